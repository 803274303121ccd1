//! Large systems against what is known of them: motions along one mode, the dense way, other ways to say the
//! same.

use fvi_fft::memory::{Engine, States};
use fvi_fft::sums::max_or_nan;
use fvi_scenario::language::Document;
use fvi_scenario::scenario::{Scenario, SymmetricMatrix};
use fvi_simulation::simulation::{GridState, Precision, Simulation, Solver, SolverChoice};
use nalgebra::DMatrix;
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
    one.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(0.0, max_or_nan)
}

/// A chain of masses between two walls, its stiffness and a mass matrix that couples neighbours as linear
/// elements do: both have the eigenvectors sin(i j π/(n + 1)).
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
        self.of_scheme(modes, step, steps, (at, "kind = 'low-order'", 2))
    }

    /// The same with another scheme and another order of the convolution quadrature.
    fn of_scheme(
        &self,
        modes: &[usize],
        step: f64,
        steps: usize,
        (at, scheme, order): (&str, &str, usize),
    ) -> Scenario {
        let n = (self.n + 1) as f64;
        let mut position = vec![0.0; self.n];
        for &mode in modes {
            position.iter_mut().zip(self.shape(mode)).for_each(|(q, shape)| *q += shape / mode as f64);
        }
        let text = format!(
            "[system]\nmass = 'M.mtx'\nstiffness = 'K.mtx'\n[[system.damping]]\norder = 0.6\ncoefficient = 'K.mtx'\nscale = 0.02\n\
             [initial]\nposition = {position:?}\nmomentum = {:?}\n[scheme]\n{scheme}\n\
             [convolution]\nat = '{at}'\norder = {order}\n[time]\nstep = {step:e}\nsteps = {steps}\n[output]\ncoordinates = [0]\n",
            vec![0.0; self.n]
        );
        let document = Document::new("chain", Path::new(""), &text)
            .with_attached("M.mtx", self.file(4.0 / 6.0, 1.0 / 6.0))
            .with_attached("K.mtx", self.file(2.0 * n * n, -n * n));
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

/// Two Gauss points, with two unknowns at each coordinate.
const GAUSS: &str = "kind = 'galerkin'\ndegree = 2";

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

/// One correction a step is enough for one unknown node, and two for two: what the factor's rounding does to
/// stiff motions does not add up.
#[test]
fn a_chain_of_soft_and_stiff_springs_keeps_its_energy() {
    keeps_energy_of_soft_and_stiff_springs("kind = 'low-order'", 20_000);
    keeps_energy_of_soft_and_stiff_springs(GAUSS, 5_000);
}

fn keeps_energy_of_soft_and_stiff_springs(scheme: &str, steps: usize) {
    // Frequencies times the step from 0.01 to 2·10⁵.
    let n = 140;
    let spring = |i: usize| 1e-2 * 10f64.powi((i * 37 % 13) as i32);
    let mut stiffness = format!("%%MatrixMarket matrix coordinate real symmetric\n{n} {n} {}\n", 2 * n - 1);
    for row in 1..=n {
        if row > 1 {
            writeln!(stiffness, "{row} {} {:e}", row - 1, -spring(row - 1)).unwrap();
        }
        writeln!(stiffness, "{row} {row} {:e}", spring(row - 1) + spring(row)).unwrap();
    }
    let position: Vec<f64> = (0..n).map(|i| (i as f64 * 0.05).sin()).collect();
    let momentum: Vec<f64> = (0..n).map(|i| (i as f64 * 0.7).cos()).collect();
    let text = format!(
        "[system]\nmass = {:?}\nstiffness = 'K.mtx'\n[initial]\nposition = {position:?}\nmomentum = {momentum:?}\n\
         [scheme]\n{scheme}\n[time]\nstep = 1.0\nsteps = {steps}\n[output]\ncoordinates = [0]\n",
        vec![1.0; n]
    );
    let document = Document::new("springs", Path::new(""), &text).with_attached("K.mtx", stiffness);
    let scenario = Scenario::from_document(document).unwrap();
    let mut simulation = Simulation::new(&scenario, Precision::F64).unwrap();
    assert!(matches!(simulation.solver(), Solver::Sparse { .. }));
    let energy = |simulation: &mut Simulation| {
        let mut state =
            GridState { position: position.clone(), momentum: momentum.clone(), ..GridState::default() };
        simulation.read(&mut state);
        state.energy
    };
    let first = energy(&mut simulation);
    let mut changes = Vec::new();
    for step in 1..=steps {
        simulation.step(&[]).unwrap();
        if step % 1_000 == 0 {
            changes.push(energy(&mut simulation) / first - 1.0);
        }
    }
    // Rounding of the forces in the stiffest springs alone makes it wander by so much.
    assert!(changes.iter().all(|change| change.abs() < 1e-7), "{changes:?}");
}

#[test]
fn the_sparse_way_leads_where_the_dense_one_does() {
    let chain = Chain { n: 60 };
    let low = "kind = 'low-order'";
    // Both forms of damping, one unknown and two.
    for (at, scheme, order, step) in [
        ("nodes", low, 2, 0.05),
        ("main-nodes", low, 2, 0.002),
        ("nodes", GAUSS, 3, 0.01),
        ("nodes", GAUSS, 4, 0.005),
        ("main-nodes", GAUSS, 2, 0.002),
    ] {
        let scenario = chain.of_scheme(&[1, 2, 3, 5, 8, 60], step, 300, (at, scheme, order));
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

/// A chain with five kinds of damping everywhere and two at its ends.
fn chain_of_many_dampings() -> Scenario {
    let chain = Chain { n: 140 };
    let mut rows = String::from("%%MatrixMarket matrix coordinate real general\n140 100 100\n");
    (1..=100).for_each(|column| writeln!(rows, "{} {column} 1.0", column + 20).unwrap());
    let term = |order: f64, rest: &str| format!("[[system.damping]]\norder = {order}\n{rest}\n");
    let everywhere = "coefficient = 'K.mtx'\nscale = 0.002";
    let dampers = format!("attached = 'B.mtx'\nstrength = {:?}", vec![0.3; 100]);
    let terms = [
        term(0.6, everywhere),
        term(1.5, &format!("{everywhere}\nderivative = 'caputo'")),
        term(0.5, &dampers),
        term(0.25, everywhere),
        term(1.0, everywhere),
        term(0.8, &dampers),
        term(1.2, &format!("{everywhere}\nderivative = 'caputo'")),
        term(0.7, &format!("{everywhere}\nderivative = 'riemann-liouville'")),
        term(0.9, "coefficient = 'M.mtx'"),
    ];
    let mut position = chain.shape(3);
    position.iter_mut().enumerate().for_each(|(i, q)| *q += 0.1 * (i as f64).sin());
    let text = format!(
        "[system]\nmass = 'M.mtx'\nstiffness = 'K.mtx'\n{}[initial]\nposition = {position:?}\nvelocity = {:?}\n\
         [convolution]\nat = 'nodes'\norder = 2\n[time]\nstep = 0.02\nsteps = 150\n[output]\ncoordinates = [0]\n",
        terms.concat(),
        chain.shape(2),
    );
    let n = (chain.n + 1) as f64;
    let document = Document::new("dampings", Path::new(""), &text)
        .with_attached("B.mtx", rows)
        .with_attached("M.mtx", chain.file(4.0 / 6.0, 1.0 / 6.0))
        .with_attached("K.mtx", chain.file(2.0 * n * n, -n * n));
    Scenario::from_document(document).unwrap()
}

/// Terms that follow the same numbers share a memory; whole orders, other derivatives and other places do not
/// join them. The motion is that of memories that are plain sums.
#[test]
fn dampings_of_several_orders_on_the_same_coordinates_share_a_memory() {
    let mut scenario = chain_of_many_dampings();
    // So short a run would have plain sums.
    scenario.history.choose(Engine::ExponentialSum);
    let simulation = Simulation::new(&scenario, Precision::F64).unwrap();
    assert_eq!(simulation.shared(), [vec![0, 3, 8], vec![1, 6], vec![2, 5]]);
    assert_eq!(simulation.engines(), [Engine::ExponentialSum; 9]);
    let last = |scenario: &Scenario| states(scenario, SolverChoice::Automatic).pop().unwrap();
    let shared = last(&scenario);
    scenario.history.choose(Engine::Direct);
    let simulation = Simulation::new(&scenario, Precision::F64).unwrap();
    assert!(simulation.shared().is_empty());
    let plain = last(&scenario);
    let largest = plain.position.iter().fold(0.0, |largest: f64, q| max_or_nan(largest, q.abs()));
    let error = apart(&shared.position, &plain.position);
    assert!(error < 1e-11 * largest, "{error:e} of {largest:e}");
    // In single precision, to its tolerance.
    scenario.history.choose(Engine::ExponentialSum);
    scenario.history.states = Some(States::F32);
    scenario.history.tolerance = Some(1e-6);
    let single = last(&scenario);
    let error = apart(&single.position, &plain.position);
    assert!(error > 0.0 && error < 1e-6 * largest, "{error:e} of {largest:e}");
}

#[test]
fn engines_agree_on_a_large_chain() {
    let chain = Chain { n: 150 };
    for (scheme, order, step) in [("kind = 'low-order'", 2, 0.05), (GAUSS, 3, 0.002)] {
        let mut scenario = chain.of_scheme(&[1, 7], step, 100, ("nodes", scheme, order));
        let mut of = |engine| {
            scenario.history.choose(engine);
            states(&scenario, SolverChoice::Automatic).pop().unwrap().position
        };
        let direct = of(Engine::Direct);
        for engine in [Engine::ExponentialSum, Engine::BlockFft, Engine::RealTime, Engine::ExponentialSumCore]
        {
            let error = apart(&of(engine), &direct);
            assert!(error < 1e-9, "{scheme} {engine:?}: {error:e}");
        }
    }
}

/// The midpoint rule, and two Gauss points: (scheme, order of the convolution quadrature).
fn schemes() -> [(serde_json::Value, u32); 3] {
    let gauss = json!({ "kind": "galerkin", "degree": 2 });
    [(json!({ "kind": "low-order" }), 2), (gauss.clone(), 3), (gauss, 4)]
}

fn small(
    system: serde_json::Value,
    (scheme, order): &(serde_json::Value, u32),
    steps: usize,
) -> Vec<GridState> {
    let count = system["mass"].as_array().unwrap().len();
    let position: Vec<f64> = (0..count).map(|i| 0.3 - 0.2 * i as f64).collect();
    let scenario = Scenario::from_value(&json!({
        "system": system,
        "initial": { "position": position, "velocity": vec![0.1; count] },
        "scheme": scheme,
        "convolution": { "family": "bdf", "order": order, "at": "nodes" },
        "time": { "step": 0.05, "steps": steps },
    }))
    .unwrap();
    assert!(matches!(
        Simulation::with_solver(&scenario, Precision::F64, SolverChoice::Sparse).unwrap().solver(),
        Solver::Sparse { .. }
    ));
    let dense = states(&scenario, SolverChoice::Dense);
    let sparse = states(&scenario, SolverChoice::Sparse);
    for (one, other) in sparse.iter().zip(&dense) {
        assert!(apart(&one.position, &other.position) < 1e-11);
    }
    dense
}

fn assert_same(one: &[GridState], other: &[GridState]) {
    for (one, other) in one.iter().zip(other) {
        let error = max_or_nan(apart(&one.position, &other.position), apart(&one.momentum, &other.momentum));
        assert!(error < 1e-11 && (one.energy - other.energy).abs() < 1e-11, "t = {}: {error:e}", one.time);
    }
}

/// Dampers, elements, loads and a stiffness are short for coefficients, a potential and forces.
#[test]
fn two_ways_to_say_the_same_give_the_same_motion() {
    let short = |scheme: &_| {
        small(
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
            scheme,
            80,
        )
    };
    let long = |scheme: &_| {
        small(
            json!({
                "mass": [1.0, 2.0, 1.5],
                "potential": "q0^2 + q1^2 + 0.5*q2^2 - q0*q1 - q1*q2 + 0.25*k3*((q1 - q0)^4 + (q1 - q2)^4) + 0.1*(q0 + q2)",
                "force": ["step(1 - t)", "0", "0.5*sin(2*t) - step(1 - t)"],
                // Loads are taken at the nodes.
                "force_quadrature": "nodes",
                "parameters": { "k3": 4.0 },
                "damping": [{ "order": 0.6, "coefficient": [[0.3, -0.3, 0.0], [-0.3, 0.5, -0.2], [0.0, -0.2, 0.2]] }],
            }),
            scheme,
            80,
        )
    };
    for scheme in &schemes() {
        assert_same(&short(scheme), &long(scheme));
    }
}

fn of_repository(name: &str) -> Scenario {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/scenarios").join(name);
    Scenario::read(&path).unwrap()
}

/// The dampers of the frame are as its stiffness, storey by storey, so that it decouples into oscillators
/// with the frequencies of a uniform shear frame, each shaken by its share of the ground's acceleration.
#[test]
fn the_shaken_frame_moves_as_its_modes_do() {
    let frame = of_repository("frame-ten-storeys.toml");
    let (n, m, k, rho) = (10, 1e5, 2e8, 4e6);
    let found = states(&frame, SolverChoice::Automatic);
    let (step, steps) = (frame.time.step, frame.time.steps);
    let mut known = vec![vec![0.0; n]; steps + 1];
    let ground = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/scenarios/frame-ground.csv");
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
    let largest = found
        .iter()
        .flat_map(|state| &state.position)
        .fold(0.0, |largest: f64, q| max_or_nan(largest, q.abs()));
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
        .fold(0.0, max_or_nan);
    assert!(widest > 0.05, "{widest}");
    for (one, other) in found.iter().zip(&known) {
        let error = apart(&one.position, &other.position);
        assert!(error < 1e-9, "t = {}: {error:e}", one.time);
    }
}

/// Complex numbers, as far as the transform below wants them: (real, imaginary).
type Complex = (f64, f64);

fn times((a, b): Complex, (c, d): Complex) -> Complex {
    (a * c - b * d, a * d + b * c)
}

fn over(numerator: Complex, (c, d): Complex) -> Complex {
    let square = c * c + d * d;
    times(numerator, (c / square, -d / square))
}

/// q(t) of q̈ + c D^β q + ω² q = 0 in Caputo's sense with q(0) = 1 at rest, 0 < β < 1, from its Laplace
/// transform (s + c s^{β−1})/(s² + c s^β + ω²) by the trapezoidal rule on Talbot's contour, for ω t up to
/// about 12.
fn released(beta: f64, c: f64, square: f64, t: f64) -> f64 {
    const NODES: usize = 64;
    let (scale, width) = (NODES as f64 / t, 2.0 * PI / NODES as f64);
    let mut sum = 0.0;
    for node in 0..NODES {
        let theta = -PI + (node as f64 + 0.5) * width;
        let (sine, cosine) = (0.6407 * theta).sin_cos();
        let cot = cosine / sine;
        let s = (scale * (0.5017 * theta * cot - 0.6122), scale * 0.2645 * theta);
        let slope = (scale * (0.5017 * (cot - 0.6407 * theta * (1.0 + cot * cot))), scale * 0.2645);
        let (modulus, angle) = (s.0.hypot(s.1), s.1.atan2(s.0));
        let power = |exponent: f64| {
            let (sine, cosine) = (exponent * angle).sin_cos();
            (modulus.powf(exponent) * cosine, modulus.powf(exponent) * sine)
        };
        let (first, second) = (power(beta - 1.0), power(beta));
        let numerator = (s.0 + c * first.0, s.1 + c * first.1);
        let square_of_s = times(s, s);
        let denominator = (square_of_s.0 + c * second.0 + square, square_of_s.1 + c * second.1);
        let size = (s.0 * t).exp();
        let exponential = (size * (s.1 * t).cos(), size * (s.1 * t).sin());
        // The integrand times s′, divided by 2πi.
        sum += times(times(exponential, over(numerator, denominator)), slope).1;
    }
    sum * width / (2.0 * PI)
}

#[test]
fn the_exact_oscillator_is_one() {
    // Without damping a cosine; with a dashpot of order one the textbook's.
    assert!((released(0.5, 0.0, 9.0, 2.0) - 6.0_f64.cos()).abs() < 1e-9);
    let (c, square, t) = (0.2_f64, 4.0_f64, 3.0_f64);
    let frequency = (square - 0.25 * c * c).sqrt();
    let known = (-0.5 * c * t).exp() * ((frequency * t).cos() + 0.5 * c / frequency * (frequency * t).sin());
    assert!((released(1.0, c, square, t) - known).abs() < 1e-9);
}

/// The position at the end of a run released at rest from `start`.
fn end_of_release(
    (system, (scheme, order)): (&serde_json::Value, &(serde_json::Value, u32)),
    start: &[f64],
    end: f64,
    steps: usize,
) -> Vec<f64> {
    let scenario = Scenario::from_value(&json!({
        "system": system,
        "initial": { "position": start, "momentum": vec![0.0; start.len()] },
        "scheme": scheme,
        "convolution": { "family": "bdf", "order": order },
        "time": { "step": end / steps as f64, "steps": steps },
        "output": { "coordinates": [0] },
    }))
    .unwrap();
    let mut simulation = Simulation::new(&scenario, Precision::F64).unwrap();
    assert!(matches!(simulation.solver(), Solver::Sparse { .. }));
    (0..steps).for_each(|_| _ = simulation.step(&[]).unwrap());
    let zeros = vec![0.0; start.len()];
    let mut state = GridState { position: zeros.clone(), momentum: zeros, ..GridState::default() };
    simulation.read(&mut state);
    state.position
}

/// The error at the end, over the largest number of the start, with so many steps and with twice as many;
/// modes as (shape, ω²).
fn errors_of_release(
    system: (&serde_json::Value, &(serde_json::Value, u32)),
    (beta, scale): (f64, f64),
    modes: &[(Vec<f64>, f64)],
    end: f64,
    steps: usize,
) -> [f64; 2] {
    let sum = |amplitude: &dyn Fn(f64) -> f64| -> Vec<f64> {
        let mut sum = vec![0.0; modes[0].0.len()];
        for (shape, square) in modes {
            let amplitude = amplitude(*square);
            sum.iter_mut().zip(shape).for_each(|(sum, x)| *sum += amplitude * x);
        }
        sum
    };
    let start = sum(&|_| 1.0);
    let known = sum(&|square| released(beta, scale * square, square, end));
    let largest = start.iter().fold(0.0, |largest: f64, x| max_or_nan(largest, x.abs()));
    [steps, 2 * steps].map(|steps| apart(&end_of_release(system, &start, end, steps), &known) / largest)
}

/// Finite elements of a real package: with damping in proportion to the stiffness every mode is a fractional
/// oscillator, whose motion is known.
#[test]
fn cantilever_and_plate_move_as_their_exact_modes_to_the_order_of_the_scheme() {
    for (name, beta, scale) in [("cantilever", 0.6, 0.02), ("plate", 0.5, 0.005)] {
        let file = |letter: &str| {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/scenarios/finite-elements");
            folder.join(format!("{name}-{letter}.npz"))
        };
        let structure = of_repository(&format!("finite-elements/{name}.toml")).system;
        let n = structure.coordinates();
        let dense = |matrix: &SymmetricMatrix| {
            let SymmetricMatrix::Sparse(entries) = matrix else { panic!("a file") };
            let mut dense = DMatrix::zeros(n, n);
            for (row, slots) in entries.pattern.rows().enumerate() {
                slots.for_each(|slot| {
                    dense[(row, entries.pattern.columns()[slot] as usize)] = entries.values[slot]
                });
            }
            dense
        };
        let mass = dense(&structure.mass).cholesky().unwrap().l();
        let half = mass.solve_lower_triangular(&dense(structure.stiffness.as_ref().unwrap())).unwrap();
        let whole = mass.solve_lower_triangular(&half.transpose()).unwrap();
        let eigen = (0.5 * (&whole + whole.transpose())).symmetric_eigen();
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let modes: Vec<_> = [0, 2]
            .map(|mode| {
                let vector = eigen.eigenvectors.column(order[mode]).into_owned();
                let shape = mass.tr_solve_lower_triangular(&vector).unwrap();
                (shape.as_slice().to_vec(), eigen.eigenvalues[order[mode]])
            })
            .into();
        let end = 6.0 / modes[1].1.sqrt();
        let system = json!({
            "mass": file("M"), "stiffness": file("K"),
            "damping": [{ "order": beta, "coefficient": file("K"), "scale": scale }],
        });
        let [coarse, fine] = errors_of_release((&system, &schemes()[0]), (beta, scale), &modes, end, 80);
        let ratio = coarse / fine;
        assert!(fine < 2e-3 && (3.5..4.6).contains(&ratio), "{name}: {coarse:e} {fine:e} {ratio}");
    }
}

#[test]
fn a_chain_of_five_thousand_moves_as_its_exact_modes() {
    let chain = Chain { n: 5000 };
    let n = (chain.n + 1) as f64;
    let modes: Vec<_> =
        [1, 3].map(|mode| (chain.shape(mode), chain.stiffness(mode) / chain.mass(mode))).into();
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: String| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let (mass, stiffness) =
        (file("M.mtx", chain.file(4.0 / 6.0, 1.0 / 6.0)), file("K.mtx", chain.file(2.0 * n * n, -n * n)));
    let system = json!({
        "mass": mass, "stiffness": stiffness,
        "damping": [{ "order": 0.6, "coefficient": stiffness, "scale": 0.02 }],
    });
    // ωh of the fastest mode is 170 and 85.
    let [coarse, fine] = errors_of_release((&system, &schemes()[0]), (0.6, 0.02), &modes, 0.6, 60);
    let ratio = coarse / fine;
    assert!(fine < 2e-3 && (3.5..4.6).contains(&ratio), "{coarse:e} {fine:e} {ratio}");
}

/// Orders 2, 3 and 4 on ten thousand coordinates: springs between neighbours and to the ground, with
/// frequencies from 1 to 2.2, damped in proportion to the stiffness, so that every mode is a fractional
/// oscillator whose motion is known.
#[test]
fn a_chain_of_ten_thousand_moves_as_its_exact_modes_to_orders_up_to_four() {
    let chain = Chain { n: 10_000 };
    let modes: Vec<_> =
        [1, 4_000, 10_000].map(|mode| (chain.shape(mode), 3.0 - 2.0 * chain.angle(mode).cos())).into();
    let folder = tempfile::tempdir().unwrap();
    let stiffness = folder.path().join("K.mtx");
    std::fs::write(&stiffness, chain.file(3.0, -1.0)).unwrap();
    let system = json!({
        "mass": vec![1.0; chain.n], "stiffness": stiffness,
        "damping": [{ "order": 0.6, "coefficient": stiffness, "scale": 0.1 }],
    });
    for scheme in &schemes() {
        let order = scheme.1;
        // h = 0.1 and 0.05, and half as long where errors begin to fall later.
        let steps = if order == 4 { 80 } else { 40 };
        let [coarse, fine] = errors_of_release((&system, scheme), (0.6, 0.1), &modes, 4.0, steps);
        let found = (coarse / fine).log2();
        assert!(found > f64::from(order) - 0.3, "{order}: {coarse:e} {fine:e} {found}");
        println!("order {order}: {coarse:e} {fine:e} {found}");
    }
}

/// Elements that differ from stage to stage, in double and single precision.
#[test]
fn nonlinear_elements_on_two_gauss_points_move_sparse_as_dense() {
    let n = 40;
    let pairs: Vec<[usize; 2]> = (1..n).map(|i| [i - 1, i]).collect();
    let position: Vec<f64> = (0..n).map(|i| (0.9 * i as f64).sin()).collect();
    let scenario = |scheme: &serde_json::Value, order: u32| {
        Scenario::from_value(&json!({
            "system": {
                "mass": vec![1.0; n], "stiffness": vec![1.0; n],
                "damping": [{ "order": 0.6, "coefficient": vec![0.05; n] }],
                "element": [{ "potential": "8*(x1 - x0)^4", "coordinates": pairs }],
            },
            "initial": { "position": position, "momentum": vec![0.0; n] },
            "scheme": scheme,
            "convolution": { "family": "bdf", "order": order },
            "time": { "step": 0.05, "steps": 40 },
        }))
        .unwrap()
    };
    for (scheme, order) in &schemes()[1..] {
        let scenario = scenario(scheme, *order);
        let dense = states(&scenario, SolverChoice::Dense);
        let sparse = states(&scenario, SolverChoice::Sparse);
        for (one, other) in sparse.iter().zip(&dense) {
            let error =
                max_or_nan(apart(&one.position, &other.position), apart(&one.momentum, &other.momentum));
            assert!(error < 1e-10, "t = {}: {error:e}", one.time);
        }
        let mut single = Simulation::with_solver(&scenario, Precision::F32, SolverChoice::Sparse).unwrap();
        let mut state = sparse[0].clone();
        for _ in 0..scenario.time.steps {
            single.step(&[]).unwrap();
        }
        single.read(&mut state);
        let error = apart(&state.position, &dense[scenario.time.steps].position);
        assert!(error > 0.0 && error < 1e-4, "{error:e}");
    }
}
