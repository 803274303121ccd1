//! Controllers in a run: they sample states at grid points and supply the forces over steps.

use crate::simulation::{GridState, Precision};
use fvi_core::{
    ExponentialSum, FractionalPid, Kernel, ParameterError, PidInputs, PidLaw, Real, StateError, StateReader,
    StateWriter, Stateful,
};
use fvi_fft::Aligned;
use fvi_fft::exponentials::controller_source::ControllerTables;
use fvi_fft::exponentials::exponential_table::{
    ENDLESS, ENDLESS_REACH, ExponentialKernel, ExponentialKernelError, SMALLEST_TOLERANCE,
};
use fvi_scenario::language::InputError;
use fvi_scenario::language::Problem;
use fvi_scenario::language::expression::{Elementary, Moment};
use fvi_scenario::scenario::{Controller, SampledInput, Scenario, counts_within};
use std::collections::VecDeque;

/// The input force of a step: the force held from its beginning, and changes inside it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Drive {
    /// The force from the beginning of the step.
    pub(crate) held: Vec<f64>,
    /// The same force and the following ones inside the step, with the times from which they act; `None`
    /// unless a delay is not an integer number of steps.
    pub(crate) inside: Option<SampledInput>,
    /// The largest force on each coordinate.
    pub(crate) largest: Vec<f64>,
}

/// The controllers of a scenario, in any precision.
pub(crate) trait Control {
    /// Samples the state after the given number of steps, if a sample is due.
    ///
    /// # Errors
    /// The reason why a controller refused it.
    fn take(&mut self, step: u64, state: &GridState) -> Result<(), String>;
    /// Adds the force over the step that begins at a time after the given number of steps to `drive`, which
    /// contains the inputs of the scenario.
    fn drive(&mut self, step: u64, time: f64, drive: &mut Drive);
    /// Writes output, setpoint and measured value of each controller at its last sample.
    fn write(&self, columns: &mut [f64]);
    /// Appends the state.
    ///
    /// # Errors
    /// [`StateError`], of memories that cannot be saved.
    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), StateError>;
    /// Restores a state.
    ///
    /// # Errors
    /// [`StateError`] if the bytes are no such state.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError>;
}

/// The controllers of a scenario; `None` if it has none.
///
/// # Errors
/// If a sample time is not an integer number of steps, or a memory cannot be built.
pub(crate) fn control(
    scenario: &Scenario,
    precision: Precision,
) -> Result<Option<Box<dyn Control>>, InputError> {
    if scenario.controllers.is_empty() {
        return Ok(None);
    }
    Ok(Some(match precision {
        Precision::F64 => Box::new(Loops::<f64>::new(scenario)?),
        Precision::F32 => Box::new(Loops::<f32>::new(scenario)?),
    }))
}

/// True if outputs may begin to act inside steps.
pub(crate) fn acts_inside_steps(scenario: &Scenario) -> bool {
    let step = scenario.time.step;
    scenario.controllers.iter().any(|controller| controller.delay_in_steps(step).1 != 0.0)
}

/// The memory of a controller.
pub type Sum<T> = ExponentialSum<T, Aligned<T>, Vec<T>>;

/// A controller on exponential sums.
pub type SumPid<T> = FractionalPid<T, Sum<T>, Sum<T>, PidLaw<T>, Sum<T>>;

/// All controllers of a scenario.
struct Loops<T> {
    loops: Vec<Loop<T>>,
    step_size: f64,
    /// Position and momentum as variables of expressions.
    variables: Vec<T>,
}

/// A controller in a closed loop.
struct Loop<T> {
    controller: Controller,
    pid: SumPid<T>,
    /// Number of steps between samples.
    every: u64,
    /// Delay until the output acts: an integer number of steps, and a fraction of one.
    delay: (u64, f64),
    /// Outputs that do not act yet, with the steps in which they begin to act.
    waiting: VecDeque<(u64, T)>,
    /// The output that acts at present.
    acting: T,
    /// Output, setpoint and measured value of the last sample.
    columns: [T; 3],
}

