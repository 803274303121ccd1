//! `kinetic`: the kinetic part of a Lagrangian, quadratic in the velocities.

use super::matrix::SymmetricMatrix;
use crate::language::document::Value;
use crate::language::error::{InputError, Problem};
use crate::language::expression::{Expression, Moment};
use fvi_core::max_or_nan;
use nalgebra::DMatrix;

/// Largest part of T(q, v), relative to its size, that is not that of a quadratic polynomial in v.
const NOT_QUADRATIC: f64 = 1e-9;

/// T(q, v) = ½ vᵀ M(q) v + a(q)ᵀ v + c(q) at one position.
#[derive(Clone, Debug)]
pub(super) struct Kinetic {
    /// M(q), symmetric.
    pub(super) mass: DMatrix<f64>,
    /// a(q).
    pub(super) linear: Vec<f64>,
}

impl Kinetic {
    /// M and a at a position, from values of T: those of a quadratic polynomial determine it.
    ///
    /// # Errors
    /// If T is not finite there, or not quadratic in the velocities.
    pub(super) fn at(
        expression: &Expression,
        position: &[f64],
        value: &Value<'_>,
    ) -> Result<Self, InputError> {
        let count = position.len();
        let at = |position: &[f64], velocity: &[f64]| {
            let point: Vec<f64> = position.iter().chain(velocity).copied().collect();
            expression.value(Moment::inside(0.0), &point)
        };
        let of_units = |units: &[(usize, f64)]| {
            let mut velocity = vec![0.0; count];
            units.iter().for_each(|&(index, size)| velocity[index] += size);
            at(position, &velocity)
        };
        let still = of_units(&[]);
        let forth: Vec<f64> = (0..count).map(|i| of_units(&[(i, 1.0)])).collect();
        let back: Vec<f64> = (0..count).map(|i| of_units(&[(i, -1.0)])).collect();
        let mass = DMatrix::from_fn(count, count, |i, j| match i == j {
            true => forth[i] + back[i] - 2.0 * still,
            false => (of_units(&[(i, 1.0), (j, 1.0)]) - forth[i]) - (forth[j] - still),
        });
        let linear: Vec<f64> = forth.iter().zip(&back).map(|(forth, back)| 0.5 * (forth - back)).collect();
        let all = mass.iter().chain(&linear).chain([&still]);
        let largest = all.fold(0.0, |most, number| max_or_nan(most, number.abs()));
        if !largest.is_finite() {
            let place = format!("q = {position:?}");
            return Err(value.error(Problem::NotFinite { what: "the kinetic energy", place }));
        }
        let made = Self { mass, linear };
        let speed =
            |scale: f64| (0..count).map(|i| scale * (1.37 - 0.61 * (i % 5) as f64)).collect::<Vec<_>>();
        for scale in [1.0, -2.0, 5.0] {
            let velocity = speed(scale);
            let polynomial = made.energy(&velocity) + still;
            let size = max_or_nan(polynomial.abs(), largest * scale * scale);
            let error = (at(position, &velocity) - polynomial).abs();
            if error > NOT_QUADRATIC * size || error.is_nan() {
                return Err(value.out_of_range("a polynomial of degree 2 in the velocities v0, v1, …"));
            }
        }
        Ok(made)
    }

    /// ½ vᵀ M v + aᵀ v.
    fn energy(&self, velocity: &[f64]) -> f64 {
        let momentum = self.momentum(velocity);
        let parts = momentum.iter().zip(&self.linear).zip(velocity);
        parts.map(|((p, a), v)| 0.5 * (p + a) * v).sum()
    }

    /// M v + a.
    pub(super) fn momentum(&self, velocity: &[f64]) -> Vec<f64> {
        SymmetricMatrix::Dense(self.mass.clone())
            .times(velocity)
            .iter()
            .zip(&self.linear)
            .map(|(p, a)| p + a)
            .collect()
    }
}
