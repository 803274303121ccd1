//! Stationarity with the fractional velocities as unknowns, matrix-free.
//!
//! With Q₀ and Q_N fixed, the positions between them and the velocities V₁…V_{N−1} determine each other: V
//! comes from Q by a triangular Toeplitz matrix T, and Q from V by its inverse J, the fractional sum whose
//! weights g are those of the exponent −α. In the velocities every operator is bounded independently of h,
//! where T·Tᵀ in the positions grows like h^(−2α). Written for σ = − (the problem of σ = + is this one with
//! time reversed and v of the other sign):
//!
//! ```text
//! Q_k = ĝ_k Q₀ + Σ_{j=1}^{k} g_{k−j} V_j ,   V_N = (Q_N − ĝ_N Q₀)/g₀ + Σ_{j=1}^{N−1} s_j V_j ,
//! s_j = −ĝ_{N−j} ,   ĝ = g/g₀
//! r_k = ∂L/∂v(k) + s_k ∂L/∂v(N) + (Jᵀ ∂L/∂x)_k = 0 ,   k = 1…N−1
//! ```
//!
//! r is Jᵀ times the gradient of the discrete functional. Its derivative is
//!
//! ```text
//! H = A + s A_N sᵀ + (B J + Jᵀ Bᵀ + Jᵀ C J) ,   A = ∂²L/∂v² , B = ∂²L/∂v∂x , C = ∂²L/∂x²  at each point
//! ```
//!
//! The part in brackets is compact, since J smooths; the rest, diagonal plus rank d, is inverted exactly and
//! preconditions the whole. So the number of Krylov iterations does not grow with N, and a Lagrangian without
//! x needs one.

use super::end_points::EndPoints;
use super::grid::{Grid, Sigma};
use super::lagrangian::Lagrangian;
use super::minres::{self, Limits, inner};
use super::newton::{Descent, Direction, Formulation, Residual, Stationarity};
use super::toeplitz::{LowerToeplitz, Product};
use fvi_core::max_or_nan;
use fvi_fft::dense;
use nalgebra::{DMatrix, DVector};

/// Reduction of the residual in one solution of the linear system; Newton's method corrects the remainder.
const KRYLOV_REDUCTION: f64 = 1e-10;
/// In the preconditioner only, eigenvalues of ∂²L/∂v² are raised to at least this fraction of the largest
/// one.
const LEAST_CURVATURE: f64 = 1e-6;

pub(super) struct Velocities<'a> {
    lagrangian: &'a dyn Lagrangian,
    grid: Grid,
    sigma: Sigma,
    coordinates: usize,
    /// J, of size N − 1.
    sum: LowerToeplitz,
    /// ĝ₁…ĝ_N at 1…N, ĝ₀ = 1.
    monic: Vec<f64>,
    /// g₀ = h^α.
    leading: f64,
    /// Position at the end where the operator starts, and at the other end.
    first: Vec<f64>,
    last: Vec<f64>,
    krylov_iterations: usize,
    /// ∂L/∂(x, v) at the points 1…N, 2d numbers each.
    slopes: Vec<f64>,
    /// Second derivatives at the points 1…N, (2d)² numbers each.
    curvatures: Vec<f64>,
    couples_positions: bool,
    gradient: Vec<f64>,
    preconditioner: Preconditioner,
}

impl<'a> Velocities<'a> {
    /// From the weights g₀…g_N of the fractional sum of order α.
    pub(super) fn new(
        lagrangian: &'a dyn Lagrangian,
        grid: Grid,
        sigma: Sigma,
        sum_weights: &[f64],
        ends: &EndPoints,
        product: Product,
        krylov_iterations: usize,
    ) -> Self {
        let steps = grid.steps();
        let coordinates = lagrangian.coordinates();
        let leading = sum_weights[0];
        let monic = sum_weights.iter().map(|weight| weight / leading).collect();
        let weights = sum_weights[..steps - 1].to_vec();
        let (first, last) = match sigma {
            Sigma::Minus => (ends.start.clone(), ends.end.clone()),
            Sigma::Plus => (ends.end.clone(), ends.start.clone()),
        };
        Self {
            lagrangian,
            grid,
            sigma,
            coordinates,
            sum: LowerToeplitz::new(weights, product),
            monic,
            leading,
            first,
            last,
            krylov_iterations,
            slopes: vec![0.0; 2 * coordinates * steps],
            curvatures: vec![0.0; 4 * coordinates * coordinates * steps],
            couples_positions: true,
            gradient: Vec::new(),
            preconditioner: Preconditioner::identity(steps, coordinates),
        }
    }

