//! `[system]`: mass, potential, force, parameters and damping.

use super::matrix::SymmetricMatrix;
use super::own_terms::SharedTerms;
use crate::language::document::{Table, Value};
use crate::language::error::{InputError, Problem};
use crate::language::expression::{Expression, Symbols};
use serde::Serialize;
use std::collections::BTreeMap;

/// d/dt (M q̇) + ∇U(q) = F(t, q) − Σ_m ρ_m D^{β_m} q.
#[derive(Clone, Debug, Serialize)]
pub struct System {
    /// M, symmetric positive definite.
    pub mass: SymmetricMatrix,
    /// U(q); absent: none.
    pub potential: Option<Expression>,
    /// F(t, q), one expression for each coordinate; absent: none.
    pub force: Option<Vec<Expression>>,
    /// How schemes take the work of the part of the force that depends on time alone.
    pub force_quadrature: ForceQuadrature,
    /// Named constants of the expressions.
    pub parameters: BTreeMap<String, f64>,
    /// The damping terms, summed.
    pub damping: Vec<Damping>,
    /// Potential and forces in code, beside those above.
    #[serde(skip)]
    pub own_terms: Option<SharedTerms>,
}

/// One damping term ρ D^β q.
#[derive(Clone, Debug, Serialize)]
pub struct Damping {
    /// β = 2α, the damping order in the equation of motion, 0 ≤ β < 2.
    pub order: f64,
    /// ρ, symmetric positive semidefinite.
    pub coefficient: SymmetricMatrix,
    /// What the derivative acts on.
    pub derivative: Derivative,
}

/// How schemes take the work of the part of a force that depends on time alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ForceQuadrature {
    /// By its exact moments in every step where it jumps, has a kink, or is close to a root; at the nodes elsewhere.
    #[default]
    Moments,
    /// At the nodes of the action's quadrature in every step: the papers' form.
    Nodes,
}

/// What a fractional derivative acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Derivative {
    /// On q itself.
    RiemannLiouville,
    /// On q − q₀ for 0 < β ≤ 1 and on q − q₀ − v₀t for 1 < β < 2.
    Caputo,
}

impl System {
    pub(super) fn read(table: &Table<'_>) -> Result<Self, InputError> {
        table.allow(&["mass", "potential", "force", "force_quadrature", "parameters", "damping"])?;
        let mass_value = table.required("mass")?;
        let mass = SymmetricMatrix::read(&mass_value)?;
        let count = mass.size();
        if count == 0 {
            return Err(mass_value.error(Problem::WrongShape {
                expected: "one coordinate at least".to_owned(),
                found: "none".to_owned(),
            }));
        }
        let mass = mass.positive_definite(&mass_value)?;
        let parameters = match table.optional("parameters") {
            Some(value) => read_parameters(&value)?,
            None => BTreeMap::new(),
        };
        let symbols = symbols(&parameters);
        let coordinates = symbols.clone().with_coordinates(count);
        let potential =
            table.optional("potential").map(|value| value.expression(&coordinates)).transpose()?;
        let timed = symbols.with_time().with_coordinates(count);
        let force = table.optional("force").map(|value| value.expressions(&timed, count)).transpose()?;
        let force_quadrature = match table.optional("force_quadrature") {
            Some(value) => {
                value.choice(&[("moments", ForceQuadrature::Moments), ("nodes", ForceQuadrature::Nodes)])?
            }
            None => ForceQuadrature::default(),
        };
        let damping = match table.optional("damping") {
            Some(value) => value
                .list("a list of tables, each headed [[system.damping]]")?
                .iter()
                .map(|term| Damping::read(&term.table()?, count))
                .collect::<Result<_, _>>()?,
            None => Vec::new(),
        };
        Ok(Self { mass, potential, force, force_quadrature, parameters, damping, own_terms: None })
    }

    /// Number of coordinates N.
    pub fn coordinates(&self) -> usize {
        self.mass.size()
    }

    /// The parameters as names for further expressions.
    pub fn symbols(&self) -> Symbols {
        symbols(&self.parameters)
    }
}

impl Damping {
    fn read(table: &Table<'_>, count: usize) -> Result<Self, InputError> {
        table.allow(&["order", "coefficient", "derivative"])?;
        let order_value = table.required("order")?;
        let order = order_value.number()?;
        if !(0.0..2.0).contains(&order) {
            return Err(order_value.out_of_range("a damping order 0 ≤ β < 2"));
        }
        let coefficient_value = table.required("coefficient")?;
        let coefficient = SymmetricMatrix::read(&coefficient_value)?;
        if coefficient.size() != count {
            return Err(coefficient_value.error(Problem::WrongShape {
                expected: format!("{count} (the number of coordinates, from `system.mass`)"),
                found: format!("{} rows", coefficient.size()),
            }));
        }
        let coefficient = coefficient.positive_semidefinite(&coefficient_value)?;
        let derivative = match table.optional("derivative") {
            Some(value) => value.choice(&[
                ("caputo", Derivative::Caputo),
                ("riemann-liouville", Derivative::RiemannLiouville),
            ])?,
            None => Derivative::Caputo,
        };
        Ok(Self { order, coefficient, derivative })
    }
}

fn read_parameters(value: &Value<'_>) -> Result<BTreeMap<String, f64>, InputError> {
    let mut parameters = BTreeMap::new();
    for (name, entry) in value.table()?.entries() {
        Symbols::new()
            .with_parameter(name, 0.0)
            .map_err(|error| entry.key_error(Problem::ParameterName(error)))?;
        parameters.insert(name.to_owned(), entry.number()?);
    }
    Ok(parameters)
}

/// The parameters as names; those that cannot be names were refused when they were read.
fn symbols(parameters: &BTreeMap<String, f64>) -> Symbols {
    parameters.iter().fold(Symbols::new(), |symbols, (name, &value)| {
        symbols.clone().with_parameter(name, value).unwrap_or(symbols)
    })
}
