//! Members of a batch: a scenario with other numbers at some of its places.

use super::matrix::SymmetricMatrix;
use super::parameters::{symbols_of, symbols_of_force, symbols_of_potential};
use super::{Amplitude, Damping, Event, Scenario, System};
use crate::language::expression::{Expression, Symbols};
use crate::language::{InputError, Problem, put, value_at};
use fvi_fft::transfer::TransferFunction;

/// A scenario whose numbers at some paths differ from member to member.
///
/// Initial values, parameters of expressions, orders and diagonal coefficients of damping are put into the
/// scenario that has been read; for other paths each member is read from the values of the file. Both give
/// the same scenario.
///
/// ```
/// # use fvi_scenario::scenario::{Members, Scenario};
/// let oscillator = Scenario::from_value(&serde_json::json!({
///     "system": { "mass": [1.0], "potential": "0.5*k*q0^2", "parameters": { "k": 1.0 } },
///     "initial": { "position": [2.0], "momentum": [0.0] },
///     "time": { "step": 0.01, "steps": 1000 },
/// }))?;
/// let members = Members::new(oscillator, ["system.parameters.k", "initial.position[0]"])?;
/// let member = members.member(&[4.0, 0.5])?;
/// assert_eq!((member.system.parameters["k"], member.initial.position[0]), (4.0, 0.5));
/// # Ok::<(), fvi_scenario::language::InputError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Members {
    base: Scenario,
    /// The values of its file.
    values: toml::Table,
    paths: Vec<String>,
    /// The places of the paths; `None` if a member must be read.
    places: Option<Vec<Place>>,
}

/// A place in a scenario that holds a number as it is in the file.
#[derive(Clone, Debug, PartialEq)]
enum Place {
    Position(usize),
    Momentum(usize),
    Velocity(usize),
    Parameter(String),
    /// β of a damping term.
    Order(usize),
    /// Entry of the diagonal ρ of a damping term.
    Coefficient(usize, usize),
}

/// Whole numbers below it are exact.
const EXACT: f64 = 9_007_199_254_740_992.0;

