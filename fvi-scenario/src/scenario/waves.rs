//! `kernel = { radiation = … }` and `kernel = { states = … }`: the waves about floating bodies.

use super::kernel::{kernel_of_symbol, share, taken_by};
use super::relaxation_matrix::Pair;
use crate::language::cells::AS_WRITTEN;
use crate::language::document::{Table, Value};
use crate::language::error::{InputError, Problem};
use data::Data;
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::radiation::Damping;
use fvi_fft::transfer::relaxation::Relaxation;
use fvi_fft::transfer::state_space::{MatrixPole, StateSpace};
use fvi_fft::transfer::{Active, TransferFunction};
use nalgebra::{Complex, DMatrix};
use serde::{Serialize, Serializer};
use std::sync::Arc;

mod data;

/// The force −A(∞) q̈ − ∫ K(t − τ) q̇(τ) dτ of radiated waves, in the frequency domain
///
/// ```text
/// K̂(iω) = B(ω) + iω (A(ω) − A(∞)) ,
/// ```
///
/// by tables of the added mass A and the radiation damping B, or by K̂(s) = D + C (s − A)⁻¹ B with matrices
/// of
/// equations of states. A(∞) is a part of the mass. Source: \[Cum62\], \[Ogi64\].
#[derive(Clone, Debug, PartialEq)]
pub struct Waves {
    /// The keys of the scenario, with the mass that is already added.
    keys: toml::Table,
    /// A(∞) of all coordinates of the system, where it is to be added to the mass.
    pub(super) added: Option<DMatrix<f64>>,
    /// Sentences on what was done with the numbers.
    pub(super) notes: Vec<String>,
    /// Where the table is not passive.
    pub(super) active: Option<Active>,
}

impl Serialize for Waves {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.keys.serialize(serializer)
    }
}

/// Below this share of the sizes a number is the rounding of others.
const ROUNDING: f64 = 1e-12;

/// What is allowed unless the scenario says otherwise: B at the first and at the last row, and the difference
/// of A from what follows from B.
const BEGIN: f64 = 0.2;
const END: f64 = 0.05;
const INCONSISTENCY: f64 = 0.05;

/// Which of a system's coordinates the rows and columns of the matrices are.
struct Places {
    own: Vec<usize>,
    count: usize,
}

impl Places {
    fn read(table: &Table<'_>, value: &Value<'_>, size: usize, count: usize) -> Result<Self, InputError> {
        let Some(list) = table.optional("coordinates") else {
            if size == count {
                return Ok(Self { own: (0..count).collect(), count });
            }
            return Err(value.error(Problem::WrongShape {
                expected: format!(
                    "matrices of {count} rows, one for each coordinate (or `coordinates` = [0, …], the coordinates of their rows)"
                ),
                found: format!("{size}"),
            }));
        };
        let mut own = Vec::new();
        for entry in list.list("a list of coordinates, from 0")? {
            let place = entry.whole(0..=count.saturating_sub(1))?;
            if own.contains(&place) {
                return Err(entry.out_of_range("each coordinate once"));
            }
            own.push(place);
        }
        if own.len() != size {
            return Err(list.error(Problem::WrongShape {
                expected: format!("{size} coordinates, one for each row of the matrices"),
                found: own.len().to_string(),
            }));
        }
        Ok(Self { own, count })
    }

    fn spread(&self, matrix: &DMatrix<f64>) -> DMatrix<f64> {
        let mut whole = DMatrix::zeros(self.count, self.count);
        for (row, &i) in self.own.iter().enumerate() {
            for (column, &j) in self.own.iter().enumerate() {
                whole[(i, j)] = matrix[(row, column)];
            }
        }
        whole
    }

    /// i ≤ j.
    fn pair(&self, row: usize, column: usize) -> (usize, usize) {
        let (i, j) = (self.own[row], self.own[column]);
        (i.min(j), i.max(j))
    }
}

