//! Predictions of a model for the data, and their derivatives with respect to its parameters.

use super::closed::Closed;
use super::data::{Domain, Observed, Over, Record};
use super::interpolation::{Sought, Stencil};
use super::no_prediction::NoPrediction;
use super::plan::{Free, Model, numbers_at, put_number, said};
use super::shift::Shift;
use fvi_fft::memory::Tables;
use fvi_scenario::language::{InputError, put};
use fvi_scenario::scenario::{KnownMatrices, Quantity, Scenario};
use fvi_simulation::simulation::motion::Motion;
use fvi_simulation::simulation::{GridState, Precision, StateQuantities};
use nalgebra::{DMatrix, DVector};
use std::sync::atomic::{AtomicBool, Ordering};

/// Relative step of a parameter in finite differences of runs.
const RUN_CHANGE: f64 = 3e-5;

/// Relative change of a parameter for differences of closed forms.
const FORM_CHANGE: f64 = 1e-4;

/// Relative change of a parameter to leave a point where derivatives do not exist.
const NUDGE: f64 = 1e-6;

/// Tables of data under the same conditions, predicted by one run.
struct Group {
    records: Vec<usize>,
    /// The data, in ascending order of the first grid point that they depend on.
    needs: Vec<Need>,
    /// The last grid point that is needed.
    last: usize,
}

/// A data value over time, predicted as a weighted sum over grid points.
struct Need {
    /// Its index in the vector of all data.
    place: usize,
    what: Observed,
    stencil: Stencil,
}

/// Computes the predictions of a model for the data.
pub(super) struct Predictions<'f> {
    model: &'f Model,
    records: &'f [Record],
    shift: Option<&'f Shift>,
    /// Index in the vector of all data at which the values of each table begin; the last entry is the length
    /// of the vector.
    begins: Vec<usize>,
    groups: Vec<Group>,
    /// For each parameter, whether the program differentiates the discrete motion exactly with respect to it.
    exact: Vec<bool>,
    /// For each parameter, the reason if it does not.
    reasons: Vec<Option<String>>,
    tables: Tables,
    known: KnownMatrices,
    stop: &'f AtomicBool,
    progress: &'f mut dyn FnMut(usize),
    /// Number of runs made.
    runs: usize,
}

