//! The trait of memory engines: convolution of a known kernel with a signal that arrives one sample a step.

use core::fmt;

use crate::saving::{StateError, StateReader, Stateful};

/// Kind of samples that a memory takes of the motion X that its operator acts on (q itself, or q − q₀ …).
///
/// The same derivative D^β X = Σ_n W_n X_{k−n} may be served from any of them, by kernels that differ by a
/// factor: with Y_k = X_k − X_{k−1} the kernel has the sums W_0 + … + W_n, of generating function
/// K(z)/(1 − z). Schemes have the differences to full relative accuracy, from their equations and not by
/// subtraction, and the sum over them is as small as the derivative itself: where values lose u h^{−β}|X| to
/// rounding, increments lose u h^{1−β}|Ẋ|. All of these kernels have the same leading weight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ActsOn {
    /// The values X_{k,i} of the nodes.
    #[default]
    Values,
    /// The increments X_{k,i} − X_{k−1,i} of every node, X_{−1,i} = 0.
    Increments,
    /// Differences X_{k,i} − x_k between every node and the main node x_k at the beginning of its step, with
    /// x_0 = 0.
    Rises,
}

/// A memory engine: convolution of a known kernel with an online signal.
///
/// With the kernel W₀, W₁, … (S×S matrices; plain numbers for S = 1) and the samples x₀, x₁, … the engine
/// serves the *memory term*
///
/// ```text
/// r_k = Σ_{n=1}^{k} W_n x_{k−n} ,      so that    (W ∗ x)_k = W₀ x_k + r_k ,
/// ```
///
/// where k = [`len`](Memory::len) is the index of the sample to come. r_k is known before x_k is: schemes
/// that are implicit in x_k need only r_k and the leading weight W₀.
///
/// **Layout.** A sample is one number for each *channel*. A kernel of plain numbers acts on every channel
/// alike. A kernel of S×S matrices acts on groups of S neighbouring channels: stage s of coordinate i is
/// channel i·S + s, which is `SMatrix<T, S, N>::as_slice` of the stage values in columns.
///
/// **Contract.** [`next_term`](Memory::next_term) may be called any number of times before a push and returns
/// the same numbers. It fails with [`MemoryError::Full`] when the sample x_k that it prepares for could not
/// be stored; after a successful `next_term` the following push of a sample of the right length succeeds. A
/// call that fails changes nothing. Engines differ in cost and in rounding only.
///
/// Source: \[HLS\]; the kernels are those of \[Lubich86\].
pub trait Memory<T>: Stateful {
    /// Number of channels, N·S: how many numbers a sample has.
    fn channels(&self) -> usize;

    /// Number of stages S of the kernel: 1 for plain numbers.
    fn stages(&self) -> usize {
        1
    }

    /// Number of kernels that act on the same samples, each with terms of its own.
    ///
    /// Where there are several, [`leading`](Memory::leading) and [`next_term`](Memory::next_term) have the
    /// numbers of one kernel after those of the other.
    fn kernels(&self) -> usize {
        1
    }

    /// Kind of samples: which differences of the motion the kernel is for.
    ///
    /// A damping term pushes samples of this kind; the memory itself does not distinguish them.
    fn acts_on(&self) -> ActsOn {
        ActsOn::Values
    }

    /// States that samples will be differences of a signal that may jump by its own size at every sample, as
    /// a measured value with noise does, and clears the memory.
    ///
    /// For engines whose sums would accumulate the rounding errors of such differences; others need no
    /// change. The differences of a motion are small, and do not need it.
    fn expect_jumps(&mut self) {
        self.clear();
    }

    /// Leading weight W₀, S×S numbers, row by row, of each kernel.
    fn leading(&self) -> &[T];

    /// True if W₀ stays the same for all later samples as long as the step does: false where starting weights
    /// correct the first few.
    fn leading_is_constant(&self) -> bool {
        true
    }

    /// Number of samples pushed so far, k.
    fn len(&self) -> usize;

    /// True if no sample has been pushed yet.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Sets the length, in units of time, of the step that leads from the previous sample to the sample to
    /// come, x_k.
    ///
    /// An engine for steps of any length uses it in the weights of x_k, [`leading`](Memory::leading)
    /// included. An engine for equal steps ignores it: a damping term has compared the length with its
    /// kernel's step before. It may be called again before a push, when a step is repeated with another
    /// length; the last call counts. There is no step before the first sample x₀ where main nodes are stored.
    ///
    /// # Errors
    /// [`MemoryError::StepLength`] if the engine cannot serve a step of this length.
    fn begin_step(&mut self, length: T) -> Result<(), MemoryError> {
        let _ = length;
        Ok(())
    }

    /// Writes r_k = Σ_{n≥1} W_n x_{k−n} to `term`, one number per channel and kernel.
    ///
    /// # Errors
    /// [`MemoryError::Full`] if x_k would not fit, [`MemoryError::ChannelMismatch`] if `term` has the wrong
    /// length.
    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError>;

