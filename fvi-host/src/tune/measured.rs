//! A plant by its measured frequency response.
//!
//! A rational model with a dead time,
//!
//! ```text
//! M(s) = Σ_j r_j/(s − p_j) e^{−Ls} ,        Re p_j < 0 ,
//! ```
//!
//! with a fraction r/s, and the sum divided by s^{k−1}, for k integrators, is fitted to the relative errors
//! of the data, of the order beyond which more poles do not halve them. On the imaginary axis, between the
//! first frequency and the last, the plant is what was measured: the model times the ratio P/M of the data,
//! linear in ln ω, the data of neighbouring frequencies averaged. Everywhere else it is the model.

use super::margins::summit;
use super::polynomial::polynomial;
use fvi_fft::rational::{Values, sum_of_fractions};
use fvi_fft::sums::max_or_nan;
use fvi_scenario::language::cells::{Cells, OVER, cells};
use fvi_scenario::language::document::{Table, Value};
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::Quotient;
use fvi_simulation::simulation::closed_loop::logarithm;
use nalgebra::Complex;
use serde::Serialize;

/// Columns of a response: both of a row.
const COLUMNS: [[&str; 2]; 2] = [["re", "im"], ["magnitude", "phase"]];

/// Keys of a plant by its response.
pub(super) const KEYS: [&str; 7] =
    ["response", "columns", "units", "decimal", "integrators", "tolerance", "dead_time"];

/// Fewest frequencies.
const FEWEST: usize = 8;

/// Largest number of integrators.
const MOST_INTEGRATORS: usize = 4;

/// Largest relative deviation of a model from the data, where the plant says none.
const TOLERANCE: f64 = 0.05;

/// Ratio of frequencies up to which data are averaged.
const NEIGHBOURS: f64 = 1.1;

/// Highest order of a model.
const MOST_POLES: usize = 12;

/// Orders that have to do no better than a model, and by what factor.
const TRIED_BEYOND: usize = 2;
const BETTER: f64 = 0.5;

/// Deviation, as root of the mean square, that cannot be told from rounding.
const EXACT: f64 = 1e-10;

/// Frequencies by which dead times are compared, and dead times compared at first.
const COMPARED: usize = 80;
const DEAD_TIMES: usize = 24;

/// Ratio of deviations up to which a model without dead time is as good.
const AS_GOOD: f64 = 1.01;

/// Relocations of poles, for a comparison of dead times and for a model.
const ROUNDS: [usize; 2] = [5, 30];

/// Distance from the imaginary axis, relative to ω, up to which the plant is what was measured.
const ON_THE_AXIS: f64 = 1e-5;

/// A plant as it was measured, and its model without the dead time.
pub(super) struct Measured {
    file: String,
    /// Number of rows, and the first and last frequency.
    points: usize,
    pub(super) band: [f64; 2],
    /// ln ω, ascending, and P/M there.
    ratios: Vec<(f64, Complex<f64>)>,
    model: Model,
    integrators: usize,
    tolerance: f64,
    /// About rows that were left out.
    pub(super) note: Option<String>,
}

/// A model, and how far it is from the data.
#[derive(Clone)]
struct Model {
    poles: Vec<Complex<f64>>,
    residues: Vec<Complex<f64>>,
    /// Poles at s = 0 beside them.
    integrators: usize,
    dead_time: f64,
    /// Root of the mean square and maximum of |M/P − 1|, and ω there.
    mean: f64,
    largest: f64,
    largest_at: f64,
}

/// The response of `tune.json`.
#[derive(Serialize)]
pub(super) struct Record<'a> {
    file: &'a str,
    points: usize,
    from: f64,
    to: f64,
    order: usize,
    integrators: usize,
    deviation: f64,
    deviation_at: f64,
    tolerance: f64,
    /// Coefficients of numerator and denominator, from s⁰ on.
    model: Option<[Vec<f64>; 2]>,
}

/// ω and P(iω), ascending.
struct Data {
    omega: Vec<f64>,
    values: Vec<Complex<f64>>,
}

