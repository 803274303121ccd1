//! The weights of rational kernels by backward differentiation as exponentials in closed form.
//!
//! With σ = h p for a simple pole p of K, of residue a, the poles of K(γ(z)/h) are the zeros z of γ(z) − σ,
//! a polynomial in δ = 1 − z:
//!
//! ```text
//! Σ_i δ^i/i = σ ,       w_n = Σ_z a h/(γ'(δ) z) z⁻ⁿ ,       γ'(δ) = Σ_i δ^{i−1} ,
//! ```
//!
//! and on increments each part is divided by δ. What K has besides poles, c₀ + c₁ s, is in the first weights.

use crate::transfer::fractions::{Fractions, PoleOfOrder};
use fvi_core::BdfOrder;
use nalgebra::Complex;

/// Part of the value of a term below which K(0) is 0.
const NOTHING: f64 = 1e-13;

/// Iterations in which the zeros of a polynomial are found; fifteen are usual.
const MOST_ITERATIONS: usize = 200;

/// All exponentials of the weights of a kernel.
pub(super) struct ClosedPairs {
    /// The first lag from which they are the weights.
    pub(super) first: usize,
    /// ρ and c of w_n = Re Σ c ρⁿ, |ρ| < 1.
    pub(super) pairs: Vec<[Complex<f64>; 2]>,
}

impl ClosedPairs {
    /// Those of K(γ(z)/h), or of K(γ(z)/h)/(1 − z) on increments; `None` where poles are not simple, or
    /// weights do not fall off.
    pub(super) fn of(
        fractions: &Fractions,
        order: BdfOrder,
        on_increments: bool,
        step_size: f64,
    ) -> Option<Self> {
        let zero = Complex::ZERO;
        let stays = fractions.value(zero).norm() > NOTHING * fractions.size(zero);
        if on_increments && stays || fractions.poles.iter().any(|pole| pole.coefficients.len() != 1) {
            return None;
        }
        let degree = if fractions.direct[1] == 0.0 { 0 } else { order.get() };
        let mut pairs = Vec::new();
        for pole in fractions.poles.iter().filter(|pole| pole.place.im >= 0.0) {
            pairs.extend(exponentials_of(pole, order, on_increments, step_size)?);
        }
        Some(Self { first: degree + 1, pairs })
    }
}

/// The exponentials of a pole, and of its conjugate where it is not real.
fn exponentials_of(
    pole: &PoleOfOrder,
    order: BdfOrder,
    on_increments: bool,
    step_size: f64,
) -> Option<Vec<[Complex<f64>; 2]>> {
    let one = Complex::new(1.0, 0.0);
    let is_real = pole.place.im == 0.0;
    let zeros = differences(order, pole.place * step_size)?;
    // Of the zeros of a real polynomial one of each pair stands for both.
    let known = zeros.into_iter().filter(|difference| !is_real || difference.im >= 0.0);
    known
        .map(|difference| {
            let z = one - difference;
            let slope = (0..order.get()).fold(Complex::<f64>::ZERO, |sum, _| sum * difference + one);
            let divisor = if on_increments { slope * z * difference } else { slope * z };
            let times = if is_real && difference.im == 0.0 { 1.0 } else { 2.0 };
            let coefficient: Complex<f64> = pole.coefficients[0] * (times * step_size) / divisor;
            let decay = z.inv();
            (decay.norm() < 1.0 && coefficient.is_finite()).then_some([decay, coefficient])
        })
        .collect()
}

/// The δ with Σ_i δ^i/i = σ: all zeros at once by the method of Weierstrass, and then each by Newton's.
fn differences(order: BdfOrder, value: Complex<f64>) -> Option<Vec<Complex<f64>>> {
    let degree = order.get();
    let miss = |x: Complex<f64>| {
        let series = (1..=degree).rev().fold(Complex::<f64>::ZERO, |sum, i| (sum + 1.0 / i as f64) * x);
        series - value
    };
    let slope = |x: Complex<f64>| (0..degree).fold(Complex::<f64>::ZERO, |sum, _| sum * x + 1.0);
    // No zero lies outside of this circle.
    let radius = 1.0 + degree as f64 * value.norm().max(1.0);
    let start = |k: usize| Complex::from_polar(radius.powf(1.0 / degree as f64), 0.4 + 2.4 * k as f64);
    let mut zeros: Vec<Complex<f64>> = (0..degree).map(start).collect();
    let mut moved = f64::INFINITY;
    for _ in 0..MOST_ITERATIONS {
        moved = 0.0;
        for k in 0..degree {
            let apart = (0..degree).filter(|&other| other != k).map(|other| zeros[k] - zeros[other]);
            let step = miss(zeros[k]) * degree as f64 / apart.product::<Complex<f64>>();
            zeros[k] -= step;
            moved = fvi_core::max_or_nan(moved, step.norm() / zeros[k].norm());
        }
        if moved < 1e-12 {
            break;
        }
    }
    if moved.is_nan() || moved > 1e-9 {
        return None;
    }
    for zero in &mut zeros {
        *zero -= miss(*zero) / slope(*zero);
        if value.im == 0.0 && zero.im.abs() < 1e-12 * zero.norm() {
            zero.im = 0.0;
        }
    }
    Some(zeros)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sums::max_or_nan;
    use crate::transfer::algebra::{Algebra, Series};
    use crate::transfer::fractions::Quotient;
    use crate::transfer::multistep_rule::MultistepRule;

    /// s(s + 0.1)/((s + 0.1)² + 4) + s/(s + 3) + 0.2 s, as a quotient and as a series.
    fn quotient() -> Fractions {
        let s = Quotient::variable;
        let number = Quotient::constant;
        let below = || s().plus(&number(0.1)).multiply(&s().plus(&number(0.1))).plus(&number(4.0));
        let wave = s().multiply(&s().plus(&number(0.1))).multiply(&below().inverse().unwrap());
        let relaxation = s().multiply(&s().plus(&number(3.0)).inverse().unwrap());
        let all = [wave, relaxation, s().multiply(&number(0.2))].map(|part| part.fractions().unwrap());
        all.into_iter().reduce(Fractions::plus).unwrap()
    }

    fn series(s: &Series) -> Series {
        let moved = s.add(&s.constant(0.1));
        let wave = s.multiply(&moved).divide(&moved.multiply(&moved).add(&s.constant(4.0)));
        wave.add(&s.divide(&s.add(&s.constant(3.0)))).add(&s.scale(0.2))
    }

    #[test]
    fn closed_exponentials_are_the_weights_of_the_power_series() {
        for p in 1..=6 {
            let order = BdfOrder::new(p).unwrap();
            for on_increments in [false, true] {
                let made = series(&MultistepRule::Bdf(order).series(0.05, 200));
                let known = if on_increments { made.sums() } else { made.to_numbers() };
                let closed = ClosedPairs::of(&quotient(), order, on_increments, 0.05).unwrap();
                let largest = known.iter().map(|weight| weight.abs()).fold(0.0, max_or_nan);
                for (n, weight) in known.iter().enumerate().skip(closed.first) {
                    let found: f64 = closed.pairs.iter().map(|[rho, c]| (c * rho.powu(n as u32)).re).sum();
                    assert!(
                        (found - weight).abs() < 1e-13 * largest,
                        "BDF {p}, {on_increments}, {n}: {found}"
                    );
                }
            }
        }
    }
}
