//! Coordinates without mass: checks of the forces that hold them and of the scheme, and their positions at
//! the start.

use super::bad_mass;
use crate::model::{Direction, Equilibrium, MasslessRows, Matrix, Model, matrix};
use fvi_core::{Instant, Mechanics, max_or_nan};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{DampedAt, Derivative, Scenario, Scheme};
use fvi_sparse::{Analysis, FactorError, Pattern};
use nalgebra::{Complex, DMatrix};
use std::borrow::Cow;

/// Fraction of a diagonal entry above which a pivot is not rounding.
const ROUNDING: f64 = 1e-13;

/// Largest distance of a given position from the balance of forces, relative to the largest position.
const GIVEN: f64 = 1e-6;

/// Most coordinates that dampers without an unrelaxed modulus may hold in some directions only.
const MOST_COUPLED: usize = 500;

/// Most means that a position at a grid point is made of.
const MOST_MEANS: usize = 6;

/// Coordinates without mass, with the forces that act on them at the start.
struct Held {
    rows: Vec<usize>,
    /// Index of each coordinate among the rows.
    places: Vec<Option<usize>>,
    /// ∂²U/∂q² − ∂F/∂q, and −∂F/∂v if there is one.
    stiffness: Matrix<f64>,
    resistance: Option<Matrix<f64>>,
    /// For each whether a damping term acts on it, whether one without an unrelaxed modulus does, whether one
    /// does that is at rest at the given position, and whether a velocity-dependent force does.
    remembered: Vec<bool>,
    creeping: Vec<bool>,
    resting: Vec<bool>,
    resisted: Vec<bool>,
}

/// A scenario with coordinates without mass.
pub(super) struct Placed<'a> {
    /// The scenario, with its position at t = 0+ as the initial one.
    pub(super) scenario: Cow<'a, Scenario>,
    /// True if this differs from the given position, at which memories are at rest.
    pub(super) jumps: bool,
    /// The coordinates without mass.
    pub(super) rows: MasslessRows,
}

/// The coordinates without mass of a scenario, and the scenario with their positions at t = 0+. Scenarios
/// with a mass for every coordinate are unchanged.
///
/// A coordinate without mass follows the load of t = 0 at once, as far as the dampers let it: it jumps along
/// the directions y in which every kernel has an unrelaxed modulus K_m(∞), to
///
/// ```text
/// yᵀ [∇U(q) − F + Σ_m K_m(∞) ρ_m (q − q₀)] = 0 ,
/// ```
///
/// where the memories are at rest at the given q₀, those of Riemann and Liouville's derivatives at 0. Dampers
/// without such a modulus hold it at q₀. Where no memory is at rest at q₀, a given zero is replaced by the
/// position found; other given values must be near it.
///
/// # Errors
/// If nothing holds one of them, or the scheme, the damping or another key needs its mass.
pub(super) fn placed(scenario: &Scenario) -> Result<Placed<'_>, InputError> {
    let unchanged = |rows| Placed { scenario: Cow::Borrowed(scenario), jumps: false, rows };
    let rows = scenario.system.massless();
    if rows.is_empty() {
        return Ok(unchanged(MasslessRows::default()));
    }
    let mut model = Model::<f64>::new(scenario).map_err(|error| bad_mass(scenario, &error))?;
    let held = Held::new(scenario, rows, &mut model)?;
    if scenario.equation.is_some() {
        // Each coordinate has a damper that holds it where it begins, whatever its right side is.
        held.check_scheme(scenario)?;
        held.check_growth(scenario)?;
        return Ok(unchanged(held.sorted(scenario)));
    }
    held.check_damping(scenario, &scenario.initial.position)?;
    held.check_scheme(scenario)?;
    held.check_hold(scenario)?;
    let start = held.start(scenario)?;
    if let Some(position) = &start {
        held.check_damping(scenario, position)?;
    }
    let rows = held.sorted(scenario);
    let Some(position) = start else { return Ok(unchanged(rows)) };
    let mut placed = scenario.clone();
    placed.initial.position = position;
    Ok(Placed { scenario: Cow::Owned(placed), jumps: true, rows })
}

/// The error for what acts on this coordinate by the entries of its matrix; what none goes with is a row of
/// the table of combinations.
fn refused(scenario: &Scenario, key: &str, what: &str, row: usize) -> InputError {
    let with = format!("coordinate {row} (from 0), which has no mass (`system.mass`)");
    let allowed = format!("{what} where every coordinate has a mass");
    scenario.error_at(key, Problem::Incompatible { with, allowed })
}

