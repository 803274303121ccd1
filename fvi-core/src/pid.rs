//! A fractional PID controller whose ticks are atomic: the whole state advances or none of it.

use core::borrow::{Borrow, BorrowMut};
use core::fmt;

use crate::direct::FixedDirect;
use crate::error::ParameterError;
use crate::exponential_sum::ExponentialSum;
use crate::generated::GeneratedMemory;
use crate::memory::Memory;
use crate::memoryless::Memoryless;
use crate::operator::{FractionalOperator, FromZero, FromZeroOrRest, OperatorError, Pending, Start};
use crate::pid_law::{AntiWindup, Bumpless, DerivativeFilter, DerivativeOf, PidGains, PidLaw, PidSettings};
use crate::real::{Real, sum_and_rest};
use crate::saving::{Shape, StateError, StateReader, StateWriter, Stateful, header_bytes};

/// A fractional PID controller on memories of any kind; see [`PidLaw`] for the equations.
///
/// One [`tick`](FractionalPid::tick) a sample time: it takes setpoint and measured value, returns the output,
/// and is atomic: a tick that is refused (numbers that are not finite, a memory that is full) leaves
/// everything as it was. The integral is in units of the output, I^λ of K_i e. For λ < 1 it is the value of
/// an operator plus an offset, which absorbs transfers and changes of gains; for λ ≥ 1 it is a sum, exact to
/// rounding, of I^{λ−1}. (I¹ D^{1−λ} for λ < 1 would accumulate the rounding of its memory: in single
/// precision up to 10⁻² after 10⁷ ticks of a signal of size 1, where the operator has lost 10⁻⁶.)
///
/// * **Limits and rate.** The output changes at most by the rate limit from one tick to the next, and never
///   exceeds the limits. Feed-forward is included.
/// * **Windup.** [`AntiWindup`] changes the samples that the integral takes, so that its whole memory, not
///   only its sum, is that of an integral which has never been far from the limits.
/// * **Manual.** [`manual`](FractionalPid::manual) sets the output and clears the memory of the integral.
///   [`automatic`](FractionalPid::automatic) returns control to the law: the first tick has the output of the
///   manual mode, to rounding, and the integral continues from there. Without an integral (K_i = 0) the
///   output follows from the law alone.
/// * **Gains** change at any time ([`set_gains`](FractionalPid::set_gains),
///   [`set_law`](FractionalPid::set_law)); [`Bumpless`] selects the value that stays the same.
/// * **Lost samples.** For a tick without a measurement repeat the previous value; a tick that is left out
///   shifts the time of the operators. For ticks that come early or late there are memories for steps of any
///   length, and [`tick_after`](FractionalPid::tick_after).
///
/// Parameters: the scalar T, the memories I of I^λ or I^{λ−1} and D of D^μ (in the series form of the filter
/// 1/(1 + (T_d/N) s^μ)), the law L by value or by reference, and the memory F of a fractional derivative
/// filter. [`RingPid`], [`ExponentialPid`] and others name the usual ones.
///
/// ```
/// use fvi_core::{
///     AntiWindup, BdfOrder, PidGains, PidLaw, PidSettings, RingPid, monic_bdf_table_f32,
/// };
/// const LAMBDA: f64 = 0.9;
/// const MU: f64 = 0.5;
/// static INTEGRAL: [f32; 256] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, -LAMBDA);
/// static DERIVATIVE: [f32; 256] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, MU);
///
/// struct Axis {
///     pid: RingPid<'static, f32, 256>,
/// }
///
/// let gains = PidGains::Parallel { proportional: 2.0, integral: 1.0, derivative: 0.3 };
/// let law = PidLaw::new(PidSettings {
///     integral_order: LAMBDA,
///     derivative_order: MU,
///     limits: [-5.0, 5.0],
///     anti_windup: AntiWindup::BackCalculation { time: 0.1 },
///     ..PidSettings::new(gains, 1e-3)
/// })?;
/// let integral = law.integral_kernel()?.short_memory(&INTEGRAL)?;
/// let derivative = law.derivative_kernel()?.short_memory(&DERIVATIVE)?;
/// let mut axis = Axis { pid: RingPid::new(law, integral, derivative)? };
/// // A large error: the output is at its limit, and back within as soon as the error has gone.
/// for _ in 0..1000 {
///     assert_eq!(axis.pid.tick(10.0, 0.0)?, 5.0);
/// }
/// assert!(axis.pid.tick(10.0, 10.0)? < 5.0);
/// // What is refused changes nothing.
/// let output = axis.pid.output();
/// assert!(axis.pid.tick(10.0, f32::NAN).is_err());
/// assert_eq!(axis.pid.output(), output);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct FractionalPid<T, I, D, L = PidLaw<T>, F = Memoryless<T>> {
    law: L,
    /// The operator I^λ, or I^{λ−1} whose values are summed in `state`.
    integral: FractionalOperator<T, I, FromZero>,
    derivative: Option<FractionalOperator<T, D, FromZeroOrRest>>,
    /// Operator of a fractional filter of the derivative.
    filter: Option<FractionalOperator<T, F, FromZero>>,
    state: PidState<T>,
}

