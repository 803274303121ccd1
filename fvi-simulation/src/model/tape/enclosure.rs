//! Bounds of a function of time over a range of time, by interval arithmetic: of its value and of its first
//! two derivatives.
//!
//! Every operation rounds outwards, so that bounds hold for the function at all times of the range. Source:
//! \[MKC09\] ch. 2 and 5.

use fvi_core::min_or_nan;
use fvi_fft::sums::max_or_nan;
use fvi_scenario::language::expression::{Elementary, Function, Kind, Node, Operator, power};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// A closed interval of numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    /// Lower bound.
    pub(super) low: f64,
    /// Upper bound.
    pub(super) high: f64,
}

/// Bounds of value, first and second derivative. At jumps, kinks, roots, poles, and where the function is not
/// defined, bounds of quantities that do not exist are infinite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Enclosure {
    /// Bounds of the function.
    pub(super) value: Bounds,
    /// Bounds of its derivative.
    pub(super) slope: Bounds,
    /// Bounds of its second derivative.
    pub(super) bend: Bounds,
}

/// Relative error bound of functions of `libm`.
const ROUNDING: f64 = 8.0 * f64::EPSILON;

/// Largest argument of sine, cosine and tangent that is reduced to a period.
const MOST_RADIANS: f64 = 1e9;

impl Bounds {
    const WHOLE: Self = Self { low: f64::NEG_INFINITY, high: f64::INFINITY };
    const ZERO: Self = Self { low: 0.0, high: 0.0 };

    fn point(number: f64) -> Self {
        Self { low: number, high: number }.checked()
    }

    /// Bounds of an operation that rounds correctly; a difference of zero is exact.
    fn rounded(low: f64, high: f64) -> Self {
        let (down, up) = (low.next_down(), high.next_up());
        Self { low: if low == 0.0 { low } else { down }, high: if high == 0.0 { high } else { up } }.checked()
    }

    /// Bounds of a function of `libm`.
    fn loose(low: f64, high: f64) -> Self {
        let widened = |number: f64| ROUNDING * number.abs() + f64::MIN_POSITIVE;
        let (low, high) = if low <= high { (low, high) } else { (high, low) };
        // An infinite bound stays infinite.
        let low = if low.is_infinite() { low } else { low - widened(low) };
        let high = if high.is_infinite() { high } else { high + widened(high) };
        Self { low, high }.checked()
    }

    fn checked(self) -> Self {
        if self.low.is_nan() || self.high.is_nan() { Self::WHOLE } else { self }
    }

    /// True if zero is in the interval.
    pub(super) fn contains_zero(self) -> bool {
        self.low <= 0.0 && self.high >= 0.0
    }

    /// True if the interval is the number zero.
    pub(super) fn is_zero(self) -> bool {
        self == Self::ZERO
    }

    /// True if both bounds are finite.
    pub(super) fn is_finite(self) -> bool {
        self.low.is_finite() && self.high.is_finite()
    }

    /// The largest absolute value.
    pub(super) fn magnitude(self) -> f64 {
        self.low.abs().max(self.high.abs())
    }

    /// The smallest absolute value.
    pub(super) fn mignitude(self) -> f64 {
        if self.contains_zero() { 0.0 } else { self.low.abs().min(self.high.abs()) }
    }

