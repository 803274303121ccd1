//! Further frequencies where a response is sharp: between those that were asked for a resonance can lie
//! unseen.

use nalgebra::Complex;
use std::collections::BinaryHeap;

/// Change of the phase in radians and of ln |H| between neighbours, from which on a point is put between
/// them.
const COARSE: f64 = 0.15;
/// Neighbours are not closer than this in ln ω.
const CLOSEST: f64 = 1e-9;

/// Two neighbours, the coarsest pair first.
struct Pair {
    change: f64,
    begin: (f64, Complex<f64>),
    end: (f64, Complex<f64>),
}

impl Pair {
    /// The pair, if the response changes by more than [`COARSE`] within it.
    fn coarse(begin: (f64, Complex<f64>), end: (f64, Complex<f64>)) -> Option<Self> {
        let turn = end.1 / begin.1;
        let change = libm::log(turn.norm()).abs().max(turn.arg().abs());
        // Not a number where a response is zero or infinite: nothing is drawn there.
        let wide = libm::log(end.0 / begin.0) > CLOSEST;
        (wide && change > COARSE && change.is_finite()).then_some(Self { change, begin, end })
    }
}

impl PartialEq for Pair {
    fn eq(&self, other: &Self) -> bool {
        self.change.total_cmp(&other.change).is_eq()
    }
}

impl Eq for Pair {}

impl PartialOrd for Pair {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Pair {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.change.total_cmp(&other.change)
    }
}

/// At most `most` points of a response H between those that are known, ascending in ω.
///
/// The first ones are the `resonances`, frequencies near poles, which neighbours that are further apart do
/// not show. Each further one halves, on the logarithmic scale, the pair of neighbours between which H
/// changes most, until it changes by less than 0.15 (in ln |H| and radians) between any two.
///
/// # Errors
/// The first error of `response`.
pub(super) fn between<E>(
    known: &[(f64, Complex<f64>)],
    resonances: &[f64],
    most: usize,
    mut response: impl FnMut(f64) -> Result<Complex<f64>, E>,
) -> Result<Vec<(f64, Complex<f64>)>, E> {
    let (Some(&(first, _)), Some(&(last, _))) = (known.first(), known.last()) else { return Ok(Vec::new()) };
    let mut found = Vec::new();
    let inside = |omega: &&f64| **omega > first && **omega < last;
    let unknown = |omega: &&f64| known.binary_search_by(|place| place.0.total_cmp(omega)).is_err();
    for &omega in resonances.iter().filter(inside).filter(unknown).take(most) {
        found.push((omega, response(omega)?));
    }
    let mut all: Vec<_> = known.iter().chain(&found).copied().collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut coarse: BinaryHeap<Pair> =
        all.windows(2).filter_map(|pair| Pair::coarse(pair[0], pair[1])).collect();
    while found.len() < most {
        let Some(Pair { begin, end, .. }) = coarse.pop() else { break };
        let omega = (begin.0 * end.0).sqrt();
        let middle = (omega, response(omega)?);
        found.push(middle);
        coarse.extend(Pair::coarse(begin, middle));
        coarse.extend(Pair::coarse(middle, end));
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::convert::Infallible;

    /// Ten frequencies a decade do not see a resonance of damping ratio 10⁻⁵.
    #[test]
    fn a_narrow_peak_is_found_to_its_top() {
        let response = |omega: f64| Complex::new(1.0 - omega * omega, 2e-5 * omega).inv();
        let places = (0..=20).map(|k| 0.1033 * 10f64.powf(0.1 * f64::from(k)));
        let known: Vec<_> = places.map(|omega| (omega, response(omega))).collect();
        let top = |found: &[(f64, Complex<f64>)]| {
            found.iter().map(|place| place.1.norm()).max_by(f64::total_cmp).unwrap()
        };
        assert!(top(&known) < 50.0);
        for resonances in [&[][..], &[1.0]] {
            let found =
                between(&known, resonances, 100, |omega| Ok::<_, Infallible>(response(omega))).unwrap();
            assert!(found.len() <= 100);
            assert!(found.windows(2).all(|pair| pair[0].0 < pair[1].0));
            // 1/(2ζ), with the frequency of the pole alone, and to a few percent by halving.
            let (least, seen) =
                if resonances.is_empty() { (2e3, "by halving") } else { (5e4, "by the pole") };
            assert!(top(&found) > 0.999 * least, "{seen}: {}", top(&found));
        }
    }

    /// Where nothing is sharp, nothing is added.
    #[test]
    fn a_smooth_response_is_left_as_it_is() {
        let places = (1..50).map(|k| f64::from(k) * 0.1);
        let known: Vec<_> = places.map(|omega| (omega, Complex::new(1.0, 0.1 * omega).inv())).collect();
        let found =
            between(&known, &[], 50, |_| -> Result<Complex<f64>, Infallible> { unreachable!() }).unwrap();
        assert!(found.is_empty());
    }
}
