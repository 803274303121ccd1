//! Statistics of a fit from residuals and their derivatives: standard errors, correlations, and directions in
//! parameter space that the data do not determine.

use fvi_fft::dense::{SingularValues, triangle};
use fvi_fft::sums::max_or_nan;
use nalgebra::{DMatrix, DVector};

/// Probability of each tail outside of an interval: 2.5 %.
const TAIL: f64 = 0.025;

/// The number of standard errors from an estimate to either end of its 95 % interval: for Student's
/// distribution with these degrees of freedom, or with `None` for the normal distribution.
pub(super) fn half_width(degrees_of_freedom: Option<usize>) -> f64 {
    let Some(nu) = degrees_of_freedom else { return 1.959_963_984_540_054 };
    if nu == 0 {
        return f64::INFINITY;
    }
    let nu = nu as f64;
    // P(|T| > t) = I_x(ν/2, ½) with x = ν/(ν + t²).
    let beyond = |t: f64| incomplete_beta(nu / (nu + t * t), 0.5 * nu, 0.5);
    let (mut low, mut high) = (0.0, 1.0);
    while beyond(high) > 2.0 * TAIL {
        high *= 2.0;
    }
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if beyond(middle) > 2.0 * TAIL { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// I_x(a, b), by its continued fraction.
fn incomplete_beta(x: f64, a: f64, b: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return if x <= 0.0 { 0.0 } else { 1.0 };
    }
    // The continued fraction converges fast below the mean; above it I_x(a, b) = 1 − I_{1−x}(b, a).
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(1.0 - x, b, a);
    }
    let logarithm =
        libm::lgamma(a + b) - libm::lgamma(a) - libm::lgamma(b) + a * libm::log(x) + b * libm::log1p(-x);
    let away = |number: f64| if number.abs() < 1e-300 { 1e-300 } else { number };
    let mut c = 1.0;
    let mut d = away(1.0 - (a + b) * x / (a + 1.0)).recip();
    let mut fraction = d;
    for m in 1..2000 {
        let m = f64::from(m);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        for term in [even, odd] {
            d = away(1.0 + term * d).recip();
            c = away(1.0 + term / c);
            fraction *= c * d;
        }
        if (c * d - 1.0).abs() < 1e-15 {
            break;
        }
    }
    libm::exp(logarithm) * fraction / a
}

/// Number of standard deviations by which a sum of squares of standard normal numbers exceeds its expected
/// value, by the cube-root approximation of \[WilsonHilferty31\].
pub(super) fn excess(sum: f64, degrees_of_freedom: usize) -> f64 {
    let nu = degrees_of_freedom as f64;
    let variance = 2.0 / (9.0 * nu);
    (libm::cbrt(sum / nu) - (1.0 - variance)) / variance.sqrt()
}

/// Covariance of the parameters from the model linearised at the minimum.
#[derive(Clone, Debug)]
pub(super) struct Covariance {
    /// Covariance matrix of the free parameters, in units of the variance of a residual, without the
    /// directions that the data do not determine.
    pub(super) matrix: DMatrix<f64>,
    /// Singular values of the derivatives, each column scaled to length 1, in descending order.
    pub(super) singular_values: Vec<f64>,
    /// Directions in parameter space along which the predictions do not change: components by parameter, the
    /// largest one scaled to 1.
    pub(super) undetermined: Vec<Vec<f64>>,
    /// How many of them are not known one by one, since there are fewer data than parameters: the last entry
    /// stands for all of these.
    pub(super) open: usize,
}

