//! The integrator: the only place where system, scheme and memory meet.

use core::fmt;

use crate::coefficients::Fixed;
use crate::damped_motion::{Mismatch, Sample};
use crate::damping::Damping;
use crate::error::{ParameterError, check_step_size};
use crate::linear::all_finite;
use crate::memory::MemoryError;
use crate::real::Real;
use crate::saving::{Shape, StateError, StateReader, StateWriter, Stateful, header_bytes};
use crate::scheme::{Outcome, Rounding, Sampling, Scheme, State, Step, StepError, conclude};
use crate::space::{Block, Space, part_mut, vectors_mut};
use crate::system::{Force, Mechanics, Potential, System};

/// Integrates d/dt ∂L/∂v − ∂L/∂q = F + u − Σ_m ρ_m D₋^{β_m} q step by step.
///
/// A step computes the memory terms, solves the equations of the scheme, stores the new sample and only then
/// advances the state: an error leaves state and memories as they were, and the caller may try again.
///
/// ```
/// # use fvi_core::*;
/// // m q̈ + k q = −ρ D^{1/2} q with q(0) = 1, q̇(0) = 0, in Caputo's sense.
/// static WEIGHTS: [f64; 128] = monic_increment_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
/// let step_size = 0.05;
/// let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, step_size)?;
/// let memory = kernel.full_memory::<f64, 1, 128>(&WEIGHTS)?;
/// let rho = Coefficients::Diagonal([0.2].into());
/// let damping = DampingTerm::new(kernel, rho, Derivative::Caputo, memory)?;
/// let system = System {
///     mass: Mass::diagonal([1.0])?,
///     potential: Quadratic::diagonal([1.0])?,
///     force: NoForce,
/// };
/// let scheme = Galerkin::low_order(0.5)?;
/// let mut integrator = Integrator::builder(system, scheme, step_size)
///     .damping(damping)
///     .position([1.0])
///     .velocity([0.0])
///     .build()?;
/// let energy = integrator.energy();
/// for _ in 0..100 {
///     integrator.step(&[0.0].into())?;
/// }
/// assert!(integrator.energy() < energy);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Source: \[JO\] Algorithm 3; \[HJO\] Algorithm 1.
#[derive(Clone, Debug)]
#[must_use]
pub struct Integrator<T: Real, X: Space<T>, G, S: Scheme<T, X>, D> {
    space: X,
    mechanics: G,
    scheme: S,
    storage: S::Storage,
    damping: D,
    step_size: T,
    state: State<X::Vector>,
    /// Index and time of the grid point from which later times are counted with the step size; earlier steps
    /// may have had any length.
    anchor: (u64, T),
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"intg";

/// Builder of an [`Integrator`]. By default the motion begins at rest at the origin, undamped.
#[derive(Clone, Debug)]
#[must_use]
pub struct IntegratorBuilder<T: Real, X: Space<T>, G, S, D> {
    space: X,
    mechanics: G,
    scheme: S,
    damping: D,
    step_size: T,
    start: T,
    position: X::Vector,
    /// Initial momentum or velocity, and which of the two it is.
    motion: (X::Vector, Motion),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Motion {
    Momentum,
    Velocity,
}

/// Reason why an integrator cannot be built.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum IntegratorError {
    /// The step size is not positive and finite.
    StepSize(ParameterError),
    /// The initial position or momentum is not finite.
    InitialState,
    /// A damping does not fit the system, the scheme or the step size.
    Damping(Mismatch),
    /// A memory has no room for the first sample.
    Memory(MemoryError),
}

impl fmt::Display for IntegratorError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::StepSize(error) => error.fmt(f),
            Self::InitialState => write!(f, "the initial position or momentum is not finite"),
            Self::Damping(error) => error.fmt(f),
            Self::Memory(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for IntegratorError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::StepSize(error) => Some(error),
            Self::InitialState => None,
            Self::Damping(error) => Some(error),
            Self::Memory(error) => Some(error),
        }
    }
}

impl<T, const N: usize, P, F, S> Integrator<T, Fixed<N>, System<T, N, P, F>, S, ()>
where
    T: Real,
    P: Potential<T, N>,
    F: Force<T, N>,
    S: Scheme<T, Fixed<N>>,
{
    /// Builder of an integrator for a system of N coordinates with the step size h.
    #[inline]
    pub fn builder(
        system: System<T, N, P, F>,
        scheme: S,
        step_size: T,
    ) -> IntegratorBuilder<T, Fixed<N>, System<T, N, P, F>, S, ()> {
        IntegratorBuilder::in_space(Fixed, system, scheme, step_size)
    }
}

