//! Functions of the Laplace variable over two kinds of numbers: complex ones, and power series to about 30
//! digits.

use super::real::Real;
use fvi_core::DoubleDouble;
use nalgebra::Complex;

/// Numbers with which a formula K(s) can be evaluated.
///
/// Powers and logarithms are the principal branches, with their cut on the negative real axis.
pub trait Algebra: Clone {
    /// A real constant of the same kind as `self`.
    #[must_use]
    fn constant(&self, value: f64) -> Self;
    /// Sum.
    #[must_use]
    fn add(&self, other: &Self) -> Self;
    /// Product.
    #[must_use]
    fn multiply(&self, other: &Self) -> Self;
    /// Quotient.
    #[must_use]
    fn divide(&self, other: &Self) -> Self;
    /// The power of a real exponent.
    #[must_use]
    fn power(&self, exponent: Real) -> Self;
    /// eˣ.
    #[must_use]
    fn exponential(&self) -> Self;
    /// The natural logarithm.
    #[must_use]
    fn logarithm(&self) -> Self;

    /// Product with a real number.
    #[must_use]
    fn scale(&self, factor: f64) -> Self {
        self.multiply(&self.constant(factor))
    }

    /// The negative.
    #[must_use]
    fn negate(&self) -> Self {
        self.scale(-1.0)
    }

    /// (1 + x)^e − 1, accurate to rounding near x = 0.
    #[must_use]
    fn power_beside_one(&self, exponent: Real) -> Self;

    /// eˣ − 1, accurate to rounding near x = 0.
    #[must_use]
    fn exponential_beside_one(&self) -> Self;

    /// True if x, or the first coefficient of a series, lies in the left half-plane.
    fn is_left(&self) -> bool;

    /// A real parameter of the same kind as `self`.
    #[must_use]
    fn parameter(&self, value: Real) -> Self {
        self.constant(value.to_f64())
    }

    /// Product with a real parameter.
    #[must_use]
    fn stretched(&self, factor: Real) -> Self {
        self.scale(factor.to_f64())
    }

    /// x/(1 + x).
    #[must_use]
    fn share(&self) -> Self {
        self.divide(&self.add(&self.constant(1.0)))
    }

    /// 1/(1/x + 1/y): two elements in series.
    #[must_use]
    fn in_series(&self, other: &Self) -> Self {
        self.divide(&self.divide(other).add(&self.constant(1.0)))
    }

    /// ∫₀¹ tⁿ e^{xt} dt; for n = 0 it is (eˣ − 1)/x.
    #[must_use]
    fn exponential_moment(&self, n: u32) -> Self {
        match n.checked_sub(1) {
            None => self.exponential_beside_one().divide(self),
            Some(below) => {
                let below = self.exponential_moment(below).scale(-f64::from(n));
                self.exponential().add(&below).divide(self)
            }
        }
    }

    /// (x + a)^e − a^e, accurate to rounding near x = 0.
    #[must_use]
    fn power_beyond(&self, start: Real, exponent: Real) -> Self {
        let base = self.parameter(start).power(exponent);
        self.divide(&self.parameter(start)).power_beside_one(exponent).multiply(&base)
    }
}

impl Algebra for Complex<f64> {
    fn constant(&self, value: f64) -> Self {
        Self::new(value, 0.0)
    }

    fn add(&self, other: &Self) -> Self {
        self + other
    }

    fn multiply(&self, other: &Self) -> Self {
        self * other
    }

    fn divide(&self, other: &Self) -> Self {
        self / other
    }

    fn power(&self, exponent: Real) -> Self {
        let exponent = exponent.to_f64();
        if exponent == 0.0 {
            return Self::new(1.0, 0.0);
        }
        if exponent == 1.0 {
            return *self;
        }
        let (size, angle) = (libm::pow(self.norm(), exponent), exponent * libm::atan2(self.im, self.re));
        Self::new(size * libm::cos(angle), size * libm::sin(angle))
    }

    fn exponential(&self) -> Self {
        let size = libm::exp(self.re);
        Self::new(size * libm::cos(self.im), size * libm::sin(self.im))
    }

