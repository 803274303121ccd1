//! Sweeps: run on threads of this process, or run by run in other processes.

use crate::documents::Source;
use crate::errors::{Failure, Outcome, guarded};
use crate::run::precision as precision_of;
use crate::terms::{Callables, ErrorSlot, PythonTerms};
use crate::watch::Watch;
use fvi_fft::memory::Tables;
use fvi_host::sweep::{
    Column, Ledger as HostLedger, Parts, RemoteRun, Shard, ShardError, Sweep as HostSweep, SweepError,
    SweepOptions, SweepSummary, gather, rows, sweep as make_all,
};
use fvi_scenario::language::InputError;
use fvi_scenario::scenario::SharedTerms;
use fvi_simulation::simulation::Precision;
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};
use std::num::NonZero;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Names and texts of sweep and scenario, the directory of the scenario, and the contents of the files that
/// they name, for sending to other processes.
type PartsInPython = ((String, String), (String, String), String, Vec<(String, Py<PyBytes>)>);

/// A run made elsewhere: its index, its record, and the trajectory file if it is kept.
type MadeElsewhere<'py> = (usize, Bound<'py, PyBytes>, Option<Bound<'py, PyBytes>>);

/// A sweep that has been read and checked.
#[pyclass(frozen, module = "fvi._fvi", name = "Sweep")]
pub(crate) struct Sweep {
    sweep: Arc<HostSweep>,
    precision: Precision,
    /// Tables shared by all runs that this process makes for another one.
    tables: Tables,
    /// The first exception raised by a function of the runs.
    raised: ErrorSlot,
}

/// The failure for an error, without its place where there is no file.
fn unusable(error: &InputError, sources: &[&Source]) -> Failure {
    let in_file = sources.iter().any(|source| match source {
        Source::File(path) => path.display().to_string() == error.file(),
        Source::Keys { .. } => false,
    });
    Failure::of_document(error, in_file)
}

impl From<SweepError> for Failure {
    fn from(error: SweepError) -> Self {
        let of_out = |message: String| Self::Input { key: "out".to_owned(), value: String::new(), message };
        match error {
            SweepError::Input(error) => Self::of_document(&error, true),
            SweepError::File(error) => Self::File(error.to_string()),
            SweepError::OtherSweep { file } => of_out(format!(
                "out: {} holds records of another sweep, or of this one with another scenario, precision or version of fvi; \
                 take another directory, or remove the file to begin anew",
                file.display()
            )),
            error => of_out(format!("out: {error}")),
        }
    }
}

#[pymethods]
impl Sweep {
    /// `scenario` replaces the one that the sweep names; `terms` are added to every run.
    #[new]
    #[pyo3(signature = (source, scenario, precision, terms = None))]
    fn new(
        py: Python<'_>,
        source: Source,
        scenario: Option<Source>,
        precision: &str,
        terms: Option<Callables>,
    ) -> PyResult<Self> {
        let precision = precision_of(precision)?;
        let raised = ErrorSlot::default();
        py.detach(|| {
            guarded(|| {
                let document = source.document().map_err(|error| source.failure(&error))?;
                let sweep = match &scenario {
                    None => HostSweep::from_document(&document).map_err(|error| {
                        Failure::of_document(&error, source.is_file() || error.file() != document.name())
                    }),
                    Some(scenario) => scenario
                        .document()
                        .and_then(|scenario| HostSweep::of_scenario(&document, scenario))
                        .map_err(|error| unusable(&error, &[&source, scenario])),
                };
                let mut sweep = sweep?;
                if let Some(terms) = terms {
                    let (terms, slot) = (Arc::new(terms), raised.clone());
                    sweep = sweep.with_own_terms(move |scenario| {
                        let terms = PythonTerms::new(terms.clone(), scenario.coordinates(), slot.clone());
                        SharedTerms::new(terms)
                    });
                }
                Ok(Self { sweep: Arc::new(sweep), precision, tables: Tables::default(), raised })
            })
        })
    }

