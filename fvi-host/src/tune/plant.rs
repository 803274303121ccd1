//! The plant, as a function of s.

use super::margins::Loop;
use super::measured::{self, Measured};
use super::polynomial::polynomial;
use fvi_scenario::language::document::{Table, Value};
use fvi_scenario::language::expression::Moment;
use fvi_scenario::language::{Document, InputError, Problem};
use fvi_scenario::scenario::{Controller, PlantFormula, Quotient, Scenario, read_parameters};
use fvi_simulation::simulation::closed_loop::{OpenLoop, logarithm};
use fvi_simulation::simulation::response::Linearised;
use nalgebra::Complex;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;

/// P(s) e^{−Ls}.
pub struct Plant {
    kind: Kind,
    /// Dead time L in addition to that contained in P.
    dead_time: f64,
    /// Sampling time of its controller.
    sample: f64,
}

enum Kind {
    /// K/(T s + 1)
    FirstOrder { gain: f64, time: f64 },
    /// K/(a s² + b s + 1)
    SecondOrder { gain: f64, coefficients: [f64; 2] },
    /// K Π(s − z_i)/Π(s − p_j), by coefficients from s⁰ on, the last of the denominator 1, and as given.
    PolesZeros { gain: f64, numerator: Vec<f64>, denominator: Vec<f64>, roots: [Vec<[f64; 2]>; 2] },
    /// A formula in s with parameters.
    Formula { formula: PlantFormula, parameters: BTreeMap<String, f64> },
    /// A measured frequency response.
    Measured(Box<Measured>),
    /// A scenario linearised about a position: transfer function from the output of a controller to its
    /// measured value.
    Scenario(Box<ScenarioPlant>),
}

/// A scenario, linearised.
pub struct ScenarioPlant {
    /// The file as named.
    pub file: String,
    /// The scenario without controllers of its own.
    pub scenario: Scenario,
    /// The controller as written in the scenario, with `measures`, `drives` and the sampling time.
    pub controller: Controller,
    /// The scenario's document, and its keys including the controller.
    pub(super) document: Document,
    pub(super) values: toml::Table,
    linearised: Linearised,
    at_rest: Vec<f64>,
    load: Vec<f64>,
    /// ∂y/∂q, ∂y/∂p.
    measure: [Vec<f64>; 2],
}

/// A first-order plant with dead time, K e^{−Ls}/(T s + 1), for which rules exist.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstOrder {
    /// K.
    pub gain: f64,
    /// T.
    pub time: f64,
    /// L.
    pub dead_time: f64,
}

fn not_negative(value: &Value<'_>) -> Result<f64, InputError> {
    let number = value.number()?;
    if number >= 0.0 { Ok(number) } else { Err(value.out_of_range("at least 0")) }
}

fn not_zero(value: &Value<'_>) -> Result<f64, InputError> {
    let number = value.number()?;
    if number != 0.0 { Ok(number) } else { Err(value.out_of_range("a number other than 0")) }
}

/// Poles or zeros: numbers, and [re, im] for a pair re ± i im.
fn read_roots(value: &Value<'_>) -> Result<Vec<[f64; 2]>, InputError> {
    let roots = value.list("a list of numbers, and of [re, im] for pairs")?;
    let read = |root: &Value<'_>| {
        if !root.is_list() {
            return Ok([root.number()?, 0.0]);
        }
        match root.numbers()?[..] {
            [re, im] if im != 0.0 => Ok([re, im]),
            _ => Err(root.out_of_range("[re, im] with im other than 0, for the pair re ± i im")),
        }
    };
    roots.iter().map(read).collect()
}

