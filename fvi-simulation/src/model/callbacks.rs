//! Terms in code, converted to the precision of a run.

use fvi_scenario::language::expression::{Elementary, Moment};
use fvi_scenario::scenario::SharedTerms;
use fvi_sparse::Pattern;

/// Potential and forces supplied in code, with buffers for their arguments and results.
#[derive(Clone, Debug)]
pub(super) struct Callbacks {
    terms: SharedTerms,
    position: Vec<f64>,
    /// Velocity, if forces depend on it.
    velocity: Vec<f64>,
    restoring: Vec<f64>,
    /// −∂F/∂v, row by row, if forces depend on the velocity.
    resistance: Vec<f64>,
    /// Stiffness: one number for each place, or row by row for a full matrix; empty if nothing depends on the
    /// position.
    stiffness: Vec<f64>,
    /// Slots of these numbers in the stiffness of the model; empty if they are in the same order.
    slots: Vec<usize>,
    places: Option<Vec<(u32, u32)>>,
    depends_on_position: bool,
}

impl Callbacks {
    pub(super) fn new(terms: SharedTerms, size: usize) -> Self {
        let depends_on_velocity = terms.depend_on_velocity();
        let depends_on_position = terms.depend_on_position();
        let moving = if depends_on_velocity { size } else { 0 };
        let places = terms.with(|terms| terms.places()).filter(|_| depends_on_position && moving == 0);
        let count = match &places {
            Some(places) => places.len(),
            None if depends_on_position => size * size,
            None => 0,
        };
        let (position, restoring) = (vec![0.0; size], vec![0.0; size]);
        Self {
            terms,
            position,
            velocity: vec![0.0; moving],
            restoring,
            resistance: vec![0.0; moving * moving],
            stiffness: vec![0.0; count],
            slots: Vec::new(),
            places,
            depends_on_position,
        }
    }

    pub(super) fn depends_on_position(&self) -> bool {
        self.depends_on_position
    }

    pub(super) fn depends_on_velocity(&self) -> bool {
        !self.velocity.is_empty()
    }

    /// Sets the velocity for the next evaluation.
    pub(super) fn move_at<T: Elementary>(&mut self, velocity: &[T]) {
        self.velocity.iter_mut().zip(velocity).for_each(|(place, number)| *place = number.to_f64());
    }

    /// −∂F/∂v at the last linearisation, row by row; empty if no force depends on the velocity.
    pub(super) fn resistance(&self) -> &[f64] {
        &self.resistance
    }

    /// The places of the stiffness, in the order of its numbers.
    pub(super) fn places(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let size = if self.places.is_none() && self.depends_on_position { self.restoring.len() } else { 0 };
        let all = (0..size).flat_map(move |row| (0..size).map(move |column| (row, column)));
        let known = self.places.iter().flatten();
        known.map(|&(row, column)| (row as usize, column as usize)).chain(all)
    }

    /// Determines the slots of its places in the pattern of the model, which contains them.
    pub(super) fn settle(&mut self, pattern: &Pattern) {
        self.slots = match &self.places {
            Some(_) => self.places().map(|(row, column)| pattern.slot(row, column)).collect(),
            None => Vec::new(),
        };
    }

    fn at<T: Elementary>(&mut self, position: &[T]) {
        for (place, number) in self.position.iter_mut().zip(position) {
            *place = number.to_f64();
        }
    }

    pub(super) fn potential<T: Elementary>(&mut self, position: &[T]) -> T {
        self.at(position);
        T::of(self.terms.with(|terms| terms.potential(&self.position)))
    }

    pub(super) fn add_restoring_force<T: Elementary>(
        &mut self,
        moment: Moment<T>,
        position: &[T],
        restoring: &mut [T],
    ) {
        self.at(position);
        self.restoring.fill(0.0);
        let (moment, velocity) = (moment.in_double(), self.velocity.as_slice());
        self.terms.with(|terms| match velocity {
            [] => terms.add_restoring_force(moment, &self.position, &mut self.restoring),
            _ => {
                terms.add_restoring_force_in_motion(moment, &self.position, velocity, &mut self.restoring);
            }
        });
        add(&self.restoring, restoring);
    }

