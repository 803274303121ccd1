//! Newton's method with line search, for the zeros of a gradient.

use serde::Serialize;

/// Settings of Newton's method.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NewtonOptions {
    /// Residual, relative to the size of the terms that cancel in it, at which an iterate counts as a
    /// solution. Below it the iteration continues as long as it reduces the residual.
    pub tolerance: f64,
    /// Largest number of Newton steps.
    pub iterations: usize,
    /// Largest number of iterations of the Krylov method in one Newton step.
    pub krylov_iterations: usize,
}

impl Default for NewtonOptions {
    fn default() -> Self {
        Self { tolerance: 1e-11, iterations: 100, krylov_iterations: 500 }
    }
}

/// Equations r(u) = 0 as Newton's method needs them.
pub(super) trait Stationarity {
    /// Evaluates the equations and their derivative at `unknowns`, and fixes the norm for the line search
    /// there; `None` where something is not finite.
    fn linearise(&mut self, unknowns: &[f64]) -> Option<Residual>;

    /// Norm of the residual at other unknowns, in the norm that the last linearisation fixed; infinite where
    /// something is not finite.
    fn norm_at(&mut self, unknowns: &[f64]) -> f64;

    /// The Newton step at the last linearisation; `None` if the linear system cannot be solved.
    fn direction(&mut self) -> Option<Direction>;

    /// The functional whose gradient the equations are, where there is one.
    fn functional(&mut self) -> Option<&mut dyn Descent> {
        None
    }
}

/// A functional that can be decreased where Newton's method for its gradient fails.
pub(super) trait Descent {
    /// Its value; infinite where something is not finite.
    fn value_at(&mut self, unknowns: &[f64]) -> f64;

    /// Its derivative along a step, at the last linearisation.
    fn slope(&self, step: &[f64]) -> f64;

    /// A step along which it decreases: minus its gradient, times a positive definite stand-in for the
    /// inverse of its second derivative.
    fn steepest(&mut self) -> Vec<f64>;
}

/// Discrete Euler–Lagrange equations written in some unknowns.
pub(super) trait Formulation: Stationarity {
    /// The unknowns that belong to positions and velocities at the points 0…N.
    fn unknowns(&self, positions: &[f64], velocities: &[f64]) -> Vec<f64>;

    /// Positions and velocities at the points 0…N; the velocity at the point outside I_σ is zero.
    fn trajectory(&mut self, unknowns: &[f64]) -> (Vec<f64>, Vec<f64>);
}

/// Size of a residual.
#[derive(Clone, Copy, Debug)]
pub(super) struct Residual {
    /// Its norm.
    pub(super) norm: f64,
    /// The norm of its terms without their signs: rounding errors are small multiples of ε times this.
    pub(super) scale: f64,
}

impl Residual {
    fn relative(self) -> f64 {
        if self.norm == 0.0 { 0.0 } else { self.norm / self.scale }
    }
}

/// A Newton step.
#[derive(Clone, Debug)]
pub(super) struct Direction {
    pub(super) step: Vec<f64>,
    /// Iterations of the Krylov method; 0 for a direct solution.
    pub(super) krylov_iterations: usize,
}

/// The best iterate.
#[derive(Clone, Debug)]
pub(super) struct Iterate {
    pub(super) unknowns: Vec<f64>,
    pub(super) newton_iterations: usize,
    pub(super) krylov_iterations: usize,
    /// Relative residual after 0, 1, 2, … Newton steps.
    pub(super) history: Vec<f64>,
    pub(super) relative_residual: f64,
    pub(super) converged: bool,
}

impl Iterate {
    /// Result if the equations cannot be evaluated at the start.
    pub(super) fn untouched() -> Self {
        Self {
            unknowns: Vec::new(),
            newton_iterations: 0,
            krylov_iterations: 0,
            history: Vec::new(),
            relative_residual: f64::INFINITY,
            converged: false,
        }
    }
}

