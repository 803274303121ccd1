//! The mechanism of a scenario: its Lagrangian, constraints and elongations, compiled.

use super::mechanics::Model;
use super::space::AnySpace;
use crate::model::tape::CompiledFunction;
use fvi_core::{Instant, Lagrangian, MatrixError, Mechanics, Second, max_or_nan};
use fvi_scenario::language::expression::{Elementary, Expression, Moment};
use fvi_scenario::scenario::{Quantity, Scenario, Scheme, SymmetricMatrix};

/// T(q, v) − U(q) with forces, constraints and elongations of a scenario.
#[derive(Clone, Debug)]
pub struct Mechanism<T> {
    /// Potential and forces of all kinds.
    model: Model<T>,
    /// The potential alone, for a scheme with discrete gradients.
    conservative: Option<Box<Model<T>>>,
    /// T; absent: ½ vᵀ M v with the mass, row by row.
    kinetic: Option<CompiledFunction<T>>,
    mass: Vec<T>,
    constraints: Vec<CompiledFunction<T>>,
    /// What constraints are multiplied by, and their multipliers divided.
    unit: T,
    elongations: Vec<Elongation<T>>,
    /// q, and q followed by v.
    position: Vec<T>,
    point: Vec<T>,
    restoring: Vec<T>,
    gradient: Vec<T>,
    hessian: Vec<T>,
    registers: Vec<T>,
}

/// g(q) of a damper.
#[derive(Clone, Debug)]
enum Elongation<T> {
    /// A coordinate.
    Coordinate(usize),
    /// A function of them.
    Function(Box<CompiledFunction<T>>),
}

impl<T: Elementary> Mechanism<T> {
    /// Compiles the system of a scenario.
    ///
    /// # Errors
    /// If the mass at the start is not positive definite in the precision of `T`.
    pub fn new(scenario: &Scenario) -> Result<Self, MatrixError> {
        let system = &scenario.system;
        let count = system.coordinates();
        let elongations = system.damping.iter().flat_map(|term| match &term.along {
            Some(along) => {
                let of_function =
                    |g: &Expression| Elongation::Function(Box::new(CompiledFunction::compile(g, count)));
                along.elongations.iter().map(of_function).collect::<Vec<_>>()
            }
            None => damped_coordinates(scenario, term).into_iter().map(Elongation::Coordinate).collect(),
        });
        let elongations = elongations.collect();
        let compile = |c: &Expression| CompiledFunction::compile(c, count);
        let constraints = system.constraints.iter().map(compile).collect();
        let kinetic = system.kinetic.as_ref().map(|kinetic| CompiledFunction::compile(kinetic, 2 * count));
        let mut mass = vec![T::zero(); count * count];
        for column in 0..count {
            let mut unit = vec![0.0; count];
            unit[column] = 1.0;
            for (row, entry) in system.mass.times(&unit).into_iter().enumerate() {
                mass[row * count + column] = T::of(entry);
            }
        }
        let mut undamped = without_dampers(scenario);
        let zeros = |count: usize| vec![T::zero(); count];
        let model = Model::new(&undamped)?;
        let conservative = if scenario.scheme == Scheme::Energy {
            undamped.system.force = None;
            undamped.system.loads.clear();
            undamped.system.own_terms = None;
            undamped.input = None;
            Some(Box::new(Model::new(&undamped)?))
        } else {
            None
        };
        Ok(Self {
            model,
            conservative,
            kinetic,
            mass,
            constraints,
            unit: T::one(),
            elongations,
            position: zeros(count),
            point: zeros(2 * count),
            restoring: zeros(count),
            gradient: zeros(2 * count),
            hessian: Vec::new(),
            registers: Vec::new(),
        })
    }

    /// Measures the constraints in a [unit](Self::unit) in which their gradients are about as large as the
    /// mass where it moves at first: elimination by the larger pivot would lose a mass of 10⁻²⁶ beside
    /// gradients of 1. It is a power of two, and stays 1 where the two are within a factor of 2²⁰.
    pub fn balance(&mut self, position: &[T], velocity: &[T]) {
        let (count, constraints) = (position.len(), self.constraints.len());
        let zeros = |count: usize| vec![T::zero(); count];
        let [mut mass, mut coupling, mut stiffness, mut resistance] = [(); 4].map(|()| zeros(count * count));
        let parts = Second {
            mass: &mut mass,
            coupling: &mut coupling,
            stiffness: &mut stiffness,
            resistance: &mut resistance,
        };
        self.second(Instant::in_step(T::zero(), T::of(0.5), T::zero()), position, velocity, parts);
        let (mut values, mut gradients) = (zeros(constraints), zeros(constraints * count));
        self.constrain(position, &mut values, &mut gradients);
        let size = |numbers: &[T]| numbers.iter().fold(0.0, |most, x| max_or_nan(most, x.to_f64().abs()));
        let ratio = size(&mass) / size(&gradients);
        if ratio.is_normal() && ratio.log2().abs() > 20.0 {
            self.unit = T::of(ratio.log2().round().exp2());
        }
    }

