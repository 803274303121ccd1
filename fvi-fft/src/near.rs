//! The near part: pairs of samples less than two blocks apart, summed directly.

use pulp::{Arch, Simd, WithSimd};

use crate::scalar::Scalar;

/// Outputs that are prepared together.
pub(crate) const CHUNK: usize = 16;

/// Direct sums over the lags of the block of the output and the block before it.
///
/// Outputs are prepared sixteen at a time, a *chunk*: when chunk [k, k + 16) begins, all samples before k are added, as a
/// Toeplitz matrix times a vector; samples within the chunk are added when they come.
pub(crate) struct Near<T> {
    block: usize,
    stages: usize,
    /// W₀, row by row.
    leading: Vec<T>,
    /// For each entry of the matrices, row by row, and each lag n < 2B₀ the weights of lags n … n + 15, so that they lie
    /// on whole cache lines wherever they begin.
    planes: Vec<Vec<Row<T>>>,
    /// Memory terms of the current chunk, one row per channel.
    terms: Vec<Row<T>>,
    unit: Arch,
}

/// Sixteen numbers on whole cache lines.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Row<T>([T; CHUNK]);

impl<T: Scalar> Near<T> {
    /// Near part of blocks of `block` samples; `planes` has the weights of at least 2 `block` lags for each entry.
    pub(crate) fn new(block: usize, stages: usize, channels: usize, planes: &[Vec<T>], unit: Arch) -> Self {
        Self {
            block,
            stages,
            leading: planes.iter().map(|plane| plane[0]).collect(),
            planes: planes.iter().map(|plane| rows(&plane[..2 * block])).collect(),
            terms: vec![Row([T::zero(); CHUNK]); channels],
            unit,
        }
    }

    pub(crate) fn leading(&self) -> &[T] {
        &self.leading
    }

    pub(crate) fn stages(&self) -> usize {
        self.stages
    }

    /// r_k of every channel.
    pub(crate) fn term(&self, k: usize, term: &mut [T]) {
        for (number, row) in term.iter_mut().zip(&self.terms) {
            *number = row.0[k % CHUNK];
        }
    }

    /// Adds what is due after the sample x_k, the last one of `signal`, to the terms of its chunk.
    ///
    /// If 2ⁱ is the largest power of two that divides k + 1, the last 2ⁱ samples are added to the next 2ⁱ terms: the
    /// binary splitting of \[HLS\], here to load and store each term four times only.
    pub(crate) fn push(&mut self, k: usize, signal: &[Vec<T>]) {
        match (k + 1) % CHUNK {
            0 => {}
            place if place % 8 == 0 => self.add_square::<8>(place, signal),
            place if place % 4 == 0 => self.add_square::<4>(place, signal),
            place if place % 2 == 0 => self.add_square::<2>(place, signal),
            place => self.add_square::<1>(place, signal),
        }
    }

    /// Adds the last M samples to the M terms from `place` on.
    #[inline(always)]
    fn add_square<const M: usize>(&mut self, place: usize, signal: &[Vec<T>]) {
        let mut group = 0;
        while group < self.terms.len() {
            for stage in 0..self.stages {
                let terms = &mut self.terms[group + stage].0[place..place + M];
                for other in 0..self.stages {
                    let plane = &self.planes[stage * self.stages + other][1..=M];
                    let Some(samples) = signal[group + other].last_chunk::<M>() else { continue };
                    let mut sums = [T::zero(); M];
                    for (&sample, weights) in samples.iter().rev().zip(plane) {
                        for (sum, &weight) in sums.iter_mut().zip(&weights.0) {
                            *sum += sample * weight;
                        }
                    }
                    for (term, &sum) in terms.iter_mut().zip(&sums) {
                        *term += sum;
                    }
                }
            }
            group += self.stages;
        }
    }

    /// Begins the chunk at k: `far` writes what the levels owe to a channel, then the near samples are added.
    pub(crate) fn begin(&mut self, k: usize, signal: &[Vec<T>], far: impl Fn(usize, &mut [T; CHUNK])) {
        let start = (k / self.block).saturating_sub(1) * self.block;
        let stages = self.stages;
        for (channel, row) in self.terms.iter_mut().enumerate() {
            *row = Row([T::zero(); CHUNK]);
            far(channel, &mut row.0);
            let (group, stage) = (channel / stages * stages, channel % stages);
            for other in 0..stages {
                let samples = &signal[group + other][start..k];
                let plane = &self.planes[stage * stages + other];
                self.unit.dispatch(Toeplitz { samples, plane, row: &mut row.0 });
            }
        }
    }

    /// Forgets all samples.
    pub(crate) fn clear(&mut self) {
        self.terms.fill(Row([T::zero(); CHUNK]));
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.leading.as_slice())
            + size_of_val(self.terms.as_slice())
            + self.planes.iter().map(|plane| size_of_val(plane.as_slice())).sum::<usize>()
    }
}

/// For each lag n the weights of lags n … n + 15, zero beyond the end.
fn rows<T: Scalar>(weights: &[T]) -> Vec<Row<T>> {
    let weight = |lag: usize| weights.get(lag).copied().unwrap_or(T::zero());
    (0..weights.len()).map(|first| Row(core::array::from_fn(|l| weight(first + l)))).collect()
}

/// row_i += Σ_j samples_j plane_{n + i − j}, n the number of samples.
struct Toeplitz<'a, T> {
    samples: &'a [T],
    plane: &'a [Row<T>],
    row: &'a mut [T; CHUNK],
}

impl<T: Scalar> WithSimd for Toeplitz<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, unit: S) {
        // A chunk begins at a multiple of sixteen, and so does the block before. Four accumulators a lane: the sums do
        // not wait for each other, and round less than one would.
        let quads = self.samples.as_chunks::<4>().0;
        let columns = self.plane[1..=self.samples.len()].as_chunks::<4>().0;
        for (part, row) in T::reals_mut::<S>(self.row).iter_mut().enumerate() {
            let mut sums = [T::in_lanes(unit, T::zero()); 4];
            for (quad, weights) in quads.iter().zip(columns.iter().rev()) {
                for c in 0..4 {
                    let weights = T::reals::<S>(&weights[3 - c].0)[part];
                    sums[c] = T::plus_product(unit, T::in_lanes(unit, quad[c]), weights, sums[c]);
                }
            }
            let sum = T::plus(unit, T::plus(unit, sums[0], sums[1]), T::plus(unit, sums[2], sums[3]));
            *row = T::plus(unit, *row, sum);
        }
    }
}
