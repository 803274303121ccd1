//! Tables of added mass and radiation damping, and matrices of equations of states, as they are given.

use super::taken_by;
use crate::language::cells::{Cells, cells, refuse_as_written};
use crate::language::document::{Table, Value};
use crate::language::error::{InputError, Problem};
use crate::language::matrix_file::Arrays;
use crate::language::npy::Array;
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::radiation::Retardation;
use fvi_fft::transfer::state_space::StateSpace;
use nalgebra::DMatrix;

/// A(ω) and B(ω) at ascending ω.
pub(super) struct Data {
    pub(super) omega: Vec<f64>,
    pub(super) damping: Vec<DMatrix<f64>>,
    added: Option<Vec<DMatrix<f64>>>,
    infinite: Option<DMatrix<f64>>,
}

const SHAPES: &str =
    "a file .csv or .npz, a list of rows [omega, A, B], or { omega = […], A = […], B = […] }";

impl Data {
    /// Reads the table of any of its forms.
    pub(super) fn read(
        table: &Table<'_>,
        value: &Value<'_>,
        notes: &mut Vec<String>,
    ) -> Result<Self, InputError> {
        let is_csv = value.is_text() && !value.text()?.to_lowercase().ends_with(".npz");
        if !is_csv {
            refuse_as_written(table, "`radiation`")?;
        }
        let mut read = if is_csv {
            Self::of_cells(table, value, notes)?
        } else if value.is_text() {
            Self::of_arrays(&value.arrays()?, notes).map_err(|reason| value.file_error(reason))?
        } else if value.is_table() {
            Self::of_table(value, notes)?
        } else {
            Self::of_rows(value)?
        };
        if let Some(infinite) = infinite_of(table, read.size())? {
            read.infinite = Some(infinite);
        }
        read.sort(value)?;
        Ok(read)
    }

    /// Number of rows of the matrices.
    pub(super) fn size(&self) -> usize {
        self.damping.first().map_or(0, DMatrix::nrows)
    }

    fn sort(&mut self, value: &Value<'_>) -> Result<(), InputError> {
        let mut order: Vec<usize> = (0..self.omega.len()).collect();
        order.sort_by(|&a, &b| self.omega[a].total_cmp(&self.omega[b]));
        self.damping = order.iter().map(|&k| self.damping[k].clone()).collect();
        if let Some(added) = &mut self.added {
            *added = order.iter().map(|&k| added[k].clone()).collect();
        }
        self.omega = order.iter().map(|&k| self.omega[k]).collect();
        let refused = |reason: String| Err(super::refuse(value, reason));
        if self.omega.len() < 3 {
            return refused(format!("three frequencies at least, not {}", self.omega.len()));
        }
        if self.omega[0] < 0.0 {
            return refused(format!("frequencies ≥ 0, not ω = {}", self.omega[0]));
        }
        match self.omega.windows(2).find(|pair| pair[0] == pair[1]) {
            Some(pair) => refused(format!(
                "each frequency once, with the entries of its matrices in columns of their own: ω = {} stands there twice",
                pair[0]
            )),
            None => Ok(()),
        }
    }

