//! Scenarios made in code.

use super::Scenario;
use super::event::{Action, Direction};
use super::own_terms::{OwnTerms, SharedTerms};
use super::scheme::Scheme;
use super::system::{Derivative, KernelKeys};
use crate::language::expression::Moment;
use crate::language::{InputError, Problem};
use fvi_core::ParameterError;
use fvi_fft::memory::{Engine, History};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::transfer::TransferFunction;
use nalgebra::DMatrix;
use serde::Serialize;
use toml::{Table, Value};

/// A symmetric matrix given in code: its diagonal, or its rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Entries(Value);

impl<const N: usize> From<[f64; N]> for Entries {
    /// The numbers of the diagonal.
    fn from(diagonal: [f64; N]) -> Self {
        Self::from(diagonal.as_slice())
    }
}

impl From<&[f64]> for Entries {
    /// The numbers of the diagonal.
    fn from(diagonal: &[f64]) -> Self {
        Self(numbers(diagonal))
    }
}

impl From<Vec<f64>> for Entries {
    /// The numbers of the diagonal.
    fn from(diagonal: Vec<f64>) -> Self {
        Self::from(diagonal.as_slice())
    }
}

impl<const N: usize, const M: usize> From<[[f64; M]; N]> for Entries {
    /// The rows.
    fn from(rows: [[f64; M]; N]) -> Self {
        Self(Value::Array(rows.iter().map(|row| numbers(row)).collect()))
    }
}

impl From<DMatrix<f64>> for Entries {
    fn from(matrix: DMatrix<f64>) -> Self {
        let row = |row: usize| Value::Array(matrix.row(row).iter().copied().map(Value::Float).collect());
        Self(Value::Array((0..matrix.nrows()).map(row).collect()))
    }
}

fn numbers(numbers: &[f64]) -> Value {
    Value::Array(numbers.iter().copied().map(Value::Float).collect())
}

/// A damping term −ρ K(D) q.
#[derive(Clone, Debug)]
pub struct Damper {
    kernel: TransferFunction,
    coefficient: Entries,
    derivative: Derivative,
    allow_active: bool,
}

impl Damper {
    /// The term with the kernel K(s) and ρ, symmetric and positive semidefinite, N×N; on Caputo's derivative.
    pub fn new(kernel: TransferFunction, coefficient: impl Into<Entries>) -> Self {
        let coefficient = coefficient.into();
        Self { kernel, coefficient, derivative: Derivative::Caputo, allow_active: false }
    }

    /// The term −ρ D^β q with the damping order β = 2α.
    ///
    /// # Errors
    /// Unless 0 ≤ β < 2.
    pub fn of_order(beta: f64, coefficient: impl Into<Entries>) -> Result<Self, ParameterError> {
        Ok(Self::new(TransferFunction::power(beta)?, coefficient))
    }

    /// The same term on another motion: for Riemann–Liouville's derivative that on q itself.
    pub fn on(self, derivative: Derivative) -> Self {
        Self { derivative, ..self }
    }

    /// Admits a kernel that is not passive, which may give back more energy than it was given.
    pub fn allow_active(self) -> Self {
        Self { allow_active: true, ..self }
    }

    fn keys(&self) -> Result<Value, toml::ser::Error> {
        let mut keys = Table::new();
        match self.kernel.exponent() {
            Some(order) => keys.insert("order".to_owned(), Value::Float(order)),
            None => keys.insert("kernel".to_owned(), Value::try_from(KernelKeys(&self.kernel))?),
        };
        if self.allow_active {
            keys.insert("allow_active".to_owned(), Value::Boolean(true));
        }
        keys.insert("coefficient".to_owned(), self.coefficient.0.clone());
        keys.insert("derivative".to_owned(), Value::try_from(self.derivative)?);
        Ok(Value::Table(keys))
    }
}

