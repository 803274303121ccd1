//! The project's own memories in the race.

use fvi_core::{Direct, Memory, MemoryError, Overflow, ParameterError, Stateful, Tiled};
use fvi_fft::GrowingRing;
use fvi_fft::memory::{Engine, History};
use fvi_fft::memory::{EngineError, Memories, MemoryRequest, SumTable, Tables};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::{BlockFft, Engines, RealTime, WeightTable};

use crate::kernel::Source;
use crate::precision::Precision;
use crate::strategy::{AnyMemory, BuiltStrategy, Declined, Strategy, Task, require_short};

/// All strategies of the project.
pub(crate) fn strategies() -> Vec<Strategy> {
    vec![
        Strategy::new("direct", "plain sum in vector code, fvi-core", |task| {
            require_short(task, task.length)?;
            let made = match task.precision {
                Precision::F64 => AnyMemory::F64(direct(&task.weights, task)?),
                Precision::F32 => AnyMemory::F32(direct(&task.weights, task)?),
            };
            Ok(BuiltStrategy::of(made).taking(of_a_plain_sum(task)))
        }),
        Strategy::new("block-fft", "transforms in blocks, fvi-fft", |task| {
            let weights = &task.weights;
            let made = BuiltStrategy::of(match task.precision {
                Precision::F64 => AnyMemory::F64(f64::block_fft(
                    &mut WeightTable::scalars(weights),
                    task.channels,
                    task.length,
                )?),
                Precision::F32 => AnyMemory::F32(f32::block_fft(
                    &mut WeightTable::scalars(&single(weights)),
                    task.channels,
                    task.length,
                )?),
            });
            Ok(made.taking(of_transforms(task, BlockFft::<f64>::operations(task.length))))
        }),
        Strategy::new("real-time", "transforms whose work is spread over the steps, fvi-fft", |task| {
            let weights = &task.weights;
            let made = BuiltStrategy::of(match task.precision {
                Precision::F64 => AnyMemory::F64(f64::real_time(
                    &mut WeightTable::scalars(weights),
                    task.channels,
                    task.length,
                )?),
                Precision::F32 => AnyMemory::F32(f32::real_time(
                    &mut WeightTable::scalars(&single(weights)),
                    task.channels,
                    task.length,
                )?),
            });
            Ok(made.taking(of_transforms(task, RealTime::<f64>::operations(task.length))))
        }),
        Strategy::new("exponential-sum", "sum of exponentials in chunks, fvi-fft", |task| {
            exponential_sum(task, Engine::ExponentialSum)
        }),
        Strategy::new("exponential-sum-core", "sum of exponentials of firmware, fvi-core", |task| {
            exponential_sum(task, Engine::ExponentialSumCore)
        }),
        Strategy::new("tiled", "plain sum of firmware, eight terms at a time, fvi-core", |task| {
            require_short(task, task.length)?;
            if task.channels > 1 {
                return Err(Declined::sits_out("its number of channels is fixed in code, here at one"));
            }
            let made = BuiltStrategy::of(match task.precision {
                Precision::F64 => AnyMemory::F64(tiled(&task.weights, task.length)?),
                Precision::F32 => AnyMemory::F32(tiled(&task.weights, task.length)?),
            });
            Ok(made.taking(of_a_plain_sum(task)))
        }),
        Strategy::new("any-step", "exponentials for steps of any length, here equal ones, fvi-fft", any_step)
            .without_bound(),
    ]
}

fn of_a_plain_sum(task: &Task) -> f64 {
    (task.length as f64 - 1.0) * task.channels as f64
}

fn of_transforms(task: &Task, of_a_channel: f64) -> f64 {
    of_a_channel / task.length as f64 * task.channels as f64
}

/// Its size is fixed in code: the smallest of these that takes the samples.
fn tiled<T: Engines>(weights: &[f64], length: usize) -> Result<Box<dyn Memory<T> + Send>, Declined> {
    fn of<T: Engines, const B: usize>(weights: &[f64]) -> Result<Box<dyn Memory<T> + Send>, Declined> {
        // Firmware has them in flash; here they stay until the program ends.
        let table: &'static [T] = weights.iter().map(|&weight| T::of(weight)).collect::<Vec<_>>().leak();
        Ok(Box::new(Tiled::<T, 1, B>::new(table, T::one(), Overflow::Refuse)?))
    }
    match length {
        ..=256 => of::<T, 32>(weights),
        257..=2048 => of::<T, 256>(weights),
        2049..=16_384 => of::<T, 2048>(weights),
        _ => Err(Declined::sits_out("its number of samples is fixed in code, here at no more than 16384")),
    }
}

/// A memory for steps of any length on steps of one.
struct EqualSteps {
    memory: fvi_fft::BoxedMemory<f64>,
    step: f64,
}

impl Memory<f64> for EqualSteps {
    fn channels(&self) -> usize {
        self.memory.channels()
    }

    fn leading(&self) -> &[f64] {
        self.memory.leading()
    }

    fn leading_is_constant(&self) -> bool {
        self.memory.leading_is_constant()
    }

