//! Rational matrices of transfer functions that are given as equations of states.

use crate::dense::{eigenvalues, symmetric_eigenvalues};
use crate::sums::max_or_nan;
use fvi_core::min_or_nan;
use nalgebra::{Complex, DMatrix};

/// y = C x + D u, ẋ = A x + B u, with as many outputs as inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct StateSpace {
    /// A, n × n.
    pub state: DMatrix<f64>,
    /// B, n × m.
    pub input: DMatrix<f64>,
    /// C, m × n.
    pub output: DMatrix<f64>,
    /// D, m × m.
    pub direct: DMatrix<f64>,
}

/// A pole p, and its residue, a matrix of the rank of its multiplicity.
#[derive(Clone, Debug)]
pub struct MatrixPole {
    /// p; of a pair only that with Im p > 0.
    pub place: Complex<f64>,
    /// R of R/(s − p).
    pub residue: DMatrix<Complex<f64>>,
}

impl StateSpace {
    /// D + C (s − A)⁻¹ B; `None` at a pole.
    pub fn value(&self, s: Complex<f64>) -> Option<DMatrix<Complex<f64>>> {
        let complex = |matrix: &DMatrix<f64>| matrix.map(|entry| Complex::new(entry, 0.0));
        let mut shifted = -complex(&self.state);
        for k in 0..shifted.nrows() {
            shifted[(k, k)] += s;
        }
        let states = shifted.lu().solve(&complex(&self.input))?;
        Some(complex(&self.output) * states + complex(&self.direct))
    }

    /// The poles with their residues, R = C V (WᵀV)⁻¹ Wᵀ B, where the columns of V and W span the
    /// eigenvectors of A and Aᵀ: one for a simple pole, and as many as the pole counts where two bodies alike
    /// have it.
    ///
    /// # Errors
    /// A sentence with numbers if a pole is not in Re s < 0, if the numbers do not tell the poles apart, or
    /// if one is not simple: with fewer eigenvectors than it counts.
    pub fn poles(&self) -> Result<Vec<MatrixPole>, String> {
        let unknown = || "the eigenvalues of A are not found".to_owned();
        let mut places = eigenvalues(self.state.clone()).ok_or_else(unknown)?;
        let largest = places.iter().map(|place| place.norm()).fold(0.0, max_or_nan);
        for place in &mut places {
            if place.im.abs() <= 1e-13 * largest {
                place.im = 0.0;
            }
        }
        if let Some(place) = places.iter().find(|place| place.re >= 0.0) {
            let (re, im) = (place.re, place.im.abs());
            return Err(format!(
                "stable equations: A has the eigenvalue {re:.6e} ± {im:.6e}i, and the real parts of all must be below 0"
            ));
        }
        let transposed = self.state.transpose();
        let complex = |matrix: &DMatrix<f64>| matrix.map(|entry| Complex::new(entry, 0.0));
        let mut poles = Vec::new();
        let mut rest: Vec<_> = places.into_iter().filter(|place| place.im >= 0.0).collect();
        while let Some(&place) = rest.first() {
            let count = rest.len();
            rest.retain(|other| (other - place).norm() > ALIKE * place.norm());
            let count = count - rest.len();
            let spaces = (null_space(&self.state, place, count), null_space(&transposed, place, count));
            let (Some(right), Some(left)) = spaces else { return Err(unknown()) };
            let observed = complex(&self.output) * &right;
            let driven = left.transpose() * complex(&self.input);
            let product = left.transpose() * right;
            let Some(driven) = product.lu().solve(&driven) else { return Err(not_simple(place)) };
            let mut residue = observed * driven;
            if place.im == 0.0 {
                residue.apply(|entry| entry.im = 0.0);
            }
            poles.push(MatrixPole { place, residue });
        }
        self.check(&poles, largest)?;
        Ok(poles)
    }

    /// Compares the sum over the poles with D + C (s − A)⁻¹ B at places of Re s ≥ 0.
    fn check(&self, poles: &[MatrixPole], largest: f64) -> Result<(), String> {
        let mut off = 0.0_f64;
        for (re, im) in [(1.0, 0.0), (0.1, 0.0), (0.01, 0.3), (0.0, 1.0), (0.0, 0.1), (0.3, 3.0)] {
            let s = Complex::new(re, im) * largest;
            let Some(value) = self.value(s) else { continue };
            let sum = sum(&self.direct, poles, s);
            let size = value.iter().map(|entry| entry.norm()).fold(f64::MIN_POSITIVE, max_or_nan);
            let difference = (sum - value).iter().map(|entry| entry.norm()).fold(0.0, max_or_nan);
            off = max_or_nan(off, difference / size);
        }
        if off <= 1e-8 {
            return Ok(());
        }
        Err(format!(
            "equations with simple poles that the numbers tell apart: partial fractions differ from D + C (s − A)⁻¹ B by {off:.1e} \
             of it; a multiple pole with fewer eigenvectors than it counts is written as a quotient of polynomials in `symbol`"
        ))
    }

