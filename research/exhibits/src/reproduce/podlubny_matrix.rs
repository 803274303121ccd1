//! Podlubny's matrix method: triangular strip matrices for linear fractional differential equations with
//! constant coefficients.
//!
//! An independent benchmark: it discretises the equation in the positions directly, with weights from a
//! separate recursion.

use fvi_core::ParameterError;

/// A term a D^β y of the equation's left side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LinearTerm {
    /// a.
    pub(super) coefficient: f64,
    /// β, 0 ≤ β ≤ 2.
    pub(super) order: f64,
}

/// Solves a linear fractional differential equation whose solution starts from rest.
///
/// ```text
/// Σ_m a_m D^{β_m} y = f(t) ,     y(0) = 0, and y′(0) = 0 where an order exceeds 1
/// Σ_m a_m B^{(β_m)} Y = F ,
/// (B^{(β)})_{kj} = h^{−β} (−1)^{k−j} binom(β, k−j) for k ≥ j, 0 above the diagonal
/// ```
///
/// B^{(β)} is the triangular strip matrix of the backward difference of order β: (1, −1)/h for the first
/// derivative, (1, −2, 1)/h² for the second, Grünwald–Letnikov weights between. The zero initial values, as
/// many as the largest order rounded up, replace the same number of first rows. What remains is
/// a lower triangular Toeplitz system, solved by forward substitution in N² operations with N numbers of
/// storage. Every difference is of first order, and so is the solution.
///
/// Returns y(k h), k = 0…`steps`.
///
/// # Errors
/// If h is not positive and finite, an order is outside [0, 2], or the diagonal Σ_m a_m h^{−β_m} is zero or
/// not finite.
///
/// Source: \[Podlubny00\]; \[PodlubnyEtAl09\].
pub(super) fn podlubny_matrix_method(
    terms: &[LinearTerm],
    force: impl Fn(f64) -> f64,
    step_size: f64,
    steps: usize,
) -> Result<Vec<f64>, ParameterError> {
    if !(step_size > 0.0 && step_size.is_finite()) {
        let allowed = "greater than 0 and finite";
        return Err(ParameterError { parameter: "step size h", value: step_size, allowed });
    }
    if let Some(term) = terms.iter().find(|term| !(0.0..=2.0).contains(&term.order)) {
        let allowed = "at least 0 and at most 2";
        return Err(ParameterError { parameter: "order β of a term", value: term.order, allowed });
    }
    let strip = strip(terms, step_size, steps + 1);
    let diagonal = strip[0];
    if diagonal == 0.0 || !diagonal.is_finite() {
        let allowed = "finite and not 0";
        return Err(ParameterError { parameter: "diagonal of the strip matrix", value: diagonal, allowed });
    }
    let zeros = terms.iter().map(|term| libm::ceil(term.order) as usize).max().unwrap_or(0);
    let mut values = vec![0.0; steps + 1];
    for k in zeros..=steps {
        let earlier: f64 = strip[1..=k].iter().zip(values[..k].iter().rev()).map(|(c, y)| c * y).sum();
        values[k] = (force(step_size * k as f64) - earlier) / diagonal;
    }
    Ok(values)
}

/// The first column of Σ_m a_m B^{(β_m)}, which determines the Toeplitz matrix.
fn strip(terms: &[LinearTerm], step_size: f64, length: usize) -> Vec<f64> {
    let mut strip = vec![0.0; length];
    for term in terms {
        let mut weight = term.coefficient * libm::pow(step_size, -term.order);
        for (j, entry) in strip.iter_mut().enumerate() {
            if j > 0 {
                weight *= 1.0 - (term.order + 1.0) / j as f64;
            }
            *entry += weight;
        }
    }
    strip
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_fft::sums::max_or_nan;

    /// q̈ + D^{3/2} q + q.
    const PLATE: [LinearTerm; 3] = [
        LinearTerm { coefficient: 1.0, order: 2.0 },
        LinearTerm { coefficient: 1.0, order: 1.5 },
        LinearTerm { coefficient: 1.0, order: 0.0 },
    ];

    /// Largest error on [0, 1] for the force whose solution is t³.
    fn error(steps: usize) -> f64 {
        let force = |t: f64| 6.0 * t + 6.0 / libm::tgamma(2.5) * t.powf(1.5) + t.powi(3);
        let step_size = 1.0 / steps as f64;
        let values = podlubny_matrix_method(&PLATE, force, step_size, steps).unwrap();
        let exact = (0..=steps).map(|k| (step_size * k as f64).powi(3));
        values.iter().zip(exact).fold(0.0, |largest, (y, exact)| max_or_nan(largest, (y - exact).abs()))
    }

    #[test]
    fn the_error_against_an_exact_solution_is_of_first_order() {
        let errors = [32, 64, 128, 256, 512].map(error);
        let orders: Vec<f64> = errors.windows(2).map(|pair| (pair[0] / pair[1]).log2()).collect();
        assert!(orders.iter().all(|order| (order - 1.0).abs() < 0.03), "{orders:?}");
        assert!(errors[4] < 3.0 / 512.0, "{errors:?}");
    }

    #[test]
    fn whole_orders_give_backward_differences() {
        let term = |coefficient, order| LinearTerm { coefficient, order };
        let strip = strip(&[term(3.0, 2.0), term(5.0, 1.0), term(7.0, 0.0)], 0.5, 5);
        assert_eq!(strip, [12.0 + 10.0 + 7.0, -24.0 - 10.0, 12.0, 0.0, 0.0]);
        // y′ = 1 from rest is met exactly.
        let values = podlubny_matrix_method(&[term(1.0, 1.0)], |_| 1.0, 0.25, 4).unwrap();
        assert_eq!(values, [0.0, 0.25, 0.5, 0.75, 1.0]);
    }

    #[test]
    fn what_cannot_be_solved_is_refused_by_name() {
        let refused = |terms: &[LinearTerm], h: f64| {
            podlubny_matrix_method(terms, |_| 1.0, h, 4).unwrap_err().to_string()
        };
        assert!(refused(&PLATE, 0.0).contains("step size h = 0"));
        assert!(refused(&PLATE, f64::NAN).contains("step size"));
        assert!(
            refused(&[LinearTerm { coefficient: 1.0, order: 2.5 }], 0.1).contains("order β of a term = 2.5")
        );
        assert!(refused(&[LinearTerm { coefficient: 0.0, order: 1.0 }], 0.1).contains("diagonal"));
    }
}
