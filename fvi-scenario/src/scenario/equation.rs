//! `[equation]`: fractional differential equations, as coordinates without mass.

use super::initial::InitialState;
use super::matrix::SymmetricMatrix;
use super::own_terms::{OwnTerms, SharedTerms};
use super::parameters::{read_parameters, symbols_of};
use super::system::{Damping, Derivative, ForceQuadrature, System};
use crate::language::document::{Table, Value};
use crate::language::error::{InputError, Problem};
use crate::language::expression::{Expression, Moment, Node, Operator, ParameterNameError, Symbols};
use fvi_core::ParameterError;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;

/// Orders that differ by less are one order: the decimal fractions of a file are rounded.
const SAME: f64 = 1e-12;

/// The largest order: a chain of so many coordinates for one unknown.
const LARGEST_ORDER: f64 = 100.0;

/// Σ_j a_{ij} D^{α_{ij}} x_i = f_i(t, x) for the unknowns x_0 … x_{n−1}.
///
/// A coordinate without mass, damped by D^β with β ≤ 1 and pushed by F, satisfies D^β q = F. The equations
/// are made of such coordinates. With α the largest order of an unknown x and m the smallest whole number ≥
/// α, they are
///
/// ```text
/// y_0 = x ,   y_k' = y_{k+1}   for k = 0 … m − 2 ,   D^{α−m+1} y_{m−1} = R ,
/// R = (f − Σ_j a_j D^{α_j} x) / a ,   α_j < α .
/// ```
///
/// D^k x is y_k for whole k; D^s x for k < s < k + 1 is a coordinate w with D^{k+1−s} w = y_{k+1}, or
/// D^{α−s} w = R where k + 1 ≥ α, from w = 0. Terms of a positive share a_j/a with orders between m − 1 and α
/// are further dampers on y_{m−1}. Source: \[Die10\], lemma 3.13, for Caputo's derivatives of derivatives.
///
/// f may name derivatives D^s x of lower orders, which are such coordinates too, y_k or w. They come next to
/// the unknowns, in the sequence of their names.
///
/// ```
/// # use fvi_scenario::scenario::Scenario;
/// let scenario = Scenario::from_value(&serde_json::json!({
///     "equation": { "order": 1.8, "right": ["1 - x0"], "initial": [0.0, 0.0] },
///     "time": { "end": 5.0, "tolerance": 1e-8 },
/// }))?;
/// // x and x', of which the first is the unknown.
/// assert_eq!((scenario.coordinates(), scenario.written_coordinates()), (2, vec![0]));
/// # Ok::<(), fvi_scenario::language::InputError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Equation {
    /// The left side of each equation, by falling order.
    pub terms: Vec<Vec<Term>>,
    /// f_i(t, x).
    pub right: Vec<String>,
    /// x_i(0), x_i'(0), … of each unknown, as many as its order asks for.
    pub initial: Vec<Vec<f64>>,
    /// The derivatives.
    pub derivative: Derivative,
    /// Named constants of the expressions.
    pub parameters: BTreeMap<String, f64>,
    /// Derivatives that the right sides name.
    pub derivatives: Vec<NamedDerivative>,
    /// What each coordinate is.
    coordinates: Vec<EquationCoordinate>,
    /// The coordinate whose force is the right side of each equation, with 1/a.
    driven: Vec<Vec<(usize, f64)>>,
}

/// A coordinate of the system that an equation stands for: a derivative of an unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EquationCoordinate {
    /// Index of the unknown.
    pub unknown: usize,
    /// The order of this derivative of it; 0 for itself.
    pub derivative: f64,
    /// The order β ≤ 1 of the derivative that it is moved by.
    pub moved: f64,
}

/// One term a D^α x of an equation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Term {
    /// α ≥ 0.
    pub order: f64,
    /// a ≠ 0.
    pub coefficient: f64,
}

/// A derivative of an unknown under a name of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedDerivative {
    /// The name in right sides.
    pub name: String,
    /// Index of the unknown.
    pub of: usize,
    /// Greater than 0 and less than the largest order of the unknown.
    pub order: f64,
}

/// What the coordinates of an equation are made of.
#[derive(Default)]
struct Chains {
    /// Each coordinate, and its initial value.
    coordinates: Vec<(EquationCoordinate, f64)>,
    forces: Vec<Option<Node>>,
    /// Order, coordinate and share of each damper.
    dampers: Vec<(f64, usize, f64)>,
    driven: Vec<Vec<(usize, f64)>>,
    /// Unknown, order and coordinate of each derivative that has a name, and whether it has been made.
    named: Vec<(usize, f64, usize, bool)>,
}

