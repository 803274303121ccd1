//! Forces of time that are unbounded but integrable, separated from those that the nodes of a scheme
//! evaluate.

use super::scenario_loads::{loads, takes_moments};
use super::scheme::AnyScheme;
use super::tape::{Singularity, Unbounded, terms};
use fvi_scenario::language::expression::{Expression, Node, Operator};
use fvi_scenario::scenario::{Amplitude, Load, Scenario, Scheme};
use std::ops::Range;

/// Separated terms.
#[derive(Clone, Debug)]
pub(crate) struct UnboundedForces {
    /// The scenario without these terms.
    pub(crate) rest: Scenario,
    /// One expression for each coordinate, and the singularities.
    pub(crate) force: Option<(Vec<Expression>, Vec<Singularity>)>,
    /// Loads with the motions that they act on, and their singularities.
    pub(crate) loads: Vec<(Load, Range<usize>, Vec<Singularity>)>,
}

/// Exponents, at t = 0 and elsewhere, above which exact moment corrections suffice: the double-exponential
/// rule is accurate for them.
const MILD: [f64; 2] = [-0.5 - 1e-9, -0.2];

impl UnboundedForces {
    /// `None` if there is no such term, or the scheme does not support moments.
    pub(crate) fn of(scenario: &Scenario) -> Option<Self> {
        let components = scenario.system.force.as_deref().unwrap_or_default();
        let is_forced = !components.is_empty() || loads(scenario).next().is_some();
        if !is_forced || !takes_moments(scenario) {
            return None;
        }
        let (run, touched) = ([scenario.time.start, scenario.time.end()], touched(scenario));
        let split = |expression: &Expression| split(expression, run, touched);
        let split_components: Vec<_> = components.iter().map(split).collect();
        let split_loads: Vec<_> = loads(scenario)
            .map(|(load, motions)| match &load.amplitude {
                Amplitude::Expression(amplitude) => split(amplitude).map(|parts| (load, motions, parts)),
                Amplitude::Record(_) => None,
            })
            .collect();
        if split_components.iter().all(Option::is_none) && split_loads.iter().all(Option::is_none) {
            return None;
        }
        let mut rest = scenario.clone();
        let mut force = None;
        if split_components.iter().any(Option::is_some) {
            let (mut whole, mut singularities) = (Vec::new(), Vec::new());
            let mut left = Vec::new();
            for (component, parts) in components.iter().zip(split_components) {
                let (taken, remaining, times) = parts.unwrap_or_else(|| {
                    (component.with_root(Node::number(0.0)), component.clone(), Vec::new())
                });
                whole.push(taken);
                left.push(remaining);
                singularities.extend(times);
            }
            rest.system.force = Some(left);
            force = Some((whole, singularities));
        }
        let shared = rest.system.loads.iter_mut();
        let of_cases = rest.cases.iter_mut().flat_map(|case| case.loads.iter_mut());
        let mut whole_loads = Vec::new();
        for (place, parts) in shared.chain(of_cases).zip(split_loads) {
            let Some((load, motions, (taken, remaining, times))) = parts else { continue };
            place.amplitude = Amplitude::Expression(remaining);
            whole_loads.push((
                Load { amplitude: Amplitude::Expression(taken), ..load.clone() },
                motions,
                times,
            ));
        }
        Some(Self { rest, force, loads: whole_loads })
    }
}

/// True if the nodes of a scenario's scheme include the beginning of a step, and any of its ends.
fn touched(scenario: &Scenario) -> [bool; 2] {
    if scenario.scheme == Scheme::Collocation {
        return [true; 2];
    }
    let scheme = AnyScheme::<f64>::new(scenario).ok();
    let has = |node: f64| scheme.as_ref().is_some_and(|scheme| scheme.view().nodes.contains(&node));
    [has(0.0), has(0.0) || has(1.0)]
}

/// The terms of an expression to be separated, the remaining expression, and the times of the singularities.
fn split(
    expression: &Expression,
    run: [f64; 2],
    touched: [bool; 2],
) -> Option<(Expression, Expression, Vec<Singularity>)> {
    let (mut taken, mut left, mut times) = (Vec::new(), Vec::new(), Vec::new());
    for term in terms(expression.root()) {
        let found = if term.varies() { Vec::new() } else { Unbounded::of(&term, run).found };
        let is_strong = |singularity: &Singularity| {
            let is_later = usize::from(singularity.time > run[0]);
            touched[is_later] || singularity.exponent() < MILD[usize::from(singularity.time != 0.0)]
        };
        if found.iter().all(Singularity::has_integral) && found.iter().any(is_strong) {
            taken.push(term);
            times.extend(found);
        } else {
            left.push(term);
        }
    }
    let sum = |terms: Vec<Node>| terms.into_iter().reduce(|sum, term| Node::join(Operator::Add, sum, term));
    let taken = sum(taken)?;
    let left = sum(left).unwrap_or_else(|| Node::number(0.0));
    Some((expression.with_root(taken), expression.with_root(left), times))
}
