//! Choice of the dense or the sparse space for a scenario.

use crate::model::{AnyScheme, AnySpace, Elimination, Matrix, Model, StagePair, matrix};
use fvi_core::Mechanics;
use fvi_scenario::language::memory_limit::available_memory;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Scenario, Scheme, SharedTerms};
use serde::Serialize;

/// Solver of the equations of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Solver {
    /// By elimination in a full matrix, or within its band.
    Dense,
    /// By a sparse Cholesky factor.
    Sparse {
        /// Structurally nonzero places in the matrix of a step.
        places: usize,
        /// Bytes of its factor.
        factor_bytes: usize,
    },
}

/// Choice of a solver by the caller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SolverChoice {
    /// Sparse for large systems, dense for small ones.
    #[default]
    Automatic,
    /// Dense.
    Dense,
    /// Sparse.
    Sparse,
}

/// Number of coordinates from which the sparse factor is faster.
const MANY: usize = 128;

/// Number of coordinates from which it is faster for matrices from files with a sparse factor: a step with
/// full matrices takes N² operations, and its check the eigenvalues of N × N matrices.
const SEVERAL: usize = 32;

/// Largest fraction of N² entries of a factor for up to [`MANY`] coordinates.
const SMALL: f64 = 0.25;

/// Largest number of coordinates times nodes for a full matrix, which takes 8 n² bytes.
const MOST_DENSE: usize = 6_000;

/// Number of unknowns of a step from which a warning about full matrices is given.
const SLOW: usize = 300;

/// The schemes with sparse factors, beginning with the one that is stable at every step.
const SPARSE_SCHEMES: &str = "there are sparse factors for `kind` = \"low-order\" with `[convolution] at` = \"nodes\", `order` = 2, \
     and for \"galerkin\" of `degree` = 2 on two Gauss points with `[convolution] family` = \"bdf\", `order` = 3 or 4";

/// Warning about full matrices of many coordinates: the reason, and how to avoid them.
pub(super) fn dense_warning(scenario: &Scenario) -> Option<String> {
    let (degree, coordinates) = (scenario.scheme_descriptor().unknowns, scenario.coordinates());
    let owned = scenario.system.own_terms.as_ref().is_some_and(SharedTerms::are_full);
    let collocation = scenario.scheme == Scheme::Collocation;
    if coordinates.saturating_mul(degree) < SLOW {
        return None;
    }
    let (key, why, instead) = if owned {
        let instead = "a potential whose pattern or sparse Hessian is known, expressions in `[[system.element]]` and functions of t alone leave \
             the matrices sparse";
        (
            "system",
            "the functions take the position or the velocity, so that their derivatives may be full",
            instead,
        )
    } else if !scenario.system.is_large() {
        return None;
    } else if scenario.system.force.iter().flatten().any(|force| force.has_variables()) {
        let instead = "potentials in `[[system.element]]` and loads leave the matrices sparse";
        ("system.force", "the force depends on the position or the velocity", instead)
    } else if scenario.system.gyroscopic.is_some() {
        (
            "system.gyroscopic",
            "it makes the matrix of a step unsymmetric",
            "systems without it have sparse factors",
        )
    } else if degree > 1 || collocation {
        let why = "the scheme has none but with one unknown a step, or two on two Gauss points";
        ("scheme", why, SPARSE_SCHEMES)
    } else {
        return None;
    };
    Some(format!(
        "{key}: {coordinates} coordinates are solved with full matrices instead of sparse factors, since {why}; {instead}"
    ))
}

/// Transformation to a symmetric matrix for a step with two unknown nodes: that of Gauss's two points, unless
/// the damping couples them.
fn stage_pair(scenario: &Scenario) -> Option<StagePair> {
    let scheme = match scenario.scheme {
        Scheme::Galerkin { degree: 2, .. } if scenario.convolution.family.staged().is_none() => {
            AnyScheme::<f64>::new(scenario).ok()?
        }
        _ => return None,
    };
    StagePair::of(&scheme.view())
}

