//! A memory whose steps run with the widest vectors of the processor in use.

use fvi_core::{ActsOn, Memory, MemoryError, StateError, StateReader, StateWriter, Stateful};
use pulp::{Arch, NullaryFnOnce};

/// A memory of the core compiled for every vector unit of the target, with the one to use chosen at run time.
///
/// The arithmetic is that of the memory itself: the same operations in the same order, hence the same bits on
/// every unit.
#[derive(Clone, Debug)]
pub struct Vectorised<M> {
    memory: M,
    unit: Arch,
}

impl<M> Vectorised<M> {
    /// The same memory, with dispatch to the vector unit.
    pub fn new(memory: M) -> Self {
        Self { memory, unit: Arch::new() }
    }
}

impl<T, M: Memory<T>> Memory<T> for Vectorised<M> {
    fn channels(&self) -> usize {
        self.memory.channels()
    }

    fn stages(&self) -> usize {
        self.memory.stages()
    }

    fn kernels(&self) -> usize {
        self.memory.kernels()
    }

    fn acts_on(&self) -> ActsOn {
        self.memory.acts_on()
    }

    fn leading(&self) -> &[T] {
        self.memory.leading()
    }

    fn len(&self) -> usize {
        self.memory.len()
    }

    #[inline]
    fn begin_step(&mut self, length: T) -> Result<(), MemoryError> {
        self.unit.dispatch(BeginStep { memory: &mut self.memory, length })
    }

    #[inline]
    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        self.unit.dispatch(NextTerm { memory: &mut self.memory, term })
    }

    #[inline]
    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        self.unit.dispatch(Push { memory: &mut self.memory, sample })
    }

    fn clear(&mut self) {
        self.memory.clear();
    }

    fn bytes(&self) -> usize {
        self.memory.bytes() + size_of::<Arch>()
    }

    fn overruns(&self) -> Option<usize> {
        self.memory.overruns()
    }
}

impl<M: Stateful> Stateful for Vectorised<M> {
    fn state_bytes(&self) -> usize {
        self.memory.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.memory.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.memory.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.memory.restore(from)
    }
}

/// `push` as a call that is compiled once for every vector unit. A closure would be called through a shim
/// that is not inlined, and therefore compiled for the plain target.
struct Push<'a, M, T> {
    memory: &'a mut M,
    sample: &'a [T],
}

/// The same for `next_term`.
struct NextTerm<'a, M, T> {
    memory: &'a mut M,
    term: &'a mut [T],
}

/// The same for `begin_step`.
struct BeginStep<'a, M, T> {
    memory: &'a mut M,
    length: T,
}

impl<T, M: Memory<T>> NullaryFnOnce for Push<'_, M, T> {
    type Output = Result<(), MemoryError>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        self.memory.push(self.sample)
    }
}

impl<T, M: Memory<T>> NullaryFnOnce for NextTerm<'_, M, T> {
    type Output = Result<(), MemoryError>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        self.memory.next_term(self.term)
    }
}

impl<T, M: Memory<T>> NullaryFnOnce for BeginStep<'_, M, T> {
    type Output = Result<(), MemoryError>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        self.memory.begin_step(self.length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use fvi_core::check_channels;

    /// A memory with its own implementation of every method.
    struct Answers {
        samples: usize,
        length: f64,
    }

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

        fn leading(&self) -> &[f64] {
            &[5.0; 18]
        }

        fn len(&self) -> usize {
            self.samples
        }

        fn begin_step(&mut self, length: f64) -> Result<(), MemoryError> {
            self.length = length;
            if length > 0.0 { Ok(()) } else { Err(MemoryError::StepLength) }
        }

        fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
            check_channels(12, term.len())?;
            term.fill(self.length);
            Ok(())
        }

        fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
            check_channels(6, sample.len())?;
            self.samples += 3;
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

    #[test]
    fn a_dispatched_memory_answers_as_the_memory_itself() {
        let mut memory = Vectorised::new(Answers { samples: 0, length: 0.0 });
        assert_eq!((memory.channels(), memory.stages(), memory.kernels()), (6, 3, 2));
        assert_eq!((memory.acts_on(), memory.leading()), (ActsOn::Rises, &[5.0; 18][..]));
        assert_eq!((memory.bytes(), memory.overruns()), (77 + size_of::<Arch>(), Some(8)));
        assert_eq!(memory.begin_step(0.0), Err(MemoryError::StepLength));
        assert_eq!(memory.begin_step(0.25), Ok(()));
        let mut term = [0.0; 12];
        assert_eq!((memory.next_term(&mut term), term), (Ok(()), [0.25; 12]));
        let wrong = |expected, found| Err(MemoryError::ChannelMismatch { expected, found });
        assert_eq!((memory.next_term(&mut [0.0]), memory.push(&[0.0])), (wrong(12, 1), wrong(6, 1)));
        assert_eq!((memory.push(&[0.0; 6]), memory.len()), (Ok(()), 3));
        let mut bytes = [0; 9];
        assert_eq!((memory.save(&mut StateWriter::new(&mut bytes)), bytes), (Ok(()), [1; 9]));
        assert_eq!(memory.state_bytes(), 9);
        assert!(memory.check_state(&mut StateReader::new(&bytes[1..])).is_err());
        assert_eq!((memory.restore(&mut StateReader::new(&bytes)), memory.len()), (Ok(()), 4));
        assert!(memory.restore(&mut StateReader::new(&bytes[1..])).is_err());
        memory.clear();
        assert!(memory.is_empty());
    }
}
