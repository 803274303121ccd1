//! What the papers of the strategies state beside what is found here, and how operations grow:
//!
//!     cargo run --release -p fvi-rivals --example papers [PAGE]
//!
//! prints both tables in Markdown or, given a page, writes them over those in it. Exponents of time are
//! those of the map beside the page, `strategies/strategies.csv`.

use std::error::Error;
use std::path::Path;

use fvi_rivals::{claims, fitted_exponent, growths};

const CLAIMS: &str = "| strategy | source | what it states | kernel, parameters | stated | found |\n|---|---|---|---|---|---|\n";
const GROWTHS: &str =
    "| strategy | theory | its exponent | of operations | of time |\n|---|---|---|---|---|\n";

fn main() -> Result<(), Box<dyn Error>> {
    let page = std::env::args().nth(1);
    let map = page.as_deref().map(|page| Path::new(page).with_file_name("strategies/strategies.csv"));
    let times = map.map(std::fs::read_to_string).transpose()?.unwrap_or_default();
    let rows: String = claims()?.iter().map(|claim| claim.row() + "\n").collect();
    let fits: String = growths()?
        .iter()
        .map(|growth| {
            // At the tolerances of the map the window of a short memory is all of a run.
            let is_window = growth.strategy == "short-memory";
            let of_time = if is_window { None } else { time(&times, growth.strategy) };
            growth.row(of_time) + "\n"
        })
        .collect();
    let Some(page) = page else {
        print!("{CLAIMS}{rows}\n{GROWTHS}{fits}");
        return Ok(());
    };
    let text = std::fs::read_to_string(&page)?;
    let text = replaced(&text, CLAIMS, &rows).and_then(|text| replaced(&text, GROWTHS, &fits));
    std::fs::write(&page, text.ok_or_else(|| format!("{page}: a table is missing"))?)?;
    Ok(())
}

/// Exponent of the mean time of a step on s^½ at 10⁻⁸, from 2048 steps on.
fn time(table: &str, strategy: &str) -> Option<f64> {
    let rows = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let rows = rows.filter(|row| row.len() > 7 && row[0] == strategy && row[1] == "s^½" && row[5] == "1e-8");
    let points = rows.filter_map(|row| Some((row[2].parse().ok()?, row[7].parse().ok()?)));
    fitted_exponent(&points.filter(|&(steps, _)| steps >= 2048.0).collect::<Vec<_>>())
}

/// The page with other rows below a head.
fn replaced(page: &str, head: &str, rows: &str) -> Option<String> {
    let from = page.find(head)? + head.len();
    let to = from + page[from..].find("\n\n")? + 1;
    Some(format!("{}{rows}{}", &page[..from], &page[to..]))
}
