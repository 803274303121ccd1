//! Frequency response and poles of a scenario, and moduli, creep and relaxation of its kernels.

#[cfg(feature = "pictures")]
mod pictures;
mod sharp;

use crate::results::csv_row::append_row;
use crate::results::files::{FileError, remove, write_json, write_text};
use crate::results::output_directory::OutputDirectory;
use fvi_core::ParameterError;
use fvi_fft::transfer::laplace::{creep, relaxation, whole};
use fvi_scenario::language::InputError;
use fvi_scenario::language::excerpt::excerpt;
use fvi_scenario::language::memory_limit::{OutOfMemory, check_capacity};
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::response::{Linearised, MOST_MODES, SystemMode, SystemPole};
use serde::Serialize;
use std::f64::consts::PI;
use std::sync::atomic::{AtomicBool, Ordering};

/// A number of a response.
pub type Complex<T = f64> = nalgebra::Complex<T>;

/// What is to be computed.
#[derive(Clone, Debug)]
pub struct ResponseOptions {
    /// First angular frequency; `None`: 2π over the time of the run.
    pub from: Option<f64>,
    /// Last angular frequency; `None`: π over the time step.
    pub to: Option<f64>,
    /// Number of frequencies, equidistant on a logarithmic scale.
    pub points: usize,
    /// The angular frequencies themselves, in place of `from`, `to` and `points`.
    pub omega: Option<Vec<f64>>,
    /// The coordinate on which the force acts.
    pub input: usize,
    /// The coordinate whose displacement is computed.
    pub output: usize,
    /// The point about which the system is linearised; without it the initial position.
    pub position: Option<Vec<f64>>,
    /// Angular frequencies near which modes are sought; none are without them.
    pub near: Vec<f64>,
    /// Number of modes near each of them.
    pub modes: usize,
    /// False: without the response of the discrete scheme.
    pub discrete: bool,
}

/// Default number of frequencies.
pub const POINTS: usize = 400;

/// Default number of modes near a frequency.
pub const MODES: usize = 6;

impl Default for ResponseOptions {
    fn default() -> Self {
        Self {
            from: None,
            to: None,
            points: POINTS,
            omega: None,
            input: 0,
            output: 0,
            position: None,
            near: Vec::new(),
            modes: MODES,
            discrete: true,
        }
    }
}

/// Damping of a motion, as |Re s|/Im s, up to which it is rounding.
const UNDAMPED: f64 = 1e-12;

/// Response of a damped system.
#[derive(Clone, Debug)]
pub struct Response {
    /// ω, ascending.
    pub omega: Vec<f64>,
    /// H(ω): displacement of the output under a force e^{iωt} on the input.
    pub response: Vec<Complex<f64>>,
    /// Further frequencies between those of `omega`, ascending, and H(ω), where H is sharp, so that pictures
    /// show resonances between two of `omega`. Empty if the frequencies were given one by one.
    pub between: Vec<(f64, Complex<f64>)>,
    /// H(ω) of the discrete scheme, for the frequencies up to π/h, which are the first ones of `omega`;
    /// otherwise why it is left out.
    pub discrete: Result<Vec<Complex<f64>>, String>,
    /// Poles with Im s ≥ 0, in ascending order of |s|; otherwise why they are left out.
    pub poles: Result<Vec<SystemPole>, String>,
    /// The modes near each of the frequencies asked for, in their order, each with that frequency.
    pub modes: Vec<(f64, SystemMode)>,
    /// Curves of the kernel of each damping term.
    pub kernels: Vec<KernelCurves>,
    /// Warnings.
    pub warnings: Vec<String>,
}

/// Moduli, creep and relaxation of a kernel.
#[derive(Clone, Debug)]
pub struct KernelCurves {
    /// Its name.
    pub name: String,
    /// K(iω): storage and loss modulus, at the frequencies of the response.
    pub moduli: Vec<Complex<f64>>,
    /// Times 1/ω, ascending.
    pub times: Vec<f64>,
    /// Creep function J(t) at `times`; `None` for a kernel that is not passive.
    pub creep: Option<Vec<f64>>,
    /// Relaxation function G(t) at `times`; `None` for a kernel that is not passive.
    pub relaxation: Option<Vec<f64>>,
}