impl Plant {
    /// Reads `[plant]`; `scenario` is that of the plant if it has been read already, `sample` the sampling
    /// time of its controller.
    ///
    /// # Errors
    /// The first invalid entry of the table, or of the scenario that it names.
    pub(super) fn read(
        table: &Table<'_>,
        document: &Document,
        scenario: Option<Document>,
        sample: &Value<'_>,
    ) -> Result<Self, InputError> {
        let dead_time = table.optional("dead_time").map_or(Ok(0.0), |value| not_negative(&value))?;
        let forms =
            ["time_constant", "time_constants", "frequency", "poles", "transfer", "response", "scenario"];
        let mut given = forms.iter().filter(|form| table.optional(form).is_some());
        let form = match given.next() {
            Some(&form) => form,
            None => {
                table.required(&forms.join("` or `"))?;
                forms[0]
            }
        };
        if let Some(other) = given.next() {
            let other = table.required(other)?;
            return Err(other.key_error(Problem::Conflict { other: format!("plant.{form}") }));
        }
        let gain = || table.optional("gain").map_or(Ok(1.0), |value| not_zero(&value));
        let of_controller = sample;
        let sample = of_controller.positive()?;
        let kind = match form {
            "time_constant" => {
                table.allow(&["gain", "time_constant", "dead_time"])?;
                Kind::FirstOrder { gain: gain()?, time: table.required(form)?.positive()? }
            }
            "time_constants" => {
                table.allow(&["gain", "time_constants", "dead_time"])?;
                let value = table.required(form)?;
                let times = value.numbers()?;
                let [first, second] = <[f64; 2]>::try_from(times)
                    .ok()
                    .filter(|times| times.iter().all(|&time| time > 0.0))
                    .ok_or_else(|| value.out_of_range("two positive numbers"))?;
                Kind::SecondOrder { gain: gain()?, coefficients: [first * second, first + second] }
            }
            "frequency" => {
                table.allow(&["gain", "frequency", "damping", "dead_time"])?;
                let frequency = table.required(form)?.positive()?;
                let damping = table.required("damping")?.number()?;
                let coefficients = [frequency.powi(-2), 2.0 * damping / frequency];
                Kind::SecondOrder { gain: gain()?, coefficients }
            }
            "poles" => {
                table.allow(&["gain", "poles", "zeros", "dead_time"])?;
                let value = table.required(form)?;
                let poles = read_roots(&value)?;
                let zeros = table.optional("zeros").map_or(Ok(Vec::new()), |value| read_roots(&value))?;
                let gain = gain()?;
                let [numerator, denominator] = [polynomial(&zeros, gain), polynomial(&poles, 1.0)];
                if numerator.len() >= denominator.len() {
                    return Err(value.out_of_range("more poles than `zeros`, pairs counted twice"));
                }
                Kind::PolesZeros { gain, numerator, denominator, roots: [zeros, poles] }
            }
            "transfer" => {
                table.allow(&["transfer", "parameters", "dead_time"])?;
                let parameters = table.optional("parameters");
                let parameters = parameters.map_or(Ok(BTreeMap::new()), |value| read_parameters(&value))?;
                let formula = PlantFormula::read(&table.required(form)?, &parameters)?;
                Kind::Formula { formula, parameters }
            }
            "response" => {
                let given = table.optional("dead_time").map(|_| dead_time);
                let measured = Measured::read(table, &table.required(form)?, given)?;
                let dead_time = measured.dead_time();
                return Ok(Self { kind: Kind::Measured(Box::new(measured)), dead_time, sample });
            }
            _ => {
                table.allow(&["scenario", "measures", "drives", "position", "dead_time"])?;
                let of_file = match scenario {
                    Some(scenario) => scenario,
                    None => {
                        let file = table.required("scenario")?;
                        let name = file.text()?;
                        Document::read(&document.resolve(name))
                            .map_err(|error| refused(&file, name, &error))?
                    }
                };
                Kind::Scenario(Box::new(ScenarioPlant::read(table, of_file, of_controller, dead_time)?))
            }
        };
        Ok(Self { kind, dead_time, sample })
    }

    /// P(s) e^{−Ls} and the logarithm of its denominator, ln D(s), for Re s ≥ 0 and Im s ≥ 0; `None` where
    /// the plant has no value.
    pub fn at(&self, s: Complex<f64>) -> Option<OpenLoop> {
        let later = (s * -self.dead_time).exp();
        let of = |numerator: Complex<f64>, denominator: Complex<f64>| OpenLoop {
            value: numerator / denominator * later,
            log_denominator: logarithm(denominator),
        };
        Some(match &self.kind {
            Kind::FirstOrder { gain, time } => of(Complex::new(*gain, 0.0), s * *time + 1.0),
            Kind::SecondOrder { gain, coefficients: [a, b] } => {
                of(Complex::new(*gain, 0.0), s * s * *a + s * *b + 1.0)
            }
            Kind::PolesZeros { gain, roots: [zeros, poles], .. } => {
                let product = |roots: &[[f64; 2]], first: f64| {
                    roots.iter().fold(Complex::new(first, 0.0), |product, &[re, im]| match im {
                        0.0 => product * (s - re),
                        _ => product * ((s - re) * (s - re) + im * im),
                    })
                };
                of(product(zeros, *gain), product(poles, 1.0))
            }
            Kind::Formula { formula, .. } => {
                let [value, log_denominator] = formula.at(s);
                OpenLoop { value: value * later, log_denominator }
            }
            Kind::Measured(measured) => {
                let (value, log_denominator) = measured.at(s);
                OpenLoop { value: value * later, log_denominator }
            }
            Kind::Scenario(plant) => {
                let (value, log_denominator) = plant.at(s)?;
                OpenLoop { value: value * later, log_denominator }
            }
        })
    }

