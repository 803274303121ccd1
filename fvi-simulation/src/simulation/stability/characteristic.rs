//! The characteristic function of a step: its zeros z are the motions q_k = z^{−k} v.

use super::parts::Part;
use super::polynomials::Polynomials;
use super::symbol;
use super::{DampingForm, Discretisation};
use fvi_fft::dense;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::transfer::multistep_rule::MultistepRule;
use nalgebra::{Complex, DMatrix};
use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

/// The equations of a step for motions z^{−k} v, multiplied by h and by z^{−k−1}:
///
/// ```text
/// A(z) v = 0 ,
/// A_νμ(z) = Σ_i b_i [ ψ̇_ν(c_i) φ̇_μ(c_i) M − h ψ_ν(c_i) φ̇_μ(c_i) C − h² ψ_ν(c_i) φ_μ(c_i) K ]
///           − Σ_m h^{2−β_m} D^m_νμ(z) ρ_m
/// ```
///
/// with φ₀ = z(1 − τ) + τ, ψ₀ = 1 − τ + zτ, and φ_μ = ψ_μ a bubble for 0 < μ < S. The damping terms are
///
/// ```text
/// main nodes:  D_00 = z γ_p(z)^β, all others zero           (h (D^β q)_k in the equation of q_k)
/// nodes:       D_νμ = γ_p(z)^β Σ_i b_i ψ_ν(c_i) φ_μ(c_i)
/// stages:      D_νμ = Σ_i b_i ψ_ν(c_i) Σ_j (Δ(z)^β)_ij φ_μ(c_j)
/// ```
///
/// For another transfer function K(s), h² K(γ_p(z)/h) replaces h^{2−β} γ_p(z)^β.
pub(crate) struct Characteristic {
    degree: usize,
    polynomials: Polynomials,
    form: Form,
    transfers: Vec<TransferFunction>,
    /// Cache of the factors that do not depend on h, by the bits of z: the search for a stable step returns
    /// to the same z.
    known: RefCell<HashMap<[u64; 2], Rc<Factors>>>,
}

enum Form {
    MainNodes(MultistepRule),
    Nodes(MultistepRule),
    Stages { inverse: DMatrix<f64> },
}

/// The coefficients of M, K and the ρ_m at one z, S×S.
struct Factors {
    kinetic: DMatrix<Complex<f64>>,
    viscous: DMatrix<Complex<f64>>,
    elastic: DMatrix<Complex<f64>>,
    /// For transfer functions other than powers without their value.
    damped: Vec<DMatrix<Complex<f64>>>,
}

/// The coefficients of M, K and the ρ_m in the equations of a step, S×S each.
pub(crate) struct MatrixFactors {
    pub(crate) mass: DMatrix<Complex<f64>>,
    pub(crate) stiffness: DMatrix<Complex<f64>>,
    pub(crate) damping: Vec<DMatrix<Complex<f64>>>,
}

impl MatrixFactors {
    /// Adds the matrices, multiplied by their coefficients, to a matrix of S·N rows given row by row.
    pub(crate) fn add_to(
        &self,
        matrix: &mut [Complex<f64>],
        mass: &DMatrix<f64>,
        stiffness: &DMatrix<f64>,
        damping: &[DMatrix<f64>],
    ) {
        let pairs = [(&self.mass, mass), (&self.stiffness, stiffness)];
        for (factors, of) in pairs.into_iter().chain(self.damping.iter().zip(damping)) {
            add_product(matrix, factors, of);
        }
    }
}

/// Adds a matrix, multiplied by its S×S coefficients, to a matrix of S·N rows.
fn add_product(matrix: &mut [Complex<f64>], factors: &DMatrix<Complex<f64>>, of: &DMatrix<f64>) {
    let (degree, size) = (factors.nrows(), of.nrows());
    let rows = degree * size;
    for nu in 0..degree {
        for mu in 0..degree {
            let factor = factors[(nu, mu)];
            if factor == Complex::ZERO {
                continue;
            }
            for i in 0..size {
                for j in 0..size {
                    matrix[(nu * size + i) * rows + mu * size + j] += factor * of[(i, j)];
                }
            }
        }
    }
}

impl Characteristic {
    pub(crate) fn new(discretisation: &Discretisation, transfers: Vec<TransferFunction>) -> Self {
        let form = match &discretisation.form {
            DampingForm::MainNodes { rule } => Form::MainNodes(*rule),
            DampingForm::Nodes { rule } => Form::Nodes(*rule),
            DampingForm::Stages { matrix } => {
                let size = matrix.nrows();
                // A stiffly accurate method has one; without it no motion is found to be stable.
                let unknown = || DMatrix::from_element(size, size, f64::NAN);
                let inverse = dense::inverse(matrix.clone()).unwrap_or_else(unknown);
                Form::Stages { inverse }
            }
        };
        Self {
            degree: discretisation.degree,
            polynomials: Polynomials::new(
                discretisation.degree,
                &discretisation.nodes,
                &discretisation.weights,
            ),
            form,
            transfers,
            known: RefCell::default(),
        }
    }

