//! Damped modes near a frequency: zeros of the characteristic function in a disc, with their shapes.

use super::{Equations, Linearised};
use crate::simulation::stability::winding::{Fineness, turned_by_slopes};
use fvi_core::{max_or_nan, min_or_nan};
use fvi_fft::dense::{complex_schur, symmetric_eigen};
use fvi_fft::transfer::TransferFunction;
use fvi_sparse::ComplexFactored;
use nalgebra::{Complex, DMatrix, DVector, Dyn, LU};
use std::cell::RefCell;
use std::f64::consts::PI;

/// A motion x e^{st} without a force: (s²M + K + Σ ρ_m K_m(s)) x = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct SystemMode {
    /// s, with Im s > 0.
    pub place: Complex<f64>,
    /// x, a number for each coordinate; the largest is 1.
    pub shape: Vec<Complex<f64>>,
    /// |(s²M + K + Σ ρ_m K_m(s)) x| over the sum of the lengths of its terms.
    pub residual: f64,
    /// Where kernels are tables up to a time T: what tables up to T/2 change of s, relative to |s|.
    pub of_tables: Option<f64>,
}

impl SystemMode {
    /// |s|, the angular frequency of the corresponding undamped motion.
    pub fn frequency(&self) -> f64 {
        self.place.norm()
    }

    /// The damping ratio −Re s/|s|.
    pub fn damping(&self) -> f64 {
        -self.place.re / self.place.norm()
    }
}

/// Largest number of modes at a frequency.
pub const MOST_MODES: usize = 200;

/// Largest part of ω that a disc about iω reaches: it keeps away from the cuts of the kernels.
const LARGEST: f64 = 0.999;

/// What tables up to half their time may change of a mode, relative to |s|.
const OF_TABLES: f64 = 1e-3;

/// Distances from iω whose ratio differs from 1 by less are equal.
const APART: f64 = 1e-6;

/// For the edge of a disc.
const FINENESS: Fineness = Fineness { followed: 0.3, parts: 8, halvings: 22 };

/// The `count` modes nearest to iω, and those that are as near as the last of them; all in |s − iω| < 0.999 ω
/// if there are fewer.
///
/// Undamped modes near ω, of a block Krylov space of (K + Re Σ ρ_m K_m(iω) − σM)⁻¹M, are the starts of
/// Newton's method for T(s) x = 0, T = s²M + K + Σ ρ_m K_m,
///
/// ```text
/// u = T(s)⁻¹ T′(s) x ,    s ← s − xᴴx/xᴴu ,    x ← u/|u| .
/// ```
///
/// The zeros of det T in the disc are then counted by the argument principle. Where there are more than were
/// found, undamped modes near the nearest of them, or the integrals ∮ z^k T⁻¹ dz over the edge of
/// the disc give the starts. Sources: \[GT17\] § 4, \[Beyn12\] for the integrals.
///
/// # Errors
/// A message, if the count differs from what was found, or the kernels do not tell the modes.
pub(super) fn near(
    system: &Linearised,
    omega: f64,
    count: usize,
    stopped: &mut dyn FnMut() -> bool,
) -> Result<Vec<SystemMode>, String> {
    let halved: Vec<Option<TransferFunction>> =
        system.transfers.iter().map(TransferFunction::halved).collect();
    let of_tables = halved.iter().any(Option::is_some).then(|| {
        let whole = halved.into_iter().zip(&system.transfers);
        whole.map(|(half, whole)| half.unwrap_or_else(|| whole.clone())).collect()
    });
    let search = Search {
        system,
        of_tables,
        centre: Complex::new(0.0, omega),
        largest: largest_radius(system, omega),
        stopped: RefCell::new(stopped),
    };
    let mode = |zero: Zero| {
        let residual = system.residual(&system.factors_at(zero.s, &system.transfers), &zero.x);
        let shape = system.coordinates(&zero.x);
        let largest = shape.iter().copied().max_by(|a, b| a.norm().total_cmp(&b.norm()));
        let largest = largest.unwrap_or(Complex::new(1.0, 0.0));
        let shape = shape.into_iter().map(|entry| entry / largest).collect();
        SystemMode { place: zero.s, shape, residual, of_tables: zero.of_tables }
    };
    Ok(search.modes(count)?.into_iter().map(mode).collect())
}

