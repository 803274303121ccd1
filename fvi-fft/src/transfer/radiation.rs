//! Retardation functions of the waves that a body radiates, from its damping over frequency.

use crate::dense::symmetric_eigen;
use crate::sums::max_or_nan;
use nalgebra::{Complex, DMatrix};
use std::f64::consts::PI;

/// Radiation damping B(ω) at ascending frequencies, a symmetric matrix for each.
///
/// Between rows B is linear, below the first one a line from B(0) = 0, above the last one a line to 0 at
/// [`TAIL`] times it: a positive semidefinite matrix everywhere, if every row is one. Units: frequencies in
/// rad/s, B in those of a force over a velocity.
#[derive(Clone, Debug)]
pub struct Damping {
    omega: Vec<f64>,
    rows: Vec<DMatrix<f64>>,
    /// Size of B of each coordinate, which makes entries of different units comparable.
    sizes: Vec<f64>,
}

/// What ω of the last row is multiplied by for the place where B has ended.
pub const TAIL: f64 = 1.5;

/// Rows of K in a period of the highest frequency.
const PER_PERIOD: f64 = 8.0;

/// Most rows of K.
const MOST_ROWS: f64 = 20_000.0;

/// K(t) at t = kΔ, linear in between, 0 at the last one; and how far it is from the table.
#[derive(Clone, Debug)]
pub struct Retardation {
    /// Δ.
    pub spacing: f64,
    /// K.
    pub rows: Vec<DMatrix<f64>>,
    /// Largest difference of Re K̂(iω) from the B of a row, relative to the sizes, and its ω.
    pub deviation: (f64, f64),
}

impl Damping {
    /// Of frequencies, rows and sizes of the coordinates, each positive.
    pub fn new(omega: Vec<f64>, rows: Vec<DMatrix<f64>>, sizes: Vec<f64>) -> Self {
        Self { omega, rows, sizes }
    }

