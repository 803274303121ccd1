//! Galerkin schemes with BDF memories: orders without damping, orders of the papers with it.

use fvi_fft::sums::max_or_nan;
use std::f64::consts::PI;

use fvi_core::{
    Derivative::Caputo, Derivative::RiemannLiouville, Galerkin, Instant, Mass, NoForce, Quadratic,
    Quadrature, System, TimeForce,
};
use fvi_tests::convergence::{largest_error, observed_order};
use fvi_tests::manufactured::manufactured_errors;
use fvi_tests::motion::{Motion, Pendulum, diagonal, integrate, term, weights};
use nalgebra::{SVector, vector};

fn pendulum<const S: usize, const Q: usize>(scheme: Galerkin<f64, S, Q>, h: f64, steps: usize) -> Motion<1> {
    let system =
        System { mass: Mass::diagonal([1.0]).unwrap(), potential: Pendulum { gravity: 1.0 }, force: NoForce };
    integrate(system, scheme, (), h, (vector![2.0], vector![0.5]), steps).unwrap()
}

/// Observed order of positions and momenta of an undamped pendulum on [0, 4] with steps of 4 over `steps`,
/// against 800 steps of degree 6.
fn conservative_order<const S: usize, const Q: usize>(quadrature: &Quadrature<Q>, steps: [usize; 3]) -> f64 {
    let fine = pendulum(Galerkin::<f64, 6, 6>::new(&Quadrature::gauss().unwrap()).unwrap(), 0.005, 800);
    let errors = steps.map(|count| {
        let motion = pendulum(Galerkin::<f64, S, Q>::new(quadrature).unwrap(), 4.0 / count as f64, count);
        let every = 800 / count;
        let exact = |k: usize| (fine.positions[k * every][0], fine.momenta[k * every][0]);
        (0..=count).fold(0.0, |largest, k| {
            let ((q, p), (x, y)) = ((motion.positions[k][0], motion.momenta[k][0]), exact(k));
            max_or_nan(largest, max_or_nan((q - x).abs(), (p - y).abs()))
        })
    });
    assert!(errors[2] > 1e-13, "the errors are rounding: {errors:?}");
    observed_order(&steps.map(|count| 4.0 / count as f64), &errors)
}

#[test]
fn the_conservative_part_has_order_twice_the_degree_or_that_of_the_quadrature() {
    // min(2S, u), [HJO] §2.3; u = 2Q for Gauss and 2Q − 2 for Lobatto.
    let fine = [80, 160, 400];
    let middle = [32, 50, 80];
    let coarse = [8, 10, 16];
    let gauss = |order: f64, expected: f64| {
        assert!((order - expected).abs() < 0.25, "Gauss: order {order} instead of {expected}");
    };
    gauss(conservative_order::<1, 1>(&Quadrature::gauss().unwrap(), fine), 2.0);
    gauss(conservative_order::<1, 3>(&Quadrature::gauss().unwrap(), fine), 2.0);
    gauss(conservative_order::<2, 2>(&Quadrature::gauss().unwrap(), fine), 4.0);
    gauss(conservative_order::<2, 6>(&Quadrature::gauss().unwrap(), fine), 4.0);
    gauss(conservative_order::<3, 3>(&Quadrature::gauss().unwrap(), middle), 6.0);
    gauss(conservative_order::<4, 4>(&Quadrature::gauss().unwrap(), coarse), 8.0);
    let lobatto = |order: f64, expected: f64| {
        assert!((order - expected).abs() < 0.25, "Lobatto: order {order} instead of {expected}");
    };
    lobatto(conservative_order::<1, 2>(&Quadrature::lobatto().unwrap(), fine), 2.0);
    lobatto(conservative_order::<2, 2>(&Quadrature::lobatto().unwrap(), fine), 2.0);
    lobatto(conservative_order::<2, 3>(&Quadrature::lobatto().unwrap(), fine), 4.0);
    lobatto(conservative_order::<3, 4>(&Quadrature::lobatto().unwrap(), middle), 6.0);
}

#[test]
fn high_degrees_keep_the_energy_of_a_pendulum_to_rounding() {
    fn drift<const S: usize>() -> f64 {
        let scheme = Galerkin::<f64, S, S>::new(&Quadrature::gauss().unwrap()).unwrap();
        let motion = pendulum(scheme, 0.1, 4000);
        motion.energies.iter().fold(0.0, |largest, e| max_or_nan(largest, (e - motion.energies[0]).abs()))
    }
    let drifts = [drift::<3>(), drift::<4>(), drift::<5>(), drift::<6>()];
    assert!(drifts[0] < 1e-8 && drifts[1] < 1e-11, "{drifts:?}");
    assert!(drifts[2] < 1e-13 && drifts[3] < 1e-13, "{drifts:?}");
}