impl Held {
    fn new(scenario: &Scenario, rows: Vec<usize>, model: &mut Model<f64>) -> Result<Self, InputError> {
        let size = scenario.coordinates();
        let mut places = vec![None; size];
        rows.iter().enumerate().for_each(|(place, &row)| places[row] = Some(place));
        let position = scenario.initial.position.clone();
        let instant = Instant::in_step(scenario.time.start, 0.5, scenario.time.step);
        let (mut restoring, mut stiffness) = (vec![0.0; size], model.stiffness());
        let mut resistance = None;
        let mut resisted = vec![false; rows.len()];
        if Mechanics::depends_on_velocity(model) {
            let mut velocity = vec![0.0; size];
            model.velocity(&scenario.initial.momentum, &mut velocity);
            let mut at = |velocity: &[f64], stiffness: &mut Matrix<f64>| {
                model.linearise_in_motion(instant, &position, velocity, &mut restoring, stiffness);
                let mut resistance = stiffness.clone();
                model.resistance(instant, &position, velocity, &mut resistance);
                resistance
            };
            // The velocity is changed, so that velocity-dependent forces are found even where drag has no
            // slope.
            let elsewhere: Vec<f64> =
                velocity.iter().enumerate().map(|(i, v)| v + 1.0 + 0.1 * (i as f64).sin()).collect();
            let other = at(&elsewhere, &mut stiffness);
            let here = at(&velocity, &mut stiffness);
            // A dashpot resists as such a force does; velocities of others then only push.
            let dashpots = dashpots(scenario, &places, rows.len());
            for (row, column, entry) in here.entries().into_iter().chain(other.entries()) {
                if let (Some(place), true) = (places[row], entry != 0.0) {
                    resisted[place] |= row == column || dashpots[place] == 0.0;
                }
            }
            let mut own = own_entries(&here, &places, rows.len());
            own.iter_mut().zip(&dashpots).for_each(|(own, dashpot)| *own += dashpot);
            if let Some(place) =
                (0..rows.len()).find(|&place| resisted[place] && (own[place] <= 0.0 || own[place].is_nan()))
            {
                let reason = format!(
                    "the force on coordinate {}, which has no mass, depends on a velocity and does not resist the one of this \
                     coordinate at the start: −∂F/∂v is {} there",
                    rows[place], own[place]
                );
                return Err(scenario.error_at("system.force", Problem::Unusable { reason }));
            }
            resistance = Some(here);
        } else {
            model.linearise(instant, &position, &mut restoring, &mut stiffness);
        }
        let [mut remembered, mut creeping, mut resting] = [(); 3].map(|()| vec![false; rows.len()]);
        for term in &scenario.system.damping {
            let creeps = term.transfer.unrelaxed().is_none();
            let rests = term.derivative == Derivative::Caputo && term.transfer.exponent() != Some(0.0);
            for (row, _, entry) in matrix::<f64>(&term.coefficient).entries() {
                if let (Some(place), true) = (places[row], entry != 0.0) {
                    remembered[place] = true;
                    creeping[place] |= creeps;
                    resting[place] |= rests;
                }
            }
        }
        Ok(Self { rows, places, stiffness, resistance, remembered, creeping, resting, resisted })
    }

    /// Refuses gyroscopic forces and dampings that need a mass, or leave where the motion begins open.
    fn check_damping(&self, scenario: &Scenario, position: &[f64]) -> Result<(), InputError> {
        let row_of = |row: usize| self.places[row].map(|_| row);
        if let Some(skew) = &scenario.system.gyroscopic {
            let turned = skew
                .entries()
                .iter()
                .find_map(|&(row, _, entry)| row_of(row as usize).filter(|_| entry != 0.0));
            if let Some(row) = turned {
                return Err(refused(scenario, "system.gyroscopic", "gyroscopic forces", row));
            }
        }
        for (index, term) in scenario.system.damping.iter().enumerate() {
            let key = format!("system.damping[{index}]");
            let entries = matrix::<f64>(&term.coefficient).entries();
            let acts = entries.iter().find_map(|&(row, _, entry)| row_of(row).filter(|_| entry != 0.0));
            let Some(row) = acts else { continue };
            if term.transfer.growth() > 1.0 {
                let what = "a kernel that grows faster than s (an order above 1), which is an inertia,";
                return Err(refused(scenario, &key, what, row));
            }
            if term.derivative == Derivative::RiemannLiouville && term.transfer.unrelaxed().is_none() {
                let force = term.coefficient.times(position);
                if let Some(&row) = self.rows.iter().find(|&&row| force[row] != 0.0) {
                    let reason = format!(
                        "the Riemann–Liouville derivative of a position that is not 0 at the start pushes coordinate {row}, which has no \
                         mass, without bound; `derivative = \"caputo\"` does not"
                    );
                    return Err(scenario.error_at(&key, Problem::Unusable { reason }));
                }
            }
        }
        // What a force of the velocity resists must be held in every direction: at the end of a step it is
        // what the polynomial says.
        let resisted = self.resisted.contains(&true);
        if let Some(place) = self.loose(scenario).filter(|_| resisted) {
            let reason = format!(
                "the damping couples coordinate {}, which has no mass, with others so that it resists some of their motions only; take \
                 coordinates of which each is damped or not, such as the elongations of the dampers",
                self.rows[place]
            );
            return Err(scenario.error_at("system.damping", Problem::Unusable { reason }));
        }
        Ok(())
    }

