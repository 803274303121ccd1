//! Checks of forces of time before the run: those without an integral are refused, and a warning is given for
//! those that no node of the scheme resolves.

use crate::model::tape::{Singularity, Unbounded, terms};
use crate::model::{first_taken_in_part, first_unresolved, takes_moments};
use fvi_scenario::language::expression::{Expression, Kind, Node};
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Amplitude, ForceQuadrature, Scenario};

/// Refuses forces of time that are not integrable, and unbounded forces if the scheme can use neither their
/// integral nor their values.
///
/// # Errors
/// Names the key of the force, and the time.
pub(super) fn check(scenario: &Scenario) -> Result<(), InputError> {
    let refused = |key: &str, reason: String| Err(scenario.error_at(key, Problem::Unusable { reason }));
    for (key, expression) in expressions(scenario) {
        for singularity in unbounded(scenario, expression).flat_map(|unbounded| unbounded.found) {
            let Singularity { time, .. } = singularity;
            if !singularity.has_integral() {
                return refused(
                    &key,
                    format!(
                        "it grows like {} near t = {time}, where it has no impulse: no step could take it",
                        like(&singularity)
                    ),
                );
            }
            if !scenario.scheme_descriptor().takes_moments {
                return refused(
                    &key,
                    format!(
                        "it grows like {} near t = {time}; it has an impulse there, but this scheme looks at forces at its nodes alone: \
                         take \"collocation\", \"galerkin\" without Gauss weights or \"low-order\" with κ > 0",
                        like(&singularity)
                    ),
                );
            }
        }
    }
    Ok(())
}

/// Warnings about forces of time.
pub(super) fn warnings(scenario: &Scenario) -> Vec<String> {
    let mut warnings = Vec::new();
    let by_nodes = !takes_moments(scenario);
    // Moments are the default, and what they promise of jumps is not kept by the nodes of an accurate scheme.
    let scheme = scenario.scheme_descriptor();
    let in_part =
        by_nodes && scheme.order >= 2 && scenario.system.force_quadrature == ForceQuadrature::Moments;
    let seeing = if scheme.takes_moments {
        "shorter steps see it, and `system.force_quadrature` = \"moments\""
    } else {
        "shorter steps see it"
    };
    for (key, expression) in expressions(scenario) {
        for Unbounded { found, known_to } in unbounded(scenario, expression) {
            if let Some(time) = known_to {
                warnings
                    .push(format!("{key}: whether it has an impulse could be told up to t = {time} only"));
            }
            if let (true, Some(singularity)) = (by_nodes, found.first()) {
                warnings.push(format!(
                    "{key}: it grows like {} near t = {}, where the nodes of the scheme lose part of its impulse: \
                     `system.force_quadrature` = \"moments\" takes it in",
                    like(singularity),
                    singularity.time
                ));
            }
        }
        let depends = expression.root().varies();
        if by_nodes || depends {
            let mut functions = Vec::new();
            factors(expression.root(), &mut functions);
            let missed = |function: Node| {
                first_unresolved(scenario, &Amplitude::Expression(expression.with_root(function)))
            };
            if let Some(time) = functions.iter().cloned().find_map(missed) {
                let advice = if depends { "shorter steps or an adaptive grid see it" } else { seeing };
                warnings.push(narrow(&key, time, advice));
            } else if in_part
                && let Some(time) = functions.iter().find_map(|function| {
                    let function = Amplitude::Expression(expression.with_root(function.clone()));
                    first_taken_in_part(scenario, &function)
                })
            {
                warnings.push(inside(scenario, &key, time));
            }
        }
    }
    if by_nodes {
        let records = scenario.system.loads.iter().enumerate();
        for (index, load) in records.filter(|(_, load)| matches!(load.amplitude, Amplitude::Record(_))) {
            if let Some(time) = first_unresolved(scenario, &load.amplitude) {
                let key = format!("system.load[{index}].amplitude");
                warnings.push(narrow(&key, time, "shorter steps see them"));
            } else if in_part && let Some(time) = first_taken_in_part(scenario, &load.amplitude) {
                let key = format!("system.load[{index}].amplitude");
                warnings.push(inside(scenario, &key, time));
            }
        }
    }
    warnings
}

fn inside(scenario: &Scenario, key: &str, time: f64) -> String {
    let or_else =
        if scenario.is_mechanism() { "" } else { ", and so does \"galerkin\" without Gauss weights" };
    format!(
        "{key}: it jumps or bends inside the step from t = {time} on, where this scheme takes it at its nodes alone: a part of that \
         step's impulse is lost; a grid point there keeps it{or_else}"
    )
}

fn narrow(key: &str, time: f64, advice: &str) -> String {
    format!(
        "{key}: near t = {time} it does something between the nodes of the scheme that they do not see; {advice}"
    )
}

/// |t − c|^e in words.
fn like(singularity: &Singularity) -> String {
    let of = if singularity.time == 0.0 { "t".to_owned() } else { format!("|t − {}|", singularity.time) };
    match singularity.exponent() {
        exponent if exponent.is_infinite() => "no power of a distance".to_owned(),
        exponent if exponent > -0.2 => format!("a logarithm of {of}"),
        exponent => format!("{of}^({:.3})", exponent),
    }
}

/// Forces and amplitudes that are expressions, with their keys.
fn expressions(scenario: &Scenario) -> impl Iterator<Item = (String, &Expression)> {
    let force = scenario.system.force.iter().flatten().enumerate();
    let force = force.map(|(index, force)| (format!("system.force[{index}]"), force));
    let loads = scenario.system.loads.iter().enumerate();
    let loads = loads.map(|(index, load)| (format!("system.load[{index}].amplitude"), &load.amplitude));
    let cases = scenario.cases.iter().enumerate().flat_map(|(case, loads)| {
        let loads = loads.loads.iter().enumerate();
        loads.map(move |(index, load)| (format!("case[{case}].load[{index}].amplitude"), &load.amplitude))
    });
    let amplitudes = loads.chain(cases).filter_map(|(key, amplitude)| match amplitude {
        Amplitude::Expression(expression) => Some((key, expression)),
        Amplitude::Record(_) => None,
    });
    force.chain(amplitudes)
}

/// Unbounded terms of an expression among those that depend on time alone.
fn unbounded(scenario: &Scenario, expression: &Expression) -> impl Iterator<Item = Unbounded> {
    let run = [scenario.time.start, scenario.time.end()];
    let of_time = terms(expression.root()).into_iter().filter(|term| !term.varies());
    of_time.filter(move |_| run[1] > run[0]).map(move |term| Unbounded::of(&term, run))
}

/// The largest parts that depend on time alone.
fn factors(node: &Node, found: &mut Vec<Node>) {
    if !node.varies() {
        return found.push(node.clone());
    }
    match node.kind() {
        Kind::Number(_) | Kind::Time | Kind::SidedTime | Kind::Variable(_) => {}
        Kind::Negation(inner) | Kind::Call(_, inner) => factors(inner, found),
        Kind::Chain(first, operands) => {
            factors(first, found);
            operands.iter().for_each(|(_, operand)| factors(operand, found));
        }
        Kind::Power(sides) | Kind::Choice(_, sides) => sides.iter().for_each(|side| factors(side, found)),
    }
}
