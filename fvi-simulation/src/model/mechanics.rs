//! The mechanical system of a scenario: mass, compiled potential and force.

use super::callbacks::Callbacks;
use super::elements::Elements;
use super::energies::{EnergyRoom, States, write_plain};
use super::loads::Loads;
use super::matrices::{Matrix, Sparse};
use super::moment::moment;
use super::rough_forces::RoughForces;
use super::shared::Shared;
use super::space::AnySpace;
use super::switches::{Side, SidedPoint, Switched};
use super::unbounded_forces::UnboundedForces;
use crate::model::tape::{CompiledForce, CompiledPotential, OwnRegisters, force_variables};
use fvi_core::{Block, Instant, MatrixError, Mechanics, NodalRule, Real};
use fvi_core::{combine_two, factor, invert_factored};
use fvi_fft::transfer::TransferFunction;
use fvi_scenario::language::expression::Elementary;
use fvi_scenario::scenario::{Derivative, SampledInput, Scenario, SymmetricMatrix, System};
use fvi_sparse::{Analysis, Factor, Pattern};
use std::sync::Arc;

/// M, U and F of a scenario, compiled once.
#[derive(Clone, Debug)]
pub struct Model<T> {
    mass: Matrix<T>,
    inverse_mass: InverseMass<T>,
    /// Number of threads for products and solutions.
    threads: usize,
    /// K of the scenario, including the springs of its kernels.
    base: Option<Matrix<T>>,
    /// Position at which these springs are at rest.
    anchor: Option<Anchor<T>>,
    elements: Vec<Elements<T>>,
    loads: Loads<T>,
    /// Loads of each load case, which has its own motion.
    cases: Vec<Loads<T>>,
    /// Energies of these motions.
    energies: Vec<T>,
    potential: Option<CompiledPotential<T>>,
    /// K of the quadratic part ½ qᵀKq + bᵀq of the potential, if there is one.
    quadratic: Option<Matrix<T>>,
    linear: Vec<(usize, T)>,
    force: CompiledForce<T>,
    /// True if there is a force at all.
    forced: bool,
    /// True if the stiffness is the same at every position and time.
    is_linear: bool,
    /// True if the restoring force is that of a constant matrix from files, or rows, alone.
    is_constant: bool,
    /// True if the restoring force is that of one expression alone, without jumps and kinks as switches.
    is_of_expression: bool,
    /// True if slopes of the forces that are not finite, as of √x at 0, are left out of Newton's matrix:
    /// forces alone decide what the iteration ends at.
    leaves_out_slopes: bool,
    /// Forces that are rough in time, with exact moments.
    rough: Option<Box<RoughForces>>,
    /// Potentials and forces supplied as code.
    own: Option<Callbacks>,
    /// The jumps and kinks of potential and force in the position, if steps end at them.
    potential_sides: Option<SidedPoint<T>>,
    force_sides: Option<SidedPoint<T>>,
    /// The constant part of the stiffness, by slot.
    constant: Sparse<T>,
    /// Slots of the entries of the potential's Hessian, and of their mirror images.
    hessian_slots: Vec<(u32, u32)>,
    /// Slots of the entries of the force's Jacobians with respect to the position, and to the velocity.
    jacobian_slots: Vec<usize>,
    resistance_slots: Vec<usize>,
    /// Data for forces that depend on the velocity.
    moving: Option<Moving<T>>,
    registers: Vec<T>,
    /// Registers for the gradient of the potential's remainder, and for both its derivatives.
    restoring_registers: OwnRegisters<T>,
    rest_registers: OwnRegisters<T>,
    /// Scratch vector of N numbers.
    pushed: Vec<T>,
    /// Entries of a Jacobian.
    entries: Vec<T>,
}

/// Data for forces that depend on the velocity.
#[derive(Clone, Debug)]
struct Moving<T> {
    /// True if expressions depend on the velocity.
    in_words: bool,
    /// The constant part of the resistance −∂F/∂v, by slot; empty if it is zero.
    constant: Vec<T>,
    /// q followed by v.
    point: Vec<T>,
}

/// Marker for the slot of an entry that is in the other matrix.
const NOWHERE: usize = usize::MAX;

/// Largest depth of arguments of jumps and kinks within each other.
const DEEPEST: usize = 64;

/// Inverse of the mass, with zeros in the rows and columns of coordinates without mass.
#[derive(Clone, Debug)]
enum InverseMass<T> {
    Matrix(Matrix<T>),
    /// The factor of a sparse mass, with ones for coordinates without mass, and a lumped mass for each
    /// coordinate for a first guess, infinite for those without mass.
    Factor(Arc<Factor>, Vec<T>),
}