/// A disc has none of the kernels' poles.
fn largest_radius(system: &Linearised, omega: f64) -> f64 {
    let poles =
        system.transfers.iter().filter_map(TransferFunction::fractions).flat_map(|fractions| fractions.poles);
    let distance = |place: Complex<f64>| (place - Complex::new(0.0, omega)).norm();
    LARGEST * poles.map(|pole| distance(pole.place)).fold(omega, min_or_nan)
}

/// A zero with its vector, |x| = 1.
#[derive(Clone, Debug)]
struct Zero {
    s: Complex<f64>,
    x: Vec<Complex<f64>>,
    /// What the first halves of tables change of it.
    of_tables: Option<f64>,
}

struct Search<'a> {
    system: &'a Linearised,
    /// The kernels with the first halves of tables, where there are any.
    of_tables: Option<Vec<TransferFunction>>,
    centre: Complex<f64>,
    /// Largest radius of a disc about it.
    largest: f64,
    stopped: RefCell<&'a mut dyn FnMut() -> bool>,
}

/// A matrix with its factors.
enum Factored<'a> {
    Dense(LU<Complex<f64>, Dyn, Dyn>),
    Sparse(ComplexFactored<'a>),
}

impl Factored<'_> {
    fn solve(&self, vector: &mut [Complex<f64>]) -> Option<()> {
        match self {
            Self::Dense(factors) => {
                let mut column = DVector::from_column_slice(vector);
                factors.solve_mut(&mut column).then_some(())?;
                vector.copy_from_slice(column.as_slice());
            }
            Self::Sparse(factors) => factors.solve(vector).ok()?,
        }
        vector.iter().all(|entry| entry.re.is_finite() && entry.im.is_finite()).then_some(())
    }

    /// ln det on any branch; `None` if it is zero or not finite.
    fn log_determinant(&self) -> Option<Complex<f64>> {
        let logarithm =
            |pivot: &Complex<f64>| Complex::new(libm::log(pivot.norm()), libm::atan2(pivot.im, pivot.re));
        let sum: Complex<f64> = match self {
            Self::Sparse(factors) => factors.pivots().iter().map(logarithm).sum(),
            Self::Dense(factors) => {
                let sum: Complex<f64> = factors.lu_internal().diagonal().iter().map(logarithm).sum();
                let is_odd = factors.p().determinant::<f64>() < 0.0;
                sum + Complex::new(0.0, if is_odd { PI } else { 0.0 })
            }
        };
        (sum.re.is_finite() && sum.im.is_finite()).then_some(sum)
    }
}

impl Linearised {
    /// The factors of M, K, ρ_1, … in T(s).
    fn factors_at(&self, s: Complex<f64>, kernels: &[TransferFunction]) -> Vec<Complex<f64>> {
        let own = [s * s, Complex::new(1.0, 0.0)];
        own.into_iter().chain(kernels.iter().map(|kernel| kernel.value(s))).collect()
    }

    /// Their derivatives; of the kernels by differences, whose error is 10⁻⁸ of them.
    fn slopes_at(&self, s: Complex<f64>, kernels: &[TransferFunction]) -> Vec<Complex<f64>> {
        let by = s * 1e-4;
        let slope = |kernel: &TransferFunction| (kernel.value(s + by) - kernel.value(s - by)) / (by * 2.0);
        [s * 2.0, Complex::ZERO].into_iter().chain(kernels.iter().map(slope)).collect()
    }