impl Equation {
    /// Reads the table; returns the system and the state it stands for too.
    pub(super) fn read(table: &Table<'_>) -> Result<(Self, System, InitialState), InputError> {
        table.allow(&["order", "terms", "right", "initial", "derivative", "derivatives", "parameters"])?;
        let parameters = match table.optional("parameters") {
            Some(value) => read_parameters(&value)?,
            None => BTreeMap::new(),
        };
        let right_value = table.required("right")?;
        let entries = if right_value.is_text() {
            vec![right_value.clone()]
        } else {
            right_value.list("an expression in quotes for each unknown")?
        };
        let count = entries.len();
        if count == 0 {
            return Err(right_value.out_of_range("one right side at least"));
        }
        let terms = Self::read_terms(table, count)?;
        let symbols = names(&parameters, count).map_err(|name| {
            right_value.error(Problem::Incompatible {
                with: format!("a parameter with the name `{name}`"),
                allowed: format!("another name of the parameter: here `{name}` is an unknown"),
            })
        })?;
        let derivatives = NamedDerivative::read_all(table, (&symbols, &parameters), &terms)?;
        let symbols = symbols.with_variables(derivatives.iter().map(|one| one.name.clone()));
        let right: Vec<Expression> =
            entries.iter().map(|entry| entry.expression(&symbols)).collect::<Result<_, _>>()?;
        let initial = read_initial(&table.required("initial")?, &terms)?;
        let derivative = match table.optional("derivative") {
            Some(value) => value.choice(&[
                ("caputo", Derivative::Caputo),
                ("riemann-liouville", Derivative::RiemannLiouville),
            ])?,
            None => Derivative::Caputo,
        };
        if derivative == Derivative::RiemannLiouville {
            NamedDerivative::check_initial(table, &derivatives, &initial)?;
        }
        let mut chains = Chains::of_unknowns(&initial, &derivatives);
        for (unknown, terms) in terms.iter().enumerate() {
            let mut force = right[unknown].root().clone();
            if derivative == Derivative::RiemannLiouville {
                force = with_initial_forces(force, terms, &initial[unknown])
                    .map_err(|allowed| table.required("initial").map(|value| value.out_of_range(allowed)))
                    .or_else(|error| Err(error?))?;
            }
            chains.add(unknown, terms, &initial[unknown], force);
        }
        let system = chains.system(&right, &parameters).map_err(|error| {
            let reason = error.to_string();
            right_value.error(Problem::Unusable { reason })
        })?;
        let state = InitialState::of_equation(chains.coordinates.iter().map(|&(.., start)| start).collect());
        let equation = Self {
            terms,
            right: right.iter().map(|expression| expression.text().to_owned()).collect(),
            initial,
            derivative,
            parameters,
            derivatives,
            coordinates: chains.coordinates.iter().map(|&(coordinate, _)| coordinate).collect(),
            driven: chains.driven,
        };
        Ok((equation, system, state))
    }

    fn read_terms(table: &Table<'_>, count: usize) -> Result<Vec<Vec<Term>>, InputError> {
        let (given, value) = table.either("order", "terms")?;
        let wrong = |found: usize| Problem::WrongShape {
            expected: format!("{count}, one for each of `equation.right`"),
            found: format!("{found}"),
        };
        if given {
            let one = |value: &Value<'_>| {
                let order = read_order(value, true)?;
                Ok(vec![Term { order, coefficient: 1.0 }])
            };
            if !value.is_list() {
                return Ok(vec![one(&value)?; count]);
            }
            let orders = value.list("orders > 0")?;
            if orders.len() != count {
                return Err(value.error(wrong(orders.len())));
            }
            return orders.iter().map(one).collect();
        }
        let lists = value.list("a list of terms for each equation")?;
        // One equation may have its terms without a list around them.
        if count == 1 && lists.first().is_some_and(Value::is_table) {
            return Ok(vec![Term::read_all(&value)?]);
        }
        if lists.len() != count {
            return Err(value.error(wrong(lists.len())));
        }
        lists.iter().map(Term::read_all).collect()
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.terms.len()
    }

    /// Number of unknowns and derivatives that right sides act on.
    pub fn arguments(&self) -> usize {
        self.unknowns() + self.derivatives.len()
    }

    /// What each coordinate of the system is.
    pub fn coordinates(&self) -> &[EquationCoordinate] {
        &self.coordinates
    }

    /// Adds a constant to the right side of each equation, in the system that the equation stands for.
    pub fn push(&self, system: &mut System, constants: &[f64]) {
        let Some(forces) = &mut system.force else { return };
        for (driven, constant) in self.driven.iter().zip(constants) {
            for &(place, share) in driven {
                let force = &mut forces[place];
                let push = Node::number(constant * share);
                *force = force.with_root(Node::join(Operator::Add, force.root().clone(), push));
            }
        }
    }

    /// The key of an equation that a key of the system it stands for comes from.
    pub(super) fn key(&self, path: &str) -> String {
        let orders = if self.is_plain() { "equation.order" } else { "equation.terms" };
        let index = |rest: &str| rest.trim_matches(['[', ']']).parse::<usize>().ok();
        if let Some(rest) = path.strip_prefix("system.force") {
            return match index(rest).and_then(|row| self.coordinates.get(row)) {
                Some(EquationCoordinate { unknown, .. }) => format!("equation.right[{unknown}]"),
                None => "equation.right".to_owned(),
            };
        }
        let of = |prefix: &str| path == prefix || path.starts_with(&format!("{prefix}."));
        if path.starts_with("system.damping") {
            orders.to_owned()
        } else if of("initial") {
            "equation.initial".to_owned()
        } else if let Some(rest) = path.strip_prefix("system.parameters") {
            format!("equation.parameters{rest}")
        } else if of("system") {
            "equation".to_owned()
        } else {
            path.to_owned()
        }
    }

    /// True if each equation has one term with the factor 1.
    fn is_plain(&self) -> bool {
        self.terms.iter().all(|terms| matches!(terms.as_slice(), [Term { coefficient: 1.0, .. }]))
    }
}

