//! Damping at the quadrature nodes with weights of backward differentiation formulas: principle, orders, limits, stability.

use std::collections::HashMap;
use std::path::Path;

use fvi_core::{
    Coefficients, DampingTerm,
    Derivative::{self, Caputo, RiemannLiouville},
    Direct, Fixed, Galerkin, Kernel, Mass, NoForce, NodeGalerkin, Overflow, Potential, Quadratic, Quadrature,
    System, left_operator, right_operator,
};
use fvi_host::language::Document;
use fvi_host::scenario::{Engine, Scenario};
use fvi_host::simulation::{GridState, Precision, Simulation};
use fvi_tests::convergence::observed_order;
use fvi_tests::manufactured::manufactured_errors;
use fvi_tests::motion::{Pendulum, diagonal, integrate, weights};
use fvi_tests::reference;
use fvi_tests::stages::StageMemory;
use nalgebra::{SMatrix, SVector, matrix, vector};

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
fn states(text: &str, engine: Option<Engine>) -> Vec<GridState> {
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

/// m q̈ + ρ D^β q + c q = 0 from q₀ = 1 with the momentum `start`, values against exact ones at t ≥ 1.
struct Oscillator<'a> {
    rows: &'a [HashMap<String, f64>],
    derivative: Derivative,
    start: f64,
}

impl Oscillator<'_> {
    /// Position, momentum and energy, from the response G to an impulse and its integral S.
    fn exact(&self, row: &HashMap<String, f64>) -> [f64; 3] {
        let (m, c) = (row["m"], row["c"]);
        let (q, v) = match self.derivative {
            // Only those terms of the start that the derivative acts on drive the motion.
            Caputo => (1.0 - c * row["S"], -c * row["G"]),
            RiemannLiouville => (m * row["dG"], m * row["ddG"]),
        };
        let (q, p) = (q + self.start * row["G"], m * (v + self.start * row["dG"]));
        [q, p, 0.5 * (p * p / m + c * q * q)]
    }

    /// Largest errors of position, momentum and energy at the times of the table, with n steps a unit.
    fn errors(&self, degree: usize, order: usize, n: usize) -> [f64; 3] {
        let row = &self.rows[0];
        let (m, rho, c, beta) = (row["m"], row["rho"], row["c"], row["beta"]);
        let derivative = if self.derivative == Caputo { "caputo" } else { "riemann-liouville" };
        let motion = states(
            &format!(
                "[system]\nmass = [{m:?}]\npotential = \"0.5*c*q0^2\"\nparameters = {{ c = {c:?} }}\n\
                 [[system.damping]]\norder = {beta:?}\ncoefficient = [{rho:?}]\nderivative = \"{derivative}\"\n\
                 [initial]\nposition = [1.0]\nmomentum = [{:?}]\n[scheme]\nkind = \"galerkin\"\ndegree = {degree}\n\
                 [convolution]\norder = {order}\nat = \"nodes\"\n[time]\nstep = {:?}\nend = 4.0\n",
                self.start,
                1.0 / n as f64
            ),
            None,
        );
        let mut errors = [0.0; 3];
        for row in self.rows.iter().filter(|row| (1.0..=4.0).contains(&row["t"])) {
            let state = &motion[(row["t"] * n as f64) as usize];
            let found = [state.position[0], state.momentum[0], state.energy];
            for ((error, found), exact) in errors.iter_mut().zip(found).zip(self.exact(row)) {
                *error = f64::max(*error, (found - exact).abs());
            }
        }
        errors
    }

    /// Observed orders of position, momentum and energy on the given grids.
    fn orders(&self, degree: usize, order: usize, steps: &[usize]) -> [f64; 3] {
        let sizes: Vec<f64> = steps.iter().map(|&n| 1.0 / n as f64).collect();
        let errors: Vec<[f64; 3]> = steps.iter().map(|&n| self.errors(degree, order, n)).collect();
        [0, 1, 2].map(|quantity| {
            let errors: Vec<f64> = errors.iter().map(|error| error[quantity]).collect();
            observed_order(&sizes, &errors)
        })
    }
}

