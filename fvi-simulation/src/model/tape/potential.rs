//! Compiled potentials U(q).

use super::function::{Differentiated, value};
use super::polynomial::{Polynomial, split};
use super::program::{LANES, LaneRegisters, OwnRegisters, Program};
use super::sides::CompiledSides;
use fvi_scenario::language::expression::{Elementary, Expression, Moment, Node};

/// ½ qᵀ K q + bᵀ q + c.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct QuadraticPart<T> {
    /// (row, column, entry) of the lower triangle of the symmetric K, diagonal included, row by row.
    pub stiffness: Vec<(u32, u32, T)>,
    /// (coordinate, entry) of b, ascending.
    pub linear: Vec<(u32, T)>,
    /// c.
    pub constant: T,
}

impl<T: Elementary> QuadraticPart<T> {
    fn new(polynomial: &Polynomial) -> Self {
        let stiffness = polynomial.quadratic.iter().map(|(&(row, column), &coefficient)| {
            (row, column, if row == column { 2.0 * coefficient } else { coefficient })
        });
        Self {
            stiffness: stiffness
                .filter(|&(.., entry)| entry != 0.0)
                .map(|(row, column, entry)| (row, column, T::of(entry)))
                .collect(),
            linear: polynomial
                .linear
                .iter()
                .filter(|&(_, &entry)| entry != 0.0)
                .map(|(&coordinate, &entry)| (coordinate, T::of(entry)))
                .collect(),
            constant: T::of(polynomial.constant),
        }
    }

    /// Adds K q + b to `gradient`.
    pub fn add_gradient(&self, position: &[T], gradient: &mut [T]) {
        for &(row, column, entry) in &self.stiffness {
            let (row, column) = (row as usize, column as usize);
            gradient[row] += entry * position[column];
            if row != column {
                gradient[column] += entry * position[row];
            }
        }
        for &(coordinate, entry) in &self.linear {
            gradient[coordinate as usize] += entry;
        }
    }
}

/// A potential as the sum of a quadratic part and a remainder, with programs for value, gradient and Hessian.
///
/// The split is exact except for the rounding of coefficients such as k·1·(−1). The value is computed from
/// the expression as written, not from the parts: expanding (q1 − q0)² would lose digits.
#[derive(Clone, Debug)]
pub struct CompiledPotential<T> {
    quadratic: QuadraticPart<T>,
    value: Program<T>,
    rest: Option<Differentiated<T>>,
    /// Value of the remainder, with the sides of its jumps and kinks as inputs.
    sided_rest: Option<Program<T>>,
}

impl<T: Elementary> CompiledPotential<T> {
    /// Compiles U for `coordinates` coordinates, the variables of the expression.
    pub fn compile(potential: &Expression, coordinates: usize) -> Self {
        let (polynomial, rest) = split(potential.root());
        Self {
            quadratic: QuadraticPart::new(&polynomial),
            value: value(potential, coordinates),
            rest: rest.filter(Node::varies).map(|rest| Differentiated::new(&rest, coordinates)),
            sided_rest: None,
        }
    }

    /// As [`compile`](Self::compile), with the sides of jumps and kinks as inputs of the derivatives of the
    /// remainder, if there are any: positions for it then have two additional numbers for each after the
    /// coordinates. Messages name coordinates by the letter and their indices.
    pub fn compile_sided(
        potential: &Expression,
        (coordinates, letter): (usize, char),
    ) -> (Self, Option<CompiledSides>) {
        let (polynomial, rest) = split(potential.root());
        let sided =
            rest.filter(Node::varies).and_then(|rest| Differentiated::sided(&rest, (coordinates, letter)));
        match sided {
            None => (Self::compile(potential, coordinates), None),
            Some((rest, sided_rest, sides)) => {
                let quadratic = QuadraticPart::new(&polynomial);
                let value = value(potential, coordinates);
                (Self { quadratic, value, rest: Some(rest), sided_rest: Some(sided_rest) }, Some(sides))
            }
        }
    }

    /// The remainder of U on the sides given after the coordinates; zero without jumps and kinks.
    pub fn sided_rest(&self, point: &[T], registers: &mut Vec<T>) -> T {
        let mut value = [T::zero()];
        if let Some(rest) = &self.sided_rest {
            rest.evaluate(moment(), point, registers, &mut value, &mut []);
        }
        value[0]
    }