/// Right sides in code: a force on each unknown, passed to the coordinates that it drives, which depends on
/// derivatives with names as well. What code pushes these with is left out.
pub(super) struct RightSides {
    terms: SharedTerms,
    driven: Vec<Vec<(usize, f64)>>,
    /// Room for ∇U − F of the unknowns and its derivative.
    restoring: Vec<f64>,
    slopes: Vec<f64>,
}

impl RightSides {
    /// Those of an equation, as forces on its coordinates.
    pub(super) fn of(equation: &Equation, terms: SharedTerms) -> SharedTerms {
        let count = equation.arguments();
        let (restoring, slopes) = (vec![0.0; count], vec![0.0; count * count]);
        SharedTerms::new(Self { terms, driven: equation.driven.clone(), restoring, slopes })
    }
}

impl OwnTerms for RightSides {
    fn potential(&mut self, _: &[f64]) -> f64 {
        0.0
    }

    fn add_restoring_force(&mut self, moment: Moment<f64>, position: &[f64], restoring: &mut [f64]) {
        let Self { terms, driven, restoring: own, .. } = self;
        own.fill(0.0);
        terms.with(|terms| terms.add_restoring_force(moment, &position[..own.len()], own));
        for (driven, &own) in driven.iter().zip(&*own) {
            driven.iter().for_each(|&(row, factor)| restoring[row] += factor * own);
        }
    }

    fn add_linearisation(
        &mut self,
        moment: Moment<f64>,
        position: &[f64],
        restoring: &mut [f64],
        stiffness: &mut [f64],
    ) {
        let Self { terms, driven, restoring: own, slopes } = self;
        let (count, size) = (own.len(), position.len());
        own.fill(0.0);
        slopes.fill(0.0);
        terms.with(|terms| terms.add_linearisation(moment, &position[..count], own, slopes));
        for ((driven, &own), slopes) in driven.iter().zip(&*own).zip(slopes.chunks(count)) {
            for &(row, factor) in driven {
                restoring[row] += factor * own;
                let entries = stiffness[row * size..].iter_mut().zip(slopes);
                // As of expressions: slopes like that of √x at 0 are left out.
                let finite = entries.filter(|(_, slope)| slope.is_finite());
                finite.for_each(|(entry, slope)| *entry += factor * slope);
            }
        }
    }

    fn take_largest_force(&mut self, largest: &mut [f64]) {
        largest.fill(0.0);
    }
}

impl Serialize for Equation {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        if self.is_plain() {
            let orders: Vec<f64> = self.terms.iter().flatten().map(|term| term.order).collect();
            map.serialize_entry("order", &orders)?;
        } else {
            map.serialize_entry("terms", &self.terms)?;
        }
        map.serialize_entry("right", &self.right)?;
        map.serialize_entry("initial", &self.initial)?;
        map.serialize_entry("derivative", &self.derivative)?;
        if !self.derivatives.is_empty() {
            map.serialize_entry("derivatives", &Named(&self.derivatives))?;
        }
        map.serialize_entry("parameters", &self.parameters)?;
        map.end()
    }
}

/// Derivatives as a table, in their sequence.
struct Named<'a>(&'a [NamedDerivative]);

impl Serialize for Named<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Content {
            of: String,
            order: f64,
        }
        let content = |one: &NamedDerivative| Content { of: format!("x{}", one.of), order: one.order };
        serializer.collect_map(self.0.iter().map(|one| (&one.name, content(one))))
    }
}