/// A scenario made in code, a call for each part; what is not given has the default of a file.
///
/// A mass on a hardening spring beside a fractional Maxwell element, until it first passes its place of rest:
///
/// ```
/// use fvi_fft::memory::Engine;
/// use fvi_fft::quadrature::ConvolutionFamily;
/// use fvi_fft::transfer::TransferFunction;
/// use fvi_scenario::scenario::{Action, Damper, Direction, Scenario, Scheme};
///
/// let scenario = Scenario::builder([1.0])
///     .potential("0.5*q0^2 + 0.1*q0^4")
///     .damper(Damper::new(TransferFunction::maxwell(0.6, 0.0, 1.0)?, [1.5]))
///     .position([1.0])
///     .scheme(Scheme::Galerkin { degree: 2, quadrature: None })
///     .convolution(ConvolutionFamily::Bdf { order: 4 })
///     .engine(Engine::ExponentialSum)
///     .event("q0", Direction::Both, Action::Stop)
///     .until(0.01, 20.0)
///     .build()?;
/// assert_eq!(scenario.time.steps, 2000);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Default)]
#[must_use = "a builder does nothing until `build`"]
pub struct ScenarioBuilder {
    root: Table,
    terms: Option<SharedTerms>,
    in_code: InCode,
    /// The first value that no file could hold.
    refused: Option<(String, String)>,
}

impl Scenario {
    /// Begins a scenario with the mass matrix M of its N coordinates, as its diagonal or its rows; a zero on
    /// the diagonal is a coordinate without mass.
    pub fn builder(mass: impl Into<Entries>) -> ScenarioBuilder {
        ScenarioBuilder::default().with("system.mass", mass.into().0)
    }
}

impl ScenarioBuilder {
    /// The title of the pictures.
    pub fn title(self, title: &str) -> Self {
        self.set("title", title)
    }

    /// K, symmetric, of the force −K q.
    pub fn stiffness(self, stiffness: impl Into<Entries>) -> Self {
        self.with("system.stiffness", stiffness.into().0)
    }

    /// U(q) as an expression in q0 … and the parameters.
    pub fn potential(self, potential: &str) -> Self {
        self.set("system.potential", potential)
    }

    /// F(t, q, v) as one expression for each coordinate, in t, q0 …, v0 … and the parameters.
    pub fn force<const N: usize>(self, components: [&str; N]) -> Self {
        self.set("system.force", components.as_slice())
    }

    /// A named constant of the expressions.
    pub fn parameter(self, name: &str, value: f64) -> Self {
        self.set(&format!("system.parameters.{name}"), value)
    }

    /// U(q) in code, in addition to that of an expression: its value, and a function that writes ∇U, N
    /// numbers, and ∂²U/∂q², N×N numbers row by row.
    pub fn potential_in_code(
        mut self,
        value: impl FnMut(&[f64]) -> f64 + Send + 'static,
        derivatives: impl FnMut(&[f64], &mut [f64], &mut [f64]) + Send + 'static,
    ) -> Self {
        self.in_code.potential = Some((Box::new(value), Box::new(derivatives)));
        self
    }

    /// F(t, q) in code, in addition to that of expressions: a function that writes F, N numbers, and ∂F/∂q,
    /// N×N numbers row by row.
    pub fn force_in_code(
        mut self,
        force: impl FnMut(f64, &[f64], &mut [f64], &mut [f64]) + Send + 'static,
    ) -> Self {
        self.in_code.force = Some(Box::new(force));
        self
    }

    /// Any other potential and forces in code, such as those with velocities or few entries; replaces those
    /// of the two calls above.
    pub fn own_terms(self, terms: SharedTerms) -> Self {
        Self { terms: Some(terms), ..self }
    }

    /// Adds a damping term.
    pub fn damper(mut self, damper: Damper) -> Self {
        match damper.keys() {
            Ok(keys) => self.append("system", "damping", keys),
            Err(error) => self.refuse("system.damping", &error),
        }
        self
    }

