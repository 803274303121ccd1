//! Fractional integrals on a stream with a state that can be set: an integral of a fractional derivative.

use crate::error::ParameterError;
use crate::kernel::{Kernel, Rule};
use crate::memory::Memory;
use crate::operator::{FractionalOperator, OperatorError, Pending, Start};
use crate::real::Real;
use crate::saving::{Shape, StateError, StateReader, StateWriter, header_bytes};
use crate::weights::BdfOrder;

/// Fractional integral of order λ on a stream, 0 < λ < 2, as the integral of a derivative:
///
/// ```text
/// I^λ x = I¹ D^{1−λ} x :        d_k = (D^{1−λ} x)_k ,      s_k = s_{k−1} + h d_k ,      s_{−1} = 0 .
/// ```
///
/// The values are those of the weights of I^λ of order 1, (h/(1 − z))^λ = h/(1 − z) · ((1 − z)/h)^{1−λ}. But
/// the sum s is exact to rounding, kept in two parts, and it is one number that can be read, clamped and
/// [`set`](FractionalIntegral::set): for limits, and for transfer without a bump. For λ > 1, where D^{1−λ}
/// itself is an integral, and for λ = 1, where it is the identity, nothing else changes.
///
/// **What a set state remembers.** Only s is set; D^{1−λ} still knows the past. After 1 s of x = 1 and then
/// zeros I^0.8 falls from 1.07 to 0.34 within 100 s, and from whatever value s was given it falls by those
/// 0.73 as well. [`restart`](FractionalIntegral::restart) lets D^{1−λ} forget: then s stays where it was put
/// until samples move it.
///
/// **Take a memory on increments** for λ < 1
/// ([`monic_increment_table`](crate::monic_increment_table), `fvi exponentials --increments`). That of a
/// table on values has errors ε of its weights, which for a signal that stays do not cancel as the weights
/// do: s then drifts by ε h^λ for each sample, k^{1−λ} ε of I^λ after k of them. On increments the error
/// stays at ε.
///
/// **In single precision** for λ < 1 the sum accumulates the rounding errors of the memory of D^{1−λ}: with
/// exponential sums, over 10⁷ samples with a nonzero mean, 10⁻³ of the value for λ = 0.5 and 5·10⁻³ for λ =
/// 0.9, in proportion to the number of samples. The [`FractionalOperator`] of exponent −λ stays within
/// 4·10⁻⁷, and so does [`FractionalPid`](crate::FractionalPid), which uses it. For λ ≥ 1 nothing accumulates.
///
/// ```
/// # use fvi_core::{BdfOrder, FractionalIntegral, Kernel, monic_increment_table};
/// static WEIGHTS: [f64; 256] = monic_increment_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
/// // The half integral, from the half derivative.
/// let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 0.01)?;
/// let mut half_integral = FractionalIntegral::new(&kernel, kernel.full_memory::<f64, 1, 256>(&WEIGHTS)?)?;
/// for _ in 0..=100 {
///     half_integral.push(1.0)?;
/// }
/// // That of 1 at t = 1 is 2/√π.
/// assert!((half_integral.value() - 1.128).abs() < 5e-3);
/// half_integral.clamp(-1.0, 1.0)?;
/// assert_eq!(half_integral.value(), 1.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Source: \[Lubich86\] for the product of the symbols.
#[derive(Clone, Debug)]
pub struct FractionalIntegral<T, M> {
    derivative: FractionalOperator<T, M>,
    step_size: T,
    /// s.
    sum: T,
    /// Rounding error of s so far (compensated summation).
    rest: T,
}