/// Why there is no response.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ResponseError {
    /// The scenario cannot be linearised.
    #[error(transparent)]
    Input(#[from] InputError),
    /// An argument is outside its range.
    #[error(transparent)]
    Argument(ParameterError),
    /// The point about which it is linearised has another number of coordinates.
    #[error("--position: {found} numbers instead of {expected}, one for each coordinate")]
    Position {
        /// Numbers given.
        found: usize,
        /// Coordinates.
        expected: usize,
    },
    /// The curves would not fit into memory.
    #[error("{points} frequencies: {error}")]
    NoRoom {
        /// Their number.
        points: usize,
        /// What is needed.
        error: OutOfMemory,
    },
    /// The equations have no solution.
    #[error("{0}")]
    Unsolved(String),
    /// It was stopped.
    #[error("stopped")]
    Stopped,
}

fn refused(parameter: &'static str, value: f64, allowed: &'static str) -> ResponseError {
    ResponseError::Argument(ParameterError { parameter, value, allowed })
}

/// The angular frequencies of the request.
fn frequencies(scenario: &Scenario, options: &ResponseOptions) -> Result<Vec<f64>, ResponseError> {
    const POSITIVE: &str = "positive and finite";
    if let Some(omega) = &options.omega {
        if omega.is_empty() {
            return Err(refused("number of frequencies", 0.0, "1 at least"));
        }
        if let Some(&wrong) = omega.iter().find(|&&omega| !(omega > 0.0 && omega.is_finite())) {
            return Err(refused("omega", wrong, POSITIVE));
        }
        if !omega.windows(2).all(|pair| pair[0] < pair[1]) {
            let wrong = omega.windows(2).find(|pair| pair[0] >= pair[1]).map_or(f64::NAN, |pair| pair[1]);
            return Err(refused("omega", wrong, "frequencies that ascend"));
        }
        return Ok(omega.clone());
    }
    let time = &scenario.time;
    let end = match time.adaptive() {
        Some(adaptive) => adaptive.end,
        None => time.time(time.steps),
    };
    let step = if time.adaptive().is_some() { f64::NAN } else { time.mean_step() };
    let seen = (2.0 * PI / end, PI / step);
    let from = options.from.unwrap_or(if seen.0.is_finite() { seen.0 } else { 1e-3 * PI / step });
    let to = options.to.unwrap_or(if seen.1 > from { seen.1 } else { 1e4 * from });
    for (name, value) in [("from", from), ("to", to)] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(refused(name, value, POSITIVE));
        }
    }
    if to < from {
        return Err(refused("to", to, "a frequency that is not below the first one"));
    }
    if options.points < 2 && to > from || options.points < 1 {
        return Err(refused("points", options.points as f64, "2 at least"));
    }
    // The curves of the response and of every kernel, and what is drawn and written of them.
    let curves = 1 + scenario.system.damping.len();
    check_capacity(options.points.saturating_mul(16 * size_of::<f64>() * curves))
        .map_err(|error| ResponseError::NoRoom { points: options.points, error })?;
    let (low, high) = (libm::log(from), libm::log(to));
    let last = options.points.max(2) - 1;
    let at = |k: usize| match k {
        0 => from,
        k if k == last => to,
        k => libm::exp(low + (high - low) * k as f64 / last as f64),
    };
    if from == to { Ok(vec![from]) } else { Ok((0..=last).map(at).collect()) }
}

