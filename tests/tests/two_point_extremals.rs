//! Discrete extremals: closed forms, agreement of the solvers, minima, and iterations that stay bounded as
//! the grid grows.

use fvi_core::{BdfOrder, ConvolutionWeights};
use fvi_exhibits::two_point::{
    Closures, EmbeddedProblem, ExpressionLagrangian, ExtremalProblem, Functional, Grid, Lagrangian, Method,
    NewtonOptions, OperatorEquation, Product, Sigma, Solution, Term,
};
use fvi_fft::sums::max_or_nan;
use fvi_scenario::language::expression::{Expression, Symbols};
use fvi_tests::reference;
use proptest::prelude::*;

fn lagrangian(text: &str, coordinates: usize) -> ExpressionLagrangian {
    let symbols = Symbols::new().with_time().with_variables(ExpressionLagrangian::variables(coordinates));
    ExpressionLagrangian::new(Expression::parse(text, &symbols).unwrap(), coordinates).unwrap()
}

fn solve(
    lagrangian: &dyn Lagrangian,
    grid: Grid,
    sigma: Sigma,
    alpha: f64,
    ends: [&[f64]; 2],
    method: Method,
) -> Solution {
    let problem = ExtremalProblem::new(lagrangian, grid, sigma, alpha, ends[0], ends[1]).unwrap();
    let extremal = problem.with_method(method).solve().unwrap();
    assert!(
        extremal.residual <= 32.0 * extremal.rounding_level,
        "residual {} above rounding {}",
        extremal.residual,
        extremal.rounding_level
    );
    extremal
}

fn largest_difference(first: &[f64], second: &[f64]) -> f64 {
    assert_eq!(first.len(), second.len());
    first.iter().zip(second).fold(0.0, |a: f64, (b, c)| max_or_nan(a, (b - c).abs()))
}

/// log₂ of the ratios of successive errors.
fn orders(errors: &[f64]) -> Vec<f64> {
    errors.windows(2).map(|pair| (pair[0] / pair[1]).log2()).collect()
}

#[test]
fn the_path_of_least_fractional_speed_is_the_discrete_closed_form() {
    // With V = T Q and Q_N fixed, ½‖V‖² is least for V_j ∝ g_{N−j}, g the weights of the inverse of T.
    let free = lagrangian("0.5*v0^2", 1);
    for alpha in [0.55, 0.75, 0.9] {
        for (steps, method) in [(100, Method::Dense), (100, Method::Krylov), (1000, Method::Krylov)] {
            let grid = Grid::new(0.0, 1.0, steps).unwrap();
            let weights = ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, -alpha, grid.step()).unwrap();
            let g: Vec<f64> = weights.take(steps).collect();
            let squares: f64 = g.iter().map(|weight| weight * weight).sum();
            let exact = |k: usize| (1..=k).map(|j| g[k - j] * g[steps - j]).sum::<f64>() / squares;
            let expected: Vec<f64> = (0..=steps).map(exact).collect();
            let extremal = solve(&free, grid, Sigma::Minus, alpha, [&[0.0], &[1.0]], method);
            assert!(largest_difference(&extremal.positions, &expected) < 1e-13, "{alpha} {steps} {method:?}");
            assert!((extremal.value.unwrap() - 0.5 * grid.step() / squares).abs() < 1e-13);
        }
    }
}

#[test]
fn the_path_of_least_fractional_speed_converges_with_order_2_alpha_minus_1() {
    // The solution behaves like (1 − t)^(2α−1) near the end. Measured at 1024 to 8192 steps: 0.15 (falling
    // slowly towards 0.1) for α = 0.55, 0.50 for 0.75, 0.80 for 0.9.
    let free = lagrangian("0.5*v0^2", 1);
    let table = reference::read("extremal_least_fractional_speed.csv");
    for (alpha, low, high) in [(0.55, 0.1, 0.16), (0.75, 0.49, 0.52), (0.9, 0.78, 0.86)] {
        let known: Vec<(f64, f64)> =
            table.iter().filter(|row| row["alpha"] == alpha).map(|row| (row["t"], row["x"])).collect();
        assert_eq!(known.len(), 65);
        let error = |steps: usize| {
            let grid = Grid::new(0.0, 1.0, steps).unwrap();
            let extremal = solve(&free, grid, Sigma::Minus, alpha, [&[0.0], &[1.0]], Method::Krylov);
            let at = |&(t, x): &(f64, f64)| extremal.positions[(t * steps as f64) as usize] - x;
            known.iter().map(at).fold(0.0, |a: f64, b| max_or_nan(a, b.abs()))
        };
        let errors: Vec<f64> = [1024, 2048, 4096, 8192].map(error).to_vec();
        for order in orders(&errors) {
            assert!(low < order && order < high, "alpha = {alpha}: {errors:?} {order}");
        }
    }
    // α = 1: the straight line, exactly.
    let grid = Grid::new(0.0, 1.0, 1000).unwrap();
    let line: Vec<f64> = (0..=1000).map(|k| grid.time(k)).collect();
    let extremal = solve(&free, grid, Sigma::Minus, 1.0, [&[0.0], &[1.0]], Method::Krylov);
    assert!(largest_difference(&extremal.positions, &line) < 1e-14);
}

