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

fn steers(letter: char) -> bool {
    let turns = matches!(letter, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    turns || letter.is_control() && letter != '\n' && letter != '\t'
}

#[cfg(test)]
mod tests {
    use super::*;

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
