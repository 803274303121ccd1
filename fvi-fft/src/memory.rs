//! The memory engines on the host, and their choice.

mod history;
mod tables;

pub use history::{Engine, History, Overflow, States};
pub use tables::Tables;

use crate::Aligned;
use crate::GrowingRing;
use crate::exponentials::complex_exponential_table::complex_exponentials;
use crate::exponentials::exponential_table::{self, ExponentialKernel, ExponentialKernelError};
use crate::exponentials::rate_table::{RateTableError, SMALLEST_TOLERANCE, rate_table_of};
use crate::quadrature::ConvolutionFamily;
use crate::quadrature::multistep_weights::multistep_weights;
use crate::quadrature::runge_kutta_weights::RungeKuttaWeights;
use crate::quadrature::starting::StartingCorrection;
use crate::transfer::TransferFunction;
use crate::transfer::fractions::Fractions;
use crate::transfer::multistep_rule::MultistepRule;
use crate::with_staged_method;
use crate::{
    ComplexExponentials, Engines, VectorVariableSteps, Vectorised, WIDE_KERNELS, Weights, WideExponentialSum,
};
use fvi_core::{
    ActsOn, BdfOrder, ConvolutionWeights, Direct, ExponentialSum, ExponentialTable, Memory, MemoryError,
    ParameterError, Real, RungeKutta, SavedChannels, StateError, StateReader, StateWriter, Stateful,
};
use std::sync::{Arc, Mutex, PoisonError};

/// A memory engine chosen at run time.
pub struct HostMemory<T> {
    memory: crate::BoxedMemory<T>,
    engine: Engine,
    acts_on: ActsOn,
    // Copies of values that every step needs, without a virtual call of the engine.
    stages: usize,
    is_empty: bool,
    /// W₀, if it is the same at every step.
    leading: Option<Box<[T]>>,
}

impl<T: Copy> HostMemory<T> {
    fn new(memory: crate::BoxedMemory<T>, engine: Engine, acts_on: ActsOn) -> Self {
        let constant = engine != Engine::AnyStep && memory.leading_is_constant();
        let leading = constant.then(|| memory.leading().into());
        let (stages, is_empty) = (memory.stages(), memory.is_empty());
        Self { memory, engine, acts_on, stages, is_empty, leading }
    }
}

impl<T> HostMemory<T> {
    /// The engine that it is.
    pub fn engine(&self) -> Engine {
        self.engine
    }

    /// The engine itself, where it is called through a pointer anyway: one call less for a term or a sample.
    pub fn into_engine(self) -> crate::BoxedMemory<T> {
        self.memory
    }
}

/// The scalars for which memories are built. The code behind a request is generic and large, and is compiled
/// in this crate only.
pub trait Memories: Engines {
    /// [`MemoryRequest::build_with`]
    ///
    /// # Errors
    /// As there.
    fn memory(request: &MemoryRequest<'_>, tables: &Tables) -> Result<HostMemory<Self>, EngineError>;
}

impl Memories for f32 {
    fn memory(request: &MemoryRequest<'_>, tables: &Tables) -> Result<HostMemory<f32>, EngineError> {
        request.made(tables)
    }
}

impl Memories for f64 {
    fn memory(request: &MemoryRequest<'_>, tables: &Tables) -> Result<HostMemory<f64>, EngineError> {
        request.made(tables)
    }
}

/// Request for a memory: kernel, quadrature, number of samples and channels, engine.
#[derive(Clone, Debug)]
pub struct MemoryRequest<'a> {
    /// The method behind the convolution quadrature.
    pub family: ConvolutionFamily,
    /// Exponents made exact by starting weights; empty: none.
    pub starting: &'a [f64],
    /// K(s) of the damping force.
    pub transfer: &'a TransferFunction,
    /// h; the shortest step of a grid with different steps.
    pub step_size: f64,
    /// The last time of a grid with different steps; `None` for equal steps.
    pub end: Option<f64>,
    /// Number of coordinates N; those of all motions where several are integrated together.
    pub coordinates: usize,
    /// Number of motions integrated together. The engine is chosen as for one of them, so that its bits are
    /// the same.
    pub motions: usize,
    /// Number of samples in the run: one for each step, and one before the first.
    pub samples: usize,
    /// True if the samples are given values and not solved increments: then the memory acts on values, and
    /// its error is that of the plain sum for any samples.
    pub given: bool,
    /// The requested engine, and its settings.
    pub history: &'a History,
}

/// Weights of a multistep rule as a sum of exponentials.
#[derive(Clone, Debug)]
pub enum SumTable {
    /// Real exponentials; the tolerance is the error of each weight relative to itself.
    Real(Arc<ExponentialKernel>),
    /// Exponentials in complex-conjugate pairs; the tolerance is the error of each weight relative to the
    /// largest one, and of all together.
    Pairs(Arc<ComplexExponentials>),
}

/// Why an engine cannot serve a request.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    /// The run is too long for the engine's tables and samples to fit into memory.
    #[error("the engine \"{}\" finds no room for {samples} samples", .engine.name())]
    NoRoom {
        /// The engine.
        engine: Engine,
        /// Number of samples.
        samples: usize,
    },
    /// A parameter of the kernel is outside its range.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The engine is for equal steps only, or the quadrature has no weights for other steps.
    #[error("the engine \"{}\" cannot serve this: {reason}", .engine.name())]
    Unsuited {
        /// The engine.
        engine: Engine,
        /// The reason, and an alternative.
        reason: &'static str,
    },
    /// No table of exponentials reaches the tolerance.
    #[error(transparent)]
    Table(ExponentialKernelError),
    /// No sum of relaxations approximates the kernel for steps of any length.
    #[error(transparent)]
    Rates(RateTableError),
    /// The run to be continued began with a table of exponentials that ends too early.
    #[error(
        "the run began with a table of exponentials for {reach} samples, and its memory cannot be carried to {samples}: \
         begin anew, or with a longer `history.horizon` the next time"
    )]
    TableEnds {
        /// Number of samples that the table covers.
        reach: usize,
        /// Number of samples of the continued run.
        samples: usize,
    },
}