/// Entries of the stiffness −∂F/∂q + ∂²U and of the resistance −∂F/∂v of a system: the constant ones with
/// their numbers, and the places of those that change.
struct Entries<T> {
    /// Of the quadratic parts of the potential and of elements, above or on the diagonal.
    springs: Vec<(usize, usize, T)>,
    /// Of the linear parts of the force in the position, and in the velocity.
    pushed: Vec<(usize, usize, T)>,
    resisted: Vec<(usize, usize, T)>,
    /// Places in the Hessian of the rest of the potential.
    curved: Vec<(usize, usize)>,
    /// Places in the Jacobian of the rest of the force; columns from N on belong to the velocities.
    turned: Vec<(usize, usize)>,
}

impl<T: Elementary> Entries<T> {
    fn of(
        size: usize,
        potential: Option<&CompiledPotential<T>>,
        force: &CompiledForce<T>,
        elements: &[Elements<T>],
    ) -> Self {
        let index = |&(row, column): &(u32, u32)| (row as usize, column as usize);
        let entry = |&(row, column, entry): &(u32, u32, T)| (row as usize, column as usize, entry);
        let quadratic =
            potential.into_iter().flat_map(|potential| potential.quadratic().stiffness.iter().map(entry));
        let (pushed, resisted): (Vec<_>, Vec<_>) =
            force.linear().iter().map(entry).partition(|&(_, column, _)| column < size);
        let resisted = resisted.into_iter().map(|(row, column, entry)| (row, column - size, entry));
        Self {
            springs: quadratic.chain(elements.iter().flat_map(Elements::springs)).collect(),
            pushed,
            resisted: resisted.collect(),
            curved: potential
                .into_iter()
                .flat_map(|potential| potential.pattern().iter().map(index))
                .collect(),
            turned: force.pattern().iter().map(index).collect(),
        }
    }

    /// All places, those of elements among them, in both triangles.
    fn places(&self, size: usize, elements: &[Elements<T>]) -> Vec<(usize, usize)> {
        let both = |(row, column): (usize, usize)| [(row, column), (column, row)];
        let springs = self.springs.iter().map(|&(row, column, _)| (row, column));
        let of_potential =
            springs.chain(self.curved.iter().copied()).chain(elements.iter().flat_map(Elements::places));
        let of_velocity =
            |&(row, column): &(usize, usize)| (row, if column < size { column } else { column - size });
        let linear = self.pushed.iter().chain(&self.resisted).map(|&(row, column, _)| (row, column));
        of_potential.flat_map(both).chain(linear.chain(self.turned.iter().map(of_velocity))).collect()
    }

    /// The slots of the potential's Hessian and of its mirror image.
    fn hessian_slots(&self, pattern: &Pattern) -> Vec<(u32, u32)> {
        let narrow = |slot: usize| u32::try_from(slot).expect("fewer slots than 2³²");
        let slot = |row: usize, column: usize| narrow(pattern.slot(row, column));
        self.curved.iter().map(|&(row, column)| (slot(row, column), slot(column, row))).collect()
    }

    /// The slots of the force's Jacobians by the position, and by the velocity. If the force depends on the
    /// velocity, both have a slot for every entry, marked if the entry is in the other matrix.
    fn jacobian_slots(&self, pattern: &Pattern, size: usize, in_words: bool) -> (Vec<usize>, Vec<usize>) {
        let turned = self.turned.iter();
        if !in_words {
            return (turned.map(|&(row, column)| pattern.slot(row, column)).collect(), Vec::new());
        }
        let slots = |&(row, column): &(usize, usize)| match column < size {
            true => (pattern.slot(row, column), NOWHERE),
            false => (NOWHERE, pattern.slot(row, column - size)),
        };
        turned.map(slots).unzip()
    }

    /// The constant part of the stiffness.
    fn constant_stiffness(&self, base: Option<&Matrix<T>>, pattern: &Arc<Pattern>) -> Sparse<T> {
        let mut values = of_base(base, pattern);
        for &(row, column, entry) in &self.springs {
            values.own()[pattern.slot(row, column)] += entry;
            if row != column {
                values.own()[pattern.slot(column, row)] += entry;
            }
        }
        for &(row, column, entry) in &self.pushed {
            values.own()[pattern.slot(row, column)] -= entry;
        }
        Sparse { pattern: Arc::clone(pattern), values, threads: 1 }
    }

    /// The constant part of the resistance, by slot.
    fn constant_resistance(&self, pattern: &Pattern) -> Vec<T> {
        let mut constant = vec![T::zero(); pattern.len()];
        for &(row, column, entry) in &self.resisted {
            constant[pattern.slot(row, column)] -= entry;
        }
        constant
    }
}

/// Restoring forces that are the same at every position and time, by coordinate.
fn constant_forces<T: Elementary>(
    potential: Option<&CompiledPotential<T>>,
    elements: &[Elements<T>],
    anchor: Option<&Anchor<T>>,
    copies: usize,
) -> Vec<(usize, T)> {
    let linear = potential.into_iter().flat_map(|potential| potential.quadratic().linear.iter());
    linear
        .map(|&(coordinate, entry)| (coordinate as usize, entry))
        .chain(elements.iter().flat_map(Elements::constant_restoring_force))
        .chain(anchor.into_iter().flat_map(|anchor| anchor.restoring_forces(copies)))
        .collect()
}

