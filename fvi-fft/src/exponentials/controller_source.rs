//! A fractional PID controller as Rust source: its tables, its law, a type and a constructor.

use crate::exponentials::band_table::{BandErrors, band_table, check};
use crate::exponentials::exponential_table::{ExponentialKernel, ExponentialKernelError};
use crate::exponentials::rust_constants::{end_of, is_identifier, scalar, table_constant, table_fits};
use crate::transfer::TransferFunction;
use fvi_core::{
    AntiWindup, BdfOrder, Bumpless, DerivativeFilter, DerivativeOf, Kernel, ParameterError, PidGains, PidLaw,
    PidSettings, Real,
};
use std::fmt::{LowerExp, Write as _};

/// The tables of a controller on exponential sums, computed for a step of 1: [`Kernel::exponential_sum`]
/// scales them.
#[derive(Clone, Debug, PartialEq)]
pub struct ControllerTables {
    /// D^{−λ}, or D^{1−λ} for λ ≥ 1.
    pub integral: ExponentialKernel,
    /// D^μ, on increments; D^{μ−1} of a measured rate.
    pub derivative: ExponentialKernel,
    /// D^ν of a fractional filter of the derivative.
    pub filter: Option<ExponentialKernel>,
    /// Of tables for a band, by part: what they are worth there.
    pub errors: Vec<(&'static str, BandErrors)>,
}

/// Time between the ticks of a law.
fn sample_of<T: Real>(law: &PidLaw<T>) -> Result<f64, ParameterError> {
    let allowed = "a number: a table for ticks at any times is one of rates";
    law.settings().sample.ok_or(ParameterError { parameter: "sample time", value: f64::NAN, allowed })
}

impl ControllerTables {
    /// Tables whose weights hold to the relative tolerance `tolerance` up to lag `horizon`, in ticks.
    ///
    /// # Errors
    /// [`ExponentialKernelError`] if the law has no sample time, the horizon or the tolerance is not allowed,
    /// or no table reaches the tolerance.
    pub fn new<T: Real>(
        law: &PidLaw<T>,
        horizon: usize,
        tolerance: f64,
    ) -> Result<Self, ExponentialKernelError> {
        sample_of(law)?;
        let table = |kernel: Kernel| {
            let exponent = kernel.symbol().growth();
            let made =
                if exponent > 0.0 { ExponentialKernel::bdf_on_increments } else { ExponentialKernel::bdf };
            made(BdfOrder::GRUNWALD_LETNIKOV, exponent, 1.0, horizon, tolerance)
        };
        Ok(Self {
            integral: table(law.integral_kernel()?)?,
            derivative: table(law.derivative_kernel()?)?,
            filter: law.filter_kernel()?.map(table).transpose()?,
            errors: Vec::new(),
        })
    }

    /// Endless tables of few exponentials whose frequency responses are within the relative tolerance
    /// `tolerance` from `band[0]` to `band[1]` in Hz, for a sample time in seconds ([`band_table`]).
    ///
    /// # Errors
    /// [`ExponentialKernelError`] as [`new`](Self::new), and of the band.
    pub fn over_band<T: Real>(
        law: &PidLaw<T>,
        band: [f64; 2],
        tolerance: f64,
    ) -> Result<Self, ExponentialKernelError> {
        let mut tables = Self::new(law, 1, tolerance)?;
        let sample = sample_of(law)?;
        check(band, sample, tolerance)?;
        let mut errors = Vec::new();
        let mut table = |part: &'static str, kernel: Kernel| {
            let exponent = kernel.symbol().growth();
            let transfer = TransferFunction::power(exponent)?;
            let of_step = band.map(|frequency| frequency * sample);
            let order = BdfOrder::GRUNWALD_LETNIKOV;
            let (table, found) = band_table(&transfer, order, exponent > 0.0, 1.0, of_step, tolerance)?;
            errors.push((part, BandErrors { band, ..found }));
            Ok::<_, ExponentialKernelError>(table)
        };
        tables.integral = table("integral", law.integral_kernel()?)?;
        tables.derivative = table("derivative", law.derivative_kernel()?)?;
        tables.filter = law.filter_kernel()?.map(|kernel| table("filter", kernel)).transpose()?;
        Ok(Self { errors, ..tables })
    }

    /// What the table of a part is worth over its band, to follow its description.
    pub fn worth(&self, part: &str) -> String {
        let found = self.errors.iter().find(|(of, _)| *of == part);
        found.map_or_else(String::new, |(_, errors)| format!("; {errors}"))
    }

