//! Fractional damping: coefficients, order, and the memory that it needs.

use core::fmt;

use crate::coefficients::{Coefficients, Fixed};
use crate::error::{MatrixError, ParameterError};
use crate::kernel::Kernel;
use crate::linear::add_multiple;
use crate::memory::{ActsOn, Memory, MemoryError};
use crate::real::Real;
use crate::saving::{Shape, StateError, StateReader, StateWriter, header_bytes};
use crate::space::{Block, Space, vectors, vectors_mut};

/// On what the fractional derivative acts.
///
/// The two types agree where the terms left out vanish (\[JO\] eq. 4). With q₀ ≠ 0 and 0 < β < 1 the
/// Riemann–Liouville type has the force ρ q₀ t^{−β}/Γ(1−β), singular at t = 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Derivative {
    /// On q itself.
    RiemannLiouville,
    /// On q − q₀ for 0 < β ≤ 1, on q − q₀ − v₀ t for 1 < β < 2, with v₀ = M⁻¹ p₀; on q itself for β = 0.
    Caputo,
}

/// The sample to come, as far as it is known before the step is solved: R nodes of step k, at q_k + e_1, …,
/// q_k + e_R and the times t_k + c_1 h, …, t_k + c_R h.
///
/// Vectors of R·N numbers have one node after another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<'a, T> {
    /// Main node q_k at the beginning of the step.
    pub from: &'a [T],
    /// q_k − X_{k−1,i}: how far the nodes of the sample before lie behind q_k, R·N numbers. Empty where they
    /// end at q_k, as main nodes do.
    pub behind: &'a [T],
    /// t_k.
    pub time: T,
    /// h; zero for the first main node, to which no step leads.
    pub length: T,
    /// c_1, …, c_R.
    pub fractions: &'a [T],
}

/// Damping with memory: anything between no damping and many terms.
///
/// A sample holds R nodes: one where the memory stores the main nodes q_k, and as many as there are
/// quadrature nodes where it stores those. With the nodes of the sample to come at q_k + e_1, …, q_k + e_R
/// the damping exerts
///
/// ```text
/// Σ_m ρ_m (D^{β_m} q)_i = known_i + Σ_m ρ_m Σ_j W_ij e_j ,     i = 1…R
/// ```
///
/// and the force on the system is minus this. Vectors of R·N numbers have one node after another. `()` is no
/// damping, [`DampingTerm`] one term, and tuples, arrays and mutable slices of dampings act together.
pub trait Damping<T: Real, X: Space<T>> {
    /// Checks that the memories fit N coordinates and R nodes, and the kernels the step size.
    ///
    /// # Errors
    /// [`Mismatch`] if one does not.
    fn check(&self, coordinates: usize, nodes: usize, step_size: T) -> Result<(), Mismatch>;

    /// Forgets everything and notes how the motion starts.
    fn begin(&mut self, position: &[T], velocity: &[T]);

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

    /// Shows every W_ij ρ_m that is not zero, as (i, j, W_ij, ρ_m), for a sample of `nodes` nodes.
    fn visit_leading(&self, nodes: usize, visit: impl FnMut(usize, usize, T, &X::Block));

    /// Whether the leading weights of all later steps are those of the step to come.
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

    /// Number of bytes that [`save`](Damping::save) writes at present.
    fn state_bytes(&self) -> usize {
        0
    }

    /// Writes the state, so that a damping made alike that [`restore`](Damping::restore)s it goes on with the
    /// same bits.
    ///
    /// # Errors
    /// [`StateError::NoRoom`], and [`StateError::Unsupported`] for dampings that do not offer it.
    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        let _ = to;
        Err(StateError::Unsupported)
    }

    /// Reads past a state and checks on the way that [`restore`](Damping::restore) would take it.
    ///
    /// # Errors
    /// [`StateError`]
    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let _ = from;
        Err(StateError::Unsupported)
    }

    /// Takes over a saved state in place of its own.
    ///
    /// # Errors
    /// [`StateError`] if the bytes are not the state of such a damping; it is as before.
    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let _ = from;
        Err(StateError::Unsupported)
    }
}

