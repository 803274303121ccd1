//! Rows and cells of a text, before anything is known of its columns.

/// A row of the file: its line, and its cells.
pub(super) type Row = (u64, Vec<String>);

/// What stands in place of a number that is missing, in small letters.
const MISSING: [&str; 32] = [
    "",
    "-",
    "--",
    "---",
    "–",
    "—",
    "−",
    "nan",
    "-nan",
    "+nan",
    "nan(ind)",
    "-nan(ind)",
    "1.#qnan",
    "-1.#qnan",
    "1.#ind",
    "-1.#ind",
    "na",
    "n/a",
    "n.a.",
    "n.a",
    "#n/a",
    "#nv",
    "#div/0!",
    "#value!",
    "#num!",
    "#ref!",
    "#null!",
    "null",
    "nil",
    "none",
    "<na>",
    "missing",
];

pub(super) fn is_missing(cell: &str) -> bool {
    MISSING.contains(&cell.to_lowercase().as_str())
}

/// The number of a cell; `1.5D+03`, as Fortran writes it, is one too.
pub(super) fn number_of(cell: &str, comma: bool) -> Option<f64> {
    let plain;
    let digits = if comma {
        if cell.contains('.') {
            return None;
        }
        plain = cell.replacen(',', ".", 1);
        plain.as_str()
    } else {
        cell
    };
    digits.parse().ok().or_else(|| {
        let (front, back) = digits.split_once(['D', 'd'])?;
        let is_digit = |sign: char| sign.is_ascii_digit() || "+-.".contains(sign);
        let are_digits = |part: &str| !part.is_empty() && part.chars().all(is_digit);
        (are_digits(front) && are_digits(back)).then(|| format!("{front}e{back}").parse().ok())?
    })
}

/// Separators in the order in which they are tried.
const SEPARATORS: [char; 4] = ['\t', ';', ',', ' '];

/// A text without its comments.
pub(super) struct Layout {
    /// Comments are empty lines here, so that the numbers of lines are those of the file.
    text: String,
    /// Lines that begin with #, without it, and their numbers.
    comments: Vec<(u64, String)>,
    /// The separator that the first line names, as `sep=;` of spreadsheets.
    said: Option<char>,
}

impl Layout {
    pub(super) fn of(text: &str) -> Result<Self, String> {
        // Old files end with ^Z.
        let text = text.trim_end_matches('\u{1a}').replace("\r\n", "\n").replace('\r', "\n");
        let mut layout = Self { text: String::new(), comments: Vec::new(), said: None };
        for (index, line) in text.lines().enumerate() {
            let lower = line.trim_matches('"').to_lowercase();
            let first_cell = lower.split(['\t', ';', ',', ' ']).next().unwrap_or_default();
            if let (0, Some(sign)) = (index, lower.strip_prefix("sep=")) {
                let mut signs = sign.chars();
                match (signs.next(), signs.next()) {
                    (Some(sign @ ('\t' | ';' | ',' | ' ' | '|')), None) => layout.said = Some(sign),
                    _ => {
                        return Err(format!(
                            "`sep={sign}`: a tab, a semicolon, a comma, a space or | is wanted"
                        ));
                    }
                }
            } else if line.starts_with('#') && !is_missing(first_cell) {
                layout.comments.push((index as u64 + 1, line.trim_start_matches('#').to_owned()));
            } else {
                layout.text += line;
            }
            layout.text.push('\n');
        }
        Ok(layout)
    }

    /// The separators that are possible; a comma comes last where it may stand before decimals.
    pub(super) fn separators(&self, comma: bool) -> Vec<char> {
        let mut all = SEPARATORS.to_vec();
        if comma {
            all.swap(2, 3);
        }
        self.said.map_or(all, |sign| vec![sign])
    }

    /// The separator of the first line with content.
    pub(super) fn of_first_line(&self) -> char {
        let first = self.text.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
        let found = SEPARATORS.into_iter().find(|&separator| first.contains(separator));
        self.said.or(found).unwrap_or(',')
    }

    /// The cells of a line that stand below those of a header, where both are separated by spaces: their ends
    /// or their beginnings are in line. `None` if they are not.
    pub(super) fn below(&self, header: u64, line: u64) -> Option<Vec<String>> {
        let words = |line: u64| self.text.lines().nth(line as usize - 1).map_or_else(Vec::new, words);
        let (header, cells) = (words(header), words(line));
        let place = |of: fn(&Word<'_>) -> usize| -> Option<Vec<String>> {
            let mut row = vec![String::new(); header.len()];
            for cell in &cells {
                row[header.iter().position(|name| of(name) == of(cell))?] = cell.text.to_owned();
            }
            Some(row)
        };
        place(|word| word.end).or_else(|| place(|word| word.begin))
    }

    pub(super) fn rows(&self, separator: char) -> Result<Vec<Row>, csv::Error> {
        separated(&self.text, separator)
    }

