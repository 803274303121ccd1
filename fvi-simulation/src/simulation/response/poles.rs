//! Poles of a damped structure: zeros of its characteristic function, counted and computed.

use crate::numerics::transfer::TransferFunction;
use crate::simulation::stability::Part;
use crate::simulation::stability::characteristic::log_determinant;
use crate::simulation::stability::winding::{Fineness, turned};
use nalgebra::{Complex, DMatrix};
use std::f64::consts::PI;

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

/// Lower bound of |s| in the search, as a fraction of the largest frequency.
const SLOWEST: f64 = 1e-9;

/// For a side of a cell.
const FINENESS: Fineness = Fineness { followed: 0.7, parts: 8, halvings: 40 };

/// Largest number of evaluations of the function in a search.
const MOST_VALUES: usize = 4_000_000;

/// The zeros of det(s² + K + Σ ρ_m K_m(s)) of one part on the principal sheet, in the upper half-plane and on
/// the real axis.
///
/// In w = ln s the sheet is a strip. It is divided into cells, whose zeros are counted by the argument
/// principle, until a cell has one zero, which is computed by the secant method. If no kernel has a cut,
/// zeros and poles may lie on the negative real axis: the strip then extends beyond it, and the poles of
/// Prony series are divided out.
///
/// # Errors
/// A message, if zeros cannot be separated.
pub(super) fn poles_of(part: &Part, transfers: &[TransferFunction]) -> Result<Vec<SystemPole>, String> {
    let search = Search::new(part, transfers);
    let mut found = search.zeros()?;
    found.retain(|s| !search.is_taken_out(*s));
    // Zeros on the real axis up to rounding, and conjugates of zeros found beyond it.
    for s in &mut found {
        if s.im.abs() <= 1e-11 * s.re.abs() {
            s.im = 0.0;
        }
    }
    found.retain(|s| s.im >= 0.0);
    Ok(found.into_iter().map(|place| SystemPole { place }).collect())
}

struct Search<'a> {
    part: &'a Part,
    transfers: Vec<(&'a TransferFunction, &'a DMatrix<f64>)>,
    /// Poles s = −λ of kernels if no kernel has a cut, each with the rank of ρ as its multiplicity.
    taken_out: Vec<(f64, f64)>,
    /// Bounds of ln |s| and of the angle.
    strip: [(f64, f64); 2],
    /// Depth to which cells are divided whatever their count: the poles of formulas might cancel zeros in it.
    least_depth: u32,
    values: std::cell::Cell<usize>,
}

#[derive(Clone, Copy)]
struct Cell {
    from: (f64, f64),
    to: (f64, f64),
    depth: u32,
}

impl<'a> Search<'a> {
    fn new(part: &'a Part, transfers: &'a [TransferFunction]) -> Self {
        let acting: Vec<_> =
            transfers.iter().zip(&part.damping).filter(|(_, rho)| rho.amax() > 0.0).collect();
        let has_cut = acting.iter().any(|(transfer, _)| transfer.cut().is_some());
        let is_simple =
            acting.iter().all(|(transfer, _)| transfer.is_relaxation() && transfer.text().is_none());
        let mut taken_out: Vec<(f64, f64)> = Vec::new();
        for (transfer, rho) in &acting {
            let rank = rank(rho);
            for pole in transfer.poles() {
                match taken_out.iter_mut().find(|(rate, _)| (rate - pole.rate).abs() <= 1e-12 * rate.abs()) {
                    Some((_, known)) => *known = (*known + rank).min(part.size() as f64),
                    None => taken_out.push((pole.rate, rank)),
                }
            }
        }
        // There are no zeros beyond |s|² = Σ |ρ| |K(s)| + |K|; |s| is doubled as a margin.
        let bound = |radius: f64| {
            let angles = [0.0, 0.25 * PI, 0.5 * PI, 0.75 * PI, PI];
            let size = |transfer: &TransferFunction| {
                let sizes =
                    angles.iter().map(|&angle| transfer.value(polar(libm::log(radius), angle)).norm());
                sizes.filter(|size| size.is_finite()).fold(0.0, f64::max)
            };
            part.stiffness.norm()
                + acting.iter().map(|(transfer, rho)| rho.norm() * size(transfer)).sum::<f64>()
        };
        let mut highest = 1e-12;
        while highest * highest < 4.0 * bound(highest) && highest < 1e150 {
            highest *= 2.0;
        }
        let top = libm::log(highest);
        let left = if has_cut { PI } else { PI + 0.061 };
        Self {
            part,
            transfers: acting,
            taken_out,
            strip: [(top + libm::log(SLOWEST), top), (-0.053, left)],
            least_depth: if is_simple { 0 } else { 10 },
            values: std::cell::Cell::new(MOST_VALUES),
        }
    }

    fn is_taken_out(&self, s: Complex<f64>) -> bool {
        self.taken_out.iter().any(|(rate, _)| (s + *rate).norm() <= 1e-7 * rate)
    }

    /// A logarithm of the function at s = e^{x + iy}.
    fn logarithm(&self, x: f64, angle: f64) -> Option<Complex<f64>> {
        self.values.set(self.values.get().checked_sub(1)?);
        self.logarithm_at(polar(x, angle))
    }

