//! Damping terms of a scenario whose memory has one channel per coordinate, or per direction of dampers.

use super::matrices::Matrix;
use super::space::AnySpace;
use fvi_core::{
    Block, DampedMotion, Damping, DampingError, Derivative, Kernel, Memory, MemoryError, Mismatch, Real,
    Sample, StateError, StateReader, StateWriter, Stateful, add_multiple,
};
use fvi_scenario::scenario::Attached;
use std::ops::Range;

/// Damping terms Σ_m ρ_m D^{β_m} q whose memory has K channels s = G q.
///
/// ```text
/// ρ_m D^{β_m} q = H_m D^{β_m} (G q) ,      ρ_m = H_m G
/// ```
///
/// G is the identity, selects the coordinates whose rows of ρ are not empty, or is Bᵀ for dampers ρ = B C Bᵀ,
/// one column each. The memory stores the motion G q in the space of its channels. Terms of different orders
/// with the same G share a memory of several kernels.
pub struct ChannelDamping<T: Real, M> {
    terms: Vec<Coefficient<T>>,
    directions: Directions<T>,
    /// K, times the number of motions.
    count: usize,
    channels: DampedMotion<T, AnySpace, M>,
    /// G applied to the sample: to its main node, and to the offsets of its nodes.
    from: Vec<T>,
    behind: Vec<T>,
    increments: Vec<T>,
    /// Known part of the derivatives: K numbers for each node and term.
    known: Vec<T>,
    scratch: Vec<T>,
    /// Scratch vector of N numbers.
    vector: Vec<T>,
}

/// ρ of a term.
pub struct Coefficient<T> {
    /// The matrix.
    pub rho: Matrix<T>,
    /// The diagonal of C, for dampers.
    pub strength: Vec<T>,
}

/// Directions whose motion the memory stores, the rows of G.
#[derive(Clone, Debug, PartialEq)]
pub enum Directions<T> {
    /// Every coordinate; their number.
    All(usize),
    /// These coordinates, ascending; the rows of all others are empty.
    Coordinates(Vec<usize>),
    /// Bᵀ q: the columns of B, each as (coordinate, number).
    Columns(Vec<Vec<(usize, T)>>),
}

impl<T: Real> Directions<T> {
    /// The coordinates at which a matrix has entries; `rows` are the ranges of each row's entries.
    pub fn of_rows(rows: impl Iterator<Item = Range<usize>>) -> Self {
        let filled = rows.enumerate().filter(|(_, slots)| !slots.is_empty());
        let mut coordinates: Vec<usize> = filled.map(|(row, _)| row).collect();
        // A matrix without entries has no damping, but its memory needs a channel.
        if coordinates.is_empty() {
            coordinates.push(0);
        }
        Self::Coordinates(coordinates)
    }

    /// The columns of dampers.
    pub fn of_dampers(attached: &Attached) -> Self {
        let entry = |&(coordinate, number): &(u32, f64)| (coordinate as usize, T::of(number));
        Self::Columns(attached.columns.iter().map(|column| column.iter().map(entry).collect()).collect())
    }

    /// K.
    pub fn count(&self) -> usize {
        match self {
            Self::All(count) => *count,
            Self::Coordinates(coordinates) => coordinates.len(),
            Self::Columns(columns) => columns.len(),
        }
    }

    /// True if G is the identity.
    fn are_all(&self) -> bool {
        matches!(self, Self::All(_))
    }

    /// G x, for each of the motions in x, N coordinates each, one after another.
    fn take(&self, x: &[T], coordinates: usize, out: &mut [T]) {
        let copies = x.chunks_exact(coordinates.max(1)).zip(out.chunks_exact_mut(self.count().max(1)));
        copies.for_each(|(x, out)| self.take_one(x, out));
    }

    fn take_one(&self, x: &[T], out: &mut [T]) {
        match self {
            Self::All(_) => out.copy_from_slice(x),
            // All coordinates are selected.
            Self::Coordinates(_) if x.len() == out.len() => out.copy_from_slice(x),
            Self::Coordinates(coordinates) => {
                out.iter_mut().zip(coordinates).for_each(|(place, &coordinate)| *place = x[coordinate]);
            }
            Self::Columns(columns) => {
                for (place, column) in out.iter_mut().zip(columns) {
                    *place = column.iter().fold(T::zero(), |sum, &(coordinate, b)| sum + b * x[coordinate]);
                }
            }
        }
    }

