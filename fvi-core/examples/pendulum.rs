//! A damped pendulum as a controller simulates it: single precision, the weights in flash, no allocation, and
//! a restart in the middle from what was saved to battery-backed memory.
//!
//! ml² φ̈ = −mgl sin φ − ρ D^{1/2} φ for m = l = 1, in Caputo's sense.

use fvi_core::nalgebra::{SMatrix, SVector};
use fvi_core::{
    BdfOrder, Coefficients, DampingTerm, Derivative, Fixed, FixedDirect, Galerkin, Integrator, Kernel, Mass,
    NoForce, Potential, StateReader, StateWriter, Stateful, System, monic_bdf_table_f32,
};

const STEP_SIZE: f32 = 0.02;

/// Samples that the memory keeps, and weights: made by the compiler, kept in flash.
const HISTORY: usize = 512;
static WEIGHTS: [f32; HISTORY] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, 0.5);

/// U = −g cos φ
struct Gravity;

impl Potential<f32, 1> for Gravity {
    fn value(&self, angle: &SVector<f32, 1>) -> f32 {
        -9.81 * libm::cosf(angle[0])
    }

    fn gradient(&self, angle: &SVector<f32, 1>) -> SVector<f32, 1> {
        [9.81 * libm::sinf(angle[0])].into()
    }

    fn hessian(&self, angle: &SVector<f32, 1>) -> SMatrix<f32, 1, 1> {
        [[9.81 * libm::cosf(angle[0])]].into()
    }
}

type Memory = FixedDirect<'static, f32, 1, HISTORY>;
type Pendulum = Integrator<
    f32,
    Fixed<1>,
    System<f32, 1, Gravity, NoForce>,
    Galerkin<f32, 1, 1>,
    DampingTerm<f32, Fixed<1>, Memory>,
>;

/// The pendulum, released at an angle of one radian.
fn pendulum() -> Result<Pendulum, Box<dyn std::error::Error>> {
    let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, STEP_SIZE.into())?;
    let rho = Coefficients::Diagonal([0.5].into());
    let damping = DampingTerm::new(kernel, rho, Derivative::Caputo, kernel.short_memory(&WEIGHTS)?)?;
    let system = System { mass: Mass::diagonal([1.0])?, potential: Gravity, force: NoForce };
    let builder = Integrator::builder(system, Galerkin::low_order(0.5)?, STEP_SIZE);
    Ok(builder.damping(damping).position([1.0]).build()?)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut running = pendulum()?;
    for _ in 0..250 {
        running.step(&[0.0].into())?;
    }
    // Power fails; the bytes stay.
    let mut kept = [0; 4096];
    let mut writer = StateWriter::new(&mut kept);
    running.save(&mut writer)?;
    let length = writer.written();
    let mut restarted = pendulum()?;
    restarted.restore(&mut StateReader::new(&kept[..length]))?;

    println!("{length} bytes carry the pendulum over the restart at t = {}", restarted.time());
    println!("    t  angle     energy    difference to a run without restart");
    for step in 1..=250 {
        running.step(&[0.0].into())?;
        restarted.step(&[0.0].into())?;
        if step % 50 == 0 {
            let angle = restarted.state().position[0];
            let difference = angle - running.state().position[0];
            println!("{:5.2}  {angle:+.5}  {:+.5}  {difference}", restarted.time(), restarted.energy());
        }
    }
    Ok(())
}
