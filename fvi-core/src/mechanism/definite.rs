//! Whether a mass is positive definite where constraints let it move.

use crate::linear::{all_finite, at};
use crate::mechanism::step::{copy, dot, product, put};
use crate::real::{Real, max_or_nan};
use crate::scheme::StepError;
use crate::space::parts_mut;

/// A velocity that the constraints allow, of size 1, without a positive kinetic energy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NotDefinite {
    /// The coordinate that moves most, from 0.
    pub(super) coordinate: usize,
    /// ½ vᵀMv.
    pub(super) energy: f64,
}

impl From<NotDefinite> for StepError {
    fn from(NotDefinite { coordinate, energy }: NotDefinite) -> Self {
        Self::IndefiniteMass { coordinate, energy }
    }
}

/// A velocity of N numbers with C v = 0 and vᵀMv ≤ 0, up to rounding, if there is one: by the factors of
/// PMP + κ(I − P), where P is the projection onto the kernel of C and κ > 0.
///
/// `work` has N² + MN numbers or more, `velocity` N.
pub(super) fn not_definite<T: Real>(
    (mass, constraints): (&[T], &[T]),
    [n, m]: [usize; 2],
    (work, velocity): (&mut [T], &mut [T]),
) -> Option<NotDefinite> {
    if !all_finite(mass) {
        // Whoever takes it for a number says so.
        return None;
    }
    let (matrix, work) = parts_mut(work, n * n);
    let (rows, _) = parts_mut(work, m * n);
    let (velocity, _) = parts_mut(velocity, n);
    let width = n.max(1);
    copy(matrix, mass);
    copy(rows, constraints);
    let kappa = (0..n).fold(T::zero(), |most, row| max_or_nan(most, at(mass, row * n + row).abs()));
    let kappa = if kappa > T::zero() { kappa } else { T::one() };
    for index in 0..m {
        let (before, rest) = parts_mut(rows, index * n);
        let (row, _) = parts_mut(rest, n);
        orthonormalise(row, before);
        project((matrix, row), kappa, velocity);
    }
    let failed = (0..n).find(|&row| !eliminate(matrix, n, row))?;
    // With the rows before it, x = (−B⁻¹b, 1, 0 …).
    velocity.fill(T::zero());
    put(velocity, failed, T::one());
    for row in (0..failed).rev() {
        let below = (row + 1..=failed).map(|other| at(matrix, other * n + row) * at(velocity, other));
        let sum = below.fold(T::zero(), |sum, product| sum + product);
        put(velocity, row, -sum / at(matrix, row * n + row));
    }
    for row in rows.chunks_exact(width) {
        let along = dot(row, velocity);
        velocity.iter_mut().zip(row).for_each(|(place, &entry)| *place -= along * entry);
    }
    let whole = dot(velocity, velocity);
    let moved = product(mass, velocity).zip(&*velocity).fold(T::zero(), |sum, (p, &v)| sum + p * v);
    let most = velocity.iter().enumerate().fold((0, T::zero()), |(most, size), (index, &v)| {
        if v.abs() > size { (index, v.abs()) } else { (most, size) }
    });
    Some(NotDefinite { coordinate: most.0, energy: (T::of(0.5) * moved / whole).to_f64() })
}

/// Takes off what a row has of orthonormal ones, twice against rounding, and scales it to 1; a row of which
/// nothing is left is zero.
fn orthonormalise<T: Real>(row: &mut [T], before: &[T]) {
    let whole = dot(row, row);
    for other in before.chunks_exact(row.len().max(1)).chain(before.chunks_exact(row.len().max(1))) {
        let along = dot(row, other);
        row.iter_mut().zip(other).for_each(|(place, &other)| *place -= along * other);
    }
    let left = dot(row, row);
    let is_new = left > T::EPSILON * whole;
    let scale = if is_new { T::one() / left.sqrt() } else { T::zero() };
    row.iter_mut().for_each(|place| *place *= scale);
}

/// M ← (I − qqᵀ)M(I − qqᵀ) + κqqᵀ.
fn project<T: Real>((matrix, row): (&mut [T], &[T]), kappa: T, moved: &mut [T]) {
    moved.iter_mut().zip(product(matrix, row)).for_each(|(place, number)| *place = number);
    let both = dot(row, moved) + kappa;
    for (line, (&q, &w)) in matrix.chunks_exact_mut(row.len().max(1)).zip(row.iter().zip(&*moved)) {
        for (place, (&other, &turned)) in line.iter_mut().zip(row.iter().zip(&*moved)) {
            *place += both * q * other - q * turned - w * other;
        }
    }
}

/// Writes row `row` of the factor L, B = LLᵀ, below the diagonal; false if there is none.
fn eliminate<T: Real>(matrix: &mut [T], n: usize, row: usize) -> bool {
    for column in 0..=row {
        let own = at(matrix, row * n + column);
        let known = (0..column).map(|k| at(matrix, row * n + k) * at(matrix, column * n + k));
        let left = known.fold(own, |sum, product| sum - product);
        if column < row {
            put(matrix, row * n + column, left / at(matrix, column * n + column));
        } else if left > T::from_count(4 * n as u64) * T::EPSILON * own {
            put(matrix, row * n + row, left.sqrt());
        } else {
            return false;
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(mass: &[f64], constraints: &[f64]) -> Option<NotDefinite> {
        let n = mass.len().isqrt();
        let m = constraints.len() / n;
        let (mut work, mut velocity) = ([0.0; 64], [0.0; 8]);
        not_definite((mass, constraints), [n, m], (&mut work, &mut velocity))
    }

    #[test]
    fn a_mass_counts_where_the_constraints_let_it_move() {
        assert_eq!(found(&[2.0, 1.0, 1.0, 1.0], &[]), None);
        // ½vᵀMv = −½ along (1, −1)/√2.
        let energy = found(&[1.0, 2.0, 2.0, 1.0], &[]).unwrap().energy;
        assert!((-0.5..0.0).contains(&energy), "{energy}");
        let energy = found(&[1.0, 2.0, 2.0, 1.0], &[1.0, 1.0]).unwrap().energy;
        assert!((energy + 0.5).abs() < 1e-15, "{energy}");
        assert_eq!(found(&[1.0, 2.0, 2.0, 1.0], &[1.0, -1.0]), None);
        // Without mass in a direction that is held.
        let [a, b] = [1.0, 0.0];
        assert_eq!(found(&[a, b, b, b], &[0.0, 3.0]), None);
        assert_eq!(found(&[a, b, b, b], &[]), Some(NotDefinite { coordinate: 1, energy: 0.0 }));
        assert_eq!(found(&[0.0; 4], &[]), Some(NotDefinite { coordinate: 0, energy: 0.0 }));
        // Masses of any size beside each other.
        assert_eq!(found(&[1e-20, 0.0, 0.0, 1e20], &[]), None);
        // A constraint that is given twice holds once.
        assert_eq!(found(&[a, b, b, b], &[0.0, 3.0, 0.0, 1.0]), None);
    }

    #[test]
    fn the_coordinate_that_moves_most_is_told() {
        let mass = [2.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -3.0];
        assert_eq!(found(&mass, &[]), Some(NotDefinite { coordinate: 2, energy: -1.5 }));
        let held = found(&mass, &[0.0, 0.0, 1.0]);
        assert_eq!(held, None);
    }
}