    fn hull(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    fn meet(self, other: Self) -> Self {
        let met = Self { low: self.low.max(other.low), high: self.high.min(other.high) };
        if met.low <= met.high { met } else { self }
    }

    fn negative(self) -> Self {
        Self { low: -self.high, high: -self.low }
    }

    fn plus(self, other: Self) -> Self {
        if self.is_zero() {
            return other;
        }
        if other.is_zero() {
            return self;
        }
        Self::rounded(self.low + other.low, self.high + other.high)
    }

    /// Zero times an infinite bound is zero: the derivative of a constant factor.
    fn times(self, other: Self) -> Self {
        if self.is_zero() || other.is_zero() {
            return Self::ZERO;
        }
        let product = |a: f64, b: f64| if a == 0.0 || b == 0.0 { 0.0 } else { a * b };
        let all = [
            product(self.low, other.low),
            product(self.low, other.high),
            product(self.high, other.low),
            product(self.high, other.high),
        ];
        let low = all.into_iter().fold(f64::INFINITY, min_or_nan);
        Self::rounded(low, all.into_iter().fold(f64::NEG_INFINITY, max_or_nan))
    }

    fn scaled(self, factor: f64) -> Self {
        self.times(Self::point(factor))
    }

    fn squared(self) -> Self {
        if self.is_zero() {
            return self;
        }
        let (least, most) = (self.mignitude(), self.magnitude());
        Self { low: (least * least).next_down().max(0.0), high: (most * most).next_up() }.checked()
    }

    /// Bounds of a function that is monotonic.
    fn through(self, function: impl Fn(f64) -> f64) -> Self {
        Self::loose(function(self.low), function(self.high))
    }

    /// x^e for x ≥ 0, e not zero.
    fn raised(self, exponent: f64) -> Self {
        let raised = |x: f64| if x <= 0.0 && exponent < 0.0 { f64::INFINITY } else { power(x, exponent) };
        let Self { low, high } = self.through(raised);
        Self { low: low.max(0.0), high }
    }

    /// x^n for an integer n and any x.
    fn to_whole(self, n: f64) -> Self {
        if n == 0.0 {
            return Self::point(1.0);
        }
        if n < 0.0 && self.contains_zero() {
            return Self::WHOLE;
        }
        let is_even = (0.5 * n).fract() == 0.0;
        if is_even {
            let sizes = Self { low: self.mignitude(), high: self.magnitude() };
            return sizes.raised(n);
        }
        self.through(|x| power(x, n))
    }

    /// True if the interval may contain place + k·2π for some integer k.
    fn meets(self, place: f64) -> bool {
        let slack = 1e-9;
        ((self.high + slack - place) / TAU).floor() >= ((self.low - slack - place) / TAU).ceil()
    }

    /// Bounds of a sinusoid with its maximum at this place.
    fn wave(self, function: impl Fn(f64) -> f64, highest: f64) -> Self {
        if self.magnitude() >= MOST_RADIANS {
            return Self { low: -1.0, high: 1.0 };
        }
        let ends = self.through(function);
        let low = if self.meets(highest + PI) { -1.0 } else { ends.low };
        let high = if self.meets(highest) { 1.0 } else { ends.high };
        Self { low, high }
    }

    fn sine(self) -> Self {
        self.wave(|x| x.sine(), FRAC_PI_2)
    }

    fn cosine(self) -> Self {
        self.wave(|x| x.cosine(), 0.0)
    }

    fn hyperbolic_cosine(self) -> Self {
        Self { low: self.mignitude(), high: self.magnitude() }.through(|x| x.hyperbolic_cosine())
    }
}

impl Enclosure {
    const UNKNOWN: Self = Self { value: Bounds::WHOLE, slope: Bounds::WHOLE, bend: Bounds::WHOLE };

    /// Enclosure of a part of an expression that depends on time alone, over [`from`, `to`].
    pub(super) fn of(node: &Node, from: f64, to: f64) -> Self {
        let of = |node: &Node| Self::of(node, from, to);
        match node.kind() {
            Kind::Number(number) => Self::constant(Bounds::point(*number)),
            Kind::Time | Kind::SidedTime => {
                Self { value: Bounds { low: from, high: to }, slope: Bounds::point(1.0), bend: Bounds::ZERO }
            }
            Kind::Variable(_) => Self::UNKNOWN,
            Kind::Negation(inner) => of(inner).negative(),
            Kind::Chain(first, operands) => {
                operands.iter().fold(of(first), |joined, (operator, operand)| match operator {
                    Operator::Add => joined.plus(of(operand)),
                    Operator::Subtract => joined.plus(of(operand).negative()),
                    Operator::Multiply => joined.times(of(operand)),
                    Operator::Divide => match operand.as_number() {
                        Some(divisor) if divisor != 0.0 => joined.divided(divisor),
                        _ => joined.times(of(operand).to_power(-1.0)),
                    },
                })
            }
            Kind::Power(sides) => {
                let [base, exponent] = sides.as_ref();
                match exponent.as_number() {
                    Some(exponent) => of(base).to_power(exponent),
                    None => {
                        let base = of(base);
                        // b^e = e^(e ln b) for positive b.
                        if base.value.low > 0.0 {
                            base.call(Function::Log).times(of(exponent)).call(Function::Exp)
                        } else {
                            Self::UNKNOWN
                        }
                    }
                }
            }
            Kind::Call(function, argument) => of(argument).call(*function),
            Kind::Choice(function, sides) => of(&sides[0]).choose(*function, of(&sides[1])),
        }
    }

