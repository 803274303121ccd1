//! `fvi controller`: the controllers of a scenario as constants for firmware.

use super::CommandError;
use super::listing::{
    ListingFormat, ListingPrecision, check_exponentials, emit, exponentials_listing, identifier,
    parameter_error,
};
use super::terminal::mention;
use fvi_core::{AntiWindup, DerivativeFilter, DerivativeOf, PidGains, Sealing};
use fvi_fft::exponentials::controller_source::{ControllerSourceError, ControllerTables, source_with_tables};
use fvi_fft::exponentials::exponential_table::{
    ExponentialKernel, ExponentialKernelError, SMALLEST_TOLERANCE,
};
use fvi_fft::exponentials::fixed_source::{FixedController, FixedUnits};
use fvi_scenario::language::{Document, Problem};
use fvi_scenario::scenario::{Controller, Scenario};
use fvi_simulation::simulation::control::{Unusable, tables_of_firmware};
use std::fmt::{LowerExp, Write as _};
use std::path::PathBuf;

/// Arguments of `fvi controller`.
#[derive(Debug, clap::Args)]
pub(crate) struct ControllerArguments {
    /// A scenario with [controller], or `controller.toml` of `fvi tune`, a TOML file
    scenario: PathBuf,
    /// Constants of Rust, or of C for fvi.h. Memories are endless and, in single precision, accurate to 1e-7,
    /// unless [history] has a horizon and a tolerance
    #[arg(long, value_enum)]
    format: Format,
    /// Numbers of the constants; those of C are single
    #[arg(long, value_enum, default_value = "f32")]
    precision: ListingPrecision,
    /// As few exponentials as the frequencies from LOW to HIGH need, in Hz for a sample time in seconds: there
    /// the response of every operator is within the tolerance
    #[arg(long, num_args = 2, value_names = ["LOW", "HIGH"], requires = "tolerance")]
    band: Option<Vec<f64>>,
    /// Relative tolerance of the responses over the band, 1e-7 to 0.1
    #[arg(long, requires = "band")]
    tolerance: Option<f64>,
    /// Floating point, or whole numbers, for processors without a floating-point unit and on tables for a band
    #[arg(long, value_enum, default_value_t, requires_ifs = [("fixed", "band"), ("fixed", "input_unit"), ("fixed", "output_unit")])]
    arithmetic: Arithmetic,
    /// With whole numbers: what a count of setpoint and measured value is worth, in units of the scenario
    #[arg(long, value_name = "UNIT")]
    input_unit: Option<f64>,
    /// With whole numbers: what a count of the output is worth
    #[arg(long, value_name = "UNIT")]
    output_unit: Option<f64>,
    /// Prefix of the names of the constants
    #[arg(long, value_parser = identifier, default_value = "controller")]
    name: String,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Language of the constants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// Constants of Rust
    Rust,
    /// Constants of C
    C,
}

/// Numbers of a controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum Arithmetic {
    /// Floating point
    #[default]
    Float,
    /// Whole numbers of 32 and 64 bits
    Fixed,
}

/// A controller with the tables and options for its constants.
struct Listed<'a> {
    controller: &'a Controller,
    tables: ControllerTables,
    name: String,
    precision: ListingPrecision,
    format: Format,
}