    fn logarithm_at(&self, s: Complex<f64>) -> Option<Complex<f64>> {
        let size = self.part.size();
        let mut matrix = vec![Complex::ZERO; size * size];
        let factors: Vec<_> =
            self.transfers.iter().map(|(transfer, rho)| (transfer.value(s), *rho)).collect();
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
        for &(rate, rank) in &self.taken_out {
            let factor = s / rate + 1.0;
            sum += Complex::new(libm::log(factor.norm()), libm::atan2(factor.im, factor.re)) * rank;
        }
        (sum.re.is_finite() && sum.im.is_finite()).then_some(sum)
    }

    fn zeros(&self) -> Result<Vec<Complex<f64>>, String> {
        let [(left, right), (low, high)] = self.strip;
        let mut found = Vec::new();
        let mut cells = vec![Cell { from: (left, low), to: (right, high), depth: 0 }];
        while let Some(cell) = cells.pop() {
            let count = self.count(&cell);
            if count == Some(0) && cell.depth >= self.least_depth {
                continue;
            }
            let (wide, high) = (cell.to.0 - cell.from.0, cell.to.1 - cell.from.1);
            if count == Some(1)
                && wide.max(high) < 0.3
                && let Some(zero) = self.refine(&cell)
            {
                found.push(zero);
                continue;
            }
            if wide.max(high) < 1e-7 {
                // Zeros that coincide up to rounding are one place with the counted multiplicity; a cell of
                // poles has none.
                match count {
                    Some(count) => {
                        let middle = polar(0.5 * (cell.from.0 + cell.to.0), 0.5 * (cell.from.1 + cell.to.1));
                        found.extend((0..count.max(0)).map(|_| middle));
                        continue;
                    }
                    None => return Err(self.lost(&cell)),
                }
            }
            if self.values.get() == 0 {
                return Err(self.lost(&cell));
            }
            cells.extend(self.halves(cell));
        }
        Ok(found)
    }

    fn lost(&self, cell: &Cell) -> String {
        let s = polar(0.5 * (cell.from.0 + cell.to.0), 0.5 * (cell.from.1 + cell.to.1));
        format!("the poles near s = {:.4e} + {:.4e}i cannot be told apart", s.re, s.im)
    }

    /// The halves of a cell across its longer side, cut where no zero lies on the line.
    fn halves(&self, cell: Cell) -> [Cell; 2] {
        let Cell { from, to, depth } = cell;
        let depth = depth + 1;
        let across_x = to.0 - from.0 >= to.1 - from.1;
        let cut = |fraction: f64| {
            if across_x {
                let middle = from.0 + fraction * (to.0 - from.0);
                [Cell { from, to: (middle, to.1), depth }, Cell { from: (middle, from.1), to, depth }]
            } else {
                let middle = from.1 + fraction * (to.1 - from.1);
                [Cell { from, to: (to.0, middle), depth }, Cell { from: (from.0, middle), to, depth }]
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
            self.turned(line.0, line.1).is_some()
        });
        good.unwrap_or_else(|| cut(0.4871))
    }

    /// Zeros minus poles in a cell; `None` if the phase cannot be followed along its edge.
    fn count(&self, cell: &Cell) -> Option<i64> {
        let Cell { from, to, .. } = *cell;
        let corners = [from, (to.0, from.1), to, (from.0, to.1), from];
        let turned: f64 =
            corners.windows(2).map(|pair| self.turned(pair[0], pair[1])).sum::<Option<f64>>()?;
        let count = (turned / (2.0 * PI)).round();
        ((turned / (2.0 * PI) - count).abs() < 0.1).then_some(count as i64)
    }

    /// The change of the phase of the function along a line.
    fn turned(&self, from: (f64, f64), to: (f64, f64)) -> Option<f64> {
        turned(1.0, &FINENESS, |part| {
            let (x, y) = (from.0 + part * (to.0 - from.0), from.1 + part * (to.1 - from.1));
            self.logarithm(x, y)
        })
    }

    /// The zero of a cell by the secant method in ln s; `None` if it leads out of the cell.
    fn refine(&self, cell: &Cell) -> Option<Complex<f64>> {
        let Cell { from, to, .. } = *cell;
        let middle = Complex::new(0.5 * (from.0 + to.0), 0.5 * (from.1 + to.1));
        let reference = self.logarithm_at(polar(middle.re, middle.im))?;
        let value = |w: Complex<f64>| match self.logarithm_at(polar(w.re, w.im)) {
            Some(logarithm) => {
                let by = logarithm - reference;
                polar(by.re.min(600.0), by.im)
            }
            None => Complex::ZERO,
        };
        let (mut before, mut now) = (middle + Complex::new(1e-4, 1e-4), middle);
        let (mut value_before, mut value_now) = (value(before), value(now));
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
            if change.norm() < 1e-15 {
                break;
            }
        }
        let own = |x: f64, from: f64, to: f64| x >= from - 1e-12 && x <= to + 1e-12;
        let settled = (now - before).norm() < 1e-9 && own(now.re, from.0, to.0) && own(now.im, from.1, to.1);
        settled.then(|| polar(now.re, now.im))
    }
}

fn rank(rho: &DMatrix<f64>) -> f64 {
    let eigenvalues = crate::numerics::dense::symmetric_eigenvalues(rho.clone());
    let threshold = 1e-12 * eigenvalues.amax();
    eigenvalues.iter().filter(|value| value.abs() > threshold).count() as f64
}

/// e^{x + iy}; at y = π on the upper side of the negative real axis.
fn polar(x: f64, angle: f64) -> Complex<f64> {
    let size = libm::exp(x);
    if angle == PI {
        return Complex::new(-size, 0.0);
    }
    Complex::new(size * libm::cos(angle), size * libm::sin(angle))
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
}
