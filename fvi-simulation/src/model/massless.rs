//! Positions of coordinates without mass at the ends of steps.

use super::matrices::Matrix;
use super::space::AnySpace;
use fvi_core::{Instant, Mechanics, Real, State, Step, factor, max_or_nan, substitute};
use fvi_sparse::{Analysis, Factor, Pattern};

/// Coordinates z without mass, by the way in which their positions at grid points are determined.
///
/// With no mass M_zz the equations of a step on polynomials with as many Gauss points as its degree are
/// G_z(X_i) = 0 at each point: the balance of forces. The positions X_i at the points follow from it alone,
/// and the polynomial through them and z_k ends at
///
/// ```text
/// z_{k+1} = (−1)^S z_k + a combination of the X_i ,
/// ```
///
/// so that an error of z_k never decays. But z_k does not occur in the equations, and may have any value. It
/// is computed as accurately as possible:
///
/// ```text
/// held by stiffness alone     G_z(t_{k+1}, q_{k+1}) = 0
/// held by memories            z_{k+1} = Σ_{j=1}^m (1/j) ∇^{j−1} Z_k ,    Z_k = Σ_i b_i X_{k,i}
/// resisted by F(t, q, v)      the end of the polynomial, which depends on z_k through its velocity
/// ```
///
/// Z_k are means over steps, in which the errors of single nodes cancel; the sum is the slope at t_{k+1} of
/// the polynomial through their integrals, of order m in h. After the first step, with one mean, it is
/// 2Z_0 − z_0. Momenta are zero.
#[derive(Clone, Debug, Default)]
pub(crate) struct MasslessRows {
    /// All coordinates without mass, ascending.
    pub(crate) all: Vec<usize>,
    /// Coordinates held by stiffness alone.
    pub(crate) held: Vec<usize>,
    /// Coordinates held by memories.
    pub(crate) remembered: Vec<usize>,
    /// Number m of means used.
    pub(crate) means: usize,
}

impl MasslessRows {
    /// True if there are no coordinates without mass.
    pub(crate) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Length of the state kept from step to step: for each remembered coordinate the means of the previous
    /// steps.
    pub(crate) fn carried(&self) -> usize {
        self.remembered.len() * self.means.saturating_sub(1)
    }
}

/// Result of a step.
pub(crate) struct Found<'a, T> {
    /// b_i.
    pub(crate) weights: &'a [T],
    /// X_i − q_k.
    pub(crate) stages: &'a [T],
}

/// State kept from step to step.
pub(crate) struct Carried<'a, T> {
    /// q_{k+1} − X_i, if the memory stores the nodes.
    pub(crate) behind: &'a mut [T],
    /// Means of the previous steps, the newest first.
    pub(crate) means: &'a mut [T],
    /// The polynomial of the step, as increments at its control points.
    pub(crate) increments: &'a mut [T],
}

/// Buffers for the end of a step.
pub(crate) struct Settling<T> {
    equilibrium: Option<Equilibrium<T>>,
    /// z_k of all coordinates without mass.
    start: Vec<T>,
    position: Vec<T>,
}

impl<T: Real> Settling<T> {
    pub(crate) fn new<G: Mechanics<T, AnySpace>>(rows: &MasslessRows, mechanics: &G) -> Self {
        let equilibrium = (!rows.held.is_empty()).then(|| Equilibrium::new(&rows.held, mechanics));
        Self { equilibrium, start: vec![T::zero(); rows.all.len()], position: Vec::new() }
    }

    /// Stores the positions of these coordinates at the beginning of a step.
    pub(crate) fn begin(&mut self, rows: &MasslessRows, position: &[T]) {
        self.start.iter_mut().zip(&rows.all).for_each(|(start, &row)| *start = position[row]);
    }

