//! `[system]`: mass, potential, force, parameters and damping.

use super::element::Element;
use super::gyroscopic::SkewMatrix;
use super::kernel::{read_transfer, remedy_of};
use super::kinetic::Kinetic;
use super::load::Load;
use super::matrix::SymmetricMatrix;
use super::own_terms::SharedTerms;
use super::parameters::{read_parameters, symbols_of, symbols_of_force, symbols_of_potential};
use super::relaxation_matrix::{Pair, RelaxationMatrix};
use super::sparse_matrix::{KnownMatrices, Matrices, SparseMatrix};
use super::waves::Waves;
use crate::language::document::{Table, Value};
use crate::language::error::{InputError, Problem};
use crate::language::expression::{Expression, Symbols};
use fvi_core::ParameterError;
use fvi_fft::transfer::Active;
use fvi_fft::transfer::TransferFunction;
use nalgebra::DMatrix;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;
use std::sync::Arc;

/// d/dt (M q̇) + G q̇ + K q + ∇U(q) + Σ_e ∇U_e(q) = F(t, q, q̇) + Σ_l f_l a_l(t) − Σ_m ρ_m K_m(D) q, K_m(D) =
/// D^{β_m} or of another transfer function.
#[derive(Clone, Debug, Serialize)]
pub struct System {
    /// T(q, v) of the Lagrangian T − U, a polynomial of degree 2 in the velocities, in the variables q_0 …
    /// q_{N−1}, v_0 … v_{N−1}; absent: ½ vᵀ M v.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kinetic: Option<Expression>,
    /// c(q) = 0, in the variables q_0 … q_{N−1}.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub constraints: Vec<Expression>,
    /// a(q₀) of the momentum M v + a at the start; empty without `kinetic`.
    #[serde(skip)]
    pub(super) linear_momentum: Vec<f64>,
    /// M, symmetric and positive definite apart from rows and columns of zeros, which are coordinates without
    /// mass. With `kinetic` that of the initial position.
    pub mass: SymmetricMatrix,
    /// K, symmetric; absent: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<SymmetricMatrix>,
    /// G, skew-symmetric; absent: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gyroscopic: Option<SkewMatrix>,
    /// U(q); absent: none.
    pub potential: Option<Expression>,
    /// F(t, q, v), one expression for each coordinate, in the variables q_0 … q_{N−1}, v_0 … v_{N−1}; absent:
    /// none.
    pub force: Option<Vec<Expression>>,
    /// Quadrature of the part of the force that depends on time alone.
    pub force_quadrature: ForceQuadrature,
    /// Named constants of the expressions.
    pub parameters: BTreeMap<String, f64>,
    /// The damping terms, summed. Terms of the scenario come first; if the kernel of one is a matrix, its
    /// further parts follow after all of them.
    #[serde(serialize_with = "written")]
    pub damping: Vec<Damping>,
    /// U_e: potentials of a few coordinates each.
    #[serde(rename = "element", skip_serializing_if = "Vec::is_empty")]
    pub elements: Vec<Element>,
    /// f_l a_l(t).
    #[serde(rename = "load", skip_serializing_if = "Vec::is_empty")]
    pub loads: Vec<Load>,
    /// Potential and forces in code, in addition to those above.
    #[serde(skip)]
    pub own_terms: Option<SharedTerms>,
    /// Patterns and factors shared with other scenarios.
    #[serde(skip)]
    pub known: Option<KnownMatrices>,
    /// Number of unknowns of the [`Equation`](super::Equation) that this system stands for, its first
    /// coordinates; `None` for a mechanical system.
    #[serde(skip)]
    pub unknowns: Option<usize>,
}

/// One damping term ρ K(D) q.
#[derive(Clone, Debug)]
pub struct Damping {
    /// K(s): s^β with the damping order β = 2α of the equation of motion, 0 ≤ β < 2, or another kernel.
    pub transfer: TransferFunction,
    /// ρ, symmetric positive semidefinite.
    pub coefficient: SymmetricMatrix,
    /// Signal that the derivative acts on.
    pub derivative: Derivative,
    /// The elongations that it acts along in place of coordinates, and ρ for them; `coefficient` is then
    /// zero.
    pub along: Option<Along>,
    /// B and strength if the scenario gives ρ = B diag(strength) Bᵀ.
    pub attached: Option<Attached>,
    /// Factor by which the matrix of a file was multiplied.
    scale: Option<f64>,
    /// The matrix of kernels that this term is a part of, if any.
    matrix: Option<Part>,
}