    /// a M + k K + Σ r_m ρ_m with its factors; `None` where a factor is not finite, or if it was stopped.
    fn factored(&self, factors: &[Complex<f64>], stopped: &mut dyn FnMut() -> bool) -> Option<Factored<'_>> {
        if stopped() || !factors.iter().all(|factor| factor.re.is_finite() && factor.im.is_finite()) {
            return None;
        }
        match &self.equations {
            Equations::Dense { mass, stiffness, damping } => {
                let matrices = [mass, stiffness].into_iter().chain(damping);
                let mut sum = DMatrix::<Complex<f64>>::zeros(self.size, self.size);
                for (factor, matrix) in factors.iter().zip(matrices) {
                    sum.iter_mut().zip(matrix.iter()).for_each(|(place, entry)| *place += factor * *entry);
                }
                Some(Factored::Dense(sum.lu()))
            }
            Equations::Sparse { pattern, solver, .. } => {
                Some(Factored::Sparse(solver.factored(pattern, self.entries(factors), stopped)?))
            }
        }
    }

    /// The entries of a sum of sparse matrices by the slots of their pattern.
    pub(super) fn entries(&self, factors: &[Complex<f64>]) -> Vec<Complex<f64>> {
        let Equations::Sparse { pattern, slots, .. } = &self.equations else { return Vec::new() };
        let mut values = vec![Complex::ZERO; pattern.len()];
        for (factor, entries) in factors.iter().zip(slots) {
            entries.iter().for_each(|&(slot, entry)| values[slot] += factor * entry);
        }
        values
    }

    /// (a M + k K + Σ r_m ρ_m) x
    fn product(&self, factors: &[Complex<f64>], x: &[Complex<f64>]) -> Vec<Complex<f64>> {
        let mut product = vec![Complex::ZERO; x.len()];
        match &self.equations {
            Equations::Dense { mass, stiffness, damping } => {
                for (factor, matrix) in factors.iter().zip([mass, stiffness].into_iter().chain(damping)) {
                    for (column, number) in x.iter().enumerate() {
                        let by = factor * number;
                        let entries = matrix.column(column);
                        product
                            .iter_mut()
                            .zip(entries.iter())
                            .for_each(|(place, entry)| *place += by * *entry);
                    }
                }
            }
            Equations::Sparse { pattern, .. } => {
                let values = self.entries(factors);
                for (row, slots) in pattern.rows().enumerate() {
                    product[row] = slots.map(|slot| values[slot] * x[pattern.columns()[slot] as usize]).sum();
                }
            }
        }
        product
    }

    fn residual(&self, factors: &[Complex<f64>], x: &[Complex<f64>]) -> f64 {
        let alone = |index: usize| {
            let mut one = vec![Complex::ZERO; factors.len()];
            one[index] = factors[index];
            length(&self.product(&one, x))
        };
        let terms: f64 = (0..factors.len()).map(alone).sum();
        length(&self.product(factors, x)) / terms
    }
}

fn length(x: &[Complex<f64>]) -> f64 {
    x.iter().map(Complex::norm_sqr).sum::<f64>().sqrt()
}

/// xᴴy
fn inner(x: &[Complex<f64>], y: &[Complex<f64>]) -> Complex<f64> {
    x.iter().zip(y).map(|(x, y)| x.conj() * y).sum()
}

fn scaled(x: &mut [Complex<f64>], by: Complex<f64>) {
    x.iter_mut().for_each(|entry| *entry *= by);
}

/// Numbers between −1 and 1 that are the same in every search.
struct Irregular(u64);

impl Irregular {
    fn vector(&mut self, size: usize) -> Vec<Complex<f64>> {
        let mut next = || {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        };
        (0..size).map(|_| Complex::new(next(), 0.0)).collect()
    }
}

