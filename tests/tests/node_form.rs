//! Damping at the quadrature nodes with weights of backward differentiation formulas: principle, momentum,
//! limits, engines.

use fvi_fft::sums::max_or_nan;
use std::path::Path;

use fvi_core::{
    Coefficients, DampingTerm,
    Derivative::{self, Caputo, RiemannLiouville},
    Direct, Fixed, Galerkin, Kernel, Mass, NoForce, NodeGalerkin, Overflow, Potential, Quadratic, Quadrature,
    System, left_operator, right_operator,
};
use fvi_fft::memory::Engine;
use fvi_scenario::language::Document;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::{GridState, Precision, Simulation};
use fvi_tests::motion::{Pendulum, diagonal, integrate, weights};
use fvi_tests::stages::StageMemory;
use nalgebra::{SMatrix, SVector, matrix, vector};
use proptest::{collection, prelude::*};

/// A damping term whose memory holds R nodes of N coordinates, each with the plain weights of D^β.
fn node_term<const N: usize, const R: usize>(
    coefficients: Coefficients<f64, N>,
    damping_order: f64,
    derivative: Derivative,
    weights: &[f64],
) -> DampingTerm<f64, Fixed<N>, StageMemory> {
    let memory = Direct::new(weights.to_vec(), 1, 1.0, vec![Default::default(); N * R], Overflow::Refuse);
    let kernel = Kernel::given(damping_order).expect("an order in range");
    DampingTerm::new(kernel, coefficients, derivative, memory.expect("a good memory")).expect("good damping")
}

fn gauss<const S: usize>() -> NodeGalerkin<f64, S, S> {
    NodeGalerkin::new(Galerkin::new(&Quadrature::gauss().unwrap()).unwrap())
}

/// The states of a scenario at every grid point, from t = 0.
pub(crate) fn states(text: &str, engine: Option<Engine>) -> Vec<GridState> {
    let document = Document::new("node-form.toml", Path::new("."), text);
    let mut scenario = Scenario::from_document(document).unwrap_or_else(|error| panic!("{error}"));
    if let Some(engine) = engine {
        scenario.history.choose(engine);
    }
    let mut simulation =
        Simulation::new(&scenario, Precision::F64).unwrap_or_else(|error| panic!("{error}\n{text}"));
    let none = vec![0.0; scenario.coordinates()];
    let mut state = GridState { position: none.clone(), momentum: none, ..GridState::default() };
    simulation.read(&mut state);
    let mut states = vec![state.clone()];
    for _ in 0..scenario.time.steps {
        simulation.step(&[]).unwrap_or_else(|error| panic!("{error}\n{text}"));
        simulation.read(&mut state);
        states.push(state.clone());
    }
    states
}

/// Paths of R nodes over a number of steps.
fn path(steps: usize, nodes: usize, a: f64, b: f64) -> Vec<Vec<f64>> {
    (0..nodes).map(|i| (0..steps).map(|k| (a * k as f64 + b * i as f64).sin()).collect()).collect()
}

/// h Σ_k Σ_i b_i f_{k,i} g_{k,i}.
fn product(h: f64, b: &[f64], f: &[Vec<f64>], g: &[Vec<f64>]) -> f64 {
    let node = |(f, g): (&Vec<f64>, &Vec<f64>)| -> f64 { f.iter().zip(g).map(|(f, g)| f * g).sum() };
    b.iter().zip(f.iter().zip(g).map(node)).map(|(b, sum)| h * b * sum).sum()
}

/// An operator on the sequence of every node.
fn on_nodes(operator: fn(&[f64], &[f64], &mut [f64]), weights: &[f64], x: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let mut output = x.to_vec();
    x.iter().zip(&mut output).for_each(|(x, y)| operator(weights, x, y));
    output
}

