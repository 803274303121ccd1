//! Fractional damping: coefficients, order, and the memory that it needs.

use core::fmt;

use crate::coefficients::{Coefficients, Fixed};
use crate::damped_motion::{DampedMotion, DampingError, Derivative, Mismatch, Sample};
use crate::kernel::Kernel;
use crate::linear::add_multiple;
use crate::memory::{Memory, MemoryError};
use crate::real::Real;
use crate::saving::{StateError, StateReader, StateWriter, Stateful};
use crate::space::{Block, Space, part_mut, parts_mut, vectors, vectors_mut};

/// Damping with memory: none, one term or several.
///
/// A sample holds R nodes: R = 1 if the memory stores the main nodes q_k, otherwise the number of quadrature
/// nodes, which it then stores. With the nodes of the sample to come at q_k + e_1, …, q_k + e_R the damping
/// exerts
///
/// ```text
/// Σ_m ρ_m (D^{β_m} q)_i = known_i + Σ_m ρ_m Σ_j W_ij e_j ,     i = 1…R
/// ```
///
/// and the force on the system is minus this. Vectors of R·N numbers have one node after another. `()` is no
/// damping, [`DampingTerm`] one term, and tuples, arrays and mutable slices of dampings act together.
pub trait Damping<T: Real, X: Space<T>>: Stateful {
    /// Checks that the memories fit N coordinates and R nodes, and the kernels the step size.
    ///
    /// # Errors
    /// [`Mismatch`] if one does not.
    fn check(&self, coordinates: usize, nodes: usize, step_size: T) -> Result<(), Mismatch>;

    /// Clears the memories and stores the initial position and velocity.
    fn begin(&mut self, position: &[T], velocity: &[T]);

    /// Sets, after [`begin`](Damping::begin), a start time other than 0.
    fn begin_at(&mut self, time: T);

