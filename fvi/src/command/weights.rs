//! `fvi weights`: convolution-quadrature weights as a table or as constants.

use super::CommandError;
use super::kernel_choice::KernelChoice;
use super::listing::{
    ListingFormat, ListingPrecision, emit, identifier, parameter_error, write_matrix_weights, write_weights,
};
use fvi_core::{BdfOrder, ConvolutionWeights, ParameterError, RungeKutta};
use fvi_fft::quadrature::StagedMethod;
use fvi_fft::quadrature::multistep_weights::multistep_weights;
use fvi_fft::quadrature::runge_kutta_weights::RungeKuttaWeights;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::transfer::multistep_rule::MultistepRule;
use fvi_fft::with_staged_method;
use fvi_scenario::language::memory_limit::check_capacity;
use std::path::PathBuf;

/// Arguments of `fvi weights`.
#[derive(Debug, clap::Args)]
pub(crate) struct WeightsArguments {
    /// Family of the underlying multistep method
    #[arg(long, value_enum, default_value_t)]
    family: Family,
    /// Order p of the backward differentiation formula, 1 to 6
    #[arg(long, default_value_t = 1)]
    order: usize,
    /// Stages of the Runge–Kutta method: 1 to 3 (radau-iia), 2 to 4 (lobatto-iiic); the weights are matrices
    /// then
    #[arg(long)]
    stages: Option<usize>,
    #[command(flatten)]
    kernel: KernelChoice,
    /// Step size h
    #[arg(long, default_value_t = 1.0)]
    step: f64,
    /// Weights for memories on differences, on increments (bdf, trapezoidal) or rises (others), which lose
    /// less to rounding
    #[arg(long)]
    increments: bool,
    /// How many weights
    #[arg(long, default_value_t = 64)]
    count: usize,
    /// A table, or constants for firmware
    #[arg(long, value_enum, default_value_t)]
    format: ListingFormat,
    /// Precision of the constants [default: f32 in C, as in fvi.h, else f64]
    #[arg(long, value_enum)]
    precision: Option<ListingPrecision>,
    /// Name of the constants, such as half_derivative [default: WEIGHTS in Rust, fvi in C]
    #[arg(long, value_parser = identifier)]
    name: Option<String>,
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
    /// The trapezoidal rule, `convolution.symbol` = "trapezoidal" in scenarios
    Trapezoidal,
    /// Radau IIA methods
    RadauIia,
    /// Lobatto IIIC methods
    LobattoIiic,
}

/// Number of weights that are checked before the first is written.
const CHECKED: usize = 1 << 16;

