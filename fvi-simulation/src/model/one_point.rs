//! One coordinate, one quadrature point: steps so short that everything lies in place.

use super::mechanics::{SingleModel, matrix};
use super::scenario_space::{Remembers, ScenarioSpace, derivative};
use super::scheme::{AnyScheme, DenseOutput};
use crate::language::expression::Elementary;
use crate::scenario::{self, DampedAt, SampledInput, Scenario};
use core::ops::Range;
use core::slice::from_mut;
use fvi_core::{
    Block, Coefficients, Corrections, Damping, DampingError, DampingTerm, Fixed, Instant, Kernel,
    MatrixError, Mechanics, Memory, NodalRule, Outcome, ParameterError, Real, Sample, Sampling, Scheme,
    State, Step, StepError, add_multiple, conclude,
};
use nalgebra::SVector;

/// A discrete Lagrangian of degree one with one quadrature point, its tables in place.
#[derive(Clone, Debug)]
pub struct OnePoint<T> {
    at: DampedAt,
    weight: [T; 1],
    node: [T; 1],
    end: [T; 1],
    shape: [T; 1],
    test: [T; 1],
    kinetic: [T; 1],
}

impl<T: Real> OnePoint<T> {
    /// The same scheme in place, if it is of this kind.
    pub fn of(scheme: &AnyScheme<T>) -> Option<Self> {
        let at = scheme.one_point_form()?;
        let view = scheme.of_one_point()?;
        let one = |numbers: &[T]| <[T; 1]>::try_from(numbers).ok();
        let (weight, node, end) = (one(view.weights)?, one(view.nodes)?, one(view.control_points)?);
        let (shape, test, kinetic) = (one(view.shapes)?, one(view.tests)?, one(view.kinetic)?);
        Some(Self { at, weight, node, end, shape, test, kinetic })
    }
}

impl<T: Elementary> OnePoint<T> {
    /// Whether a scenario is stepped by such a scheme in the space of one coordinate.
    pub fn serves(scenario: &Scenario) -> bool {
        SingleModel::<T>::serves(scenario)
            && scenario.system.damping.iter().all(|term| term.attached.is_none())
            && AnyScheme::<T>::new(scenario).is_ok_and(|scheme| Self::of(&scheme).is_some())
    }
}

/// What a [`OnePoint`] scheme keeps between steps.
#[derive(Clone, Debug)]
pub struct OnePointRoom<T> {
    /// The reciprocal of a linear equation's slope, and the length of the steps that it is for; zero where it
    /// is for none.
    kept: (T, T),
    /// q_k − X_{k−1}, and what pulled there.
    carried: [T; 2],
    /// Which of them there are: the first where the memory stores the quadrature node, the second where the
    /// system is not linear.
    present: Range<usize>,
    /// q_{k+1} − q_k of the last step.
    increment: [T; 1],
}

impl<T: Real> Scheme<T, Fixed<1>> for OnePoint<T> {
    type Storage = OnePointRoom<T>;

    fn storage<G: Mechanics<T, Fixed<1>>>(&self, _: &Fixed<1>, mechanics: &G) -> OnePointRoom<T> {
        OnePointRoom {
            kept: (T::zero(), T::zero()),
            carried: [T::zero(); 2],
            present: usize::from(self.at != DampedAt::Nodes)..2 - usize::from(mechanics.is_linear()),
            increment: [T::zero()],
        }
    }

    fn carried(room: &OnePointRoom<T>) -> &[T] {
        &room.carried[room.present.clone()]
    }

    fn carried_mut(room: &mut OnePointRoom<T>) -> &mut [T] {
        &mut room.carried[room.present.clone()]
    }

    fn sampling(&self) -> Sampling<'_, T> {
        match self.at {
            DampedAt::MainNodes => Sampling::MainNodes,
            DampedAt::Nodes => Sampling::Nodes(&self.node),
        }
    }

    #[inline]
    fn step<G: Mechanics<T, Fixed<1>>, D: Damping<T, Fixed<1>>>(
        &self,
        room: &mut OnePointRoom<T>,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<SVector<T, 1>>,
    ) -> Result<u32, StepError> {
        match self.at {
            DampedAt::MainNodes => self.make::<false, _, _>(room, mechanics, damping, step, state),
            DampedAt::Nodes => self.make::<true, _, _>(room, mechanics, damping, step, state),
        }
    }
}

