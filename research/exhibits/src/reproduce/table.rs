//! Tables: all digits in a CSV file, a few on the page.

/// A table with named columns.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Suffix of its file's name; empty for the only file of an exhibit.
    pub name: &'static str,
    /// Heading on the page.
    pub caption: String,
    /// Its columns.
    pub columns: Vec<Column>,
    /// Its rows, a cell for each column.
    pub rows: Vec<Vec<Cell>>,
    /// True if the page shows it, or only links to its file.
    pub shown: bool,
}

/// A column of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Its name in the file.
    pub name: String,
    /// Its heading on the page.
    pub heading: String,
    /// How the page shows its numbers.
    pub format: Format,
}

/// How the page shows a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// With enough digits to restore the same number.
    Exact,
    /// With three digits and an exponent.
    Error,
    /// With two decimals.
    Order,
}

/// A cell of a table.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// A number.
    Number(f64),
    /// A word.
    Text(String),
    /// No value.
    Empty,
}

impl From<f64> for Cell {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl From<Option<f64>> for Cell {
    fn from(number: Option<f64>) -> Self {
        number.map_or(Self::Empty, Self::Number)
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl Column {
    /// A column.
    pub fn new(name: impl Into<String>, format: Format) -> Self {
        let name = name.into();
        Self { heading: name.clone(), name, format }
    }

    /// The column with a shorter heading on the page.
    pub fn headed(mut self, heading: &str) -> Self {
        heading.clone_into(&mut self.heading);
        self
    }

    /// Text of a cell on the page.
    fn show(&self, cell: &Cell) -> String {
        match cell {
            Cell::Empty => "–".to_owned(),
            Cell::Text(text) => text.clone(),
            Cell::Number(number) => match self.format {
                Format::Exact => format!("{number}"),
                Format::Error => format!("{number:.2e}"),
                Format::Order => format!("{number:.2}"),
            },
        }
    }
}

impl Table {
    /// An empty table that the page shows.
    pub fn new(name: &'static str, caption: impl Into<String>, columns: Vec<Column>) -> Self {
        Self { name, caption: caption.into(), columns, rows: Vec::new(), shown: true }
    }

    /// The columns of curves over a common axis: rows are points.
    pub fn of_curves(
        name: &'static str,
        caption: impl Into<String>,
        columns: &[&str],
        rows: impl IntoIterator<Item = Vec<Cell>>,
    ) -> Self {
        let columns = columns.iter().map(|&name| Column::new(name, Format::Exact)).collect();
        Self { rows: rows.into_iter().collect(), shown: false, ..Self::new(name, caption, columns) }
    }

    /// Adds a row, a cell for each column.
    pub fn with_row(mut self, row: impl IntoIterator<Item = Cell>) -> Self {
        self.rows.push(row.into_iter().collect());
        self
    }

    /// The table as CSV: a header, numbers with enough digits to restore them, and nothing for
    /// [`Cell::Empty`].
    pub fn csv(&self) -> String {
        let line = |cells: Vec<String>| cells.join(",") + "\n";
        let mut text = line(self.columns.iter().map(|column| quoted(&column.name)).collect());
        for row in &self.rows {
            let cell = |cell: &Cell| match cell {
                Cell::Number(number) => format!("{number:?}"),
                Cell::Text(text) => quoted(text),
                Cell::Empty => String::new(),
            };
            text += &line(row.iter().map(cell).collect());
        }
        text
    }

    /// The table as Markdown, with the digits of its columns' formats.
    pub fn markdown(&self) -> String {
        let head = self.columns.iter().map(|column| column.heading.as_str());
        let rows = self.rows.iter().map(|row| {
            self.columns.iter().zip(row).map(|(column, cell)| column.show(cell)).collect::<Vec<_>>()
        });
        markdown_table(head, rows)
    }
}

/// A Markdown table of texts.
pub(super) fn markdown_table<'a>(
    head: impl Iterator<Item = &'a str>,
    rows: impl Iterator<Item = Vec<String>>,
) -> String {
    let line = |cells: &[String]| {
        let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let head: Vec<String> = head.map(str::to_owned).collect();
    let mut text = line(&head) + &format!("|{}\n", "---|".repeat(head.len()));
    rows.for_each(|row| text += &line(&row));
    text
}

/// A cell of a CSV file, in quotes where it needs them.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_has_all_digits_and_the_page_a_few() {
        let columns = vec![
            Column::new("h", Format::Exact),
            Column::new("error, BDF 1", Format::Error),
            Column::new("order of BDF 1", Format::Order).headed("order"),
        ];
        let third = 1.0 / 3.0;
        let table = Table::new("", "Errors", columns)
            .with_row([0.5.into(), third.into(), None.into()])
            .with_row([0.25.into(), 1e-7.into(), third.into()]);
        let csv = table.csv();
        assert_eq!(
            csv,
            "h,\"error, BDF 1\",order of BDF 1\n0.5,0.3333333333333333,\n0.25,1e-7,0.3333333333333333\n"
        );
        let page = table.markdown();
        assert!(page.starts_with("| h | error, BDF 1 | order |\n"), "{page}");
        assert!(page.contains("| 0.5 | 3.33e-1 | – |\n| 0.25 | 1.00e-7 | 0.33 |\n"), "{page}");
    }
}
