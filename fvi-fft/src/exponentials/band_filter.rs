//! Rational filters of the literature for s^β over a band, for those who must match a given design.
//!
//! ```text
//! s^β ≈ k Π_{i<N} (s + z_i)/(s + p_i) ,        −1 < β < 1, z_i, p_i > 0
//! ```
//!
//! *Oustaloup*: corners in geometric sequence, z_i = ω₁ (ω₂/ω₁)^{(i + (1−β)/2)/N}, p_i with 1 + β, and k =
//! ω₂^β. *Matsuda*: the continued fraction through the magnitudes ω_i^β at 2N + 1 frequencies in geometric
//! sequence over the band ([`RationalPower`]).
//!
//! Discrete by Tustin's rule, s = (2/h) (1 − z)/(1 + z) with z the delay by a step.
//!
//! Sources: \[Oustaloup00\]; \[MatsudaFujii93\].

use crate::exponentials::rational_power::RationalPower;
use crate::transfer::check;
use fvi_core::{ParameterError, max_or_nan};
use nalgebra::Complex;
use std::f64::consts::PI;

/// Most sections.
const MOST: usize = 60;

/// Largest relative difference between a filter and its polynomials.
const ALIKE: f64 = 1e-6;

/// Frequencies of every check.
const CHECKED: usize = 500;

/// Which filter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Design {
    /// Corners in geometric sequence.
    Oustaloup,
    /// Continued fraction.
    Matsuda,
}

/// k Π (s + z_i)/(s + p_i).
#[derive(Clone, Debug, PartialEq)]
pub struct BandFilter {
    /// k
    pub gain: f64,
    /// z_i in rad/s, ascending.
    pub zeros: Vec<f64>,
    /// p_i in rad/s, ascending.
    pub poles: Vec<f64>,
    exponent: f64,
    band: [f64; 2],
    step_size: f64,
}

impl BandFilter {
    /// The filter with `order` sections for the band from `band[0]` to `band[1]` in Hz, for steps h in
    /// seconds.
    ///
    /// # Errors
    /// If a parameter is out of range, or numbers of 30 digits do not hold the sections of the continued
    /// fraction.
    pub fn new(
        design: Design,
        exponent: f64,
        step_size: f64,
        band: [f64; 2],
        order: usize,
    ) -> Result<Self, ParameterError> {
        check(exponent.abs() < 1.0 && exponent != 0.0, "exponent", exponent, "between -1 and 1, not 0")?;
        check(step_size > 0.0 && step_size.is_finite(), "step", step_size, "greater than 0")?;
        let [low, high] = band;
        check(low > 0.0, "lower end of the band", low, "greater than 0")?;
        let range = "above the lower end, and below half of the sampling frequency";
        check(high > low && high < 0.5 / step_size, "upper end of the band", high, range)?;
        check((1..=MOST).contains(&order), "order", order as f64, "at least 1 and at most 60")?;
        let [low, high] = band.map(|frequency| 2.0 * PI * frequency);
        let place = |part: f64| low * libm::pow(high / low, part);
        let made = |gain, zeros, poles| Self { gain, zeros, poles, exponent, band, step_size };
        if design == Design::Oustaloup {
            let corner =
                |i: usize, sign: f64| place((i as f64 + 0.5 * (1.0 + sign * exponent)) / order as f64);
            let corners = |sign: f64| (0..order).map(|i| corner(i, sign)).collect();
            return Ok(made(libm::pow(high, exponent), corners(-1.0), corners(1.0)));
        }
        let allowed = "lower: numbers of 30 digits do not hold the sections of this continued fraction";
        let found = RationalPower::through_gains(exponent, low, high, order);
        let RationalPower { gain, zeros, poles } =
            found.ok_or(ParameterError { parameter: "order", value: order as f64, allowed })?;
        Ok(made(gain, zeros, poles))
    }

    /// Its value at s.
    pub fn at(&self, s: Complex<f64>) -> Complex<f64> {
        let sections = self.zeros.iter().zip(&self.poles);
        sections.fold(Complex::from(self.gain), |product, (zero, pole)| product * (s + *zero) / (s + *pole))
    }

    /// [b₀, b₁, a₁] of the sections (b₀ + b₁ z)/(1 + a₁ z), the gain in the first.
    pub fn sections(&self) -> Vec<[f64; 3]> {
        let twice = 2.0 / self.step_size;
        let of = |(i, (zero, pole)): (usize, (&f64, &f64))| {
            let gain = if i == 0 { self.gain } else { 1.0 };
            let below = twice + pole;
            [gain * (zero + twice) / below, gain * (zero - twice) / below, (pole - twice) / below]
        };
        self.zeros.iter().zip(&self.poles).enumerate().map(of).collect()
    }

    /// b and a of H(z) = Σ b_n zⁿ/Σ a_n zⁿ, a₀ = 1.
    ///
    /// # Errors
    /// If the coefficients, in double precision, are those of another filter over the band.
    pub fn transfer_function(&self) -> Result<[Vec<f64>; 2], ParameterError> {
        let sections = self.sections();
        let times = |product: Vec<f64>, [first, second]: [f64; 2]| {
            let mut next = vec![0.0; product.len() + 1];
            product.iter().enumerate().for_each(|(n, value)| {
                next[n] += first * value;
                next[n + 1] += second * value;
            });
            next
        };
        let above = sections.iter().fold(vec![1.0], |b, &[b0, b1, _]| times(b, [b0, b1]));
        let below = sections.iter().fold(vec![1.0], |a, &[_, _, a1]| times(a, [1.0, a1]));
        let apart = self.largest(|omega, _| {
            let z = Complex::new(0.0, -omega * self.step_size).exp();
            let sum = |numbers: &[f64]| {
                numbers.iter().rev().fold(Complex::ZERO, |sum: Complex<f64>, number| sum * z + number)
            };
            (sum(&above) / sum(&below) / self.response(omega) - 1.0).norm()
        });
        let allowed = "lower, or the band narrower: a polynomial in double precision is another filter there, sections are not";
        check(apart <= ALIKE, "order", self.poles.len() as f64, allowed)?;
        Ok([above, below])
    }

    /// Its frequency response after Tustin's rule.
    pub fn response(&self, omega: f64) -> Complex<f64> {
        self.at(Complex::new(0.0, 2.0 / self.step_size * libm::tan(0.5 * omega * self.step_size)))
    }

    /// Largest error of magnitude, in dB, and phase, in degrees, of the response over the band, against
    /// (iω)^β.
    pub fn errors(&self) -> [f64; 2] {
        let known = |omega: f64| Complex::new(0.0, omega).powf(self.exponent);
        let size = |omega, _| (20.0 * libm::log10((self.response(omega) / known(omega)).norm())).abs();
        let phase = |omega, _| (self.response(omega) / known(omega)).arg().to_degrees().abs();
        [self.largest(size), self.largest(phase)]
    }

    fn largest(&self, of: impl Fn(f64, Complex<f64>) -> f64) -> f64 {
        let [low, high] = self.band.map(|frequency| 2.0 * PI * frequency);
        (0..=CHECKED)
            .map(|k| low * libm::pow(high / low, k as f64 / CHECKED as f64))
            .map(|omega| of(omega, Complex::new(0.0, omega)))
            .fold(0.0, max_or_nan)
    }
}