    /// When a controller on the tables ends, in words, with this time between ticks; `None` where it does
    /// not.
    pub fn end(&self, sample: f64) -> Option<String> {
        let tables = [Some(&self.integral), Some(&self.derivative), self.filter.as_ref()];
        tables.into_iter().flatten().find_map(|table| end_of(table, sample))
    }
}

/// Reason why no source of a controller was generated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ControllerSourceError {
    /// The name is not a valid identifier.
    #[error("`{name}` is no name for constants: it has letters, digits and underscores, the first a letter")]
    Name {
        /// The name.
        name: String,
    },
    /// A setting is not allowed.
    #[error(transparent)]
    Setting(#[from] ParameterError),
    /// A table could not be computed.
    #[error("the table of the {part}: {reason}")]
    Table {
        /// `controller`, or the part whose numbers are out of range in the precision.
        part: &'static str,
        /// The reason.
        reason: String,
    },
}

impl From<ExponentialKernelError> for ControllerSourceError {
    fn from(error: ExponentialKernelError) -> Self {
        match error {
            ExponentialKernelError::Parameter(error) => Self::Setting(error),
            missed => Self::Table { part: "controller", reason: missed.to_string() },
        }
    }
}

/// Rust source of a controller on exponential sums, for `include!` in a program without std: for build
/// scripts, and printed by `fvi controller`.
///
/// For the name `axis` it contains the tables `AXIS_INTEGRAL` and `AXIS_DERIVATIVE` (and `AXIS_FILTER` with a
/// fractional filter); `axis_law()` for the law with these settings; the type `AxisPid`, a
/// [`FractionalPid`](fvi_core::FractionalPid) that owns its law, or shares it as `AxisPid<&'static
/// PidLaw<f32>>`; `new_axis()` with a law of its own, and `axis_with(law)` with a given one. If the gain of
/// the derivative is 0 there is no memory for it. The numbers are those of T, `f32` or `f64`; the source
/// depends on fvi-core only.
///
/// `horizon` is the number of ticks for which the weights hold, each within the relative tolerance
/// `tolerance` ([`ExponentialKernel::bdf`]), and after which the controller refuses further ones;
/// [`ENDLESS`](super::exponential_table::ENDLESS) for no limit. The source says which.
///
/// ```
/// use fvi_core::{AntiWindup, PidGains, PidSettings};
/// use fvi_fft::exponentials::controller_source::controller_source;
/// use fvi_fft::exponentials::exponential_table::ENDLESS;
///
/// // In build.rs:
/// let gains = PidGains::Parallel { proportional: 8.0f32, integral: 4.0, derivative: 2.0 };
/// let settings = PidSettings {
///     integral_order: 0.9,
///     derivative_order: 0.8,
///     limits: [-2.0, 2.0],
///     anti_windup: AntiWindup::BackCalculation { time: 0.2 },
///     ..PidSettings::new(gains, 1e-3)
/// };
/// let source = controller_source("axis", &settings, ENDLESS, 1e-7)?;
/// // std::fs::write(Path::new(&env::var("OUT_DIR")?).join("axis.rs"), source)?;
/// assert!(source.contains("pub fn new_axis()"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`ControllerSourceError`] if the name is not an identifier, [`PidLaw::new`] refuses the settings, or there
/// are no such tables.
pub fn controller_source<T: Real + LowerExp>(
    name: &str,
    settings: &PidSettings<T>,
    horizon: usize,
    tolerance: f64,
) -> Result<String, ControllerSourceError> {
    let law = PidLaw::new(*settings)?;
    let tables = ControllerTables::new(&law, horizon, tolerance)?;
    source_with_tables(name, &law, &tables, "")
}

