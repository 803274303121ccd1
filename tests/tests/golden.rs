//! Trajectories against independent dense implementations (`tests/reference/dense_bdf.py`,
//! `dense_galerkin.py`): nonlinear and coupled systems, dense matrices, several terms, both types of
//! derivative, both ends of κ, high quadrature orders.

use fvi_core::{
    Coefficients, Damping, Derivative::Caputo, Derivative::RiemannLiouville, Fixed, Force, Galerkin, Instant,
    Mass, NoForce, NodeGalerkin, Potential, Quadrature, RungeKutta, System,
};
use fvi_fft::sums::max_or_nan;
use fvi_tests::motion::{Motion, Pendulum, diagonal, integrate, term, weights};
use fvi_tests::reference;
use fvi_tests::stages::stage_term;
use nalgebra::{SMatrix, SVector, matrix, vector};

/// Allowed distance from the golden values, relative to the largest value of a column.
const TOLERANCE: f64 = 1e-11;

/// The same for Runge–Kutta quadrature.
const STAGE_TOLERANCE: f64 = 1e-12;

fn assert_golden<const N: usize>(name: &str, motion: &Motion<N>) {
    assert_golden_to(name, motion, TOLERANCE);
}

fn assert_golden_to<const N: usize>(name: &str, motion: &Motion<N>, tolerance: f64) {
    let rows = reference::read(&format!("trajectory_{name}.csv"));
    assert_eq!(rows.len(), motion.times.len());
    for (letter, found) in [("q", &motion.positions), ("p", &motion.momenta)] {
        for i in 0..N {
            let column = format!("{letter}{i}");
            let largest = rows.iter().fold(0.0, |largest, row| max_or_nan(largest, row[&column].abs()));
            for (k, (row, found)) in rows.iter().zip(found).enumerate() {
                let error = (found[i] - row[&column]).abs();
                assert!(error <= tolerance * largest, "{name}, {column}, step {k}: off by {error:e}");
            }
        }
    }
}

#[test]
fn a_pendulum_with_caputo_memory() {
    let table = weights(2, 0.5, 0.05, 201);
    let system = System {
        mass: Mass::diagonal([1.5]).unwrap(),
        potential: Pendulum { gravity: 9.81 },
        force: NoForce,
    };
    let damping = term(diagonal(0.4), 0.5, Caputo, &table);
    let scheme = Galerkin::low_order(0.5).unwrap();
    let motion = integrate(system, scheme, damping, 0.05, (vector![2.0], vector![0.3]), 200).unwrap();
    assert_golden("pendulum", &motion);
}

struct CoupledSprings;

impl Potential<f64, 2> for CoupledSprings {
    fn value(&self, q: &SVector<f64, 2>) -> f64 {
        1.5 * q[0].powi(2) + 0.25 * q[0].powi(4) + q[1].powi(2) - (q[0] - q[1]).cos()
    }

    fn gradient(&self, q: &SVector<f64, 2>) -> SVector<f64, 2> {
        let pull = (q[0] - q[1]).sin();
        vector![3.0 * q[0] + q[0].powi(3) + pull, 2.0 * q[1] - pull]
    }

    fn hessian(&self, q: &SVector<f64, 2>) -> SMatrix<f64, 2, 2> {
        let stiffness = (q[0] - q[1]).cos();
        matrix![3.0 + 3.0 * q[0].powi(2) + stiffness, -stiffness; -stiffness, 2.0 + stiffness]
    }
}

struct DriveAndCoupling;

impl Force<f64, 2> for DriveAndCoupling {
    fn value(&self, instant: Instant<f64>, q: &SVector<f64, 2>) -> SVector<f64, 2> {
        let t = instant.time;
        vector![(2.0 * t).cos() - q[1] / 4.0, t * q[0] / 8.0]
    }

    fn jacobian(&self, instant: Instant<f64>, _: &SVector<f64, 2>) -> SMatrix<f64, 2, 2> {
        matrix![0.0, -0.25; instant.time / 8.0, 0.0]
    }
}