/// Computes some of the predictions at a point in parameter space and writes them.
type Compute<'c, 'f> = dyn Fn(&mut Predictions<'f>, &[f64], &mut Predicted) -> Result<(), NoPrediction> + 'c;

/// Predictions of a model for all data.
#[derive(Clone, Debug)]
pub(super) struct Predicted {
    pub(super) values: DVector<f64>,
    /// Difference of each interpolated value from that of a polynomial of lower degree; zero at grid points.
    pub(super) unresolved: DVector<f64>,
    /// Derivatives of `values` (rows) with respect to the parameters (columns), not to their logarithms.
    pub(super) jacobian: Option<DMatrix<f64>>,
}

impl<'f> Predictions<'f> {
    /// Predictions of a model; the start values of the parameters decide which derivatives are available.
    pub(super) fn new(
        model: &'f Model,
        (records, shift): (&'f [Record], Option<&'f Shift>),
        stop: &'f AtomicBool,
        progress: &'f mut dyn FnMut(usize),
    ) -> Result<Self, NoPrediction> {
        let mut begins = vec![0];
        for record in records {
            begins.push(begins[begins.len() - 1] + record.len());
        }
        let mut made = Self {
            model,
            records,
            shift,
            begins,
            groups: Vec::new(),
            exact: vec![true; model.free.len()],
            reasons: vec![None; model.free.len()],
            tables: Tables::default(),
            known: KnownMatrices::default(),
            stop,
            progress,
            runs: 0,
        };
        made.group()?;
        made.ask_for_derivatives();
        Ok(made)
    }

    /// Runs made so far.
    pub(super) fn runs(&self) -> usize {
        self.runs
    }

    /// Why the derivative with respect to a parameter is taken from differences.
    pub(super) fn reason(&self, parameter: usize) -> Option<&str> {
        self.reasons[parameter].as_deref()
    }

    /// What the derivatives by a parameter are, "exact" or "differences": those of closed forms are these.
    pub(super) fn derivative(&self, parameter: usize) -> &'static str {
        let is_of_form = |(index, record): (usize, &Record)| {
            record.domain != Domain::Time && self.concerns(parameter, index)
        };
        let any = self.records.iter().enumerate().any(is_of_form);
        if any || !self.exact[parameter] { "differences" } else { "exact" }
    }

    /// True if all derivatives are exact ones of the discrete motion.
    pub(super) fn are_all_exact(&self) -> bool {
        self.exact.iter().all(|&exact| exact)
            && self.records.iter().all(|record| record.domain == Domain::Time)
    }

    /// Range of the values of a table in the vector of all data.
    pub(super) fn place(&self, record: usize) -> std::ops::Range<usize> {
        self.begins[record]..self.begins[record + 1]
    }

    fn group(&mut self) -> Result<(), NoPrediction> {
        let own = |record: usize| self.model.free.iter().any(|free| free.record == Some(record));
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for (index, record) in self.records.iter().enumerate() {
            let alike = |group: &&mut Vec<usize>| {
                let first = &self.records[group[0]];
                first.domain == Domain::Time
                    && record.domain == Domain::Time
                    && first.set == record.set
                    && !own(index)
                    && !own(group[0])
            };
            match groups.iter_mut().find(alike) {
                Some(group) => group.push(index),
                None => groups.push(vec![index]),
            }
        }
        let start: Vec<f64> = self.model.free.iter().map(|free| free.start).collect();
        for records in groups {
            let mut group = Group { records, needs: Vec::new(), last: 0 };
            if self.records[group.records[0]].domain == Domain::Time {
                let grid = self.scenario(group.records[0], &start, &[])?.time;
                for &index in &group.records {
                    let (record, begin) = (&self.records[index], self.begins[index]);
                    for (row, &time) in record.places.iter().enumerate() {
                        for (column, data) in record.columns.iter().enumerate() {
                            let of = match data.what {
                                Observed::Acceleration(_) => Sought::Slope,
                                _ => Sought::Value,
                            };
                            let stencil = Stencil::new(&grid, time.clamp(grid.time(0), grid.end()), of);
                            group.last = group.last.max(stencil.last());
                            let place = begin + row * record.columns.len() + column;
                            group.needs.push(Need { place, what: data.what, stencil });
                        }
                    }
                }
                group.needs.sort_by_key(|need| need.stencil.first);
            }
            self.groups.push(group);
        }
        Ok(())
    }

    /// Determines the parameters with respect to which the program differentiates exactly.
    fn ask_for_derivatives(&mut self) {
        let start: Vec<f64> = self.model.free.iter().map(|free| free.start).collect();
        for parameter in 0..self.model.free.len() {
            for group in 0..self.groups.len() {
                let record = self.groups[group].records[0];
                if self.records[record].domain != Domain::Time || !self.concerns(parameter, record) {
                    continue;
                }
                let attempt = |point: &[f64]| -> Result<(), InputError> {
                    let scenario = self.scenario(record, point, &[parameter])?;
                    let motion = Motion::sharing(&scenario, Precision::F64, &self.tables)?;
                    motion.with_sensitivities(&self.tables).map(|_| ())
                };
                let Err(error) = attempt(&start) else { continue };
                // Some derivatives are missing at isolated values only, such as an order of 1: tried beside
                // it.
                if attempt(&self.nudged(&start)).is_err() {
                    self.exact[parameter] = false;
                    self.reasons[parameter] = Some(said(&error));
                }
            }
        }
    }

    /// A neighbouring point, each parameter moved in the direction in which its bound is farther away.
    pub(super) fn nudged(&self, point: &[f64]) -> Vec<f64> {
        let nudge = |(free, &value): (&Free, &f64)| {
            let change = NUDGE * size(free, value);
            let middle = 0.5 * (free.bounds.0 + free.bounds.1);
            let up = if middle.is_finite() { value <= middle } else { true };
            if up { value + change } else { value - change }
        };
        self.model.free.iter().zip(point).map(nudge).collect()
    }

    /// True if the predictions for a table of data depend on a parameter.
    fn concerns(&self, parameter: usize, record: usize) -> bool {
        self.model.free[parameter].record.is_none_or(|own| own == record)
    }

    /// The keys of the scenario for a table of data, with the parameters at `point`.
    pub(super) fn values(&self, record: Option<usize>, point: &[f64]) -> Result<toml::Table, String> {
        let mut values = self.model.values.clone();
        if let Some(record) = record {
            for (path, value) in &self.records[record].set {
                put(&mut values, path, value.clone())?;
            }
        }
        for (free, &number) in self.model.free.iter().zip(point) {
            if free.record.is_none() || free.record == record {
                put_number(&mut values, &free.path, number)?;
            }
        }
        Ok(values)
    }

    /// The scenario for a table of data with the parameters at `point`, with derivatives with respect to the
    /// parameters `by`.
    fn scenario(&self, record: usize, point: &[f64], by: &[usize]) -> Result<Scenario, InputError> {
        let (base, document) = (&self.model.base, self.model.base.document());
        let mut values = self
            .values(Some(record), point)
            .map_err(|reason| base.error_at("", fvi_scenario::language::Problem::Unusable { reason }))?;
        values.remove("sensitivity");
        // Not needed here.
        values.remove("reference");
        if !by.is_empty() {
            let paths = by.iter().map(|&index| self.model.free[index].path.clone().into()).collect();
            let asked = toml::Table::from_iter([("parameters".to_owned(), toml::Value::Array(paths))]);
            values.insert("sensitivity".to_owned(), toml::Value::Table(asked));
        }
        let mut scenario = Scenario::knowing(document.with_values(&values), &self.known)?;
        // For large systems energies are computed at output rows only.
        scenario.output.every = 1;
        Ok(scenario)
    }

    /// The predictions at a point, with derivatives if requested.
    pub(super) fn at(&mut self, point: &[f64], derivatives: bool) -> Result<Predicted, NoPrediction> {
        let all = self.begins[self.records.len()];
        let count = self.model.free.len();
        let mut predicted = Predicted {
            values: DVector::zeros(all),
            unresolved: DVector::zeros(all),
            jacobian: derivatives.then(|| DMatrix::zeros(all, count)),
        };
        for group in 0..self.groups.len() {
            let record = self.groups[group].records[0];
            if self.records[record].domain != Domain::Time {
                self.answer(record, point, &mut predicted)?;
                continue;
            }
            let known = |index: &usize| self.concerns(*index, record);
            let by: Vec<usize> = (0..count).filter(known).filter(|&index| self.exact[index]).collect();
            let mut differences: Vec<usize> =
                (0..count).filter(known).filter(|&index| !self.exact[index]).collect();
            if !derivatives || by.is_empty() {
                self.run(group, point, &[], &mut predicted)?;
            } else if self.can_differentiate(record, point, &by) {
                self.run(group, point, &by, &mut predicted)?;
            } else {
                let beside = self.nudged(point);
                self.run(group, point, &[], &mut predicted)?;
                if self.can_differentiate(record, &beside, &by) {
                    let mut other = predicted.clone();
                    self.run(group, &beside, &by, &mut other)?;
                    predicted.jacobian = other.jacobian;
                } else {
                    differences = (0..count).filter(|index| self.concerns(*index, record)).collect();
                }
            }
            if derivatives {
                for parameter in differences {
                    let run = |this: &mut Self, point: &[f64], into: &mut Predicted| {
                        this.run(group, point, &[], into)
                    };
                    self.difference(parameter, point, RUN_CHANGE, &mut predicted, &run)?;
                }
            }
        }
        Ok(predicted)
    }

    fn can_differentiate(&self, record: usize, point: &[f64], by: &[usize]) -> bool {
        self.scenario(record, point, by).is_ok()
    }

    /// ∂/∂θ of what `compute` writes, by central differences of order four, or by one-sided ones where points
    /// on the other side are beyond a bound or refused.
    fn difference(
        &mut self,
        parameter: usize,
        point: &[f64],
        relative: f64,
        predicted: &mut Predicted,
        compute: &Compute<'_, 'f>,
    ) -> Result<(), NoPrediction> {
        let change = relative * size(&self.model.free[parameter], point[parameter]);
        let (low, high) = self.model.free[parameter].bounds;
        let mut attempt = |shares: &[(f64, f64)]| -> Result<DVector<f64>, NoPrediction> {
            let mut sum = DVector::zeros(predicted.values.len());
            let mut first: Option<DVector<f64>> = None;
            for &(offset, share) in shares {
                let mut beside = point.to_vec();
                beside[parameter] += offset * change;
                let mut other = Predicted {
                    values: DVector::zeros(sum.len()),
                    unresolved: DVector::zeros(sum.len()),
                    jacobian: None,
                };
                compute(self, &beside, &mut other)?;
                // The shares sum to 0: with differences from one of the points the sum is exactly 0 where
                // nothing changes.
                match &first {
                    Some(first) => sum.axpy(share / change, &(other.values - first), 1.0),
                    None => first = Some(other.values),
                }
            }
            Ok(sum)
        };
        let central = [(-2.0, 1.0 / 12.0), (-1.0, -2.0 / 3.0), (1.0, 2.0 / 3.0), (2.0, -1.0 / 12.0)];
        let up = [(0.0, -25.0 / 12.0), (1.0, 4.0), (2.0, -3.0), (3.0, 4.0 / 3.0), (4.0, -0.25)];
        let down = up.map(|(offset, share): (f64, f64)| (-offset, -share));
        let is_allowed = |shares: &[(f64, f64)]| {
            let mut places = shares.iter().map(|(offset, _)| point[parameter] + offset * change);
            places.all(|place| (low..=high).contains(&place))
        };
        let mut ways: [&[(f64, f64)]; 3] = [&central, &up, &down];
        // Those between the bounds first.
        ways.sort_by_key(|shares| !is_allowed(shares));
        let mut column = attempt(ways[0]);
        for shares in &ways[1..] {
            if !matches!(column, Err(NoPrediction::Refused(_))) {
                break;
            }
            column = attempt(shares);
        }
        let column = column?;
        if let Some(jacobian) = &mut predicted.jacobian {
            // The rows of other tables of data are zero here and must not be overwritten.
            for (row, &slope) in column.iter().enumerate().filter(|(_, slope)| **slope != 0.0) {
                jacobian[(row, parameter)] = slope;
            }
        }
        Ok(())
    }

    /// Runs one group and writes the predictions for its tables.
    fn run(
        &mut self,
        group: usize,
        point: &[f64],
        by: &[usize],
        predicted: &mut Predicted,
    ) -> Result<(), NoPrediction> {
        let record = self.groups[group].records[0];
        let scenario = self.scenario(record, point, by)?;
        let mut motion = Motion::sharing(&scenario, Precision::F64, &self.tables)?;
        if !by.is_empty() {
            motion = motion.with_sensitivities(&self.tables)?;
        }
        let Group { needs, last, .. } = &self.groups[group];
        for need in needs {
            predicted.values[need.place] = 0.0;
            predicted.unresolved[need.place] = 0.0;
        }
        let mut derived = Derived::new(self, &scenario, record, point, by, needs)?;
        let mut state = motion.state().clone();
        // `opened`: number of needs whose first grid point has been reached; `open`: those of them whose last
        // one has not.
        let (mut opened, mut open): (usize, Vec<usize>) = (0, Vec::new());
        let mut index = 0;
        loop {
            for place in 0..motion.batch().len() {
                motion.batch().read(place, &mut state);
                while needs.get(opened).is_some_and(|need| need.stencil.first <= index) {
                    open.push(opened);
                    opened += 1;
                }
                if !open.is_empty() {
                    derived.look(&state, motion.batch().sensitivities(place));
                }
                for &number in &open {
                    let Need { place, what, stencil } = &needs[number];
                    let at = index - stencil.first;
                    let share = stencil.shares[at];
                    let value = derived.value(*what)?;
                    predicted.values[*place] += share * value;
                    if let Some(lower) = stencil.lower.get(at) {
                        predicted.unresolved[*place] += (share - lower) * value;
                    }
                    if let Some(jacobian) = &mut predicted.jacobian {
                        for (column, &parameter) in by.iter().enumerate() {
                            jacobian[(*place, parameter)] += share * derived.slope(*what, column)?;
                        }
                    }
                }
                open.retain(|&number| needs[number].stencil.last() > index);
                index += 1;
            }
            if index > *last {
                break;
            }
            (self.progress)(self.runs);
            if self.stop.load(Ordering::Relaxed) {
                return Err(NoPrediction::Stopped);
            }
            if let Err(failure) = motion.advance_along(usize::MAX) {
                let fvi_simulation::simulation::motion::Failure { step, time, reason } = failure;
                return Err(NoPrediction::Refused(format!("step {step}, from t = {time}: {reason}")));
            }
        }
        self.runs += 1;
        (self.progress)(self.runs);
        Ok(())
    }

    /// Writes the predictions for a table of data over frequencies.
    fn answer(
        &mut self,
        record: usize,
        point: &[f64],
        predicted: &mut Predicted,
    ) -> Result<(), NoPrediction> {
        let compute =
            |this: &mut Self, point: &[f64], into: &mut Predicted| this.write_answer(record, point, into);
        compute(self, point, predicted)?;
        if predicted.jacobian.is_some() {
            let known: Vec<usize> =
                (0..self.model.free.len()).filter(|&index| self.concerns(index, record)).collect();
            for parameter in known {
                self.difference(parameter, point, FORM_CHANGE, predicted, &compute)?;
            }
        }
        self.runs += 1;
        (self.progress)(self.runs);
        Ok(())
    }

    /// a_T of a table of data.
    fn shift_factor(&self, record: usize, point: &[f64]) -> Result<f64, NoPrediction> {
        let Some(shift) = self.shift else { return Ok(1.0) };
        let log10 = shift.log10(record, &numbers_at(&self.model.free, point));
        let factor = log10.map(libm::exp10).filter(|factor| factor.is_normal());
        factor.ok_or_else(|| {
            NoPrediction::Refused(format!(
                "shift: the factor at the temperature {} is no finite number > 0; c2 + T − T₀ must be > 0",
                shift.temperature(record)
            ))
        })
    }

    fn write_answer(
        &mut self,
        record: usize,
        point: &[f64],
        predicted: &mut Predicted,
    ) -> Result<(), NoPrediction> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(NoPrediction::Stopped);
        }
        let scenario = self.scenario(record, point, &[])?;
        let table = &self.records[record];
        let Domain::Closed { over, answer, position } = &table.domain else { return Ok(()) };
        let position = position.as_ref().unwrap_or(&scenario.initial.position);
        let closed = Closed::new(&scenario, *answer, position)?;
        let factor = self.shift_factor(record, point)?;
        for (row, &place) in table.places.iter().enumerate() {
            let place = if *over == Over::Time { place / factor } else { place * factor };
            let begin = self.begins[record] + row * table.columns.len();
            let columns = table.columns.iter().map(|column| column.what);
            closed.write(*over, place, columns, &mut predicted.values.as_mut_slice()[begin..])?;
        }
        Ok(())
    }
}

