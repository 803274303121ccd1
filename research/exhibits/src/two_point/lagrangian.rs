//! Lagrangians of two-point problems, from expressions and from closures.

use fvi_scenario::language::expression::{Expression, Moment};
use fvi_simulation::model::tape::CompiledFunction;

/// Largest number of coordinates of a Lagrangian that is given as an expression.
pub const MAX_COORDINATES: usize = 4;

/// A Lagrangian L(x, v, t) of d coordinates with its first and second derivatives.
///
/// Derivatives are with respect to (x, v) together, 2d variables: first all of x, then all of v.
pub trait Lagrangian {
    /// Number of coordinates d.
    fn coordinates(&self) -> usize;

    /// L(x, v, t).
    fn value(&self, t: f64, x: &[f64], v: &[f64]) -> f64;

    /// Writes the 2d first derivatives ∂L/∂x, ∂L/∂v.
    fn gradient(&self, t: f64, x: &[f64], v: &[f64], gradient: &mut [f64]);

    /// Writes the symmetric (2d)×(2d) matrix of second derivatives, row by row, and the first derivatives.
    fn derivatives(&self, t: f64, x: &[f64], v: &[f64], gradient: &mut [f64], hessian: &mut [f64]);
}

/// A Lagrangian made from three closures.
///
/// `value(t, x, v)`, `gradient(t, x, v, out)` and `hessian(t, x, v, out)`, with outputs laid out as in
/// [`Lagrangian`].
#[derive(Clone, Debug)]
pub struct Closures<V, G, H> {
    coordinates: usize,
    value: V,
    gradient: G,
    hessian: H,
}

impl<V, G, H> Closures<V, G, H>
where
    V: Fn(f64, &[f64], &[f64]) -> f64,
    G: Fn(f64, &[f64], &[f64], &mut [f64]),
    H: Fn(f64, &[f64], &[f64], &mut [f64]),
{
    /// The Lagrangian of `coordinates` coordinates with these values and derivatives.
    pub fn new(coordinates: usize, value: V, gradient: G, hessian: H) -> Self {
        Self { coordinates, value, gradient, hessian }
    }
}

impl<V, G, H> Lagrangian for Closures<V, G, H>
where
    V: Fn(f64, &[f64], &[f64]) -> f64,
    G: Fn(f64, &[f64], &[f64], &mut [f64]),
    H: Fn(f64, &[f64], &[f64], &mut [f64]),
{
    fn coordinates(&self) -> usize {
        self.coordinates
    }

    fn value(&self, t: f64, x: &[f64], v: &[f64]) -> f64 {
        (self.value)(t, x, v)
    }

    fn gradient(&self, t: f64, x: &[f64], v: &[f64], gradient: &mut [f64]) {
        (self.gradient)(t, x, v, gradient);
    }

    fn derivatives(&self, t: f64, x: &[f64], v: &[f64], gradient: &mut [f64], hessian: &mut [f64]) {
        (self.gradient)(t, x, v, gradient);
        (self.hessian)(t, x, v, hessian);
    }
}

/// A Lagrangian written as an expression in x0, x1, …, v0, v1, … and t.
#[derive(Clone, Debug)]
pub struct ExpressionLagrangian {
    expression: Expression,
    compiled: Box<CompiledFunction<f64>>,
    coordinates: usize,
}

impl ExpressionLagrangian {
    /// The names of the variables of a Lagrangian, in the order that the expression must have been parsed
    /// with.
    pub fn variables(coordinates: usize) -> impl Iterator<Item = String> {
        let named = move |letter: char| (0..coordinates).map(move |index| format!("{letter}{index}"));
        named('x').chain(named('v'))
    }

    /// The Lagrangian of `coordinates` coordinates given by an expression whose variables are
    /// [`variables`](Self::variables); `None` if there are none or more than [`MAX_COORDINATES`] coordinates.
    pub fn new(expression: Expression, coordinates: usize) -> Option<Self> {
        (1..=MAX_COORDINATES).contains(&coordinates).then(|| {
            let compiled = Box::new(CompiledFunction::compile(&expression, 2 * coordinates));
            Self { expression, compiled, coordinates }
        })
    }

    /// The expression as it was written.
    pub fn text(&self) -> &str {
        self.expression.text()
    }
}

impl Lagrangian for ExpressionLagrangian {
    fn coordinates(&self) -> usize {
        self.coordinates
    }

    fn value(&self, t: f64, x: &[f64], v: &[f64]) -> f64 {
        self.expression.value(Moment::inside(t), &[x, v].concat())
    }

    fn gradient(&self, t: f64, x: &[f64], v: &[f64], gradient: &mut [f64]) {
        self.compiled.gradient(Moment::inside(t), &[x, v].concat(), &mut Vec::new(), gradient);
    }

    fn derivatives(&self, t: f64, x: &[f64], v: &[f64], gradient: &mut [f64], hessian: &mut [f64]) {
        let pattern = self.compiled.pattern();
        let mut entries = vec![0.0; pattern.len()];
        let variables = [x, v].concat();
        self.compiled.derivatives(Moment::inside(t), &variables, &mut Vec::new(), gradient, &mut entries);
        hessian.fill(0.0);
        for (&(row, column), entry) in pattern.iter().zip(entries) {
            let (row, column) = (row as usize, column as usize);
            hessian[row * variables.len() + column] = entry;
            hessian[column * variables.len() + row] = entry;
        }
    }
}

impl serde::Serialize for ExpressionLagrangian {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.expression.serialize(serializer)
    }
}
