//! Rational functions of the Laplace variable in partial fractions.

use nalgebra::{Complex, DMatrix};

/// K(s) = c₀ + c₁ s + Σ_p Σ_k a_{pk}/(s − p)^k, real for real s: of poles in conjugate pairs both are listed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fractions {
    /// c₀ and c₁.
    pub direct: [f64; 2],
    /// The poles, each once.
    pub poles: Vec<PoleOfOrder>,
}

/// A pole with its Laurent coefficients.
#[derive(Clone, Debug, PartialEq)]
pub struct PoleOfOrder {
    /// p.
    pub place: Complex<f64>,
    /// a₁, a₂, …: those of 1/(s − p), 1/(s − p)², …
    pub coefficients: Vec<Complex<f64>>,
}

/// Relative distance of places that are one up to rounding.
pub const SAME: f64 = 1e-13;

/// Highest degree of a polynomial that is read: beyond, its coefficients do not tell its roots.
const HIGHEST: usize = 40;

/// True if two places are one up to rounding.
pub fn is_same(one: Complex<f64>, other: Complex<f64>) -> bool {
    (one - other).norm() <= SAME * one.norm().max(other.norm())
}

impl PoleOfOrder {
    fn value(&self, s: Complex<f64>) -> Complex<f64> {
        let inverse = (s - self.place).inv();
        self.coefficients.iter().rev().fold(Complex::<f64>::ZERO, |sum, a| (sum + a) * inverse)
    }
}

impl Fractions {
    /// c₀.
    pub fn constant(value: f64) -> Self {
        Self { direct: [value, 0.0], poles: Vec::new() }
    }

    /// K(s).
    pub fn value(&self, s: Complex<f64>) -> Complex<f64> {
        let poles: Complex<f64> = self.poles.iter().map(|pole| pole.value(s)).sum();
        s * self.direct[1] + self.direct[0] + poles
    }

    /// The sum of the sizes of its terms at s, the scale of its rounding errors.
    pub fn size(&self, s: Complex<f64>) -> f64 {
        let of_pole = |pole: &PoleOfOrder| {
            let inverse = 1.0 / (s - pole.place).norm();
            pole.coefficients.iter().rev().fold(0.0, |sum, a| (sum + a.norm()) * inverse)
        };
        let poles: f64 = self.poles.iter().map(of_pole).sum();
        self.direct[0].abs() + self.direct[1].abs() * s.norm() + poles
    }

    /// The sum of two functions.
    #[must_use]
    pub fn plus(mut self, other: Self) -> Self {
        self.direct.iter_mut().zip(other.direct).for_each(|(mine, more)| *mine += more);
        for pole in other.poles {
            let Some(mine) = self.poles.iter_mut().find(|mine| is_same(mine.place, pole.place)) else {
                self.poles.push(pole);
                continue;
            };
            let count = mine.coefficients.len().max(pole.coefficients.len());
            mine.coefficients.resize(count, Complex::ZERO);
            mine.coefficients.iter_mut().zip(pole.coefficients).for_each(|(mine, more)| *mine += more);
        }
        self
    }

    /// The product with a number.
    #[must_use]
    pub fn scale(mut self, factor: f64) -> Self {
        self.direct.iter_mut().for_each(|number| *number *= factor);
        let numbers = self.poles.iter_mut().flat_map(|pole| &mut pole.coefficients);
        numbers.for_each(|number| *number *= factor);
        self
    }

    /// True if all poles are simple and on the negative real axis: K is a sum of relaxations.
    pub fn is_relaxation(&self) -> bool {
        let relaxes =
            |pole: &PoleOfOrder| pole.coefficients.len() == 1 && pole.place.im == 0.0 && pole.place.re < 0.0;
        self.poles.iter().all(relaxes)
    }

    /// The Laurent coefficients of K(s)/s at each pole, for K(0) = 0.
    ///
    /// 1/s = Σ_j (−1)^j (s − p)^j/p^{j+1}
    #[must_use]
    pub fn poles_over_s(&self) -> Vec<PoleOfOrder> {
        let divided = |pole: &PoleOfOrder| {
            let inverse = pole.place.inv();
            let mut coefficients = pole.coefficients.clone();
            let mut above = Complex::ZERO;
            for number in coefficients.iter_mut().rev() {
                above = (*number - above) * inverse;
                *number = above;
            }
            PoleOfOrder { place: pole.place, coefficients }
        };
        self.poles.iter().map(divided).collect()
    }
}

