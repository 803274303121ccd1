//! A transfer function as a sum of relaxations in continuous time, with a check of that sum.

use crate::exponentials::jacobi_matrix::JacobiMatrix;
use crate::exponentials::rate_rules::Relaxation;
use crate::transfer::derivative::TransferDerivative;
use crate::transfer::{Cut, TransferFunction};
use nalgebra::Complex;
use std::f64::consts::PI;

/// Width of the strip below which the trapezoidal rule would be so fine that Gauss rules in windows need
/// fewer nodes.
const WIDE_STRIP: f64 = 1.2;

/// Width of a window in ln d.
const WINDOW: f64 = 4.0;

/// ln ρ of the ellipse around a window that reaches to half a turn, beyond which e^{−λt} grows.
const ELLIPSE: f64 = 0.723;

/// Largest number of halvings of a window, and of pieces.
const HALVINGS: usize = 48;
const PIECES: usize = 600;

/// Largest error of the derivative of a kernel, relative to the kernel.
const OF_DERIVATIVES: f64 = 1e-10;

/// Ratio to a sum below which its terms are dropped.
const NEGLIGIBLE: f64 = 1e-18;

/// Nearest and farthest place on the cut, as multiples of 1/horizon and of 1/shortest step.
const FAR: f64 = 1e120;

/// Spectrum of K, or of its derivative by a parameter: with d derivatives, K(s)/s^d = Σ c/(s + λ).
pub(crate) struct Spectrum<'a> {
    pub(crate) transfer: &'a TransferFunction,
    /// ∂K/∂θ, in place of K.
    pub(crate) by: Option<&'a TransferDerivative>,
    /// d
    pub(crate) derivatives: usize,
    pub(crate) shortest: f64,
    pub(crate) horizon: f64,
    pub(crate) tolerance: f64,
}

