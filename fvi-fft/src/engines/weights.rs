//! Source of the weights W₀, W₁, … of an engine.

use fvi_core::{ConvolutionWeights, ParameterError, Real};

/// Source of the convolution weights, which are requested in consecutive ranges.
///
/// An engine requests every weight exactly once and in order: the first call has `first` = 0, each later one
/// starts where the previous one ended. So a recursion can serve as a kernel, and a run needs no length in
/// advance.
///
/// Every closure `FnMut(usize, &mut [T])` is a kernel of plain numbers.
pub trait Weights<T> {
    /// Number of stages S: the weights are S×S matrices; 1 for plain numbers.
    fn stages(&self) -> usize {
        1
    }

    /// Writes W_first, W_{first+1}, …, each S×S numbers row by row; `weights` holds a whole number of
    /// matrices.
    fn fill(&mut self, first: usize, weights: &mut [T]);
}

impl<T, F: FnMut(usize, &mut [T])> Weights<T> for F {
    fn fill(&mut self, first: usize, weights: &mut [T]) {
        self(first, weights);
    }
}

/// A kernel given as a table; beyond its end the weights are zero.
///
/// The table holds S×S numbers for each weight, row by row.
#[derive(Clone, Copy, Debug)]
pub struct WeightTable<'a, T> {
    weights: &'a [T],
    stages: usize,
}

impl<'a, T> WeightTable<'a, T> {
    /// Table of plain numbers, w₀ first.
    pub fn scalars(weights: &'a [T]) -> Self {
        Self { weights, stages: 1 }
    }

    /// Table of S×S matrices, row by row, W₀ first. An incomplete last matrix is padded with zeros.
    pub fn matrices(weights: &'a [T], stages: usize) -> Self {
        Self { weights, stages }
    }
}

impl<T: Copy + Default> Weights<T> for WeightTable<'_, T> {
    fn stages(&self) -> usize {
        self.stages
    }

    fn fill(&mut self, first: usize, weights: &mut [T]) {
        let start = first.saturating_mul(self.stages * self.stages).min(self.weights.len());
        let known = weights.len().min(self.weights.len() - start);
        weights[..known].copy_from_slice(&self.weights[start..start + known]);
        weights[known..].fill(T::default());
    }
}

/// The weights of a convolution quadrature, from their recursion.
impl<T: Real> Weights<T> for ConvolutionWeights {
    fn fill(&mut self, _first: usize, weights: &mut [T]) {
        ConvolutionWeights::fill(self, weights);
    }
}

/// Checks that the channels are a whole number of groups of the kernel's stages and returns S.
pub(crate) fn check_shape<T>(kernel: &impl Weights<T>, channels: usize) -> Result<usize, ParameterError> {
    let stages = kernel.stages();
    let refused =
        |parameter, value: usize, allowed| ParameterError { parameter, value: value as f64, allowed };
    if stages == 0 {
        return Err(refused("stages", stages, "at least 1"));
    }
    if channels == 0 || !channels.is_multiple_of(stages) {
        return Err(refused("channels", channels, "a positive multiple of the kernel's stages"));
    }
    Ok(stages)
}

/// The first `count` weights, one plane for each entry of the matrices, row by row.
pub(crate) fn take_planes<T: Real>(kernel: &mut impl Weights<T>, count: usize) -> Vec<Vec<T>> {
    let stages = kernel.stages();
    let mut planes = vec![Vec::new(); stages * stages];
    extend_planes(kernel, &mut planes, count);
    planes
}

/// Requests the weights that the planes lack up to lag `count` − 1.
pub(crate) fn extend_planes<T: Real>(
    kernel: &mut (impl Weights<T> + ?Sized),
    planes: &mut [Vec<T>],
    count: usize,
) {
    const STRETCH: usize = 1024;
    let mut first = planes[0].len();
    let mut stretch = Vec::new();
    while first < count {
        let matrices = STRETCH.min(count - first);
        stretch.resize(matrices * planes.len(), T::zero());
        kernel.fill(first, &mut stretch);
        for (entry, plane) in planes.iter_mut().enumerate() {
            plane.extend(stretch.iter().skip(entry).step_by(stretch.len() / matrices));
        }
        first += matrices;
    }
}
