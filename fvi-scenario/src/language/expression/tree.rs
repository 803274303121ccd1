//! The tree of an expression, with constants folded, and its evaluation.

use super::Elementary;
use super::function::Function;
use super::jet::Jet;

/// A part of an expression.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    kind: Kind,
    /// True if a variable occurs in it. Parts without variables are evaluated as plain numbers: that is
    /// cheap, and t^2.5 or sqrt(t) at t = 0 then have no derivative that could be infinite.
    varies: bool,
}

/// Kind of a part.
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// A number.
    Number(f64),
    /// The time.
    Time,
    /// The time as seen from the side from which it is approached.
    SidedTime,
    /// A variable, by its index.
    Variable(usize),
    /// The negative of a part.
    Negation(Box<Node>),
    /// Operands joined from left to right by operators of one precedence: a sum or a product. A sum of a
    /// hundred thousand terms is one part, not a hundred thousand nested ones.
    Chain(Box<Node>, Vec<(Operator, Node)>),
    /// Base and exponent.
    Power(Box<[Node; 2]>),
    /// A function of one argument.
    Call(Function, Box<Node>),
    /// `min` or `max`.
    Choice(Function, Box<[Node; 2]>),
}

/// An operator that joins operands from left to right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operator {
    /// +
    Add,
    /// −
    Subtract,
    /// ·
    Multiply,
    /// /
    Divide,
}

impl Operator {
    /// True if it joins the terms of a sum rather than the factors of a product.
    pub fn is_additive(self) -> bool {
        matches!(self, Self::Add | Self::Subtract)
    }
}

impl Node {
    /// A number.
    pub fn number(value: f64) -> Self {
        Self { kind: Kind::Number(value), varies: false }
    }

    pub(super) fn time() -> Self {
        Self { kind: Kind::Time, varies: false }
    }

    /// A variable, by its index.
    pub fn variable(index: usize) -> Self {
        Self { kind: Kind::Variable(index), varies: true }
    }

    /// −`inner`.
    pub fn negation(inner: Self) -> Self {
        let varies = inner.varies;
        Self { kind: Kind::Negation(Box::new(inner)), varies }.folded()
    }

    /// `left` and `right` joined by `operator`: `right` becomes another operand of `left` if that is a
    /// suitable chain.
    pub fn join(operator: Operator, mut left: Self, right: Self) -> Self {
        if left.takes(operator, &right)
            && let Kind::Chain(_, operands) = &mut left.kind
        {
            operands.push((operator, right));
            return left;
        }
        let varies = left.varies || right.varies;
        Self { kind: Kind::Chain(Box::new(left), vec![(operator, right)]), varies }.folded()
    }

    /// True if [`join`](Self::join) extends the chain and does not make the tree deeper. A chain that begins
    /// without variables is kept as a separate part, which is evaluated as a plain number.
    pub(super) fn takes(&self, operator: Operator, right: &Self) -> bool {
        match &self.kind {
            Kind::Chain(_, operands) => {
                operands.last().is_some_and(|(last, _)| last.is_additive() == operator.is_additive())
                    && (self.varies || !right.varies)
            }
            _ => false,
        }
    }