    /// The factor of the constraints: their multipliers are those of the scenario divided by it.
    pub fn unit(&self) -> T {
        self.unit
    }

    /// The same with its constraints as they are written.
    #[must_use]
    pub fn in_units_of_scenario(self) -> Self {
        Self { unit: T::one(), ..self }
    }

    /// Potential and forces.
    pub fn model_mut(&mut self) -> &mut Model<T> {
        &mut self.model
    }

    /// Index of the first elongation that has no first or second derivatives at a position.
    pub fn first_not_differentiable(&mut self, position: &[T]) -> Option<usize> {
        let mut gradient = vec![T::zero(); self.position.len()];
        let (hessian, registers) = (&mut self.hessian, &mut self.registers);
        let is_rough = |elongation: &Elongation<T>| {
            let Elongation::Function(function) = elongation else { return false };
            hessian.resize(function.pattern().len(), T::zero());
            let now = Moment::inside(T::zero());
            function.derivatives(now, position, registers, &mut gradient, hessian);
            gradient.iter().chain(&*hessian).any(|entry| !entry.is_finite())
        };
        self.elongations.iter().position(is_rough)
    }

    /// Writes g of every elongation.
    pub fn lengths(&mut self, position: &[T], lengths: &mut [T]) {
        for (elongation, place) in self.elongations.iter().zip(lengths) {
            *place = match elongation {
                Elongation::Coordinate(index) => position[*index],
                Elongation::Function(function) => {
                    function.value(Moment::inside(T::zero()), position, &mut self.registers)
                }
            };
        }
    }

    /// U, ∂U/∂q, and ∂²U/∂q² if asked for.
    fn height(&mut self, position: &[T], gradient: &mut [T], hessian: Option<&mut [T]>) -> Option<T> {
        let model = &mut **self.conservative.as_mut()?;
        let count = position.len();
        self.position.copy_from_slice(position);
        let still = vec![T::zero(); count];
        let value = Mechanics::<T, AnySpace>::energy(model, &self.position, &still);
        let instant = Instant::in_step(T::zero(), T::of(0.5), T::zero());
        let Some(hessian) = hessian else {
            Mechanics::<T, AnySpace>::restoring_force(model, instant, &self.position, &mut self.restoring);
            gradient.copy_from_slice(&self.restoring);
            return Some(value);
        };
        let mut stiffness = Mechanics::<T, AnySpace>::stiffness(model);
        let restoring = &mut self.restoring;
        Mechanics::<T, AnySpace>::linearise(model, instant, &self.position, restoring, &mut stiffness);
        gradient.copy_from_slice(restoring);
        hessian.fill(T::zero());
        for (row, column, entry) in stiffness.entries() {
            hessian[row * count + column] = entry;
        }
        Some(value)
    }

    /// T at the point that was taken, with `factor` times its derivatives with respect to q added to others.
    fn add_kinetic(&mut self, factor: T, sum: &mut [T], hessian: Option<&mut [T]>) -> Option<T> {
        let kinetic = self.kinetic.as_ref()?;
        let (now, count) = (Moment::inside(T::zero()), self.position.len());
        let value = kinetic.value(now, &self.point, &mut self.registers);
        match hessian {
            None => kinetic.gradient(now, &self.point, &mut self.registers, &mut self.gradient),
            Some(hessian) => {
                let (registers, gradient) = (&mut self.registers, &mut self.gradient);
                self.hessian.resize(kinetic.pattern().len(), T::zero());
                kinetic.derivatives(now, &self.point, registers, gradient, &mut self.hessian);
                for (&(row, column), &entry) in kinetic.pattern().iter().zip(&self.hessian) {
                    // The lower triangle of the matrix of q and v.
                    if (row as usize) < count {
                        add_both(hessian, (row as usize, column as usize), count, factor * entry);
                    }
                }
            }
        }
        sum.iter_mut().zip(&self.gradient).for_each(|(place, &slope)| *place += factor * slope);
        Some(value)
    }

