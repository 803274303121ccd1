//! The tiled memory: the direct sum with the far history summed for eight outputs at a time.

use crate::direct::Overflow;
use crate::error::ParameterError;
use crate::linear::at;
use crate::memory::{ActsOn, Memory, MemoryError, check_channels};
use crate::real::Real;
use crate::saving::{Shape, StateError, StateReader, StateWriter, Stateful, fingerprint, header_bytes};

/// Kind of the saved state.
const TAG: [u8; 4] = *b"tile";

/// Number of samples in a block, and of outputs for which a block is summed at a time.
const TILE: usize = 8;

/// A direct memory r_k = Σ_{n=1}^{k} w_n x_{k−n} that sums its far history for eight outputs at a time.
///
/// Samples lie in blocks of eight. The sums of a tile of eight outputs over all blocks but the latest two are
/// made while the eight outputs before it are served, an eighth of them with every push: each product then
/// needs a quarter of a load instead of two, and no step costs more than another by more than one block. What
/// is left for a term are the 8 to 15 latest samples. The number of products is that of
/// [`Direct`](crate::Direct).
///
/// `C` channels, `B` blocks: at most 8·B samples in full memory, lags up to 8·(B−1) in short memory. The
/// weights are borrowed and may lie in flash; those beyond the end of the table count as zero. All are
/// multiplied by `scale`. Kernels of plain numbers only.
///
/// **Order of the sum.** Eight partial sums over the far blocks, each from the oldest sample to the newest,
/// one after another; added up in this order; plus the sum over the latest full block, oldest first, plus the
/// sum over the block being filled, oldest first. It depends on the samples alone: the same bits on every
/// machine.
#[derive(Clone, Debug)]
pub struct Tiled<'w, T, const C: usize, const B: usize> {
    weights: &'w [T],
    scale: T,
    leading: [T; 1],
    channels: [Channel<T, B>; C],
    overflow: Overflow,
    acts_on: ActsOn,
    len: usize,
}

#[derive(Clone, Copy, Debug)]
struct Channel<T, const B: usize> {
    blocks: [[T; TILE]; B],
    /// Far sums of the present tile.
    present: [T; TILE],
    /// Far sums of the next tile, as far as they have been made.
    next: [T; TILE],
}

impl<T: Real, const B: usize> Channel<T, B> {
    fn empty() -> Self {
        Self { blocks: [[T::zero(); TILE]; B], present: [T::zero(); TILE], next: [T::zero(); TILE] }
    }

    /// All numbers of the state.
    fn numbers(&self) -> impl Iterator<Item = &T> {
        self.blocks.as_flattened().iter().chain(&self.present).chain(&self.next)
    }

    /// All numbers of the state, to be written.
    fn numbers_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.blocks.as_flattened_mut().iter_mut().chain(&mut self.present).chain(&mut self.next)
    }

    /// Adds the contribution of `count` blocks to the sums of the next tile; the first block has the index
    /// `first` and the distance `distance` from that tile.
    #[inline]
    fn add_far(&mut self, weights: &[T], first: usize, distance: usize, count: usize) {
        let (behind_cut, before_cut) = self.blocks.split_at((first % B.max(1)).min(B));
        let (older, _) = before_cut.split_at(count.min(before_cut.len()));
        let (newer, _) = behind_cut.split_at((count - older.len()).min(behind_cut.len()));
        let mut sums = [T::zero(); TILE];
        for (blocks, distance) in [(older, distance), (newer, distance.saturating_sub(older.len()))] {
            if !blocks.is_empty() {
                add_blocks(&mut sums, weights, blocks, distance);
            }
        }
        for (next, sum) in self.next.iter_mut().zip(sums) {
            *next += sum;
        }
    }
}

