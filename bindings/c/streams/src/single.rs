//! Convolvers in single precision.

use fvi_fft::Preparer;

use crate::convolver::{self, Begins, Machine, Prepared, Response};
use crate::status::FviStreamStatus;
use crate::stream::{FviConvolverFacts, FviStream};

/// A finite response; with no samples it stands for no response, which costs nothing.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FviResponseF32 {
    /// Its samples w(0), w(1), …; they are copied.
    pub samples: *const f32,
    /// Their number, at most 268435456.
    pub count: usize,
}

impl Response<f32> for FviResponseF32 {
    fn parts(&self) -> (*const f32, usize) {
        (self.samples, self.count)
    }
}

/// A convolver in single precision:
///
/// y_o(k) = Σ_i Σ_n w_oi(n) x_i(k − latency − n) ,     x_i(j) = 0 for j < 0.
///
/// The error is a few units of rounding of Σ|w| max|x|, however long the stream is. One thread at a time may
/// use it.
pub struct FviConvolverF32(());

/// What makes responses ready for an exchange, on any thread; several threads may use it at the same time.
pub struct FviPreparerF32(());

/// A place for responses that are ready for a convolver. One thread at a time may use it.
pub struct FviPreparedF32(());

/// Makes a convolver from `inputs` to `outputs` channels, and writes its address to `convolver`. Everything
/// is planned and allocated here; memory that cannot be had ends the program.
///
/// `responses` is a matrix, row by row: the responses of input 0 to all outputs, then those of input 1, ….
/// They are copied. With as many inputs as outputs and the same array for each channel and nothing else, that
/// one is transformed and stored once.
///
/// Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _OUT_OF_RANGE, _LATENCY, _LONGEST, _NO_RESPONSE,
/// _RESPONSE_TOO_LONG or _RESPONSE_NOT_FINITE; then nothing is written. fvi_convolver_free_f32 frees it.
///
/// # Safety
/// `responses` must be `inputs` times `outputs` responses, each with as many samples as it says; `stream`
/// must be readable, `convolver` writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_new_f32(
    responses: *const FviResponseF32,
    inputs: usize,
    outputs: usize,
    stream: *const FviStream,
    convolver: *mut *mut FviConvolverF32,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::new::<f32, _>(responses, (inputs, outputs), stream, convolver.cast()) }
}

/// Frees a convolver; NULL is ignored.
///
/// # Safety
/// `convolver` must be NULL or come from fvi_convolver_new_f32, and not be used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_free_f32(convolver: *mut FviConvolverF32) {
    // SAFETY: promised by the caller.
    unsafe { convolver::free::<Machine<f32>>(convolver.cast()) }
}

/// Takes the next `samples` samples of each input and writes as many of each output: `inputs` and `outputs`
/// are the addresses of one array for each of them. An output may be the same array as an input, or lie
/// apart from all. Does not allocate, free, lock or wait.
///
/// Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _OUT_OF_RANGE, or _SAMPLE_NOT_FINITE; then neither convolver
/// nor outputs have changed.
///
/// # Safety
/// `convolver` must come from fvi_convolver_new_f32; there must be as many arrays as it has inputs and
/// outputs, each of them with room for `samples` numbers, those of the inputs readable, those of the outputs
/// writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_process_f32(
    convolver: *mut FviConvolverF32,
    inputs: *const *const f32,
    outputs: *const *mut f32,
    samples: usize,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::process::<f32>(convolver.cast(), inputs, outputs, samples) }
}

/// Writes what the convolver is, and where it is, to `facts`.
///
/// Returns FVI_STREAM_STATUS_NULL or _MISALIGNED.
///
/// # Safety
/// `convolver` must come from fvi_convolver_new_f32, `facts` be writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_facts_f32(
    convolver: *const FviConvolverF32,
    facts: *mut FviConvolverFacts,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::facts::<f32>(convolver.cast(), facts) }
}

/// Makes what prepares responses for this convolver, and writes its address to `preparer`; to be called on
/// the thread that uses the convolver, before the stream begins. It may outlive the convolver.
///
/// Returns FVI_STREAM_STATUS_NULL or _MISALIGNED; then nothing is written. fvi_preparer_free_f32 frees it.
///
/// # Safety
/// `convolver` must come from fvi_convolver_new_f32, `preparer` be writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_preparer_new_f32(
    convolver: *const FviConvolverF32,
    preparer: *mut *mut FviPreparerF32,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::preparer::<f32>(convolver.cast(), preparer.cast()) }
}

/// Frees what prepares responses; NULL is ignored.
///
/// # Safety
/// `preparer` must be NULL or come from fvi_preparer_new_f32, and not be used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_preparer_free_f32(preparer: *mut FviPreparerF32) {
    // SAFETY: promised by the caller.
    unsafe { convolver::free::<Preparer<f32>>(preparer.cast()) }
}

