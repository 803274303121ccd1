//! Rational functions of s that take the gains ω_k^β of a power at points ω_k in geometric sequence: the
//! continued fraction of Thiele's interpolation, known in control as Matsuda's.
//!
//! ```text
//! C(s) = a_0 + (s − ω_0)/(a_1 + (s − ω_1)/(a_2 + …)) ,
//! a_i = f_i(ω_i) ,      f_0 = ω^β ,      f_{i+1} = (ω − ω_i)/(f_i − a_i) .
//! ```
//!
//! With an odd number of points it has as many zeros as poles, all on the negative real axis, which
//! interlace. The differences f_i − a_i cancel the more the narrower the band and the more the points: they
//! are taken with 30 digits, and zeros and poles that even these do not hold are refused.
//!
//! Source: \[MatsudaFujii93\].

use crate::sums::max_or_nan;
use fvi_core::DoubleDouble;

/// Largest relative change of zeros and poles by a change in the last digits of the gains.
const CERTAIN: f64 = 1e-9;

/// gain · Π (s + zero)/(s + pole), both ascending, for s^β with −1 < β < 1.
#[derive(Clone, Debug, PartialEq)]
pub struct RationalPower {
    /// Factor of the product.
    pub gain: f64,
    /// Zeros, negated.
    pub zeros: Vec<f64>,
    /// Poles, negated.
    pub poles: Vec<f64>,
}

impl RationalPower {
    /// The function with `count` zeros and poles through s^`order` at 2·`count` + 1 points from `low` to
    /// `high`; `None` if numbers of 30 digits do not hold them to nine.
    pub fn through_gains(order: f64, low: f64, high: f64, count: usize) -> Option<Self> {
        if order < 0.0 {
            // The inverse takes the inverse gains, and there is one function with as many zeros and poles.
            let Self { gain, zeros, poles } = Self::through_gains(-order, low, high, count)?;
            return Some(Self { gain: gain.recip(), zeros: poles, poles: zeros });
        }
        // The last digit of a number of 30 is 2⁻¹⁰⁴ of it.
        let [found, other] =
            [0.0, libm::exp2(-102.0)].map(|change| Self::with_gains_changed(order, low, high, count, change));
        let (found, other) = (found?, other?);
        let changes =
            |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, max_or_nan);
        let change = max_or_nan(changes(&found.zeros, &other.zeros), changes(&found.poles, &other.poles));
        (change <= CERTAIN).then_some(found)
    }

    /// The same through gains that are larger and smaller in turn by a factor 1 + `change`.
    fn with_gains_changed(order: f64, low: f64, high: f64, count: usize, change: f64) -> Option<Self> {
        let points = 2 * count + 1;
        let ratio = libm::pow(high / low, 1.0 / (points - 1) as f64);
        // In units of the lowest point. With the powers of the rounded number ratio^β to 30 digits, the order
        // differs from β by rounding.
        let powers = |base: f64| {
            let next = |power: &DoubleDouble| Some(power.scale(base));
            std::iter::successors(Some(DoubleDouble::ONE), next).take(points).collect::<Vec<_>>()
        };
        let (places, mut values) = (powers(ratio), powers(libm::pow(ratio, order)));
        for (k, value) in values.iter_mut().enumerate() {
            *value = value.add(value.scale(if k % 2 == 0 { change } else { -change }));
        }
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
    pub fn value(&self, s: f64) -> f64 {
        let factors = self.zeros.iter().zip(&self.poles).map(|(zero, pole)| (s + zero) / (s + pole));
        self.gain * factors.product::<f64>()
    }

    /// Largest relative error at real s between `low` and `high`.
    pub fn error(&self, order: f64, low: f64, high: f64) -> f64 {
        let place = |index: usize| low * libm::pow(high / low, index as f64 / 400.0);
        (0..=400).map(place).map(|s| (self.value(s) / libm::pow(s, order) - 1.0).abs()).fold(0.0, max_or_nan)
    }
}

/// The `count` places x > 0 where the function changes its sign, ascending.
fn roots(function: impl Fn(f64) -> f64, top: f64, count: usize) -> Option<Vec<f64>> {
    /// How far zeros and poles are sought outside of the points: those of orders close to 0 and ±1 are far.
    const ROOM: f64 = 1e12;
    /// Looks for each of them.
    const LOOKS: usize = 400;
    let looks = LOOKS * count.max(1);
    let place = |index: usize| libm::pow(top * ROOM * ROOM, index as f64 / looks as f64) / ROOM;
    let mut found = Vec::new();
    let (mut left, mut sign) = (place(0), function(place(0)) > 0.0);
    for index in 1..=looks {
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
    use std::f64::consts::PI;

    #[test]
    fn the_fraction_takes_the_gains_at_its_points_and_converges_between() {
        let (low, high) = (1e-3, 1e2);
        let mut errors = Vec::new();
        for count in [2, 4, 8] {
            let rational = RationalPower::through_gains(0.5, low, high, count).unwrap();
            for k in 0..=2 * count {
                let s = low * (high / low).powf(k as f64 / (2 * count) as f64);
                assert!((rational.value(s) / s.sqrt() - 1.0).abs() < 1e-9, "{count}, {k}");
            }
            errors.push(rational.error(0.5, low, high));
        }
        assert!(errors[0] > 10.0 * errors[1] && errors[1] > 30.0 * errors[2], "{errors:?}");
        assert!(errors[2] < 1e-3, "{errors:?}");
    }

    #[test]
    fn nine_sections_in_a_decade_are_those_of_numbers_with_sixty_digits() {
        // From the same fraction and the roots of its polynomials with 60 and 120 digits.
        let known = [
            0.12105404, 1.1457607, 3.5241842, 8.0833252, 16.672901, 33.77361, 72.438902, 185.40401,
            800.08258, 0.49342929, 2.1293184, 5.4498917, 11.689132, 23.678194, 48.839329, 112.02144,
            344.56075, 3261.2227,
        ];
        let found = RationalPower::through_gains(0.5, 2.0 * PI, 20.0 * PI, 9).unwrap();
        for (found, known) in found.zeros.iter().chain(&found.poles).zip(known) {
            assert!((found / known - 1.0).abs() < 1e-7, "{found} for {known}");
        }
    }

    #[test]
    fn negative_powers_are_the_inverse() {
        let found = RationalPower::through_gains(-0.3, 0.1, 10.0, 4).unwrap();
        for k in 0..9 {
            let s = 0.1 * libm::pow(100.0, f64::from(k) / 8.0);
            assert!((found.value(s) * libm::pow(s, 0.3) - 1.0).abs() < 1e-9, "{s}");
        }
    }

    #[test]
    fn sections_that_thirty_digits_do_not_hold_are_refused() {
        assert_eq!(RationalPower::through_gains(0.5, 1.0, 10.0, 30), None);
    }
}
