//! Weights of convolution quadrature based on backward differentiation formulas.

use crate::double_double::DoubleDouble;
use crate::error::{ParameterError, check_step_size};
use crate::real::Real;

/// Order p = 1…6 of a backward differentiation formula.
///
/// Its generating function is γ_p(z) = Σ_{i=1}^{p} (1−z)^i / i (\[HJO\] eq. 30); p = 1 gives the
/// Grünwald–Letnikov weights of \[JO\] eq. 46.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BdfOrder(u8);

/// Least common multiple of 1…6: 60·γ_p has integer coefficients.
const COMMON_DENOMINATOR: f64 = 60.0;

impl BdfOrder {
    /// Grünwald–Letnikov, p = 1.
    pub const GRUNWALD_LETNIKOV: Self = Self(1);

    /// The formula of order `order`.
    ///
    /// # Errors
    /// If `order` is not one of 1…6.
    pub const fn new(order: usize) -> Result<Self, ParameterError> {
        if 1 <= order && order <= 6 {
            Ok(Self(order as u8))
        } else {
            Err(ParameterError {
                parameter: "order of the backward differentiation formula",
                value: order as f64,
                allowed: "one of 1, 2, 3, 4, 5, 6",
            })
        }
    }

    /// The order p.
    pub const fn get(self) -> usize {
        self.0 as usize
    }

    /// 60 a_j for γ_p(z) = Σ_j a_j z^j: integers, hence exact.
    ///
    /// a_j = (−1)^j Σ_{i=max(j,1)}^{p} C(i, j) / i.
    const fn scaled_coefficients(self) -> [f64; 7] {
        let mut coefficients = [0.0; 7];
        let mut i = 1;
        while i <= self.get() {
            let mut binomial = COMMON_DENOMINATOR / i as f64;
            let mut j = 0;
            while j <= i && j < coefficients.len() {
                coefficients[j] += binomial;
                binomial = -binomial * (i - j) as f64 / (j + 1) as f64;
                j += 1;
            }
            i += 1;
        }
        coefficients
    }

    /// Coefficients a₀…a_p of the generating function γ_p(z) = Σ_j a_j z^j, in the first p + 1 places.
    pub const fn coefficients(self) -> [f64; 7] {
        let mut coefficients = self.scaled_coefficients();
        let mut j = 0;
        while j < coefficients.len() {
            coefficients[j] /= COMMON_DENOMINATOR;
            j += 1;
        }
        coefficients
    }

    /// Value γ_p(z) of the generating function at a real z.
    pub const fn generating_function(self, z: f64) -> f64 {
        let coefficients = self.coefficients();
        let mut value = 0.0;
        let mut j = coefficients.len();
        while j > 0 {
            j -= 1;
            value = value * z + coefficients[j];
        }
        value
    }
}

/// Checks that the exponent of a quadrature lies in (−1, 2).
const fn check_exponent(exponent: f64) -> Result<(), ParameterError> {
    ParameterError::check(
        exponent > -1.0 && exponent < 2.0,
        "exponent",
        exponent,
        "greater than −1 and less than 2",
    )
}

/// Coefficients of f = (γ_p(z)/a₀)^β or of f/(1 − z), their sums, one after another, each correct to about 30
/// digits before it is rounded.
///
/// ŵ₀ = 1 and n 60a₀ ŵ_n = Σ_{j=1}^{min(p,n)} (βj − n + j) 60a_j ŵ_{n−j}, the recursion for a power of a
/// polynomial, in double-double arithmetic with the factor formed exactly. With g(z) = γ_p(z)/(1 − z) the
/// function f/(1 − z) solves γ_p f' = (β γ_p' + g) f, so that 60g_{j−1} joins the factor: no sum is formed
/// that would cancel, and the relative accuracy is that of the weights at every index.
#[derive(Clone, Debug)]
struct MonicWeights {
    order: BdfOrder,
    exponent: f64,
    coefficients: [f64; 7],
    /// 60g₀, 60g₁, … for the sums, zeros for the weights themselves.
    quotient: [f64; 7],
    /// Last index of a nonzero weight, for integer powers of a polynomial.
    last: u64,
    /// ŵ_{n−1}, ŵ_{n−2}, …
    recent: [DoubleDouble; 6],
    /// Index n of the next weight.
    next: u64,
}

