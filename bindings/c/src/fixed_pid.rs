//! A fractional PID controller in whole numbers.

use fvi_core::{FixedGain, FixedLaw, FixedOperator, FixedPid, FixedTerm, FixedWindup};

use crate::pid::{
    FVI_PID_BACK_CALCULATION, FVI_PID_CONDITIONAL, FVI_PID_FROM_REST, FVI_PID_NO_ANTI_WINDUP,
    FVI_PID_OF_VALUES,
};
use crate::pointer::{check, reference, slice, slice_mut};
use crate::status::{FviStatus, status};
use crate::stored::{Storable, keep, kept, words};

/// A factor mantissa 2^-shift.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FviFixedGain {
    /// Mantissa.
    pub mantissa: i32,
    /// Shift.
    pub shift: i32,
}

/// A decaying exponential of an operator.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FviFixedTerm {
    /// What it loses in a tick; zero for a sum that stays.
    pub decay: FviFixedGain,
    /// From its value to the output.
    pub output: FviFixedGain,
    /// Binary digits of its value behind those of a sample.
    pub lift: i32,
}

/// The law of a controller in whole numbers, with all factors between counts of the inputs and units of 2^-16
/// counts of the output. `fvi controller --arithmetic fixed --format c` makes it.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FviFixedLaw {
    /// First weights of the integral; NULL with a count of 0 for none.
    pub integral_head: *const FviFixedGain,
    /// Its exponentials.
    pub integral_terms: *const FviFixedTerm,
    /// First weights of the derivative.
    pub derivative_head: *const FviFixedGain,
    /// Its exponentials.
    pub derivative_terms: *const FviFixedTerm,
    /// Smallest and largest output, in units of 2^-16 counts.
    pub limits: [i64; 2],
    /// Largest change of the output in a tick, in units of 2^-16 counts.
    pub stride: i64,
    /// Number of weights.
    pub integral_head_count: u32,
    /// Number of exponentials.
    pub integral_terms_count: u32,
    /// Number of weights.
    pub derivative_head_count: u32,
    /// Number of exponentials.
    pub derivative_terms_count: u32,
    /// Gain of the setpoint.
    pub setpoint: FviFixedGain,
    /// Gain of the measured value.
    pub measured: FviFixedGain,
    /// Weight of the setpoint in the derivative, 2^5 times.
    pub derivative_weight: FviFixedGain,
    /// Share of a new sample in the derivative's filter; 1 for no filter.
    pub filter_share: FviFixedGain,
    /// Factor of the anti-windup, from the output to a sample of the integral.
    pub windup: FviFixedGain,
    /// FVI_PID_FROM_REST or FVI_PID_OF_VALUES.
    pub derivative_of: u32,
    /// FVI_PID_NO_ANTI_WINDUP, FVI_PID_BACK_CALCULATION or FVI_PID_CONDITIONAL.
    pub anti_windup: u32,
}

const _: () = assert!(size_of::<FviFixedGain>() == size_of::<FixedGain>());
const _: () = assert!(size_of::<FviFixedTerm>() == size_of::<FixedTerm>());

/// Number of 64-bit words of a controller in whole numbers.
pub const FVI_FIXED_PID_WORDS: usize = 36;

/// A fractional PID controller in whole numbers.
///
/// Set all words to zero before the first call.
#[repr(C)]
#[derive(Debug)]
pub struct FviFixedPid {
    /// Internal state; not to be accessed by the caller.
    pub words: [u64; FVI_FIXED_PID_WORDS],
}

type Pid = FixedPid<FixedLaw<'static>, &'static mut [i64]>;

impl Storable for Pid {
    const TAG: u64 = 0x6676_692d_6678_7064;
}

const _: () = assert!(words::<Pid>() <= FVI_FIXED_PID_WORDS);

impl From<FviFixedGain> for FixedGain {
    fn from(gain: FviFixedGain) -> Self {
        Self { mantissa: gain.mantissa, shift: gain.shift }
    }
}

