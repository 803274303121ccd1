//! The cut and the poles of a transfer function as decaying exponentials of the weights of a multistep rule.

use crate::quadrature::exponential::Exponential;
use crate::transfer::{self, Pole, TransferFunction};
use fvi_core::{BdfOrder, DoubleDouble};
use std::f64::consts::PI;

/// Largest number of constant nodes summed, and ratio to their sum below which further ones are dropped.
const MOST_STANDING: usize = 20_000;
const NEGLIGIBLE: f64 = 1e-18;

/// Terms of the series of artanh t/t to 30 digits, for the t ≤ 0.11 of a strip of half width π/2.
const TERMS: usize = 17;

/// Weights fall by this factor until nothing of them is left.
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
pub(crate) struct PrincipalCut<'a> {
    transfer: &'a TransferFunction,
    order: BdfOrder,
    step_size: f64,
    on_increments: bool,
    cut: Option<Start>,
    /// Sign of the jump; if it changes, the sign on most of the cut.
    jump_sign: f64,
    poles: Vec<Exponential>,
}

/// A part c δⁿ of the weights, to about 30 digits but for the jump across the cut that c comes from.
pub(crate) struct Part {
    pub(crate) coefficient: DoubleDouble,
    /// δ, 0 < δ ≤ 1.
    pub(crate) decay: DoubleDouble,
}

/// Where the cut begins in z.
struct Start {
    cut: transfer::Cut,
    /// m at the branch point.
    place: f64,
    /// The same to 30 digits.
    whole_place: DoubleDouble,
    /// g^{(k)}/k! there, k = 1, ….
    taylor: [f64; 6],
}

impl<'a> PrincipalCut<'a> {
    pub(crate) fn new(
        transfer: &'a TransferFunction,
        order: BdfOrder,
        step_size: f64,
        on_increments: bool,
    ) -> Self {
        let start = |cut: transfer::Cut| {
            let place = preimage(order, cut.start * step_size)?;
            let whole_place = refined(order, place, whole(cut.start, cut.rest).scale(step_size));
            Some(Start { cut, place, whole_place, taylor: taylor(order, place) })
        };
        let poles = transfer.poles().into_iter();
        Self {
            transfer,
            order,
            step_size,
            on_increments,
            cut: transfer.cut().and_then(start),
            jump_sign: if transfer.jump(1.0 / step_size) < 0.0 { -1.0 } else { 1.0 },
            poles: poles.filter_map(|pole| exponential(order, step_size, on_increments, pole)).collect(),
        }
    }

    /// The exponentials of the poles.
    pub(crate) fn poles(&self) -> &[Exponential] {
        &self.poles
    }

    /// The common sign of the nodes: for weights on values the opposite of that of the jump.
    pub(crate) fn sign(&self) -> f64 {
        if self.on_increments { self.jump_sign } else { -self.jump_sign }
    }

    /// The slowest rate, that of the branch point.
    pub(crate) fn slowest(&self) -> f64 {
        self.cut.as_ref().map_or(0.0, |start| libm::log1p(start.place))
    }

    /// The lag up to which the weights are not negligible.
    pub(crate) fn reach(&self, horizon: u64) -> u64 {
        let rate = self.slowest();
        if rate == 0.0 {
            return horizon;
        }
        horizon.min((-libm::log(NOTHING_LEFT) / rate).ceil() as u64)
    }

    /// Spacing of the trapezoidal rule in ln d at which its relative error is about half the tolerance:
    /// e^{−2πs/spacing} in a strip of half width s, times the growth of the integrand towards its edge.
    pub(crate) fn spacing(&self, tolerance: f64) -> f64 {
        let strip = self.cut.as_ref().map_or(0.5 * PI, |start| start.cut.strip);
        2.0 * PI * strip / (libm::log(2.0 / tolerance) + 6.0)
    }

    /// Rate from which nodes are negligible at the end of a head.
    pub(crate) fn fastest(&self, head: usize, tolerance: f64) -> f64 {
        let power = self.cut.as_ref().map_or(0.0, |start| start.cut.power.max(self.transfer.growth()));
        self.slowest() + (libm::log(2.0 / tolerance) + 2.0 + 1.5 * power) / head as f64
    }

    /// The trapezoidal rule in ln d up to a rate, slowest node first, without the [`sign`](Self::sign) and
    /// the poles.
    ///
    /// Nodes so slow that they are constant relative to the branch point up to the horizon are merged to one
    /// node there.
    pub(crate) fn rule(&self, spacing: f64, fastest: f64, horizon: u64, tolerance: f64) -> Vec<Exponential> {
        let Some(Start { place, .. }) = &self.cut else { return Vec::new() };
        let slowest = self.slowest();
        let (first, count) = self.reach_of_rule(place, spacing, fastest, horizon, tolerance);
        let at = |k: usize| libm::exp(first - k as f64 * spacing);
        let rest = self.standing((count + 1..).map(at), spacing);
        let node = |k: usize| {
            let d = at(k);
            let rate = slowest + libm::log1p(d / (1.0 + place));
            Exponential { rate, coefficient: self.coefficient(d, spacing) }
        };
        std::iter::once(Exponential { rate: slowest, coefficient: rest })
            .chain((0..=count).rev().map(node))
            .collect()
    }

