//! The largest gain with bounds on |S| and |T|.

use super::grid::{SampledPlant, SampledPoint};
use super::law::Law;
use super::margins::summit;
use super::problem::{Structure, Terms};
use super::search::SLACK;
use fvi_core::PidGains;
use nalgebra::Complex;

/// Distance of the ratios of two gains that are tried first, as that of ln ω.
const STEP: f64 = 0.1;

/// Forbidden gains k for one frequency: (k₁, k₂), those of L = k g too near −1.
type Interval = (f64, f64);

/// The largest integral gain (of a PI^λ), or proportional gain (of a PD^μ), of which the sampled loop is
/// stable with |S| ≤ Ms and |T| ≤ Mt.
///
/// For a fixed ratio of the two gains, L = k g(ω): each bound forbids an interval of k at each frequency, in
/// which a quadratic is negative. Between the forbidden intervals of all frequencies the loop never passes
/// through −1, so that a stretch of allowed gains is stable as a whole or not at all; where the plant
/// integrates, the stretch from zero is not the stable one. The ratio is then optimised in one dimension.
/// \[APH98\]
///
/// # Errors
/// A sentence, if the bounds hold for any gain, or for none of a stable loop.
pub(super) fn by_sensitivity(
    sampled: &SampledPlant<'_>,
    structure: &Structure,
    (ms, mt): (f64, Option<f64>),
) -> Result<Law, String> {
    let search = Gains { sampled, structure, ms, mt, sign: sampled.plant.sign() };
    let lowest = 1e-4 * sampled.plant.scale();
    let highest = std::f64::consts::PI / structure.sample;
    let count = (libm::log(highest / lowest) / STEP).ceil().max(1.0) as usize;
    let place = |index: usize| libm::log(lowest) + STEP * index as f64;
    let merits: Vec<f64> = (0..=count).map(|index| search.merit(place(index))).collect();
    let mut best = (0.0, 0.0);
    for (index, &merit) in merits.iter().enumerate() {
        if merit > best.1 {
            best = (place(index), merit);
        }
    }
    if best.1 == 0.0 {
        return Err("no gains of a stable loop keep these bounds".to_owned());
    }
    if best.1.is_infinite() {
        return Err(
            "any gain keeps this Ms: the phase of the sampled plant stays above −180° with this controller"
                .to_owned(),
        );
    }
    let refined = summit(&|x| search.merit(x), best.0 - STEP, best.0 + STEP);
    if refined.1 > best.1 {
        best = refined;
    }
    let ratio = search.ratio(best.0);
    let gain = search.gain(ratio);
    Ok(search.law(ratio, search.kept(ratio, gain).unwrap_or(gain)))
}

struct Gains<'a> {
    sampled: &'a SampledPlant<'a>,
    structure: &'a Structure,
    ms: f64,
    mt: Option<f64>,
    sign: f64,
}

