//! Where a motion goes: its trajectory, the traces of its pictures and its snapshots, in a directory of its own where there are load
//! cases.

use crate::lab::checkpoint::case_directories;
#[cfg(feature = "pictures")]
use crate::results::files::write_text;
use crate::results::files::{FileError, remove};
#[cfg(feature = "pictures")]
use crate::results::picture::Map;
use crate::results::run_traces::RunTraces;
use crate::results::snapshots::Snapshots;
use crate::results::trajectory::{Format, TrajectoryMark, TrajectoryWriter};
use crate::scenario::Scenario;
use crate::simulation::GridState;
use std::path::{Path, PathBuf};

/// Whole states, and the picture of them.
const SNAPSHOTS: &str = "snapshots.npz";
const MAP: &str = "map.svg";

/// One motion of a run at a grid point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View<'a> {
    pub(crate) time: f64,
    pub(crate) position: &'a [f64],
    pub(crate) momentum: &'a [f64],
    pub(crate) energy: f64,
}

impl View<'_> {
    /// As far as it is written and drawn.
    pub(crate) fn shown(&self, scenario: &Scenario) -> GridState {
        let of = |numbers: &[f64]| match &scenario.output.coordinates {
            Some(chosen) => chosen.iter().filter_map(|&index| numbers.get(index).copied()).collect(),
            None => numbers.to_vec(),
        };
        let (position, momentum) = (of(self.position), of(self.momentum));
        GridState { time: self.time, position, momentum, energy: self.energy }
    }
}

impl<'a> From<&'a GridState> for View<'a> {
    fn from(state: &'a GridState) -> Self {
        let GridState { time, position, momentum, energy } = state;
        Self { time: *time, position, momentum, energy: *energy }
    }
}

/// The files of one motion.
pub(crate) struct Outlet {
    directory: PathBuf,
    writer: TrajectoryWriter,
    traces: RunTraces,
    snapshots: Option<Snapshots>,
}

impl Outlet {
    /// Those of a run that begins.
    ///
    /// # Errors
    /// If a file cannot be made.
    pub(crate) fn open_all(
        scenario: &Scenario,
        directory: &Path,
        format: Format,
    ) -> Result<Vec<Self>, FileError> {
        let chosen = scenario.written_coordinates();
        let open = |directory: PathBuf| {
            let path = directory.join(format.file());
            std::fs::create_dir_all(&directory).map_err(FileError::at(&directory))?;
            let writer = TrajectoryWriter::create(&directory, format, &chosen, scenario.output.every)
                .map_err(FileError::at(&path))?;
            Ok(Self::with(scenario, directory, writer, RunTraces::new(chosen.len())))
        };
        Self::directories(scenario, directory).into_iter().map(open).collect()
    }

    /// Those of a run that goes on with grid point `index`.
    ///
    /// # Errors
    /// If what was marked is no longer there.
    pub(crate) fn resume_all(
        scenario: &Scenario,
        directory: &Path,
        marks: &[TrajectoryMark],
        traces: Vec<RunTraces>,
        index: usize,
    ) -> Result<Vec<Self>, FileError> {
        let (count, every) = (scenario.written_coordinates().len(), scenario.output.every);
        let directories = Self::directories(scenario, directory).into_iter();
        let resume = |((directory, mark), traces): ((PathBuf, &TrajectoryMark), RunTraces)| {
            let path = directory.join(mark.format.file());
            let writer = TrajectoryWriter::resume(&directory, mark, count, every, index)
                .map_err(FileError::at(&path))?;
            Ok(Self::with(scenario, directory, writer, traces))
        };
        directories.zip(marks).zip(traces).map(resume).collect()
    }

    fn directories(scenario: &Scenario, directory: &Path) -> Vec<PathBuf> {
        case_directories(directory, scenario.cases.iter().map(|case| case.name.as_str()))
    }

    fn with(scenario: &Scenario, directory: PathBuf, writer: TrajectoryWriter, traces: RunTraces) -> Self {
        let snapshots = scenario.output.snapshots.map(|every| Snapshots::new(every, scenario.coordinates()));
        Self { directory, writer, traces, snapshots }
    }

