//! A fractional PID controller.

use core::ffi::{CStr, c_char};

use fvi_core::{
    Actuator, AntiWindup, Bumpless, DerivativeFilter, DerivativeOf, FractionalPid, Memoryless,
    ParameterError, PidError, PidGains, PidInputs, PidLaw, PidSettings,
};

use crate::memory::{AnyMemory, FviMemory};
use crate::pointer::{check, reference};
use crate::saving::{ByteBuffer, give};
use crate::status::{FviStatus, status};
use crate::stored::{Storable, keep, kept, words};

/// Form: u = kp (b r - y) + ki I^lambda (r - y) + kd D^mu (c r - y), filtered.
pub const FVI_PID_PARALLEL: u32 = 0;
/// Form: C(s) = kp (1 + ki/s^lambda) (1 + kd s^mu) / (1 + (kd/filter_ratio) s^mu) on r - y: ki is 1/T_i, kd
/// is T_d.
pub const FVI_PID_SERIES: u32 = 1;

/// The derivative is that of c r - y minus its first value: a loop at rest starts without a kick.
pub const FVI_PID_FROM_REST: u32 = 0;
/// The derivative is that of c r - y, taken as zero before the first tick.
pub const FVI_PID_OF_VALUES: u32 = 1;
/// The derivative is D^(mu - 1) of a measured rate of y; c is 0.
pub const FVI_PID_OF_RATE: u32 = 2;

/// No anti-windup.
pub const FVI_PID_NO_ANTI_WINDUP: u32 = 0;
/// Back-calculation with a tracking time.
pub const FVI_PID_BACK_CALCULATION: u32 = 1;
/// Conditional integration.
pub const FVI_PID_CONDITIONAL: u32 = 2;

/// A change of gains does not change the output at its first tick.
pub const FVI_PID_BUMPLESS: u32 = 0;
/// A change of gains changes the output at its first tick by the proportional term only.
pub const FVI_PID_EXCEPT_PROPORTIONAL: u32 = 1;
/// A change of gains changes the output freely.
pub const FVI_PID_BUMPS: u32 = 2;

/// The actuator applied the last output.
pub const FVI_PID_FOLLOWED: u32 = 0;
/// The actuator applied the value `applied`.
pub const FVI_PID_APPLIED: u32 = 1;
/// The actuator is at a limit unknown to the controller: the integral can only decrease in magnitude.
pub const FVI_PID_LIMITED: u32 = 2;

/// A control law. Members that are zero mean: no limits, no filter, default orders; the setpoint weights are
/// used as given.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FviPidSettings {
    /// Time between ticks.
    pub sample: f64,
    /// Order of the integral, above 0 and below 2; 0 stands for 1.
    pub lambda: f64,
    /// Order of the derivative, above 0 and below 2; 0 stands for 1.
    pub mu: f64,
    /// Time of the derivative's filter in the parallel form; 0 for none.
    pub filter_time: f64,
    /// Order of that filter; 0 stands for 1, other orders need a memory.
    pub filter_order: f64,
    /// Back-calculation: the tracking time.
    pub tracking_time: f64,
    /// Gains; in the series form kp, 1/T_i and T_d.
    pub kp: f32,
    /// See kp.
    pub ki: f32,
    /// See kp.
    pub kd: f32,
    /// Series form: the filter ratio N.
    pub filter_ratio: f32,
    /// b and c of the parallel form.
    pub setpoint_weights: [f32; 2],
    /// The smallest and the largest output; two zeros for no limits. Infinities are allowed.
    pub limits: [f32; 2],
    /// Largest rate of change of the output per unit of time; 0 for no limit.
    pub rate_limit: f32,
    /// FVI_PID_PARALLEL or FVI_PID_SERIES.
    pub form: u32,
    /// FVI_PID_FROM_REST, FVI_PID_OF_VALUES or FVI_PID_OF_RATE.
    pub derivative_of: u32,
    /// FVI_PID_NO_ANTI_WINDUP, FVI_PID_BACK_CALCULATION or FVI_PID_CONDITIONAL.
    pub anti_windup: u32,
    /// FVI_PID_BUMPLESS, FVI_PID_EXCEPT_PROPORTIONAL or FVI_PID_BUMPS.
    pub bumpless: u32,
}

