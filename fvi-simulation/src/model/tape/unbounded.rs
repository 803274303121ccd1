//! Times at which a function of time is unbounded, and whether it is integrable there.

use super::enclosure::Enclosure;
use super::time_terms::Term;
use fvi_scenario::language::expression::Node;

/// A time near which a function grows like |t − c|^e.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Singularity {
    /// c.
    pub time: f64,
    /// e before c and after it; 0 if the function is bounded, negative and close to 0 for a logarithm.
    pub exponents: [f64; 2],
}

/// Exponent below which the function is not integrable, or cannot be distinguished from such a function.
const SMALLEST_EXPONENT: f64 = -0.99;

/// Result of a search.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Unbounded {
    /// Singularities, ascending, up to the first that is not integrable.
    pub found: Vec<Singularity>,
    /// Time up to which they are known, if not the end of the run.
    pub known_to: Option<f64>,
}

/// Largest number of enclosures in a search.
const MOST_LOOKS: usize = 20_000;

/// Length of a range from the start on, as a fraction of the run, below which it is treated as a point, if
/// times are numbers so close to each other: at a start at 0.
const SMALLEST: f64 = 1e-27;

impl Singularity {
    /// True if the function is integrable there.
    pub fn has_integral(&self) -> bool {
        self.exponents.iter().all(|&exponent| exponent > SMALLEST_EXPONENT)
    }

    /// The smaller of both exponents.
    pub fn exponent(&self) -> f64 {
        self.exponents[0].min(self.exponents[1])
    }
}

impl Unbounded {
    /// The singularities of a term over a run, from its start to its end: the range is halved until interval
    /// arithmetic bounds the term in every part except the shortest, where the growth of its values decides.
    pub fn of(node: &Node, run: [f64; 2]) -> Self {
        let [start, end] = run;
        let smallest = SMALLEST * (end - start);
        let (mut parts, mut looks) = (vec![(start, end)], 0);
        let mut result = Self::default();
        let mut passed = f64::NEG_INFINITY;
        let term = Term::new(node.clone());
        let mut registers = Vec::new();
        let mut value = |time: f64| term.at(time, &mut registers);
        while let Some((from, to)) = parts.pop() {
            if to <= passed {
                continue;
            }
            looks += 1;
            if looks > MOST_LOOKS {
                result.known_to = Some(from);
                return result;
            }
            if Enclosure::of(node, from, to).value.is_finite() {
                continue;
            }
            let middle = 0.5 * (from + to);
            let is_start = from == start && to - start <= smallest;
            let is_point = is_start || to - from <= 4.0 * f64::EPSILON * from.abs().max(to.abs());
            if !is_point {
                parts.extend([(middle, to), (from, middle)]);
                continue;
            }
            let time = if is_start { start } else { highest(from.next_down().max(start), to, &mut value) };
            match growth(time, run, &mut value) {
                None => {
                    // The term is not a number there: the run will fail with a message.
                    result.known_to = None;
                    return result;
                }
                Some(exponents) if exponents == [0.0; 2] => {}
                Some(exponents) => {
                    let singularity = Singularity { time, exponents };
                    result.found.push(singularity);
                    if !singularity.has_integral() {
                        return result;
                    }
                }
            }
            passed = if is_start { start + smallest } else { to + 8.0 * f64::EPSILON * to.abs() };
        }
        result
    }
}

/// The place between two close ones where a function is largest, or not finite.
fn highest(from: f64, to: f64, value: &mut impl FnMut(f64) -> f64) -> f64 {
    let (mut time, mut best, mut largest) = (from, from, 0.0);
    while time <= to.next_up() {
        let size = value(time).abs();
        if !size.is_finite() {
            return time;
        }
        if size > largest {
            (best, largest) = (time, size);
        }
        time = time.next_up();
    }
    best
}

/// e before and after a time of a run; `None` if the function is not a number there.
fn growth(time: f64, [start, end]: [f64; 2], value: &mut impl FnMut(f64) -> f64) -> Option<[f64; 2]> {
    // Distances large enough for the rounding of the time, and small beside the run.
    let distances = if time == 0.0 {
        [1e-20, 1e-24].map(|part| part * (end - start))
    } else {
        let far = (1e-7 * time.abs()).min(0.01 * (end - start));
        [far, (0.01 * far).max(64.0 * f64::EPSILON * time.abs()).min(0.5 * far)]
    };
    let mut exponents = [0.0; 2];
    for (side, exponent) in [-1.0, 1.0].into_iter().zip(&mut exponents) {
        if (side < 0.0 && time <= start) || (side > 0.0 && time >= end) {
            continue;
        }
        let [far, near] = distances.map(|distance| value(time + side * distance).abs());
        if far.is_nan() || near.is_nan() {
            return None;
        }
        if near.is_infinite() {
            *exponent = f64::NEG_INFINITY;
        } else if near > far * (1.0 + 1e-6) {
            let measured = if far == 0.0 {
                f64::NEG_INFINITY
            } else {
                libm::log(near / far) / libm::log(distances[1] / distances[0])
            };
            *exponent = rounded(measured);
        }
    }
    Some(exponents)
}

