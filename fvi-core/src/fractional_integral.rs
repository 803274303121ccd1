//! Fractional integrals on a stream with a state that can be set: an integral of a fractional derivative.

use crate::error::ParameterError;
use crate::kernel::{Kernel, Rule};
use crate::linear::at;
use crate::memory::Memory;
use crate::operator::{FractionalOperator, OperatorError, Pending, Start};
use crate::real::{Real, sum_and_rest};
use crate::saving::{Shape, StateError, StateReader, StateWriter, Stateful, header_bytes};
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
/// **History of a set state.** Only s is set; D^{1−λ} keeps its history. After 1 s of x = 1 and then zeros
/// I^0.8 falls from 1.07 to 0.34 within 100 s, and from any value that s was set to it falls by the same
/// 0.73. [`restart`](FractionalIntegral::restart) clears the history of D^{1−λ}: then s stays at its value
/// until samples change it.
///
/// **Use a memory on increments** for λ < 1 ([`monic_increment_table`](crate::monic_increment_table), `fvi
/// exponentials --increments`). The weights of a table on values have errors ε that do not cancel for a
/// constant signal as the weights do: s then drifts by ε h^λ for each sample, k^{1−λ} ε of I^λ after k of
/// them. On increments the error stays at ε.
///
/// **Over long times in single precision** use for λ < 1 the memory of I^λ itself,
/// [`of_integral`](FractionalIntegral::of_integral): s is then its value plus an offset that can be set, and
/// nothing is summed. Its error stays at 4·10⁻⁷ of the largest value for any number of samples, as that of
/// [`FractionalPid`](crate::FractionalPid) does. As the integral of a derivative, s accumulates the rounding
/// errors of the values of D^{1−λ}, at worst N^{1−λ} of their last digits after N samples. For λ ≥ 1 nothing
/// accumulates.
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
    /// Step size of the sum; `None` where the operator is I^λ itself.
    step_size: Option<T>,
    /// s.
    sum: T,
    /// Rounding error of s (compensated summation), or the offset of s from the value of I^λ.
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
    pub fn new(kernel: &Kernel, memory: M) -> Result<Self, ParameterError> {
        let exponent = kernel.symbol().growth();
        ParameterError::check(
            exponent > -1.0 && exponent < 1.0,
            "exponent",
            exponent,
            "1 less the order of the integral, between -1 and 1",
        )?;
        let (derivative, step_size) = Self::operator(kernel, memory)?;
        Ok(Self { derivative, step_size: Some(T::of(step_size)), sum: T::zero(), rest: T::zero() })
    }

    /// The integral of order λ < 1 on an empty memory of the given kernel, that of I^λ = D^{−λ}:
    ///
    /// ```text
    /// s_k = (I^λ x)_k + c ,
    /// ```
    ///
    /// where [`set`](FractionalIntegral::set) changes c and [`restart`](FractionalIntegral::restart) clears
    /// the history of I^λ. The values are those of [`new`](FractionalIntegral::new) on D^{1−λ}, set or not.
    ///
    /// # Errors
    /// As [`new`](FractionalIntegral::new), for an exponent −λ in (−1, 0).
    pub fn of_integral(kernel: &Kernel, memory: M) -> Result<Self, ParameterError> {
        let exponent = kernel.symbol().growth();
        let allowed = "minus the order of the integral, between -1 and 0";
        ParameterError::check(exponent > -1.0 && exponent < 0.0, "exponent", exponent, allowed)?;
        let (derivative, _) = Self::operator(kernel, memory)?;
        Ok(Self { derivative, step_size: None, sum: T::zero(), rest: T::zero() })
    }

    /// The operator of a kernel with a step size, and that step size.
    fn operator(kernel: &Kernel, mut memory: M) -> Result<(FractionalOperator<T, M>, f64), ParameterError> {
        let allowed = "one of backward differentiation of order 1, with a step size";
        let wrong = ParameterError { parameter: "kernel", value: f64::NAN, allowed };
        let step_size = kernel
            .step_size()
            .filter(|_| kernel.rule() == Rule::Bdf(BdfOrder::GRUNWALD_LETNIKOV))
            .ok_or(wrong)?;
        let channels = memory.channels();
        ParameterError::check(channels == 1, "channels", channels as f64, "1")?;
        kernel.check(&mut memory, 0)?;
        let derivative = FractionalOperator::new(memory, Start::RiemannLiouville).map_err(|_| wrong)?;
        Ok((derivative, step_size))
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
        let (sum, rest) = match self.step_size {
            Some(step) => sum_and_rest(self.sum, step * derivative.value() + self.rest),
            None => (derivative.value() + self.rest, self.rest),
        };
        if !sum.is_finite() {
            return Err(OperatorError::NotFinite);
        }
        Ok(PendingIntegral { derivative, sum: (&mut self.sum, sum), rest: (&mut self.rest, rest) })
    }

    /// Change of the next value for a unit of the next sample, h^λ.
    pub fn leading(&self) -> T {
        let leading = at(self.derivative.memory().leading(), 0);
        self.step_size.map_or(leading, |step| step * leading)
    }

    /// The value s after the last sample; 0 before the first.
    #[inline]
    pub fn value(&self) -> T {
        self.sum
    }

    /// Sets s. The operator keeps its history; see [`restart`](FractionalIntegral::restart).
    ///
    /// # Errors
    /// [`OperatorError::NotFinite`] if it is not a finite number, or its offset from the value of I^λ is not.
    pub fn set(&mut self, value: T) -> Result<(), OperatorError> {
        let rest = match self.step_size {
            Some(_) => T::zero(),
            None => self.rest + (value - self.sum),
        };
        if !value.is_finite() || !rest.is_finite() {
            return Err(OperatorError::NotFinite);
        }
        (self.sum, self.rest) = (value, rest);
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

    /// Clears all samples and continues from s = `value`.
    ///
    /// # Errors
    /// [`OperatorError::NotFinite`] if it is not a finite number; nothing is forgotten then.
    pub fn restart(&mut self, value: T) -> Result<(), OperatorError> {
        if !value.is_finite() {
            return Err(OperatorError::NotFinite);
        }
        self.clear();
        self.set(value)
    }

    /// Forgets all samples.
    pub fn clear(&mut self) {
        self.derivative.clear();
        (self.sum, self.rest) = (T::zero(), T::zero());
    }

    /// The operator D^{1−λ} whose values are summed, or I^λ.
    pub fn derivative(&self) -> &FractionalOperator<T, M> {
        &self.derivative
    }

    /// Header of the saved state: the values that must match when it is restored.
    fn shape(&self) -> Shape<1> {
        [("bits of the step size of the sum", self.step_size.map_or(0, Real::bits))]
    }
}

