//! Values with their derivatives by one number, in any algebra in which transfer functions are evaluated.

use crate::transfer::algebra::Algebra;
use crate::transfer::real::Real;

/// f(θ) and f′(θ); operations follow the rules of differentiation.
#[derive(Clone, Debug)]
pub struct Dual<A> {
    /// f(θ).
    pub value: A,
    /// f′(θ); `None` if f does not depend on θ.
    slope: Option<A>,
}

impl<A: Algebra> Dual<A> {
    /// θ itself.
    pub fn variable(value: A) -> Self {
        let slope = Some(value.constant(1.0));
        Self { value, slope }
    }

    /// A value that does not depend on θ.
    pub fn constant_in(value: &A) -> Self {
        Self { value: value.clone(), slope: None }
    }

    /// f′(θ).
    pub fn slope(self) -> A {
        match self.slope {
            Some(slope) => slope,
            None => self.value.constant(0.0),
        }
    }

    /// g(f(θ)), from g and, where f depends on θ, g′ at f(θ).
    fn chain(&self, value: A, slope: impl FnOnce() -> A) -> Self {
        Self { value, slope: self.slope.as_ref().map(|own| own.multiply(&slope())) }
    }

    /// The value with another part of its derivative, by a parameter in it: `slope` of that by θ, times
    /// `part`.
    fn beside(self, slope: f64, part: impl FnOnce() -> A) -> Self {
        if slope == 0.0 {
            return self;
        }
        let part = part().scale(slope);
        Self { slope: sum(self.slope.as_ref(), Some(part)), value: self.value }
    }
}

/// The sum of two slopes.
fn sum<A: Algebra>(one: Option<&A>, other: Option<A>) -> Option<A> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.add(&other)),
        (one, other) => other.or_else(|| one.cloned()),
    }
}

impl<A: Algebra> Algebra for Dual<A> {
    fn constant(&self, value: f64) -> Self {
        Self { value: self.value.constant(value), slope: None }
    }

    fn add(&self, other: &Self) -> Self {
        Self { value: self.value.add(&other.value), slope: sum(self.slope.as_ref(), other.slope.clone()) }
    }

    fn multiply(&self, other: &Self) -> Self {
        let one = self.slope.as_ref().map(|slope| slope.multiply(&other.value));
        let second = other.slope.as_ref().map(|slope| self.value.multiply(slope));
        Self { value: self.value.multiply(&other.value), slope: sum(one.as_ref(), second) }
    }

    fn divide(&self, other: &Self) -> Self {
        let value = self.value.divide(&other.value);
        let fallen = other.slope.as_ref().map(|slope| value.multiply(slope).negate());
        let slope = sum(self.slope.as_ref(), fallen).map(|slope| slope.divide(&other.value));
        Self { value, slope }
    }

    fn power(&self, exponent: Real) -> Self {
        let e = exponent.to_f64();
        let value = self.value.power(exponent);
        let power = if e == 0.0 {
            Self { value, slope: None }
        } else {
            self.chain(value, || self.value.power(exponent.less_one()).scale(e))
        };
        let grown = power.value.clone();
        power.beside(exponent.slope, || grown.multiply(&self.value.logarithm()))
    }

    fn exponential(&self) -> Self {
        let value = self.value.exponential();
        self.chain(value.clone(), || value)
    }

    fn logarithm(&self) -> Self {
        self.chain(self.value.logarithm(), || self.value.constant(1.0).divide(&self.value))
    }

    fn scale(&self, factor: f64) -> Self {
        Self { value: self.value.scale(factor), slope: self.slope.as_ref().map(|slope| slope.scale(factor)) }
    }

    fn power_beside_one(&self, exponent: Real) -> Self {
        let above = || self.value.add(&self.value.constant(1.0));
        let slope = || above().power(exponent.less_one()).scale(exponent.to_f64());
        let power = self.chain(self.value.power_beside_one(exponent), slope);
        power.beside(exponent.slope, || above().power(exponent).multiply(&above().logarithm()))
    }

    fn exponential_beside_one(&self) -> Self {
        self.chain(self.value.exponential_beside_one(), || self.value.exponential())
    }

    fn is_left(&self) -> bool {
        self.value.is_left()
    }

    fn parameter(&self, value: Real) -> Self {
        self.constant(value.to_f64()).beside(value.slope, || self.value.constant(1.0))
    }

    fn stretched(&self, factor: Real) -> Self {
        self.scale(factor.to_f64()).beside(factor.slope, || self.value.clone())
    }

    /// Its slope 1/(1 + x)² does not cancel.
    fn share(&self) -> Self {
        let below = || self.value.add(&self.value.constant(1.0));
        self.chain(self.value.share(), || self.value.constant(1.0).divide(&below().multiply(&below())))
    }

    /// With z = 1/(1/x + 1/y) its slope is (z/x)² x′ + (z/y)² y′, of which nothing cancels.
    fn in_series(&self, other: &Self) -> Self {
        let value = self.value.in_series(&other.value);
        let part = |of: &Self| {
            let ratio = value.divide(&of.value);
            of.slope.as_ref().map(|slope| ratio.multiply(&ratio).multiply(slope))
        };
        Self { slope: sum(part(self).as_ref(), part(other)), value }
    }

