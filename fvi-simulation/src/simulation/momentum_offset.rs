//! Momentum offset of schemes with several nodes due to Riemann–Liouville damping from q₀ ≠ 0.

use fvi_core::Real;
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::quadrature::starting_defects::reciprocal_gamma;
use fvi_fft::transfer::TransferFunction;
use fvi_scenario::scenario::{DampedAt, Derivative, ReportedMomentum, Scenario};

/// Difference between the momentum of a discrete Lagrangian that is damped at several quadrature nodes and
/// that of the motion.
///
/// The constant q₀ is sampled equally at all nodes of a step, so that with f_m = q₀ t^{−β_m}/Γ(1−β_m), or q₀
/// L⁻¹[K_m(s)/s] for another kernel,
///
/// ```text
/// p_k = p(t_k) + Σ_m ρ_m ((h²/12) f_m′(t_k) − (h⁴/240) f_m‴(t_k)) + … ,
/// ```
///
/// the first terms of −D⁻¹ [(y/sinh y)² − 1] ρ f with y = hD/2: derived in `book/src/theory/node-form.md`.
#[derive(Clone, Debug, Default)]
pub(super) struct MomentumOffset<T> {
    /// K_m, and ρ_m q₀.
    terms: Vec<(TransferFunction, Vec<T>)>,
    /// Time at which the motion of the memories begins.
    begin: f64,
}

impl<T: Real> MomentumOffset<T> {
    /// The offset for the terms of a scenario whose scheme has `nodes` nodes; `leave(m)` returns ρ_m q₀.
    /// Empty if the reported momentum is that of the discrete Lagrangian, or the order of the scheme is at
    /// most 2.
    pub(super) fn of(scenario: &Scenario, nodes: usize, mut leave: impl FnMut(usize) -> Vec<T>) -> Self {
        let ConvolutionFamily::Bdf { order: 3.. } = scenario.convolution.family else {
            return Self::default();
        };
        let several = nodes > 1 && scenario.convolution.at == DampedAt::Nodes;
        if !several || scenario.output.momentum == ReportedMomentum::OneSided {
            return Self::default();
        }
        let terms = scenario.system.damping.iter().enumerate();
        // A spring and a dashpot have no memory of the constant: f is 0, or its derivatives are.
        let remembers =
            |kernel: &TransferFunction| kernel.fractions().is_none_or(|parts| !parts.poles.is_empty());
        let singular = terms
            .filter(|(_, term)| term.derivative == Derivative::RiemannLiouville && remembers(&term.transfer));
        let terms = singular.map(|(index, term)| (term.transfer.clone(), leave(index)));
        let begin = scenario.time.start - scenario.initial.past_steps() as f64 * scenario.time.step;
        Self { terms: terms.filter(|(_, vector)| vector.iter().any(|&x| x != T::zero())).collect(), begin }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.terms.is_empty()
    }

