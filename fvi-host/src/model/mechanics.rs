//! The mechanics of a scenario: mass, compiled potential and force.

use super::force_moments::ForceMoments;
use super::own::Own;
use super::space::{Dense, Matrix, Pattern, Sparse};
use crate::language::expression::{Elementary, Moment};
use crate::model::tape::{CompiledForce, CompiledPotential};
use crate::scenario::{ForceQuadrature, Scenario, Scheme, SymmetricMatrix};
use fvi_core::{Approach, Block, Instant, MatrixError, Mechanics, NodalRule, Real, factor, invert_factored};
use std::sync::Arc;

/// M, U and F of a scenario, compiled once.
#[derive(Clone, Debug)]
pub struct Model<T> {
    mass: Matrix<T>,
    inverse_mass: Matrix<T>,
    potential: Option<CompiledPotential<T>>,
    /// K of the quadratic part ½ qᵀKq + bᵀq of the potential.
    quadratic: Matrix<T>,
    linear: Vec<(usize, T)>,
    force: CompiledForce<T>,
    /// Whether there is a force at all.
    forced: bool,
    /// Where the force is rough in time and its moments are taken exactly.
    moments: Option<ForceMoments>,
    /// What code supplies.
    own: Option<Own>,
    /// Values of the stiffness that never change, by slot.
    constant: Sparse<T>,
    /// Slots of the entries of the potential's Hessian, and of their mirror images.
    hessian_slots: Vec<(usize, usize)>,
    /// Slots of the entries of the force's Jacobian.
    jacobian_slots: Vec<usize>,
    registers: Vec<T>,
    /// N numbers.
    pushed: Vec<T>,
    /// Entries of a Hessian or Jacobian.
    entries: Vec<T>,
}

impl<T: Elementary> Model<T> {
    /// Compiles the system of a scenario.
    ///
    /// # Errors
    /// If the mass is not positive definite in the precision of `T`.
    pub fn new(scenario: &Scenario) -> Result<Self, MatrixError> {
        let system = &scenario.system;
        let size = system.coordinates();
        let mass = matrix(&system.mass);
        let inverse_mass = inverse(&mass, size)?;
        let potential = system.potential.as_ref().map(|u| CompiledPotential::<T>::compile(u, size));
        let force = CompiledForce::<T>::compile(system.force.as_deref().unwrap_or_default());
        let index = |&(row, column): &(u32, u32)| (row as usize, column as usize);
        let entry = |&(row, column, entry): &(u32, u32, T)| (row as usize, column as usize, entry);
        let springs: Vec<_> = potential
            .iter()
            .flat_map(|potential| potential.quadratic().stiffness.iter().map(entry))
            .collect();
        let linear = potential
            .iter()
            .flat_map(|potential| potential.quadratic().linear.iter())
            .map(|&(coordinate, entry)| (coordinate as usize, entry))
            .collect();
        let curved: Vec<_> =
            potential.iter().flat_map(|potential| potential.pattern().iter().map(index)).collect();
        let pushed: Vec<_> = force.linear().iter().map(entry).collect();
        let turned: Vec<_> = force.pattern().iter().map(index).collect();

        let both = |(row, column): (usize, usize)| [(row, column), (column, row)];
        let of_potential =
            springs.iter().map(|&(row, column, _)| (row, column)).chain(curved.iter().copied());
        let of_force = pushed.iter().map(|&(row, column, _)| (row, column)).chain(turned.iter().copied());
        let own = system.own_terms.clone().map(|terms| Own::new(terms, size));
        let of_own =
            own.iter().flat_map(|_| (0..size).flat_map(|row| (0..size).map(move |column| (row, column))));
        let places = of_potential.flat_map(both).chain(of_force).chain(of_own);
        let pattern = Arc::new(Pattern::new(size, places.collect()));
        let slots = |&(row, column): &(usize, usize)| (pattern.slot(row, column), pattern.slot(column, row));
        let hessian_slots: Vec<_> = curved.iter().map(slots).collect();
        let jacobian_slots: Vec<_> = turned.iter().map(|&(row, column)| pattern.slot(row, column)).collect();
        let mut constant = Sparse::zero(Arc::clone(&pattern));
        for &(row, column, entry) in &springs {
            let (slot, mirrored) = slots(&(row, column));
            constant.values[slot] += entry;
            if row != column {
                constant.values[mirrored] += entry;
            }
        }
        for &(row, column, entry) in &pushed {
            constant.values[pattern.slot(row, column)] -= entry;
        }
        let entries = vec![T::zero(); hessian_slots.len().max(jacobian_slots.len())];
        Ok(Self {
            mass,
            inverse_mass,
            quadratic: Matrix::symmetric(size, springs.iter().copied()),
            linear,
            potential,
            forced: !force.is_zero(),
            moments: exact_moments(scenario),
            own,
            force,
            constant,
            hessian_slots,
            jacobian_slots,
            registers: Vec::new(),
            pushed: vec![T::zero(); size],
            entries,
        })
    }

    /// K q + b.
    fn quadratic_pull(&self, position: &[T], pull: &mut [T]) {
        pull.fill(T::zero());
        self.quadratic.multiply_add(T::one(), position, pull);
        for &(coordinate, entry) in &self.linear {
            pull[coordinate] += entry;
        }
    }
}

impl<T: Elementary> Mechanics<T, Dense> for Model<T> {
    fn mass(&self) -> &Matrix<T> {
        &self.mass
    }

    fn velocity(&self, momentum: &[T], velocity: &mut [T]) {
        velocity.fill(T::zero());
        self.inverse_mass.multiply_add(T::one(), momentum, velocity);
    }