/// Computes the response of a scenario; `progress` receives the number of frequencies done and their total
/// number.
///
/// # Errors
/// [`ResponseError`].
pub fn respond(
    scenario: &Scenario,
    options: &ResponseOptions,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Response, ResponseError> {
    let size = scenario.coordinates();
    for (name, coordinate) in [("input", options.input), ("output", options.output)] {
        if coordinate >= size {
            return Err(refused(name, coordinate as f64, "the number of a coordinate, from 0"));
        }
    }
    let position = options.position.as_ref().unwrap_or(&scenario.initial.position);
    if position.len() != size {
        return Err(ResponseError::Position { found: position.len(), expected: size });
    }
    if let Some(&wrong) = position.iter().find(|q| !q.is_finite()) {
        return Err(refused("position", wrong, "finite"));
    }
    let omega = frequencies(scenario, options)?;
    let linearised = Linearised::new(scenario, position)?;
    let mut warnings = warnings_of(&linearised);
    let all = omega.len().saturating_add(options.near.len().saturating_mul(options.modes));
    let modes = modes_near(&linearised, options, stop, &mut |done| progress(done, all))?;
    warnings.extend(options.near.iter().filter_map(|near| few_modes(*near, &modes, options.modes)));
    let highest = PI / scenario.time.step * (1.0 + 1e-12);
    let before = all - omega.len();
    let (response, discrete) =
        curves(&linearised, &omega, highest, options, stop, &mut |done| progress(before + done, all))?;
    progress(all, all);
    let poles = linearised.poles();
    if (poles.is_ok() || !modes.is_empty() && !linearised.has_tables_over_time())
        && let Some(kernel) = linearised.kernel_of_unknown_poles()
    {
        warnings.push(format!(
            "poles.csv and modes.csv may be incomplete: the kernel {kernel} may itself have poles, which cancel those of the system \
             in the counts of the argument principle; those of quotients of polynomials in s, as damping terms of their \
             own, are known"
        ));
    }
    let known: Vec<_> = omega.iter().copied().zip(response.iter().copied()).collect();
    // At the frequency of a motion that nothing damps there is no solution to show.
    let is_damped = |pole: &&SystemPole| pole.place.re.abs() > UNDAMPED * pole.place.im;
    let resonances: Vec<f64> = poles.iter().flatten().filter(is_damped).map(|pole| pole.place.im).collect();
    let known = if options.omega.is_some() { &[] } else { &known[..] };
    // Systems whose poles are computed are small, and a frequency costs little.
    let most = if resonances.is_empty() { known.len() } else { 8 * known.len() };
    let between = sharp::between(known, &resonances, most, |omega| {
        let mut stopped = || {
            progress(all, all);
            stop.load(Ordering::Relaxed)
        };
        if stopped() {
            return Err(ResponseError::Stopped);
        }
        let column = linearised.response_unless(omega, options.input, &mut stopped);
        Ok(column.map_err(|reason| unsolved(reason, stop))?[options.output])
    })?;
    let times: Vec<f64> = omega.iter().rev().map(|omega| omega.recip()).collect();
    let terms = linearised.kernels().iter();
    let kernels = terms.map(|transfer| KernelCurves {
        name: transfer.to_string(),
        moduli: omega.iter().map(|&omega| whole(transfer, Complex::new(0.0, omega))).collect(),
        creep: times.iter().map(|&time| creep(transfer, time)).collect(),
        relaxation: times.iter().map(|&time| relaxation(transfer, time)).collect(),
        times: times.clone(),
    });
    Ok(Response { response, between, discrete, poles, modes, kernels: kernels.collect(), warnings, omega })
}

/// What the linearisation itself gives reason to warn of.
fn warnings_of(linearised: &Linearised) -> Vec<String> {
    let mut warnings = Vec::new();
    if linearised.is_at_a_kink() {
        warnings.push(
            "the forces have a kink at this position, where they have no derivative: the response is that of one side, \
             or lacks what has the kink; choose another `position`"
                .to_owned(),
        );
    }
    if linearised.changes_with_time() {
        warnings.push("the stiffness changes with time: the response is that of t = 0".to_owned());
    }
    if let Some(highest) = linearised.highest() {
        warnings.push(format!(
            "a kernel is given by weights w_n: its K(iω) is the sum of w_n e^(-iωnh), for frequencies up to π/h = {highest}"
        ));
    }
    warnings
}

/// That there are fewer modes near a frequency than were asked for.
fn few_modes(near: f64, modes: &[(f64, SystemMode)], wanted: usize) -> Option<String> {
    let there = match modes.iter().filter(|(own, _)| *own == near).count() {
        found if found >= wanted => return None,
        1 => "there is 1 mode".to_owned(),
        found => format!("there are {found} modes"),
    };
    Some(format!("near ω = {near} {there}, not {wanted}: no other is in the disc about iω that is searched"))
}

/// H(ω) at the frequencies, and that of the scheme up to the highest one that its step tells, or why there is
/// none.
type Curves = (Vec<Complex<f64>>, Result<Vec<Complex<f64>>, String>);

fn curves(
    linearised: &Linearised,
    omega: &[f64],
    highest: f64,
    options: &ResponseOptions,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize),
) -> Result<Curves, ResponseError> {
    let mut response = Vec::with_capacity(omega.len());
    let mut discrete = match linearised.without_discrete_response() {
        None if options.discrete => Ok(Vec::new()),
        None => Err(NOT_ASKED.to_owned()),
        Some(reason) => Err(reason.to_owned()),
    };
    for (index, &omega_k) in omega.iter().enumerate() {
        let mut stopped = || {
            progress(index);
            stop.load(Ordering::Relaxed)
        };
        if stopped() {
            return Err(ResponseError::Stopped);
        }
        let column = linearised.response_unless(omega_k, options.input, &mut stopped);
        response.push(column.map_err(|reason| unsolved(reason, stop))?[options.output]);
        if let (Ok(values), true) = (&mut discrete, omega_k <= highest) {
            match linearised.discrete_response_unless(omega_k, options.input, &mut stopped) {
                Ok(column) => values.push(column[options.output]),
                Err(reason) if stop.load(Ordering::Relaxed) => return Err(unsolved(reason, stop)),
                Err(reason) => discrete = Err(reason),
            }
        }
    }
    Ok((response, discrete))
}

