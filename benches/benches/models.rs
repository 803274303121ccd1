//! What a model costs: ∇U and the Hessian of compiled potentials, against forward differentiation of the
//! expression (for numbers of coordinates that it can be instantiated for) and the formula written by hand.

use std::hint::black_box;
use std::time::Instant;

use fvi_scenario::language::expression::{Expression, Moment, Symbols};
use fvi_simulation::model::tape::CompiledPotential;
use nalgebra::SVector;

/// Times measured in turn; the fastest counts.
const TURNS: usize = 15;

fn main() {
    println!("ns for gradient and Hessian                 compiled  forward  by hand  (compiling, ms)");
    small::<1>("pendulum", "9.81*(1 - cos(q0))", Some(pendulum));
    small::<8>("linear chain of 8", &linear_chain(8), None);
    small::<8>("nonlinear chain of 8", &nonlinear_chain(8), Some(springs));
    for coordinates in [64, 2000] {
        report(
            &format!("linear chain of {coordinates}"),
            &compiled(&linear_chain(coordinates), coordinates),
            None,
            None,
        );
        report(
            &format!("nonlinear chain of {coordinates}"),
            &compiled(&nonlinear_chain(coordinates), coordinates),
            None,
            Some(by_hand(springs, coordinates)),
        );
    }
}

/// A chain that hangs between two walls.
fn linear_chain(coordinates: usize) -> String {
    let springs = (1..coordinates).map(|i| format!(" + 5000*(q{i} - q{})^2", i - 1));
    format!("5000*q0^2{} + 5000*q{}^2", springs.collect::<String>(), coordinates - 1)
}

fn nonlinear_chain(coordinates: usize) -> String {
    let spring = |i: usize| format!("0.5*(q{i} - q{})^2 + 0.25*0.7*(q{i} - q{})^4", i - 1, i - 1);
    (1..coordinates).map(spring).collect::<Vec<_>>().join(" + ")
}

type ByHand = fn(&[f64], &mut [f64], &mut [f64]);

fn pendulum(q: &[f64], gradient: &mut [f64], hessian: &mut [f64]) {
    gradient[0] = 9.81 * fvi_scenario::language::expression::Elementary::sine(q[0]);
    hessian[0] = 9.81 * fvi_scenario::language::expression::Elementary::cosine(q[0]);
}

/// The nonlinear chain: diagonal of the Hessian, then the entries below it.
fn springs(q: &[f64], gradient: &mut [f64], hessian: &mut [f64]) {
    gradient.fill(0.0);
    hessian.fill(0.0);
    let (diagonal, below) = hessian.split_at_mut(q.len());
    for i in 1..q.len() {
        let stretch = q[i] - q[i - 1];
        let square = stretch * stretch;
        let tension = stretch + 0.7 * stretch * square;
        let stiffness = 1.0 + 3.0 * 0.7 * square;
        gradient[i] += tension;
        gradient[i - 1] -= tension;
        diagonal[i] += stiffness;
        diagonal[i - 1] += stiffness;
        below[i - 1] = -stiffness;
    }
}

fn position(coordinates: usize) -> Vec<f64> {
    (0..coordinates).map(|i| (0.7 * i as f64).sin() + 0.3).collect()
}

/// Fastest mean time of a call, in nanoseconds.
fn fastest(calls: usize, mut call: impl FnMut()) -> f64 {
    let mut fastest = f64::INFINITY;
    for _ in 0..TURNS {
        let start = Instant::now();
        for _ in 0..calls {
            call();
        }
        fastest = fastest.min(start.elapsed().as_secs_f64() / calls as f64);
    }
    1e9 * fastest
}

fn calls(coordinates: usize) -> usize {
    1 + 200_000 / coordinates
}

fn parse(text: &str, coordinates: usize) -> Expression {
    Expression::parse(text, &Symbols::new().with_coordinates(coordinates)).expect("a good expression")
}

/// Nanoseconds of an evaluation, milliseconds of compilation.
fn compiled(text: &str, coordinates: usize) -> (f64, f64) {
    let compile = || CompiledPotential::<f64>::compile(&parse(text, coordinates), coordinates);
    let compilation = 1e-6 * fastest(1, || drop(black_box(compile())));
    let potential = compile();
    let q = position(coordinates);
    let (mut registers, mut gradient) = (Vec::new(), vec![0.0; coordinates]);
    let mut hessian = vec![0.0; potential.pattern().len()];
    let time = fastest(calls(coordinates), || {
        potential.derivatives(black_box(&q), &mut registers, &mut gradient, &mut hessian);
        black_box((&gradient, &hessian));
    });
    (time, compilation)
}

fn by_hand(formula: ByHand, coordinates: usize) -> f64 {
    let q = position(coordinates);
    let (mut gradient, mut hessian) = (vec![0.0; coordinates], vec![0.0; 2 * coordinates - 1]);
    fastest(calls(coordinates), || {
        formula(black_box(&q), &mut gradient, &mut hessian);
        black_box((&gradient, &hessian));
    })
}

fn small<const N: usize>(name: &str, text: &str, formula: Option<ByHand>) {
    let expression = parse(text, N);
    let q = SVector::<f64, N>::from_column_slice(&position(N));
    let forward = fastest(calls(N), || {
        black_box(expression.hessian(Moment::inside(0.0), black_box(&q)));
    });
    report(name, &compiled(text, N), Some(forward), formula.map(|formula| by_hand(formula, N)));
}

fn report(name: &str, &(compiled, compilation): &(f64, f64), forward: Option<f64>, hand: Option<f64>) {
    let number = |time: Option<f64>| time.map_or(String::new(), |time| format!("{time:.1}"));
    println!("{name:<42} {compiled:>9.1} {:>8} {:>8}  ({compilation:.1})", number(forward), number(hand));
}