/// Number of samples up to which the plain sum serves by default: its cost is that of the whole history at
/// each step, but it needs no transforms.
const PLAIN: usize = 256;

/// Number of samples up to which transforms in blocks serve by default. Step for step a sum of exponentials
/// costs half of them or less (`fvi compare-engines`), but its table takes one to three milliseconds, longer
/// than all the steps of so short a run.
const CROSSOVER: usize = 16_384;

/// Largest number of stages that plain sums and those of exponentials for equal steps take.
const MOST_STAGES_OF_SUMS: usize = 4;

/// Largest number of channels to which `CROSSOVER` applies, and largest length of a history that is short for
/// any number of channels: with many channels the cost of a table is soon made up for, and full histories of
/// all channels fill the memory.
const FEW: usize = 64;
const SMALL: usize = 1 << 16;
/// Number of channels from which exponential sums are stored with neighbouring channels side by side, and the
/// largest chunk for which they are: in longer ones, required by the heads of high orders, the samples of a
/// chunk take more room than the sums.
const MANY: usize = 96;
const LONGEST_CHUNK: usize = 64;

/// Smallest order for which memories act on increments. Below, nothing cancels in the plain weights, and
/// those on increments hardly decay, so that no exponential sum approximates them.
pub const LEAST_ON_INCREMENTS: f64 = 0.1;

/// Largest number of kernels that share a memory.
pub const MOST_SHARING: usize = WIDE_KERNELS;

/// Fraction of the tolerance left to the table if a state in single precision takes the rest.
const PART_OF_THE_TABLE: f64 = 0.5;

/// Relative error of the history in a table for steps of any length: a few times rounding. For transfer
/// functions given as formulas, whose own rounding may be larger, up to a hundred times that.
pub const RATE_TOLERANCE: f64 = 1e-13;

/// Numbers that the transform behind exact weights takes for each of them.
const ROOM_OF_TRANSFORM: usize = 64;

/// Relative error of a weight that does not show beside rounding.
const EXACT: f64 = exponential_table::SMALLEST_TOLERANCE;

impl From<ExponentialKernelError> for EngineError {
    fn from(error: ExponentialKernelError) -> Self {
        match error {
            ExponentialKernelError::Parameter(error) => Self::Parameter(error),
            error => Self::Table(error),
        }
    }
}

impl From<RateTableError> for EngineError {
    fn from(error: RateTableError) -> Self {
        match error {
            RateTableError::Parameter(error) => Self::Parameter(error),
            error => Self::Rates(error),
        }
    }
}

/// Most weights of one kernel that are kept for other runs.
const MOST_SHARED: usize = 1 << 17;

