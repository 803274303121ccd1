//! Relaxation functions given by rows of time and modulus.

use crate::real_transforms;
use crate::transfer::algebra::{Algebra, Series};
use crate::transfer::multistep_rule::MultistepRule;
use crate::transfer::polynomial::polynomial;
use crate::transfer::{Active, Formula, Passivity};
use fvi_core::{BdfOrder, min_or_nan};
use nalgebra::Complex;
use std::f64::consts::PI;

/// K(s) = s Ĝ(s) of a relaxation function G: the force ∫ G(t − τ) q̇(τ) dτ.
///
/// G is linear between its rows, and G(T) e^{−(t−T)/τ} after the last one, at T:
///
/// ```text
/// K(s) = G(0) + Σ_i m_i (e^{−s t_i} − e^{−s t_{i+1}})/s − G(T) e^{−sT} / (1 + τ s) ,
/// ```
///
/// m_i the slopes. Units: those of G. Source: \[Mainardi10\].
#[derive(Debug)]
pub struct Relaxation {
    name: String,
    /// t and G, one after the other.
    rows: Vec<f64>,
    decay: Option<f64>,
    /// Δ, if t_i = iΔ to rounding.
    spacing: Option<f64>,
    /// True if the kernel is an entry of a matrix, for which passivity is a property of the whole.
    part: bool,
    /// Up to which tolerances the rows were amended, by their names in files, and sentences on how.
    tolerances: Vec<(&'static str, f64)>,
    notes: Vec<String>,
}

/// Name of the form in files.
pub(super) const FORM: &str = "relaxation";

/// Number of rows from which weights come from one transform, with errors relative to the first weight, in
/// place of a power series for every row, with errors relative to each weight.
const MANY: usize = 65;

/// Number of weights below which those of a long table, too, are a power series: a transform costs the same
/// for a few as for all.
const FEW: usize = 8;

/// −ln of what a sum leaves out, relative to its largest terms.
const NOTHING: f64 = 50.0;

impl Relaxation {
    /// From rows (t, G) with ascending t from 0, of a file of this name, continued with the time constant
    /// `decay`; without one, G is zero after them.
    pub fn new(name: &str, rows: &[(f64, f64)], decay: Option<f64>) -> Self {
        let spacing = equal_spacing(rows);
        let rows = rows.iter().flat_map(|&(time, modulus)| [time, modulus]).collect();
        Self {
            name: name.to_owned(),
            rows,
            decay,
            spacing,
            part: false,
            tolerances: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// The same with the tolerances up to which its rows were amended, and sentences on how.
    #[doc(hidden)]
    pub fn amended(self, tolerances: Vec<(&'static str, f64)>, notes: Vec<String>) -> Self {
        Self { tolerances, notes, ..self }
    }

    /// The same as an entry of a matrix: its passivity is not checked by itself.
    pub fn of_matrix(self) -> Self {
        Self { part: true, ..self }
    }

    fn row(&self, index: usize) -> (f64, f64) {
        (self.rows[2 * index], self.rows[2 * index + 1])
    }

    fn count(&self) -> usize {
        self.rows.len() / 2
    }

    fn last(&self) -> (f64, f64) {
        self.row(self.count() - 1)
    }

    /// (t_i, t_{i+1} − t_i, m_i)
    fn pieces(&self) -> impl Iterator<Item = (f64, f64, f64)> + '_ {
        (1..self.count()).map(|index| {
            let ((begin, from), (end, to)) = (self.row(index - 1), self.row(index));
            (begin, end - begin, (to - from) / (end - begin))
        })
    }

    /// True if G falls, is convex, and ends at or above zero: then it is passive (Pólya).
    fn is_convex(&self) -> bool {
        let (_, end) = self.last();
        let after = self.decay.map_or(0.0, |decay| -end / decay);
        let slopes: Vec<f64> = self.pieces().map(|(.., slope)| slope).chain([after]).collect();
        // A step down to zero after the last row is not convex.
        let ends = end == 0.0 || (end > 0.0 && self.decay.is_some());
        ends && slopes.is_sorted() && slopes.last().is_none_or(|&slope| slope <= 0.0)
    }
}

impl Relaxation {
    /// Σ m_i ∫ e^{−st} dt over the pieces, m_i Δ_i (1 − e^{−x})/x e^{−s t_i} with x = s Δ_i, at each place s.
    /// With equal spacing the exponentials are powers of one, and the sum is a polynomial in it.
    fn pieces_at(&self, places: &[Complex<f64>]) -> Vec<Complex<f64>> {
        let Some(spacing) = self.spacing else {
            let sum = |&s: &Complex<f64>| {
                self.pieces()
                    .take_while(|(begin, ..)| s.re * begin < NOTHING)
                    .map(|(begin, length, slope)| {
                        (s * -begin).exponential() * mean(s * length) * (slope * length)
                    })
                    .sum()
            };
            return places.iter().map(sum).collect();
        };
        let pieces = self.count() - 1;
        let power = |s: &Complex<f64>| {
            let x = s * spacing;
            let reach = if x.re > 0.0 { (NOTHING / x.re).ceil().min(pieces as f64) as usize } else { pieces };
            ((-x).exponential(), reach)
        };
        let powers: Vec<(Complex<f64>, usize)> = places.iter().map(power).collect();
        let sums = polynomial(|index| self.row(index + 1).1 - self.row(index).1, &powers);
        sums.into_iter().zip(places).map(|(sum, s)| sum * mean(s * spacing)).collect()
    }

    /// The factor 1/(1 + τs) of what follows the last row, and its e^{−sT}, whose sum with the pieces is K.
    fn tail_at(&self, s: Complex<f64>) -> Complex<f64> {
        let (end, modulus) = self.last();
        (s * -end).exponential() * modulus
    }

    /// The weights of BDF 1 and 2 of all lags up to `count`, to rounding of the first one.
    ///
    /// Without the factor of the decay K is an entire function, which on |z| = 1, where Re γ ≥ 0, has values
    /// of the size of G: the weights are its Fourier coefficients, on so many points that what lies beyond
    /// has decayed. The factor is applied by a recursion for the coefficients,
    ///
    /// ```text
    /// (1 + τ γ(z)/h) Σ u_n zⁿ = Σ v_n zⁿ .
    /// ```
    fn weights_of_transform(&self, order: BdfOrder, step_size: f64, count: usize) -> Vec<f64> {
        let rule = MultistepRule::Bdf(order);
        let reach = reach(order.get(), self.last().0 / step_size);
        let length = reach.next_power_of_two();
        let places: Vec<Complex<f64>> = (0..=length / 2)
            .map(|k| rule.on_circle(-2.0 * PI * k as f64 / length as f64) / step_size)
            .collect();
        let coefficients = |mut values: Vec<Complex<f64>>| {
            // Real for real z, without rounding errors of the imaginary part.
            for end in [0, length / 2] {
                values[end].im = 0.0;
            }
            let mut weights = vec![0.0; length];
            if real_transforms(length).1.process(&mut values, &mut weights).is_err() {
                return vec![f64::NAN; count];
            }
            weights.iter_mut().for_each(|weight| *weight /= length as f64);
            weights.resize(reach, 0.0);
            weights.resize(count, 0.0);
            weights
        };
        let mut head = self.pieces_at(&places);
        head.iter_mut().for_each(|value| *value += self.row(0).1);
        let tail: Vec<Complex<f64>> = places.iter().map(|&s| self.tail_at(s)).collect();
        let Some(decay) = self.decay else {
            head.iter_mut().zip(tail).for_each(|(value, tail)| *value -= tail);
            return coefficients(head);
        };
        let (mut weights, mut tail) = (coefficients(head), coefficients(tail));
        let ratio = decay / step_size;
        let gamma: Vec<f64> = order
            .coefficients()
            .iter()
            .take(order.get() + 1)
            .map(|coefficient| ratio * coefficient)
            .collect();
        for n in 0..count {
            let known: f64 = (1..gamma.len().min(n + 1)).map(|k| gamma[k] * tail[n - k]).sum();
            tail[n] = (tail[n] - known) / (1.0 + gamma[0]);
            weights[n] -= tail[n];
        }
        weights
    }
}

/// (1 − e^{−x})/x
fn mean(x: Complex<f64>) -> Complex<f64> {
    let one = Complex::new(1.0, 0.0);
    if x.norm() < 1e-2 {
        (1..8).rev().fold(one, |sum, n| one - x * sum / f64::from(n + 1))
    } else {
        (one - (-x).exponential()) / x
    }
}

/// Δ, if all times are its multiples to rounding.
fn equal_spacing(rows: &[(f64, f64)]) -> Option<f64> {
    let pieces = rows.len().checked_sub(1).filter(|&pieces| pieces > 0)?;
    let end = rows[pieces].0;
    let spacing = end / pieces as f64;
    let are_equal = rows
        .iter()
        .enumerate()
        .all(|(index, &(time, _))| (time - index as f64 * spacing).abs() <= 4.0 * f64::EPSILON * end);
    are_equal.then_some(spacing)
}

/// Number of weights of e^{−λγ(z)} by BDF 1 or 2 beyond which all are nothing beside the largest: on |z| = r
/// > 1 it is at most e^{λ(r−1)}, or e^{λ(r²−1)/2}, and the n-th weight at most r⁻ⁿ of that.
fn reach(order: usize, delay: f64) -> usize {
    let most = |growth: f64| {
        let exponent = if order == 1 { libm::expm1(growth) } else { 0.5 * libm::expm1(2.0 * growth) };
        (NOTHING + delay * exponent) / growth
    };
    let places = (0..60).map(|k| most(libm::exp2(-0.25 * f64::from(k)) * 4.0));
    places.fold(f64::INFINITY, min_or_nan).ceil() as usize + 2
}

/// Frequencies at which the passivity of tables is looked at.
#[derive(Clone, Copy, Debug)]
pub struct Frequencies {
    /// T
    longest: f64,
    /// Smallest difference of times.
    shortest: f64,
    /// True if the times of all tables are multiples of one Δ.
    has_spacing: bool,
    /// True if in addition G is zero at their ends.
    is_periodic: bool,
    /// Number of rows.
    rows: usize,
}

impl Frequencies {
    /// Those of tables, t and G one after the other.
    pub fn of<'t>(tables: impl Iterator<Item = &'t [f64]>) -> Self {
        let mut made =
            Self { longest: 0.0, shortest: f64::INFINITY, has_spacing: true, is_periodic: true, rows: 0 };
        let mut spacings = Vec::new();
        for table in tables {
            let rows: Vec<(f64, f64)> = table.chunks_exact(2).map(|row| (row[0], row[1])).collect();
            let Some(&(end, modulus)) = rows.last() else { continue };
            made.longest = made.longest.max(end);
            let lengths = rows.windows(2).map(|pair| pair[1].0 - pair[0].0);
            made.shortest = lengths.fold(made.shortest, min_or_nan);
            made.is_periodic &= modulus == 0.0;
            made.rows += rows.len();
            spacings.push(equal_spacing(&rows));
        }
        let first = spacings.first().copied().flatten();
        made.has_spacing = first.is_some_and(|first| {
            let alike = |spacing: f64| (spacing - first).abs() <= 1e-12 * first;
            spacings.iter().all(|spacing| spacing.is_some_and(alike))
        });
        made.is_periodic &= made.has_spacing;
        made
    }

    /// The places. Re K(iω)/(iω) ω² of rows at multiples of Δ has the period 2π/Δ, so that nothing new
    /// follows above π/Δ; it varies with ω like cos ωT. Below 1/T, and where the rows are not equidistant and
    /// there would be too many places, forty per decade are looked at.
    fn places(&self) -> Vec<f64> {
        const PER_DECADE: f64 = 40.0;
        // Places to a period of cos ωT.
        const PER_PERIOD: f64 = 8.0;
        // Exponentials, where each row takes one at every place.
        const MOST: usize = 1_000_000;
        let end = if self.is_periodic { PI / self.shortest } else { 100.0 * PI / self.shortest };
        let (dense, most) = if self.has_spacing {
            (2.0 * PI / self.shortest, usize::MAX)
        } else {
            (end, MOST / self.rows.max(1))
        };
        let apart = 2.0 * PI / (PER_PERIOD * self.longest);
        let mut places = Vec::new();
        let mut place = 0.01 / self.longest;
        while place < end {
            places.push(place);
            let next = place * libm::exp10(1.0 / PER_DECADE);
            place = if place < dense && places.len() < most { next.min(place + apart) } else { next };
        }
        places.push(end);
        places
    }

    /// The lowest band of frequencies at which Re R/|R| for R = K(iω)/(iω), which `resistances` returns for
    /// each ω, is below zero.
    pub fn look_for_activity(&self, resistances: impl Fn(&[f64]) -> Vec<f64>) -> Option<Active> {
        // Rounding error of sums over many rows.
        const ROUNDING: f64 = -1e-9;
        if self.longest == 0.0 {
            return None;
        }
        let resistance = |omega: f64| resistances(&[omega]).into_iter().sum::<f64>();
        // Several at a time, but not the values of all.
        let places = self.places();
        let found = places.chunks(64).flat_map(&resistances);
        let mut looks: Vec<(f64, f64)> = places.iter().copied().zip(found).collect();
        let mut grounds = Vec::new();
        for looks in looks.windows(3) {
            let [before, here, after] = [looks[0].1, looks[1].1, looks[2].1];
            // Between the places the ground is at most as deep as twice the parabola through them.
            let depth = (before - here).max(after - here);
            if here <= before && here <= after && here >= ROUNDING && here - depth < ROUNDING {
                // A minimum: golden-section search.
                let (mut low, mut high) = (looks[0].0, looks[2].0);
                for _ in 0..16 {
                    let (left, right) = (high - 0.618 * (high - low), low + 0.618 * (high - low));
                    if resistance(left) < resistance(right) { high = right } else { low = left }
                }
                grounds.push((0.5 * (low + high), resistance(0.5 * (low + high))));
            }
        }
        looks.extend(grounds);
        looks.sort_by(|one, other| one.0.total_cmp(&other.0));
        let drives = |look: &(f64, f64)| look.1 < ROUNDING;
        let begin = looks.iter().position(drives)?;
        let end = looks[begin..].iter().take_while(|look| drives(look)).count() + begin;
        // Bisection between a place that is not passive and one that is.
        let edge = |mut inside: f64, mut outside: f64| {
            for _ in 0..40 {
                let middle = 0.5 * (inside + outside);
                if resistance(middle) < ROUNDING { inside = middle } else { outside = middle }
            }
            inside
        };
        let worst = looks[begin..end].iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
        Some(Active {
            place: Complex::new(0.0, worst.0),
            resistance: worst.1,
            from: (begin > 0).then(|| edge(looks[begin].0, looks[begin - 1].0)),
            to: looks.get(end).map(|beyond| edge(looks[end - 1].0, beyond.0)),
        })
    }
}

impl Formula for Relaxation {
    fn value(&self, s: Complex<f64>) -> Complex<f64> {
        self.values(&[s]).into_iter().sum()
    }

