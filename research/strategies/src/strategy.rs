//! The strategies of a race, and the tasks that they are given.

use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use fvi_core::{BdfOrder, Memory, ParameterError};
use fvi_fft::baseline::OfflineFft;
use fvi_fft::exponentials::exponential_table::SMALLEST_TOLERANCE;
use fvi_rivals::Operations;

use crate::kernel::Kernel;
use crate::precision::Precision;

/// Request to a strategy.
#[derive(Clone, Debug)]
pub struct Task {
    pub(crate) kernel: Arc<Kernel>,
    /// The weights w_0, w_1, … of the kernel, one for each step.
    pub weights: Arc<Vec<f64>>,
    /// Number of steps.
    pub length: usize,
    /// Number of channels, each convolved with the same weights.
    pub channels: usize,
    /// Type of the samples.
    pub precision: Precision,
    /// Tolerated error, relative to Σ|w||x|.
    pub tolerance: f64,
    /// Set when nobody waits for the strategy any more.
    pub(crate) abandoned: Arc<AtomicBool>,
}

impl Task {
    /// The kernel s^β by a backward differentiation formula at step 1 in the form used by the memory of a
    /// run, whose weights act on differences for β ≥ 0.1: one channel in double precision, exact to rounding.
    ///
    /// # Errors
    /// If the exponent is not greater than −1 and less than 2.
    pub fn of_a_run(order: BdfOrder, exponent: f64, length: usize) -> Result<Self, ParameterError> {
        let kernel = Kernel::of_a_run(order, exponent)?;
        Ok(Self {
            weights: Arc::new(kernel.weights(length)?),
            kernel: Arc::new(kernel),
            length,
            channels: 1,
            precision: Precision::F64,
            tolerance: SMALLEST_TOLERANCE,
            abandoned: Arc::default(),
        })
    }

    /// Name of the kernel.
    pub fn kernel(&self) -> &str {
        &self.kernel.name
    }

    /// β of a kernel s^β.
    pub fn order(&self) -> Option<f64> {
        self.kernel.exponent()
    }

    /// h, the step of the quadrature.
    pub fn step(&self) -> f64 {
        self.kernel.step
    }
}

/// A memory in one of the precisions, or the offline transform, which is not a memory.
pub(crate) enum AnyMemory {
    F64(Box<dyn Memory<f64> + Send>),
    F32(Box<dyn Memory<f32> + Send>),
    /// An offline transform of samples known beforehand, one channel; it has no steps.
    Offline(Box<OfflineFft>),
}

impl AnyMemory {
    pub(crate) fn precision(&self) -> Precision {
        match self {
            Self::F64(_) | Self::Offline(_) => Precision::F64,
            Self::F32(_) => Precision::F32,
        }
    }

    pub(crate) fn channels(&self) -> usize {
        match self {
            Self::F64(memory) => memory.channels(),
            Self::F32(memory) => memory.channels(),
            Self::Offline(_) => 1,
        }
    }
}

/// Source of the number of operations.
#[derive(Clone, Debug, Default)]
pub(crate) enum Flops {
    #[default]
    Unknown,
    Counted(Operations),
    /// As many in each step.
    OfAStep(f64),
}

/// Returns the reason of a failure that a [`MemoryError`](fvi_core::MemoryError) cannot express.
pub(crate) type Trouble = Arc<dyn Fn() -> Option<String> + Send + Sync>;

/// Measures the bytes of what is no memory of this process; `None` where the system does not tell.
pub(crate) type Measured = Arc<dyn Fn() -> Option<usize> + Send + Sync>;

/// A strategy that has been made for a task.
pub struct BuiltStrategy {
    pub(crate) memory: AnyMemory,
    pub(crate) own_weights: Option<Arc<Vec<f64>>>,
    pub(crate) flops: Flops,
    pub(crate) trouble: Option<Trouble>,
    /// In place of the bytes that the memory counts itself.
    pub(crate) resident: Option<Measured>,
    pub(crate) promises: bool,
}

impl BuiltStrategy {
    /// A memory in double precision, whose calls are compiled for the widest vectors of the processor.
    pub fn memory(memory: impl Memory<f64> + Send + 'static) -> Self {
        Self::of(AnyMemory::F64(fvi_rivals::vectorised(memory)))
    }