impl MemoryRequest<'_> {
    /// The memory, empty, on the requested engine or on the fastest that is exact to rounding.
    ///
    /// # Errors
    /// [`EngineError`] if the requested engine cannot serve the kernel.
    pub fn build<T: Memories>(&self) -> Result<HostMemory<T>, EngineError> {
        self.build_with(&Tables::default())
    }

    /// As [`build`](Self::build), with tables that are cached in `tables`.
    ///
    /// # Errors
    /// As [`build`](Self::build).
    pub fn build_with<T: Memories>(&self, tables: &Tables) -> Result<HostMemory<T>, EngineError> {
        T::memory(self, tables)
    }

    fn made<T: Engines>(&self, tables: &Tables) -> Result<HostMemory<T>, EngineError> {
        let exponents = self.starting;
        let memory = self.without_starting(tables)?;
        let ConvolutionFamily::Bdf { order } = self.family else { return Ok(memory) };
        if exponents.is_empty() {
            return Ok(memory);
        }
        let (engine, acts_on, order) = (memory.engine(), memory.acts_on, BdfOrder::new(order)?);
        if !self.transfer.is_relaxation() {
            let reason = "`convolution.starting` is for kernels whose singularities lie on the negative real axis; leave it out";
            return Err(EngineError::Unsuited { engine, reason });
        }
        let corrected =
            StartingCorrection::of_transfer(memory, order, self.transfer, self.step_size, exponents)?;
        Ok(HostMemory::new(Box::new(corrected), engine, acts_on))
    }

    /// A memory of other weights for the same samples, scalar weights or planes of matrices with the given
    /// number of stages, such as derivatives of the kernel's weights with respect to a parameter: the plain
    /// sum if that is the requested engine, transforms otherwise. The arguments of `weights` are whether they
    /// are to act on increments, and their number.
    ///
    /// # Errors
    /// [`EngineError`], and those of `weights`.
    pub fn build_of_weights(
        &self,
        stages: usize,
        weights: &dyn Fn(bool, usize) -> Result<Vec<f64>, ParameterError>,
    ) -> Result<HostMemory<f64>, EngineError> {
        let direct = self.engine() == Engine::Direct;
        let samples = if direct { self.kept() } else { self.samples };
        let count = samples.saturating_add(1);
        self.room::<f64>(Engine::BlockFft, count.saturating_mul(2 * stages * stages))?;
        let numbers = weights(self.acts_on() != ActsOn::Values, count)?;
        match direct {
            true => self.direct(numbers, stages, 1.0),
            false => self.transforms(Engine::BlockFft, Planes { numbers, stages }, stages),
        }
    }

    /// True if the kernel may share a memory with another one, as far as this depends on the kernels: both
    /// have exponentials, and act on the same kind of samples.
    pub fn may_share_with(&self, other: &Self) -> bool {
        let fractional = |request: &Self| {
            request.transfer.exponent().is_some_and(|exponent| exponent != 0.0 && exponent != 1.0)
        };
        fractional(self) && fractional(other) && self.acts_on() == other.acts_on()
    }

    /// One memory for the kernels of these exponents, of which that of the request is the first: the samples
    /// and one set of exponentials for all of them. `None` if the engine would not be sums of exponentials
    /// for many channels, or no common table reaches the tolerance: then each needs a memory of its own.
    pub fn build_sharing<T: Engines>(&self, exponents: &[f64], tables: &Tables) -> Option<HostMemory<T>> {
        let ConvolutionFamily::Bdf { order } = self.family else { return None };
        if !self.starting.is_empty() || self.engine() != Engine::ExponentialSum {
            return None;
        }
        let (order, tolerance) = (BdfOrder::new(order).ok()?, self.table_tolerance());
        let (horizon, on_increments) = (self.horizon().ok()?, self.acts_on() != ActsOn::Values);
        let others = exponents.iter().map(|exponent| exponent.to_bits());
        let key: Vec<u64> = self.key(horizon as u64, tolerance).into_iter().chain(others).collect();
        let make = || {
            let step_size = self.step_size;
            Ok(ExponentialKernel::sharing_rates(
                order,
                exponents,
                on_increments,
                step_size,
                horizon,
                tolerance,
            )?)
        };
        let kernels = tables.get(&key, make).ok()?;
        let kernels: Vec<_> = kernels.iter().map(ExponentialKernel::table::<f64>).collect();
        let kernels: Vec<_> = kernels.iter().map(ExponentialTable::borrow).collect();
        Some(self.host(self.side_by_side(&kernels)?.ok()?, Engine::ExponentialSum))
    }

    /// Kind of samples that the memory acts on: differences, where they are more accurate. Kernels that
    /// hardly grow for large s, such as the identity, integrals and materials with a glass modulus, act on
    /// values.
    pub fn acts_on(&self) -> ActsOn {
        match self.family {
            _ if self.given || self.transfer.growth() < LEAST_ON_INCREMENTS => ActsOn::Values,
            // The partial sums of its weights would converge to the stiffness of the spring only up to
            // rounding.
            _ if self.transfer.spring() != 0.0 => ActsOn::Values,
            ConvolutionFamily::Bdf { .. } | ConvolutionFamily::Trapezoidal => ActsOn::Increments,
            ConvolutionFamily::RadauIia { .. }
            | ConvolutionFamily::LobattoIiic { .. }
            | ConvolutionFamily::Gauss { .. } => ActsOn::Rises,
        }
    }

    /// The kernel of the memory.
    ///
    /// # Errors
    /// If the exponent or the step size is outside its range.
    pub fn kernel(&self) -> Result<fvi_core::Kernel, ParameterError> {
        let (transfer, step_size) = (self.transfer, self.step_size);
        if let (Some(_), true) = (transfer.table(), self.family.is_staged()) {
            let allowed =
                "those of a multistep rule, one number for each lag: take `convolution.family` = \"bdf\"";
            return Err(ParameterError { parameter: "weights", value: f64::NAN, allowed });
        }
        let Some(exponent) = transfer.exponent() else { return self.kernel_of_transfer() };
        if self.family == ConvolutionFamily::Trapezoidal && exponent != 0.0 {
            return self.kernel_of_transfer();
        }
        if self.any_step() {
            // The memory is built from the same family and exponent; there is no single step size to compare.
            return fvi_core::Kernel::given(exponent);
        }
        if let Some(staged) = self.family.staged() {
            return with_staged_method!(staged, method => fvi_core::Kernel::runge_kutta(&method, exponent, step_size))?;
        }
        // Only the identity is left for the trapezoidal rule, and it is the same for any rule.
        let order = match self.family {
            ConvolutionFamily::Bdf { order } => order,
            _ => 1,
        };
        fvi_core::Kernel::bdf(BdfOrder::new(order)?, exponent, step_size)
    }

    fn kernel_of_transfer(&self) -> Result<fvi_core::Kernel, ParameterError> {
        let (transfer, step_size) = (self.transfer, self.step_size);
        if self.any_step() {
            return fvi_core::Kernel::given_growth(transfer.growth());
        }
        if let Some(staged) = self.family.staged() {
            return with_staged_method!(staged, method => self.matrix_kernel(&method))?;
        }
        let allowed = "a multistep rule, Radau IIA or Lobatto IIIC; Gauss weights are those of mechanisms";
        let unknown = ParameterError { parameter: "family", value: f64::NAN, allowed };
        let rule = self.family.multistep()?.ok_or(unknown)?;
        let first = transfer.table().map_or(2, |table| table.weights().len().min(2));
        let weights = multistep_weights(transfer, rule, step_size, false, first)?;
        // A table of one weight is that of a memory without lags.
        let first = if let [only] = weights[..] { [only, 0.0] } else { [weights[0], weights[1]] };
        fvi_core::Kernel::weights(transfer.growth(), first, step_size)
    }

    fn matrix_kernel<const R: usize>(
        &self,
        method: &RungeKutta<R>,
    ) -> Result<fvi_core::Kernel, ParameterError> {
        let (transfer, step_size) = (self.transfer, self.step_size);
        let on_rises = self.acts_on() != ActsOn::Values;
        let weights = RungeKuttaWeights::of_transfer(method, transfer, on_rises, step_size, 1)?;
        fvi_core::Kernel::matrix_weights(transfer.growth(), R, weights.leading_determinant(), step_size)
    }

    /// True if the memory takes steps of any length.
    fn any_step(&self) -> bool {
        self.end.is_some() || self.engine() == Engine::AnyStep
    }

    /// The memory before it is wrapped with starting weights.
    fn without_starting<T: Engines>(&self, tables: &Tables) -> Result<HostMemory<T>, EngineError> {
        let engine = self.engine();
        match self.memory(engine, tables) {
            Err(EngineError::Table(_)) if self.history.engine.is_none() => {
                self.memory(Engine::BlockFft, tables)
            }
            other => other,
        }
    }

    /// The requested engine, or the fastest that is exact to rounding, as far as there is a table for it.
    fn engine(&self) -> Engine {
        let channels = self.channels_of_one();
        let few = channels <= FEW || self.planned().saturating_mul(channels) <= SMALL;
        match self.history.engine {
            Some(engine) => engine,
            None if self.end.is_some() => Engine::AnyStep,
            None if self.family.staged().is_some_and(|method| method.stages() > MOST_STAGES_OF_SUMS) => {
                if self.transfer.is_relaxation() {
                    Engine::AnyStep
                } else {
                    Engine::BlockFft
                }
            }
            None if (self.planned() <= PLAIN && few) || self.history.capacity.is_some() => Engine::Direct,
            None if self.planned() <= CROSSOVER && few => Engine::BlockFft,
            None if self.family == ConvolutionFamily::Trapezoidal => Engine::BlockFft,
            None if self.transfer.table().is_some() => Engine::BlockFft,
            None if self.is_staged() && !self.transfer.is_relaxation() => Engine::BlockFft,
            None => Engine::ExponentialSum,
        }
    }

    /// True if its weights are matrices, those of a Runge–Kutta method.
    fn is_staged(&self) -> bool {
        !matches!(self.family, ConvolutionFamily::Bdf { .. } | ConvolutionFamily::Trapezoidal)
    }

    /// Relative error of a weight in a table of exponentials.
    fn table_tolerance(&self) -> f64 {
        match (self.history.tolerance, self.history.states) {
            (Some(tolerance), Some(States::F32)) => PART_OF_THE_TABLE * tolerance,
            (tolerance, _) => tolerance.unwrap_or(EXACT),
        }
    }

    fn memory<T: Engines>(&self, engine: Engine, tables: &Tables) -> Result<HostMemory<T>, EngineError> {
        if self.end.is_some() && engine != Engine::AnyStep {
            let reason = "its weights are for equal steps; \"any-step\" takes those of this grid";
            return Err(EngineError::Unsuited { engine, reason });
        }
        if let Some(staged) = self.family.staged() {
            return with_staged_method!(staged, method => self.staged(engine, &method, tables))?;
        }
        let Some(rule) = self.family.multistep()? else {
            let reason = "Gauss weights are those of the dampers of mechanisms";
            return Err(EngineError::Unsuited { engine, reason });
        };
        self.scalar(engine, rule, tables)
    }

    /// A memory for a kernel of plain numbers.
    fn scalar<T: Engines>(
        &self,
        engine: Engine,
        rule: MultistepRule,
        tables: &Tables,
    ) -> Result<HostMemory<T>, EngineError> {
        match engine {
            Engine::AnyStep => {
                let reason = "it needs a Runge–Kutta family of convolution quadrature";
                Err(EngineError::Unsuited { engine, reason })
            }
            Engine::Direct | Engine::BlockFft | Engine::RealTime => match (self.transfer.exponent(), rule) {
                (Some(exponent), MultistepRule::Bdf(order)) => {
                    self.power_weights(engine, order, exponent, tables)
                }
                _ => self.transfer_weights(engine, rule, tables),
            },
            Engine::ExponentialSum | Engine::ExponentialSumCore => {
                match self.sum_table(engine, rule, tables)? {
                    SumTable::Pairs(table) => {
                        Ok(self.host(T::complex_exponential_sum(&table, self.coordinates)?, engine))
                    }
                    SumTable::Real(kernel) if engine == Engine::ExponentialSumCore => {
                        self.core_exponential_sum(kernel.table())
                    }
                    SumTable::Real(kernel) => self.exponential_sum_of_numbers(&kernel.table().borrow()),
                }
            }
        }
    }

    /// The table of an exponential sum for weights of a multistep rule, as the memory takes it.
    ///
    /// # Errors
    /// If there is no such table, or the quadrature is a Runge–Kutta family.
    pub fn exponentials(&self, engine: Engine, tables: &Tables) -> Result<SumTable, EngineError> {
        let Some(rule) = self.family.multistep()? else {
            let reason = "its weights are matrices";
            return Err(EngineError::Unsuited { engine, reason });
        };
        self.sum_table(engine, rule, tables)
    }

    fn sum_table(
        &self,
        engine: Engine,
        rule: MultistepRule,
        tables: &Tables,
    ) -> Result<SumTable, EngineError> {
        if self.transfer.table().is_some() {
            let reason = "weights do not tell the kernel K(s), whose exponentials it takes: take \"direct\", \"block-fft\" or \
                 \"real-time\"";
            return Err(EngineError::Unsuited { engine, reason });
        }
        let horizon = self.horizon()?;
        let (tolerance, reached) = (self.table_tolerance(), f64::INFINITY);
        let unknown = ExponentialKernelError::ToleranceMissed { tolerance, reached };
        let turns = |fractions: Fractions| fractions.poles.iter().any(|pole| pole.place.im != 0.0);
        if self.may_oscillate(engine) && self.transfer.fractions().is_some_and(turns) {
            return self.complex_pairs(rule, tables, unknown).map(SumTable::Pairs);
        }
        let kernel = match rule {
            MultistepRule::Bdf(order) => self.real_exponentials(order, horizon, tables),
            MultistepRule::Trapezoidal if self.may_oscillate(engine) => Err(unknown.into()),
            MultistepRule::Trapezoidal => {
                let reason = "the weights of the trapezoidal rule alternate in sign and do not fall off: take \"direct\", \
                     \"block-fft\" or \"real-time\"";
                Err(EngineError::Unsuited { engine, reason })
            }
        };
        match kernel {
            Err(EngineError::Table(missed)) if self.may_oscillate(engine) => {
                self.complex_pairs(rule, tables, missed).map(SumTable::Pairs)
            }
            other => other.map(SumTable::Real),
        }
    }

    /// The table of real exponentials.
    fn real_exponentials(
        &self,
        order: BdfOrder,
        horizon: usize,
        tables: &Tables,
    ) -> Result<Arc<ExponentialKernel>, EngineError> {
        let tolerance = self.table_tolerance();
        let on_increments = self.acts_on() != ActsOn::Values;
        let (transfer, step_size) = (self.transfer, self.step_size);
        tables.get(&self.key(horizon as u64, tolerance), || {
            Ok(ExponentialKernel::of_transfer(transfer, order, on_increments, step_size, horizon, tolerance)?)
        })
    }

    /// True if exponentials in complex pairs may take the place of real ones: where they are asked for, with
    /// a tolerance, since they are not exact to rounding, and states are not to be in single precision.
    fn may_oscillate(&self, engine: Engine) -> bool {
        let asked = (self.history.engine, self.history.tolerance.is_some(), self.history.states);
        let may = matches!(asked, (Some(Engine::ExponentialSum), true, None | Some(States::F64)));
        may && engine == Engine::ExponentialSum && !self.transfer.is_relaxation()
    }

    /// The table of exponentials in complex pairs; `missed` is why there are no real ones.
    fn complex_pairs(
        &self,
        rule: MultistepRule,
        tables: &Tables,
        missed: ExponentialKernelError,
    ) -> Result<Arc<ComplexExponentials>, EngineError> {
        let (tolerance, on_increments) = (self.table_tolerance(), self.acts_on() != ActsOn::Values);
        let reach = self
            .history
            .horizon
            .map_or_else(|| reach_of_pairs(self.planned()), |horizon| horizon.max(self.planned()));
        if reach < self.samples {
            return Err(EngineError::TableEnds { reach, samples: self.samples });
        }
        // The exact weights, and what their transform takes.
        self.room::<f64>(Engine::ExponentialSum, reach.saturating_mul(ROOM_OF_TRANSFORM))?;
        let (transfer, step_size) = (self.transfer, self.step_size);
        let table = tables.get(&self.key(reach as u64, tolerance), || {
            complex_exponentials(transfer, rule, on_increments, step_size, reach, tolerance)
                .map(|(table, _)| table)
                .map_err(EngineError::from)
        });
        match (table, missed) {
            // Of both tables the error of the better one.
            (
                Err(EngineError::Table(ExponentialKernelError::ToleranceMissed { reached, tolerance })),
                ExponentialKernelError::ToleranceMissed { reached: real, .. },
            ) => {
                let reached = reached.min(real);
                Err(EngineError::Table(ExponentialKernelError::ToleranceMissed { tolerance, reached }))
            }
            (table, _) => table,
        }
    }

    /// A memory that sums weights of s^β.
    fn power_weights<T: Engines>(
        &self,
        engine: Engine,
        order: BdfOrder,
        exponent: f64,
        tables: &Tables,
    ) -> Result<HostMemory<T>, EngineError> {
        let weights = |step_size: f64| -> Result<ConvolutionWeights, ParameterError> {
            let weights = ConvolutionWeights::bdf(order, exponent, step_size)?;
            Ok(if self.acts_on() == ActsOn::Values { weights } else { weights.on_increments() })
        };
        if engine != Engine::Direct {
            if self.samples > MOST_SHARED {
                return self.transforms(engine, weights(self.step_size)?, 1);
            }
            let shared =
                tables.get(&self.key(0, 0.0), || Ok(SharedWeights::from(weights(self.step_size)?)))?;
            return self.transforms(engine, WeightsOfMany(shared), 1);
        }
        let kept = self.kept();
        // With the step size γ_p(0) the leading weight is 1: the monic table that firmware uses, with a
        // scale.
        let table = self.kept_weights(kept, tables, || {
            let mut monic = weights(order.generating_function(0.0))?;
            let mut table = self.room(engine, kept.saturating_add(1))?;
            table.resize(kept + 1, T::zero());
            monic.fill(&mut table);
            Ok(table)
        })?;
        let scale = T::of(fvi_core::leading_bdf_weight(order, exponent, self.step_size)?);
        self.direct(table, 1, scale)
    }

    /// The weights that `make` computes for so many samples; few of them are cached.
    fn kept_weights<T: Engines>(
        &self,
        samples: usize,
        tables: &Tables,
        make: impl Fn() -> Result<Vec<T>, EngineError>,
    ) -> Result<Vec<T>, EngineError> {
        if samples > CROSSOVER {
            return make();
        }
        Ok(tables.get(&self.key(samples as u64, 0.0), make)?.to_vec())
    }

    /// A memory that sums weights of another transfer function.
    fn transfer_weights<T: Engines>(
        &self,
        engine: Engine,
        rule: MultistepRule,
        tables: &Tables,
    ) -> Result<HostMemory<T>, EngineError> {
        let samples = if engine == Engine::Direct { self.kept() } else { self.samples };
        let count = samples.saturating_add(1);
        // The weights in double precision and in that of the run.
        self.room::<f64>(engine, count.saturating_mul(2))?;
        let on_increments = self.acts_on() != ActsOn::Values;
        // Of given weights only those that meet a sample.
        let met = if self.transfer.table().is_some() { count.min(self.samples.max(1)) } else { count };
        let make = || Ok(multistep_weights(self.transfer, rule, self.step_size, on_increments, met)?);
        let weights = if met <= MOST_SHARED {
            tables.get(&self.key(met as u64, 0.0), make)?
        } else {
            Arc::new(make()?)
        };
        let mut numbers: Vec<T> = weights.iter().copied().map(T::of).collect();
        numbers.resize(count, T::zero());
        match engine {
            Engine::Direct => self.direct(numbers, 1, T::one()),
            _ => self.transforms(engine, Planes { numbers, stages: 1 }, 1),
        }
    }

    /// A memory for a kernel of R×R matrices.
    fn staged<T: Engines, const R: usize>(
        &self,
        engine: Engine,
        method: &RungeKutta<R>,
        tables: &Tables,
    ) -> Result<HostMemory<T>, EngineError> {
        if engine == Engine::AnyStep {
            if self.transfer.table().is_some() {
                let reason = "weights are for equal steps, those of their file";
                return Err(EngineError::Unsuited { engine, reason });
            }
            return self.variable_steps(method, tables);
        }
        if !self.transfer.is_relaxation()
            && matches!(engine, Engine::ExponentialSum | Engine::ExponentialSumCore)
        {
            let reason = "this kernel is not made up by decaying exponentials: take the engine \"direct\", \"block-fft\" \
                          or \"real-time\", or `convolution.family` = \"bdf\"";
            return Err(EngineError::Unsuited { engine, reason });
        }
        let count = match engine {
            Engine::Direct => self.kept().saturating_add(1),
            Engine::BlockFft | Engine::RealTime => self.samples.saturating_add(1),
            Engine::ExponentialSum | Engine::ExponentialSumCore | Engine::AnyStep => {
                self.horizon()?.saturating_add(1)
            }
        };
        let on_rises = self.acts_on() != ActsOn::Values;
        let (transfer, step_size) = (self.transfer, self.step_size);
        let weights = tables.get(&self.key(count as u64, 0.0), || {
            Ok(RungeKuttaWeights::of_transfer(method, transfer, on_rises, step_size, count)?)
        })?;
        match engine {
            Engine::ExponentialSum => return self.exponential_sum(&weights.table().borrow()),
            Engine::ExponentialSumCore => return self.core_exponential_sum(weights.table()),
            Engine::Direct | Engine::BlockFft | Engine::RealTime | Engine::AnyStep => {}
        }
        self.room::<f64>(engine, count.saturating_mul(R * R))?;
        let planes: Vec<T> = weights.planes().into_iter().map(T::of).collect();
        match engine {
            Engine::Direct => self.direct(planes, R, T::one()),
            _ => self.transforms(engine, Planes { numbers: planes, stages: R }, R),
        }
    }

    /// The memory for steps of any length.
    fn variable_steps<T: Engines, const R: usize>(
        &self,
        method: &RungeKutta<R>,
        tables: &Tables,
    ) -> Result<HostMemory<T>, EngineError> {
        let horizon = match self.end {
            Some(end) => end,
            None => self.step_size * self.horizon()? as f64,
        };
        // Single precision rounds more coarsely than that.
        let rounding = 0.01 * T::EPSILON.to_f64();
        let usual = RATE_TOLERANCE.max(rounding);
        let tolerance = self.history.rates.map_or(usual, |asked| asked.max(SMALLEST_TOLERANCE).max(rounding));
        let table = tables.get(&self.key(horizon.to_bits(), tolerance), || {
            let made =
                |tolerance| rate_table_of::<T, R>(method, self.transfer, self.step_size, horizon, tolerance);
            // Not every kernel is known to the last digits, and formulas may have lost a few more by rounding
            // at times as long as the run.
            let losses: &[f64] = if self.transfer.text().is_some() { &[1.0, 10.0, 100.0] } else { &[1.0] };
            Ok(losses.iter().fold(made(tolerance), |table, &loss| table.or_else(|_| made(loss * usual)))?)
        })?;
        let memory = VectorVariableSteps::new(method, &table.borrow(), self.coordinates)?;
        let memory = memory.acting_on(self.acts_on());
        Ok(self.host(Box::new(memory), Engine::AnyStep))
    }

    fn direct<T: Engines>(
        &self,
        weights: Vec<T>,
        stages: usize,
        scale: T,
    ) -> Result<HostMemory<T>, EngineError> {
        let channels = self.coordinates * stages;
        let rings: Vec<GrowingRing<T>> = (0..channels).map(|_| GrowingRing::new(self.kept())).collect();
        let overflow = match self.history.overflow {
            Overflow::Stop => fvi_core::Overflow::Refuse,
            Overflow::Forget => fvi_core::Overflow::Forget,
        };
        let memory = Box::new(Direct::new(weights, stages, scale, rings, overflow)?);
        Ok(self.host(memory, Engine::Direct))
    }

    fn transforms<T: Engines>(
        &self,
        engine: Engine,
        mut kernel: impl Weights<T>,
        stages: usize,
    ) -> Result<HostMemory<T>, EngineError> {
        let channels = self.coordinates * stages;
        let samples = self.samples.max(1);
        // Weights, their spectra and the samples: somewhat more than this many numbers.
        self.room::<T>(engine, samples.saturating_mul(4 * stages * stages + channels))?;
        let make = if engine == Engine::RealTime { T::real_time } else { T::block_fft };
        Ok(self.host(make(&mut kernel, channels, samples)?, engine))
    }

    fn exponential_sum<T: Engines>(
        &self,
        table: &ExponentialTable<&[f64]>,
    ) -> Result<HostMemory<T>, EngineError> {
        let memory = T::exponential_sum(table, self.coordinates * table.stages)?;
        Ok(self.host(memory, Engine::ExponentialSum))
    }

    /// An exponential sum for a scalar kernel, in the layout that suits the number of channels.
    fn exponential_sum_of_numbers<T: Engines>(
        &self,
        table: &ExponentialTable<&[f64]>,
    ) -> Result<HostMemory<T>, EngineError> {
        match self.side_by_side(&[*table]) {
            Some(memory) => Ok(self.host(memory?, Engine::ExponentialSum)),
            None => self.exponential_sum(table),
        }
    }

    /// The layout for many channels, if there are many.
    fn side_by_side<T: Engines>(
        &self,
        tables: &[ExponentialTable<&[f64]>],
    ) -> Option<Result<crate::BoxedMemory<T>, ParameterError>> {
        let (channels, threads) = (self.coordinates, self.history.threads());
        let chunk = tables.first().map_or(0, WideExponentialSum::<T>::chunk);
        match self.history.states {
            Some(States::F32) => Some(T::wide_exponential_sum_in_f32(tables, channels, threads)),
            _ if self.channels_of_one() < MANY || chunk > LONGEST_CHUNK => None,
            _ => Some(T::wide_exponential_sum(tables, channels, threads)),
        }
    }

    /// The memory of fvi-core, a sample at a time, with a table rounded as for firmware.
    fn core_exponential_sum<T: Engines>(
        &self,
        table: ExponentialTable<Aligned<T>>,
    ) -> Result<HostMemory<T>, EngineError> {
        let channels = self.coordinates * table.stages;
        let state = Aligned::zeros(table.borrow().state_len(channels));
        let memory = Box::new(Vectorised::new(ExponentialSum::new(table, T::one(), channels, state)?));
        Ok(self.host(memory, Engine::ExponentialSumCore))
    }

    fn host<T: Copy>(&self, memory: crate::BoxedMemory<T>, engine: Engine) -> HostMemory<T> {
        HostMemory::new(memory, engine, self.acts_on())
    }

    /// Key by which tables of this kernel are distinguished from others of the same type.
    fn key(&self, reach: u64, tolerance: f64) -> Vec<u64> {
        let (family, size) = match self.family {
            ConvolutionFamily::Bdf { order } => (0, order),
            ConvolutionFamily::RadauIia { stages } => (1, stages),
            ConvolutionFamily::LobattoIiic { stages } => (2, stages),
            ConvolutionFamily::Trapezoidal => (3, 2),
            ConvolutionFamily::Gauss { stages } => (4, stages),
        };
        let on_values = u64::from(self.acts_on() == ActsOn::Values);
        let numbers = [family, size as u64, on_values, self.step_size.to_bits(), reach, tolerance.to_bits()];
        numbers.into_iter().chain(self.transfer.key()).collect()
    }

    /// Number of channels of one motion.
    fn channels_of_one(&self) -> usize {
        self.coordinates / self.motions.max(1)
    }

    /// Number of samples for which engine and table are chosen.
    fn planned(&self) -> usize {
        self.history.planned.unwrap_or(self.samples)
    }

    /// Largest lag of a table of exponentials.
    fn horizon(&self) -> Result<usize, EngineError> {
        let reach = self
            .history
            .horizon
            .map_or_else(|| reach_over(self.planned()), |horizon| horizon.max(self.planned()));
        if reach < self.samples {
            Err(EngineError::TableEnds { reach, samples: self.samples })
        } else {
            Ok(reach)
        }
    }

    /// Number of samples that the direct engine keeps.
    fn kept(&self) -> usize {
        let samples = self.samples.max(1);
        self.history.capacity.map_or(samples, |capacity| capacity.min(samples))
    }

    /// An empty vector with capacity for `count` numbers.
    fn room<T>(&self, engine: Engine, count: usize) -> Result<Vec<T>, EngineError> {
        let mut room = Vec::new();
        match room.try_reserve_exact(count) {
            Ok(()) => Ok(room),
            Err(_) => Err(EngineError::NoRoom { engine, samples: self.samples }),
        }
    }
}

