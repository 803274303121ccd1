//! The motion that a damping acts on, and the samples of it that its memory stores.

use core::fmt;

use crate::error::{MatrixError, ParameterError};
use crate::kernel::{Kernel, Symbol};
use crate::linear::add_multiple;
use crate::memory::{ActsOn, Memory, MemoryError};
use crate::real::Real;
use crate::saving::{Shape, StateError, StateReader, StateWriter, Stateful, header_bytes};
use crate::space::{Space, part_mut, parts_mut, vectors, vectors_mut};

/// On what the fractional derivative acts.
///
/// The two types agree where the terms left out vanish (\[JO\] eq. 4). With q₀ ≠ 0 and 0 < β < 1 the
/// Riemann–Liouville type has the force ρ q₀ t^{−β}/Γ(1−β), singular at t = 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Derivative {
    /// On q itself.
    RiemannLiouville,
    /// On q − q₀ for 0 < β ≤ 1, on q − q₀ − v₀ t for 1 < β < 2, with v₀ = M⁻¹ p₀; on q itself for β = 0. A
    /// symbol other than s^β acts on q − q₀, on q − q₀ − v₀ t where it grows faster than s.
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
    /// q_k − X_{k−1,i}, the offsets of q_k from the nodes of the previous sample, R·N numbers; before the
    /// first sample those from the rest of Caputo's type, zero unless the position jumped. Empty if the
    /// previous sample is the main node q_k.
    pub behind: &'a [T],
    /// t_k.
    pub time: T,
    /// h; zero for the first main node, to which no step leads.
    pub length: T,
    /// c_1, …, c_R.
    pub fractions: &'a [T],
}

/// The motion X that a damping acts on, with the memory that stores its samples and supplies the derivatives
/// D^β X: a damping term without its coefficient ρ.
///
/// The memory has one channel for each coordinate and node. A kernel of plain numbers acts on the sequence of
/// every node by itself; one of R×R matrices couples the R nodes. [`ActsOn`] of the memory selects the
/// samples: values of the motion or differences, which come from the solved increments e_i. The differences
/// of Caputo's type begin with zero, those of Riemann–Liouville's with q₀. A memory of several kernels
/// ([`Memory::kernels`]) supplies one derivative for each, for dampings of different orders on the same
/// coordinates.
///
/// With the nodes of the sample to come at q_k + e_1, …, q_k + e_R and the weights W of a kernel
///
/// ```text
/// (D^β X)_i = known_i + Σ_j W_ij e_j .
/// ```
///
/// Source: \[JO\] eq. 1, 34a; \[HJO\] eq. 34a, 35.
#[derive(Clone, Copy, Debug)]
pub struct DampedMotion<T: Real, X: Space<T>, M> {
    start: Subtraction,
    initial_position: X::Vector,
    initial_velocity: X::Vector,
    /// Step size of the kernels; zero if it is the caller's responsibility.
    step_size: T,
    memory: M,
}

/// Part of the motion that is subtracted before the derivatives are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subtraction {
    /// None: derivatives act on the motion itself.
    Nothing,
    /// Where it begins.
    Position,
    /// The line along which it begins.
    PositionAndVelocity,
}

impl Subtraction {
    /// What a type of derivative subtracts for a symbol.
    pub fn of(derivative: Derivative, symbol: Symbol) -> Self {
        match derivative {
            Derivative::RiemannLiouville => Self::Nothing,
            Derivative::Caputo if symbol == (Symbol::Power { exponent: 0.0 }) => Self::Nothing,
            Derivative::Caputo if symbol.growth() <= 1.0 => Self::Position,
            Derivative::Caputo => Self::PositionAndVelocity,
        }
    }
}