/// The sparse space for a scenario, or `None` if it runs in the dense one.
///
/// Sparse factors require symmetric matrices with one unknown node, or two on two Gauss points: variational
/// schemes of degree 1 and 2 without a force that depends on the position or the velocity.
///
/// # Errors
/// If the system is too large for the solver that its scheme needs, or its factor for the available memory.
pub(super) fn sparse_space(
    scenario: &Scenario,
    choice: SolverChoice,
) -> Result<Option<AnySpace>, InputError> {
    let (degree, count) = (scenario.scheme_descriptor().unknowns, scenario.coordinates());
    let known = scenario.system.has_sparse_matrices() || scenario.system.has_sparse_terms();
    let beyond_dense = count.saturating_mul(degree) > MOST_DENSE;
    let large = scenario.system.is_large() || beyond_dense;
    let many = count > MANY || (count > SEVERAL && known);
    let pushed = scenario.system.force.iter().flatten().any(|force| force.has_variables());
    let owned = scenario.system.own_terms.as_ref().is_some_and(SharedTerms::are_full);
    let collocation = scenario.scheme == Scheme::Collocation;
    let pair = stage_pair(scenario);
    let eliminated = (degree == 1 && !collocation) || pair.is_some();
    let suits = eliminated && !pushed && !owned && scenario.system.gyroscopic.is_none();
    let wanted = match choice {
        // Load cases share a sparse factor of any size.
        SolverChoice::Automatic => (large && many) || !scenario.cases.is_empty(),
        SolverChoice::Dense => false,
        SolverChoice::Sparse => true,
    };
    // Coefficients of the scheme decide it, not the table of combinations.
    if !scenario.cases.is_empty() && (!wanted || !suits) {
        let allowed = format!("a scheme whose steps are solved by a sparse factor: {SPARSE_SCHEMES}");
        let with = "`[[case]]`".to_owned();
        return Err(scenario.error_at("scheme", Problem::Incompatible { with, allowed }));
    }
    if !wanted || !suits {
        if beyond_dense {
            return Err(too_large(scenario, pushed));
        }
        return Ok(None);
    }
    let model = Model::<f64>::new(scenario).map_err(|error| {
        scenario.error_at("system.mass", Problem::Precision { reason: error.to_string() })
    })?;
    let damping: Vec<Matrix<f64>> =
        scenario.system.damping.iter().map(|term| matrix(&term.coefficient)).collect();
    let stiffness = model.stiffness();
    let mass = model.mass();
    let blocks: Vec<_> = [mass, &stiffness].into_iter().chain(&damping).collect();
    let plan = match &scenario.system.known {
        Some(known) => Elimination::knowing(scenario.coordinates(), &blocks, known),
        None => Elimination::of(scenario.coordinates(), &blocks),
    };
    let plan = match pair {
        Some(pair) => plan.of_pairs(pair),
        None => plan,
    };
    let unknowns = count * plan.nodes();
    if is_of_few(scenario, choice) && plan.factor_len() as f64 > SMALL * (unknowns * unknowns) as f64 {
        return Ok(None);
    }
    if let Some(available) = available_memory()
        && plan.factor_bytes() > available
    {
        let megabytes = |bytes: usize| bytes.div_ceil(1 << 20);
        let reason = format!(
            "the Cholesky factor of the step's matrix takes {} MB, {} MB of memory are available",
            megabytes(plan.factor_bytes()),
            megabytes(available)
        );
        return Err(scenario.error_at("system.mass", Problem::Unusable { reason }));
    }
    Ok(Some(AnySpace::sparse(plan).times(scenario.copies()).on_threads(scenario.history.threads())))
}

/// True if the number of coordinates is small enough for full matrices.
pub(super) fn is_of_few(scenario: &Scenario, choice: SolverChoice) -> bool {
    choice == SolverChoice::Automatic && scenario.cases.is_empty() && scenario.coordinates() <= MANY
}

/// True if the number of coordinates is so large that eigenvalues of full matrices take longer than short
/// runs.
pub(super) fn are_several(scenario: &Scenario) -> bool {
    scenario.coordinates() > SEVERAL
}

fn too_large(scenario: &Scenario, pushed: bool) -> InputError {
    let with = format!("{} coordinates: it is solved with full matrices", scenario.coordinates());
    if pushed {
        let allowed = "a force of time alone (`[[system.load]]`), potentials for what depends on the position (`[[system.element]]`)";
        return scenario
            .error_at("system.force", Problem::Incompatible { with, allowed: allowed.to_owned() });
    }
    if scenario.system.gyroscopic.is_some() {
        let allowed = format!("at most {MOST_DENSE} coordinates: the matrix of a step is unsymmetric");
        return scenario.error_at("system.gyroscopic", Problem::Incompatible { with, allowed });
    }
    scenario.error_at("scheme", Problem::Incompatible { with, allowed: SPARSE_SCHEMES.to_owned() })
}
