//! Elements: one compiled potential of a few coordinates, at many places.

use crate::language::expression::Elementary;
use crate::model::tape::CompiledPotential;
use crate::scenario::Element;
use fvi_sparse::Pattern;

/// The places of one potential.
#[derive(Clone, Debug)]
pub struct Elements<T> {
    potential: CompiledPotential<T>,
    /// Coordinates of each place, `width` each.
    coordinates: Vec<usize>,
    width: usize,
    /// Slots of the entries of each place's Hessian in the stiffness, and of their mirror images.
    slots: Vec<(usize, usize)>,
    point: Vec<T>,
    gradient: Vec<T>,
    hessian: Vec<T>,
    registers: Vec<T>,
}

impl<T: Elementary> Elements<T> {
    /// Compiles the potential.
    pub fn new(element: &Element) -> Self {
        let width = element.coordinates.first().map_or(1, Vec::len);
        let potential = CompiledPotential::<T>::compile(&element.potential, width);
        let zeros = |count: usize| vec![T::zero(); count];
        Self {
            coordinates: element.coordinates.iter().flatten().copied().collect(),
            width,
            slots: Vec::new(),
            point: zeros(width),
            gradient: zeros(width),
            hessian: zeros(potential.pattern().len()),
            registers: Vec::new(),
            potential,
        }
    }

    /// Whether the potential is a quadratic polynomial.
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
    pub fn constant_pull(&self) -> impl Iterator<Item = (usize, T)> + '_ {
        let linear = self.potential.quadratic().linear.iter();
        self.coordinates
            .chunks_exact(self.width)
            .flat_map(move |place| linear.clone().map(move |&(index, entry)| (place[index as usize], entry)))
    }

    /// Places of the rest's Hessian in the stiffness.
    pub fn places(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let pattern = self.potential.pattern().iter();
        self.coordinates.chunks_exact(self.width).flat_map(move |place| {
            pattern.clone().map(move |&(row, column)| (place[row as usize], place[column as usize]))
        })
    }

    /// Notes where the entries of the Hessian lie.
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

    /// Adds the gradient of what is not quadratic.
    pub fn add_rest_gradient(&mut self, position: &[T], pull: &mut [T]) {
        if self.is_quadratic() {
            return;
        }
        for place in self.coordinates.chunks_exact(self.width) {
            self.point.iter_mut().zip(place).for_each(|(x, &coordinate)| *x = position[coordinate]);
            self.gradient.fill(T::zero());
            self.potential.add_rest_gradient(&self.point, &mut self.registers, &mut self.gradient);
            place.iter().zip(&self.gradient).for_each(|(&coordinate, &force)| pull[coordinate] += force);
        }
    }

    /// Adds gradient and Hessian of what is not quadratic.
    pub fn add_rest_derivatives(&mut self, position: &[T], pull: &mut [T], stiffness: &mut [T]) {
        if self.is_quadratic() {
            return;
        }
        let count = self.hessian.len();
        for (index, place) in self.coordinates.chunks_exact(self.width).enumerate() {
            self.point.iter_mut().zip(place).for_each(|(x, &coordinate)| *x = position[coordinate]);
            self.gradient.fill(T::zero());
            let (registers, gradient) = (&mut self.registers, &mut self.gradient);
            self.potential.add_rest_derivatives(&self.point, registers, gradient, &mut self.hessian);
            place.iter().zip(&*gradient).for_each(|(&coordinate, &force)| pull[coordinate] += force);
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
