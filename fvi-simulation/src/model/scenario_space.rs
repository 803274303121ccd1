//! What a space needs for scenarios to run in it.

use super::channel_damping::{ChannelDamping, Coefficient, Directions, HostTerm};
use super::energies::EnergiesAlong;
use super::matrices::Matrix;
use super::mechanics::{Model, matrix, vector};
use super::scheme::{AnyScheme, DenseOutput};
use super::space::AnySpace;
use super::switches::Switched;
use crate::language::expression::Elementary;
use crate::scenario::{self, SampledInput, Scenario, SymmetricMatrix};
use fvi_core::{
    Damping, DampingError, DampingTerm, Derivative, Kernel, MatrixError, Mechanics, Memory, ParameterError,
    Space,
};

/// A space in which scenarios run: how what they say becomes its vectors, matrices, system and scheme.
///
/// The simulation is written over this; another way to store coordinates joins by implementing it.
pub trait ScenarioSpace<T: Elementary>: Space<T> {
    /// M, U and F.
    type System: Mechanics<T, Self> + EnergiesAlong<T> + Switched;
    /// The scheme.
    type Scheme: DenseOutput<T, Self>;
    /// A damping term on a memory.
    type Term<M: Memory<T>>: Damping<T, Self> + Remembers<M>;

    /// The system of a scenario.
    ///
    /// # Errors
    /// If the mass is not positive definite in the precision of `T`.
    fn system(&self, scenario: &Scenario) -> Result<Self::System, MatrixError>;

    /// The scheme of a scenario.
    ///
    /// # Errors
    /// If degree, points and stages do not go together.
    fn scheme(&self, scenario: &Scenario) -> Result<Self::Scheme, ParameterError>;

    /// How many motions are integrated together, one behind the other in every vector.
    fn copies(&self) -> usize {
        1
    }

    /// Threads that products with matrices, and solutions, may take.
    fn threads(&self) -> usize {
        1
    }

    /// Whether the energy costs about as much as a step, so that it is computed for the rows that are written
    /// only.
    fn energy_is_dear(&self) -> bool {
        false
    }

    /// The vector of these numbers, one for each coordinate, the same for every motion.
    fn vector(&self, numbers: &[f64]) -> Self::Vector;

    /// The energies of the motions whose sum the system has computed last; none for a single motion.
    fn energies(_: &Self::System) -> &[T] {
        &[]
    }

    /// From where on something of the forces that is rough in time may have been overlooked.
    fn missed(_: &Self::System) -> Option<f64> {
        None
    }

    /// What controllers change inside the step to come, where they do.
    fn live(_: &mut Self::System) -> Option<&mut SampledInput> {
        None
    }

    /// G, skew-symmetric; `None` without gyroscopic forces.
    fn gyroscopic(&self, scenario: &Scenario) -> Option<Self::Block> {
        let _ = scenario;
        None
    }

    /// Number of channels that the memory of a term has for each node.
    fn channels(&self, term: &scenario::Damping) -> usize;

    /// Whether the memories of two terms would follow the same numbers, so that they may have one.
    fn follow_alike(&self, one: &scenario::Damping, other: &scenario::Damping) -> bool;

    /// Damping terms on a memory of their kernels. Where there are several they follow the same numbers.
    ///
    /// # Errors
    /// If the coefficients are not positive semidefinite in the precision of `T`, or the memory is not one of
    /// the kernels.
    fn term<M: Memory<T>>(
        &self,
        terms: &[(&scenario::Damping, Kernel)],
        memory: M,
    ) -> Result<Self::Term<M>, DampingError>;
}

/// What has a memory.
pub trait Remembers<M> {
    /// The memory.
    fn memory(&self) -> &M;
}

impl<T: Elementary, M: Memory<T>> Remembers<M> for HostTerm<T, M> {
    fn memory(&self) -> &M {
        HostTerm::memory(self)
    }
}

/// On what the derivative of a term acts.
pub(super) fn derivative(term: &scenario::Damping) -> Derivative {
    match term.derivative {
        scenario::Derivative::RiemannLiouville => Derivative::RiemannLiouville,
        scenario::Derivative::Caputo => Derivative::Caputo,
    }
}