    /// A coordinate, of those that forces of the velocity or dampers hold, on which they are not positive
    /// definite.
    fn loose(&self, scenario: &Scenario) -> Option<usize> {
        let count = self.rows.len();
        let damped: Vec<bool> =
            (0..count).map(|place| self.remembered[place] || self.resisted[place]).collect();
        let mut entries = Vec::new();
        for term in &scenario.system.damping {
            entries.extend(self.own_block(&matrix(&term.coefficient), 1.0));
        }
        entries.extend(self.resistance.iter().flat_map(|resistance| self.own_block(resistance, 1.0)));
        entries.retain(|&(row, column, _)| damped[row] && damped[column]);
        let others = (0..count).filter(|&place| !damped[place]);
        entries.extend(others.map(|place| (place, place, 1.0)));
        first_loose(count, &entries)
    }

    /// Refuses schemes whose equations do not determine what holds these coordinates, or for which their
    /// errors grow. It depends on the entries of the matrices that hold them.
    fn check_scheme(&self, scenario: &Scenario) -> Result<(), InputError> {
        if scenario.scheme == Scheme::Collocation {
            return Ok(());
        }
        // Their positions at the end of a step would need the input there, which may change inside the step.
        let held = |row: usize| {
            self.places[row].is_some_and(|place| !self.remembered[place] && !self.resisted[place])
        };
        let driven = scenario.controllers.iter().flat_map(|controller| controller.drives.entries.iter());
        let driven = driven.map(|&(row, _)| row as usize).find(|&row| held(row));
        let pushed = scenario
            .input
            .as_ref()
            .and_then(|input| self.rows.iter().copied().find(|&row| held(row) && input.pushes(row)));
        for (key, row) in [("controller", driven), ("input", pushed)] {
            if let Some(row) = row {
                let with =
                    format!("coordinate {row} (from 0), which has no mass and no damper: it pushes it");
                let allowed = "forces on others, loads, or \"collocation\"".to_owned();
                return Err(scenario.error_at(key, Problem::Incompatible { with, allowed }));
            }
        }
        let Some(place) = self.remembered.iter().position(|&remembered| remembered) else { return Ok(()) };
        let with = format!("damping of coordinate {} (from 0), which has no mass", self.rows[place]);
        if scenario.convolution.at == DampedAt::MainNodes {
            let allowed = "\"nodes\"".to_owned();
            return Err(scenario.error_at("convolution.at", Problem::Incompatible { with, allowed }));
        }
        if scenario.time.grid.is_some() || scenario.time.adaptive().is_some() {
            let allowed = "\"collocation\", or equal steps".to_owned();
            return Err(scenario.error_at("scheme", Problem::Incompatible { with, allowed }));
        }
        Ok(())
    }

    /// Refuses equal steps over which a right side grows by more than its unknown: of the numbers that such
    /// steps would give none is near the solution.
    fn check_growth(&self, scenario: &Scenario) -> Result<(), InputError> {
        if scenario.time.grid.is_some() {
            return Ok(());
        }
        let h = scenario.time.step;
        let mut own = own_entries(&self.stiffness, &self.places, self.rows.len());
        for term in &scenario.system.damping {
            let value = term.transfer.value(Complex::new(h.recip(), 0.0)).re;
            own.iter_mut().zip(term.coefficient.diagonal()).for_each(|(own, entry)| *own += value * entry);
        }
        match own.iter().any(|&own| own <= 0.0) {
            true => {
                let with =
                    "a right side that grows faster with its unknown than such a step resolves".to_owned();
                let allowed =
                    "shorter steps; or `end` with a `tolerance` alone, which chooses them".to_owned();
                Err(scenario.error_at("time.step", Problem::Incompatible { with, allowed }))
            }
            false => Ok(()),
        }
    }