    /// q₀; zero otherwise.
    pub fn position(self, position: impl AsRef<[f64]>) -> Self {
        self.with("initial.position", numbers(position.as_ref()))
    }

    /// v₀; at rest otherwise.
    pub fn velocity(self, velocity: impl AsRef<[f64]>) -> Self {
        self.with("initial.velocity", numbers(velocity.as_ref()))
    }

    /// p₀ = M v₀, in place of v₀.
    pub fn momentum(self, momentum: impl AsRef<[f64]>) -> Self {
        self.with("initial.momentum", numbers(momentum.as_ref()))
    }

    /// The integrator; the midpoint rule otherwise.
    pub fn scheme(self, scheme: Scheme) -> Self {
        self.set("scheme", scheme)
    }

    /// The family of convolution quadratures; that which goes with the scheme otherwise.
    pub fn convolution(self, family: ConvolutionFamily) -> Self {
        self.set("convolution", family)
    }

    /// The engine of the memory; the fastest that is exact to rounding otherwise.
    pub fn engine(self, engine: Engine) -> Self {
        self.history(History { engine: Some(engine), ..History::default() })
    }

    /// The engine with its settings.
    pub fn history(self, history: History) -> Self {
        self.set("history", history)
    }

    /// `steps` steps of the length h.
    pub fn steps(self, step: f64, steps: usize) -> Self {
        self.set("time.step", step).set("time.steps", steps)
    }

    /// Steps of the length h to the end time, a multiple of h.
    pub fn until(self, step: f64, end: f64) -> Self {
        self.set("time.step", step).set("time.end", end)
    }

    /// Steps of any length to the end time, chosen for an error of positions up to the tolerance.
    pub fn adaptive(self, end: f64, tolerance: f64) -> Self {
        self.set("time.end", end).set("time.tolerance", tolerance)
    }

    /// Adds an event: `when`, an expression in t, q0 …, p0 … and the parameters, passes zero.
    pub fn event(mut self, when: &str, direction: Direction, action: Action) -> Self {
        #[derive(Serialize)]
        struct Keys<'a> {
            when: &'a str,
            direction: Direction,
            action: Action,
        }
        match Value::try_from(Keys { when, direction, action }) {
            Ok(keys) => self.append("", "event", keys),
            Err(error) => self.refuse("event", &error),
        }
        self
    }

    /// Any other key of a scenario by its path, such as `output.every`.
    pub fn set(mut self, path: &str, value: impl Serialize) -> Self {
        match Value::try_from(value) {
            Ok(value) => self.with(path, value),
            Err(error) => {
                self.refuse(path, &error);
                self
            }
        }
    }

    /// Checks the whole.
    ///
    /// # Errors
    /// The first value that cannot be used, by its key in a file.
    pub fn build(self) -> Result<Scenario, InputError> {
        if let Some((path, reason)) = self.refused {
            return Err(InputError::unreadable(&path, Problem::Unreadable { reason }));
        }
        let scenario = Scenario::from_value(&self.root)?;
        let count = scenario.coordinates();
        let terms = self.terms.or_else(|| self.in_code.shared(count));
        Ok(match terms {
            Some(terms) => scenario.with_own_terms(terms),
            None => scenario,
        })
    }

    fn refuse(&mut self, path: &str, reason: &toml::ser::Error) {
        self.refused.get_or_insert_with(|| (path.to_owned(), reason.to_string()));
    }

    fn with(mut self, path: &str, value: Value) -> Self {
        let mut table = &mut self.root;
        let mut names = path.split('.').peekable();
        while let Some(name) = names.next() {
            if names.peek().is_none() {
                table.insert(name.to_owned(), value);
                break;
            }
            let next = table.entry(name).or_insert_with(|| Value::Table(Table::new()));
            if !next.is_table() {
                *next = Value::Table(Table::new());
            }
            let Value::Table(inner) = next else { break };
            table = inner;
        }
        self
    }

    /// Appends to the list `name` of a table of the root, or of the root itself.
    fn append(&mut self, of: &str, name: &str, value: Value) {
        let table = if of.is_empty() {
            &mut self.root
        } else {
            let inner = self.root.entry(of).or_insert_with(|| Value::Table(Table::new()));
            let Value::Table(inner) = inner else { return };
            inner
        };
        if let Value::Array(list) = table.entry(name).or_insert_with(|| Value::Array(Vec::new())) {
            list.push(value);
        }
    }
}

