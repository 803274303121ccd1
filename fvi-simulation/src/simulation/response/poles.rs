//! Poles of a damped structure: zeros of its characteristic function, counted and computed.

use branch::{Branch, Chart, Place, nearest, polar};

use crate::simulation::stability::Part;
use crate::simulation::stability::characteristic::log_determinant;
use crate::simulation::stability::winding::{Fineness, turned};
use fvi_core::min_or_nan;
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::transfer::fractions::{Fractions, is_same};
use nalgebra::{Complex, DMatrix};
use std::f64::consts::PI;

mod branch;

/// A matrix of complex numbers.
type ComplexMatrix = DMatrix<Complex<f64>>;

/// A zero of the characteristic function, a motion e^{st} of the structure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SystemPole {
    /// s, with Im s ≥ 0.
    pub place: Complex<f64>,
}

impl SystemPole {
    /// |s|, the angular frequency of the corresponding undamped motion.
    pub fn frequency(&self) -> f64 {
        self.place.norm()
    }

    /// The damping ratio −Re s/|s|.
    pub fn damping(&self) -> f64 {
        -self.place.re / self.place.norm()
    }
}

/// Lower bound of |s| in the search, as a fraction of the largest frequency, which counts up to so many
/// times that of the stiffness, and of the slowest pole of a kernel; where the stiffness asks for more, at
/// most.
const SLOWEST: f64 = 1e-9;
const FASTEST: f64 = 1e3;
const SLOWEST_OF_ALL: f64 = 1e-60;

/// Distance from a kernel's pole, relative to it, within which the kernel is evaluated by its partial
/// fractions: their pole is the one that is multiplied out.
const CLOSE: f64 = 1e-3;

/// Size of a cell, in ln s, below which zeros whose halves cannot be counted are one place.
const ONE_PLACE: f64 = 1e-4;

/// Last correction of a zero, in ln s: the next one of the secant method is of rounding.
const SETTLED: f64 = 1e-9;

/// For a side of a cell.
const FINENESS: Fineness = Fineness { followed: 0.7, parts: 8, halvings: 40 };

/// Largest number of evaluations of the function in a search.
const MOST_VALUES: usize = 4_000_000;

/// The zeros of det(s² + K + Σ ρ_m K_m(s)) of one part on the principal sheet, in the upper half-plane and on
/// the real axis.
///
/// In w = ln s the sheet is a strip. It is divided into cells, whose zeros are counted by the argument
/// principle, until a cell has one zero, which is computed by the secant method. Where no cut lies, zeros and
/// poles may lie on the negative real axis: the strip then extends beyond it. The poles of rational kernels
/// are multiplied out, each as often as its McMillan degree says, so that they cancel no zero. Where a kernel
/// has no bound at the start of its cut, zeros lie closer to it than numbers tell s apart: they are sought in
/// a [`Chart`] of their own.
///
/// # Errors
/// A message, if zeros cannot be separated.
pub(super) fn poles_of(part: &Part, transfers: &[TransferFunction]) -> Result<Vec<SystemPole>, String> {
    let search = Search::new(part, transfers);
    let mut found = search.zeros()?;
    found.retain(|zero| !search.is_taken_out(zero.s));
    let all = found.clone();
    for (index, zero) in found.iter_mut().enumerate() {
        if search.is_real(zero, index, &all) {
            zero.s.im = 0.0;
        }
    }
    found.retain(|zero| zero.s.im >= 0.0);
    Ok(found.into_iter().map(|zero| SystemPole { place: zero.s }).collect())
}

/// True if every pole of a kernel is known, so that zeros beside them are counted.
pub(super) fn is_known(transfer: &TransferFunction) -> bool {
    transfer.fractions().is_some() || transfer.is_relaxation()
}

/// A kernel in the characteristic function.
struct Acting<'a> {
    transfer: &'a TransferFunction,
    rho: &'a DMatrix<f64>,
    fractions: Option<Fractions>,
}

impl Acting<'_> {
    fn value(&self, place: &Place) -> Complex<f64> {
        let Place { s, .. } = *place;
        if let Chart::Beside(branch) = place.chart
            && let Some(start) = self.transfer.unbounded_start()
            && start.place == branch.start
        {
            return start.value(place.coordinate);
        }
        match &self.fractions {
            Some(fractions)
                if fractions.poles.iter().any(|p| (s - p.place).norm() < CLOSE * p.place.norm()) =>
            {
                fractions.value(s) - self.transfer.spring()
            }
            _ => self.transfer.value(s),
        }
    }
}