#[test]
fn the_power_law_converges_with_order_one() {
    // Grünwald–Letnikov is of first order. For α = 0.55 the order climbs from 0.95 towards 1; for α = 1 and
    // b = 2 the error of the one-sided difference is constant and the end points remove it.
    let power = 2.0;
    for (alpha, low, high) in [(0.55, 0.93, 1.0), (0.75, 0.96, 1.0), (0.9, 0.97, 1.01)] {
        let factor = libm::tgamma(power + 1.0) / libm::tgamma(power + 1.0 - alpha);
        let text = format!("0.5*(v0 - {factor}*t^{})^2", power - alpha);
        let shifted = lagrangian(&text, 1);
        let error = |steps: usize| {
            let grid = Grid::new(0.0, 1.0, steps).unwrap();
            let exact: Vec<f64> = (0..=steps).map(|k| grid.time(k).powf(power)).collect();
            let extremal = solve(&shifted, grid, Sigma::Minus, alpha, [&[0.0], &[1.0]], Method::Krylov);
            largest_difference(&extremal.positions, &exact)
        };
        let errors: Vec<f64> = [1024, 2048, 4096, 8192].map(error).to_vec();
        for order in orders(&errors) {
            assert!(low < order && order < high, "alpha = {alpha}: {errors:?} {order}");
        }
    }
    let classical = lagrangian("0.5*(v0 - 2*t)^2", 1);
    let grid = Grid::new(0.0, 1.0, 512).unwrap();
    let exact: Vec<f64> = (0..=512).map(|k| grid.time(k).powi(2)).collect();
    let extremal = solve(&classical, grid, Sigma::Minus, 1.0, [&[0.0], &[1.0]], Method::Krylov);
    assert!(largest_difference(&extremal.positions, &exact) < 1e-13);
}

#[test]
fn order_one_gives_the_classical_boundary_value_problem() {
    // (Q_{k+1} − 2Q_k + Q_{k−1})/h² + Q_k = 0 has the solution sin(kθ)/sin(Nθ) with 2 − 2 cos θ = h². The
    // functional is indefinite here (the interval is longer than π).
    let oscillator = Closures::new(
        1,
        |_t, x: &[f64], v: &[f64]| 0.5 * (v[0] * v[0] - x[0] * x[0]),
        |_t, x: &[f64], v: &[f64], out: &mut [f64]| out.copy_from_slice(&[-x[0], v[0]]),
        |_t, _x: &[f64], _v: &[f64], out: &mut [f64]| out.copy_from_slice(&[-1.0, 0.0, 0.0, 1.0]),
    );
    for (steps, method) in [(64, Method::Dense), (64, Method::Krylov), (2000, Method::Krylov)] {
        let grid = Grid::new(1.0, 5.5, steps).unwrap();
        let angle = 2.0 * (0.5 * grid.step()).asin();
        let exact: Vec<f64> =
            (0..=steps).map(|k| (k as f64 * angle).sin() / (steps as f64 * angle).sin()).collect();
        for sigma in [Sigma::Minus, Sigma::Plus] {
            let extremal = solve(&oscillator, grid, sigma, 1.0, [&[0.0], &[1.0]], method);
            assert!(largest_difference(&extremal.positions, &exact) < 1e-11, "{steps} {method:?} {sigma:?}");
        }
    }
}

