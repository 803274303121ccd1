//! Galerkin discrete Lagrangians: polynomial trajectories, quadrature of the action, and the step they give.

use nalgebra::SVector;

use crate::damping::AffineForce;
use crate::error::ParameterError;
use crate::linear::Nodes;
use crate::newton::newton;
use crate::quadrature::{Quadrature, lobatto_half};
use crate::real::Real;
use crate::scheme::{Sampling, Scheme, StepEnd, StepError, StepStart};
use crate::system::{Force, Instant, Potential, System};

/// Discrete Lagrangian on polynomials of degree S with a quadrature of Q points.
///
/// ```text
/// L_d = h Σ_i b_i L(q_d(c_i h), q̇_d(c_i h)) ,     q_d(τh) = q_k + Σ_{ν=1}^{S} ℓ_ν(τ) e^ν ,     e^ν = q^ν − q_k
/// ```
///
/// through the control points 0 = d₀ < d₁ < … < d_S = 1. Degree 1 with one point at 1 − κ is the low-order discrete Lagrangian
/// (1/2h) Δqᵀ M Δq − h U(κ q_k + (1−κ) q_{k+1}), see [`low_order`](Galerkin::low_order).
///
/// As a [`Scheme`] it is the fractional variational integrator in (q, p) form, whose memory stores the main nodes:
///
/// ```text
/// p_k = −D₁L_d − f₀ ,    0 = D_νL_d + f_ν (inner nodes) ,    p_{k+1} = D_{S+1}L_d + f_S − h Σ_m ρ_m (D^{β_m} q)_{k+1}
/// ```
///
/// with the virtual work f_ν = h Σ_i b_i ℓ_ν(c_i) F of the external force. Eliminating p gives \[JO\] Algorithm 3 and \[HJO\] eq. 38a,
/// 44a–b (Algorithm 1). The fractional force involves q_{k+1} only after the first two lines have found it.
///
/// Source: \[JO\] eq. 45a, 57, 63–66; \[HJO\] eq. 6–7, 42.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Galerkin<T, const S: usize, const Q: usize> {
    /// Quadrature weights b_i.
    weights: [T; Q],
    /// Quadrature nodes c_i.
    nodes: [T; Q],
    /// Control points d_1 … d_S.
    control_points: [T; S],
    /// ℓ_ν(c_i), ν = 1…S.
    shapes: [[T; S]; Q],
    /// ℓ_ν(c_i), ν = 0…S−1: the shapes that the S equations are tested with.
    tests: [[T; S]; Q],
    /// Σ_i b_i ℓ̇_ν(c_i) ℓ̇_μ(c_i), row ν = 0…S−1, column μ = 1…S.
    kinetic: [[T; S]; S],
}

/// Value and derivative at τ of the Lagrange polynomial ℓ_ν with ℓ_ν(d_μ) = δ_νμ.
fn lagrange(points: &[f64], nu: usize, tau: f64) -> (f64, f64) {
    let own = points.get(nu).copied().unwrap_or(0.0);
    let (mut value, mut derivative) = (1.0, 0.0);
    for (_, &other) in points.iter().enumerate().filter(|&(mu, _)| mu != nu) {
        let (factor, slope) = ((tau - other) / (own - other), 1.0 / (own - other));
        derivative = derivative * factor + value * slope;
        value *= factor;
    }
    (value, derivative)
}

