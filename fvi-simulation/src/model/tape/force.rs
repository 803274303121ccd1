//! Compiled forces F(t, q).

use super::derivative::{Entry, Order};
use super::graph::Graph;
use super::polynomial::split;
use super::program::Program;
use super::sides::{CompiledSides, SideArguments};
use fvi_scenario::language::expression::{Elementary, Expression, Moment, Node};

/// A force as the sum of a constant, a matrix times q, a function of t alone and a remainder.
///
/// A component that depends on q linearly with constant coefficients has no remainder.
#[derive(Clone, Debug)]
pub struct CompiledForce<T> {
    constant: Vec<(u32, T)>,
    linear: Vec<(u32, u32, T)>,
    timed: Option<Program<T>>,
    rest: Option<Rest<T>>,
}

#[derive(Clone, Debug)]
struct Rest<T> {
    pattern: Vec<Entry>,
    depends_on_time: bool,
    value: Program<T>,
    derivatives: Program<T>,
}

impl<T: Elementary> CompiledForce<T> {
    /// Compiles F, one expression for each coordinate; an empty slice is a zero force.
    pub fn compile(components: &[Expression]) -> Self {
        Self::compile_of(components, variables(components))
    }

    /// As [`compile`](Self::compile), with `variables` variables: the coordinates, followed by velocities,
    /// with respect to which it is differentiated as well. Positions are then followed by velocities.
    pub fn compile_of(components: &[Expression], variables: usize) -> Self {
        let (mut force, rest) = Self::without_rest(components);
        force.rest = Rest::new(&rest, variables);
        force
    }

    /// As [`compile_of`](Self::compile_of), with the sides of jumps and kinks in the position as inputs, if
    /// there are any: positions then have two additional numbers for each after the variables.
    pub fn compile_sided(components: &[Expression], variables: usize) -> (Self, Option<CompiledSides>) {
        let (mut force, rest) = Self::without_rest(components);
        match Rest::sided(&rest, (components.len(), variables)) {
            Some((rest, sides)) => {
                force.rest = Some(rest);
                (force, Some(sides))
            }
            None => (Self::compile_of(components, variables), None),
        }
    }

    /// All parts except the remainder, and the components of the remainder.
    fn without_rest(components: &[Expression]) -> (Self, Vec<(u32, &Node)>) {
        let (mut constant, mut linear, mut timed, mut rest) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (row, component) in (0..).zip(components) {
            match parts(component.root()) {
                Parts::Affine { offset, slopes, of_time } => {
                    if offset != 0.0 {
                        constant.push((row, T::of(offset)));
                    }
                    let slopes = slopes.into_iter().filter(|&(_, slope)| slope != 0.0);
                    linear.extend(slopes.map(|(column, slope)| (row, column, T::of(slope))));
                    timed.extend(of_time.map(|node| (row, node)));
                }
                Parts::Nonlinear => rest.push((row, component.root())),
            }
        }
        (Self { constant, linear, timed: Self::timed(&timed), rest: None }, rest)
    }

    fn timed(components: &[(u32, Node)]) -> Option<Program<T>> {
        let mut graph = Graph::default();
        let values: Vec<_> = components
            .iter()
            .map(|(row, node)| (*row, graph.differentiate(node, Order::Value).value))
            .collect();
        (!values.is_empty()).then(|| Program::new(&graph, 0, &values, &[]))
    }

    /// True if there is no force at all.
    pub fn is_zero(&self) -> bool {
        self.is_constant() && self.constant.is_empty()
    }

    /// True if the force depends neither on the time nor on the position.
    pub fn is_constant(&self) -> bool {
        !self.depends_on_time() && !self.depends_on_position()
    }

    /// True if the force depends on the time.
    pub fn depends_on_time(&self) -> bool {
        self.timed.is_some() || self.rest.as_ref().is_some_and(|rest| rest.depends_on_time)
    }

    /// True if the force depends on the position.
    pub fn depends_on_position(&self) -> bool {
        !self.linear.is_empty() || self.rest.is_some()
    }

    /// True if its dependence on the position, if any, is a constant matrix: [`linear`](Self::linear).
    pub fn is_affine(&self) -> bool {
        self.rest.is_none()
    }

    /// (row, column, entry) of the constant part of ∂F/∂q, row by row.
    pub fn linear(&self) -> &[(u32, u32, T)] {
        &self.linear
    }

    /// (row, column) of the entries of ∂F/∂q besides the constant ones, row by row. The rows are not those of
    /// [`linear`](Self::linear).
    pub fn pattern(&self) -> &[(u32, u32)] {
        self.rest.as_ref().map_or(&[], |rest| &rest.pattern)
    }

