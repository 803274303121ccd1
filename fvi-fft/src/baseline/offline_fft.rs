//! The lower bound: convolution of data that are known beforehand.

use std::sync::Arc;

use fvi_core::ParameterError;
use realfft::{ComplexToReal, RealToComplex};
use rustfft::num_complex::Complex;

use crate::scalar::Scalar;
use crate::weights::{Weights, check_shape, take_planes};

/// One forward real transform of the known signal, product with the cached kernel spectrum, one inverse.
///
/// Not a memory: every sample must be known at the start. Near and far lags share the transform, so it is not
/// exact to rounding either; it is here for its time.
pub struct OfflineFft<T: Scalar> {
    length: usize,
    forward: Arc<dyn RealToComplex<T>>,
    inverse: Arc<dyn ComplexToReal<T>>,
    kernel: Vec<Complex<T>>,
    padded: Vec<T>,
    spectrum: Vec<Complex<T>>,
    scratch: Vec<Complex<T>>,
}

impl<T: Scalar> OfflineFft<T> {
    /// The convolution of `length` samples of one channel with a kernel of plain numbers.
    ///
    /// # Errors
    /// If the kernel has several stages or the length is zero.
    pub fn new(mut kernel: impl Weights<T>, length: usize) -> Result<Self, ParameterError> {
        check_shape(&kernel, 1)?;
        if length == 0 {
            return Err(ParameterError { parameter: "length", value: 0.0, allowed: "at least 1" });
        }
        let size = (2 * length).next_power_of_two();
        let (forward, inverse) = T::real_transforms(size);
        let mut padded = take_planes(&mut kernel, length).remove(0);
        let scale = T::of(1.0 / size as f64);
        padded.iter_mut().for_each(|weight| *weight *= scale);
        padded[0] = T::zero();
        padded.resize(size, T::zero());
        let spectrum = forward.make_output_vec();
        let scratch = forward.get_scratch_len().max(inverse.get_scratch_len());
        let mut offline = Self {
            length,
            kernel: Vec::new(),
            padded,
            spectrum,
            scratch: vec![Complex::new(T::zero(), T::zero()); scratch],
            forward,
            inverse,
        };
        offline.transform();
        offline.kernel = offline.spectrum.clone();
        Ok(offline)
    }

    /// Transforms `padded` to `spectrum`.
    fn transform(&mut self) {
        let scratch = &mut self.scratch[..self.forward.get_scratch_len()];
        // All lengths are those of the plan, so the transform cannot refuse.
        let _ = self.forward.process_with_scratch(&mut self.padded, &mut self.spectrum, scratch);
    }

    /// Writes r_k for k = 0 … length − 1.
    ///
    /// # Panics
    /// If a slice is shorter than the length.
    pub fn convolve(&mut self, signal: &[T], terms: &mut [T]) {
        self.padded[..self.length].copy_from_slice(&signal[..self.length]);
        self.padded[self.length..].fill(T::zero());
        self.transform();
        for (number, weight) in self.spectrum.iter_mut().zip(&self.kernel) {
            *number *= *weight;
        }
        // The ends of a real spectrum are real; the transform insists on the sign of zero.
        let last = self.spectrum.len() - 1;
        (self.spectrum[0].im, self.spectrum[last].im) = (T::zero(), T::zero());
        let scratch = &mut self.scratch[..self.inverse.get_scratch_len()];
        let _ = self.inverse.process_with_scratch(&mut self.spectrum, &mut self.padded, scratch);
        terms[..self.length].copy_from_slice(&self.padded[..self.length]);
    }

    /// Bytes of tables and buffers.
    pub fn bytes(&self) -> usize {
        let complex = self.kernel.len() + self.spectrum.len() + self.scratch.len();
        size_of::<Self>() + complex * size_of::<Complex<T>>() + self.padded.len() * size_of::<T>()
    }
}
