//! Galerkin discrete Lagrangians: polynomial trajectories, quadrature of the action, and the step they give.

use nalgebra::SVector;

use crate::coefficients::Fixed;
use crate::damping::Damping;
use crate::discrete_lagrangian::DiscreteLagrangian;
use crate::error::ParameterError;
use crate::newton::{Factors, StepMatrix};
use crate::quadrature::{Quadrature, lobatto_half};
use crate::real::Real;
use crate::scheme::{Sampling, Scheme, State, Step, StepError};
use crate::space::{part_mut, vectors_mut};
use crate::system::Mechanics;
use crate::workspace::{CachedFactor, Workspace};

/// Discrete Lagrangian on polynomials of degree S with a quadrature of Q points.
///
/// ```text
/// L_d = h Σ_i b_i L(q_d(c_i h), q̇_d(c_i h)) ,     q_d(τh) = q_k + Σ_{ν=1}^{S} ℓ_ν(τ) e^ν ,
/// e^ν = q^ν − q_k
/// ```
///
/// through the control points 0 = d₀ < d₁ < … < d_S = 1. Degree 1 with one point at 1 − κ is the low-order
/// discrete Lagrangian (1/2h) Δqᵀ M Δq − h U(κ q_k + (1−κ) q_{k+1}), see [`low_order`](Galerkin::low_order).
///
/// As a [`Scheme`] it is the fractional variational integrator in (q, p) form, whose memory stores the main
/// nodes:
///
/// ```text
/// p_k = −D₁L_d − f₀ ,    0 = D_νL_d + f_ν (inner nodes) ,
/// p_{k+1} = D_{S+1}L_d + f_S − h Σ_m ρ_m (D^{β_m} q)_{k+1}
/// ```
///
/// with the virtual work f_ν = h Σ_i b_i ℓ_ν(c_i) F of the external force. Eliminating p gives \[JO\]
/// Algorithm 3 and \[HJO\] eq. 38a, 44a–b (Algorithm 1). The fractional force involves q_{k+1} only after the
/// first two lines have found it.
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
    /// ℓ_ν(c_i), ν = 0…S−1: the test functions of the S equations.
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

/// Output slices for the coefficients of a [`DiscreteLagrangian`] that follow from its quadrature.
#[derive(Debug)]
pub struct Tables<'a, T> {
    /// S numbers; their count is the degree.
    pub control_points: &'a mut [T],
    /// Q·S numbers.
    pub shapes: &'a mut [T],
    /// Q·S numbers.
    pub tests: &'a mut [T],
    /// S·S numbers.
    pub kinetic: &'a mut [T],
}

impl<T: Real> Tables<'_, T> {
    /// Fills the tables for polynomials through the Lobatto points of S + 1 nodes and a quadrature; see
    /// [`Galerkin::new`].
    ///
    /// # Errors
    /// If S is not one of 1…6, or there are fewer nodes than S.
    pub fn fill(self, nodes: &[f64], weights: &[f64]) -> Result<(), ParameterError> {
        let degree = self.control_points.len();
        let half = degree.checked_add(1).and_then(lobatto_half).ok_or(ParameterError {
            parameter: "degree of the polynomials",
            value: degree as f64,
            allowed: "one of 1, 2, 3, 4, 5, 6",
        })?;
        ParameterError::check(
            nodes.len() >= degree,
            "number of quadrature points",
            nodes.len() as f64,
            "at least the degree of the polynomials",
        )?;
        let mut points = [0.0; MAX_DEGREE + 1];
        let points = part_mut(&mut points, degree + 1);
        for (point, &(d, _)) in points.iter_mut().zip(half) {
            *point = d;
        }
        for (point, &(d, _)) in points.iter_mut().rev().zip(half) {
            *point = 1.0 - d;
        }
        let points = &*points;
        for (place, &point) in self.control_points.iter_mut().zip(points.iter().skip(1)) {
            *place = T::of(point);
        }
        let shapes = vectors_mut(self.shapes, degree);
        let tests = vectors_mut(self.tests, degree);
        for (&node, (shapes, tests)) in nodes.iter().zip(shapes.zip(tests)) {
            for (nu, (shape, test)) in shapes.iter_mut().zip(tests).enumerate() {
                *shape = T::of(lagrange(points, nu + 1, node).0);
                *test = T::of(lagrange(points, nu, node).0);
            }
        }
        for (nu, row) in self.kinetic.chunks_exact_mut(degree.max(1)).enumerate() {
            for (mu, entry) in row.iter_mut().enumerate() {
                let product = |node| lagrange(points, nu, node).1 * lagrange(points, mu + 1, node).1;
                let terms = nodes.iter().zip(weights);
                *entry = T::of(terms.map(|(&node, weight)| weight * product(node)).sum());
            }
        }
        Ok(())
    }
}