/// The tables of exact values, a group of rows for each oscillator.
fn oscillators() -> Vec<Vec<HashMap<String, f64>>> {
    let rows = [reference::read("fundamental.csv"), reference::read("fundamental_between.csv")].concat();
    let same = |a: &HashMap<String, f64>, b: &HashMap<String, f64>| {
        ["beta", "m", "rho", "c"].iter().all(|key| a[*key] == b[*key])
    };
    rows.chunk_by(same).map(<[_]>::to_vec).collect()
}

/// Degree and BDF order, steps a unit, and the band of the observed order.
type Case = (usize, usize, &'static [usize], (f64, f64));

const CASES: [Case; 5] = [
    (1, 2, &[64, 128, 256], (1.9, 2.1)),
    (2, 3, &[32, 64, 128], (2.9, 3.1)),
    (2, 4, &[32, 64, 128], (3.8, 4.2)),
    (3, 5, &[16, 32, 64], (4.8, 5.2)),
    (3, 6, &[16, 32], (5.6, 6.9)),
];

fn assert_orders(oscillator: &Oscillator, (degree, order, steps, (least, most)): Case) {
    let row = &oscillator.rows[0];
    for (name, found) in ["q", "p", "E"].into_iter().zip(oscillator.orders(degree, order, steps)) {
        assert!(
            (least..=most).contains(&found),
            "Gauss {degree}, BDF {order}, β = {}, ρ = {}, {:?}, p₀ = {}: order {found:.2} of {name}",
            row["beta"],
            row["rho"],
            oscillator.derivative,
            oscillator.start
        );
    }
}

#[test]
fn the_order_is_the_formulas_for_position_momentum_and_energy() {
    let mut seen = 0;
    for rows in oscillators() {
        // With β > 1 Caputo's derivative takes the initial velocity off.
        let (start, cases) = if rows[0]["beta"] <= 1.0 { (0.5, 5) } else { (0.0, 3) };
        for case in CASES.into_iter().take(cases) {
            assert_orders(&Oscillator { rows: &rows, derivative: Caputo, start }, case);
            seen += 1;
        }
    }
    assert_eq!(seen, 7 * 5 + 2 * 3);
}

#[test]
fn riemann_liouville_damping_converges_from_a_start_that_is_not_zero() {
    // A force singular like t^{−β} for β < 1, an impulse for β = 1, and no function at all beyond: the sums of all formulas have one limit, the
    // motion whose transform is (m q₀ s + p₀)/P(s).
    for rows in oscillators() {
        let oscillator = Oscillator { rows: &rows, derivative: RiemannLiouville, start: 0.5 };
        assert_orders(&oscillator, (1, 1, &[128, 256, 512], (0.9, 1.1)));
        let cases = if rows[0]["beta"] <= 1.0 { 3 } else { 2 };
        for case in CASES.into_iter().take(cases) {
            assert_orders(&oscillator, case);
        }
    }
}

#[test]
fn a_smooth_nonlinear_motion_has_the_order_of_the_formula() {
    fn orders<const S: usize>(order: usize, damping_order: f64, steps: [usize; 2]) -> [f64; 2] {
        let sizes = steps.map(|n| 1.0 / n as f64);
        let errors = steps.map(|n| {
            let table = weights(order, damping_order, 1.0 / n as f64, n + 1);
            let damping = node_term::<1, S>(diagonal(0.5), damping_order, Caputo, &table);
            manufactured_errors(gauss::<S>(), damping, (0.5, damping_order), n)
        });
        [0, 1].map(|quantity| observed_order(&sizes, &errors.map(|error| error[quantity])))
    }
    for damping_order in [0.3, 0.7, 1.0, 1.5] {
        let check = |name: &str, found: [f64; 2], expected: f64| {
            for (quantity, found) in ["q", "p"].into_iter().zip(found) {
                let what = format!("{name}, {quantity}, β = {damping_order}: {found:.2}");
                assert!((found - expected).abs() < 0.1 * expected.sqrt(), "{what}");
            }
        };
        check("Gauss 1, BDF 2", orders::<1>(2, damping_order, [128, 256]), 2.0);
        check("Gauss 2, BDF 3", orders::<2>(3, damping_order, [128, 256]), 3.0);
        check("Gauss 2, BDF 4", orders::<2>(4, damping_order, [64, 128]), 4.0);
        if damping_order <= 1.0 {
            check("Gauss 3, BDF 5", orders::<3>(5, damping_order, [64, 128]), 5.0);
        }
    }
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
    // S = Σ L_d(x) + Σ L_d(y) − h Σ_k ρ (D₋^α X)_k (D₊^α Y)_k under equal variations of x and y that vanish at the ends, X and Y at the
    // midpoints; it is quadratic here, so a central difference is its derivative.
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
        let error = (motion.positions[k][0] - q).abs().max((motion.momenta[k][0] - p).abs());
        assert!(error < 1e-11, "step {k}: {error:e}");
    }
}

