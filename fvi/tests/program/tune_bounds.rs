//! `fvi tune` on plants of the literature and on random ones: every bound of a specification holds for the
//! sampled loop, which arithmetic of its own judges, or the exit code is 1 and what is missed is said.
//!
//! Every fourth plant of the literature and every twentieth of the random ones, each for one of the
//! specifications; with `FVI_TUNINGS=n` every n-th, with `FVI_TUNINGS=all` each of them for all.

use crate::sampled_loop::{Gains, Rational, Reached, SampledLoop};
use crate::workplace::{Workplace, text};
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;

/// Π (1 + T s)
fn lags(times: &[f64]) -> Vec<Vec<f64>> {
    times.iter().map(|&time| vec![1.0, time]).collect()
}

fn plant(gain: f64, above: &[f64], below: &[f64], delay: f64) -> Rational {
    Rational { gain, above: lags(above), below: lags(below), delay }
}

fn integrating(gain: f64, above: &[f64], below: &[f64], delay: f64) -> Rational {
    let mut made = plant(gain, above, below, delay);
    made.below.push(vec![0.0, 1.0]);
    made
}

fn with_pair(gain: f64, below: &[f64], pair: [f64; 3], delay: f64) -> Rational {
    let mut made = plant(gain, &[], below, delay);
    made.below.push(pair.to_vec());
    made
}

/// The test batch of \[AstromHagglund06\], the examples of \[Skogestad03\], and those of \[Monje08\] and others
/// that the manual has.
fn of_the_literature() -> Vec<Rational> {
    let mut plants = Vec::new();
    for time in [0.1, 1.0, 10.0] {
        plants.push(plant(1.0, &[], &[time], 1.0));
        plants.push(plant(1.0, &[], &[time, time], 1.0));
        plants.push(plant(1.0, &[], &[1.0, time, time], 0.0));
    }
    plants.extend([3, 4, 6, 8].map(|order| plant(1.0, &[], &vec![1.0; order], 0.0)));
    for share in [0.2f64, 0.5, 0.8] {
        plants.push(plant(1.0, &[], &[1.0, share, share.powi(2), share.powi(3)], 0.0));
    }
    for (time, delay) in [(0.9, 0.1), (0.5, 0.5), (0.1, 0.9)] {
        plants.push(integrating(1.0, &[], &[time], delay));
        plants.push(plant(time, &[], &[time, 5.0], delay));
    }
    plants.extend([0.2, 0.6, 1.1].map(|zero| plant(1.0, &[-zero], &[1.0; 3], 0.0)));
    plants.extend([0.3, 1.0].map(|time| with_pair(1.0, &[1.0], [1.0, 1.4 * time, time * time], 0.0)));
    plants.extend([
        plant(1.0, &[], &[1.0, 0.2], 0.0),
        plant(1.0, &[-0.3, 0.08], &[2.0, 1.0, 0.4, 0.2, 0.05, 0.05, 0.05], 0.0),
        plant(2.0, &[15.0], &[20.0, 1.0, 0.1, 0.1], 0.0),
        plant(1.0, &[], &[1.0, 0.2, 0.04, 0.008], 0.0),
        integrating(1.0, &[0.17, 0.17], &[1.0, 1.0, 0.028], 0.0),
        plant(1.0, &[-2.0], &[1.0; 3], 0.0),
        integrating(1.0, &[], &[1.0, 1.0], 0.0),
        plant(1.0, &[], &[20.0, 2.0], 1.0),
        plant(1.0, &[-1.0], &[6.0, 2.0, 2.0], 1.0),
        plant(1.0, &[6.0, 3.0], &[10.0, 8.0, 1.0], 0.3),
        plant(1.0, &[2.0], &[10.0, 0.5], 1.0),
        plant(3.13, &[], &[433.33], 50.0),
        integrating(0.55, &[], &[0.6], 0.05),
        integrating(0.0506, &[], &[], 6.0),
        integrating(1.0, &[], &[], 0.0),
        integrating(1.0, &[], &[1.0], 0.0),
        with_pair(1.0, &[1.0], [1.0, 2.0 / 9.0, 1.0 / 9.0], 0.0),
        with_pair(1.0, &[], [1.0, 0.05, 0.25], 0.0),
    ]);
    plants
}