impl Members {
    /// The scenario with numbers that differ at these paths, such as `system.damping[0].order`. The only
    /// entry of a list is also named by the path of the list.
    ///
    /// # Errors
    /// If the scenario has no such place.
    pub fn new<'p>(base: Scenario, paths: impl IntoIterator<Item = &'p str>) -> Result<Self, InputError> {
        if base.equation.is_some() && base.system.own_terms.is_some() {
            let reason = "right sides in code do not take the numbers of members".to_owned();
            return Err(base.error_at("equation.right", Problem::Unusable { reason }));
        }
        let values = base.document().values()?;
        let mut probe = values.clone();
        let mut taken: Vec<String> = Vec::new();
        for path in paths {
            let refused = |reason| base.error_at(path, Problem::Unusable { reason });
            if let Some(name) = path.strip_prefix("system.parameters.")
                && !base.system.parameters.contains_key(name)
            {
                return Err(refused(format!("the scenario has no parameter `{name}`")));
            }
            let alone = format!("{path}[0]");
            let is_list = value_at(&values, path).and_then(toml::Value::as_array);
            let path = match is_list.map(Vec::as_slice) {
                Some([toml::Value::Integer(_) | toml::Value::Float(_)]) => alone,
                Some(list) => {
                    let reason = format!("a list of {} entries: say which, `{alone}`", list.len());
                    return Err(refused(reason));
                }
                None => path.to_owned(),
            };
            put(&mut probe, &path, toml::Value::Integer(0)).map_err(refused)?;
            if taken.contains(&path) {
                return Err(refused("each place once".to_owned()));
            }
            taken.push(path);
        }
        let places = Self::places(&base, &taken);
        Ok(Self { base, values, paths: taken, places })
    }

    /// The scenario that members differ from.
    pub fn base(&self) -> &Scenario {
        &self.base
    }

    /// The paths, in the order of the numbers.
    pub fn paths(&self) -> &[String] {
        &self.paths
    }

    /// The member with these numbers, one for each path.
    ///
    /// # Errors
    /// What is wrong with one of them, with its place in the equivalent file.
    pub fn member(&self, numbers: &[f64]) -> Result<Scenario, InputError> {
        match self.changed(numbers) {
            Some(scenario) => Ok(scenario),
            None => self.read(numbers),
        }
    }

    /// True if members can be run at the same time: their terms in code, if any, can be
    /// [copied](super::OwnTerms::again).
    pub fn are_independent(&self) -> bool {
        self.base.system.own_terms.as_ref().is_none_or(|terms| terms.again().is_some())
    }

    /// The same member, read from the values of the file: its errors show its own numbers.
    ///
    /// # Errors
    /// As [`member`](Self::member).
    pub fn read(&self, numbers: &[f64]) -> Result<Scenario, InputError> {
        let mut values = self.values.clone();
        for (path, &number) in self.paths.iter().zip(numbers) {
            // Some keys take whole numbers only; where others are allowed too, both are the same.
            let is_whole = number.trunc() == number && number.abs() < EXACT && number.to_bits() != 1 << 63;
            let value =
                if is_whole { toml::Value::Integer(number as i64) } else { toml::Value::Float(number) };
            put(&mut values, path, value)
                .map_err(|reason| self.base.error_at(path, Problem::Unusable { reason }))?;
        }
        let document = self.base.document().with_values(&values);
        let Scenario { system, events, history, .. } = &self.base;
        let mut scenario = match &system.known {
            Some(known) => Scenario::knowing(document, known),
            None => Scenario::from_document(document),
        }?;
        if !self.paths.iter().any(|path| path.starts_with("history.")) {
            scenario.history = *history;
        }
        scenario = self.with_own_terms(scenario);
        for (event, own) in scenario.events.iter_mut().zip(events) {
            event.own.clone_from(&own.own);
        }
        Ok(scenario)
    }

    /// A member with the terms in code of the base, its own if there are such.
    fn with_own_terms(&self, mut scenario: Scenario) -> Scenario {
        let terms = self.base.system.own_terms.as_ref();
        scenario.system.own_terms = terms.map(|terms| terms.again().unwrap_or_else(|| terms.clone()));
        scenario
    }

    /// The places of paths in a scenario; `None` if another part of it depends on one of them.
    fn places(base: &Scenario, paths: &[String]) -> Option<Vec<Place>> {
        let Scenario { system, .. } = base;
        let depends = base.is_mechanism()
            || base.equation.is_some()
            || base.sensitivity.is_some()
            || base.time.adaptive().is_some()
            || !base.convolution.starting.is_empty()
            || !system.massless().is_empty();
        if depends {
            return None;
        }
        let places: Vec<Place> = paths.iter().map(|path| Place::of(base, path)).collect::<Option<_>>()?;
        let is_named = places.iter().any(|place| matches!(place, Place::Parameter(_)));
        let of_formula = |index: usize| base.document().has(&format!("system.damping[{index}].kernel"));
        let uses_names = !base.cases.is_empty()
            || !base.controllers.is_empty()
            || base.reference.is_some()
            || base.input.is_some()
            || (0..system.damping.len()).any(of_formula);
        (!(is_named && uses_names)).then_some(places)
    }

    /// The scenario with these numbers put into their places; `None` if it must be read, or they are refused.
    pub fn changed(&self, numbers: &[f64]) -> Option<Scenario> {
        let mut scenario = None;
        self.put(numbers, &mut scenario)?;
        scenario
    }

    /// True if members differ in the initial position and momentum and in parameters of expressions only.
    pub fn differ_in_start_and_parameters(&self) -> bool {
        let is_of_damping = |place: &Place| matches!(place, Place::Order(_) | Place::Coefficient(..));
        self.places.as_ref().is_some_and(|places| !places.iter().any(is_of_damping))
    }

    /// As [`changed`](Self::changed), in the place of another member, if there is one: also of one whose
    /// numbers were refused.
    pub fn put<'s>(&self, numbers: &[f64], member: &'s mut Option<Scenario>) -> Option<&'s Scenario> {
        let places = self.places.as_ref()?;
        if !numbers.iter().all(|number| number.is_finite()) {
            return None;
        }
        // Each member has terms in code of its own.
        if member.is_none() || self.base.system.own_terms.is_some() {
            *member = Some(self.with_own_terms(self.base.clone()));
        }
        let scenario = member.as_mut()?;
        let (mut velocity, mut is_named) = (None, false);
        for (place, &number) in places.iter().zip(numbers) {
            let system = &mut scenario.system;
            match place {
                Place::Position(index) => *scenario.initial.position.get_mut(*index)? = number,
                Place::Momentum(index) => *scenario.initial.momentum.get_mut(*index)? = number,
                Place::Velocity(index) => {
                    let velocity = velocity.get_or_insert_with(|| self.velocity());
                    *velocity.get_mut(*index)? = number;
                }
                Place::Parameter(name) => {
                    *system.parameters.get_mut(name)? = number;
                    is_named = true;
                }
                Place::Order(term) if number > 0.0 && number < 2.0 => {
                    system.damping.get_mut(*term)?.transfer = TransferFunction::power(number).ok()?;
                }
                Place::Coefficient(term, index) if number >= 0.0 => {
                    let Damping { coefficient: SymmetricMatrix::Diagonal(entries), .. } =
                        system.damping.get_mut(*term)?
                    else {
                        return None;
                    };
                    *entries.get_mut(*index)? = number;
                }
                Place::Order(_) | Place::Coefficient(..) => return None,
            }
        }
        if let Some(velocity) = velocity {
            scenario.initial.momentum = scenario.system.momentum_at_start(&velocity);
        }
        if is_named {
            scenario.system.parse_again()?;
            let Scenario { system, events, .. } = &mut *scenario;
            for event in events {
                event.when = Expression::parse(event.when.text(), &Event::symbols(system)).ok()?;
                event.when.root().as_number().is_none().then_some(())?;
            }
        }
        let is_finite = scenario.initial.momentum.iter().all(|number| number.is_finite());
        (is_finite && scenario.check_start().is_ok() && scenario.check_combinations().is_ok())
            .then_some(&*scenario)
    }

    /// `initial.velocity` of the file.
    fn velocity(&self) -> Vec<f64> {
        let given = value_at(&self.values, "initial.velocity").and_then(toml::Value::as_array);
        let number = |value: &toml::Value| value.as_float().or(value.as_integer().map(|whole| whole as f64));
        given.into_iter().flatten().map_while(number).collect()
    }
}