impl<T: Elementary> Model<T> {
    /// Compiles the system of a scenario.
    ///
    /// # Errors
    /// If the mass, apart from rows and columns of zeros, is not positive definite in the precision of `T`.
    pub fn new(scenario: &Scenario) -> Result<Self, MatrixError> {
        Self::with_moduli(scenario, |transfer| Some(transfer.spring()))
    }

    /// The system as a jump of the position meets it: with the unrelaxed moduli K_m(∞) of its kernels, in
    /// place of K_m(0). Kernels that have none are left out; they allow no jump.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub(crate) fn unrelaxed(scenario: &Scenario) -> Result<Self, MatrixError> {
        Self::with_moduli(scenario, TransferFunction::unrelaxed)
    }

    fn with_moduli(scenario: &Scenario, modulus: Modulus) -> Result<Self, MatrixError> {
        let rough = RoughForces::of(scenario).map(Box::new);
        let unbounded = UnboundedForces::of(scenario);
        let scenario = unbounded.as_ref().map_or(scenario, |unbounded| &unbounded.rest);
        let system = &scenario.system;
        let size = system.coordinates();
        let threads = scenario.history.threads();
        let mass = matrix(&system.mass).on_threads(threads);
        let inverse_mass = inverse(&mass, &system.mass)?;
        // Adaptive steps end at jumps and kinks.
        let is_sided = scenario.time.adaptive().is_some() && scenario.cases.is_empty();
        let compiled = system.potential.as_ref().map(|potential| match is_sided {
            true => CompiledPotential::<T>::compile_sided(potential, (size, 'q')),
            false => (CompiledPotential::<T>::compile(potential, size), None),
        });
        let (potential, potential_sides) = compiled.map_or((None, None), |(u, sides)| (Some(u), sides));
        let components = system.force.as_deref().unwrap_or_default();
        let in_words = system.force_in_words_depends_on_velocity();
        let variables = force_variables(components);
        let (force, force_sides) = match is_sided {
            true => CompiledForce::<T>::compile_sided(components, variables),
            false => (CompiledForce::<T>::compile_of(components, variables), None),
        };
        let mut elements: Vec<_> =
            system.elements.iter().map(|element| Elements::<T>::new(element, is_sided)).collect();
        let base: Option<Matrix<T>> = system.stiffness.as_ref().map(|k| matrix(k).on_threads(threads));
        let base = with_springs_of_kernels(system, modulus, base, threads);
        let anchor = Anchor::of(scenario, modulus);
        let mut own = system.own_terms.clone().map(|terms| Callbacks::new(terms, size));
        let linear = constant_forces(potential.as_ref(), &elements, anchor.as_ref(), scenario.copies());
        let entries_of = Entries::of(size, potential.as_ref(), &force, &elements);
        let mut places = entries_of.places(size, &elements);
        places.extend(own.iter().flat_map(Callbacks::places));
        let pattern = with_base(size, base.as_ref(), &places);
        let pattern = match &system.known {
            Some(known) => known.pattern(pattern),
            None => pattern,
        };
        let hessian_slots = entries_of.hessian_slots(&pattern);
        let (jacobian_slots, resistance_slots) = entries_of.jacobian_slots(&pattern, size, in_words);
        elements.iter_mut().for_each(|elements| elements.settle(&pattern));
        own.iter_mut().for_each(|own| own.settle(&pattern));
        let moves = in_words || own.as_ref().is_some_and(Callbacks::depends_on_velocity);
        let moving = moves.then(|| Moving {
            in_words,
            constant: entries_of.constant_resistance(&pattern),
            point: vec![T::zero(); if in_words { 2 * size } else { 0 }],
        });
        let constant = entries_of.constant_stiffness(base.as_ref(), &pattern);
        let is_constant = places.is_empty()
            && potential.is_none()
            && force.is_zero()
            && elements.is_empty()
            && own.is_none();
        let springs = entries_of.springs;
        let entries = vec![T::zero(); jacobian_slots.len()];
        let quadratic = (!springs.is_empty()).then(|| Matrix::symmetric(size, springs.iter().copied()));
        let mut model = Self {
            mass,
            inverse_mass,
            threads,
            base,
            anchor,
            elements,
            loads: Loads::new(&system.loads),
            cases: scenario.cases.iter().map(|case| Loads::new(&case.loads)).collect(),
            energies: Vec::new(),
            quadratic,
            linear,
            potential,
            is_constant,
            is_of_expression: false,
            leaves_out_slopes: scenario.equation.is_some(),
            forced: !force.is_zero(),
            is_linear: false,
            rough,
            own,
            force,
            constant,
            hessian_slots,
            jacobian_slots,
            resistance_slots,
            moving,
            registers: Vec::new(),
            restoring_registers: OwnRegisters::default(),
            rest_registers: OwnRegisters::default(),
            pushed: vec![T::zero(); size * scenario.copies()],
            entries,
            potential_sides: potential_sides.map(SidedPoint::new),
            force_sides: force_sides.map(SidedPoint::new),
        };
        model.is_linear = model.has_constant_stiffness();
        model.is_of_expression = model.has_forces_of_expression();
        model.take_sides_at(&scenario.initial.position);
        Ok(model)
    }

    /// Sets the sides of switches from a position at t = 0. It is repeated, since the sides of arguments
    /// within arguments depend on others.
    pub(crate) fn take_sides_at(&mut self, position: &[f64]) {
        let (mut values, mut before) = (Vec::new(), Vec::new());
        for _ in 0..=self.switches().min(DEEPEST) {
            self.arguments(0.0, position, &mut values);
            let sides: Vec<Side> = values.iter().map(|&value| Side::of(value)).collect();
            if sides == before {
                return;
            }
            self.set_sides(&sides);
            before = sides;
        }
    }

    /// Time from which rough points in time may have been overlooked.
    pub fn unresolved_since(&self) -> Option<f64> {
        self.rough.as_ref().and_then(|rough| rough.unresolved_since())
    }

    /// Input that controllers change inside the next step.
    pub(crate) fn live(&mut self) -> Option<&mut SampledInput> {
        self.rough.as_mut().and_then(|rough| rough.live())
    }

    /// The energies of the motions under load cases, as of the last computation; empty without cases.
    pub fn energies(&self) -> &[T] {
        &self.energies
    }

    /// Subtracts the loads of the system, and those of the case of each motion.
    #[inline(always)]
    fn subtract_loads(&mut self, instant: Instant<T>, restoring: &mut [T]) {
        if !(self.loads.is_empty() && self.cases.is_empty()) {
            self.subtract_loads_there_are(instant, restoring);
        }
    }

    #[inline(never)]
    fn subtract_loads_there_are(&mut self, instant: Instant<T>, restoring: &mut [T]) {
        let size = self.mass.size().max(1);
        for restoring in restoring.chunks_mut(size) {
            self.loads.add(moment(instant), -T::one(), restoring);
        }
        for (loads, restoring) in self.cases.iter_mut().zip(restoring.chunks_mut(size)) {
            loads.add(moment(instant), -T::one(), restoring);
        }
    }

    /// K q + b.
    fn quadratic_restoring_force(&self, position: &[T], restoring: &mut [T]) {
        restoring.fill(T::zero());
        if let Some(base) = &self.base {
            base.multiply_add(T::one(), position, restoring);
        }
        if let Some(quadratic) = &self.quadratic {
            quadratic.multiply_add(T::one(), position, restoring);
        }
        for &(coordinate, entry) in &self.linear {
            restoring[coordinate] += entry;
        }
    }
}

