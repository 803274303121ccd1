//! The schemes of scenarios: any degree, any quadrature, known at run time.

use super::few::few_mut;
use super::few_equations::FewEquations;
use super::massless::{Carried, Found, MasslessRows, Settling};
use super::matrices::Matrix;
use super::small::Small;
use super::space::{AnyEquations, AnyFactors, AnySpace};
use fvi_core::{
    Block, CachedFactor, CollocationTables, Damping, DiscreteLagrangian, Equations, ExplicitEuler, Galerkin,
    ImplicitEuler, Mechanics, ParameterError, Real, RungeKutta, Sampling, Scheme, Space, State, Step,
    StepError, Tables, Workspace, add_multiple, gauss_rule, lobatto_rule,
};
use fvi_fft::quadrature::StagedMethod;
use fvi_fft::with_staged_method;
use fvi_scenario::scenario::{DampedAt, Quadrature, Scenario, Scheme as ScenarioScheme};

/// Any of fvi-core's schemes, with its tables on the heap.
#[derive(Clone, Debug)]
pub struct AnyScheme<T> {
    weights: Vec<T>,
    nodes: Vec<T>,
    control_points: Vec<T>,
    shapes: Vec<T>,
    tests: Vec<T>,
    kinetic: Vec<T>,
    /// A and A² of collocation.
    matrix: Vec<T>,
    square: Vec<T>,
    /// The coefficients if the polynomial is a straight line with one quadrature point.
    line: Option<Line<T>>,
    form: Form,
    /// Coordinates without mass whose positions at grid points do not follow from the step's polynomial.
    massless: MasslessRows,
}

/// Place where the fractional force acts, and samples that the memory stores.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    /// The force acts at q_{k+1}, in the new momentum only; the memory stores main nodes.
    MainNodes,
    /// The force acts at the end of the step, in all equations; the memory stores main nodes.
    EndOfStep,
    /// The force acts at the quadrature nodes, which the memory stores.
    Nodes,
    /// The force acts at the collocation nodes, which the memory stores.
    Collocation,
}

impl<T: Real> AnyScheme<T> {
    /// The scheme of a scenario.
    ///
    /// # Errors
    /// If degree, points and stages do not fit each other.
    pub fn new(scenario: &Scenario) -> Result<Self, ParameterError> {
        let form = match scenario.convolution.at {
            DampedAt::MainNodes => Form::MainNodes,
            DampedAt::Nodes => Form::Nodes,
        };
        let degree = match scenario.scheme {
            ScenarioScheme::LowOrder { kappa } => {
                return Ok(Self::of(&Galerkin::low_order(T::of(kappa))?, form));
            }
            // Its nodes; the step with discrete gradients is that of mechanisms.
            ScenarioScheme::Energy => return Ok(Self::of(&Galerkin::low_order(T::of(0.5))?, form)),
            ScenarioScheme::ExplicitEuler => {
                return Ok(Self::of(&ExplicitEuler::coefficients(), Form::MainNodes));
            }
            ScenarioScheme::ImplicitEuler => {
                return Ok(Self::of(&ImplicitEuler::coefficients(), Form::EndOfStep));
            }
            ScenarioScheme::Galerkin { degree, .. } => degree,
            ScenarioScheme::Collocation => {
                let staged = scenario.convolution.family.staged().unwrap_or(StagedMethod::RadauIia(3));
                return with_staged_method!(staged, method => Self::collocation(&method));
            }
        };
        let rule = match scenario.convolution.family.staged() {
            None => Rule::of(scenario.scheme.quadrature().unwrap_or(Quadrature::Gauss(degree)))?,
            Some(staged) => with_staged_method!(staged, method => Rule::of_method(&method))?,
        };
        Self::galerkin(degree, &rule, form)
    }