impl Data {
    fn read(cells: &Cells<'_, '_>) -> Result<Self, InputError> {
        let over = OVER[1..].iter().find_map(|name| cells.column(name));
        let header = |reason: String| cells.fault(cells.header, reason);
        let Some(over) = over else {
            return Err(header("a table over t: omega (rad/s) or f (Hz) is wanted".to_owned()));
        };
        let pairs = COLUMNS.map(|pair| pair.map(|name| cells.column(name)));
        let known = |name: &str| COLUMNS.as_flattened().contains(&name) || OVER.contains(&name);
        if let Some(place) = cells.columns.iter().position(|place| !known(&place.name)) {
            let reason = format!(
                "{}: unknown; columns beside the frequency are re and im, or magnitude and phase; \
                 `columns = {{ re = \"…\", im = \"…\" }}` says which of the file's they are",
                cells.place(place)
            );
            return Err(header(reason));
        }
        let (columns, in_parts) = match pairs {
            [[Some(re), Some(im)], [None, None]] => ([re, im], true),
            [[None, None], [Some(magnitude), Some(phase)]] => ([magnitude, phase], false),
            _ => return Err(header("re and im, or magnitude and phase: two columns of one kind".to_owned())),
        };
        columns.into_iter().try_for_each(|column| cells.check_unit(column))?;
        let [first, second] = columns.map(|column| cells.values(column));
        let omega = cells.values(over);
        for (k, (line, _)) in cells.rows.iter().enumerate() {
            let reason = if omega[k] <= 0.0 {
                format!("{} is not a frequency > 0", cells.place(over))
            } else if !in_parts && first[k] <= 0.0 {
                let advice = "magnitudes are > 0; those in decibels are `units = { magnitude = \"dB\" }`";
                format!("{}: {advice}", cells.place(columns[0]))
            } else if in_parts && first[k] == 0.0 && second[k] == 0.0 {
                "a response of zero".to_owned()
            } else {
                continue;
            };
            return Err(cells.fault(*line, reason));
        }
        if omega.len() < FEWEST {
            return Err(header(format!("{FEWEST} frequencies at least, not {}", omega.len())));
        }
        let value = |(a, b): (&f64, &f64)| match in_parts {
            true => Complex::new(*a, *b),
            false => Complex::new(a * libm::cos(*b), a * libm::sin(*b)),
        };
        Ok(Self { values: first.iter().zip(&second).map(value).collect(), omega })
    }

    /// At most [`COMPARED`] of the rows.
    fn thinned(&self) -> Self {
        let stride = self.omega.len().div_ceil(COMPARED);
        let pick = |k: &usize| k.is_multiple_of(stride);
        let rows: Vec<usize> = (0..self.omega.len()).filter(pick).collect();
        Self {
            omega: rows.iter().map(|&k| self.omega[k]).collect(),
            values: rows.iter().map(|&k| self.values[k]).collect(),
        }
    }

    /// The largest dead time that the phase allows: a plant whose rest only lags has a larger lag than its
    /// dead time.
    fn most_dead_time(&self, integrators: usize) -> f64 {
        let angle = |value: Complex<f64>| libm::atan2(value.im, value.re);
        // Of P s^k, without the sign of its gain.
        let first = self.values[0] * Complex::new(0.0, 1.0).powu(integrators as u32);
        let mut phase = angle(if first.re < 0.0 { -first } else { first });
        let mut most = max_or_nan(0.0, -phase / self.omega[0]);
        for (omega, pair) in self.omega[1..].iter().zip(self.values.windows(2)) {
            phase += angle(pair[1] / pair[0]);
            most = max_or_nan(most, -phase / omega);
        }
        1.2 * most
    }

