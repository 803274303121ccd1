//! Slices of few numbers as arrays, whose length the compiler knows.

/// The N numbers of a slice.
#[inline(always)]
pub(super) fn few<T, const N: usize>(numbers: &[T]) -> &[T; N] {
    numbers.first_chunk().expect("N numbers")
}

/// The N numbers of a slice.
#[inline(always)]
pub(super) fn few_mut<T, const N: usize>(numbers: &mut [T]) -> &mut [T; N] {
    numbers.first_chunk_mut().expect("N numbers")
}