/// Why a damping does not go with an integrator.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Mismatch {
    /// A memory has another number of channels or stages than the system and the scheme need.
    Shape {
        /// Channels needed, N·R.
        channels_needed: usize,
        /// Channels of the memory.
        channels: usize,
        /// Stages needed, R.
        stages_needed: usize,
        /// Stages of the memory's kernel.
        stages: usize,
    },
    /// The kernel is for another step size.
    StepSize {
        /// The step size of the kernel.
        kernel: f64,
        /// The step size of the integrator.
        integrator: f64,
    },
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Shape { channels_needed, channels, stages_needed, stages } => write!(
                f,
                "a memory has {channels} channels and {stages} stages where {channels_needed} and {stages_needed} are needed"
            ),
            Self::StepSize { kernel, integrator } => write!(
                f,
                "a damping term has the kernel of step size {kernel}, the integrator makes steps of {integrator}"
            ),
        }
    }
}

impl core::error::Error for Mismatch {}

/// Why a damping term cannot be made.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum DampingError {
    /// The damping order is outside [0, 2).
    Order(ParameterError),
    /// The coefficients are not finite, not symmetric or not positive semidefinite.
    Coefficients(MatrixError),
    /// The memory is not one of the kernel.
    Kernel(ParameterError),
}

impl fmt::Display for DampingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Order(error) => error.fmt(f),
            Self::Coefficients(error) => write!(f, "damping coefficient: {error}"),
            Self::Kernel(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for DampingError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        Some(match self {
            Self::Order(error) | Self::Kernel(error) => error,
            Self::Coefficients(error) => error,
        })
    }
}

/// One damping term ρ D₋^β q with its memory.
///
/// ρ is symmetric positive semidefinite; β = 2α is the damping order, 0 ≤ β < 2 (α is the order in the
/// Lagrangian). The [`Kernel`] of the memory says what β and the step size are.
///
/// The memory has one channel for each coordinate and node. A kernel of plain numbers acts on the sequence of
/// every node by itself; one of R×R matrices couples the R nodes. The memory says which differences of the
/// motion it wants ([`ActsOn`]); they come from the solved increments e_i, and those of Caputo's type begin
/// with zero where those of Riemann–Liouville's begin with q₀. Source: \[JO\] eq. 1, 34a; \[HJO\] eq. 34a,
/// 35.
#[derive(Clone, Copy, Debug)]
pub struct DampingTerm<T: Real, X: Space<T>, M> {
    coefficients: X::Block,
    start: Subtraction,
    initial_position: X::Vector,
    initial_velocity: X::Vector,
    /// Of the kernel; zero if the caller vouches for it.
    step_size: T,
    memory: M,
}

/// Part of the motion on which a term does not act.
#[derive(Clone, Copy, Debug)]
enum Subtraction {
    Nothing,
    Position,
    PositionAndVelocity,
}

impl<T: Real, const N: usize, M: Memory<T>> DampingTerm<T, Fixed<N>, M> {
    /// The term ρ D^β q on a memory of the given kernel, that of s^β.
    ///
    /// # Errors
    /// If β is outside [0, 2), ρ is not finite, symmetric and positive semidefinite, or the memory is not one
    /// of the kernel.
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
        mut memory: M,
    ) -> Result<Self, DampingError> {
        let damping_order = kernel.exponent();
        ParameterError::check(
            (0.0..2.0).contains(&damping_order),
            "damping order",
            damping_order,
            "at least 0 and less than 2",
        )
        .map_err(DampingError::Order)?;
        coefficients.check_positive_semidefinite().map_err(DampingError::Coefficients)?;
        kernel.check(&mut memory).map_err(DampingError::Kernel)?;
        let start = match derivative {
            Derivative::RiemannLiouville => Subtraction::Nothing,
            Derivative::Caputo if damping_order == 0.0 => Subtraction::Nothing,
            Derivative::Caputo if damping_order <= 1.0 => Subtraction::Position,
            Derivative::Caputo => Subtraction::PositionAndVelocity,
        };
        let (initial_position, initial_velocity) = (space.zeros(), space.zeros());
        let step_size = kernel.step_size().map_or(T::zero(), T::of);
        Ok(Self { coefficients, start, initial_position, initial_velocity, step_size, memory })
    }
}

