//! A system of one coordinate, its numbers in place.

use super::{Model, moment};
use crate::language::expression::Elementary;
use crate::model::energies::{EnergiesAlong, EnergyRoom, States, write_plain};
use crate::model::matrices::Matrix;
use crate::model::switches::Switched;
use crate::scenario::{SampledInput, Scenario};
use fvi_core::{Block, Coefficients, Fixed, Instant, MatrixError, Mechanics, NodalRule, Real};
use nalgebra::SVector;

/// M, U and F of a scenario with one coordinate.
///
/// The numbers are those of the [`Model`] that it is made from, which serves what is compiled from
/// expressions.
#[derive(Clone, Debug)]
pub struct SingleModel<T> {
    model: Model<T>,
    mass: Coefficients<T, 1>,
    inverse_mass: T,
    /// k of the quadratic part ½ k q² + b q of the potential, and b.
    quadratic: T,
    linear: T,
    /// The part of the stiffness that never changes.
    constant: T,
    is_linear: bool,
}

/// The entry of a 1×1 matrix.
fn entry<T: Real>(matrix: &Matrix<T>) -> T {
    let mut product = [T::zero()];
    matrix.multiply_add(T::one(), &[T::one()], &mut product);
    product[0]
}

impl<T: Elementary> SingleModel<T> {
    /// Whether a scenario is such a system, of expressions alone.
    pub fn serves(scenario: &Scenario) -> bool {
        let system = &scenario.system;
        let springs = system.damping.iter().any(|term| term.transfer.spring() != 0.0);
        // Where steps end at jumps and kinks in the position its model has more inputs than the coordinate.
        let switches = scenario.time.adaptive().is_some();
        let plain = system.own_terms.is_none() && !system.is_large();
        scenario.coordinates() == 1 && plain && !springs && !switches
    }

    /// As [`Model::missed`].
    pub fn missed(&self) -> Option<f64> {
        self.model.missed()
    }

    /// As [`Model::live`].
    pub(crate) fn live(&mut self) -> Option<&mut SampledInput> {
        self.model.live()
    }

    /// Compiles the system of a scenario that it [`serves`](Self::serves).
    ///
    /// # Errors
    /// If the mass is not positive in the precision of `T`.
    pub fn new(scenario: &Scenario) -> Result<Self, MatrixError> {
        let model = Model::<T>::new(scenario)?;
        let mut inverse_mass = [T::zero()];
        model.write_velocity(&[T::one()], &mut inverse_mass);
        Ok(Self {
            mass: Coefficients::Diagonal([entry(&model.mass)].into()),
            inverse_mass: inverse_mass[0],
            quadratic: entry(&model.quadratic),
            linear: model.linear.iter().fold(T::zero(), |sum, &(_, restoring)| sum + restoring),
            constant: model.constant.values.iter().fold(T::zero(), |sum, &value| sum + value),
            is_linear: model.is_linear(),
            model,
        })
    }
}

impl<T: Elementary> SingleModel<T> {
    /// F.
    #[inline(never)]
    fn push(&mut self, instant: Instant<T>, q: T) -> T {
        let Model { force, registers, .. } = &mut self.model;
        let mut pushed = [T::zero()];
        force.value(moment(instant), &[q], registers, &mut pushed);
        pushed[0]
    }

    /// Takes F off the restoring force, and its derivative off the stiffness.
    #[inline(never)]
    fn linearise_push(&mut self, instant: Instant<T>, q: T, (restoring, mut stiffness): (T, T)) -> (T, T) {
        let Model { force, registers, entries, .. } = &mut self.model;
        let mut pushed = [T::zero()];
        force.derivatives(moment(instant), &[q], registers, &mut pushed, entries);
        entries.iter().take(force.pattern().len()).for_each(|&entry| stiffness -= entry);
        (restoring - pushed[0], stiffness)
    }
}

impl<T> Switched for SingleModel<T> {}

impl<T: Elementary> EnergiesAlong<T> for SingleModel<T> {
    fn has_plain_energy(&self) -> bool {
        // Of expressions alone, and a single mass is its own diagonal.
        true
    }

    fn write_energies(&self, states: &States<'_>, room: &mut EnergyRoom<T>, energies: &mut [f64]) {
        write_plain(&[self.inverse_mass], self.model.potential.as_ref(), states, room, energies);
    }
}

impl<T: Elementary> Mechanics<T, Fixed<1>> for SingleModel<T> {
    #[inline(always)]
    fn mass(&self) -> &Coefficients<T, 1> {
        &self.mass
    }

    #[inline(always)]
    fn velocity(&self, momentum: &[T], velocity: &mut [T]) {
        if let ([velocity], [p]) = (velocity, momentum) {
            *velocity = self.inverse_mass * *p;
        }
    }

    #[inline(always)]
    fn restoring_force(&mut self, instant: Instant<T>, position: &SVector<T, 1>, restoring: &mut [T]) {
        let [restoring] = restoring else { return };
        let q = position[0];
        *restoring = self.quadratic * q + self.linear;
        if !self.is_linear
            && let Some(potential) = &self.model.potential
        {
            *restoring = potential.add_rest_slope(&mut self.model.restoring_registers, q, *restoring);
        }
        if self.model.forced {
            *restoring -= self.push(instant, q);
        }
    }

    #[inline(always)]
    fn linearise(
        &mut self,
        instant: Instant<T>,
        position: &SVector<T, 1>,
        restoring: &mut [T],
        stiffness: &mut Coefficients<T, 1>,
    ) {
        let [restoring] = restoring else { return };
        let q = position[0];
        let mut numbers = (self.quadratic * q + self.linear, self.constant);
        if let Some(potential) = &self.model.potential {
            let registers = &mut self.model.rest_registers;
            numbers = potential.add_rest_slope_and_curvature(registers, q, numbers);
        }
        if self.model.forced {
            numbers = self.linearise_push(instant, q, numbers);
        }
        *restoring = numbers.0;
        *stiffness = Coefficients::Diagonal([numbers.1].into());
    }

    #[inline(always)]
    fn stiffness(&self) -> Coefficients<T, 1> {
        Coefficients::Diagonal([T::zero()].into())
    }

    #[inline(always)]
    fn is_rough(&self) -> bool {
        self.model.rough.is_some()
    }

    #[inline(always)]
    fn moment_correction(&mut self, rule: &NodalRule<'_, T>, moment_correction: &mut [T]) -> bool {
        self.model.rough.as_mut().is_some_and(|rough| rough.moment_correction(rule, moment_correction))
    }

    #[inline(always)]
    fn is_linear(&self) -> bool {
        self.is_linear
    }

    #[inline(always)]
    fn energy(&mut self, position: &SVector<T, 1>, momentum: &SVector<T, 1>) -> T {
        let kinetic = T::of(0.5) * (momentum[0] * (self.inverse_mass * momentum[0]));
        kinetic + self.model.potential_energy(position.as_slice())
    }
}