/// A controller whose memories are rings of the latest H samples.
pub type RingPid<'w, T, const H: usize, L = PidLaw<T>> =
    FractionalPid<T, FixedDirect<'w, T, 1, H>, FixedDirect<'w, T, 1, H>, L>;

/// A PI^λ controller whose memory is a ring of the latest H samples.
pub type RingPi<'w, T, const H: usize, L = PidLaw<T>> =
    FractionalPid<T, FixedDirect<'w, T, 1, H>, Memoryless<T>, L>;

/// A controller whose memories are exponential sums with tables in flash; I and D are the
/// [`state_len`](crate::ExponentialTable::state_len) of these.
pub type ExponentialPid<'w, T, const I: usize, const D: usize, L = PidLaw<T>> =
    FractionalPid<T, ExponentialSum<T, &'w [T], [T; I]>, ExponentialSum<T, &'w [T], [T; D]>, L>;

/// A PI^λ controller whose memory is an exponential sum.
pub type ExponentialPi<'w, T, const I: usize, L = PidLaw<T>> =
    FractionalPid<T, ExponentialSum<T, &'w [T], [T; I]>, Memoryless<T>, L>;

/// State of a controller apart from that of its operators.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PidState<T> {
    mode: Mode,
    /// True from the first tick on.
    has_ticked: bool,
    /// The output of the last tick, or that of the manual mode.
    output: T,
    /// The output set in manual mode.
    manual: T,
    /// The derivative after the filter of order 1, as a compensated sum.
    filtered: CompensatedSum<T>,
    /// The gains of the last tick, if those of the law are others.
    replaced: Option<PidGains<T>>,
    /// The integral term of the last tick.
    integral: T,
    /// Sum or offset beside the integral operator.
    beside: CompensatedSum<T>,
}

impl<T: Real> PidState<T> {
    fn new() -> Self {
        let zero = T::zero();
        let beside = CompensatedSum { sum: zero, rest: zero };
        let filtered = beside;
        Self {
            mode: Mode::Automatic,
            has_ticked: false,
            output: zero,
            manual: zero,
            filtered,
            replaced: None,
            integral: zero,
            beside,
        }
    }
}

/// A compensated sum: its value and its rounding error.
#[derive(Clone, Copy, Debug, PartialEq)]
struct CompensatedSum<T> {
    sum: T,
    rest: T,
}

impl<T: Real> CompensatedSum<T> {
    #[inline(always)]
    fn plus(self, more: T) -> Self {
        let (sum, rest) = sum_and_rest(self.sum, more + self.rest);
        Self { sum, rest }
    }

    /// The new sum or offset for this value of the operator, and the integral term: with a `step` the sum of
    /// `step` times the values, otherwise the value plus the offset.
    #[inline(always)]
    fn with(self, step: Option<T>, value: T) -> (Self, T) {
        match step {
            Some(step) => {
                let kept = self.plus(step * value);
                (kept, kept.sum)
            }
            None => (self, value + self.sum),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    Automatic,
    Manual,
    /// From manual to automatic on the next tick.
    Transfer,
}

/// Inputs of a tick. [`PidInputs::new`] sets setpoint and measured value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PidInputs<T> {
    /// r.
    pub setpoint: T,
    /// y.
    pub measured: T,
    /// ẏ, used by a derivative of a [measured rate](DerivativeOf::MeasuredRate) only, which refuses a value
    /// that is not a number.
    pub rate: T,
    /// u_ff.
    pub feed_forward: T,
    /// Response of the actuator to the output of the previous tick.
    pub actuator: Actuator<T>,
}

impl<T: Real> PidInputs<T> {
    /// Setpoint and measured value alone; the rate is not a number.
    pub fn new(setpoint: T, measured: T) -> Self {
        let rate = T::of(f64::NAN);
        Self { setpoint, measured, rate, feed_forward: T::zero(), actuator: Actuator::Followed }
    }

    /// r − y, and refuses numbers that are not finite, the rate and the difference apart.
    #[inline(always)]
    fn error(&self) -> Result<T, PidError> {
        let error = self.setpoint - self.measured;
        // It is finite only if both are.
        if !error.is_finite() {
            finite("the setpoint", self.setpoint)?;
            finite("the measured value", self.measured)?;
        }
        finite("the feed-forward", self.feed_forward)?;
        if let Actuator::Applied(applied) = self.actuator {
            finite("what the actuator applied", applied)?;
        }
        Ok(error)
    }
}

/// Response of an actuator to the output of the previous tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Actuator<T> {
    /// It applied the output.
    Followed,
    /// It applied this value. Back-calculation feeds the difference back into the samples of the integral, by
    /// an equation that is stable for every tracking time and 0 < λ < 2; conditional integration takes it for
    /// a limit on that side; without anti-windup it has no effect.
    Applied(T),
    /// The actuator, or something after it, is at a limit unknown to the controller: in this tick the
    /// integral only shrinks.
    Limited,
}

/// Reason why a controller refused a call; the controller is unchanged.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PidError {
    /// An input or a result is infinite or not a number.
    NotFinite {
        /// Name of that number.
        what: &'static str,
    },
    /// An operator refused its sample.
    Operator(OperatorError),
    /// A tick with an interval requires a law without a sample time; a tick without an interval requires one
    /// with it.
    Interval,
}

