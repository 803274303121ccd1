//! Results of an exhibit.

use super::table::Table;
use fvi_host::results::picture::Chart;

/// Results of an exhibit: pictures, tables, and printed values beside measured ones.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// Pictures, in the order of the page.
    pub pictures: Vec<Picture>,
    /// Tables, each a CSV file.
    pub tables: Vec<Table>,
    /// Printed and measured values.
    pub comparisons: Vec<Comparison>,
    /// Remarks, a paragraph each.
    pub remarks: Vec<String>,
}

/// A picture with its place among an exhibit's.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Suffix of its file's name; empty for the only file of an exhibit.
    pub name: &'static str,
    /// Description for readers who do not see the picture.
    pub caption: String,
    /// The picture.
    pub chart: Chart,
}

/// A printed value and the measured one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Comparison {
    /// Name of the compared quantity.
    pub quantity: String,
    /// As printed.
    pub paper: String,
    /// As measured.
    pub ours: String,
    /// Why they differ; empty where they agree.
    pub reason: String,
}

impl Findings {
    /// Adds a picture.
    pub fn with_picture(mut self, name: &'static str, caption: impl Into<String>, chart: Chart) -> Self {
        self.pictures.push(Picture { name, caption: caption.into(), chart });
        self
    }

    /// Adds a table.
    pub fn with_table(mut self, table: Table) -> Self {
        self.tables.push(table);
        self
    }

    /// Adds a value that agrees with the printed one.
    pub fn agrees(
        self,
        quantity: impl Into<String>,
        paper: impl Into<String>,
        ours: impl Into<String>,
    ) -> Self {
        self.differs(quantity, paper, ours, "")
    }

    /// Adds a value that differs from the printed one, and why.
    pub fn differs(
        mut self,
        quantity: impl Into<String>,
        paper: impl Into<String>,
        ours: impl Into<String>,
        reason: impl Into<String>,
    ) -> Self {
        self.comparisons.push(Comparison {
            quantity: quantity.into(),
            paper: paper.into(),
            ours: ours.into(),
            reason: reason.into(),
        });
        self
    }

    /// Adds a paragraph.
    pub fn with_remark(mut self, remark: impl Into<String>) -> Self {
        self.remarks.push(remark.into());
        self
    }
}
