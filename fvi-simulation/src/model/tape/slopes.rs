//! Weighted derivatives of forces by many constants at once.

use super::derivative::{ALONG, Order};
use super::graph::{Graph, Origin, Value};
use super::program::Program;
use fvi_scenario::language::expression::{Elementary, Expression, Moment};

/// ∂φ/∂θ of φ = Σ_i λ_i G_i(t, x, θ) by all of θ, for forces G = ∇U or G = −F: as one program, in which every
/// distinct value is computed once. Its variables are x, θ and λ.
#[derive(Clone, Debug)]
pub struct CompiledSlopes<T> {
    program: Program<T>,
}

impl<T: Elementary> CompiledSlopes<T> {
    /// For U in `width` variables, followed by the constants: λ has `width` components.
    pub fn of_potential(potential: &Expression, [width, constants]: [usize; 2]) -> Self {
        let mut graph = Graph::default();
        let (first, count) = (index(width), index(constants));
        let along = graph.differentiate_along(potential.root(), [first, count]).hessian;
        let by_constant = along.into_iter().filter(|((row, _), _)| *row == ALONG);
        let sums: Vec<(u32, Value)> =
            by_constant.map(|((_, column), entry)| (column - first, entry)).collect();
        Self { program: Program::new(&graph, 2 * width + constants, &sums, &[]) }
    }

    /// For the components of F in `width` variables, followed by the constants: λ has a number for each
    /// component.
    pub fn of_force(components: &[Expression], [width, constants]: [usize; 2]) -> Self {
        let mut graph = Graph::default();
        let (first, last) = (index(width), index(width + constants));
        let mut sums = Vec::new();
        for (row, component) in (0..).zip(components) {
            let weight = graph.insert(Origin::Variable(last + row));
            for (column, slope) in graph.differentiate(component.root(), Order::Gradient).gradient {
                if (first..last).contains(&column) {
                    let weighted = graph.scale(slope, weight);
                    sums.push((column - first, graph.negate(weighted)));
                }
            }
        }
        sums.sort_by_key(|&(constant, _)| constant);
        Self { program: Program::new(&graph, width + constants + components.len(), &sums, &[]) }
    }

    /// Adds ∂φ/∂θ at x, θ and λ.
    pub fn add(&self, moment: Moment<T>, point: &[T], registers: &mut Vec<T>, sums: &mut [T]) {
        self.program.evaluate(moment, point, registers, sums, &mut []);
    }
}

fn index(count: usize) -> u32 {
    u32::try_from(count).expect("fewer than 2³² variables fit into the memory")
}