/// A part of a matrix of kernels: that of one pair of coordinates.
#[derive(Clone, Debug, PartialEq)]
struct Part {
    whole: Arc<Whole>,
    /// True if the part replaces the term in the scenario.
    stands_for_it: bool,
}

/// A matrix of kernels.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
enum Whole {
    Relaxation(RelaxationMatrix),
    Waves(Waves),
}

impl Whole {
    fn notes(&self) -> &[String] {
        match self {
            Self::Relaxation(matrix) => &matrix.notes,
            Self::Waves(waves) => &waves.notes,
        }
    }

    fn active(&self) -> Option<Active> {
        match self {
            Self::Relaxation(matrix) => matrix.active,
            Self::Waves(waves) => waves.active,
        }
    }
}

/// Serialises the terms of the scenario.
fn written<S: Serializer>(terms: &[Damping], serializer: S) -> Result<S::Ok, S::Error> {
    let is_written = |term: &&Damping| term.matrix.as_ref().is_none_or(|part| part.stands_for_it);
    serializer.collect_seq(terms.iter().filter(is_written))
}

/// Elongations of a damping term.
#[derive(Clone, Debug)]
pub struct Along {
    /// g_e(q), in the variables q_0 … q_{N−1}.
    pub elongations: Vec<Expression>,
    /// ρ, symmetric positive semidefinite, for the elongations.
    pub coefficient: SymmetricMatrix,
    /// True if the scenario gives one elongation, and one number.
    is_one: bool,
}

/// Dampers: ρ = B diag(strength) Bᵀ, one column of B for each damper.
#[derive(Clone, Debug, PartialEq)]
pub struct Attached {
    /// The columns of B, each as its nonzero entries (coordinate, number).
    pub columns: Vec<Vec<(u32, f64)>>,
    /// One number ≥ 0 for each column.
    pub strength: Vec<f64>,
    /// The file of B; `None` if B is given by its rows.
    source: Option<String>,
    rows: usize,
}

/// Quadrature of the forces that depend on time alone: forces, loads, sampled inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ForceQuadrature {
    /// By exact moments in every step with a jump, a kink or a nearby root; at the nodes otherwise.
    #[default]
    Moments,
    /// At the nodes of the action's quadrature in every step, as in the papers.
    Nodes,
}

/// Motion on which a fractional derivative acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Derivative {
    /// On q itself.
    RiemannLiouville,
    /// On q − q₀ for 0 < β ≤ 1 and on q − q₀ − v₀t for 1 < β < 2; for other kernels on q − q₀ − v₀t if they
    /// grow faster than s, otherwise on q − q₀.
    Caputo,
}