struct Search<'a> {
    part: &'a Part,
    acting: Vec<Acting<'a>>,
    /// Poles of rational kernels, each with its multiplicity.
    taken_out: Vec<(Complex<f64>, f64)>,
    /// The strip, in ln |s| and the angle, and the surroundings of branch points.
    strip: Vec<Cell>,
    /// ln |s| beyond which the negative real axis is a cut.
    cut: f64,
    /// Depth to which cells are divided whatever their count: the poles of formulas might cancel zeros in it.
    least_depth: u32,
    values: std::cell::Cell<usize>,
}

#[derive(Clone, Copy)]
struct Cell {
    chart: Chart,
    from: (f64, f64),
    to: (f64, f64),
    depth: u32,
}

impl Cell {
    fn size(&self) -> f64 {
        (self.to.0 - self.from.0).max(self.to.1 - self.from.1)
    }

    fn middle(&self) -> Place {
        self.chart.place(Complex::new(0.5 * (self.from.0 + self.to.0), 0.5 * (self.from.1 + self.to.1)))
    }
}

impl<'a> Search<'a> {
    fn new(part: &'a Part, transfers: &'a [TransferFunction]) -> Self {
        let acting: Vec<Acting<'_>> = transfers
            .iter()
            .zip(&part.damping)
            .filter(|(_, rho)| rho.amax() > 0.0)
            .map(|(transfer, rho)| Acting { transfer, rho, fractions: transfer.fractions() })
            .collect();
        // Before a cut the real axis is like any other place.
        let starts = acting.iter().filter_map(|acting| acting.transfer.cut());
        let cut = starts.map(|cut| libm::log(cut.start)).fold(f64::INFINITY, min_or_nan) - 1e-6;
        let is_simple = acting.iter().all(|acting| is_known(acting.transfer));
        let taken_out = poles_with_multiplicity(&acting, part);
        let branches = branches_of(part, &acting);
        let [lowest, highest] = reach(part, &acting, &taken_out, &branches);
        let strip = strip(lowest, highest, cut, &branches);
        let least_depth = if is_simple { 0 } else { 10 };
        Self { part, acting, taken_out, strip, cut, least_depth, values: std::cell::Cell::new(MOST_VALUES) }
    }

    /// Where kernels share a pole up to rounding, what is left of it.
    fn is_taken_out(&self, s: Complex<f64>) -> bool {
        self.taken_out.iter().any(|(place, _)| (s - place).norm() <= 1e-14 * place.norm())
    }

    /// True if a zero is real up to rounding: beside the real axis zeros come in conjugate pairs.
    fn is_real(&self, zero: &Place, index: usize, all: &[Place]) -> bool {
        let s = zero.s;
        if let Chart::Beside(branch) = zero.chart {
            let angle = zero.coordinate.im.abs();
            let conjugate = zero.coordinate.conj();
            let is_other =
                |other: &Place| other.chart == zero.chart && (other.coordinate - conjugate).norm() < angle;
            let others = all.iter().enumerate().filter(|(other, _)| *other != index);
            return angle <= if branch.is_first { 1e-6 } else { 1e-11 }
                && !others.map(|(_, other)| other).any(is_other);
        }
        if s.re < 0.0 && libm::log(s.norm()) >= self.cut {
            return s.im.abs() <= 1e-11 * s.re.abs();
        }
        let has_conjugate = || {
            let others = all.iter().enumerate().filter(|(other, _)| *other != index);
            others.into_iter().any(|(_, other)| (other.s - s.conj()).norm() < s.im.abs())
        };
        s.im.abs() <= 1e-6 * s.re.abs() && !has_conjugate()
    }

    /// A logarithm of the function at a place of the search.
    fn logarithm(&self, place: &Place) -> Option<Complex<f64>> {
        self.values.set(self.values.get().checked_sub(1)?);
        self.logarithm_at(place)
    }

    fn logarithm_at(&self, place: &Place) -> Option<Complex<f64>> {
        let s = place.s;
        let size = self.part.size();
        let mut matrix = vec![Complex::ZERO; size * size];
        let factors: Vec<_> = self.acting.iter().map(|acting| (acting.value(place), acting.rho)).collect();
        for row in 0..size {
            for column in 0..size {
                let mut entry = Complex::new(self.part.stiffness[(row, column)], 0.0);
                if row == column {
                    entry += s * s;
                }
                matrix[row * size + column] =
                    factors.iter().fold(entry, |entry, (factor, rho)| entry + factor * rho[(row, column)]);
            }
        }
        let mut sum = log_determinant(&mut matrix, size)?;
        for &(place, multiplicity) in &self.taken_out {
            let factor = (s - place) / place.norm();
            sum += Complex::new(libm::log(factor.norm()), libm::atan2(factor.im, factor.re)) * multiplicity;
        }
        (sum.re.is_finite() && sum.im.is_finite()).then_some(sum)
    }

