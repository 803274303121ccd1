//! The files of `fvi extremal`: data, pictures and the record.

use super::extremal::{Method, NotConverged, ProblemError, Solution, Status};
use super::grid::Grid;
#[cfg(feature = "pictures")]
use super::pictures::charts;
use super::problem_file::ProblemFile;
#[cfg(feature = "pictures")]
use fvi_host::results::files::write_picture;
use fvi_host::results::files::{FileError, remove, write, write_json};
use fvi_host::results::output_directory::OutputDirectory;
use fvi_scenario::language::memory_limit::{OutOfMemory, check_capacity};
use serde::Serialize;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

/// The record of a problem's solution, `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct ExtremalSummary {
    /// True if the positions are an extremal or only the best iterate.
    pub status: Status,
    /// Version of the program.
    pub version: &'static str,
    /// Operating system and processor.
    pub platform: String,
    /// Value of the functional, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    /// Newton steps.
    pub newton_iterations: usize,
    /// Iterations of the Krylov method, all Newton steps together.
    pub krylov_iterations: usize,
    /// Relative residual after each Newton step.
    pub residual_history: Vec<f64>,
    /// The last relative residual.
    pub relative_residual: f64,
    /// Largest magnitude of the left side of the discrete Euler–Lagrange equation.
    pub residual: f64,
    /// Residual that rounding of the positions alone may leave there.
    pub rounding_level: f64,
    /// Errors against the reference on this grid and coarser ones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<GridError>,
    /// Seconds for the solution on the grid of the file.
    pub seconds: f64,
    /// The files beside this one.
    pub files: Vec<&'static str>,
    /// The inputs as used, defaults filled in.
    pub problem: ProblemFile,
}

/// Error against the reference on one grid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GridError {
    /// Steps of the grid.
    pub steps: usize,
    /// Grid points where the reference is known.
    pub compared: usize,
    /// Grid points where it is infinite or not a number: nothing is compared there.
    #[serde(skip_serializing_if = "none")]
    pub undefined: usize,
    /// Largest error of a position there.
    pub largest: f64,
    /// log₂ of the error of the grid with half as many steps over this one's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub order: Option<f64>,
}

fn none(count: &usize) -> bool {
    *count == 0
}