impl<T: Real> OnePoint<T> {
    /// A step as [`fvi_core::DiscreteLagrangian::step_damped_at_nodes`] or, where that is not `AT_NODE`,
    /// [`fvi_core::DiscreteLagrangian::step_damped_at_main_nodes`] makes it, to the bit.
    #[inline(always)]
    fn make<const AT_NODE: bool, G: Mechanics<T, Fixed<1>>, D: Damping<T, Fixed<1>>>(
        &self,
        room: &mut OnePointRoom<T>,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<SVector<T, 1>>,
    ) -> Result<u32, StepError> {
        let h = step.size;
        let OnePointRoom { kept, carried: [behind, pulled], increment, .. } = room;
        let fractions = if AT_NODE { self.node } else { [T::one()] };
        let behind = if AT_NODE { from_mut(behind) } else { &mut [] };
        let (mut known, mut scratch) = ([T::zero()], [T::zero(); 2]);
        let from = state.position.as_slice();
        let sample = Sample { from, behind, time: step.time, length: h, fractions: &fractions };
        damping.add_known(&sample, &mut known, &mut scratch)?;

        let drifts = self.test[0] == T::zero();
        let mut moments = [T::zero(); 2];
        let rough = !drifts && mechanics.is_rough() && self.write_moments(mechanics, step, &mut moments);
        let is_linear = mechanics.is_linear();
        let mut line = Line::<AT_NODE, _, _, _> {
            scheme: self,
            mechanics,
            damping: &*damping,
            step,
            position: state.position[0],
            momentum: state.momentum[0],
            known: known[0],
            moment: if rough { Some(moments[0]) } else { None },
            stage: T::zero(),
            force: T::zero(),
        };
        let (e, iterations) = if drifts {
            let e = line.drift(line.momentum) * h;
            line.look(e);
            (e, 0)
        } else if is_linear {
            (line.solve_linear(kept)?, 1)
        } else {
            line.solve(*pulled)?
        };
        let (stage, force) = (line.stage, line.force);

        let mut impulse = force * (h * self.weight[0]);
        if rough {
            impulse = impulse - moments[0] * h - moments[1] * h;
        }
        let kick = if AT_NODE {
            -impulse
        } else {
            damping.add_leading(&[e], &mut known, &mut scratch);
            -impulse - known[0] * h
        };
        let increments = if AT_NODE { &[stage] } else { &[e] };
        let found = Outcome { increments, rise: &[e], kick: &[kick] };
        conclude(damping, step, &fractions, &found, state, behind, &mut scratch)?;
        (*pulled, *increment) = (force, [e]);
        Ok(iterations)
    }

    /// Writes what exact moments of the force exceed the node by; returns whether they do.
    #[inline(never)]
    fn write_moments<G: Mechanics<T, Fixed<1>>>(
        &self,
        mechanics: &mut G,
        step: &Step<'_, T>,
        moments: &mut [T; 2],
    ) -> bool {
        let rule = NodalRule {
            start: step.time,
            length: step.size,
            weights: &self.weight,
            nodes: &self.node,
            points: &self.end,
            shapes: &self.shape,
            tests: &self.test,
        };
        mechanics.moment_correction(&rule, moments)
    }
}

/// The equation of a step,
///
/// ```text
/// 0 = p_k + (K/h) m e − h b ℓ₀(c) G ,     G = U′(X) − F(t_k + ch, X) − u ,     X = q_k + ℓ₁(c) e ,
/// ```
///
/// G with the fractional force where that acts `AT_NODE`, for e = q_{k+1} − q_k.
struct Line<'a, const AT_NODE: bool, T, G, D> {
    scheme: &'a OnePoint<T>,
    mechanics: &'a mut G,
    damping: &'a D,
    step: &'a Step<'a, T>,
    position: T,
    momentum: T,
    /// What is known of the fractional force.
    known: T,
    /// The first moment of the force that the node lacks.
    moment: Option<T>,
    /// X − q_k, and G there.
    stage: T,
    force: T,
}