    /// Sets the positions of coordinates without mass at the end of a step.
    pub(crate) fn end<G: Mechanics<T, AnySpace>>(
        &mut self,
        rows: &MasslessRows,
        mechanics: &mut G,
        step: &Step<'_, T>,
        found: &Found<'_, T>,
        carried: Carried<'_, T>,
        state: &mut State<Vec<T>>,
    ) {
        let Carried { behind, means, increments } = carried;
        let size = state.position.len().max(1);
        for &row in &rows.all {
            (state.momentum[row], state.rounding.momentum[row]) = (T::zero(), T::zero());
        }
        self.position.clear();
        self.position.extend_from_slice(&state.position);
        let start = |row: usize| rows.all.binary_search(&row).map_or(T::zero(), |place| self.start[place]);
        let mean = |row: usize| {
            let stages = found.stages.chunks_exact(size).map(|stage| stage[row]);
            let terms = stages.zip(found.weights).map(|(stage, &weight)| weight * stage);
            start(row) + terms.fold(T::zero(), |sum, term| sum + term)
        };
        let earlier = rows.means.saturating_sub(1);
        let known = usize::try_from(state.step).unwrap_or(usize::MAX).saturating_add(1).min(rows.means);
        for (&row, means) in rows.remembered.iter().zip(means.chunks_exact_mut(earlier.max(1))) {
            let newest = mean(row);
            self.position[row] = if known < 2 {
                newest + (newest - start(row))
            } else {
                slope_at_end(newest, &means[..known - 1])
            };
            means.rotate_right(1);
            means[0] = newest;
        }
        if let Some(equilibrium) = &mut self.equilibrium {
            let instant = Instant::in_step(step.time, T::one(), step.size);
            let motion = (&mut self.position, state.momentum.as_slice());
            if equilibrium.find(mechanics, instant, step.input, motion).is_err() {
                // Forces were in balance at the nodes: the mean of these positions is a good guess.
                for &row in &rows.held {
                    self.position[row] = mean(row);
                }
            }
        }
        for &row in rows.held.iter().chain(&rows.remembered) {
            let moved = self.position[row] - state.position[row];
            (state.position[row], state.rounding.position[row]) = (self.position[row], T::zero());
            behind.chunks_exact_mut(size).for_each(|behind| behind[row] += moved);
            if let Some(last) = increments.chunks_exact_mut(size).last() {
                last[row] += moved;
            }
        }
    }
}

/// Σ_{j=1}^m (1/j) ∇^{j−1} Z at the newest of m means; `earlier` contains the others, newest first.
fn slope_at_end<T: Real>(newest: T, earlier: &[T]) -> T {
    let mut slope = newest;
    for order in 1..=earlier.len() {
        // ∇^order by its binomial coefficients.
        let (mut difference, mut binomial) = (newest, 1.0);
        for (index, &mean) in earlier[..order].iter().enumerate() {
            binomial *= -((order - index) as f64) / (index + 1) as f64;
            difference += T::of(binomial) * mean;
        }
        slope += difference / T::of((order + 1) as f64);
    }
    slope
}

/// Error: no balance of forces was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NoEquilibrium;

/// Largest number of corrections for a nonlinear balance.
const CORRECTIONS: usize = 25;

/// Largest number of coordinates for which the balance is solved in a full matrix.
const FEW: usize = 64;

/// A direction in which a position may move: coordinates and their entries.
pub(crate) type Direction = Vec<(usize, f64)>;

/// The balance of the forces G_i(t, q) = ∂U/∂q_i − F_i − u_i along some directions N, NᵀG = 0, to be solved
/// for a displacement N y. Directions are often single coordinates.
pub(crate) struct Equilibrium<T> {
    directions: Vec<Direction>,
    /// The directions in which each coordinate moves, with their entries.
    places: Vec<Direction>,
    /// Solver for a linear system, once it has been built.
    kept: Option<Solver>,
    restoring: Vec<T>,
    velocity: Vec<T>,
    stiffness: Matrix<T>,
    right: Vec<f64>,
}

enum Solver {
    Full { factors: Vec<f64>, pivots: Vec<usize> },
    Sparse(Factor),
}

impl Solver {
    /// A solver for NᵀKN.
    fn new<T: Real>(stiffness: &Matrix<T>, places: &[Direction], count: usize) -> Option<Self> {
        let along = |(row, column, entry): (usize, usize, T)| {
            let pairs =
                places[row].iter().flat_map(move |one| places[column].iter().map(move |other| (one, other)));
            pairs.map(move |(one, other)| (one.0, other.0, one.1 * entry.to_f64() * other.1))
        };
        let entries: Vec<(usize, usize, f64)> = stiffness.entries().into_iter().flat_map(along).collect();
        if count > FEW
            && let Some(factor) = sparse_factor(count, &entries)
        {
            return Some(Self::Sparse(factor));
        }
        let (mut factors, mut pivots) = (vec![0.0; count * count], vec![0; count]);
        entries.iter().for_each(|&(row, column, entry)| factors[row * count + column] += entry);
        factor(&mut factors, &mut pivots).ok()?;
        Some(Self::Full { factors, pivots })
    }

    fn solve(&self, right: &mut [f64]) {
        match self {
            Self::Full { factors, pivots } => substitute(factors, pivots, right),
            Self::Sparse(factor) => factor.solve(right),
        }
    }
}

/// The factor of a symmetric positive definite matrix; `None` if the matrix is not.
fn sparse_factor(count: usize, entries: &[(usize, usize, f64)]) -> Option<Factor> {
    let pattern = Pattern::new(count, entries.iter().map(|&(row, column, _)| (row, column)).collect());
    let mut values = vec![0.0; pattern.len()];
    entries.iter().for_each(|&(row, column, entry)| values[pattern.slot(row, column)] += entry);
    let mirrored = |&(row, column, entry): &(usize, usize, f64)| {
        let slots = pattern.row(column);
        let place = pattern.columns()[slots.clone()].binary_search(&(row as u32)).ok()?;
        ((values[slots.start + place] - entry).abs() <= 1e-12 * entry.abs()).then_some(())
    };
    entries.iter().map(mirrored).collect::<Option<()>>()?;
    Analysis::new(&pattern).factor(&pattern, &values).ok()
}

