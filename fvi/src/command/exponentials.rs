//! `fvi exponentials`: convolution-quadrature weights as a head and decaying exponentials.

use super::CommandError;
use super::kernel_choice::KernelChoice;
use super::listing::{
    ListingFormat, ListingPrecision, check_exponentials, emit, exponentials_listing, identifier, mention_end,
    parameter_error,
};
use super::terminal::mention;
use fvi_core::BdfOrder;
use fvi_fft::exponentials::band_table::band_table;
use fvi_fft::exponentials::complex_exponential_table::complex_exponentials;
use fvi_fft::exponentials::exponential_table::{ENDLESS, ExponentialKernel, ExponentialKernelError};
use fvi_fft::exponentials::paired_source::PairedSource;
use fvi_fft::exponentials::rust_constants::end_of;
use fvi_fft::transfer::TransferFunction;
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
    /// As few exponentials as the frequencies from LOW to HIGH need, in Hz for a step in seconds: there the
    /// response is within the tolerance, 1e-7 to 0.1, of that of the weights. Derivatives need fewer with
    /// --increments
    #[arg(long, num_args = 2, value_names = ["LOW", "HIGH"], conflicts_with = "horizon")]
    band: Option<Vec<f64>>,
    /// Relative tolerance of every weight, 4e-15 to 0.1; with a band, that of the response
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
        let (on_increments, step, tolerance) = (self.increments, self.step, self.tolerance);
        let poles = transfer.fractions().map_or_else(Vec::new, |fractions| fractions.poles);
        if poles.iter().any(|pole| pole.place.im != 0.0) {
            return self.in_pairs(&transfer, order, horizon);
        }
        let made = match self.band.as_deref() {
            Some(&[low, high]) => band_table(&transfer, order, on_increments, step, [low, high], tolerance)
                .map(|(kernel, errors)| (kernel, Some(errors))),
            _ => ExponentialKernel::of_transfer(&transfer, order, on_increments, step, horizon, tolerance)
                .map(|kernel| (kernel, None)),
        };
        // What has no cut from s = 0 on, as double poles, delays and lead-lags of a fractional power.
        let missed = matches!(made, Err(ExponentialKernelError::ToleranceMissed { .. }));
        if missed && !transfer.is_relaxation() {
            return self.in_pairs(&transfer, order, horizon);
        }
        let (kernel, errors) = made.map_err(table_error)?;
        let on = if self.increments { " on increments" } else { "" };
        let worth = errors.map_or_else(String::new, |errors| format!("; {errors}"));
        let origin =
            format!("BDF {}, {}{on}, step {}{worth}", self.order, self.kernel.origin(&transfer), self.step);
        let precision = self.format.precision(self.precision);
        check_exponentials(&kernel, self.step, precision)?;
        let name = self.name.as_deref();
        let listing = exponentials_listing(&kernel, (&origin, name), self.format, precision);
        emit(|out| out.write_all(listing.as_bytes()), self.out.as_deref())?;
        if let Some(errors) = errors {
            mention(&format!("note: {} exponentials, {errors}\n", kernel.exponentials().len()));
        }
        mention_end(end_of(&kernel, self.step).as_deref());
        Ok(())
    }

    /// The listing of a kernel that has exponentials in pairs, as a filter.
    fn in_pairs(
        &self,
        transfer: &TransferFunction,
        order: BdfOrder,
        horizon: usize,
    ) -> Result<(), CommandError> {
        if self.band.is_some() {
            let what = "--band shortens tables of real exponentials, and those of this kernel come in pairs (of complex or multiple \
                        poles, or for delays): leave it out";
            return Err(CommandError::Unsuited(what.to_owned()));
        }
        let (step, tolerance) = (self.step, self.tolerance);
        let made = complex_exponentials(transfer, order, self.increments, step, horizon, tolerance);
        let (table, miss) = made.map_err(table_error)?;
        let on = if self.increments { " on increments" } else { "" };
        let origin = format!(
            "BDF {}, {}{on}, step {step}, weights within {:.1e} of the largest",
            self.order,
            self.kernel.origin(transfer),
            miss.largest
        );
        if table.pairs.is_empty() {
            let what = format!("the weights end after {}: `fvi weights` lists them", table.head.len());
            return Err(CommandError::Unsuited(what));
        }
        let name = self.name.as_deref().unwrap_or(match self.format {
            ListingFormat::C => "fvi",
            _ => "filter",
        });
        let in_single = self.format.precision(self.precision) == ListingPrecision::F32;
        let source = PairedSource { table: &table, origin: &origin, name, in_single };
        let listing = match self.format {
            ListingFormat::Csv => source.csv(),
            ListingFormat::Rust => source.rust(),
            ListingFormat::C => source.c(),
        };
        emit(|out| out.write_all(listing.as_bytes()), self.out.as_deref())
    }
}

fn table_error(error: ExponentialKernelError) -> CommandError {
    match error {
        ExponentialKernelError::Parameter(error) => parameter_error(error),
        missed => CommandError::Failed(missed.to_string()),
    }
}
