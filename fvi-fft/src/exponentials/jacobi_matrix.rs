//! Gauss rules of discrete positive measures, by Lanczos' algorithm \[GolubWelsch69\], \[Gautschi04\].

use crate::sums::CompensatedSum;

/// Number of nodes of the longest Gauss rule tried.
pub(crate) const LONGEST_RULE: usize = 24;

/// Iterations in which an eigenvalue is found; three are usual.
const MOST_ITERATIONS: usize = 64;

/// The Jacobi matrix of a discrete positive measure; its leading parts are those of the Gauss rules. It has
/// as many rows as the longest rule asked for so far.
pub(crate) struct JacobiMatrix {
    mass: f64,
    places: Vec<f64>,
    diagonal: Vec<f64>,
    beside: Vec<f64>,
    /// Lanczos' vectors: the orthonormal polynomials at the places times the roots of the masses.
    basis: Vec<Vec<f64>>,
    /// The next of them.
    next: Vec<f64>,
}

impl JacobiMatrix {
    /// For a measure of (place, mass): Lanczos' algorithm on the diagonal matrix of places, started from the
    /// square roots of the masses and reorthogonalised.
    pub(crate) fn of(measure: &[(f64, f64)]) -> Self {
        let mass = measure.iter().map(|(_, mass)| *mass).collect::<CompensatedSum>().total();
        Self {
            mass,
            places: measure.iter().map(|(place, _)| *place).collect(),
            diagonal: Vec::new(),
            beside: Vec::new(),
            basis: Vec::new(),
            next: measure.iter().map(|(_, part)| (part / mass).sqrt()).collect(),
        }
    }

    /// The whole mass.
    pub(crate) fn mass(&self) -> f64 {
        self.mass
    }

    /// Lanczos' vectors for rules of [`LONGEST_RULE`] nodes.
    pub(crate) fn basis(&mut self) -> &[Vec<f64>] {
        self.extend_to(LONGEST_RULE);
        &self.basis
    }

    /// As many rows as a rule of this size asks for, and the measure has.
    fn extend_to(&mut self, size: usize) {
        let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        while self.diagonal.len() < size.min(self.places.len()) {
            let current = std::mem::take(&mut self.next);
            let mut next: Vec<f64> = self.places.iter().zip(&current).map(|(place, q)| place * q).collect();
            self.diagonal.push(dot(&next, &current));
            self.basis.push(current);
            for _ in 0..2 {
                for vector in &self.basis {
                    let overlap = dot(&next, vector);
                    next.iter_mut().zip(vector).for_each(|(next, q)| *next -= overlap * q);
                }
            }
            let norm = dot(&next, &next).sqrt();
            self.beside.push(norm);
            next.iter_mut().for_each(|next| *next /= norm);
            self.next = next;
        }
    }

    /// The Gauss rule of `size` nodes, (place, mass) in ascending order.
    pub(crate) fn gauss_rule(&mut self, size: usize) -> Vec<(f64, f64)> {
        let (places, rows) = self.diagonalised(size, 1);
        let masses = rows.iter().flatten().map(|first| self.mass * first.powi(2));
        let mut rule: Vec<(f64, f64)> = places.into_iter().zip(masses).collect();
        rule.sort_by(|a, b| a.0.total_cmp(&b.0));
        rule
    }

    /// The nodes of the Gauss rule of `size` nodes in ascending order, each with its eigenvector.
    pub(crate) fn nodes(&mut self, size: usize) -> Vec<(f64, Vec<f64>)> {
        let (places, rows) = self.diagonalised(size, size);
        let node = |(k, place): (usize, f64)| (place, rows.iter().map(|row| row[k]).collect());
        let mut nodes: Vec<(f64, Vec<f64>)> = places.into_iter().enumerate().map(node).collect();
        nodes.sort_by(|a, b| a.0.total_cmp(&b.0));
        nodes
    }

    /// The eigenvalues of the leading part, and the first entries of its eigenvectors, row by row; all of
    /// them NaN where they are not found.
    fn diagonalised(&mut self, size: usize, entries: usize) -> (Vec<f64>, Vec<Vec<f64>>) {
        self.extend_to(size);
        let size = size.min(self.diagonal.len());
        let mut places = self.diagonal[..size].to_vec();
        let mut beside = self.beside[..size].to_vec();
        let unit = |row: usize| (0..size).map(move |k| if k == row { 1.0 } else { 0.0 }).collect();
        let mut rows: Vec<Vec<f64>> = (0..entries.min(size)).map(unit).collect();
        if !diagonalise(&mut places, &mut beside, &mut rows) {
            places.fill(f64::NAN);
            rows.iter_mut().for_each(|row| row.fill(f64::NAN));
        }
        (places, rows)
    }
}

