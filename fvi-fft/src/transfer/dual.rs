//! Values with their derivatives by one number, in any algebra in which transfer functions are evaluated.

use crate::transfer::algebra::Algebra;
use fvi_core::DoubleDouble;

/// f(θ) and f′(θ); operations follow the rules of differentiation.
#[derive(Clone, Debug)]
pub struct Dual<A> {
    /// f(θ).
    pub value: A,
    /// f′(θ).
    pub slope: A,
}

impl<A: Algebra> Dual<A> {
    /// A value that does not depend on θ.
    pub fn constant_in(value: &A) -> Self {
        Self { value: value.clone(), slope: value.constant(0.0) }
    }

    /// g(f(θ)), from g and g′ at f(θ).
    fn chain(&self, value: A, slope: &A) -> Self {
        Self { value, slope: self.slope.multiply(slope) }
    }
}

impl<A: Algebra> Algebra for Dual<A> {
    fn constant(&self, value: f64) -> Self {
        Self { value: self.value.constant(value), slope: self.value.constant(0.0) }
    }

    fn add(&self, other: &Self) -> Self {
        Self { value: self.value.add(&other.value), slope: self.slope.add(&other.slope) }
    }

    fn multiply(&self, other: &Self) -> Self {
        let slope = self.slope.multiply(&other.value).add(&self.value.multiply(&other.slope));
        Self { value: self.value.multiply(&other.value), slope }
    }

    fn divide(&self, other: &Self) -> Self {
        let value = self.value.divide(&other.value);
        let slope = self.slope.add(&value.multiply(&other.slope).negate()).divide(&other.value);
        Self { value, slope }
    }

    fn power(&self, exponent: DoubleDouble) -> Self {
        if exponent.to_f64() == 0.0 {
            return self.constant(1.0);
        }
        let below = self.value.power(exponent.add(DoubleDouble::exact(-1.0)));
        self.chain(self.value.power(exponent), &below.scale(exponent.to_f64()))
    }

    fn exponential(&self) -> Self {
        let value = self.value.exponential();
        self.chain(value.clone(), &value)
    }

    fn logarithm(&self) -> Self {
        let slope = self.value.constant(1.0).divide(&self.value);
        self.chain(self.value.logarithm(), &slope)
    }

    fn power_beside_one(&self, exponent: f64) -> Self {
        let one = self.value.constant(1.0);
        let below = self.value.add(&one).power(DoubleDouble::exact(exponent - 1.0));
        self.chain(self.value.power_beside_one(exponent), &below.scale(exponent))
    }

    fn exponential_beside_one(&self) -> Self {
        self.chain(self.value.exponential_beside_one(), &self.value.exponential())
    }

    fn is_left(&self) -> bool {
        self.value.is_left()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Complex;

    #[test]
    fn slopes_are_those_of_closed_forms() {
        let at = Complex::new(0.7, 1.1);
        let x = Dual { value: at, slope: Complex::new(1.0, 0.0) };
        let one = x.constant(1.0);
        let close = |found: Dual<Complex<f64>>, value: Complex<f64>, slope: Complex<f64>| {
            assert!(
                (found.value - value).norm() < 1e-14 && (found.slope - slope).norm() < 1e-14,
                "{found:?}"
            );
        };
        close(x.multiply(&x), at * at, at * 2.0);
        close(one.divide(&x.add(&one)), 1.0 / (1.0 + at), -1.0 / ((1.0 + at) * (1.0 + at)));
        close(x.power(DoubleDouble::exact(0.3)), at.powf(0.3), 0.3 * at.powf(-0.7));
        close(x.power(DoubleDouble::exact(0.0)), Complex::ONE, Complex::ZERO);
        close(x.scale(-2.0).exponential(), (-2.0 * at).exp(), -2.0 * (-2.0 * at).exp());
        close(x.logarithm(), at.ln(), 1.0 / at);
        close(x.power_beside_one(-0.4), (1.0 + at).powf(-0.4) - 1.0, -0.4 * (1.0 + at).powf(-1.4));
    }
}
