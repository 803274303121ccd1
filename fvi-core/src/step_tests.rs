//! Steps against the equations that they solve, written out plainly with the sums of their memories: two
//! coordinates, schemes of any degree and quadrature.

use heapless::Deque;
use nalgebra::{SMatrix, SVector, matrix, vector};
use std::vec::Vec;

use crate::coefficients::{Coefficients, Fixed};
use crate::collocation::Collocation;
use crate::damped_motion::Derivative;
use crate::damping::{Damping, DampingTerm};
use crate::direct::{Direct, Overflow};
use crate::discrete_lagrangian::DiscreteLagrangian;
use crate::galerkin::Galerkin;
use crate::integrator::Integrator;
use crate::kernel::Kernel;
use crate::linear::{Singular, solve};
use crate::newton::{Equations, Factors, StepMatrix};
use crate::node_galerkin::NodeGalerkin;
use crate::quadrature::Quadrature;
use crate::runge_kutta::RungeKutta;
use crate::scheme::{Sampling, Scheme, State, Step, StepError};
use crate::system::{Force, Instant, Mass, Mechanics, NoForce, Potential, System};
use crate::workspace::{CachedFactor, Workspace};

type V = SVector<f64, 2>;
type M = SMatrix<f64, 2, 2>;

/// Tolerance for rounding errors.
const EXACT: f64 = 1e-12;

const H: f64 = 0.2;
const MASS: Coefficients<f64, 2> = Coefficients::Dense(matrix![2.0, 0.5; 0.5, 1.0]);
const INPUT: V = V::new(0.3, -0.2);
const START: V = V::new(0.4, -0.3);
const MOMENTUM: V = V::new(1.2, 0.5);

/// ½ qᵀ K q + quartic (q₀ − 2 q₁)⁴ / 4 with K = [3 −1; −1 2], stiffened by a factor.
#[derive(Clone, Copy)]
struct Springs {
    factor: f64,
    quartic: f64,
}

impl Potential<f64, 2> for Springs {
    fn value(&self, q: &V) -> f64 {
        0.5 * self.factor * q.dot(&(matrix![3.0, -1.0; -1.0, 2.0] * q))
            + 0.25 * self.quartic * (q[0] - 2.0 * q[1]).powi(4)
    }

    fn gradient(&self, q: &V) -> V {
        let cube = self.quartic * (q[0] - 2.0 * q[1]).powi(3);
        self.factor * (matrix![3.0, -1.0; -1.0, 2.0] * q) + vector![cube, -2.0 * cube]
    }

    fn hessian(&self, q: &V) -> M {
        let square = 3.0 * self.quartic * (q[0] - 2.0 * q[1]).powi(2);
        self.factor * matrix![3.0, -1.0; -1.0, 2.0] + square * matrix![1.0, -2.0; -2.0, 4.0]
    }

    fn is_quadratic(&self) -> bool {
        self.quartic == 0.0
    }
}

/// A force that no quadrature of few points integrates exactly, and that may depend on the position or supply
/// its exact moments.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Load {
    OfTime,
    WithMoments,
    OfPosition,
}

impl Force<f64, 2> for Load {
    fn value(&self, instant: Instant<f64>, q: &V) -> V {
        let t = instant.time;
        let follows =
            if *self == Self::OfPosition { vector![-0.25 * q[1], 0.5 * t * q[0]] } else { V::zeros() };
        vector![1.0 + t.powi(4), 0.5 - 3.0 * t.powi(3)] + follows
    }

    fn jacobian(&self, instant: Instant<f64>, _: &V) -> M {
        let follows = matrix![0.0, -0.25; 0.5 * instant.time, 0.0];
        if *self == Self::OfPosition { follows } else { M::zeros() }
    }

    fn depends_on_position(&self) -> bool {
        *self == Self::OfPosition
    }

    fn moments(&self, start: f64, length: f64, points: &[f64], moments: &mut [V]) -> bool {
        if *self != Self::WithMoments {
            return false;
        }
        let all: Vec<f64> = core::iter::once(0.0).chain(points.iter().copied()).collect();
        let exact = Quadrature::<6>::gauss().unwrap();
        for (nu, moment) in moments.iter_mut().enumerate() {
            *moment = V::zeros();
            for (&tau, &weight) in exact.nodes().iter().zip(exact.weights()) {
                let others = all.iter().enumerate().filter(|&(mu, _)| mu != nu);
                let shape: f64 = others.map(|(_, other)| (tau - other) / (all[nu] - other)).product();
                *moment += self.value(Instant::in_step(start, tau, length), &V::zeros()) * (weight * shape);
            }
        }
        true
    }
}

