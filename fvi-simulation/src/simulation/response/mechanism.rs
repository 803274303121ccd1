//! A mechanism linearised at an equilibrium.

use super::{AtPoint, Equations, has_kink, later, not_finite};
use crate::model::{Mechanism, coefficient_of};
use fvi_core::{Instant, Lagrangian, Second, max_or_nan};
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::Scenario;
use nalgebra::{DMatrix, DVector};

/// Steps of Newton's method for an equilibrium.
const MOST_STEPS: usize = 60;

/// Largest distance of a position from an equilibrium, relative to 1 + max |q|.
const CLOSE: f64 = 1e-6;

/// M, K and the ρ_m of a mechanism at an equilibrium, in the directions that its constraints leave.
///
/// With d/dt L_v = L_q + F − Σ_e G_eᵀ f_e − Cᵀ λ, c(q) = 0, at rest at q
///
/// ```text
/// M = L_vv ,   ρ_m = G_mᵀ ρ G_m ,
/// K = −∂(L_q + F)/∂q + Σ_k λ_k ∂²c_k + Σ_e [f_e ∂²g_e + K_e(0) G_eᵀ ρ G_e] ,
/// ```
///
/// on the kernel of C, where f_e = ρ K_e(0) (g_e(q) − g_e(q₀)) is what springs of kernels pull with.
///
/// # Errors
/// If q is no equilibrium, constraints are redundant there, or the momentum has terms whose forces are
/// proportional to the velocity.
pub(super) fn at_point(scenario: &Scenario, position: &[f64]) -> Result<AtPoint, InputError> {
    let mut system = Pulled::new(scenario)?;
    let here = system.at(0.0, position, None);
    if here.stiffness.iter().chain(here.constraint_jacobian.iter()).any(|entry| !entry.is_finite()) {
        return Err(not_finite(scenario, position));
    }
    refuse_turning(scenario, &here)?;
    let solved = system.next(position, &here).ok_or_else(|| {
        let reason = format!("at q = {position:?} the constraints, or the mass, are singular");
        scenario
            .error_at_first(&["system.constraints", "system.kinetic", "system"], Problem::Unusable { reason })
    })?;
    refuse_motion(scenario, &mut system, position, &here, &solved)?;
    let here = system.at(0.0, position, Some(&solved.multipliers));
    let changes = later(scenario).any(|time| {
        let then = system.at(time, position, Some(&solved.multipliers));
        (then.stiffness - &here.stiffness).amax() > 0.0
    });
    let kink = has_kink(position, |position| {
        let at = system.at(0.0, position, None);
        let entries =
            (0..position.len()).flat_map(|row| (0..position.len()).map(move |column| (row, column)));
        let entries = entries.map(|place| (place.0, place.1, at.stiffness[place])).collect();
        ((-at.force).as_slice().to_vec(), entries)
    });
    let [mass, stiffness, damping] = [vec![here.mass.clone()], vec![here.stiffness], here.damping];
    let (free, onto) = match solved.directions {
        Some(directions) => (Some([directions.clone(), here.mass]), Some(directions)),
        None => (None, None),
    };
    let reduce = |matrices: Vec<DMatrix<f64>>| -> Vec<DMatrix<f64>> {
        match &onto {
            Some(n) => matrices.into_iter().map(|matrix| n.transpose() * matrix * n).collect(),
            None => matrices,
        }
    };
    let one = |matrices: Vec<DMatrix<f64>>| reduce(matrices).swap_remove(0);
    let bent = one(vec![here.curvature]);
    let equations = Equations::Dense { mass: one(mass), stiffness: one(stiffness), damping: reduce(damping) };
    Ok(AtPoint { free, bent: (bent.amax() > 0.0).then_some(bent), equations, changes, kink })
}

/// What a mechanism at rest at a position is made of.
struct AtRest {
    /// L_vv.
    mass: DMatrix<f64>,
    /// K, without the constraints' part unless multipliers are given.
    stiffness: DMatrix<f64>,
    /// Σ_k λ_k ∂²c_k.
    curvature: DMatrix<f64>,
    /// L_q + F − Gᵀf.
    force: DVector<f64>,
    /// ∂L_v/∂q − ∂(L_q + F)/∂v.
    turning: DMatrix<f64>,
    /// Gᵀ ρ G of each term.
    damping: Vec<DMatrix<f64>>,
    /// c and C.
    constraints: DVector<f64>,
    constraint_jacobian: DMatrix<f64>,
}