/// Size of a parameter, to which its changes are relative.
fn size(free: &Free, value: f64) -> f64 {
    let typical =
        if free.scale == super::plan::Scale::Logarithmic { value.abs() } else { free.typical(value) };
    value.abs().max(typical)
}

/// A system with a changed value of one parameter, and the change.
type OtherRun = (StateQuantities, f64);

/// Quantities derived from a state (velocity, energy), and their derivatives with respect to the parameters.
struct Derived {
    system: StateQuantities,
    is_mechanism: bool,
    /// For each parameter, the entries (row, column) of the mass matrix that it is; empty for other
    /// parameters.
    mass_changes: Vec<Vec<(usize, usize)>>,
    /// For each parameter, if energies or velocities of a mechanism are needed: the systems with a slightly
    /// larger and a slightly smaller value of it, with the changes.
    beside: Vec<[OtherRun; 2]>,
    tells_velocity: bool,
    tells_energy: bool,
    position: Vec<f64>,
    momentum: Vec<f64>,
    velocity: Vec<f64>,
    energy: f64,
    /// ∂q/∂θ: N numbers for each parameter in turn.
    position_slopes: Vec<f64>,
    momentum_slopes: Vec<f64>,
    velocity_slopes: Vec<f64>,
    energy_slopes: Vec<f64>,
}