impl<T: Real, X: Space<T>, M: Memory<T>> DampedMotion<T, X, M> {
    /// The motion on a memory of the given kernels.
    ///
    /// # Errors
    /// If a β is outside [0, 2), two kernels subtract different parts of the motion or have different step
    /// sizes, or the weights of the memory are not those of the kernels.
    #[inline(always)]
    pub fn new(
        space: &X,
        kernels: &[Kernel],
        derivative: Derivative,
        mut memory: M,
    ) -> Result<Self, DampingError> {
        let (mut start, mut step_size) = (None, None);
        for (index, kernel) in kernels.iter().enumerate() {
            let damping_order = kernel.symbol().growth();
            let order = |accepted, allowed| {
                ParameterError::check(accepted, "damping order", damping_order, allowed)
                    .map_err(DampingError::Order)
            };
            order((0.0..2.0).contains(&damping_order), "at least 0 and less than 2")?;
            let own = Subtraction::of(derivative, kernel.symbol());
            let same = *start.get_or_insert(own) == own;
            order(
                same,
                "of Caputo's type all 0, all up to 1 or all above where a memory has several kernels",
            )?;
            let same = *step_size.get_or_insert(kernel.step_size()) == kernel.step_size();
            let (steps, step) = ("step size", kernel.step_size().unwrap_or(f64::NAN));
            ParameterError::check(same, steps, step, "that of the memory's other kernels")
                .map_err(DampingError::Kernel)?;
            kernel.check(&mut memory, index).map_err(DampingError::Kernel)?;
        }
        let (found, allowed) = (kernels.len(), "as many as the memory has");
        ParameterError::check(memory.kernels() == found && found > 0, "kernels", found as f64, allowed)
            .map_err(DampingError::Kernel)?;
        Ok(Self {
            start: start.unwrap_or(Subtraction::Nothing),
            initial_position: space.zeros(),
            initial_velocity: space.zeros(),
            step_size: step_size.flatten().map_or(T::zero(), T::of),
            memory,
        })
    }