    fn of_cells(table: &Table<'_>, value: &Value<'_>, notes: &mut Vec<String>) -> Result<Self, InputError> {
        let cells = cells(value, table)?;
        let over = ["omega", "f"].iter().find_map(|name| cells.column(name));
        let Some(over) = over else {
            return Err(
                cells.fault(cells.header, "a table over t: omega (rad/s) or f (Hz) is wanted".to_owned())
            );
        };
        check_units(&cells, table)?;
        let mut entries = Vec::new();
        for (column, place) in cells.columns.iter().enumerate().filter(|(column, _)| *column != over) {
            let Some(entry) = entry_of(&place.name) else {
                let reason = format!(
                    "{}: unknown; columns beside {} are A and B of one coordinate, or A00, A01, …, B00, … (A0_10 from ten on); \
                     `columns = {{ A00 = \"…\" }}` says which of the file's they are",
                    cells.place(column),
                    cells.columns[over].name
                );
                return Err(cells.fault(cells.header, reason));
            };
            entries.push((entry, column));
        }
        let size = entries.iter().map(|((_, i, j), _)| i.max(j) + 1).max().unwrap_or(0);
        if !entries.iter().any(|((is_added, ..), _)| !is_added) {
            return Err(cells.fault(cells.header, "there is no column B".to_owned()));
        }
        let omega = cells.values(over);
        let mut matrices = [vec![DMatrix::zeros(size, size); omega.len()], Vec::new()];
        matrices[1] = matrices[0].clone();
        let is_there = |entry: (bool, usize, usize)| entries.iter().any(|(other, _)| *other == entry);
        for &((is_added, i, j), column) in &entries {
            for (k, number) in cells.values(column).into_iter().enumerate() {
                let matrix = &mut matrices[usize::from(is_added)][k];
                matrix[(i, j)] = number;
                // One of a pair alone stands for both.
                if !is_there((is_added, j, i)) {
                    matrix[(j, i)] = number;
                }
            }
        }
        notes.extend(Cells::left_out_note(&cells.left_out, None));
        let has_added = entries.iter().any(|((is_added, ..), _)| *is_added);
        let [damping, added] = matrices;
        Ok(Self { omega, damping, added: has_added.then_some(added), infinite: None })
    }

    fn of_arrays(arrays: &Arrays, notes: &mut Vec<String>) -> Result<Self, String> {
        let omega = arrays.array("omega")?;
        if omega.shape.len() != 1 {
            return Err(format!("omega: a list is wanted, the shape is {:?}", omega.shape));
        }
        let damping = matrices("B", arrays.array("B")?, omega.numbers.len())?;
        let added = match arrays.has("A") {
            true => Some(matrices("A", arrays.array("A")?, omega.numbers.len())?),
            false => None,
        };
        let infinite = match arrays.has("infinite") {
            true => Some(matrix_of("infinite", arrays.array("infinite")?)?),
            false => None,
        };
        Self::whole(omega.numbers, damping, added, infinite, notes)
    }

    fn whole(
        omega: Vec<f64>,
        damping: Vec<DMatrix<f64>>,
        added: Option<Vec<DMatrix<f64>>>,
        infinite: Option<DMatrix<f64>>,
        notes: &mut Vec<String>,
    ) -> Result<Self, String> {
        let size = damping.first().map_or(0, DMatrix::nrows);
        let others = added.iter().flatten().chain(&infinite);
        if let Some(other) = others.into_iter().find(|other| other.nrows() != size) {
            return Err(format!(
                "A has {} rows and B {size}: both are of the same coordinates",
                other.nrows()
            ));
        }
        let is_number = |k: &usize| {
            let added = added.as_ref().is_none_or(|added| added[*k].iter().all(|entry| entry.is_finite()));
            omega[*k].is_finite() && added && damping[*k].iter().all(|entry| entry.is_finite())
        };
        let kept: Vec<usize> = (0..omega.len()).filter(is_number).collect();
        if kept.len() < omega.len() {
            let count = omega.len() - kept.len();
            let rows = if count == 1 { "row is" } else { "rows are" };
            notes.push(format!("{count} {rows} left out, in which a number is not finite"));
        }
        let pick = |rows: &[DMatrix<f64>]| kept.iter().map(|&k| rows[k].clone()).collect::<Vec<_>>();
        Ok(Self {
            omega: kept.iter().map(|&k| omega[k]).collect(),
            damping: pick(&damping),
            added: added.as_deref().map(pick),
            infinite,
        })
    }

