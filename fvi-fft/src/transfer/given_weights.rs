//! Convolution weights that are given as numbers.

use crate::real_transforms;
use crate::transfer::Active;
use fvi_core::{DoubleDouble, ParameterError, max_or_nan};
use nalgebra::Complex;

/// Weights w₀, w₁, … of a memory, given as they are: the force at step k is ρ Σ_{n=0}^{k} w_n q_{k−n}.
///
/// They belong to one step size h. The transfer function is replaced by the series
///
/// ```text
/// K_h(s) = Σ_n w_n e^{−nsh} ,    Re s ≥ 0 , |Im s| ≤ π/h ,
/// ```
///
/// which is K(γ(z)/h) at z = e^{−sh} for the weights of convolution quadrature. K(s) itself is unknown, as
/// are weights beyond the last one. Units: those of K. Source: \[Lubich86\].
#[derive(Clone, Debug, PartialEq)]
pub struct GivenWeights {
    name: String,
    weights: Vec<f64>,
    /// Σ_{m ≤ n} w_m.
    sums: Vec<f64>,
    step: Option<f64>,
    /// In angular frequencies for h = 1.
    active: Option<Active>,
}

impl GivenWeights {
    /// From weights of a file of this name; an empty name for weights given as a list.
    ///
    /// # Errors
    /// If there is no weight, or a weight or a partial sum is not finite.
    pub fn new(name: &str, weights: Vec<f64>) -> Result<Self, ParameterError> {
        let refused = |parameter, value, allowed| Err(ParameterError { parameter, value, allowed });
        if weights.is_empty() {
            return refused("number of weights", 0.0, "at least 1");
        }
        let mut sum = DoubleDouble::ZERO;
        let mut sums = Vec::with_capacity(weights.len());
        for &weight in &weights {
            sum = sum.add(DoubleDouble::exact(weight));
            sums.push(sum.to_f64());
        }
        if let Some((&weight, _)) = weights.iter().zip(&sums).find(|(_, sum)| !sum.is_finite()) {
            return refused("weight", weight, "finite, as are their sums");
        }
        let active = look_for_activity(&weights, &sums);
        Ok(Self { name: name.to_owned(), weights, sums, step: None, active })
    }

    /// The same weights, for the step size h.
    ///
    /// # Errors
    /// If h is not positive and finite, or the weights are for another step size.
    pub fn at_step(self, step: f64) -> Result<Self, ParameterError> {
        self.check_step(step)?;
        Ok(Self { step: Some(self.step.unwrap_or(step)), ..self })
    }

    /// Checks that a run with the step size h may use the weights: any step size if theirs is unknown.
    ///
    /// # Errors
    /// If h is not positive and finite, or the weights are for another step size.
    pub fn check_step(&self, step: f64) -> Result<(), ParameterError> {
        let refused = |parameter, value, allowed| Err(ParameterError { parameter, value, allowed });
        if !(step > 0.0 && step.is_finite()) {
            return refused("step size", step, "positive and finite");
        }
        match self.step {
            Some(own) if (own - step).abs() > SAME_STEP * step => {
                refused("step of the weights", own, "the step at which they are taken")
            }
            _ => Ok(()),
        }
    }

    /// The name of their file; empty without one.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// w₀, w₁, …
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// h, where it is known.
    pub fn step(&self) -> Option<f64> {
        self.step
    }

    /// Σ w_n zⁿ for |z| ≤ 1.
    pub fn symbol(&self, z: Complex<f64>) -> Complex<f64> {
        self.weights.iter().rev().fold(Complex::ZERO, |sum, weight| sum * z + *weight)
    }

    /// K_h(s), with h = 1 if the step size is unknown.
    pub fn value(&self, s: Complex<f64>) -> Complex<f64> {
        let exponent = s * -self.step.unwrap_or(1.0);
        let size = libm::exp(exponent.re);
        self.symbol(Complex::new(size * libm::cos(exponent.im), size * libm::sin(exponent.im)))
    }

