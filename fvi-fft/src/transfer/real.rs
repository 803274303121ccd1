//! Real parameters of transfer functions.

use fvi_core::DoubleDouble;

/// A real number with its derivative by one parameter θ.
#[derive(Clone, Copy, Debug)]
pub struct Real {
    /// The number.
    pub value: DoubleDouble,
    /// Its derivative by θ: 1 for θ itself, 0 for what does not depend on it.
    pub slope: f64,
}

impl Real {
    /// The number in double precision.
    pub fn to_f64(self) -> f64 {
        self.value.to_f64()
    }

    /// The number less another one.
    #[must_use]
    pub fn less(self, other: Self) -> Self {
        Self { value: self.value.add(other.value.scale(-1.0)), slope: self.slope - other.slope }
    }

    /// The number less 1.
    #[must_use]
    pub fn less_one(self) -> Self {
        self.less(1.0.into())
    }

    /// The negative.
    #[must_use]
    pub fn negative(self) -> Self {
        Self { value: self.value.scale(-1.0), slope: -self.slope }
    }
}

impl From<f64> for Real {
    fn from(value: f64) -> Self {
        Self { value: DoubleDouble::exact(value), slope: 0.0 }
    }
}