    fn galerkin(degree: usize, rule: &Rule, form: Form) -> Result<Self, ParameterError> {
        let points = rule.nodes.len();
        let numbers = |count: usize| vec![T::zero(); count];
        let mut scheme = Self {
            weights: super::vector(&rule.weights),
            nodes: super::vector(&rule.nodes),
            control_points: numbers(degree),
            shapes: numbers(points * degree),
            tests: numbers(points * degree),
            kinetic: numbers(degree * degree),
            matrix: Vec::new(),
            square: Vec::new(),
            line: None,
            form,
            massless: MasslessRows::default(),
        };
        let tables = Tables {
            control_points: &mut scheme.control_points,
            shapes: &mut scheme.shapes,
            tests: &mut scheme.tests,
            kinetic: &mut scheme.kinetic,
        };
        tables.fill(&rule.nodes, &rule.weights)?;
        scheme.line = Line::of(&scheme.view());
        Ok(scheme)
    }

    fn of(galerkin: &Galerkin<T, 1, 1>, form: Form) -> Self {
        let view = galerkin.view();
        Self {
            weights: view.weights.to_vec(),
            nodes: view.nodes.to_vec(),
            control_points: view.control_points.to_vec(),
            shapes: view.shapes.to_vec(),
            tests: view.tests.to_vec(),
            kinetic: view.kinetic.to_vec(),
            matrix: Vec::new(),
            square: Vec::new(),
            line: Line::of(&view),
            form,
            massless: MasslessRows::default(),
        }
    }

    fn collocation<const R: usize>(method: &RungeKutta<R>) -> Self {
        let nodes: Vec<T> = super::vector(method.quadrature().nodes());
        Self {
            weights: super::vector(method.quadrature().weights()),
            // The unknowns are accelerations at the nodes.
            control_points: nodes.clone(),
            nodes,
            shapes: Vec::new(),
            tests: Vec::new(),
            kinetic: Vec::new(),
            matrix: super::vector(method.matrix().as_flattened()),
            square: super::vector(method.square().as_flattened()),
            line: None,
            form: Form::Collocation,
            massless: MasslessRows::default(),
        }
    }

    /// The same scheme for a system with these coordinates without mass.
    pub(crate) fn with_massless(self, massless: MasslessRows) -> Self {
        Self { massless, ..self }
    }

    /// The discrete Lagrangian.
    pub fn view(&self) -> DiscreteLagrangian<'_, T> {
        DiscreteLagrangian {
            weights: &self.weights,
            nodes: &self.nodes,
            control_points: &self.control_points,
            shapes: &self.shapes,
            tests: &self.tests,
            kinetic: &self.kinetic,
        }
    }

    /// A of collocation, R·R numbers row by row; `None` for other schemes.
    pub fn matrix(&self) -> Option<&[T]> {
        (self.form == Form::Collocation).then_some(&self.matrix)
    }

    /// A² of collocation, whose unknowns are accelerations; `None` for schemes that solve for increments.
    pub fn square(&self) -> Option<&[T]> {
        (self.form == Form::Collocation).then_some(&self.square)
    }

    /// True if the fractional force acts in the new momentum only.
    pub fn kicks_at_main_nodes(&self) -> bool {
        self.form == Form::MainNodes
    }
}

/// The coefficients of a discrete Lagrangian of degree one with one quadrature point.
#[derive(Clone, Copy, Debug)]
struct Line<T> {
    weights: [T; 1],
    nodes: [T; 1],
    control_points: [T; 1],
    shapes: [T; 1],
    tests: [T; 1],
    kinetic: [T; 1],
}

impl<T: Copy> Line<T> {
    fn of(any: &DiscreteLagrangian<'_, T>) -> Option<Self> {
        Some(Self {
            weights: any.weights.try_into().ok()?,
            nodes: any.nodes.try_into().ok()?,
            control_points: any.control_points.try_into().ok()?,
            shapes: any.shapes.try_into().ok()?,
            tests: any.tests.try_into().ok()?,
            kinetic: any.kinetic.try_into().ok()?,
        })
    }

