//! Transfer functions of plants, written as expressions in s: as fractions whose parts are analytic.

use super::parameters::symbols_of;
use super::symbol::{evaluate, power, unsuited};
use crate::language::document::Value;
use crate::language::error::{InputError, Problem};
use crate::language::expression::{Expression, Function, Kind, Node, Operator};
use fvi_fft::transfer::algebra::Algebra;
use fvi_fft::transfer::real::Real;
use fvi_fft::transfer::scaled::Scaled;
use nalgebra::Complex;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// P(s) as an expression in s and the parameters, such as `3.13*exp(-50*s)/(433.33*s + 1)`.
///
/// It is converted to a fraction N(s)/D(s) whose parts are analytic for Re s > 0, for any nesting of sums and
/// quotients: the zeros of D there are the plant's unstable poles, and those of a D + b N the unstable poles
/// of a closed loop. Powers are principal branches.
#[derive(Clone, Debug)]
pub struct PlantFormula {
    expression: Expression,
    dead_time: f64,
}

/// Bounds of the argument of a part for s in the upper right quadrant; `None` where unknown.
type Sector = Option<(f64, f64)>;

impl PlantFormula {
    /// Reads the expression.
    ///
    /// # Errors
    /// If it is not an expression in s, contains functions that are not analytic, an exponential that grows
    /// to the right (a prediction), a power or logarithm of a part that may be a negative number in the right
    /// half-plane, or is not real for positive s.
    pub fn read(value: &Value<'_>, parameters: &BTreeMap<String, f64>) -> Result<Self, InputError> {
        if parameters.contains_key("s") {
            return Err(value.out_of_range(
                "an expression beside parameters none of which is named `s`, the Laplace variable",
            ));
        }
        let symbols = symbols_of(parameters).with_variables(["s".to_owned()]);
        let expression = value.expression(&symbols)?;
        if let Some(function) = unsuited(expression.root()) {
            return Err(value.out_of_range(format!(
                "+ − * / ^, sqrt, exp, log, sinh, cosh and tanh of the complex variable s, not {function}"
            )));
        }
        let unusable = |reason: String| value.error(Problem::Unusable { reason });
        analytic(expression.root()).map_err(unusable)?;
        let dead_time = dead_time(expression.root());
        let formula = Self { expression, dead_time };
        for exponent in -6..=6 {
            let s = libm::exp10(0.5 * f64::from(exponent) + 0.1234);
            let [found, log_denominator] = formula.at(Complex::new(s, 0.0));
            let is_real = found.im.abs() <= 1e-9 * found.re.abs();
            if !(is_real && found.is_finite() && log_denominator.is_finite()) {
                return Err(value.out_of_range(format!(
                    "an expression that is a real number for every s > 0 (it is {found} at s = {s:.4})"
                )));
            }
        }
        Ok(formula)
    }

    /// P(s) and ln D(s), for Re s ≥ 0 and Im s ≥ 0.
    pub fn at(&self, s: Complex<f64>) -> [Complex<f64>; 2] {
        let [numerator, denominator] = self.fraction(s);
        let (value, log_denominator) = (numerator / denominator, denominator.logarithm());
        if value.is_finite() && log_denominator.is_finite() {
            return [value, log_denominator];
        }
        let [numerator, denominator] = fraction(self.expression.root(), &Scaled::of(s));
        [numerator.divide(&denominator).value(), denominator.logarithm().value()]
    }

    /// N(s) and D(s).
    fn fraction(&self, s: Complex<f64>) -> [Complex<f64>; 2] {
        fraction(self.expression.root(), &s)
    }

    /// The sum L of all dead times, which bounds the phase rate of its exponentials e^{−Ls}.
    pub fn dead_time(&self) -> f64 {
        self.dead_time
    }

    /// The formula as N(s)/D(s) e^{−Ls}: coefficients of the polynomials N and D from s⁰ on, and L; `None` if
    /// it is not of this kind, or of a degree beyond 64.
    pub fn quotient(&self) -> Option<Quotient> {
        Quotient::of(self.expression.root())
    }