    /// Refuses coordinates that neither stiffness nor damping holds. A damper without an unrelaxed modulus
    /// holds over short steps whatever the stiffness is, which right sides that are no gradient have of any
    /// size.
    fn check_hold(&self, scenario: &Scenario) -> Result<(), InputError> {
        let h = scenario.time.step;
        let s = if h > 0.0 && h.is_finite() { h.recip() } else { 1.0 };
        let mut entries = self.own_block(&self.stiffness, 1.0);
        let largest: f64 = entries.iter().map(|(_, _, entry)| entry.abs()).sum();
        for term in &scenario.system.damping {
            let block = self.own_block(&matrix(&term.coefficient), 1.0);
            let value = term.transfer.value(Complex::new(s, 0.0)).re;
            let mut factor = if value > 0.0 && value.is_finite() { value } else { 1.0 };
            if term.transfer.unrelaxed().is_none() {
                let own = block.iter().filter(|(row, column, entry)| row == column && *entry > 0.0);
                let least = -own.map(|(_, _, entry)| -entry).fold(f64::NEG_INFINITY, max_or_nan);
                factor = factor.max(2.0 * largest / least);
            }
            entries.extend(block.into_iter().map(|(row, column, entry)| (row, column, factor * entry)));
        }
        entries.extend(self.resistance.iter().flat_map(|resistance| self.own_block(resistance, s)));
        match first_loose(self.rows.len(), &entries) {
            None => Ok(()),
            Some(place) => {
                let reason = format!(
                    "mass 0 at coordinate {} (from 0), which neither stiffness nor damping holds at the start: their sum is not \
                     positive definite on the coordinates without mass",
                    self.rows[place]
                );
                Err(scenario.error_at("system.mass", Problem::Unusable { reason }))
            }
        }
    }

    /// The entries of a matrix between coordinates without mass, by their indices among these.
    fn own_block(&self, matrix: &Matrix<f64>, factor: f64) -> Vec<(usize, usize, f64)> {
        let places = &self.places;
        let own =
            |(row, column, entry): (usize, usize, f64)| Some((places[row]?, places[column]?, factor * entry));
        matrix.entries().into_iter().filter_map(own).collect()
    }

