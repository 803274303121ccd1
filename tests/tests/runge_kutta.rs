//! Runge–Kutta convolution quadrature: weights, discrete principle, orders, agreement with independent
//! values.

use fvi_fft::sums::max_or_nan;
use std::collections::HashMap;
use std::path::Path;

use fvi_core::{
    Approach, Derivative::Caputo, Derivative::RiemannLiouville, Instant, Mass, NodeGalerkin, Quadratic,
    RungeKutta, System, TimeForce,
};
use fvi_fft::quadrature::runge_kutta_weights::RungeKuttaWeights;
use fvi_fft::transfer::TransferFunction;
use fvi_scenario::language::Document;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::stability::{
    DampingForm, Discretisation, LinearDamping, LinearSystem, Verdict, check_stability,
};
use fvi_simulation::simulation::{GridState, Precision, Simulation};
use fvi_tests::convergence::observed_order;
use fvi_tests::manufactured::manufactured_errors;
use fvi_tests::motion::{Motion, diagonal, integrate};
use fvi_tests::reference;
use fvi_tests::stages::stage_term;
use nalgebra::{DMatrix, SVector, dmatrix, vector};

/// Runs `$body` with `$method` for each of the methods, `$family` 0 for Radau IIA and 1 for Lobatto IIIC.
macro_rules! for_each_method {
    (|$family:ident, $method:ident| $body:expr) => {{
        {
            let ($family, $method) = (0.0, RungeKutta::<1>::radau_iia().unwrap());
            $body
        }
        {
            let ($family, $method) = (0.0, RungeKutta::<2>::radau_iia().unwrap());
            $body
        }
        {
            let ($family, $method) = (0.0, RungeKutta::<3>::radau_iia().unwrap());
            $body
        }
        {
            let ($family, $method) = (1.0, RungeKutta::<2>::lobatto_iiic().unwrap());
            $body
        }
        {
            let ($family, $method) = (1.0, RungeKutta::<3>::lobatto_iiic().unwrap());
            $body
        }
        {
            let ($family, $method) = (1.0, RungeKutta::<4>::lobatto_iiic().unwrap());
            $body
        }
    }};
}

const ORDERS: [f64; 7] = [-0.5, 0.25, 0.5, 0.9375, 1.0625, 1.5, 1.875];

/// Planes of a table with `stages` stages, read as matrices.
struct Kernel {
    stages: usize,
    planes: Vec<f64>,
}

impl Kernel {
    fn new<const R: usize>(method: &RungeKutta<R>, exponent: f64, count: usize) -> Self {
        let weights = RungeKuttaWeights::new(method, exponent, 0.5, count).unwrap();
        Self { stages: R, planes: weights.planes() }
    }

    fn entry(&self, n: usize, i: usize, j: usize) -> f64 {
        self.planes[(i * self.stages + j) * self.count() + n]
    }

    fn count(&self) -> usize {
        self.planes.len() / (self.stages * self.stages)
    }

    fn size(&self, n: usize) -> f64 {
        self.entries().fold(0.0, |size, (i, j)| max_or_nan(size, self.entry(n, i, j).abs()))
    }

    fn entries(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let stages = self.stages;
        (0..stages * stages).map(move |entry| (entry / stages, entry % stages))
    }
}

#[test]
fn matrix_weights_agree_with_twenty_five_digits_up_to_twenty_thousand() {
    let rows = reference::read("runge_kutta_weights.csv");
    let mut checked = 0;
    for exponent in ORDERS {
        for_each_method!(|family, method| {
            let kernel = Kernel::new(&method, exponent, 20_001);
            let scale = 0.5f64.powf(exponent);
            let belongs = |row: &&HashMap<String, f64>| {
                row["family"] == family && row["stages"] == kernel.stages as f64 && row["beta"] == exponent
            };
            for row in rows.iter().filter(belongs) {
                let (n, i, j) = (row["n"] as usize, row["row"] as usize, row["column"] as usize);
                let error = (kernel.entry(n, i, j) * scale - row["weight"]).abs();
                // W₂ of exponents a little above 1 is what a difference of numbers of the size of W₀ leaves.
                let size = if n == 2 { kernel.size(0) } else { kernel.size(n) };
                assert!(error <= 1e-14 * size * scale, "{family}, {exponent}, {row:?}: {error:e}");
                checked += 1;
            }
        });
    }
    assert_eq!(checked, 7 * 17 * (1 + 4 + 9 + 4 + 9 + 16));
}