    /// The matrix with each entry relative to the sizes of its coordinates.
    fn relative(&self, matrix: &DMatrix<f64>) -> DMatrix<f64> {
        let size = |i: usize, j: usize| (self.sizes[i] * self.sizes[j]).sqrt();
        DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)] / size(i, j))
    }

    /// The smallest eigenvalue of a row relative to the sizes, and its ω.
    pub fn lowest(&self) -> (f64, f64) {
        let of = |(row, omega): (&DMatrix<f64>, &f64)| {
            (symmetric_eigen(self.relative(row)).eigenvalues.min(), *omega)
        };
        let all = self.rows.iter().zip(&self.omega).map(of);
        all.fold((f64::INFINITY, 0.0), |least, next| if next.0 < least.0 { next } else { least })
    }

    /// The nearest rows that are positive semidefinite: eigenvalues below 0, relative to the sizes, become 0.
    #[must_use]
    pub fn projected(&self) -> Self {
        let project = |row: &DMatrix<f64>| {
            let mut eigen = symmetric_eigen(self.relative(row));
            if eigen.eigenvalues.min() >= 0.0 {
                return row.clone();
            }
            eigen.eigenvalues.apply(|value| *value = value.max(0.0));
            let matrix = eigen.recompose();
            let size = |i: usize, j: usize| (self.sizes[i] * self.sizes[j]).sqrt();
            let mean = |i: usize, j: usize| 0.5 * (matrix[(i, j)] + matrix[(j, i)]) * size(i, j);
            DMatrix::from_fn(row.nrows(), row.ncols(), mean)
        };
        Self { rows: self.rows.iter().map(project).collect(), ..self.clone() }
    }

    /// The places of the kinks of B, on the positive half-axis, 0 and the end among them.
    fn places(&self) -> Vec<f64> {
        let begin = (self.omega[0] > 0.0).then_some(0.0);
        let end = TAIL * self.omega[self.omega.len() - 1];
        begin.into_iter().chain(self.omega.iter().copied()).chain([end]).collect()
    }

    /// The changes of slope of an entry at the places; that at 0 is not needed.
    fn kinks(&self, rows: &[DMatrix<f64>], (i, j): (usize, usize), places: &[f64]) -> Vec<f64> {
        let begin = (self.omega[0] > 0.0).then_some(0.0);
        let own = rows.iter().map(|row| row[(i, j)]);
        let values: Vec<f64> = begin.into_iter().chain(own).chain([0.0]).collect();
        let slope = |k: usize| (values[k + 1] - values[k]) / (places[k + 1] - places[k]);
        let kink = |k: usize| match k {
            0 => 0.0,
            k if k + 1 == places.len() => -slope(k - 1),
            k => slope(k) - slope(k - 1),
        };
        (0..places.len()).map(kink).collect()
    }

    /// K(t) = (2/π) ∫ B cos ωt dω = (1/π) Σ c_k ω_k² (sin(ω_k t/2)/(ω_k t/2))², c_k the changes of slope.
    fn value(kinks: &[f64], places: &[f64], time: f64) -> f64 {
        let term = |(kink, place): (&f64, &f64)| kink * place * place * sinc_squared(place * time);
        kinks.iter().zip(places).map(term).sum::<f64>() / PI
    }

    /// The time after which every entry of K stays below 2·10⁻³ of its largest value, eight times; at most
    /// what the distance of the rows tells, 2π over the mean of it.
    pub fn length(&self) -> f64 {
        const SMALL: f64 = 2e-3;
        let places = self.places();
        let end = places[places.len() - 1];
        let apart = self.omega[self.omega.len() - 1] / self.omega.len() as f64;
        let longest = 2.0 * PI / apart;
        let spacing = PI / end;
        let steps = (longest / spacing).ceil().min(MOST_ROWS) as usize;
        let mut last = 0.0;
        for i in 0..self.sizes.len() {
            let kinks = self.kinks(&self.rows, (i, i), &places);
            let of = |k: usize| Self::value(&kinks, &places, k as f64 * spacing).abs();
            let values: Vec<f64> = (0..steps).map(of).collect();
            let most = values.iter().copied().fold(0.0, max_or_nan);
            let after = values.iter().rposition(|&value| value > SMALL * most).unwrap_or(0);
            last = max_or_nan(last, after as f64 * spacing);
        }
        (8.0 * last).clamp(8.0 * 2.0 * PI / end, longest)
    }

    /// K(t) up to T = `length`.
    ///
    /// K is multiplied by Bohman's window w, which ends at T, and is linear between its rows. Both are
    /// positive
    /// definite, so that
    ///
    /// ```text
    /// Re K̂(iω) = sinc²(ωΔ/2) Σ_k (B∗ŵ)(ω + 2πk/Δ) ≥ 0
    /// ```
    ///
    /// for every ω if B ≥ 0 at its rows. What w and the interpolation change at the rows is added to B
    /// beforehand, as far as it stays positive semidefinite (with `keep`: whatever it is), in a few
    /// corrections.
    pub fn retardation(&self, length: f64, keep: bool) -> Retardation {
        const CORRECTIONS: usize = 12;
        let places = self.places();
        let end = places[places.len() - 1];
        let count = (length * PER_PERIOD * end / (2.0 * PI)).ceil().clamp(2.0, MOST_ROWS) as usize;
        let spacing = length / count as f64;
        let shapes = DMatrix::from_fn(count + 1, places.len(), |k, place| {
            let (x, omega) = (k as f64 / count as f64, places[place]);
            let window = (1.0 - x) * libm::cos(PI * x) + libm::sin(PI * x) / PI;
            let is_last = k == count;
            if is_last { 0.0 } else { omega * omega / PI * sinc_squared(omega * k as f64 * spacing) * window }
        });
        // Re ∫ of hats, and half a hat at t = 0.
        let cosines = DMatrix::from_fn(self.omega.len(), count + 1, |row, k| {
            let x = self.omega[row] * spacing;
            let share = if k == 0 { 0.5 } else { 1.0 };
            share * spacing * sinc_squared(x) * libm::cos(x * k as f64)
        });
        let mut source = self.clone();
        for (row, omega) in source.rows.iter_mut().zip(&self.omega) {
            *row /= sinc_squared(omega * spacing);
        }
        let mut best: Option<([f64; 2], DMatrix<f64>)> = None;
        for _ in 0..=CORRECTIONS {
            let kinks: Vec<f64> =
                self.pairs().flat_map(|pair| self.kinks(&source.rows, pair, &places)).collect();
            let kinks = DMatrix::from_vec(places.len(), self.pairs().count(), kinks);
            let columns = &shapes * kinks;
            let found = &cosines * &columns;
            let mut deviation = [0.0, 0.0];
            for (k, omega) in self.omega.iter().enumerate() {
                let off = &self.rows[k] - self.matrix(|column| found[(k, column)]);
                let size = self.relative(&off).amax();
                if size > deviation[0] {
                    deviation = [size, *omega];
                }
                source.rows[k] += off;
            }
            if best.as_ref().is_some_and(|(least, _)| least[0] <= 1.01 * deviation[0]) {
                break;
            }
            best = Some((deviation, columns));
            if !keep {
                source = source.projected();
            }
        }
        let (deviation, columns) = best.unwrap_or(([f64::NAN; 2], DMatrix::zeros(0, 0)));
        let rows = (0..columns.nrows()).map(|k| self.matrix(|column| columns[(k, column)])).collect();
        Retardation { spacing, rows, deviation: (deviation[0], deviation[1]) }
    }

    /// The entries on and above the diagonal.
    fn pairs(&self) -> impl Iterator<Item = (usize, usize)> {
        let size = self.sizes.len();
        (0..size).flat_map(move |i| (i..size).map(move |j| (i, j)))
    }

    /// The symmetric matrix with these entries, in the order of the pairs.
    fn matrix(&self, entry: impl Fn(usize) -> f64) -> DMatrix<f64> {
        let mut matrix = DMatrix::zeros(self.sizes.len(), self.sizes.len());
        for (column, (i, j)) in self.pairs().enumerate() {
            (matrix[(i, j)], matrix[(j, i)]) = (entry(column), entry(column));
        }
        matrix
    }
}

