//! Weights, memories and operators: every public function, on numbers that the compiler does not know.

use fvi_core::{
    Actuator, AntiWindup, BdfOrder, Bumpless, ConvolutionWeights, DerivativeFilter, DerivativeOf, Direct,
    ExponentialSum, ExponentialTable, FixedDirect, FractionalIntegral, FractionalOperator, FractionalPid,
    Kernel, Memory, Memoryless, Overflow, PidGains, PidInputs, PidLaw, PidSettings, Quadrature, Real, Ring,
    RungeKutta, Start, StateReader, StateWriter, Stateful, Tiled, check_channels, leading_bdf_weight, left_operator,
    monic_bdf_table, monic_bdf_table_f32, right_operator,
};
use heapless::Deque;

use super::HISTORY;

/// What the caller hands in.
pub struct Unknown<'a, T> {
    /// A table of [`TABLE`](super::TABLE) numbers.
    pub table: &'a [T],
    pub samples: &'a [T],
    pub scale: T,
    pub stages: usize,
    pub channels: usize,
}

/// Everything that a memory is asked. Nothing here ends early on what the compiler knows, or it would leave
/// out the rest.
fn ask<T: Real>(mut memory: impl Memory<T>, samples: &[T]) -> Option<T> {
    let channels = memory.channels();
    let grouped = check_channels(channels, memory.stages()).is_ok();
    let mut term = [T::zero(); 8];
    let term = term.get_mut(..channels)?;
    for sample in samples.chunks(channels.max(1)) {
        memory.next_term(term).ok()?;
        memory.push(sample).ok()?;
    }
    let mut by_reference = &mut memory;
    Memory::<T>::next_term(&mut by_reference, term).ok()?;
    let mut bytes = [0; 4096];
    let mut writer = StateWriter::new(bytes.get_mut(..memory.state_bytes())?);
    let (saved, written) = (memory.save(&mut writer).is_ok(), writer.written());
    let mut reader = StateReader::new(bytes.get(channels..written)?);
    let restored = memory.restore(&mut reader).is_ok() || reader.finish().is_ok() || saved;
    memory.begin_step(term.first().copied()?).ok()?;
    let leading = memory.leading().iter().fold(T::zero(), |sum, &weight| sum + weight);
    let counts = memory.bytes()
        + memory.len()
        + usize::from(memory.is_empty())
        + usize::from(grouped)
        + usize::from(restored);
    memory.clear();
    Some(term.iter().fold(leading + T::from_count(counts as u64), |sum, &term| sum + term))
}

type Stages<T> = Deque<T, HISTORY>;

/// Direct memories: plain numbers and matrices, rings in an array and in a slice, full and short.
fn direct<T: Real>(unknown: &Unknown<'_, T>) -> Option<T> {
    let &Unknown { table, samples, scale, stages, channels } = unknown;
    let full = FixedDirect::<T, 2, HISTORY>::full_memory(table, scale).ok()?;
    let short = FixedDirect::<T, 2, HISTORY>::short_memory(table, scale).ok()?;
    let mut kept = full.capacity();
    let mut rings: [Stages<T>; 8] = [const { Deque::new() }; 8];
    let rings = rings.get_mut(..channels)?;
    let overflow = if scale > T::zero() { Overflow::Refuse } else { Overflow::Forget };
    if let Some(ring) = rings.first_mut() {
        Ring::store(ring, scale);
        let (newer, older) = Ring::as_slices(ring);
        let counts = newer.len() + older.len() + Ring::capacity(ring) + Ring::bytes(ring);
        kept += counts;
        Ring::clear(ring);
    }
    let of_stages = Direct::<T, _, _, Stages<T>>::new(table, stages, scale, rings, overflow).ok()?;
    let four: [Stages<T>; 4] = [const { Deque::new() }; 4];
    let in_an_array = Direct::new(table, stages, scale, four, overflow).ok()?;
    let kept = T::from_count(kept as u64);
    Some(
        kept + ask(full, samples)?
            + ask(short, samples)?
            + ask(of_stages, samples)?
            + ask(in_an_array, samples)?,
    )
}

fn tiled<T: Real>(unknown: &Unknown<'_, T>) -> Option<T> {
    let &Unknown { table, samples, scale, .. } = unknown;
    let one = Tiled::<T, 1, 4>::new(table, scale, Overflow::Forget).ok()?;
    let two = Tiled::<T, 2, 4>::new(table, scale, Overflow::Refuse).ok()?;
    Some(ask(one, samples)? + ask(two, samples)?)
}

