//! The tree of an expression, with constants folded, and its evaluation.

use super::Elementary;
use super::function::Function;
use super::jet::Jet;

/// A part of an expression.
#[derive(Clone, Debug)]
pub(super) struct Node {
    kind: Kind,
    /// Whether a variable occurs in it. Parts without variables are evaluated as plain numbers: that is
    /// cheap, and t^2.5 or sqrt(t) at t = 0 then have no derivative that could be infinite.
    varies: bool,
}

#[derive(Clone, Debug)]
enum Kind {
    Number(f64),
    Time,
    /// The time as seen from the side from which it is approached.
    SidedTime,
    Variable(usize),
    Negation(Box<Node>),
    /// An operand and what is done to it, from left to right: a long sum or product is one node, whose evaluation needs no
    /// stack for each of its terms.
    Operation(Box<Node>, Vec<(Operator, Node)>),
    Call(Function, Box<Node>),
    Choice(Function, Box<[Node; 2]>),
}

/// A binary operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Operator {
    Add,
    Subtract,
    Multiply,
    Divide,
    Power,
}

impl Node {
    pub(super) fn number(value: f64) -> Self {
        Self { kind: Kind::Number(value), varies: false }
    }

    pub(super) fn time() -> Self {
        Self { kind: Kind::Time, varies: false }
    }

    pub(super) fn variable(index: usize) -> Self {
        Self { kind: Kind::Variable(index), varies: true }
    }

    pub(super) fn negation(inner: Self) -> Self {
        let varies = inner.varies;
        Self { kind: Kind::Negation(Box::new(inner)), varies }.folded()
    }

    pub(super) fn operation(operator: Operator, left: Self, right: Self) -> Self {
        let varies = left.varies || right.varies;
        match left {
            // What does not vary stays a part of its own, to be evaluated as a plain number.
            Self { kind: Kind::Operation(first, mut rest), varies: before }
                if operator != Operator::Power && before == varies =>
            {
                rest.push((operator, right));
                Self { kind: Kind::Operation(first, rest), varies }
            }
            left => Self { kind: Kind::Operation(Box::new(left), vec![(operator, right)]), varies }.folded(),
        }
    }

    /// Whether a further operation from the right makes this node longer instead of deeper.
    pub(super) fn takes_operand(&self, operator: Operator, right: &Self) -> bool {
        matches!(self.kind, Kind::Operation(..))
            && operator != Operator::Power
            && self.varies == (self.varies || right.varies)
    }

    pub(super) fn call(function: Function, mut argument: Self) -> Self {
        if function.jumps() {
            argument.take_sides();
        }
        let varies = argument.varies;
        Self { kind: Kind::Call(function, Box::new(argument)), varies }.folded()
    }

    pub(super) fn choice(function: Function, left: Self, right: Self) -> Self {
        let varies = left.varies || right.varies;
        Self { kind: Kind::Choice(function, Box::new([left, right])), varies }.folded()
    }

    pub(super) fn varies(&self) -> bool {
        self.varies
    }

    /// The number, if it is one.
    pub(super) fn as_number(&self) -> Option<f64> {
        match self.kind {
            Kind::Number(value) => Some(value),
            _ => None,
        }
    }

    /// A number in place of a part all of whose parts are numbers.
    fn folded(self) -> Self {
        let constant = match &self.kind {
            Kind::Number(_) | Kind::Time | Kind::SidedTime | Kind::Variable(_) => false,
            Kind::Negation(inner) | Kind::Call(_, inner) => inner.as_number().is_some(),
            Kind::Choice(_, sides) => sides.iter().all(|side| side.as_number().is_some()),
            Kind::Operation(first, rest) => {
                first.as_number().is_some() && rest.iter().all(|(_, right)| right.as_number().is_some())
            }
        };
        if constant { Self::number(self.plain(0.0, 0.0)) } else { self }
    }