/// Lags of the table for a run of `samples` samples: at least twice as many, and the same for runs that are
/// not much longer, so that a run can be continued with the bits of one that was that long from the start.
/// Each factor of four costs a few exponentials.
#[doc(hidden)]
pub fn reach_over(samples: usize) -> usize {
    let mut reach: usize = 1 << 20;
    while reach / 2 < samples && reach < usize::MAX / 4 {
        reach *= 4;
    }
    reach.max(samples)
}

/// The same for exponentials in complex pairs, which are compared with every weight up to there. With lag 0
/// these are a power of two: one more, and the transform that they come from is twice as long.
fn reach_of_pairs(samples: usize) -> usize {
    let mut count: usize = 1 << 12;
    while count / 2 < samples && count < usize::MAX / 4 {
        count *= 4;
    }
    (count - 1).max(samples)
}

/// A kernel of matrices that lie plane by plane.
struct Planes<T> {
    numbers: Vec<T>,
    stages: usize,
}

impl<T: Copy> Weights<T> for Planes<T> {
    fn stages(&self) -> usize {
        self.stages
    }

    fn fill(&mut self, first: usize, weights: &mut [T]) {
        let planes = self.stages * self.stages;
        let length = self.numbers.len() / planes;
        for (index, matrix) in weights.chunks_exact_mut(planes).enumerate() {
            // The engines may request a few more weights than the run needs; those meet no sample.
            let n = (first + index).min(length - 1);
            for (plane, place) in matrix.iter_mut().enumerate() {
                *place = self.numbers[plane * length + n];
            }
        }
    }
}

