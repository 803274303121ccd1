//! `[controller]`: a sampled fractional PID controller whose output is a force on the coordinates.

use super::Scenario;
use super::load::Pattern;
use super::system::System;
use super::time::TimeGrid;
use crate::language::document::{Document, Table, Value};
use crate::language::error::{InputError, Problem};
use crate::language::expression::{Elementary, Expression, Moment};
use crate::language::number_table::NumberTable;
use crate::language::{number_at, value_at};
use fvi_core::{
    AntiWindup, Bumpless, DerivativeFilter, DerivativeOf, ParameterError, PidGains, PidLaw, PidSettings, Real,
};
use serde::{Serialize, Serializer};
use std::sync::Arc;

/// A controller in a closed loop: it samples a measured value, and its output, a force on the coordinates, is
/// held until the next sample.
#[derive(Clone, Debug)]
pub struct Controller {
    /// y, an expression in `q0`, …, `p0`, … and the parameters.
    pub measures: Expression,
    /// r(t).
    pub setpoint: Setpoint,
    /// u_ff(t).
    pub feed_forward: Option<Expression>,
    /// The force on the coordinates per unit of output.
    pub drives: Pattern,
    /// The law, in double precision.
    pub settings: PidSettings<f64>,
    /// Time between samples, a multiple of the step.
    pub sample: f64,
    /// Delay until the output acts, in units of time.
    pub delay: f64,
    /// Quantisation of the measured value and of the output.
    pub quantise: Quantise,
    /// Noise added to the measured value.
    pub noise: Noise,
}

/// A setpoint over time.
#[derive(Clone, Debug)]
pub enum Setpoint {
    /// An expression in t and the parameters.
    Expression(Expression),
    /// A record, linear between its rows and constant before the first and after the last.
    Record {
        /// Name of the file.
        file: String,
        /// (t, r).
        rows: Arc<Vec<(f64, f64)>>,
    },
}

/// Quantisation steps of converters; `None` for no quantisation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Quantise {
    /// Step of the measured value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measure: Option<f64>,
    /// Step of the output.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub output: Option<f64>,
}

/// The least and the largest multiple of a quantum within limits, as counts of it; a limit that is a multiple
/// but for rounding counts as one.
#[doc(hidden)]
pub fn counts_within(quantum: f64, [lower, upper]: [f64; 2]) -> [f64; 2] {
    let count = |limit: f64, inwards: fn(f64) -> f64| {
        let (count, nearest) = (limit / quantum, libm::round(limit / quantum));
        if (count - nearest).abs() <= 4.0 * f64::EPSILON * count.abs() { nearest } else { inwards(count) }
    };
    [count(lower, libm::ceil), count(upper, libm::floor)]
}

/// Gaussian noise on the measured value, the same in every run with the same seed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Noise {
    /// σ.
    pub standard_deviation: f64,
    /// Seed of the generator.
    pub seed: u64,
}

impl Noise {
    /// Noise of sample `index`: normally distributed with standard deviation σ.
    ///
    /// Two outputs of SplitMix64 at the counter `index` and the method of Box and Muller, with the functions
    /// of `libm`: the same numbers on every machine. Source: \[SLF14\], \[BoxMuller58\].
    pub fn at(&self, index: u64) -> f64 {
        if self.standard_deviation == 0.0 {
            return 0.0;
        }
        let key = mixed(self.seed);
        let uniform = |place: u64| {
            let bits = mixed(key.wrapping_add(index.wrapping_mul(2).wrapping_add(place)));
            // In (0, 1].
            ((bits >> 11) as f64 + 1.0) / (1u64 << 53) as f64
        };
        let radius = libm::sqrt(-2.0 * libm::log(uniform(0)));
        self.standard_deviation * radius * libm::cos(2.0 * std::f64::consts::PI * uniform(1))
    }
}