    /// The lowest eigenvalue of the Hermitian part of K̂(iω) relative to |K̂|, and its ω; frequencies are
    /// fifty to a decade from 10⁻³ of the slowest pole to 10³ of the fastest one, and those of the poles.
    pub fn lowest(&self, poles: &[MatrixPole]) -> (f64, f64) {
        let rates = poles.iter().map(|pole| pole.place.norm());
        let (slow, fast) =
            rates.fold((f64::INFINITY, 0.0), |(slow, fast), r| (min_or_nan(slow, r), max_or_nan(fast, r)));
        let mut looks: Vec<f64> = poles
            .iter()
            .flat_map(|pole| {
                let near = move |k: i32| pole.place.im + f64::from(k) * 0.25 * pole.place.re;
                (-8..=8).map(near)
            })
            .filter(|omega| *omega > 0.0)
            .collect();
        let mut omega = 1e-3 * slow;
        while omega < 1e3 * fast {
            looks.push(omega);
            omega *= libm::exp10(0.02);
        }
        let of = |omega: f64| {
            let value = sum(&self.direct, poles, Complex::new(0.0, omega));
            let size = value.iter().map(|entry| entry.norm_sqr()).sum::<f64>().sqrt();
            (hermitian_lowest(&value) / size, omega)
        };
        let all = looks.into_iter().map(of);
        all.fold((f64::INFINITY, 0.0), |least, next| if next.0 < least.0 { next } else { least })
    }
}

/// D + Σ R/(s − p) over both poles of each pair.
fn sum(direct: &DMatrix<f64>, poles: &[MatrixPole], s: Complex<f64>) -> DMatrix<Complex<f64>> {
    let mut sum = direct.map(|entry| Complex::new(entry, 0.0));
    for pole in poles {
        sum += &pole.residue * (s - pole.place).inv();
        if pole.place.im > 0.0 {
            sum += pole.residue.conjugate() * (s - pole.place.conj()).inv();
        }
    }
    sum
}

/// The smallest eigenvalue of (M + M*)/2: those of [[X, −Y], [Y, X]] with M + M* = 2(X + iY).
fn hermitian_lowest(matrix: &DMatrix<Complex<f64>>) -> f64 {
    let size = matrix.nrows();
    let part = |i: usize, j: usize| (matrix[(i, j)] + matrix[(j, i)].conj()) * 0.5;
    let whole = DMatrix::from_fn(2 * size, 2 * size, |i, j| {
        let entry = part(i % size, j % size);
        match (i < size, j < size) {
            (true, true) | (false, false) => entry.re,
            (true, false) => -entry.im,
            (false, true) => entry.im,
        }
    });
    symmetric_eigenvalues(whole).min()
}

/// Distance of eigenvalues that are one pole, relative to their size. Those of a pole that is not simple are
/// farther apart: the root of rounding.
const ALIKE: f64 = 1e-11;

/// The sentence about a pole with too few eigenvectors.
fn not_simple(place: Complex<f64>) -> String {
    format!(
        "equations whose poles are simple: A has fewer eigenvectors for the eigenvalue {:.6e} ± {:.6e}i than it counts; such a \
         multiple pole is written as a quotient of polynomials in `symbol`",
        place.re,
        place.im.abs()
    )
}

