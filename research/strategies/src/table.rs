//! The table of a record: `strategies.csv`.

use crate::front::break_even;
use crate::record::Record;

/// Columns of `strategies.csv`.
const COLUMNS: [&str; 16] = [
    "strategy",
    "kernel",
    "length",
    "channels",
    "precision",
    "tolerance",
    "error_u",
    "mean_ns",
    "p50_ns",
    "p999_ns",
    "worst_ns",
    "setup_ns",
    "total_ns",
    "break_even",
    "bytes",
    "flops",
];

/// `strategies.csv`: one row for each strategy in each race; empty are break-even lengths of those
/// beyond the tolerance, bytes that are not known, and flops that are not counted.
pub(crate) fn table(record: &Record) -> Result<String, csv::Error> {
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(COLUMNS)?;
    for race in &record.races {
        for row in &race.rows {
            table.write_record([
                row.strategy.clone(),
                race.kernel.clone(),
                race.length.to_string(),
                race.channels.to_string(),
                race.precision.name().to_owned(),
                format!("{:e}", race.tolerance),
                if row.error_u < 1e6 {
                    format!("{:.4}", row.error_u)
                } else {
                    format!("{:.4e}", row.error_u)
                },
                format!("{:.3}", row.mean_ns),
                format!("{:.0}", row.p50_ns),
                format!("{:.0}", row.p999_ns),
                format!("{:.0}", row.worst_ns),
                format!("{:.0}", row.setup_ns),
                format!("{:.0}", row.total_ns),
                break_even(race, row).map_or_else(String::new, |steps| format!("{steps:.0}")),
                row.bytes.map_or_else(String::new, |bytes| bytes.to_string()),
                row.flops.map_or_else(String::new, |flops| format!("{flops:.2}")),
            ])?;
        }
    }
    let bytes = table.into_inner().map_err(|error| csv::Error::from(error.into_error()))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}
