//! Matrix weights of Runge–Kutta convolution quadrature by transforms on a circle, for any function that is
//! analytic in the right half-plane.

use crate::dense::solve_complex;
use crate::quadrature::inverse::inverse;
use crate::real_transforms;
use fvi_core::{ParameterError, RungeKutta, max_or_nan};
use nalgebra::{Complex, SMatrix};
use std::f64::consts::PI;

/// Number of points on the circle per weight.
const POINTS: usize = 16;

/// Aliasing error of the transform, relative to a weight.
const FOLDED: f64 = 1e-20;

/// Largest number of corrections of the eigenvalues of Δ(z), which start from those at the previous point.
const CORRECTIONS: usize = 60;

/// Weights by a transform on a circle.
pub(crate) struct OnCircle {
    /// Plane by plane.
    pub(crate) planes: Vec<f64>,
    /// The largest coefficient of a negative power of z, relative to the largest value on the circle: not
    /// more than rounding for a function that is analytic inside.
    pub(crate) behind: f64,
}

/// The weights of Σ W_n zⁿ = f(Δ(z)/h) for a function f that is analytic in the right half-plane, by the
/// formulas of [`runge_kutta_derivative`](super::runge_kutta_derivative::runge_kutta_derivative).
pub(crate) fn on_circle<const R: usize>(
    method: &RungeKutta<R>,
    function: &dyn Fn(Complex<f64>) -> Complex<f64>,
    step_size: f64,
    on_rises: bool,
    count: usize,
) -> Result<OnCircle, ParameterError> {
    let matrix = SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j]);
    let inverse = inverse(&matrix);
    let row_by_row = |matrix: &SMatrix<f64, R, R>| -> Vec<f64> { matrix.transpose().as_slice().to_vec() };
    let tables = Tables {
        stages: R,
        matrix: row_by_row(&matrix),
        inverse: row_by_row(&inverse),
        weights: method.quadrature().weights().to_vec(),
    };
    tables.planes(function, step_size, on_rises, count)
}

/// The tables of a method for any number of stages, compiled once for all of them.
struct Tables {
    stages: usize,
    /// A and A⁻¹, row by row, and b.
    matrix: Vec<f64>,
    inverse: Vec<f64>,
    weights: Vec<f64>,
}

impl Tables {
    fn planes(
        &self,
        function: &dyn Fn(Complex<f64>) -> Complex<f64>,
        step_size: f64,
        on_rises: bool,
        count: usize,
    ) -> Result<OnCircle, ParameterError> {
        let refused = |parameter, value, allowed| Err(ParameterError { parameter, value, allowed });
        if !(step_size > 0.0 && step_size.is_finite()) {
            return refused("step size", step_size, "positive and finite");
        }
        let entries = self.stages * self.stages;
        let length = (POINTS * count).next_power_of_two();
        let radius = libm::exp(libm::log(FOLDED) / length as f64);
        let (below, above) = self.polynomials();
        let mut eigenvalues: Vec<Complex<f64>> =
            (0..self.stages).map(|k| Complex::new(0.4, 0.9).powu(k as u32) * 3.0).collect();
        let mut values = vec![vec![Complex::ZERO; length / 2 + 1]; entries];
        let mut value = vec![Complex::ZERO; entries];
        for k in 0..=length / 2 {
            let angle = -2.0 * PI * k as f64 / length as f64;
            let z = Complex::new(libm::cos(angle), libm::sin(angle)) * radius;
            find_roots(&below, &above, z, &mut eigenvalues);
            value.fill(Complex::ZERO);
            for &eigenvalue in &eigenvalues {
                let s = eigenvalue / step_size;
                let factor = function(s);
                let factor = if on_rises { factor / (s * step_size) } else { factor };
                if self.add_projection(eigenvalue, factor, on_rises, &mut value).is_none() {
                    return refused(
                        "step size",
                        step_size,
                        "one at which the weights, or their derivatives, are finite",
                    );
                }
            }
            for (values, &value) in values.iter_mut().zip(&value) {
                values[k] = value;
            }
        }
        let largest = values.iter().flatten().map(|value| value.norm()).fold(0.0, max_or_nan);
        let mut behind = 0.0_f64;
        let (_, inverse) = real_transforms(length);
        let (mut planes, mut plane) = (Vec::with_capacity(entries * count), vec![0.0; length]);
        for mut values in values {
            // Real for real z, without rounding errors of the imaginary part.
            for end in [0, length / 2] {
                values[end].im = 0.0;
            }
            if inverse.process(&mut values, &mut plane).is_err() {
                return refused("number of weights", count as f64, "smaller");
            }
            let last = plane[length - POINTS..].iter().map(|weight| weight.abs() / length as f64);
            behind = last.fold(behind, max_or_nan);
            let scale = |n: usize| libm::exp(-(n as f64) * libm::log(radius)) / length as f64;
            planes.extend(plane.iter().take(count).enumerate().map(|(n, weight)| weight * scale(n)));
        }
        match planes.iter().find(|weight| !weight.is_finite()) {
            Some(&weight) => refused("weight, or its derivative", weight, "finite"),
            None => Ok(OnCircle { planes, behind: behind / largest.max(f64::MIN_POSITIVE) }),
        }
    }