    fn of_table(value: &Value<'_>, notes: &mut Vec<String>) -> Result<Self, InputError> {
        let table = value.table()?;
        table.allow(&["omega", "A", "B"])?;
        let omega = table.required("omega")?.numbers()?;
        let read = |value: Value<'_>| -> Result<Vec<DMatrix<f64>>, InputError> {
            let list = value.list("a list with a number or a matrix for each frequency")?;
            if list.len() != omega.len() {
                return Err(value.error(Problem::WrongShape {
                    expected: format!("{}, one for each of `omega`", omega.len()),
                    found: list.len().to_string(),
                }));
            }
            let rows = list.iter().map(matrix_in).collect::<Result<Vec<_>, _>>()?;
            match rows.iter().position(|row| row.shape() != rows[0].shape() || !row.is_square()) {
                None => Ok(rows),
                Some(at) => Err(list[at].out_of_range("square matrices of the same size")),
            }
        };
        let damping = read(table.required("B")?)?;
        let added = table.optional("A").map(read).transpose()?;
        Self::whole(omega.clone(), damping, added, None, notes).map_err(|reason| value.out_of_range(reason))
    }

    fn of_rows(value: &Value<'_>) -> Result<Self, InputError> {
        let (mut omega, mut damping, mut added) = (Vec::new(), Vec::new(), Vec::new());
        for row in value.list(SHAPES)? {
            let row = row.vector(3)?;
            omega.push(row[0]);
            added.push(DMatrix::from_element(1, 1, row[1]));
            damping.push(DMatrix::from_element(1, 1, row[2]));
        }
        Ok(Self { omega, damping, added: Some(added), infinite: None })
    }

    /// The size of B of each coordinate: its largest diagonal entry, not below what is nothing beside others.
    pub(super) fn sizes(&self) -> Vec<f64> {
        let largest =
            |rows: &[DMatrix<f64>], i: usize| rows.iter().map(|row| row[(i, i)].abs()).fold(0.0, max_or_nan);
        let own: Vec<f64> = (0..self.size()).map(|i| largest(&self.damping, i)).collect();
        let all = own.iter().copied().fold(f64::MIN_POSITIVE, max_or_nan);
        let nothing = 1e-10 * all;
        let floor = |i: usize| match (&self.added, self.omega.last()) {
            (Some(added), Some(last)) => max_or_nan(nothing, 1e-6 * last * largest(added, i)),
            _ => nothing,
        };
        (0..self.size()).map(|i| max_or_nan(own[i], floor(i))).collect()
    }

    /// Puts the mean of a matrix and its transpose in its place.
    pub(super) fn symmetrise(
        &mut self,
        tolerance: Option<f64>,
        notes: &mut Vec<String>,
    ) -> Result<(), String> {
        let mut all = vec![("B", &mut self.damping)];
        all.extend(self.added.as_mut().map(|added| ("A", added)));
        for (name, rows) in all {
            let largest: Vec<f64> = (0..rows[0].nrows())
                .map(|i| rows.iter().map(|row| row[(i, i)].abs()).fold(f64::MIN_POSITIVE, max_or_nan))
                .collect();
            let mut most = (0.0, 0, 0, 0.0);
            for (row, omega) in rows.iter().zip(&self.omega) {
                for i in 0..row.nrows() {
                    for j in 0..i {
                        let off = (row[(i, j)] - row[(j, i)]).abs() / (largest[i] * largest[j]).sqrt();
                        if off > most.0 {
                            most = (off, i, j, *omega);
                        }
                    }
                }
            }
            let (share, i, j, omega) = most;
            let line = format!(
                "{name}{i}{j} and {name}{j}{i} differ by {share:.1e} of the largest {name}{i}{i} and {name}{j}{j} (their \
                 geometric mean), at ω = {omega}"
            );
            if share > tolerance.unwrap_or(super::ROUNDING) {
                return Err(format!(
                    "a symmetric matrix, as that of waves is without forward speed: {line}; {}",
                    taken_by("asymmetry", share, "takes the mean", "it is no such matrix")
                ));
            }
            if share > super::ROUNDING {
                notes.push(format!("{line}: the mean is taken"));
            }
            for row in rows.iter_mut() {
                *row = (&*row + row.transpose()) * 0.5;
            }
        }
        let is_off = |matrix: &&DMatrix<f64>| (*matrix - matrix.transpose()).amax() > 1e-3 * matrix.amax();
        if self.infinite.as_ref().filter(is_off).is_some() {
            return Err("a symmetric matrix `infinite`".to_owned());
        }
        self.infinite = self.infinite.take().map(|matrix| (&matrix + matrix.transpose()) * 0.5);
        Ok(())
    }

    /// Refuses a table that leaves out too much before its first or after its last row.
    pub(super) fn check_ends(&self, sizes: &[f64], [begin, end]: [f64; 2]) -> Result<(), String> {
        let left = |row: &DMatrix<f64>| {
            row.diagonal().iter().zip(sizes).map(|(entry, size)| entry.abs() / size).fold(0.0, max_or_nan)
        };
        let last = self.omega.len() - 1;
        let (first, rest) = (left(&self.damping[0]), left(&self.damping[last]));
        if self.omega[0] > 0.0 && first > begin {
            return Err(format!(
                "a table from low frequencies on: at the first row, ω = {}, B is {first:.1e} of the largest; {}",
                self.omega[0],
                taken_by(
                    "begin",
                    first,
                    "takes a line from B(0) = 0 to it",
                    "rows at lower frequencies are needed"
                )
            ));
        }
        if rest > end {
            return Err(format!(
                "a table to high frequencies: at the last row, ω = {}, B is {rest:.1e} of the largest; {}",
                self.omega[last],
                taken_by(
                    "end",
                    rest,
                    &format!(
                        "takes a line from it to 0 at ω = {}",
                        fvi_fft::transfer::radiation::TAIL * self.omega[last]
                    ),
                    "rows at higher frequencies are needed"
                )
            ));
        }
        Ok(())
    }

    /// A(∞): what is given, or the mean of A − Im K̂(iω)/ω over the rows, with the weights ω²; and how far
    /// A is
    /// from it (Ogilvie's relation).
    pub(super) fn infinite(
        &self,
        found: &Retardation,
        sizes: &[f64],
        (limit, cause): (f64, &str),
        notes: &mut Vec<String>,
    ) -> Result<Option<DMatrix<f64>>, String> {
        let Some(added) = &self.added else { return Ok(self.infinite.clone()) };
        let size = self.size();
        let rows: Vec<(f64, &DMatrix<f64>, DMatrix<f64>)> = self
            .omega
            .iter()
            .zip(added)
            .filter(|(omega, _)| **omega > 0.0)
            .map(|(&omega, added)| (omega, added, found.transform(omega).map(|entry| entry.im)))
            .collect();
        let weights: f64 = rows.iter().map(|(omega, ..)| omega * omega).sum();
        let sum =
            rows.iter().fold(DMatrix::zeros(size, size), |sum: DMatrix<f64>, (omega, added, reactance)| {
                sum + (*added * (omega * omega) - reactance * *omega)
            });
        let estimate = sum / weights;
        let infinite = self.infinite.clone().unwrap_or_else(|| estimate.clone());
        // The size of ω (A − A(∞)), or of B where that is larger.
        let reactance = |i: usize| {
            rows.iter()
                .map(|(omega, added, _)| omega * (added[(i, i)] - infinite[(i, i)]).abs())
                .fold(sizes[i], max_or_nan)
        };
        let scales: Vec<f64> = (0..size).map(reactance).collect();
        let mut most = (0.0, 0, 0, 0.0);
        for (omega, added, reactance) in &rows {
            for i in 0..size {
                for j in i..size {
                    let off = *omega * (added[(i, j)] - infinite[(i, j)]) - reactance[(i, j)];
                    let off = off.abs() / (scales[i] * scales[j]).sqrt();
                    if off > most.0 {
                        most = (off, i, j, *omega);
                    }
                }
            }
        }
        let (share, i, j, omega) = most;
        let line = format!(
            "A and B (Ogilvie's relation): ω (A{i}{j} − A{i}{j}(∞)) is {share:.1e} of its size from what follows from B, at ω = {omega}"
        );
        if share > limit {
            let other = match &self.infinite {
                Some(_) => format!("; A{i}{j}(∞) = {:.6e} would follow from both", estimate[(i, j)]),
                None => String::new(),
            };
            return Err(format!(
                "{line}{other}: {cause}; {}",
                taken_by("inconsistency", share, "takes them", "one does not follow from the other at all")
            ));
        }
        notes.push(line);
        if self.infinite.is_none() {
            let diagonal: Vec<String> =
                infinite.diagonal().iter().map(|entry| format!("{entry:.6e}")).collect();
            notes.push(format!("A(∞) follows from A and B, on the diagonal {}", diagonal.join(", ")));
        }
        Ok(Some(infinite))
    }
}