type PotentialValue = Box<dyn FnMut(&[f64]) -> f64 + Send>;
type PotentialDerivatives = Box<dyn FnMut(&[f64], &mut [f64], &mut [f64]) + Send>;
type ForceAndDerivative = Box<dyn FnMut(f64, &[f64], &mut [f64], &mut [f64]) + Send>;

/// Potential and force as functions.
#[derive(Default)]
struct InCode {
    potential: Option<(PotentialValue, PotentialDerivatives)>,
    force: Option<ForceAndDerivative>,
    /// Room for what a function writes: N numbers, and N×N.
    vector: Vec<f64>,
    matrix: Vec<f64>,
    largest: Vec<f64>,
}

impl InCode {
    fn shared(mut self, count: usize) -> Option<SharedTerms> {
        if self.potential.is_none() && self.force.is_none() {
            return None;
        }
        (self.vector, self.largest) = (vec![0.0; count], vec![0.0; count]);
        self.matrix = vec![0.0; count * count];
        Some(SharedTerms::new(self))
    }

    /// Adds ∇U − F and, if it is asked for, ∂²U/∂q² − ∂F/∂q.
    fn add(&mut self, time: f64, position: &[f64], restoring: &mut [f64], stiffness: Option<&mut [f64]>) {
        let Self { potential, force, vector, matrix, largest } = self;
        let mut stiffness = stiffness;
        let mut add = |sign: f64, vector: &[f64], matrix: &[f64]| {
            restoring.iter_mut().zip(vector).for_each(|(sum, part)| *sum += sign * part);
            if let Some(stiffness) = &mut stiffness {
                stiffness.iter_mut().zip(matrix).for_each(|(sum, part)| *sum += sign * part);
            }
        };
        if let Some((_, derivatives)) = potential {
            vector.fill(0.0);
            matrix.fill(0.0);
            derivatives(position, vector, matrix);
            add(1.0, vector, matrix);
        }
        if let Some(force) = force {
            vector.fill(0.0);
            matrix.fill(0.0);
            force(time, position, vector, matrix);
            add(-1.0, vector, matrix);
            for (largest, force) in largest.iter_mut().zip(vector.iter()) {
                *largest = largest.max(force.abs());
            }
        }
    }
}

impl OwnTerms for InCode {
    fn potential(&mut self, position: &[f64]) -> f64 {
        match &mut self.potential {
            Some((value, _)) => value(position),
            None => 0.0,
        }
    }

    fn add_restoring_force(&mut self, moment: Moment<f64>, position: &[f64], restoring: &mut [f64]) {
        self.add(moment.sided(), position, restoring, None);
    }

    fn add_linearisation(
        &mut self,
        moment: Moment<f64>,
        position: &[f64],
        restoring: &mut [f64],
        stiffness: &mut [f64],
    ) {
        self.add(moment.sided(), position, restoring, Some(stiffness));
    }