impl fmt::Display for PidError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite { what } => write!(f, "{what} is not a finite number"),
            Self::Operator(error) => error.fmt(f),
            Self::Interval => {
                write!(f, "ticks with a positive interval are for laws without a sample time, and no others")
            }
        }
    }
}

impl core::error::Error for PidError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Operator(error) => Some(error),
            Self::NotFinite { .. } | Self::Interval => None,
        }
    }
}

impl From<OperatorError> for PidError {
    fn from(error: OperatorError) -> Self {
        Self::Operator(error)
    }
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"fpid";
/// Added to the saved mode from the first tick on.
const TICKED: u64 = 4;

impl<T, I, D, L> FractionalPid<T, I, D, L>
where
    T: Real,
    I: Memory<T>,
    D: Memory<T>,
    L: Borrow<PidLaw<T>>,
{
    /// A controller on memories of the law's kernels ([`PidLaw::integral_kernel`],
    /// [`PidLaw::derivative_kernel`]), in automatic mode.
    ///
    /// # Errors
    /// [`ParameterError`] if the weights of a memory are not those of its kernel, or the law has a fractional
    /// filter.
    pub fn new(law: L, integral: I, derivative: D) -> Result<Self, ParameterError> {
        Self::with_parts(law, integral, Some(derivative), None)
    }

    /// A PI^λ controller.
    ///
    /// # Errors
    /// As [`new`](FractionalPid::new), and if the law has a derivative.
    pub fn without_derivative(law: L, integral: I) -> Result<Self, ParameterError> {
        Self::with_parts(law, integral, None, None)
    }
}

impl<T, I, D, L, F> FractionalPid<T, I, D, L, F>
where
    T: Real,
    I: Memory<T>,
    D: Memory<T>,
    L: Borrow<PidLaw<T>>,
    F: Memory<T>,
{
    /// A controller whose law has a fractional filter of the derivative, with its memory
    /// ([`PidLaw::filter_kernel`]).
    ///
    /// # Errors
    /// [`ParameterError`] if the weights of a memory are not those of its kernel, or the law has no such
    /// filter.
    pub fn with_filter(law: L, integral: I, derivative: D, filter: F) -> Result<Self, ParameterError> {
        Self::with_parts(law, integral, Some(derivative), Some(filter))
    }

    /// A controller of these parts, for parts that are known at run time only; otherwise use
    /// [`new`](FractionalPid::new), [`without_derivative`](FractionalPid::without_derivative) or
    /// [`with_filter`](FractionalPid::with_filter).
    ///
    /// # Errors
    /// [`ParameterError`] if the weights of a memory are not those of its kernel, a derivative lacks its
    /// memory, or there is a memory of a filter without a fractional filter or the other way round.
    pub fn with_parts(
        law: L,
        integral: I,
        derivative: Option<D>,
        filter: Option<F>,
    ) -> Result<Self, ParameterError> {
        let shared: &PidLaw<T> = law.borrow();
        let settings = *shared.settings();
        let gain = if settings.gains.differentiates() { 1.0 } else { 0.0 };
        let allowed = "0 without a memory of the derivative";
        ParameterError::check(derivative.is_some() || gain == 0.0, "derivative gain", gain, allowed)?;
        let filter_kernel = shared.filter_kernel()?;
        ParameterError::check(
            filter.is_some() == filter_kernel.is_some(),
            "memory of the derivative's filter",
            f64::NAN,
            "there for a fractional filter, and for no other",
        )?;
        let refused = ParameterError { parameter: "memory", value: f64::NAN, allowed: "one of one channel" };
        let kernel = shared.integral_kernel()?;
        let mut memory = integral;
        kernel.check(&mut memory, 0)?;
        let integral = FractionalOperator::starting(memory, FromZero).map_err(|_| refused)?;
        let derivative = match derivative {
            Some(mut memory) => {
                shared.derivative_kernel()?.check(&mut memory, 0)?;
                Some(FractionalOperator::starting(memory, shared.start()).map_err(|_| refused)?)
            }
            None => None,
        };
        let filter = match (filter, filter_kernel) {
            (Some(mut memory), Some(kernel)) => {
                kernel.check(&mut memory, 0)?;
                Some(FractionalOperator::starting(memory, FromZero).map_err(|_| refused)?)
            }
            _ => None,
        };
        Ok(Self { law, integral, derivative, filter, state: PidState::new() })
    }

    /// A controller on memories that were generated with the law `checked`: nothing is left to compute, and
    /// where these are constants nothing to compare. Its law is `law`, that one or another for the same
    /// operators.
    ///
    /// # Errors
    /// [`ParameterError`] if `checked` is not the [`sealed`](PidLaw::sealed) law of these memories, or `law`
    /// needs other operators.
    #[inline(always)]
    pub fn generated(
        checked: &PidLaw<T>,
        law: L,
        integral: I,
        derivative: Option<D>,
        filter: Option<F>,
    ) -> Result<Self, ParameterError>
    where
        I: GeneratedMemory<T>,
        D: GeneratedMemory<T>,
        F: GeneratedMemory<T>,
    {
        let refused = ParameterError {
            parameter: "memory",
            value: f64::NAN,
            allowed: "those that were generated with the law",
        };
        let seals = [
            I::SEAL,
            if derivative.is_some() { D::SEAL } else { 0 },
            if filter.is_some() { F::SEAL } else { 0 },
        ];
        // One by one the compiler compares constants.
        if !checked.memories.iter().eq(&seals) {
            return Err(refused);
        }
        let shared: &PidLaw<T> = law.borrow();
        shared.follows(checked)?;
        if derivative.is_none() && shared.settings().gains.differentiates() {
            return Err(refused);
        }
        let integral = FractionalOperator::starting(integral, FromZero).map_err(|_| refused)?;
        let start = shared.start();
        let derivative = match derivative {
            Some(memory) => Some(FractionalOperator::starting(memory, start).map_err(|_| refused)?),
            None => None,
        };
        let filter = match filter {
            Some(memory) => Some(FractionalOperator::starting(memory, FromZero).map_err(|_| refused)?),
            None => None,
        };
        Ok(Self { law, integral, derivative, filter, state: PidState::new() })
    }

    /// Takes setpoint r and measured value y and returns the output u.
    ///
    /// # Errors
    /// [`PidError`]; the controller then is unchanged. A derivative of a measured rate requires
    /// [`tick_with`](FractionalPid::tick_with).
    #[inline]
    pub fn tick(&mut self, setpoint: T, measured: T) -> Result<T, PidError> {
        self.step(None, &PidInputs::new(setpoint, measured))
    }

    /// The same for an actuator that reports the value it applied in the previous tick.
    ///
    /// # Errors
    /// As [`tick`](FractionalPid::tick).
    pub fn tick_applied(&mut self, setpoint: T, measured: T, applied: T) -> Result<T, PidError> {
        let actuator = Actuator::Applied(applied);
        self.step(None, &PidInputs { actuator, ..PidInputs::new(setpoint, measured) })
    }

    /// The same with all inputs of a tick.
    ///
    /// # Errors
    /// As [`tick`](FractionalPid::tick).
    pub fn tick_with(&mut self, inputs: &PidInputs<T>) -> Result<T, PidError> {
        self.step(None, inputs)
    }

    /// A tick that comes `interval` units of time after the previous one, for a law without a sample time.
    /// The first interval is the length of a step that ends with the first tick.
    ///
    /// # Errors
    /// As [`tick`](FractionalPid::tick), and if a memory does not serve the interval.
    pub fn tick_after(&mut self, interval: T, inputs: &PidInputs<T>) -> Result<T, PidError> {
        self.step(Some(interval), inputs)
    }

    #[inline(always)]
    fn step(&mut self, interval: Option<T>, inputs: &PidInputs<T>) -> Result<T, PidError> {
        let Self { law, integral, derivative, filter, state } = self;
        let law: &PidLaw<T> = (*law).borrow();
        let settings = law.settings();
        let &PidInputs { feed_forward, actuator, .. } = inputs;
        let error = inputs.error()?;
        let (stride, share) = match interval {
            None if settings.sample.is_some() => (law.constants.stride, law.constants.filter_share),
            Some(interval) if settings.sample.is_none() && interval > T::zero() => {
                finite("the interval", interval)?;
                (settings.rate_limit * interval, interval / (law.constants.filter_time + interval))
            }
            _ => return Err(PidError::Interval),
        };
        finite("the control error", error)?;
        let signals = Signals::of(
            law,
            (derivative.as_mut(), filter.as_mut()),
            state.filtered,
            (interval, share),
            inputs,
            error,
        )?;
        let Signals { in_proportion, derived, filtered, .. } = signals;
        let now = Terms::of(&settings.gains, in_proportion, derived, error);
        let allowed =
            Allowed { limits: settings.limits, reach: [state.output - stride, state.output + stride] };
        if state.mode == Mode::Manual {
            let output = allowed.nearest(state.manual);
            if !derived.is_finite() {
                return Err(not_finite("the derivative", [signals.value(), None]));
            }
            signals.take()?;
            *state = PidState { has_ticked: true, output, filtered, replaced: None, ..*state };
            return Ok(output);
        }
        let pending = prepare(integral, interval, now.sample)?;
        let step = if law.accumulates { Some(interval.unwrap_or(law.constants.step)) } else { None };
        let leading = match step {
            Some(step) => step * pending.leading(),
            None => pending.leading(),
        };
        let beside = now.proportional + now.derivative + feed_forward;
        let (_, mut value) = state.beside.with(step, pending.value());
        let plain = beside + value;
        let integrates = now.integral_gain != T::zero();
        let shift = match (state.mode, &state.replaced) {
            (Mode::Transfer, _) if integrates => state.output - plain,
            (_, Some(gains))
                if (integrates || gains.integral() != T::zero())
                    && settings.bumpless != Bumpless::Nothing =>
            {
                let derived = signals.derived_with(gains, &settings.gains);
                let old = Terms::of(gains, in_proportion, derived, error);
                old.without_bump(&now, settings, leading)
            }
            _ => T::zero(),
        };
        let (mut start, mut base) = (state.integral, state.beside);
        if shift != T::zero() {
            (start, base) = (start + shift, base.plus(shift));
            (_, value) = base.with(step, pending.value());
        }
        let raw = beside + value;
        // The output has a part of every number before it: if one of them is not finite, it is not either.
        if !raw.is_finite() {
            return Err(not_finite("the output before its limits", [signals.value(), Some(pending.value())]));
        }
        let (output, sample) = if integrates {
            let term = IntegralTerm { beside, value, start, leading, sample: now.sample };
            term.limited(law, actuator, state.output, &allowed, raw)?
        } else {
            (allowed.nearest(raw), None)
        };
        let pending = match sample {
            Some(sample) => pending.instead(sample)?,
            None => pending,
        };
        let (kept, value) = base.with(step, pending.value());
        if !value.is_finite() {
            return Err(not_finite("the integral", [None, Some(pending.value())]));
        }
        pending.take()?;
        signals.take()?;
        *state = PidState {
            mode: Mode::Automatic,
            has_ticked: true,
            output,
            manual: state.manual,
            filtered,
            replaced: None,
            integral: value,
            beside: kept,
        };
        Ok(output)
    }

    /// Sets the output to u, from the next tick on, within limits and rate. The derivative continues; the
    /// memory of the integral is cleared. Before the first tick, where an actuator stands at u already, no
    /// rate holds it up: for a bumpless start [`automatic`](FractionalPid::automatic) may follow at once.
    ///
    /// # Errors
    /// [`PidError::NotFinite`].
    pub fn manual(&mut self, output: T) -> Result<(), PidError> {
        finite("the manual output", output)?;
        if !self.state.has_ticked {
            self.state.output = within(output, self.law.borrow().settings().limits);
        }
        if self.state.mode != Mode::Manual {
            self.integral.clear();
            let PidState { integral, beside, .. } = PidState::new();
            (self.state.integral, self.state.beside) = (integral, beside);
        }
        (self.state.mode, self.state.manual) = (Mode::Manual, output);
        Ok(())
    }

    /// Returns to automatic mode. The next tick has the output of the previous one, and the integral
    /// continues from there.
    pub fn automatic(&mut self) {
        if self.state.mode == Mode::Manual {
            self.state.mode = Mode::Transfer;
        }
    }

    /// True if the output is set by hand.
    pub fn is_manual(&self) -> bool {
        self.state.mode == Mode::Manual
    }

    /// Changes gains, from the next tick on; [`Bumpless`] selects the value that stays the same.
    ///
    /// In every language they are the factors of the operators: of I^λ the series form has 1/T_i, of D^μ T_d.
    ///
    /// # Errors
    /// [`ParameterError`] if a gain is out of range, the form differs, or a derivative has no memory.
    pub fn set_gains(&mut self, gains: PidGains<T>) -> Result<(), ParameterError>
    where
        L: BorrowMut<PidLaw<T>>,
    {
        let law = (*Borrow::<PidLaw<T>>::borrow(&self.law)).with_gains(gains)?;
        self.check_derivative(&law)?;
        let last = self.last_gains();
        *self.law.borrow_mut() = law;
        self.state.replaced = self.replaced(last);
        Ok(())
    }

    /// Changes the law, from the next tick on: gains, weights, limits, times of filters; not form, orders and
    /// sample time. [`Bumpless`] of the new law selects the value that stays the same when gains change.
    ///
    /// # Errors
    /// [`ParameterError`] if the law has other operators.
    pub fn set_law(&mut self, law: L) -> Result<(), ParameterError> {
        let new: &PidLaw<T> = law.borrow();
        new.follows(self.law.borrow())?;
        self.check_derivative(new)?;
        let last = self.last_gains();
        self.law = law;
        self.state.replaced = self.replaced(last);
        Ok(())
    }

    /// The gains of the last tick.
    fn last_gains(&self) -> PidGains<T> {
        match self.state.replaced {
            Some(gains) => gains,
            None => self.law.borrow().settings().gains,
        }
    }

    /// These gains of the last tick, if those of the law are others.
    fn replaced(&self, gains: PidGains<T>) -> Option<PidGains<T>> {
        Some(gains).filter(|gains| *gains != self.law.borrow().settings().gains)
    }

    fn check_derivative(&self, law: &PidLaw<T>) -> Result<(), ParameterError> {
        let served = self.derivative.is_some() || !law.settings().gains.differentiates();
        ParameterError::check(served, "derivative gain", 1.0, "0 without a memory of the derivative")
    }

    /// Returns to the state after construction, in automatic mode, with the present law.
    pub fn reset(&mut self) {
        self.integral.clear();
        if let Some(derivative) = &mut self.derivative {
            derivative.clear();
        }
        if let Some(filter) = &mut self.filter {
            filter.clear();
        }
        self.state = PidState::new();
    }

    /// The law.
    pub fn law(&self) -> &PidLaw<T> {
        self.law.borrow()
    }

    /// The output of the last tick; 0 before the first.
    pub fn output(&self) -> T {
        self.state.output
    }

    /// The integral term of the output: K_i I^λ of the samples, as modified by limits and transfers.
    pub fn integral(&self) -> T {
        self.state.integral
    }

    /// The memory of the integral.
    pub fn integral_memory(&self) -> &I {
        self.integral.memory()
    }

    /// Header of the saved state: the values that must match when it is restored.
    fn shape(&self) -> Shape<4> {
        let settings = self.law.borrow().settings();
        let series = u64::from(matches!(settings.gains, PidGains::Series { .. }));
        let parts = u64::from(self.derivative.is_some()) << 1 | u64::from(self.filter.is_some()) << 2;
        [
            ("form and operators", series | parts),
            ("bits of the integral order", settings.integral_order.to_bits()),
            ("bits of the derivative order", settings.derivative_order.to_bits()),
            ("bits of the sample time", settings.sample.unwrap_or(0.0).to_bits()),
        ]
    }

    /// The part of a saved state before those of the memories.
    #[inline(never)]
    fn read_state(&self, from: &mut StateReader<'_>) -> Result<PidState<T>, StateError> {
        from.header::<T, 4>(TAG, &self.shape())?;
        let found = from.count()?;
        let mode = match found & !TICKED {
            0 => Mode::Automatic,
            1 => Mode::Manual,
            2 => Mode::Transfer,
            _ => return Err(StateError::TooLarge { what: "mode", limit: 2 | TICKED, found }),
        };
        let has_ticked = found & TICKED != 0;
        let mut numbers = [T::zero(); 11];
        from.fill(&mut numbers)?;
        let [output, manual, sum, rest, integral, sum_beside, rest_beside, gains @ ..] = numbers;
        let filtered = CompensatedSum { sum, rest };
        let beside = CompensatedSum { sum: sum_beside, rest: rest_beside };
        let replaced = self.replaced(with_numbers(&self.law.borrow().settings().gains, gains));
        Ok(PidState { mode, has_ticked, output, manual, filtered, replaced, integral, beside })
    }
}

/// All that the memories hold; the law is not included.
impl<T, I, D, L, F> Stateful for FractionalPid<T, I, D, L, F>
where
    T: Real,
    I: Memory<T>,
    D: Memory<T>,
    L: Borrow<PidLaw<T>>,
    F: Memory<T>,
{
    fn state_bytes(&self) -> usize {
        let memories =
            self.integral.state_bytes() + self.derivative.state_bytes() + self.filter.state_bytes();
        header_bytes(4) + 8 + 11 * T::BYTES + memories
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 4>(TAG, &self.shape())?;
        let state = &self.state;
        let mode = match state.mode {
            Mode::Automatic => 0,
            Mode::Manual => 1,
            Mode::Transfer => 2,
        };
        to.count(if state.has_ticked { mode | TICKED } else { mode })?;
        let CompensatedSum { sum, rest } = state.filtered;
        let beside = state.beside;
        let signals = [state.output, state.manual, sum, rest, state.integral, beside.sum, beside.rest];
        to.slice(&signals)?;
        to.slice(&numbers_of(&self.last_gains()))?;
        self.integral.save(to)?;
        self.derivative.save(to)?;
        self.filter.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.read_state(from)?;
        self.integral.check_state(from)?;
        self.derivative.check_state(from)?;
        self.filter.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        self.state = self.read_state(from)?;
        self.integral.restore(from)?;
        self.derivative.restore(from)?;
        self.filter.restore(from)
    }
}

/// The terms of a law, and the sample of its integral.
struct Terms<T> {
    proportional: T,
    derivative: T,
    integral_gain: T,
    /// K_i e, or in the series form K_i times the input of the integral.
    sample: T,
}

impl<T: Real> Terms<T> {
    /// `derived` is the derivative, or in the series form the output of the filter.
    #[inline(always)]
    fn of(gains: &PidGains<T>, in_proportion: T, derived: T, error: T) -> Self {
        let integral_gain = gains.integral();
        match *gains {
            PidGains::Parallel { proportional, derivative, .. } => Self {
                proportional: proportional * in_proportion,
                derivative: derivative * derived,
                integral_gain,
                sample: integral_gain * error,
            },
            PidGains::Series { proportional, filter_ratio, .. } => {
                let lead = filter_ratio * error - (filter_ratio - T::one()) * derived;
                Self {
                    proportional: proportional * lead,
                    derivative: T::zero(),
                    integral_gain,
                    sample: integral_gain * lead,
                }
            }
        }
    }