impl Waves {
    /// The value that describes waves, if the kernel has this form.
    pub(super) fn of<'a>(kernel: &Table<'a>) -> Option<Value<'a>> {
        kernel.optional("radiation").or_else(|| kernel.optional("states"))
    }

    /// Reads the kernel of a system with `count` coordinates, with K_ij of each coupled pair.
    pub(super) fn read(
        table: &Table<'_>,
        place: &Value<'_>,
        count: usize,
        allow_active: bool,
    ) -> Result<(Self, Vec<Pair>), InputError> {
        let (is_table, value) = table.either("radiation", "states")?;
        let (pairs, places, infinite, notes, active) = if is_table {
            Self::of_radiation(table, &value, count, allow_active)?
        } else {
            Self::of_states(table, &value, count, allow_active)?
        };
        let adds = match table.optional("added_to_mass") {
            Some(value) => value.truth()?,
            None => true,
        };
        let document = place.document();
        let mut keys = document.table_at(place.path())?;
        if value.is_text() {
            let file = document.resolve(value.text()?).display().to_string();
            keys.insert(if is_table { "radiation" } else { "states" }.to_owned(), toml::Value::String(file));
        }
        let added = match infinite {
            Some(infinite) if adds => {
                keys.insert("added_to_mass".to_owned(), toml::Value::Boolean(false));
                Some(places.spread(&infinite))
            }
            None if adds && is_table => {
                return Err(value.out_of_range(
                    "A(∞), for the mass: columns A beside B, or `infinite`; or `added_to_mass = false` where the mass has it",
                ));
            }
            _ => None,
        };
        Ok((Self { keys, added, notes, active }, pairs))
    }

    fn of_radiation(
        table: &Table<'_>,
        value: &Value<'_>,
        count: usize,
        allow_active: bool,
    ) -> Result<Read, InputError> {
        let own = ["radiation", "coordinates", "infinite", "added_to_mass", "memory"];
        let tolerances = ["begin", "end", "activity", "asymmetry", "inconsistency"];
        table.allow(&[&own[..], &tolerances, &AS_WRITTEN].concat())?;
        let mut notes = Vec::new();
        let mut data = Data::read(table, value, &mut notes)?;
        let places = Places::read(table, value, data.size(), count)?;
        let refused = |reason: String| refuse(value, reason);
        let tolerance = |key: &str| table.optional(key).map(|value| share(&value)).transpose();
        data.symmetrise(tolerance("asymmetry")?, &mut notes).map_err(refused)?;
        let sizes = data.sizes();
        let damping = Damping::new(data.omega.clone(), data.damping.clone(), sizes.clone());
        data.check_ends(&sizes, [tolerance("begin")?.unwrap_or(BEGIN), tolerance("end")?.unwrap_or(END)])
            .map_err(refused)?;
        let (lowest, omega) = damping.lowest();
        let drives = lowest < -ROUNDING;
        let is_taken = tolerance("activity")?.is_some_and(|most| -lowest <= most);
        let line =
            format!("the smallest eigenvalue of B is {lowest:.2e} of the largest damping, at ω = {omega}");
        if drives && !is_taken && !allow_active {
            return Err(refused(format!(
                "a passive kernel: {line}; {}; `allow_active = true` admits it",
                taken_by(
                    "activity",
                    -lowest,
                    "puts the nearest passive B in its place",
                    "it drives as much as it damps"
                )
            )));
        }
        let keep = drives && !is_taken;
        if drives && is_taken {
            notes.push(format!("{line}: the nearest B ≥ 0 is in its place"));
        }
        let active = keep.then(|| Active {
            place: Complex::new(0.0, omega),
            resistance: lowest,
            from: Some(omega),
            to: Some(omega),
        });
        let damping = if keep { damping } else { damping.projected() };
        let length = match table.optional("memory") {
            Some(value) => value.positive()?,
            None => damping.length(),
        };
        let found = damping.retardation(length, keep);
        let (off, at) = found.deviation;
        notes.push(format!(
            "K(t) has {} rows up to t = {length:.4}; Re K̂(iω) differs from B by at most {off:.1e} of the largest damping, at ω = {at}",
            found.rows.len()
        ));
        let limit = tolerance("inconsistency")?.unwrap_or(INCONSISTENCY);
        let cause = match table.optional("memory") {
            Some(_) if off > INCONSISTENCY => format!(
                "`memory` = {length} is too short, K(t) up to there has a Re K̂(iω) that differs from B by {off:.1e} of the largest \
                 damping; without the key it goes to t = {:.4}",
                damping.length()
            ),
            _ => "frequencies in rad/s and both in the same units are wanted".to_owned(),
        };
        let infinite = data.infinite(&found, &sizes, (limit, &cause), &mut notes).map_err(refused)?;
        let mut pairs = Vec::new();
        for row in 0..data.size() {
            for column in row..data.size() {
                let rows = found.table(row, column);
                if rows.iter().any(|row| row.1 != 0.0) {
                    let of = |sign: f64| {
                        let rows: Vec<(f64, f64)> = rows.iter().map(|row| (row.0, sign * row.1)).collect();
                        let formula = Arc::new(Relaxation::new("", &rows, None).of_matrix());
                        TransferFunction::formula(formula).map_err(|error| refused(error.to_string()))
                    };
                    pairs.push((places.pair(row, column), [of(1.0)?, of(-1.0)?]));
                }
            }
        }
        if pairs.is_empty() {
            return Err(refused("a damping B other than 0".to_owned()));
        }
        Ok((pairs, places, infinite, notes, active))
    }

    fn of_states(
        table: &Table<'_>,
        value: &Value<'_>,
        count: usize,
        allow_active: bool,
    ) -> Result<Read, InputError> {
        table.allow(&["states", "coordinates", "infinite", "added_to_mass", "asymmetry", "activity"])?;
        let refused = |reason: String| refuse(value, reason);
        let tolerance = |key: &str| table.optional(key).map(|value| share(&value)).transpose();
        let space = data::read_states(value)?;
        let size = space.direct.nrows();
        let places = Places::read(table, value, size, count)?;
        let mut notes = Vec::new();
        let poles = space.poles().map_err(refused)?;
        let (direct, poles) =
            symmetric(&space, poles, tolerance("asymmetry")?, &mut notes).map_err(refused)?;
        let space = StateSpace { direct, ..space };
        let (lowest, omega) = space.lowest(&poles);
        let drives = lowest < -1e-9;
        let is_taken = tolerance("activity")?.is_some_and(|most| -lowest <= most);
        let line = format!("the smallest eigenvalue of Re K̂(iω) is {lowest:.2e} of |K̂|, at ω = {omega:.4e}");
        if drives && !is_taken && !allow_active {
            return Err(refused(format!(
                "a passive kernel: {line}; {}; `allow_active = true` admits it, too",
                taken_by("activity", -lowest, "takes it as it is", "it drives with all of its size there")
            )));
        }
        if drives {
            notes.push(format!("{line}: taken as it is"));
        }
        let place = Complex::new(0.0, omega);
        let active =
            drives.then_some(Active { place, resistance: lowest, from: Some(omega), to: Some(omega) });
        let mut pairs = Vec::new();
        for row in 0..size {
            for column in row..size {
                let Some(text) = fractions_in_words(&space.direct, &poles, (row, column)) else { continue };
                let of = |text: &str| {
                    kernel_of_symbol(text)
                        .map_err(|error| refused(format!("K_{row}{column} = {text}: {error}")))
                };
                pairs.push((places.pair(row, column), [of(&text)?, of(&format!("-({text})"))?]));
            }
        }
        if pairs.is_empty() {
            return Err(refused("equations with a response".to_owned()));
        }
        let infinite = data::infinite_of(table, size)?;
        Ok((pairs, places, infinite, notes, active))
    }
}