    fn take_largest_force(&mut self, largest: &mut [f64]) {
        largest.copy_from_slice(&self.largest);
        self.largest.fill(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::to_value;

    #[test]
    fn what_is_built_is_what_the_file_says() {
        let built = Scenario::builder([1.0, 2.0])
            .title("two masses")
            .stiffness([[2.0, -1.0], [-1.0, 2.0]])
            .potential("a*q0^4")
            .force(["0", "sin(t) - v1"])
            .parameter("a", 0.25)
            .damper(Damper::of_order(0.5, [0.1, 0.2]).unwrap().on(Derivative::RiemannLiouville))
            .damper(Damper::new(TransferFunction::maxwell(0.6, 0.0, 1.0).unwrap(), [1.5, 0.0]))
            .position([0.0, 0.0])
            .velocity([1.0, 0.0])
            .scheme(Scheme::Galerkin { degree: 2, quadrature: None })
            .convolution(ConvolutionFamily::Bdf { order: 4 })
            .engine(Engine::BlockFft)
            .event("q0 - 0.5", Direction::Rising, Action::Record)
            .event("q1 - 0.2", Direction::Both, Action::Stop)
            .set("output.every", 5)
            .steps(0.01, 300)
            .build()
            .unwrap();
        let read: Scenario = r#"
            title = "two masses"
            [system]
            mass = [1.0, 2.0]
            stiffness = [[2.0, -1.0], [-1.0, 2.0]]
            potential = "a*q0^4"
            force = ["0", "sin(t) - v1"]
            parameters.a = 0.25
            damping = [
                { order = 0.5, coefficient = [0.1, 0.2], derivative = "riemann-liouville" },
                { kernel = { form = "maxwell", order = 0.6, time = 1.0 }, coefficient = [1.5, 0.0] },
            ]
            [initial]
            position = [0.0, 0.0]
            velocity = [1.0, 0.0]
            [scheme]
            kind = "galerkin"
            degree = 2
            [convolution]
            order = 4
            [history]
            engine = "block-fft"
            [output]
            every = 5
            [[event]]
            when = "q0 - 0.5"
            direction = "rising"
            [[event]]
            when = "q1 - 0.2"
            action = "stop"
            [time]
            step = 0.01
            steps = 300
        "#
        .parse()
        .unwrap();
        assert_eq!(to_value(&built).unwrap(), to_value(&read).unwrap());
    }

    #[test]
    fn what_is_wrong_is_named_by_its_key() {
        let error = |builder: ScenarioBuilder| builder.build().unwrap_err().to_string();
        let rest = || Scenario::builder([1.0]).steps(0.1, 10);
        assert!(error(Scenario::builder([1.0])).contains("time"));
        assert!(error(rest().position([1.0, 2.0])).contains("initial.position"));
        assert!(error(rest().position([f64::NAN])).contains("initial.position"));
        assert!(error(rest().potential("0.5*q1^2")).contains("system.potential"));
        assert!(error(rest().set("output.sometimes", 5)).contains("sometimes"));
        assert!(error(rest().set("output.every", u64::MAX)).contains("output.every"));
        assert!(Damper::of_order(2.0, [1.0]).is_err());
    }

    #[test]
    fn functions_add_their_potential_and_force() {
        let scenario = Scenario::builder([1.0])
            .potential_in_code(
                |q| 0.25 * q[0].powi(4),
                |q, slope, curvature| {
                    slope[0] = q[0].powi(3);
                    curvature[0] = 3.0 * q[0].powi(2);
                },
            )
            .force_in_code(|t, q, force, derivative| {
                force[0] = t - 2.0 * q[0];
                derivative[0] = -2.0;
            })
            .position([0.5])
            .steps(0.1, 10)
            .build()
            .unwrap();
        scenario.system.own_terms.unwrap().with(|terms| {
            let (mut restoring, mut stiffness, mut largest) = ([1.0], [1.0], [0.0]);
            terms.add_linearisation(Moment::inside(3.0), &[0.5], &mut restoring, &mut stiffness);
            assert_eq!((restoring, stiffness), ([1.0 + 0.125 - 2.0], [1.0 + 0.75 + 2.0]));
            assert_eq!(terms.potential(&[2.0]), 4.0);
            terms.take_largest_force(&mut largest);
            assert_eq!(largest, [2.0]);
        });
    }
}