    /// As [`of`](Self::of), with value and slope tightened by the mean value theorem.
    pub(super) fn centred(node: &Node, from: f64, to: f64) -> Self {
        let mut found = Self::of(node, from, to);
        let middle = 0.5 * (from + to);
        if !found.slope.is_finite() || !found.value.contains_zero() {
            return found;
        }
        let centre = Self::of(node, middle, middle);
        let way = Bounds::rounded(from - middle, to - middle);
        found.value = found.value.meet(centre.value.plus(found.slope.times(way)));
        if found.bend.is_finite() {
            found.slope = found.slope.meet(centre.slope.plus(found.bend.times(way)));
        }
        found
    }

    fn constant(value: Bounds) -> Self {
        Self { value, slope: Bounds::ZERO, bend: Bounds::ZERO }
    }

    fn negative(self) -> Self {
        Self { value: self.value.negative(), slope: self.slope.negative(), bend: self.bend.negative() }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            value: self.value.plus(other.value),
            slope: self.slope.plus(other.slope),
            bend: self.bend.plus(other.bend),
        }
    }

    fn times(self, other: Self) -> Self {
        let once = self.slope.times(other.value).plus(self.value.times(other.slope));
        let mixed = self.slope.times(other.slope).scaled(2.0);
        let twice = self.bend.times(other.value).plus(mixed).plus(self.value.times(other.bend));
        Self { value: self.value.times(other.value), slope: once, bend: twice }
    }

    fn divided(self, divisor: f64) -> Self {
        let by = |bounds: Bounds| {
            if bounds.is_zero() {
                return bounds;
            }
            let (low, high) = (bounds.low / divisor, bounds.high / divisor);
            Bounds::rounded(low.min(high), low.max(high))
        };
        Self { value: by(self.value), slope: by(self.slope), bend: by(self.bend) }
    }

    /// f(g) with f and its derivatives over the values of g.
    fn chain(self, value: Bounds, first: Bounds, second: Bounds) -> Self {
        let bend = second.times(self.slope.squared()).plus(first.times(self.bend));
        Self { value, slope: first.times(self.slope), bend }
    }

    fn to_power(self, exponent: f64) -> Self {
        let x = self.value;
        let whole = exponent.fract() == 0.0;
        if !whole && x.low < 0.0 {
            return Self::UNKNOWN;
        }
        let raised = |e: f64| match () {
            () if e == 0.0 => Bounds::point(1.0),
            () if whole => x.to_whole(e),
            () => x.raised(e),
        };
        let derivative = |factor: f64, e: f64| {
            if factor == 0.0 { Bounds::ZERO } else { raised(e).scaled(factor) }
        };
        let first = derivative(exponent, exponent - 1.0);
        let second = derivative(exponent * (exponent - 1.0), exponent - 2.0);
        self.chain(raised(exponent), first, second)
    }

