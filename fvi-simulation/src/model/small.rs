//! The spaces of few coordinates, for which the one step is compiled again.

use super::few::{few, few_mut};
use super::matrices::Matrix;
use super::space::AnySpace;
use fvi_core::{
    Damping, Instant, Mechanics, MemoryError, Mismatch, NodalRule, Real, Sample, Space, Stateful,
};

/// The space of exactly N coordinates, with the vectors and matrices of [`AnySpace`].
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

/// System and damping of [`AnySpace`], lent to a step in the space of their N coordinates.
pub(super) struct Lent<'a, Of>(pub(super) &'a mut Of);

impl<T: Real, G: Mechanics<T, AnySpace>, const N: usize> Mechanics<T, Small<N>> for Lent<'_, G> {
    #[inline(always)]
    fn mass(&self) -> &Matrix<T> {
        self.0.mass()
    }

    #[inline(always)]
    fn velocity(&self, momentum: &[T], velocity: &mut [T]) {
        self.0.velocity(momentum, velocity);
    }

    #[inline(always)]
    fn drift(&self, momentum: &[T], velocity: &mut [T]) {
        self.0.drift(momentum, velocity);
    }

    #[inline(always)]
    fn restoring_force(&mut self, instant: Instant<T>, position: &Vec<T>, restoring: &mut [T]) {
        self.0.restoring_force(instant, position, restoring);
    }

    #[inline(always)]
    fn linearise(
        &mut self,
        instant: Instant<T>,
        position: &Vec<T>,
        restoring: &mut [T],
        stiffness: &mut Matrix<T>,
    ) {
        self.0.linearise(instant, position, restoring, stiffness);
    }

    #[inline(always)]
    fn depends_on_velocity(&self) -> bool {
        self.0.depends_on_velocity()
    }

    #[inline(always)]
    fn restoring_force_in_motion(
        &mut self,
        instant: Instant<T>,
        position: &Vec<T>,
        velocity: &[T],
        restoring: &mut [T],
    ) {
        self.0.restoring_force_in_motion(instant, position, velocity, restoring);
    }

    #[inline(always)]
    fn linearise_in_motion(
        &mut self,
        instant: Instant<T>,
        position: &Vec<T>,
        velocity: &[T],
        restoring: &mut [T],
        stiffness: &mut Matrix<T>,
    ) {
        self.0.linearise_in_motion(instant, position, velocity, restoring, stiffness);
    }

    #[inline(always)]
    fn resistance(
        &mut self,
        instant: Instant<T>,
        position: &Vec<T>,
        velocity: &[T],
        resistance: &mut Matrix<T>,
    ) {
        self.0.resistance(instant, position, velocity, resistance);
    }

    #[inline(always)]
    fn is_rough(&self) -> bool {
        self.0.is_rough()
    }

    #[inline(always)]
    fn moment_correction(&mut self, rule: &NodalRule<'_, T>, moment_correction: &mut [T]) -> bool {
        self.0.moment_correction(rule, moment_correction)
    }

    fn stiffness(&self) -> Matrix<T> {
        self.0.stiffness()
    }

    #[inline(always)]
    fn is_linear(&self) -> bool {
        self.0.is_linear()
    }

    fn energy(&mut self, position: &Vec<T>, momentum: &Vec<T>) -> T {
        self.0.energy(position, momentum)
    }
}

/// A step neither saves nor restores.
impl<D> Stateful for Lent<'_, D> {}

impl<T: Real, D: Damping<T, AnySpace>, const N: usize> Damping<T, Small<N>> for Lent<'_, D> {
    fn check(&self, coordinates: usize, nodes: usize, step_size: T) -> Result<(), Mismatch> {
        self.0.check(coordinates, nodes, step_size)
    }

    fn begin(&mut self, position: &[T], velocity: &[T]) {
        self.0.begin(position, velocity);
    }

    fn begin_at(&mut self, time: T) {
        self.0.begin_at(time);
    }

    #[inline(always)]
    fn add_known(
        &mut self,
        sample: &Sample<'_, T>,
        known: &mut [T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        self.0.add_known(sample, known, scratch)
    }

    #[inline(always)]
    fn add_leading(&self, increments: &[T], force: &mut [T], scratch: &mut [T]) {
        self.0.add_leading(increments, force, scratch);
    }

    #[inline(always)]
    fn visit_leading(&self, nodes: usize, visit: impl FnMut(usize, usize, T, &Matrix<T>)) {
        self.0.visit_leading(nodes, visit);
    }

    #[inline(always)]
    fn leading_is_constant(&self) -> bool {
        self.0.leading_is_constant()
    }

    #[inline(always)]
    fn push(
        &mut self,
        sample: &Sample<'_, T>,
        increments: &[T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        self.0.push(sample, increments, scratch)
    }
}
