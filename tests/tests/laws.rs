//! What the integrator keeps and what it equals: limits that pin the theory.

use fvi_core::{BdfOrder, Coefficients, Fixed, Kernel, right_operator};
use fvi_core::{
    Derivative::{Caputo, RiemannLiouville},
    ExplicitDamping, ExplicitEuler, Galerkin, ImplicitEuler, Integrator, Mass, NoForce, Potential, Quadratic,
    Scheme, Stability, System, check_stability,
};
use fvi_fft::sums::max_or_nan;
use fvi_tests::motion::{Motion, Pendulum, diagonal, integrate, term, weights};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3, matrix, vector};

fn pendulum() -> System<f64, 1, Pendulum> {
    System { mass: Mass::diagonal([1.5]).unwrap(), potential: Pendulum { gravity: 9.81 }, force: NoForce }
}

#[test]
fn half_order_damping_is_the_lagrange_dalembert_integrator_to_rounding() {
    // α = ½, Grünwald–Letnikov: [JO] Corollary 4.2, f⁻ = 0, f⁺ = −ρ (q_{k+1} − q_k), here for a nonlinear
    // potential.
    let (h, rho, steps) = (0.02, 0.7, 2000);
    let table = weights(1, 1.0, h, steps + 1);
    let scheme = Galerkin::low_order(0.5).unwrap();
    let damping = term(diagonal(rho), 1.0, RiemannLiouville, &table);
    let motion = integrate(pendulum(), scheme, damping, h, (vector![2.5], vector![0.3]), steps).unwrap();
    let (mass, gravity) = (1.5, 9.81);
    let (mut q, mut p) = (2.5, 0.3);
    for k in 1..=steps {
        // p_k = M e/h + ½ h g sin(q_k + e/2) by fixed-point iteration on e.
        let mut e = h * p / mass;
        for _ in 0..60 {
            e = h / mass * (p - 0.5 * h * gravity * f64::sin(q + 0.5 * e));
        }
        p = mass * e / h - 0.5 * h * gravity * f64::sin(q + 0.5 * e) - rho * e;
        q += e;
        let error = max_or_nan((motion.positions[k][0] - q).abs(), (motion.momenta[k][0] - p).abs());
        assert!(error < 1e-11, "step {k}: {error:e}");
    }
}

#[test]
fn the_mirror_system_runs_backwards() {
    // [JO] Proposition 4.2: y_k = x_{N−k} satisfies the discrete equation with the advanced operator, here
    // Δ₊^α Δ₊^α.
    let (h, rho, alpha, steps) = (0.05, 0.4, 0.35, 400);
    let table = weights(1, 2.0 * alpha, h, steps + 1);
    let scheme = Galerkin::low_order(0.5).unwrap();
    let damping = term(diagonal(rho), 2.0 * alpha, RiemannLiouville, &table);
    let motion = integrate(pendulum(), scheme, damping, h, (vector![0.0], vector![2.0]), steps).unwrap();
    let y: Vec<f64> = motion.first_positions().into_iter().rev().collect();
    let half = weights(1, alpha, h, steps + 1);
    let (mut once, mut twice) = (vec![0.0; steps + 1], vec![0.0; steps + 1]);
    right_operator(&half, &y, &mut once);
    right_operator(&half, &once, &mut twice);
    for k in 1..steps {
        let inertia = 1.5 * (y[k + 1] - 2.0 * y[k] + y[k - 1]) / (h * h);
        let pull = 0.5 * 9.81 * ((0.5 * (y[k] + y[k + 1])).sin() + (0.5 * (y[k] + y[k - 1])).sin());
        let residual = inertia + pull + rho * twice[k];
        assert!(residual.abs() < 1e-9, "k = {k}: {residual:e}");
    }
}

/// Linearly damped oscillator of \[JO\] eq. 67 (ρ = 0.2, q₀ = 1, p₀ = ½) to t = `end`, with BDF p.
fn oscillator<S: Scheme<f64, Fixed<1>>>(scheme: S, p: usize, h: f64, end: f64) -> Motion<1> {
    let steps = (end / h).round() as usize;
    let table = weights(p, 1.0, h, steps + 1);
    let system = System {
        mass: Mass::diagonal([1.0]).unwrap(),
        potential: Quadratic::diagonal([1.0]).unwrap(),
        force: NoForce,
    };
    let damping = term(diagonal(0.2), 1.0, Caputo, &table);
    integrate(system, scheme, damping, h, (vector![1.0], vector![0.5]), steps).unwrap()
}

fn exact_energy(t: f64) -> f64 {
    let (rate, frequency) = (0.1, 0.99f64.sqrt());
    let (a, b) = (1.0, 0.6 / frequency);
    let (sin, cos) = (frequency * t).sin_cos();
    let decay = (-rate * t).exp();
    let q = decay * (a * cos + b * sin);
    let v = decay * frequency * (b * cos - a * sin) - rate * q;
    0.5 * (q * q + v * v)
}

