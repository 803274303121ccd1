//! `fvi rates`: the table of a memory for steps of any length.

use super::CommandError;
use super::kernel_choice::KernelChoice;
use super::listing::{ListingPrecision, emit, identifier, parameter_error, rates_csv, rates_rust};
use fvi_core::{ParameterError, RateTable, Real, RungeKutta};
use fvi_fft::exponentials::rate_table::{RateTableError, rate_table_of};
use fvi_fft::quadrature::StagedMethod;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::with_staged_method;
use std::fmt::LowerExp;
use std::path::PathBuf;

/// Arguments of `fvi rates`.
#[derive(Debug, clap::Args)]
pub(crate) struct RatesArguments {
    /// Family of the Runge–Kutta method
    #[arg(long, value_enum, default_value_t)]
    family: Family,
    /// Stages of the method: 1 to 3 (radau-iia), 2 to 4 (lobatto-iiic)
    #[arg(long)]
    stages: usize,
    #[command(flatten)]
    kernel: KernelChoice,
    /// The shortest step that will be made
    #[arg(long)]
    shortest: f64,
    /// The last time, in the same unit
    #[arg(long)]
    horizon: f64,
    /// Relative tolerance of the past, 1e-14 to 0.1
    #[arg(long, default_value_t = 1e-12)]
    tolerance: f64,
    /// A table, or a constant for firmware
    #[arg(long, value_enum, default_value_t)]
    format: Format,
    /// Precision of the constant
    #[arg(long, value_enum, default_value_t)]
    precision: ListingPrecision,
    /// Name of the constant, such as half_derivative [default: TABLE]
    #[arg(long, value_parser = identifier)]
    name: Option<String>,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Families of methods, by their names in scenarios.
#[derive(Clone, Copy, Debug, Default, clap::ValueEnum)]
enum Family {
    /// Radau IIA methods
    #[default]
    RadauIia,
    /// Lobatto IIIC methods
    LobattoIiic,
}

/// How the table is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// Comma-separated columns under a header, 17 significant digits
    #[default]
    Csv,
    /// A constant of Rust
    Rust,
}

impl RatesArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let staged = match self.family {
            Family::RadauIia => StagedMethod::RadauIia(self.stages),
            Family::LobattoIiic => StagedMethod::LobattoIiic(self.stages),
        };
        let transfer = self.kernel.transfer()?;
        with_staged_method!(staged, method => self.list(staged.family(), &method, &transfer))
            .map_err(parameter_error)?
    }

    fn list<const R: usize>(
        &self,
        name: &str,
        method: &RungeKutta<R>,
        transfer: &TransferFunction,
    ) -> Result<(), CommandError> {
        // A CSV table is always in double precision.
        let listing = match (self.format, self.precision) {
            (Format::Rust, ListingPrecision::F32) => self.listed::<f32, R>(name, method, transfer, "f32")?,
            _ => self.listed::<f64, R>(name, method, transfer, "f64")?,
        };
        emit(|out| out.write_all(listing.as_bytes()), self.out.as_deref())
    }

    fn listed<T: Real + LowerExp, const R: usize>(
        &self,
        name: &str,
        method: &RungeKutta<R>,
        transfer: &TransferFunction,
        scalar: &str,
    ) -> Result<String, CommandError> {
        let Self { shortest, horizon, tolerance, .. } = *self;
        let table = rate_table_of::<T, R>(method, transfer, shortest, horizon, tolerance).map_err(
            |error| match error {
                RateTableError::Parameter(error) => parameter_error(error),
                error => CommandError::Unsuited(error.to_string()),
            },
        )?;
        let table: RateTable<&[T]> = table.borrow();
        let held =
            |number: &T| number.is_finite() && (*number == T::zero() || number.abs() >= T::SMALLEST_NORMAL);
        // The fastest rates and their coefficients depend on the shortest step, the slowest ones on the
        // horizon.
        if !table.rates.iter().chain(table.coefficients).all(held) {
            let allowed = "a step and a horizon whose rates and coefficients the precision holds";
            return Err(parameter_error(ParameterError { parameter: "shortest", value: shortest, allowed }));
        }
        let stages = if R == 1 { "stage" } else { "stages" };
        let origin = format!("{name}, {R} {stages}, {}", self.kernel.origin(transfer));
        Ok(match self.format {
            Format::Csv => rates_csv(&table, &origin, tolerance),
            Format::Rust => rates_rust(&table, (&origin, self.name.as_deref()), tolerance, scalar),
        })
    }
}
