//! Problems with known motions, to be run on any grid.

use super::super::ReproduceError;
use fvi_core::max_or_nan;
use fvi_host::converge::{Outcome, run_on};
use fvi_host::run::{Run, RunEnd};
use fvi_scenario::language::Document;
use fvi_scenario::scenario::Scenario;
use std::convert::Infallible;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// q and q̇ of q̈ + ρ D^β q + k q = 0 in Caputo's sense from q = 1 at rest: `tests/reference/released.py`.
const RELEASED: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/reference/released.csv"));

/// Radau IIA with three stages, by collocation.
pub(super) const COLLOCATION: &str = "[scheme]\nkind = \"collocation\"\n";

/// Polynomials of degree 3 on the nodes of Radau IIA 3.
pub(super) const GALERKIN: &str =
    "[scheme]\nkind = \"galerkin\"\ndegree = 3\n[convolution]\nfamily = \"radau-iia\"\nstages = 3\n";

/// Radau IIA with two stages, by collocation.
pub(super) const COLLOCATION_2: &str =
    "[scheme]\nkind = \"collocation\"\n[convolution]\nfamily = \"radau-iia\"\nstages = 2\n";

/// A system with its initial state and known values of its motion.
#[derive(Clone, Debug)]
pub(super) struct Problem {
    pub(super) name: String,
    /// `[system]` and `[initial]`.
    system: String,
    /// Known motion as expressions of `[reference]`, or
    expressions: Option<&'static str>,
    /// as rows `t,q0,…,p0,…`; empty if there are expressions.
    rows: Vec<Vec<f64>>,
    /// Last time.
    pub(super) end: f64,
    /// Times at which its force jumps.
    pub(super) jumps: &'static [f64],
}

/// Result of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Made {
    pub(super) steps: usize,
    /// Number of steps solved, rejected ones included.
    pub(super) solved: usize,
    pub(super) rejected: usize,
    pub(super) attempts: usize,
    /// Largest errors of position and momentum, relative to the largest reference value if that is above 1.
    pub(super) position: f64,
    pub(super) momentum: f64,
    pub(super) seconds: f64,
}

impl Made {
    /// The larger of the two errors.
    pub(super) fn error(&self) -> f64 {
        self.position.max(self.momentum)
    }
}

/// Rows t, q, p of a released oscillator.
fn released_rows(coefficient: f64, order: f64, stiffness: f64) -> Vec<[f64; 3]> {
    let mut rows = Vec::new();
    for line in RELEASED.lines().skip(1) {
        let numbers: Vec<f64> = line.split(',').filter_map(|cell| cell.parse().ok()).collect();
        if let [rho, beta, k, t, q, p] = numbers[..]
            && [rho, beta, k] == [coefficient, order, stiffness]
        {
            rows.push([t, q, p]);
        }
    }
    rows
}

/// `[[system.damping]]` of one term.
fn damping(order: f64, coefficient: &str) -> String {
    format!("[[system.damping]]\norder = {order:?}\ncoefficient = {coefficient}\n")
}

/// `[initial]` at rest.
fn at_rest(position: &str) -> String {
    let coordinates = position.split(',').count();
    format!("[initial]\nposition = {position}\nmomentum = {:?}\n", vec![0.0; coordinates])
}

impl Problem {
    /// q̈ + D^(3/2) q + q = f with the solution t^(5/2) on [0, 1].
    pub(super) fn root() -> Self {
        let force = "force = [\"15/4*sqrt(t) + 15/8*sqrt(pi)*t + t^2.5\"]";
        Self {
            name: "q = t^(5/2), β = 3/2".to_owned(),
            system: oscillator(1.0, force) + &damping(1.5, "[1.0]") + &at_rest("[0.0]"),
            expressions: Some("position = [\"t^2.5\"]\nmomentum = [\"2.5*t^1.5\"]\n"),
            rows: Vec::new(),
            end: 1.0,
            jumps: &[],
        }
    }

    /// q̈ + ρ D^β q + q = 0 in Caputo's sense from q = 1 at rest.
    pub(super) fn released(coefficient: f64, order: f64) -> Self {
        let rows = released_rows(coefficient, order, 1.0);
        let end = if coefficient > 1.0 { 1e8 } else { 20.0 };
        Self {
            name: match coefficient {
                1.0 => format!("q̈ + D^{order} q + q = 0 from 1"),
                _ => format!("q̈ + {coefficient} D^{order} q + q = 0 from 1, to t = 10⁸"),
            },
            system: oscillator(1.0, "") + &damping(order, &format!("[{coefficient:?}]")) + &at_rest("[1.0]"),
            expressions: None,
            rows: rows.iter().filter(|row| row[0] <= end).map(|row| row.to_vec()).collect(),
            end,
            jumps: &[],
        }
    }

