//! What rounding leaves of the schemes' digits.

use fvi_core::{
    BdfOrder, DampingTerm, Derivative::Caputo, Galerkin, Integrator, Kernel, Mass, NoForce, Quadratic,
    System, monic_increment_table_f32,
};
use fvi_fft::memory::Engine;
use fvi_fft::sums::max_or_nan;
use fvi_scenario::language::Document;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::{GridState, Precision, Simulation};
use fvi_tests::reference;
use nalgebra::vector;
use std::path::Path;

/// Largest distance from the values with 70 digits, position or momentum, every 256th step.
fn rounding_error(at: &str, engine: Engine) -> f64 {
    let text = format!(
        r#"
        [system]
        mass = [1.0]
        potential = "0.5*q0^2"
        [[system.damping]]
        order = 1.9
        coefficient = [0.5]
        [initial]
        position = [1.0]
        momentum = [0.0]
        [scheme]
        kind = "low-order"
        [convolution]
        family = "bdf"
        order = 2
        at = "{at}"
        [time]
        step = {}
        steps = 8192
        {output}
        "#,
        4.0 / 8192.0,
        output = if at == "nodes" { "" } else { "[output]\nmomentum = \"one-sided\"" }
    );
    let mut scenario = Scenario::from_document(Document::new("floor.toml", Path::new("."), &text)).unwrap();
    scenario.history.choose(engine);
    let mut simulation = Simulation::new(&scenario, Precision::F64).unwrap();
    let mut state = GridState { position: vec![0.0], momentum: vec![0.0], ..GridState::default() };
    let prefix = at.split_once("nodes").map_or("", |(main, _)| if main.is_empty() { "node" } else { "main" });
    let mut worst = 0.0;
    let mut step = 0;
    for row in reference::read("rounding_floor.csv") {
        while step < row["step"] as usize {
            simulation.step(&[]).unwrap();
            step += 1;
        }
        simulation.read(&mut state);
        let errors = [
            state.position[0] - row[&format!("{prefix}_q")],
            state.momentum[0] - row[&format!("{prefix}_p")],
        ];
        worst = errors.into_iter().map(f64::abs).fold(worst, max_or_nan);
    }
    worst
}

#[test]
fn strong_memory_keeps_all_but_the_last_digits_on_every_engine() {
    // On values, with weights of size h^−1.9 = 2·10⁶, this was 5·10⁻¹⁰.
    for at in ["main-nodes", "nodes"] {
        for engine in [
            Engine::Direct,
            Engine::BlockFft,
            Engine::RealTime,
            Engine::ExponentialSum,
            Engine::ExponentialSumCore,
        ] {
            let error = rounding_error(at, engine);
            assert!(error < 5e-13, "{at}, {engine:?}: {error:e}");
        }
    }
}

/// Energy of the oscillator m = k = 1 in single precision, relative to the one it starts with.
fn energy_left<D: fvi_core::Damping<f32, fvi_core::Fixed<1>>>(
    step_size: f32,
    damping: D,
    steps: usize,
    position: f32,
) -> f64 {
    let system = System {
        mass: Mass::diagonal([1.0]).unwrap(),
        potential: Quadratic::diagonal([1.0]).unwrap(),
        force: NoForce,
    };
    let mut integrator = Integrator::builder(system, Galerkin::low_order(0.5).unwrap(), step_size)
        .damping(damping)
        .position([position])
        .build()
        .unwrap();
    for _ in 0..steps {
        integrator.step(&vector![0.0]).unwrap();
    }
    let state = integrator.state();
    let (q, p) = (f64::from(state.position[0]), f64::from(state.momentum[0]));
    (q * q + p * p) / f64::from(position).powi(2)
}

/// The same where all is in double precision but one thing: the value of the force is rounded to single
/// precision, as every force that is computed there is.
fn energy_with_rounded_forces(step_size: f32, steps: usize, position: f32) -> f64 {
    let (h, start) = (f64::from(step_size), f64::from(position));
    let (mut q, mut p) = (start, 0.0);
    for _ in 0..steps {
        let e = (p - 0.5 * h * q) / (1.0 / h + 0.25 * h);
        p -= h * f64::from((q + 0.5 * e) as f32);
        q += e;
    }
    (q * q + p * p) / (start * start)
}

