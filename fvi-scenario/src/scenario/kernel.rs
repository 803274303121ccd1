//! `order` and `kernel` of a damping term, from which its transfer function is built.

use super::convex::convex_near;
use super::parameters::{read_parameters, symbols_of};
use super::symbol::{Symbol, unsuited};
use crate::language::cells::{AS_WRITTEN, Cells, cells, refuse_as_written};
use crate::language::document::{Document, Table, Value};
use crate::language::error::{InputError, Problem};
use crate::language::expression::Symbols;
use fvi_core::ParameterError;
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::given_weights::GivenWeights;
use fvi_fft::transfer::relaxation::Relaxation;
use fvi_fft::transfer::{TransferFunction, WRITTEN, WrittenParameter};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Reads `order`, or `kernel` in its place; `step` is the step size of a run with equal steps, for which
/// weights in a file must be made.
///
/// # Errors
/// If neither or both are given, a parameter of the kernel is outside its range, the kernel is not passive
/// and `allow_active` is not set, or weights are for another step size.
pub(super) fn read_transfer(
    table: &Table<'_>,
    parameters: &BTreeMap<String, f64>,
    step: Option<f64>,
) -> Result<TransferFunction, InputError> {
    let (is_order, value) = table.either("order", "kernel")?;
    let allow_active = match table.optional("allow_active") {
        Some(value) => value.truth()?,
        None => false,
    };
    if is_order {
        let order = value.number()?;
        let refused = || value.out_of_range("a damping order 0 ≤ β < 2");
        if !(0.0..2.0).contains(&order) {
            return Err(refused());
        }
        // D⁰q is q itself: a spring, whose energy is mechanical.
        if order == 0.0 {
            return kernel_of_symbol("1");
        }
        return TransferFunction::power(order).map_err(|_| refused());
    }
    let kernel = value.table()?;
    let mut transfer = read_kernel(&kernel, parameters)?;
    if let (Some(weights), Some(step)) = (transfer.table(), step) {
        let bound = weights.clone().at_step(step).map_err(|_| {
            let place = kernel.optional("step").unwrap_or_else(|| value.clone());
            place.error(Problem::Incompatible {
                with: format!("`time.step` = {step}"),
                allowed: "weights of that step: those of another one are another kernel".to_owned(),
            })
        })?;
        transfer = TransferFunction::weights(bound);
    }
    match transfer.active() {
        Some(active) if !allow_active => Err(value.out_of_range(format!(
            "a passive kernel: this one can drive the motion at {active}; `allow_active = true` beside `kernel` admits it{}",
            remedy(&kernel)?
        ))),
        _ => Ok(transfer),
    }
}

/// The kernel of a file with a table `[kernel]`, and a table `[parameters]` for the expression of a symbol.
///
/// # Errors
/// As in a scenario, except that it need not be passive.
pub fn kernel_of_file(path: &Path) -> Result<TransferFunction, InputError> {
    kernel_of_document(&Document::read(path)?)
}

/// The kernel whose symbol is an expression in s.
///
/// # Errors
/// If the expression cannot be used; the error names it as the document `--symbol`.
pub fn kernel_of_symbol(text: &str) -> Result<TransferFunction, InputError> {
    let keys = BTreeMap::from([("kernel", BTreeMap::from([("symbol", text)]))]);
    kernel_of_document(&Document::of_value("--symbol", Path::new(""), &keys)?)
}

/// The kernel of a document with a table `[kernel]`, and a table `[parameters]` for the expression of a
/// symbol.
///
/// # Errors
/// As in a scenario, except that it need not be passive.
pub fn kernel_of_document(document: &Document) -> Result<TransferFunction, InputError> {
    document.with_root(|root| {
        root.allow(&["kernel", "parameters"])?;
        let parameters = match root.optional("parameters") {
            Some(value) => read_parameters(&value)?,
            None => BTreeMap::new(),
        };
        read_kernel(&root.required("kernel")?.table()?, &parameters)
    })
}

/// The kernel of a table that also has other keys, with the table of parameters for the expression of a
/// symbol.
///
/// # Errors
/// As in a scenario, except that it need not be passive.
pub fn kernel_of_table(
    table: &Table<'_>,
    beside: &'static [&'static str],
    parameters: Option<&Value<'_>>,
) -> Result<TransferFunction, InputError> {
    let parameters = parameters.map(read_parameters).transpose()?.unwrap_or_default();
    read_kernel(&table.beside(beside), &parameters)
}

/// Reads the table of a kernel.
///
/// # Errors
/// If a key is unknown or missing, or a value outside its range.
pub(super) fn read_kernel(
    table: &Table<'_>,
    parameters: &BTreeMap<String, f64>,
) -> Result<TransferFunction, InputError> {
    if let Some(value) = table.optional("relaxation") {
        return read_relaxation(table, &value);
    }
    if let Some(value) = table.optional("weights") {
        return read_weights(table, &value);
    }
    if let Some(value) = table.optional("radiation").or_else(|| table.optional("states")) {
        return Err(value.key_error(Problem::Incompatible {
            with: "a kernel without a system".to_owned(),
            allowed: "it in [[system.damping]], where A(∞) joins the mass".to_owned(),
        }));
    }
    let (is_form, value) = table.either("form", "symbol")?;
    if !is_form {
        table.allow(&["symbol"])?;
        return read_symbol(&value, parameters);
    }
    read_form(table, &value)
}

