use super::*;
use std::io::{Cursor, Write};

fn market(text: &str) -> Result<FileMatrix, String> {
    read("a.mtx", text.as_bytes())
}

/// An archive of arrays of float64 or int32 numbers.
fn archive(members: &[(&str, Vec<u8>)], compressed: bool) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let method = if compressed { zip::CompressionMethod::Deflated } else { zip::CompressionMethod::Stored };
    for (name, bytes) in members {
        let options = zip::write::SimpleFileOptions::default().compression_method(method).large_file(true);
        writer.start_file(*name, options).unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

fn array(numbers: &[f64]) -> Vec<u8> {
    let mut bytes = npy::header(&[numbers.len()]);
    bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    bytes
}

/// The text `format` as NumPy stores `b"csr"`.
fn format_member(format: &str) -> Vec<u8> {
    let header = "{'descr': '|S3', 'fortran_order': False, 'shape': (), }\n";
    [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), format.as_bytes()]
        .concat()
}

fn sparse(format: &str, members: &[(&str, &[f64])], compressed: bool) -> Vec<u8> {
    let mut all = vec![("format.npy", format_member(format))];
    all.extend(members.iter().map(|(name, numbers)| (*name, array(numbers))));
    archive(&all, compressed)
}

#[test]
fn matrix_market_files_are_read_as_their_heads_say() {
    let symmetric = market(
        "%%MatrixMarket matrix coordinate real symmetric\n% a comment\n\n2 2 2\n1 1 4.0\n\n2 1 -1e0\n",
    )
    .unwrap();
    assert_eq!(
        symmetric,
        FileMatrix { rows: 2, columns: 2, entries: vec![(0, 0, 4.0), (1, 0, -1.0)], half: true }
    );
    let general = market("%%MatrixMarket MATRIX Array Integer general\n2 2\n1\n0\n3\n4\n").unwrap();
    assert_eq!(general.entries, [(0, 0, 1.0), (0, 1, 3.0), (1, 1, 4.0)]);
    let half = market("%%MatrixMarket matrix array real symmetric\n2 2\n1\n2\n3\n").unwrap();
    assert_eq!(half.entries, [(0, 0, 1.0), (1, 0, 2.0), (1, 1, 3.0)]);
    assert_eq!(
        read_vector("f.mtx", b"%%MatrixMarket matrix array real general\n3 1\n1\n0\n5\n").unwrap().numbers(),
        [1.0, 0.0, 5.0]
    );
}

#[test]
fn faults_of_matrix_market_files_are_named_by_their_lines() {
    let head = "%%MatrixMarket matrix coordinate real general\n";
    for (text, said) in [
        ("", "line 1"),
        ("%%MatrixMarket matrix coordinate complex general\n1 1 1\n1 1 1 0\n", "`complex`"),
        ("%%MatrixMarket matrix coordinate real skew-symmetric\n1 1 0\n", "`skew-symmetric`"),
        (&format!("{head}2 2 1\n3 1 1.0\n"), "line 3: `3` is not an index from 1 to 2"),
        (&format!("{head}2 2 1\n0 1 1.0\n"), "line 3: `0` is not an index"),
        (&format!("{head}2 2 1\n1 1 nan\n"), "line 3: `nan` is not a finite number"),
        (&format!("{head}2 2 2\n1 1 1\n"), "1 entries instead of 2"),
        (&format!("{head}2 2 1\n1 1 1\n2 2 1\n"), "line 4: more than 1 entries"),
        (&format!("{head}2 2 1\n1 1 1 7\n"), "line 3: `7` is too much"),
        (&format!("{head}99999999999 2 1\n1 1 1\n"), "more than can be used"),
        (&format!("{head}2 2 18446744073709551615\n1 1 1\n"), "entries instead of"),
    ] {
        let reason = market(text).unwrap_err();
        assert!(reason.contains(said), "{text:?}: {reason}");
    }
}