#[test]
fn a_million_steps_in_single_precision_lose_no_energy_of_their_own() {
    // What is left is the rounding of the increments h v and of the forces h F: a random walk whose steps
    // grow with h. That of the forces nobody can take away in single precision.
    for (step_size, allowed, least) in [(0.001, 1e-7, 0.0), (0.01, 1e-6, 0.0), (0.05, 1e-5, 4e-7)] {
        let positions = [1.0, 1.1, 0.9, 0.77].into_iter();
        let errors = positions.map(|position| {
            let error = energy_left(step_size, (), 1_000_000, position) - 1.0;
            [error, energy_with_rounded_forces(step_size, 1_000_000, position) - 1.0]
        });
        let largest = errors.fold([0.0_f64; 2], |largest, error| {
            [max_or_nan(largest[0], error[0].abs()), max_or_nan(largest[1], error[1].abs())]
        });
        println!(
            "h = {step_size}: energy off by {:.1e}; by rounding of forces alone {:.1e}",
            largest[0], largest[1]
        );
        assert!(largest[0] < allowed && largest[1] > least, "h = {step_size}: {largest:?}");
    }
}

#[test]
fn a_million_steps_in_single_precision_lose_what_the_damping_takes() {
    static WEIGHTS: [f32; 4] = monic_increment_table_f32(BdfOrder::GRUNWALD_LETNIKOV, 1.0);
    for step_size in [0.005f32, 0.01, 0.02] {
        let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, 1.0, f64::from(step_size)).unwrap();
        let memory = kernel.short_memory::<f32, 1, 4>(&WEIGHTS).unwrap();
        let rho = 1e-5;
        let term = DampingTerm::new(kernel, diagonal_f32(rho as f32), Caputo, memory).unwrap();
        let found = energy_left(step_size, term, 1_000_000, 1.0);
        let expected = exact_energy(f64::from(step_size), f64::from(rho as f32), 1_000_000);
        assert!(
            (found - expected).abs() < 1e-5 * (1.0 - expected),
            "h = {step_size}: {found} and {expected}"
        );
    }
}

fn diagonal_f32(entry: f32) -> fvi_core::Coefficients<f32, 1> {
    fvi_core::Coefficients::Diagonal(vector![entry])
}

/// The same scheme in double precision, without memory: D q of order one is the last step's velocity.
fn exact_energy(h: f64, rho: f64, steps: usize) -> f64 {
    let (mut q, mut p) = (1.0f64, 0.0f64);
    for _ in 0..steps {
        let e = (p - 0.5 * h * q) / (1.0 / h + 0.25 * h);
        p -= h * (q + 0.5 * e) + rho * e;
        q += e;
    }
    q * q + p * p
}

#[test]
fn a_chain_in_single_precision_neither_gains_nor_loses_energy() {
    // Between walls, unequal masses, a step far below the periods: its equations are solved once a step.
    let text = r#"
        [system]
        mass = [1.0, 1.3, 0.7, 1.1, 0.9, 1.7]
        potential = "2*q0^2 + 2*(q1 - q0)^2 + 3*(q2 - q1)^2 + 1.1*(q3 - q2)^2 + 2*(q4 - q3)^2 + 0.7*(q5 - q4)^2"
        [initial]
        position = [1.0, -0.4, 0.3, 0.9, -0.2, 0.5]
        momentum = [0.0, 0.2, 0.0, -0.3, 0.0, 0.1]
        [scheme]
        kind = "low-order"
        [time]
        step = 0.02
        steps = 100000
    "#;
    let scenario = Scenario::from_document(Document::new("chain.toml", Path::new("."), text)).unwrap();
    let mut simulation = Simulation::new(&scenario, Precision::F32).unwrap();
    let zeros = || vec![0.0; 6];
    let mut state = GridState { position: zeros(), momentum: zeros(), ..GridState::default() };
    // An invariant of the midpoint rule, rounded by its own terms each time.
    let mut mean_energy = || {
        (0..1000).fold(0.0, |sum, _| {
            simulation.step(&[]).unwrap();
            simulation.read(&mut state);
            sum + state.energy / 1000.0
        })
    };
    let first = mean_energy();
    let last = (0..98).fold(first, |_, _| mean_energy());
    assert!((last - first).abs() < 1e-6 * first, "{first} → {last}");
}
