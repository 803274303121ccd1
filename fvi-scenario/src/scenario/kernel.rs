//! `order` and `kernel` of a damping term, from which its transfer function is built.

use super::parameters::{read_parameters, symbols_of};
use super::symbol::{Symbol, unsuited};
use crate::language::document::{Document, Table, Value};
use crate::language::error::{InputError, Problem};
use crate::language::expression::Symbols;
use crate::language::number_table::NumberTable;
use fvi_core::ParameterError;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::transfer::given_weights::GivenWeights;
use fvi_fft::transfer::relaxation::Relaxation;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// The forms of `kernel.form`.
#[derive(Clone, Copy)]
enum Form {
    Power,
    Tempered,
    Maxwell,
    Prony,
    HavriliakNegami,
}

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
            "a passive kernel: this one can drive the motion at {active}; `allow_active = true` admits it"
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
    let (is_form, value) = table.either("form", "symbol")?;
    if !is_form {
        table.allow(&["symbol"])?;
        return read_symbol(&value, parameters);
    }
    let form = value.choice(&[
        ("power", Form::Power),
        ("tempered", Form::Tempered),
        ("maxwell", Form::Maxwell),
        ("prony", Form::Prony),
        ("havriliak-negami", Form::HavriliakNegami),
    ])?;
    let number = |key: &str| table.required(key)?.number();
    let optional = |key: &str, default: f64| table.optional(key).map_or(Ok(default), |value| value.number());
    let made = match form {
        Form::Power => {
            table.allow(&["form", "order"])?;
            match number("order")? {
                order if order < 0.0 => Err(ParameterError {
                    parameter: "order",
                    value: order,
                    allowed: "at least 0 and less than 2",
                }),
                order => TransferFunction::power(order)
                    .map_err(|error| ParameterError { parameter: "order", ..error }),
            }
        }
        Form::Tempered => {
            table.allow(&["form", "order", "rate"])?;
            TransferFunction::tempered(number("order")?, number("rate")?)
        }
        Form::Maxwell => {
            table.allow(&["form", "order", "inner", "time"])?;
            TransferFunction::maxwell(number("order")?, optional("inner", 0.0)?, number("time")?)
        }
        Form::Prony => {
            table.allow(&["form", "strengths", "times"])?;
            let strengths = table.required("strengths")?.numbers()?;
            let times_value = table.required("times")?;
            let times = times_value.numbers()?;
            if times.len() != strengths.len() {
                return Err(times_value.error(Problem::WrongShape {
                    expected: format!("{} numbers, one for each of `strengths`", strengths.len()),
                    found: times.len().to_string(),
                }));
            }
            TransferFunction::prony(&strengths, &times)
        }
        Form::HavriliakNegami => {
            table.allow(&["form", "order", "power", "time"])?;
            TransferFunction::havriliak_negami(number("order")?, optional("power", 1.0)?, number("time")?)
        }
    };
    made.map_err(|error| {
        let key = match error.parameter {
            "strength" | "number of strengths" => "strengths",
            // An error in an entry of `times` is reported for that key.
            "time" if matches!(form, Form::Prony) => "times",
            parameter => parameter,
        };
        let place = table.optional(key).unwrap_or_else(|| value.clone());
        place.out_of_range(format!("{} {}", error.parameter, error.allowed))
    })
}

/// Reads a relaxation function: a file with the columns `t,G`, or rows of t and G.
fn read_relaxation(table: &Table<'_>, value: &Value<'_>) -> Result<TransferFunction, InputError> {
    table.allow(&["relaxation", "decay"])?;
    let decay = table.optional("decay").map(|decay| decay.positive()).transpose()?;
    relaxation_of(value, decay, None)
}

/// The relaxation function of a file or rows. For an entry of a matrix it need not be passive by itself, and
/// is built with a sign.
///
/// # Errors
/// Names the row that is wrong.
pub(super) fn relaxation_of(
    value: &Value<'_>,
    decay: Option<f64>,
    of_matrix: Option<f64>,
) -> Result<TransferFunction, InputError> {
    let (file, rows) = if value.is_text() {
        let read = NumberTable::read(value, value.document(), &["G".to_owned()])?;
        let file = value.document().resolve(value.text()?).display().to_string();
        (file, read.rows.iter().map(|row| (row[0], row[1])).collect::<Vec<_>>())
    } else {
        let rows = value.list("a file, or a list of rows [t, G]")?;
        let row = |row: &Value<'_>| row.vector(2).map(|row| (row[0], row[1]));
        (String::new(), rows.iter().map(row).collect::<Result<Vec<_>, _>>()?)
    };
    let refused = |index: usize, reason: String| {
        let reason = format!("row {}: {reason}", index + 1);
        if value.is_text() { value.file_error(reason) } else { value.out_of_range(reason) }
    };
    if rows.len() < 2 {
        return Err(refused(0, "at least two rows are needed".to_owned()));
    }
    if rows[0].0 != 0.0 {
        return Err(refused(
            0,
            format!("t = {} instead of 0, where a relaxation function begins", rows[0].0),
        ));
    }
    if let Some(index) = rows.windows(2).position(|pair| pair[1].0 <= pair[0].0) {
        return Err(refused(
            index + 1,
            format!("t = {} does not come after the row before", rows[index + 1].0),
        ));
    }
    // A function that oscillates about zero, such as that of waves, rises in places; its passivity is checked
    // by sampling.
    let swings = of_matrix.is_some() || rows.iter().any(|row| row.1 < 0.0);
    if let Some(index) = rows.windows(2).position(|pair| pair[1].1 > pair[0].1).filter(|_| !swings) {
        return Err(refused(index + 1, format!("G rises to {}: the material would push", rows[index + 1].1)));
    }
    let (end, modulus) = rows[rows.len() - 1];
    if modulus != 0.0 && decay.is_none() {
        return Err(refused(
            rows.len() - 1,
            format!(
                "G = {modulus} at the end, t = {end}: say how it goes on, by the time constant `decay`, or end at 0"
            ),
        ));
    }
    let made = match of_matrix {
        None => Relaxation::new(&file, &rows, decay),
        Some(sign) => {
            let signed: Vec<(f64, f64)> =
                rows.iter().map(|&(time, modulus)| (time, sign * modulus)).collect();
            Relaxation::new(&file, &signed, decay).of_matrix()
        }
    };
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
    use fvi_core::DoubleDouble;
    use fvi_fft::sums::max_or_nan;
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
            ("s^-1.5", "does not vanish like an integral"),
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
                .with_attached("late.csv", "t,G\n1,1\n2,0\n");
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
        assert_eq!((file.spring(), file.active(), file.growth()), (0.0, None, 0.0));
        for (keys, reason) in [
            ("relaxation = \"rises.csv\"", "row 2: G rises to 1.6"),
            ("relaxation = \"late.csv\"", "row 1: t = 1 instead of 0"),
            ("relaxation = [[0, 1], [1, 0.5]]", "`decay`"),
            ("relaxation = [[0, 1], [0, 0]]", "does not come after"),
            ("relaxation = [[0, 1]]", "at least two rows"),
            ("relaxation = \"G.csv\"\norder = 1", "unknown key"),
        ] {
            let message = read(keys).unwrap_err();
            assert!(message.contains(reason), "{keys}: {message}");
        }
        assert!(read("relaxation = [[0, 1], [1, 0.5]]\ndecay = 2.0").is_ok());
        // A rectangle is not passive at some frequencies.
        assert!(read("relaxation = [[0, 1], [1, 1], [1.001, 0]]").unwrap().active().is_some());
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
