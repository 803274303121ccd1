//! What the engines ask of a number, and what is compiled here for each of them.

use std::sync::Arc;

use fvi_core::Real;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftNum, FftPlanner};

use crate::lanes::Lanes;

/// Scalar of the engines: `f32` or `f64`.
///
/// Transforms come from the scalar, and not from a planner with a type parameter, so that what is generic and
/// large behind them is compiled once, in this crate, and not in every crate that uses it.
pub trait Scalar: Real + FftNum + Lanes {
    /// Complex transforms of a length, forward and inverse.
    fn transforms(length: usize) -> [Arc<dyn Fft<Self>>; 2];

    /// Transforms of real data of a length, forward and inverse.
    fn real_transforms(length: usize) -> (Arc<dyn RealToComplex<Self>>, Arc<dyn ComplexToReal<Self>>);
}

macro_rules! scalars {
    ($($scalar:ty)*) => {$(
        impl Scalar for $scalar {
            fn transforms(length: usize) -> [Arc<dyn Fft<Self>>; 2] {
                let mut planner = FftPlanner::new();
                [planner.plan_fft_forward(length), planner.plan_fft_inverse(length)]
            }

            fn real_transforms(
                length: usize,
            ) -> (Arc<dyn RealToComplex<Self>>, Arc<dyn ComplexToReal<Self>>) {
                let mut planner = RealFftPlanner::new();
                (planner.plan_fft_forward(length), planner.plan_fft_inverse(length))
            }
        }
    )*};
}

scalars!(f32 f64);
