//! `PLANT.toml`: the input of `fvi tune`, read and checked.

use super::plant::Plant;
use super::relay::needs_scenario;
use super::running_loop::Running;
use fvi_core::DerivativeFilter;
use fvi_scenario::language::document::{Table, Value};
use fvi_scenario::language::{Document, InputError, Problem};
use serde::Serialize;
use std::path::Path;

/// A problem of tuning with all its values checked.
#[derive(Serialize)]
pub struct TuningProblem {
    /// Title of the pictures.
    pub title: Option<String>,
    /// The plant.
    pub plant: Plant,
    /// What is known of the controller.
    pub controller: Structure,
    /// What the loop must satisfy.
    pub specification: Specification,
    /// Amplitude d of a relay experiment for the ultimate point; `None`: no experiment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relay: Option<f64>,
    /// How the loop is run with it, `loop.toml`.
    #[serde(skip)]
    pub(super) running: Running,
    #[serde(skip)]
    document: Document,
}

/// Which terms a controller has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Terms {
    /// K_p + K_i s^{−λ}
    Pi,
    /// K_p + K_d s^μ
    Pd,
    /// All three.
    Pid,
}

impl Terms {
    /// True if the controller has an integral term I^λ.
    pub fn integrates(self) -> bool {
        self != Self::Pd
    }

    /// True if the controller has a derivative term D^μ.
    pub fn differentiates(self) -> bool {
        self != Self::Pi
    }
}

/// `[controller]`: the given part of the controller.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Structure {
    /// Its terms.
    #[serde(rename = "structure")]
    pub terms: Terms,
    /// λ; free if absent.
    pub lambda: Option<f64>,
    /// μ; free if absent.
    pub mu: Option<f64>,
    /// T and ν of the derivative's filter.
    #[serde(skip)]
    pub filter: DerivativeFilter,
    /// b and c.
    pub setpoint_weights: [f64; 2],
    /// Time between samples.
    pub sample: f64,
}

/// A bound on |S| or |T|.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limit {
    /// First frequency of the bound.
    pub from: f64,
    /// Last frequency of the bound; may equal `from`.
    pub to: f64,
    /// The largest value, in decibels.
    pub decibels: f64,
}

/// Specification of the loop.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Specification {
    /// |L(iω_c)| = 1 with a phase margin.
    Crossover(Crossover),
    /// The largest gain for which |S| stays within a bound.
    Sensitivity {
        /// The largest |S|.
        ms: f64,
        /// The largest |T|.
        mt: Option<f64>,
    },
    /// A named rule.
    Rule {
        /// Which.
        name: Rule,
        /// Bound on |S|, for rules with one.
        ms: Option<f64>,
        /// Purpose, for rules with one.
        purpose: Option<Purpose>,
        /// Time constant of the closed loop, for rules with one.
        closed_loop_time: Option<f64>,
    },
}

/// A crossover frequency with phase margin, and further conditions.
#[derive(Clone, Debug, Serialize)]
pub struct Crossover {
    /// ω_c.
    pub crossover: f64,
    /// φ_m in degrees.
    pub phase_margin: f64,
    /// True if the phase is flat there, d arg L/dω = 0.
    pub flat_phase: bool,
    /// Bounds on |S|.
    pub sensitivity: Vec<Limit>,
    /// Bounds on |T|.
    pub complementary: Vec<Limit>,
    /// Bound on |S| over all frequencies.
    pub ms: Option<f64>,
    /// Bound on |T| over all frequencies.
    pub mt: Option<f64>,
    /// Objective for the remaining freedom.
    pub prefer: Preference,
}

/// Objective that selects among the loops that meet a specification.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preference {
    /// The smallest |S(iω_c/10)|: rejection of slow loads.
    Loads,
    /// The smallest Ms.
    Robustness,
}

/// A named rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rule {
    /// Series form with fractional filter, for plants of first order with dead time. \[PV11\]
    PadulaVisioli,
    /// From ultimate gain and period. \[ZN42\]
    ZieglerNichols,
    /// For plants of first or second order with dead time. \[Skogestad03\]
    Simc,
    /// For plants of first order with dead time, for a given time constant of the closed loop.
    /// \[AstromHagglund06\]
    Lambda,
}

/// What a rule is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Purpose {
    /// Steps of the setpoint.
    Setpoint,
    /// Steps of a load at the plant's input.
    Load,
}

