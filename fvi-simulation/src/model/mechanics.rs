//! The mechanics of a scenario: mass, compiled potential and force.

mod single;

pub use single::SingleModel;

use super::chain::PairedRows;
use super::elements::Elements;
use super::energies::{EnergiesAlong, EnergyRoom, States, write_plain};
use super::loads::Loads;
use super::matrices::{Matrix, Sparse};
use super::moment::moment;
use super::own::Own;
use super::rough_forces::RoughForces;
use super::shared::Shared;
use super::space::AnySpace;
use crate::language::expression::Elementary;
use crate::model::tape::{CompiledForce, CompiledPotential, OwnRegisters};
use crate::scenario::{Scenario, SymmetricMatrix};
use fvi_core::{Block, Instant, MatrixError, Mechanics, NodalRule, Real};
use fvi_core::{combine_two, factor, invert_factored};
use fvi_sparse::{Analysis, Factor, Pattern};
use std::sync::Arc;

/// M, U and F of a scenario, compiled once.
#[derive(Clone, Debug)]
pub struct Model<T> {
    mass: Matrix<T>,
    inverse_mass: InverseMass<T>,
    /// Threads that products and solutions may take.
    threads: usize,
    /// K of the scenario.
    base: Option<Matrix<T>>,
    elements: Vec<Elements<T>>,
    loads: Loads<T>,
    /// Those of each load case, which acts on a motion of its own.
    cases: Vec<Loads<T>>,
    /// The energies of these motions.
    energies: Vec<T>,
    potential: Option<CompiledPotential<T>>,
    /// K of the quadratic part ½ qᵀKq + bᵀq of the potential.
    quadratic: Matrix<T>,
    /// The same, where it is that of a chain, and no other stiffness beside it.
    paired_rows: Option<PairedRows<T>>,
    linear: Vec<(usize, T)>,
    force: CompiledForce<T>,
    /// Whether there is a force at all.
    forced: bool,
    /// Whether the matrix from files, or the rows, are all that pulls.
    is_constant: bool,
    /// Whether the paired rows are.
    pulls_by_paired_rows: bool,
    /// What is rough in time, so that its moments are taken exactly.
    rough: Option<RoughForces>,
    /// What code supplies.
    own: Option<Own>,
    /// Values of the stiffness that never change, by slot.
    constant: Sparse<T>,
    /// Slots of the entries of the potential's Hessian, and of their mirror images.
    hessian_slots: Vec<(u32, u32)>,
    /// Slots of the entries of the force's Jacobian.
    jacobian_slots: Vec<usize>,
    registers: Vec<T>,
    /// Those of the gradient of the potential's rest, and those of both its derivatives.
    pull_registers: OwnRegisters<T>,
    rest_registers: OwnRegisters<T>,
    /// N numbers.
    pushed: Vec<T>,
    /// Entries of a Jacobian.
    entries: Vec<T>,
}

/// What makes velocities of momenta.
#[derive(Clone, Debug)]
enum InverseMass<T> {
    Matrix(Matrix<T>),
    /// The factor of a sparse mass, and masses of the coordinates by themselves for a first guess.
    Factor(Arc<Factor>, Vec<T>),
}