#[test]
fn sparse_archives_of_each_format_hold_the_same_matrix() {
    // [1 2; 0 3]
    let known = [(0, 0, 1.0), (0, 1, 2.0), (1, 1, 3.0)];
    let shape: (&str, &[f64]) = ("shape.npy", &[2.0, 2.0]);
    for compressed in [false, true] {
        let rows = sparse(
            "csr",
            &[
                ("indices.npy", &[0.0, 1.0, 1.0]),
                ("indptr.npy", &[0.0, 2.0, 3.0]),
                shape,
                ("data.npy", &[1.0, 2.0, 3.0]),
            ],
            compressed,
        );
        let columns = sparse(
            "csc",
            &[
                ("indices.npy", &[0.0, 0.0, 1.0]),
                ("indptr.npy", &[0.0, 1.0, 3.0]),
                shape,
                ("data.npy", &[1.0, 2.0, 3.0]),
            ],
            compressed,
        );
        let places = sparse(
            "coo",
            &[
                ("row.npy", &[0.0, 0.0, 1.0]),
                ("col.npy", &[0.0, 1.0, 1.0]),
                shape,
                ("data.npy", &[1.0, 2.0, 3.0]),
            ],
            compressed,
        );
        for bytes in [rows, columns, places] {
            assert_eq!(read("k.npz", &bytes).unwrap().entries, known);
        }
    }
}

#[test]
fn another_format_is_refused_whatever_its_data_look_like() {
    for format in ["bsr", "dia"] {
        let reason = read("k.npz", &sparse(format, &[("shape.npy", &[2.0, 2.0])], false)).unwrap_err();
        assert!(reason.contains(&format!("the format `{format}`; allowed: csr, csc, coo")), "{reason}");
    }
}

#[test]
fn forged_archives_are_refused() {
    let shape: (&str, &[f64]) = ("shape.npy", &[2.0, 2.0]);
    for (members, said) in [
        (
            vec![
                ("indices.npy", &[0.0, 2.0][..]),
                ("indptr.npy", &[0.0, 1.0, 2.0]),
                shape,
                ("data.npy", &[1.0, 1.0]),
            ],
            "not an index from 0 to 1",
        ),
        (
            vec![
                ("indices.npy", &[0.0, -1.0][..]),
                ("indptr.npy", &[0.0, 1.0, 2.0]),
                shape,
                ("data.npy", &[1.0, 1.0]),
            ],
            "not an index",
        ),
        (
            vec![
                ("indices.npy", &[0.0, 1.0][..]),
                ("indptr.npy", &[0.0, 9.0, 2.0]),
                shape,
                ("data.npy", &[1.0, 1.0]),
            ],
            "indptr",
        ),
        (
            vec![
                ("indices.npy", &[0.0][..]),
                ("indptr.npy", &[0.0, 1.0, 2.0]),
                shape,
                ("data.npy", &[1.0, 1.0]),
            ],
            "2 entries and 1 indices",
        ),
        (
            vec![
                ("indices.npy", &[0.0, 1.0][..]),
                ("indptr.npy", &[0.0, 1.0, 2.0]),
                shape,
                ("data.npy", &[1.0, f64::NAN]),
            ],
            "row 1, column 1",
        ),
        (
            vec![
                ("indices.npy", &[0.0, 0.5][..]),
                ("indptr.npy", &[0.0, 1.0, 2.0]),
                shape,
                ("data.npy", &[1.0, 1.0]),
            ],
            "entry 1 is 0.5",
        ),
        (
            vec![
                ("indices.npy", &[0.0, 1.0][..]),
                ("indptr.npy", &[0.0, 1.5, 2.0]),
                shape,
                ("data.npy", &[1.0, 1.0]),
            ],
            "indptr",
        ),
        (vec![("shape.npy", &[2.0, 2.5][..]), ("data.npy", &[1.0])], "2.5 columns"),
        (vec![shape, ("data.npy", &[1.0])], "indices.npy"),
    ] {
        let reason = read("k.npz", &sparse("csr", &members, true)).unwrap_err();
        assert!(reason.contains(said), "{reason}");
    }
    let whole = sparse(
        "csr",
        &[
            ("indices.npy", &[0.0]),
            ("indptr.npy", &[0.0, 1.0]),
            ("shape.npy", &[1.0, 1.0]),
            ("data.npy", &[1.0]),
        ],
        true,
    );
    assert!(read("k.npz", &whole).is_ok());
    for length in 0..whole.len() {
        assert!(read("k.npz", &whole[..length]).is_err(), "{length} bytes");
    }
}

