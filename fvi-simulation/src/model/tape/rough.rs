//! Rough points of the part of a force that depends on time alone: jumps, kinks and roots in its expressions.

use super::derivative::Order;
use super::enclosure::Enclosure;
use super::force::{Parts, parts};
use super::graph::Graph;
use super::program::Program;
use fvi_scenario::language::expression::{Expression, Function, Kind, Moment, Node, Operator};

/// The arguments at whose zeros a force of time is rough.
#[derive(Clone, Debug)]
pub struct RoughArguments {
    arguments: Vec<RoughArgument>,
    nodes: Vec<Node>,
    values: Program<f64>,
}

/// Zeros of an argument closer than this fraction of the searched range, 10⁻¹⁰, may be found as one.
const CLOSEST: f64 = 1.0 / (1_u64 << 33) as f64;

/// Largest number of enclosures in a search.
const MOST_LOOKS: usize = 16_384;

/// Number of halvings of the range to reach a zero.
const HALVINGS: i32 = 63;

/// An argument at whose zeros a force is rough.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoughArgument {
    /// Its zero, if it is linear in t.
    pub zero: Option<f64>,
    /// True if it is under a root, a logarithm or a power with a noninteger exponent, with which the force is
    /// rough near the zero too and not only across it.
    pub root: bool,
}

impl RoughArguments {
    /// The arguments of a force with one expression for each coordinate; empty if it is smooth.
    pub fn of(components: &[Expression]) -> Self {
        let mut found = Vec::new();
        for component in components {
            if let Parts::Affine { of_time: Some(node), .. } = parts(component.root()) {
                collect(&node, &mut found);
            }
        }
        Self::compile(found)
    }

