//! Tables of exponentials as Rust constants.

use crate::exponentials::exponential_table::{ENDLESS, ExponentialKernel};
use fvi_core::Real;
use std::fmt::LowerExp;

/// True if a constant of Rust and C may have this name: letters, digits and underscores, beginning with a
/// letter.
pub fn is_identifier(name: &str) -> bool {
    let mut characters = name.chars();
    let begins = characters.next().is_some_and(|first| first.is_ascii_alphabetic());
    begins && characters.all(|character| character.is_ascii_alphanumeric() || character == '_')
}

/// True if all numbers of a table are finite in the precision of T, and none that is not zero underflows to
/// zero.
pub fn table_fits<T: Real>(kernel: &ExponentialKernel) -> bool {
    let smallest = T::SMALLEST_NORMAL.to_f64();
    let coefficients = kernel.exponentials().iter().map(|exponential| exponential.coefficient);
    let mut numbers = kernel.head().iter().copied().chain(coefficients);
    numbers.all(|number| {
        let held = T::of(number).to_f64();
        number == 0.0 || held.is_finite() && held.abs() >= smallest
    })
}

/// When a memory on the table ends, in words, with `step` units of time between samples; nothing where it
/// does not.
pub fn end_of(kernel: &ExponentialKernel, step: f64) -> Option<String> {
    let ends = kernel.horizon() != ENDLESS && !kernel.exponentials().is_empty();
    ends.then(|| {
        let samples = kernel.horizon();
        let time = format!(", {} units of time", samples as f64 * step);
        // A table with a step of 1 is one for any step.
        format!("ends after {samples} samples{}", if step == 1.0 { "" } else { &time })
    })
}

/// The constant `name`, an [`ExponentialTable`](fvi_core::ExponentialTable) of `f32` or `f64`; `origin` is
/// part of its documentation.
pub fn table_constant<T: Real + LowerExp>(kernel: &ExponentialKernel, origin: &str, name: &str) -> String {
    let (table, scalar) = (kernel.table::<T>(), scalar::<T>());
    let name = name.to_ascii_uppercase();
    let horizon = match kernel.horizon() {
        ENDLESS => "fvi_core::ExponentialTable::<()>::ENDLESS".to_owned(),
        horizon => horizon.to_string(),
    };
    let end = match end_of(kernel, kernel.step_size()) {
        Some(end) => format!("/// A memory on it {end}: it refuses further ones, or forgets.\n///\n"),
        None => String::new(),
    };
    format!(
        "/// {origin}: {} weights, then {} exponentials; tolerance {:e}.\n///\n{end}\
         /// `fvi_core::Kernel::exponential_sum` takes it, with \
         `{name}.state_len(channels)` numbers of state.\n\
         pub const {name}: fvi_core::ExponentialTable<&[{scalar}]> = fvi_core::ExponentialTable {{\n    \
         stages: 1,\n    head: &[\n{}    ],\n    exponentials: &[\n{}    ],\n    slow_blocks: {},\n    \
         far_blocks: {},\n    horizon: {horizon},\n    step_size: {:?},\n}};\n",
        kernel.head().len(),
        kernel.exponentials().len(),
        kernel.tolerance(),
        rows(table.head.as_ref(), "        ", ""),
        rows(table.exponentials.as_ref(), "        ", ""),
        table.slow_blocks,
        table.far_blocks,
        table.step_size,
    )
}

/// Name of the scalar: `f32` or `f64`.
pub(crate) fn scalar<T: Real>() -> &'static str {
    if T::BYTES == f32::BYTES { "f32" } else { "f64" }
}

/// Numbers in rows of four, each with enough digits to restore the same number, and a suffix.
pub fn rows<T: LowerExp>(numbers: &[T], indent: &str, suffix: &str) -> String {
    numbers
        .chunks(4)
        .map(|row| {
            let row: Vec<String> = row.iter().map(|number| format!("{number:e}{suffix}")).collect();
            format!("{indent}{},\n", row.join(", "))
        })
        .collect()
}