/// Largest |log(E/E_exact)|: how far the energy is off, as a factor that does not fade with the motion.
fn energy_drift(motion: &Motion<1>) -> f64 {
    let ratios = motion.times.iter().zip(&motion.energies).map(|(&t, e)| (e / exact_energy(t)).ln().abs());
    ratios.fold(0.0, max_or_nan)
}

#[test]
fn energy_follows_the_exact_decay_closer_than_both_euler_methods() {
    // The papers' steps: h = 0.2 against implicit, h = 0.1 against explicit Euler [JO, Fig. 6].
    let scheme = Galerkin::low_order(0.5).unwrap();
    let (coarse, fine) = (oscillator(scheme, 1, 0.2, 20.0), oscillator(scheme, 1, 0.1, 20.0));
    let implicit = oscillator(ImplicitEuler, 1, 0.2, 20.0);
    let explicit = oscillator(ExplicitEuler, 1, 0.1, 20.0);
    let drifts = [&coarse, &implicit, &fine, &explicit].map(energy_drift);
    assert!(drifts[0] < 0.15 * drifts[1], "variational {} and implicit Euler {}", drifts[0], drifts[1]);
    assert!(drifts[2] < 0.15 * drifts[3], "variational {} and explicit Euler {}", drifts[2], drifts[3]);
}

/// Drift of log(E/E_exact) in a unit of time, from averages over the periods that end at t = 40 and at
/// t = 100.
fn drift_rate<S: Scheme<f64, Fixed<1>>>(scheme: S, p: usize, h: f64) -> f64 {
    let motion = oscillator(scheme, p, h, 100.0);
    let period = (core::f64::consts::TAU / 0.99f64.sqrt() / h).round() as usize;
    let mean = |end: f64| {
        let last = (end / h).round() as usize;
        let errors =
            (last + 1 - period..=last).map(|k| (motion.energies[k] / exact_energy(motion.times[k])).ln());
        errors.sum::<f64>() / period as f64
    };
    (mean(100.0) - mean(40.0)) / 60.0
}

#[test]
fn the_rate_of_decay_is_right_to_the_order_of_the_damping() {
    // Log E/E_exact grows in proportion to time: damping that is wrong by a part of order h^p is a rate that
    // is wrong by as much.
    let scheme = Galerkin::low_order(0.5).unwrap();
    let order = |p, h: f64| (drift_rate(scheme, p, h) / drift_rate(scheme, p, 0.5 * h)).log2();
    for (p, h, expected) in [(1, 0.05, 0.91), (1, 0.025, 0.96), (2, 0.05, 2.01)] {
        let found = order(p, h);
        assert!((found - expected).abs() < 0.03, "BDF {p}, h = {h}: order {found}");
    }
    // Both Euler methods add a rate of ±h: 55 times as much as that of BDF 1.
    let rate = drift_rate(scheme, 1, 0.05).abs();
    for (name, euler) in
        [("implicit", drift_rate(ImplicitEuler, 1, 0.05)), ("explicit", drift_rate(ExplicitEuler, 1, 0.05))]
    {
        assert!(euler.abs() > 50.0 * rate, "{name} Euler {euler}, variational {rate}");
    }
}

/// Spring of hardening type between two masses: depends on the distance alone.
struct Bond;

impl Potential<f64, 2> for Bond {
    fn value(&self, q: &SVector<f64, 2>) -> f64 {
        let d = q[1] - q[0];
        2.0 * d * d + d.powi(4)
    }

    fn gradient(&self, q: &SVector<f64, 2>) -> SVector<f64, 2> {
        let d = q[1] - q[0];
        let pull = 4.0 * d + 4.0 * d.powi(3);
        vector![-pull, pull]
    }

    fn hessian(&self, q: &SVector<f64, 2>) -> SMatrix<f64, 2, 2> {
        let d = q[1] - q[0];
        let stiffness = 4.0 + 12.0 * d * d;
        matrix![stiffness, -stiffness; -stiffness, stiffness]
    }
}

#[test]
fn total_momentum_is_conserved_without_damping() {
    for kappa in [0.0, 0.3, 0.5, 1.0] {
        let system = System { mass: Mass::diagonal([1.0, 3.0]).unwrap(), potential: Bond, force: NoForce };
        let scheme = Galerkin::low_order(kappa).unwrap();
        let start = (vector![0.0, 0.8], vector![0.7, -0.2]);
        let motion = integrate(system, scheme, (), 0.05, start, 4000).unwrap();
        for (k, p) in motion.momenta.iter().enumerate() {
            assert!((p.sum() - 0.5).abs() < 1e-12, "κ = {kappa}, step {k}: {:e}", p.sum() - 0.5);
        }
    }
}

#[test]
fn the_undamped_energy_error_stays_bounded() {
    // Symplectic: the error of the first hundredth of the run is not exceeded later.
    let scheme = Galerkin::low_order(0.5).unwrap();
    let motion = integrate(pendulum(), scheme, (), 0.02, (vector![1.0], vector![0.0]), 50_000).unwrap();
    let error = |range: std::ops::Range<usize>| {
        range.map(|k| (motion.energies[k] - motion.energies[0]).abs()).fold(0.0, max_or_nan)
    };
    assert!(error(0..50_000) < 1.01 * error(0..1000));
}