    /// The comments as rows: a header may be one of them.
    pub(super) fn comments(&self, separator: char) -> Vec<Row> {
        let of = |(line, text): &(u64, String)| {
            let rows = separated(text, separator).ok()?;
            rows.into_iter().next().map(|(_, cells)| (*line, cells))
        };
        self.comments.iter().filter_map(of).collect()
    }
}

/// A text with one space between its words, of whatever kind and however many stand there.
pub(super) fn squeezed(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A word of a line, with the places of its letters.
struct Word<'a> {
    text: &'a str,
    begin: usize,
    end: usize,
}

/// The words between the spaces of a line; brackets hold together, "[rad / s]".
fn words(line: &str) -> Vec<Word<'_>> {
    let mut found = Vec::new();
    let (mut begin, mut open) = (None, 0_u32);
    for (index, (byte, letter)) in line.char_indices().chain([(line.len(), '\n')]).enumerate() {
        match letter {
            '[' | '(' => open += 1,
            ']' | ')' => open = open.saturating_sub(1),
            _ => {}
        }
        // What is not closed again holds nothing together.
        let holds = open > 0 && line[byte..].contains([']', ')']);
        match begin {
            None if !letter.is_whitespace() => begin = Some((index, byte)),
            Some((from, first)) if letter.is_whitespace() && !holds => {
                found.push(Word { text: &line[first..byte], begin: from, end: index });
                begin = None;
            }
            _ => {}
        }
    }
    found
}

/// The rows of a text that is separated by tabs, semicolons, commas or bars, or by spaces.
fn separated(text: &str, separator: char) -> Result<Vec<Row>, csv::Error> {
    let spaced;
    let (text, separator) = if separator == ' ' {
        let line = |line| words(line).into_iter().map(|word| word.text).collect::<Vec<_>>().join("\t");
        spaced = text.lines().map(line).collect::<Vec<_>>().join("\n");
        (spaced.as_str(), '\t')
    } else {
        (text, separator)
    };
    let mut reader = csv::ReaderBuilder::new();
    let reader = reader.trim(csv::Trim::All).has_headers(false).flexible(true);
    let mut rows = Vec::new();
    // The reader tells where it was before it skipped empty lines.
    let (mut place, mut line) = (0, 1);
    for record in reader.delimiter(separator as u8).from_reader(text.as_bytes()).records() {
        let record = record?;
        let begin = record.position().map_or(place, |position| position.byte() as usize);
        let empty = text.as_bytes()[begin..].iter().take_while(|byte| **byte == b'\n').count();
        line += text.as_bytes()[place..begin + empty].iter().filter(|byte| **byte == b'\n').count() as u64;
        place = begin + empty;
        let row: Vec<String> = record.iter().map(squeezed).collect();
        if row.iter().any(|cell| !cell.is_empty()) {
            rows.push((line, row));
        }
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimal_commas_are_not_guessed() {
        assert_eq!((number_of("1,5", true), number_of("1.5", false)), (Some(1.5), Some(1.5)));
        assert_eq!((number_of("1,5", false), number_of("1,234.5", true)), (None, None));
        assert_eq!((number_of("1.5D+03", false), number_of("D", false)), (Some(1500.0), None));
    }

    #[test]
    fn spaces_divide_outside_of_brackets() {
        let texts = |line| words(line).into_iter().map(|word| word.text).collect::<Vec<_>>();
        assert_eq!(texts("  f  [rad / s] (° C)x "), ["f", "[rad / s]", "(° C)x"]);
        assert_eq!(texts("G) (a b c"), ["G)", "(a", "b", "c"]);
    }

    #[test]
    fn cells_stand_below_the_names_that_they_are_in_line_with() {
        let below =
            |header: &str, cells: &str| Layout::of(&format!("{header}\n{cells}\n")).unwrap().below(1, 2);
        assert_eq!(below("Index     °t    f", "         [s] [Hz]").unwrap(), ["", "[s]", "[Hz]"][..]);
        assert_eq!(below("Index  t  f     G", "       s  Hz").unwrap(), ["", "s", "Hz", ""][..]);
        assert_eq!(below("Index  t  f", " s  Hz"), None);
    }

    #[test]
    fn lines_keep_their_numbers() {
        let layout = Layout::of("sep=;\r\n# note\r\nt;q0\r\n\r\n1;2\r\n#N/A;3\r\n").unwrap();
        assert_eq!(layout.separators(false), [';']);
        let rows = layout.rows(';').unwrap();
        let lines: Vec<u64> = rows.iter().map(|row| row.0).collect();
        assert_eq!(lines, [3, 5, 6]);
        assert_eq!(layout.comments(';'), [(2, vec!["note".to_owned()])]);
        assert!(Layout::of("sep=x\nt,q0\n").is_err());
    }
}