/// Makes responses ready for an exchange, on any thread, and writes the address of their place to `prepared`;
/// `responses`, `inputs` and `outputs` as for fvi_convolver_new_f32.
///
/// Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _OUT_OF_RANGE, _NO_RESPONSE, _RESPONSE_TOO_LONG,
/// _RESPONSE_NOT_FINITE, or _CHANNELS if the convolver has others; then nothing is written.
/// fvi_prepared_free_f32 frees it.
///
/// # Safety
/// `preparer` must come from fvi_preparer_new_f32; the rest as for fvi_convolver_new_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_preparer_prepare_f32(
    preparer: *const FviPreparerF32,
    responses: *const FviResponseF32,
    inputs: usize,
    outputs: usize,
    prepared: *mut *mut FviPreparedF32,
) -> FviStreamStatus {
    let count = (inputs, outputs);
    // SAFETY: promised by the caller.
    unsafe { convolver::prepare::<f32, _>(preparer.cast(), responses, count, prepared.cast()) }
}

/// Frees a place, with the responses in it; NULL is ignored. It frees memory: not for the thread of a stream.
///
/// # Safety
/// `prepared` must be NULL or come from fvi_preparer_prepare_f32, and not be used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_prepared_free_f32(prepared: *mut FviPreparedF32) {
    // SAFETY: promised by the caller.
    unsafe { convolver::free::<Prepared<f32>>(prepared.cast()) }
}

/// Begins to exchange the responses: from the next sample on, with i = 0, 1, …,
///
/// y = (1 − g) y_old + g y_new ,     g = min(1, i/fade) ,
///
/// where y_old and y_new are the convolutions of the whole stream with the responses before and after. Takes
/// the responses out of their place; what an earlier exchange has put out of use is in it afterwards, else it
/// is empty. `begins_in`, unless NULL, receives the samples until the fade begins, here 0.
///
/// The blocks under way are computed for the new responses at once, which for long responses takes as long as
/// some blocks of audio; fvi_convolver_exchange_evenly_f32 does not. Neither allocates, frees, locks or
/// waits.
///
/// Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _EMPTY if there is nothing in the place, _BUSY or _FOREIGN;
/// then nothing has changed, and the responses are still in their place.
///
/// # Safety
/// `convolver` must come from fvi_convolver_new_f32, `prepared` from fvi_preparer_prepare_f32; `begins_in`
/// must be NULL or writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_exchange_f32(
    convolver: *mut FviConvolverF32,
    prepared: *mut FviPreparedF32,
    fade: usize,
    begins_in: *mut u64,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::exchange::<f32>(convolver.cast(), prepared.cast(), fade, Begins::Now, begins_in) }
}

/// The same without any work here: the fade begins when the outputs of the new responses have been computed
/// along with those of the old ones, after one to two blocks of the coarsest stage; `begins_in` receives how
/// many samples these are. Until it has ended the products of spectra cost twice as much.
///
/// Returns what fvi_convolver_exchange_f32 returns.
///
/// # Safety
/// As for fvi_convolver_exchange_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_exchange_evenly_f32(
    convolver: *mut FviConvolverF32,
    prepared: *mut FviPreparedF32,
    fade: usize,
    begins_in: *mut u64,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::exchange::<f32>(convolver.cast(), prepared.cast(), fade, Begins::Evenly, begins_in) }
}

/// Moves the responses that an exchange has put out of use, after its fade has ended, to an empty place, to
/// be freed on another thread or used again.
///
/// Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _OCCUPIED if the place is not empty, or _EMPTY if none are
/// out of use; then nothing has changed.
///
/// # Safety
/// As for fvi_convolver_exchange_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_take_retired_f32(
    convolver: *mut FviConvolverF32,
    prepared: *mut FviPreparedF32,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::take_retired::<f32>(convolver.cast(), prepared.cast()) }
}

/// Forgets all samples; an exchange under way ends.
///
/// Returns FVI_STREAM_STATUS_NULL or _MISALIGNED.
///
/// # Safety
/// `convolver` must come from fvi_convolver_new_f32.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_clear_f32(convolver: *mut FviConvolverF32) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::clear::<f32>(convolver.cast()) }
}

/// Saves a convolver: writes its state, the last samples of each input, to `bytes` and the number of bytes to
/// `written`. With a capacity of 0 only the number of bytes that are needed at present is written; it grows
/// until as many samples have come as the longest response has, and some more.
///
/// The bytes are the same on every machine. They contain no checksum; where stored bits can change, add one.
/// Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _OUT_OF_RANGE, or _WRONG_SIZE if the capacity is too small;
/// then nothing is written.
///
/// # Safety
/// `convolver` must come from fvi_convolver_new_f32, `capacity` bytes and `written` be writable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_save_f32(
    convolver: *const FviConvolverF32,
    bytes: *mut u8,
    capacity: usize,
    written: *mut usize,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::save::<f32>(convolver.cast(), bytes, capacity, written) }
}

/// Restores what fvi_convolver_save_f32 wrote, into a convolver with the same responses and the same stream:
/// it then continues bit-identically, whatever it did before. A state saved during an exchange needs a
/// convolver in which an exchange for the same responses is under way. Bytes after the state, up to `count`,
/// are ignored.
///
/// Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _OUT_OF_RANGE, or _WRONG_STATE if the bytes are not the state
/// of such a convolver, which is then unchanged.
///
/// # Safety
/// `convolver` must come from fvi_convolver_new_f32, `count` bytes be readable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_convolver_restore_f32(
    convolver: *mut FviConvolverF32,
    bytes: *const u8,
    count: usize,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    unsafe { convolver::restore::<f32>(convolver.cast(), bytes, count) }
}
