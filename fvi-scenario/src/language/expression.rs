//! Expressions of scenario files, with their exact gradient and Hessian.
//!
//! An expression is parsed once against the names it may use ([`Symbols`]); parameters and everything else
//! that is constant are folded in `f64`. It is then evaluated in `f32` or `f64` together with as many
//! derivatives as are needed, by second-order forward differentiation: exact up to rounding, no
//! difference quotients. Every function comes from `libm`, so that a host and a microcontroller agree.
//!
//! Grammar, loosest binding first:
//!
//! ```text
//! sum      = product { ("+" | "−") product }
//! product  = signed { ("*" | "/") signed }
//! signed   = { "+" | "−" } power                  −q0^2 is −(q0^2)
//! power    = primary [ "^" signed ]               2^3^2 is 2^(3^2), 2^-1 is ½
//! primary  = number | name | function "(" sum { "," sum } ")" | "(" sum ")"
//! ```
//!
//! **Sides of a jump.** Inside the argument of `step` and `sign` the time is moved slightly to the side of a
//! grid point from which that point is approached (see [`Moment`]); everywhere else it is exactly the time of
//! the point.

mod elementary;
mod function;
mod jet;
mod syntax;
mod tree;

pub use elementary::Elementary;
pub use function::Function;
pub use syntax::nearest;
pub use syntax::{ExpressionError, ExpressionFault};

use fvi_core::Real;
use jet::{FirstOrder, Jet, SecondOrder};
use nalgebra::{SMatrix, SVector};
use std::collections::{BTreeMap, HashMap};
pub use tree::{Kind, LARGEST_MULTIPLIED, Node, Operator, power};

/// The names an expression may use besides numbers, functions and `pi`.
#[derive(Clone, Debug, Default)]
pub struct Symbols {
    time: bool,
    variables: Vec<String>,
    /// Index of each variable in `variables`: a chain of N coordinates refers to them some 4N times.
    indices: HashMap<String, usize>,
    parameters: BTreeMap<String, f64>,
}

impl Symbols {
    /// No names at all: constant expressions.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds the time `t`.
    pub fn with_time(mut self) -> Self {
        self.time = true;
        self
    }

    /// Adds variables; their order is the order of the derivatives.
    pub fn with_variables(mut self, names: impl IntoIterator<Item = String>) -> Self {
        for name in names {
            self.indices.entry(name.clone()).or_insert(self.variables.len());
            self.variables.push(name);
        }
        self
    }

    /// Adds the coordinates `q0`, `q1`, …
    pub fn with_coordinates(self, count: usize) -> Self {
        self.with_variables((0..count).map(|index| format!("q{index}")))
    }

    /// Adds the velocities `v0`, `v1`, … as variables after the existing ones. A name that already has a
    /// meaning, according to `taken` or as a parameter, keeps it.
    pub fn with_velocities(mut self, count: usize, taken: impl Fn(&str) -> bool) -> Self {
        for index in 0..count {
            let name = format!("v{index}");
            let is_known = taken(&name) || self.parameters.contains_key(&name);
            if !is_known {
                self.indices.entry(name.clone()).or_insert(self.variables.len());
            }
            self.variables.push(name);
        }
        self
    }

    /// Adds a named constant.
    ///
    /// # Errors
    /// The reason why the name cannot be a parameter: it is not a name, or it already has a meaning.
    pub fn with_parameter(mut self, name: &str, value: f64) -> Result<Self, ParameterNameError> {
        self.add_parameter(name, value)?;
        Ok(self)
    }

    /// As [`with_parameter`](Self::with_parameter); after an error the symbols are as before.
    pub(crate) fn add_parameter(&mut self, name: &str, value: f64) -> Result<(), ParameterNameError> {
        self.allows(name)?;
        self.parameters.entry(name.to_owned()).or_insert(value);
        Ok(())
    }

    /// # Errors
    /// The reason why the name cannot be given to anything: it is not a name, or it already has a meaning.
    pub(crate) fn allows(&self, name: &str) -> Result<(), ParameterNameError> {
        let mut letters = name.chars();
        let well_formed =
            letters.next().is_some_and(syntax::starts_name) && letters.all(syntax::continues_name);
        if !well_formed {
            return Err(ParameterNameError::NotAName);
        }
        if function::Function::named(name).is_some() {
            return Err(ParameterNameError::Function);
        }
        if name == "pi" {
            return Err(ParameterNameError::Constant);
        }
        if name == "t" {
            return Err(ParameterNameError::Time);
        }
        let numbered = name
            .strip_prefix('q')
            .is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|digit| digit.is_ascii_digit()));
        if numbered || self.indices.contains_key(name) {
            return Err(ParameterNameError::Variable);
        }
        Ok(())
    }

    fn resolve(&self, name: &str) -> Option<Node> {
        if name == "pi" {
            return Some(Node::number(core::f64::consts::PI));
        }
        if name == "t" && self.time {
            return Some(Node::time());
        }
        if let Some(&index) = self.indices.get(name) {
            return Some(Node::variable(index));
        }
        self.parameters.get(name).map(|&value| Node::number(value))
    }

    /// Every name that may stand alone.
    fn names(&self) -> impl Iterator<Item = &str> {
        let variables = self.variables.iter().map(String::as_str);
        self.time.then_some("t").into_iter().chain(variables).chain(self.others())
    }

    /// The names for messages; of many variables only the first two and the last.
    fn names_in_brief(&self) -> Vec<&str> {
        const MANY: usize = 8;
        let variables: Vec<&str> = match self.variables.as_slice() {
            [first, second, between @ .., last] if between.len() + 3 > MANY => vec![first, second, "…", last],
            variables => variables.iter().map(String::as_str).collect(),
        };
        self.time.then_some("t").into_iter().chain(variables).chain(self.others()).collect()
    }

    fn others(&self) -> impl Iterator<Item = &str> {
        self.parameters.keys().map(String::as_str).chain(["pi"])
    }
}