    /// What is added to the integral so that other gains, `now`, leave the output where these would have it.
    #[inline(always)]
    fn without_bump(&self, now: &Self, settings: &PidSettings<T>, leading: T) -> T {
        let series = matches!(settings.gains, PidGains::Series { .. });
        let proportional = match settings.bumpless {
            Bumpless::ExceptProportional if !series => T::zero(),
            _ => self.proportional - now.proportional,
        };
        proportional + (self.derivative - now.derivative) + leading * (self.sample - now.sample)
    }
}

/// The signals that the gains multiply, and the pending samples of the operators.
struct Signals<'a, T: Real, D: Memory<T>, F: Memory<T>> {
    in_proportion: T,
    derived: T,
    filtered: CompensatedSum<T>,
    pending_derivative: Option<Pending<'a, T, D, FromZeroOrRest>>,
    pending_filter: Option<Pending<'a, T, F, FromZero>>,
}

impl<'a, T: Real, D: Memory<T>, F: Memory<T>> Signals<'a, T, D, F> {
    /// Of a law with these operators of derivative and filter; `share` is that of a sample in the filter of
    /// first order.
    #[inline(always)]
    fn of(
        law: &PidLaw<T>,
        (derivative, filter): (Operator<'a, T, D, FromZeroOrRest>, Operator<'a, T, F, FromZero>),
        before: CompensatedSum<T>,
        (interval, share): (Option<T>, T),
        &PidInputs { setpoint, measured, rate, .. }: &PidInputs<T>,
        error: T,
    ) -> Result<Self, PidError> {
        let settings = law.settings();
        let (mut pending_derivative, mut pending_filter) = (None, None);
        let mut filtered = before;
        let (in_proportion, derived) = match settings.gains {
            PidGains::Parallel { .. } => {
                let [b, c] = settings.setpoint_weights;
                if let Some(derivative) = derivative {
                    let signal = match settings.derivative_of {
                        DerivativeOf::MeasuredRate => {
                            finite("the measured rate", rate)?;
                            -rate
                        }
                        DerivativeOf::Values | DerivativeOf::ValuesFromRest => c * setpoint - measured,
                    };
                    let pending = prepare(derivative, interval, signal)?;
                    filtered = match (settings.derivative_filter, filter) {
                        (DerivativeFilter::FirstOrder { .. }, _) => {
                            before.plus(share * (pending.value() - before.sum))
                        }
                        (DerivativeFilter::Fractional { .. }, Some(filter)) => {
                            let (behind, pending) =
                                relaxed(filter, interval, law.constants.filter_time, pending.value())?;
                            pending_filter = Some(pending);
                            CompensatedSum { sum: behind, ..before }
                        }
                        _ => CompensatedSum { sum: pending.value(), ..before },
                    };
                    pending_derivative = Some(pending);
                }
                (b * setpoint - measured, filtered.sum)
            }
            PidGains::Series { derivative_time, filter_ratio, .. } => match derivative {
                Some(derivative) => {
                    // (1 + T_d s^μ)/(1 + (T_d/N) s^μ) = N − (N − 1)/(1 + (T_d/N) s^μ)
                    let (behind, pending) =
                        relaxed(derivative, interval, derivative_time / filter_ratio, error)?;
                    pending_derivative = Some(pending);
                    (error, behind)
                }
                None => (error, error),
            },
        };
        Ok(Self { in_proportion, derived, filtered, pending_derivative, pending_filter })
    }

