//! Regions in which a form is not passive, by sampling.

use super::Active;
use super::form::Form;
use nalgebra::Complex;
use std::f64::consts::PI;

/// The region where K is not passive, as sampling on the imaginary axis and on rays into the right half-plane
/// shows, at forty and ten places per decade over sixty decades, and more densely where the real part of
/// K(s)/s is small.
pub(super) fn look_for_activity(form: &dyn Form) -> Option<Active> {
    if form.spring() < 0.0 {
        // The static force is repulsive.
        let place = Complex::new(f64::MIN_POSITIVE, 0.0);
        return Some(Active { place, resistance: -1.0, from: None, to: None });
    }
    let resistance = |angle: f64, logarithm: f64| {
        let size = libm::exp10(logarithm);
        // On the imaginary axis Re K(iω)/(iω) is Im K/ω, without the rounding of a cosine.
        let s = if angle == 0.5 * PI {
            Complex::new(0.0, size)
        } else {
            Complex::new(size * libm::cos(angle), size * libm::sin(angle))
        };
        let value = form.value(s);
        let ratio = value / s;
        // Of K(s) − K(0) the rounding of K(0) is left.
        let rounding = 4.0 * f64::EPSILON * form.spring().abs() / value.norm();
        (s, ratio.re / ratio.norm() + rounding)
    };
    const DECADES: i32 = 30;
    // Rounding error of formulas with cancellation.
    const ROUNDING: f64 = -1e-9;
    let (first, last) = (-f64::from(DECADES), f64::from(DECADES));
    for angle in [0.5 * PI, 0.45 * PI, 0.4 * PI, 0.3 * PI, 0.2 * PI, 0.1 * PI, 0.0] {
        // Resonances are narrow next to the axis only; the rays are 0.3 apart, which is a seventh of a
        // decade.
        let per_decade = if angle == 0.5 * PI { 40 } else { 10 };
        let at = |k: i32| f64::from(k) / f64::from(per_decade);
        // A value that is not a number, from under- or overflow, is ignored.
        let value = |logarithm: f64| resistance(angle, logarithm).1;
        let drives = |logarithm: f64| value(logarithm) < ROUNDING;
        let mut looks: Vec<(f64, f64)> =
            (-DECADES * per_decade..=DECADES * per_decade).map(|k| (at(k), value(at(k)))).collect();
        let mut grounds = Vec::new();
        for looks in looks.windows(3) {
            if looks[1].1 <= looks[0].1 && looks[1].1 <= looks[2].1 && looks[1].1 < 0.1 {
                // A minimum: golden-section search.
                let (mut low, mut high) = (looks[0].0, looks[2].0);
                for _ in 0..40 {
                    let (left, right) = (high - 0.618 * (high - low), low + 0.618 * (high - low));
                    if value(left) < value(right) {
                        high = right;
                    } else {
                        low = left;
                    }
                }
                grounds.push((0.5 * (low + high), value(0.5 * (low + high))));
            }
        }
        looks.extend(grounds);
        looks.sort_by(|one, other| one.0.total_cmp(&other.0));
        let Some(begin) = looks.iter().position(|look| look.1 < ROUNDING) else { continue };
        let end = looks[begin..].iter().position(|look| look.1 >= ROUNDING);
        let end = end.map_or(looks.len(), |count| begin + count);
        // Bisection between a place that is not passive and one that is.
        let edge = |mut inside: f64, mut outside: f64| {
            for _ in 0..40 {
                let middle = 0.5 * (inside + outside);
                if drives(middle) { inside = middle } else { outside = middle }
            }
            libm::exp10(inside)
        };
        let from = (begin > 0).then(|| edge(looks[begin].0, looks[begin - 1].0));
        let to = looks.get(end).map(|beyond| edge(looks[end - 1].0, beyond.0));
        let worst = looks[begin..end].iter().min_by(|one, other| one.1.total_cmp(&other.1));
        let (place, resistance) = resistance(angle, worst.map_or(first, |worst| worst.0.clamp(first, last)));
        return Some(Active { place, resistance, from, to });
    }
    None
}
