//! Kernel compression: auxiliary variables in place of the history of a fractional integral.

use fvi_core::ParameterError;

use crate::dyadic_exponentials::{Term, power_rules};
use crate::exponential_modes::{ExponentialModes, Mode, Modes};
use crate::jiang::{fastest_rate, fewest_points};
use crate::l1::check_order;

/// Ratio of successive intervals of rates.
pub(crate) const RATIO: f64 = 3.0;

/// Kernel compression \[BaffetHesthaven17\] by composite Gauss–Jacobi rules \[Baffet19\]: O(log N) a step.
///
/// D^β x is the fractional integral of order 1 − β of x′. Its history, from lags of a step or more, has the
/// kernel t^{−β}/Γ(1−β) on h ≤ t ≤ T, which is approximated by a sum of exponentials; each gives an auxiliary
/// variable with φ′ = −λφ + x′, solved exactly for a signal that is linear between samples. The local part is
/// that of the L1 formula, so that with an exact kernel the sum is that of [`l1_weights`](crate::l1_weights).
///
/// Choices made here: the rules of \[Baffet19\] in place of the multipoles of \[BaffetHesthaven17\], on
/// intervals of rates with ratio 3; the smallest number of points for which the resulting weights agree with
/// those of the formula within the relative `tolerance`. The auxiliary variables are driven by differences of
/// samples, whose rounding is not small compared with the weights at large lags.
///
/// # Errors
/// If β is outside (0, 1), the step is not positive, the tolerance is not reached, or there is no channel or
/// no capacity.
pub fn kernel_compression(
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

/// Σ a e^{−λt} for Γ(β) t^{−β} between a step and the end, time in steps.
pub(crate) fn kernel_terms(order: f64, capacity: usize, tolerance: f64, points: usize) -> Vec<Term> {
    power_rules(order - 1.0, capacity as f64 + 1.0, RATIO, fastest_rate(tolerance), points)
}

fn modes_of(order: f64, step: f64, terms: &[Term]) -> Modes {
    let scale = libm::pow(step, -order);
    // t^{−β} = Σ a e^{−λt}/Γ(β), and 1/(Γ(1−β)Γ(β)) = sin(πβ)/π.
    let factor = scale * libm::sin(std::f64::consts::PI * order) / std::f64::consts::PI;
    let mode = |rate: f64, amplitude: f64| {
        let decay = libm::exp(-rate);
        // ∫₀¹ e^{−λ(2−v)} dv
        let driven = factor * amplitude * decay * -libm::expm1(-rate) / rate;
        Mode { decay, newest: driven, before: -driven }
    };
    let leading = scale / libm::tgamma(2.0 - order);
    Modes {
        leading,
        local: -leading,
        modes: terms.iter().map(|term| mode(term.rate, term.amplitude)).collect(),
    }
}
