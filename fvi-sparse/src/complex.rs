//! Complex equations with a symmetric pattern, as for the response to a harmonic load.

use crate::{Analysis, Pattern};
use num_complex::Complex;

/// Solves A x = b for complex matrices of one symmetric pattern, whose entries need not be symmetric.
///
/// Elimination follows the order of the pattern's [`Analysis`], without exchange of rows. Iterative
/// refinement recovers what small pivots lose, or the solution is refused. \[DuffErismanReid17\] § 4.
#[derive(Debug)]
pub struct ComplexSolver {
    order: Vec<u32>,
    place: Vec<u32>,
    /// The rows below the diagonal of each column of the factor, as indices in the order of elimination,
    /// ascending.
    below: Vec<Vec<u32>>,
}

/// Error: elimination without exchange of rows does not solve the equations to rounding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unsolved {
    /// The largest residual over |A| |x| + |b|.
    pub residual: f64,
}

/// Largest backward error accepted, and largest number of refinements.
const ACCEPTED: f64 = 1e-13;
const ROUNDS: usize = 4;

/// Products of the elimination after which it is asked whether to go on.
const BETWEEN_QUESTIONS: usize = 200_000;

/// The factors L and U of one matrix, in the order of elimination: U has the pattern of Lᵀ.
#[derive(Debug)]
struct Factors {
    pivots: Vec<Complex<f64>>,
    lower: Vec<Vec<Complex<f64>>>,
    upper: Vec<Vec<Complex<f64>>>,
}

impl ComplexSolver {
    /// A solver for matrices of this pattern.
    pub fn new(pattern: &Pattern) -> Self {
        let analysis = Analysis::new(pattern);
        let (order, place) = (analysis.blocks().order.clone(), analysis.blocks().place.clone());
        let size = order.len();
        let mut below: Vec<Vec<u32>> = vec![Vec::new(); size];
        let mut children: Vec<Vec<u32>> = vec![Vec::new(); size];
        for column in 0..size {
            let own = pattern.row(order[column] as usize);
            let own = pattern.columns()[own].iter().map(|&other| place[other as usize]);
            let mut rows: Vec<u32> = own.filter(|&row| row as usize > column).collect();
            for &child in &children[column] {
                rows.extend(below[child as usize].iter().filter(|&&row| row as usize > column));
            }
            rows.sort_unstable();
            rows.dedup();
            if let Some(&parent) = rows.first() {
                children[parent as usize].push(column as u32);
            }
            below[column] = rows;
        }
        Self { order, place, below }
    }

    /// Number of entries in the factors of a matrix.
    pub fn factor_len(&self) -> usize {
        self.below.iter().map(|rows| 2 * rows.len() + 1).sum()
    }

    /// Replaces `vector` by the solution; `values` are the entries of A by the slots of the pattern.
    ///
    /// # Errors
    /// [`Unsolved`] if a pivot is zero or too small for the refinement to make up for it.
    pub fn solve(
        &self,
        pattern: &Pattern,
        values: &[Complex<f64>],
        vector: &mut [Complex<f64>],
    ) -> Result<(), Unsolved> {
        match self.factored(pattern, values.to_vec(), &mut || false) {
            Some(factored) => factored.solve(vector),
            None => Err(Unsolved { residual: f64::NAN }),
        }
    }

