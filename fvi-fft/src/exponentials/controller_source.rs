//! A fractional PID controller as Rust source: its tables, its law, a type and a constructor.

use crate::exponentials::band_table::{BandErrors, band_table, check};
use crate::exponentials::exponential_table::{ExponentialKernel, ExponentialKernelError};
use crate::exponentials::rust_constants::{end_of, is_identifier, scalar, table_constant, table_fits};
use crate::transfer::TransferFunction;
use fvi_core::{
    ActsOn, AntiWindup, BdfOrder, Bumpless, DerivativeFilter, DerivativeOf, Kernel, Memory as _,
    ParameterError, PidConstants, PidGains, PidLaw, PidSettings, Real, Sealing,
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
pub fn controller_source<T: Sealing + LowerExp>(
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
pub fn source_with_tables<T: Sealing + LowerExp>(
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
    let mut parts = vec![("integral", integral, &tables.integral, law.integral_kernel()?)];
    if differentiates {
        parts.push(("derivative", derivative, &tables.derivative, law.derivative_kernel()?));
    }
    if let (Some(table), Some(kernel)) = (&tables.filter, law.filter_kernel()?) {
        parts.push(("filter", filter, table, kernel));
    }
    let (mut text, camel) = (String::new(), camel_case(&small));
    let mut memories = Vec::new();
    for (part, origin, table, kernel) in &parts {
        let origin = format!("{origin}{}", tables.worth(part));
        memories.push(write_memory::<T>(&mut text, name, part, &origin, (table, kernel))?);
    }
    let none = || Memory { of: format!("fvi_core::Memoryless<{scalar}>"), made: "None".to_owned(), seal: 0 };
    let mut memories = memories.into_iter();
    let integral = memories.next().unwrap_or_else(none);
    let derivative = if differentiates { memories.next() } else { None };
    let derivative = derivative.map_or_else(none, |memory| memory.some());
    let filter = memories.next().map_or_else(none, |memory| memory.some());
    write_law(&mut text, &small, law, [integral.seal, derivative.seal, filter.seal], note);
    let law_type = format!("fvi_core::PidLaw<{scalar}>");
    let end = match law.settings().sample.and_then(|sample| tables.end(sample)) {
        Some(end) => format!("It\n/// {end}: further ticks are refused."),
        None => "It has no end.".to_owned(),
    };
    let _ = write!(
        text,
        "/// The controller, with a law of its own, which can be changed, one that it borrows, or\n\
         /// [`{camel}Law`], which is compiled in. {end}\n\
         pub type {camel}Pid<L = {law_type}> = fvi_core::FractionalPid<\n    {scalar},\n    {},\n    {},\n    \
         L,\n    {},\n>;\n\n\
         /// The controller with a law of its own, before its first tick.\n///\n/// # Errors\n\
         /// None: it has been checked.\n#[inline]\n\
         pub fn new_{small}() -> Result<{camel}Pid, fvi_core::ParameterError> {{\n    \
         {small}_with({large}_LAW)\n}}\n\n\
         /// The same with this law, by value or by reference: one with other gains, one that loops\n\
         /// share, or [`{camel}Law`].\n\
         ///\n/// # Errors\n\
         /// If its orders or its sample time are others than those of the tables.\n#[inline]\n\
         pub fn {small}_with<L: core::borrow::Borrow<{law_type}>>(\n    law: L,\n\
         ) -> Result<{camel}Pid<L>, fvi_core::ParameterError> {{\n    \
         let integral = {};\n    let derivative = {};\n    let filter = {};\n    \
         fvi_core::FractionalPid::generated(&{large}_LAW, law, integral, derivative, filter)\n}}\n",
        integral.of, derivative.of, filter.of, integral.made, derivative.made, filter.made,
    );
    Ok(text)
}

/// The memory of an operator in the source: its type, the expression that makes it, its seal.
struct Memory {
    of: String,
    made: String,
    seal: u32,
}

impl Memory {
    /// The memory of an operator that a law may be without.
    fn some(self) -> Self {
        Self { made: format!("Some({})", self.made), ..self }
    }
}

/// Writes the table of an operator and the type that stands for it, and returns its memory.
fn write_memory<T: Sealing + LowerExp>(
    text: &mut String,
    name: &str,
    part: &'static str,
    origin: &str,
    (table, kernel): (&ExponentialKernel, &Kernel),
) -> Result<Memory, ControllerSourceError> {
    let scalar = scalar::<T>();
    if !table_fits::<T>(table) {
        let reason = format!("a number does not fit into {scalar}: choose a shorter horizon");
        return Err(ControllerSourceError::Table { part, reason });
    }
    let numbers = table.table::<T>();
    let view = numbers.borrow();
    let memory = kernel.exponential_sum(view, 1, vec![T::zero(); view.state_len(1)])?;
    if kernel.symbol().growth() == 0.0 {
        // The memory of an operator of order 0 has no numbers; that it has none is its seal.
        let of = format!("fvi_core::Memoryless<{scalar}>");
        return Ok(Memory { made: "fvi_core::Memoryless::new()".to_owned(), of, seal: 1 });
    }
    let (scale, acts_on) = (memory.scale(), memory.acts_on());
    let seal = T::table_seal(&view, scale, acts_on);
    *text += &table_constant::<T>(table, origin, &format!("{name}_{part}"));
    let (camel, large) =
        (camel_case(&format!("{name}_{part}").to_ascii_lowercase()), name.to_ascii_uppercase());
    let large = format!("{large}_{}", part.to_ascii_uppercase());
    let acts_on = match acts_on {
        ActsOn::Values => "Values",
        ActsOn::Increments => "Increments",
        ActsOn::Rises => "Rises",
    };
    let _ = writeln!(
        text,
        "\n/// [`{large}`] as a type, with its scale.\n#[derive(Clone, Copy, Debug)]\npub struct {camel};\n\n\
         impl fvi_core::GeneratedKernel<{scalar}> for {camel} {{\n    \
         const TABLE: fvi_core::SealedTable<{scalar}> = match fvi_core::SealedTable::<{scalar}>::new(\n        \
         {large},\n        {scale:e},\n        fvi_core::ActsOn::{acts_on},\n        {seal:#010x},\n    ) {{\n        \
         Some(table) => table,\n        \
         None => panic!(\"a constant has been edited: generate the controller again\"),\n    }};\n}}\n"
    );
    Ok(Memory {
        of: format!("fvi_core::GeneratedSum<{scalar}, {camel}, [{scalar}; {large}.state_len(1)]>"),
        made: format!("fvi_core::GeneratedSum::generated([0.0; {large}.state_len(1)])?"),
        seal,
    })
}

fn has_derivative<T: Real>(gains: &PidGains<T>) -> bool {
    match *gains {
        PidGains::Parallel { derivative, .. } => derivative != T::zero(),
        PidGains::Series { derivative_time, .. } => derivative_time != T::zero(),
    }
}

/// `two_words` as `TwoWords`.
pub(super) fn camel_case(name: &str) -> String {
    let word = |word: &str| {
        let mut letters = word.chars();
        let first = letters.next().map(|first| first.to_ascii_uppercase().to_string());
        first.unwrap_or_default() + letters.as_str()
    };
    name.split('_').map(word).collect()
}

/// Writes the law, for memories with these seals, and the type that stands for it.
fn write_law<T: Sealing>(text: &mut String, small: &str, law: &PidLaw<T>, memories: [u32; 3], note: &str) {
    let settings = law.settings();
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
    let (large, camel) = (small.to_ascii_uppercase(), camel_case(small));
    let _ = writeln!(
        text,
        "/// The law of the controller, sample {sample}{note}.\n\
         pub const {large}_LAW: fvi_core::PidLaw<{scalar}> = match fvi_core::PidLaw::<{scalar}>::sealed(\n    \
         fvi_core::PidSettings {{\n        gains: fvi_core::PidGains::{gains},\n        \
         integral_order: {:?},\n        derivative_order: {:?},\n        sample: {:?},\n        \
         setpoint_weights: [{}, {}],\n        derivative_of: fvi_core::DerivativeOf::{of},\n        \
         derivative_filter: fvi_core::DerivativeFilter::{filter},\n        limits: [{}, {}],\n        \
         rate_limit: {},\n        anti_windup: fvi_core::AntiWindup::{windup},\n        \
         bumpless: fvi_core::Bumpless::{bumpless},\n    }},",
        settings.integral_order,
        settings.derivative_order,
        settings.sample,
        number(b),
        number(c),
        number(lower),
        number(upper),
        number(settings.rate_limit),
    );
    let &PidConstants { tracking, filter_time, filter_share, step, stride } = law.constants();
    let [tracking, filter_time, filter_share, step, stride] =
        [tracking, filter_time, filter_share, step, stride].map(number);
    let _ = writeln!(
        text,
        "    fvi_core::PidConstants {{\n        tracking: {tracking},\n        filter_time: {filter_time},\n        \
         filter_share: {filter_share},\n        step: {step},\n        stride: {stride},\n    }},\n    \
         [{:#x}, {:#x}, {:#x}],\n    {:#010x},\n) {{\n    Some(law) => law,\n    \
         None => panic!(\"a constant has been edited: generate the controller again\"),\n}};\n\n\
         /// [`{large}_LAW`].\n///\n/// # Errors\n/// None: it has been checked.\n\
         pub const fn {small}_law() -> Result<fvi_core::PidLaw<{scalar}>, fvi_core::ParameterError> {{\n    \
         Ok({large}_LAW)\n}}\n\n\
         /// [`{large}_LAW`] as a type: a controller with it needs no storage for it, and only the code for\n\
         /// what it uses.\n#[derive(Clone, Copy, Debug)]\n#[allow(dead_code)]\npub struct {camel}Law;\n\n\
         impl core::borrow::Borrow<fvi_core::PidLaw<{scalar}>> for {camel}Law {{\n    #[inline(always)]\n    \
         fn borrow(&self) -> &fvi_core::PidLaw<{scalar}> {{\n        \
         const LAW: &fvi_core::PidLaw<{scalar}> = &{large}_LAW;\n        LAW\n    }}\n}}\n",
        memories[0],
        memories[1],
        memories[2],
        T::law_seal(law, memories),
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
            "pub const fn two_axes_law()",
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
        let without = PidSettings { integral_order: 0.9, ..PidSettings::new(gains, 0.5) };
        let source = controller_source::<f64>("a", &without, ENDLESS, 1e-12).unwrap();
        assert!(source.contains("proportional: 0.1, ") && source.contains("::ENDLESS"), "{source}");
        // Without a derivative there is no memory for it.
        assert!(source.contains("fvi_core::Memoryless<f64>") && !source.contains("DERIVATIVE"), "{source}");
        let filter = DerivativeFilter::Fractional { time: 0.1, order: 0.7 };
        let filtered = PidSettings { derivative_filter: filter, ..settings(FULL) };
        let source = controller_source("a", &filtered, 1000, 1e-7).unwrap();
        assert!(
            source.contains("A_FILTER") && source.contains("law, integral, derivative, filter)"),
            "{source}"
        );
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