impl<T: Real, X: Space<T>, G: Mechanics<T, X>, S: Scheme<T, X>> IntegratorBuilder<T, X, G, S, ()> {
    /// Builder of an integrator in any space; see [`Integrator::builder`].
    #[inline]
    pub fn in_space(space: X, mechanics: G, scheme: S, step_size: T) -> Self {
        let (position, motion) = (space.zeros(), (space.zeros(), Motion::Momentum));
        Self { space, mechanics, scheme, damping: (), step_size, start: T::zero(), position, motion }
    }

    /// The damping: a term, or several together.
    #[inline]
    pub fn damping<D: Damping<T, X>>(self, damping: D) -> IntegratorBuilder<T, X, G, S, D> {
        let Self { space, mechanics, scheme, damping: (), step_size, start, position, motion } = self;
        IntegratorBuilder { space, mechanics, scheme, damping, step_size, start, position, motion }
    }
}

impl<T: Real, X: Space<T>, G: Mechanics<T, X>, S: Scheme<T, X>, D: Damping<T, X>>
    IntegratorBuilder<T, X, G, S, D>
{
    /// The time t₀ at which the motion begins; 0 by default.
    #[inline]
    pub fn start(mut self, time: T) -> Self {
        self.start = time;
        self
    }

    /// Initial position q₀.
    #[inline]
    pub fn position(mut self, position: impl Into<X::Vector>) -> Self {
        self.position = position.into();
        self
    }

    /// Initial momentum p₀.
    #[inline]
    pub fn momentum(mut self, momentum: impl Into<X::Vector>) -> Self {
        self.motion = (momentum.into(), Motion::Momentum);
        self
    }

    /// Initial velocity v₀: the momentum is M v₀.
    #[inline]
    pub fn velocity(mut self, velocity: impl Into<X::Vector>) -> Self {
        self.motion = (velocity.into(), Motion::Velocity);
        self
    }

    /// The integrator at the start with empty memories.
    ///
    /// # Errors
    /// [`IntegratorError`].
    #[inline]
    pub fn build(self) -> Result<Integrator<T, X, G, S, D>, IntegratorError> {
        let Self { space, mechanics, scheme, mut damping, step_size, start, position, motion } = self;
        check_step_size(step_size.to_f64()).map_err(IntegratorError::StepSize)?;
        let (given, motion) = motion;
        let mut other = space.zeros();
        let (momentum, velocity) = match motion {
            Motion::Momentum => {
                mechanics.velocity(X::slice(&given), X::slice_mut(&mut other));
                (given, other)
            }
            Motion::Velocity => {
                mechanics.mass().multiply_add(T::one(), X::slice(&given), X::slice_mut(&mut other));
                (other, given)
            }
        };
        if ![&position, &momentum, &velocity].iter().all(|vector| all_finite(X::slice(vector))) {
            return Err(IntegratorError::InitialState);
        }
        let nodes = scheme.sampling().nodes();
        damping.check(space.coordinates(), nodes, step_size).map_err(IntegratorError::Damping)?;
        begin(&space, &scheme, &mut damping, start, (&position, &velocity))?;
        let storage = scheme.storage(&space, &mechanics);
        let rounding = Rounding { position: space.zeros(), momentum: space.zeros() };
        let state = State { step: 0, position, momentum, rounding };
        let anchor = (0, start);
        Ok(Integrator { space, mechanics, scheme, storage, damping, step_size, state, anchor })
    }
}

/// Empties the memories of a damping, for a motion that begins at this time with a position and a velocity.
#[inline]
fn begin<T: Real, X: Space<T>, S: Scheme<T, X>, D: Damping<T, X>>(
    space: &X,
    scheme: &S,
    damping: &mut D,
    start: T,
    (position, velocity): (&X::Vector, &X::Vector),
) -> Result<(), IntegratorError> {
    damping.begin(X::slice(position), X::slice(velocity));
    if start != T::zero() {
        damping.begin_at(start);
    }
    if matches!(scheme.sampling(), Sampling::MainNodes) {
        let (rest, mut scratch) = (space.zeros(), space.zeros());
        let (from, fractions) = (X::slice(position), &[T::zero()]);
        let sample = Sample { from, behind: &[], time: start, length: T::zero(), fractions };
        damping
            .push(&sample, X::slice(&rest), X::slice_mut(&mut scratch))
            .map_err(IntegratorError::Memory)?;
    }
    Ok(())
}

