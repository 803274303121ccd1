//! The direct memory: every sample in a ring, every term a sum.

use core::marker::PhantomData;

use heapless::Deque;

use crate::error::ParameterError;
use crate::linear::at;
use crate::memory::{ActsOn, Memory, MemoryError, check_channels};
use crate::real::Real;
use crate::saving::{Shape, StateError, StateReader, StateWriter, Stateful, fingerprint, header_bytes};
use crate::space::{part, vectors, vectors_mut};
use crate::weighted_sum::weighted_sum;

/// Storage of one channel: the samples as two slices, backwards in time.
///
/// `heapless::Deque<T, H>` is one, of fixed capacity and without allocation. Newest first, a sample lies in
/// the same order as the weight that it meets.
pub trait Ring<T> {
    /// The samples, newest first, as two slices one after the other.
    fn as_slices(&self) -> (&[T], &[T]);

    /// Number of samples that the ring can hold.
    fn capacity(&self) -> usize;

    /// Stores a sample, in place of the oldest if the ring is full.
    fn store(&mut self, sample: T);

    /// Removes all samples.
    fn clear(&mut self);

    /// Bytes of the ring, wherever they lie.
    fn bytes(&self) -> usize;
}

impl<T, const H: usize> Ring<T> for Deque<T, H> {
    fn as_slices(&self) -> (&[T], &[T]) {
        Deque::as_slices(self)
    }

    fn capacity(&self) -> usize {
        H
    }

    fn store(&mut self, sample: T) {
        if self.is_full() {
            self.pop_back();
        }
        // There is room now, unless H = 0.
        let _ = self.push_front(sample);
    }

    fn clear(&mut self) {
        Deque::clear(self);
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
    }
}

/// Policy for a sample that comes when the ring is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overflow {
    /// Refuse it with [`MemoryError::Full`]: the memory is exact as long as it works.
    Refuse,
    /// Drop the oldest sample: the sum then lacks its far end.
    Forget,
}

/// The direct memory: r_k = Σ_{n=1}^{k} W_n x_{k−n}, summed term by term over rings of samples.
///
/// Cost of a term: k multiply–adds per channel (S of them for S×S kernels). State: one ring per channel. The
/// weights `K` are borrowed or owned, so that a table can lie in flash and serve many memories.
///
/// For S×S kernels the weights lie plane by plane: entry (i, j) of W_n is `weights[(i·S + j)·L + n]` with L =
/// `weights.len() / S²`. All of them are multiplied by `scale`, the h^{−β} (or w₀) that a dimensionless table
/// leaves out.
///
/// Source of the kernels: \[HJO\] eq. 21, 35; \[JO\] eq. 45.
#[derive(Clone, Debug)]
pub struct Direct<T, K, C, R> {
    weights: K,
    stages: usize,
    scale: T,
    leading: [T; MAX_STAGES * MAX_STAGES],
    rings: C,
    overflow: Overflow,
    acts_on: ActsOn,
    len: usize,
    ring: PhantomData<R>,
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"dire";

/// Largest number of stages S of a matrix kernel.
pub(crate) const MAX_STAGES: usize = 4;

/// [`Direct`] with `C` channels in rings of fixed capacity `H` and a borrowed table of weights: no
/// allocation.
pub type FixedDirect<'w, T, const C: usize, const H: usize> =
    Direct<T, &'w [T], [Deque<T, H>; C], Deque<T, H>>;

impl<'w, T: Real, const C: usize, const H: usize> FixedDirect<'w, T, C, H> {
    /// Full memory of at most `H` samples for a kernel of plain numbers scale·w_n: refuses to overflow.
    ///
    /// # Errors
    /// See [`Direct::new`].
    pub fn full_memory(weights: &'w [T], scale: T) -> Result<Self, ParameterError> {
        Self::new(weights, 1, scale, Self::rings(), Overflow::Refuse)
    }

