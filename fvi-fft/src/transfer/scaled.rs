//! Complex numbers with an exponent of their own, for formulas whose parts leave the range of numbers.

use crate::transfer::algebra::Algebra;
use crate::transfer::real::Real;
use nalgebra::Complex;

/// The complex number z e^x. Quotients like sinh(0.3 √s)/sinh √s have values where their parts overflow.
#[derive(Clone, Copy, Debug)]
pub struct Scaled {
    /// z.
    part: Complex<f64>,
    /// x.
    exponent: f64,
}

impl Scaled {
    /// A number as it is.
    pub fn of(part: Complex<f64>) -> Self {
        Self { part, exponent: 0.0 }
    }

    /// z e^x, 0 or infinite beyond the range of numbers.
    pub fn value(self) -> Complex<f64> {
        // In two factors, since e^x may leave the range where z e^x does not.
        let half = libm::exp(0.5 * self.exponent);
        if self.part == Complex::ZERO { self.part } else { self.part * half * half }
    }

    /// Part of the value that its exponent leaves to rounding: a rounded x moves e^x by as much.
    pub fn rounding(self) -> f64 {
        f64::EPSILON * (1.0 + self.exponent.abs())
    }

    /// The same number with |z| near 1.
    fn normal(self) -> Self {
        /// ln |z| up to which nothing is moved.
        const NEAR: f64 = 100.0;
        let size = libm::log(self.part.norm());
        if size.is_nan() || size.is_infinite() || size.abs() <= NEAR {
            return self;
        }
        let whole = libm::round(size);
        Self {
            part: self.part * libm::exp(-0.5 * whole) * libm::exp(-0.5 * whole),
            exponent: self.exponent + whole,
        }
    }
}

impl Algebra for Scaled {
    fn constant(&self, value: f64) -> Self {
        Self::of(Complex::new(value, 0.0)).normal()
    }

    fn add(&self, other: &Self) -> Self {
        let (large, small) = if self.part == Complex::ZERO
            || (other.part != Complex::ZERO && other.exponent > self.exponent)
        {
            (other, self)
        } else {
            (self, other)
        };
        let moved = small.part * libm::exp((small.exponent - large.exponent).min(0.0));
        Self { part: large.part + moved, exponent: large.exponent }.normal()
    }

    fn multiply(&self, other: &Self) -> Self {
        Self { part: self.part * other.part, exponent: self.exponent + other.exponent }.normal()
    }

    fn divide(&self, other: &Self) -> Self {
        Self { part: self.part / other.part, exponent: self.exponent - other.exponent }.normal()
    }

    fn power(&self, exponent: Real) -> Self {
        Self { part: self.part.power(exponent), exponent: self.exponent * exponent.to_f64() }.normal()
    }

    fn exponential(&self) -> Self {
        let x = self.value();
        Self { part: Complex::new(libm::cos(x.im), libm::sin(x.im)), exponent: x.re }
    }

    fn logarithm(&self) -> Self {
        Self::of(self.part.logarithm() + self.exponent)
    }

    fn power_beside_one(&self, exponent: Real) -> Self {
        let x = self.value();
        if x.norm() < 1.0 {
            return Self::of(x.power_beside_one(exponent));
        }
        self.add(&self.constant(1.0)).power(exponent).add(&self.constant(-1.0))
    }

    fn exponential_beside_one(&self) -> Self {
        let x = self.value();
        if x.re < 1.0 {
            return Self::of(x.exponential_beside_one());
        }
        self.exponential().add(&self.constant(-1.0))
    }

    fn is_left(&self) -> bool {
        self.part.re < 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: Complex<f64>, right: Complex<f64>) -> bool {
        (found - right).norm() <= 1e-13 * right.norm()
    }

    #[test]
    fn within_the_range_of_numbers_it_counts_as_complex_numbers_do() {
        fn of<A: Algebra>(x: &A, y: &A) -> Vec<A> {
            let exponent = Real::from(0.3);
            vec![
                x.add(y),
                x.multiply(y).add(&x.constant(-2.0)),
                x.divide(y).power(exponent),
                x.exponential().multiply(&y.negate().exponential()),
                x.logarithm(),
                y.scale(0.01).power_beside_one(exponent),
                x.power_beside_one(exponent),
                y.negate().exponential_beside_one(),
                x.exponential_beside_one(),
                x.scale(1e-30).exponential_beside_one(),
            ]
        }
        let (x, y) = (Complex::new(3.0, 4.0), Complex::new(0.5, -20.0));
        for (k, (scaled, plain)) in of(&Scaled::of(x), &Scaled::of(y)).iter().zip(of(&x, &y)).enumerate() {
            assert!(close(scaled.value(), plain), "{k}: {scaled:?} for {plain}");
        }
    }

    #[test]
    fn quotients_of_what_overflows_are_numbers() {
        let sine = |x: &Scaled| x.exponential().add(&x.negate().exponential().negate()).scale(0.5);
        for x in [Complex::new(2000.0, 0.0), Complex::new(1500.0, 1500.0), Complex::new(1e4, 3.0)] {
            let large = Scaled::of(x);
            // sinh(0.99 x)/sinh x → e^{−0.01 x}
            let right = (x * (0.99 - 1.0)).exponential();
            let found = sine(&large.scale(0.99)).divide(&sine(&large));
            assert!((found.value() - right).norm() <= 1e-11 * right.norm(), "{x}: {found:?} for {right}");
            assert!(found.rounding() < 1e-11);
            // 1/sinh x is nothing, and sinh x beyond all numbers.
            assert_eq!(large.constant(1.0).divide(&sine(&large)).value(), Complex::ZERO);
            assert!(sine(&large).value().norm().is_infinite());
        }
    }
}
