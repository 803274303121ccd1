//! Potentials and forces that are Python functions.

use crate::errors::{Failure, Outcome};
use crate::native::NativeFunction;
use fvi_fft::sums::max_or_nan;
use fvi_scenario::language::expression::Moment;
use fvi_scenario::scenario::{OwnTerms, Scenario, SharedFunction, SharedTerms};
use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::{PyArithmeticError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyBool, PyFloat, PyList, PyTuple};
use std::sync::{Arc, Mutex, PoisonError};

/// A function of the caller's.
enum Function {
    Python(Py<PyAny>),
    Native(NativeFunction),
}

impl<'py> FromPyObject<'_, 'py> for Function {
    type Error = PyErr;

    fn extract(given: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        Ok(match NativeFunction::of(&given)? {
            Some(function) => Self::Native(function),
            None => Self::Python(given.to_owned().unbind()),
        })
    }
}

/// The functions, under the names of the Python part of the package.
#[derive(FromPyObject)]
pub(crate) struct Callables {
    /// U(q), ∇U(q) and ∂²U/∂q².
    value: Option<Function>,
    gradient: Option<Function>,
    hessian: Option<Function>,
    /// F(t, q), ∂F/∂q and ∂F/∂v. A force without position is F(t), one with velocity F(t, q, v); the
    /// derivatives take the same arguments.
    force: Option<Function>,
    jacobian: Option<Function>,
    velocity_jacobian: Option<Function>,
    takes_position: bool,
    takes_velocity: bool,
    /// Positions of the structural nonzeros of ∂²U/∂q², as pairs row, column; the Hessian then returns one
    /// number for each. `None`: it returns the full matrix, row by row.
    places: Option<Vec<u32>>,
}

impl Callables {
    /// True if one of them is a function of Python.
    pub(crate) fn need_interpreter(&self) -> bool {
        let Self { value, gradient, hessian, force, jacobian, velocity_jacobian, .. } = self;
        let all = [value, gradient, hessian, force, jacobian, velocity_jacobian];
        all.into_iter().flatten().any(|function| matches!(function, Function::Python(_)))
    }

    /// True if derivatives of all that depends on the position or the velocity are among them.
    fn have_derivatives(&self) -> bool {
        (self.gradient.is_none() || self.hessian.is_some())
            && (!self.takes_position || self.jacobian.is_some())
            && (!self.takes_velocity || self.velocity_jacobian.is_some())
    }
}

/// The functions of a run: a potential and forces, and what events watch.
#[derive(Default)]
pub(crate) struct Functions {
    pub(crate) terms: Option<Callables>,
    pub(crate) events: Vec<Option<Py<PyAny>>>,
}

impl Functions {
    /// True if the run calls functions of Python.
    pub(crate) fn need_interpreter(&self) -> bool {
        self.terms.as_ref().is_some_and(Callables::need_interpreter)
            || self.events.iter().any(Option::is_some)
    }

    /// The scenario with them; `looks` if they are called at its start, `exactly` if it is differentiated in
    /// another way than by its `[sensitivity]`.
    ///
    /// # Errors
    /// If one fails there, returns what is not finite, or is not the derivative of the other.
    pub(crate) fn put_into(
        self,
        mut scenario: Scenario,
        slot: &ErrorSlot,
        (looks, exactly): (bool, bool),
    ) -> Outcome<Scenario> {
        for (event, function) in scenario.events.iter_mut().zip(self.events) {
            event.own = function.map(|function| watched(function, slot.clone()));
        }
        let Some(callables) = self.terms else { return Ok(scenario) };
        // Of an equation they act on its unknowns, and on derivatives with names.
        let unknowns = || scenario.system.names().count();
        let size = scenario.equation.as_ref().map_or_else(unknowns, |equation| equation.arguments());
        let mut terms = PythonTerms::new(Arc::new(callables), size, slot.clone());
        if looks {
            let velocity = scenario.initial_velocity();
            let start = Place {
                time: scenario.time.start,
                position: &scenario.initial.position[..size],
                velocity: velocity.as_deref(),
            };
            terms.look_at_the_start(start, exactly || scenario.sensitivity.is_some())?;
        }
        Ok(scenario.with_own_terms(SharedTerms::new(terms)))
    }
}

