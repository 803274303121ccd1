//! The near part: pairs of samples not far apart, summed directly.

use pulp::{Arch, Simd, WithSimd};

use crate::engines::row::{CHUNK, Row, add_product};
use crate::engines::scalar::Scalar;

/// Direct sums over the lags below a limit.
///
/// Outputs are prepared sixteen at a time, a *chunk*: when chunk [k, k + 16) begins, all samples before k are
/// added, as a Toeplitz matrix times a vector; samples within the chunk are added when they come.
pub(crate) struct Near<T> {
    stages: usize,
    /// W₀, row by row.
    leading: Vec<T>,
    /// For each entry of the matrices, row by row, and each lag n below the limit the weights of lags n … n +
    /// 15, stored separately so that each row begins on a cache line.
    planes: Vec<Vec<Row<T>>>,
    /// For each entry and each place in a chunk, the weights with which a sample there enters the terms of
    /// its chunk: zero up to its place.
    within: Vec<[Row<T>; CHUNK]>,
    /// Memory terms of the current chunk, one row per channel.
    terms: Vec<Row<T>>,
    unit: Arch,
}

impl<T: Scalar> Near<T> {
    /// Near part of the lags below `lags`; `planes` has the weights of at least as many for each entry.
    pub(crate) fn new(lags: usize, stages: usize, channels: usize, planes: &[Vec<T>], unit: Arch) -> Self {
        Self {
            stages,
            leading: planes.iter().map(|plane| plane[0]).collect(),
            planes: planes.iter().map(|plane| rows(&plane[..lags])).collect(),
            within: planes.iter().map(|plane| within(plane)).collect(),
            terms: vec![Row::zeros(); channels],
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
    #[inline]
    pub(crate) fn term(&self, k: usize, term: &mut [T]) {
        if let ([number], [row]) = (&mut *term, &*self.terms) {
            *number = row.0[k % CHUNK];
            return;
        }
        for (number, row) in term.iter_mut().zip(&self.terms) {
            *number = row.0[k % CHUNK];
        }
    }

    /// Adds the sample x_k to the later terms of its chunk.
    #[inline]
    pub(crate) fn push(&mut self, k: usize, sample: &[T]) {
        let place = k % CHUNK;
        if let ([term], [x], [within]) = (&mut *self.terms, sample, &*self.within) {
            add_within(term, &within[place], *x, place);
            return;
        }
        let stages = self.stages;
        for (terms, sample) in self.terms.chunks_exact_mut(stages).zip(sample.chunks_exact(stages)) {
            for (term, planes) in terms.iter_mut().zip(self.within.chunks_exact(stages)) {
                for (within, &x) in planes.iter().zip(sample) {
                    add_within(term, &within[place], x, place);
                }
            }
        }
    }

    /// Begins the chunk after all of `signal`. Each channel's terms start with `far(channel)`, the
    /// contribution of the older samples; the latest `count` samples are added to it directly. `count` is
    /// even, and small enough that the lags of a whole chunk remain below the limit.
    pub(crate) fn begin(&mut self, count: usize, signal: &[Vec<T>], mut far: impl FnMut(usize) -> Row<T>) {
        let stages = self.stages;
        for (channel, row) in self.terms.iter_mut().enumerate() {
            *row = far(channel);
            let (group, stage) = (channel / stages * stages, channel % stages);
            for other in 0..stages {
                let samples = &signal[group + other];
                let samples = &samples[samples.len() - count..];
                let plane = &self.planes[stage * stages + other];
                self.unit.dispatch(Toeplitz { samples, plane, row });
            }
        }
    }

    /// Forgets all samples.
    pub(crate) fn clear(&mut self) {
        self.terms.fill(Row::zeros());
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.leading.as_slice())
            + size_of_val(self.terms.as_slice())
            + size_of_val(self.within.as_slice())
            + self.planes.iter().map(|plane| size_of_val(plane.as_slice())).sum::<usize>()
    }
}

/// For each lag n the weights of lags n … n + 15, zero beyond the end.
fn rows<T: Scalar>(weights: &[T]) -> Vec<Row<T>> {
    let weight = |lag: usize| weights.get(lag).copied().unwrap_or(T::zero());
    (0..weights.len()).map(|first| Row(core::array::from_fn(|l| weight(first + l)))).collect()
}

/// For each place in a chunk the weights for the later terms, up to the end of the chunk.
fn within<T: Scalar>(weights: &[T]) -> [Row<T>; CHUNK] {
    let weight = |place: usize, i: usize| if i > place { weights.get(i - place).copied() } else { None };
    core::array::from_fn(|place| Row(core::array::from_fn(|i| weight(place, i).unwrap_or(T::zero()))))
}

/// terms += x weights for a sample at `place` in their chunk: too short for a call of another vector unit.
#[inline(always)]
fn add_within<T: Scalar>(terms: &mut Row<T>, weights: &Row<T>, x: T, place: usize) {
    const HALF: usize = CHUNK / 2;
    let ([first, second], [first_weights, second_weights]) =
        (terms.0.as_chunks_mut::<HALF>().0, weights.0.as_chunks::<HALF>().0)
    else {
        return;
    };
    let add = |terms: &mut [T; HALF], weights: &[T; HALF]| {
        let before = *terms;
        *terms = core::array::from_fn(|i| before[i] + weights[i] * x);
    };
    if place + 1 < HALF {
        add(first, first_weights);
    }
    add(second, second_weights);
}

/// row_i += Σ_j samples_j plane_{n + i − j}, n the number of samples.
struct Toeplitz<'a, T> {
    samples: &'a [T],
    plane: &'a [Row<T>],
    row: &'a mut Row<T>,
}

impl<T: Scalar> WithSimd for Toeplitz<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, unit: V) {
        let columns = self.plane[1..=self.samples.len()].iter().rev();
        add_product(unit, self.row, columns.zip(self.samples.iter().copied()));
    }
}
