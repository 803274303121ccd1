//! `kernel = { relaxation = [["G00.csv", "G01.csv"], …] }`: a relaxation function for each pair of
//! coordinates.

use super::kernel::{Measured, Tolerances, read_decay, share, smallest_raise, taken_by};
use crate::language::cells::AS_WRITTEN;
use crate::language::document::{Table, Value};
use crate::language::error::{InputError, Problem};
use fvi_fft::dense::symmetric_eigenvalues;
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::relaxation::Frequencies;
use fvi_fft::transfer::{Active, TransferFunction};
use nalgebra::{Complex, DMatrix};
use serde::Serialize;
use std::collections::BTreeMap;

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
    /// By how much the files may differ from a symmetric passive matrix with a beginning and an end, by the
    /// names of the tolerances.
    #[serde(flatten)]
    pub tolerances: BTreeMap<&'static str, f64>,
    /// How the files are written: `columns`, `units`, `decimal`.
    #[serde(flatten)]
    pub written: toml::Table,
    /// Sentences on how they were amended.
    #[serde(skip)]
    pub notes: Vec<String>,
    /// The smallest rise of G_ii(0) with which it is passive, where it is not, in units of the largest |G|.
    #[serde(skip)]
    pub raise: Option<f64>,
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
        let own = ["relaxation", "decay", "begin", "end", "activity", "asymmetry"];
        table.allow(&[&own[..], &AS_WRITTEN].concat())?;
        let (decay, tolerances) = (read_decay(table)?, Tolerances::read(table)?);
        let asymmetry = table.optional("asymmetry").map(|value| share(&value)).transpose()?;
        let (files, entries) = read_entries(value, table, count)?;
        let mut entries = completed(entries, decay, tolerances)?;
        let mut notes = Vec::new();
        symmetrise(&mut entries, asymmetry, &mut notes)?;
        entries.retain(|((i, j), ..)| i <= j);
        for ((i, j), _, measured) in &mut entries {
            notes.extend(measured.notes.drain(..).map(|note| format!("entry [{i}][{j}]: {note}")));
        }
        let Some(largest) = entries.iter().map(|(.., measured)| measured.largest()).reduce(max_or_nan) else {
            return Err(value.out_of_range("one file at least"));
        };
        let build = |raise: f64| -> Result<Vec<Pair>, InputError> {
            let pair = |((i, j), place, measured): &Entry<'_>| {
                let raise = if i == j { raise * largest } else { 0.0 };
                Ok(((*i, *j), measured.of_matrix(place, decay, raise)?))
            };
            entries.iter().map(pair).collect()
        };
        let mut pairs = build(0.0)?;
        let mut active = look_for_activity(&pairs, count);
        let mut raise = None;
        if active.is_some() {
            let is_passive = |pairs: Vec<Pair>| look_for_activity(&pairs, count).is_none();
            raise = smallest_raise(1.0, |share| Ok(build(share).is_ok_and(is_passive)))?;
            if let Some(share) = raise.filter(|share| tolerances.activity.is_some_and(|most| *share <= most))
            {
                pairs = build(share)?;
                active = None;
                notes.push(format!(
                    "all G_ii(0) are raised by {:.3e}, {share:.1e} of the largest |G|, the smallest rise to 5 % with which the kernel \
                     is passive",
                    share * largest
                ));
            }
        }
        let mut kept = BTreeMap::from_iter(tolerances.keys());
        kept.extend(asymmetry.map(|asymmetry| ("asymmetry", asymmetry)));
        let path = value.path().strip_suffix(".relaxation").unwrap_or_default();
        let mut written = value.document().table_at(path)?;
        written.retain(|key, _| AS_WRITTEN.contains(&key));
        Ok((Self { files, decay, tolerances: kept, written, notes, raise, active }, pairs))
    }
}

/// An entry with its place in the matrix and in the file.
type Entry<'v> = ((usize, usize), Value<'v>, Measured);

/// Reads the files, and their names row by row.
fn read_entries<'v>(
    value: &Value<'v>,
    table: &Table<'_>,
    count: usize,
) -> Result<(Vec<Vec<String>>, Vec<Entry<'v>>), InputError> {
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
    let (mut files, mut entries) = (vec![vec![String::new(); count]; count], Vec::new());
    for (i, row) in rows.iter().enumerate() {
        let names = row.list("names of files")?;
        if names.len() != count {
            return Err(shape(row, names.len()));
        }
        for (j, entry) in names.into_iter().enumerate() {
            if !entry.is_text() && entry.number()? != 0.0 {
                return Err(entry.out_of_range("the name of a file, or \"\" where nothing couples"));
            }
            if entry.is_text() && !entry.text()?.is_empty() {
                entry.document().resolve(entry.text()?).display().to_string().clone_into(&mut files[i][j]);
                let measured = Measured::read(&entry, table)?;
                entries.push(((i, j), entry, measured));
            }
        }
    }
    Ok((files, entries))
}

