//! What Riemann–Liouville damping from q₀ ≠ 0 leaves in the momentum of schemes with several nodes.

use crate::numerics::starting_defects::reciprocal_gamma;
use crate::numerics::transfer::TransferFunction;
use crate::scenario::{ConvolutionFamily, DampedAt, Derivative, ReportedMomentum, Scenario};
use fvi_core::Real;

/// By how much the momentum of a discrete Lagrangian that is damped at several quadrature nodes differs from
/// that of the motion.
///
/// The constant q₀ is sampled alike at all nodes of a step, so that with f_m = q₀ t^{−β_m}/Γ(1−β_m), or
/// q₀ L⁻¹[K_m(s)/s] of another kernel,
///
/// ```text
/// p_k = p(t_k) + Σ_m ρ_m ((h²/12) f_m′(t_k) − (h⁴/240) f_m‴(t_k)) + … ,
/// ```
///
/// the first terms of −D⁻¹ [(y/sinh y)² − 1] ρ f with y = hD/2: derived in `docs/node-form.md`.
#[derive(Clone, Debug, Default)]
pub(super) struct MomentumOffset<T> {
    /// K_m, and ρ_m q₀.
    terms: Vec<(TransferFunction, Vec<T>)>,
}

impl<T: Real> MomentumOffset<T> {
    /// For the terms of a scenario whose scheme has so many nodes; `leave` writes ρ_m q₀. There are none
    /// where the momentum that is reported is to be that of the discrete Lagrangian, or the formula is of
    /// order 2 at most.
    pub(super) fn of(scenario: &Scenario, nodes: usize, mut leave: impl FnMut(usize) -> Vec<T>) -> Self {
        let ConvolutionFamily::Bdf { order: 3.. } = scenario.convolution.family else {
            return Self::default();
        };
        let several = nodes > 1 && scenario.convolution.at == DampedAt::Nodes;
        if !several || scenario.output.momentum == ReportedMomentum::OneSided {
            return Self::default();
        }
        let terms = scenario.system.damping.iter().enumerate();
        let singular = terms.filter(|(_, term)| term.derivative == Derivative::RiemannLiouville);
        let terms = singular.map(|(index, term)| (term.transfer.clone(), leave(index)));
        Self { terms: terms.filter(|(_, vector)| vector.iter().any(|&x| x != T::zero())).collect() }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.terms.is_empty()
    }

    /// Takes it off a momentum at a time after so many steps; at t = 0 there is none yet.
    pub(super) fn take_off(&self, time: f64, step_size: f64, momentum: &mut [T]) {
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
                    // f′ = L⁻¹[K], which formulas do not tell.
                    let derivative = |k: i32| transfer.response(time, k).unwrap_or(0.0);
                    step_size.powi(2) * (derivative(0) / 12.0 - step_size.powi(2) * derivative(2) / 240.0)
                }
            };
            let factor = T::of(factor);
            momentum.iter_mut().zip(vector).for_each(|(place, &x)| *place -= factor * x);
        }
    }
}
