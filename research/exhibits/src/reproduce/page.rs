//! The files of a reproduction: pictures, CSV files and the page with comparisons.

use super::table::markdown_table;
use super::{Comparison, Exhibit, Findings, accuracy, automatic, equations, materials};
use fvi_host::results::files::{FileError, write_picture, write_text};
use fvi_host::results::output_directory::OutputDirectory;

/// Name of the page in the output directory that holds all exhibits but those with a page of their own.
pub const PAGE: &str = "reproduction.md";

/// Writes pictures and tables of the exhibits, then the pages about them; each file appears
/// atomically.
///
/// # Errors
/// [`FileError`].
pub fn write(found: &[(Exhibit, Findings)], directory: &OutputDirectory) -> Result<(), FileError> {
    for (exhibit, findings) in found {
        for picture in &findings.pictures {
            write_picture(&directory.join(file_name(exhibit, picture.name, "svg")), &picture.chart)?;
        }
        for table in &findings.tables {
            write_text(&directory.join(file_name(exhibit, table.name, "csv")), &table.csv())?;
        }
    }
    for (name, head) in [
        (PAGE, HEAD),
        (accuracy::PAGE, accuracy::HEAD),
        (materials::PAGE, materials::HEAD),
        (equations::PAGE, equations::HEAD),
        (automatic::PAGE, automatic::HEAD),
    ] {
        let on_page: Vec<_> = found.iter().filter(|(exhibit, _)| exhibit.page == name).collect();
        if !on_page.is_empty() {
            let sections = on_page.iter().map(|(exhibit, findings)| section(exhibit, findings));
            write_text(&directory.join(name), &(head.to_owned() + &sections.collect::<String>()))?;
        }
    }
    Ok(())
}

/// `hjo-fig-4-errors.svg`: name of the exhibit, suffix that distinguishes its files, extension.
fn file_name(exhibit: &Exhibit, part: &str, ending: &str) -> String {
    let name = exhibit.name;
    if part.is_empty() { format!("{name}.{ending}") } else { format!("{name}-{part}.{ending}") }
}

/// Head of the page.
const HEAD: &str = "# Figures and tables of the papers, computed again\n\n\
    `fvi reproduce all` writes this page, its pictures and the CSV files behind them; `fvi reproduce NAME` \
    makes one exhibit. Keys are those of `REFERENCES.md`. Errors are the largest over the grid points of a \
    run unless a heading says otherwise; *order* is that between a step size and the next longer \
    one, *slope* that of the line of least squares through the logarithms. [BCGI] prints no numbers: \
    `fvi extremal` solves its equations. Figures that are drawings only are left out.\n";

fn section(exhibit: &Exhibit, findings: &Findings) -> String {
    let mut text = format!("\n## {}\n\n`fvi reproduce {}`\n", exhibit.heading(), exhibit.name);
    for picture in &findings.pictures {
        text += &format!("\n![{}]({})\n", picture.caption, file_name(exhibit, picture.name, "svg"));
    }
    if !findings.comparisons.is_empty() {
        let head = ["", "paper", "here", "why they differ"];
        let rows = findings.comparisons.iter().map(|comparison| {
            let Comparison { quantity, paper, ours, reason } = comparison.clone();
            vec![quantity, paper, ours, reason]
        });
        text += &format!("\n{}", markdown_table(head.into_iter(), rows));
    }
    for table in &findings.tables {
        let file = file_name(exhibit, table.name, "csv");
        text += &format!("\n{} ([`{file}`]({file}))\n", table.caption);
        if table.shown {
            text += &format!("\n{}", table.markdown());
        }
    }
    for remark in &findings.remarks {
        text += &format!("\n{remark}\n");
    }
    text
}