    /// The discrete Lagrangian, as a view whose lengths are known to the compiler: its step has no loops over
    /// nodes and points.
    #[inline(always)]
    fn view(&self) -> DiscreteLagrangian<'_, T> {
        let Self { weights, nodes, control_points, shapes, tests, kinetic } = self;
        DiscreteLagrangian { weights, nodes, control_points, shapes, tests, kinetic }
    }
}

/// A quadrature on [0, 1].
struct Rule {
    nodes: Vec<f64>,
    weights: Vec<f64>,
}

impl Rule {
    fn of(quadrature: Quadrature) -> Result<Self, ParameterError> {
        let points = quadrature.points();
        let (mut nodes, mut weights) = (vec![0.0; points], vec![0.0; points]);
        match quadrature {
            Quadrature::Gauss(_) => gauss_rule(&mut nodes, &mut weights)?,
            Quadrature::Lobatto(_) => lobatto_rule(&mut nodes, &mut weights)?,
        }
        Ok(Self { nodes, weights })
    }

    fn of_method<const R: usize>(method: &RungeKutta<R>) -> Self {
        let quadrature = method.quadrature();
        Self { nodes: quadrature.nodes().to_vec(), weights: quadrature.weights().to_vec() }
    }
}

/// Workspace of a step, and data that a linear system reuses between steps.
pub struct StepBuffers<T: Real> {
    numbers: Numbers<T>,
    /// Buffers for coordinates without mass at the ends of steps.
    settling: Settling<T>,
    matrix: AnyEquations<T>,
    kept: CachedFactor<AnyFactors<T>, T>,
}

/// The vectors and matrices of a step apart from its equations.
struct Numbers<T: Real> {
    increments: Vec<T>,
    residual: Vec<T>,
    stages: Vec<T>,
    forces: Vec<T>,
    known: Vec<T>,
    scratch: Vec<T>,
    /// Offsets of the position from the nodes of the last sample, followed by the last restoring force and
    /// the means of coordinates without mass.
    carried: Vec<T>,
    /// Lengths of the first and the second of these parts.
    behind: usize,
    pulled: usize,
    moment_correction: Vec<T>,
    point: Vec<T>,
    stiffness: Matrix<T>,
}

impl<T: Real> Scheme<T, AnySpace> for AnyScheme<T> {
    type Storage = StepBuffers<T>;

    fn storage<G: Mechanics<T, AnySpace>>(&self, space: &AnySpace, mechanics: &G) -> StepBuffers<T> {
        let (size, degree, points) =
            (Space::<T>::coordinates(space), self.control_points.len(), self.nodes.len());
        let samples = self.sampling().nodes();
        let numbers = |count: usize| vec![T::zero(); count * size];
        let behind = if self.form == Form::Nodes { points } else { 0 };
        // For a linear system there is no guess.
        let guessed = !mechanics.is_linear() && self.line.is_some();
        StepBuffers {
            numbers: Numbers {
                increments: numbers(degree),
                residual: numbers(degree),
                stages: numbers(points),
                forces: numbers(points),
                known: numbers(samples),
                scratch: numbers(samples + 1),
                moment_correction: numbers(degree + 1),
                carried: vec![T::zero(); (behind + usize::from(guessed)) * size + self.massless.carried()],
                behind: behind * size,
                pulled: usize::from(guessed) * size,
                point: numbers(1),
                stiffness: mechanics.stiffness(),
            },
            settling: Settling::new(&self.massless, mechanics),
            matrix: space.equations(degree),
            kept: CachedFactor::nothing(AnyFactors::default()),
        }
    }

    fn carried(room: &StepBuffers<T>) -> &[T] {
        &room.numbers.carried
    }

    fn carried_mut(room: &mut StepBuffers<T>) -> &mut [T] {
        &mut room.numbers.carried
    }

