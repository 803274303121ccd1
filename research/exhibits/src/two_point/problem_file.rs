//! Problem files of `fvi extremal`: a two-point problem, read and checked.

use super::equation::{EmbeddedProblem, Embedding, ORDER, OperatorEquation, Term};
use super::extremal::{ExtremalProblem, Method, NotConverged, ProblemError, Solution};
use super::grid::{Grid, Sigma};
use super::lagrangian::{ExpressionLagrangian, MAX_COORDINATES};
use super::newton::NewtonOptions;
use fvi_scenario::language::document::{Table, Value};
use fvi_scenario::language::expression::{Expression, Moment, Symbols};
use fvi_scenario::language::number_table::NumberTable;
use fvi_scenario::language::{Document, InputError, Problem};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// A problem file with all its values checked.
#[derive(Clone, Debug, Serialize)]
pub struct ProblemFile {
    /// Title of the pictures.
    pub title: Option<String>,
    /// Equation to solve between the ends.
    #[serde(flatten)]
    pub statement: Statement,
    /// Named constants of the expressions.
    pub parameters: BTreeMap<String, f64>,
    /// The side of the discrete derivative.
    pub sigma: Sigma,
    /// Position at the start of the interval.
    pub start: Vec<f64>,
    /// Position at its end.
    pub end: Vec<f64>,
    /// The interval and its grid.
    pub grid: Grid,
    /// Start of Newton's method, as functions of t; `None`: the default start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guess: Option<Vec<Expression>>,
    /// How the equations of an extremal are solved; for an embedded equation there is no choice.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub method: Option<Method>,
    /// Tolerance and numbers of iterations of the solver.
    pub solver: NewtonOptions,
    /// Known extremal to compare with.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference: Option<KnownPositions>,
    #[serde(skip)]
    name: String,
}

/// Equation to solve between the ends.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Statement {
    /// A Lagrangian functional is stationary.
    Lagrangian {
        /// L(x, v, t).
        lagrangian: ExpressionLagrangian,
        /// Order α of the derivative that v stands for.
        alpha: f64,
    },
    /// A differential equation holds, embedded directly.
    Equation {
        /// The sum of its terms is zero.
        #[serde(flatten)]
        equation: OperatorEquation,
    },
}

/// Known positions.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum KnownPositions {
    /// Functions of t, one for each coordinate.
    Expressions {
        /// x(t).
        position: Vec<Expression>,
    },
    /// Values at some times.
    Table {
        /// The file they are from, as written in the problem file.
        file: String,
        /// t and the positions, ascending in time.
        #[serde(skip)]
        rows: Vec<Vec<f64>>,
    },
}

impl KnownPositions {
    /// The positions at `time` on a grid of step `step`, which may be infinite or not a number where they are
    /// expressions; `None` where a table has no row for it.
    pub fn at(&self, time: f64, step: f64) -> Option<Vec<f64>> {
        match self {
            Self::Expressions { position } => {
                Some(position.iter().map(|x| x.value(Moment::inside(time), &[])).collect())
            }
            Self::Table { rows, .. } => {
                // A tabulated time is a grid time when they differ by rounding only.
                let tolerance = 1e-9 * step;
                let next = rows.partition_point(|row| row[0] < time - tolerance);
                rows.get(next).filter(|row| row[0] <= time + tolerance).map(|row| row[1..].to_vec())
            }
        }
    }
}