impl System {
    /// Reads the system; `step` is the step size of a run with equal steps.
    pub(super) fn read(
        table: &Table<'_>,
        shared: Option<&KnownMatrices>,
        step: Option<f64>,
        start: Option<&[f64]>,
    ) -> Result<Self, InputError> {
        table.allow(&[
            "mass",
            "kinetic",
            "constraints",
            "stiffness",
            "gyroscopic",
            "potential",
            "force",
            "force_quadrature",
            "parameters",
            "damping",
            "element",
            "load",
        ])?;
        let mut known = Matrices::sharing(shared);
        let parameters = match table.optional("parameters") {
            Some(value) => read_parameters(&value)?,
            None => BTreeMap::new(),
        };
        let Inertia { kinetic, mass, linear_momentum } =
            Inertia::read(table, &parameters, start, &mut known)?;
        let count = mass.size();
        let stiffness = match table.optional("stiffness") {
            Some(value) => Some(SymmetricMatrix::read(&value, Some(count), &mut known)?),
            None => None,
        };
        let gyroscopic =
            table.optional("gyroscopic").map(|value| SkewMatrix::read(&value, count)).transpose()?;
        // The names of all coordinates are built only if expressions may contain them.
        let potential = table
            .optional("potential")
            .map(|value| value.expression(&symbols_of_potential(&parameters, count)))
            .transpose()?;
        let force = table
            .optional("force")
            .map(|value| value.expressions(&symbols_of_force(&parameters, count), count))
            .transpose()?;
        let constraints = match table.optional("constraints") {
            Some(value) => {
                let symbols = symbols_of(&parameters).with_coordinates(count);
                let constraints = value.list("a list of expressions, each 0 on the constraint")?;
                constraints.iter().map(|c| c.expression(&symbols)).collect::<Result<_, _>>()?
            }
            None => Vec::new(),
        };
        let force_quadrature = match table.optional("force_quadrature") {
            Some(value) => {
                value.choice(&[("moments", ForceQuadrature::Moments), ("nodes", ForceQuadrature::Nodes)])?
            }
            None => ForceQuadrature::default(),
        };
        let element = ("element", "a list of tables, each headed [[system.element]]");
        let elements = tables(table, element, |element| Element::read(element, &parameters, count))?;
        let load = ("load", "a list of tables, each headed [[system.load]]");
        let loads = tables(table, load, |load| Load::read(load, &symbols_of(&parameters), count))?;
        let damping = ("damping", "a list of tables, each headed [[system.damping]]");
        let terms =
            tables(table, damping, |term| Damping::read(term, count, (&parameters, step), &mut known))?;
        let damping = in_order(terms);
        let mass = with_added_mass(mass, &damping, table, &known)?;
        Ok(Self {
            kinetic,
            constraints,
            linear_momentum,
            mass,
            stiffness,
            gyroscopic,
            potential,
            force,
            force_quadrature,
            parameters,
            damping,
            elements,
            loads,
            own_terms: None,
            known: shared.cloned(),
            unknowns: None,
        })
    }

    /// True if it stands for an [`Equation`](super::Equation), whose keys are written in place of its own.
    pub fn stands_for_equation(&self) -> bool {
        self.unknowns.is_some()
    }

    /// The names of what moves in files and expressions: the coordinates q0, q1, …, or the unknowns of an
    /// equation, x0, x1, …
    pub fn names(&self) -> impl Iterator<Item = String> + use<> {
        let (letter, count) = match self.unknowns {
            Some(count) => ('x', count),
            None => ('q', self.coordinates()),
        };
        (0..count).map(move |index| format!("{letter}{index}"))
    }

    /// L_v(q₀, v) = M v + a at the initial position.
    pub(super) fn momentum_at_start(&self, velocity: &[f64]) -> Vec<f64> {
        let mut momentum = self.mass.times(velocity);
        momentum.iter_mut().zip(&self.linear_momentum).for_each(|(p, a)| *p += a);
        momentum
    }

    /// a(q₀) of the momentum M v + a at the start; empty where it is zero.
    pub(super) fn linear_momentum(&self) -> &[f64] {
        &self.linear_momentum
    }

    /// The elongations of all damping terms that act along any, in their order.
    pub fn elongations(&self) -> impl Iterator<Item = &Expression> {
        self.damping.iter().filter_map(|term| term.along.as_ref()).flat_map(|along| &along.elongations)
    }

    /// True if it is a mechanism: a Lagrangian, constraints, or damping along elongations.
    pub fn is_mechanism(&self) -> bool {
        self.kinetic.is_some()
            || !self.constraints.is_empty()
            || self.damping.iter().any(|term| term.along.is_some())
    }

    /// Coordinates without mass, from 0.
    pub fn massless(&self) -> Vec<usize> {
        self.mass.zero_rows()
    }

    /// Number of coordinates N.
    pub fn coordinates(&self) -> usize {
        self.mass.size()
    }

    /// True if a force depends on the velocity, as an expression or in code.
    pub fn has_forces_of_velocity(&self) -> bool {
        self.force_in_words_depends_on_velocity()
            || self.own_terms.as_ref().is_some_and(SharedTerms::depend_on_velocity)
    }