/// A memory of exponentials for a table that may have any shape.
fn exponential_sum<T: Real>(unknown: &Unknown<'_, T>) -> Option<T> {
    let &Unknown { table, samples, scale, stages, channels } = unknown;
    let table = ExponentialTable {
        stages,
        head: table.get(..8)?,
        exponentials: table.get(8..24)?,
        slow_blocks: channels,
        far_blocks: stages,
        horizon: channels as u64,
        step_size: scale.to_f64(),
    };
    let ones = table.terms::<1>().fold(T::zero(), |sum, term| sum + term.decay + term.output[0]);
    let twos = table.terms::<2>().fold(ones, |sum, term| sum + term.input[0] + term.input[1]);
    let mut state = [T::zero(); 256];
    let state = state.get_mut(..table.state_len(channels))?;
    let overflow = if scale > T::zero() { Overflow::Refuse } else { Overflow::Forget };
    let memory = ExponentialSum::new(table, scale, channels, state).ok()?.past_horizon(overflow).ok()?;
    let slow = T::from_count(memory.table().borrow().slow_blocks as u64);
    Some(ask(memory, samples)? + twos + slow)
}

/// Operators on whole sequences and on streams.
fn operators<T: Real>(unknown: &Unknown<'_, T>) -> Option<T> {
    let &Unknown { table, samples, scale, channels, .. } = unknown;
    let mut output = [T::zero(); HISTORY];
    left_operator(table, samples, output.get_mut(..channels)?);
    right_operator(table, output.get(..channels)?, &mut [scale; 8]);
    right_operator(table, samples, output.get_mut(channels..)?);
    let mut sum = output.iter().fold(T::zero(), |sum, &number| sum + number);
    for start in [Start::RiemannLiouville, Start::Caputo, Start::CaputoWithRise { rise: scale }] {
        let memory = FixedDirect::<T, 1, HISTORY>::short_memory(table, scale).ok()?;
        let mut operator = FractionalOperator::new(memory, start).ok()?;
        for &sample in samples {
            sum += operator.push(sample).ok()? + operator.peek(sample).ok()?;
            sum += operator.prepare_after(scale, sample).ok()?.value();
        }
        sum += T::from_count(operator.memory().len() as u64);
        let mut bytes = [0; 1024];
        let mut writer = StateWriter::new(bytes.get_mut(..operator.state_bytes())?);
        sum += T::from_count(operator.save(&mut writer).is_ok().into());
        let mut reader = StateReader::new(bytes.get(channels..)?);
        sum += T::from_count(operator.restore(&mut reader).is_ok().into());
        operator.clear();
    }
    Some(sum)
}

/// An integral, and a memory whose scale its kernel finds.
fn integrals<T: Real>(unknown: &Unknown<'_, T>) -> Option<T> {
    let &Unknown { table, samples, scale, stages, channels } = unknown;
    let kernel = Kernel::bdf(BdfOrder::new(stages).ok()?, scale.to_f64(), scale.to_f64()).ok()?;
    let memory = kernel.short_memory::<T, 1, HISTORY>(table).ok()?;
    let mut integral = FractionalIntegral::new(&kernel, memory).ok()?;
    for &sample in samples {
        integral.push(sample).ok()?;
        integral.peek(sample).ok()?;
        integral.clamp(scale, sample).ok()?;
    }
    let mut bytes = [0; 1024];
    let mut writer = StateWriter::new(bytes.get_mut(..integral.state_bytes())?);
    integral.save(&mut writer).ok()?;
    integral.restore(&mut StateReader::new(bytes.get(channels..)?)).ok()?;
    let sum = integral.value() + integral.leading();
    integral.restart(scale).ok()?;
    integral.clear();
    let table = ExponentialTable {
        stages,
        head: table.get(..8)?,
        exponentials: table.get(8..24)?,
        slow_blocks: 0,
        far_blocks: 0,
        horizon: ExponentialTable::<()>::ENDLESS,
        step_size: scale.to_f64(),
    };
    let mut state = [T::zero(); 256];
    let memory = kernel.exponential_sum(table, channels, state.get_mut(..table.state_len(channels))?).ok()?;
    Some(sum + ask(memory, samples)?)
}