impl<T: Elementary> Loops<T> {
    fn new(scenario: &Scenario) -> Result<Self, InputError> {
        let step_size = scenario.time.step;
        let make = |(index, controller): (usize, &Controller)| {
            let every = controller.steps_between(step_size).ok_or_else(|| {
                let allowed = format!("a multiple of the step {step_size}");
                error_at(scenario, index, &["sample"], Problem::OutOfRange { allowed })
            })?;
            let pid = pid(scenario, controller).map_err(|unusable| unusable.error(scenario, index))?;
            Ok(Loop {
                controller: controller.clone(),
                pid,
                every,
                delay: controller.delay_in_steps(step_size),
                waiting: VecDeque::new(),
                acting: T::zero(),
                columns: [T::zero(); 3],
            })
        };
        let loops = scenario.controllers.iter().enumerate().map(make).collect::<Result<_, InputError>>()?;
        Ok(Self { loops, step_size, variables: Vec::new() })
    }
}

/// Reason why a controller of a scenario cannot be built.
#[derive(Clone, Debug)]
pub struct Unusable {
    /// The keys that may be the cause, of `[controller]`, or of the scenario if they begin with the name of
    /// another table; the first one in the file is reported.
    keys: &'static [&'static str],
    reason: String,
}

impl Unusable {
    fn of(keys: &'static [&'static str], reason: impl ToString) -> Self {
        Self { keys, reason: reason.to_string() }
    }

    /// The error for a parameter of the law that is refused.
    pub fn of_parameter(error: &ParameterError) -> Self {
        Self::of(Controller::keys_of(error.parameter), error)
    }

    /// The error about the controller with this index.
    pub fn error(self, scenario: &Scenario, index: usize) -> InputError {
        error_at(scenario, index, self.keys, Problem::Unusable { reason: self.reason })
    }
}

impl From<ParameterError> for Unusable {
    fn from(error: ParameterError) -> Self {
        Self::of_parameter(&error)
    }
}

/// An error about the first of some keys that is in the file.
fn error_at(scenario: &Scenario, index: usize, keys: &[&str], problem: Problem) -> InputError {
    let of_controller = |key: &&str| match key.starts_with("history.") {
        true => vec![(*key).to_owned()],
        false => vec![format!("controller.{key}"), format!("controller[{index}].{key}")],
    };
    let paths: Vec<String> = keys.iter().flat_map(of_controller).collect();
    let paths: Vec<&str> = paths.iter().map(String::as_str).collect();
    scenario.error_at_first(&paths, problem)
}

/// A controller of a scenario in its state before the first sample.
///
/// # Errors
/// As [`tables`], and if a number is out of range in the precision.
pub fn pid<T: Real>(scenario: &Scenario, controller: &Controller) -> Result<SumPid<T>, Unusable> {
    let law = controller.law::<T>()?;
    let tables = tables(scenario, controller)?;
    let integral = memory::<T>(&law.integral_kernel()?, &tables.integral, "integral")?;
    let derivative = memory::<T>(&law.derivative_kernel()?, &tables.derivative, "derivative")?;
    let filter = match (law.filter_kernel()?, &tables.filter) {
        (Some(kernel), Some(table)) => Some(memory::<T>(&kernel, table, "filter of the derivative")?),
        _ => None,
    };
    Ok(FractionalPid::with_parts(law, integral, Some(derivative), filter)?)
}

/// The tables of a controller for a microcontroller, computed for h = 1: those of a run where `[history]` has
/// a horizon, and endless ones otherwise; `tolerance` unless `[history]` has another.
///
/// # Errors
/// As [`tables`].
pub fn tables_of_firmware(
    scenario: &Scenario,
    controller: &Controller,
    tolerance: f64,
) -> Result<ControllerTables, Unusable> {
    if scenario.history.horizon.is_some() {
        return of_horizon(scenario, controller, horizon(scenario, controller)?, tolerance);
    }
    of_horizon(scenario, controller, ENDLESS, tolerance)
}