    fn logarithm(&self) -> Self {
        let angle = libm::atan2(self.im, self.re);
        // Near 1 from |x|² − 1, which does not cancel: ln x keeps its digits there.
        let beside = self.re - 1.0;
        if beside.abs() < 0.25 && self.im.abs() < 0.25 {
            return Self::new(0.5 * libm::log1p(beside * (2.0 + beside) + self.im * self.im), angle);
        }
        Self::new(libm::log(self.norm()), angle)
    }

    fn scale(&self, factor: f64) -> Self {
        self * factor
    }

    fn power_beside_one(&self, exponent: Real) -> Self {
        let exponent = exponent.to_f64();
        // ln(1 + x) and eʸ − 1, each from terms that do not cancel.
        let size = 0.5 * libm::log1p(self.re * (2.0 + self.re) + self.im * self.im);
        let (re, im) = (exponent * size, exponent * libm::atan2(self.im, 1.0 + self.re));
        let half = libm::sin(0.5 * im);
        let grown = libm::expm1(re);
        Self::new(grown * libm::cos(im) - 2.0 * half * half, (1.0 + grown) * libm::sin(im))
    }

    fn exponential_beside_one(&self) -> Self {
        let (grown, half) = (libm::expm1(self.re), libm::sin(0.5 * self.im));
        Self::new(grown * libm::cos(self.im) - 2.0 * half * half, (1.0 + grown) * libm::sin(self.im))
    }

    /// Near x = 0, where its quotient cancels, by the series Σ x^k/(k! (n + k + 1)).
    fn exponential_moment(&self, n: u32) -> Self {
        /// Beyond it the terms are below rounding for |x| ≤ 1.
        const TERMS: u32 = 20;
        if self.norm() > 1.0 {
            let above = match n.checked_sub(1) {
                None => self.exponential_beside_one(),
                Some(below) => self.exponential() - self.exponential_moment(below) * f64::from(n),
            };
            return above / self;
        }
        let (mut power, mut sum) = (Self::ONE, Self::ZERO);
        for k in 0..TERMS {
            sum += power / f64::from(n + k + 1);
            power *= self / f64::from(k + 1);
        }
        sum
    }

    fn is_left(&self) -> bool {
        self.re < 0.0
    }
}

/// Bounds of x between which e^{−x} is computed as the square of e^{−x/2}: beyond the first the low part of
/// e^{−x} underflows, beyond the second e^{−x/2} does too. They correspond to delays of 512 steps and more,
/// whose weights are not computed as series.
const DEEP: f64 = 600.0;
const DEEPEST: f64 = 1300.0;

/// The first coefficients of a power series in z, to about 30 digits.
///
/// The coefficients are real. Products, quotients, powers, exponentials and logarithms are computed by
/// recursions for their coefficients, with O(n²) operations for n coefficients; trailing zeros, as those of a
/// polynomial, cost nothing.
#[derive(Clone, Debug)]
pub struct Series {
    coefficients: Vec<DoubleDouble>,
    count: usize,
}

impl Series {
    /// A polynomial, truncated to `count` coefficients.
    pub fn polynomial(coefficients: &[DoubleDouble], count: usize) -> Self {
        Self { coefficients: coefficients.iter().copied().take(count).collect(), count }.trimmed()
    }

    /// All `count` coefficients, rounded.
    pub fn to_numbers(&self) -> Vec<f64> {
        (0..self.count).map(|n| self.at(n).to_f64()).collect()
    }

    /// The coefficients of the series divided by 1 − z: its partial sums, rounded.
    pub fn sums(&self) -> Vec<f64> {
        let mut sum = DoubleDouble::ZERO;
        let mut add = |n: usize| {
            sum = sum.add(self.at(n));
            sum.to_f64()
        };
        (0..self.count).map(&mut add).collect()
    }

    fn at(&self, n: usize) -> DoubleDouble {
        self.coefficients.get(n).copied().unwrap_or(DoubleDouble::ZERO)
    }

    fn trimmed(mut self) -> Self {
        while self.coefficients.last().is_some_and(|last| last.to_f64() == 0.0) {
            self.coefficients.pop();
        }
        self
    }

    fn of(coefficients: Vec<DoubleDouble>, count: usize) -> Self {
        Self { coefficients, count }.trimmed()
    }