impl MonicWeights {
    const fn new(order: BdfOrder, exponent: f64) -> Self {
        // The recursion would leave rounding errors after the end of a polynomial.
        let last = if exponent == 0.0 {
            0
        } else if exponent == 1.0 {
            order.get() as u64
        } else {
            u64::MAX
        };
        Self {
            order,
            exponent,
            coefficients: order.scaled_coefficients(),
            quotient: [0.0; 7],
            last,
            recent: [DoubleDouble::ZERO; 6],
            next: 0,
        }
    }

    /// The sums of the weights, from the first on.
    const fn sums(order: BdfOrder, exponent: f64) -> Self {
        let mut sums = Self::new(order, exponent);
        let mut sum = 0.0;
        let mut j = 0;
        while j < order.get() && j < sums.quotient.len() {
            sum += sums.coefficients[j];
            sums.quotient[j] = sum;
            j += 1;
        }
        sums.last = if exponent == 1.0 { order.get() as u64 - 1 } else { u64::MAX };
        sums
    }

    const fn advance(&mut self) -> DoubleDouble {
        let weight = self.weight();
        let mut j = self.recent.len() - 1;
        while j > 0 {
            self.recent[j] = self.recent[j - 1];
            j -= 1;
        }
        self.recent[0] = weight;
        self.next += 1;
        weight
    }

    const fn weight(&self) -> DoubleDouble {
        if self.next == 0 {
            return DoubleDouble::ONE;
        }
        let n = self.next as f64;
        if self.next > self.last {
            return DoubleDouble::ZERO;
        }
        let mut sum = DoubleDouble::ZERO;
        let mut j = 1;
        while j <= self.order.get() && j as u64 <= self.next && j <= self.recent.len() {
            let whole = DoubleDouble::exact(j as f64 - n);
            let factor = DoubleDouble::product(self.exponent, j as f64).add(whole);
            let factor = factor.scale(self.coefficients[j]).add(DoubleDouble::exact(self.quotient[j - 1]));
            sum = sum.add(factor.multiply(self.recent[j - 1]));
            j += 1;
        }
        sum.divide(n * self.coefficients[0])
    }
}

/// Weights w₀, w₁, … of convolution quadrature of the operator D^β, one after another without end.
///
/// ```text
/// Σ_n w_n zⁿ = (γ_p(z)/h)^β ,      (D^β x)_k = Σ_{n=0}^{k} w_n x_{k−n}
/// ```
///
/// The exponent β may be any number in (−1, 2): positive for derivatives (the damping order 2α of the
/// equation of motion), negative for fractional integrals. Units of a weight: time^(−β).
///
/// Source: \[HJO\] eq. 18–22, 30, 35; \[JO\] eq. 45–46 for p = 1; \[Lubich86\].
///
/// ```
/// # use fvi_core::{BdfOrder, ConvolutionWeights};
/// let order = BdfOrder::new(2)?;
/// let weights = ConvolutionWeights::bdf(order, 1.0, 0.5)?;
/// // γ₂(z)/h = (3/2 − 2z + z²/2)/h
/// assert!(weights.take(4).eq([3.0, -4.0, 1.0, 0.0]));
/// # Ok::<(), fvi_core::ParameterError>(())
/// ```
#[derive(Clone, Debug)]
pub struct ConvolutionWeights {
    monic: MonicWeights,
    leading: f64,
}

impl ConvolutionWeights {
    /// Weights based on the backward differentiation formula of order `order`, for the operator D^`exponent`
    /// and the step size `step_size`.
    ///
    /// # Errors
    /// If the exponent is outside (−1, 2) or the step size is not positive and finite.
    pub fn bdf(order: BdfOrder, exponent: f64, step_size: f64) -> Result<Self, ParameterError> {
        check_exponent(exponent)?;
        let leading = leading_bdf_weight(order, exponent, step_size)?;
        Ok(Self { monic: MonicWeights::new(order, exponent), leading })
    }

    /// The weights of the same operator on increments, from the first on: (D^β x)_k = Σ_n w'_n
    /// (x_{k−n} − x_{k−n−1}) with x_{−1} = 0. They are the sums w'_n = w₀ + … + w_n, of generating function
    /// (γ_p(z)/h)^β/(1 − z), and fall off like n^{−β}.
    pub fn on_increments(self) -> Self {
        Self { monic: MonicWeights::sums(self.monic.order, self.monic.exponent), ..self }
    }

