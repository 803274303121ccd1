//! The near part: samples of the same block and the one before, summed directly.

use pulp::{Arch, Simd, WithSimd};

use crate::engines::row::{CHUNK, Row, add_product};
use crate::engines::scalar::Scalar;

/// Weights of a response at short lags, zero beyond its ends.
pub(crate) struct NearFilter<T> {
    /// Lags with weights that are not zero: from here …
    from: usize,
    /// … up to here.
    to: usize,
    /// The weights of lags n … n + 15 for each n ≥ −16, on cache lines.
    rows: Vec<Row<T>>,
    /// From the longest lag to lag 0, then zeros.
    reversed: Vec<T>,
}

impl<T: Scalar> NearFilter<T> {
    /// The weights of the lags below `lags`.
    pub(crate) fn new(weights: &[T], lags: usize) -> Self {
        let weights = &weights[..lags.min(weights.len())];
        let given = |weight: &T| *weight != T::zero();
        let weight = |lag: Option<usize>| lag.and_then(|lag| weights.get(lag)).copied();
        let row = |first: usize| {
            let of_place = |i: usize| weight((first + i).checked_sub(CHUNK)).unwrap_or(T::zero());
            Row(core::array::from_fn(of_place))
        };
        let reversed = (0..lags + CHUNK).map(|q| weight((lags - 1).checked_sub(q)).unwrap_or(T::zero()));
        Self {
            from: weights.iter().position(given).unwrap_or(weights.len()),
            to: weights.iter().rposition(given).map_or(0, |last| last + 1),
            rows: (0..lags + CHUNK).map(row).collect(),
            reversed: reversed.collect(),
        }
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.rows.as_slice()) + size_of_val(self.reversed.as_slice())
    }
}

/// The samples of the current block and as many before it as the near part reads, for each input.
pub(crate) struct Recent<T> {
    rows: Vec<Vec<T>>,
    back: usize,
    first: usize,
    unit: Arch,
}

/// Outputs from which on a chunk is computed together: its fixed cost is that of so many single ones.
const TOGETHER: usize = 6;

impl<T: Scalar> Recent<T> {
    /// For blocks of `first` samples, with `back` samples before them.
    pub(crate) fn new(inputs: usize, first: usize, back: usize, unit: Arch) -> Self {
        Self { rows: vec![vec![T::zero(); back + first + CHUNK]; inputs], back, first, unit }
    }

    /// Begins a block: the last samples of the finished one move to the front.
    pub(crate) fn begin_block(&mut self) {
        for row in &mut self.rows {
            row.copy_within(self.first..self.first + self.back, 0);
            row[self.back..].fill(T::zero());
        }
    }

    /// Places samples in the block, from place p on.
    pub(crate) fn store(&mut self, input: usize, p: usize, samples: &[T]) {
        let first = self.back + p;
        self.rows[input][first..first + samples.len()].copy_from_slice(samples);
    }

    /// Places the samples before the block.
    pub(crate) fn store_before(&mut self, input: usize, samples: &[T]) {
        self.rows[input][..self.back].copy_from_slice(samples);
    }

    /// Adds Σ w(n) x(k − n) over the samples stored, for the outputs at the places p … of the block.
    pub(crate) fn add(&self, input: usize, filter: &NearFilter<T>, p: usize, outputs: &mut [T]) {
        if filter.from >= filter.to {
            return;
        }
        let row = &self.rows[input];
        for (chunk, outputs) in outputs.chunks_mut(CHUNK).enumerate() {
            let place = self.back + p + chunk * CHUNK;
            if outputs.len() < TOGETHER {
                for (i, output) in outputs.iter_mut().enumerate() {
                    *output += self.one(row, filter, place + i);
                }
                continue;
            }
            let first = (place + 1).saturating_sub(filter.to);
            let last = (place + outputs.len()).saturating_sub(filter.from);
            if first >= last {
                continue;
            }
            // An even number of samples: weights of one too many are zero.
            let count = (last - first).next_multiple_of(2);
            let mut sums = Row::zeros();
            // Sample j has the lag place − j for the first output.
            let lags = &filter.rows[place + CHUNK + 1 - first - count..place + CHUNK + 1 - first];
            let samples = &row[first..first + count];
            self.unit.dispatch(Together { lags, samples, sums: &mut sums });
            outputs.iter_mut().zip(sums.0).for_each(|(output, sum)| *output += sum);
        }
    }

    /// One output, at an index of the row.
    fn one(&self, row: &[T], filter: &NearFilter<T>, place: usize) -> T {
        let first = (place + 1).saturating_sub(filter.to);
        let last = (place + 1).saturating_sub(filter.from);
        if first >= last {
            return T::zero();
        }
        let count = (last - first).next_multiple_of(CHUNK);
        let weights = self.back + self.first - 1 + first - place;
        let weights = &filter.reversed[weights..weights + count.min(filter.reversed.len() - weights)];
        self.unit.dispatch(Dot { weights, samples: &row[first..row.len().min(first + count)] })
    }

    pub(crate) fn clear(&mut self) {
        self.rows.iter_mut().for_each(|row| row.fill(T::zero()));
    }

    pub(crate) fn bytes(&self) -> usize {
        self.rows.iter().map(|row| size_of_val(row.as_slice())).sum()
    }
}

/// sums_i += Σ_j samples_j lags_{last − j, i}
struct Together<'a, T> {
    lags: &'a [Row<T>],
    samples: &'a [T],
    sums: &'a mut Row<T>,
}

impl<T: Scalar> WithSimd for Together<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, unit: V) {
        add_product(unit, self.sums, self.lags.iter().rev().zip(self.samples.iter().copied()));
    }
}

/// Σ weights_j samples_j over whole vectors.
struct Dot<'a, T> {
    weights: &'a [T],
    samples: &'a [T],
}

impl<T: Scalar> WithSimd for Dot<'_, T> {
    type Output = T;

    #[inline(always)]
    fn with_simd<V: Simd>(self, unit: V) -> T {
        let (weights, samples) = (T::reals::<V>(self.weights), T::reals::<V>(self.samples));
        let zero = T::in_lanes(unit, T::zero());
        let mut sums = [zero; 4];
        let (weights, last_weights) = weights.as_chunks::<4>();
        let (samples, last_samples) = samples.as_chunks::<4>();
        for (weights, samples) in weights.iter().zip(samples) {
            for ((sum, &weight), &sample) in sums.iter_mut().zip(weights).zip(samples) {
                *sum = T::plus_product(unit, weight, sample, *sum);
            }
        }
        // A row of samples may be shorter by the numbers whose weights are zero.
        let rest = if samples.len() < weights.len() { &[][..] } else { last_samples };
        for ((sum, &weight), &sample) in sums.iter_mut().zip(last_weights).zip(rest) {
            *sum = T::plus_product(unit, weight, sample, *sum);
        }
        let sum = T::plus(unit, T::plus(unit, sums[0], sums[1]), T::plus(unit, sums[2], sums[3]));
        let mut lanes = Row::<T>::zeros();
        if let Some(place) = lanes.parts_mut::<V>().first_mut() {
            *place = sum;
        }
        let lanes = lanes.0;
        let eight: [T; 8] = core::array::from_fn(|i| lanes[i] + lanes[i + 8]);
        let four: [T; 4] = core::array::from_fn(|i| eight[i] + eight[i + 4]);
        (four[0] + four[2]) + (four[1] + four[3])
    }
}
