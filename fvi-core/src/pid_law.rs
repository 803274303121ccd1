//! The law of a fractional PID controller: the part that many controllers can share, without their states.

use nalgebra::Complex;

use crate::error::{ParameterError, check_step_size};
use crate::kernel::Kernel;
use crate::operator::FromZeroOrRest;
use crate::real::Real;
use crate::runge_kutta::RungeKutta;
use crate::weights::BdfOrder;

/// Gains of a [`PidLaw`]; the variant is its form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PidGains<T> {
    /// u = K_p (b r − y) + K_i I^λ (r − y) + K_d D^μ (c r − y)_f
    Parallel {
        /// K_p.
        proportional: T,
        /// K_i.
        integral: T,
        /// K_d.
        derivative: T,
    },
    /// C(s) = K_p (1 + 1/(T_i s^λ)) (1 + T_d s^μ) / (1 + (T_d/N) s^μ), acting on r − y.
    Series {
        /// K_p.
        proportional: T,
        /// 1/T_i, in units of time^{−λ}; 0 for no integral.
        integral_rate: T,
        /// T_d, in units of time^μ; 0 for no derivative.
        derivative_time: T,
        /// N, the largest gain of the derivative factor.
        filter_ratio: T,
    },
}

impl<T: Real> PidGains<T> {
    /// K_i, the gain of I^λ when the form is multiplied out.
    #[inline(always)]
    pub(crate) fn integral(&self) -> T {
        match *self {
            Self::Parallel { integral, .. } => integral,
            Self::Series { proportional, integral_rate, .. } => proportional * integral_rate,
        }
    }

    /// True if there is a derivative.
    pub(crate) fn differentiates(&self) -> bool {
        match *self {
            Self::Parallel { derivative, .. } => derivative != T::zero(),
            Self::Series { derivative_time, .. } => derivative_time != T::zero(),
        }
    }

    pub(crate) fn same_form(&self, other: &Self) -> bool {
        matches!(
            (self, other),
            (Self::Parallel { .. }, Self::Parallel { .. }) | (Self::Series { .. }, Self::Series { .. })
        )
    }

    /// T_d/N of the series form.
    #[inline(always)]
    pub(crate) fn filter_time(&self) -> Option<T> {
        match *self {
            Self::Parallel { .. } => None,
            Self::Series { derivative_time, filter_ratio, .. } => Some(derivative_time / filter_ratio),
        }
    }

    /// # Errors
    /// If a gain is not finite, or a time negative, or N not positive.
    pub(crate) fn check(&self) -> Result<(), ParameterError> {
        let finite =
            |name, gain: T| ParameterError::check(gain.is_finite(), name, gain.to_f64(), "a finite number");
        match *self {
            Self::Parallel { proportional, integral, derivative } => {
                finite("proportional gain", proportional)?;
                finite("integral gain", integral)?;
                finite("derivative gain", derivative)
            }
            Self::Series { proportional, integral_rate, derivative_time, filter_ratio } => {
                finite("proportional gain", proportional)?;
                finite("integral rate", integral_rate)?;
                finite("integral gain", self.integral())?;
                let (time, ratio) = (derivative_time.to_f64(), filter_ratio.to_f64());
                let allowed = "at least 0 and finite";
                ParameterError::check(time >= 0.0 && time.is_finite(), "derivative time", time, allowed)?;
                let allowed = "positive and finite";
                ParameterError::check(ratio > 0.0 && ratio.is_finite(), "filter ratio", ratio, allowed)?;
                let finite = (derivative_time / filter_ratio).is_finite();
                let allowed = "finite also when divided by the filter ratio";
                ParameterError::check(finite, "derivative time", time, allowed)
            }
        }
    }
}

/// Filter of the derivative in the parallel form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DerivativeFilter {
    /// No filter.
    None,
    /// 1/(1 + T s), by backward differences.
    FirstOrder {
        /// T.
        time: f64,
    },
    /// 1/(1 + T s^ν), with a memory of its own.
    Fractional {
        /// T, in units of time^ν.
        time: f64,
        /// ν, 0 < ν < 2.
        order: f64,
    },
}