impl<T: Real, const S: usize, const Q: usize> Galerkin<T, S, Q> {
    /// Polynomials of degree S through the Lobatto points of S + 1 nodes, with the given quadrature.
    ///
    /// The conservative part has the order min(2S, u), u the order of the quadrature (\[HJO\] §2.3 with its references): 2Q
    /// for Gauss, 2Q − 2 for Lobatto. S = Q with Gauss points is the Gauss collocation method.
    ///
    /// ```
    /// # use fvi_core::{Galerkin, Quadrature};
    /// // Degree 2 with two Gauss points, order 4: the scheme of [HJO] §5.1.
    /// let scheme = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss()?)?;
    /// // One point cannot tell parabolas apart: the kinetic part would be singular.
    /// assert!(Galerkin::<f64, 2, 1>::new(&Quadrature::gauss()?).is_err());
    /// # Ok::<(), fvi_core::ParameterError>(())
    /// ```
    ///
    /// Source: \[HJO\] eq. 6–7, 42.
    ///
    /// # Errors
    /// If S is not one of 1…6, or Q is less than S: Σ_i b_i ℓ̇_ν(c_i) ℓ̇_μ(c_i) is then singular.
    pub fn new(quadrature: &Quadrature<Q>) -> Result<Self, ParameterError> {
        let half = S.checked_add(1).and_then(lobatto_half).ok_or(ParameterError {
            parameter: "degree of the polynomials",
            value: S as f64,
            allowed: "one of 1, 2, 3, 4, 5, 6",
        })?;
        ParameterError::check(
            quadrature.active() >= S,
            "number of quadrature points",
            quadrature.active() as f64,
            "at least the degree of the polynomials",
        )?;
        let mut points = [0.0; MAX_DEGREE + 1];
        let points = points.get_mut(..=S).unwrap_or(&mut []);
        for (point, &(d, _)) in points.iter_mut().zip(half) {
            *point = d;
        }
        for (point, &(d, _)) in points.iter_mut().rev().zip(half) {
            *point = 1.0 - d;
        }
        let (points, zero) = (&*points, T::zero());
        let mut galerkin = Self {
            weights: quadrature.weights.map(T::of),
            nodes: quadrature.nodes.map(T::of),
            control_points: [zero; S],
            shapes: [[zero; S]; Q],
            tests: [[zero; S]; Q],
            kinetic: [[zero; S]; S],
        };
        for (place, &point) in galerkin.control_points.iter_mut().zip(points.iter().skip(1)) {
            *place = T::of(point);
        }
        let at_nodes = quadrature.nodes.iter().zip(galerkin.shapes.iter_mut().zip(&mut galerkin.tests));
        for (&node, (shapes, tests)) in at_nodes {
            for (nu, (shape, test)) in shapes.iter_mut().zip(tests).enumerate() {
                *shape = T::of(lagrange(points, nu + 1, node).0);
                *test = T::of(lagrange(points, nu, node).0);
            }
        }
        for (nu, row) in galerkin.kinetic.iter_mut().enumerate() {
            for (mu, entry) in row.iter_mut().enumerate() {
                let product = |node| lagrange(points, nu, node).1 * lagrange(points, mu + 1, node).1;
                let terms = quadrature.nodes.iter().zip(&quadrature.weights);
                *entry = T::of(terms.map(|(&node, weight)| weight * product(node)).sum());
            }
        }
        Ok(galerkin)
    }

    /// Twice L_d on the nodes v, x_1, …, x_{S−1}, −v of a motion that turns round every step, as (kinetic, potential)
    /// coefficients of (1/h) M and h K for the unknowns (v, x_1, …, x_{S−1}).
    ///
    /// Row sums of the kinetic matrix vanish, which gives the products with ℓ₀ − ℓ_S from those that are kept.
    pub(crate) fn alternating_form(&self) -> [[(T, T); S]; S] {
        let last = S.saturating_sub(1);
        let kept = |nu: usize, mu: usize| {
            self.kinetic.get(nu).and_then(|row| row.get(mu.wrapping_sub(1))).copied().unwrap_or(T::zero())
        };
        // K_νμ for ν, μ = 0…S−1 of the full symmetric matrix.
        let kinetic = |nu: usize, mu: usize| {
            if mu > 0 {
                kept(nu, mu)
            } else if nu > 0 {
                kept(mu, nu)
            } else {
                (1..=S).fold(T::zero(), |sum, mu| sum - kept(0, mu))
            }
        };
        let to_end = |nu: usize| kept(nu, S);
        let end = (0..S).fold(T::zero(), |sum, nu| sum - to_end(nu));
        let mut form = [[(T::zero(), T::zero()); S]; S];
        for (nu, row) in form.iter_mut().enumerate() {
            for (mu, (kinetic_entry, potential_entry)) in row.iter_mut().enumerate() {
                let mut entry = kinetic(nu, mu);
                if nu == 0 {
                    entry -= to_end(mu);
                }
                if mu == 0 {
                    entry -= to_end(nu);
                }
                if nu == 0 && mu == 0 {
                    entry += end;
                }
                *kinetic_entry = entry;
                let quadrature = self.weights.iter().zip(&self.tests).zip(&self.shapes);
                for ((&weight, tests), shapes) in quadrature {
                    let value = |nu: usize| {
                        let own = tests.get(nu).copied().unwrap_or(T::zero());
                        let end = shapes.get(last).copied().unwrap_or(T::zero());
                        if nu == 0 { own - end } else { own }
                    };
                    *potential_entry += weight * value(nu) * value(mu);
                }
            }
        }
        form
    }

