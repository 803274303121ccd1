//! What comes out: trajectories, measures of them, pictures, and the files that all of it goes to.

pub mod files;
pub mod measure;
pub mod output_directory;
#[cfg(feature = "pictures")]
pub mod picture;
pub mod room;
#[cfg(feature = "pictures")]
pub(crate) mod run_pictures;
pub mod trajectory;