/// Holds the first exception raised by a function until the failing step has ended.
#[derive(Clone, Default)]
pub(crate) struct ErrorSlot(Arc<Mutex<Option<PyErr>>>);

impl ErrorSlot {
    pub(crate) fn take(&self) -> Option<PyErr> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn keep(&self, error: PyErr) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }

    pub(crate) fn is_full(&self) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }
}

/// Distance, relative to the position, of a further point at which a gradient is checked.
const NEARBY: f64 = 0.01;
/// Most entries of a gradient that are checked.
const MOST_CHECKED: usize = 16;
/// Relative difference from which a gradient is wrong, and as a multiple of the error of differences.
const ENOUGH: f64 = 1e-3;
const TEN: f64 = 10.0;
/// Second distance of differences, as a multiple of the first: rounded functions differ at them.
const WIDER: f64 = 100.0;

/// [`Callables`] with the interface that the library requires.
pub(crate) struct PythonTerms {
    callables: Arc<Callables>,
    size: usize,
    slot: ErrorSlot,
    /// Largest |F_i| since the last query of the energy guard.
    largest: Vec<f64>,
    answer: Vec<f64>,
    nearby: Vec<f64>,
    difference: Vec<f64>,
}

impl PythonTerms {
    pub(crate) fn new(callables: Arc<Callables>, size: usize, slot: ErrorSlot) -> Self {
        let zeros = || vec![0.0; size];
        let (largest, nearby, difference) = (zeros(), zeros(), zeros());
        Self { callables, size, slot, largest, answer: Vec::new(), nearby, difference }
    }

    /// Refuses functions that fail, or return values that are not finite, at the initial state, and gradients
    /// that are not those of the value; with `exactly` matrices, too, that are not the derivatives.
    fn look_at_the_start(&mut self, start: Place<'_>, exactly: bool) -> Outcome<()> {
        let Place { time, position, velocity } = start;
        let value = self.potential(position);
        let mut restoring = vec![0.0; self.size];
        // If the velocity requires the solution of equations, the force is first checked in the first step.
        let velocity = if self.callables.takes_velocity { velocity } else { Some(&[][..]) };
        if let Some(velocity) = velocity {
            self.add_restoring_force_in_motion(Moment::inside(time), position, velocity, &mut restoring);
        }
        if let Some(error) = self.slot.take() {
            return Err(Failure::Raised(error));
        }
        let bad = if !value.is_finite() {
            Some(("potential", "the value"))
        } else if restoring.iter().any(|number| !number.is_finite()) {
            Some(("potential", "the gradient, or the force,"))
        } else {
            None
        };
        if let Some((key, what)) = bad {
            let message = format!("{key}: {what} is not finite at t = {time}, q = {position:?}");
            return Err(Failure::Input { key: key.to_owned(), value: String::new(), message });
        }
        if self.callables.value.is_some() {
            self.check_derivative(Which::Gradient, start)?;
        }
        for which in [Which::Hessian, Which::Jacobian, Which::VelocityJacobian] {
            self.check_are_numbers(which, start)?;
        }
        if exactly && self.callables.have_derivatives() {
            for which in [Which::Hessian, Which::Jacobian, Which::VelocityJacobian] {
                self.check_derivative(which, start)?;
            }
        }
        Ok(())
    }