#[test]
fn node_by_node_the_operators_are_adjoint_and_form_a_semigroup() {
    let (h, steps) = (0.1, 40);
    let b = Quadrature::<3>::gauss().unwrap().weights().to_vec();
    let (f, g) = (path(steps, 3, 0.7, 0.3), path(steps, 3, 1.9, 0.8));
    for order in 1..=6 {
        for alpha in [0.15, 0.5, 0.75] {
            let (half, whole) = (weights(order, alpha, h, steps), weights(order, 2.0 * alpha, h, steps));
            let left = |weights: &[f64], x: &[Vec<f64>]| on_nodes(left_operator::<f64>, weights, x);
            let right = |weights: &[f64], x: &[Vec<f64>]| on_nodes(right_operator::<f64>, weights, x);
            let (retarded, advanced) =
                (product(h, &b, &left(&half, &f), &g), product(h, &b, &f, &right(&half, &g)));
            let size = whole.iter().map(|w| w.abs()).sum::<f64>() * steps as f64 * h;
            assert!((retarded - advanced).abs() < 1e-14 * size, "BDF {order}: {retarded} and {advanced}");
            // ⟨D₋^α f, D₊^α g⟩ = ⟨D₋^{2α} f, g⟩.
            let action = product(h, &b, &left(&half, &f), &right(&half, &g));
            let force = product(h, &b, &left(&whole, &f), &g);
            assert!((action - force).abs() < 1e-13 * size, "BDF {order}: {action} and {force}");
        }
    }
}

#[test]
fn the_motion_and_its_mirror_image_make_the_restricted_action_stationary() {
    // S = Σ L_d(x) + Σ L_d(y) − h Σ_k ρ (D₋^α X)_k (D₊^α Y)_k under equal variations of x and y that vanish
    // at the ends, X and Y at the midpoints; it is quadratic here, so a central difference is its derivative.
    let (h, rho, alpha, steps) = (0.1, 0.6, 0.35, 60);
    let table = weights(2, 2.0 * alpha, h, steps + 1);
    let damping = node_term::<1, 1>(diagonal(rho), 2.0 * alpha, RiemannLiouville, &table);
    let system = System {
        mass: Mass::diagonal([1.5]).unwrap(),
        potential: Quadratic::diagonal([2.0]).unwrap(),
        force: NoForce,
    };
    let motion = integrate(system, gauss::<1>(), damping, h, (vector![1.0], vector![0.3]), steps).unwrap();
    let x = motion.first_positions();
    let y: Vec<f64> = x.iter().rev().copied().collect();
    let half = weights(2, alpha, h, steps);
    let action = |x: &[f64], y: &[f64]| {
        let middle = |x: &[f64]| x.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect::<Vec<_>>();
        let free = |x: &[f64]| {
            let kinetic: f64 = x.windows(2).map(|pair| 0.75 / h * (pair[1] - pair[0]).powi(2)).sum();
            kinetic - middle(x).iter().map(|x| h * x * x).sum::<f64>()
        };
        let (mut left, mut right) = (vec![0.0; steps], vec![0.0; steps]);
        left_operator(&half, &middle(x), &mut left);
        right_operator(&half, &middle(y), &mut right);
        free(x) + free(y) - h * rho * left.iter().zip(&right).map(|(a, b)| a * b).sum::<f64>()
    };
    for varied in [1, 2, 20, steps - 1] {
        let moved = |path: &[f64], by: f64| {
            let mut path = path.to_vec();
            path[varied] += by;
            path
        };
        let slope =
            0.5 * (action(&moved(&x, 1.0), &moved(&y, 1.0)) - action(&moved(&x, -1.0), &moved(&y, -1.0)));
        assert!(slope.abs() < 1e-10, "node {varied}: {slope:e}");
        // It is not stationary because it were flat: one path alone does not make it so.
        let alone = 0.5 * (action(&moved(&x, 1.0), &y) - action(&moved(&x, -1.0), &y));
        assert!(alone.abs() > 1e-3, "node {varied}: {alone:e}");
    }
}

