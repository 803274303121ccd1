//! Numbers that several matrices may share.

use fvi_core::Real;
use std::any::Any;
use std::ops::Deref;
use std::sync::Arc;

/// The entries of a sparse matrix, owned or shared with other matrices. Those of finite-element models take
/// more memory than all vectors together.
#[derive(Clone, Debug)]
pub enum Shared<T> {
    /// Owned by one matrix.
    Own(Vec<T>),
    /// Shared by several matrices.
    Common(Arc<Vec<T>>),
}

impl<T: Real> Shared<T> {
    /// Numbers of a scenario in the precision of `T`: shared with the scenario if that is double precision.
    pub fn of(numbers: &Arc<Vec<f64>>) -> Self {
        let any: Arc<dyn Any + Send + Sync> = Arc::<Vec<f64>>::clone(numbers);
        match any.downcast::<Vec<T>>() {
            Ok(numbers) => Self::Common(numbers),
            Err(_) => Self::Own(numbers.iter().map(|&number| T::of(number)).collect()),
        }
    }

    /// The numbers, mutable; shared ones are copied first.
    #[inline]
    pub fn own(&mut self) -> &mut [T] {
        if let Self::Common(numbers) = self {
            *self = Self::Own(numbers.to_vec());
        }
        match self {
            Self::Own(numbers) => numbers,
            Self::Common(_) => &mut [],
        }
    }
}

impl<T> Deref for Shared<T> {
    type Target = [T];

    #[inline]
    fn deref(&self) -> &[T] {
        match self {
            Self::Own(numbers) => numbers,
            Self::Common(numbers) => numbers,
        }
    }
}

/// Equality of the numbers, owned or shared.
impl<T: PartialEq> PartialEq for Shared<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn common_numbers_stay_as_they_are_where_others_hold_them() {
        let numbers = Arc::new(vec![1.5, 0.1]);
        let mut same = Shared::<f64>::of(&numbers);
        let rounded = Shared::<f32>::of(&numbers);
        assert!(matches!(&same, Shared::Common(held) if Arc::ptr_eq(held, &numbers)));
        assert_eq!(*rounded, [1.5, 0.1_f32]);
        let other = same.clone();
        same.own()[0] = 2.0;
        assert_eq!((same[0], other[0], numbers[0]), (2.0, 1.5, 1.5));
    }
}