/// Replaces the diagonal of a symmetric tridiagonal matrix by its eigenvalues and multiplies rows from the
/// right by its eigenvectors, by the implicit QL algorithm; false where it does not end. `beside` is as long
/// as the diagonal, its last number without meaning. Source: \[GolubWelsch69\].
fn diagonalise(diagonal: &mut [f64], beside: &mut [f64], rows: &mut [Vec<f64>]) -> bool {
    let Some(last) = diagonal.len().checked_sub(1) else { return true };
    for place in 0..last {
        let mut iterations = 0;
        loop {
            let is_none =
                |k: &usize| beside[*k].abs() <= f64::EPSILON * (diagonal[*k].abs() + diagonal[*k + 1].abs());
            let end = (place..last).find(is_none).unwrap_or(last);
            if end == place {
                break;
            }
            if iterations == MOST_ITERATIONS {
                return false;
            }
            iterations += 1;
            turn(diagonal, beside, rows, [place, end]);
        }
    }
    diagonal.iter().all(|number| number.is_finite())
}

/// One iteration on the rows from `begin` to `end`, with the shift of Wilkinson.
fn turn(diagonal: &mut [f64], beside: &mut [f64], rows: &mut [Vec<f64>], [begin, end]: [usize; 2]) {
    let half = (diagonal[begin + 1] - diagonal[begin]) / (2.0 * beside[begin]);
    let shift = beside[begin] / (half + libm::copysign(libm::hypot(half, 1.0), half));
    let mut bulge = diagonal[end] - diagonal[begin] + shift;
    let (mut sine, mut cosine, mut moved) = (1.0, 1.0, 0.0);
    for k in (begin..end).rev() {
        let (across, along) = (sine * beside[k], cosine * beside[k]);
        let size = libm::hypot(across, bulge);
        beside[k + 1] = size;
        if size == 0.0 {
            // The matrix falls apart here.
            diagonal[k + 1] -= moved;
            beside[end] = 0.0;
            return;
        }
        (sine, cosine) = (across / size, bulge / size);
        let rest = diagonal[k + 1] - moved;
        let turned = (diagonal[k] - rest) * sine + 2.0 * cosine * along;
        moved = sine * turned;
        diagonal[k + 1] = rest + moved;
        bulge = cosine * turned - along;
        for row in &mut *rows {
            let (one, other) = (row[k], row[k + 1]);
            row[k + 1] = sine * one + cosine * other;
            row[k] = cosine * one - sine * other;
        }
    }
    diagonal[begin] -= moved;
    beside[begin] = bulge;
    beside[end] = 0.0;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A measure with places and masses over many decades.
    fn measure(count: usize) -> Vec<(f64, f64)> {
        (0..count).map(|k| (libm::exp(-0.5 * k as f64), libm::exp(-0.2 * k as f64))).collect()
    }

    #[test]
    fn gauss_rules_integrate_polynomials_exactly() {
        let measure = measure(60);
        let mut jacobi = JacobiMatrix::of(&measure);
        for size in [1, 2, 5, 12, 24] {
            let rule = jacobi.gauss_rule(size);
            assert!(rule.len() == size && rule.windows(2).all(|pair| pair[0].0 < pair[1].0));
            for power in 0..2 * size as i32 {
                let moment = |nodes: &[(f64, f64)]| nodes.iter().map(|(x, m)| m * x.powi(power)).sum::<f64>();
                let (found, exact) = (moment(&rule), moment(&measure));
                assert!((found - exact).abs() < 1e-13 * exact, "{size}, x^{power}: {found} {exact}");
            }
        }
    }

    #[test]
    fn the_rule_of_all_places_is_the_measure() {
        let measure = [(0.1, 0.5), (0.4, 2.0), (0.7, 1.0), (1.0, 0.25)];
        let rule = JacobiMatrix::of(&measure).gauss_rule(9);
        assert_eq!(rule.len(), 4);
        for ((x, m), (place, mass)) in rule.into_iter().zip(measure) {
            assert!((x - place).abs() < 1e-15 && (m - mass).abs() < 1e-14, "{x} {m}");
        }
    }

    #[test]
    fn rows_are_multiplied_by_eigenvectors() {
        let mut jacobi = JacobiMatrix::of(&measure(30));
        let nodes = jacobi.nodes(10);
        for (place, vector) in &nodes {
            for row in 0..10 {
                let above = if row > 0 { jacobi.beside[row - 1] * vector[row - 1] } else { 0.0 };
                let below = if row + 1 < 10 { jacobi.beside[row] * vector[row + 1] } else { 0.0 };
                let product = above + jacobi.diagonal[row] * vector[row] + below;
                assert!((product - place * vector[row]).abs() < 1e-15, "{place}, {row}");
            }
        }
    }

    #[test]
    fn what_is_not_finite_has_no_rule() {
        let rule = JacobiMatrix::of(&[(0.1, 1.0), (f64::NAN, 1.0), (1.0, 1.0)]).gauss_rule(2);
        assert!(rule.iter().all(|(place, mass)| place.is_nan() && mass.is_nan()));
    }
}
