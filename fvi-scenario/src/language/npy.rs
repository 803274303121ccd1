//! Arrays in NumPy's format, read with every length checked against the size of the file.

/// Numbers of an array with its shape, converted to float64.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Empty for a single number.
    pub shape: Vec<usize>,
    /// In row-major order, the last index fastest.
    pub numbers: Vec<f64>,
}

/// Type of the stored numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Float32,
    Float64,
    Signed(usize),
    Unsigned(usize),
}

impl Kind {
    fn bytes(self) -> usize {
        match self {
            Self::Float32 => 4,
            Self::Float64 => 8,
            Self::Signed(bytes) | Self::Unsigned(bytes) => bytes,
        }
    }
}

const MAGIC: &[u8] = b"\x93NUMPY";

/// Longest header accepted, in bytes.
const LONGEST_HEADER: usize = 1 << 16;

/// Reads the bytes of a `.npy` file.
///
/// # Errors
/// A description of the problem.
pub fn read(bytes: &[u8]) -> Result<Array, String> {
    let truncated = || "the file ends within its header".to_owned();
    let rest = bytes.strip_prefix(MAGIC).ok_or("not a file of numpy.save")?;
    let (&[major, _minor], rest) = rest.split_first_chunk::<2>().ok_or_else(truncated)?;
    let (length, rest) = match major {
        1 => {
            let (length, rest) = rest.split_first_chunk::<2>().ok_or_else(truncated)?;
            (usize::from(u16::from_le_bytes(*length)), rest)
        }
        2 | 3 => {
            let (length, rest) = rest.split_first_chunk::<4>().ok_or_else(truncated)?;
            (u32::from_le_bytes(*length) as usize, rest)
        }
        other => return Err(format!("version {other} of numpy's format is not known")),
    };
    if length > LONGEST_HEADER {
        return Err(format!("a header of {length} bytes"));
    }
    let (header, data) = rest.split_at_checked(length).ok_or_else(truncated)?;
    let header = std::str::from_utf8(header).map_err(|_| "the header is not text".to_owned())?;
    let (kind, big_endian) = kind(&entry(header, "descr")?)?;
    let columns_first = match entry(header, "fortran_order")?.as_str() {
        "True" => true,
        "False" => false,
        other => return Err(format!("fortran_order is `{other}`")),
    };
    let shape = shape(&entry(header, "shape")?)?;
    let count = shape.iter().try_fold(1_usize, |count, &length| count.checked_mul(length));
    let wanted = count.and_then(|count| count.checked_mul(kind.bytes()));
    if wanted != Some(data.len()) {
        return Err(format!(
            "the shape {shape:?} of {} bytes each needs another number of bytes than the {} there are",
            kind.bytes(),
            data.len()
        ));
    }
    let mut numbers: Vec<f64> =
        data.chunks_exact(kind.bytes()).map(|bytes| number(kind, big_endian, bytes)).collect();
    if columns_first && let &[rows, columns] = shape.as_slice() {
        let at = |index: usize| numbers[index % columns * rows + index / columns];
        numbers = (0..numbers.len()).map(at).collect();
    } else if columns_first && shape.len() > 2 {
        return Err("more than two dimensions".to_owned());
    }
    Ok(Array { shape, numbers })
}

/// The value of a key of the header, which is written as a Python dictionary.
fn entry(header: &str, key: &str) -> Result<String, String> {
    let missing = || format!("the header has no `{key}`");
    let (_, rest) = header.split_once(&format!("'{key}':")).ok_or_else(missing)?;
    let rest = rest.trim_start();
    let end = if rest.starts_with('(') {
        rest.find(')').map(|end| end + 1)
    } else if let Some(quoted) = rest.strip_prefix('\'') {
        quoted.find('\'').map(|end| end + 2)
    } else {
        rest.find([',', '}'])
    };
    Ok(rest.get(..end.ok_or_else(missing)?).unwrap_or_default().trim().to_owned())
}

fn kind(description: &str) -> Result<(Kind, bool), String> {
    let refused = || {
        format!("numbers of the type {description}; allowed: real or whole numbers ('<f8', '<f4', '<i4', …)")
    };
    let word = description.trim_matches('\'');
    let big_endian = word.starts_with('>');
    let kind = match word.trim_start_matches(['<', '>', '|', '=']) {
        "f8" => Kind::Float64,
        "f4" => Kind::Float32,
        "i1" => Kind::Signed(1),
        "i2" => Kind::Signed(2),
        "i4" => Kind::Signed(4),
        "i8" => Kind::Signed(8),
        "u1" => Kind::Unsigned(1),
        "u2" => Kind::Unsigned(2),
        "u4" => Kind::Unsigned(4),
        "u8" => Kind::Unsigned(8),
        _ => return Err(refused()),
    };
    Ok((kind, big_endian))
}

