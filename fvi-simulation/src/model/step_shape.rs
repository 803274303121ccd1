//! The shape of a step: its coefficients, for whatever repeats it.

use super::AnyScheme;
use fvi_core::DiscreteLagrangian;

/// How the unknowns e^μ of a step of length h, increments of control points or the accelerations a_μ of
/// collocation, enter its equations
///
/// ```text
/// 0 = p_k (ν = 0, increments only) + Σ_μ inertia(ν, μ) M e^μ + Σ_i part(i, ν) G_i ,
/// X_i = q_k + c_i h v_k (collocation only) + Σ_μ displacement(i, μ) e^μ ,
/// V_i = v_k (collocation only) + Σ_μ slope(i, μ) e^μ ,
/// ```
///
/// with the forces G_i at the quadrature points X_i and the velocities V_i there.
#[derive(Clone, Copy)]
pub(crate) struct StepShape<'a> {
    view: DiscreteLagrangian<'a, f64>,
    /// A and A² of collocation.
    collocation: Option<[&'a [f64]; 2]>,
    length: f64,
}

impl<'a> StepShape<'a> {
    /// The shape of a scheme's step of this length.
    pub(crate) fn new(scheme: &'a AnyScheme<f64>, length: f64) -> Self {
        let collocation = scheme.matrix().zip(scheme.square()).map(|(matrix, square)| [matrix, square]);
        Self { view: scheme.view(), collocation, length }
    }

    /// Number of unknowns of a coordinate.
    pub(crate) fn degree(&self) -> usize {
        self.view.control_points.len()
    }

    /// Number of quadrature points.
    pub(crate) fn points(&self) -> usize {
        self.view.nodes.len()
    }

    /// True if the unknowns are accelerations.
    pub(crate) fn is_collocation(&self) -> bool {
        self.collocation.is_some()
    }

    /// c_i.
    pub(crate) fn nodes(&self) -> &'a [f64] {
        self.view.nodes
    }

    /// b_i.
    pub(crate) fn weights(&self) -> &'a [f64] {
        self.view.weights
    }

    /// ∂X_i/∂e^μ: the value of a shape function, or h² (A²)_iμ.
    pub(crate) fn displacement(&self, i: usize, mu: usize) -> f64 {
        match self.collocation {
            Some([_, square]) => self.length * self.length * square[i * self.degree() + mu],
            None => self.view.shapes[i * self.degree() + mu],
        }
    }

    /// ∂V_i/∂e^μ: the slope of a shape function divided by h, or h A_iμ.
    pub(crate) fn slope(&self, i: usize, mu: usize) -> f64 {
        match self.collocation {
            Some([matrix, _]) => self.length * matrix[i * self.degree() + mu],
            None => self.view.slope(i, mu) / self.length,
        }
    }

    /// The factor of M e^μ in equation ν: K_νμ/h, or 1 on the diagonal.
    pub(crate) fn inertia(&self, nu: usize, mu: usize) -> f64 {
        match self.collocation {
            Some(_) => f64::from(u8::from(nu == mu)),
            None => self.view.kinetic[nu * self.degree() + mu] / self.length,
        }
    }

    /// The factor of G_i in equation ν: −h b_i ℓ_ν(c_i), or 1 on the diagonal.
    pub(crate) fn part(&self, i: usize, nu: usize) -> f64 {
        match self.collocation {
            Some(_) => f64::from(u8::from(i == nu)),
            None => -self.length * self.view.weights[i] * self.view.tests[i * self.degree() + nu],
        }
    }
}
