//! Numbers quantised to 16 bits, enough for a picture.

use serde::{Deserialize, Serialize};

/// A uniform quantisation around the first number stored; its step grows with the largest distance from that
/// number.
///
/// A number takes two bytes. The quantisation step (`rung`) is a power of two and at most 1/16383 of the
/// largest distance from the first number. Numbers stored before the step grew are off by one step at most.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Levels {
    origin: Option<f64>,
    rung: f64,
}

/// Quantised number, in steps from the origin.
pub(super) type Level = i16;

/// Level of numbers that are too large for any picture.
const BEYOND: Level = Level::MIN;

/// The largest number that has a level; no axis of a picture reaches as far.
const LARGEST: f64 = 1e300;

/// Largest level; a number beyond it makes the step grow.
const HIGHEST: f64 = 32766.0;

impl Levels {
    /// The number with level 0: the first one stored.
    pub(super) fn origin(&self) -> Option<f64> {
        self.origin
    }

    /// True if values read from a file are valid for a quantisation.
    pub(super) fn is_sound(&self) -> bool {
        self.origin.is_none_or(|origin| origin.abs() <= LARGEST) && self.rung >= 0.0 && self.rung <= LARGEST
    }

    /// Enlarges the step if a number is out of range; returns the factor by which existing levels must be
    /// multiplied then.
    pub(super) fn reach(&mut self, number: f64) -> Option<f64> {
        if !has_level(number) {
            return None;
        }
        let distance = (number - *self.origin.get_or_insert(number)).abs();
        if distance <= HIGHEST * self.rung {
            return None;
        }
        let rung = power_of_two_below(distance * (2.0 / HIGHEST));
        let ratio = self.rung / rung;
        self.rung = rung;
        Some(ratio)
    }

    /// The level of a number, after [`reach`](Self::reach) for it.
    pub(super) fn level(&self, number: f64) -> Level {
        let Some(origin) = self.origin.filter(|_| has_level(number)) else { return BEYOND };
        // The cast maps NaN, from 0/0 when the step is still 0, to level 0.
        ((number - origin) / self.rung).round_ties_even() as Level
    }

    /// The number at a level; `f64::MAX`, which no axis shows, for [`BEYOND`].
    pub(super) fn number(&self, level: Level) -> f64 {
        match self.origin {
            Some(origin) if level != BEYOND => origin + f64::from(level) * self.rung,
            _ => f64::MAX,
        }
    }
}

/// Converts a level when the step grows; `ratio` is the factor from [`Levels::reach`].
pub(super) fn moved(level: Level, ratio: f64) -> Level {
    if level == BEYOND { BEYOND } else { (f64::from(level) * ratio).round_ties_even() as Level }
}

/// True if a number is small enough to have a level.
pub(super) fn has_level(number: f64) -> bool {
    number.abs() <= LARGEST
}

/// The largest power of two not above a positive number, for subnormal numbers too.
fn power_of_two_below(number: f64) -> f64 {
    if number >= f64::MIN_POSITIVE {
        const EXPONENT: u64 = 0x7ff << 52;
        f64::from_bits(number.to_bits() & EXPONENT)
    } else {
        f64::from_bits(1 << number.to_bits().max(1).ilog2())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_fft::sums::max_or_nan;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn a_number_is_at_most_a_rung_away_however_the_ladder_grew(
            numbers in prop::collection::vec(prop_oneof![-1e300..1e300, -1.0..1.0, 1.0..1.000001, -1e-310..1e-310], 1..60)
        ) {
            let mut ladder = Levels::default();
            let mut levels = Vec::new();
            for &number in &numbers {
                if let Some(ratio) = ladder.reach(number) {
                    levels.iter_mut().for_each(|level| *level = moved(*level, ratio));
                }
                levels.push(ladder.level(number));
            }
            let extent = numbers.iter().map(|number| (number - numbers[0]).abs()).fold(0.0, max_or_nan);
            prop_assert!(ladder.rung <= extent / 16383.0 || ladder.rung == f64::from_bits(1));
            for (&number, &level) in numbers.iter().zip(&levels) {
                let found = ladder.number(level);
                let rounding = f64::EPSILON * number.abs().max(numbers[0].abs());
                prop_assert!((found - number).abs() <= 1.001 * ladder.rung + rounding, "{found:e} for {number:e}");
            }
        }
    }

    #[test]
    fn numbers_beyond_all_axes_stay_beyond() {
        let mut ladder = Levels::default();
        assert_eq!(ladder.reach(f64::MAX), None);
        assert_eq!((ladder.origin(), ladder.number(ladder.level(f64::MAX))), (None, f64::MAX));
        assert_eq!(ladder.reach(2.0), None);
        assert_eq!(ladder.number(ladder.level(2.0)), 2.0);
        assert_eq!(ladder.reach(-1.5e308), None);
        let level = ladder.level(-1.5e308);
        assert_eq!(ladder.reach(3.0), Some(0.0));
        assert_eq!((ladder.number(moved(level, 0.5)), ladder.number(ladder.level(3.0))), (f64::MAX, 3.0));
    }
}