impl<T: Real, X: Space<T>, G: Mechanics<T, X>, S: Scheme<T, X>, D: Damping<T, X>> Integrator<T, X, G, S, D> {
    /// Begins a new motion with this system, which may have been [changed](Self::system_mut): at the time t₀
    /// with the position q₀ and the momentum p₀, and with empty memories. All its steps have the bits of
    /// those of a new integrator.
    ///
    /// # Errors
    /// [`IntegratorError`]; the integrator must then begin anew before its next step.
    pub fn begin_anew(
        &mut self,
        start: T,
        position: &X::Vector,
        momentum: &X::Vector,
    ) -> Result<(), IntegratorError> {
        let Self { space, mechanics, scheme, storage, damping, state, anchor, .. } = self;
        let mut velocity = space.zeros();
        mechanics.velocity(X::slice(momentum), X::slice_mut(&mut velocity));
        if ![position, momentum, &velocity].iter().all(|vector| all_finite(X::slice(vector))) {
            return Err(IntegratorError::InitialState);
        }
        begin(space, scheme, damping, start, (position, &velocity))?;
        *storage = scheme.storage(space, mechanics);
        X::slice_mut(&mut state.position).copy_from_slice(X::slice(position));
        X::slice_mut(&mut state.momentum).copy_from_slice(X::slice(momentum));
        for rounding in [&mut state.rounding.position, &mut state.rounding.momentum] {
            X::slice_mut(rounding).fill(T::zero());
        }
        (state.step, *anchor) = (0, (0, start));
        Ok(())
    }

    /// Makes one step with the input u held over it (zero where there is none); returns the iterations of
    /// Newton's method.
    ///
    /// # Errors
    /// [`StepError`]; state and memories are as before the call.
    #[inline]
    pub fn step(&mut self, input: &X::Vector) -> Result<u32, StepError> {
        self.step_under(X::slice(input))
    }

    /// As [`step`](Integrator::step), with the first numbers of the input given; the others are zero.
    ///
    /// # Errors
    /// As [`step`](Integrator::step).
    #[inline]
    pub fn step_under(&mut self, input: &[T]) -> Result<u32, StepError> {
        let (index, time) = self.anchor;
        let end = time + T::from_count((self.state.step - index).saturating_add(1)) * self.step_size;
        let iterations = self.make(self.step_size, end, input)?;
        self.state.step += 1;
        Ok(iterations)
    }

    /// Makes one step of any length h > 0, with the input u held over it: for ticks that come early or late.
    /// Steps that follow are counted from its end.
    ///
    /// The damping must have memories for steps of any length
    /// ([`VariableStepMemory`](crate::VariableStepMemory)) with the nodes of the scheme, or this length.
    ///
    /// # Errors
    /// [`StepError`], [`MemoryError::StepLength`] in it where the memories do not take this length; state and
    /// memories are as before the call.
    #[inline]
    pub fn step_by(&mut self, length: T, input: &X::Vector) -> Result<u32, StepError> {
        self.step_over(length, self.time() + length, input)
    }

    /// Makes one step to the time `end`, as [`step_by`](Integrator::step_by): on grids whose times are given.
    ///
    /// # Errors
    /// As [`step_by`](Integrator::step_by); the time must be later than the present one.
    #[inline]
    pub fn step_to(&mut self, end: T, input: &X::Vector) -> Result<u32, StepError> {
        self.step_over(end - self.time(), end, input)
    }

    /// Makes one step of the given length to the time `end`, as [`step_by`](Integrator::step_by): where the
    /// length is known to more digits than the difference of two times has.
    ///
    /// # Errors
    /// As [`step_by`](Integrator::step_by).
    pub fn step_over(&mut self, length: T, end: T, input: &X::Vector) -> Result<u32, StepError> {
        if !(length > T::zero() && end.is_finite()) {
            return Err(MemoryError::StepLength.into());
        }
        let iterations = self.make(length, end, X::slice(input))?;
        self.state.step += 1;
        self.anchor = (self.state.step, end);
        Ok(iterations)
    }