    /// Writes F(t, q), of all parts together.
    pub fn value(&self, moment: Moment<T>, position: &[T], registers: &mut Vec<T>, force: &mut [T]) {
        self.affine(moment, position, registers, force);
        if let Some(rest) = &self.rest {
            rest.value.evaluate(moment, position, registers, force, &mut []);
        }
    }

    /// Writes F(t, q), of all parts together, and the entries of ∂F/∂q in the order of
    /// [`pattern`](Self::pattern).
    pub fn derivatives(
        &self,
        moment: Moment<T>,
        position: &[T],
        registers: &mut Vec<T>,
        force: &mut [T],
        jacobian: &mut [T],
    ) {
        self.affine(moment, position, registers, force);
        if let Some(rest) = &self.rest {
            rest.derivatives.evaluate(moment, position, registers, force, jacobian);
        }
    }

    /// Writes F without its remainder at q = 0: the constant and the function of t.
    pub fn load(&self, moment: Moment<T>, registers: &mut Vec<T>, force: &mut [T]) {
        force.fill(T::zero());
        for &(row, number) in &self.constant {
            force[row as usize] = number;
        }
        if let Some(timed) = &self.timed {
            timed.evaluate(moment, &[], registers, force, &mut []);
        }
    }

    fn affine(&self, moment: Moment<T>, position: &[T], registers: &mut Vec<T>, force: &mut [T]) {
        self.load(moment, registers, force);
        for &(row, column, slope) in &self.linear {
            force[row as usize] += slope * position[column as usize];
        }
    }
}

impl<T: Elementary> Rest<T> {
    fn new(components: &[(u32, &Node)], count: usize) -> Option<Self> {
        if components.is_empty() {
            return None;
        }
        let mut graph = Graph::default();
        let mut values = Vec::new();
        let mut slopes = Vec::new();
        for &(row, node) in components {
            let component = graph.differentiate(node, Order::Gradient);
            values.push((row, component.value));
            slopes.extend(component.gradient.into_iter().map(|(column, slope)| ((row, column), slope)));
        }
        let value = Program::new(&graph, count, &values, &[]);
        let (pattern, slopes): (Vec<_>, Vec<_>) = slopes.into_iter().unzip();
        let entries: Vec<_> = (0..).zip(slopes).collect();
        let derivatives = Program::new(&graph, count, &values, &entries);
        Some(Self { pattern, depends_on_time: graph.knows_time(), value, derivatives })
    }

    fn sided(
        components: &[(u32, &Node)],
        (coordinates, variables): (usize, usize),
    ) -> Option<(Self, CompiledSides)> {
        let mut graph = Graph::default();
        let mut sides = SideArguments::new(coordinates, 'q').with_variables(variables);
        let (mut values, mut slopes) = (Vec::new(), Vec::new());
        for &(row, node) in components {
            let component = graph.differentiate_sided(node, Order::Gradient, &mut sides);
            values.push((row, component.value));
            slopes.extend(component.gradient.into_iter().map(|(column, slope)| ((row, column), slope)));
        }
        let inputs = sides.inputs_in_all();
        let sides = sides.compile(&graph)?;
        let value = Program::new(&graph, inputs, &values, &[]);
        let (pattern, slopes): (Vec<_>, Vec<_>) = slopes.into_iter().unzip();
        let entries: Vec<_> = (0..).zip(slopes).collect();
        let derivatives = Program::new(&graph, inputs, &values, &entries);
        Some((Self { pattern, depends_on_time: graph.knows_time(), value, derivatives }, sides))
    }
}

/// The variables of a force: its coordinates, and as many velocities if it depends on any.
pub fn variables(components: &[Expression]) -> usize {
    let count = components.len();
    let moves = components.iter().any(|component| component.root().has_variable_from(count));
    if moves { 2 * count } else { count }
}

/// A component of a force, split by its dependence on time and position.
pub(super) enum Parts {
    Affine { offset: f64, slopes: Vec<(u32, f64)>, of_time: Option<Node> },
    Nonlinear,
}

/// Splits a component.
pub(super) fn parts(component: &Node) -> Parts {
    let (polynomial, rest) = split(component);
    if polynomial.degree() == 2 || rest.as_ref().is_some_and(Node::varies) {
        return Parts::Nonlinear;
    }
    let slopes = polynomial.linear.into_iter().collect();
    Parts::Affine { offset: polynomial.constant, slopes, of_time: rest }
}