/// The weights of s^β that the runs with a kernel have taken so far, as one list for all of them.
#[derive(Debug)]
struct SharedWeights(Mutex<(Vec<f64>, ConvolutionWeights)>);

impl From<ConvolutionWeights> for SharedWeights {
    fn from(weights: ConvolutionWeights) -> Self {
        Self(Mutex::new((Vec::new(), weights)))
    }
}

/// Those weights as a kernel of one run.
struct WeightsOfMany(Arc<SharedWeights>);

impl<T: Real> Weights<T> for WeightsOfMany {
    fn fill(&mut self, first: usize, weights: &mut [T]) {
        let mut shared = self.0.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (known, following) = &mut *shared;
        let missing = (first + weights.len()).saturating_sub(known.len());
        known.extend(following.take(missing));
        weights.iter_mut().zip(&known[first..]).for_each(|(weight, &known)| *weight = T::of(known));
    }
}

impl<T> Memory<T> for HostMemory<T> {
    fn channels(&self) -> usize {
        self.memory.channels()
    }

    fn stages(&self) -> usize {
        self.stages
    }

    fn kernels(&self) -> usize {
        self.memory.kernels()
    }

    fn acts_on(&self) -> ActsOn {
        self.acts_on
    }

    #[inline]
    fn leading(&self) -> &[T] {
        match &self.leading {
            Some(leading) => leading,
            None => self.memory.leading(),
        }
    }

