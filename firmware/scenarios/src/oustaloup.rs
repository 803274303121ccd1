//! Oustaloup's filter, commonly used for fractional-order controllers, for comparison.

use fvi_core::Real;

/// Approximation of s^β by a chain of first-order sections, each discretised by Tustin's rule.
///
/// ```text
/// s^β ≈ ω_h^β Π_{k=1}^{S} (s + ω′_k) / (s + ω_k) ,     ω′_k, ω_k = ω_b (ω_h/ω_b)^{(k − ½ ∓ β/2)/S}
/// ```
///
/// accurate between the frequencies ω_b and ω_h. Source: \[Oustaloup00\].
#[derive(Clone, Debug)]
pub struct Oustaloup<T, const S: usize> {
    gain: T,
    sections: [Section<T>; S],
}

/// y = b₀ x + z ,  z ← b₁ x − a y.
#[derive(Clone, Copy, Debug, Default)]
struct Section<T> {
    b0: T,
    b1: T,
    a: T,
    z: T,
}

impl<T: Real, const S: usize> Oustaloup<T, S> {
    /// The filter for the exponent β, the band from `low` to `high` in radians per second, and the step size
    /// h.
    pub fn new(exponent: f64, low: f64, high: f64, step_size: f64) -> Self {
        let mut sections = [Section::default(); S];
        for (k, section) in sections.iter_mut().enumerate() {
            let place = |shift: f64| {
                let fraction = (k as f64 + 0.5 + shift * exponent / 2.0) / S as f64;
                low * (high / low).power(fraction) * step_size / 2.0
            };
            let (zero, pole) = (place(-1.0), place(1.0));
            *section = Section {
                b0: T::of((1.0 + zero) / (1.0 + pole)),
                b1: T::of((zero - 1.0) / (1.0 + pole)),
                a: T::of((pole - 1.0) / (1.0 + pole)),
                z: T::zero(),
            };
        }
        Self { gain: T::of(high.power(exponent)), sections }
    }

    /// Takes a sample and returns the output of the filter.
    #[inline]
    pub fn push(&mut self, sample: T) -> T {
        self.sections.iter_mut().fold(self.gain * sample, |x, section| {
            let y = section.b0 * x + section.z;
            section.z = section.b1 * x - section.a * y;
            y
        })
    }
}