/// A quotient of polynomials with real coefficients in ascending order; the denominator in factors.
#[derive(Clone, Debug)]
pub struct Quotient {
    above: Vec<f64>,
    below: Vec<Vec<f64>>,
}

impl Quotient {
    /// A number.
    pub fn constant(value: f64) -> Self {
        Self { above: vec![value], below: Vec::new() }
    }

    /// s.
    pub fn variable() -> Self {
        Self { above: vec![0.0, 1.0], below: Vec::new() }
    }

    /// The sum, over a common denominator.
    #[must_use]
    pub fn plus(self, other: &Self) -> Self {
        let mut missing = other.below.clone();
        let mut mine = self.below.clone();
        mine.retain(|factor| match missing.iter().position(|other| other == factor) {
            Some(place) => {
                missing.remove(place);
                false
            }
            None => true,
        });
        let one = missing.iter().fold(self.above, |product, factor| multiplied(&product, factor));
        let more = mine.iter().fold(other.above.clone(), |product, factor| multiplied(&product, factor));
        let (mut sum, short) = if one.len() < more.len() { (more, one) } else { (one, more) };
        sum.iter_mut().zip(short).for_each(|(sum, number)| *sum += number);
        let below = self.below.into_iter().chain(missing).collect();
        Self { above: trimmed(sum), below }
    }

    /// The product.
    #[must_use]
    pub fn multiply(self, other: &Self) -> Self {
        let mut below = self.below;
        below.extend_from_slice(&other.below);
        Self { above: multiplied(&self.above, &other.above), below }
    }

    /// The inverse; `None` of zero.
    pub fn inverse(self) -> Option<Self> {
        if self.above.iter().all(|&number| number == 0.0) {
            return None;
        }
        let above = self.below.iter().fold(vec![1.0], |product, factor| multiplied(&product, factor));
        let below = if self.above == [1.0] { Vec::new() } else { vec![self.above] };
        Some(Self { above, below })
    }

    /// A whole power; `None` if the degree would be beyond what is read.
    pub fn power(self, exponent: f64) -> Option<Self> {
        if exponent.fract() != 0.0 || exponent.abs() > HIGHEST as f64 {
            return None;
        }
        let base = if exponent < 0.0 { self.inverse()? } else { self };
        let power = (0..exponent.abs() as usize).fold(Self::constant(1.0), |power, _| power.multiply(&base));
        power.is_readable().then_some(power)
    }

    /// True if its degrees are small enough, and its numbers finite.
    pub fn is_readable(&self) -> bool {
        let degree = self.below.iter().map(Vec::len).sum::<usize>().max(self.above.len());
        degree <= 2 * HIGHEST && self.above.iter().chain(self.below.iter().flatten()).all(|x| x.is_finite())
    }

    /// Partial fractions; `None` if it grows faster than s, has a pole at s = 0, or roots are not found.
    pub fn fractions(&self) -> Option<Fractions> {
        let mut lead = 1.0;
        let mut places: Vec<(Complex<f64>, usize)> = Vec::new();
        for factor in &self.below {
            lead *= factor.last()?;
            for root in roots(factor)? {
                match places.iter_mut().find(|(place, _)| is_same(*place, root)) {
                    Some((_, order)) => *order += 1,
                    None => places.push((root, 1)),
                }
            }
        }
        let below = self.below.iter().fold(vec![1.0], |product, factor| multiplied(&product, factor));
        let (degree, of_below) = (self.above.len(), below.len());
        if degree > of_below + 1 || places.iter().any(|(place, _)| place.norm() == 0.0) {
            return None;
        }
        let at = |index: usize| self.above.get(index).map_or(0.0, |a| *a);
        let last = below.last()?;
        let c1 = at(of_below) / last;
        let next = if of_below > 1 { below[of_below - 2] } else { 0.0 };
        let c0 = (at(of_below - 1) - c1 * next) / last;
        let mut poles = Vec::new();
        for (index, &(place, order)) in places.iter().enumerate() {
            let mut series = shifted(&self.above, place, order);
            series.iter_mut().for_each(|number| *number /= lead);
            for (other, times) in places.iter().enumerate().filter(|(other, _)| *other != index).map(|x| *x.1)
            {
                for _ in 0..times {
                    divide_by_root(&mut series, place - other);
                }
            }
            // Coefficients of 1/(s − p)^order first. A root of the numerator cancels the pole.
            series.reverse();
            let size = self.above.iter().rev().fold(0.0, |sum: f64, a| sum * place.norm() + a.abs());
            let value = self.above.iter().rev().fold(Complex::<f64>::ZERO, |sum, a| sum * place + *a);
            if order == 1 && value.norm() <= 8.0 * f64::EPSILON * size {
                continue;
            }
            poles.push(PoleOfOrder { place, coefficients: series });
        }
        let fractions = Fractions { direct: [c0, c1], poles };
        let numbers = fractions.poles.iter().flat_map(|pole| &pole.coefficients);
        let finite = numbers.into_iter().all(|a| a.re.is_finite() && a.im.is_finite());
        (finite && c0.is_finite() && c1.is_finite()).then_some(fractions)
    }
}