impl Derived {
    fn new(
        predictions: &Predictions<'_>,
        scenario: &Scenario,
        record: usize,
        point: &[f64],
        by: &[usize],
        needs: &[Need],
    ) -> Result<Self, NoPrediction> {
        let size = scenario.coordinates();
        let tells = |wanted: fn(&Observed) -> bool| needs.iter().any(|need| wanted(&need.what));
        let tells_energy = tells(|what| *what == Observed::Energy);
        let tells_velocity = tells(|what| matches!(what, Observed::Velocity(_) | Observed::Acceleration(_)));
        let differs = tells_energy || (tells_velocity && scenario.is_mechanism());
        let parameters = scenario.sensitivity.iter().flat_map(|asked| &asked.parameters);
        let mass_changes = parameters.map(|parameter| match parameter.what {
            Quantity::Mass(row, column) if row == column => vec![(row, column)],
            Quantity::Mass(row, column) => vec![(row, column), (column, row)],
            _ => Vec::new(),
        });
        let mass_changes: Vec<_> = mass_changes.collect();
        let mut beside = Vec::new();
        for &parameter in by {
            if !differs {
                break;
            }
            // Where the system is invalid on one side, as beyond the largest order, the one at the point is
            // used, with a change of 0.
            let change = 1e-5 * self::size(&predictions.model.free[parameter], point[parameter]);
            let other = |change: f64| -> Result<OtherRun, NoPrediction> {
                let mut beside = point.to_vec();
                beside[parameter] += change;
                match predictions
                    .scenario(record, &beside, &[])
                    .map_err(NoPrediction::from)
                    .and_then(|s| StateQuantities::new(&s).map_err(NoPrediction::from))
                {
                    Ok(system) => Ok((system, change)),
                    Err(_) => Ok((StateQuantities::new(scenario)?, 0.0)),
                }
            };
            beside.push([other(change)?, other(-change)?]);
        }
        let massless = if scenario.is_mechanism() { Vec::new() } else { scenario.system.massless() };
        if let (true, Some(row)) = (tells_velocity, massless.first()) {
            let reason =
                format!("system.mass: coordinate {row} has no mass, so that no momentum tells its velocity");
            return Err(NoPrediction::Refused(reason));
        }
        Ok(Self {
            system: StateQuantities::new(scenario)?,
            is_mechanism: scenario.is_mechanism(),
            mass_changes,
            beside,
            tells_velocity,
            tells_energy,
            position: vec![0.0; size],
            momentum: vec![0.0; size],
            velocity: vec![0.0; size],
            energy: 0.0,
            position_slopes: vec![0.0; size * by.len()],
            momentum_slopes: vec![0.0; size * by.len()],
            velocity_slopes: vec![0.0; size * by.len()],
            energy_slopes: vec![0.0; by.len()],
        })
    }