impl NamedDerivative {
    /// `derivatives = { name = { of = "x0", order = 0.5 } }`
    fn read_all(
        table: &Table<'_>,
        (symbols, parameters): (&Symbols, &BTreeMap<String, f64>),
        terms: &[Vec<Term>],
    ) -> Result<Vec<Self>, InputError> {
        let mut derivatives: Vec<Self> = Vec::new();
        let Some(value) = table.optional("derivatives") else { return Ok(derivatives) };
        for (name, entry) in value.table()?.entries() {
            let taken = match symbols.allows(name) {
                Ok(()) => parameters.contains_key(name).then(|| "it is a parameter".to_owned()),
                Err(ParameterNameError::Variable) => Some("it may be taken for an unknown".to_owned()),
                Err(error) => Some(error.to_string()),
            };
            if let Some(taken) = taken {
                let reason = format!("this name cannot be a derivative: {taken}");
                return Err(entry.key_error(Problem::Unusable { reason }));
            }
            let content = entry.table()?;
            content.allow(&["of", "order"])?;
            let unknown = content.required("of")?;
            let of = unknown.text()?.strip_prefix('x').and_then(|index| index.parse().ok());
            let Some((of, terms)) = of.and_then(|of: usize| Some((of, terms.get(of)?))) else {
                let last = terms.len() - 1;
                let all = if last == 0 { "\"x0\"".to_owned() } else { format!("\"x0\" … \"x{last}\"") };
                return Err(unknown.out_of_range(format!("an unknown, {all}")));
            };
            let place = content.required("order")?;
            let order = read_order(&place, true)?;
            if order > terms[0].order - SAME {
                return Err(place.out_of_range(format!(
                    "an order greater than 0 and less than {}, the largest of x{of}",
                    terms[0].order
                )));
            }
            if let Some(other) =
                derivatives.iter().find(|other| other.of == of && (other.order - order).abs() < SAME)
            {
                return Err(place.out_of_range(format!("each once: `{}` is this derivative", other.name)));
            }
            derivatives.push(Self { name: name.to_owned(), of, order });
        }
        Ok(derivatives)
    }

    /// Riemann and Liouville's derivatives are Caputo's where the values that they act on are 0.
    fn check_initial(
        table: &Table<'_>,
        derivatives: &[Self],
        initial: &[Vec<f64>],
    ) -> Result<(), InputError> {
        for Self { name, of, order } in derivatives {
            let mut acted_on = initial[*of].iter().enumerate().filter(|&(k, _)| (k as f64) < *order);
            if *order != order.trunc() && acted_on.any(|(_, &value)| value != 0.0) {
                return Err(table.required("initial")?.out_of_range(format!(
                    "0 for the values that `{name}`, the Riemann–Liouville derivative of order {order}, acts on; or `derivative` = \
                     \"caputo\""
                )));
            }
        }
        Ok(())
    }
}

impl Term {
    fn read_all(value: &Value<'_>) -> Result<Vec<Self>, InputError> {
        let mut terms: Vec<Self> = Vec::new();
        for entry in value.list("a list of tables { order, coefficient }")? {
            let table = entry.table()?;
            table.allow(&["order", "coefficient"])?;
            let order = read_order(&table.required("order")?, false)?;
            let factor = table.required("coefficient")?;
            let coefficient = factor.number()?;
            if coefficient == 0.0 {
                return Err(factor.out_of_range("a number other than 0"));
            }
            if terms.iter().any(|term| (term.order - order).abs() < SAME) {
                return Err(table.required("order")?.out_of_range("each order once in an equation"));
            }
            terms.push(Self { order, coefficient });
        }
        terms.sort_by(|one, other| other.order.total_cmp(&one.order));
        if terms.first().is_none_or(|first| first.order == 0.0) {
            return Err(value.out_of_range("one order > 0 at least"));
        }
        Ok(terms)
    }
}

/// A finite order; a whole number where it differs from one by rounding.
fn read_order(value: &Value<'_>, positive: bool) -> Result<f64, InputError> {
    let order = value.number()?;
    let near = if (order - order.round()).abs() < SAME { order.round() } else { order };
    if !(0.0..=LARGEST_ORDER).contains(&near) || (positive && near == 0.0) {
        let least = if positive { "greater than 0" } else { "of 0 at least" };
        return Err(value.out_of_range(format!("an order {least} and at most {LARGEST_ORDER}")));
    }
    Ok(near)
}

/// Number of initial values for an order.
fn derivatives_at_start(order: f64) -> usize {
    order.ceil() as usize
}

/// The unknowns as names, with time and parameters; a name that a parameter has taken.
fn names(parameters: &BTreeMap<String, f64>, count: usize) -> Result<Symbols, String> {
    let names = || (0..count).map(|index| format!("x{index}"));
    match names().find(|name| parameters.contains_key(name)) {
        Some(taken) => Err(taken),
        None => Ok(symbols_of(parameters).with_time().with_variables(names())),
    }
}

fn read_initial(value: &Value<'_>, terms: &[Vec<Term>]) -> Result<Vec<Vec<f64>>, InputError> {
    let wanted: Vec<usize> = terms.iter().map(|terms| derivatives_at_start(terms[0].order)).collect();
    let expected = |unknown: usize| {
        let marks = (0..wanted[unknown].min(4)).map(|k| format!("x{unknown}{}(0)", "'".repeat(k)));
        let dots = if wanted[unknown] > 4 { ", …" } else { "" };
        format!("{}: {}{dots}", wanted[unknown], marks.collect::<Vec<_>>().join(", "))
    };
    let checked = |value: &Value<'_>, unknown: usize, numbers: Vec<f64>| {
        if numbers.len() == wanted[unknown] {
            return Ok(numbers);
        }
        let found = format!("{} for an equation of order {}", numbers.len(), terms[unknown][0].order);
        Err(value.error(Problem::WrongShape { expected: expected(unknown), found }))
    };
    let of_one = |value: &Value<'_>, unknown: usize| {
        let numbers = if value.is_list() { value.numbers()? } else { vec![value.number()?] };
        checked(value, unknown, numbers)
    };
    let flat = !value.is_list() || value.list("")?.iter().all(|entry| !entry.is_list());
    // One unknown may have its values without a list around them.
    if terms.len() == 1 && flat {
        return Ok(vec![of_one(value, 0)?]);
    }
    let entries = value.list("a number for each unknown, or a list [x(0), x'(0), …]")?;
    if entries.len() != terms.len() {
        return Err(value.error(Problem::WrongShape {
            expected: format!("{}, one for each of `equation.right`", terms.len()),
            found: format!("{}", entries.len()),
        }));
    }
    entries.iter().enumerate().map(|(unknown, entry)| of_one(entry, unknown)).collect()
}

