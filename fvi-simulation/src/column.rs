//! Reductions over a column of numbers, several at a time.

use pulp::NullaryFnOnce;

/// Number of accumulators.
const LANES: usize = 8;

/// Number of numbers from which dispatch to a vector unit is worth while.
const MANY: usize = 16;

/// Runs `look` on `count` numbers with the vectors of the processor, if there are many; the bits are the
/// same.
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

/// Folds the numbers of a column with `join` from `start`, in no particular order.
#[inline(always)]
fn fold(numbers: &[f64], start: f64, join: impl Fn(f64, f64) -> f64) -> f64 {
    // For large systems only few states are reduced together.
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

/// Combines the accumulators by halves, which the compiler vectorises.
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

/// The reduction of [`extremes`]. A closure of this size would not be inlined, and would be compiled without
/// the wider vectors.
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

/// The smallest number, infinity for an empty slice. Values that are not numbers are ignored.
pub fn lowest(numbers: &[f64]) -> f64 {
    fold(numbers, f64::INFINITY, lower)
}

/// The largest number, minus infinity for an empty slice. Values that are not numbers are ignored.
pub fn highest(numbers: &[f64]) -> f64 {
    fold(numbers, f64::NEG_INFINITY, higher)
}

/// The largest absolute value, zero for an empty slice. Values that are not numbers are ignored.
pub fn largest(numbers: &[f64]) -> f64 {
    fold(numbers, 0.0, |largest, number| if number.abs() > largest { number.abs() } else { largest })
}

/// Index of the first occurrence of a number.
pub fn first_place(numbers: &[f64], wanted: f64) -> Option<usize> {
    let row = along(numbers.len(), || {
        let mut rows = numbers.as_chunks::<LANES>().0.iter();
        rows.position(|row| row.iter().fold(false, |found, &number| found | (number == wanted)))
    });
    let start = row.unwrap_or(numbers.len() / LANES) * LANES;
    let within = numbers.get(start..)?.iter().position(|&number| number == wanted)?;
    Some(start + within)
}

/// True if all numbers are finite.
pub fn is_finite(numbers: &[f64]) -> bool {
    // Zero times an infinity or not-a-number is not a number, and stays so in sums.
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
