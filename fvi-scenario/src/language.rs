//! What users write, before anyone asks what it means: documents, expressions, and errors with their places.

pub mod document;
pub mod error;
pub mod excerpt;
pub mod expression;
pub(crate) mod matrix_file;
pub mod npy;
pub mod number_table;
pub mod visible;

pub use document::Document;
pub use error::{Cause, InputError, Problem};