    /// Computes the derived quantities of a state and their derivatives.
    fn look(&mut self, state: &GridState, slopes: &[f64]) {
        let size = self.position.len();
        self.position.copy_from_slice(&state.position);
        self.momentum.copy_from_slice(&state.momentum);
        self.energy = state.energy;
        let count = self.energy_slopes.len();
        if slopes.len() == 2 * size * count {
            for (parameter, both) in slopes.chunks_exact(2 * size).enumerate() {
                let own = parameter * size..(parameter + 1) * size;
                self.position_slopes[own.clone()].copy_from_slice(&both[..size]);
                self.momentum_slopes[own].copy_from_slice(&both[size..]);
            }
        }
        if self.tells_velocity {
            self.system.velocity(&self.position, &self.momentum, &mut self.velocity);
            match self.is_mechanism {
                false => self.differentiate_velocity(),
                true => self.difference_velocity(),
            }
        }
        if self.tells_energy {
            for parameter in 0..count {
                let Some([(up, above), (down, below)]) = self.moved(parameter) else { continue };
                let Some([(more, _), (less, _)]) = self.beside.get_mut(parameter) else { continue };
                let (above, below) = (more.energy(&above[0], &above[1]), less.energy(&below[0], &below[1]));
                self.energy_slopes[parameter] = (above - below) / (up - down);
            }
        }
    }

