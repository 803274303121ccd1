//! `[sensitivity]`: parameters for which derivatives of the motion are computed.

use super::Scenario;
use super::element::Element;
use super::load::Amplitude;
use super::matrix::SymmetricMatrix;
use super::symbol::symbol_derivative;
use super::system::Derivative;
use crate::language::document::{Table, Value};
use crate::language::error::{InputError, Problem};
use crate::language::expression::{Expression, ExpressionError, Symbols};
use fvi_fft::transfer::derivative::TransferDerivative;
use serde::{Serialize, Serializer};

/// The parameters, in the order of the file.
#[derive(Clone, Debug, Serialize)]
pub struct Sensitivity {
    /// The parameters by their paths.
    pub parameters: Vec<Parameter>,
}

/// A parameter: a number of the scenario.
#[derive(Clone, Debug)]
pub struct Parameter {
    /// Its path, such as `system.damping[0].order`.
    pub path: String,
    /// Kind of the parameter.
    pub what: Quantity,
}

impl Serialize for Parameter {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.path)
    }
}

/// Kind of a parameter.
#[derive(Clone, Debug)]
pub enum Quantity {
    /// An entry of q₀.
    Position(usize),
    /// An entry of the past, by row and column.
    Past(usize, usize),
    /// An entry of p₀.
    Momentum(usize),
    /// An entry of v₀ = M⁻¹p₀, if the scenario gives v₀.
    Velocity(usize),
    /// An entry of M together with its mirror image.
    Mass(usize, usize),
    /// An entry of K together with its mirror image.
    Stiffness(usize, usize),
    /// An entry of G together with the negative of its mirror image.
    Gyroscopic(usize, usize),
    /// ∂ρ of damping term number m by the parameter, as entries (row, column, number).
    Coefficient(usize, Vec<(usize, usize, f64)>),
    /// A parameter of the kernel of damping term number m.
    Kernel(usize, TransferDerivative),
    /// A named constant, with the expressions in which it is an additional variable.
    Named(Box<Named>),
}

/// Expressions in which a named constant is the last variable.
#[derive(Clone, Debug)]
pub struct Named {
    /// Its value.
    pub value: f64,
    /// U in q0, … and the constant, if it occurs there.
    pub potential: Option<Expression>,
    /// F in t, q0, … and the constant, if it occurs there.
    pub force: Option<Vec<Expression>>,
    /// The potentials of element groups in x0, … and the constant, each with the index of its group.
    pub elements: Vec<(usize, Expression)>,
    /// Amplitudes of loads in t and the constant, each with the index of its load.
    pub loads: Vec<(usize, Expression)>,
    /// T in q0, …, v0, … and the constant, if it occurs there.
    pub kinetic: Option<Expression>,
    /// Constraints in q0, … and the constant, each with its index.
    pub constraints: Vec<(usize, Expression)>,
    /// Elongations likewise, counted through all damping terms that have any.
    pub elongations: Vec<(usize, Expression)>,
    /// Derivatives of kernels whose `symbol` contains it, each with the index of the damping term.
    pub kernels: Vec<(usize, TransferDerivative)>,
}

impl Named {
    /// The expressions in which several constants are variables together, in their order after the others;
    /// without kernels, and with the value of this one.
    ///
    /// # Errors
    /// If an expression cannot be read again.
    pub fn together(&self, scenario: &Scenario, names: &[&str]) -> Result<Self, InputError> {
        let fault = |error| scenario.error_at("sensitivity.parameters", Problem::Expression(error));
        Self::read(scenario, (names, self.value), &fault)
    }