/// Orthonormal vectors v with A v = p v, as many as asked for, by inverse iteration beside p.
fn null_space(matrix: &DMatrix<f64>, place: Complex<f64>, count: usize) -> Option<DMatrix<Complex<f64>>> {
    let size = matrix.nrows();
    let mut shifted = matrix.map(|entry| Complex::new(entry, 0.0));
    let beside = place + place.norm() * Complex::new(3e-13, 1e-13);
    for k in 0..size {
        shifted[(k, k)] -= beside;
    }
    let factors = shifted.lu();
    let start = |k: usize, j: usize| 1.0 + 0.37 * libm::sin((k * (j + 1)) as f64 + 1.0);
    let mut vectors = DMatrix::from_fn(size, count, |k, j| Complex::new(start(k, j), 0.0));
    for _ in 0..4 {
        vectors = factors.solve(&vectors)?;
        for j in 0..count {
            let (before, mut rest) = vectors.columns_range_pair_mut(..j, j..);
            let mut vector = rest.column_mut(0);
            // Twice, for vectors that are nearly parallel.
            for _ in 0..2 {
                for other in before.column_iter() {
                    let along = other.dotc(&vector);
                    vector.axpy(-along, &other, Complex::ONE);
                }
            }
            let norm = vector.norm();
            if norm <= 0.0 || !norm.is_finite() {
                return None;
            }
            vector /= Complex::new(norm, 0.0);
        }
    }
    Some(vectors)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equations_of_states_have_the_poles_and_residues_of_their_fractions() {
        // s(s + 1.2)/((s² + 1.1 s + 1.3)(s + 0.7)) in companion form.
        let (a2, a1, a0) = (1.1 + 0.7, 1.3 + 0.77, 0.91);
        let space = StateSpace {
            state: DMatrix::from_row_slice(3, 3, &[-a2, -a1, -a0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]),
            input: DMatrix::from_row_slice(3, 1, &[1.0, 0.0, 0.0]),
            output: DMatrix::from_row_slice(1, 3, &[1.0, 1.2, 0.0]),
            direct: DMatrix::zeros(1, 1),
        };
        let poles = space.poles().unwrap();
        assert_eq!(poles.len(), 2);
        for omega in [0.0, 0.3, 1.0, 7.0] {
            let s = Complex::new(0.1, omega);
            let exact = s * (s + 1.2) / ((s * s + s * 1.1 + 1.3) * (s + 0.7));
            assert!((sum(&space.direct, &poles, s)[(0, 0)] - exact).norm() < 1e-13);
        }
        assert!(space.lowest(&poles).0 > 0.0);
    }

    #[test]
    fn bodies_alike_have_their_poles_once_with_residues_of_their_number() {
        // Two and three times the same pair of poles and a real one, their states mixed by a rotation.
        let block = [[-0.6, 1.3, 0.0], [-1.3, -0.6, 0.0], [0.0, 0.0, -0.4]];
        for bodies in [2, 3] {
            let size = 3 * bodies;
            let mut state = DMatrix::zeros(size, size);
            let (mut input, mut output) = (DMatrix::zeros(size, bodies), DMatrix::zeros(bodies, size));
            for body in 0..bodies {
                for (row, entries) in block.iter().enumerate() {
                    for (column, &entry) in entries.iter().enumerate() {
                        state[(3 * body + row, 3 * body + column)] = entry;
                    }
                    // They drive each other.
                    for other in 0..bodies {
                        let share = if other == body { 2.0 } else { 0.3 };
                        input[(3 * body + row, other)] = share * (row as f64 - 0.7);
                        output[(other, 3 * body + row)] = share * (0.4 + row as f64);
                    }
                }
            }
            let mixing = DMatrix::from_fn(size, size, |i, j| libm::sin((3 * i + 7 * j + i * j) as f64));
            let mixing = mixing.qr().q();
            let space = StateSpace {
                state: &mixing * state * mixing.transpose(),
                input: &mixing * input,
                output: output * mixing.transpose(),
                direct: DMatrix::zeros(bodies, bodies),
            };
            let poles = space.poles().unwrap();
            assert_eq!(poles.len(), 2, "{poles:?}");
            for omega in [0.1, 1.0, 3.0] {
                let s = Complex::new(0.2, omega);
                let off = (sum(&space.direct, &poles, s) - space.value(s).unwrap()).norm();
                assert!(off < 1e-11, "{bodies} bodies at {omega}: {off:e}");
            }
        }
    }

    #[test]
    fn growing_driving_and_multiple_poles_are_told() {
        let of = |state: &[f64], output: &[f64]| StateSpace {
            state: DMatrix::from_row_slice(2, 2, state),
            input: DMatrix::from_row_slice(2, 1, &[0.0, 1.0]),
            output: DMatrix::from_row_slice(1, 2, output),
            direct: DMatrix::zeros(1, 1),
        };
        let told = of(&[0.1, 0.0, 0.0, -1.0], &[1.0, 1.0]).poles().unwrap_err();
        assert!(told.contains("eigenvalue 1.000000e-1"), "{told}");
        let told = of(&[-1.0, 1.0, 0.0, -1.0], &[1.0, 0.0]).poles().unwrap_err();
        assert!(told.contains("multiple pole"), "{told}");
        // 1/(s² + s + 1), a spring at rest: Re at ω > 1 is below 0.
        let driving = of(&[0.0, 1.0, -1.0, -1.0], &[1.0, 0.0]);
        let (lowest, omega) = driving.lowest(&driving.poles().unwrap());
        assert!(lowest < -0.9 && omega > 1.0, "{lowest} at {omega}");
    }
}
