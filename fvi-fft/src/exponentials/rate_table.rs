//! Tables for the memory of steps of any length: a power of the Laplace variable as a sum of relaxations.
//!
//! ```text
//! s^{−μ} = (sin πμ / π) ∫ λ^{1−μ} (s + λ)^{−1} d ln λ ,
//! t^{μ−1}/Γ(μ) = (sin πμ / π) ∫ λ^{1−μ} e^{−λt} d ln λ
//! ```
//!
//! The integrals over ln λ are those of analytic functions that decay at both ends, for which the trapezoidal
//! rule converges like e^{−π²/d} in its spacing d. Its slowest and fastest nodes are replaced by fewer
//! (`rate_rules.rs`), so that the number of rates grows only with the logarithm of the ratio of horizon and
//! shortest step.
//!
//! Other kernels have other densities in place of the power of λ (`spectrum.rs`).

use std::f64::consts::PI;
use std::fmt;

use crate::Aligned;
use crate::exponentials::rate_rules::{
    Compression, Relaxation, Responses, early_responses, late_responses, responses_beyond, responses_within,
};
use crate::exponentials::spectrum::Spectrum;
use crate::quadrature::inverse::power;
use crate::transfer::TransferFunction;
use fvi_core::{ParameterError, RateTable, Real, RungeKutta};
use nalgebra::SMatrix;

/// Smallest relative tolerance of a table: below it rounding dominates.
pub const SMALLEST_TOLERANCE: f64 = 1e-14;

/// Rates per block of fvi-core's memory.
const BLOCK: usize = 4;

/// The table of D^`exponent` for a method, for steps of at least `shortest` and times up to `horizon`, with
/// the weights of the history within the relative tolerance `tolerance`.
///
/// # Errors
/// If the exponent is outside (−1, 2), the lengths are outside [10⁻²⁸⁰, 10²⁸⁰], the horizon is shorter than
/// the shortest step, or the tolerance is outside [10⁻¹⁴, 10⁻¹].
pub fn rate_table<T: Real, const R: usize>(
    method: &RungeKutta<R>,
    exponent: f64,
    shortest: f64,
    horizon: f64,
    tolerance: f64,
) -> Result<RateTable<Aligned<T>>, ParameterError> {
    check_ranges(shortest, horizon, tolerance)?;
    let matrix = SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j]);
    let leading = leading(&matrix, exponent)?;
    let relaxations = if exponent == exponent.round() {
        Vec::new()
    } else {
        Power { mu: exponent.ceil() - exponent, jump: (PI * (exponent - exponent.round())).sin().abs() / PI }
            .compressed(early_responses(method, shortest), [shortest, horizon], tolerance)
    };
    let leading = (0..R * R).map(|index| T::of(leading[(index / R, index % R)])).collect();
    Ok(table(exponent, leading, &relaxations, [shortest, horizon]))
}

/// (A⁻¹)^β
fn leading<const R: usize>(
    matrix: &SMatrix<f64, R, R>,
    exponent: f64,
) -> Result<SMatrix<f64, R, R>, ParameterError> {
    if !(exponent > -1.0 && exponent < 2.0) {
        let allowed = "greater than −1 and less than 2";
        return Err(ParameterError { parameter: "exponent", value: exponent, allowed });
    }
    // The same integral as that of the rates, in place of a contour: it needs a thirtieth of the points.
    Ok(match exponent {
        exponent if exponent < 0.0 => matrix * power(matrix, 1.0 + exponent),
        exponent if exponent <= 1.0 => power(matrix, exponent),
        exponent => power(matrix, 1.0) * power(matrix, exponent - 1.0),
    })
}