    /// The sum of all dead times.
    pub fn dead_time(&self) -> f64 {
        self.dead_time
            + match &self.kind {
                Kind::Formula { formula, .. } => formula.dead_time(),
                _ => 0.0,
            }
    }

    /// The plant as a first-order one, if it is given in that form.
    pub fn first_order(&self) -> Option<FirstOrder> {
        match self.kind {
            Kind::FirstOrder { gain, time } => Some(FirstOrder { gain, time, dead_time: self.dead_time }),
            _ => None,
        }
    }

    /// The plant with all its dead time, the last coefficient of the denominator 1; `None` where it is no
    /// quotient of polynomials with more poles than zeros.
    pub(super) fn quotient(&self) -> Option<Quotient> {
        let of = |numerator: Vec<f64>, denominator: Vec<f64>, within: f64| {
            let last = *denominator.last()?;
            let monic = |part: Vec<f64>| part.into_iter().map(|number| number / last).collect();
            let dead_time = self.dead_time + within;
            let is_proper = numerator.len() < denominator.len() && dead_time >= 0.0;
            is_proper.then(|| Quotient {
                numerator: monic(numerator),
                denominator: monic(denominator),
                dead_time,
            })
        };
        match &self.kind {
            Kind::FirstOrder { gain, time } => of(vec![*gain], vec![1.0, *time], 0.0),
            Kind::SecondOrder { gain, coefficients: [a, b] } => of(vec![*gain], vec![1.0, *b, *a], 0.0),
            Kind::PolesZeros { numerator, denominator, .. } => {
                of(numerator.clone(), denominator.clone(), 0.0)
            }
            Kind::Formula { formula, .. } => {
                let Quotient { numerator, denominator, dead_time } = formula.quotient()?;
                of(numerator, denominator, dead_time)
            }
            Kind::Measured(measured) => {
                let Quotient { numerator, denominator, .. } = measured.quotient()?;
                of(numerator, denominator, 0.0)
            }
            Kind::Scenario(_) => None,
        }
    }

    /// K, T₁ ≥ T₂ and L of a plant with two time constants.
    pub fn two_time_constants(&self) -> Option<(f64, [f64; 2])> {
        let Kind::SecondOrder { gain, coefficients: [a, b] } = self.kind else { return None };
        let discriminant = b * b - 4.0 * a;
        if discriminant < -1e-12 * b * b || b <= 0.0 {
            return None;
        }
        let first = 0.5 * (b + libm::sqrt(discriminant.max(0.0)));
        Some((gain, [first, a / first]))
    }

    /// The scenario behind it.
    pub fn scenario(&self) -> Option<&ScenarioPlant> {
        match &self.kind {
            Kind::Scenario(plant) => Some(plant),
            _ => None,
        }
    }

    /// What is known of it by measurement.
    pub(super) fn measured(&self) -> Option<&Measured> {
        match &self.kind {
            Kind::Measured(measured) => Some(measured),
            _ => None,
        }
    }

    /// True for all frequencies but those at which a measured plant was not measured.
    pub(super) fn is_known_at(&self, omega: f64) -> bool {
        self.measured().is_none_or(|measured| (measured.band[0]..=measured.band[1]).contains(&omega))
    }

    /// Sign that the gains must have for a stable loop: D + C N must not change its sign between s = 0 and
    /// infinity, for P = N/D.
    pub fn sign(&self) -> f64 {
        let scale = self.scale();
        let at = |s: f64| self.at(Complex::new(s, 0.0));
        let turned = |plant: OpenLoop| libm::cos(plant.log_denominator.im);
        let (Some(low), Some(high)) = (at(1e-4 * scale), at(1e4 * scale)) else { return 1.0 };
        let sign = low.value.re * turned(low) * turned(high);
        if sign < 0.0 { -1.0 } else { 1.0 }
    }