    /// The model with these dead time and number of poles; `None` where there is none.
    fn model(&self, order: usize, integrators: usize, dead_time: f64, rounds: usize) -> Option<Model> {
        // One integral is a fraction like others, so that P s^k may tend to a constant.
        let staying = if integrators > 0 { &[Complex::ZERO][..] } else { &[] };
        let integrators = integrators.saturating_sub(1);
        let places: Vec<_> = self.omega.iter().map(|&omega| Complex::new(0.0, omega)).collect();
        let of_fractions = |(s, value): (&Complex<f64>, &Complex<f64>)| {
            value * (s * dead_time).exp() * s.powu(integrators as u32)
        };
        let values: Vec<_> = places.iter().zip(&self.values).map(of_fractions).collect();
        let weights: Vec<f64> = values.iter().map(|value| value.norm().recip()).collect();
        let data = Values { places: &places, values: &values, weights: &weights };
        let (low, high) = (self.omega[0], self.omega[self.omega.len() - 1]);
        let mut best: Option<Model> = None;
        for start in [spread_real(order, low, high), spread_pairs(order, low, high)] {
            let mut poles = start;
            for _ in 0..rounds {
                let Some(next) = data.relocated(&poles, staying) else { break };
                poles = next;
            }
            poles.extend_from_slice(staying);
            let Some(residues) = data.residues(&poles) else { continue };
            let errors = places
                .iter()
                .zip(&values)
                .map(|(s, value)| (sum_of_fractions(&poles, &residues, *s) / value - 1.0).norm());
            let errors: Vec<f64> = errors.collect();
            let square = errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64;
            let mean = libm::sqrt(square);
            if !mean.is_finite() || best.as_ref().is_some_and(|best| best.mean <= mean) {
                continue;
            }
            let at = (0..errors.len()).max_by(|&a, &b| errors[a].total_cmp(&errors[b]))?;
            let (largest, largest_at) = (errors[at], self.omega[at]);
            best = Some(Model { poles, residues, integrators, dead_time, mean, largest, largest_at });
        }
        best
    }

    /// The model of this order with the best dead time, or the given one.
    fn best_model(&self, order: usize, integrators: usize, dead_time: Option<f64>) -> Option<Model> {
        let [few, many] = ROUNDS;
        if let Some(dead_time) = dead_time {
            return self.model(order, integrators, dead_time, many);
        }
        let thinned = self.thinned();
        let most = thinned.most_dead_time(integrators);
        let mean = |dead_time: f64| {
            thinned.model(order, integrators, dead_time, few).map_or(f64::INFINITY, |model| model.mean)
        };
        let part = |k: usize| most * k as f64 / DEAD_TIMES as f64;
        let means: Vec<f64> = (0..=DEAD_TIMES).map(|k| mean(part(k))).collect();
        let at = (0..means.len()).min_by(|&a, &b| means[a].total_cmp(&means[b]))?;
        let (low, high) = (part(at.saturating_sub(1)), part((at + 1).min(DEAD_TIMES)));
        let (found, _) = summit(&|dead_time| -mean(dead_time), low, high);
        let best = self.model(order, integrators, found, many);
        // None, where it makes no difference.
        let without = self.model(order, integrators, 0.0, many);
        let is_as_good = |model: &Model| best.as_ref().is_none_or(|best| model.mean <= AS_GOOD * best.mean);
        without.filter(is_as_good).or(best)
    }

    /// The model of the least order beyond which more poles do not make it much better.
    fn fitted(&self, integrators: usize, dead_time: Option<f64>, tolerance: f64) -> Option<Model> {
        let mut best: Option<Model> = None;
        let mut beyond = 0;
        let least = usize::from(integrators == 0);
        for order in least..=MOST_POLES.min((self.omega.len() - 1) / 2) {
            let Some(model) = self.best_model(order, integrators, dead_time) else { continue };
            if best.as_ref().is_none_or(|best| model.mean < BETTER * best.mean) {
                (best, beyond) = (Some(model), 0);
            } else {
                beyond += 1;
            }
            let is_enough =
                |best: &Model| best.mean <= EXACT || beyond == TRIED_BEYOND && best.largest <= tolerance;
            if best.as_ref().is_some_and(is_enough) {
                break;
            }
        }
        best
    }