    /// True if a force given as expressions depends on the velocity.
    pub fn force_in_words_depends_on_velocity(&self) -> bool {
        let count = self.coordinates();
        self.force.iter().flatten().any(|component| component.root().has_variable_from(count))
    }

    /// True if the scenario uses any of the keys for large systems.
    pub fn is_large(&self) -> bool {
        self.stiffness.is_some()
            || !self.elements.is_empty()
            || !self.loads.is_empty()
            || self.has_sparse_matrices()
            || self.has_sparse_terms()
    }

    /// True if there are terms in code that state the places of their derivatives.
    pub fn has_sparse_terms(&self) -> bool {
        self.own_terms.as_ref().is_some_and(SharedTerms::are_sparse)
    }

    /// True if mass, stiffness or damping are sparse matrices.
    pub fn has_sparse_matrices(&self) -> bool {
        let coefficients = self.damping.iter().map(|term| &term.coefficient);
        let mut matrices = self.stiffness.iter().chain(coefficients).chain([&self.mass]);
        matrices.any(|matrix| matches!(matrix, SymmetricMatrix::Sparse(_)))
    }

    /// The parameters as names for further expressions.
    pub fn symbols(&self) -> Symbols {
        symbols_of(&self.parameters)
    }
}

impl Damping {
    /// Caputo's derivative of an order, with a diagonal ρ.
    pub(super) fn of_order(order: f64, coefficient: Vec<f64>) -> Result<Self, ParameterError> {
        Ok(Self {
            transfer: TransferFunction::power(order)?,
            coefficient: SymmetricMatrix::Diagonal(coefficient),
            derivative: Derivative::Caputo,
            along: None,
            attached: None,
            scale: None,
            matrix: None,
        })
    }

    fn read(
        table: &Table<'_>,
        count: usize,
        (parameters, step): (&BTreeMap<String, f64>, Option<f64>),
        known: &mut Matrices<'_>,
    ) -> Result<Vec<Self>, InputError> {
        table.allow(&[
            "order",
            "kernel",
            "allow_active",
            "coefficient",
            "scale",
            "attached",
            "strength",
            "derivative",
            "along",
        ])?;
        let derivative = match table.optional("derivative") {
            Some(value) => value.choice(&[
                ("caputo", Derivative::Caputo),
                ("riemann-liouville", Derivative::RiemannLiouville),
            ])?,
            None => Derivative::Caputo,
        };
        if let Some(terms) = Self::read_matrix(table, count, derivative)? {
            return Ok(terms);
        }
        let transfer = read_transfer(table, parameters, step)?;
        // Caputo's derivative of order 0 is the position, not its distance from the start.
        let is_position =
            table.optional("order").is_some_and(|order| order.number().is_ok_and(|order| order == 0.0));
        let derivative = if is_position { Derivative::RiemannLiouville } else { derivative };
        if let Some(value) = table.optional("along") {
            let along = Along::read(&value, table, (parameters, count), known)?;
            let (coefficient, attached) = (SymmetricMatrix::Diagonal(vec![0.0; count]), None);
            let (along, scale, matrix) = (Some(along), None, None);
            return Ok(vec![Self { transfer, coefficient, derivative, along, attached, scale, matrix }]);
        }
        let scale = table.optional("scale");
        let (given, value) = table.either("coefficient", "attached")?;
        let (coefficient, attached, scale) = if given {
            if let Some(strength) = table.optional("strength") {
                return Err(belongs(&strength, "strength", "attached"));
            }
            let mut coefficient = SymmetricMatrix::read(&value, Some(count), known)?;
            if let Some(scale) = &scale {
                coefficient = coefficient.scaled(scale.number()?);
            }
            let scale = scale.map(|scale| scale.number()).transpose()?.filter(|_| value.is_text());
            (coefficient.positive_semidefinite(&value, known)?, None, scale)
        } else {
            if let Some(scale) = scale {
                return Err(belongs(&scale, "scale", "coefficient"));
            }
            let attached = Attached::read(&value, &table.required("strength")?, count)?;
            (attached.coefficient(), Some(attached), None)
        };
        Ok(vec![Self { transfer, coefficient, derivative, along: None, attached, scale, matrix: None }])
    }