    /// q̈ + q = 0 from q = 1 at rest: an undamped motion.
    pub(super) fn undamped() -> Self {
        Self {
            name: "q̈ + q = 0 from 1".to_owned(),
            system: oscillator(1.0, "") + &at_rest("[1.0]"),
            expressions: Some("position = [\"cos(t)\"]\nmomentum = [\"-sin(t)\"]\n"),
            rows: Vec::new(),
            end: 20.0,
            jumps: &[],
        }
    }

    /// The plate under a pulse that ends at t = 1: a step of 8 at t = 0, and one of −8 at t = 1. The response
    /// to a unit step is 1 − q of the plate let go.
    pub(super) fn pulse() -> Self {
        let rows = released_rows(1.0, 1.5, 1.0);
        let released = |t: f64| rows.iter().find(|row| row[0] == t).copied();
        let response = |t: f64| {
            let [_, q, p] = released(t)?;
            let [_, q_before, p_before] = if t > 1.0 { released(t - 1.0)? } else { [0.0, 1.0, 0.0] };
            Some(vec![t, 8.0 * (q_before - q), 8.0 * (p_before - p)])
        };
        Self {
            name: "plate under a pulse up to t = 1".to_owned(),
            system: oscillator(1.0, "force = [\"8*step(1 - t)\"]")
                + &damping(1.5, "[1.0]")
                + &at_rest("[0.0]"),
            expressions: None,
            rows: (1..=30).filter_map(|t| response(f64::from(t))).collect(),
            end: 30.0,
            jumps: &[1.0],
        }
    }

    /// The pendulum on a viscoelastic hinge, released from 2 rad, against a fine graded run by collocation;
    /// and the largest difference from that of another scheme.
    pub(super) fn pendulum(stop: &AtomicBool) -> Result<(Self, f64), ReproduceError> {
        let potential = "mass = [0.25]\npotential = \"m*g*l*(1 - cos(q0))\"\n";
        let parameters = "parameters = { m = 1.0, g = 9.81, l = 0.5 }\n";
        let mut problem = Self {
            name: "pendulum on a viscoelastic hinge from 2 rad".to_owned(),
            system: format!("[system]\n{potential}{parameters}")
                + &damping(0.6, "[0.12]")
                + &at_rest("[2.0]"),
            expressions: None,
            rows: Vec::new(),
            end: 20.0,
            jumps: &[],
        };
        let times: Vec<f64> =
            [1e-3, 1e-2, 0.1].into_iter().chain((1..=40).map(|k| 0.5 * f64::from(k))).collect();
        let [rows, others] = PENDULUM_RUNS.map(|(scheme, steps, exponent)| {
            let time = format!(
                "grid = \"graded\"\nend = 20.0\nsteps = {steps}\nexponent = {exponent:?}\nmust_hit = {:?}\n",
                &times[..times.len() - 1]
            );
            let scenario = problem.scenario(scheme, &time, "")?;
            let mut rows = Vec::new();
            let outcome = run_on(&scenario, stop, &mut |_, state| {
                if times.contains(&state.time) {
                    rows.push(vec![state.time, state.position[0], state.momentum[0]]);
                }
            })?;
            match outcome {
                Outcome::Done { .. } => Ok(rows),
                Outcome::Failed { reason } => Err(ReproduceError::Run { reason }),
            }
        });
        let (rows, others): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (rows?, others?);
        let numbers = rows.iter().flatten().zip(others.iter().flatten());
        let difference = numbers.map(|(one, other)| (one - other).abs()).fold(0.0, max_or_nan);
        problem.rows = rows;
        Ok((problem, difference))
    }

    /// Two equal masses with an undamped soft mode q₀ + q₁ and a stiff mode q₀ − q₁, which is a thousand
    /// times as fast, strongly damped, and released from 10⁻³ times the amplitude of the soft one.
    pub(super) fn stiff() -> Self {
        let stiff = released_rows(1e4, 0.5, 1e6);
        let row = |&[t, q, p]: &[f64; 3]| {
            let (x, v) = (t.cos(), -t.sin());
            let (y, w) = (1e-3 * q, 1e-3 * p);
            vec![t, x + y, x - y, v + w, v - w]
        };
        let system = "[system]\nmass = [1.0, 1.0]\npotential = \"0.25*(q0 + q1)^2 + 0.25*1e6*(q0 - q1)^2\"\n";
        Self {
            name: "two masses: soft mode undamped, stiff mode let go".to_owned(),
            system: system.to_owned()
                + &damping(0.5, "[[5e3, -5e3], [-5e3, 5e3]]")
                + &at_rest("[1.001, 0.999]"),
            expressions: None,
            rows: stiff.iter().map(row).collect(),
            end: 20.0,
            jumps: &[],
        }
    }