impl<T: Elementary> Mechanics<T, AnySpace> for Model<T> {
    fn mass(&self) -> &Matrix<T> {
        &self.mass
    }

    #[inline(always)]
    fn velocity(&self, momentum: &[T], velocity: &mut [T]) {
        self.write_velocity(momentum, velocity);
    }

    #[inline(always)]
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

    #[inline(always)]
    fn restoring_force(&mut self, instant: Instant<T>, position: &Vec<T>, restoring: &mut [T]) {
        if !self.is_of_expression {
            return self.restoring_force_of_any(instant, position, restoring);
        }
        self.restoring_force_of_expression(position, restoring);
        if let Some(potential) = &self.potential {
            potential.add_rest_gradient_again(&mut self.restoring_registers, position, restoring);
        }
    }

    #[inline(always)]
    fn linearise(
        &mut self,
        instant: Instant<T>,
        position: &Vec<T>,
        restoring: &mut [T],
        stiffness: &mut Matrix<T>,
    ) {
        let (true, Matrix::Sparse(stiffness)) = (self.is_of_expression, &mut *stiffness) else {
            return self.linearise_any(instant, position, restoring, stiffness);
        };
        self.restoring_force_of_expression(position, restoring);
        let values = stiffness.values.own();
        values.copy_from_slice(&self.constant.values);
        if let Some(potential) = &self.potential {
            let places = (self.hessian_slots.as_slice(), values);
            potential.add_rest_derivatives_again(&mut self.rest_registers, position, restoring, places);
        }
    }

    fn depends_on_velocity(&self) -> bool {
        self.moving.is_some()
    }

    fn restoring_force_in_motion(
        &mut self,
        instant: Instant<T>,
        position: &Vec<T>,
        velocity: &[T],
        restoring: &mut [T],
    ) {
        self.move_at(velocity);
        self.restoring_force(instant, position, restoring);
    }

    fn linearise_in_motion(
        &mut self,
        instant: Instant<T>,
        position: &Vec<T>,
        velocity: &[T],
        restoring: &mut [T],
        stiffness: &mut Matrix<T>,
    ) {
        self.move_at(velocity);
        self.linearise(instant, position, restoring, stiffness);
    }

