//! Units that stand beside the names of columns.

use crate::language::excerpt::excerpt;
use std::f64::consts::{PI, TAU};

/// What a column is multiplied by, or why that is not known, with the number if there is one.
pub(super) type Factor = Result<f64, (String, Option<f64>)>;

/// A name of a column and its unit, if any: "Time [s]", "Time (s)", "Time / s", "Time in s", "Time, s",
/// "Time/(s)".
pub(super) fn without_unit(name: &str) -> (&str, Option<&str>) {
    for (open, close) in [('[', ']'), ('(', ')')] {
        if let Some((front, unit)) = name.strip_suffix(close).and_then(|rest| rest.rsplit_once(open)) {
            let front = front.trim();
            let before_sign = front.strip_suffix('/').or_else(|| front.strip_suffix(" in"));
            let front = before_sign.unwrap_or(front).trim();
            if !front.is_empty() {
                return (front, Some(unit.trim()));
            }
        }
    }
    // The first sign behind which a unit stands: that in "S in N/mm²" is not the slash.
    let signs = ["/", " in ", ", "];
    let mut places: Vec<(usize, usize)> = signs
        .iter()
        .flat_map(|sign| name.match_indices(sign).map(|(place, _)| (place, place + sign.len())))
        .collect();
    places.sort_unstable();
    for (end, begin) in places {
        let (front, unit) = (name[..end].trim(), name[begin..].trim());
        if !front.is_empty() && is_unit(unit) {
            return (front, Some(unit));
        }
    }
    (name, None)
}

/// "f in Hertz": a word, and behind `in` another one, whether it is known as a unit or not.
pub(super) fn in_unit(name: &str) -> Option<(&str, &str)> {
    let (front, unit) = name.split_once(" in ")?;
    let is_word = |text: &str| !text.trim().is_empty() && !text.trim().contains(char::is_whitespace);
    is_word(unit).then_some((front.trim(), unit.trim()))
}

/// Words that are no part of the name of a frequency, in small letters.
const OF_FREQUENCIES: [&str; 14] = [
    "hz", "hertz", "mhz", "khz", "ghz", "rad", "rads", "radian", "radians", "krad", "mrad", "rpm", "cps",
    "cpm",
];
const LOGARITHMS: [&str; 4] = ["log", "lg", "ln", "logarithm"];

/// True if a heading says that what stands below are logarithms, as "log G'".
pub(super) fn says_logarithms(heading: &str) -> bool {
    let mut words = heading.split(|letter: char| !letter.is_alphabetic());
    words.any(|word| LOGARITHMS.contains(&word.to_lowercase().as_str()))
}

/// The unit in the heading of a time or a frequency: behind a name, in any brackets, or a word that is the
/// name of a unit, as in "w_Hz" and "w Hz"; the whole heading if its numbers are logarithms. What is left of
/// it may be no unit, and is refused then.
pub(super) fn unit_of_axis<'h>(own: &str, heading: &'h str) -> Option<&'h str> {
    let is_letter = |letter: char| letter.is_alphabetic() || letter == '°';
    let mut begin = None;
    let mut words: Vec<(usize, &str)> = Vec::new();
    for (place, letter) in heading.char_indices().chain([(heading.len(), ' ')]) {
        match begin {
            None if is_letter(letter) => begin = Some(place),
            Some(first) if !is_letter(letter) => {
                words.push((first, &heading[first..place]));
                begin = None;
            }
            _ => {}
        }
    }
    let among = |word: &str, known: &[&str]| known.contains(&word.to_lowercase().as_str());
    if words.iter().any(|(_, word)| among(word, &LOGARITHMS)) {
        return Some(heading);
    }
    let is_of_time = |word: &str| is_second(word) || known(word, &TIMES).is_some();
    let word = match own {
        "t" => words.last().filter(|(place, word)| *place > 0 && is_of_time(word)),
        _ => words.iter().find(|(_, word)| among(word, &OF_FREQUENCIES)),
    };
    let from_word = || word.map(|(place, _)| heading[*place..].trim_end_matches([')', ']', '}', '>', ' ']));
    let behind = without_unit(heading).1.or_else(|| in_unit(heading).map(|(_, unit)| unit));
    match behind {
        // "Time (action)" has no unit, whatever letters are those of a unit.
        Some(unit) if own == "t" && heading.ends_with(')') && !is_unit(&unit.to_lowercase()) => from_word(),
        Some(unit) if heading.ends_with([')', ']']) => Some(unit),
        // Of "w rad/s" the unit begins before the slash.
        Some(unit) => from_word().filter(|longer| longer.len() > unit.len()).or(Some(unit)),
        None => from_word(),
    }
}

/// The unit in a header cell, if what stands there is one: "(delta)" of "Tan(delta)" is none.
pub(super) fn unit_in(name: &str) -> Option<&str> {
    without_unit(name).1.filter(|unit| is_unit(unit) || begins_with_decibels(unit))
}

