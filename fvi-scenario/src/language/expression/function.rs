//! The functions of expressions, each with its first two derivatives.

use super::Elementary;
use super::jet::Jet;
use core::cmp::Ordering;

/// A function of one or two arguments.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Function {
    /// 0 below zero, 1 from zero on.
    Step,
    /// −1, 0 or 1.
    Sign,
    /// The absolute value.
    Abs,
    /// The square root.
    Sqrt,
    /// eˣ.
    Exp,
    /// The natural logarithm.
    Log,
    /// The sine, of radians.
    Sin,
    /// The cosine, of radians.
    Cos,
    /// The tangent, of radians.
    Tan,
    /// The hyperbolic sine.
    Sinh,
    /// The hyperbolic cosine.
    Cosh,
    /// The hyperbolic tangent.
    Tanh,
    /// Γ(x).
    Gamma,
    /// The angle of a tangent, in (−π/2, π/2).
    Atan,
    /// The angle of a sine, in [−π/2, π/2].
    Asin,
    /// The angle of a cosine, in [0, π].
    Acos,
    /// The angle of the point (x, y), given as (y, x), in [−π, π]; its derivatives do not see the cut.
    Atan2,
    /// √(x² + y²).
    Hypot,
    /// The smaller of two numbers.
    Min,
    /// The larger of two numbers.
    Max,
}

const NAMES: [(&str, Function); 20] = [
    ("step", Function::Step),
    ("sign", Function::Sign),
    ("min", Function::Min),
    ("max", Function::Max),
    ("abs", Function::Abs),
    ("sqrt", Function::Sqrt),
    ("exp", Function::Exp),
    ("log", Function::Log),
    ("sin", Function::Sin),
    ("cos", Function::Cos),
    ("tan", Function::Tan),
    ("atan", Function::Atan),
    ("asin", Function::Asin),
    ("acos", Function::Acos),
    ("atan2", Function::Atan2),
    ("hypot", Function::Hypot),
    ("sinh", Function::Sinh),
    ("cosh", Function::Cosh),
    ("tanh", Function::Tanh),
    ("gamma", Function::Gamma),
];

impl Function {
    pub(super) fn named(name: &str) -> Option<Self> {
        NAMES.iter().find(|(known, _)| *known == name).map(|&(_, function)| function)
    }