/// Signal that the derivative of the parallel form acts on. The series form acts on r − y, which is zero in a
/// loop at rest, and counts as zero before the first tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DerivativeOf {
    /// c r − y minus its first value (Caputo): the loop starts at rest, at any y, and its first output has no
    /// derivative.
    ValuesFromRest,
    /// c r − y, which counts as zero before the first tick, as the samples of the integral do: a loop that
    /// starts at y ≠ 0 begins with a kick −K_d h^{−μ} y.
    Values,
    /// −ẏ from a rate sensor, of which K_d D^{μ−1} is taken. The setpoint weight c is 0.
    MeasuredRate,
}

/// Method that keeps the integral from growing while the output is at a limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AntiWindup {
    /// No anti-windup.
    None,
    /// Back-calculation: the part of the output that the limits cut off enters the samples of the integral,
    ///
    /// ```text
    /// v = K_i e + (u − u*)/τ^λ ,        u* the output before limits ,
    /// ```
    ///
    /// so that its memory winds back too. u* depends on v through the leading weight w of I^λ; the equation
    /// is solved within the tick. So is that for the output u₋ of the previous tick where an
    /// [actuator](crate::Actuator::Applied) has applied another value ū: v = K_i e + f with f = (ū − u₋ − w
    /// f)/τ^λ, which is stable for every τ.
    BackCalculation {
        /// τ, the tracking time.
        time: f64,
    },
    /// Conditional integration: beyond the upper limit u_max the integral I(v) is held,
    ///
    /// ```text
    /// I = min( I(K_i e), max( u_max − a, min( I(0), I₋ ) ) ) ,
    /// ```
    ///
    /// a the rest of the output, I(0) the integral without the sample of this tick and I₋ that before it: as
    /// low as brings u* to the limit, but no lower than the smaller of I(0) and I₋. Below the lower limit
    /// likewise, with the signs turned.
    Conditional,
}

/// Value that stays the same on the tick after a change of gains. The integral absorbs the difference;
/// without an integral (K_i = 0 before and after) nothing does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bumpless {
    /// The whole output.
    Whole,
    /// The output without its proportional term, which changes with its gain. Not available in the series
    /// form.
    ExceptProportional,
    /// Nothing: the output changes with the gains. (The integral, kept in units of the output, does not.)
    Nothing,
}

/// Settings of a controller as plain data; [`PidLaw::new`] checks them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PidSettings<T> {
    /// Gains and form.
    pub gains: PidGains<T>,
    /// λ, 0 < λ < 2.
    pub integral_order: f64,
    /// μ, 0 < μ < 2.
    pub derivative_order: f64,
    /// h, the time between ticks; `None` for ticks at any times.
    pub sample: Option<f64>,
    /// b and c of the parallel form. The series form acts on r − y.
    pub setpoint_weights: [T; 2],
    /// Signal that the derivative acts on.
    pub derivative_of: DerivativeOf,
    /// Filter of the derivative.
    pub derivative_filter: DerivativeFilter,
    /// Smallest and largest output; infinite for no limit.
    pub limits: [T; 2],
    /// Largest change of the output per unit of time; infinite for no limit. Before the first tick the output
    /// is 0, or as set by [`manual`](crate::FractionalPid::manual).
    pub rate_limit: T,
    /// Anti-windup for the limits of output and rate.
    pub anti_windup: AntiWindup,
    /// Value that stays the same when gains change.
    pub bumpless: Bumpless,
}

impl<T: Real> PidSettings<T> {
    /// Orders 1, setpoint weights b = 1 and c = 0, a derivative that starts at rest, no filter, no limits, no
    /// anti-windup.
    pub fn new(gains: PidGains<T>, sample: f64) -> Self {
        Self {
            gains,
            integral_order: 1.0,
            derivative_order: 1.0,
            sample: Some(sample),
            setpoint_weights: [T::one(), T::zero()],
            derivative_of: DerivativeOf::ValuesFromRest,
            derivative_filter: DerivativeFilter::None,
            limits: [T::of(f64::NEG_INFINITY), T::of(f64::INFINITY)],
            rate_limit: T::of(f64::INFINITY),
            anti_windup: AntiWindup::None,
            bumpless: Bumpless::Whole,
        }
    }
}