    /// Two masses connected by a spring whose frequency is a thousand times that of their motion, which does
    /// not stretch it; undamped.
    pub(super) fn stiff_at_rest() -> Self {
        let system = "[system]\nmass = [1.0, 1.0]\npotential = \"0.25*(q0 + q1)^2 + 0.25*1e6*(q0 - q1)^2\"\n";
        Self {
            name: "two masses, undamped, stiff mode at rest".to_owned(),
            system: system.to_owned() + &at_rest("[1.0, 1.0]"),
            expressions: Some("position = [\"cos(t)\", \"cos(t)\"]\nmomentum = [\"-sin(t)\", \"-sin(t)\"]\n"),
            rows: Vec::new(),
            end: 20.0,
            jumps: &[],
        }
    }

    /// The times at which values are known.
    pub(super) fn times(&self) -> Vec<f64> {
        self.rows.iter().map(|row| row[0]).collect()
    }

    /// Known values of a coordinate over time.
    pub(super) fn values(&self, coordinate: usize) -> Vec<(f64, f64)> {
        self.rows.iter().filter_map(|row| Some((row[0], *row.get(1 + coordinate)?))).collect()
    }

    /// `[output]` at the times at which values are known, by the scheme's polynomial where they are not grid
    /// points.
    pub(super) fn at_known_times(&self) -> String {
        if self.rows.is_empty() { String::new() } else { format!("[output]\ntimes = {:?}\n", self.times()) }
    }

    /// The problem with a scheme on a grid, and `[output]`.
    pub(super) fn scenario(
        &self,
        scheme: &str,
        time: &str,
        output: &str,
    ) -> Result<Scenario, ReproduceError> {
        let coordinates = self.rows.first().map_or(0, |row| (row.len() - 1) / 2);
        let mut text = format!("{}{scheme}[time]\n{time}{output}", self.system);
        let mut table = "t".to_owned();
        for name in ["q", "p"] {
            (0..coordinates).for_each(|index| table += &format!(",{name}{index}"));
        }
        for row in &self.rows {
            let cells: Vec<String> = row.iter().map(|number| format!("{number:?}")).collect();
            table += &format!("\n{}", cells.join(","));
        }
        if let Some(expressions) = self.expressions {
            text += &format!("[reference]\n{expressions}");
        } else if !self.rows.is_empty() {
            text += "[reference]\nfile = \"known.csv\"\n";
        }
        let document = Document::new(&self.name, Path::new(""), &text);
        Ok(Scenario::from_document(document.with_attached("known.csv", table))?)
    }

    /// Runs the problem, and compares at the grid points with known values.
    pub(super) fn run(&self, scheme: &str, time: &str, stop: &AtomicBool) -> Result<Made, ReproduceError> {
        measured(&self.scenario(scheme, time, "")?, stop)
    }

    /// Runs the problem, and compares at all times with known values.
    pub(super) fn run_between(
        &self,
        scheme: &str,
        time: &str,
        stop: &AtomicBool,
    ) -> Result<Made, ReproduceError> {
        measured(&self.scenario(scheme, time, &self.at_known_times())?, stop)
    }
}

/// Runs a scenario with a reference.
pub(super) fn measured(scenario: &Scenario, stop: &AtomicBool) -> Result<Made, ReproduceError> {
    let mut run = Run::of(scenario).start()?;
    let Ok(end) = run.drive(stop, |_| Ok::<_, Infallible>(()));
    let summary = run.summary(end);
    match summary.end {
        RunEnd::Completed | RunEnd::Event { .. } => {}
        RunEnd::Stopped => return Err(ReproduceError::Stopped),
        RunEnd::Failed { reason, .. } => return Err(ReproduceError::Run { reason }),
    }
    let errors = summary.errors.unwrap_or_default();
    let (attempts, rejected) = summary.attempts.map_or((0, 0), |attempts| (attempts.made, attempts.rejected));
    let [position, momentum] =
        [errors.position, errors.momentum].map(|of| of.largest / of.reference_largest.max(1.0));
    let solved = if attempts > 0 { 3 * attempts } else { summary.steps };
    let (steps, seconds) = (summary.steps, summary.seconds);
    Ok(Made { steps, solved, rejected, attempts, position, momentum, seconds })
}

/// Runs for the pendulum (scheme, number of steps, exponent of the grid): the reference, and the one that its
/// error is estimated with.
const PENDULUM_RUNS: [(&str, usize, f64); 2] = [(COLLOCATION, 12_000, 3.0), (GALERKIN, 12_000, 4.0)];

/// `[system]` of one mass on a spring.
fn oscillator(stiffness: f64, force: &str) -> String {
    format!("[system]\nmass = [1.0]\npotential = \"0.5*{stiffness:?}*q0^2\"\n{force}\n")
}