/// Largest error of a table's weights against the planes, relative to the largest entry of the weight.
fn largest_error_of_the_table<const R: usize>(method: &RungeKutta<R>, exponent: f64) -> f64 {
    let weights = RungeKuttaWeights::new(method, exponent, 0.5, 100).unwrap();
    let kernel = Kernel::new(method, exponent, 100);
    let table = weights.table::<f64>();
    let table = table.borrow();
    let head = table.head.len() / (R * R);
    let mut largest = 0.0;
    for n in 0..kernel.count() {
        let entry = |i: usize, j: usize| -> f64 {
            match n.checked_sub(head) {
                None => table.head[(i * R + j) * head + n],
                Some(left) => table
                    .terms::<R>()
                    .map(|term| (1.0 - term.decay).powi(left as i32) * term.output[i] * term.input[j])
                    .sum(),
            }
        };
        for (i, j) in kernel.entries() {
            let error = (entry(i, j) - kernel.entry(n, i, j)).abs();
            largest = max_or_nan(largest, error / kernel.size(n).max(f64::MIN_POSITIVE));
        }
    }
    largest
}

#[test]
fn tables_of_exponentials_have_the_weights_of_the_planes() {
    for exponent in [-0.7, -0.1, 0.004, 0.5, 0.83, 1.17, 1.5, 1.96] {
        for_each_method!(|family, method| {
            let error = largest_error_of_the_table(&method, exponent);
            let stages = method.matrix().len();
            assert!(error < 1e-13, "family {family}, {stages} stages, β = {exponent}: {error:e}");
        });
    }
}

#[test]
fn powers_of_the_matrix_symbol_form_a_semigroup() {
    for (a, b) in [(0.25, 0.25), (0.75, 0.75), (0.3, 0.7), (-0.5, 0.5), (0.95, 0.95), (-0.5, 1.5), (1.0, 0.5)]
    {
        for_each_method!(|_family, method| {
            let count = 100;
            let (left, right, sum) = (
                Kernel::new(&method, a, count),
                Kernel::new(&method, b, count),
                Kernel::new(&method, a + b, count),
            );
            for k in 0..count {
                let size: f64 = (0..=k).map(|n| left.size(n) * right.size(k - n)).sum();
                for (i, j) in sum.entries() {
                    let terms = (0..=k).flat_map(|n| (0..sum.stages).map(move |l| (n, l)));
                    let product: f64 =
                        terms.map(|(n, l)| left.entry(n, i, l) * right.entry(k - n, l, j)).sum();
                    let error = (product - sum.entry(k, i, j)).abs();
                    assert!(error <= 1e-14 * size, "{a} + {b}, {} stages, n = {k}: {error:e}", sum.stages);
                }
            }
        });
    }
}

/// Σ_k Σ_i b_i (D₋^α X)_{k,i} (D₊^α Y)_{k,i}, the advanced operator being (D₊Y)_k = Σ_n B⁻¹ W_nᵀ B Y_{k+n}.
fn restricted_action(half: &Kernel, b: &[f64], x: &[Vec<f64>], y: &[Vec<f64>]) -> f64 {
    let (steps, stages) = (x.len(), half.stages);
    let mut action = 0.0;
    for k in 0..steps {
        for i in 0..stages {
            let (mut retarded, mut advanced) = (0.0, 0.0);
            for j in 0..stages {
                retarded += (0..=k).map(|n| half.entry(n, i, j) * x[k - n][j]).sum::<f64>();
                advanced +=
                    (0..steps - k).map(|n| b[j] / b[i] * half.entry(n, j, i) * y[k + n][j]).sum::<f64>();
            }
            action += b[i] * retarded * advanced;
        }
    }
    action
}

