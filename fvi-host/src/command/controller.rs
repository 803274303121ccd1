//! `fvi controller`: the controllers of a scenario as constants for firmware.

use super::CommandError;
use super::listing::{
    ListingFormat, ListingPrecision, check_exponentials, emit, exponentials_listing, identifier,
};
use crate::language::Problem;
use crate::numerics::exponential_table::ExponentialKernel;
use crate::scenario::{Controller, Scenario};
use crate::simulation::control::{Tables, tables};
use fvi_core::{AntiWindup, DerivativeFilter, DerivativeOf, PidGains};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Arguments of `fvi controller`.
#[derive(Debug, clap::Args)]
pub struct ControllerArguments {
    /// The scenario, a TOML file with [controller]
    scenario: PathBuf,
    /// Constants of Rust, or of C for fvi.h
    #[arg(long, value_enum)]
    format: Format,
    /// Numbers of the constants; those of C are single
    #[arg(long, value_enum, default_value = "f32")]
    precision: ListingPrecision,
    /// Prefix of the names of the constants
    #[arg(long, value_parser = identifier, default_value = "controller")]
    name: String,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// In which language.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// Constants of Rust
    Rust,
    /// Constants of C
    C,
}

/// A controller with what belongs to its constants.
struct Listed<'a> {
    controller: &'a Controller,
    tables: Tables,
    name: String,
    precision: ListingPrecision,
    format: ListingFormat,
    /// Steps between samples, and the delay in samples.
    timing: String,
}

impl ControllerArguments {
    pub(super) fn execute(self) -> Result<(), CommandError> {
        let scenario = Scenario::read(&self.scenario)?;
        if scenario.controllers.is_empty() {
            let problem = Problem::MissingKey { key: "controller".to_owned() };
            return Err(scenario.error_at("", problem).into());
        }
        let (format, precision) = match self.format {
            Format::Rust => (ListingFormat::Rust, self.precision),
            Format::C if self.precision == ListingPrecision::F32 => (ListingFormat::C, self.precision),
            Format::C => {
                return Err(CommandError::Unsuited(
                    "constants of C are for fvi.h, which computes in single precision: --precision f32"
                        .to_owned(),
                ));
            }
        };
        let mut text = String::new();
        let several = scenario.controllers.len() > 1;
        for (index, controller) in scenario.controllers.iter().enumerate() {
            let tables = tables(&scenario, controller).map_err(|reason| {
                let paths = ["controller.sample".to_owned(), format!("controller[{index}].sample")];
                let paths = [paths[0].as_str(), paths[1].as_str()];
                CommandError::from(scenario.error_at_first(&paths, Problem::Unusable { reason }))
            })?;
            let name = if several { format!("{}{index}", self.name) } else { self.name.clone() };
            let timing = format!("sample {}, delay {}", controller.sample, controller.delay);
            let listed = Listed { controller, tables, name, precision, format, timing };
            if index > 0 {
                text.push('\n');
            }
            listed.write(&mut text)?;
        }
        emit(|out| out.write_all(text.as_bytes()), self.out.as_deref())
    }
}