    /// The derivative, or the output of the series form's filter, if `gains` were those of this tick in
    /// place of `now`.
    ///
    /// With x + τ (p + w x) = e for the filter's output x, where p + w x = D^μ x, the output for another τ'
    /// is x' = x + (τ − τ') D^μ x/(1 + τ' w).
    #[inline(always)]
    fn derived_with(&self, gains: &PidGains<T>, now: &PidGains<T>) -> T {
        match (gains.filter_time(), now.filter_time(), &self.pending_derivative) {
            (Some(time), Some(present), Some(pending)) => {
                self.derived + (present - time) * pending.value() / (T::one() + time * pending.leading())
            }
            _ => self.derived,
        }
    }

    /// The value of the derivative's operator.
    #[inline(always)]
    fn value(&self) -> Option<T> {
        self.pending_derivative.as_ref().map(Pending::value)
    }

    /// Takes the samples of the operators.
    #[inline(always)]
    fn take(self) -> Result<(), OperatorError> {
        if let Some(pending) = self.pending_derivative {
            pending.take()?;
        }
        if let Some(pending) = self.pending_filter {
            pending.take()?;
        }
        Ok(())
    }
}

/// The integral and what stands beside it in the output, before the limits.
struct IntegralTerm<T> {
    beside: T,
    /// With the present sample, and before it.
    value: T,
    start: T,
    /// ∂value/∂sample, and the sample.
    leading: T,
    sample: T,
}