    /// Number of points strictly between the ends.
    fn inner_points(&self) -> usize {
        self.grid.steps() - 1
    }

    /// s_j for the point with index j − 1 among the inner ones.
    fn row(&self, inner: usize) -> f64 {
        -self.monic[self.grid.steps() - 1 - inner]
    }

    /// Positions and velocities at the points 1…N, in reversed time for σ = +.
    fn state(&mut self, unknowns: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let (d, steps) = (self.coordinates, self.grid.steps());
        let mut positions = unknowns.to_vec();
        self.sum.apply(&mut positions, d);
        for (k, position) in positions.chunks_exact_mut(d).enumerate() {
            for (x, first) in position.iter_mut().zip(&self.first) {
                *x += self.monic[k + 1] * first;
            }
        }
        positions.extend_from_slice(&self.last);
        let mut velocities = unknowns.to_vec();
        for i in 0..d {
            let free = (self.last[i] - self.monic[steps] * self.first[i]) / self.leading;
            velocities.push(free + self.along_row(unknowns, i));
        }
        (positions, velocities)
    }

    /// Σ_j s_j u_j of one coordinate.
    fn along_row(&self, unknowns: &[f64], coordinate: usize) -> f64 {
        let entries = unknowns[coordinate..].iter().step_by(self.coordinates);
        entries.enumerate().map(|(k, entry)| self.row(k) * entry).sum()
    }

    /// Time of the point j = 1…N.
    fn time(&self, j: usize) -> f64 {
        match self.sigma {
            Sigma::Minus => self.grid.time(j),
            Sigma::Plus => self.grid.time(self.grid.steps() - j),
        }
    }

    /// First derivatives at the points 1…N.
    fn evaluate_slopes(&mut self, unknowns: &[f64]) {
        let d = self.coordinates;
        let sign = self.sigma.derivative_sign();
        let (positions, velocities) = self.state(unknowns);
        let mut v = vec![0.0; d];
        for (index, slope) in self.slopes.chunks_exact_mut(2 * d).enumerate() {
            let t = match self.sigma {
                Sigma::Minus => self.grid.time(index + 1),
                Sigma::Plus => self.grid.time(self.grid.steps() - index - 1),
            };
            let point = index * d..(index + 1) * d;
            v.iter_mut().zip(&velocities[point.clone()]).for_each(|(v, value)| *v = sign * value);
            self.lagrangian.gradient(t, &positions[point], &v, slope);
            slope[d..].iter_mut().for_each(|value| *value *= sign);
        }
    }

    /// r from the first derivatives.
    fn residual(&mut self) -> Vec<f64> {
        let slopes = core::mem::take(&mut self.slopes);
        let residual = self.collect(&slopes);
        self.slopes = slopes;
        residual
    }

    /// b_k + s_k b_N + (Jᵀ a)_k, for `pairs` (a, b) at the points 1…N, d numbers each.
    fn collect(&mut self, pairs: &[f64]) -> Vec<f64> {
        let (d, inner) = (self.coordinates, self.inner_points());
        let mut result: Vec<f64> =
            pairs.chunks_exact(2 * d).take(inner).flat_map(|pair| &pair[..d]).copied().collect();
        self.sum.apply_transposed(&mut result, d);
        let end = &pairs[2 * d * inner + d..];
        for k in 0..inner {
            let row = self.row(k);
            for i in 0..d {
                result[k * d + i] += pairs[2 * d * k + d + i] + row * end[i];
            }
        }
        result
    }

