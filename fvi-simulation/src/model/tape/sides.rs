//! Jumps and kinks in the position: their arguments, and their sides as inputs of a program.
//!
//! A function is smooth between its jumps and kinks. With the side of each as an input, the program continues
//! smoothly where an argument passes zero, so that a step across it determines the time of the crossing to
//! the order of the scheme; a step that ends there, followed by one on the other side, has that order too.

use super::graph::{Graph, Origin, Value};
use super::program::Program;
use fvi_scenario::language::expression::{Kind, Moment, Node, Operator};
use std::collections::HashMap;

/// The arguments of jumps and kinks found in an expression.
#[derive(Debug)]
pub(super) struct SideArguments {
    /// Number of variables before the sides.
    coordinates: u32,
    /// Index of the first variable that is not a position; only jumps and kinks in positions become switches.
    positions: usize,
    /// Prefix of the names of variables.
    letter: char,
    names: Vec<String>,
    derivatives: Vec<(Value, Vec<(u32, Value)>)>,
    /// Index of each argument by its value; equal values are one argument.
    known: HashMap<Value, usize>,
}

impl SideArguments {
    /// An empty collection for functions of `coordinates` coordinates, named by this letter and their
    /// indices.
    pub(super) fn new(coordinates: usize, letter: char) -> Self {
        let positions = coordinates;
        let coordinates = u32::try_from(coordinates).expect("fewer than 2³² coordinates");
        Self {
            coordinates,
            positions,
            letter,
            names: Vec::new(),
            derivatives: Vec::new(),
            known: HashMap::new(),
        }
    }

    /// The same with `count` variables in all, of which those after the coordinates do not make jumps and
    /// kinks switches.
    pub(super) fn with_variables(self, count: usize) -> Self {
        let coordinates = u32::try_from(count).expect("fewer than 2³² variables");
        Self { coordinates, ..self }
    }

    /// True if the sides of a jump or kink with this argument are inputs.
    pub(super) fn take(&self, node: &Node) -> bool {
        node.varies() && !node.has_variable_from(self.positions)
    }

    /// The inputs a and b of the side a + b g of a jump or kink with the argument g and its gradient.
    pub(super) fn inputs(
        &mut self,
        node: &Node,
        (argument, gradient): (Value, &[(u32, Value)]),
    ) -> [Origin; 2] {
        let index = *self.known.entry(argument).or_insert_with(|| {
            self.names.push(text(node, self.letter));
            self.derivatives.push((argument, gradient.to_vec()));
            self.names.len() - 1
        });
        let first = self.coordinates + 2 * u32::try_from(index).expect("fewer than 2³¹ jumps and kinks");
        [Origin::Variable(first), Origin::Variable(first + 1)]
    }

    /// Number of coordinates plus two inputs for each side.
    pub(super) fn inputs_in_all(&self) -> usize {
        self.coordinates as usize + 2 * self.names.len()
    }

    /// The program of the arguments; `None` if there are none.
    pub(super) fn compile(self, graph: &Graph) -> Option<CompiledSides> {
        if self.names.is_empty() {
            return None;
        }
        let inputs = self.inputs_in_all();
        let values: Vec<_> =
            (0..).zip(&self.derivatives).map(|(place, (value, _))| (place, *value)).collect();
        let slopes = (0_u32..).zip(&self.derivatives).flat_map(|(index, (_, gradient))| {
            gradient.iter().map(move |&(column, slope)| ((index, column), slope))
        });
        let (pattern, slopes): (Vec<_>, Vec<_>) = slopes.unzip();
        let entries: Vec<_> = (0..).zip(slopes).collect();
        Some(CompiledSides {
            coordinates: self.coordinates as usize,
            names: self.names,
            values: Program::new(graph, inputs, &values, &[]),
            slopes: Program::new(graph, inputs, &values, &entries),
            pattern,
        })
    }
}

/// The arguments of the jumps and kinks of a function, as programs.
#[derive(Clone, Debug)]
pub struct CompiledSides {
    coordinates: usize,
    names: Vec<String>,
    values: Program<f64>,
    slopes: Program<f64>,
    /// Argument and coordinate of each slope.
    pattern: Vec<(u32, u32)>,
}

