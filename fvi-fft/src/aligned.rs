//! Numbers that begin on a cache line, so that no vector load straddles two.

/// Bytes of a cache line, and of the widest vector.
const LINE: usize = 64;

/// An array of fixed length whose first number lies on a cache line.
///
/// Accessing a vector that straddles two lines takes two accesses, and reading one back right after it was
/// written is slow.
#[derive(Debug)]
pub struct Aligned<T> {
    /// Padding up to the cache line, then the numbers.
    room: Vec<T>,
    first: usize,
}

impl<T: Copy + Default> Aligned<T> {
    /// `len` default numbers, zeros.
    pub fn zeros(len: usize) -> Self {
        let mut room = vec![T::default(); len + LINE / size_of::<T>().max(1)];
        let offset = room.as_ptr().align_offset(LINE);
        let first = if offset + len <= room.len() { offset } else { 0 };
        room.truncate(first + len);
        Self { room, first }
    }
}

impl<T: Copy + Default> From<&[T]> for Aligned<T> {
    fn from(numbers: &[T]) -> Self {
        let mut aligned = Self::zeros(numbers.len());
        aligned.as_mut().copy_from_slice(numbers);
        aligned
    }
}

impl<T: Copy + Default> FromIterator<T> for Aligned<T> {
    fn from_iter<I: IntoIterator<Item = T>>(numbers: I) -> Self {
        numbers.into_iter().collect::<Vec<T>>().as_slice().into()
    }
}

/// The clone gets its own padding, since its address differs.
impl<T: Copy + Default> Clone for Aligned<T> {
    fn clone(&self) -> Self {
        self.as_ref().into()
    }
}

impl<T> AsRef<[T]> for Aligned<T> {
    fn as_ref(&self) -> &[T] {
        &self.room[self.first..]
    }
}

impl<T> AsMut<[T]> for Aligned<T> {
    fn as_mut(&mut self) -> &mut [T] {
        &mut self.room[self.first..]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clones_and_copies_start_on_a_line_too() {
        let numbers: Vec<f64> = (0..37).map(f64::from).collect();
        let aligned = Aligned::from(&numbers[1..]);
        for copy in [&aligned.clone(), &aligned.clone().clone(), &aligned] {
            assert_eq!(copy.as_ref(), &numbers[1..]);
            assert_eq!(copy.as_ref().as_ptr().align_offset(LINE), 0);
        }
    }
}