    /// Refuses derivatives that are no numbers at the start, where those of a root may be infinite.
    fn check_are_numbers(&mut self, which: Which, start: Place<'_>) -> Outcome<()> {
        let (name, function) = self.callables.named(which);
        // The velocity may require the solution of equations.
        if function.is_none() || (self.callables.takes_velocity && start.velocity.is_none()) {
            return Ok(());
        }
        self.look(which, start, self.entries(which));
        if let Some(error) = self.slot.take() {
            return Err(Failure::Raised(error));
        }
        if self.answer.iter().any(|entry| entry.is_nan()) {
            let Place { time, position, .. } = start;
            let message = format!("{name}: is not a number at t = {time}, q = {position:?}");
            return Err(Failure::Input { key: name.to_owned(), value: "nan".to_owned(), message });
        }
        Ok(())
    }

    /// Number of entries that a derivative has.
    fn entries(&self, which: Which) -> usize {
        match (&self.callables.places, which) {
            (Some(places), Which::Hessian) => places.len() / 2,
            (_, Which::Value | Which::Gradient | Which::Force) => self.size,
            _ => self.size * self.size,
        }
    }

    /// Refuses a derivative that is not that of its function: at the start, and where differences say too
    /// little there, as at rest, at a point nearby.
    fn check_derivative(&mut self, which: Which, start: Place<'_>) -> Outcome<()> {
        let (_, function) = self.callables.named(which);
        if function.is_none() {
            return Ok(());
        }
        let apart =
            |(index, &q): (usize, &f64)| q + NEARBY * q.abs().max(1.0) * (1.0 + 0.3 * (index % 7) as f64);
        let away = |numbers: &[f64]| numbers.iter().enumerate().map(apart).collect::<Vec<f64>>();
        let (nearby, then) = (away(start.position), start.velocity.map(away));
        for place in [start, Place { position: &nearby, velocity: then.as_deref(), ..start }] {
            let told = self.compare(which, place);
            // The domain of the functions may end nearby.
            if let Some(error) = self.slot.take()
                && !Python::attach(|py| {
                    error.is_instance_of::<PyValueError>(py) || error.is_instance_of::<PyArithmeticError>(py)
                })
            {
                return Err(Failure::Raised(error));
            }
            if told? {
                break;
            }
        }
        Ok(())
    }

    /// Compares a derivative with differences of its function, coordinate by coordinate. True if these say
    /// enough about all that were looked at.
    fn compare(&mut self, which: Which, place: Place<'_>) -> Outcome<bool> {
        let (of, along) = which.of();
        let Some(by) = (if along == Along::Velocity { place.velocity } else { Some(place.position) }) else {
            return Ok(true);
        };
        let rows = if of == Which::Value { 1 } else { self.size };
        self.look(which, place, self.entries(which));
        let given = self.answer.clone();
        let entry = |terms: &Self, row: usize, column: usize| match (&terms.callables.places, which) {
            (Some(places), Which::Hessian) => {
                let pairs = places.as_chunks::<2>().0.iter().zip(&given);
                let here = pairs.filter(|(pair, _)| **pair == [row as u32, column as u32]);
                here.map(|(_, number)| number).sum()
            }
            _ => given[row * terms.size + column],
        };
        let (by, stride) = (by.to_vec(), self.size.div_ceil(MOST_CHECKED).max(1));
        let mut told = true;
        for column in (0..self.size).step_by(stride) {
            let slopes = self.slopes(&by, column, |terms, by| {
                let place = match along {
                    Along::Position => Place { position: by, ..place },
                    Along::Velocity => Place { velocity: Some(by), ..place },
                };
                terms.look(of, place, rows);
                terms.answer.clone()
            });
            for (row, (slope, error)) in slopes.into_iter().enumerate() {
                let given = entry(self, row, column);
                let size = slope.abs().max(given.abs());
                if !error.is_finite() {
                    told = false;
                } else if (slope - given).abs() > TEN * error + ENOUGH * size {
                    let (name, _) = self.callables.named(which);
                    let (of, _) = self.callables.named(of);
                    let entry = if rows == 1 { column.to_string() } else { format!("({row}, {column})") };
                    let message = format!(
                        "{name}: entry {entry} is {given} at q = {:?}, where differences of {of} give {slope:.6}",
                        place.position
                    );
                    return Err(Failure::Input { key: name.to_owned(), value: given.to_string(), message });
                } else {
                    told &= size > TEN * error;
                }
            }
        }
        Ok(told)
    }

