//! What a parameter changes in the equations of a mechanism at a fixed motion.

use super::explicit::Direct;
use crate::model::damped_coordinates;
use crate::model::tape::CompiledFunction;
use fvi_core::Instant;
use fvi_scenario::language::expression::{Expression, Moment};
use fvi_scenario::scenario::{Quantity, Scenario};

/// ∂_θ of L_v, L_q + F, c, C and G.
pub(super) struct Explicit {
    /// Of −F and the gradients of potentials.
    forces: Vec<Direct>,
    /// Places of ∂M.
    mass: Vec<(usize, usize)>,
    kinetic: Option<Beside>,
    /// Constraints and elongations, each with its index.
    constraints: Vec<(usize, Beside)>,
    elongations: Vec<(usize, Beside)>,
}

/// An expression with the parameter as its last variable.
struct Beside {
    function: CompiledFunction<f64>,
    point: Vec<f64>,
    gradient: Vec<f64>,
    hessian: Vec<f64>,
    registers: Vec<f64>,
}

impl Beside {
    fn new(expression: &Expression, variables: usize, value: f64) -> Self {
        let function = CompiledFunction::compile(expression, variables + 1);
        let mut point = vec![0.0; variables + 1];
        point[variables] = value;
        let hessian = vec![0.0; function.pattern().len()];
        Self { function, gradient: point.clone(), point, hessian, registers: Vec::new() }
    }

    /// ∂f/∂θ; hands out ∂²f/∂x_i∂θ.
    fn at(&mut self, numbers: &[&[f64]], mut take: impl FnMut(usize, f64)) -> f64 {
        let places = self.point.iter_mut().zip(numbers.iter().copied().flatten());
        places.for_each(|(place, &number)| *place = number);
        let Self { function, point, gradient, hessian, registers } = self;
        function.derivatives(Moment::inside(0.0), point, registers, gradient, hessian);
        let last = point.len() - 1;
        for (&(row, column), &entry) in function.pattern().iter().zip(&*hessian) {
            // The last row of the lower triangle.
            if row as usize == last && (column as usize) < last {
                take(column as usize, entry);
            }
        }
        gradient[last]
    }
}

impl Explicit {
    pub(super) fn new(scenario: &Scenario, what: &Quantity) -> Self {
        let count = scenario.coordinates();
        let mut made = Self {
            forces: Vec::new(),
            mass: Vec::new(),
            kinetic: None,
            constraints: Vec::new(),
            elongations: Vec::new(),
        };
        match what {
            &Quantity::Mass(row, column) => made.mass = super::mirrored(row, column),
            Quantity::Stiffness(..) => made.forces = Direct::all(scenario, what),
            Quantity::Named(named) => {
                // Springs of kernels are parts of their dampers.
                let mut undamped = scenario.clone();
                undamped.system.damping.clear();
                made.forces = Direct::all(&undamped, what);
                let of_position = |(index, expression): &(usize, Expression)| {
                    (*index, Beside::new(expression, count, named.value))
                };
                let kinetic = named.kinetic.as_ref();
                made.kinetic = kinetic.map(|kinetic| Beside::new(kinetic, 2 * count, named.value));
                made.constraints = named.constraints.iter().map(of_position).collect();
                let places = places(scenario);
                made.elongations = named.elongations.iter().map(of_position).collect();
                made.elongations.iter_mut().for_each(|(index, _)| *index = places[*index]);
            }
            _ => {}
        }
        made
    }

    /// Adds `factor` ∂_θL_v.
    pub(super) fn add_momentum(&mut self, factor: f64, position: &[f64], velocity: &[f64], out: &mut [f64]) {
        self.mass.iter().for_each(|&(row, column)| out[row] += factor * velocity[column]);
        if let Some(kinetic) = &mut self.kinetic {
            let count = position.len();
            kinetic.at(&[position, velocity], |index, entry| {
                if let Some(row) = index.checked_sub(count) {
                    out[row] += factor * entry;
                }
            });
        }
    }

    /// Adds ∂_θ(L_q + F).
    pub(super) fn add_force(
        &mut self,
        instant: Instant<f64>,
        position: &[f64],
        velocity: &[f64],
        out: &mut [f64],
    ) {
        let mut restoring = vec![0.0; out.len()];
        for direct in &mut self.forces {
            direct.add(instant, (position, velocity), &mut restoring);
        }
        out.iter_mut().zip(&restoring).for_each(|(out, restoring)| *out -= restoring);
        if let Some(kinetic) = &mut self.kinetic {
            kinetic.at(&[position, velocity], |index, entry| {
                if let Some(place) = out.get_mut(index) {
                    *place += entry;
                }
            });
        }
    }

    /// Adds ∂_θc and ∂_θC.
    pub(super) fn constrain(&mut self, position: &[f64], values: &mut [f64], jacobian: &mut [f64]) {
        let count = position.len();
        for (row, constraint) in &mut self.constraints {
            let slope = constraint.at(&[position], |index, entry| jacobian[*row * count + index] += entry);
            values[*row] += slope;
        }
    }

    /// Adds ∂_θG.
    pub(super) fn elongate(&mut self, position: &[f64], jacobian: &mut [f64]) {
        let count = position.len();
        for (row, elongation) in &mut self.elongations {
            elongation.at(&[position], |index, entry| jacobian[*row * count + index] += entry);
        }
    }
}

/// The index among all elongations, those along coordinates included, of each that is an expression.
fn places(scenario: &Scenario) -> Vec<usize> {
    let (mut first, mut places) = (0, Vec::new());
    for term in &scenario.system.damping {
        let count = match &term.along {
            Some(along) => {
                places.extend(first..first + along.elongations.len());
                along.elongations.len()
            }
            None => damped_coordinates(scenario, term).len(),
        };
        first += count;
    }
    places
}
