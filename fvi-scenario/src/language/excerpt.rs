//! Excerpts of input text for messages: on one line, short, and without control characters.

/// Largest number of characters of a value in a message.
const LONGEST: usize = 60;

/// Largest number of names in a message.
const MOST_NAMES: usize = 40;

/// A text on one line, cut after 60 characters, control characters written out.
pub fn excerpt(text: &str) -> String {
    let mut shown = String::new();
    let mut letters = 0;
    let mut words = text.split_whitespace();
    let mut word = words.next();
    while let Some(letters_of_word) = word {
        if !shown.is_empty() {
            shown.push(' ');
            letters += 1;
        }
        for letter in letters_of_word.chars() {
            if letters >= LONGEST {
                shown.push('…');
                return shown;
            }
            letters += 1;
            if letter.is_control() {
                shown.extend(letter.escape_default());
            } else {
                shown.push(letter);
            }
        }
        word = words.next();
    }
    shown
}

/// Names separated by commas, at most 40 of them.
pub fn excerpt_list(names: &[&str]) -> String {
    let shown: Vec<String> = names.iter().take(MOST_NAMES).map(|name| excerpt(name)).collect();
    let rest = names.len().saturating_sub(MOST_NAMES);
    if rest == 0 { shown.join(", ") } else { format!("{} and {rest} more", shown.join(", ")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_shown_is_short_and_harmless() {
        assert_eq!(excerpt("[1.0,\n  2.0]"), "[1.0, 2.0]");
        assert_eq!(excerpt("a\u{1b}[2Jb"), "a\\u{1b}[2Jb");
        assert_eq!(excerpt(&"ä".repeat(5_000_000)), format!("{}…", "ä".repeat(60)));
        assert_eq!(excerpt(&"x".repeat(60)), "x".repeat(60));
        let names: Vec<String> = (0..100).map(|index| format!("k{index}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        assert!(excerpt_list(&names).ends_with("k39 and 60 more"));
    }
}
