//! Detection of functions of time that the nodes of a scheme miss.

use super::force_moments::{ForceMoments, StepLengths};
use super::scheme::AnyScheme;
use super::signal_moments::SignalMoments;
use fvi_core::NodalRule;
use fvi_scenario::language::expression::{Expression, Moment};
use fvi_scenario::scenario::{Amplitude, Record, Scenario, TimeGrid};

/// Largest number of checks of ranges and steps.
const MOST_LOOKS: usize = 20_000;

/// Fraction, of the force and of the values at the surrounding nodes, above which a difference counts as
/// missed: most of a force, or the part that a jump inside a step leaves, and in schemes of a higher order a
/// kink.
const MOST: f64 = 0.3;
const AT_A_JUMP: f64 = 0.02;
const AT_A_KINK: f64 = 1e-3;

/// Number of steps on either side that are examined.
const BESIDE: usize = 4;

/// The first time near which the nodes of a scenario's scheme miss most of a function of time; `None` if
/// there is none, or steps are chosen during the run.
pub(crate) fn first_unresolved(scenario: &Scenario, function: &Amplitude) -> Option<f64> {
    first_beyond(MOST, scenario, function)
}

/// The first time near which the nodes miss a part of it, as at a jump or a kink inside a step.
pub(crate) fn first_taken_in_part(scenario: &Scenario, function: &Amplitude) -> Option<f64> {
    let share = if scenario.scheme_descriptor().order > 2 { AT_A_KINK } else { AT_A_JUMP };
    first_beyond(share, scenario, function)
}

fn first_beyond(share: f64, scenario: &Scenario, function: &Amplitude) -> Option<f64> {
    let time = &scenario.time;
    if time.adaptive().is_some() || time.steps == 0 {
        return None;
    }
    let scheme = AnyScheme::<f64>::new(scenario).ok()?;
    let (weights, nodes) = (scheme.view().weights.to_vec(), scheme.view().nodes.to_vec());
    let mut nodes = Nodes { time, weights, nodes, share, looks: 0 };
    match function {
        Amplitude::Expression(expression) => nodes.first_of_expression(expression),
        Amplitude::Record(record) => nodes.first_of_record(record),
    }
}

struct Nodes<'s> {
    time: &'s TimeGrid,
    weights: Vec<f64>,
    nodes: Vec<f64>,
    /// The share above which an impulse counts as missed.
    share: f64,
    looks: usize,
}

impl Nodes<'_> {
    fn first_of_expression(&mut self, expression: &Expression) -> Option<f64> {
        let (end, longest) = (self.time.end(), self.time.longest_step());
        let components = [expression.clone()];
        let mut moments = ForceMoments::new(&components, StepLengths::Any, (end, Some(longest)))?;
        let mut cells = vec![(0.0, end)];
        while let Some((from, to)) = cells.pop() {
            self.looks += 1;
            if self.looks > MOST_LOOKS {
                return None;
            }
            if moments.is_smooth_cell((from, to), longest) {
                continue;
            }
            if to - from > 4.0 * longest {
                let middle = 0.5 * (from + to);
                cells.extend([(middle, to), (from, middle)]);
                continue;
            }
            let first = self.step_at(from);
            for step in (first..self.time.steps).take_while(|&step| self.time.time(step) < to) {
                let value = |moment: Moment<f64>| expression.value(moment, &[]).abs();
                if self.misses(step, value, |rule| {
                    moments
                        .moment_correction(rule)
                        .map(|moment_correction| moment_correction[0] + moment_correction[1])
                }) {
                    return Some(self.time.time(step));
                }
            }
        }
        None
    }

    fn first_of_record(&mut self, record: &Record) -> Option<f64> {
        let mut moments = SignalMoments::new(record.clone());
        let mut before = None;
        for &(time, _) in record.rows() {
            let step = self.step_at(time);
            if time < 0.0 || step >= self.time.steps || before == Some(step) {
                continue;
            }
            before = Some(step);
            self.looks += 1;
            if self.looks > 10 * MOST_LOOKS {
                return None;
            }
            let value = |moment: Moment<f64>| record.at(moment).abs();
            if self.misses(step, value, |rule| {
                moments
                    .moment_correction(rule)
                    .map(|moment_correction| moment_correction[0] + moment_correction[1])
            }) {
                return Some(self.time.time(step));
            }
        }
        None
    }

    /// The step that contains a time.
    fn step_at(&self, time: f64) -> usize {
        let (mut low, mut high) = (0, self.time.steps);
        while low < high {
            let middle = low.midpoint(high);
            if self.time.time(middle + 1) <= time { low = middle + 1 } else { high = middle }
        }
        low
    }

    /// True if the nodes of a step miss more than that share of the force's impulse over it.
    fn misses(
        &mut self,
        step: usize,
        value: impl Fn(Moment<f64>) -> f64,
        moment_correction: impl FnOnce(&NodalRule<'_, f64>) -> Option<f64>,
    ) -> bool {
        self.looks += 1;
        let (start, length) = (self.time.time(step), self.time.time(step + 1) - self.time.time(step));
        // ∫F is the nodes' sum plus the corrections of both moments on a straight line.
        let tests: Vec<f64> = self.nodes.iter().map(|node| 1.0 - node).collect();
        let rule = NodalRule {
            start,
            length,
            weights: &self.weights,
            nodes: &self.nodes,
            points: &[1.0],
            shapes: &self.nodes,
            tests: &tests,
        };
        let Some(missed) = moment_correction(&rule) else { return false };
        let seen = |step: usize| -> f64 {
            let (start, length) = (self.time.time(step), self.time.time(step + 1) - self.time.time(step));
            let at = |node: f64| match node {
                0.0 => Moment::from_right(start),
                1.0 => Moment::from_left(start + length),
                _ => Moment::inside(start + node * length),
            };
            self.nodes.iter().zip(&self.weights).map(|(&node, weight)| weight * value(at(node))).sum()
        };
        let beside = step.saturating_sub(BESIDE)..(step + BESIDE + 1).min(self.time.steps);
        let around: f64 = beside.map(seen).sum();
        missed.abs() > self.share * (around + missed.abs())
    }
}
