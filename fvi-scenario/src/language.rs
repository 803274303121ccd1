//! The input language without its meaning: documents, expressions, and errors with their places.

pub mod document;
pub mod error;
pub mod escape;
pub mod excerpt;
pub mod expression;
mod input_file;
pub(crate) mod matrix_file;
pub mod memory_limit;
pub mod npy;
pub mod number_table;
mod paths;

pub use document::Document;
pub use error::{Cause, InputError, Problem};
pub use paths::{put, value_at};