/// A mechanism with the springs of its kernels.
struct Pulled {
    system: Mechanism<f64>,
    /// g(q₀).
    lengths: Vec<f64>,
    /// ρ and K(0) of each term.
    terms: Vec<(DMatrix<f64>, f64)>,
}

impl Pulled {
    fn new(scenario: &Scenario) -> Result<Self, InputError> {
        let mut system =
            Mechanism::<f64>::new(scenario).map_err(|error| super::super::bad_mass(scenario, &error))?;
        let mut lengths = vec![0.0; system.elongations()];
        system.lengths(&scenario.initial.position, &mut lengths);
        let terms = scenario.system.damping.iter().map(|term| {
            let coefficient = coefficient_of::<f64>(scenario, term);
            let count = coefficient.len().isqrt();
            (DMatrix::from_row_slice(count, count, &coefficient), term.transfer.spring())
        });
        Ok(Self { system, lengths, terms: terms.collect() })
    }

    fn at(&mut self, time: f64, position: &[f64], multipliers: Option<&[f64]>) -> AtRest {
        let (n, system) = (position.len(), &mut self.system);
        let (m, still) = (system.constraints(), vec![0.0; n]);
        let instant = Instant::in_step(time, 0.5, 0.0);
        let [mut momentum, mut force] = [vec![0.0; n], vec![0.0; n]];
        system.first(instant, position, &still, &mut momentum, &mut force);
        let [mut mass, mut coupling, mut slope, mut resistance] = [(); 4].map(|()| vec![0.0; n * n]);
        let parts = Second {
            mass: &mut mass,
            coupling: &mut coupling,
            stiffness: &mut slope,
            resistance: &mut resistance,
        };
        system.second(instant, position, &still, parts);
        let mut elongations = vec![0.0; self.lengths.len() * n];
        system.elongate(position, &mut elongations);
        let mut lengths = vec![0.0; self.lengths.len()];
        system.lengths(position, &mut lengths);
        let risen: Vec<f64> = lengths.iter().zip(&self.lengths).map(|(g, start)| g - start).collect();
        let (mut first, mut pulls, mut damping) = (0, vec![0.0; lengths.len()], Vec::new());
        let mut stiffness = DMatrix::zeros(n, n);
        for (rho, spring) in &self.terms {
            let count = rho.nrows();
            let jacobian = DMatrix::from_row_slice(count, n, &elongations[first * n..(first + count) * n]);
            let own = jacobian.transpose() * rho * &jacobian;
            if *spring != 0.0 {
                let pull = rho * DVector::from_column_slice(&risen[first..first + count]) * *spring;
                pulls[first..first + count].copy_from_slice(pull.as_slice());
                stiffness += &own * *spring;
            }
            damping.push(own);
            first += count;
        }
        let mut turned = vec![0.0; lengths.len() * n];
        system.turn(position, &still, &pulls, &mut turned, &mut slope);
        let [mut values, mut jacobian] = [vec![0.0; m], vec![0.0; m * n]];
        system.constrain(position, &mut values, &mut jacobian);
        let mut curvature = vec![0.0; n * n];
        if let Some(multipliers) = multipliers {
            system.add_constraint_curvature(position, multipliers, 1.0, &mut curvature);
        }
        let square = |entries: &[f64]| DMatrix::from_row_slice(n, n, entries);
        let elongations = DMatrix::from_row_slice(lengths.len(), n, &elongations);
        AtRest {
            mass: square(&mass),
            stiffness: stiffness - square(&slope) + square(&curvature),
            curvature: square(&curvature),
            force: DVector::from_vec(force) - elongations.transpose() * DVector::from_vec(pulls),
            turning: square(&coupling) - square(&resistance),
            damping,
            constraints: DVector::from_vec(values),
            constraint_jacobian: DMatrix::from_row_slice(m, n, &jacobian),
        }
    }

