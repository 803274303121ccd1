//! Checks of kernels given by weights against the settings of a run.

use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::Scenario;

/// Refuses damping terms by weights if the run needs others: for another step, or more of them.
pub(super) fn check(scenario: &Scenario) -> Result<(), InputError> {
    for (index, term) in scenario.system.damping.iter().enumerate() {
        let Some(table) = term.transfer.table() else { continue };
        let path = format!("system.damping[{index}].kernel.weights");
        if let (Err(_), Some(own)) = (table.check_step(scenario.time.step), table.step()) {
            let with = format!("steps of {}", scenario.time.step);
            let allowed = format!("steps of {own}, to which these weights belong");
            return Err(scenario.error_at(&path, Problem::Incompatible { with, allowed }));
        }
        // One weight for each lag that occurs; a memory that forgets stores fewer samples.
        let lags = scenario.time.steps.saturating_add(1);
        let wanted = scenario.history.capacity.map_or(lags, |capacity| lags.min(capacity.saturating_add(1)));
        let rows = table.weights().len();
        if rows < wanted {
            let reason = format!(
                "{rows} weights where a run of {} steps needs {wanted}, n = 0…{}; where the kernel has ended they are 0",
                scenario.time.steps,
                wanted - 1
            );
            return Err(scenario.error_at(&path, Problem::Unusable { reason }));
        }
    }
    Ok(())
}