    /// Adds factor · v wᵀ/(wᵀv) for an eigenvalue, times A⁻¹ on rises.
    fn add_projection(
        &self,
        eigenvalue: Complex<f64>,
        factor: Complex<f64>,
        on_rises: bool,
        sum: &mut [Complex<f64>],
    ) -> Option<()> {
        let r = self.stages;
        let solved = |transposed: bool, right: &dyn Fn(usize) -> f64| {
            let entry = |place: usize| {
                let (row, column) = (place / r, place % r);
                let entry = if transposed { self.matrix[column * r + row] } else { self.matrix[place] };
                Complex::new(f64::from(u8::from(row == column)), 0.0) - eigenvalue * entry
            };
            let mut matrix: Vec<Complex<f64>> = (0..r * r).map(entry).collect();
            let mut vector: Vec<Complex<f64>> = (0..r).map(|i| Complex::new(right(i), 0.0)).collect();
            solve_complex(&mut matrix, &mut vector).map(|()| vector)
        };
        let right = solved(false, &|_| 1.0)?;
        let left = solved(true, &|i| self.weights[i])?;
        let product: Complex<f64> = left.iter().zip(&right).map(|(w, v)| w * v).sum();
        let factor = factor / product;
        for j in 0..r {
            let entry = match on_rises {
                false => left[j],
                true => (0..r).map(|l| left[l] * self.inverse[l * r + j]).sum(),
            };
            for (i, v) in right.iter().enumerate() {
                sum[i * r + j] += factor * v * entry;
            }
        }
        Some(())
    }

    /// det(I − λA) and det(I − λ(A − 1bᵀ)) in powers of λ: denominator and numerator of R(λ).
    fn polynomials(&self) -> (Vec<f64>, Vec<f64>) {
        let r = self.stages;
        let of = |matrix: &[f64]| {
            // Elementary symmetric functions of the eigenvalues, from the sums of their powers.
            let (mut power, mut traces) = (matrix.to_vec(), Vec::new());
            for _ in 0..r {
                traces.push((0..r).map(|i| power[i * r + i]).sum::<f64>());
                power = (0..r * r)
                    .map(|place| (0..r).map(|l| power[place / r * r + l] * matrix[l * r + place % r]).sum())
                    .collect();
            }
            let mut symmetric = vec![1.0];
            for k in 1..=r {
                let sign = |i: usize| if i % 2 == 1 { 1.0 } else { -1.0 };
                let sum: f64 = (1..=k).map(|i| sign(i) * symmetric[k - i] * traces[i - 1]).sum();
                symmetric.push(sum / k as f64);
            }
            let signed = symmetric.iter().enumerate().map(|(k, e)| if k % 2 == 1 { -e } else { *e });
            signed.collect::<Vec<f64>>()
        };
        let changed: Vec<f64> =
            (0..r * r).map(|place| self.matrix[place] - self.weights[place % r]).collect();
        (of(&self.matrix), of(&changed))
    }
}

/// The zeros λ of below(λ) − z above(λ), all at once by Weierstrass' method from the given estimates.
fn find_roots(below: &[f64], above: &[f64], z: Complex<f64>, roots: &mut [Complex<f64>]) {
    let coefficients: Vec<Complex<f64>> = below.iter().zip(above).map(|(q, p)| q - z * p).collect();
    let leading = coefficients.last().copied().unwrap_or(Complex::ONE);
    for _ in 0..CORRECTIONS {
        let mut largest = 0.0_f64;
        for index in 0..roots.len() {
            let root = roots[index];
            let value = coefficients.iter().rev().fold(Complex::new(0.0, 0.0), |sum, c| sum * root + c);
            let others = roots.iter().enumerate().filter(|&(other, _)| other != index);
            let product = others.fold(leading, |product, (_, other)| product * (root - other));
            let correction = value / product;
            if correction.is_finite() {
                roots[index] = root - correction;
                largest = largest.max(correction.norm() / root.norm().max(1e-300));
            }
        }
        if largest < 4.0 * f64::EPSILON {
            break;
        }
    }
}
