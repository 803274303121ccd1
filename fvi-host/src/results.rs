//! Results: trajectories, measures of them, pictures, and the files that they are written to.

pub(crate) mod csv_row;
pub mod files;
pub(crate) mod growing_file;
mod levels;
pub mod measure;
pub(crate) mod npz_rows;
pub(crate) mod numpy;
pub mod output_directory;
#[cfg(feature = "pictures")]
pub mod picture;
pub mod rows;
#[cfg(feature = "pictures")]
pub(crate) mod run_pictures;
pub(crate) mod run_traces;
pub(crate) mod sections;
pub(crate) mod snapshots;
pub mod trace;
pub mod trajectory;
