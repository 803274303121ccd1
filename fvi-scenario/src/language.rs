//! The input language without its meaning: documents, expressions, and errors with their places.

#[doc(hidden)]
pub mod cells;
#[doc(hidden)]
pub mod document;
mod encoding;
#[doc(hidden)]
pub mod error;
#[doc(hidden)]
pub mod escape;
#[doc(hidden)]
pub mod excerpt;
#[doc(hidden)]
pub mod expression;
mod input_file;
pub(crate) mod matrix_file;
#[doc(hidden)]
pub mod memory_limit;
#[doc(hidden)]
pub mod npy;
#[doc(hidden)]
pub mod number_table;
mod paths;

pub use document::Document;
pub use error::{Cause, InputError, Problem};
pub use paths::{mirrored, number_at, put, put_with_mirror, value_at};
