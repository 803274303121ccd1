//! Large systems against what is known of them: motions along one mode, the dense way, other ways to say the same.

use fvi_host::language::Document;
use fvi_host::scenario::Scenario;
use fvi_host::simulation::{GridState, Precision, Simulation, Solver, SolverChoice};
use serde_json::json;
use std::f64::consts::PI;
use std::fmt::Write;
use std::path::Path;

/// All states of a run, the first included.
fn states(scenario: &Scenario, solver: SolverChoice) -> Vec<GridState> {
    let mut simulation = Simulation::with_solver(scenario, Precision::F64, solver).unwrap();
    let zeros = vec![0.0; scenario.coordinates()];
    let mut state = GridState { position: zeros.clone(), momentum: zeros, ..GridState::default() };
    (0..=scenario.time.steps)
        .map(|step| {
            if step > 0 {
                simulation.step(&[]).unwrap();
            }
            simulation.read(&mut state);
            state.clone()
        })
        .collect()
}

/// The largest difference of two lists.
fn apart(one: &[f64], other: &[f64]) -> f64 {
    assert_eq!(one.len(), other.len());
    one.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// A chain of masses between two walls, its stiffness and a mass matrix that couples neighbours as linear elements do: both have the
/// eigenvectors sin(i j π/(n + 1)).
struct Chain {
    n: usize,
}

impl Chain {
    fn file(&self, own: f64, beside: f64) -> String {
        let n = self.n;
        let mut text = format!("%%MatrixMarket matrix coordinate real symmetric\n{n} {n} {}\n", 2 * n - 1);
        for row in 1..=n {
            if row > 1 {
                writeln!(text, "{row} {} {beside:e}", row - 1).unwrap();
            }
            writeln!(text, "{row} {row} {own:e}").unwrap();
        }
        text
    }

    fn angle(&self, mode: usize) -> f64 {
        mode as f64 * PI / (self.n + 1) as f64
    }

    fn mass(&self, mode: usize) -> f64 {
        (4.0 + 2.0 * self.angle(mode).cos()) / 6.0
    }

    fn stiffness(&self, mode: usize) -> f64 {
        let n = (self.n + 1) as f64;
        n * n * (2.0 - 2.0 * self.angle(mode).cos())
    }

    fn shape(&self, mode: usize) -> Vec<f64> {
        (1..=self.n).map(|i| (i as f64 * self.angle(mode)).sin()).collect()
    }

    /// Released along modes of these numbers; ρ = 0.02 K.
    fn scenario(&self, modes: &[usize], step: f64, steps: usize, at: &str) -> Scenario {
        let n = (self.n + 1) as f64;
        let mut position = vec![0.0; self.n];
        for &mode in modes {
            position.iter_mut().zip(self.shape(mode)).for_each(|(q, shape)| *q += shape / mode as f64);
        }
        let text = format!(
            "[system]\nmass = 'M.mtx'\nstiffness = 'K.mtx'\n[[system.damping]]\norder = 0.6\ncoefficient = 'K.mtx'\nscale = 0.02\n\
             [initial]\nposition = {position:?}\nmomentum = {:?}\n[scheme]\nkind = 'low-order'\n\
             [convolution]\nat = '{at}'\norder = 2\n[time]\nstep = {step:e}\nsteps = {steps}\n[output]\ncoordinates = [0]\n",
            vec![0.0; self.n]
        );
        let document = Document::new("chain", Path::new(""), &text)
            .with_attached("M.mtx", &self.file(4.0 / 6.0, 1.0 / 6.0))
            .with_attached("K.mtx", &self.file(2.0 * n * n, -n * n));
        Scenario::from_document(document).unwrap()
    }

    /// The motion of one mode by itself.
    fn oscillator(&self, mode: usize, step: f64, steps: usize) -> Vec<f64> {
        let (m, k) = (self.mass(mode), self.stiffness(mode));
        let scenario = Scenario::from_value(&json!({
            "system": {
                "mass": [m], "potential": "0.5*k*q0^2", "parameters": { "k": k },
                "damping": [{ "order": 0.6, "coefficient": [0.02 * k] }],
            },
            "initial": { "position": [1.0 / mode as f64], "momentum": [0.0] },
            "scheme": { "kind": "low-order" },
            "convolution": { "family": "bdf", "order": 2, "at": "nodes" },
            "time": { "step": step, "steps": steps },
        }))
        .unwrap();
        states(&scenario, SolverChoice::Dense).into_iter().map(|state| state.position[0]).collect()
    }
}

/// Modes do not disturb each other, so that each moves as a fractional oscillator by itself.
#[test]
fn a_chain_of_five_hundred_moves_as_its_modes_do_one_by_one() {
    let chain = Chain { n: 500 };
    // The fastest mode has ω h of about 90.
    let (modes, step, steps) = ([1, 4, 499], 0.05, 60);
    let scenario = chain.scenario(&modes, step, steps, "nodes");
    let simulation = Simulation::new(&scenario, Precision::F64).unwrap();
    assert!(matches!(simulation.solver(), Solver::Sparse { .. }));
    let found = states(&scenario, SolverChoice::Automatic);
    let alone: Vec<_> =
        modes.iter().map(|&mode| (chain.shape(mode), chain.oscillator(mode, step, steps))).collect();
    for (index, state) in found.iter().enumerate() {
        let known: Vec<f64> = (0..chain.n)
            .map(|i| alone.iter().map(|(shape, amplitude)| shape[i] * amplitude[index]).sum())
            .collect();
        let error = apart(&state.position, &known);
        assert!(error < 1e-9, "step {index}: {error:e}");
    }
}

/// The first mode against itself in steps an eighth as long.
#[test]
fn the_error_of_a_large_chain_falls_with_the_square_of_the_step() {
    let chain = Chain { n: 500 };
    let fine = chain.oscillator(1, 0.05 / 16.0, 16 * 40);
    let error = |steps: usize| {
        let found =
            states(&chain.scenario(&[1], 2.0 / steps as f64, steps, "nodes"), SolverChoice::Automatic);
        let known: Vec<f64> = chain.shape(1).iter().map(|shape| shape * fine[fine.len() - 1]).collect();
        apart(&found[steps].position, &known)
    };
    let (coarse, finer) = (error(40), error(80));
    let ratio = coarse / finer;
    assert!((3.4..4.8).contains(&ratio), "{coarse:e} {finer:e}: {ratio}");
}

#[test]
fn the_sparse_way_leads_where_the_dense_one_does() {
    let chain = Chain { n: 60 };
    // Both forms of damping that the sparse solver serves.
    for (at, step) in [("nodes", 0.05), ("main-nodes", 0.002)] {
        let scenario = chain.scenario(&[1, 2, 3, 5, 8, 60], step, 300, at);
        let sparse = states(&scenario, SolverChoice::Sparse);
        let dense = states(&scenario, SolverChoice::Dense);
        for (one, other) in sparse.iter().zip(&dense) {
            let (position, momentum) =
                (apart(&one.position, &other.position), apart(&one.momentum, &other.momentum));
            let energy = (one.energy - other.energy).abs();
            let large = dense[0].energy;
            assert!(
                position < 1e-9 && momentum < 1e-8 && energy < 1e-9 * large,
                "{at}: {position:e} {momentum:e} {energy:e}"
            );
        }
    }
}

#[test]
fn engines_agree_on_a_large_chain() {
    let chain = Chain { n: 150 };
    let mut scenario = chain.scenario(&[1, 7], 0.05, 100, "nodes");
    let mut of = |engine| {
        scenario.history.choose(engine);
        states(&scenario, SolverChoice::Automatic).pop().unwrap().position
    };
    use fvi_host::scenario::Engine;
    let direct = of(Engine::Direct);
    for engine in [Engine::ExponentialSum, Engine::BlockFft, Engine::RealTime, Engine::ExponentialSumCore] {
        let error = apart(&of(engine), &direct);
        assert!(error < 1e-9, "{engine:?}: {error:e}");
    }
}

fn small(system: serde_json::Value, steps: usize) -> Vec<GridState> {
    let count = system["mass"].as_array().unwrap().len();
    let position: Vec<f64> = (0..count).map(|i| 0.3 - 0.2 * i as f64).collect();
    let scenario = Scenario::from_value(&json!({
        "system": system,
        "initial": { "position": position, "velocity": vec![0.1; count] },
        "scheme": { "kind": "low-order" },
        "convolution": { "family": "bdf", "order": 2, "at": "nodes" },
        "time": { "step": 0.05, "steps": steps },
    }))
    .unwrap();
    let dense = states(&scenario, SolverChoice::Dense);
    let sparse = states(&scenario, SolverChoice::Sparse);
    for (one, other) in sparse.iter().zip(&dense) {
        assert!(apart(&one.position, &other.position) < 1e-11);
    }
    dense
}

fn assert_same(one: &[GridState], other: &[GridState]) {
    for (one, other) in one.iter().zip(other) {
        let error = apart(&one.position, &other.position).max(apart(&one.momentum, &other.momentum));
        assert!(error < 1e-11 && (one.energy - other.energy).abs() < 1e-11, "t = {}: {error:e}", one.time);
    }
}

/// Dampers, elements, loads and a stiffness are short for coefficients, a potential and forces.
#[test]
fn two_ways_to_say_the_same_give_the_same_motion() {
    let short = small(
        json!({
            "mass": [1.0, 2.0, 1.5],
            "stiffness": [[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]],
            "parameters": { "k3": 4.0 },
            "damping": [{ "order": 0.6, "attached": [[1.0, 0.0], [-1.0, 0.5], [0.0, -0.5]], "strength": [0.3, 0.8] }],
            "element": [{ "potential": "0.25*k3*(x1 - x0)^4 + 0.1*x0", "coordinates": [[0, 1], [2, 1]] }],
            "load": [
                { "pattern": { "coordinate": 2, "value": 0.5 }, "amplitude": "sin(2*t)" },
                { "pattern": [1.0, 0.0, -1.0], "amplitude": "step(1 - t)" },
            ],
        }),
        80,
    );
    let long = small(
        json!({
            "mass": [1.0, 2.0, 1.5],
            "potential": "q0^2 + q1^2 + 0.5*q2^2 - q0*q1 - q1*q2 + 0.25*k3*((q1 - q0)^4 + (q1 - q2)^4) + 0.1*(q0 + q2)",
            "force": ["step(1 - t)", "0", "0.5*sin(2*t) - step(1 - t)"],
            // Loads are taken at the nodes.
            "force_quadrature": "nodes",
            "parameters": { "k3": 4.0 },
            "damping": [{ "order": 0.6, "coefficient": [[0.3, -0.3, 0.0], [-0.3, 0.5, -0.2], [0.0, -0.2, 0.2]] }],
        }),
        80,
    );
    assert_same(&short, &long);
}

fn of_repository(name: &str) -> Scenario {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios").join(name);
    Scenario::read(&path).unwrap()
}

/// The dampers of the frame are as its stiffness, storey by storey, so that it decouples into oscillators with the frequencies
/// of a uniform shear frame, each shaken by its share of the ground's acceleration.
#[test]
fn the_shaken_frame_moves_as_its_modes_do() {
    let frame = of_repository("frame-ten-storeys.toml");
    let (n, m, k, rho) = (10, 1e5, 2e8, 4e6);
    let found = states(&frame, SolverChoice::Automatic);
    let (step, steps) = (frame.time.step, frame.time.steps);
    let mut known = vec![vec![0.0; n]; steps + 1];
    let ground = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios/frame-ground.csv");
    for mode in 1..=n {
        let angle = (2 * mode - 1) as f64 * PI / (2 * n + 1) as f64;
        let shape: Vec<f64> = (1..=n).map(|i| (i as f64 * angle).sin()).collect();
        let square: f64 = shape.iter().map(|x| x * x).sum();
        let share = -m * shape.iter().sum::<f64>() / square;
        let factor = 4.0 * (0.5 * angle).sin().powi(2);
        let oscillator = Scenario::from_value(&json!({
            "system": {
                "mass": [m], "stiffness": [k * factor],
                "damping": [{ "order": 0.6, "coefficient": [rho * factor] }],
                "load": [{ "pattern": [share], "amplitude": { "file": ground } }],
            },
            "scheme": { "kind": "low-order" },
            "convolution": { "family": "bdf", "order": 2, "at": "nodes" },
            "time": { "step": step, "steps": steps },
        }))
        .unwrap();
        for (known, state) in known.iter_mut().zip(states(&oscillator, SolverChoice::Dense)) {
            known.iter_mut().zip(&shape).for_each(|(q, shape)| *q += shape * state.position[0]);
        }
    }
    let largest =
        found.iter().flat_map(|state| &state.position).fold(0.0, |largest: f64, q| largest.max(q.abs()));
    // Storeys that move by centimetres.
    assert!((0.01..0.5).contains(&largest), "{largest}");
    for (state, known) in found.iter().zip(&known) {
        let error = apart(&state.position, known);
        assert!(error < 1e-9 * largest, "t = {}: {error:e}", state.time);
    }
}

/// The elements of the chain with gaps, written out as one potential.
#[test]
fn the_chain_with_gaps_moves_as_its_potential_says() {
    let mut chain = of_repository("chain-with-gaps.toml");
    // Longer on, every bounce has multiplied the rounding of those before.
    chain.time.steps = 1000;
    let n = chain.coordinates();
    let found = states(&chain, SolverChoice::Automatic);
    let between =
        |i: usize| format!("0.5*k*(q{1} - q{0})^2 + 0.5*c*max(abs(q{1} - q{0}) - gap, 0)^2", i, i + 1);
    let potential: Vec<String> = (0..n - 1).map(between).chain([format!("0.5*k*q{}^2", n - 1)]).collect();
    let mut rho = vec![vec![0.0; n]; n];
    for i in 0..n - 1 {
        for (a, b, sign) in [(i, i, 1.0), (i + 1, i + 1, 1.0), (i, i + 1, -1.0), (i + 1, i, -1.0)] {
            rho[a][b] += sign * 0.05;
        }
    }
    let mut force = vec!["0".to_owned(); n];
    force[0] = "step(1 - t)".to_owned();
    let whole = Scenario::from_value(&json!({
        "system": {
            "mass": vec![1.0; n], "potential": potential.join(" + "), "force": force, "force_quadrature": "nodes",
            "parameters": { "k": 1.0, "c": 400.0, "gap": 0.05 },
            "damping": [{ "order": 0.5, "coefficient": rho }],
        },
        "initial": { "position": vec![0.0; n], "momentum": vec![0.0; n] },
        "scheme": { "kind": "low-order" },
        "convolution": { "family": "bdf", "order": 2, "at": "nodes" },
        "time": { "step": chain.time.step, "steps": 1000 },
    }))
    .unwrap();
    let known = states(&whole, SolverChoice::Dense);
    // Buffers are met: neighbours part by more than the gap.
    let widest = found
        .iter()
        .flat_map(|state| state.position.windows(2).map(|pair| (pair[1] - pair[0]).abs()))
        .fold(0.0, f64::max);
    assert!(widest > 0.05, "{widest}");
    for (one, other) in found.iter().zip(&known) {
        let error = apart(&one.position, &other.position);
        assert!(error < 1e-9, "t = {}: {error:e}", one.time);
    }
}