    /// out += H s for each motion; `vector` is scratch of the length of `out`.
    #[inline]
    fn give(&self, coefficient: &Coefficient<T>, s: &[T], vector: &mut [T], out: &mut [T]) {
        let Coefficient { rho, strength } = coefficient;
        let (size, count) = (|| rho.size().max(1), || self.count().max(1));
        match self {
            Self::All(_) => rho.multiply_add(T::one(), s, out),
            Self::Coordinates(_) if size() == count() => rho.multiply_add(T::one(), s, out),
            Self::Coordinates(coordinates) => {
                vector.fill(T::zero());
                for (s, vector) in s.chunks_exact(count()).zip(vector.chunks_exact_mut(size())) {
                    coordinates.iter().zip(s).for_each(|(&coordinate, &number)| vector[coordinate] = number);
                }
                rho.multiply_add(T::one(), vector, out);
            }
            Self::Columns(columns) => {
                for (s, out) in s.chunks_exact(count()).zip(out.chunks_exact_mut(size())) {
                    for ((column, &strength), &number) in columns.iter().zip(strength).zip(s) {
                        column.iter().for_each(|&(coordinate, b)| out[coordinate] += b * (strength * number));
                    }
                }
            }
        }
    }
}

impl<T: Real> Coefficient<T> {
    /// ρ, and the strengths of dampers.
    pub fn new(rho: Matrix<T>, attached: Option<&Attached>) -> Self {
        let strength = attached.map_or(&[][..], |attached| &attached.strength);
        Self { rho, strength: strength.iter().map(|&strength| T::of(strength)).collect() }
    }
}

impl<T: Real, M> ChannelDamping<T, M> {
    /// The memory.
    pub fn memory(&self) -> &M {
        self.channels.memory()
    }
}

impl<T: Real, M: Memory<T>> ChannelDamping<T, M> {
    /// The terms, one for each kernel, on a memory with these kernels and K channels for each node, and for
    /// each motion if `copies` are integrated together; every ρ must have been checked to be positive
    /// semidefinite.
    ///
    /// # Errors
    /// If the weights of the memory are not those of the kernels.
    pub fn new(
        kernels: &[Kernel],
        (terms, directions, copies): (Vec<Coefficient<T>>, Directions<T>, usize),
        derivative: Derivative,
        memory: M,
    ) -> Result<Self, DampingError> {
        let count = copies * directions.count();
        let size = terms.first().map_or(0, |term| term.rho.size());
        let channels = memory.channels();
        Ok(Self {
            channels: DampedMotion::new(&AnySpace::dense(count), kernels, derivative, memory)?,
            from: vec![T::zero(); count],
            behind: Vec::new(),
            increments: Vec::new(),
            known: vec![T::zero(); channels * terms.len()],
            scratch: vec![T::zero(); channels + count],
            vector: vec![T::zero(); copies * size],
            terms,
            directions,
            count,
        })
    }

    /// N.
    fn coordinates(&self) -> usize {
        self.terms.first().map_or(0, |term| term.rho.size())
    }

    /// Applies G to the sample unless G is the identity.
    fn take(&mut self, sample: &Sample<'_, T>) {
        if !self.directions.are_all() {
            let coordinates = self.coordinates();
            self.directions.take(sample.from, coordinates, &mut self.from);
            take_each(&self.directions, sample.behind, coordinates, &mut self.behind);
        }
    }

    /// [`add_known`](Damping::add_known) for any directions and nodes.
    #[inline(never)]
    fn add_known_of_any(&mut self, sample: &Sample<'_, T>, known: &mut [T]) -> Result<(), MemoryError> {
        self.take(sample);
        let Self {
            terms, directions, count, channels, from, behind, known: of_terms, scratch, vector, ..
        } = self;
        let of_channels =
            if directions.are_all() { Sample { ..*sample } } else { Sample { from, behind, ..*sample } };
        channels.memory_terms(&of_channels, of_terms)?;
        let (nodes, coordinates) = (sample.fractions.len(), sample.from.len());
        let mut rest = of_terms.as_mut_slice();
        for (kernel, term) in terms.iter().enumerate() {
            let (numbers, others) = rest.split_at_mut(*count * nodes);
            rest = others;
            if nodes == 1 {
                channels.complete(kernel, &of_channels, numbers);
                directions.give(term, numbers, vector, known);
                continue;
            }
            for (node, known) in known.chunks_exact_mut(coordinates.max(1)).enumerate() {
                let sum = &mut scratch[..*count];
                channels.complete_node((kernel, node), &of_channels, numbers, sum);
                directions.give(term, sum, vector, known);
            }
        }
        Ok(())
    }