    fn len(&self) -> usize {
        self.memory.len()
    }

    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        self.memory.begin_step(self.step)?;
        self.memory.next_term(term)
    }

    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        self.memory.push(sample)
    }

    fn clear(&mut self) {
        self.memory.clear();
    }

    fn bytes(&self) -> usize {
        self.memory.bytes()
    }
}

impl Stateful for EqualSteps {}

/// Of implicit Euler, which is Radau IIA with one stage.
fn any_step(task: &Task) -> Result<BuiltStrategy, Declined> {
    let family = ConvolutionFamily::RadauIia { stages: 1 };
    let parts = RequestParts::new(task, Engine::AnyStep, family, None)?;
    if task.kernel.order.get() != 1 {
        return Err(Declined::sits_out("it is for Runge–Kutta quadrature, of which BDF of order 1 is one"));
    }
    if task.precision == Precision::F32 {
        return Err(Declined::sits_out("in single precision its terms are right to some hundred u"));
    }
    let request = MemoryRequest { end: Some(task.length as f64 * task.kernel.step), ..parts.request(task) };
    let memory = engine(&request, &Tables::default())?;
    Ok(BuiltStrategy::of(AnyMemory::F64(Box::new(EqualSteps { memory, step: task.kernel.step }))))
}

/// What a request for an engine refers to.
struct RequestParts<'a> {
    transfer: &'a TransferFunction,
    family: ConvolutionFamily,
    history: History,
}

impl<'a> RequestParts<'a> {
    fn new(
        task: &'a Task,
        engine: Engine,
        family: ConvolutionFamily,
        tolerance: Option<f64>,
    ) -> Result<Self, Declined> {
        let Source::Transfer(transfer) = &task.kernel.source else {
            let reason = "exponentials are made from K(s), which a table of weights does not tell";
            return Err(Declined::sits_out(reason));
        };
        // A table for the length of the race, as those of the literature; the table of a run reaches at least
        // twice as far, so that it can be continued.
        let horizon = (engine != Engine::AnyStep).then_some(task.length);
        let engine = Some(engine);
        let history = History { engine, tolerance, horizon, threads: Some(1), ..History::default() };
        Ok(Self { transfer, family, history })
    }

    fn request(&self, task: &Task) -> MemoryRequest<'_> {
        MemoryRequest {
            end: None,
            family: self.family,
            starting: &[],
            transfer: self.transfer,
            step_size: task.kernel.step,
            coordinates: task.channels,
            motions: 1,
            samples: task.length,
            given: !task.kernel.on_increments,
            history: &self.history,
        }
    }
}

/// The engine that a run has; where there is none for the kernel the strategy does not take part.
fn engine<T: Memories>(
    request: &MemoryRequest<'_>,
    tables: &Tables,
) -> Result<fvi_fft::BoxedMemory<T>, Declined> {
    let made = T::memory(request, tables);
    Ok(made.map_err(|error: EngineError| Declined::SitsOut(error.to_string()))?.into_engine())
}

fn single(weights: &[f64]) -> Vec<f32> {
    weights.iter().map(|&weight| weight as f32).collect()
}

/// The engine `direct` as in a run, for any weights.
fn direct<T: Engines>(weights: &[f64], task: &Task) -> Result<Box<dyn Memory<T> + Send>, ParameterError> {
    let mut table: Vec<T> = weights.iter().map(|&weight| T::of(weight)).collect();
    table.push(T::zero());
    let rings: Vec<GrowingRing<T>> = (0..task.channels).map(|_| GrowingRing::new(task.length)).collect();
    Ok(Box::new(Direct::new(table, 1, T::one(), rings, Overflow::Refuse)?))
}

/// Operations are those of the recursion: two for each weight of the head, four for each exponential, eleven
/// for a complex pair.
fn exponential_sum(task: &Task, name: Engine) -> Result<BuiltStrategy, Declined> {
    let family = ConvolutionFamily::Bdf { order: task.kernel.order.get() };
    let parts = RequestParts::new(task, name, family, Some(table_tolerance(task)))?;
    let (request, tables) = (parts.request(task), Tables::default());
    let made = BuiltStrategy::of(match task.precision {
        Precision::F64 => AnyMemory::F64(engine(&request, &tables)?),
        Precision::F32 => AnyMemory::F32(engine(&request, &tables)?),
    });
    let table = request.exponentials(name, &tables);
    let (made, operations) = match table.map_err(|error| Declined::SitsOut(error.to_string()))? {
        SumTable::Real(kernel) => (made, 2 * kernel.head().len() + 4 * kernel.exponentials().len()),
        // The error of its weights is relative to the largest of them, not each to itself.
        SumTable::Pairs(pairs) => (made.without_bound(), 2 * pairs.head.len() + 11 * pairs.pairs.len()),
    };
    Ok(made.taking((operations * task.channels) as f64))
}

fn table_tolerance(task: &Task) -> f64 {
    match task.precision {
        Precision::F64 => task.tolerance,
        // In single precision the table should not limit the accuracy.
        Precision::F32 => task.tolerance.max(1e-9),
    }
}