type Plant = System<f64, 2, Springs, Load>;

fn plant(factor: f64, quartic: f64, force: Load) -> Plant {
    let mass = Mass::new(MASS).unwrap();
    System { mass, potential: Springs { factor, quartic }, force }
}

/// Coefficients of a discrete Lagrangian.
#[derive(Clone, Debug)]
struct Numbers {
    weights: Vec<f64>,
    nodes: Vec<f64>,
    control_points: Vec<f64>,
    shapes: Vec<f64>,
    tests: Vec<f64>,
    kinetic: Vec<f64>,
}

impl Numbers {
    fn of(view: DiscreteLagrangian<'_, f64>) -> Self {
        Self {
            weights: view.weights.to_vec(),
            nodes: view.nodes.to_vec(),
            control_points: view.control_points.to_vec(),
            shapes: view.shapes.to_vec(),
            tests: view.tests.to_vec(),
            kinetic: view.kinetic.to_vec(),
        }
    }

    /// Straight lines with one node and any coefficients.
    fn one_node([weight, node, shape, test, kinetic]: [f64; 5]) -> Self {
        Self {
            weights: [weight].into(),
            nodes: [node].into(),
            control_points: [1.0].into(),
            shapes: [shape].into(),
            tests: [test].into(),
            kinetic: [kinetic].into(),
        }
    }

    /// Every node repeated, with half the weight.
    fn doubled(&self) -> Self {
        let twice = |numbers: &[f64]| [numbers, numbers].concat();
        Self {
            weights: twice(&self.weights).iter().map(|weight| 0.5 * weight).collect(),
            nodes: twice(&self.nodes),
            shapes: twice(&self.shapes),
            tests: twice(&self.tests),
            ..self.clone()
        }
    }

    fn view(&self) -> DiscreteLagrangian<'_, f64> {
        DiscreteLagrangian {
            weights: &self.weights,
            nodes: &self.nodes,
            control_points: &self.control_points,
            shapes: &self.shapes,
            tests: &self.tests,
            kinetic: &self.kinetic,
        }
    }

    fn degree(&self) -> usize {
        self.control_points.len()
    }

    fn drifts(&self) -> bool {
        self.degree() == 1 && self.tests.iter().all(|&test| test == 0.0)
    }
}

/// Equations whose solver makes an error of 10⁻⁸ and does not keep factors, and the coefficient of the mass
/// expected in them.
struct Inexact<const S: usize>(StepMatrix<f64, 2, S>, f64);

impl<const S: usize> Equations<f64, Coefficients<f64, 2>> for Inexact<S> {
    type Factor = Factors<f64, 2, S>;

    fn clear(&mut self) {
        Equations::<f64, Coefficients<f64, 2>>::clear(&mut self.0);
        self.1 = 0.0;
    }

    fn add(&mut self, row: usize, column: usize, factor: f64, block: &Coefficients<f64, 2>) {
        self.0.add(row, column, factor, block);
        self.1 += if *block == MASS { factor } else { 0.0 };
    }

    fn solve(&mut self, vector: &mut [f64]) -> Result<(), Singular> {
        Equations::<f64, Coefficients<f64, 2>>::solve(&mut self.0, vector)
    }

    fn keep(
        &mut self,
        kept: &mut Self::Factor,
        inertia: (f64, &Coefficients<f64, 2>),
    ) -> Result<(), Singular> {
        assert!(inertia.0 == if S == 1 && inertia.0 != 0.0 { self.1 } else { 0.0 });
        self.0.keep(kept, inertia)
    }

    fn solve_kept(&mut self, kept: &Self::Factor, vector: &mut [f64]) {
        Equations::<f64, Coefficients<f64, 2>>::solve_kept(&mut self.0, kept, vector);
        vector.iter_mut().for_each(|number| *number *= 1.0 + 1e-8);
    }
}

/// A scheme of any coefficients, damped at its nodes or at the main nodes, with an inexact solver. With
/// `guess` it starts from the restoring force of the last step.
struct Any<const S: usize> {
    numbers: Numbers,
    at_nodes: bool,
    guess: bool,
}

