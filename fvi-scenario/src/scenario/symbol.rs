//! Transfer functions that are expressions in the Laplace variable s.

use crate::language::expression::{Expression, Function, Kind, LARGEST_MULTIPLIED, Node, Operator};
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::algebra::{Algebra, Series};
use fvi_fft::transfer::derivative::TransferDerivative;
use fvi_fft::transfer::dual::Dual;
use fvi_fft::transfer::estimate::Estimate;
use fvi_fft::transfer::fractions::{Fractions, Quotient};
use fvi_fft::transfer::real::Real;
use fvi_fft::transfer::scaled::Scaled;
use fvi_fft::transfer::{Formula, TransferFunction};
use nalgebra::Complex;
use std::f64::consts::PI;
use std::sync::Arc;

/// A function in the expression that is not analytic, or has no power series here.
pub(super) fn unsuited(node: &Node) -> Option<String> {
    match node.kind() {
        Kind::Number(_) | Kind::Variable(_) => None,
        Kind::Time | Kind::SidedTime => Some("the time".to_owned()),
        Kind::Negation(inner) => unsuited(inner),
        Kind::Chain(first, operands) => {
            unsuited(first).or_else(|| operands.iter().find_map(|(_, operand)| unsuited(operand)))
        }
        Kind::Power(sides) => sides.iter().find_map(unsuited),
        Kind::Choice(function, _) if function.selects() => Some("min or max".to_owned()),
        Kind::Choice(function, _) => Some(function.name().to_owned()),
        Kind::Call(function, argument) => match function {
            Function::Sqrt
            | Function::Exp
            | Function::Log
            | Function::Sinh
            | Function::Cosh
            | Function::Tanh => unsuited(argument),
            other => Some(format!("{other:?}").to_lowercase()),
        },
    }
}

/// An expression in s.
#[derive(Debug)]
pub(super) struct Symbol {
    expression: Expression,
    /// Its numbers, those of its parameters included, which the text only names.
    numbers: Vec<f64>,
}

impl Symbol {
    pub(super) fn new(expression: Expression) -> Self {
        let mut numbers = Vec::new();
        add_numbers(expression.root(), &mut numbers);
        Self { expression, numbers }
    }

    /// K(s) with its rounding error; where its digits are lost in a quotient whose divisor vanishes, the mean
    /// [around](Self::around) s.
    fn estimate(&self, s: Complex<f64>) -> Estimate {
        let plain = self.plain(s);
        if plain.is_sure() {
            plain
        } else {
            self.around(s).filter(|mean| mean.error < plain.error).unwrap_or(plain)
        }
    }

    /// K(s) with its rounding error, where its parts overflow too.
    fn plain(&self, s: Complex<f64>) -> Estimate {
        let plain = evaluate(self.expression.root(), &Estimate::exact(s));
        if plain.value.is_finite() {
            return plain;
        }
        let scaled = evaluate(self.expression.root(), &Scaled::of(s));
        let value = scaled.value();
        if !value.is_finite() {
            return plain;
        }
        Estimate { value, error: value.norm() * scaled.rounding(), divided: false }
    }

    /// K(s) at a removable point, such as (s − 1)/log(s) at s = 1, by its mean over a circle around s:
    ///
    /// ```text
    /// K(s) = (1/m) Σ_j K(s + r e^{2πij/m}) ,      m = 16 ,
    /// ```
    ///
    /// with an error of (r/R)^m, R the distance of the next singularity. `None` on the cut, and where K has a
    /// singularity inside: there the means over two circles differ, or the largest |K| on the inner one is
    /// above that on the outer one, which is impossible for an analytic function (maximum principle).
    fn around(&self, s: Complex<f64>) -> Option<Estimate> {
        /// m.
        const POINTS: usize = 16;
        /// Radii relative to the distance from the cut.
        const RADII: [f64; 2] = [1.0 / 32.0, 1.0 / 64.0];
        /// Largest difference of the means, relative to the largest value.
        const APART: f64 = 1e-10;
        let from_cut = if s.re > 0.0 { s.norm() } else { s.im.abs() };
        if !(from_cut > 0.0 && from_cut.is_finite()) {
            return None;
        }
        let [outer, inner] = RADII.map(|radius| {
            let mut mean = Estimate { value: Complex::ZERO, error: 0.0, divided: false };
            let mut largest = 0.0_f64;
            for j in 0..POINTS {
                let angle = 2.0 * PI * (j as f64 + 0.5) / POINTS as f64;
                let direction = Complex::new(libm::cos(angle), libm::sin(angle));
                let at = self.plain(s + direction * (radius * from_cut));
                mean.value += at.value / POINTS as f64;
                mean.error += at.error / POINTS as f64;
                largest = max_or_nan(largest, at.value.norm());
            }
            (mean, largest)
        });
        let ((mean, largest), (other, most)) = (outer, inner);
        let agree = (mean.value - other.value).norm() <= APART * largest && most <= largest * (1.0 + APART);
        // Real for real s, without the rounding of the mean.
        let value = if s.im == 0.0 { Complex::new(mean.value.re, 0.0) } else { mean.value };
        (agree && mean.error.is_finite()).then_some(Estimate { value, ..mean })
    }
}