    /// A characteristic angular frequency of the plant: where its phase is 45° below that at low frequencies;
    /// of one whose phase nowhere is, as of 1/s, a tenth of the inverse of the sampling time.
    pub fn scale(&self) -> f64 {
        match self.kind {
            Kind::FirstOrder { time, .. } => (time + self.dead_time).recip(),
            Kind::SecondOrder { coefficients: [a, _], .. } => (libm::sqrt(a) + self.dead_time).recip(),
            _ => {
                let mut last: Option<Complex<f64>> = None;
                let mut turned = 0.0;
                for index in -540..540 {
                    let omega = libm::exp10(f64::from(index) / 60.0);
                    let Some(value) = self.at(Complex::new(0.0, omega)).map(|plant| plant.value) else {
                        continue;
                    };
                    if let Some(last) = last {
                        let turn = value / last;
                        turned += libm::atan2(turn.im, turn.re);
                    }
                    if turned < -0.25 * std::f64::consts::PI {
                        return omega;
                    }
                    last = Some(value);
                }
                0.1 / self.sample
            }
        }
    }

    /// Ultimate gain and frequency: the lowest angular frequency at which the phase is −180°, and the
    /// proportional gain for which the loop is there at the limit of stability; `None` if there is none.
    pub fn ultimate(&self) -> Option<(f64, f64)> {
        let scale = self.scale();
        let sign = self.sign();
        let open: &Loop<'_> = &|omega| Some(self.at(Complex::new(0.0, omega))?.value * sign);
        let highest = 1e4 * scale;
        let points = super::margins::follow(open, 1e-4 * scale, highest, self.dead_time()).ok()?;
        let found = super::margins::margins(&points, open);
        let omega = *found.phase_crossovers.first()?;
        self.is_known_at(omega).then_some((sign / open(omega)?.norm(), omega))
    }
}

/// The refusal of the scenario that a plant names.
fn refused(file: &Value<'_>, name: &str, error: &InputError) -> InputError {
    file.error(Problem::Refused { file: name.to_owned(), reason: error.to_string() })
}

impl ScenarioPlant {
    fn read(
        table: &Table<'_>,
        of_file: Document,
        sample: &Value<'_>,
        dead_time: f64,
    ) -> Result<Self, InputError> {
        let file = table.required("scenario")?;
        let name = file.text()?;
        let refused = |error: &InputError| refused(&file, name, error);
        let mut values = of_file.values().map_err(|error| refused(&error))?;
        // `measures` and `drives` are read like the keys of a `[controller]`.
        let mut entries = toml::Table::new();
        let (measures, drives) = (table.required("measures")?, table.required("drives")?);
        entries.insert("measures".to_owned(), measures.text()?.into());
        let drives = drives.numbers()?;
        entries.insert("drives".to_owned(), toml::Value::Array(drives.iter().map(|&u| u.into()).collect()));
        entries.insert("setpoint".to_owned(), "0".into());
        entries.insert("sample".to_owned(), sample.number()?.into());
        entries.insert("delay".to_owned(), dead_time.into());
        values.insert("controller".to_owned(), toml::Value::Table(entries));
        let mut scenario =
            Scenario::from_document(of_file.with_values(&values)).map_err(|error| {
                match error.key().strip_prefix("controller.") {
                    Some("sample") => sample.error(error.problem().clone()),
                    Some("delay") => table
                        .required("dead_time")
                        .map_or_else(|other| other, |value| value.error(error.problem().clone())),
                    Some(key) => table
                        .required(key)
                        .map_or_else(|other| other, |value| value.error(error.problem().clone())),
                    None => refused(&error),
                }
            })?;
        let Some(controller) = scenario.controllers.pop() else {
            return Err(file.error(Problem::MissingKey { key: "controller".to_owned() }));
        };
        scenario.controllers.clear();
        let count = scenario.coordinates();
        let position = match table.optional("position") {
            None => scenario.initial.position.clone(),
            Some(value) => {
                let position = value.numbers()?;
                if position.len() != count {
                    let expected = format!("{count} numbers, one for each coordinate");
                    let found = format!("{} numbers", position.len());
                    return Err(value.error(Problem::WrongShape { expected, found }));
                }
                position
            }
        };
        if let Some(row) = scenario.system.massless().first() {
            let reason = format!(
                "coordinate {row} has no mass (`system.mass`); loops are judged about plants of which every coordinate has one"
            );
            return Err(file.error(Problem::Refused { file: name.to_owned(), reason }));
        }
        let linearised = Linearised::new(&scenario, &position).map_err(|error| refused(&error))?;
        let mut load = vec![0.0; count];
        controller.drives.entries.iter().for_each(|&(row, number)| load[row as usize] = number);
        let at_rest: Vec<f64> = position.iter().copied().chain((0..count).map(|_| 0.0)).collect();
        let slope = |index| controller.measures.slope(Moment::inside(0.0), &at_rest, index);
        let measure = [(0..count).map(slope).collect::<Vec<_>>(), (count..2 * count).map(slope).collect()];
        if measure.iter().flatten().any(|slope| !slope.is_finite()) {
            return Err(measures.out_of_range("an expression with a derivative at the position"));
        }
        if measure.iter().flatten().all(|&slope| slope == 0.0) {
            return Err(measures.out_of_range("an expression that changes with the motion at the position"));
        }
        let plant = Self {
            file: name.to_owned(),
            scenario,
            controller,
            document: of_file,
            values,
            linearised,
            at_rest,
            load,
            measure,
        };
        match plant.linearised.transfer(Complex::new(1.0, 0.0), &plant.load) {
            Err(reason) if reason.contains("up to") => Err(file.error(Problem::Unusable { reason })),
            _ => Ok(plant),
        }
    }