    /// `stiffness` is the stiffness of the model: a full matrix row by row, unless the places are known.
    pub(super) fn add_linearisation<T: Elementary>(
        &mut self,
        moment: Moment<T>,
        position: &[T],
        restoring: &mut [T],
        stiffness: &mut [T],
    ) {
        if !self.depends_on_position {
            return self.add_restoring_force(moment, position, restoring);
        }
        self.at(position);
        self.restoring.fill(0.0);
        self.stiffness.fill(0.0);
        let (own_restoring, own_stiffness) = (&mut self.restoring, &mut self.stiffness);
        self.resistance.fill(0.0);
        let (moment, place) = (moment.in_double(), (self.position.as_slice(), self.velocity.as_slice()));
        let resistance = &mut self.resistance;
        self.terms.with(|terms| match place {
            (position, []) => terms.add_linearisation(moment, position, own_restoring, own_stiffness),
            _ => {
                terms.add_linearisation_in_motion(moment, place, own_restoring, own_stiffness, resistance);
            }
        });
        add(&self.restoring, restoring);
        if self.places.is_none() {
            return add(&self.stiffness, stiffness);
        }
        for (&slot, &number) in self.slots.iter().zip(&self.stiffness) {
            stiffness[slot] += T::of(number);
        }
    }
}

fn add<T: Elementary>(own: &[f64], sum: &mut [T]) {
    sum.iter_mut().zip(own).for_each(|(sum, &number)| *sum += T::of(number));
}

#[cfg(test)]
mod tests {
    use crate::simulation::motion::Motion;
    use crate::simulation::{Precision, Solver};
    use fvi_scenario::language::expression::Moment;
    use fvi_scenario::scenario::{OwnTerms, Scenario, SharedTerms};

    /// A driven pendulum, U = −9 cos q, F = sin 3t.
    struct Pendulum;

    impl OwnTerms for Pendulum {
        fn potential(&mut self, position: &[f64]) -> f64 {
            -9.0 * libm::cos(position[0])
        }

        fn add_restoring_force(&mut self, moment: Moment<f64>, position: &[f64], restoring: &mut [f64]) {
            restoring[0] += 9.0 * libm::sin(position[0]) - libm::sin(3.0 * moment.sided());
        }

        fn add_linearisation(
            &mut self,
            moment: Moment<f64>,
            position: &[f64],
            restoring: &mut [f64],
            stiffness: &mut [f64],
        ) {
            self.add_restoring_force(moment, position, restoring);
            stiffness[0] += 9.0 * libm::cos(position[0]);
        }

        fn take_largest_force(&mut self, largest: &mut [f64]) {
            largest[0] = 1.0;
        }
    }

    #[test]
    fn terms_in_code_move_as_those_in_words() {
        let scenario = |potential: serde_json::Value, force: serde_json::Value| {
            let mut system = serde_json::json!({
                "mass": [1.0, 2.0],
                "damping": [{ "order": 0.5, "coefficient": [0.1, 0.3] }],
            });
            system["potential"] = potential;
            system["force"] = force;
            Scenario::from_value(&serde_json::json!({
                "system": system,
                "initial": { "position": [2.0, 1.0], "momentum": [0.0, 0.0] },
                "time": { "step": 0.02, "steps": 200 },
            }))
            .unwrap()
        };
        let spring = "2*(q1 - q0)^2";
        let words = scenario(format!("{spring} - 9*cos(q0)").into(), ["sin(3*t)", "0"].as_slice().into());
        let code =
            scenario(spring.into(), ["0", "0"].as_slice().into()).with_own_terms(SharedTerms::new(Pendulum));
        for (precision, tolerance) in [(Precision::F64, 1e-13), (Precision::F32, 1e-4)] {
            let (mut words, mut code) =
                (Motion::start(&words, precision).unwrap(), Motion::start(&code, precision).unwrap());
            for _ in 0..200 {
                words.advance().unwrap();
                code.advance().unwrap();
            }
            let (words, code) = (words.state(), code.state());
            for (a, b) in words.position.iter().zip(&code.position) {
                assert!((a - b).abs() < tolerance, "{words:?} {code:?}");
            }
            assert!((words.energy - code.energy).abs() < 10.0 * tolerance, "{words:?} {code:?}");
        }
    }

    /// F_i = sin(t), independent of the position.
    struct Drive;

    impl OwnTerms for Drive {
        fn potential(&mut self, _: &[f64]) -> f64 {
            0.0
        }

        fn depends_on_position(&self) -> bool {
            false
        }

        fn add_restoring_force(&mut self, moment: Moment<f64>, _: &[f64], restoring: &mut [f64]) {
            restoring.iter_mut().for_each(|restoring| *restoring -= libm::sin(moment.sided()));
        }

        fn add_linearisation(&mut self, _: Moment<f64>, _: &[f64], _: &mut [f64], _: &mut [f64]) {
            panic!("nothing depends on the position");
        }

