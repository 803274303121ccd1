//! Multistep rules of convolution quadrature.

use crate::transfer::algebra::{Algebra, Series};
use fvi_core::{BdfOrder, DoubleDouble};
use nalgebra::Complex;

/// A linear multistep rule, whose symbol γ(z)/h stands in place of s. Source: \[Lubich86\].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MultistepRule {
    /// γ_p(z) = Σ_{i=1}^p (1 − z)^i/i, backward differentiation.
    Bdf(BdfOrder),
    /// γ(z) = 2 (1 − z)/(1 + z), the trapezoidal rule: of order 2 and without numerical damping, since |γ| is
    /// infinite at z = −1. The weights of K(s) ~ s^μ have a part that alternates in sign like (−1)ⁿ n^(μ−1).
    Trapezoidal,
}

impl From<BdfOrder> for MultistepRule {
    fn from(order: BdfOrder) -> Self {
        Self::Bdf(order)
    }
}

impl MultistepRule {
    /// p, the order of consistency.
    pub fn order(self) -> usize {
        match self {
            Self::Bdf(order) => order.get(),
            Self::Trapezoidal => 2,
        }
    }

    /// True if Re γ ≥ 0 in |z| ≤ 1 and arg γ ∈ [−π/2, 0] on the upper half of the circle: the hypothesis of
    /// the theorem on passive kernels (book/src/theory/kernels.md).
    pub fn is_passive(self) -> bool {
        self.order() <= 2
    }

    /// γ(z).
    pub fn symbol(self, z: Complex<f64>) -> Complex<f64> {
        let one = Complex::new(1.0, 0.0);
        let difference = one - z;
        match self {
            Self::Trapezoidal => difference * 2.0 / (one + z),
            Self::Bdf(order) => of_difference(order, difference),
        }
    }

    /// γ(e^{iθ}), with 1 − e^{iθ} accurate for small θ.
    pub fn on_circle(self, angle: f64) -> Complex<f64> {
        let half = libm::sin(0.5 * angle);
        let difference = Complex::new(2.0 * half * half, -libm::sin(angle));
        match self {
            Self::Trapezoidal => difference * 2.0 / (Complex::new(2.0, 0.0) - difference),
            Self::Bdf(order) => of_difference(order, difference),
        }
    }

    /// The series of γ(z)/h.
    pub fn series(self, step_size: f64, count: usize) -> Series {
        let inverse = DoubleDouble::ONE.divide(step_size);
        match self {
            Self::Bdf(order) => {
                // Sixty times the coefficients are integers.
                let coefficient = |scaled: f64| inverse.scale((60.0 * scaled).round()).divide(60.0);
                let coefficients: Vec<_> = order.coefficients().into_iter().map(coefficient).collect();
                Series::polynomial(&coefficients, count)
            }
            Self::Trapezoidal => {
                let twice = inverse.scale(2.0);
                let above = Series::polynomial(&[twice, twice.scale(-1.0)], count);
                let below = Series::polynomial(&[DoubleDouble::ONE, DoubleDouble::ONE], count);
                above.divide(&below)
            }
        }
    }
}

/// Σ δ^i/i
fn of_difference(order: BdfOrder, difference: Complex<f64>) -> Complex<f64> {
    (1..=order.get()).rev().fold(Complex::ZERO, |sum, i| (sum + 1.0 / i as f64) * difference)
}

/// The name in headings.
impl std::fmt::Display for MultistepRule {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Bdf(order) => write!(f, "BDF {}", order.get()),
            Self::Trapezoidal => f.write_str("trapezoidal rule"),
        }
    }
}