    /// All arguments that depend on time alone, at any depth of these expressions; `None` if there are none.
    pub fn anywhere_in<'e>(expressions: impl IntoIterator<Item = &'e Expression>) -> Option<Self> {
        let mut found = Vec::new();
        for expression in expressions {
            collect(expression.root(), &mut found);
        }
        found.retain(|(node, _)| !node.varies());
        Some(Self::compile(found)).filter(|found| !found.arguments.is_empty())
    }

    fn compile(mut found: Vec<(Node, bool)>) -> Self {
        // An argument that does not depend on time vanishes always or never.
        found.retain(|(node, _)| linear(node).is_none_or(|[_, slope]| slope != 0.0));
        let mut graph = Graph::default();
        let values: Vec<_> = (0..)
            .zip(&found)
            .map(|(place, (node, _))| (place, graph.differentiate(node, Order::Value).value))
            .collect();
        let argument = |(node, root): &(Node, bool)| {
            let zero = linear(node).map(|[offset, slope]| -offset / slope);
            RoughArgument { zero, root: *root }
        };
        Self {
            arguments: found.iter().map(argument).collect(),
            nodes: found.iter().map(|(node, _)| node.clone()).collect(),
            values: Program::new(&graph, 0, &values, &[]),
        }
    }

    /// The arguments, in the order of their values.
    pub fn arguments(&self) -> &[RoughArgument] {
        &self.arguments
    }

    /// True if an argument has a constant sign over the range, or is zero.
    pub fn keeps_sign(&self, index: usize, from: f64, to: f64) -> bool {
        let found = Enclosure::centred(&self.nodes[index], from, to);
        !found.value.contains_zero() || found.slope.is_zero()
    }

    /// Calls `found` with each place, as a fraction of the range of time from `start`, where an argument
    /// changes its sign (`true`), or where one under a root may touch zero (`false`), in ascending order
    /// until `found` returns `false`.
    ///
    /// The range is halved until in each part the argument has no zero, or at most one because it is
    /// monotonic, both by the bounds of interval arithmetic, or the part is negligibly short.
    ///
    /// # Errors
    /// The time up to which all are known, if the search exceeds its limit.
    pub fn changes(
        &self,
        index: usize,
        (start, length): (f64, f64),
        (registers, values): (&mut Vec<f64>, &mut [f64]),
        mut found: impl FnMut(f64, bool) -> bool,
    ) -> Result<(), f64> {
        let node = &self.nodes[index];
        let at = |place: f64| start + place * length;
        let mut negative = |place: f64| {
            self.values(at(place), registers, values);
            values[index] < 0.0
        };
        let mut parts = vec![(0.0_f64, 1.0_f64, 0)];
        let mut looks = 0;
        while let Some((mut low, mut high, depth)) = parts.pop() {
            looks += 1;
            if looks > MOST_LOOKS {
                return Err(at(low));
            }
            let bounds = Enclosure::centred(node, at(low), at(high));
            if !bounds.value.contains_zero() || bounds.slope.is_zero() {
                continue;
            }
            let is_shortest = high - low <= CLOSEST || at(high) <= at(low).next_up();
            if bounds.slope.contains_zero() && !is_shortest {
                let middle = 0.5 * (low + high);
                parts.push((middle, high, depth + 1));
                parts.push((low, middle, depth + 1));
                continue;
            }
            let before = negative(low);
            let changes = before != negative(high);
            if changes {
                for _ in depth..HALVINGS {
                    let middle = 0.5 * (low + high);
                    if negative(middle) == before { low = middle } else { high = middle }
                }
            } else if !(is_shortest && self.arguments[index].root) {
                continue;
            }
            if !found(0.5 * (low + high), changes) {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Writes the values of the arguments at a time.
    pub fn values(&self, time: f64, registers: &mut Vec<f64>, values: &mut [f64]) {
        values.fill(0.0);
        self.values.evaluate(Moment::inside(time), &[], registers, values, &mut []);
    }
}

/// Adds the arguments in a node, each with whether it is under a root.
fn collect(node: &Node, found: &mut Vec<(Node, bool)>) {
    match node.kind() {
        Kind::Number(_) | Kind::Time | Kind::SidedTime | Kind::Variable(_) => {}
        Kind::Negation(inner) => collect(inner, found),
        Kind::Chain(first, operands) => {
            collect(first, found);
            operands.iter().for_each(|(_, operand)| collect(operand, found));
        }
        Kind::Power(sides) => {
            let [base, exponent] = sides.as_ref();
            collect(base, found);
            collect(exponent, found);
            // Integer powers are smooth, and a function that grows like 1/t is not integrable.
            let rough =
                exponent.as_number().is_none_or(|exponent| exponent > -1.0 && exponent.fract() != 0.0);
            if rough {
                found.push((base.clone(), true));
            }
        }
        Kind::Call(function, argument) => {
            collect(argument, found);
            match function {
                Function::Step | Function::Sign | Function::Abs => found.push(((**argument).clone(), false)),
                Function::Sqrt | Function::Log => found.push(((**argument).clone(), true)),
                _ => {}
            }
        }
        Kind::Choice(function, sides) => {
            let [left, right] = sides.as_ref();
            collect(left, found);
            collect(right, found);
            if function.selects() {
                found.push((Node::join(Operator::Subtract, left.clone(), right.clone()), false));
            }
        }
    }
}

/// (a, b) if the node is a + b t.
pub(super) fn linear(node: &Node) -> Option<[f64; 2]> {
    match node.kind() {
        Kind::Number(value) => Some([*value, 0.0]),
        Kind::Time | Kind::SidedTime => Some([0.0, 1.0]),
        Kind::Negation(inner) => linear(inner).map(|[a, b]| [-a, -b]),
        Kind::Chain(first, operands) => {
            operands.iter().try_fold(linear(first)?, |[a, b], (operator, operand)| {
                let [c, d] = linear(operand)?;
                match operator {
                    Operator::Add => Some([a + c, b + d]),
                    Operator::Subtract => Some([a - c, b - d]),
                    Operator::Multiply if d == 0.0 => Some([a * c, b * c]),
                    Operator::Multiply if b == 0.0 => Some([a * c, a * d]),
                    Operator::Divide if d == 0.0 => Some([a / c, b / c]),
                    Operator::Multiply | Operator::Divide => None,
                }
            })
        }
        _ => None,
    }
}