/// The tables of a controller of a scenario, computed for h = 1.
///
/// # Errors
/// A message: its `sample` is not an integer number of steps, or a tolerance cannot be met.
pub fn tables(scenario: &Scenario, controller: &Controller) -> Result<ControllerTables, Unusable> {
    of_horizon(scenario, controller, horizon(scenario, controller)?, SMALLEST_TOLERANCE)
}

/// Number of ticks for which the tables of a run are made.
fn horizon(scenario: &Scenario, controller: &Controller) -> Result<usize, Unusable> {
    let step = scenario.time.step;
    let every = controller
        .steps_between(step)
        .ok_or_else(|| Unusable::of(&["sample"], format!("it is no multiple of {step}")))?;
    // Tables are computed for the planned run, and also used by one that is continued beyond.
    let planned = scenario.history.planned.unwrap_or(scenario.time.steps.saturating_add(1));
    let [planned, ticks] = [planned, scenario.time.steps].map(|steps| (steps as u64 / every) as usize + 2);
    let reach = match scenario.history.horizon {
        Some(horizon) => horizon.max(planned),
        None => planned.next_power_of_two().max(1 << 20),
    };
    if reach < ticks {
        let reason = format!(
            "its memory was made for {reach} samples, and {ticks} are wanted: begin anew, or with a longer `history.horizon`"
        );
        return Err(Unusable::of(&["history.horizon", "sample"], reason));
    }
    Ok(if reach as u64 > ENDLESS_REACH { ENDLESS } else { reach })
}

fn of_horizon(
    scenario: &Scenario,
    controller: &Controller,
    horizon: usize,
    tolerance: f64,
) -> Result<ControllerTables, Unusable> {
    let law = controller.law::<f64>()?;
    let tolerance = scenario.history.tolerance.unwrap_or(tolerance);
    ControllerTables::new(&law, horizon, tolerance).map_err(|error| match error {
        ExponentialKernelError::Parameter(error) => match error.parameter {
            "horizon" => Unusable::of(&["history.horizon", "sample"], error),
            "tolerance" => Unusable::of(&["history.tolerance", "sample"], error),
            _ => error.into(),
        },
        missed => Unusable::of(&["history.tolerance", "mu", "sample"], missed),
    })
}

/// The memory of a kernel with its table.
fn memory<T: Real>(kernel: &Kernel, table: &ExponentialKernel, what: &str) -> Result<Sum<T>, Unusable> {
    let table = table.table::<T>();
    let state = vec![T::zero(); table.borrow().state_len(1)];
    kernel.exponential_sum(table, 1, state).map_err(|error| {
        let reason = format!("the weights of the {what}, powers of it, leave the precision ({error})");
        Unusable::of(&["sample"], reason)
    })
}

/// Largest multiple of a quantum to which numbers are rounded.
const MOST_QUANTA: f64 = (1u64 << 52) as f64;

/// The nearest multiple of a quantum within limits, if there is a quantum; ties are rounded away from zero.
fn rounded<T: Real>(number: T, quantum: Option<f64>, limits: [f64; 2]) -> T {
    let Some(quantum) = quantum else { return number };
    let count = (number / T::of(quantum)).to_f64();
    if count.abs() < MOST_QUANTA {
        let [least, most] = counts_within(quantum, limits);
        T::of(libm::round(count).max(least).min(most) * quantum)
    } else {
        // Larger numbers of double precision are multiples already.
        number
    }
}

impl<T: Elementary> Loop<T> {
    fn take(&mut self, step: u64, time: f64, variables: &[T]) -> Result<(), String> {
        if !step.is_multiple_of(self.every) {
            return Ok(());
        }
        let Controller { measures, setpoint, feed_forward, quantise, noise, settings, .. } = &self.controller;
        let time = T::of(time);
        let noise = T::of(noise.at(step / self.every));
        let measured = measures.value(Moment::inside(time), variables) + noise;
        let measured = rounded(measured, quantise.measure, [f64::NEG_INFINITY, f64::INFINITY]);
        let wanted = setpoint.at(time);
        let mut inputs = PidInputs::new(wanted, measured);
        if let Some(feed_forward) = feed_forward {
            inputs.feed_forward = feed_forward.value(Moment::from_right(time), &[]);
        }
        let output = self.pid.tick_with(&inputs).map_err(|error| error.to_string())?;
        let output = rounded(output, quantise.output, settings.limits);
        self.waiting.push_back((step.saturating_add(self.delay.0), output));
        self.columns = [output, wanted, measured];
        Ok(())
    }
}

