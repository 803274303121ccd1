//! What the engines ask of a number.

use fvi_core::Real;
use rustfft::FftNum;

use crate::lanes::Lanes;

/// Scalar of the transform-based engines: `f32` or `f64`.
pub trait Scalar: Real + FftNum + Lanes {}

impl Scalar for f32 {}
impl Scalar for f64 {}
