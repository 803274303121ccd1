//! Explicit dependence of the forces on a parameter: ∂G/∂θ with G = ∇U − F at a fixed position.

use crate::model::tape::{CompiledForce, CompiledPotential};
use crate::model::{matrix, moment};
use fvi_core::{Block, Instant};
use fvi_scenario::scenario::{Derivative, Named, Quantity, Scenario};
use nalgebra::SVector;

/// A part of ∂G/∂θ of one parameter.
pub(in crate::simulation) enum Direct {
    /// For entries of K, with their mirror images.
    Entries(Vec<(usize, usize, f64)>),
    /// ∂(ρ K(0)) (q − q*) for a kernel with a spring.
    Spring {
        entries: Vec<(usize, usize, f64)>,
        rest: Vec<f64>,
    },
    /// Force of the springs of kernels, if the parameter is their rest position.
    Constant(Vec<f64>),
    Expressions(Box<Expressions>),
}

/// For a constant of expressions.
pub(in crate::simulation) struct Expressions {
    value: f64,
    potential: Option<CompiledPotential<f64>>,
    force: Option<CompiledForce<f64>>,
    /// True if the force depends on the velocity.
    moves: bool,
    elements: Vec<(CompiledPotential<f64>, Vec<Vec<usize>>)>,
    loads: Vec<(fvi_scenario::language::expression::Expression, Vec<(u32, f64)>)>,
    room: Buffers,
}

/// Buffers.
#[derive(Default)]
struct Buffers {
    registers: Vec<f64>,
    point: Vec<f64>,
    gradient: Vec<f64>,
    second: Vec<f64>,
}

impl Buffers {
    /// Copies numbers, followed by the constant, to the point.
    fn begin(&mut self, numbers: impl Iterator<Item = f64>, constant: f64) {
        self.point.clear();
        self.point.extend(numbers.chain(std::iter::once(constant)));
    }

    /// Zeros a gradient and `second` second derivatives.
    fn derivatives(&mut self, second: usize) {
        self.gradient.clear();
        self.gradient.resize(self.point.len(), 0.0);
        self.second.clear();
        self.second.resize(second, 0.0);
    }
}

impl Direct {
    /// All parts of ∂G/∂θ of a parameter.
    pub(in crate::simulation) fn all(scenario: &Scenario, what: &Quantity) -> Vec<Self> {
        let mut parts = Self::beside_expressions(scenario, what);
        if let Quantity::Named(named) = what {
            parts.push(Self::Expressions(Box::new(Expressions::new(scenario, named))));
        }
        parts
    }

    /// Those besides derivatives of expressions.
    pub(in crate::simulation) fn beside_expressions(scenario: &Scenario, what: &Quantity) -> Vec<Self> {
        let damping = &scenario.system.damping;
        let size = scenario.coordinates();
        // Rest position of the spring of a term.
        let rest = |term: usize| match damping[term].derivative {
            Derivative::Caputo => scenario.initial.base().to_vec(),
            Derivative::RiemannLiouville => vec![0.0; size],
        };
        let mut parts = Vec::new();
        match what {
            &Quantity::Stiffness(row, column) => {
                let mirrored = (row != column).then_some((column, row, 1.0));
                parts.push(Self::Entries(std::iter::once((row, column, 1.0)).chain(mirrored).collect()));
            }
            Quantity::Coefficient(term, change) if damping[*term].transfer.spring() != 0.0 => {
                let spring = damping[*term].transfer.spring();
                let entries = change.iter().map(|&(row, column, entry)| (row, column, spring * entry));
                parts.push(Self::Spring { entries: entries.collect(), rest: rest(*term) });
            }
            // Position at which the motion of the memories begins.
            &Quantity::Position(index) | &Quantity::Past(0, index)
                if scenario.initial.past.is_none() || !matches!(what, Quantity::Position(_)) =>
            {
                let mut restoring = vec![0.0; size];
                let mut one = vec![0.0; size];
                one[index] = 1.0;
                for term in damping.iter().filter(|term| term.derivative == Derivative::Caputo) {
                    matrix::<f64>(&term.coefficient).multiply_add(
                        -term.transfer.spring(),
                        &one,
                        &mut restoring,
                    );
                }
                if restoring.iter().any(|&x| x != 0.0) {
                    parts.push(Self::Constant(restoring));
                }
            }
            _ => {}
        }
        for (term, spring) in (0..damping.len()).filter_map(|term| Some((term, what.kernel(term)?.spring())))
        {
            if spring != 0.0 {
                let entries = matrix::<f64>(&damping[term].coefficient).entries().into_iter();
                let entries = entries.map(|(row, column, entry)| (row, column, spring * entry));
                parts.push(Self::Spring { entries: entries.collect(), rest: rest(term) });
            }
        }
        parts
    }