/// Inputs of a tick.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FviPidInputs {
    /// r.
    pub setpoint: f32,
    /// y.
    pub measured: f32,
    /// The rate of y, for FVI_PID_OF_RATE.
    pub rate: f32,
    /// Added to the output, inside its limits.
    pub feed_forward: f32,
    /// FVI_PID_FOLLOWED, FVI_PID_APPLIED or FVI_PID_LIMITED.
    pub actuator: u32,
    /// Output of the previous tick as the actuator applied it.
    pub applied: f32,
}

/// Number of 64-bit words of a controller.
pub const FVI_PID_WORDS: usize = 96;

/// A fractional PID controller.
///
/// Set all words to zero before the first call.
#[repr(C)]
#[derive(Debug)]
pub struct FviPid {
    /// Internal state; not to be accessed by the caller.
    pub words: [u64; FVI_PID_WORDS],
}

type Pid = FractionalPid<f32, AnyMemory<1>, AnyMemory<1>, PidLaw<f32>, AnyMemory<1>>;

impl Storable for Pid {
    const TAG: u64 = 0x6676_692d_6670_6964;
}

const _: () = assert!(words::<Pid>() <= FVI_PID_WORDS);

impl From<PidError> for FviStatus {
    fn from(error: PidError) -> Self {
        match error {
            PidError::Operator(error) => error.into(),
            PidError::Interval => Self::OutOfRange,
            _ => Self::NotFinite,
        }
    }
}

/// A member of the settings that is refused.
struct Refused {
    status: FviStatus,
    member: &'static CStr,
}

impl Refused {
    /// An unknown constant.
    fn constant(member: &'static CStr) -> Self {
        Self { status: FviStatus::OutOfRange, member }
    }
}

impl From<ParameterError> for Refused {
    fn from(error: ParameterError) -> Self {
        let member = match error.parameter {
            "proportional gain" => c"kp",
            "integral gain" | "integral rate" => c"ki",
            "derivative gain" | "derivative time" => c"kd",
            "filter ratio" => c"filter_ratio",
            "integral order" => c"lambda",
            "derivative order" => c"mu",
            "setpoint weight" | "setpoint weight of the derivative" => c"setpoint_weights",
            "lower limit" | "limits" => c"limits",
            "rate limit" => c"rate_limit",
            "tracking time" => c"tracking_time",
            "time of the derivative's filter" => c"filter_time",
            "order of the derivative's filter" => c"filter_order",
            "derivative" => c"derivative_of",
            _ => c"sample",
        };
        Self { status: error.into(), member }
    }
}

impl From<Refused> for FviStatus {
    fn from(refused: Refused) -> Self {
        refused.status
    }
}

/// Gains of a form.
fn gains(form: u32, [kp, ki, kd, ratio]: [f32; 4]) -> Result<PidGains<f32>, Refused> {
    match form {
        FVI_PID_PARALLEL => Ok(PidGains::Parallel { proportional: kp, integral: ki, derivative: kd }),
        FVI_PID_SERIES => Ok(PidGains::Series {
            proportional: kp,
            integral_rate: ki,
            derivative_time: kd,
            filter_ratio: ratio,
        }),
        _ => Err(Refused::constant(c"form")),
    }
}

/// An order, of which 0 stands for 1.
fn or_one(order: f64) -> f64 {
    if order == 0.0 { 1.0 } else { order }
}

