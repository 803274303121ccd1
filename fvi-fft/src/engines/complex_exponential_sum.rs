//! The exponential-sum memory of kernels that oscillate: exponentials in complex-conjugate pairs.

use fvi_core::{
    ActsOn, Memory, MemoryError, ParameterError, Real, Shape, StateError, StateReader, StateWriter, Stateful,
    check_channels, fingerprint, header_bytes,
};

use crate::engines::scalar::Scalar;

/// Weights as a head and exponentials in complex-conjugate pairs,
///
/// ```text
/// w_n = head[n]                            for n < n₀ ,
/// w_n = Re Σ_j c_j ρ_j^{n − n₀}            for n₀ ≤ n ≤ horizon
/// ```
///
/// Head and coefficients have the unit of a weight. An exponential of a real ρ_j stands for itself, one of a
/// complex ρ_j for itself and its conjugate.
#[derive(Clone, Debug, PartialEq)]
pub struct ComplexExponentials {
    /// w₀ … w_{n₀−1}, at least one.
    pub head: Vec<f64>,
    /// Re ρ_j, Im ρ_j, Re c_j, Im c_j.
    pub pairs: Vec<[f64; 4]>,
    /// Largest lag at which they hold.
    pub horizon: usize,
}

impl ComplexExponentials {
    /// The weights from n₀ on, as the memory has them: each by a product with ρ_j of the one before.
    pub fn tail(&self) -> impl Iterator<Item = f64> + '_ {
        let mut powers = vec![[1.0, 0.0]; self.pairs.len()];
        std::iter::repeat_with(move || {
            let mut weight = 0.0;
            for (power, [re, im, c_re, c_im]) in powers.iter_mut().zip(&self.pairs) {
                weight += c_re * power[0] - c_im * power[1];
                *power = [re * power[0] - im * power[1], im * power[0] + re * power[1]];
            }
            weight
        })
    }

    fn check(&self) -> Result<(), ParameterError> {
        let refuse = |parameter, value, allowed| Err(ParameterError { parameter, value, allowed });
        if self.head.is_empty() {
            return refuse("head weights", 0.0, "at least one");
        }
        let numbers = self.head.iter().chain(self.pairs.as_flattened());
        match numbers.copied().find(|number| !number.is_finite()) {
            Some(number) => refuse("number of the table", number, "finite"),
            None => Ok(()),
        }
    }
}

/// The memory for a table of [`ComplexExponentials`]: r_k = Σ_{n=1}^{k} w_n x_{k−n}.
///
/// The samples of the last n₀ − 1 steps are summed directly, everything older through complex sums that turn
/// and shrink from step to step:
///
/// ```text
/// Z_j ← ρ_j Z_j + x_{k−n₀+1} ,        r_{k+1} = Σ_{n=1}^{n₀−1} w_n x_{k+1−n} + Re Σ_j c_j Z_j
/// ```
///
/// Two numbers of state for a pair, a dozen operations for a pair and a step. Sums are in double precision
/// whatever `T` is, since a pair that hardly decays is turned as often as there are steps.
///
/// Source: recursion as in \[SchädleLFLubich06\].
#[derive(Clone, Debug)]
pub struct ComplexExponentialSum<T> {
    acts_on: ActsOn,
    leading: [T; 1],
    /// w_{n₀−1} … w₁, oldest sample first.
    head: Vec<f64>,
    blocks: Vec<Block>,
    horizon: usize,
    fingerprint: u64,
    len: usize,
    channels: Vec<Channel>,
}

/// Exponentials that are computed side by side.
const LANES: usize = 8;

/// Kind of the saved state.
const TAG: [u8; 4] = *b"cplx";

/// ρ and c of the exponentials of a block; zeros where it is not full.
#[derive(Clone, Copy, Debug)]
struct Block {
    turn: [[f64; LANES]; 2],
    output: [[f64; LANES]; 2],
}

/// The state of one channel.
#[derive(Clone, Debug)]
struct Channel {
    /// The last n₀ samples, twice: those from any place on are in order.
    recent: Vec<f64>,
    /// Re Z and Im Z of each block.
    sums: Vec<[[f64; LANES]; 2]>,
    /// r_k of the sample to come.
    term: f64,
}

impl<T: Scalar> ComplexExponentialSum<T> {
    /// A memory on `channels` channels, without samples.
    ///
    /// # Errors
    /// If the table has no head or a number that is not finite, or there is no channel.
    pub fn new(table: &ComplexExponentials, channels: usize) -> Result<Self, ParameterError> {
        table.check()?;
        if channels == 0 {
            return Err(ParameterError { parameter: "channels", value: 0.0, allowed: "at least 1" });
        }
        let block = |pairs: &[[f64; 4]]| {
            let lanes =
                |place: usize| std::array::from_fn(|lane| pairs.get(lane).map_or(0.0, |pair| pair[place]));
            Block { turn: [lanes(0), lanes(1)], output: [lanes(2), lanes(3)] }
        };
        let blocks: Vec<Block> = table.pairs.chunks(LANES).map(block).collect();
        let channel = Channel {
            recent: vec![0.0; 2 * table.head.len()],
            sums: vec![[[0.0; LANES]; 2]; blocks.len()],
            term: 0.0,
        };
        Ok(Self {
            acts_on: ActsOn::Values,
            leading: [T::of(table.head[0])],
            head: table.head[1..].iter().rev().copied().collect(),
            blocks,
            horizon: table.horizon,
            fingerprint: fingerprint(table.head.iter().chain(table.pairs.as_flattened())),
            len: 0,
            channels: vec![channel; channels],
        })
    }