    /// The terms of a matrix of kernels, if the kernel is one.
    fn read_matrix(
        table: &Table<'_>,
        count: usize,
        derivative: Derivative,
    ) -> Result<Option<Vec<Self>>, InputError> {
        let Some(value) = table.optional("kernel") else { return Ok(None) };
        let Ok(kernel) = value.table() else { return Ok(None) };
        let files = kernel.optional("relaxation").filter(RelaxationMatrix::is_one);
        if files.is_none() && Waves::of(&kernel).is_none() {
            return Ok(None);
        }
        for key in ["order", "coefficient", "attached", "scale", "strength", "along"] {
            if let Some(other) = table.optional(key) {
                let with = "a kernel that is a matrix of forces over velocities".to_owned();
                let allowed = "the matrix alone: its entries hold forces over velocities".to_owned();
                return Err(other.error(Problem::Incompatible { with, allowed }));
            }
        }
        let allow_active = table.optional("allow_active").map_or(Ok(false), |value| value.truth())?;
        let Some(files) = files else {
            let (whole, pairs) = Waves::read(&kernel, &value, count, allow_active)?;
            return Ok(Some(Self::of_matrix(Whole::Waves(whole), pairs, count, derivative)));
        };
        let (whole, pairs) = RelaxationMatrix::read(&kernel, &files, count)?;
        if let (Some(active), false) = (whole.active, allow_active) {
            return Err(value.out_of_range(format!(
                "a passive kernel: the smallest eigenvalue of this matrix drives the motion at {active}; \
                 `allow_active = true` beside `kernel` admits it{}",
                remedy_of(whole.raise.unwrap_or(f64::INFINITY))
            )));
        }
        Ok(Some(Self::of_matrix(Whole::Relaxation(whole), pairs, count, derivative)))
    }

    /// The terms of a matrix of kernels: E_ii K_ii, and (E_ij + E_ji) K_ij as
    /// (e_i + e_j)(e_i + e_j)ᵀ K_ij + (E_ii + E_jj)(−K_ij), whose matrices are positive semidefinite.
    fn of_matrix(whole: Whole, pairs: Vec<Pair>, count: usize, derivative: Derivative) -> Vec<Self> {
        let whole = Arc::new(whole);
        let terms = pairs.into_iter().flat_map(|((i, j), [transfer, negative])| {
            let mut coefficient = DMatrix::zeros(count, count);
            (coefficient[(i, i)], coefficient[(j, j)]) = (1.0, 1.0);
            let alone = coefficient.clone();
            (coefficient[(i, j)], coefficient[(j, i)]) = (1.0, 1.0);
            [(coefficient, transfer), (alone, negative)].into_iter().take(if i == j { 1 } else { 2 })
        });
        let part = |(index, (coefficient, transfer)): (usize, (DMatrix<f64>, TransferFunction))| Self {
            transfer,
            coefficient: SymmetricMatrix::Dense(coefficient),
            derivative,
            along: None,
            attached: None,
            scale: None,
            matrix: Some(Part { whole: Arc::clone(&whole), stands_for_it: index == 0 }),
        };
        terms.enumerate().map(part).collect()
    }

    /// Sentences on how the numbers of its kernel were amended; the first part of a matrix has all of them.
    pub(super) fn notes(&self) -> &[String] {
        match &self.matrix {
            Some(part) if part.stands_for_it => part.whole.notes(),
            Some(_) => &[],
            None => self.transfer.notes(),
        }
    }

    /// What its kernel adds to the mass.
    fn added_mass(&self) -> Option<&DMatrix<f64>> {
        match self.matrix.as_ref().map(|part| &*part.whole) {
            Some(Whole::Waves(waves)) => waves.added.as_ref(),
            _ => None,
        }
    }

    /// The region where its kernel is not passive; for a matrix of kernels that of the whole.
    pub fn active(&self) -> Option<Active> {
        match &self.matrix {
            Some(part) => part.whole.active(),
            None => self.transfer.active(),
        }
    }
}

