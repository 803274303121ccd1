//! Arithmetic with about 106 bits from pairs of `f64`, usable at compile time.

/// Unevaluated sum `high + low` with |low| at most half a unit in the last place of `high`.
///
/// The classical error-free transformations of \[Dekker71\] and \[Knuth2\]; products split their factors, so
/// that the same operations run in a `const fn` and on targets without fused multiply–add.
#[derive(Clone, Copy, Debug)]
pub struct DoubleDouble {
    high: f64,
    low: f64,
}

/// Sum and its exact rounding error.
const fn two_sum(a: f64, b: f64) -> DoubleDouble {
    let high = a + b;
    let b_part = high - a;
    DoubleDouble { high, low: (a - (high - b_part)) + (b - b_part) }
}

/// Sum and its exact rounding error for |a| ≥ |b|.
const fn quick_two_sum(a: f64, b: f64) -> DoubleDouble {
    let high = a + b;
    DoubleDouble { high, low: b - (high - a) }
}

/// The upper and lower 26 bits of `a`.
const fn split(a: f64) -> (f64, f64) {
    let scaled = 134_217_729.0 * a; // 2²⁷ + 1
    let upper = scaled - (scaled - a);
    (upper, a - upper)
}

/// Product and its exact rounding error.
const fn two_product(a: f64, b: f64) -> DoubleDouble {
    let high = a * b;
    let (a_upper, a_lower) = split(a);
    let (b_upper, b_lower) = split(b);
    let low = ((a_upper * b_upper - high) + a_upper * b_lower + a_lower * b_upper) + a_lower * b_lower;
    DoubleDouble { high, low }
}

impl DoubleDouble {
    /// 0.
    pub const ZERO: Self = Self::exact(0.0);
    /// 1.
    pub const ONE: Self = Self::exact(1.0);

    /// The number itself.
    pub const fn exact(value: f64) -> Self {
        Self { high: value, low: 0.0 }
    }

    /// The exact product of two numbers.
    pub const fn product(a: f64, b: f64) -> Self {
        two_product(a, b)
    }

    /// The nearest number in double precision.
    pub const fn to_f64(self) -> f64 {
        self.high
    }

    /// Rounding error of [`to_f64`](Self::to_f64).
    pub const fn low(self) -> f64 {
        self.low
    }

    /// Sum.
    pub const fn add(self, other: Self) -> Self {
        let high = two_sum(self.high, other.high);
        let low = two_sum(self.low, other.low);
        let carried = quick_two_sum(high.high, high.low + low.high);
        quick_two_sum(carried.high, carried.low + low.low)
    }

    /// Product.
    pub const fn multiply(self, other: Self) -> Self {
        let product = two_product(self.high, other.high);
        quick_two_sum(product.high, product.low + (self.high * other.low + self.low * other.high))
    }

    /// Product with a number.
    pub const fn scale(self, factor: f64) -> Self {
        let product = two_product(self.high, factor);
        quick_two_sum(product.high, product.low + self.low * factor)
    }

    /// Quotient by a number.
    pub const fn divide(self, divisor: f64) -> Self {
        let quotient = self.high / divisor;
        let back = two_product(quotient, divisor);
        let rest = (self.high - back.high) - back.low + self.low;
        quick_two_sum(quotient, rest / divisor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_third_times_three_keeps_thirty_digits() {
        let third = DoubleDouble::ONE.divide(3.0);
        let rest = third.scale(3.0).add(DoubleDouble::exact(-1.0));
        assert!(rest.to_f64().abs() < 1e-31, "{rest:?}");
    }

    #[test]
    fn what_cancellation_leaves_is_kept_whole() {
        let beside =
            |whole: f64, part: i32| DoubleDouble::exact(whole).add(DoubleDouble::exact(2f64.powi(part)));
        let left = beside(1.0, -60).add(beside(-1.0, -120));
        assert_eq!((left.to_f64(), left.low()), (2f64.powi(-60), 2f64.powi(-120)));
    }

    #[test]
    fn products_carry_their_rounding_error() {
        // (1 + 2⁻⁵²)² = 1 + 2⁻⁵¹ + 2⁻¹⁰⁴, and the last term is what f64 loses.
        let a = 1.0 + f64::EPSILON;
        let square = DoubleDouble::product(a, a);
        assert_eq!(square.high, 1.0 + 2.0 * f64::EPSILON);
        assert_eq!(square.low, f64::EPSILON * f64::EPSILON);
        let same = DoubleDouble::exact(a).multiply(DoubleDouble::exact(a));
        assert_eq!((same.high, same.low), (square.high, square.low));
    }
}
