//! A fractional PID controller in whole numbers, for processors without a floating-point unit.
//!
//! Every operation is one on two's complement, so that the bits are the same everywhere; sums saturate, and
//! no input leads beyond the numbers.

use core::borrow::Borrow;

use crate::error::ParameterError;

/// Binary digits that the derivative's filter has more than an output.
const FILTER_DIGITS: u32 = 15;

/// A factor m 2^{−s}.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FixedGain {
    /// m; from 2³⁰ on in magnitude, if it has all its digits.
    pub mantissa: i32,
    /// s.
    pub shift: i32,
}

impl FixedGain {
    /// No effect.
    pub const ZERO: Self = Self { mantissa: 0, shift: 0 };

    /// The nearest factor to `value`, within 2⁻³¹ of it; `None` if it is not finite or beyond 2¹²⁷. Below
    /// 2⁻⁹⁵ it is zero: no number of 64 bits times it comes to half a unit.
    pub fn nearest(value: f64) -> Option<Self> {
        if !value.is_finite() {
            return None;
        }
        let (fraction, exponent) = libm::frexp(value);
        let mantissa = libm::round(libm::ldexp(fraction, 31));
        // Rounded up to the next power of two.
        let (mantissa, exponent) = if mantissa.abs() >= 2_147_483_648.0 {
            (0.5 * mantissa, exponent + 1)
        } else {
            (mantissa, exponent)
        };
        match 31 - exponent {
            _ if mantissa == 0.0 => Some(Self::ZERO),
            shift if shift > 126 => Some(Self::ZERO),
            shift if shift >= -96 => Some(Self { mantissa: mantissa as i32, shift }),
            _ => None,
        }
    }

    /// The factor as a number, exactly.
    pub fn value(self) -> f64 {
        libm::ldexp(f64::from(self.mantissa), -self.shift)
    }

    /// Bound on the error of its product with a number of 64 bits, in units of the product.
    pub fn rounding(self) -> f64 {
        match self.shift - 32 {
            _ if self.mantissa == 0 => 0.0,
            // What the upper digits leave out, and half a unit.
            shift if shift > 0 => 0.5 + libm::ldexp(1.0, -shift),
            shift => libm::ldexp(1.0, -shift),
        }
    }

    /// The factor times a number of 32 bits, rounded; what does not fit saturates.
    #[inline]
    fn times_word(self, number: i32) -> i64 {
        scaled(i64::from(number) * i64::from(self.mantissa), self.shift)
    }

    /// The factor times a number of 64 bits, rounded; what does not fit saturates.
    #[inline]
    fn times(self, number: i64) -> i64 {
        let mantissa = i64::from(self.mantissa);
        let low = (number & 0xffff_ffff) * mantissa;
        scaled((number >> 32) * mantissa + (low >> 32), self.shift.saturating_sub(32))
    }
}

/// number 2^{−shift}, rounded, halves upwards; what does not fit saturates.
#[inline]
fn scaled(number: i64, shift: i32) -> i64 {
    if shift > 0 {
        let twice = number >> (shift - 1).min(63);
        return (twice >> 1) + (twice & 1);
    }
    let up = shift.unsigned_abs().min(63);
    let moved = number << up;
    if moved >> up == number { moved } else { saturated(number) }
}

/// The number of 64 bits that is farthest on the side of `number`.
#[inline]
fn saturated(number: i64) -> i64 {
    if number < 0 { i64::MIN } else { i64::MAX }
}

/// The nearest number of 32 bits.
#[inline]
fn word(number: i64) -> i32 {
    number.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
}

/// A decaying exponential: z ← z + (2^lift x − decay z), of which output z is part of the operator.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FixedTerm {
    /// μ; zero for a sum that stays.
    pub decay: FixedGain,
    /// From z to the output.
    pub output: FixedGain,
    /// Binary digits of z behind those of a sample, 0 to 31.
    pub lift: i32,
}

