//! Many runs of one scenario with other numbers.

use crate::documents::Source;
use crate::errors::{Failure, Outcome, guarded};
use crate::run::{Arrays, Prepared, Record, arrays_of, precision as precision_of, read_knowing};
use crate::terms::{Callables, ErrorSlot, Functions};
use crate::watch::Watch;
use fvi_host::batch::{Batch as HostBatch, MemberRun};
use fvi_host::results::rows::Rows;
use fvi_host::run::RunEnd;
use fvi_scenario::language::memory_limit::check_capacity;
use fvi_scenario::scenario::Members;
use fvi_simulation::simulation::columns::Columns;
use fvi_simulation::simulation::events::EventRecord;
use fvi_simulation::simulation::velocities_need_all_momenta;
use numpy::{IntoPyArray, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::num::NonZero;
use std::sync::atomic::{AtomicBool, Ordering};

/// A scenario with numbers that differ from run to run, read and compiled once.
#[pyclass(frozen, module = "fvi._fvi")]
pub(crate) struct Batch {
    batch: HostBatch,
    in_file: bool,
    /// True if runs call functions of Python, one run at a time.
    in_code: bool,
    slot: ErrorSlot,
}

/// A run: its arrays, how it ended as JSON, its summary, and the exception that stopped it.
type One<'py> = (Arrays<'py>, String, Record, Option<PyErr>);

#[pymethods]
impl Batch {
    #[new]
    fn new(
        source: Source,
        paths: Vec<String>,
        precision: &str,
        prepared: &Prepared,
        terms: Option<Callables>,
        events: Vec<Option<Py<PyAny>>>,
    ) -> PyResult<Self> {
        let precision = precision_of(precision)?;
        let slot = ErrorSlot::default();
        let functions = Functions { terms, events };
        let in_code = functions.need_interpreter();
        guarded(|| {
            let scenario = read_knowing(&source, None, Some(&prepared.matrices))?;
            let scenario = functions.put_into(scenario, &slot, (true, false))?;
            let failure = |error| source.failure(&error);
            let members = Members::new(scenario, paths.iter().map(String::as_str)).map_err(failure)?;
            let batch = HostBatch::new(members, precision, prepared.tables.clone()).map_err(failure)?;
            Ok(Self { batch, in_file: source.is_file(), in_code, slot })
        })
    }

    /// What velocities and accelerations follow from in the run with these numbers, as JSON, and its title:
    /// scheme and times; `with_mass` the mass, with that of the fluid about bodies, or a kinetic energy with
    /// its parameters and constraints.
    fn described(&self, py: Python<'_>, numbers: Vec<f64>, with_mass: bool) -> PyResult<String> {
        py.detach(|| {
            guarded(|| {
                let scenario = self.batch.members().member(&numbers);
                let scenario = scenario.map_err(|error| Failure::of_document(&error, self.in_file))?;
                let failed = |error: serde_json::Error| Failure::Failed(error.to_string());
                let mut described = serde_json::json!({
                    "title": scenario.title,
                    "scheme": scenario.scheme,
                    "time": scenario.time,
                    "output": { "times": scenario.output.times },
                });
                if with_mass {
                    let mut system = serde_json::to_value(&scenario.system).map_err(failed)?;
                    if let Some(system) = system.as_object_mut() {
                        system.retain(|key, _| {
                            ["mass", "kinetic", "parameters", "constraints"].contains(&key.as_str())
                        });
                    }
                    described["system"] = system;
                }
                serde_json::to_string(&described).map_err(failed)
            })
        })
    }

