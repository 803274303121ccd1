//! Which features of a scenario go together: one table.
//!
//! A [`Feature`] is a predicate on a [`Scenario`], with the key that turns it on; a [`Row`] of [`ROWS`] says
//! which two do not go together, why, and what to use instead. The table is evaluated after a scenario has
//! been read, and again where a motion begins, since code may have changed it. What one table of a file
//! says against itself is its reader's; what needs matrices or numbers is refused where they are computed.

mod feature;
mod rows;

pub use feature::Feature;
pub use rows::ROWS;

use super::Scenario;
use crate::language::{InputError, Problem};
use std::fmt::Write as _;

/// Two features that do not go together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// The feature that errors name with its place and value.
    pub refused: Feature,
    /// The feature that it does not go with.
    pub beside: Feature,
    /// The reason; empty where it is plain.
    pub why: &'static str,
    /// What to use instead, in place of the value of `refused`.
    pub instead: &'static str,
}

impl Row {
    /// The error for a scenario that has both, or has the refused one and is put to the use beside it.
    fn error(&self, scenario: &Scenario) -> Option<InputError> {
        let index = self.refused.find(scenario)?;
        let mut with = if self.beside.is_use() {
            self.beside.name()
        } else {
            self.beside.shown(scenario, self.beside.find(scenario)?)
        };
        if !self.why.is_empty() {
            let _ = write!(with, ": {}", self.why);
        }
        if let Some(numbers) = self.refused.numbers(scenario) {
            let _ = write!(with, "; {numbers}");
        }
        let problem = Problem::Incompatible { with, allowed: self.instead.to_owned() };
        Some(scenario.error_at(&self.refused.path(scenario, index), problem))
    }
}

impl Scenario {
    /// Refuses features that do not go together.
    ///
    /// # Errors
    /// [`Problem::Incompatible`] for the first of [`ROWS`] whose features the scenario has.
    pub fn check_combinations(&self) -> Result<(), InputError> {
        self.check(|row| !row.beside.is_use())
    }

    /// Refuses features that do not go with a use of the scenario, such as [`Feature::Fit`].
    ///
    /// # Errors
    /// [`Problem::Incompatible`] for the first feature of [`ROWS`] that does not go with it.
    pub fn check_use(&self, used: Feature) -> Result<(), InputError> {
        self.check(|row| row.beside == used)
    }

    fn check(&self, applies: impl Fn(&Row) -> bool) -> Result<(), InputError> {
        let mut rows = ROWS.iter().filter(|row| applies(row));
        rows.find_map(|row| row.error(self)).map_or(Ok(()), Err)
    }
}

/// The line of the page of the book that [`page`] follows.
pub const MARK: &str =
    "<!-- printed by `cargo run -p fvi-scenario --example combinations book/src/use/combinations.md` -->\n\n";

/// The tables of the page of the book, in Markdown: the features with their keys, and what does not go
/// together.
pub fn page() -> String {
    let mut page = String::from("| feature | key | does not go with |\n|---|---|---|\n");
    for &feature in Feature::ALL {
        let others = ROWS.iter().filter_map(|row| match (row.refused == feature, row.beside == feature) {
            (true, _) => Some(row.beside),
            (_, true) => Some(row.refused),
            _ => None,
        });
        let others: Vec<_> = others.map(Feature::name).collect();
        let key = feature
            .keys()
            .next()
            .filter(|_| !feature.is_use())
            .map_or_else(String::new, |key| format!("`{key}`"));
        let _ = writeln!(page, "| {} | {key} | {} |", feature.name(), others.join("; "));
    }
    page += "\n| this | beside | does not go, because | instead |\n|---|---|---|---|\n";
    for Row { refused, beside, why, instead } in ROWS {
        let _ = writeln!(page, "| {} | {} | {why} | {instead} |", refused.name(), beside.name());
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::language::Document;
    use std::path::Path;

    fn refused(text: &str) -> InputError {
        Scenario::from_document(Document::new("test.toml", Path::new(""), text)).unwrap_err()
    }

    #[test]
    fn the_page_of_the_book_is_this_table() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../book/src/use/combinations.md");
        let text = std::fs::read_to_string(path).unwrap();
        let (_, printed) = text.split_once(MARK).unwrap();
        assert!(printed == page(), "print it anew: {MARK}");
    }

    #[test]
    fn errors_name_keys_that_the_file_has() {
        let equation = "[equation]\norder = 0.6\nright = \"-x0\"\ninitial = 1.0\n";
        let pendulum = "[system]\nmass = [1.0, 1.0]\npotential = \"9.81*q1\"\nconstraints = [\"q0^2 + q1^2 - 1\"]\n\
            [initial]\nposition = [1.0, 0.0]\n";
        let steps = "[time]\nstep = 0.01\nend = 1.0\n";
        let chosen = "[time]\nend = 1.0\ntolerance = 1e-6\n";
        let spring = "[[system.damping]]\norder = 0.0\ncoefficient = 1.0\nalong = \"q0\"\n";
        for (text, key, line, with) in [
            (
                format!("{equation}{chosen}[scheme]\nkind = \"galerkin\"\ndegree = 2\n"),
                "time.tolerance",
                7,
                "(`scheme.kind`)",
            ),
            (
                format!("{equation}[time]\nend = 1.0\n[scheme]\nkind = \"low-order\"\n"),
                "time.end",
                6,
                "(`scheme.kind`)",
            ),
            (
                format!("{pendulum}[convolution]\nat = \"main-nodes\"\n{steps}"),
                "convolution.at",
                8,
                "(`system.constraints`)",
            ),
            (format!("{pendulum}{chosen}"), "time.tolerance", 9, "(`system.constraints`)"),
            (
                format!("{pendulum}[scheme]\nkind = \"galerkin\"\ndegree = 2\npoints = 3\n{steps}"),
                "scheme.points",
                10,
                "(`system.constraints`)",
            ),
            (format!("{pendulum}{spring}{steps}"), "system.damping[0].order", 8, "(`system.constraints`)"),
        ] {
            let error = refused(&text);
            assert_eq!((error.key(), error.line()), (key, Some(line)), "{error}");
            assert!(error.to_string().contains(with), "{error}");
        }
    }

    #[test]
    fn defaults_are_called_defaults() {
        let text = "[system]\nmass = [1.0]\n[initial]\nposition = [1.0]\n\
            [time]\ngrid = \"points\"\npoints = [0.0, 0.1, 0.3]\n";
        let message = refused(text).to_string();
        assert!(message.contains("a multistep rule, the default of `convolution.family`:"), "{message}");
    }

    #[test]
    fn no_pair_is_in_the_table_twice() {
        for (index, row) in ROWS.iter().enumerate() {
            let same = |other: &&Row| {
                (other.refused, other.beside) == (row.refused, row.beside)
                    || (other.refused, other.beside) == (row.beside, row.refused)
            };
            assert_eq!(ROWS[..index].iter().find(same), None);
        }
    }
}
