//! Output of one motion: its trajectory, the data of its pictures and its snapshots, for load cases in a
//! directory of each case.

#[cfg(feature = "pictures")]
use crate::results::files::write_text;
use crate::results::files::{FileError, remove};
use crate::results::growing_file::Mark;
use crate::results::rows::Rows;
use crate::results::run_traces::RunTraces;
#[cfg(feature = "pictures")]
use crate::results::snapshots;
use crate::results::snapshots::Snapshots;
use crate::results::trajectory::{Format, Shape, States, TrajectoryMark, TrajectoryWriter};
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::GridState;
use fvi_simulation::simulation::columns::Columns;
use fvi_simulation::simulation::step_batch::StepBatch;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Names of the files with the snapshots of the whole state, and with the picture of them.
const SNAPSHOTS: &str = "snapshots.npz";
const MAP: &str = "map.svg";

/// State of one motion (load case) of a run at a grid point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StateView<'a> {
    pub(crate) time: f64,
    pub(crate) position: &'a [f64],
    pub(crate) momentum: &'a [f64],
    pub(crate) energy: f64,
    /// Values of the run's [`Columns`](fvi_simulation::simulation::columns::Columns).
    pub(crate) columns: &'a [f64],
    pub(crate) sensitivities: &'a [f64],
}

impl StateView<'_> {
    /// The state with the output coordinates only.
    pub(crate) fn shown(&self, scenario: &Scenario) -> GridState {
        let of = |numbers: &[f64]| match &scenario.output.coordinates {
            Some(chosen) => chosen.iter().filter_map(|&index| numbers.get(index).copied()).collect(),
            None => numbers.to_vec(),
        };
        let (position, momentum) = (of(self.position), of(self.momentum));
        let sensitivities = self.sensitivities.chunks(self.position.len().max(1)).flat_map(of).collect();
        let columns = self.columns.to_vec();
        GridState { time: self.time, position, momentum, energy: self.energy, columns, sensitivities }
    }
}

impl<'a> From<&'a GridState> for StateView<'a> {
    fn from(state: &'a GridState) -> Self {
        let GridState { time, position, momentum, energy, columns, sensitivities } = state;
        Self { time: *time, position, momentum, energy: *energy, columns, sensitivities }
    }
}

/// One motion of a run over a batch of steps.
#[derive(Clone, Debug)]
pub(crate) struct BatchView<'a> {
    batch: &'a StepBatch,
    /// Range of its coordinates among those of all motions.
    places: Range<usize>,
    energies: &'a [f64],
}

impl<'a> BatchView<'a> {
    /// View of the motion with the coordinates `places`, and with its energies.
    pub(crate) fn new(batch: &'a StepBatch, places: Range<usize>, energies: &'a [f64]) -> Self {
        Self { batch, places, energies }
    }