    /// A logarithm of det A(z) up to a positive factor; `None` where it is zero or not finite.
    pub(super) fn logarithm(&self, part: &Part, step: f64, z: Complex<f64>) -> Option<Complex<f64>> {
        let (size, rows) = (part.size(), part.size() * self.degree);
        let mut matrix = vec![Complex::ZERO; rows * rows];
        let factors = self.factors_of_matrices(step, z);
        let identity = part.mass.is_none().then(|| DMatrix::identity(size, size));
        if let Some(mass) = part.mass.as_ref().or(identity.as_ref()) {
            factors.add_to(&mut matrix, mass, &part.stiffness, &part.damping);
        }
        if let Some(resistance) = &part.resistance {
            let viscous = self.factors(z).viscous.map(|entry| -entry * step);
            add_product(&mut matrix, &viscous, resistance);
        }
        log_determinant(&mut matrix, rows)
    }

    /// The coefficients of M, K and the ρ_m in A(z), signs and powers of h included.
    pub(crate) fn factors_of_matrices(&self, step: f64, z: Complex<f64>) -> MatrixFactors {
        let factors = self.factors(z);
        let damped = self.transfers.iter().zip(&factors.damped).map(|(transfer, damped)| {
            let staged = self.at_stages(transfer, step, z);
            let scale = -self.scale(transfer, step, z);
            staged.as_ref().unwrap_or(damped).map(|entry| entry * scale)
        });
        let elastic = factors.elastic.map(|entry| -entry * (step * step));
        MatrixFactors { mass: factors.kinetic.clone(), stiffness: elastic, damping: damped.collect() }
    }

    /// Coefficients of a force f e^{iωt} in the equations at z = e^{−iωh}: A(z) v + h² Σ_i b_i ψ_ν(c_i)
    /// z^{1−c_i} f = 0.
    pub(crate) fn forcing(&self, step: f64, omega: f64) -> Vec<Complex<f64>> {
        let Polynomials { nodes, weights, values, .. } = &self.polynomials;
        let turned = |fraction: f64| {
            let angle = omega * step * fraction;
            Complex::new(libm::cos(angle), -libm::sin(angle))
        };
        let tests = self.wide(values, [turned(0.0), turned(1.0)]);
        let at = |nu: usize| -> Complex<f64> {
            let nodes = nodes.iter().zip(weights).enumerate();
            nodes.map(|(i, (node, weight))| tests[(i, nu)] * turned(1.0 - node) * *weight).sum()
        };
        (0..self.degree).map(|nu| at(nu) * (step * step)).collect()
    }

    /// Factor of a damping term that depends on h: h^{2−β}, or h² K(γ_p(z)/h).
    fn scale(&self, transfer: &TransferFunction, step: f64, z: Complex<f64>) -> Complex<f64> {
        match (transfer.exponent(), &self.form) {
            (Some(order), _) => Complex::new(libm::pow(step, 2.0 - order), 0.0),
            (None, Form::MainNodes(rule) | Form::Nodes(rule)) => {
                transfer.symbol(*rule, step, z) * (step * step)
            }
            (None, Form::Stages { .. }) => Complex::new(step * step, 0.0),
        }
    }

    /// D of a transfer function other than a power at the stages: with K(Δ(z)/h) in place of Δ(z)^β.
    fn at_stages(
        &self,
        transfer: &TransferFunction,
        step: f64,
        z: Complex<f64>,
    ) -> Option<DMatrix<Complex<f64>>> {
        match (transfer.exponent(), &self.form) {
            (None, Form::Stages { inverse }) => {
                let delta = symbol::difference(inverse, z) / Complex::new(step, 0.0);
                Some(self.between_stages(symbol::function_of(&delta, |s| transfer.value(s)), z))
            }
            _ => None,
        }
    }

    /// Σ_i b_i ψ_ν(c_i) Σ_j X_ij φ_μ(c_j)
    fn between_stages(&self, matrix: DMatrix<Complex<f64>>, z: Complex<f64>) -> DMatrix<Complex<f64>> {
        let Polynomials { weights, values, .. } = &self.polynomials;
        let one = Complex::new(1.0, 0.0);
        let mut tests = self.wide(values, [one, z]);
        for (mut row, &weight) in tests.row_iter_mut().zip(weights) {
            row *= Complex::new(weight, 0.0);
        }
        tests.transpose() * matrix * self.wide(values, [z, one])
    }