/// Smallest fraction of a step that a line search tries.
const SHORTEST_STEP: f64 = 1.0 / (1 << 20) as f64;
/// Smallest fraction of a Newton step that is tried where the functional can be decreased instead.
const SHORTEST_NEWTON_STEP: f64 = 1.0 / 8.0;
/// Fraction of the decrease predicted by the linear model that a step must achieve.
const SUFFICIENT_DECREASE: f64 = 1e-4;
/// A converged iterate is improved further as long as a step reduces the residual by this factor.
const WORTHWHILE_GAIN: f64 = 0.25;
/// Below this relative residual only rounding errors are left.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// Newton's method from `start`: full steps where they reduce the residual, shortened ones otherwise. Where
/// shortened steps do not reduce it either, and the equations are the gradient of a functional, a step that
/// decreases the functional.
///
/// `observe` receives the number of steps and the relative residual before each step. `None` if the equations
/// cannot be evaluated at the start.
pub(super) fn minimise_residual(
    equations: &mut impl Stationarity,
    start: Vec<f64>,
    options: &NewtonOptions,
    observe: &mut dyn FnMut(usize, f64),
) -> Option<Iterate> {
    let mut residual = equations.linearise(&start)?;
    let mut point = start.clone();
    let mut best = Iterate {
        unknowns: start,
        newton_iterations: 0,
        krylov_iterations: 0,
        history: vec![residual.relative()],
        relative_residual: residual.relative(),
        converged: residual.relative() <= options.tolerance,
    };
    while best.newton_iterations < options.iterations && best.relative_residual > ROUNDING {
        observe(best.newton_iterations, residual.relative());
        let Some(direction) = equations.direction() else { break };
        best.krylov_iterations += direction.krylov_iterations;
        let Some(next) = step(equations, &point, &direction.step, residual.norm, best.converged) else {
            break;
        };
        let Some(next_residual) = equations.linearise(&next) else { break };
        let gain = next_residual.relative() / residual.relative();
        if best.converged && gain >= 1.0 {
            break;
        }
        residual = next_residual;
        point = next;
        best.newton_iterations += 1;
        best.history.push(residual.relative());
        let finished = best.converged && gain > WORTHWHILE_GAIN;
        if residual.relative() < best.relative_residual {
            best.relative_residual = residual.relative();
            best.unknowns.clone_from(&point);
            best.converged = residual.relative() <= options.tolerance;
        }
        if finished {
            break;
        }
    }
    Some(best)
}

/// The next point; a converged one is only ever improved by Newton steps.
fn step(
    equations: &mut impl Stationarity,
    from: &[f64],
    newton: &[f64],
    norm: f64,
    converged: bool,
) -> Option<Vec<f64>> {
    let has_functional = equations.functional().is_some();
    let shortest = if has_functional { SHORTEST_NEWTON_STEP } else { SHORTEST_STEP };
    let reduces =
        |trial: &[f64], length: f64| equations.norm_at(trial) <= (1.0 - SUFFICIENT_DECREASE * length) * norm;
    let next = search(from, newton, shortest, reduces);
    if next.is_some() || converged {
        return next;
    }
    let functional = equations.functional()?;
    let steepest;
    let along = if functional.slope(newton) < 0.0 {
        newton
    } else {
        steepest = functional.steepest();
        &steepest
    };
    let (value, slope) = (functional.value_at(from), functional.slope(along));
    let decreases = |trial: &[f64], length: f64| {
        functional.value_at(trial) <= value + SUFFICIENT_DECREASE * length * slope
    };
    search(from, along, SHORTEST_STEP, decreases)
}

/// The first of the points at full, half, quarter, … step that is accepted.
fn search(
    from: &[f64],
    step: &[f64],
    shortest: f64,
    mut accepts: impl FnMut(&[f64], f64) -> bool,
) -> Option<Vec<f64>> {
    let mut length = 1.0;
    while length >= shortest {
        let trial: Vec<f64> = from.iter().zip(step).map(|(u, s)| u + length * s).collect();
        if accepts(&trial, length) {
            return Some(trial);
        }
        length *= 0.5;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// arctan(u) = 0: full Newton steps diverge from |u| > 1.39.
    struct Arctangent {
        at: f64,
    }

    impl Stationarity for Arctangent {
        fn linearise(&mut self, unknowns: &[f64]) -> Option<Residual> {
            self.at = unknowns[0];
            Some(Residual { norm: unknowns[0].atan().abs(), scale: 1.0 })
        }

        fn norm_at(&mut self, unknowns: &[f64]) -> f64 {
            unknowns[0].atan().abs()
        }

        fn direction(&mut self) -> Option<Direction> {
            let step = -self.at.atan() * (1.0 + self.at * self.at);
            Some(Direction { step: vec![step], krylov_iterations: 0 })
        }
    }

    #[test]
    fn the_line_search_rescues_steps_that_overshoot() {
        let options = NewtonOptions::default();
        let iterate =
            minimise_residual(&mut Arctangent { at: 0.0 }, vec![20.0], &options, &mut |_, _| ()).unwrap();
        assert!(iterate.converged);
        assert!(iterate.unknowns[0].abs() < 1e-11);
        assert!(iterate.history.windows(2).all(|pair| pair[1] < pair[0]));
    }

    #[test]
    fn too_few_iterations_keep_the_best_iterate_and_say_so() {
        let options = NewtonOptions { iterations: 2, ..NewtonOptions::default() };
        let iterate =
            minimise_residual(&mut Arctangent { at: 0.0 }, vec![20.0], &options, &mut |_, _| ()).unwrap();
        assert!(!iterate.converged);
        assert_eq!(iterate.newton_iterations, 2);
        assert!(iterate.unknowns[0].abs() < 20.0);
    }
}