/// Storage of [`Any`]: factors, offsets from the last nodes, the last restoring force.
struct Buffers<const S: usize> {
    kept: CachedFactor<Factors<f64, 2, S>, f64>,
    behind: Vec<f64>,
    restoring: Vec<f64>,
}

impl<const S: usize> Scheme<f64, Fixed<2>> for Any<S> {
    type Storage = Buffers<S>;

    fn storage<G: Mechanics<f64, Fixed<2>>>(&self, _: &Fixed<2>, _: &G) -> Buffers<S> {
        let behind = if self.at_nodes { 2 * self.numbers.nodes.len() } else { 0 };
        let restoring = if self.guess { 2 } else { 0 };
        Buffers {
            kept: CachedFactor::nothing(Factors::zero()),
            behind: std::vec![0.0; behind],
            restoring: std::vec![0.0; restoring],
        }
    }

    fn sampling(&self) -> Sampling<'_, f64> {
        if self.at_nodes { Sampling::Nodes(&self.numbers.nodes) } else { Sampling::MainNodes }
    }

    fn step<G: Mechanics<f64, Fixed<2>>, D: Damping<f64, Fixed<2>>>(
        &self,
        storage: &mut Buffers<S>,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, f64>,
        state: &mut State<V>,
    ) -> Result<u32, StepError> {
        assert!((step.end - step.time - step.size).abs() < 1e-14);
        let points = self.numbers.nodes.len();
        let room = |vectors: usize| std::vec![f64::NAN; 2 * vectors];
        let known = if self.at_nodes { points } else { 1 };
        let mut work = Workspace::<f64, Fixed<2>, Inexact<S>> {
            increments: &mut room(S),
            residual: &mut room(S),
            stages: &mut room(points),
            forces: &mut room(points),
            known: &mut room(known),
            scratch: &mut room(known + 1),
            behind: &mut storage.behind,
            restoring: &mut storage.restoring,
            moment_correction: &mut room(S + 1),
            point: &mut V::zeros(),
            stiffness: &mut mechanics.stiffness(),
            matrix: &mut Inexact(StepMatrix::zero(), 0.0),
            kept: &mut storage.kept,
        };
        let view = self.numbers.view();
        if self.at_nodes {
            view.step_damped_at_nodes(&mut work, mechanics, damping, step, state)
        } else {
            view.step_damped_at_main_nodes(&mut work, mechanics, damping, step, state)
        }
    }
}

/// A damping: ρ, type of derivative, and the weights of a kernel, plane by plane.
#[derive(Clone, Copy)]
struct Term {
    rho: M,
    derivative: Derivative,
    exponent: f64,
    weights: &'static [f64],
}

const LENGTH: usize = 12;

/// Plain weights, and the four planes of matrices.
const PLAIN: [f64; LENGTH] = [2.0, -0.7, -0.5, 0.3, -0.2, 0.15, -0.1, 0.08, 0.05, -0.04, 0.03, 0.02];
const PLANES: [f64; 4 * LENGTH] = {
    let mut planes = [0.0; 4 * LENGTH];
    let mut place = 0;
    while place < planes.len() {
        let (plane, lag) = (place / LENGTH, place % LENGTH);
        planes[place] = PLAIN[(lag + plane) % LENGTH] * [1.0, 0.4, -0.6, 1.2][plane];
        place += 1;
    }
    // The leading weight.
    (planes[0], planes[LENGTH], planes[2 * LENGTH], planes[3 * LENGTH]) = (2.0, 0.5, -0.75, 1.5);
    planes
};

fn terms(count: usize, stages: usize) -> Vec<Term> {
    let weights = if stages == 1 { &PLAIN[..] } else { &PLANES };
    let soft = Term {
        rho: matrix![0.4, 0.1; 0.1, 0.3],
        derivative: Derivative::RiemannLiouville,
        exponent: 0.5,
        weights,
    };
    let inert =
        Term { rho: matrix![0.1, 0.0; 0.0, 0.6], derivative: Derivative::Caputo, exponent: 1.5, weights };
    [soft, inert][..count].to_vec()
}

type Memory = Direct<f64, &'static [f64], Vec<Deque<f64, LENGTH>>, Deque<f64, LENGTH>>;

