//! Scenario files: everything a run is made from, read and checked.
//!
//! A [`Scenario`] holds the contents of the TOML file, with defaults filled in and every value checked; it
//! does not depend on how it is run. Its serialised form is the record of the inputs as used.

mod adaptive;
mod appearance;
mod automatic;
mod builder;
mod case;
mod combinations;
mod controller;
mod convex;
mod element;
mod equation;
mod event;
mod grid;
mod gyroscopic;
mod initial;
mod kernel;
mod keys;
mod kinetic;
mod load;
mod matrix;
mod members;
mod own_terms;
mod parameters;
mod past;
mod plant_formula;
mod reference;
mod relaxation_matrix;
mod sampled_input;
mod scheme;
mod scheme_descriptor;
mod sensitivity;
mod sparse_matrix;
mod symbol;
mod system;
mod time;
mod warnings;
mod waves;

pub use adaptive::Adaptive;
#[doc(hidden)]
pub use adaptive::Start;
pub use appearance::{Appearance, Paper, Units};
pub use automatic::Automatic;
#[doc(hidden)]
pub use automatic::{Candidate, Fineness, Method, Spread};
pub use builder::{Damper, Entries, ScenarioBuilder};
pub use case::Case;
#[doc(hidden)]
pub use combinations::{Feature, MARK as COMBINATIONS_MARK, ROWS, Row, page as combinations_page};
#[doc(hidden)]
pub use controller::counts_within;
pub use controller::{Controller, Noise, Quantise, Setpoint};
pub use element::Element;
pub use equation::{Equation, EquationCoordinate, NamedDerivative, Term};
pub use event::{Action, Direction, Event, SharedFunction};
pub use grid::{Grid, GridRule};
pub use gyroscopic::SkewMatrix;
pub use initial::InitialState;
#[doc(hidden)]
pub use kernel::{kernel_of_document, kernel_of_file, kernel_of_symbol, kernel_of_table, weights_of};
#[doc(hidden)]
pub use keys::KEYS;
pub use load::{Amplitude, Load, Pattern, Record};
pub use matrix::SymmetricMatrix;
pub use members::Members;
pub use own_terms::OwnTerms;
#[doc(hidden)]
pub use own_terms::SharedTerms;
#[doc(hidden)]
pub use parameters::read_parameters;
pub use past::Past;
#[doc(hidden)]
pub use plant_formula::{PlantFormula, Quotient};
pub use reference::{Reference, ReferenceRow, ReferenceSource};
#[doc(hidden)]
pub use relaxation_matrix::RelaxationMatrix;
pub use sampled_input::SampledInput;
pub use scheme::{Convolution, DampedAt, Quadrature, Scheme};
#[doc(hidden)]
pub use scheme_descriptor::SchemeDescriptor;
pub use sensitivity::Sensitivity;
#[doc(hidden)]
pub use sensitivity::{Named, Parameter, Quantity};
#[doc(hidden)]
pub use sparse_matrix::KnownMatrices;
pub use sparse_matrix::SparseMatrix;
pub use system::{Along, Attached, Damping, Derivative, ForceQuadrature, System};
pub use time::{
    LARGEST_TOLERANCE, MOST_STEPS, OnEnergyGrowth, OutputOptions, ReportedMomentum,
    SMALLEST_SINGLE_TOLERANCE, TimeGrid,
};
pub use waves::Waves;

use crate::language::document::{Document, Table};
use crate::language::expression::Moment;
use crate::language::{InputError, Problem, number_at, put_with_mirror};
use equation::RightSides;
use fvi_core::min_or_nan;
use fvi_fft::dense;
use fvi_fft::memory::History;
use nalgebra::DVector;
use serde::Serialize;
use std::path::Path;
use time::read_history;

/// Largest number of coordinates of a large system for which all are columns of the trajectory by default.
const MOST_COLUMNS: usize = 64;

/// The keys and tables of a scenario.
const TABLES: [&str; 15] = [
    "title",
    "system",
    "initial",
    "equation",
    "scheme",
    "convolution",
    "time",
    "history",
    "output",
    "input",
    "reference",
    "case",
    "event",
    "controller",
    "sensitivity",
];

