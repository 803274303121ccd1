//! Orders of convergence that the papers report, on their problems and step sizes.

use fvi_fft::sums::max_or_nan;
use std::f64::consts::PI;

use fvi_core::{
    Derivative, Derivative::RiemannLiouville, Galerkin, Instant, Mass, NoForce, Quadratic, System, TimeForce,
};
use fvi_tests::convergence::{largest_error, observed_order};
use fvi_tests::motion::{Motion, Pendulum, diagonal, integrate, term, weights};
use fvi_tests::reference;
use nalgebra::{SVector, vector};

/// q̈ + q + ρ D^β q = f on [0, h·steps], midpoint rule, Riemann–Liouville memory.
fn oscillator(
    (rho, damping_order): (f64, f64),
    bdf_order: usize,
    (position, momentum): (f64, f64),
    force: impl Fn(Instant<f64>) -> f64,
    step_size: f64,
    steps: usize,
) -> Motion<1> {
    let table = weights(bdf_order, damping_order, step_size, steps + 1);
    let system = System {
        mass: Mass::diagonal([1.0]).unwrap(),
        potential: Quadratic::diagonal([1.0]).unwrap(),
        force: TimeForce(|instant| SVector::from([force(instant)])),
    };
    let damping = term(diagonal(rho), damping_order, RiemannLiouville, &table);
    let scheme = Galerkin::low_order(0.5).unwrap();
    integrate(system, scheme, damping, step_size, (vector![position], vector![momentum]), steps).unwrap()
}

/// Position and velocity of q̈ + q + ρ q̇ = 0.
fn damped_oscillation(rho: f64, (position, velocity): (f64, f64), t: f64) -> (f64, f64) {
    let (rate, frequency) = (rho / 2.0, (1.0 - rho * rho / 4.0).sqrt());
    let (a, b) = (position, (velocity + rate * position) / frequency);
    let (sin, cos) = (frequency * t).sin_cos();
    let decay = (-rate * t).exp();
    let q = decay * (a * cos + b * sin);
    (q, decay * frequency * (b * cos - a * sin) - rate * q)
}

/// Observed order of the largest error at step sizes length/2^i, for a motion and its exact positions.
fn order_on(length: f64, levels: std::ops::RangeInclusive<u32>, error: impl Fn(f64, usize) -> f64) -> f64 {
    let (mut step_sizes, mut errors) = (vec![], vec![]);
    for level in levels {
        let steps = 2usize.pow(level);
        step_sizes.push(length / steps as f64);
        errors.push(error(length / steps as f64, steps));
    }
    observed_order(&step_sizes, &errors)
}

#[track_caller]
fn assert_orders(found: [f64; 3], expected: [f64; 3], margin: f64) {
    for (p, (found, expected)) in (1..).zip(found.iter().zip(expected)) {
        assert!((found - expected).abs() <= margin, "BDF {p}: order {found:.3} instead of {expected}");
    }
}

#[test]
fn hjo_table_1_damped_oscillator() {
    // [HJO] eq. 39: ρ = 0.2, q₀ = 0, p₀ = 1.2 on [0, 16], h = 16/2^i, i = 4…11; orders 1, 2, 2. The coarsest
    // steps are as long as a sixth of a period, so the slope over the finer half of them is what tells the
    // order.
    let orders = [1, 2, 3].map(|p| {
        order_on(16.0, 7..=11, |h, steps| {
            let motion = oscillator((0.2, 1.0), p, (0.0, 1.2), |_| 0.0, h, steps);
            let exact: Vec<f64> =
                motion.times.iter().map(|&t| damped_oscillation(0.2, (0.0, 1.2), t).0).collect();
            largest_error(&motion.first_positions(), &exact)
        })
    });
    assert_orders(orders, [1.0, 2.0, 2.0], 0.1);
}

