//! Forces c sign(v)|v|^γ with γ < 1, as of viscous dampers in buildings: their slope is infinite at rest, and
//! they hold what is pushed with less force than they need to move noticeably.

use fvi_core::{
    Coefficients, Collocation, Fixed, Force, Galerkin, Instant, Integrator, Mass, Quadratic, Quadrature,
    RungeKutta, Scheme, System,
};
use nalgebra::{SMatrix, SVector, matrix};

/// Three storeys with a damper in each, pushed until t = 3.
struct Dampers {
    power: f64,
    coefficient: f64,
}

/// Velocities over the dampers are B v.
const OVER: SMatrix<f64, 3, 3> = matrix![1.0, 0.0, 0.0; -1.0, 1.0, 0.0; 0.0, -1.0, 1.0];

impl Force<f64, 3> for Dampers {
    fn value(&self, instant: Instant<f64>, position: &SVector<f64, 3>) -> SVector<f64, 3> {
        self.value_in_motion(instant, position, &SVector::zeros())
    }
    fn depends_on_velocity(&self) -> bool {
        true
    }
    fn value_in_motion(
        &self,
        instant: Instant<f64>,
        _: &SVector<f64, 3>,
        velocity: &SVector<f64, 3>,
    ) -> SVector<f64, 3> {
        let push = if instant.time < 3.0 { (7.0 * instant.time).sin() } else { 0.0 };
        let held = (OVER * velocity)
            .map(|v| if v == 0.0 { 0.0 } else { self.coefficient * v.signum() * v.abs().powf(self.power) });
        SVector::from([2.0, 3.0, 4.0]) * push - OVER.transpose() * held
    }
    fn velocity_jacobian(
        &self,
        _: Instant<f64>,
        _: &SVector<f64, 3>,
        velocity: &SVector<f64, 3>,
    ) -> SMatrix<f64, 3, 3> {
        let slopes = (OVER * velocity).map(|v| {
            if v == 0.0 { 0.0 } else { self.coefficient * self.power * v.abs().powf(self.power - 1.0) }
        });
        -(OVER.transpose() * SMatrix::from_diagonal(&slopes) * OVER)
    }
}

/// Positions at t = 1 and at t = 6, after the dampers have stopped the building, and the most corrections of
/// a step.
fn run<S: Scheme<f64, Fixed<3>>>(scheme: S, h: f64, power: f64) -> ([SVector<f64, 3>; 2], u32) {
    let stiffness = OVER.transpose() * OVER * 900.0;
    let potential = Quadratic::new(Coefficients::Dense(stiffness)).unwrap();
    let force = Dampers { power, coefficient: 3.0 };
    let system = System { mass: Mass::diagonal([1.0; 3]).unwrap(), potential, force };
    let mut integrator = Integrator::builder(system, scheme, h).build().unwrap();
    let (mut seen, mut most) = ([SVector::zeros(); 2], 0);
    for step in 1..=(6.0 / h).round() as usize {
        let corrections = integrator.step(&SVector::zeros());
        most = most.max(corrections.unwrap_or_else(|error| panic!("γ = {power}, step {step}: {error}")));
        if step == (1.0 / h).round() as usize {
            seen[0] = integrator.state().position;
        }
    }
    seen[1] = integrator.state().position;
    (seen, most)
}

#[test]
fn every_scheme_passes_where_dampers_stick() {
    let h = 0.005;
    for power in [0.9, 0.5, 0.3, 0.2, 0.1, 0.05] {
        let line = run(Galerkin::low_order(0.5).unwrap(), h, power);
        let others = [
            ("degree 2", run(Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().unwrap()).unwrap(), h, power)),
            ("collocation", run(Collocation::<f64, 2>::new(&RungeKutta::radau_iia().unwrap()), h, power)),
            ("a quarter of the step", run(Galerkin::low_order(0.5).unwrap(), 0.25 * h, power)),
        ];
        println!("γ = {power}: {line:?}");
        for (name, (seen, most)) in others {
            for (own, other) in line.0.iter().zip(&seen) {
                let (error, size) = ((own - other).amax(), 0.02);
                println!("  {name}: {:.1e} of {:.1e}, {most}", error, own.amax());
                assert!(error < 0.05 * size, "γ = {power}, {name}: {error:e}");
            }
        }
    }
}
