//! Matsuda's continued fraction.

use fvi_core::{BdfOrder, DoubleDouble, ParameterError};
use fvi_fft::sums::max_or_nan;

use crate::filter_cascade::{FilterCascade, Section};
use crate::oustaloup::{band, check_tolerance, whole_sections};

/// Largest number of sections; beyond, rounding destroys the continued fraction.
const MOST_SECTIONS: usize = 16;
/// Margin of the band, as a factor at either end; the fraction is accurate somewhat beyond its points, too.
const ROOM: f64 = 1e-2;

/// s^β as the continued fraction through its gains at points in geometric sequence \[MatsudaFujii93\]:
/// O(sections) a step.
///
/// a_0 + (s − ω_0)/(a_1 + (s − ω_1)/(a_2 + …)) takes the values ω_k^β at s = ω_k. With an odd number of
/// points it has as many zeros as poles, all on the negative real axis, which interlace; the sections that
/// they form are discretised by the backward differentiation formula. For β > 1 one section is s itself.
///
/// Choices made here: points over a band that extends the frequencies of a run of `capacity` steps by a
/// factor of 100 at either end; the smallest number of sections, not more than 16, whose relative error at
/// real s between the points is at most `tolerance`. There is no bound on the error of a sum.
///
/// # Errors
/// If β is not between 0 and 2, or is 1; if step or tolerance is outside its range, or there is no channel or
/// capacity.
pub fn matsuda(
    order: f64,
    formula: BdfOrder,
    step: f64,
    channels: usize,
    capacity: usize,
    tolerance: f64,
) -> Result<FilterCascade, ParameterError> {
    let (mut sections, part) = whole_sections(order)?;
    check_tolerance(tolerance)?;
    let (low, high) = band(step, capacity, ROOM);
    let mut best: Option<Rational> = None;
    for count in 1..=MOST_SECTIONS {
        let Some(found) = Rational::through_gains(part, low, high, count) else { continue };
        let error = found.error(part, low, high);
        if best.as_ref().is_none_or(|best| error < best.error(part, low, high)) {
            best = Some(found);
        }
        if error <= tolerance {
            break;
        }
    }
    let Some(best) = best else {
        return Err(ParameterError { parameter: "order", value: order, allowed: "one that has a fraction" });
    };
    sections.extend(best.sections());
    FilterCascade::new(best.gain, &sections, formula, step, channels, capacity)
}

/// gain · Π (s + zero)/(s + pole), both ascending.
#[derive(Clone, Debug)]
pub(crate) struct Rational {
    pub(crate) gain: f64,
    pub(crate) zeros: Vec<f64>,
    pub(crate) poles: Vec<f64>,
}