    /// Its text.
    pub fn text(&self) -> &str {
        self.expression.text()
    }
}

impl Serialize for PlantFormula {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.expression.serialize(serializer)
    }
}

/// N(s)/D(s) e^{−Ls} with polynomials N and D.
#[derive(Clone, Debug, PartialEq)]
pub struct Quotient {
    /// Coefficients of N, from s⁰ on.
    pub numerator: Vec<f64>,
    /// Coefficients of D, from s⁰ on.
    pub denominator: Vec<f64>,
    /// L.
    pub dead_time: f64,
}

/// The highest degree of a polynomial.
const MOST_DEGREES: usize = 64;

impl Quotient {
    fn number(value: f64) -> Self {
        Self { numerator: vec![value], denominator: vec![1.0], dead_time: 0.0 }
    }

    fn of(node: &Node) -> Option<Self> {
        if !node.varies() {
            return Some(Self::number(evaluate(node, &Complex::new(1.0, 0.0)).re));
        }
        match node.kind() {
            Kind::Variable(_) => Some(Self { numerator: vec![0.0, 1.0], ..Self::number(1.0) }),
            Kind::Negation(inner) => Some(Self::of(inner)?.times(-1.0)),
            Kind::Chain(first, operands) => {
                operands.iter().try_fold(Self::of(first)?, |left, (operator, operand)| {
                    let right = Self::of(operand)?;
                    match operator {
                        Operator::Add => left.plus(right),
                        Operator::Subtract => left.plus(right.times(-1.0)),
                        Operator::Multiply => left.product(&right),
                        Operator::Divide => left.product(&right.inverse()),
                    }
                })
            }
            Kind::Power(sides) => {
                let [base, exponent] = sides.as_ref();
                let whole = exponent.as_number().filter(|n| n.fract() == 0.0 && n.abs() <= 64.0)?;
                let base = if whole < 0.0 { Self::of(base)?.inverse() } else { Self::of(base)? };
                (0..whole.abs() as u32).try_fold(Self::number(1.0), |power, _| power.product(&base))
            }
            Kind::Call(Function::Exp, argument) => {
                let exponent = Self::of(argument)?;
                let [last] = exponent.denominator[..] else { return None };
                let (constant, slope) = match exponent.numerator[..] {
                    [constant] => (constant, 0.0),
                    [constant, slope] => (constant, slope),
                    _ => return None,
                };
                let whole = exponent.dead_time == 0.0;
                whole.then(|| Self { dead_time: -slope / last, ..Self::number(libm::exp(constant / last)) })
            }
            _ => None,
        }
    }

    fn times(mut self, factor: f64) -> Self {
        self.numerator.iter_mut().for_each(|number| *number *= factor);
        self
    }

    fn inverse(self) -> Self {
        Self { numerator: self.denominator, denominator: self.numerator, dead_time: -self.dead_time }
    }

    /// The product; `None` beyond degree 64.
    pub fn product(&self, other: &Self) -> Option<Self> {
        Self {
            numerator: multiplied(&self.numerator, &other.numerator),
            denominator: multiplied(&self.denominator, &other.denominator),
            dead_time: self.dead_time + other.dead_time,
        }
        .trimmed()
    }

    /// The sum, if both have the same dead time; `None` beyond degree 64.
    pub fn plus(self, other: Self) -> Option<Self> {
        if self.dead_time != other.dead_time {
            return None;
        }
        if self.denominator == other.denominator {
            return Self { numerator: added(self.numerator, &other.numerator), ..self }.trimmed();
        }
        let numerator = added(
            multiplied(&self.numerator, &other.denominator),
            &multiplied(&other.numerator, &self.denominator),
        );
        let denominator = multiplied(&self.denominator, &other.denominator);
        Self { numerator, denominator, dead_time: self.dead_time }.trimmed()
    }

    /// Without leading zeros; `None` if nothing is left of a part, or too much.
    fn trimmed(mut self) -> Option<Self> {
        for part in [&mut self.numerator, &mut self.denominator] {
            while part.len() > 1 && part.last() == Some(&0.0) {
                part.pop();
            }
            if part.len() > MOST_DEGREES + 1 || part.iter().any(|number| !number.is_finite()) {
                return None;
            }
        }
        (self.denominator.last() != Some(&0.0)).then_some(self)
    }
}