impl CompiledSides {
    /// The functions with their arguments, as written except that numbers are evaluated.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Number of coordinates, which precede the inputs for the sides.
    pub fn coordinates(&self) -> usize {
        self.coordinates
    }

    /// Writes the values of the arguments at a time and a point, whose coordinates are followed by the inputs
    /// a and b of each side.
    pub fn values(&self, time: f64, point: &[f64], registers: &mut Vec<f64>, values: &mut [f64]) {
        values.fill(0.0);
        self.values.evaluate(Moment::inside(time), point, registers, values, &mut []);
    }

    /// Writes (Σ_i |∂g/∂q_i|, Σ_i |q_i ∂g/∂q_i|) for each argument at such a point.
    pub fn scales(&self, time: f64, point: &[f64], registers: &mut Vec<f64>, scales: &mut [[f64; 2]]) {
        let mut values = vec![0.0; self.names.len()];
        let mut slopes = vec![0.0; self.pattern.len()];
        self.slopes.evaluate(Moment::inside(time), point, registers, &mut values, &mut slopes);
        scales.fill([0.0; 2]);
        for (&(argument, coordinate), slope) in self.pattern.iter().zip(slopes) {
            let [sum, weighted] = &mut scales[argument as usize];
            *sum += slope.abs();
            *weighted += (slope * point[coordinate as usize]).abs();
        }
    }
}

/// Largest number of characters of a part in a message.
const LONGEST: usize = 80;

/// A part of an expression as text.
fn text(node: &Node, letter: char) -> String {
    let mut text = String::new();
    write(node, (letter, 0), &mut text);
    if text.chars().count() > LONGEST {
        text = text.chars().take(LONGEST).chain(['…']).collect();
    }
    text
}

/// Writes a part, in brackets if it does not bind tighter than `outer`: 1 in a sum, 2 in a product, 3 in a
/// power.
fn write(node: &Node, (letter, outer): (char, u8), text: &mut String) {
    // The text is cut off at this length anyway.
    if text.len() > 8 * LONGEST {
        return;
    }
    let bracketed = |inner: u8, text: &mut String, body: &dyn Fn(&mut String)| {
        if inner <= outer {
            text.push('(');
            body(text);
            text.push(')');
        } else {
            body(text);
        }
    };
    match node.kind() {
        Kind::Number(number) if *number < 0.0 => {
            bracketed(2, text, &|text| text.push_str(&number.to_string()));
        }
        Kind::Number(number) => text.push_str(&number.to_string()),
        Kind::Time | Kind::SidedTime => text.push('t'),
        Kind::Variable(index) => {
            text.push(letter);
            text.push_str(&index.to_string());
        }
        Kind::Negation(inner) => bracketed(1, text, &|text| {
            text.push('-');
            write(inner, (letter, 1), text);
        }),
        Kind::Chain(first, operands) => {
            let additive = operands.first().is_some_and(|(operator, _)| operator.is_additive());
            let own = if additive { 1 } else { 2 };
            bracketed(own, text, &|text| {
                write(first, (letter, own - 1), text);
                for (operator, operand) in operands {
                    text.push_str(match operator {
                        Operator::Add => " + ",
                        Operator::Subtract => " - ",
                        Operator::Multiply => "*",
                        Operator::Divide => "/",
                    });
                    write(operand, (letter, own), text);
                }
            });
        }
        Kind::Power(sides) => bracketed(3, text, &|text| {
            write(&sides[0], (letter, 3), text);
            text.push('^');
            write(&sides[1], (letter, 3), text);
        }),
        Kind::Call(function, argument) => {
            text.push_str(function.name());
            text.push('(');
            write(argument, (letter, 0), text);
            text.push(')');
        }
        Kind::Choice(function, sides) => {
            text.push_str(function.name());
            text.push('(');
            write(&sides[0], (letter, 0), text);
            text.push_str(", ");
            write(&sides[1], (letter, 0), text);
            text.push(')');
        }
    }
}