    /// Number of operations of the gradient and the Hessian of the remainder.
    #[cfg(test)]
    pub(super) fn operations(&self) -> usize {
        self.rest.as_ref().map_or(0, |rest| rest.derivatives.operations())
    }

    /// The quadratic part.
    pub fn quadratic(&self) -> &QuadraticPart<T> {
        &self.quadratic
    }

    /// True if there is no remainder.
    pub fn is_quadratic(&self) -> bool {
        self.rest.is_none()
    }

    /// (row, column) of the structurally nonzero entries of the remainder's Hessian: lower triangle with the
    /// diagonal, row by row.
    pub fn pattern(&self) -> &[(u32, u32)] {
        self.rest.as_ref().map_or(&[], |rest| &rest.pattern)
    }

    /// U(q).
    pub fn value(&self, position: &[T], registers: &mut Vec<T>) -> T {
        let mut value = [T::zero()];
        self.value.evaluate(moment(), position, registers, &mut value, &mut []);
        value[0]
    }

    /// U at several points, whose coordinates `place` writes, with the same bits as one by one. `registers`
    /// must be used for this potential only.
    pub(in crate::model) fn values_along(
        &self,
        registers: &mut LaneRegisters<T>,
        place: impl FnOnce(&mut [[T; LANES]]),
    ) -> [T; LANES] {
        self.value.first_sum_along(registers, place)
    }

    /// Writes ∇U(q), of both parts together.
    pub fn gradient(&self, position: &[T], registers: &mut Vec<T>, gradient: &mut [T]) {
        gradient.fill(T::zero());
        self.quadratic.add_gradient(position, gradient);
        self.add_rest_gradient(position, registers, gradient);
    }

    /// Adds the gradient of the remainder to `gradient`.
    pub fn add_rest_gradient(&self, position: &[T], registers: &mut Vec<T>, gradient: &mut [T]) {
        if let Some(rest) = &self.rest {
            rest.gradient.evaluate(moment(), position, registers, gradient, &mut []);
        }
    }

    /// As [`add_rest_gradient`](Self::add_rest_gradient), with registers used for this program only.
    #[inline]
    pub(in crate::model) fn add_rest_gradient_again(
        &self,
        registers: &mut OwnRegisters<T>,
        position: &[T],
        gradient: &mut [T],
    ) {
        if let Some(rest) = &self.rest {
            rest.gradient.evaluate_again(registers, position, gradient, (&[], &mut []));
        }
    }

    /// Writes ∇U(q), of both parts together, and the entries of the remainder's Hessian in the order of
    /// [`pattern`](Self::pattern).
    pub fn derivatives(&self, position: &[T], registers: &mut Vec<T>, gradient: &mut [T], hessian: &mut [T]) {
        gradient.fill(T::zero());
        self.quadratic.add_gradient(position, gradient);
        self.add_rest_derivatives(position, registers, gradient, hessian);
    }

    /// Adds the gradient of the remainder to `gradient` and writes the entries of its Hessian.
    pub fn add_rest_derivatives(
        &self,
        position: &[T],
        registers: &mut Vec<T>,
        gradient: &mut [T],
        hessian: &mut [T],
    ) {
        if let Some(rest) = &self.rest {
            rest.derivatives.evaluate(moment(), position, registers, gradient, hessian);
        }
    }

    /// As [`add_rest_derivatives`](Self::add_rest_derivatives), with registers used for this program only;
    /// the entries are added to the values of a matrix, each at its slot and at that of its mirror image.
    #[inline]
    pub(in crate::model) fn add_rest_derivatives_again(
        &self,
        registers: &mut OwnRegisters<T>,
        position: &[T],
        gradient: &mut [T],
        slots_and_values: (&[(u32, u32)], &mut [T]),
    ) {
        if let Some(rest) = &self.rest {
            rest.derivatives.evaluate_again(registers, position, gradient, slots_and_values);
        }
    }
}

/// Any moment: a potential does not depend on the time.
fn moment<T: Elementary>() -> Moment<T> {
    Moment::inside(T::zero())
}