    /// The sweep that another process has sent.
    #[staticmethod]
    fn of_parts(py: Python<'_>, parts: PartsInPython, precision: &str) -> PyResult<Self> {
        let precision = precision_of(precision)?;
        let (sweep, scenario, directory, files) = parts;
        let files = files.into_iter().map(|(name, content)| (name, content.as_bytes(py).to_vec())).collect();
        let parts = Parts { sweep, scenario, directory, files };
        py.detach(|| {
            guarded(|| {
                let sweep =
                    HostSweep::of_parts(&parts).map_err(|error| Failure::of_document(&error, true))?;
                let raised = ErrorSlot::default();
                Ok(Self { sweep: Arc::new(sweep), precision, tables: Tables::default(), raised })
            })
        })
    }

    /// The data that another process needs to make runs.
    fn parts(&self, py: Python<'_>) -> PyResult<PartsInPython> {
        let Parts { sweep, scenario, directory, files } =
            py.detach(|| guarded(|| Ok(self.sweep.parts()?)))?;
        let files =
            files.into_iter().map(|(name, content)| (name, PyBytes::new(py, &content).unbind())).collect();
        Ok((sweep, scenario, directory, files))
    }

    #[getter]
    fn fingerprint(&self) -> u32 {
        self.sweep.fingerprint(self.precision)
    }

    #[getter]
    fn keeps_trajectories(&self) -> bool {
        self.sweep.keeps_trajectories()
    }

    fn __len__(&self) -> usize {
        self.sweep.runs()
    }

    /// Makes runs for another process.
    fn make_elsewhere<'py>(
        &self,
        py: Python<'py>,
        runs: Vec<usize>,
        scratch: PathBuf,
    ) -> PyResult<Vec<MadeElsewhere<'py>>> {
        let made = py.detach(|| {
            guarded(|| {
                let stop = AtomicBool::new(false);
                let make = |&run: &usize| {
                    if run >= self.sweep.runs() {
                        return Err(Failure::argument("runs", run, "runs of the sweep"));
                    }
                    Ok(self.sweep.make_elsewhere(run, self.precision, &scratch, &self.tables, &stop)?)
                };
                runs.iter().filter_map(|run| make(run).transpose()).collect::<Outcome<Vec<RemoteRun>>>()
            })
        })?;
        let bytes = |content: Vec<u8>| PyBytes::new(py, &content);
        Ok(made.into_iter().map(|made| (made.run, bytes(made.record), made.trajectory.map(bytes))).collect())
    }

    /// Makes all runs, or those of a shard, on threads of this process.
    fn make<'py>(
        &self,
        py: Python<'py>,
        directory: PathBuf,
        jobs: Option<NonZero<usize>>,
        shard: Option<&str>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<(Bound<'py, PyDict>, Option<PyErr>)> {
        let options = SweepOptions { jobs, ..self.options(directory, shard)? };
        let (summary, raised) = py.detach(|| {
            guarded(|| {
                let stop = AtomicBool::new(false);
                let mut watch = Watch::new(progress);
                let all = options.shard.share(self.sweep.runs());
                let summary = make_all(&self.sweep, &options, &stop, &mut |done| {
                    if !watch.hear(done, all) || self.raised.is_full() {
                        stop.store(true, Ordering::Relaxed);
                    }
                })?;
                Ok((summary, self.raised.take().or(watch.into_raised())))
            })
        })?;
        Ok((told(py, &summary)?, raised))
    }

    /// Joins the shards in a directory.
    fn gather<'py>(&self, py: Python<'py>, directory: PathBuf) -> PyResult<Bound<'py, PyDict>> {
        let options = self.options(directory, None)?;
        let summary = py.detach(|| guarded(|| Ok(gather(&self.sweep, &options)?)))?;
        told(py, &summary)
    }

    /// The rows of the table that exist: of one shard, or of all gathered shards.
    fn rows<'py>(
        &self,
        py: Python<'py>,
        directory: PathBuf,
        shard: Option<&str>,
        gathered: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let options = self.options(directory, shard)?;
        let columns = py.detach(|| guarded(|| Ok(rows(&self.sweep, &options, gathered)?)))?;
        let table = PyDict::new(py);
        for (name, column) in columns {
            match column {
                Column::Whole(numbers) => table.set_item(name, numbers.into_pyarray(py))?,
                Column::Number(numbers) => table.set_item(name, numbers.into_pyarray(py))?,
                Column::Text(texts) => table.set_item(name, PyList::new(py, texts)?)?,
            }
        }
        Ok(table)
    }

    /// Opens the records in a directory, for runs made by other processes.
    fn open(&self, py: Python<'_>, directory: PathBuf, shard: Option<&str>) -> PyResult<Ledger> {
        let options = self.options(directory, shard)?;
        let ledger = py.detach(|| guarded(|| Ok(HostLedger::open(&self.sweep, options)?)))?;
        Ok(Ledger { sweep: self.sweep.clone(), ledger: Mutex::new(Some(ledger)) })
    }
}

