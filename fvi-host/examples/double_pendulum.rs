//! A mechanism in code, without files: a double pendulum with a fractional damper in each joint, by the trait
//! `Lagrangian` and the Gauss method of two stages; and what a step costs with and without memory.

use fvi_host::fvi_core::{
    DamperRow, Dampers, GaussLobatto, Instant, Lagrangian, MechanismIntegrator, Relaxing, Second,
};
use fvi_host::fvi_fft::exponentials::relaxation_table::relaxation_table;
use fvi_host::fvi_fft::transfer::TransferFunction;
use std::time::Instant as Clock;

const STEP: f64 = 0.01;
const STEPS: u32 = 5000;
const STAGES: usize = 2;
const START: ([f64; 2], [f64; 2]) = ([1.0, 1.6], [0.5, -1.0]);

/// Masses 1 and 0.8 kg on rods of 1 and 0.7 m, by their angles from below:
///
/// ```text
/// L = 0.9 v₀² + 0.196 v₁² + 0.56 v₀v₁ cos(q₀ − q₁) + 9.81 (1.8 cos q₀ + 0.56 cos q₁)
/// ```
struct DoublePendulum {
    /// Joints with dampers, along q₀ and q₁ − q₀; 0 or 2.
    joints: usize,
}

const GRAVITY: [f64; 2] = [9.81 * 1.8, 9.81 * 0.56];

impl Lagrangian<f64> for DoublePendulum {
    fn coordinates(&self) -> usize {
        2
    }

    fn elongations(&self) -> usize {
        self.joints
    }

    fn first(&mut self, _: Instant<f64>, q: &[f64], v: &[f64], momentum: &mut [f64], force: &mut [f64]) {
        let (sin, cos) = (q[0] - q[1]).sin_cos();
        momentum.copy_from_slice(&[1.8 * v[0] + 0.56 * cos * v[1], 0.392 * v[1] + 0.56 * cos * v[0]]);
        let turned = 0.56 * v[0] * v[1] * sin;
        force.copy_from_slice(&[-turned - GRAVITY[0] * q[0].sin(), turned - GRAVITY[1] * q[1].sin()]);
    }

    fn second(&mut self, _: Instant<f64>, q: &[f64], v: &[f64], parts: Second<'_, f64>) {
        let (sin, cos) = (q[0] - q[1]).sin_cos();
        let (across, sine) = (0.56 * cos, 0.56 * sin);
        let bent = across * v[0] * v[1];
        parts.mass.copy_from_slice(&[1.8, across, across, 0.392]);
        parts.coupling.copy_from_slice(&[-sine * v[1], sine * v[1], -sine * v[0], sine * v[0]]);
        let [down, side] = [GRAVITY[0] * q[0].cos(), GRAVITY[1] * q[1].cos()];
        parts.stiffness.copy_from_slice(&[-bent - down, bent, bent, -bent - side]);
        parts.resistance.copy_from_slice(&[-sine * v[1], -sine * v[0], sine * v[1], sine * v[0]]);
    }

    fn elongate(&mut self, _: &[f64], jacobian: &mut [f64]) {
        let rows = [1.0, 0.0, -1.0, 1.0];
        jacobian.iter_mut().zip(rows).for_each(|(place, entry)| *place = entry);
    }

    fn turn(&mut self, _: &[f64], _: &[f64], _: &[f64], turning: &mut [f64], _: &mut [f64]) {
        turning.fill(0.0);
    }

    fn energy(&mut self, q: &[f64], v: &[f64]) -> f64 {
        let moving = 0.9 * v[0] * v[0] + 0.196 * v[1] * v[1] + 0.56 * v[0] * v[1] * (q[0] - q[1]).cos();
        moving - GRAVITY[0] * q[0].cos() - GRAVITY[1] * q[1].cos()
    }
}

type Joint = Relaxing<f64, Vec<f64>, Vec<f64>>;
type Joints = DamperRow<Joint, Vec<Joint>>;
type Integrator<D> = MechanismIntegrator<f64, DoublePendulum, D, Vec<f64>, Vec<usize>>;
type Failed = Box<dyn std::error::Error>;

/// ρ D^β along one elongation.
fn joint(rule: &GaussLobatto<f64>, order: f64, rho: f64) -> Result<Joint, Failed> {
    let horizon = 100.0_f64.max(STEP * f64::from(STEPS));
    let table = relaxation_table(&TransferFunction::power(order)?, STEP, horizon, 1e-13)?;
    let numbers = vec![0.0; Joint::numbers(table.rates.len(), STAGES, 1)];
    Ok(Relaxing::new(rule, table, vec![rho], 1, numbers)?)
}

/// The pendulum at its start.
fn begin<D: Dampers<f64>>(rule: GaussLobatto<f64>, dampers: D) -> Result<Integrator<D>, Failed> {
    let shape = [2, 0, dampers.elongations()];
    let numbers = vec![0.0; Integrator::<D>::numbers(STAGES, shape)];
    let buffers = (numbers, vec![0; Integrator::<D>::unknowns(STAGES, shape)]);
    let parts = (DoublePendulum { joints: shape[2] }, dampers);
    Ok(Integrator::new(rule, parts, (STEP, 0.0), (&START.0, &START.1), false, buffers)?)
}

/// Runs to the end; returns microseconds of a step.
fn run<D: Dampers<f64>>(pendulum: &mut Integrator<D>) -> Result<f64, Failed> {
    let clock = Clock::now();
    for _ in 0..STEPS {
        pendulum.step(&[])?;
    }
    Ok(1e6 * clock.elapsed().as_secs_f64() / f64::from(STEPS))
}

fn main() -> Result<(), Failed> {
    let rule = GaussLobatto::new(STAGES)?;
    let mut free = begin(rule, ())?;
    let before = free.energy();
    let plain = run(&mut free)?;
    println!(
        "without dampers: {plain:.1} µs a step, the energy has changed by {:.0e} J",
        free.energy() - before
    );
    let joints = Joints::new(vec![joint(&rule, 0.5, 1.2)?, joint(&rule, 0.7, 0.5)?]);
    let mut damped = begin(rule, joints)?;
    let remembering = run(&mut damped)?;
    let [q0, q1] = [damped.position()[0], damped.position()[1]];
    println!("with two fractional joints: {remembering:.1} µs a step, {:.1} times", remembering / plain);
    println!("q({}) = ({q0:+.6}, {q1:+.6})", STEP * f64::from(STEPS));
    let dissipated = damped.work() - damped.stored();
    println!(
        "energy {:.4} J, {:.4} J of it stored in the joints' memories, {dissipated:.4} J dissipated",
        damped.energy() + damped.stored(),
        damped.stored()
    );
    let off = damped.energy() + damped.work() - before;
    println!("energy and the work of the joints make up the energy at the start within {:.0e} J", off.abs());
    Ok(())
}
