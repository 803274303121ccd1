//! State as bytes, with which memories, dampings and integrators survive a restart, without allocation.

use core::fmt;

use crate::real::Real;

/// Writes states one after another to a slice of bytes of the caller.
///
/// Integers take eight bytes, numbers four (`f32`) or eight (`f64`), all with the least significant byte
/// first: a host can restore what a microcontroller saved, and the other way round. Corruption of the stored
/// bytes is not detected; where it can happen the caller keeps a checksum beside them.
///
/// ```
/// # use fvi_core::{FixedDirect, Memory, StateReader, StateWriter, Stateful};
/// let weights = [1.0, -0.5, -0.125];
/// let mut memory = FixedDirect::<f64, 1, 8>::full_memory(&weights, 1.0)?;
/// memory.push(&[2.0])?;
/// let mut bytes = [0; 128];
/// let mut writer = StateWriter::new(&mut bytes);
/// memory.save(&mut writer)?;
/// let length = writer.written();
/// assert_eq!(length, memory.state_bytes());
///
/// let mut after_the_restart = FixedDirect::<f64, 1, 8>::full_memory(&weights, 1.0)?;
/// let mut reader = StateReader::new(&bytes[..length]);
/// after_the_restart.restore(&mut reader)?;
/// reader.finish()?;
/// assert_eq!(after_the_restart.len(), 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
#[must_use]
pub struct StateWriter<'a> {
    rest: &'a mut [u8],
    room: usize,
}

/// Reads what a [`StateWriter`] wrote. A clone reads ahead.
#[derive(Clone, Debug)]
#[must_use]
pub struct StateReader<'a> {
    rest: &'a [u8],
}

/// An object whose state can be saved and restored: a memory, a damping, an operator, a controller, an
/// integrator.
///
/// The state is what depends on samples and steps; parameters, such as the kernel, are not part of it. An
/// object built with the same parameters that restores a state continues with identical bits, on this machine
/// or another. What cannot be saved implements the trait without methods: all of them refuse then.
pub trait Stateful {
    /// Number of bytes that [`save`](Stateful::save) writes at present.
    fn state_bytes(&self) -> usize {
        0
    }

    /// Writes the state.
    ///
    /// # Errors
    /// [`StateError::NoRoom`], and [`StateError::Unsupported`] if this object, or one that it contains,
    /// cannot be saved.
    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        let _ = to;
        Err(StateError::Unsupported)
    }

    /// Reads past a state and checks that [`restore`](Stateful::restore) would accept it.
    ///
    /// # Errors
    /// As [`restore`](Stateful::restore).
    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let _ = from;
        Err(StateError::Unsupported)
    }

    /// Replaces the state by a saved one.
    ///
    /// # Errors
    /// [`StateError`] if the bytes are not the state of an object of this kind, shape, precision and kernel,
    /// as far as it is recorded; the object is then unchanged.
    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let _ = from;
        Err(StateError::Unsupported)
    }
}

/// No state.
impl Stateful for () {
    fn save(&self, _: &mut StateWriter<'_>) -> Result<(), StateError> {
        Ok(())
    }

    fn check_state(&self, _: &mut StateReader<'_>) -> Result<(), StateError> {
        Ok(())
    }

    fn restore(&mut self, _: &mut StateReader<'_>) -> Result<(), StateError> {
        Ok(())
    }
}

/// Nothing where there is none.
impl<S: Stateful> Stateful for Option<S> {
    fn state_bytes(&self) -> usize {
        self.as_ref().map_or(0, S::state_bytes)
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.as_ref().map_or(Ok(()), |object| object.save(to))
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.as_ref().map_or(Ok(()), |object| object.check_state(from))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.as_mut().map_or(Ok(()), |object| object.restore(from))
    }
}

/// One after another.
impl<A: Stateful, B: Stateful> Stateful for (A, B) {
    fn state_bytes(&self) -> usize {
        self.0.state_bytes() + self.1.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.0.save(to)?;
        self.1.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.0.check_state(from)?;
        self.1.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        self.0.restore(from)?;
        self.1.restore(from)
    }
}