    fn exponential_moment(&self, n: u32) -> Self {
        self.chain(self.value.exponential_moment(n), || self.value.exponential_moment(n + 1))
    }

    /// The slope by a, e ((x + a)^{e−1} − a^{e−1}), is again such a difference; that by e is
    /// a^e (((1 + x/a)^e − 1) ln a + (1 + x/a)^e ln(1 + x/a)).
    fn power_beyond(&self, start: Real, exponent: Real) -> Self {
        let e = exponent.to_f64();
        let plain = Real { slope: 0.0, ..start };
        let (base, x) = (self.value.parameter(start), &self.value);
        let slope = || x.add(&base).power(exponent.less_one()).scale(e);
        let power = self.chain(x.power_beyond(start, exponent), slope);
        let power = power.beside(start.slope, || x.power_beyond(plain, exponent.less_one()).scale(e));
        power.beside(exponent.slope, || {
            let scaled = x.divide(&base);
            let beyond = scaled.power_beside_one(exponent);
            let above = scaled.add(&x.constant(1.0));
            let grown = beyond.add(&x.constant(1.0)).multiply(&above.logarithm());
            beyond.multiply(&base.logarithm()).add(&grown).multiply(&base.power(exponent))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Complex;

    fn close(found: Dual<Complex<f64>>, value: Complex<f64>, slope: Complex<f64>) {
        assert!(
            (found.value - value).norm() < 1e-14 && (found.clone().slope() - slope).norm() < 1e-14,
            "{found:?} {slope}"
        );
    }

    #[test]
    fn slopes_are_those_of_closed_forms() {
        let at = Complex::new(0.7, 1.1);
        let x = Dual::variable(at);
        let one = x.constant(1.0);
        close(x.multiply(&x), at * at, at * 2.0);
        close(one.divide(&x.add(&one)), 1.0 / (1.0 + at), -1.0 / ((1.0 + at) * (1.0 + at)));
        close(x.power(Real::from(0.3)), at.powf(0.3), 0.3 * at.powf(-0.7));
        close(x.power(Real::from(0.0)), Complex::ONE, Complex::ZERO);
        close(x.scale(-2.0).exponential(), (-2.0 * at).exp(), -2.0 * (-2.0 * at).exp());
        close(x.logarithm(), at.ln(), 1.0 / at);
        close(
            x.power_beside_one(Real::from(-0.4)),
            (1.0 + at).powf(-0.4) - 1.0,
            -0.4 * (1.0 + at).powf(-1.4),
        );
        close(x.share(), at / (1.0 + at), 1.0 / ((1.0 + at) * (1.0 + at)));
        close(x.in_series(&one), at / (1.0 + at), 1.0 / ((1.0 + at) * (1.0 + at)));
        for small in [Complex::new(1e-9, 2e-9), Complex::new(-0.3, 0.4), at, 3.0 * at] {
            // ∫ t e^{xt} dt by Simpson's rule.
            let integrand = |k: i32| {
                let t = f64::from(k) / 2000.0;
                t * (small * t).exp()
            };
            let weight = |k: i32| [2.0, 4.0][k as usize % 2] - f64::from(u8::from(k == 0 || k == 2000));
            let slope: Complex<f64> = (0..=2000).map(|k| integrand(k) * weight(k)).sum();
            let found = Dual::variable(small).exponential_moment(0);
            assert!((found.slope() - slope / 6000.0).norm() < 1e-12, "{small}");
        }
        close(
            x.power_beyond(Real::from(0.4), Real::from(1.3)),
            (at + 0.4).powf(1.3) - 0.4_f64.powf(1.3),
            1.3 * (at + 0.4).powf(0.3),
        );
    }

    #[test]
    fn slopes_by_parameters_are_those_of_closed_forms() {
        let at = Complex::new(0.7, 1.1);
        let x = Dual::constant_in(&at);
        let theta = |value: f64| Real { slope: 1.0, ..Real::from(value) };
        close(x.power(theta(0.3)), at.powf(0.3), at.powf(0.3) * at.ln());
        close(x.power(theta(0.0)), Complex::ONE, at.ln());
        close(x.stretched(theta(3.0)), 3.0 * at, at);
        close(x.parameter(theta(3.0)), Complex::new(3.0, 0.0), Complex::ONE);
        let above = 1.0 + at;
        close(x.power_beside_one(theta(0.6)), above.powf(0.6) - 1.0, above.powf(0.6) * above.ln());
        let (a, e) = (0.4_f64, 1.3);
        let value = (at + a).powf(e) - a.powf(e);
        let by_start = e * ((at + a).powf(e - 1.0) - a.powf(e - 1.0));
        close(x.power_beyond(theta(a), Real::from(e)), value, by_start);
        let by_exponent = (at + a).powf(e) * (at + a).ln() - a.powf(e) * a.ln();
        close(x.power_beyond(Real::from(a), theta(e)), value, by_exponent);
    }
}
