//! Resolution of functions of time by steps of a given length.

use super::derivative::Order;
use super::enclosure::Enclosure;
use super::force::{Parts, parts};
use super::graph::Graph;
use super::program::Program;
use super::rough::linear;
use fvi_core::max_or_nan;
use fvi_scenario::language::expression::{Expression, Kind, Moment, Node, Operator};

/// The terms of forces that depend on time alone, treated separately, so that a small term is not hidden by a
/// large one.
#[derive(Clone, Debug)]
pub struct TimeTerms {
    terms: Vec<Term>,
    end: f64,
    /// Size below which a term is neglected: [`NEGLIGIBLE`] of the mean of Σ |f|.
    floor: f64,
    /// A lower bound of ∫ Σ |f| over the run.
    impulse: f64,
    registers: Vec<f64>,
}

/// A single term.
#[derive(Clone, Debug)]
pub(super) struct Term {
    node: Node,
    value: Program<f64>,
}

/// Fraction of the impulse that may be lost.
const NEGLIGIBLE: f64 = 1e-10;

/// Number of pieces from which the impulse is estimated.
const PIECES: usize = 160;

/// A term is resolved by nodes at distance h if h²/24 |f″|, the error of the midpoint rule for its mean, is
/// at most this fraction of the sum of |f| over nine steps.
const MISSED: f64 = 0.01;

/// Number of steps on either side that are included in this sum.
const BESIDE: i32 = 4;

/// The same criterion within a piece of a step, relative to the largest |f|, for a quadrature of 15 nodes.
const MISSED_IN_PIECE: f64 = 0.5;

/// An adaptive step is divided into eighths to find peaks of f between its nodes. There is none if f, between
/// neighbouring points, differs from the straight line through them by at most this fraction of its largest
/// |f|.
const BETWEEN_EIGHTHS: f64 = 0.125;

/// Largest number of checks of a proposed step.
const MOST_LOOKS: usize = 400;

impl TimeTerms {
    /// The terms of the part of a force that depends on time alone, over a run to `end`; `None` if it is
    /// linear in t.
    pub fn of(components: &[Expression], end: f64) -> Option<Self> {
        let mut nodes = Vec::new();
        for component in components {
            if let Parts::Affine { of_time: Some(node), .. } = parts(component.root()) {
                add_terms(&node, &mut nodes);
            }
        }
        Self::compile(nodes, end)
    }