/// The mass with what the kernels add to it.
fn with_added_mass(
    mass: SymmetricMatrix,
    damping: &[Damping],
    table: &Table<'_>,
    known: &Matrices<'_>,
) -> Result<SymmetricMatrix, InputError> {
    let is_whole = |term: &&Damping| term.matrix.as_ref().is_some_and(|part| part.stands_for_it);
    let mut added = damping.iter().filter(is_whole).filter_map(Damping::added_mass);
    added.try_fold(mass, |mass, added| match table.optional("kinetic") {
        None => mass.plus(added, &table.required("mass")?, known),
        Some(kinetic) => Err(kinetic.error(Problem::Incompatible {
            with: "the A(∞) of a kernel, which belongs to the mass".to_owned(),
            allowed: "`system.mass` in its place, or `added_to_mass = false` there".to_owned(),
        })),
    })
}

/// The tables of a list, each read by `read`.
fn tables<T>(
    system: &Table<'_>,
    (key, expected): (&str, &'static str),
    mut read: impl FnMut(&Table<'_>) -> Result<T, InputError>,
) -> Result<Vec<T>, InputError> {
    let Some(value) = system.optional(key) else { return Ok(Vec::new()) };
    value.list(expected)?.iter().map(|table| read(&table.table()?)).collect()
}

/// The terms in the order of the scenario, followed by further parts of matrices of kernels.
fn in_order(terms: Vec<Vec<Damping>>) -> Vec<Damping> {
    let (mut first, mut further) = (Vec::new(), Vec::new());
    for term in terms {
        let mut parts = term.into_iter();
        first.extend(parts.next());
        further.extend(parts);
    }
    first.extend(further);
    first
}

/// Serialises the keys of the scenario.
impl Serialize for Damping {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        if let Some(part) = &self.matrix {
            map.serialize_entry("kernel", &*part.whole)?;
            if self.active().is_some() {
                map.serialize_entry("allow_active", &true)?;
            }
            map.serialize_entry("derivative", &self.derivative)?;
            return map.end();
        }
        match self.transfer.exponent() {
            Some(order) => map.serialize_entry("order", &order)?,
            None => map.serialize_entry("kernel", &KernelKeys(&self.transfer))?,
        }
        if self.active().is_some() {
            map.serialize_entry("allow_active", &true)?;
        }
        if let Some(along) = &self.along {
            along.serialize_entries(&mut map)?;
            map.serialize_entry("derivative", &self.derivative)?;
            return map.end();
        }
        match &self.attached {
            Some(attached) => {
                match &attached.source {
                    Some(file) => map.serialize_entry("attached", file)?,
                    None => map.serialize_entry("attached", &attached.dense_rows())?,
                }
                map.serialize_entry("strength", &attached.strength)?;
            }
            None => map.serialize_entry("coefficient", &self.coefficient)?,
        }
        if let Some(scale) = self.scale {
            map.serialize_entry("scale", &scale)?;
        }
        map.serialize_entry("derivative", &self.derivative)?;
        map.end()
    }
}

/// Serialises the keys of a kernel.
pub(super) struct KernelKeys<'a>(pub(super) &'a TransferFunction);

impl Serialize for KernelKeys<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        match self.0.text() {
            // Rows given directly instead of a file.
            Some("") if self.0.table().is_some() => map.serialize_entry(self.0.form(), self.0.numbers())?,
            Some("") => {
                let rows: Vec<&[f64]> = self.0.numbers().chunks(2).collect();
                map.serialize_entry(self.0.form(), &rows)?;
            }
            Some(text) => map.serialize_entry(self.0.form(), text)?,
            None => map.serialize_entry("form", self.0.form())?,
        }
        for (name, numbers) in self.0.parameters() {
            match (name, &numbers[..]) {
                ("strengths" | "times", numbers) => map.serialize_entry(name, numbers)?,
                (_, [number]) => map.serialize_entry(name, number)?,
                (_, numbers) => map.serialize_entry(name, numbers)?,
            }
        }
        map.end()
    }
}

