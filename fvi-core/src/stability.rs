//! How large a step the explicit fractional force allows.

use nalgebra::SMatrix;

use crate::coefficients::Coefficients;
use crate::error::{ParameterError, check_step_size};
use crate::galerkin::Galerkin;
use crate::linear::is_positive_definite_in_place;
use crate::real::Real;
use crate::space::Block;
use crate::system::Mass;
use crate::weights::BdfOrder;

/// A damping term as input of the stability check.
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
        /// The largest step that passes the check; 0 if there is none.
        largest_stable_step: f64,
    },
}

/// Checks the step size of a scheme with explicit damping against the fastest motion that the grid can
/// represent.
///
/// The fractional force is explicit. For a potential with the constant Hessian K growth sets in first at the
/// motion q_k = (−1)^k v. Its discrete action per step, with the inner nodes in equilibrium, is L_d on the
/// nodes v, x_1, …, x_{S−1}, −v, and the motion does not grow as long as the quadratic form
///
/// ```text
/// 2 L_d(v, x_1, …, x_{S−1}, −v) − h Σ_m (γ_p(−1)/h)^{β_m} vᵀ ρ_m v
///     is positive definite in (v, x_1, …, x_{S−1}).
/// ```
///
/// For degree 1 this is (4/h²) M − (1−2κ)² K − Σ_m ρ_m (γ_p(−1)/h)^{β_m}. For higher degrees it also requires
/// that no free oscillation turns by half a revolution or more in a step: beyond that the grid aliases it to
/// its mirror image, whose damping has the wrong sign.
///
/// For a symmetric positive semidefinite K that is enough. A motion e^{−ikθ} v, 0 < θ < π, between growth and
/// decay would make the conservative part, which is real along v, equal to h Σ_m (γ_p(e^{iθ})/h)^{β_m} vᵀ ρ_m
/// v. As long as β |arg γ_p(e^{iθ})| < π at every θ the imaginary parts of these terms have one sign, and the
/// motion is undamped. As ρ rises from zero, growth can therefore set in at z = −1 only. The formulas of
/// order 1 and 2 have |arg γ_p| ≤ π/2; the others allow β up to 1.915, 1.687, 1.404 and 1.109 for p = 3, 4,
/// 5, 6. Above, slower motions can grow and this function refuses to judge; the host's check
/// (`fvi_host::stability`) counts them.
///
/// `stiffness` is ∂²U/∂q² − ∂F/∂q at the initial point, of which the symmetric part is taken; for nonlinear
/// problems the check is local. The limit of the midpoint rule does not depend on K: it is stable for every
/// spring.
///
/// # Errors
/// If the step size is not positive and finite, or a damping order is above those limits.
pub fn check_stability<T: Real, const N: usize, const S: usize, const Q: usize>(
    scheme: &Galerkin<T, S, Q>,
    mass: &Mass<T, N>,
    stiffness: &SMatrix<T, N, N>,
    damping: &[ExplicitDamping<T, N>],
    step_size: f64,
) -> Result<Stability, ParameterError> {
    check_step_size(step_size)?;
    for term in damping {
        ParameterError::check(
            term.damping_order <= largest_damping_order(term.bdf_order),
            "damping order of a scheme to be checked",
            term.damping_order,
            "below 2, 2, 1.915, 1.687, 1.404, 1.109 for formulas of order 1…6",
        )?;
    }
    let mass = mass.matrix().to_matrix();
    let symmetric = (stiffness + stiffness.transpose()) * T::of(0.5);
    let form = scheme.alternating_form();
    let stable = |h: f64| {
        // Multiplied by h, which keeps the numbers near those of the mass.
        let square = T::of(h * h);
        let mut rows = [[[[T::zero(); N]; S]; N]; S];
        let numbers = rows.as_flattened_mut().as_flattened_mut().as_flattened_mut();
        for (row, blocks) in form.iter().enumerate() {
            for (column, &(kinetic, potential)) in blocks.iter().enumerate() {
                let block = Coefficients::Dense(mass * kinetic - symmetric * (potential * square));
                block.add_to(T::one(), numbers, N * S, row * N, column * N);
            }
        }
        for term in damping {
            let symbol = libm::pow(term.bdf_order.generating_function(-1.0) / h, term.damping_order);
            term.coefficients.add_to(-T::of(h * h * symbol), numbers, N * S, 0, 0);
        }
        is_positive_definite_in_place(numbers, N * S)
    };
    if stable(step_size) {
        return Ok(Stability::Stable);
    }
    let (mut low, mut high) = (step_size, step_size);
    while !stable(low) && low > f64::MIN_POSITIVE {
        (low, high) = (low * 0.5, low);
    }
    if !stable(low) {
        return Ok(Stability::Unstable { largest_stable_step: 0.0 });
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if stable(middle) { low = middle } else { high = middle }
    }
    Ok(Stability::Unstable { largest_stable_step: low })
}

