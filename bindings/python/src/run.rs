//! Runs of scenarios.

use crate::documents::Source;
use crate::errors::{Failure, Outcome, guarded};
use crate::terms::{Callables, ErrorSlot, PythonTerms};
use crate::watch::Watch;
use fvi_host::lab::checkpoint::IntervalError;
use fvi_host::lab::run::{Run, RunError, RunOptions, RunSummary, run as run_into_files};
use fvi_host::language::Problem;
use fvi_host::memory::Tables;
use fvi_host::results::room::require;
use fvi_host::results::trajectory::Format;
use fvi_host::scenario::{Engine, KnownMatrices, Scenario, SharedTerms};
use fvi_host::simulation::{GridState, Precision};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// What a motion hands to Python: the name of its load case, t, q, p, energy, u, setpoint and measure of each
/// controller, the derivatives of q and p by each parameter, how it ended, and the summary, both as JSON: the
/// latter is long where there are many coordinates, and seldom looked at.
type Motion<'py> = (
    String,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    String,
    String,
);

/// Runs a scenario and keeps the rows that `fvi run` would write: those of its one motion, or with `cases`
/// those of each load case.
#[pyfunction]
#[pyo3(signature = (source, *, engine = None, precision = "f64", progress = None, terms = None, cases = false,
                    prepared = None, spent = 0.0))]
#[expect(clippy::too_many_arguments, reason = "the keywords of the function")]
pub(crate) fn run<'py>(
    py: Python<'py>,
    source: Source,
    engine: Option<&str>,
    precision: &str,
    progress: Option<Py<PyAny>>,
    terms: Option<Callables>,
    cases: bool,
    prepared: Option<&Prepared>,
    spent: f64,
) -> PyResult<(Vec<Motion<'py>>, Option<PyErr>)> {
    let engine = engine.map(self::engine).transpose()?;
    let precision = self::precision(precision)?;
    let begin = Instant::now();
    let known = prepared.map(|prepared| &prepared.matrices);
    let own_tables = Tables::default();
    let tables = prepared.map_or(&own_tables, |prepared| &prepared.tables);
    let read = || if cases { read_its_cases(&source, engine) } else { read_knowing(&source, engine, known) };
    let spent = || spent + begin.elapsed().as_secs_f64();
    let (names, motions, raised) = match terms {
        // Code of the caller's is called several times a step: the interpreter hands over between its
        // instructions anyway.
        Some(callables) => {
            let slot = ErrorSlot::default();
            guarded(|| {
                let scenario = read()?;
                let mut terms = PythonTerms::new(callables, scenario.coordinates(), slot.clone());
                terms.look_at_the_start(&scenario.initial.position)?;
                let scenario = scenario.with_own_terms(SharedTerms::new(terms));
                compute(&source, &scenario, (precision, tables, spent()), progress, &slot)
            })?
        }
        None => py.detach(|| {
            guarded(|| {
                let scenario = read()?;
                compute(&source, &scenario, (precision, tables, spent()), progress, &ErrorSlot::default())
            })
        })?,
    };
    let motions = names.into_iter().zip(motions);
    let motions = motions.map(|(name, (rows, summary))| rows.into_python(py, name, &summary));
    Ok((motions.collect::<PyResult<_>>()?, raised))
}

/// Runs a scenario as `fvi run` does, into a directory, with NumPy arrays and checkpoints; returns the
/// summary as JSON, and the exception that stopped it, if one did.
#[pyfunction]
#[pyo3(signature = (source, directory, *, engine = None, precision = "f64", progress = None, checkpoint_every = None,
                    resume = false, accept_other_machine = false))]