    /// ∂v/∂θ from M δv = δp − δM v.
    fn differentiate_velocity(&mut self) {
        let size = self.position.len();
        let mut rest = vec![0.0; size];
        for parameter in 0..self.energy_slopes.len() {
            let own = parameter * size..(parameter + 1) * size;
            rest.copy_from_slice(&self.momentum_slopes[own.clone()]);
            for &(row, column) in &self.mass_changes[parameter] {
                rest[row] -= self.velocity[column];
            }
            self.system.velocity(&self.position, &rest, &mut self.velocity_slopes[own]);
        }
    }

    /// ∂v/∂θ of a mechanism, whose mass depends on the position and on parameters in words.
    fn difference_velocity(&mut self) {
        let size = self.position.len();
        let (mut fast, mut slow) = (vec![0.0; size], vec![0.0; size]);
        for parameter in 0..self.energy_slopes.len() {
            let Some([(up, above), (down, below)]) = self.moved(parameter) else { continue };
            let Some([(more, _), (less, _)]) = self.beside.get_mut(parameter) else { continue };
            more.velocity(&above[0], &above[1], &mut fast);
            less.velocity(&below[0], &below[1], &mut slow);
            let slopes = &mut self.velocity_slopes[parameter * size..][..size];
            for ((slope, &fast), &slow) in slopes.iter_mut().zip(&fast).zip(&slow) {
                *slope = (fast - slow) / (up - down);
            }
        }
    }