    /// Combines the rows and columns of the ends 0 and 1 to those of ψ₀ and φ₀.
    fn wide(&self, to: &DMatrix<f64>, [left, right]: [Complex<f64>; 2]) -> DMatrix<Complex<f64>> {
        let one = Complex::new(1.0, 0.0);
        DMatrix::from_fn(to.nrows(), self.degree, |row, mu| match mu {
            0 => left * to[(row, 0)] + right * to[(row, 1)],
            _ => one * to[(row, mu + 1)],
        })
    }

    fn factors(&self, z: Complex<f64>) -> Rc<Factors> {
        let place = [z.re.to_bits(), z.im.to_bits()];
        if let Some(factors) = self.known.borrow().get(&place) {
            return Rc::clone(factors);
        }
        let factors = Rc::new(self.factors_at(z));
        self.known.borrow_mut().insert(place, Rc::clone(&factors));
        factors
    }

    fn factors_at(&self, z: Complex<f64>) -> Factors {
        let Polynomials { kinetic, elastic, viscous, .. } = &self.polynomials;
        let one = Complex::new(1.0, 0.0);
        let both = |products: &DMatrix<f64>, trial, test: [Complex<f64>; 2]| {
            let half = self.wide(products, trial);
            DMatrix::from_fn(self.degree, self.degree, |nu, mu| match nu {
                0 => test[0] * half[(0, mu)] + test[1] * half[(1, mu)],
                _ => half[(nu + 1, mu)],
            })
        };
        // φ̇₀ = 1 − z and ψ̇₀ = z − 1 directly, since sums would lose the digits of slow motions.
        let kinetic = both(kinetic, [Complex::ZERO, one - z], [Complex::ZERO, z - one]);
        let elastic = both(elastic, [z, one], [one, z]);
        let viscous = both(viscous, [Complex::ZERO, one - z], [one, z]);
        let damped = self.transfers.iter().map(|transfer| match &self.form {
            Form::MainNodes(rule) => {
                let mut only = DMatrix::zeros(self.degree, self.degree);
                only[(0, 0)] = transfer.exponent().map_or(z, |order| z * symbol::multistep(*rule, order, z));
                only
            }
            Form::Nodes(rule) => match transfer.exponent() {
                Some(order) => &elastic * symbol::multistep(*rule, order, z),
                None => elastic.clone(),
            },
            Form::Stages { inverse } => {
                // Other transfer functions depend on the step.
                let power = transfer.exponent().map(|order| symbol::runge_kutta(inverse, order, z));
                power.map_or_else(|| DMatrix::zeros(0, 0), |power| self.between_stages(power, z))
            }
        });
        let damped = damped.collect();
        Factors { kinetic, viscous, elastic, damped }
    }
}

/// ln det of a matrix given row by row, by elimination with column pivots; `None` if it is zero or not
/// finite.
pub(crate) fn log_determinant(matrix: &mut [Complex<f64>], rows: usize) -> Option<Complex<f64>> {
    let mut sum = Complex::ZERO;
    for column in 0..rows {
        let size = |row: usize| matrix[row * rows + column].norm_sqr();
        let pivot_row = (column..rows).max_by(|&a, &b| size(a).total_cmp(&size(b)))?;
        let pivot = matrix[pivot_row * rows + column];
        if pivot == Complex::ZERO || !(pivot.re.is_finite() && pivot.im.is_finite()) {
            return None;
        }
        sum += Complex::new(libm::log(pivot.norm()), libm::atan2(pivot.im, pivot.re));
        if pivot_row != column {
            sum.im += std::f64::consts::PI;
            for j in column..rows {
                matrix.swap(pivot_row * rows + j, column * rows + j);
            }
        }
        let (above, below) = matrix.split_at_mut((column + 1) * rows);
        let pivots = &above[column * rows + column + 1..];
        let inverse = pivot.inv();
        for row in below.chunks_exact_mut(rows) {
            let factor = row[column] * inverse;
            if factor != Complex::ZERO {
                row[column + 1..].iter_mut().zip(pivots).for_each(|(entry, pivot)| *entry -= factor * pivot);
            }
        }
    }
    Some(sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_logarithm_of_a_determinant_with_exchanged_rows() {
        // det [0 2i; 3 1] = −6i.
        let entry = Complex::new;
        let mut matrix = [entry(0.0, 0.0), entry(0.0, 2.0), entry(3.0, 0.0), entry(1.0, 0.0)];
        let found = log_determinant(&mut matrix, 2).unwrap();
        assert!((found.re - 6f64.ln()).abs() < 1e-15);
        assert!((found.im.sin() + 1.0).abs() < 1e-15);
        assert_eq!(log_determinant(&mut [entry(0.0, 0.0); 4], 2), None);
    }
}