fn multiplied(left: &[f64], right: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; left.len() + right.len() - 1];
    for (i, a) in left.iter().enumerate() {
        right.iter().enumerate().for_each(|(j, b)| product[i + j] += a * b);
    }
    product
}

fn added(mut left: Vec<f64>, right: &[f64]) -> Vec<f64> {
    left.resize(left.len().max(right.len()), 0.0);
    left.iter_mut().zip(right).for_each(|(a, b)| *a += b);
    left
}

fn fraction<A: Algebra>(node: &Node, s: &A) -> [A; 2] {
    let one = || s.constant(1.0);
    if !node.varies() {
        return [evaluate(node, s), one()];
    }
    let of = |node: &Node| fraction(node, s);
    match node.kind() {
        Kind::Negation(inner) => {
            let [numerator, denominator] = of(inner);
            [numerator.negate(), denominator]
        }
        Kind::Chain(first, operands) => operands.iter().fold(of(first), |[n, d], (operator, operand)| {
            let [right_n, right_d] = of(operand);
            let crossed = |right: A| n.multiply(&right_d).add(&right.multiply(&d));
            match operator {
                Operator::Add => [crossed(right_n), d.multiply(&right_d)],
                Operator::Subtract => [crossed(right_n.negate()), d.multiply(&right_d)],
                Operator::Multiply => [n.multiply(&right_n), d.multiply(&right_d)],
                Operator::Divide => [n.multiply(&right_d), d.multiply(&right_n)],
            }
        }),
        Kind::Power(sides) => {
            let [base, exponent] = sides.as_ref();
            let whole = exponent.as_number().filter(|number| number.fract() == 0.0 && number.abs() <= 64.0);
            match (whole, exponent.as_number()) {
                (Some(whole), _) => {
                    let [n, d] = of(base).map(|part| power(&part, whole.abs()));
                    if whole < 0.0 { [d, n] } else { [n, d] }
                }
                // A negative power of a base that vanishes at s = 0 only belongs to the denominator.
                (None, Some(exponent)) if exponent < 0.0 => {
                    [one(), evaluate(base, s).power(Real::from(-exponent))]
                }
                _ => [evaluate(node, s), one()],
            }
        }
        Kind::Call(Function::Tanh, argument) => {
            let small = evaluate(argument, s).scale(-2.0).exponential();
            [one().add(&small.negate()), one().add(&small)]
        }
        _ => [evaluate(node, s), one()],
    }
}

/// The reason why the parts of a fraction would not be analytic in the right half-plane.
fn analytic(node: &Node) -> Result<(), String> {
    if !node.varies() {
        return Ok(());
    }
    match node.kind() {
        Kind::Negation(inner) => analytic(inner),
        Kind::Chain(first, operands) => {
            analytic(first)?;
            operands.iter().try_for_each(|(_, operand)| analytic(operand))
        }
        Kind::Power(sides) => {
            let [base, exponent] = sides.as_ref();
            let Some(number) = exponent.as_number() else {
                return Err("s in an exponent: write exp(−L*s) for a dead time L".to_owned());
            };
            if number.fract() == 0.0 && number.abs() <= 64.0 { analytic(base) } else { branch(base, "power") }
        }
        Kind::Call(Function::Sqrt, argument) => branch(argument, "root"),
        Kind::Call(Function::Log, argument) => branch(argument, "logarithm"),
        Kind::Call(function, argument) => {
            if divides(argument) {
                return Err("a quotient in s inside a function: it has no value where its divisor vanishes"
                    .to_owned());
            }
            analytic(argument)?;
            let at = |exponent: i32| evaluate(argument, &Complex::new(libm::exp10(exponent.into()), 0.0)).re;
            let grows = |from: i32, to: i32| at(to) > at(from) + 1e-9 * at(from).abs();
            if *function == Function::Exp && (grows(0, 3) || grows(3, 6)) {
                return Err(
                    "exp of something that grows with s, a prediction: a dead time L is exp(−L*s)".to_owned()
                );
            }
            Ok(())
        }
        _ => Ok(()),
    }
}