    /// The run with these numbers.
    fn run_one<'py>(&self, py: Python<'py>, numbers: Vec<f64>) -> PyResult<One<'py>> {
        let run = || {
            guarded(|| {
                let mut watch = Watch::new(None);
                let stop = AtomicBool::new(false);
                let run = self.batch.run_one(&numbers, &stop, &mut |batch| {
                    let steps = batch.first() + batch.len().saturating_sub(1);
                    if (steps > 0 && !watch.tick(steps, None)) || self.slot.is_full() {
                        stop.store(true, Ordering::Relaxed);
                    }
                });
                let raised = self.slot.take().or(watch.into_raised());
                match (run, raised) {
                    (Ok((rows, summary)), raised) => Ok((rows, summary, raised)),
                    (Err(_), Some(raised)) => Err(Failure::Raised(raised)),
                    (Err(error), None) => Err(Failure::of_document(&error, self.in_file)),
                }
            })
        };
        let (rows, summary, raised) = if self.in_code { run() } else { py.detach(run) }?;
        let end = serde_json::to_string(&summary.in_short());
        let end = end.map_err(|error| Failure::Failed(error.to_string()))?;
        Ok((arrays_of(py, rows)?, end, Record { summary }, raised))
    }

    /// The runs with the numbers of each row, as a dictionary of arrays over the runs, and the exception that
    /// stopped them.
    fn run<'py>(
        &self,
        py: Python<'py>,
        numbers: PyReadonlyArray2<'py, f64>,
        jobs: Option<NonZero<usize>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<(Bound<'py, PyDict>, Option<PyErr>)> {
        let count = numbers.as_array().nrows();
        let numbers = numbers.as_array().iter().copied().collect::<Vec<f64>>();
        let run = || {
            guarded(|| {
                self.check_capacity(count)?;
                let (mut watch, stop) = (Watch::new(progress), AtomicBool::new(false));
                let jobs = if self.in_code { NonZero::new(1) } else { jobs };
                let runs = self.batch.run(&numbers, jobs, &stop, &mut |done| {
                    if !watch.hear(done, count) || self.slot.is_full() {
                        stop.store(true, Ordering::Relaxed);
                    }
                });
                let failure = |error| Failure::of_document(&error, self.in_file);
                let runs: Vec<Outcome<MemberRun>> =
                    runs.into_iter().map(|run| run.map_err(failure)).collect();
                let table = Table::of(&runs);
                Ok((runs, table, self.slot.take().or(watch.into_raised())))
            })
        };
        let (runs, table, raised) = if self.in_code { run() } else { py.detach(run) }?;
        Ok((table.into_python(py, runs)?, raised))
    }
}

impl Batch {
    /// Refuses more rows than there is memory for: those of the runs, and the arrays of all.
    fn check_capacity(&self, count: usize) -> Outcome<()> {
        let scenario = self.batch.members().base();
        let vectors = if velocities_need_all_momenta(scenario) { 3 } else { 2 };
        let width = 2 + vectors * scenario.written_coordinates().len() + Columns::of(scenario).len();
        let rows = Rows::expected(scenario);
        let bytes = [2, count, rows, width, size_of::<f64>()].into_iter().fold(1, usize::saturating_mul);
        check_capacity(bytes).map_err(|error| {
            Failure::NoRoom(format!(
                "{count} runs of {rows} rows: {error}; write fewer rows with `every`, or make fewer runs at a time"
            ))
        })
    }
}

/// The rows of all runs, each as long as the longest, with NaN behind the end of a run.
struct Table {
    runs: usize,
    rows: usize,
    coordinates: usize,
    columns: Columns,
    per_row: usize,
    /// The times of the longest run, if those of all others are its first ones; those of each run otherwise.
    time: Vec<f64>,
    position: Vec<f64>,
    momentum: Vec<f64>,
    /// Where momenta do not tell it.
    velocity: Option<Vec<f64>>,
    energy: Vec<f64>,
    of_columns: Vec<f64>,
    derivatives: Vec<f64>,
}

impl Table {
    fn of(runs: &[Outcome<MemberRun>]) -> Self {
        let made = || runs.iter().filter_map(|run| run.as_ref().ok()).filter(|run| !run.rows.is_empty());
        let longest = made().max_by_key(|run| run.rows.len()).map(|run| &run.rows);
        let rows = longest.map_or(0, Rows::len);
        let (coordinates, columns) =
            longest.map_or_else(|| (0, Columns::default()), |rows| (rows.coordinates, rows.columns.clone()));
        let per_row = longest.map_or(0, |rows| rows.derivatives.len() / rows.len().max(1));
        let common = longest
            .map(|rows| &rows.time)
            .filter(|longest| made().all(|run| longest.starts_with(&run.rows.time)));
        let spread = |part: fn(&Rows) -> &[f64], width: usize| {
            let mut all = vec![f64::NAN; runs.len() * rows * width];
            for (run, place) in runs.iter().zip(all.chunks_mut((rows * width).max(1))) {
                let given = run.as_ref().map_or(&[][..], |run| part(&run.rows));
                place.iter_mut().zip(given).for_each(|(place, &number)| *place = number);
            }
            all
        };
        Self {
            runs: runs.len(),
            rows,
            coordinates,
            per_row,
            time: common.map_or_else(|| spread(|rows| &rows.time, 1), Clone::clone),
            position: spread(|rows| &rows.position, coordinates),
            momentum: spread(|rows| &rows.momentum, coordinates),
            velocity: longest
                .is_some_and(|rows| !rows.velocity.is_empty())
                .then(|| spread(|rows| &rows.velocity, coordinates)),
            energy: spread(|rows| &rows.energy, 1),
            of_columns: spread(|rows| &rows.of_columns, columns.len()),
            derivatives: spread(|rows| &rows.derivatives, per_row),
            columns,
        }
    }