impl<T: Real> IntegralTerm<T> {
    /// The output that integrates on, from `raw` before limits and without regard to windup, and the sample
    /// that leads there in place of the present one; `last` was the output before.
    #[inline(always)]
    fn limited(
        &self,
        law: &PidLaw<T>,
        actuator: Actuator<T>,
        last: T,
        allowed: &Allowed<T>,
        raw: T,
    ) -> Result<(T, Option<T>), PidError> {
        let &Self { beside, value, start, leading, sample } = self;
        match (law.settings().anti_windup, actuator) {
            (_, Actuator::Limited) => {
                let least = if start < T::zero() { start } else { T::zero() };
                let most = if start > T::zero() { start } else { T::zero() };
                self.held_at(within(value, [least, most]), allowed)
            }
            (AntiWindup::BackCalculation { .. }, _) => {
                let tracking = law.constants.tracking;
                // f = (missed − w f)/τ^λ: what is fed back is part of the output that it corrects.
                let (feedback, missed) = match actuator {
                    Actuator::Applied(applied) => {
                        let missed = applied - last;
                        (tracking * missed / (T::one() + leading * tracking), missed != T::zero())
                    }
                    _ => (T::zero(), false),
                };
                let raw = raw + leading * feedback;
                let output = allowed.nearest(raw);
                // u* = a + w (u − u*)/τ^λ beyond a limit.
                let beyond = (raw - output) / (T::one() + leading * tracking);
                let changed = missed || beyond != T::zero();
                Ok((output, changed.then(|| sample + feedback - tracking * beyond)))
            }
            (AntiWindup::Conditional, _) => {
                let [lowest, highest] = allowed.ends();
                let [least, most] = match actuator {
                    Actuator::Applied(applied) => [
                        if applied > last { applied } else { lowest },
                        if applied < last { applied } else { highest },
                    ],
                    _ => [lowest, highest],
                };
                // Value of the integral without the present sample.
                let alone = value - leading * sample;
                let (falling, rising) = if alone < start { (alone, start) } else { (start, alone) };
                let held = if raw > most {
                    smaller(value, larger(most - beside, falling))
                } else if raw < least {
                    larger(value, smaller(least - beside, rising))
                } else {
                    value
                };
                self.held_at(held, allowed)
            }
            (AntiWindup::None, _) => Ok((allowed.nearest(raw), None)),
        }
    }