    /// H u.
    fn product(&mut self, unknowns: &[f64]) -> Vec<f64> {
        let (d, inner) = (self.coordinates, self.inner_points());
        let mut positions = vec![0.0; inner * d];
        if self.couples_positions {
            positions.copy_from_slice(unknowns);
            self.sum.apply(&mut positions, d);
        }
        let end: Vec<f64> = (0..d).map(|i| self.along_row(unknowns, i)).collect();
        let mut pairs = vec![0.0; 2 * d * (inner + 1)];
        let mut both = vec![0.0; 2 * d];
        for (k, (pair, curvature)) in
            pairs.chunks_exact_mut(2 * d).zip(self.curvatures.chunks_exact(4 * d * d)).enumerate()
        {
            if k < inner {
                both[..d].copy_from_slice(&positions[k * d..(k + 1) * d]);
                both[d..].copy_from_slice(&unknowns[k * d..(k + 1) * d]);
            } else {
                both[..d].fill(0.0);
                both[d..].copy_from_slice(&end);
            }
            for (entry, row) in pair.iter_mut().zip(curvature.chunks_exact(2 * d)) {
                *entry = minres::inner(row, &both);
            }
        }
        if self.couples_positions {
            return self.collect(&pairs);
        }
        let mut result = Vec::with_capacity(inner * d);
        for k in 0..inner {
            let row = self.row(k);
            result.extend((d..2 * d).map(|i| pairs[2 * d * k + i] + row * pairs[2 * d * inner + i]));
        }
        result
    }

    /// Norm of the sum of magnitudes of the terms of r, and of their changes by rounding the unknowns,
    /// without the rank-d part.
    fn scale(&mut self, unknowns: &[f64]) -> f64 {
        let d = self.coordinates;
        let (positions, velocities) = self.state(unknowns);
        let mut both = vec![0.0; 2 * d];
        let mut pairs = vec![0.0; self.slopes.len()];
        for (k, pair) in pairs.chunks_exact_mut(2 * d).enumerate() {
            let point = k * d..(k + 1) * d;
            both[..d].copy_from_slice(&positions[point.clone()]);
            both[d..].copy_from_slice(&velocities[point]);
            let slopes = &self.slopes[2 * d * k..2 * d * (k + 1)];
            let rows = self.curvatures[4 * d * d * k..4 * d * d * (k + 1)].chunks_exact(2 * d);
            for ((entry, slope), row) in pair.iter_mut().zip(slopes).zip(rows) {
                let propagated: f64 = row.iter().zip(&both).map(|(c, u)| (c * u).abs()).sum();
                *entry = slope.abs() + propagated;
            }
        }
        let sizes: Vec<f64> = self.collect_sizes(&pairs);
        self.preconditioner.diagonal_norm(&sizes)
    }

    /// [`collect`](Self::collect) with |s_k| in place of s_k.
    fn collect_sizes(&mut self, pairs: &[f64]) -> Vec<f64> {
        let (d, inner) = (self.coordinates, self.inner_points());
        let mut flipped = pairs.to_vec();
        for entry in &mut flipped[2 * d * inner + d..] {
            *entry = -*entry;
        }
        self.collect(&flipped)
    }
}

/// Points in the opposite order, each number multiplied by `sign`.
fn reversed(values: &[f64], coordinates: usize, sign: f64) -> Vec<f64> {
    values.chunks_exact(coordinates).rev().flatten().map(|value| sign * value).collect()
}

