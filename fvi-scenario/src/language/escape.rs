//! Removal of control characters from texts that are printed on a terminal.

use std::borrow::Cow;

/// The text without characters that control a terminal: control characters except line feed and tab, and
/// those that change the direction of writing. Each is replaced by one with the same number of bytes, so that
/// offsets in the text stay valid.
pub fn visible(text: &str) -> Cow<'_, str> {
    if !text.chars().any(steers) {
        return Cow::Borrowed(text);
    }
    let shown = |letter: char| match (steers(letter), letter.len_utf8()) {
        (false, _) => letter,
        (true, 1) => '?',
        (true, 2) => '¿',
        (true, _) => '\u{fffd}',
    };
    Cow::Owned(text.chars().map(shown).collect())
}

/// The same on one line.
pub fn visible_line(text: &str) -> String {
    visible(text).replace('\n', " ")
}

/// Longest number, in digits, that is not written as a power of ten.
const LONGEST_NUMBER: usize = 24;

/// The text with numbers of many digits as powers of ten: 1e300 in place of a one with 300 zeros.
pub fn short_numbers(text: &str) -> Cow<'_, str> {
    let is_part = |byte: u8| byte.is_ascii_digit() || byte == b'.';
    if !text.as_bytes().windows(LONGEST_NUMBER + 1).any(|digits| digits.iter().all(|&byte| is_part(byte))) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(start) = rest.bytes().position(is_part) {
        let (before, from) = rest.split_at(start);
        let end = from.bytes().position(|byte| !is_part(byte)).unwrap_or(from.len());
        let (number, after) = from.split_at(end);
        shown.push_str(before);
        match number.parse::<f64>() {
            Ok(value) if number.len() > LONGEST_NUMBER && value.is_finite() => {
                shown.push_str(&format!("{value:e}"));
            }
            _ if number.len() > LONGEST_NUMBER => {
                shown.push_str(&number[..LONGEST_NUMBER]);
                shown.push('…');
            }
            _ => shown.push_str(number),
        }
        rest = after;
    }
    shown.push_str(rest);
    Cow::Owned(shown)
}

fn steers(letter: char) -> bool {
    let turns = matches!(letter, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    turns || letter.is_control() && letter != '\n' && letter != '\t'
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_many_digits_are_powers_of_ten() {
        assert_eq!(
            short_numbers(&format!("step = 1{} s, x = -0.{}5", "0".repeat(300), "0".repeat(99))),
            "step = 1e300 s, x = -5e-100"
        );
        assert_eq!(short_numbers(&format!("{}.", "7".repeat(400))), format!("{}…", "7".repeat(24)));
        let short = "lines 1.2.3, 0.1 and 9007199254740992 of 10";
        assert!(matches!(short_numbers(short), Cow::Borrowed(_)));
    }

    #[test]
    fn what_steers_a_terminal_is_replaced_byte_for_byte() {
        let text = "α \u{1b}[31mred\u{7f}\r\n\tC1 \u{9b}2J, turned \u{202e}txt";
        let shown = visible(text);
        assert_eq!(shown, "α ?[31mred??\n\tC1 ¿2J, turned \u{fffd}txt");
        assert_eq!(shown.len(), text.len());
        assert_eq!(visible_line("one\ntwo"), "one two");
        assert!(matches!(visible("ordinary: ½ pᵀM⁻¹p"), Cow::Borrowed(_)));
    }
}