impl ProblemFile {
    /// Reads and checks a problem file.
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
        document.with_root(|root| Self::from_root(&root, &document))
    }

    fn from_root(root: &Table<'_>, document: &Document) -> Result<Self, InputError> {
        root.allow(&["title", "problem", "interval", "boundary", "guess", "solver", "reference"])?;
        let title = root.optional("title").map(|value| value.text().map(str::to_owned)).transpose()?;
        let boundary = root.required("boundary")?.table()?;
        boundary.allow(&["start", "end"])?;
        let start_value = boundary.required("start")?;
        let start = start_value.numbers()?;
        let count = start.len();
        if !(1..=MAX_COORDINATES).contains(&count) {
            return Err(start_value.out_of_range(format!("1 to {MAX_COORDINATES} coordinates")));
        }
        let end_value = boundary.required("end")?;
        let end = end_value.numbers()?;
        check_count(&end_value, count, end.len())?;

        let problem = root.required("problem")?.table()?;
        problem.allow(&["lagrangian", "terms", "embedding", "parameters", "alpha", "sigma"])?;
        let (parameters, timed) =
            read_parameters(problem.optional("parameters"), Symbols::new().with_time())?;
        let statement = Statement::read(&problem, count)?;
        let sigma = match problem.optional("sigma") {
            Some(value) => value.choice(&[("-", Sigma::Minus), ("+", Sigma::Plus)])?,
            None => Sigma::Minus,
        };
        let grid = read_grid(&root.required("interval")?.table()?)?;
        let guess = match root.optional("guess") {
            Some(value) => {
                let table = value.table()?;
                table.allow(&["position"])?;
                Some(expressions(&table.required("position")?, &timed, count)?)
            }
            None => None,
        };
        let (method, solver) = read_solver(root.optional("solver"), &statement, &grid, count)?;
        let reference = match root.optional("reference") {
            Some(value) => Some(read_reference(&value.table()?, document, &timed, &grid, count)?),
            None => None,
        };
        let name = document.name().to_owned();
        let file = Self {
            title,
            statement,
            parameters,
            sigma,
            start,
            end,
            grid,
            guess,
            method,
            solver,
            reference,
            name,
        };
        file.check_guess(root)?;
        Ok(file)
    }

    /// Refuses a guess that is not finite at some grid point.
    fn check_guess(&self, root: &Table<'_>) -> Result<(), InputError> {
        let (Some(guess), Some(value)) = (self.guess_on(&self.grid), root.optional("guess")) else {
            return Ok(());
        };
        let count = self.coordinates();
        // The end points take the place of the guess there.
        match guess[count..guess.len() - count].iter().position(|x| !x.is_finite()) {
            None => Ok(()),
            Some(index) => {
                let place = format!("t = {}", self.grid.time(index / count + 1));
                Err(value.error(Problem::NotFinite { what: "the guess", place }))
            }
        }
    }

    /// The guess at every grid point, the end points at the ends.
    fn guess_on(&self, grid: &Grid) -> Option<Vec<f64>> {
        let guess = self.guess.as_ref()?;
        let value = |k: usize| guess.iter().map(move |x| x.value(Moment::inside(grid.time(k)), &[]));
        let inner = (1..grid.steps()).flat_map(value);
        Some(self.start.iter().copied().chain(inner).chain(self.end.iter().copied()).collect())
    }

    /// Number of coordinates.
    pub fn coordinates(&self) -> usize {
        self.start.len()
    }

    /// The title, or the file's name without its ending.
    pub fn heading(&self) -> &str {
        self.title.as_deref().unwrap_or_else(|| {
            Path::new(&self.name).file_stem().and_then(|stem| stem.to_str()).unwrap_or("extremal")
        })
    }

    /// Solves the problem on a grid of the same interval; `observe` receives the number of Newton steps and
    /// the relative residual before each step.
    ///
    /// # Errors
    /// If the guess is not finite on the given grid, when it differs from the file's. The inner result is the
    /// solution or the best iterate.
    pub fn solve(
        &self,
        grid: Grid,
        observe: &mut dyn FnMut(usize, f64),
    ) -> Result<Result<Solution, NotConverged>, ProblemError> {
        let guess = self.guess_on(&grid);
        match &self.statement {
            Statement::Lagrangian { lagrangian, alpha } => {
                let (start, end) = (&self.start, &self.end);
                let mut problem = ExtremalProblem::new(lagrangian, grid, self.sigma, *alpha, start, end)?
                    .with_options(self.solver);
                if let Some(method) = self.method.filter(|_| grid == self.grid) {
                    problem = problem.with_method(method);
                }
                if let Some(guess) = guess {
                    problem = problem.with_guess(guess)?;
                }
                Ok(problem.solve_observed(observe))
            }
            Statement::Equation { equation } => {
                let mut problem = EmbeddedProblem::new(equation, grid, self.sigma, &self.start, &self.end)?
                    .with_options(self.solver);
                if let Some(guess) = guess {
                    problem = problem.with_guess(guess)?;
                }
                Ok(problem.solve(observe))
            }
        }
    }
}