/// Directions that the memory of a term follows; `None`: every coordinate.
fn directions<T: Elementary>(term: &scenario::Damping) -> Option<Directions<T>> {
    match (&term.attached, &term.coefficient) {
        (Some(attached), _) => Some(Directions::of_dampers(attached)),
        (None, SymmetricMatrix::Sparse(entries)) => Some(Directions::of_rows(entries.pattern.rows())),
        (None, _) => None,
    }
}

/// The same, every coordinate by its number.
fn all_directions<T: Elementary>(term: &scenario::Damping) -> Directions<T> {
    directions(term).unwrap_or_else(|| Directions::Coordinates((0..term.coefficient.size()).collect()))
}

impl<T: Elementary> ScenarioSpace<T> for AnySpace {
    type System = Model<T>;
    type Scheme = AnyScheme<T>;
    type Term<M: Memory<T>> = HostTerm<T, M>;

    fn system(&self, scenario: &Scenario) -> Result<Model<T>, MatrixError> {
        Model::new(scenario)
    }

    fn scheme(&self, scenario: &Scenario) -> Result<AnyScheme<T>, ParameterError> {
        AnyScheme::new(scenario)
    }

    fn copies(&self) -> usize {
        AnySpace::copies(self)
    }

    fn threads(&self) -> usize {
        AnySpace::threads(self)
    }

    fn energy_is_dear(&self) -> bool {
        self.plan().is_some()
    }

    fn vector(&self, numbers: &[f64]) -> Vec<T> {
        vector(numbers).repeat(AnySpace::copies(self))
    }

    fn energies(system: &Model<T>) -> &[T] {
        system.energies()
    }

    fn gyroscopic(&self, scenario: &Scenario) -> Option<Matrix<T>> {
        let skew = scenario.system.gyroscopic.as_ref()?;
        let entries =
            skew.entries().iter().map(|&(row, column, entry)| (row as usize, column as usize, entry));
        Some(Matrix::of_entries(scenario.coordinates(), entries).on_threads(AnySpace::threads(self)))
    }

    fn missed(system: &Model<T>) -> Option<f64> {
        system.missed()
    }

    fn live(system: &mut Model<T>) -> Option<&mut SampledInput> {
        system.live()
    }

    fn channels(&self, term: &scenario::Damping) -> usize {
        let for_one = match (&term.attached, &term.coefficient) {
            (Some(attached), _) => attached.columns.len(),
            (None, SymmetricMatrix::Sparse(entries)) => {
                entries.pattern.rows().filter(|slots| !slots.is_empty()).count().max(1)
            }
            (None, other) => other.size(),
        };
        for_one * AnySpace::copies(self)
    }

    fn follow_alike(&self, one: &scenario::Damping, other: &scenario::Damping) -> bool {
        let same_derivative = one.derivative == other.derivative
            && (derivative(one) == Derivative::RiemannLiouville
                || (one.transfer.growth() > 1.0) == (other.transfer.growth() > 1.0));
        same_derivative && all_directions::<T>(one) == all_directions::<T>(other)
    }

    fn term<M: Memory<T>>(
        &self,
        terms: &[(&scenario::Damping, Kernel)],
        memory: M,
    ) -> Result<Self::Term<M>, DampingError> {
        let rho = |term: &scenario::Damping| -> Matrix<T> {
            matrix(&term.coefficient).on_threads(AnySpace::threads(self))
        };
        let (first, kernel) = terms[0];
        if terms.len() == 1 && directions::<T>(first).is_none() {
            return DampingTerm::in_space(self, kernel, rho(first), derivative(first), memory)
                .map(HostTerm::Everywhere);
        }
        let copies = AnySpace::copies(self);
        let coefficient =
            |&(term, _): &(&scenario::Damping, Kernel)| Coefficient::new(rho(term), term.attached.as_ref());
        let coefficients = terms.iter().map(coefficient).collect();
        let kernels: Vec<Kernel> = terms.iter().map(|(_, kernel)| *kernel).collect();
        let shape = (coefficients, all_directions(first), copies);
        ChannelDamping::new(&kernels, shape, derivative(first), memory).map(HostTerm::Channels)
    }
}
