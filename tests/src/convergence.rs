//! Errors and observed orders of convergence.

use fvi_fft::sums::max_or_nan;

/// Largest distance between two sequences.
pub fn largest_error(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, max_or_nan)
}

/// Slope of the least-squares line through (log h, log error): the observed order.
pub fn observed_order(step_sizes: &[f64], errors: &[f64]) -> f64 {
    let count = errors.len() as f64;
    let x: Vec<f64> = step_sizes.iter().map(|h| h.ln()).collect();
    let y: Vec<f64> = errors.iter().map(|e| e.ln()).collect();
    let (mean_x, mean_y) = (x.iter().sum::<f64>() / count, y.iter().sum::<f64>() / count);
    let covariance: f64 = x.iter().zip(&y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    let variance: f64 = x.iter().map(|x| (x - mean_x).powi(2)).sum();
    covariance / variance
}
