//! Files of checksummed sections: the file format of checkpoints.
//!
//! ```text
//! magic                8 bytes
//! format version       u32
//! number of sections   u32
//! CRC-32 of the above  u32
//! each section:        tag (4 bytes), length of the content (u64), content, CRC-32 of the three (u32)
//! ```
//!
//! Integers are little-endian. Any change within 32 adjacent bits, and so of any single byte, changes the
//! CRC-32; lengths are checked against the length of the file.

use std::io::{self, Write};

/// One section: a tag and its content.
pub(crate) type Section<'a> = ([u8; 4], &'a [u8]);

/// Why bytes are not a valid file of sections.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Damage {
    /// The first bytes differ from the expected ones.
    #[error("it does not begin as one")]
    Magic,
    /// It is of another version of the format.
    #[error("its format is version {found}, and only version {known} is known here")]
    Version { known: u32, found: u32 },
    /// It ends too early.
    #[error("it ends too early")]
    Truncated,
    /// A checksum is not that of the bytes.
    #[error("a checksum does not fit")]
    Checksum,
    /// Bytes follow the last section.
    #[error("bytes follow behind its end")]
    Surplus,
}

/// Number of bytes of a content that are written at a time.
const PART: usize = 1 << 18;

/// Writes a file of sections.
pub(crate) fn write(
    to: &mut impl Write,
    magic: [u8; 8],
    version: u32,
    sections: &[Section<'_>],
) -> io::Result<()> {
    let mut head = Vec::from(magic);
    head.extend(version.to_le_bytes());
    head.extend((sections.len() as u32).to_le_bytes());
    to.write_all(&head)?;
    to.write_all(&crc32fast::hash(&head).to_le_bytes())?;
    for (tag, content) in sections {
        let length = (content.len() as u64).to_le_bytes();
        let mut hasher = crc32fast::Hasher::new();
        // Long contents in parts that remain in the cache between checksum and copy.
        for part in [&tag[..], &length].into_iter().chain(content.chunks(PART)) {
            hasher.update(part);
            to.write_all(part)?;
        }
        to.write_all(&hasher.finalize().to_le_bytes())?;
    }
    Ok(())
}

/// The sections of a file.
pub(crate) fn read(bytes: &[u8], magic: [u8; 8], version: u32) -> Result<Vec<Section<'_>>, Damage> {
    let mut rest = bytes;
    let head = take(&mut rest, 16)?;
    if head[..8] != magic {
        return Err(Damage::Magic);
    }
    check(&[head], take(&mut rest, 4)?)?;
    let found = u32::from_le_bytes(array(&head[8..12]));
    if found != version {
        return Err(Damage::Version { known: version, found });
    }
    let count = u32::from_le_bytes(array(&head[12..16]));
    let mut sections = Vec::new();
    for _ in 0..count {
        let label = take(&mut rest, 12)?;
        let length = u64::from_le_bytes(array(&label[4..]));
        let content = take(&mut rest, usize::try_from(length).map_err(|_| Damage::Truncated)?)?;
        check(&[label, content], take(&mut rest, 4)?)?;
        sections.push((array(&label[..4]), content));
    }
    if rest.is_empty() { Ok(sections) } else { Err(Damage::Surplus) }
}

fn take<'a>(rest: &mut &'a [u8], count: usize) -> Result<&'a [u8], Damage> {
    let (here, after) = rest.split_at_checked(count).ok_or(Damage::Truncated)?;
    *rest = after;
    Ok(here)
}

fn check(parts: &[&[u8]], checksum: &[u8]) -> Result<(), Damage> {
    let mut hasher = crc32fast::Hasher::new();
    parts.iter().for_each(|part| hasher.update(part));
    if hasher.finalize() == u32::from_le_bytes(array(checksum)) { Ok(()) } else { Err(Damage::Checksum) }
}

/// Converts a slice of known length N to an array.
fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut array = [0; N];
    array.iter_mut().zip(bytes).for_each(|(place, &byte)| *place = byte);
    array
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAGIC: [u8; 8] = *b"test\r\n\x1a\n";

    fn file() -> Vec<u8> {
        let mut bytes = Vec::new();
        write(&mut bytes, MAGIC, 3, &[(*b"some", b"content"), (*b"none", b"")]).unwrap();
        bytes
    }

    #[test]
    fn what_was_written_is_read() {
        let expected: Vec<Section<'_>> = vec![(*b"some", b"content"), (*b"none", b"")];
        assert_eq!(read(&file(), MAGIC, 3), Ok(expected));
        assert_eq!(read(&file(), MAGIC, 4), Err(Damage::Version { known: 4, found: 3 }));
    }

    #[test]
    fn every_changed_byte_truncation_and_addition_is_noticed() {
        let whole = file();
        for place in 0..whole.len() {
            for change in [1, 0x80, 0xff] {
                let mut bytes = whole.clone();
                bytes[place] ^= change;
                assert!(read(&bytes, MAGIC, 3).is_err(), "byte {place} changed by {change}");
            }
            assert!(read(&whole[..place], MAGIC, 3).is_err(), "cut to {place} bytes");
        }
        assert_eq!(read(&[&whole[..], b"\n"].concat(), MAGIC, 3), Err(Damage::Surplus));
    }

    #[test]
    fn a_forged_length_takes_no_memory() {
        let mut bytes = file();
        bytes[24..32].copy_from_slice(&u64::MAX.to_le_bytes());
        assert_eq!(read(&bytes, MAGIC, 3), Err(Damage::Truncated));
    }
}