fn damping(terms: &[Term], nodes: usize, stages: usize) -> Vec<DampingTerm<f64, Fixed<2>, Memory>> {
    let made = |term: &Term| {
        let rings = std::vec![Deque::new(); 2 * nodes];
        let memory = Direct::new(term.weights, stages, 1.0, rings, Overflow::Refuse).unwrap();
        let kernel = Kernel::given(term.exponent).unwrap();
        DampingTerm::new(kernel, Coefficients::Dense(term.rho), term.derivative, memory).unwrap()
    };
    terms.iter().map(made).collect()
}

/// Σ_m ρ_m (D^{β_m} X)_{k,i} of the last sample, by its definition. A sample is the positions at its nodes,
/// with their times.
fn damping_force(terms: &[Term], samples: &[Vec<(f64, V)>], i: usize) -> V {
    let (k, nodes) = (samples.len() - 1, samples[0].len());
    let velocity = plant(1.0, 0.0, Load::OfTime).mass.velocity(&MOMENTUM);
    let mut force = V::zeros();
    for term in terms {
        let coupled = term.weights.len() > LENGTH;
        for (n, sample) in samples.iter().rev().enumerate().take(k + 1) {
            for (j, &(time, position)) in sample.iter().enumerate() {
                let weight = match (coupled, i == j) {
                    (true, _) => term.weights[(i * nodes + j) * LENGTH + n],
                    (false, true) => term.weights[n],
                    (false, false) => 0.0,
                };
                let left_out = match term.derivative {
                    Derivative::RiemannLiouville => V::zeros(),
                    Derivative::Caputo => START + velocity * time,
                };
                force += term.rho * (position - left_out) * weight;
            }
        }
    }
    force
}

/// The root of `residual` next to `guess`, by Newton's method with differences for derivatives.
fn root(mut x: Vec<f64>, residual: impl Fn(&[f64]) -> Vec<f64>) -> Vec<f64> {
    let count = x.len();
    for _ in 0..12 {
        let mut matrix = std::vec![0.0; count * count];
        for column in 0..count {
            let moved = |by: f64| {
                let mut x = x.clone();
                x[column] += by;
                residual(&x)
            };
            for (row, (above, below)) in moved(1e-3).iter().zip(moved(-1e-3)).enumerate() {
                matrix[row * count + column] = (above - below) / 2e-3;
            }
        }
        let mut correction = residual(&x);
        solve(&mut matrix, &mut std::vec![0; count], &mut correction).unwrap();
        x.iter_mut().zip(correction).for_each(|(x, change)| *x -= change);
    }
    x
}

fn pairs(numbers: &[f64]) -> Vec<V> {
    numbers.chunks(2).map(|pair| vector![pair[0], pair[1]]).collect()
}

