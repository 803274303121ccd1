//! The engines as objects, compiled in this crate.

use fvi_core::{ExponentialTable, Memory, ParameterError};

use crate::block_fft::BlockFft;
use crate::chunked_exponential_sum::ChunkedExponentialSum;
use crate::complex_exponential_sum::{ComplexExponentialSum, ComplexExponentials};
use crate::real_time::{Pacing, RealTime};
use crate::scalar::Scalar;
use crate::vectorised::Vectorised;
use crate::weights::Weights;
use crate::wide_exponential_sum::WideExponentialSum;

/// A memory engine chosen at run time.
pub type Engine<T> = Box<dyn Memory<T> + Send>;

/// Constructors of the engines of this crate for a scalar, as trait objects, so that crates which use them do
/// not compile them again.
pub trait Engines: Scalar {
    /// [`BlockFft::planned`]
    ///
    /// # Errors
    /// As there.
    fn block_fft(
        kernel: &mut dyn Weights<Self>,
        channels: usize,
        capacity: usize,
    ) -> Result<Engine<Self>, ParameterError>;

    /// [`RealTime::planned`] with [`Pacing::Paced`]
    ///
    /// # Errors
    /// As there.
    fn real_time(
        kernel: &mut dyn Weights<Self>,
        channels: usize,
        capacity: usize,
    ) -> Result<Engine<Self>, ParameterError>;

    /// [`ChunkedExponentialSum::new`] for the kernel of a table of 1 to 4 stages
    ///
    /// # Errors
    /// As there, and for more stages.
    fn exponential_sum(
        table: &ExponentialTable<&[f64]>,
        channels: usize,
    ) -> Result<Engine<Self>, ParameterError>;

    /// [`ComplexExponentialSum::new`]
    ///
    /// # Errors
    /// As there.
    fn complex_exponential_sum(
        table: &ComplexExponentials,
        channels: usize,
    ) -> Result<Engine<Self>, ParameterError>;

    /// [`WideExponentialSum::of_kernels`] on so many threads
    ///
    /// # Errors
    /// As there.
    fn wide_exponential_sum(
        tables: &[ExponentialTable<&[f64]>],
        channels: usize,
        threads: usize,
    ) -> Result<Engine<Self>, ParameterError>;

    /// The same with a state in single precision
    ///
    /// # Errors
    /// As there.
    fn wide_exponential_sum_in_f32(
        tables: &[ExponentialTable<&[f64]>],
        channels: usize,
        threads: usize,
    ) -> Result<Engine<Self>, ParameterError>;
}

/// A kernel by mutable reference.
struct Borrowed<'a, T>(&'a mut dyn Weights<T>);

impl<T> Weights<T> for Borrowed<'_, T> {
    fn stages(&self) -> usize {
        self.0.stages()
    }

    fn fill(&mut self, first: usize, weights: &mut [T]) {
        self.0.fill(first, weights);
    }
}

macro_rules! engines {
    ($($scalar:ty)*) => {$(
        impl Engines for $scalar {
            fn block_fft(
                kernel: &mut dyn Weights<Self>,
                channels: usize,
                capacity: usize,
            ) -> Result<Engine<Self>, ParameterError> {
                Ok(Box::new(BlockFft::planned(Borrowed(kernel), channels, capacity)?))
            }

            fn real_time(
                kernel: &mut dyn Weights<Self>,
                channels: usize,
                capacity: usize,
            ) -> Result<Engine<Self>, ParameterError> {
                Ok(Box::new(RealTime::planned(Borrowed(kernel), channels, capacity, Pacing::Paced)?))
            }

            fn exponential_sum(
                table: &ExponentialTable<&[f64]>,
                channels: usize,
            ) -> Result<Engine<Self>, ParameterError> {
                Ok(match table.stages {
                    1 => Box::new(ChunkedExponentialSum::<Self, 1>::new(table, channels)?),
                    2 => Box::new(ChunkedExponentialSum::<Self, 2>::new(table, channels)?),
                    3 => Box::new(ChunkedExponentialSum::<Self, 3>::new(table, channels)?),
                    4 => Box::new(ChunkedExponentialSum::<Self, 4>::new(table, channels)?),
                    stages => {
                        let (parameter, allowed) = ("stages", "1 to 4");
                        return Err(ParameterError { parameter, value: stages as f64, allowed });
                    }
                })
            }

            fn complex_exponential_sum(
                table: &ComplexExponentials,
                channels: usize,
            ) -> Result<Engine<Self>, ParameterError> {
                Ok(Box::new(Vectorised::new(ComplexExponentialSum::<Self>::new(table, channels)?)))
            }

            fn wide_exponential_sum(
                tables: &[ExponentialTable<&[f64]>],
                channels: usize,
                threads: usize,
            ) -> Result<Engine<Self>, ParameterError> {
                let memory = WideExponentialSum::<Self>::of_kernels(tables, channels)?;
                Ok(Box::new(memory.on_threads(threads)))
            }

            fn wide_exponential_sum_in_f32(
                tables: &[ExponentialTable<&[f64]>],
                channels: usize,
                threads: usize,
            ) -> Result<Engine<Self>, ParameterError> {
                let memory = WideExponentialSum::<Self, f32>::of_kernels(tables, channels)?;
                Ok(Box::new(memory.on_threads(threads)))
            }
        }
    )*};
}

engines!(f32 f64);