/// Numbers in [0, 1) from a congruential generator: the same on every run.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Σ_r b_r b_rᵀ of vectors of small whole numbers, times a power of two near `size`: symmetric and semidefinite without rounding.
    fn matrix(&mut self, coordinates: usize, rank: usize, size: f64) -> Vec<Vec<f64>> {
        let vectors: Vec<Vec<f64>> = (0..rank)
            .map(|_| (0..coordinates).map(|_| (5.0 * self.next()).floor() - 2.0).collect())
            .collect();
        let scale = size.log2().round().exp2();
        let entry = |i: usize, j: usize| scale * vectors.iter().map(|b| b[i] * b[j]).sum::<f64>();
        (0..coordinates).map(|i| (0..coordinates).map(|j| entry(i, j)).collect()).collect()
    }
}

/// Energies of the midpoint rule from rest on a random system, with ωh up to about 10⁶ and a damping force as large.
fn energies(numbers: &mut Numbers, coordinates: usize, steps: usize) -> (String, Vec<f64>) {
    let rank = 1 + (coordinates as f64 * numbers.next()) as usize;
    let (stiff, damped) = (16.0 * numbers.next() - 4.0, 16.0 * numbers.next() - 4.0);
    let stiffness = numbers.matrix(coordinates, coordinates + 1, 10f64.powf(stiff));
    let damping = numbers.matrix(coordinates, rank, 10f64.powf(damped));
    let order = 1 + (2.0 * numbers.next()) as usize;
    let beta = 2.0 * numbers.next();
    let terms: Vec<String> = (0..coordinates)
        .flat_map(|i| (i..coordinates).map(move |j| (i, j)))
        .map(|(i, j)| format!("{:?}*q{i}*q{j}", if i == j { 0.5 * stiffness[i][i] } else { stiffness[i][j] }))
        .collect();
    let position: Vec<f64> = (0..coordinates).map(|_| 2.0 * numbers.next() - 1.0).collect();
    let what = format!(
        "N = {coordinates}, BDF {order}, β = {beta}, K ~ 1e{stiff:.1}, ρ ~ 1e{damped:.1} of rank {rank}"
    );
    let text = format!(
        "[system]\nmass = {:?}\npotential = \"{}\"\n[[system.damping]]\norder = {beta:?}\ncoefficient = {damping:?}\n\
         [initial]\nposition = {position:?}\nmomentum = {:?}\n[convolution]\norder = {order}\nat = \"nodes\"\n\
         [time]\nstep = 1.0\nsteps = {steps}\n",
        vec![1.0; coordinates],
        terms.join(" + ").replace("+ -", "- "),
        vec![0.0; coordinates],
    );
    (what, states(&text, None).iter().map(|state| state.energy).collect())
}

fn assert_never_above_the_first((what, energies): (String, Vec<f64>)) {
    for (k, energy) in energies.iter().enumerate() {
        assert!(
            *energy <= energies[0] * (1.0 + 1e-9),
            "{what}, step {k}: {energy:e} after {:e}",
            energies[0]
        );
    }
}

#[test]
fn the_midpoint_from_rest_never_has_more_energy_than_at_first_whatever_the_stiffness() {
    let mut numbers = Numbers(13);
    for coordinates in (1..=20).chain(1..=6) {
        assert_never_above_the_first(energies(&mut numbers, coordinates, 200));
    }
    for _ in 0..2 {
        assert_never_above_the_first(energies(&mut numbers, 2, 20_000));
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
            let error = pairs.fold(0.0, |error, (a, b)| f64::max(error, (a - b).abs()));
            assert!(error < 1e-11, "{engine:?}, step {k}: {error:e}");
        }
    }
}