    /// Indices of the elongations in words.
    pub fn functions(&self) -> Vec<usize> {
        let is_function = |elongation: &Elongation<T>| matches!(elongation, Elongation::Function(_));
        (0..self.elongations.len()).filter(|&index| is_function(&self.elongations[index])).collect()
    }

    /// Writes ∂g/∂q of one elongation in words; zeros for others.
    pub fn slope(&mut self, elongation: usize, position: &[T], slope: &mut [T]) {
        slope.fill(T::zero());
        if let Some(Elongation::Function(function)) = self.elongations.get(elongation) {
            function.gradient(Moment::inside(T::zero()), position, &mut self.registers, slope);
        }
    }

    /// M(q) v of T.
    pub fn moved(&mut self, position: &[T], velocity: &[T], momentum: &mut [T]) {
        self.take(position, velocity);
        let count = position.len();
        let Some(kinetic) = &self.kinetic else {
            for (place, row) in momentum.iter_mut().zip(self.mass.chunks_exact(count.max(1))) {
                *place = row.iter().zip(velocity).fold(T::zero(), |sum, (&m, &v)| sum + m * v);
            }
            return;
        };
        let now = Moment::inside(T::zero());
        kinetic.gradient(now, &self.point, &mut self.registers, &mut self.gradient);
        momentum.copy_from_slice(&self.gradient[count..]);
        // Less the terms linear in v.
        self.point[count..].fill(T::zero());
        kinetic.gradient(now, &self.point, &mut self.registers, &mut self.gradient);
        momentum.iter_mut().zip(&self.gradient[count..]).for_each(|(place, &still)| *place -= still);
    }

    fn take(&mut self, position: &[T], velocity: &[T]) {
        let count = self.position.len();
        self.position.copy_from_slice(position);
        self.point[..count].copy_from_slice(position);
        self.point[count..].copy_from_slice(velocity);
    }
}

/// Potential and forces of a scenario: without dampers, which hold what the kernels of coordinates have of
/// springs, and with masses of 1 in place of a kinetic energy in words, whose mass nothing asks for.
pub fn without_dampers(scenario: &Scenario) -> Scenario {
    let mut undamped = scenario.clone();
    undamped.system.damping.clear();
    if undamped.system.kinetic.is_some() {
        undamped.system.mass = SymmetricMatrix::Diagonal(vec![1.0; scenario.coordinates()]);
    }
    undamped
}

/// Coordinates that a damping term without elongations acts on, or would with a parameter of `[sensitivity]`
/// other than 0.
pub fn damped_coordinates(scenario: &Scenario, term: &fvi_scenario::scenario::Damping) -> Vec<usize> {
    let silent = term.coefficient.zero_rows();
    let parameters = scenario.sensitivity.iter().flat_map(|sensitivity| &sensitivity.parameters);
    let changed: Vec<usize> = parameters
        .filter_map(|parameter| match &parameter.what {
            Quantity::Coefficient(own, change) => {
                std::ptr::eq(term, &scenario.system.damping[*own]).then_some(change)
            }
            _ => None,
        })
        .flat_map(|change| change.iter().map(|&(row, _, _)| row))
        .collect();
    let acts = |row: &usize| silent.binary_search(row).is_err() || changed.contains(row);
    (0..scenario.coordinates()).filter(acts).collect()
}

/// ρ of a damping term for its elongations, row by row.
pub fn coefficient_of<T: Elementary>(scenario: &Scenario, term: &fvi_scenario::scenario::Damping) -> Vec<T> {
    let (matrix, rows) = match &term.along {
        Some(along) => (&along.coefficient, (0..along.elongations.len()).collect()),
        None => (&term.coefficient, damped_coordinates(scenario, term)),
    };
    let column = |&column: &usize| {
        let mut unit = vec![0.0; matrix.size()];
        unit[column] = 1.0;
        matrix.times(&unit)
    };
    let columns: Vec<Vec<f64>> = rows.iter().map(column).collect();
    rows.iter().flat_map(|&row| columns.iter().map(move |column| T::of(column[row]))).collect()
}

impl<T: Elementary> Lagrangian<T> for Mechanism<T> {
    fn coordinates(&self) -> usize {
        self.position.len()
    }

