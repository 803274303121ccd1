//! Weights computed at start-up, for programs without a table in flash.

use fvi_core::{BdfOrder, ConvolutionWeights};

use crate::pointer::slice_mut;
use crate::status::{FviStatus, status};

/// Writes the convolution-quadrature weights w_0 … w_{count−1} of D^exponent for a step size.
///
/// `order` is that of the backward differentiation formula, 1…6; −1 < exponent < 2; negative for fractional
/// integrals. The weights contain the step size, so that the scale of the memory is 1. They are computed in
/// double precision, which is emulated in software on processors without it. Returns FVI_STATUS_NULL,
/// FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE or FVI_STATUS_OUT_OF_RANGE.
///
/// # Safety
/// `weights` must be writable for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_weights_bdf(
    order: u32,
    exponent: f64,
    step_size: f64,
    weights: *mut f32,
    count: usize,
) -> FviStatus {
    status((|| {
        // SAFETY: passed on.
        unsafe { fill(generator(order, exponent, step_size)?, weights, count) }
    })())
}

/// Writes the weights of the same operator for memories on increments (FVI_ON_INCREMENTS): w_0, w_0 + w_1, …
///
/// Otherwise as fvi_weights_bdf.
///
/// # Safety
/// `weights` must be writable for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fvi_increment_weights_bdf(
    order: u32,
    exponent: f64,
    step_size: f64,
    weights: *mut f32,
    count: usize,
) -> FviStatus {
    status((|| {
        // SAFETY: passed on.
        unsafe { fill(generator(order, exponent, step_size)?.on_increments(), weights, count) }
    })())
}

fn generator(order: u32, exponent: f64, step_size: f64) -> Result<ConvolutionWeights, FviStatus> {
    let order = BdfOrder::new(usize::try_from(order).unwrap_or(0))?;
    Ok(ConvolutionWeights::bdf(order, exponent, step_size)?)
}

/// # Safety
/// `weights` must be writable for `count` numbers.
unsafe fn fill(mut generator: ConvolutionWeights, weights: *mut f32, count: usize) -> Result<(), FviStatus> {
    // SAFETY: writable as promised; numbers may hold anything, they are written only.
    generator.fill(unsafe { slice_mut(weights, count) }?);
    Ok(())
}