/// Reason why a name cannot be a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ParameterNameError {
    /// Not of the form letter, letters, digits and underscores.
    #[error("a name starts with a letter and goes on with letters, digits and _")]
    NotAName,
    /// The name of a function.
    #[error("it is the name of a function")]
    Function,
    /// `pi`.
    #[error("it is the name of the constant π")]
    Constant,
    /// `t`.
    #[error("it is the name of the time")]
    Time,
    /// `q0`, `q1`, … or another variable.
    #[error("it is the name of a coordinate")]
    Variable,
}

/// A time at which an expression is evaluated, with the side from which jumps at it are approached.
///
/// Grid times k·h and the times of jumps written in a file are both rounded, so that a jump at a grid point
/// may be computed to lie on either side of it. The time in the argument of `step` and `sign` is therefore
/// moved by 8 units of rounding, far more than both roundings and far less than a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment<T> {
    /// The time itself.
    pub time: T,
    /// The time, moved to the side from which it is approached.
    pub sided: T,
}

impl<T: Real> Moment<T> {
    /// The time strictly inside a step: jumps are evaluated at their computed places.
    pub fn inside(time: T) -> Self {
        Self { time, sided: time }
    }

    /// The time at the right end of a step, from inside it: a jump there has not happened yet.
    pub fn from_left(time: T) -> Self {
        Self { time, sided: time - time.abs() * Self::nudge() }
    }

    /// The time at the left end of a step, from inside it: a jump there has happened. At t = 0, before which
    /// nothing lies, it is the time itself.
    pub fn from_right(time: T) -> Self {
        Self { time, sided: time + time.abs() * Self::nudge() }
    }

    /// The same in double precision.
    pub fn in_double(&self) -> Moment<f64> {
        Moment { time: self.time.to_f64(), sided: self.sided.to_f64() }
    }

    /// The time at which a force with jumps is evaluated: equal to the time up to rounding, on the intended
    /// side.
    pub fn sided(&self) -> T {
        self.sided
    }

    fn nudge() -> T {
        T::EPSILON * T::of(8.0)
    }
}

/// A parsed expression.
#[derive(Clone, Debug)]
pub struct Expression {
    root: Node,
    text: String,
}

impl Expression {
    /// Parses `text` with the names of `symbols`.
    ///
    /// # Errors
    /// [`ExpressionError`] with the fault and its place in `text`.
    pub fn parse(text: &str, symbols: &Symbols) -> Result<Self, ExpressionError> {
        Ok(Self { root: syntax::parse(text, symbols)?, text: text.to_owned() })
    }

    /// The text it was parsed from.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// A part of the expression, or a transformed one, with the same text.
    pub fn with_root(&self, root: Node) -> Self {
        Self { root, text: self.text.clone() }
    }

    /// True if any variable occurs in it (after constants are folded).
    pub fn has_variables(&self) -> bool {
        self.root.varies()
    }

    /// The expression as a tree.
    pub fn root(&self) -> &Node {
        &self.root
    }

    /// The value at a moment and a point. `variables` in the order of [`Symbols::with_variables`].
    pub fn value<T: Elementary>(&self, moment: Moment<T>, variables: &[T]) -> T {
        self.root.evaluate::<T, T>(moment.time, moment.sided, variables)
    }

    /// Value and gradient with respect to the variables.
    pub fn gradient<T: Elementary, const N: usize>(
        &self,
        moment: Moment<T>,
        point: &SVector<T, N>,
    ) -> (T, SVector<T, N>) {
        let variables: [FirstOrder<T, N>; N] = core::array::from_fn(|i| FirstOrder::variable(point[i], i));
        let jet: FirstOrder<T, N> = self.root.evaluate(moment.time, moment.sided, &variables);
        (jet.value(), jet.gradient)
    }

    /// The derivative with respect to one variable.
    pub fn slope<T: Elementary>(&self, moment: Moment<T>, point: &[T], index: usize) -> T {
        let variables: Vec<FirstOrder<T, 1>> = point
            .iter()
            .enumerate()
            .map(|(own, &value)| FirstOrder::variable(value, usize::from(own != index)))
            .collect();
        let jet: FirstOrder<T, 1> = self.root.evaluate(moment.time, moment.sided, &variables);
        jet.gradient[0]
    }

    /// Value, gradient and (symmetric) Hessian with respect to the variables.
    pub fn hessian<T: Elementary, const N: usize>(
        &self,
        moment: Moment<T>,
        point: &SVector<T, N>,
    ) -> (T, SVector<T, N>, SMatrix<T, N, N>) {
        let variables: [SecondOrder<T, N>; N] = core::array::from_fn(|i| SecondOrder::variable(point[i], i));
        let jet: SecondOrder<T, N> = self.root.evaluate(moment.time, moment.sided, &variables);
        (jet.value(), jet.gradient, jet.hessian)
    }
}

impl serde::Serialize for Expression {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.text)
    }
}

#[cfg(test)]
mod tests;
