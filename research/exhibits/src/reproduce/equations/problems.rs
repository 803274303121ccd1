//! Published test problems: the scenario, and the same equations as functions for the methods of the
//! literature.

use fvi_core::max_or_nan;
use fvi_rivals::FractionalEquation;
use fvi_scenario::language::{Document, InputError};
use fvi_scenario::scenario::Scenario;
use std::f64::consts::PI;
use std::path::Path;

/// The text of a file of the repository's `examples/scenarios/equations`, of which the package has a copy.
macro_rules! carried {
    ($name:literal) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/equations/", $name))
    };
}

/// What is known of a solution.
pub(super) enum Known {
    /// The first unknowns at any time.
    Formula(fn(f64) -> Vec<f64>),
    /// The table beside the scenario, its name and its content.
    Table(&'static str, &'static str),
}

/// A test problem.
pub(super) struct Problem {
    /// Name of its files.
    pub(super) name: &'static str,
    pub(super) title: &'static str,
    text: &'static str,
    /// Orders, initial values and functions of unknowns whose orders are at most 1.
    orders: &'static [f64],
    initial: &'static [f64],
    right: fn(f64, &[f64], &mut [f64]),
    jacobian: fn(f64, &[f64], &mut [f64]),
    pub(super) end: f64,
    /// Steps of the coarsest grid of the methods of the literature, whose multiples meet the known times.
    pub(super) coarsest: usize,
    known: Known,
}

/// Γ.
fn gamma(x: f64) -> f64 {
    libm::tgamma(x)
}

/// Row by row.
fn linear(rows: &[f64], x: &[f64], f: &mut [f64]) {
    for (row, value) in rows.chunks(x.len()).zip(f) {
        *value = row.iter().zip(x).map(|(entry, x)| entry * x).sum();
    }
}

const STIFF: [f64; 9] = [-10000.6, 0.0, 1.2, -0.15, -0.28, -0.2, 1.0, -0.5, -1.8];

fn stiff_solution(t: f64) -> Vec<f64> {
    let root = t.sqrt();
    vec![0.5 * root + 0.8 * t + 1.0, t * root + t * t * root + 1.0, t * t + t * t * root + 1.0]
}

fn stiff_right(t: f64, x: &[f64], f: &mut [f64]) {
    let solution = stiff_solution(t);
    let away = [x[0] - solution[0], x[1] - solution[1], x[2] - solution[2]];
    linear(&STIFF, &away, f);
    f[0] += 0.5 * gamma(1.5) + 0.8 / gamma(1.5) * t.sqrt();
    f[1] += gamma(2.5) * t + gamma(3.5) / 2.0 * t * t;
    f[2] += 2.0 / gamma(2.5) * t * t.sqrt() + gamma(3.5) / 2.0 * t * t;
}

const FIVE: [f64; 25] = [
    41.0, 41.0, -38.0, 40.0, -2.0, -79.0, 81.0, 2.0, 0.0, -2.0, 20.0, -60.0, 20.0, -20.0, -8.0, -22.0, 58.0,
    -24.0, 20.0, -4.0, 1.0, 1.0, -2.0, -4.0, -2.0,
];

fn five_right(_: f64, x: &[f64], f: &mut [f64]) {
    linear(&FIVE, x, f);
    f.iter_mut().for_each(|value| *value /= 8.0);
}

fn five_slopes(_: f64, _: &[f64], slopes: &mut [f64]) {
    slopes.iter_mut().zip(FIVE).for_each(|(slope, entry)| *slope = entry / 8.0);
}

/// Σ of six terms by half orders, z_k = D^{k/2} x.
fn terms_right(t: f64, z: &[f64], f: &mut [f64]) {
    f[..5].copy_from_slice(&z[1..]);
    f[5] = 6.0 * t.cos() - z[5] - z[4] - 4.0 * z[2] - z[1] - 4.0 * z[0];
}

fn terms_slopes(_: f64, _: &[f64], slopes: &mut [f64]) {
    slopes.fill(0.0);
    (0..5).for_each(|k| slopes[6 * k + k + 1] = 1.0);
    slopes[30..].copy_from_slice(&[-4.0, -1.0, -4.0, 0.0, -1.0, -1.0]);
}

fn power_right(t: f64, x: &[f64], f: &mut [f64]) {
    let given = 40320.0 / gamma(8.5) * t.powf(7.5) - 3.0 * gamma(5.25) / gamma(4.75) * t.powf(3.75);
    let cube = (1.5 * t.powf(0.25) - t.powi(4)).powi(3);
    f[0] = given + 2.25 * gamma(1.5) + cube - x[0].abs().powf(1.5);
}

fn roots_right(t: f64, x: &[f64], f: &mut [f64]) {
    f[0] = (((x[1] - 0.5) * (x[2] - 0.3)).max(0.0).powf(1.0 / 6.0) + t.sqrt()) / PI.sqrt();
    f[1] = gamma(2.2) * (x[0] - 1.0);
    f[2] = gamma(2.8) / gamma(2.2) * (x[1] - 0.5);
}

/// The two infinite slopes at the start are left out, as the published programs do.
fn roots_slopes(_: f64, x: &[f64], slopes: &mut [f64]) {
    slopes.fill(0.0);
    let (y, z) = (x[1] - 0.5, x[2] - 0.3);
    if y > 0.0 && z > 0.0 {
        let root = (y * z).powf(1.0 / 6.0) / PI.sqrt() / 6.0;
        (slopes[1], slopes[2]) = (root / y, root / z);
    }
    slopes[3] = gamma(2.2);
    slopes[7] = gamma(2.8) / gamma(2.2);
}