    fn resistance(&mut self, _: Instant<T>, _: &Vec<T>, _: &[T], resistance: &mut Matrix<T>) {
        let (Some(moving), Matrix::Sparse(resistance)) = (&self.moving, resistance) else { return };
        let values = resistance.values.own();
        values.copy_from_slice(&moving.constant);
        // The derivatives at the last linearisation.
        for (&slot, &entry) in self.resistance_slots.iter().zip(&self.entries) {
            if slot != NOWHERE {
                values[slot] -= entry;
            }
        }
        // Terms in code have full matrices, row by row.
        let in_code = self.own.iter().flat_map(Callbacks::resistance);
        values.iter_mut().zip(in_code).for_each(|(value, &entry)| *value += T::of(entry));
    }

    fn stiffness(&self) -> Matrix<T> {
        Matrix::Sparse(self.constant.clone())
    }

    fn is_rough(&self) -> bool {
        self.rough.is_some()
    }

    fn moment_correction(&mut self, rule: &NodalRule<'_, T>, moment_correction: &mut [T]) -> bool {
        self.rough.as_mut().is_some_and(|rough| rough.moment_correction(rule, moment_correction))
    }

    fn is_linear(&self) -> bool {
        self.is_linear
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
            for (energy, (q, restoring)) in self.energies.iter_mut().zip(pairs) {
                *energy += half * product(q, restoring);
            }
        }
        self.pushed = velocity;
        if let Some(anchor) = &self.anchor {
            energy += position.chunks(size).fold(T::zero(), |sum, q| sum + anchor.energy(q));
            for (energy, q) in self.energies.iter_mut().zip(position.chunks(size)) {
                *energy += anchor.energy(q);
            }
        }
        for elements in &mut self.elements {
            energy += elements.value(position);
        }
        if let Some(own) = &mut self.own {
            energy += own.potential(position);
        }
        energy
    }
}

/// The position, followed by the velocity if expressions depend on it.
#[inline(always)]
fn with_velocity<'a, T: Elementary>(moving: &'a mut Option<Moving<T>>, position: &'a [T]) -> &'a [T] {
    match moving {
        Some(Moving { in_words: true, point, .. }) => {
            point.iter_mut().zip(position).for_each(|(place, &number)| *place = number);
            point
        }
        _ => position,
    }
}

/// A position, followed by the sides of jumps and kinks if there are any.
#[inline(always)]
fn sided<'a, T: Elementary>(sides: &'a mut Option<SidedPoint<T>>, position: &'a [T]) -> &'a [T] {
    match sides {
        Some(sides) => sides.at(position),
        None => position,
    }
}

/// Switches are numbered in the order: potential, forces, elements group by group.
impl<T: Elementary> Switched for Model<T> {
    fn switches(&self) -> usize {
        let of_expressions = [&self.potential_sides, &self.force_sides].into_iter().flatten();
        of_expressions.map(SidedPoint::len).sum::<usize>()
            + self.elements.iter().map(Elements::switches).sum::<usize>()
    }

    fn set_sides(&mut self, mut sides: &[Side]) {
        for point in [&mut self.potential_sides, &mut self.force_sides].into_iter().flatten() {
            let (own, others) = sides.split_at(point.len());
            point.set(own);
            sides = others;
        }
        for elements in &mut self.elements {
            let (own, others) = sides.split_at(elements.switches());
            elements.set_sides(own);
            sides = others;
        }
    }

    fn arguments(&mut self, time: f64, position: &[f64], values: &mut Vec<f64>) {
        values.clear();
        values.resize(self.switches(), 0.0);
        let mut values = values.as_mut_slice();
        for point in [&mut self.potential_sides, &mut self.force_sides].into_iter().flatten() {
            let (own, others) = values.split_at_mut(point.len());
            point.values(time, position, own);
            values = others;
        }
        for elements in &mut self.elements {
            let (own, others) = values.split_at_mut(elements.switches());
            elements.arguments(time, position, own);
            values = others;
        }
    }

    fn argument_scales(&mut self, time: f64, position: &[f64], scales: &mut Vec<[f64; 2]>) {
        scales.clear();
        scales.resize(self.switches(), [0.0; 2]);
        let mut scales = scales.as_mut_slice();
        for point in [&mut self.potential_sides, &mut self.force_sides].into_iter().flatten() {
            let (own, others) = scales.split_at_mut(point.len());
            point.scales(time, position, own);
            scales = others;
        }
        for elements in &mut self.elements {
            let (own, others) = scales.split_at_mut(elements.switches());
            elements.argument_scales(time, position, own);
            scales = others;
        }
    }

    fn sided_potential(&mut self, position: &[f64]) -> f64 {
        let position: Vec<T> = vector(position);
        let of_elements: f64 =
            self.elements.iter_mut().map(|elements| elements.sided_potential(&position)).sum();
        match (&self.potential, &mut self.potential_sides) {
            (Some(potential), Some(sides)) => {
                potential.sided_rest(sides.at(&position), &mut self.registers).to_f64() + of_elements
            }
            _ => of_elements,
        }
    }