#[expect(clippy::too_many_arguments, reason = "the keywords of the function")]
pub(crate) fn run_in(
    py: Python<'_>,
    source: Source,
    directory: PathBuf,
    engine: Option<&str>,
    precision: &str,
    progress: Option<Py<PyAny>>,
    checkpoint_every: Option<&str>,
    resume: bool,
    accept_other_machine: bool,
) -> PyResult<(String, Option<PyErr>)> {
    let engine = engine.map(self::engine).transpose()?;
    let precision = self::precision(precision)?;
    let checkpoints = checkpoint_every.map(str::parse).transpose().map_err(|error: IntervalError| {
        let (key, value) = ("checkpoint_every".to_owned(), checkpoint_every.unwrap_or_default().to_owned());
        Failure::Input { message: format!("{key}: {error}"), key, value }
    })?;
    let (summary, raised) = py.detach(|| {
        guarded(|| {
            let scenario = read(&source, engine)?;
            let options = RunOptions {
                precision,
                format: Some(Format::Npz),
                checkpoints: checkpoints.unwrap_or_default(),
                resume,
                accept_other_machine,
                ..RunOptions::new(directory)
            };
            let stop = AtomicBool::new(false);
            let mut watch = Watch::new(progress);
            let result = run_into_files(&scenario, &options, &stop, &mut |steps| {
                if !watch.tick(steps, scenario.time.steps_known()) {
                    stop.store(true, Ordering::Relaxed);
                }
            });
            let summary = result.map_err(|error| match error {
                RunError::Input(error) => source.failure(&error),
                RunError::File(error) => Failure::File(error.to_string()),
                RunError::Checkpoint(error) => {
                    Failure::Input { key: "out".to_owned(), value: String::new(), message: error.to_string() }
                }
                other => Failure::Failed(other.to_string()),
            })?;
            let summary =
                serde_json::to_string(&summary).map_err(|error| Failure::Failed(error.to_string()))?;
            Ok((summary, watch.into_raised()))
        })
    })?;
    Ok((summary, raised))
}

/// The precision of a name.
pub(crate) fn precision(name: &str) -> Result<Precision, Failure> {
    match name {
        "f64" => Ok(Precision::F64),
        "f32" => Ok(Precision::F32),
        other => Err(Failure::argument("precision", format!("{other:?}"), "\"f64\", \"f32\"")),
    }
}

/// The engine of a name.
pub(crate) fn engine(name: &str) -> Result<Engine, Failure> {
    Engine::NAMES.iter().find(|(known, _)| *known == name).map(|&(_, engine)| engine).ok_or_else(|| {
        let names: Vec<_> = Engine::NAMES.iter().map(|(name, _)| format!("\"{name}\"")).collect();
        Failure::argument("engine", format!("{name:?}"), &names.join(", "))
    })
}

/// Shared between runs of one model: matrices with their analyses and factors, tables of memories.
#[pyclass(frozen, module = "fvi._fvi")]
pub(crate) struct Prepared {
    matrices: KnownMatrices,
    tables: Tables,
}

#[pymethods]
impl Prepared {
    #[new]
    fn new() -> Self {
        Self { matrices: KnownMatrices::default(), tables: Tables::default() }
    }
}

/// The scenario of a source, of one motion.
pub(crate) fn read(source: &Source, engine: Option<Engine>) -> Outcome<Scenario> {
    read_knowing(source, engine, None)
}

/// The scenario of a source, of one motion, with matrices that are known already.
fn read_knowing(source: &Source, engine: Option<Engine>, known: Option<&KnownMatrices>) -> Outcome<Scenario> {
    let scenario = read_cases(source, engine, known)?;
    scenario
        .require_one_motion("functions that return one motion; `run_cases` takes them")
        .map_err(|error| source.failure(&error))?;
    Ok(scenario)
}

/// The scenario of a source, which must have load cases.
fn read_its_cases(source: &Source, engine: Option<Engine>) -> Outcome<Scenario> {
    let scenario = read_cases(source, engine, None)?;
    if scenario.cases.is_empty() {
        return Err(
            source.failure(&scenario.error_at("case", Problem::MissingKey { key: "case".to_owned() }))
        );
    }
    Ok(scenario)
}

/// The scenario of a source, which may have load cases.
fn read_cases(source: &Source, engine: Option<Engine>, known: Option<&KnownMatrices>) -> Outcome<Scenario> {
    let scenario = source.document().and_then(|document| match known {
        Some(known) => Scenario::knowing(document, known),
        None => Scenario::from_document(document),
    });
    let mut scenario = scenario.map_err(|error| source.failure(&error))?;
    if let Some(engine) = engine {
        scenario.history.choose(engine);
    }
    Ok(scenario)
}