    #[inline(always)]
    fn make(&mut self, length: T, end: T, input: &[T]) -> Result<u32, StepError> {
        let step = Step { time: self.time(), end, size: length, input };
        let Self { mechanics, scheme, storage, damping, state, .. } = self;
        scheme.step(storage, mechanics, damping, &step, state)
    }

    /// Makes a step of the step size h to the time `end` from a given result instead of solving for it: adds
    /// the increments `found` to position and momentum, and stores the nodes in the memories as after a
    /// solved step. So a known motion becomes the past of the one that follows.
    ///
    /// `found.increments` are those of the nodes that the memory stores, R·N numbers. `known` has room for as
    /// many, `scratch` for N more.
    ///
    /// # Errors
    /// [`StepError::NotFinite`] or [`StepError::Memory`]; state and memories are as before the call.
    pub fn follow(
        &mut self,
        end: T,
        found: &Outcome<'_, T>,
        known: &mut [T],
        scratch: &mut [T],
    ) -> Result<(), StepError> {
        let time = self.time();
        let Self { scheme, storage, damping, state, step_size, .. } = self;
        let (at_end, coordinates) = ([T::one()], X::slice(&state.position).len());
        let (fractions, stored) = match scheme.sampling() {
            Sampling::MainNodes => (&at_end[..], 0),
            Sampling::Nodes(fractions) => (fractions, fractions.len() * coordinates),
        };
        let behind = part_mut(S::carried_mut(storage), stored);
        let from = X::slice(&state.position);
        let sample = Sample { from, behind: &*behind, time, length: *step_size, fractions };
        damping.add_known(&sample, known, scratch)?;
        let step = Step { time, end, size: *step_size, input: &[] };
        conclude::<T, X, X, D>(damping, &step, fractions, found, state, behind, scratch)?;
        state.step += 1;
        self.anchor = (self.state.step, end);
        Ok(())
    }

    /// Moves the position at once, at the present time: the memories see a jump of the motion. At the start
    /// they are at rest at the position before it.
    ///
    /// For schemes whose memories store nodes ([`Sampling::Nodes`]); with main nodes for coordinates that no
    /// damping acts on.
    pub fn jump_to(&mut self, position: &X::Vector) {
        let coordinates = X::slice(position).len();
        let stored = match self.scheme.sampling() {
            Sampling::MainNodes => 0,
            Sampling::Nodes(fractions) => fractions.len() * coordinates,
        };
        let behind = part_mut(S::carried_mut(&mut self.storage), stored);
        let from = X::slice(&self.state.position);
        for offsets in vectors_mut(behind, coordinates) {
            let moved = offsets.iter_mut().zip(X::slice(position).iter().zip(from));
            moved.for_each(|(offset, (&to, &from))| *offset += to - from);
        }
        X::slice_mut(&mut self.state.position).copy_from_slice(X::slice(position));
        X::slice_mut(&mut self.state.rounding.position).fill(T::zero());
    }

    /// Time t_k of the present state: k h where all steps had the step size h and the first began at 0.
    #[inline]
    pub fn time(&self) -> T {
        let (index, time) = self.anchor;
        time + T::from_count(self.state.step - index) * self.step_size
    }

    /// Step size h.
    pub fn step_size(&self) -> T {
        self.step_size
    }

    /// The present state.
    pub fn state(&self) -> &State<X::Vector> {
        &self.state
    }

    /// Writes the velocity M⁻¹ p of the present state.
    pub fn velocity(&self, velocity: &mut X::Vector) {
        self.mechanics.velocity(X::slice(&self.state.momentum), X::slice_mut(velocity));
    }

    /// Energy ½ pᵀ M⁻¹ p + U(q) of the present state (\[JO\] §5).
    pub fn energy(&mut self) -> T {
        self.mechanics.energy(&self.state.position, &self.state.momentum)
    }

    /// Energy ½ pᵀ M⁻¹ p + U(q) of the present position with another momentum.
    pub fn energy_with(&mut self, momentum: &X::Vector) -> T {
        self.mechanics.energy(&self.state.position, momentum)
    }

    /// Energy ½ pᵀ M⁻¹ p + U(q) of any state.
    pub fn energy_of(&mut self, position: &X::Vector, momentum: &X::Vector) -> T {
        self.mechanics.energy(position, momentum)
    }

