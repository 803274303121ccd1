//! `kernel = { relaxation = [["G00.csv", "G01.csv"], …] }`: a relaxation function for each pair of
//! coordinates.

use super::kernel::relaxation_of;
use crate::language::document::{Table, Value};
use crate::language::error::{InputError, Problem};
use fvi_fft::dense::symmetric_eigenvalues;
use fvi_fft::transfer::relaxation::Frequencies;
use fvi_fft::transfer::{Active, TransferFunction};
use nalgebra::{Complex, DMatrix};
use serde::Serialize;

/// Retardation functions between coordinates, as in Cummins' equation: the force on coordinate i is
/// −Σ_j ∫ G_ij(t − τ) q̇_j(τ) dτ. G is symmetric.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RelaxationMatrix {
    /// The files, row by row; empty for a pair without coupling.
    #[serde(rename = "relaxation")]
    pub files: Vec<Vec<String>>,
    /// The time constant after the last rows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decay: Option<f64>,
    /// The region where it is not passive.
    #[serde(skip)]
    pub active: Option<Active>,
}

/// K_ij of a pair of coordinates, i ≤ j, and −K_ij.
pub(super) type Pair = ((usize, usize), [TransferFunction; 2]);

impl RelaxationMatrix {
    /// True if the value of `relaxation` has this form: rows with names of files.
    pub(super) fn is_one(value: &Value<'_>) -> bool {
        let has_text =
            |row: &Value<'_>| row.is_list() && row.list("").is_ok_and(|row| row.iter().any(Value::is_text));
        value.is_list() && value.list("").is_ok_and(|rows| rows.iter().any(has_text))
    }

    /// Reads the kernel of a scenario with `count` coordinates, with K_ij of each coupled pair.
    pub(super) fn read(
        table: &Table<'_>,
        value: &Value<'_>,
        count: usize,
    ) -> Result<(Self, Vec<Pair>), InputError> {
        table.allow(&["relaxation", "decay"])?;
        let decay = table.optional("decay").map(|decay| decay.positive()).transpose()?;
        let rows = value.list("rows of names of files")?;
        let shape = |place: &Value<'_>, found: usize| {
            place.error(Problem::WrongShape {
                expected: format!("{count} entries, one for each coordinate"),
                found: found.to_string(),
            })
        };
        if rows.len() != count {
            return Err(shape(value, rows.len()));
        }
        let mut pairs: Vec<Pair> = Vec::new();
        let mut files = vec![vec![String::new(); count]; count];
        for (i, row) in rows.iter().enumerate() {
            let entries = row.list("names of files")?;
            if entries.len() != count {
                return Err(shape(row, entries.len()));
            }
            for (j, entry) in entries.iter().enumerate() {
                let couples = entry.is_text() && !entry.text()?.is_empty();
                let both = || {
                    Ok([relaxation_of(entry, decay, Some(1.0))?, relaxation_of(entry, decay, Some(-1.0))?])
                };
                if !entry.is_text() && entry.number()? != 0.0 {
                    return Err(entry.out_of_range("the name of a file, or \"\" where nothing couples"));
                }
                let transfers = if couples { Some(both()?) } else { None };
                if let Some([transfer, _]) = &transfers {
                    files[i][j] = transfer.text().unwrap_or_default().to_owned();
                }
                if i <= j {
                    pairs.extend(transfers.map(|transfers| ((i, j), transfers)));
                    continue;
                }
                let other =
                    pairs.iter().find(|(pair, _)| *pair == (j, i)).map(|(_, other)| other[0].numbers());
                if transfers.as_ref().map(|transfers| transfers[0].numbers()) != other {
                    return Err(entry.out_of_range(format!(
                        "the numbers of entry [{j}][{i}]: the matrix is symmetric, as that of waves is without forward speed"
                    )));
                }
            }
        }
        if pairs.is_empty() {
            return Err(value.out_of_range("one file at least"));
        }
        let active = look_for_activity(&pairs, count);
        Ok((Self { files, decay, active }, pairs))
    }
}

/// The lowest band of frequencies at which Re R(iω) = Im K(iω)/ω has an eigenvalue below zero.
fn look_for_activity(pairs: &[Pair], count: usize) -> Option<Active> {
    let resistance = |omega: f64| {
        let mut matrix = DMatrix::zeros(count, count);
        let mut size = 0.0;
        for ((i, j), [transfer, _]) in pairs {
            let value = transfer.value(Complex::new(0.0, omega)) + transfer.spring();
            (matrix[(*i, *j)], matrix[(*j, *i)]) = (value.im, value.im);
            size += value.norm_sqr();
        }
        symmetric_eigenvalues(matrix).min() / f64::sqrt(size)
    };
    let tables = pairs.iter().map(|(_, [transfer, _])| transfer.numbers());
    Frequencies::of(tables).look_for_activity(resistance)
}
