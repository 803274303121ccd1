//! Weights and exponentials as text: tables, and constants for firmware.

use super::CommandError;
use super::terminal::{mention, output};
use fvi_core::{ParameterError, RateTable, Real};
use fvi_fft::exponentials::exponential_table::{ENDLESS, ExponentialKernel};
use fvi_fft::exponentials::rust_constants::{end_of, is_identifier, rows, table_constant, table_fits};
use fvi_host::results::files::write_out;
use std::fmt::LowerExp;
use std::io::{self, Write};
use std::path::Path;

/// How numbers are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum ListingFormat {
    /// Comma-separated columns under a header, 17 significant digits
    #[default]
    Csv,
    /// Constants of Rust
    Rust,
    /// Constants of C
    C,
}

impl ListingFormat {
    /// The precision of the numbers, where the user has asked for this one or for none: a table in CSV is in
    /// double precision, and constants of C are those of fvi.h.
    pub(super) fn precision(self, asked: Option<ListingPrecision>) -> ListingPrecision {
        match (self, asked) {
            (Self::Csv, _) | (Self::Rust, None) => ListingPrecision::F64,
            (Self::C, None) => ListingPrecision::F32,
            (_, Some(precision)) => precision,
        }
    }
}

/// Precision of constants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum ListingPrecision {
    /// Double
    #[default]
    F64,
    /// Single
    F32,
}

/// An argument outside its range.
pub(super) fn parameter_error(error: ParameterError) -> CommandError {
    CommandError::Argument(error)
}

/// Checks that a name is an identifier both in Rust and in C.
pub(super) fn identifier(text: &str) -> Result<String, String> {
    if is_identifier(text) {
        return Ok(text.to_owned());
    }
    Err("a name has letters, digits and underscores, and begins with a letter".to_owned())
}

/// Writes a listing to standard output, or to the path given by the user.
pub(super) fn emit(
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    file: Option<&Path>,
) -> Result<(), CommandError> {
    match file {
        None => output(content),
        Some(path) => Ok(write_out(path, content)?),
    }
}

/// Says on standard error when a memory on listed tables ends, if it does.
pub(super) fn mention_end(end: Option<&str>) {
    if let Some(end) = end {
        mention(&format!("note: a memory on this table {end}\n"));
    }
}

/// Writes `count` weights w₀, w₁, … one by one, since all of them may not fit into memory.
pub(super) fn write_weights(
    out: &mut dyn Write,
    weights: impl Iterator<Item = f64>,
    count: usize,
    (origin, name): (&str, Option<&str>),
    (format, precision): (ListingFormat, ListingPrecision),
) -> io::Result<()> {
    let single = precision == ListingPrecision::F32;
    let (head, end) = match format {
        ListingFormat::Csv => ("n,weight\n".to_owned(), ""),
        ListingFormat::Rust => {
            let name = name.unwrap_or("WEIGHTS").to_ascii_uppercase();
            let doc = format!("/// Convolution-quadrature weights: {origin}.");
            let scalar = if single { "f32" } else { "f64" };
            (format!("{doc}\npub const {name}: [{scalar}; {count}] = [\n"), "];\n")
        }
        ListingFormat::C => {
            let (small, large) = names_of_c(name);
            let scalar = if single { "float" } else { "double" };
            let constants = format!(
                "/* Convolution-quadrature weights: {origin}. */\n#define {large}_WEIGHTS {count}\n\
                 static const {scalar} {small}_weights[{large}_WEIGHTS] = {{\n"
            );
            (constants, "};\n")
        }
    };
    out.write_all(head.as_bytes())?;
    for (n, weight) in weights.take(count).enumerate() {
        match format {
            ListingFormat::Csv => writeln!(out, "{n},{weight:.16e}")?,
            // Constants: four numbers in a row.
            _ => {
                let (before, after) = (if n % 4 == 0 { "    " } else { " " }, n % 4 == 3 || n + 1 == count);
                let end = if after { "\n" } else { "" };
                match (single, format) {
                    (true, ListingFormat::C) => write!(out, "{before}{:e}f,{end}", weight as f32)?,
                    (true, _) => write!(out, "{before}{:e},{end}", weight as f32)?,
                    (false, _) => write!(out, "{before}{weight:e},{end}")?,
                }
            }
        }
    }
    out.write_all(end.as_bytes())
}