impl<T: Real, const S: usize, const Q: usize> Galerkin<T, S, Q> {
    /// Polynomials of degree S through the Lobatto points of S + 1 nodes, with the given quadrature.
    ///
    /// The conservative part has the order min(2S, u), u the order of the quadrature (\[HJO\] §2.3 with its
    /// references): 2Q for Gauss, 2Q − 2 for Lobatto. S = Q with Gauss points is the Gauss collocation
    /// method.
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
        let zero = T::zero();
        let mut galerkin = Self {
            weights: quadrature.weights.map(T::of),
            nodes: quadrature.nodes.map(T::of),
            control_points: [zero; S],
            shapes: [[zero; S]; Q],
            tests: [[zero; S]; Q],
            kinetic: [[zero; S]; S],
        };
        let tables = Tables {
            control_points: &mut galerkin.control_points,
            shapes: galerkin.shapes.as_flattened_mut(),
            tests: galerkin.tests.as_flattened_mut(),
            kinetic: galerkin.kinetic.as_flattened_mut(),
        };
        tables.fill(&quadrature.nodes, &quadrature.weights)?;
        Ok(galerkin)
    }

    /// Twice L_d on the nodes v, x_1, …, x_{S−1}, −v of a motion that changes its sign with every step, as
    /// (kinetic, potential) coefficients of (1/h) M and h K for the unknowns (v, x_1, …, x_{S−1}).
    ///
    /// The shape that belongs to v is ℓ₀ − ℓ_S, those of the other unknowns are their own.
    pub(crate) fn alternating_form(&self) -> [[(T, T); S]; S] {
        let mut form = [[(T::zero(), T::zero()); S]; S];
        for (nu, row) in form.iter_mut().enumerate() {
            for (mu, (kinetic, potential)) in row.iter_mut().enumerate() {
                *kinetic = self.slopes(nu, mu);
                if nu == 0 {
                    *kinetic -= self.slopes(S, mu);
                }
                if mu == 0 {
                    *kinetic -= self.slopes(nu, S);
                }
                if nu == 0 && mu == 0 {
                    *kinetic += self.slopes(S, S);
                }
                for ((&weight, tests), shapes) in self.weights.iter().zip(&self.tests).zip(&self.shapes) {
                    let value = |nu: usize| {
                        let own = tests.get(nu).copied().unwrap_or(T::zero());
                        let of_end = shapes.last().copied().unwrap_or(T::zero());
                        if nu == 0 { own - of_end } else { own }
                    };
                    *potential += weight * value(nu) * value(mu);
                }
            }
        }
        form
    }

    /// Σ_i b_i ℓ̇_ν(c_i) ℓ̇_μ(c_i) for ν and μ from 0 to S.
    ///
    /// The table contains the symmetric matrix without its first and its last entry; these follow from the
    /// others, since the slopes of all shapes add to zero.
    fn slopes(&self, nu: usize, mu: usize) -> T {
        let kept = |nu: usize, mu: usize| {
            let row = self.kinetic.get(nu);
            row.and_then(|row| row.get(mu.wrapping_sub(1))).copied().unwrap_or(T::zero())
        };
        match (nu.min(mu), nu.max(mu)) {
            (0, 0) => (1..=S).fold(T::zero(), |sum, mu| sum - kept(0, mu)),
            (low, _) if low == S => (0..S).fold(T::zero(), |sum, nu| sum - kept(nu, S)),
            (low, high) => kept(low, high),
        }
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
    /// κ = ½ is the midpoint rule (order 2 for the conservative part); κ = 0 and 1 are the two symplectic
    /// Euler methods.
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
        Ok(Self::of_degree_one(node, node, kappa))
    }

    /// Straight lines with one node and the given values of ℓ₁ and ℓ₀ at it.
    #[inline(always)]
    pub(crate) fn of_degree_one(node: T, shape: T, test: T) -> Self {
        Self {
            weights: [T::one()],
            nodes: [node],
            control_points: [T::one()],
            shapes: [[shape]],
            tests: [[test]],
            kinetic: [[-T::one()]],
        }
    }
}

impl<T, const S: usize, const Q: usize> Galerkin<T, S, Q> {
    /// The discrete Lagrangian without its shape in the type.
    #[inline(always)]
    pub fn view(&self) -> DiscreteLagrangian<'_, T> {
        DiscreteLagrangian {
            weights: &self.weights,
            nodes: &self.nodes,
            control_points: &self.control_points,
            shapes: self.shapes.as_flattened(),
            tests: self.tests.as_flattened(),
            kinetic: self.kinetic.as_flattened(),
        }
    }
}