/// The output function of SplitMix64 at one step of its counter.
fn mixed(counter: u64) -> u64 {
    let z = counter.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Setpoint {
    /// r(t) at a sample; at a jump the value after it.
    pub fn at<T: Elementary>(&self, time: T) -> T {
        match self {
            Self::Expression(expression) => expression.value(Moment::from_right(time), &[]),
            Self::Record { rows, .. } => {
                let time = time.to_f64();
                let after = rows.partition_point(|&(t, _)| t <= time);
                let value = match (after.checked_sub(1).and_then(|before| rows.get(before)), rows.get(after))
                {
                    (Some(&(t0, r0)), Some(&(t1, r1))) => r0 + (r1 - r0) * ((time - t0) / (t1 - t0)),
                    (Some(&(_, r)), None) | (None, Some(&(_, r))) => r,
                    (None, None) => 0.0,
                };
                T::of(value)
            }
        }
    }
}

/// Largest deviation from an integer number of steps, in steps, at which a time counts as a multiple of the
/// step.
const SLACK: f64 = 1e-9;

/// A time as an integer number of steps and a fraction of one.
fn in_steps(time: f64, step: f64) -> (f64, f64) {
    let steps = time / step;
    let nearest = steps.round();
    if (steps - nearest).abs() <= SLACK * f64::max(1.0, nearest) {
        return (nearest, 0.0);
    }
    (steps.floor(), steps - steps.floor())
}

impl Scenario {
    /// The scenario of a document, or of one with `[controller]` alone, as `fvi tune` writes it.
    ///
    /// The constants of a controller do not depend on what it controls: masses at rest, one for each entry of
    /// `drives`, stand in for that.
    ///
    /// # Errors
    /// The first invalid entry.
    pub fn with_controllers(document: Document) -> Result<Self, InputError> {
        let mut values = document.values()?;
        let is_alone = values.contains_key("controller") && !values.contains_key("system");
        if !is_alone || values.contains_key("equation") {
            return Self::from_document(document);
        }
        let paths = ["controller", "controller[0]"];
        let drives = paths.iter().find_map(|path| value_at(&values, &format!("{path}.drives")));
        let count = drives.and_then(toml::Value::as_array).map_or(1, Vec::len);
        let sample = paths.iter().find_map(|path| number_at(&values, &format!("{path}.sample")));
        let step = match sample {
            Some(sample) if sample > 0.0 && sample.is_finite() => sample,
            // It is refused by its own key.
            _ => 1.0,
        };
        let numbers = |number: f64| toml::Value::Array(vec![toml::Value::Float(number); count]);
        let mut table = |name: &str, entries: Vec<(&str, toml::Value)>| {
            let entries = entries.into_iter().map(|(key, value)| (key.to_owned(), value));
            values.entry(name).or_insert_with(|| toml::Value::Table(entries.collect()));
        };
        table("system", vec![("mass", numbers(1.0))]);
        table("initial", vec![("position", numbers(0.0))]);
        table("time", vec![("step", toml::Value::Float(step)), ("steps", toml::Value::Integer(1))]);
        Self::from_document(document.with_values(&values))
    }
}

impl Controller {
    /// Reads `[controller]`, or any number of `[[controller]]`.
    pub(super) fn read_all(
        value: &Value<'_>,
        (system, time): (&System, &TimeGrid),
        document: &Document,
    ) -> Result<Vec<Self>, InputError> {
        let read = |table: &Table<'_>| Self::read(table, (system, time), document);
        if value.is_table() {
            return Ok(vec![read(&value.table()?)?]);
        }
        let tables = value.list("a table headed [controller], or tables headed [[controller]]")?;
        tables.iter().map(|table| read(&table.table()?)).collect()
    }

    fn read(
        table: &Table<'_>,
        (system, time): (&System, &TimeGrid),
        document: &Document,
    ) -> Result<Self, InputError> {
        table.allow(&[
            "kind",
            "form",
            "measures",
            "setpoint",
            "feed_forward",
            "drives",
            "kp",
            "ki",
            "lambda",
            "kd",
            "mu",
            "setpoint_weights",
            "derivative",
            "derivative_filter",
            "integral_time",
            "derivative_time",
            "filter_ratio",
            "sample",
            "delay",
            "limits",
            "rate_limit",
            "anti_windup",
            "quantise",
            "noise",
        ])?;
        if let Some(kind) = table.optional("kind") {
            kind.choice(&[("fractional-pid", ())])?;
        }
        let count = system.coordinates();
        let names = |letter: char| (0..count).map(move |index| format!("{letter}{index}"));
        let value = table.required("measures")?;
        if let Some(name) = names('p').find(|name| system.parameters.contains_key(name)) {
            return Err(value.error(Problem::Incompatible {
                with: format!("a parameter with the name `{name}`"),
                allowed: "another name of the parameter: here it is a momentum".to_owned(),
            }));
        }
        let symbols = system.symbols();
        let of_state = symbols.clone().with_variables(names('q')).with_variables(names('p'));
        let measures = value.expression(&of_state)?;
        let of_time = symbols.with_time();
        let setpoint = Setpoint::read(&table.required("setpoint")?, &of_time, document)?;
        let feed_forward =
            table.optional("feed_forward").map(|value| value.expression(&of_time)).transpose()?;
        let drives = Pattern::read(&table.required("drives")?, count)?;

        let value = table.required("sample")?;
        let sample = value.positive()?;
        let (steps, rest) = in_steps(sample, time.step);
        // Steps that differ have no multiples, and no controllers.
        if time.grid.is_none() && (steps < 1.0 || rest != 0.0) {
            return Err(value.out_of_range(format!("a multiple of `time.step` = {}", time.step)));
        }
        let delay = match table.optional("delay") {
            None => 0.0,
            Some(value) => {
                let delay = not_negative(&value)?;
                let (steps, _) = in_steps(delay, time.step);
                if steps > (1u64 << 53) as f64 {
                    return Err(value.out_of_range("at most 2^53 steps"));
                }
                delay
            }
        };
        let settings = read_settings(table, sample)?;
        let quantise = match table.optional("quantise") {
            None => Quantise::default(),
            Some(value) => {
                let table = value.table()?;
                table.allow(&["measure", "output"])?;
                let quantum = |key| table.optional(key).map(|value| value.positive()).transpose();
                let quantise = Quantise { measure: quantum("measure")?, output: quantum("output")? };
                if let Some(output) = quantise.output {
                    let [least, most] = counts_within(output, settings.limits);
                    if least > most {
                        let allowed = "a quantum of which a multiple lies within `limits`";
                        return Err(table.required("output")?.out_of_range(allowed));
                    }
                }
                quantise
            }
        };
        let noise = match table.optional("noise") {
            None => Noise::default(),
            Some(value) => {
                let table = value.table()?;
                table.allow(&["standard_deviation", "seed"])?;
                let standard_deviation = not_negative(&table.required("standard_deviation")?)?;
                let most = usize::try_from(1u64 << 53).unwrap_or(usize::MAX);
                let seed = table.optional("seed").map_or(Ok(0), |value| value.whole(0..=most))?;
                Noise { standard_deviation, seed: seed as u64 }
            }
        };
        Ok(Self { measures, setpoint, feed_forward, drives, settings, sample, delay, quantise, noise })
    }

    /// Steps between samples, on a grid of equal steps; `None` if they are not an integer number.
    pub fn steps_between(&self, step: f64) -> Option<u64> {
        let (steps, rest) = in_steps(self.sample, step);
        (steps >= 1.0 && rest == 0.0).then_some(steps as u64)
    }

    /// Delay until the output acts: an integer number of steps, and a fraction of one.
    pub fn delay_in_steps(&self, step: f64) -> (u64, f64) {
        let (steps, rest) = in_steps(self.delay, step);
        (steps as u64, rest)
    }

    /// The keys of `[controller]` from which a parameter of the law may come, the most likely first.
    pub fn keys_of(parameter: &str) -> &'static [&'static str] {
        match parameter {
            "proportional gain" => &["kp"],
            "integral gain" => &["ki", "integral_time", "kp"],
            "integral rate" => &["integral_time"],
            "derivative gain" => &["kd"],
            "derivative time" => &["derivative_time"],
            "filter ratio" => &["filter_ratio"],
            "setpoint weight" => &["setpoint_weights"],
            "lower limit" | "limits" => &["limits"],
            "rate limit" => &["rate_limit"],
            "tracking time" => &["anti_windup.time"],
            "time of the derivative's filter" => &["derivative_filter.time", "derivative_filter"],
            "order of the derivative's filter" => &["derivative_filter.order"],
            "integral order" => &["lambda"],
            "derivative order" => &["mu"],
            _ => &["sample"],
        }
    }

    /// The law with numbers of another precision.
    ///
    /// # Errors
    /// If a number is out of range.
    pub fn law<T: Real>(&self) -> Result<PidLaw<T>, ParameterError> {
        let of = T::of;
        let settings = &self.settings;
        let [lower, upper] = settings.limits.map(of);
        if lower >= upper {
            let allowed = "two numbers that the precision tells apart";
            return Err(ParameterError { parameter: "limits", value: settings.limits[0], allowed });
        }
        let gains = match settings.gains {
            PidGains::Parallel { proportional, integral, derivative } => PidGains::Parallel {
                proportional: of(proportional),
                integral: of(integral),
                derivative: of(derivative),
            },
            PidGains::Series { proportional, integral_rate, derivative_time, filter_ratio } => {
                PidGains::Series {
                    proportional: of(proportional),
                    integral_rate: of(integral_rate),
                    derivative_time: of(derivative_time),
                    filter_ratio: of(filter_ratio),
                }
            }
        };
        PidLaw::new(PidSettings {
            gains,
            integral_order: settings.integral_order,
            derivative_order: settings.derivative_order,
            sample: settings.sample,
            setpoint_weights: settings.setpoint_weights.map(of),
            derivative_of: settings.derivative_of,
            derivative_filter: settings.derivative_filter,
            limits: [lower, upper],
            rate_limit: of(settings.rate_limit),
            anti_windup: settings.anti_windup,
            bumpless: settings.bumpless,
        })
    }
}