impl ControllerArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let scenario = Scenario::with_controllers(Document::read(&self.scenario)?)?;
        if scenario.controllers.is_empty() {
            let problem = Problem::MissingKey { key: "controller".to_owned() };
            return Err(scenario.error_at("", problem).into());
        }
        let (format, precision) = (self.format, self.precision);
        if format == Format::C && precision != ListingPrecision::F32 {
            return Err(CommandError::Unsuited(
                "constants of C are for fvi.h, which computes in single precision: --precision f32"
                    .to_owned(),
            ));
        }
        let units = self.units()?;
        // Unless the scenario says otherwise: near the rounding of the numbers.
        let tolerance = match precision {
            ListingPrecision::F32 => 1e-7,
            ListingPrecision::F64 => SMALLEST_TOLERANCE,
        };
        let mut text = String::new();
        let mut mentions = String::new();
        let several = scenario.controllers.len() > 1;
        for (index, controller) in scenario.controllers.iter().enumerate() {
            let refused = |unusable: Unusable| CommandError::from(unusable.error(&scenario, index));
            let tables = match (self.band.as_deref(), self.tolerance) {
                (Some(&[low, high]), Some(tolerance)) => over_band(controller, [low, high], tolerance)?,
                _ => tables_of_firmware(&scenario, controller, tolerance).map_err(refused)?,
            };
            // Values that the microcontroller would refuse are refused here, in its precision.
            let fits = match precision {
                ListingPrecision::F32 => controller.law::<f32>().map(|_| ()),
                ListingPrecision::F64 => controller.law::<f64>().map(|_| ()),
            };
            fits.map_err(|error| refused(Unusable::of_parameter(&error)))?;
            let name = if several { format!("{}{index}", self.name) } else { self.name.clone() };
            let listed = Listed { controller, tables, name, precision, format };
            if index > 0 {
                text.push('\n');
            }
            match units {
                Some(units) => {
                    let fixed = listed.write_fixed(units, &mut text)?;
                    mentions += &format!("note: {} in whole numbers: {}\n", listed.name, fixed.worth());
                }
                None => listed.write(&mut text)?,
            }
            for (part, errors) in &listed.tables.errors {
                mentions += &format!("note: {} {part}: {errors}\n", listed.name);
            }
            if let Some(end) = listed.end() {
                mentions += &format!("note: {} {end}: further ticks are refused\n", listed.name);
            }
        }
        emit(|out| out.write_all(text.as_bytes()), self.out.as_deref())?;
        mention(&mentions);
        Ok(())
    }
}

impl ControllerArguments {
    /// What counts are worth, for whole numbers.
    fn units(&self) -> Result<Option<FixedUnits>, CommandError> {
        let unsuited = |reason: &str| Err(CommandError::Unsuited(reason.to_owned()));
        match (self.arithmetic, self.input_unit, self.output_unit) {
            (Arithmetic::Fixed, ..) if self.precision != ListingPrecision::F32 => {
                unsuited("--precision is that of numbers in floating point: not with --arithmetic fixed")
            }
            (Arithmetic::Fixed, Some(input), Some(output)) => Ok(Some(FixedUnits { input, output })),
            (_, None, None) => Ok(None),
            _ => unsuited("--input-unit and --output-unit are for --arithmetic fixed, and needed there"),
        }
    }
}

/// The tables of a controller for a band.
fn over_band(
    controller: &Controller,
    band: [f64; 2],
    tolerance: f64,
) -> Result<ControllerTables, CommandError> {
    let law = controller.law::<f64>().map_err(parameter_error)?;
    ControllerTables::over_band(&law, band, tolerance).map_err(|error| match error {
        ExponentialKernelError::Parameter(error) => parameter_error(error),
        missed => CommandError::Failed(missed.to_string()),
    })
}