    pub(crate) fn of(memory: AnyMemory) -> Self {
        Self {
            memory,
            own_weights: None,
            flops: Flops::Unknown,
            trouble: None,
            resident: None,
            promises: true,
        }
    }

    /// The memory, if it is one in double precision.
    pub fn into_memory(self) -> Option<Box<dyn Memory<f64> + Send>> {
        match self.memory {
            AnyMemory::F64(memory) => Some(memory),
            AnyMemory::F32(_) | AnyMemory::Offline(_) => None,
        }
    }

    /// A memory that counts its operations itself.
    pub fn counted(self, operations: Operations) -> Self {
        Self { flops: Flops::Counted(operations), ..self }
    }

    /// A memory with as many floating-point operations on average in each step, for all channels.
    pub(crate) fn taking(self, operations: f64) -> Self {
        Self { flops: Flops::OfAStep(operations), ..self }
    }

    /// One that has no error bound for this task, as [`Strategy::without_bound`] says for all tasks.
    pub fn without_bound(self) -> Self {
        Self { promises: false, ..self }
    }

    /// A memory that sums weights of its own in place of those of the task, such as another discretisation of
    /// the same operator: its error is measured against the sum with these weights.
    pub fn summing(self, weights: Vec<f64>) -> Self {
        Self { own_weights: Some(Arc::new(weights)), ..self }
    }
}

/// Why a strategy does not take part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Declined {
    /// It does not apply to this task.
    SitsOut(String),
    /// It cannot be constructed.
    Failed(String),
}

impl Declined {
    pub(crate) fn sits_out(reason: impl Into<String>) -> Self {
        Self::SitsOut(reason.into())
    }
}

/// Errors in making a strategy are reported with its name.
impl<E: Error> From<E> for Declined {
    fn from(error: E) -> Self {
        Self::Failed(error.to_string())
    }
}

pub(crate) type Maker = Arc<dyn Fn(&Task) -> Result<BuiltStrategy, Declined> + Send + Sync>;

/// A strategy by name, and how it is made for a task.
#[derive(Clone)]
pub struct Strategy {
    pub(crate) name: String,
    pub(crate) description: String,
    /// True if the method has an error bound, so that its error should be within the tolerance.
    pub(crate) promises: bool,
    pub(crate) make: Maker,
}

impl Strategy {
    /// A strategy with a name, a short description, and its constructor for a task, which a race calls once
    /// before the errors are measured and once for each round.
    pub fn new(
        name: impl Into<String>,
        description: impl Into<String>,
        make: impl Fn(&Task) -> Result<BuiltStrategy, Declined> + Send + Sync + 'static,
    ) -> Self {
        Self { name: name.into(), description: description.into(), promises: true, make: Arc::new(make) }
    }

    /// The strategy marked as one without an error bound: exceeding the tolerance is then not reported as a
    /// failure.
    #[must_use]
    pub fn without_bound(self) -> Self {
        Self { promises: false, ..self }
    }

    /// Constructs the strategy for a task, outside of a race.
    ///
    /// # Errors
    /// Why the strategy does not take part.
    pub fn make(&self, task: &Task) -> Result<BuiltStrategy, Declined> {
        (self.make)(task)
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }
}

/// Largest number of products of a plain sum over a run, for all channels: beyond, it does not take part.
const MOST_PRODUCTS: f64 = (1u64 << 31) as f64;

/// For plain sums: declines runs that would take seconds each.
pub(crate) fn require_short(task: &Task, window: usize) -> Result<(), Declined> {
    let products = task.length as f64 * window.min(task.length) as f64 * task.channels as f64;
    if products <= MOST_PRODUCTS {
        return Ok(());
    }
    Err(Declined::sits_out(format!("{products:.1e} products in a run, more than {MOST_PRODUCTS:.1e}")))
}

/// Why a memory in double precision does not take part in single precision.
pub(crate) const DOUBLE_ONLY: &str = "it is there in double precision only";

pub(crate) fn require_double(task: &Task) -> Result<(), Declined> {
    match task.precision {
        Precision::F64 => Ok(()),
        Precision::F32 => Err(Declined::sits_out(DOUBLE_ONLY)),
    }
}