    /// The directions in which the coordinates may jump: those in which neither dampers without an unrelaxed
    /// modulus nor forces of the velocity resist, the eigenvectors of their sum with the eigenvalue 0.
    fn free(&self, scenario: &Scenario) -> Result<Vec<Direction>, InputError> {
        let count = self.rows.len();
        let held = |place: usize| self.creeping[place] || self.resisted[place];
        let (held, free): (Vec<usize>, Vec<usize>) = (0..count).partition(|&place| held(place));
        let mut directions: Vec<Direction> =
            free.iter().map(|&place| vec![(self.rows[place], 1.0)]).collect();
        let creeping = scenario.system.damping.iter().filter(|term| term.transfer.unrelaxed().is_none());
        let mut entries: Vec<_> =
            creeping.flat_map(|term| self.own_block(&matrix(&term.coefficient), 1.0)).collect();
        entries.extend(self.resistance.iter().flat_map(|resistance| self.own_block(resistance, 1.0)));
        let mut among = vec![None; count];
        held.iter().enumerate().for_each(|(index, &place)| among[place] = Some(index));
        let entries: Vec<(usize, usize, f64)> = entries
            .into_iter()
            .filter_map(|(row, column, entry)| Some((among[row]?, among[column]?, entry)))
            .collect();
        let Some(loose) = first_loose(held.len(), &entries) else { return Ok(directions) };
        if held.len() > MOST_COUPLED {
            let reason = format!(
                "the damping couples coordinate {}, which has no mass, with others so that it resists some of their motions only,                  and with {} such coordinates in all, more than {MOST_COUPLED}; take coordinates of which each is damped or not,                  such as the elongations of the dampers",
                self.rows[held[loose]],
                held.len()
            );
            return Err(scenario.error_at("system.damping", Problem::Unusable { reason }));
        }
        let mut resisting = DMatrix::zeros(held.len(), held.len());
        for (row, column, entry) in entries {
            resisting[(row, column)] += 0.5 * entry;
            resisting[(column, row)] += 0.5 * entry;
        }
        let eigen = resisting.symmetric_eigen();
        let largest = eigen.eigenvalues.amax();
        for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            if *value <= ROUNDING.sqrt() * 1e-3 * largest {
                let entries = held.iter().zip(vector.iter()).filter(|(_, entry)| **entry != 0.0);
                directions.push(entries.map(|(&place, &entry)| (self.rows[place], entry)).collect());
            }
        }
        Ok(directions)
    }

    /// The position at t = 0+, if coordinates can jump.
    fn start(&self, scenario: &Scenario) -> Result<Option<Vec<f64>>, InputError> {
        let directions = self.free(scenario)?;
        let Some(&(row, _)) = directions.iter().flatten().next() else { return Ok(None) };
        let mut model = Model::<f64>::unrelaxed(scenario).map_err(|error| bad_mass(scenario, &error))?;
        let given = &scenario.initial.position;
        let mut position = given.clone();
        let instant = Instant::in_step(scenario.time.start, 0.0, scenario.time.step);
        let input = scenario.input_over(0);
        let motion = (&mut position, scenario.initial.momentum.as_slice());
        if Equilibrium::along(directions, &model).find(&mut model, instant, input, motion).is_err() {
            let reason = format!(
                "no balance of the forces on coordinate {row} and others without mass was found from there; give one that is nearer"
            );
            return Err(scenario.error_at("initial.position", Problem::Unusable { reason }));
        }
        let largest = position.iter().map(|number| number.abs()).fold(0.0, max_or_nan);
        let far = |&(place, row): &(usize, &usize)| {
            let (free, off) = (!self.resting[place], (given[*row] - position[*row]).abs());
            free && given[*row] != 0.0 && off > GIVEN * largest
        };
        if let Some((_, &row)) = self.rows.iter().enumerate().find(far) {
            let reason = format!(
                "coordinate {row} (from 0) has no mass and no memory that is at rest at the given position: its forces balance at {}, \
                 {} is given, which is off by {:e}; give that, or 0 to have it computed",
                position[row],
                given[row],
                given[row] - position[row]
            );
            return Err(scenario.error_at("initial.position", Problem::Unusable { reason }));
        }
        Ok(Some(position))
    }

    fn sorted(self, scenario: &Scenario) -> MasslessRows {
        if scenario.scheme == Scheme::Collocation {
            return MasslessRows { all: self.rows, ..MasslessRows::default() };
        }
        let of = |wanted: &dyn Fn(usize) -> bool| {
            let places = (0..self.rows.len()).filter(|&place| !self.resisted[place] && wanted(place));
            places.map(|place| self.rows[place]).collect::<Vec<_>>()
        };
        let order = match scenario.convolution.family {
            ConvolutionFamily::Bdf { order } => order,
            _ => 2,
        };
        let means = order.min(2 * scenario.scheme_descriptor().unknowns).clamp(2, MOST_MEANS);
        let held = of(&|place| !self.remembered[place]);
        let remembered = of(&|place| self.remembered[place]);
        MasslessRows { all: self.rows, held, remembered, means }
    }
}

/// The diagonal coefficients of the dashpots, terms of order 1, for the coordinates that have places.
fn dashpots(scenario: &Scenario, places: &[Option<usize>], count: usize) -> Vec<f64> {
    let mut sum = vec![0.0; count];
    let of_order_1 = scenario.system.damping.iter().filter(|term| term.transfer.exponent() == Some(1.0));
    for term in of_order_1 {
        let own = own_entries(&matrix(&term.coefficient), places, count);
        sum.iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
    }
    sum
}

/// The diagonal entries of a matrix for the coordinates that have places.
fn own_entries(matrix: &Matrix<f64>, places: &[Option<usize>], count: usize) -> Vec<f64> {
    let mut own = vec![0.0; count];
    for (row, column, entry) in matrix.entries() {
        if let (Some(place), true) = (places[row], row == column) {
            own[place] += entry;
        }
    }
    own
}

/// The first coordinate at which the symmetric part of a matrix is not positive definite beyond rounding.
fn first_loose(count: usize, entries: &[(usize, usize, f64)]) -> Option<usize> {
    let diagonal = (0..count).map(|place| (place, place));
    let both = entries.iter().flat_map(|&(row, column, _)| [(row, column), (column, row)]);
    let pattern = Pattern::new(count, diagonal.chain(both).collect());
    let mut values = vec![0.0; pattern.len()];
    for &(row, column, entry) in entries {
        values[pattern.slot(row, column)] += 0.5 * entry;
        values[pattern.slot(column, row)] += 0.5 * entry;
    }
    for row in 0..count {
        values[pattern.slot(row, row)] *= 1.0 - ROUNDING;
    }
    match Analysis::new(&pattern).factor(&pattern, &values) {
        Err(FactorError::Pivot { coordinate, .. }) => Some(coordinate),
        _ => None,
    }
}
