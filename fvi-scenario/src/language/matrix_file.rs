//! Matrices and vectors in files: Matrix Market, SciPy's sparse NPZ, NumPy arrays.

use super::memory_limit::check_capacity;
use super::npy::{self, Array};
use flate2::bufread::DeflateDecoder;
use rawzip::{CompressionMethod, ZipArchive, ZipFileHeaderRecord, ZipSliceArchive};
use std::io::Read;

/// A matrix as its entries, in the order of the file; repeated places are summed.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct FileMatrix {
    pub rows: usize,
    pub(crate) columns: usize,
    /// (row, column, entry), from 0.
    pub(crate) entries: Vec<(u32, u32, f64)>,
    /// True if the file stores one triangle of a symmetric matrix.
    pub(crate) half: bool,
}

/// Largest number of rows or columns.
const MOST: usize = 1 << 31;

/// Reads a matrix from the bytes of a file, in the format given by the extension of its name.
///
/// # Errors
/// A description of the problem, with the line or the member of the archive.
pub(crate) fn read(name: &str, bytes: &[u8]) -> Result<FileMatrix, String> {
    let matrix = match ending(name).as_str() {
        "mtx" => matrix_market(bytes)?,
        "npz" => sparse_npz(bytes)?,
        "npy" => of_array(npy::read(bytes)?)?,
        _ => {
            return Err(
                "the name must end in .mtx (Matrix Market), .npz (scipy.sparse.save_npz) or .npy".to_owned()
            );
        }
    };
    for &(row, column, entry) in &matrix.entries {
        if !entry.is_finite() {
            return Err(format!("row {row}, column {column} (from 0): {entry} is not a finite number"));
        }
    }
    Ok(matrix)
}

/// A vector in a file: its length, and its structurally nonzero entries. The length is as stated by the file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FileVector {
    pub(crate) length: usize,
    entries: Vec<(usize, f64)>,
}

impl FileVector {
    /// All numbers, zeros included; allocates the stated length.
    pub(crate) fn numbers(self) -> Vec<f64> {
        let mut numbers = vec![0.0; self.length];
        for (place, entry) in self.entries {
            numbers[place] += entry;
        }
        numbers
    }
}

/// Reads a vector: a `.npy` array, or a `.mtx` file with one column or one row.
///
/// # Errors
/// As [`read`].
pub(crate) fn read_vector(name: &str, bytes: &[u8]) -> Result<FileVector, String> {
    let matrix = read(name, bytes)?;
    let length = match (matrix.rows, matrix.columns) {
        (length, 1) | (1, length) => length,
        (rows, columns) => return Err(format!("{rows} × {columns} numbers where a vector is wanted")),
    };
    let entries = matrix.entries.iter().map(|&(row, column, entry)| (row.max(column) as usize, entry));
    Ok(FileVector { length, entries: entries.collect() })
}

fn ending(name: &str) -> String {
    name.rsplit_once('.').map(|(_, ending)| ending.to_ascii_lowercase()).unwrap_or_default()
}

/// The nonzero entries of an array; a list is a column.
fn of_array(array: Array) -> Result<FileMatrix, String> {
    let (rows, columns) = match *array.shape.as_slice() {
        [rows] => (rows, 1),
        [rows, columns] => (rows, columns),
        ref other => {
            return Err(format!("an array of the shape {other:?} where a vector or matrix is wanted"));
        }
    };
    check_size(rows, columns)?;
    let places = array.numbers.into_iter().enumerate().filter(|&(_, entry)| entry != 0.0);
    let entries =
        places.map(|(index, entry)| ((index / columns) as u32, (index % columns) as u32, entry)).collect();
    Ok(FileMatrix { rows, columns, entries, half: false })
}

fn check_size(rows: usize, columns: usize) -> Result<(), String> {
    if rows.max(columns) > MOST {
        return Err(format!("{rows} × {columns} entries are more than can be used"));
    }
    Ok(())
}

/// Storage scheme of a Matrix Market file.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Layout {
    Coordinates,
    Columns,
}

