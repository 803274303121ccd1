//! How large a step the fractional force at the stages of a Runge–Kutta method allows.

use crate::runge_kutta_weights::RungeKuttaWeights;
use fvi_core::{Coefficients, ParameterError, RungeKutta, Stability};
use nalgebra::{Complex, DMatrix, SMatrix};
use std::f64::consts::{FRAC_PI_3, PI};

/// A damping term as the check sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageDamping<const N: usize> {
    /// Coefficients ρ.
    pub coefficients: Coefficients<f64, N>,
    /// Damping order β = 2α.
    pub damping_order: f64,
}

/// A linear mechanical system: mass and stiffness ∂²U/∂q² − ∂F/∂q.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearSystem<const N: usize> {
    /// M.
    pub mass: SMatrix<f64, N, N>,
    /// K.
    pub stiffness: SMatrix<f64, N, N>,
}

/// Weights whose generating function is taken for the symbol; z^HORIZON is nothing on the contour.
const HORIZON: usize = 4096;

/// Points of the half of the contour in the upper half-plane: on a whole half-circle, or on its part and the chord.
const ARC_POINTS: usize = 640;
const CHORD_POINTS: usize = 160;

/// Growth in a step that is found: the contour runs at this distance inside the unit circle. A motion that neither
/// grows nor decays stays outside.
const MARGIN: f64 = 0.01;

/// Checks the step size of a scheme that is damped at the stages, of polynomials of the given degree.
///
/// The fractional force takes the stage values implicitly, and yet long steps can make a motion grow: with as many degrees as
/// stages the discrete action is blind to the part of the polynomial that the quadrature does not see. With motions
/// q_k = z^{−k} v the equations of a step are
///
/// ```text
/// A(z) v = 0 ,   A_νμ(z) = Σ_i b_i [ M ψ̇_ν(c_i) φ̇_μ(c_i) − h² ψ_ν(c_i) ( K φ_μ(c_i) + Σ_m ρ_m Σ_j ((Δ(z)/h)^{β_m})_ij φ_μ(c_j) ) ]
/// ```
///
/// with φ₀ = z(1 − τ) + τ, ψ₀ = 1 − τ + zτ and the bubbles τ(1−τ)τ^{μ−1} at both places for 0 < μ < S. A zero of det A in |z| < 1 is a
/// motion that grows. They are counted by the argument principle; where K alone makes motions grow, not being symmetric and positive
/// semidefinite, only those with Re z < ½, periods shorter than six steps. `stiffness` is that of the initial point, so for
/// nonlinear problems the check is local.
///
/// # Errors
/// If the step size is not positive and finite, or an order is outside the range of the weights.
pub fn check_stage_stability<const N: usize, const R: usize>(
    method: &RungeKutta<R>,
    degree: usize,
    system: &LinearSystem<N>,
    damping: &[StageDamping<N>],
    step_size: f64,
) -> Result<Stability, ParameterError> {
    if !(step_size > 0.0 && step_size.is_finite()) {
        let allowed = "positive and finite";
        return Err(ParameterError { parameter: "step size", value: step_size, allowed });
    }
    let contour = if holds_back(&system.stiffness) { circle() } else { part_of_circle() };
    let mut symbols = Vec::new();
    for term in damping {
        let weights = RungeKuttaWeights::new(method, term.damping_order, 1.0, HORIZON)?;
        symbols.push(contour.iter().map(|&z| weights.symbol(z)).collect::<Vec<_>>());
    }
    let form = Form { method, degree, system, damping };
    let stable = |h: f64| {
        let at = |(index, &z): (usize, &Complex<f64>)| {
            let symbols: Vec<_> = symbols.iter().map(|of_term| of_term[index]).collect();
            form.at(z, &symbols, h).determinant()
        };
        let determinants: Vec<Complex<f64>> = contour.iter().enumerate().map(at).collect();
        let turn = |pair: &[Complex<f64>]| (pair[1] * pair[0].conj()).arg();
        // From the real axis to the real axis: a whole number of half-turns, the conjugate half adds as many.
        let half_turns = determinants.windows(2).map(turn).sum::<f64>() / PI;
        half_turns.abs() < 0.5
    };
    if stable(step_size) {
        return Ok(Stability::Stable);
    }
    let (mut low, mut high) = (0.5 * step_size, step_size);
    while !stable(low) && low > f64::MIN_POSITIVE {
        (low, high) = (0.5 * low, low);
    }
    // Four digits: the user is told three.
    while high - low > 1e-4 * low {
        let middle = 0.5 * (low + high);
        if stable(middle) { low = middle } else { high = middle }
    }
    Ok(Stability::Unstable { largest_stable_step: low })
}