/// The same with given tables; `note` follows the sample time in the documentation of the law.
///
/// # Errors
/// If the name is not an identifier, or a table is out of range in the precision.
pub fn source_with_tables<T: Real + LowerExp>(
    name: &str,
    law: &PidLaw<T>,
    tables: &ControllerTables,
    note: &str,
) -> Result<String, ControllerSourceError> {
    if !is_identifier(name) {
        return Err(ControllerSourceError::Name { name: name.to_owned() });
    }
    let settings = law.settings();
    let scalar = scalar::<T>();
    let (small, large) = (name.to_ascii_lowercase(), name.to_ascii_uppercase());
    let differentiates = tables.filter.is_some() || has_derivative(&settings.gains);
    let summed = if settings.integral_order < 1.0 { "" } else { " but for a sum" };
    let integral = format!("Integral, s^-{}{summed}", settings.integral_order);
    let derivative = format!("Derivative, s^{}", settings.derivative_order);
    let filter = "Filter of the derivative".to_owned();
    let mut parts = vec![("integral", integral, &tables.integral)];
    if differentiates {
        parts.push(("derivative", derivative, &tables.derivative));
    }
    parts.extend(tables.filter.as_ref().map(|table| ("filter", filter, table)));
    let mut text = String::new();
    for (part, origin, table) in &parts {
        if !table_fits::<T>(table) {
            let reason = format!("a number does not fit into {scalar}: choose a shorter horizon");
            return Err(ControllerSourceError::Table { part, reason });
        }
        let origin = format!("{origin}{}", tables.worth(part));
        text += &table_constant::<T>(table, &origin, &format!("{name}_{part}"));
        text.push('\n');
    }
    write_law(&mut text, &small, settings, note);

    let memory = |part: &str| {
        format!(
            "fvi_core::ExponentialSum<{scalar}, &'static [{scalar}], [{scalar}; {large}_{part}.state_len(1)]>"
        )
    };
    let law_type = format!("fvi_core::PidLaw<{scalar}>");
    let mut types = format!("{scalar}, {}, ", memory("INTEGRAL"));
    types += &if differentiates { memory("DERIVATIVE") } else { format!("fvi_core::Memoryless<{scalar}>") };
    types += ", L";
    if tables.filter.is_some() {
        let _ = write!(types, ", {}", memory("FILTER"));
    }
    let made = |part: &str, kernel: &str| {
        format!("{kernel}.exponential_sum({large}_{part}, 1, [0.0; {large}_{part}.state_len(1)])?")
    };
    let mut body = format!(
        "    let shared: &{law_type} = law.borrow();\n    let integral = {};\n",
        made("INTEGRAL", "shared.integral_kernel()?")
    );
    if differentiates {
        let _ = writeln!(body, "    let derivative = {};", made("DERIVATIVE", "shared.derivative_kernel()?"));
    }
    body += &match (&tables.filter, differentiates) {
        (Some(_), _) => format!(
            "    let filter = match shared.filter_kernel()? {{\n        Some(kernel) => Some({}),\n        \
             None => None,\n    }};\n    \
             fvi_core::FractionalPid::with_parts(law, integral, Some(derivative), filter)\n",
            made("FILTER", "kernel")
        ),
        (None, true) => "    fvi_core::FractionalPid::new(law, integral, derivative)\n".to_owned(),
        (None, false) => "    fvi_core::FractionalPid::without_derivative(law, integral)\n".to_owned(),
    };
    let camel = camel_case(&small);
    let end = match law.settings().sample.and_then(|sample| tables.end(sample)) {
        Some(end) => format!("It\n/// {end}: further ticks are refused."),
        None => "It has no end.".to_owned(),
    };
    let _ = write!(
        text,
        "/// The controller, with a law of its own or one that it borrows. {end}\n\
         pub type {camel}Pid<L = {law_type}> = fvi_core::FractionalPid<{types}>;\n\n\
         /// The controller with a law of its own, before its first tick.\n///\n/// # Errors\n\
         /// None: it has been checked.\n\
         pub fn new_{small}() -> Result<{camel}Pid, fvi_core::ParameterError> {{\n    \
         {small}_with({small}_law()?)\n}}\n\n\
         /// The same with this law, by value or by reference: one with other gains, \
         or one that loops share.\n\
         ///\n/// # Errors\n/// If its orders or its sample time are others than those of the tables.\n\
         pub fn {small}_with<L: core::borrow::Borrow<{law_type}>>(\n    law: L,\n\
         ) -> Result<{camel}Pid<L>, fvi_core::ParameterError> {{\n{body}}}\n"
    );
    Ok(text)
}

fn has_derivative<T: Real>(gains: &PidGains<T>) -> bool {
    match *gains {
        PidGains::Parallel { derivative, .. } => derivative != T::zero(),
        PidGains::Series { derivative_time, .. } => derivative_time != T::zero(),
    }
}

/// `two_words` as `TwoWords`.
fn camel_case(name: &str) -> String {
    let word = |word: &str| {
        let mut letters = word.chars();
        let first = letters.next().map(|first| first.to_ascii_uppercase().to_string());
        first.unwrap_or_default() + letters.as_str()
    };
    name.split('_').map(word).collect()
}