    fn call(self, function: Function) -> Self {
        let x = self.value;
        match function {
            Function::Step if x.low >= 0.0 => Self::constant(Bounds::point(1.0)),
            Function::Step if x.high < 0.0 => Self::constant(Bounds::ZERO),
            Function::Step => self.chain(Bounds { low: 0.0, high: 1.0 }, Bounds::WHOLE, Bounds::WHOLE),
            Function::Sign if x.low > 0.0 => Self::constant(Bounds::point(1.0)),
            Function::Sign if x.high < 0.0 => Self::constant(Bounds::point(-1.0)),
            Function::Sign => self.chain(Bounds { low: -1.0, high: 1.0 }, Bounds::WHOLE, Bounds::WHOLE),
            Function::Abs if x.low >= 0.0 => self,
            Function::Abs if x.high <= 0.0 => self.negative(),
            Function::Abs => {
                let sides = Bounds { low: -1.0, high: 1.0 };
                self.chain(Bounds { low: 0.0, high: x.magnitude() }, sides, Bounds::WHOLE)
            }
            Function::Sqrt | Function::Log if x.low < 0.0 => Self::UNKNOWN,
            Function::Sqrt => {
                self.chain(x.raised(0.5), x.raised(-0.5).scaled(0.5), x.raised(-1.5).scaled(-0.25))
            }
            Function::Log => {
                self.chain(x.through(|x| x.logarithm()), x.raised(-1.0), x.raised(-2.0).negative())
            }
            Function::Exp => {
                let power = x.through(|x| x.exponential());
                self.chain(power, power, power)
            }
            Function::Sin => self.chain(x.sine(), x.cosine(), x.sine().negative()),
            Function::Cos => self.chain(x.cosine(), x.sine().negative(), x.cosine().negative()),
            Function::Tan => {
                if x.cosine().contains_zero() {
                    return Self::UNKNOWN;
                }
                let tangent = x.through(|x| x.tangent());
                let slope = tangent.squared().plus(Bounds::point(1.0));
                self.chain(tangent, slope, tangent.times(slope).scaled(2.0))
            }
            Function::Sinh => {
                let sine = x.through(|x| x.hyperbolic_sine());
                self.chain(sine, x.hyperbolic_cosine(), sine)
            }
            Function::Cosh => {
                let (sine, cosine) = (x.through(|x| x.hyperbolic_sine()), x.hyperbolic_cosine());
                self.chain(cosine, sine, cosine)
            }
            Function::Tanh => {
                let tangent = x.through(|x| x.hyperbolic_tangent());
                let slope = x.hyperbolic_cosine().squared().raised(-1.0);
                self.chain(tangent, slope, tangent.times(slope).scaled(-2.0))
            }
            Function::Gamma => self.gamma(),
            Function::Atan => {
                let slope = x.squared().plus(Bounds::point(1.0)).raised(-1.0);
                let bend = x.times(slope.squared()).scaled(-2.0);
                self.chain(x.through(|x| x.arc_tangent()), slope, bend)
            }
            Function::Asin | Function::Acos if x.low <= -1.0 || x.high >= 1.0 => Self::UNKNOWN,
            Function::Asin => {
                let square = Bounds::point(1.0).plus(x.squared().negative());
                let bend = x.times(square.raised(-1.5));
                self.chain(x.through(|x| x.arc_sine()), square.raised(-0.5), bend)
            }
            Function::Acos => {
                let right = Self::constant(Bounds::loose(0.5 * PI, 0.5 * PI));
                right.plus(self.call(Function::Asin).negative())
            }
            Function::Min | Function::Max | Function::Atan2 | Function::Hypot => self,
        }
    }

    /// Γ for positive arguments, where it and its second derivative are convex.
    fn gamma(self) -> Self {
        let x = self.value;
        if x.low <= 0.0 {
            if x.high > 0.5 {
                return Self::UNKNOWN;
            }
            // Γ(x) Γ(1 − x) = π/sin πx
            let pi = Self::constant(Bounds::loose(PI, PI));
            let other = Self::constant(Bounds::point(1.0)).plus(self.negative()).gamma();
            return pi.times(pi.times(self).call(Function::Sin).times(other).to_power(-1.0));
        }
        let at = |x: f64| {
            let (gamma, first, second) = (x.gamma_function(), x.digamma_function(), x.trigamma_function());
            [gamma, gamma * first, gamma * (first * first + second)]
        };
        let (low, high) = (at(x.low), at(x.high));
        // The minimum of Γ is 0.8856 at 1.4616. The digamma and trigamma functions are less accurate.
        let least = if x.low < 1.47 && x.high > 1.45 { 0.885 } else { low[0].min(high[0]) * (1.0 - 1e-12) };
        let value = Bounds { low: least, high: low[0].max(high[0]) * (1.0 + 1e-12) }.checked();
        let loose = |low: f64, high: f64| {
            let slack = 1e-9 * (low.abs() + high.abs());
            Bounds { low: low - slack, high: high + slack }.checked()
        };
        // The second derivative increases from 2 on.
        let least = if x.low >= 2.0 { low[2] } else { 0.0 };
        self.chain(value, loose(low[1], high[1]), loose(least, low[2].max(high[2])))
    }