/// Whether K is symmetric and positive semidefinite, to rounding.
fn holds_back<const N: usize>(stiffness: &SMatrix<f64, N, N>) -> bool {
    let rounding = 1e-12 * stiffness.amax();
    let symmetric = (stiffness - stiffness.transpose()).amax() <= rounding;
    let dense = DMatrix::from_fn(N, N, |i, j| stiffness[(i, j)]);
    symmetric && dense.symmetric_eigenvalues().iter().all(|&value| value >= -rounding)
}

fn on_circle(angle: f64) -> Complex<f64> {
    Complex::new((1.0 - MARGIN) * libm::cos(angle), (1.0 - MARGIN) * libm::sin(angle))
}

/// The upper half of the circle, denser towards z = 1 where the resolved motions are, from the real axis to the real axis.
fn circle() -> Vec<Complex<f64>> {
    let left = |point: usize| 1.0 - point as f64 / ARC_POINTS as f64;
    (0..=ARC_POINTS).map(|point| on_circle(PI * left(point) * left(point))).collect()
}

/// The upper half of the contour around the part of the disc left of Re z = ½, from the real axis to the real axis.
fn part_of_circle() -> Vec<Complex<f64>> {
    let arc =
        (0..=ARC_POINTS).map(|point| on_circle(PI - (PI - FRAC_PI_3) * point as f64 / ARC_POINTS as f64));
    let end = on_circle(FRAC_PI_3);
    let chord = (1..=CHORD_POINTS)
        .map(|point| Complex::new(end.re, end.im * (1.0 - point as f64 / CHORD_POINTS as f64)));
    arc.chain(chord).collect()
}

/// The equations of a step for motions z^{−k} v.
struct Form<'a, const N: usize, const R: usize> {
    method: &'a RungeKutta<R>,
    degree: usize,
    system: &'a LinearSystem<N>,
    damping: &'a [StageDamping<N>],
}

/// Values and slopes of a function on the step at the nodes.
type AtNodes<const R: usize> = [(Complex<f64>, Complex<f64>); R];

