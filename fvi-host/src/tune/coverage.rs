//! What a loop needs to know of its plant beyond the frequencies at which that was measured.

use super::law::Law;
use super::problem::{Specification, TuningProblem};
use super::sampled::{band, difference, held_from_beyond, sampled_loop};
use fvi_fft::sums::{max_or_nan, min_or_nan};
use nalgebra::Complex;

/// The largest |S| that is allowed for beyond the data, where a specification has no bound on it.
const MS: f64 = 2.0;

/// Part of |1 + L| that may come from beyond the data, by aliases.
const FROM_BEYOND: f64 = 0.05;

/// Logarithm of the ratio of neighbouring frequencies, and how far below the data they go.
const SPACING: f64 = 0.05;
const BELOW: f64 = 1e-3;

/// Checks that the bounds of a specification hold for any phase of L at frequencies that were not measured:
/// that the gain has become small enough above, is large enough below unless the plant is settled there,
/// and that aliases of what was not measured change 1 + L by little.
///
/// # Errors
/// A sentence with the frequency.
pub(super) fn check_covered(problem: &TuningProblem, law: &Law) -> Result<(), String> {
    let Some(measured) = problem.plant.measured() else { return Ok(()) };
    let (plant, sample) = (&problem.plant, problem.controller.sample);
    let [low, high] = measured.band;
    let (ms, mt) = match &problem.specification {
        Specification::Crossover(wanted) => (wanted.ms, wanted.mt),
        Specification::Sensitivity { ms, mt } => (Some(*ms), *mt),
        Specification::Rule { ms, .. } => (*ms, None),
    };
    let ms = ms.unwrap_or(MS);
    // |S| ≤ 1/|1 − |L|| and |T| ≤ |L|/|1 − |L||.
    let most = min_or_nan(1.0 - 1.0 / ms, mt.map_or(1.0, |mt| mt / (1.0 + mt)));
    let least = max_or_nan(1.0 + 1.0 / ms, mt.map_or(1.0, |mt| mt / (mt - 1.0)));
    let open = |omega: f64| {
        let size = sampled_loop(plant, law, sample, Complex::new(0.0, omega)).map(|open| open.norm());
        size.unwrap_or(f64::NAN)
    };
    let end = band(sample);
    for omega in spread(high, end).skip(1) {
        let size = open(omega);
        if size.is_nan() || size > most {
            return Err(format!(
                "the data end at ω = {high:.6}, and |L| is {size:.3} at {omega:.6}, below π/`controller.sample`: where nothing \
                 was measured it must be below {most:.3}"
            ));
        }
    }
    if !measured.is_settled() {
        for omega in spread(BELOW * low, min_or_nan(low, end)) {
            let size = open(omega);
            if size.is_nan() || size < least {
                return Err(format!(
                    "the data begin at ω = {low:.6}, where the plant is not settled, and |L| is {size:.3} at {omega:.6}: where \
                     nothing was measured it must be above {least:.3}"
                ));
            }
        }
    }
    for omega in spread(low, min_or_nan(high, end)) {
        let s = Complex::new(0.0, omega);
        let response = law.response(difference(s, sample)).measured;
        let hidden = held_from_beyond(plant, omega, sample, high).map(|part| part * response.norm());
        let whole = sampled_loop(plant, law, sample, s).map(|open| (open + 1.0).norm());
        let part = hidden.zip(whole).map_or(f64::NAN, |(hidden, whole)| hidden / whole);
        if part.is_nan() || part > FROM_BEYOND {
            return Err(format!(
                "the data end at ω = {high:.6}: samples of {sample} fold what lies beyond into {part:.3} of 1 + L at \
                 {omega:.6}, where {FROM_BEYOND} is allowed"
            ));
        }
    }
    Ok(())
}

/// Frequencies in geometric sequence, both ends among them; none where the first is not below the last.
fn spread(from: f64, to: f64) -> impl Iterator<Item = f64> {
    let count = if from < to { (libm::log(to / from) / SPACING).ceil() as usize + 1 } else { 0 };
    let ratio = libm::pow(to / from, 1.0 / count.saturating_sub(1).max(1) as f64);
    (0..count).map(move |k| from * libm::pow(ratio, k as f64))
}