/// Numbers that look random: xorshift.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, low: f64, high: f64) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        low + (high - low) * (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn plant(&mut self) -> Rational {
        let scale = 10f64.powf(self.roll(-2.0, 2.0));
        let gain = 10f64.powf(self.roll(-1.0, 1.0)) * if self.roll(0.0, 1.0) < 0.2 { -1.0 } else { 1.0 };
        let count = self.roll(1.0, 4.99) as usize;
        let mut below = lags(&vec![0.0; count]);
        below.iter_mut().for_each(|lag| lag[1] = scale * 10f64.powf(self.roll(-1.0, 0.3)));
        match self.roll(0.0, 10.0) as u32 {
            0 | 1 => below[0] = vec![0.0, scale],
            2 | 3 => {
                let (damping, frequency) = (self.roll(0.05, 0.7), 10f64.powf(self.roll(0.0, 0.7)) / scale);
                below.push(vec![1.0, 2.0 * damping / frequency, frequency.powi(-2)]);
            }
            // A motion that grows.
            4 => below[0] = vec![-1.0, scale],
            _ => {}
        }
        let mut above = Vec::new();
        if count > 1 && self.roll(0.0, 1.0) < 0.4 {
            above.push(vec![1.0, scale * self.roll(-0.6, 0.6)]);
        }
        let delay = if self.roll(0.0, 1.0) < 0.6 { scale * self.roll(0.0, 0.8) } else { 0.0 };
        Rational { gain, above, below, delay }
    }
}

/// What is asked for; bounds of a search that has a choice are those of the manual.
#[derive(Debug)]
struct Asked {
    structure: &'static str,
    crossover: Option<[f64; 2]>,
    ms: Option<f64>,
    mt: Option<f64>,
    is_flat: bool,
    sample: f64,
    filter: f64,
}

/// The first frequency at which the phase of the plant has fallen this much from that at rest, in degrees.
fn where_it_has_turned(plant: &Rational, degrees: f64) -> f64 {
    let mut omega = 1e-6;
    let mut last = plant.at(omega);
    let from = if plant.below.iter().any(|factor| factor[0] == 0.0) { 90.0 } else { 0.0 };
    let mut turned = from;
    while turned < degrees && omega < 1e6 {
        omega *= 1.002;
        let next = plant.at(omega);
        turned -= next.times(last.inverse()).phase().to_degrees();
        last = next;
    }
    omega
}

fn specifications(plant: &Rational) -> Vec<Asked> {
    let fast = where_it_has_turned(plant, 150.0);
    let middle = where_it_has_turned(plant, 115.0);
    // A hundredth to a tenth of the time of a radian.
    let asked = |structure, crossover, [ms, mt]: [Option<f64>; 2], part: f64| Asked {
        structure,
        crossover,
        ms,
        mt,
        is_flat: false,
        sample: part / fast,
        filter: 0.1 / fast,
    };
    let crossing = |part: f64, margin: f64| Some([part * middle, margin]);
    vec![
        asked("pi", None, [Some(1.4), None], 0.1),
        asked("pid", crossing(0.9, 60.0), [Some(1.7), None], 0.03),
        asked("pi", None, [Some(1.7), Some(1.3)], 0.02),
        asked("pi", crossing(0.5, 55.0), [None, None], 0.1),
        asked("pd", crossing(1.2, 45.0), [Some(2.0), None], 0.02),
        Asked { is_flat: true, ..asked("pid", crossing(0.7, 50.0), [None, None], 0.1) },
        asked("pd", None, [Some(1.6), None], 0.05),
    ]
}

fn problem(plant: &Rational, asked: &Asked) -> String {
    let filter = if asked.structure == "pi" {
        String::new()
    } else {
        format!("derivative_filter = {:?}\n", asked.filter)
    };
    let mut problem = format!(
        "[plant]\ntransfer = \"{}\"\n[controller]\nstructure = \"{}\"\nsample = {:?}\n{filter}[specification]\n",
        plant.formula(),
        asked.structure,
        asked.sample
    );
    if let Some([crossover, margin]) = asked.crossover {
        let _ = writeln!(problem, "crossover = {crossover:?}\nphase_margin = {margin:?}");
    }
    for (key, bound) in [("ms", asked.ms), ("mt", asked.mt)] {
        if let Some(bound) = bound {
            let _ = writeln!(problem, "{key} = {bound:?}");
        }
    }
    if asked.is_flat {
        problem += "flat_phase = true\n";
    }
    problem
}

