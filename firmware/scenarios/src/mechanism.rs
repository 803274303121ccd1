//! A mass on a rod that swings in the plane: a constraint, and a viscoelastic strut to a point beside it,
//! without allocation.
//!
//! ```text
//! q̈ = (0, −g) − λ ∂c/∂q − f ∂l/∂q ,     c = |q|² − 1 = 0 ,     l = |q − a| ,     a = (1.5, 0.2)
//! f = Σ_j c_j y_j ,     ẏ_j = l̇ − y_j/τ_j ,     h = 0.02
//! ```
//!
//! Two stages, so that positions and momenta have order 4; lengths in m, mass 1 kg, g = 9.81 m/s².

use core::fmt;

use fvi_core::{
    DamperRow, GaussLobatto, Instant, Lagrangian, MechanismIntegrator, Real, RelaxationTable, Relaxing,
    Second,
};

use crate::bits::Bits;
use crate::refusal::Refusal;

/// Steps of the run.
pub const STEPS: usize = 250;
/// Step size.
pub const STEP_SIZE: f64 = 0.02;
/// Where the strut is held.
pub const HELD: [f64; 2] = [1.5, 0.2];
/// 1/τ_j.
pub const RATES: [f64; 2] = [0.8, 6.0];
/// c_j.
pub const STRENGTHS: [f64; 2] = [0.5, 3.0];
/// g.
pub const GRAVITY: f64 = 9.81;
/// Position and velocity at the start.
pub const START: [[f64; 2]; 2] = [[0.6, -0.8], [1.6, 1.2]];

const STAGES: usize = 2;
/// Coordinates, constraints, elongations.
const SHAPE: [usize; 3] = [2, 1, 1];

/// A scalar with the strut's numbers in flash.
pub trait Tabulated: Bits {
    /// 1/τ_j, c_j and ρ.
    const STRUT: [&'static [Self]; 3];
}

impl Tabulated for f32 {
    const STRUT: [&'static [Self]; 3] =
        [&[RATES[0] as f32, RATES[1] as f32], &[STRENGTHS[0] as f32, STRENGTHS[1] as f32], &[1.0]];
}

impl Tabulated for f64 {
    const STRUT: [&'static [Self]; 3] = [&RATES, &STRENGTHS, &[1.0]];
}

type Strut<T, const N: usize> = Relaxing<T, &'static [T], [T; N]>;
type Row<T, const N: usize> = DamperRow<Strut<T, N>, [Strut<T, N>; 1]>;
type Swinging<T, const N: usize, const B: usize, const P: usize> =
    MechanismIntegrator<T, Swing<T>, Row<T, N>, [T; B], [usize; P]>;

/// Numbers of the strut's buffer.
const STRUT: usize = Strut::<f64, 0>::numbers(RATES.len(), STAGES, 1);
/// Numbers of the integrator's buffer, which depend on the numbers of coordinates and stages alone.
const NUMBERS: usize = Swinging::<f64, 0, 0, 0>::numbers(STAGES, SHAPE);
/// Unknowns of a step.
const UNKNOWNS: usize = Swinging::<f64, 0, 0, 0>::unknowns(STAGES, SHAPE);

type Integrator<T> = Swinging<T, STRUT, NUMBERS, UNKNOWNS>;

/// The mass on its rod; the strut's place.
#[derive(Clone, Copy, Debug)]
pub struct Swing<T> {
    held: [T; 2],
    gravity: T,
}

impl<T: Real> Swing<T> {
    /// q − a, and |q − a|.
    fn strut(&self, position: &[T]) -> ([T; 2], T) {
        let [x, y] = pair(position);
        let along = [x - self.held[0], y - self.held[1]];
        (along, (along[0] * along[0] + along[1] * along[1]).sqrt())
    }
}

/// Both numbers of a vector.
fn pair<T: Real>(vector: &[T]) -> [T; 2] {
    match *vector {
        [x, y] => [x, y],
        _ => [T::zero(); 2],
    }
}

fn write<T: Copy>(to: &mut [T], numbers: &[T]) {
    to.iter_mut().zip(numbers).for_each(|(to, &number)| *to = number);
}

impl<T: Real> Lagrangian<T> for Swing<T> {
    fn coordinates(&self) -> usize {
        2
    }

    fn constraints(&self) -> usize {
        1
    }

    fn elongations(&self) -> usize {
        1
    }

