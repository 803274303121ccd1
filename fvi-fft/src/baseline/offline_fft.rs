//! The lower bound: convolution of data that are known in advance.

use std::sync::Arc;

use fvi_core::ParameterError;
use realfft::{ComplexToReal, RealToComplex};
use rustfft::num_complex::Complex;

use crate::engines::plans::real_transforms;
use crate::engines::weights::{Weights, check_shape, take_planes};

/// One forward real transform of the known signal, product with the cached kernel spectrum, one inverse.
///
/// Not a memory: every sample must be known at the start. Near and far lags share the transform, so it is not
/// exact to rounding either; it serves as a bound of the run time.
pub struct OfflineFft {
    length: usize,
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
    kernel: Vec<Complex<f64>>,
    padded: Vec<f64>,
    spectrum: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
}

impl OfflineFft {
    /// The convolution of `length` samples of one channel with a kernel of plain numbers.
    ///
    /// # Errors
    /// If the kernel has several stages or the length is zero.
    pub fn new(mut kernel: impl Weights<f64>, length: usize) -> Result<Self, ParameterError> {
        check_shape(&kernel, 1)?;
        if length == 0 {
            return Err(ParameterError { parameter: "length", value: 0.0, allowed: "at least 1" });
        }
        let size = (2 * length).next_power_of_two();
        let (forward, inverse) = real_transforms(size);
        let mut padded = take_planes(&mut kernel, length).remove(0);
        let scale = 1.0 / size as f64;
        padded.iter_mut().for_each(|weight| *weight *= scale);
        padded[0] = 0.0;
        padded.resize(size, 0.0);
        let spectrum = forward.make_output_vec();
        let scratch = forward.get_scratch_len().max(inverse.get_scratch_len());
        let mut offline = Self {
            length,
            kernel: Vec::new(),
            padded,
            spectrum,
            scratch: vec![Complex::new(0.0, 0.0); scratch],
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
    pub fn convolve(&mut self, signal: &[f64], terms: &mut [f64]) {
        self.padded[..self.length].copy_from_slice(&signal[..self.length]);
        self.padded[self.length..].fill(0.0);
        self.transform();
        for (number, weight) in self.spectrum.iter_mut().zip(&self.kernel) {
            *number *= *weight;
        }
        // The ends of a real spectrum are real; the transform insists on the sign of zero.
        let last = self.spectrum.len() - 1;
        (self.spectrum[0].im, self.spectrum[last].im) = (0.0, 0.0);
        let scratch = &mut self.scratch[..self.inverse.get_scratch_len()];
        let _ = self.inverse.process_with_scratch(&mut self.spectrum, &mut self.padded, scratch);
        terms[..self.length].copy_from_slice(&self.padded[..self.length]);
    }

    /// Bytes of tables and buffers.
    pub fn bytes(&self) -> usize {
        let complex = [&self.kernel, &self.spectrum, &self.scratch].map(Vec::len).iter().sum::<usize>();
        size_of::<Self>() + complex * size_of::<Complex<f64>>() + self.padded.len() * size_of::<f64>()
    }
}