    fn zeros(&self) -> Result<Vec<Place>, String> {
        let mut found = Vec::new();
        for &cell in &self.strip {
            let inside = self.zeros_in(cell)?;
            // The whole strip at once is another count than its cells.
            if self.least_depth == 0
                && let Some(count) = self.count(&cell)
                && count != inside.len() as i64
            {
                return Err(format!(
                    "the argument principle counts {count} poles, of which {} were found",
                    inside.len()
                ));
            }
            found.extend(inside.into_iter().filter(|zero| zero.is_of_its_chart()));
        }
        Ok(found)
    }

    fn zeros_in(&self, cell: Cell) -> Result<Vec<Place>, String> {
        let mut found = Vec::new();
        let mut cells = vec![cell];
        while let Some(cell) = cells.pop() {
            let count = self.count(&cell);
            if count == Some(0) && cell.depth >= self.least_depth {
                continue;
            }
            if count == Some(1)
                && cell.size() < 0.3
                && let Some(zero) = self.refine(&cell)
            {
                found.push(zero);
                continue;
            }
            // Zeros that coincide up to rounding are one place with the counted multiplicity; a cell of poles
            // has none.
            let halves = self.halves(cell);
            let is_one_place = cell.size() < 1e-7
                || cell.size() < ONE_PLACE && halves.iter().any(|half| self.count(half).is_none());
            if is_one_place && let Some(count) = count {
                found.extend((0..count.max(0)).map(|_| cell.middle()));
                continue;
            }
            if cell.size() < 1e-7 || self.values.get() == 0 {
                return Err(self.lost(&cell));
            }
            cells.extend(halves);
        }
        Ok(found)
    }

    fn lost(&self, cell: &Cell) -> String {
        let s = cell.middle().s;
        format!("the poles near s = {:.4e} + {:.4e}i cannot be told apart", s.re, s.im)
    }

    /// The halves of a cell across its longer side, cut where no zero lies on the line.
    fn halves(&self, cell: Cell) -> [Cell; 2] {
        let Cell { chart, from, to, depth } = cell;
        let depth = depth + 1;
        let across_x = to.0 - from.0 >= to.1 - from.1;
        let cut = |fraction: f64| {
            if across_x {
                let middle = from.0 + fraction * (to.0 - from.0);
                [
                    Cell { chart, from, to: (middle, to.1), depth },
                    Cell { chart, from: (middle, from.1), to, depth },
                ]
            } else {
                let middle = from.1 + fraction * (to.1 - from.1);
                [
                    Cell { chart, from, to: (to.0, middle), depth },
                    Cell { chart, from: (from.0, middle), to, depth },
                ]
            }
        };
        // Irregular fractions: zeros of undamped structures lie at half the angle.
        let places = [0.4871, 0.5293, 0.4419, 0.5617, 0.3907];
        let good = places.into_iter().map(cut).find(|halves| {
            let [first, _] = halves;
            let line = if across_x {
                ((first.to.0, from.1), (first.to.0, to.1))
            } else {
                ((from.0, first.to.1), (to.0, first.to.1))
            };
            self.turned(chart, line.0, line.1).is_some()
        });
        good.unwrap_or_else(|| cut(0.4871))
    }

    /// Zeros minus poles in a cell; `None` if the phase cannot be followed along its edge.
    fn count(&self, cell: &Cell) -> Option<i64> {
        let Cell { chart, from, to, .. } = *cell;
        let corners = [from, (to.0, from.1), to, (from.0, to.1), from];
        let turned: f64 =
            corners.windows(2).map(|pair| self.turned(chart, pair[0], pair[1])).sum::<Option<f64>>()?;
        let count = (turned / (2.0 * PI)).round();
        ((turned / (2.0 * PI) - count).abs() < 0.1).then_some(count as i64)
    }

    /// The change of the phase of the function along a line.
    ///
    /// Far out the function is like s^d, with d = 2N and the multiplicities of the poles that are multiplied
    /// out: along an arc its size is constant, and its phase turns by d times the angle, which whole turns in
    /// each part would hide.
    fn turned(&self, chart: Chart, from: (f64, f64), to: (f64, f64)) -> Option<f64> {
        let multiplicities: f64 = self.taken_out.iter().map(|(_, multiplicity)| multiplicity).sum();
        let degree = 2.0 * self.part.size() as f64 + multiplicities;
        let parts = (degree * libm::hypot(to.0 - from.0, to.1 - from.1)).ceil() as usize;
        let fineness = Fineness { parts: parts.max(FINENESS.parts), ..FINENESS };
        turned(1.0, &fineness, |part| {
            let (x, y) = (from.0 + part * (to.0 - from.0), from.1 + part * (to.1 - from.1));
            self.logarithm(&chart.place(Complex::new(x, y)))
        })
    }