/// The right side without what Riemann and Liouville's derivatives have more than Caputo's,
///
/// ```text
/// a_j Σ_k x^(k)(0) t^{k−α_j} / Γ(k + 1 − α_j) ,   k < α_j .
/// ```
///
/// Those of the largest order, or with k − α_j ≤ −1, would push without a bound: what is allowed, then.
fn with_initial_forces(mut force: Node, terms: &[Term], initial: &[f64]) -> Result<Node, String> {
    for (place, &Term { order, coefficient }) in terms.iter().enumerate() {
        if order == order.trunc() {
            continue;
        }
        for (k, &value) in
            initial.iter().enumerate().filter(|&(k, &value)| (k as f64) < order && value != 0.0)
        {
            let power = k as f64 - order;
            if place == 0 || power <= -1.0 {
                return Err(format!(
                    "0 for the values that the Riemann–Liouville derivative of order {order} acts on: of a start at other values \
                     it is unbounded; or `derivative` = \"caputo\""
                ));
            }
            let factor = coefficient * value / libm::tgamma(power + 1.0);
            let text = format!("({factor:?})*t^({power:?})");
            if let Ok(push) = Expression::parse(&text, &Symbols::new().with_time()) {
                force = Node::join(Operator::Subtract, force, push.root().clone());
            }
        }
    }
    Ok(force)
}

impl Chains {
    /// One coordinate for each unknown, and for each derivative that has a name.
    fn of_unknowns(initial: &[Vec<f64>], derivatives: &[NamedDerivative]) -> Self {
        let whole = |unknown, derivative| EquationCoordinate { unknown, derivative, moved: 1.0 };
        let first = |(unknown, values): (usize, &Vec<f64>)| {
            (whole(unknown, 0.0), values.first().copied().unwrap_or_default())
        };
        let named = derivatives.iter().zip(initial.len()..);
        let count = initial.len() + derivatives.len();
        let unknowns = initial.iter().enumerate().map(first);
        Self {
            coordinates: unknowns
                .chain(derivatives.iter().map(|one| (whole(one.of, one.order), 0.0)))
                .collect(),
            forces: vec![None; count],
            named: named.map(|(one, place)| (one.of, one.order, place, false)).collect(),
            ..Self::default()
        }
    }

    /// The coordinate D^`derivative` of an unknown, moved by a derivative of the order `moved`; that of its
    /// name, if it has one.
    fn coordinate(&mut self, unknown: usize, derivative: f64, moved: f64, start: f64) -> usize {
        let is_this = |named: &&mut (usize, f64, usize, bool)| {
            named.0 == unknown && (named.1 - derivative).abs() < SAME
        };
        let made = (EquationCoordinate { unknown, derivative, moved }, start);
        let place = match self.named.iter_mut().find(is_this) {
            Some((.., place, is_made)) => {
                *is_made = true;
                *place
            }
            None => {
                self.coordinates.push(made);
                self.forces.push(None);
                self.coordinates.len() - 1
            }
        };
        self.coordinates[place] = made;
        self.dampers.push((moved, place, 1.0));
        place
    }