const PROBLEMS: [(&str, usize); 5] = [
    ("0.5*v0^2 + 0.5*x0^2", 1),
    ("0.5*v0^2 - 2*x0^2 + t*x0", 1),
    ("0.5*(1 + t)*v0^2 + 0.3*x0*v0 + 2*x0^2", 1),
    ("0.5*v0^2 + 0.1*v0^4 + cos(2*x0)", 1),
    ("0.5*(1 + 0.5*t)*v0^2 + 0.5*v1^2 + 0.3*v0*v1 + 0.2*x0*v1 + 0.5*x0^2 - cos(x0 - 2*x1)", 2),
];

#[test]
fn the_matrix_free_solver_agrees_with_the_dense_one() {
    for (text, coordinates) in PROBLEMS {
        let lagrangian = lagrangian(text, coordinates);
        let (start, end) = (&[0.2, -0.1][..coordinates], &[1.0, 0.5][..coordinates]);
        for sigma in [Sigma::Minus, Sigma::Plus] {
            for (steps, alpha) in [(2, 0.5), (3, 0.8), (40, 0.6), (100, 0.9), (100, 1.0)] {
                let grid = Grid::new(0.5, 2.0, steps).unwrap();
                let dense = solve(&lagrangian, grid, sigma, alpha, [start, end], Method::Dense);
                let krylov = solve(&lagrangian, grid, sigma, alpha, [start, end], Method::Krylov);
                let place = format!("{text} {sigma:?} {steps} {alpha}");
                assert!(largest_difference(&dense.positions, &krylov.positions) < 1e-11, "{place}");
                let largest = dense.velocities.iter().fold(1.0, |a: f64, v| max_or_nan(a, v.abs()));
                assert!(
                    largest_difference(&dense.velocities, &krylov.velocities) < 1e-10 * largest,
                    "{place}"
                );
                let (first, second) = (dense.value.unwrap(), krylov.value.unwrap());
                assert!((first - second).abs() < 1e-11 * first.abs().max(1.0), "{place}");
            }
        }
    }
}

#[test]
fn the_two_sides_mirror_each_other() {
    let plain = lagrangian("0.5*(1 + t)*v0^2 + 0.3*x0*v0 + 0.1*v0^3 + exp(x0)", 1);
    let mirrored = lagrangian("0.5*(2 - t)*v0^2 - 0.3*x0*v0 - 0.1*v0^3 + exp(x0)", 1);
    let grid = Grid::new(0.0, 1.0, 300).unwrap();
    let minus = solve(&plain, grid, Sigma::Minus, 0.8, [&[0.0], &[0.5]], Method::Krylov);
    let mut plus = solve(&mirrored, grid, Sigma::Plus, 0.8, [&[0.5], &[0.0]], Method::Krylov);
    plus.positions.reverse();
    plus.velocities.reverse();
    plus.velocities.iter_mut().for_each(|v| *v = -*v);
    assert!(largest_difference(&minus.positions, &plus.positions) < 1e-12);
    assert!(largest_difference(&minus.velocities, &plus.velocities) < 1e-10);
}

#[test]
fn the_velocities_are_the_operator_of_the_positions() {
    let lagrangian = lagrangian("0.5*v0^2 + cos(2*x0)", 1);
    for sigma in [Sigma::Minus, Sigma::Plus] {
        let grid = Grid::new(0.0, 1.0, 500).unwrap();
        let extremal = solve(&lagrangian, grid, sigma, 0.7, [&[0.5], &[1.0]], Method::Krylov);
        let velocities = Functional::new(&lagrangian, grid, sigma, 0.7, Product::Sums)
            .unwrap()
            .velocities(&extremal.positions);
        let largest = velocities.iter().fold(0.0, |a: f64, v| max_or_nan(a, v.abs()));
        assert!(largest_difference(&velocities, &extremal.velocities) < 1e-11 * largest, "{sigma:?}");
    }
}