    /// The same memory, its weights being for such samples.
    #[must_use]
    pub fn acting_on(self, acts_on: ActsOn) -> Self {
        Self { acts_on, ..self }
    }

    /// Header of the saved state.
    fn shape(&self) -> Shape<3> {
        let head = self.head.len() as u64 + 1;
        [
            ("channels", self.channels.len() as u64),
            ("head weights", head),
            ("fingerprint of the kernel", self.fingerprint),
        ]
    }

    /// Reads how many samples a state has seen.
    fn count(&self, from: &mut StateReader<'_>) -> Result<usize, StateError> {
        from.header::<T, 3>(TAG, &self.shape())?;
        from.count_up_to("samples", self.horizon)
    }

    /// Numbers of the state.
    fn numbers(&self) -> usize {
        self.channels.len() * (self.head.len() + 2 + 2 * LANES * self.blocks.len())
    }

    fn check_capacity(&self, channels: usize) -> Result<(), MemoryError> {
        check_channels(self.channels.len(), channels)?;
        let capacity = self.horizon;
        if self.len >= capacity { Err(MemoryError::Full { capacity }) } else { Ok(()) }
    }
}

impl Channel {
    /// Takes up the sample that leaves the head, and prepares the term of the sample to come; the newest
    /// sample is at `place`.
    #[inline(always)]
    fn advance(&mut self, head: &[f64], blocks: &[Block], place: usize) {
        // Behind `place`, the last n₀ samples from the oldest on.
        let Some([oldest, nearer @ ..]) = self.recent.get(place + 1..place + 2 + head.len()) else { return };
        let mut sums = [0.0; LANES];
        for ([re, im], block) in self.sums.iter_mut().zip(blocks) {
            for lane in 0..LANES {
                let (x, y) = (re[lane], im[lane]);
                let (a, b) = (block.turn[0][lane], block.turn[1][lane]);
                re[lane] = a * x - b * y + oldest;
                im[lane] = b * x + a * y;
                sums[lane] += block.output[0][lane] * re[lane] - block.output[1][lane] * im[lane];
            }
        }
        let (weights, rest) = head.as_chunks::<LANES>();
        let (samples, last) = nearer.as_chunks::<LANES>();
        for (weights, samples) in weights.iter().zip(samples) {
            for ((sum, weight), sample) in sums.iter_mut().zip(weights).zip(samples) {
                *sum += weight * sample;
            }
        }
        let near: f64 = rest.iter().zip(last).map(|(weight, sample)| weight * sample).sum();
        self.term = sums.iter().sum::<f64>() + near;
    }

    fn clear(&mut self) {
        self.recent.fill(0.0);
        self.sums.fill([[0.0; LANES]; 2]);
        self.term = 0.0;
    }
}

impl<T: Scalar> Memory<T> for ComplexExponentialSum<T> {
    fn channels(&self) -> usize {
        self.channels.len()
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
        self.check_capacity(term.len())?;
        for (term, channel) in term.iter_mut().zip(&self.channels) {
            *term = T::of(channel.term);
        }
        Ok(())
    }

    #[inline(always)]
    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        self.check_capacity(sample.len())?;
        let length = self.head.len() + 1;
        let place = self.len % length;
        for (channel, sample) in self.channels.iter_mut().zip(sample) {
            let sample = sample.to_f64();
            (channel.recent[place], channel.recent[place + length]) = (sample, sample);
            channel.advance(&self.head, &self.blocks, place);
        }
        self.len += 1;
        Ok(())
    }

    fn clear(&mut self) {
        self.len = 0;
        self.channels.iter_mut().for_each(Channel::clear);
    }

    fn bytes(&self) -> usize {
        let channel = |channel: &Channel| size_of_val(&*channel.recent) + size_of_val(&*channel.sums);
        size_of::<Self>()
            + size_of_val(&*self.head)
            + size_of_val(&*self.blocks)
            + size_of_val(&*self.channels)
            + self.channels.iter().map(channel).sum::<usize>()
    }
}