    /// The matrix with its factors, for several solutions. `stopped` is asked now and then during the
    /// elimination, after a millisecond or so; `None` if it says so.
    #[doc(hidden)]
    pub fn factored<'a>(
        &'a self,
        pattern: &'a Pattern,
        values: Vec<Complex<f64>>,
        stopped: &mut dyn FnMut() -> bool,
    ) -> Option<ComplexFactored<'a>> {
        let factors = self.factor(pattern, &values, stopped)?;
        Some(ComplexFactored { solver: self, pattern, values, factors })
    }

    fn factor(
        &self,
        pattern: &Pattern,
        values: &[Complex<f64>],
        stopped: &mut dyn FnMut() -> bool,
    ) -> Option<Factors> {
        let mut products = 0;
        let size = self.order.len();
        let mut pivots = vec![Complex::ZERO; size];
        let mut lower: Vec<Vec<Complex<f64>>> = vec![Vec::new(); size];
        let mut upper: Vec<Vec<Complex<f64>>> = vec![Vec::new(); size];
        // For each column the earlier columns that update it next, each with the index of its next row.
        let mut waiting: Vec<Vec<(u32, u32)>> = vec![Vec::new(); size];
        let (mut column_of, mut row_of) = (vec![Complex::ZERO; size], vec![Complex::ZERO; size]);
        for column in 0..size {
            let row = self.order[column] as usize;
            for slot in pattern.row(row) {
                let other = pattern.columns()[slot] as usize;
                let at = self.place[other] as usize;
                if at >= column {
                    row_of[at] = values[slot];
                    column_of[at] = values[pattern.slot(other, row)];
                }
            }
            for (from, index) in std::mem::take(&mut waiting[column]) {
                let (before, first) = (from as usize, index as usize);
                let rows = &self.below[before][first..];
                products += rows.len();
                let (left, right) = (lower[before][first], upper[before][first]);
                let pairs = lower[before][first..].iter().zip(&upper[before][first..]);
                for (&at, (below, beside)) in rows.iter().zip(pairs) {
                    column_of[at as usize] -= below * right;
                    row_of[at as usize] -= left * beside;
                }
                if let Some(&next) = rows.get(1) {
                    waiting[next as usize].push((from, index + 1));
                }
            }
            if products > BETWEEN_QUESTIONS {
                products = 0;
                if stopped() {
                    return None;
                }
            }
            // Row and column both include the diagonal entry.
            let pivot = column_of[column];
            pivots[column] = pivot;
            let inverse = pivot.inv();
            lower[column] = self.below[column].iter().map(|&at| column_of[at as usize] * inverse).collect();
            upper[column] = self.below[column].iter().map(|&at| row_of[at as usize]).collect();
            for &at in self.below[column].iter().chain([&(column as u32)]) {
                column_of[at as usize] = Complex::ZERO;
                row_of[at as usize] = Complex::ZERO;
            }
            if let Some(&next) = self.below[column].first() {
                waiting[next as usize].push((column as u32, 0));
            }
        }
        Some(Factors { pivots, lower, upper })
    }

    fn substitute(&self, factors: &Factors, vector: &mut [Complex<f64>]) {
        let mut x: Vec<_> = self.order.iter().map(|&row| vector[row as usize]).collect();
        for (column, rows) in self.below.iter().enumerate() {
            let known = x[column];
            for (&row, entry) in rows.iter().zip(&factors.lower[column]) {
                x[row as usize] -= entry * known;
            }
        }
        for (column, rows) in self.below.iter().enumerate().rev() {
            let behind: Complex<f64> =
                rows.iter().zip(&factors.upper[column]).map(|(&row, entry)| entry * x[row as usize]).sum();
            x[column] = (x[column] - behind) / factors.pivots[column];
        }
        for (&row, x) in self.order.iter().zip(x) {
            vector[row as usize] = x;
        }
    }
}

/// A matrix with its factors.
#[doc(hidden)]
#[derive(Debug)]
pub struct ComplexFactored<'a> {
    solver: &'a ComplexSolver,
    pattern: &'a Pattern,
    values: Vec<Complex<f64>>,
    factors: Factors,
}

impl ComplexFactored<'_> {
    /// Replaces `vector` by the solution.
    ///
    /// # Errors
    /// [`Unsolved`], as [`ComplexSolver::solve`].
    pub fn solve(&self, vector: &mut [Complex<f64>]) -> Result<(), Unsolved> {
        let Self { solver, pattern, values, factors } = self;
        let wanted = vector.to_vec();
        vector.fill(Complex::ZERO);
        let mut residual = wanted.clone();
        let mut size = f64::INFINITY;
        for _ in 0..ROUNDS {
            solver.substitute(factors, &mut residual);
            vector.iter_mut().zip(&residual).for_each(|(x, more)| *x += *more);
            size = backward_error(pattern, values, vector, &wanted, &mut residual);
            if size <= 4.0 * f64::EPSILON {
                break;
            }
        }
        // A residual that is not a number is refused too.
        if size <= ACCEPTED { Ok(()) } else { Err(Unsolved { residual: size }) }
    }

    /// The pivots, whose product is the determinant.
    pub fn pivots(&self) -> &[Complex<f64>] {
        &self.factors.pivots
    }
}

