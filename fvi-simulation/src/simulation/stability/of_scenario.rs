//! The stability check of a scenario's step.

use super::large::{self, check_large};
use super::{DampingForm, Discretisation, LinearDamping, LinearSystem, Verdict, check_stability};
use crate::model::Model;
use fvi_core::RungeKutta;
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::with_staged_method;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{DampedAt, Quadrature, Scenario, Scheme, SharedTerms, SymmetricMatrix, System};
use nalgebra::{DMatrix, DVector};

/// Refuses a step at which motions near the start grow, unless the scenario allows it. The Euler methods,
/// which are baselines with growing motions, are not checked.
///
/// `stiffness` and `resistance` are ∂²U/∂q² − ∂F/∂q and, if forces depend on the velocity, −∂F/∂v at the
/// start of the run.
pub(crate) fn check_step(
    scenario: &Scenario,
    (stiffness, resistance): (&DMatrix<f64>, Option<&DMatrix<f64>>),
) -> Result<(), InputError> {
    let Some(discretisation) = discretisation(scenario) else { return Ok(()) };
    // Adaptive steps are shortened by growing motions.
    if scenario.time.allow_unstable || scenario.time.adaptive().is_some() || may_drive(scenario) {
        return Ok(());
    }
    // Stable for any mass, or where nothing pushes: this avoids a Cholesky factor of a possibly large matrix,
    // and the eigenvalues of one number.
    let damped = !scenario.system.damping.is_empty();
    let without_push = || resistance.is_none() && pulls_back(&scenario.system, stiffness);
    if large::is_unconditional(&discretisation, damped)
        && (!scenario.system.massless().is_empty() || without_push())
    {
        return Ok(());
    }
    let damping = scenario.system.damping.iter().map(|term| LinearDamping {
        coefficients: dense(&term.coefficient),
        transfer: term.transfer.clone(),
    });
    let matrices = (stiffness, resistance);
    let system = LinearSystem::resisted(&dense(&scenario.system.mass), matrices, damping.collect()).map_err(
        |error| scenario.error_at("system.mass", Problem::Precision { reason: error.to_string() }),
    )?;
    match check_stability(&discretisation, &system, scenario.time.longest_step(), scenario.time.steps) {
        Verdict::Stable => Ok(()),
        Verdict::Unstable { largest_stable_step } => {
            let largest_step = largest_stable_step.map(three_digits_below);
            let advice = advice(&discretisation, largest_step.is_some());
            let key = if scenario.time.grid.is_some() { "time.grid" } else { "time.step" };
            Err(scenario.error_at(key, Problem::Unstable { largest_step, advice }))
        }
    }
}

/// True if masses, stiffness and damping are diagonal, and no coordinate is pushed away from where it is at
/// rest.
fn pulls_back(system: &System, stiffness: &DMatrix<f64>) -> bool {
    let SymmetricMatrix::Diagonal(masses) = &system.mass else { return false };
    let by_mass = |entries: &[f64]| {
        entries.iter().zip(masses).all(|(entry, mass)| *entry >= 0.0 && (entry / mass).is_finite())
    };
    let is_damping = |matrix: &SymmetricMatrix| match matrix {
        SymmetricMatrix::Diagonal(entries) => by_mass(entries),
        _ => false,
    };
    let mut entries = stiffness.iter().enumerate();
    let is_diagonal = entries.all(|(index, entry)| index % (masses.len() + 1) == 0 || *entry == 0.0);
    is_diagonal
        && by_mass(stiffness.diagonal().as_slice())
        && system.damping.iter().all(|term| is_damping(&term.coefficient))
}

/// As [`check_step`] for a system in the sparse space, by its fastest motions.
pub(crate) fn check_large_step(scenario: &Scenario) -> Result<(), InputError> {
    let Some(discretisation) = discretisation(scenario) else { return Ok(()) };
    let damped = !scenario.system.damping.is_empty();
    if scenario.time.allow_unstable
        || scenario.time.adaptive().is_some()
        || may_drive(scenario)
        || large::is_unconditional(&discretisation, damped)
    {
        return Ok(());
    }
    let mut model = Model::<f64>::new(scenario).map_err(|error| {
        scenario.error_at("system.mass", Problem::Precision { reason: error.to_string() })
    })?;
    match check_large(&discretisation, scenario, &mut model) {
        Verdict::Stable => Ok(()),
        Verdict::Unstable { largest_stable_step } => {
            let largest_step = largest_stable_step.map(three_digits_below);
            let advice = format!(
                "{}; `[scheme] kind` = \"low-order\", `kappa` = 0.5 with `[convolution] at` = \"nodes\", `order` = 2 is stable at \
                 every step",
                advice(&discretisation, largest_step.is_some())
            );
            Err(scenario.error_at("time.step", Problem::Unstable { largest_step, advice }))
        }
    }
}

/// True if no motion of the scenario grows at any step: a linear one with an unconditionally stable scheme.
pub(crate) fn is_unconditional(scenario: &Scenario) -> bool {
    let system = &scenario.system;
    let damped = !system.damping.is_empty();
    let linear = system.potential.is_none()
        && system.elements.is_empty()
        && system.force.is_none()
        && !system.own_terms.as_ref().is_some_and(SharedTerms::depend_on_position);
    linear
        && !may_drive(scenario)
        && discretisation(scenario).is_some_and(|scheme| large::is_unconditional(&scheme, damped))
}