/// Appends the numbers of an expression that is suited to a symbol.
fn add_numbers(node: &Node, numbers: &mut Vec<f64>) {
    match node.kind() {
        Kind::Number(value) => numbers.push(*value),
        Kind::Negation(inner) | Kind::Call(_, inner) => add_numbers(inner, numbers),
        Kind::Chain(first, operands) => {
            add_numbers(first, numbers);
            operands.iter().for_each(|(_, operand)| add_numbers(operand, numbers));
        }
        Kind::Power(sides) => sides.iter().for_each(|side| add_numbers(side, numbers)),
        Kind::Variable(_) | Kind::Time | Kind::SidedTime | Kind::Choice(..) => {}
    }
}

impl Formula for Symbol {
    fn value(&self, s: Complex<f64>) -> Complex<f64> {
        self.estimate(s).value
    }

    fn rounding(&self, s: Complex<f64>) -> f64 {
        self.estimate(s).error
    }

    fn series(&self, s: &Series) -> Series {
        evaluate(self.expression.root(), s)
    }

    fn text(&self) -> &str {
        self.expression.text()
    }

    fn numbers(&self) -> &[f64] {
        &self.numbers
    }

    fn fractions(&self) -> Option<Fractions> {
        fractions_of(self.expression.root())
    }
}

/// Partial fractions of an expression in s; `None` if it is not a quotient of polynomials.
fn fractions_of(node: &Node) -> Option<Fractions> {
    by_terms(&Quotient::constant(1.0), node).or_else(|| quotient(node)?.fractions())
}

/// Partial fractions of the product of a factor and an expression, of sums term by term: over a common
/// denominator the residues would lose digits. `None` too where only the sum of all terms has partial
/// fractions, as of s² − s³/(s + 1).
fn by_terms(factor: &Quotient, node: &Node) -> Option<Fractions> {
    match node.kind() {
        Kind::Negation(inner) => Some(by_terms(factor, inner)?.scale(-1.0)),
        Kind::Chain(first, operands) if operands.iter().all(|(operator, _)| operator.is_additive()) => {
            operands.iter().try_fold(by_terms(factor, first)?, |sum, (operator, operand)| {
                let sign = if *operator == Operator::Subtract { -1.0 } else { 1.0 };
                Some(sum.plus(by_terms(factor, operand)?.scale(sign)))
            })
        }
        Kind::Chain(first, operands) => match operands.as_slice() {
            [(Operator::Multiply, operand)] => by_terms(&factor.clone().multiply(&quotient(first)?), operand),
            _ => factor.clone().multiply(&quotient(node)?).fractions(),
        },
        _ => factor.clone().multiply(&quotient(node)?).fractions(),
    }
}

/// An expression in s as a quotient of polynomials.
fn quotient(node: &Node) -> Option<Quotient> {
    let found = match node.kind() {
        Kind::Number(value) => Quotient::constant(*value),
        Kind::Variable(0) => Quotient::variable(),
        Kind::Negation(inner) => quotient(inner)?.multiply(&Quotient::constant(-1.0)),
        Kind::Chain(first, operands) => {
            operands.iter().try_fold(quotient(first)?, |joined, (operator, operand)| {
                let operand = quotient(operand)?;
                let joined = match operator {
                    Operator::Add => joined.plus(&operand),
                    Operator::Subtract => joined.plus(&operand.multiply(&Quotient::constant(-1.0))),
                    Operator::Multiply => joined.multiply(&operand),
                    Operator::Divide => joined.multiply(&operand.inverse()?),
                };
                joined.is_readable().then_some(joined)
            })?
        }
        Kind::Power(sides) => {
            let [base, exponent] = sides.as_ref();
            quotient(base)?.power(exponent.as_number()?)?
        }
        _ => return None,
    };
    found.is_readable().then_some(found)
}

