//! What the last run leaves behind for one of another member of its batch.

use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::Simulation;

/// The member whose run a thread has made last, in whose place the next one is put, and its simulation, which
/// begins anew for the next one.
#[derive(Default)]
pub(crate) struct Last {
    pub(crate) member: Option<Scenario>,
    pub(crate) simulation: Option<Simulation>,
}