    /// Quadrature nodes c_i.
    pub fn nodes(&self) -> &[T; Q] {
        &self.nodes
    }
}

/// Largest degree S of the polynomials.
const MAX_DEGREE: usize = 6;

impl<T: Real> Galerkin<T, 1, 1> {
    /// The low-order discrete Lagrangian of \[JO\] eq. 57, potential at κ q_k + (1−κ) q_{k+1}.
    ///
    /// κ = ½ is the midpoint rule (order 2 for the conservative part); κ = 0 and 1 are the two symplectic Euler methods.
    ///
    /// # Errors
    /// If κ is outside [0, 1].
    pub fn low_order(kappa: T) -> Result<Self, ParameterError> {
        ParameterError::check(
            kappa >= T::zero() && kappa <= T::one(),
            "kappa",
            kappa.to_f64(),
            "at least 0 and at most 1",
        )?;
        let node = T::one() - kappa;
        Ok(Self {
            weights: [T::one()],
            nodes: [node],
            control_points: [T::one()],
            shapes: [[node]],
            tests: [[kappa]],
            kinetic: [[-T::one()]],
        })
    }
}

/// What the equations of a step say once the nodes are found.
pub(crate) struct Solution<T, const N: usize, const S: usize> {
    /// e^1 … e^S.
    pub(crate) increments: Nodes<T, N, S>,
    /// h Σ_i b_i G_i, what the momentum loses by the forces at the quadrature nodes.
    pub(crate) impulse: SVector<T, N>,
    pub(crate) iterations: u32,
}

impl<T: Real, const S: usize, const Q: usize> Galerkin<T, S, Q> {
    /// X_i − q_k = Σ_ν ℓ_ν(c_i) e^ν.
    #[inline]
    pub(crate) fn stages<const N: usize>(&self, increments: &Nodes<T, N, S>) -> Nodes<T, N, Q> {
        self.shapes.map(|shapes| {
            shapes.iter().zip(increments).fold(SVector::zeros(), |sum, (&shape, e)| sum + e * shape)
        })
    }

