//! Defects of convolution quadrature of K(D) on powers of time, for kernels other than s^β.

use crate::quadrature::multistep_weights::multistep_weights;
use crate::quadrature::starting_defects::{FAR, reciprocal_gamma, zeta_at_minus};
use crate::transfer::TransferFunction;
use fvi_core::{BdfOrder, ParameterError};
use nalgebra::Complex;
use std::f64::consts::PI;

/// The defects of powers (t/h)^ν at t = kh,
///
/// ```text
/// d_k = K(D) (t/h)^ν − Σ_{n=0}^{k} w_n (k−n)^ν
///     = (1/2πi) ∫ e^{kσ} [K(σ/h) Γ(ν+1)/σ^{ν+1} − K(γ_p(e^{−σ})/h) Σ_n n^ν e^{−nσ}] dσ ,
/// Σ_n n^ν e^{−nσ} = Γ(ν+1)/σ^{ν+1} + Σ_i ζ(−ν−i) (−σ)^i/i!        for |σ| < 2π.
/// ```
///
/// For small k the sum is computed directly. From some k on the integral is taken on Talbot's contour around
/// the negative real axis, where both terms have their singularities; the subtracted quantities have the size
/// of K(D) t^ν, not of t^ν, so that d_k has an error of 10⁻¹² of that.
///
/// Source: \[Lubich86\] for the symbols; \[TWS06\] for the contour.
#[derive(Clone, Debug)]
pub(crate) struct KernelDefects {
    transfer: TransferFunction,
    order: BdfOrder,
    step_size: f64,
    powers: Vec<Power>,
}

#[derive(Clone, Debug)]
struct Power {
    nu: f64,
    /// ζ(−ν−i) (−1)^i/i!
    zetas: [f64; TERMS],
    /// d_k for the first k.
    near: Vec<f64>,
}

/// Terms of the series in σ, |σ| ≤ 1.2 where e^{kσ} is not negligible.
const TERMS: usize = 28;

/// Nodes of the contour.
const NODES: usize = 28;

impl KernelDefects {
    /// The defects of K by BDF p with a step size, for powers with the exponents ν ≥ 0.
    ///
    /// # Errors
    /// If the kernel has singularities off the negative real axis, or is given by weights.
    pub(crate) fn new(
        transfer: &TransferFunction,
        order: BdfOrder,
        step_size: f64,
        exponents: &[f64],
    ) -> Result<Self, ParameterError> {
        if !transfer.is_relaxation() {
            let allowed =
                "starting weights for s^β and for kernels whose singularities lie on the negative real axis";
            return Err(ParameterError { parameter: "kernel", value: f64::NAN, allowed });
        }
        let far = FAR[order.get() - 1];
        let weights = multistep_weights(transfer, order, step_size, false, far)?;
        let mut made = Self { transfer: transfer.clone(), order, step_size, powers: Vec::new() };
        for &nu in exponents {
            let mut zetas = [0.0; TERMS];
            let mut factor = 1.0;
            for (i, place) in zetas.iter_mut().enumerate() {
                *place = factor * zeta_at_minus(nu + i as f64) + if nu == 0.0 && i == 0 { 1.0 } else { 0.0 };
                factor /= -(i as f64 + 1.0);
            }
            let sample = |k: usize| if nu == 0.0 { 1.0 } else { libm::pow(k as f64, nu) };
            let near = |k: usize| {
                let sum: f64 =
                    weights[..=k].iter().enumerate().map(|(n, weight)| weight * sample(k - n)).sum();
                let scale = 1.0 / reciprocal_gamma(nu + 1.0);
                made.on_contour(k, |sigma| power(sigma, -nu - 1.0) * made.value(sigma) * scale) - sum
            };
            let near = std::iter::once(0.0).chain((1..far).map(near)).collect();
            made.powers.push(Power { nu, zetas, near });
        }
        Ok(made)
    }

    /// d_k of every power, k ≥ 1.
    pub(crate) fn at(&self, k: usize) -> Vec<f64> {
        self.powers
            .iter()
            .map(|power| power.near.get(k).copied().unwrap_or_else(|| self.far(power, k)))
            .collect()
    }