fn not_negative(value: &Value<'_>) -> Result<f64, InputError> {
    let number = value.number()?;
    if number >= 0.0 { Ok(number) } else { Err(value.out_of_range("at least 0")) }
}

fn order(table: &Table<'_>, key: &str) -> Result<f64, InputError> {
    let Some(value) = table.optional(key) else { return Ok(1.0) };
    let order = value.number()?;
    if order > 0.0 && order < 2.0 {
        Ok(order)
    } else {
        Err(value.out_of_range("greater than 0 and less than 2"))
    }
}

/// Reads the law from a table.
fn read_settings(table: &Table<'_>, sample: f64) -> Result<PidSettings<f64>, InputError> {
    let number = |key: &str, default: f64| table.optional(key).map_or(Ok(default), |value| value.number());
    let forms = [("parallel", false), ("series", true)];
    let series = table.optional("form").map_or(Ok(false), |value| value.choice(&forms))?;
    let (own, foreign): (&str, &[&str]) = match series {
        true => ("series", &["ki", "kd", "setpoint_weights", "derivative", "derivative_filter"]),
        false => ("parallel", &["integral_time", "derivative_time", "filter_ratio"]),
    };
    if let Some(value) = foreign.iter().find_map(|key| table.optional(key)) {
        return Err(value.key_error(Problem::Incompatible {
            with: format!("`form` = \"{own}\""),
            allowed: format!("only with `form` = \"{}\"", if series { "parallel" } else { "series" }),
        }));
    }
    let proportional = number("kp", 0.0)?;
    let gains = if series {
        let integral_rate =
            table.optional("integral_time").map_or(Ok(0.0), |value| Ok(1.0 / value.positive()?))?;
        let derivative_time =
            table.optional("derivative_time").map_or(Ok(0.0), |value| not_negative(&value))?;
        let filter_ratio = table.optional("filter_ratio").map_or(Ok(10.0), |value| value.positive())?;
        PidGains::Series { proportional, integral_rate, derivative_time, filter_ratio }
    } else {
        PidGains::Parallel { proportional, integral: number("ki", 0.0)?, derivative: number("kd", 0.0)? }
    };
    let setpoint_weights = match table.optional("setpoint_weights") {
        None => [1.0, 0.0],
        Some(value) => pair(&value, "two numbers, of the proportional term and of the derivative")?,
    };
    let derivatives = [("riemann-liouville", DerivativeOf::Values), ("caputo", DerivativeOf::ValuesFromRest)];
    let derivative_of = table
        .optional("derivative")
        .map_or(Ok(DerivativeOf::ValuesFromRest), |value| value.choice(&derivatives))?;
    let derivative_filter = match table.optional("derivative_filter") {
        None => DerivativeFilter::None,
        Some(value) if value.is_table() => {
            let table = value.table()?;
            table.allow(&["time", "order"])?;
            let time = not_negative(&table.required("time")?)?;
            match order(&table, "order")? {
                _ if time == 0.0 => DerivativeFilter::None,
                1.0 => DerivativeFilter::FirstOrder { time },
                order => DerivativeFilter::Fractional { time, order },
            }
        }
        Some(value) => DerivativeFilter::FirstOrder { time: not_negative(&value)? },
    };
    let limits = match table.optional("limits") {
        None => [f64::NEG_INFINITY, f64::INFINITY],
        Some(value) => {
            let [lower, upper] = pair(&value, "two numbers, the least output and the largest")?;
            if lower >= upper {
                return Err(value.out_of_range("a lower limit that is smaller than the upper one"));
            }
            [lower, upper]
        }
    };
    let rate_limit = table.optional("rate_limit").map_or(Ok(f64::INFINITY), |value| value.positive())?;
    let anti_windup = match table.optional("anti_windup") {
        None => AntiWindup::None,
        Some(value) => {
            let table = value.table()?;
            table.allow(&["kind", "time"])?;
            let kinds = [("none", 0), ("back-calculation", 1), ("conditional", 2)];
            let kind = table.required("kind")?.choice(&kinds)?;
            match (kind, table.optional("time")) {
                (1, _) => AntiWindup::BackCalculation { time: table.required("time")?.positive()? },
                (_, Some(time)) => {
                    return Err(time.key_error(Problem::Incompatible {
                        with: "this kind".to_owned(),
                        allowed: "only with `kind` = \"back-calculation\"".to_owned(),
                    }));
                }
                (2, None) => AntiWindup::Conditional,
                _ => AntiWindup::None,
            }
        }
    };
    let settings = PidSettings {
        gains,
        integral_order: order(table, "lambda")?,
        derivative_order: order(table, "mu")?,
        sample: Some(sample),
        setpoint_weights,
        derivative_of,
        derivative_filter,
        limits,
        rate_limit,
        anti_windup,
        bumpless: Bumpless::Whole,
    };
    // The remaining errors are combinations of numbers that leave the range of the scalar.
    match PidLaw::new(settings) {
        Ok(_) => Ok(settings),
        Err(error) => {
            let found = Controller::keys_of(error.parameter).iter().find_map(|key| at(table, key));
            let value = found.map_or_else(|| table.required("sample"), Ok)?;
            Err(value.error(Problem::Unusable { reason: error.to_string() }))
        }
    }
}