/// A scenario with checked values.
#[derive(Clone, Debug, Serialize)]
pub struct Scenario {
    /// Title of the pictures.
    pub title: Option<String>,
    /// The mechanical system, or the coordinates without mass that stand for the equation.
    #[serde(skip_serializing_if = "System::stands_for_equation")]
    pub system: System,
    /// Initial state.
    #[serde(skip_serializing_if = "InitialState::is_of_equation")]
    pub initial: InitialState,
    /// Fractional differential equations, in place of a mechanical system and its initial state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub equation: Option<Equation>,
    /// The integrator.
    pub scheme: Scheme,
    /// Discretisation of the fractional derivatives.
    pub convolution: Convolution,
    /// The time grid.
    pub time: TimeGrid,
    /// The memory engine.
    pub history: History,
    /// Output options.
    pub output: OutputOptions,
    /// A force given by samples, each held until the next.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub input: Option<SampledInput>,
    /// Known solution for comparison.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference: Option<Reference>,
    /// Load cases, integrated together; empty: one motion under the loads of the system.
    #[serde(rename = "case", skip_serializing_if = "Vec::is_empty")]
    pub cases: Vec<Case>,
    /// Events to detect.
    #[serde(rename = "event", skip_serializing_if = "Vec::is_empty")]
    pub events: Vec<Event>,
    /// Controllers.
    #[serde(rename = "controller", skip_serializing_if = "Vec::is_empty")]
    pub controllers: Vec<Controller>,
    /// Parameters for which the derivatives of the motion are computed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensitivity: Option<Sensitivity>,
    /// What is asked for in place of a scheme and a grid; scheme, convolution and grid are the default ones
    /// until they are chosen, and nothing moves before.
    #[serde(skip)]
    pub automatic: Option<Automatic>,
    #[serde(skip)]
    document: Document,
}

impl std::str::FromStr for Scenario {
    type Err = InputError;

    /// Reads and checks a scenario in TOML; names of files in it are relative to the working directory.
    fn from_str(text: &str) -> Result<Self, InputError> {
        Self::from_document(Document::new("scenario", Path::new(""), text))
    }
}

impl Scenario {
    /// Descriptor of the scheme with its convolution quadrature.
    pub fn scheme_descriptor(&self) -> SchemeDescriptor {
        self.scheme.descriptor(self.convolution.family)
    }

    /// Order in h of positions and momenta on steps of any length.
    ///
    /// That of the scheme, but for variational schemes at most w + 2 − β, w the stage order of the
    /// Runge–Kutta family and β the largest order of the damping: the quadrature at the stages has no higher
    /// one.
    pub fn order_of_varying_steps(&self) -> f64 {
        let descriptor = self.scheme_descriptor();
        let order = descriptor.order as f64;
        let Some(method) = self.convolution.family.staged().filter(|_| descriptor.is_variational) else {
            return order;
        };
        let growth = self.system.damping.iter().map(|term| term.transfer.growth());
        growth.map(|growth| method.stage_order() as f64 + 2.0 - growth).fold(order, min_or_nan)
    }

