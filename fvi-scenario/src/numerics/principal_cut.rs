//! The cut and the poles of a transfer function as decaying exponentials of the weights of a multistep rule.

use super::exponential::Exponential;
use super::transfer::{self, Pole, TransferFunction};
use fvi_core::BdfOrder;
use std::f64::consts::PI;

/// Largest number of constant nodes summed, and ratio to their sum below which further ones are dropped.
const MOST_STANDING: usize = 20_000;
const NEGLIGIBLE: f64 = 1e-18;

/// Factor of decay after which weights are negligible.
const NOTHING_LEFT: f64 = 1e-30;

/// The part of the weights of convolution quadrature that comes from the negative real axis of s.
///
/// The weights are the Taylor coefficients of K(γ_p(z)/h). Cauchy's contour is deformed to the cut of K and
/// its poles in the z-plane at z = 1 + m, m > 0, with g(m) = −γ_p(1 + m) = m − m²/2 + … and x = g(m)/h:
///
/// ```text
/// w_n = −(1/π) ∫ Im K(−x + i0) (1+m)^{−n−1} dm + Σ_poles residue·h/(g′(m) (1 + m)) (1+m)^{−n} .
/// ```
///
/// Weights on increments are those of K(γ_p(z)/h)/(1 − z), 1 − z = −m. Contributions of other preimages of
/// the cut and the poles fall like |ζ|^{−n} with |ζ| ≥ 1.2, and are left to the first weights.
pub(super) struct PrincipalCut<'a> {
    transfer: &'a TransferFunction,
    step_size: f64,
    on_increments: bool,
    cut: Option<Start>,
    /// Sign of the jump; if it changes, the sign on most of the cut.
    jump_sign: f64,
    poles: Vec<Exponential>,
}

/// Beginning of the cut in z.
struct Start {
    cut: transfer::Cut,
    /// m at the branch point.
    place: f64,
    /// g^{(k)}/k! at the branch point, k = 1, ….
    taylor: [f64; 6],
}

impl<'a> PrincipalCut<'a> {
    pub(super) fn new(
        transfer: &'a TransferFunction,
        order: BdfOrder,
        step_size: f64,
        on_increments: bool,
    ) -> Self {
        let start = |cut: transfer::Cut| {
            let place = preimage(order, cut.start * step_size)?;
            Some(Start { cut, place, taylor: taylor(order, place) })
        };
        let poles = transfer.poles().into_iter();
        Self {
            transfer,
            step_size,
            on_increments,
            cut: transfer.cut().and_then(start),
            jump_sign: if transfer.jump(1.0 / step_size) < 0.0 { -1.0 } else { 1.0 },
            poles: poles.filter_map(|pole| exponential(order, step_size, on_increments, pole)).collect(),
        }
    }

    /// The exponentials of the poles.
    pub(super) fn poles(&self) -> &[Exponential] {
        &self.poles
    }

    /// The common sign of the nodes: for weights on values the opposite of that of the jump.
    pub(super) fn sign(&self) -> f64 {
        if self.on_increments { self.jump_sign } else { -self.jump_sign }
    }

    /// The slowest rate, that of the branch point.
    pub(super) fn slowest(&self) -> f64 {
        self.cut.as_ref().map_or(0.0, |start| libm::log1p(start.place))
    }

    /// The lag up to which the weights are not negligible.
    pub(super) fn reach(&self, horizon: usize) -> usize {
        let rate = self.slowest();
        if rate == 0.0 {
            return horizon;
        }
        horizon.min((-libm::log(NOTHING_LEFT) / rate).ceil() as usize)
    }

    /// Spacing of the trapezoidal rule in ln d at which its relative error is about half the tolerance:
    /// e^{−2πs/spacing} in a strip of half width s, times the growth of the integrand towards its edge.
    pub(super) fn spacing(&self, tolerance: f64) -> f64 {
        let strip = self.cut.as_ref().map_or(0.5 * PI, |start| start.cut.strip);
        2.0 * PI * strip / (libm::log(2.0 / tolerance) + 6.0)
    }

    /// Rate from which nodes are negligible at the end of a head.
    pub(super) fn fastest(&self, head: usize, tolerance: f64) -> f64 {
        let power = self.cut.as_ref().map_or(0.0, |start| start.cut.power.max(self.transfer.growth()));
        self.slowest() + (libm::log(2.0 / tolerance) + 2.0 + 1.5 * power) / head as f64
    }

