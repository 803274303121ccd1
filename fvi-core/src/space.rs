//! Storage of vectors and matrices of coordinates.

use crate::error::MatrixError;
use crate::linear::combine;
use crate::real::Real;

/// Storage for N coordinates.
///
/// Schemes, damping and the integrator are written once, over slices of N numbers; a space defines the
/// storage. [`Fixed`](crate::Fixed) stores everything in place and needs no allocator. A host adds a space
/// whose N is known at run time only.
pub trait Space<T: Real>: Clone {
    /// True if N is known at compile time. Steps are then inlined for it; otherwise they consist of calls,
    /// which cost little beside loops over many coordinates and are compiled once.
    const KNOWN_SIZE: bool;

    /// N numbers.
    type Vector: Clone;
    /// An N×N matrix: mass, damping coefficients, stiffness.
    type Block: Block<T>;

    /// Number of coordinates N.
    fn coordinates(&self) -> usize;

    /// The zero vector.
    fn zeros(&self) -> Self::Vector;

    /// The N numbers of a vector.
    fn slice(vector: &Self::Vector) -> &[T];

    /// The N numbers of a vector.
    fn slice_mut(vector: &mut Self::Vector) -> &mut [T];
}

/// An N×N matrix as schemes use it.
pub trait Block<T: Real> {
    /// out += factor · (B x).
    fn multiply_add(&self, factor: T, x: &[T], out: &mut [T]);

    /// out ← `start` + factor · (B x) − `by` · `force`: the residual of a momentum equation.
    #[inline(always)]
    fn balance(&self, (start, (by, force)): (&[T], (T, &[T])), (factor, x): (T, &[T]), out: &mut [T]) {
        combine(out, start, |_, start| start);
        self.multiply_add(factor, x, out);
        combine(out, force, |out, force| out - force * by);
    }

    /// Adds factor · B to the N×N block of a dense matrix that begins at the given row and column. The matrix
    /// is stored row by row, `width` numbers each.
    fn add_to(&self, factor: T, target: &mut [T], width: usize, row: usize, column: usize);

    /// Checks that the matrix is finite, symmetric and positive semidefinite to rounding.
    ///
    /// # Errors
    /// [`MatrixError`].
    fn check_positive_semidefinite(&self) -> Result<(), MatrixError>;
}

/// Result of `act` through a call that is not inlined, so that it is compiled once.
#[inline(never)]
pub(crate) fn called<R>(act: impl FnOnce() -> R) -> R {
    act()
}

/// The vectors of `width` numbers in a slice, one after another; an incomplete last one is left out.
///
/// `chunks_exact` divides lengths. Where the width is known at run time only, the divisions of a small step
/// cost more than its arithmetic.
#[inline(always)]
pub(crate) fn vectors<T>(mut rest: &[T], width: usize) -> impl Iterator<Item = &[T]> {
    core::iter::from_fn(move || {
        let (vector, later) = rest.split_at_checked(width.max(1))?;
        rest = later;
        Some(vector)
    })
}

/// The first `count` numbers of a work array.
///
/// The shapes of scheme, system and memory determine the length of work arrays. Unit tests detect one that is
/// too short; in production it counts as empty, since no step may panic.
#[inline(always)]
pub(crate) fn part<T>(numbers: &[T], count: usize) -> &[T] {
    #[cfg(test)]
    assert!(count <= numbers.len(), "a work array of {} numbers, {count} wanted", numbers.len());
    numbers.get(..count).unwrap_or_default()
}

/// As [`part`], to change them.
#[inline(always)]
pub(crate) fn part_mut<T>(numbers: &mut [T], count: usize) -> &mut [T] {
    #[cfg(test)]
    assert!(count <= numbers.len(), "a work array of {} numbers, {count} wanted", numbers.len());
    numbers.get_mut(..count).unwrap_or_default()
}

/// The numbers of a work array from `start` on, as [`part`].
#[inline(always)]
pub(crate) fn part_from<T>(numbers: &[T], start: usize) -> &[T] {
    #[cfg(test)]
    assert!(start <= numbers.len(), "a work array of {} numbers, from {start} on", numbers.len());
    numbers.get(start..).unwrap_or_default()
}

/// The first `count` numbers of a work array, as [`part`], and the others, to change them.
#[inline(always)]
pub(crate) fn parts_mut<T>(numbers: &mut [T], count: usize) -> (&mut [T], &mut [T]) {
    #[cfg(test)]
    assert!(count <= numbers.len(), "a work array of {} numbers, {count} wanted", numbers.len());
    numbers.split_at_mut_checked(count).unwrap_or_default()
}

/// The last vector of a row of vectors, as [`part`].
#[inline(always)]
pub(crate) fn last_vector<T>(numbers: &[T], width: usize) -> &[T] {
    let found = vectors(numbers, width).last();
    #[cfg(test)]
    assert!(found.is_some(), "no vector of {width} in {} numbers", numbers.len());
    found.unwrap_or_default()
}

/// Vector `index` of a row of vectors, as [`part`].
#[inline(always)]
pub(crate) fn vector_at<T>(numbers: &[T], width: usize, index: usize) -> &[T] {
    let found = vectors(numbers, width).nth(index);
    #[cfg(test)]
    assert!(found.is_some(), "no vector {index} of {width} in {} numbers", numbers.len());
    found.unwrap_or_default()
}

/// As [`vectors`], to change them.
#[inline(always)]
pub(crate) fn vectors_mut<T>(mut rest: &mut [T], width: usize) -> impl Iterator<Item = &mut [T]> {
    core::iter::from_fn(move || {
        let (vector, later) = core::mem::take(&mut rest).split_at_mut_checked(width.max(1))?;
        rest = later;
        Some(vector)
    })
}
