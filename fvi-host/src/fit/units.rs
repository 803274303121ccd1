//! Units as they are written, compared with each other.

/// True if two units differ by prefixes only, or both are angles.
pub(super) fn is_same_dimension(one: &str, other: &str) -> bool {
    let words = |unit: &str| -> Vec<String> {
        let words = unit.split(|sign: char| !sign.is_alphabetic() && sign != '°');
        words.filter(|word| !word.is_empty()).map(str::to_owned).collect()
    };
    let base = |word: &str| word.chars().skip(1).collect::<String>();
    let is_angle = |word: &str| ["rad", "deg", "°"].contains(&word);
    let (one, other) = (words(one), words(other));
    one.len() == other.len()
        && one.iter().zip(&other).all(|(one, other)| {
            let (short, long) = (base(one), base(other));
            one == other
                || short == *other
                || long == *one
                || !short.is_empty() && short == long
                || is_angle(one) && is_angle(other)
        })
}

/// A unit without blanks, with ^-1 for ⁻¹.
pub(super) fn plain(unit: &str) -> String {
    let without: String = unit.chars().filter(|sign| !sign.is_whitespace()).collect();
    without.replace("⁻¹", "^-1").replace('−', "-")
}

/// The unit of the inverse of "1/Pa", "Pa^-1", "m/N"; `None` of others.
pub(super) fn inverse(unit: &str) -> Option<String> {
    let unit = plain(unit);
    if let Some(base) = unit.strip_suffix("^-1").or_else(|| unit.strip_suffix("-1")) {
        return Some(base.to_owned());
    }
    match unit.split('/').collect::<Vec<_>>().as_slice() {
        ["1" | "", below] => Some((*below).to_owned()),
        [above, below] => Some(format!("{below}/{above}")),
        _ => None,
    }
}

/// True for units of stresses, and so of moduli: "kPa", "N/mm^2", "psi".
pub(super) fn is_stress(unit: &str) -> bool {
    let unit = plain(unit).replace('²', "^2").replace("^2", "2");
    let prefixed = |base: &str| unit.strip_suffix(base).is_some_and(|prefix| prefix.chars().count() <= 1);
    prefixed("Pa") || prefixed("bar") || ["psi", "ksi", "N/m2", "N/mm2", "dyn/cm2"].contains(&unit.as_str())
}

/// What a unit of a motion by a force is that of: 0 of displacements, "m/N", 1 of velocities, "(m/s)/N",
/// "m/(N s)", 2 of accelerations, "m/s^2/N", "g/N"; `None` of other units.
pub(super) fn motion_by_force(unit: &str) -> Option<u8> {
    let (mut words, unit) =
        (unit.split(|sign: char| !sign.is_alphabetic()).filter(|word| !word.is_empty()), plain(unit));
    let first = words.next()?;
    let is_angle = ["rad", "deg"].contains(&first);
    let is_length =
        is_angle || ["in", "ft"].contains(&first) || first.strip_suffix('m').is_some_and(|p| p.len() <= 2);
    let rest: Vec<&str> = words.collect();
    let is_force =
        |word: &&str| word.strip_suffix('N').is_some_and(|p| p.len() <= 1) || ["lbf", "Nm"].contains(word);
    if !rest.iter().any(is_force) || !(is_length || first == "g") {
        return None;
    }
    let squares = ["s^2", "s²", "s2", "s^-2", "s⁻²", "s-2"];
    Some(match rest.contains(&"s") {
        _ if first == "g" || squares.iter().any(|square| unit.contains(square)) => 2,
        true => 1,
        false => 0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moduli_and_motions_are_told_by_their_units() {
        for (unit, stress) in [
            ("Pa", true),
            ("kPa", true),
            ("N/mm²", true),
            ("psi", true),
            ("N/m", false),
            ("1/Pa", false),
            ("m/N", false),
        ] {
            assert_eq!(is_stress(unit), stress, "{unit}");
        }
        for (unit, derivative) in [
            ("m/N", Some(0)),
            ("µm/N", Some(0)),
            ("rad/(N m)", Some(0)),
            ("m/s/N", Some(1)),
            ("(m/s)/N", Some(1)),
            ("m/(N s)", Some(1)),
            ("mm/s^2/N", Some(2)),
            ("m s⁻² N⁻¹", Some(2)),
            ("g/N", Some(2)),
            ("N/m", None),
            ("dB", None),
            ("1/kg", None),
            ("m", None),
        ] {
            assert_eq!(motion_by_force(unit), derivative, "{unit}");
        }
    }

    #[test]
    fn dimensions_are_told_apart_by_their_words() {
        for (one, other) in [("mm", "m"), ("m", "µm"), ("kPa", "MPa"), ("mm/s", "m/s"), ("deg", "rad")] {
            assert!(is_same_dimension(one, other), "{one} {other}");
        }
        for (one, other) in [("m", "rad"), ("m/s", "rad/s"), ("m", "s"), ("m", "N m")] {
            assert!(!is_same_dimension(one, other), "{one} {other}");
        }
    }

    #[test]
    fn inverses_of_units_are_found() {
        for (unit, known) in
            [("1/Pa", "Pa"), ("1 / kPa", "kPa"), ("Pa^-1", "Pa"), ("Pa⁻¹", "Pa"), ("m/N", "N/m")]
        {
            assert_eq!(inverse(unit).as_deref(), Some(known));
        }
        assert_eq!(inverse("m^2/N/s"), None);
    }
}