    /// Puts the sided time in place of the time.
    fn take_sides(&mut self) {
        match &mut self.kind {
            Kind::Time => self.kind = Kind::SidedTime,
            Kind::Number(_) | Kind::SidedTime | Kind::Variable(_) => {}
            Kind::Negation(inner) | Kind::Call(_, inner) => inner.take_sides(),
            Kind::Choice(_, sides) => sides.iter_mut().for_each(Self::take_sides),
            Kind::Operation(first, rest) => {
                first.take_sides();
                rest.iter_mut().for_each(|(_, right)| right.take_sides());
            }
        }
    }

    /// The value of a part without variables.
    fn plain<T: Elementary>(&self, time: T, sided: T) -> T {
        self.branch::<T, T>(time, sided, &[])
    }

    /// The value with the derivatives that `J` carries.
    pub(super) fn evaluate<T: Elementary, J: Jet<T>>(&self, time: T, sided: T, variables: &[J]) -> J {
        if self.varies {
            self.branch(time, sided, variables)
        } else {
            J::constant(match self.kind {
                Kind::Number(value) => T::of(value),
                _ => self.plain(time, sided),
            })
        }
    }

    fn branch<T: Elementary, J: Jet<T>>(&self, time: T, sided: T, variables: &[J]) -> J {
        let of = |node: &Self| node.evaluate(time, sided, variables);
        match &self.kind {
            Kind::Number(value) => J::constant(T::of(*value)),
            Kind::Time => J::constant(time),
            Kind::SidedTime => J::constant(sided),
            Kind::Variable(index) => match variables.get(*index) {
                Some(variable) => *variable,
                None => J::constant(T::of(f64::NAN)),
            },
            Kind::Negation(inner) => of(inner).negate(),
            Kind::Call(function, argument) => function.apply(of(argument)),
            Kind::Choice(function, sides) => function.choose(of(&sides[0]), of(&sides[1])),
            Kind::Operation(first, rest) => {
                rest.iter().fold(of(first), |left, (operator, right)| match operator {
                    Operator::Add => left.add(of(right)),
                    Operator::Subtract => left.subtract(of(right)),
                    Operator::Multiply => left.multiply(of(right)),
                    Operator::Divide => left.divide(of(right)),
                    Operator::Power if right.varies => varying_power(left, of(right), first.varies),
                    Operator::Power => fixed_power(left, right.evaluate::<T, T>(time, sided, &[])),
                })
            }
        }
    }
}

/// x^e with an exponent without variables: x^e, e·x^(e−1), e(e−1)·x^(e−2), a factor 0 winning over x = 0.
fn fixed_power<T: Elementary, J: Jet<T>>(base: J, exponent: T) -> J {
    let x = base.value();
    base.chain(power(x, exponent), || {
        let one = T::one();
        let reduced = exponent - one;
        let first = if exponent == T::zero() { exponent } else { exponent * power(x, reduced) };
        let factor = exponent * reduced;
        let second = if factor == T::zero() { factor } else { factor * power(x, reduced - one) };
        (first, second)
    })
}

/// b^e with an exponent that varies: e^(e·ln b).
fn varying_power<T: Elementary, J: Jet<T>>(base: J, exponent: J, base_varies: bool) -> J {
    let value = power(base.value(), exponent.value());
    if value == T::zero() {
        return J::constant(value);
    }
    let logarithm =
        if base_varies { Function::Log.apply(base) } else { J::constant(base.value().logarithm()) };
    exponent.multiply(logarithm).chain(value, || (value, value))
}

/// x^e: by multiplication for small whole exponents, which is exact where it can be and what anyone writing
/// the formula out would compute; otherwise from `libm`. Negative bases take whole exponents only.
fn power<T: Elementary>(x: T, exponent: T) -> T {
    const LARGEST: i32 = 8;
    let mut whole = 0;
    let mut count = T::zero();
    let magnitude = exponent.abs();
    while whole < LARGEST && count < magnitude {
        whole += 1;
        count += T::one();
    }
    if count != magnitude {
        return x.power(exponent);
    }
    let mut product = T::one();
    let mut square = x;
    let mut bits = whole;
    while bits > 0 {
        if bits & 1 == 1 {
            product *= square;
        }
        square *= square;
        bits >>= 1;
    }
    if exponent < T::zero() { T::one() / product } else { product }
}
