//! Runs of a sweep made by other processes, possibly without access to the same files: the data sent to them,
//! and the results that they return.

use super::records::{Record, Records};
use super::{Sweep, SweepError, SweepOptions, SweepSummary, conclude, failures};
use crate::results::files::{self, FileError};
use crate::results::output_directory::OutputDirectory;
use crate::run::Last;
use fvi_fft::memory::Tables;
use fvi_scenario::language::{Document, InputError};
use fvi_simulation::simulation::Precision;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// A sweep with the contents of all files that it reads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parts {
    /// Name and text of the sweep.
    pub sweep: (String, String),
    /// Name and text of its scenario.
    pub scenario: (String, String),
    /// Directory of the scenario on the sending machine, which is part of the file names in the records.
    pub directory: String,
    /// The files that its scenarios name, by these names.
    pub files: Vec<(String, Vec<u8>)>,
}

/// Result of a run made by another process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RemoteRun {
    /// Index of the run in the sweep.
    pub run: usize,
    /// Its record, with a checksum.
    pub record: Vec<u8>,
    /// The file of its trajectory, if the sweep keeps them.
    pub trajectory: Option<Vec<u8>>,
}

impl Sweep {
    /// The data that another process needs to make runs.
    ///
    /// # Errors
    /// If a file that the scenario names cannot be read any more.
    pub fn parts(&self) -> Result<Parts, SweepError> {
        let named = |document: &Document| (document.name().to_owned(), document.text().to_owned());
        let scenario = self.base().document();
        let files = scenario.files_among(self.texts()).map_err(FileError::at(Path::new(scenario.name())))?;
        let directory = scenario.resolve("").display().to_string();
        Ok(Parts { sweep: named(self.document()), scenario: named(scenario), directory, files })
    }

    /// The sweep that was sent.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn of_parts(parts: &Parts) -> Result<Self, InputError> {
        let document = |(name, text): &(String, String), directory: &str| {
            Document::new(name, Path::new(directory), text)
        };
        let mut scenario = document(&parts.scenario, &parts.directory);
        for (name, content) in &parts.files {
            scenario = scenario.with_attached(name, content.as_slice());
        }
        Self::of_scenario(&document(&parts.sweep, ""), scenario)
    }

    /// Checksum of sweep, precision and version of fvi: runs with the same value belong to one table.
    pub fn fingerprint(&self, precision: Precision) -> u32 {
        crc32fast::hash(&self.identity(precision))
    }

    /// Makes one run, whose result is to be sent back; `scratch` is a directory for temporary files, `tables`
    /// are shared with the other runs of this process. `None` if it was stopped.
    ///
    /// # Errors
    /// If `scratch` cannot be written to; a failing run is not an error.
    pub fn make_elsewhere(
        &self,
        run: usize,
        precision: Precision,
        scratch: &Path,
        tables: &Tables,
        stop: &AtomicBool,
    ) -> Result<Option<RemoteRun>, SweepError> {
        let options = SweepOptions { precision, ..SweepOptions::new(scratch) };
        let Some(record) = self.make(run, &mut Last::default(), &options, tables, stop)? else {
            return Ok(None);
        };
        let trajectory = match self.trajectory_of(run, scratch) {
            // A refused run has no trajectory.
            Some(path) if path.is_file() => {
                let content = fs::read(&path).and_then(|content| fs::remove_file(&path).map(|()| content));
                Some(content.map_err(FileError::at(&path))?)
            }
            _ => None,
        };
        Ok(Some(RemoteRun { run, record: record.encode(self.layout()), trajectory }))
    }
}

/// The records of a sweep whose runs are made by other processes.
pub struct Ledger {
    records: Records,
    options: SweepOptions,
}

impl Ledger {
    /// Opens the records in a directory and locks them against other processes.
    ///
    /// # Errors
    /// As [`sweep`](super::sweep).
    pub fn open(sweep: &Sweep, options: SweepOptions) -> Result<Self, SweepError> {
        OutputDirectory::make(&options.directory)?;
        let identity = sweep.identity(options.precision);
        let records = Records::open(&options.directory, &identity, sweep.layout(), options.shard)?;
        Ok(Self { records, options })
    }

    /// Number of runs in this share of the sweep.
    pub fn share(&self) -> usize {
        self.records.share()
    }

    /// The runs that are not done yet.
    ///
    /// # Errors
    /// If the records cannot be read.
    pub fn missing(&self) -> Result<Vec<usize>, SweepError> {
        let mut missing = Vec::new();
        for place in 0..self.records.share() {
            if self.records.read(place)?.is_none() {
                missing.push(self.records.run(place));
            }
        }
        Ok(missing)
    }

    /// Stores the result of a run; storing it again changes nothing. Returns `false` if it does not belong to
    /// this sweep, or was damaged in transmission.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn take(&self, sweep: &Sweep, made: &RemoteRun) -> Result<bool, SweepError> {
        let place = self.records.place(made.run);
        let record = Record::decode(&made.record, sweep.layout());
        let (Some(place), Some(record)) = (place, record) else { return Ok(false) };
        if let (Some(path), Some(content)) =
            (sweep.trajectory_of(made.run, &self.options.directory), &made.trajectory)
        {
            let parent = path.parent().unwrap_or(&self.options.directory);
            fs::create_dir_all(parent).map_err(FileError::at(parent))?;
            files::write(&path, |file| file.write_all(content))?;
        }
        self.records.write(place, &record)?;
        Ok(true)
    }

    /// Writes the table, if all runs are done.
    ///
    /// # Errors
    /// As [`sweep`](super::sweep).
    pub fn finish(self, sweep: &Sweep) -> Result<SweepSummary, SweepError> {
        self.records.flush()?;
        let (share, done) = (self.records.share(), self.records.done()?);
        let options = &self.options;
        let whole = options.shard == super::Shard::WHOLE;
        let failed = failures(&options.directory, &sweep.identity(options.precision), sweep, options.shard)?;
        let files =
            if whole && done == share { conclude(sweep, options, &[self.records])? } else { Vec::new() };
        Ok(SweepSummary { runs: sweep.runs(), share, done, failed, files })
    }
}
