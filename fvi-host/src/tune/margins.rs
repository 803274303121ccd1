//! Margins of a loop from its frequency response.

use fvi_simulation::simulation::events;
use nalgebra::Complex;
use serde::Serialize;
use std::f64::consts::PI;

/// How far a loop is from −1.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Margins {
    /// Factor by which the gain may grow until L passes through −1; `None` if it never does.
    pub gain_margin: Option<f64>,
    /// Factor down to which the gain may shrink until L passes through −1; `None` if it never does.
    pub gain_reduction: Option<f64>,
    /// The smallest distance of the phase from −180° where |L| = 1, in degrees; `None` where |L| is never 1.
    pub phase_margin: Option<f64>,
    /// Additional dead time up to which the loop stays stable.
    pub delay_margin: Option<f64>,
    /// ω where |L| = 1, ascending.
    pub gain_crossovers: Vec<f64>,
    /// ω where L is a negative number, the first one and those with |L| > 0.1, ascending.
    pub phase_crossovers: Vec<f64>,
    /// The largest |S| = 1/|1 + L|.
    pub ms: f64,
    /// ω of the largest |S|.
    pub ms_at: f64,
    /// The largest |T| = |L|/|1 + L|.
    pub mt: f64,
    /// ω of the largest |T|.
    pub mt_at: f64,
}

/// A loop as a function of ω; `None` where it has no value.
pub(super) type Loop<'a> = dyn Fn(f64) -> Option<Complex<f64>> + 'a;

/// Logarithm of the ratio of neighbouring frequencies.
const SPACING: f64 = 0.01;

/// Largest change of the phase of e^{−iωL} between neighbouring frequencies, in radians.
const TURN: f64 = 0.1;

/// |L| below which the response does not affect any margin.
const SMALL: f64 = 0.02;

/// Distance of |L| from 1 at a point beside which it may cross 1 and come back.
const GRAZING: f64 = 0.05;

/// Part of itself that the imaginary part of a real number may be.
const ON_THE_AXIS: f64 = 1e-9;

/// Largest number of bisections of an interval in which the loop curves strongly.
const HALVINGS: u32 = 24;

/// Largest number of frequencies of a response.
const MOST: usize = 2_000_000;

/// The response at frequencies close enough to resolve its curve.
///
/// # Errors
/// A sentence, where the loop has no value.
pub(super) fn follow(
    open: &Loop<'_>,
    from: f64,
    to: f64,
    dead_time: f64,
) -> Result<Vec<(f64, Complex<f64>)>, String> {
    let at = |omega: f64| match open(omega) {
        Some(value) if value.re.is_finite() && value.im.is_finite() => Ok((omega, value)),
        _ => Err(format!("the loop has no finite value at ω = {omega:e}")),
    };
    let mut last = at(from)?;
    let mut points = vec![last];
    while last.0 < to {
        let mut ratio = SPACING;
        if last.1.norm() > SMALL {
            ratio = ratio.min(TURN / (dead_time * last.0));
        }
        let omega = last.0 * libm::exp(ratio);
        let next = at(if omega >= to { to } else { omega })?;
        refine(last, next, HALVINGS, &at, &mut points)?;
        last = next;
        if points.len() > MOST {
            return Err(format!(
                "the loop gain stays above {SMALL} over so many turns of its dead time that they cannot be followed: \
                 ω = {:e} is reached",
                last.0
            ));
        }
    }
    Ok(points)
}

/// Adds points between two points, and the second one.
fn refine(
    left: (f64, Complex<f64>),
    right: (f64, Complex<f64>),
    halvings: u32,
    at: &dyn Fn(f64) -> Result<(f64, Complex<f64>), String>,
    points: &mut Vec<(f64, Complex<f64>)>,
) -> Result<(), String> {
    let middle = at(libm::sqrt(left.0 * right.0))?;
    let straight = (left.1 + right.1) * 0.5;
    let size = left.1.norm().max(right.1.norm()).max(middle.1.norm());
    if (middle.1 - straight).norm() > 0.01 * size && halvings > 0 && size > SMALL {
        refine(left, middle, halvings - 1, at, points)?;
        return refine(middle, right, halvings - 1, at, points);
    }
    points.extend([middle, right]);
    Ok(())
}

/// The zero of a function that changes its sign in an interval of ω; `None` where the function has no value.
fn zero(function: &dyn Fn(f64) -> Option<f64>, low: f64, high: f64) -> Option<f64> {
    let [at_low, at_high] = [function(low)?, function(high)?];
    let mut has_values = true;
    let value = |omega: f64| {
        function(omega).unwrap_or_else(|| {
            has_values = false;
            0.0
        })
    };
    let found = events::zero(value, (low, at_low), (high, at_high));
    has_values.then_some(found)
}