#[test]
fn hjo_table_1_bagley_torvik_with_exact_cube() {
    // [HJO] eq. 41a: damping order ½, exact solution t³ on [0, 1], h = 2^−i, i = 1…8; orders 1, 2, 2. BDF 1
    // falls from 1.5 at the coarsest pair to 1.02 at the finest, hence the slope over the finer half.
    let force = |i: Instant<f64>| i.time.powi(3) + 6.0 * i.time + 3.2 / PI.sqrt() * i.time.powf(2.5);
    let orders = [1, 2, 3].map(|p| {
        order_on(1.0, 4..=8, |h, steps| {
            let motion = oscillator((1.0, 0.5), p, (0.0, 0.0), force, h, steps);
            let exact: Vec<f64> = motion.times.iter().map(|t| t.powi(3)).collect();
            largest_error(&motion.first_positions(), &exact)
        })
    });
    assert_orders(orders, [1.0, 2.0, 2.0], 0.1);
}

#[test]
fn hjo_table_1_bagley_torvik_with_exact_power_five_halves() {
    // [HJO] eq. 41b: damping order 3/2, exact solution t^{5/2}, h = 2^−i, i = 1…8; orders 1, 1.8, 1.8 are
    // printed. The force grows like √t, which the midpoint rule integrates over the first step only to
    // h^{3/2}.
    let force = |i: Instant<f64>| 3.75 * i.time.sqrt() + 1.875 * PI.sqrt() * i.time + i.time.powf(2.5);
    let orders = [1, 2, 3].map(|p| {
        order_on(1.0, 1..=8, |h, steps| {
            let motion = oscillator((1.0, 1.5), p, (0.0, 0.0), force, h, steps);
            let exact: Vec<f64> = motion.times.iter().map(|t| t.powf(2.5)).collect();
            largest_error(&motion.first_positions(), &exact)
        })
    });
    assert_orders(orders, [1.0, 1.8, 1.8], 0.15);
}

#[test]
fn jo_figures_5_and_6_position_momentum_and_energy() {
    // [JO] eq. 67: ρ = 0.2, q₀ = 1, p₀ = ½, Grünwald–Letnikov; order ≈ 0.94 in q, p and energy. On
    // steps longer than 1/8 the leading terms of the error still cancel in part.
    let start = (1.0, 0.5);
    let order_of = |error: &dyn Fn(&Motion<1>) -> f64| {
        order_on(16.0, 8..=11, |h, steps| error(&oscillator((0.2, 1.0), 1, start, |_| 0.0, h, steps)))
    };
    let exact = |motion: &Motion<1>, select: fn((f64, f64)) -> f64| -> Vec<f64> {
        motion.times.iter().map(|&t| select(damped_oscillation(0.2, start, t))).collect()
    };
    let position = order_of(&|motion| largest_error(&motion.first_positions(), &exact(motion, |(q, _)| q)));
    let momentum = order_of(&|motion| largest_error(&motion.first_momenta(), &exact(motion, |(_, p)| p)));
    let energy =
        order_of(&|motion| largest_error(&motion.energies, &exact(motion, |(q, p)| 0.5 * (q * q + p * p))));
    for (name, order) in [("position", position), ("momentum", momentum), ("energy", energy)] {
        assert!((order - 0.96).abs() < 0.04, "{name}: order {order:.3}");
    }
}

/// Largest error at the reference times that are grid points.
fn pulse_error(bdf_order: usize, step_size: f64) -> f64 {
    let steps = (30.0 / step_size).round() as usize;
    let pulse = |instant: Instant<f64>| if instant.time <= 1.0 { 8.0 } else { 0.0 };
    let motion = oscillator((1.0, 1.5), bdf_order, (0.0, 0.0), pulse, step_size, steps);
    let rows = reference::read("bagley_torvik_pulse.csv");
    rows.iter().fold(0.0, |largest, row| {
        let k = (row["t"] / step_size).round() as usize;
        max_or_nan(largest, (motion.positions[k][0] - row["x"]).abs())
    })
}