/// True for A, and row and column, of "A", "B", "A01", "A0_10".
fn entry_of(name: &str) -> Option<(bool, usize, usize)> {
    let is_added = match name.chars().next()? {
        'A' => true,
        'B' => false,
        _ => return None,
    };
    let rest = &name[1..];
    if rest.is_empty() {
        return Some((is_added, 0, 0));
    }
    let (row, column) = match rest.split_once('_') {
        Some(parts) => parts,
        None if rest.len() == 2 && rest.is_ascii() => rest.split_at(1),
        None => return None,
    };
    let place = |digits: &str| digits.parse().ok().filter(|&place: &usize| place < 600);
    Some((is_added, place(row)?, place(column)?))
}

/// Units of A and B are products of kg, m, s, N and rad, unless `units` says what to multiply by.
fn check_units(cells: &Cells<'_, '_>, table: &Table<'_>) -> Result<(), InputError> {
    const KNOWN: [&str; 11] = ["", "kg", "m", "s", "n", "rad", "ns", "nm", "nms", "kgm", "sec"];
    for (column, place) in cells.columns.iter().enumerate() {
        let Some(unit) = place.unit.as_ref().filter(|_| entry_of(&place.name).is_some()) else { continue };
        let said = table.optional("units").and_then(|units| units.table().ok());
        if said.is_some_and(|said| said.optional(&place.name).is_some()) {
            continue;
        }
        let lower = unit.to_lowercase();
        let mut words = lower.split(|letter: char| !letter.is_ascii_alphabetic());
        if !words.all(|word| KNOWN.contains(&word)) {
            let reason = format!(
                "{}: a unit `{unit}`, which is no product of kg, m, s, N, rad; `units = {{ {} = … }}` is the number to multiply \
                 it by",
                cells.place(column),
                place.name
            );
            return Err(cells.fault(cells.header, reason));
        }
    }
    Ok(())
}

