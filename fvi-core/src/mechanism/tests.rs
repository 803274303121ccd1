//! Orders, laws and refusals of mechanisms, on systems whose motion is known otherwise.

use super::*;
use crate::real::max_or_nan;
use crate::saving::{StateReader, StateWriter, Stateful};
use crate::scheme::StepError;
use crate::system::Instant;
use std::vec;
use std::vec::Vec;

/// A mass on a spring of length 1 that swings in the plane under gravity g, damped along the spring; or on a
/// rod, if `is_rod`.
#[derive(Clone, Debug)]
struct Swing {
    stiffness: f64,
    gravity: f64,
    is_rod: bool,
    is_damped: bool,
    /// A rod given twice.
    is_twice: bool,
}

impl Lagrangian<f64> for Swing {
    fn coordinates(&self) -> usize {
        2
    }

    fn constraints(&self) -> usize {
        usize::from(self.is_rod) + usize::from(self.is_twice)
    }

    fn elongations(&self) -> usize {
        usize::from(self.is_damped)
    }

    fn first(&mut self, _: Instant<f64>, q: &[f64], v: &[f64], momentum: &mut [f64], force: &mut [f64]) {
        let length = q[0].hypot(q[1]);
        let pull = self.stiffness * (length - 1.0) / length;
        momentum.copy_from_slice(v);
        force.copy_from_slice(&[-pull * q[0], -pull * q[1] - self.gravity]);
    }

    fn second(&mut self, _: Instant<f64>, q: &[f64], _: &[f64], parts: Second<'_, f64>) {
        let length = q[0].hypot(q[1]);
        let (k, cube) = (self.stiffness, length * length * length);
        parts.mass.copy_from_slice(&[1.0, 0.0, 0.0, 1.0]);
        parts.coupling.fill(0.0);
        parts.resistance.fill(0.0);
        let across = k * q[0] * q[1] / cube;
        parts.stiffness.copy_from_slice(&[
            -k + k * q[1] * q[1] / cube,
            -across,
            -across,
            -k + k * q[0] * q[0] / cube,
        ]);
    }

    fn constrain(&mut self, q: &[f64], values: &mut [f64], jacobian: &mut [f64]) {
        for (index, value) in values.iter_mut().enumerate() {
            let factor = [1.0, 3.0][index];
            *value = factor * (q[0] * q[0] + q[1] * q[1] - 1.0);
            jacobian[2 * index..2 * index + 2].copy_from_slice(&[2.0 * factor * q[0], 2.0 * factor * q[1]]);
        }
    }

    fn add_constraint_curvature(&mut self, _: &[f64], multipliers: &[f64], factor: f64, sum: &mut [f64]) {
        for &multiplier in multipliers {
            sum[0] += 2.0 * factor * multiplier;
            sum[3] += 2.0 * factor * multiplier;
        }
    }

    fn elongate(&mut self, q: &[f64], jacobian: &mut [f64]) {
        if self.is_damped {
            let length = q[0].hypot(q[1]);
            jacobian.copy_from_slice(&[q[0] / length, q[1] / length]);
        }
    }

    fn turn(&mut self, q: &[f64], v: &[f64], forces: &[f64], turning: &mut [f64], stiffness: &mut [f64]) {
        if !self.is_damped {
            return;
        }
        let cube = q[0].hypot(q[1]).powi(3);
        let bend = [q[1] * q[1] / cube, -q[0] * q[1] / cube, -q[0] * q[1] / cube, q[0] * q[0] / cube];
        turning.copy_from_slice(&[bend[0] * v[0] + bend[1] * v[1], bend[2] * v[0] + bend[3] * v[1]]);
        stiffness.iter_mut().zip(bend).for_each(|(place, bend)| *place -= forces[0] * bend);
    }

    fn energy(&mut self, q: &[f64], v: &[f64]) -> f64 {
        let stretch = q[0].hypot(q[1]) - 1.0;
        0.5 * (v[0] * v[0] + v[1] * v[1]) + 0.5 * self.stiffness * stretch * stretch + self.gravity * q[1]
    }
}

type Element = Relaxing<f64, Vec<f64>, Vec<f64>>;
type Row = DamperRow<Element, Vec<Element>>;
type Swinging = MechanismIntegrator<f64, Swing, Row, Vec<f64>, Vec<usize>>;

