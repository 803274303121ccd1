//! Kinks of forces in the velocity, at which adaptive steps end.

use super::Simulation;
use super::crossings::{first_zero, looks};
use fvi_core::min_or_nan;
use fvi_scenario::language::expression::{Expression, Function, Kind, Moment, Node, Operator};
use fvi_scenario::scenario::Scenario;

/// Distance for differences of the position, as a part of the pair.
const APART: f64 = 1e-5;

/// A crossing counts as met at this fraction of the pair times √tolerance: what the wrong side changes there
/// is of second order.
const NEAR: f64 = 0.03;

/// Arguments g(t, q, v) of `abs`, and differences of the two of `min` and `max`, in forces of the velocity:
/// where one is zero the force has a kink.
///
/// A kink before the first node of a pair or behind its last one is seen by no difference of a whole step and
/// its halves, since the forces are those of one side at all nodes. So pairs end there. Nothing slides along
/// a kink, unlike a jump, and the side that follows from it is that of the motion. Where forces jump with a
/// velocity, as those of dampers that hold a mass, it may be crossed to and fro, and no pairs end there.
pub(super) struct VelocityKinks {
    arguments: Vec<Expression>,
    /// 0.03 √tolerance.
    near: f64,
    variables: Vec<f64>,
    position: [Vec<f64>; 2],
}

impl VelocityKinks {
    /// Those of the forces of a scenario with adaptive steps; `None` if there are none.
    pub(super) fn of(scenario: &Scenario) -> Option<Self> {
        let rule = scenario.time.adaptive().filter(|_| !scenario.jumps_with_velocities())?;
        let (size, mut arguments) = (scenario.coordinates(), Vec::new());
        for component in scenario.system.force.iter().flatten() {
            collect(component.root(), size, &mut |argument| arguments.push(component.with_root(argument)));
        }
        let near = NEAR * libm::sqrt(rule.tolerance);
        let (variables, position) = (Vec::new(), [Vec::new(), Vec::new()]);
        (!arguments.is_empty()).then_some(Self { arguments, near, variables, position })
    }

    /// The first time inside a finished pair at which one is crossed, away from both of its ends.
    pub(super) fn first_inside(&mut self, simulation: &mut Simulation, pair: [f64; 3]) -> Option<f64> {
        let [begin, _, end] = pair;
        let near = self.near * (end - begin);
        let mut times: Vec<f64> = looks(pair).collect();
        times[0] = begin + near;
        if let Some(last) = times.last_mut() {
            *last = end - near;
        }
        let mut first = f64::INFINITY;
        for index in 0..self.arguments.len() {
            let mut at = |time: f64| self.value(simulation, index, (time, pair));
            let values: Vec<f64> = times.iter().map(|&time| at(time)).collect();
            let Some(from) = values.iter().position(|&value| value != 0.0) else { continue };
            let side = values[from].signum();
            let inside: Vec<f64> = values.iter().map(|value| side * value).collect();
            if let Some(time) = first_zero(&mut |time| side * at(time), &times, &inside, from) {
                first = min_or_nan(first, time);
            }
        }
        first.is_finite().then_some(first)
    }

    /// An argument at a time inside the pair.
    fn value(&mut self, simulation: &mut Simulation, index: usize, place: (f64, [f64; 3])) -> f64 {
        motion_at(simulation, place, &mut self.position, &mut self.variables);
        self.arguments[index].value(Moment::inside(place.0), &self.variables)
    }
}

/// Writes position and velocity at a time inside a finished pair, the velocity by differences.
pub(super) fn motion_at(
    simulation: &mut Simulation,
    (time, [begin, middle, end]): (f64, [f64; 3]),
    [before, after]: &mut [Vec<f64>; 2],
    motion: &mut Vec<f64>,
) {
    // The polynomial is another one on each half.
    let [from, to] = if time > middle { [middle, end] } else { [begin, middle] };
    let apart = APART * (to - from);
    let times = [(time - apart).max(from + 0.1 * apart), (time + apart).min(to)];
    simulation.position_at(times[0], before);
    simulation.position_at(times[1], after);
    let part = (time - times[0]) / (times[1] - times[0]);
    let between = before.iter().zip(&*after);
    motion.clear();
    motion.extend(between.clone().map(|(before, after)| before + part * (after - before)));
    motion.extend(between.map(|(before, after)| (after - before) / (times[1] - times[0])));
}

/// Passes the arguments of the kinks of an expression that depend on a velocity, the variables from `first`
/// on.
fn collect(node: &Node, first: usize, take: &mut dyn FnMut(Node)) {
    match node.kind() {
        Kind::Number(_) | Kind::Time | Kind::SidedTime | Kind::Variable(_) => {}
        Kind::Negation(inner) => collect(inner, first, take),
        Kind::Call(function, argument) => {
            if *function == Function::Abs && argument.has_variable_from(first) {
                take((**argument).clone());
            }
            collect(argument, first, take);
        }
        Kind::Choice(function, sides) => {
            let [left, right] = sides.as_ref();
            if function.selects() && node.has_variable_from(first) {
                take(Node::join(Operator::Subtract, left.clone(), right.clone()));
            }
            [left, right].into_iter().for_each(|side| collect(side, first, take));
        }
        Kind::Chain(head, operands) => {
            collect(head, first, take);
            operands.iter().for_each(|(_, operand)| collect(operand, first, take));
        }
        Kind::Power(sides) => sides.iter().for_each(|side| collect(side, first, take)),
    }
}
