//! Complex numbers with a bound of their rounding errors.

use crate::transfer::algebra::Algebra;
use crate::transfer::real::Real;
use nalgebra::Complex;

/// A value with its rounding error, to first order: what an expression has lost by cancellation.
///
/// The value has the same bits as without the error.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    /// The value.
    pub value: Complex<f64>,
    /// Bound of the error of its modulus.
    pub error: f64,
    /// True if a divisor, or the base of a power, had lost digits.
    pub divided: bool,
}

/// Relative error of a divisor above which it has lost digits.
const LOST: f64 = 1e-10;

impl Estimate {
    /// A value without an error.
    pub fn exact(value: Complex<f64>) -> Self {
        Self { value, error: 0.0, divided: false }
    }

    /// True if the value is finite, and no divisor has lost its digits.
    pub fn is_sure(&self) -> bool {
        self.value.is_finite() && !self.divided
    }

    fn rounded(value: Complex<f64>, error: f64, divided: bool) -> Self {
        let error = error + f64::EPSILON * value.norm();
        // What is not a number has any error.
        let error = if value.is_finite() && !error.is_nan() { error } else { f64::INFINITY };
        Self { value, error, divided }
    }

    fn has_lost(&self) -> bool {
        self.error > LOST * self.value.norm()
    }
}

impl Algebra for Estimate {
    fn constant(&self, value: f64) -> Self {
        Self::exact(Complex::new(value, 0.0))
    }

    fn add(&self, other: &Self) -> Self {
        let divided = self.divided || other.divided;
        Self::rounded(self.value.add(&other.value), self.error + other.error, divided)
    }

    fn multiply(&self, other: &Self) -> Self {
        let error = self.error * other.value.norm() + other.error * self.value.norm();
        Self::rounded(self.value.multiply(&other.value), error, self.divided || other.divided)
    }

    fn divide(&self, other: &Self) -> Self {
        let value = self.value.divide(&other.value);
        let error = (self.error + value.norm() * other.error) / other.value.norm();
        Self::rounded(value, error, self.divided || other.divided || other.has_lost())
    }

    fn power(&self, exponent: Real) -> Self {
        let value = self.value.power(exponent);
        let relative = if self.error == 0.0 { 0.0 } else { self.error / self.value.norm() };
        let error = exponent.to_f64().abs() * relative * value.norm();
        let vanishes = exponent.to_f64() < 1.0 && self.has_lost();
        Self::rounded(value, error, self.divided || vanishes)
    }

    fn exponential(&self) -> Self {
        let value = self.value.exponential();
        Self::rounded(value, value.norm() * self.error, self.divided)
    }

    fn logarithm(&self) -> Self {
        Self::rounded(self.value.logarithm(), self.error / self.value.norm(), self.divided)
    }

    fn scale(&self, factor: f64) -> Self {
        Self::rounded(self.value.scale(factor), self.error * factor.abs(), self.divided)
    }

    fn power_beside_one(&self, exponent: Real) -> Self {
        let slope = (self.value + 1.0).power(exponent.less_one()).norm();
        let value = self.value.power_beside_one(exponent);
        Self::rounded(value, exponent.to_f64().abs() * slope * self.error, self.divided)
    }

    fn exponential_beside_one(&self) -> Self {
        let error = self.value.exponential().norm() * self.error;
        Self::rounded(self.value.exponential_beside_one(), error, self.divided)
    }

    fn is_left(&self) -> bool {
        self.value.is_left()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cancels_has_the_rounding_of_its_terms() {
        let at = |re: f64| Estimate::exact(Complex::new(re, 0.0));
        // √(1 + s) − 1 at s = 10⁻⁸ has 8 digits left, as a number and as a divisor.
        let s = at(1e-8);
        let root = s.add(&s.constant(1.0)).power(Real::from(0.5));
        let rest = root.add(&s.constant(-1.0));
        let miss = (rest.value.re - (5e-9 - 1.25e-17)).abs();
        assert!(miss <= rest.error && rest.error < 1e-15 && rest.is_sure(), "{rest:?}");
        assert!(!s.divide(&rest).is_sure());
        // (s − 1)/ln s is right beside s = 1, and lost at it.
        let quotient = |s: Estimate| s.add(&s.constant(-1.0)).divide(&s.logarithm());
        assert!(quotient(at(1.0 + 1e-9)).error < 1e-15 && !quotient(at(1.0)).is_sure());
        assert_eq!(quotient(at(1.0)).error, f64::INFINITY);
    }
}