/// Words of units that take no prefix, and those that do.
const PLAIN: [&str; 51] = [
    "sec", "secs", "second", "seconds", "min", "minute", "minutes", "h", "hr", "hour", "hours", "d", "day",
    "days", "hz", "HZ", "radian", "radians", "rads", "deg", "dB", "°", "°C", "°F", "K", "%", "psi", "ksi",
    "dyn", "dyne", "t", "tonne", "tonnes", "lb", "lbf", "ft", "rpm", "cpm", "Ns", "PA", "KPA", "MPA", "GPA",
    "hertz", "Hertz", "HERTZ", "RAD", "RPM", "cps", "cycle", "cycles",
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
    let without: String =
        unit.chars().filter(|letter| !letter.is_whitespace() && !"*·⋅.^()".contains(*letter)).collect();
    let short = |part: &str| match part {
        "sec" | "second" | "seconds" => "s".to_owned(),
        "radian" | "radians" | "rads" => "rad".to_owned(),
        part => part.to_owned(),
    };
    let per: Vec<String> = without.split('/').map(short).collect();
    per.join("/").replace("sec-1", "s-1").replace("radians-1", "rads-1")
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
    let (said, small, unit) = (excerpt(unit), plain(&unit.to_lowercase()), plain(unit));
    match name {
        // These are known in capitals, too; prefixes are not, as those of mHz and MHz.
        "omega" | "f" => match small.as_str() {
            "hz" | "hertz" | "cps" | "c/s" | "cycle/s" | "cycles/s" => Ok(TAU),
            "rad/s" | "rads-1" => Ok(1.0),
            "1/s" | "s-1" | "/s" => Err((
                format!(
                    "a frequency in `{said}`, which may be rad/s or Hz; `units = {{ {name} = \"rad/s\" }}` or \"Hz\" says which"
                ),
                None,
            )),
            _ => {
                let reason = format!("a frequency in `{said}`, which is neither rad/s nor Hz");
                let turns = ["rpm", "cpm", "u/min", "rev/min", "r/min"].contains(&small.as_str()).then_some(1.0 / 60.0);
                let (known, unit) = (known(&unit, &FREQUENCIES), if name == "f" { 1.0 } else { TAU });
                Err((reason, turns.or(known).map(|hertz| hertz * unit)))
            }
        },
        "t" => match unit.as_str() {
            second if is_second(second) => Ok(1.0),
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
            "deg" | "°" | "degree" | "degrees" | "rad" => Err((
                format!("an angle in `{said}`, where its tangent is wanted, which no number in `units = {{ … }}` makes of it"),
                None,
            )),
            other => Err((format!("a loss factor in `{said}`"), (other == "%").then_some(0.01))),
        },
        _ => Ok(1.0),
    }
}

fn is_second(unit: &str) -> bool {
    matches!(unit, "s" | "S" | "sec" | "secs" | "second" | "seconds")
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
            ("S in N/mm²", "S", Some("N/mm²")),
            ("w in rad/s", "w", Some("rad/s")),
            ("w in 1/s", "w", Some("1/s")),
            ("w in Hertz", "w", Some("Hertz")),
            ("S in MPA", "S", Some("MPA")),
            ("creep/(1/MPa)", "creep", Some("1/MPa")),
            ("J / [1/Pa]", "J", Some("1/Pa")),
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
    fn headings_of_frequencies_pass_over_no_unit() {
        for (heading, unit) in [
            ("w", None),
            ("Angular frequency", None),
            ("Cycle frequency", None),
            ("w [RAD/S]", Some("RAD/S")),
            ("w (cps)", Some("cps")),
            ("w [x 10^3 rad/s]", Some("x 10^3 rad/s")),
            ("w Hz", Some("Hz")),
            ("w_Hz", Some("Hz")),
            ("w <Hz>", Some("Hz")),
            ("w rad/s", Some("rad/s")),
            ("w in foo", Some("foo")),
            ("Hz", Some("Hz")),
            ("rad/s", Some("rad/s")),
            ("log w [rad/s]", Some("log w [rad/s]")),
        ] {
            assert_eq!(unit_of_axis("omega", heading), unit, "{heading}");
        }
        for (heading, unit) in [
            ("Time", None),
            ("Time (action)", None),
            ("t", None),
            ("Time (MIN)", Some("MIN")),
            ("Time [ticks]", Some("ticks")),
            ("Time_ms", Some("ms")),
        ] {
            assert_eq!(unit_of_axis("t", heading), unit, "{heading}");
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
            ("omega", Some("RAD/S"), 1.0),
            ("omega", Some("RAD/SEC"), 1.0),
            ("f", Some("Hertz"), TAU),
            ("omega", Some("cps"), TAU),
            ("omega", Some("Cycles/s"), TAU),
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
            ("f", "U/min", Some(1.0 / 60.0)),
            ("f", "RPM", Some(1.0 / 60.0)),
            ("f", "MHZ", None),
            ("omega", "10 rad/s", None),
            ("omega", "rad", None),
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