/// Reads the parameters of a form that `value` names.
fn read_form(table: &Table<'_>, value: &Value<'_>) -> Result<TransferFunction, InputError> {
    let form = value.choice(&WRITTEN.map(|form| (form.name, form)))?;
    let names = form.parameters.iter().map(|parameter| parameter.name);
    table.allow(&std::iter::once("form").chain(names).collect::<Vec<_>>())?;
    let mut numbers = Vec::with_capacity(form.parameters.len());
    let mut first: Option<(&str, usize)> = None;
    for parameter in form.parameters {
        if !parameter.is_list {
            numbers.push(vec![match (table.optional(parameter.name), parameter.default) {
                (None, Some(default)) => default,
                _ => table.required(parameter.name)?.number()?,
            }]);
            continue;
        }
        let list = table.required(parameter.name)?;
        let values = list.numbers()?;
        let &mut (one, count) = first.get_or_insert((parameter.name, values.len()));
        if values.len() != count {
            return Err(list.error(Problem::WrongShape {
                expected: format!("{count} numbers, one for each of `{one}`"),
                found: values.len().to_string(),
            }));
        }
        numbers.push(values);
    }
    form.make(&numbers).map_err(|error| {
        // An error in an entry of a list is reported for its key.
        let is_of = |parameter: &&WrittenParameter| {
            let singular = parameter.name.trim_end_matches('s');
            parameter.name == error.parameter || (parameter.is_list && error.parameter.contains(singular))
        };
        let own = form.parameters.iter().find(is_of).and_then(|parameter| table.optional(parameter.name));
        let place = own.unwrap_or_else(|| value.clone());
        place.out_of_range(format!("{} {}", error.parameter, error.allowed))
    })
}

/// Reads a relaxation function: a file with the columns `t,G`, or rows of t and G.
fn read_relaxation(table: &Table<'_>, value: &Value<'_>) -> Result<TransferFunction, InputError> {
    table.allow(&[&["relaxation", "decay", "begin", "end", "activity"], &AS_WRITTEN[..]].concat())?;
    let (decay, tolerances) = (read_decay(table)?, Tolerances::read(table)?);
    let measured = Measured::read(value, table)?;
    let largest = measured.largest();
    let measured = measured.complete(value, decay, tolerances, largest)?;
    let plain = measured.transfer(value, decay, tolerances, 0.0)?;
    let Some(tolerance) = tolerances.activity.filter(|_| plain.active().is_some()) else { return Ok(plain) };
    let made = measured.made_passive(value, decay, tolerances, tolerance)?;
    Ok(made.map_or(plain, |made| made.kernel))
}

pub(super) fn read_decay(table: &Table<'_>) -> Result<Option<f64>, InputError> {
    table.optional("decay").map(|decay| decay.positive()).transpose()
}

/// What makes a kernel of a relaxation function passive, or nothing: the end of the sentence that refuses it.
fn remedy(kernel: &Table<'_>) -> Result<String, InputError> {
    let Some(value) = kernel.optional("relaxation") else { return Ok(String::new()) };
    let (decay, tolerances) = (read_decay(kernel)?, Tolerances::read(kernel)?);
    let measured = Measured::read(&value, kernel)?;
    let largest = measured.largest();
    let measured = measured.complete(&value, decay, tolerances, largest)?;
    let made = measured.made_passive(&value, decay, tolerances, 1.0)?;
    Ok(made.map_or_else(
        || remedy_of(f64::INFINITY),
        |made| match (made.is_raised, tolerance_of(made.share)) {
            (false, Some(share)) => format!(
                "; a falling convex function up to {share} of the largest |G| from it is passive, which `activity` = {share} takes"
            ),
            _ => remedy_of(made.share),
        },
    ))
}

/// The end of a sentence that refuses a kernel which is passive with G(0) raised by this share.
pub(super) fn remedy_of(share: f64) -> String {
    match tolerance_of(share) {
        Some(share) => {
            format!(
                "; with G(0) raised by {share} of the largest |G| it is passive, which `activity` = {share} does"
            )
        }
        None => "; no change by less than the largest |G| makes it passive: `activity` takes no such table"
            .to_owned(),
    }
}

/// A share in words, rounded up, so that a tolerance as large is enough.
pub(super) fn at_least(share: f64) -> String {
    let text = format!("{share:.1e}");
    let digit = 0.1 * libm::exp10(share.log10().floor());
    if text.parse().is_ok_and(|told: f64| told < share) { format!("{:.1e}", share + digit) } else { text }
}

/// [`at_least`], where a tolerance may be that large: it is a share below 1.
fn tolerance_of(share: f64) -> Option<String> {
    let text = at_least(share);
    text.parse().is_ok_and(|told: f64| told < 1.0).then_some(text)
}

/// "`begin` ≥ 3.0e-1 takes a line", or where no tolerance takes that share, that there is none, and why.
pub(super) fn taken_by(key: &str, share: f64, does: &str, otherwise: &str) -> String {
    match tolerance_of(share) {
        Some(told) => format!("`{key}` ≥ {told} {does}"),
        None => format!("no `{key}` < 1 takes that: {otherwise}"),
    }
}

/// The smallest share of the largest |G|, to 5 %, by which G(0) has to rise for a kernel to be passive, if it
/// is at most that.
///
/// G is linear between its rows, so that the row at t = 0 rises by a triangle, whose resistance Re Ĝ(iω) is
/// ½ a Δ (sin(ωΔ/2)/(ωΔ/2))² with the first spacing Δ. With equal spacing all of Re Ĝ has this factor beside
/// a trigonometric polynomial, which rises by a/2 everywhere: no change of the rows that takes less from the
/// largest violation of this polynomial is enough.
pub(super) fn smallest_raise(
    most: f64,
    is_passive: impl Fn(f64) -> Result<bool, InputError>,
) -> Result<Option<f64>, InputError> {
    if !is_passive(most)? {
        return Ok(None);
    }
    let mut enough = most;
    // Down by tens, then between two of them.
    while enough > 1e-12 * most && is_passive(0.1 * enough)? {
        enough *= 0.1;
    }
    let mut less = 0.1 * enough;
    while enough > 1.05 * less {
        let between = (enough * less).sqrt();
        if is_passive(between)? {
            enough = between;
        } else {
            less = between;
        }
    }
    Ok(Some(enough))
}