    fn first(&mut self, _: Instant<T>, _: &[T], velocity: &[T], momentum: &mut [T], force: &mut [T]) {
        write(momentum, velocity);
        write(force, &[T::zero(), -self.gravity]);
    }

    fn second(&mut self, _: Instant<T>, _: &[T], _: &[T], parts: Second<'_, T>) {
        let (zero, one) = (T::zero(), T::one());
        write(parts.mass, &[one, zero, zero, one]);
        parts.coupling.fill(zero);
        parts.resistance.fill(zero);
        parts.stiffness.fill(zero);
    }

    fn has_constant_mass(&self) -> bool {
        true
    }

    fn constrain(&mut self, position: &[T], values: &mut [T], jacobian: &mut [T]) {
        let [x, y] = pair(position);
        write(values, &[x * x + y * y - T::one()]);
        write(jacobian, &[x + x, y + y]);
    }

    fn add_constraint_curvature(&mut self, _: &[T], multipliers: &[T], factor: T, sum: &mut [T]) {
        let twice = multipliers.iter().fold(T::zero(), |sum, &multiplier| sum + multiplier + multiplier);
        // The diagonal of a 2×2 matrix.
        sum.iter_mut().step_by(3).for_each(|entry| *entry += factor * twice);
    }

    fn elongate(&mut self, position: &[T], jacobian: &mut [T]) {
        let ([x, y], length) = self.strut(position);
        write(jacobian, &[x / length, y / length]);
    }

    fn turn(&mut self, position: &[T], velocity: &[T], forces: &[T], turning: &mut [T], stiffness: &mut [T]) {
        let ([x, y], length) = self.strut(position);
        let cube = length * length * length;
        let bend = [y * y / cube, -x * y / cube, -x * y / cube, x * x / cube];
        let [u, v] = pair(velocity);
        write(turning, &[bend[0] * u + bend[1] * v, bend[2] * u + bend[3] * v]);
        for &force in forces {
            stiffness.iter_mut().zip(bend).for_each(|(entry, bend)| *entry -= force * bend);
        }
    }

    fn energy(&mut self, position: &[T], velocity: &[T]) -> T {
        let ([u, v], [_, height]) = (pair(velocity), pair(position));
        T::of(0.5) * (u * u + v * v) + self.gravity * height
    }
}

/// The mechanism at its start.
fn begin<T: Tabulated>() -> Result<Integrator<T>, Refusal> {
    let rule = GaussLobatto::new(STAGES)?;
    let [rates, coefficients, rho] = T::STRUT;
    let horizon = STEP_SIZE * STEPS as f64;
    let table = RelaxationTable { is_inertial: false, rates, coefficients, shortest: STEP_SIZE, horizon };
    let strut = Strut::new(&rule, table, rho, 1, [T::zero(); STRUT])?;
    let system = Swing { held: HELD.map(T::of), gravity: T::of(GRAVITY) };
    let [position, velocity] = START.map(|of| of.map(T::of));
    let (time, buffers) = ((T::of(STEP_SIZE), T::zero()), ([T::zero(); NUMBERS], [0; UNKNOWNS]));
    let dampers = Row::new([strut]);
    Ok(Integrator::new(rule, (system, dampers), time, (&position, &velocity), true, buffers)?)
}

/// Runs the scenario and writes `k q0 q1 v0 v1 w`, k = 0 … [`STEPS`], with the work w that the strut has
/// taken up, the numbers as the hexadecimal digits of their bits.
///
/// # Errors
/// What a constructor, a step or `out` refuses; with the numbers of this scenario, the first two refuse
/// nothing.
pub fn run<T: Tabulated>(out: &mut impl fmt::Write) -> Result<(), Refusal> {
    let mut integrator = begin::<T>()?;
    for step in 0..=STEPS {
        write!(out, "{step}")?;
        for number in integrator.position().iter().chain(integrator.velocity()) {
            write!(out, " {}", number.hexadecimal())?;
        }
        writeln!(out, " {}", integrator.work().hexadecimal())?;
        if step < STEPS {
            integrator.step(&[])?;
        }
    }
    Ok(())
}

/// [`run`] in single and then in double precision, each under a heading with the scalar's name.
///
/// # Errors
/// As [`run`].
pub fn run_both(out: &mut impl fmt::Write) -> Result<(), Refusal> {
    writeln!(out, "{}", f32::NAME)?;
    run::<f32>(out)?;
    writeln!(out, "{}", f64::NAME)?;
    run::<f64>(out)
}