    /// ln d of the first node of the rule, the fastest, and the number of those behind it that move up to
    /// the horizon.
    fn reach_of_rule(
        &self,
        place: &f64,
        spacing: f64,
        fastest: f64,
        horizon: u64,
        tolerance: f64,
    ) -> (f64, usize) {
        let standing = 0.01 * tolerance / horizon as f64;
        let first = libm::log((1.0 + place) * libm::expm1(fastest - self.slowest()));
        (first, ((first - libm::log(standing)) / spacing).ceil().max(1.0) as usize)
    }

    /// Sum of the coefficients at these distances, which stand still: term by term, since next to the branch
    /// point kernels of several powers follow none of them.
    fn standing(&self, distances: impl Iterator<Item = f64>, spacing: f64) -> f64 {
        let mut rest = 0.0;
        for d in distances.take(MOST_STANDING) {
            let coefficient = self.coefficient(d, spacing);
            rest += coefficient;
            if coefficient.abs() <= NEGLIGIBLE * rest.abs() {
                break;
            }
        }
        rest
    }

    /// Rule and poles as parts of the weights from lag `head` to `horizon`, slowest first, with their signs.
    ///
    /// A weight at lag n has the rounding of a decay n times, so that decays are known to 30 digits:
    /// distances from the branch point are a geometric series of ratio (1 − t)/(1 + t), whose logarithm is
    /// the spacing, −2 artanh t.
    pub(crate) fn parts(&self, head: usize, horizon: usize, tolerance: f64) -> Vec<Part> {
        let poles = self.transfer.poles().into_iter();
        let mut parts: Vec<Part> = poles.filter_map(|pole| self.part_of_pole(pole)).collect();
        if let Some(Start { place, whole_place, .. }) = &self.cut {
            let wanted = self.spacing(tolerance);
            let t = libm::tanh(0.5 * wanted);
            let beside = |sign: f64| DoubleDouble::ONE.add(DoubleDouble::exact(sign * t));
            let ratio = quotient(beside(-1.0), beside(1.0));
            let square = DoubleDouble::product(t, t);
            let series = (0..TERMS).rev().fold(DoubleDouble::ZERO, |sum, k| {
                sum.multiply(square).add(DoubleDouble::ONE.divide((2 * k + 1) as f64))
            });
            let spacing = series.scale(2.0 * t);
            let fastest = self.fastest(head, tolerance);
            let (first, count) =
                self.reach_of_rule(place, spacing.to_f64(), fastest, horizon as u64, tolerance);
            let distances = std::iter::successors(Some(DoubleDouble::exact(libm::exp(first))), |d| {
                Some(d.multiply(ratio))
            });
            let moving = distances.clone().take(count + 1);
            let standing = self.standing(distances.skip(count + 1).map(DoubleDouble::to_f64), 1.0);
            let beyond = DoubleDouble::ONE.add(*whole_place);
            let part = |coefficient: f64, d: DoubleDouble| Part {
                coefficient: spacing.scale(self.sign() * coefficient),
                decay: quotient(DoubleDouble::ONE, beyond.add(d)),
            };
            parts.push(part(standing, DoubleDouble::ZERO));
            parts.extend(moving.map(|d| part(self.coefficient(d.to_f64(), 1.0), d)));
        }
        parts.sort_by(|a, b| b.decay.to_f64().total_cmp(&a.decay.to_f64()));
        parts
    }

    /// As [`exponential`], to 30 digits.
    fn part_of_pole(&self, pole: Pole) -> Option<Part> {
        let value = whole(pole.rate, pole.rests[0]).scale(self.step_size);
        let m = refined(self.order, preimage(self.order, value.to_f64())?, value);
        let beyond = DoubleDouble::ONE.add(m);
        let divisor = if self.on_increments { m.scale(-1.0) } else { DoubleDouble::ONE };
        let residue = whole(pole.residue, pole.rests[1]).scale(self.step_size);
        let below = slope(self.order, m).multiply(beyond).multiply(divisor);
        Some(Part { coefficient: quotient(residue, below), decay: quotient(DoubleDouble::ONE, beyond) })
    }

    /// Of the node at a distance d from the branch point.
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

/// g′(m) = Σ_{i=1}^p (−m)^{i−1} to 30 digits.
fn slope(order: BdfOrder, m: DoubleDouble) -> DoubleDouble {
    let minus = m.scale(-1.0);
    (0..order.get()).fold(DoubleDouble::ZERO, |sum, _| minus.multiply(sum).add(DoubleDouble::ONE))
}

/// The zero of g − `value` to 30 digits from one in double precision, by a step of Newton's method.
fn refined(order: BdfOrder, m: f64, value: DoubleDouble) -> DoubleDouble {
    let m = DoubleDouble::exact(m);
    let minus = m.scale(-1.0);
    let formula = (1..=order.get())
        .rev()
        .fold(DoubleDouble::ZERO, |sum, i| minus.multiply(sum).add(DoubleDouble::ONE.divide(i as f64)));
    let miss = value.add(m.multiply(formula).scale(-1.0));
    m.add(quotient(miss, slope(order, m)))
}

/// The sum of two numbers, the second being the rounding of the first.
fn whole(number: f64, rest: f64) -> DoubleDouble {
    DoubleDouble::exact(number).add(DoubleDouble::exact(rest))
}

/// a/b to about 30 digits.
fn quotient(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble {
    let first = a.to_f64() / b.to_f64();
    let rest = a.add(b.scale(-first));
    DoubleDouble::exact(first).add(DoubleDouble::exact(rest.to_f64() / b.to_f64()))
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
