//! Sparse matrices as SciPy's archives: damaged as a whole, and put together from arrays that lie.

use super::checkpoints::change;
use super::domains::matrix_file;
use super::mutation::Generator;
use super::{Outcome, number};
use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Names of the arrays in an archive, and their files.
type Members = Vec<(&'static str, Vec<u8>)>;

fn array(kind: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n");
    [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), data].concat()
}

fn list(numbers: &[f64]) -> Vec<u8> {
    let data: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    array("<f8", &format!("({},)", numbers.len()), &data)
}

fn whole(numbers: &[i32]) -> Vec<u8> {
    let data: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    array("<i4", &format!("({},)", numbers.len()), &data)
}

/// A chain of ten springs in each of the three formats.
fn corpus() -> Vec<Members> {
    let entries: Vec<(i32, i32, f64)> = (0..10)
        .flat_map(|row| [(row, row - 1, -1.0), (row, row, 2.5), (row, row + 1, -1.0)])
        .filter(|&(_, column, _)| (0..10).contains(&column))
        .collect();
    let rows: Vec<i32> = entries.iter().map(|entry| entry.0).collect();
    let columns: Vec<i32> = entries.iter().map(|entry| entry.1).collect();
    let data: Vec<f64> = entries.iter().map(|entry| entry.2).collect();
    let ends: Vec<i32> = (0..=10).map(|end| rows.iter().filter(|&&row| row < end).count() as i32).collect();
    let with = |format: &str, places: [(&'static str, &[i32]); 2]| {
        let mut members = vec![("format.npy", array("|S3", "()", format.as_bytes()))];
        members.extend(places.map(|(name, numbers)| (name, whole(numbers))));
        members.extend([("shape.npy", whole(&[10, 10])), ("data.npy", list(&data))]);
        members
    };
    vec![
        with("csr", [("indices.npy", &columns), ("indptr.npy", &ends)]),
        // The matrix is symmetric: its columns are its rows.
        with("csc", [("indices.npy", &columns), ("indptr.npy", &ends)]),
        with("coo", [("row.npy", &rows), ("col.npy", &columns)]),
    ]
}

fn archive(members: &Members, method: CompressionMethod) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in members {
        writer.start_file(*name, SimpleFileOptions::default().compression_method(method)).unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// Tries archives, as many as the other kinds of input.
pub(crate) fn assail() {
    let (runs, seed) = (number("FVI_HOSTILE_RUNS", 300) as usize, number("FVI_HOSTILE_SEED", 1));
    let mut generator = Generator::new(seed);
    let corpus = corpus();
    for members in &corpus {
        for method in [CompressionMethod::Stored, CompressionMethod::Deflated] {
            assert_eq!(matrix_file("a.npz", &archive(members, method)), Ok(Outcome::Done));
        }
    }
    let mut counts: BTreeMap<Outcome, usize> = BTreeMap::new();
    for index in 0..runs {
        let mut members = corpus[generator.below(corpus.len())].clone();
        let other = &corpus[generator.below(corpus.len())];
        let method = [CompressionMethod::Stored, CompressionMethod::Deflated][generator.below(2)];
        let inside = generator.below(4) > 0;
        if inside {
            for _ in 0..=generator.below(3) {
                let place = generator.below(members.len());
                let like = &other[generator.below(other.len())].1;
                change(&mut members[place].1, like, &mut generator);
            }
        }
        let mut bytes = archive(&members, method);
        if !inside {
            change(&mut bytes, &archive(other, method), &mut generator);
        }
        let outcome = catch_unwind(AssertUnwindSafe(|| matrix_file("a.npz", &bytes)))
            .unwrap_or_else(|_| panic!("archive {index} of seed {seed} panics"))
            .unwrap_or_else(|broken| panic!("archive {index} of seed {seed}: {broken}"));
        *counts.entry(outcome).or_default() += 1;
    }
    let count = |outcome| counts.get(&outcome).copied().unwrap_or(0);
    let (refused, failed, done) = (count(Outcome::Refused), count(Outcome::Failed), count(Outcome::Done));
    println!("archives: {runs} inputs: {refused} refused, {failed} failed, {done} done");
    assert!(refused > 0 && done > 0 || runs == 0, "what is tried is stale");
}