impl<T: Real, X: Space<T>, M> DampingTerm<T, X, M> {
    /// The memory.
    pub fn memory(&self) -> &M {
        &self.memory
    }
}

impl<T: Real, X: Space<T>, M: Memory<T>> DampingTerm<T, X, M> {
    /// What its state begins with.
    fn shape(&self) -> Shape<3> {
        let left_out = match self.start {
            Subtraction::Nothing => 0,
            Subtraction::Position => 1,
            Subtraction::PositionAndVelocity => 2,
        };
        let coordinates = X::slice(&self.initial_position).len() as u64;
        let acts_on = self.memory.acts_on() as u64;
        [("coordinates", coordinates), ("kind of derivative", left_out), ("kind of samples", acts_on)]
    }

    /// Adds `factor` times what node j of the sample would give to the memory's signal if it lay at q_k.
    ///
    /// With the increment e_j added that is what the memory stores. Of increments and rises nothing is
    /// subtracted that the solver does not know by itself.
    #[inline(always)]
    fn add_offset(&self, sample: &Sample<'_, T>, j: usize, factor: T, out: &mut [T]) {
        let velocity = X::slice(&self.initial_velocity);
        let into = sample.fractions.get(j).map_or(T::zero(), |&fraction| fraction * sample.length);
        let first = self.memory.is_empty();
        let (position, lapse) = match self.memory.acts_on() {
            ActsOn::Values => {
                let time = sample.time + into;
                let numbers = sample.from.iter().zip(X::slice(&self.initial_position).iter().zip(velocity));
                for (out, (&position, (&initial, &velocity))) in out.iter_mut().zip(numbers) {
                    *out += factor
                        * match self.start {
                            Subtraction::Nothing => position,
                            Subtraction::Position => position - initial,
                            Subtraction::PositionAndVelocity => position - initial - velocity * time,
                        };
                }
                return;
            }
            ActsOn::Increments | ActsOn::Rises if first => {
                let from_rest = !matches!(self.start, Subtraction::Nothing);
                (if from_rest { &[] } else { sample.from }, sample.time + into)
            }
            ActsOn::Increments => {
                (vectors(sample.behind, sample.from.len()).nth(j).unwrap_or(&[]), sample.length)
            }
            ActsOn::Rises => (&[][..], into),
        };
        add_multiple(out, factor, position);
        if let Subtraction::PositionAndVelocity = self.start {
            add_multiple(out, -(factor * lapse), velocity);
        }
    }

    /// W_ij, i and j from 0, of a sample with `nodes` nodes.
    #[inline(always)]
    fn leading(&self, nodes: usize, i: usize, j: usize) -> T {
        let stages = self.memory.stages();
        let index = if stages == nodes {
            i * stages + j
        } else if i == j {
            0
        } else {
            return T::zero();
        };
        self.memory.leading().get(index).copied().unwrap_or(T::zero())
    }
}

impl<T: Real, X: Space<T>, M: Memory<T>> Damping<T, X> for DampingTerm<T, X, M> {
    fn check(&self, coordinates: usize, nodes: usize, step_size: T) -> Result<(), Mismatch> {
        let (channels, stages) = (self.memory.channels(), self.memory.stages());
        let channels_needed = coordinates * nodes;
        if channels != channels_needed || (stages != nodes && stages != 1) {
            return Err(Mismatch::Shape { channels_needed, channels, stages_needed: nodes, stages });
        }
        if self.step_size != T::zero() && self.step_size != step_size {
            let (kernel, integrator) = (self.step_size.to_f64(), step_size.to_f64());
            return Err(Mismatch::StepSize { kernel, integrator });
        }
        Ok(())
    }