    /// The largest |Σ_{m ≤ n} w_m| of the two steps around a time: the size of the force at that time after a
    /// unit jump of the position at t = 0.
    pub fn after_a_jump(&self, time: f64) -> f64 {
        let last = self.sums.len() - 1;
        let index = (time / self.step.unwrap_or(1.0)).floor().clamp(0.0, last as f64) as usize;
        let before = index.saturating_sub(1);
        self.sums[before..=(index + 1).min(last)].iter().map(|sum| sum.abs()).fold(0.0, max_or_nan)
    }

    /// The band in which it adds energy to a harmonic motion: see `look_for_activity`.
    pub fn active(&self) -> Option<Active> {
        let scale = self.step.unwrap_or(1.0);
        self.active.map(|active| Active {
            place: active.place / scale,
            from: active.from.map(|from| from / scale),
            to: active.to.map(|to| to / scale),
            ..active
        })
    }
}

/// Relative difference up to which step sizes are equal, which allows for the digits of files.
const SAME_STEP: f64 = 1e-9;

/// Relative to |φ|, the rounding error above which a negative resistance is significant, as for other
/// transfer functions.
const ROUNDING: f64 = 1e-9;

/// The lowest band of frequencies in which harmonic motions gain energy from the memory.
///
/// In the midpoint rule the velocities v_0 … v_{N−1} of a path from rest do the work h Σ v_k (φ v)_k on a
/// memory at its node, with φ(z) = (h/2) W(z) (1 + z)/(1 − z), whose coefficients are (h/2)(S_n + S_{n−1}),
/// S_n = Σ_{m ≤ n} w_m. For v_k = cos θk and sin θk together it is h N Re φ_N(e^{−iθ}), where φ_N is the
/// series with the additional factors 1 − n/N (Fejér). So where that is negative a motion of N steps gains
/// energy, and it is nowhere negative if the weights have a continuation to a passive memory: the result does
/// not depend on where the table ends.
fn look_for_activity(weights: &[f64], sums: &[f64]) -> Option<Active> {
    let count = weights.len();
    let length = (4 * count).next_power_of_two().max(256);
    let mut signal = vec![0.0; length];
    let mut before = 0.0;
    for (n, (place, sum)) in signal.iter_mut().zip(sums).enumerate() {
        *place = (sum + before) * (1.0 - n as f64 / count as f64);
        before = *sum;
    }
    // Rounding error of the transform and of the weights.
    let size = signal.iter().map(|number| number * number).sum::<f64>().sqrt();
    let of_transform = 4.0 * f64::EPSILON * libm::log2(length as f64) * size;
    let of_weights = 4.0 * f64::EPSILON * weights.iter().map(|weight| weight * weight).sum::<f64>().sqrt();
    let (forward, _) = real_transforms(length);
    let mut values = vec![Complex::ZERO; length / 2 + 1];
    if forward.process(&mut signal, &mut values).is_err() {
        return None;
    }
    let angle = |k: usize| 2.0 * std::f64::consts::PI * k as f64 / length as f64;
    let resistance = |k: usize| {
        let lost = of_transform + of_weights / libm::tan(0.5 * angle(k)).abs();
        let ratio = (values[k].re + lost) / values[k].norm().max(f64::MIN_POSITIVE);
        if ratio < -ROUNDING { Some(values[k].re / values[k].norm()) } else { None }
    };
    // There is no oscillation at θ = 0 and π.
    let last = length / 2 - 1;
    let begin = (1..=last).find(|&k| resistance(k).is_some())?;
    let end = (begin..=last).take_while(|&k| resistance(k).is_some()).last().unwrap_or(begin);
    let worst = (begin..=end).min_by(|&a, &b| values[a].re.total_cmp(&values[b].re)).unwrap_or(begin);
    Some(Active {
        place: Complex::new(0.0, angle(worst)),
        resistance: resistance(worst).unwrap_or(-1.0),
        from: (begin > 1).then(|| angle(begin)),
        to: (end < last).then(|| angle(end)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quadrature::multistep_weights::multistep_weights;
    use crate::transfer::TransferFunction;
    use crate::transfer::multistep_rule::MultistepRule;
    use fvi_core::BdfOrder;

    fn table(weights: Vec<f64>) -> GivenWeights {
        GivenWeights::new("w.csv", weights).unwrap()
    }

    fn of(transfer: &TransferFunction, rule: impl Into<MultistepRule>, count: usize) -> GivenWeights {
        table(multistep_weights(transfer, rule, 0.1, false, count).unwrap()).at_step(0.1).unwrap()
    }

    #[test]
    fn weights_of_passive_kernels_are_passive_wherever_they_end() {
        let kernels = [
            TransferFunction::power(0.0).unwrap(),
            TransferFunction::power(0.3).unwrap(),
            TransferFunction::power(1.0).unwrap(),
            TransferFunction::power(1.8).unwrap(),
            TransferFunction::tempered(1.5, 0.4).unwrap(),
            TransferFunction::maxwell(0.7, 0.0, 2.0).unwrap(),
            TransferFunction::prony(&[1.0, 0.3], &[5.0, 0.01]).unwrap(),
            TransferFunction::havriliak_negami(0.7, 0.5, 0.3).unwrap(),
        ];
        for transfer in &kernels {
            for count in [1, 2, 7, 100, 5000] {
                for order in [1, 2] {
                    let made = of(transfer, BdfOrder::new(order).unwrap(), count);
                    assert_eq!(made.active(), None, "{transfer}, BDF {order}, {count}");
                }
                assert_eq!(
                    of(transfer, MultistepRule::Trapezoidal, count).active(),
                    None,
                    "{transfer}, {count}"
                );
            }
        }
    }

    #[test]
    fn weights_that_drive_are_found_with_the_band() {
        assert!(table(vec![-1.0]).active().is_some());
        // K = s − s^½ is not passive below ω = ½, with BDF 1 at h = 0.1.
        let linear = multistep_weights(
            &TransferFunction::power(1.0).unwrap(),
            BdfOrder::GRUNWALD_LETNIKOV,
            0.1,
            false,
            4000,
        );
        let half = multistep_weights(
            &TransferFunction::power(0.5).unwrap(),
            BdfOrder::GRUNWALD_LETNIKOV,
            0.1,
            false,
            4000,
        );
        let weights = linear.unwrap().iter().zip(half.unwrap()).map(|(a, b)| a - b).collect();
        let active = table(weights).at_step(0.1).unwrap().active().unwrap();
        assert!(active.from.is_none() && (active.to.unwrap() - 0.5).abs() < 0.05, "{active}");
        // A delay is not passive at high frequencies first.
        let mut delayed = vec![0.0; 10];
        (delayed[5], delayed[6]) = (10.0, -10.0);
        assert!(table(delayed).active().is_some());
    }

    #[test]
    fn the_series_is_that_of_the_symbol() {
        let transfer = TransferFunction::tempered(0.6, 2.0).unwrap();
        let order = BdfOrder::new(2).unwrap();
        let made = of(&transfer, order, 4000);
        for omega in [0.5, 3.0, 20.0] {
            let z = Complex::new(libm::cos(0.1 * omega), -libm::sin(0.1 * omega));
            let known = transfer.value(MultistepRule::from(order).symbol(z) / 0.1);
            assert!((made.value(Complex::new(0.0, omega)) - known).norm() < 1e-13 * known.norm());
        }
    }

    #[test]
    fn they_belong_to_one_step() {
        let made = table(vec![1.0, -1.0]);
        assert!(made.check_step(0.1).is_ok() && made.check_step(7.0).is_ok());
        let made = made.at_step(0.1).unwrap();
        assert!(made.check_step(0.1 + 1e-12).is_ok());
        assert_eq!(made.check_step(0.2).unwrap_err().parameter, "step of the weights");
        assert_eq!(made.at_step(0.2).unwrap_err().value, 0.1);
        assert!(table(vec![1.0]).at_step(f64::NAN).is_err());
        assert!(GivenWeights::new("", vec![]).is_err());
        assert!(GivenWeights::new("", vec![f64::MAX, f64::MAX]).is_err());
        assert!(GivenWeights::new("", vec![1.0, f64::NAN]).is_err());
    }
}