    /// Reads and checks a scenario file.
    ///
    /// # Errors
    /// The first value in the file that cannot be used, with its location.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        Self::from_document(Document::read(path)?)
    }

    /// Checks a scenario that has been read into a document.
    ///
    /// # Errors
    /// The first value in the document that cannot be used, with its location.
    pub fn from_document(document: Document) -> Result<Self, InputError> {
        Self::sharing(document, None)
    }

    /// As [`from_document`](Self::from_document), sharing matrices that other scenarios have read.
    ///
    /// # Errors
    /// The first value in the document that cannot be used, with its location.
    pub fn knowing(document: Document, known: &KnownMatrices) -> Result<Self, InputError> {
        Self::sharing(document, Some(known))
    }

    fn sharing(document: Document, known: Option<&KnownMatrices>) -> Result<Self, InputError> {
        if let Some(automatic) = Automatic::of(&document)? {
            return automatic.unchosen(document, known);
        }
        let scenario = document.with_root(|root| Self::from_root(&root, &document, known))?;
        scenario.check_start()?;
        scenario.check_combinations()?;
        Ok(scenario)
    }

    /// A scenario constructed in code: from any value that serialises to the keys of a scenario file, such as
    /// a [`Scenario`].
    ///
    /// ```
    /// # use fvi_scenario::scenario::Scenario;
    /// let scenario = Scenario::from_value(&serde_json::json!({
    ///     "system": {
    ///         "mass": [1.0],
    ///         "potential": "1 - cos(q0)",
    ///         "damping": [{ "order": 0.5, "coefficient": [0.1] }],
    ///     },
    ///     "initial": { "position": [2.0], "momentum": [0.0] },
    ///     "time": { "step": 0.01, "steps": 1000 },
    /// }))?;
    /// assert_eq!(scenario.coordinates(), 1);
    /// # Ok::<(), fvi_scenario::language::InputError>(())
    /// ```
    ///
    /// # Errors
    /// The first value that cannot be used, with its location in the equivalent file.
    pub fn from_value(value: &impl Serialize) -> Result<Self, InputError> {
        Self::from_document(Document::of_value("scenario", Path::new(""), value)?)
    }

    /// The scenario with a potential and forces in code in addition to those of the file; of an equation with
    /// forces on its n unknowns, of time and the unknowns, in addition to its right sides.
    pub fn with_own_terms(mut self, terms: SharedTerms) -> Self {
        self.system.own_terms = Some(match &self.equation {
            Some(equation) => RightSides::of(equation, terms),
            None => terms,
        });
        self
    }

    /// The convolution quadrature of an equation that names none.
    fn convolution_of_equation(root: &Table<'_>) -> Result<Convolution, InputError> {
        let time = root.required("time")?.table()?;
        let given = |key: &str| time.optional(key).is_some();
        // Of steps that are given the number of stages decides nothing but their accuracy.
        if given("step") || given("steps") || given("points") || given("ratio") {
            return Ok(Convolution::default_for(&Scheme::for_equations()));
        }
        let tolerance = time.optional("tolerance").and_then(|value| value.number().ok());
        Ok(Convolution::for_equations(tolerance.unwrap_or(Adaptive::USUAL_TOLERANCE)))
    }

    fn from_root(
        root: &Table<'_>,
        document: &Document,
        known: Option<&KnownMatrices>,
    ) -> Result<Self, InputError> {
        root.allow(&TABLES)?;
        let title = root.optional("title").map(|value| value.text().map(str::to_owned)).transpose()?;
        // Grids with different steps have no `step`; errors in it are reported when `time` is read.
        let step =
            root.optional("time").and_then(|value| value.table().ok()?.optional("step")?.positive().ok());
        let (equation, system, mut initial) = Self::read_problem(root, known, step)?;
        let count = system.names().count();
        let scheme = match root.optional("scheme") {
            Some(value) => Scheme::read(&value.table()?)?,
            None if equation.is_some() => Scheme::for_equations(),
            None if system.is_mechanism() => Scheme::OF_MECHANISMS,
            None => Scheme::default(),
        };
        let convolution = match root.optional("convolution") {
            Some(value) => Convolution::read(&value.table()?, &scheme, system.is_mechanism())?,
            None if system.is_mechanism() => Convolution::of_mechanism(&scheme),
            None if equation.is_some() && root.optional("scheme").is_none() => {
                Self::convolution_of_equation(root)?
            }
            None => Convolution::default_for(&scheme),
        };
        let scheme = scheme.with_quadrature_for(convolution.family);
        let descriptor = scheme.descriptor(convolution.family);
        let start = Adaptive::start(&system, &initial);
        let time = TimeGrid::read(&root.required("time")?.table()?, start, document)?;
        if let Some(value) = root.optional("initial").map(|value| value.table()).transpose()?
            && let Some(value) = value.optional("past")
        {
            initial.past = Some(Past::read(&value, count, past::rows_of_step(&scheme, &convolution))?);
        }
        if let (Some(value), false) = (root.optional("convolution"), time.allow_unstable) {
            convolution.check_exponents(&value.table()?, &system)?;
        }
        let mut history = match root.optional("history") {
            Some(value) => {
                let samples = time.steps.saturating_add(1).saturating_add(initial.past_steps());
                read_history(&value.table()?, samples)?
            }
            None => History::default(),
        };
        history.rates = time.adaptive().and_then(Adaptive::tolerance_of_rates);
        let output = Self::read_output(root, &descriptor, (&system, &time), document)?;
        let input = match root.optional("input") {
            Some(value) => Some(SampledInput::read(&value.table()?, count, &time, document)?),
            None => None,
        };
        let reference = match root.optional("reference") {
            Some(value) => Some(Reference::read(&value.table()?, &system, (&time, &output), document)?),
            None => None,
        };
        let cases = match root.optional("case") {
            Some(value) => Case::read_all(&value, &system)?,
            None => Vec::new(),
        };
        let events = match root.optional("event") {
            Some(value) => value
                .list("a list of tables, each headed [[event]]")?
                .iter()
                .map(|event| Event::read(&event.table()?, &system))
                .collect::<Result<_, _>>()?,
            None => Vec::new(),
        };
        let controllers = match root.optional("controller") {
            Some(value) => Controller::read_all(&value, (&system, &time), document)?,
            None => Vec::new(),
        };
        let document = document.clone();
        let mut scenario = Self {
            title,
            system,
            initial,
            equation,
            scheme,
            convolution,
            time,
            history,
            output,
            input,
            reference,
            cases,
            events,
            controllers,
            sensitivity: None,
            automatic: None,
            document,
        };
        if let Some(value) = root.optional("sensitivity") {
            scenario.sensitivity = Some(Sensitivity::read(&value.table()?, &scenario)?);
        }
        Ok(scenario)
    }

    /// The system and its initial state, or the equation with those that stand for it.
    fn read_problem(
        root: &Table<'_>,
        known: Option<&KnownMatrices>,
        step: Option<f64>,
    ) -> Result<(Option<Equation>, System, InitialState), InputError> {
        if let Some(value) = root.optional("equation") {
            for key in ["system", "initial", "case", "controller", "input", "sensitivity"] {
                if let Some(other) = root.optional(key) {
                    return Err(other.key_error(Problem::Conflict { other: "equation".to_owned() }));
                }
            }
            let (equation, system, initial) = Equation::read(&value.table()?)?;
            return Ok((Some(equation), system, initial));
        }
        // Errors in it are reported when `initial` is read.
        let start = root
            .optional("initial")
            .and_then(|value| value.table().ok()?.optional("position")?.numbers().ok());
        let system = System::read(&root.required("system")?.table()?, known, step, start.as_deref())?;
        let initial = match root.optional("initial") {
            Some(value) => InitialState::read(&value.table()?, &system)?,
            None => InitialState::at_rest(system.coordinates()),
        };
        Ok((None, system, initial))
    }

    /// The output; of an equation its unknowns, and nothing that it has not.
    fn read_output(
        root: &Table<'_>,
        descriptor: &SchemeDescriptor,
        (system, time): (&System, &TimeGrid),
        document: &Document,
    ) -> Result<OutputOptions, InputError> {
        let (count, of_equation) = (system.names().count(), system.stands_for_equation());
        let mut output = match root.optional("output") {
            Some(value) => {
                let table = value.table()?;
                if of_equation {
                    table.allow(&[
                        "every",
                        "coordinates",
                        "times",
                        "momentum",
                        "labels",
                        "units",
                        "picture",
                    ])?;
                }
                OutputOptions::read(&table, descriptor, count, time)?
            }
            None => OutputOptions::default_for(descriptor),
        };
        if of_equation {
            output.coordinates.get_or_insert_with(|| (0..count).collect());
        }
        if system.is_large() && count > MOST_COLUMNS && output.coordinates.is_none() {
            let reason = format!(
                "`output.coordinates` must say which of the {count} coordinates are written: more than {MOST_COLUMNS} are not by default"
            );
            return Err(document.error_at("output.coordinates", Problem::Unusable { reason }));
        }
        Ok(output)
    }

    /// The same scenario over the same time in another number of steps, with the whole state after each step.
    pub fn in_steps(&self, steps: usize) -> Self {
        let mut scenario = self.clone();
        scenario.output.every = 1;
        scenario.time = self.time.in_steps(steps);
        if let Some(input) = &mut scenario.input {
            input.place_on(&scenario.time);
        }
        scenario
    }

    /// The same scenario with another number of steps of the same size.
    ///
    /// # Errors
    /// [`Problem::OutOfRange`] for `history.horizon`, if that is given and too short; for `time`, if there
    /// are too many steps.
    pub fn ending_after(&self, steps: usize) -> Result<Self, InputError> {
        self.check_use(Feature::AnotherEnd)?;
        let refused = |key, allowed: String| Err(self.error_at(key, Problem::OutOfRange { allowed }));
        if steps > MOST_STEPS || !self.time.time(steps).is_finite() {
            return refused("time", format!("at most {MOST_STEPS} steps, and an end that is a finite time"));
        }
        if self.history.horizon.is_some_and(|horizon| horizon <= steps) {
            return refused(
                "history.horizon",
                format!("at least {}, for {steps} steps", steps.saturating_add(1)),
            );
        }
        let mut scenario = self.clone();
        scenario.time.steps = steps;
        Ok(scenario)
    }

    /// The same scenario with another end time.
    ///
    /// # Errors
    /// If the time is no grid time, and those of [`ending_after`](Self::ending_after).
    pub fn ending_at(&self, end: f64) -> Result<Self, InputError> {
        self.check_use(Feature::AnotherEnd)?;
        let steps = if end >= self.time.start {
            time::steps_to(end, self.time.start, self.time.step)
        } else {
            Err(time::LEAST_END[usize::from(self.time.start != 0.0)].to_owned())
        };
        let refused = |allowed| {
            self.error_at(
                "time.step",
                Problem::Incompatible { with: format!("an end at t = {end}"), allowed },
            )
        };
        self.ending_after(steps.map_err(refused)?)
    }

    /// True if there is no reference, or it can be compared at one grid point or more.
    pub fn meets_reference(&self) -> bool {
        self.reference.as_ref().is_none_or(|reference| reference.meets(&self.time, &self.output))
    }

    /// True if it is integrated as a mechanism, with Gauss weights.
    pub fn is_mechanism(&self) -> bool {
        matches!(self.convolution.family, fvi_fft::quadrature::ConvolutionFamily::Gauss { .. })
    }

    /// True if the motion is needed between grid points.
    pub fn is_looked_into(&self) -> bool {
        !self.output.times.is_empty() || !self.events.is_empty()
    }

    /// The file it was read from.
    pub fn document(&self) -> &Document {
        &self.document
    }

    /// The number at a path of its file, such as `system.damping[0].order`; `None` if there is none.
    ///
    /// # Errors
    /// If the file is not readable any more.
    pub fn number(&self, path: &str) -> Result<Option<f64>, InputError> {
        Ok(number_at(&self.document.values()?, path))
    }

    /// The scenario with another number at a path of its file, and at its mirror image in a symmetric matrix.
    ///
    /// # Errors
    /// If there is no such path, or the number is not allowed there.
    pub fn with_number(&self, path: &str, number: f64) -> Result<Self, InputError> {
        let mut values = self.document.values()?;
        put_with_mirror(&mut values, path, number)
            .map_err(|reason| self.error_at(path, Problem::Unusable { reason }))?;
        Self::from_document(self.document.with_values(&values))
    }

    /// Number of coordinates N.
    pub fn coordinates(&self) -> usize {
        self.system.coordinates()
    }

    /// Number of samples in a memory: one for each step, of the past too, and the first main node.
    pub fn samples(&self) -> usize {
        self.time.steps.saturating_add(self.initial.past_steps()).saturating_add(1)
    }

    /// The coordinates that are written and drawn.
    pub fn written_coordinates(&self) -> Vec<usize> {
        self.output.coordinates.clone().unwrap_or_else(|| (0..self.coordinates()).collect())
    }

    /// The title, or the file's name without its extension.
    pub fn heading(&self) -> &str {
        self.title.as_deref().unwrap_or_else(|| {
            Path::new(self.document.name()).file_stem().and_then(|stem| stem.to_str()).unwrap_or("run")
        })
    }

    /// An error about the value at `path`, such as `history.engine`, in this scenario's file.
    pub fn error_at(&self, path: &str, problem: Problem) -> InputError {
        match &self.equation {
            Some(equation) => self.document.error_at(&equation.key(path), problem),
            None => self.document.error_at(path, problem),
        }
    }

    /// True if its file has a key that a key of the system it stands for comes from.
    pub(crate) fn has_key(&self, path: &str) -> bool {
        match &self.equation {
            Some(equation) => self.document.has(&equation.key(path)),
            None => self.document.has(path),
        }
    }

    /// An error about the first of these values that is in the file, or about the first path if none is.
    pub fn error_at_first(&self, paths: &[&str], problem: Problem) -> InputError {
        let path = paths.iter().find(|path| self.document.has(path)).or(paths.first());
        self.error_at(path.copied().unwrap_or_default(), problem)
    }

    /// True if a force that changes inside a step acts from that time on.
    pub(crate) fn acts_inside_steps(&self) -> bool {
        self.scheme_descriptor().takes_inputs_inside
            && self.system.force_quadrature == ForceQuadrature::Moments
    }

    /// v₀ = M⁻¹ p₀, zero where there is no mass; `None` for a mass that is known by its entries, which takes
    /// a solution of equations.
    pub fn initial_velocity(&self) -> Option<Vec<f64>> {
        let momentum = &self.initial.momentum;
        match &self.system.mass {
            SymmetricMatrix::Diagonal(masses) => {
                let velocity = |(&p, &mass): (&f64, &f64)| if mass == 0.0 { 0.0 } else { p / mass };
                Some(momentum.iter().zip(masses).map(velocity).collect())
            }
            SymmetricMatrix::Dense(mass) => {
                let mut regular = mass.clone();
                self.system.massless().into_iter().for_each(|row| regular[(row, row)] = 1.0);
                let inverse = dense::inverse(regular)?;
                let mut moving = DVector::from_column_slice(momentum);
                let linear = self.system.linear_momentum();
                moving.iter_mut().zip(linear).for_each(|(p, a)| *p -= a);
                Some((inverse * moving).as_slice().to_vec())
            }
            SymmetricMatrix::Sparse(_) => None,
        }
    }

    /// Refuses a potential or force that is not finite at the start.
    fn check_start(&self) -> Result<(), InputError> {
        let (start, half) = (self.time.start, self.time.start + 0.5 * self.time.step);
        let letter = if self.equation.is_some() { "x" } else { "q" };
        let shown = self.initial.position.get(..self.system.names().count()).unwrap_or_default();
        let place = match shown {
            few if few.len() <= 64 => format!("t = {start}, {letter} = {few:?}"),
            _ => format!("t = {start}"),
        };
        if let Some(potential) = &self.system.potential
            && !potential.value(Moment::inside(start), &self.initial.position).is_finite()
        {
            return Err(
                self.error_at("system.potential", Problem::NotFinite { what: "the potential", place })
            );
        }
        let common = self.system.loads.iter().enumerate();
        let common = common.map(|(index, load)| (format!("system.load[{index}]"), load));
        let of_cases = self.cases.iter().enumerate().flat_map(|(case, Case { loads, .. })| {
            let loads = loads.iter().enumerate();
            loads.map(move |(index, load)| (format!("case[{case}].load[{index}]"), load))
        });
        for (path, load) in common.chain(of_cases) {
            if let Amplitude::Expression(amplitude) = &load.amplitude
                && !amplitude.value::<f64>(Moment::inside(start), &[]).is_finite()
                && !amplitude.value::<f64>(Moment::inside(half), &[]).is_finite()
            {
                let problem = Problem::NotFinite { what: "the amplitude", place: format!("t = {start}") };
                return Err(self.error_at(&format!("{path}.amplitude"), problem));
            }
        }
        let moves = self.system.force_in_words_depends_on_velocity();
        let velocity = if moves { self.initial_velocity() } else { None };
        let point: Vec<f64> =
            self.initial.position.iter().chain(velocity.iter().flatten()).copied().collect();
        for (index, force) in self.system.force.iter().flatten().enumerate() {
            if velocity.is_none() && force.root().has_variable_from(self.coordinates()) {
                continue;
            }
            // A force may be singular at t = 0 alone, which schemes with interior nodes never evaluate; only
            // a force that is not a number later too, because of the coordinates, is certain to fail.
            let value = force.value(Moment::inside(start), &point);
            let later = force.value(Moment::inside(half), &point);
            if !value.is_finite() && !later.is_finite() {
                let what = if self.equation.is_some() { "the right side" } else { "the force" };
                let problem = Problem::NotFinite { what, place };
                return Err(self.error_at(&format!("system.force[{index}]"), problem));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