    /// Subtracts the offset from a momentum at a time; there is none at the beginning of the motion.
    pub(super) fn take_off(&self, time: f64, step_size: f64, momentum: &mut [T]) {
        let time = time - self.begin;
        if time <= 0.0 {
            return;
        }
        let ratio = (step_size / time).powi(2);
        for (transfer, vector) in &self.terms {
            let factor = match transfer.exponent() {
                Some(order) => {
                    let derivative = |m: i32| reciprocal_gamma(1.0 - order - f64::from(m));
                    let size = libm::pow(time, 1.0 - order) * ratio;
                    size * (derivative(1) / 12.0 - ratio * derivative(3) / 240.0)
                }
                None => {
                    // f′ = L⁻¹[K]; kernels for which it is unknown are refused by the table of combinations.
                    let derivative = |k: i32| transfer.response(time, k).unwrap_or(f64::NAN);
                    step_size.powi(2) * (derivative(0) / 12.0 - step_size.powi(2) * derivative(2) / 240.0)
                }
            };
            let factor = T::of(factor);
            momentum.iter_mut().zip(vector).for_each(|(place, &x)| *place -= factor * x);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::Precision;
    use crate::simulation::motion::Motion;
    use serde_json::json;

    const BETA: f64 = 0.9;
    const RHO: f64 = 3.0;

    /// The `derivative`-th derivative at t = 1 of Σ_n (−ρ)^n t^{first + n (2 − β)}/Γ(1 + first + n (2 − β)).
    fn series(first: f64, derivative: f64) -> f64 {
        let terms = (0..80).map(|n| {
            let n = f64::from(n);
            (-RHO).powf(n) * reciprocal_gamma(1.0 + first + n * (2.0 - BETA) - derivative)
        });
        terms.sum()
    }

    /// Errors of position and momentum at t = 1 of q̈ + ρ D^β q = 0 with three Gauss points and BDF 6.
    fn errors(derivative: &str, initial: [f64; 2], step: f64) -> [f64; 2] {
        let scenario = json!({
            "system": { "mass": [1.0], "damping": [{ "order": BETA, "coefficient": [RHO], "derivative": derivative }] },
            "initial": { "position": [initial[0]], "momentum": [initial[1]] },
            "scheme": { "kind": "galerkin", "degree": 3 },
            "convolution": { "family": "bdf", "order": 6 },
            "time": { "step": step, "end": 1.0 },
        });
        let scenario = Scenario::from_value(&scenario).unwrap();
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
        while !motion.is_done() {
            motion.advance_along(usize::MAX).unwrap();
        }
        let exact = |derivative| initial[0] * series(0.0, derivative) + initial[1] * series(1.0, derivative);
        [motion.state().position[0] - exact(0.0), motion.state().momentum[0] - exact(1.0)]
    }

    #[test]
    fn at_the_last_digits_the_start_leaves_terms_of_order_four() {
        let h: f64 = 1.0 / 256.0;
        let h4 = h.powi(4);
        let [once, twice] = [-BETA, -1.0 - BETA].map(|x| RHO * reciprocal_gamma(x));
        let assert_near = |found: f64, expected: f64| {
            assert!((found / expected - 1.0).abs() < 0.25, "{found} and {expected}");
        };
        for derivative in ["caputo", "riemann-liouville"] {
            // The error at t = 1 from an initial velocity: book/src/theory/node-form.md.
            let [q, p] = errors(derivative, [0.0, 1.0], h);
            assert_near(q, -h4 / 720.0 * once);
            assert_near(p, h4 / 240.0 * twice);
        }
        // And from an initial position, with the Riemann–Liouville type.
        assert_near(errors("riemann-liouville", [1.0, 0.0], h)[0], h4 / 240.0 * twice);
        // Before this digit the formula's own error dominates, and decreases faster.
        let [far, near] =
            [1.0 / 32.0, 1.0 / 64.0].map(|step| errors("riemann-liouville", [1.0, 0.0], step)[0]);
        assert!((far / near).abs().log2() > 6.0, "{far} {near}");
    }

    #[test]
    fn a_spring_and_a_dashpot_leave_no_offset() {
        for (order, exact) in [(0.0, [1f64.cos(), -1f64.sin()]), (1.0, [(-1f64).exp(), -(-1f64).exp()])] {
            let scenario = json!({
                "system": { "mass": [1.0], "damping": [{ "order": order, "coefficient": [1.0], "derivative": "riemann-liouville" }] },
                "initial": { "position": [1.0], "momentum": [0.0] },
                "scheme": { "kind": "galerkin", "degree": 3 },
                "convolution": { "family": "bdf", "order": 6 },
                "time": { "step": 1.0 / 256.0, "end": 1.0 },
            });
            let scenario = Scenario::from_value(&scenario).unwrap();
            let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
            while !motion.is_done() {
                motion.advance_along(usize::MAX).unwrap();
            }
            let found = [motion.state().position[0], motion.state().momentum[0]];
            for (found, exact) in found.into_iter().zip(exact) {
                assert!((found - exact).abs() < 1e-8, "order {order}: {found} {exact}");
            }
        }
    }
}
