//! The damping terms of a scenario on memories: number of channels, and terms that may share a memory.

use super::channel_damping::{ChannelDamping, Coefficient, Directions};
use super::matrices::Matrix;
use super::mechanics::matrix;
use super::space::AnySpace;
use fvi_core::{Block, DampingError, Derivative, Kernel, Memory};
use fvi_scenario::language::expression::Elementary;
use fvi_scenario::scenario::{self, SymmetricMatrix};

/// Type of the derivative of a term.
fn derivative(term: &scenario::Damping) -> Derivative {
    match term.derivative {
        scenario::Derivative::RiemannLiouville => Derivative::RiemannLiouville,
        scenario::Derivative::Caputo => Derivative::Caputo,
    }
}

/// Directions whose motion the memory of a term stores; `None`: every coordinate.
fn directions<T: Elementary>(term: &scenario::Damping) -> Option<Directions<T>> {
    match (&term.attached, &term.coefficient) {
        (Some(attached), _) => Some(Directions::of_dampers(attached)),
        (None, SymmetricMatrix::Sparse(entries)) => Some(Directions::of_rows(entries.pattern.rows())),
        (None, _) => None,
    }
}

/// The same, with every coordinate by its index.
fn all_directions<T: Elementary>(term: &scenario::Damping) -> Directions<T> {
    directions(term).unwrap_or_else(|| Directions::Coordinates((0..term.coefficient.size()).collect()))
}

/// Number of channels that the memory of a term has for each node, with `copies` motions integrated together.
pub fn channels_of(term: &scenario::Damping, copies: usize) -> usize {
    let for_one = match (&term.attached, &term.coefficient) {
        (Some(attached), _) => attached.columns.len(),
        (None, SymmetricMatrix::Sparse(entries)) => {
            entries.pattern.rows().filter(|slots| !slots.is_empty()).count().max(1)
        }
        (None, other) => other.size(),
    };
    for_one * copies
}

/// True if the memories of two terms would store the same samples, so that they may share one.
pub fn follow_alike<T: Elementary>(one: &scenario::Damping, other: &scenario::Damping) -> bool {
    let same_derivative = one.derivative == other.derivative
        && (derivative(one) == Derivative::RiemannLiouville
            || (one.transfer.growth() > 1.0) == (other.transfer.growth() > 1.0));
    same_derivative && all_directions::<T>(one) == all_directions::<T>(other)
}

/// Damping terms on a memory of their kernels. Several terms must have the same samples.
///
/// # Errors
/// If the coefficients are not positive semidefinite in the precision of `T`, or the weights of the memory
/// are not those of the kernels.
pub fn term_on_memory<T: Elementary, M: Memory<T>>(
    space: &AnySpace,
    terms: &[(&scenario::Damping, Kernel)],
    memory: M,
) -> Result<ChannelDamping<T, M>, DampingError> {
    let rho =
        |term: &scenario::Damping| -> Matrix<T> { matrix(&term.coefficient).on_threads(space.threads()) };
    let first = terms[0].0;
    let directions = match directions::<T>(first) {
        None if terms.len() == 1 => {
            rho(first).check_positive_semidefinite().map_err(DampingError::Coefficients)?;
            Directions::All(first.coefficient.size())
        }
        _ => all_directions(first),
    };
    let coefficient =
        |&(term, _): &(&scenario::Damping, Kernel)| Coefficient::new(rho(term), term.attached.as_ref());
    let coefficients = terms.iter().map(coefficient).collect();
    let kernels: Vec<Kernel> = terms.iter().map(|(_, kernel)| *kernel).collect();
    ChannelDamping::new(&kernels, (coefficients, directions, space.copies()), derivative(first), memory)
}