impl Search<'_> {
    fn factored(&self, s: Complex<f64>, kernels: &[TransferFunction]) -> Option<Factored<'_>> {
        let factors = self.system.factors_at(s, kernels);
        self.system.factored(&factors, &mut **self.stopped.borrow_mut())
    }

    fn is_stopped(&self) -> bool {
        (self.stopped.borrow_mut())()
    }

    /// Replaces a vector by the solution, of which there are many for one factor.
    fn solved(&self, factored: &Factored, vector: &mut [Complex<f64>]) -> Option<()> {
        (!self.is_stopped()).then(|| factored.solve(vector))?
    }

    fn distance(&self, zero: &Zero) -> f64 {
        (zero.s - self.centre).norm()
    }

    fn modes(&self, count: usize) -> Result<Vec<Zero>, String> {
        let mut zeros = Vec::new();
        for (s, x) in self.undamped(self.centre.im, count + 3) {
            self.add_from(&mut zeros, s, x);
        }
        let mut last = (0, 0);
        for _ in 0..4 {
            zeros.sort_by(|a, b| self.distance(a).total_cmp(&self.distance(b)));
            let mut counted = None;
            for radius in self.radii(&zeros, count) {
                let inside: Vec<Zero> =
                    zeros.iter().filter(|zero| self.distance(zero) < radius).cloned().collect();
                let Some(all) = self.count(self.centre, radius, &zeros) else { continue };
                if all == inside.len() as i64 {
                    return Ok(self.nearest(inside, count));
                }
                last = (all, inside.len());
                counted = usize::try_from(all).ok().map(|all| (radius, all));
            }
            let Some((radius, wanted)) = counted.filter(|(_, all)| *all >= last.1 && *all <= 2 * MOST_MODES)
            else {
                break;
            };
            if let Some(all) = self.complete(&mut zeros, radius, wanted) {
                return Ok(self.nearest(all, count));
            }
        }
        let omega = self.centre.im;
        let of_tables = match &self.of_tables {
            Some(_) => {
                "; a kernel is a table over time, whose end tells nothing of modes that its first half does not tell"
            }
            None => "",
        };
        Err(format!(
            "the argument principle counts {}, of which {} were found; other frequencies or another number of modes may separate \
             them (ω = {omega}){of_tables}",
            last.0, last.1
        ))
    }

    /// The nearest zeros of all in a disc, and those that are as near as the last of them.
    fn nearest(&self, mut zeros: Vec<Zero>, count: usize) -> Vec<Zero> {
        zeros.sort_by(|a, b| self.distance(a).total_cmp(&self.distance(b)));
        if let Some(last) = zeros.get(count - 1).map(|zero| self.distance(zero)) {
            zeros.retain(|zero| self.distance(zero) <= last * (1.0 + APART));
        }
        zeros
    }

    /// Adds the zeros in a disc that undamped modes about the nearest one lead to, as where many lie close
    /// together far from ω, or that integrals over its edge tell; all of them if multiple ones make up their
    /// number.
    fn complete(&self, zeros: &mut Vec<Zero>, radius: f64, wanted: usize) -> Option<Vec<Zero>> {
        if let Some(nearest) = zeros.first().map(|zero| zero.s.im) {
            for (s, x) in self.undamped(nearest, 2 * wanted + 6) {
                self.add_from(zeros, s, x);
            }
            if zeros.iter().filter(|zero| self.distance(zero) < radius).count() >= wanted {
                return None;
            }
        }
        for nodes in [24, 96] {
            for (k, start) in self.starts(radius, wanted, nodes).into_iter().enumerate() {
                // Beside the zero itself, where T has no inverse.
                self.add_from(zeros, start * (1.0 + 1e-6), Irregular(17 + k as u64).vector(self.system.size));
            }
            let inside: Vec<&Zero> = zeros.iter().filter(|zero| self.distance(zero) < radius).collect();
            if inside.len() >= wanted {
                break;
            }
            let multiple = self.with_multiplicity(&inside, radius);
            if multiple.len() == wanted {
                return Some(multiple);
            }
        }
        None
    }

    /// Adds the zero next to a start, unless it is there, or the tables do not tell it.
    fn add_from(&self, zeros: &mut Vec<Zero>, s: Complex<f64>, x: Vec<Complex<f64>>) {
        let Some(mut zero) = self.refine(s, x, &self.system.transfers) else { return };
        if let Some(shorter) = &self.of_tables {
            let other = self.refine(zero.s, zero.x.clone(), shorter);
            let change = other.map_or(f64::INFINITY, |other| (other.s - zero.s).norm() / zero.s.norm());
            let is_told = change < OF_TABLES;
            if !is_told {
                return;
            }
            zero.of_tables = Some(change);
        }
        add(zeros, zero);
    }

    /// The radius of the disc; with tables smaller ones too, as far to the left as there is nothing that the
    /// tables do not tell.
    fn radii(&self, zeros: &[Zero], count: usize) -> Vec<f64> {
        let radius = self.radius(zeros, count);
        let inner = zeros.iter().map(|zero| self.distance(zero)).filter(|distance| *distance < radius);
        let inner = inner.fold(0.0, max_or_nan);
        if self.of_tables.is_none() || inner == 0.0 {
            return vec![radius];
        }
        (0..10).map(|k| inner * 1.02 + (radius - inner * 1.02) * libm::pow(0.6, f64::from(k))).collect()
    }

    /// A radius with the wanted zeros inside, and those that are as far away as the last of them.
    fn radius(&self, zeros: &[Zero], count: usize) -> f64 {
        let distances: Vec<f64> = zeros.iter().map(|zero| self.distance(zero)).collect();
        for at in count..distances.len() {
            let (inner, outer) = (distances[at - 1], min_or_nan(distances[at], self.largest));
            if outer - inner > APART * outer {
                return inner + 0.5 * (outer - inner);
            }
        }
        self.largest
    }

    /// The number of zeros in a disc; `None` if one lies on its edge.
    ///
    /// Those that are known are divided out, of whichever side of the edge: the phase of the rest changes
    /// slowly, and counts what is missing.
    fn count(&self, centre: Complex<f64>, radius: f64, known: &[Zero]) -> Option<i64> {
        let turned = turned_by_slopes(2.0 * PI, &FINENESS, |angle| {
            let s = centre + Complex::new(libm::cos(angle), libm::sin(angle)) * radius;
            let whole = self.factored(s, &self.system.transfers)?.log_determinant()?;
            let factor = |zero: &Zero| {
                let by = s - zero.s;
                Complex::new(libm::log(by.norm()), libm::atan2(by.im, by.re))
            };
            Some(whole - known.iter().map(factor).sum::<Complex<f64>>())
        })?;
        let count = (turned / (2.0 * PI)).round();
        let inside = known.iter().filter(|zero| (zero.s - centre).norm() < radius).count();
        ((turned / (2.0 * PI) - count).abs() < 0.1).then_some(count as i64 + inside as i64)
    }

    /// Zeros as often as the argument principle counts them in small discs of their own.
    fn with_multiplicity(&self, zeros: &[&Zero], radius: f64) -> Vec<Zero> {
        let mut all: Vec<Zero> = Vec::new();
        for (index, zero) in zeros.iter().enumerate() {
            if zeros[..index].iter().any(|other| is_same(other.s, zero.s)) {
                continue;
            }
            let others =
                zeros.iter().filter(|other| !is_same(other.s, zero.s)).map(|other| (other.s - zero.s).norm());
            let apart = 0.1 * others.fold(0.1 * radius, min_or_nan);
            let vectors: Vec<&&Zero> = zeros.iter().filter(|other| is_same(other.s, zero.s)).collect();
            let count =
                self.count(zero.s, apart, &[]).and_then(|count| usize::try_from(count).ok()).unwrap_or(0);
            all.extend((0..count).map(|k| Zero::clone(vectors[k.min(vectors.len() - 1)])));
        }
        all
    }

    /// Newton's method from a place and a vector.
    fn refine(
        &self,
        mut s: Complex<f64>,
        mut x: Vec<Complex<f64>>,
        kernels: &[TransferFunction],
    ) -> Option<Zero> {
        let zero = |s, x| Some(Zero { s, x, of_tables: None });
        const ROUNDS: usize = 40;
        let size = length(&x);
        scaled(&mut x, Complex::new(1.0 / size, 0.0));
        let mut before = f64::INFINITY;
        for _ in 0..ROUNDS {
            let mut u = self.system.product(&self.system.slopes_at(s, kernels), &x);
            let solved = self.factored(s, kernels).and_then(|factored| factored.solve(&mut u));
            if solved.is_none() {
                // At the zero itself to rounding.
                let residual = self.system.residual(&self.system.factors_at(s, kernels), &x);
                return if residual < 1e-10 { zero(s, x) } else { None };
            }
            let change = Complex::new(1.0, 0.0) / inner(&x, &u);
            s -= change;
            let size = length(&u);
            scaled(&mut u, Complex::new(1.0 / size, 0.0));
            x = u;
            let relative = change.norm() / s.norm();
            if !relative.is_finite() || s.im <= 0.0 || (s - self.centre).norm() > 3.0 * self.centre.norm() {
                return None;
            }
            if relative < 4.0 * f64::EPSILON || relative < 1e-10 && relative >= 0.5 * before {
                return zero(s, x);
            }
            before = relative;
        }
        if before < 1e-7 { zero(s, x) } else { None }
    }

    /// Undamped modes near a frequency, with the kernels at the centre; at least `count` if there are as
    /// many.
    fn undamped(&self, omega: f64, count: usize) -> Vec<(Complex<f64>, Vec<Complex<f64>>)> {
        let mut real: Vec<Complex<f64>> = self
            .system
            .factors_at(self.centre, &self.system.transfers)
            .into_iter()
            .map(|factor| Complex::new(factor.re, 0.0))
            .collect();
        real[0] = Complex::new(-omega * omega, 0.0);
        let mass: Vec<Complex<f64>> =
            (0..real.len()).map(|index| Complex::new(f64::from(u8::from(index == 0)), 0.0)).collect();
        // Beside the frequency, which may be one of the undamped modes.
        let shifted = [1.0 - 1.234e-3, 1.0 + 2.71e-3, 1.0 - 7.1e-3].into_iter().find_map(|share| {
            let mut factors = real.clone();
            factors[0] *= share;
            let factored = self.system.factored(&factors, &mut **self.stopped.borrow_mut())?;
            let mut test = Irregular(5).vector(self.system.size);
            factored.solve(&mut test).map(|()| factored)
        });
        let Some(factored) = shifted else { return Vec::new() };
        let basis = krylov(self.system.size, 2 * (count + 10), |x| {
            let mut y = self.system.product(&mass, x);
            self.solved(&factored, &mut y).map(|()| y)
        });
        let mut still = real;
        still[0] = Complex::ZERO;
        self.ritz(&basis, &still, &mass, omega, count)
    }

    /// ω_j² and x_j of K V y = ω² M V y, those with ω_j next to ω first.
    fn ritz(
        &self,
        basis: &[Vec<Complex<f64>>],
        still: &[Complex<f64>],
        mass: &[Complex<f64>],
        omega: f64,
        count: usize,
    ) -> Vec<(Complex<f64>, Vec<Complex<f64>>)> {
        let projected = |factors: &[Complex<f64>]| {
            let mut matrix = DMatrix::zeros(basis.len(), basis.len());
            for (j, x) in basis.iter().enumerate() {
                if self.is_stopped() {
                    return None;
                }
                let product = self.system.product(factors, x);
                for (i, other) in basis[..=j].iter().enumerate() {
                    matrix[(i, j)] = inner(other, &product).re;
                    matrix[(j, i)] = matrix[(i, j)];
                }
            }
            Some(matrix)
        };
        let (Some(stiffness), Some(inertia)) = (projected(still), projected(mass)) else { return Vec::new() };
        let Some(lower) = inertia.cholesky().map(|factors| factors.l()) else { return Vec::new() };
        let Some(inverse) = lower.clone().try_inverse() else { return Vec::new() };
        let eigen = symmetric_eigen(&inverse * stiffness * inverse.transpose());
        let mut order: Vec<usize> = (0..basis.len()).filter(|&k| eigen.eigenvalues[k] > 0.0).collect();
        let off = |k: usize| (eigen.eigenvalues[k].sqrt() - omega).abs();
        order.sort_by(|&a, &b| off(a).total_cmp(&off(b)));
        let start = |k: usize| {
            let weights = inverse.transpose() * eigen.eigenvectors.column(k);
            let mut x = vec![Complex::ZERO; self.system.size];
            for (vector, weight) in basis.iter().zip(weights.iter()) {
                x.iter_mut().zip(vector).for_each(|(place, entry)| *place += entry * *weight);
            }
            (Complex::new(0.0, eigen.eigenvalues[k].sqrt()), x)
        };
        order.into_iter().take(count).map(start).collect()
    }

    /// Eigenvalues of the pencil (A_{i+j+1}), (A_{i+j}), i, j < K, of the moments A_k = ∮ zᵏ T⁻¹V dz in a
    /// disc, with the coordinate z = (s − iω)/r, for a block V of irregular vectors: `wanted` places and a
    /// few to spare, of which one moment tells no more than there are coordinates.
    fn starts(&self, radius: f64, wanted: usize, nodes: usize) -> Vec<Complex<f64>> {
        const SPARE: usize = 6;
        const MOST_BLOCKS: usize = 12;
        let size = self.system.size;
        let columns = (wanted + SPARE).min(size);
        // Of many coordinates a second moment to spare would only be noise.
        let told = if size > SPARE { wanted } else { wanted + SPARE };
        let blocks = told.div_ceil(size.max(1)).clamp(1, MOST_BLOCKS);
        let mut irregular = Irregular(1);
        let block: Vec<_> = (0..columns).map(|_| irregular.vector(size)).collect();
        let mut moments = vec![DMatrix::<Complex<f64>>::zeros(size, columns); 2 * blocks];
        for node in 0..nodes {
            let angle = 2.0 * PI * (node as f64 + 0.5) / nodes as f64;
            let z = Complex::new(libm::cos(angle), libm::sin(angle));
            let Some(factored) = self.factored(self.centre + z * radius, &self.system.transfers) else {
                return Vec::new();
            };
            for (column, vector) in block.iter().enumerate() {
                let mut solution = vector.clone();
                if self.solved(&factored, &mut solution).is_none() {
                    return Vec::new();
                }
                for (row, mut entry) in solution.into_iter().enumerate() {
                    for moment in &mut moments {
                        entry *= z;
                        moment[(row, column)] += entry;
                    }
                }
            }
        }
        let hankel = |from: usize| {
            DMatrix::from_fn(blocks * size, blocks * columns, |row, column| {
                moments[row / size + column / columns + from][(row % size, column % columns)]
            })
        };
        eigenvalues(&hankel(0), &hankel(1))
            .into_iter()
            .filter(|z| z.norm() < 1.2)
            .map(|z| self.centre + z * radius)
            .filter(|s| s.im > 0.0)
            .collect()
    }
}