impl Statement {
    fn read(table: &Table<'_>, count: usize) -> Result<Self, InputError> {
        let (is_lagrangian, value) = table.either("lagrangian", "terms")?;
        let parameters = table.optional("parameters");
        let timed = Symbols::new().with_time();
        if is_lagrangian {
            let variables = timed.with_variables(ExpressionLagrangian::variables(count));
            let (_, symbols) = read_parameters(parameters, variables)?;
            let lagrangian = ExpressionLagrangian::new(value.expression(&symbols)?, count)
                .ok_or_else(|| value.out_of_range(format!("1 to {MAX_COORDINATES} coordinates")))?;
            let alpha_value = table.required("alpha")?;
            let alpha = alpha_value.number()?;
            if !(alpha > 0.0 && alpha <= 1.0) {
                return Err(alpha_value.out_of_range("an order 0 < α ≤ 1"));
            }
            if let Some(embedding) = table.optional("embedding") {
                return Err(embedding.key_error(Problem::Incompatible {
                    with: "`problem.lagrangian`".to_owned(),
                    allowed: "`embedding` belongs to `problem.terms`".to_owned(),
                }));
            }
            return Ok(Self::Lagrangian { lagrangian, alpha });
        }
        if let Some(alpha) = table.optional("alpha") {
            return Err(alpha.key_error(Problem::Incompatible {
                with: "`problem.terms`".to_owned(),
                allowed: "`alpha` belongs to a Lagrangian; terms name whole orders themselves".to_owned(),
            }));
        }
        let variables = timed.with_variables(OperatorEquation::variables(count));
        let (_, symbols) = read_parameters(parameters, variables)?;
        let terms = value
            .list("a list of tables, each headed [[problem.terms]]")?
            .iter()
            .map(|term| read_term(&term.table()?, &symbols, count))
            .collect::<Result<_, _>>()?;
        let terms = OperatorEquation::new(terms, count)
            .ok_or_else(|| value.out_of_range("terms whose highest order is 2"))?;
        let embedding = match table.optional("embedding") {
            Some(value) => {
                value.choice(&[("symmetric", Embedding::Symmetric), ("asymmetric", Embedding::Asymmetric)])?
            }
            None => Embedding::default(),
        };
        Ok(Self::Equation { equation: terms.with_embedding(embedding) })
    }
}

fn read_term(table: &Table<'_>, symbols: &Symbols, count: usize) -> Result<Term, InputError> {
    table.allow(&["factor", "order", "of"])?;
    let factor = table.optional("factor").map(|value| value.expression(symbols)).transpose()?;
    let order = table.required("order")?.whole(0..=ORDER)?;
    let of = expressions(&table.required("of")?, symbols, count)?;
    Ok(Term { factor, order, of })
}

fn check_count(value: &Value<'_>, expected: usize, found: usize) -> Result<(), InputError> {
    if expected == found {
        return Ok(());
    }
    Err(value.error(Problem::WrongShape {
        expected: format!("{expected}, one for each coordinate (as many as `boundary.start` has)"),
        found: format!("{found} entries"),
    }))
}

fn expressions(value: &Value<'_>, symbols: &Symbols, count: usize) -> Result<Vec<Expression>, InputError> {
    let list = value.list("a list of expressions in quotes")?;
    check_count(value, count, list.len())?;
    list.iter().map(|entry| entry.expression(symbols)).collect()
}

/// The parameters, and the symbols with them.
fn read_parameters(
    value: Option<Value<'_>>,
    mut symbols: Symbols,
) -> Result<(BTreeMap<String, f64>, Symbols), InputError> {
    let mut parameters = BTreeMap::new();
    let Some(value) = value else { return Ok((parameters, symbols)) };
    for (name, entry) in value.table()?.entries() {
        let number = entry.number()?;
        symbols = symbols
            .with_parameter(name, number)
            .map_err(|error| entry.key_error(Problem::ParameterName(error)))?;
        parameters.insert(name.to_owned(), number);
    }
    Ok((parameters, symbols))
}