impl Along {
    fn read(
        value: &Value<'_>,
        term: &Table<'_>,
        (parameters, count): (&BTreeMap<String, f64>, usize),
        known: &mut Matrices<'_>,
    ) -> Result<Self, InputError> {
        for key in ["attached", "scale", "strength"] {
            if let Some(other) = term.optional(key) {
                return Err(other.key_error(Problem::Incompatible {
                    with: "`along`".to_owned(),
                    allowed: "`coefficient` beside `along`: a number, or a matrix for several elongations"
                        .to_owned(),
                }));
            }
        }
        let symbols = symbols_of(parameters).with_coordinates(count);
        let is_one = value.is_text();
        let elongations = match is_one {
            true => vec![value.expression(&symbols)?],
            false => value
                .list("an expression of the coordinates, or a list of them")?
                .iter()
                .map(|elongation| elongation.expression(&symbols))
                .collect::<Result<Vec<_>, _>>()?,
        };
        if elongations.is_empty() {
            return Err(value.out_of_range("one elongation at least"));
        }
        let is_constant = |elongation: &Expression| !elongation.root().has_variable_from(0);
        if let Some(index) = elongations.iter().position(is_constant) {
            let which = if is_one {
                String::new()
            } else {
                format!(", of which elongation {index} (from 0) has none")
            };
            return Err(value.out_of_range(format!("functions of the coordinates q0, q1, …{which}")));
        }
        let given = term.required("coefficient")?;
        let coefficient = match is_one && !given.is_list() {
            true => SymmetricMatrix::Diagonal(vec![given.number()?]),
            false => Self::read_coefficient(&given, elongations.len(), known)?,
        };
        let coefficient = coefficient.positive_semidefinite(&given, known)?;
        Ok(Self { elongations, coefficient, is_one })
    }

    /// ρ for several elongations.
    fn read_coefficient(
        given: &Value<'_>,
        count: usize,
        known: &mut Matrices<'_>,
    ) -> Result<SymmetricMatrix, InputError> {
        let matrix = SymmetricMatrix::read(given, given.is_text().then_some(count), known)?;
        if matrix.size() == count {
            return Ok(matrix);
        }
        let expected = format!("{count} numbers or rows, one for each elongation of `along`");
        Err(given.error(Problem::WrongShape { expected, found: matrix.size().to_string() }))
    }

    fn serialize_entries<M: SerializeMap>(&self, map: &mut M) -> Result<(), M::Error> {
        match (&self.coefficient, self.is_one, self.elongations.first()) {
            (SymmetricMatrix::Diagonal(one), true, Some(elongation)) => {
                map.serialize_entry("along", elongation)?;
                map.serialize_entry("coefficient", &one.first())
            }
            _ => {
                map.serialize_entry("along", &self.elongations)?;
                map.serialize_entry("coefficient", &self.coefficient)
            }
        }
    }
}

/// What a system says of its inertia.
struct Inertia {
    kinetic: Option<Expression>,
    mass: SymmetricMatrix,
    linear_momentum: Vec<f64>,
}

impl Inertia {
    /// Reads `mass`, or `kinetic` for as many coordinates as the initial position has.
    fn read(
        table: &Table<'_>,
        parameters: &BTreeMap<String, f64>,
        start: Option<&[f64]>,
        known: &mut Matrices<'_>,
    ) -> Result<Self, InputError> {
        let Some(value) = table.optional("kinetic") else {
            let value = table.required("mass")?;
            let mass = SymmetricMatrix::read(&value, None, known)?;
            if mass.size() == 0 {
                return Err(value.error(Problem::WrongShape {
                    expected: "one coordinate at least".to_owned(),
                    found: "none".to_owned(),
                }));
            }
            let mass = mass.mass(&value, known)?;
            return Ok(Self { kinetic: None, mass, linear_momentum: Vec::new() });
        };
        let Some(position) = start.filter(|position| !position.is_empty()) else {
            return Err(value
                .out_of_range("an `initial.position` beside it, which says how many coordinates there are"));
        };
        let count = position.len();
        let symbols = symbols_of(parameters).with_coordinates(count).with_velocities(count, |_| false);
        let expression = value.expression(&symbols)?;
        let Kinetic { mass, linear } = Kinetic::at(&expression, position, &value)?;
        let mass = SymmetricMatrix::Dense(mass);
        // A scenario that is written out has the mass at the start beside it.
        if let Some(given) = table.optional("mass") {
            let is_same =
                SymmetricMatrix::read(&given, None, known).is_ok_and(|given| given.is_close_to(&mass));
            if !is_same {
                return Err(given.error(Problem::Incompatible {
                    with: "`system.kinetic`".to_owned(),
                    allowed: "one of the two: leave it out".to_owned(),
                }));
            }
        }
        Ok(Self { kinetic: Some(expression), mass, linear_momentum: linear })
    }
}