impl Place {
    /// The place of a path that the file gives as a number, if members differ at that place only.
    fn of(base: &Scenario, path: &str) -> Option<Self> {
        let document = base.document();
        if !document.has(path) {
            return None;
        }
        if let Some(name) = path.strip_prefix("system.parameters.") {
            return Some(Self::Parameter(name.to_owned()));
        }
        let index = |text: &str| text.strip_suffix(']')?.parse::<usize>().ok();
        for (key, place) in [
            ("position[", Self::Position as fn(usize) -> Self),
            ("momentum[", Self::Momentum),
            ("velocity[", Self::Velocity),
        ] {
            if let Some(rest) = path.strip_prefix("initial.").and_then(|rest| rest.strip_prefix(key)) {
                // The past ends at the position; its file, if there is one, is read with it.
                return (base.initial.past.is_none()).then_some(place(index(rest)?));
            }
        }
        let (term, rest) = path.strip_prefix("system.damping[")?.split_once("].")?;
        let term = term.parse::<usize>().ok()?;
        let has = |key: &str| document.has(&format!("system.damping[{term}].{key}"));
        match rest {
            // A spring has another derivative.
            "order" => {
                let order = base.system.damping.get(term)?.transfer.exponent()?;
                (order != 0.0).then_some(Self::Order(term))
            }
            _ if has("scale") || has("along") => None,
            _ => Some(Self::Coefficient(term, index(rest.strip_prefix("coefficient[")?)?)),
        }
    }
}