pub(super) fn check_ranges(shortest: f64, horizon: f64, tolerance: f64) -> Result<(), ParameterError> {
    let range = |accepted, parameter, value, allowed| match accepted {
        true => Ok(()),
        false => Err(ParameterError { parameter, value, allowed }),
    };
    // Beyond, rates and coefficients leave the range of double precision.
    range(
        (1e-280..=1e280).contains(&shortest),
        "shortest step",
        shortest,
        "at least 1e-280 and at most 1e280",
    )?;
    range(
        (shortest..=1e280).contains(&horizon),
        "horizon",
        horizon,
        "at least the shortest step and at most 1e280",
    )?;
    range(
        (SMALLEST_TOLERANCE..=0.1).contains(&tolerance),
        "tolerance",
        tolerance,
        "at least 1e-14 and at most 0.1",
    )
}

fn table<T: Real>(
    exponent: f64,
    leading: Aligned<T>,
    relaxations: &[Relaxation],
    [shortest, horizon]: [f64; 2],
) -> RateTable<Aligned<T>> {
    let filled = relaxations.len().next_multiple_of(BLOCK);
    let numbers = |of: &dyn Fn(&Relaxation) -> f64| {
        let numbers = relaxations.iter().map(|relaxation| T::of(of(relaxation)));
        numbers.chain(std::iter::repeat(T::zero())).take(filled).collect::<Aligned<T>>()
    };
    RateTable {
        exponent,
        leading,
        rates: numbers(&|relaxation| relaxation.rate),
        coefficients: numbers(&|relaxation| relaxation.coefficient),
        shortest,
        horizon,
    }
}

/// Reason why a kernel has no table.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum RateTableError {
    /// A parameter is not allowed.
    Parameter(ParameterError),
    /// No sum of relaxations approximates the kernel within the tolerance.
    ToleranceMissed {
        /// The requested tolerance.
        tolerance: f64,
        /// The error that was reached.
        reached: f64,
    },
}

impl fmt::Display for RateTableError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parameter(error) => error.fmt(f),
            Self::ToleranceMissed { tolerance, reached } => write!(
                f,
                "no relaxations make up this kernel within {tolerance:e} for steps of any length, but to {reached:.1e}: \
                 its singularities must all lie on the negative real axis, poles be simple, and what grows faster than s must vanish like s; \
                 `convolution.family` = \"bdf\" on equal steps takes any kernel"
            ),
        }
    }
}

impl std::error::Error for RateTableError {}

impl From<ParameterError> for RateTableError {
    fn from(error: ParameterError) -> Self {
        Self::Parameter(error)
    }
}

/// Fastest rate, as rate · shortest step: faster relaxations only contribute through c/λ.
pub(super) const ENDLESS: f64 = 1e16;