/// How far a measured relaxation function may be from one that can be used as it is, each relative to the
/// largest |G|; `None` where nothing is said, which is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tolerances {
    /// By how much G(0) may differ from the first row, where that comes later.
    begin: Option<f64>,
    /// What may be left at the last row.
    end: Option<f64>,
    /// By how much rows may be changed so that the kernel is passive.
    pub(super) activity: Option<f64>,
}

impl Tolerances {
    pub(super) fn read(table: &Table<'_>) -> Result<Self, InputError> {
        let of = |key: &str| table.optional(key).map(|value| share(&value)).transpose();
        Ok(Self { begin: of("begin")?, end: of("end")?, activity: of("activity")? })
    }

    pub(super) fn keys(self) -> Vec<(&'static str, f64)> {
        let all = [("begin", self.begin), ("end", self.end), ("activity", self.activity)];
        all.into_iter().filter_map(|(key, number)| Some((key, number?))).collect()
    }
}

/// A tolerance, a share of the largest number.
pub(super) fn share(value: &Value<'_>) -> Result<f64, InputError> {
    let share = value.positive()?;
    if share < 1.0 { Ok(share) } else { Err(value.out_of_range("a share of the largest |G|, 0 < x < 1")) }
}

/// The rows of a relaxation function, amended within tolerances.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    file: String,
    pub(super) rows: Vec<(f64, f64)>,
    pub(super) notes: Vec<String>,
}

/// A kernel that was made passive.
struct MadePassive {
    kernel: TransferFunction,
    /// The largest change of a row, relative to the largest |G|.
    share: f64,
    /// Whether G(0) was raised.
    is_raised: bool,
}

impl Measured {
    /// Reads a file, with the keys for it in the table of the kernel, or rows.
    ///
    /// # Errors
    /// Names the row that is wrong.
    pub(super) fn read(value: &Value<'_>, table: &Table<'_>) -> Result<Self, InputError> {
        let mut notes = Vec::new();
        let (file, rows) = if value.is_text() {
            let read = cells(value, table)?;
            let (Some(time), Some(modulus), 2) = (read.column("t"), read.column("G"), read.columns.len())
            else {
                let names: Vec<&str> = read.columns.iter().map(|place| place.name.as_str()).collect();
                let reason = format!(
                    "the columns are {}, where t and G are needed; `columns = {{ t = \"…\", G = \"…\" }}` says which of the file they are",
                    names.join(", ")
                );
                return Err(read.fault(read.header, reason));
            };
            // What other keys are needed to read again is kept as rows.
            let is_plain = AS_WRITTEN.iter().all(|key| table.optional(key).is_none());
            let name = value.document().resolve(value.text()?).display().to_string();
            let file = if is_plain { name.clone() } else { String::new() };
            if let Some(note) = Cells::left_out_note(&read.left_out, None) {
                notes.push(format!("{name}: {note}"));
            }
            (file, read.values(time).into_iter().zip(read.values(modulus)).collect::<Vec<_>>())
        } else {
            let rows = value.list("a file, or a list of rows [t, G]")?;
            refuse_as_written(table, "rows")?;
            let row = |row: &Value<'_>| row.vector(2).map(|row| (row[0], row[1]));
            (String::new(), rows.iter().map(row).collect::<Result<Vec<_>, _>>()?)
        };
        if rows.len() < 2 {
            return Err(refused_row(value, 0, "at least two rows are needed"));
        }
        if let Some(index) = rows.windows(2).position(|pair| pair[1].0 <= pair[0].0) {
            let reason = format!("t = {} does not come after the row before", rows[index + 1].0);
            return Err(refused_row(value, index + 1, &reason));
        }
        Ok(Self { file, rows, notes })
    }

    /// The same from t = 0 on, to 0 or to a time constant; `largest` is what tolerances are relative to.
    ///
    /// # Errors
    /// Names the row that is wrong, by how much, and the tolerance that takes it.
    pub(super) fn complete(
        mut self,
        value: &Value<'_>,
        decay: Option<f64>,
        tolerances: Tolerances,
        largest: f64,
    ) -> Result<Self, InputError> {
        let count = self.rows.len();
        let ((first, from), (second, to)) = (self.rows[0], self.rows[1]);
        if first != 0.0 {
            let start = from - first * (to - from) / (second - first);
            let change = (start - from).abs() / largest;
            let line = format!(
                "the line through the first two rows goes to G(0) = {start:.6e}, {change:.1e} of the largest |G| from there"
            );
            if !(first > 0.0 && tolerances.begin.is_some_and(|most| change <= most)) {
                let mut reason = format!("t = {first} instead of 0, where a relaxation function begins");
                if first > 0.0 && change.is_finite() {
                    reason += &format!("; {line}");
                }
                if first > 0.0 && change < 0.95 {
                    reason += &format!(": `begin` ≥ {} takes that", at_least(change));
                }
                return Err(refused_row(value, 0, &reason));
            }
            self.notes.push(format!("the first row is at t = {first}: {line}"));
            self.rows.insert(0, (0.0, start));
        }
        let index = self.rows.len() - 1;
        let ((before, _), (end, modulus)) = (self.rows[index - 1], self.rows[index]);
        if modulus != 0.0 && decay.is_none() {
            let left = modulus.abs() / largest;
            if tolerances.end.is_none_or(|most| left > most) {
                let mut reason = format!(
                    "G = {modulus} at the end, t = {end}, {left:.1e} of the largest |G|: say how it goes on, by the time constant \
                     `decay`, or end at 0"
                );
                if left < 0.95 {
                    reason += &format!(", or let a line to 0 follow by `end` ≥ {}", at_least(left));
                }
                return Err(refused_row(value, count - 1, &reason));
            }
            self.notes.push(format!(
                "G = {modulus:.6e} is left at the last row, t = {end}, {left:.1e} of the largest |G|: a line to 0 over {:.6e} follows",
                end - before
            ));
            self.rows.push((end + (end - before), 0.0));
        }
        Ok(self)
    }