impl TuningProblem {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// The first thing in the file that cannot be used, with its place.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        Self::from_document(Document::read(path)?)
    }

    /// Checks a problem already read.
    ///
    /// # Errors
    /// The first thing in the document that cannot be used, with its place.
    pub fn from_document(document: Document) -> Result<Self, InputError> {
        Self::with_plant(document, None)
    }

    /// Checks a problem and the scenario of its plant, both already read; what `plant.scenario` says stands
    /// in messages only.
    ///
    /// # Errors
    /// The first thing in either that cannot be used, with its place.
    pub fn of_scenario(document: Document, scenario: Document) -> Result<Self, InputError> {
        Self::with_plant(document, Some(scenario))
    }

    fn with_plant(document: Document, scenario: Option<Document>) -> Result<Self, InputError> {
        let (title, plant, controller, specification, relay, running) = document.with_root(|root| {
            root.allow(&["title", "plant", "controller", "specification", "relay", "loop"])?;
            let title = root.optional("title").map(|value| value.text().map(str::to_owned)).transpose()?;
            let controller = root.required("controller")?.table()?;
            let specification = root.required("specification")?.table()?;
            let rule = specification.optional("rule");
            let structure = Structure::read(&controller, rule.as_ref())?;
            let plant = root.required("plant")?.table()?;
            let plant = Plant::read(&plant, &document, scenario, &controller.required("sample")?)?;
            let specification = read_specification(&specification, &structure, &plant)?;
            let relay = match root.optional("relay") {
                None => None,
                Some(value) if plant.scenario().is_none() => return Err(value.key_error(needs_scenario())),
                Some(value) => {
                    let table = value.table()?;
                    table.allow(&["amplitude"])?;
                    Some(table.required("amplitude")?.positive()?)
                }
            };
            let running = root
                .optional("loop")
                .map_or(Ok(Running::default()), |value| Running::read(&value, &plant, structure.sample))?;
            Ok((title, plant, structure, specification, relay, running))
        })?;
        Ok(Self { title, plant, controller, specification, relay, running, document })
    }

    /// Title of the pictures: that of the problem, or the name of the file.
    pub fn heading(&self) -> &str {
        self.title.as_deref().unwrap_or_else(|| self.document.name())
    }
}

fn order(table: &Table<'_>, key: &str) -> Result<Option<f64>, InputError> {
    let Some(value) = table.optional(key) else { return Ok(None) };
    let order = value.number()?;
    if order > 0.0 && order < 2.0 {
        Ok(Some(order))
    } else {
        Err(value.out_of_range("greater than 0 and less than 2"))
    }
}

/// The rule that has a filter of its own.
const FILTERS: &str = "padula-visioli";

impl Structure {
    fn read(table: &Table<'_>, rule: Option<&Value<'_>>) -> Result<Self, InputError> {
        table.allow(&["structure", "lambda", "mu", "derivative_filter", "setpoint_weights", "sample"])?;
        let words = [("pi", Terms::Pi), ("pd", Terms::Pd), ("pid", Terms::Pid)];
        let terms = table.optional("structure").map_or(Ok(Terms::Pid), |value| value.choice(&words))?;
        let orders = [("lambda", terms.integrates(), "I"), ("mu", terms.differentiates(), "D")];
        let foreign = |value: &Value<'_>, with: &str, allowed: &str| {
            value.key_error(Problem::Incompatible { with: with.to_owned(), allowed: allowed.to_owned() })
        };
        for (key, used, term) in orders {
            match table.optional(key) {
                Some(value) if rule.is_some() => {
                    return Err(foreign(&value, "a rule", "no order: a rule says the orders itself"));
                }
                Some(value) if !used => {
                    let allowed = format!("only with a `structure` that has {term}");
                    return Err(foreign(&value, "this `structure`", &allowed));
                }
                _ => {}
            }
        }
        let filter = match table.optional("derivative_filter") {
            None => DerivativeFilter::None,
            Some(value) if rule.is_some_and(|rule| rule.text().is_ok_and(|name| name == FILTERS)) => {
                let rule = format!("the rule {FILTERS:?}");
                return Err(foreign(&value, &rule, "no filter: this rule says the filter itself"));
            }
            Some(value) if !terms.differentiates() => {
                let allowed = "only with a `structure` that has D";
                return Err(foreign(&value, "this `structure`", allowed));
            }
            Some(value) if value.table().is_ok() => {
                let table = value.table()?;
                table.allow(&["time", "order"])?;
                let time = table.required("time")?.positive()?;
                match order(&table, "order")?.unwrap_or(1.0) {
                    1.0 => DerivativeFilter::FirstOrder { time },
                    order => DerivativeFilter::Fractional { time, order },
                }
            }
            Some(value) => DerivativeFilter::FirstOrder { time: value.positive()? },
        };
        let setpoint_weights = match table.optional("setpoint_weights") {
            None => [1.0, 0.0],
            Some(value) => <[f64; 2]>::try_from(value.numbers()?).map_err(|numbers| {
                value.error(Problem::WrongShape {
                    expected: "two numbers, of the proportional term and of the derivative".to_owned(),
                    found: format!("{} numbers", numbers.len()),
                })
            })?,
        };
        let (lambda, mu) = (order(table, "lambda")?, order(table, "mu")?);
        let sample = table.required("sample")?.positive()?;
        Ok(Self { terms, lambda, mu, filter, setpoint_weights, sample })
    }
}