/// An operator of a [`FixedLaw`], in the form of an [`ExponentialTable`](crate::ExponentialTable), with all
/// that stands between its samples and the output in the numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FixedOperator<'a> {
    /// The first weights, at least two before exponentials; empty for no operator.
    pub head: &'a [FixedGain],
    /// The exponentials.
    pub terms: &'a [FixedTerm],
}

impl FixedOperator<'_> {
    const fn state_len(&self) -> usize {
        self.terms.len() + self.head.len().saturating_sub(1)
    }

    fn leading(&self) -> FixedGain {
        self.head.first().copied().unwrap_or(FixedGain::ZERO)
    }

    /// The operator without the sample of this tick: Σ_{n≥1} of weights and samples before. Its exponentials
    /// take the oldest sample that the head has kept, which belongs to the next tick's.
    #[inline]
    fn term(&self, state: &mut [i64]) -> i64 {
        let Some((delayed, sums)) = state.split_at_mut_checked(self.head.len().saturating_sub(1)) else {
            return 0;
        };
        let mut term = 0i64;
        for (gain, sample) in self.head.iter().skip(1).zip(&*delayed) {
            term = term.saturating_add(gain.times_word(word(*sample)));
        }
        let oldest = delayed.last().copied().unwrap_or(0);
        for (exponential, sum) in self.terms.iter().zip(sums) {
            term = term.saturating_add(exponential.output.times(*sum));
            let taken = scaled(oldest, exponential.lift.saturating_neg());
            *sum = sum.saturating_sub(exponential.decay.times(*sum)).saturating_add(taken);
        }
        term
    }

    /// Stores the sample of this tick.
    #[inline]
    fn push(&self, state: &mut [i64], sample: i32) {
        let mut newest = i64::from(sample);
        for place in state.iter_mut().take(self.head.len().saturating_sub(1)) {
            newest = core::mem::replace(place, newest);
        }
    }
}

/// Anti-windup of a [`FixedLaw`], with factors from the output to samples of the integral.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FixedWindup {
    /// None.
    None,
    /// [`BackCalculation`](crate::AntiWindup::BackCalculation): 1/((τ^λ + w) K_i), w the leading weight.
    BackCalculation(FixedGain),
    /// [`Conditional`](crate::AntiWindup::Conditional): 1/(w K_i).
    Conditional(FixedGain),
}

/// The law of a [`FixedPid`]: that of a [`PidLaw`](crate::PidLaw) in the parallel form,
///
/// ```text
/// u* = K_p (b r − y) + K_i I^λ (r − y) + K_d D^μ (c r − y)_f ,        u = u* within limits ,
/// ```
///
/// with all factors between counts of the inputs and units 2⁻¹⁶ of a count of the output. It is plain data
/// for flash; `fvi controller --arithmetic fixed` makes it. Whatever its numbers, a tick is defined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FixedLaw<'a> {
    /// K_p b.
    pub setpoint: FixedGain,
    /// K_p.
    pub measured: FixedGain,
    /// K_i I^λ.
    pub integral: FixedOperator<'a>,
    /// K_d D^μ, on differences.
    pub derivative: FixedOperator<'a>,
    /// c 2⁵, from counts to units of samples.
    pub derivative_weight: FixedGain,
    /// True if the derivative begins with its first value, false if with zero.
    pub from_rest: bool,
    /// h/(T + h) of the derivative's filter; 1 without.
    pub filter_share: FixedGain,
    /// Smallest and largest output, in units of 2⁻¹⁶ counts.
    pub limits: [i64; 2],
    /// Largest change of the output in a tick, in units of 2⁻¹⁶ counts.
    pub stride: i64,
    /// Anti-windup.
    pub anti_windup: FixedWindup,
}

