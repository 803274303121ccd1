//! C interface of fvi-fft's convolver: finite responses on streams without end.
//!
//! A library of its own beside that of fvi-core, since it allocates: when a convolver is made and when
//! responses are prepared, never when a block is processed or responses are exchanged. Every call that can
//! fail returns a status that says what is wrong, and changes nothing in that case. The header
//! `fvi_streams.h` is generated from this crate.

mod convolver;
mod double;
// The checks of pointers are those of the other library.
#[path = "../../src/pointer.rs"]
mod pointer;
mod single;
mod status;
mod stream;

pub use double::*;
pub use single::*;
pub use status::*;
pub use stream::*;