/// A sample whose value an integral has computed but not yet taken; if dropped, the integral is unchanged.
#[derive(Debug)]
#[must_use = "the integral has not taken the sample"]
pub struct PendingIntegral<'a, T, M> {
    derivative: Pending<'a, T, M>,
    sum: (&'a mut T, T),
    rest: (&'a mut T, T),
}

impl<T: Real, M: Memory<T>> PendingIntegral<'_, T, M> {
    /// (I^λ x)_k.
    #[inline]
    pub fn value(&self) -> T {
        self.sum.1
    }

    /// Takes the sample and returns (I^λ x)_k.
    ///
    /// # Errors
    /// None, of a memory that keeps the contract of [`Memory`].
    #[inline]
    pub fn take(self) -> Result<T, OperatorError> {
        let Self { derivative, sum, rest } = self;
        derivative.take()?;
        *rest.0 = rest.1;
        *sum.0 = sum.1;
        Ok(sum.1)
    }
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"inte";

impl<T: Real, M: Memory<T>> FractionalIntegral<T, M> {
    /// The integral of order λ = 1 − β on an empty memory of the given kernel, that of D^β.
    ///
    /// # Errors
    /// [`ParameterError`] if β is not in (−1, 1), the rule is not the backward differentiation formula of
    /// order 1 with a step size, or the memory does not have one channel with the weights of the kernel.
    pub fn new(kernel: &Kernel, mut memory: M) -> Result<Self, ParameterError> {
        let (exponent, step) = (kernel.symbol().growth(), kernel.step_size());
        ParameterError::check(
            exponent > -1.0 && exponent < 1.0,
            "exponent",
            exponent,
            "1 less the order of the integral, between -1 and 1",
        )?;
        let allowed = "one of backward differentiation of order 1, with a step size";
        let wrong = ParameterError { parameter: "kernel", value: f64::NAN, allowed };
        let step_size =
            step.filter(|_| kernel.rule() == Rule::Bdf(BdfOrder::GRUNWALD_LETNIKOV)).ok_or(wrong)?;
        let channels = memory.channels();
        ParameterError::check(channels == 1, "channels", channels as f64, "1")?;
        kernel.check(&mut memory, 0)?;
        let derivative = FractionalOperator::new(memory, Start::RiemannLiouville).map_err(|_| wrong)?;
        Ok(Self { derivative, step_size: T::of(step_size), sum: T::zero(), rest: T::zero() })
    }

    /// Takes the next sample x_k and returns (I^λ x)_k.
    ///
    /// # Errors
    /// As [`FractionalOperator::push`]; the integral then is as before.
    #[inline]
    pub fn push(&mut self, sample: T) -> Result<T, OperatorError> {
        self.prepare(sample)?.take()
    }

    /// What [`push`](FractionalIntegral::push) would return; the integral stays as it is.
    ///
    /// # Errors
    /// As there.
    #[inline]
    pub fn peek(&mut self, sample: T) -> Result<T, OperatorError> {
        Ok(self.prepare(sample)?.value())
    }

    /// Computes (I^λ x)_k for the next sample, which [`PendingIntegral::take`] takes; see
    /// [`FractionalOperator::prepare`].
    ///
    /// # Errors
    /// As those of [`push`](FractionalIntegral::push).
    #[inline]
    pub fn prepare(&mut self, sample: T) -> Result<PendingIntegral<'_, T, M>, OperatorError> {
        let derivative = self.derivative.prepare(sample)?;
        let gain = self.step_size * derivative.value() + self.rest;
        let sum = self.sum + gain;
        if !sum.is_finite() {
            return Err(OperatorError::NotFinite);
        }
        // Exact rounding error of the sum.
        let second = sum - self.sum;
        let rest = (self.sum - (sum - second)) + (gain - second);
        Ok(PendingIntegral { derivative, sum: (&mut self.sum, sum), rest: (&mut self.rest, rest) })
    }

    /// Change of the next value for a unit of the next sample, h w₀ = h^λ.
    pub fn leading(&self) -> T {
        let leading = self.derivative.memory().leading().first().copied().unwrap_or(T::zero());
        self.step_size * leading
    }

    /// The value s after the last sample; 0 before the first.
    #[inline]
    pub fn value(&self) -> T {
        self.sum
    }

    /// Sets s. D^{1−λ} keeps its history; see [`restart`](FractionalIntegral::restart).
    ///
    /// # Errors
    /// [`OperatorError::NotFinite`] if it is not a finite number.
    pub fn set(&mut self, value: T) -> Result<(), OperatorError> {
        if !value.is_finite() {
            return Err(OperatorError::NotFinite);
        }
        (self.sum, self.rest) = (value, T::zero());
        Ok(())
    }

    /// Sets s to the nearest value within limits, if it is outside.
    ///
    /// # Errors
    /// [`OperatorError::NotFinite`] if a limit is not a number or the lower one is above the other.
    pub fn clamp(&mut self, lower: T, upper: T) -> Result<(), OperatorError> {
        let ordered = lower <= upper;
        if !ordered {
            return Err(OperatorError::NotFinite);
        }
        if self.sum > upper {
            self.set(upper)
        } else if self.sum < lower {
            self.set(lower)
        } else {
            Ok(())
        }
    }

    /// Forgets all samples and goes on from s = `value`.
    ///
    /// # Errors
    /// [`OperatorError::NotFinite`] if it is not a finite number; nothing is forgotten then.
    pub fn restart(&mut self, value: T) -> Result<(), OperatorError> {
        self.set(value)?;
        self.derivative.clear();
        Ok(())
    }

    /// Forgets all samples.
    pub fn clear(&mut self) {
        self.derivative.clear();
        (self.sum, self.rest) = (T::zero(), T::zero());
    }

    /// The operator D^{1−λ} whose values are summed.
    pub fn derivative(&self) -> &FractionalOperator<T, M> {
        &self.derivative
    }

    /// Number of bytes that [`save`](FractionalIntegral::save) writes at present.
    pub fn state_bytes(&self) -> usize {
        header_bytes(1) + 2 * T::BYTES + self.derivative.state_bytes()
    }

    /// Writes the state. An integral with the same parameters that restores it continues with identical bits.
    ///
    /// # Errors
    /// [`StateError::NoRoom`], and the errors of the memory.
    pub fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 1>(TAG, &self.shape())?;
        to.numbers([&self.sum, &self.rest])?;
        self.derivative.save(to)
    }

    /// Replaces the state by a saved one.
    ///
    /// # Errors
    /// [`StateError`] if the bytes are not the state of such an integral, which then is unchanged.
    pub fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let mut ahead = from.clone();
        ahead.header::<T, 1>(TAG, &self.shape())?;
        let (sum, rest) = (ahead.number()?, ahead.number()?);
        self.derivative.restore(&mut ahead)?;
        (self.sum, self.rest) = (sum, rest);
        *from = ahead;
        Ok(())
    }

    /// Header of the saved state: what a state must agree with to be restored.
    fn shape(&self) -> Shape<1> {
        [("bits of the step size", self.step_size.bits())]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::direct::FixedDirect;
    use crate::memory::MemoryError;
    use crate::operator::left_operator;
    use crate::weights::{ConvolutionWeights, monic_bdf_table, monic_increment_table};
    use std::vec;
    use std::vec::Vec;

    const ORDER: BdfOrder = BdfOrder::GRUNWALD_LETNIKOV;
    const STEP: f64 = 0.01;

    type Ring = FixedDirect<'static, f64, 1, 256>;

    fn kernel(exponent: f64) -> Kernel {
        Kernel::bdf(ORDER, exponent, STEP).unwrap()
    }

    fn on(exponent: f64, weights: &'static [f64]) -> FractionalIntegral<f64, Ring> {
        FractionalIntegral::new(&kernel(exponent), kernel(exponent).full_memory(weights).unwrap()).unwrap()
    }

    static FIFTH: [f64; 256] = monic_increment_table(ORDER, 0.2);
    static FIFTH_OF_VALUES: [f64; 256] = monic_bdf_table(ORDER, 0.2);
    static NONE: [f64; 256] = monic_bdf_table(ORDER, 0.0);
    static ABOVE: [f64; 256] = monic_bdf_table(ORDER, -0.6);

    /// Weights of I^λ; those of λ > 1 are sums of those of λ − 1.
    fn weights(order: f64) -> Vec<f64> {
        let of = |order: f64| ConvolutionWeights::bdf(ORDER, -order, STEP).unwrap().take(256);
        if order < 1.0 {
            return of(order).collect();
        }
        let sum = |sum: &mut f64, weight: f64| {
            *sum += STEP * weight;
            Some(*sum)
        };
        of(order - 1.0).scan(0.0, sum).collect()
    }

    #[test]
    fn values_are_those_of_the_weights_of_the_integral() {
        let samples: Vec<f64> = (0..256).map(|k| libm::sin(0.1 * f64::from(k)) + 0.25).collect();
        for (order, table) in [(0.8, &FIFTH), (0.8, &FIFTH_OF_VALUES), (1.0, &NONE), (1.6, &ABOVE)] {
            let mut expected = vec![0.0; 256];
            left_operator(&weights(order), &samples, &mut expected);
            let mut integral = on(1.0 - order, table);
            assert!((integral.leading() - libm::pow(STEP, order)).abs() < 1e-15);
            for (k, (&sample, expected)) in samples.iter().zip(expected).enumerate() {
                let peeked = integral.peek(sample).unwrap();
                let (before, value) = (integral.value(), integral.push(sample).unwrap());
                assert!((value - expected).abs() < 1e-12, "order {order}, sample {k}: {value} {expected}");
                assert_eq!((value, value), (peeked, integral.value()));
                assert!(k == 0 || before != value);
            }
        }
    }

    #[test]
    fn a_state_that_is_set_moves_as_it_would_have_and_one_that_is_restarted_stays() {
        let mut integral = on(0.2, &FIFTH);
        for _ in 0..100 {
            integral.push(1.0).unwrap();
        }
        let (mut set, mut restarted) = (integral.clone(), integral.clone());
        let loaded = integral.value();
        set.set(0.0).unwrap();
        restarted.restart(0.5).unwrap();
        for _ in 0..150 {
            let (value, moved) = (integral.push(0.0).unwrap(), set.push(0.0).unwrap());
            assert!((value - loaded - moved).abs() < 1e-14);
            assert_eq!(restarted.push(0.0), Ok(0.5));
        }
        assert!(set.value() < -0.1);
        for (value, expected) in [(3.0, 2.0), (-3.0, -1.0), (0.5, 0.5)] {
            set.set(value).unwrap();
            set.clamp(-1.0, 2.0).unwrap();
            assert_eq!(set.value(), expected);
        }
        assert!(set.clamp(1.0, -1.0).is_err() && set.clamp(f64::NAN, 1.0).is_err());
        assert_eq!(
            (set.set(f64::NAN), set.restart(f64::INFINITY)),
            (Err(OperatorError::NotFinite), Err(OperatorError::NotFinite))
        );
        assert_eq!((set.value(), set.derivative().memory().len()), (0.5, 250));
        set.clear();
        assert_eq!((set.value(), set.derivative().memory().len()), (0.0, 0));
    }

    #[test]
    fn what_is_refused_changes_nothing() {
        let mut integral = on(0.2, &FIFTH);
        integral.push(1.0).unwrap();
        let value = integral.value();
        assert_eq!(integral.push(f64::NAN), Err(OperatorError::NotFinite));
        drop(integral.prepare(7.0).unwrap());
        assert_eq!((integral.value(), integral.derivative().memory().len()), (value, 1));
        integral.set(f64::MAX).unwrap();
        assert_eq!(integral.push(f64::MAX * 1e-3), Err(OperatorError::NotFinite));
        for _ in 0..255 {
            integral.push(0.0).unwrap();
        }
        assert_eq!(integral.push(0.0), Err(MemoryError::Full { capacity: 256 }.into()));
    }

    #[test]
    fn kernels_that_are_none_of_its_derivative_are_refused() {
        let memory = || kernel(0.2).full_memory::<f64, 1, 256>(&FIFTH).unwrap();
        let refused =
            |kernel: &Kernel| FractionalIntegral::new(kernel, memory()).map(|_| ()).unwrap_err().parameter;
        assert_eq!(refused(&kernel(1.0)), "exponent");
        assert_eq!(refused(&kernel(1.2)), "exponent");
        assert_eq!(refused(&Kernel::given(0.2).unwrap()), "kernel");
        assert_eq!(refused(&Kernel::bdf(BdfOrder::new(2).unwrap(), 0.2, STEP).unwrap()), "kernel");
        assert_eq!(refused(&kernel(0.3)), "leading weight of the memory");
        assert_eq!(refused(&Kernel::bdf(ORDER, 0.2, 0.02).unwrap()), "leading weight of the memory");
        let two = kernel(0.2).full_memory::<f64, 2, 256>(&FIFTH).unwrap();
        assert_eq!(FractionalIntegral::new(&kernel(0.2), two).map(|_| ()).unwrap_err().parameter, "channels");
    }

    #[test]
    fn a_saved_state_goes_on_with_the_same_bits() {
        let mut integral = on(0.2, &FIFTH);
        for k in 0..40 {
            let mut bytes = vec![0; integral.state_bytes()];
            let mut writer = StateWriter::new(&mut bytes);
            integral.save(&mut writer).unwrap();
            assert_eq!(writer.written(), bytes.len());
            let mut restored = on(0.2, &FIFTH);
            let mut reader = StateReader::new(&bytes);
            assert_eq!((restored.restore(&mut reader), reader.finish()), (Ok(()), Ok(())));
            let short = StateReader::new(&bytes[..bytes.len() - 1]);
            assert!(restored.restore(&mut short.clone()).is_err());
            assert!(on(0.0, &NONE).restore(&mut StateReader::new(&bytes)).is_err());
            let sample = libm::cos(f64::from(k));
            assert_eq!(restored.push(sample), integral.push(sample));
            assert_eq!(
                (restored.sum.to_bits(), restored.rest.to_bits()),
                (integral.sum.to_bits(), integral.rest.to_bits())
            );
        }
    }

    #[test]
    fn ten_million_samples_leave_no_drift_in_single_precision() {
        // λ = 1 alone, an accumulator, with numbers that single precision rounds.
        static ONE: [f32; 1] = [1.0];
        let kernel = Kernel::bdf(ORDER, 0.0, 1e-3).unwrap();
        let memory = kernel.short_memory::<f32, 1, 1>(&ONE).unwrap();
        let mut integral = FractionalIntegral::new(&kernel, memory).unwrap();
        let mut expected = 0.0f64;
        for k in 0..10_000_000u32 {
            let sample = 0.1 + (k % 7) as f32 * 0.013;
            integral.push(sample).unwrap();
            expected += f64::from(1e-3f32) * f64::from(sample);
        }
        let error = f64::from(integral.value()) / expected - 1.0;
        assert!(error.abs() < 6e-8, "{error:e}");
    }
}