/// Adds blocks; the first has the given distance from the tile, and the distance decreases by one from each
/// to the next.
#[inline]
fn add_blocks<T: Real>(sums: &mut [T; TILE], weights: &[T], blocks: &[[T; TILE]], distance: usize) {
    let (table, rest) = weights.as_chunks::<TILE>();
    // A block at the distance d needs the chunks d − 1 and d of the table.
    let beyond = (distance + 1).saturating_sub(table.len()).min(blocks.len());
    let (beyond, within) = blocks.split_at(beyond);
    if !beyond.is_empty() {
        let mut last = [T::zero(); TILE];
        last.iter_mut().zip(rest).for_each(|(padded, &weight)| *padded = weight);
        let zero = [T::zero(); TILE];
        let chunk =
            |index: usize| table.get(index).unwrap_or(if index == table.len() { &last } else { &zero });
        for (block, distance) in beyond.iter().zip((1..=distance).rev()) {
            add_block(sums, chunk(distance - 1), chunk(distance), block);
        }
    }
    let distance = distance - beyond.len().min(distance);
    let (less, greater) = (table.get(..distance).unwrap_or(&[]), table.get(1..=distance).unwrap_or(&[]));
    let pairs = less.iter().rev().zip(greater.iter().rev());
    let mut registers = *sums;
    for (block, (less, greater)) in within.iter().zip(pairs) {
        add_block(&mut registers, less, greater, block);
    }
    *sums = registers;
}

/// Adds Σ_i w_{m+j−i} x_i to sum j, where `less` holds w_{m−8} … w_{m−1} and `greater` w_m … w_{m+7}.
#[inline]
fn add_block<T: Real>(sums: &mut [T; TILE], less: &[T; TILE], greater: &[T; TILE], block: &[T; TILE]) {
    for (i, &sample) in block.iter().enumerate() {
        let weights = less.iter().skip(TILE - i).chain(greater);
        for (sum, &weight) in sums.iter_mut().zip(weights) {
            *sum += weight * sample;
        }
    }
}

/// Σ w_n x over samples, oldest first, with weights in ascending order of lags.
#[inline]
fn near_sum<T: Real>(weights: &[T], samples: &[T]) -> T {
    let behind = samples.len().saturating_sub(weights.len());
    let samples = samples.get(behind..).unwrap_or(&[]);
    let weights = weights.get(..samples.len()).unwrap_or(&[]);
    samples.iter().zip(weights.iter().rev()).fold(T::zero(), |sum, (&x, &w)| sum + w * x)
}

impl<'w, T: Real, const C: usize, const B: usize> Tiled<'w, T, C, B> {
    /// A memory that [`Refuse`](Overflow::Refuse)s to take more than 8·B samples, or
    /// [`Forget`](Overflow::Forget)s what lies more than 8·(B−1) samples back.
    ///
    /// # Errors
    /// If C is 0, B is less than 3, the table is empty, or a weight or the scale is not finite.
    pub fn new(weights: &'w [T], scale: T, overflow: Overflow) -> Result<Self, ParameterError> {
        ParameterError::check(C > 0, "channels", C as f64, "at least 1")?;
        ParameterError::check(B >= 3, "blocks", B as f64, "at least 3")?;
        ParameterError::check(!weights.is_empty(), "number of weights", 0.0, "at least 1")?;
        if let Some(weight) = weights.iter().find(|weight| !weight.is_finite()) {
            return Err(ParameterError { parameter: "weight", value: weight.to_f64(), allowed: "finite" });
        }
        ParameterError::check(scale.is_finite(), "scale", scale.to_f64(), "finite")?;
        let weights = match overflow {
            Overflow::Refuse => weights,
            Overflow::Forget => weights.get(..=TILE * (B - 1)).unwrap_or(weights),
        };
        let leading = [at(weights, 0) * scale];
        let channels = [Channel::empty(); C];
        Ok(Self { weights, scale, leading, channels, overflow, acts_on: ActsOn::Values, len: 0 })
    }

    /// The same memory, with weights for samples of the given kind.
    pub fn acting_on(self, acts_on: ActsOn) -> Self {
        Self { acts_on, ..self }
    }