    /// Header of the saved state: the values that must match when it is restored.
    fn shape(&self) -> Shape<2> {
        let coordinates = self.space.coordinates() as u64;
        [("coordinates", coordinates), ("bits of the step size", self.step_size.bits())]
    }

    /// Storage of the scheme between steps.
    pub fn storage(&self) -> &S::Storage {
        &self.storage
    }

    /// The scheme.
    pub fn scheme(&self) -> &S {
        &self.scheme
    }

    /// The system.
    pub fn system(&self) -> &G {
        &self.mechanics
    }

    /// The system, to be changed between steps: the steps that follow are those of the changed system. The
    /// state does not depend on it.
    pub fn system_mut(&mut self) -> &mut G {
        &mut self.mechanics
    }

    /// The damping with its memories.
    pub fn damping(&self) -> &D {
        &self.damping
    }

    /// The damping, for access to data that it holds beside what the steps need.
    pub fn damping_mut(&mut self) -> &mut D {
        &mut self.damping
    }
}

/// Step, position, momentum, and the state of the damping. System and scheme are not compared.
impl<T: Real, X: Space<T>, G: Mechanics<T, X>, S: Scheme<T, X>, D: Damping<T, X>> Stateful
    for Integrator<T, X, G, S, D>
{
    fn state_bytes(&self) -> usize {
        let numbers = 1 + 4 * self.space.coordinates() + S::carried(&self.storage).len();
        header_bytes(4) + numbers * T::BYTES + self.damping.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 2>(TAG, &self.shape())?;
        to.count(self.state.step)?;
        to.count(self.anchor.0)?;
        to.numbers([&self.anchor.1])?;
        let State { position, momentum, rounding, .. } = &self.state;
        for vector in [position, momentum, &rounding.position, &rounding.momentum] {
            to.numbers(X::slice(vector))?;
        }
        to.numbers(S::carried(&self.storage))?;
        self.damping.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.header::<T, 2>(TAG, &self.shape())?;
        let step = from.count()?;
        from.count_up_to("steps", usize::try_from(step).unwrap_or(usize::MAX))?;
        from.skip::<T>(1 + 4 * self.space.coordinates() + S::carried(&self.storage).len())?;
        self.damping.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let mut ahead = from.clone();
        ahead.header::<T, 2>(TAG, &self.shape())?;
        let step = ahead.count()?;
        let anchor = (
            ahead.count_up_to("steps", usize::try_from(step).unwrap_or(usize::MAX))? as u64,
            ahead.number()?,
        );
        let zeros = || self.space.zeros();
        let rounding = Rounding { position: zeros(), momentum: zeros() };
        let mut state = State { step, position: zeros(), momentum: zeros(), rounding };
        let State { position, momentum, rounding, .. } = &mut state;
        for vector in [position, momentum, &mut rounding.position, &mut rounding.momentum] {
            ahead.numbers(X::slice_mut(vector))?;
        }
        // All else that the scheme stores belongs to the leading weights of the old damping.
        let mut storage = self.scheme.storage(&self.space, &self.mechanics);
        ahead.numbers(S::carried_mut(&mut storage))?;
        self.damping.restore(&mut ahead)?;
        (self.state, self.storage, self.anchor) = (state, storage, anchor);
        *from = ahead;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coefficients::Coefficients;
    use crate::damped_motion::Derivative;
    use crate::damping::DampingTerm;
    use crate::galerkin::Galerkin;
    use crate::kernel::Kernel;
    use crate::node_galerkin::NodeGalerkin;
    use crate::system::{Instant, Mass, Quadratic, TimeForce};
    use crate::weights::{BdfOrder, monic_increment_table};
    use nalgebra::{SVector, vector};
    use std::vec::Vec;

    type Thrust = fn(Instant<f64>) -> SVector<f64, 1>;

    type Pushed = Integrator<
        f64,
        Fixed<1>,
        System<f64, 1, Quadratic<f64, 1>, TimeForce<Thrust>>,
        Galerkin<f64, 1, 1>,
        (),
    >;

    /// A spring of 8 on a mass of 2 that is pushed by the force 2 t.
    fn plant() -> System<f64, 1, Quadratic<f64, 1>, TimeForce<Thrust>> {
        let force = TimeForce((|instant| vector![2.0 * instant.time]) as Thrust);
        System { mass: Mass::diagonal([2.0]).unwrap(), potential: Quadratic::diagonal([8.0]).unwrap(), force }
    }

    /// The step that κ = 0 makes: q rises by h p / m, and p loses h times the restoring force at its end.
    fn by_hand((time, q, p): (f64, f64, f64), h: f64, input: f64) -> (f64, f64, f64) {
        let (end, q) = (time + h, q + h * p / 2.0);
        (end, q, p - h * (8.0 * q - 2.0 * end - input))
    }

    #[test]
    fn steps_follow_each_other_in_time_whatever_their_length() {
        let mut integrator = Integrator::builder(plant(), Galerkin::low_order(0.0).unwrap(), 0.25)
            .position([1.0])
            .momentum([0.5])
            .build()
            .unwrap();
        assert_eq!(integrator.step_size(), 0.25);
        let mut state = (0.0, 1.0, 0.5);
        let (input, mut steps) = ([1.5].into(), 0);
        let mut assert_at = |integrator: &mut Pushed, (time, q, p): (f64, f64, f64)| {
            steps += 1;
            let found = integrator.state();
            assert_eq!((found.step, integrator.time()), (steps, time));
            assert!(
                (found.position[0] - q).abs() < 1e-14 && (found.momentum[0] - p).abs() < 1e-14,
                "step {steps}"
            );
            let energy = |q: f64, p: f64| p * p / 4.0 + 4.0 * q * q;
            assert!((integrator.energy() - energy(q, p)).abs() < 1e-13, "step {steps}");
            assert_eq!(integrator.energy_with(&[2.0].into()), energy(integrator.state().position[0], 2.0));
            assert_eq!(integrator.energy_of(&[0.5].into(), &[2.0].into()), 2.0);
        };
        for _ in 0..3 {
            assert_eq!(integrator.step(&input), Ok(0));
            state = by_hand(state, 0.25, 1.5);
            assert_at(&mut integrator, state);
        }
        assert_eq!(integrator.step_by(0.125, &input), Ok(0));
        state = by_hand(state, 0.125, 1.5);
        assert_at(&mut integrator, state);
        assert_eq!(integrator.step_to(1.5, &input), Ok(0));
        state = by_hand(state, 0.625, 1.5);
        assert_at(&mut integrator, state);
        // Without an input there is none, and equal steps go on from where the others ended.
        for _ in 0..3 {
            assert_eq!(integrator.step_under(&[]), Ok(0));
            state = by_hand(state, 0.25, 0.0);
            assert_at(&mut integrator, state);
        }
    }

    #[test]
    fn steps_that_are_solved_for_say_how_often_they_were_corrected() {
        let mut integrator = Integrator::builder(plant(), Galerkin::low_order(0.5).unwrap(), 0.25)
            .position([1.0])
            .build()
            .unwrap();
        assert_eq!(integrator.step_by(0.125, &[0.0].into()), Ok(1));
    }

    /// A damped spring whose memory stores the nodes of the steps.
    macro_rules! damped {
        ($kappa:expr, $order:expr, $derivative:expr, $start:expr, $q:expr, $p:expr) => {
            damped!(
                NodeGalerkin::new(Galerkin::low_order($kappa).unwrap()),
                $order, $derivative, $start, $q, $p;
            )
        };
        ($scheme:expr, $order:expr, $derivative:expr, $start:expr, $q:expr, $p:expr;) => {{
            static WEIGHTS: [f64; 64] = monic_increment_table(BdfOrder::GRUNWALD_LETNIKOV, $order);
            let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, $order, 0.25).unwrap();
            let memory = kernel.full_memory::<f64, 1, 64>(&WEIGHTS).unwrap();
            let rho = Coefficients::Diagonal([0.7].into());
            let damping = DampingTerm::new(kernel, rho, $derivative, memory).unwrap();
            Integrator::builder(plant(), $scheme, 0.25)
                .damping(damping)
                .start($start)
                .position([$q])
                .momentum([$p])
                .build()
                .unwrap()
        }};
    }

    #[test]
    fn steps_that_were_made_otherwise_are_the_past_of_those_that_follow() {
        macro_rules! assert_followed {
            ($order:expr, $derivative:expr) => {
                // One integrator makes all steps; the other follows the given first half, and begins at
                // another time.
                let mut whole = damped!(0.5, $order, $derivative, 0.5, 1.0, 0.5);
                let mut half = damped!(0.5, $order, $derivative, 0.5, 1.0, 0.5);
                for step in 1..=20 {
                    let (q, p) = (whole.state().position[0], whole.state().momentum[0]);
                    whole.step(&[0.0].into()).unwrap();
                    if step > 10 {
                        half.step(&[0.0].into()).unwrap();
                    } else {
                        let (rise, kick) = (whole.state().position[0] - q, whole.state().momentum[0] - p);
                        let found = Outcome { increments: &[0.5 * rise], rise: &[rise], kick: &[kick] };
                        let end = 0.5 + 0.25 * f64::from(step);
                        half.follow(end, &found, &mut [0.0], &mut [0.0; 2]).unwrap();
                    }
                    let (one, other) = (whole.state(), half.state());
                    assert_eq!((one.step, whole.time()), (other.step, half.time()));
                    assert_eq!(whole.time(), 0.5 + 0.25 * f64::from(step));
                    assert!((one.position[0] - other.position[0]).abs() < 1e-13, "step {step}");
                    assert!((one.momentum[0] - other.momentum[0]).abs() < 1e-13, "step {step}");
                }
                let found = Outcome { increments: &[f64::NAN], rise: &[f64::NAN], kick: &[0.0] };
                let before = half.state().clone();
                let refused = half.follow(9.0, &found, &mut [0.0], &mut [0.0; 2]);
                assert_eq!(refused, Err(StepError::NotFinite));
                assert_eq!(*half.state(), before);
            };
        }
        assert_followed!(0.5, Derivative::Caputo);
        assert_followed!(1.5, Derivative::Caputo);
        assert_followed!(1.5, Derivative::RiemannLiouville);
    }

    #[test]
    fn a_motion_that_begins_anew_has_the_bits_of_a_new_integrator() {
        macro_rules! assert_anew {
            ($scheme:expr, $order:expr) => {
                let mut used = damped!($scheme, $order, Derivative::Caputo, 0.0, 1.0, 0.5;);
                for step in 0..30 {
                    used.step(&[f64::from(step)].into()).unwrap();
                }
                let refused = used.begin_anew(0.5, &[1.0].into(), &[f64::INFINITY].into());
                assert_eq!(refused, Err(IntegratorError::InitialState));
                used.begin_anew(0.5, &[-2.0].into(), &[0.75].into()).unwrap();
                let mut new = damped!($scheme, $order, Derivative::Caputo, 0.5, -2.0, 0.75;);
                for _ in 0..30 {
                    assert_eq!((used.state(), used.time()), (new.state(), new.time()));
                    assert_eq!(used.step(&[0.5].into()), new.step(&[0.5].into()));
                }
            };
        }
        assert_anew!(Galerkin::low_order(0.5).unwrap(), 0.5);
        assert_anew!(NodeGalerkin::new(Galerkin::low_order(0.5).unwrap()), 1.5);
    }

    #[test]
    fn a_motion_that_begins_later_is_the_same_at_later_times() {
        macro_rules! assert_shifted {
            ($order:expr, $kappa:expr) => {
                let [mut now, mut later] =
                    [0.0, 1.0].map(|start| damped!($kappa, $order, Derivative::Caputo, start, 1.0, 0.5));
                // The force is 2 t: at times later by 1 it is larger by 2, which the input compensates.
                for _ in 0..20 {
                    now.step(&[0.0].into()).unwrap();
                    later.step(&[-2.0].into()).unwrap();
                    assert_eq!(later.time(), now.time() + 1.0);
                    assert!((now.state().position[0] - later.state().position[0]).abs() < 1e-13);
                }
            };
        }
        assert_shifted!(0.5, 0.5);
        assert_shifted!(1.5, 0.5);
    }

    #[test]
    fn a_state_for_another_step_size_is_refused() {
        let build =
            |h| Integrator::builder(plant(), Galerkin::low_order(0.5).unwrap(), h).position([1.0]).build();
        let mut bytes: Vec<u8> = std::vec![0; build(0.5).unwrap().state_bytes()];
        build(0.5).unwrap().save(&mut StateWriter::new(&mut bytes)).unwrap();
        assert_eq!(build(0.5).unwrap().restore(&mut StateReader::new(&bytes)), Ok(()));
        let refused = build(0.25).unwrap().restore(&mut StateReader::new(&bytes));
        assert!(
            matches!(refused, Err(StateError::Mismatch { what: "bits of the step size", .. })),
            "{refused:?}"
        );
    }
}