/// Writes matrix weights W₀, W₁, … of R stages, given plane by plane: entry (i, j) of W_n at
/// (i·R + j)·count + n, as constants keep them.
pub(super) fn write_matrix_weights(
    out: &mut dyn Write,
    planes: &[f64],
    stages: usize,
    (origin, name): (&str, Option<&str>),
    form: (ListingFormat, ListingPrecision),
) -> io::Result<()> {
    let count = planes.len() / (stages * stages);
    if form.0 != ListingFormat::Csv {
        let layout = format!("{origin}; entry (i, j) of weight n at (i*{stages} + j)*{count} + n");
        return write_weights(out, planes.iter().copied(), planes.len(), (&layout, name), form);
    }
    out.write_all(b"n,row,column,weight\n")?;
    for n in 0..count {
        for (place, plane) in planes.chunks(count).enumerate() {
            writeln!(out, "{n},{},{},{:.16e}", place / stages, place % stages, plane[n])?;
        }
    }
    Ok(())
}

/// Refuses a table with a number that overflows, or underflows to zero, in the precision of the listing.
pub(super) fn check_exponentials(
    kernel: &ExponentialKernel,
    step: f64,
    precision: ListingPrecision,
) -> Result<(), CommandError> {
    let fits = match precision {
        ListingPrecision::F64 => table_fits::<f64>(kernel),
        ListingPrecision::F32 => table_fits::<f32>(kernel),
    };
    let allowed = match precision {
        ListingPrecision::F64 => {
            "a step and a horizon whose weights, from h^−exponent in size, double precision holds"
        }
        ListingPrecision::F32 => {
            "a step and a horizon whose weights, from h^−exponent in size, single precision holds"
        }
    };
    if fits {
        return Ok(());
    }
    Err(parameter_error(ParameterError { parameter: "step", value: step, allowed }))
}

/// Writes a table of leading weights and exponentials.
pub(super) fn exponentials_listing(
    kernel: &ExponentialKernel,
    said: (&str, Option<&str>),
    format: ListingFormat,
    precision: ListingPrecision,
) -> String {
    let (origin, name) = (said.0, said.1.unwrap_or("TABLE"));
    match (format, precision) {
        (ListingFormat::Csv, _) => exponentials_csv(kernel),
        (ListingFormat::Rust, ListingPrecision::F64) => table_constant::<f64>(kernel, origin, name),
        (ListingFormat::Rust, ListingPrecision::F32) => table_constant::<f32>(kernel, origin, name),
        (ListingFormat::C, ListingPrecision::F64) => exponentials_c::<f64>(kernel, said, "double"),
        (ListingFormat::C, ListingPrecision::F32) => exponentials_c::<f32>(kernel, said, "float"),
    }
}

/// Prefixes of names in C: of objects, and of macros.
fn names_of_c(name: Option<&str>) -> (String, String) {
    let name = name.unwrap_or("fvi");
    (name.to_ascii_lowercase(), name.to_ascii_uppercase())
}

/// The horizon of a table as text of a 64-bit constant.
fn horizon_text(kernel: &ExponentialKernel) -> String {
    if kernel.horizon() == ENDLESS { "endless".to_owned() } else { kernel.horizon().to_string() }
}

fn exponentials_csv(kernel: &ExponentialKernel) -> String {
    let comments = format!(
        "# head = {}\n# horizon = {}\n# step = {}\n# tolerance = {:e}\nrate,coefficient\n",
        kernel.head().len(),
        horizon_text(kernel),
        kernel.step_size(),
        kernel.tolerance(),
    );
    let rows = kernel.exponentials().iter().map(|e| format!("{:.16e},{:.16e}\n", e.rate, e.coefficient));
    std::iter::once(comments).chain(rows).collect()
}