    fn sampling(&self) -> Sampling<'_, T> {
        match self.form {
            Form::MainNodes | Form::EndOfStep => Sampling::MainNodes,
            Form::Nodes | Form::Collocation => Sampling::Nodes(&self.nodes),
        }
    }

    fn step<G: Mechanics<T, AnySpace>, D: Damping<T, AnySpace>>(
        &self,
        room: &mut StepBuffers<T>,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<Vec<T>>,
    ) -> Result<u32, StepError> {
        if !self.massless.is_empty() {
            room.settling.begin(&self.massless, &state.position);
        }
        // On a straight line with one node.
        let few = if self.line.is_some() { state.position.len() } else { 0 };
        let iterations = match few {
            1 => self.step_of_few::<1, _, _>(room, mechanics, damping, step, state),
            2 => self.step_of_few::<2, _, _>(room, mechanics, damping, step, state),
            3 => self.step_of_few::<3, _, _>(room, mechanics, damping, step, state),
            4 => {
                let StepBuffers { numbers, matrix, kept, .. } = room;
                numbers.step_of_known::<4, _, _, _>(self, (matrix, kept), mechanics, damping, step, state)
            }
            _ => self.step_of_any(room, mechanics, damping, step, state),
        }?;
        if !self.massless.is_empty() {
            let StepBuffers { numbers: room, settling, .. } = room;
            let (behind, rest) = room.carried.split_at_mut(room.behind);
            let (_, means) = rest.split_at_mut(room.pulled);
            let found = Found { weights: &self.weights, stages: &room.stages };
            let carried = Carried { behind, means, increments: &mut room.increments };
            settling.end(&self.massless, mechanics, step, &found, carried, state);
        }
        Ok(iterations)
    }
}

impl<T: Real> AnyScheme<T> {
    /// The step on a straight line with one node for N coordinates.
    #[inline(never)]
    fn step_of_few<const N: usize, G: Mechanics<T, AnySpace>, D: Damping<T, AnySpace>>(
        &self,
        room: &mut StepBuffers<T>,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<Vec<T>>,
    ) -> Result<u32, StepError> {
        let StepBuffers { numbers, matrix, kept, .. } = &mut *room;
        match FewEquations::<T, N>::of(matrix) {
            Some(mut few) => {
                numbers.step_of_known::<N, _, _, _>(self, (&mut few, kept), mechanics, damping, step, state)
            }
            None => self.step_of_any(room, mechanics, damping, step, state),
        }
    }

    /// The step for any number of coordinates.
    #[inline(never)]
    fn step_of_any<G: Mechanics<T, AnySpace>, D: Damping<T, AnySpace>>(
        &self,
        room: &mut StepBuffers<T>,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<Vec<T>>,
    ) -> Result<u32, StepError> {
        let StepBuffers { numbers: room, matrix, kept, .. } = room;
        let line = self.line.as_ref().map(Line::view);
        let (behind, rest) = room.carried.split_at_mut(room.behind);
        let mut work = Workspace::<T, AnySpace, _> {
            increments: &mut room.increments,
            residual: &mut room.residual,
            stages: &mut room.stages,
            forces: &mut room.forces,
            known: &mut room.known,
            scratch: &mut room.scratch,
            behind,
            restoring: &mut rest[..room.pulled],
            moment_correction: &mut room.moment_correction,
            point: &mut room.point,
            stiffness: &mut room.stiffness,
            matrix,
            kept,
        };
        match (self.form, line) {
            (Form::MainNodes, Some(line)) => {
                line.step_damped_at_main_nodes(&mut work, mechanics, damping, step, state)
            }
            (Form::EndOfStep | Form::Nodes, Some(line)) => {
                line.step_damped_at_nodes(&mut work, mechanics, damping, step, state)
            }
            (Form::MainNodes, None) => {
                self.view().step_damped_at_main_nodes(&mut work, mechanics, damping, step, state)
            }
            (Form::EndOfStep | Form::Nodes, None) => {
                self.view().step_damped_at_nodes(&mut work, mechanics, damping, step, state)
            }
            (Form::Collocation, _) => {
                let Self { matrix, square, weights, nodes, .. } = self;
                let tables = CollocationTables { matrix, square, weights, nodes };
                tables.step(&mut work, mechanics, damping, step, state)
            }
        }
    }
}