    /// The measured value at the position about which it is linearised.
    pub fn rest(&self) -> f64 {
        self.controller.measures.value(Moment::inside(0.0), &self.at_rest)
    }

    /// The force on the coordinates for each unit of output.
    pub fn load(&self) -> &[f64] {
        &self.load
    }

    /// True if its stiffness changes with time.
    pub fn changes_with_time(&self) -> bool {
        self.linearised.changes_with_time()
    }

    /// True if its forces have no derivative at the position about which it is linearised.
    pub fn is_at_a_kink(&self) -> bool {
        self.linearised.is_at_a_kink()
    }

    fn at(&self, s: Complex<f64>) -> Option<(Complex<f64>, Complex<f64>)> {
        let (position, logarithm) = self.linearised.transfer(s, &self.load).ok()?;
        let velocity: Vec<_> = position.iter().map(|q| q * s).collect();
        let momentum = self.linearised.momentum(&velocity)?;
        let [of_position, of_momentum] = &self.measure;
        let sum = |slopes: &[f64], values: &[Complex<f64>]| {
            slopes.iter().zip(values).map(|(slope, value)| value * *slope).sum::<Complex<f64>>()
        };
        Some((sum(of_position, &position) + sum(of_momentum, &momentum), logarithm))
    }
}

/// A plant as written to `tune.json`.
#[derive(Default, Serialize)]
struct Record<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    gain: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    time_constant: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    polynomial: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    zeros: Option<&'a [[f64; 2]]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    poles: Option<&'a [[f64; 2]]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    transfer: Option<&'a PlantFormula>,
    #[serde(skip_serializing_if = "Option::is_none")]
    parameters: Option<&'a BTreeMap<String, f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    scenario: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    measures: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    drives: Option<&'a [f64]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    response: Option<measured::Record<'a>>,
    dead_time: f64,
}

impl Serialize for Plant {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut record = Record { dead_time: self.dead_time, ..Record::default() };
        match &self.kind {
            Kind::FirstOrder { gain, time } => {
                (record.gain, record.time_constant) = (Some(*gain), Some(*time));
            }
            Kind::SecondOrder { gain, coefficients: [a, b] } => {
                (record.gain, record.polynomial) = (Some(*gain), Some([*a, *b, 1.0]));
            }
            Kind::PolesZeros { gain, roots: [zeros, poles], .. } => {
                (record.gain, record.zeros, record.poles) = (Some(*gain), Some(&zeros[..]), Some(&poles[..]));
            }
            Kind::Formula { formula, parameters } => {
                (record.transfer, record.parameters) = (Some(formula), Some(parameters));
            }
            Kind::Measured(measured) => record.response = Some(measured.record()),
            Kind::Scenario(plant) => {
                record.scenario = Some(&plant.file);
                record.measures = Some(plant.controller.measures.text());
                record.drives = Some(&plant.load);
            }
        }
        record.serialize(serializer)
    }
}