    /// The output with another value of the integral, and the sample for it.
    #[inline(always)]
    fn held_at(&self, held: T, allowed: &Allowed<T>) -> Result<(T, Option<T>), PidError> {
        let raw = self.beside + held;
        finite("the output before its limits", raw)?;
        let sample = || self.sample + (held - self.value) / self.leading;
        Ok((allowed.nearest(raw), (held != self.value).then(sample)))
    }
}

/// The outputs that limits and rate allow.
struct Allowed<T> {
    limits: [T; 2],
    /// As far as the rate allows.
    reach: [T; 2],
}

impl<T: Real> Allowed<T> {
    /// The nearest output within reach, and within the limits, wherever they are.
    #[inline(always)]
    fn nearest(&self, output: T) -> T {
        within(within(output, self.reach), self.limits)
    }

    /// The smallest and the largest of them.
    #[inline(always)]
    fn ends(&self) -> [T; 2] {
        self.reach.map(|end| within(end, self.limits))
    }
}

/// The operator of a part of the law that has one.
type Operator<'a, T, M, S> = Option<&'a mut FractionalOperator<T, M, S>>;

/// The value of an operator, which may be infinite or not a number.
#[inline(always)]
fn prepare<T: Real, M: Memory<T>, S: Copy + Into<Start<T>>>(
    operator: &mut FractionalOperator<T, M, S>,
    interval: Option<T>,
    sample: T,
) -> Result<Pending<'_, T, M, S>, OperatorError> {
    match interval {
        None => operator.prepare_any(sample),
        Some(interval) => operator.prepare_any_after(interval, sample),
    }
}