    fn read(
        scenario: &Scenario,
        (names, value): (&[&str], f64),
        fault: &dyn Fn(ExpressionError) -> InputError,
    ) -> Result<Self, InputError> {
        let system = &scenario.system;
        let others = others(scenario, names);
        let variables = || names.iter().map(|&name| name.to_owned());
        let count = scenario.coordinates();
        // The expression with the constants as additional variables; `None` if none of them occurs in it.
        let again = |expression: &Expression, symbols: Symbols, before: usize| -> Result<_, InputError> {
            let symbols = symbols.with_variables(variables());
            let parsed = Expression::parse(expression.text(), &symbols).map_err(fault)?;
            Ok(parsed.root().has_variable_from(before).then_some(parsed))
        };
        let potential = match &system.potential {
            Some(potential) => again(potential, others.clone().with_coordinates(count), count)?,
            None => None,
        };
        let mut force = None;
        if let Some(components) = &system.force {
            // The constants come after positions and, if they are variables, velocities.
            let moves = system.force_in_words_depends_on_velocity();
            let before = if moves { 2 * count } else { count };
            let symbols = || {
                let symbols = others.clone().with_time().with_coordinates(count);
                match moves {
                    true => symbols.with_velocities(count, |other| names.contains(&other)),
                    false => symbols,
                }
                .with_variables(variables())
            };
            let parsed = components.iter().map(|component| Expression::parse(component.text(), &symbols()));
            let parsed: Vec<Expression> = parsed.collect::<Result<_, _>>().map_err(fault)?;
            let occurs = parsed.iter().any(|component| component.root().has_variable_from(before));
            force = occurs.then_some(parsed);
        }
        let mut elements = Vec::new();
        for (index, Element { potential, coordinates }) in system.elements.iter().enumerate() {
            let width = coordinates.first().map_or(0, Vec::len);
            let inside = (0..width).map(|index| format!("x{index}"));
            let parsed = again(potential, others.clone().with_variables(inside), width)?;
            elements.extend(parsed.map(|parsed| (index, parsed)));
        }
        let mut loads = Vec::new();
        for (index, load) in system.loads.iter().enumerate() {
            if let Amplitude::Expression(amplitude) = &load.amplitude {
                let parsed = again(amplitude, others.clone().with_time(), 0)?;
                loads.extend(parsed.map(|parsed| (index, parsed)));
            }
        }
        let kinetic = match &system.kinetic {
            Some(kinetic) => {
                let symbols = others.clone().with_coordinates(count);
                let symbols = symbols.with_velocities(count, |other| names.contains(&other));
                again(kinetic, symbols, 2 * count)?
            }
            None => None,
        };
        let of_position = |expressions: &mut dyn Iterator<Item = &Expression>| {
            let mut found = Vec::new();
            for (index, expression) in expressions.enumerate() {
                let parsed = again(expression, others.clone().with_coordinates(count), count)?;
                found.extend(parsed.map(|parsed| (index, parsed)));
            }
            Ok::<_, InputError>(found)
        };
        let constraints = of_position(&mut system.constraints.iter())?;
        let elongations = of_position(&mut system.elongations())?;
        let kernels = Vec::new();
        Ok(Self { value, potential, force, elements, loads, kinetic, constraints, elongations, kernels })
    }
}

/// The constants of a scenario but those of these names.
fn others(scenario: &Scenario, names: &[&str]) -> Symbols {
    let parameters = scenario.system.parameters.iter();
    let others = parameters.filter(|(other, _)| !names.contains(&other.as_str()));
    others.fold(Symbols::new(), |symbols, (other, &value)| {
        symbols.clone().with_parameter(other, value).unwrap_or(symbols)
    })
}

impl Quantity {
    /// The derivative of the kernel of a damping term.
    pub fn kernel(&self, term: usize) -> Option<&TransferDerivative> {
        match self {
            Self::Kernel(own, derivative) if *own == term => Some(derivative),
            Self::Named(named) => {
                named.kernels.iter().find(|(own, _)| *own == term).map(|(_, derivative)| derivative)
            }
            _ => None,
        }
    }
}

/// The valid paths.
const PATHS: &str = "system.damping[m].order, .coefficient[i] or [i][j], .scale, .strength[l], .kernel.NAME or .kernel.NAME[j]; \
    system.parameters.NAME; system.mass[i] or [i][j]; system.stiffness[i] or [i][j]; system.gyroscopic[i][j]; initial.position[i], initial.momentum[i] or \
    initial.velocity[i]; initial.past[k][i]";

const BY_NUMBERS: &str = "an entry of a matrix that the scenario gives by numbers, not by a file";

impl Sensitivity {
    /// Reads the parameters of a scenario that is complete otherwise.
    pub(super) fn read(table: &Table<'_>, scenario: &Scenario) -> Result<Self, InputError> {
        table.allow(&["parameters"])?;
        let value = table.required("parameters")?;
        let values = value.list("a list of paths")?;
        if values.is_empty() {
            return Err(value.out_of_range("one path at least"));
        }
        let mut parameters: Vec<Parameter> = Vec::new();
        for value in &values {
            let path = value.text()?;
            if parameters.iter().any(|known| known.path == path) {
                return Err(value.out_of_range("paths that differ"));
            }
            parameters
                .push(Parameter { path: path.to_owned(), what: Reader { scenario, value }.read(path)? });
        }
        Ok(Self { parameters })
    }
}