/// The largest value of a function over the points of a response, refined between them, and its place.
pub(super) fn largest(
    points: &[(f64, Complex<f64>)],
    open: &Loop<'_>,
    size: fn(Complex<f64>) -> f64,
) -> (f64, f64) {
    let values: Vec<f64> = points.iter().map(|point| size(point.1)).collect();
    let mut best = (points[0].0, f64::NEG_INFINITY);
    for (index, (&value, point)) in values.iter().zip(points).enumerate() {
        let left = values[index.saturating_sub(1)];
        let right = values[(index + 1).min(values.len() - 1)];
        if value >= left && value >= right {
            if value > best.1 {
                best = (point.0, value);
            }
            // A maximum between neighbouring points exceeds their values by little only.
            if value > 0.98 * best.1 {
                let (low, high) =
                    (points[index.saturating_sub(1)].0, points[(index + 1).min(points.len() - 1)].0);
                let (place, peak) = summit(&|omega| open(omega).map_or(f64::NAN, size), low, high);
                if peak > best.1 {
                    best = (place, peak);
                }
            }
        }
    }
    best
}

/// The largest value over points that are close to each other, by parabolas through neighbours.
pub(super) fn largest_by_parabolas(
    points: impl Iterator<Item = Complex<f64>>,
    size: fn(Complex<f64>) -> f64,
) -> f64 {
    let (mut before, mut last, mut best) = (f64::NAN, f64::NAN, f64::NEG_INFINITY);
    for value in points.map(size) {
        best = best.max(value);
        if last >= before && last >= value {
            let (rise, bend) = (value - before, before - 2.0 * last + value);
            if bend < 0.0 {
                best = best.max(last - 0.125 * rise * rise / bend);
            }
        }
        (before, last) = (last, value);
    }
    best
}

/// Place and value of the maximum of a function in an interval where it has one: by parabolas through the
/// three best places, and by golden sections where these lead nowhere. \[Brent73\], chapter 5
pub(super) fn summit(function: &dyn Fn(f64) -> f64, mut low: f64, mut high: f64) -> (f64, f64) {
    /// The smaller part of a golden section.
    const GOLDEN: f64 = 0.381_966_011_250_105_2;
    const MOST: usize = 80;
    // A maximum so near is higher by rounding.
    let near = 1e-9 * (high - low);
    let at = |place: f64| {
        (place, Some(function(place)).filter(|value| !value.is_nan()).unwrap_or(f64::NEG_INFINITY))
    };
    let mut best = at(low + GOLDEN * (high - low));
    let (mut second, mut third) = (best, best);
    // The last move, and the one before it.
    let (mut last, mut before) = (0.0_f64, 0.0_f64);
    for _ in 0..MOST {
        let middle = 0.5 * (low + high);
        if (best.0 - middle).abs() <= 2.0 * near - 0.5 * (high - low) {
            break;
        }
        let over = before;
        let way = top_of_parabola(best, second, third);
        let place = best.0 + way;
        if way.abs() < 0.5 * over.abs() && place > low && place < high {
            before = last;
            last = if (place - low).min(high - place) < 2.0 * near {
                near.copysign(middle - best.0)
            } else {
                way
            };
        } else {
            before = if best.0 < middle { high - best.0 } else { low - best.0 };
            last = GOLDEN * before;
        }
        let found = at(best.0 + if last.abs() < near { near.copysign(last) } else { last });
        if found.1 >= best.1 {
            *(if found.0 >= best.0 { &mut low } else { &mut high }) = best.0;
            (best, second, third) = (found, best, second);
        } else {
            *(if found.0 < best.0 { &mut low } else { &mut high }) = found.0;
            if found.1 >= second.1 || second.0 == best.0 {
                (second, third) = (found, second);
            } else if found.1 >= third.1 || third.0 == best.0 || third.0 == second.0 {
                third = found;
            }
        }
    }
    best
}

/// Way from the first of three points to the top of the parabola through them; not finite where there is
/// none.
fn top_of_parabola(one: (f64, f64), two: (f64, f64), three: (f64, f64)) -> f64 {
    let side = (one.0 - two.0) * (one.1 - three.1);
    let other = (one.0 - three.0) * (one.1 - two.1);
    ((one.0 - two.0) * side - (one.0 - three.0) * other) / (2.0 * (other - side))
}

/// |S| = 1/|1 + L|.
pub(super) fn sensitivity(open: Complex<f64>) -> f64 {
    (open + 1.0).norm().recip()
}

/// |T| = |L|/|1 + L|.
pub(super) fn complementary(open: Complex<f64>) -> f64 {
    open.norm() / (open + 1.0).norm()
}

/// The largest |S| whatever the phase of L is, for |L| < 1.
pub(super) fn sensitivity_at_any_phase(open: Complex<f64>) -> f64 {
    if open.norm() < 1.0 { (1.0 - open.norm()).recip() } else { f64::INFINITY }
}

/// The largest |T| whatever the phase of L is, for |L| < 1.
pub(super) fn complementary_at_any_phase(open: Complex<f64>) -> f64 {
    open.norm() * sensitivity_at_any_phase(open)
}

/// Where |L| crosses 1 in an interval.
fn crossed(open: &Loop<'_>, low: f64, high: f64) -> Option<f64> {
    zero(&|omega| Some(open(omega)?.norm() - 1.0), low, high)
}