    /// Stores the sample x_k.
    ///
    /// # Errors
    /// [`MemoryError::Full`] if it does not fit, [`MemoryError::ChannelMismatch`] if it has the wrong length.
    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError>;

    /// Forgets all samples; the kernel stays.
    fn clear(&mut self);

    /// Bytes of state, tables and buffers, wherever they lie.
    fn bytes(&self) -> usize;

    /// Number of times that scheduled work was late; `None` for engines without a schedule.
    fn overruns(&self) -> Option<usize> {
        None
    }

    /// Restores some channels from a saved state, that of a memory which differs in the number of its
    /// channels only; the other channels are unchanged. So channels can be redistributed among memories.
    ///
    /// A memory without samples takes over the sample count of the state; any other must have the same count.
    ///
    /// # Errors
    /// As [`restore`](Stateful::restore), and if a channel does not exist in state or memory, or the sample
    /// counts differ; the memory is then unchanged.
    fn restore_channels(
        &mut self,
        from: &mut StateReader<'_>,
        channels: SavedChannels,
    ) -> Result<(), StateError> {
        let _ = (from, channels);
        Err(StateError::Unsupported)
    }
}

/// Channels to restore from a saved state into a memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SavedChannels {
    /// Number of channels in the state.
    pub of: usize,
    /// Index of the first channel taken from the state.
    pub first: usize,
    /// Number of channels taken.
    pub count: usize,
    /// Channel of the memory that receives the first; the others follow.
    pub to: usize,
}

/// Reason why a memory engine refused a call; the engine is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum MemoryError {
    /// The engine has all of the `capacity` samples that it can keep or that its table reaches.
    Full {
        /// Number of samples the engine can take.
        capacity: usize,
    },
    /// A slice has another number of channels than the engine.
    ChannelMismatch {
        /// Channels of the engine.
        expected: usize,
        /// Length of the slice.
        found: usize,
    },
    /// The weights are for steps of another length.
    StepLength,
}

impl fmt::Display for MemoryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Full { capacity } => write!(f, "the memory is full: it takes {capacity} samples"),
            Self::ChannelMismatch { expected, found } => {
                write!(f, "a sample has {found} numbers but the memory has {expected} channels")
            }
            Self::StepLength => write!(f, "the weights of the memory are for steps of another length"),
        }
    }
}

impl core::error::Error for MemoryError {}

impl<T, M: Memory<T> + ?Sized> Memory<T> for &mut M {
    fn channels(&self) -> usize {
        (**self).channels()
    }

    fn stages(&self) -> usize {
        (**self).stages()
    }

    fn kernels(&self) -> usize {
        (**self).kernels()
    }

    fn acts_on(&self) -> ActsOn {
        (**self).acts_on()
    }

    fn expect_jumps(&mut self) {
        (**self).expect_jumps();
    }

    fn leading(&self) -> &[T] {
        (**self).leading()
    }

    fn leading_is_constant(&self) -> bool {
        (**self).leading_is_constant()
    }

    fn len(&self) -> usize {
        (**self).len()
    }

    fn begin_step(&mut self, length: T) -> Result<(), MemoryError> {
        (**self).begin_step(length)
    }

    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        (**self).next_term(term)
    }

    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        (**self).push(sample)
    }

    fn clear(&mut self) {
        (**self).clear();
    }

    fn bytes(&self) -> usize {
        (**self).bytes()
    }

    fn overruns(&self) -> Option<usize> {
        (**self).overruns()
    }

    fn restore_channels(
        &mut self,
        from: &mut StateReader<'_>,
        channels: SavedChannels,
    ) -> Result<(), StateError> {
        (**self).restore_channels(from, channels)
    }
}