    /// The largest |G|.
    pub(super) fn largest(&self) -> f64 {
        self.rows.iter().map(|row| row.1.abs()).fold(0.0, max_or_nan)
    }

    fn relaxation(
        &self,
        decay: Option<f64>,
        tolerances: Tolerances,
        (sign, raise): (f64, f64),
    ) -> Relaxation {
        let mut rows: Vec<(f64, f64)> =
            self.rows.iter().map(|&(time, modulus)| (time, sign * modulus)).collect();
        let mut notes = self.notes.clone();
        if raise > 0.0 {
            rows[0].1 += sign * raise;
            let (share, largest) = (raise / self.largest(), self.rows[0].1);
            notes.push(format!(
                "G(0) = {largest:.6e} is raised by {raise:.3e}, {share:.1e} of the largest |G|, the smallest rise there to 5 % with \
                 which the kernel is passive"
            ));
        }
        Relaxation::new(&self.file, &rows, decay).amended(tolerances.keys(), notes)
    }

    /// K with G(0) raised.
    fn transfer(
        &self,
        value: &Value<'_>,
        decay: Option<f64>,
        tolerances: Tolerances,
        raise: f64,
    ) -> Result<TransferFunction, InputError> {
        of_formula(value, self.relaxation(decay, tolerances, (1.0, raise)))
    }

    /// The kernel with the smaller one of two changes that make it passive, if it is at most this share of
    /// the largest |G|: a rise of G(0), or the change to a convex function that falls.
    fn made_passive(
        &self,
        value: &Value<'_>,
        decay: Option<f64>,
        tolerances: Tolerances,
        most: f64,
    ) -> Result<Option<MadePassive>, InputError> {
        let largest = self.largest();
        let (rows, change) = convex_near(&self.rows, decay);
        let share = change / largest;
        let mut convex = Self { rows, ..self.clone() };
        convex.notes.push(format!(
            "a falling convex function is in the place of G, at most {change:.3e} from it, {share:.1e} of the largest |G|: it is passive"
        ));
        let kernel = convex.transfer(value, decay, tolerances, 0.0)?;
        let is_enough = share <= most && kernel.active().is_none();
        let build = |share: f64| self.transfer(value, decay, tolerances, share * largest);
        let most = if is_enough { share } else { most };
        // Raised to 0 everywhere, a table is no kernel at all.
        let is_passive = |share| Ok(build(share).is_ok_and(|kernel| kernel.active().is_none()));
        if let Some(share) = smallest_raise(most, is_passive)? {
            return Ok(Some(MadePassive { kernel: build(share)?, share, is_raised: true }));
        }
        Ok(is_enough.then_some(MadePassive { kernel, share, is_raised: false }))
    }

    /// K and −K of an entry of a matrix, which need not be passive by itself.
    pub(super) fn of_matrix(
        &self,
        value: &Value<'_>,
        decay: Option<f64>,
        raise: f64,
    ) -> Result<[TransferFunction; 2], InputError> {
        let of = |sign: f64| {
            let own = self.relaxation(decay, Tolerances::default(), (sign, raise));
            of_formula(value, own.of_matrix())
        };
        Ok([of(1.0)?, of(-1.0)?])
    }
}

/// An error about a row of a file, or of a list in the scenario.
fn refused_row(value: &Value<'_>, index: usize, reason: &str) -> InputError {
    let reason = format!("row {}: {reason}", index + 1);
    if value.is_text() { value.file_error(reason) } else { value.out_of_range(reason) }
}

fn of_formula(value: &Value<'_>, made: Relaxation) -> Result<TransferFunction, InputError> {
    TransferFunction::formula(Arc::new(made)).map_err(|error| {
        value.out_of_range(format!("{}; {} is {:e} here", error.allowed, error.parameter, error.value))
    })
}

/// Reads weights, and the step size for which they are made.
fn read_weights(table: &Table<'_>, value: &Value<'_>) -> Result<TransferFunction, InputError> {
    table.allow(&["weights", "step"])?;
    let refused =
        |error: ParameterError| value.out_of_range(format!("{} {}", error.parameter, error.allowed));
    let file = if value.is_list() {
        String::new()
    } else {
        value.document().resolve(value.text()?).display().to_string()
    };
    let mut made = GivenWeights::new(&file, weights_of(value)?).map_err(refused)?;
    if let Some(step) = table.optional("step") {
        made = made.at_step(step.positive()?).map_err(refused)?;
    }
    Ok(TransferFunction::weights(made))
}

