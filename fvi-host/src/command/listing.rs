//! Weights and exponentials as text: tables, and constants for firmware.

use super::CommandError;
use crate::exponential_table::ExponentialKernel;
use crate::files::write_text;
use fvi_core::{ParameterError, Real};
use std::fmt::LowerExp;
use std::io::Write;
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

/// Writes the text to standard output, or to a file that appears whole or not at all.
pub(super) fn emit(text: &str, file: Option<&Path>) -> Result<(), CommandError> {
    let written = match file {
        None => std::io::stdout().lock().write_all(text.as_bytes()),
        Some(path) => return Ok(write_text(path, text)?),
    };
    match written {
        // The reader has seen enough, as in `fvi weights … | head`.
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        written => written.map_err(|error| CommandError::Failed(format!("standard output: {error}"))),
    }
}

/// Weights w₀, w₁, …
pub(super) fn weights_listing(weights: &[f64], origin: &str, format: ListingFormat) -> String {
    let count = weights.len();
    match format {
        ListingFormat::Csv => {
            let rows = weights.iter().enumerate().map(|(n, weight)| format!("{n},{weight:.16e}\n"));
            std::iter::once("n,weight\n".to_string()).chain(rows).collect()
        }
        ListingFormat::Rust => format!(
            "/// Convolution-quadrature weights: {origin}.\npub const WEIGHTS: [f64; {count}] = [\n{}];\n",
            rows(weights, "    ", "")
        ),
        ListingFormat::C => format!(
            "/* Convolution-quadrature weights: {origin}. */\n#define FVI_WEIGHTS {count}\n\
             static const double fvi_weights[FVI_WEIGHTS] = {{\n{}}};\n",
            rows(weights, "    ", "")
        ),
    }
}

/// Matrix weights W₀, W₁, … of R stages, given plane by plane: entry (i, j) of W_n at (i·R + j)·count + n, as constants keep them.
pub(super) fn matrix_weights_listing(
    planes: &[f64],
    stages: usize,
    origin: &str,
    format: ListingFormat,
) -> String {
    let count = planes.len() / (stages * stages);
    match format {
        ListingFormat::Csv => {
            let entries = (0..count).flat_map(|n| (0..stages * stages).map(move |plane| (n, plane)));
            let row = |(n, plane): (usize, usize)| {
                let (row, column) = (plane / stages, plane % stages);
                format!("{n},{row},{column},{:.16e}\n", planes[plane * count + n])
            };
            std::iter::once("n,row,column,weight\n".to_string()).chain(entries.map(row)).collect()
        }
        ListingFormat::Rust | ListingFormat::C => {
            let layout = format!("{origin}; entry (i, j) of weight n at (i*{stages} + j)*{count} + n");
            weights_listing(planes, &layout, format)
        }
    }
}

/// A head of weights and exponentials.
pub(super) fn exponentials_listing(
    kernel: &ExponentialKernel,
    origin: &str,
    format: ListingFormat,
    precision: ListingPrecision,
) -> String {
    match (format, precision) {
        (ListingFormat::Csv, _) => exponentials_csv(kernel),
        (ListingFormat::Rust, ListingPrecision::F64) => exponentials_rust::<f64>(kernel, origin, "f64"),
        (ListingFormat::Rust, ListingPrecision::F32) => exponentials_rust::<f32>(kernel, origin, "f32"),
        (ListingFormat::C, ListingPrecision::F64) => exponentials_c::<f64>(kernel, origin, "double"),
        (ListingFormat::C, ListingPrecision::F32) => exponentials_c::<f32>(kernel, origin, "float"),
    }
}

fn exponentials_csv(kernel: &ExponentialKernel) -> String {
    let comments = format!(
        "# head = {}\n# horizon = {}\n# tolerance = {:e}\nrate,coefficient\n",
        kernel.head().len(),
        kernel.horizon(),
        kernel.tolerance(),
    );
    let rows = kernel.exponentials().iter().map(|e| format!("{:.16e},{:.16e}\n", e.rate, e.coefficient));
    std::iter::once(comments).chain(rows).collect()
}

fn exponentials_rust<T: Real + LowerExp>(kernel: &ExponentialKernel, origin: &str, scalar: &str) -> String {
    let table = kernel.table::<T>();
    format!(
        "/// {origin}: {} weights, then {} exponentials; tolerance {:e}.\n\
         ///\n/// `fvi_core::ExponentialSum` takes it, with `TABLE.state_len(channels)` numbers of state.\n\
         pub const TABLE: fvi_core::ExponentialTable<&[{scalar}]> = fvi_core::ExponentialTable {{\n    \
         stages: 1,\n    head: &[\n{}    ],\n    exponentials: &[\n{}    ],\n    slow_blocks: {},\n    horizon: {},\n}};\n",
        kernel.head().len(),
        kernel.exponentials().len(),
        kernel.tolerance(),
        rows(table.head.as_ref(), "        ", ""),
        rows(table.exponentials.as_ref(), "        ", ""),
        table.slow_blocks,
        table.horizon,
    )
}

fn exponentials_c<T: Real + LowerExp>(kernel: &ExponentialKernel, origin: &str, scalar: &str) -> String {
    let table = kernel.table::<T>();
    let (head, exponentials) = (table.head.as_ref(), table.exponentials.as_ref());
    let suffix = if scalar == "float" { "f" } else { "" };
    let array = |name: &str, length: &str, numbers: &[T]| match numbers {
        // C has no arrays without elements.
        [] => String::new(),
        _ => format!("static const {scalar} {name}[{length}] = {{\n{}}};\n", rows(numbers, "    ", suffix)),
    };
    format!(
        "/* {origin}: tolerance {:e}. The exponentials in blocks of four decays and four coefficients, as fvi.h takes them. */\n\
         #define FVI_HEAD {}\n#define FVI_EXPONENTIALS {}\n#define FVI_SLOW_BLOCKS {}\n#define FVI_HORIZON {}U\n{}{}",
        kernel.tolerance(),
        head.len(),
        exponentials.len(),
        table.slow_blocks,
        kernel.horizon(),
        array("fvi_head", "FVI_HEAD", head),
        array("fvi_exponentials", "FVI_EXPONENTIALS", exponentials),
    )
}

/// Numbers in rows of four, each with the digits that bring the same number back, and a suffix.
fn rows<T: LowerExp>(numbers: &[T], indent: &str, suffix: &str) -> String {
    numbers
        .chunks(4)
        .map(|row| {
            let row: Vec<String> = row.iter().map(|number| format!("{number:e}{suffix}")).collect();
            format!("{indent}{},\n", row.join(", "))
        })
        .collect()
}