/// One after another.
impl<S: Stateful> Stateful for [S] {
    fn state_bytes(&self) -> usize {
        self.iter().map(|object| object.state_bytes()).sum()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.iter().try_for_each(|object| object.save(to))
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.iter().try_for_each(|object| object.check_state(from))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        self.iter_mut().try_for_each(|object| object.restore(from))
    }
}

impl<S: Stateful + ?Sized> Stateful for &mut S {
    fn state_bytes(&self) -> usize {
        (**self).state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        (**self).save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        (**self).check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        (**self).restore(from)
    }
}

impl<S: Stateful, const K: usize> Stateful for [S; K] {
    fn state_bytes(&self) -> usize {
        self.as_slice().state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.as_slice().save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.as_slice().check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.as_mut_slice().restore(from)
    }
}

/// Header of a saved state: names and values that must agree with those of the object that restores it.
pub type Shape<const E: usize> = [(&'static str, u64); E];

/// Bytes of a header with E entries in its shape: a tag, the size of a number, the entries.
pub const fn header_bytes(entries: usize) -> usize {
    5 + 8 * entries
}

/// Reason why a state was not saved or not restored. An object that refuses to be restored is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StateError {
    /// The slice to write to is too short.
    NoRoom {
        /// Its length in bytes.
        room: usize,
    },
    /// The bytes end too early: the state is truncated.
    Truncated {
        /// Smallest number of bytes that the next part needs.
        needed: usize,
        /// Number of bytes left.
        left: usize,
    },
    /// Bytes are left after the state.
    Surplus {
        /// Their number.
        bytes: usize,
    },
    /// The state belongs to an object of another kind, or these bytes are no state.
    Kind {
        /// Tag of the object.
        expected: [u8; 4],
        /// Tag of the state.
        found: [u8; 4],
    },
    /// The state belongs to an object of another shape, kernel or precision.
    Mismatch {
        /// Name of the value that differs.
        what: &'static str,
        /// Value of the object.
        expected: u64,
        /// Value in the state.
        found: u64,
    },
    /// A count is larger than the object allows.
    TooLarge {
        /// Name of what is counted.
        what: &'static str,
        /// The largest count allowed.
        limit: u64,
        /// The count in the state.
        found: u64,
    },
    /// A number of the state is infinite or not a number: these bytes have changed since they were saved.
    NotFinite,
    /// The object cannot save its state.
    Unsupported,
}

impl fmt::Display for StateError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::NoRoom { room } => write!(f, "the state does not fit into {room} bytes"),
            Self::Truncated { needed, left } => {
                write!(f, "the saved state ends too early: {left} bytes are left where {needed} are needed")
            }
            Self::Surplus { bytes } => write!(f, "{bytes} bytes are left over behind the saved state"),
            Self::Kind { expected, found } => write!(
                f,
                "the saved state is of the kind \"{}\", not \"{}\"",
                found.escape_ascii(),
                expected.escape_ascii()
            ),
            Self::Mismatch { what, expected, found } => {
                write!(f, "the saved state does not belong here: {what} is {found}, not {expected}")
            }
            Self::TooLarge { what, limit, found } => {
                write!(f, "the saved state has {what} = {found} where at most {limit} are possible")
            }
            Self::NotFinite => write!(f, "the saved state has a number that is not finite"),
            Self::Unsupported => write!(f, "this object cannot save its state"),
        }
    }
}

impl core::error::Error for StateError {}

impl<'a> StateWriter<'a> {
    /// Writes to `bytes`, from the first on.
    pub fn new(bytes: &'a mut [u8]) -> Self {
        let room = bytes.len();
        Self { rest: bytes, room }
    }

    /// Number of bytes written so far.
    pub fn written(&self) -> usize {
        self.room.saturating_sub(self.rest.len())
    }

    /// Writes bytes as they are.
    ///
    /// # Errors
    /// [`StateError::NoRoom`]; then nothing is written.
    pub fn bytes(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        if self.rest.len() < bytes.len() {
            return Err(StateError::NoRoom { room: self.room });
        }
        let rest = core::mem::take(&mut self.rest);
        let (here, rest) = rest.split_at_mut_checked(bytes.len()).unwrap_or_default();
        here.iter_mut().zip(bytes).for_each(|(place, &byte)| *place = byte);
        self.rest = rest;
        Ok(())
    }