impl WeightsArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        match (self.family, self.stages) {
            (Family::Bdf, None) => self.bdf(),
            (Family::Trapezoidal, None) => {
                self.of_transfer(&self.kernel.transfer()?, MultistepRule::Trapezoidal)
            }
            (Family::RadauIia, Some(stages)) => self.staged(StagedMethod::RadauIia(stages)),
            (Family::LobattoIiic, Some(stages)) => self.staged(StagedMethod::LobattoIiic(stages)),
            (family, stages) => {
                let allowed = match family {
                    Family::Bdf => "none with the family bdf",
                    Family::Trapezoidal => "none with the family trapezoidal",
                    Family::RadauIia => "1, 2, 3, 5 or 7 with the family radau-iia",
                    Family::LobattoIiic => "2, 3 or 4 with the family lobatto-iiic",
                };
                let value = stages.map_or(f64::NAN, |stages| stages as f64);
                Err(parameter_error(ParameterError { parameter: "stages", value, allowed }))
            }
        }
    }

    fn bdf(&self) -> Result<(), CommandError> {
        let order = BdfOrder::new(self.order).map_err(parameter_error)?;
        let transfer = self.kernel.transfer()?;
        let Some(exponent) = transfer.exponent() else { return self.of_transfer(&transfer, order.into()) };
        let weights = || -> Result<ConvolutionWeights, CommandError> {
            let weights = ConvolutionWeights::bdf(order, exponent, self.step).map_err(parameter_error)?;
            Ok(if self.increments { weights.on_increments() } else { weights })
        };
        let first: Vec<f64> = weights()?.take(self.count.min(CHECKED)).collect();
        // Beyond them the weights decay like n^(−1−exponent), those on increments like n^(−exponent).
        let power = exponent + if self.increments { 0.0 } else { 1.0 };
        let factor = libm::pow((self.count as f64 / CHECKED as f64).max(1.0), -power);
        let last = first.last().map(|weight| weight * factor);
        self.check(first.iter().copied().chain(last))?;
        let weights = weights()?;
        let on = if self.increments { " on increments" } else { "" };
        let origin = format!("BDF {}, exponent {exponent}{on}, step {}", self.order, self.step);
        let said = (&*origin, self.name.as_deref());
        emit(|out| write_weights(out, weights, self.count, said, self.form()), self.out.as_deref())
    }

    /// Lists weights that are computed all at once: for kernels other than s^β, or by the trapezoidal rule.
    fn of_transfer(&self, transfer: &TransferFunction, rule: MultistepRule) -> Result<(), CommandError> {
        check_capacity(self.count.saturating_mul(2 * size_of::<f64>()))
            .map_err(|error| CommandError::NoRoom(format!("--count: {error}")))?;
        let weights = multistep_weights(transfer, rule, self.step, self.increments, self.count)
            .map_err(parameter_error)?;
        let on = if self.increments { " on increments" } else { "" };
        let origin = format!("{rule}, {}{on}, step {}", self.kernel.origin(transfer), self.step);
        let said = (&*origin, self.name.as_deref());
        let write = |out: &mut dyn std::io::Write| {
            write_weights(out, weights.into_iter(), self.count, said, self.form())
        };
        emit(write, self.out.as_deref())
    }

    fn staged(&self, staged: StagedMethod) -> Result<(), CommandError> {
        with_staged_method!(staged, method => self.matrices(staged.family(), &method))
            .map_err(parameter_error)?
    }

    fn matrices<const R: usize>(&self, name: &str, method: &RungeKutta<R>) -> Result<(), CommandError> {
        let exponent = self.kernel.power("weights of Runge–Kutta families")?;
        let make = if self.increments { RungeKuttaWeights::on_rises } else { RungeKuttaWeights::new };
        let weights = make(method, exponent, self.step, self.count).map_err(parameter_error)?;
        check_capacity(self.count.saturating_mul(R * R * size_of::<f64>()))
            .map_err(|error| CommandError::NoRoom(format!("--count: {error}")))?;
        let planes = weights.planes();
        self.check(planes.iter().copied())?;
        let on = if self.increments { " on rises" } else { "" };
        let origin = format!("{name}, {R} stages, exponent {exponent}{on}, step {}", self.step);
        let said = (&*origin, self.name.as_deref());
        emit(|out| write_matrix_weights(out, &planes, R, said, self.form()), self.out.as_deref())
    }

    /// Format and precision of the listing.
    fn form(&self) -> (ListingFormat, ListingPrecision) {
        (self.format, self.format.precision(self.precision))
    }

    /// Refuses weights that overflow or underflow in the precision of the listing.
    fn check(&self, mut weights: impl Iterator<Item = f64>) -> Result<(), CommandError> {
        let single = self.form().1 == ListingPrecision::F32;
        let held = |weight: f64| if single { (weight as f32).is_normal() } else { weight.is_normal() };
        if weights.all(|weight| weight == 0.0 || held(weight)) {
            return Ok(());
        }
        let allowed = match single {
            true => "a step whose weights, h^−exponent in size, single precision holds",
            false => "a step whose weights, h^−exponent in size, double precision holds",
        };
        Err(parameter_error(ParameterError { parameter: "step", value: self.step, allowed }))
    }
}