    /// [`add_leading`](Damping::add_leading) for any terms and nodes.
    #[inline(never)]
    fn add_leading_of_any(&self, increments: &[T], force: &mut [T], scratch: &mut [T]) {
        let coordinates = self.vector.len().max(1);
        let nodes = increments.len() / coordinates;
        let sum = &mut scratch[..coordinates];
        for (kernel, term) in self.terms.iter().enumerate() {
            for (own, force) in force.chunks_exact_mut(coordinates).enumerate() {
                sum.fill(T::zero());
                self.channels.visit_leading(kernel, nodes, |i, j, weight| {
                    if i == own {
                        add_multiple(sum, weight, &increments[j * coordinates..(j + 1) * coordinates]);
                    }
                });
                term.rho.multiply_add(T::one(), sum, force);
            }
        }
    }

    /// [`push`](Damping::push) for directions other than all coordinates.
    #[inline(never)]
    fn push_some(&mut self, sample: &Sample<'_, T>, increments: &[T]) -> Result<(), MemoryError> {
        self.take(sample);
        take_each(&self.directions, increments, self.coordinates(), &mut self.increments);
        let of_channels = Sample { from: &self.from, behind: &self.behind, ..*sample };
        self.channels.push(&of_channels, &self.increments, &mut self.scratch)
    }
}

/// Applies G to vectors of N numbers one after another.
fn take_each<T: Real>(directions: &Directions<T>, vectors: &[T], coordinates: usize, out: &mut Vec<T>) {
    out.resize(vectors.len() / coordinates.max(1) * directions.count(), T::zero());
    directions.take(vectors, coordinates, out);
}

impl<T: Real, M: Memory<T>> Damping<T, AnySpace> for ChannelDamping<T, M> {
    fn check(&self, _: usize, nodes: usize, step_size: T) -> Result<(), Mismatch> {
        self.channels.check(self.count, nodes, step_size)
    }

    fn begin(&mut self, position: &[T], velocity: &[T]) {
        let mut start = vec![T::zero(); self.count];
        self.directions.take(position, self.coordinates(), &mut self.from);
        self.directions.take(velocity, self.coordinates(), &mut start);
        self.channels.begin(&self.from, &start);
    }

    fn begin_at(&mut self, time: T) {
        self.channels.begin_at(time);
    }

    #[inline(always)]
    fn add_known(&mut self, sample: &Sample<'_, T>, known: &mut [T], _: &mut [T]) -> Result<(), MemoryError> {
        if !self.directions.are_all() || sample.fractions.len() != 1 {
            return self.add_known_of_any(sample, known);
        }
        let Self { terms, channels, known: of_terms, .. } = self;
        channels.memory_terms(sample, of_terms)?;
        // As many numbers as coordinates: where these are known, so are those.
        let numbers = of_terms.chunks_exact_mut(sample.from.len().max(1));
        for (kernel, (term, numbers)) in terms.iter().zip(numbers).enumerate() {
            channels.complete(kernel, sample, numbers);
            term.rho.multiply_add(T::one(), numbers, known);
        }
        Ok(())
    }

    #[inline(always)]
    fn add_leading(&self, increments: &[T], force: &mut [T], scratch: &mut [T]) {
        match (&self.directions, &self.terms[..]) {
            (Directions::All(_), [term]) if increments.len() == self.vector.len() => {
                term.rho.multiply_add(self.channels.leading(0, 1, 0, 0), increments, force);
            }
            _ => self.add_leading_of_any(increments, force, scratch),
        }
    }

    fn visit_leading(&self, nodes: usize, mut visit: impl FnMut(usize, usize, T, &Matrix<T>)) {
        for (kernel, term) in self.terms.iter().enumerate() {
            self.channels.visit_leading(kernel, nodes, |i, j, weight| visit(i, j, weight, &term.rho));
        }
    }

    fn leading_is_constant(&self) -> bool {
        self.channels.memory().leading_is_constant()
    }

    #[inline(always)]
    fn push(&mut self, sample: &Sample<'_, T>, increments: &[T], _: &mut [T]) -> Result<(), MemoryError> {
        match self.directions {
            Directions::All(_) => self.channels.push(sample, increments, &mut self.scratch),
            _ => self.push_some(sample, increments),
        }
    }
}

impl<T: Real, M: Memory<T>> Stateful for ChannelDamping<T, M> {
    fn state_bytes(&self) -> usize {
        self.channels.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.channels.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.channels.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.channels.restore(from)
    }
}
