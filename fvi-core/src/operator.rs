//! Discrete fractional operators on whole sequences and on a stream of samples.

use core::fmt;

use crate::linear::at;
use crate::memory::{ActsOn, Memory, MemoryError};
use crate::real::{Real, sum_and_rest};
use crate::saving::{Shape, StateError, StateReader, StateWriter, Stateful, header_bytes};

/// Left (retarded) discrete operator: (D₋x)_k = Σ_{n=0}^{k} w_n x_{k−n}, for every k of the sequence.
///
/// Writes as many values as the shorter of `samples` and `output` has. Source: \[JO\] eq. 45b; \[HJO\] eq.
/// 21.
pub fn left_operator<T: Real>(weights: &[T], samples: &[T], output: &mut [T]) {
    for (k, output) in output.iter_mut().enumerate().take(samples.len()) {
        let past = samples.get(..=k).unwrap_or(&[]).iter().rev();
        *output = weights.iter().zip(past).fold(T::zero(), |sum, (&w, &x)| sum + w * x);
    }
}

/// Right (advanced) discrete operator: (D₊x)_k = Σ_{n=0}^{N−k} w_n x_{k+n}, for every k of the sequence x₀ …
/// x_N.
///
/// It is the adjoint of the left one: Σ_k g_k (D₋f)_k = Σ_k (D₊g)_k f_k. Source: \[JO\] eq. 45c; \[HJO\] eq.
/// 22–23.
pub fn right_operator<T: Real>(weights: &[T], samples: &[T], output: &mut [T]) {
    for (k, output) in output.iter_mut().enumerate() {
        let future = samples.get(k..).unwrap_or(&[]);
        *output = weights.iter().zip(future).fold(T::zero(), |sum, (&w, &x)| sum + w * x);
    }
}

/// Initial part of a signal that a fractional derivative of Caputo type subtracts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start<T> {
    /// Nothing: the operator of Riemann–Liouville type acts on x itself. Fractional integrals are of this
    /// type.
    RiemannLiouville,
    /// The first sample: x_k − x₀, the Caputo derivative of an order up to 1.
    Caputo,
    /// The first sample and a slope: x_k − x₀ − k·`rise`, the Caputo derivative of an order between 1 and 2;
    /// `rise` is the initial slope times the step size.
    CaputoWithRise {
        /// Initial slope times step size.
        rise: T,
    },
    /// The same for samples at any times, by the slope itself: x_k − x₀ − (t_k − t₀)·`slope`.
    CaputoWithSlope {
        /// Initial slope.
        slope: T,
    },
}

/// The start of an operator whose type says that it subtracts nothing.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FromZero;

impl<T> From<FromZero> for Start<T> {
    #[inline(always)]
    fn from(_: FromZero) -> Self {
        Self::RiemannLiouville
    }
}

/// The start of an operator that subtracts nothing or the first sample.
#[derive(Clone, Copy, Debug)]
pub(crate) enum FromZeroOrRest {
    Zero,
    Rest,
}

impl<T> From<FromZeroOrRest> for Start<T> {
    #[inline(always)]
    fn from(start: FromZeroOrRest) -> Self {
        match start {
            FromZeroOrRest::Zero => Self::RiemannLiouville,
            FromZeroOrRest::Rest => Self::Caputo,
        }
    }
}