impl Sweep {
    fn options(&self, directory: PathBuf, shard: Option<&str>) -> Result<SweepOptions, Failure> {
        let shard = shard.map(str::parse).transpose().map_err(|error: ShardError| Failure::Input {
            key: "shard".to_owned(),
            value: shard.unwrap_or_default().to_owned(),
            message: format!("shard: {error}"),
        })?;
        let (precision, shard) = (self.precision, shard.unwrap_or(Shard::WHOLE));
        Ok(SweepOptions { precision, shard, ..SweepOptions::new(directory) })
    }
}

fn told<'py>(py: Python<'py>, summary: &SweepSummary) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("runs", summary.runs)?;
    dict.set_item("share", summary.share)?;
    dict.set_item("done", summary.done)?;
    dict.set_item("failed", summary.failed)?;
    dict.set_item("files", &summary.files)?;
    Ok(dict)
}

/// The records of a sweep whose runs are made by other processes.
#[pyclass(frozen, module = "fvi._fvi", name = "Ledger")]
pub(crate) struct Ledger {
    sweep: Arc<HostSweep>,
    /// `None` once it is closed.
    ledger: Mutex<Option<HostLedger>>,
}

impl Ledger {
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        call: impl Send + FnOnce(&HostLedger) -> Result<T, SweepError>,
    ) -> PyResult<T> {
        py.detach(|| {
            guarded(|| {
                let ledger = self.ledger.lock().unwrap_or_else(PoisonError::into_inner);
                let ledger = ledger.as_ref().ok_or_else(closed)?;
                Ok(call(ledger)?)
            })
        })
    }
}

fn closed() -> Failure {
    Failure::Failed("the records have been closed".to_owned())
}

#[pymethods]
impl Ledger {
    /// Indices of the runs that are not done.
    fn missing<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<usize>>> {
        Ok(self.with(py, HostLedger::missing)?.into_pyarray(py))
    }

    /// Number of runs of the shard.
    #[getter]
    fn share(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |ledger| Ok(ledger.share()))
    }

    /// Stores the record of a run; false if it does not belong to the sweep or was damaged in transmission.
    fn take(&self, py: Python<'_>, run: usize, record: &[u8], trajectory: Option<&[u8]>) -> PyResult<bool> {
        let made = RemoteRun { run, record: record.to_vec(), trajectory: trajectory.map(<[u8]>::to_vec) };
        self.with(py, |ledger| ledger.take(&self.sweep, &made))
    }

    /// Closes the records, and writes the table if all runs are there.
    fn finish<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let summary = py.detach(|| {
            guarded(|| {
                let ledger = self.ledger.lock().unwrap_or_else(PoisonError::into_inner).take();
                Ok(ledger.ok_or_else(closed)?.finish(&self.sweep)?)
            })
        })?;
        told(py, &summary)
    }

    /// Closes the records as they are.
    fn close(&self) {
        drop(self.ledger.lock().unwrap_or_else(PoisonError::into_inner).take());
    }
}

/// Facts of the machine on which the last bits of runs depend.
#[pyfunction]
pub(crate) fn vector_units() -> &'static str {
    fvi_fft::vector_units()
}
