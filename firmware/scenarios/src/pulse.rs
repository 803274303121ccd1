//! The Bagley–Torvik plate under a pulse, with its whole history in a ring and its weights in flash.
//!
//! ```text
//! q̈ + D^{3/2} q + q = f(t) ,     f = 8 on [0, 1], 0 after ,     q(0) = q̇(0) = 0 ,     h = 0.125 ,
//! 300 steps
//! ```

use core::fmt;

use fvi_core::{
    ActsOn, BdfOrder, Coefficients, DampingTerm, Derivative, FixedDirect, Galerkin, Instant, Integrator,
    Kernel, Mass, Quadratic, Real, System, TimeForce, leading_bdf_weight, monic_increment_table,
    monic_increment_table_f32,
};
use nalgebra::SVector;

use crate::bits::Bits;
use crate::refusal::Refusal;

/// Steps of the run.
pub const STEPS: usize = 300;

/// Samples that the ring holds: one for every point of the grid.
pub const CAPACITY: usize = STEPS + 1;

const DAMPING_ORDER: f64 = 1.5;
/// Step size: a binary fraction, so that the pulse ends at the same point of the grid in either precision.
pub const STEP_SIZE: f64 = 0.125;

static WEIGHTS_F32: [f32; CAPACITY] = monic_increment_table_f32(BdfOrder::GRUNWALD_LETNIKOV, DAMPING_ORDER);
static WEIGHTS_F64: [f64; CAPACITY] = monic_increment_table(BdfOrder::GRUNWALD_LETNIKOV, DAMPING_ORDER);

/// A scalar with a table of weights in flash.
pub trait Tabulated: Bits {
    /// (w₀ + … + w_n) / w₀, n = 0 … [`STEPS`]: the memory acts on increments.
    fn weights() -> &'static [Self];
}

impl Tabulated for f32 {
    fn weights() -> &'static [Self] {
        &WEIGHTS_F32
    }
}

impl Tabulated for f64 {
    fn weights() -> &'static [Self] {
        &WEIGHTS_F64
    }
}

/// Force of the pulse. It jumps at a grid point, at which it still has the value of the pulse.
fn pulse<T: Real>(instant: Instant<T>) -> SVector<T, 1> {
    let on = instant.time <= T::one();
    SVector::from([if on { T::of(8.0) } else { T::zero() }])
}

/// Runs the scenario and writes `k q_k p_k`, k = 0 … [`STEPS`], the numbers as the hexadecimal digits of
/// their bits.
///
/// # Errors
/// What a constructor, a step or `out` refuses; with the numbers of this scenario, the first two refuse
/// nothing.
pub fn run<T: Tabulated>(out: &mut impl fmt::Write) -> Result<(), Refusal> {
    let scale = T::of(leading_bdf_weight(BdfOrder::GRUNWALD_LETNIKOV, DAMPING_ORDER, STEP_SIZE)?);
    let memory =
        FixedDirect::<T, 1, CAPACITY>::full_memory(T::weights(), scale)?.acting_on(ActsOn::Increments);
    let rho = Coefficients::Diagonal(SVector::from([T::one()]));
    let damping = DampingTerm::new(Kernel::given(DAMPING_ORDER)?, rho, Derivative::RiemannLiouville, memory)?;
    let system = System {
        mass: Mass::diagonal([T::one()])?,
        potential: Quadratic::diagonal([T::one()])?,
        force: TimeForce(pulse),
    };
    let scheme = Galerkin::low_order(T::of(0.5))?;
    let rest = SVector::from([T::zero()]);
    let mut integrator = Integrator::builder(system, scheme, T::of(STEP_SIZE))
        .damping(damping)
        .position(rest)
        .momentum(rest)
        .build()?;
    for step in 0..=STEPS {
        let state = integrator.state();
        writeln!(out, "{step} {} {}", state.position[0].hexadecimal(), state.momentum[0].hexadecimal())?;
        if step < STEPS {
            integrator.step(&rest)?;
        }
    }
    Ok(())
}

/// [`run`] in single and then in double precision, each under a heading with the scalar's name.
///
/// # Errors
/// As [`run`].
pub fn run_both(out: &mut impl fmt::Write) -> Result<(), Refusal> {
    writeln!(out, "{}", f32::NAME)?;
    run::<f32>(out)?;
    writeln!(out, "{}", f64::NAME)?;
    run::<f64>(out)
}