/// A number, or rows of numbers.
fn matrix_in(value: &Value<'_>) -> Result<DMatrix<f64>, InputError> {
    if !value.is_list() {
        return Ok(DMatrix::from_element(1, 1, value.number()?));
    }
    let rows = value.list("rows of numbers")?;
    let numbers = rows.iter().map(Value::numbers).collect::<Result<Vec<_>, _>>()?;
    let columns = numbers.first().map_or(0, Vec::len);
    if columns == 0 || numbers.iter().any(|row| row.len() != columns) {
        return Err(value.out_of_range("rows of the same length, one number at least"));
    }
    Ok(DMatrix::from_fn(numbers.len(), columns, |i, j| numbers[i][j]))
}

/// A(∞) of the key `infinite`.
pub(super) fn infinite_of(table: &Table<'_>, size: usize) -> Result<Option<DMatrix<f64>>, InputError> {
    let Some(value) = table.optional("infinite") else { return Ok(None) };
    let matrix = matrix_in(&value)?;
    if matrix.shape() != (size, size) {
        return Err(value.error(Problem::WrongShape {
            expected: format!("{size} rows of {size} numbers, as many as the other matrices have"),
            found: format!("{} rows of {}", matrix.nrows(), matrix.ncols()),
        }));
    }
    Ok(Some(matrix))
}