    /// Writes the `count` values of a function at a place to `answer`.
    fn look(&mut self, which: Which, place: Place<'_>, count: usize) {
        let Place { time, position, velocity } = place;
        match which {
            Which::Value | Which::Gradient | Which::Hessian => self.call(which, None, Some(position), count),
            Which::Force | Which::Jacobian | Which::VelocityJacobian => {
                let position = self.callables.takes_position.then_some(position);
                let velocity = velocity.filter(|_| self.callables.takes_velocity);
                self.call_moving(which, Some(time), position, velocity, count);
            }
        }
    }

    /// Derivatives by one of the arguments, by differences, with estimates of their errors; an error is not
    /// finite where a value is not.
    fn slopes(
        &mut self,
        point: &[f64],
        coordinate: usize,
        mut look: impl FnMut(&mut Self, &[f64]) -> Vec<f64>,
    ) -> Vec<(f64, f64)> {
        let mut at = point.to_vec();
        let middle = look(self, &at);
        let mut looks = Vec::with_capacity(4);
        for part in [1.0, WIDER] {
            let distance = part * f64::EPSILON.cbrt() * point[coordinate].abs().max(1.0);
            for side in [distance, -distance] {
                at[coordinate] = point[coordinate] + side;
                looks.push((at[coordinate] - point[coordinate], look(self, &at)));
            }
        }
        let of_row = |(row, &middle): (usize, &f64)| {
            let largest =
                looks.iter().fold(middle.abs(), |largest, (_, there)| max_or_nan(largest, there[row].abs()));
            let slopes: Vec<f64> = looks.iter().map(|(rise, there)| (there[row] - middle) / rise).collect();
            let [ahead, behind, far_ahead, far_behind] = [0, 1, 2, 3].map(|side| slopes[side]);
            let (near, far) = (0.5 * (ahead + behind), 0.5 * (far_ahead + far_behind));
            let rounding = 8.0 * f64::EPSILON.powf(2.0 / 3.0) * largest;
            (near, (near - far).abs() + (ahead - behind).abs() + rounding)
        };
        middle.iter().enumerate().map(of_row).collect()
    }

    /// Calls a function and stores its `count` values in `answer`; NaN if it fails.
    fn call(&mut self, which: Which, time: Option<f64>, position: Option<&[f64]>, count: usize) {
        self.call_moving(which, time, position, None, count);
    }

    /// As [`call`](Self::call), with the velocity as a further argument.
    fn call_moving(
        &mut self,
        which: Which,
        time: Option<f64>,
        position: Option<&[f64]>,
        velocity: Option<&[f64]>,
        count: usize,
    ) {
        self.answer.clear();
        if self.slot.is_full() {
            self.answer.resize(count, f64::NAN);
            return;
        }
        let (name, function) = self.callables.named(which);
        let function = match function {
            Some(Function::Python(function)) => function,
            Some(Function::Native(function)) => {
                self.answer.resize(count, 0.0);
                function.call(which == Which::Value, (time, position, velocity), &mut self.answer);
                return;
            }
            None => {
                self.answer.resize(count, 0.0);
                return;
            }
        };
        let answer = &mut self.answer;
        let result = Python::attach(|py| {
            let function = function.bind(py);
            let array = |position: &[f64]| PyArray1::from_slice(py, position);
            let returned = match (time, position, velocity) {
                (Some(time), Some(position), Some(velocity)) => {
                    function.call1((time, array(position), array(velocity)))
                }
                (Some(time), Some(position), None) => function.call1((time, array(position))),
                (Some(time), None, _) => function.call1((time,)),
                (None, Some(position), _) => function.call1((array(position),)),
                (None, None, _) => function.call1(PyTuple::empty(py)),
            }?;
            numbers(name, &returned, count, answer)
        });
        if let Err(error) = result {
            self.slot.keep(error);
            self.answer.clear();
            self.answer.resize(count, f64::NAN);
        }
    }

