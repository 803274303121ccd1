//! `kernel = { relaxation = [["G00.csv", "G01.csv"], …] }`: a relaxation function for each pair of
//! coordinates.

use super::kernel::relaxation_of;
use crate::language::document::{Table, Value};
use crate::language::error::{InputError, Problem};
use fvi_core::min_or_nan;
use fvi_fft::dense::symmetric_eigenvalues;
use fvi_fft::transfer::Active;
use fvi_fft::transfer::TransferFunction;
use nalgebra::{Complex, DMatrix};
use serde::Serialize;
use std::f64::consts::PI;

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

/// The lowest band of frequencies at which Re R(iω) = Im K(iω)/ω has an eigenvalue below zero, from a
/// hundredth of the inverse of the longest time to a hundred times that of the shortest difference of times.
fn look_for_activity(pairs: &[Pair], count: usize) -> Option<Active> {
    const PER_DECADE: f64 = 40.0;
    const ROUNDING: f64 = -1e-9;
    let (mut longest, mut shortest) = (0.0_f64, f64::INFINITY);
    for (_, [transfer, _]) in pairs {
        let times: Vec<f64> = transfer.numbers().iter().step_by(2).copied().collect();
        longest = longest.max(times.last().copied().unwrap_or(0.0));
        shortest = times.windows(2).map(|pair| pair[1] - pair[0]).fold(shortest, min_or_nan);
    }
    if longest == 0.0 {
        return None;
    }
    let resistance = |logarithm: f64| {
        let omega = libm::exp10(logarithm);
        let mut matrix = DMatrix::zeros(count, count);
        let mut size = 0.0;
        for ((i, j), [transfer, _]) in pairs {
            let value = transfer.value(Complex::new(0.0, omega)) + transfer.spring();
            (matrix[(*i, *j)], matrix[(*j, *i)]) = (value.im, value.im);
            size += value.norm_sqr();
        }
        symmetric_eigenvalues(matrix).min() / f64::sqrt(size)
    };
    let (first, last) = (libm::log10(0.01 / longest), libm::log10(100.0 * PI / shortest));
    let places = ((last - first) * PER_DECADE).ceil() as usize;
    let at = |k: usize| first + k as f64 / PER_DECADE;
    let mut looks: Vec<(f64, f64)> = (0..=places).map(|k| (at(k), resistance(at(k)))).collect();
    let mut grounds = Vec::new();
    for looks in looks.windows(3) {
        if looks[1].1 <= looks[0].1 && looks[1].1 <= looks[2].1 && looks[1].1 < 0.1 && looks[1].1 >= ROUNDING
        {
            // A minimum: golden-section search.
            let (mut low, mut high) = (looks[0].0, looks[2].0);
            for _ in 0..16 {
                let (left, right) = (high - 0.618 * (high - low), low + 0.618 * (high - low));
                if resistance(left) < resistance(right) { high = right } else { low = left }
            }
            grounds.push((0.5 * (low + high), resistance(0.5 * (low + high))));
        }
    }
    looks.extend(grounds);
    looks.sort_by(|one, other| one.0.total_cmp(&other.0));
    let drives = |look: &(f64, f64)| look.1 < ROUNDING;
    let begin = looks.iter().position(drives)?;
    let end = looks[begin..].iter().take_while(|look| drives(look)).count() + begin;
    let worst = looks[begin..end].iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(Active {
        place: Complex::new(0.0, libm::exp10(worst.0)),
        resistance: worst.1,
        from: (begin > 0).then(|| libm::exp10(looks[begin].0)),
        to: (end < looks.len()).then(|| libm::exp10(looks[end - 1].0)),
    })
}
