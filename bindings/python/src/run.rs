//! Runs of scenarios.

use crate::documents::Source;
use crate::errors::{Failure, Outcome, guarded};
use crate::terms::{Callables, ErrorSlot, Functions};
use crate::watch::Watch;
use fvi_fft::memory::Engine;
use fvi_fft::memory::Tables;
use fvi_host::checkpoint::IntervalError;
use fvi_host::results::rows::Rows;
use fvi_host::results::trajectory::Format;
use fvi_host::run::{
    Run, RunEnd, RunError, RunOptions, RunSnapshot as HostSnapshot, RunSummary, choose, run as run_into_files,
};
use fvi_scenario::language::Problem;
use fvi_scenario::scenario::{Feature, KnownMatrices, Scenario};
use fvi_simulation::simulation::{Precision, sample_fractions};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Result of a motion for Python: name of its load case, its arrays, as JSON how it ended, and the whole
/// summary.
type Motion<'py> = (String, Arrays<'py>, String, Record);

/// Runs a scenario and returns the rows that `fvi run` would write: those of its one motion, or with `cases`
/// those of each load case.
#[pyfunction]
#[pyo3(signature = (source, *, engine = None, precision = "f64", progress = None, terms = None, cases = false,
                    prepared = None, spent = 0.0, events = Vec::new(), resume = None, keep = None))]
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
    events: Vec<Option<Py<PyAny>>>,
    resume: Option<&RunSnapshot>,
    keep: Option<bool>,
) -> PyResult<(Vec<Motion<'py>>, Option<PyErr>, Option<RunSnapshot>)> {
    let engine = engine.map(self::engine).transpose()?;
    let precision = self::precision(precision)?;
    let begin = Instant::now();
    let known = prepared.map(|prepared| &prepared.matrices);
    let own_tables = Tables::default();
    let tables = prepared.map_or(&own_tables, |prepared| &*prepared.tables);
    let read = || -> Outcome<Scenario> {
        let scenario =
            if cases { read_its_cases(&source, engine) } else { read_knowing(&source, engine, known) };
        let mut scenario = scenario?;
        if let Some(RunSnapshot { snapshot }) = resume {
            scenario.history.planned = Some(snapshot.planned());
        }
        Ok(scenario)
    };
    let functions = Functions { terms, events };
    let needs_interpreter = functions.need_interpreter();
    let spent = || spent + begin.elapsed().as_secs_f64();
    let run = || {
        guarded(|| {
            let slot = ErrorSlot::default();
            let scenario = functions.put_into(read()?, &slot, (resume.is_none(), false))?;
            compute(&source, &scenario, (precision, tables, spent()), progress, &slot, (resume, keep))
        })
    };
    // Functions of Python are called several times a step, so that the interpreter can switch threads between
    // their instructions.
    let (names, motions, raised, snapshot) = if needs_interpreter { run() } else { py.detach(run) }?;
    let motions = names.into_iter().zip(motions);
    let motions = motions.map(|(name, (rows, summary))| into_python(py, name, rows, summary));
    Ok((motions.collect::<PyResult<_>>()?, raised, snapshot.map(|snapshot| RunSnapshot { snapshot })))
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
    pub(crate) matrices: KnownMatrices,
    pub(crate) tables: Arc<Tables>,
}

#[pymethods]
impl Prepared {
    #[new]
    fn new() -> Self {
        Self { matrices: KnownMatrices::default(), tables: Arc::default() }
    }
}

/// State of a run from which another run can continue.
#[pyclass(frozen, module = "fvi._fvi")]
pub(crate) struct RunSnapshot {
    snapshot: HostSnapshot,
}

#[pymethods]
impl RunSnapshot {
    #[getter]
    fn steps(&self) -> usize {
        self.snapshot.steps()
    }

    #[getter]
    fn nbytes(&self) -> usize {
        self.snapshot.bytes()
    }
}

/// Fractions of a step at which the positions of a past are needed in addition to the beginning of the step;
/// empty where the latter suffice.
#[pyfunction]
pub(crate) fn past_nodes(py: Python<'_>, source: Source) -> PyResult<Vec<f64>> {
    py.detach(|| guarded(|| Ok(sample_fractions(&read(&source, None)?))))
}

/// Reads the scenario of a source, which must not have load cases.
pub(crate) fn read(source: &Source, engine: Option<Engine>) -> Outcome<Scenario> {
    read_knowing(source, engine, None)
}

/// Like [`read`], with matrices that have been read already.
pub(crate) fn read_knowing(
    source: &Source,
    engine: Option<Engine>,
    known: Option<&KnownMatrices>,
) -> Outcome<Scenario> {
    let scenario = read_cases(source, engine, known)?;
    scenario.check_use(Feature::OneMotion).map_err(|error| source.failure(&error))?;
    Ok(scenario)
}

/// Reads the scenario of a source, which must have load cases.
fn read_its_cases(source: &Source, engine: Option<Engine>) -> Outcome<Scenario> {
    let scenario = read_cases(source, engine, None)?;
    if scenario.cases.is_empty() {
        return Err(
            source.failure(&scenario.error_at("case", Problem::MissingKey { key: "case".to_owned() }))
        );
    }
    Ok(scenario)
}

/// Reads the scenario of a source, which may have load cases.
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

/// Size of the memories in bytes up to which a result always keeps the state for a continuation.
const SMALL: usize = 16_000_000;

/// Names of the load cases, rows and summary of each, the exception that stopped the run, and its final
/// state.
type Computed = (Vec<String>, Vec<(Rows, RunSummary)>, Option<PyErr>, Option<HostSnapshot>);