    /// The largest parts of these expressions, at any depth, that depend on time alone.
    pub fn anywhere_in<'e>(expressions: impl IntoIterator<Item = &'e Expression>, end: f64) -> Option<Self> {
        let mut nodes = Vec::new();
        for expression in expressions {
            factors_of_time(expression.root(), &mut nodes);
        }
        Self::compile(nodes, end)
    }

    fn compile(mut nodes: Vec<Node>, end: f64) -> Option<Self> {
        nodes.retain(|node| linear(node).is_none());
        if nodes.is_empty() || end <= 0.0 {
            return None;
        }
        let terms = nodes.into_iter().map(Term::new).collect();
        let mut all = Self { terms, end, floor: 0.0, impulse: 0.0, registers: Vec::new() };
        all.impulse = all.least_impulse();
        all.floor = NEGLIGIBLE * all.impulse / end;
        Some(all)
    }

    /// Number of terms.
    pub fn count(&self) -> usize {
        self.terms.len()
    }

    /// The terms as trees.
    pub fn nodes(&self) -> impl Iterator<Item = &Node> {
        self.terms.iter().map(|term| &term.node)
    }

    /// A lower bound of ∫ Σ |f|, by refining the pieces with the least accurate bounds.
    fn least_impulse(&self) -> f64 {
        let piece = |index: usize, from: f64, to: f64| {
            let value = Enclosure::of(&self.terms[index].node, from, to).value;
            let (least, most) = ((to - from) * value.mignitude(), (to - from) * value.magnitude());
            (index, from, to, least, most - least)
        };
        let mut pieces: Vec<_> = (0..self.terms.len()).map(|index| piece(index, 0.0, self.end)).collect();
        for _ in 0..PIECES {
            let least: f64 = pieces.iter().map(|piece| piece.3).sum();
            let unknown: f64 = pieces.iter().map(|piece| piece.4).sum();
            let widest = (0..pieces.len()).max_by(|&a, &b| pieces[a].4.total_cmp(&pieces[b].4));
            let Some(widest) = widest.filter(|_| unknown > least) else { break };
            let (index, from, to, ..) = pieces[widest];
            let middle = 0.5 * (from + to);
            pieces[widest] = piece(index, from, middle);
            pieces.push(piece(index, middle, to));
        }
        pieces.iter().map(|piece| piece.3).sum()
    }

    /// True if nodes at distance `step` resolve every term all over a range of several steps.
    pub fn is_described(&mut self, (from, to): (f64, f64), step: f64) -> bool {
        let Self { terms, floor, registers, .. } = self;
        terms.iter().all(|term| {
            let bounds = Enclosure::of(&term.node, from, to);
            bounds.value.magnitude() <= *floor
                || (bounds.bend.is_finite() && {
                    let largest = largest(term, (from, to), 8, registers);
                    step * step / 24.0 * bounds.bend.magnitude() <= 2.5 * MISSED * largest
                })
        })
    }

    /// The same within a step, including the steps before and after it. A term may jump within `slack` of its
    /// ends.
    pub fn is_described_in_step(&mut self, start: f64, length: f64, slack: f64) -> bool {
        let Self { terms, floor, end, registers, .. } = self;
        let beside = |steps: i32| start + length * f64::from(steps);
        terms.iter().all(|term| {
            let enclosure = |start: f64| Enclosure::of(&term.node, start + slack, start + length - slack);
            let mut bends_little = |start: f64, bend: f64| {
                let sum: f64 = (-BESIDE..=BESIDE)
                    .map(|steps| start + length * (0.5 + f64::from(steps)))
                    .filter(|time| (0.0..=*end).contains(time))
                    .map(|time| term.at(time, registers).abs())
                    .filter(|value| value.is_finite())
                    .sum();
                length * length / 24.0 * bend <= MISSED * sum
            };
            let own = enclosure(start);
            if own.value.magnitude() <= *floor {
                return true;
            }
            own.bend.is_finite()
                && bends_little(start, own.bend.magnitude())
                // The tail of a narrow peak in a neighbouring step belongs to that step.
                && (-BESIDE..=BESIDE).map(beside).filter(|&start| start >= 0.0).all(|start| {
                    let other = enclosure(start);
                    let counts =
                        other.value.magnitude() > own.value.magnitude() && other.bend.is_finite();
                    !counts || bends_little(start, other.bend.magnitude())
                })
        })
    }

    /// True if a quadrature of many nodes resolves every term within a piece of a step. A term may jump
    /// within `slack` of its ends.
    pub fn is_described_in_piece(&mut self, from: f64, to: f64, slack: f64) -> bool {
        let (from, to) = (from + slack, to - slack);
        let Self { terms, floor, registers, .. } = self;
        from >= to
            || terms.iter().all(|term| {
                let bounds = Enclosure::of(&term.node, from, to);
                let length = to - from;
                bounds.value.magnitude() <= *floor
                    || (bounds.bend.is_finite() && {
                        let largest = largest(term, (from, to), 2, registers);
                        length * length / 24.0 * bounds.bend.magnitude() <= MISSED_IN_PIECE * largest
                    })
            })
    }

    /// The end, at most `to`, of the longest step from `from` whose nodes would not miss a contribution of
    /// more than `tolerance` of the impulse.
    pub fn reach(&mut self, from: f64, to: f64, tolerance: f64) -> f64 {
        const SEARCHES: usize = 12;
        let floor = self.floor.max(0.01 * tolerance * self.impulse / self.end);
        if self.is_visible(from, to, floor) {
            return to;
        }
        // The longest step known to be acceptable, if any.
        let (mut good, mut bad) = (from, to);
        let mut shorter = 0;
        while good == from && shorter < 40 {
            let middle = from + 0.5 * (bad - from);
            if self.is_visible(from, middle, floor) {
                good = middle
            } else {
                bad = middle
            }
            shorter += 1;
        }
        for _ in 0..SEARCHES {
            let middle = 0.5 * (good + bad);
            if self.is_visible(from, middle, floor) { good = middle } else { bad = middle }
        }
        if good > from { good } else { to }
    }

    /// True if the eighths of a step resolve every term.
    fn is_visible(&mut self, from: f64, to: f64, floor: f64) -> bool {
        let Self { terms, registers, .. } = self;
        let eighth = 0.125 * (to - from);
        // Rough points are at the ends only.
        let slack = 8.0 * f64::EPSILON * to.abs();
        terms.iter().all(|term| {
            let mut seen = None;
            // An integrable pole is at an end, and its impulse is computed separately.
            let is_pole = |low: f64, high: f64| !Enclosure::of(&term.node, low, high).value.is_finite();
            let poles = [is_pole(from, from + eighth), is_pole(to - eighth, to)];
            let mut parts: Vec<_> = (0..8)
                .rev()
                .map(|part| (from + f64::from(part) * eighth, from + f64::from(part + 1) * eighth))
                .collect();
            parts[7].0 += slack;
            parts[0].1 -= slack;
            let mut looks = 0;
            while let Some((low, high)) = parts.pop() {
                looks += 1;
                if looks > MOST_LOOKS {
                    return false;
                }
                if high <= low {
                    continue;
                }
                let bounds = Enclosure::of(&term.node, low, high);
                if bounds.value.magnitude() <= floor {
                    continue;
                }
                let seen = *seen.get_or_insert_with(|| largest(term, (from, to), 8, registers));
                if bounds.bend.is_finite()
                    && 0.125 * eighth * eighth * bounds.bend.magnitude() <= BETWEEN_EIGHTHS * seen
                {
                    continue;
                }
                if (poles[0] && high <= from + eighth) || (poles[1] && low >= to - eighth) {
                    continue;
                }
                // Towards a root the second derivative is unbounded.
                if high - low < eighth / 4096.0 {
                    if bounds.value.magnitude() <= 4.0 * seen {
                        continue;
                    }
                    return false;
                }
                let middle = 0.5 * (low + high);
                parts.push((middle, high));
                parts.push((low, middle));
            }
            true
        })
    }
}