    /// Adds known_i to `known`, R·N numbers. `scratch` has R·N numbers, and N more where R > 1.
    ///
    /// # Errors
    /// [`MemoryError::Full`] if the sample to come could not be stored, [`MemoryError::StepLength`] if the
    /// kernel is for another step size.
    fn add_known(
        &mut self,
        sample: &Sample<'_, T>,
        known: &mut [T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError>;

    /// Adds Σ_m ρ_m Σ_j W_ij e_j to `force`, R·N numbers. `scratch` has N numbers at least.
    fn add_leading(&self, increments: &[T], force: &mut [T], scratch: &mut [T]);

    /// Calls `visit(i, j, W_ij, ρ_m)` for every nonzero W_ij ρ_m, for a sample of `nodes` nodes.
    fn visit_leading(&self, nodes: usize, visit: impl FnMut(usize, usize, T, &X::Block));

    /// True if the leading weights of all later steps are those of the step to come.
    fn leading_is_constant(&self) -> bool;

    /// Stores the sample, whose `increments` e_1, …, e_R are known now. `scratch` has R·N numbers, and N more
    /// where R > 1.
    ///
    /// # Errors
    /// [`MemoryError::Full`]; not after a successful [`add_known`](Damping::add_known).
    fn push(
        &mut self,
        sample: &Sample<'_, T>,
        increments: &[T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError>;
}

/// One damping term ρ D₋^β q with its memory.
///
/// ρ is symmetric positive semidefinite; β = 2α is the damping order, 0 ≤ β < 2 (α is the order in the
/// Lagrangian). The [`Kernel`] of the memory contains β and the step size; [`DampedMotion`] defines the
/// samples of the memory. Source: \[JO\] eq. 1, 34a; \[HJO\] eq. 34a, 35.
#[derive(Clone)]
pub struct DampingTerm<T: Real, X: Space<T>, M> {
    coefficients: X::Block,
    motion: DampedMotion<T, X, M>,
}

impl<T: Real, X: Space<T>, M: Copy> Copy for DampingTerm<T, X, M>
where
    X::Block: Copy,
    DampedMotion<T, X, M>: Copy,
{
}

impl<T: Real, X: Space<T>, M> fmt::Debug for DampingTerm<T, X, M>
where
    X::Block: fmt::Debug,
    DampedMotion<T, X, M>: fmt::Debug,
{
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { coefficients, motion } = self;
        f.debug_struct("DampingTerm").field("coefficients", coefficients).field("motion", motion).finish()
    }
}

impl<T: Real, const N: usize, M: Memory<T>> DampingTerm<T, Fixed<N>, M> {
    /// The term ρ D^β q on a memory of the given kernel, that of s^β.
    ///
    /// # Errors
    /// If β is outside [0, 2), ρ is not finite, symmetric and positive semidefinite, or the weights of the
    /// memory are not those of the kernel.
    #[inline(always)]
    pub fn new(
        kernel: Kernel,
        coefficients: Coefficients<T, N>,
        derivative: Derivative,
        memory: M,
    ) -> Result<Self, DampingError> {
        Self::in_space(&Fixed, kernel, coefficients, derivative, memory)
    }
}

impl<T: Real, X: Space<T>, M: Memory<T>> DampingTerm<T, X, M> {
    /// The term ρ D^β q in any space; see [`new`](DampingTerm::new).
    ///
    /// # Errors
    /// As [`new`](DampingTerm::new).
    #[inline(always)]
    pub fn in_space(
        space: &X,
        kernel: Kernel,
        coefficients: X::Block,
        derivative: Derivative,
        memory: M,
    ) -> Result<Self, DampingError> {
        coefficients.check_positive_semidefinite().map_err(DampingError::Coefficients)?;
        let motion = DampedMotion::new(space, &[kernel], derivative, memory)?;
        Ok(Self { coefficients, motion })
    }
}

impl<T: Real, X: Space<T>, M> DampingTerm<T, X, M> {
    /// The memory.
    pub fn memory(&self) -> &M {
        self.motion.memory()
    }
}

impl<T: Real, X: Space<T>, M: Memory<T>> Damping<T, X> for DampingTerm<T, X, M> {
    fn check(&self, coordinates: usize, nodes: usize, step_size: T) -> Result<(), Mismatch> {
        self.motion.check(coordinates, nodes, step_size)
    }

    fn begin(&mut self, position: &[T], velocity: &[T]) {
        self.motion.begin(position, velocity);
    }

    fn begin_at(&mut self, time: T) {
        self.motion.begin_at(time);
    }

    #[inline(always)]
    fn add_known(
        &mut self,
        sample: &Sample<'_, T>,
        known: &mut [T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        let (coordinates, nodes) = (sample.from.len(), sample.fractions.len());
        let (term, rest) = parts_mut(scratch, coordinates * nodes);
        self.motion.memory_terms(sample, term)?;
        if nodes == 1 {
            self.motion.complete(0, sample, term);
            self.coefficients.multiply_add(T::one(), term, known);
            return Ok(());
        }
        let sum = part_mut(rest, coordinates);
        for (i, known) in vectors_mut(known, coordinates).enumerate() {
            self.motion.complete_node((0, i), sample, term, sum);
            self.coefficients.multiply_add(T::one(), sum, known);
        }
        Ok(())
    }

    #[inline(always)]
    fn add_leading(&self, increments: &[T], force: &mut [T], scratch: &mut [T]) {
        let coordinates = self.motion.coordinates();
        if increments.len() == coordinates {
            return self.coefficients.multiply_add(self.motion.leading(0, 1, 0, 0), increments, force);
        }
        let sum = part_mut(scratch, coordinates);
        let nodes = vectors(increments, coordinates).count();
        for (i, force) in vectors_mut(force, coordinates).enumerate() {
            sum.fill(T::zero());
            for (j, increment) in vectors(increments, coordinates).enumerate() {
                add_multiple(sum, self.motion.leading(0, nodes, i, j), increment);
            }
            self.coefficients.multiply_add(T::one(), sum, force);
        }
    }

    #[inline(always)]
    fn visit_leading(&self, nodes: usize, mut visit: impl FnMut(usize, usize, T, &X::Block)) {
        self.motion.visit_leading(0, nodes, |i, j, weight| visit(i, j, weight, &self.coefficients));
    }

    #[inline(always)]
    fn leading_is_constant(&self) -> bool {
        self.motion.memory().leading_is_constant()
    }

    #[inline(always)]
    fn push(
        &mut self,
        sample: &Sample<'_, T>,
        increments: &[T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        self.motion.push(sample, increments, scratch)
    }
}

impl<T: Real, X: Space<T>, M: Memory<T>> Stateful for DampingTerm<T, X, M> {
    fn state_bytes(&self) -> usize {
        self.motion.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.motion.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.motion.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.motion.restore(from)
    }
}

impl<T: Real, X: Space<T>> Damping<T, X> for () {
    fn check(&self, _: usize, _: usize, _: T) -> Result<(), Mismatch> {
        Ok(())
    }

    fn begin(&mut self, _: &[T], _: &[T]) {}

    fn begin_at(&mut self, _: T) {}

    fn add_known(&mut self, _: &Sample<'_, T>, _: &mut [T], _: &mut [T]) -> Result<(), MemoryError> {
        Ok(())
    }

    fn add_leading(&self, _: &[T], _: &mut [T], _: &mut [T]) {}

    fn visit_leading(&self, _: usize, _: impl FnMut(usize, usize, T, &X::Block)) {}

    fn leading_is_constant(&self) -> bool {
        true
    }

    fn push(&mut self, _: &Sample<'_, T>, _: &[T], _: &mut [T]) -> Result<(), MemoryError> {
        Ok(())
    }
}

impl<T: Real, X: Space<T>, A: Damping<T, X>, B: Damping<T, X>> Damping<T, X> for (A, B) {
    fn check(&self, coordinates: usize, nodes: usize, step_size: T) -> Result<(), Mismatch> {
        self.0.check(coordinates, nodes, step_size)?;
        self.1.check(coordinates, nodes, step_size)
    }

    fn begin(&mut self, position: &[T], velocity: &[T]) {
        self.0.begin(position, velocity);
        self.1.begin(position, velocity);
    }

    fn begin_at(&mut self, time: T) {
        self.0.begin_at(time);
        self.1.begin_at(time);
    }

    #[inline(always)]
    fn add_known(
        &mut self,
        sample: &Sample<'_, T>,
        known: &mut [T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        self.0.add_known(sample, known, scratch)?;
        self.1.add_known(sample, known, scratch)
    }

    #[inline(always)]
    fn add_leading(&self, increments: &[T], force: &mut [T], scratch: &mut [T]) {
        self.0.add_leading(increments, force, scratch);
        self.1.add_leading(increments, force, scratch);
    }

    #[inline(always)]
    fn visit_leading(&self, nodes: usize, mut visit: impl FnMut(usize, usize, T, &X::Block)) {
        self.0.visit_leading(nodes, &mut visit);
        self.1.visit_leading(nodes, visit);
    }

    #[inline(always)]
    fn leading_is_constant(&self) -> bool {
        self.0.leading_is_constant() && self.1.leading_is_constant()
    }

    #[inline(always)]
    fn push(
        &mut self,
        sample: &Sample<'_, T>,
        increments: &[T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        self.0.push(sample, increments, scratch)?;
        self.1.push(sample, increments, scratch)
    }
}

impl<T: Real, X: Space<T>, D: Damping<T, X>> Damping<T, X> for [D] {
    fn check(&self, coordinates: usize, nodes: usize, step_size: T) -> Result<(), Mismatch> {
        self.iter().try_for_each(|damping| damping.check(coordinates, nodes, step_size))
    }

    fn begin(&mut self, position: &[T], velocity: &[T]) {
        self.iter_mut().for_each(|damping| damping.begin(position, velocity));
    }

    fn begin_at(&mut self, time: T) {
        self.iter_mut().for_each(|damping| damping.begin_at(time));
    }

    #[inline(always)]
    fn add_known(
        &mut self,
        sample: &Sample<'_, T>,
        known: &mut [T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        for damping in self {
            damping.add_known(sample, known, scratch)?;
        }
        Ok(())
    }

    #[inline(always)]
    fn add_leading(&self, increments: &[T], force: &mut [T], scratch: &mut [T]) {
        for damping in self {
            damping.add_leading(increments, force, scratch);
        }
    }

    #[inline(always)]
    fn visit_leading(&self, nodes: usize, mut visit: impl FnMut(usize, usize, T, &X::Block)) {
        self.iter().for_each(|damping| damping.visit_leading(nodes, &mut visit));
    }

    #[inline(always)]
    fn leading_is_constant(&self) -> bool {
        self.iter().all(|damping| damping.leading_is_constant())
    }

    #[inline(always)]
    fn push(
        &mut self,
        sample: &Sample<'_, T>,
        increments: &[T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        for damping in self {
            damping.push(sample, increments, scratch)?;
        }
        Ok(())
    }
}

/// Implements `Damping` for a holder of a damping, by forwarding every call.
macro_rules! forward_damping {
    ($({$($generics:tt)*})? $holder:ty, $inner:ty, $self:ident => $shared:expr, $unique:expr) => {
        impl<T: Real, X: Space<T>, D: Damping<T, X> $(, $($generics)*)?> Damping<T, X> for $holder {
            fn check(&$self, coordinates: usize, nodes: usize, step_size: T) -> Result<(), Mismatch> {
                <$inner as Damping<T, X>>::check($shared, coordinates, nodes, step_size)
            }

            fn begin(&mut $self, position: &[T], velocity: &[T]) {
                <$inner as Damping<T, X>>::begin($unique, position, velocity);
            }

            fn begin_at(&mut $self, time: T) {
                <$inner as Damping<T, X>>::begin_at($unique, time);
            }

            #[inline(always)]
            fn add_known(
                &mut $self,
                sample: &Sample<'_, T>,
                known: &mut [T],
                scratch: &mut [T],
            ) -> Result<(), MemoryError> {
                <$inner as Damping<T, X>>::add_known($unique, sample, known, scratch)
            }

            #[inline(always)]
            fn add_leading(&$self, increments: &[T], force: &mut [T], scratch: &mut [T]) {
                <$inner as Damping<T, X>>::add_leading($shared, increments, force, scratch);
            }

            #[inline(always)]
            fn visit_leading(&$self, nodes: usize, visit: impl FnMut(usize, usize, T, &X::Block)) {
                <$inner as Damping<T, X>>::visit_leading($shared, nodes, visit);
            }

            #[inline(always)]
            fn leading_is_constant(&$self) -> bool {
                <$inner as Damping<T, X>>::leading_is_constant($shared)
            }

            #[inline(always)]
            fn push(
                &mut $self,
                sample: &Sample<'_, T>,
                increments: &[T],
                scratch: &mut [T],
            ) -> Result<(), MemoryError> {
                <$inner as Damping<T, X>>::push($unique, sample, increments, scratch)
            }
        }
    };
}

forward_damping!({const K: usize} [D; K], [D], self => self.as_slice(), self.as_mut_slice());
forward_damping!(&mut [D], [D], self => &**self, &mut **self);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::direct::FixedDirect;
    use crate::memory::ActsOn;
    use crate::recording_memory::RecordingMemory;
    use nalgebra::matrix;
    use std::vec::Vec;

    type Term<M> = DampingTerm<f64, Fixed<2>, M>;

    fn term<M: Memory<f64>>(rho: [[f64; 2]; 2], memory: M) -> Term<M> {
        let [[a, b], [c, d]] = rho;
        let kernel = Kernel::given(0.5).unwrap();
        let rho = Coefficients::Dense(matrix![a, b; c, d]);
        DampingTerm::new(kernel, rho, Derivative::RiemannLiouville, memory).unwrap()
    }

    const RHO: [[[f64; 2]; 2]; 2] = [[[2.0, 0.5], [0.5, 1.0]], [[1.0, -0.25], [-0.25, 3.0]]];

    /// A memory of two coordinates on one or two nodes, by a kernel of plain numbers or of matrices.
    fn told(nodes: usize, leading: &[f64], first_term: f64) -> RecordingMemory {
        RecordingMemory {
            stages: nodes,
            leading: leading.to_vec(),
            leading_is_constant: true,
            acts_on: ActsOn::Values,
            terms: (0..2 * nodes).map(|place| first_term + 0.5 * place as f64).collect(),
            capacity: 9,
            samples: Vec::new(),
        }
    }

    const FROM: [f64; 2] = [1.5, -2.0];
    const INCREMENTS: [f64; 4] = [0.25, 0.5, -1.0, 2.0];

    fn sample(nodes: usize) -> Sample<'static, f64> {
        let fractions = if nodes == 1 { &[1.0][..] } else { &[0.5, 1.0] };
        Sample { from: &FROM, behind: &[], time: 0.0, length: 0.5, fractions }
    }

    /// Force of a damping on the nodes of the sample, node by node, and its derivative with respect to the
    /// increments, row by row, from the visited entries.
    fn exerted(damping: &mut impl Damping<f64, Fixed<2>>, nodes: usize) -> (Vec<f64>, Vec<f64>) {
        let room = 2 * nodes + if nodes > 1 { 2 } else { 0 };
        let (mut force, mut scratch) = (std::vec![0.0; 2 * nodes], std::vec![f64::NAN; room]);
        damping.add_known(&sample(nodes), &mut force, &mut scratch).unwrap();
        damping.add_leading(&INCREMENTS[..2 * nodes], &mut force, &mut scratch);
        let mut derivative = std::vec![0.0; 4 * nodes * nodes];
        damping.visit_leading(nodes, |i, j, weight, rho| {
            rho.add_to(weight, &mut derivative, 2 * nodes, 2 * i, 2 * j);
        });
        (force, derivative)
    }

    /// The same for one term by its definition, from ρ, the terms of its memory, and its leading weight.
    fn defined(rho: [[f64; 2]; 2], memory: &RecordingMemory) -> (Vec<f64>, Vec<f64>) {
        let nodes = memory.stages;
        let (mut force, mut derivative) = (std::vec![0.0; 2 * nodes], std::vec![0.0; 4 * nodes * nodes]);
        for i in 0..nodes {
            for (row, numbers) in rho.iter().enumerate() {
                for (column, rho) in numbers.iter().enumerate() {
                    let mut sum = memory.terms[column * nodes + i];
                    for j in 0..nodes {
                        let weight = memory.leading[i * nodes + j];
                        sum += weight * (FROM[column] + INCREMENTS[2 * j + column]);
                        derivative[(2 * i + row) * 2 * nodes + 2 * j + column] = rho * weight;
                    }
                    force[2 * i + row] += rho * sum;
                }
            }
        }
        (force, derivative)
    }

    fn sum(
        (mut force, mut derivative): (Vec<f64>, Vec<f64>),
        other: &(Vec<f64>, Vec<f64>),
    ) -> (Vec<f64>, Vec<f64>) {
        force.iter_mut().zip(&other.0).for_each(|(sum, number)| *sum += number);
        derivative.iter_mut().zip(&other.1).for_each(|(sum, number)| *sum += number);
        (force, derivative)
    }

    #[test]
    fn several_dampings_exert_the_sum_of_what_each_does() {
        // Numbers of few digits: sums are exact.
        for (nodes, leading) in
            [(1, [&[4.0][..], &[0.5]]), (2, [&[4.0, 0.5, 1.5, 2.0], &[1.0, 0.25, 0.0, 8.0]])]
        {
            let memories = [told(nodes, leading[0], 1.0), told(nodes, leading[1], -3.0)];
            let term = |which: usize| term(RHO[which], memories[which].clone());
            let parts = [0, 1].map(|which| defined(RHO[which], &memories[which]));
            assert_eq!(exerted(&mut term(0), nodes), parts[0]);
            assert_eq!(exerted(&mut term(1), nodes), parts[1]);
            let [one, other] = parts;
            let both = sum(one, &other);
            assert_eq!(exerted(&mut (term(0), term(1)), nodes), both, "a pair");
            assert_eq!(exerted(&mut [term(0), term(1)], nodes), both, "an array");
            assert_eq!(exerted(&mut &mut [term(0), term(1)][..], nodes), both, "a slice");
            assert_eq!(exerted(&mut ((), (term(1), term(0))), nodes), both, "three");
        }
    }

    /// Asserts that every call reaches both of two memories, and that an error of either is returned.
    /// `samples` returns the number of samples of each.
    fn assert_both_are_asked<D: Damping<f64, Fixed<2>>>(
        with: impl Fn(RecordingMemory, RecordingMemory) -> D,
        samples: impl Fn(&D) -> [usize; 2],
    ) {
        let good = || told(1, &[1.0], 0.0);
        let full = || RecordingMemory { capacity: 0, ..good() };
        let wide = || RecordingMemory { terms: std::vec![0.0; 3], ..good() };
        let changing = || RecordingMemory { leading_is_constant: false, ..good() };
        let (mut known, mut scratch) = ([0.0; 2], [0.0; 2]);

        assert_eq!(with(good(), good()).check(2, 1, 0.5), Ok(()));
        assert!(with(wide(), good()).check(2, 1, 0.5).is_err());
        assert!(with(good(), wide()).check(2, 1, 0.5).is_err());

        assert!(with(good(), good()).leading_is_constant());
        assert!(!with(changing(), good()).leading_is_constant());
        assert!(!with(good(), changing()).leading_is_constant());

        let refused = Err(MemoryError::Full { capacity: 0 });
        for mut damping in [with(full(), good()), with(good(), full())] {
            assert_eq!(damping.add_known(&sample(1), &mut known, &mut scratch), refused);
            assert_eq!(damping.push(&sample(1), &INCREMENTS[..2], &mut scratch), refused);
        }

        let mut damping = with(good(), good());
        damping.push(&sample(1), &INCREMENTS[..2], &mut scratch).unwrap();
        assert_eq!(samples(&damping), [1, 1]);
        damping.begin(&FROM, &[0.0; 2]);
        assert_eq!(samples(&damping), [0, 0]);
    }

    #[test]
    fn several_dampings_are_asked_one_after_the_other() {
        let term = |memory| term(RHO[0], memory);
        let count = |term: &Term<RecordingMemory>| term.memory().len();
        assert_both_are_asked(|one, other| (term(one), term(other)), |pair| [count(&pair.0), count(&pair.1)]);
        assert_both_are_asked(
            |one, other| [term(one), term(other)],
            |pair| [count(&pair[0]), count(&pair[1])],
        );
        assert_both_are_asked(
            |one, other| &mut *std::vec![term(one), term(other)].leak(),
            |pair| [count(&pair[0]), count(&pair[1])],
        );
        assert!(Damping::<f64, Fixed<2>>::leading_is_constant(&()));
    }

    #[test]
    fn a_damping_names_its_parts() {
        let shown = std::format!("{:?}", term(RHO[0], told(1, &[1.0], 0.0)));
        for part in ["DampingTerm", "coefficients: Dense", "motion: DampedMotion"] {
            assert!(shown.contains(part), "{shown}");
        }
    }

    type Saved<'a> = Term<FixedDirect<'a, f64, 2, 4>>;

    fn bytes(damping: &impl Damping<f64, Fixed<2>>) -> Vec<u8> {
        let mut bytes = std::vec![0; damping.state_bytes()];
        let mut writer = StateWriter::new(&mut bytes);
        damping.save(&mut writer).unwrap();
        assert_eq!(writer.written(), damping.state_bytes());
        bytes
    }

    /// Asserts that a truncated state is refused and changes no damping, not even the first.
    fn assert_taken_whole<D: Damping<f64, Fixed<2>>>(of: impl Fn(Saved<'static>, Saved<'static>) -> D) {
        let fed = |count: usize, start: f64| {
            let memory = FixedDirect::full_memory(&[1.0, 0.5, 0.25, 0.125], 1.0).unwrap();
            let mut damping = term(RHO[0], memory);
            Damping::begin(&mut damping, &[start, 0.0], &[0.0, start]);
            for _ in 0..count {
                Damping::push(&mut damping, &sample(1), &INCREMENTS[..2], &mut [0.0; 2]).unwrap();
            }
            damping
        };
        let state = bytes(&of(fed(1, 1.0), fed(3, 2.0)));
        let mut damping = of(fed(2, 3.0), fed(0, 4.0));
        let before = bytes(&damping);
        for length in 0..state.len() {
            let cut = &state[..length];
            assert!(damping.check_state(&mut StateReader::new(cut)).is_err(), "{length} bytes");
            assert!(damping.restore(&mut StateReader::new(cut)).is_err(), "{length} bytes");
            assert_eq!(bytes(&damping), before, "{length} bytes");
        }
        let mut reader = StateReader::new(&state);
        damping.check_state(&mut reader).unwrap();
        reader.finish().unwrap();
        damping.restore(&mut StateReader::new(&state)).unwrap();
        assert_eq!(bytes(&damping), state);
    }

    #[test]
    fn saved_dampings_are_taken_whole_or_not_at_all() {
        assert_taken_whole(|one, _| one);
        assert_taken_whole(|one, other| (one, other));
        assert_taken_whole(|one, other| [one, other]);
        assert_taken_whole(|one, other| &mut *std::vec![one, other].leak());
    }

    /// A force ρ q̇ of the current step, without memory.
    struct Viscous;

    impl Stateful for Viscous {}

    impl Damping<f64, Fixed<1>> for Viscous {
        fn check(&self, _: usize, _: usize, _: f64) -> Result<(), Mismatch> {
            Ok(())
        }

        fn begin(&mut self, _: &[f64], _: &[f64]) {}

        fn begin_at(&mut self, _: f64) {}

        fn add_known(
            &mut self,
            _: &Sample<'_, f64>,
            _: &mut [f64],
            _: &mut [f64],
        ) -> Result<(), MemoryError> {
            Ok(())
        }

        fn add_leading(&self, increments: &[f64], force: &mut [f64], _: &mut [f64]) {
            add_multiple(force, 10.0, increments);
        }

        fn visit_leading(&self, _: usize, mut visit: impl FnMut(usize, usize, f64, &Coefficients<f64, 1>)) {
            visit(0, 0, 10.0, &Coefficients::Diagonal([1.0].into()));
        }

        fn leading_is_constant(&self) -> bool {
            true
        }

        fn push(&mut self, _: &Sample<'_, f64>, _: &[f64], _: &mut [f64]) -> Result<(), MemoryError> {
            Ok(())
        }
    }

    #[test]
    fn a_damping_of_ones_own_that_cannot_be_saved_says_so() {
        assert_eq!(Viscous.state_bytes(), 0);
        assert_eq!(Viscous.save(&mut StateWriter::new(&mut [])), Err(StateError::Unsupported));
        assert_eq!(Viscous.check_state(&mut StateReader::new(&[])), Err(StateError::Unsupported));
        assert_eq!(Viscous.restore(&mut StateReader::new(&[])), Err(StateError::Unsupported));
    }
}
