//! `fvi weights`: convolution-quadrature weights as a table or as constants.

use super::CommandError;
use super::listing::{ListingFormat, emit, matrix_weights_listing, parameter_error, weights_listing};
use crate::runge_kutta_weights::RungeKuttaWeights;
use fvi_core::{BdfOrder, ConvolutionWeights, ParameterError, RungeKutta};
use std::path::PathBuf;

/// Arguments of `fvi weights`.
#[derive(Debug, clap::Args)]
pub struct WeightsArguments {
    /// Family of the underlying multistep method
    #[arg(long, value_enum, default_value_t)]
    family: Family,
    /// Order p of the backward differentiation formula, 1 to 6
    #[arg(long, default_value_t = 1)]
    order: usize,
    /// Stages of the Runge–Kutta method: 1 to 3 (radau-iia), 2 to 4 (lobatto-iiic); the weights are matrices then
    #[arg(long)]
    stages: Option<usize>,
    /// Exponent of the operator in (−1, 2): positive for derivatives (the damping order), negative for integrals
    #[arg(long, allow_negative_numbers = true)]
    exponent: f64,
    /// Step size h
    #[arg(long, default_value_t = 1.0)]
    step: f64,
    /// How many weights
    #[arg(long, default_value_t = 64)]
    count: usize,
    /// A table, or constants for firmware
    #[arg(long, value_enum, default_value_t)]
    format: ListingFormat,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Families of weights, by their names in scenarios.
#[derive(Clone, Copy, Debug, Default, clap::ValueEnum)]
enum Family {
    /// Backward differentiation formulas
    #[default]
    Bdf,
    /// Radau IIA methods
    RadauIia,
    /// Lobatto IIIC methods
    LobattoIiic,
}

impl WeightsArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let text = match (self.family, self.stages) {
            (Family::Bdf, None) => self.bdf()?,
            (Family::RadauIia, Some(1)) => self.matrices(RungeKutta::<1>::radau_iia())?,
            (Family::RadauIia, Some(2)) => self.matrices(RungeKutta::<2>::radau_iia())?,
            (Family::RadauIia, Some(3)) => self.matrices(RungeKutta::<3>::radau_iia())?,
            (Family::LobattoIiic, Some(2)) => self.matrices(RungeKutta::<2>::lobatto_iiic())?,
            (Family::LobattoIiic, Some(3)) => self.matrices(RungeKutta::<3>::lobatto_iiic())?,
            (Family::LobattoIiic, Some(4)) => self.matrices(RungeKutta::<4>::lobatto_iiic())?,
            (family, stages) => {
                let allowed = match family {
                    Family::Bdf => "none with the family bdf",
                    Family::RadauIia => "1, 2 or 3 with the family radau-iia",
                    Family::LobattoIiic => "2, 3 or 4 with the family lobatto-iiic",
                };
                let value = stages.map_or(f64::NAN, |stages| stages as f64);
                return Err(parameter_error(ParameterError { parameter: "stages", value, allowed }));
            }
        };
        emit(&text, self.out.as_deref())
    }

    fn bdf(&self) -> Result<String, CommandError> {
        let weights = BdfOrder::new(self.order)
            .and_then(|order| ConvolutionWeights::bdf(order, self.exponent, self.step))
            .map_err(parameter_error)?;
        let weights: Vec<f64> = weights.take(self.count).collect();
        let origin = format!("BDF {}, exponent {}, step {}", self.order, self.exponent, self.step);
        Ok(weights_listing(&weights, &origin, self.format))
    }

    fn matrices<const R: usize>(
        &self,
        method: Result<RungeKutta<R>, ParameterError>,
    ) -> Result<String, CommandError> {
        let weights = method
            .and_then(|method| RungeKuttaWeights::new(&method, self.exponent, self.step, self.count))
            .map_err(parameter_error)?;
        let name = match self.family {
            Family::LobattoIiic => "Lobatto IIIC",
            _ => "Radau IIA",
        };
        let origin = format!("{name}, {R} stages, exponent {}, step {}", self.exponent, self.step);
        Ok(matrix_weights_listing(&weights.planes(), R, &origin, self.format))
    }
}