impl<T: Real> Equilibrium<T> {
    /// The balance for these coordinates.
    pub(crate) fn new<G: Mechanics<T, AnySpace>>(rows: &[usize], mechanics: &G) -> Self {
        Self::along(rows.iter().map(|&row| vec![(row, 1.0)]).collect(), mechanics)
    }

    /// The balance along these directions.
    pub(crate) fn along<G: Mechanics<T, AnySpace>>(directions: Vec<Direction>, mechanics: &G) -> Self {
        let stiffness = mechanics.stiffness();
        let size = stiffness.size();
        let mut places = vec![Vec::new(); size];
        for (index, direction) in directions.iter().enumerate() {
            direction.iter().for_each(|&(row, entry)| places[row].push((index, entry)));
        }
        let zeros = || vec![T::zero(); size];
        let right = vec![0.0; directions.len()];
        Self { directions, places, kept: None, restoring: zeros(), velocity: zeros(), stiffness, right }
    }

    /// Moves the position along the directions to a balance of the forces, with the momentum of the motion
    /// and an input u whose missing numbers are zero.
    ///
    /// # Errors
    /// If Newton's method does not converge; the position must not be used then.
    pub(crate) fn find<G: Mechanics<T, AnySpace>>(
        &mut self,
        mechanics: &mut G,
        instant: Instant<T>,
        input: &[T],
        (position, momentum): (&mut Vec<T>, &[T]),
    ) -> Result<(), NoEquilibrium> {
        let (linear, moves) = (mechanics.is_linear(), mechanics.depends_on_velocity());
        if moves {
            mechanics.velocity(momentum, &mut self.velocity);
        }
        let mut before = f64::INFINITY;
        for _ in 0..CORRECTIONS {
            let known = if linear { self.kept.take() } else { None };
            let Self { restoring, velocity, stiffness, .. } = self;
            match (moves, known.is_some()) {
                (false, true) => mechanics.restoring_force(instant, position, restoring),
                (true, true) => mechanics.restoring_force_in_motion(instant, position, velocity, restoring),
                (false, false) => mechanics.linearise(instant, position, restoring, stiffness),
                (true, false) => {
                    mechanics.linearise_in_motion(instant, position, velocity, restoring, stiffness);
                }
            }
            let solver = known.or_else(|| Solver::new(stiffness, &self.places, self.directions.len()));
            let Some(solver) = solver else { return Err(NoEquilibrium) };
            for (right, direction) in self.right.iter_mut().zip(&self.directions) {
                let along = direction.iter().map(|&(row, entry)| {
                    let input = input.get(row).copied().unwrap_or(T::zero());
                    entry * (restoring[row] - input).to_f64()
                });
                *right = along.sum();
            }
            solver.solve(&mut self.right);
            if !self.right.iter().all(|right| right.is_finite()) {
                return Err(NoEquilibrium);
            }
            for (&right, direction) in self.right.iter().zip(&self.directions) {
                direction.iter().for_each(|&(row, entry)| position[row] -= T::of(right * entry));
            }
            if linear {
                self.kept = Some(solver);
                return Ok(());
            }
            let change = self.right.iter().map(|right| right.abs()).fold(0.0, max_or_nan);
            let largest = position.iter().map(|number| number.to_f64().abs()).fold(0.0, max_or_nan);
            // Converged to rounding, or as far as the rounding of the forces allows.
            let (fine, coarse) = (64.0 * T::EPSILON.to_f64(), T::EPSILON.to_f64().sqrt());
            if change <= fine * largest || (change >= 0.25 * before && before <= coarse * largest) {
                return Ok(());
            }
            before = change;
        }
        Err(NoEquilibrium)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_polynomial_follows_from_means_over_steps() {
        // Means of τ^p over the steps that end at 0, −1, …: the value of τ^p at 0 is zero except for p = 0.
        for count in 1..=6_usize {
            for power in 0..count as i32 {
                let integral = |tau: f64| tau.powi(power + 1) / f64::from(power + 1);
                let means: Vec<f64> =
                    (0..count).map(|j| integral(-(j as f64)) - integral(-(j as f64) - 1.0)).collect();
                let found = slope_at_end(means[0], &means[1..]);
                let exact = if power == 0 { 1.0 } else { 0.0 };
                assert!((found - exact).abs() < 1e-10, "{count} means, τ^{power}: {found}");
            }
        }
    }
}