impl<T: Real> Numbers<T> {
    /// The step on a straight line with one node for N coordinates, compiled for them: without loops over
    /// vectors of any length, with the same bits.
    #[inline(always)]
    fn step_of_known<const N: usize, E, G, D>(
        &mut self,
        scheme: &AnyScheme<T>,
        (matrix, kept): (&mut E, &mut CachedFactor<E::Factor, T>),
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<Vec<T>>,
    ) -> Result<u32, StepError>
    where
        E: Equations<T, Matrix<T>>,
        G: Mechanics<T, AnySpace>,
        D: Damping<T, AnySpace>,
    {
        let line = scheme.line.expect("one point");
        let line = line.view();
        let (behind, rest) = self.carried.split_at_mut(self.behind);
        // On the stack their places are known.
        let [mut increments, mut stages, mut residual, mut forces, mut known, mut scratch] =
            [[T::zero(); N]; 6];
        let mut work = Workspace::<T, Small<N>, _> {
            increments: &mut increments,
            residual: &mut residual,
            stages: &mut stages,
            forces: &mut forces,
            known: &mut known,
            scratch: &mut scratch,
            behind,
            restoring: &mut rest[..self.pulled],
            moment_correction: &mut self.moment_correction,
            point: &mut self.point,
            stiffness: &mut self.stiffness,
            matrix,
            kept,
        };
        let made = match scheme.form {
            Form::MainNodes => {
                work.behind = &mut [];
                line.step_damped_at_main_nodes(&mut work, mechanics, damping, step, state)
            }
            _ => line.step_damped_at_nodes(&mut work, mechanics, damping, step, state),
        };
        *few_mut(&mut self.increments) = increments;
        *few_mut(&mut self.stages) = stages;
        made
    }
}

impl<T: Real> AnyScheme<T> {
    /// The solution of the last step: with the state at its beginning it determines
    /// [`interpolate`](Self::interpolate).
    pub fn solution(room: &StepBuffers<T>) -> &[T] {
        &room.numbers.increments
    }

    /// Moves position and momentum from the beginning of a step, of the given length, to the given fraction
    /// of it, by the polynomial of the scheme.
    pub fn interpolate(
        &self,
        solution: &[T],
        mechanics: &impl Mechanics<T, AnySpace>,
        (length, fraction): (T, T),
        position: &mut [T],
        momentum: &mut [T],
    ) {
        let size = position.len().max(1);
        let unknowns = || solution.chunks_exact(size);
        // Δq, and Δv for collocation or v.
        let (mut way, mut velocity) = (vec![T::zero(); size], vec![T::zero(); size]);
        if self.form == Form::Collocation {
            mechanics.velocity(momentum, &mut velocity);
            add_multiple(&mut way, length * fraction, &velocity);
            velocity.fill(T::zero());
            for (j, acceleration) in unknowns().enumerate() {
                let [once, mut twice] = integrals_of_shape(&self.nodes, j, fraction);
                if self.nodes.len() == 1 {
                    // With one stage the displacement follows from the final velocity, Δq = h (v + h a).
                    twice = fraction;
                }
                add_multiple(&mut velocity, length * once, acceleration);
                add_multiple(&mut way, length * length * twice, acceleration);
            }
            self.interpolate_massless(solution, (length, fraction), &mut way);
        } else {
            momentum.fill(T::zero());
            let points: Vec<T> =
                std::iter::once(T::zero()).chain(self.control_points.iter().copied()).collect();
            for (nu, increment) in unknowns().enumerate() {
                let (shape, slope) = shape(&points, nu + 1, fraction);
                add_multiple(&mut way, shape, increment);
                add_multiple(&mut velocity, slope / length, increment);
            }
        }
        add_multiple(position, T::one(), &way);
        mechanics.mass().multiply_add(T::one(), &velocity, momentum);
    }
}