#[test]
fn the_restricted_variation_of_the_action_gives_the_force_at_the_stages() {
    // δX = δY = δ: the variation is Σ_k Σ_i b_i ((D₋^{2α} X) + (D₊^{2α} Y))_{k,i} δ_{k,i}, by the semigroup
    // and the adjoint.
    for alpha in [0.25, 0.5, 0.75] {
        for_each_method!(|_family, method| {
            let steps = 12;
            let (half, whole) =
                (Kernel::new(&method, alpha, steps), Kernel::new(&method, 2.0 * alpha, steps));
            let (b, stages) = (method.quadrature().weights(), whole.stages);
            let path = |a: f64, c: f64| -> Vec<Vec<f64>> {
                (0..steps)
                    .map(|k| (0..stages).map(|i| (a * k as f64 + c * i as f64).sin()).collect())
                    .collect()
            };
            let (x, y, delta) = (path(0.7, 0.3), path(1.9, 0.8), path(2.3, 1.1));
            let moved = |path: &[Vec<f64>], by: f64| -> Vec<Vec<f64>> {
                let rows = path.iter().zip(&delta);
                rows.map(|(row, d)| row.iter().zip(d).map(|(x, d)| x + by * d).collect()).collect()
            };
            // The action is quadratic, so a central difference is its derivative.
            let variation = 0.5
                * (restricted_action(&half, b, &moved(&x, 1.0), &moved(&y, 1.0))
                    - restricted_action(&half, b, &moved(&x, -1.0), &moved(&y, -1.0)));
            let (mut expected, mut size) = (0.0, 0.0);
            for k in 0..steps {
                for i in 0..stages {
                    for j in 0..stages {
                        for n in 0..=k {
                            let forces = [
                                b[i] * whole.entry(n, i, j) * x[k - n][j] * delta[k][i],
                                b[i] * whole.entry(n, i, j) * y[k][i] * delta[k - n][j],
                            ];
                            expected += forces.iter().sum::<f64>();
                            size += forces.iter().map(|force| force.abs()).sum::<f64>();
                        }
                    }
                }
            }
            assert!((variation - expected).abs() <= 1e-14 * size, "{alpha}: {variation} and {expected}");
        });
    }
}

/// q̈ + q + ρ D^β q = f from rest or with p₀ = 1, degree S, Riemann–Liouville memory.
fn linear<const S: usize, const R: usize>(
    method: &RungeKutta<R>,
    (mass, rho, stiffness, damping_order): (f64, f64, f64, f64),
    momentum: f64,
    force: impl Fn(Instant<f64>) -> f64,
    step_size: f64,
    steps: usize,
) -> Motion<1> {
    let system = System {
        mass: Mass::diagonal([mass]).unwrap(),
        potential: Quadratic::diagonal([stiffness]).unwrap(),
        force: TimeForce(|instant| SVector::from([force(instant)])),
    };
    let damping = stage_term(method, diagonal(rho), damping_order, RiemannLiouville, step_size, steps);
    let scheme = NodeGalerkin::<f64, S, R>::with_stages(method).unwrap();
    integrate(system, scheme, damping, step_size, (vector![0.0], vector![momentum]), steps).unwrap()
}

/// 8 on [0, 1], seen from inside the step by nodes on its end.
fn pulse(instant: Instant<f64>) -> f64 {
    let on = match instant.approach {
        Approach::FromRight => instant.time < 1.0 - 1e-9,
        Approach::FromLeft => instant.time < 1.0 + 1e-9,
        Approach::Inside => instant.time < 1.0,
    };
    if on { 8.0 } else { 0.0 }
}

#[test]
fn the_plate_under_a_pulse_is_met_to_nine_digits_with_600_steps() {
    // Radau IIA, three stages, degree 3. The jump lies on a grid point, where the last node of the step
    // before sees the pulse and the first of a Lobatto method does not.
    fn error<const S: usize, const R: usize>(method: &RungeKutta<R>) -> (f64, f64) {
        let motion = linear::<S, R>(method, (1.0, 1.0, 1.0, 1.5), 0.0, pulse, 0.05, 600);
        let rows = reference::read("bagley_torvik_pulse.csv");
        rows.iter().filter(|row| row["t"] >= 1.0).fold((0.0, 0.0), |(q, p), row| {
            let k = (row["t"] / 0.05).round() as usize;
            let (x, v) = (motion.positions[k][0] - row["x"], motion.momenta[k][0] - row["v"]);
            (max_or_nan(q, x.abs()), max_or_nan(p, v.abs()))
        })
    }
    let radau = error::<3, 3>(&RungeKutta::radau_iia().unwrap());
    assert!(radau.0 < 1e-8 && radau.1 < 2e-6, "{radau:?}");
    let lobatto = error::<3, 4>(&RungeKutta::lobatto_iiic().unwrap());
    assert!(lobatto.0 < 2e-9 && lobatto.1 < 1e-6, "{lobatto:?}");
}