/// Reader of one path.
struct Reader<'a> {
    scenario: &'a Scenario,
    value: &'a Value<'a>,
}

/// The parts of a path: each a name and its indices.
fn parts(path: &str) -> Option<Vec<(&str, Vec<usize>)>> {
    path.split('.').map(part).collect()
}

fn part(part: &str) -> Option<(&str, Vec<usize>)> {
    let (name, mut rest) = part.split_at(part.find('[').unwrap_or(part.len()));
    let mut indices = Vec::new();
    while !rest.is_empty() {
        let (index, behind) = rest.strip_prefix('[')?.split_once(']')?;
        indices.push(index.parse().ok()?);
        rest = behind;
    }
    (!name.is_empty()).then_some((name, indices))
}

impl Reader<'_> {
    fn refused(&self, allowed: impl Into<String>) -> InputError {
        self.value.out_of_range(allowed)
    }

    fn read(&self, path: &str) -> Result<Quantity, InputError> {
        let Some(parts) = parts(path) else { return Err(self.refused(PATHS)) };
        // The index of a list of one number may be left out.
        let is_alone = |name: &str, indices: &[usize]| {
            let of_coordinates = ["position", "momentum", "velocity"].contains(&name);
            of_coordinates && indices.is_empty() && self.scenario.coordinates() == 1
        };
        let parts: Vec<(&str, &[usize])> = parts
            .iter()
            .map(|(name, indices)| (*name, if is_alone(name, indices) { &[0][..] } else { &indices[..] }))
            .collect();
        let system = &self.scenario.system;
        match parts[..] {
            [("initial", []), ("position", &[index])] => Ok(Quantity::Position(self.coordinate(index)?)),
            [("initial", []), ("past", &[row, column])] => {
                let Some(past) = &self.scenario.initial.past else {
                    return Err(self.refused("a number that the scenario has: there is no `initial.past`"));
                };
                if past.is_from_file() {
                    return Err(self.refused(BY_NUMBERS));
                }
                if row >= past.rows() {
                    return Err(self.refused(format!("a row below {}, the number of rows", past.rows())));
                }
                Ok(Quantity::Past(row, self.coordinate(column)?))
            }
            [("initial", []), ("momentum", &[index])] => {
                if self.gives_velocity() {
                    return Err(self.refused("`initial.velocity[i]`: the scenario gives the velocity"));
                }
                Ok(Quantity::Momentum(self.coordinate(index)?))
            }
            [("initial", []), ("velocity", &[index])] => {
                if !self.gives_velocity() {
                    return Err(self.refused("`initial.momentum[i]`: the scenario gives no velocity"));
                }
                Ok(Quantity::Velocity(self.coordinate(index)?))
            }
            [("system", []), ("mass", _)] if system.kinetic.is_some() => {
                Err(self.refused("`system.parameters.NAME` in `system.kinetic`, which gives the mass"))
            }
            [("system", []), ("mass", indices)] => {
                let (row, column) = self.entry(&system.mass, indices)?;
                Ok(Quantity::Mass(row, column))
            }
            [("system", []), ("stiffness", indices)] => {
                let Some(stiffness) = &system.stiffness else {
                    return Err(
                        self.refused("a number that the scenario has: there is no `system.stiffness`")
                    );
                };
                let (row, column) = self.entry(stiffness, indices)?;
                Ok(Quantity::Stiffness(row, column))
            }
            [("system", []), ("gyroscopic", indices)] => {
                let Some(gyroscopic) = &system.gyroscopic else {
                    return Err(
                        self.refused("a number that the scenario has: there is no `system.gyroscopic`")
                    );
                };
                match *indices {
                    _ if gyroscopic.is_from_file() => Err(self.refused(BY_NUMBERS)),
                    [row, column] if row != column => {
                        Ok(Quantity::Gyroscopic(self.coordinate(row)?, self.coordinate(column)?))
                    }
                    [_, _] => Err(self.refused("an entry off the diagonal, which is 0")),
                    _ => Err(self.refused("`[i][j]` behind it: the matrix is given by its rows")),
                }
            }
            [("system", []), ("parameters", []), (name, [])] => self.named(name),
            [("system", []), ("damping", &[term]), ref rest @ ..] => self.damping(term, rest),
            _ => Err(self.refused(PATHS)),
        }
    }

    fn gives_velocity(&self) -> bool {
        self.scenario.document().has("initial.velocity")
    }

    fn coordinate(&self, index: usize) -> Result<usize, InputError> {
        self.below(index, self.scenario.coordinates(), "coordinates")
    }

    fn below(&self, index: usize, count: usize, of: &str) -> Result<usize, InputError> {
        let refused = || self.refused(format!("an index below {count}, the number of {of}"));
        if index < count { Ok(index) } else { Err(refused()) }
    }

    /// The row and column of an entry that the file of the scenario gives.
    fn entry(&self, matrix: &SymmetricMatrix, indices: &[usize]) -> Result<(usize, usize), InputError> {
        let place = |index: usize| self.below(index, matrix.size(), "rows");
        match (matrix, indices) {
            (SymmetricMatrix::Diagonal(_), &[index]) => Ok((place(index)?, index)),
            (SymmetricMatrix::Dense(_), &[row, column]) => Ok((place(row)?, place(column)?)),
            (SymmetricMatrix::Diagonal(_) | SymmetricMatrix::Dense(_), []) if matrix.size() == 1 => {
                Ok((0, 0))
            }
            (SymmetricMatrix::Diagonal(_), _) => {
                Err(self.refused("`[i]` behind it: the matrix is a diagonal"))
            }
            (SymmetricMatrix::Dense(_), _) => {
                Err(self.refused("`[i][j]` behind it: the matrix is given by its rows"))
            }
            (SymmetricMatrix::Sparse(_), _) => Err(self.refused(BY_NUMBERS)),
        }
    }

    fn damping(&self, term: usize, rest: &[(&str, &[usize])]) -> Result<Quantity, InputError> {
        let count = self.scenario.system.damping.len();
        let Some(damping) = self.scenario.system.damping.get(term) else {
            return Err(self.refused(format!("a damping term below {count}, their number")));
        };
        match *rest {
            [("order", [])] if self.has(term, "order") => self.kernel(term, "order", 0),
            [("kernel", []), (name, [])] if self.has(term, &format!("kernel.{name}[1]")) => {
                Err(self.refused("`[i]` behind it: there are several"))
            }
            [("kernel", []), (name, [])] if self.has(term, &format!("kernel.{name}")) => {
                self.kernel(term, name, 0)
            }
            [("kernel", []), (name, &[index])] if self.has(term, &format!("kernel.{name}")) => {
                self.kernel(term, name, index)
            }
            [("coefficient", indices)] if self.has(term, "coefficient") => {
                if self.has(term, "scale") {
                    return Err(self.refused("`.scale`: this coefficient is scaled"));
                }
                let coefficient = damping.along.as_ref().map(|along| &along.coefficient);
                let (row, column) = self.entry(coefficient.unwrap_or(&damping.coefficient), indices)?;
                let mirrored = (row != column).then_some((column, row, 1.0));
                Ok(Quantity::Coefficient(term, std::iter::once((row, column, 1.0)).chain(mirrored).collect()))
            }
            [("scale", [])] if self.has(term, "scale") => {
                let scale = damping_scale(self.scenario, term)?;
                if scale == 0.0 {
                    return Err(self.refused("a scale that is not 0: the matrix is not kept beside it"));
                }
                let entries = entries(&damping.coefficient).into_iter();
                let entries = entries.map(|(row, column, entry)| (row, column, entry / scale));
                Ok(Quantity::Coefficient(term, entries.collect()))
            }
            [("strength", &[index])] if self.has(term, "strength") => {
                let columns = damping.attached.as_ref().map(|attached| &attached.columns);
                let Some(column) = columns.and_then(|columns| columns.get(index)) else {
                    return Err(self.refused("the index of a damper"));
                };
                let pairs = column.iter().flat_map(|&(row, one)| {
                    column.iter().map(move |&(other, two)| (row as usize, other as usize, one * two))
                });
                Ok(Quantity::Coefficient(term, pairs.collect()))
            }
            _ => Err(self.refused(format!("a number that the damping term has; paths: {PATHS}"))),
        }
    }

    fn has(&self, term: usize, key: &str) -> bool {
        self.scenario.document().has(&format!("system.damping[{term}].{key}"))
    }

    fn kernel(&self, term: usize, name: &str, index: usize) -> Result<Quantity, InputError> {
        let damping = &self.scenario.system.damping[term];
        self.refuse_starting()?;
        let order = damping.transfer.exponent();
        let at_rest = self.scenario.initial.momentum.iter().all(|&p| p == 0.0);
        let is_spring = self.has(term, "order") && order.is_none();
        let jumps = damping.derivative == Derivative::Caputo && order == Some(1.0) && !at_rest;
        if is_spring || jumps {
            return Err(self.refused(
                "an order other than 0, and other than 1 where the motion begins with a velocity: Caputo's derivative jumps there",
            ));
        }
        match TransferDerivative::new(&damping.transfer, name, index) {
            // A form that was simplified no longer has the parameter given in the file.
            Some(derivative) => Ok(Quantity::Kernel(term, derivative)),
            None => Err(self.refused(format!(
                "a number of the kernel {}; those of tables are not differentiated, those of expressions by \
                 `system.parameters.NAME`, nor one at which a form becomes a simpler one",
                damping.transfer
            ))),
        }
    }

    fn refuse_starting(&self) -> Result<(), InputError> {
        if self.scenario.convolution.starting.is_empty() {
            return Ok(());
        }
        Err(self.refused(
            "parameters of kernels without `convolution.starting`: starting weights are not differentiated by them",
        ))
    }

    fn named(&self, name: &str) -> Result<Quantity, InputError> {
        let system = &self.scenario.system;
        let Some(&value) = system.parameters.get(name) else {
            let known: Vec<&str> = system.parameters.keys().map(String::as_str).collect();
            return Err(self.refused(format!("one of `system.parameters`: {}", known.join(", "))));
        };
        let fault = |error| self.value.error(Problem::Expression(error));
        let mut named = Named::read(self.scenario, (&[name], value), &fault)?;
        let others = others(self.scenario, &[name]);
        for (term, damping) in system.damping.iter().enumerate() {
            if !self.has(term, "kernel.symbol") {
                continue;
            }
            let Some(text) = damping.transfer.text() else { continue };
            let symbols = others.clone().with_variables(["s".to_owned()]).with_variables([name.to_owned()]);
            let parsed = Expression::parse(text, &symbols).map_err(fault)?;
            if parsed.root().has_variable(1) {
                named.kernels.push((term, self.symbol(term, parsed, value)?));
            }
        }
        Ok(Quantity::Named(Box::new(named)))
    }

    /// The derivative of the symbol of a term by a constant in it.
    fn symbol(
        &self,
        term: usize,
        expression: Expression,
        value: f64,
    ) -> Result<TransferDerivative, InputError> {
        self.refuse_starting()?;
        let damping = &self.scenario.system.damping[term];
        let place = format!("; it is in `system.damping[{term}].kernel.symbol`");
        let derivative = symbol_derivative(&damping.transfer, expression, value)
            .map_err(|allowed| self.refused(allowed + &place))?;
        let at_rest = self.scenario.initial.momentum.iter().all(|&p| p == 0.0);
        let jumps = damping.derivative == Derivative::Caputo && damping.transfer.growth() == 1.0 && !at_rest;
        if jumps && derivative.changes_growth_of(&damping.transfer) {
            let allowed = "a value at which the symbol does not grow like s, where the motion begins with a velocity: Caputo's \
                derivative jumps there";
            return Err(self.refused(allowed.to_owned() + &place));
        }
        Ok(derivative)
    }
}