    /// The trapezoidal rule in ln d up to a rate, slowest node first, without the [`sign`](Self::sign) and
    /// the poles.
    ///
    /// Nodes so slow that they are constant relative to the branch point up to the horizon are merged to one
    /// node there.
    pub(super) fn rule(
        &self,
        spacing: f64,
        fastest: f64,
        horizon: usize,
        tolerance: f64,
    ) -> Vec<Exponential> {
        let Some(Start { place, .. }) = &self.cut else { return Vec::new() };
        let slowest = self.slowest();
        let standing = 0.01 * tolerance / horizon as f64;
        let first = libm::log((1.0 + place) * libm::expm1(fastest - slowest));
        let count = ((first - libm::log(standing)) / spacing).ceil().max(1.0) as usize;
        let at = |k: usize| libm::exp(first - k as f64 * spacing);
        // Summed term by term: near the branch point kernels of several powers follow none of these.
        let mut rest = 0.0;
        for k in count + 1..count + MOST_STANDING {
            let coefficient = self.coefficient(at(k), spacing);
            rest += coefficient;
            if coefficient.abs() <= NEGLIGIBLE * rest.abs() {
                break;
            }
        }
        let node = |k: usize| {
            let d = at(k);
            let rate = slowest + libm::log1p(d / (1.0 + place));
            Exponential { rate, coefficient: self.coefficient(d, spacing) }
        };
        std::iter::once(Exponential { rate: slowest, coefficient: rest })
            .chain((0..=count).rev().map(node))
            .collect()
    }

    /// Coefficient of the node at a distance d from the branch point.
    fn coefficient(&self, d: f64, spacing: f64) -> f64 {
        let Some(Start { place, taylor, .. }) = &self.cut else { return 0.0 };
        let beyond = d * taylor.iter().rev().fold(0.0, |sum, coefficient| sum * d + coefficient);
        let m = place + d;
        let divisor = if self.on_increments { m } else { 1.0 };
        let jump = self.jump_sign * self.transfer.jump(beyond.abs() / self.step_size);
        spacing * jump * (d / divisor) / (1.0 + m)
    }
}

/// The exponential of a pole; `None` if the pole has no real preimage, so that its contribution decays within
/// a few weights.
fn exponential(order: BdfOrder, step_size: f64, on_increments: bool, pole: Pole) -> Option<Exponential> {
    let m = preimage(order, pole.rate * step_size)?;
    let slope = taylor(order, m)[0];
    let divisor = if on_increments { -m } else { 1.0 };
    let coefficient = pole.residue * step_size / (slope * (1.0 + m) * divisor);
    Some(Exponential { rate: libm::log1p(m), coefficient })
}

/// g(m) = −γ_p(1 + m) = Σ_{i=1}^p −(−m)^i/i.
fn negative_formula(order: BdfOrder, m: f64) -> f64 {
    m * (1..=order.get()).rev().fold(0.0, |sum, i| 1.0 / i as f64 - m * sum)
}

/// g^{(k)}(m)/k!, k = 1, …, p.
fn taylor(order: BdfOrder, m: f64) -> [f64; 6] {
    let mut of_powers = [0.0; 7];
    for (i, place) in of_powers.iter_mut().enumerate().take(order.get() + 1).skip(1) {
        *place = (if i % 2 == 1 { 1.0 } else { -1.0 }) / i as f64;
    }
    // Horner's scheme, once for each derivative.
    let mut coefficients = [0.0; 6];
    let mut rest = of_powers;
    for place in std::iter::once(&mut 0.0).chain(&mut coefficients) {
        let mut carried = 0.0;
        for number in rest.iter_mut().rev() {
            carried = carried * m + *number;
            *number = carried;
        }
        *place = rest[0];
        rest.rotate_left(1);
        rest[6] = 0.0;
    }
    coefficients
}

/// The smallest m > 0 with g(m) = `value` on the branch that begins at 0; `None` if there is none.
fn preimage(order: BdfOrder, value: f64) -> Option<f64> {
    if value == 0.0 {
        return Some(0.0);
    }
    let even = order.get().is_multiple_of(2);
    let mut high = 1.0;
    if even && negative_formula(order, high) <= value {
        return None;
    }
    while !even && negative_formula(order, high) < value {
        high *= 2.0;
        if !high.is_finite() {
            return None;
        }
    }
    let mut low = 0.0;
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if negative_formula(order, middle) < value { low = middle } else { high = middle }
    }
    // Newton's method, to full relative accuracy for any size.
    let mut m = if low == 0.0 { value } else { low };
    for _ in 0..8 {
        m -= (negative_formula(order, m) - value) / taylor(order, m)[0];
    }
    (m > 0.0 && m.is_finite()).then_some(m)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn preimages_are_zeros_of_the_formula() {
        for p in 1..=6 {
            let order = BdfOrder::new(p).unwrap();
            for value in [1e-300, 1e-9, 0.1, 0.49, 3.0, 1e6] {
                let Some(m) = preimage(order, value) else {
                    assert!(p % 2 == 0 && value > 0.5, "{p}, {value}");
                    continue;
                };
                let back = negative_formula(order, m);
                assert!((back - value).abs() <= 1e-14 * value, "{p}, {value}: {back}");
            }
        }
    }

    #[test]
    fn differences_of_the_formula_follow_from_its_derivatives() {
        for p in 1..=6 {
            let order = BdfOrder::new(p).unwrap();
            for m in [0.0, 0.2, 0.9] {
                let d = 0.125;
                let taylor = taylor(order, m);
                let sum = d * taylor.iter().rev().fold(0.0, |sum, c| sum * d + c);
                let difference = negative_formula(order, m + d) - negative_formula(order, m);
                assert!((sum - difference).abs() < 1e-15, "{p}, {m}");
            }
        }
    }
}