/// Largest number of entries of B diag(strength) Bᵀ: a damper between all coordinates would make it dense.
const MOST_ATTACHED: usize = 50_000_000;

impl Attached {
    fn read(value: &Value<'_>, strength_value: &Value<'_>, count: usize) -> Result<Self, InputError> {
        let (rows, columns, entries, source) = if value.is_text() {
            let file = value.matrix_file()?;
            if file.half {
                return Err(value.file_error("a symmetric matrix where the columns of dampers are wanted"));
            }
            let source = value.document().resolve(value.text()?).display().to_string();
            (file.rows, file.columns, file.entries, Some(source))
        } else {
            let rows = value.list("a file, or a list of rows")?;
            let rows: Vec<Vec<f64>> = rows.iter().map(Value::numbers).collect::<Result<_, _>>()?;
            let columns = rows.first().map_or(0, Vec::len);
            if rows.iter().any(|row| row.len() != columns) {
                return Err(value.out_of_range("rows of the same length, one number for each damper"));
            }
            let entry = |(row, numbers): (usize, &Vec<f64>)| {
                let numbers = numbers.iter().enumerate().filter(|(_, number)| **number != 0.0);
                numbers.map(|(column, &number)| (row as u32, column as u32, number)).collect::<Vec<_>>()
            };
            (rows.len(), columns, rows.iter().enumerate().flat_map(entry).collect(), None)
        };
        if rows != count {
            return Err(value.error(Problem::WrongShape {
                expected: format!("{count} rows (the number of coordinates, from `system.mass`)"),
                found: format!("{rows} rows"),
            }));
        }
        if columns == 0 {
            return Err(value.out_of_range("one column at least, one for each damper"));
        }
        let strength = strength_value.numbers()?;
        if strength.len() != columns {
            return Err(strength_value.error(Problem::WrongShape {
                expected: format!("{columns} numbers, one for each column of `attached`"),
                found: format!("{}", strength.len()),
            }));
        }
        if strength.iter().any(|&strength| strength < 0.0) {
            return Err(strength_value.out_of_range("numbers ≥ 0"));
        }
        let mut of_column = vec![Vec::new(); columns];
        for (row, column, entry) in entries {
            of_column[column as usize].push((row, entry));
        }
        let filled: usize =
            of_column.iter().map(|column: &Vec<(u32, f64)>| column.len() * column.len()).sum();
        if filled > MOST_ATTACHED {
            return Err(value.out_of_range(format!(
                "columns of a few coordinates each: B diag(strength) Bᵀ would have {filled} entries, at most {MOST_ATTACHED} are taken"
            )));
        }
        Ok(Self { columns: of_column, strength, source, rows })
    }

    /// B diag(strength) Bᵀ.
    fn coefficient(&self) -> SymmetricMatrix {
        SymmetricMatrix::Sparse(SparseMatrix::of_columns(self.rows, &self.columns, &self.strength))
    }

    fn dense_rows(&self) -> Vec<Vec<f64>> {
        let mut rows = vec![vec![0.0; self.columns.len()]; self.rows];
        for (column, entries) in self.columns.iter().enumerate() {
            for &(row, entry) in entries {
                rows[row as usize][column] += entry;
            }
        }
        rows
    }
}

fn belongs(value: &Value<'_>, key: &str, other: &str) -> InputError {
    value.key_error(Problem::Incompatible {
        with: "the other keys of this term".to_owned(),
        allowed: format!("`{key}` belongs to `{other}`"),
    })
}