    fn position(&self, coordinate: usize) -> &'a [f64] {
        self.batch.position(self.places.start + coordinate)
    }

    fn momentum(&self, coordinate: usize) -> &'a [f64] {
        self.batch.momentum(self.places.start + coordinate)
    }

    fn time(&self, index: usize) -> f64 {
        self.batch.times()[index]
    }

    fn energy(&self, index: usize) -> f64 {
        self.energies[index]
    }

    /// The run's columns at the last state.
    fn columns(&self) -> &'a [f64] {
        self.batch.columns()
    }

    /// ∂q/∂θ and ∂p/∂θ of the coordinates `chosen`; none where nothing is differentiated.
    fn sensitivities(&self, index: usize, chosen: &[usize]) -> impl Iterator<Item = f64> {
        let of_all = self.batch.sensitivities(index).chunks(self.places.len().max(1));
        of_all.flat_map(|all| chosen.iter().map(|&coordinate| all[coordinate]))
    }

    /// The state at `index` of the batch, with the coordinates `chosen` only.
    pub(crate) fn state(&self, index: usize, chosen: &[usize]) -> GridState {
        let numbers = || vec![0.0; chosen.len()];
        let mut state = GridState { position: numbers(), momentum: numbers(), ..GridState::default() };
        self.read(index, chosen, &mut state);
        state
    }

    /// Adds the states after multiples of `every` steps, with the coordinates `chosen`, to rows.
    pub(crate) fn add_to(&self, rows: &mut Rows, chosen: &[usize], every: usize) {
        let indices = || self.batch.multiples(every);
        let add = |numbers: &mut Vec<f64>, column: &[f64]| match every {
            1 => numbers.extend_from_slice(column),
            _ => numbers.extend(indices().map(|index| column[index])),
        };
        add(&mut rows.time, self.batch.times());
        add(&mut rows.energy, self.energies);
        if let &[only] = chosen {
            add(&mut rows.position, self.position(only));
            add(&mut rows.momentum, self.momentum(only));
        } else {
            for index in indices() {
                rows.position.extend(chosen.iter().map(|&coordinate| self.position(coordinate)[index]));
                rows.momentum.extend(chosen.iter().map(|&coordinate| self.momentum(coordinate)[index]));
            }
        }
        if !(self.columns().is_empty() && self.batch.sensitivities(0).is_empty()) {
            for index in indices() {
                rows.derivatives.extend(self.sensitivities(index, chosen));
                rows.of_columns.extend_from_slice(self.columns());
            }
        }
    }

    /// Writes the coordinates `chosen` at `index` of the batch to `state`, which has as many coordinates.
    pub(crate) fn read(&self, index: usize, chosen: &[usize], state: &mut GridState) {
        let GridState { time, position, momentum, energy, columns, sensitivities } = state;
        columns.clear();
        columns.extend_from_slice(self.columns());
        (*time, *energy) = (self.time(index), self.energy(index));
        sensitivities.clear();
        sensitivities.extend(self.sensitivities(index, chosen));
        let places = position.iter_mut().zip(momentum);
        for ((q, p), &coordinate) in places.zip(chosen) {
            (*q, *p) = (self.position(coordinate)[index], self.momentum(coordinate)[index]);
        }
    }
}

/// How far the files of one motion have got.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct OutputMark {
    pub(crate) trajectory: TrajectoryMark,
    /// One mark for each array of the snapshots; empty without snapshots.
    pub(crate) snapshots: Vec<Mark>,
}

impl OutputMark {
    /// Checks that the marked parts of the files exist in the directory; returns a sentence about what is
    /// missing. Changes nothing.
    pub(crate) fn missing(&self, directory: &Path) -> Option<String> {
        let rows = TrajectoryWriter::can_resume(directory, &self.trajectory);
        let snapshots = directory.join(SNAPSHOTS);
        let states = self.snapshots.is_empty() || Snapshots::can_resume(&snapshots, &self.snapshots);
        let file = directory.join(self.trajectory.format.file());
        let (file, parts) = match (rows, states) {
            (true, true) => return None,
            (false, _) => (file.display(), format!("{}.part", file.display())),
            (true, false) => (snapshots.display(), "the parts beside it".to_owned()),
        };
        Some(format!("neither {parts} nor {file} holds its rows"))
    }
}

/// Most coordinates whose curves are drawn, the first of those that are written.
const MOST_DRAWN: usize = 100;

/// The files of one motion.
pub(crate) struct OutputSink {
    directory: PathBuf,
    /// Indices of the coordinates that are written and drawn.
    chosen: Vec<usize>,
    writer: TrajectoryWriter,
    traces: RunTraces,
    snapshots: Option<Snapshots>,
}

