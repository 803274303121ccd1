//! A race of strategies for online convolution: the sums r_k = Σ_{n≥1} w_n x_{k−n} of a known kernel with
//! samples that arrive one by one.
//!
//! A file gives kernels, lengths, channels, precisions, tolerances and strategies ([`Plan`]); a [`Lab`] runs
//! the project's memories, strategies from the literature (`fvi-rivals`), programs over pipes, and strategies
//! of your own, which implement [`fvi_core::Memory`]:
//!
//! ```no_run
//! use fvi_strategies::{Lab, Made, Strategy};
//! # use fvi_rivals::PlainSum as Mine;
//!
//! let mine = Strategy::new("mine", "a plain sum of my own", |task| {
//!     Ok(Made::memory(Mine::new(&task.weights, task.channels, task.length)?))
//! });
//! let summary = Lab::new().with(mine).run("race.toml".as_ref(), "out/race".as_ref())?;
//! println!("{summary}");
//! # Ok::<(), fvi_strategies::LabError>(())
//! ```
#![forbid(unsafe_code)]

mod contestant;
pub mod engines;
mod field;
mod front;
mod kernel;
mod lab;
mod machine;
mod page;
mod picture;
mod pipe;
mod plan;
mod precision;
mod project;
mod race;
mod record;
mod strategy;

pub use front::Agreement;
pub use fvi_core;
pub use lab::{Lab, LabError, Summary};
pub use plan::Plan;
pub use precision::Precision;
pub use race::FoundOut;
pub use record::{Absence, Kind, RaceRecord, Record, Row};
pub use strategy::{Declined, Made, Strategy, Task};