impl Covariance {
    /// Covariance for the derivatives J; `accuracy` is the relative accuracy of its entries, `typical` the
    /// typical size of each parameter.
    pub(super) fn of(jacobian: &DMatrix<f64>, accuracy: f64, typical: &[f64]) -> Self {
        let count = jacobian.ncols();
        let norms: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
        let effect = |index: usize| norms[index] * typical[index];
        let largest = (0..count).map(effect).fold(0.0, max_or_nan);
        let is_dead = |index: usize| norms[index] == 0.0 || effect(index) <= 1e-3 * accuracy * largest;
        let scale: Vec<f64> =
            (0..count).map(|index| if is_dead(index) { 0.0 } else { norms[index].recip() }).collect();
        let scaled =
            DMatrix::from_fn(jacobian.nrows(), count, |row, column| jacobian[(row, column)] * scale[column]);
        let (triangle, _) = triangle(scaled, &DVector::zeros(jacobian.nrows()));
        let Some(SingularValues { values, v_t, .. }) = SingularValues::of(triangle) else {
            let matrix = DMatrix::from_element(count, count, f64::NAN);
            return Self { matrix, singular_values: Vec::new(), undetermined: Vec::new(), open: 0 };
        };
        let first = values.iter().copied().fold(0.0, max_or_nan);
        let mut matrix = DMatrix::zeros(count, count);
        let mut undetermined = Vec::new();
        for k in 0..count {
            // With fewer residuals than parameters there are fewer values.
            let value = values.get(k).copied().unwrap_or(0.0);
            if value > accuracy * first {
                let direction: Vec<f64> = (0..count).map(|index| v_t[(k, index)] * scale[index]).collect();
                for row in 0..count {
                    for column in 0..count {
                        matrix[(row, column)] += direction[row] * direction[column] / (value * value);
                    }
                }
            }
        }
        for index in (0..count).filter(|&index| is_dead(index)) {
            let mut direction = vec![0.0; count];
            direction[index] = 1.0;
            undetermined.push(direction);
        }
        for k in 0..values.len() {
            if values[k] > accuracy * first {
                continue;
            }
            let alive: f64 =
                (0..count).filter(|&index| !is_dead(index)).map(|index| v_t[(k, index)].powi(2)).sum();
            if alive > 0.5 {
                let direction: Vec<f64> = (0..count).map(|index| v_t[(k, index)] * scale[index]).collect();
                let share = |index: usize| direction[index] / typical[index];
                let lead = (0..count)
                    .map(share)
                    .fold(0.0, |lead: f64, x| if x.abs() > lead.abs() { x } else { lead });
                undetermined.push((0..count).map(|index| share(index) / lead).collect());
            }
        }
        let dead = (0..count).filter(|&index| is_dead(index)).count();
        let open = count.saturating_sub(values.len() + dead);
        if open > 0 {
            // Fewer data than parameters: none of them is determined by itself.
            undetermined.push((0..count).map(|index| if is_dead(index) { 0.0 } else { 1.0 }).collect());
        }
        Self { matrix, singular_values: values.iter().copied().collect(), undetermined, open }
    }

    /// True if a parameter has a component in a direction that is not determined.
    pub(super) fn is_undetermined(&self, index: usize) -> bool {
        self.undetermined.iter().any(|direction| direction[index].abs() > 1e-3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_tables() {
        for (nu, t) in [(1, 12.706_204_736), (2, 4.302_652_730), (10, 2.228_138_852), (100, 1.983_971_519)] {
            assert!((half_width(Some(nu)) - t).abs() < 1e-8 * t, "{nu}: {}", half_width(Some(nu)));
        }
        assert!((half_width(Some(100_000)) - half_width(None)).abs() < 1e-4);
    }

    #[test]
    fn sums_of_squares_are_judged() {
        // The upper 0.1 % of 10 and 1000 degrees of freedom begin at 29.588 and 1143.917.
        for (nu, sum) in [(10, 29.588), (1000, 1143.917)] {
            assert!((excess(sum, nu) - 3.090).abs() < 0.02, "{}", excess(sum, nu));
        }
    }

    #[test]
    fn a_sum_is_determined_and_a_difference_is_not() {
        let jacobian = DMatrix::from_row_slice(3, 3, &[1.0, 2.0, 0.0, 2.0, 4.0, 1.0, 3.0, 6.0, 0.0]);
        let found = Covariance::of(&jacobian, 1e-9, &[1.0; 3]);
        assert_eq!(found.undetermined.len(), 1);
        let direction = &found.undetermined[0];
        assert!(
            (direction[0] / direction[1] + 2.0).abs() < 1e-9 && direction[2].abs() < 1e-9,
            "{direction:?}"
        );
        assert!(found.is_undetermined(0) && found.is_undetermined(1) && !found.is_undetermined(2));
    }

    #[test]
    fn a_parameter_without_effect_is_told() {
        let jacobian = DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 2.0, 0.0]);
        let found = Covariance::of(&jacobian, 1e-9, &[1.0; 2]);
        assert_eq!(found.undetermined, [vec![0.0, 1.0]]);
        assert!((found.matrix[(0, 0)] - 0.2).abs() < 1e-15);
    }

    #[test]
    fn fewer_data_than_parameters_determine_none() {
        let found = Covariance::of(&DMatrix::from_row_slice(1, 2, &[1.0, 1.0]), 1e-9, &[1.0; 2]);
        assert!(found.is_undetermined(0) && found.is_undetermined(1) && found.open == 1);
    }
}
