//! Sums of exponentials for powers of time, from Gauss rules on dyadic intervals of rates.

use crate::gauss_jacobi::gauss_jacobi;

/// One term a e^{−λt}.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Term {
    pub(crate) rate: f64,
    pub(crate) amplitude: f64,
}

/// Rules for ∫₀^∞ λ^p e^{−λt} dλ = Γ(p+1) t^{−p−1} on 1 ≤ t ≤ `horizon`, p > −1: a Gauss–Jacobi rule on (0,
/// 1/horizon), Gauss–Legendre rules on the following intervals, whose ends grow by the factor `ratio`, up to
/// λ = `fastest`; `points` nodes in each.
pub(crate) fn power_rules(p: f64, horizon: f64, ratio: f64, fastest: f64, points: usize) -> Vec<Term> {
    let mut end = 1.0 / horizon;
    let scale = libm::pow(end, p + 1.0);
    let rule = gauss_jacobi(points, p).into_iter();
    let mut terms: Vec<Term> =
        rule.map(|(x, weight)| Term { rate: x * end, amplitude: weight * scale }).collect();
    let legendre = gauss_jacobi(points, 0.0);
    while end < fastest {
        let length = end * (ratio - 1.0);
        terms.extend(legendre.iter().map(|(x, weight)| {
            let rate = end + x * length;
            Term { rate, amplitude: weight * length * libm::pow(rate, p) }
        }));
        end *= ratio;
    }
    terms
}

/// Lags at which tables are compared with weights: all small ones, then some in each decade.
pub(crate) fn lags_to_compare(horizon: usize) -> Vec<usize> {
    let mut lags: Vec<usize> = (1..=horizon.min(32)).collect();
    let mut lag = 32.0;
    while lag * 1.15 < horizon as f64 {
        lag *= 1.15;
        lags.push(lag as usize);
    }
    lags.push(horizon);
    lags
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_fft::sums::max_or_nan;

    #[test]
    fn rules_converge_to_powers_of_time() {
        for p in [-0.5, 0.3, 1.0] {
            let mut errors = Vec::new();
            for points in [4, 8, 14] {
                let terms = power_rules(p, 1e6, 2.0, 64.0, points);
                let error = |t: f64| {
                    let sum: f64 = terms.iter().map(|term| term.amplitude * libm::exp(-term.rate * t)).sum();
                    (sum / (libm::tgamma(p + 1.0) * libm::pow(t, -p - 1.0)) - 1.0).abs()
                };
                errors.push([1.0, 7.7, 1e3, 1e6].map(error).into_iter().fold(0.0, max_or_nan));
            }
            assert!(errors[0] > 1e2 * errors[1] && errors[2] < 1e-12, "{p}: {errors:?}");
        }
    }
}