impl Stationarity for Velocities<'_> {
    fn linearise(&mut self, unknowns: &[f64]) -> Option<Residual> {
        let d = self.coordinates;
        let sign = self.sigma.derivative_sign();
        let (positions, velocities) = self.state(unknowns);
        let mut v = vec![0.0; d];
        for k in 0..self.grid.steps() {
            let point = k * d..(k + 1) * d;
            v.iter_mut().zip(&velocities[point.clone()]).for_each(|(v, value)| *v = sign * value);
            let t = self.time(k + 1);
            let slope = &mut self.slopes[2 * d * k..2 * d * (k + 1)];
            let curvature = &mut self.curvatures[4 * d * d * k..4 * d * d * (k + 1)];
            self.lagrangian.derivatives(t, &positions[point], &v, slope, curvature);
            slope[d..].iter_mut().for_each(|value| *value *= sign);
            for row in 0..d {
                for column in d..2 * d {
                    curvature[row * 2 * d + column] *= sign;
                    curvature[column * 2 * d + row] *= sign;
                }
            }
        }
        let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
        if !(finite(&self.slopes) && finite(&self.curvatures)) {
            return None;
        }
        // The last point's position is fixed: only its velocity counts.
        let by_point = self.curvatures.chunks_exact(4 * d * d).take(self.inner_points());
        self.couples_positions =
            by_point.flat_map(|curvature| curvature.chunks_exact(2 * d).enumerate()).any(|(row, entries)| {
                let relevant = if row < d { entries } else { &entries[..d] };
                relevant.iter().any(|&entry| entry != 0.0)
            });
        self.gradient = self.residual();
        let rows = (0..self.inner_points()).map(|k| self.row(k)).collect();
        self.preconditioner = Preconditioner::new(&self.curvatures, d, rows)?;
        let norm = self.preconditioner.norm(&self.gradient);
        let scale = self.scale(unknowns);
        (norm.is_finite() && scale.is_finite()).then_some(Residual { norm, scale })
    }

    fn norm_at(&mut self, unknowns: &[f64]) -> f64 {
        self.evaluate_slopes(unknowns);
        let residual = self.residual();
        let norm = self.preconditioner.norm(&residual);
        if norm.is_nan() { f64::INFINITY } else { norm }
    }

    fn direction(&mut self) -> Option<Direction> {
        let right_side: Vec<f64> = self.gradient.iter().map(|entry| -entry).collect();
        let limits = Limits { reduction: KRYLOV_REDUCTION, iterations: self.krylov_iterations };
        let preconditioner =
            core::mem::replace(&mut self.preconditioner, Preconditioner::identity(0, self.coordinates));
        let precondition = |residual: &[f64]| preconditioner.solve(residual);
        let solution = minres::solve(&right_side, |u| self.product(u), precondition, limits);
        self.preconditioner = preconditioner;
        (solution.reduction < 1.0)
            .then_some(Direction { step: solution.unknowns, krylov_iterations: solution.iterations })
    }

    fn functional(&mut self) -> Option<&mut dyn Descent> {
        Some(self)
    }
}

impl Descent for Velocities<'_> {
    fn value_at(&mut self, unknowns: &[f64]) -> f64 {
        let d = self.coordinates;
        let sign = self.sigma.derivative_sign();
        let (positions, velocities) = self.state(unknowns);
        let mut v = vec![0.0; d];
        let mut sum = 0.0;
        for (k, (x, velocity)) in positions.chunks_exact(d).zip(velocities.chunks_exact(d)).enumerate() {
            v.iter_mut().zip(velocity).for_each(|(v, value)| *v = sign * value);
            sum += self.lagrangian.value(self.time(k + 1), x, &v);
        }
        if sum.is_nan() { f64::INFINITY } else { sum }
    }

    fn slope(&self, step: &[f64]) -> f64 {
        inner(&self.gradient, step)
    }

    fn steepest(&mut self) -> Vec<f64> {
        self.preconditioner.solve(&self.gradient).iter().map(|entry| -entry).collect()
    }
}

impl Formulation for Velocities<'_> {
    fn unknowns(&self, _positions: &[f64], velocities: &[f64]) -> Vec<f64> {
        let d = self.coordinates;
        let sign = self.sigma.derivative_sign();
        let point = |j: usize| match self.sigma {
            Sigma::Minus => j,
            Sigma::Plus => self.grid.steps() - j,
        };
        (1..self.grid.steps())
            .flat_map(|j| (0..d).map(move |i| (j, i)))
            .map(|(j, i)| sign * velocities[point(j) * d + i])
            .collect()
    }

    fn trajectory(&mut self, unknowns: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let d = self.coordinates;
        let (positions, mut velocities) = self.state(unknowns);
        let mut positions = [self.first.clone(), positions].concat();
        velocities.splice(0..0, vec![0.0; d]);
        if self.sigma == Sigma::Plus {
            positions = reversed(&positions, d, 1.0);
            velocities = reversed(&velocities, d, -1.0);
        }
        (positions, velocities)
    }
}

