//! `fvi exponentials`: convolution-quadrature weights as a head and decaying exponentials.

use super::CommandError;
use super::kernel_choice::KernelChoice;
use super::listing::{
    ListingFormat, ListingPrecision, check_exponentials, emit, exponentials_listing, identifier, mention_end,
    parameter_error,
};
use fvi_core::BdfOrder;
use fvi_fft::exponentials::exponential_table::{ENDLESS, ExponentialKernel, ExponentialKernelError};
use fvi_fft::exponentials::rust_constants::end_of;
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
    /// Largest lag, in steps, at which the weights hold; a memory on the table ends there [default: none, the
    /// weights hold to the tolerance up to a lag of 2^50, and nothing is refused beyond]
    #[arg(long)]
    horizon: Option<f64>,
    /// No horizon: the default
    #[arg(long, conflicts_with = "horizon")]
    endless: bool,
    /// Relative tolerance of every weight, 4e-15 to 0.1
    #[arg(long, default_value_t = 1e-12)]
    tolerance: f64,
    /// A table, or constants for firmware
    #[arg(long, value_enum, default_value_t)]
    format: ListingFormat,
    /// Precision of the constants [default: f32 in C, as in fvi.h, else f64]
    #[arg(long, value_enum)]
    precision: Option<ListingPrecision>,
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
        let horizon = match self.horizon {
            None => ENDLESS,
            Some(horizon) if (1.0..=9e15).contains(&horizon) => horizon as usize,
            Some(value) => {
                let (parameter, allowed) = ("horizon", "at least 1 and at most 9e15");
                return Err(parameter_error(fvi_core::ParameterError { parameter, value, allowed }));
            }
        };
        let order = BdfOrder::new(self.order).map_err(parameter_error)?;
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
        let precision = self.format.precision(self.precision);
        check_exponentials(&kernel, self.step, precision)?;
        let name = self.name.as_deref();
        let listing = exponentials_listing(&kernel, (&origin, name), self.format, precision);
        emit(|out| out.write_all(listing.as_bytes()), self.out.as_deref())?;
        mention_end(end_of(&kernel, self.step).as_deref());
        Ok(())
    }
}
