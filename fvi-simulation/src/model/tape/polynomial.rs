//! The quadratic polynomial in an expression, split off exactly.

use fvi_scenario::language::expression::{Kind, Node, Operator};
use std::collections::BTreeMap;

/// constant + Σ linear_i q_i + Σ_{i ≥ j} quadratic_ij q_i q_j.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Polynomial {
    pub(super) constant: f64,
    pub(super) linear: BTreeMap<u32, f64>,
    pub(super) quadratic: BTreeMap<(u32, u32), f64>,
}

impl Polynomial {
    /// The polynomial of a part, if it is a polynomial of degree two or less with constant coefficients.
    pub(super) fn of(node: &Node) -> Option<Self> {
        match node.kind() {
            Kind::Number(number) => Some(Self::number(*number)),
            Kind::Variable(index) => {
                let linear = BTreeMap::from([(u32::try_from(*index).ok()?, 1.0)]);
                Some(Self { linear, ..Self::default() })
            }
            Kind::Negation(inner) => Some(Self::of(inner)?.mapped(|x| -x)),
            Kind::Chain(first, operands) => {
                operands.iter().try_fold(Self::of(first)?, |joined, (operator, operand)| {
                    let operand = Self::of(operand)?;
                    match operator {
                        Operator::Add => Some(joined.plus(operand)),
                        Operator::Subtract => Some(joined.plus(operand.mapped(|x| -x))),
                        Operator::Multiply => joined.times(&operand),
                        Operator::Divide => {
                            let divisor = operand.as_number()?;
                            Some(joined.mapped(|x| x / divisor))
                        }
                    }
                })
            }
            Kind::Power(sides) => {
                let [base, exponent] = sides.as_ref();
                match exponent.as_number() {
                    Some(1.0) => Self::of(base),
                    Some(2.0) => {
                        let base = Self::of(base)?;
                        base.clone().times(&base)
                    }
                    _ => None,
                }
            }
            Kind::Time | Kind::SidedTime | Kind::Call(..) | Kind::Choice(..) => None,
        }
    }

    fn number(constant: f64) -> Self {
        Self { constant, ..Self::default() }
    }

    fn as_number(&self) -> Option<f64> {
        (self.degree() == 0).then_some(self.constant)
    }

    pub(super) fn degree(&self) -> usize {
        if !self.quadratic.is_empty() { 2 } else { usize::from(!self.linear.is_empty()) }
    }

    /// True if all coefficients are finite; those of a product may overflow.
    pub(super) fn is_finite(&self) -> bool {
        self.constant.is_finite()
            && self.linear.values().all(|x| x.is_finite())
            && self.quadratic.values().all(|x| x.is_finite())
    }

    pub(super) fn mapped(mut self, change: impl Fn(f64) -> f64) -> Self {
        self.constant = change(self.constant);
        self.linear.values_mut().for_each(|x| *x = change(*x));
        self.quadratic.values_mut().for_each(|x| *x = change(*x));
        self
    }

    pub(super) fn plus(mut self, other: Self) -> Self {
        self.constant += other.constant;
        add(&mut self.linear, other.linear);
        add(&mut self.quadratic, other.quadratic);
        self
    }

    fn times(self, other: &Self) -> Option<Self> {
        if let Some(factor) = other.as_number() {
            return Some(self.mapped(|x| x * factor));
        }
        if let Some(factor) = self.as_number() {
            return Some(other.clone().mapped(|x| factor * x));
        }
        if self.degree() + other.degree() > 2 {
            return None;
        }
        let mut product = Self::number(self.constant * other.constant);
        add(&mut product.linear, self.linear.iter().map(|(&i, x)| (i, x * other.constant)));
        add(&mut product.linear, other.linear.iter().map(|(&i, x)| (i, x * self.constant)));
        for (&i, x) in &self.linear {
            add(&mut product.quadratic, other.linear.iter().map(|(&j, y)| ((i.max(j), i.min(j)), x * y)));
        }
        Some(product)
    }
}

fn add<K: Ord>(to: &mut BTreeMap<K, f64>, terms: impl IntoIterator<Item = (K, f64)>) {
    for (key, term) in terms {
        *to.entry(key).or_insert(0.0) += term;
    }
}

/// A part as the sum of a polynomial and a remainder.
///
/// Polynomial terms of a sum, also of a sum multiplied by numbers, go to the polynomial; if there is a
/// remainder, constants stay with it, so that 1 − cos q0 is unchanged.
pub(super) fn split(node: &Node) -> (Polynomial, Option<Node>) {
    if let Some(polynomial) = Polynomial::of(node)
        && polynomial.is_finite()
    {
        return (polynomial, None);
    }
    let parts = match node.kind() {
        Kind::Negation(inner) => {
            let (polynomial, rest) = split(inner);
            rest.map(|rest| (polynomial.mapped(|x| -x), Node::negation(rest)))
        }
        Kind::Chain(first, operands) if operands.iter().any(|(operator, _)| operator.is_additive()) => {
            split_sum(first, operands)
        }
        Kind::Chain(first, operands) => split_product(first, operands),
        _ => None,
    };
    match parts {
        Some((polynomial, rest)) if polynomial.degree() > 0 && polynomial.is_finite() => {
            (polynomial, Some(rest))
        }
        _ => (Polynomial::default(), Some(node.clone())),
    }
}

fn split_sum(first: &Node, operands: &[(Operator, Node)]) -> Option<(Polynomial, Node)> {
    let mut sum = Polynomial::default();
    let mut remaining: Option<Node> = None;
    let terms = operands.iter().map(|(operator, term)| (*operator, term));
    for (operator, term) in core::iter::once((Operator::Add, first)).chain(terms) {
        let (polynomial, rest) = split(term);
        let rest = match rest {
            None if polynomial.degree() == 0 => Some(term.clone()),
            rest => {
                let negative = operator == Operator::Subtract;
                sum = sum.plus(polynomial.mapped(|x| if negative { -x } else { x }));
                rest
            }
        };
        remaining = match (remaining, rest, operator) {
            (remaining, None, _) => remaining,
            (None, Some(rest), Operator::Subtract) => Some(Node::negation(rest)),
            (None, Some(rest), _) => Some(rest),
            (Some(remaining), Some(rest), _) => Some(Node::join(operator, remaining, rest)),
        };
    }
    remaining.map(|rest| (sum, rest))
}

/// Splits a product of numbers and one other part that can be split.
fn split_product(first: &Node, operands: &[(Operator, Node)]) -> Option<(Polynomial, Node)> {
    let mut polynomial = Polynomial::default();
    let mut product: Option<Node> = None;
    let mut found = false;
    let factors = operands.iter().map(|(operator, factor)| (*operator, factor));
    for (operator, factor) in core::iter::once((Operator::Multiply, first)).chain(factors) {
        let scaled = match factor.as_number() {
            Some(number) if operator == Operator::Divide => polynomial.mapped(|x| x / number),
            Some(number) if found => polynomial.mapped(|x| x * number),
            Some(_) => polynomial,
            None if found || operator == Operator::Divide => return None,
            None => {
                found = true;
                let before = match &product {
                    Some(before) => before.as_number()?,
                    None => 1.0,
                };
                let (inner, rest) = split(factor);
                product = Some(match product {
                    Some(before) => Node::join(Operator::Multiply, before, rest?),
                    None => rest?,
                });
                polynomial = inner.mapped(|x| before * x);
                continue;
            }
        };
        polynomial = scaled;
        product = Some(match product {
            Some(before) => Node::join(operator, before, factor.clone()),
            None => factor.clone(),
        });
    }
    product.map(|rest| (polynomial, rest))
}