    /// The zero of a cell by the secant method in its coordinate; `None` if it leads out of the cell.
    fn refine(&self, cell: &Cell) -> Option<Place> {
        let Cell { chart, from, to, .. } = *cell;
        let middle = Complex::new(0.5 * (from.0 + to.0), 0.5 * (from.1 + to.1));
        let reference = self.logarithm_at(&chart.place(middle))?;
        let value = |w: Complex<f64>| match self.logarithm_at(&chart.place(w)) {
            Some(logarithm) => {
                let by = logarithm - reference;
                polar(by.re.min(600.0), by.im)
            }
            None => Complex::ZERO,
        };
        let (mut before, mut now) = (middle + Complex::new(1e-4, 1e-4), middle);
        let (mut value_before, mut value_now) = (value(before), value(now));
        let (mut best, mut settled) = ((now, value_now.norm()), value_now == Complex::ZERO);
        for _ in 0..60 {
            if value_now == Complex::ZERO {
                break;
            }
            let change = value_now * (now - before) / (value_now - value_before);
            if !(change.re.is_finite() && change.im.is_finite()) {
                break;
            }
            (before, value_before) = (now, value_now);
            now -= change;
            let slack = 0.2 * (to.0 - from.0).max(to.1 - from.1);
            let inside = |x: f64, from: f64, to: f64| x > from - slack && x < to + slack;
            if !inside(now.re, from.0, to.0) || !inside(now.im, from.1, to.1) {
                return None;
            }
            value_now = value(now);
            if value_now.norm() < best.1 {
                best = (now, value_now.norm());
            }
            settled |= change.norm() < SETTLED;
            if change.norm() < 1e-15 {
                break;
            }
        }
        let own = |x: f64, from: f64, to: f64| x >= from - 1e-12 && x <= to + 1e-12;
        // Where values are rounding the secant through two of them leads away.
        let place = best.0;
        settled &= own(place.re, from.0, to.0) && own(place.im, from.1, to.1);
        settled.then(|| chart.place(place))
    }
}

/// The cells in which zeros are sought, between two bounds of ln |s|.
fn strip(lowest: f64, highest: f64, cut: f64, branches: &[Branch]) -> Vec<Cell> {
    let (below, above) = (-0.053, PI + 0.061);
    let cell = |from: f64, to: f64, angle: f64| {
        (from < to).then_some(Cell { chart: Chart::Plane, from: (from, below), to: (to, angle), depth: 0 })
    };
    let mut cells = Vec::new();
    let mut from = lowest;
    // Before the first cut the strip extends beyond the negative real axis.
    let first = branches.first().filter(|first| first.is_first);
    let end = first.map_or(cut, |first| libm::log(first.start) - first.reach).min(highest);
    if end > lowest {
        cells.extend(cell(lowest, end, above));
        from = end;
    }
    for branch in branches {
        let middle = libm::log(branch.start);
        cells.extend(cell(from, middle - branch.reach, PI));
        cells.extend(cell(middle - branch.reach, middle + branch.reach, PI - branch.reach));
        from = middle + branch.reach;
        let lowest_angle = if branch.is_first { below } else { 0.0 };
        cells.push(Cell {
            chart: Chart::Beside(*branch),
            from: (branch.nearest, lowest_angle),
            to: (libm::log(2.0 * branch.reach), PI),
            depth: 0,
        });
    }
    cells.extend(cell(from, highest, PI));
    cells
}