/// The law of a fractional PID controller, checked, with the constants that its ticks need:
///
/// ```text
/// u* = K_p (b r − y) + K_i I^λ (r − y) + K_d D^μ (c r − y)_f + u_ff ,        u = u* within limits ,
/// ```
///
/// or its series form ([`PidGains::Series`]). One law serves any number of
/// [`FractionalPid`](crate::FractionalPid)s, which own it or borrow it. Operators are those of backward
/// differences, s ≈ (1 − z)/h: the output of tick k depends on its own sample e_k, with the leading weights
/// h^λ and h^{−μ}.
///
/// Source: \[Podlubny99\] for PI^λD^μ; \[PV11\] for the series form; \[AstromHagglund06\] for weights, limits
/// and transfer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PidLaw<T> {
    settings: PidSettings<T>,
    pub(crate) constants: PidConstants<T>,
    /// λ ≥ 1: the integral is the sum of I^{λ−1}.
    pub(crate) accumulates: bool,
    /// Seals of the memories of integral, derivative and filter that a host has checked; 0 for none.
    pub(crate) memories: [u32; 3],
}

/// The numbers that ticks need and that follow from the settings of a law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PidConstants<T> {
    /// τ^{−λ}, or 0 without back-calculation.
    pub tracking: T,
    /// T of the filter: for order 1 a time, for order ν in units of time^ν.
    pub filter_time: T,
    /// h/(T + h) of the filter of order 1.
    pub filter_share: T,
    /// h.
    pub step: T,
    /// Largest change of the output in a tick; infinite for no limit.
    pub stride: T,
}

impl<T: Copy> PidLaw<T> {
    /// A law of settings that have been checked.
    pub(crate) const fn of_constants(
        settings: PidSettings<T>,
        constants: PidConstants<T>,
        memories: [u32; 3],
    ) -> Self {
        let accumulates = settings.integral_order >= 1.0;
        Self { settings, constants, accumulates, memories }
    }
}