    /// ln ω and the ratio of the data to a model, those of neighbouring frequencies averaged.
    fn ratios(&self, model: &Model) -> Vec<(f64, Complex<f64>)> {
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for (k, &omega) in self.omega.iter().enumerate() {
            match groups.last_mut().filter(|group| omega <= NEIGHBOURS * self.omega[group[0]]) {
                Some(group) => group.push(k),
                None => groups.push(vec![k]),
            }
        }
        let average = |group: &Vec<usize>| {
            let part = 1.0 / group.len() as f64;
            let place = group.iter().map(|&k| libm::log(self.omega[k]) * part).sum();
            let ratio = |&k: &usize| self.values[k] / model.at(Complex::new(0.0, self.omega[k])) * part;
            (place, group.iter().map(ratio).sum())
        };
        groups.iter().map(average).collect()
    }
}

/// Poles in geometric sequence.
fn spread_real(order: usize, low: f64, high: f64) -> Vec<Complex<f64>> {
    let place = |k: usize| low * libm::pow(high / low, (k as f64 + 0.5) / order as f64);
    (0..order).map(|k| Complex::new(-place(k), 0.0)).collect()
}

/// Pairs with little damping in geometric sequence, and a real pole for an odd number.
fn spread_pairs(order: usize, low: f64, high: f64) -> Vec<Complex<f64>> {
    let pairs = order / 2;
    let place = |k: usize| low * libm::pow(high / low, (k as f64 + 0.5) / pairs as f64);
    let mut poles: Vec<_> = (0..pairs).map(|k| Complex::new(-0.01 * place(k), place(k))).collect();
    if !order.is_multiple_of(2) {
        poles.push(Complex::new(-libm::sqrt(low * high), 0.0));
    }
    poles
}

impl Measured {
    /// Reads the response that a plant names, and fits its model, whose dead time is given or found.
    ///
    /// # Errors
    /// The first thing in table or file that cannot be used; if no model is within the tolerance.
    pub(super) fn read(
        table: &Table<'_>,
        value: &Value<'_>,
        dead_time: Option<f64>,
    ) -> Result<Self, InputError> {
        table.allow(&KEYS)?;
        let cells = cells(value, table)?;
        let data = Data::read(&cells)?;
        let integrators =
            table.optional("integrators").map_or(Ok(0), |value| value.whole(0..=MOST_INTEGRATORS))?;
        let tolerance = match table.optional("tolerance") {
            None => TOLERANCE,
            Some(value) => {
                let tolerance = value.number()?;
                if !(tolerance > 0.0 && tolerance < 1.0) {
                    return Err(value.out_of_range("greater than 0 and less than 1"));
                }
                tolerance
            }
        };
        let model = data.fitted(integrators, dead_time, tolerance).ok_or_else(|| {
            value.error(Problem::Unusable { reason: "no rational function is near the response".to_owned() })
        })?;
        if model.largest > tolerance {
            let reason = format!(
                "the response is {:.3} of its size away from the nearest model, of order {} with a dead time of {:.6}, at \
                 ω = {:.6}: `tolerance` is {tolerance}",
                model.largest,
                model.order(),
                model.dead_time,
                model.largest_at
            );
            return Err(value.error(Problem::Unusable { reason }));
        }
        let ratios = data.ratios(&model);
        let band = [data.omega[0], data.omega[data.omega.len() - 1]];
        let note = Cells::left_out_note(&cells.left_out, Some(cells.left_out.len() + cells.rows.len()));
        let (file, points) = (value.text()?.to_owned(), data.omega.len());
        let note = note.map(|note| format!("{file}: {note}"));
        Ok(Self { file, points, band, ratios, model, integrators, tolerance, note })
    }

    /// P(s) without the dead time of its model, and ln D(s).
    pub(super) fn at(&self, s: Complex<f64>) -> (Complex<f64>, Complex<f64>) {
        let mut denominator = logarithm(s) * self.model.integrators as f64;
        for pole in &self.model.poles {
            denominator += logarithm(s - pole);
            if pole.im != 0.0 {
                denominator += logarithm(s - pole.conj());
            }
        }
        (self.model.rational(s) * self.ratio(s), denominator)
    }

