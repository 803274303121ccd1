//! A stage under the fractional PID controller of `firmware/loop.toml`, as `fvi run --precision f32` computes
//! it.
//!
//! ```text
//! plant        q̈ + 4 q = u ,     q(0) = q̇(0) = 0 ,     h = 1 ms
//! controller   60 (r − y) + 20 I^0.8 (r − y) − 12 D^0.6 y, filtered; every 2 ms, 1 ms late, within ±40
//! ```
//!
//! And its controller in whole numbers, on inputs of all sizes.

use core::fmt;

use fvi_core::{Galerkin, Integrator, Mass, NoForce, Quadratic, System};
use nalgebra::SVector;

use crate::bits::Bits;
use crate::refusal::Refusal;
use crate::tables::axis::new_axis;
use crate::tables::whole_axis::new_whole_axis;

/// Steps of the run.
pub const STEPS: u32 = 3000;

/// Steps between samples.
const SAMPLE: u32 = 2;

/// The first step that begins with the second setpoint.
const TURN: u32 = 801;

const STEP_SIZE: f32 = 1e-3;

/// Ticks of the controller in whole numbers, and between two that are printed.
const WHOLE_TICKS: u32 = 10_000;
const PRINTED: u32 = 1_000;

/// Runs the scenario and writes `k q_k p_k u_k`, k = 0 … [`STEPS`], the numbers as the hexadecimal digits of
/// their bits; then of the controller in whole numbers now and then the output and a hash of all so far.
///
/// # Errors
/// What a constructor, a tick, a step or `out` refuses; with the numbers of this scenario, the first three
/// refuse nothing.
pub fn run(out: &mut impl fmt::Write) -> Result<(), Refusal> {
    let mut pid = new_axis()?;
    let system =
        System { mass: Mass::diagonal([1.0f32])?, potential: Quadratic::diagonal([4.0])?, force: NoForce };
    let rest = SVector::from([0.0]);
    let mut plant = Integrator::builder(system, Galerkin::low_order(0.5)?, STEP_SIZE)
        .position(rest)
        .momentum(rest)
        .build()?;
    writeln!(out, "{}", f32::NAME)?;
    // The output acting now, and the one that will act a step later.
    let mut acting = 0.0;
    for step in 0..=STEPS {
        let (position, momentum) = (plant.state().position[0], plant.state().momentum[0]);
        let sampled = step.is_multiple_of(SAMPLE);
        if sampled {
            pid.tick(if step < TURN { 1.0 } else { -1.0 }, position)?;
        }
        writeln!(
            out,
            "{step} {} {} {}",
            position.hexadecimal(),
            momentum.hexadecimal(),
            pid.output().hexadecimal()
        )?;
        if !sampled {
            acting = pid.output();
        }
        if step < STEPS {
            plant.step(&SVector::from([acting]))?;
        }
    }
    run_whole(out)
}

/// Ticks the controller in whole numbers with inputs that jump by their size, of 2 to 32 bits.
fn run_whole(out: &mut impl fmt::Write) -> Result<(), Refusal> {
    let mut pid = new_whole_axis()?;
    let (mut state, mut hash) = (1u32, 0x811c_9dc5u32);
    let mut input = |tick: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state.cast_signed() >> (30 - tick / 100 % 31)
    };
    writeln!(out, "whole")?;
    for tick in 1..=WHOLE_TICKS {
        let output = pid.tick(input(tick), input(tick));
        hash = (hash ^ output.cast_unsigned()).wrapping_mul(0x0100_0193);
        if tick.is_multiple_of(PRINTED) {
            writeln!(out, "{tick} {output} {hash:08x}")?;
        }
    }
    Ok(())
}