fn exponentials_c<T: Real + LowerExp>(
    kernel: &ExponentialKernel,
    (origin, name): (&str, Option<&str>),
    scalar: &str,
) -> String {
    let table = kernel.table::<T>();
    let (small, large) = names_of_c(name);
    let (head, exponentials) = (table.head.as_ref(), table.exponentials.as_ref());
    let suffix = if scalar == "float" { "f" } else { "" };
    let array = |name: &str, length: &str, numbers: &[T]| match numbers {
        // C has no empty arrays.
        [] => String::new(),
        _ => format!("static const {scalar} {name}[{length}] = {{\n{}}};\n", rows(numbers, "    ", suffix)),
    };
    let (pointer, horizon) = match (exponentials, kernel.horizon()) {
        ([], _) => ("NULL".to_owned(), "FVI_ENDLESS".to_owned()),
        (_, ENDLESS) => (format!("{small}_exponentials"), "FVI_ENDLESS".to_owned()),
        // In C, as in fvi.h, an integer of 64 bits on every processor.
        (_, horizon) => (format!("{small}_exponentials"), format!("UINT64_C({horizon})")),
    };
    // The types of fvi.h are in single precision.
    let memory = if scalar == "float" {
        format!(
            "/* The members of FviMemory that the table gives; the kind may be or-ed with flags, and the buffer has\n   \
             {large}_NUMBERS(channels) numbers. */\n\
             #define {large}_TABLE \\\n    .kind = FVI_EXPONENTIAL_SUM{}, .scale = 1.0f, .weights = {small}_head, \
             .weight_count = {large}_HEAD, \\\n    .exponentials = {pointer}, .exponential_count = {large}_EXPONENTIALS, \
             .slow_blocks = {large}_SLOW_BLOCKS, \\\n    .far_blocks = {large}_FAR_BLOCKS, .horizon = {large}_HORIZON, \
             .step_size = {large}_STEP\n",
            if kernel.on_increments() { " | FVI_ON_INCREMENTS" } else { "" },
        )
    } else {
        String::new()
    };
    let end = match end_of(kernel, kernel.step_size()) {
        Some(end) => format!(
            " A memory on it {end}:\n   it refuses further ones, or forgets with FVI_FORGET_PAST_HORIZON."
        ),
        None => String::new(),
    };
    format!(
        "/* {origin}: tolerance {:e}. The exponentials in blocks of four decays and four coefficients, as fvi.h takes them.{end} */\n\
         #define {large}_HEAD {}\n#define {large}_EXPONENTIALS {}\n#define {large}_SLOW_BLOCKS {}\n#define {large}_FAR_BLOCKS {}\n\
         #define {large}_HORIZON {horizon}\n#define {large}_STEP {:e}\n\
         #define {large}_NUMBERS(channels) \\\n    FVI_EXPONENTIAL_NUMBERS({large}_HEAD, {large}_EXPONENTIALS, \
         {large}_FAR_BLOCKS, channels)\n{}{}{memory}",
        kernel.tolerance(),
        head.len(),
        exponentials.len(),
        table.slow_blocks,
        table.far_blocks,
        kernel.step_size(),
        array(&format!("{small}_head"), &format!("{large}_HEAD"), head),
        array(&format!("{small}_exponentials"), &format!("{large}_EXPONENTIALS"), exponentials),
    )
}

/// A table for steps of any length: rates λ and coefficients c of s^−μ ≈ Σ c/(s + λ),
/// μ = ⌈exponent⌉ − exponent, or of K(s)/s^d, d = ⌈exponent⌉, for another kernel.
pub(super) fn rates_csv<T: Real + LowerExp>(table: &RateTable<&[T]>, origin: &str, tolerance: f64) -> String {
    let sum = match table.leading.is_empty() {
        true => format!("# K(s)/s^{} = sum of coefficient/(s + rate)\n", table.exponent.ceil()),
        false => String::new(),
    };
    let comments = format!(
        "# {origin}\n{sum}# shortest step = {:e}\n# horizon = {:e}\n# tolerance = {tolerance:e}\nrate,coefficient\n",
        table.shortest, table.horizon,
    );
    // Zero coefficients only pad the last block.
    let pairs = table.rates.iter().zip(table.coefficients).filter(|(_, c)| **c != T::zero());
    let rows = pairs.map(|(rate, coefficient)| format!("{rate:.16e},{coefficient:.16e}\n"));
    std::iter::once(comments).chain(rows).collect()
}

/// The same table as a constant in Rust.
pub(super) fn rates_rust<T: Real + LowerExp>(
    table: &RateTable<&[T]>,
    (origin, name): (&str, Option<&str>),
    tolerance: f64,
    scalar: &str,
) -> String {
    let name = name.unwrap_or("TABLE").to_ascii_uppercase();
    format!(
        "/// {origin}: {} rates for steps from {:e} on and times up to {:e}; tolerance {tolerance:e}.\n///\n\
         /// `fvi_core::VariableStepMemory` takes it, with \
         `{name}.state_len(coordinates, stages)` numbers of state.\n\
         pub const {name}: fvi_core::RateTable<&[{scalar}]> = fvi_core::RateTable {{\n    exponent: {:?},\n    \
         leading: &[\n{}    ],\n    rates: &[\n{}    ],\n    coefficients: &[\n{}    ],\n    shortest: {:?},\n    \
         horizon: {:?},\n}};\n",
        table.rates.len(),
        table.shortest,
        table.horizon,
        table.exponent,
        rows(table.leading, "        ", ""),
        rows(table.rates, "        ", ""),
        rows(table.coefficients, "        ", ""),
        table.shortest,
        table.horizon,
    )
}