impl FixedLaw<'_> {
    /// Binary digits of a sample behind the point: samples are in units of 2⁻⁵ counts of the inputs.
    pub const SAMPLE_DIGITS: u32 = 5;

    /// Binary digits of an output behind the point while it is computed.
    pub const OUTPUT_DIGITS: u32 = 16;

    /// Largest magnitude of an input, 2²³ − 1: what lies beyond counts as that.
    pub const LARGEST_INPUT: i32 = (1 << 23) - 1;

    /// Length of the state of a [`FixedPid`]; a `const fn`, to be the length of an array.
    pub const fn state_len(&self) -> usize {
        self.integral.state_len() + self.derivative.state_len()
    }

    /// The sample that the integral takes: its error, unless the output is beyond a limit.
    #[inline]
    fn sample(&self, error: i32, term: IntegralTerm, [lowest, highest]: [i64; 2]) -> i32 {
        let IntegralTerm { beside, before, alone, value } = term;
        let raw = beside.saturating_add(value);
        let beyond = raw.saturating_sub(raw.min(highest).max(lowest));
        if beyond == 0 {
            return error;
        }
        let changed = |gain: FixedGain, by: i64| word(gain.times(by).saturating_add(i64::from(error)));
        match self.anti_windup {
            FixedWindup::None => error,
            FixedWindup::BackCalculation(gain) => changed(gain, beyond.saturating_neg()),
            FixedWindup::Conditional(gain) => {
                let (falling, rising) = (alone.min(before), alone.max(before));
                let held = if beyond > 0 {
                    value.min(highest.saturating_sub(beside).max(falling))
                } else {
                    value.max(lowest.saturating_sub(beside).min(rising))
                };
                changed(gain, held.saturating_sub(value))
            }
        }
    }
}

/// What the integral and the rest of the output are in a tick.
#[derive(Clone, Copy)]
struct IntegralTerm {
    /// The output without the integral.
    beside: i64,
    /// The integral of the last tick, that of this one without its sample, and with its error as the sample.
    before: i64,
    alone: i64,
    value: i64,
}

/// A fractional PID controller in whole numbers: inputs and output in counts, whose units the law's numbers
/// contain.
///
/// Inputs beyond ±(2²³ − 1) count as that. Exponentials are z ← z + (2^l x − μ z) with z in 64 bits, as many
/// of them behind the point as keep |x|/μ from overflowing; where a sum nevertheless grows without bound, as
/// an integral does, it saturates. Against the same law in exact arithmetic the output is within the bound
/// that `fvi controller` states with the constants, for any inputs, as long as it has reached no limit; at
/// one, samples that wind back are rounded to 2⁻⁵ counts, and saturate at 2²⁶: from an output that would be
/// farther beyond its limit than that many counts times (w + τ^λ) K_i, or w K_i, it winds back in more ticks
/// than one.
///
/// ```
/// use fvi_core::{FixedGain, FixedLaw, FixedOperator, FixedPid, FixedWindup};
///
/// // K_p = 1/4: a quarter of 2¹⁶ for each count.
/// const QUARTER: FixedGain = FixedGain { mantissa: 1 << 30, shift: 16 };
/// const NONE: FixedOperator<'_> = FixedOperator { head: &[], terms: &[] };
/// const LAW: FixedLaw<'_> = FixedLaw {
///     setpoint: QUARTER,
///     measured: QUARTER,
///     integral: NONE,
///     derivative: NONE,
///     derivative_weight: FixedGain::ZERO,
///     from_rest: true,
///     filter_share: FixedGain::ZERO,
///     limits: [-100 << 16, 100 << 16],
///     stride: i64::MAX,
///     anti_windup: FixedWindup::None,
/// };
/// let mut pid = FixedPid::new(&LAW, [0; LAW.state_len()])?;
/// assert_eq!(pid.tick(30, 10), 5);
/// assert_eq!(pid.tick(i32::MAX, i32::MIN), 100);
/// # Ok::<(), fvi_core::ParameterError>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct FixedPid<L, B> {
    law: L,
    numbers: B,
    /// c r − y of the last tick; `None` where it counts as the first.
    acted: Option<i32>,
    filtered: i64,
    /// Integral term and output of the last tick.
    integral: i64,
    output: i64,
}