impl Retardation {
    /// K̂(iω) = ∫ K(t) e^{−iωt} dt.
    pub fn transform(&self, omega: f64) -> DMatrix<Complex<f64>> {
        transform(&self.rows, self.spacing, omega)
    }

    /// t and K_ij, row by row.
    pub fn table(&self, i: usize, j: usize) -> Vec<(f64, f64)> {
        self.rows.iter().enumerate().map(|(k, row)| (k as f64 * self.spacing, row[(i, j)])).collect()
    }
}

/// (sin(x/2)/(x/2))²
fn sinc_squared(x: f64) -> f64 {
    let half = 0.5 * x;
    let shape = if half.abs() < 1e-4 { 1.0 - half * half / 6.0 } else { libm::sin(half) / half };
    shape * shape
}

/// ∫ K e^{−iωt} dt of rows that are linear in between: hats of the width 2Δ, and half of one at t = 0.
fn transform(rows: &[DMatrix<f64>], spacing: f64, omega: f64) -> DMatrix<Complex<f64>> {
    let Some(first) = rows.first() else { return DMatrix::zeros(0, 0) };
    let x = omega * spacing;
    let turn = Complex::new(libm::cos(x), -libm::sin(x));
    // ∫₀^Δ (1 − t/Δ) e^{−iωt} dt = Δ (1 − ix − e^{−ix})/x²
    let half = if x.abs() < 1e-3 {
        Complex::new(0.5 - x * x / 24.0, -x / 6.0 + x * x * x / 120.0)
    } else {
        (Complex::new(1.0, -x) - turn) / (x * x)
    };
    let sum = rows
        .iter()
        .skip(1)
        .rev()
        .fold(DMatrix::<Complex<f64>>::zeros(first.nrows(), first.ncols()), |sum, row| {
            (sum + row.map(|entry| Complex::new(entry, 0.0))) * turn
        });
    let full = Complex::new(sinc_squared(x), 0.0);
    (sum * full + first.map(|entry| half * entry)) * Complex::new(spacing, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// K̂ = s(s + 1.2)/((s² + 1.1 s + 1.3)(s + 0.7)), which is positive real.
    fn rational(s: Complex<f64>) -> Complex<f64> {
        s * (s + 1.2) / ((s * s + s * 1.1 + 1.3) * (s + 0.7))
    }

    fn table() -> Damping {
        let omega: Vec<f64> = (1..=400).map(|k| 0.05 * f64::from(k)).collect();
        let row = |omega: &f64| DMatrix::from_element(1, 1, rational(Complex::new(0.0, *omega)).re);
        let rows: Vec<DMatrix<f64>> = omega.iter().map(row).collect();
        let size = rows.iter().map(|row| row[(0, 0)]).fold(0.0, max_or_nan);
        Damping::new(omega, rows, vec![size])
    }

    #[test]
    fn a_rational_function_comes_back_from_its_table() {
        let table = table();
        let length = table.length();
        assert!(length > 50.0 && length < 130.0, "{length}");
        let found = table.retardation(length, false);
        assert!(found.deviation.0 < 1e-3, "{:?}", found.deviation);
        for k in 0..1000 {
            let omega = 0.02 * f64::from(k) + 0.001;
            let (own, exact) = (found.transform(omega)[(0, 0)], rational(Complex::new(0.0, omega)));
            assert!(own.re > 0.0, "{omega}: {own}");
            assert!((own - exact).norm() < 3e-3, "{omega}: {own} {exact}");
        }
        // Far beyond the table too.
        for k in 0..3000 {
            let omega = 20.0 + 0.1 * f64::from(k);
            assert!(found.transform(omega)[(0, 0)].re > -1e-14, "{omega}");
        }
    }

    #[test]
    fn rows_below_zero_are_projected() {
        let rows = vec![DMatrix::from_element(1, 1, -1e-3), DMatrix::from_element(1, 1, 1.0)];
        let table = Damping::new(vec![0.1, 1.0], rows, vec![1.0]);
        assert_eq!(table.lowest(), (-1e-3, 0.1));
        let projected = table.projected();
        assert_eq!(projected.rows[0][(0, 0)], 0.0);
        assert_eq!(projected.rows[1][(0, 0)], 1.0);
        // [[1, 2], [2, 1]] has the eigenvalues 3 and −1.
        let row = DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 1.0]);
        let pair = Damping::new(vec![1.0], vec![row], vec![1.0, 1.0]).projected();
        assert!((&pair.rows[0] - DMatrix::from_element(2, 2, 1.5)).amax() < 1e-14);
    }
}