    fn leading_is_constant(&self) -> bool {
        self.leading.is_some() || self.memory.leading_is_constant()
    }

    fn len(&self) -> usize {
        self.memory.len()
    }

    fn is_empty(&self) -> bool {
        self.is_empty
    }

    #[inline]
    fn begin_step(&mut self, length: T) -> Result<(), MemoryError> {
        // Other engines ignore the length.
        if self.engine == Engine::AnyStep { self.memory.begin_step(length) } else { Ok(()) }
    }

    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        self.memory.next_term(term)
    }

    #[inline]
    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        self.memory.push(sample)?;
        self.is_empty = false;
        Ok(())
    }

    fn clear(&mut self) {
        self.is_empty = true;
        self.memory.clear();
    }

    fn bytes(&self) -> usize {
        self.memory.bytes()
    }

    fn overruns(&self) -> Option<usize> {
        self.memory.overruns()
    }

    fn restore_channels(
        &mut self,
        from: &mut StateReader<'_>,
        channels: SavedChannels,
    ) -> Result<(), StateError> {
        self.memory.restore_channels(from, channels)?;
        self.is_empty = self.memory.is_empty();
        Ok(())
    }
}

impl<T> Stateful for HostMemory<T> {
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
        self.memory.restore(from)?;
        self.is_empty = self.memory.is_empty();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::LazyLock;