impl<T: Elementary> Model<T> {
    /// Compiles the system of a scenario.
    ///
    /// # Errors
    /// If the mass is not positive definite in the precision of `T`.
    pub fn new(scenario: &Scenario) -> Result<Self, MatrixError> {
        let system = &scenario.system;
        let size = system.coordinates();
        let threads = scenario.history.threads();
        let mass = matrix(&system.mass).on_threads(threads);
        let inverse_mass = inverse(&mass, size)?;
        let potential = system.potential.as_ref().map(|u| CompiledPotential::<T>::compile(u, size));
        let force = CompiledForce::<T>::compile(system.force.as_deref().unwrap_or_default());
        let index = |&(row, column): &(u32, u32)| (row as usize, column as usize);
        let entry = |&(row, column, entry): &(u32, u32, T)| (row as usize, column as usize, entry);
        let mut elements: Vec<_> = system.elements.iter().map(Elements::<T>::new).collect();
        let base: Option<Matrix<T>> = system.stiffness.as_ref().map(|k| matrix(k).on_threads(threads));
        let springs: Vec<_> = potential
            .iter()
            .flat_map(|potential| potential.quadratic().stiffness.iter().map(entry))
            .chain(elements.iter().flat_map(Elements::springs))
            .collect();
        let linear: Vec<_> = potential
            .iter()
            .flat_map(|potential| potential.quadratic().linear.iter())
            .map(|&(coordinate, entry)| (coordinate as usize, entry))
            .chain(elements.iter().flat_map(Elements::constant_pull))
            .collect();
        let curved: Vec<_> =
            potential.iter().flat_map(|potential| potential.pattern().iter().map(index)).collect();
        let pushed: Vec<_> = force.linear().iter().map(entry).collect();
        let turned: Vec<_> = force.pattern().iter().map(index).collect();

        let both = |(row, column): (usize, usize)| [(row, column), (column, row)];
        let of_potential = springs
            .iter()
            .map(|&(row, column, _)| (row, column))
            .chain(curved.iter().copied())
            .chain(elements.iter().flat_map(Elements::places));
        let of_force = pushed.iter().map(|&(row, column, _)| (row, column)).chain(turned.iter().copied());
        let own = system.own_terms.clone().map(|terms| Own::new(terms, size));
        let of_own = own
            .iter()
            .filter(|own| own.depends_on_position())
            .flat_map(|_| (0..size).flat_map(|row| (0..size).map(move |column| (row, column))));
        let places: Vec<_> = of_potential.flat_map(both).chain(of_force).chain(of_own).collect();
        let pattern = with_base(size, base.as_ref(), &places);
        let pattern = match &system.known {
            Some(known) => known.pattern(pattern),
            None => pattern,
        };
        let slots = |&(row, column): &(usize, usize)| (pattern.slot(row, column), pattern.slot(column, row));
        let narrow = |place: (usize, usize)| {
            let narrow = |slot: usize| u32::try_from(slot).expect("fewer slots than 2³²");
            (narrow(place.0), narrow(place.1))
        };
        let hessian_slots: Vec<_> = curved.iter().map(slots).map(narrow).collect();
        let jacobian_slots: Vec<_> = turned.iter().map(|&(row, column)| pattern.slot(row, column)).collect();
        elements.iter_mut().for_each(|elements| elements.settle(&pattern));
        let mut values = of_base(base.as_ref(), &pattern);
        for &(row, column, entry) in &springs {
            let (slot, mirrored) = slots(&(row, column));
            values.own()[slot] += entry;
            if row != column {
                values.own()[mirrored] += entry;
            }
        }
        for &(row, column, entry) in &pushed {
            values.own()[pattern.slot(row, column)] -= entry;
        }
        let constant = Sparse { pattern: Arc::clone(&pattern), values, threads: 1 };
        let is_constant = places.is_empty()
            && potential.is_none()
            && force.is_zero()
            && elements.is_empty()
            && own.is_none();
        let entries = vec![T::zero(); jacobian_slots.len()];
        let quadratic = Matrix::symmetric(size, springs.iter().copied());
        let paired_rows = match (&base, &quadratic) {
            (None, Matrix::Sparse(sparse)) => sparse.paired_rows(),
            _ => None,
        };
        let pulls_by_paired_rows = paired_rows.is_some()
            && linear.is_empty()
            && potential.as_ref().is_none_or(CompiledPotential::is_quadratic)
            && elements.is_empty()
            && system.loads.is_empty()
            && scenario.cases.is_empty()
            && own.is_none()
            && force.is_zero();
        Ok(Self {
            mass,
            inverse_mass,
            threads,
            base,
            paired_rows,
            pulls_by_paired_rows,
            elements,
            loads: Loads::new(&system.loads),
            cases: scenario.cases.iter().map(|case| Loads::new(&case.loads)).collect(),
            energies: Vec::new(),
            quadratic,
            linear,
            potential,
            is_constant,
            forced: !force.is_zero(),
            rough: RoughForces::of(scenario),
            own,
            force,
            constant,
            hessian_slots,
            jacobian_slots,
            registers: Vec::new(),
            pull_registers: OwnRegisters::default(),
            rest_registers: OwnRegisters::default(),
            pushed: vec![T::zero(); size * scenario.copies()],
            entries,
        })
    }

    /// The energies of the motions under load cases, as computed last; none without cases.
    pub fn energies(&self) -> &[T] {
        &self.energies
    }

    /// Subtracts the loads of the system, and of the case that each motion is under.
    #[inline(always)]
    fn subtract_loads(&mut self, instant: Instant<T>, pull: &mut [T]) {
        if !(self.loads.is_empty() && self.cases.is_empty()) {
            self.subtract_loads_there_are(instant, pull);
        }
    }