fn shape(tuple: &str) -> Result<Vec<usize>, String> {
    let inside = tuple.strip_prefix('(').and_then(|rest| rest.strip_suffix(')'));
    let lengths = inside.ok_or_else(|| format!("the shape is `{tuple}`"))?.split(',').map(str::trim);
    lengths
        .filter(|length| !length.is_empty())
        .map(|length| length.parse().map_err(|_| format!("the shape is `{tuple}`")))
        .collect()
}

/// The number in the bytes of its type.
fn number(kind: Kind, big_endian: bool, bytes: &[u8]) -> f64 {
    let mut wide = [0; 8];
    for (index, &byte) in bytes.iter().enumerate() {
        let place = if big_endian { bytes.len() - 1 - index } else { index };
        wide[place] = byte;
    }
    let bits = u64::from_le_bytes(wide);
    match kind {
        Kind::Float64 => f64::from_bits(bits),
        Kind::Float32 => f64::from(f32::from_bits(bits as u32)),
        Kind::Unsigned(_) => bits as f64,
        Kind::Signed(bytes) => {
            let unused = 64 - 8 * bytes as u32;
            (((bits << unused) as i64) >> unused) as f64
        }
    }
}

/// The bytes with which a `.npy` file of float64 numbers of this shape begins.
#[cfg(test)]
pub(crate) fn header(shape: &[usize]) -> Vec<u8> {
    let lengths: String = shape.iter().map(|length| format!("{length},")).collect();
    let mut text = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({lengths}), }}");
    // The numbers begin at a multiple of 64 bytes.
    let length = (MAGIC.len() + 4 + text.len() + 1).next_multiple_of(64) - MAGIC.len() - 4;
    text.extend(std::iter::repeat_n(' ', length - text.len() - 1));
    text.push('\n');
    let mut bytes = MAGIC.to_vec();
    bytes.extend([1, 0]);
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(description: &str, order: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': {description}, 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let mut bytes = [MAGIC, &[1, 0], &(header.len() as u16).to_le_bytes()].concat();
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn numbers_of_every_kind_are_read() {
        let floats: Vec<u8> = [1.5_f64, -2.0].iter().flat_map(|number| number.to_le_bytes()).collect();
        let read =
            |description, data: &[u8]| read(&file(description, "False", "(2,)", data)).unwrap().numbers;
        assert_eq!(read("'<f8'", &floats), [1.5, -2.0]);
        assert_eq!(read("'>i2'", &[0xFF, 0xFE, 0, 3]), [-2.0, 3.0]);
        assert_eq!(read("'|u1'", &[7, 255]), [7.0, 255.0]);
        let singles: Vec<u8> = [0.5_f32, 4.0].iter().flat_map(|number| number.to_be_bytes()).collect();
        assert_eq!(read("'>f4'", &singles), [0.5, 4.0]);
    }

    #[test]
    fn columns_first_is_turned_over() {
        let array = read(&file("'|i1'", "True", "(2, 3)", &[1, 2, 3, 4, 5, 6])).unwrap();
        assert_eq!(array, Array { shape: vec![2, 3], numbers: vec![1.0, 3.0, 5.0, 2.0, 4.0, 6.0] });
    }

    #[test]
    fn what_is_written_is_read() {
        let mut bytes = header(&[2, 1]);
        assert_eq!(bytes.len() % 64, 0);
        bytes.extend([0.1_f64, -3.0].iter().flat_map(|number| number.to_le_bytes()));
        assert_eq!(read(&bytes).unwrap(), Array { shape: vec![2, 1], numbers: vec![0.1, -3.0] });
    }

    #[test]
    fn forged_headers_are_refused() {
        for (description, shape, data) in [
            ("'<f8'", "(2,)", &[0_u8; 8][..]),
            ("'<f8'", "(18446744073709551615, 4)", &[0; 8]),
            ("'<c16'", "(1,)", &[0; 16]),
            ("'O'", "(1,)", &[0; 8]),
            ("'<f8'", "(1", &[0; 8]),
            ("'<f8'", "(-1,)", &[0; 8]),
        ] {
            assert!(read(&file(description, "False", shape, data)).is_err(), "{description} {shape}");
        }
        let whole = file("'<f8'", "False", "(1,)", &[0; 8]);
        for length in 0..whole.len() {
            assert!(read(&whole[..length]).is_err(), "{length} bytes");
        }
    }
}