impl Rational {
    /// The function with `count` zeros and poles through s^β at 2·`count` + 1 points; `None` if, because of
    /// rounding, not all zeros and poles are found.
    pub(crate) fn through_gains(order: f64, low: f64, high: f64, count: usize) -> Option<Self> {
        let points = 2 * count + 1;
        let ratio = libm::pow(high / low, 1.0 / (points - 1) as f64);
        // In units of the lowest point. With the powers of the rounded number ratio^β to 30 digits, the order
        // differs from β by rounding.
        let powers = |base: f64| {
            let next = |power: &DoubleDouble| Some(power.scale(base));
            std::iter::successors(Some(DoubleDouble::ONE), next).take(points).collect::<Vec<_>>()
        };
        let (places, mut values) = (powers(ratio), powers(libm::pow(ratio, order)));
        let minus = |a: DoubleDouble, b: DoubleDouble| a.add(b.scale(-1.0));
        let divide = |a: DoubleDouble, b: DoubleDouble| {
            // Division by the rounded divisor, with one correction.
            let quotient = a.divide(b.to_f64());
            quotient.add(minus(a, quotient.multiply(b)).divide(b.to_f64()))
        };
        // Inverse differences of Thiele's interpolation.
        let mut fraction = Vec::with_capacity(points);
        for i in 0..points {
            fraction.push(values[i]);
            for k in i + 1..points {
                values[k] = divide(minus(places[k], places[i]), minus(values[k], fraction[i]));
            }
        }
        if fraction.iter().any(|entry| !entry.to_f64().is_finite()) {
            return None;
        }
        // Numerator and denominator at s = −x by their recurrences, scaled.
        let both = |x: f64| {
            let (mut now, mut before) =
                ([fraction[0], DoubleDouble::ONE], [DoubleDouble::ONE, DoubleDouble::ZERO]);
            for i in 1..points {
                let factor = minus(DoubleDouble::exact(-x), places[i - 1]);
                let next =
                    [0, 1].map(|side| fraction[i].multiply(now[side]).add(factor.multiply(before[side])));
                let size = next[0].to_f64().abs().max(next[1].to_f64().abs());
                let scale = if (1e-60..=1e60).contains(&size) { 1.0 } else { 1.0 / size };
                before = now.map(|number| number.scale(scale));
                now = next.map(|number| number.scale(scale));
            }
            now.map(DoubleDouble::to_f64)
        };
        let top = places[points - 1].to_f64();
        let zeros = roots(|x| both(x)[0], top, count)?;
        let poles = roots(|x| both(x)[1], top, count)?;
        let interlaced = zeros.iter().zip(&poles).all(|(zero, pole)| zero < pole)
            && poles.iter().zip(&zeros[1..]).all(|(pole, zero)| pole < zero);
        if !interlaced {
            return None;
        }
        let scaled = |roots: Vec<f64>| roots.into_iter().map(|root| root * low).collect::<Vec<_>>();
        let mut found = Self { gain: 1.0, zeros: scaled(zeros), poles: scaled(poles) };
        let middle = low * places[count].to_f64();
        found.gain = libm::pow(middle, order) / found.value(middle);
        Some(found)
    }

    /// Value of the function at s > 0.
    pub(crate) fn value(&self, s: f64) -> f64 {
        let factors = self.zeros.iter().zip(&self.poles).map(|(zero, pole)| (s + zero) / (s + pole));
        self.gain * factors.product::<f64>()
    }

    /// Largest relative error on the band.
    fn error(&self, order: f64, low: f64, high: f64) -> f64 {
        let place = |index: usize| low * libm::pow(high / low, index as f64 / 400.0);
        (0..=400).map(place).map(|s| (self.value(s) / libm::pow(s, order) - 1.0).abs()).fold(0.0, max_or_nan)
    }

    fn sections(&self) -> impl Iterator<Item = Section> {
        self.zeros.iter().zip(&self.poles).map(|(&zero, &pole)| Section { zero, pole: Some(pole) })
    }
}

/// The `count` places x > 0 where the function changes its sign, ascending.
fn roots(function: impl Fn(f64) -> f64, top: f64, count: usize) -> Option<Vec<f64>> {
    const ROOM: f64 = 1e6;
    const LOOKS: usize = 400;
    let place = |index: usize| libm::pow(top * ROOM * ROOM, index as f64 / LOOKS as f64) / ROOM;
    let mut found = Vec::new();
    let (mut left, mut sign) = (place(0), function(place(0)) > 0.0);
    for index in 1..=LOOKS {
        let right = place(index);
        if (function(right) > 0.0) != sign {
            let (mut a, mut b) = (left, right);
            for _ in 0..60 {
                let middle = 0.5 * (a + b);
                if (function(middle) > 0.0) == sign { a = middle } else { b = middle }
            }
            found.push(0.5 * (a + b));
            sign = !sign;
        }
        left = right;
    }
    (found.len() == count).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fraction_takes_the_gains_at_its_points_and_converges_between() {
        let (low, high) = (1e-3, 1e2);
        let mut errors = Vec::new();
        for count in [2, 4, 8] {
            let rational = Rational::through_gains(0.5, low, high, count).unwrap();
            for k in 0..=2 * count {
                let s = low * (high / low).powf(k as f64 / (2 * count) as f64);
                assert!((rational.value(s) / s.sqrt() - 1.0).abs() < 1e-9, "{count}, {k}");
            }
            errors.push(rational.error(0.5, low, high));
        }
        assert!(errors[0] > 10.0 * errors[1] && errors[1] > 30.0 * errors[2], "{errors:?}");
        assert!(errors[2] < 1e-3, "{errors:?}");
    }
}
