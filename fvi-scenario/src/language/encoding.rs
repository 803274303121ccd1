//! Texts of files in the encodings in which programs write them.

/// The text of bytes in UTF-8, in UTF-16 of either order, or in Windows-1252, which contains Latin-1.
///
/// A mark at the beginning tells the encoding. Without one, UTF-16 is known by a zero in every second byte of
/// its first characters, and what is not UTF-8 is taken as Windows-1252 unless it has control characters.
pub(super) fn decoded(bytes: Vec<u8>) -> Result<String, String> {
    match bytes.as_slice() {
        [b'P', b'K', 3, 4, ..] | [0xd0, 0xcf, 0x11, 0xe0, ..] => {
            Err("a spreadsheet (.xlsx, .ods, .xls), not text: save the table as CSV".to_owned())
        }
        [0x89, b'H', b'D', b'F', ..] | [b'C', b'D', b'F', 1 | 2 | 5, ..] => {
            Err("a file of HDF5 or NetCDF, not text: Python reads those of Capytaine and BEMIO".to_owned())
        }
        [0xef, 0xbb, 0xbf, ..] => utf8(bytes).map(|text| text.trim_start_matches('\u{feff}').to_owned()),
        [0xff, 0xfe, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => utf16(rest, u16::from_be_bytes),
        all if has_zeros(all, 1) => utf16(all, u16::from_le_bytes),
        all if has_zeros(all, 0) => utf16(all, u16::from_be_bytes),
        _ => utf8(bytes),
    }
}

/// True if, of the first pairs of bytes, one is zero and the other is not.
fn has_zeros(bytes: &[u8], place: usize) -> bool {
    let mut pairs = bytes.chunks_exact(2).take(8);
    pairs.len() == 8 && pairs.all(|pair| pair[place] == 0 && pair[1 - place] != 0)
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> Result<String, String> {
    let units = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
    let text = char::decode_utf16(units).collect::<Result<String, _>>();
    match text {
        Ok(text) if bytes.len().is_multiple_of(2) => Ok(text),
        _ => Err("it begins as text in UTF-16, and does not go on as such".to_owned()),
    }
}

fn utf8(bytes: Vec<u8>) -> Result<String, String> {
    let error = match String::from_utf8(bytes) {
        Ok(text) => return Ok(text),
        Err(error) => error,
    };
    let is_control = |byte: &u8| *byte < 0x20 && !b"\t\r\n\x0c\x1a".contains(byte) || *byte == 0x7f;
    let bytes = error.as_bytes();
    let letter = |byte: &u8| match byte {
        0x80..0xa0 => UPPER[usize::from(*byte) - 0x80],
        other => Some(char::from(*other)),
    };
    let text: Option<String> =
        if bytes.iter().any(is_control) { None } else { bytes.iter().map(letter).collect() };
    text.ok_or_else(|| {
        let place = error.utf8_error().valid_up_to();
        let line = bytes.iter().take(place).filter(|&&byte| byte == b'\n').count() + 1;
        format!("not text in UTF-8, UTF-16 or Latin-1: line {line}, byte {} of the file", place + 1)
    })
}

/// The characters from 0x80 to 0x9f of Windows-1252.
#[rustfmt::skip]
const UPPER: [Option<char>; 32] = [
    Some('€'), None, Some('‚'), Some('ƒ'), Some('„'), Some('…'), Some('†'), Some('‡'),
    Some('ˆ'), Some('‰'), Some('Š'), Some('‹'), Some('Œ'), None, Some('Ž'), None,
    None, Some('‘'), Some('’'), Some('“'), Some('”'), Some('•'), Some('–'), Some('—'),
    Some('˜'), Some('™'), Some('š'), Some('›'), Some('œ'), None, Some('ž'), Some('Ÿ'),
];

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "ω;G' [Pa]\r\n0,1;2·10³\r\n";

    fn in_utf16(text: &str, bytes: fn(u16) -> [u8; 2]) -> Vec<u8> {
        text.encode_utf16().flat_map(bytes).collect()
    }

    #[test]
    fn one_text_is_read_from_every_encoding() {
        let marked = format!("\u{feff}{TEXT}");
        assert_eq!(decoded(TEXT.as_bytes().to_vec()).unwrap(), TEXT);
        assert_eq!(decoded(marked.as_bytes().to_vec()).unwrap(), TEXT);
        assert_eq!(decoded(in_utf16(&marked, u16::to_le_bytes)).unwrap(), TEXT);
        assert_eq!(decoded(in_utf16(&marked, u16::to_be_bytes)).unwrap(), TEXT);
        let plain = "t,q0\n0.1,0.9\n0.2,0.8\n";
        assert_eq!(decoded(in_utf16(plain, u16::to_le_bytes)).unwrap(), plain);
        assert_eq!(decoded(in_utf16(plain, u16::to_be_bytes)).unwrap(), plain);
        // Temp./°C, µm and a dash, in Windows-1252.
        let bytes = b"Temp./\xb0C;\xb5m\n1;\x96\n".to_vec();
        assert_eq!(decoded(bytes).unwrap(), "Temp./°C;µm\n1;–\n");
    }

    #[test]
    fn what_is_no_text_is_refused_with_its_place() {
        let said = decoded(b"t,q0\n0.1,\xff\x00\x01\n".to_vec()).unwrap_err();
        assert!(said.contains("line 2, byte 10"), "{said}");
        assert!(decoded(vec![0xff, 0xfe, 0x61, 0x00, 0x61]).is_err());
        assert!(decoded(b"PK\x03\x04\x14\x00".to_vec()).unwrap_err().contains("CSV"));
        assert!(decoded(b"\x89HDF\r\n\x1a\n".to_vec()).unwrap_err().contains("HDF5"));
        assert!(decoded(vec![0xff, 0xfe, 0x00, 0xd8, 0x61, 0x00]).is_err());
    }
}