    /// Checks that the memory fits N coordinates and R nodes, and the kernels the step size.
    ///
    /// # Errors
    /// [`Mismatch`] if one does not.
    pub fn check(&self, coordinates: usize, nodes: usize, step_size: T) -> Result<(), Mismatch> {
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

    /// Clears the memory and stores the initial position and velocity.
    pub fn begin(&mut self, position: &[T], velocity: &[T]) {
        self.memory.clear();
        copy(X::slice_mut(&mut self.initial_position), position);
        copy(X::slice_mut(&mut self.initial_velocity), velocity);
    }

    /// Sets a start time t₀ other than 0: the line that Caputo's type subtracts for β > 1 is then q₀ + v₀ (t
    /// − t₀).
    pub fn begin_at(&mut self, time: T) {
        if let Subtraction::PositionAndVelocity = self.start {
            add_multiple(X::slice_mut(&mut self.initial_position), -time, X::slice(&self.initial_velocity));
        }
    }

    /// Writes the memory terms, R·N numbers for each kernel: the known part of the derivatives without the
    /// offsets of the nodes.
    ///
    /// # Errors
    /// [`MemoryError::Full`] if the sample to come could not be stored, [`MemoryError::StepLength`] if the
    /// kernels are for another step size.
    #[inline(always)]
    pub fn memory_terms(&mut self, sample: &Sample<'_, T>, terms: &mut [T]) -> Result<(), MemoryError> {
        if self.step_size != T::zero() && self.step_size != sample.length {
            return Err(MemoryError::StepLength);
        }
        self.memory.begin_step(sample.length)?;
        self.memory.next_term(terms)
    }

    /// Completes the memory term of a kernel, for a sample of one node, to the known part of its derivative.
    #[inline(always)]
    pub fn complete(&self, kernel: usize, sample: &Sample<'_, T>, term: &mut [T]) {
        self.add_offset(sample, 0, self.leading(kernel, 1, 0, 0), term);
    }

    /// Writes known_i for (kernel, node i), for a sample of several nodes, from the memory terms of that
    /// kernel.
    #[inline(always)]
    pub fn complete_node(
        &self,
        (kernel, i): (usize, usize),
        sample: &Sample<'_, T>,
        term: &[T],
        known: &mut [T],
    ) {
        let nodes = sample.fractions.len();
        // Node i of every coordinate.
        for (known, stages) in known.iter_mut().zip(vectors(term, nodes)) {
            *known = stages.get(i).copied().unwrap_or(T::zero());
        }
        for j in 0..nodes {
            let weight = self.leading(kernel, nodes, i, j);
            if weight != T::zero() {
                self.add_offset(sample, j, weight, known);
            }
        }
    }

    /// W_ij of a kernel, i and j from 0, for a sample of `nodes` nodes.
    #[inline(always)]
    pub fn leading(&self, kernel: usize, nodes: usize, i: usize, j: usize) -> T {
        let stages = self.memory.stages();
        let index = if stages == nodes {
            i * stages + j
        } else if i == j {
            0
        } else {
            return T::zero();
        };
        let index = kernel * (stages * stages) + index;
        self.memory.leading().get(index).copied().unwrap_or(T::zero())
    }

    /// Calls `visit(i, j, W_ij)` for every nonzero W_ij of a kernel.
    #[inline(always)]
    pub fn visit_leading(&self, kernel: usize, nodes: usize, mut visit: impl FnMut(usize, usize, T)) {
        for i in 0..nodes {
            for j in 0..nodes {
                let weight = self.leading(kernel, nodes, i, j);
                if weight != T::zero() {
                    visit(i, j, weight);
                }
            }
        }
    }

    /// Stores the sample, whose increments e_1, …, e_R are known now. `scratch` has R·N numbers, and N more
    /// where R > 1.
    ///
    /// # Errors
    /// [`MemoryError::Full`]; not after a successful [`memory_terms`](Self::memory_terms).
    #[inline(always)]
    pub fn push(
        &mut self,
        sample: &Sample<'_, T>,
        increments: &[T],
        scratch: &mut [T],
    ) -> Result<(), MemoryError> {
        let (coordinates, nodes) = (sample.from.len(), sample.fractions.len());
        let (stored, rest) = parts_mut(scratch, coordinates * nodes);
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
        let node = part_mut(rest, coordinates);
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

    /// Adds `factor` times the sample that node j would give the memory if it lay at q_k.
    ///
    /// The sample that the memory stores is this plus the increment e_j. For increments and rises it contains
    /// only differences that the solver has as such; none is formed by subtracting positions.
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
            ActsOn::Rises if !first => (&[][..], into),
            ActsOn::Increments | ActsOn::Rises => {
                // What lies behind a first sample is a jump of the position at the start.
                let behind = match self.start {
                    Subtraction::Nothing if first => sample.from,
                    _ => vectors(sample.behind, sample.from.len()).nth(j).unwrap_or_default(),
                };
                (behind, if first { into } else { sample.length })
            }
        };
        add_multiple(out, factor, position);
        if let Subtraction::PositionAndVelocity = self.start {
            add_multiple(out, -(factor * lapse), velocity);
        }
    }

    /// Header of the saved state: the values that must match when it is restored.
    fn shape(&self) -> Shape<3> {
        let left_out = match self.start {
            Subtraction::Nothing => 0,
            Subtraction::Position => 1,
            Subtraction::PositionAndVelocity => 2,
        };
        let acts_on = self.memory.acts_on() as u64;
        let coordinates = self.coordinates() as u64;
        [("coordinates", coordinates), ("kind of derivative", left_out), ("kind of samples", acts_on)]
    }
}