impl<T: Elementary> Control for Loops<T> {
    fn take(&mut self, step: u64, state: &GridState) -> Result<(), String> {
        let Self { loops, variables, .. } = self;
        if loops.iter().any(|one| step.is_multiple_of(one.every)) {
            variables.clear();
            variables.extend(state.position.iter().chain(&state.momentum).map(|&number| T::of(number)));
        }
        let several = loops.len() > 1;
        loops.iter_mut().enumerate().try_for_each(|(index, one)| {
            let which = if several { format!("controller[{index}]") } else { "controller".to_owned() };
            one.take(step, state.time, variables).map_err(|reason| format!("{which}: {reason}"))
        })
    }

    fn drive(&mut self, step: u64, time: f64, drive: &mut Drive) {
        let mut changes: Vec<(f64, usize, T)> = Vec::new();
        for (index, one) in self.loops.iter_mut().enumerate() {
            while let Some(&(begins, output)) = one.waiting.front()
                && (begins < step || (begins == step && one.delay.1 == 0.0))
            {
                one.acting = output;
                one.waiting.pop_front();
            }
            add(&one.controller, one.acting, &mut drive.held);
            if let Some(&(begins, output)) = one.waiting.front()
                && begins == step
            {
                changes.push((one.delay.1, index, output));
            }
        }
        drive.largest.clear();
        drive.largest.extend(drive.held.iter().map(|force| force.abs()));
        let Some(inside) = &mut drive.inside else { return };
        changes.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Relative to the held force, which is passed separately.
        let (mut times, mut samples) = (vec![time], vec![drive.held.clone()]);
        for (fraction, index, output) in changes {
            let one = &self.loops[index];
            let mut sample = samples.last().cloned().unwrap_or_default();
            add(&one.controller, output, &mut sample);
            add(&one.controller, -one.acting, &mut sample);
            for (largest, force) in drive.largest.iter_mut().zip(&sample) {
                *largest = largest.max(force.abs());
            }
            times.push(time + fraction * self.step_size);
            samples.push(sample);
        }
        *inside = SampledInput::of(times, samples);
    }

    fn write(&self, columns: &mut [f64]) {
        let numbers = self.loops.iter().flat_map(|one| one.columns);
        columns.iter_mut().zip(numbers).for_each(|(place, number)| *place = number.to_f64());
    }

    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), StateError> {
        for one in &self.loops {
            let begin = bytes.len();
            let numbers = 4 + one.waiting.len();
            bytes.resize(begin + 8 + 8 * one.waiting.len() + T::BYTES * numbers + one.pid.state_bytes(), 0);
            let mut writer = StateWriter::new(&mut bytes[begin..]);
            writer.count(one.waiting.len() as u64)?;
            for (begins, output) in &one.waiting {
                writer.count(*begins)?;
                writer.numbers([output])?;
            }
            writer.numbers([&one.acting])?;
            writer.numbers(&one.columns)?;
            one.pid.save(&mut writer)?;
            let written = writer.written();
            bytes.truncate(begin + written);
        }
        Ok(())
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let mut reader = StateReader::new(bytes);
        for one in &mut self.loops {
            let count = reader.count()?;
            one.waiting.clear();
            for _ in 0..count {
                let entry = (reader.count()?, reader.number()?);
                one.waiting.push_back(entry);
            }
            one.acting = reader.number()?;
            one.columns = [reader.number()?, reader.number()?, reader.number()?];
            one.pid.restore(&mut reader)?;
        }
        reader.finish()
    }
}

/// Adds the force of a controller's output.
fn add<T: Real>(controller: &Controller, output: T, forces: &mut [f64]) {
    for &(coordinate, force) in controller.drives.entries.iter() {
        if let Some(place) = forces.get_mut(coordinate as usize) {
            *place += (T::of(force) * output).to_f64();
        }
    }
}
