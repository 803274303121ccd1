//! Decomposition of a linear system into uncoupled parts.

use super::LinearSystem;
use fvi_fft::dense::{symmetric_eigen, symmetric_eigenvalues};
use nalgebra::DMatrix;

/// Coupling between coordinates, relative to the largest entry of its matrix, below which it is neglected.
const ROUNDING: f64 = 1e-12;

/// Largest number of coordinates of a part; in larger ones the coupling between the modes is neglected.
pub(crate) const LARGEST_PART: usize = 40;

/// A part of the system, in coordinates where the mass matrix is the identity unless `mass` is given.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Part {
    /// M, positive semidefinite, if it is not the identity.
    pub(crate) mass: Option<DMatrix<f64>>,
    /// K.
    pub(crate) stiffness: DMatrix<f64>,
    /// C, if there are velocity-dependent forces.
    pub(crate) resistance: Option<DMatrix<f64>>,
    /// ρ of each term.
    pub(crate) damping: Vec<DMatrix<f64>>,
}

impl Part {
    /// Number of coordinates.
    pub(crate) fn size(&self) -> usize {
        self.stiffness.nrows()
    }

    /// True if any term acts on it.
    pub(crate) fn is_damped(&self) -> bool {
        self.damping.iter().any(|term| term.amax() > 0.0)
    }

    /// The negative of the smallest eigenvalue of the symmetric part of C, if that is negative; otherwise
    /// zero.
    fn driving(&self) -> f64 {
        let Some(resistance) = &self.resistance else { return 0.0 };
        let smallest = symmetric_eigenvalues((resistance + resistance.transpose()) * 0.5).min();
        let rounding = 1e-14 * self.size() as f64 * resistance.amax();
        if -smallest > rounding { -smallest } else { 0.0 }
    }

    /// True if velocity-dependent forces act on it.
    pub(crate) fn is_resisted(&self) -> bool {
        self.resistance.as_ref().is_some_and(|resistance| resistance.amax() > 0.0)
    }

    /// Upper bound σ of the growth rates of the part: no motion grows faster than e^{σt}.
    ///
    /// If s² + k + iκ + Σ ρ s^β = 0 with ρ ≥ 0, where k and iκ are the symmetric and skew parts of K for the
    /// motion, and Re s > 0, then (Re s)² ≤ max(−k, 0) + |κ|/2: the imaginary part of the equation bounds 2
    /// Re s |Im s| by |κ|, the real part the rest. With velocity-dependent forces, where −γ is the smallest
    /// eigenvalue of the symmetric part of C if that is negative, the real part of the equation divided by s
    /// is Re s ≤ γ + (max(−k, 0) + |κ|/2)/Re s.
    pub(super) fn growth_rate(&self) -> f64 {
        let transposed = self.stiffness.transpose();
        let symmetric = (&self.stiffness + &transposed) * 0.5;
        let skew = (&self.stiffness - &transposed) * 0.5;
        let smallest = symmetric_eigenvalues(symmetric).min();
        let rounding = 1e-14 * self.size() as f64 * self.stiffness.amax();
        let pushing = if -smallest > rounding { -smallest } else { 0.0 };
        let turning = skew.norm();
        let square = pushing + if turning > rounding { 0.5 * turning } else { 0.0 };
        match self.driving() {
            0.0 => libm::sqrt(square),
            driving => 0.5 * driving + libm::sqrt(0.25 * driving * driving + square),
        }
    }
}

/// The parts of a system.
///
/// In the eigenvectors of a combination of all matrices those that commute become diagonal together: then
/// every mode is a part. Coordinates that remain coupled form one part. With a nonsymmetric stiffness the
/// coordinates are not transformed.
pub(super) fn parts(system: &LinearSystem) -> Vec<Part> {
    let mut parts = match all_parts(system) {
        Ok(parts) => parts,
        Err(matrices) => return neglecting_coupling(&matrices, Has::of(system)),
    };
    // One of several equal modes suffices.
    parts.sort_by(|a, b| order(a).partial_cmp(&order(b)).unwrap_or(std::cmp::Ordering::Equal));
    parts.dedup_by(|a, b| a.size() == 1 && b.size() == 1 && order(a) == order(b));
    parts
}

