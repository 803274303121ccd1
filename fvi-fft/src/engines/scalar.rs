//! The scalar of the engines.

use fvi_core::Real;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftNum};

use crate::engines::lanes::Lanes;

/// Scalar of the engines: `f32` or `f64`.
///
/// Transforms are computed in double precision for both: the library of transforms is the larger part of what
/// is compiled here, and rounding within a transform then costs single precision no digits.
pub trait Scalar: Real + FftNum + Lanes {
    /// Complex numbers of scratch that [`transform`](Self::transform) needs.
    fn transform_scratch(plan: &dyn Fft<f64>) -> usize;

    /// Transforms `numbers`, of the length of the plan, in place.
    fn transform(plan: &dyn Fft<f64>, numbers: &mut [Complex<Self>], scratch: &mut [Complex<f64>]);
}

impl Scalar for f64 {
    fn transform_scratch(plan: &dyn Fft<f64>) -> usize {
        plan.get_inplace_scratch_len()
    }

    fn transform(plan: &dyn Fft<f64>, numbers: &mut [Complex<f64>], scratch: &mut [Complex<f64>]) {
        plan.process_with_scratch(numbers, &mut scratch[..plan.get_inplace_scratch_len()]);
    }
}

impl Scalar for f32 {
    fn transform_scratch(plan: &dyn Fft<f64>) -> usize {
        plan.len() + plan.get_inplace_scratch_len()
    }

    fn transform(plan: &dyn Fft<f64>, numbers: &mut [Complex<f32>], scratch: &mut [Complex<f64>]) {
        let (wide, rest) = scratch.split_at_mut(plan.len());
        for (wide, number) in wide.iter_mut().zip(&*numbers) {
            *wide = Complex::new(f64::from(number.re), f64::from(number.im));
        }
        plan.process_with_scratch(wide, &mut rest[..plan.get_inplace_scratch_len()]);
        for (number, wide) in numbers.iter_mut().zip(&*wide) {
            *number = Complex::new(wide.re as f32, wide.im as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Scalar;
    use crate::engines::plans::Plans;

    #[test]
    fn single_precision_needs_room_for_its_numbers_in_double_precision() {
        let plan = Plans::new().plan(64).forward;
        assert_eq!(f32::transform_scratch(&*plan), 64 + f64::transform_scratch(&*plan));
    }
}