    /// Computes a series whose coefficients follow from the previous ones.
    fn recursion(
        &self,
        first: DoubleDouble,
        mut next: impl FnMut(usize, &[DoubleDouble]) -> DoubleDouble,
    ) -> Self {
        let mut made = Vec::with_capacity(self.count);
        made.push(first);
        for n in 1..self.count {
            let coefficient = next(n, &made);
            made.push(coefficient);
        }
        Self::of(made, self.count)
    }
}

impl Algebra for Series {
    fn constant(&self, value: f64) -> Self {
        Self { coefficients: vec![DoubleDouble::exact(value)], count: self.count }.trimmed()
    }

    fn add(&self, other: &Self) -> Self {
        let length = self.coefficients.len().max(other.coefficients.len());
        Self::of((0..length).map(|n| self.at(n).add(other.at(n))).collect(), self.count)
    }

    fn multiply(&self, other: &Self) -> Self {
        let (short, long) =
            if self.coefficients.len() < other.coefficients.len() { (self, other) } else { (other, self) };
        let length = (short.coefficients.len() + long.coefficients.len()).saturating_sub(1).min(self.count);
        let coefficient = |n: usize| {
            let parts = short.coefficients.iter().enumerate().take(n + 1);
            parts.fold(DoubleDouble::ZERO, |sum, (j, part)| sum.add(part.multiply(long.at(n - j))))
        };
        Self::of((0..length).map(coefficient).collect(), self.count)
    }

    fn divide(&self, other: &Self) -> Self {
        let divisor = other.at(0);
        self.recursion(quotient(self.at(0), divisor), |n, made| {
            let parts = other.coefficients.iter().enumerate().take(n + 1).skip(1);
            let rest =
                parts.fold(self.at(n), |rest, (j, part)| rest.add(part.multiply(made[n - j]).scale(-1.0)));
            quotient(rest, divisor)
        })
    }

    /// n f₀ g_n = Σ_{j≥1} ((e + 1) j − n) f_j g_{n−j} for g = f^e.
    fn power(&self, exponent: Real) -> Self {
        let exponent = exponent.value;
        let whole = exponent.to_f64();
        if whole == 0.0 {
            return self.constant(1.0);
        }
        if whole == 1.0 && exponent.low() == 0.0 {
            return self.clone();
        }
        let first = self.at(0);
        let above = exponent.add(DoubleDouble::ONE);
        self.recursion(power(first, exponent), |n, made| {
            let parts = self.coefficients.iter().enumerate().take(n + 1).skip(1);
            let sum = parts.fold(DoubleDouble::ZERO, |sum, (j, part)| {
                let factor = above.scale(j as f64).add(DoubleDouble::exact(-(n as f64)));
                sum.add(factor.multiply(part.multiply(made[n - j])))
            });
            quotient(sum.divide(n as f64), first)
        })
    }

    /// n g_n = Σ_{j≥1} j f_j g_{n−j}.
    ///
    /// For a delay e^{−sT} of many steps the first coefficient underflows, while those near T do not: the
    /// recursion starts with its square root, and the result is multiplied by the square root again.
    fn exponential(&self) -> Self {
        let first = self.at(0);
        let is_delay = (-DEEPEST..-DEEP).contains(&first.to_f64());
        let start = exponential(if is_delay { first.scale(0.5) } else { first });
        let mut made = self.recursion(start, |n, made| {
            let parts = self.coefficients.iter().enumerate().take(n + 1).skip(1);
            let sum = parts.fold(DoubleDouble::ZERO, |sum, (j, part)| {
                sum.add(part.scale(j as f64).multiply(made[n - j]))
            });
            sum.divide(n as f64)
        });
        if is_delay {
            made.coefficients.iter_mut().for_each(|number| *number = number.multiply(start));
        }
        made
    }

    /// n f₀ g_n = n f_n − Σ_{0<j<n} j g_j f_{n−j}.
    fn logarithm(&self) -> Self {
        let first = self.at(0);
        self.recursion(logarithm(first), |n, made| {
            let parts = self.coefficients.iter().enumerate().take(n).skip(1);
            let rest = parts.fold(self.at(n).scale(n as f64), |rest, (j, part)| {
                rest.add(part.multiply(made[n - j]).scale(-((n - j) as f64)))
            });
            quotient(rest.divide(n as f64), first)
        })
    }

