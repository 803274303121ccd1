//! How far several runs of the same races agree about the fastest strategies and the fronts:
//!
//!     cargo run --release -p fvi-strategies --example agreement -- out/1 out/2 out/3
//!
//! with the directories that `fvi strategies FILE.toml --out DIRECTORY` has written.

use std::error::Error;
use std::path::Path;

use fvi_strategies::{Agreement, Record};

fn main() -> Result<(), Box<dyn Error>> {
    let mut runs: Vec<Record> = Vec::new();
    for directory in std::env::args().skip(1) {
        let path = Path::new(&directory).join("strategies.json");
        let named = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        let text = std::fs::read_to_string(&path).map_err(|error| named(&error))?;
        runs.push(serde_json::from_str(&text).map_err(|error| named(&error))?);
    }
    if runs.len() < 2 {
        println!("two directories of runs at least");
        return Ok(());
    }
    println!("{}", Agreement::of(&runs));
    Ok(())
}