/// The value of a key, or of a key in a table under it: `a.b`.
fn at<'a>(table: &Table<'a>, key: &str) -> Option<Value<'a>> {
    match key.split_once('.') {
        None => table.optional(key),
        Some((outer, inner)) => {
            let value = table.optional(outer).filter(|value| value.is_table())?;
            value.table().ok()?.optional(inner)
        }
    }
}

fn pair(value: &Value<'_>, expected: &'static str) -> Result<[f64; 2], InputError> {
    let numbers = value.numbers()?;
    <[f64; 2]>::try_from(numbers).map_err(|numbers| {
        let found = format!("{} numbers", numbers.len());
        value.error(Problem::WrongShape { expected: expected.to_owned(), found })
    })
}

impl Setpoint {
    fn read(
        value: &Value<'_>,
        symbols: &crate::language::expression::Symbols,
        document: &Document,
    ) -> Result<Self, InputError> {
        if !value.is_table() {
            return Ok(Self::Expression(value.expression(symbols)?));
        }
        let table = value.table()?;
        table.allow(&["file"])?;
        let value = table.required("file")?;
        let read = NumberTable::read(&value, document, &["r".to_owned()])?;
        let rows = read.rows.iter().filter_map(|row| Some((*row.first()?, *row.get(1)?))).collect::<Vec<_>>();
        if rows.is_empty() {
            let (expected, found) = ("one row at least".to_owned(), "none".to_owned());
            return Err(value.error(Problem::WrongShape { expected, found }));
        }
        let file = document.resolve(value.text()?).display().to_string();
        Ok(Self::Record { file, rows: Arc::new(rows) })
    }
}