impl OutputSink {
    /// The sinks of all motions of a run that begins.
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
            let parameters = scenario.sensitivity.as_ref().map_or(0, |asked| asked.parameters.len());
            let columns = Columns::of(scenario);
            let shape =
                Shape { states: States::of(scenario), coordinates: &chosen, columns: &columns, parameters };
            let writer = TrajectoryWriter::create(&directory, format, shape, scenario.output.every)
                .map_err(FileError::at(&path))?;
            let path = directory.join(SNAPSHOTS);
            let create = |every| Snapshots::create(&path, every, scenario.coordinates());
            let snapshots =
                scenario.output.snapshots.map(create).transpose().map_err(FileError::at(&path))?;
            let traces = RunTraces::new(chosen.len().min(MOST_DRAWN), columns.len(), has_phase(scenario));
            let chosen = chosen.clone();
            Ok(Self { directory, chosen, writer, traces, snapshots })
        };
        Self::directories(scenario, directory).into_iter().map(open).collect()
    }

    /// The sinks of all motions of a resumed run whose next grid point is `index`.
    ///
    /// # Errors
    /// If the marked part of a file no longer exists.
    pub(crate) fn resume_all(
        scenario: &Scenario,
        directory: &Path,
        marks: &[OutputMark],
        traces: Vec<RunTraces>,
        index: usize,
    ) -> Result<Vec<Self>, FileError> {
        let (count, every) = (scenario.written_coordinates().len(), scenario.output.every);
        let columns = Columns::of(scenario);
        let shape = (States::of(scenario), count, &columns);
        let directories = Self::directories(scenario, directory).into_iter();
        let resume = |((directory, mark), traces): ((PathBuf, &OutputMark), RunTraces)| {
            let path = directory.join(mark.trajectory.format.file());
            let writer = TrajectoryWriter::resume(&directory, &mark.trajectory, shape, every, index)
                .map_err(FileError::at(&path))?;
            let path = directory.join(SNAPSHOTS);
            let resume = |every| Snapshots::resume(&path, every, scenario.coordinates(), &mark.snapshots);
            let snapshots =
                scenario.output.snapshots.map(resume).transpose().map_err(FileError::at(&path))?;
            Ok(Self { directory, chosen: scenario.written_coordinates(), writer, traces, snapshots })
        };
        directories.zip(marks).zip(traces).map(resume).collect()
    }

    fn directories(scenario: &Scenario, directory: &Path) -> Vec<PathBuf> {
        case_directories(directory, scenario.cases.iter().map(|case| case.name.as_str()))
    }

    /// Writes a batch of states, and the requested output states between its last two grid points.
    ///
    /// # Errors
    /// If a row cannot be written.
    pub(crate) fn take(
        &mut self,
        scenario: &Scenario,
        between: &[GridState],
        batch_view: &BatchView<'_>,
    ) -> Result<(), FileError> {
        let Self { directory, chosen, writer, traces, snapshots } = self;
        let (batch, format) = (batch_view.batch, writer.format());
        let failed = |error| FileError::at(&directory.join(format.file()))(error);
        if scenario.output.times.is_empty() {
            writer.push_all(batch.len(), |index| batch_view.state(index, chosen)).map_err(failed)?;
        }
        for row in between {
            writer.push(&StateView::from(row).shown(scenario)).map_err(failed)?;
        }
        let drawn = chosen.iter().map(|&index| batch_view.position(index));
        traces.take(batch.times(), drawn, (batch_view.energies, batch.with_energy()));
        if let (Some(&first), true) = (chosen.first(), has_phase(scenario)) {
            // The first unknown with the second, or the position with the momentum.
            let beside = match (scenario.equation.is_some(), chosen.get(1)) {
                (true, Some(&second)) => batch_view.position(second),
                _ => batch_view.momentum(first),
            };
            traces.take_phase(batch_view.position(first), beside);
        }
        traces.take_columns(batch.times(), batch.columns());
        let Some(snapshots) = snapshots else { return Ok(()) };
        let whole: Vec<usize> = (0..batch_view.places.len()).collect();
        for index in batch.multiples(snapshots.every()) {
            let GridState { time, position, momentum, .. } = batch_view.state(index, &whole);
            snapshots
                .take(time, &position, &momentum)
                .map_err(|error| FileError::at(&directory.join(SNAPSHOTS))(error))?;
        }
        Ok(())
    }

    /// Adds the energy of the last state, which was not computed with its step.
    pub(crate) fn take_last_energy(&mut self, last: &GridState) {
        self.traces.take_energy(last.time, last.energy);
    }

    /// Flushes the files and returns a mark of how far they are written.
    ///
    /// # Errors
    /// If rows cannot be written.
    pub(crate) fn mark(&mut self) -> Result<OutputMark, FileError> {
        let path = self.directory.join(self.writer.format().file());
        let trajectory = self.writer.mark().map_err(FileError::at(&path))?;
        let path = self.directory.join(SNAPSHOTS);
        let snapshots = self.snapshots.as_mut().map(Snapshots::mark).transpose();
        let snapshots = snapshots.map_err(FileError::at(&path))?.unwrap_or_default();
        Ok(OutputMark { trajectory, snapshots })
    }

    /// Keeps the rows written so far when this is dropped, for a run that resumes.
    pub(crate) fn keep(&mut self) {
        self.writer.keep();
        self.snapshots.iter_mut().for_each(Snapshots::keep);
    }

    /// Data of the pictures.
    pub(crate) fn traces(&self) -> &RunTraces {
        &self.traces
    }

    /// Where the files are.
    pub(crate) fn directory(&self) -> &Path {
        &self.directory
    }

    /// Completes the files, and adds their names to `files`; the inner result is an error if a picture could
    /// not be drawn.
    ///
    /// # Errors
    /// If another file cannot be written.
    pub(crate) fn finish(
        self,
        scenario: &Scenario,
        last: &GridState,
        files: &mut Vec<&'static str>,
    ) -> Result<Result<(), FileError>, FileError> {
        let Self { directory, writer, traces, snapshots, .. } = self;
        let format = writer.format();
        let path = directory.join(format.file());
        writer.finish(&StateView::from(last).shown(scenario)).map_err(FileError::at(&path))?;
        remove(&directory.join(format.other().file()))?;
        files.push(format.file());
        let path = directory.join(SNAPSHOTS);
        let kept = snapshots.is_some();
        match snapshots {
            Some(snapshots) => {
                snapshots.finish().map_err(FileError::at(&path))?;
                files.push(SNAPSHOTS);
            }
            None => remove(&path)?,
        }
        #[cfg(not(feature = "pictures"))]
        let (drawn, ..) = (Ok(()), traces, kept);
        #[cfg(feature = "pictures")]
        let drawn = traces.draw(scenario, last.time, &directory, files);
        #[cfg(feature = "pictures")]
        let drawn = drawn.and(write_map(scenario, kept.then_some(&path), &directory.join(MAP), files));
        Ok(drawn)
    }

    /// Removes the files of an earlier run without load cases from the directory.
    ///
    /// # Errors
    /// If that fails.
    pub(crate) fn remove_files(directory: &Path) -> Result<(), FileError> {
        let pictures = ["coordinates.svg", "energy.svg", "phase.svg", "control.svg", "output.svg", MAP];
        [Format::Csv.file(), Format::Npz.file(), SNAPSHOTS]
            .into_iter()
            .chain(pictures)
            .try_for_each(|name| remove(&directory.join(name)))
    }
}

/// True if a run has a phase portrait: of one coordinate, or of two unknowns of an equation.
fn has_phase(scenario: &Scenario) -> bool {
    let written = scenario.written_coordinates().len();
    if scenario.equation.is_some() { written > 1 } else { written == 1 }
}

/// The directories of the load cases with these names; without cases the run's own.
pub(crate) fn case_directories<'a>(directory: &Path, names: impl Iterator<Item = &'a str>) -> Vec<PathBuf> {
    let directories: Vec<_> = names.map(|name| directory.join(name)).collect();
    if directories.is_empty() { vec![directory.to_owned()] } else { directories }
}

/// Draws the snapshots, or removes the map of an earlier run.
#[cfg(feature = "pictures")]
fn write_map(
    scenario: &Scenario,
    archive: Option<&PathBuf>,
    path: &Path,
    files: &mut Vec<&'static str>,
) -> Result<(), FileError> {
    let Some(archive) = archive else { return remove(path) };
    let map = snapshots::map(archive, scenario.heading(), scenario.coordinates());
    let map = map.map_err(FileError::at(archive))?;
    write_text(path, &map.to_svg())?;
    files.push(MAP);
    Ok(())
}