impl Listed<'_> {
    /// When the controller ends, in words, if it does.
    fn end(&self) -> Option<String> {
        self.tables.end(self.controller.sample)
    }

    fn write(&self, text: &mut String) -> Result<(), CommandError> {
        match (self.format, self.precision) {
            (Format::C, _) => {
                self.write_c(text)?;
                if text.contains("INFINITY") {
                    text.insert_str(0, "#include <math.h>\n\n");
                }
                Ok(())
            }
            (Format::Rust, ListingPrecision::F32) => self.write_rust::<f32>(text),
            (Format::Rust, ListingPrecision::F64) => self.write_rust::<f64>(text),
        }
    }

    fn write_rust<T: Sealing + LowerExp>(&self, text: &mut String) -> Result<(), CommandError> {
        let law = self.controller.law::<T>().map_err(parameter_error)?;
        let note = format!(", delay {}", self.controller.delay);
        let source = source_with_tables(&self.name, &law, &self.tables, &note);
        *text += &source.map_err(|error| match error {
            ControllerSourceError::Setting(error) => parameter_error(error),
            other => CommandError::Unsuited(other.to_string()),
        })?;
        Ok(())
    }

    /// Writes the constants of a controller in whole numbers.
    fn write_fixed(&self, units: FixedUnits, text: &mut String) -> Result<FixedController, CommandError> {
        let Self { controller, tables, name, .. } = self;
        let law = controller.law::<f64>().map_err(parameter_error)?;
        let fixed = FixedController::new(&law, tables, units).map_err(parameter_error)?;
        let note = format!(", delay {}", controller.delay);
        *text += &match self.format {
            Format::Rust => fixed.rust(name, controller.sample, tables, &note),
            Format::C => fixed.c(name, controller.sample, tables, &note),
        };
        Ok(fixed)
    }

    fn write_c(&self, text: &mut String) -> Result<(), CommandError> {
        let ControllerTables { integral, derivative, filter, .. } = &self.tables;
        let mut list = |part: &str, table: &ExponentialKernel, what: &str| {
            check_exponentials(table, 1.0, self.precision)?;
            let name = format!("{}_{part}", self.name);
            let what = &format!("{what}{}", self.tables.worth(part));
            *text += &exponentials_listing(table, (what, Some(&name)), ListingFormat::C, self.precision);
            text.push('\n');
            Ok::<_, CommandError>(())
        };
        let settings = &self.controller.settings;
        let (lambda, mu) = (settings.integral_order, settings.derivative_order);
        let summed = if lambda < 1.0 { "" } else { " but for a sum" };
        list("integral", integral, &format!("Integral, s^-{lambda}{summed}"))?;
        list("derivative", derivative, &format!("Derivative, s^{mu}"))?;
        if let Some(filter) = filter {
            list("filter", filter, "Filter of the derivative")?;
        }
        let large = self.name.to_ascii_uppercase();
        let number = |number: f64| match number as f32 {
            f32::INFINITY => "INFINITY".to_owned(),
            f32::NEG_INFINITY => "-INFINITY".to_owned(),
            number => format!("{number:e}f"),
        };
        let mut members = Vec::new();
        let double = |number: f64| format!("{number:e}");
        members.push(("sample", double(self.controller.sample)));
        members.push(("lambda", double(settings.integral_order)));
        members.push(("mu", double(settings.derivative_order)));
        match settings.derivative_filter {
            DerivativeFilter::None => {}
            DerivativeFilter::FirstOrder { time } => members.push(("filter_time", double(time))),
            DerivativeFilter::Fractional { time, order } => {
                members.extend([("filter_time", double(time)), ("filter_order", double(order))]);
            }
        }
        match settings.gains {
            PidGains::Parallel { proportional, integral, derivative } => {
                members.push(("form", "FVI_PID_PARALLEL".to_owned()));
                members.extend([
                    ("kp", number(proportional)),
                    ("ki", number(integral)),
                    ("kd", number(derivative)),
                ]);
            }
            PidGains::Series { proportional, integral_rate, derivative_time, filter_ratio } => {
                members.push(("form", "FVI_PID_SERIES".to_owned()));
                members.extend([
                    ("kp", number(proportional)),
                    ("ki", number(integral_rate)),
                    ("kd", number(derivative_time)),
                    ("filter_ratio", number(filter_ratio)),
                ]);
            }
        }
        let [b, c] = settings.setpoint_weights;
        members.push(("setpoint_weights", format!("{{{}, {}}}", number(b), number(c))));
        if settings.limits.iter().any(|limit| limit.is_finite()) {
            let [lower, upper] = settings.limits;
            members.push(("limits", format!("{{{}, {}}}", number(lower), number(upper))));
        }
        if settings.rate_limit.is_finite() {
            members.push(("rate_limit", number(settings.rate_limit)));
        }
        members.push((
            "derivative_of",
            match settings.derivative_of {
                DerivativeOf::Values => "FVI_PID_OF_VALUES",
                DerivativeOf::ValuesFromRest => "FVI_PID_FROM_REST",
                DerivativeOf::MeasuredRate => "FVI_PID_OF_RATE",
            }
            .to_owned(),
        ));
        match settings.anti_windup {
            AntiWindup::None => {}
            AntiWindup::BackCalculation { time } => {
                members.push(("anti_windup", "FVI_PID_BACK_CALCULATION".to_owned()));
                members.push(("tracking_time", double(time)));
            }
            AntiWindup::Conditional => members.push(("anti_windup", "FVI_PID_CONDITIONAL".to_owned())),
        }
        let filter =
            if self.tables.filter.is_some() { format!(", {large}_FILTER_TABLE") } else { String::new() };
        let end = match self.end() {
            Some(end) => format!("The controller {end}: further ticks are refused"),
            None => "The controller has no end".to_owned(),
        };
        let _ = write!(
            text,
            "/* The members of FviPidSettings of the controller, sample {}, delay {}. fvi_pid_init takes them with memories of\n   \
             {large}_INTEGRAL_TABLE and {large}_DERIVATIVE_TABLE{filter}: their weights are for a step of 1, and\n   \
             fvi_memory_scale_bdf gives each its scale. {end}. */\n#define {large}_SETTINGS",
            self.controller.sample, self.controller.delay
        );
        for (name, value) in members {
            let _ = write!(text, " \\\n    .{name} = {value},");
        }
        text.push('\n');
        Ok(())
    }
}