/// Pairs, coordinates, A(∞), sentences, where it drives.
type Read = (Vec<Pair>, Places, Option<DMatrix<f64>>, Vec<String>, Option<Active>);

/// An error about a file, or about numbers in the scenario.
fn refuse(value: &Value<'_>, reason: String) -> InputError {
    if value.is_text() { value.file_error(reason) } else { value.out_of_range(reason) }
}

/// D and residues, made symmetric.
fn symmetric(
    space: &StateSpace,
    mut poles: Vec<MatrixPole>,
    tolerance: Option<f64>,
    notes: &mut Vec<String>,
) -> Result<(DMatrix<f64>, Vec<MatrixPole>), String> {
    let mut most = 0.0_f64;
    for pole in &mut poles {
        let other = pole.residue.transpose();
        let size = pole.residue.iter().map(|entry| entry.norm()).fold(f64::MIN_POSITIVE, max_or_nan);
        let off = (&pole.residue - &other).iter().map(|entry| entry.norm()).fold(0.0, max_or_nan);
        most = max_or_nan(most, off / size);
        pole.residue = (&pole.residue + other) * Complex::new(0.5, 0.0);
    }
    let transposed = space.direct.transpose();
    let off = (&space.direct - &transposed).amax() / space.direct.amax().max(f64::MIN_POSITIVE);
    most = max_or_nan(most, off);
    if most > tolerance.unwrap_or(1e-9) || most.is_nan() {
        return Err(format!(
            "a symmetric matrix of responses, as that of waves is without forward speed: residues differ from their transposes by \
             {most:.1e} of the largest entry; {}",
            taken_by("asymmetry", most, "takes their mean", "it is no such matrix")
        ));
    }
    if most > 1e-9 {
        notes.push(format!(
            "residues differ from their transposes by up to {most:.1e} of the largest entry: their mean is taken"
        ));
    }
    Ok(((&space.direct + transposed) * 0.5, poles))
}

/// s K̂_ij(s) in partial fractions as an expression; `None` if it is zero.
fn fractions_in_words(
    direct: &DMatrix<f64>,
    poles: &[MatrixPole],
    (row, column): (usize, usize),
) -> Option<String> {
    let largest = poles.iter().flat_map(|pole| pole.residue.iter()).map(|r| r.norm()).fold(0.0, max_or_nan);
    let mut terms = Vec::new();
    if direct[(row, column)] != 0.0 {
        terms.push(format!("({:e})", direct[(row, column)]));
    }
    for pole in poles {
        let (residue, p) = (pole.residue[(row, column)], pole.place);
        if residue.norm() <= 1e-14 * largest {
            continue;
        }
        terms.push(if p.im == 0.0 {
            format!("({:e})/(s + ({:e}))", residue.re, -p.re)
        } else {
            let parts = [residue.re * p.re, residue.im * p.im];
            let rounding = 4.0 * f64::EPSILON * (parts[0].abs() + parts[1].abs());
            let constant = -2.0 * (parts[0] + parts[1]);
            let constant = if constant.abs() <= rounding { 0.0 } else { constant };
            format!(
                "(({:e})*s + ({constant:e}))/(s^2 + ({:e})*s + ({:e}))",
                2.0 * residue.re,
                -2.0 * p.re,
                p.norm_sqr()
            )
        });
    }
    (!terms.is_empty()).then(|| format!("s*({})", terms.join(" + ")))
}

#[cfg(test)]
mod tests;