    /// Short memory of the last `H` samples for a kernel of plain numbers scale·w_n: forgets older ones.
    ///
    /// The term then lacks Σ_{n>H} w_n x_{k−n}, which is at most max|x| · Σ_{n>H} |w_n|; for
    /// Grünwald–Letnikov weights and 0 < β < 1 the last sum is |Σ_{n≤H} w_n| ≈ (H h)^{−β} / Γ(1 − β), a slow
    /// decay.
    ///
    /// # Errors
    /// See [`Direct::new`].
    pub fn short_memory(weights: &'w [T], scale: T) -> Result<Self, ParameterError> {
        Self::new(weights, 1, scale, Self::rings(), Overflow::Forget)
    }

    fn rings() -> [Deque<T, H>; C] {
        [const { Deque::new() }; C]
    }
}

impl<T, K, C, R> Direct<T, K, C, R>
where
    T: Real,
    K: AsRef<[T]>,
    C: AsRef<[R]> + AsMut<[R]>,
    R: Ring<T>,
{
    /// A memory for the kernel scale·W_n of S×S matrices, S = `stages`, on one ring per channel.
    ///
    /// # Errors
    /// If S is not one of 1…4, the number of channels is not a multiple of S, the weights are not S² planes
    /// of at least one number, or a weight or the scale is not finite.
    pub fn new(
        weights: K,
        stages: usize,
        scale: T,
        mut rings: C,
        overflow: Overflow,
    ) -> Result<Self, ParameterError> {
        let table = weights.as_ref();
        let channels = rings.as_ref().len();
        let planes = stages.saturating_mul(stages);
        ParameterError::check(
            (1..=MAX_STAGES).contains(&stages),
            "stages",
            stages as f64,
            "one of 1, 2, 3, 4",
        )?;
        ParameterError::check(
            channels > 0 && channels.is_multiple_of(stages),
            "channels",
            channels as f64,
            "a positive multiple of the stages",
        )?;
        ParameterError::check(
            !table.is_empty() && table.len().is_multiple_of(planes),
            "number of weights",
            table.len() as f64,
            "a positive multiple of the squared stages",
        )?;
        ParameterError::check(scale.is_finite(), "scale", scale.to_f64(), "finite")?;
        if let Some(weight) = table.iter().find(|weight| !weight.is_finite()) {
            return Err(ParameterError { parameter: "weight", value: weight.to_f64(), allowed: "finite" });
        }
        let mut leading = [T::zero(); MAX_STAGES * MAX_STAGES];
        for (leading, plane) in leading.iter_mut().zip(vectors(table, table.len() / planes.max(1))) {
            *leading = at(plane, 0) * scale;
        }
        rings.as_mut().iter_mut().for_each(Ring::clear);
        let (acts_on, len, ring) = (ActsOn::Values, 0, PhantomData);
        Ok(Self { weights, stages, scale, leading, rings, overflow, acts_on, len, ring })
    }

    /// The same memory, with weights for samples of the given kind.
    pub fn acting_on(self, acts_on: ActsOn) -> Self {
        Self { acts_on, ..self }
    }

    /// Number of samples that the rings hold.
    pub fn capacity(&self) -> usize {
        self.rings.as_ref().iter().map(Ring::capacity).min().unwrap_or(0)
    }

    /// Header of the saved state: the values that must match when it is restored.
    fn shape(&self) -> Shape<3> {
        let kernel = fingerprint(self.leading());
        [
            ("channels", self.channels() as u64),
            ("stages", self.stages as u64),
            ("fingerprint of the kernel", kernel),
        ]
    }

    /// Reads the number of samples in a saved state.
    fn count(&self, from: &mut StateReader<'_>) -> Result<usize, StateError> {
        from.header::<T, 3>(TAG, &self.shape())?;
        let refuses = self.overflow == Overflow::Refuse;
        from.count_up_to("samples", if refuses { self.capacity() } else { usize::MAX })
    }

    fn check_capacity(&self) -> Result<(), MemoryError> {
        let capacity = self.capacity();
        match self.overflow {
            Overflow::Refuse if self.len >= capacity => Err(MemoryError::Full { capacity }),
            Overflow::Refuse | Overflow::Forget => Ok(()),
        }
    }
}

impl<T, K, C, R> Memory<T> for Direct<T, K, C, R>
where
    T: Real,
    K: AsRef<[T]>,
    C: AsRef<[R]> + AsMut<[R]>,
    R: Ring<T>,
{
    fn channels(&self) -> usize {
        self.rings.as_ref().len()
    }

    fn stages(&self) -> usize {
        self.stages
    }

    fn acts_on(&self) -> ActsOn {
        self.acts_on
    }

    fn leading(&self) -> &[T] {
        part(&self.leading, self.stages * self.stages)
    }

    fn len(&self) -> usize {
        self.len
    }

    #[inline]
    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        check_channels(self.channels(), term.len())?;
        self.check_capacity()?;
        let weights = self.weights.as_ref();
        if self.stages == 1 {
            for (term, ring) in term.iter_mut().zip(self.rings.as_ref()) {
                let (newer, older) = ring.as_slices();
                *term = weighted_sum(weights, newer, older) * self.scale;
            }
            return Ok(());
        }
        let length = weights.len() / (self.stages * self.stages).max(1);
        let groups = vectors(self.rings.as_ref(), self.stages);
        for (group, terms) in groups.zip(vectors_mut(term, self.stages)) {
            let rows = vectors(weights, length * self.stages);
            for (term, row) in terms.iter_mut().zip(rows) {
                let mut sum = T::zero();
                for (plane, ring) in vectors(row, length).zip(group) {
                    let (newer, older) = ring.as_slices();
                    sum += weighted_sum(plane, newer, older);
                }
                *term = sum * self.scale;
            }
        }
        Ok(())
    }