/// As [`parts`], including repeated modes; if a part is larger than [`LARGEST_PART`], the matrices instead.
pub(super) fn all_parts(system: &LinearSystem) -> Result<Vec<Part>, Vec<DMatrix<f64>>> {
    let size = system.stiffness.nrows();
    let mut matrices = vec![system.stiffness.clone()];
    matrices.extend(system.damping.iter().map(|term| term.coefficients.clone()));
    let is_symmetric =
        |matrix: &DMatrix<f64>| (matrix - matrix.transpose()).amax() <= ROUNDING * matrix.amax();
    let symmetric = is_symmetric(&matrices[0]) && system.resistance.as_ref().is_none_or(is_symmetric);
    matrices.extend(system.resistance.clone());
    matrices.extend(system.mass.clone());
    if symmetric && size > 1 {
        turn(&mut matrices, |index| libm::sqrt(2.0 + index as f64));
    }
    let mut found = components(&matrices);
    if found.iter().any(|members| members.len() > LARGEST_PART) {
        return Err(matrices);
    }
    found.iter_mut().for_each(|members| members.sort_unstable());
    Ok(found.iter().map(|members| part(&matrices, members, Has::of(system))).collect())
}

/// Which matrices of a system follow K and ρ in a list: C and then M, as far as they exist.
#[derive(Clone, Copy)]
struct Has {
    resistance: bool,
    mass: bool,
}

impl Has {
    fn of(system: &LinearSystem) -> Self {
        Self { resistance: system.resistance.is_some(), mass: system.mass.is_some() }
    }
}

/// Transforms all matrices to the eigenvectors of their combination with these factors.
fn turn(matrices: &mut [DMatrix<f64>], factor: impl Fn(usize) -> f64) {
    let size = matrices[0].nrows();
    let combination = matrices.iter().enumerate().fold(DMatrix::zeros(size, size), |sum, (index, matrix)| {
        let largest = matrix.amax();
        if largest > 0.0 { sum + matrix * (factor(index) / largest) } else { sum }
    });
    let vectors = symmetric_eigen((&combination + combination.transpose()) * 0.5).eigenvectors;
    for matrix in matrices {
        *matrix = vectors.transpose() * &*matrix * &vectors;
    }
}

/// The sets of coordinates that are coupled with each other, directly or through others.
fn components(matrices: &[DMatrix<f64>]) -> Vec<Vec<usize>> {
    let size = matrices[0].nrows();
    let rounding: Vec<f64> = matrices.iter().map(|of| ROUNDING * of.amax()).collect();
    let coupled = |i: usize, j: usize| {
        matrices.iter().zip(&rounding).any(|(of, &zero)| of[(i, j)].abs().max(of[(j, i)].abs()) > zero)
    };
    let mut free: Vec<usize> = (0..size).collect();
    let mut found = Vec::new();
    while let Some(first) = free.pop() {
        let mut members = vec![first];
        let mut next = 0;
        while next < members.len() {
            let from = members[next];
            let (joined, left): (Vec<_>, Vec<_>) = free.into_iter().partition(|&to| coupled(from, to));
            members.extend(joined);
            free = left;
            next += 1;
        }
        found.push(members);
    }
    found
}

fn part(matrices: &[DMatrix<f64>], members: &[usize], has: Has) -> Part {
    let of = |matrix: &DMatrix<f64>| {
        let block = DMatrix::from_fn(members.len(), members.len(), |i, j| matrix[(members[i], members[j])]);
        // A block of rounding size becomes zero, so that undamped modes are recognised.
        let rounding = ROUNDING * matrix.amax();
        if block.amax() <= rounding { DMatrix::zeros(members.len(), members.len()) } else { block }
    };
    let (stiffness, rest) = matrices.split_first().map_or((&matrices[0], &[][..]), |split| split);
    let (rest, mass) = rest.split_at(rest.len() - usize::from(has.mass));
    let (damping, resistance) = rest.split_at(rest.len() - usize::from(has.resistance));
    Part {
        mass: mass.first().map(of),
        stiffness: of(stiffness),
        resistance: resistance.first().map(of),
        damping: damping.iter().map(of).collect(),
    }
}