    /// Adds ∂G/∂θ at an instant, a position and a velocity.
    pub(super) fn add(
        &mut self,
        instant: Instant<f64>,
        (position, velocity): (&[f64], &[f64]),
        out: &mut [f64],
    ) {
        match self {
            Self::Entries(entries) => {
                entries.iter().for_each(|&(row, column, entry)| out[row] += entry * position[column]);
            }
            Self::Spring { entries, rest } => {
                for &(row, column, entry) in &*entries {
                    out[row] += entry * (position[column] - rest[column]);
                }
            }
            Self::Constant(restoring) => {
                out.iter_mut().zip(restoring).for_each(|(out, restoring)| *out += *restoring)
            }
            Self::Expressions(expressions) => {
                expressions
                    .visit(instant, (position, velocity), |coordinate, entry| out[coordinate] += entry);
            }
        }
    }

    /// λ·∂G/∂θ at an instant, a position and a velocity.
    pub(in crate::simulation) fn weighted(
        &mut self,
        instant: Instant<f64>,
        (position, velocity): (&[f64], &[f64]),
        by: &[f64],
    ) -> f64 {
        match self {
            Self::Entries(entries) => {
                entries.iter().map(|&(row, column, entry)| by[row] * entry * position[column]).sum()
            }
            Self::Spring { entries, rest } => (entries.iter())
                .map(|&(row, column, entry)| by[row] * entry * (position[column] - rest[column]))
                .sum(),
            Self::Constant(restoring) => by.iter().zip(&*restoring).map(|(by, force)| by * force).sum(),
            Self::Expressions(expressions) => {
                let mut sum = 0.0;
                expressions.visit(instant, (position, velocity), |coordinate, entry| {
                    sum += by[coordinate] * entry;
                });
                sum
            }
        }
    }
}

impl Expressions {
    fn new(scenario: &Scenario, named: &Named) -> Self {
        let size = scenario.coordinates();
        let system = &scenario.system;
        let moves = system.force_in_words_depends_on_velocity();
        let variables = if moves { 2 * size } else { size };
        let force = named.force.as_ref().map(|components| {
            // One more variable, after those of the force.
            CompiledForce::compile_of(components, variables + 1)
        });
        let elements = named.elements.iter().map(|(group, potential)| {
            let coordinates = system.elements[*group].coordinates.clone();
            let width = coordinates.first().map_or(0, Vec::len);
            (CompiledPotential::compile(potential, width + 1), coordinates)
        });
        let loads = named
            .loads
            .iter()
            .map(|(load, amplitude)| (amplitude.clone(), system.loads[*load].pattern.entries.to_vec()));
        Self {
            value: named.value,
            potential: named.potential.as_ref().map(|u| CompiledPotential::compile(u, size + 1)),
            force,
            moves,
            elements: elements.collect(),
            loads: loads.collect(),
            room: Buffers::default(),
        }
    }

    /// Hands on the entries of ∂G/∂θ, those of a coordinate added: its index and a number.
    fn visit(
        &mut self,
        instant: Instant<f64>,
        (position, velocity): (&[f64], &[f64]),
        mut take: impl FnMut(usize, f64),
    ) {
        let Self { value, potential, force, moves, elements, loads, room } = self;
        if let Some(potential) = potential {
            room.begin(position.iter().copied(), *value);
            mixed(potential, room, &mut take);
        }
        for (potential, places) in elements {
            for place in places {
                room.begin(place.iter().map(|&coordinate| position[coordinate]), *value);
                mixed(potential, room, |index, entry| take(place[index], entry));
            }
        }
        if let Some(force) = force {
            let velocity = if *moves { velocity } else { &[] };
            room.begin(position.iter().chain(velocity).copied(), *value);
            let last = (position.len() + velocity.len()) as u32;
            room.derivatives(force.pattern().len());
            let Buffers { registers, point, gradient, second } = room;
            force.derivatives(moment(instant), point, registers, gradient, second);
            let constant = force.linear().iter().map(|&(row, column, entry)| (row, column, entry));
            let changing =
                force.pattern().iter().zip(&*second).map(|(&(row, column), &entry)| (row, column, entry));
            for (row, _, entry) in constant.chain(changing).filter(|&(_, column, _)| column == last) {
                take(row as usize, -entry);
            }
        }
        for (amplitude, pattern) in loads {
            let (_, slope) = amplitude.gradient::<f64, 1>(moment(instant), &SVector::from([*value]));
            pattern.iter().for_each(|&(coordinate, entry)| take(coordinate as usize, -entry * slope[0]));
        }
    }
}

/// ∂²U/∂x_i∂θ at the point in the buffer, where θ is the last variable.
fn mixed(potential: &CompiledPotential<f64>, room: &mut Buffers, mut take: impl FnMut(usize, f64)) {
    room.derivatives(potential.pattern().len());
    let Buffers { registers, point, gradient, second } = room;
    let last = point.len() - 1;
    potential.derivatives(point, registers, gradient, second);
    let constant = potential.quadratic().stiffness.iter().copied();
    let changing =
        potential.pattern().iter().zip(&*second).map(|(&(row, column), &entry)| (row, column, entry));
    for (row, column, entry) in constant.chain(changing) {
        // The last row of the lower triangle.
        if row as usize == last && (column as usize) < last {
            take(column as usize, entry);
        }
    }
}
