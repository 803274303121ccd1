//! Strategies from the literature (`fvi-rivals`) in the race.

use fvi_core::Memory;
use fvi_rivals::{
    ExponentialModes, FilterCascade, ObliviousQuadrature, Operations, PlainSum, RelaxedProduct, TextbookHls,
    jiang, kernel_compression, l1_weights, matsuda, non_uniform_partition, oustaloup, short_memory,
    uniform_partition, window_of,
};

use crate::kernel::Source;
use crate::strategy::{BuiltStrategy, Declined, Strategy, Task, require_double, require_short};

/// All strategies of `fvi-rivals`.
pub(crate) fn strategies() -> Vec<Strategy> {
    let of = |name: &str, description: &str, make: fn(&Task) -> Result<BuiltStrategy, Declined>| {
        Strategy::new(name, description, move |task: &Task| {
            require_double(task)?;
            make(task)
        })
    };
    vec![
        of("naive", "the double sum, vectorised", |task| {
            require_short(task, task.length)?;
            let memory = PlainSum::new(&task.weights, task.channels, task.length)?;
            let operations = memory.operations();
            Ok(counted(memory, operations))
        }),
        of("hls", "binary splitting of the textbook [HLS]", |task| {
            let memory = TextbookHls::new(&task.weights, task.channels, task.length)?;
            let operations = memory.operations();
            Ok(counted(memory, operations))
        }),
        of("uniform", "uniform partition [Wefers15]", |task| {
            let memory = uniform_partition(&task.weights, task.channels, task.length)?;
            let operations = memory.operations();
            Ok(counted(memory, operations))
        }),
        of("gardner", "non-uniform partition [Gardner95]", |task| {
            let memory = non_uniform_partition(&task.weights, task.channels, task.length)?;
            let operations = memory.operations();
            Ok(counted(memory, operations))
        }),
        of("relaxed", "relaxed multiplication in blocks [vdHoeven14]", |task| {
            let memory = RelaxedProduct::new(&task.weights, task.channels, task.length)?;
            let operations = memory.operations();
            Ok(counted(memory, operations))
        }),
        of("short-memory", "plain sum over a window [Podlubny]", |task| {
            require_short(task, window_of(&task.weights, task.tolerance))?;
            let memory = short_memory(&task.weights, task.channels, task.length, task.tolerance)?;
            let operations = memory.operations();
            Ok(counted(memory, operations))
        })
        .without_bound(),
        of("oustaloup", "recursive filter [Oustaloup00]", |task| filter(task, oustaloup)).without_bound(),
        of("matsuda", "continued fraction through gains [MatsudaFujii93]", |task| filter(task, matsuda))
            .without_bound(),
        of("l1", "plain sum of the L1 formula, weights of its own [OldhamSpanier74]", |task| {
            let weights = l1_weights(l1_order(task)?, task.step(), task.length)?;
            require_short(task, task.length)?;
            let memory = PlainSum::new(&weights, task.channels, task.length)?;
            let operations = memory.operations();
            Ok(counted(memory, operations).summing(weights))
        }),
        of("jiang", "L1 by a sum of exponentials [JiangZhangZhangZhang17]", |task| modes(task, jiang)),
        of("baffet-hesthaven", "L1 by kernel compression [BaffetHesthaven17], [Baffet19]", |task| {
            modes(task, kernel_compression)
        }),
        of("oblivious", "fast and oblivious quadrature [SchädleLFLubich06]", |task| {
            let Source::Transfer(transfer) = &task.kernel.source else {
                return Err(Declined::sits_out("it needs K(s) at complex s"));
            };
            if !transfer.is_relaxation() || transfer.growth() < 0.0 {
                return Err(Declined::sits_out("K(s) has singularities off the negative real axis"));
            }
            if task.kernel.order.get() != 1 {
                return Err(Declined::sits_out("it is there for implicit Euler, BDF of order 1"));
            }
            let symbol = |s| transfer.value(s);
            let (channels, length) = (task.channels, task.length);
            let memory = ObliviousQuadrature::new(
                &symbol,
                &task.weights,
                task.step(),
                channels,
                length,
                task.tolerance,
            )
            .map_err(|error| Declined::SitsOut(error.to_string()))?;
            let operations = memory.operations();
            Ok(counted(memory, operations))
        }),
    ]
}

fn counted(memory: impl Memory<f64> + Send + 'static, operations: Operations) -> BuiltStrategy {
    BuiltStrategy::memory(memory).counted(operations)
}

/// A filter approximation of s^β, for kernels of that form.
fn filter(
    task: &Task,
    make: fn(
        f64,
        fvi_core::BdfOrder,
        f64,
        usize,
        usize,
        f64,
    ) -> Result<FilterCascade, fvi_core::ParameterError>,
) -> Result<BuiltStrategy, Declined> {
    let order = task.order().filter(|&order| order > 0.0 && order < 2.0 && order != 1.0);
    let Some(order) = order else {
        return Err(Declined::sits_out("it is for kernels s^β, 0 < β < 2, β ≠ 1"));
    };
    let memory = make(order, task.kernel.order, task.step(), task.channels, task.length, task.tolerance)?;
    let operations = memory.operations();
    Ok(counted(memory, operations))
}

fn l1_order(task: &Task) -> Result<f64, Declined> {
    let order = task.order().filter(|&order| order > 0.0 && order < 1.0);
    order.ok_or_else(|| Declined::sits_out("the L1 formula is for kernels s^β, 0 < β < 1"))
}

fn modes(
    task: &Task,
    make: fn(f64, f64, usize, usize, f64) -> Result<ExponentialModes, fvi_core::ParameterError>,
) -> Result<BuiltStrategy, Declined> {
    let order = l1_order(task)?;
    let memory = make(order, task.step(), task.channels, task.length, task.tolerance)
        .map_err(|error| Declined::SitsOut(error.to_string()))?;
    let operations = memory.operations();
    Ok(counted(memory, operations).summing(l1_weights(order, task.step(), task.length)?))
}
