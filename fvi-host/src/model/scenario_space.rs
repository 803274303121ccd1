//! What a space needs for scenarios to run in it.

use super::mechanics::{Model, matrix, vector};
use super::scheme::{AnyScheme, DenseOutput};
use super::space::{Dense, Matrix};
use crate::language::expression::Elementary;
use crate::scenario::{Scenario, SymmetricMatrix};
use fvi_core::{MatrixError, Mechanics, ParameterError, Space};

/// A space in which scenarios run: how what they say becomes its vectors, matrices, system and scheme.
///
/// The simulation is written over this; another way to store coordinates joins by implementing it.
pub trait ScenarioSpace<T: Elementary>: Space<T> {
    /// M, U and F.
    type System: Mechanics<T, Self>;
    /// The scheme.
    type Scheme: DenseOutput<T, Self>;

    /// The system of a scenario.
    ///
    /// # Errors
    /// If the mass is not positive definite in the precision of `T`.
    fn system(&self, scenario: &Scenario) -> Result<Self::System, MatrixError>;

    /// The scheme of a scenario.
    ///
    /// # Errors
    /// If degree, points and stages do not go together.
    fn scheme(&self, scenario: &Scenario) -> Result<Self::Scheme, ParameterError>;

    /// The vector of these numbers, one for each coordinate.
    fn vector(&self, numbers: &[f64]) -> Self::Vector;

    /// A symmetric matrix of the scenario.
    fn block(&self, matrix: &SymmetricMatrix) -> Self::Block;
}

impl<T: Elementary> ScenarioSpace<T> for Dense {
    type System = Model<T>;
    type Scheme = AnyScheme<T>;

    fn system(&self, scenario: &Scenario) -> Result<Model<T>, MatrixError> {
        Model::new(scenario)
    }

    fn scheme(&self, scenario: &Scenario) -> Result<AnyScheme<T>, ParameterError> {
        AnyScheme::new(scenario)
    }

    fn vector(&self, numbers: &[f64]) -> Vec<T> {
        vector(numbers)
    }

    fn block(&self, entries: &SymmetricMatrix) -> Matrix<T> {
        matrix(entries)
    }
}
