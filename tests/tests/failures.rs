//! Errors are typed, and a failing call leaves everything as it was.

use fvi_core::{
    BdfOrder, Coefficients, DampingError, DampingTerm, Derivative::Caputo, FixedDirect, Galerkin, Integrator,
    IntegratorError, Kernel, Mass, Memory, MemoryError, Mismatch, NoForce, Potential, Quadratic, StepError,
    System,
};
use fvi_tests::motion::{diagonal, weights};
use nalgebra::{SMatrix, SVector, vector};

/// A potential that is not a number beyond |q| = 1.
#[derive(Debug)]
struct Walled;

impl Potential<f64, 1> for Walled {
    fn value(&self, q: &SVector<f64, 1>) -> f64 {
        0.5 * q[0] * q[0]
    }

    fn gradient(&self, q: &SVector<f64, 1>) -> SVector<f64, 1> {
        if q[0].abs() <= 1.0 { *q } else { vector![f64::NAN] }
    }

    fn hessian(&self, _: &SVector<f64, 1>) -> SMatrix<f64, 1, 1> {
        SMatrix::identity()
    }
}

fn spring() -> System<f64, 1, Quadratic<f64, 1>> {
    System {
        mass: Mass::diagonal([1.0]).unwrap(),
        potential: Quadratic::diagonal([1.0]).unwrap(),
        force: NoForce,
    }
}

#[test]
fn a_failed_step_can_be_tried_again_as_if_nothing_had_happened() {
    let table = weights(1, 0.5, 0.1, 101);
    let make = || {
        let memory = FixedDirect::<f64, 1, 101>::full_memory(&table, 1.0).unwrap();
        let damping = DampingTerm::new(Kernel::given(0.5).unwrap(), diagonal(0.2), Caputo, memory).unwrap();
        let system = System { mass: Mass::diagonal([1.0]).unwrap(), potential: Walled, force: NoForce };
        let scheme = Galerkin::low_order(0.5).unwrap();
        Integrator::builder(system, scheme, 0.1)
            .damping(damping)
            .position(vector![0.5])
            .momentum(vector![0.0])
            .build()
            .unwrap()
    };
    let (mut disturbed, mut undisturbed) = (make(), make());
    for k in 0..100 {
        let before = *disturbed.state();
        for (input, expected) in [
            (f64::NAN, StepError::NotFinite),
            (f64::INFINITY, StepError::NotFinite),
            (1e4, StepError::NotFinite),
        ] {
            assert_eq!(disturbed.step(&vector![input]), Err(expected), "step {k}, input {input}");
            assert_eq!(*disturbed.state(), before);
        }
        disturbed.step(&vector![0.0]).unwrap();
        undisturbed.step(&vector![0.0]).unwrap();
        assert_eq!(disturbed.state(), undisturbed.state(), "step {k}");
    }
    // The ring of 101 samples is full now, and says so as often as it is asked.
    let before = *disturbed.state();
    for _ in 0..3 {
        assert_eq!(
            disturbed.step(&vector![0.0]),
            Err(StepError::Memory(MemoryError::Full { capacity: 101 }))
        );
    }
    assert_eq!(*disturbed.state(), before);
    assert_eq!(disturbed.damping().memory().len(), 101);
}

#[test]
fn a_full_second_memory_leaves_the_first_one_alone() {
    let table = weights(1, 0.5, 0.1, 101);
    let long = FixedDirect::<f64, 1, 100>::full_memory(&table, 1.0).unwrap();
    let short = FixedDirect::<f64, 1, 3>::full_memory(&table, 1.0).unwrap();
    let first = DampingTerm::new(Kernel::given(0.5).unwrap(), diagonal(0.2), Caputo, long).unwrap();
    let second = DampingTerm::new(Kernel::given(0.5).unwrap(), diagonal(0.2), Caputo, short).unwrap();
    let system = System { mass: Mass::diagonal([1.0]).unwrap(), potential: Walled, force: NoForce };
    let scheme = Galerkin::low_order(0.5).unwrap();
    let mut integrator = Integrator::builder(system, scheme, 0.1)
        .damping((first, second))
        .position(vector![0.5])
        .momentum(vector![0.0])
        .build()
        .unwrap();
    assert!(integrator.step(&vector![0.0]).is_ok());
    assert!(integrator.step(&vector![0.0]).is_ok());
    assert_eq!(integrator.step(&vector![0.0]), Err(MemoryError::Full { capacity: 3 }.into()));
    assert_eq!(integrator.damping().0.memory().len(), 3);
    assert_eq!(integrator.state().step, 2);
}