/// Checks that a power, root or logarithm of a part is analytic: the part must not take negative values.
fn branch(base: &Node, what: &str) -> Result<(), String> {
    match sector(base) {
        Some((low, high)) if !divides(base) && low >= -PI - 1e-9 && high <= PI + 1e-9 => Ok(()),
        _ => Err(format!(
            "a {what} of something that is not known to stay off the negative numbers for Re s > 0, as sums of \
             positive numbers times powers of s up to s^2 are"
        )),
    }
}

/// True if a denominator depends on s.
fn divides(node: &Node) -> bool {
    node.any(&|part| match part.kind() {
        Kind::Chain(_, operands) => {
            operands.iter().any(|(operator, operand)| *operator == Operator::Divide && operand.varies())
        }
        Kind::Power(sides) => sides[0].varies() && sides[1].as_number().is_none_or(|number| number < 0.0),
        _ => false,
    })
}

fn sector(node: &Node) -> Sector {
    if !node.varies() {
        let value = evaluate(node, &Complex::new(1.0, 0.0)).re;
        return match value {
            value if value > 0.0 => Some((0.0, 0.0)),
            value if value < 0.0 => Some((PI, PI)),
            _ => None,
        };
    }
    match node.kind() {
        Kind::Variable(_) => Some((0.0, 0.5 * PI)),
        Kind::Chain(first, operands) => {
            operands.iter().try_fold(sector(first)?, |bounds, (operator, operand)| {
                let (low, high) = bounds;
                // The argument of a zero term is undefined, and the term can be ignored.
                let (right_low, right_high) = sector(operand)?;
                match operator {
                    Operator::Add => {
                        let hull = (low.min(right_low), high.max(right_high));
                        (hull.1 - hull.0 <= PI).then_some(hull)
                    }
                    Operator::Subtract => None,
                    Operator::Multiply => Some((low + right_low, high + right_high)),
                    Operator::Divide => Some((low - right_high, high - right_low)),
                }
            })
        }
        Kind::Power(sides) => {
            let exponent = sides[1].as_number().filter(|&exponent| exponent > 0.0)?;
            let (low, high) = sector(&sides[0])?;
            Some((exponent * low, exponent * high))
        }
        Kind::Call(Function::Sqrt, argument) => sector(argument).map(|(low, high)| (0.5 * low, 0.5 * high)),
        _ => None,
    }
}

