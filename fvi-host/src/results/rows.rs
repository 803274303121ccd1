//! Rows of a trajectory in memory, column by column.

use fvi_scenario::language::memory_limit::check_capacity;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::columns::Columns;
use fvi_simulation::simulation::{GridState, velocities_need_all_momenta};

/// The rows of a trajectory, column by column.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    /// N, the number of coordinates written.
    pub coordinates: usize,
    /// t of each row.
    pub time: Vec<f64>,
    /// q of each row, N numbers each.
    pub position: Vec<f64>,
    /// p of each row, N numbers each.
    pub momentum: Vec<f64>,
    /// v of each row, N numbers each, where the mass couples chosen coordinates with others; empty otherwise,
    /// since momenta tell it.
    pub velocity: Vec<f64>,
    /// The energy of each row.
    pub energy: Vec<f64>,
    /// The further columns of the run.
    pub columns: Columns,
    /// Their numbers for each row.
    pub of_columns: Vec<f64>,
    /// ∂q/∂θ and ∂p/∂θ of each row, for each parameter of `[sensitivity]`.
    pub derivatives: Vec<f64>,
}

/// Largest number of rows that there is room for at once where rows grow.
const FIRST: usize = 4096;

/// There is no room for the rows of a run.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{rows} rows of {numbers} numbers: {reason}; write fewer of them with `every`")]
pub struct OutOfMemory {
    rows: usize,
    numbers: usize,
    reason: String,
}

impl Rows {
    /// Empty rows for each load case of a scenario, or for its one motion, with room for all.
    ///
    /// # Errors
    /// [`OutOfMemory`].
    pub fn of_cases(scenario: &Scenario) -> Result<Vec<Self>, OutOfMemory> {
        let coordinates = scenario.written_coordinates().len();
        let rows = Self::expected(scenario);
        let columns = Columns::of(scenario);
        let parameters = scenario.sensitivity.as_ref().map_or(0, |asked| asked.parameters.len());
        let derivatives = coordinates.saturating_mul(2).saturating_mul(parameters);
        let velocities = if velocities_need_all_momenta(scenario) { coordinates } else { 0 };
        let more = derivatives.saturating_add(columns.len()).saturating_add(velocities);
        let numbers = coordinates.saturating_mul(2).saturating_add(2).saturating_add(more);
        let no_room = |reason: String| OutOfMemory { rows, numbers, reason };
        let copies = scenario.copies();
        check_capacity(rows.saturating_mul(numbers).saturating_mul(copies).saturating_mul(size_of::<f64>()))
            .map_err(|error| no_room(error.to_string()))?;
        let room = |count: usize| {
            let mut room: Vec<f64> = Vec::new();
            room.try_reserve_exact(count).map(|()| room).map_err(|error| no_room(error.to_string()))
        };
        let one = |_| {
            Ok(Self {
                coordinates,
                time: room(rows)?,
                position: room(rows * coordinates)?,
                momentum: room(rows * coordinates)?,
                velocity: room(rows * velocities)?,
                energy: room(rows)?,
                columns: columns.clone(),
                of_columns: room(rows * columns.len())?,
                derivatives: room(rows * derivatives)?,
            })
        };
        (0..copies).map(one).collect()
    }

    /// Empty rows for the one motion of a scenario; they grow.
    pub fn for_run(scenario: &Scenario) -> Self {
        let (coordinates, columns) = (scenario.written_coordinates().len(), Columns::of(scenario));
        let rows = Self::expected(scenario).min(FIRST);
        let room = |width: usize| Vec::with_capacity(rows.saturating_mul(width));
        Self {
            coordinates,
            time: room(1),
            position: room(coordinates),
            momentum: room(coordinates),
            velocity: Vec::new(),
            energy: room(1),
            of_columns: room(columns.len()),
            columns,
            derivatives: Vec::new(),
        }
    }

    /// Number of rows of a run that makes all its steps; where it is not known, it is too small.
    pub fn expected(scenario: &Scenario) -> usize {
        let steps = scenario.time.steps_known().unwrap_or_default();
        match scenario.output.times.len() {
            0 => (steps / scenario.output.every).saturating_add(2),
            times => times,
        }
    }

    /// Adds a row.
    pub fn push(&mut self, state: &GridState) {
        self.time.push(state.time);
        self.position.extend_from_slice(&state.position);
        self.momentum.extend_from_slice(&state.momentum);
        self.energy.push(state.energy);
        self.derivatives.extend_from_slice(&state.sensitivities);
        self.of_columns.extend_from_slice(&state.columns);
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.time.len()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.time.is_empty()
    }

    /// Bytes of times, states and energies.
    pub fn bytes(&self) -> usize {
        let states = self.position.len() + self.momentum.len() + self.velocity.len();
        let numbers = self.time.len() + states + self.energy.len();
        numbers * size_of::<f64>()
    }
}
