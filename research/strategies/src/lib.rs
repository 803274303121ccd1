#![doc = include_str!("../README.md")]
//!
//! A file gives a [`Plan`]; a [`Lab`] runs the project's memories, strategies from the literature
//! (`fvi-rivals`), programs over pipes, and strategies of your own, which implement [`fvi_core::Memory`].
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
mod table;

pub use front::Agreement;
pub use fvi_core;
pub use lab::{Lab, LabError, Summary};
pub use machine::Machine;
pub use plan::Plan;
pub use precision::Precision;
pub use race::Disqualified;
pub use record::{Absence, Kind, RaceRecord, Record, Row};
pub use strategy::{BuiltStrategy, Declined, Strategy, Task};