fn multiplied(one: &[f64], other: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; one.len() + other.len() - 1];
    for (i, a) in one.iter().enumerate() {
        for (j, b) in other.iter().enumerate() {
            product[i + j] += a * b;
        }
    }
    trimmed(product)
}

fn trimmed(mut polynomial: Vec<f64>) -> Vec<f64> {
    while polynomial.len() > 1 && polynomial.last() == Some(&0.0) {
        polynomial.pop();
    }
    polynomial
}

/// The first coefficients of a polynomial in s − p, by repeated synthetic division.
fn shifted(polynomial: &[f64], place: Complex<f64>, count: usize) -> Vec<Complex<f64>> {
    let mut rest: Vec<Complex<f64>> = polynomial.iter().map(|&a| Complex::new(a, 0.0)).collect();
    let mut series = Vec::with_capacity(count);
    for _ in 0..count {
        if rest.is_empty() {
            series.push(Complex::ZERO);
            continue;
        }
        for index in (0..rest.len() - 1).rev() {
            let above = rest[index + 1];
            rest[index] += place * above;
        }
        series.push(rest.remove(0));
    }
    series
}

/// Divides a series in x by x + `distance`.
fn divide_by_root(series: &mut [Complex<f64>], distance: Complex<f64>) {
    let mut before = Complex::ZERO;
    for number in series {
        *number = (*number - before) / distance;
        before = *number;
    }
}

/// The roots of a polynomial, each as often as it is one, in exact conjugate pairs; `None` if its numbers do
/// not tell them.
///
/// Those of a quadratic from its formula, others as eigenvalues of the companion matrix, with s scaled so
/// that first and last coefficient are alike, refined by Newton's method.
fn roots(polynomial: &[f64]) -> Option<Vec<Complex<f64>>> {
    let zeros = polynomial.iter().take_while(|&&a| a == 0.0).count();
    let rest = polynomial.get(zeros..)?;
    let degree = rest.len().checked_sub(1)?;
    let mut found = vec![Complex::ZERO; zeros];
    match *rest {
        [_] => {}
        [c, b] => found.push(Complex::new(-c / b, 0.0)),
        [c, b, a] => found.extend(roots_of_quadratic(a, b, c)),
        _ if degree > HIGHEST => return None,
        _ => found.extend(roots_of_higher(rest)?),
    }
    Some(found)
}

/// Of a s² + b s + c: the discriminant with a fused product, so that double roots are seen.
fn roots_of_quadratic(a: f64, b: f64, c: f64) -> [Complex<f64>; 2] {
    let product = 4.0 * a * c;
    let rest = libm::fma(4.0 * a, c, -product);
    let discriminant = libm::fma(b, b, -product) - rest;
    let middle = -b / (2.0 * a);
    if discriminant.abs() <= 4.0 * f64::EPSILON * (b * b).max(product.abs()) {
        return [Complex::new(middle, 0.0); 2];
    }
    if discriminant < 0.0 {
        let beside = libm::sqrt(-discriminant) / (2.0 * a).abs();
        return [Complex::new(middle, beside), Complex::new(middle, -beside)];
    }
    let far = -0.5 * (b + libm::copysign(libm::sqrt(discriminant), b));
    [Complex::new(far / a, 0.0), Complex::new(c / far, 0.0)]
}