fn law(settings: &FviPidSettings) -> Result<PidLaw<f32>, Refused> {
    let FviPidSettings { kp, ki, kd, filter_ratio, limits, rate_limit, .. } = *settings;
    let derivative_filter = match (settings.filter_time, or_one(settings.filter_order)) {
        (0.0, _) => DerivativeFilter::None,
        (time, 1.0) => DerivativeFilter::FirstOrder { time },
        (time, order) => DerivativeFilter::Fractional { time, order },
    };
    Ok(PidLaw::new(PidSettings {
        gains: gains(settings.form, [kp, ki, kd, filter_ratio])?,
        integral_order: or_one(settings.lambda),
        derivative_order: or_one(settings.mu),
        sample: Some(settings.sample),
        setpoint_weights: settings.setpoint_weights,
        derivative_of: match settings.derivative_of {
            FVI_PID_OF_VALUES => DerivativeOf::Values,
            FVI_PID_FROM_REST => DerivativeOf::ValuesFromRest,
            FVI_PID_OF_RATE => DerivativeOf::MeasuredRate,
            _ => return Err(Refused::constant(c"derivative_of")),
        },
        derivative_filter,
        limits: if limits == [0.0; 2] { [f32::NEG_INFINITY, f32::INFINITY] } else { limits },
        rate_limit: if rate_limit == 0.0 { f32::INFINITY } else { rate_limit },
        anti_windup: match settings.anti_windup {
            FVI_PID_NO_ANTI_WINDUP => AntiWindup::None,
            FVI_PID_BACK_CALCULATION => AntiWindup::BackCalculation { time: settings.tracking_time },
            FVI_PID_CONDITIONAL => AntiWindup::Conditional,
            _ => return Err(Refused::constant(c"anti_windup")),
        },
        bumpless: match settings.bumpless {
            FVI_PID_BUMPLESS => Bumpless::Whole,
            FVI_PID_EXCEPT_PROPORTIONAL => Bumpless::ExceptProportional,
            FVI_PID_BUMPS => Bumpless::Nothing,
            _ => return Err(Refused::constant(c"bumpless")),
        },
    })?)
}

/// The name of the first member of the settings that fvi_pid_init and fvi_pid_set would refuse, such as
/// "lambda"; NULL if they are all right, and "settings" if the pointer is NULL or misaligned. Memories are
/// not looked at.
///
/// # Safety
/// `settings` must be readable, or NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_pid_refused(settings: *const FviPidSettings) -> *const c_char {
    // SAFETY: readable as promised.
    match unsafe { reference(settings) }.map(law) {
        Ok(Ok(_)) => core::ptr::null(),
        Ok(Err(refused)) => refused.member.as_ptr(),
        Err(_) => c"settings".as_ptr(),
    }
}

/// Sets up a controller on empty memories.
///
/// The kernel of the integral's memory is D^-lambda for lambda < 1, else D^(1 - lambda). For lambda = 1 that
/// is the identity, a ring with the single weight 1, or NULL: a P or PD controller is one with lambda = 1, ki
/// = 0 and no memory of an integral. That of the derivative's memory is D^mu, or D^(mu - 1) for a rate; NULL
/// without a derivative. That of the filter's memory is D^filter_order; NULL where the order is 1 or there is
/// no filter. The memories are compared with these kernels. fvi_pid_refused names the member of the settings
/// that is wrong. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE,
/// FVI_STATUS_OUT_OF_RANGE or FVI_STATUS_WRONG_SIZE if something is wrong with a pointer, a number or a size.
///
/// # Safety
/// `controller` must be writable, `settings` readable, the memories as their type describes or NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_pid_init(
    controller: *mut FviPid,
    settings: *const FviPidSettings,
    integral: *const FviMemory,
    derivative: *const FviMemory,
    filter: *const FviMemory,
) -> FviStatus {
    /// # Safety
    /// As described for [`FviMemory`], or NULL.
    unsafe fn memory(memory: *const FviMemory) -> Result<Option<AnyMemory<1>>, FviStatus> {
        if memory.is_null() {
            return Ok(None);
        }
        // SAFETY: promised by the caller.
        unsafe { AnyMemory::<1>::new(reference(memory)?) }.map(Some)
    }
    status((|| {
        check(controller)?;
        // SAFETY: readable as promised.
        let law = law(unsafe { reference(settings) }?)?;
        // SAFETY: promised by the caller.
        let (integral, derivative, filter) =
            unsafe { (memory(integral)?, memory(derivative)?, memory(filter)?) };
        let integral = match integral {
            None if law.settings().integral_order == 1.0 => AnyMemory::Identity(Memoryless::new()),
            given => given.ok_or(FviStatus::Null)?,
        };
        let pid = Pid::with_parts(law, integral, derivative, filter)?;
        // SAFETY: the words are as many as the assertion above demands.
        unsafe { keep(controller.cast(), pid) }
    })())
}

