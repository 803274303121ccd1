//! Gradients: derivatives of one function of a trajectory by any number of parameters, at the price of about
//! two runs.
//!
//! The derivatives are those of the computed numbers, as sensitivities are, by the steps of the run backwards
//! ([`Adjoint`]).
//!
//! ```
//! use fvi_host::gradient::{Cotangent, MOST_BYTES};
//! use fvi_host::prelude::*;
//! # use fvi_scenario::language::Document;
//! # use std::{convert::Infallible, path::Path, sync::atomic::AtomicBool};
//!
//! let scenario = Scenario::from_document(Document::new("pendulum.toml", Path::new(""), r#"
//!     system = { mass = [1.0], potential = "-k*cos(q0)", parameters = { k = 9.81 }, damping = [{ order = 0.5, coefficient = [0.3] }] }
//!     initial = { position = [2.0] }
//!     time = { step = 0.01, end = 5.0 }
//!     sensitivity = { parameters = ["system.parameters.k", "system.damping[0].order"] }
//! "#))?;
//! let mut run = Run::of(&scenario).recorded(MOST_BYTES).start()?;
//! let mut rows = 0;
//! let Ok(end) = run.drive(&AtomicBool::new(false), |portion| {
//!     portion.rows(|_, _| Ok::<_, Infallible>(rows += 1))
//! });
//! assert_eq!(end, RunEnd::Completed);
//! // Where the pendulum is at the end: what does that depend on?
//! let mut last = vec![0.0; rows];
//! last[rows - 1] = 1.0;
//! let recording = run.recording().unwrap();
//! let gradient = recording.gradient(&scenario, Cotangent { position: &last, momentum: &[] })?;
//! assert_eq!(gradient.parameters.len(), 2);
//! assert_eq!((gradient.position.len(), gradient.force.len()), (1, 500));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use fvi_fft::memory::Tables;
use fvi_scenario::language::InputError;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::Precision;
pub use fvi_simulation::simulation::adjoint::Gradient;
use fvi_simulation::simulation::adjoint::{Adjoint, Record};
use fvi_simulation::simulation::energy_guard::Gathered;
use fvi_simulation::simulation::motion::Motion;

/// Bytes that a stretch of recorded steps takes at most, unless the caller wants other stretches.
pub const MOST_BYTES: usize = 1 << 29;

/// The steps of a run, for gradients of functions of its trajectory.
///
/// Where they take more than the bytes allowed for them, the state of the motion is saved at the ends of
/// stretches in place of all but the last, and gradients make these stretches again: the price is one more
/// run. Derivatives by parameters of a kernel need the samples of its memory and as many multipliers in any
/// case.
pub struct Recording {
    most: usize,
    /// The last stretch, and the states before each earlier one.
    record: Record,
    earlier: Vec<Saved>,
    failed: Option<String>,
}

/// The state of a motion at the end of a stretch, with the step before it.
struct Saved {
    steps: usize,
    bytes: Vec<u8>,
    gathered: Gathered,
    last: Record,
}

/// The derivatives of a function by the rows of a trajectory, as a run hands them on: those that
/// `output.every` selects, and that of the last state; of each the coordinates that `output.coordinates`
/// selects. Row by row; empty for zeros.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cotangent<'a> {
    /// By the positions.
    pub position: &'a [f64],
    /// By the momenta.
    pub momentum: &'a [f64],
}

/// Why there is no gradient.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GradientError {
    /// Gradients of the scenario are not supported.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A cotangent has another number of entries than the trajectory.
    #[error("the cotangent of the {what} has {found} numbers; there are {rows} rows of {columns}")]
    Shape {
        /// "positions" or "momenta".
        what: &'static str,
        /// Numbers given.
        found: usize,
        /// Rows of the trajectory.
        rows: usize,
        /// Numbers of each.
        columns: usize,
    },
    /// The steps could not be kept, or one has no derivative.
    #[error("{0}")]
    Failed(String),
}

impl Recording {
    /// Nothing yet, in stretches of so many bytes at most.
    pub(crate) fn new(most: usize) -> Self {
        Self { most, record: Record::default(), earlier: Vec::new(), failed: None }
    }

