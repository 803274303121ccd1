//! Sweeps: one scenario with many values of some of its keys, run on all cores, on several machines, and
//! resumable at any time.
//!
//! Every run has a place of fixed size in a file of records, `sweep.fvi`, or `sweep.shard-1-of-8.fvi` where
//! several processes share the runs. The process that ends a sweep reads the records in the order of the
//! runs, so that the table has the same bytes however many threads and processes filled them, and however
//! often these were interrupted.

mod axis;
mod keep;
mod measured;
#[cfg(feature = "pictures")]
mod pictures;
mod plan;
mod points;
mod records;
mod remote;
mod table;

pub use plan::Sweep;
pub use records::{Shard, ShardError};
pub use remote::{Ledger, Parts, RemoteRun};
pub use table::Column;

use crate::results::files::FileError;
use crate::results::output_directory::OutputDirectory;
use crate::results::trajectory::TrajectoryWriter;
use crate::run::{Last, Run, RunEnd};
use fvi_fft::memory::Tables;
use fvi_scenario::language::InputError;
use fvi_scenario::scenario::{Feature, Scenario};
use fvi_simulation::simulation::columns::Columns;
use fvi_simulation::simulation::{Precision, Simulation};
use measured::Measured;
use records::{Record, Records, Status};
use serde::Serialize;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

/// Longest time between two flushes of the records to the disk.
const FLUSH: Duration = Duration::from_secs(5);

/// How a sweep is made.
#[derive(Clone, Debug)]
pub struct SweepOptions {
    /// Output directory.
    pub directory: PathBuf,
    /// Floating-point precision.
    pub precision: Precision,
    /// Number of threads; `None`: one for each core.
    pub jobs: Option<NonZero<usize>>,
    /// The runs that this process makes.
    pub shard: Shard,
}

impl SweepOptions {
    /// All runs in double precision, on all cores.
    pub fn new(directory: impl Into<PathBuf>) -> Self {
        let precision = Precision::default();
        Self { directory: directory.into(), precision, jobs: None, shard: Shard::WHOLE }
    }
}

/// Outcome of a sweep.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SweepSummary {
    /// Runs of the sweep.
    pub runs: usize,
    /// Number of runs in this process's share.
    pub share: usize,
    /// Number of runs of this share that are done, now or earlier.
    pub done: usize,
    /// Number of runs of this share that failed.
    pub failed: usize,
    /// The files of the table and its pictures, if the sweep is complete.
    pub files: Vec<String>,
}

/// Why a sweep could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SweepError {
    /// The sweep file, or its scenario, cannot be used.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A file cannot be written or read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The records in the directory are of another sweep.
    #[error(
        "{} holds records of another sweep, or of this one with another scenario, precision or version of fvi: take another \
         directory with `--out`, or remove the file to begin anew", .file.display()
    )]
    OtherSweep {
        /// The file of records.
        file: PathBuf,
    },
    /// Another process holds the file of records.
    #[error("{}: another process is at work on these runs", .file.display())]
    InUse {
        /// The file of records.
        file: PathBuf,
    },
    /// Shards overlap, or some are missing.
    #[error("{}: {}", .directory.display(), .reasons.join("; "))]
    Incomplete {
        /// The directory.
        directory: PathBuf,
        /// Shards that are missing or present twice.
        reasons: Vec<String>,
    },
}