/// Makes a tick with setpoint r and measured value y, and writes the output.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE or
/// FVI_STATUS_MEMORY_FULL; then neither controller nor `output` has changed.
///
/// # Safety
/// `controller` must be zeroed or set up, `output` writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_pid_tick(
    controller: *mut FviPid,
    setpoint: f32,
    measured: f32,
    output: *mut f32,
) -> FviStatus {
    status((|| {
        check(output)?;
        check(controller)?;
        // SAFETY: zeroed or set up, as promised.
        let value = unsafe { kept::<Pid>(controller.cast()) }?.tick(setpoint, measured)?;
        // SAFETY: not NULL and aligned; writable as promised.
        unsafe { output.write(value) };
        Ok(())
    })())
}

/// Makes a tick with all inputs, and writes the output.
///
/// Returns what fvi_pid_tick does, and FVI_STATUS_OUT_OF_RANGE for an unknown value of `actuator`.
///
/// # Safety
/// As for fvi_pid_tick; `inputs` must be readable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_pid_tick_with(
    controller: *mut FviPid,
    inputs: *const FviPidInputs,
    output: *mut f32,
) -> FviStatus {
    status((|| {
        check(output)?;
        check(controller)?;
        // SAFETY: readable as promised.
        let &FviPidInputs { setpoint, measured, rate, feed_forward, actuator, applied } =
            unsafe { reference(inputs) }?;
        let actuator = match actuator {
            FVI_PID_FOLLOWED => Actuator::Followed,
            FVI_PID_APPLIED => Actuator::Applied(applied),
            FVI_PID_LIMITED => Actuator::Limited,
            _ => return Err(FviStatus::OutOfRange),
        };
        let inputs = PidInputs { setpoint, measured, rate, feed_forward, actuator };
        // SAFETY: zeroed or set up, as promised.
        let value = unsafe { kept::<Pid>(controller.cast()) }?.tick_with(&inputs)?;
        // SAFETY: not NULL and aligned; writable as promised.
        unsafe { output.write(value) };
        Ok(())
    })())
}

/// Sets the output by hand, from the next tick on, within limits and rate limit; the memory of the integral
/// is cleared. Before the first tick no rate holds it up: for a bumpless start, from where the actuator
/// stands, fvi_pid_automatic may follow at once.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED or FVI_STATUS_NOT_FINITE.
///
/// # Safety
/// `controller` must be zeroed or set up.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_pid_manual(controller: *mut FviPid, output: f32) -> FviStatus {
    status((|| {
        check(controller)?;
        // SAFETY: zeroed or set up, as promised.
        Ok(unsafe { kept::<Pid>(controller.cast()) }?.manual(output)?)
    })())
}

/// Returns the output to automatic control, without a jump: the output of the next tick equals that of the
/// previous one.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.
///
/// # Safety
/// `controller` must be zeroed or set up.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_pid_automatic(controller: *mut FviPid) -> FviStatus {
    status((|| {
        check(controller)?;
        // SAFETY: zeroed or set up, as promised.
        unsafe { kept::<Pid>(controller.cast()) }?.automatic();
        Ok(())
    })())
}

/// Changes the gains, from the next tick on; `bumpless` of the settings selects how the output may change.
/// They are those of FviPidSettings: in the series form kp, 1/T_i and T_d.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE, or
/// FVI_STATUS_OUT_OF_RANGE if a gain is not allowed, or a derivative lacks its memory.
///
/// # Safety
/// `controller` must be zeroed or set up.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_pid_set_gains(controller: *mut FviPid, kp: f32, ki: f32, kd: f32) -> FviStatus {
    status((|| {
        check(controller)?;
        // SAFETY: zeroed or set up, as promised.
        let pid = unsafe { kept::<Pid>(controller.cast()) }?;
        let (form, ratio) = match pid.law().settings().gains {
            PidGains::Parallel { .. } => (FVI_PID_PARALLEL, 0.0),
            PidGains::Series { filter_ratio, .. } => (FVI_PID_SERIES, filter_ratio),
        };
        Ok(pid.set_gains(gains(form, [kp, ki, kd, ratio])?)?)
    })())
}