#[test]
fn iterations_do_not_grow_with_the_grid() {
    // The largest grid has 10⁵ points: its dense matrix would take 80 GB.
    for (text, most_per_newton_step, largest) in [
        ("0.5*v0^2", 2, 100_000),
        ("0.5*v0^2 + 0.5*x0^2", 8, 100_000),
        ("0.5*v0^2 + 50*x0^2", 28, 20_000),
        ("0.5*v0^2 - 2*x0^2", 12, 20_000),
    ] {
        let lagrangian = lagrangian(text, 1);
        for (alpha, all_steps) in [(0.6, &[1_000, largest][..]), (1.0, &[1_000, 10_000][..])] {
            for &steps in all_steps {
                let grid = Grid::new(0.0, 1.0, steps).unwrap();
                let extremal =
                    solve(&lagrangian, grid, Sigma::Minus, alpha, [&[0.5], &[1.0]], Method::Krylov);
                assert!(extremal.newton_iterations <= 4, "{text} {alpha} {steps}");
                // One more solution than Newton steps when the last step gains nothing and is not taken.
                let limit = most_per_newton_step * (extremal.newton_iterations + 1);
                assert!(extremal.krylov_iterations <= limit, "{text} {alpha} {steps}");
            }
        }
    }
}

/// Two coordinates, nonlinear, with a factor: (1 + x0²)·ẍ0 + d/dt(x0 − x1) + x1 = 0,
/// ẍ1 + cos(t)·ẋ0 + sinh(x1) = 0.
fn coupled_equation() -> OperatorEquation {
    let symbols = Symbols::new().with_time().with_variables(OperatorEquation::variables(2));
    let parse = |text: &str| Expression::parse(text, &symbols).unwrap();
    let term = |factor: Option<&str>, order, of: [&str; 2]| Term {
        factor: factor.map(parse),
        order,
        of: of.map(parse).to_vec(),
    };
    let terms = vec![
        term(Some("1 + x0^2"), 2, ["x0", "0"]),
        term(None, 2, ["0", "x1"]),
        term(None, 1, ["x0 - x1", "0"]),
        term(Some("cos(t)"), 1, ["0", "x0"]),
        term(None, 0, ["x1", "sinh(x1)"]),
    ];
    OperatorEquation::new(terms, 2).unwrap()
}

#[test]
fn embedded_equations_are_solved_to_rounding_with_quadratic_convergence() {
    let equation = coupled_equation();
    for sigma in [Sigma::Minus, Sigma::Plus] {
        for steps in [2, 3, 1000] {
            let grid = Grid::new(0.0, 1.0, steps).unwrap();
            let problem = EmbeddedProblem::new(&equation, grid, sigma, &[0.2, -0.3], &[1.0, 0.5]).unwrap();
            let solution = problem.solve(&mut |_, _| ()).unwrap();
            let left_sides = equation.embedding(&grid, sigma, &solution.positions);
            let largest = left_sides.iter().fold(0.0, |a: f64, b| max_or_nan(a, b.abs()));
            assert_eq!(largest, solution.residual);
            assert!(largest <= 8.0 * solution.rounding_level, "{sigma:?} {steps}: {largest}");
            assert!(solution.newton_iterations <= 7, "{sigma:?} {steps}: {:?}", solution.history);
        }
    }
}

#[test]
fn a_poor_start_is_rescued_by_decreasing_the_functional() {
    // From a straight line that leaves the wells no shortened Newton step reduces the residual for long.
    let wells = lagrangian("0.5*v0^2 + 0.1*v0^4 + 2*(x0^2 - 1)^2", 1);
    for (steps, method) in [(60, Method::Dense), (60, Method::Krylov), (300, Method::Krylov)] {
        let grid = Grid::new(0.0, 4.0, steps).unwrap();
        let line: Vec<f64> = (0..=steps).map(|k| 0.5 * grid.time(k) - 1.0).collect();
        let problem = ExtremalProblem::new(&wells, grid, Sigma::Minus, 0.8, &[-1.0], &[1.0]).unwrap();
        let extremal = problem.with_method(method).with_guess(line).unwrap().solve().unwrap();
        assert!(extremal.residual <= 32.0 * extremal.rounding_level, "{method:?} {steps}");
    }
}