impl System {
    /// Parses the expressions again, for other values of the parameters; `None` if that is refused.
    fn parse_again(&mut self) -> Option<()> {
        let (count, parameters) = (self.coordinates(), &self.parameters);
        let again = |expression: &mut Expression, symbols: &Symbols| {
            *expression = Expression::parse(expression.text(), symbols).ok()?;
            Some(())
        };
        if let Some(potential) = &mut self.potential {
            again(potential, &symbols_of_potential(parameters, count))?;
        }
        if let Some(force) = &mut self.force {
            let symbols = symbols_of_force(parameters, count);
            force.iter_mut().try_for_each(|component| again(component, &symbols))?;
        }
        for element in &mut self.elements {
            let width = element.coordinates.first().map_or(0, Vec::len);
            let names = (0..width).map(|index| format!("x{index}"));
            again(&mut element.potential, &symbols_of(parameters).with_variables(names))?;
        }
        for load in &mut self.loads {
            if let Amplitude::Expression(amplitude) = &mut load.amplitude {
                again(amplitude, &symbols_of(parameters).with_time())?;
            }
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn scenario(more: Value) -> Scenario {
        let mut value = json!({
            "system": {
                "mass": [[2.0, 0.3], [0.3, 1.0]],
                "potential": "0.5*k*q0^2 + c*q1^4",
                "force": ["a*sin(t)", "-d*v1"],
                "parameters": { "k": 1, "c": 0.5, "a": 0.2, "d": 0.1 },
                "damping": [
                    { "order": 0.5, "coefficient": [0.1, 0.2] },
                    { "order": 1.5, "coefficient": [[0.1, 0.0], [0.0, 0.1]] },
                ],
                "load": [{ "pattern": [0.0, 1.0], "amplitude": "a*cos(k*t)" }],
                "element": [{ "potential": "c*(x1 - x0)^4", "coordinates": [[0, 1]] }],
            },
            "initial": { "position": [1.0, 0.0], "velocity": [0.5, 0] },
            "event": [{ "when": "q0 - a" }],
            "time": { "step": 0.05, "steps": 40 },
        });
        value.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        Scenario::from_value(&value).unwrap()
    }

    #[test]
    fn members_are_those_that_would_be_read() {
        let numbers: &[(&[&str], &[f64], bool)] = &[
            (&["initial.position[0]", "initial.position[1]"], &[0.25, -0.0], true),
            (&["initial.velocity[1]"], &[3.0], true),
            (&["system.parameters.k", "system.parameters.a"], &[0.3, 2.0], true),
            (&["system.parameters.c", "system.parameters.d"], &[0.0, 0.7], true),
            (&["system.damping[0].order", "system.damping[0].coefficient[1]"], &[0.75, 0.0], true),
            (&["system.damping[1].order"], &[1.0], true),
            // At order 0 the term is a spring.
            (&["system.damping[0].order"], &[0.0], false),
            (&["system.mass[0][0]"], &[5.0], false),
            (&["system.damping[1].coefficient[0][0]"], &[0.2], false),
            (&["time.step", "time.steps"], &[0.1, 20.0], false),
            (&["convolution.order"], &[2.0], false),
        ];
        for (paths, numbers, direct) in numbers {
            let members = Members::new(scenario(json!({})), paths.iter().copied()).unwrap();
            let changed = members.changed(numbers);
            assert_eq!(changed.is_some(), *direct, "{paths:?}");
            let (one, other) = (members.member(numbers).unwrap(), members.read(numbers).unwrap());
            let text = |scenario: &Scenario| {
                let written = serde_json::to_string(scenario).unwrap();
                written + &format!("{:?} {:?}", scenario.system, scenario.events)
            };
            assert_eq!(text(&one), text(&other), "{paths:?}");
            // In the place of another member, and of one whose numbers were refused.
            let mut place = None;
            for before in [0.25, f64::NAN] {
                let _ = members.put(&vec![before; numbers.len()], &mut place);
                let put = members.put(numbers, &mut place).map(text);
                assert_eq!(put, direct.then(|| text(&other)), "{paths:?}");
            }
        }
    }

    #[test]
    fn one_entry_of_a_list_needs_no_index() {
        let one = Scenario::from_value(&json!({
            "system": { "mass": [1.0], "damping": [{ "order": 0.5, "coefficient": [0.1] }] },
            "time": { "step": 0.05, "steps": 40 },
        }));
        let members = Members::new(one.unwrap(), ["system.damping[0].coefficient"]).unwrap();
        assert_eq!(members.paths(), ["system.damping[0].coefficient[0]"]);
    }

    #[test]
    fn what_a_scenario_does_not_have_is_refused_and_errors_show_the_number() {
        for (path, said) in [
            ("system.parameters.z", "no parameter `z`"),
            ("initial.position[2]", "`initial.position` has 2 entries"),
            ("initial.position", "a list of 2 entries"),
            ("system.damping[2].order", "`system.damping` has 2 entries"),
        ] {
            let error = Members::new(scenario(json!({})), [path]).unwrap_err();
            assert!(error.problem().to_string().contains(said), "{path}: {}", error.problem());
        }
        let paths = ["system.damping[0].order", "system.damping[0].coefficient[0]", "system.parameters.k"];
        for (numbers, key, value) in [
            ([2.5, 0.1, 1.0], "system.damping[0].order", "2.5"),
            ([0.5, -0.1, 1.0], "system.damping[0].coefficient", "[-0.1, 0.2]"),
            ([0.5, 0.1, f64::NAN], "system.parameters.k", "nan"),
        ] {
            let error = Members::new(scenario(json!({})), paths).unwrap().member(&numbers).unwrap_err();
            assert_eq!((error.key(), error.value()), (key, value), "{error}");
        }
        let twice = Members::new(scenario(json!({})), ["time.step", "time.step"]).unwrap_err();
        assert!(twice.problem().to_string().contains("once"), "{}", twice.problem());
    }
}
