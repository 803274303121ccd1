//! The scalar of the state: `f32` or `f64`, with every transcendental function from `libm`.

use core::cmp::Ordering;
use nalgebra::RealField;

/// Floating-point scalar of the state and of the memory: `f32` or `f64`.
///
/// Functions that reach the state are taken from `libm`, never from the platform, so that a host and a
/// microcontroller compute the same bits from the same program. Arithmetic and square roots are rounded as
/// IEEE 754 prescribes on both.
pub trait Real: RealField + Copy + Default {
    /// Distance from 1 to the next larger number, twice the unit roundoff u.
    const EPSILON: Self;

    /// The weights of the identity: a single 1.
    const IDENTITY: &'static [Self];

    /// Smallest positive number with all its digits.
    const SMALLEST_NORMAL: Self;

    /// Bytes of a number.
    const BYTES: usize;

    /// Nearest number to `value`.
    fn of(value: f64) -> Self;

    /// The same number as `f64`, exactly.
    fn to_f64(self) -> f64;

    /// Nearest number to the integer `count`.
    fn from_count(count: u64) -> Self;

    /// The bits of the number, in the lowest [`BYTES`](Real::BYTES) bytes.
    fn bits(self) -> u64;

    /// The number with these bits; those above the lowest [`BYTES`](Real::BYTES) bytes are ignored.
    fn of_bits(bits: u64) -> Self;

    /// `self` raised to `exponent`, from `libm`.
    fn power(self, exponent: Self) -> Self;
}

/// The larger of two numbers, for folds over sizes and errors; NaN if either is NaN, which `f64::max` would
/// leave out.
#[inline(always)]
pub fn max_or_nan<T: Real>(largest: T, number: T) -> T {
    match number.partial_cmp(&largest) {
        Some(Ordering::Greater) => number,
        Some(_) => largest,
        // One of them is NaN, and so is their sum.
        None => largest + number,
    }
}

/// The smaller of two numbers; NaN if either is NaN.
#[inline(always)]
pub fn min_or_nan<T: Real>(least: T, number: T) -> T {
    match number.partial_cmp(&least) {
        Some(Ordering::Less) => number,
        Some(_) => least,
        None => least + number,
    }
}

/// a + b rounded, and its exact rounding error. \[Knuth2\]
#[inline(always)]
pub(crate) fn sum_and_rest<T: Real>(a: T, b: T) -> (T, T) {
    let sum = a + b;
    let second = sum - a;
    (sum, (a - (sum - second)) + (b - second))
}

macro_rules! real {
    ($scalar:ident, $word:ident, $power:path) => {
        impl Real for $scalar {
            const EPSILON: Self = $scalar::EPSILON;
            const IDENTITY: &'static [Self] = &[1.0];
            const SMALLEST_NORMAL: Self = $scalar::MIN_POSITIVE;
            const BYTES: usize = size_of::<$scalar>();

            #[inline]
            fn of(value: f64) -> Self {
                value as $scalar
            }

            #[inline]
            fn to_f64(self) -> f64 {
                self as f64
            }

            #[inline]
            fn from_count(count: u64) -> Self {
                match i64::try_from(count) {
                    // Large processors have an instruction for signed numbers only.
                    Ok(count) if cfg!(target_pointer_width = "64") => count as $scalar,
                    _ => count as $scalar,
                }
            }

            #[inline]
            fn bits(self) -> u64 {
                u64::from($scalar::to_bits(self))
            }

            #[inline]
            fn of_bits(bits: u64) -> Self {
                $scalar::from_bits(bits as $word)
            }

            #[inline]
            fn power(self, exponent: Self) -> Self {
                $power(self, exponent)
            }
        }
    };
}

real!(f32, u32, libm::powf);
real!(f64, u64, libm::pow);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_is_kept_wherever_it_stands() {
        for place in 0..3 {
            let mut errors = [1.0, 3.0, 2.0];
            assert_eq!(errors.into_iter().fold(0.0, max_or_nan), 3.0);
            assert_eq!(errors.into_iter().fold(f64::INFINITY, min_or_nan), 1.0);
            errors[place] = f64::NAN;
            assert!(errors.into_iter().fold(0.0, max_or_nan).is_nan(), "{errors:?}");
            assert!(errors.into_iter().fold(f64::INFINITY, min_or_nan).is_nan(), "{errors:?}");
        }
    }
}
