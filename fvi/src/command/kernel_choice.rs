//! `--exponent`, `--kernel` or `--symbol`: the kernel of a listing.

use super::CommandError;
use super::listing::parameter_error;
use fvi_fft::transfer::TransferFunction;
use fvi_scenario::scenario::{kernel_of_file, kernel_of_symbol};
use std::path::PathBuf;

/// Options that select a kernel.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
pub(super) struct KernelChoice {
    /// Exponent of the operator in (−1, 2): positive for derivatives (the damping order), negative for
    /// integrals
    #[arg(long, allow_negative_numbers = true)]
    pub(super) exponent: Option<f64>,
    /// A file with a table [kernel], as `kernel` of a damping term in a scenario
    #[arg(long, value_name = "FILE")]
    kernel: Option<PathBuf>,
    /// An expression in the Laplace variable s, such as "s^0.5/(1 + s^0.5)"
    #[arg(long, value_name = "EXPRESSION")]
    symbol: Option<String>,
}

impl KernelChoice {
    /// Transfer function of the kernel, which need not be passive.
    pub(super) fn transfer(&self) -> Result<TransferFunction, CommandError> {
        match self {
            Self { kernel: Some(path), .. } => Ok(kernel_of_file(path)?.with_its_spring()),
            Self { symbol: Some(text), .. } => Ok(kernel_of_symbol(text)?.with_its_spring()),
            Self { exponent, .. } => {
                TransferFunction::power(exponent.unwrap_or(f64::NAN)).map_err(parameter_error)
            }
        }
    }

    /// The exponent β of a kernel s^β; an error for other kernels, for which `what` does not exist.
    pub(super) fn power(&self, what: &str) -> Result<f64, CommandError> {
        let transfer = self.transfer()?;
        transfer.exponent().ok_or_else(|| {
            CommandError::Unsuited(format!(
                "{what} are there for kernels s^β (--exponent), not for {transfer}"
            ))
        })
    }

    /// Description for the head of a listing.
    pub(super) fn origin(&self, transfer: &TransferFunction) -> String {
        match transfer.exponent() {
            Some(exponent) => format!("exponent {exponent}"),
            None => format!("kernel {transfer}"),
        }
    }
}