    /// Takes the last batch of a motion.
    pub(crate) fn take(&mut self, motion: &Motion<'_>) {
        self.record.take(motion.batch());
        if self.record.bytes() <= self.most || motion.is_done() {
            return;
        }
        match motion.save() {
            Ok(bytes) => {
                let last = self.record.tail();
                self.record.clone_from(&last);
                let (steps, gathered) = (motion.steps(), motion.gathered());
                self.earlier.push(Saved { steps, bytes, gathered, last });
            }
            Err(error) => self.failed = Some(format!("steps that do not fit cannot be made again: {error}")),
        }
    }

    /// Steps made.
    pub fn steps(&self) -> usize {
        self.record.end()
    }

    /// Bytes that it takes.
    pub fn bytes(&self) -> usize {
        let saved = |saved: &Saved| saved.bytes.len() + saved.last.bytes();
        self.record.bytes() + self.earlier.iter().map(saved).sum::<usize>()
    }

    /// The gradient of a function of the trajectory with these derivatives by its rows, for the scenario of
    /// the run.
    ///
    /// # Errors
    /// [`GradientError`].
    pub fn gradient(&self, scenario: &Scenario, by: Cotangent<'_>) -> Result<Gradient, GradientError> {
        self.gradient_with(scenario, &Tables::default(), by)
    }

    /// As [`gradient`](Self::gradient), with the tables of memories shared with other runs.
    ///
    /// # Errors
    /// As [`gradient`](Self::gradient).
    pub fn gradient_with(
        &self,
        scenario: &Scenario,
        tables: &Tables,
        by: Cotangent<'_>,
    ) -> Result<Gradient, GradientError> {
        if let Some(reason) = &self.failed {
            return Err(GradientError::Failed(reason.clone()));
        }
        let (every, steps) = (scenario.output.every.max(1), self.steps());
        let chosen = scenario.written_coordinates();
        let (rows, columns) = (steps / every + 1 + usize::from(!steps.is_multiple_of(every)), chosen.len());
        for (what, numbers) in [("positions", by.position), ("momenta", by.momentum)] {
            let found = numbers.len();
            if found != 0 && found != rows * columns {
                return Err(GradientError::Shape { what, found, rows, columns });
            }
        }
        let mut cotangent = |k: usize, position: &mut [f64], momentum: &mut [f64]| {
            let row = if k == steps { rows - 1 } else { k / every };
            if k != steps && !k.is_multiple_of(every) {
                return;
            }
            for (numbers, places) in [(by.position, position), (by.momentum, momentum)] {
                if let Some(numbers) = numbers.get(row * columns..(row + 1) * columns) {
                    numbers.iter().zip(&chosen).for_each(|(number, &place)| places[place] += number);
                }
            }
        };
        let mut adjoint = Adjoint::new(scenario, tables)?;
        let begin = self.earlier.last().map_or(0, |saved| saved.steps);
        adjoint.go_back(&self.record, begin..steps, &mut cotangent).map_err(GradientError::Failed)?;
        let mut first = None;
        for (index, saved) in self.earlier.iter().enumerate().rev() {
            let before = index.checked_sub(1).and_then(|before| self.earlier.get(before));
            let record = made_again(scenario, tables, before, saved.steps)?;
            let begin = before.map_or(0, |before| before.steps);
            adjoint.go_back(&record, begin..saved.steps, &mut cotangent).map_err(GradientError::Failed)?;
            first = Some(record);
        }
        let first = first.as_ref().unwrap_or(&self.record);
        adjoint.finish(first, &mut cotangent).map_err(GradientError::Failed)
    }
}

/// The stretch of steps from a saved state, or from the start, to the one after so many steps.
fn made_again(
    scenario: &Scenario,
    tables: &Tables,
    from: Option<&Saved>,
    end: usize,
) -> Result<Record, GradientError> {
    let mut motion = Motion::sharing(scenario, Precision::F64, tables)?.recorded();
    let mut record = match from {
        Some(Saved { steps, bytes, gathered, last }) => {
            let failed = |error: fvi_core::StateError| GradientError::Failed(error.to_string());
            motion.resume(*steps, bytes, gathered.clone(), None).map_err(failed)?;
            last.clone()
        }
        None => {
            let mut record = Record::default();
            record.take(motion.batch());
            record
        }
    };
    while motion.steps() < end {
        let most = end - motion.steps();
        motion.advance_along(most).map_err(|failure| GradientError::Failed(failure.reason))?;
        record.take(motion.batch());
    }
    Ok(record)
}