fn compute(
    source: &Source,
    scenario: &Scenario,
    (precision, tables, spent): (Precision, &Tables, f64),
    progress: Option<Py<PyAny>>,
    slot: &ErrorSlot,
) -> Outcome<(Vec<String>, Vec<(Rows, RunSummary)>, Option<PyErr>)> {
    let run = Run::sharing_cases(scenario, precision, tables)
        .map_err(|error| slot.take().map_or_else(|| source.failure(&error), Failure::Raised))?
        .prepared_for(spent);
    let mut motions = Rows::of_cases(scenario)?;
    let mut watch = Watch::new(progress);
    let stop = AtomicBool::new(false);
    let all = scenario.time.steps_known();
    let result = run.rows_of_cases_to_the_end(
        &stop,
        |case, row| {
            if let Some(rows) = motions.get_mut(case) {
                rows.push(row);
            }
            Ok::<_, Infallible>(())
        },
        |batch| {
            let steps = batch.first() + batch.len().saturating_sub(1);
            if steps > 0 && !watch.tick(steps, all) {
                stop.store(true, Ordering::Relaxed);
            }
        },
    );
    let Ok(summaries) = result;
    let names = match scenario.cases.as_slice() {
        [] => vec![String::new()],
        cases => cases.iter().map(|case| case.name.clone()).collect(),
    };
    Ok((names, motions.into_iter().zip(summaries).collect(), slot.take().or(watch.into_raised())))
}

/// The rows of a trajectory, column by column.
struct Rows {
    coordinates: usize,
    time: Vec<f64>,
    /// Row by row, N numbers each.
    position: Vec<f64>,
    momentum: Vec<f64>,
    energy: Vec<f64>,
    /// Row by row, three numbers for each controller.
    control: Vec<f64>,
    controllers: usize,
    derivatives: Vec<f64>,
}

impl Rows {
    /// Room for those of each load case of a scenario.
    fn of_cases(scenario: &Scenario) -> Outcome<Vec<Self>> {
        let coordinates = scenario.written_coordinates().len();
        // They grow where nobody knows how many there will be.
        let steps = scenario.time.steps_known().unwrap_or_default();
        let rows = match scenario.output.times.len() {
            0 => (steps / scenario.output.every).saturating_add(2),
            times => times,
        };
        let controllers = scenario.controllers.len();
        let parameters = scenario.sensitivity.as_ref().map_or(0, |asked| asked.parameters.len());
        let derivatives = coordinates.saturating_mul(2).saturating_mul(parameters);
        let more = derivatives.saturating_add(controllers.saturating_mul(3));
        let numbers = coordinates.saturating_mul(2).saturating_add(2).saturating_add(more);
        let no_room = |what: String| {
            Failure::NoRoom(format!(
                "{rows} rows of {numbers} numbers: {what}; write fewer of them with `every`"
            ))
        };
        let copies = scenario.copies();
        require(rows.saturating_mul(numbers).saturating_mul(copies).saturating_mul(size_of::<f64>()))
            .map_err(|error| no_room(error.to_string()))?;
        let room = |count: usize| {
            let mut room: Vec<f64> = Vec::new();
            room.try_reserve_exact(count).map(|()| room).map_err(|error| no_room(error.to_string()))
        };
        let one = |_| {
            Ok(Self {
                coordinates,
                time: room(rows)?,
                position: room(rows * coordinates)?,
                momentum: room(rows * coordinates)?,
                energy: room(rows)?,
                control: room(rows * 3 * controllers)?,
                controllers,
                derivatives: room(rows * derivatives)?,
            })
        };
        (0..copies).map(one).collect()
    }

    /// As arrays, with the record of the run.
    fn into_python<'py>(self, py: Python<'py>, name: String, summary: &RunSummary) -> PyResult<Motion<'py>> {
        let json = |value: Result<String, serde_json::Error>| {
            value.map_err(|error| Failure::Failed(error.to_string()))
        };
        let end = json(serde_json::to_string(&summary.in_short()))?;
        let summary = json(serde_json::to_string(summary))?;
        let Self { coordinates, time, position, momentum, energy, control, controllers, derivatives } = self;
        let rows = time.len();
        let table = |numbers: Vec<f64>, columns| numbers.into_pyarray(py).reshape([rows, columns]);
        let columns = derivatives.len().checked_div(rows).unwrap_or(0);
        let (position, momentum) = (table(position, coordinates)?, table(momentum, coordinates)?);
        let (control, derivatives) = (table(control, 3 * controllers)?, table(derivatives, columns)?);
        let (time, energy) = (time.into_pyarray(py), energy.into_pyarray(py));
        Ok((name, time, position, momentum, energy, control, derivatives, end, summary))
    }

    fn push(&mut self, state: &GridState) {
        self.time.push(state.time);
        self.position.extend_from_slice(&state.position);
        self.momentum.extend_from_slice(&state.momentum);
        self.energy.push(state.energy);
        self.derivatives.extend_from_slice(&state.sensitivities);
        self.control.extend_from_slice(&state.control);
    }
}
