//! The sampled loop: the plant behind a zero-order hold, observed at the samples, and the discrete law.

use super::law::Law;
use super::plant::Plant;
use nalgebra::Complex;
use std::f64::consts::PI;

/// Number of aliasing bands summed on either side; what lies beyond is extrapolated. Where |sh| is small
/// fewer are enough, because all of them together contribute less.
fn bands(angle: f64) -> usize {
    match angle {
        ..0.01 => 8,
        ..0.2 => 32,
        _ => 128,
    }
}

/// 1 − e^{−z}
fn fallen(z: Complex<f64>) -> Complex<f64> {
    let half = libm::sin(0.5 * z.im);
    let beside = libm::expm1(-z.re);
    Complex::new(2.0 * half * half - beside * libm::cos(z.im), (1.0 + beside) * libm::sin(z.im))
}

/// Transfer function of the plant from sample to sample, with its input held between them,
///
/// ```text
/// G(e^{sh}) = (1 − e^{−sh})/h Σ_k P(s + 2πik/h) / (s + 2πik/h) ,        Re s ≥ 0, 0 ≤ Im s ≤ π/h .
/// ```
///
/// The relative error is some 10⁻⁴ at ω = π/h, and smaller below. `None` where P has no value, and where the
/// series of a plant with several dead times and a direct path is not summed.
pub(super) fn held_plant(plant: &Plant, s: Complex<f64>, sample: f64) -> Option<Complex<f64>> {
    aliases(s, sample, plant.dead_time(), |place| Some(plant.at(place)?.value / place))
}

/// The part of G at ω that comes from |P| beyond a frequency, of any phase.
pub(super) fn held_from_beyond(plant: &Plant, omega: f64, sample: f64, beyond: f64) -> Option<f64> {
    let size = |place: Complex<f64>| match place.im > beyond * (1.0 + 1e-9) {
        true => Some(Complex::new((plant.at(place)?.value / place).norm(), 0.0)),
        false => Some(Complex::ZERO),
    };
    aliases(Complex::new(0.0, omega), sample, 0.0, size).map(|sum| sum.norm())
}

/// (1 − e^{−sh})/h Σ_k f(s + 2πik/h) for f with conjugate values at conjugate places, which a dead time
/// turns.
fn aliases(
    s: Complex<f64>,
    sample: f64,
    dead_time: f64,
    function: impl Fn(Complex<f64>) -> Option<Complex<f64>>,
) -> Option<Complex<f64>> {
    let bands = bands(s.norm() * sample);
    let sum = Aliases { s, band: 2.0 * PI / sample, delay: dead_time / sample, function };
    let mut whole = Complex::ZERO;
    let mut half = Complex::ZERO;
    for k in 0..bands {
        if k == bands / 2 {
            half = whole;
        }
        whole += sum.pair(k as f64)?;
    }
    let whole = match sum.rest(bands as f64)? {
        Rest::Summed(rest) => whole + rest,
        // The truncation error is inversely proportional to the number of bands.
        Rest::FallsFast => whole * 2.0 - half,
        Rest::Turns => return None,
    };
    Some(fallen(s * sample) / sample * whole)
}

/// What the terms from a certain one on are together.
enum Rest {
    Summed(Complex<f64>),
    /// Terms that fall like 1/k² or faster, without a fraction of a sample as dead time, or turned in another
    /// way.
    FallsFast,
    /// Terms that turn in another way than by the dead time.
    Turns,
}

/// The terms f(s + 2πik/h).
struct Aliases<F> {
    s: Complex<f64>,
    band: f64,
    /// The dead time L in samples.
    delay: f64,
    function: F,
}