/// What is wrong with a tuning; nothing if it meets every bound.
fn wrong(asked: &Asked, record: &Value, found: &Reached) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut holds = |what: &str, value: f64, bound: f64| {
        if value.is_nan() || value > bound {
            wrong.push(format!("{what} is {value} instead of at most {bound}"));
        }
    };
    holds("the number of growing motions", found.growing.abs(), 0.01);
    // A choice keeps Ms ≤ 3 and Mt ≤ 3 or what the phase margin has.
    holds("Ms", found.ms, asked.ms.unwrap_or(if asked.crossover.is_some() { 10.0 } else { 3.0 }) + 2e-5);
    holds("Mt", found.mt, asked.mt.unwrap_or(f64::INFINITY) + 2e-5);
    if let Some([crossover, margin]) = asked.crossover {
        holds("the highest crossover", found.highest_crossover / crossover, 1.0 + 1e-5);
        holds("the crossover asked for", crossover / found.highest_crossover, 1.0 + 1e-5);
        holds("what the phase margin lacks", margin - found.phase_margin, 1e-3);
    }
    // Near π/h the program sums the aliases of a plant that decays like 1/s to some 10⁻⁴.
    let said = record["sampled_margins"]["ms"].as_f64().unwrap_or(f64::NAN);
    holds("the relative error of the Ms that is said", (said / found.ms - 1.0).abs(), 3e-4);
    wrong
}

/// Every so many plants are tuned, each for one specification; with `all` each for all of them.
fn every(otherwise: usize) -> Option<usize> {
    match std::env::var("FVI_TUNINGS") {
        Ok(word) if word == "all" => None,
        Ok(word) => Some(word.parse().unwrap()),
        Err(_) => Some(otherwise),
    }
}

fn bounds_hold(plants: &[Rational], otherwise: usize) {
    let place = Workplace::new();
    let mut failures = Vec::new();
    let (mut met, mut refused) = (0, 0);
    for (index, plant) in plants.iter().enumerate() {
        for (number, asked) in specifications(plant).iter().enumerate() {
            if every(otherwise).is_some_and(|every| index % every != 0 || number != index / every % 7) {
                continue;
            }
            let problem = problem(plant, asked);
            place.write("plant.toml", &problem);
            let output = place.fvi(&["tune", "plant.toml", "--out", "out"]);
            let message = text(&output.stderr);
            match output.status.code() {
                Some(0) => {
                    let file = place.path("out").join("tune.json");
                    let record: Value = serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap();
                    let loop_ = SampledLoop::new(plant, asked.sample, Gains::of(&record));
                    let low = 1e-5 * where_it_has_turned(plant, 115.0);
                    let found = loop_.reached(low, if every(otherwise).is_none() { 100_000 } else { 20_000 });
                    let wrong = wrong(asked, &record, &found);
                    if !wrong.is_empty() {
                        let loop_ = Gains::of(&record);
                        failures.push(format!("{index}.{number}: {wrong:?}\n{loop_:?}\n{problem}"));
                    }
                    met += 1;
                }
                Some(1) => {
                    refused += 1;
                    if std::env::var_os("FVI_TUNINGS").is_some() {
                        println!("{index}.{number} {message}{problem}");
                    }
                    let says = [
                        " instead of at ",
                        "would have to turn it",
                        "keep",
                        "motions",
                        "motion of",
                        "is unstable",
                    ];
                    if !says.iter().any(|part| message.contains(part)) || message.contains("misses: \n") {
                        failures.push(format!("{index}.{number}: {message}\n{problem}"));
                    }
                }
                code => failures.push(format!("{index}.{number}: {code:?} {message}\n{problem}")),
            }
        }
    }
    println!("{met} tuned, {refused} refused");
    assert!(failures.is_empty(), "{} of {met}:\n{}", failures.len(), failures.join("\n"));
    assert!(met > 0);
}

#[test]
fn bounds_hold_for_plants_of_the_literature() {
    bounds_hold(&of_the_literature(), 4);
}

#[test]
fn bounds_hold_for_random_plants() {
    let mut dice = Dice(0x9e37_79b9_7f4a_7c15);
    let plants: Vec<Rational> = (0..200).map(|_| dice.plant()).collect();
    bounds_hold(&plants, 20);
}