#[test]
fn free_oscillations_are_met_to_ten_digits_with_64_steps_a_unit() {
    // q₀ = 0, p₀ = m v₀: q = m v₀ G(t). At β = 3/2 the motion starts like t^{5/2}, which leaves 10⁻⁹.
    let rows = reference::read("fundamental.csv");
    let mut problems = 0;
    for group in rows.chunk_by(|a, b| ["beta", "m", "rho", "c"].iter().all(|key| a[*key] == b[*key])) {
        let (beta, m, rho, c) = (group[0]["beta"], group[0]["m"], group[0]["rho"], group[0]["c"]);
        let radau = RungeKutta::<3>::radau_iia().unwrap();
        let lobatto = RungeKutta::<4>::lobatto_iiic().unwrap();
        let (h, steps, parameters) = (1.0 / 64.0, 1280, (m, rho, c, beta));
        let motions = [
            linear::<3, 3>(&radau, parameters, m, |_| 0.0, h, steps),
            linear::<3, 4>(&lobatto, parameters, m, |_| 0.0, h, steps),
        ];
        let allowed = if beta <= 1.0 { [1e-11, 1e-12] } else { [1e-9, 1e-11] };
        for (motion, allowed) in motions.iter().zip(allowed) {
            for row in group.iter().filter(|row| row["t"] >= 1.0 && row["t"] <= 20.0) {
                let k = (row["t"] / h).round() as usize;
                let error = (motion.positions[k][0] - m * row["G"]).abs();
                assert!(error <= allowed, "β = {beta}, ρ = {rho}, t = {}: {error:e}", row["t"]);
            }
        }
        problems += 1;
    }
    assert_eq!(problems, 6);
}

/// Observed orders of position and momentum. One stage needs more steps until the lowest order shows.
fn orders<const S: usize, const R: usize>(method: &RungeKutta<R>, damping_order: f64) -> [f64; 2] {
    let steps = if R == 1 { [1024, 2048, 4096] } else { [16, 32, 64] };
    let step_sizes = steps.map(|n| 1.0 / n as f64);
    let errors = steps.map(|n| {
        let damping = stage_term(method, diagonal(0.5), damping_order, Caputo, 1.0 / n as f64, n);
        let scheme = NodeGalerkin::<f64, S, R>::with_stages(method).unwrap();
        manufactured_errors(scheme, damping, (0.5, damping_order), n)
    });
    [0, 1].map(|quantity| observed_order(&step_sizes, &errors.map(|error| error[quantity])))
}

#[test]
fn stage_damped_schemes_have_their_orders_on_a_smooth_nonlinear_motion() {
    // With u the order of the Runge–Kutta method and w its stage order (Radau IIA: 2R − 1 and R; Lobatto
    // IIIC: 2R − 2 and R − 1) the positions are of order min(u, w + 3 − β) and the momenta of order min(u,
    // w + 2 − β): the quadrature of D^β at the stages loses β of the order w + 1 of a stage, and each
    // integration over time wins one back. For β = 1 the quadrature is the Runge–Kutta method itself, which
    // has the order u in both.
    for damping_order in [0.3, 0.5, 1.0, 1.5, 1.9] {
        let check = |name: &str, found: [f64; 2], order: f64, stage_order: f64| {
            let expected = if damping_order == 1.0 {
                [order; 2]
            } else {
                [3.0, 2.0].map(|won| order.min(stage_order + won - damping_order))
            };
            for (quantity, (found, expected)) in ["q", "p"].into_iter().zip(found.into_iter().zip(expected)) {
                let what = format!("{name}, {quantity}, β = {damping_order}: {found:.2} for {expected:.2}");
                // Two parts of the error, of nearly the same order and of opposite sign, cancel at some step
                // sizes: what is seen there is above or below.
                let allowed = match (name, quantity) {
                    ("Lobatto 3", "p") | ("Lobatto 4", "q") if damping_order < 1.0 => 0.9,
                    _ => 0.3,
                };
                assert!((found - expected).abs() < allowed, "{what}");
            }
        };
        check("Radau 1", orders::<1, 1>(&RungeKutta::radau_iia().unwrap(), damping_order), 1.0, 1.0);
        check("Radau 2", orders::<2, 2>(&RungeKutta::radau_iia().unwrap(), damping_order), 3.0, 2.0);
        check("Radau 3", orders::<3, 3>(&RungeKutta::radau_iia().unwrap(), damping_order), 5.0, 3.0);
        check("Lobatto 2", orders::<1, 2>(&RungeKutta::lobatto_iiic().unwrap(), damping_order), 2.0, 1.0);
        check("Lobatto 3", orders::<2, 3>(&RungeKutta::lobatto_iiic().unwrap(), damping_order), 4.0, 2.0);
        check("Lobatto 4", orders::<3, 4>(&RungeKutta::lobatto_iiic().unwrap(), damping_order), 6.0, 3.0);
    }
}