    fn choose(self, function: Function, other: Self) -> Self {
        if function == Function::Hypot {
            return self.times(self).plus(other.times(other)).call(Function::Sqrt);
        }
        if function == Function::Atan2 {
            return Self::UNKNOWN;
        }
        let (lesser, greater) = match function {
            Function::Min => (self, other),
            _ => (self.negative(), other.negative()),
        };
        let chosen = if lesser.value.high <= greater.value.low {
            lesser
        } else if greater.value.high <= lesser.value.low {
            greater
        } else {
            let value = Bounds {
                low: lesser.value.low.min(greater.value.low),
                high: lesser.value.high.min(greater.value.high),
            };
            let both_constant = lesser.slope.is_zero() && greater.slope.is_zero();
            let bend = if both_constant { Bounds::ZERO } else { Bounds::WHOLE };
            Self { value, slope: lesser.slope.hull(greater.slope), bend }
        };
        if function == Function::Min { chosen } else { chosen.negative() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_scenario::language::expression::{Expression, Moment, Symbols};

    fn expression(text: &str) -> Expression {
        Expression::parse(text, &Symbols::new().with_time()).unwrap()
    }

    /// Every function, on both sides of its special points.
    const SAMPLES: [&str; 27] = [
        "gamma(t - 3.417)",
        "3 - 2*t + t^2/7",
        "sin(3*t) + cos(t)^2",
        "tan(t/4)",
        "exp(-((t - 1)/0.3)^2)/0.3",
        "log(t + 0.5) - 1/(t + 1)",
        "sqrt(t + 0.1)*t^2.5",
        "sinh(t - 1) + cosh(2 - t)",
        "tanh(5*(t - 1.2))",
        "gamma(t + 0.2)",
        "gamma(t + 3.2)",
        "abs(t - 1.3) + max(t, 2 - t)",
        "min(sin(t), cos(t))",
        "step(t - 1)*t + sign(1.5 - t)",
        "2^(-t) + (t + 1)^(t - 0.5)",
        "(t - 1)^3 + (t + 1)^(-3)",
        "(t + 2)^(-2) - (t - 1)^4",
        "1/(1 + t^2)",
        "t^0.3",
        "-abs(-t)",
        "exp(sin(7*t))",
        "t*t - 2*t + 1",
        "t/(t + 1)",
        "max(0, 1 - abs(t - 1)/0.1)",
        "step(0.01 - (t - 1.1)^2)",
        "5",
        "log(abs(t - 1))",
    ];

    #[test]
    fn values_and_difference_quotients_lie_within_the_bounds() {
        let mut checked = 0;
        for text in SAMPLES {
            let expression = expression(text);
            let value = |t: f64| expression.value(Moment::inside(t), &[]);
            for (from, width) in [(0.0, 0.5), (0.05, 1e-3), (0.9, 0.3), (1.0, 1e-6), (1.2, 0.7), (2.0, 3.0)] {
                let found = Enclosure::of(expression.root(), from, from + width);
                let centred = Enclosure::centred(expression.root(), from, from + width);
                for part in 0..=20 {
                    let t = from + width * f64::from(part) / 20.0;
                    for bounds in [found.value, centred.value] {
                        assert!(
                            bounds.low <= value(t) && value(t) <= bounds.high,
                            "{text} at {t}: {bounds:?}"
                        );
                    }
                    let h = 0.02 * width;
                    if t + h > from + width || h < 1e-5 {
                        continue;
                    }
                    // A difference quotient of the function is a value of its derivative.
                    let quotient = (value(t + h) - value(t)) / h;
                    let slack = 1e-9 * (1.0 + quotient.abs());
                    for Bounds { low, high } in [found.slope, centred.slope] {
                        assert!(low - slack <= quotient && quotient <= high + slack, "{text} at {t}");
                    }
                    if t + 2.0 * h <= from + width {
                        let second = (value(t + 2.0 * h) - 2.0 * value(t + h) + value(t)) / (h * h);
                        let slack = 1e-5 * (1.0 + second.abs());
                        let Bounds { low, high } = found.bend;
                        assert!(low - slack <= second && second <= high + slack, "{text} at {t}: {second}");
                        checked += 1;
                    }
                }
            }
        }
        assert!(checked > 1500, "{checked}");
    }

    #[test]
    fn bounds_close_in_where_a_function_is_smooth() {
        for text in ["sin(3*t) + cos(t)^2", "exp(-((t - 1)/0.3)^2)/0.3", "gamma(t + 3.2)", "1/(1 + t^2)"] {
            let expression = expression(text);
            let found = Enclosure::of(expression.root(), 0.7, 0.7 + 1e-6);
            for Bounds { low, high } in [found.value, found.slope, found.bend] {
                assert!(high - low < 1e-3, "{text}: {low} to {high}");
            }
        }
        // Unbounded functions have infinite bounds.
        assert!(!Enclosure::of(expression("1/(t - 1.03)").root(), 1.0, 1.1).value.is_finite());
        assert!(!Enclosure::of(expression("tan(t)").root(), 1.5, 1.6).value.is_finite());
        assert!(!Enclosure::of(expression("abs(t - 1)").root(), 0.9, 1.1).bend.is_finite());
        assert!(Enclosure::of(expression("step(t - 1)").root(), 0.9, 0.99).slope.is_zero());
    }
}