/// Writes b − A x and returns its largest entry over |A| |x| + |b|, row by row. What has fallen below the
/// range of numbers along a chain, or has lost its digits there, is no error.
fn backward_error(
    pattern: &Pattern,
    values: &[Complex<f64>],
    x: &[Complex<f64>],
    wanted: &[Complex<f64>],
    residual: &mut [Complex<f64>],
) -> f64 {
    /// Size of a number whose rounding error is still in the range.
    const LEAST: f64 = f64::MIN_POSITIVE / f64::EPSILON;
    let mut largest = 0.0;
    for (row, slots) in pattern.rows().enumerate() {
        let (mut sum, mut size) = (wanted[row], wanted[row].l1_norm());
        let mut entries = 1.0;
        for slot in slots {
            let term = values[slot] * x[pattern.columns()[slot] as usize];
            sum -= term;
            size += term.l1_norm();
            entries += values[slot].l1_norm();
        }
        residual[row] = sum;
        let error = sum.l1_norm() / size.max(LEAST * entries);
        // `max` would ignore a value that is not a number.
        if error > largest || error.is_nan() {
            largest = error;
        }
    }
    largest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_that_decays_below_the_range_of_numbers_is_a_solution() {
        let count = 1000;
        let mut places = vec![(0, 0)];
        for i in 1..count {
            places.extend([(i, i), (i, i - 1), (i - 1, i)]);
        }
        let pattern = Pattern::new(count, places);
        let mut values = vec![Complex::ZERO; pattern.len()];
        for (row, slots) in pattern.rows().enumerate() {
            for slot in slots {
                let is_own = pattern.columns()[slot] as usize == row;
                values[slot] = if is_own { Complex::new(-300.0, 2.0) } else { Complex::new(-7.0, 0.3) };
            }
        }
        let mut x = vec![Complex::ZERO; count];
        x[0] = Complex::new(1.0, 0.0);
        let solver = ComplexSolver::new(&pattern);
        solver.factored(&pattern, values.clone(), &mut || false).unwrap().solve(&mut x).unwrap();
        // x_{k+1} = λ x_k with λ + 1/λ = −a/b
        let (a, b) = (Complex::new(-300.0, 2.0), Complex::new(-7.0, 0.3));
        let ratio = -a / b;
        let root = (ratio * ratio - 4.0).sqrt();
        let lambda =
            [(ratio + root) * 0.5, (ratio - root) * 0.5].into_iter().find(|l| l.norm() < 1.0).unwrap();
        for k in [0, 1, 50] {
            let error = (x[k + 1] / x[k] - lambda).norm() / lambda.norm();
            assert!(error < 1e-12, "{k}: {error:.1e}");
        }
        assert!(x[count - 1].norm() < 1e-300);
    }

    /// A grid of `side` × `side` points with neighbours, and entries without symmetry.
    fn grid(side: usize) -> (Pattern, Vec<Complex<f64>>) {
        let mut places = Vec::new();
        for i in 0..side {
            for j in 0..side {
                let at = i * side + j;
                places.push((at, at));
                for near in [(i + 1 < side).then(|| at + side), (j + 1 < side).then(|| at + 1)] {
                    places.extend(near.into_iter().flat_map(|near| [(at, near), (near, at)]));
                }
            }
        }
        let pattern = Pattern::new(side * side, places);
        let mut values = vec![Complex::ZERO; pattern.len()];
        for (row, slots) in pattern.rows().enumerate() {
            for slot in slots {
                let column = pattern.columns()[slot] as usize;
                values[slot] = if row == column {
                    // Indefinite, as K − ω²M is.
                    Complex::new(if row % 3 == 0 { -1.5 } else { 4.0 }, 0.2)
                } else {
                    Complex::new(-1.0, 0.1 * (row as f64 - column as f64).signum())
                };
            }
        }
        (pattern, values)
    }

    #[test]
    fn indefinite_unsymmetric_equations_are_solved_to_rounding() {
        let (pattern, values) = grid(13);
        let solver = ComplexSolver::new(&pattern);
        let known: Vec<_> = (0..169).map(|i| Complex::new(f64::from(i).sin(), f64::from(i).cos())).collect();
        let mut vector = vec![Complex::ZERO; 169];
        for (row, slots) in pattern.rows().enumerate() {
            vector[row] = slots.map(|slot| values[slot] * known[pattern.columns()[slot] as usize]).sum();
        }
        solver.solve(&pattern, &values, &mut vector).unwrap();
        for (x, known) in vector.iter().zip(&known) {
            assert!((x - known).l1_norm() < 1e-12, "{x} is not {known}");
        }
    }

    #[test]
    fn the_determinant_of_a_small_matrix() {
        // det [2i 1 0; 1 3 −1; 0 −1 1] = 2i·(3 − 1) − 1 = −1 + 4i.
        let pattern = Pattern::new(3, vec![(0, 0), (1, 1), (2, 2), (0, 1), (1, 0), (1, 2), (2, 1)]);
        let mut values = vec![Complex::ZERO; pattern.len()];
        let mut set = |row, column, re, im| values[pattern.slot(row, column)] = Complex::new(re, im);
        set(0, 0, 0.0, 2.0);
        set(1, 1, 3.0, 0.0);
        set(2, 2, 1.0, 0.0);
        for (row, column, entry) in [(0, 1, 1.0), (1, 0, 1.0), (1, 2, -1.0), (2, 1, -1.0)] {
            set(row, column, entry, 0.0);
        }
        let solver = ComplexSolver::new(&pattern);
        let found = solver.factored(&pattern, values, &mut || false);
        let found: Complex<f64> = found.unwrap().pivots().iter().product();
        assert!((found - Complex::new(-1.0, 4.0)).l1_norm() < 1e-14, "{found}");
    }

    #[test]
    fn elimination_is_given_up_when_asked() {
        let (pattern, values) = grid(60);
        let solver = ComplexSolver::new(&pattern);
        let mut asked = 0;
        let mut stopped = || {
            asked += 1;
            asked == 2
        };
        assert!(solver.factored(&pattern, values, &mut stopped).is_none());
        assert_eq!(asked, 2);
    }

    #[test]
    fn equations_without_a_solution_are_refused() {
        let (pattern, _) = grid(3);
        let solver = ComplexSolver::new(&pattern);
        let mut vector = vec![Complex::new(1.0, 0.0); 9];
        assert!(solver.solve(&pattern, &vec![Complex::ZERO; pattern.len()], &mut vector).is_err());
    }
}