/// The weights of a file with the columns `n,weight`, n = 0, 1, …, or of a list.
///
/// # Errors
/// If there is no such file, a row is not the next one, or a weight is not a finite number, with the line.
pub fn weights_of(value: &Value<'_>) -> Result<Vec<f64>, InputError> {
    if value.is_list() {
        return value.numbers();
    }
    let document = value.document();
    let file = document.resolve(value.text()?).display().to_string();
    let unreadable = |reason: String| value.error(Problem::Unreadable { reason });
    let fault = |line: u64, reason: String| value.error(Problem::Table { file: file.clone(), line, reason });
    let text = document.read_named(value.text()?).map_err(|error| unreadable(error.to_string()))?;
    let mut reader =
        csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(text.as_bytes());
    let header = reader.headers().map_err(|error| unreadable(error.to_string()))?.clone();
    if header.iter().collect::<Vec<_>>() != ["n", "weight"] {
        return Err(fault(1, "the columns must be n,weight".to_owned()));
    }
    let mut weights = Vec::new();
    for record in reader.records() {
        let record = record
            .map_err(|error| fault(error.position().map_or(0, csv::Position::line), error.to_string()))?;
        let line = record.position().map_or(0, csv::Position::line);
        if record.get(0).and_then(|cell| cell.parse().ok()) != Some(weights.len()) {
            return Err(fault(
                line,
                format!("n must be {}: weights come in order from n = 0", weights.len()),
            ));
        }
        let weight = record.get(1).and_then(|cell| cell.parse::<f64>().ok()).filter(|w| w.is_finite());
        let Some(weight) = weight else {
            return Err(fault(line, "the weight is not a finite number".to_owned()));
        };
        weights.push(weight);
    }
    if weights.is_empty() {
        return Err(fault(1, "there are no rows".to_owned()));
    }
    Ok(weights)
}