/// Writes the function that constructs the law.
fn write_law<T: Real>(text: &mut String, small: &str, settings: &PidSettings<T>, note: &str) {
    let scalar = scalar::<T>();
    let number = |number: T| match number.to_f64() {
        f64::INFINITY => format!("{scalar}::INFINITY"),
        f64::NEG_INFINITY => format!("{scalar}::NEG_INFINITY"),
        _ => format!("{number:?}"),
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
    let bumpless = match settings.bumpless {
        Bumpless::Whole => "Whole",
        Bumpless::ExceptProportional => "ExceptProportional",
        Bumpless::Nothing => "Nothing",
    };
    let ([b, c], [lower, upper]) = (settings.setpoint_weights, settings.limits);
    let sample = settings.sample.map_or_else(|| "of each tick's own".to_owned(), |sample| sample.to_string());
    let _ = writeln!(
        text,
        "/// The law of the controller, sample {sample}{note}.\n///\n/// # Errors\n/// None: it has been checked.\n\
         pub fn {small}_law() -> Result<fvi_core::PidLaw<{scalar}>, fvi_core::ParameterError> {{\n    \
         fvi_core::PidLaw::new(fvi_core::PidSettings {{\n        gains: fvi_core::PidGains::{gains},\n        \
         integral_order: {:?},\n        derivative_order: {:?},\n        sample: {:?},\n        \
         setpoint_weights: [{}, {}],\n        derivative_of: fvi_core::DerivativeOf::{of},\n        \
         derivative_filter: fvi_core::DerivativeFilter::{filter},\n        limits: [{}, {}],\n        \
         rate_limit: {},\n        anti_windup: fvi_core::AntiWindup::{windup},\n        \
         bumpless: fvi_core::Bumpless::{bumpless},\n    }})\n}}\n",
        settings.integral_order,
        settings.derivative_order,
        settings.sample,
        number(b),
        number(c),
        number(lower),
        number(upper),
        number(settings.rate_limit),
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exponentials::exponential_table::ENDLESS;

    fn settings(gains: PidGains<f32>) -> PidSettings<f32> {
        PidSettings { integral_order: 0.9, derivative_order: 0.8, ..PidSettings::new(gains, 1e-3) }
    }

    const FULL: PidGains<f32> = PidGains::Parallel { proportional: 8.0, integral: 4.0, derivative: 0.1 };

    #[test]
    fn the_source_has_what_a_struct_names() {
        let source = controller_source("two_axes", &settings(FULL), 100_000_000, 1e-7).unwrap();
        for passage in [
            "pub const TWO_AXES_INTEGRAL: fvi_core::ExponentialTable<&[f32]>",
            "pub const TWO_AXES_DERIVATIVE: fvi_core::ExponentialTable<&[f32]>",
            "pub fn two_axes_law()",
            "proportional: 8.0, integral: 4.0, derivative: 0.1",
            "sample: Some(0.001)",
            "limits: [f32::NEG_INFINITY, f32::INFINITY]",
            "bumpless: fvi_core::Bumpless::Whole",
            "pub type TwoAxesPid<L = fvi_core::PidLaw<f32>> = ",
            "pub fn new_two_axes() -> Result<TwoAxesPid, ",
            "pub fn two_axes_with<L: ",
        ] {
            assert!(source.contains(passage), "no {passage} in\n{source}");
        }
        // Numbers in the precision of the settings; tables without a horizon on request.
        let gains = PidGains::Parallel { proportional: 0.1, integral: 4.0, derivative: 0.0 };
        let source = controller_source::<f64>("a", &PidSettings::new(gains, 0.5), ENDLESS, 1e-12).unwrap();
        assert!(source.contains("proportional: 0.1, ") && source.contains("::ENDLESS"), "{source}");
        // Without a derivative there is no memory for it.
        assert!(source.contains("fvi_core::Memoryless<f64>") && !source.contains("DERIVATIVE"), "{source}");
        let filter = DerivativeFilter::Fractional { time: 0.1, order: 0.7 };
        let filtered = PidSettings { derivative_filter: filter, ..settings(FULL) };
        let source = controller_source("a", &filtered, 1000, 1e-7).unwrap();
        assert!(source.contains("A_FILTER") && source.contains("with_parts(law"), "{source}");
    }

    #[test]
    fn what_makes_no_controller_is_refused() {
        let refused = |name: &str, settings: PidSettings<f32>, horizon, tolerance| {
            controller_source(name, &settings, horizon, tolerance).unwrap_err().to_string()
        };
        let fine = settings(FULL);
        for (message, said) in [
            (refused("2nd", fine, 1000, 1e-7), "`2nd`"),
            (refused("a-b", fine, 1000, 1e-7), "`a-b`"),
            (refused("", fine, 1000, 1e-7), "``"),
            (refused("a", PidSettings { integral_order: 2.0, ..fine }, 1000, 1e-7), "integral order = 2 "),
            (refused("a", PidSettings { sample: None, ..fine }, 1000, 1e-7), "sample time"),
            (refused("a", fine, 0, 1e-7), "horizon"),
            (refused("a", fine, 1000, 1.0), "tolerance"),
        ] {
            assert!(message.contains(said), "no {said} in {message}");
        }
    }
}