    /// Takes the state after a number of steps, and those between it and the one before that were asked for.
    ///
    /// # Errors
    /// If a row cannot be written.
    pub(crate) fn take(
        &mut self,
        scenario: &Scenario,
        steps: usize,
        between: &[GridState],
        state: &View<'_>,
    ) -> Result<(), FileError> {
        let path = self.directory.join(self.writer.format().file());
        let shown = state.shown(scenario);
        if scenario.output.times.is_empty() {
            self.writer.push(&shown).map_err(FileError::at(&path))?;
        }
        for row in between {
            self.writer.push(&View::from(row).shown(scenario)).map_err(FileError::at(&path))?;
        }
        self.traces.take(&shown);
        if let Some(snapshots) = &mut self.snapshots {
            snapshots.take(steps, state.time, state.position, state.momentum);
        }
        Ok(())
    }

    /// How far the trajectory has got.
    ///
    /// # Errors
    /// If its rows cannot be written.
    pub(crate) fn mark(&mut self) -> Result<TrajectoryMark, FileError> {
        let path = self.directory.join(self.writer.format().file());
        self.writer.mark().map_err(FileError::at(&path))
    }

    /// Has the rows kept for a run that goes on.
    pub(crate) fn keep(&mut self) {
        self.writer.keep();
    }

    /// What the pictures are drawn from.
    pub(crate) fn traces(&self) -> &RunTraces {
        &self.traces
    }

    /// Where the files are.
    pub(crate) fn directory(&self) -> &Path {
        &self.directory
    }

    /// Writes the files, and adds their names; the result within says whether the pictures could be drawn.
    ///
    /// # Errors
    /// If another file cannot be written.
    pub(crate) fn finish(
        self,
        scenario: &Scenario,
        last: &GridState,
        files: &mut Vec<&'static str>,
    ) -> Result<Result<(), FileError>, FileError> {
        let Self { directory, writer, traces, snapshots } = self;
        let format = writer.format();
        let path = directory.join(format.file());
        writer.finish(&View::from(last).shown(scenario)).map_err(FileError::at(&path))?;
        remove(&directory.join(format.other().file()))?;
        files.push(format.file());
        match &snapshots {
            Some(snapshots) => {
                snapshots.write(&directory.join(SNAPSHOTS))?;
                files.push(SNAPSHOTS);
            }
            None => remove(&directory.join(SNAPSHOTS))?,
        }
        #[cfg(not(feature = "pictures"))]
        let (drawn, _) = (Ok(()), traces);
        #[cfg(feature = "pictures")]
        let drawn = traces.draw(scenario, last.time, &directory, files);
        #[cfg(feature = "pictures")]
        let drawn = drawn.and(write_map(scenario, snapshots.as_ref(), &directory.join(MAP), files));
        Ok(drawn)
    }

    /// Removes what a run without load cases has left in the directory.
    ///
    /// # Errors
    /// If that fails.
    pub(crate) fn remove_files(directory: &Path) -> Result<(), FileError> {
        let pictures = ["coordinates.svg", "energy.svg", "phase.svg", MAP];
        [Format::Csv.file(), Format::Npz.file(), SNAPSHOTS]
            .into_iter()
            .chain(pictures)
            .try_for_each(|name| remove(&directory.join(name)))
    }
}

/// Draws the snapshots, or removes the map of an earlier run.
#[cfg(feature = "pictures")]
fn write_map(
    scenario: &Scenario,
    snapshots: Option<&Snapshots>,
    path: &Path,
    files: &mut Vec<&'static str>,
) -> Result<(), FileError> {
    let Some(snapshots) = snapshots else { return remove(path) };
    let (times, positions) = snapshots.positions();
    let map = Map::new(scenario.heading(), times, positions, scenario.coordinates());
    write_text(path, &map.to_svg())?;
    files.push(MAP);
    Ok(())
}