/// The branch points where kernels have no bound.
fn branches_of(part: &Part, acting: &[Acting<'_>]) -> Vec<Branch> {
    let first = acting.iter().filter_map(|acting| acting.transfer.cut()).map(|cut| cut.start);
    let first = first.fold(f64::INFINITY, min_or_nan);
    let place = |acting: &Acting<'_>| acting.transfer.unbounded_start().map(|start| start.place);
    let mut starts: Vec<f64> = acting.iter().filter_map(place).collect();
    starts.sort_by(f64::total_cmp);
    starts.dedup();
    let of = |&start: &f64| {
        let others = starts.iter().filter(|&&other| other != start);
        let reach = others.map(|other| 0.2 * (other / start - 1.0).abs()).fold(0.1, min_or_nan);
        let (here, elsewhere): (Vec<_>, Vec<_>) =
            acting.iter().partition(|acting| place(acting) == Some(start));
        // Beside the branch point the rest of the function is what it is there, to a few times.
        let s = Complex::new(-start, 1e-3 * reach * start);
        let of_others = elsewhere.iter().map(|acting| acting.transfer.value(s).norm() * acting.rho.norm());
        let rest = part.stiffness.norm() + start * start + of_others.sum::<f64>();
        let terms =
            here.iter().filter_map(|acting| Some((acting.transfer.unbounded_start()?.power, acting.rho)));
        Branch { start, reach, is_first: start <= first, nearest: nearest(&terms.collect::<Vec<_>>(), rest) }
    };
    starts.iter().map(of).collect()
}

/// Bounds of ln |s|. There are no zeros beyond |s|² = Σ |ρ| |K(s)| + |K|, farther out than all poles,
/// where |s| is doubled as a margin; and none where s² and Σ |ρ| |K(s)| are small against a stiffness.
fn reach(
    part: &Part,
    acting: &[Acting<'_>],
    taken_out: &[(Complex<f64>, f64)],
    branches: &[Branch],
) -> [f64; 2] {
    let angles = [0.0, 0.25 * PI, 0.5 * PI, 0.75 * PI, PI];
    let of = |transfer: &TransferFunction, radius: f64| {
        let sizes = angles.iter().map(|&angle| transfer.value(polar(libm::log(radius), angle)).norm());
        // On the negative real axis K may have a pole.
        sizes.filter(|size| size.is_finite()).reduce(max_or_nan).unwrap_or(f64::INFINITY)
    };
    let damping = |radius: f64| -> f64 {
        acting.iter().map(|acting| acting.rho.norm() * of(acting.transfer, radius)).sum()
    };
    let starts = || branches.iter().map(|branch| branch.start);
    let sizes = || taken_out.iter().map(|(place, _)| place.norm()).chain(starts());
    let mut highest = sizes().fold(1e-12, |most, size| max_or_nan(most, 4.0 * size));
    while highest * highest < 4.0 * (part.stiffness.norm() + damping(highest)) && highest < 1e150 {
        highest *= 2.0;
    }
    // For damping of an order close to 2 the bound above is far beyond all frequencies of the stiffness.
    let stiff = libm::sqrt(part.stiffness.norm());
    let fast = if stiff > 0.0 { min_or_nan(highest, FASTEST * stiff) } else { highest };
    let mut lowest = SLOWEST * sizes().fold(fast, min_or_nan);
    let eigenvalues = fvi_fft::dense::symmetric_eigenvalues(part.stiffness.clone());
    let softest = eigenvalues.iter().map(|value| value.abs()).fold(f64::INFINITY, min_or_nan);
    while softest > 1e-12 * part.stiffness.norm()
        && lowest * lowest + damping(lowest) > 0.25 * softest
        && lowest > SLOWEST_OF_ALL * fast
    {
        lowest *= 0.5;
    }
    [libm::log(lowest), libm::log(highest)]
}

/// The poles of Σ ρ_m K_m, with the McMillan degree of each, the rank of the block Hankel matrix
///
/// ```text
/// [ A₁ A₂ … A_k ; A₂ A₃ … 0 ; … ; A_k 0 … 0 ]
/// ```
///
/// of its Laurent coefficients A_j.
fn poles_with_multiplicity(acting: &[Acting<'_>], part: &Part) -> Vec<(Complex<f64>, f64)> {
    let size = part.size();
    let mut poles: Vec<(Complex<f64>, Vec<ComplexMatrix>, DMatrix<f64>)> = Vec::new();
    for Acting { rho, fractions, .. } in acting {
        for pole in fractions.iter().flat_map(|fractions| &fractions.poles) {
            let index =
                poles.iter().position(|(place, ..)| is_same(*place, pole.place)).unwrap_or_else(|| {
                    poles.push((pole.place, Vec::new(), DMatrix::zeros(size, size)));
                    poles.len() - 1
                });
            let (place, matrices, terms) = &mut poles[index];
            while matrices.len() < pole.coefficients.len() {
                matrices.push(DMatrix::zeros(size, size));
            }
            for (order, (matrix, coefficient)) in matrices.iter_mut().zip(&pole.coefficients).enumerate() {
                *matrix += rho.map(|entry| *coefficient * entry);
                let sizes = rho.map(|entry| (*coefficient * entry).norm());
                *terms += sizes * libm::pow(place.norm(), -(order as f64));
            }
        }
    }
    let counted = |(place, matrices, terms): (Complex<f64>, Vec<ComplexMatrix>, DMatrix<f64>)| {
        let order = matrices.len();
        // In units of the pole, so that the coefficients of all orders are alike, and of what moves each
        // coordinate there, so that those in other units are.
        let unit = place.norm();
        let stiff = |k: usize| {
            let inertia = part.mass.as_ref().map_or(1.0, |mass| mass[(k, k)].abs()) * unit * unit;
            let size = (inertia + part.stiffness[(k, k)].abs() + terms[(k, k)] / unit).sqrt();
            if size > 0.0 { size } else { 1.0 }
        };
        let sizes: Vec<f64> = (0..size).map(stiff).collect();
        let scale = |row: usize, column: usize| 1.0 / (sizes[row] * sizes[column]);
        let hankel = DMatrix::from_fn(order * size, order * size, |row, column| {
            let index = row / size + column / size;
            let scale = libm::pow(unit, -(index as f64)) * scale(row % size, column % size);
            matrices.get(index).map_or(Complex::ZERO, |matrix| matrix[(row % size, column % size)] * scale)
        });
        // Terms that cancel, as those of an entry off the diagonal do on it, leave their rounding errors.
        let largest =
            DMatrix::from_fn(size, size, |row, column| terms[(row, column)] * scale(row, column)).amax();
        (place, rank(hankel, 64.0 * f64::EPSILON * largest) as f64)
    };
    poles.into_iter().map(counted).filter(|(_, multiplicity)| *multiplicity > 0.0).collect()
}

/// The rank of a matrix whose entries have errors up to `error`, by elimination with the largest pivots.
fn rank(mut matrix: ComplexMatrix, error: f64) -> usize {
    let size = matrix.nrows();
    let largest = matrix.iter().map(|entry| entry.norm()).fold(0.0, max_or_nan);
    for step in 0..size {
        let places = (step..size).flat_map(|row| (step..size).map(move |column| (row, column)));
        let pivot = places.max_by(|&a, &b| matrix[a].norm_sqr().total_cmp(&matrix[b].norm_sqr()));
        let Some((row, column)) = pivot.filter(|&place| matrix[place].norm() > error.max(1e-12 * largest))
        else {
            return step;
        };
        matrix.swap_rows(step, row);
        matrix.swap_columns(step, column);
        for row in step + 1..size {
            let factor = matrix[(row, step)] / matrix[(step, step)];
            for column in step..size {
                let above = matrix[(step, column)];
                matrix[(row, column)] -= factor * above;
            }
        }
    }
    size
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::dmatrix;

    fn part(stiffness: f64, rho: &[f64]) -> Part {
        let damping = rho.iter().map(|&rho| dmatrix![rho]).collect();
        Part { mass: None, stiffness: dmatrix![stiffness], resistance: None, damping }
    }

    fn places(part: &Part, transfers: &[TransferFunction]) -> Vec<Complex<f64>> {
        let mut found: Vec<_> = poles_of(part, transfers).unwrap().iter().map(|pole| pole.place).collect();
        found.sort_by(|a, b| a.norm().total_cmp(&b.norm()));
        found
    }

    fn near(found: Complex<f64>, known: Complex<f64>) {
        assert!((found - known).norm() < 1e-12 * known.norm(), "{found} instead of {known}");
    }

    #[test]
    fn a_dashpot_has_the_poles_of_the_textbook() {
        let transfers = [TransferFunction::power(1.0).unwrap()];
        let found = places(&part(4.0, &[0.4]), &transfers);
        assert_eq!(found.len(), 1);
        near(found[0], Complex::new(-0.2, 3.96f64.sqrt()));
        // Overdamped: two on the real axis.
        let found = places(&part(4.0, &[5.0]), &transfers);
        assert_eq!(found.len(), 2);
        near(found[0], Complex::new(-1.0, 0.0));
        near(found[1], Complex::new(-4.0, 0.0));
    }

    #[test]
    fn a_springpot_has_one_pair_that_solves_its_equation() {
        for order in [0.3, 0.5, 1.2, 1.9] {
            let transfers = [TransferFunction::power(order).unwrap()];
            let found = places(&part(2.0, &[0.7]), &transfers);
            assert_eq!(found.len(), 1, "{order}: {found:?}");
            let s = found[0];
            assert!((s * s + 2.0 + s.powf(order) * 0.7).norm() < 1e-13, "{order}: {s}");
            assert!(s.re < 0.0);
        }
        // Close to 2 it acts as a mass, and |s|² = Σ |ρ| |K(s)| lies far beyond all that moves.
        for order in [1.97, 1.99, 1.999] {
            for rho in [1e-2, 1.0, 1e2, 1e4] {
                let found = places(&part(1.0, &[rho]), &[TransferFunction::power(order).unwrap()]);
                assert_eq!(found.len(), 1, "{order}, {rho}: {found:?}");
                assert!(
                    (found[0] * found[0] + 1.0 + found[0].powf(order) * rho).norm() < 1e-12,
                    "{order}, {rho}"
                );
            }
        }
        // s² + s^{1/2}: s^{3/2} = −1, s = e^{2πi/3}.
        let found = places(&part(0.0, &[1.0]), &[TransferFunction::power(0.5).unwrap()]);
        assert_eq!(found.len(), 1);
        near(found[0], Complex::new(-0.5, 0.75f64.sqrt()));
    }

    #[test]
    fn an_oscillator_without_damping_and_one_that_falls() {
        near(places(&part(9.0, &[]), &[])[0], Complex::new(0.0, 3.0));
        let found = places(&part(-9.0, &[]), &[]);
        assert!(found.len() == 2 && found.iter().any(|s| (s - 3.0).norm() < 1e-12), "{found:?}");
    }

    #[test]
    fn prony_series_bring_real_poles() {
        // s² + 1 + 0.5 s/(1 + s): (s² + 1)(1 + s) + 0.5 s = 0.
        let found = places(&part(1.0, &[0.5]), &[TransferFunction::prony(&[1.0], &[1.0]).unwrap()]);
        assert_eq!(found.len(), 2, "{found:?}");
        for s in &found {
            assert!(((s * s + 1.0) * (s + 1.0) + s * 0.5).norm() < 1e-12, "{s}");
        }
        assert_eq!(found.iter().filter(|s| s.im == 0.0).count(), 1);
    }

    fn symbol(text: &str) -> TransferFunction {
        fvi_scenario::scenario::kernel_of_symbol(text).unwrap()
    }

    #[test]
    fn zeros_beside_the_poles_of_kernels_are_found() {
        // A resonator, 0.15 from its pole.
        let kernel = symbol("s^2*0.9728856577525005/(s^2 + 0.5316299786381982*s + 3.2047138700533733)");
        let found = places(&part(1.0, &[1.0]), &[kernel]);
        assert_eq!(found.len(), 2, "{found:?}");
        // Farther out than the springs' frequencies.
        let prony = TransferFunction::prony(&[2.872, 2.849], &[1.0 / 21.4, 1.0 / 17.6]).unwrap();
        let found = places(&part(1.0, &[1.0]), &[prony]);
        assert_eq!(found.len(), 3, "{found:?}");
    }

    #[test]
    fn double_poles_of_a_kernel_and_of_the_system_are_counted() {
        let found = places(&part(1.0, &[0.7]), &[symbol("s^2/(s^2 + 2*s + 1)")]);
        // (s² + 1)(s + 1)² + 0.7 s², whose roots are two pairs.
        assert_eq!(found.len(), 2, "{found:?}");
        for s in found {
            assert!(((s * s + 1.0) * (s + 1.0) * (s + 1.0) + s * s * 0.7).norm() < 1e-11, "{s}");
        }
        let found = places(&part(1.0, &[2.0]), &[TransferFunction::power(1.0).unwrap()]);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found.iter().all(|s| (s + 1.0).norm() < 1e-6), "{found:?}");
    }

    /// v vᵀ s/(s² + 0.8 s + 1.5) with v = (1, w), the entry off the diagonal by sums and differences of the
    /// coordinates, whose terms cancel on it: one pole pair of the kernel, whatever the unit of the second
    /// coordinate is.
    #[test]
    fn a_pole_of_rank_one_is_counted_once_in_any_units() {
        for w in [1.0, 1e3, 1e5, 1e7] {
            let scale = dmatrix![1.0, 0.0; 0.0, 1.0 / (w * 8.0_f64.sqrt())];
            let scaled = |matrix: DMatrix<f64>| &scale * matrix * &scale;
            let part = Part {
                mass: None,
                resistance: None,
                stiffness: dmatrix![4.0, 0.0; 0.0, 3.0],
                damping: vec![
                    scaled(dmatrix![1.0, 0.0; 0.0, 0.0]),
                    scaled(dmatrix![0.5, 0.5; 0.5, 0.5]),
                    scaled(dmatrix![0.5, -0.5; -0.5, 0.5]),
                    scaled(dmatrix![0.0, 0.0; 0.0, 1.0]),
                ],
            };
            let of = |factor: f64| symbol(&format!("{factor:e}*s/(s^2 + 0.8*s + 1.5)"));
            let transfers = [of(1.0), of(w), of(-w), of(w * w)];
            let found = places(&part, &transfers);
            assert_eq!(found.len(), 3, "{w}: {found:?}");
            for s in found {
                let kernel = s / (s * s + s * 0.8 + 1.5);
                let determinant =
                    (s * s + 4.0) * (s * s + 3.0) + kernel * (s * s + 3.0 + (s * s + 4.0) / 8.0);
                assert!(determinant.norm() < 1e-8, "{w}, {s}: {determinant}");
            }
        }
    }

    #[test]
    fn coupled_coordinates_have_as_many_poles() {
        let part = Part {
            mass: None,
            resistance: None,
            stiffness: dmatrix![2.0, -1.0; -1.0, 3.0],
            damping: vec![dmatrix![0.3, 0.0; 0.0, 0.0], dmatrix![0.0, 0.0; 0.0, 0.2]],
        };
        let transfers =
            [TransferFunction::power(0.6).unwrap(), TransferFunction::maxwell(0.5, 0.0, 2.0).unwrap()];
        let found = places(&part, &transfers);
        assert_eq!(found.len(), 2);
        for s in found {
            let (one, other) = (transfers[0].value(s) * 0.3, transfers[1].value(s) * 0.2);
            let determinant = (s * s + 2.0 + one) * (s * s + 3.0 + other) - 1.0;
            assert!(determinant.norm() < 1e-12, "{s}: {determinant}");
        }
    }

    /// Two Prony series with matrices that do not commute, as many coordinates and times as make the function
    /// like s³² and s⁶⁴ far out: against the eigenvalues of the equations of first order, with
    /// ż = v − z/τ for each time τ.
    #[test]
    fn all_poles_of_series_on_matrices_that_do_not_commute_are_found() {
        for (size, times) in [(4, 3), (8, 1), (8, 3), (6, 2)] {
            let wave = |index: usize, turn: f64| libm::cos(1.0 + turn * index as f64);
            let square = |turn: f64, scale: f64| {
                let root = DMatrix::from_fn(size, size, |row, column| wave(row * size + column, turn));
                (&root * root.transpose() + DMatrix::identity(size, size) * 0.5) * scale
            };
            let part = Part {
                mass: None,
                resistance: None,
                stiffness: square(2.1, 1.0),
                damping: vec![
                    square(3.7, 0.05),
                    DMatrix::from_fn(size, size, |row, column| {
                        if row == column { 0.15 + 0.1 * wave(row, 1.3) } else { 0.0 }
                    }),
                ],
            };
            let numbers = |turn: f64| {
                let of = |index: usize| {
                    (1.0 + 0.5 * wave(index + 1, turn), (1.5 * wave(index + 1, turn + 0.7)).exp())
                };
                (0..times).map(of).unzip::<f64, f64, Vec<f64>, Vec<f64>>()
            };
            let series = [numbers(2.3), numbers(3.1)];
            let transfers = series.clone().map(|(g, tau)| TransferFunction::prony(&g, &tau).unwrap());
            let mut first_order = DMatrix::<f64>::zeros(size * (2 + 2 * times), size * (2 + 2 * times));
            let one = DMatrix::<f64>::identity(size, size);
            let mut put = |row: usize, column: usize, block: DMatrix<f64>| {
                first_order.view_mut((row * size, column * size), (size, size)).copy_from(&block);
            };
            put(0, 1, one.clone());
            put(1, 0, -&part.stiffness);
            let of_all = series.iter().zip(&part.damping);
            let relaxing = of_all.flat_map(|((g, tau), rho)| g.iter().zip(tau).map(move |pair| (pair, rho)));
            for (index, ((g, tau), rho)) in relaxing.enumerate() {
                put(1, 2 + index, rho * -*g);
                put(2 + index, 1, one.clone());
                put(2 + index, 2 + index, &one * -tau.recip());
            }
            let known: Vec<_> = first_order.complex_eigenvalues().iter().copied().collect();
            let known: Vec<_> = known.into_iter().filter(|s| s.im >= 0.0).collect();
            let found = places(&part, &transfers);
            assert_eq!(found.len(), known.len(), "{size} coordinates, {times} times");
            for s in found {
                let nearest = known.iter().map(|other| (other - s).norm()).fold(f64::INFINITY, min_or_nan);
                assert!(nearest < 1e-8 * s.norm(), "{size} coordinates, {times} times: {s}, {nearest:e}");
            }
        }
    }
}