    pub(super) fn power(base: Self, exponent: Self) -> Self {
        let varies = base.varies || exponent.varies;
        Self { kind: Kind::Power(Box::new([base, exponent])), varies }.folded()
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

    /// True if a variable occurs in it.
    pub fn varies(&self) -> bool {
        self.varies
    }

    /// Kind of the node.
    pub fn kind(&self) -> &Kind {
        &self.kind
    }

    /// True if a test holds for the node or one of its descendants.
    pub fn any(&self, test: &dyn Fn(&Self) -> bool) -> bool {
        test(self)
            || match &self.kind {
                Kind::Number(_) | Kind::Time | Kind::SidedTime | Kind::Variable(_) => false,
                Kind::Negation(inner) | Kind::Call(_, inner) => inner.any(test),
                Kind::Chain(first, operands) => {
                    first.any(test) || operands.iter().any(|(_, operand)| operand.any(test))
                }
                Kind::Power(sides) | Kind::Choice(_, sides) => sides.iter().any(|side| side.any(test)),
            }
    }

    /// True if the variable of this index occurs in it.
    pub fn has_variable(&self, index: usize) -> bool {
        self.any(&|node| matches!(node.kind, Kind::Variable(own) if own == index))
    }

    /// True if a variable of this index or a higher one occurs in it.
    pub fn has_variable_from(&self, first: usize) -> bool {
        self.any(&|node| matches!(node.kind, Kind::Variable(own) if own >= first))
    }

    /// True if it has jumps or kinks in its variables: `step`, `sign`, `abs`, `min` or `max` of them.
    pub fn has_kinks(&self) -> bool {
        self.any(&|node| match &node.kind {
            Kind::Call(Function::Step | Function::Sign | Function::Abs, argument) => argument.varies,
            Kind::Choice(function, _) => function.selects() && node.varies,
            _ => false,
        })
    }

    /// The number, if it is one.
    pub fn as_number(&self) -> Option<f64> {
        match self.kind {
            Kind::Number(value) => Some(value),
            _ => None,
        }
    }

    /// A number instead of a part whose operands are all numbers.
    fn folded(self) -> Self {
        let constant = match &self.kind {
            Kind::Number(_) | Kind::Time | Kind::SidedTime | Kind::Variable(_) => false,
            Kind::Negation(inner) | Kind::Call(_, inner) => inner.as_number().is_some(),
            Kind::Chain(first, operands) => {
                first.as_number().is_some()
                    && operands.iter().all(|(_, operand)| operand.as_number().is_some())
            }
            Kind::Power(sides) | Kind::Choice(_, sides) => {
                sides.iter().all(|side| side.as_number().is_some())
            }
        };
        if constant { Self::number(self.plain(0.0, 0.0)) } else { self }
    }

    /// Replaces the time by the sided time.
    fn take_sides(&mut self) {
        match &mut self.kind {
            Kind::Time => self.kind = Kind::SidedTime,
            Kind::Number(_) | Kind::SidedTime | Kind::Variable(_) => {}
            Kind::Negation(inner) | Kind::Call(_, inner) => inner.take_sides(),
            Kind::Chain(first, operands) => {
                first.take_sides();
                operands.iter_mut().for_each(|(_, operand)| operand.take_sides());
            }
            Kind::Power(sides) | Kind::Choice(_, sides) => sides.iter_mut().for_each(Self::take_sides),
        }
    }

    /// The value of a part without variables.
    fn plain<T: Elementary>(&self, time: T, sided: T) -> T {
        self.branch::<T, T>(time, sided, &[])
    }

    /// The value with the derivatives of the jet `J`.
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
            Kind::Choice(function, sides) => function.of_two(of(&sides[0]), of(&sides[1])),
            Kind::Chain(first, operands) => {
                operands.iter().fold(of(first), |joined, (operator, operand)| match operator {
                    Operator::Add => joined.add(of(operand)),
                    Operator::Subtract => joined.subtract(of(operand)),
                    Operator::Multiply => joined.multiply(of(operand)),
                    Operator::Divide => joined.divide(of(operand)),
                })
            }
            Kind::Power(sides) => {
                let [base, exponent] = sides.as_ref();
                if exponent.varies {
                    varying_power(of(base), of(exponent), base.varies)
                } else {
                    fixed_power(of(base), exponent.evaluate::<T, T>(time, sided, &[]))
                }
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

/// Largest integer exponent for which a power is computed by multiplication.
pub const LARGEST_MULTIPLIED: u32 = 8;

/// x^e: by multiplication for small integer exponents, as in the written-out formula and without rounding
/// where possible; otherwise from `libm`. Negative bases need integer exponents.
pub fn power<T: Elementary>(x: T, exponent: T) -> T {
    let mut whole = 0;
    let mut count = T::zero();
    let magnitude = exponent.abs();
    while whole < LARGEST_MULTIPLIED && count < magnitude {
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