    fn constraints(&self) -> usize {
        self.constraints.len()
    }

    fn elongations(&self) -> usize {
        self.elongations.len()
    }

    fn first(
        &mut self,
        instant: Instant<T>,
        position: &[T],
        velocity: &[T],
        momentum: &mut [T],
        force: &mut [T],
    ) {
        self.take(position, velocity);
        let count = position.len();
        Mechanics::<T, AnySpace>::restoring_force_in_motion(
            &mut self.model,
            instant,
            &self.position,
            velocity,
            &mut self.restoring,
        );
        force.iter_mut().zip(&self.restoring).for_each(|(place, &restoring)| *place = -restoring);
        match &self.kinetic {
            Some(kinetic) => {
                let now = Moment::inside(T::zero());
                kinetic.gradient(now, &self.point, &mut self.registers, &mut self.gradient);
                momentum.copy_from_slice(&self.gradient[count..]);
                force.iter_mut().zip(&self.gradient).for_each(|(place, &slope)| *place += slope);
            }
            None => {
                for (place, row) in momentum.iter_mut().zip(self.mass.chunks_exact(count)) {
                    *place = row.iter().zip(velocity).fold(T::zero(), |sum, (&m, &v)| sum + m * v);
                }
            }
        }
    }

    fn second(&mut self, instant: Instant<T>, position: &[T], velocity: &[T], parts: Second<'_, T>) {
        self.take(position, velocity);
        let count = position.len();
        let model = &mut self.model;
        let mut stiffness = Mechanics::<T, AnySpace>::stiffness(model);
        Mechanics::<T, AnySpace>::linearise_in_motion(
            model,
            instant,
            &self.position,
            velocity,
            &mut self.restoring,
            &mut stiffness,
        );
        parts.stiffness.fill(T::zero());
        for (row, column, entry) in stiffness.entries() {
            parts.stiffness[row * count + column] = -entry;
        }
        parts.resistance.fill(T::zero());
        if Mechanics::<T, AnySpace>::depends_on_velocity(model) {
            let mut resistance = Mechanics::<T, AnySpace>::stiffness(model);
            Mechanics::<T, AnySpace>::resistance(model, instant, &self.position, velocity, &mut resistance);
            for (row, column, entry) in resistance.entries() {
                parts.resistance[row * count + column] = -entry;
            }
        }
        parts.coupling.fill(T::zero());
        let Some(kinetic) = &self.kinetic else {
            parts.mass.copy_from_slice(&self.mass);
            return;
        };
        parts.mass.fill(T::zero());
        self.hessian.resize(kinetic.pattern().len(), T::zero());
        let now = Moment::inside(T::zero());
        kinetic.derivatives(now, &self.point, &mut self.registers, &mut self.gradient, &mut self.hessian);
        for (&(row, column), &entry) in kinetic.pattern().iter().zip(&self.hessian) {
            // The lower triangle of the matrix of q and v.
            let (row, column) = (row as usize, column as usize);
            match (row.checked_sub(count), column.checked_sub(count)) {
                (None, _) => add_both(parts.stiffness, (row, column), count, entry),
                (Some(row), Some(column)) => add_both(parts.mass, (row, column), count, entry),
                (Some(row), None) => {
                    parts.coupling[row * count + column] += entry;
                    parts.resistance[column * count + row] += entry;
                }
            }
        }
    }

    fn constrain(&mut self, position: &[T], values: &mut [T], jacobian: &mut [T]) {
        let now = Moment::inside(T::zero());
        let rows = jacobian.chunks_exact_mut(position.len().max(1));
        for ((constraint, value), row) in self.constraints.iter().zip(values).zip(rows) {
            *value = self.unit * constraint.value(now, position, &mut self.registers);
            constraint.gradient(now, position, &mut self.registers, row);
            row.iter_mut().for_each(|slope| *slope *= self.unit);
        }
    }

    fn add_constraint_curvature(&mut self, position: &[T], multipliers: &[T], factor: T, sum: &mut [T]) {
        let count = position.len();
        for (constraint, &multiplier) in self.constraints.iter().zip(multipliers) {
            self.hessian.resize(constraint.pattern().len(), T::zero());
            let gradient = &mut self.gradient[..count];
            let now = Moment::inside(T::zero());
            constraint.derivatives(now, position, &mut self.registers, gradient, &mut self.hessian);
            for (&(row, column), &entry) in constraint.pattern().iter().zip(&self.hessian) {
                add_both(
                    sum,
                    (row as usize, column as usize),
                    count,
                    self.unit * factor * multiplier * entry,
                );
            }
        }
    }

