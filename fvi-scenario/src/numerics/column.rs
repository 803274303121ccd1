//! Looks along a column of numbers, several of them at a time.

use pulp::NullaryFnOnce;

/// Numbers that are looked at side by side.
const LANES: usize = 8;

/// Numbers from which on it is worth asking for a vector unit.
const MANY: usize = 16;

/// Looks along so many numbers with the vectors of the processor, where they are many; the bits are the same.
#[inline(always)]
fn along<L: NullaryFnOnce>(count: usize, look: L) -> L::Output {
    #[cfg(target_arch = "x86_64")]
    if count >= MANY
        && let Some(wide) = pulp::x86::V3::try_new()
    {
        return wide.vectorize(look);
    }
    look.call()
}

/// Joins the numbers of a column to `start`, in no particular order.
#[inline(always)]
fn fold(numbers: &[f64], start: f64, join: impl Fn(f64, f64) -> f64) -> f64 {
    // Of large systems few states are looked at together.
    if numbers.len() < LANES {
        return numbers.iter().fold(start, |joined, &number| join(joined, number));
    }
    along(numbers.len(), || fold_in_lanes(numbers, start, &join))
}

#[inline(always)]
fn fold_in_lanes(numbers: &[f64], start: f64, join: impl Fn(f64, f64) -> f64) -> f64 {
    let (rows, rest) = numbers.as_chunks::<LANES>();
    let mut lanes = [start; LANES];
    for row in rows {
        for (lane, &number) in lanes.iter_mut().zip(row) {
            *lane = join(*lane, number);
        }
    }
    rest.iter().fold(joined(lanes, &join), |joined, &number| join(joined, number))
}

/// Joins what lanes hold: halves, of which the compiler makes vectors.
#[inline(always)]
fn joined(lanes: [f64; LANES], join: impl Fn(f64, f64) -> f64) -> f64 {
    let four: [f64; LANES / 2] = core::array::from_fn(|lane| join(lanes[lane], lanes[lane + LANES / 2]));
    let [a, b, c, d] = four;
    join(join(a, c), join(b, d))
}

#[inline(always)]
fn lower(low: f64, number: f64) -> f64 {
    if number < low { number } else { low }
}

#[inline(always)]
fn higher(high: f64, number: f64) -> f64 {
    if number > high { number } else { high }
}

/// The [`lowest`] number and the [`highest`].
pub fn extremes(numbers: &[f64]) -> (f64, f64) {
    along(numbers.len(), Extremes(numbers))
}

/// The look for [`extremes`]. A closure of its size would be a call, compiled for the vectors that every
/// processor has.
struct Extremes<'a>(&'a [f64]);

impl NullaryFnOnce for Extremes<'_> {
    type Output = (f64, f64);

    #[inline(always)]
    fn call(self) -> (f64, f64) {
        let (rows, rest) = self.0.as_chunks::<LANES>();
        let (mut lows, mut highs) = ([f64::INFINITY; LANES], [f64::NEG_INFINITY; LANES]);
        for row in rows {
            lows = core::array::from_fn(|lane| lower(lows[lane], row[lane]));
            highs = core::array::from_fn(|lane| higher(highs[lane], row[lane]));
        }
        let ends = (joined(lows, lower), joined(highs, higher));
        rest.iter().fold(ends, |(low, high), &number| (lower(low, number), higher(high, number)))
    }
}

/// The lowest number, infinity if there is none. What is not a number is passed over.
pub fn lowest(numbers: &[f64]) -> f64 {
    fold(numbers, f64::INFINITY, lower)
}

/// The highest number, minus infinity if there is none. What is not a number is passed over.
pub fn highest(numbers: &[f64]) -> f64 {
    fold(numbers, f64::NEG_INFINITY, higher)
}

/// The largest absolute value, zero if there is none. What is not a number is passed over.
pub fn largest(numbers: &[f64]) -> f64 {
    fold(numbers, 0.0, |largest, number| if number.abs() > largest { number.abs() } else { largest })
}

/// Where a number stands first.
pub fn first_place(numbers: &[f64], wanted: f64) -> Option<usize> {
    let row = along(numbers.len(), || {
        let mut rows = numbers.as_chunks::<LANES>().0.iter();
        rows.position(|row| row.iter().fold(false, |found, &number| found | (number == wanted)))
    });
    let start = row.unwrap_or(numbers.len() / LANES) * LANES;
    let within = numbers.get(start..)?.iter().position(|&number| number == wanted)?;
    Some(start + within)
}

/// Whether all numbers are finite.
pub fn is_finite(numbers: &[f64]) -> bool {
    // Zero times what is infinite or not a number is not a number, and stays so in sums.
    fold(numbers, 0.0, |sum, number| sum + 0.0 * number) == 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looks_see_every_place_of_a_column() {
        for count in [1, 7, 8, 9, 16, 30] {
            for place in 0..count {
                let column = |number: f64| {
                    let mut column = vec![-1.0; count];
                    column[place] = number;
                    column
                };
                assert_eq!(lowest(&column(-2.5)), -2.5, "{place} of {count}");
                assert_eq!(highest(&column(0.5)), 0.5, "{place} of {count}");
                assert_eq!(largest(&column(-3.0)), 3.0, "{place} of {count}");
                assert_eq!(extremes(&column(-2.5)).0, -2.5, "{place} of {count}");
                assert_eq!(extremes(&column(0.5)).1, 0.5, "{place} of {count}");
                assert_eq!(first_place(&column(0.5), 0.5), Some(place), "of {count}");
                assert_eq!(
                    first_place(&column(0.5), -1.0),
                    [0, 1].into_iter().find(|&p| p != place && p < count)
                );
                assert_eq!(first_place(&column(0.5), 2.0), None);
                assert!(is_finite(&column(f64::MAX)));
                for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                    assert!(!is_finite(&column(bad)), "{bad} at {place} of {count}");
                }
            }
        }
        assert_eq!((lowest(&[]), highest(&[]), largest(&[])), (f64::INFINITY, f64::NEG_INFINITY, 0.0));
        assert_eq!(lowest(&[f64::NAN, 2.0]), 2.0);
    }
}