impl<T: Real> PidLaw<T> {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`ParameterError`] if a number is out of its range, or the settings contradict each other.
    pub fn new(settings: PidSettings<T>) -> Result<Self, ParameterError> {
        let check = ParameterError::check;
        settings.gains.check()?;
        let orders =
            [("integral order", settings.integral_order), ("derivative order", settings.derivative_order)];
        for (name, order) in orders {
            check(order > 0.0 && order < 2.0, name, order, "greater than 0 and less than 2")?;
        }
        if let Some(sample) = settings.sample {
            check_step_size(sample)?;
            let step = T::of(sample);
            let allowed = "one that the precision holds with all digits";
            check(step >= T::SMALLEST_NORMAL && step.is_finite(), "step size", sample, allowed)?;
        }
        for weight in settings.setpoint_weights {
            check(weight.is_finite(), "setpoint weight", weight.to_f64(), "a finite number")?;
        }
        let [lower, upper] = settings.limits;
        check(lower <= upper, "lower limit", lower.to_f64(), "a number no larger than the upper limit")?;
        let unreachable = lower == upper && !lower.is_finite();
        check(!unreachable, "limits", lower.to_f64(), "not one and the same infinity")?;
        let rate = settings.rate_limit;
        check(rate > T::zero(), "rate limit", rate.to_f64(), "positive, or infinite for none")?;
        let stride = settings.sample.map(|sample| rate * T::of(sample));
        let moves = stride.is_none_or(|stride| stride > T::zero());
        check(moves, "rate limit", rate.to_f64(), "large enough for a change in a sample time")?;
        let tracking = match settings.anti_windup {
            AntiWindup::BackCalculation { time } => {
                let tracking = T::of(libm::pow(time, -settings.integral_order));
                let positive = time > 0.0 && tracking > T::zero() && tracking.is_finite();
                check(positive, "tracking time", time, "positive and finite")?;
                // The leading weight over τ^λ, by which limits are divided.
                if let Some(sample) = settings.sample {
                    let ratio = T::of(libm::pow(sample / time, settings.integral_order));
                    let allowed = "not so much shorter than a sample time";
                    check(ratio.is_finite(), "tracking time", time, allowed)?;
                }
                tracking
            }
            AntiWindup::None | AntiWindup::Conditional => T::zero(),
        };
        let filter_time = match settings.derivative_filter {
            DerivativeFilter::None => 0.0,
            DerivativeFilter::FirstOrder { time } => time,
            DerivativeFilter::Fractional { time, order } => {
                let allowed = "greater than 0 and less than 2";
                check(order > 0.0 && order < 2.0, "order of the derivative's filter", order, allowed)?;
                time
            }
        };
        let positive = filter_time >= 0.0 && T::of(filter_time).is_finite();
        check(positive, "time of the derivative's filter", filter_time, "at least 0 and finite")?;
        if settings.derivative_of == DerivativeOf::MeasuredRate {
            let weight = settings.setpoint_weights[1];
            let allowed = "0 where the derivative is of a measured rate";
            check(weight == T::zero(), "setpoint weight of the derivative", weight.to_f64(), allowed)?;
        }
        if let PidGains::Series { .. } = settings.gains {
            let plain = settings.derivative_filter == DerivativeFilter::None;
            let allowed = "none in the series form, which has its own";
            check(plain, "time of the derivative's filter", filter_time, allowed)?;
            let values = settings.derivative_of != DerivativeOf::MeasuredRate;
            let allowed = "of the values r - y in the series form";
            check(values, "derivative", f64::NAN, allowed)?;
        }
        let share = |sample: f64| T::of(sample / (filter_time + sample));
        let constants = PidConstants {
            tracking,
            filter_time: T::of(filter_time),
            filter_share: settings.sample.map_or(T::zero(), share),
            step: T::of(settings.sample.unwrap_or(f64::NAN)),
            stride: stride.unwrap_or(T::of(f64::NAN)),
        };
        Ok(Self::of_constants(settings, constants, [0; 3]))
    }

    /// The numbers that follow from the settings.
    pub fn constants(&self) -> &PidConstants<T> {
        &self.constants
    }

    /// The settings that the law was built from.
    pub fn settings(&self) -> &PidSettings<T> {
        &self.settings
    }

    /// The same law with other gains.
    ///
    /// # Errors
    /// As [`new`](PidLaw::new), and if the gains are those of the other form.
    pub fn with_gains(&self, gains: PidGains<T>) -> Result<Self, ParameterError> {
        gains.check()?;
        let allowed = "of the form of the law, parallel or series";
        ParameterError::check(gains.same_form(&self.settings.gains), "gains", f64::NAN, allowed)?;
        Ok(Self { settings: PidSettings { gains, ..self.settings }, ..*self })
    }

    /// The kernel of the memory of the integral: D^{−λ} for λ < 1, and D^{1−λ}, whose values are summed, for
    /// λ ≥ 1. For λ = 1 that is the identity ([`Memoryless`](crate::Memoryless)).
    ///
    /// # Errors
    /// If the sample time is so short that weights overflow.
    pub fn integral_kernel(&self) -> Result<Kernel, ParameterError> {
        self.kernel(if self.accumulates { 1.0 } else { 0.0 } - self.settings.integral_order)
    }

    /// The kernel of the memory of the derivative: D^μ, or D^{μ−1} of a measured rate.
    ///
    /// # Errors
    /// As [`integral_kernel`](PidLaw::integral_kernel).
    pub fn derivative_kernel(&self) -> Result<Kernel, ParameterError> {
        let measured = self.settings.derivative_of == DerivativeOf::MeasuredRate;
        self.kernel(self.settings.derivative_order - if measured { 1.0 } else { 0.0 })
    }

    /// The kernel of the memory of a fractional filter; `None` where there is no such filter.
    ///
    /// # Errors
    /// As [`integral_kernel`](PidLaw::integral_kernel).
    pub fn filter_kernel(&self) -> Result<Option<Kernel>, ParameterError> {
        match self.settings.derivative_filter {
            DerivativeFilter::Fractional { order, .. } => self.kernel(order).map(Some),
            DerivativeFilter::None | DerivativeFilter::FirstOrder { .. } => Ok(None),
        }
    }

    fn kernel(&self, exponent: f64) -> Result<Kernel, ParameterError> {
        match self.settings.sample {
            Some(sample) => Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, exponent, sample),
            None => Kernel::any_step(&RungeKutta::<1>::radau_iia()?, exponent),
        }
    }

    /// Part of the signal that the derivative's operator subtracts.
    pub(crate) fn start(&self) -> FromZeroOrRest {
        match (self.settings.derivative_of, self.settings.gains) {
            (DerivativeOf::ValuesFromRest, PidGains::Parallel { .. }) => FromZeroOrRest::Rest,
            _ => FromZeroOrRest::Zero,
        }
    }

    /// Checks that a controller can change from the law `other` to this one: they need the same operators.
    pub(crate) fn follows(&self, other: &Self) -> Result<(), ParameterError> {
        let (new, old) = (&self.settings, &other.settings);
        let same = new.integral_order == old.integral_order
            && new.derivative_order == old.derivative_order
            && new.sample == old.sample
            && new.derivative_of == old.derivative_of
            && self.filter_order() == other.filter_order()
            && new.gains.same_form(&old.gains);
        let allowed = "of the same form, orders, sample time and kind of derivative";
        ParameterError::check(same, "law", f64::NAN, allowed)
    }

    fn filter_order(&self) -> Option<f64> {
        match self.settings.derivative_filter {
            DerivativeFilter::Fractional { order, .. } => Some(order),
            DerivativeFilter::None | DerivativeFilter::FirstOrder { .. } => None,
        }
    }

    /// Frequency response of the discrete law without limits to r = e^{iωt} and y = e^{iωt}, u = C_r r − C_y
    /// y, at ω in radians per unit of time. It includes the discretisation: both are C(iω) to first order in
    /// ωh. `None` for ticks at any times, and outside 0 < ω ≤ π/h.
    ///
    /// For a derivative of a measured rate that rate is iω y.
    pub fn response(&self, omega: f64) -> Option<PidResponse> {
        let settings = &self.settings;
        let sample = settings.sample?;
        let angle = omega * sample;
        if !(angle > 0.0 && angle <= core::f64::consts::PI) {
            return None;
        }
        // (1 − e^{−iωh})/h = 2 sin(ωh/2)/h · e^{i(π − ωh)/2}
        let modulus = 2.0 * libm::sin(0.5 * angle) / sample;
        let argument = 0.5 * (core::f64::consts::PI - angle);
        let power = |exponent: f64| {
            let (size, turn) = (libm::pow(modulus, exponent), exponent * argument);
            Complex::new(size * libm::cos(turn), size * libm::sin(turn))
        };
        let one = Complex::new(1.0, 0.0);
        let integral = power(-settings.integral_order);
        match settings.gains {
            PidGains::Parallel { proportional, integral: integral_gain, derivative } => {
                let order = settings.derivative_order;
                let derived = match settings.derivative_of {
                    DerivativeOf::MeasuredRate => power(order - 1.0) * Complex::new(0.0, omega),
                    DerivativeOf::Values | DerivativeOf::ValuesFromRest => power(order),
                };
                let filter = match settings.derivative_filter {
                    DerivativeFilter::None => one,
                    DerivativeFilter::FirstOrder { time } => one + power(1.0).scale(time),
                    DerivativeFilter::Fractional { time, order } => one + power(order).scale(time),
                };
                let derivative = quotient(derived.scale(derivative.to_f64()), filter);
                let integral = integral.scale(integral_gain.to_f64());
                let [b, c] = settings.setpoint_weights.map(|weight| weight.to_f64());
                let proportional = proportional.to_f64();
                Some(PidResponse {
                    setpoint: integral + derivative.scale(c) + one.scale(proportional * b),
                    measured: integral + derivative + one.scale(proportional),
                })
            }
            PidGains::Series { proportional, integral_rate, derivative_time, filter_ratio } => {
                let derived = power(settings.derivative_order).scale(derivative_time.to_f64());
                let filter = one + derived.scale(1.0 / filter_ratio.to_f64());
                let lead = quotient(one + derived, filter);
                let whole = (one + integral.scale(integral_rate.to_f64())) * lead;
                let whole = whole.scale(proportional.to_f64());
                Some(PidResponse { setpoint: whole, measured: whole })
            }
        }
    }
}

/// a/b
fn quotient(a: Complex<f64>, b: Complex<f64>) -> Complex<f64> {
    let size = b.re * b.re + b.im * b.im;
    let product = a * b.conj();
    Complex::new(product.re / size, product.im / size)
}

/// Frequency responses of a discrete law at one frequency: u = C_r r − C_y y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PidResponse {
    /// C_r.
    pub setpoint: Complex<f64>,
    /// C_y.
    pub measured: Complex<f64>,
}