    fn begin(&mut self, position: &[T], velocity: &[T]) {
        self.memory.clear();
        copy(X::slice_mut(&mut self.initial_position), position);
        copy(X::slice_mut(&mut self.initial_velocity), velocity);
    }

    #[inline(always)]
    fn add_known(
        &mut self,
        sample: &Sample<'_, T>,
        known: &mut [T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        if self.step_size != T::zero() && self.step_size != sample.length {
            return Err(MemoryError::StepLength);
        }
        self.memory.begin_step(sample.length)?;
        let (coordinates, nodes) = (sample.from.len(), sample.fractions.len());
        let (term, rest) = scratch.split_at_mut_checked(coordinates * nodes).unwrap_or_default();
        self.memory.next_term(term)?;
        if nodes == 1 {
            self.add_offset(sample, 0, self.leading(1, 0, 0), term);
            self.coefficients.multiply_add(T::one(), term, known);
            return Ok(());
        }
        let sum = rest.get_mut(..coordinates).unwrap_or(&mut []);
        for (i, known) in vectors_mut(known, coordinates).enumerate() {
            // Node i of every coordinate.
            for (sum, stages) in sum.iter_mut().zip(vectors(term, nodes)) {
                *sum = stages.get(i).copied().unwrap_or(T::zero());
            }
            for j in 0..nodes {
                let weight = self.leading(nodes, i, j);
                if weight != T::zero() {
                    self.add_offset(sample, j, weight, sum);
                }
            }
            self.coefficients.multiply_add(T::one(), sum, known);
        }
        Ok(())
    }

    #[inline(always)]
    fn add_leading(&self, increments: &[T], force: &mut [T], scratch: &mut [T]) {
        let coordinates = X::slice(&self.initial_position).len();
        if increments.len() == coordinates {
            return self.coefficients.multiply_add(self.leading(1, 0, 0), increments, force);
        }
        let sum = scratch.get_mut(..coordinates).unwrap_or(&mut []);
        let nodes = vectors(increments, coordinates).count();
        for (i, force) in vectors_mut(force, coordinates).enumerate() {
            sum.fill(T::zero());
            for (j, increment) in vectors(increments, coordinates).enumerate() {
                add_multiple(sum, self.leading(nodes, i, j), increment);
            }
            self.coefficients.multiply_add(T::one(), sum, force);
        }
    }

    #[inline(always)]
    fn visit_leading(&self, nodes: usize, mut visit: impl FnMut(usize, usize, T, &X::Block)) {
        for i in 0..nodes {
            for j in 0..nodes {
                let weight = self.leading(nodes, i, j);
                if weight != T::zero() {
                    visit(i, j, weight, &self.coefficients);
                }
            }
        }
    }

    #[inline(always)]
    fn leading_is_constant(&self) -> bool {
        self.memory.leading_is_constant()
    }

    #[inline(always)]
    fn push(
        &mut self,
        sample: &Sample<'_, T>,
        increments: &[T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        let (coordinates, nodes) = (sample.from.len(), sample.fractions.len());
        let (stored, rest) = scratch.split_at_mut_checked(coordinates * nodes).unwrap_or_default();
        if nodes == 1 {
            let ends_at_node = sample.behind.is_empty() && !self.memory.is_empty();
            let without_drift = !matches!(self.start, Subtraction::PositionAndVelocity);
            if self.memory.acts_on() == ActsOn::Increments && ends_at_node && without_drift {
                // The increments themselves are the sample.
                return self.memory.push(increments);
            }
            copy(stored, increments);
            self.add_offset(sample, 0, T::one(), stored);
            return self.memory.push(stored);
        }
        let node = rest.get_mut(..coordinates).unwrap_or(&mut []);
        for (stage, increment) in vectors(increments, coordinates).enumerate() {
            copy(node, increment);
            self.add_offset(sample, stage, T::one(), node);
            for (stages, &number) in vectors_mut(stored, nodes).zip(&*node) {
                if let Some(place) = stages.get_mut(stage) {
                    *place = number;
                }
            }
        }
        self.memory.push(stored)
    }

    fn state_bytes(&self) -> usize {
        let coordinates = X::slice(&self.initial_position).len();
        header_bytes(3) + 2 * coordinates * T::BYTES + self.memory.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 3>(TAG, &self.shape())?;
        to.numbers(X::slice(&self.initial_position))?;
        to.numbers(X::slice(&self.initial_velocity))?;
        self.memory.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.header::<T, 3>(TAG, &self.shape())?;
        from.skip::<T>(2 * X::slice(&self.initial_position).len())?;
        self.memory.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        from.header::<T, 3>(TAG, &self.shape())?;
        from.numbers(X::slice_mut(&mut self.initial_position))?;
        from.numbers(X::slice_mut(&mut self.initial_velocity))?;
        self.memory.restore(from)
    }
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"damp";

#[inline]
fn copy<T: Copy>(target: &mut [T], source: &[T]) {
    target.iter_mut().zip(source).for_each(|(place, &number)| *place = number);
}

impl<T: Real, X: Space<T>> Damping<T, X> for () {
    fn check(&self, _: usize, _: usize, _: T) -> Result<(), Mismatch> {
        Ok(())
    }

    fn begin(&mut self, _: &[T], _: &[T]) {}

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

    fn save(&self, _: &mut StateWriter<'_>) -> Result<(), StateError> {
        Ok(())
    }

    fn check_state(&self, _: &mut StateReader<'_>) -> Result<(), StateError> {
        Ok(())
    }

    fn restore(&mut self, _: &mut StateReader<'_>) -> Result<(), StateError> {
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

    fn state_bytes(&self) -> usize {
        self.0.state_bytes() + self.1.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.0.save(to)?;
        self.1.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.0.check_state(from)?;
        self.1.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        self.0.restore(from)?;
        self.1.restore(from)
    }
}

impl<T: Real, X: Space<T>, D: Damping<T, X>> Damping<T, X> for [D] {
    fn check(&self, coordinates: usize, nodes: usize, step_size: T) -> Result<(), Mismatch> {
        self.iter().try_for_each(|damping| damping.check(coordinates, nodes, step_size))
    }

    fn begin(&mut self, position: &[T], velocity: &[T]) {
        self.iter_mut().for_each(|damping| damping.begin(position, velocity));
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

    fn state_bytes(&self) -> usize {
        self.iter().map(|damping| damping.state_bytes()).sum()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.iter().try_for_each(|damping| damping.save(to))
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.iter().try_for_each(|damping| damping.check_state(from))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        self.iter_mut().try_for_each(|damping| damping.restore(from))
    }
}

/// A damping that hands every call on to the one it holds.
macro_rules! handing_on {
    ($({$($generics:tt)*})? $holder:ty, $inner:ty, $self:ident => $shared:expr, $unique:expr) => {
        impl<T: Real, X: Space<T>, D: Damping<T, X> $(, $($generics)*)?> Damping<T, X> for $holder {
            fn check(&$self, coordinates: usize, nodes: usize, step_size: T) -> Result<(), Mismatch> {
                <$inner as Damping<T, X>>::check($shared, coordinates, nodes, step_size)
            }

            fn begin(&mut $self, position: &[T], velocity: &[T]) {
                <$inner as Damping<T, X>>::begin($unique, position, velocity);
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

            fn state_bytes(&$self) -> usize {
                <$inner as Damping<T, X>>::state_bytes($shared)
            }

            fn save(&$self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
                <$inner as Damping<T, X>>::save($shared, to)
            }

            fn check_state(&$self, from: &mut StateReader<'_>) -> Result<(), StateError> {
                <$inner as Damping<T, X>>::check_state($shared, from)
            }

            fn restore(&mut $self, from: &mut StateReader<'_>) -> Result<(), StateError> {
                <$inner as Damping<T, X>>::restore($unique, from)
            }
        }
    };
}

handing_on!({const K: usize} [D; K], [D], self => self.as_slice(), self.as_mut_slice());
handing_on!(&mut [D], [D], self => &**self, &mut **self);