fn compute(
    source: &Source,
    scenario: &Scenario,
    (precision, tables, spent): (Precision, &Tables, f64),
    progress: Option<Py<PyAny>>,
    slot: &ErrorSlot,
    (resume, keep): (Option<&RunSnapshot>, Option<bool>),
) -> Outcome<Computed> {
    let raised = |error| slot.take().map_or_else(|| source.failure(&error), Failure::Raised);
    let begin = Instant::now();
    let chosen =
        match scenario.automatic {
            Some(_) => Some(choose(scenario, precision, tables, &AtomicBool::new(false)).map_err(
                |error| match error {
                    RunError::Input(error) => raised(error),
                    other => slot.take().map_or_else(|| Failure::Failed(other.to_string()), Failure::Raised),
                },
            )?),
            None => None,
        };
    let scenario = chosen.as_ref().map_or(scenario, |chosen| &chosen.scenario);
    let mut run = Run::of(scenario)
        .precision(precision)
        .tables(tables)
        .chosen(chosen.as_ref().map(|chosen| &chosen.choice))
        .prepared_for(spent + begin.elapsed().as_secs_f64())
        .start()
        .map_err(raised)?;
    if let Some(RunSnapshot { snapshot }) = resume {
        run.resume_from(snapshot).map_err(|error| Failure::Failed(format!("continue_from: {error}")))?;
    }
    let mut motions = Rows::of_cases(scenario).map_err(|error| Failure::NoRoom(error.to_string()))?;
    let mut watch = Watch::new(progress);
    let stop = AtomicBool::new(false);
    let all = scenario.time.steps_known();
    let Ok(end) = run.drive(&stop, |portion| {
        let batch = portion.batch();
        let steps = batch.first() + batch.len().saturating_sub(1);
        if (steps > 0 && !watch.tick(steps, all)) || slot.is_full() {
            stop.store(true, Ordering::Relaxed);
        }
        portion.keep(&mut motions);
        Ok::<_, Infallible>(())
    });
    let small = || {
        let rows = motions.iter().map(Rows::bytes).sum::<usize>();
        run.memory_bytes() <= rows.max(SMALL)
    };
    let wanted = scenario.cases.is_empty() && chosen.is_none() && keep.unwrap_or_else(small);
    let snapshot = match wanted {
        true => run.snapshot().map_err(|error| Failure::Failed(error.to_string()))?,
        false => None,
    };
    let snapshot = snapshot.filter(|_| !matches!(end, RunEnd::Failed { .. }));
    let summaries = run.summaries(end);
    let names = match scenario.cases.as_slice() {
        [] => vec![String::new()],
        cases => cases.iter().map(|case| case.name.clone()).collect(),
    };
    let raised = slot.take().or(watch.into_raised());
    Ok((names, motions.into_iter().zip(summaries).collect(), raised, snapshot))
}

/// The rows as arrays, with the name of their load case and the summary of the run.
fn into_python<'py>(py: Python<'py>, name: String, rows: Rows, summary: RunSummary) -> PyResult<Motion<'py>> {
    let json = serde_json::to_string(&summary.in_short());
    let end = json.map_err(|error| Failure::Failed(error.to_string()))?;
    Ok((name, arrays_of(py, rows)?, end, Record { summary }))
}

/// t, q, p, energy, further columns by name, derivatives of q and p with respect to each parameter, and
/// velocities where the written momenta do not tell them; as many columns as there are, none otherwise.
pub(crate) type Arrays<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyDict>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
);

/// The rows as arrays.
pub(crate) fn arrays_of(py: Python<'_>, rows: Rows) -> PyResult<Arrays<'_>> {
    let Rows { coordinates, time, position, momentum, velocity, energy, columns, of_columns, derivatives } =
        rows;
    let rows = time.len();
    let table = |numbers: Vec<f64>, columns| numbers.into_pyarray(py).reshape([rows, columns]);
    let per_row = derivatives.len().checked_div(rows).unwrap_or(0);
    let (position, momentum) = (table(position, coordinates)?, table(momentum, coordinates)?);
    let derivatives = table(derivatives, per_row)?;
    let of_velocities = velocity.len().checked_div(rows).unwrap_or(0);
    let velocity = table(velocity, of_velocities)?;
    let (time, energy) = (time.into_pyarray(py), energy.into_pyarray(py));
    let by_name = PyDict::new(py);
    for quantity in columns.quantities() {
        let of_rows = of_columns.chunks_exact(columns.len());
        let numbers: Vec<f64> = of_rows.flat_map(|row| quantity.of(row)).collect();
        match quantity.members {
            1 => by_name.set_item(quantity.name, numbers.into_pyarray(py))?,
            members => by_name.set_item(quantity.name, table(numbers, members)?)?,
        }
    }
    Ok((time, position, momentum, energy, by_name, derivatives, velocity))
}

/// The whole summary of a run. Its text is long for many coordinates, and made on demand.
#[pyclass(frozen, module = "fvi._fvi")]
pub(crate) struct Record {
    pub(crate) summary: RunSummary,
}

#[pymethods]
impl Record {
    /// The summary as JSON.
    fn json(&self, py: Python<'_>) -> PyResult<String> {
        let summary = &self.summary;
        let text = py.detach(|| match summary.scenario.equation {
            Some(_) => summary.record().map(|record| record.to_string()),
            None => serde_json::to_string(summary),
        });
        text.map_err(|error| Failure::Failed(error.to_string()).into())
    }
}