    static HALF: LazyLock<TransferFunction> = LazyLock::new(|| TransferFunction::power(0.5).unwrap());

    fn request(history: &History) -> MemoryRequest<'_> {
        MemoryRequest {
            family: ConvolutionFamily::Bdf { order: 1 },
            starting: &[],
            transfer: &HALF,
            step_size: 0.25,
            end: None,
            coordinates: 2,
            motions: 1,
            samples: 6,
            given: false,
            history,
        }
    }

    #[test]
    fn the_direct_engine_sums_the_weights_of_the_step_size() {
        let history = History::default();
        let mut memory = request(&history).build::<f64>().unwrap();
        let weights = ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 0.25).unwrap();
        let weights: Vec<f64> = weights.on_increments().take(6).collect();
        assert_eq!((memory.acts_on(), memory.leading()), (ActsOn::Increments, &[2.0][..]));
        memory.push(&[1.0, 0.0]).unwrap();
        for weight in &weights[1..] {
            let mut term = [f64::NAN; 2];
            memory.next_term(&mut term).unwrap();
            assert!((term[0] - weight).abs() < 1e-15 && term[1] == 0.0, "{term:?} {weight}");
            memory.push(&[0.0, 0.0]).unwrap();
        }
        assert_eq!(memory.next_term(&mut [0.0; 2]), Err(MemoryError::Full { capacity: 6 }));
    }

    #[test]
    fn the_number_of_samples_and_channels_chooses_the_engine() {
        let history = History::default();
        for (samples, coordinates, engine) in [
            (256, 2, Engine::Direct),
            (257, 2, Engine::BlockFft),
            (16_384, 64, Engine::BlockFft),
            (16_385, 2, Engine::ExponentialSum),
            (16_384, 65, Engine::ExponentialSum),
        ] {
            let request = MemoryRequest { samples, coordinates, ..request(&history) };
            assert_eq!(request.build::<f64>().unwrap().engine(), engine, "{samples} × {coordinates}");
        }
    }

    #[test]
    fn runs_that_are_no_longer_than_the_transforms_have_one_history() {
        let history = History::default();
        let build = |samples| MemoryRequest { samples, ..request(&history) }.build::<f64>().unwrap();
        let (mut short, mut long) = (build(1500), build(16_384));
        let (mut found, mut expected) = ([f64::NAN; 2], [f64::NAN; 2]);
        for k in 0..1500_u16 {
            short.next_term(&mut found).unwrap();
            long.next_term(&mut expected).unwrap();
            assert_eq!(found.map(f64::to_bits), expected.map(f64::to_bits), "k = {k}");
            let sample = [(0.37 * f64::from(k)).sin(), 1.0 / (1.0 + f64::from(k))];
            short.push(&sample).unwrap();
            long.push(&sample).unwrap();
        }
    }

    #[test]
    fn a_run_too_long_for_the_memory_of_the_machine_is_refused() {
        for engine in [Engine::Direct, Engine::BlockFft, Engine::RealTime] {
            let history = History { engine: Some(engine), ..History::default() };
            let mut request = request(&history);
            request.samples = usize::MAX;
            let refused = EngineError::NoRoom { engine, samples: usize::MAX };
            assert_eq!(request.build::<f64>().err(), Some(refused));
        }
    }

    #[test]
    fn tables_of_pairs_reach_twice_as_far_and_their_transform_no_farther() {
        for samples in [1, 1000, 2048, 2049, 131_072, 131_073] {
            let reach = reach_of_pairs(samples);
            assert!(reach + 1 >= 2 * samples && reach < 8 * samples.max(1024), "{samples}: {reach}");
            assert!((reach + 1).is_power_of_two(), "{samples}: {reach}");
        }
    }

    #[test]
    fn short_memory_forgets_only_when_it_is_told_to() {
        let history = History { capacity: Some(2), overflow: Overflow::Forget, ..History::default() };
        let mut memory = request(&history).build::<f64>().unwrap();
        for sample in [[1.0, 1.0], [0.0, 0.0], [0.0, 0.0]] {
            memory.push(&sample).unwrap();
        }
        let mut term = [f64::NAN; 2];
        memory.next_term(&mut term).unwrap();
        assert_eq!(term, [0.0, 0.0]);
        let history = History { overflow: Overflow::Stop, ..history };
        let mut memory = request(&history).build::<f64>().unwrap();
        memory.push(&[1.0, 1.0]).unwrap();
        memory.push(&[1.0, 1.0]).unwrap();
        assert_eq!(memory.push(&[1.0, 1.0]), Err(MemoryError::Full { capacity: 2 }));
    }

    #[test]
    fn the_cores_exponential_sum_has_the_bits_of_a_table_in_flash() {
        let history = History {
            engine: Some(Engine::ExponentialSumCore),
            tolerance: Some(1e-7),
            horizon: Some(100_000_000),
            ..History::default()
        };
        let request = MemoryRequest { samples: 600, ..request(&history) };
        let mut hosted = request.build::<f32>().unwrap();
        let order = BdfOrder::GRUNWALD_LETNIKOV;
        let kernel = ExponentialKernel::bdf_on_increments(order, 0.5, 0.25, 100_000_000, 1e-7).unwrap();
        let table = kernel.table::<f32>();
        let state = vec![0.0; table.borrow().state_len(2)];
        let mut flashed = ExponentialSum::new(table, 1.0, 2, state).unwrap();
        let (mut found, mut expected) = ([f32::NAN; 2], [f32::NAN; 2]);
        for k in 0..600u16 {
            hosted.next_term(&mut found).unwrap();
            flashed.next_term(&mut expected).unwrap();
            assert_eq!(found.map(f32::to_bits), expected.map(f32::to_bits), "k = {k}");
            let sample = [(f32::from(k) * 0.37).sin(), 1.0 - f32::from(k)];
            hosted.push(&sample).unwrap();
            flashed.push(&sample).unwrap();
        }
    }
}