    /// The two changes of a parameter, each with position and momentum moved along (∂q/∂θ, ∂p/∂θ).
    fn moved(&self, parameter: usize) -> Option<[(f64, [Vec<f64>; 2]); 2]> {
        let size = self.position.len();
        let own = parameter * size..(parameter + 1) * size;
        let both = |change: f64| {
            let moved = |from: &[f64], by: &[f64]| -> Vec<f64> {
                from.iter().zip(by).map(|(x, slope)| x + change * slope).collect()
            };
            let position = moved(&self.position, &self.position_slopes[own.clone()]);
            (change, [position, moved(&self.momentum, &self.momentum_slopes[own.clone()])])
        };
        self.beside.get(parameter).map(|[(_, up), (_, down)]| [both(*up), both(*down)])
    }

    fn value(&self, what: Observed) -> Result<f64, NoPrediction> {
        Ok(match what {
            Observed::Position(index) => self.position[index],
            Observed::Momentum(index) => self.momentum[index],
            Observed::Velocity(index) | Observed::Acceleration(index) if self.velocity[index].is_nan() => {
                let reason =
                    "system.kinetic: the mass is singular on the way, so that no momentum tells the velocity";
                return Err(NoPrediction::Refused(reason.to_owned()));
            }
            Observed::Velocity(index) | Observed::Acceleration(index) => self.velocity[index],
            Observed::Energy => self.energy,
            _ => return Err(NoPrediction::of_a_motion()),
        })
    }

    fn slope(&self, what: Observed, column: usize) -> Result<f64, NoPrediction> {
        let at = column * self.position.len();
        Ok(match what {
            Observed::Position(index) => self.position_slopes[at + index],
            Observed::Momentum(index) => self.momentum_slopes[at + index],
            Observed::Velocity(index) | Observed::Acceleration(index) => self.velocity_slopes[at + index],
            Observed::Energy => self.energy_slopes[column],
            _ => return Err(NoPrediction::of_a_motion()),
        })
    }
}