    fn values(&self, places: &[Complex<f64>]) -> Vec<Complex<f64>> {
        let with_tail = |(pieces, &s): (Complex<f64>, &Complex<f64>)| {
            let tail = self.tail_at(s);
            let tail = self.decay.map_or(tail, |decay| tail / (s * decay + 1.0));
            let sum = pieces + self.row(0).1 - tail;
            // Far to the left the exponentials overflow.
            if sum.re.is_finite() && sum.im.is_finite() { sum } else { Complex::new(f64::NAN, f64::NAN) }
        };
        self.pieces_at(places).into_iter().zip(places).map(with_tail).collect()
    }

    fn series(&self, s: &Series) -> Series {
        let at = |time: f64| s.scale(-time).exponential();
        let (end, modulus) = self.last();
        let tail = at(end).scale(modulus);
        let tail = match self.decay {
            Some(decay) => tail.divide(&s.scale(decay).add(&s.constant(1.0))),
            None => tail,
        };
        let mut sum = s.constant(self.row(0).1).add(&tail.negate());
        let mut begin = at(0.0);
        let mut pieces = s.constant(0.0);
        for (from, length, slope) in self.pieces() {
            let end = at(from + length);
            pieces = pieces.add(&begin.add(&end.negate()).scale(slope));
            begin = end;
        }
        sum = sum.add(&pieces.divide(s));
        sum
    }