    /// Writes an integer.
    ///
    /// # Errors
    /// [`StateError::NoRoom`].
    pub fn count(&mut self, count: u64) -> Result<(), StateError> {
        self.bytes(&count.to_le_bytes())
    }

    /// Writes numbers.
    ///
    /// # Errors
    /// [`StateError::NoRoom`].
    pub fn numbers<'n, T: Real>(
        &mut self,
        numbers: impl IntoIterator<Item = &'n T>,
    ) -> Result<(), StateError> {
        numbers.into_iter().try_for_each(|number| {
            let bits = number.bits();
            // `BYTES` is known to the compiler: one store for each number.
            if T::BYTES == 4 { self.word((bits as u32).to_le_bytes()) } else { self.word(bits.to_le_bytes()) }
        })
    }

    /// [`numbers`](Self::numbers) of a slice, compiled once for each precision.
    #[inline(never)]
    pub(crate) fn slice<T: Real>(&mut self, numbers: &[T]) -> Result<(), StateError> {
        self.numbers(numbers)
    }

    #[inline]
    fn word<const B: usize>(&mut self, word: [u8; B]) -> Result<(), StateError> {
        if self.rest.len() < B {
            return Err(StateError::NoRoom { room: self.room });
        }
        if let Some((place, rest)) = core::mem::take(&mut self.rest).split_first_chunk_mut() {
            *place = word;
            self.rest = rest;
        }
        Ok(())
    }

    /// Writes the header of a state: the tag of its kind, the size of a number `T`, and its shape.
    ///
    /// # Errors
    /// [`StateError::NoRoom`].
    pub fn header<T: Real, const E: usize>(
        &mut self,
        tag: [u8; 4],
        shape: &Shape<E>,
    ) -> Result<(), StateError> {
        self.header_of(tag, T::BYTES as u8, shape)
    }

    /// Compiled once, whatever the numbers and the shape.
    #[inline(never)]
    fn header_of(
        &mut self,
        tag: [u8; 4],
        bytes_of_number: u8,
        shape: &[(&'static str, u64)],
    ) -> Result<(), StateError> {
        let [a, b, c, d] = tag;
        self.bytes(&[a, b, c, d, bytes_of_number])?;
        shape.iter().try_for_each(|&(_, value)| self.count(value))
    }
}

impl<'a> StateReader<'a> {
    /// Reads `bytes` from the first on.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    /// Number of bytes that have not been read.
    pub fn left(&self) -> usize {
        self.rest.len()
    }

    /// Ends reading.
    ///
    /// # Errors
    /// [`StateError::Surplus`] if bytes are left.
    pub fn finish(self) -> Result<(), StateError> {
        match self.rest.len() {
            0 => Ok(()),
            bytes => Err(StateError::Surplus { bytes }),
        }
    }

    /// The next `count` bytes.
    ///
    /// # Errors
    /// [`StateError::Truncated`] if there are fewer.
    pub fn bytes(&mut self, count: usize) -> Result<&'a [u8], StateError> {
        let truncated = StateError::Truncated { needed: count, left: self.rest.len() };
        let (here, rest) = self.rest.split_at_checked(count).ok_or(truncated)?;
        self.rest = rest;
        Ok(here)
    }

    /// The next integer.
    ///
    /// # Errors
    /// [`StateError::Truncated`].
    pub fn count(&mut self) -> Result<u64, StateError> {
        self.word().map(u64::from_le_bytes)
    }

    #[inline]
    fn word<const B: usize>(&mut self) -> Result<[u8; B], StateError> {
        let truncated = StateError::Truncated { needed: B, left: self.rest.len() };
        let (word, rest) = self.rest.split_first_chunk().ok_or(truncated)?;
        self.rest = rest;
        Ok(*word)
    }

    /// The next integer, a count of at most `limit`.
    ///
    /// # Errors
    /// [`StateError::Truncated`], or [`StateError::TooLarge`] with the name of what is counted.
    pub fn count_up_to(&mut self, what: &'static str, limit: usize) -> Result<usize, StateError> {
        let found = self.count()?;
        let too_large = StateError::TooLarge { what, limit: limit as u64, found };
        usize::try_from(found).ok().filter(|&count| count <= limit).ok_or(too_large)
    }

    /// The next number.
    ///
    /// # Errors
    /// [`StateError::Truncated`], or [`StateError::NotFinite`].
    pub fn number<T: Real>(&mut self) -> Result<T, StateError> {
        let bits = match T::BYTES {
            4 => u32::from_le_bytes(self.word()?).into(),
            _ => u64::from_le_bytes(self.word()?),
        };
        Some(T::of_bits(bits)).filter(|number| number.is_finite()).ok_or(StateError::NotFinite)
    }

    /// Reads the next numbers to the given places.
    ///
    /// # Errors
    /// [`StateError::Truncated`], or [`StateError::NotFinite`].
    pub fn numbers<'n, T: Real>(
        &mut self,
        places: impl IntoIterator<Item = &'n mut T>,
    ) -> Result<(), StateError> {
        places.into_iter().try_for_each(|place| {
            *place = self.number()?;
            Ok(())
        })
    }

    /// [`numbers`](Self::numbers) to a slice, compiled once for each precision.
    #[inline(never)]
    pub(crate) fn fill<T: Real>(&mut self, places: &mut [T]) -> Result<(), StateError> {
        self.numbers(places)
    }

    /// Skips numbers after checking that they are complete and finite.
    ///
    /// # Errors
    /// [`StateError::Truncated`], or [`StateError::NotFinite`].
    #[inline(never)]
    pub fn skip<T: Real>(&mut self, numbers: usize) -> Result<(), StateError> {
        let skipped = self.bytes(numbers.saturating_mul(T::BYTES))?;
        // All without leaving at the first: no branch for each number.
        let are_finite = match T::BYTES {
            4 => all_finite::<T, 4>(skipped, |word| u32::from_le_bytes(word).into()),
            _ => all_finite::<T, 8>(skipped, u64::from_le_bytes),
        };
        if are_finite { Ok(()) } else { Err(StateError::NotFinite) }
    }

    /// Reads a header and compares it with that of the object.
    ///
    /// # Errors
    /// [`StateError::Truncated`], [`StateError::Kind`], or [`StateError::Mismatch`] with the first entry that
    /// differs.
    pub fn header<T: Real, const E: usize>(
        &mut self,
        tag: [u8; 4],
        shape: &Shape<E>,
    ) -> Result<(), StateError> {
        self.header_of(tag, T::BYTES as u8, shape)
    }

    /// Compiled once, whatever the numbers and the shape.
    #[inline(never)]
    fn header_of(
        &mut self,
        tag: [u8; 4],
        bytes_of_number: u8,
        shape: &[(&'static str, u64)],
    ) -> Result<(), StateError> {
        let found = self.word()?;
        if found != tag {
            return Err(StateError::Kind { expected: tag, found });
        }
        let [size] = self.word()?;
        same("bytes of a number", bytes_of_number.into(), size.into())?;
        shape.iter().try_for_each(|&(what, expected)| same(what, expected, self.count()?))
    }
}

/// True if all numbers in these bytes are finite.
fn all_finite<T: Real, const B: usize>(bytes: &[u8], bits: impl Fn([u8; B]) -> u64) -> bool {
    let (words, _) = bytes.as_chunks();
    words.iter().fold(true, |finite, &word| finite & T::of_bits(bits(word)).is_finite())
}

fn same(what: &'static str, expected: u64, found: u64) -> Result<(), StateError> {
    if expected == found { Ok(()) } else { Err(StateError::Mismatch { what, expected, found }) }
}

/// Hash of no words.
pub(crate) const BASIS: u64 = 0xcbf2_9ce4_8422_2325;

/// The hash with one more word.
pub(crate) const fn mix(hash: u64, word: u64) -> u64 {
    const PRIME: u64 = 0x0100_0000_01b3;
    let mixed = (hash ^ word).wrapping_mul(PRIME);
    // Most weights differ in the low bits of their words, and a product mixes into its high bits.
    mixed ^ (mixed >> 32)
}

/// Hash of the bits of the numbers (FNV-1a over words), by which kernels with different weights are
/// distinguished.
pub fn fingerprint<'n, T: Real>(numbers: impl IntoIterator<Item = &'n T>) -> u64 {
    numbers.into_iter().fold(BASIS, |hash, number| mix(hash, number.bits()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_every_bit_with_the_least_significant_byte_first() {
        let mut bytes = [0; 24];
        let mut writer = StateWriter::new(&mut bytes);
        writer.numbers(&[-0.0f32, f32::from_bits(0x0080_1234)]).unwrap();
        writer.numbers(&[f64::MIN_POSITIVE]).unwrap();
        writer.count(258).unwrap();
        assert_eq!(writer.bytes(&[1]), Err(StateError::NoRoom { room: 24 }));
        assert_eq!(writer.written(), 24);
        assert_eq!(bytes[4..8], [0x34, 0x12, 0x80, 0x00]);
        assert_eq!(bytes[16..18], [2, 1]);
        let mut reader = StateReader::new(&bytes);
        assert_eq!(reader.number::<f32>().unwrap().to_bits(), (-0.0f32).to_bits());
        assert_eq!(reader.number::<f32>().unwrap().to_bits(), 0x0080_1234);
        assert_eq!(reader.clone().number(), Ok(f64::MIN_POSITIVE));
        assert_eq!(reader.clone().finish(), Err(StateError::Surplus { bytes: 16 }));
        reader.skip::<f64>(1).unwrap();
        let too_large = StateError::TooLarge { what: "steps", limit: 257, found: 258 };
        assert_eq!(reader.clone().count_up_to("steps", 257), Err(too_large));
        assert_eq!(reader.count_up_to("steps", 258), Ok(258));
        assert_eq!(reader.count(), Err(StateError::Truncated { needed: 8, left: 0 }));
    }

    #[test]
    fn a_number_that_is_not_finite_is_refused_where_it_is_read_and_where_it_is_skipped() {
        for changed in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut bytes = [0; 16];
            StateWriter::new(&mut bytes).numbers(&[1.0, changed]).unwrap();
            let reader = StateReader::new(&bytes);
            assert_eq!(reader.clone().skip::<f64>(1), Ok(()));
            assert_eq!(reader.clone().skip::<f64>(2), Err(StateError::NotFinite), "{changed}");
            assert_eq!(reader.clone().numbers(&mut [0.0; 2]), Err(StateError::NotFinite), "{changed}");
        }
    }

    #[test]
    fn a_header_of_another_kind_precision_or_shape_is_refused() {
        let mut bytes = [0; header_bytes(2)];
        StateWriter::new(&mut bytes).header::<f32, 2>(*b"test", &[("ears", 2), ("legs", 4)]).unwrap();
        let read = |tag: &[u8; 4], legs| {
            StateReader::new(&bytes).header::<f32, 2>(*tag, &[("ears", 2), ("legs", legs)])
        };
        assert_eq!(read(b"test", 4), Ok(()));
        assert_eq!(read(b"best", 4), Err(StateError::Kind { expected: *b"best", found: *b"test" }));
        assert_eq!(read(b"test", 6), Err(StateError::Mismatch { what: "legs", expected: 6, found: 4 }));
        let double = StateReader::new(&bytes).header::<f64, 0>(*b"test", &[]);
        let expected = StateError::Mismatch { what: "bytes of a number", expected: 8, found: 4 };
        assert_eq!(double, Err(expected));
    }

    #[test]
    fn fingerprints_tell_close_kernels_apart() {
        let of = |weight: f64| fingerprint(&[1.0, weight]);
        assert_ne!(of(0.5), of(0.5 + f64::EPSILON));
        assert_ne!(fingerprint(&[1.0, 2.0]), fingerprint(&[2.0, 1.0]));
    }

    #[test]
    fn fingerprints_stay_what_they_are_in_states_that_were_saved() {
        assert_eq!(fingerprint::<f64>(&[]), 0xcbf2_9ce4_8422_2325);
        // FNV-1a over whole words, with the high half of each product folded onto the low one.
        let by_hand = |numbers: &[u64]| {
            numbers.iter().fold(0xcbf2_9ce4_8422_2325u64, |hash, bits| {
                let product = (u128::from(hash ^ bits) * 0x0100_0000_01b3 % (1 << 64)) as u64;
                product ^ (product / (1 << 32))
            })
        };
        assert_eq!(fingerprint(&[1.0f64, -0.1]), by_hand(&[1.0f64.to_bits(), (-0.1f64).to_bits()]));
        assert_eq!(fingerprint(&[0.3f32]), by_hand(&[u64::from(0.3f32.to_bits())]));
    }
}