    fn power_beside_one(&self, exponent: Real) -> Self {
        let mut power = self.add(&self.constant(1.0)).power(exponent);
        if let Some(first) = power.coefficients.first_mut() {
            // 1 + x and x^e − 1 lose digits for small x.
            *first = power_beside_one(self.at(0), exponent.to_f64());
        }
        power
    }

    fn exponential_beside_one(&self) -> Self {
        let mut grown = self.exponential().add(&self.constant(-1.0));
        let first = self.at(0);
        if first.to_f64().abs() < 0.3 {
            match grown.coefficients.first_mut() {
                Some(place) => *place = small_exponential(first),
                None => return Self::of(vec![small_exponential(first)], self.count),
            }
        }
        grown
    }

    fn is_left(&self) -> bool {
        self.at(0).to_f64() < 0.0
    }
}

/// a/b.
fn quotient(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble {
    let divisor = b.to_f64();
    let first = a.to_f64() / divisor;
    let rest = a.add(b.scale(-first));
    let second = rest.to_f64() / divisor;
    let last = rest.add(b.scale(-second)).to_f64() / divisor;
    DoubleDouble::exact(first).add(DoubleDouble::exact(second)).add(DoubleDouble::exact(last))
}

/// ln 2 minus the nearest number to it.
const LOW_OF_LN_2: f64 = 2.319_046_813_846_299_6e-17;

/// Number of halvings of the argument of an exponential, and of terms of its series.
const HALVINGS: i32 = 9;
const TERMS: u32 = 11;

/// eˣ − 1 for |x| < 0.4: Taylor's series at x/2⁹, then (1 + y)² − 1 = y (2 + y) nine times.
fn small_exponential(x: DoubleDouble) -> DoubleDouble {
    let small = x.scale(0.5_f64.powi(HALVINGS));
    let series = (2..=TERMS)
        .rev()
        .fold(DoubleDouble::ONE, |sum, n| sum.multiply(small).divide(f64::from(n)).add(DoubleDouble::ONE));
    let mut grown = series.multiply(small);
    for _ in 0..HALVINGS {
        grown = grown.multiply(grown.add(DoubleDouble::exact(2.0)));
    }
    grown
}

/// eˣ.
fn exponential(x: DoubleDouble) -> DoubleDouble {
    let twos = (x.to_f64() / std::f64::consts::LN_2).round();
    if twos.is_nan() || twos.abs() >= 1000.0 {
        return DoubleDouble::exact(libm::exp(x.to_f64()));
    }
    let ln_2 = DoubleDouble::exact(std::f64::consts::LN_2).add(DoubleDouble::exact(LOW_OF_LN_2));
    let rest = x.add(ln_2.scale(-twos));
    small_exponential(rest).add(DoubleDouble::ONE).scale(libm::exp2(twos))
}

/// ln x, NaN for x ≤ 0: one Newton step from the logarithm in double precision.
fn logarithm(x: DoubleDouble) -> DoubleDouble {
    let near = DoubleDouble::exact(libm::log(x.to_f64()));
    if !near.to_f64().is_finite() {
        return near;
    }
    // x e^{−y} − 1 =: d, ln x = y + d − d²/2 + …
    let beside = x.multiply(exponential(near.scale(-1.0))).add(DoubleDouble::exact(-1.0));
    near.add(beside).add(beside.multiply(beside).scale(-0.5))
}

/// ln(1 + x) for x > −1: one Newton step from the logarithm in double precision, accurate near 0.
fn logarithm_beside_one(x: DoubleDouble) -> DoubleDouble {
    if x.to_f64().abs() > 0.3 {
        return logarithm(x.add(DoubleDouble::ONE));
    }
    let near = DoubleDouble::exact(libm::log1p(x.to_f64()));
    // (1 + x) e^{−y} − 1 = x + (1 + x)(e^{−y} − 1)
    let fallen = small_exponential(near.scale(-1.0));
    let beside = x.add(fallen.multiply(x.add(DoubleDouble::ONE)));
    near.add(beside).add(beside.multiply(beside).scale(-0.5))
}

/// x^e for x > 0.
fn power(x: DoubleDouble, exponent: DoubleDouble) -> DoubleDouble {
    exponential(logarithm(x).multiply(exponent))
}

/// (1 + x)^e − 1 for x > −1.
fn power_beside_one(x: DoubleDouble, exponent: f64) -> DoubleDouble {
    let logarithm = logarithm_beside_one(x).scale(exponent);
    if logarithm.to_f64().abs() < 0.3 {
        return small_exponential(logarithm);
    }
    exponential(logarithm).add(DoubleDouble::exact(-1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn double(value: f64) -> DoubleDouble {
        DoubleDouble::exact(value)
    }

    /// |a − b|, with the low parts of both.
    fn apart(a: DoubleDouble, b: DoubleDouble) -> f64 {
        a.add(b.scale(-1.0)).to_f64().abs()
    }

    #[test]
    fn exponentials_and_logarithms_undo_each_other_to_thirty_digits() {
        for x in [1e-20, 3e-9, 0.01, 0.29, 0.31, 1.0, 7.5, 300.0] {
            let there = logarithm(exponential(double(x)));
            assert!(apart(there, double(x)) < 1e-29 * x.max(1.0), "{x}");
            let beside = logarithm_beside_one(power_beside_one(double(x.min(2.0)), 1.0));
            let known = logarithm(double(1.0).add(double(x.min(2.0))));
            assert!(apart(beside, known) < 1e-29, "{x}");
            let back = power(power(double(x), double(0.3)), quotient(double(1.0), double(0.3)));
            assert!(apart(back, double(x)) < 1e-28 * x, "{x}");
        }
        // (1 + x)^½ − 1 = x/2 − x²/8 + …
        let x = 1e-18;
        let series = double(0.5 * x).add(DoubleDouble::product(x, x).scale(-0.125));
        assert!(apart(power_beside_one(double(x), 0.5), series) < 1e-48);
    }

    #[test]
    fn powers_of_a_series_form_a_semigroup() {
        let difference = Series::polynomial(&[double(1.5), double(-2.0), double(0.5)], 200);
        let (half, rest) = (difference.power(Real::from(0.5)), difference.power(Real::from(0.75)));
        let all = difference.power(Real::from(1.25));
        let product = half.multiply(&rest);
        for n in 0..200 {
            assert!(apart(all.at(n), product.at(n)) < 1e-28 * all.at(n).to_f64().abs() + 1e-31, "{n}");
        }
        let one = all.divide(&product);
        assert!(apart(one.at(0), double(1.0)) < 1e-30);
        assert!((1..200).all(|n| one.at(n).to_f64().abs() < 1e-27));
    }

    #[test]
    fn logarithms_of_exponentials_of_a_series_are_the_series() {
        let series = Series::polynomial(&[double(0.7), double(-0.3), double(0.2), double(0.1)], 60);
        let back = series.exponential().logarithm();
        assert!((0..60).all(|n| apart(back.at(n), series.at(n)) < 1e-27));
        // e^{0.7 ln f} = f^{0.7}
        let by_logarithm = series.logarithm().scale(0.7).exponential();
        let power = series.power(Real::from(0.7));
        assert!((0..60).all(|n| apart(by_logarithm.at(n), power.at(n)) < 1e-26));
    }

    #[test]
    fn small_differences_from_one_keep_their_digits() {
        for x in [Complex::new(1e-12, 3e-13), Complex::new(0.4, -2.0), Complex::new(-0.2, 1e-9)] {
            let found = x.power_beside_one(Real::from(-0.3));
            let direct = Complex::new(1.0, 0.0).add(&x).power(Real::from(-0.3)) - Complex::new(1.0, 0.0);
            assert!((found - direct).norm() < 4e-16, "{x}");
            // −0.3 x + 0.195 x² for small x
            if x.norm() < 1e-9 {
                let series = x * -0.3 + x * x * 0.195;
                assert!((found - series).norm() < 4e-16 * series.norm());
            }
        }
        let series = Series::polynomial(&[double(1e-9), double(-1e-9)], 4);
        let power = series.power_beside_one(Real::from(0.5));
        assert!((power.at(0).to_f64() - (0.5e-9 - 0.125e-18)).abs() < 1e-31);
    }
}