    /// The coordinates of one equation, whose right side is `force`.
    fn add(&mut self, unknown: usize, terms: &[Term], initial: &[f64], mut force: Node) {
        let (highest, lower) = (terms[0], &terms[1..]);
        let whole: Vec<usize> = (0..initial.len())
            .map(|k| if k == 0 { unknown } else { self.coordinate(unknown, k as f64, 1.0, initial[k]) })
            .collect();
        let last = whole[whole.len() - 1];
        let below = (initial.len() - 1) as f64;
        for pair in whole.windows(2) {
            self.forces[pair[0]] = Some(Node::variable(pair[1]));
        }
        if whole.len() > 1 {
            self.dampers.push((1.0, unknown, 1.0));
            self.dampers.retain(|&(_, coordinate, _)| coordinate != last);
        }
        self.dampers.push((highest.order - below, last, 1.0));
        self.coordinates[last].0.moved = highest.order - below;
        let beside = |order: f64| order > below;
        // A derivative beside the highest is a coordinate, moved by the right side without dampers.
        let is_named = self.named.iter().any(|&(of, order, ..)| of == unknown && beside(order));
        let is_positive = |term: &Term| term.coefficient / highest.coefficient > 0.0;
        let damps = !is_named && lower.iter().filter(|term| beside(term.order)).all(is_positive);
        let mut driven = vec![(last, highest.coefficient.recip())];
        for term in lower {
            let share = term.coefficient / highest.coefficient;
            if beside(term.order) && damps {
                self.dampers.push((term.order - below, last, share));
                continue;
            }
            let derivative = self.derivative(unknown, term.order, highest, (&whole, &mut driven));
            let part =
                Node::join(Operator::Multiply, Node::number(term.coefficient), Node::variable(derivative));
            force = Node::join(Operator::Subtract, force, part);
        }
        let left: Vec<f64> = self
            .named
            .iter()
            .filter(|&&(of, _, _, is_made)| of == unknown && !is_made)
            .map(|&(_, order, ..)| order)
            .collect();
        for order in left {
            self.derivative(unknown, order, highest, (&whole, &mut driven));
        }
        if highest.coefficient != 1.0 {
            force = Node::join(Operator::Divide, force, Node::number(highest.coefficient));
        }
        for &(place, _) in &driven {
            self.forces[place] = Some(force.clone());
        }
        self.driven.push(driven);
    }

    /// The coordinate that is a derivative of a lower order: one of those of whole orders, or one that the
    /// next of them, or the right side, moves.
    fn derivative(
        &mut self,
        unknown: usize,
        order: f64,
        highest: Term,
        (whole, driven): (&[usize], &mut Vec<(usize, f64)>),
    ) -> usize {
        let k = order.trunc();
        if order == k {
            return whole[k as usize];
        }
        let Some(&next) = whole.get(k as usize + 1) else {
            let place = self.coordinate(unknown, order, highest.order - order, 0.0);
            driven.push((place, highest.coefficient.recip()));
            return place;
        };
        let place = self.coordinate(unknown, order, k + 1.0 - order, 0.0);
        self.forces[place] = Some(Node::variable(next));
        place
    }