/// Checks the length of a sample or term against the number of channels.
///
/// # Errors
/// [`MemoryError::ChannelMismatch`] if they differ.
pub fn check_channels(expected: usize, found: usize) -> Result<(), MemoryError> {
    if expected == found { Ok(()) } else { Err(MemoryError::ChannelMismatch { expected, found }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::saving::StateWriter;

    /// A memory of two kernels with its own implementation of every method, and one that relies on the
    /// defaults.
    #[derive(Default)]
    struct Answers {
        steps: std::vec::Vec<f64>,
        samples: usize,
    }

    struct Silent;

    impl Memory<f64> for Answers {
        fn channels(&self) -> usize {
            6
        }

        fn stages(&self) -> usize {
            3
        }

        fn kernels(&self) -> usize {
            2
        }

        fn acts_on(&self) -> ActsOn {
            ActsOn::Rises
        }

        fn expect_jumps(&mut self) {
            self.samples = 9;
        }

        fn leading(&self) -> &[f64] {
            &[5.0; 18]
        }

        fn leading_is_constant(&self) -> bool {
            false
        }

        fn len(&self) -> usize {
            self.samples
        }

        fn begin_step(&mut self, length: f64) -> Result<(), MemoryError> {
            if length <= 0.0 {
                return Err(MemoryError::StepLength);
            }
            self.steps.push(length);
            Ok(())
        }

        fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
            check_channels(12, term.len())?;
            term.fill(7.0);
            Ok(())
        }

        fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
            check_channels(6, sample.len())?;
            self.samples += 1;
            Ok(())
        }

        fn clear(&mut self) {
            self.samples = 0;
        }

        fn bytes(&self) -> usize {
            77
        }

        fn overruns(&self) -> Option<usize> {
            Some(8)
        }

        fn restore_channels(
            &mut self,
            from: &mut StateReader<'_>,
            channels: SavedChannels,
        ) -> Result<(), StateError> {
            self.samples = channels.count;
            from.bytes(channels.of).map(|_| ())
        }
    }

    impl Stateful for Answers {
        fn state_bytes(&self) -> usize {
            9
        }

        fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
            to.bytes(&[1; 9])
        }

        fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
            from.bytes(9).map(|_| ())
        }

        fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
            self.samples = 4;
            from.bytes(9).map(|_| ())
        }
    }

    impl Memory<f64> for Silent {
        fn channels(&self) -> usize {
            1
        }

        fn leading(&self) -> &[f64] {
            &[0.0]
        }

        fn len(&self) -> usize {
            3
        }

        fn next_term(&mut self, _: &mut [f64]) -> Result<(), MemoryError> {
            Ok(())
        }

        fn push(&mut self, _: &[f64]) -> Result<(), MemoryError> {
            Ok(())
        }

        fn clear(&mut self) {}

        fn bytes(&self) -> usize {
            0
        }
    }

    impl Stateful for Silent {}

    /// Calls through a type parameter, which is a reference here.
    fn assert_answers(mut memory: impl Memory<f64>) {
        assert_eq!((memory.channels(), memory.stages(), memory.kernels()), (6, 3, 2));
        assert_eq!((memory.acts_on(), memory.leading_is_constant()), (ActsOn::Rises, false));
        assert_eq!((memory.leading(), memory.bytes(), memory.overruns()), (&[5.0; 18][..], 77, Some(8)));
        assert_eq!((memory.len(), memory.is_empty()), (0, true));
        assert_eq!(memory.begin_step(0.0), Err(MemoryError::StepLength));
        assert_eq!(memory.begin_step(0.25), Ok(()));
        let mut term = [0.0; 12];
        assert_eq!((memory.next_term(&mut term), term), (Ok(()), [7.0; 12]));
        assert_eq!(memory.push(&[0.0]), Err(MemoryError::ChannelMismatch { expected: 6, found: 1 }));
        assert_eq!((memory.push(&[0.0; 6]), memory.len(), memory.is_empty()), (Ok(()), 1, false));
        memory.expect_jumps();
        assert_eq!(memory.len(), 9);
        let mut bytes = [0; 9];
        assert_eq!((memory.save(&mut StateWriter::new(&mut bytes)), bytes), (Ok(()), [1; 9]));
        assert_eq!(memory.state_bytes(), 9);
        assert!(memory.check_state(&mut StateReader::new(&bytes[1..])).is_err());
        assert_eq!((memory.restore(&mut StateReader::new(&bytes)), memory.len()), (Ok(()), 4));
        assert!(memory.restore(&mut StateReader::new(&bytes[1..])).is_err());
        let channels = SavedChannels { of: 9, first: 0, count: 5, to: 0 };
        let taken = memory.restore_channels(&mut StateReader::new(&bytes), channels);
        assert_eq!((taken, memory.len()), (Ok(()), 5));
        memory.clear();
        assert_eq!(memory.len(), 0);
    }

    #[test]
    fn a_reference_to_a_memory_is_that_memory() {
        let mut memory = Answers::default();
        assert_answers(&mut memory);
        assert_eq!(memory.steps, [0.25]);
    }

    #[test]
    fn a_memory_of_one_kernel_for_equal_steps_needs_to_say_nothing() {
        let mut memory = Silent;
        assert_eq!((memory.stages(), memory.kernels(), memory.acts_on()), (1, 1, ActsOn::Values));
        assert!(memory.leading_is_constant() && !memory.is_empty());
        assert_eq!((memory.begin_step(0.1), memory.overruns(), memory.state_bytes()), (Ok(()), None, 0));
        let unsupported = Err(StateError::Unsupported);
        assert_eq!(memory.save(&mut StateWriter::new(&mut [])), unsupported);
        assert_eq!(memory.check_state(&mut StateReader::new(&[])), unsupported);
        assert_eq!(memory.restore(&mut StateReader::new(&[])), unsupported);
        let channels = SavedChannels { of: 1, first: 0, count: 1, to: 0 };
        assert_eq!(memory.restore_channels(&mut StateReader::new(&[]), channels), unsupported);
    }
}