fn cubic_right(t: f64, x: &[f64], f: &mut [f64]) {
    let solution = 1.0 + t.powf(2.0 / 3.0);
    let slope = gamma(5.0 / 3.0) / gamma(4.0 / 3.0) * t.cbrt();
    f[0] = t / 10.0 * (x[0].powi(3) - solution.powi(3)) + slope;
}

/// The problems of the work–precision pictures.
pub(super) const PROBLEMS: [Problem; 7] = [
    Problem {
        name: "relaxation",
        title: "D^0.6 x = −10 x, to 5",
        text: carried!("relaxation.toml"),
        orders: &[0.6],
        initial: &[1.0],
        right: |_, x, f| f[0] = -10.0 * x[0],
        jacobian: |_, _, slopes| slopes[0] = -10.0,
        end: 5.0,
        coarsest: 20,
        known: Known::Table("relaxation-reference.csv", carried!("relaxation-reference.csv")),
    },
    Problem {
        name: "singular-start",
        title: "nonlinear, x = t⁸ − 3 t^4.25 + 9/4 √t, to 1",
        text: carried!("singular-start.toml"),
        orders: &[0.5],
        initial: &[0.0],
        right: power_right,
        jacobian: |_, x, slopes| slopes[0] = -1.5 * x[0].abs().sqrt() * x[0].signum(),
        end: 1.0,
        coarsest: 16,
        known: Known::Formula(|t| vec![t.powi(8) - 3.0 * t.powf(4.25) + 2.25 * t.sqrt()]),
    },
    Problem {
        name: "cubic",
        title: "order ⅓, x = 1 + t^⅔, to 1",
        text: carried!("published/fhbvm-cubic.toml"),
        orders: &[1.0 / 3.0],
        initial: &[1.0],
        right: cubic_right,
        jacobian: |t, x, slopes| slopes[0] = 0.3 * t * x[0] * x[0],
        end: 1.0,
        coarsest: 16,
        known: Known::Formula(|t| vec![1.0 + t.powf(2.0 / 3.0)]),
    },
    Problem {
        name: "stiff",
        title: "three unknowns, rates 1 to 10⁴, to 1",
        text: carried!("published/fractionaldiffeq-stiff.toml"),
        orders: &[0.5; 3],
        initial: &[1.0; 3],
        right: stiff_right,
        jacobian: |_, _, slopes| slopes.copy_from_slice(&STIFF),
        end: 1.0,
        coarsest: 16,
        known: Known::Formula(stiff_solution),
    },
    Problem {
        name: "roots",
        title: "orders 0.5, 0.2, 0.6, to 5",
        text: carried!("roots.toml"),
        orders: &[0.5, 0.2, 0.6],
        initial: &[1.0, 0.5, 0.3],
        right: roots_right,
        jacobian: roots_slopes,
        end: 5.0,
        coarsest: 20,
        known: Known::Formula(|t| vec![1.0 + t, 0.5 + t.powf(1.2), 0.3 + t.powf(1.8)]),
    },
    Problem {
        name: "terms",
        title: "six terms of orders 0 to 3, to 100",
        text: carried!("published/garrappa-multi-term.toml"),
        orders: &[0.5; 6],
        initial: &[1.0, 0.0, 1.0, 0.0, -1.0, 0.0],
        right: terms_right,
        jacobian: terms_slopes,
        end: 100.0,
        coarsest: 400,
        known: Known::Formula(|t| vec![t.sin() + t.cos()]),
    },
    Problem {
        name: "oscillating",
        title: "five unknowns, 64 oscillations, to 2",
        text: carried!("published/fhbvm-oscillating.toml"),
        orders: &[0.5; 5],
        initial: &[1.0, 2.0, 3.0, 4.0, 5.0],
        right: five_right,
        jacobian: five_slopes,
        end: 2.0,
        coarsest: 1000,
        known: Known::Table(
            "fhbvm-oscillating-reference.csv",
            carried!("published/fhbvm-oscillating-reference.csv"),
        ),
    },
];

impl Problem {
    /// The equations for the methods of the literature.
    pub(super) fn equation(&self) -> FractionalEquation<'_> {
        FractionalEquation {
            orders: self.orders,
            initial: self.initial,
            right: &self.right,
            jacobian: &self.jacobian,
        }
    }

    /// The scenario with a tolerance.
    pub(super) fn scenario(&self, tolerance: f64) -> Result<Scenario, InputError> {
        let document = Document::new(self.name, Path::new(""), self.text);
        let document = match self.known {
            Known::Table(name, content) => document.with_attached(name, content),
            Known::Formula(_) => document,
        };
        let mut values = document.values()?;
        values["time"]["tolerance"] = toml::Value::Float(tolerance);
        Scenario::from_document(document.with_values(&values))
    }

    /// The largest error of what a method with `steps` steps of one length gave, time by time; relative to the
    /// largest known value where that is above 1.
    pub(super) fn error(&self, x: &[f64], steps: usize) -> f64 {
        let (count, step) = (self.orders.len(), self.end / steps as f64);
        let (mut error, mut scale): (f64, f64) = (0.0, 1.0);
        let mut compare = |known: &[f64], index: usize| {
            for (x, known) in x[index * count..].iter().zip(known) {
                error = max_or_nan(error, (x - known).abs());
                scale = scale.max(known.abs());
            }
        };
        match self.known {
            Known::Formula(solution) => {
                (1..=steps).for_each(|index| compare(&solution(index as f64 * step), index));
            }
            Known::Table(_, content) => {
                for line in content.lines().skip(1) {
                    let numbers: Vec<f64> = line.split(',').filter_map(|cell| cell.parse().ok()).collect();
                    let index = (numbers[0] / step).round();
                    if index >= 1.0 && (index * step / numbers[0] - 1.0).abs() < 1e-9 {
                        compare(&numbers[1..], index as usize);
                    }
                }
            }
        }
        error / scale
    }
}