/// Nodes and weights of Gauss's rule of 4 points on [−1, 1], the positive nodes.
const NODES: [(f64, f64); 2] = [
    (0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
    (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
];

impl<F: Fn(Complex<f64>) -> Option<Complex<f64>>> Aliases<F> {
    fn place(&self, distance: f64) -> Complex<f64> {
        Complex::new(self.s.re, self.s.im + distance * self.band)
    }

    fn term(&self, distance: f64) -> Option<Complex<f64>> {
        let place = self.place(distance);
        let value = (self.function)(Complex::new(place.re, place.im.abs()))?;
        Some(if place.im < 0.0 { value.conj() } else { value })
    }

    /// The terms k and −k − 1 together.
    fn pair(&self, k: f64) -> Option<Complex<f64>> {
        Some(self.term(k)? + self.term(-k - 1.0)?)
    }

    /// The term without the turn e^{−2πikL/h} of the dead time: a smooth function of k.
    fn smooth(&self, distance: f64) -> Option<Complex<f64>> {
        let turns = distance * self.delay;
        Some(self.term(distance)? * turned(2.0 * PI * (turns - libm::round(turns))))
    }

    /// Octaves beyond `first` over which the terms are followed: as far as rounding leaves the dead time's
    /// turn five digits. With fewer the sum would be noise, on which margins depend.
    fn octaves(&self, first: f64) -> i32 {
        const MOST: i32 = 24;
        const ROUNDED: f64 = 1e-5;
        let rounding = 2.0 * PI * f64::EPSILON * (1.0 + self.delay) * first;
        (1..MOST).find(|&octave| rounding * libm::exp2(f64::from(octave)) > ROUNDED).unwrap_or(MOST)
    }

    /// The sum of the pairs from `first` on.
    fn rest(&self, first: f64) -> Option<Rest> {
        let is_smooth_at = |k: f64| -> Option<bool> {
            let (one, next) = (self.smooth(k)?, self.smooth(k + 1.0)?);
            Some((next - one).norm() <= 8.0 / k * one.norm())
        };
        // Over octaves, since single terms of two dead times may cancel.
        let falls_fast = self.term(16.0 * first)?.norm() <= libm::pow(0.27, 4.0) * self.term(first)?.norm();
        // Of all dead time, what is not a whole number of samples.
        let turn = 2.0 * PI * (self.delay - libm::round(self.delay));
        let turns = turn.abs() > 1e-9 + 8.0 * PI * f64::EPSILON * self.delay;
        if falls_fast && !turns {
            return Some(Rest::FallsFast);
        }
        if !(is_smooth_at(first)? && is_smooth_at(1.5 * first)? && self.is_smooth_beyond(first)?) {
            return match (falls_fast, self.delay) {
                (true, _) => Some(Rest::FallsFast),
                (false, 0.0) => Some(Rest::Turns),
                // The dead time is one within the plant, of which nothing is left at high frequencies.
                _ => {
                    let function: &dyn Fn(Complex<f64>) -> Option<Complex<f64>> = &self.function;
                    Aliases { s: self.s, band: self.band, delay: 0.0, function }.rest(first)
                }
            };
        }
        if !turns {
            return self.slow_rest(first).map(Rest::Summed);
        }
        let above = turning_rest(|k| self.smooth(k), turn, first)?;
        let below = turning_rest(|k| self.smooth(-k - 1.0), -turn, first)? * turned(turn);
        Some(Rest::Summed(above + below))
    }

    /// True if the smooth part of a term falls from octave to octave as it did in the one before, as far as
    /// it is known: around each pole or zero its fall changes slowly. A second dead time changes it by
    /// anything.
    fn is_smooth_beyond(&self, first: f64) -> Option<bool> {
        const CHANGE: f64 = 0.7;
        let (mut before, mut fall) = (self.smooth(first)?, None::<Complex<f64>>);
        for octave in 1..=self.octaves(first) {
            let Some(next) = self.smooth(first * libm::exp2(f64::from(octave))) else { break };
            if next.norm() == 0.0 {
                break;
            }
            let fallen = next / before;
            if fall.is_some_and(|fall| (fallen / fall - 1.0).norm() > CHANGE) {
                return Some(false);
            }
            (before, fall) = (next, Some(fallen));
        }
        Some(true)
    }

    /// The sum of the pairs from `first` on of a plant that falls more slowly than 1/s, whose dead time is a
    /// whole number of samples.
    ///
    /// By the formula of Euler and Maclaurin: the integral over k is computed over octaves, and from the last
    /// one on as that of a power. With a direct path the series gives the mean of the outputs before and
    /// after a step of the input; the controller reads the one before, so that the step arrives a sample
    /// later.
    fn slow_rest(&self, first: f64) -> Option<Complex<f64>> {
        let pair = |k: f64| Some(self.smooth(k)? + self.smooth(-k - 1.0)?);
        let mut rest = pair(first)? * 0.5 - (pair(first + 0.5)? - pair(first - 0.5)?) / 12.0;
        let octaves = self.octaves(first);
        for octave in 0..octaves {
            let begin = first * libm::exp2(f64::from(octave));
            rest += over_panel(pair, begin, 2.0 * begin)?;
        }
        let last = first * libm::exp2(f64::from(octaves));
        let (before, end) = (pair(0.5 * last)?, pair(last)?);
        if end.norm() > 0.0 {
            let ratio = before / end;
            let power = Complex::new(libm::log(ratio.norm()), libm::atan2(ratio.im, ratio.re))
                / std::f64::consts::LN_2;
            rest += end * last / (power - 1.0);
        }
        let [direct, earlier] = [last, 0.5 * last].map(|k| Some(self.smooth(k)? * self.place(k)));
        let (direct, earlier) = (direct?, earlier?);
        if (direct - earlier).norm() < 1e-4 * direct.norm() {
            // Times (1 − e^{−sh})/h.
            rest -= direct * (PI / self.band);
        }
        Some(rest)
    }
}

/// e^{iφ}
fn turned(angle: f64) -> Complex<f64> {
    Complex::new(libm::cos(angle), libm::sin(angle))
}

/// ∫ g(k) dk over a panel, by Gauss's rule in ln k.
fn over_panel(function: impl Fn(f64) -> Option<Complex<f64>>, from: f64, to: f64) -> Option<Complex<f64>> {
    let half = 0.5 * libm::log(to / from);
    NODES.iter().flat_map(|&(node, weight)| [(node, weight), (-node, weight)]).try_fold(
        Complex::ZERO,
        |sum, (node, weight)| {
            let k = from * libm::exp(half * (1.0 + node));
            Some(sum + function(k)? * (half * weight * k))
        },
    )
}

/// Σ_{k ≥ first} g(k) e^{−iφk} for a smooth function g that falls, 0 < |φ| ≤ π.
///
/// Where a turn is seen within `first` terms by parts: with z = e^{−iφ} and S_j = Σ_k z^k Δ^j g(k),
///
/// ```text
/// S_j = (z^first Δ^j g(first) + z S_{j+1})/(1 − z) .
/// ```
///
/// A slower one is a sum to which the formula of Euler and Maclaurin applies; the integral in it is computed
/// over panels within which little turns, up to where it, too, can be integrated by parts.
fn turning_rest(smooth: impl Fn(f64) -> Option<Complex<f64>>, turn: f64, first: f64) -> Option<Complex<f64>> {
    /// Angle from which parts are integrated.
    const FAR: f64 = 50.0;
    const PARTS: usize = 6;
    let term = |k: f64| Some(smooth(k)? * turned(-turn * k));
    if turn.abs() * first >= 12.0 {
        let mut differences = [Complex::ZERO; PARTS + 1];
        for (j, value) in differences.iter_mut().enumerate() {
            *value = smooth(first + j as f64)?;
        }
        for order in 1..=PARTS {
            for j in (order..=PARTS).rev() {
                let before = differences[j - 1];
                differences[j] -= before;
            }
        }
        let z = turned(-turn);
        let below = (Complex::new(1.0, 0.0) - z).inv();
        let sum = differences.iter().rev().fold(Complex::<f64>::ZERO, |sum, part| (sum * z + part) * below);
        return Some(sum * turned(-turn * first));
    }
    let mut rest = term(first)? * 0.5 - (term(first + 0.5)? - term(first - 0.5)?) / 12.0;
    let (mut from, last) = (first, FAR / turn.abs());
    while from < last {
        let to = (2.0 * from).min(from + 1.5 / turn.abs()).min(last);
        rest += over_panel(term, from, to)?;
        from = to;
    }
    // g, g′ and g″ at the end.
    let apart = last / 16.0;
    let [before, at, behind] = [last - apart, last, last + apart].map(&smooth);
    let (before, at, behind) = (before?, at?, behind?);
    let slope = (behind - before) / (2.0 * apart);
    let bend = (behind - at * 2.0 + before) / (apart * apart);
    let inverse = Complex::new(0.0, turn).inv();
    Some(rest + (at + (slope + bend * inverse) * inverse) * inverse * turned(-turn * last))
}

/// (1 − e^{−sh})/h, which stands for s in the sampled law.
pub(super) fn difference(s: Complex<f64>, sample: f64) -> Complex<f64> {
    fallen(s * sample) / sample
}

/// L(e^{sh}) of the sampled loop. The discrete law is the continuous one with backward differences,
/// (1 − e^{−sh})/h, in place of s.
pub(super) fn sampled_loop(plant: &Plant, law: &Law, sample: f64, s: Complex<f64>) -> Option<Complex<f64>> {
    Some(held_plant(plant, s, sample)? * law.response(difference(s, sample)).measured)
}

/// Upper end of the frequency band: π/h, reduced by rounding.
pub(super) fn band(sample: f64) -> f64 {
    PI / sample * (1.0 - 1e-13)
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_core::{DerivativeFilter, PidGains};

    /// G(z) of (a s + 1)/(s + 1) e^{−Ls} behind a hold, from its step response a e^{−t} + 1 − e^{−t}: with
    /// L = (n + λ)h the first value that is seen is that a time (1 − λ)h behind the jump; for λ = 0 it is the
    /// one of the next sample.
    fn lead(a: f64, s: Complex<f64>, sample: f64, dead_time: f64) -> Complex<f64> {
        let whole = libm::floor(dead_time / sample * (1.0 + 1e-12));
        let fraction = (dead_time / sample - whole).max(0.0);
        let within = if fraction < 1e-9 { sample } else { (1.0 - fraction) * sample };
        let (z, one) = ((s * -sample).exp(), Complex::new(1.0, 0.0));
        // Σ_k (1 − (1 − a) e^{−within − kh}) z^k, behind whole + 1 samples, times 1 − z.
        let fallen = Complex::new((1.0 - a) * libm::exp(-within), 0.0) / (one - z * libm::exp(-sample));
        let sum = one / (one - z) - fallen;
        sum * (one - z) * (s * (-sample * (whole + 1.0))).exp()
    }

    #[test]
    fn plants_behind_a_hold_are_those_of_their_step_responses_whatever_their_dead_time_is() {
        for sample in [0.1, 1.0] {
            for delay in
                [0.0, 0.005, 0.05, 0.2, 0.5, 0.77, 0.995, 1.0, 1.0 + 3e-5, 2.0, 10.003, 100.0, 1000.0]
            {
                for a in [0.0, 0.5, 1.5] {
                    let dead_time = delay * sample;
                    let value = |s: Complex<f64>| (s * a + 1.0) / (s + 1.0) * (s * -dead_time).exp();
                    for share in [1e-3, 0.05, 0.0637, 0.4, 0.95] {
                        for growth in [0.0, 0.3] {
                            let s = Complex::new(growth, PI * share / sample);
                            let found =
                                aliases(s, sample, dead_time, |place| Some(value(place) / place)).unwrap();
                            let right = lead(a, s, sample, dead_time);
                            let error = (found - right).norm() / right.norm();
                            assert!(
                                error < 3e-4,
                                "h {sample}, L/h {delay}, a {a}, s {s}: {found} for {right}, {error:.1e}"
                            );
                        }
                    }
                }
            }
        }
    }

    /// Their series turns in more than one way: the sum is bounded, or there is none.
    #[test]
    fn direct_paths_with_two_dead_times_are_held_to_a_percent_or_refused() {
        let sample = 0.1;
        let mut refused = 0;
        for (one, other) in [(0.33, 0.7), (0.33, 0.331), (0.3, 0.3001), (0.05, 0.25), (0.012, 0.3)] {
            for share in [0.05, 0.5, 0.95] {
                let s = Complex::new(0.0, PI * share / sample);
                let value = |s: Complex<f64>| (s * -one).exp() + (s * -other).exp() * 0.5;
                let right = lead(1.0, s, sample, one) + lead(1.0, s, sample, other) * 0.5;
                match aliases(s, sample, one + other, |place| Some(value(place) / place)) {
                    None => refused += 1,
                    Some(found) => {
                        let error = (found - right).norm() / right.norm();
                        assert!(error < 1e-2, "{one}, {other}, {s}: {found} for {right}, {error:.1e}");
                    }
                }
            }
        }
        assert!(refused > 0);
    }

    #[test]
    fn a_law_with_differences_in_place_of_s_is_the_law_that_ticks() {
        let parallel = Law {
            gains: PidGains::Parallel { proportional: 2.0, integral: 0.7, derivative: 0.4 },
            lambda: 0.8,
            mu: 1.3,
            filter: DerivativeFilter::Fractional { time: 0.2, order: 0.9 },
            setpoint_weights: [0.5, 0.1],
        };
        let series = Law {
            gains: PidGains::Series {
                proportional: 2.0,
                integral_rate: 0.3,
                derivative_time: 0.5,
                filter_ratio: 10.0,
            },
            filter: DerivativeFilter::None,
            setpoint_weights: [1.0, 0.0],
            ..parallel
        };
        let sample = 0.1;
        for law in [parallel, series] {
            let ticks = law.sampled(sample).unwrap();
            for omega in [1e-3, 0.4, 7.0, band(sample)] {
                let known = ticks.response(omega).unwrap();
                let found = law.response(difference(Complex::new(0.0, omega), sample));
                for (known, found) in [(known.measured, found.measured), (known.setpoint, found.setpoint)] {
                    assert!((known - found).norm() < 1e-12 * known.norm(), "{omega}: {known} {found}");
                }
            }
        }
    }
}
