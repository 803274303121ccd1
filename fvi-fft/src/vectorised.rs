//! A memory whose steps run with the widest vectors of the processor at hand.

use fvi_core::{ActsOn, Memory, MemoryError, StateError, StateReader, StateWriter};
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
    /// The same memory, dispatched.
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

/// The call that is compiled once for every vector unit. A closure would not do: it is called through a shim
/// that is not inlined, and what is not inlined is compiled for the plain target.
struct Push<'a, M, T> {
    memory: &'a mut M,
    sample: &'a [T],
}

/// The same for the memory term.
struct NextTerm<'a, M, T> {
    memory: &'a mut M,
    term: &'a mut [T],
}

/// And for the length of the step to come.
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
