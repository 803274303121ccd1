//! The engines: block transforms and exponential sums in vector code, and their constructors as objects.

mod block_fft;
mod chunked_exponential_sum;
mod complex_exponential_sum;
mod cover;
mod lanes;
mod level;
#[cfg(test)]
mod memory_tests;
mod near;
pub(crate) mod plans;
mod real_time;
mod replay;
mod row;
mod scalar;
mod stream;
mod table_kernel;
mod transform;
mod vector_variable_steps;
mod vectorised;
pub(crate) mod weights;
mod wide_exponential_sum;

pub use block_fft::BlockFft;
pub use chunked_exponential_sum::ChunkedExponentialSum;
pub use complex_exponential_sum::{ComplexExponentialSum, ComplexExponentials};
pub use plans::real_transforms;
pub use real_time::{Pacing, RealTime};
pub use scalar::Scalar;
pub use stream::{
    Convolver, ExchangeError, Exchanged, PreparedResponses, Preparer, Responses, Stream, StreamError,
};
pub use vector_variable_steps::VectorVariableSteps;
pub use vectorised::Vectorised;
pub use weights::{WeightTable, Weights};
pub use wide_exponential_sum::{WIDE_KERNELS, WideExponentialSum};

use fvi_core::{ExponentialTable, Memory, ParameterError};

/// A memory whose type is known at run time only.
pub type BoxedMemory<T> = Box<dyn Memory<T> + Send>;

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
    ) -> Result<BoxedMemory<Self>, ParameterError>;

    /// [`RealTime::planned`] with [`Pacing::Paced`]
    ///
    /// # Errors
    /// As there.
    fn real_time(
        kernel: &mut dyn Weights<Self>,
        channels: usize,
        capacity: usize,
    ) -> Result<BoxedMemory<Self>, ParameterError>;

    /// [`ChunkedExponentialSum::new`] for the kernel of a table of 1 to 4 stages
    ///
    /// # Errors
    /// As there, and for more stages.
    fn exponential_sum(
        table: &ExponentialTable<&[f64]>,
        channels: usize,
    ) -> Result<BoxedMemory<Self>, ParameterError>;

    /// [`ComplexExponentialSum::new`]
    ///
    /// # Errors
    /// As there.
    fn complex_exponential_sum(
        table: &ComplexExponentials,
        channels: usize,
    ) -> Result<BoxedMemory<Self>, ParameterError>;

    /// [`WideExponentialSum::of_kernels`] on so many threads
    ///
    /// # Errors
    /// As there.
    fn wide_exponential_sum(
        tables: &[ExponentialTable<&[f64]>],
        channels: usize,
        threads: usize,
    ) -> Result<BoxedMemory<Self>, ParameterError>;

    /// The same with a state in single precision
    ///
    /// # Errors
    /// As there.
    fn wide_exponential_sum_in_f32(
        tables: &[ExponentialTable<&[f64]>],
        channels: usize,
        threads: usize,
    ) -> Result<BoxedMemory<Self>, ParameterError>;
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
            ) -> Result<BoxedMemory<Self>, ParameterError> {
                Ok(Box::new(BlockFft::planned(Borrowed(kernel), channels, capacity)?))
            }

            fn real_time(
                kernel: &mut dyn Weights<Self>,
                channels: usize,
                capacity: usize,
            ) -> Result<BoxedMemory<Self>, ParameterError> {
                Ok(Box::new(RealTime::planned(Borrowed(kernel), channels, capacity, Pacing::Paced)?))
            }

            fn exponential_sum(
                table: &ExponentialTable<&[f64]>,
                channels: usize,
            ) -> Result<BoxedMemory<Self>, ParameterError> {
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
            ) -> Result<BoxedMemory<Self>, ParameterError> {
                Ok(Box::new(Vectorised::new(ComplexExponentialSum::<Self>::new(table, channels)?)))
            }

            fn wide_exponential_sum(
                tables: &[ExponentialTable<&[f64]>],
                channels: usize,
                threads: usize,
            ) -> Result<BoxedMemory<Self>, ParameterError> {
                let memory = WideExponentialSum::<Self>::of_kernels(tables, channels)?;
                Ok(Box::new(memory.on_threads(threads)))
            }

            fn wide_exponential_sum_in_f32(
                tables: &[ExponentialTable<&[f64]>],
                channels: usize,
                threads: usize,
            ) -> Result<BoxedMemory<Self>, ParameterError> {
                let memory = WideExponentialSum::<Self, f32>::of_kernels(tables, channels)?;
                Ok(Box::new(memory.on_threads(threads)))
            }
        }
    )*};
}

engines!(f32 f64);
