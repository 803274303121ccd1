//! What the sources of the strategies state holds here, and the page says so.

use fvi_rivals::{claims, growths};

/// The page of the book with both tables.
fn page() -> String {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../book/src/engines/strategies.md");
    std::fs::read_to_string(path).unwrap()
}

/// The last cells of a row of the page that begins like this one, as numbers.
fn last_cells<const N: usize>(page: &str, row: &str, of_it: usize) -> [f64; N] {
    let cells: Vec<&str> = row.split(" | ").collect();
    let beginning = cells[..of_it].join(" | ") + " | ";
    let found: Vec<&str> = page.lines().filter(|line| line.starts_with(&beginning)).collect();
    assert_eq!(found.len(), 1, "`cargo run --release -p fvi-rivals --example papers PAGE`: {beginning}");
    let numbers: Vec<f64> = found[0][beginning.len()..]
        .split(" | ")
        .map(|cell| cell.trim_matches(|c| " |≤≥".contains(c)).parse().unwrap_or(f64::NAN))
        .collect();
    numbers[..N].try_into().unwrap()
}

#[test]
fn every_strategy_does_what_its_source_states() {
    let page = page();
    let claims = claims().unwrap();
    for claim in &claims {
        assert!(claim.holds(), "{claim:?}");
        let [stated, found] = last_cells(&page, &claim.row(), 4);
        // Three digits are written, of what is rounding of a few steps a size.
        let room = if claim.is_rounding { 4.0 } else { 1.01 };
        let same =
            |written: f64, number: f64| written == number || (written / number).max(number / written) <= room;
        assert!(same(stated, claim.stated), "{stated}: {claim:?}");
        assert!(same(found, claim.found) || found.abs().max(claim.found) < 1e-10, "{found}: {claim:?}");
    }
    for strategy in [
        "naive",
        "hls",
        "uniform",
        "gardner",
        "relaxed",
        "short-memory",
        "oustaloup",
        "matsuda",
        "l1",
        "jiang",
        "baffet-hesthaven",
        "oblivious",
    ] {
        assert!(claims.iter().any(|claim| claim.strategy == strategy), "{strategy}");
    }
}

#[test]
fn operations_grow_as_theory_says() {
    let page = page();
    let growths = growths().unwrap();
    for growth in &growths {
        let room = if growth.expected > 0.4 { 0.15 } else { 0.1 };
        assert!((growth.found - growth.expected).abs() < room, "{growth:?}");
        let [expected, found] = last_cells(&page, &growth.row(None), 2);
        assert!((expected - growth.expected).abs() < 0.006, "{expected}: {growth:?}");
        assert!((found - growth.found).abs() < 0.006, "{found}: {growth:?}");
    }
    // Middle products and kept transforms take less than half of what the textbook's splitting does.
    let last = |name: &str| growths.iter().find(|growth| growth.strategy == name).unwrap().counts[2].1;
    assert!(last("relaxed") < 0.5 * last("hls"));
}