#[test]
fn jo_figure_7_plate_with_a_pulse() {
    // [JO] eq. 68: order ≈ 0.97 against a benchmark; here against 24 digits. The pulse ends at a grid point,
    // which costs no order: BDF 2 reaches its own.
    let step_sizes = [1.0 / 8.0, 1.0 / 16.0, 1.0 / 32.0, 1.0 / 64.0, 1.0 / 128.0];
    let first = observed_order(&step_sizes, &step_sizes.map(|h| pulse_error(1, h)));
    let second = observed_order(&step_sizes, &step_sizes.map(|h| pulse_error(2, h)));
    assert!((first - 0.97).abs() < 0.06, "BDF 1: {first:.3}");
    assert!((second - 2.0).abs() < 0.2, "BDF 2: {second:.3}");
}

#[test]
fn free_oscillations_converge_to_the_reference_solutions() {
    // q₀ = 0, p₀ = m v₀: q = m v₀ G(t); Riemann–Liouville and Caputo agree for β ≤ 1.
    let rows = reference::read("fundamental.csv");
    let mut problems = 0;
    for group in rows.chunk_by(|a, b| ["beta", "m", "rho", "c"].iter().all(|key| a[*key] == b[*key])) {
        let (beta, m, rho, c) = (group[0]["beta"], group[0]["m"], group[0]["rho"], group[0]["c"]);
        let error = |h: f64| {
            let steps = (20.0 / h).round() as usize;
            let table = weights(2, beta, h, steps + 1);
            let system = System {
                mass: Mass::diagonal([m]).unwrap(),
                potential: Quadratic::diagonal([c]).unwrap(),
                force: NoForce,
            };
            let damping = term(diagonal(rho), beta, RiemannLiouville, &table);
            let scheme = Galerkin::low_order(0.5).unwrap();
            let motion = integrate(system, scheme, damping, h, (vector![0.0], vector![m]), steps).unwrap();
            group.iter().filter(|row| row["t"] >= 1.0 && row["t"] <= 20.0).fold(0.0, |largest, row| {
                let k = (row["t"] / h).round() as usize;
                max_or_nan(largest, (motion.positions[k][0] - m * row["G"]).abs())
            })
        };
        let (coarse, fine) = (error(1.0 / 32.0), error(1.0 / 64.0));
        assert!(fine < 2e-3 && coarse / fine > 1.8, "β = {beta}, ρ = {rho}, c = {c}: {coarse:e}, {fine:e}");
        problems += 1;
    }
    assert!(problems >= 3, "only {problems} problems were read");
}

#[test]
fn a_pendulum_released_from_rest_with_caputo_memory_shows_its_order() {
    // Nonlinear, q₀ ≠ 0. Released from rest q − q₀ starts like t², whose fractional derivative BDF 2 takes
    // with order 2.
    let run = |p: usize, h: f64, steps: usize| {
        let table = weights(p, 0.5, h, steps + 1);
        let system = System {
            mass: Mass::diagonal([1.0]).unwrap(),
            potential: Pendulum { gravity: 1.0 },
            force: NoForce,
        };
        let damping = term(diagonal(0.4), 0.5, Derivative::Caputo, &table);
        let scheme = Galerkin::low_order(0.5).unwrap();
        integrate(system, scheme, damping, h, (vector![2.0], vector![0.0]), steps).unwrap().first_positions()
    };
    let length = 8.0;
    for (p, expected) in [(1, 1.0), (2, 2.0)] {
        // Richardson's difference: level against level + 1.
        let (mut step_sizes, mut errors) = (vec![], vec![]);
        for level in 5..=10 {
            let steps = 2usize.pow(level);
            let h = length / steps as f64;
            let (coarse, fine) = (run(p, h, steps), run(p, h / 2.0, 2 * steps));
            let fine: Vec<f64> = fine.into_iter().step_by(2).collect();
            step_sizes.push(h);
            errors.push(largest_error(&coarse, &fine));
        }
        let order = observed_order(&step_sizes, &errors);
        assert!((order - expected).abs() < 0.1, "BDF {p}: order {order:.3}");
    }
}