/// The eigenvalues of A₁ relative to A₀ on the range of A₀.
fn eigenvalues(zeroth: &DMatrix<Complex<f64>>, first: &DMatrix<Complex<f64>>) -> Vec<Complex<f64>> {
    const NOTHING: f64 = 1e-11;
    let Some(parts) = zeroth.clone().try_svd(true, true, 5.0 * f64::EPSILON, 100_000) else {
        return Vec::new();
    };
    let (Some(u), Some(v_t)) = (parts.u, parts.v_t) else { return Vec::new() };
    let largest = parts.singular_values.iter().copied().fold(0.0, max_or_nan);
    let rank = parts.singular_values.iter().filter(|value| **value > NOTHING * largest).count();
    let left = u.columns(0, rank).adjoint() * first;
    let small = left * v_t.rows(0, rank).adjoint();
    let small =
        DMatrix::from_fn(rank, rank, |row, column| small[(row, column)] / parts.singular_values[column]);
    complex_schur(small).map_or_else(Vec::new, |schur| {
        schur.triangular.diagonal().iter().map(|entry| entry * schur.scale).collect()
    })
}

fn is_same(one: Complex<f64>, other: Complex<f64>) -> bool {
    (one - other).norm() < 1e-7 * one.norm()
}

/// Adds a zero unless it is there: places that are the same have vectors of their own.
fn add(zeros: &mut Vec<Zero>, zero: Zero) {
    let mut rest = zero.x.clone();
    let mut own: Vec<Vec<Complex<f64>>> = Vec::new();
    for other in zeros.iter().filter(|other| is_same(other.s, zero.s)) {
        let mut vector = other.x.clone();
        remove(&mut vector, &own);
        let size = length(&vector);
        scaled(&mut vector, Complex::new(1.0 / size, 0.0));
        own.push(vector);
    }
    remove(&mut rest, &own);
    if length(&rest) > 1e-3 {
        zeros.push(zero);
    }
}