impl<'a, L: Borrow<FixedLaw<'a>>, B: AsRef<[i64]> + AsMut<[i64]>> FixedPid<L, B> {
    /// A controller before its first tick, with a law of its own or one that it borrows.
    ///
    /// # Errors
    /// If the state has another length than [`FixedLaw::state_len`].
    pub fn new(law: L, state: B) -> Result<Self, ParameterError> {
        let (length, right) = (state.as_ref().len(), law.borrow().state_len());
        let allowed = "the law's state_len";
        ParameterError::check(length == right, "state length", length as f64, allowed)?;
        let mut pid = Self { law, numbers: state, acted: None, filtered: 0, integral: 0, output: 0 };
        pid.reset();
        Ok(pid)
    }

    /// Takes setpoint r and measured value y, in counts, and returns the output u, in counts of its own.
    pub fn tick(&mut self, setpoint: i32, measured: i32) -> i32 {
        let law: &FixedLaw<'a> = self.law.borrow();
        let [r, y] =
            [setpoint, measured].map(|input| input.clamp(-FixedLaw::LARGEST_INPUT, FixedLaw::LARGEST_INPUT));
        let numbers = self.numbers.as_mut();
        let Some((of_integral, of_derivative)) = numbers.split_at_mut_checked(law.integral.state_len())
        else {
            return word(scaled(self.output, FixedLaw::OUTPUT_DIGITS as i32));
        };
        let acted =
            word(law.derivative_weight.times_word(r).saturating_sub(i64::from(y << FixedLaw::SAMPLE_DIGITS)));
        let rise = acted.saturating_sub(self.acted.unwrap_or(acted));
        let derived = law.derivative.term(of_derivative);
        let derived = derived.saturating_add(law.derivative.leading().times_word(rise));
        law.derivative.push(of_derivative, rise);
        let largest = i64::MAX >> (FILTER_DIGITS + 1);
        let lifted = derived.clamp(-largest, largest) << FILTER_DIGITS;
        self.filtered =
            self.filtered.saturating_add(law.filter_share.times(lifted.saturating_sub(self.filtered)));
        let proportional = law.setpoint.times_word(r).saturating_sub(law.measured.times_word(y));
        let beside = proportional.saturating_add(scaled(self.filtered, FILTER_DIGITS as i32));
        let [lower, upper] = law.limits;
        let lowest = self.output.saturating_sub(law.stride).min(upper).max(lower);
        let highest = self.output.saturating_add(law.stride).min(upper).max(lower);
        let error = (r - y) << FixedLaw::SAMPLE_DIGITS;
        let alone = law.integral.term(of_integral);
        let leading = law.integral.leading();
        let value = alone.saturating_add(leading.times_word(error));
        let term = IntegralTerm { beside, before: self.integral, alone, value };
        let sample = law.sample(error, term, [lowest, highest]);
        let value = if sample == error { value } else { alone.saturating_add(leading.times_word(sample)) };
        law.integral.push(of_integral, sample);
        self.acted = Some(acted);
        self.integral = value;
        self.output = beside.saturating_add(value).min(highest).max(lowest);
        self.output()
    }

    /// The output of the last tick, in counts; 0 before the first.
    pub fn output(&self) -> i32 {
        word(scaled(self.output, FixedLaw::OUTPUT_DIGITS as i32))
    }