#[test]
fn wrong_values_are_refused_at_construction() {
    let scheme = Galerkin::low_order(0.5).unwrap();
    for h in [0.0, -0.1, f64::NAN, f64::INFINITY] {
        let error = Integrator::builder(spring(), scheme, h)
            .damping(())
            .position(vector![0.0])
            .momentum(vector![0.0])
            .build()
            .unwrap_err();
        assert!(matches!(error, IntegratorError::StepSize(_)), "{h}: {error}");
    }
    let error = Integrator::builder(spring(), scheme, 0.1)
        .damping(())
        .position(vector![f64::NAN])
        .momentum(vector![0.0])
        .build()
        .unwrap_err();
    assert_eq!(error, IntegratorError::InitialState);
    for kappa in [-0.1, 1.1, f64::NAN] {
        assert_eq!(Galerkin::low_order(kappa).unwrap_err().parameter, "kappa");
    }
    for order in [-1.0, 2.0, f64::NAN] {
        assert_eq!(Kernel::given(order).unwrap_err().parameter, "exponent", "{order}");
    }
    let table = weights(1, 0.5, 0.1, 10);
    let memory = || FixedDirect::<f64, 1, 10>::full_memory(&table, 1.0).unwrap();
    // Integrals have kernels, but no damping is one.
    let integral = Kernel::given(-0.5).unwrap();
    let error = DampingTerm::new(integral, diagonal::<1>(1.0), Caputo, memory()).unwrap_err();
    assert!(matches!(error, DampingError::Order(_)), "{error}");
    let kernel = Kernel::given(0.5).unwrap();
    let negative = Coefficients::Diagonal(vector![-1.0]);
    let negative = DampingTerm::new(kernel, negative, Caputo, memory()).unwrap_err();
    assert!(matches!(negative, DampingError::Coefficients(_)));
}

#[test]
fn a_kernel_that_is_not_the_memorys_or_the_integrators_is_refused() {
    let table = weights(1, 0.5, 0.1, 10);
    let memory = || FixedDirect::<f64, 1, 10>::full_memory(&table, 1.0).unwrap();
    let term = |h: f64, exponent: f64| {
        let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, exponent, h).unwrap();
        DampingTerm::new(kernel, diagonal::<1>(0.2), Caputo, memory())
    };
    for (h, exponent) in [(0.2, 0.5), (0.1, 0.6)] {
        assert!(matches!(term(h, exponent).unwrap_err(), DampingError::Kernel(_)), "{h}, {exponent}");
    }
    let build = |h| {
        let scheme = Galerkin::low_order(0.5).unwrap();
        Integrator::builder(spring(), scheme, h).damping(term(0.1, 0.5).unwrap()).build()
    };
    assert!(build(0.1).is_ok());
    let error = build(0.05).unwrap_err();
    let mismatch = Mismatch::StepSize { kernel: 0.1, integrator: 0.05 };
    assert_eq!(error, IntegratorError::Damping(mismatch), "{error}");
}

#[test]
fn a_memory_for_another_number_of_coordinates_is_refused() {
    let table = weights(1, 0.5, 0.1, 10);
    let memory = FixedDirect::<f64, 2, 10>::full_memory(&table, 1.0).unwrap();
    let damping = DampingTerm::new(Kernel::given(0.5).unwrap(), diagonal(0.2), Caputo, memory).unwrap();
    let system = System { mass: Mass::diagonal([1.0]).unwrap(), potential: Walled, force: NoForce };
    let scheme = Galerkin::low_order(0.5).unwrap();
    let error = Integrator::builder(system, scheme, 0.1)
        .damping(damping)
        .position(vector![0.5])
        .momentum(vector![0.0])
        .build()
        .unwrap_err();
    assert!(matches!(error, IntegratorError::Damping(Mismatch::Shape { .. })), "{error}");
}
