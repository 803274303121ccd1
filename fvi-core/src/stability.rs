//! How large a step the explicit fractional force allows.

use nalgebra::SMatrix;

use crate::error::{ParameterError, check_step_size};
use crate::linear::is_positive_definite;
use crate::real::Real;
use crate::system::{Coefficients, Mass};
use crate::weights::BdfOrder;

/// A damping term as the stability check sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExplicitDamping<T, const N: usize> {
    /// Coefficients ρ.
    pub coefficients: Coefficients<T, N>,
    /// Damping order β = 2α.
    pub damping_order: f64,
    /// Order p of the backward differentiation formula.
    pub bdf_order: BdfOrder,
}

/// Result of the stability check.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stability {
    /// The step is small enough.
    Stable,
    /// The step is too large.
    Unstable {
        /// The largest step that passes the check.
        largest_stable_step: f64,
    },
}

/// Checks the step size of the low-order scheme against the fastest motion the grid can carry.
///
/// The fractional force is explicit. For a potential with the constant Hessian K the motion q_k = (−1)^k v is where growth
/// sets in first, and it does not grow as long as
///
/// ```text
/// (4/h²) M − (1−2κ)² K − Σ_m ρ_m (γ_p(−1)/h)^{β_m}    is positive definite.
/// ```
///
/// On |z| = 1 the left side, as a function of z, can only vanish where (γ_p(z)/h)^β is real; without K that happens at
/// z = −1 alone. `stiffness` is ∂²U/∂q² − ∂F/∂q at the initial point, so for nonlinear problems the check is local. κ = ½
/// takes no account of K: the midpoint rule is stable for every spring.
///
/// # Errors
/// If the step size is not positive and finite.
pub fn check_low_order_stability<T: Real, const N: usize>(
    mass: &Mass<T, N>,
    stiffness: &SMatrix<T, N, N>,
    kappa: T,
    damping: &[ExplicitDamping<T, N>],
    step_size: f64,
) -> Result<Stability, ParameterError> {
    check_step_size(step_size)?;
    let share = (T::one() - T::of(2.0) * kappa) * (T::one() - T::of(2.0) * kappa);
    let symmetric = (stiffness + stiffness.transpose()) * (share * T::of(0.5));
    let stable = |h: f64| {
        // Multiplied by h²/4, which keeps the numbers near those of the mass.
        let quarter = h * h / 4.0;
        let mut margin = mass.matrix().to_matrix() - symmetric * T::of(quarter);
        for term in damping {
            let symbol = libm::pow(term.bdf_order.generating_function(-1.0) / h, term.damping_order);
            margin -= term.coefficients.to_matrix() * T::of(quarter * symbol);
        }
        is_positive_definite(&margin)
    };
    if stable(step_size) {
        return Ok(Stability::Stable);
    }
    let (mut low, mut high) = (step_size, step_size);
    while !stable(low) && low > f64::MIN_POSITIVE {
        (low, high) = (low * 0.5, low);
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if stable(middle) { low = middle } else { high = middle }
    }
    Ok(Stability::Unstable { largest_stable_step: low })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::matrix;

    fn limit(kappa: f64, stiffness: f64, rho: f64, damping_order: f64, p: usize) -> Stability {
        let term = ExplicitDamping {
            coefficients: Coefficients::Diagonal([rho].into()),
            damping_order,
            bdf_order: BdfOrder::new(p).unwrap(),
        };
        let mass = Mass::diagonal([1.0]).unwrap();
        check_low_order_stability(&mass, &matrix![stiffness], kappa, &[term], 100.0).unwrap()
    }

    fn assert_limit(found: Stability, expected: f64) {
        let Stability::Unstable { largest_stable_step } = found else { panic!("{found:?}") };
        assert!((largest_stable_step / expected - 1.0).abs() < 1e-12, "{largest_stable_step} and {expected}");
    }

    #[test]
    fn the_limit_of_a_single_mass_has_a_closed_form() {
        // 4/h² = ρ (γ_p(−1)/h)^β ; γ₁(−1) = 2, γ₂(−1) = 4.
        assert_limit(limit(0.5, 7.0, 3.0, 1.0, 1), 4.0 / (3.0 * 2.0));
        assert_limit(limit(0.5, 7.0, 3.0, 1.5, 2), (4.0 / (3.0 * 8.0f64)).powi(2));
        // Symplectic Euler: h √k = 2.
        assert_limit(limit(0.0, 9.0, 0.0, 0.5, 1), 2.0 / 3.0);
        assert_eq!(limit(0.5, 9.0, 0.0, 0.5, 1), Stability::Stable);
    }
}