/// The table of any transfer function whose singularities lie on the negative real axis.
///
/// The sum of relaxations approximates K(s)/s^d within `tolerance`, relative to K, for |s| from the inverse
/// of the horizon to ten times that of the shortest step, Re s ≥ 0. Then those faster than the shortest step
/// or slower than the horizon are merged, which changes responses at times between the two by at most
/// `tolerance`; near both ends the sum is less accurate as a function of s. The table of s^β is that of
/// [`rate_table`], that of a Prony series consists of its terms.
///
/// # Errors
/// As [`rate_table`]; and [`RateTableError::ToleranceMissed`] if K has singularities elsewhere, or a formula
/// is not accurate enough; and for kernels given by weights, which are for equal steps.
pub fn rate_table_of<T: Real, const R: usize>(
    method: &RungeKutta<R>,
    transfer: &TransferFunction,
    shortest: f64,
    horizon: f64,
    tolerance: f64,
) -> Result<RateTable<Aligned<T>>, RateTableError> {
    if let Some(exponent) = transfer.exponent() {
        return Ok(rate_table(method, exponent, shortest, horizon, tolerance)?);
    }
    if let Some(table) = transfer.table() {
        let (parameter, value) = ("number of weights", table.weights().len() as f64);
        return Err(ParameterError { parameter, value, allowed: "none: weights are for equal steps" }.into());
    }
    check_ranges(shortest, horizon, tolerance)?;
    let growth = transfer.growth();
    let (derivatives, exponent) = match growth {
        growth if growth < 0.0 => (0, growth),
        // With one derivative, K/s is an integral over decaying functions, G(t) = L⁻¹[K(s)/s].
        0.0 => (1, 1.0),
        growth if growth <= 1.0 => (1, growth),
        growth => (2, growth),
    };
    let [nodes, ends] = Spectrum { transfer, by: None, derivatives, shortest, horizon, tolerance }
        .relaxations()
        .map_err(|reached| RateTableError::ToleranceMissed { tolerance, reached })?;
    let finished = |mut relaxations: Vec<Relaxation>| {
        relaxations.extend_from_slice(&ends);
        relaxations.sort_by(|a, b| a.rate.total_cmp(&b.rate));
        Ok(table(exponent, Aligned::zeros(0), &relaxations, [shortest, horizon]))
    };
    // A sum of poles is one of relaxations already.
    if transfer.fractions().is_some() {
        return finished(nodes);
    }
    let matrix = SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j]);
    let of_sign = |sign: f64| {
        let nodes: Vec<Relaxation> = nodes
            .iter()
            .filter(|node| node.coefficient * sign > 0.0)
            .map(|node| Relaxation { coefficient: node.coefficient.abs(), ..*node })
            .collect();
        let within = [1.0, 30.0].map(|ratio| responses_beyond(&matrix, ratio * shortest));
        let early = early_responses(method, shortest).into_iter().chain(within).collect();
        let late = late_responses(horizon).into_iter().chain([responses_within(&matrix, horizon)]).collect();
        let closing = Some(ENDLESS / shortest);
        let compression = Compression { early, late, shortest, horizon, tolerance, closing };
        compression.of(&nodes).into_iter().map(move |node| {
            // So that products with steps stay in the range of single precision too.
            let rate = node.rate.min(ENDLESS / shortest);
            let worth = if node.rate > rate { node.coefficient / node.rate * rate } else { node.coefficient };
            Relaxation { rate, coefficient: sign * worth }
        })
    };
    finished(of_sign(1.0).chain(of_sign(-1.0)).collect())
}

/// s^{−μ}
struct Power {
    mu: f64,
    /// sin(πμ)/π, exact to rounding also near an integer order.
    jump: f64,
}

impl Power {
    /// Spacing of the trapezoidal rule at which its relative error is half the tolerance:
    /// 2 |Γ(1−μ + 2πi/d)| / Γ(1−μ), by Stirling's formula.
    fn spacing(&self, tolerance: f64) -> f64 {
        let error = |d: f64| {
            let power = (2.0 * PI / d).powf(0.5 - self.mu);
            2.0 * (2.0 * PI).sqrt() * power * (-PI * PI / d).exp() / libm::tgamma(1.0 - self.mu)
        };
        let (mut fine, mut coarse) = (0.05, 4.0);
        for _ in 0..60 {
            let middle = 0.5 * (fine + coarse);
            if error(middle) < 0.5 * tolerance { fine = middle } else { coarse = middle }
        }
        fine
    }

    /// The trapezoidal rule, slowest node first. Nodes so slow that they are constant up to the horizon, a
    /// geometric series, are merged to one of rate 0; nodes faster than the last contribute less than the
    /// tolerance to any step.
    fn trapezoidal_rule(&self, shortest: f64, horizon: f64, tolerance: f64) -> Vec<Relaxation> {
        let (spacing, ratio) = (self.spacing(tolerance), 1.0 - self.mu);
        let fastest = (100.0 / tolerance).ln() / (1.0 + self.mu) - shortest.ln();
        let standing = (0.01 * tolerance / horizon).ln();
        let count = ((fastest - standing) / spacing).ceil().max(1.0) as usize;
        let at = |k: usize| fastest - k as f64 * spacing;
        let node = |k: usize| Relaxation {
            rate: at(k).exp(),
            coefficient: self.jump * spacing * (ratio * at(k)).exp(),
        };
        let rest = self.jump * spacing * (ratio * at(count)).exp() / libm::expm1(spacing * ratio);
        std::iter::once(Relaxation { rate: 0.0, coefficient: rest })
            .chain((0..=count).rev().map(node))
            .collect()
    }

