//! Elements: one compiled potential of a few coordinates, applied at many places.

use crate::model::switches::{Side, SidedPoint};
use crate::model::tape::CompiledPotential;
use fvi_scenario::language::expression::Elementary;
use fvi_scenario::scenario::Element;
use fvi_sparse::Pattern;

/// A potential and the places where it is applied.
#[derive(Clone, Debug)]
pub struct Elements<T> {
    potential: CompiledPotential<T>,
    /// Coordinates of each place, `width` each.
    coordinates: Vec<usize>,
    width: usize,
    /// Slots of the entries of each place's Hessian in the stiffness, and of their mirror images.
    slots: Vec<(usize, usize)>,
    point: Vec<T>,
    /// The sides of the jumps and kinks at each place, if steps end at them, and a buffer for one place.
    sides: Option<(Vec<Side>, SidedPoint<T>)>,
    gradient: Vec<T>,
    hessian: Vec<T>,
    registers: Vec<T>,
}

impl<T: Elementary> Elements<T> {
    /// Compiles the potential; with `is_sided` jumps and kinks are switches.
    pub(super) fn new(element: &Element, is_sided: bool) -> Self {
        let width = element.coordinates.first().map_or(1, Vec::len);
        let (potential, sides) = match is_sided {
            true => CompiledPotential::<T>::compile_sided(&element.potential, (width, 'x')),
            false => (CompiledPotential::<T>::compile(&element.potential, width), None),
        };
        let with_room = |sides| {
            let point = SidedPoint::new(sides);
            (vec![Side::Below; point.len() * element.coordinates.len()], point)
        };
        let zeros = |count: usize| vec![T::zero(); count];
        Self {
            coordinates: element.coordinates.iter().flatten().copied().collect(),
            width,
            slots: Vec::new(),
            point: zeros(width),
            sides: sides.map(with_room),
            gradient: zeros(width),
            hessian: zeros(potential.pattern().len()),
            registers: Vec::new(),
            potential,
        }
    }

    /// True if the potential is a quadratic polynomial.
    pub fn is_quadratic(&self) -> bool {
        self.potential.is_quadratic()
    }