/// The nearest fraction with a small denominator.
fn rounded(exponent: f64) -> f64 {
    let candidates = [1000.0, 12.0].map(|parts: f64| (exponent * parts).round() / parts);
    let near = candidates.into_iter().find(|candidate| (candidate - exponent).abs() < 1e-5);
    near.filter(|&exponent| exponent != 0.0).unwrap_or(exponent)
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_scenario::language::expression::{Expression, Symbols};

    fn unbounded(text: &str) -> Unbounded {
        let expression = Expression::parse(text, &Symbols::new().with_time()).unwrap();
        Unbounded::of(expression.root(), [0.0, 8.0])
    }

    #[test]
    fn what_grows_without_bound_is_found_with_its_exponent() {
        let at = |time: f64, left: f64, right: f64| Singularity { time, exponents: [left, right] };
        for (text, expected) in [
            ("t^(-0.9)", at(0.0, 0.0, -0.9)),
            ("1/sqrt(t)", at(0.0, 0.0, -0.5)),
            ("abs(t - 1.03)^(-0.5)", at(1.03, -0.5, -0.5)),
            ("step(t - 2)*abs(t - 2)^(-1/3)", at(2.0, 0.0, -1.0 / 3.0)),
        ] {
            let found = unbounded(text);
            assert_eq!(found.found, [expected], "{text}");
            assert!(expected.has_integral());
        }
        let logarithm = unbounded("log(abs(t - 1.03))").found;
        assert!(logarithm.len() == 1 && logarithm[0].time == 1.03, "{logarithm:?}");
        assert!(logarithm[0].exponents.iter().all(|&e| e < 0.0 && e > -0.1), "{logarithm:?}");
        let periodic = unbounded("abs(sin(t))^(-0.5)").found;
        assert_eq!(periodic.len(), 3, "{periodic:?}");
    }

    #[test]
    fn what_lies_before_the_start_does_not_count() {
        let of = |text: &str, run: [f64; 2]| {
            let expression = Expression::parse(text, &Symbols::new().with_time()).unwrap();
            Unbounded::of(expression.root(), run)
        };
        for (start, length) in [(10.0, 0.2), (1.0, 100.0), (1e7, 2.0), (-3.0, 1.0), (1e-3, 5.0)] {
            let run = [start, start + length];
            for exponent in [-0.9, -0.5] {
                let found = of(&format!("(t - ({start}))^({exponent})"), run);
                let right = Singularity { time: start, exponents: [0.0, exponent] };
                assert!(found.found.len() == 1 && found.known_to.is_none(), "{start}: {found:?}");
                assert!(found.found[0].time == right.time && found.found[0].exponents[0] == 0.0, "{found:?}");
                assert!((found.found[0].exponents[1] - exponent).abs() < 1e-5, "{start}: {found:?}");
            }
            let found = of(&format!("(t - ({start}))^(-1.2)"), run).found;
            assert!(found.len() == 1 && !found[0].has_integral(), "{start}: {found:?}");
            assert_eq!(of(&format!("1/(t - ({start}) + 0.5)"), run), Unbounded::default(), "{start}");
        }
    }

    #[test]
    fn what_has_no_integral_is_told() {
        for (text, time) in [
            ("t^(-1.2)", 0.0),
            ("1/(t - 1.03)", 1.03),
            ("tan(t)", std::f64::consts::FRAC_PI_2),
            ("1/sin(t)", 0.0),
            ("gamma(t - 3.5)", 0.5),
            ("exp(1/t)", 0.0),
            ("(t - 1)^(-2)", 1.0),
            ("1/(8 - t)", 8.0),
        ] {
            let found = unbounded(text).found;
            let last = found.last().unwrap_or_else(|| panic!("{text}"));
            assert!(!last.has_integral() && (last.time - time).abs() < 1e-14, "{text}: {found:?}");
        }
    }

    #[test]
    fn bounded_functions_have_none() {
        for text in [
            "sin(t)/t",
            "1/(t*t - 2*t + 1.01)",
            "exp(-1/t)",
            "sqrt(t)",
            "t^2.5",
            "tan(t/6)",
            "(1 - cos(t))/t^2",
        ] {
            assert_eq!(unbounded(text), Unbounded::default(), "{text}");
        }
    }
}