    /// Solves the first S equations for the nodes.
    ///
    /// With G_i = ∇U(X_i) − F(t_k + c_i h, X_i) − u, plus the fractional force where it acts at the stages, equation ν = 0…S−1 is
    ///
    /// ```text
    /// 0 = δ_{ν0} p_k + (1/h) Σ_μ K_{νμ} M e^μ − h Σ_i b_i ℓ_ν(c_i) G_i ,      K_{νμ} = Σ_i b_i ℓ̇_ν(c_i) ℓ̇_μ(c_i)
    /// ```
    ///
    /// The shapes add to one and their derivatives to zero, so the last equation is p_{k+1} = p_k − h Σ_i b_i G_i.
    #[inline]
    pub(crate) fn solve<const N: usize, P: Potential<T, N>, F: Force<T, N>>(
        &self,
        system: &System<T, N, P, F>,
        start: &StepStart<T, N>,
        stage_force: Option<&AffineForce<T, N, Q>>,
    ) -> Result<Solution<T, N, S>, StepError> {
        let h = start.step_size;
        let instants = self.nodes.map(|node| Instant::in_step(start.time, node, h));
        let forces = |stages: &Nodes<T, N, Q>| {
            let mut forces = [SVector::zeros(); Q];
            let nodes = stages.iter().zip(instants).zip(&self.weights);
            for (i, (force, ((stage, instant), &weight))) in forces.iter_mut().zip(nodes).enumerate() {
                if weight == T::zero() {
                    continue;
                }
                *force = system.pull(instant, &(start.position + stage)) - start.input;
                if let Some(damping) = stage_force {
                    *force += damping.at(i, stages);
                }
            }
            forces
        };
        let drift = system.mass.velocity(&start.momentum) * h;
        let mut increments = self.control_points.map(|point| drift * point);
        let mass = system.mass.matrix();
        let dense_mass = mass.to_matrix();
        let iterations = newton(&mut increments, start.position.amax(), |increments, jacobian| {
            let stages = self.stages(increments);
            let forces = forces(&stages);
            let mut residual = [SVector::zeros(); S];
            if let Some(first) = residual.first_mut() {
                *first = start.momentum;
            }
            for ((residual, blocks), kinetic) in
                residual.iter_mut().zip(jacobian.iter_mut()).zip(&self.kinetic)
            {
                for ((block, &kinetic), increment) in blocks.iter_mut().zip(kinetic).zip(increments) {
                    let factor = kinetic / h;
                    *block = dense_mass * factor;
                    *residual += mass.multiply(increment) * factor;
                }
            }
            let quadrature = self.weights.iter().zip(&self.tests).zip(&self.shapes);
            for (i, (((&weight, tests), shapes), (force, (stage, &instant)))) in
                quadrature.zip(forces.iter().zip(stages.iter().zip(&instants))).enumerate()
            {
                if weight == T::zero() {
                    continue;
                }
                let stiffness = system.stiffness(instant, &(start.position + stage));
                for ((residual, blocks), &test) in residual.iter_mut().zip(jacobian.iter_mut()).zip(tests) {
                    let factor = h * weight * test;
                    *residual -= force * factor;
                    for (block, &shape) in blocks.iter_mut().zip(shapes) {
                        *block -= stiffness * (factor * shape);
                    }
                    let damping_row = stage_force.and_then(|damping| damping.leading.get(i));
                    for (leading, shapes) in damping_row.into_iter().flatten().zip(&self.shapes) {
                        for (block, &shape) in blocks.iter_mut().zip(shapes) {
                            *block -= leading * (factor * shape);
                        }
                    }
                }
            }
            residual
        })?;
        let impulse = self
            .weights
            .iter()
            .zip(&forces(&self.stages(&increments)))
            .fold(SVector::zeros(), |sum, (&weight, force)| sum + force * (h * weight));
        Ok(Solution { increments, impulse, iterations })
    }
}

impl<T: Real, const N: usize, const S: usize, const Q: usize> Scheme<T, N, 1> for Galerkin<T, S, Q> {
    fn sampling(&self) -> Sampling<T, 1> {
        Sampling::MainNodes
    }