impl<const N: usize, const R: usize> Form<'_, N, R> {
    /// A(z) for the step size h, with the symbols Δ(z)^β of the terms.
    fn at(&self, z: Complex<f64>, symbols: &[SMatrix<Complex<f64>, R, R>], h: f64) -> DMatrix<Complex<f64>> {
        let rule = self.method.quadrature();
        let one = Complex::new(1.0, 0.0);
        let ends = |left: Complex<f64>, right: Complex<f64>| -> AtNodes<R> {
            rule.nodes().map(|c| (left * (1.0 - c) + right * c, right - left))
        };
        let bubble = |power: usize| -> AtNodes<R> {
            rule.nodes().map(|c| {
                let (n, low) = (power as f64, c.powi(power as i32 - 1));
                (one * ((1.0 - c) * low * c), one * (n * low - (n + 1.0) * low * c))
            })
        };
        let bubbles = (1..self.degree).map(bubble);
        let trials: Vec<AtNodes<R>> = std::iter::once(ends(z, one)).chain(bubbles.clone()).collect();
        let tests: Vec<AtNodes<R>> = std::iter::once(ends(one, z)).chain(bubbles).collect();
        let scales: Vec<f64> =
            self.damping.iter().map(|term| libm::pow(h, 2.0 - term.damping_order)).collect();
        let mut form = DMatrix::zeros(N * self.degree, N * self.degree);
        for (nu, test) in tests.iter().enumerate() {
            for (mu, trial) in trials.iter().enumerate() {
                let (mut kinetic, mut elastic) = (Complex::ZERO, Complex::ZERO);
                let mut damped = vec![Complex::ZERO; symbols.len()];
                for (i, &weight) in rule.weights().iter().enumerate() {
                    kinetic += test[i].1 * trial[i].1 * weight;
                    elastic += test[i].0 * trial[i].0 * weight * (h * h);
                    for (damped, symbol) in damped.iter_mut().zip(symbols) {
                        let derivative: Complex<f64> = (0..R).map(|j| symbol[(i, j)] * trial[j].0).sum();
                        *damped += test[i].0 * derivative * weight;
                    }
                }
                let mut block = self.system.mass.map(|entry| kinetic * entry)
                    - self.system.stiffness.map(|entry| elastic * entry);
                for ((term, damped), scale) in self.damping.iter().zip(damped).zip(&scales) {
                    block -= term.coefficients.to_matrix().map(|entry| damped * (entry * scale));
                }
                form.view_mut((nu * N, mu * N), (N, N)).copy_from(&block);
            }
        }
        form
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::matrix;

    fn limit<const R: usize>(method: &RungeKutta<R>, degree: usize, damping_order: f64) -> Option<f64> {
        let system = LinearSystem { mass: matrix![1.0], stiffness: matrix![0.0] };
        let term = StageDamping { coefficients: Coefficients::Diagonal([2.0].into()), damping_order };
        match check_stage_stability(method, degree, &system, &[term], 1000.0).unwrap() {
            Stability::Stable => None,
            Stability::Unstable { largest_stable_step } => Some(largest_stable_step),
        }
    }

    #[test]
    fn with_one_stage_the_limit_has_a_closed_form() {
        // The equation is (1−z)² M + z (1−z)^β h^{2−β} ρ = 0; growth sets in at z = −1.
        let method = RungeKutta::<1>::radau_iia().unwrap();
        for damping_order in [0.5, 1.0, 1.5] {
            let expected =
                libm::pow(4.0 / (2.0 * libm::pow(2.0, damping_order)), 1.0 / (2.0 - damping_order));
            let found = limit(&method, 1, damping_order).unwrap();
            // One percent of growth in a step is let pass.
            assert!((found / expected - 1.0).abs() < 0.05, "{damping_order}: {found} for {expected}");
        }
    }

    #[test]
    fn a_motion_that_the_system_itself_makes_grow_is_not_held_against_the_step() {
        let method = RungeKutta::<2>::radau_iia().unwrap();
        let term = StageDamping { coefficients: Coefficients::Diagonal([0.1].into()), damping_order: 0.5 };
        let verdict = |stiffness: f64| {
            let system = LinearSystem { mass: matrix![1.0], stiffness: matrix![stiffness] };
            check_stage_stability(&method, 2, &system, &[term], 0.1).unwrap()
        };
        assert_eq!(verdict(-4.0), Stability::Stable);
        assert_eq!(verdict(4.0), Stability::Stable);
    }

    #[test]
    fn degrees_below_the_number_of_stages_lift_the_limit() {
        for damping_order in [1.0, 1.5, 1.9] {
            let radau = RungeKutta::<3>::radau_iia().unwrap();
            assert!(limit(&radau, 3, damping_order).is_some() && limit(&radau, 2, damping_order).is_none());
            let radau = RungeKutta::<2>::radau_iia().unwrap();
            assert!(limit(&radau, 2, damping_order).is_some() && limit(&radau, 1, damping_order).is_none());
            assert!(limit(&RungeKutta::<2>::lobatto_iiic().unwrap(), 1, damping_order).is_none());
            assert!(limit(&RungeKutta::<3>::lobatto_iiic().unwrap(), 2, damping_order).is_none());
            assert!(limit(&RungeKutta::<4>::lobatto_iiic().unwrap(), 3, damping_order).is_none());
        }
    }
}
