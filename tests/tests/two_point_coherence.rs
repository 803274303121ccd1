//! Coherence of discrete embeddings: the direct embedding of the Euler–Lagrange equation against the gradient
//! of the discrete functional (\[BCGI\] Propositions 1, 3 and 5).

use fvi_exhibits::two_point::{
    ExpressionLagrangian, Functional, Grid, OperatorEquation, Product, Sigma, Term, asymmetric_embedding,
    fractional_embedding, symmetric_embedding,
};
use fvi_fft::sums::max_or_nan;
use fvi_scenario::language::expression::{Expression, Symbols};
use proptest::prelude::*;

fn lagrangian(text: &str, coordinates: usize) -> ExpressionLagrangian {
    let symbols = Symbols::new().with_time().with_variables(ExpressionLagrangian::variables(coordinates));
    ExpressionLagrangian::new(Expression::parse(text, &symbols).unwrap(), coordinates).unwrap()
}

/// Nonlinear in every argument and with x, v and t coupled; six coefficients.
fn nonlinear(c: &[f64; 6], coordinates: usize) -> ExpressionLagrangian {
    let [a, b, c, d, e, f] = c;
    let one = format!(
        "({a})*v0^3 + ({b})*exp(0.3*x0)*v0 + ({c})*sin(x0*v0 + t) + ({d})*x0^4*t + ({e})*v0^2 + ({f})*x0"
    );
    let text = match coordinates {
        1 => one,
        _ => format!("{one} + ({a})*x1*v0*v1 + ({b})*cos(x1 - x0)*v1^2 + ({c})*tanh(v1 + x1)"),
    };
    lagrangian(&text, coordinates)
}

fn sigma() -> impl Strategy<Value = Sigma> {
    prop_oneof![Just(Sigma::Minus), Just(Sigma::Plus)]
}

fn coefficients() -> impl Strategy<Value = [f64; 6]> {
    prop::array::uniform6(-1.0..1.0)
}

/// Grid and positions of `coordinates` coordinates on it; velocities stay moderate.
fn path(coordinates: usize) -> impl Strategy<Value = (Grid, Vec<f64>)> {
    (2..40_usize, 0.5..8.0).prop_flat_map(move |(steps, length)| {
        let grid = Grid::new(-0.3, length, steps).unwrap();
        (Just(grid), prop::collection::vec(-1.0..1.0, (steps + 1) * coordinates))
    })
}

/// Largest difference relative to the largest entry and the weights, in units of rounding.
fn difference(first: &[f64], second: &[f64]) -> f64 {
    assert_eq!(first.len(), second.len());
    let largest = first.iter().chain(second).fold(1.0, |a: f64, b| max_or_nan(a, b.abs()));
    first.iter().zip(second).fold(0.0, |a: f64, (b, c)| max_or_nan(a, (b - c).abs()))
        / (largest * f64::EPSILON)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_fractional_embedding_is_coherent(
        (coordinates, (grid, positions)) in (1..3_usize).prop_flat_map(|d| (Just(d), path(d))),
        c in coefficients(),
        sigma in sigma(),
        alpha in 0.05..1.0,
    ) {
        let lagrangian = nonlinear(&c, coordinates);
        for product in [Product::Sums, Product::Transforms] {
            let mut functional = Functional::new(&lagrangian, grid, sigma, alpha, product).unwrap();
            let gradient = functional.gradient(&positions);
            let embedding = fractional_embedding(&lagrangian, &grid, sigma, alpha, product, &positions).unwrap();
            prop_assert!(difference(&gradient, &embedding) < 256.0);
        }
    }

    #[test]
    fn the_asymmetric_classical_embedding_is_coherent(
        (grid, positions) in path(1),
        c in coefficients(),
        sigma in sigma(),
    ) {
        let lagrangian = nonlinear(&c, 1);
        let mut functional = Functional::new(&lagrangian, grid, sigma, 1.0, Product::Sums).unwrap();
        let embedding = asymmetric_embedding(&lagrangian, &grid, sigma, &positions);
        prop_assert!(difference(&functional.gradient(&positions), &embedding) < 256.0);
    }

    #[test]
    fn the_gradient_is_the_derivative_of_the_functional(
        (grid, positions) in path(2),
        c in coefficients(),
        sigma in sigma(),
        alpha in 0.05..1.0,
        direction in prop::collection::vec(-1.0..1.0, 82),
    ) {
        let lagrangian = nonlinear(&c, 2);
        let mut functional = Functional::new(&lagrangian, grid, sigma, alpha, Product::Sums).unwrap();
        let inner = 2..positions.len() - 2;
        let mut at = |length: f64| {
            let mut moved = positions.clone();
            for (x, d) in moved[inner.clone()].iter_mut().zip(&direction) {
                *x += length * d;
            }
            functional.value(&moved)
        };
        // Central differences of fourth order: the remainder and the rounding are both below 1e-8.
        let e = 1e-3 * grid.step().powf(alpha).min(1.0);
        let numerical = (8.0 * (at(e) - at(-e)) - (at(2.0 * e) - at(-2.0 * e))) / (12.0 * e);
        let terms: Vec<f64> = functional
            .gradient(&positions)
            .iter()
            .zip(&direction)
            .map(|(g, d)| grid.step() * g * d)
            .collect();
        let exact: f64 = terms.iter().sum();
        let size: f64 = terms.iter().map(|term| term.abs()).sum::<f64>() + 1.0;
        prop_assert!((numerical - exact).abs() < 1e-6 * size, "{} {}", numerical, exact);
    }
}