/// Why a response of the scheme is left out that nobody wants.
const NOT_ASKED: &str = "it was not asked for";

/// The error of equations that were left unsolved.
fn unsolved(reason: String, stop: &AtomicBool) -> ResponseError {
    if stop.load(Ordering::Relaxed) { ResponseError::Stopped } else { ResponseError::Unsolved(reason) }
}

/// The modes near the frequencies of the request; `progress` receives how many are done.
fn modes_near(
    linearised: &Linearised,
    options: &ResponseOptions,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize),
) -> Result<Vec<(f64, SystemMode)>, ResponseError> {
    let mut modes = Vec::new();
    if options.near.is_empty() {
        return Ok(modes);
    }
    if !(1..=MOST_MODES).contains(&options.modes) {
        return Err(refused("modes", options.modes as f64, "from 1 to 200"));
    }
    for (index, &near) in options.near.iter().enumerate() {
        if !(near > 0.0 && near.is_finite()) {
            return Err(refused("near", near, "positive and finite"));
        }
        let mut stopped = || {
            progress(index * options.modes);
            stop.load(Ordering::Relaxed)
        };
        let found = linearised.modes(near, options.modes, &mut stopped);
        let found = found.map_err(|reason| unsolved(format!("modes near ω = {near}: {reason}"), stop))?;
        modes.extend(found.into_iter().map(|mode| (near, mode)));
    }
    Ok(modes)
}

/// The record of a response, `response.json`.
#[derive(Serialize)]
struct Summary<'a> {
    version: &'static str,
    platform: String,
    input: usize,
    output: usize,
    position: &'a [f64],
    frequencies: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    poles: Option<usize>,
    #[serde(skip_serializing_if = "<[f64]>::is_empty")]
    near: &'a [f64],
    #[serde(skip_serializing_if = "Option::is_none")]
    modes: Option<usize>,
    /// Results that were left out, with the reasons.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    left_out: Vec<String>,
    warnings: &'a [String],
    files: &'a [String],
    scenario: &'a Scenario,
}

impl Response {
    /// Results that were left out, with the reasons.
    pub fn left_out(&self) -> Vec<String> {
        let reasons = [
            ("response_discrete.csv", self.discrete.as_ref().err()),
            ("poles.csv", self.poles.as_ref().err()),
        ];
        let reasons =
            reasons.into_iter().filter(|(_, reason)| reason.is_none_or(|reason| reason != NOT_ASKED));
        let reasons = reasons.filter_map(|(file, reason)| Some(format!("{file}: {}", reason?)));
        let without = self.kernels.iter().enumerate().filter(|(_, kernel)| kernel.creep.is_none());
        let without: Vec<_> = without.collect();
        let of_kernels = without.first().map(|(first, kernel)| {
            let others = match without.len() {
                1 => String::new(),
                count => format!(", and of {} others", count - 1),
            };
            format!(
                "creep_{first}.csv, relaxation_{first}.csv of the kernel {}{others}: they are given by weights, active (as a single \
                 entry of a matrix may be), or their curves are not finite",
                excerpt(&kernel.name)
            )
        });
        reasons.chain(of_kernels).collect()
    }