    /// Writes the force to `answer`, at a time, a position and, if it takes one, a velocity.
    fn force(&mut self, time: f64, position: &[f64], velocity: &[f64]) {
        let position = self.callables.takes_position.then_some(position);
        let velocity = self.callables.takes_velocity.then_some(velocity);
        self.call_moving(Which::Force, Some(time), position, velocity, self.size);
    }

    /// Adds, with a sign, finite differences of the values that `look` writes to `answer`, one coordinate at
    /// a time, to `stiffness`.
    fn add_differences(
        &mut self,
        position: &[f64],
        sign: f64,
        stiffness: &mut [f64],
        mut look: impl FnMut(&mut Self, &[f64]),
    ) {
        let mut base = std::mem::take(&mut self.difference);
        base.clone_from(&self.answer);
        let mut nearby = std::mem::take(&mut self.nearby);
        nearby.copy_from_slice(position);
        for column in 0..self.size {
            let step = f64::EPSILON.sqrt() * position[column].abs().max(1.0);
            nearby[column] = position[column] + step;
            // The change after rounding.
            let step = nearby[column] - position[column];
            look(self, &nearby);
            for row in 0..self.size {
                stiffness[row * self.size + column] += sign * (self.answer[row] - base[row]) / step;
            }
            nearby[column] = position[column];
        }
        (self.difference, self.nearby) = (base, nearby);
    }

    fn add_force(&mut self, restoring: &mut [f64]) {
        for ((restoring, largest), force) in restoring.iter_mut().zip(&mut self.largest).zip(&self.answer) {
            *restoring -= force;
            *largest = largest.max(force.abs());
        }
    }
}

/// A time, a position, and a velocity if it is known.
#[derive(Clone, Copy)]
struct Place<'a> {
    time: f64,
    position: &'a [f64],
    velocity: Option<&'a [f64]>,
}

#[derive(Clone, Copy, PartialEq)]
enum Which {
    Value,
    Gradient,
    Hessian,
    Force,
    Jacobian,
    VelocityJacobian,
}

/// By what a function is differentiated.
#[derive(Clone, Copy, PartialEq)]
enum Along {
    Position,
    Velocity,
}

impl Which {
    /// The function that it is a derivative of, and by what.
    fn of(self) -> (Self, Along) {
        match self {
            Self::Value | Self::Gradient => (Self::Value, Along::Position),
            Self::Hessian => (Self::Gradient, Along::Position),
            Self::Force | Self::Jacobian => (Self::Force, Along::Position),
            Self::VelocityJacobian => (Self::Force, Along::Velocity),
        }
    }
}

impl Callables {
    /// The function and its name.
    fn named(&self, which: Which) -> (&'static str, Option<&Function>) {
        let (name, function) = match which {
            Which::Value => ("potential.value", &self.value),
            Which::Gradient => ("potential.gradient", &self.gradient),
            Which::Hessian => ("potential.hessian", &self.hessian),
            Which::Force => ("force", &self.force),
            Which::Jacobian => ("force.jacobian", &self.jacobian),
            Which::VelocityJacobian => ("force.velocity_jacobian", &self.velocity_jacobian),
        };
        (name, function.as_ref())
    }
}

impl OwnTerms for PythonTerms {
    fn again(&self) -> Option<SharedTerms> {
        let again = Self::new(self.callables.clone(), self.size, self.slot.clone());
        Some(SharedTerms::new(again))
    }

    fn has_exact_derivatives(&self) -> bool {
        self.callables.have_derivatives()
    }