/// M = |A| + s |A_N| sᵀ, positive definite, and its exact inverse:
/// M⁻¹ = |A|⁻¹ − |A|⁻¹ s K⁻¹ sᵀ |A|⁻¹ with K = |A_N|⁻¹ + Σ_j s_j² |A_j|⁻¹.
struct Preconditioner {
    coordinates: usize,
    /// |A_j|⁻¹ for the inner points, d² numbers each.
    inverses: Vec<f64>,
    rows: Vec<f64>,
    /// K⁻¹.
    capacitance: DMatrix<f64>,
}

impl Preconditioner {
    fn identity(points: usize, coordinates: usize) -> Self {
        let mut inverses = vec![0.0; points.saturating_sub(1) * coordinates * coordinates];
        for block in inverses.chunks_exact_mut(coordinates * coordinates) {
            block.iter_mut().step_by(coordinates + 1).for_each(|entry| *entry = 1.0);
        }
        Self {
            coordinates,
            inverses,
            rows: vec![0.0; points.saturating_sub(1)],
            capacitance: DMatrix::zeros(coordinates, coordinates),
        }
    }

    /// From second derivatives at the points 1…N and the row s.
    fn new(curvatures: &[f64], coordinates: usize, rows: Vec<f64>) -> Option<Self> {
        let d = coordinates;
        let eigen: Vec<_> = curvatures
            .chunks_exact(4 * d * d)
            .map(|curvature| {
                dense::symmetric_eigen(DMatrix::from_fn(d, d, |i, j| curvature[(d + i) * 2 * d + d + j]))
            })
            .collect();
        let largest =
            eigen.iter().flat_map(|eigen| eigen.eigenvalues.iter()).map(|b| b.abs()).fold(0.0, max_or_nan);
        let floor = if largest > 0.0 { LEAST_CURVATURE * largest } else { 1.0 };
        let mut inverses = Vec::with_capacity(eigen.len() * d * d);
        for eigen in &eigen {
            let reciprocal = eigen.eigenvalues.map(|value| 1.0 / value.abs().max(floor));
            let inverse =
                &eigen.eigenvectors * DMatrix::from_diagonal(&reciprocal) * eigen.eigenvectors.transpose();
            inverses.extend_from_slice(inverse.as_slice());
        }
        let end = inverses.split_off(rows.len() * d * d);
        let mut capacitance = DMatrix::from_column_slice(d, d, &end);
        for (inverse, row) in inverses.chunks_exact(d * d).zip(&rows) {
            for (entry, value) in capacitance.iter_mut().zip(inverse) {
                *entry += row * row * value;
            }
        }
        Some(Self { coordinates, inverses, rows, capacitance: dense::inverse(capacitance)? })
    }

    /// |A|⁻¹ r.
    fn diagonal(&self, residual: &[f64]) -> Vec<f64> {
        let d = self.coordinates;
        let mut result = Vec::with_capacity(residual.len());
        for (inverse, part) in self.inverses.chunks_exact(d * d).zip(residual.chunks_exact(d)) {
            result.extend(inverse.chunks_exact(d).map(|row| inner(row, part)));
        }
        result
    }

    fn solve(&self, residual: &[f64]) -> Vec<f64> {
        let d = self.coordinates;
        let mut result = self.diagonal(residual);
        let mut along = DVector::zeros(d);
        for (part, row) in result.chunks_exact(d).zip(&self.rows) {
            for (entry, value) in along.iter_mut().zip(part) {
                *entry += row * value;
            }
        }
        let along = &self.capacitance * along;
        for ((part, inverse), row) in
            result.chunks_exact_mut(d).zip(self.inverses.chunks_exact(d * d)).zip(&self.rows)
        {
            for (entry, coefficients) in part.iter_mut().zip(inverse.chunks_exact(d)) {
                *entry -= row * inner(coefficients, along.as_slice());
            }
        }
        result
    }

    fn norm(&self, residual: &[f64]) -> f64 {
        inner(residual, &self.solve(residual)).max(0.0).sqrt()
    }

    fn diagonal_norm(&self, residual: &[f64]) -> f64 {
        inner(residual, &self.diagonal(residual)).sqrt()
    }
}