    fn describe_switch(&self, mut index: usize) -> String {
        for (point, place) in [(&self.potential_sides, "potential"), (&self.force_sides, "force")] {
            let Some(point) = point else { continue };
            if index < point.len() {
                return format!("{} of `system.{place}`", point.name(index));
            }
            index -= point.len();
        }
        for (number, elements) in self.elements.iter().enumerate() {
            if index < elements.switches() {
                let (name, place) = elements.describe_switch(index);
                return format!("{name} of `system.element[{number}].potential` at coordinates[{place}]");
            }
            index -= elements.switches();
        }
        String::new()
    }
}

impl<T: Elementary> Model<T> {
    /// True if the energy has the form ½ Σ p_i²/m_i + U(q) with one expression for U.
    pub fn has_plain_energy(&self) -> bool {
        let diagonal = matches!(self.inverse_mass, InverseMass::Matrix(Matrix::Diagonal(_)));
        diagonal
            && self.base.is_none()
            && self.elements.is_empty()
            && self.own.is_none()
            && self.cases.is_empty()
    }

    /// Writes the energies of `energies.len()` states, with the same bits as one by one.
    ///
    /// Only for systems with a [plain](Self::has_plain_energy) energy; otherwise nothing is written. `room`
    /// must be used for this system only.
    pub fn write_energies(&self, states: &States<'_>, room: &mut EnergyRoom<T>, energies: &mut [f64]) {
        if let InverseMass::Matrix(Matrix::Diagonal(inverse_masses)) = &self.inverse_mass {
            write_plain(inverse_masses, self.potential.as_ref(), states, room, energies);
        }
    }
}

impl<T: Elementary> Model<T> {
    /// Sets the velocity for the next evaluation.
    fn move_at(&mut self, velocity: &[T]) {
        let size = self.mass.size();
        if let Some(Moving { point, .. }) = &mut self.moving {
            point.iter_mut().skip(size).zip(velocity).for_each(|(place, &number)| *place = number);
        }
        if let Some(own) = &mut self.own {
            own.move_at(velocity);
        }
    }

    /// True if the stiffness is the same at every position and time.
    fn has_constant_stiffness(&self) -> bool {
        self.own.as_ref().is_none_or(|own| !own.depends_on_position())
            && self.potential.as_ref().is_none_or(CompiledPotential::is_quadratic)
            && self.elements.iter().all(Elements::is_quadratic)
            && self.force.is_affine()
    }

    /// The part of the potential that is given as an expression.
    fn potential_energy(&mut self, position: &[T]) -> T {
        let potential = self.potential.as_ref();
        potential.map_or(T::zero(), |potential| potential.value(position, &mut self.registers))
    }

    /// K q + b of the potential alone.
    #[inline(always)]
    fn restoring_force_of_expression(&self, position: &[T], restoring: &mut [T]) {
        // As many numbers as the force has: where these are known, so are those.
        let position = &position[..restoring.len()];
        restoring.fill(T::zero());
        if let Some(quadratic) = &self.quadratic {
            quadratic.multiply_add(T::one(), position, restoring);
        }
        for &(coordinate, entry) in &self.linear {
            restoring[coordinate] += entry;
        }
    }

    /// True if the restoring force is that of the potential's expression alone.
    fn has_forces_of_expression(&self) -> bool {
        let is_loaded = !self.loads.is_empty() || !self.cases.is_empty();
        let is_more = self.base.is_some() || self.own.is_some() || !self.elements.is_empty();
        !(is_loaded || is_more || self.forced || self.moving.is_some() || self.potential_sides.is_some())
    }

    /// [`restoring_force`](Mechanics::restoring_force) with all there may be.
    #[inline(never)]
    fn restoring_force_of_any(&mut self, instant: Instant<T>, position: &[T], restoring: &mut [T]) {
        self.quadratic_restoring_force(position, restoring);
        if let Some(potential) = &self.potential {
            let point = sided(&mut self.potential_sides, position);
            potential.add_rest_gradient_again(&mut self.restoring_registers, point, restoring);
        }
        self.elements.iter_mut().for_each(|elements| elements.add_rest_gradient(position, restoring));
        self.subtract_loads(instant, restoring);
        if self.forced {
            let position = with_velocity(&mut self.moving, position);
            let point = sided(&mut self.force_sides, position);
            self.force.value(moment(instant), point, &mut self.registers, &mut self.pushed);
            restoring.iter_mut().zip(&self.pushed).for_each(|(restoring, &force)| *restoring -= force);
        }
        if let Some(own) = &mut self.own {
            own.add_restoring_force(moment(instant), position, restoring);
        }
    }