/// Takes the parts along orthonormal vectors out of a vector.
fn remove(vector: &mut [Complex<f64>], basis: &[Vec<Complex<f64>>]) {
    for _ in 0..2 {
        for own in basis {
            let part = inner(own, vector);
            vector.iter_mut().zip(own).for_each(|(place, entry)| *place -= part * entry);
        }
    }
}

/// An orthonormal basis of a block Krylov space of two vectors, of at most so many dimensions.
fn krylov(
    size: usize,
    dimensions: usize,
    apply: impl Fn(&[Complex<f64>]) -> Option<Vec<Complex<f64>>>,
) -> Vec<Vec<Complex<f64>>> {
    let mut irregular = Irregular(3);
    let mut basis: Vec<Vec<Complex<f64>>> = Vec::new();
    let mut waiting: std::collections::VecDeque<_> = (0..2).map(|_| irregular.vector(size)).collect();
    while let Some(next) = waiting.pop_front() {
        let Some(mut vector) = apply(&next) else { continue };
        let whole = length(&vector);
        remove(&mut vector, &basis);
        let rest = length(&vector);
        let is_new = rest > 1e-12 * whole;
        if !is_new || basis.len() >= dimensions.min(size) {
            continue;
        }
        scaled(&mut vector, Complex::new(1.0 / rest, 0.0));
        waiting.push_back(vector.clone());
        basis.push(vector);
    }
    basis
}

#[cfg(test)]
mod tests;
