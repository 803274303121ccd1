//! Two masses, two damping terms of different order, a scheme of order 3; rings of samples, no allocation.
//!
//! M q̈ + K q = −C D^{1/2} q − 0.1 D^{3/2} q with C = diag(0.3, 0), in Caputo's sense.

use fvi_core::nalgebra::Matrix2;
use fvi_core::{
    BdfOrder, Coefficients, DampingTerm, Derivative, Galerkin, Integrator, Kernel, Mass, NoForce,
    NodeGalerkin, Quadratic, Quadrature, System, monic_bdf_table,
};

const SAMPLES: usize = 512;
const BDF_3: BdfOrder = match BdfOrder::new(3) {
    Ok(order) => order,
    Err(_) => BdfOrder::GRUNWALD_LETNIKOV,
};
static HALF: [f64; SAMPLES] = monic_bdf_table(BDF_3, 0.5);
static THREE_HALVES: [f64; SAMPLES] = monic_bdf_table(BDF_3, 1.5);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let h = 0.02;
    let slow = Kernel::bdf(BDF_3, 0.5, h)?;
    let fast = Kernel::bdf(BDF_3, 1.5, h)?;
    // Each term has its memory: two nodes of two coordinates are four channels.
    let damping = (
        DampingTerm::new(
            slow,
            Coefficients::Diagonal([0.3, 0.0].into()),
            Derivative::Caputo,
            slow.full_memory::<f64, 4, SAMPLES>(&HALF)?,
        )?,
        DampingTerm::new(
            fast,
            Coefficients::Diagonal([0.1, 0.1].into()),
            Derivative::Caputo,
            fast.full_memory::<f64, 4, SAMPLES>(&THREE_HALVES)?,
        )?,
    );
    let system = System {
        mass: Mass::diagonal([1.0, 2.0])?,
        potential: Quadratic::new(Coefficients::Dense(Matrix2::new(3.0, -1.0, -1.0, 1.0)))?,
        force: NoForce,
    };
    // Degree 2 on two Gauss points, damped at them.
    let scheme = NodeGalerkin::new(Galerkin::<f64, 2, 2>::new(&Quadrature::gauss()?)?);
    let mut masses = Integrator::builder(system, scheme, h).damping(damping).position([1.0, 0.0]).build()?;
    for k in 1..=500 {
        masses.step(&[0.0, 0.0].into())?;
        if k % 100 == 0 {
            let state = masses.state();
            println!("t = {:4.1}: q = {:+.5} {:+.5}", f64::from(k) * h, state.position[0], state.position[1]);
        }
    }
    Ok(())
}