/// Position and momentum of the next main node by the equations in the documentation of
/// [`DiscreteLagrangian::step_damped_at_main_nodes`] and its neighbour. `samples` are those of the memory.
fn next(
    numbers: &Numbers,
    at_nodes: bool,
    plant: &Plant,
    terms: &[Term],
    (time, q, p): (f64, V, V),
    samples: &mut Vec<Vec<(f64, V)>>,
) -> (V, V) {
    let (degree, points) = (numbers.degree(), numbers.nodes.len());
    let shape = |i: usize, nu: usize| match nu {
        0 => numbers.tests[i * degree],
        nu => numbers.shapes[i * degree + nu - 1],
    };
    let instant = |i: usize| Instant::in_step(time, numbers.nodes[i], H);
    let stages = |e: &[V]| -> Vec<V> {
        (0..points).map(|i| (1..=degree).fold(q, |sum, nu| sum + e[nu - 1] * shape(i, nu))).collect()
    };
    // The part of the work of the force against shape ν that the nodes miss.
    let mut missed = std::vec![V::zeros(); degree + 1];
    if !numbers.drifts() && plant.force.moments(time, H, &numbers.control_points, &mut missed) {
        for (nu, missed) in missed.iter_mut().enumerate() {
            for (i, weight) in numbers.weights.iter().enumerate() {
                *missed -= plant.force.value(instant(i), &q) * (weight * shape(i, nu));
            }
        }
    }
    let restoring_forces = |e: &[V]| -> Vec<V> {
        let stages = stages(e);
        let mut samples = samples.clone();
        samples.push(stages.iter().enumerate().map(|(i, &stage)| (instant(i).time, stage)).collect());
        let restoring = |(i, stage): (usize, &V)| {
            let damping = if at_nodes { damping_force(terms, &samples, i) } else { V::zeros() };
            plant.potential.gradient(stage) - plant.force.value(instant(i), stage) - INPUT + damping
        };
        stages.iter().enumerate().map(restoring).collect()
    };
    let residual = |unknowns: &[f64]| -> Vec<f64> {
        let e = pairs(unknowns);
        let restoring_forces = restoring_forces(&e);
        let equation = |nu: usize| {
            let mut sum = if nu == 0 { p } else { V::zeros() } + missed[nu] * H;
            for (mu, e) in e.iter().enumerate() {
                sum += plant.mass.momentum(e) * (numbers.kinetic[nu * degree + mu] / H);
            }
            for (i, restoring) in restoring_forces.iter().enumerate() {
                sum -= restoring * (H * numbers.weights[i] * shape(i, nu));
            }
            [sum[0], sum[1]]
        };
        (0..degree).flat_map(equation).collect()
    };
    let e = pairs(&root(std::vec![0.0; 2 * degree], residual));
    let mut momentum = missed.iter().fold(p, |sum, missed| sum + missed * H);
    for (restoring, weight) in restoring_forces(&e).iter().zip(&numbers.weights) {
        momentum -= restoring * (H * weight);
    }
    let position = q + e[degree - 1];
    if at_nodes {
        samples.push(stages(&e).into_iter().enumerate().map(|(i, stage)| (instant(i).time, stage)).collect());
    } else {
        samples.push([(time + H, position)].into());
        momentum -= damping_force(terms, samples, 0) * H;
    }
    (position, momentum)
}

/// Makes steps by an integrator and by `next`, and compares them within the given tolerance.
fn assert_steps<S: Scheme<f64, Fixed<2>>>(
    case: &str,
    scheme: S,
    plant: &Plant,
    terms: &[Term],
    (nodes, stages, allowed): (usize, usize, f64),
    mut next: impl FnMut((f64, V, V), &mut Vec<Vec<(f64, V)>>) -> (V, V),
) {
    let case = std::format!(
        "{case}, quartic {}, {:?}, {} dampings",
        plant.potential.quartic,
        plant.force,
        terms.len()
    );
    let at_main_nodes = matches!(scheme.sampling(), Sampling::MainNodes);
    let mut dampings = damping(terms, nodes, stages);
    let mut integrator = Integrator::builder(*plant, scheme, H)
        .damping(&mut dampings[..])
        .position(START)
        .momentum(MOMENTUM)
        .build()
        .unwrap();
    let (mut q, mut p) = (START, MOMENTUM);
    let mut samples = if at_main_nodes { std::vec![std::vec![(0.0, q)]] } else { Vec::new() };
    for k in 0..8 {
        (q, p) = next((H * f64::from(k), q, p), &mut samples);
        integrator.step(&INPUT).unwrap();
        let state = integrator.state();
        if k == 0 {
            // Positions are those after the second correction, which makes up for the inexact solver.
            assert!((state.position - q).amax() < EXACT, "{case}: {}", state.position - q);
        }
        let error = (state.position - q).amax().max((state.momentum - p).amax());
        assert!(error < allowed, "{case}, step {k}: {error:e} off");
    }
}

/// Linear and nonlinear systems, with every kind of force, with no, one and two dampings.
fn for_every_plant(test: impl Fn(&Plant, usize)) {
    for quartic in [0.0, 0.5] {
        for force in [Load::OfTime, Load::WithMoments, Load::OfPosition] {
            for dampings in 0..3 {
                test(&plant(1.0, quartic, force), dampings);
            }
        }
    }
}