/// Reads a Matrix Market file; comments and blank lines are allowed anywhere.
fn matrix_market(bytes: &[u8]) -> Result<FileMatrix, String> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let line = bytes[..error.valid_up_to()].iter().filter(|&&byte| byte == b'\n').count() + 1;
        format!("line {line}: not text in UTF-8")
    })?;
    let mut lines = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    let (_, head) = lines.next().unwrap_or((1, ""));
    let words: Vec<String> = head.split_whitespace().map(str::to_ascii_lowercase).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let ["%%matrixmarket", "matrix", layout, field, symmetry] = words.as_slice() else {
        return Err(
            "line 1: not `%%MatrixMarket matrix coordinate|array real|integer general|symmetric`".to_owned()
        );
    };
    let layout = match *layout {
        "coordinate" => Layout::Coordinates,
        "array" => Layout::Columns,
        other => return Err(format!("line 1: `{other}`; allowed: coordinate, array")),
    };
    if !["real", "integer", "double"].contains(field) {
        return Err(format!("line 1: entries of the kind `{field}`; allowed: real, integer"));
    }
    let half = match *symmetry {
        "general" => false,
        "symmetric" => true,
        other => return Err(format!("line 1: `{other}`; allowed: general, symmetric")),
    };
    let mut lines = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('%'));
    let (line, sizes) = lines.next().ok_or("the line with the numbers of rows and columns is missing")?;
    let sizes: Vec<usize> = sizes
        .split_whitespace()
        .map(|word| {
            word.parse()
                .map_err(|_| format!("line {line}: `{word}` is not a number of rows, columns or entries"))
        })
        .collect::<Result<_, _>>()?;
    let (rows, columns, count) = match (layout, sizes.as_slice()) {
        (Layout::Coordinates, &[rows, columns, count]) => (rows, columns, count),
        (Layout::Columns, &[rows, columns]) if half => {
            (rows, columns, rows.saturating_mul(rows.saturating_add(1)) / 2)
        }
        (Layout::Columns, &[rows, columns]) => (rows, columns, rows.saturating_mul(columns)),
        _ => {
            return Err(format!(
                "line {line}: the numbers of rows, columns and (coordinate) entries are wanted"
            ));
        }
    };
    check_size(rows, columns)?;
    if half && rows != columns {
        return Err(format!("line {line}: a symmetric matrix of {rows} rows and {columns} columns"));
    }
    // Capacity limited by the length of the text: two bytes for the shortest entry and its separator.
    let mut entries = Vec::with_capacity(count.min(text.len() / 2 + 1));
    let (mut row, mut column) = (0, 0);
    for (line, words) in lines {
        let mut words = words.split_whitespace();
        let mut index = |most: usize| -> Result<usize, String> {
            let word = words.next().unwrap_or_default();
            let found = word.parse::<usize>().ok().filter(|index| (1..=most).contains(index));
            found
                .map(|index| index - 1)
                .ok_or_else(|| format!("line {line}: `{word}` is not an index from 1 to {most}"))
        };
        let place = match layout {
            Layout::Coordinates => (index(rows)?, index(columns)?),
            Layout::Columns => (row, column),
        };
        let word = words.next().unwrap_or_default();
        let entry = word.parse::<f64>().ok().filter(|entry| entry.is_finite()).ok_or_else(|| {
            format!("line {line}: `{}` is not a finite number", super::excerpt::excerpt(word))
        })?;
        if let Some(word) = words.next() {
            return Err(format!("line {line}: `{}` is too much", super::excerpt::excerpt(word)));
        }
        if entries.len() == count {
            return Err(format!("line {line}: more than {count} entries"));
        }
        if half && place.1 > place.0 {
            return Err(format!("line {line}: an entry above the diagonal of a symmetric matrix"));
        }
        entries.push((place.0 as u32, place.1 as u32, entry));
        if layout == Layout::Columns {
            row += 1;
            if row == rows {
                column += 1;
                row = if half { column } else { 0 };
            }
        }
    }
    if entries.len() != count {
        return Err(format!("{} entries instead of {count}: the file ends too early", entries.len()));
    }
    if layout == Layout::Columns {
        entries.retain(|&(.., entry)| entry != 0.0);
    }
    Ok(FileMatrix { rows, columns, entries, half })
}

/// An archive of arrays as `numpy.savez` writes it, compressed or not.
struct Archive<'a>(ZipSliceArchive<&'a [u8]>);