impl<T: Real, X: Space<T>, M: Memory<T>> Stateful for DampedMotion<T, X, M> {
    fn state_bytes(&self) -> usize {
        header_bytes(3) + 2 * self.coordinates() * T::BYTES + self.memory.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 3>(TAG, &self.shape())?;
        to.numbers(X::slice(&self.initial_position))?;
        to.numbers(X::slice(&self.initial_velocity))?;
        self.memory.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.header::<T, 3>(TAG, &self.shape())?;
        from.skip::<T>(2 * self.coordinates())?;
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

impl<T: Real, X: Space<T>, M> DampedMotion<T, X, M> {
    /// The memory.
    pub fn memory(&self) -> &M {
        &self.memory
    }

    /// Number of coordinates N.
    #[inline(always)]
    pub fn coordinates(&self) -> usize {
        X::slice(&self.initial_position).len()
    }
}

/// Reason why a damping does not fit an integrator.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum DampingError {
    /// The damping order is outside [0, 2).
    Order(ParameterError),
    /// The coefficients are not finite, not symmetric or not positive semidefinite.
    Coefficients(MatrixError),
    /// The weights of the memory are not those of the kernel.
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

/// Kind of the saved state.
const TAG: [u8; 4] = *b"damp";

#[inline]
fn copy<T: Copy>(target: &mut [T], source: &[T]) {
    target.iter_mut().zip(source).for_each(|(place, &number)| *place = number);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coefficients::Fixed;
    use crate::direct::FixedDirect;
    use crate::memory::check_channels;
    use crate::recording_memory::RecordingMemory;
    use crate::weights::{BdfOrder, leading_bdf_weight};
    use std::vec::Vec;

    /// Two kernels on one channel with a leading weight only, without memory.
    struct Leading([f64; 2]);

    impl Memory<f64> for Leading {
        fn channels(&self) -> usize {
            1
        }

        fn kernels(&self) -> usize {
            2
        }

        fn leading(&self) -> &[f64] {
            &self.0
        }

        fn len(&self) -> usize {
            0
        }

        fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
            term.fill(0.0);
            check_channels(2, term.len())
        }

        fn push(&mut self, _: &[f64]) -> Result<(), MemoryError> {
            Ok(())
        }

        fn clear(&mut self) {}

        fn bytes(&self) -> usize {
            16
        }
    }

    impl Stateful for Leading {}

    fn kernel(exponent: f64, step_size: f64) -> Kernel {
        Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, exponent, step_size).unwrap()
    }

    fn motion(
        kernels: &[Kernel],
        derivative: Derivative,
    ) -> Result<DampedMotion<f64, Fixed<1>, Leading>, DampingError> {
        let leading = [0.3, 1.4]
            .map(|exponent| leading_bdf_weight(BdfOrder::GRUNWALD_LETNIKOV, exponent, 0.1).unwrap());
        DampedMotion::new(&Fixed, kernels, derivative, Leading(leading))
    }

    #[test]
    fn every_kernel_of_a_memory_has_its_own_leading_weight() {
        let kernels = [kernel(0.3, 0.1), kernel(1.4, 0.1)];
        let mut motion = motion(&kernels, Derivative::RiemannLiouville).unwrap();
        motion.begin(&[2.0], &[0.0]);
        let sample = Sample { from: &[2.0], behind: &[], time: 0.0, length: 0.1, fractions: &[0.5] };
        let mut terms = [f64::NAN; 2];
        motion.memory_terms(&sample, &mut terms).unwrap();
        for (index, (term, exponent)) in terms.iter_mut().zip([0.3, 1.4]).enumerate() {
            motion.complete(index, &sample, core::slice::from_mut(term));
            let weight = motion.leading(index, 1, 0, 0);
            assert!((weight * libm::pow(0.1, exponent) - 1.0).abs() < 1e-14, "{exponent}: {weight}");
            assert_eq!(*term, 2.0 * weight);
        }
    }

    #[test]
    fn kernels_that_cannot_share_samples_are_refused() {
        let refused = |kernels: &[Kernel], derivative| match motion(kernels, derivative).err() {
            Some(DampingError::Order(error) | DampingError::Kernel(error)) => error.parameter,
            _ => "",
        };
        let (low, high) = (kernel(0.3, 0.1), kernel(1.4, 0.1));
        assert_eq!(refused(&[low, high], Derivative::Caputo), "damping order");
        let liouville = Derivative::RiemannLiouville;
        assert_eq!(refused(&[low, high], liouville), "");
        assert_eq!(refused(&[low, kernel(1.4, 0.2)], liouville), "step size");
        assert_eq!(refused(&[high, low], liouville), "leading weight of the memory");
        assert_eq!(refused(&[low], liouville), "kernels");
        assert_eq!(refused(&[low, high, Kernel::given(0.5).unwrap()], liouville), "step size");
    }