#[test]
fn riemann_liouville_and_caputo_agree_when_the_motion_starts_at_zero() {
    let table = weights(2, 0.6, 0.05, 401);
    let run = |derivative| {
        let damping = term(diagonal(0.5), 0.6, derivative, &table);
        let scheme = Galerkin::low_order(0.5).unwrap();
        integrate(pendulum(), scheme, damping, 0.05, (vector![0.0], vector![1.0]), 400)
            .unwrap()
            .first_positions()
    };
    assert_eq!(run(RiemannLiouville), run(Caputo));
}

#[test]
fn single_precision_agrees_with_double_precision() {
    use fvi_core::{ConvolutionWeights, DampingTerm, FixedDirect};
    let (h, steps) = (0.05, 400);
    let table = weights(1, 0.5, h, steps + 1);
    let scheme = Galerkin::low_order(0.5).unwrap();
    let system = System {
        mass: Mass::diagonal([1.0]).unwrap(),
        potential: Quadratic::diagonal([1.0]).unwrap(),
        force: NoForce,
    };
    let damping = term(diagonal(0.3), 0.5, Caputo, &table);
    let double = integrate(system, scheme, damping, h, (vector![1.0], vector![0.0]), steps).unwrap();
    let mut single_table = vec![0f32; steps + 1];
    ConvolutionWeights::bdf(BdfOrder::new(1).unwrap(), 0.5, h).unwrap().fill(&mut single_table);
    let memory = FixedDirect::<f32, 1, 512>::full_memory(&single_table, 1.0).unwrap();
    let damping =
        DampingTerm::new(Kernel::given(0.5).unwrap(), Coefficients::Diagonal([0.3].into()), Caputo, memory)
            .unwrap();
    let system = System {
        mass: Mass::diagonal([1f32]).unwrap(),
        potential: Quadratic::diagonal([1.0]).unwrap(),
        force: NoForce,
    };
    let scheme = Galerkin::low_order(0.5f32).unwrap();
    let mut single = Integrator::builder(system, scheme, h as f32)
        .damping(damping)
        .position([1.0])
        .momentum([0.0])
        .build()
        .unwrap();
    for position in &double.positions[1..] {
        single.step(&[0.0].into()).unwrap();
        let error = (f64::from(single.state().position[0]) - position[0]).abs();
        assert!(error < 400.0 * f64::from(f32::EPSILON), "step {}: {error:e}", single.state().step);
    }
}

/// Three masses on springs between walls with the damping order and BDF order given.
fn chain(rho: f64, damping_order: f64, p: usize, h: f64, steps: usize) -> (Stability, Motion<3>) {
    let stiffness = Matrix3::new(2.0, -1.0, 0.0, -1.0, 2.0, -1.0, 0.0, -1.0, 2.0);
    let mass = Mass::diagonal([1.0, 1.0, 1.0]).unwrap();
    let scheme = Galerkin::low_order(0.5).unwrap();
    let explicit =
        ExplicitDamping { coefficients: diagonal(rho), damping_order, bdf_order: BdfOrder::new(p).unwrap() };
    let check = check_stability(&scheme, &mass, &stiffness, &[explicit], h).unwrap();
    let table = weights(p, damping_order, h, steps + 1);
    let damping = term(diagonal(rho), damping_order, Caputo, &table);
    let potential = Quadratic::new(Coefficients::Dense(stiffness)).unwrap();
    let system = System { mass, potential, force: NoForce };
    let start = (Vector3::new(0.1, 0.0, 0.0), Vector3::zeros());
    (check, integrate(system, scheme, damping, h, start, steps).unwrap())
}

fn largest_position(motion: &Motion<3>) -> f64 {
    motion.positions.iter().fold(0.0, |largest, q| max_or_nan(largest, q.amax()))
}

#[test]
fn the_stability_check_foresees_an_explosion() {
    let (check, motion) = chain(0.5, 1.65, 4, 0.04, 100);
    assert!(matches!(check, Stability::Unstable { .. }));
    assert!(largest_position(&motion) > 1e6, "{}", largest_position(&motion));
}

#[test]
fn the_largest_stable_step_is_sharp() {
    for (damping_order, p) in [(0.5, 1), (1.0, 2), (1.5, 3), (1.5, 4)] {
        let (Stability::Unstable { largest_stable_step }, _) = chain(2.0, damping_order, p, 10.0, 1) else {
            panic!("h = 10 passed for β = {damping_order}, BDF {p}");
        };
        for (factor, stable) in [(0.98, true), (1.02, false)] {
            let (check, motion) = chain(2.0, damping_order, p, factor * largest_stable_step, 6000);
            assert_eq!(check == Stability::Stable, stable);
            let largest = largest_position(&motion);
            assert_eq!(
                largest < 1.0,
                stable,
                "β = {damping_order}, BDF {p}, {factor} of the limit: {largest}"
            );
        }
    }
}