impl<const AT_NODE: bool, T, G, D> Line<'_, AT_NODE, T, G, D>
where
    T: Real,
    G: Mechanics<T, Fixed<1>>,
    D: Damping<T, Fixed<1>>,
{
    /// v of a momentum.
    #[inline(always)]
    fn drift(&self, momentum: T) -> T {
        let mut velocity = [T::zero()];
        self.mechanics.drift(&[momentum], &mut velocity);
        velocity[0]
    }

    fn instant(&self) -> Instant<T> {
        Instant::in_step(self.step.time, self.scheme.node[0], self.step.size)
    }

    /// Finds G where e leads.
    #[inline(always)]
    fn look(&mut self, e: T) {
        self.stage = e * self.scheme.shape[0];
        self.look_at(self.position + self.stage);
        self.add_leading();
    }

    /// Finds G at X, but for what e adds to the damping.
    #[inline(always)]
    fn look_at(&mut self, point: T) {
        let mut force = [T::zero()];
        self.mechanics.restoring_force(self.instant(), &SVector::from([point]), &mut force);
        self.force = self.with_input(force[0]);
    }

    /// Finds G where e leads, and its slope ∂²U/∂q² − ∂F/∂q.
    #[inline(always)]
    fn linearise(&mut self, e: T) -> Coefficients<T, 1> {
        self.stage = e * self.scheme.shape[0];
        let (mut force, mut stiffness) = ([T::zero()], Coefficients::Diagonal(SVector::zeros()));
        let point = SVector::from([self.position + self.stage]);
        self.mechanics.linearise(self.instant(), &point, &mut force, &mut stiffness);
        self.force = self.with_input(force[0]);
        self.add_leading();
        stiffness
    }

    /// G of what pulls.
    #[inline(always)]
    fn with_input(&self, restoring: T) -> T {
        let force = self.step.input.first().map_or(restoring, |&input| restoring - input);
        if AT_NODE { force + self.known } else { force }
    }

    #[inline(always)]
    fn add_leading(&mut self) {
        if AT_NODE {
            let mut force = [self.force];
            self.damping.add_leading(&[self.stage], &mut force, &mut [T::zero()]);
            [self.force] = force;
        }
    }

    /// What the equation leaves.
    #[inline(always)]
    fn balance(&self, e: T) -> T {
        let (h, scheme) = (self.step.size, self.scheme);
        let factor = h * scheme.weight[0] * scheme.test[0];
        let mut left = [T::zero()];
        let known: (&[T], _) = (&[self.momentum], (factor, &[self.force][..]));
        self.mechanics.mass().balance(known, (scheme.kinetic[0] / h, &[e]), &mut left);
        self.moment.map_or(left[0], |moment| left[0] + moment * h)
    }

    /// What the equation leaves, a finite number.
    #[inline(always)]
    fn finite_balance(&self, e: T) -> Result<T, StepError> {
        let left = self.balance(e);
        if left.is_finite() { Ok(left) } else { Err(StepError::NotFinite) }
    }

    /// Its slope in e.
    #[inline(always)]
    fn slope(&self, stiffness: &Coefficients<T, 1>) -> T {
        let (h, scheme) = (self.step.size, self.scheme);
        let factor = h * scheme.weight[0] * scheme.test[0] * scheme.shape[0];
        let mut slope = [T::zero()];
        let mut add = |factor: T, block: &Coefficients<T, 1>| {
            block.multiply_add(factor, &[T::one()], &mut slope);
        };
        add(scheme.kinetic[0] / h, self.mechanics.mass());
        add(-factor, stiffness);
        if AT_NODE {
            self.damping.visit_leading(1, |_, _, leading, rho| add(-(factor * leading), rho));
        }
        slope[0]
    }

    /// Finds G where e leads, and the slope of the equation there. Linear systems look at it once: not worth
    /// its place.
    #[inline(never)]
    fn prepare(&mut self, e: T) -> Result<T, StepError> {
        let stiffness = self.linearise(e);
        pivot(self.slope(&stiffness))
    }

    /// Solves the equation of a linear system with the reciprocal of its slope, twice: its rounding is the
    /// same at every step, and would add up to growth or decay.
    #[inline(always)]
    fn solve_linear(&mut self, (reciprocal, length): &mut (T, T)) -> Result<T, StepError> {
        let h = self.step.size;
        // Where damping acts no guess is needed, and a stiff motion at speed would be guessed so far off that
        // its place is lost in rounding.
        let guess = if AT_NODE { T::zero() } else { self.drift(self.momentum) * h };
        if *length != h {
            *reciprocal = T::one() / self.prepare(guess)?;
            let stays = !AT_NODE || self.damping.leading_is_constant();
            *length = if stays { h } else { T::zero() };
        } else if AT_NODE {
            self.look_at(self.position);
        } else {
            self.look(guess);
        }
        let once = guess - self.balance(guess) * *reciprocal;
        self.look(once);
        let e = once - self.balance(once) * *reciprocal;
        self.stage = e * self.scheme.shape[0];
        Ok(e)
    }

    /// Solves the equation by Newton's method, from where the force of the last step would lead.
    #[inline(always)]
    fn solve(&mut self, pulled: T) -> Result<(T, u32), StepError> {
        let (h, scheme, p) = (self.step.size, self.scheme, self.momentum);
        // No further than twice as far as without forces: where they are stiff those of the last step say
        // nothing.
        let change = pulled * (h * scheme.weight[0] * scheme.test[0]);
        let expected = if change.abs() > p.abs() { p } else { p - change };
        let mut e = self.drift(expected) * -(h / scheme.kinetic[0]);

        let mut corrections = Corrections::new(size(self.position));
        let (stiffness, correction, converged) = loop {
            let stiffness = self.linearise(e);
            let residual = self.finite_balance(e)?;
            let slope = pivot(self.slope(&stiffness))?;
            let correction = residual / slope;
            e -= correction;
            let sizes = (size(correction), size(e));
            if let Some(converged) = corrections.judge(size(residual), sizes, true)? {
                break (stiffness, correction, converged);
            }
            if !corrections.takes_factors_again() {
                continue;
            }
            self.look(e);
            let residual = self.finite_balance(e)?;
            let correction = residual / slope;
            e -= correction;
            let sizes = (size(correction), size(e));
            if let Some(converged) = corrections.judge(size(residual), sizes, true)? {
                break (stiffness, correction, converged);
            }
        };
        // The force at the end is the last one and its linear change, where what that leaves is rounding.
        let rounding = T::of(0.25) * T::EPSILON * h * scheme.weight[0] * size(self.force);
        if converged.residual.is_some_and(|left| left <= rounding) {
            self.stage = -(correction * scheme.shape[0]);
            let mut force = [self.force];
            stiffness.multiply_add(T::one(), &[self.stage], &mut force);
            [self.force] = force;
            self.add_leading();
            self.stage = e * scheme.shape[0];
        } else {
            self.look(e);
        }
        Ok((e, converged.iterations))
    }
}