/// Steps of the given coefficients, damped at main nodes and at nodes, with plain and with matrix weights.
fn assert_any_steps<const S: usize>(case: &str, numbers: &Numbers) {
    for_every_plant(|plant, dampings| {
        for guess in [false, true] {
            if guess && (S, numbers.nodes.len()) != (1, 1) {
                continue;
            }
            let terms_of = |stages| terms(dampings, stages);
            let any = |at_nodes| Any::<S> { numbers: numbers.clone(), at_nodes, guess };
            let terms = terms_of(1);
            // The forces are those after the first of two corrections.
            let allowed = if plant.is_linear() { 1e-7 } else { EXACT };
            assert_steps(
                &std::format!("{case}, main nodes"),
                any(false),
                plant,
                &terms,
                (1, 1, allowed),
                |state, samples| next(numbers, false, plant, &terms, state, samples),
            );
            let nodes = numbers.nodes.len();
            for stages in 1..=nodes {
                let terms = terms_of(stages);
                assert_steps(
                    &std::format!("{case}, nodes"),
                    any(true),
                    plant,
                    &terms,
                    (nodes, stages, allowed),
                    |state, samples| next(numbers, true, plant, &terms, state, samples),
                );
            }
        }
    });
}

#[test]
fn steps_with_one_node_solve_their_equations() {
    for kappa in [0.0, 0.3, 0.5, 1.0] {
        let numbers = Numbers::of(Galerkin::<f64, 1, 1>::low_order(kappa).unwrap().view());
        assert_any_steps::<1>(&std::format!("κ = {kappa}"), &numbers);
    }
    assert_any_steps::<1>("numbers of no polynomial", &Numbers::one_node([0.8, 0.25, 0.7, 0.35, -1.3]));
}

#[test]
fn steps_with_several_nodes_solve_their_equations() {
    // Two nodes in the same place, so that the position drifts at κ = 0.
    for kappa in [0.0, 0.3] {
        let numbers = Numbers::of(Galerkin::<f64, 1, 1>::low_order(kappa).unwrap().view()).doubled();
        assert_any_steps::<1>(&std::format!("κ = {kappa} twice"), &numbers);
    }
    let lobatto = Galerkin::<f64, 1, 2>::new(&Quadrature::lobatto().unwrap()).unwrap();
    assert_any_steps::<1>("trapezoidal rule", &Numbers::of(lobatto.view()));
    let gauss = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().unwrap()).unwrap();
    assert_any_steps::<2>("parabolas", &Numbers::of(gauss.view()));
}

#[test]
fn schemes_make_the_steps_of_their_numbers() {
    let midpoint = Galerkin::<f64, 1, 1>::low_order(0.5).unwrap();
    let gauss = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().unwrap()).unwrap();
    let radau = RungeKutta::<2>::radau_iia().unwrap();
    for_every_plant(|plant, dampings| {
        let plain = terms(dampings, 1);
        for (numbers, at_nodes) in
            [(Numbers::of(midpoint.view()), false), (Numbers::of(midpoint.view()), true)]
        {
            let next = |state, samples: &mut _| next(&numbers, at_nodes, plant, &plain, state, samples);
            if at_nodes {
                assert_steps(
                    "midpoint at nodes",
                    NodeGalerkin::new(midpoint),
                    plant,
                    &plain,
                    (1, 1, EXACT),
                    next,
                );
            } else {
                assert_steps("midpoint", midpoint, plant, &plain, (1, 1, EXACT), next);
            }
        }
        let numbers = Numbers::of(gauss.view());
        assert_steps("parabolas", gauss, plant, &plain, (1, 1, EXACT), |state, samples| {
            next(&numbers, false, plant, &plain, state, samples)
        });
        let numbers = Numbers::of(Galerkin::<f64, 2, 2>::new(radau.quadrature()).unwrap().view());
        let scheme = NodeGalerkin::<f64, 2, 2>::with_stages(&radau).unwrap();
        let coupled = terms(dampings, 2);
        assert_steps(
            "parabolas on Radau's nodes",
            scheme,
            plant,
            &coupled,
            (2, 2, EXACT),
            |state, samples| next(&numbers, true, plant, &coupled, state, samples),
        );
    });
}

