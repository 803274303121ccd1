//! The L1 formula of the fractional derivative.

use fvi_core::ParameterError;

/// Checks order and step: 0 < β < 1, and h positive and finite.
pub(crate) fn check_order(order: f64, step: f64) -> Result<(), ParameterError> {
    if !(order > 0.0 && order < 1.0) {
        let allowed = "greater than 0 and less than 1, where the L1 formula is";
        return Err(ParameterError { parameter: "order", value: order, allowed });
    }
    if !(step > 0.0 && step.is_finite()) {
        return Err(ParameterError { parameter: "step", value: step, allowed: "positive and finite" });
    }
    Ok(())
}

/// The first `count` weights of the L1 formula for D^β, 0 < β < 1, of a signal that is zero before its first
/// sample and linear between samples:
///
/// ```text
/// w_0 = h^{−β}/Γ(2−β) ,   w_n = w_0 ((n+1)^{1−β} − 2 n^{1−β} + (n−1)^{1−β}) .
/// ```
///
/// Second differences are computed from their series, so that each weight is accurate at any lag.
///
/// Source: \[OldhamSpanier74\], §8.2.
///
/// # Errors
/// If β is outside (0, 1) or h not positive and finite.
pub fn l1_weights(order: f64, step: f64, count: usize) -> Result<Vec<f64>, ParameterError> {
    check_order(order, step)?;
    let leading = libm::pow(step, -order) / libm::tgamma(2.0 - order);
    Ok((0..count).map(|n| leading * second_difference(1.0 - order, n)).collect())
}

/// (n+1)^p − 2 n^p + (n−1)^p, where powers of negative numbers count as 0.
pub(crate) fn second_difference(p: f64, n: usize) -> f64 {
    match n {
        0 => 1.0,
        1 => libm::pow(2.0, p) - 2.0,
        _ => {
            // 2 n^p Σ_{m≥1} binom(p, 2m) n^{−2m}
            let square = (n as f64) * (n as f64);
            let (mut term, mut total) = (1.0, 0.0);
            for m in 1..60 {
                let j = 2.0 * f64::from(m);
                term *= (p - j + 2.0) * (p - j + 1.0) / ((j - 1.0) * j * square);
                total += term;
                if term.abs() < 1e-18 * total.abs() {
                    break;
                }
            }
            2.0 * libm::pow(n as f64, p) * total
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_differences_are_those_of_powers() {
        for p in [0.1, 0.5, 0.9] {
            for n in 2..40 {
                let x = f64::from(n);
                let plain = (x + 1.0).powf(p) - 2.0 * x.powf(p) + (x - 1.0).powf(p);
                let series = second_difference(p, n as usize);
                assert!((plain - series).abs() < 1e-14, "{p}, {n}: {plain}, {series}");
            }
            // The leading term of the series, p(p−1)n^{p−2}, is followed by one of n^{p−4}.
            let far = second_difference(p, 1_000_000) / (p * (p - 1.0) * 1e6f64.powf(p - 2.0));
            assert!((far - 1.0).abs() < 1e-11, "{far}");
        }
    }

    #[test]
    fn straight_signals_have_their_derivative() {
        // D^β t = t^{1−β}/Γ(2−β), with samples x_k = (k+1)h: the signal leaves zero a step before the first.
        let (order, step) = (0.4, 0.1);
        let weights = l1_weights(order, step, 50).unwrap();
        for k in [0, 1, 2, 20, 49] {
            let sum: f64 = (0..=k).map(|n| weights[n] * (k + 1 - n) as f64 * step).sum();
            let exact = ((k + 1) as f64 * step).powf(1.0 - order) / libm::tgamma(2.0 - order);
            assert!((sum / exact - 1.0).abs() < 1e-12, "{k}: {sum}, {exact}");
        }
    }

    #[test]
    fn orders_beyond_one_are_refused() {
        for order in [0.0, 1.0, f64::NAN] {
            assert!(l1_weights(order, 1.0, 3).is_err());
        }
        assert!(l1_weights(0.5, 0.0, 3).is_err());
    }
}