    #[inline]
    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        check_channels(self.channels(), sample.len())?;
        self.check_capacity()?;
        for (ring, &number) in self.rings.as_mut().iter_mut().zip(sample) {
            ring.store(number);
        }
        self.len = self.len.saturating_add(1);
        Ok(())
    }

    fn clear(&mut self) {
        self.rings.as_mut().iter_mut().for_each(Ring::clear);
        self.len = 0;
    }

    fn bytes(&self) -> usize {
        size_of::<Self>() - size_of::<C>()
            + size_of_val(self.weights.as_ref())
            + self.rings.as_ref().iter().map(Ring::bytes).sum::<usize>()
    }
}

impl<T, K, C, R> Stateful for Direct<T, K, C, R>
where
    T: Real,
    K: AsRef<[T]>,
    C: AsRef<[R]> + AsMut<[R]>,
    R: Ring<T>,
{
    fn state_bytes(&self) -> usize {
        let rings = self.rings.as_ref().iter().map(|ring| 8 + kept(ring) * T::BYTES);
        header_bytes(4) + rings.sum::<usize>()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 3>(TAG, &self.shape())?;
        to.count(self.len as u64)?;
        for ring in self.rings.as_ref() {
            to.count(kept(ring) as u64)?;
            // Oldest first: the order in which they are stored again.
            let (newer, older) = ring.as_slices();
            to.numbers(newer.iter().chain(older).rev())?;
        }
        Ok(())
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let len = self.count(from)?;
        for ring in self.rings.as_ref() {
            let kept = from.count_up_to("kept samples", len)?;
            let wanted = len.min(ring.capacity());
            if kept < wanted {
                let (expected, found) = (wanted as u64, kept as u64);
                return Err(StateError::Mismatch { what: "kept samples", expected, found });
            }
            from.skip::<T>(kept)?;
        }
        Ok(())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        self.len = self.count(from)?;
        for ring in self.rings.as_mut() {
            ring.clear();
            for _ in 0..from.count()? {
                ring.store(from.number()?);
            }
        }
        Ok(())
    }
}