/// Fractional operator on a stream: takes a sample x_k, returns (D^β x)_k = Σ_{n=0}^{k} w_n x_{k−n}.
///
/// For controllers and filters: fractional derivatives (0 < β < 2) and integrals (−1 < β < 0), on any
/// [`Memory`] with one channel whose kernel holds the weights of D^β. Integrals of order 1 and above are
/// [`FractionalIntegral`](crate::FractionalIntegral)s; those below may be. Differences of samples are formed
/// by subtraction here, without loss for samples that are given; memories that act on increments are more
/// accurate for derivatives all the same, because their sums do not cancel.
///
/// ```
/// # use fvi_core::{BdfOrder, FixedDirect, FractionalOperator, Start, leading_bdf_weight, monic_bdf_table};
/// static WEIGHTS: [f64; 256] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, -0.5);
/// let scale = leading_bdf_weight(BdfOrder::GRUNWALD_LETNIKOV, -0.5, 0.01)?;
/// let memory = FixedDirect::<f64, 1, 256>::full_memory(&WEIGHTS, scale)?;
/// let mut half_integral = FractionalOperator::new(memory, Start::RiemannLiouville)?;
/// let mut output = 0.0;
/// for _ in 0..=100 {
///     output = half_integral.push(1.0)?;
/// }
/// // The half integral of 1 at t = 1 is 2/√π.
/// assert!((output - 1.128).abs() < 5e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Source: \[HJO\] eq. 21; \[JO\] eq. 4 for the relation of the two types.
///
/// Parameters: the scalar T, the memory M, and the kind of start, a [`Start`] that is known at run time.
#[derive(Clone, Debug)]
pub struct FractionalOperator<T, M, S = Start<T>> {
    memory: M,
    start: S,
    /// The sample that the next one is compared with: the first of the Caputo types, for a memory on
    /// increments the last one.
    reference: T,
    /// Time of the last sample, if samples come at any times; for a memory on increments the rounding error
    /// of their sum.
    rest: T,
}

/// A sample x_k whose value an operator has computed but not yet taken; if dropped, the operator is
/// unchanged.
#[derive(Debug)]
#[must_use = "the operator has not taken the sample"]
pub struct Pending<'a, T, M, S = Start<T>> {
    operator: &'a mut FractionalOperator<T, M, S>,
    acted_on: T,
    reference: T,
    rest: T,
    /// Contribution of the past to the next value.
    term: T,
    value: T,
}

impl<T: Real, M: Memory<T>, S: Copy + Into<Start<T>>> Pending<'_, T, M, S> {
    /// (D^β x)_k.
    #[inline]
    pub fn value(&self) -> T {
        self.value
    }

    /// The same with another sample, at the cost of a product: for laws in which the sample depends on the
    /// value. For the Riemann–Liouville type only. The value may be infinite or not a number.
    ///
    /// # Errors
    /// None, for this type.
    #[inline(always)]
    pub(crate) fn instead(self, sample: T) -> Result<Self, OperatorError> {
        let (acted_on, reference, rest) = self.operator.compared(sample)?;
        let value = self.operator.leading() * acted_on + self.term;
        Ok(Self { acted_on, reference, rest, value, ..self })
    }

    /// Refuses a sample or a value that is not finite. If the sample is not, neither is the value.
    ///
    /// # Errors
    /// [`OperatorError::NotFinite`].
    #[inline(always)]
    pub(crate) fn finite(self) -> Result<Self, OperatorError> {
        if self.value.is_finite() { Ok(self) } else { Err(OperatorError::NotFinite) }
    }

    /// w₀ of the sample.
    #[inline]
    pub(crate) fn leading(&self) -> T {
        self.operator.leading()
    }

    /// Takes the sample and returns (D^β x)_k.
    ///
    /// # Errors
    /// None, of a memory that keeps the contract of [`Memory`].
    #[inline(always)]
    pub fn take(self) -> Result<T, OperatorError> {
        let Self { operator, acted_on, reference, rest, value, .. } = self;
        operator.memory.push(&[acted_on])?;
        (operator.reference, operator.rest) = (reference, rest);
        Ok(value)
    }
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"oper";

/// Reason why the operator refused a sample; the operator is unchanged.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum OperatorError {
    /// The sample, or the result, is infinite or not a number.
    NotFinite,
    /// The memory refused it, or has not one channel with one stage.
    Memory(MemoryError),
}

impl fmt::Display for OperatorError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "the sample or the result is not a finite number"),
            Self::Memory(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for OperatorError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::NotFinite => None,
            Self::Memory(error) => Some(error),
        }
    }
}

impl From<MemoryError> for OperatorError {
    fn from(error: MemoryError) -> Self {
        Self::Memory(error)
    }
}

impl<T: Real, M: Memory<T>> FractionalOperator<T, M> {
    /// An operator on an empty memory.
    ///
    /// # Errors
    /// [`MemoryError::ChannelMismatch`] if the memory has more than one channel, [`OperatorError::NotFinite`]
    /// if the rise is not finite.
    pub fn new(memory: M, start: Start<T>) -> Result<Self, OperatorError> {
        Self::starting(memory, start)
    }
}