    #[inline(never)]
    fn subtract_loads_there_are(&mut self, instant: Instant<T>, pull: &mut [T]) {
        let size = self.mass.size().max(1);
        for pull in pull.chunks_mut(size) {
            self.loads.add(moment(instant), -T::one(), pull);
        }
        for (loads, pull) in self.cases.iter_mut().zip(pull.chunks_mut(size)) {
            loads.add(moment(instant), -T::one(), pull);
        }
    }

    /// K q + b.
    fn quadratic_pull(&self, position: &[T], pull: &mut [T]) {
        if !self.paired_rows.as_ref().is_some_and(|rows| rows.multiply(position, pull)) {
            pull.fill(T::zero());
            if let Some(base) = &self.base {
                base.multiply_add(T::one(), position, pull);
            }
            self.quadratic.multiply_add(T::one(), position, pull);
        }
        for &(coordinate, entry) in &self.linear {
            pull[coordinate] += entry;
        }
    }
}

impl<T: Elementary> Mechanics<T, AnySpace> for Model<T> {
    fn mass(&self) -> &Matrix<T> {
        &self.mass
    }

    #[inline]
    fn velocity(&self, momentum: &[T], velocity: &mut [T]) {
        self.write_velocity(momentum, velocity);
    }

    fn drift(&self, momentum: &[T], velocity: &mut [T]) {
        match &self.inverse_mass {
            InverseMass::Matrix(_) => self.write_velocity(momentum, velocity),
            InverseMass::Factor(_, masses) => {
                for ((place, &p), &mass) in velocity.iter_mut().zip(momentum).zip(masses.iter().cycle()) {
                    *place = p / mass;
                }
            }
        }
    }

    fn pull(&mut self, instant: Instant<T>, position: &Vec<T>, pull: &mut [T]) {
        if self.pulls_by_paired_rows
            && let Some(rows) = &self.paired_rows
            && rows.multiply(position, pull)
        {
            return;
        }
        self.pull_of_all(instant, position, pull);
    }

    fn linearise(
        &mut self,
        instant: Instant<T>,
        position: &Vec<T>,
        pull: &mut [T],
        stiffness: &mut Matrix<T>,
    ) {
        let Matrix::Sparse(stiffness) = stiffness else {
            return self.pull(instant, position, pull);
        };
        self.quadratic_pull(position, pull);
        if self.is_constant {
            stiffness.values = self.constant.values.clone();
            return self.subtract_loads(instant, pull);
        }
        let values = stiffness.values.own();
        values.copy_from_slice(&self.constant.values);
        if let Some(potential) = &self.potential {
            let places = (self.hessian_slots.as_slice(), &mut *values);
            potential.add_rest_derivatives_again(&mut self.rest_registers, position, pull, places);
        }
        if let Some(own) = &mut self.own {
            own.add_linearisation(moment(instant), position, pull, values);
        }
        for elements in &mut self.elements {
            elements.add_rest_derivatives(position, pull, values);
        }
        self.subtract_loads(instant, pull);
        if !self.forced {
            return;
        }
        let (registers, pushed) = (&mut self.registers, &mut self.pushed);
        let jacobian = &mut self.entries[..self.jacobian_slots.len()];
        self.force.derivatives(moment(instant), position, registers, pushed, jacobian);
        pull.iter_mut().zip(pushed).for_each(|(pull, force)| *pull -= *force);
        for (&slot, &mut entry) in self.jacobian_slots.iter().zip(jacobian) {
            values[slot] -= entry;
        }
    }

    fn stiffness(&self) -> Matrix<T> {
        Matrix::Sparse(self.constant.clone())
    }

    fn is_rough(&self) -> bool {
        self.rough.is_some()
    }

    fn excess(&mut self, rule: &NodalRule<'_, T>, excess: &mut [T]) -> bool {
        self.rough.as_mut().is_some_and(|rough| rough.excess(rule, excess))
    }

    fn is_linear(&self) -> bool {
        self.is_linear()
    }