/// Reads K(s) as an expression in s and the parameters.
fn read_symbol(
    value: &Value<'_>,
    parameters: &BTreeMap<String, f64>,
) -> Result<TransferFunction, InputError> {
    if parameters.contains_key("s") {
        return Err(
            value.out_of_range("a symbol beside parameters none of which is named `s`, the Laplace variable")
        );
    }
    let symbols: Symbols = symbols_of(parameters).with_variables(["s".to_owned()]);
    let expression = value.expression(&symbols)?;
    if let Some(function) = unsuited(expression.root()) {
        return Err(value.out_of_range(format!(
            "+ − * / ^, sqrt, exp, log, sinh, cosh and tanh of the complex variable s, not {function}"
        )));
    }
    TransferFunction::formula(Arc::new(Symbol::new(expression))).map_err(|error| {
        value.out_of_range(format!("{}; {} is {:e} here", error.allowed, error.parameter, error.value))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;
    use fvi_core::DoubleDouble;
    use fvi_core::min_or_nan;
    use fvi_fft::transfer::algebra::Series;
    use nalgebra::Complex;

    fn symbol(text: &str) -> TransferFunction {
        kernel_of_symbol(text).unwrap_or_else(|error| panic!("{text}: {error}"))
    }

    #[test]
    fn expressions_have_the_values_of_the_forms() {
        let pairs = [
            ("s^0.6/(1 + s^0.6)", TransferFunction::maxwell(0.6, 0.0, 1.0)),
            ("(s + 0.3)^0.5 - 0.3^0.5", TransferFunction::tempered(0.5, 0.3)),
            ("s/(1 + s) + 0.7*0.1*s/(1 + 0.1*s)", TransferFunction::prony(&[1.0, 0.7], &[1.0, 0.1])),
            ("1 - (1 + (2*s)^0.7)^-0.5", TransferFunction::havriliak_negami(0.7, 0.5, 2.0)),
            ("exp(0.4*log(s))", TransferFunction::power(0.4)),
        ];
        for (text, form) in pairs {
            let (expression, form) = (symbol(text), form.unwrap());
            assert!((expression.growth() - form.growth()).abs() < 1e-6, "{text}");
            for s in [Complex::new(0.1, 0.0), Complex::new(0.0, 3.0), Complex::new(-2.0, 0.5)] {
                let error = (expression.value(s) - form.value(s)).norm();
                assert!(error < 1e-14 * (1.0 + form.value(s).norm()), "{text}, {s}: {error:e}");
            }
            let z = Series::polynomial(&[DoubleDouble::exact(1.5), DoubleDouble::exact(-1.0)], 40);
            let (found, known) = (expression.series(&z).to_numbers(), form.series(&z).to_numbers());
            let error = found.iter().zip(&known).map(|(a, b)| (a - b).abs()).fold(0.0, max_or_nan);
            assert!(error < 1e-15, "{text}: {error:e}");
        }
    }

    #[test]
    fn symbols_of_one_text_are_told_apart_by_their_parameters() {
        let of = |order: f64| {
            let text = format!("kernel = {{ symbol = \"s^b/(1 + s^b)\" }}\nparameters = {{ b = {order} }}\n");
            kernel_of_document(&Document::new("kernel.toml", Path::new("."), &text)).unwrap()
        };
        assert_ne!(of(0.5).key(), of(0.6).key());
        assert_ne!(of(0.5), of(0.6));
        assert_eq!(of(0.5), of(0.5));
    }

    #[test]
    fn what_a_symbol_has_at_zero_is_a_spring() {
        let material = symbol("0.5 + 1.5*s^0.6/(1 + s^0.6)");
        assert!((material.spring() - 0.5).abs() < 1e-15);
        assert!(material.value(Complex::new(1e-30, 0.0)).norm() < 1e-15);
        assert!(material.is_relaxation() && material.active().is_none());
        let whole = material.clone().with_its_spring();
        assert!((whole.value(Complex::new(1e-30, 0.0)).re - 0.5).abs() < 1e-15);
        assert_eq!(whole.spring(), material.spring());
        assert_ne!(whole.key(), material.key());
        assert_eq!(symbol("s^0.5").spring(), 0.0);
        // Beside powers so low that they have not decayed at the smallest numbers; and those alone.
        for power in [0.18, 0.1, 0.01, 0.003] {
            let beside = symbol(&format!("0.5 + s^{power} + s^{}", 2.5 * power));
            assert!((beside.spring() - 0.5).abs() < 1e-7, "{power}: {:e}", beside.spring());
            assert_eq!(symbol(&format!("s^{power}")).spring(), 0.0, "{power}");
            assert_eq!(symbol(&format!("s^{power} + 3*s^{}", 2.5 * power)).spring(), 0.0, "{power}");
            assert_eq!(symbol(&format!("s^{power}/(1 + s^{power})")).spring(), 0.0, "{power}");
        }
        assert_eq!(symbol("1/(1 + log(1 + 1/s))").spring(), 0.0);
        // Poles in addition to the cut.
        assert!(!symbol("0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)").is_relaxation());
        assert!(symbol("-1 + s^0.5").active().is_some());
    }

    #[test]
    fn the_cut_of_a_symbol_is_as_narrow_as_it_is_and_its_only_singularity() {
        use std::f64::consts::PI;
        // 1 + s^x vanishes beyond the cut at the angle π/x.
        for order in [0.5, 0.8, 0.9, 0.94, 0.98] {
            let material = symbol(&format!("s^{order}/(1 + s^{order})"));
            let strip = material.cut().unwrap().strip;
            assert!(material.is_relaxation() && strip < 1.3 * (PI / order - PI), "{order}: {strip}");
        }
        assert!(!symbol("s^0.9999/(1 + s^0.9999)").is_relaxation());
        for text in
            ["s^0.001", "s^0.999", "s^0.97 + 0.2*s^0.99", "0.2*s^0.001 + s^0.5/(1 + s^0.5)", "log(1 + s^0.5)"]
        {
            assert!(symbol(text).is_relaxation(), "{text}");
        }
        // A weak resonance, a resonance far away, and inertia beside a cut.
        let resonance = "s*(s + 0.1)/((s + 0.1)^2 + 4)";
        assert!(!symbol(&format!("s^0.5 + 1e-7*{resonance}")).is_relaxation());
        assert!(!symbol("s^0.5 + 1e3*s*(s + 1e5)/((s + 1e5)^2 + 1e14)").is_relaxation());
        assert!(!symbol("s^0.5 + s^1.5").is_relaxation());
    }

    #[test]
    fn where_a_kernel_is_not_passive_is_a_band_of_frequencies() {
        // Im (iω − (iω)^½)/ω < 0 for ω^½ < ½ √2; with a subtracted resonance between the zeros of Im K(iω)/ω.
        let told = |text: &str| symbol(text).active().unwrap().to_string();
        assert_eq!(told("s - s^0.5"), "ω below 5.0000e-1, where Im K(iω)/ω < 0");
        assert_eq!(told("s^0.5 - 0.5*s"), "ω above 2.0000e0, where Im K(iω)/ω < 0");
        let band = symbol("s - 0.05*s^2/(s^2 + 0.02*s + 1)").active().unwrap();
        let (from, to) = (band.from.unwrap(), band.to.unwrap());
        assert!(from < to && to - from < 1.0, "{band}");
        let passive = |omega: f64| {
            let s = Complex::new(0.0, omega);
            (s - s * s * 0.05 / (s * s + s * 0.02 + 1.0)).im / omega
        };
        assert!(passive(from).abs() < 1e-6 && passive(to).abs() < 1e-6, "{band}");
    }

    #[test]
    fn symbols_that_cannot_be_kernels_are_refused_with_the_reason() {
        for (text, reason) in [
            ("abs(s)", "not abs"),
            ("sin(s)", "not sin"),
            ("max(s, 1)", "not min or max"),
            ("t*s", "unknown name"),
            ("s^2", "grows more slowly than s²"),
            ("sqrt(1 - s)", "a real number for every s > 0"),
        ] {
            let error = kernel_of_symbol(text).unwrap_err();
            let help = miette::Diagnostic::help(&error).map(|help| help.to_string()).unwrap_or_default();
            assert!(format!("{error} {help}").contains(reason), "{text}: {error} {help}");
        }
    }

    #[test]
    fn relaxation_functions_are_read_and_checked_row_by_row() {
        let read = |keys: &str| {
            let document = Document::new("kernel.toml", Path::new("."), &format!("[kernel]\n{keys}\n"))
                .with_attached("G.csv", "t,G\n0,1\n0.5,0.6\n2,0\n")
                .with_attached("rises.csv", "t,G\n0,1\n0.5,1.6\n2,0\n")
                .with_attached("late.csv", "t,G\n1,1\n2,0\n")
                .with_attached("written.csv", "Curve 3\nG(t);Time;T\nkPa;min;K\n0;0,0333333333333333;20\n0,6;0,00833333333333333;20\nNaN;0,02;20\n1;0;20\n")
                .with_attached("tabs.csv", "t\tG\n0\t1\n0.5\t0.6\n2\t0\n")
                .with_attached("three.csv", "t,G,T\n0,1,20\n0.5,0.6,20\n2,0,20\n");
            kernel_of_document(&document).map_err(|error| {
                let help = miette::Diagnostic::help(&error).map(|help| help.to_string()).unwrap_or_default();
                format!("{error} {help}")
            })
        };
        let (file, rows) = (
            read("relaxation = \"G.csv\"").unwrap(),
            read("relaxation = [[0, 1], [0.5, 0.6], [2, 0]]").unwrap(),
        );
        let s = Complex::new(0.3, 1.0);
        assert_eq!(file.value(s), rows.value(s));
        // As a rheometer writes it: another order, units, a decimal comma, a missing number.
        let written = "relaxation = \"written.csv\"\ncolumns = { t = \"Time\", G = \"G(t)\" }\ndecimal = \",\"\nunits = { t = 60.0 }";
        assert!((read(written).unwrap().value(s) - rows.value(s)).norm() < 1e-13);
        assert_eq!(read("relaxation = \"tabs.csv\"").unwrap().value(s), rows.value(s));
        assert_eq!((file.spring(), file.active(), file.growth()), (0.0, None, 0.0));
        for (keys, reason) in [
            ("relaxation = \"late.csv\"", "row 1: t = 1 instead of 0"),
            ("relaxation = \"late.csv\"", "1.0e0 of the largest |G| from there"),
            ("relaxation = [[1, 1], [3, 0]]", "`begin` ≥ 5.0e-1 takes that"),
            ("relaxation = \"late.csv\"\nbegin = 1.5", "0 < x < 1"),
            ("relaxation = [[0, 1], [1, 0.5]]\nend = 0.1", "`end` ≥ 5.0e-1"),
            // Rows have the numbers of the file also after one was added at 0, and the share is enough.
            ("relaxation = [[1, 1], [2, 0.501]]\nbegin = 0.6", "row 2: G = 0.501 at the end"),
            ("relaxation = [[0, 1], [1, 0.501]]\nend = 0.5", "`end` ≥ 5.1e-1"),
            ("relaxation = [[0, 1], [1, 0.5]]", "`decay`"),
            ("relaxation = [[0, 1], [0, 0]]", "does not come after"),
            ("relaxation = [[0, 1]]", "at least two rows"),
            ("relaxation = \"G.csv\"\norder = 1", "unknown key"),
            ("relaxation = \"three.csv\"", "the columns are t, G, T, where t and G are needed"),
            ("relaxation = \"G.csv\"\ncolumns = { t = \"Time\", G = \"G\" }", "here `Time` is missing"),
        ] {
            let message = read(keys).unwrap_err();
            assert!(message.contains(reason), "{keys}: {message}");
        }
        assert!(read("relaxation = [[0, 1], [1, 0.5]]\ndecay = 2.0").is_ok());
        // What counts is Re Ĝ, not that G falls: the first is passive though it rises, the second is not.
        assert!(read("relaxation = [[0, 1], [1, 0.3], [2, 0.31], [3, 0]]").unwrap().active().is_none());
        assert!(read("relaxation = \"rises.csv\"").unwrap().active().is_some());
        // A rectangle is not passive at some frequencies.
        assert!(read("relaxation = [[0, 1], [1, 1], [1.001, 0]]").unwrap().active().is_some());
    }

    /// Re Ĝ(iω) of rows that are linear in between, by Simpson's rule of ∫ G cos ωt dt.
    fn resistance(rows: &[f64], omega: f64) -> f64 {
        let rows: Vec<(f64, f64)> = rows.chunks(2).map(|row| (row[0], row[1])).collect();
        let piece = |pair: &[(f64, f64)]| {
            let ((from, start), (to, end)) = (pair[0], pair[1]);
            (0..200).fold(0.0, |sum, k| {
                let at = |x: f64| (start + (end - start) * x) * (omega * (from + (to - from) * x)).cos();
                let (x, width) = (f64::from(k) / 200.0, 1.0 / 200.0);
                sum + (to - from) * width / 6.0 * (at(x) + 4.0 * at(x + 0.5 * width) + at(x + width))
            })
        };
        rows.windows(2).map(piece).sum()
    }

    #[test]
    fn measured_relaxation_functions_are_amended_within_their_tolerances() {
        let read = |keys: &str| {
            kernel_of_document(&Document::new("kernel.toml", Path::new("."), &format!("[kernel]\n{keys}\n")))
        };
        // It swings, from t = 0.1 on, with noise of 0.003.
        let noisy: Vec<String> = (1..40)
            .map(|k| {
                let (t, noise) = (0.1 * f64::from(k), 0.003 * f64::from(k * k % 7 - 3));
                format!("[{t}, {}]", (-t).exp() * (2.0 * t).cos() + noise)
            })
            .collect();
        let rows = format!("relaxation = [{}]", noisy.join(", "));
        assert!(read(&rows).is_err());
        let kernel = read(&format!("{rows}\nbegin = 0.2\nend = 0.05")).unwrap();
        let numbers = kernel.numbers();
        let (first, second) = (numbers[3], numbers[5]);
        assert_eq!((numbers[0], numbers[2]), (0.0, 0.1));
        assert!((numbers[1] - (2.0 * first - second)).abs() < 1e-12);
        assert!(numbers[numbers.len() - 1] == 0.0 && numbers.len() == 2 * 41);
        assert!(kernel.active().is_some() && kernel.notes().len() == 2, "{:?}", kernel.notes());
        // The smallest rise of G(0) that makes it passive: 10 % less would not.
        let passive = read(&format!("{rows}\nbegin = 0.2\nend = 0.05\nactivity = 0.2")).unwrap();
        assert!(passive.active().is_none() && passive.notes()[2].contains("G(0)"), "{:?}", passive.notes());
        let raise = passive.numbers()[1] - numbers[1];
        assert!(raise > 0.0 && passive.numbers()[2..] == numbers[2..]);
        let lowest = |raise: f64| {
            let mut rows = numbers.to_vec();
            rows[1] += raise;
            (1..=1500).map(|k| resistance(&rows, 0.02 * f64::from(k))).fold(f64::INFINITY, min_or_nan)
        };
        assert!(lowest(0.0) < -1e-4 && lowest(raise) > -1e-6 && lowest(0.9 * raise) < 0.0, "{raise}");
        // A change of all rows to a convex function is smaller where they fall with noise.
        let logarithmic: Vec<String> = (0..150)
            .map(|k| {
                let (t, noise) = (libm::exp10(0.03 * f64::from(k) - 3.0), 1e-3 * f64::from(k * k % 7 - 3));
                format!("[{t:e}, {:e}]", libm::exp(-t) + noise)
            })
            .collect();
        let rows_of_decades = format!("relaxation = [{}]", logarithmic.join(", "));
        let plain = read(&format!("{rows_of_decades}\nbegin = 0.1\nend = 0.05")).unwrap();
        assert!(plain.active().is_some());
        let convex = read(&format!("{rows_of_decades}\nbegin = 0.1\nend = 0.05\nactivity = 0.02")).unwrap();
        assert!(convex.active().is_none() && convex.notes()[2].contains("convex"), "{:?}", convex.notes());
        let change = convex.numbers().iter().zip(plain.numbers()).map(|(own, row)| (own - row).abs());
        let change = change.fold(0.0, max_or_nan);
        assert!(change > 2e-3 && change < 0.02, "{change}");
        // Where the tolerance is too small, it stays as it is, and is refused in a scenario with the size.
        let keys = format!("{rows}\nbegin = 0.2\nend = 0.05\nactivity = 1e-6");
        assert!(read(&keys).unwrap().active().is_some());
        let scenario = format!(
            "[system]\nmass = [1.0]\n[[system.damping]]\ncoefficient = [1.0]\nkernel = {{ {} }}\n[initial]\nposition = [1.0]\n[time]\nstep = 0.01\nsteps = 10\n",
            keys.replace('\n', ", ")
        );
        let error = Scenario::from_document(Document::new("s.toml", Path::new("."), &scenario)).unwrap_err();
        let said = format!("{error} {:?}", error.problem());
        assert!(said.contains("`activity` ="), "{said}");
        let taken = scenario.replace("activity = 1e-6", "activity = 0.2");
        let taken = Scenario::from_document(Document::new("s.toml", Path::new("."), &taken)).unwrap();
        let warnings = taken.warnings();
        assert_eq!(warnings.len(), 3, "{warnings:?}");
        assert!(warnings[2].starts_with("system.damping[0].kernel: G(0) = "), "{warnings:?}");
        // The scenario as it is written down again is the same.
        let again = toml::to_string(&taken).unwrap();
        assert!(again.contains("activity = 0.2"), "{again}");
    }

    /// Raised by as much as it is, a negative table is nothing, and no `activity` takes that.
    #[test]
    fn a_table_of_the_other_sign_is_refused_without_a_tolerance_that_would_be_refused() {
        let of = |more: &str| {
            format!(
                "[system]\nmass = [1.0]\nstiffness = [9.0]\n[[system.damping]]\ncoefficient = [1.0]\nkernel = {{ relaxation = [[0, -1], [1, -0.5], [2, 0]] }}\n{more}[initial]\nposition = [1.0]\n[time]\nstep = 0.01\nsteps = 10\n"
            )
        };
        let read = |more: &str| Scenario::from_document(Document::new("s.toml", Path::new("."), &of(more)));
        let said = format!("{:?}", read("").unwrap_err().problem());
        assert!(
            said.contains("drive the motion") && said.contains("`activity` takes no such table"),
            "{said}"
        );
        read("allow_active = true\n").unwrap();
    }

    #[test]
    fn weights_are_read_and_checked_row_by_row() {
        let read = |keys: &str| {
            let document = Document::new("kernel.toml", Path::new("/data"), &format!("[kernel]\n{keys}\n"))
                .with_attached("w.csv", "# by hand\nn,weight\n0,10.0\n1,-10.0\n")
                .with_attached("gap.csv", "n,weight\n0,1\n2,1\n")
                .with_attached("text.csv", "n,weight\n0,1\n1,one\n")
                .with_attached("names.csv", "k,w\n0,1\n")
                .with_attached("empty.csv", "n,weight\n");
            kernel_of_document(&document).map_err(|error| {
                let help = miette::Diagnostic::help(&error).map(|help| help.to_string()).unwrap_or_default();
                format!("{error} {help}")
            })
        };
        let (file, list) = (read("weights = \"w.csv\"").unwrap(), read("weights = [10.0, -10.0]").unwrap());
        assert_eq!((file.text(), list.text()), (Some("/data/w.csv"), Some("")));
        assert_eq!((file.numbers(), file.active(), file.spring()), (&[10.0, -10.0][..], None, 0.0));
        assert_eq!(file.numbers(), list.numbers());
        let stated = read("weights = \"w.csv\"\nstep = 0.1").unwrap();
        assert_eq!(stated.table().unwrap().step(), Some(0.1));
        assert_eq!(stated.parameters(), [("step", vec![0.1])]);
        for (keys, reason) in [
            ("weights = \"gap.csv\"", "gap.csv, line 3: n must be 1"),
            ("weights = \"text.csv\"", "line 3: the weight is not a finite number"),
            ("weights = \"names.csv\"", "the columns must be n,weight"),
            ("weights = \"empty.csv\"", "there are no rows"),
            ("weights = \"none.csv\"", "none.csv"),
            ("weights = []", "number of weights at least 1"),
            ("weights = \"w.csv\"\nstep = 0", "step"),
            ("weights = \"w.csv\"\norder = 1", "unknown key"),
        ] {
            let message = read(keys).unwrap_err();
            assert!(message.contains(reason), "{keys}: {message}");
        }
    }

    #[test]
    fn kernels_that_are_not_passive_are_found() {
        for text in ["-s^0.5", "s/(1 - s)", "s^0.5 - 0.3*s^1.5", "s*exp(-s)", "s^0.5*exp(-0.1*s)"] {
            assert!(kernel_of_symbol(text).is_err() || symbol(text).active().is_some(), "{text}");
        }
        for text in
            ["s^0.5", "s*tanh(sqrt(s))/sqrt(s)", "sqrt(s)/(1 + sqrt(s))", "0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)"]
        {
            assert_eq!(symbol(text).active(), None, "{text}");
        }
    }
}