impl Gains<'_> {
    fn law(&self, ratio: f64, gain: f64) -> Law {
        let Self { structure, sign, .. } = self;
        let (integral, derivative) = match structure.terms {
            Terms::Pi => (ratio * gain * sign, 0.0),
            _ => (0.0, ratio * gain * sign),
        };
        Law {
            gains: PidGains::Parallel { proportional: gain * sign, integral, derivative },
            lambda: structure.lambda.unwrap_or(1.0),
            mu: structure.mu.unwrap_or(1.0),
            filter: structure.filter,
            setpoint_weights: structure.setpoint_weights,
        }
    }

    /// The ratio of the second gain to K_p for which both terms are equal at ω = eˣ.
    fn ratio(&self, x: f64) -> f64 {
        let law = self.law(1.0, 1.0);
        libm::exp(x * if self.structure.terms == Terms::Pi { law.lambda } else { -law.mu })
    }

    /// The gain to be maximised: K_i of a PI, K_p of a PD.
    fn merit(&self, x: f64) -> f64 {
        let ratio = self.ratio(x);
        let gain = self.gain(ratio);
        if self.structure.terms == Terms::Pi { ratio * gain } else { gain }
    }

    /// The largest gain up to this one that keeps the bounds between the points of the grid, too, where a
    /// sharp maximum of |S| may lie; `None` if none near it does.
    fn kept(&self, ratio: f64, gain: f64) -> Option<f64> {
        const PARTS: [f64; 6] = [1.0, 0.999, 0.99, 0.97, 0.9, 0.8];
        let keeps = |part: &f64| {
            let law = self.law(ratio, part * gain);
            let found = self.sampled.margins(&law);
            found.ms <= self.ms + SLACK
                && self.mt.is_none_or(|mt| found.mt <= mt + SLACK)
                && self.sampled.is_stable(&law)
        };
        let place = PARTS.iter().position(keeps)?;
        let mut low = PARTS[place];
        let Some(mut high) = place.checked_sub(1).map(|above| PARTS[above]) else { return Some(gain) };
        for _ in 0..30 {
            let middle = 0.5 * (low + high);
            *(if keeps(&middle) { &mut low } else { &mut high }) = middle;
        }
        Some(low * gain)
    }

    /// The largest allowed K_p of a stable loop; 0 if there is none.
    fn gain(&self, ratio: f64) -> f64 {
        let unit = self.law(ratio, 1.0);
        let at = |point: &SampledPoint| point.plant * unit.response(point.difference).measured;
        let mut forbidden: Vec<Interval> = Vec::new();
        for bound in [Some(Bound::S(self.ms)), self.mt.map(Bound::T)].into_iter().flatten() {
            let mut last: Option<Interval> = None;
            for point in &self.sampled.points {
                let here = bound.forbids(at(point), point.any_phase);
                // Between neighbours the interval moves from one to the other.
                forbidden.extend(match (last, here) {
                    (Some(last), Some(here)) => Some((last.0.min(here.0), last.1.max(here.1))),
                    _ => here,
                });
                last = here;
            }
        }
        forbidden.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut allowed = Vec::new();
        let mut from = 0.0;
        for (low, high) in forbidden {
            if low > from {
                allowed.push(low);
            }
            from = high.max(from);
        }
        if from.is_finite() {
            allowed.push(f64::INFINITY);
        }
        let is_stable = |gain: f64| {
            let gain = if gain.is_finite() { gain } else { 2.0 * from.max(1.0) };
            self.sampled.is_stable(&self.law(ratio, gain))
        };
        allowed.into_iter().rev().find(|&gain| is_stable(gain)).unwrap_or_default()
    }
}

/// A bound on the maximum of |S| or |T|.
#[derive(Clone, Copy)]
enum Bound {
    S(f64),
    T(f64),
}

impl Bound {
    /// The interval of k for which L = k g misses the bound.
    fn forbids(self, g: Complex<f64>, any_phase: bool) -> Option<Interval> {
        let square = g.norm_sqr();
        // a k² + 2 Re g k + c < 0, and the largest |L| whatever its phase.
        let (a, c, size) = match self {
            Self::S(ms) => (square, 1.0 - 1.0 / (ms * ms), 1.0 - 1.0 / ms),
            Self::T(mt) => (square * (1.0 - 1.0 / (mt * mt)), 1.0, mt / (1.0 + mt)),
        };
        if any_phase {
            return Some((size / libm::sqrt(square), f64::INFINITY));
        }
        let discriminant = g.re * g.re - a * c;
        (g.re < 0.0 && discriminant > 0.0).then(|| {
            let root = libm::sqrt(discriminant) - g.re;
            (c / root, root / a)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forbidden_gains_are_those_that_miss_the_bound() {
        let g = Complex::new(-0.8, 0.3);
        let s = |k: f64| (g * k + 1.0).norm().recip();
        let t = |k: f64| (g * k).norm() * s(k);
        for (bound, value, size) in
            [(Bound::S(1.4), 1.4, &s as &dyn Fn(f64) -> f64), (Bound::T(1.3), 1.3, &t as &dyn Fn(f64) -> f64)]
        {
            let (low, high) = bound.forbids(g, false).unwrap();
            assert!((size(low) - value).abs() < 1e-12 && (size(high) - value).abs() < 1e-12);
            assert!(size(0.5 * (low + high)) > value && size(0.9 * low) < value && size(1.1 * high) < value);
        }
        assert!(Bound::S(1.4).forbids(Complex::new(0.1, 2.0), false).is_none());
    }
}
