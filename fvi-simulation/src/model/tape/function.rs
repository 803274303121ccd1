//! Compiled functions of t and of any variables, without splitting.

use super::derivative::{Entry, Order};
use super::graph::Graph;
use super::program::Program;
use super::sides::{CompiledSides, SideArguments};
use fvi_scenario::language::expression::{Elementary, Expression, Kind, Moment, Node, Operator};

/// f(t, x) with programs for its value and its first two derivatives in x.
///
/// Every number has the same bits as in the evaluation of the expression tree.
#[derive(Clone, Debug)]
pub struct CompiledFunction<T> {
    value: Program<T>,
    differentiated: Differentiated<T>,
}

impl<T: Elementary> CompiledFunction<T> {
    /// Compiles an expression in `variables` variables.
    pub fn compile(expression: &Expression, variables: usize) -> Self {
        Self {
            value: value(expression, variables),
            differentiated: Differentiated::new(expression.root(), variables),
        }
    }

    /// (row, column) of the structurally nonzero entries of the Hessian: lower triangle with the diagonal,
    /// row by row.
    pub fn pattern(&self) -> &[(u32, u32)] {
        &self.differentiated.pattern
    }

    /// f(t, x).
    pub fn value(&self, moment: Moment<T>, variables: &[T], registers: &mut Vec<T>) -> T {
        let mut value = [T::zero()];
        self.value.evaluate(moment, variables, registers, &mut value, &mut []);
        value[0]
    }

    /// Writes ∂f/∂x.
    pub fn gradient(&self, moment: Moment<T>, variables: &[T], registers: &mut Vec<T>, gradient: &mut [T]) {
        gradient.fill(T::zero());
        self.differentiated.gradient.evaluate(moment, variables, registers, gradient, &mut []);
    }

    /// Writes ∂f/∂x and the entries of ∂²f/∂x² in the order of [`pattern`](Self::pattern).
    pub fn derivatives(
        &self,
        moment: Moment<T>,
        variables: &[T],
        registers: &mut Vec<T>,
        gradient: &mut [T],
        hessian: &mut [T],
    ) {
        gradient.fill(T::zero());
        self.differentiated.derivatives.evaluate(moment, variables, registers, gradient, hessian);
    }
}

/// The program of a value alone.
pub(super) fn value<T: Elementary>(expression: &Expression, variables: usize) -> Program<T> {
    // When the program adds the terms of a sum itself, in the same order, the terms are independent of each
    // other.
    if let Kind::Chain(first, operands) = expression.root().kind()
        && operands.iter().all(|(operator, _)| operator.is_additive())
    {
        let mut graph = Graph::default();
        let mut terms = vec![(0, graph.differentiate(first, Order::Value).value)];
        for (operator, operand) in operands {
            let value = graph.differentiate(operand, Order::Value).value;
            terms.push((0, if *operator == Operator::Subtract { graph.negate(value) } else { value }));
        }
        let program = Program::new(&graph, variables, &terms, &[]);
        if program.keeps_the_order_of_sums() {
            return program;
        }
    }
    let mut graph = Graph::default();
    let value = graph.differentiate(expression.root(), Order::Value).value;
    Program::new(&graph, variables, &[(0, value)], &[])
}

/// Programs that add a gradient; the second also computes the entries of the Hessian.
#[derive(Clone, Debug)]
pub(super) struct Differentiated<T> {
    pub(super) pattern: Vec<Entry>,
    pub(super) gradient: Program<T>,
    pub(super) derivatives: Program<T>,
}

impl<T: Elementary> Differentiated<T> {
    pub(super) fn new(node: &Node, variables: usize) -> Self {
        let mut graph = Graph::default();
        let function = graph.differentiate(node, Order::Hessian);
        let gradient = Program::new(&graph, variables, &function.gradient, &[]);
        let (pattern, values): (Vec<_>, Vec<_>) = function.hessian.into_iter().unzip();
        let entries: Vec<_> = (0..).zip(values).collect();
        let derivatives = Program::new(&graph, variables, &function.gradient, &entries);
        Self { pattern, gradient, derivatives }
    }

    /// As [`new`](Self::new), with the sides of jumps and kinks as inputs after the variables, and with the
    /// program of the value; `None` if there are no jumps and kinks.
    pub(super) fn sided(
        node: &Node,
        (variables, letter): (usize, char),
    ) -> Option<(Self, Program<T>, CompiledSides)> {
        let (mut graph, mut sides) = (Graph::default(), SideArguments::new(variables, letter));
        let function = graph.differentiate_sided(node, Order::Hessian, &mut sides);
        let inputs = sides.inputs_in_all();
        let sides = sides.compile(&graph)?;
        let value = Program::new(&graph, inputs, &[(0, function.value)], &[]);
        let gradient = Program::new(&graph, inputs, &function.gradient, &[]);
        let (pattern, values): (Vec<_>, Vec<_>) = function.hessian.into_iter().unzip();
        let entries: Vec<_> = (0..).zip(values).collect();
        let derivatives = Program::new(&graph, inputs, &function.gradient, &entries);
        Some((Self { pattern, gradient, derivatives }, value, sides))
    }
}
