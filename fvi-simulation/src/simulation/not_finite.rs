//! The start of a simulation, and checks that states and energies are finite.

use crate::column::is_finite;
use crate::simulation::step_batch::StepBatch;
use crate::simulation::{GridState, Precision, Simulation, SolverChoice};
use fvi_fft::memory::Tables;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::Scenario;

/// A simulation and its state at t = 0; one that has `ended` begins anew if it can.
///
/// # Errors
/// If the simulation cannot be built, or its state or energy is not finite in its precision.
pub(crate) fn start(
    ended: Option<Simulation>,
    scenario: &Scenario,
    precision: Precision,
    tables: &Tables,
) -> Result<(Simulation, GridState), InputError> {
    if precision == Precision::F32 {
        check_range(scenario)?;
    }
    let mut begun = None;
    if let Some(mut simulation) = ended {
        begun = simulation.begin_anew(scenario)?.then_some(simulation);
    }
    let mut simulation = match begun {
        Some(simulation) => simulation,
        None => Simulation::sharing(scenario, precision, SolverChoice::default(), tables)?,
    };
    let none = vec![0.0; scenario.coordinates() * scenario.copies()];
    let mut state = GridState { position: none.clone(), momentum: none, ..GridState::default() };
    simulation.read(&mut state);
    match what_is_not_finite(&state) {
        None => Ok((simulation, state)),
        Some(what) => {
            let (time, initial) = (scenario.time.start, &scenario.initial);
            let place = format!("t = {time}, q = {:?}, p = {:?}", initial.position, initial.momentum);
            let problem = Problem::NotFinite { what, place };
            // The potential has been checked: the remaining cause is an overflow of the momentum or the
            // kinetic energy.
            let key = if what == "the position" { "initial.position" } else { momentum_key(scenario) };
            Err(scenario.error_at(key, problem))
        }
    }
}

/// The key by which the file gives the momentum.
fn momentum_key(scenario: &Scenario) -> &'static str {
    let problem = Problem::NotFinite { what: "the momentum", place: String::new() };
    let given = scenario.error_at("initial.velocity", problem).line().is_some();
    if given { "initial.velocity" } else { "initial.momentum" }
}

/// Refuses numbers out of the range of single precision, with their keys.
fn check_range(scenario: &Scenario) -> Result<(), InputError> {
    let held = |&number: &f64| (number as f32).is_finite();
    let refused = |key, allowed: &str| {
        let reason = format!("single precision holds numbers up to 3.4e38; {allowed}");
        Err(scenario.error_at(key, Problem::Precision { reason }))
    };
    if !scenario.initial.position.iter().all(held) {
        return refused("initial.position", "take another unit of length, or `--precision f64`");
    }
    if !scenario.initial.momentum.iter().all(held) {
        return refused(
            momentum_key(scenario),
            "the momentum M v is beyond them; take other units, or `--precision f64`",
        );
    }
    if !held(&scenario.time.step) || scenario.time.step as f32 == 0.0 {
        return refused(
            "time.step",
            "and steps down to 1.4e-45; take another unit of time, or `--precision f64`",
        );
    }
    Ok(())
}

/// Name of the first number of a state that is infinite or not a number.
pub(crate) fn what_is_not_finite(state: &GridState) -> Option<&'static str> {
    let finite = |numbers: &[f64]| numbers.iter().all(|number| number.is_finite());
    if !finite(&state.position) {
        Some("the position")
    } else if !finite(&state.momentum) {
        Some("the momentum")
    } else if !state.energy.is_finite() {
        Some("the energy")
    } else {
        None
    }
}

/// Index of the first state that is not finite, and the name of the number.
pub(crate) fn first_not_finite(batch: &StepBatch, scratch: &mut GridState) -> Option<(usize, &'static str)> {
    let all_finite = match batch.alone() {
        Some((position, momentum)) => [position, momentum, batch.energies()].into_iter().all(is_finite),
        None => batch.positions().chain(batch.momenta()).chain([batch.energies()]).all(is_finite),
    };
    if all_finite {
        return None;
    }
    (0..batch.len()).find_map(|index| {
        batch.read(index, scratch);
        what_is_not_finite(scratch).map(|what| (index, what))
    })
}

/// Reason of the failure of a step whose result is not finite.
pub(crate) fn reason(what: &str) -> String {
    format!("{what} is not finite at its end")
}