    /// [`linearise`](Mechanics::linearise) with all there may be.
    #[inline(never)]
    fn linearise_any(
        &mut self,
        instant: Instant<T>,
        position: &[T],
        restoring: &mut [T],
        stiffness: &mut Matrix<T>,
    ) {
        let Matrix::Sparse(stiffness) = stiffness else {
            return self.restoring_force_of_any(instant, position, restoring);
        };
        self.quadratic_restoring_force(position, restoring);
        if self.is_constant {
            stiffness.values = self.constant.values.clone();
            return self.subtract_loads(instant, restoring);
        }
        let values = stiffness.values.own();
        values.copy_from_slice(&self.constant.values);
        if let Some(potential) = &self.potential {
            let places = (self.hessian_slots.as_slice(), &mut *values);
            let point = sided(&mut self.potential_sides, position);
            potential.add_rest_derivatives_again(&mut self.rest_registers, point, restoring, places);
        }
        if let Some(own) = &mut self.own {
            own.add_linearisation(moment(instant), position, restoring, values);
        }
        for elements in &mut self.elements {
            elements.add_rest_derivatives(position, restoring, values);
        }
        self.subtract_loads(instant, restoring);
        if !self.forced {
            return;
        }
        let (registers, pushed) = (&mut self.registers, &mut self.pushed);
        let jacobian = &mut self.entries[..self.jacobian_slots.len()];
        let position = with_velocity(&mut self.moving, position);
        let point = sided(&mut self.force_sides, position);
        self.force.derivatives(moment(instant), point, registers, pushed, jacobian);
        restoring.iter_mut().zip(pushed).for_each(|(restoring, force)| *restoring -= *force);
        if self.resistance_slots.is_empty() {
            let leaves_out = self.leaves_out_slopes;
            for (&slot, &mut entry) in self.jacobian_slots.iter().zip(jacobian) {
                if !leaves_out || entry.is_finite() {
                    values[slot] -= entry;
                }
            }
        } else {
            for (&slot, &mut entry) in self.jacobian_slots.iter().zip(jacobian) {
                if slot != NOWHERE {
                    values[slot] -= entry;
                }
            }
        }
    }

    /// M⁻¹ p.
    #[inline(always)]
    fn write_velocity(&self, momentum: &[T], velocity: &mut [T]) {
        match &self.inverse_mass {
            InverseMass::Matrix(Matrix::Diagonal(inverse)) if inverse.len() == momentum.len() => {
                combine_two(velocity, inverse, momentum, |_, inverse, p| inverse * p);
            }
            _ => self.write_velocity_of_any(momentum, velocity),
        }
    }

    #[inline(never)]
    fn write_velocity_of_any(&self, momentum: &[T], velocity: &mut [T]) {
        match &self.inverse_mass {
            InverseMass::Matrix(inverse) => {
                velocity.fill(T::zero());
                inverse.multiply_add(T::one(), momentum, velocity);
            }
            InverseMass::Factor(factor, masses) => {
                let mut numbers: Vec<f64> = momentum.iter().map(|number| number.to_f64()).collect();
                factor.solve_on_threads(&mut numbers, self.threads);
                for ((place, number), mass) in velocity.iter_mut().zip(numbers).zip(masses.iter().cycle()) {
                    *place = if mass.is_finite() { T::of(number) } else { T::zero() };
                }
            }
        }
    }
}

/// The initial position q₀ at which the springs K_m(0) ρ_m of kernels that act on q − q₀ are at rest: ½ (q −
/// q₀)ᵀ C (q − q₀) = ½ qᵀCq − (C q₀)ᵀq + ½ q₀ᵀC q₀ with C = Σ K_m(0) ρ_m.
#[derive(Clone, Debug)]
struct Anchor<T> {
    /// C q₀.
    restoring: Vec<T>,
    /// ½ q₀ᵀC q₀.
    energy: T,
}

impl<T: Real> Anchor<T> {
    fn of(scenario: &Scenario, modulus: Modulus) -> Option<Self> {
        let position = scenario.initial.base();
        let mut restoring = vec![0.0; position.len()];
        for term in &scenario.system.damping {
            let Some(spring) = modulus(&term.transfer) else { continue };
            let from_rest = term.derivative == Derivative::Caputo && term.transfer.exponent() != Some(0.0);
            if spring != 0.0 && from_rest {
                restoring
                    .iter_mut()
                    .zip(term.coefficient.times(position))
                    .for_each(|(sum, x)| *sum += spring * x);
            }
        }
        let energy: f64 =
            0.5 * restoring.iter().zip(position).map(|(restoring, q)| restoring * q).sum::<f64>();
        (restoring.iter().any(|&restoring| restoring != 0.0))
            .then(|| Self { restoring: vector(&restoring), energy: T::of(energy) })
    }

    /// (coordinate, entry) of the constant part of the gradient, for `copies` motions one after another.
    fn restoring_forces(&self, copies: usize) -> impl Iterator<Item = (usize, T)> + '_ {
        let size = self.restoring.len();
        let of_motion = move |motion: usize| {
            self.restoring
                .iter()
                .enumerate()
                .map(move |(index, &restoring)| (motion * size + index, -restoring))
        };
        (0..copies).flat_map(of_motion)
    }

    /// The energy in addition to ½ qᵀCq.
    fn energy(&self, position: &[T]) -> T {
        position.iter().zip(&self.restoring).fold(self.energy, |sum, (&q, &restoring)| sum - q * restoring)
    }
}