    /// A motion of two coordinates with q(0) = (2, −1) and q̇(0) = (3, 0.5).
    fn position(time: f64) -> [f64; 2] {
        [2.0 + 3.0 * time - 2.0 * time * time, -1.0 + 0.5 * time + time.powi(3)]
    }

    /// Part of the motion that derivatives do not act on.
    fn left_out(derivative: Derivative, exponent: f64, time: f64) -> [f64; 2] {
        match derivative {
            Derivative::RiemannLiouville => [0.0; 2],
            Derivative::Caputo if exponent == 0.0 => [0.0; 2],
            Derivative::Caputo if exponent <= 1.0 => [2.0, -1.0],
            Derivative::Caputo => [2.0 + 3.0 * time, -1.0 + 0.5 * time],
        }
    }

    /// Pushes four samples of the motion to a memory of two kernels, and compares the samples that the memory
    /// receives and the known parts of the derivatives with their definitions. Nodes lie at `fractions` of
    /// the steps; without fractions samples are main nodes.
    fn assert_told(
        stages: usize,
        fractions: Option<&[f64]>,
        acts_on: ActsOn,
        derivative: Derivative,
        exponent: f64,
    ) {
        let (h, nodes) = (0.5, fractions.map_or(1, <[f64]>::len));
        let case = std::format!("{stages} stages, {fractions:?}, {acts_on:?}, {derivative:?}, {exponent}");
        // Zero entries are not visited.
        let leading = [3.0, 0.5, 0.0, -2.0, 1.5, -0.25, 0.75, 4.0][..2 * stages * stages].to_vec();
        let weight = |kernel: usize, i: usize, j: usize| match (stages == nodes, i == j) {
            (true, _) => leading[kernel * stages * stages + i * stages + j],
            (false, true) => leading[kernel],
            (false, false) => 0.0,
        };
        let terms: Vec<f64> = (0..4 * nodes).map(|place| 0.25 * place as f64 - 1.0).collect();
        let memory = RecordingMemory {
            stages,
            leading: leading.clone(),
            leading_is_constant: true,
            acts_on,
            terms: terms.clone(),
            capacity: 9,
            samples: Vec::new(),
        };
        let kernels = [Kernel::given(exponent).unwrap(); 2];
        let mut motion = DampedMotion::<f64, Fixed<2>, _>::new(&Fixed, &kernels, derivative, memory).unwrap();
        motion.begin(&[9.0; 2], &[9.0; 2]);
        let mut scratch = std::vec![f64::NAN; 2 * nodes + if nodes > 1 { 2 } else { 0 }];
        for _ in 0..2 {
            let sample =
                Sample { from: &[9.0; 2], behind: &[], time: 0.0, length: h, fractions: &[1.0; 2][..nodes] };
            motion.push(&sample, &std::vec![1.0; 2 * nodes], &mut scratch).unwrap();
        }
        // `begin` clears the memory.
        motion.begin(&position(0.0), &[3.0, 0.5]);
        let acted_on = |time: f64| {
            let (motion, less) = (position(time), left_out(derivative, exponent, time));
            [motion[0] - less[0], motion[1] - less[1]]
        };
        for k in 0..4 {
            let (start, length, fractions) = match (fractions, k) {
                (Some(fractions), _) => (h * k as f64, h, fractions),
                // Main nodes: the first is where the motion begins, the others are ends of steps.
                (None, 0) => (0.0, 0.0, &[0.0][..]),
                (None, _) => (h * (k - 1) as f64, h, &[1.0][..]),
            };
            let from = position(start);
            let times = fractions.iter().map(|fraction| start + fraction * length);
            let increments: Vec<f64> = times
                .clone()
                .flat_map(|time| [position(time)[0] - from[0], position(time)[1] - from[1]])
                .collect();
            let of_last = |time: f64| if k == 0 { from } else { position(time - h) };
            let behind: Vec<f64> = times
                .clone()
                .flat_map(|time| [from[0] - of_last(time)[0], from[1] - of_last(time)[1]])
                .collect();
            let behind = if motion_at_main_nodes(fractions, length) { &[][..] } else { &behind };
            let sample = Sample { from: &from, behind, time: start, length, fractions };
            // Coordinate by coordinate, the nodes of each side by side.
            let expected: Vec<f64> = (0..2)
                .flat_map(|coordinate| times.clone().map(move |time| (coordinate, time)))
                .map(|(coordinate, time)| {
                    let value = acted_on(time)[coordinate];
                    match acts_on {
                        _ if k == 0 => value,
                        ActsOn::Values => value,
                        ActsOn::Increments => value - acted_on(time - h)[coordinate],
                        ActsOn::Rises => value - acted_on(start)[coordinate],
                    }
                })
                .collect();
            let mut found = std::vec![f64::NAN; terms.len()];
            motion.memory_terms(&sample, &mut found).unwrap();
            for (kernel, found) in found.chunks_mut(2 * nodes).enumerate() {
                let term = &terms[2 * nodes * kernel..][..2 * nodes];
                let mut shown = std::vec![0.0; nodes * nodes];
                motion.visit_leading(kernel, nodes, |i, j, weight| shown[i * nodes + j] = weight);
                for i in 0..nodes {
                    let mut known = [f64::NAN; 2];
                    if nodes == 1 {
                        motion.complete(kernel, &sample, found);
                        known.copy_from_slice(found);
                    } else {
                        motion.complete_node((kernel, i), &sample, found, &mut known);
                    }
                    for (coordinate, known) in known.iter().enumerate() {
                        let (mut left, mut right) = (*known, term[coordinate * nodes + i]);
                        for j in 0..nodes {
                            left += shown[i * nodes + j] * increments[2 * j + coordinate];
                            right += weight(kernel, i, j) * expected[coordinate * nodes + j];
                        }
                        assert!((left - right).abs() < 1e-13, "{case}, sample {k}: {left} and {right}");
                    }
                }
            }
            motion.push(&sample, &increments, &mut scratch).unwrap();
            assert_eq!(motion.memory().samples.len(), k + 1, "{case}");
            for (&told, expected) in motion.memory().samples[k].iter().zip(expected) {
                assert!((told - expected).abs() < 1e-14, "{case}, sample {k}: {told}, not {expected}");
            }
        }
    }