#[test]
fn collocation_solves_its_equations() {
    let method = RungeKutta::<2>::radau_iia().unwrap();
    let (square, quadrature) = (method.square(), method.quadrature());
    for_every_plant(|plant, dampings| {
        let terms = terms(dampings, 2);
        let next = |(time, q, p): (f64, V, V), samples: &mut Vec<Vec<(f64, V)>>| {
            let velocity = plant.mass.velocity(&p);
            let instant = |i: usize| Instant::in_step(time, quadrature.nodes()[i], H);
            let sample = |a: &[V]| -> Vec<(f64, V)> {
                let stage = |i: usize| {
                    let position = q + velocity * (H * quadrature.nodes()[i]);
                    (instant(i).time, (0..2).fold(position, |sum, j| sum + a[j] * (H * H * square[i][j])))
                };
                [stage(0), stage(1)].into()
            };
            let residual = |unknowns: &[f64]| -> Vec<f64> {
                let a = pairs(unknowns);
                let mut samples = samples.clone();
                samples.push(sample(&a));
                let equation = |i: usize| {
                    let stage = samples[samples.len() - 1][i].1;
                    let forces =
                        plant.force.value(instant(i), &stage) + INPUT - damping_force(&terms, &samples, i);
                    let left = plant.mass.momentum(&a[i]) + plant.potential.gradient(&stage) - forces;
                    [left[0], left[1]]
                };
                (0..2).flat_map(equation).collect()
            };
            let a = pairs(&root(std::vec![0.0; 4], residual));
            let found = sample(&a);
            samples.push(found.clone());
            let mean = a[0] * quadrature.weights()[0] + a[1] * quadrature.weights()[1];
            (found[1].1, p + plant.mass.momentum(&mean) * H)
        };
        if plant.force != Load::WithMoments {
            assert_steps("collocation", Collocation::new(&method), plant, &terms, (2, 2, EXACT), next);
        }
    });
}

/// −g·q, as a potential that is not declared quadratic.
struct Slope(V);

impl Potential<f64, 2> for Slope {
    fn value(&self, q: &V) -> f64 {
        -self.0.dot(q)
    }

    fn gradient(&self, _: &V) -> V {
        -self.0
    }

    fn hessian(&self, _: &V) -> M {
        M::zeros()
    }
}

/// Number of corrections in each of three steps down a slope; the length of the second is given.
fn corrections<const S: usize>(scheme: Any<S>, slope: V, momentum: V) -> [u32; 3] {
    let system = System { mass: Mass::new(MASS).unwrap(), potential: Slope(slope), force: NoForce };
    let mut none = damping(&[], 1, 1);
    let mut integrator = Integrator::builder(system, scheme, 0.25)
        .damping(&mut none[..])
        .position(START)
        .momentum(momentum)
        .build()
        .unwrap();
    let none = V::zeros();
    [
        integrator.step(&none).unwrap(),
        integrator.step_by(0.25, &none).unwrap(),
        integrator.step(&none).unwrap(),
    ]
}

#[test]
fn a_step_begins_with_the_best_guess_there_is() {
    let any = |at_nodes, guess| Any::<1> {
        numbers: Numbers::one_node([0.8, 0.25, 0.7, 0.35, -1.3]),
        at_nodes,
        guess,
    };
    let midpoint = |guess| {
        let numbers = Numbers::of(Galerkin::<f64, 1, 1>::low_order(0.5).unwrap().view());
        Any::<1> { numbers, at_nodes: false, guess }
    };
    let parabolas = |at_nodes| {
        let gauss = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().unwrap()).unwrap();
        Any::<2> { numbers: Numbers::of(gauss.view()), at_nodes, guess: false }
    };
    // A free mass continues its motion: the first correction is of rounding size.
    for at_nodes in [false, true] {
        assert_eq!(corrections(parabolas(at_nodes), V::zeros(), MOMENTUM), [1, 1, 1]);
        let numbers = Numbers::of(Galerkin::<f64, 1, 1>::low_order(0.5).unwrap().view());
        assert_eq!(
            corrections(Any::<1> { numbers, at_nodes, guess: false }, V::zeros(), MOMENTUM),
            [1, 1, 1]
        );
    }
    // Down a slope the restoring force of the last step predicts the position.
    let slope = vector![0.5, 0.25];
    for at_nodes in [false, true] {
        assert_eq!(corrections(any(at_nodes, false), slope, MOMENTUM), [2, 2, 2]);
        assert_eq!(corrections(any(at_nodes, true), slope, MOMENTUM), [2, 1, 1]);
    }
    // Not where it would reverse the mass: p = −0.375 g is −0.125 g after a step, just as large as h ℓ₀ g; p
    // = −0.3125 g is less after the first step, and more after the second.
    let steep = vector![64.0, 32.0];
    assert_eq!(corrections(midpoint(true), steep, -0.375 * steep), [2, 1, 1]);
    assert_eq!(corrections(midpoint(true), steep, -0.3125 * steep), [2, 2, 1]);
}
