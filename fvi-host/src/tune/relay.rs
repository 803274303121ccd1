//! A relay in place of the controller: the simulated plant oscillates near its ultimate frequency.

use super::plant::ScenarioPlant;
use crate::run::{Run, RunEnd};
use fvi_scenario::language::Problem;
use fvi_scenario::scenario::Scenario;
use nalgebra::Complex;
use serde::Serialize;
use std::convert::Infallible;
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

/// Result of a relay experiment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RelayResult {
    /// The amplitude d of the relay's output.
    pub amplitude: f64,
    /// ω of the oscillation.
    pub frequency: f64,
    /// Amplitude a of the oscillation: half the difference of the highest and lowest measured value.
    pub oscillation: f64,
    /// 4 d/(π a), the ultimate gain by the describing function.
    pub describing_gain: f64,
    /// |u₁|/|y₁|, by the first harmonics of output and measured value.
    pub harmonic_gain: f64,
    /// The phase of y₁/u₁ in degrees: how far from −180° the point of the plant's response is.
    pub phase: f64,
}

/// Number of expected periods simulated (`PERIODS`), and of those at the end that are evaluated
/// (`LOOKED_AT`).
const PERIODS: f64 = 40.0;
const LOOKED_AT: usize = 10;

/// Largest number of steps of an experiment.
const MOST_STEPS: f64 = 2e7;

/// Proportional gain of the relay, so large that the output is always at a limit.
const STEEP: f64 = 1e12;

/// Simulates the plant under a relay of the given amplitude; `expected` is an estimate of the angular
/// frequency of the oscillation.
///
/// # Errors
/// A sentence, if the scenario cannot be run, a step fails, or it does not oscillate.
pub(super) fn experiment(
    plant: &ScenarioPlant,
    (amplitude, sign): (f64, f64),
    expected: f64,
    stop: &AtomicBool,
) -> Result<RelayResult, String> {
    let sample = plant.controller.sample;
    let rest = plant.rest();
    let mut values = plant.values.clone();
    let mut put = |key: &str, value: toml::Value| {
        if let Some(toml::Value::Table(table)) = values.get_mut("controller") {
            table.insert(key.to_owned(), value);
        }
    };
    // A step of the setpoint during the first sample starts the oscillation.
    let kick = format!("{rest:?} + {:?}*step({:?} - t)", (1.0 + rest.abs()) * sign, 0.5 * sample);
    put("setpoint", kick.into());
    put("kp", (STEEP * sign).into());
    put("limits", toml::Value::Array(vec![(-amplitude).into(), amplitude.into()]));
    let document = plant.document.with_values(&values);
    let steps = (PERIODS * 2.0 * PI / expected / plant.scenario.time.step).ceil();
    if steps > MOST_STEPS {
        return Err(format!("the relay experiment would take {steps:e} steps, more than {MOST_STEPS:e}"));
    }
    let scenario =
        Scenario::from_document(document).and_then(|scenario| scenario.ending_after(steps as usize));
    let scenario = scenario.map_err(|error| error.to_string())?;
    let mut run = Run::of(&scenario).start().map_err(|error| error.to_string())?;
    let (mut times, mut outputs, mut measured) = (Vec::new(), Vec::new(), Vec::new());
    let every = (sample / scenario.time.step).round() as usize;
    let Ok(end) = run.drive(stop, |portion| {
        portion.states(|step, state| {
            if step % every == 0 {
                times.push(state.time);
                outputs.push(state.columns[0]);
                measured.push(state.columns[2] - rest);
            }
            Ok::<_, Infallible>(())
        })
    });
    match end {
        RunEnd::Completed => {}
        other => return Err(format!("the relay experiment ended early: {other:?}")),
    }
    // Times at which the measured value crosses its rest value upwards, interpolated between samples.
    let passages: Vec<f64> = (1..times.len())
        .filter(|&k| measured[k - 1] < 0.0 && measured[k] >= 0.0)
        .map(|k| times[k - 1] - measured[k - 1] * (times[k] - times[k - 1]) / (measured[k] - measured[k - 1]))
        .collect();
    let too_few = || {
        format!(
            "the relay experiment has {} periods of the {PERIODS} that were expected: it does not oscillate about its rest",
            passages.len()
        )
    };
    let count = passages.len();
    let first = count.checked_sub(LOOKED_AT + 1).map(|at| passages[at]).ok_or_else(too_few)?;
    let last = passages[count - 1];
    let periods: Vec<f64> =
        passages[count - 1 - LOOKED_AT..].windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mean = (last - first) / LOOKED_AT as f64;
    if periods.iter().any(|period| (period - mean).abs() > 0.1 * mean + 2.0 * sample) {
        return Err(format!("the relay experiment has no steady period: the last ones are {periods:.4?}"));
    }
    let frequency = 2.0 * PI / mean;
    let within = |time: f64| time >= first && time < last;
    let seen: Vec<usize> = (0..times.len()).filter(|&k| within(times[k])).collect();
    let size = |fold: fn(f64, f64) -> f64, start: f64| seen.iter().map(|&k| measured[k]).fold(start, fold);
    let oscillation = 0.5 * (size(f64::max, f64::NEG_INFINITY) - size(f64::min, f64::INFINITY));
    let harmonic = |values: &[f64]| -> Complex<f64> {
        seen.iter().map(|&k| Complex::new(0.0, -frequency * times[k]).exp() * values[k]).sum()
    };
    // The output is held until the next sample.
    let turn = Complex::new(0.0, frequency * sample);
    let held = (Complex::new(1.0, 0.0) - (-turn).exp()) / turn;
    let (of_output, of_measured) = (harmonic(&outputs) * held, harmonic(&measured));
    let ratio = of_measured / of_output;
    Ok(RelayResult {
        amplitude,
        frequency,
        oscillation,
        describing_gain: sign * 4.0 * amplitude / (PI * oscillation),
        harmonic_gain: sign * ratio.norm().recip(),
        phase: libm::atan2((ratio * sign).im, (ratio * sign).re).to_degrees(),
    })
}

/// The error for a relay experiment on a plant that is not given as a scenario.
pub(super) fn needs_scenario() -> Problem {
    Problem::Incompatible {
        with: "a plant without `scenario`".to_owned(),
        allowed: "a relay on a scenario, which is simulated; the ultimate point of others is known exactly"
            .to_owned(),
    }
}
