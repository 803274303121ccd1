//! States after consecutive steps, stored in columns for checks and output.

use super::GridState;

/// Largest number of steps in a batch.
const STEPS: usize = 64;

/// Largest number of position values in a batch, so that it stays in the fastest cache.
const NUMBERS: usize = 1024;

/// States after consecutive steps: times, energies and every coordinate in separate columns, step after step.
///
/// A run makes the steps of a batch and then processes all of its states, which costs less than after every
/// step: each operation reads one column.
#[derive(Clone, Debug)]
pub struct StepBatch {
    /// Capacity in states.
    room: usize,
    /// Number of states.
    len: usize,
    /// Number of steps made up to the first state.
    first: usize,
    times: Vec<f64>,
    energies: Vec<f64>,
    /// Columns of `room` numbers, one after another.
    positions: Vec<f64>,
    momenta: Vec<f64>,
    iterations: Vec<u32>,
    /// The run's columns at the last state; a run with columns has batches of one state.
    columns: Vec<f64>,
    /// ∂q/∂θ and ∂p/∂θ, state after state, none where nothing is differentiated; and how many of a state.
    sensitivities: Vec<f64>,
    slopes: usize,
    /// What the steps were solved by, step after step, where it is kept; and how many numbers solve a step.
    increments: Option<Vec<f64>>,
    unknowns: usize,
    /// Energies are those of the states after multiples of so many steps.
    energies_every: usize,
}

impl StepBatch {
    /// An empty batch for states with `coordinates` coordinates: with capacity for one state if `one_by_one`,
    /// otherwise for many. Energies are known after multiples of `energies_every` steps.
    pub fn new(coordinates: usize, one_by_one: bool, energies_every: usize) -> Self {
        let room = if one_by_one { 1 } else { (NUMBERS / coordinates.max(1)).clamp(1, STEPS) };
        let column = || vec![0.0; room];
        let coordinates = || vec![0.0; room * coordinates];
        Self {
            room,
            len: 0,
            first: 0,
            times: column(),
            energies: column(),
            positions: coordinates(),
            momenta: coordinates(),
            iterations: vec![0; room],
            columns: Vec::new(),
            sensitivities: Vec::new(),
            slopes: 0,
            increments: None,
            unknowns: 0,
            energies_every,
        }
    }

    /// Capacity in states.
    pub(crate) fn room(&self) -> usize {
        self.room
    }

    /// Clears the batch; its next state is the one after `first` steps.
    pub fn begin(&mut self, first: usize) {
        (self.first, self.len) = (first, 0);
        if let Some(increments) = &mut self.increments {
            increments.clear();
        }
    }

    /// Keeps the first `len` states.
    pub(crate) fn truncate(&mut self, len: usize) {
        self.len = self.len.min(len);
    }

    /// Appends a state; beyond the capacity it is dropped.
    #[inline(always)]
    pub(crate) fn push(
        &mut self,
        (time, energy): (f64, f64),
        position: impl Iterator<Item = f64>,
        momentum: impl Iterator<Item = f64>,
        iterations: u32,
    ) {
        let (index, room) = (self.len, self.room);
        let columns = self.times.get_mut(index).zip(self.energies.get_mut(index));
        let (Some((time_place, energy_place)), Some(iterations_place)) =
            (columns, self.iterations.get_mut(index))
        else {
            return;
        };
        (*time_place, *energy_place, *iterations_place) = (time, energy, iterations);
        put(&mut self.positions, (index, room), position);
        put(&mut self.momenta, (index, room), momentum);
        self.len += 1;
    }

    /// Appends a state.
    pub fn push_state(&mut self, state: &GridState, iterations: u32) {
        let (position, momentum) = (state.position.iter().copied(), state.momentum.iter().copied());
        let index = self.len;
        self.push((state.time, state.energy), position, momentum, iterations);
        self.columns.clone_from(&state.columns);
        self.take_sensitivities(index, &state.sensitivities);
    }

    /// ∂q/∂θ and ∂p/∂θ of a state; none where nothing is differentiated.
    pub fn sensitivities(&self, index: usize) -> &[f64] {
        self.sensitivities.get(index * self.slopes..(index + 1) * self.slopes).unwrap_or_default()
    }