    /// Fills the slice with the next weights.
    pub fn fill<T: Real>(&mut self, weights: &mut [T]) {
        for weight in weights {
            *weight = T::of(self.advance());
        }
    }

    /// The next weight divided by the leading one, w_n/w₀, to about 30 digits: independent of the step size.
    pub fn next_monic(&mut self) -> DoubleDouble {
        self.monic.advance()
    }

    fn advance(&mut self) -> f64 {
        self.monic.advance().scale(self.leading).to_f64()
    }
}

impl Iterator for ConvolutionWeights {
    type Item = f64;

    fn next(&mut self) -> Option<f64> {
        Some(self.advance())
    }
}

/// Leading weight w₀ = (γ_p(0)/h)^β: the factor between a monic table and the weights themselves.
///
/// # Errors
/// If the exponent is outside (−1, 2) or the step size is not positive and finite.
pub fn leading_bdf_weight(order: BdfOrder, exponent: f64, step_size: f64) -> Result<f64, ParameterError> {
    check_exponent(exponent)?;
    check_step_size(step_size)?;
    Ok(libm::pow(order.generating_function(0.0) / step_size, exponent))
}

/// Table of w_n / w₀, n = 0…H−1, made at compile time to lie in flash.
///
/// (γ_p(z)/γ_p(0))^β needs rational arithmetic only, so the table holds for every step size; the factor w₀ of
/// [`leading_bdf_weight`] is applied to the sum. Not-a-number throughout if the exponent is outside (−1, 2).
///
/// ```
/// # use fvi_core::{BdfOrder, monic_bdf_table};
/// static WEIGHTS: [f64; 4] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
/// assert_eq!(WEIGHTS, [1.0, -0.5, -0.125, -0.0625]);
/// ```
pub const fn monic_bdf_table<const H: usize>(order: BdfOrder, exponent: f64) -> [f64; H] {
    table(exponent, MonicWeights::new(order, exponent))
}

/// [`monic_bdf_table`] rounded to single precision.
pub const fn monic_bdf_table_f32<const H: usize>(order: BdfOrder, exponent: f64) -> [f32; H] {
    rounded(monic_bdf_table(order, exponent))
}

/// Table of w'_n / w₀, n = 0…H−1, for memories that act on increments: w'_n = w₀ + … + w_n
/// ([`ConvolutionWeights::on_increments`]). Otherwise as [`monic_bdf_table`].
///
/// ```
/// # use fvi_core::{BdfOrder, monic_increment_table};
/// static WEIGHTS: [f64; 4] = monic_increment_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
/// assert_eq!(WEIGHTS, [1.0, 0.5, 0.375, 0.3125]);
/// ```
pub const fn monic_increment_table<const H: usize>(order: BdfOrder, exponent: f64) -> [f64; H] {
    table(exponent, MonicWeights::sums(order, exponent))
}

/// [`monic_increment_table`] rounded to single precision.
pub const fn monic_increment_table_f32<const H: usize>(order: BdfOrder, exponent: f64) -> [f32; H] {
    rounded(monic_increment_table(order, exponent))
}

const fn table<const H: usize>(exponent: f64, mut weights: MonicWeights) -> [f64; H] {
    let mut table = [f64::NAN; H];
    if check_exponent(exponent).is_err() {
        return table;
    }
    let mut n = 0;
    while n < H {
        table[n] = weights.advance().to_f64();
        n += 1;
    }
    table
}