/// Changes the settings, from the next tick on: gains, setpoint weights, limits, rate limit, anti-windup with
/// its tracking time, filter time, and `bumpless`, which selects how the output may change where gains do.
/// Form, orders, sample time and kind of derivative are those of the set-up.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE, or
/// FVI_STATUS_OUT_OF_RANGE if a member is not allowed (fvi_pid_refused names it), needs other memories, or
/// differs that may not.
///
/// # Safety
/// `controller` must be zeroed or set up, `settings` readable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_pid_set(controller: *mut FviPid, settings: *const FviPidSettings) -> FviStatus {
    status((|| {
        check(controller)?;
        // SAFETY: readable as promised.
        let law = law(unsafe { reference(settings) }?)?;
        // SAFETY: zeroed or set up, as promised.
        let pid = unsafe { kept::<Pid>(controller.cast()) }?;
        // The law is one by itself, but not one for these memories.
        pid.set_law(law).map_err(|_| FviStatus::OutOfRange)
    })())
}

/// Writes the output of the last tick, 0 before the first, and the integral term in it, ki I^lambda of the
/// samples as limits and transfers have changed them. A pointer that is NULL receives nothing.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.
///
/// # Safety
/// `controller` must be zeroed or set up, `output` and `integral` writable or NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_pid_state(
    controller: *const FviPid,
    output: *mut f32,
    integral: *mut f32,
) -> FviStatus {
    status((|| {
        check(controller)?;
        for place in [output, integral] {
            if !place.is_null() {
                check(place)?;
            }
        }
        // SAFETY: zeroed or set up, as promised.
        let pid = unsafe { kept::<Pid>(controller.cast_mut().cast()) }?;
        for (place, value) in [(output, pid.output()), (integral, pid.integral())] {
            if !place.is_null() {
                // SAFETY: aligned; writable as promised.
                unsafe { place.write(value) };
            }
        }
        Ok(())
    })())
}

/// Restores the state after set-up, with empty memories and in automatic mode; the gains are kept.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.
///
/// # Safety
/// `controller` must be zeroed or set up.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_pid_reset(controller: *mut FviPid) -> FviStatus {
    status((|| {
        check(controller)?;
        // SAFETY: zeroed or set up, as promised.
        unsafe { kept::<Pid>(controller.cast()) }?.reset();
        Ok(())
    })())
}

/// Saves the state of a controller with its memories, as fvi_operator_save does for an operator. The law is
/// not part of it.
///
/// # Safety
/// `controller` must be zeroed or set up, `capacity` bytes and `written` writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_pid_save(
    controller: *const FviPid,
    bytes: *mut u8,
    capacity: usize,
    written: *mut usize,
) -> FviStatus {
    status((|| {
        check(controller)?;
        // SAFETY: zeroed or set up, as promised.
        let pid = unsafe { kept::<Pid>(controller.cast_mut().cast()) }?;
        let place = ByteBuffer { bytes, capacity, written };
        // SAFETY: promised by the caller.
        unsafe { place.take(pid) }
    })())
}

/// Restores what fvi_pid_save wrote, into a controller set up in the same way, as fvi_operator_restore does
/// for an operator.
///
/// # Safety
/// `controller` must be zeroed or set up, `count` bytes readable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_pid_restore(
    controller: *mut FviPid,
    bytes: *const u8,
    count: usize,
) -> FviStatus {
    status((|| {
        check(controller)?;
        // SAFETY: zeroed or set up, as promised.
        let pid = unsafe { kept::<Pid>(controller.cast()) }?;
        // SAFETY: promised by the caller.
        unsafe { give(bytes, count, pid) }
    })())
}