#[test]
fn two_coupled_coordinates_with_dense_matrices_and_two_terms() {
    let h = 0.03125;
    let (slow, fast) = (weights(3, 0.75, h, 161), weights(3, 1.5, h, 161));
    let system = System {
        mass: Mass::dense(matrix![2.0, 0.5; 0.5, 1.0]).unwrap(),
        potential: CoupledSprings,
        force: DriveAndCoupling,
    };
    let damping = (
        term(Coefficients::Dense(matrix![0.5, 0.25; 0.25, 0.5]), 0.75, RiemannLiouville, &slow),
        term(Coefficients::Diagonal(vector![0.25, 0.125]), 1.5, Caputo, &fast),
    );
    let scheme = Galerkin::low_order(0.3125).unwrap();
    let motion =
        integrate(system, scheme, damping, h, (vector![0.5, -0.25], vector![0.125, 1.0]), 160).unwrap();
    assert_golden("coupled", &motion);
}

struct HardeningSpring;

impl Potential<f64, 1> for HardeningSpring {
    fn value(&self, q: &SVector<f64, 1>) -> f64 {
        0.5 * q[0].powi(2) + 0.25 * q[0].powi(4)
    }

    fn gradient(&self, q: &SVector<f64, 1>) -> SVector<f64, 1> {
        vector![q[0] + q[0].powi(3)]
    }

    fn hessian(&self, q: &SVector<f64, 1>) -> SMatrix<f64, 1, 1> {
        matrix![1.0 + 3.0 * q[0].powi(2)]
    }
}

/// A force whose derivative is not given.
struct DriveAndSoftening;

impl Force<f64, 1> for DriveAndSoftening {
    fn value(&self, instant: Instant<f64>, q: &SVector<f64, 1>) -> SVector<f64, 1> {
        vector![(3.0 * instant.time).sin() - q[0].powi(2) / 8.0]
    }
}

fn hardening() -> System<f64, 1, HardeningSpring, DriveAndSoftening> {
    System { mass: Mass::diagonal([1.0]).unwrap(), potential: HardeningSpring, force: DriveAndSoftening }
}

#[test]
fn damping_order_near_two_with_bdf_six_and_the_potential_at_the_beginning() {
    let h = 0.015625;
    let table = weights(6, 1.875, h, 129);
    let damping = term(diagonal(0.0078125), 1.875, Caputo, &table);
    let scheme = Galerkin::low_order(1.0).unwrap();
    let motion = integrate(hardening(), scheme, damping, h, (vector![1.0], vector![-0.5]), 128).unwrap();
    assert_golden("steep_first", &motion);
}

#[test]
fn three_terms_of_order_five_quarters_zero_and_one_and_the_potential_at_the_end() {
    let h = 0.015625;
    let (steep, spring, dashpot) =
        (weights(5, 1.25, h, 129), weights(5, 0.0, h, 129), weights(5, 1.0, h, 129));
    let damping = (
        term(diagonal(0.0625), 1.25, RiemannLiouville, &steep),
        (term(diagonal(0.5), 0.0, Caputo, &spring), term(diagonal(0.25), 1.0, Caputo, &dashpot)),
    );
    let scheme = Galerkin::low_order(0.0).unwrap();
    let motion = integrate(hardening(), scheme, damping, h, (vector![1.0], vector![-0.5]), 128).unwrap();
    assert_golden("steep_last", &motion);
}

fn free_pendulum() -> System<f64, 1, Pendulum, NoForce> {
    System { mass: Mass::diagonal([1.5]).unwrap(), potential: Pendulum { gravity: 9.75 }, force: NoForce }
}

fn coupled() -> System<f64, 2, CoupledSprings, DriveAndCoupling> {
    System {
        mass: Mass::dense(matrix![2.0, 0.5; 0.5, 1.0]).unwrap(),
        potential: CoupledSprings,
        force: DriveAndCoupling,
    }
}

const COUPLED_START: (SVector<f64, 2>, SVector<f64, 2>) =
    (SVector::<f64, 2>::new(0.5, -0.25), SVector::<f64, 2>::new(0.125, 1.0));