/// Makes the runs of a sweep that have not been made yet, and the table once all are there.
///
/// `stop` ends it; runs that have not finished by then are made again the next time. `progress` receives the
/// number of runs that are done, at least ten times a second, so that it can also set `stop`.
///
/// # Errors
/// [`SweepError`]; a failing run is not an error but a row of the table.
pub fn sweep(
    sweep: &Sweep,
    options: &SweepOptions,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize),
) -> Result<SweepSummary, SweepError> {
    OutputDirectory::make(&options.directory)?;
    let identity = sweep.identity(options.precision);
    let records = Records::open(&options.directory, &identity, sweep.layout(), options.shard)?;
    let (share, mut done) = (records.share(), records.done()?);
    progress(done);
    let jobs = options.jobs.or_else(|| std::thread::available_parallelism().ok()).map_or(1, NonZero::get);
    let (next, tables) = (Mutex::new(0..share), Tables::default());
    let (made, failure) = (AtomicUsize::new(done), Mutex::new(None));
    let (sender, news) = mpsc::sync_channel(1);
    std::thread::scope(|scope| {
        for _ in 0..jobs.min(share.max(1)) {
            let (sender, next, records, tables) = (sender.clone(), &next, &records, &tables);
            let (made, failure) = (&made, &failure);
            let work = move || {
                let mut last = Last::default();
                while !stop.load(Ordering::Relaxed) {
                    let place = next.lock().ok().and_then(|mut places| places.next());
                    let Some(place) = place else { break };
                    if records.read(place)?.is_some() {
                        continue;
                    }
                    let run = records.run(place);
                    let Some(record) = sweep.make(run, &mut last, options, tables, stop)? else { break };
                    records.write(place, &record)?;
                    made.fetch_add(1, Ordering::Relaxed);
                    // If `progress` is still busy, this notification is dropped.
                    let _ = sender.try_send(());
                }
                Ok::<_, SweepError>(())
            };
            scope.spawn(move || {
                let Err(error) = work() else { return };
                // No further run is started; those in progress see `stop` themselves.
                if let Ok(mut places) = next.lock() {
                    *places = 0..0;
                }
                failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
            });
        }
        drop(sender);
        let mut flushed = Instant::now();
        while news.recv_timeout(Duration::from_millis(50)) != Err(mpsc::RecvTimeoutError::Disconnected) {
            progress(made.load(Ordering::Relaxed));
            if flushed.elapsed() > FLUSH {
                // An error here occurs again below.
                let _ = records.flush();
                flushed = Instant::now();
            }
        }
    });
    done = made.into_inner();
    progress(done);
    records.flush()?;
    if let Some(error) = failure.into_inner().unwrap_or_else(PoisonError::into_inner) {
        return Err(error);
    }
    let complete = done == share && options.shard == Shard::WHOLE;
    let files = if complete { conclude(sweep, options, &[records])? } else { Vec::new() };
    let failed = failures(&options.directory, &identity, sweep, options.shard)?;
    Ok(SweepSummary { runs: sweep.runs(), share, done, failed, files })
}

/// The rows of the table that exist so far: those of the shard, or with `gathered` all rows of a directory
/// whose shards are complete.
///
/// # Errors
/// As [`gather`].
pub fn rows(
    sweep: &Sweep,
    options: &SweepOptions,
    gathered: bool,
) -> Result<Vec<(String, Column)>, SweepError> {
    let identity = sweep.identity(options.precision);
    let shards = if gathered {
        Records::all(&options.directory, &identity, sweep.layout())?
    } else {
        vec![Records::look(&options.directory, &identity, sweep.layout(), options.shard)?]
    };
    Ok(table::rows(sweep, &shards)?)
}

fn failures(directory: &Path, identity: &[u8], sweep: &Sweep, shard: Shard) -> Result<usize, SweepError> {
    let records = Records::look(directory, identity, sweep.layout(), shard)?;
    let mut failed = 0;
    for place in 0..records.share() {
        failed += usize::from(records.read(place)?.is_some_and(|record| record.status != Status::Completed));
    }
    Ok(failed)
}

/// Joins the shards in a directory to the table.
///
/// # Errors
/// [`SweepError::Incomplete`] with the shards that are missing, unfinished or overlapping; and the other
/// variants.
pub fn gather(sweep: &Sweep, options: &SweepOptions) -> Result<SweepSummary, SweepError> {
    let identity = sweep.identity(options.precision);
    let shards = Records::all(&options.directory, &identity, sweep.layout())?;
    let files = conclude(sweep, options, &shards)?;
    let mut failed = 0;
    for records in &shards {
        for place in 0..records.share() {
            failed +=
                usize::from(records.read(place)?.is_some_and(|record| record.status != Status::Completed));
        }
    }
    let runs = sweep.runs();
    Ok(SweepSummary { runs, share: runs, done: runs, failed, files })
}