/// An archive of arrays of one number, and the offset of the directory entry of the array `data`.
fn of_one_number(names: &[&str], compressed: bool) -> (Vec<u8>, usize) {
    let numbers: [&[f64]; 4] = [&[0.0], &[0.0, 1.0], &[1.0, 1.0], &[1.0]];
    let members: Vec<_> = names.iter().copied().zip(numbers.into_iter().cycle()).collect();
    let bytes = sparse("csr", &members, compressed);
    let name = bytes.windows(8).rposition(|name| name == b"data.npy").unwrap();
    (bytes, name - 46)
}

const CSR: [&str; 4] = ["indices.npy", "indptr.npy", "shape.npy", "data.npy"];

#[test]
fn members_that_cannot_be_read_as_they_are_meant_are_refused() {
    let refused = |bytes: &[u8], said: &str| {
        let reason = read("k.npz", bytes).unwrap_err();
        assert!(reason.contains(said), "{reason}");
    };
    let (mut encrypted, entry) = of_one_number(&CSR, true);
    encrypted[entry + 8] |= 1;
    refused(&encrypted, "data.npy: it is encrypted");
    let (mut packed, entry) = of_one_number(&CSR, true);
    packed[entry + 10] = 12;
    refused(&packed, "data.npy: compressed by method 12");
    // A second member renamed to the name of the first, wherever its name occurs.
    let (mut doubled, _) =
        of_one_number(&["indices.npy", "indptr.npy", "shape.npy", "data.npy", "datb.npy"], false);
    while let Some(place) = doubled.windows(8).position(|name| name == b"datb.npy") {
        doubled[place + 3] = b'a';
    }
    refused(&doubled, "data.npy: the archive has two members of this name");
    refused(&of_one_number(&CSR[1..], false).0, "indices.npy: the archive has no member of this name");
}

#[test]
fn a_changed_byte_is_noticed_or_changes_nothing() {
    for compressed in [false, true] {
        let (whole, _) = of_one_number(&CSR, compressed);
        let matrix = read("k.npz", &whole).unwrap();
        for (place, change) in (0..whole.len()).flat_map(|place| [1, 2, 0x80, 0xff].map(|bits| (place, bits)))
        {
            let mut bytes = whole.clone();
            bytes[place] ^= change;
            if let Ok(found) = read("k.npz", &bytes) {
                assert_eq!(found, matrix, "byte {place} changed by {change:#x}");
            }
        }
    }
}

/// Bytes changed at random with a fixed seed: nothing may panic, and indices that are read are within bounds.
#[test]
fn archives_with_wrong_bytes_do_no_harm() {
    let members: [(&str, &[f64]); 4] = [
        ("indices.npy", &[0.0, 1.0, 1.0]),
        ("indptr.npy", &[0.0, 2.0, 3.0]),
        ("shape.npy", &[2.0, 2.0]),
        ("data.npy", &[1.0, 2.0, 3.0]),
    ];
    let mut seed = 7_u64;
    let mut random = move |end: usize| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as usize % end
    };
    for round in 0..2000 {
        let mut bytes = sparse("csr", &members, round % 2 == 0);
        for _ in 0..1 + random(4) {
            let place = random(bytes.len());
            bytes[place] = random(256) as u8;
        }
        if let Ok(matrix) = read("k.npz", &bytes) {
            let inside = |&(row, column, _): &(u32, u32, f64)| {
                (row as usize) < matrix.rows && (column as usize) < matrix.columns
            };
            assert!(matrix.entries.iter().all(inside));
        }
    }
}