/// q̈ + q + ρ D^β q = f, degree 2 with two Gauss points, Riemann–Liouville memory.
fn oscillator(
    (rho, damping_order): (f64, f64),
    bdf_order: usize,
    momentum: f64,
    force: impl Fn(Instant<f64>) -> f64,
    length: f64,
    steps: usize,
) -> Motion<1> {
    let h = length / steps as f64;
    let table = weights(bdf_order, damping_order, h, steps + 1);
    let system = System {
        mass: Mass::diagonal([1.0]).unwrap(),
        potential: Quadratic::diagonal([1.0]).unwrap(),
        force: TimeForce(|instant| SVector::from([force(instant)])),
    };
    let damping = term(diagonal(rho), damping_order, RiemannLiouville, &table);
    let scheme = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().unwrap()).unwrap();
    integrate(system, scheme, damping, h, (vector![0.0], vector![momentum]), steps).unwrap()
}

/// Observed orders with BDF 1, 2, 3 of the largest position error at `length`/2^i.
fn orders(
    length: f64,
    levels: std::ops::RangeInclusive<u32>,
    motion: impl Fn(usize, usize) -> Motion<1>,
    exact: impl Fn(f64) -> f64,
) -> [f64; 3] {
    [1, 2, 3].map(|p| {
        let (mut step_sizes, mut errors) = (vec![], vec![]);
        for level in levels.clone() {
            let steps = 2usize.pow(level);
            let motion = motion(p, steps);
            let exact: Vec<f64> = motion.times.iter().map(|&t| exact(t)).collect();
            step_sizes.push(length / steps as f64);
            errors.push(largest_error(&motion.first_positions(), &exact));
        }
        observed_order(&step_sizes, &errors)
    })
}

#[track_caller]
fn assert_orders(found: [f64; 3], expected: [f64; 3], margin: f64) {
    for (p, (found, expected)) in (1..).zip(found.into_iter().zip(expected)) {
        assert!((found - expected).abs() <= margin, "BDF {p}: order {found:.3} instead of {expected}");
    }
}

#[test]
fn hjo_table_2() {
    // [HJO] §5.1: degree 2, two Gauss points. The memory knows the main nodes only: BDF 3 stays at order 2.
    let free = orders(
        16.0,
        7..=11,
        |p, steps| oscillator((0.2, 1.0), p, 1.2, |_| 0.0, 16.0, steps),
        |t| {
            let frequency = 0.99f64.sqrt();
            1.2 / frequency * (-0.1 * t).exp() * (frequency * t).sin()
        },
    );
    let cube = |i: Instant<f64>| i.time.powi(3) + 6.0 * i.time + 3.2 / PI.sqrt() * i.time.powf(2.5);
    let cube = orders(1.0, 1..=8, |p, n| oscillator((1.0, 0.5), p, 0.0, cube, 1.0, n), |t| t.powi(3));
    let power = |i: Instant<f64>| 3.75 * i.time.sqrt() + 1.875 * PI.sqrt() * i.time + i.time.powf(2.5);
    let power = orders(1.0, 1..=8, |p, n| oscillator((1.0, 1.5), p, 0.0, power, 1.0, n), |t| t.powf(2.5));
    assert_orders(free, [1.0, 2.0, 2.0], 0.1);
    assert_orders(cube, [1.0, 2.0, 2.0], 0.15);
    assert_orders(power, [1.0, 2.0, 2.0], 0.1);
}

/// Observed orders of position and momentum on a nonlinear motion that is smooth from the start on.
fn nonlinear_orders<const S: usize, const Q: usize>(
    scheme: Galerkin<f64, S, Q>,
    bdf_order: usize,
    damping: (f64, f64),
) -> [f64; 2] {
    let steps = [256, 512, 1024];
    let errors = steps.map(|n| {
        let table = weights(bdf_order, damping.1, 1.0 / n as f64, n + 1);
        let term = term(diagonal(damping.0), damping.1, Caputo, &table);
        manufactured_errors(scheme, term, damping, n)
    });
    let step_sizes = steps.map(|n| 1.0 / n as f64);
    [0, 1].map(|quantity| observed_order(&step_sizes, &errors.map(|error| error[quantity])))
}

#[test]
fn damping_at_the_main_nodes_has_order_two_in_position_and_one_in_momentum_on_a_nonlinear_motion() {
    // The memory acts at the ends of the steps only. Eliminating the momenta leaves the trapezoidal rule for
    // the damping: positions of order min(p, 2), whatever the degree. p_k has lost the whole h ρ D^β q at the
    // end of its step where half of it belongs to the next: momenta are of order 1. The coefficients are
    // large, so that the error of the damping stands out, but small enough for BDF 3 to be stable.
    for (coefficient, damping_order) in [(4.0, 0.3), (2.0, 0.5), (2.0, 1.0), (1.0, 1.5), (0.1, 1.9)] {
        let damping = (coefficient, damping_order);
        for p in [1, 2, 3] {
            let parabolas = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().unwrap()).unwrap();
            let found = [
                nonlinear_orders(Galerkin::low_order(0.5).unwrap(), p, damping),
                nonlinear_orders(parabolas, p, damping),
            ];
            let expected = [f64::min(p as f64, 2.0), 1.0];
            for (order, expected) in found.into_iter().flat_map(|found| found.into_iter().zip(expected)) {
                assert!(
                    (order - expected).abs() < 0.2,
                    "BDF {p}, β = {damping_order}: order {order:.3} instead of {expected}"
                );
            }
        }
    }
}