    pub(super) fn names() -> impl Iterator<Item = &'static str> {
        NAMES.iter().map(|&(name, _)| name)
    }

    pub(super) fn arguments(self) -> usize {
        match self {
            Self::Min | Self::Max | Self::Atan2 | Self::Hypot => 2,
            _ => 1,
        }
    }

    /// Its name in expressions.
    pub fn name(self) -> &'static str {
        NAMES.iter().find(|(_, function)| *function == self).map_or("", |(name, _)| name)
    }

    /// True if the function has a kink where its two arguments are equal.
    pub fn selects(self) -> bool {
        matches!(self, Self::Min | Self::Max)
    }

    /// True if the function jumps, so that the side from which its argument is approached matters.
    pub(super) fn jumps(self) -> bool {
        matches!(self, Self::Step | Self::Sign)
    }

    /// The value at `x` of a function of one argument.
    #[inline]
    pub fn at<T: Elementary>(self, x: T) -> T {
        self.apply(x)
    }

    /// The function of `x`; [`of_two`](Self::of_two) has those of two arguments.
    ///
    /// At a kink or jump the derivatives are those of neither side: `abs` has 0 at 0, `step` and `sign` have
    /// 0 everywhere.
    pub(crate) fn apply<T: Elementary, J: Jet<T>>(self, x: J) -> J {
        let v = x.value();
        let (zero, one, two) = (T::zero(), T::one(), T::one() + T::one());
        match self {
            Self::Step => J::constant(step(v)),
            Self::Sign => J::constant(sign(v)),
            Self::Abs => x.chain(v.abs(), || (sign(v), zero)),
            Self::Sqrt => {
                let root = v.square_root();
                x.chain(root, || {
                    let slope = one / (two * root);
                    (slope, -slope / (two * v))
                })
            }
            Self::Exp => {
                let power = v.exponential();
                x.chain(power, || (power, power))
            }
            Self::Log => x.chain(v.logarithm(), || (one / v, -one / (v * v))),
            Self::Sin => {
                let sine = v.sine();
                x.chain(sine, || (v.cosine(), -sine))
            }
            Self::Cos => {
                let cosine = v.cosine();
                x.chain(cosine, || (-v.sine(), -cosine))
            }
            Self::Tan => {
                let tangent = v.tangent();
                x.chain(tangent, || {
                    let slope = one + tangent * tangent;
                    (slope, two * tangent * slope)
                })
            }
            Self::Atan => {
                let slope = one / (one + v * v);
                x.chain(v.arc_tangent(), || (slope, -two * v * slope * slope))
            }
            Self::Asin | Self::Acos => {
                let is_sine = self == Self::Asin;
                let value = if is_sine { v.arc_sine() } else { v.arc_cosine() };
                x.chain(value, || {
                    // (1 − v)(1 + v) keeps the digits of 1 − v² near its ends.
                    let square = (one - v) * (one + v);
                    let slope = one / square.square_root();
                    let change = v * slope / square;
                    if is_sine { (slope, change) } else { (-slope, -change) }
                })
            }
            Self::Sinh => {
                let sine = v.hyperbolic_sine();
                x.chain(sine, || (v.hyperbolic_cosine(), sine))
            }
            Self::Cosh => {
                let cosine = v.hyperbolic_cosine();
                x.chain(cosine, || (v.hyperbolic_sine(), cosine))
            }
            Self::Tanh => {
                let tangent = v.hyperbolic_tangent();
                x.chain(tangent, || {
                    // 1/cosh² is accurate where 1 − tanh² has cancelled.
                    let cosine = v.hyperbolic_cosine();
                    let slope = one / (cosine * cosine);
                    (slope, -two * tangent * slope)
                })
            }
            Self::Gamma => {
                let gamma = v.gamma_function();
                x.chain(gamma, || {
                    // Γ′ = Γψ, Γ″ = Γ(ψ² + ψ′).
                    let (first, second) = (v.digamma_function(), v.trigamma_function());
                    (gamma * first, gamma * (first * first + second))
                })
            }
            Self::Min | Self::Max | Self::Atan2 | Self::Hypot => x,
        }
    }

    /// The function of two numbers.
    pub(super) fn of_two<T: Elementary, J: Jet<T>>(self, left: J, right: J) -> J {
        match self {
            Self::Atan2 => {
                // In axes turned by the angle itself it is 0, and its derivatives are those of the tangent.
                let (y, x) = (J::constant(left.value()), J::constant(right.value()));
                let along = right.multiply(x).add(left.multiply(y));
                let across = left.multiply(x).subtract(right.multiply(y));
                let angle = left.value().arc_tangent_of(right.value());
                J::constant(angle).add(across.divide(along))
            }
            Self::Hypot => Self::Sqrt.apply(left.multiply(left).add(right.multiply(right))),
            _ => self.choose(left, right),
        }
    }

    /// `min` or `max` of two numbers, with the derivatives of the selected one.
    ///
    /// If either number is not a number, so is the result.
    fn choose<T: Elementary, J: Jet<T>>(self, left: J, right: J) -> J {
        match left.value().partial_cmp(&right.value()) {
            None => left.add(right),
            Some(Ordering::Greater) if self == Self::Min => right,
            Some(Ordering::Less) if self == Self::Max => right,
            Some(_) => left,
        }
    }
}

/// 1 for x ≥ 0, else 0.
fn step<T: Elementary>(x: T) -> T {
    match x.partial_cmp(&T::zero()) {
        None => x,
        Some(Ordering::Less) => T::zero(),
        Some(_) => T::one(),
    }
}

/// −1, 0 or 1.
fn sign<T: Elementary>(x: T) -> T {
    match x.partial_cmp(&T::zero()) {
        None | Some(Ordering::Equal) => x,
        Some(Ordering::Less) => -T::one(),
        Some(Ordering::Greater) => T::one(),
    }
}