/// Every mode of the stiffness, and every mode of the damping, as a part of its own.
fn neglecting_coupling(matrices: &[DMatrix<f64>], has: Has) -> Vec<Part> {
    let one_by_one = |matrices: &[DMatrix<f64>]| -> Vec<Part> {
        (0..matrices[0].nrows()).map(|index| part(matrices, &[index], has)).collect()
    };
    let (mut elastic, mut damped) = (matrices.to_vec(), matrices.to_vec());
    turn(&mut elastic, |index| if index == 0 { 1.0 } else { 0.0 });
    turn(&mut damped, |index| if index == 0 { 0.0 } else { 1.0 });
    [one_by_one(&elastic), one_by_one(&damped)].concat()
}

/// Sort key of a part: its numbers to eight digits.
fn order(part: &Part) -> Vec<f64> {
    let digits = |number: &f64| {
        let unit = libm::exp10(libm::log10(number.abs()).floor() - 8.0);
        if unit > 0.0 { (number / unit).round() * unit } else { 0.0 }
    };
    let others = part.damping.iter().chain(&part.resistance).chain(&part.mass);
    let numbers = part.stiffness.iter().chain(others.flat_map(|matrix| matrix.iter()));
    std::iter::once(part.size() as f64).chain(numbers.map(digits)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::LinearDamping;
    use super::*;
    use fvi_fft::transfer::TransferFunction;
    use nalgebra::dmatrix;

    fn system(mass: DMatrix<f64>, stiffness: DMatrix<f64>, rho: DMatrix<f64>) -> LinearSystem {
        let damping =
            vec![LinearDamping { coefficients: rho, transfer: TransferFunction::power(0.5).unwrap() }];
        LinearSystem::new(&mass, &stiffness, damping).unwrap()
    }

    #[test]
    fn modes_come_apart_where_the_matrices_commute() {
        let stiffness = dmatrix![2.0, -1.0, 0.0; -1.0, 2.0, -1.0; 0.0, -1.0, 2.0];
        let mass = dmatrix![2.0, 0.3, 0.0; 0.3, 1.0, 0.1; 0.0, 0.1, 3.0];
        let proportional = system(mass.clone(), stiffness.clone(), &mass * 0.1 + &stiffness * 0.2);
        let found = parts(&proportional);
        assert_eq!(found.len(), 3);
        for part in found {
            let (k, rho) = (part.stiffness[(0, 0)], part.damping[0][(0, 0)]);
            assert!((rho - 0.1 - 0.2 * k).abs() < 1e-14);
        }
        let one_damper = system(mass, stiffness, dmatrix![1.0, 0.0, 0.0; 0.0, 0.0, 0.0; 0.0, 0.0, 0.0]);
        assert_eq!(parts(&one_damper).len(), 1);
    }

    #[test]
    fn equal_modes_are_looked_at_once_and_couplings_are_followed() {
        let rho = DMatrix::identity(3, 3);
        assert_eq!(parts(&system(DMatrix::identity(3, 3), DMatrix::identity(3, 3) * 4.0, rho)).len(), 1);
        let turning = dmatrix![1.0, 0.5, 0.0; -0.5, 1.0, 0.0; 0.0, 0.0, 3.0];
        let sizes: Vec<usize> = parts(&system(DMatrix::identity(3, 3), turning, DMatrix::zeros(3, 3)))
            .iter()
            .map(Part::size)
            .collect();
        assert_eq!(sizes, [1, 2]);
    }

    #[test]
    fn the_growth_rate_bounds_that_of_unstable_equilibria() {
        let of = |stiffness| parts(&system(DMatrix::identity(2, 2), stiffness, DMatrix::zeros(2, 2)));
        let rates: Vec<f64> = of(dmatrix![-4.0, 0.0; 0.0, 9.0]).iter().map(Part::growth_rate).collect();
        assert_eq!(rates, [2.0, 0.0]);
        // A circulatory force: s² = −1 ± 0.5i, Re s = 0.2429.
        let rate = of(dmatrix![1.0, 0.5; -0.5, 1.0])[0].growth_rate();
        assert!((0.2429..0.7).contains(&rate), "{rate}");
    }
}