impl<T: Real, M: Memory<T>> Stateful for FractionalIntegral<T, M> {
    fn state_bytes(&self) -> usize {
        header_bytes(1) + 2 * T::BYTES + self.derivative.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 1>(TAG, &self.shape())?;
        to.slice(&[self.sum, self.rest])?;
        self.derivative.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.header::<T, 1>(TAG, &self.shape())?;
        from.skip::<T>(2)?;
        self.derivative.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let mut ahead = from.clone();
        ahead.header::<T, 1>(TAG, &self.shape())?;
        let mut numbers = [T::zero(); 2];
        ahead.fill(&mut numbers)?;
        self.derivative.restore(&mut ahead)?;
        [self.sum, self.rest] = numbers;
        *from = ahead;
        Ok(())
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
    fn on_the_memory_of_the_integral_values_are_the_same_set_or_not() {
        static INTEGRAL: [f64; 256] = monic_bdf_table(ORDER, -0.8);
        let made =
            || FractionalIntegral::of_integral(&kernel(-0.8), kernel(-0.8).full_memory(&INTEGRAL).unwrap());
        let (mut summed, mut direct) = (on(0.2, &FIFTH), made().unwrap());
        assert!((direct.leading() - libm::pow(STEP, 0.8)).abs() < 1e-15);
        for k in 0..250 {
            let sample = libm::sin(0.1 * f64::from(k)) + 0.25;
            let (expected, value) = (summed.push(sample).unwrap(), direct.push(sample).unwrap());
            assert!((value - expected).abs() < 1e-13, "{k}: {value} {expected}");
            for integral in [&mut summed, &mut direct] {
                match k {
                    20 | 40 => integral.set(0.3).unwrap(),
                    60 => integral.restart(-0.2).unwrap(),
                    80.. => integral.clamp(-0.5, 0.4).unwrap(),
                    _ => {}
                }
            }
            if k % 20 == 0 {
                assert!((direct.value() - summed.value()).abs() < 1e-13);
                let mut bytes = vec![0; direct.state_bytes()];
                direct.save(&mut StateWriter::new(&mut bytes)).unwrap();
                let mut restored = made().unwrap();
                restored.restore(&mut StateReader::new(&bytes)).unwrap();
                assert_eq!((restored.peek(0.5), restored.value()), (direct.peek(0.5), direct.value()));
                assert!(on(0.2, &FIFTH).restore(&mut StateReader::new(&bytes)).is_err());
            }
        }
        // Refused, with nothing changed.
        let before = (direct.value(), direct.derivative().memory().len());
        assert!(
            direct.set(f64::NAN).is_err()
                && direct.restart(f64::NAN).is_err()
                && direct.push(f64::NAN).is_err()
        );
        assert_eq!((direct.value(), direct.derivative().memory().len()), before);
        let refused = FractionalIntegral::of_integral(
            &kernel(0.2),
            kernel(0.2).full_memory::<f64, 1, 256>(&FIFTH).unwrap(),
        );
        assert_eq!(refused.map(|_| ()).unwrap_err().parameter, "exponent");
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
            assert_eq!(restored.check_state(&mut reader.clone()), Ok(()));
            assert_eq!((restored.restore(&mut reader), reader.finish()), (Ok(()), Ok(())));
            let short = StateReader::new(&bytes[..bytes.len() - 1]);
            assert!(restored.check_state(&mut short.clone()).is_err());
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