/// The number by which the coefficient of a term is multiplied.
fn damping_scale(scenario: &Scenario, term: usize) -> Result<f64, InputError> {
    let path = format!("system.damping[{term}].scale");
    scenario.document().with_root(|root| {
        let terms = root.required("system")?.table()?.required("damping")?;
        let terms = terms.list("a list of tables")?;
        match terms.get(term) {
            Some(term) => term.table()?.required("scale")?.number(),
            None => Err(scenario.error_at(&path, Problem::MissingKey { key: "scale".to_owned() })),
        }
    })
}

/// (row, column, entry) of a matrix.
fn entries(matrix: &SymmetricMatrix) -> Vec<(usize, usize, f64)> {
    match matrix {
        SymmetricMatrix::Diagonal(entries) => {
            entries.iter().enumerate().map(|(index, &entry)| (index, index, entry)).collect()
        }
        SymmetricMatrix::Dense(matrix) => {
            let size = matrix.nrows();
            let all = (0..size).flat_map(|row| (0..size).map(move |column| (row, column)));
            all.map(|(row, column)| (row, column, matrix[(row, column)])).collect()
        }
        SymmetricMatrix::Sparse(matrix) => {
            let rows = matrix.pattern.rows().enumerate();
            let entry =
                |row, slot: usize| (row, matrix.pattern.columns()[slot] as usize, matrix.values[slot]);
            rows.flat_map(|(row, slots)| slots.map(move |slot| entry(row, slot))).collect()
        }
    }
}