/// Two Maxwell elements and a dashpot beside each other.
fn elements(rule: &GaussLobatto<f64>, shortest: f64) -> Element {
    let rates = vec![0.7, 9.0, 1e16];
    let coefficients = vec![1.5, 4.0, 0.3 * 1e16];
    let table = RelaxationTable { is_inertial: false, rates, coefficients, shortest, horizon: 100.0 };
    let numbers = vec![0.0; Element::numbers(3, rule.stages(), 1)];
    Relaxing::new(rule, table, vec![0.8], 1, numbers).unwrap()
}

fn swinging(
    swing: Swing,
    stages: usize,
    h: f64,
    start: ([f64; 2], [f64; 2]),
) -> Result<Swinging, MechanismError> {
    let rule = GaussLobatto::new(stages).unwrap();
    let shape = [2, swing.constraints(), swing.elongations()];
    let dampers = Row::new(if swing.is_damped { vec![elements(&rule, h)] } else { Vec::new() });
    let buffers = (vec![0.0; Swinging::numbers(stages, shape)], vec![0; Swinging::unknowns(stages, shape)]);
    let (position, velocity) = start;
    Swinging::new(rule, (swing, dampers), (h, 0.0), (&position, &velocity), false, buffers)
}

const SPRING: Swing =
    Swing { stiffness: 20.0, gravity: 3.0, is_rod: false, is_damped: true, is_twice: false };
const ROD: Swing = Swing { is_rod: true, ..SPRING };
const START: ([f64; 2], [f64; 2]) = ([1.2, 0.1], [0.4, -0.5]);

fn after(swing: &Swing, start: ([f64; 2], [f64; 2]), stages: usize, steps: usize) -> [f64; 4] {
    let mut swinging = swinging(swing.clone(), stages, 2.0 / steps as f64, start).unwrap();
    for _ in 0..steps {
        swinging.step(&[]).unwrap();
    }
    let mut momentum = [0.0; 2];
    assert!(swinging.write_momentum(&mut momentum));
    let q = swinging.position();
    [q[0], q[1], momentum[0], momentum[1]]
}

fn distance(one: &[f64; 4], other: &[f64; 4]) -> f64 {
    one.iter().zip(other).fold(0.0, |most, (a, b)| max_or_nan(most, (a - b).abs()))
}

#[test]
fn positions_and_momenta_have_twice_the_order_of_the_stages() {
    for (swing, start) in [(SPRING, START), (ROD, ([0.6, 0.8], [-0.8, 0.6]))] {
        let exact = after(&swing, start, 5, 80);
        for (stages, steps) in [(1, 160), (2, 80), (3, 40), (4, 20)] {
            let coarse = distance(&after(&swing, start, stages, steps), &exact);
            let fine = distance(&after(&swing, start, stages, 2 * steps), &exact);
            let order = (coarse / fine).log2();
            let expected = 2.0 * stages as f64;
            assert!((order - expected).abs() < 0.3, "{stages} stages, rod {}: {order}", swing.is_rod);
        }
    }
}

#[test]
fn a_rod_swings_as_the_pendulum_of_its_angle_does() {
    // φ from the vertical: φ'' = −3 sin φ, by many steps of the classical Runge–Kutta method.
    let (mut angle, mut rate, h) = (0.5_f64, 1.0, 1e-4);
    let slope = |angle: f64, rate: f64| (rate, -3.0 * angle.sin());
    for _ in 0..20_000 {
        let (a1, b1) = slope(angle, rate);
        let (a2, b2) = slope(angle + 0.5 * h * a1, rate + 0.5 * h * b1);
        let (a3, b3) = slope(angle + 0.5 * h * a2, rate + 0.5 * h * b2);
        let (a4, b4) = slope(angle + h * a3, rate + h * b3);
        angle += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4);
        rate += h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4);
    }
    let swing = Swing { is_damped: false, stiffness: 0.0, ..ROD };
    let start = ([0.5_f64.sin(), -0.5_f64.cos()], [0.5_f64.cos(), 0.5_f64.sin()]);
    let mut swinging = swinging(swing, 4, 0.02, start).unwrap();
    for _ in 0..100 {
        swinging.step(&[]).unwrap();
        assert!(swinging.constraint_error() < 1e-14);
        let (q, v) = (swinging.position(), swinging.velocity());
        assert!((q[0] * v[0] + q[1] * v[1]).abs() < 1e-14);
    }
    let expected = [angle.sin(), -angle.cos()];
    let error =
        swinging.position().iter().zip(expected).fold(0.0, |most, (q, e)| max_or_nan(most, (q - e).abs()));
    assert!(error < 1e-11, "{error:e}");
    // The rod carries gravity and the centripetal force: −2 λ = −(g cos φ + φ'²).
    let mut multiplier = [0.0];
    assert!(swinging.write_multipliers(&mut multiplier));
    let tension = 3.0 * angle.cos() + rate * rate;
    assert!((2.0 * multiplier[0] - tension).abs() < 1e-10, "{} and {tension}", 2.0 * multiplier[0]);
}

