//! Rows of sixteen numbers, the unit in which outputs are prepared.

use pulp::Simd;

use crate::engines::scalar::Scalar;

/// Number of outputs that are prepared together.
pub(crate) const CHUNK: usize = 16;

/// Sixteen numbers on whole cache lines, a whole number of vectors of every unit.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(crate) struct Row<T>(pub(crate) [T; CHUNK]);

impl<T: Scalar> Row<T> {
    pub(crate) fn zeros() -> Self {
        Self([T::zero(); CHUNK])
    }

    /// The row in vectors.
    #[inline(always)]
    pub(crate) fn parts<V: Simd>(&self) -> &[T::Reals<V>] {
        T::reals::<V>(&self.0)
    }

    /// The row in vectors, mutable.
    #[inline(always)]
    pub(crate) fn parts_mut<V: Simd>(&mut self) -> &mut [T::Reals<V>] {
        T::reals_mut::<V>(&mut self.0)
    }

    /// self += x row, for a row that is zero up to `place`.
    #[inline(always)]
    pub(crate) fn add_multiple<V: Simd>(&mut self, unit: V, row: &Self, x: T, place: usize) {
        let x = T::in_lanes(unit, x);
        let (numbers, others) = (self.parts_mut::<V>(), row.parts::<V>());
        let half = numbers.len() / 2;
        let (first, second) = numbers.split_at_mut(half);
        let (first_others, second_others) = others.split_at(half);
        if place + 1 < CHUNK / 2 {
            for (number, &other) in first.iter_mut().zip(first_others) {
                *number = T::plus_product(unit, other, x, *number);
            }
        }
        for (number, &other) in second.iter_mut().zip(second_others) {
            *number = T::plus_product(unit, other, x, *number);
        }
    }
}

/// row += Σ_i x_i rows_i, for an even number of rows.
///
/// Two accumulators per lane: the sums are independent, and their rounding error is smaller than that of one.
#[inline(always)]
pub(crate) fn add_product<'a, T: Scalar, V: Simd>(
    unit: V,
    row: &mut Row<T>,
    products: impl IntoIterator<Item = (&'a Row<T>, T)>,
) {
    let zero = T::in_lanes(unit, T::zero());
    let (mut even, mut odd) = ([zero; CHUNK], [zero; CHUNK]);
    let mut products = products.into_iter();
    while let (Some((first, x)), Some((second, y))) = (products.next(), products.next()) {
        let (x, y) = (T::in_lanes(unit, x), T::in_lanes(unit, y));
        let parts = first.parts::<V>().iter().zip(second.parts::<V>());
        for ((even, odd), (&first, &second)) in even.iter_mut().zip(&mut odd).zip(parts) {
            *even = T::plus_product(unit, first, x, *even);
            *odd = T::plus_product(unit, second, y, *odd);
        }
    }
    for ((number, even), odd) in row.parts_mut::<V>().iter_mut().zip(even).zip(odd) {
        *number = T::plus(unit, *number, T::plus(unit, even, odd));
    }
}
