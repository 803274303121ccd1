//! The project's own memories in the race.

use fvi_core::{Direct, Memory, MemoryError, Overflow, ParameterError, Tiled};
use fvi_fft::{BlockFft, Engines, RealTime, WeightTable};
use fvi_memory::memory::{EngineError, HostMemory, Memories, MemoryRequest, Tables};
use fvi_scenario::numerics::exponential_table::ExponentialKernel;
use fvi_scenario::numerics::growing_ring::GrowingRing;
use fvi_scenario::scenario::{Convolution, ConvolutionFamily, Engine, History};

use crate::kernel::Source;
use crate::precision::Precision;
use crate::strategy::{AnyMemory, Declined, Made, Strategy, Task, require_short};

/// All strategies of the project.
pub(crate) fn strategies() -> Vec<Strategy> {
    vec![
        Strategy::new("direct", "plain sum in vector code, fvi-core", |task| {
            require_short(task, task.length)?;
            let made = match task.precision {
                Precision::F64 => AnyMemory::F64(direct(&task.weights, task)?),
                Precision::F32 => AnyMemory::F32(direct(&task.weights, task)?),
            };
            Ok(Made::of(made))
        }),
        Strategy::new("block-fft", "transforms in blocks, fvi-fft", |task| {
            let weights = &task.weights;
            Ok(Made::of(match task.precision {
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
            }))
        }),
        Strategy::new("real-time", "transforms whose work is spread over the steps, fvi-fft", |task| {
            let weights = &task.weights;
            Ok(Made::of(match task.precision {
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
            }))
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
            Ok(Made::of(match task.precision {
                Precision::F64 => AnyMemory::F64(tiled(&task.weights, task.length)?),
                Precision::F32 => AnyMemory::F32(tiled(&task.weights, task.length)?),
            }))
        }),
        Strategy::new("any-step", "exponentials for steps of any length, here equal ones, fvi-fft", any_step)
            .without_bound(),
    ]
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
    memory: HostMemory<f64>,
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

/// Of implicit Euler, which is Radau IIA with one stage.
fn any_step(task: &Task) -> Result<Made, Declined> {
    let Source::Transfer(transfer) = &task.kernel.source else {
        return Err(Declined::sits_out(
            "its exponentials are made from K(s), which a table of weights does not tell",
        ));
    };
    if task.kernel.order.get() != 1 {
        return Err(Declined::sits_out("it is for Runge–Kutta quadrature, of which BDF of order 1 is one"));
    }
    if task.precision == Precision::F32 {
        return Err(Declined::sits_out("in single precision its terms are right to some hundred u"));
    }
    let family = ConvolutionFamily::RadauIia { stages: 1 };
    let convolution = Convolution { family, ..Convolution::default() };
    let history = History { engine: Some(Engine::AnyStep), threads: Some(1), ..History::default() };
    let request = MemoryRequest {
        end: Some(task.length as f64 * task.kernel.step),
        convolution: &convolution,
        transfer,
        step_size: task.kernel.step,
        coordinates: task.channels,
        motions: 1,
        samples: task.length,
        given: true,
        history: &history,
    };
    let memory = f64::memory(&request, &Tables::default())
        .map_err(|error: EngineError| Declined::SitsOut(error.to_string()))?;
    Ok(Made::of(AnyMemory::F64(Box::new(EqualSteps { memory, step: task.kernel.step }))))
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

fn exponential_sum(task: &Task, engine: Engine) -> Result<Made, Declined> {
    let Source::Transfer(transfer) = &task.kernel.source else {
        return Err(Declined::sits_out(
            "exponentials are made from K(s), which a table of weights does not tell",
        ));
    };
    let tolerance = table_tolerance(task);
    let convolution = Convolution {
        family: ConvolutionFamily::Bdf { order: task.kernel.order.get() },
        ..Convolution::default()
    };
    let history =
        History { engine: Some(engine), tolerance: Some(tolerance), threads: Some(1), ..History::default() };
    let request = MemoryRequest {
        end: None,
        convolution: &convolution,
        transfer,
        step_size: task.kernel.step,
        coordinates: task.channels,
        motions: 1,
        samples: task.length,
        given: !task.kernel.on_increments,
        history: &history,
    };
    // Without such a table for the kernel the strategy does not take part.
    let sits_out = |error: EngineError| Declined::SitsOut(error.to_string());
    let made = Made::of(match task.precision {
        Precision::F64 => {
            AnyMemory::F64(Box::new(f64::memory(&request, &Tables::default()).map_err(sits_out)?))
        }
        Precision::F32 => {
            AnyMemory::F32(Box::new(f32::memory(&request, &Tables::default()).map_err(sits_out)?))
        }
    });
    Ok(made)
}

/// Mean number of floating-point operations per step of one of these strategies, over a run.
///
/// Of a sum of exponentials they are those of its recursion: a product and a sum for each weight of the head,
/// four for each exponential.
pub(crate) fn flops(strategy: &str, task: &Task) -> Option<f64> {
    let steps = task.length as f64;
    let of_one = match strategy {
        "direct" | "tiled" => steps - 1.0,
        "block-fft" => BlockFft::<f64>::operations(task.length) / steps,
        "real-time" => RealTime::<f64>::operations(task.length) / steps,
        "exponential-sum" | "exponential-sum-core" => {
            let Source::Transfer(transfer) = &task.kernel.source else { return None };
            let (order, step, tolerance) = (task.kernel.order, task.kernel.step, table_tolerance(task));
            let horizon = task.length.max(1 << 20);
            let on_increments = task.kernel.on_increments;
            let kernel =
                ExponentialKernel::of_transfer(transfer, order, on_increments, step, horizon, tolerance)
                    .ok()?;
            (2 * kernel.head().len() + 4 * kernel.exponentials().len()) as f64
        }
        _ => return None,
    };
    Some(of_one * task.channels as f64)
}

fn table_tolerance(task: &Task) -> f64 {
    match task.precision {
        Precision::F64 => task.tolerance,
        // In single precision the table should not limit the accuracy.
        Precision::F32 => task.tolerance.max(1e-9),
    }
}
