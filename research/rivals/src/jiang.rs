//! The fast L1 formula by a sum of exponentials.

use fvi_core::ParameterError;

use crate::dyadic_exponentials::{Term, lags_to_compare, power_rules};
use crate::exponential_modes::{ExponentialModes, Mode, Modes};
use crate::l1::{check_order, second_difference};

/// Largest number of points of a rule; more do not improve the accuracy.
pub(crate) const MOST_POINTS: usize = 24;

/// The fast evaluation of the L1 formula \[JiangZhangZhangZhang17\]: O(log N) a step.
///
/// The formula is integrated by parts once more, which gives the kernel t^{−1−β} on h ≤ t ≤ T; this is
/// approximated by a sum of exponentials by a Gauss–Jacobi rule next to zero and Gauss–Legendre rules on
/// dyadic intervals. A mode is the integral of its exponential against the signal, interpolated linearly
/// between samples, so that with an exact kernel the sum is that of [`l1_weights`](crate::l1_weights).
///
/// Choices made here: the same number of points on every interval, the smallest for which the resulting
/// weights agree with those of the formula within the relative `tolerance` (the paper bounds the absolute
/// error of t^{−1−β}), and no reduction of the modes afterwards.
///
/// # Errors
/// If β is outside (0, 1), the step is not positive, the tolerance is not reached, or there is no channel or
/// no capacity.
pub fn jiang(
    order: f64,
    step: f64,
    channels: usize,
    capacity: usize,
    tolerance: f64,
) -> Result<ExponentialModes, ParameterError> {
    check_order(order, step)?;
    let (_, modes) = fewest_points(order, step, capacity, tolerance, |points| {
        modes_of(order, step, &kernel_terms(order, capacity, tolerance, points))
    })?;
    ExponentialModes::new(&modes, channels, capacity)
}

/// Σ a e^{−λt} for Γ(1+β) t^{−1−β} between a step and the end, time in steps.
pub(crate) fn kernel_terms(order: f64, capacity: usize, tolerance: f64, points: usize) -> Vec<Term> {
    power_rules(order, capacity as f64 + 1.0, 2.0, fastest_rate(tolerance), points)
}

pub(crate) fn modes_of(order: f64, step: f64, terms: &[Term]) -> Modes {
    let scale = libm::pow(step, -order);
    // t^{−1−β} = Σ a e^{−λt}/Γ(1+β), and β/(Γ(1−β)Γ(1+β)) = sin(πβ)/π.
    let factor = -scale * libm::sin(std::f64::consts::PI * order) / std::f64::consts::PI;
    let mode = |rate: f64, amplitude: f64| {
        let decay = libm::exp(-rate);
        let (newest, before) = straight(rate);
        Mode {
            decay,
            newest: factor * amplitude * decay * newest,
            before: factor * amplitude * decay * before,
        }
    };
    let leading = scale / libm::tgamma(2.0 - order);
    Modes {
        leading,
        local: scale / libm::tgamma(1.0 - order) - leading,
        modes: terms.iter().map(|term| mode(term.rate, term.amplitude)).collect(),
    }
}

/// ∫₀¹ e^{−s(1−v)} v dv = (s − 1 + e^{−s})/s² and ∫₀¹ e^{−s(1−v)} (1−v) dv = (1 − e^{−s} − s e^{−s})/s².
fn straight(s: f64) -> (f64, f64) {
    if s > 0.5 {
        let decay = libm::exp(-s);
        return ((s - 1.0 + decay) / (s * s), (1.0 - decay - s * decay) / (s * s));
    }
    // Σ (−s)^m/(m+2)! and Σ (m+1)(−s)^m/(m+2)!
    let (mut term, mut sums) = (0.5, (0.0, 0.0));
    for m in 0..18 {
        let m = f64::from(m);
        sums.0 += term;
        sums.1 += term * (m + 1.0);
        term *= -s / (m + 3.0);
    }
    sums
}

/// Largest rate: faster exponentials are below the tolerance at the first lag of the history.
pub(crate) fn fastest_rate(tolerance: f64) -> f64 {
    8.0 - 1.5 * libm::log(tolerance)
}

/// The smallest number of points per rule for which the weights agree with those of the formula within the
/// relative tolerance, and the modes.
pub(crate) fn fewest_points(
    order: f64,
    step: f64,
    capacity: usize,
    tolerance: f64,
    modes_of: impl Fn(usize) -> Modes,
) -> Result<(usize, Modes), ParameterError> {
    let refused = |value, allowed| Err(ParameterError { parameter: "tolerance", value, allowed });
    if !(tolerance > 0.0 && tolerance < 1.0) {
        return refused(tolerance, "greater than 0 and less than 1");
    }
    let leading = libm::pow(step, -order) / libm::tgamma(2.0 - order);
    let exact: Vec<(usize, f64)> = lags_to_compare(capacity)
        .into_iter()
        .map(|n| (n, leading * second_difference(1.0 - order, n)))
        .collect();
    for points in 2..=MOST_POINTS {
        let modes = modes_of(points);
        if exact.iter().all(|&(n, weight)| (modes.weight(n) / weight - 1.0).abs() <= tolerance) {
            return Ok((points, modes));
        }
    }
    refused(tolerance, "within what rounding leaves of the weights of a sum of exponentials")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integrals_over_a_step_agree_where_series_and_closed_form_meet() {
        let (below, above) = (straight(0.5), straight(0.5 + 1e-12));
        assert!((below.0 - above.0).abs() < 1e-12 && (below.1 - above.1).abs() < 1e-12);
        assert_eq!(straight(0.0), (0.5, 0.5));
    }
}
