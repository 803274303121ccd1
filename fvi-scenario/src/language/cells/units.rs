//! Units that stand beside the names of columns.

use crate::language::excerpt::excerpt;
use std::f64::consts::{PI, TAU};

/// What a column is multiplied by, or why that is not known, with the number if there is one.
pub(super) type Factor = Result<f64, (String, Option<f64>)>;

/// A name of a column and its unit, if any: "Time [s]", "Time (s)", "Time / s", "Time in s", "Time, s".
pub(super) fn without_unit(name: &str) -> (&str, Option<&str>) {
    for (open, close) in [('[', ']'), ('(', ')')] {
        if let Some((front, unit)) = name.strip_suffix(close).and_then(|rest| rest.rsplit_once(open))
            && !front.trim().is_empty()
        {
            return (front.trim(), Some(unit.trim()));
        }
    }
    for sign in ["/", " in ", ", "] {
        for (place, _) in name.match_indices(sign) {
            let (front, unit) = (name[..place].trim(), name[place + sign.len()..].trim());
            if !front.is_empty() && is_unit(unit) {
                return (front, Some(unit));
            }
        }
    }
    (name, None)
}

/// The unit in a header cell, if what stands there is one: "(delta)" of "Tan(delta)" is none.
pub(super) fn unit_in(name: &str) -> Option<&str> {
    without_unit(name).1.filter(|unit| is_unit(unit) || begins_with_decibels(unit))
}

/// Words of units that take no prefix, and those that do.
const PLAIN: [&str; 39] = [
    "sec", "secs", "second", "seconds", "min", "minute", "minutes", "h", "hr", "hour", "hours", "d", "day",
    "days", "hz", "HZ", "radian", "radians", "rads", "deg", "dB", "°", "°C", "°F", "K", "%", "psi", "ksi",
    "dyn", "dyne", "t", "tonne", "tonnes", "lb", "lbf", "ft", "rpm", "cpm", "Ns",
];
const PREFIXED: [&str; 14] = ["s", "S", "Hz", "rad", "Pa", "bar", "N", "Nm", "m", "g", "J", "W", "V", "A"];
const PREFIXES: [&str; 13] = ["", "k", "M", "G", "T", "m", "µ", "μ", "u", "n", "p", "c", "d"];

/// True for products, quotients and powers of the words of units, "N s/m", "rad·s⁻¹", "1/s".
pub(super) fn is_unit(text: &str) -> bool {
    let is_letter = |letter: char| letter.is_alphabetic() || "°%".contains(letter);
    let is_sign = |letter: char| letter.is_ascii_digit() || " /*·⋅.^-−()⁻⁰¹²³⁴⁵⁶⁷⁸⁹".contains(letter);
    let begins_as_number = text.starts_with(|sign: char| sign.is_ascii_digit() || "+-−.,".contains(sign));
    let is_quotient = text.replace(' ', "").starts_with("1/") || text.starts_with("10^");
    if begins_as_number && !is_quotient || !text.chars().all(|letter| is_letter(letter) || is_sign(letter)) {
        return false;
    }
    let is_word = |word: &str| {
        let prefixed =
            |prefix: &&str| word.strip_prefix(*prefix).is_some_and(|base| PREFIXED.contains(&base));
        PLAIN.contains(&word) || PREFIXES.iter().any(prefixed)
    };
    let mut words = text.split(|letter: char| !is_letter(letter)).filter(|word| !word.is_empty()).peekable();
    words.peek().is_some() && words.all(is_word)
}

pub(super) fn is_decibels(unit: &str) -> bool {
    unit.eq_ignore_ascii_case("dB")
}

/// "dB re 1 m/N", too.
fn begins_with_decibels(unit: &str) -> bool {
    unit.get(..2).is_some_and(is_decibels)
}

/// The unit with one sign for each of its operations.
fn plain(unit: &str) -> String {
    let unit = unit.replace("⁻¹", "-1").replace('−', "-");
    let word = |word: &str, by: &str, text: String| if text == word { by.to_owned() } else { text };
    let without: String =
        unit.chars().filter(|letter| !letter.is_whitespace() && !"*·⋅.^()".contains(*letter)).collect();
    let per: Vec<String> = without
        .split('/')
        .map(|part| {
            word(
                "sec",
                "s",
                word("second", "s", word("radians", "rad", word("radian", "rad", part.to_owned()))),
            )
        })
        .collect();
    per.join("/").replace("sec-1", "s-1")
}

