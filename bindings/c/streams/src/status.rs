//! What a call returns.

use core::ffi::{CStr, c_char};

use fvi_core::{ParameterError, StateError};
use fvi_fft::{ExchangeError, StreamError};

/// The status returned by a call. Any status but FVI_STREAM_STATUS_OK means that the call has changed
/// nothing.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FviStreamStatus {
    /// Success.
    Ok = 0,
    /// A pointer is NULL that must not be.
    Null = 1,
    /// A pointer is not aligned as its type requires.
    Misaligned = 2,
    /// A number of samples, bytes or responses is larger than any array can be.
    OutOfRange = 3,
    /// The latency is longer than 16777216 samples.
    Latency = 4,
    /// The length to be planned for is longer than 268435456 samples.
    Longest = 5,
    /// There is no input, no output, or no response with a sample.
    NoResponse = 6,
    /// A response is longer than 268435456 samples, or than the convolver was planned for.
    ResponseTooLong = 7,
    /// A sample of a response is infinite or NaN.
    ResponseNotFinite = 8,
    /// The responses are not from as many inputs to as many outputs as those of the convolver.
    Channels = 9,
    /// A sample of the stream is infinite or NaN.
    SampleNotFinite = 10,
    /// An exchange is under way.
    Busy = 11,
    /// The responses were prepared for a convolver of another shape, stream or precision.
    Foreign = 12,
    /// There are no responses: the place is empty, or none have been put out of use.
    Empty = 13,
    /// There are responses in the place already.
    Occupied = 14,
    /// The buffer is smaller than the state.
    WrongSize = 15,
    /// Saved bytes are incomplete, damaged, or the state of another convolver.
    WrongState = 16,
}

/// The name that `pointer.rs` has for it.
pub(crate) use FviStreamStatus as FviStatus;

/// A short English text for a status; an unknown one has a text as well. Never NULL.
#[unsafe(no_mangle)]
pub extern "C" fn fvi_stream_status_text(status: i32) -> *const c_char {
    const TEXTS: [&CStr; 17] = [
        c"done",
        c"a pointer is NULL",
        c"a pointer is not aligned",
        c"a number of samples, bytes or responses is larger than any array",
        c"the latency is longer than 16777216 samples",
        c"the length to be planned for is longer than 268435456 samples",
        c"there is no input, no output, or no response with a sample",
        c"a response is longer than 268435456 samples, or than the convolver was planned for",
        c"a sample of a response is not finite",
        c"the responses are for another number of inputs or outputs",
        c"a sample of the stream is not finite",
        c"an exchange is under way",
        c"the responses were prepared for another convolver",
        c"there are no responses in this place",
        c"there are responses in this place already",
        c"the buffer is smaller than the state",
        c"the saved state is damaged or belongs to another convolver",
    ];
    let text = usize::try_from(status).ok().and_then(|status| TEXTS.get(status));
    text.unwrap_or(&c"unknown status").as_ptr()
}

/// The status of a result.
pub(crate) fn status(result: Result<(), FviStreamStatus>) -> FviStreamStatus {
    match result {
        Ok(()) => FviStreamStatus::Ok,
        Err(status) => status,
    }
}

/// The status of a parameter of a convolver or of its responses that is refused.
pub(crate) fn of_parameter(error: ParameterError) -> FviStreamStatus {
    match (error.parameter, error.value) {
        ("latency", _) => FviStreamStatus::Latency,
        ("longest", _) => FviStreamStatus::Longest,
        ("samples of a response" | "responses" | "channels", 0.0) => FviStreamStatus::NoResponse,
        ("samples of a response", _) => FviStreamStatus::ResponseTooLong,
        ("response", _) => FviStreamStatus::ResponseNotFinite,
        ("inputs" | "outputs", _) => FviStreamStatus::Channels,
        _ => FviStreamStatus::OutOfRange,
    }
}

/// The status of a block that is refused. The numbers of channels and samples are those of the convolver.
pub(crate) fn of_block(error: StreamError) -> FviStreamStatus {
    match error {
        StreamError::NotFinite { .. } => FviStreamStatus::SampleNotFinite,
        _ => FviStreamStatus::Channels,
    }
}

/// The status of an exchange that is refused.
pub(crate) fn of_exchange<T: fvi_fft::Engines>(error: &ExchangeError<T>) -> FviStreamStatus {
    match error {
        ExchangeError::Busy { .. } => FviStreamStatus::Busy,
        _ => FviStreamStatus::Foreign,
    }
}

impl From<StateError> for FviStreamStatus {
    fn from(error: StateError) -> Self {
        match error {
            StateError::NoRoom { .. } => Self::WrongSize,
            _ => Self::WrongState,
        }
    }
}