/// The sum of L over all e^{−Ls}.
fn dead_time(node: &Node) -> f64 {
    match node.kind() {
        _ if !node.varies() => 0.0,
        Kind::Negation(inner) => dead_time(inner),
        Kind::Chain(first, operands) => {
            dead_time(first) + operands.iter().map(|(_, operand)| dead_time(operand)).sum::<f64>()
        }
        Kind::Power(sides) => {
            dead_time(&sides[0]) * sides[1].as_number().map_or(1.0, |number| number.abs().max(1.0))
        }
        Kind::Call(function, argument) => {
            let turns = |omega: f64| evaluate(argument, &Complex::new(0.0, omega)).im.abs() / omega;
            let own = if matches!(function, Function::Sqrt | Function::Log) {
                0.0
            } else {
                // At high frequencies roots contribute nothing to the phase, and L s all of it.
                let far = turns(1e12);
                let times = if *function == Function::Exp { 1.0 } else { 2.0 };
                if far > 1e-4 * turns(1.0) { times * far } else { 0.0 }
            };
            own + dead_time(argument)
        }
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::language::Document;
    use std::path::Path;

    fn read(text: &str) -> Result<PlantFormula, String> {
        let document = Document::new("plant.toml", Path::new(""), &format!("p = \"{text}\""));
        document
            .with_root(|root| PlantFormula::read(&root.required("p")?, &BTreeMap::new()))
            .map_err(|error| format!("{error} {:?}", error.problem()))
    }

    #[test]
    fn fractions_have_the_value_of_the_expression_and_no_poles() {
        let s = Complex::new(0.3, 1.7);
        for (text, value) in [
            ("3.13*exp(-50*s)/(433.33*s + 1)", (s * -50.0).exp() * 3.13 / (s * 433.33 + 1.0)),
            ("1/(s*(0.71*s + 1))", (s * (s * 0.71 + 1.0)).inv()),
            ("1/(0.8*s^2.2 + 0.5*s^0.9 + 1)", (s.powf(2.2) * 0.8 + s.powf(0.9) * 0.5 + 1.0).inv()),
            ("2/(s - 1) + s^-0.5/(1 + 1/s)", (s - 1.0).inv() * 2.0 + s.powf(-0.5) / (s.inv() + 1.0)),
            ("1/(s^2 + s + 1)^0.5", (s * s + s + 1.0).sqrt().inv()),
            ("1/cosh(sqrt(s))", s.sqrt().cosh().inv()),
            // Parts that are beyond the range of numbers, in proportion.
            ("cosh(999*s)/cosh(1000*s)", (s * -1.0).exp()),
            ("tanh(sqrt(s))/sqrt(s)", s.sqrt().tanh() / s.sqrt()),
        ] {
            let [found, log_denominator] = read(text).unwrap().at(s);
            assert!((found - value).norm() < 1e-12 * value.norm(), "{text}: {found} {value}");
            assert!(log_denominator.is_finite(), "{text}");
        }
        // An unstable pole is a zero of D, and N is finite there.
        let [n, d] = read("2/(s - 1) + 1").unwrap().fraction(Complex::new(1.0, 0.0));
        assert_eq!((d.norm(), n.re), (0.0, 2.0));
    }

    #[test]
    fn quotients_of_polynomials_are_found() {
        for (text, numerator, denominator, dead_time) in [
            ("2/(s^2 + 3*s + 5)", &[2.0][..], &[5.0, 3.0, 1.0][..], 0.0),
            ("3.13*exp(-50*s)/(433.33*s + 1)", &[3.13], &[1.0, 433.33], 50.0),
            ("(1 - s)*exp(-2*s)*exp(-s)/(s*(s + 1)^2)", &[1.0, -1.0], &[0.0, 1.0, 2.0, 1.0], 3.0),
            ("1/(s + 1) - 2/(s + 3)", &[1.0, -1.0], &[3.0, 4.0, 1.0], 0.0),
            ("1/(1 + 1/s)", &[0.0, 1.0], &[1.0, 1.0], 0.0),
            ("(s + 2)^-2", &[1.0], &[4.0, 4.0, 1.0], 0.0),
        ] {
            let known =
                Quotient { numerator: numerator.to_vec(), denominator: denominator.to_vec(), dead_time };
            assert_eq!(read(text).unwrap().quotient(), Some(known), "{text}");
        }
        for text in ["1/(s^0.5 + 1)", "1/(s + 1) + exp(-s)/(s + 2)", "tanh(s)/s", "1/(s + exp(-s))"] {
            assert_eq!(read(text).unwrap().quotient(), None, "{text}");
        }
    }

    #[test]
    fn dead_times_are_found_wherever_they_stand() {
        assert_eq!(read("exp(-2*s)/(1 + s)").unwrap().dead_time(), 2.0);
        assert_eq!(read("exp(-2*s)*exp(-s*0.5)/(1 + exp(-s))").unwrap().dead_time(), 3.5);
        assert_eq!(read("exp(-sqrt(s))").unwrap().dead_time(), 0.0);
    }

    #[test]
    fn what_is_not_analytic_to_the_right_is_refused() {
        for (text, part) in [
            ("exp(s)", "a prediction"),
            ("(s - 1)^0.5", "negative numbers"),
            ("log(1 - s)", "negative numbers"),
            ("exp(-1/s)", "divisor vanishes"),
            ("2^s", "s in an exponent"),
            ("abs(s)", "not abs"),
            ("(s^3 + 1)^0.5", "negative numbers"),
            ("(0 - 1)^0.5*s", "NaN"),
            ("1/(s", "p"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains(part), "{text}: {message}");
        }
    }
}