    /// Header of the saved state: the values that must match when it is restored.
    fn shape(&self) -> Shape<4> {
        let refuses = u64::from(self.overflow == Overflow::Refuse);
        let kernel = fingerprint(self.weights) ^ self.scale.bits();
        [
            ("channels", C as u64),
            ("blocks", B as u64),
            ("refusal of an overflow", refuses),
            ("fingerprint of the kernel", kernel),
        ]
    }

    /// Reads the number of samples in a saved state.
    fn count(&self, from: &mut StateReader<'_>) -> Result<usize, StateError> {
        from.header::<T, 4>(TAG, &self.shape())?;
        from.count_up_to("samples", if self.overflow == Overflow::Refuse { TILE * B } else { usize::MAX })
    }

    fn check_capacity(&self) -> Result<(), MemoryError> {
        let capacity = TILE * B;
        match self.overflow {
            Overflow::Refuse if self.len >= capacity => Err(MemoryError::Full { capacity }),
            Overflow::Refuse | Overflow::Forget => Ok(()),
        }
    }
}

impl<T: Real, const C: usize, const B: usize> Memory<T> for Tiled<'_, T, C, B> {
    fn channels(&self) -> usize {
        C
    }

    fn acts_on(&self) -> ActsOn {
        self.acts_on
    }

    fn leading(&self) -> &[T] {
        &self.leading
    }

    fn len(&self) -> usize {
        self.len
    }

    #[inline]
    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        check_channels(C, term.len())?;
        self.check_capacity()?;
        let (tile, place) = (self.len / TILE, self.len % TILE);
        let (present, before) = self
            .weights
            .get(1..)
            .unwrap_or(&[])
            .split_at_checked(place)
            .unwrap_or((self.weights.get(1..).unwrap_or(&[]), &[]));
        for (term, channel) in term.iter_mut().zip(&self.channels) {
            let block = |index: usize| channel.blocks.get(index % B.max(1)).map_or(&[][..], |block| block);
            let far = at(&channel.present, place);
            // The block before the first contains zeros, by `clear` and `new`.
            let full = near_sum(before, block(tile + B - 1));
            let filling = near_sum(present, block(tile).get(..place).unwrap_or(&[]));
            *term = (far + full + filling) * self.scale;
        }
        Ok(())
    }

    #[inline]
    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        check_channels(C, sample.len())?;
        self.check_capacity()?;
        let (tile, place) = (self.len / TILE, self.len % TILE);
        let oldest = (tile + 2).saturating_sub(B);
        let far = tile - oldest;
        let (done, due) = (far * place / TILE, far * (place + 1) / TILE);
        for (channel, &number) in self.channels.iter_mut().zip(sample) {
            let block = channel.blocks.get_mut(tile % B.max(1));
            if let Some(kept) = block.and_then(|block| block.get_mut(place)) {
                *kept = number;
            }
            channel.add_far(self.weights, oldest + done, far + 1 - done, due - done);
            if place == TILE - 1 {
                channel.present = channel.next;
                channel.next = [T::zero(); TILE];
            }
        }
        self.len = self.len.saturating_add(1);
        Ok(())
    }

    fn clear(&mut self) {
        self.channels = [Channel::empty(); C];
        self.len = 0;
    }

    fn bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(self.weights)
    }
}