    /// The multipliers of a position, and Newton's step towards an equilibrium; `None` where constraints are
    /// redundant.
    fn next(&mut self, position: &[f64], here: &AtRest) -> Option<Solved> {
        let jacobian = &here.constraint_jacobian;
        if jacobian.nrows() == 0 {
            let change = least_step(here.stiffness.clone(), &here.force, size_of(position));
            return Some(Solved { multipliers: Vec::new(), directions: None, change });
        }
        // λ of the least force that is left.
        let gram = (jacobian * jacobian.transpose()).cholesky()?;
        let size = gram.l().diagonal();
        if size.min() < 1e-7 * size.max() {
            return None;
        }
        let multipliers = gram.solve(&(jacobian * &here.force)).as_slice().to_vec();
        let onto =
            DMatrix::identity(position.len(), position.len()) - jacobian.transpose() * gram.solve(jacobian);
        let spectrum = onto.symmetric_eigen();
        let kept = (0..position.len()).filter(|&column| spectrum.eigenvalues[column] > 0.5);
        let columns: Vec<_> = kept.map(|column| spectrum.eigenvectors.column(column).into_owned()).collect();
        if columns.len() + jacobian.nrows() != position.len() || columns.is_empty() {
            return None;
        }
        let directions = DMatrix::from_columns(&columns);
        let stiffness = self.at(0.0, position, Some(&multipliers)).stiffness;
        let back = -(jacobian.transpose() * gram.solve(&here.constraints));
        let left = directions.transpose() * (&here.force - &stiffness * &back);
        let onto_free = directions.transpose() * stiffness * &directions;
        let along = least_step(onto_free, &left, size_of(position));
        let change = along.map(|along| back + &directions * along);
        Some(Solved { multipliers, directions: Some(directions), change })
    }

    /// The equilibrium that Newton's method finds from a position.
    fn equilibrium_near(&mut self, position: &[f64]) -> Option<Vec<f64>> {
        let mut position = position.to_vec();
        for _ in 0..MOST_STEPS {
            let here = self.at(0.0, &position, None);
            let change = self.next(&position, &here)?.change?;
            let size = change.amax();
            let largest = size_of(&position);
            if !size.is_finite() {
                return None;
            }
            let share = (0.5 * largest / size).min(1.0);
            position.iter_mut().zip(change.iter()).for_each(|(q, change)| *q += share * change);
            if size <= 1e-13 * largest {
                return Some(position);
            }
        }
        None
    }
}

/// max(1, max |q|).
fn size_of(position: &[f64]) -> f64 {
    position.iter().map(|q| q.abs()).fold(1.0, max_or_nan)
}

/// The least x with K x = f; `None` if there is none, as where a force acts in a direction without stiffness.
fn least_step(stiffness: DMatrix<f64>, force: &DVector<f64>, size: f64) -> Option<DVector<f64>> {
    let svd = stiffness.clone().try_svd(true, true, f64::EPSILON, 10_000)?;
    let largest = svd.singular_values.max();
    let step = svd.solve(force, 1e-11 * largest).ok()?;
    let left = (force - stiffness * &step).amax();
    (left <= 1e-8 * force.amax() || left <= 1e-12 * largest * size).then_some(step)
}

/// λ, a basis of the kernel of C, and a step towards an equilibrium, where there is one.
struct Solved {
    multipliers: Vec<f64>,
    directions: Option<DMatrix<f64>>,
    change: Option<DVector<f64>>,
}

/// Refuses forces proportional to the velocity.
fn refuse_turning(scenario: &Scenario, here: &AtRest) -> Result<(), InputError> {
    if here.turning.amax() <= 1e-14 * (here.mass.amax() + here.stiffness.amax()) {
        return Ok(());
    }
    let reason =
        "its terms that are linear in the velocities turn at rest, as gyroscopic forces do, and a frequency \
         response takes symmetric equations"
            .to_owned();
    Err(scenario.error_at("system.kinetic", Problem::Unusable { reason }))
}

/// Refuses a position at which the mechanism does not stay at rest.
fn refuse_motion(
    scenario: &Scenario,
    system: &mut Pulled,
    position: &[f64],
    here: &AtRest,
    solved: &Solved,
) -> Result<(), InputError> {
    let left = match &solved.directions {
        Some(n) => n * (n.transpose() * &here.force),
        None => here.force.clone(),
    };
    let off = here.constraints.iter().map(|c| c.abs()).fold(0.0, max_or_nan);
    let stays = |change: &DVector<f64>| change.amax() <= CLOSE * size_of(position);
    if solved.change.as_ref().is_some_and(stays) {
        return Ok(());
    }
    let near = system.equilibrium_near(position).map_or_else(String::new, |equilibrium| {
        format!("; Newton's method finds one at q = {equilibrium:?}, which `--position` takes")
    });
    let force: Vec<f64> = left.iter().copied().collect();
    let reason = format!(
        "a frequency response is about an equilibrium: at q = {position:?} the force {force:?} is left at rest, and the \
         constraints are off by {off:.2e}{near}"
    );
    Err(scenario.error_at("initial.position", Problem::Unusable { reason }))
}