impl Term {
    pub(super) fn new(node: Node) -> Self {
        let mut graph = Graph::default();
        let value = graph.differentiate(&node, Order::Value).value;
        Self { value: Program::new(&graph, 0, &[(0, value)], &[]), node }
    }

    pub(super) fn at(&self, time: f64, registers: &mut Vec<f64>) -> f64 {
        let mut value = [0.0];
        self.value.evaluate(Moment::inside(time), &[], registers, &mut value, &mut []);
        value[0]
    }
}

/// The largest |f| at `parts` equidistant points of a range.
fn largest(term: &Term, (from, to): (f64, f64), parts: u32, registers: &mut Vec<f64>) -> f64 {
    (0..=parts)
        .map(|part| term.at(from + (to - from) * f64::from(part) / f64::from(parts), registers).abs())
        .filter(|value| value.is_finite())
        .fold(0.0, max_or_nan)
}

/// The terms of a sum.
pub fn terms(node: &Node) -> Vec<Node> {
    let mut found = Vec::new();
    add_terms(node, &mut found);
    found
}

fn add_terms(node: &Node, terms: &mut Vec<Node>) {
    match node.kind() {
        Kind::Chain(first, operands)
            if operands.first().is_some_and(|(operator, _)| operator.is_additive()) =>
        {
            add_terms(first, terms);
            for (operator, operand) in operands {
                let from = terms.len();
                add_terms(operand, terms);
                if *operator == Operator::Subtract {
                    for term in &mut terms[from..] {
                        *term = Node::negation(term.clone());
                    }
                }
            }
        }
        Kind::Negation(inner) => {
            let from = terms.len();
            add_terms(inner, terms);
            for term in &mut terms[from..] {
                *term = Node::negation(term.clone());
            }
        }
        _ => terms.push(node.clone()),
    }
}

/// The largest parts that depend on time alone; for a sum or product that does not, those of its operands.
fn factors_of_time(node: &Node, found: &mut Vec<Node>) {
    if !node.varies() {
        return add_terms(node, found);
    }
    match node.kind() {
        Kind::Number(_) | Kind::Time | Kind::SidedTime | Kind::Variable(_) => {}
        Kind::Negation(inner) | Kind::Call(_, inner) => factors_of_time(inner, found),
        Kind::Chain(first, operands) => {
            factors_of_time(first, found);
            operands.iter().for_each(|(_, operand)| factors_of_time(operand, found));
        }
        Kind::Power(sides) | Kind::Choice(_, sides) => {
            sides.iter().for_each(|side| factors_of_time(side, found));
        }
    }
}