    /// `modes.csv`, and `mode_shapes.csv` with a row for each coordinate.
    fn mode_files(&self) -> Vec<(String, String)> {
        if self.modes.is_empty() {
            return Vec::new();
        }
        let has_tables = self.modes.iter().any(|(_, mode)| mode.of_tables.is_some());
        let more = if has_tables { ",of_tables" } else { "" };
        let mut text = format!("near,re,im,frequency,damping,residual{more}\n");
        for (near, mode) in &self.modes {
            let numbers =
                [*near, mode.place.re, mode.place.im, mode.frequency(), mode.damping(), mode.residual];
            let numbers: Vec<f64> = numbers.into_iter().chain(mode.of_tables).collect();
            append_row(&mut text, &numbers);
        }
        let names = (0..self.modes.len()).map(|k| format!(",re{k},im{k}")).collect::<String>();
        let mut shapes = format!("coordinate{names}\n");
        for coordinate in 0..self.modes[0].1.shape.len() {
            let parts = self.modes.iter().flat_map(|(_, mode)| {
                let entry = mode.shape[coordinate];
                [entry.re, entry.im]
            });
            let numbers: Vec<f64> = std::iter::once(coordinate as f64).chain(parts).collect();
            append_row(&mut shapes, &numbers);
        }
        vec![("modes.csv".to_owned(), text), ("mode_shapes.csv".to_owned(), shapes)]
    }

    /// Writes the files of a response.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn write(
        &self,
        scenario: &Scenario,
        options: &ResponseOptions,
        directory: &OutputDirectory,
    ) -> Result<(), FileError> {
        remove(&directory.join("response.json"))?;
        for name in
            ["response_between.csv", "response_discrete.csv", "poles.csv", "modes.csv", "mode_shapes.csv"]
        {
            remove(&directory.join(name))?;
        }
        let mut files =
            vec![("response.csv".to_owned(), complex_table("omega,re,im", &self.omega, &self.response))];
        if !self.between.is_empty() {
            let (omega, values): (Vec<f64>, Vec<_>) = self.between.iter().copied().unzip();
            files.push(("response_between.csv".to_owned(), complex_table("omega,re,im", &omega, &values)));
        }
        if let Ok(discrete) = &self.discrete {
            files.push((
                "response_discrete.csv".to_owned(),
                complex_table("omega,re,im", &self.omega, discrete),
            ));
        }
        if let Ok(poles) = &self.poles {
            let mut text = "re,im,frequency,damping\n".to_owned();
            for pole in poles {
                let numbers = [pole.place.re, pole.place.im, pole.frequency(), pole.damping()];
                append_row(&mut text, &numbers);
            }
            files.push(("poles.csv".to_owned(), text));
        }
        files.extend(self.mode_files());
        for (term, kernel) in self.kernels.iter().enumerate() {
            let moduli = complex_table("omega,storage,loss", &self.omega, &kernel.moduli);
            files.push((format!("moduli_{term}.csv"), moduli));
            let curves = [("creep", &kernel.creep), ("relaxation", &kernel.relaxation)];
            for (name, values) in curves {
                let path = format!("{name}_{term}.csv");
                let Some(values) = values else {
                    remove(&directory.join(path))?;
                    continue;
                };
                let mut text = format!("t,{name}\n");
                kernel
                    .times
                    .iter()
                    .zip(values)
                    .for_each(|(&time, &value)| append_row(&mut text, &[time, value]));
                files.push((path, text));
            }
        }
        for (name, text) in &files {
            write_text(&directory.join(name), text)?;
        }
        let mut names: Vec<String> = files.into_iter().map(|(name, _)| name).collect();
        #[cfg(feature = "pictures")]
        for (name, chart) in pictures::charts(self, scenario, options) {
            crate::results::files::write_picture(&directory.join(name), &chart)?;
            names.push(name.to_owned());
        }
        names.sort();
        let summary = Summary {
            version: env!("CARGO_PKG_VERSION"),
            platform: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            input: options.input,
            output: options.output,
            position: options.position.as_ref().unwrap_or(&scenario.initial.position),
            frequencies: self.omega.len(),
            poles: self.poles.as_ref().ok().map(Vec::len),
            near: &options.near,
            modes: (!options.near.is_empty()).then_some(self.modes.len()),
            left_out: self.left_out(),
            warnings: &self.warnings,
            files: &names,
            scenario,
        };
        write_json(&directory.join("response.json"), &summary)
    }
}

fn complex_table(header: &str, omega: &[f64], values: &[Complex<f64>]) -> String {
    let mut text = format!("{header}\n");
    omega.iter().zip(values).for_each(|(&omega, value)| append_row(&mut text, &[omega, value.re, value.im]));
    text
}