/// The slope of an equation that can be solved.
#[inline(always)]
fn pivot<T: Real>(slope: T) -> Result<T, StepError> {
    if slope.is_finite() && slope != T::zero() { Ok(slope) } else { Err(StepError::SingularJacobian) }
}

/// |x|; not a number if x is not finite.
#[expect(clippy::eq_op, reason = "x − x tells a finite number from others")]
#[inline(always)]
fn size<T: Real>(x: T) -> T {
    x.abs() + (x - x)
}

impl<T: Real> DenseOutput<T, Fixed<1>> for OnePoint<T> {
    fn solution(room: &OnePointRoom<T>) -> &[T] {
        &room.increment
    }

    fn interpolate(
        &self,
        solution: &[T],
        mechanics: &impl Mechanics<T, Fixed<1>>,
        (length, fraction): (T, T),
        position: &mut [T],
        momentum: &mut [T],
    ) {
        // A straight line.
        let Some(&increment) = solution.first() else { return };
        add_multiple(position, fraction, solution);
        momentum.fill(T::zero());
        mechanics.mass().multiply_add(T::one(), &[increment * (T::one() / length)], momentum);
    }
}

impl<T: Elementary, M: Memory<T>> Remembers<M> for DampingTerm<T, Fixed<1>, M> {
    fn memory(&self) -> &M {
        DampingTerm::memory(self)
    }
}

impl<T: Elementary> ScenarioSpace<T> for Fixed<1> {
    type System = SingleModel<T>;
    type Scheme = OnePoint<T>;
    type Term<M: Memory<T>> = DampingTerm<T, Self, M>;

    fn system(&self, scenario: &Scenario) -> Result<SingleModel<T>, MatrixError> {
        SingleModel::new(scenario)
    }

    fn scheme(&self, scenario: &Scenario) -> Result<OnePoint<T>, ParameterError> {
        let allowed = "a scheme of degree 1 with one point";
        let other = ParameterError { parameter: "scheme", value: f64::NAN, allowed };
        OnePoint::of(&AnyScheme::new(scenario)?).ok_or(other)
    }

    fn vector(&self, numbers: &[f64]) -> SVector<T, 1> {
        SVector::from_iterator(numbers.iter().map(|&number| T::of(number)))
    }

    fn missed(system: &SingleModel<T>) -> Option<f64> {
        system.missed()
    }

    fn live(system: &mut SingleModel<T>) -> Option<&mut SampledInput> {
        system.live()
    }

    fn channels(&self, _: &scenario::Damping) -> usize {
        1
    }

    fn follow_alike(&self, _: &scenario::Damping, _: &scenario::Damping) -> bool {
        // One coordinate's exponentials are few, and steps of a known size know terms one by one.
        false
    }

    fn term<M: Memory<T>>(
        &self,
        terms: &[(&scenario::Damping, Kernel)],
        memory: M,
    ) -> Result<DampingTerm<T, Self, M>, DampingError> {
        let (term, kernel) = terms[0];
        let mut rho = [T::zero()];
        matrix(&term.coefficient).multiply_add(T::one(), &[T::one()], &mut rho);
        DampingTerm::new(kernel, Coefficients::Diagonal(rho.into()), derivative(term), memory)
    }
}
