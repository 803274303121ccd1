//! Prints the tables of what goes with what, or writes them into their page of the book: `cargo run -p
//! fvi-scenario --example combinations book/src/use/combinations.md`.

use fvi_scenario::scenario::{COMBINATIONS_MARK, combinations_page};

fn main() -> std::io::Result<()> {
    let Some(path) = std::env::args().nth(1) else {
        print!("{}", combinations_page());
        return Ok(());
    };
    let page = std::fs::read_to_string(&path)?;
    let prose = page.split_once(COMBINATIONS_MARK).map_or(page.as_str(), |(prose, _)| prose);
    std::fs::write(path, format!("{prose}{COMBINATIONS_MARK}{}", combinations_page()))
}