    /// The rule with its slowest and fastest nodes compressed, for a method with the given responses of the
    /// shortest step.
    fn compressed(
        &self,
        early: Vec<Responses>,
        [shortest, horizon]: [f64; 2],
        tolerance: f64,
    ) -> Vec<Relaxation> {
        let nodes = self.trapezoidal_rule(shortest, horizon, tolerance);
        Compression { early, late: late_responses(horizon), shortest, horizon, tolerance, closing: None }
            .of(&nodes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn radau() -> RungeKutta<3> {
        RungeKutta::radau_iia().unwrap()
    }

    #[test]
    fn the_relaxations_sum_to_the_kernel_over_seventeen_decades() {
        for exponent in [0.05, 0.3, 0.5, 0.97, 1.5, 1.9, -0.4] {
            for (tolerance, most) in [(1e-12, 150), (1e-6, 90)] {
                let table = rate_table::<f64, 3>(&radau(), exponent, 1e-9, 1e8, tolerance).unwrap();
                let (rates, coefficients) = (table.rates.as_ref(), table.coefficients.as_ref());
                assert!(rates.len() <= most, "{} rates for {exponent}, {tolerance:e}", rates.len());
                let mu = exponent.ceil() - exponent;
                for decade in 0..=68 {
                    // The history begins one shortest step back; the stages lie within the step.
                    let time = 1e-8 * 10_f64.powf(f64::from(decade) / 4.25);
                    let terms = rates.iter().zip(coefficients).map(|(rate, c)| c * (-rate * time).exp());
                    let exact = time.powf(mu - 1.0) / libm::tgamma(mu);
                    let error = terms.sum::<f64>() / exact - 1.0;
                    assert!(error.abs() < tolerance, "{exponent}, {tolerance:e}: {error:e} at {time:e}");
                }
            }
        }
    }

    #[test]
    fn tables_for_more_stages_sum_to_the_kernel_too() {
        let method = RungeKutta::<7>::radau_iia().unwrap();
        for exponent in [0.3, 0.9, 1.5, -0.4] {
            for tolerance in [1e-14, 1e-7] {
                let table = rate_table::<f64, 7>(&method, exponent, 1e-9, 1e8, tolerance).unwrap();
                let mu = exponent.ceil() - exponent;
                for decade in 0..=16 {
                    let time = 1e-8 * 10_f64.powi(decade);
                    let nodes = table.rates.as_ref().iter().zip(table.coefficients.as_ref());
                    let sum: f64 = nodes.map(|(rate, c)| c * (-rate * time).exp()).sum();
                    let error = sum * libm::tgamma(mu) / time.powf(mu - 1.0) - 1.0;
                    let allowed = tolerance.max(4e-15);
                    assert!(error.abs() < allowed, "{exponent}, {tolerance:e}: {error:e} at {time:e}");
                }
            }
        }
    }

    #[test]
    fn whole_orders_need_no_rates() {
        for exponent in [0.0, 1.0] {
            let table = rate_table::<f64, 3>(&radau(), exponent, 1e-3, 1.0, 1e-12).unwrap();
            assert!(table.rates.as_ref().is_empty());
        }
    }

    #[test]
    fn what_no_table_serves_is_refused() {
        let table = |exponent, shortest, horizon, tolerance| {
            rate_table::<f64, 3>(&radau(), exponent, shortest, horizon, tolerance).is_ok()
        };
        assert!(table(0.5, 0.1, 1.0, 1e-12) && table(0.5, 1.0, 1.0, 1e-12));
        assert!(!table(2.0, 0.1, 1.0, 1e-12) && !table(0.5, 0.0, 1.0, 1e-12));
        assert!(!table(0.5, 0.1, 0.01, 1e-12) && !table(0.5, 0.1, f64::NAN, 1e-12));
        assert!(!table(0.5, 0.1, 1.0, 1e-16));
    }
}