/// Solves x + T D^ν x = `signal`; returns x and the pending operator.
#[inline(always)]
fn relaxed<T: Real, M: Memory<T>, S: Copy + Into<Start<T>>>(
    operator: &mut FractionalOperator<T, M, S>,
    interval: Option<T>,
    time: T,
    signal: T,
) -> Result<(T, Pending<'_, T, M, S>), OperatorError> {
    let pending = prepare(operator, interval, T::zero())?.finite()?;
    let behind = (signal - time * pending.value()) / (T::one() + time * pending.leading());
    Ok((behind, pending.instead(behind)?.finite()?))
}

/// Why the number `what` is not finite: the value of an operator before it is not, or itself.
#[inline(always)]
fn not_finite<T: Real>(what: &'static str, operators: [Option<T>; 2]) -> PidError {
    let all = operators.iter().flatten().all(|value| value.is_finite());
    if all { PidError::NotFinite { what } } else { OperatorError::NotFinite.into() }
}

#[inline(always)]
fn finite<T: Real>(what: &'static str, number: T) -> Result<(), PidError> {
    if number.is_finite() { Ok(()) } else { Err(PidError::NotFinite { what }) }
}

#[inline(always)]
fn larger<T: Real>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

#[inline(always)]
fn smaller<T: Real>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

/// The nearest number that is neither below `lower` nor above `upper`.
#[inline(always)]
fn within<T: Real>(number: T, [lower, upper]: [T; 2]) -> T {
    if number > upper {
        upper
    } else if number < lower {
        lower
    } else {
        number
    }
}

fn numbers_of<T: Real>(gains: &PidGains<T>) -> [T; 4] {
    match *gains {
        PidGains::Parallel { proportional, integral, derivative } => {
            [proportional, integral, derivative, T::zero()]
        }
        PidGains::Series { proportional, integral_rate, derivative_time, filter_ratio } => {
            [proportional, integral_rate, derivative_time, filter_ratio]
        }
    }
}

/// Gains of the same form with these numbers.
fn with_numbers<T: Real>(form: &PidGains<T>, [first, second, third, fourth]: [T; 4]) -> PidGains<T> {
    match form {
        PidGains::Parallel { .. } => {
            PidGains::Parallel { proportional: first, integral: second, derivative: third }
        }
        PidGains::Series { .. } => PidGains::Series {
            proportional: first,
            integral_rate: second,
            derivative_time: third,
            filter_ratio: fourth,
        },
    }
}