impl<T: Real, M: Memory<T>, S: Copy + Into<Start<T>>> FractionalOperator<T, M, S> {
    /// The same with a start of any type.
    pub(crate) fn starting(mut memory: M, start: S) -> Result<Self, OperatorError> {
        crate::memory::check_channels(1, memory.channels())?;
        if let Start::CaputoWithRise { rise: slope } | Start::CaputoWithSlope { slope } = start.into()
            && !slope.is_finite()
        {
            return Err(OperatorError::NotFinite);
        }
        memory.expect_jumps();
        Ok(Self { memory, start, reference: T::zero(), rest: T::zero() })
    }

    /// Takes the next sample x_k and returns (D^β x)_k.
    ///
    /// # Errors
    /// [`OperatorError::NotFinite`] if x_k or the result is not finite, [`OperatorError::Memory`] if the
    /// memory is full; the operator then is as before.
    #[inline]
    pub fn push(&mut self, sample: T) -> Result<T, OperatorError> {
        self.prepare(sample)?.take()
    }

    /// What [`push`](FractionalOperator::push) would return; the operator stays as it is.
    ///
    /// # Errors
    /// As there.
    #[inline]
    pub fn peek(&mut self, sample: T) -> Result<T, OperatorError> {
        Ok(self.prepare(sample)?.value())
    }

