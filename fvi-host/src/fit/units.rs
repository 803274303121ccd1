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

#[cfg(test)]
mod tests {
    use super::*;

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