/// True if no linear motion with gyroscopic forces grows at any step: for the midpoint rule, and without
/// damping for as many Gauss points as the degree, which is Gauss collocation.
pub(crate) fn takes_gyroscopic(scenario: &Scenario) -> bool {
    let damped = !scenario.system.damping.is_empty();
    let gauss = matches!(scenario.scheme, Scheme::Galerkin { degree, quadrature: Some(Quadrature::Gauss(points)) } if points == degree);
    let unconditional =
        discretisation(scenario).is_some_and(|scheme| large::is_unconditional(&scheme, damped));
    !may_drive(scenario) && (unconditional || (gauss && !damped))
}

/// True if a kernel is not passive: then motions may grow at any step.
fn may_drive(scenario: &Scenario) -> bool {
    scenario.system.damping.iter().any(|term| term.active().is_some())
}

/// Advice for a scheme whose step is too long.
fn advice(discretisation: &Discretisation, shorter: bool) -> String {
    let mut ways = Vec::new();
    if shorter {
        ways.push("a shorter `time.step`");
    }
    match &discretisation.form {
        DampingForm::MainNodes { rule } | DampingForm::Nodes { rule } if !rule.is_passive() => {
            ways.push("a lower `convolution.order`");
        }
        DampingForm::Stages { matrix } if discretisation.degree == matrix.nrows() => {
            ways.push("a lower `scheme.degree`");
        }
        _ => {}
    }
    let runs = "set `time.allow_unstable = true` to run anyway";
    if ways.is_empty() { runs.to_owned() } else { format!("take {}, or {runs}", ways.join(" or ")) }
}

/// A positive number rounded down to three digits.
fn three_digits_below(number: f64) -> f64 {
    let unit = libm::exp10(libm::log10(number).floor() - 2.0);
    (number / unit).floor() * unit
}

fn dense(matrix: &SymmetricMatrix) -> DMatrix<f64> {
    match matrix {
        SymmetricMatrix::Diagonal(entries) => DMatrix::from_diagonal(&DVector::from_column_slice(entries)),
        SymmetricMatrix::Dense(entries) => entries.clone(),
        SymmetricMatrix::Sparse(entries) => {
            let mut dense = DMatrix::zeros(entries.size(), entries.size());
            for (row, slots) in entries.pattern.rows().enumerate() {
                for slot in slots {
                    dense[(row, entries.pattern.columns()[slot] as usize)] = entries.values[slot];
                }
            }
            dense
        }
    }
}

/// The scheme of a scenario; `None` for the Euler methods, for collocation, which is L-stable, for the energy
/// scheme, and for invalid combinations.
pub(crate) fn discretisation(scenario: &Scenario) -> Option<Discretisation> {
    let (degree, kappa) = match scenario.scheme {
        Scheme::LowOrder { kappa } => (1, Some(kappa)),
        Scheme::Galerkin { degree, .. } => (degree, None),
        Scheme::Collocation | Scheme::Energy | Scheme::ExplicitEuler | Scheme::ImplicitEuler => return None,
    };
    let (form, rule) = match scenario.convolution.family.multistep().ok()? {
        Some(multistep) => {
            let nodes = match kappa {
                Some(kappa) => (vec![1.0 - kappa], vec![1.0]),
                None => rule(scenario.scheme.quadrature()?)?,
            };
            let form = match scenario.convolution.at {
                DampedAt::MainNodes => DampingForm::MainNodes { rule: multistep },
                DampedAt::Nodes => DampingForm::Nodes { rule: multistep },
            };
            (form, nodes)
        }
        None => stages_of_family(scenario.convolution.family)?,
    };
    let (nodes, weights) = rule;
    Some(Discretisation { degree, nodes, weights, form })
}

/// Fractions of a step at which the scheme of a scenario evaluates forces.
pub(crate) fn force_nodes(scenario: &Scenario) -> Vec<f64> {
    let stages = || match scenario.scheme {
        Scheme::Collocation => stages_of_family(scenario.convolution.family).map(|(_, (nodes, _))| nodes),
        _ => None,
    };
    let nodes = discretisation(scenario).map(|scheme| scheme.nodes);
    nodes.or_else(stages).unwrap_or_else(|| vec![0.0, 1.0])
}

/// The stages of a Runge–Kutta family.
pub(crate) fn stages_of_family(family: ConvolutionFamily) -> Option<(DampingForm, Rule)> {
    with_staged_method!(family.staged()?, method => stages_of(&method)).ok()
}

/// Nodes and weights of a quadrature.
pub(crate) type Rule = (Vec<f64>, Vec<f64>);

fn stages_of<const R: usize>(method: &RungeKutta<R>) -> (DampingForm, Rule) {
    let matrix = DMatrix::from_fn(R, R, |i, j| method.matrix()[i][j]);
    (DampingForm::Stages { matrix }, nodes_and_weights(method.quadrature()))
}

fn nodes_and_weights<const Q: usize>(rule: &fvi_core::Quadrature<Q>) -> Rule {
    (rule.nodes().to_vec(), rule.weights().to_vec())
}

fn rule(quadrature: Quadrature) -> Option<Rule> {
    macro_rules! of_points {
        ($rule:ident, $points:expr, $($q:literal)*) => {
            match $points {
                $($q => fvi_core::Quadrature::<$q>::$rule().ok().map(|rule| nodes_and_weights(&rule)),)*
                _ => None,
            }
        };
    }
    match quadrature {
        Quadrature::Gauss(points) => of_points!(gauss, points, 1 2 3 4 5 6),
        Quadrature::Lobatto(points) => of_points!(lobatto, points, 2 3 4 5 6 7),
    }
}