    /// Takes those of a state.
    pub(crate) fn take_sensitivities(&mut self, index: usize, slopes: &[f64]) {
        self.slopes = slopes.len();
        self.sensitivities.resize(self.room * self.slopes, 0.0);
        if let Some(places) = self.sensitivities.get_mut(index * self.slopes..(index + 1) * self.slopes) {
            places.copy_from_slice(slopes);
        }
    }

    /// From now on steps leave behind what they were solved by.
    pub(crate) fn keep_increments(&mut self) {
        self.increments = Some(Vec::new());
    }

    /// Takes what the step to the last state was solved by, where that is kept.
    #[inline(always)]
    pub(crate) fn push_increments(&mut self, numbers: impl Iterator<Item = f64>) {
        if let Some(increments) = &mut self.increments {
            let before = increments.len();
            increments.extend(numbers);
            self.unknowns = increments.len() - before;
        }
    }

    /// What the step to a state was solved by: q_d(c h) − q_k at each control point, or accelerations.
    pub(crate) fn increments(&self, index: usize) -> &[f64] {
        let all = self.increments.as_deref().unwrap_or_default();
        all.get(index * self.unknowns..(index + 1) * self.unknowns).unwrap_or_default()
    }

    /// Replaces the last state, or removes it.
    pub(crate) fn replace_last(&mut self, state: Option<&GridState>) {
        let Some(last) = self.len.checked_sub(1) else { return };
        self.len = last;
        if let Some(state) = state {
            self.push_state(state, self.iterations[last]);
        }
    }

    /// The run's columns at the last state.
    pub fn columns(&self) -> &[f64] {
        &self.columns
    }

    /// [`columns`](Self::columns), mutable.
    pub(crate) fn columns_mut(&mut self) -> &mut [f64] {
        &mut self.columns
    }

    /// Number of states.
    pub fn len(&self) -> usize {
        self.len
    }

    /// True if there are no states.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of steps made up to the first state.
    pub fn first(&self) -> usize {
        self.first
    }

    /// The indices of the states after a multiple of `every` steps.
    pub fn multiples(&self, every: usize) -> impl Iterator<Item = usize> + use<> {
        let every = every.max(1);
        let next = match self.first % every {
            0 => 0,
            past => every - past,
        };
        (next..self.len).step_by(every)
    }

    /// t.
    pub fn times(&self) -> &[f64] {
        &self.times[..self.len]
    }

    /// E of each state; if it was not computed, an earlier one.
    pub fn energies(&self) -> &[f64] {
        &self.energies[..self.len]
    }

    /// The indices of the states whose energy is known, and used for pictures and extremes; `None`: all of
    /// them. The last state of a run may have an energy and not be among these: a run that is continued has
    /// none there.
    pub fn with_energy(&self) -> Option<impl Iterator<Item = usize> + use<>> {
        (self.energies_every > 1).then(|| self.multiples(self.energies_every))
    }

    /// True if the last state is not among those [`with_energy`](Self::with_energy).
    pub fn lacks_last_energy(&self) -> bool {
        self.with_energy().is_some_and(|known| known.last() != self.len.checked_sub(1))
    }

    /// Each coordinate of q.
    pub fn positions(&self) -> impl Iterator<Item = &[f64]> {
        self.positions.chunks_exact(self.room).map(|column| &column[..self.len])
    }

    /// Each coordinate of p.
    pub fn momenta(&self) -> impl Iterator<Item = &[f64]> {
        self.momenta.chunks_exact(self.room).map(|column| &column[..self.len])
    }

    /// q and p if the batch has a single state, as for large systems.
    pub fn alone(&self) -> Option<(&[f64], &[f64])> {
        (self.room == 1 && self.len == 1).then_some((&self.positions, &self.momenta))
    }

    /// A coordinate of q.
    pub fn position(&self, coordinate: usize) -> &[f64] {
        &self.positions[coordinate * self.room..][..self.len]
    }

    /// A coordinate of p.
    pub fn momentum(&self, coordinate: usize) -> &[f64] {
        &self.momenta[coordinate * self.room..][..self.len]
    }