/// What a column with this unit is multiplied by.
pub(super) fn factor_of(name: &str, unit: Option<&str>) -> Factor {
    let Some(unit) = unit else {
        return match name {
            "f" => Ok(TAU),
            "phase" => {
                let reason = "a phase without a unit; `units = { phase = \"deg\" }` or \"rad\" says which";
                Err((reason.to_owned(), None))
            }
            _ => Ok(1.0),
        };
    };
    let (said, unit) = (excerpt(unit), plain(unit));
    match name {
        "omega" | "f" => match unit.as_str() {
            "Hz" | "hz" | "HZ" => Ok(TAU),
            "rad/s" | "rads-1" | "Rad/s" => Ok(1.0),
            "1/s" | "s-1" | "/s" => Err((
                format!(
                    "a frequency in `{said}`, which may be rad/s or Hz; `units = {{ {name} = \"rad/s\" }}` or \"Hz\" says which"
                ),
                None,
            )),
            other => {
                let reason = format!("a frequency in `{said}`, which is neither rad/s nor Hz");
                let unit = if name == "f" { 1.0 } else { TAU };
                Err((reason, known(other, &FREQUENCIES).map(|hertz| hertz * unit)))
            }
        },
        "t" => match unit.as_str() {
            "s" | "secs" | "seconds" | "S" => Ok(1.0),
            other => Err((format!("a time in `{said}`, not in s"), known(other, &TIMES))),
        },
        "phase" => match unit.as_str() {
            "deg" | "°" | "degree" | "degrees" => Ok(PI / 180.0),
            "rad" => Ok(1.0),
            _ => {
                let reason =
                    "which is neither deg nor rad; `units = { phase = \"deg\" }` or \"rad\" says which";
                Err((format!("a phase in `{said}`, {reason}"), None))
            }
        },
        "magnitude" | "magnitude_deviation" if is_decibels(&unit) => Ok(1.0),
        "magnitude" if begins_with_decibels(&unit) => {
            let reason = "which may be of another unit than the scenario's; `units = { magnitude = \"dB\" }` takes them as its own";
            Err((format!("decibels in `{said}`, {reason}"), None))
        }
        _ if is_decibels(&unit) => Err((
            "decibels, which only a column `magnitude` is taken in, and `magnitude_deviation`; a deviation of it is in its own unit"
                .to_owned(),
            None,
        )),
        "tan_delta" => match unit.as_str() {
            "1" | "–" => Ok(1.0),
            other => Err((format!("a loss factor in `{said}`"), (other == "%").then_some(0.01))),
        },
        _ => Ok(1.0),
    }
}

/// Further units of frequencies, in Hz.
pub(super) const FREQUENCIES: [(&str, f64); 6] = [
    ("mHz", 1e-3),
    ("kHz", 1e3),
    ("MHz", 1e6),
    ("rpm", 1.0 / 60.0),
    ("deg/s", 1.0 / 360.0),
    ("°/s", 1.0 / 360.0),
];

const TIMES: [(&str, f64); 12] = [
    ("min", 60.0),
    ("minutes", 60.0),
    ("h", 3600.0),
    ("hr", 3600.0),
    ("hours", 3600.0),
    ("d", 86_400.0),
    ("days", 86_400.0),
    ("ms", 1e-3),
    ("µs", 1e-6),
    ("μs", 1e-6),
    ("us", 1e-6),
    ("ns", 1e-9),
];

fn known(unit: &str, units: &[(&str, f64)]) -> Option<f64> {
    units.iter().find(|(name, _)| *name == unit).map(|(_, factor)| *factor)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_divided_from_their_units() {
        for (cell, name, unit) in [
            ("Angular Frequency [rad/s]", "Angular Frequency", Some("rad/s")),
            ("Storage Modulus (Pa)", "Storage Modulus", Some("Pa")),
            ("Angular frequency / rad/s", "Angular frequency", Some("rad/s")),
            ("ω/rad/s", "ω", Some("rad/s")),
            ("G' in kPa", "G'", Some("kPa")),
            ("Time, min", "Time", Some("min")),
            ("Time in test", "Time in test", None),
            ("A/B", "A/B", None),
            ("G'", "G'", None),
            ("(Pa)", "(Pa)", None),
        ] {
            assert_eq!(without_unit(cell), (name, unit));
        }
        for (cell, unit) in
            [("Tan(delta)", None), ("Time (action)", None), ("Time (min)", Some("min")), ("E* (1 Hz)", None)]
        {
            assert_eq!(unit_in(cell), unit, "{cell}");
        }
    }

    #[test]
    fn words_of_units_are_told_from_others() {
        for unit in
            ["1/s", "N s/m", "rad·s⁻¹", "kg/m^3", "10^3 Pa", "°C", "%", "s^-1", "MPa", "N·s/m", "1 / s"]
        {
            assert!(is_unit(unit), "{unit}");
        }
        for other in ["", "1.0", "1e3", "-", "delta", "point", "1.0x", "G'", "5 s", "n/a"] {
            assert!(!is_unit(other), "{other}");
        }
    }

    #[test]
    fn units_of_frequencies_and_times_have_factors() {
        for (name, unit, factor) in [
            ("omega", Some("Hz"), TAU),
            ("omega", Some("rad / s"), 1.0),
            ("omega", Some("rad·s⁻¹"), 1.0),
            ("omega", Some("rad.s-1"), 1.0),
            ("omega", Some("radians/sec"), 1.0),
            ("f", Some("rad s^-1"), 1.0),
            ("f", None, TAU),
            ("omega", None, 1.0),
            ("t", Some("seconds"), 1.0),
        ] {
            assert_eq!(factor_of(name, unit), Ok(factor), "{name} in {unit:?}");
        }
        for (name, unit, number) in [
            ("omega", "1/s", None),
            ("f", "s⁻¹", None),
            ("omega", "log (rad/s)", None),
            ("omega", "kHz", Some(1e3 * TAU)),
            ("f", "kHz", Some(1e3)),
            ("t", "min", Some(60.0)),
            ("t", "test", None),
            ("tan_delta", "%", Some(0.01)),
        ] {
            let (reason, factor) = factor_of(name, Some(unit)).unwrap_err();
            assert_eq!(factor, number, "{name} in {unit}");
            assert!(reason.contains(&format!("`{unit}`")), "{name} in {unit}: {reason}");
        }
    }
}