    fn elongate(&mut self, position: &[T], jacobian: &mut [T]) {
        let rows = jacobian.chunks_exact_mut(position.len().max(1));
        for (elongation, row) in self.elongations.iter().zip(rows) {
            match elongation {
                Elongation::Coordinate(index) => {
                    row.fill(T::zero());
                    row[*index] = T::one();
                }
                Elongation::Function(function) => {
                    function.gradient(Moment::inside(T::zero()), position, &mut self.registers, row);
                }
            }
        }
    }

    fn turn(&mut self, position: &[T], velocity: &[T], forces: &[T], turning: &mut [T], stiffness: &mut [T]) {
        let count = position.len();
        turning.fill(T::zero());
        let rows = turning.chunks_exact_mut(count.max(1));
        for ((elongation, row), &force) in self.elongations.iter().zip(rows).zip(forces) {
            let Elongation::Function(function) = elongation else { continue };
            self.hessian.resize(function.pattern().len(), T::zero());
            let gradient = &mut self.gradient[..count];
            let now = Moment::inside(T::zero());
            function.derivatives(now, position, &mut self.registers, gradient, &mut self.hessian);
            for (&(i, j), &entry) in function.pattern().iter().zip(&self.hessian) {
                let (i, j) = (i as usize, j as usize);
                add_both(stiffness, (i, j), count, -force * entry);
                row[j] += velocity[i] * entry;
                if i != j {
                    row[i] += velocity[j] * entry;
                }
            }
        }
    }

    fn has_constant_mass(&self) -> bool {
        self.kinetic.is_none()
    }

    fn potential(&mut self, position: &[T], gradient: &mut [T], hessian: Option<&mut [T]>) -> Option<T> {
        if self.kinetic.is_some() { None } else { self.height(position, gradient, hessian) }
    }

    fn polarised(
        &mut self,
        position: &[T],
        velocities: [&[T]; 2],
        gradient: &mut [T],
        mut hessian: Option<&mut [T]>,
    ) -> Option<[T; 2]> {
        self.kinetic.as_ref()?;
        let height = self.height(position, gradient, hessian.as_deref_mut())?;
        let mut sum = [-height, height.abs()];
        gradient.iter_mut().for_each(|place| *place = -*place);
        if let Some(hessian) = hessian.as_deref_mut() {
            hessian.iter_mut().for_each(|place| *place = -*place);
        }
        // T is a quadratic polynomial of v.
        let [one, other] = velocities;
        let half = T::of(0.5);
        let mean: Vec<T> = one.iter().zip(other).map(|(&v, &w)| half * (v + w)).collect();
        for (factor, velocity) in [(T::of(2.0), &mean[..]), (-half, one), (-half, other)] {
            self.take(position, velocity);
            let value = factor * self.add_kinetic(factor, gradient, hessian.as_deref_mut())?;
            sum = [sum[0] + value, sum[1] + value.abs()];
        }
        Some(sum)
    }

    fn energy(&mut self, position: &[T], velocity: &[T]) -> T {
        self.take(position, velocity);
        let count = position.len();
        let still = vec![T::zero(); count];
        let potential = Mechanics::<T, AnySpace>::energy(&mut self.model, &self.position, &still);
        let product = |a: &[T], b: &[T]| a.iter().zip(b).fold(T::zero(), |sum, (&a, &b)| sum + a * b);
        let Some(kinetic) = &self.kinetic else {
            let rows = self.mass.chunks_exact(count.max(1)).zip(velocity);
            return potential
                + T::of(0.5) * rows.fold(T::zero(), |sum, (row, &v)| sum + v * product(row, velocity));
        };
        let now = Moment::inside(T::zero());
        let value = kinetic.value(now, &self.point, &mut self.registers);
        kinetic.gradient(now, &self.point, &mut self.registers, &mut self.gradient);
        potential + (product(&self.gradient[count..], velocity) - value)
    }
}

/// Adds an entry and its mirror image.
fn add_both<T: Elementary>(matrix: &mut [T], (row, column): (usize, usize), count: usize, entry: T) {
    matrix[row * count + column] += entry;
    if row != column {
        matrix[column * count + row] += entry;
    }
}