/// Where |L| crosses 1 and comes back among three points on one side of it.
fn grazed(points: [(f64, Complex<f64>); 3], open: &Loop<'_>) -> [Option<f64>; 2] {
    let [low, middle, high] = points.map(|(_, value)| value.norm() - 1.0);
    let is_near = middle.abs() < GRAZING && middle.abs() <= low.abs().min(high.abs());
    let on_one_side = (low > 0.0) == (middle > 0.0) && (middle > 0.0) == (high > 0.0);
    if !is_near || !on_one_side {
        return [None; 2];
    }
    let side = if middle > 0.0 { -1.0 } else { 1.0 };
    let size = |omega: f64| open(omega).map_or(f64::NAN, |value| side * (value.norm() - 1.0));
    let [(from, _), _, (to, _)] = points;
    match summit(&size, from, to) {
        (place, most) if most > 0.0 => [crossed(open, from, place), crossed(open, place, to)],
        _ => [None; 2],
    }
}

/// The margins from the points of a response.
pub(super) fn margins(points: &[(f64, Complex<f64>)], open: &Loop<'_>) -> Margins {
    let mut found = Margins::default();
    // At π/h every response of samples is a real number.
    let end = points.last().map_or(f64::NAN, |point| point.0);
    // Of all places where L is a negative number.
    let mut factors = Vec::new();
    for three in points.windows(3) {
        found.gain_crossovers.extend(grazed([three[0], three[1], three[2]], open).into_iter().flatten());
    }
    for pair in points.windows(2) {
        let ((low, left), (high, right)) = (pair[0], pair[1]);
        if (left.norm() > 1.0) != (right.norm() > 1.0) {
            found.gain_crossovers.extend(crossed(open, low, high));
        }
        let crossed = if high == end && right.im.abs() <= ON_THE_AXIS * right.norm() {
            Some(high)
        } else if (left.im > 0.0) != (right.im > 0.0) && left.re.min(right.re) < 0.0 {
            zero(&|omega| Some(open(omega)?.im), low, high)
        } else {
            None
        };
        let negative = crossed.and_then(|at| Some((at, -open(at)?.re))).filter(|(_, size)| *size > 0.0);
        if let Some((at, size)) = negative {
            factors.push(size.recip());
            if found.phase_crossovers.is_empty() || size > 0.1 {
                found.phase_crossovers.push(at);
            }
        }
    }
    found.gain_crossovers.sort_by(f64::total_cmp);
    let phases: Vec<(f64, f64)> = found
        .gain_crossovers
        .iter()
        .filter_map(|&omega| Some((omega, -open(omega)?)))
        .map(|(omega, value)| (omega, libm::atan2(value.im, value.re)))
        .collect();
    let smallest = |numbers: &mut dyn Iterator<Item = f64>| numbers.reduce(f64::min);
    found.phase_margin = phases
        .iter()
        .map(|phase| phase.1.to_degrees())
        .reduce(|least, other| if other.abs() < least.abs() { other } else { least });
    found.delay_margin = smallest(
        &mut phases
            .iter()
            .map(|&(omega, phase)| (if phase < 0.0 { phase + 2.0 * PI } else { phase }) / omega),
    );
    found.gain_margin = smallest(&mut factors.iter().copied().filter(|&factor| factor > 1.0));
    found.gain_reduction = factors.iter().copied().filter(|&factor| factor <= 1.0).reduce(f64::max);
    (found.ms_at, found.ms) = largest(points, open, sensitivity);
    (found.mt_at, found.mt) = largest(points, open, complementary);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summits_are_found_with_few_evaluations() {
        let calls = std::cell::Cell::new(0);
        let counted = |function: fn(f64) -> f64, low: f64, high: f64| {
            calls.set(0);
            let found = summit(
                &|x| {
                    calls.set(calls.get() + 1);
                    function(x)
                },
                low,
                high,
            );
            (found, calls.get())
        };
        let ((place, value), calls_of_sine) = counted(libm::sin, 1.0, 2.5);
        assert!((place - 0.5 * PI).abs() < 1e-7 && (value - 1.0).abs() < 1e-15, "{place} {value}");
        assert!(calls_of_sine < 30, "{calls_of_sine}");
        // A resonance of the quality 10⁶ in an interval that resolves it badly, a corner, and the end.
        let sharp = |x: f64| 1.0 / ((x - 1.0) * (x - 1.0) * 1e12 + 1.0);
        let ((place, value), _) = counted(sharp, 1.0 - 1e-4, 1.0 + 2e-4);
        assert!((place - 1.0).abs() < 1e-10 && (value - 1.0).abs() < 1e-8, "{place} {value}");
        let ((place, _), _) = counted(|x| -(x - 0.3).abs(), 0.0, 1.0);
        assert!((place - 0.3).abs() < 2e-9, "{place}");
        let ((place, _), _) = counted(|x| x, 0.0, 1.0);
        assert!(place > 1.0 - 4e-9, "{place}");
        // Where there is no value there is no maximum.
        let ((place, _), _) = counted(|x| if x < 0.5 { f64::NAN } else { -x }, 0.0, 1.0);
        assert!((place - 0.5).abs() < 4e-9, "{place}");
    }
}