/// Why a problem could not be solved or recorded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// The problem cannot be set up.
    #[error(transparent)]
    Problem(#[from] ProblemError),
    /// The solution on this grid would not fit into memory.
    #[error("interval.steps = {steps}: {no_room}")]
    NoRoom {
        /// Number of steps of the grid.
        steps: usize,
        /// Bytes that would be needed.
        no_room: OutOfMemory,
    },
    /// A file cannot be written.
    #[error(transparent)]
    File(#[from] FileError),
}

/// Name of the record.
const SUMMARY: &str = "summary.json";

/// Coarser grids on which the error is measured for the order.
const COARSER_GRIDS: u32 = 3;

/// Solves the problem and writes `extremal.csv`, pictures and `summary.json` into `directory`.
///
/// An iteration that does not converge is not an error here: the best iterate is written, and the summary
/// records it. `observe` receives the number of Newton steps and the relative residual before each.
///
/// # Errors
/// [`OutputError`].
pub fn solve_and_write(
    file: &ProblemFile,
    directory: &OutputDirectory,
    observe: &mut dyn FnMut(usize, f64),
) -> Result<ExtremalSummary, OutputError> {
    require_room(file)?;
    let start = Instant::now();
    let (status, extremal) = match file.solve(file.grid, observe)? {
        Ok(extremal) => (Status::Converged, extremal),
        Err(NotConverged { best }) => (Status::NotConverged, *best),
    };
    let seconds = start.elapsed().as_secs_f64();
    let errors = match status {
        Status::Converged => grid_errors(file, &extremal)?,
        Status::NotConverged => Vec::new(),
    };

    // A summary vouches for the files beside it: the old one is removed before they are replaced, the new one
    // is written last.
    remove(&directory.join(SUMMARY))?;
    write_table(file, &extremal, &directory.join("extremal.csv"))?;
    #[cfg_attr(not(feature = "pictures"), expect(unused_mut))]
    let mut files = vec!["extremal.csv"];
    #[cfg(feature = "pictures")]
    for (name, chart) in charts(file, status, &extremal) {
        write_picture(&directory.join(name), &chart)?;
        files.push(name);
    }
    let summary = ExtremalSummary {
        status,
        version: env!("CARGO_PKG_VERSION"),
        platform: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        value: extremal.value,
        newton_iterations: extremal.newton_iterations,
        krylov_iterations: extremal.krylov_iterations,
        residual_history: extremal.history,
        relative_residual: extremal.relative_residual,
        residual: extremal.residual,
        rounding_level: extremal.rounding_level,
        errors,
        seconds,
        files,
        problem: file.clone(),
    };
    write_json(&directory.join(SUMMARY), &summary)?;
    Ok(summary)
}

/// Refuses a grid whose solution would not fit into memory.
///
/// # Errors
/// [`OutputError::NoRoom`].
pub fn require_room(file: &ProblemFile) -> Result<(), OutputError> {
    let (steps, d) = (file.grid.steps(), file.coordinates());
    // Measured: 700 bytes a step with one coordinate, 1000 with two; the bound includes a margin.
    let linear = steps.saturating_mul(640 + 320 * d + 48 * d * d);
    let unknowns = steps.saturating_mul(d);
    let dense = match file.method {
        // Several matrices of all unknowns.
        Some(Method::Dense) => unknowns.saturating_mul(unknowns).saturating_mul(4 * size_of::<f64>()),
        _ => 0,
    };
    check_capacity(linear.saturating_add(dense)).map_err(|no_room| OutputError::NoRoom { steps, no_room })
}

/// `t,x0,…,v0,…` with 17 significant digits; no velocity at the point outside I_σ.
fn write_table(file: &ProblemFile, extremal: &Solution, path: &Path) -> Result<(), FileError> {
    let d = file.coordinates();
    write(path, |out| {
        let columns = |letter: char| (0..d).map(move |index| format!(",{letter}{index}"));
        let names: String = columns('x').chain(columns('v')).collect();
        writeln!(out, "t{names}")?;
        let without_velocity = file.sigma.excluded(file.grid.steps());
        for k in 0..=file.grid.steps() {
            write!(out, "{:.16e}", file.grid.time(k))?;
            for x in &extremal.positions[k * d..(k + 1) * d] {
                write!(out, ",{x:.16e}")?;
            }
            for v in &extremal.velocities[k * d..(k + 1) * d] {
                if k == without_velocity {
                    write!(out, ",")?;
                } else {
                    write!(out, ",{v:.16e}")?;
                }
            }
            writeln!(out)?;
        }
        Ok(())
    })
}

/// Errors on the file's grid and on those with half, a quarter, … as many steps; coarsest first.
fn grid_errors(file: &ProblemFile, extremal: &Solution) -> Result<Vec<GridError>, ProblemError> {
    if file.reference.is_none() {
        return Ok(Vec::new());
    }
    let mut errors: Vec<GridError> = Vec::new();
    for level in (0..=COARSER_GRIDS).rev() {
        let steps = file.grid.steps() >> level;
        if steps << level != file.grid.steps() || steps < 8 {
            continue;
        }
        let measured = if level == 0 {
            grid_error(file, &file.grid, &extremal.positions)
        } else {
            let grid = file.grid.with_steps(steps)?;
            match file.solve(grid, &mut |_, _| ())? {
                Ok(coarse) => grid_error(file, &grid, &coarse.positions),
                Err(_) => None,
            }
        };
        let Some(mut error) = measured else { continue };
        error.order = errors
            .last()
            .filter(|coarser| 2 * coarser.steps == steps && error.largest > 0.0)
            .map(|coarser| (coarser.largest / error.largest).log2())
            .filter(|order| order.is_finite());
        errors.push(error);
    }
    Ok(errors)
}

fn grid_error(file: &ProblemFile, grid: &Grid, positions: &[f64]) -> Option<GridError> {
    let reference = file.reference.as_ref()?;
    let mut error = GridError { steps: grid.steps(), compared: 0, undefined: 0, largest: 0.0, order: None };
    for (k, position) in positions.chunks_exact(file.coordinates()).enumerate() {
        if let Some(known) = reference.at(grid.time(k), grid.step()) {
            if known.iter().any(|exact| !exact.is_finite()) {
                error.undefined += 1;
                continue;
            }
            error.compared += 1;
            for (x, exact) in position.iter().zip(&known) {
                // A difference beyond the largest number counts as the largest number.
                error.largest = error.largest.max((x - exact).abs().min(f64::MAX));
            }
        }
    }
    (error.compared > 0).then_some(error)
}