impl<T: Real, const C: usize, const B: usize> Stateful for Tiled<'_, T, C, B> {
    fn state_bytes(&self) -> usize {
        header_bytes(5) + C * (B + 2) * TILE * T::BYTES
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 4>(TAG, &self.shape())?;
        to.count(self.len as u64)?;
        self.channels.iter().try_for_each(|channel| to.numbers(channel.numbers()))
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.count(from)?;
        from.skip::<T>(C * (B + 2) * TILE)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        self.len = self.count(from)?;
        self.channels.iter_mut().try_for_each(|channel| from.numbers(channel.numbers_mut()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::direct::FixedDirect;
    use crate::noise::noise;

    /// Runs both memories side by side; the terms agree to rounding of at most a few hundred products of size
    /// ¼.
    fn agree(mut tiled: impl Memory<f64>, mut direct: impl Memory<f64>, steps: usize) {
        for (k, pair) in noise(2 * steps).chunks(2).enumerate() {
            let (mut fast, mut plain) = ([f64::NAN; 2], [f64::NAN; 2]);
            tiled.next_term(&mut fast).unwrap();
            direct.next_term(&mut plain).unwrap();
            for (fast, plain) in fast.into_iter().zip(plain) {
                assert!((fast - plain).abs() <= 1e-14, "step {k}: {fast} and {plain}");
            }
            tiled.push(pair).unwrap();
            direct.push(pair).unwrap();
        }
    }

    #[test]
    fn full_memory_is_the_direct_sum_until_it_refuses() {
        // A table as long as the memory, shorter, and longer, so that its end falls on every place in a
        // window.
        for reach in [1, 2, 7, 8, 9, 30, 31, 32, 33, 63, 64, 200] {
            let weights = noise(reach);
            let tiled = || Tiled::<f64, 2, 8>::new(&weights, 0.5, Overflow::Refuse).unwrap();
            let direct = FixedDirect::<f64, 2, 64>::full_memory(&weights, 0.5).unwrap();
            agree(tiled(), direct, 64);
            let mut full = tiled();
            for _ in 0..64 {
                full.push(&[1.0, 2.0]).unwrap();
            }
            assert_eq!(full.push(&[1.0, 2.0]), Err(MemoryError::Full { capacity: 64 }));
            assert_eq!(full.next_term(&mut [0.0; 2]), Err(MemoryError::Full { capacity: 64 }));
            full.clear();
            agree(full, FixedDirect::<f64, 2, 64>::full_memory(&weights, 0.5).unwrap(), 64);
        }
    }

    #[test]
    fn tables_that_end_among_many_blocks_lose_nothing() {
        // With forty blocks several are added with every push, some of them on either side of the table's
        // end.
        for reach in [70, 100, 155] {
            let weights = noise(reach);
            let tiled = Tiled::<f64, 2, 40>::new(&weights, 1.0, Overflow::Refuse).unwrap();
            agree(tiled, FixedDirect::<f64, 2, 320>::full_memory(&weights, 1.0).unwrap(), 320);
        }
    }

    #[test]
    fn short_memory_forgets_beyond_all_blocks_but_one() {
        let weights = noise(300);
        let tiled = Tiled::<f64, 2, 5>::new(&weights, 1.0, Overflow::Forget).unwrap();
        let direct = FixedDirect::<f64, 2, 32>::short_memory(&weights, 1.0).unwrap();
        agree(tiled, direct, 250);
    }

    #[test]
    fn a_term_may_be_asked_for_again() {
        let weights = noise(100);
        let mut memory = Tiled::<f64, 1, 8>::new(&weights, 1.0, Overflow::Refuse).unwrap();
        for sample in noise(40) {
            let (mut first, mut second) = ([0.0], [1.0]);
            memory.next_term(&mut first).unwrap();
            memory.next_term(&mut second).unwrap();
            assert_eq!(first, second);
            memory.push(&[sample]).unwrap();
        }
    }

    #[test]
    fn bad_tables_and_slices_are_refused() {
        let refused =
            |weights: &[f64], scale| Tiled::<f64, 1, 4>::new(weights, scale, Overflow::Refuse).is_err();
        assert!(refused(&[], 1.0));
        assert!(refused(&[1.0, f64::NAN], 1.0));
        assert!(refused(&[1.0], f64::INFINITY));
        assert!(Tiled::<f64, 0, 4>::new(&[1.0], 1.0, Overflow::Refuse).is_err());
        assert!(Tiled::<f64, 1, 2>::new(&[1.0], 1.0, Overflow::Refuse).is_err());
        let mut memory = Tiled::<f64, 1, 4>::new(&[1.0], 1.0, Overflow::Refuse).unwrap();
        let mismatch = Err(MemoryError::ChannelMismatch { expected: 1, found: 2 });
        assert_eq!(memory.push(&[1.0, 2.0]), mismatch);
        assert_eq!(memory.next_term(&mut [1.0, 2.0]), mismatch);
    }

    #[test]
    fn states_of_another_kernel_or_kind_of_overflow_are_refused() {
        let save = |memory: &dyn Memory<f64>| {
            let mut bytes = std::vec![0; memory.state_bytes()];
            let mut writer = StateWriter::new(&mut bytes);
            memory.save(&mut writer).unwrap();
            assert_eq!(writer.written(), memory.state_bytes());
            bytes
        };
        let weights = noise(100);
        // The fingerprint must distinguish kernels and scales of few bits and of many.
        for scale in [1.0, 0.0, f64::from_bits(1), f64::MAX] {
            let mut own = Tiled::<f64, 2, 8>::new(&weights, scale, Overflow::Refuse).unwrap();
            own.push(&[1.0, 2.0]).unwrap();
            let bytes = save(&own);
            let restored = |weights: &[f64], scale: f64, overflow| {
                let mut memory = Tiled::<f64, 2, 8>::new(weights, scale, overflow).unwrap();
                match memory.restore(&mut StateReader::new(&bytes)) {
                    Err(StateError::Mismatch { what, .. }) => what,
                    other => other.map_or("another error", |()| "restored"),
                }
            };
            assert_eq!(restored(&weights, scale, Overflow::Refuse), "restored");
            assert_eq!(restored(&weights, scale, Overflow::Forget), "refusal of an overflow");
            assert_eq!(restored(&weights, 2.0, Overflow::Refuse), "fingerprint of the kernel");
            for n in 0..32 {
                let mut other = weights.clone();
                other[n] *= 1.0 + f64::EPSILON;
                assert_eq!(restored(&other, scale, Overflow::Refuse), "fingerprint of the kernel", "{n}");
            }
            let mut wide = Tiled::<f64, 3, 8>::new(&weights, scale, Overflow::Refuse).unwrap();
            assert!(wide.restore(&mut StateReader::new(&bytes)).is_err());
            let mut long = Tiled::<f64, 2, 9>::new(&weights, scale, Overflow::Refuse).unwrap();
            assert!(long.restore(&mut StateReader::new(&bytes)).is_err());
            assert!(own.check_state(&mut StateReader::new(&bytes[..bytes.len() - 1])).is_err());
        }
    }

    #[test]
    fn bytes_are_those_of_the_object_and_its_weights() {
        let weights = noise(100);
        let memory = Tiled::<f64, 2, 8>::new(&weights, 1.0, Overflow::Refuse).unwrap();
        assert_eq!(memory.bytes(), size_of_val(&memory) + 100 * 8);
        assert_eq!(memory.state_bytes(), header_bytes(5) + 2 * 10 * 8 * 8);
    }

    #[test]
    fn a_state_says_whether_its_memory_refuses() {
        let weights = noise(9);
        for (overflow, said) in [(Overflow::Refuse, 1), (Overflow::Forget, 0)] {
            let memory = Tiled::<f64, 1, 3>::new(&weights, 1.0, overflow).unwrap();
            let mut bytes = [0; header_bytes(5) + 5 * 8 * 8];
            memory.save(&mut StateWriter::new(&mut bytes)).unwrap();
            // Tag, size of a number, channels and blocks stand before it.
            assert_eq!(
                bytes[5..29],
                [[1, 0, 0, 0, 0, 0, 0, 0], [3, 0, 0, 0, 0, 0, 0, 0], [said, 0, 0, 0, 0, 0, 0, 0]].concat()
            );
        }
    }
}