impl<T: Scalar> Stateful for ComplexExponentialSum<T> {
    fn state_bytes(&self) -> usize {
        header_bytes(4) + self.numbers() * f64::BYTES
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 3>(TAG, &self.shape())?;
        to.count(self.len as u64)?;
        let length = self.head.len() + 1;
        self.channels.iter().try_for_each(|channel| {
            to.numbers(&channel.recent[..length])?;
            to.numbers(channel.sums.as_flattened().as_flattened())?;
            to.numbers([&channel.term])
        })
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.count(from)?;
        from.skip::<f64>(self.numbers())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        self.len = self.count(from)?;
        let length = self.head.len() + 1;
        for channel in &mut self.channels {
            let (once, again) = channel.recent.split_at_mut(length);
            from.numbers(&mut *once)?;
            again.copy_from_slice(once);
            from.numbers(channel.sums.as_flattened_mut().as_flattened_mut())?;
            channel.term = from.number()?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vectorised;

    /// A head of n₀ weights, a pair that turns by a radian a step, a real exponential.
    fn table(head: usize, horizon: usize) -> ComplexExponentials {
        let (sine, cosine) = 1f64.sin_cos();
        ComplexExponentials {
            head: (0..head).map(|n| 1.0 / (1.0 + n as f64)).collect(),
            pairs: vec![[0.9 * cosine, 0.9 * sine, 0.3, -0.2], [0.5, 0.0, 0.7, 0.0]],
            horizon,
        }
    }

    /// w_n by the formula.
    fn weight(table: &ComplexExponentials, n: usize) -> f64 {
        let lag = n as f64 - table.head.len() as f64;
        let turned = 0.9f64.powf(lag) * (0.3 * lag.cos() + 0.2 * lag.sin());
        table.head.get(n).copied().unwrap_or(turned + 0.7 * 0.5f64.powf(lag))
    }

    #[test]
    fn terms_are_sums_of_the_weights_of_every_head() {
        for head in [1, 2, 9, 17] {
            let table = table(head, 100);
            for (n, found) in (head..60).zip(table.tail()) {
                assert!((found - weight(&table, n)).abs() < 1e-15, "{head}, {n}");
            }
            let mut memory = Vectorised::new(ComplexExponentialSum::<f64>::new(&table, 2).unwrap());
            let sample = |k: usize, channel: usize| ((k * k + 3 * channel) as f64 * 0.7).sin();
            for k in 0..100 {
                let mut term = [f64::NAN; 2];
                memory.next_term(&mut term).unwrap();
                for (channel, term) in term.iter().enumerate() {
                    let sum: f64 = (1..=k).map(|n| weight(&table, n) * sample(k - n, channel)).sum();
                    assert!((term - sum).abs() < 2e-15 * (2.0 + k as f64), "{head}, {k}: {term} {sum}");
                }
                memory.push(&[sample(k, 0), sample(k, 1)]).unwrap();
            }
            let full = Err(MemoryError::Full { capacity: 100 });
            assert_eq!((memory.next_term(&mut [0.0; 2]), memory.push(&[0.0; 2])), (full, full));
            memory.clear();
            let mut term = [f64::NAN; 2];
            memory.next_term(&mut term).unwrap();
            assert_eq!((memory.len(), term), (0, [0.0; 2]));
        }
    }

    #[test]
    fn a_saved_state_goes_on_with_the_same_bits_and_others_are_refused() {
        let build = |head, channels| ComplexExponentialSum::<f32>::new(&table(head, 60), channels).unwrap();
        let mut memory = build(9, 2);
        let mut before = build(9, 2);
        for k in 0..50u8 {
            let mut bytes = vec![0; memory.state_bytes()];
            let mut writer = StateWriter::new(&mut bytes);
            memory.save(&mut writer).unwrap();
            assert_eq!(writer.written(), memory.state_bytes());
            // Each takes up the state of the other in turn.
            let mut reader = StateReader::new(&bytes);
            assert_eq!((before.restore(&mut reader), reader.finish()), (Ok(()), Ok(())));
            for sample in [[f32::from(k), -1.0], [0.3, f32::from(k % 7)]] {
                let (mut found, mut expected) = ([f32::NAN; 2], [f32::NAN; 2]);
                before.next_term(&mut found).unwrap();
                memory.next_term(&mut expected).unwrap();
                assert_eq!(found.map(f32::to_bits), expected.map(f32::to_bits), "{k}");
                if memory.len() < 50 {
                    before.push(&sample).unwrap();
                    memory.push(&sample).unwrap();
                }
            }
            for other in [build(9, 1), build(10, 2)] {
                assert!(other.check_state(&mut StateReader::new(&bytes)).is_err());
            }
            assert!(before.restore(&mut StateReader::new(&bytes[..bytes.len() - 1])).is_err());
        }
    }

    #[test]
    fn tables_without_a_head_and_numbers_that_are_none_are_refused() {
        let parameter = |table: ComplexExponentials, channels| {
            ComplexExponentialSum::<f64>::new(&table, channels).err().map(|error| error.parameter)
        };
        assert_eq!(parameter(table(0, 10), 1), Some("head weights"));
        assert_eq!(parameter(table(1, 10), 0), Some("channels"));
        let mut broken = table(1, 10);
        broken.pairs[1][2] = f64::NAN;
        assert_eq!(parameter(broken, 1), Some("number of the table"));
    }
}