    /// Computes (D^β x)_k for the next sample x_k, which [`Pending::take`] takes.
    ///
    /// Everything that can fail has been checked then. So the samples of several operators in one tick are
    /// taken together or not at all:
    ///
    /// ```
    /// # use fvi_core::{BdfOrder, FixedDirect, FractionalOperator, OperatorError, Start, monic_bdf_table};
    /// # static HALF: [f64; 8] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
    /// # let memory = || FixedDirect::<f64, 1, 8>::short_memory(&HALF, 1.0);
    /// # let mut integral = FractionalOperator::new(memory()?, Start::RiemannLiouville)?;
    /// # let mut derivative = FractionalOperator::new(memory()?, Start::RiemannLiouville)?;
    /// let mut tick = |error: f64, measured: f64| -> Result<f64, OperatorError> {
    ///     let first = integral.prepare(error)?;
    ///     let second = derivative.prepare(measured)?;
    ///     Ok(first.take()? + second.take()?)
    /// };
    /// assert!(tick(1.0, f64::NAN).is_err());
    /// assert_eq!(tick(1.0, 2.0)?, 3.0);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As those of [`push`](FractionalOperator::push).
    #[inline(always)]
    pub fn prepare(&mut self, sample: T) -> Result<Pending<'_, T, M, S>, OperatorError> {
        self.prepare_any(sample)?.finite()
    }

    /// The same for any sample: the value may be infinite or not a number, and the caller must see to it that
    /// it is not taken then.
    #[inline(always)]
    pub(crate) fn prepare_any(&mut self, sample: T) -> Result<Pending<'_, T, M, S>, OperatorError> {
        let (acted_on, reference, rest) = self.compared(sample)?;
        let (value, term) = self.value(acted_on)?;
        Ok(Pending { operator: self, acted_on, reference, rest, term, value })
    }

    /// The number that the memory acts on for this sample, the new reference, and the rounding error of
    /// increments, which is added to the next one, so that their sum equals the signal for any number of
    /// them.
    #[inline(always)]
    fn compared(&self, sample: T) -> Result<(T, T, T), OperatorError> {
        let on_values = self.memory.acts_on() == ActsOn::Values;
        let start: Start<T> = self.start.into();
        if start == Start::RiemannLiouville && on_values {
            return Ok((sample, self.reference, self.rest));
        }
        let first = self.memory.is_empty();
        let reference = if first { sample } else { self.reference };
        let (acted_on, rest) = match start {
            Start::RiemannLiouville if first => (sample, self.rest),
            Start::Caputo if on_values => (sample - reference, self.rest),
            Start::RiemannLiouville | Start::Caputo => {
                let (difference, lost) = sum_and_rest(sample, -reference);
                // Units in the last place of the samples, and so of what they differ by or more.
                let rest = lost + self.rest;
                let increment = difference + rest;
                (increment, rest - (increment - difference))
            }
            Start::CaputoWithRise { rise } => {
                let count = self.memory.len();
                // A saturated count no longer gives the time of a sample on the line.
                if on_values && count == usize::MAX {
                    return Err(MemoryError::Full { capacity: count }.into());
                }
                let rises = if on_values { T::from_count(count as u64) } else { T::of(count.min(1) as f64) };
                if on_values {
                    (sample - reference - rise * rises, self.rest)
                } else {
                    let (increment, lost) = sum_and_rest(sample, -reference);
                    let (increment, more) = sum_and_rest(increment, -rise * rises);
                    sum_and_rest(increment, (lost + more) + self.rest)
                }
            }
            // A slope needs the times of samples.
            Start::CaputoWithSlope { .. } => return Err(MemoryError::StepLength.into()),
        };
        Ok((acted_on, if on_values { reference } else { sample }, rest))
    }

    /// Takes a sample that comes `interval` units of time after the previous one and returns (D^β x)_k: for
    /// ticks that come early or late.
    ///
    /// The memory must be one for steps of any length ([`VariableStepMemory`](crate::VariableStepMemory) of
    /// one stage, of order 1). The first interval is the length of a step that ends with the first sample;
    /// the signal before that counts as zero for the Riemann–Liouville type, and as the first sample for the
    /// Caputo type.
    ///
    /// # Errors
    /// [`OperatorError::NotFinite`] if x_k or the result is not finite; [`OperatorError::Memory`] if the
    /// memory does not take this interval, or the start is given by a rise, which contains a step size. The
    /// operator then is unchanged.
    pub fn push_after(&mut self, interval: T, sample: T) -> Result<T, OperatorError> {
        self.prepare_after(interval, sample)?.take()
    }

    /// As [`prepare`](FractionalOperator::prepare), for a sample that comes `interval` units of time after
    /// the one before.
    ///
    /// # Errors
    /// As those of [`push_after`](FractionalOperator::push_after).
    pub fn prepare_after(&mut self, interval: T, sample: T) -> Result<Pending<'_, T, M, S>, OperatorError> {
        self.prepare_any_after(interval, sample)?.finite()
    }

    /// The same for any sample, as [`prepare_any`](FractionalOperator::prepare_any).
    pub(crate) fn prepare_any_after(
        &mut self,
        interval: T,
        sample: T,
    ) -> Result<Pending<'_, T, M, S>, OperatorError> {
        let empty = self.memory.is_empty();
        if self.memory.acts_on() != ActsOn::Values {
            return Err(MemoryError::StepLength.into());
        }
        let first = if empty { sample } else { self.reference };
        let time = if empty { T::zero() } else { self.rest + interval };
        let acted_on = match self.start.into() {
            Start::RiemannLiouville => sample,
            Start::Caputo => sample - first,
            Start::CaputoWithSlope { slope } => sample - first - slope * time,
            Start::CaputoWithRise { .. } => return Err(MemoryError::StepLength.into()),
        };
        self.memory.begin_step(interval)?;
        let (value, term) = self.value(acted_on)?;
        Ok(Pending { operator: self, acted_on, reference: first, rest: time, term, value })
    }

    /// The value with a sample of which the memory acts on this, and what the past adds to it.
    #[inline(always)]
    fn value(&mut self, acted_on: T) -> Result<(T, T), OperatorError> {
        let mut term = [T::zero()];
        self.memory.next_term(&mut term)?;
        Ok((self.leading() * acted_on + term[0], term[0]))
    }

    /// w₀
    #[inline(always)]
    fn leading(&self) -> T {
        at(self.memory.leading(), 0)
    }

    /// Forgets all samples.
    pub fn clear(&mut self) {
        self.memory.clear();
        (self.reference, self.rest) = (T::zero(), T::zero());
    }

    /// Header of the saved state: the values that must match when it is restored.
    fn shape(&self) -> Shape<3> {
        let (kind, rise) = match self.start.into() {
            Start::RiemannLiouville => (0, T::zero()),
            Start::Caputo => (1, T::zero()),
            Start::CaputoWithRise { rise } => (2, rise),
            Start::CaputoWithSlope { slope } => (3, slope),
        };
        let acts_on = self.memory.acts_on() as u64;
        [("kind of start", kind), ("bits of the rise", rise.bits()), ("kind of samples", acts_on)]
    }

    /// The part of a saved state before that of the memory.
    #[inline(never)]
    fn read_numbers(&self, from: &mut StateReader<'_>) -> Result<[T; 2], StateError> {
        from.header::<T, 3>(TAG, &self.shape())?;
        let mut numbers = [T::zero(); 2];
        from.fill(&mut numbers)?;
        Ok(numbers)
    }

    /// The memory behind the operator.
    pub fn memory(&self) -> &M {
        &self.memory
    }
}