impl Listed<'_> {
    fn write(&self, text: &mut String) -> Result<(), CommandError> {
        let Tables { integral, derivative, filter } = &self.tables;
        let mut list = |part: &str, table: &ExponentialKernel, what: &str| {
            check_exponentials(table, 1.0, self.precision)?;
            let name = format!("{}_{part}", self.name);
            let listing = exponentials_listing(table, (what, Some(&name)), self.format, self.precision);
            *text += &listing;
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
        match self.format {
            ListingFormat::C => self.write_c(text),
            _ => self.write_rust(text),
        }
        Ok(())
    }

    fn write_rust(&self, text: &mut String) {
        let settings = &self.controller.settings;
        let (small, large) = (self.name.to_ascii_lowercase(), self.name.to_ascii_uppercase());
        let scalar = if self.precision == ListingPrecision::F32 { "f32" } else { "f64" };
        let number = |number: f64| match number {
            f64::INFINITY => format!("{scalar}::INFINITY"),
            f64::NEG_INFINITY => format!("{scalar}::NEG_INFINITY"),
            // Of the scalar: the same number as the run has.
            number if scalar == "f32" => format!("{:?}", number as f32),
            number => format!("{number:?}"),
        };
        let gains = match settings.gains {
            PidGains::Parallel { proportional, integral, derivative } => format!(
                "Parallel {{ proportional: {}, integral: {}, derivative: {} }}",
                number(proportional),
                number(integral),
                number(derivative)
            ),
            PidGains::Series { proportional, integral_rate, derivative_time, filter_ratio } => format!(
                "Series {{ proportional: {}, integral_rate: {}, derivative_time: {}, filter_ratio: {} }}",
                number(proportional),
                number(integral_rate),
                number(derivative_time),
                number(filter_ratio)
            ),
        };
        let of = match settings.derivative_of {
            DerivativeOf::Values => "Values",
            DerivativeOf::ValuesFromRest => "ValuesFromRest",
            DerivativeOf::MeasuredRate => "MeasuredRate",
        };
        let filter = match settings.derivative_filter {
            DerivativeFilter::None => "None".to_owned(),
            DerivativeFilter::FirstOrder { time } => format!("FirstOrder {{ time: {time:?} }}"),
            DerivativeFilter::Fractional { time, order } => {
                format!("Fractional {{ time: {time:?}, order: {order:?} }}")
            }
        };
        let windup = match settings.anti_windup {
            AntiWindup::None => "None".to_owned(),
            AntiWindup::BackCalculation { time } => format!("BackCalculation {{ time: {time:?} }}"),
            AntiWindup::Conditional => "Conditional".to_owned(),
        };
        let ([b, c], [lower, upper]) = (settings.setpoint_weights, settings.limits);
        let _ = writeln!(
            text,
            "/// The law of the controller, {}.\n///\n/// # Errors\n/// None: it has been checked.\n\
             pub fn {small}_law() -> Result<fvi_core::PidLaw<{scalar}>, fvi_core::ParameterError> {{\n    \
             fvi_core::PidLaw::new(fvi_core::PidSettings {{\n        gains: fvi_core::PidGains::{gains},\n        \
             integral_order: {:?},\n        derivative_order: {:?},\n        sample: Some({:?}),\n        \
             setpoint_weights: [{}, {}],\n        derivative_of: fvi_core::DerivativeOf::{of},\n        \
             derivative_filter: fvi_core::DerivativeFilter::{filter},\n        limits: [{}, {}],\n        \
             rate_limit: {},\n        anti_windup: fvi_core::AntiWindup::{windup},\n        \
             bumpless: fvi_core::Bumpless::Whole,\n    }})\n}}\n",
            self.timing,
            settings.integral_order,
            settings.derivative_order,
            self.controller.sample,
            number(b),
            number(c),
            number(lower),
            number(upper),
            number(settings.rate_limit),
        );
        let memory = |part: &str| {
            format!(
                "fvi_core::ExponentialSum<{scalar}, &'static [{scalar}], [{scalar}; {large}_{part}.state_len(1)]>"
            )
        };
        let mut types = format!("{scalar}, {}, {}", memory("INTEGRAL"), memory("DERIVATIVE"));
        let filtered = self.tables.filter.is_some();
        if filtered {
            let _ = write!(types, ", fvi_core::PidLaw<{scalar}>, {}", memory("FILTER"));
        }
        let camel: String = small
            .split('_')
            .map(|word| {
                let mut letters = word.chars();
                letters.next().map_or_else(String::new, |first| {
                    first.to_ascii_uppercase().to_string() + letters.as_str()
                })
            })
            .collect();
        let made = |part: &str, kernel: &str| {
            format!("{kernel}.exponential_sum({large}_{part}, 1, [0.0; {large}_{part}.state_len(1)])?")
        };
        let (integral, derivative) =
            (made("INTEGRAL", "law.integral_kernel()?"), made("DERIVATIVE", "law.derivative_kernel()?"));
        let parts = if filtered {
            let filter = made("FILTER", "kernel");
            format!(
                "    let filter = match law.filter_kernel()? {{\n        Some(kernel) => Some({filter}),\n        \
                 None => None,\n    }};\n    \
                 fvi_core::FractionalPid::with_parts(law, integral, Some(derivative), filter)\n"
            )
        } else {
            "    fvi_core::FractionalPid::new(law, integral, derivative)\n".to_owned()
        };
        let _ = write!(
            text,
            "/// The controller.\npub type {camel}Pid = fvi_core::FractionalPid<{types}>;\n\n\
             /// The controller, before its first tick.\n///\n/// # Errors\n/// None: it has been checked.\n\
             pub fn new_{small}() -> Result<{camel}Pid, fvi_core::ParameterError> {{\n    let law = {small}_law()?;\n    \
             let integral = {integral};\n    let derivative = {derivative};\n{parts}}}\n"
        );
    }

    fn write_c(&self, text: &mut String) {
        let settings = &self.controller.settings;
        let large = self.name.to_ascii_uppercase();
        let number = |number: f64| match number {
            f64::INFINITY => "INFINITY".to_owned(),
            f64::NEG_INFINITY => "-INFINITY".to_owned(),
            number => format!("{:e}f", number as f32),
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
        if settings.limits[0].is_finite() {
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
        let _ = write!(
            text,
            "/* The members of FviPidSettings of the controller, {}. fvi_pid_init takes them with memories of\n   \
             {large}_INTEGRAL_TABLE and {large}_DERIVATIVE_TABLE{filter}: their weights are for a step of 1, and\n   \
             fvi_memory_scale_bdf gives each its scale. */\n#define {large}_SETTINGS",
            self.timing
        );
        for (name, value) in members {
            let _ = write!(text, " \\\n    .{name} = {value},");
        }
        text.push('\n');
    }
}