/// Largest β with β |arg γ_p(e^{iθ})| < π at every θ.
const fn largest_damping_order(order: BdfOrder) -> f64 {
    match order.get() {
        1 | 2 => 2.0,
        3 => 1.915,
        4 => 1.687,
        5 => 1.404,
        _ => 1.109,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quadrature::Quadrature;
    use crate::real::max_or_nan;
    use nalgebra::matrix;

    fn limit<const S: usize, const Q: usize>(
        scheme: &Galerkin<f64, S, Q>,
        stiffness: f64,
        rho: f64,
        damping_order: f64,
        p: usize,
    ) -> Stability {
        let term = ExplicitDamping {
            coefficients: Coefficients::Diagonal([rho].into()),
            damping_order,
            bdf_order: BdfOrder::new(p).unwrap(),
        };
        let mass = Mass::diagonal([1.0]).unwrap();
        check_stability(scheme, &mass, &matrix![stiffness], &[term], 100.0).unwrap()
    }

    fn assert_limit(found: Stability, expected: f64) {
        let Stability::Unstable { largest_stable_step } = found else { panic!("{found:?}") };
        assert!((largest_stable_step / expected - 1.0).abs() < 1e-12, "{largest_stable_step} and {expected}");
    }

    #[test]
    fn the_limit_of_a_single_mass_has_a_closed_form() {
        let low_order = |kappa| Galerkin::low_order(kappa).unwrap();
        // 4/h² = ρ (γ_p(−1)/h)^β ; γ₁(−1) = 2, γ₂(−1) = 4.
        assert_limit(limit(&low_order(0.5), 7.0, 3.0, 1.0, 1), 4.0 / (3.0 * 2.0));
        assert_limit(limit(&low_order(0.5), 7.0, 3.0, 1.5, 2), (4.0 / (3.0 * 8.0f64)).powi(2));
        // Symplectic Euler: h √k = 2.
        assert_limit(limit(&low_order(0.0), 9.0, 0.0, 0.5, 1), 2.0 / 3.0);
        assert_eq!(limit(&low_order(0.5), 9.0, 0.0, 0.5, 1), Stability::Stable);
    }

    #[test]
    fn orders_at_which_slower_motions_can_grow_are_not_judged() {
        for p in 1..=6 {
            let order = BdfOrder::new(p).unwrap();
            let argument = |step: i32| {
                let theta = f64::from(step) * core::f64::consts::PI / 4000.0;
                let sum = |part: fn(f64) -> f64| {
                    order
                        .coefficients()
                        .iter()
                        .zip(0..)
                        .map(|(a, j)| a * part(f64::from(j) * theta))
                        .sum::<f64>()
                };
                libm::atan2(sum(libm::sin), sum(libm::cos)).abs()
            };
            let turned = (1..4000).map(argument).fold(0.0, max_or_nan);
            let limit = largest_damping_order(order);
            assert!(limit * turned < core::f64::consts::PI, "{p}");
            assert!(p < 3 || (limit + 2e-3) * turned > core::f64::consts::PI, "{p}");
            if p > 2 {
                let term = ExplicitDamping {
                    coefficients: Coefficients::Diagonal([0.01].into()),
                    damping_order: limit + 1e-3,
                    bdf_order: order,
                };
                let (scheme, mass) = (Galerkin::low_order(0.5).unwrap(), Mass::diagonal([1.0]).unwrap());
                let judged = |term| check_stability(&scheme, &mass, &matrix![1.0], &[term], 1e-3);
                assert_eq!(judged(term).unwrap_err().value, term.damping_order);
                assert_eq!(judged(ExplicitDamping { damping_order: limit, ..term }), Ok(Stability::Stable));
            }
        }
    }

    #[test]
    fn higher_degrees_stop_at_half_a_revolution() {
        // Gauss collocation turns by twice the argument of 1 + iy/2 − y²/12 (degree 2) or 1 + iy/2 − y²/10 −
        // iy³/120 (degree 3), y = h √k: half a revolution where the real part vanishes.
        let two = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().unwrap()).unwrap();
        assert_limit(limit(&two, 9.0, 0.0, 0.5, 1), 12f64.sqrt() / 3.0);
        let three = Galerkin::<f64, 3, 3>::new(&Quadrature::gauss().unwrap()).unwrap();
        assert_limit(limit(&three, 9.0, 0.0, 0.5, 1), 10f64.sqrt() / 3.0);
        // Lobatto, three points, degree 2: h √k = √8.
        let lobatto = Galerkin::<f64, 2, 3>::new(&Quadrature::lobatto().unwrap()).unwrap();
        assert_limit(limit(&lobatto, 9.0, 0.0, 0.5, 1), 8f64.sqrt() / 3.0);
        // Without a spring a step with inner nodes is that of degree 1.
        assert_limit(limit(&two, 0.0, 3.0, 1.0, 1), 4.0 / (3.0 * 2.0));
        assert_limit(limit(&three, 0.0, 3.0, 1.5, 2), (4.0 / (3.0 * 8.0f64)).powi(2));
    }

    #[test]
    fn the_fastest_of_several_motions_sets_the_limit() {
        fn limit_of<const S: usize, const Q: usize>(
            scheme: &Galerkin<f64, S, Q>,
            stiffness: nalgebra::SMatrix<f64, 2, 2>,
            coefficients: nalgebra::SMatrix<f64, 2, 2>,
        ) -> Stability {
            let term = ExplicitDamping {
                coefficients: Coefficients::Dense(coefficients),
                damping_order: 1.0,
                bdf_order: BdfOrder::GRUNWALD_LETNIKOV,
            };
            check_stability(scheme, &Mass::diagonal([1.0, 1.0]).unwrap(), &stiffness, &[term], 100.0).unwrap()
        }
        let one = Galerkin::<f64, 1, 1>::low_order(0.0).unwrap();
        let two = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().unwrap()).unwrap();
        let three = Galerkin::<f64, 3, 3>::new(&Quadrature::gauss().unwrap()).unwrap();
        // Eigenvalues 9 and 4, along the axes in either order, and 9 and 1 across them.
        for springs in [matrix![9.0, 0.0; 0.0, 4.0], matrix![4.0, 0.0; 0.0, 9.0], matrix![5.0, 4.0; 4.0, 5.0]]
        {
            let zero = matrix![0.0, 0.0; 0.0, 0.0];
            assert_limit(limit_of(&one, springs, zero), 2.0 / 3.0);
            assert_limit(limit_of(&two, springs, zero), 12f64.sqrt() / 3.0);
            assert_limit(limit_of(&three, springs, zero), 10f64.sqrt() / 3.0);
            // As dampings: 4/h² = 9 · 2/h.
            assert_limit(limit_of(&one, zero, springs), 2.0 / 9.0);
            assert_limit(limit_of(&two, zero, springs), 2.0 / 9.0);
            assert_limit(limit_of(&three, zero, springs), 2.0 / 9.0);
        }
    }
}
