//! Numbers with their derivatives: forward differentiation to order zero, one and two.

use super::Elementary;
use nalgebra::{SMatrix, SVector};

/// A number with its derivatives with respect to the variables, to some order.
pub(crate) trait Jet<T: Elementary>: Copy {
    fn constant(value: T) -> Self;
    fn value(&self) -> T;
    fn negate(self) -> Self;
    fn add(self, other: Self) -> Self;
    fn subtract(self, other: Self) -> Self;
    fn multiply(self, other: Self) -> Self;
    fn divide(self, other: Self) -> Self;

    /// f(self), from f and, where they are needed, (f′, f″) at the value.
    fn chain(self, value: T, slopes: impl FnOnce() -> (T, T)) -> Self;
}

impl<T: Elementary> Jet<T> for T {
    #[inline]
    fn constant(value: T) -> Self {
        value
    }

    #[inline]
    fn value(&self) -> T {
        *self
    }

    #[inline]
    fn negate(self) -> Self {
        -self
    }

    #[inline]
    fn add(self, other: Self) -> Self {
        self + other
    }

    #[inline]
    fn subtract(self, other: Self) -> Self {
        self - other
    }

    #[inline]
    fn multiply(self, other: Self) -> Self {
        self * other
    }

    #[inline]
    fn divide(self, other: Self) -> Self {
        self / other
    }

    #[inline]
    fn chain(self, value: T, _slopes: impl FnOnce() -> (T, T)) -> Self {
        value
    }
}

/// Value and gradient.
#[derive(Clone, Copy, Debug)]
pub(super) struct FirstOrder<T, const N: usize> {
    value: T,
    pub(super) gradient: SVector<T, N>,
}

impl<T: Elementary, const N: usize> FirstOrder<T, N> {
    pub(super) fn variable(value: T, index: usize) -> Self {
        Self { value, gradient: SVector::from_fn(|i, _| if i == index { T::one() } else { T::zero() }) }
    }
}

impl<T: Elementary, const N: usize> Jet<T> for FirstOrder<T, N> {
    #[inline]
    fn constant(value: T) -> Self {
        Self { value, gradient: SVector::zeros() }
    }

    #[inline]
    fn value(&self) -> T {
        self.value
    }

    #[inline]
    fn negate(self) -> Self {
        Self { value: -self.value, gradient: -self.gradient }
    }

    #[inline]
    fn add(self, other: Self) -> Self {
        Self { value: self.value + other.value, gradient: self.gradient + other.gradient }
    }

    #[inline]
    fn subtract(self, other: Self) -> Self {
        Self { value: self.value - other.value, gradient: self.gradient - other.gradient }
    }

    #[inline]
    fn multiply(self, other: Self) -> Self {
        Self {
            value: self.value * other.value,
            gradient: self.gradient * other.value + other.gradient * self.value,
        }
    }

    #[inline]
    fn divide(self, other: Self) -> Self {
        let value = self.value / other.value;
        Self { value, gradient: (self.gradient - other.gradient * value) / other.value }
    }

    #[inline]
    fn chain(self, value: T, slopes: impl FnOnce() -> (T, T)) -> Self {
        let (slope, _) = slopes();
        Self { value, gradient: self.gradient.map(|x| scaled(slope, x)) }
    }
}

/// Value, gradient and Hessian.
#[derive(Clone, Copy, Debug)]
pub(super) struct SecondOrder<T, const N: usize> {
    value: T,
    pub(super) gradient: SVector<T, N>,
    pub(super) hessian: SMatrix<T, N, N>,
}

impl<T: Elementary, const N: usize> SecondOrder<T, N> {
    pub(super) fn variable(value: T, index: usize) -> Self {
        Self { gradient: FirstOrder::variable(value, index).gradient, ..Self::constant(value) }
    }
}

impl<T: Elementary, const N: usize> Jet<T> for SecondOrder<T, N> {
    #[inline]
    fn constant(value: T) -> Self {
        Self { value, gradient: SVector::zeros(), hessian: SMatrix::zeros() }
    }

    #[inline]
    fn value(&self) -> T {
        self.value
    }

    #[inline]
    fn negate(self) -> Self {
        Self { value: -self.value, gradient: -self.gradient, hessian: -self.hessian }
    }

    #[inline]
    fn add(self, other: Self) -> Self {
        Self {
            value: self.value + other.value,
            gradient: self.gradient + other.gradient,
            hessian: self.hessian + other.hessian,
        }
    }

    #[inline]
    fn subtract(self, other: Self) -> Self {
        Self {
            value: self.value - other.value,
            gradient: self.gradient - other.gradient,
            hessian: self.hessian - other.hessian,
        }
    }

    #[inline]
    fn multiply(self, other: Self) -> Self {
        // (fg)″ = f″g + g″f + f′g′ᵀ + g′f′ᵀ.
        let cross = self.gradient * other.gradient.transpose();
        Self {
            value: self.value * other.value,
            gradient: self.gradient * other.value + other.gradient * self.value,
            hessian: self.hessian * other.value + other.hessian * self.value + (cross + cross.transpose()),
        }
    }

    #[inline]
    fn divide(self, other: Self) -> Self {
        // From f = rg: r′ = (f′ − rg′)/g and r″ = (f″ − rg″ − r′g′ᵀ − g′r′ᵀ)/g.
        let value = self.value / other.value;
        let gradient = (self.gradient - other.gradient * value) / other.value;
        let cross = gradient * other.gradient.transpose();
        let hessian = (self.hessian - other.hessian * value - (cross + cross.transpose())) / other.value;
        Self { value, gradient, hessian }
    }

    #[inline]
    fn chain(self, value: T, slopes: impl FnOnce() -> (T, T)) -> Self {
        let (slope, curvature) = slopes();
        let outer = self.gradient * self.gradient.transpose();
        Self {
            value,
            gradient: self.gradient.map(|x| scaled(slope, x)),
            hessian: self
                .hessian
                .zip_map(&outer, |inner, square| scaled(slope, inner) + scaled(curvature, square)),
        }
    }
}

/// slope·x, and 0 for x = 0 even where the slope is infinite: a variable that does not occur has no
/// influence.
#[inline]
fn scaled<T: Elementary>(slope: T, x: T) -> T {
    if x == T::zero() { x } else { slope * x }
}