#[test]
fn galerkin_schemes_with_memory_on_the_main_nodes() {
    // From `dense_galerkin.py`: degree 2 with two Gauss points and BDF 2; degree 6 with six and BDF 6.
    let start = (vector![2.0], vector![0.3]);
    let table = weights(2, 0.5, 0.0625, 121);
    let damping = term(diagonal(0.375), 0.5, Caputo, &table);
    let scheme = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().unwrap()).unwrap();
    let motion = integrate(free_pendulum(), scheme, damping, 0.0625, start, 120).unwrap();
    assert_golden("galerkin_pendulum", &motion);

    let table = weights(6, 1.25, 0.125, 41);
    let damping = term(diagonal(0.0078125), 1.25, RiemannLiouville, &table);
    let scheme = Galerkin::<f64, 6, 6>::new(&Quadrature::gauss().unwrap()).unwrap();
    let motion = integrate(free_pendulum(), scheme, damping, 0.125, start, 40).unwrap();
    assert_golden("galerkin_high", &motion);

    // Degree 3 with four Lobatto points and BDF 3, coupled, dense, two terms.
    let (slow, fast) = (weights(3, 0.75, 0.0625, 61), weights(3, 1.5, 0.0625, 61));
    let damping = (
        term(Coefficients::Dense(matrix![0.5, 0.25; 0.25, 0.5]), 0.75, RiemannLiouville, &slow),
        term(Coefficients::Diagonal(vector![0.25, 0.125]), 1.5, Caputo, &fast),
    );
    let scheme = Galerkin::<f64, 3, 4>::new(&Quadrature::lobatto().unwrap()).unwrap();
    let motion = integrate(coupled(), scheme, damping, 0.0625, COUPLED_START, 60).unwrap();
    assert_golden("galerkin_coupled", &motion);
}

#[test]
fn schemes_with_memory_at_the_stages() {
    let method = RungeKutta::<3>::radau_iia().unwrap();
    let damping = stage_term(&method, diagonal(0.375), 0.5, Caputo, 0.125, 60);
    let scheme = NodeGalerkin::<f64, 3, 3>::with_stages(&method).unwrap();
    let start = (vector![2.0], vector![0.3]);
    let motion = integrate(free_pendulum(), scheme, damping, 0.125, start, 60).unwrap();
    assert_golden_to("radau_pendulum", &motion, STAGE_TOLERANCE);

    let method = RungeKutta::<2>::radau_iia().unwrap();
    let scheme = NodeGalerkin::<f64, 2, 2>::with_stages(&method).unwrap();
    let motion =
        integrate(coupled(), scheme, coupled_stage_damping(&method), 0.125, COUPLED_START, 40).unwrap();
    assert_golden_to("radau_coupled", &motion, STAGE_TOLERANCE);

    let method = RungeKutta::<3>::lobatto_iiic().unwrap();
    let scheme = NodeGalerkin::<f64, 2, 3>::with_stages(&method).unwrap();
    let motion =
        integrate(coupled(), scheme, coupled_stage_damping(&method), 0.125, COUPLED_START, 40).unwrap();
    assert_golden_to("lobatto_coupled", &motion, STAGE_TOLERANCE);

    // Whole orders and one near 2, on four Lobatto stages.
    let method = RungeKutta::<4>::lobatto_iiic().unwrap();
    let stage = |rho, order| stage_term(&method, diagonal(rho), order, Caputo, 0.125, 40);
    let damping = ((stage(0.5, 1.875), stage(0.25, 1.0)), stage(0.5, 0.0));
    let scheme = NodeGalerkin::<f64, 3, 4>::with_stages(&method).unwrap();
    let motion = integrate(hardening(), scheme, damping, 0.125, (vector![1.0], vector![-0.5]), 40).unwrap();
    assert_golden_to("lobatto_steep", &motion, STAGE_TOLERANCE);
}

fn coupled_stage_damping<const R: usize>(method: &RungeKutta<R>) -> impl Damping<f64, Fixed<2>> + use<R> {
    let dense = Coefficients::Dense(matrix![0.5, 0.25; 0.25, 0.5]);
    (
        stage_term(method, dense, 0.75, RiemannLiouville, 0.125, 40),
        stage_term(method, Coefficients::Diagonal(vector![0.25, 0.125]), 1.5, Caputo, 0.125, 40),
    )
}