/// Writes the table and its pictures.
fn conclude(sweep: &Sweep, options: &SweepOptions, shards: &[Records]) -> Result<Vec<String>, SweepError> {
    let directory = OutputDirectory::claim(&options.directory)?;
    let mut files = table::write(sweep, shards, &directory)?;
    #[cfg(feature = "pictures")]
    files.extend(pictures::write(sweep, shards, &directory)?);
    if sweep.keeps_trajectories() {
        files.push("runs".to_owned());
    }
    Ok(files)
}

impl Sweep {
    /// Makes one run; `None` if it was stopped.
    fn make(
        &self,
        run: usize,
        last: &mut Last,
        options: &SweepOptions,
        tables: &Tables,
        stop: &AtomicBool,
    ) -> Result<Option<Record>, SweepError> {
        let columns = self.layout().columns;
        let refused = |error: InputError| {
            let key = if error.key().is_empty() { String::new() } else { format!("{}: ", error.key()) };
            let advice = error.problem().allowed().map_or_else(String::new, |allowed| format!("; {allowed}"));
            let message = format!("{key}{}{advice}", error.problem());
            Record { status: Status::Refused, steps: 0, values: vec![f64::NAN; columns], message }
        };
        let Last { member, simulation } = last;
        let (read, mut none);
        let (scenario, ended) = match self.put_member(run, member) {
            Some(member) => (member, simulation),
            None => {
                read = match self.read_scenario_of(run) {
                    Ok(scenario) => scenario,
                    Err(error) => return Ok(Some(refused(error))),
                };
                none = None;
                (&read, &mut none)
            }
        };
        if scenario.coordinates() != self.base().coordinates() {
            let message = format!(
                "{} coordinates where the scenario itself has {}",
                scenario.coordinates(),
                self.base().coordinates()
            );
            let values = vec![f64::NAN; columns];
            return Ok(Some(Record { status: Status::Refused, steps: 0, values, message }));
        }
        let mut under_way = match begin(scenario, ended, options.precision, tables) {
            Ok(under_way) => under_way,
            Err(error) => {
                // In the words of the run's own file.
                let read = self.read_scenario_of(run);
                let again =
                    read.and_then(|read| begin(&read, &mut None, options.precision, tables).map(drop));
                return Ok(Some(refused(again.err().unwrap_or(error))));
            }
        };
        let mut writer = match self.trajectory_of(run, &options.directory) {
            Some(path) => {
                let writing = FileError::at(&path);
                let parent = path.parent().unwrap_or(&options.directory);
                std::fs::create_dir_all(parent).map_err(&writing)?;
                let (coordinates, columns) = (scenario.written_coordinates().len(), Columns::of(scenario));
                Some(TrajectoryWriter::npz(&path, coordinates, &columns).map_err(&writing)?)
            }
            None => None,
        };
        let mut measured = Measured::new(scenario, self.settled());
        let end = under_way.drive(stop, |portion| {
            measured.take(portion.batch());
            match &mut writer {
                Some(writer) => portion.rows(|_, row| writer.push(row)),
                None => Ok(()),
            }
        });
        let path = || self.trajectory_of(run, &options.directory).unwrap_or_default();
        let end = end.map_err(|error| FileError::at(&path())(error))?;
        let (summary, simulation) = under_way.into_parts(end);
        *ended = self.runs_differ_in_start_and_parameters().then_some(simulation);
        let (status, message) = match &summary.end {
            RunEnd::Stopped => return Ok(None),
            RunEnd::Completed | RunEnd::Event { .. } => (Status::Completed, String::new()),
            RunEnd::Failed { step, time, reason } => {
                (Status::Failed, format!("step {step}, from t = {time}: {reason}"))
            }
        };
        if let Some(writer) = writer {
            writer.finish(&summary.last).map_err(|error| FileError::at(&path())(error))?;
        }
        let values = self.quantities().values(scenario, &summary, &measured);
        Ok(Some(Record { status, steps: summary.steps as u64, values, message }))
    }
}

/// The run of a scenario, which has no load cases.
fn begin<'s>(
    scenario: &'s Scenario,
    ended: &mut Option<Simulation>,
    precision: Precision,
    tables: &Tables,
) -> Result<Run<'s>, InputError> {
    scenario.check_use(Feature::OneMotion)?;
    Run::of(scenario).precision(precision).tables(tables).start_with(ended)
}