/// One matrix for each frequency.
fn matrices(name: &str, array: Array, count: usize) -> Result<Vec<DMatrix<f64>>, String> {
    let size = match *array.shape.as_slice() {
        [first] if first == count => 1,
        [first, rows, columns] if first == count && rows == columns => rows,
        _ => {
            return Err(format!(
                "{name}: the shape is {:?}; a number or a square matrix for each of {count} frequencies is wanted, these first",
                array.shape
            ));
        }
    };
    Ok(array.numbers.chunks_exact(size * size).map(|row| DMatrix::from_row_slice(size, size, row)).collect())
}

fn matrix_of(name: &str, array: Array) -> Result<DMatrix<f64>, String> {
    match *array.shape.as_slice() {
        [] => Ok(DMatrix::from_element(1, 1, array.numbers[0])),
        [rows, columns] => Ok(DMatrix::from_row_slice(rows, columns, &array.numbers)),
        _ => Err(format!("{name}: a matrix is wanted, the shape is {:?}", array.shape)),
    }
}

/// A, B, C and D, of a file .npz or of a table; D is zero where it is not given.
pub(super) fn read_states(value: &Value<'_>) -> Result<StateSpace, InputError> {
    let names = ["A", "B", "C", "D"];
    let refused = |reason: String| super::refuse(value, reason);
    let [state, input, output, direct] = if value.is_text() {
        let arrays = value.arrays()?;
        if let Some(other) = arrays.beyond(&names) {
            return Err(refused(format!(
                "arrays A, B, C and perhaps D in the file, and `{other}` is none of them; A(∞) is the key `infinite` beside `states`"
            )));
        }
        let read = |name: &str| match arrays.has(name) || name != "D" {
            true => arrays.array(name).and_then(|array| matrix_of(name, array)).map(Some),
            false => Ok(None),
        };
        let [a, b, c, d] = names.map(read);
        [a.map_err(refused)?, b.map_err(refused)?, c.map_err(refused)?, d.map_err(refused)?]
    } else {
        let table = value.table()?;
        table.allow(&names)?;
        let required = |name: &str| matrix_in(&table.required(name)?).map(Some);
        let direct = table.optional("D").map(|value| matrix_in(&value)).transpose()?;
        [required("A")?, required("B")?, required("C")?, direct]
    };
    let [Some(state), Some(input), Some(output)] = [state, input, output] else {
        return Err(refused("A, B and C".to_owned()));
    };
    let (states, size) = (state.nrows(), input.ncols());
    let absent = DMatrix::zeros(size, size);
    let direct = direct.unwrap_or(absent);
    let shapes = [(&state, (states, states)), (&input, (states, size)), (&output, (size, states))];
    for (name, (matrix, shape)) in names.into_iter().zip(shapes.into_iter().chain([(&direct, (size, size))]))
    {
        if matrix.shape() != shape {
            return Err(refused(format!(
                "{name} of {} × {}, not {} × {}: A is n × n, B n × m, C m × n, D m × m",
                shape.0,
                shape.1,
                matrix.nrows(),
                matrix.ncols()
            )));
        }
        if !matrix.iter().all(|entry| entry.is_finite()) {
            return Err(refused(format!("finite numbers in {name}")));
        }
    }
    if states == 0 || size == 0 {
        return Err(refused("one state and one input at least".to_owned()));
    }
    Ok(StateSpace { state, input, output, direct })
}