    /// P/M on the axis within the band.
    fn ratio(&self, s: Complex<f64>) -> Complex<f64> {
        let [low, high] = self.band;
        if !(low..=high).contains(&s.im) || s.re > ON_THE_AXIS * s.im {
            return Complex::new(1.0, 0.0);
        }
        let place = libm::log(s.im);
        let after = self.ratios.partition_point(|(other, _)| *other <= place);
        match (after.checked_sub(1).map(|k| self.ratios[k]), self.ratios.get(after)) {
            (Some((left, a)), Some(&(right, b))) => a + (b - a) * ((place - left) / (right - left)),
            (Some((_, ratio)), None) | (None, Some(&(_, ratio))) => ratio,
            (None, None) => Complex::new(1.0, 0.0),
        }
    }

    /// The dead time of the model.
    pub(super) fn dead_time(&self) -> f64 {
        self.model.dead_time
    }

    /// True if the model has reached its value, or its integrals, at the first frequency.
    pub(super) fn is_settled(&self) -> bool {
        let [low, _] = self.band;
        let Model { poles, residues, dead_time, .. } = &self.model;
        let at = |s: Complex<f64>| sum_of_fractions(poles, residues, s) * (s * -*dead_time).exp();
        let s = Complex::new(0.0, low);
        let integral = poles.iter().position(|pole| *pole == Complex::ZERO);
        let (here, still) = match integral {
            Some(index) => (at(s) * s, residues[index]),
            None => (at(s), at(Complex::ZERO)),
        };
        (here - still).norm() <= self.tolerance * still.norm()
    }

    /// The model as a quotient of polynomials, without its dead time.
    pub(super) fn quotient(&self) -> Option<Quotient> {
        self.model.quotient()
    }

    /// A sentence about the model.
    pub(super) fn description(&self) -> String {
        let [from, to] = self.band;
        format!(
            "the model of the plant has order {} and a dead time of {:.6}, and is within {:.2e} of the response at {} \
             frequencies from ω = {from:.6} to {to:.6}",
            self.model.order(),
            self.model.dead_time,
            self.model.largest,
            self.points
        )
    }

    pub(super) fn record(&self) -> Record<'_> {
        let [from, to] = self.band;
        Record {
            file: &self.file,
            points: self.points,
            from,
            to,
            order: self.model.order(),
            integrators: self.integrators,
            deviation: self.model.largest,
            deviation_at: self.model.largest_at,
            tolerance: self.tolerance,
            model: self.quotient().map(|Quotient { numerator, denominator, .. }| [numerator, denominator]),
        }
    }
}

impl Model {
    fn order(&self) -> usize {
        self.integrators + self.poles.iter().map(|pole| 1 + usize::from(pole.im != 0.0)).sum::<usize>()
    }

    /// M(s) without its dead time, and with it.
    fn rational(&self, s: Complex<f64>) -> Complex<f64> {
        sum_of_fractions(&self.poles, &self.residues, s) / s.powu(self.integrators as u32)
    }

    fn at(&self, s: Complex<f64>) -> Complex<f64> {
        self.rational(s) * (s * -self.dead_time).exp()
    }

    /// N/D without its dead time; `None` if it is of too high a degree.
    fn quotient(&self) -> Option<Quotient> {
        let of =
            |numerator: Vec<f64>, denominator: Vec<f64>| Quotient { numerator, denominator, dead_time: 0.0 };
        let fraction = |(pole, residue): (&Complex<f64>, &Complex<f64>)| {
            // r/(s − p), or 2 (Re r s − Re(r p̄))/|s − p|² of a pair.
            let numerator = match pole.im {
                0.0 => vec![residue.re],
                _ => vec![-2.0 * (residue * pole.conj()).re, 2.0 * residue.re],
            };
            of(numerator, polynomial(&[[pole.re, pole.im]], 1.0))
        };
        let fractions = self.poles.iter().zip(&self.residues).map(fraction);
        let sum = fractions.map(Some).reduce(|sum, part| sum?.plus(part?))??;
        let integrals = [vec![0.0; self.integrators], vec![1.0]].concat();
        sum.product(&of(vec![1.0], integrals))
    }
}