    fn pull(&mut self, instant: Instant<T>, position: &Vec<T>, pull: &mut [T]) {
        self.quadratic_pull(position, pull);
        if let Some(potential) = &self.potential {
            potential.add_rest_gradient(position, &mut self.registers, pull);
        }
        if self.forced {
            self.force.value(moment(instant), position, &mut self.registers, &mut self.pushed);
            pull.iter_mut().zip(&self.pushed).for_each(|(pull, &force)| *pull -= force);
        }
        if let Some(own) = &mut self.own {
            own.add_pull(moment(instant), position, pull);
        }
    }

    fn linearise(
        &mut self,
        instant: Instant<T>,
        position: &Vec<T>,
        pull: &mut [T],
        stiffness: &mut Matrix<T>,
    ) {
        let Matrix::Sparse(stiffness) = stiffness else { return self.pull(instant, position, pull) };
        stiffness.values.copy_from_slice(&self.constant.values);
        self.quadratic_pull(position, pull);
        if let Some(potential) = &self.potential {
            let hessian = &mut self.entries[..self.hessian_slots.len()];
            potential.add_rest_derivatives(position, &mut self.registers, pull, hessian);
            for (&(slot, mirrored), &mut entry) in self.hessian_slots.iter().zip(hessian) {
                stiffness.values[slot] += entry;
                if slot != mirrored {
                    stiffness.values[mirrored] += entry;
                }
            }
        }
        if let Some(own) = &mut self.own {
            own.add_linearisation(moment(instant), position, pull, &mut stiffness.values);
        }
        if !self.forced {
            return;
        }
        let (registers, pushed) = (&mut self.registers, &mut self.pushed);
        let jacobian = &mut self.entries[..self.jacobian_slots.len()];
        self.force.derivatives(moment(instant), position, registers, pushed, jacobian);
        pull.iter_mut().zip(pushed).for_each(|(pull, force)| *pull -= *force);
        for (&slot, &mut entry) in self.jacobian_slots.iter().zip(jacobian) {
            stiffness.values[slot] -= entry;
        }
    }

    fn stiffness(&self) -> Matrix<T> {
        Matrix::Sparse(self.constant.clone())
    }

    fn excess(&mut self, rule: &NodalRule<'_, T>, excess: &mut [T]) -> bool {
        self.moments.as_mut().is_some_and(|moments| moments.excess(rule, excess))
    }

    fn is_linear(&self) -> bool {
        self.own.is_none()
            && self.potential.as_ref().is_none_or(CompiledPotential::is_quadratic)
            && self.force.is_affine()
    }

    fn energy(&mut self, position: &Vec<T>, momentum: &Vec<T>) -> T {
        self.pushed.fill(T::zero());
        self.inverse_mass.multiply_add(T::one(), momentum, &mut self.pushed);
        let product = momentum.iter().zip(&self.pushed).fold(T::zero(), |sum, (&p, &v)| sum + p * v);
        let potential = self.potential.as_ref().map(|u| u.value(position, &mut self.registers));
        let energy = T::of(0.5) * product + potential.unwrap_or(T::zero());
        match &mut self.own {
            None => energy,
            Some(own) => energy + own.potential(position),
        }
    }
}

/// The moments of a rough force, for the schemes that take the work of forces by a quadrature.
fn exact_moments(scenario: &Scenario) -> Option<ForceMoments> {
    let by_moments = scenario.system.force_quadrature == ForceQuadrature::Moments
        && matches!(scenario.scheme, Scheme::LowOrder { .. } | Scheme::Galerkin { .. });
    by_moments.then(|| ForceMoments::new(scenario.system.force.as_deref()?)).flatten()
}

/// A symmetric matrix of a scenario in the precision of `T`.
pub fn matrix<T: Real>(matrix: &SymmetricMatrix) -> Matrix<T> {
    match matrix {
        SymmetricMatrix::Diagonal(entries) => Matrix::Diagonal(vector(entries)),
        SymmetricMatrix::Dense(entries) => Matrix::Dense(vector(entries.as_slice())),
    }
}

/// Numbers of a scenario in the precision of `T`.
pub fn vector<T: Real>(numbers: &[f64]) -> Vec<T> {
    numbers.iter().map(|&number| T::of(number)).collect()
}

fn inverse<T: Real>(mass: &Matrix<T>, size: usize) -> Result<Matrix<T>, MatrixError> {
    if let Matrix::Diagonal(entries) = mass {
        let inverses: Vec<T> = entries.iter().map(|&entry| T::one() / entry).collect();
        let good =
            entries.iter().zip(&inverses).all(|(entry, inverse)| *entry > T::zero() && inverse.is_finite());
        return if good { Ok(Matrix::Diagonal(inverses)) } else { Err(MatrixError::NotPositiveDefinite) };
    }
    let mut factors = vec![T::zero(); size * size];
    mass.add_to(T::one(), &mut factors, size, 0, 0);
    let mut pivots = vec![0; size];
    let mut columns = vec![T::zero(); size * size];
    factor(&mut factors, &mut pivots).map_err(|_| MatrixError::NotPositiveDefinite)?;
    invert_factored(&factors, &pivots, &mut columns);
    Ok(Matrix::Dense(columns))
}

fn moment<T: Elementary>(instant: Instant<T>) -> Moment<T> {
    match instant.approach {
        Approach::Inside => Moment::inside(instant.time),
        Approach::FromLeft => Moment::from_left(instant.time),
        Approach::FromRight => Moment::from_right(instant.time),
    }
}