impl<T: Real, M: Memory<T>, S: Copy + Into<Start<T>>> Stateful for FractionalOperator<T, M, S> {
    fn state_bytes(&self) -> usize {
        header_bytes(3) + 2 * T::BYTES + self.memory.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 3>(TAG, &self.shape())?;
        to.slice(&[self.reference, self.rest])?;
        self.memory.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.read_numbers(from)?;
        self.memory.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let mut ahead = from.clone();
        let numbers = self.read_numbers(&mut ahead)?;
        self.memory.restore(&mut ahead)?;
        [self.reference, self.rest] = numbers;
        *from = ahead;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::direct::FixedDirect;

    const WEIGHTS: [f64; 3] = [2.0, -1.5, 0.25];

    #[test]
    fn a_stream_gives_the_values_of_the_whole_sequence() {
        let samples = [1.0, -2.0, 0.5];
        let mut expected = [0.0; 3];
        left_operator(&WEIGHTS, &samples, &mut expected);
        assert_eq!(expected, [2.0, -5.5, 4.25]);
        let memory = FixedDirect::<f64, 1, 3>::full_memory(&WEIGHTS, 1.0).unwrap();
        let mut operator = FractionalOperator::new(memory, Start::RiemannLiouville).unwrap();
        for (sample, expected) in samples.into_iter().zip(expected) {
            assert_eq!(operator.push(sample), Ok(expected));
        }
    }

    #[test]
    fn the_caputo_type_ignores_how_the_signal_starts() {
        let memory = || FixedDirect::<f64, 1, 8>::full_memory(&WEIGHTS, 1.0).unwrap();
        let mut constant = FractionalOperator::new(memory(), Start::Caputo).unwrap();
        let mut line = FractionalOperator::new(memory(), Start::CaputoWithRise { rise: 0.5 }).unwrap();
        for k in 0..8 {
            assert_eq!(constant.push(3.0), Ok(0.0));
            assert_eq!(line.push(3.0 + 0.5 * f64::from(k)), Ok(0.0));
        }
    }

    #[test]
    fn a_memory_on_increments_gives_the_same_derivative() {
        const SUMS: [f64; 3] = [2.0, 0.5, 0.75];
        // The corresponding kernel on values continues with −3/4 and then zeros.
        const VALUES: [f64; 4] = [2.0, -1.5, 0.25, -0.75];
        let samples = [1.0, -2.0, 0.5, 3.0, 2.5];
        for start in [Start::RiemannLiouville, Start::Caputo, Start::CaputoWithRise { rise: 0.25 }] {
            let sums =
                FixedDirect::<f64, 1, 8>::full_memory(&SUMS, 1.0).unwrap().acting_on(ActsOn::Increments);
            let values = FixedDirect::<f64, 1, 8>::full_memory(&VALUES, 1.0).unwrap();
            let mut on_increments = FractionalOperator::new(sums, start).unwrap();
            let mut on_values = FractionalOperator::new(values, start).unwrap();
            for sample in samples {
                assert_eq!(on_increments.push(sample), on_values.push(sample), "{start:?}");
            }
        }
    }

    #[test]
    fn a_refused_sample_changes_nothing() {
        let memory = FixedDirect::<f64, 1, 2>::full_memory(&WEIGHTS, 1.0).unwrap();
        let mut operator = FractionalOperator::new(memory, Start::Caputo).unwrap();
        assert_eq!(operator.push(f64::NAN), Err(OperatorError::NotFinite));
        assert_eq!(operator.push(1.0), Ok(0.0));
        assert_eq!(operator.push(f64::INFINITY), Err(OperatorError::NotFinite));
        assert_eq!(operator.push(f64::MAX), Err(OperatorError::NotFinite));
        assert_eq!(operator.push(2.0), Ok(2.0));
        assert_eq!(operator.push(2.0), Err(MemoryError::Full { capacity: 2 }.into()));
    }

    #[test]
    fn a_peek_and_a_sample_that_is_not_taken_leave_the_operator_as_it_was() {
        for start in [Start::RiemannLiouville, Start::Caputo, Start::CaputoWithRise { rise: 0.25 }] {
            let memory = FixedDirect::<f64, 1, 4>::full_memory(&WEIGHTS, 1.0).unwrap();
            let mut operator = FractionalOperator::new(memory, start).unwrap();
            for sample in [3.0, -1.0, 0.5, 7.0] {
                let other = operator.peek(sample + 1.0).unwrap();
                let pending = operator.prepare(sample).unwrap();
                let expected = pending.value();
                assert_eq!(operator.peek(f64::NAN), Err(OperatorError::NotFinite));
                assert_eq!(operator.push(sample), Ok(expected));
                let by_one = other - expected;
                // Caputo's type subtracts the first sample.
                let left_out = operator.memory().len() == 1 && start != Start::RiemannLiouville;
                assert_eq!(by_one, if left_out { 0.0 } else { WEIGHTS[0] });
            }
            assert_eq!(operator.peek(1.0), Err(MemoryError::Full { capacity: 4 }.into()));
        }
        let mut at_any_time = identity(Start::CaputoWithSlope { slope: 0.5 });
        at_any_time.push_after(0.25, 3.0).unwrap();
        assert_eq!(at_any_time.prepare_after(2.0, 5.0).unwrap().value(), 1.0);
        assert_eq!(at_any_time.prepare_after(1.0, 5.0).unwrap().value(), 1.5);
        assert_eq!(at_any_time.push_after(1.0, 5.0), Ok(1.5));
        assert_eq!(at_any_time.push_after(1.0, 5.0), Ok(1.0));
    }

    #[test]
    fn several_operators_take_their_samples_together_or_not_at_all() {
        let memory = || FixedDirect::<f64, 1, 4>::full_memory(&WEIGHTS, 1.0).unwrap();
        let mut first = FractionalOperator::new(memory(), Start::RiemannLiouville).unwrap();
        let mut second = FractionalOperator::new(memory(), Start::Caputo).unwrap();
        let mut tick = |a: f64, b: f64| -> Result<(f64, f64), OperatorError> {
            let (of_first, of_second) = (first.prepare(a)?, second.prepare(b)?);
            Ok((of_first.take()?, of_second.take()?))
        };
        assert_eq!(tick(1.0, f64::INFINITY), Err(OperatorError::NotFinite));
        assert_eq!(tick(1.0, 5.0), Ok((2.0, 0.0)));
        assert_eq!(tick(f64::NAN, 1.0), Err(OperatorError::NotFinite));
        assert_eq!(tick(0.0, 6.0), Ok((-1.5, 2.0)));
        assert_eq!((first.memory().len(), second.memory().len()), (2, 2));
    }

    #[test]
    fn a_line_is_not_subtracted_where_its_length_is_not_known() {
        let told = || crate::recording_memory::RecordingMemory {
            stages: 1,
            leading: std::vec![1.0],
            leading_is_constant: true,
            acts_on: ActsOn::Values,
            terms: std::vec![0.0],
            capacity: usize::MAX,
            samples: std::vec::Vec::new(),
        };
        /// A memory with more samples than a `usize` can count.
        struct Beyond(crate::recording_memory::RecordingMemory);
        impl Memory<f64> for Beyond {
            fn channels(&self) -> usize {
                1
            }
            fn leading(&self) -> &[f64] {
                self.0.leading()
            }
            fn len(&self) -> usize {
                usize::MAX
            }
            fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
                self.0.next_term(term)
            }
            fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
                self.0.push(sample)
            }
            fn clear(&mut self) {
                self.0.clear();
            }
            fn bytes(&self) -> usize {
                0
            }
        }