/// The law behind the pointer.
///
/// # Safety
/// As for fvi_fixed_pid_init.
unsafe fn law(law: *const FviFixedLaw) -> Result<FixedLaw<'static>, FviStatus> {
    /// # Safety
    /// Numbers must lie there that nobody changes as long as the controller is used.
    unsafe fn operator(
        head: (*const FviFixedGain, u32),
        terms: (*const FviFixedTerm, u32),
    ) -> Result<FixedOperator<'static>, FviStatus> {
        if terms.1 > 0 && head.1 < 2 {
            return Err(FviStatus::WrongSize);
        }
        // SAFETY: both types have the members of those of fvi-core in their order, `repr(C)`; readable as
        // promised.
        unsafe {
            Ok(FixedOperator {
                head: slice(head.0.cast::<FixedGain>(), head.1 as usize)?,
                terms: slice(terms.0.cast::<FixedTerm>(), terms.1 as usize)?,
            })
        }
    }
    // SAFETY: readable as promised.
    let given = unsafe { reference(law) }?;
    // SAFETY: as promised.
    let [integral, derivative] = unsafe {
        [
            operator(
                (given.integral_head, given.integral_head_count),
                (given.integral_terms, given.integral_terms_count),
            )?,
            operator(
                (given.derivative_head, given.derivative_head_count),
                (given.derivative_terms, given.derivative_terms_count),
            )?,
        ]
    };
    Ok(FixedLaw {
        setpoint: given.setpoint.into(),
        measured: given.measured.into(),
        integral,
        derivative,
        derivative_weight: given.derivative_weight.into(),
        from_rest: match given.derivative_of {
            FVI_PID_FROM_REST => true,
            FVI_PID_OF_VALUES => false,
            _ => return Err(FviStatus::OutOfRange),
        },
        filter_share: given.filter_share.into(),
        limits: given.limits,
        stride: given.stride,
        anti_windup: match given.anti_windup {
            FVI_PID_NO_ANTI_WINDUP => FixedWindup::None,
            FVI_PID_BACK_CALCULATION => FixedWindup::BackCalculation(given.windup.into()),
            FVI_PID_CONDITIONAL => FixedWindup::Conditional(given.windup.into()),
            _ => return Err(FviStatus::OutOfRange),
        },
    })
}

/// Sets up a controller in whole numbers, with `state_count` numbers of state, which it clears. The law is
/// copied; its arrays and the state are used as long as the controller is.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_OUT_OF_RANGE or FVI_STATUS_WRONG_SIZE if
/// something is wrong with a pointer, a constant or the size.
///
/// # Safety
/// `controller` must be writable, `law` and the arrays that it names readable, `state_count` initialised
/// numbers must lie at `state` that nobody else uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_fixed_pid_init(
    controller: *mut FviFixedPid,
    law: *const FviFixedLaw,
    state: *mut i64,
    state_count: usize,
) -> FviStatus {
    status((|| {
        check(controller)?;
        // SAFETY: promised by the caller.
        let law = unsafe { self::law(law) }?;
        // SAFETY: promised by the caller.
        let state = unsafe { slice_mut(state, state_count) }?;
        let pid = Pid::new(law, state).map_err(|_| FviStatus::WrongSize)?;
        // SAFETY: the words are as many as the assertion above demands.
        unsafe { keep(controller.cast(), pid) }
    })())
}

/// Makes a tick with setpoint r and measured value y, in counts, and writes the output, in counts of its own.
///
/// Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.
///
/// # Safety
/// `controller` must be zeroed or set up, `output` writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_fixed_pid_tick(
    controller: *mut FviFixedPid,
    setpoint: i32,
    measured: i32,
    output: *mut i32,
) -> FviStatus {
    status((|| {
        check(output)?;
        check(controller)?;
        // SAFETY: zeroed or set up, as promised.
        let value = unsafe { kept::<Pid>(controller.cast()) }?.tick(setpoint, measured);
        // SAFETY: not NULL and aligned; writable as promised.
        unsafe { output.write(value) };
        Ok(())
    })())
}

/// Returns to the state before the first tick. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or
/// FVI_STATUS_NOT_INITIALISED.
///
/// # Safety
/// `controller` must be zeroed or set up.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_fixed_pid_reset(controller: *mut FviFixedPid) -> FviStatus {
    status((|| {
        check(controller)?;
        // SAFETY: zeroed or set up, as promised.
        unsafe { kept::<Pid>(controller.cast()) }?.reset();
        Ok(())
    })())
}
