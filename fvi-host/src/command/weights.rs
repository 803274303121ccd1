//! `fvi weights`: convolution-quadrature weights as a table or as constants.

use super::CommandError;
use super::listing::{ListingFormat, emit, parameter_error, write_weights};
use fvi_core::{BdfOrder, ConvolutionWeights, ParameterError};
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

/// Families of weights.
#[derive(Clone, Copy, Debug, Default, clap::ValueEnum)]
enum Family {
    /// Backward differentiation formulas
    #[default]
    Bdf,
}

/// Weights that are looked at before the first is written.
const CHECKED: usize = 1 << 16;

impl WeightsArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let Family::Bdf = self.family;
        let order = BdfOrder::new(self.order).map_err(parameter_error)?;
        let weights = || ConvolutionWeights::bdf(order, self.exponent, self.step).map_err(parameter_error);
        let first: Vec<f64> = weights()?.take(self.count.min(CHECKED)).collect();
        // Behind them the weights fall off like n^(−1−exponent).
        let factor = libm::pow((self.count as f64 / CHECKED as f64).max(1.0), -1.0 - self.exponent);
        let last = first.last().map(|weight| weight * factor);
        if !first.iter().copied().chain(last).all(|weight| weight == 0.0 || weight.is_normal()) {
            let allowed = "a step whose weights, h^−exponent in size, double precision holds";
            return Err(parameter_error(ParameterError { parameter: "step", value: self.step, allowed }));
        }
        let weights = weights()?;
        let origin = format!("BDF {}, exponent {}, step {}", self.order, self.exponent, self.step);
        emit(|out| write_weights(out, weights, self.count, &origin, self.format), self.out.as_deref())
    }
}