    fn system(
        &self,
        right: &[Expression],
        parameters: &BTreeMap<String, f64>,
    ) -> Result<System, ParameterError> {
        let count = self.coordinates.len();
        let mut orders: Vec<f64> = self.dampers.iter().map(|&(order, ..)| order).collect();
        orders.sort_by(f64::total_cmp);
        orders.dedup_by(|one, other| (*one - *other).abs() < SAME);
        let damping = orders.iter().map(|&order| {
            let mut coefficient = vec![0.0; count];
            let alike = self.dampers.iter().filter(|(own, ..)| (own - order).abs() < SAME);
            alike.for_each(|&(_, coordinate, share)| coefficient[coordinate] += share);
            Damping::of_order(order, coefficient)
        });
        let force = self.coordinates.iter().zip(&self.forces).map(|(&(coordinate, _), force)| {
            let force = force.clone().unwrap_or_else(|| Node::number(0.0));
            right[coordinate.unknown].with_root(force)
        });
        Ok(System {
            kinetic: None,
            constraints: Vec::new(),
            linear_momentum: Vec::new(),
            mass: SymmetricMatrix::Diagonal(vec![0.0; count]),
            stiffness: None,
            gyroscopic: None,
            potential: None,
            force: Some(force.collect()),
            force_quadrature: ForceQuadrature::default(),
            parameters: parameters.clone(),
            damping: damping.collect::<Result<_, _>>()?,
            elements: Vec::new(),
            loads: Vec::new(),
            own_terms: None,
            known: None,
            unknowns: Some(right.len()),
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::scenario::Scenario;
    use serde_json::{Value, json};

    fn scenario(equation: Value) -> Scenario {
        Scenario::from_value(&json!({ "equation": equation, "time": { "end": 1.0 } })).unwrap()
    }

    /// The order of each damper with its diagonal.
    fn dampers(scenario: &Scenario) -> Vec<(f64, Vec<f64>)> {
        let terms = scenario.system.damping.iter();
        terms.map(|term| (term.transfer.growth(), term.coefficient.diagonal())).collect()
    }

    /// The force on each coordinate at the time 0.5 and these values.
    fn forces(scenario: &Scenario, at: &[f64]) -> Vec<f64> {
        let moment = crate::language::expression::Moment::inside(0.5);
        scenario.system.force.iter().flatten().map(|force| force.value(moment, at)).collect()
    }

    #[test]
    fn orders_above_one_are_chains_of_derivatives() {
        let one = scenario(json!({ "order": 2.25, "right": "t - x0", "initial": [1.0, 2.0, 3.0] }));
        assert_eq!(one.initial.position, [1.0, 2.0, 3.0]);
        assert_eq!(dampers(&one), [(0.25, vec![0.0, 0.0, 1.0]), (1.0, vec![1.0, 1.0, 0.0])]);
        assert_eq!(forces(&one, &[7.0, 8.0, 9.0]), [8.0, 9.0, 0.5 - 7.0]);
        assert_eq!(one.written_coordinates(), [0]);
        let two =
            scenario(json!({ "order": [1.5, 0.5], "right": ["x1", "x0"], "initial": [[1.0, 2.0], 3.0] }));
        assert_eq!(two.initial.position, [1.0, 3.0, 2.0]);
        assert_eq!(dampers(&two), [(0.5, vec![0.0, 1.0, 1.0]), (1.0, vec![1.0, 0.0, 0.0])]);
        assert_eq!(forces(&two, &[7.0, 8.0, 9.0]), [9.0, 7.0, 8.0]);
    }

    #[test]
    fn terms_are_dampers_or_coordinates_of_their_own() {
        let term = |order: f64, coefficient: f64| json!({ "order": order, "coefficient": coefficient });
        // 2 D^0.75 x + D^0.25 x + 3 x = t
        let damped = json!({ "terms": [term(0.75, 2.0), term(0.25, 1.0), term(0.0, 3.0)], "right": "t", "initial": [1.0] });
        let damped = scenario(damped);
        assert_eq!(dampers(&damped), [(0.25, vec![0.5]), (0.75, vec![1.0])]);
        assert_eq!(forces(&damped, &[4.0]), [(0.5 - 3.0 * 4.0) / 2.0]);
        // D^0.75 x − D^0.25 x = t: w = D^0.25 x from D^0.5 w = t + w.
        let beside = json!({ "terms": [term(0.75, 1.0), term(0.25, -1.0)], "right": "t", "initial": 1.0 });
        let beside = scenario(beside);
        assert_eq!(dampers(&beside), [(0.5, vec![0.0, 1.0]), (0.75, vec![1.0, 0.0])]);
        assert_eq!(forces(&beside, &[4.0, 5.0]), [5.5, 5.5]);
        // x'' + D^0.75 x + x' = t: w = D^0.75 x from D^0.25 w = x'.
        let lower = json!({ "terms": [term(2.0, 1.0), term(0.75, 1.0), term(1.0, 1.0)], "right": "t", "initial": [1.0, 2.0] });
        let lower = scenario(lower);
        assert_eq!(lower.initial.position, [1.0, 2.0, 0.0]);
        assert_eq!(dampers(&lower), [(0.25, vec![0.0, 0.0, 1.0]), (1.0, vec![1.0, 1.0, 0.0])]);
        assert_eq!(forces(&lower, &[4.0, 5.0, 6.0]), [5.0, 0.5 - 5.0 - 6.0, 5.0]);
    }

    #[test]
    fn derivatives_with_names_are_coordinates_next_to_the_unknowns() {
        // D^1.5 x = −x' − 2 D^0.5 x: y_1 = x', and w with D^0.5 w = x'.
        let names = json!({ "w": { "of": "x0", "order": 0.5 }, "v": { "of": "x0", "order": 1 } });
        let one = scenario(
            json!({ "order": 1.5, "right": "-v - 2*w", "initial": [1.0, 3.0], "derivatives": names }),
        );
        let place = |name: &str| {
            let equation = one.equation.as_ref().unwrap();
            1 + equation.derivatives.iter().position(|one| one.name == name).unwrap()
        };
        let (v, w) = (place("v"), place("w"));
        let mut at = [7.0, 0.0, 0.0];
        (at[v], at[w]) = (8.0, 9.0);
        let forces = forces(&one, &at);
        assert_eq!((forces[0], forces[v], forces[w]), (8.0, -26.0, 8.0));
        assert_eq!((one.initial.position[v], one.initial.position[w]), (3.0, 0.0));
        let of_order = |order: f64| dampers(&one).into_iter().find(|term| term.0 == order).unwrap().1;
        assert_eq!((of_order(0.5)[v], of_order(0.5)[w], of_order(1.0)[0]), (1.0, 1.0, 1.0));
        assert_eq!(Scenario::from_value(&one).unwrap().equation, one.equation);
        // Beside the highest order: D^0.9 x + D^0.6 x = w, w = D^0.4 x, as three coordinates moved alike.
        let terms = json!([{ "order": 0.9, "coefficient": 1 }, { "order": 0.6, "coefficient": 1 }]);
        let names = json!({ "w": { "of": "x0", "order": 0.4 } });
        let two = scenario(json!({ "terms": terms, "right": "w", "initial": 1.0, "derivatives": names }));
        assert_eq!(self::forces(&two, &[4.0, 5.0, 6.0]), [5.0 - 6.0; 3]);
        assert_eq!(two.initial.position, [1.0, 0.0, 0.0]);
    }

    #[test]
    fn derivatives_that_cannot_be_named_are_refused_by_their_key() {
        let key = |derivatives: Value, derivative: &str| {
            let keys = json!({
                "order": 1.5, "right": "-x0", "initial": [1, 0], "derivatives": derivatives, "derivative": derivative,
                "parameters": { "k": 1.0 },
            });
            let error =
                Scenario::from_value(&json!({ "equation": keys, "time": { "end": 1.0 } })).unwrap_err();
            error.key().to_owned()
        };
        let of = |name: &str, of: &str, order: f64| json!({ name: { "of": of, "order": order } });
        for name in ["k", "x0", "t", "pi", "sin", "2w", "q0"] {
            assert_eq!(key(of(name, "x0", 0.5), "caputo"), format!("equation.derivatives.{name}"));
        }
        assert_eq!(key(of("w", "x1", 0.5), "caputo"), "equation.derivatives.w.of");
        for order in [0.0, -0.5, 1.5, 1.7] {
            assert_eq!(key(of("w", "x0", order), "caputo"), "equation.derivatives.w.order");
        }
        assert_eq!(key(json!({ "w": { "of": "x0" } }), "caputo"), "equation.derivatives.w");
        let twice = json!({ "v": { "of": "x0", "order": 0.5 }, "w": { "of": "x0", "order": 0.5 } });
        assert!(key(twice, "caputo").starts_with("equation.derivatives."));
        assert_eq!(key(of("w", "x0", 0.5), "riemann-liouville"), "equation.initial");
    }

    #[test]
    fn what_riemann_and_liouville_add_is_a_force() {
        let terms = json!([{ "order": 2, "coefficient": 1 }, { "order": 0.5, "coefficient": 3 }]);
        let equation =
            json!({ "terms": terms, "right": "0", "initial": [1.0, 0.0], "derivative": "riemann-liouville" });
        let force = forces(&scenario(equation), &[1.0, 0.0, 0.0])[1];
        let known = -3.0 / libm::sqrt(0.5 * core::f64::consts::PI);
        assert!((force - known).abs() < 1e-15, "{force} {known}");
    }

    #[test]
    fn what_is_written_is_what_was_read() {
        let one = scenario(
            json!({ "order": 0.5, "right": ["-k*x0", "x0"], "initial": [1, 2], "parameters": { "k": 3 } }),
        );
        let again = Scenario::from_value(&one).unwrap();
        assert_eq!(one.equation, again.equation);
        let written = serde_json::to_value(&one).unwrap();
        assert!(written.get("system").is_none() && written.get("initial").is_none());
        assert_eq!(written["equation"]["order"], json!([0.5, 0.5]));
    }

    #[test]
    fn the_shortest_step_resolves_the_start_that_the_right_side_asks_for() {
        let shortest = |order: f64, right: &str| {
            let equation =
                json!({ "order": order, "right": right, "initial": vec![0.0; order.ceil() as usize] });
            scenario(equation).time.adaptive().unwrap().shortest
        };
        // c h^α is below the tolerance, 1e-6, of the scale 1.
        assert!(1e6 * shortest(0.6, "1e6 - x0").powf(0.6) < 1e-7);
        assert!(shortest(0.6, "1e6 - x0") < 1e-3 * shortest(0.6, "1 - x0"));
        // x' ~ √t of a force like 1/√t.
        assert!(shortest(2.0, "t^(-0.5)").sqrt() < 1e-7);
    }

    #[test]
    fn what_cannot_be_meant_is_refused_by_its_key() {
        let key = |equation: Value| {
            let time = json!({ "end": 1.0 });
            let error = Scenario::from_value(&json!({ "equation": equation, "time": time })).unwrap_err();
            error.key().to_owned()
        };
        assert_eq!(key(json!({ "order": 0, "right": "x0", "initial": 1 })), "equation.order");
        assert_eq!(
            key(json!({ "order": [0.5, -1], "right": ["x0", "x1"], "initial": [1, 1] })),
            "equation.order[1]"
        );
        assert_eq!(
            key(json!({ "order": [0.5], "right": ["x0", "x1"], "initial": [1, 1] })),
            "equation.order"
        );
        assert_eq!(key(json!({ "order": 1.5, "right": "x0", "initial": 1 })), "equation.initial");
        assert_eq!(
            key(json!({ "order": 1.5, "right": ["x0", "x1"], "initial": [[1, 0], 1] })),
            "equation.initial[1]"
        );
        assert_eq!(
            key(json!({ "order": 0.5, "right": ["x0", "x2"], "initial": [1, 1] })),
            "equation.right[1]"
        );
        assert_eq!(
            key(json!({ "order": 0.5, "right": ["x0", "1/x1"], "initial": [1, 0] })),
            "equation.right[1]"
        );
        let riemann = json!({ "order": 0.5, "right": "x0", "initial": 1, "derivative": "riemann-liouville" });
        assert_eq!(key(riemann), "equation.initial");
        let terms = |order: f64, coefficient: f64| json!([{ "order": 1, "coefficient": 1 }, { "order": order, "coefficient": coefficient }]);
        assert_eq!(
            key(json!({ "terms": terms(0.5, 0.0), "right": "x0", "initial": 1 })),
            "equation.terms[1].coefficient"
        );
        assert_eq!(
            key(json!({ "terms": terms(1.0, 1.0), "right": "x0", "initial": 1 })),
            "equation.terms[1].order"
        );
        let named = json!({ "order": 0.5, "right": "x0", "initial": 1, "parameters": { "x0": 2 } });
        assert_eq!(key(named), "equation.right");
    }
}
