//! The system of a scenario in the types of the core.

use crate::expression::{Elementary, Expression, Moment};
use crate::scenario::{Scenario, SymmetricMatrix};
use fvi_core::{Approach, Coefficients, Force, Instant, Mass, MatrixError, Potential, System};
use nalgebra::{SMatrix, SVector};

/// U(q) of an expression; none at all is zero.
#[derive(Clone, Debug)]
pub struct ExpressionPotential(Option<Expression>);

/// F(t, q) of one expression for each coordinate; none at all is zero.
#[derive(Clone, Debug)]
pub struct ExpressionForce {
    components: Vec<Expression>,
    depends_on_position: bool,
}

/// The system of a scenario with N coordinates.
pub type ScenarioSystem<T, const N: usize> = System<T, N, ExpressionPotential, ExpressionForce>;

/// Builds the system; `N` must be the scenario's number of coordinates.
///
/// # Errors
/// If the mass is not positive definite in the precision of `T`.
pub fn system<T: Elementary, const N: usize>(
    scenario: &Scenario,
) -> Result<ScenarioSystem<T, N>, MatrixError> {
    let components = scenario.system.force.clone().unwrap_or_default();
    let depends_on_position = components.iter().any(Expression::has_variables);
    Ok(System {
        mass: Mass::new(coefficients(&scenario.system.mass))?,
        potential: ExpressionPotential(scenario.system.potential.clone()),
        force: ExpressionForce { components, depends_on_position },
    })
}

/// A symmetric matrix of a scenario in the core's type.
pub fn coefficients<T: Elementary, const N: usize>(matrix: &SymmetricMatrix) -> Coefficients<T, N> {
    match matrix {
        SymmetricMatrix::Diagonal(entries) => Coefficients::Diagonal(vector(entries)),
        SymmetricMatrix::Dense(entries) => {
            Coefficients::Dense(SMatrix::from_fn(|row, column| T::of(entries[(row, column)])))
        }
    }
}

/// Numbers of a scenario as a vector; missing ones are zero.
pub fn vector<T: Elementary, const N: usize>(numbers: &[f64]) -> SVector<T, N> {
    SVector::from_fn(|index, _| numbers.get(index).map_or(T::zero(), |&number| T::of(number)))
}

impl<T: Elementary, const N: usize> Potential<T, N> for ExpressionPotential {
    fn value(&self, position: &SVector<T, N>) -> T {
        match &self.0 {
            Some(expression) => expression.value(Moment::inside(T::zero()), position.as_slice()),
            None => T::zero(),
        }
    }

    fn gradient(&self, position: &SVector<T, N>) -> SVector<T, N> {
        match &self.0 {
            Some(expression) => expression.gradient(Moment::inside(T::zero()), position).1,
            None => SVector::zeros(),
        }
    }

    fn hessian(&self, position: &SVector<T, N>) -> SMatrix<T, N, N> {
        match &self.0 {
            Some(expression) => expression.hessian(Moment::inside(T::zero()), position).2,
            None => SMatrix::zeros(),
        }
    }
}

impl<T: Elementary, const N: usize> Force<T, N> for ExpressionForce {
    fn value(&self, instant: Instant<T>, position: &SVector<T, N>) -> SVector<T, N> {
        let moment = moment(instant);
        let mut force = SVector::<T, N>::zeros();
        for (entry, component) in force.iter_mut().zip(&self.components) {
            *entry = component.value(moment, position.as_slice());
        }
        force
    }

    fn jacobian(&self, instant: Instant<T>, position: &SVector<T, N>) -> SMatrix<T, N, N> {
        let mut jacobian = SMatrix::<T, N, N>::zeros();
        if self.depends_on_position {
            let moment = moment(instant);
            for (mut row, component) in jacobian.row_iter_mut().zip(&self.components) {
                row.copy_from(&component.gradient(moment, position).1.transpose());
            }
        }
        jacobian
    }
}

fn moment<T: Elementary>(instant: Instant<T>) -> Moment<T> {
    match instant.approach {
        Approach::Inside => Moment::inside(instant.time),
        Approach::FromLeft => Moment::from_left(instant.time),
        Approach::FromRight => Moment::from_right(instant.time),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Document;
    use nalgebra::{matrix, vector};
    use std::path::Path;

    #[test]
    fn the_derivatives_of_potential_and_force_land_in_their_places() {
        let text = r#"
            [system]
            mass = [[2.0, 0.5], [0.5, 1.0]]
            potential = "q0^2*q1"
            force = ["t*q1^2", "3*q0 + step(t - 1)"]
            [initial]
            position = [0.0, 0.0]
            momentum = [0.0, 0.0]
            [time]
            step = 0.5
            steps = 1
        "#;
        let scenario = Scenario::from_document(Document::new("test.toml", Path::new(""), text)).unwrap();
        let system = system::<f64, 2>(&scenario).unwrap();
        let q = vector![2.0, 3.0];
        assert_eq!(system.potential.value(&q), 12.0);
        assert_eq!(system.potential.gradient(&q), vector![12.0, 4.0]);
        assert_eq!(system.potential.hessian(&q), matrix![6.0, 4.0; 4.0, 0.0]);
        let at = |approach| Instant { time: 1.0, approach };
        assert_eq!(system.force.value(at(Approach::FromLeft), &q), vector![9.0, 6.0]);
        assert_eq!(system.force.value(at(Approach::FromRight), &q), vector![9.0, 7.0]);
        assert_eq!(system.force.jacobian(at(Approach::Inside), &q), matrix![0.0, 6.0; 3.0, 0.0]);
        assert_eq!(system.mass.momentum(&q), vector![5.5, 4.0]);
    }
}