    /// Number of iterations of Newton's method in the step to each state.
    pub fn iterations(&self) -> &[u32] {
        &self.iterations[..self.len]
    }

    /// All columns, with the energies mutable: (q, p, E), the coordinates at a distance of
    /// [`room`](Self::room) numbers.
    pub(crate) fn with_energies_mut(&mut self) -> (&[f64], &[f64], &mut [f64]) {
        (&self.positions, &self.momenta, &mut self.energies[..self.len])
    }

    /// Writes a state, whose vectors must have one place for each coordinate.
    pub fn read(&self, index: usize, state: &mut GridState) {
        state.time = self.times[index];
        state.energy = self.energies[index];
        state.columns.clone_from(&self.columns);
        state.position.iter_mut().zip(self.positions()).for_each(|(place, column)| *place = column[index]);
        state.momentum.iter_mut().zip(self.momenta()).for_each(|(place, column)| *place = column[index]);
        if self.slopes > 0 {
            state.sensitivities.clear();
            state.sensitivities.extend_from_slice(self.sensitivities(index));
        }
    }
}

/// Writes numbers to places at the distance `stride`.
#[inline(always)]
fn put(places: &mut [f64], (first, stride): (usize, usize), mut numbers: impl Iterator<Item = f64>) {
    // One coordinate: one number, without a loop.
    if places.len() == stride {
        if let (Some(place), Some(number)) = (places.get_mut(first), numbers.next()) {
            *place = number;
        }
        return;
    }
    if stride == STEPS && first < STEPS {
        // With columns of known length one bounds check serves all.
        for (column, number) in places.as_chunks_mut::<STEPS>().0.iter_mut().zip(numbers) {
            column[first] = number;
        }
        return;
    }
    let mut next = first;
    for number in numbers {
        let Some(place) = places.get_mut(next) else { return };
        *place = number;
        next += stride;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_come_back_as_they_were() {
        let state = |index: usize| {
            let x = index as f64;
            GridState {
                time: x,
                position: vec![x, -x],
                momentum: vec![0.5 * x, 7.0],
                energy: x * x,
                ..GridState::default()
            }
        };
        let many = |index: usize| {
            let numbers = |first: usize| (0..20).map(|place| (first + place) as f64).collect();
            GridState { position: numbers(index), momentum: numbers(30 * index), ..state(index) }
        };
        let mut single = StepBatch::new(2, true, 1);
        assert_eq!(single.alone(), None);
        single.push_state(&state(3), 1);
        assert_eq!(single.alone(), Some((&[3.0, -3.0][..], &[1.5, 7.0][..])));
        let mut large = StepBatch::new(20, false, 1);
        large.begin(1);
        (1..40).for_each(|index| large.push_state(&many(index), 3));
        let mut found = many(0);
        for index in 1..40 {
            large.read(index - 1, &mut found);
            assert_eq!(found, many(index));
        }
        let mut batch = StepBatch::new(2, false, 1);
        batch.begin(10);
        (10..15).for_each(|index| batch.push_state(&state(index), 3));
        let mut found = state(0);
        for index in 0..5 {
            batch.read(index, &mut found);
            assert_eq!(found, state(10 + index));
        }
        assert_eq!(
            (batch.position(1), batch.iterations()),
            (&[-10.0, -11.0, -12.0, -13.0, -14.0][..], &[3; 5][..])
        );
        assert_eq!(batch.alone(), None);
        assert_eq!(batch.multiples(4).collect::<Vec<_>>(), [2]);
        assert_eq!(batch.multiples(1).count(), 5);
        batch.replace_last(Some(&state(3)));
        batch.read(4, &mut found);
        assert_eq!(found, state(3));
        batch.truncate(2);
        assert_eq!((batch.len(), batch.energies()), (2, &[100.0, 121.0][..]));
    }

    #[test]
    fn large_states_are_looked_at_one_by_one() {
        assert_eq!(StepBatch::new(1, false, 1).room(), STEPS);
        assert_eq!(StepBatch::new(64, false, 1).room(), 16);
        assert_eq!(StepBatch::new(5000, false, 1).room(), 1);
        assert_eq!(StepBatch::new(1, true, 1).room(), 1);
    }
}