    /// Returns to the state before the first tick.
    pub fn reset(&mut self) {
        self.numbers.as_mut().fill(0);
        self.acted = if self.law.borrow().from_rest { None } else { Some(0) };
        (self.filtered, self.integral, self.output) = (0, 0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::noise;
    use std::vec::Vec;

    /// Whole numbers of all sizes, the extreme ones among them.
    fn numbers(count: usize) -> Vec<i64> {
        let mut numbers = std::vec![0, 1, -1, i64::MAX, i64::MIN, 1 << 32, (1 << 32) - 1, -(1 << 31)];
        let noise = noise(2 * count);
        let sizes =
            noise.chunks(2).map(|pair| ((pair[0] * 2.0 * i64::MAX as f64) as i64, 64.0 * (pair[1] + 0.5)));
        numbers.extend(sizes.map(|(number, shift)| number >> (shift as u32).min(63)));
        numbers
    }

    #[test]
    fn products_are_those_of_exact_arithmetic_within_their_bound() {
        for (number, gain) in numbers(20_000).into_iter().zip(numbers(20_011).into_iter().rev()) {
            let gain = FixedGain { mantissa: gain as i32, shift: (gain >> 32) as i32 % 90 };
            for (product, number) in
                [(gain.times(number), number), (gain.times_word(word(number)), i64::from(word(number)))]
            {
                let exact = number as f64 * gain.value();
                let allowed = gain.rounding() + 1e-15 * exact.abs();
                if exact.abs() + allowed < 9.2e18 {
                    let error = (product as f64 - exact).abs();
                    assert!(error <= allowed, "{gain:?} * {number}: {product}, {exact:e}");
                } else if exact.abs() - allowed > 9.3e18 {
                    assert_eq!(product, saturated(exact.signum() as i64), "{gain:?} * {number}");
                }
            }
        }
    }

    #[test]
    fn factors_are_the_nearest() {
        for exponent in -120..120 {
            for value in noise(100) {
                let value = libm::ldexp(value, exponent);
                let gain = FixedGain::nearest(value);
                let found = gain.map(FixedGain::value);
                let near = |found: f64| {
                    (found - value).abs() <= libm::ldexp(value.abs(), -31) || value.abs() < libm::exp2(-94.0)
                };
                assert!(found.map_or(value.abs() > libm::exp2(126.0), near), "{value:e}: {gain:?}");
            }
        }
        assert_eq!(FixedGain::nearest(1.0 - f64::EPSILON), Some(FixedGain { mantissa: 1 << 30, shift: 30 }));
        assert_eq!(FixedGain::nearest(0.0), Some(FixedGain::ZERO));
        for none in [f64::NAN, f64::INFINITY, 1e40] {
            assert_eq!(FixedGain::nearest(none), None);
        }
    }

    /// In a build with checks, an overflow is a panic.
    #[test]
    fn no_law_and_no_input_overflows() {
        let inputs: Vec<i32> = numbers(4000).into_iter().map(|number| number as i32).collect();
        for seed in 0..300 {
            let mut rest = numbers(200 + seed).into_iter().rev();
            let mut next = || rest.next().unwrap_or(i64::MIN);
            let mut gain = || match seed % 3 {
                0 => FixedGain { mantissa: next() as i32, shift: next() as i32 },
                _ => FixedGain { mantissa: next() as i32, shift: next() as i32 % 70 },
            };
            let heads = [[gain(), gain(), gain()], [gain(), gain(), gain()]];
            let mut term = || FixedTerm { decay: gain(), output: gain(), lift: gain().shift };
            let terms = [[term(), term()], [term(), term()]];
            let windup =
                [FixedWindup::None, FixedWindup::BackCalculation(gain()), FixedWindup::Conditional(gain())];
            let law = FixedLaw {
                setpoint: gain(),
                measured: gain(),
                integral: FixedOperator { head: &heads[0], terms: &terms[0] },
                derivative: FixedOperator { head: &heads[1], terms: &terms[1] },
                derivative_weight: gain(),
                from_rest: seed % 2 == 0,
                filter_share: gain(),
                limits: [next(), next()],
                stride: next(),
                anti_windup: windup[seed % 3],
            };
            let mut pid = FixedPid::new(&law, std::vec![0; law.state_len()]).unwrap();
            for pair in inputs.windows(2) {
                pid.tick(pair[0], pair[1]);
            }
        }
    }
}
