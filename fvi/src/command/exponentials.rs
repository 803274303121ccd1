//! `fvi exponentials`: convolution-quadrature weights as a head and decaying exponentials.

use super::CommandError;
use super::kernel_choice::KernelChoice;
use super::listing::{
    ListingFormat, ListingPrecision, check_exponentials, emit, exponentials_listing, identifier,
    parameter_error,
};
use fvi_core::BdfOrder;
use fvi_fft::exponentials::exponential_table::{ENDLESS, ExponentialKernel, ExponentialKernelError};
use std::path::PathBuf;

/// Arguments of `fvi exponentials`.
#[derive(Debug, clap::Args)]
pub(crate) struct ExponentialsArguments {
    /// Order p of the backward differentiation formula, 1 to 6
    #[arg(long, default_value_t = 1)]
    order: usize,
    #[command(flatten)]
    kernel: KernelChoice,
    /// Step size h
    #[arg(long, default_value_t = 1.0)]
    step: f64,
    /// Weights for memories on increments, which lose less to rounding; the exponent is positive then
    #[arg(long)]
    increments: bool,
    /// Largest lag, in steps, at which the weights hold
    #[arg(long, default_value_t = 1e8)]
    horizon: f64,
    /// No horizon: the weights hold to the tolerance up to a lag of 2^50, and nothing is refused beyond
    #[arg(long, conflicts_with = "horizon")]
    endless: bool,
    /// Relative tolerance of every weight, 4e-15 to 0.1
    #[arg(long, default_value_t = 1e-12)]
    tolerance: f64,
    /// A table, or constants for firmware
    #[arg(long, value_enum, default_value_t)]
    format: ListingFormat,
    /// Precision of the constants
    #[arg(long, value_enum, default_value_t)]
    precision: ListingPrecision,
    /// Name of the constants, such as half_derivative [default: TABLE in Rust, fvi in C]
    #[arg(long, value_parser = identifier)]
    name: Option<String>,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

impl ExponentialsArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        // The horizon is read as a float, so that 1e8 is accepted; up to 2⁵³ it holds every whole number of
        // steps.
        if !(self.horizon >= 1.0 && self.horizon <= 9e15) {
            let (parameter, allowed) = ("horizon", "at least 1 and at most 9e15");
            return Err(parameter_error(fvi_core::ParameterError {
                parameter,
                value: self.horizon,
                allowed,
            }));
        }
        let order = BdfOrder::new(self.order).map_err(parameter_error)?;
        let horizon = if self.endless { ENDLESS } else { self.horizon as usize };
        let transfer = self.kernel.transfer()?;
        let kernel = ExponentialKernel::of_transfer(
            &transfer,
            order,
            self.increments,
            self.step,
            horizon,
            self.tolerance,
        )
        .map_err(|error| match error {
            ExponentialKernelError::Parameter(error) => parameter_error(error),
            missed => CommandError::Failed(missed.to_string()),
        })?;
        let on = if self.increments { " on increments" } else { "" };
        let origin = format!("BDF {}, {}{on}, step {}", self.order, self.kernel.origin(&transfer), self.step);
        // A CSV table is always in double precision.
        let precision = match self.format {
            ListingFormat::Csv => ListingPrecision::F64,
            _ => self.precision,
        };
        check_exponentials(&kernel, self.step, precision)?;
        let name = self.name.as_deref();
        let listing = exponentials_listing(&kernel, (&origin, name), self.format, precision);
        emit(|out| out.write_all(listing.as_bytes()), self.out.as_deref())
    }
}