/// The entries with a beginning and an end; tolerances are relative to the largest |G| of all.
fn completed(
    entries: Vec<Entry<'_>>,
    decay: Option<f64>,
    tolerances: Tolerances,
) -> Result<Vec<Entry<'_>>, InputError> {
    let largest = entries.iter().map(|(.., measured)| measured.largest()).fold(0.0, max_or_nan);
    let mut made = Vec::with_capacity(entries.len());
    for (place, value, measured) in entries {
        let measured = measured.complete(&value, decay, tolerances, largest)?;
        made.push((place, value, measured));
    }
    Ok(made)
}

/// Puts the mean of G_ij and G_ji in the place of both.
///
/// # Errors
/// If one of them is missing, has other times, or they differ by more than the tolerance.
fn symmetrise(
    entries: &mut [Entry<'_>],
    tolerance: Option<f64>,
    notes: &mut Vec<String>,
) -> Result<(), InputError> {
    let largest = entries.iter().map(|(.., measured)| measured.largest()).fold(0.0, max_or_nan);
    for index in 0..entries.len() {
        let (i, j) = entries[index].0;
        if i == j {
            continue;
        }
        let other = entries.iter().position(|(place, ..)| *place == (j, i));
        let refused = |reason: String| {
            Err(entries[index].1.out_of_range(format!(
                "the numbers of entry [{j}][{i}]: the matrix is symmetric, as that of waves is without forward speed{reason}"
            )))
        };
        let Some(other) = other else { return refused(String::new()) };
        if other > index {
            continue;
        }
        let (own, upper) = (&entries[index].2.rows, &entries[other].2.rows);
        if own.len() != upper.len() || own.iter().zip(upper).any(|(own, upper)| own.0 != upper.0) {
            return refused("; its rows are at other times".to_owned());
        }
        let off = own.iter().zip(upper).map(|(own, upper)| ((own.1 - upper.1).abs(), own.0));
        let (most, time) = off.fold((0.0, 0.0), |most, off| if off.0 > most.0 { off } else { most });
        if most == 0.0 {
            continue;
        }
        let share = most / largest;
        if tolerance.is_none_or(|tolerance| share > tolerance) {
            return refused(format!(
                "; they differ by up to {most:.3e}, {share:.1e} of the largest |G|, at t = {time}: {}",
                taken_by(
                    "asymmetry",
                    share,
                    "takes their mean",
                    "they are no two measurements of one function"
                )
            ));
        }
        notes.push(format!(
            "entries [{j}][{i}] and [{i}][{j}] differ by up to {most:.3e}, {share:.1e} of the largest |G|, at t = {time}: their mean is \
             taken"
        ));
        let mean: Vec<(f64, f64)> =
            own.iter().zip(upper).map(|(own, upper)| (own.0, 0.5 * (own.1 + upper.1))).collect();
        entries[index].2.rows.clone_from(&mean);
        entries[other].2.rows = mean;
    }
    Ok(())
}

/// The lowest band of frequencies at which Re R(iω) = Im K(iω)/ω has an eigenvalue below zero.
fn look_for_activity(pairs: &[Pair], count: usize) -> Option<Active> {
    let resistances = |omegas: &[f64]| {
        let places: Vec<Complex<f64>> = omegas.iter().map(|&omega| Complex::new(0.0, omega)).collect();
        let mut matrices = vec![(DMatrix::zeros(count, count), 0.0); omegas.len()];
        for ((i, j), [transfer, _]) in pairs {
            for ((matrix, size), value) in matrices.iter_mut().zip(transfer.values(&places)) {
                let value = value + transfer.spring();
                (matrix[(*i, *j)], matrix[(*j, *i)]) = (value.im, value.im);
                *size += value.norm_sqr();
            }
        }
        let lowest = |(matrix, size)| symmetric_eigenvalues(matrix).min() / f64::sqrt(size);
        matrices.into_iter().map(lowest).collect()
    };
    let tables = pairs.iter().map(|(_, [transfer, _])| transfer.numbers());
    Frequencies::of(tables).look_for_activity(resistances)
}

#[cfg(test)]
mod tests {
    use crate::language::document::Document;
    use crate::scenario::Scenario;
    use std::path::Path;

    /// Two coordinates in waves: G₁₀ is G₀₁ but for 1 % at t = 1, and G₀₀ falls too
    /// late to be passive.
    fn read(tolerances: &str) -> Result<Scenario, String> {
        let text = format!(
            "[system]\nmass = [1.0, 1.0]\n[[system.damping]]\nkernel = {{ relaxation = [[\"00.csv\", \"01.csv\"], [\"10.csv\", \"11.csv\"]]{tolerances} }}\n[initial]\nposition = [1.0, 0.0]\n[time]\nstep = 0.01\nsteps = 10\n"
        );
        let document = Document::new("s.toml", Path::new("."), &text)
            .with_attached("00.csv", "t,G\n0,2\n1,1.2\n2,0\n")
            .with_attached("01.csv", "t,G\n0,0.2\n1,0.1\n2,0\n")
            .with_attached("10.csv", "t,G\n0,0.2\n1,0.12\n2,0\n")
            .with_attached("11.csv", "t,G\n0,1\n1,0.3\n2,0\n");
        Scenario::from_document(document).map_err(|error| format!("{error} {:?}", error.problem()))
    }

    #[test]
    fn tolerances_of_weak_couplings_are_relative_to_the_whole_matrix() {
        // G₀₁ is noise of 1e-3 of G₀₀, which does not end at 0: all of what it is, and 1e-3 of the whole.
        let text = "[system]\nmass = [1.0, 1.0]\n[[system.damping]]\nkernel = { relaxation = [[\"a\", \"n\"], [\"n\", \"a\"]], end = 2e-3 }\n[initial]\nposition = [1.0, 0.0]\n[time]\nstep = 0.01\nsteps = 10\n";
        let document = Document::new("s.toml", Path::new("."), text)
            .with_attached("a", "t,G\n0,2\n1,0.5\n2,0\n")
            .with_attached("n", "t,G\n0,1e-3\n1,-1e-3\n2,2e-3\n");
        let scenario = Scenario::from_document(document).unwrap();
        assert!(scenario.warnings()[0].contains("1.0e-3 of the largest |G|"), "{:?}", scenario.warnings());
    }

    #[test]
    fn no_tolerance_is_advised_where_none_below_1_is_enough() {
        let text = "[system]\nmass = [1.0, 1.0]\n[[system.damping]]\nkernel = { relaxation = [[\"b\", \"a\"], [\"a\", \"b\"]] }\n[initial]\nposition = [1.0, 0.0]\n[time]\nstep = 0.01\nsteps = 10\n";
        for (b, advice) in
            [("t,G\n0,0.001\n1,0\n2,0\n", "takes no such table"), ("t,G\n0,2\n1,0.8\n2,0\n", "`activity` =")]
        {
            let document = Document::new("s.toml", Path::new("."), text)
                .with_attached("a", "t,G\n0,1\n1,1\n2,0\n")
                .with_attached("b", b);
            let said = format!("{:?}", Scenario::from_document(document).unwrap_err().problem());
            assert!(said.contains("smallest eigenvalue") && said.contains(advice), "{said}");
        }
    }

    #[test]
    fn matrices_are_made_symmetric_and_passive_within_their_tolerances() {
        let said = read("").unwrap_err();
        assert!(said.contains("up to 2.000e-2, 1.0e-2 of the largest |G|, at t = 1"), "{said}");
        let said = read(", asymmetry = 0.02").unwrap_err();
        assert!(said.contains("smallest eigenvalue") && said.contains("`activity` ="), "{said}");
        let said = read(", asymmetry = 0.02, activity = 1e-3").unwrap_err();
        assert!(said.contains("smallest eigenvalue"), "{said}");
        let scenario = read(", asymmetry = 0.02, activity = 0.9").unwrap();
        let warnings = scenario.warnings();
        let damping: Vec<&String> =
            warnings.iter().filter(|said| said.starts_with("system.damping[0]")).collect();
        assert!(damping.len() == 2 && damping[0].contains("their mean is taken"), "{warnings:?}");
        assert!(damping[1].contains("G_ii(0) are raised by"), "{warnings:?}");
        let terms = &scenario.system.damping;
        assert!(terms.iter().all(|term| term.active().is_none()));
        // Both diagonals rise by the same, the mean couples.
        let rows = |place: usize| terms[place].transfer.numbers().to_vec();
        let all: Vec<Vec<f64>> = (0..terms.len()).map(rows).collect();
        let raise = all.iter().find(|rows| rows[3] == 1.2).map(|rows| rows[1] - 2.0).unwrap();
        assert!(raise > 0.0 && raise < 1.8, "{raise}");
        assert!(all.iter().any(|rows| rows[3] == 0.3 && (rows[1] - 1.0 - raise).abs() < 1e-12), "{all:?}");
        assert!(all.iter().any(|rows| (rows[3] - 0.11).abs() < 1e-15 && rows[1] == 0.2), "{all:?}");
    }
}