    /// (row, column, entry) of the constant part of the stiffness: lower triangle with the diagonal.
    pub fn springs(&self) -> impl Iterator<Item = (usize, usize, T)> + '_ {
        let springs = self.potential.quadratic().stiffness.iter();
        self.coordinates.chunks_exact(self.width).flat_map(move |place| {
            springs.clone().map(move |&(row, column, entry)| {
                let (a, b) = (place[row as usize], place[column as usize]);
                (a.max(b), a.min(b), entry)
            })
        })
    }

    /// (coordinate, entry) of the constant part of the gradient.
    pub fn constant_restoring_force(&self) -> impl Iterator<Item = (usize, T)> + '_ {
        let linear = self.potential.quadratic().linear.iter();
        self.coordinates
            .chunks_exact(self.width)
            .flat_map(move |place| linear.clone().map(move |&(index, entry)| (place[index as usize], entry)))
    }

    /// Places of the entries of the remaining Hessian in the stiffness.
    pub fn places(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let pattern = self.potential.pattern().iter();
        self.coordinates.chunks_exact(self.width).flat_map(move |place| {
            pattern.clone().map(move |&(row, column)| (place[row as usize], place[column as usize]))
        })
    }

    /// Determines the slots of the entries of the Hessian.
    pub fn settle(&mut self, pattern: &Pattern) {
        let slots = self.places().map(|(row, column)| (pattern.slot(row, column), pattern.slot(column, row)));
        self.slots = slots.collect();
    }

    /// U.
    pub fn value(&mut self, position: &[T]) -> T {
        let mut sum = T::zero();
        for place in self.coordinates.chunks_exact(self.width) {
            self.point.iter_mut().zip(place).for_each(|(x, &coordinate)| *x = position[coordinate]);
            sum += self.potential.value(&self.point, &mut self.registers);
        }
        sum
    }

    /// Number of jumps and kinks of all places.
    pub(super) fn switches(&self) -> usize {
        self.sides.as_ref().map_or(0, |(sides, _)| sides.len())
    }

    /// Sets the sides of the switches.
    pub(super) fn set_sides(&mut self, new: &[Side]) {
        if let Some((sides, _)) = &mut self.sides {
            sides.copy_from_slice(new);
        }
    }

    /// Name of the function with the jump or kink, and the index of its row.
    pub(super) fn describe_switch(&self, index: usize) -> (String, usize) {
        let Some((_, point)) = &self.sides else { return Default::default() };
        (point.name(index % point.len()).to_owned(), index / point.len())
    }

    /// Calls a function for each place with its jumps and kinks, the values of its coordinates, and its part
    /// of `numbers`, which has the numbers of all places.
    fn at_switches<N>(
        &mut self,
        position: &[f64],
        numbers: &mut [N],
        call: impl Fn(&mut SidedPoint<T>, &[f64], &mut [N]),
    ) {
        let Some((sides, point)) = &mut self.sides else { return };
        let count = point.len();
        let places = self.coordinates.chunks_exact(self.width).zip(sides.chunks_exact(count));
        let mut local = vec![0.0; self.width];
        for ((place, sides), numbers) in places.zip(numbers.chunks_exact_mut(count)) {
            local.iter_mut().zip(place).for_each(|(x, &coordinate)| *x = position[coordinate]);
            point.set(sides);
            call(point, &local, numbers);
        }
    }

    /// Writes the arguments of the jumps and kinks.
    pub(super) fn arguments(&mut self, time: f64, position: &[f64], values: &mut [f64]) {
        self.at_switches(position, values, |point, local, values| point.values(time, local, values));
    }

    /// Writes the rates of change of the arguments with the position.
    pub(super) fn argument_scales(&mut self, time: f64, position: &[f64], scales: &mut [[f64; 2]]) {
        self.at_switches(position, scales, |point, local, scales| point.scales(time, local, scales));
    }

    /// The part of the potentials with jumps and kinks, evaluated on the present sides.
    pub(super) fn sided_potential(&mut self, position: &[T]) -> f64 {
        let Some((sides, point)) = &mut self.sides else { return 0.0 };
        let mut sum = 0.0;
        let sides = sides.chunks_exact(point.len());
        for (place, sides) in self.coordinates.chunks_exact(self.width).zip(sides) {
            self.point.iter_mut().zip(place).for_each(|(x, &coordinate)| *x = position[coordinate]);
            point.set(sides);
            sum += self.potential.sided_rest(point.at(&self.point), &mut self.registers).to_f64();
        }
        sum
    }

    /// Adds the gradient of the part that is not quadratic.
    pub fn add_rest_gradient(&mut self, position: &[T], restoring: &mut [T]) {
        if self.is_quadratic() {
            return;
        }
        for (index, place) in self.coordinates.chunks_exact(self.width).enumerate() {
            self.point.iter_mut().zip(place).for_each(|(x, &coordinate)| *x = position[coordinate]);
            self.gradient.fill(T::zero());
            let point = sided(&mut self.sides, index, &self.point);
            self.potential.add_rest_gradient(point, &mut self.registers, &mut self.gradient);
            place.iter().zip(&self.gradient).for_each(|(&coordinate, &force)| restoring[coordinate] += force);
        }
    }

    /// Adds gradient and Hessian of the part that is not quadratic.
    pub fn add_rest_derivatives(&mut self, position: &[T], restoring: &mut [T], stiffness: &mut [T]) {
        if self.is_quadratic() {
            return;
        }
        let count = self.hessian.len();
        for (index, place) in self.coordinates.chunks_exact(self.width).enumerate() {
            self.point.iter_mut().zip(place).for_each(|(x, &coordinate)| *x = position[coordinate]);
            self.gradient.fill(T::zero());
            let (registers, gradient) = (&mut self.registers, &mut self.gradient);
            let point = sided(&mut self.sides, index, &self.point);
            self.potential.add_rest_derivatives(point, registers, gradient, &mut self.hessian);
            place.iter().zip(&*gradient).for_each(|(&coordinate, &force)| restoring[coordinate] += force);
            let slots = &self.slots[index * count..(index + 1) * count];
            for (&(slot, mirrored), &entry) in slots.iter().zip(&self.hessian) {
                stiffness[slot] += entry;
                if slot != mirrored {
                    stiffness[mirrored] += entry;
                }
            }
        }
    }
}

/// The coordinates of a place, followed by its sides if there are any.
#[inline]
fn sided<'a, T: Elementary>(
    sides: &'a mut Option<(Vec<Side>, SidedPoint<T>)>,
    index: usize,
    local: &'a [T],
) -> &'a [T] {
    let Some((sides, point)) = sides else { return local };
    let count = point.len();
    point.set(&sides[index * count..(index + 1) * count]);
    point.at(local)
}