#[test]
fn the_energy_of_a_quadratic_potential_changes_by_the_work_of_the_dampers_alone() {
    // Spring to the origin: k/2 |q|² by a rest length far below.
    #[derive(Clone)]
    struct Bowl;
    impl Lagrangian<f64> for Bowl {
        fn coordinates(&self) -> usize {
            2
        }
        fn elongations(&self) -> usize {
            1
        }
        fn first(&mut self, _: Instant<f64>, q: &[f64], v: &[f64], momentum: &mut [f64], force: &mut [f64]) {
            momentum.copy_from_slice(v);
            force.copy_from_slice(&[-4.0 * q[0], -9.0 * q[1]]);
        }
        fn second(&mut self, _: Instant<f64>, _: &[f64], _: &[f64], parts: Second<'_, f64>) {
            parts.mass.copy_from_slice(&[1.0, 0.0, 0.0, 1.0]);
            parts.coupling.fill(0.0);
            parts.resistance.fill(0.0);
            parts.stiffness.copy_from_slice(&[-4.0, 0.0, 0.0, -9.0]);
        }
        fn elongate(&mut self, q: &[f64], jacobian: &mut [f64]) {
            SPRING.clone().elongate(q, jacobian);
        }
        fn turn(&mut self, q: &[f64], v: &[f64], f: &[f64], turning: &mut [f64], stiffness: &mut [f64]) {
            SPRING.clone().turn(q, v, f, turning, stiffness);
        }
        fn energy(&mut self, q: &[f64], v: &[f64]) -> f64 {
            0.5 * (v[0] * v[0] + v[1] * v[1]) + 2.0 * q[0] * q[0] + 4.5 * q[1] * q[1]
        }
    }
    for (stages, h) in [(1, 0.05), (2, 0.3), (3, 0.8)] {
        let rule = GaussLobatto::new(stages).unwrap();
        type Rolling = MechanismIntegrator<f64, Bowl, Element, Vec<f64>, Vec<usize>>;
        let numbers = vec![0.0; Rolling::numbers(stages, [2, 0, 1])];
        let buffers = (numbers, vec![0; Rolling::unknowns(stages, [2, 0, 1])]);
        let start: (&[f64], &[f64]) = (&[1.0, 0.3], &[0.0, 0.7]);
        let dampers = elements(&rule, h);
        let mut rolling = Rolling::new(rule, (Bowl, dampers), (h, 0.0), start, false, buffers).unwrap();
        let first = rolling.energy();
        for step in 1..=60 {
            rolling.step(&[]).unwrap();
            let (energy, work, stored) = (rolling.energy(), rolling.work(), rolling.stored());
            assert!((energy + work - first).abs() < 3e-13, "{stages} stages, step {step}: {energy}, {work}");
            // What the dampers have taken up is stored at most.
            assert!(
                stored >= 0.0 && work - stored > -1e-13,
                "{stages} stages, step {step}: {work}, {stored}"
            );
        }
        assert!(rolling.work() > 0.5 * first);
    }
}

#[test]
fn a_saved_state_goes_on_with_the_same_bits() {
    let mut whole = swinging(ROD, 2, 0.02, ([0.6, 0.8], [-0.8, 0.6])).unwrap();
    for _ in 0..20 {
        whole.step(&[]).unwrap();
    }
    let mut bytes = vec![0; whole.state_bytes()];
    let mut writer = StateWriter::new(&mut bytes);
    whole.save(&mut writer).unwrap();
    assert_eq!(writer.written(), bytes.len());
    let mut other = swinging(ROD, 2, 0.02, ([0.6, 0.8], [-0.8, 0.6])).unwrap();
    other.restore(&mut StateReader::new(&bytes)).unwrap();
    for _ in 0..20 {
        whole.step(&[0.1]).unwrap();
        other.step(&[0.1]).unwrap();
        assert_eq!(whole.position(), other.position());
        assert_eq!(
            (whole.time(), whole.work(), whole.tensions()),
            (other.time(), other.work(), other.tensions())
        );
    }
    let mut another = swinging(SPRING, 2, 0.02, START).unwrap();
    assert!(another.restore(&mut StateReader::new(&bytes)).is_err());
}

