//! The project's own memories in the race.

use fvi_core::{Direct, Memory, Overflow, ParameterError};
use fvi_fft::{BlockFft, Engines, RealTime, WeightTable};
use fvi_memory::memory::{EngineError, Memories, MemoryRequest, Tables};
use fvi_scenario::numerics::exponential_table::ExponentialKernel;
use fvi_scenario::numerics::growing_ring::GrowingRing;
use fvi_scenario::scenario::{Convolution, ConvolutionFamily, Engine, History};

use crate::kernel::Source;
use crate::precision::Precision;
use crate::strategy::{AnyMemory, Declined, Made, Strategy, Task, require_short};

/// All of them.
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
    ]
}

fn single(weights: &[f64]) -> Vec<f32> {
    weights.iter().map(|&weight| weight as f32).collect()
}

/// As a run has it, for any weights.
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
    // A kernel without such a table is none for this strategy.
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

/// Floating-point operations of a step of one of these, on average over a run.
///
/// Of a sum of exponentials they are those of its recursion: a product and a sum for each weight of the head,
/// four for each exponential.
pub(crate) fn flops(strategy: &str, task: &Task) -> Option<f64> {
    let steps = task.length as f64;
    let of_one = match strategy {
        "direct" => steps - 1.0,
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
        // The table is not what limits single precision.
        Precision::F32 => task.tolerance.max(1e-9),
    }
}