    fn text(&self) -> &str {
        &self.name
    }

    fn form(&self) -> &'static str {
        FORM
    }

    fn parameters(&self) -> Vec<(&'static str, f64)> {
        self.decay.map(|decay| ("decay", decay)).into_iter().chain(self.tolerances.iter().copied()).collect()
    }

    fn numbers(&self) -> &[f64] {
        &self.rows
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn passivity(&self) -> Passivity {
        if self.part || self.is_convex() {
            return Passivity::Passive;
        }
        let resistances = |omegas: &[f64]| {
            let places: Vec<Complex<f64>> = omegas.iter().map(|&omega| Complex::new(0.0, omega)).collect();
            self.values(&places).into_iter().map(|value| value.im / value.norm()).collect()
        };
        let frequencies = Frequencies::of(std::iter::once(self.rows.as_slice()));
        match frequencies.look_for_activity(resistances) {
            Some(active) => Passivity::Active(active),
            None => Passivity::Passive,
        }
    }

    fn weights(&self, rule: MultistepRule, step_size: f64, count: usize) -> Option<Vec<f64>> {
        let MultistepRule::Bdf(order) = rule else { return None };
        let is_many = self.count() >= MANY && count >= FEW && rule.is_passive();
        is_many.then(|| self.weights_of_transform(order, step_size, count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quadrature::multistep_weights::multistep_weights;
    use crate::transfer::TransferFunction;
    use fvi_core::DoubleDouble;
    use std::sync::Arc;

    #[test]
    fn a_ramp_has_its_transform() {
        // G = 1 − t/2 to t = 2: K = 1 − (1 − e^{−2s})/(2s).
        let ramp = Relaxation::new("ramp", &[(0.0, 1.0), (0.5, 0.75), (2.0, 0.0)], None);
        for s in [Complex::new(0.3, 0.0), Complex::new(0.0, 2.0), Complex::new(1e-6, 1e-7)] {
            let direct =
                Complex::new(1.0, 0.0) - (Complex::new(1.0, 0.0) - (s * -2.0).exponential()) / (s * 2.0);
            assert!((ramp.value(s) - direct).norm() < 2e-10, "{s}");
        }
        assert_eq!(ramp.passivity(), Passivity::Passive);
        let step = Relaxation::new("step", &[(0.0, 1.0), (2.0, 0.5)], None);
        assert!(matches!(step.passivity(), Passivity::Active(_)));
    }

    #[test]
    fn rows_of_an_exponential_relax_like_a_maxwell_element() {
        // Linear between 4000 rows of e^{−t}, to 3e−7 of it.
        let rows: Vec<(f64, f64)> =
            (0..4001).map(|k| f64::from(k) * 2.5e-3).map(|t| (t, (-t).exp())).collect();
        let measured = Relaxation::new("measured", &rows, Some(1.0));
        assert_eq!(measured.passivity(), Passivity::Passive);
        let measured = TransferFunction::formula(Arc::new(measured)).unwrap();
        let maxwell = TransferFunction::prony(&[1.0], &[1.0]).unwrap();
        let order = BdfOrder::new(2).unwrap();
        let weights =
            |of: &TransferFunction, count| multistep_weights(of, order, 0.05, false, count).unwrap();
        // By the series, and by the transform for later weights.
        for count in [60, 700] {
            for (a, b) in weights(&measured, count).iter().zip(weights(&maxwell, count)) {
                assert!((a - b).abs() < 1e-6, "{a} {b}");
            }
        }
        assert_eq!(measured.active(), None);
    }

    #[test]
    fn weights_at_the_delay_of_many_steps_are_those_of_short_tables() {
        // K(0) = 0 is the sum of all weights. e^{−4γ(0)/h} is e^{−768} at the shortest step.
        let rows = [(0.0, 1.0), (1.0, 0.25), (2.0, -0.1), (3.0, 0.03), (4.0, 0.0)];
        let transfer = TransferFunction::formula(Arc::new(Relaxation::new("rows", &rows, None))).unwrap();
        for order in [1, 2] {
            for (step, count) in [(1.0 / 64.0, 511), (1.0 / 128.0, 1600), (1.0 / 300.0, 3000)] {
                let order = BdfOrder::new(order).unwrap();
                let weights = multistep_weights(&transfer, order, step, false, count).unwrap();
                let sum: f64 = weights.iter().sum();
                assert!(sum.abs() < 1e-12, "{order:?}, h = {step}: {sum:e}");
            }
        }
    }

    #[test]
    fn tables_of_many_rows_have_the_weights_of_their_series() {
        // An impulse response of waves: it swings, and its last row is not zero.
        let wave = |t: f64| libm::exp(-0.4 * t) * libm::cos(1.5 * t);
        let rows = |every: f64| -> Vec<(f64, f64)> {
            (0..120)
                .map(|k| f64::from(k) * 0.1)
                .map(|t| t * (1.0 + every * t))
                .map(|t| (t, wave(t)))
                .collect()
        };
        for (spacing, decay) in [(0.0, None), (0.0, Some(2.0)), (0.01, None), (0.01, Some(0.3))] {
            let table = Relaxation::new("wave", &rows(spacing), decay);
            for order in [1, 2] {
                let rule = MultistepRule::Bdf(BdfOrder::new(order).unwrap());
                for step in [0.025, 0.07] {
                    let found = table.weights(rule, step, 700).unwrap();
                    let known = table.series(&rule.series(step, 700)).to_numbers();
                    for (n, (found, known)) in found.iter().zip(&known).enumerate() {
                        assert!(
                            (found - known).abs() < 4e-16,
                            "{order}, h = {step}, {n}: {found:e} {known:e}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn where_a_table_drives_is_found_at_every_frequency_of_its_rows() {
        // Re Ĝ ω² = −Σ c_i cos ω t_i: a notch in one row of a convex table, of the second difference −2η.
        let table = |notch: f64| -> Vec<(f64, f64)> {
            let convex = |k: i32| libm::exp(-0.02 * f64::from(k)) - if k == 150 { notch } else { 0.0 };
            (0..400).map(|k| (0.05 * f64::from(k), if k == 399 { 0.0 } else { convex(k) })).collect()
        };
        let told = |notch| match Relaxation::new("notch", &table(notch), Some(1.0)).passivity() {
            Passivity::Active(active) => Some(active),
            Passivity::Passive => None,
            Passivity::Unknown => panic!("not looked for"),
        };
        // −c_0 = 0.0198/0.05 is more than all others, of which 4η/0.05 is the smallest multiple.
        assert_eq!(told(1e-4), None);
        let active = told(0.02).unwrap();
        assert!(active.place.re == 0.0 && active.resistance < 0.0, "{active:?}");
        let rows = Relaxation::new("notch", &table(0.02), Some(1.0));
        let drives = |omega: f64| rows.value(Complex::new(0.0, omega)).im < 0.0;
        let (from, to) = (active.from.unwrap(), active.to.unwrap());
        assert!(drives(active.place.im) && !drives(0.999 * from) && !drives(1.001 * to), "{active}");
    }

    #[test]
    fn the_series_is_that_of_the_value() {
        let rows = Relaxation::new("rows", &[(0.0, 2.0), (0.4, 1.0), (1.0, 0.7)], Some(3.0));
        let z = Series::polynomial(&[DoubleDouble::exact(2.0), DoubleDouble::exact(-2.0)], 80);
        let series: f64 =
            rows.series(&z).to_numbers().iter().rev().fold(0.0, |sum, coefficient| sum * 0.4 + coefficient);
        let value = rows.value(Complex::new(2.0 - 0.8, 0.0)).re;
        assert!((series - value).abs() < 1e-14, "{series} {value}");
    }
}