    fn depends_on_position(&self) -> bool {
        self.callables.gradient.is_some() || self.callables.takes_position
    }

    fn places(&self) -> Option<Vec<(u32, u32)>> {
        let pairs = self.callables.places.as_deref()?.as_chunks::<2>().0;
        Some(pairs.iter().map(|&[row, column]| (row, column)).collect())
    }

    fn potential(&mut self, position: &[f64]) -> f64 {
        self.call(Which::Value, None, Some(position), 1);
        self.answer[0]
    }

    fn add_restoring_force(&mut self, moment: Moment<f64>, position: &[f64], restoring: &mut [f64]) {
        self.add_restoring_force_in_motion(moment, position, &[], restoring);
    }

    fn add_linearisation(
        &mut self,
        moment: Moment<f64>,
        position: &[f64],
        restoring: &mut [f64],
        stiffness: &mut [f64],
    ) {
        self.add_linearisation_in_motion(moment, (position, &[]), restoring, stiffness, &mut []);
    }

    fn depends_on_velocity(&self) -> bool {
        self.callables.takes_velocity
    }

    fn add_restoring_force_in_motion(
        &mut self,
        moment: Moment<f64>,
        position: &[f64],
        velocity: &[f64],
        restoring: &mut [f64],
    ) {
        if self.callables.gradient.is_some() {
            self.call(Which::Gradient, None, Some(position), self.size);
            restoring.iter_mut().zip(&self.answer).for_each(|(restoring, number)| *restoring += number);
        }
        if self.callables.force.is_some() {
            self.force(moment.sided(), position, velocity);
            self.add_force(restoring);
        }
    }

    fn add_linearisation_in_motion(
        &mut self,
        moment: Moment<f64>,
        (position, velocity): (&[f64], &[f64]),
        restoring: &mut [f64],
        stiffness: &mut [f64],
        resistance: &mut [f64],
    ) {
        let (square, places) = (self.size * self.size, stiffness.len());
        if self.callables.gradient.is_some() {
            self.call(Which::Gradient, None, Some(position), self.size);
            restoring.iter_mut().zip(&self.answer).for_each(|(restoring, number)| *restoring += number);
            if self.callables.hessian.is_some() {
                self.call(Which::Hessian, None, Some(position), places);
                stiffness.iter_mut().zip(&self.answer).for_each(|(entry, number)| *entry += number);
            } else {
                self.add_differences(position, 1.0, stiffness, |terms, nearby| {
                    terms.call(Which::Gradient, None, Some(nearby), terms.size);
                });
            }
        }
        if self.callables.force.is_none() {
            return;
        }
        let time = moment.sided();
        let moving = self.callables.takes_velocity.then_some(velocity);
        self.force(time, position, velocity);
        self.add_force(restoring);
        let force = std::mem::take(&mut self.answer);
        if self.callables.jacobian.is_some() {
            self.call_moving(Which::Jacobian, Some(time), Some(position), moving, square);
            stiffness.iter_mut().zip(&self.answer).for_each(|(entry, number)| *entry -= number);
        } else if self.callables.takes_position {
            self.answer.clone_from(&force);
            self.add_differences(position, -1.0, stiffness, |terms, nearby| {
                terms.force(time, nearby, velocity);
            });
        }
        if moving.is_none() {
            return;
        }
        if self.callables.velocity_jacobian.is_some() {
            self.call_moving(Which::VelocityJacobian, Some(time), Some(position), moving, square);
            resistance.iter_mut().zip(&self.answer).for_each(|(entry, number)| *entry -= number);
        } else {
            self.answer = force;
            self.add_differences(velocity, -1.0, resistance, |terms, nearby| {
                terms.force(time, position, nearby);
            });
        }
    }

    fn take_largest_force(&mut self, largest: &mut [f64]) {
        largest.copy_from_slice(&self.largest);
        self.largest.fill(0.0);
    }
}