const fn rounded<const H: usize>(double: [f64; H]) -> [f32; H] {
    let mut table = [0.0; H];
    let mut n = 0;
    while n < H {
        table[n] = double[n] as f32;
        n += 1;
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn generating_functions_are_the_backward_differentiation_formulas() {
        let second = BdfOrder::new(2).unwrap();
        assert_eq!(second.coefficients()[..3], [1.5, -2.0, 0.5]);
        assert_eq!(BdfOrder::GRUNWALD_LETNIKOV.coefficients()[..2], [1.0, -1.0]);
        for p in 1..=6 {
            let order = BdfOrder::new(p).unwrap();
            let sum: f64 = (1..=p).map(|i| 2f64.powi(i as i32) / i as f64).sum();
            assert!((order.generating_function(-1.0) - sum).abs() < 1e-13 * sum, "p = {p}");
            assert!(order.generating_function(1.0).abs() < 1e-14, "p = {p}");
        }
    }

    #[test]
    fn whole_exponents_give_finite_kernels() {
        for p in 1..=6 {
            let order = BdfOrder::new(p).unwrap();
            let identity: Vec<f64> = ConvolutionWeights::bdf(order, 0.0, 0.1).unwrap().take(9).collect();
            assert_eq!(identity[0], 1.0);
            assert!(identity[1..].iter().all(|&w| w == 0.0));
            let first: Vec<f64> = ConvolutionWeights::bdf(order, 1.0, 1.0).unwrap().take(9).collect();
            for (n, &weight) in first.iter().enumerate() {
                let expected = if n < 7 { order.coefficients()[n] } else { 0.0 };
                assert!((weight - expected).abs() <= 4.0 * f64::EPSILON * expected.abs(), "p = {p}, n = {n}");
            }
        }
    }

    #[test]
    fn weights_on_increments_are_the_sums_of_the_weights() {
        for p in 1..=6 {
            let order = BdfOrder::new(p).unwrap();
            for exponent in [-0.6, 0.0, 0.3, 1.0, 1.5, 1.95] {
                let mut weights = ConvolutionWeights::bdf(order, exponent, 0.1).unwrap();
                let mut sums = weights.clone().on_increments();
                let mut sum = DoubleDouble::ZERO;
                for n in 0..3000 {
                    sum = sum.add(weights.next_monic());
                    let (found, expected) = (sums.next_monic().to_f64(), sum.to_f64());
                    let error = (found - expected).abs();
                    assert!(
                        error <= 2e-16 * expected.abs() + 1e-26,
                        "p = {p}, β = {exponent}, n = {n}: {error:e}"
                    );
                }
            }
        }
    }

    #[test]
    fn tables_of_the_compiler_equal_the_generator() {
        static TABLE: [f64; 100] = monic_bdf_table(BdfOrder(3), 1.3);
        let leading = leading_bdf_weight(BdfOrder(3), 1.3, 0.01).unwrap();
        let weights = ConvolutionWeights::bdf(BdfOrder(3), 1.3, 0.01).unwrap();
        for (n, (weight, monic)) in weights.zip(TABLE).enumerate() {
            assert!((weight - leading * monic).abs() <= 2.0 * f64::EPSILON * weight.abs(), "n = {n}");
        }
    }

    #[test]
    fn values_outside_the_range_are_refused() {
        for exponent in [-1.0, 2.0, f64::NAN, f64::INFINITY] {
            assert!(ConvolutionWeights::bdf(BdfOrder(1), exponent, 0.1).is_err(), "{exponent}");
        }
        for step_size in [0.0, -0.1, f64::NAN, f64::INFINITY] {
            let error = ConvolutionWeights::bdf(BdfOrder(1), 0.5, step_size).unwrap_err();
            assert_eq!(error.parameter, "step size");
        }
        assert!(BdfOrder::new(0).is_err());
        assert!(BdfOrder::new(7).is_err());
    }

    #[test]
    fn the_leading_weight_is_a_power_of_the_leading_coefficient_over_the_step() {
        let second = BdfOrder::new(2).unwrap();
        // γ₂(0) = 3/2
        assert!(
            (leading_bdf_weight(second, 0.5, 0.01).unwrap() - 150f64.sqrt()).abs() < 1e-14 * 150f64.sqrt()
        );
        assert_eq!(leading_bdf_weight(BdfOrder::GRUNWALD_LETNIKOV, 1.0, 0.25), Ok(4.0));
        assert_eq!(leading_bdf_weight(BdfOrder::GRUNWALD_LETNIKOV, -0.5, 4.0), Ok(2.0));
    }

    #[test]
    fn sums_of_a_first_difference_end_where_the_formula_does() {
        for p in 1..=6 {
            let order = BdfOrder::new(p).unwrap();
            let sums: Vec<f64> =
                ConvolutionWeights::bdf(order, 1.0, 1.0).unwrap().on_increments().take(20).collect();
            assert!(sums[..p].iter().all(|&sum| sum != 0.0), "p = {p}: {sums:?}");
            assert!(sums[p..].iter().all(|&sum| sum == 0.0), "p = {p}: {sums:?}");
        }
    }
}