#[test]
fn what_cannot_be_integrated_is_refused_with_its_numbers() {
    let refused =
        |swing: Swing, position, velocity| swinging(swing, 2, 0.1, (position, velocity)).unwrap_err();
    let off = refused(ROD, [1.1, 0.0], [0.0, 0.0]);
    assert!(matches!(off, MechanismError::OffConstraint { index: 0, value } if (value - 0.21).abs() < 1e-12));
    let leaves = refused(ROD, [1.0, 0.0], [0.5, 0.0]);
    assert!(
        matches!(leaves, MechanismError::LeavesConstraint { index: 0, rate } if (rate - 1.0).abs() < 1e-12)
    );
    let twice = refused(Swing { is_twice: true, ..ROD }, [1.0, 0.0], [0.0, 0.0]);
    assert_eq!(twice, MechanismError::Redundant { index: 1 });
    assert_eq!(refused(ROD, [1.0, f64::NAN], [0.0, 0.0]), MechanismError::InitialState);
}

#[test]
fn a_start_off_the_constraints_is_moved_onto_them_on_request() {
    let rule = GaussLobatto::new(2).unwrap();
    let swing = Swing { is_damped: false, ..ROD };
    let shape = [2, 1, 0];
    let buffers = (vec![0.0; Swinging::numbers(2, shape)], vec![0; Swinging::unknowns(2, shape)]);
    let start: (&[f64], &[f64]) = (&[1.2, 0.9], &[1.0, 0.0]);
    let mut made =
        Swinging::new(rule, (swing, Row::new(Vec::new())), (0.1, 0.0), start, true, buffers).unwrap();
    assert!(made.constraint_error() < 1e-15);
    let (q, v) = (made.position().to_vec(), made.velocity().to_vec());
    // The nearest point of the circle, and the velocity without its radial part.
    assert!((q[0] - 0.8).abs() < 1e-2 && (q[1] - 0.6).abs() < 1e-2, "{q:?}");
    assert!((q[0] * v[0] + q[1] * v[1]).abs() < 1e-15);
    assert!((v[0] * q[1] - v[1] * q[0] - q[1]).abs() < 1e-14);
}

#[test]
fn a_step_that_fails_leaves_the_state_as_it_was() {
    let mut swinging = swinging(SPRING, 2, 0.02, START).unwrap();
    swinging.step(&[]).unwrap();
    let (before, energy) = (swinging.position().to_vec(), swinging.energy());
    assert_eq!(swinging.step(&[f64::NAN]), Err(StepError::NotFinite));
    assert!(matches!(swinging.step_over(1e-9, 1.0, &[]), Err(StepError::Memory(_))));
    assert_eq!((swinging.position(), swinging.steps()), (&before[..], 1));
    assert_eq!(swinging.energy(), energy);
    assert!(swinging.step(&[]).is_ok());
}

/// A mass that depends on the position, and a term linear in the velocity:
/// L = ½ (1 + q₁²) v₀² + ½ v₁² + q₁ v₀ − q₀² − q₁⁴, or with ½ (1 − q₀) v₁².
#[derive(Clone, Copy, Debug)]
struct Curved {
    is_indefinite: bool,
}

impl Curved {
    /// M₁₁, with its first two derivatives.
    fn second_mass(self, q: &[f64]) -> [f64; 3] {
        if self.is_indefinite { [1.0 - q[0], -1.0, 0.0] } else { [1.0, 0.0, 0.0] }
    }
}

impl Lagrangian<f64> for Curved {
    fn coordinates(&self) -> usize {
        2
    }

    fn first(&mut self, _: Instant<f64>, q: &[f64], v: &[f64], momentum: &mut [f64], force: &mut [f64]) {
        let [mass, slope, _] = self.second_mass(q);
        momentum.copy_from_slice(&[(1.0 + q[1] * q[1]) * v[0] + q[1], mass * v[1]]);
        force.copy_from_slice(&[
            0.5 * slope * v[1] * v[1] - 2.0 * q[0],
            q[1] * v[0] * v[0] + v[0] - 4.0 * q[1].powi(3),
        ]);
    }