/// The modulus of the spring that stands for a kernel, if one does.
type Modulus = fn(&TransferFunction) -> Option<f64>;

/// K with the springs of kernels added, K + Σ K_m(0) ρ_m.
fn with_springs_of_kernels<T: Real>(
    system: &System,
    modulus: Modulus,
    base: Option<Matrix<T>>,
    threads: usize,
) -> Option<Matrix<T>> {
    let springs: Vec<(f64, Matrix<T>)> = system
        .damping
        .iter()
        .filter_map(|term| Some((modulus(&term.transfer)?, matrix(&term.coefficient))))
        .filter(|(spring, _)| *spring != 0.0)
        .collect();
    if springs.is_empty() {
        return base;
    }
    let lower = |factor: T, matrix: &Matrix<T>| -> Vec<(usize, usize, T)> {
        let entries = matrix.entries().into_iter().filter(|(row, column, _)| row >= column);
        entries.map(|(row, column, entry)| (row, column, factor * entry)).collect()
    };
    let own = base.iter().flat_map(|base| lower(T::one(), base));
    let all: Vec<_> =
        own.chain(springs.iter().flat_map(|(spring, rho)| lower(T::of(*spring), rho))).collect();
    Some(Matrix::symmetric(system.coordinates(), all.into_iter()).on_threads(threads))
}

/// The union of the pattern of the scenario's stiffness and these places.
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

/// The values of the scenario's stiffness by the slots of a pattern that includes its own.
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

fn inverse<T: Real>(mass: &Matrix<T>, given: &SymmetricMatrix) -> Result<InverseMass<T>, MatrixError> {
    let massless = given.zero_rows();
    match (mass, given) {
        (Matrix::Sparse(entries), SymmetricMatrix::Sparse(given)) => {
            if massless.is_empty() {
                return sparse_inverse(&entries.pattern, &entries.values, &massless);
            }
            let (pattern, values) = given.with_ones(&massless);
            sparse_inverse(&pattern, &vector(&values), &massless)
        }
        _ => dense_inverse(mass, &massless).map(InverseMass::Matrix),
    }
}

/// The factor of a sparse mass; for a diagonal mass its inverse.
fn sparse_inverse<T: Real>(
    pattern: &Pattern,
    entries: &[T],
    massless: &[usize],
) -> Result<InverseMass<T>, MatrixError> {
    let values: Vec<f64> = entries.iter().map(|entry| entry.to_f64()).collect();
    if pattern.band() == 0 {
        let full = pattern.len() == pattern.size() && values.iter().all(|&value| value > 0.0);
        let mut inverses: Vec<T> = values.iter().map(|value| T::of(value.recip())).collect();
        massless.iter().for_each(|&row| inverses[row] = T::zero());
        let inverse = InverseMass::Matrix(Matrix::Diagonal(inverses));
        return if full { Ok(inverse) } else { Err(MatrixError::NotPositiveDefinite) };
    }
    let factor =
        Analysis::new(pattern).factor_of(pattern, &values).map_err(|_| MatrixError::NotPositiveDefinite)?;
    // Lumped mass: the sum of a row, or, if couplings make that too small, the diagonal entry.
    let masses = pattern.rows().enumerate().map(|(row, slots)| {
        let own = values[pattern.slot(row, row)];
        let sum: f64 = values[slots].iter().sum();
        T::of(sum.max(0.5 * own))
    });
    let mut masses: Vec<T> = masses.collect();
    massless.iter().for_each(|&row| masses[row] = T::of(f64::INFINITY));
    Ok(InverseMass::Factor(Arc::new(factor), masses))
}

fn dense_inverse<T: Real>(mass: &Matrix<T>, massless: &[usize]) -> Result<Matrix<T>, MatrixError> {
    if let Matrix::Diagonal(entries) = mass {
        let mut inverses: Vec<T> = entries.iter().map(|&entry| T::one() / entry).collect();
        // Only coordinates without mass; a mass that is rounded to zero is not among them.
        massless.iter().for_each(|&row| inverses[row] = T::zero());
        let mut pairs = entries.iter().zip(&inverses).enumerate();
        let good = pairs.all(|(row, (entry, inverse))| {
            (*entry > T::zero() && inverse.is_finite()) || massless.binary_search(&row).is_ok()
        });
        return if good { Ok(Matrix::Diagonal(inverses)) } else { Err(MatrixError::NotPositiveDefinite) };
    }
    let size = mass.size();
    let mut factors = vec![T::zero(); size * size];
    mass.add_to(T::one(), &mut factors, size, 0, 0);
    massless.iter().for_each(|&row| factors[row * size + row] = T::one());
    let mut pivots = vec![0; size];
    let mut columns = vec![T::zero(); size * size];
    factor(&mut factors, &mut pivots).map_err(|_| MatrixError::NotPositiveDefinite)?;
    invert_factored(&factors, &pivots, &mut columns);
    massless.iter().for_each(|&row| columns[row * size + row] = T::zero());
    Ok(Matrix::Dense(columns))
}