fn roots_of_higher(polynomial: &[f64]) -> Option<Vec<Complex<f64>>> {
    let degree = polynomial.len() - 1;
    let (first, last) = (polynomial[0], polynomial[degree]);
    let scale = libm::exp(libm::log((first / last).abs()) / degree as f64);
    let scaled: Vec<f64> =
        polynomial.iter().enumerate().map(|(k, a)| a / last * scale.powi(k as i32 - degree as i32)).collect();
    let companion = DMatrix::from_fn(degree, degree, |row, column| match (row, column) {
        (row, column) if column + 1 == degree => -scaled[row],
        (row, column) if row == column + 1 => 1.0,
        _ => 0.0,
    });
    let schur = nalgebra::linalg::Schur::try_new(companion, f64::EPSILON, 10_000)?;
    let refined = |start: Complex<f64>| {
        let mut root = start;
        for _ in 0..20 {
            let (value, slope) = scaled
                .iter()
                .rev()
                .fold((Complex::<f64>::ZERO, Complex::<f64>::ZERO), |(value, slope), a| {
                    (value * root + a, slope * root + value)
                });
            let step = value / slope;
            if step.norm().is_nan() || step.norm() >= 1e-3 * root.norm() {
                break;
            }
            root -= step;
            if step.norm() <= f64::EPSILON * root.norm() {
                break;
            }
        }
        root
    };
    let mut found = Vec::with_capacity(degree);
    for start in schur.complex_eigenvalues().iter().filter(|root| root.im >= 0.0) {
        let mut root = refined(*start);
        if root.im.abs() <= 1e-12 * root.norm() {
            root.im = 0.0;
        }
        found.push(root * scale);
        if start.im > 0.0 {
            found.push(root.conj() * scale);
        }
    }
    (found.len() == degree).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polynomial(coefficients: &[f64]) -> Quotient {
        Quotient { above: coefficients.to_vec(), below: Vec::new() }
    }

    fn agrees(quotient: &Quotient) -> Fractions {
        let fractions = quotient.fractions().unwrap();
        for angle in [0.0, 0.8, 1.5] {
            for size in [1e-4, 0.03, 0.9, 4.0, 1e3] {
                let s = Complex::new(size * libm::cos(angle), size * libm::sin(angle));
                let of = |numbers: &[f64]| numbers.iter().rev().fold(Complex::ZERO, |sum, a| sum * s + a);
                let below: Complex<f64> = quotient.below.iter().map(|factor| of(factor)).product();
                let (known, found) = (of(&quotient.above) / below, fractions.value(s));
                let size = fractions.size(s);
                assert!((found - known).norm() < 1e-12 * size, "{quotient:?} at {s}: {found}, {known}");
            }
        }
        fractions
    }

    #[test]
    fn quotients_are_their_partial_fractions() {
        let above = polynomial(&[0.0, 0.3, 1.7]);
        for (below, simple) in [
            (vec![vec![1.0, 1.0]], true),
            (vec![vec![1.0, 1.0], vec![3.0, 0.5]], true),
            (vec![vec![1.0, 2.0, 1.0]], false),
            (vec![vec![1.0, 1.0]; 3], false),
            (vec![vec![3.2, 0.53, 1.0]], true),
            (vec![vec![3.2, 0.53, 1.0]; 2], false),
            (vec![vec![0.7, 3.0, 4.0, 2.0, 0.9]], true),
            (vec![vec![1e-4, 1.01, 100.0, 0.0, 0.0, 1.0]], true),
        ] {
            let below = below.into_iter().map(|factor| polynomial(&factor).inverse().unwrap());
            let quotient = below.fold(above.clone(), |product, factor| product.multiply(&factor));
            let fractions = agrees(&quotient);
            assert_eq!(fractions.poles.iter().all(|pole| pole.coefficients.len() == 1), simple);
        }
    }

    #[test]
    fn a_root_of_both_polynomials_is_no_pole() {
        let below = polynomial(&[2.0, 3.0, 1.0]).inverse().unwrap();
        let fractions = agrees(&polynomial(&[1.0, 1.0]).multiply(&below));
        assert_eq!(fractions.poles.len(), 1);
    }

    #[test]
    fn what_has_a_pole_at_zero_or_grows_faster_than_s_has_none() {
        assert!(polynomial(&[0.0, 1.0]).inverse().unwrap().fractions().is_none());
        assert!(polynomial(&[0.0, 0.0, 1.0]).fractions().is_none());
    }

    #[test]
    fn over_s_the_coefficients_of_every_order_follow() {
        let below = polynomial(&[3.2, 0.53, 1.0]).inverse().unwrap();
        let quotient = polynomial(&[0.0, 1.0]).multiply(&below.clone().multiply(&below));
        let divided = Fractions { direct: [0.0; 2], poles: quotient.fractions().unwrap().poles_over_s() };
        let s = Complex::new(0.4, 1.1);
        let known = (s * s + s * 0.53 + 3.2).inv().powi(2);
        assert!((divided.value(s) - known).norm() < 1e-13 * known.norm());
    }
}