impl<T: Real> AnyScheme<T> {
    /// Writes Δq of coordinates without mass inside a step of collocation: the polynomial through the
    /// beginning and the stages X_i − q_k = h² Σ_j (A²)_ij a_j, which their equations determine. That of
    /// positions with a velocity would begin with the velocity 0.
    fn interpolate_massless(&self, solution: &[T], (length, fraction): (T, T), way: &mut [T]) {
        let (size, stages) = (way.len().max(1), self.nodes.len());
        if self.massless.all.is_empty() {
            return;
        }
        let points: Vec<T> = std::iter::once(T::zero()).chain(self.nodes.iter().copied()).collect();
        let mut factors = vec![T::zero(); stages];
        for (i, row) in self.square.chunks_exact(stages).enumerate() {
            let (value, _) = shape(&points, i + 1, fraction);
            add_multiple(&mut factors, value * length * length, row);
        }
        for &row in &self.massless.all {
            let accelerations = solution.chunks_exact(size).map(|stage| stage[row]);
            way[row] = accelerations.zip(&factors).fold(T::zero(), |sum, (a, &factor)| sum + factor * a);
        }
    }
}

/// Value and derivative at τ of the polynomial that is 1 at one of the points and 0 at the others.
fn shape<T: Real>(points: &[T], own: usize, tau: T) -> (T, T) {
    let (mut value, mut derivative) = (T::one(), T::zero());
    for (_, &other) in points.iter().enumerate().filter(|&(index, _)| index != own) {
        let slope = T::one() / (points[own] - other);
        let factor = (tau - other) * slope;
        derivative = derivative * factor + value * slope;
        value *= factor;
    }
    (value, derivative)
}

/// ∫₀^θ ℓ_j and ∫₀^θ (θ − s) ℓ_j(s) ds, by Gauss points that are exact for the degrees of up to seven nodes.
fn integrals_of_shape<T: Real>(nodes: &[T], j: usize, theta: T) -> [T; 2] {
    let (mut points, mut weights) = ([0.0; 4], [0.0; 4]);
    let count = if nodes.len() > 5 { 4 } else { 3 };
    let (points, weights) = (&mut points[..count], &mut weights[..count]);
    let rule = gauss_rule(points, weights);
    debug_assert!(rule.is_ok(), "there are rules of three and four points");
    let mut integrals = [T::zero(); 2];
    for (&point, &weight) in points.iter().zip(&*weights) {
        let (s, weight) = (theta * T::of(point), theta * T::of(weight));
        let value = shape(nodes, j, s).0 * weight;
        integrals[0] += value;
        integrals[1] += value * (theta - s);
    }
    integrals
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_are_integrated_exactly() {
        // ℓ_1 of the nodes 1/3 and 1 is (3s − 1)/2; its integrals (3θ² − 2θ)/4 and (θ³ − θ²)/4.
        let nodes = [1.0_f64 / 3.0, 1.0];
        for theta in [0.0_f64, 0.3, 1.0] {
            let [once, twice] = integrals_of_shape(&nodes, 1, theta);
            assert!((once - (3.0 * theta * theta - 2.0 * theta) / 4.0).abs() < 1e-15);
            assert!((twice - (theta * theta * theta - theta * theta) / 4.0).abs() < 1e-15);
        }
        // Of s^m for any number of nodes that a method has, m below it.
        for count in [1, 2, 3, 5, 7] {
            let nodes: Vec<f64> = (1..=count).map(|j| f64::from(j) / f64::from(count)).collect();
            let (power, theta) = (count - 1, 0.7_f64);
            let [mut once, mut twice] = [0.0; 2];
            for (j, node) in nodes.iter().enumerate() {
                let integrals = integrals_of_shape(&nodes, j, theta);
                once += node.powi(power) * integrals[0];
                twice += node.powi(power) * integrals[1];
            }
            let exact = theta.powi(count) / f64::from(count);
            assert!((once - exact).abs() < 1e-13, "{count}: {once}");
            assert!((twice - exact * theta / f64::from(count + 1)).abs() < 1e-13, "{count}: {twice}");
        }
    }
}