/// Largest compression ratio of the deflate method.
const DENSEST: u64 = 1040;

impl Archive<'_> {
    /// The directory entry of a member; an archive with two members of that name is refused.
    fn entry(&self, member: &str) -> Result<ZipFileHeaderRecord<'_>, String> {
        let mut found = None;
        for entry in self.0.entries() {
            let entry = entry.map_err(|error| format!("{member}: {error}"))?;
            if entry.file_path().as_ref() == member.as_bytes() && found.replace(entry).is_some() {
                return Err(format!("{member}: the archive has two members of this name"));
            }
        }
        found.ok_or_else(|| format!("{member}: the archive has no member of this name"))
    }

    fn bytes(&self, member: &str) -> Result<Vec<u8>, String> {
        let entry = self.entry(member)?;
        if entry.flags().is_encrypted() {
            return Err(format!("{member}: it is encrypted"));
        }
        let (said, stored) = (entry.uncompressed_size_hint(), entry.compressed_size_hint());
        if said > stored.saturating_mul(DENSEST).saturating_add(DENSEST) {
            return Err(format!("{member}: {stored} bytes cannot hold the {said} that are promised"));
        }
        let length = usize::try_from(said).map_err(|_| format!("{member}: {said} bytes"))?;
        let mut bytes = Vec::new();
        // Bytes of one digit each become numbers of eight bytes.
        check_capacity(length.saturating_mul(1 + size_of::<f64>()))
            .map_err(|error| format!("{member}: {error}"))?;
        bytes.try_reserve_exact(length).map_err(|error| format!("{member}: {error}"))?;
        let file = self.0.get_entry(entry.wayfinder()).map_err(|error| format!("{member}: {error}"))?;
        let content: Box<dyn Read> = match entry.compression_method() {
            CompressionMethod::STORE => Box::new(file.data()),
            CompressionMethod::DEFLATE => Box::new(DeflateDecoder::new(file.data())),
            other => {
                let method = other.as_u16();
                return Err(format!(
                    "{member}: compressed by method {method}; 0 (stored) and 8 (deflated) are read"
                ));
            }
        };
        // The checksum is verified at the end of the member.
        let read = file.verifying_reader(content).take(said.saturating_add(1)).read_to_end(&mut bytes);
        read.map_err(|error| format!("{member}: {error}"))?;
        if bytes.len() != length {
            return Err(format!("{member}: not the {said} bytes that are promised"));
        }
        Ok(bytes)
    }

    fn array(&self, name: &str) -> Result<Array, String> {
        let member = format!("{name}.npy");
        npy::read(&self.bytes(&member)?).map_err(|reason| format!("{member}: {reason}"))
    }

    /// A list of numbers.
    fn list(&self, name: &str) -> Result<Vec<f64>, String> {
        let array = self.array(name)?;
        if array.shape.len() == 1 {
            Ok(array.numbers)
        } else {
            Err(format!("{name}.npy: a list is wanted, the shape is {:?}", array.shape))
        }
    }

    /// A list of indices below `end`.
    fn indices(&self, name: &str, end: usize) -> Result<Vec<u32>, String> {
        let list = self.list(name)?.into_iter().enumerate();
        list.map(|(place, index)| {
            if is_whole(index) && index < end as f64 {
                Ok(index as u32)
            } else {
                Err(format!(
                    "{name}.npy: entry {place} is {index}, not an index from 0 to {}",
                    end as f64 - 1.0
                ))
            }
        })
        .collect()
    }
}

/// The arrays of a file of `numpy.savez`.
pub(crate) struct Arrays(Vec<(String, Result<Array, String>)>);

impl Arrays {
    /// Reads all of them.
    pub(crate) fn read(name: &str, bytes: &[u8]) -> Result<Self, String> {
        if ending(name) != "npz" {
            return Err("the name must end in .npz (numpy.savez)".to_owned());
        }
        let archive = ZipArchive::from_slice(bytes)
            .map(Archive)
            .map_err(|error| format!("not a ZIP archive: {error}"))?;
        let mut names = Vec::new();
        for entry in archive.0.entries() {
            let entry = entry.map_err(|error| error.to_string())?;
            let member = String::from_utf8_lossy(entry.file_path().as_ref()).into_owned();
            names.extend(member.strip_suffix(".npy").map(str::to_owned));
        }
        Ok(Self(names.into_iter().map(|name| (name.clone(), archive.array(&name))).collect()))
    }

