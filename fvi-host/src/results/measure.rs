//! Measures of a run: largest values, and errors against the reference.

use fvi_fft::sums::max_or_nan;
use fvi_scenario::scenario::ReferenceRow;
use fvi_simulation::column::largest;
use fvi_simulation::simulation::GridState;
use fvi_simulation::simulation::step_batch::StepBatch;
use serde::{Deserialize, Serialize};

/// The largest error so far and the last one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorMeasure {
    /// Number of values compared.
    pub compared: usize,
    /// Largest absolute error.
    pub largest: f64,
    /// Absolute error at the last time that was compared.
    pub last: f64,
    /// Largest absolute value of the reference itself.
    pub reference_largest: f64,
}

impl ErrorMeasure {
    fn compare(&mut self, found: &[f64], known: &[Option<f64>]) {
        let mut errors =
            found.iter().zip(known).filter_map(|(found, known)| known.map(|known| (found, known)));
        let Some((first_found, first_known)) = errors.next() else { return };
        let mut last = 0.0_f64;
        for (found, known) in core::iter::once((first_found, first_known)).chain(errors) {
            // A difference that overflows or is NaN counts as the largest finite number.
            let error = Some((found - known).abs()).filter(|error| error.is_finite());
            last = last.max(error.unwrap_or(f64::MAX));
            self.reference_largest = self.reference_largest.max(known.abs());
            self.compared += 1;
        }
        self.last = last;
        self.largest = max_or_nan(self.largest, last);
    }
}

/// Errors against the reference, over all grid points where it is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ReferenceErrors {
    /// Of the position, the largest over the coordinates.
    #[serde(skip_serializing_if = "unknown")]
    pub position: ErrorMeasure,
    /// Of the momentum, the largest over the coordinates.
    #[serde(skip_serializing_if = "unknown")]
    pub momentum: ErrorMeasure,
    /// Of the energy.
    #[serde(skip_serializing_if = "unknown")]
    pub energy: ErrorMeasure,
    /// Values of the reference that are infinite or not a number; nothing is compared with them.
    #[serde(skip_serializing_if = "none")]
    pub undefined: usize,
}

fn none(count: &usize) -> bool {
    *count == 0
}

fn unknown(measure: &ErrorMeasure) -> bool {
    measure.compared == 0
}

impl ReferenceErrors {
    /// Compares one grid point.
    pub fn compare(&mut self, state: &GridState, known: &ReferenceRow) {
        self.position.compare(&state.position, &known.position);
        self.momentum.compare(&state.momentum, &known.momentum);
        self.energy.compare(&[state.energy], &[known.energy]);
        self.undefined += known.undefined;
    }

    /// Errors of position, momentum and energy, and the number of undefined values, for storage;
    /// [`of_parts`](Self::of_parts) is the inverse.
    pub(crate) fn parts(&self) -> ([ErrorMeasure; 3], usize) {
        ([self.position, self.momentum, self.energy], self.undefined)
    }

    /// Inverse of [`parts`](Self::parts).
    pub(crate) fn of_parts(([position, momentum, energy], undefined): ([ErrorMeasure; 3], usize)) -> Self {
        Self { position, momentum, energy, undefined }
    }

    /// Warning about values of the reference that are not finite.
    pub fn warning(&self) -> Option<String> {
        (self.undefined > 0).then(|| {
            format!("reference: {} of its values are not finite numbers and are not compared", self.undefined)
        })
    }

    /// True if anything was compared.
    pub fn any(&self) -> bool {
        self.position.compared + self.momentum.compared + self.energy.compared > 0
    }
}

/// Largest absolute values over all grid points.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Largest {
    /// Of each coordinate.
    pub position: Vec<f64>,
    /// Of each momentum.
    pub momentum: Vec<f64>,
    /// Of the energy.
    pub energy: f64,
}