/// Controllers of both forms on memories that forget.
fn controllers<T: Real>(unknown: &Unknown<'_, T>) -> Option<T> {
    let &Unknown { table, samples, scale, stages, channels } = unknown;
    let mut sum = T::zero();
    let number = scale.to_f64();
    let parallel = PidGains::Parallel { proportional: scale, integral: scale, derivative: scale };
    let series = PidGains::Series {
        proportional: scale,
        integral_rate: scale,
        derivative_time: scale,
        filter_ratio: scale,
    };
    let windups = [AntiWindup::None, AntiWindup::BackCalculation { time: number }, AntiWindup::Conditional];
    let filters = [
        DerivativeFilter::None,
        DerivativeFilter::FirstOrder { time: number },
        DerivativeFilter::Fractional { time: number, order: number },
    ];
    let sources = [DerivativeOf::Values, DerivativeOf::ValuesFromRest, DerivativeOf::MeasuredRate];
    let law = PidLaw::new(PidSettings {
        gains: if stages == 1 { parallel } else { series },
        integral_order: number,
        derivative_order: number,
        sample: Some(number).filter(|_| channels != 1),
        setpoint_weights: [scale; 2],
        derivative_of: *sources.get(stages)?,
        derivative_filter: *filters.get(channels)?,
        limits: [-scale, scale],
        rate_limit: scale,
        anti_windup: *windups.get(stages)?,
        bumpless: if channels == 2 { Bumpless::Whole } else { Bumpless::ExceptProportional },
    })
    .ok()?;
    let memory = |kernel: Kernel| kernel.short_memory::<T, 1, HISTORY>(table).ok();
    let (integral, derivative) =
        (memory(law.integral_kernel().ok()?)?, memory(law.derivative_kernel().ok()?)?);
    let mut pid = match law.filter_kernel().ok()? {
        Some(kernel) => {
            let filter = memory(kernel)?;
            FractionalPid::with_filter(law, integral, derivative, filter).ok()?
        }
        None => FractionalPid::<T, _, _, _, FixedDirect<'_, T, 1, HISTORY>>::with_filter(
            law,
            integral,
            derivative,
            FixedDirect::short_memory(table, scale).ok()?,
        )
        .ok()?,
    };
    for &sample in samples {
        for actuator in [Actuator::Followed, Actuator::Applied(sample), Actuator::Limited] {
            let inputs =
                PidInputs { actuator, rate: sample, feed_forward: scale, ..PidInputs::new(scale, sample) };
            sum += pid.tick_with(&inputs).ok()? + pid.tick_after(scale, &inputs).ok()?;
        }
        sum += pid.tick(scale, sample).ok()? + pid.tick_applied(scale, sample, scale).ok()?;
        pid.manual(sample).ok()?;
        pid.automatic();
        pid.set_gains(PidGains::Parallel { proportional: sample, integral: scale, derivative: sample })
            .ok()?;
    }
    let response = pid.law().response(number)?;
    let mut bytes = [0; 4096];
    let mut writer = StateWriter::new(bytes.get_mut(..pid.state_bytes())?);
    pid.save(&mut writer).ok()?;
    pid.restore(&mut StateReader::new(bytes.get(channels..)?)).ok()?;
    pid.set_law(law.with_gains(series).ok()?).ok()?;
    sum += pid.output() + pid.integral() + T::of(response.setpoint.re + response.measured.im);
    pid.reset();
    let mut plain = FractionalPid::<T, _, Memoryless<T>>::without_derivative(law, Memoryless::new()).ok()?;
    Some(sum + plain.tick(scale, sum).ok()? + T::from_count(pid.is_manual().into()))
}

/// All memories and operators.
pub fn engines<T: Real>(unknown: &Unknown<'_, T>) -> Option<T> {
    Some(
        direct(unknown)?
            + tiled(unknown)?
            + exponential_sum(unknown)?
            + operators(unknown)?
            + controllers(unknown)?
            + integrals(unknown)?,
    )
}

/// Weights of an order, exponent and step size.
pub fn weights(order: BdfOrder, exponent: f64, step_size: f64) -> Option<f64> {
    let coefficients = order.coefficients().iter().sum::<f64>();
    let symbol = order.generating_function(exponent) + order.get() as f64 + coefficients;
    let leading = leading_bdf_weight(order, exponent, step_size).ok()?;
    let table: [f64; 16] = monic_bdf_table(order, exponent);
    let single: [f32; 16] = monic_bdf_table_f32(order, exponent);
    let next = ConvolutionWeights::bdf(order, exponent, step_size).ok()?.next()?;
    Some(symbol + leading + table.iter().sum::<f64>() + f64::from(single.iter().sum::<f32>()) + next)
}

/// Quadratures and Runge–Kutta methods of a number of points.
fn rules_of<const Q: usize>() -> Option<f64> {
    let sum = |rule: &Quadrature<Q>| rule.nodes().iter().chain(rule.weights()).sum::<f64>();
    let gauss = Quadrature::<Q>::gauss().ok()?;
    let lobatto = Quadrature::<Q>::lobatto().map_or(0.0, |rule| sum(&rule));
    let methods = [RungeKutta::<Q>::radau_iia(), RungeKutta::<Q>::lobatto_iiic()];
    let methods = methods
        .iter()
        .flatten()
        .map(|method| sum(method.quadrature()) + method.matrix().iter().flatten().sum::<f64>());
    Some(sum(&gauss) + lobatto + methods.sum::<f64>())
}

/// The rules of any number of points.
pub fn rules(points: usize) -> Option<f64> {
    match points {
        1 => rules_of::<1>(),
        2 => rules_of::<2>(),
        3 => rules_of::<3>(),
        4 => rules_of::<4>(),
        5 => rules_of::<5>(),
        6 => rules_of::<6>(),
        _ => rules_of::<7>(),
    }
}