    fn energy(&mut self, position: &Vec<T>, momentum: &Vec<T>) -> T {
        let mut velocity = std::mem::take(&mut self.pushed);
        self.write_velocity(momentum, &mut velocity);
        let product = |a: &[T], b: &[T]| a.iter().zip(b).fold(T::zero(), |sum, (&a, &b)| sum + a * b);
        let half = T::of(0.5);
        let size = self.mass.size().max(1);
        if !self.cases.is_empty() {
            let pairs = momentum.chunks(size).zip(velocity.chunks(size));
            self.energies = pairs.map(|(p, v)| half * product(p, v)).collect();
        }
        let kinetic = half * product(momentum, &velocity);
        let mut energy = kinetic + self.potential_energy(position);
        if let Some(base) = &self.base {
            velocity.fill(T::zero());
            base.multiply_add(T::one(), position, &mut velocity);
            energy += half * product(position, &velocity);
            let pairs = position.chunks(size).zip(velocity.chunks(size));
            for (energy, (q, pull)) in self.energies.iter_mut().zip(pairs) {
                *energy += half * product(q, pull);
            }
        }
        self.pushed = velocity;
        for elements in &mut self.elements {
            energy += elements.value(position);
        }
        if let Some(own) = &mut self.own {
            energy += own.potential(position);
        }
        energy
    }
}

impl<T: Elementary> EnergiesAlong<T> for Model<T> {
    fn has_plain_energy(&self) -> bool {
        let diagonal = matches!(self.inverse_mass, InverseMass::Matrix(Matrix::Diagonal(_)));
        diagonal
            && self.base.is_none()
            && self.elements.is_empty()
            && self.own.is_none()
            && self.cases.is_empty()
    }

    fn write_energies(&self, states: &States<'_>, room: &mut EnergyRoom<T>, energies: &mut [f64]) {
        if let InverseMass::Matrix(Matrix::Diagonal(inverse_masses)) = &self.inverse_mass {
            write_plain(inverse_masses, self.potential.as_ref(), states, room, energies);
        }
    }
}

impl<T: Elementary> Model<T> {
    /// What everything that there may be pulls. Not where the paired rows alone are inlined.
    #[inline(never)]
    fn pull_of_all(&mut self, instant: Instant<T>, position: &[T], pull: &mut [T]) {
        self.quadratic_pull(position, pull);
        if let Some(potential) = &self.potential {
            potential.add_rest_gradient_again(&mut self.pull_registers, position, pull);
        }
        self.elements.iter_mut().for_each(|elements| elements.add_rest_gradient(position, pull));
        self.subtract_loads(instant, pull);
        if self.forced {
            self.force.value(moment(instant), position, &mut self.registers, &mut self.pushed);
            pull.iter_mut().zip(&self.pushed).for_each(|(pull, &force)| *pull -= force);
        }
        if let Some(own) = &mut self.own {
            own.add_pull(moment(instant), position, pull);
        }
    }

    /// Whether the stiffness is the same at every position and time.
    fn is_linear(&self) -> bool {
        self.own.as_ref().is_none_or(|own| !own.depends_on_position())
            && self.potential.as_ref().is_none_or(CompiledPotential::is_quadratic)
            && self.elements.iter().all(Elements::is_quadratic)
            && self.force.is_affine()
    }

    /// The potential that is given as an expression.
    fn potential_energy(&mut self, position: &[T]) -> T {
        let potential = self.potential.as_ref();
        potential.map_or(T::zero(), |potential| potential.value(position, &mut self.registers))
    }

    /// M⁻¹ p.
    fn write_velocity(&self, momentum: &[T], velocity: &mut [T]) {
        match &self.inverse_mass {
            InverseMass::Matrix(Matrix::Diagonal(inverse)) if inverse.len() == momentum.len() => {
                combine_two(velocity, inverse, momentum, |_, inverse, p| inverse * p);
            }
            InverseMass::Matrix(inverse) => {
                velocity.fill(T::zero());
                inverse.multiply_add(T::one(), momentum, velocity);
            }
            InverseMass::Factor(factor, _) => {
                let mut numbers: Vec<f64> = momentum.iter().map(|number| number.to_f64()).collect();
                factor.solve_on_threads(&mut numbers, self.threads);
                velocity.iter_mut().zip(numbers).for_each(|(place, number)| *place = T::of(number));
            }
        }
    }
}

/// The pattern of the scenario's stiffness and these places.
fn with_base<T: Real>(size: usize, base: Option<&Matrix<T>>, places: &[(usize, usize)]) -> Arc<Pattern> {
    match base {
        Some(Matrix::Sparse(base)) if places.is_empty() => Arc::clone(&base.pattern),
        Some(Matrix::Sparse(base)) => {
            let more = Pattern::new(size, places.to_vec());
            Arc::new(Pattern::from_rows(base.pattern.rows().zip(more.rows()).map(|(own, other)| {
                let own = &base.pattern.columns()[own];
                let mut columns = [own, &more.columns()[other]].concat();
                columns.sort_unstable();
                columns.dedup();
                columns.into_iter().map(|column| column as usize).collect::<Vec<_>>()
            })))
        }
        Some(base) => {
            let own = base.entries().into_iter().map(|(row, column, _)| (row, column));
            Arc::new(Pattern::new(size, own.chain(places.iter().copied()).collect()))
        }
        None => Arc::new(Pattern::new(size, places.to_vec())),
    }
}