impl Largest {
    /// Updates the maxima with the states of a batch, which are finite.
    pub(crate) fn take(&mut self, batch: &StepBatch) {
        match batch.alone() {
            Some((position, momentum)) => {
                raise_each(&mut self.position, position);
                raise_each(&mut self.momentum, momentum);
            }
            None => {
                raise(&mut self.position, batch.positions());
                raise(&mut self.momentum, batch.momenta());
            }
        }
        let energies = batch.energies();
        self.energy = match batch.with_energy() {
            None => max_or_nan(self.energy, largest(energies)),
            Some(known) => known.fold(self.energy, |most, index| max_or_nan(most, energies[index].abs())),
        };
    }
}

/// Raises each entry of `most` to the largest absolute value of its column.
fn raise<'a>(most: &mut Vec<f64>, columns: impl Iterator<Item = &'a [f64]>) {
    for (index, column) in columns.enumerate() {
        if index == most.len() {
            most.push(0.0);
        }
        most[index] = max_or_nan(most[index], largest(column));
    }
}

/// Raises each entry of `most` to the absolute value of its number.
fn raise_each(most: &mut Vec<f64>, numbers: &[f64]) {
    most.resize(numbers.len(), 0.0);
    most.iter_mut().zip(numbers).for_each(|(most, number)| *most = max_or_nan(*most, number.abs()));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn not_a_number_is_not_passed_over() {
        let mut errors = ErrorMeasure::default();
        for number in [1.0, f64::NAN, 2.0] {
            errors.compare(&[number], &[Some(0.0)]);
        }
        assert_eq!(errors.largest, f64::MAX);
    }

    #[test]
    fn largest_values_are_those_of_all_states() {
        for one_by_one in [false, true] {
            let mut largest = Largest::default();
            for sign in [1.0, -1.0] {
                let mut batch = StepBatch::new(1, one_by_one, 1);
                for number in [1.0, -3.0, 2.0] {
                    if one_by_one {
                        batch.begin(0);
                    }
                    let (position, momentum) = (vec![sign * number], vec![0.5]);
                    batch.push_state(
                        &GridState { position, momentum, energy: -number, ..GridState::default() },
                        0,
                    );
                    largest.take(&batch);
                }
            }
            assert_eq!(largest, Largest { position: vec![3.0], momentum: vec![0.5], energy: 3.0 });
        }
    }

    #[test]
    fn only_what_is_known_is_compared() {
        let mut errors = ReferenceErrors::default();
        let state = |q: f64| GridState {
            time: 0.0,
            position: vec![q, 9.0],
            momentum: vec![0.0, 0.0],
            energy: 2.0,
            ..GridState::default()
        };
        let known = |energy| ReferenceRow {
            time: 0.0,
            position: vec![Some(1.0), None],
            momentum: vec![None, None],
            energy,
            undefined: 0,
        };
        errors.compare(&state(1.5), &known(Some(-1.0)));
        errors.compare(&state(0.75), &known(None));
        let position = ErrorMeasure { compared: 2, largest: 0.5, last: 0.25, reference_largest: 1.0 };
        assert_eq!(errors.position, position);
        assert_eq!(errors.momentum, ErrorMeasure::default());
        assert_eq!(
            errors.energy,
            ErrorMeasure { compared: 1, largest: 3.0, last: 3.0, reference_largest: 1.0 }
        );
        let record = serde_json::to_value(errors).unwrap();
        assert!(record.get("momentum").is_none() && record["energy"]["largest"] == 3.0);
    }

    #[test]
    fn an_error_is_never_infinite_and_never_forgotten() {
        let mut errors = ReferenceErrors::default();
        let state = |q: f64| GridState { position: vec![q], momentum: vec![0.0], ..GridState::default() };
        let known = |q: f64| ReferenceRow {
            time: 0.0,
            position: vec![Some(q)],
            momentum: vec![None],
            energy: None,
            undefined: 3,
        };
        errors.compare(&state(f64::MAX), &known(f64::MIN));
        assert_eq!((errors.position.largest, errors.undefined), (f64::MAX, 3));
        let mut errors = ReferenceErrors::default();
        errors.compare(&state(f64::NAN), &known(0.0));
        assert_eq!(errors.position.largest, f64::MAX);
    }
}
