//! The short-memory principle.

use fvi_core::ParameterError;

use crate::plain_sum::PlainSum;

/// Number of lags L that are kept: the smallest L for which Σ_{n>L} |w_n| ≤ `tolerance` · Σ_{n≥1} |w_n|.
///
/// The truncated part is then at most tolerance · Σ|w_n| · max|x|: the bound of \[Podlubny\], §7.3, with the
/// actual weights in place of the asymptotic M L^{−β}/|Γ(1 − β)|, which would give a larger L.
pub fn window_of(weights: &[f64], tolerance: f64) -> usize {
    let all: f64 = weights.iter().skip(1).map(|weight| weight.abs()).sum();
    let mut beyond = 0.0;
    for n in (1..weights.len()).rev() {
        beyond += weights[n].abs();
        if beyond > tolerance * all {
            return n;
        }
    }
    0
}

/// The plain sum over the last [`window_of`] samples \[Podlubny\].
///
/// # Errors
/// If there is no weight, no channel or no capacity.
pub fn short_memory(
    weights: &[f64],
    channels: usize,
    capacity: usize,
    tolerance: f64,
) -> Result<PlainSum, ParameterError> {
    PlainSum::new(&weights[..weights.len().min(window_of(weights, tolerance) + 1)], channels, capacity)
}