/// Spring between two masses that depends on the distance alone.
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
fn damping_between_two_masses_keeps_their_total_momentum() {
    let (h, steps) = (0.05, 1000);
    let table = weights(4, 0.7, h, steps + 1);
    let between = Coefficients::Dense(matrix![0.4, -0.4; -0.4, 0.4]);
    let damping = node_term::<2, 2>(between, 0.7, Caputo, &table);
    let system = System { mass: Mass::diagonal([1.0, 3.0]).unwrap(), potential: Bond, force: NoForce };
    let start = (vector![0.0, 0.8], vector![0.7, -0.2]);
    let motion = integrate(system, gauss::<2>(), damping, h, start, steps).unwrap();
    for (k, p) in motion.momenta.iter().enumerate() {
        assert!((p.sum() - 0.5).abs() < 1e-12, "step {k}: {:e}", p.sum() - 0.5);
    }
    assert!(motion.energies[steps] < 0.5 * motion.energies[0]);
}

#[test]
fn the_total_momentum_changes_by_the_damping_force_on_all_masses() {
    let (h, rho, steps) = (0.05, 0.4, 400);
    let table = weights(2, 0.7, h, steps + 1);
    let damping = node_term::<2, 1>(diagonal(rho), 0.7, RiemannLiouville, &table);
    let system = System { mass: Mass::diagonal([1.0, 3.0]).unwrap(), potential: Bond, force: NoForce };
    let start = (vector![0.3, 0.8], vector![0.7, -0.2]);
    let motion = integrate(system, gauss::<1>(), damping, h, start, steps).unwrap();
    let middles: Vec<f64> = motion.positions.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]).sum()).collect();
    let mut force = vec![0.0; steps];
    left_operator(&table, &middles, &mut force);
    let mut total = 0.5;
    for (k, force) in force.iter().enumerate() {
        total -= h * rho * force;
        let found = motion.momenta[k + 1].sum();
        assert!((found - total).abs() < 1e-12, "step {k}: {found} and {total}");
    }
}

#[test]
fn half_order_damping_is_linear_damping_by_backward_differences_of_the_midpoints() {
    // α = ½, BDF 1: (D X)_k = (X_k − X_{k−1})/h with X_{−1} = q₀.
    let (h, rho, steps) = (0.02, 0.7, 2000);
    let (mass, gravity) = (1.5, 9.81);
    let table = weights(1, 1.0, h, steps + 1);
    let damping = node_term::<1, 1>(diagonal(rho), 1.0, Caputo, &table);
    let system =
        System { mass: Mass::diagonal([mass]).unwrap(), potential: Pendulum { gravity }, force: NoForce };
    let motion = integrate(system, gauss::<1>(), damping, h, (vector![2.5], vector![0.3]), steps).unwrap();
    let (mut q, mut p, mut before) = (2.5, 0.3, 2.5);
    for k in 1..=steps {
        let kick = |e: f64| h * gravity * f64::sin(q + 0.5 * e) + rho * (q + 0.5 * e - before);
        let mut e = h * p / mass;
        for _ in 0..60 {
            e = h / mass * (p - 0.5 * kick(e));
        }
        (p, before, q) = (p - kick(e), q + 0.5 * e, q + e);
        let error = max_or_nan((motion.positions[k][0] - q).abs(), (motion.momenta[k][0] - p).abs());
        assert!(error < 1e-11, "step {k}: {error:e}");
    }
}

#[test]
fn every_engine_gives_the_same_motion() {
    let text = "[system]\nmass = [1.0, 2.0]\npotential = \"1.0 - cos(q0) + 0.5*q1^2 + 0.1*(q0 - q1)^2\"\n\
                [[system.damping]]\norder = 0.7\ncoefficient = [[0.4, 0.1], [0.1, 0.2]]\n\
                [[system.damping]]\norder = 0.3\ncoefficient = [0.1, 0.1]\nderivative = \"riemann-liouville\"\n\
                [initial]\nposition = [0.5, -0.25]\nmomentum = [0.0, 1.0]\n\
                [scheme]\nkind = \"galerkin\"\ndegree = 3\n[convolution]\norder = 6\nat = \"nodes\"\n\
                [time]\nstep = 0.05\nsteps = 700\n";
    let plain = states(text, Some(Engine::Direct));
    for engine in [Engine::BlockFft, Engine::RealTime, Engine::ExponentialSum, Engine::ExponentialSumCore] {
        for (k, (found, plain)) in states(text, Some(engine)).iter().zip(&plain).enumerate() {
            let pairs = found.position.iter().zip(&plain.position);
            let pairs = pairs.chain(found.momentum.iter().zip(&plain.momentum));
            let error = pairs.fold(0.0, |error, (a, b)| max_or_nan(error, (a - b).abs()));
            assert!(error < 1e-11, "{engine:?}, step {k}: {error:e}");
        }
    }
}