    fn motion_at_main_nodes(fractions: &[f64], length: f64) -> bool {
        fractions == [1.0] || length == 0.0
    }

    #[test]
    fn a_memory_is_told_the_differences_that_it_wants_of_what_derivatives_act_on() {
        for acts_on in [ActsOn::Values, ActsOn::Increments, ActsOn::Rises] {
            let (liouville, caputo) = (Derivative::RiemannLiouville, Derivative::Caputo);
            for (derivative, exponent) in [
                (liouville, 0.5),
                (liouville, 1.5),
                (caputo, 0.0),
                (caputo, 0.5),
                (caputo, 1.0),
                (caputo, 1.5),
            ] {
                // The rise of a step that ends at a main node is its increment.
                if acts_on != ActsOn::Rises {
                    assert_told(1, None, acts_on, derivative, exponent);
                }
                assert_told(1, Some(&[0.5]), acts_on, derivative, exponent);
                assert_told(1, Some(&[0.25, 1.0]), acts_on, derivative, exponent);
                assert_told(2, Some(&[0.25, 1.0]), acts_on, derivative, exponent);
            }
        }
    }

    #[test]
    fn channels_stages_and_steps_must_be_those_of_the_scheme() {
        let told = |stages: usize, channels: usize| RecordingMemory {
            stages,
            leading: std::vec![1.0; stages * stages],
            leading_is_constant: true,
            acts_on: ActsOn::Values,
            terms: std::vec![0.0; channels],
            capacity: 1,
            samples: Vec::new(),
        };
        let check = |stages, channels, coordinates, nodes| {
            let kernels = [Kernel::given(0.5).unwrap()];
            let memory = told(stages, channels);
            let motion =
                DampedMotion::<f64, Fixed<2>, _>::new(&Fixed, &kernels, Derivative::Caputo, memory).unwrap();
            motion.check(coordinates, nodes, 0.1)
        };
        // Scalar weights fit any number of nodes, R×R matrices R nodes only.
        assert_eq!((check(1, 2, 2, 1), check(1, 6, 2, 3), check(3, 6, 2, 3)), (Ok(()), Ok(()), Ok(())));
        for (stages, channels, coordinates, nodes) in [(1, 3, 2, 1), (3, 3, 2, 3), (2, 6, 2, 3), (2, 2, 2, 1)]
        {
            let needed = Mismatch::Shape {
                channels_needed: coordinates * nodes,
                channels,
                stages_needed: nodes,
                stages,
            };
            assert_eq!(check(stages, channels, coordinates, nodes), Err(needed));
        }
        let kernels = [kernel(0.3, 0.1), kernel(1.4, 0.1)];
        let motion = motion(&kernels, Derivative::RiemannLiouville).unwrap();
        assert_eq!(motion.check(1, 1, 0.1), Ok(()));
        assert_eq!(motion.check(1, 1, 0.2), Err(Mismatch::StepSize { kernel: 0.1, integrator: 0.2 }));
    }