/// Reads a bound on the maximum of |S| or |T|, which must be above 1.
fn bound(table: &Table<'_>, key: &str) -> Result<Option<f64>, InputError> {
    let Some(value) = table.optional(key) else { return Ok(None) };
    let bound = value.number()?;
    if bound > 1.0 { Ok(Some(bound)) } else { Err(value.out_of_range("greater than 1")) }
}

fn read_specification(
    table: &Table<'_>,
    structure: &Structure,
    plant: &Plant,
) -> Result<Specification, InputError> {
    if let Some(value) = table.optional("rule") {
        return read_rule(table, &value, structure, plant);
    }
    let Some(crossover) = table.optional("crossover") else {
        let Some(value) = table.optional("ms") else {
            table.required("rule` or `crossover` or `ms")?;
            return Err(table.required("rule")?.out_of_range("a rule, a crossover or ms"));
        };
        table.allow(&["ms", "mt"])?;
        if structure.terms == Terms::Pid {
            return Err(value.error(Problem::Incompatible {
                with: "`structure` = \"pid\"".to_owned(),
                allowed:
                    "a `crossover` and a `phase_margin` beside it; alone it decides a \"pi\" or a \"pd\""
                        .to_owned(),
            }));
        }
        let Some(ms) = bound(table, "ms")? else { return Err(value.out_of_range("greater than 1")) };
        return Ok(Specification::Sensitivity { ms, mt: bound(table, "mt")? });
    };
    table.allow(&[
        "crossover",
        "phase_margin",
        "flat_phase",
        "sensitivity",
        "complementary",
        "ms",
        "mt",
        "prefer",
    ])?;
    let frequency = crossover.positive()?;
    let highest = std::f64::consts::PI / structure.sample;
    if frequency >= highest {
        let allowed = format!("below π/`controller.sample` = {highest:.6}");
        return Err(crossover.out_of_range(allowed));
    }
    check_measured(&crossover, frequency, plant)?;
    let value = table.required("phase_margin")?;
    let phase_margin = value.number()?;
    if !(phase_margin > 0.0 && phase_margin < 180.0) {
        return Err(value.out_of_range("degrees, greater than 0 and less than 180"));
    }
    let flat_phase = match table.optional("flat_phase") {
        None => false,
        Some(value) => {
            let flat = value.truth()?;
            let fixed = match structure.terms {
                Terms::Pi => structure.lambda.map(|_| "lambda"),
                Terms::Pd => structure.mu.map(|_| "mu"),
                Terms::Pid => None,
            };
            if let (true, Some(key)) = (flat, fixed) {
                return Err(value.error(Problem::Incompatible {
                    with: format!("`controller.{key}`"),
                    allowed: format!(
                        "an order that is free: two gains are decided by `crossover` and `phase_margin`, and `{key}` by this"
                    ),
                }));
            }
            flat
        }
    };
    let limits = |key: &str| table.optional(key).map_or(Ok(Vec::new()), |value| read_limits(&value, plant));
    // Bounds on |S| already limit the effect of loads.
    let says_loads = !structure.terms.integrates() || table.optional("sensitivity").is_some();
    let default = if says_loads { Preference::Robustness } else { Preference::Loads };
    let words = [("loads", Preference::Loads), ("robustness", Preference::Robustness)];
    let prefer = table.optional("prefer").map_or(Ok(default), |value| value.choice(&words))?;
    Ok(Specification::Crossover(Crossover {
        crossover: frequency,
        phase_margin,
        flat_phase,
        sensitivity: limits("sensitivity")?,
        complementary: limits("complementary")?,
        ms: bound(table, "ms")?,
        mt: bound(table, "mt")?,
        prefer,
    }))
}