/// A pendulum in Caputo's sense over 4 units of time.
fn pendulum(steps: usize, more: &str) -> String {
    format!(
        "[system]\nmass = [1.5]\npotential = \"-3*cos(q0)\"\n[[system.damping]]\norder = 0.6\ncoefficient = [0.4]\n\
         [initial]\nposition = [1.0]\nvelocity = [0.0]\n[time]\nstep = {:?}\nsteps = {steps}\n{more}\n",
        4.0 / steps as f64
    )
}

#[test]
fn the_momentum_shown_at_the_main_nodes_is_of_order_two() {
    let main = "[convolution]\nat = \"main-nodes\"\n[output]\nmomentum = ";
    let accurate = "[scheme]\nkind = \"galerkin\"\ndegree = 3\n[convolution]\norder = 5\n";
    let exact = states(&pendulum(256, accurate), None)[256].clone();
    let error = |steps: usize, which: &str| {
        let last = states(&pendulum(steps, &format!("{main}{which}")), None)[steps].clone();
        let of = |a: f64, b: f64| (a - b).abs();
        (of(last.momentum[0], exact.momentum[0]), of(last.energy, exact.energy))
    };
    let order = |which: &str| {
        let ((p, e), (finer_p, finer_e)) = (error(256, which), error(512, which));
        ((p / finer_p).log2(), (e / finer_e).log2())
    };
    let (mean, one_sided) = (order("\"mean\""), order("\"one-sided\""));
    assert!((mean.0 - 2.0).abs() < 0.1 && (mean.1 - 2.0).abs() < 0.1, "{mean:?}");
    assert!((one_sided.0 - 1.0).abs() < 0.1 && (one_sided.1 - 1.0).abs() < 0.1, "{one_sided:?}");
}

#[test]
fn the_mean_momentum_is_half_a_kick_before_the_one_sided_one() {
    let (h, steps) = (0.02, 200);
    let main = "[convolution]\nat = \"main-nodes\"\n[output]\nmomentum = ";
    let mean = states(&pendulum(steps, &format!("{main}\"mean\"")), None);
    let one_sided = states(&pendulum(steps, &format!("{main}\"one-sided\"")), None);
    let path: Vec<f64> = one_sided.iter().map(|state| state.position[0] - 1.0).collect();
    let mut force = vec![0.0; path.len()];
    left_operator(&weights(2, 0.6, h, path.len()), &path, &mut force);
    for (k, (mean, after)) in mean.iter().zip(&one_sided).enumerate() {
        assert_eq!(mean.position, after.position);
        let expected = after.momentum[0] + 0.5 * h * 0.4 * force[k];
        assert!((mean.momentum[0] - expected).abs() < 1e-13, "step {k}");
        let energy = mean.momentum[0].powi(2) / 3.0 - 3.0 * mean.position[0].cos();
        assert!((mean.energy - energy).abs() < 1e-13, "step {k}");
    }
}

/// A number from the environment.
fn from_environment(variable: &str, otherwise: usize) -> usize {
    std::env::var(variable).ok().and_then(|text| text.parse().ok()).unwrap_or(otherwise)
}