/// The function (t, q, p) of an event.
pub(crate) fn watched(function: Py<PyAny>, slot: ErrorSlot) -> SharedFunction {
    SharedFunction::new(move |time, position, momentum| {
        if slot.is_full() {
            return f64::NAN;
        }
        let mut answer = Vec::with_capacity(1);
        let result = Python::attach(|py| {
            let array = |numbers: &[f64]| PyArray1::from_slice(py, numbers);
            let returned = function.bind(py).call1((time, array(position), array(momentum)))?;
            if is_truth(&returned) {
                let message =
                    "events.when has returned a truth value; a number is needed, which crosses zero"
                        .to_owned();
                return Err(Failure::Input {
                    key: "events.when".to_owned(),
                    value: returned.to_string(),
                    message,
                }
                .into());
            }
            numbers("events.when", &returned, 1, &mut answer)
        });
        match (result, answer.first()) {
            (Ok(()), Some(&number)) => number,
            (result, _) => {
                if let Err(error) = result {
                    slot.keep(error);
                }
                f64::NAN
            }
        }
    })
}

/// True for `True` and `False`, NumPy's and those in arrays, whose values do not cross zero.
fn is_truth(returned: &Bound<'_, PyAny>) -> bool {
    let in_array = || returned.getattr("dtype").is_ok_and(|kind| kind.to_string() == "bool");
    returned.is_instance_of::<PyBool>() || (!returned.is_instance_of::<PyFloat>() && in_array())
}

/// The `count` numbers that a function has returned.
fn numbers(name: &str, returned: &Bound<'_, PyAny>, count: usize, to: &mut Vec<f64>) -> PyResult<()> {
    // The usual return types are read without a call to NumPy, which would cost as much as a short function.
    if count == 1
        && let Ok(number) = returned.cast::<PyFloat>()
    {
        to.push(number.value());
        return Ok(());
    }
    if of_lists(returned, to) && to.len() == count {
        return Ok(());
    }
    to.clear();
    let py = returned.py();
    // Subclasses may give the same bytes another meaning, such as masked values.
    let array = match returned.cast_exact::<PyArrayDyn<f64>>() {
        Ok(array) => array.clone(),
        Err(_) => {
            static REAL: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
            let real = REAL.import(py, "fvi._arrays", "returned")?;
            real.call1((name, returned))?.cast_into::<PyArrayDyn<f64>>()?
        }
    };
    if array.len() != count || (count > 1 && array.ndim() == 0) {
        let message = format!(
            "{name} has returned {} numbers in shape {:?}; {count} are needed",
            array.len(),
            array.shape()
        );
        return Err(Failure::Input { key: name.to_owned(), value: String::new(), message }.into());
    }
    // Row by row, whatever the memory order of the array.
    if array.is_c_contiguous() {
        to.extend(array.to_vec().map_err(|error| Failure::Failed(error.to_string()))?);
    } else {
        to.extend(array.readonly().as_array().iter());
    }
    Ok(())
}

/// Reads a list of floats, or of lists of floats of equal lengths; false for any other object.
fn of_lists(given: &Bound<'_, PyAny>, to: &mut Vec<f64>) -> bool {
    let Ok(list) = given.cast::<PyList>() else { return false };
    let mut rows = None;
    for entry in list {
        let (begin, is_row) = (to.len(), entry.is_instance_of::<PyList>());
        if is_row {
            let Ok(row) = entry.cast::<PyList>() else { return false };
            if !row.iter().all(|entry| entry.cast::<PyFloat>().map(|number| to.push(number.value())).is_ok())
            {
                return false;
            }
        } else {
            let Ok(number) = entry.cast::<PyFloat>() else { return false };
            to.push(number.value());
        }
        let shape = (is_row, to.len() - begin);
        if *rows.get_or_insert(shape) != shape {
            return false;
        }
    }
    true
}