/// Largest stable step of q̈ + q + 2 D^β q = 0, if there is any, and the sizes that the motion reaches with
/// steps that are a little shorter (900 of them) and longer (250).
fn limit<const S: usize, const R: usize>(
    method: &RungeKutta<R>,
    damping_order: f64,
) -> Option<(f64, [f64; 2])> {
    let damping = vec![LinearDamping {
        coefficients: dmatrix![2.0],
        transfer: TransferFunction::power(damping_order).unwrap(),
    }];
    let system = LinearSystem::new(&dmatrix![1.0], &dmatrix![1.0], damping).unwrap();
    let rule = method.quadrature();
    let discretisation = Discretisation {
        degree: S,
        nodes: rule.nodes().to_vec(),
        weights: rule.weights().to_vec(),
        form: DampingForm::Stages { matrix: DMatrix::from_fn(R, R, |i, j| method.matrix()[i][j]) },
    };
    let verdict = check_stability(&discretisation, &system, 100.0, 1000);
    let Verdict::Unstable { largest_stable_step: Some(largest_stable_step) } = verdict else { return None };
    let size = |(factor, steps): (f64, usize)| {
        let (h, parameters) = (factor * largest_stable_step, (1.0, 2.0, 1.0, damping_order));
        let motion = linear::<S, R>(method, parameters, 1.0, |_| 0.0, h, steps);
        motion.first_positions().iter().fold(0.0, |largest, q| max_or_nan(largest, q.abs()))
    };
    Some((largest_stable_step, [(0.95, 900), (1.05, 250)].map(size)))
}

#[test]
fn the_limit_of_the_step_with_damping_at_the_stages_is_sharp() {
    for damping_order in [0.5, 1.0, 1.5] {
        let assert_sharp = |found: Option<(f64, [f64; 2])>, name: &str| {
            let (step, [below, above]) = found.expect("a limit");
            assert!(
                below < 10.0 && above > 100.0,
                "{name}, β = {damping_order}, h = {step}: {below:e}, {above:e}"
            );
        };
        assert_sharp(limit::<1, 1>(&RungeKutta::radau_iia().unwrap(), damping_order), "Radau 1");
        assert_sharp(limit::<2, 2>(&RungeKutta::radau_iia().unwrap(), damping_order), "Radau 2");
        assert_sharp(limit::<3, 3>(&RungeKutta::radau_iia().unwrap(), damping_order), "Radau 3");
    }
}

/// Largest errors of q and p over all grid points of q″ + D^{3/2} q + q = f with the solution t^ν.
fn errors_on_a_power(power: f64, steps: usize) -> [f64; 2] {
    let text = format!(
        r#"
        [system]
        mass = [1.0]
        potential = "0.5*q0^2"
        force = ["nu*(nu - 1)*t^(nu - 2) + gamma(nu + 1)/gamma(nu - 1/2)*t^(nu - 3/2) + t^nu"]
        parameters = {{ nu = {power:?} }}
        [[system.damping]]
        order = 1.5
        coefficient = [1.0]
        [initial]
        position = [0.0]
        momentum = [0.0]
        [scheme]
        kind = "galerkin"
        degree = 3
        [convolution]
        family = "radau-iia"
        stages = 3
        [time]
        step = {:?}
        steps = {steps}
        "#,
        1.0 / steps as f64
    );
    let scenario = Scenario::from_document(Document::new("power.toml", Path::new("."), &text)).unwrap();
    let mut simulation = Simulation::new(&scenario, Precision::F64).unwrap();
    let mut state = GridState { position: vec![0.0], momentum: vec![0.0], ..GridState::default() };
    let mut errors = [0.0_f64; 2];
    for _ in 0..steps {
        simulation.step(&[]).unwrap();
        simulation.read(&mut state);
        let exact = [state.time.powf(power), power * state.time.powf(power - 1.0)];
        for (error, (found, exact)) in
            errors.iter_mut().zip([state.position[0], state.momentum[0]].into_iter().zip(exact))
        {
            *error = max_or_nan(*error, (found - exact).abs());
        }
    }
    errors
}

#[test]
fn forces_like_roots_of_time_leave_the_error_that_exact_moments_leave() {
    for row in reference::read("power_plate.csv") {
        let (power, steps) = (row["power"], row["steps"] as usize);
        let found = errors_on_a_power(power, steps);
        for (found, expected) in found.into_iter().zip([row["position"], row["momentum"]]) {
            assert!(
                (found - expected).abs() < 1e-3 * expected,
                "t^{power}, {steps} steps: {found:e} and {expected:e}"
            );
        }
    }
}