/// Σ_r v_r v_rᵀ · 2^power, exact: whole numbers between −3 and 3 make v_r, so that what is semidefinite stays
/// so.
fn gram(vectors: &[Vec<i32>], power: i32) -> Vec<Vec<f64>> {
    let size = vectors.first().map_or(0, Vec::len);
    let entry =
        |i: usize, j: usize| f64::from(vectors.iter().map(|v| v[i] * v[j]).sum::<i32>()) * 2f64.powi(power);
    (0..size).map(|i| (0..size).map(|j| entry(i, j)).collect()).collect()
}

/// Stiffness and damping of any rank: (vectors of K, vectors of ρ, q₀) of 1 to 20 coordinates.
type Stiff = (Vec<Vec<i32>>, Vec<Vec<i32>>, Vec<f64>);

fn stiff_systems() -> impl Strategy<Value = Stiff> {
    (1..=20usize).prop_flat_map(|size| {
        let vectors = || collection::vec(collection::vec(-3..=3i32, size), 1..=size);
        (vectors(), vectors(), collection::vec(-1.0..1.0f64, size))
    })
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: from_environment("PROPTEST_CASES", 24) as u32, failure_persistence: None, ..ProptestConfig::default()
    })]

    /// ½ pᵀM⁻¹p + ½ qᵀKq never rises above its first value, ωh to 10⁶, ρ to 10¹⁰, but for rounding
    /// where such a ρ acts on rounded positions: less than 10⁻³ in 10⁴ steps. `STIFF_STEPS` says over how
    /// many steps.
    #[test]
    fn the_midpoint_rule_from_rest_gains_no_energy_however_stiff(
        (stiffness, damping, position) in stiff_systems(),
        (order, damping_order) in (1..=2usize, prop_oneof![0.01..1.994f64, Just(0.5), Just(1.0), Just(1.5), Just(1.994)]),
        (step, speed, strength) in (-10..=10i32, -7..=18i32, -10..=33i32),
    ) {
        let (h, steps) = (2f64.powi(step), from_environment("STIFF_STEPS", 300));
        let (k, rho) = (gram(&stiffness, 2 * (speed - step)), gram(&damping, strength));
        let size = position.len();
        let terms = (0..size).flat_map(|i| (0..size).map(move |j| (i, j)));
        let potential: String = terms.map(|(i, j)| format!(" + ({:?})*q{i}*q{j}", 0.5 * k[i][j])).collect();
        let potential = potential.trim_start_matches(" + ");
        let (ones, zeros) = (vec![1.0; size], vec![0.0; size]);
        let text = format!(
            "[system]\nmass = {ones:?}\npotential = \"{potential}\"\n[[system.damping]]\norder = {damping_order:?}\ncoefficient = {rho:?}\n\
             [initial]\nposition = {position:?}\nmomentum = {zeros:?}\n[convolution]\norder = {order}\n\
             [time]\nstep = {h:?}\nsteps = {steps}\nenergy_guard = \"off\"\n"
        );
        let document = Document::new("stiff.toml", Path::new("."), &text);
        let scenario = Scenario::from_document(document).map_err(|error| TestCaseError::fail(error.to_string()))?;
        let mut simulation =
            Simulation::new(&scenario, Precision::F64).map_err(|error| TestCaseError::fail(error.to_string()))?;
        let mut state = GridState { position: position.clone(), momentum: position, ..GridState::default() };
        simulation.read(&mut state);
        let first = state.energy;
        // Rounding of q − q₀ acts with the damping's strength, like a spring w₀ρ; of thousands of systems the
        // worst had 23 ε of its energy.
        let strongest = rho.iter().flatten().fold(0.0, |largest: f64, entry| max_or_nan(largest, entry.abs()));
        let spring = strongest * (1.5 / h).powf(damping_order) * size as f64;
        let heat = (1e-7 * steps as f64).max(1e-4);
        let allowed = first * (1.0 + heat) + 48.0 * f64::EPSILON * spring;
        for step in 0..steps {
            simulation.step(&[]).map_err(|error| TestCaseError::fail(format!("step {step}: {error}")))?;
            simulation.read(&mut state);
            prop_assert!(state.energy <= allowed, "step {step}: {:e} after {first:e}", state.energy);
        }
    }
}