    #[inline]
    fn step<P: Potential<T, N>, F: Force<T, N>>(
        &self,
        system: &System<T, N, P, F>,
        start: &StepStart<T, N>,
        damping: &AffineForce<T, N, 1>,
    ) -> Result<StepEnd<T, N, 1>, StepError> {
        let solution = self.solve(system, start, None)?;
        let rise = solution.increments.last().copied().unwrap_or_else(SVector::zeros);
        let position = start.position + rise;
        let momentum = start.momentum - solution.impulse - damping.at(0, &[rise]) * start.step_size;
        Ok(StepEnd { position, momentum, samples: [position], iterations: solution.iterations })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runge_kutta::RungeKutta;
    use crate::system::{Coefficients, Mass};
    use nalgebra::{SMatrix, matrix, vector};

    struct Coupled;

    impl Potential<f64, 2> for Coupled {
        fn value(&self, q: &SVector<f64, 2>) -> f64 {
            1.5 * q[0] * q[0] + q[0].powi(4) / 4.0 + (q[0] - 2.0 * q[1]).cos()
        }

        fn gradient(&self, q: &SVector<f64, 2>) -> SVector<f64, 2> {
            let sine = (q[0] - 2.0 * q[1]).sin();
            vector![3.0 * q[0] + q[0].powi(3) - sine, 2.0 * sine]
        }

        fn hessian(&self, q: &SVector<f64, 2>) -> SMatrix<f64, 2, 2> {
            let cosine = (q[0] - 2.0 * q[1]).cos();
            matrix![3.0 + 3.0 * q[0] * q[0] - cosine, 2.0 * cosine; 2.0 * cosine, -4.0 * cosine]
        }
    }

    struct Push;

    impl Force<f64, 2> for Push {
        fn value(&self, instant: Instant<f64>, q: &SVector<f64, 2>) -> SVector<f64, 2> {
            vector![(2.0 * instant.time).cos() - q[1] / 4.0, instant.time * q[0] / 8.0]
        }

        fn jacobian(&self, instant: Instant<f64>, _: &SVector<f64, 2>) -> SMatrix<f64, 2, 2> {
            matrix![0.0, -0.25; instant.time / 8.0, 0.0]
        }
    }

    fn system() -> System<f64, 2, Coupled, Push> {
        let mass = Mass::new(Coefficients::Dense(matrix![2.0, 0.5; 0.5, 1.0])).unwrap();
        System { mass, potential: Coupled, force: Push }
    }

    const START: StepStart<f64, 2> = StepStart {
        time: 0.7,
        step_size: 0.25,
        position: SVector::<f64, 2>::new(0.4, -0.3),
        momentum: SVector::<f64, 2>::new(1.2, 0.5),
        input: SVector::<f64, 2>::new(0.3, -0.2),
    };

    /// Value and derivative of the polynomial through (points, values), by Neville's scheme.
    fn interpolate(
        points: &[f64],
        values: &[SVector<f64, 2>],
        tau: f64,
    ) -> (SVector<f64, 2>, SVector<f64, 2>) {
        let mut table: std::vec::Vec<_> = values.iter().map(|&value| (value, SVector::zeros())).collect();
        for level in 1..points.len() {
            for i in 0..points.len() - level {
                let (left, right) = (points[i], points[i + level]);
                let ((a, da), (b, db)) = (table[i], table[i + 1]);
                let width = right - left;
                let value = (a * (right - tau) + b * (tau - left)) / width;
                let derivative = (b - a + da * (right - tau) + db * (tau - left)) / width;
                table[i] = (value, derivative);
            }
        }
        table[0]
    }

    /// The solved step must satisfy p_k = −D₁L_d − f₀, 0 = D_νL_d + f_ν, p_{k+1} = D_{S+1}L_d + f_S, with L_d and the virtual
    /// work of the forces computed from their definitions and D by differences.
    fn assert_stationary<const S: usize, const Q: usize>(
        quadrature: &Quadrature<Q>,
        control_points: &[f64],
        damping: Option<&AffineForce<f64, 2, Q>>,
    ) {
        let galerkin = Galerkin::<f64, S, Q>::new(quadrature).unwrap();
        let (system, h) = (system(), START.step_size);
        let solution = galerkin.solve(&system, &START, damping).unwrap();
        let mut nodes = std::vec![START.position];
        nodes.extend(solution.increments.iter().map(|increment| START.position + increment));
        let rules = || quadrature.nodes.iter().zip(&quadrature.weights);
        let action = |nodes: &[SVector<f64, 2>]| -> f64 {
            let lagrangian = |&c: &f64| {
                let (q, slope) = interpolate(control_points, nodes, c);
                let v = slope / h;
                0.5 * v.dot(&system.mass.momentum(&v)) - system.potential.value(&q)
            };
            rules().map(|(c, b)| h * b * lagrangian(c)).sum()
        };
        let stages: std::vec::Vec<_> =
            rules().map(|(&c, _)| interpolate(control_points, &nodes, c).0 - START.position).collect();
        let stages: [SVector<f64, 2>; Q] = stages.try_into().unwrap();
        for nu in 0..=S {
            let mut unit = std::vec![SVector::zeros(); S + 1];
            unit[nu] = vector![1.0, 1.0];
            let mut work = SVector::<f64, 2>::zeros();
            for (i, (&c, &b)) in rules().enumerate() {
                let shape = interpolate(control_points, &unit, c).0[0];
                let instant = Instant::in_step(START.time, c, h);
                let mut force = system.force.value(instant, &(START.position + stages[i])) + START.input;
                if let Some(damping) = damping {
                    force -= damping.at(i, &stages);
                }
                work += force * (h * b * shape);
            }
            for coordinate in 0..2 {
                let moved = |by: f64| {
                    let mut nodes = nodes.clone();
                    nodes[nu][coordinate] += by;
                    action(&nodes)
                };
                let epsilon = 1e-3;
                // Fourth-order difference.
                let derivative = (8.0 * (moved(epsilon) - moved(-epsilon))
                    - (moved(2.0 * epsilon) - moved(-2.0 * epsilon)))
                    / (12.0 * epsilon);
                let momentum = match nu {
                    0 => -START.momentum[coordinate],
                    nu if nu == S => (START.momentum - solution.impulse)[coordinate],
                    _ => 0.0,
                };
                let error = derivative + work[coordinate] - momentum;
                assert!(error.abs() < 1e-10, "degree {S}, {Q} points, node {nu}: {error:e}");
            }
        }
    }

    #[test]
    fn a_step_makes_the_discrete_action_stationary() {
        assert_stationary::<1, 1>(&Quadrature::gauss().unwrap(), &[0.0, 1.0], None);
        assert_stationary::<1, 2>(&Quadrature::lobatto().unwrap(), &[0.0, 1.0], None);
        assert_stationary::<2, 2>(&Quadrature::gauss().unwrap(), &[0.0, 0.5, 1.0], None);
        assert_stationary::<2, 3>(&Quadrature::lobatto().unwrap(), &[0.0, 0.5, 1.0], None);
        let root = 0.2f64.sqrt();
        let third = [0.0, 0.5 - 0.5 * root, 0.5 + 0.5 * root, 1.0];
        assert_stationary::<3, 3>(&Quadrature::gauss().unwrap(), &third, None);
        assert_stationary::<3, 4>(&Quadrature::lobatto().unwrap(), &third, None);
        assert_stationary::<3, 6>(&Quadrature::gauss().unwrap(), &third, None);
    }

    #[test]
    fn padding_a_quadrature_does_not_change_a_bit() {
        let gauss = Quadrature::<2>::gauss().unwrap();
        let plain = Galerkin::<f64, 2, 2>::new(&gauss).unwrap();
        let padded = Galerkin::<f64, 2, 6>::new(&gauss.padded().unwrap()).unwrap();
        let system = system();
        let (a, b) =
            (plain.solve(&system, &START, None).unwrap(), padded.solve(&system, &START, None).unwrap());
        assert_eq!((a.increments, a.impulse), (b.increments, b.impulse));
        // Padding does not make a rule stronger.
        assert_eq!(Galerkin::<f64, 3, 6>::new(&gauss.padded().unwrap()).unwrap_err().value, 2.0);
        assert!(gauss.padded::<1>().is_err());
    }

    #[test]
    fn forces_at_the_stages_do_their_virtual_work() {
        let mut damping = AffineForce::<f64, 2, 3>::zero();
        for i in 0..3 {
            damping.known[i] = vector![0.3, -0.4 * i as f64];
            for j in 0..3 {
                damping.leading[i][j] = matrix![1.0, 0.2; 0.2, 0.5] * (1.0 + i as f64 - 0.7 * j as f64);
            }
        }
        let radau = RungeKutta::<3>::radau_iia().unwrap();
        assert_stationary::<2, 3>(radau.quadrature(), &[0.0, 0.5, 1.0], Some(&damping));
        let lobatto = RungeKutta::<3>::lobatto_iiic().unwrap();
        assert_stationary::<2, 3>(lobatto.quadrature(), &[0.0, 0.5, 1.0], Some(&damping));
    }

    #[test]
    fn too_few_points_and_other_degrees_are_refused() {
        let error = Galerkin::<f64, 3, 2>::new(&Quadrature::gauss().unwrap()).unwrap_err();
        assert_eq!((error.parameter, error.value), ("number of quadrature points", 2.0));
        let error = Galerkin::<f64, 7, 7>::new(&Quadrature::lobatto().unwrap()).unwrap_err();
        assert_eq!((error.parameter, error.value), ("degree of the polynomials", 7.0));
        assert!(Galerkin::<f32, 0, 1>::new(&Quadrature::gauss().unwrap()).is_err());
        assert!(Galerkin::<f32, 6, 6>::new(&Quadrature::gauss().unwrap()).is_ok());
    }
}
