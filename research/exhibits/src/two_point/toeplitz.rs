//! Products with triangular Toeplitz matrices.

use fvi_fft::real_transforms;
use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealToComplex};
use std::fmt;
use std::sync::Arc;

/// How products with a Toeplitz matrix are formed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Product {
    /// Sums, O(n²): the reference, and the fastest for short vectors.
    Sums,
    /// Fast Fourier transforms of length ≥ 2n − 1, O(n log n) time and O(n) memory.
    Transforms,
}

impl Product {
    /// The faster one for vectors of `length`.
    pub fn fastest(length: usize) -> Self {
        if length <= 256 { Self::Sums } else { Self::Transforms }
    }
}

/// A lower triangular Toeplitz matrix, T_{kj} = w_{k−j} for 0 ≤ j ≤ k < n, applied to each coordinate of
/// values on a grid.
pub struct LowerToeplitz {
    weights: Vec<f64>,
    transform: Option<Transform>,
}

impl fmt::Debug for LowerToeplitz {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let product = if self.transform.is_some() { Product::Transforms } else { Product::Sums };
        f.debug_struct("LowerToeplitz")
            .field("length", &self.weights.len())
            .field("product", &product)
            .finish()
    }
}

#[derive(Clone, Copy)]
enum Orientation {
    Plain,
    Transposed,
}

impl LowerToeplitz {
    /// The matrix with first column `weights`.
    pub fn new(weights: Vec<f64>, product: Product) -> Self {
        let transform = match product {
            Product::Sums => None,
            Product::Transforms => Some(Transform::new(&weights)),
        };
        Self { weights, transform }
    }

    /// The first column w₀…w_{n−1}.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Replaces `values`, n points of `coordinates` numbers each, by T·values: y_k = Σ_{j=0}^{k} w_{k−j} x_j.
    pub fn apply(&mut self, values: &mut [f64], coordinates: usize) {
        self.product(values, coordinates, Orientation::Plain);
    }

    /// Replaces `values`, n points of `coordinates` numbers each, by Tᵀ·values: y_j = Σ_{k=j}^{n−1} w_{k−j}
    /// x_k.
    pub fn apply_transposed(&mut self, values: &mut [f64], coordinates: usize) {
        self.product(values, coordinates, Orientation::Transposed);
    }

    fn product(&mut self, values: &mut [f64], coordinates: usize, orientation: Orientation) {
        assert_eq!(values.len(), self.weights.len() * coordinates, "one number per point and coordinate");
        for coordinate in 0..coordinates {
            match &mut self.transform {
                Some(transform) => transform.product(values, coordinate, coordinates, orientation),
                None => sums(&self.weights, values, coordinate, coordinates, orientation),
            }
        }
    }
}

/// In place: every sum reads only entries that are not yet overwritten.
fn sums(weights: &[f64], values: &mut [f64], coordinate: usize, stride: usize, orientation: Orientation) {
    let n = weights.len();
    let at = |k: usize| k * stride + coordinate;
    match orientation {
        Orientation::Plain => {
            for k in (0..n).rev() {
                values[at(k)] = (0..=k).map(|j| weights[k - j] * values[at(j)]).sum();
            }
        }
        Orientation::Transposed => {
            for j in 0..n {
                values[at(j)] = (j..n).map(|k| weights[k - j] * values[at(k)]).sum();
            }
        }
    }
}

struct Transform {
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
    /// Spectrum of the weights, divided by the length of the transform.
    spectrum: Vec<Complex<f64>>,
    signal: Vec<f64>,
    product: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
}

impl Transform {
    fn new(weights: &[f64]) -> Self {
        let length = (2 * weights.len()).next_power_of_two();
        let (forward, inverse) = real_transforms(length);
        let scratch_length = forward.get_scratch_len().max(inverse.get_scratch_len());
        let mut transform = Self {
            spectrum: forward.make_output_vec(),
            product: forward.make_output_vec(),
            signal: forward.make_input_vec(),
            scratch: vec![Complex::default(); scratch_length],
            forward,
            inverse,
        };
        transform.signal[..weights.len()].copy_from_slice(weights);
        transform.transform_signal();
        let normalisation = 1.0 / length as f64;
        for (kept, value) in transform.spectrum.iter_mut().zip(&transform.product) {
            *kept = value * normalisation;
        }
        transform
    }

    /// `product` becomes the spectrum of `signal`.
    fn transform_signal(&mut self) {
        let scratch = &mut self.scratch[..self.forward.get_scratch_len()];
        let outcome = self.forward.process_with_scratch(&mut self.signal, &mut self.product, scratch);
        debug_assert!(outcome.is_ok(), "the buffers come from the plan");
    }

    /// `signal` becomes the real signal of the spectrum `product`.
    fn transform_product(&mut self) {
        // Real signals have real first and last spectral values; rounding may have left something else.
        if let [first, .., last] = self.product.as_mut_slice() {
            first.im = 0.0;
            last.im = 0.0;
        }
        let scratch = &mut self.scratch[..self.inverse.get_scratch_len()];
        let outcome = self.inverse.process_with_scratch(&mut self.product, &mut self.signal, scratch);
        debug_assert!(outcome.is_ok(), "the buffers come from the plan");
    }

    /// The transposed product is the plain one with time reversed, hence the one with the conjugate spectrum:
    /// the wrapped part falls into the second half, which is dropped.
    fn product(&mut self, values: &mut [f64], coordinate: usize, stride: usize, orientation: Orientation) {
        let points = values.len() / stride;
        for (kept, value) in self.signal.iter_mut().zip(values[coordinate..].iter().step_by(stride)) {
            *kept = *value;
        }
        self.signal[points..].fill(0.0);
        self.transform_signal();
        for (value, weight) in self.product.iter_mut().zip(&self.spectrum) {
            *value *= match orientation {
                Orientation::Plain => *weight,
                Orientation::Transposed => weight.conj(),
            };
        }
        self.transform_product();
        for (value, result) in values[coordinate..].iter_mut().step_by(stride).zip(&self.signal) {
            *value = *result;
        }
    }
}