impl Spectrum<'_> {
    /// The relaxations, slowest first, and those at both ends; or the largest error of their sum if it
    /// exceeds the tolerance.
    ///
    /// Cauchy's contour around the negative real axis gives c(λ) = −(−1)^d Im K(−λ + i0)/(π λ^d), and poles
    /// are relaxations themselves. A dashpot, K ~ s, is a relaxation of infinite rate, the pole of K/s² at s
    /// = 0 one of rate 0: they are the limits of K at short and at long times.
    ///
    /// The sum is compared with K on three rays into the right half-plane, from the inverse of the horizon to
    /// ten times that of the shortest step. The spectrum of a stiffly accurate, A-stable method on equal
    /// steps lies in that region, so that this bounds the error of the sums, relative to K including its
    /// spring.
    pub(crate) fn relaxations(&self) -> Result<[Vec<Relaxation>; 2], f64> {
        let mut nodes = self.of_poles();
        // The cut of a formula may begin anywhere.
        let anywhere = Cut { start: 0.0, rest: 0.0, power: 0.0, strip: 0.0 };
        let is_formula = self.transfer.text().is_some() && self.transfer.fractions().is_none();
        if let Some(cut) = self.transfer.cut().or(is_formula.then_some(anywhere)) {
            let found = if cut.strip >= WIDE_STRIP { self.trapezoidal(&cut) } else { self.in_windows(&cut) };
            nodes.extend(found);
        }
        let mut ends = Vec::new();
        let mut error = self.largest_error(&nodes);
        if self.misses(error) {
            ends = self.what_is_left(&nodes);
            error = self.largest_error(&[&nodes[..], &ends].concat());
        }
        if self.misses(error) {
            return Err(error);
        }
        nodes.sort_by(|a, b| a.rate.total_cmp(&b.rate));
        Ok([nodes, ends])
    }

    fn misses(&self, error: f64) -> bool {
        let allowed = if self.by.is_some() { OF_DERIVATIVES.max(self.tolerance) } else { self.tolerance };
        error.is_nan() || error > allowed
    }

    fn of_poles(&self) -> Vec<Relaxation> {
        let pole = |pole: crate::transfer::Pole| Relaxation {
            rate: pole.rate,
            coefficient: pole.residue * (-pole.rate).powi(-(self.derivatives as i32)),
        };
        let poles = self.by.map_or_else(|| self.transfer.poles(), TransferDerivative::poles);
        poles.into_iter().map(pole).collect()
    }

    /// c(λ) d at λ = a + d, for an integral over ln d.
    fn density(&self, cut: &Cut, d: f64) -> f64 {
        let rate = cut.start + d;
        let sign = if self.derivatives == 1 { 1.0 } else { -1.0 };
        let jump = self.by.map_or_else(|| self.transfer.jump(d), |by| by.jump(cut.start, d));
        sign * jump * d * rate.powi(-(self.derivatives as i32))
    }

    /// |K| d/λ^d, the scale of the rounding error in the density of a formula.
    fn rounded(&self, cut: &Cut, d: f64) -> f64 {
        let rate = cut.start + d;
        let value = self.transfer.value(Complex::new(-rate, 0.0)).norm();
        value.max(self.transfer.spring().abs()) * d * rate.powi(-(self.derivatives as i32))
    }

    /// Distance from the branch point below which nodes are constant up to the horizon.
    fn standing(&self) -> f64 {
        0.01 * self.tolerance / self.horizon
    }

    /// Sums the nodes beyond one end, farther and farther out, until they are negligible or follow a power
    /// law.
    fn beyond(part: impl Fn(usize) -> f64, most: usize) -> f64 {
        let (mut sum, mut before) = (0.0, 0.0);
        for k in 0..most {
            let now: f64 = part(k);
            sum += now;
            if now.abs() <= NEGLIGIBLE * f64::abs(sum) {
                return sum;
            }
            if k + 1 == most && before != 0.0 {
                let ratio: f64 = now / before;
                sum += if (0.0..1.0).contains(&ratio) { now * ratio / (1.0 - ratio) } else { 0.0 };
            }
            before = now;
        }
        sum
    }

    /// The trapezoidal rule in ln d.
    fn trapezoidal(&self, cut: &Cut) -> Vec<Relaxation> {
        let spacing = 2.0 * PI * cut.strip / (libm::log(2.0 / self.tolerance) + 6.0);
        let lowest = libm::log(self.standing());
        let highest = libm::log(1e3 / self.shortest);
        let count = ((highest - lowest) / spacing).ceil() as usize;
        let far = (libm::log(FAR) / spacing) as usize;
        let at = |y: f64| spacing * self.density(cut, libm::exp(y));
        let rest = Self::beyond(|k| at(lowest - (k + 1) as f64 * spacing), far);
        let mut nodes = vec![Relaxation { rate: cut.start, coefficient: rest }];
        nodes.extend((0..count).map(|k| {
            let y = lowest + k as f64 * spacing;
            Relaxation { rate: cut.start + libm::exp(y), coefficient: at(y) }
        }));
        // Far out nodes contribute through c/λ only, and those at the end are merged to one.
        let mut sum = 0.0;
        let mut last = count;
        for k in count..count + far {
            let y = lowest + k as f64 * spacing;
            let node = Relaxation { rate: cut.start + libm::exp(y), coefficient: at(y) };
            let part = (node.coefficient / node.rate).abs();
            sum += part;
            last = k + 1;
            if part <= NEGLIGIBLE * sum {
                break;
            }
            nodes.push(node);
        }
        if last == count + far {
            nodes.extend(self.closing(&nodes));
        }
        nodes
    }

    /// The power-law continuation of the last nodes, merged to one at the end.
    fn closing(&self, nodes: &[Relaxation]) -> Option<Relaxation> {
        let [.., before, last] = nodes else { return None };
        let worth = |node: &Relaxation| node.coefficient / node.rate;
        let ratio = worth(last) / worth(before);
        let rate = last.rate;
        (0.0..1.0)
            .contains(&ratio)
            .then(|| Relaxation { rate, coefficient: worth(last) * ratio / (1.0 - ratio) * rate })
    }

    /// Gauss rules of the density in windows of ln d: for jumps that are analytic in a narrow strip only, or
    /// begin at some place.
    fn in_windows(&self, cut: &Cut) -> Vec<Relaxation> {
        let lowest = libm::log(self.standing());
        let highest = libm::log(1e3 / self.shortest);
        let count = ((highest - lowest) / WINDOW).ceil() as usize;
        let far = (libm::log(FAR) / WINDOW) as usize;
        let mass = |k: f64| self.fine(cut, lowest + k * WINDOW).iter().map(|node| node.1).sum::<f64>();
        let mut nodes =
            vec![Relaxation { rate: cut.start, coefficient: Self::beyond(|k| mass(-1.0 - k as f64), far) }];
        let size = (0.5 * libm::log(10.0 / self.tolerance) / ELLIPSE).ceil() as usize;
        let mut sum = 0.0;
        for k in 0..count + far {
            let begin = lowest + k as f64 * WINDOW;
            let fine = self.fine(cut, begin);
            for sign in [1.0, -1.0] {
                let measure: Vec<(f64, f64)> = fine
                    .iter()
                    .filter(|(_, part)| part * sign > 0.0)
                    .map(|(y, part)| (2.0 * (y - begin) / WINDOW - 1.0, part.abs()))
                    .collect();
                if measure.is_empty() {
                    continue;
                }
                let rule = JacobiMatrix::of(&measure).gauss_rule(size.min(measure.len()));
                nodes.extend(rule.into_iter().map(|(x, mass)| Relaxation {
                    rate: cut.start + libm::exp(begin + 0.5 * WINDOW * (x + 1.0)),
                    coefficient: sign * mass,
                }));
            }
            if k >= count {
                let part: f64 = fine.iter().map(|(y, part)| (part / (cut.start + libm::exp(*y))).abs()).sum();
                sum += part;
                if part <= NEGLIGIBLE * sum {
                    return nodes;
                }
            }
        }
        nodes
    }

    /// Places y and masses of the density in a window, which is halved until both halves agree with the
    /// whole.
    fn fine(&self, cut: &Cut, begin: f64) -> Vec<(f64, f64)> {
        /// The Gauss–Legendre rule with eight nodes on [−1, 1]: places and weights of the right half.
        const RULE: [(f64, f64); 4] = [
            (0.183_434_642_495_649_8, 0.362_683_783_378_362),
            (0.525_532_409_916_329, 0.313_706_645_877_887_3),
            (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
            (0.960_289_856_497_536_2, 0.101_228_536_290_376_3),
        ];
        let rule = |from: f64, to: f64| -> Vec<(f64, f64)> {
            let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
            let places = RULE.iter().flat_map(|&(x, w)| [(-x, w), (x, w)]);
            places
                .map(|(x, w)| {
                    let y = middle + half * x;
                    (y, half * w * self.density(cut, libm::exp(y)))
                })
                .filter(|(_, part)| part.is_finite() && *part != 0.0)
                .collect()
        };
        let total = |nodes: &[(f64, f64)]| nodes.iter().map(|node| node.1).sum::<f64>();
        let size = |nodes: &[(f64, f64)]| nodes.iter().map(|node| node.1.abs()).sum::<f64>();
        let mut found = Vec::new();
        let mut open: Vec<_> = (0..8)
            .map(|k| {
                let from = begin + WINDOW * f64::from(k) / 8.0;
                (from, from + WINDOW / 8.0, 0)
            })
            .collect();
        let scale: f64 = open.iter().map(|&(from, to, _)| size(&rule(from, to))).sum();
        while let Some((from, to, halvings)) = open.pop() {
            let middle = 0.5 * (from + to);
            let whole = rule(from, to);
            let halves = [rule(from, middle), rule(middle, to)].concat();
            let error = (total(&whole) - total(&halves)).abs();
            // The jump of a formula has the rounding error of its value.
            let noise = 1e-15 * 0.5 * (to - from) * self.rounded(cut, libm::exp(middle));
            let agrees = error <= 1e-15 * scale || error <= 1e-15 * size(&halves) || error <= noise;
            if agrees || halvings == HALVINGS || found.len() + open.len() >= 16 * PIECES {
                found.extend(halves);
            } else {
                open.extend([(from, middle, halvings + 1), (middle, to, halvings + 1)]);
            }
        }
        found
    }

    /// K(s)/s^d
    fn value(&self, s: Complex<f64>) -> Complex<f64> {
        let whole = self.by.map_or_else(|| self.transfer.value(s), |by| by.value(s) + by.spring());
        (0..self.derivatives).fold(whole, |value, _| value / s)
    }

    fn sum(nodes: &[Relaxation], s: Complex<f64>) -> Complex<f64> {
        nodes.iter().map(|node| (s + node.rate).inv() * node.coefficient).sum()
    }

    /// A relaxation of rate 0 and one of infinite rate that account for the difference from K at both ends of
    /// the positive axis.
    fn what_is_left(&self, nodes: &[Relaxation]) -> Vec<Relaxation> {
        let left = |s: f64| {
            let s = Complex::new(s, 0.0);
            (self.value(s) - Self::sum(nodes, s)).re
        };
        let (slow, fast) = (1e-2 / self.horizon, 1e2 / self.shortest);
        let (at_slow, at_fast) = (left(slow), left(fast));
        let standing = (at_slow - at_fast) / (1.0 / slow - 1.0 / fast);
        let endless = at_fast - standing / fast;
        let rate = 1e16 / self.shortest;
        let worth = |part: f64, of: f64| part.abs() > 1e-14 * self.value(Complex::new(of, 0.0)).norm();
        let mut found = Vec::new();
        if worth(standing / slow, slow) {
            found.push(Relaxation { rate: 0.0, coefficient: standing });
        }
        if worth(endless, fast) {
            found.push(Relaxation { rate, coefficient: endless * rate });
        }
        found
    }

    /// Largest error of the sum on the rays, relative to K including its spring.
    fn largest_error(&self, nodes: &[Relaxation]) -> f64 {
        let (first, last) = (libm::log(1.0 / self.horizon), libm::log(10.0 / self.shortest));
        let count = (2.0 * (last - first)).ceil().max(1.0);
        let mut largest = 0.0;
        for k in 0..=count as usize {
            let size = libm::exp(first + (last - first) * k as f64 / count);
            for angle in [0.0, 0.25 * PI, 0.5 * PI] {
                let s = Complex::new(size * libm::cos(angle), size * libm::sin(angle));
                let missing =
                    (0..self.derivatives).fold(self.value(s) - Self::sum(nodes, s), |left, _| left * s);
                // At a zero of K the error is related to a nearby value instead; K grows no faster than s².
                let sizes = [1.0, 1.5].map(|ratio| self.transfer.value(s * ratio).norm() / (ratio * ratio));
                let error = missing.norm() / sizes[0].max(sizes[1]).max(self.transfer.spring().abs());
                if error.is_nan() || error > largest {
                    largest = error;
                }
            }
        }
        largest
    }
}
