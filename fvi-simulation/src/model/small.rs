//! The spaces of few coordinates, for which the one step is compiled again.

use super::few::{few, few_mut};
use super::matrices::Matrix;
use fvi_core::{Real, Space};

/// The space of exactly N coordinates, with the vectors and matrices of [`AnySpace`](super::AnySpace), in
/// which system and damping stay.
///
/// A vector of known length needs no loop, no check that two of them overlap, and no remainder, which
/// together cost more than the arithmetic of a few coordinates. The bits are those of any other number.
#[derive(Clone, Copy, Debug)]
pub(super) struct Small<const N: usize>;

impl<T: Real, const N: usize> Space<T> for Small<N> {
    const KNOWN_SIZE: bool = true;

    type Vector = Vec<T>;
    type Block = Matrix<T>;

    #[inline(always)]
    fn coordinates(&self) -> usize {
        N
    }

    fn zeros(&self) -> Vec<T> {
        vec![T::zero(); N]
    }

    #[inline(always)]
    fn slice(vector: &Vec<T>) -> &[T] {
        few::<T, N>(vector)
    }

    #[inline(always)]
    fn slice_mut(vector: &mut Vec<T>) -> &mut [T] {
        few_mut::<T, N>(vector)
    }
}