#[test]
fn the_symmetric_classical_embedding_is_not_coherent() {
    // L = ½v² − ½x²: the equations −δ²Q − Q of both, but with x taken at k by the gradient and at k ± 1 by
    // the embedding.
    let oscillator = lagrangian("0.5*v0^2 - 0.5*x0^2", 1);
    let grid = Grid::new(0.0, 2.0, 20).unwrap();
    let positions: Vec<f64> = (0..=20).map(|k| grid.time(k).sin()).collect();
    for (sigma, shift) in [(Sigma::Minus, 1_usize), (Sigma::Plus, 0)] {
        let gradient =
            Functional::new(&oscillator, grid, sigma, 1.0, Product::Sums).unwrap().gradient(&positions);
        let embedding = symmetric_embedding(&oscillator, &grid, sigma, &positions);
        assert_eq!(embedding.len(), gradient.len());
        for (k, (g, e)) in (1..).zip(gradient.iter().zip(&embedding)) {
            let elsewhere = if shift == 1 { positions[k + 1] } else { positions[k - 1] };
            assert!((g - e - (elsewhere - positions[k])).abs() < 1e-12, "{sigma:?} {k}");
        }
        let largest =
            gradient.iter().zip(&embedding).fold(0.0, |a: f64, (g, e)| max_or_nan(a, (g - e).abs()));
        assert!(largest > 0.5 * grid.step(), "{sigma:?}: {largest}");
    }
}

#[test]
fn without_positions_the_symmetric_embedding_only_shifts_the_equations() {
    let free = lagrangian("0.5*v0^2 + 0.1*v0^4", 1);
    let grid = Grid::new(0.0, 1.0, 12).unwrap();
    let positions: Vec<f64> = (0..=12).map(|k| (1.7 * k as f64).sin()).collect();
    for sigma in [Sigma::Minus, Sigma::Plus] {
        let gradient = Functional::new(&free, grid, sigma, 1.0, Product::Sums).unwrap().gradient(&positions);
        let embedding = symmetric_embedding(&free, &grid, sigma, &positions);
        assert!(difference(&gradient, &embedding) < 16.0, "{sigma:?}");
    }
}

fn term(factor: Option<&str>, order: usize, of: &str) -> Term {
    let symbols = Symbols::new().with_time().with_variables(OperatorEquation::variables(1));
    let parse = |text| Expression::parse(text, &symbols).unwrap();
    Term { factor: factor.map(parse), order, of: vec![parse(of)] }
}

fn wave(grid: &Grid) -> Vec<f64> {
    (0..=grid.steps()).map(|k| (1.7 * k as f64).sin()).collect()
}

#[test]
fn newtons_equation_with_friction_is_embedded_as_printed() {
    // [BCGI] NE_h: (Q_k − 2Q_{k−1} + Q_{k−2})/h² + (Q_k − Q_{k−1})/h + Q_k, k = 2…N.
    let terms = vec![term(None, 2, "x0"), term(None, 1, "x0"), term(None, 0, "x0")];
    let equation = OperatorEquation::new(terms, 1).unwrap();
    let grid = Grid::new(0.0, 3.0, 10).unwrap();
    let (q, h) = (wave(&grid), grid.step());
    let printed: Vec<f64> = (2..=10)
        .map(|k| (q[k] - 2.0 * q[k - 1] + q[k - 2]) / (h * h) + (q[k] - q[k - 1]) / h + q[k])
        .collect();
    assert!(difference(&equation.embedding(&grid, Sigma::Minus, &q), &printed) < 8.0);
    let mirrored: Vec<f64> = (0..=8)
        .map(|k| (q[k + 2] - 2.0 * q[k + 1] + q[k]) / (h * h) + (q[k + 1] - q[k]) / h + q[k])
        .collect();
    assert!(difference(&equation.embedding(&grid, Sigma::Plus, &q), &mirrored) < 8.0);
}

#[test]
fn the_embedding_of_an_equation_depends_on_how_it_is_written() {
    // d/dt ∘ sin = cos · d/dt, but their embeddings differ ([BCGI] after Definition 4); each is consistent.
    let with = |first: Term| OperatorEquation::new(vec![term(None, 2, "x0"), first], 1).unwrap();
    let outside = with(term(None, 1, "sin(x0)"));
    let inside = with(term(Some("cos(x0)"), 1, "x0"));
    let gap = |steps| {
        let grid = Grid::new(0.0, 2.0, steps).unwrap();
        let positions: Vec<f64> = (0..=steps).map(|k| 1.0 + grid.time(k).sin()).collect();
        let first = outside.embedding(&grid, Sigma::Minus, &positions);
        let second = inside.embedding(&grid, Sigma::Minus, &positions);
        first.iter().zip(&second).fold(0.0, |a: f64, (b, c)| max_or_nan(a, (b - c).abs()))
    };
    let ratio = gap(100) / gap(200);
    assert!(gap(100) > 1e-3);
    assert!((1.9..2.1).contains(&ratio), "{ratio}");
}

#[test]
fn both_ways_to_embed_the_euler_lagrange_equation_directly_agree() {
    // ∂L/∂x − d/dt ∂L/∂v for L = ½v² − cosh x, as a Lagrangian and as terms.
    let lagrangian = lagrangian("0.5*v0^2 - cosh(x0)", 1);
    let equation = OperatorEquation::new(vec![term(None, 2, "-x0"), term(None, 0, "-sinh(x0)")], 1).unwrap();
    let grid = Grid::new(0.0, 3.0, 12).unwrap();
    for sigma in [Sigma::Minus, Sigma::Plus] {
        let first = symmetric_embedding(&lagrangian, &grid, sigma, &wave(&grid));
        assert!(difference(&first, &equation.embedding(&grid, sigma, &wave(&grid))) < 8.0, "{sigma:?}");
    }
}