/// The derivative of an expression in s and a constant, which follows s as a variable, by that constant at
/// its value.
#[derive(Debug)]
struct SymbolSlope {
    expression: Expression,
    at: f64,
}

impl SymbolSlope {
    fn of<A: Algebra>(&self, s: &A) -> A {
        let constant = Dual::variable(s.constant(self.at));
        evaluate_at(self.expression.root(), &Dual::constant_in(s), &constant).slope()
    }
}

impl Formula for SymbolSlope {
    fn value(&self, s: Complex<f64>) -> Complex<f64> {
        self.of(&s)
    }

    fn series(&self, s: &Series) -> Series {
        self.of(s)
    }

    fn text(&self) -> &str {
        self.expression.text()
    }
}

/// The derivative of a symbol by a constant, which is the variable after s in its expression.
///
/// # Errors
/// A message: the part of the symbol in which the constant may not occur.
pub(super) fn symbol_derivative(
    transfer: &TransferFunction,
    expression: Expression,
    at: f64,
) -> Result<TransferDerivative, String> {
    if let Some(function) = unsuited(expression.root()) {
        return Err(format!("a constant that a symbol does not have in {function}"));
    }
    TransferDerivative::of_formula(transfer, Arc::new(SymbolSlope { expression, at }))
        .map_err(|error| format!("{}; {} is {:e} here", error.allowed, error.parameter, error.value))
}

/// The value of an expression in s.
pub(super) fn evaluate<A: Algebra>(node: &Node, s: &A) -> A {
    evaluate_at(node, s, s)
}

/// The value of an expression in s and a constant, which is the variable after s.
fn evaluate_at<A: Algebra>(node: &Node, s: &A, constant: &A) -> A {
    let of = |node: &Node| evaluate_at(node, s, constant);
    match node.kind() {
        Kind::Number(value) => s.constant(*value),
        Kind::Variable(0) => s.clone(),
        Kind::Variable(_) => constant.clone(),
        Kind::Negation(inner) => of(inner).negate(),
        Kind::Chain(first, operands) => {
            operands.iter().fold(of(first), |joined, (operator, operand)| match operator {
                Operator::Add => joined.add(&of(operand)),
                Operator::Subtract => joined.add(&of(operand).negate()),
                Operator::Multiply => joined.multiply(&of(operand)),
                Operator::Divide => joined.divide(&of(operand)),
            })
        }
        Kind::Power(sides) => {
            let [base, exponent] = sides.as_ref();
            match exponent.as_number() {
                Some(exponent) => power(&of(base), exponent),
                None => of(base).logarithm().multiply(&of(exponent)).exponential(),
            }
        }
        Kind::Call(function, argument) => {
            let argument = of(argument);
            let half = |sum: A| sum.scale(0.5);
            match function {
                Function::Sqrt => power(&argument, 0.5),
                Function::Exp => argument.exponential(),
                Function::Log => argument.logarithm(),
                // From eˣ − 1, which keeps its digits near x = 0.
                Function::Sinh => {
                    let (up, down) =
                        (argument.exponential_beside_one(), argument.negate().exponential_beside_one());
                    half(up.add(&down.negate()))
                }
                Function::Cosh => half(argument.exponential().add(&argument.negate().exponential())),
                Function::Tanh if argument.is_left() => tangent(&argument.negate()).negate(),
                Function::Tanh => tangent(&argument),
                // Refused during reading.
                _ => s.constant(f64::NAN),
            }
        }
        // Refused during reading.
        Kind::Time | Kind::SidedTime | Kind::Choice(..) => s.constant(f64::NAN),
    }
}

/// tanh x = (1 − e^{−2x})/(1 + e^{−2x}) for Re x ≥ 0, where the exponential does not overflow.
fn tangent<A: Algebra>(x: &A) -> A {
    let fallen = x.scale(-2.0).exponential_beside_one();
    fallen.negate().divide(&fallen.add(&x.constant(2.0)))
}

/// Small integer powers by multiplication, which has no branch cut.
pub(super) fn power<A: Algebra>(base: &A, exponent: f64) -> A {
    let whole = exponent.abs();
    if exponent.fract() != 0.0 || whole > f64::from(LARGEST_MULTIPLIED) {
        return base.power(Real::from(exponent));
    }
    let product = (0..whole as usize).fold(base.constant(1.0), |product, _| product.multiply(base));
    if exponent < 0.0 { base.constant(1.0).divide(&product) } else { product }
}