/// Number of samples in a ring.
fn kept<T>(ring: &impl Ring<T>) -> usize {
    let (newer, older) = ring.as_slices();
    newer.len() + older.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    const WEIGHTS: [f64; 5] = [2.0, 3.0, 5.0, 7.0, 11.0];

    fn terms<M: Memory<f64>>(memory: &mut M, samples: &[f64]) -> std::vec::Vec<f64> {
        samples
            .iter()
            .map(|&x| {
                let mut term = [f64::NAN];
                memory.next_term(&mut term).unwrap();
                memory.push(&[x]).unwrap();
                term[0]
            })
            .collect()
    }

    #[test]
    fn full_memory_sums_everything_and_refuses_to_overflow() {
        let mut memory = FixedDirect::<f64, 1, 4>::full_memory(&WEIGHTS, 0.5).unwrap();
        assert_eq!(memory.leading(), [1.0]);
        assert_eq!(terms(&mut memory, &[1.0, 10.0, 100.0, 1000.0]), [0.0, 1.5, 17.5, 178.5]);
        assert_eq!(memory.next_term(&mut [0.0]), Err(MemoryError::Full { capacity: 4 }));
        assert_eq!(memory.push(&[1.0]), Err(MemoryError::Full { capacity: 4 }));
        assert_eq!(memory.len(), 4);
        memory.clear();
        assert_eq!(terms(&mut memory, &[1.0, 10.0]), [0.0, 1.5]);
    }

    #[test]
    fn short_memory_drops_the_oldest_sample() {
        let mut memory = FixedDirect::<f64, 1, 2>::short_memory(&WEIGHTS, 1.0).unwrap();
        assert_eq!(terms(&mut memory, &[1.0, 10.0, 100.0, 1000.0, 0.0]), [0.0, 3.0, 35.0, 350.0, 3500.0]);
        assert_eq!(memory.len(), 5);
    }

    #[test]
    fn matrix_kernels_mix_the_stages_of_a_coordinate_only() {
        // W₁ = [1 2; 3 4], W₂ = [5 6; 7 8], plane by plane.
        let planes = [0.0, 1.0, 5.0, 0.0, 2.0, 6.0, 0.0, 3.0, 7.0, 0.0, 4.0, 8.0];
        let rings: [Deque<f64, 8>; 4] = [const { Deque::new() }; 4];
        let mut memory = Direct::new(&planes[..], 2, 1.0, rings, Overflow::Refuse).unwrap();
        memory.push(&[1.0, 0.0, 0.0, 1.0]).unwrap();
        memory.push(&[0.0, 1.0, 0.0, 0.0]).unwrap();
        let mut term = [0.0; 4];
        memory.next_term(&mut term).unwrap();
        assert_eq!(term, [5.0 + 2.0, 7.0 + 4.0, 6.0, 8.0]);
    }

    #[test]
    fn bad_tables_and_slices_are_refused() {
        assert!(FixedDirect::<f64, 1, 4>::full_memory(&[], 1.0).is_err());
        assert!(FixedDirect::<f64, 1, 4>::full_memory(&[1.0, f64::NAN], 1.0).is_err());
        assert!(FixedDirect::<f64, 1, 4>::full_memory(&WEIGHTS, f64::INFINITY).is_err());
        let rings = || [const { Deque::<f64, 4>::new() }; 4];
        for (stages, weights, named) in [
            (0, 16, "stages"),
            (5, 16, "stages"),
            (usize::MAX, 16, "stages"),
            (3, 18, "channels"),
            (2, 2, "number of weights"),
            (2, 6, "number of weights"),
        ] {
            let refused =
                Direct::new([1.0; 18].get(..weights).unwrap(), stages, 1.0, rings(), Overflow::Refuse);
            assert_eq!(
                refused.map(|_| ()).unwrap_err().parameter,
                named,
                "{stages} stages, {weights} weights"
            );
        }
        let mut memory = FixedDirect::<f64, 1, 4>::full_memory(&WEIGHTS, 1.0).unwrap();
        let mismatch = Err(MemoryError::ChannelMismatch { expected: 1, found: 2 });
        assert_eq!(memory.push(&[1.0, 2.0]), mismatch);
        assert_eq!(memory.next_term(&mut [1.0, 2.0]), mismatch);
    }

    #[test]
    fn three_stages_are_those_of_the_double_sum() {
        const LENGTH: usize = 7;
        let planes = crate::noise::noise(9 * LENGTH);
        let rings: [Deque<f64, 8>; 6] = [const { Deque::new() }; 6];
        let mut memory = Direct::new(&planes[..], 3, 0.5, rings, Overflow::Refuse).unwrap();
        assert_eq!((memory.channels(), memory.stages(), memory.capacity()), (6, 3, 8));
        let leading: [f64; 9] = core::array::from_fn(|plane| 0.5 * planes[plane * LENGTH]);
        assert_eq!(memory.leading(), leading);
        let samples = crate::noise::noise(6 * 8);
        for (k, sample) in samples.chunks(6).enumerate() {
            let mut term = [f64::NAN; 6];
            memory.next_term(&mut term).unwrap();
            for (channel, term) in term.into_iter().enumerate() {
                let (group, row) = (channel / 3 * 3, channel % 3);
                let weight = |n: usize, b: usize| planes[(3 * row + b) * LENGTH + n];
                let part = |n: usize| -> f64 {
                    (0..3).map(|b| weight(n, b) * samples[6 * (k - n) + group + b]).sum()
                };
                let expected = 0.5 * (1..=k.min(LENGTH - 1)).map(part).sum::<f64>();
                assert!((term - expected).abs() < 1e-15, "{k}, {channel}: {term} {expected}");
            }
            memory.push(sample).unwrap();
        }
    }

    #[test]
    fn bytes_are_those_of_the_object_its_weights_and_its_rings() {
        let memory = FixedDirect::<f64, 3, 10>::full_memory(&WEIGHTS, 1.0).unwrap();
        assert_eq!(memory.bytes(), size_of_val(&memory) + 5 * 8);
        assert_eq!(Ring::<f64>::bytes(&Deque::<f64, 10>::new()), size_of::<Deque<f64, 10>>());
        let rings = std::vec![Deque::<f64, 10>::new(); 3];
        let elsewhere = Direct::new(&WEIGHTS[..], 1, 1.0, rings, Overflow::Refuse).unwrap();
        let object = size_of_val(&elsewhere) - size_of::<std::vec::Vec<Deque<f64, 10>>>();
        assert_eq!(elsewhere.bytes(), object + 5 * 8 + 3 * size_of::<Deque<f64, 10>>());
    }

    #[test]
    fn a_state_lacks_no_sample() {
        for (overflow, steps) in [(Overflow::Refuse, 3), (Overflow::Forget, 9)] {
            let build = || {
                let rings: [Deque<f64, 4>; 2] = [const { Deque::new() }; 2];
                Direct::new(&WEIGHTS[..], 1, 1.0, rings, overflow).unwrap()
            };
            let mut memory = build();
            for k in 0..steps {
                memory.push(&[f64::from(k), 1.0]).unwrap();
            }
            let mut bytes = [0; 200];
            let bytes = bytes.get_mut(..memory.state_bytes()).unwrap();
            memory.save(&mut StateWriter::new(bytes)).unwrap();
            let mut restored = build();
            let mut reader = StateReader::new(bytes);
            assert_eq!((restored.restore(&mut reader), reader.finish()), (Ok(()), Ok(())));
            let (mut found, mut expected) = ([0.0; 2], [1.0; 2]);
            restored.next_term(&mut found).unwrap();
            memory.next_term(&mut expected).unwrap();
            assert_eq!(found, expected);
            // The first ring's count follows the header and the number of samples.
            let place = header_bytes(4);
            let kept = bytes[place];
            bytes[place] = kept - 1;
            let (expected, found) = (u64::from(kept), u64::from(kept) - 1);
            let mismatch = Err(StateError::Mismatch { what: "kept samples", expected, found });
            assert_eq!(restored.check_state(&mut StateReader::new(bytes)), mismatch);
            assert_eq!(restored.restore(&mut StateReader::new(bytes)), mismatch);
            let mut again = [0.0; 2];
            restored.next_term(&mut again).unwrap();
            assert_eq!(again, [found_first(&mut memory), again[1]]);
        }
    }

    fn found_first(memory: &mut impl Memory<f64>) -> f64 {
        let mut term = [f64::NAN; 2];
        memory.next_term(&mut term).unwrap();
        term[0]
    }
}