/// Workspace of one step on the stack: calls `$step` with it, for R memory nodes and the given number of
/// scratch vectors.
macro_rules! in_place {
    ($degree:ident, $points:ident; $kept:expr, $behind:expr, $mechanics:expr, $known:expr, $scratch:expr, $step:expr) => {{
        let zero = T::zero();
        let (mut increments, mut residual) = ([[zero; N]; $degree], [[zero; N]; $degree]);
        let (mut stages, mut forces) = ([[zero; N]; $points], [[zero; N]; $points]);
        let mut known = $known;
        let mut moment_correction = [[zero; N]; crate::system::MAX_MOMENTS];
        let scratch = &mut $scratch;
        let mut point = $crate::linear::zero_vector();
        let mut stiffness = $mechanics.stiffness();
        let mut matrix = StepMatrix::<T, N, $degree>::zero();
        let mut workspace = Workspace::<T, Fixed<N>, StepMatrix<T, N, $degree>> {
            increments: increments.as_flattened_mut(),
            residual: residual.as_flattened_mut(),
            stages: stages.as_flattened_mut(),
            forces: forces.as_flattened_mut(),
            known: known.as_flattened_mut(),
            scratch: scratch.as_flattened_mut(),
            behind: $behind,
            restoring: &mut [],
            moment_correction: moment_correction.as_flattened_mut(),
            point: &mut point,
            stiffness: &mut stiffness,
            matrix: &mut matrix,
            kept: $kept,
        };
        $step(&mut workspace)
    }};
}
pub(crate) use in_place;

impl<T: Real, const N: usize, const S: usize, const Q: usize> Scheme<T, Fixed<N>> for Galerkin<T, S, Q> {
    type Storage = CachedFactor<Factors<T, N, S>, T>;

    fn storage<G: Mechanics<T, Fixed<N>>>(&self, _: &Fixed<N>, _: &G) -> Self::Storage {
        CachedFactor::nothing(Factors::zero())
    }

    fn sampling(&self) -> Sampling<'_, T> {
        Sampling::MainNodes
    }

    #[inline(always)]
    fn step<G: Mechanics<T, Fixed<N>>, D: Damping<T, Fixed<N>>>(
        &self,
        storage: &mut Self::Storage,
        mechanics: &mut G,
        damping: &mut D,
        step: &Step<'_, T>,
        state: &mut State<SVector<T, N>>,
    ) -> Result<u32, StepError> {
        let zeros = [[T::zero(); N]; 1];
        in_place!(S, Q; storage, &mut [], mechanics, zeros, [[T::zero(); N]; 1], |workspace| {
            self.view().step_damped_at_main_nodes(workspace, mechanics, damping, step, state)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_few_points_and_other_degrees_are_refused() {
        let error = Galerkin::<f64, 3, 2>::new(&Quadrature::gauss().unwrap()).unwrap_err();
        assert_eq!((error.parameter, error.value), ("number of quadrature points", 2.0));
        let error = Galerkin::<f64, 7, 7>::new(&Quadrature::lobatto().unwrap()).unwrap_err();
        assert_eq!((error.parameter, error.value), ("degree of the polynomials", 7.0));
        assert!(Galerkin::<f32, 0, 1>::new(&Quadrature::gauss().unwrap()).is_err());
        assert!(Galerkin::<f32, 6, 6>::new(&Quadrature::gauss().unwrap()).is_ok());
    }

    #[test]
    fn a_step_of_the_harmonic_oscillator_is_a_rotation_to_the_order_of_the_scheme() {
        use crate::system::{Mass, NoForce, Quadratic, System};
        let step_size = 0.25f64;
        let error = |scheme_order: i32, (q, p): (f64, f64)| {
            let bound = step_size.powi(scheme_order + 1) / 20.0;
            assert!((q - libm::cos(step_size)).abs() < bound, "order {scheme_order}: {q}");
            assert!((p + libm::sin(step_size)).abs() < bound, "order {scheme_order}: {p}");
        };
        let mass = Mass::diagonal([1.0]).unwrap();
        let system = System { mass, potential: Quadratic::diagonal([1.0]).unwrap(), force: NoForce };
        let midpoint = Galerkin::<f64, 1, 1>::low_order(0.5).unwrap();
        let quartic = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().unwrap()).unwrap();
        let mut coarse =
            crate::Integrator::builder(system, midpoint, step_size).position([1.0]).build().unwrap();
        let mut fine =
            crate::Integrator::builder(system, quartic, step_size).position([1.0]).build().unwrap();
        assert!(coarse.step(&[0.0].into()).unwrap() >= 1 && fine.step(&[0.0].into()).unwrap() >= 1);
        error(1, (coarse.state().position[0], coarse.state().momentum[0]));
        error(4, (fine.state().position[0], fine.state().momentum[0]));
    }

    #[test]
    fn lagrange_polynomials_have_their_values_and_slopes() {
        // ℓ₁ = 4 τ (1 − τ) on 0, ½, 1.
        assert_eq!(lagrange(&[0.0, 0.5, 1.0], 1, 0.25), (0.75, 2.0));
        assert_eq!(lagrange(&[0.0, 1.0], 0, 0.25), (0.75, -1.0));
    }

    #[test]
    fn kappa_lies_between_the_ends_of_a_step() {
        for outside in [-0.1, 1.1, f64::NAN] {
            let refused = Galerkin::<f64, 1, 1>::low_order(outside).map_err(|error| error.parameter);
            assert_eq!(refused, Err("kappa"), "{outside}");
        }
        assert!(
            Galerkin::<f64, 1, 1>::low_order(0.0).is_ok() && Galerkin::<f64, 1, 1>::low_order(1.0).is_ok()
        );
    }
}