    fn into_python<'py>(
        self,
        py: Python<'py>,
        runs: Vec<Outcome<MemberRun>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (count, rows, width) = (self.runs, self.rows, self.coordinates);
        let array = |numbers: Vec<f64>, shape: &[usize]| -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
            numbers.into_pyarray(py).reshape(shape.to_vec())
        };
        let table = PyDict::new(py);
        let time: &[usize] = if self.time.len() == rows { &[rows] } else { &[count, rows] };
        table.set_item("t", array(self.time, time)?)?;
        table.set_item("q", array(self.position, &[count, rows, width])?)?;
        table.set_item("p", array(self.momentum, &[count, rows, width])?)?;
        let velocity = self.velocity.map(|numbers| array(numbers, &[count, rows, width])).transpose()?;
        table.set_item("v", velocity)?;
        table.set_item("energy", array(self.energy, &[count, rows])?)?;
        table.set_item("derivatives", array(self.derivatives, &[count, rows, self.per_row])?)?;
        let columns = PyDict::new(py);
        for quantity in self.columns.quantities() {
            let of_rows = self.of_columns.chunks_exact(self.columns.len());
            let numbers: Vec<f64> = of_rows.flat_map(|row| quantity.of(row)).collect();
            let shape: &[usize] = match quantity.members {
                1 => &[count, rows],
                members => &[count, rows, members],
            };
            columns.set_item(quantity.name, array(numbers, shape)?)?;
        }
        table.set_item("columns", columns)?;
        let of = |part: fn(&MemberRun) -> usize| -> Bound<'py, PyArray1<i64>> {
            let numbers = runs.iter().map(|run| run.as_ref().map_or(0, |run| part(run) as i64));
            numbers.collect::<Vec<_>>().into_pyarray(py)
        };
        table.set_item("rows", of(|run| run.rows.len()))?;
        table.set_item("steps", of(|run| run.steps))?;
        let (ends, events, warnings) = (PyList::empty(py), PyDict::new(py), PyDict::new(py));
        for (index, run) in runs.into_iter().enumerate() {
            match run {
                Ok(run) => {
                    let happened = run.events.iter().map(|event| event_of(py, event));
                    if !run.events.is_empty() {
                        events.set_item(index, happened.collect::<PyResult<Vec<_>>>()?)?;
                    }
                    if !run.warnings.is_empty() {
                        warnings.set_item(index, &run.warnings)?;
                    }
                    ends.append(end_of(py, &run)?)?;
                }
                Err(failure) => ends.append(PyErr::from(failure).into_value(py))?,
            }
        }
        table.set_item("ends", ends)?;
        table.set_item("events", events)?;
        table.set_item("warnings", warnings)?;
        Ok(table)
    }
}

/// How a run ended; `None`: all steps were made.
fn end_of<'py>(py: Python<'py>, run: &MemberRun) -> PyResult<Option<Bound<'py, PyDict>>> {
    let end = PyDict::new(py);
    match &run.end {
        RunEnd::Completed => return Ok(None),
        RunEnd::Event { event, time } => {
            end.set_item("status", "event")?;
            end.set_item("event", event)?;
            end.set_item("time", time)?;
        }
        RunEnd::Stopped => end.set_item("status", "stopped")?,
        RunEnd::Failed { step, time, reason } => {
            end.set_item("status", "failed")?;
            end.set_item("step", step)?;
            end.set_item("time", time)?;
            end.set_item("reason", reason)?;
        }
    }
    Ok(Some(end))
}

fn event_of<'py>(py: Python<'py>, happened: &EventRecord) -> PyResult<Bound<'py, PyDict>> {
    let event = PyDict::new(py);
    event.set_item("event", happened.event)?;
    event.set_item("rising", happened.rising)?;
    event.set_item("time", happened.time)?;
    event.set_item("position", &happened.position)?;
    event.set_item("momentum", &happened.momentum)?;
    event.set_item("energy", happened.energy)?;
    Ok(event)
}
