//! The forms of transfer functions: each is a type in a file of its own, and a place in [`WRITTEN`].

mod distributed;
mod given;
mod havriliak_negami;
mod maxwell;
mod power;
mod prony;
mod symbolic;
mod tempered;

use super::form::WrittenForm;
pub(super) use distributed::Distributed;
pub(super) use given::Given;
pub(super) use havriliak_negami::HavriliakNegami;
pub(super) use maxwell::Maxwell;
pub(super) use power::Power;
pub(super) use prony::Prony;
pub(super) use symbolic::Symbolic;
pub(super) use tempered::Tempered;

/// The forms that files name by `form`.
pub const WRITTEN: [WrittenForm; 6] = [
    power::WRITTEN,
    tempered::WRITTEN,
    maxwell::WRITTEN,
    prony::WRITTEN,
    havriliak_negami::WRITTEN,
    distributed::WRITTEN,
];
