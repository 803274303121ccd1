//! What users write, before anyone asks what it means: documents, expressions, and errors with their places.

pub(crate) mod document;
pub(crate) mod error;
pub(crate) mod excerpt;
pub mod expression;
pub(crate) mod matrix_file;
pub(crate) mod npy;
pub(crate) mod number_table;
pub(crate) mod visible;

pub use document::Document;
pub use error::{Cause, InputError, Problem};