fn read_grid(table: &Table<'_>) -> Result<Grid, InputError> {
    table.allow(&["start", "end", "steps"])?;
    let start = match table.optional("start") {
        Some(value) => value.number()?,
        None => 0.0,
    };
    let end_value = table.required("end")?;
    let end = end_value.number()?;
    let steps = table.required("steps")?.whole(2..=1 << 26)?;
    Grid::new(start, end, steps).map_err(|_| end_value.out_of_range(format!("a number > {start}, the start")))
}

fn read_solver(
    value: Option<Value<'_>>,
    statement: &Statement,
    grid: &Grid,
    count: usize,
) -> Result<(Option<Method>, NewtonOptions), InputError> {
    const DENSE_LIMIT: usize = 4096;
    let mut options = NewtonOptions::default();
    let mut method = match statement {
        Statement::Lagrangian { .. } => Some(Method::fitting(grid.steps(), count)),
        Statement::Equation { .. } => None,
    };
    let Some(value) = value else { return Ok((method, options)) };
    let table = value.table()?;
    table.allow(&["method", "tolerance", "iterations", "krylov-iterations"])?;
    if let Some(value) = table.optional("method") {
        let chosen = value.choice(&[("dense", Method::Dense), ("krylov", Method::Krylov)])?;
        if method.is_none() {
            return Err(value.key_error(Problem::Incompatible {
                with: "`problem.terms`".to_owned(),
                allowed: "`method` belongs to a Lagrangian; embedded equations have one way".to_owned(),
            }));
        }
        method = Some(chosen);
        if chosen == Method::Dense && grid.steps() * count > DENSE_LIMIT {
            return Err(value.error(Problem::Incompatible {
                with: "`interval.steps`".to_owned(),
                allowed: format!("\"dense\" for at most {DENSE_LIMIT} unknowns, \"krylov\" for any number"),
            }));
        }
    }
    if let Some(value) = table.optional("tolerance") {
        options.tolerance = value.number()?;
        if !(1e-15..=0.1).contains(&options.tolerance) {
            return Err(value.out_of_range("1e-15 ≤ tolerance ≤ 0.1"));
        }
    }
    if let Some(value) = table.optional("iterations") {
        options.iterations = value.whole(1..=usize::MAX)?;
    }
    if let Some(value) = table.optional("krylov-iterations") {
        options.krylov_iterations = value.whole(1..=usize::MAX)?;
    }
    Ok((method, options))
}

fn read_reference(
    table: &Table<'_>,
    document: &Document,
    symbols: &Symbols,
    grid: &Grid,
    count: usize,
) -> Result<KnownPositions, InputError> {
    table.allow(&["position", "file"])?;
    let (is_position, value) = table.either("position", "file")?;
    if is_position {
        let position = expressions(&value, symbols, count)?;
        let entries = value.list("a list of expressions in quotes")?;
        for (entry, expression) in entries.iter().zip(&position) {
            let finite = |k: usize| expression.value::<f64>(Moment::inside(grid.time(k)), &[]).is_finite();
            // At the ends the positions are given, so there is nothing to compare.
            if !(1..grid.steps()).any(finite) {
                let place = "any grid point between the ends".to_owned();
                return Err(entry.error(Problem::NotFinite { what: "the reference", place }));
            }
        }
        return Ok(KnownPositions::Expressions { position });
    }
    let columns: Vec<String> = (0..count).map(|index| format!("x{index}")).collect();
    let known = NumberTable::read(&value, document, &columns)?;
    let places: Option<Vec<usize>> =
        columns.iter().map(|column| known.names.iter().position(|name| name == column)).collect();
    let file = value.text()?.to_owned();
    let Some(places) = places else {
        let reason = format!("the columns must be t,{}", columns.join(","));
        return Err(value.error(Problem::Table { file, line: 1, reason }));
    };
    let row = |numbers: &Vec<f64>| [0].iter().chain(&places).map(|&place| numbers[place]).collect();
    let reference = KnownPositions::Table { file: file.clone(), rows: known.rows.iter().map(row).collect() };
    if !(1..grid.steps()).any(|k| reference.at(grid.time(k), grid.step()).is_some()) {
        let reason = "none of its times is a grid point between the ends".to_owned();
        return Err(value.error(Problem::Table { file, line: 2, reason }));
    }
    Ok(reference)
}