/// The scenario's stiffness by the slots of a pattern that has all its places.
fn of_base<T: Real>(base: Option<&Matrix<T>>, pattern: &Pattern) -> Shared<T> {
    if let Some(Matrix::Sparse(base)) = base
        && *base.pattern == *pattern
    {
        return base.values.clone();
    }
    let mut values = vec![T::zero(); pattern.len()];
    for (row, column, entry) in base.map(Matrix::entries).unwrap_or_default() {
        values[pattern.slot(row, column)] += entry;
    }
    Shared::Own(values)
}

/// A symmetric matrix of a scenario in the precision of `T`.
pub fn matrix<T: Real>(matrix: &SymmetricMatrix) -> Matrix<T> {
    match matrix {
        SymmetricMatrix::Diagonal(entries) => Matrix::Diagonal(vector(entries)),
        SymmetricMatrix::Dense(entries) => Matrix::Dense(vector(entries.as_slice())),
        SymmetricMatrix::Sparse(entries) => {
            let (pattern, values) = (Arc::clone(&entries.pattern), Shared::of(&entries.values));
            Matrix::Sparse(Sparse { pattern, values, threads: 1 })
        }
    }
}

/// Numbers of a scenario in the precision of `T`.
pub fn vector<T: Real>(numbers: &[f64]) -> Vec<T> {
    numbers.iter().map(|&number| T::of(number)).collect()
}

fn inverse<T: Real>(mass: &Matrix<T>, size: usize) -> Result<InverseMass<T>, MatrixError> {
    if let Matrix::Sparse(entries) = mass {
        return sparse_inverse(&entries.pattern, &entries.values);
    }
    dense_inverse(mass, size).map(InverseMass::Matrix)
}

/// The factor of a sparse mass; where that is diagonal, its inverse.
fn sparse_inverse<T: Real>(pattern: &Pattern, entries: &[T]) -> Result<InverseMass<T>, MatrixError> {
    let values: Vec<f64> = entries.iter().map(|entry| entry.to_f64()).collect();
    if pattern.band() == 0 {
        let full = pattern.len() == pattern.size() && values.iter().all(|&value| value > 0.0);
        let inverses = values.iter().map(|value| T::of(value.recip())).collect();
        let inverse = InverseMass::Matrix(Matrix::Diagonal(inverses));
        return if full { Ok(inverse) } else { Err(MatrixError::NotPositiveDefinite) };
    }
    let factor =
        Analysis::new(pattern).factor_of(pattern, &values).map_err(|_| MatrixError::NotPositiveDefinite)?;
    // The sum of a row is the mass that moves with it; where couplings make that too small, its own entry.
    let masses = pattern.rows().enumerate().map(|(row, slots)| {
        let own = values[pattern.slot(row, row)];
        let sum: f64 = values[slots].iter().sum();
        T::of(sum.max(0.5 * own))
    });
    Ok(InverseMass::Factor(Arc::new(factor), masses.collect()))
}

fn dense_inverse<T: Real>(mass: &Matrix<T>, size: usize) -> Result<Matrix<T>, MatrixError> {
    if let Matrix::Diagonal(entries) = mass {
        let inverses: Vec<T> = entries.iter().map(|&entry| T::one() / entry).collect();
        let good =
            entries.iter().zip(&inverses).all(|(entry, inverse)| *entry > T::zero() && inverse.is_finite());
        return if good { Ok(Matrix::Diagonal(inverses)) } else { Err(MatrixError::NotPositiveDefinite) };
    }
    let mut factors = vec![T::zero(); size * size];
    mass.add_to(T::one(), &mut factors, size, 0, 0);
    let mut pivots = vec![0; size];
    let mut columns = vec![T::zero(); size * size];
    factor(&mut factors, &mut pivots).map_err(|_| MatrixError::NotPositiveDefinite)?;
    invert_factored(&factors, &pivots, &mut columns);
    Ok(Matrix::Dense(columns))
}
