//! Convex functions that fall, near rows of numbers.

use fvi_fft::sums::max_or_nan;

/// A convex function that falls to zero or above it, near rows (t, G) with ascending t, and the largest
/// |change| of a row.
///
/// m is the largest convex function below the rows that does not rise, and d the largest distance of a row
/// from it; no convex function is nearer than d/2, by which m is raised. With the time constant `decay` after
/// the last row, at T, it is at least the line (1 + (T − t)/τ) G(T), so that it is convex there; without one
/// it is m − m(T) + (m(T) + d/2)₊ (1 − t/T), which ends at 0.
pub(super) fn convex_near(rows: &[(f64, f64)], decay: Option<f64>) -> (Vec<(f64, f64)>, f64) {
    let below = falling(rows);
    let (end, lowest) = rows.last().zip(below.last()).map_or((0.0, 0.0), |(row, below)| (row.0, *below));
    let far = rows.iter().zip(&below).map(|(row, below)| row.1 - below).fold(0.0, max_or_nan);
    let rest = (lowest + 0.5 * far).max(0.0);
    let at = |(time, below): (f64, f64)| match decay {
        Some(decay) => (below + 0.5 * far).max(rest * (1.0 + (end - time) / decay)),
        None => below - lowest + rest * (end - time) / end,
    };
    let made: Vec<(f64, f64)> =
        rows.iter().zip(below).map(|(row, below)| (row.0, at((row.0, below)))).collect();
    let change = made.iter().zip(rows).map(|(own, row)| (own.1 - row.1).abs()).fold(0.0, max_or_nan);
    (made, change)
}

/// At each row the largest convex function below the rows that does not rise: their lower hull, level after
/// its lowest corner.
fn falling(rows: &[(f64, f64)]) -> Vec<f64> {
    let mut corners: Vec<(f64, f64)> = Vec::new();
    for &row in rows {
        while let [.., before, last] = corners[..]
            && (last.1 - before.1) * (row.0 - before.0) >= (row.1 - before.1) * (last.0 - before.0)
        {
            corners.pop();
        }
        corners.push(row);
    }
    let mut lowest = f64::INFINITY;
    let mut pieces = corners.windows(2).peekable();
    let value = |&(time, modulus): &(f64, f64)| {
        while let Some([_, to]) = pieces.peek()
            && to.0 < time
        {
            pieces.next();
        }
        let own = match pieces.peek() {
            Some([from, to]) => from.1 + (to.1 - from.1) * ((time - from.0) / (to.0 - from.0)),
            _ => modulus,
        };
        lowest = own.min(lowest);
        lowest
    };
    rows.iter().map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_function_is_convex_falls_and_is_as_near_as_one_can_be() {
        // The row at 1 is 0.3 above the line between its neighbours: half of that up, half of that down.
        let rows = [(0.0, 1.0), (1.0, 1.0), (2.0, 0.4), (4.0, 0.2), (5.0, 0.25)];
        let (made, change) = convex_near(&rows, Some(1e9));
        let known = [1.15, 0.85, 0.55, 0.35, 0.35];
        for ((own, row), known) in made.iter().zip(&rows).zip(known) {
            assert!(own.0 == row.0 && (own.1 - known).abs() < 1e-9, "{made:?}");
        }
        assert!((change - 0.15).abs() < 1e-9, "{change}");
        // A tail of τ = 1 begins as steeply as a line of the slope −G(T).
        let (made, _) = convex_near(&rows, Some(1.0));
        assert!(made[3].1 > 1.999 * made[4].1 && made[4].1 > 0.0, "{made:?}");
        // Without a tail the end is at 0; what is convex already stays.
        let (made, change) = convex_near(&[(0.0, 1.0), (1.0, 0.4), (3.0, 0.0)], None);
        assert_eq!((made, change), (vec![(0.0, 1.0), (1.0, 0.4), (3.0, 0.0)], 0.0));
        let (made, change) = convex_near(&[(0.0, 1.0), (1.0, -0.1), (3.0, 0.0)], None);
        assert_eq!(made, [(0.0, 1.1), (1.0, 0.0), (3.0, 0.0)]);
        assert!((change - 0.1).abs() < 1e-12, "{change}");
    }

    #[test]
    fn slopes_of_noisy_rows_ascend_to_zero() {
        let noise = |k: u32| 0.02 * libm::sin(7.3 * f64::from(k * k));
        let rows: Vec<(f64, f64)> = (0..200)
            .map(|k| (libm::exp2(0.1 * f64::from(k)) - 1.0, k))
            .map(|(t, k)| (t, libm::exp(-0.1 * t) + noise(k)))
            .collect();
        for decay in [None, Some(3.0), Some(1e7)] {
            let (made, change) = convex_near(&rows, decay);
            let slopes: Vec<f64> =
                made.windows(2).map(|pair| (pair[1].1 - pair[0].1) / (pair[1].0 - pair[0].0)).collect();
            assert!(slopes.windows(2).all(|pair| pair[1] - pair[0] > -1e-14), "{slopes:?}");
            assert!(slopes.iter().all(|slope| *slope <= 0.0) && made[199].1 >= 0.0);
            assert!(change > 0.01 && change < 0.05, "{decay:?}: {change}");
        }
    }
}
