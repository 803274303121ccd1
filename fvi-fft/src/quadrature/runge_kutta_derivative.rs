//! Derivatives of the matrix weights of Runge–Kutta convolution quadrature by parameters of a kernel.

use crate::dense::solve_complex;
use crate::quadrature::inverse::inverse;
use crate::real_transforms;
use crate::transfer::derivative::TransferDerivative;
use fvi_core::{ParameterError, RungeKutta};
use nalgebra::{Complex, SMatrix};
use std::f64::consts::PI;

/// Number of points on the circle per weight.
const POINTS: usize = 16;

/// Aliasing error of the transform, relative to a weight.
const FOLDED: f64 = 1e-20;

/// Largest number of corrections of the eigenvalues of Δ(z), which start from those at the previous point.
const CORRECTIONS: usize = 60;

/// The derivatives ∂W_n of matrix weights with respect to a parameter θ of the kernel, n = 0 … count − 1,
/// plane by plane: entry (i, j) of ∂W_n is at (i·R + j)·count + n. On values, or on rises if `on_rises` is
/// set, as in [`of_transfer`](super::runge_kutta_weights::RungeKuttaWeights::of_transfer).
///
/// ```text
/// Σ_n ∂W_n zⁿ = f(Δ(z)/h) ,      f = ∂K/∂θ ;      on rises f(Δ(z)/h) (Δ(z)/h)⁻¹ A⁻¹/h
/// ```
///
/// Δ(z) = A⁻¹ − z A⁻¹ 1 bᵀ A⁻¹ has the eigenvalues λ with z R(λ) = 1, R the stability function of a stiffly
/// accurate method, and for each the eigenvectors v = (I − λA)⁻¹ 1 and wᵀ = bᵀ (I − λA)⁻¹, so that
/// f(Δ/h) = Σ f(λ/h) v wᵀ / wᵀv. The weights follow from Cauchy's integral on a circle inside |z| = 1, as a
/// transform, with errors relative to the largest.
///
/// # Errors
/// If h is not positive and finite, or a weight is not finite.
pub fn runge_kutta_derivative<const R: usize>(
    method: &RungeKutta<R>,
    derivative: &TransferDerivative,
    step_size: f64,
    on_rises: bool,
    count: usize,
) -> Result<Vec<f64>, ParameterError> {
    let matrix = SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j]);
    let inverse = inverse(&matrix);
    let row_by_row = |matrix: &SMatrix<f64, R, R>| -> Vec<f64> { matrix.transpose().as_slice().to_vec() };
    let tables = Tables {
        stages: R,
        matrix: row_by_row(&matrix),
        inverse: row_by_row(&inverse),
        weights: method.quadrature().weights().to_vec(),
    };
    tables.planes(derivative, step_size, on_rises, count)
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
        derivative: &TransferDerivative,
        step_size: f64,
        on_rises: bool,
        count: usize,
    ) -> Result<Vec<f64>, ParameterError> {
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
                let factor = derivative.value(s);
                let factor = if on_rises { factor / (s * step_size) } else { factor };
                if self.add_projection(eigenvalue, factor, on_rises, &mut value).is_none() {
                    return refused(
                        "step size",
                        step_size,
                        "one at which the derivative's weights are finite",
                    );
                }
            }
            for (values, &value) in values.iter_mut().zip(&value) {
                values[k] = value;
            }
        }
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
            let scale = |n: usize| libm::exp(-(n as f64) * libm::log(radius)) / length as f64;
            planes.extend(plane.iter().take(count).enumerate().map(|(n, weight)| weight * scale(n)));
        }
        match planes.iter().find(|weight| !weight.is_finite()) {
            Some(&weight) => refused("derivative of a weight", weight, "finite"),
            None => Ok(planes),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quadrature::runge_kutta_weights::RungeKuttaWeights;
    use crate::transfer::TransferFunction;
    use fvi_core::ParameterError;

    type Made = Result<TransferFunction, ParameterError>;

    /// A parameter, its index and value, and the kernel as a function of it.
    type Case = (&'static str, usize, f64, Box<dyn Fn(f64) -> Made>);

    fn assert_differences<const R: usize>(method: &RungeKutta<R>, case: &Case) {
        let (name, index, at, make) = case;
        let (step_size, count) = (0.05, 50);
        let transfer = make(*at).unwrap();
        let derivative = TransferDerivative::new(&transfer, name, *index).unwrap();
        for on_rises in [false, true] {
            if on_rises && transfer.growth() < 0.1 {
                continue;
            }
            let found = runge_kutta_derivative(method, &derivative, step_size, on_rises, count).unwrap();
            let planes = |by: f64| {
                RungeKuttaWeights::of_transfer(method, &make(at + by).unwrap(), on_rises, step_size, count)
                    .unwrap()
                    .planes()
            };
            let h = 1e-3 * at;
            let [one, other, far, away] = [h, -h, 2.0 * h, -2.0 * h].map(planes);
            let (mut largest, mut error) = (0.0_f64, 0.0_f64);
            for (place, found) in found.iter().enumerate() {
                let difference =
                    (8.0 * (one[place] - other[place]) - (far[place] - away[place])) / (12.0 * h);
                largest = largest.max(difference.abs());
                error = error.max((found - difference).abs());
            }
            assert!(
                error < 1e-9 * largest,
                "{name} of {transfer}, {R}, {on_rises}: {error:e} of {largest:e}"
            );
        }
    }

    #[test]
    fn derivatives_are_differences_of_weights() {
        let cases: Vec<Case> = vec![
            ("order", 0, 0.7, Box::new(TransferFunction::power)),
            ("order", 0, 1.4, Box::new(TransferFunction::power)),
            ("rate", 0, 0.3, Box::new(|x| TransferFunction::tempered(1.4, x))),
            ("order", 0, 0.8, Box::new(|x| TransferFunction::maxwell(x, 0.2, 1.5))),
            ("inner", 0, 0.2, Box::new(|x| TransferFunction::maxwell(0.8, x, 1.5))),
            ("times", 1, 0.1, Box::new(|x| TransferFunction::prony(&[1.0, 0.7], &[1.0, x]))),
            ("time", 0, 2.0, Box::new(|x| TransferFunction::havriliak_negami(0.6, 0.5, x))),
        ];
        for case in &cases {
            assert_differences(&RungeKutta::<1>::radau_iia().unwrap(), case);
            assert_differences(&RungeKutta::<2>::radau_iia().unwrap(), case);
            assert_differences(&RungeKutta::<3>::radau_iia().unwrap(), case);
            assert_differences(&RungeKutta::<4>::lobatto_iiic().unwrap(), case);
        }
    }
}