    #[test]
    fn a_saved_motion_is_taken_whole_or_not_at_all() {
        let build = |derivative, start: f64| {
            let memory = FixedDirect::<f64, 3, 4>::full_memory(&[1.0, 0.5, 0.25, 0.125], 1.0).unwrap();
            let kernels = [Kernel::given(0.5).unwrap()];
            let mut motion =
                DampedMotion::<f64, Fixed<3>, _>::new(&Fixed, &kernels, derivative, memory).unwrap();
            motion.begin(&[start, 2.0, 3.0], &[0.5, start, 0.25]);
            motion
        };
        let saved = |motion: &DampedMotion<f64, Fixed<3>, FixedDirect<'_, f64, 3, 4>>| {
            let mut bytes = std::vec![0; motion.state_bytes()];
            let mut writer = StateWriter::new(&mut bytes);
            motion.save(&mut writer).unwrap();
            assert_eq!(writer.written(), motion.state_bytes());
            bytes
        };
        let mut first = build(Derivative::Caputo, 1.0);
        let sample = Sample { from: &[1.0; 3], behind: &[], time: 0.0, length: 0.0, fractions: &[0.0] };
        first.push(&sample, &[0.5, 1.0, 2.0], &mut [0.0; 3]).unwrap();
        let bytes = saved(&first);
        let mut second = build(Derivative::Caputo, 7.0);
        let before = saved(&second);
        for length in 0..bytes.len() {
            let cut = &bytes[..length];
            assert!(second.check_state(&mut StateReader::new(cut)).is_err(), "{length} bytes");
            assert!(second.restore(&mut StateReader::new(cut)).is_err(), "{length} bytes");
            assert_eq!(saved(&second), before, "{length} bytes");
        }
        let mut reader = StateReader::new(&bytes);
        second.check_state(&mut reader).unwrap();
        reader.finish().unwrap();
        second.restore(&mut StateReader::new(&bytes)).unwrap();
        assert_eq!(saved(&second), bytes);
        let refused = build(Derivative::RiemannLiouville, 1.0).restore(&mut StateReader::new(&bytes));
        assert_eq!(refused, Err(StateError::Mismatch { what: "kind of derivative", expected: 0, found: 1 }));
    }
}