/// `[controller]` in serialised form.
#[derive(Default, Serialize)]
struct Record<'a> {
    kind: &'static str,
    form: &'static str,
    measures: Option<&'a Expression>,
    setpoint: Option<SetpointRecord<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    feed_forward: Option<&'a Expression>,
    drives: Option<&'a Pattern>,
    kp: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    ki: Option<f64>,
    lambda: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    kd: Option<f64>,
    mu: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    setpoint_weights: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    derivative: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    derivative_filter: Option<FilterRecord>,
    #[serde(skip_serializing_if = "Option::is_none")]
    integral_time: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    derivative_time: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    filter_ratio: Option<f64>,
    sample: f64,
    delay: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    limits: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rate_limit: Option<f64>,
    anti_windup: WindupRecord,
    quantise: Quantise,
    noise: Noise,
}

#[derive(Serialize)]
#[serde(untagged)]
enum SetpointRecord<'a> {
    Expression(&'a Expression),
    File { file: &'a str },
}

#[derive(Serialize)]
struct FilterRecord {
    time: f64,
    order: f64,
}

#[derive(Default, Serialize)]
struct WindupRecord {
    kind: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    time: Option<f64>,
}

impl Serialize for Controller {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let settings = &self.settings;
        let mut record = Record {
            kind: "fractional-pid",
            measures: Some(&self.measures),
            setpoint: Some(match &self.setpoint {
                Setpoint::Expression(expression) => SetpointRecord::Expression(expression),
                Setpoint::Record { file, .. } => SetpointRecord::File { file },
            }),
            feed_forward: self.feed_forward.as_ref(),
            drives: Some(&self.drives),
            lambda: settings.integral_order,
            mu: settings.derivative_order,
            sample: self.sample,
            delay: self.delay,
            limits: settings.limits[0].is_finite().then_some(settings.limits),
            rate_limit: settings.rate_limit.is_finite().then_some(settings.rate_limit),
            anti_windup: match settings.anti_windup {
                AntiWindup::None => WindupRecord { kind: "none", time: None },
                AntiWindup::BackCalculation { time } => {
                    WindupRecord { kind: "back-calculation", time: Some(time) }
                }
                AntiWindup::Conditional => WindupRecord { kind: "conditional", time: None },
            },
            quantise: self.quantise,
            noise: self.noise,
            ..Record::default()
        };
        match settings.gains {
            PidGains::Parallel { proportional, integral, derivative } => {
                record.form = "parallel";
                (record.kp, record.ki, record.kd) = (proportional, Some(integral), Some(derivative));
                record.setpoint_weights = Some(settings.setpoint_weights);
                record.derivative = Some(match settings.derivative_of {
                    DerivativeOf::ValuesFromRest => "caputo",
                    DerivativeOf::Values | DerivativeOf::MeasuredRate => "riemann-liouville",
                });
                record.derivative_filter = match settings.derivative_filter {
                    DerivativeFilter::None => None,
                    DerivativeFilter::FirstOrder { time } => Some(FilterRecord { time, order: 1.0 }),
                    DerivativeFilter::Fractional { time, order } => Some(FilterRecord { time, order }),
                };
            }
            PidGains::Series { proportional, integral_rate, derivative_time, filter_ratio } => {
                record.form = "series";
                record.kp = proportional;
                record.integral_time = (integral_rate != 0.0).then(|| 1.0 / integral_rate);
                (record.derivative_time, record.filter_ratio) = (Some(derivative_time), Some(filter_ratio));
            }
        }
        record.serialize(serializer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_whole_steps_to_rounding() {
        assert_eq!(in_steps(0.3, 0.1), (3.0, 0.0));
        assert_eq!(in_steps(0.25, 0.1), (2.0, 0.5));
        assert_eq!(in_steps(0.0, 0.1), (0.0, 0.0));
        assert_eq!(in_steps(1e-3 * 12_345_678.0, 1e-3), (12_345_678.0, 0.0));
    }

    #[test]
    fn noise_is_normal_and_the_same_for_a_seed() {
        let noise = Noise { standard_deviation: 2.0, seed: 7 };
        let numbers: Vec<f64> = (0..20_000).map(|index| noise.at(index)).collect();
        let mean = numbers.iter().sum::<f64>() / 20_000.0;
        let variance = numbers.iter().map(|number| (number - mean).powi(2)).sum::<f64>() / 20_000.0;
        let fourth = numbers.iter().map(|number| (number - mean).powi(4)).sum::<f64>() / 20_000.0;
        assert!(mean.abs() < 0.05 && (variance / 4.0 - 1.0).abs() < 0.04, "{mean} {variance}");
        assert!((fourth / (3.0 * variance * variance) - 1.0).abs() < 0.1, "{fourth}");
        let neighbours: f64 = numbers.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>() / 80_000.0;
        assert!(neighbours.abs() < 0.03, "{neighbours}");
        assert_eq!(numbers[17], noise.at(17));
        assert_ne!(numbers[17], Noise { seed: 8, ..noise }.at(17));
        assert_eq!(Noise::default().at(3), 0.0);
    }
}