    fn second(&mut self, _: Instant<f64>, q: &[f64], v: &[f64], parts: Second<'_, f64>) {
        let [mass, slope, bend] = self.second_mass(q);
        parts.mass.copy_from_slice(&[1.0 + q[1] * q[1], 0.0, 0.0, mass]);
        parts.coupling.copy_from_slice(&[0.0, 2.0 * q[1] * v[0] + 1.0, slope * v[1], 0.0]);
        parts.resistance.copy_from_slice(&[0.0, slope * v[1], 2.0 * q[1] * v[0] + 1.0, 0.0]);
        let down = v[0] * v[0] - 12.0 * q[1] * q[1];
        parts.stiffness.copy_from_slice(&[0.5 * bend * v[1] * v[1] - 2.0, 0.0, 0.0, down]);
    }

    fn polarised(
        &mut self,
        q: &[f64],
        [v, w]: [&[f64]; 2],
        gradient: &mut [f64],
        hessian: Option<&mut [f64]>,
    ) -> Option<[f64; 2]> {
        let [mass, slope, bend] = self.second_mass(q);
        let (first, second, mean) = (v[0] * w[0], v[1] * w[1], 0.5 * (v[0] + w[0]));
        gradient
            .copy_from_slice(&[0.5 * slope * second - 2.0 * q[0], q[1] * first + mean - 4.0 * q[1].powi(3)]);
        if let Some(hessian) = hessian {
            let entries = [0.5 * bend * second - 2.0, 0.0, 0.0, first - 12.0 * q[1] * q[1]];
            hessian.copy_from_slice(&entries);
        }
        let terms = [
            0.5 * (1.0 + q[1] * q[1]) * first,
            0.5 * mass * second,
            q[1] * mean,
            -q[0] * q[0],
            -q[1].powi(4),
        ];
        Some([terms.iter().sum(), terms.iter().map(|term| term.abs()).sum()])
    }

    fn energy(&mut self, q: &[f64], v: &[f64]) -> f64 {
        let moving = 0.5 * (1.0 + q[1] * q[1]) * v[0] * v[0] + 0.5 * self.second_mass(q)[0] * v[1] * v[1];
        moving + q[0] * q[0] + q[1].powi(4)
    }
}

type Curving = MechanismIntegrator<f64, Curved, (), Vec<f64>, Vec<usize>>;

fn conserving(curved: Curved, h: f64, start: [[f64; 2]; 2]) -> Result<Curving, MechanismError> {
    let buffers = (vec![0.0; Curving::conserving_numbers([2, 0, 0])], vec![0; 3]);
    Curving::conserving((curved, ()), (h, 0.0), (&start[0], &start[1]), false, buffers)
}

/// Newton's method converges quadratically, so that its matrix is right, and energies are constant.
#[test]
fn discrete_gradients_of_a_polarised_lagrangian_keep_the_energy() {
    for h in [0.02, 0.1, 0.3, 1.5] {
        let start = [[0.8, -0.6], [0.5, 1.0]];
        let mut curving = conserving(Curved { is_indefinite: false }, h, start).unwrap();
        let first = curving.energy();
        let mut corrections = 0;
        for step in 1..=200 {
            corrections += curving.step(&[]).unwrap();
            let energy = curving.energy();
            assert!((energy - first).abs() < 1e-12 * first, "h = {h}, step {step}: {energy} {first}");
        }
        assert!(h > 0.2 || corrections <= 5 * 200, "h = {h}: {corrections}");
    }
}

#[test]
fn steps_of_half_the_length_are_four_times_as_accurate_by_discrete_gradients() {
    let at = |steps: u32| {
        let start = [[0.8, -0.6], [0.5, 1.0]];
        let mut curving = conserving(Curved { is_indefinite: false }, 2.0 / f64::from(steps), start).unwrap();
        (0..steps).for_each(|_| {
            curving.step(&[]).unwrap();
        });
        [curving.position(), curving.momentum()].concat()
    };
    let [coarse, fine, finest] = [100, 200, 400].map(at);
    let change = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, max_or_nan);
    let order = (change(&coarse, &fine) / change(&fine, &finest)).log2();
    assert!((order - 2.0).abs() < 0.1, "{order}");
}

/// M₁₁ = 1 − q₀.
#[test]
fn a_mass_that_is_not_positive_definite_is_refused_with_its_coordinate() {
    let curved = Curved { is_indefinite: true };
    let refused = conserving(curved, 0.1, [[1.5, 0.0], [0.0, 0.0]]).unwrap_err();
    assert_eq!(refused, MechanismError::IndefiniteMass { coordinate: 1, energy: -0.25 });
    let message = std::format!("{refused}");
    assert!(message.contains("coordinate 1") && message.contains("-2.5e-1"), "{message}");
    let allowed = conserving(curved, 0.1, [[0.5, 0.0], [0.0, 0.0]]);
    assert!(allowed.is_ok());
}
