//! `fvi reproduce`: the page, its files, and that the committed page is what the program writes.

use crate::workplace::{Workplace, text};
use std::fs;
use std::path::{Path, PathBuf};

/// The exhibits of the papers, as the program lists them.
fn names_of_papers(place: &Workplace) -> Vec<String> {
    let list = text(&place.fvi(&["reproduce"]).stdout);
    let names = list.lines().filter_map(|line| line.split_whitespace().next());
    names.filter(|name| name.starts_with("jo-") || name.starts_with("hjo-")).map(str::to_owned).collect()
}

/// Reproduces exhibits into `out`; returns the page.
fn reproduce(place: &Workplace, names: &[&str]) -> String {
    let output = place.fvi(&[&["reproduce", "--out", "out", "--quiet"], names].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(output.stdout.is_empty() && output.stderr.is_empty());
    fs::read_to_string(place.path("out").join("reproduction.md")).unwrap()
}

/// Header and rows of a CSV file without quotes.
fn table(path: &Path) -> (Vec<String>, Vec<Vec<String>>) {
    let cells = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<_>>();
    let content = fs::read_to_string(path).unwrap();
    let mut lines = content.lines().map(cells);
    (lines.next().unwrap(), lines.collect())
}

/// The column of a CSV file whose name begins so, as numbers; empty cells are left out.
fn column(place: &Workplace, file: &str, name: &str) -> Vec<f64> {
    let (header, rows) = table(&place.path("out").join(file));
    let at =
        header.iter().position(|column| column.starts_with(name)).unwrap_or_else(|| panic!("{header:?}"));
    rows.iter().filter_map(|row| row[at].parse().ok()).collect()
}

/// Targets of the links and pictures of a page.
fn links(page: &str) -> Vec<&str> {
    page.split("](").skip(1).map(|rest| rest.split(')').next().unwrap()).collect()
}

#[test]
fn without_a_name_the_exhibits_are_listed() {
    let place = Workplace::new();
    let output = place.fvi(&["reproduce"]);
    assert!(output.status.success());
    let list = text(&output.stdout);
    for line in ["jo-fig-7", "hjo-fig-2", "hjo-table-2", "[HJO] Table 1: orders with the midpoint rule"] {
        assert!(list.contains(line), "{line}: {list}");
    }
    assert!(place.files().is_empty());
}

#[test]
fn an_unknown_name_is_bad_input_and_the_message_tells_the_known_ones() {
    let place = Workplace::new();
    let output = place.fvi(&["reproduce", "hjo-table-1", "hjo-table-3"]);
    assert_eq!(output.status.code(), Some(2));
    let message = text(&output.stderr);
    for word in ["hjo-table-3", "jo-fig-4", "hjo-table-2", "all"] {
        assert!(message.contains(word), "{word}: {message}");
    }
    assert!(place.files().is_empty());
}

#[test]
fn a_directory_that_cannot_be_made_is_named() {
    let place = Workplace::new();
    place.write("out", "in the way");
    let output = place.fvi(&["reproduce", "hjo-table-1", "--out", "out"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("out"), "{}", text(&output.stderr));
}

#[test]
fn every_exhibit_of_the_papers_is_on_the_page_with_files_that_hold_the_same_values() {
    let place = Workplace::new();
    let names = names_of_papers(&place);
    assert_eq!(names.len(), 13, "{names:?}");
    let page = reproduce(&place, &names.iter().map(String::as_str).collect::<Vec<_>>());
    for name in &names {
        assert!(page.contains(&format!("\n`fvi reproduce {name}`\n")), "{name}");
    }
    let files = links(&page);
    assert!(files.len() > 40, "{files:?}");
    for file in &files {
        let content = fs::read_to_string(place.path("out").join(file)).unwrap();
        assert!(content.len() > 50, "{file}");
        if file.ends_with(".svg") {
            assert!(content.starts_with("<svg") && content.trim_end().ends_with("</svg>"), "{file}");
        }
    }
    let written = fs::read_dir(place.path("out")).unwrap().count();
    let mut linked = files.clone();
    linked.sort_unstable();
    linked.dedup();
    assert_eq!(written, linked.len() + 1, "a file that the page does not show");

    // A table on the page against its file, cell by cell.
    let (_, rows) = table(&place.path("out").join("hjo-fig-6-errors.csv"));
    let section = page.split("([`hjo-fig-6-errors.csv`](hjo-fig-6-errors.csv))").nth(1).unwrap();
    let shown = section.lines().filter(|line| line.starts_with('|')).skip(2);
    let mut compared = 0;
    for (row, line) in rows.iter().zip(shown) {
        let cells = line.trim_matches('|').split('|').map(str::trim);
        for ((cell, shown), place) in row.iter().zip(cells).zip(0..) {
            let Ok(number) = cell.parse::<f64>() else {
                assert_eq!(shown, "–");
                continue;
            };
            let expected = match place {
                0 => format!("{number}"),
                odd if odd % 2 == 1 => format!("{number:.2e}"),
                _ => format!("{number:.2}"),
            };
            assert_eq!(shown, expected);
            compared += 1;
        }
    }
    assert_eq!(compared, 8 * 7 - 3);

    the_committed_page_is_the_one_written(&place, &page, &files);
}

/// `book/src/assurance/reproduction` is what `fvi reproduce all --out book/src/assurance/reproduction`
/// writes.
fn the_committed_page_is_the_one_written(place: &Workplace, page: &str, files: &[&str]) {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../book/src/assurance/reproduction");
    let committed = fs::read_to_string(folder.join("reproduction.md")).unwrap();
    for section in page.split("\n## ").skip(1) {
        assert!(
            committed.contains(section.trim_end()),
            "book/src/assurance/reproduction/reproduction.md is not up to date:\n{section}"
        );
    }
    for file in files.iter().filter(|file| file.ends_with(".csv")) {
        let read = |path: PathBuf| fs::read_to_string(path).unwrap_or_else(|error| panic!("{file}: {error}"));
        let same = read(folder.join(file)) == read(place.path("out").join(file));
        assert!(same, "book/src/assurance/reproduction/{file} is not up to date");
    }
}

#[test]
fn the_printed_orders_are_met_on_the_papers_step_sizes() {
    let place = Workplace::new();
    reproduce(&place, &["hjo-table-1", "hjo-table-2"]);
    for (file, margin) in [("hjo-table-1.csv", 0.2), ("hjo-table-2.csv", 0.12)] {
        let content = fs::read_to_string(place.path("out").join(file)).unwrap();
        let mut reader = csv::Reader::from_reader(content.as_bytes());
        let mut rows = 0;
        for row in reader.records() {
            let row = row.unwrap();
            let (printed, slope): (f64, f64) = (row[2].parse().unwrap(), row[3].parse().unwrap());
            assert!((slope - printed).abs() < margin, "{file}: {row:?}");
            rows += 1;
        }
        assert_eq!(rows, 9);
    }
}

#[test]
fn the_benchmark_and_the_integrator_meet_at_first_order_and_the_integrator_is_closer() {
    let place = Workplace::new();
    reproduce(&place, &["jo-fig-7"]);
    let file = "jo-fig-7-errors.csv";
    let ours = column(&place, file, "variational − exact");
    let benchmark = column(&place, file, "benchmark method − exact");
    assert_eq!((ours.len(), benchmark.len()), (7, 7));
    for name in ["order variational − exact", "order benchmark method − exact"] {
        let orders = column(&place, file, name);
        assert!(orders[2..].iter().all(|order| (order - 1.0).abs() < 0.05), "{name}: {orders:?}");
    }
    assert!(ours.iter().zip(&benchmark).all(|(ours, benchmark)| ours < benchmark));
}

#[test]
fn starting_weights_leave_the_order_of_the_coupling() {
    let place = Workplace::new();
    reproduce(&place, &["hjo-fig-8"]);
    let content = fs::read_to_string(place.path("out").join("hjo-fig-8.csv")).unwrap();
    let mut reader = csv::Reader::from_reader(content.as_bytes());
    let header = reader.headers().unwrap().clone();
    let last = reader.records().last().unwrap().unwrap();
    let order = |name: &str| {
        let name = format!("order {name}");
        let at =
            header.iter().position(|column| column == name).unwrap_or_else(|| panic!("{name}: {header:?}"));
        last[at].parse::<f64>().unwrap()
    };
    // Without memory the √t force alone sets 1.5; with a smooth force the main nodes set 2; the stages set
    // more.
    assert!((order("t^(5/2) without memory") - 1.5).abs() < 0.02);
    assert!(order("t^(5/2), BDF 3 with starting weights") < 1.9);
    assert!((order("t⁴, BDF 3 with starting weights") - 2.0).abs() < 0.02);
    assert!(order("t⁴, Radau IIA") > 3.0);
}