/// Checks that a plant was measured at a frequency, if it is a measured one.
fn check_measured(value: &Value<'_>, omega: f64, plant: &Plant) -> Result<(), InputError> {
    match plant.measured() {
        Some(measured) if !plant.is_known_at(omega) => {
            let [low, high] = measured.band;
            Err(value
                .out_of_range(format!("among the frequencies of `plant.response`, {low:.6} to {high:.6}")))
        }
        _ => Ok(()),
    }
}

fn read_limits(value: &Value<'_>, plant: &Plant) -> Result<Vec<Limit>, InputError> {
    let tables = value.list("a list of tables such as [{ at = 0.001, below = -20 }]")?;
    tables
        .iter()
        .map(|value| {
            let table = value.table()?;
            table.allow(&["at", "from", "to", "below"])?;
            let below = table.required("below")?;
            let decibels = below.number()?;
            if let Some(at) = table.optional("at") {
                if let Some(other) = table.optional("from").or_else(|| table.optional("to")) {
                    return Err(other.key_error(Problem::Conflict { other: "at".to_owned() }));
                }
                let omega = at.positive()?;
                check_measured(&at, omega, plant)?;
                return Ok(Limit { from: omega, to: omega, decibels });
            }
            let (begin, to) = (table.required("from")?, table.required("to")?);
            let (from, last) = (begin.positive()?, to.positive()?);
            check_measured(&begin, from, plant)?;
            check_measured(&to, last, plant)?;
            if last < from {
                return Err(to.out_of_range("a frequency that is not below `from`"));
            }
            Ok(Limit { from, to: last, decibels })
        })
        .collect()
}

fn read_rule(
    table: &Table<'_>,
    value: &Value<'_>,
    structure: &Structure,
    plant: &Plant,
) -> Result<Specification, InputError> {
    let rules = [
        (FILTERS, Rule::PadulaVisioli),
        ("ziegler-nichols", Rule::ZieglerNichols),
        ("simc", Rule::Simc),
        ("lambda", Rule::Lambda),
    ];
    let name = value.choice(&rules)?;
    let needs = |allowed: &str| {
        Err(value.error(Problem::Incompatible {
            with: "this plant or structure".to_owned(),
            allowed: allowed.to_owned(),
        }))
    };
    let (mut ms, mut purpose, mut closed_loop_time) = (None, None, None);
    let first = plant.first_order();
    match name {
        Rule::PadulaVisioli => {
            table.allow(&["rule", "ms", "purpose"])?;
            let known = table.required("ms")?;
            ms = Some(known.number()?);
            if !matches!(ms, Some(1.4 | 2.0)) {
                return Err(known.out_of_range("1.4 or 2.0, which the rule has constants for"));
            }
            let words = [("setpoint", Purpose::Setpoint), ("load", Purpose::Load)];
            purpose = Some(table.required("purpose")?.choice(&words)?);
            let share = first.map(|plant| plant.dead_time / (plant.dead_time + plant.time));
            // Structure and range of L/(L + T) that the rule was fitted to.
            if structure.terms != Terms::Pid || !share.is_some_and(|share| (0.05..=0.8).contains(&share)) {
                return needs(
                    "`structure` = \"pid\" and a plant with `time_constant` T and `dead_time` L, L/(L + T) from 0.05 to 0.8",
                );
            }
        }
        Rule::ZieglerNichols => {
            table.allow(&["rule"])?;
            if structure.terms == Terms::Pd {
                return needs("`structure` = \"pi\" or \"pid\"");
            }
        }
        Rule::Simc => {
            table.allow(&["rule", "closed_loop_time"])?;
            let fits = match structure.terms {
                Terms::Pi => first.is_some(),
                Terms::Pid => plant.two_time_constants().is_some(),
                Terms::Pd => false,
            };
            if !fits {
                return needs(
                    "\"pi\" for a plant with `time_constant`, \"pid\" for one with two real time constants",
                );
            }
        }
        Rule::Lambda => {
            table.allow(&["rule", "closed_loop_time"])?;
            if structure.terms != Terms::Pi || first.is_none() {
                return needs("\"pi\" for a plant with `time_constant`");
            }
            table.required("closed_loop_time")?;
        }
    }
    if let Some(value) = table.optional("closed_loop_time") {
        closed_loop_time = Some(value.positive()?);
    } else if name == Rule::Simc && plant.dead_time() == 0.0 {
        // Default τ_c = L.
        table.required("closed_loop_time")?;
    }
    Ok(Specification::Rule { name, ms, purpose, closed_loop_time })
}