        impl Stateful for Beyond {}
        let mut line = FractionalOperator::new(Beyond(told()), Start::CaputoWithRise { rise: 0.5 }).unwrap();
        assert_eq!(line.push(1.0), Err(MemoryError::Full { capacity: usize::MAX }.into()));
        let mut constant = FractionalOperator::new(Beyond(told()), Start::Caputo).unwrap();
        assert_eq!(constant.push(1.0), Ok(1.0));
    }

    #[test]
    fn the_right_operator_looks_ahead_and_is_the_adjoint_of_the_left_one() {
        let (f, g) = ([1.0, -2.0, 0.5, 4.0], [3.0, 0.25, -1.0, 2.0]);
        let (mut left, mut right) = ([f64::NAN; 4], [f64::NAN; 4]);
        left_operator(&WEIGHTS, &f, &mut left);
        right_operator(&WEIGHTS, &g, &mut right);
        // 2 g_k − 3/2 g_{k+1} + 1/4 g_{k+2}
        assert_eq!(right, [5.375, 2.5, -5.0, 4.0]);
        let product = |a: [f64; 4], b: [f64; 4]| -> f64 { a.into_iter().zip(b).map(|(a, b)| a * b).sum() };
        assert_eq!(product(g, left), product(right, f));
    }

    /// On D⁰, which returns the number it acts on.
    fn identity(
        start: Start<f64>,
    ) -> FractionalOperator<f64, crate::VariableStepMemory<f64, 1, std::vec::Vec<f64>, std::vec::Vec<f64>>>
    {
        let method = crate::RungeKutta::<1>::radau_iia().unwrap();
        let none = || std::vec::Vec::new();
        let table = crate::RateTable {
            exponent: 0.0,
            leading: std::vec![1.0],
            rates: none(),
            coefficients: none(),
            shortest: 1e-3,
            horizon: 1e3,
        };
        let state = std::vec![0.0; table.borrow::<f64>().state_len(1, 1)];
        let memory = crate::VariableStepMemory::new(&method, table, 1, state).unwrap();
        FractionalOperator::new(memory, start).unwrap()
    }

    #[test]
    fn samples_at_any_times_lose_their_start_and_their_slope() {
        let starts = [Start::RiemannLiouville, Start::Caputo, Start::CaputoWithSlope { slope: 0.5 }];
        // The first interval ends at the first sample, whose time is zero.
        let samples = [(0.25, 3.0), (1.0, 4.0), (2.5, -1.0), (0.125, 8.0)];
        let expected =
            [[3.0, 4.0, -1.0, 8.0], [0.0, 1.0, -4.0, 5.0], [0.0, 1.0 - 0.5, -4.0 - 1.75, 5.0 - 0.5 * 3.625]];
        for (start, expected) in starts.into_iter().zip(expected) {
            let mut operator = identity(start);
            for round in 0..2 {
                for ((interval, sample), expected) in samples.into_iter().zip(expected) {
                    assert_eq!(operator.push_after(interval, sample), Ok(expected), "{start:?}, {round}");
                }
                operator.clear();
                assert!(operator.memory().is_empty());
            }
            operator.push_after(0.25, 3.0).unwrap();
            operator.push_after(1.0, 4.0).unwrap();
            let mut bytes = std::vec![0; operator.state_bytes()];
            operator.save(&mut StateWriter::new(&mut bytes)).unwrap();
            let mut restored = identity(start);
            let mut reader = StateReader::new(&bytes);
            restored.restore(&mut reader).unwrap();
            assert_eq!(reader.finish(), Ok(()));
            assert_eq!(restored.push_after(2.5, -1.0), Ok(expected[2]));
            let other = Start::CaputoWithSlope { slope: 0.75 };
            assert!(identity(other).restore(&mut StateReader::new(&bytes)).is_err());
        }
    }

    #[test]
    fn a_rise_wants_equal_steps_and_a_slope_wants_times() {
        let refused = Err(OperatorError::Memory(MemoryError::StepLength));
        assert_eq!(identity(Start::CaputoWithRise { rise: 0.5 }).push_after(0.1, 1.0), refused);
        assert_eq!(identity(Start::CaputoWithSlope { slope: 0.5 }).push(1.0), refused);
        let mut operator = identity(Start::Caputo);
        assert_eq!(operator.push_after(1e-4, 1.0), refused);
        assert_eq!(operator.push_after(0.1, f64::NAN), Err(OperatorError::NotFinite));
        assert_eq!(operator.push_after(0.1, 2.0), Ok(0.0));
        let memory = FixedDirect::<f64, 1, 3>::full_memory(&WEIGHTS, 1.0).unwrap();
        let mut on_increments =
            FractionalOperator::new(memory.acting_on(ActsOn::Increments), Start::Caputo).unwrap();
        assert_eq!(on_increments.push_after(0.1, 1.0), refused);
    }
}