#[test]
fn an_iteration_that_ends_too_early_keeps_its_best_iterate() {
    let lagrangian = lagrangian("0.5*v0^2 + 0.1*v0^4 + cos(2*x0)", 1);
    let grid = Grid::new(0.0, 1.0, 400).unwrap();
    let options = NewtonOptions { iterations: 1, ..NewtonOptions::default() };
    for method in [Method::Dense, Method::Krylov] {
        let problem = ExtremalProblem::new(&lagrangian, grid, Sigma::Minus, 0.7, &[0.5], &[1.0]).unwrap();
        let error = problem.with_method(method).with_options(options).solve().unwrap_err();
        let best = error.best;
        assert_eq!(best.newton_iterations, 1);
        assert!(best.relative_residual < best.history[0] && best.relative_residual > options.tolerance);
        assert_eq!((best.positions[0], best.positions[400]), (0.5, 1.0));
    }
}

#[test]
fn a_lagrangian_that_is_not_finite_on_the_way_is_no_convergence() {
    let lagrangian = lagrangian("0.5*v0^2 + log(x0)", 1);
    let grid = Grid::new(0.0, 1.0, 50).unwrap();
    let problem = ExtremalProblem::new(&lagrangian, grid, Sigma::Minus, 0.7, &[-1.0], &[1.0]).unwrap();
    let best = problem.solve().unwrap_err().best;
    assert_eq!(best.newton_iterations, 0);
    assert_eq!(best.positions.len(), 51);
}

#[test]
fn what_is_outside_the_problem_is_refused() {
    let free = lagrangian("0.5*v0^2", 1);
    let grid = Grid::new(0.0, 1.0, 10).unwrap();
    for alpha in [0.0, -0.5, 1.0 + 1e-15, f64::NAN] {
        assert!(ExtremalProblem::new(&free, grid, Sigma::Minus, alpha, &[0.0], &[1.0]).is_err(), "{alpha}");
    }
    assert!(ExtremalProblem::new(&free, grid, Sigma::Minus, 0.5, &[0.0, 0.0], &[1.0]).is_err());
    assert!(ExtremalProblem::new(&free, grid, Sigma::Minus, 0.5, &[0.0], &[f64::NAN]).is_err());
    for (start, end, steps) in [(0.0, 0.0, 4), (1.0, 0.0, 4), (0.0, f64::INFINITY, 4), (0.0, 1.0, 1)] {
        assert!(Grid::new(start, end, steps).is_err(), "{start} {end} {steps}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn extremals_of_convex_quadratic_lagrangians_are_minima(
        (l, m, n) in (-1.0..1.0, -1.0..1.0, 0.05..1.0),
        (c, d) in (-2.0..2.0, -2.0..2.0),
        (steps, alpha) in (2..60_usize, 0.05..1.0),
        (sigma, method) in (
            prop_oneof![Just(Sigma::Minus), Just(Sigma::Plus)],
            prop_oneof![Just(Method::Dense), Just(Method::Krylov)],
        ),
        ends in (-1.0..1.0, -1.0..1.0),
        perturbation in prop::collection::vec(-1.0..1.0, 61),
    ) {
        // ½|(l x + m v, n v)|², positive semidefinite in x and definite in v, and linear terms.
        let text = format!("0.5*(({l})*x0 + ({m})*v0)^2 + 0.5*({n}*v0)^2 + ({c})*x0*t + ({d})*v0");
        let lagrangian = lagrangian(&text, 1);
        let grid = Grid::new(0.0, 1.5, steps).unwrap();
        let problem = ExtremalProblem::new(&lagrangian, grid, sigma, alpha, &[ends.0], &[ends.1]).unwrap();
        let extremal = problem.with_method(method).solve().unwrap();
        let mut functional = Functional::new(&lagrangian, grid, sigma, alpha, Product::Sums).unwrap();
        let least = functional.value(&extremal.positions);
        for size in [1e-3, 1.0] {
            let mut moved = extremal.positions.clone();
            for (x, change) in moved[1..steps].iter_mut().zip(&perturbation) {
                *x += size * change;
            }
            let raised = functional.value(&moved) - least;
            // The functional is quadratic: what it gains is its second variation, h/2 Σ n² (Δ^α δ)² at least.
            let change: Vec<f64> = moved.iter().zip(&extremal.positions).map(|(a, b)| a - b).collect();
            let velocities = functional.velocities(&change);
            let least_gain = 0.5 * grid.step() * n * n * velocities.iter().map(|v| v * v).sum::<f64>();
            prop_assert!(raised >= least_gain * (1.0 - 1e-6) - 1e-11 * least.abs().max(1.0), "{} {}", raised, least_gain);
            prop_assert!(least_gain > 0.0);
        }
    }
}
