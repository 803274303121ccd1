//! Convolvers in double precision.

use fvi_fft::Preparer;

use crate::convolver::{self, Begins, Machine, Prepared, Response};
use crate::status::FviStreamStatus;
use crate::stream::{FviConvolverFacts, FviStream};

/// A finite response; with no samples it stands for no response, which costs nothing.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FviResponseF64 {
    /// Its samples w(0), w(1), …; they are copied.
    pub samples: *const f64,
    /// Their number, at most 268435456.
    pub count: usize,
}

impl Response<f64> for FviResponseF64 {
    fn parts(&self) -> (*const f64, usize) {
        (self.samples, self.count)
    }
}

/// A convolver in double precision:
///
/// y_o(k) = Σ_i Σ_n w_oi(n) x_i(k − latency − n) ,     x_i(j) = 0 for j < 0.
///
/// The error is a few units of rounding of Σ|w| max|x|, however long the stream is. One thread at a time may
/// use it.
pub struct FviConvolverF64(());

/// What makes responses ready for an exchange, on any thread; several threads may use it at the same time.
pub struct FviPreparerF64(());

/// A place for responses that are ready for a convolver. One thread at a time may use it.
pub struct FviPreparedF64(());

/// As fvi_convolver_new_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_convolver_new_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_new_f64(
    responses: *const FviResponseF64,
    inputs: usize,
    outputs: usize,
    stream: *const FviStream,
    convolver: *mut *mut FviConvolverF64,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::new::<f64, _>(responses, (inputs, outputs), stream, convolver.cast()) }
}

/// As fvi_convolver_free_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_convolver_free_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_free_f64(convolver: *mut FviConvolverF64) {
    // SAFETY: promised by the caller.
    unsafe { convolver::free::<Machine<f64>>(convolver.cast()) }
}

/// As fvi_convolver_process_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_convolver_process_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_process_f64(
    convolver: *mut FviConvolverF64,
    inputs: *const *const f64,
    outputs: *const *mut f64,
    samples: usize,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::process::<f64>(convolver.cast(), inputs, outputs, samples) }
}

/// As fvi_convolver_facts_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_convolver_facts_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_facts_f64(
    convolver: *const FviConvolverF64,
    facts: *mut FviConvolverFacts,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::facts::<f64>(convolver.cast(), facts) }
}

/// As fvi_preparer_new_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_preparer_new_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_preparer_new_f64(
    convolver: *const FviConvolverF64,
    preparer: *mut *mut FviPreparerF64,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::preparer::<f64>(convolver.cast(), preparer.cast()) }
}

/// As fvi_preparer_free_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_preparer_free_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_preparer_free_f64(preparer: *mut FviPreparerF64) {
    // SAFETY: promised by the caller.
    unsafe { convolver::free::<Preparer<f64>>(preparer.cast()) }
}

/// As fvi_preparer_prepare_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_preparer_prepare_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_preparer_prepare_f64(
    preparer: *const FviPreparerF64,
    responses: *const FviResponseF64,
    inputs: usize,
    outputs: usize,
    prepared: *mut *mut FviPreparedF64,
) -> FviStreamStatus {
    let count = (inputs, outputs);
    // SAFETY: promised by the caller.
    unsafe { convolver::prepare::<f64, _>(preparer.cast(), responses, count, prepared.cast()) }
}

/// As fvi_prepared_free_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_prepared_free_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_prepared_free_f64(prepared: *mut FviPreparedF64) {
    // SAFETY: promised by the caller.
    unsafe { convolver::free::<Prepared<f64>>(prepared.cast()) }
}

/// As fvi_convolver_exchange_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_convolver_exchange_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_exchange_f64(
    convolver: *mut FviConvolverF64,
    prepared: *mut FviPreparedF64,
    fade: usize,
    begins_in: *mut u64,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::exchange::<f64>(convolver.cast(), prepared.cast(), fade, Begins::Now, begins_in) }
}

/// As fvi_convolver_exchange_evenly_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_convolver_exchange_evenly_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_exchange_evenly_f64(
    convolver: *mut FviConvolverF64,
    prepared: *mut FviPreparedF64,
    fade: usize,
    begins_in: *mut u64,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::exchange::<f64>(convolver.cast(), prepared.cast(), fade, Begins::Evenly, begins_in) }
}

/// As fvi_convolver_take_retired_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_convolver_take_retired_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_take_retired_f64(
    convolver: *mut FviConvolverF64,
    prepared: *mut FviPreparedF64,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::take_retired::<f64>(convolver.cast(), prepared.cast()) }
}

/// As fvi_convolver_clear_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_convolver_clear_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_clear_f64(convolver: *mut FviConvolverF64) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::clear::<f64>(convolver.cast()) }
}

/// As fvi_convolver_save_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_convolver_save_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_save_f64(
    convolver: *const FviConvolverF64,
    bytes: *mut u8,
    capacity: usize,
    written: *mut usize,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::save::<f64>(convolver.cast(), bytes, capacity, written) }
}

/// As fvi_convolver_restore_f32, for a convolver in double precision.
///
/// # Safety
/// As for fvi_convolver_restore_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_restore_f64(
    convolver: *mut FviConvolverF64,
    bytes: *const u8,
    count: usize,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::restore::<f64>(convolver.cast(), bytes, count) }
}