    /// The first array that has none of these names.
    pub(crate) fn beyond(&self, names: &[&str]) -> Option<&str> {
        self.0.iter().map(|(own, _)| own.as_str()).find(|own| !names.contains(own))
    }

    /// True if there is an array of this name.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.0.iter().any(|(own, _)| own == name)
    }

    /// The array of this name.
    pub(crate) fn array(&self, name: &str) -> Result<Array, String> {
        let names = || self.0.iter().map(|(own, _)| own.as_str()).collect::<Vec<_>>().join(", ");
        match self.0.iter().find(|(own, _)| own == name) {
            Some((_, array)) => array.clone(),
            None => Err(format!("the array `{name}` is missing; there are {}", names())),
        }
    }
}

/// Reads what `scipy.sparse.save_npz` writes: compressed rows, compressed columns or coordinates.
fn sparse_npz(bytes: &[u8]) -> Result<FileMatrix, String> {
    let archive =
        ZipArchive::from_slice(bytes).map(Archive).map_err(|error| format!("not a ZIP archive: {error}"))?;
    // The format is a text of one to three letters, stored as bytes or as four bytes per letter.
    let format = archive
        .bytes("format.npy")
        .map_err(|reason| format!("{reason} (a file of scipy.sparse.save_npz is wanted)"))?;
    let letters = format.rsplit(|&byte| byte == b'\n').next().unwrap_or_default();
    let format: String =
        letters.iter().filter(|byte| byte.is_ascii_lowercase()).map(|&byte| char::from(byte)).collect();
    if !["csr", "csc", "coo"].contains(&format.as_str()) {
        return Err(format!("a sparse matrix of the format `{format}`; allowed: csr, csc, coo"));
    }
    let shape = archive.list("shape")?;
    let &[rows, columns] = shape.as_slice() else {
        return Err(format!("shape.npy: {} numbers instead of two", shape.len()));
    };
    if !is_whole(rows) || !is_whole(columns) {
        return Err(format!("shape.npy: {rows} rows and {columns} columns"));
    }
    let (rows, columns) = (rows as usize, columns as usize);
    check_size(rows, columns)?;
    let data = archive.list("data")?;
    let (major, minor) = match format.as_str() {
        "coo" => {
            let (row, column) = (archive.indices("row", rows)?, archive.indices("col", columns)?);
            let places = same_length(&data, row.len())?;
            same_length(&data, column.len())?;
            let entries =
                row.into_iter().zip(column).zip(places).map(|((row, column), &entry)| (row, column, entry));
            return Ok(FileMatrix { rows, columns, entries: entries.collect(), half: false });
        }
        "csr" => (rows, columns),
        _ => (columns, rows),
    };
    let indices = archive.indices("indices", minor)?;
    same_length(&data, indices.len())?;
    let ends = archive.list("indptr")?;
    let fits = ends.len() == major + 1
        && ends.first() == Some(&0.0)
        && ends.last() == Some(&(data.len() as f64))
        && ends.iter().all(|&end| is_whole(end))
        && ends.is_sorted();
    if !fits {
        return Err(format!(
            "indptr.npy: not {} ascending whole numbers from 0 to {}",
            major + 1,
            data.len()
        ));
    }
    let mut entries = Vec::with_capacity(data.len());
    for (outer, ends) in ends.windows(2).enumerate() {
        let range = ends[0] as usize..ends[1] as usize;
        for (&inner, &entry) in indices[range.clone()].iter().zip(&data[range]) {
            let (row, column) = if format == "csr" { (outer as u32, inner) } else { (inner, outer as u32) };
            entries.push((row, column, entry));
        }
    }
    Ok(FileMatrix { rows, columns, entries, half: false })
}

fn is_whole(number: f64) -> bool {
    number >= 0.0 && number.fract() == 0.0
}

fn same_length(data: &[f64], length: usize) -> Result<&[f64], String> {
    if data.len() == length { Ok(data) } else { Err(format!("{} entries and {length} indices", data.len())) }
}

#[cfg(test)]
mod tests;