    /// Bytes of the table.
    pub(crate) fn bytes(&self) -> usize {
        let near: usize = self.powers.iter().map(|power| power.near.len()).sum();
        size_of_val(self.powers.as_slice()) + near * size_of::<f64>()
    }

    fn far(&self, of: &Power, k: usize) -> f64 {
        let scale = 1.0 / reciprocal_gamma(of.nu + 1.0);
        self.on_contour(k, |sigma| {
            let (exact, found) = (self.value(sigma), self.value(self.formula(sigma)));
            let rest = of.zetas.iter().rev().fold(Complex::new(0.0, 0.0), |sum, zeta| sum * sigma + zeta);
            (exact - found) * power(sigma, -of.nu - 1.0) * scale - found * rest
        })
    }

    /// K(σ/h)
    fn value(&self, sigma: Complex<f64>) -> Complex<f64> {
        self.transfer.value(sigma / self.step_size)
    }

    /// γ_p(e^{−σ}), with 1 − e^{−σ} accurate for small σ.
    fn formula(&self, sigma: Complex<f64>) -> Complex<f64> {
        let half = libm::sin(0.5 * sigma.im);
        let decayed = libm::exp(-sigma.re);
        // 1 − e^{−a−ib} = −expm1(−a) + e^{−a} (1 − cos b) + i e^{−a} sin b
        let re = -libm::expm1(-sigma.re) + decayed * 2.0 * half * half;
        let difference = Complex::new(re, decayed * libm::sin(sigma.im));
        let zero = Complex::new(0.0, 0.0);
        (1..=self.order.get()).rev().fold(zero, |sum, j| (sum + 1.0 / j as f64) * difference)
    }

    /// (1/2πi) ∫ e^{kσ} F(σ) dσ
    fn on_contour(&self, k: usize, image: impl Fn(Complex<f64>) -> Complex<f64>) -> f64 {
        let count = NODES as f64;
        let node = |index: usize| {
            let angle = (2.0 * index as f64 + 1.0) * PI / count;
            let turned = 0.6407 * angle;
            let (sine, cosine) = (libm::sin(turned), libm::cos(turned));
            let place = Complex::new(0.5017 * angle * cosine / sine - 0.6122, 0.2645 * angle) * count;
            let slope = Complex::new(0.5017 * (cosine / sine - turned / (sine * sine)), 0.2645) * count;
            let size = libm::exp(place.re);
            let wave = Complex::new(size * libm::cos(place.im), size * libm::sin(place.im));
            (wave * image(place / k as f64) * slope).im
        };
        2.0 / (count * k as f64) * (0..NODES / 2).map(node).sum::<f64>()
    }
}

/// The principal power.
fn power(base: Complex<f64>, exponent: f64) -> Complex<f64> {
    let size = libm::pow(base.norm(), exponent);
    let turn = exponent * libm::atan2(base.im, base.re);
    Complex::new(size * libm::cos(turn), size * libm::sin(turn))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quadrature::starting_defects::PowerDefects;

    #[test]
    fn the_defects_of_a_power_are_those_of_its_expansion() {
        for p in [1, 2, 3] {
            let order = BdfOrder::new(p).unwrap();
            for (beta, step) in [(0.5, 0.1), (1.3, 0.02)] {
                let exponents = [0.0, 0.5, 1.0, 1.7];
                let transfer = TransferFunction::power(beta).unwrap();
                let known = PowerDefects::new(order, beta, &exponents).unwrap();
                let found = KernelDefects::new(&transfer, order, step, &exponents).unwrap();
                for k in [1, 2, 7, 31, 33, 63, 64, 200, 10_000] {
                    for ((found, known), nu) in found.at(k).iter().zip(known.at(k)).zip(exponents) {
                        let known = known * libm::pow(step, -beta);
                        // Relative to K(D) t^ν, or to the sum for small k.
                        let size = libm::pow(step, -beta)
                            * libm::pow(k as f64, nu - beta.min(if k < 64 { 0.0 } else { beta }));
                        assert!(
                            (found - known).abs() < 3e-12 * size,
                            "{p}, {beta}, ν = {nu}, {k}: {found} {known}"
                        );
                    }
                }
            }
        }
    }
}