        fn take_largest_force(&mut self, largest: &mut [f64]) {
            largest.fill(1.0);
        }
    }

    #[test]
    fn forces_of_time_alone_in_code_leave_large_systems_sparse() {
        let size = 150;
        for element in [None, Some("0.25*(x1 - x0)^4")] {
            let scenario = |load: bool| {
                let mut system = serde_json::json!({
                    "mass": vec![1.0; size],
                    "stiffness": vec![4.0; size],
                    "damping": [{ "order": 0.5, "coefficient": vec![0.1; size] }],
                });
                if let Some(potential) = element {
                    system["element"] =
                        serde_json::json!([{ "potential": potential, "coordinates": [[0, 1], [7, 9]] }]);
                }
                if load {
                    system["load"] =
                        serde_json::json!([{ "pattern": vec![1.0; size], "amplitude": "sin(t)" }]);
                }
                let position: Vec<f64> = (0..size).map(|i| (i as f64).sin()).collect();
                Scenario::from_value(&serde_json::json!({
                    "system": system,
                    "initial": { "position": position },
                    "time": { "step": 0.02, "steps": 50 },
                    "output": { "coordinates": [0] },
                }))
                .unwrap()
            };
            let (words, code) = (scenario(true), scenario(false).with_own_terms(SharedTerms::new(Drive)));
            let mut motions =
                [&words, &code].map(|scenario| Motion::start(scenario, Precision::F64).unwrap());
            for motion in &mut motions {
                assert!(matches!(motion.simulation().solver(), Solver::Sparse { .. }));
                assert_eq!(motion.simulation().warning(), None);
                (0..50).for_each(|_| {
                    motion.advance().unwrap();
                });
            }
            let [words, code] = motions.map(|motion| motion.state().clone());
            for (a, b) in words.position.iter().zip(&code.position) {
                assert!((a - b).abs() < 1e-14, "{element:?}: {a} {b}");
            }
        }
    }

    /// Uncoupled pendulums, U = −9 Σ cos q_i, whose stiffness is diagonal.
    struct Row(usize);

    impl OwnTerms for Row {
        fn potential(&mut self, position: &[f64]) -> f64 {
            position.iter().map(|&q| -9.0 * libm::cos(q)).sum()
        }

        fn places(&self) -> Option<Vec<(u32, u32)>> {
            Some((0..self.0 as u32).rev().map(|index| (index, index)).collect())
        }

        fn add_restoring_force(&mut self, _: Moment<f64>, position: &[f64], restoring: &mut [f64]) {
            restoring.iter_mut().zip(position).for_each(|(restoring, &q)| *restoring += 9.0 * libm::sin(q));
        }

        fn add_linearisation(
            &mut self,
            moment: Moment<f64>,
            position: &[f64],
            restoring: &mut [f64],
            stiffness: &mut [f64],
        ) {
            assert_eq!(stiffness.len(), self.0);
            self.add_restoring_force(moment, position, restoring);
            stiffness.iter_mut().zip(position.iter().rev()).for_each(|(k, &q)| *k += 9.0 * libm::cos(q));
        }

        fn take_largest_force(&mut self, largest: &mut [f64]) {
            largest.fill(0.0);
        }
    }

    #[test]
    fn places_that_are_known_leave_a_large_system_sparse() {
        let size = 200;
        let (masses, position) = (vec![1.0; size], (0..size).map(|index| 0.01 * index as f64));
        let scenario = Scenario::from_value(&serde_json::json!({
            "system": { "mass": masses, "load": [{ "pattern": { "coordinate": 3 }, "amplitude": "sin(t)" }] },
            "initial": { "position": position.clone().collect::<Vec<f64>>() },
            "time": { "step": 0.05, "steps": 20 },
            "output": { "coordinates": [0] },
        }));
        let scenario = scenario.unwrap().with_own_terms(SharedTerms::new(Row(size)));
        let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
        assert!(matches!(motion.simulation().solver(), Solver::Sparse { .. }));
        let alone = Scenario::from_value(&serde_json::json!({
            "system": { "mass": [1.0], "potential": "-9*cos(q0)" },
            "initial": { "position": [1.0] },
            "time": { "step": 0.05, "steps": 20 },
        }));
        let alone = alone.unwrap();
        let mut pendulum = Motion::start(&alone, Precision::F64).unwrap();
        for _ in 0..20 {
            motion.advance().unwrap();
            pendulum.advance().unwrap();
        }
        assert!((motion.state().position[100] - pendulum.state().position[0]).abs() < 1e-13);
    }
}
