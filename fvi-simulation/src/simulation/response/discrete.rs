//! The equations of a step for harmonic motions, for every scheme on equal steps.

use crate::simulation::stability::characteristic::{Characteristic, MatrixFactors};
use crate::simulation::stability::{DampingForm, discretisation, stages_of_family, symbol};
use fvi_core::{BdfOrder, GaussLobatto};
use fvi_fft::dense;
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::transfer::TransferFunction;
use fvi_scenario::scenario::{Scenario, Scheme};
use nalgebra::{Complex, DMatrix};

/// The coefficients of M, K and the ρ_m in the equations of a harmonic motion, those of the force, and those
/// of the unknown vectors in the response.
pub(super) struct SchemeFactors {
    pub(super) mass: DMatrix<Complex<f64>>,
    pub(super) stiffness: DMatrix<Complex<f64>>,
    pub(super) damping: Vec<DMatrix<Complex<f64>>>,
    pub(super) load: Vec<Complex<f64>>,
    pub(super) answer: Vec<Complex<f64>>,
}

impl SchemeFactors {
    /// Adds the matrices, multiplied by their coefficients, to a matrix given row by row.
    pub(super) fn add_to(
        &self,
        matrix: &mut [Complex<f64>],
        mass: &DMatrix<f64>,
        stiffness: &DMatrix<f64>,
        damping: &[DMatrix<f64>],
    ) {
        let factors = MatrixFactors {
            mass: self.mass.clone(),
            stiffness: self.stiffness.clone(),
            damping: self.damping.clone(),
        };
        factors.add_to(matrix, mass, stiffness, damping);
    }
}

/// The equations of a step.
pub(super) enum StepEquations {
    /// On polynomials, with the characteristic function of the stability check.
    Polynomials { characteristic: Box<Characteristic>, degree: usize },
    /// M Δ(z)²/h² + K + Σ ρ_m K_m(Δ(z)/h) at the stages of a Runge–Kutta method.
    Collocation { inverse: DMatrix<f64>, nodes: Vec<f64>, transfers: Vec<TransferFunction> },
    /// q_{k+1} − 2 q_k + q_{k−1} = h² M⁻¹ (forces at q_{k−1}, damping at q_k; or both at q_{k+1}).
    Euler { explicit: bool, order: BdfOrder, transfers: Vec<TransferFunction> },
    /// Gauss's method, with its weights.
    Gauss(Box<GaussModes>),
    /// The same with loaded constraints that are curved.
    GaussLobatto { rule: Box<GaussLobatto<f64>>, transfers: Vec<TransferFunction> },
}

impl StepEquations {
    /// The equations for a scenario, in which constraints may resist like springs.
    ///
    /// # Errors
    /// A message, for different steps.
    pub(super) fn of(
        scenario: &Scenario,
        transfers: &[TransferFunction],
        is_bent: bool,
    ) -> Result<Self, String> {
        if scenario.time.grid.is_some() {
            return Err("a scheme has a frequency response on equal steps only".to_owned());
        }
        if scenario.convolution.family.is_staged()
            && transfers.iter().any(|transfer| transfer.table().is_some())
        {
            return Err("weights of a file are none of a Runge–Kutta family".to_owned());
        }
        let transfers = transfers.to_vec();
        if let Some(discretisation) = discretisation(scenario) {
            let characteristic = Box::new(Characteristic::new(&discretisation, transfers));
            return Ok(Self::Polynomials { characteristic, degree: discretisation.degree });
        }
        let family = scenario.convolution.family;
        match (scenario.scheme, family) {
            // Discrete gradients take constraints at the node of the midpoint rule.
            (Scheme::Galerkin { .. }, ConvolutionFamily::Gauss { stages }) if is_bent => {
                let rule = Box::new(GaussLobatto::new(stages).map_err(|error| error.to_string())?);
                Ok(Self::GaussLobatto { rule, transfers })
            }
            (_, ConvolutionFamily::Gauss { stages }) => Ok(Self::Gauss(Box::new(GaussModes::new(stages)?))),
            (Scheme::ExplicitEuler | Scheme::ImplicitEuler, ConvolutionFamily::Bdf { order }) => {
                let explicit = scenario.scheme == Scheme::ExplicitEuler;
                let order = BdfOrder::new(order).map_err(|error| error.to_string())?;
                Ok(Self::Euler { explicit, order, transfers })
            }
            _ => {
                let stages = stages_of_family(family);
                let Some((DampingForm::Stages { matrix }, (nodes, _))) = stages else {
                    return Err("this scheme has no shape that is known".to_owned());
                };
                let inverse = dense::inverse(matrix).ok_or("the method has no inverse")?;
                Ok(Self::Collocation { inverse, nodes, transfers })
            }
        }
    }

    /// Number of unknown vectors of a step.
    pub(super) fn nodes(&self) -> usize {
        match self {
            Self::Polynomials { degree, .. } => *degree,
            Self::Collocation { nodes, .. } => nodes.len(),
            Self::GaussLobatto { rule, .. } => rule.stages(),
            Self::Euler { .. } | Self::Gauss(_) => 1,
        }
    }

    /// The coefficients at a frequency and step; `None` for Gauss's method, which has [`GaussModes`].
    pub(super) fn factors(&self, step: f64, omega: f64) -> Option<SchemeFactors> {
        let turned = |fraction: f64| {
            let angle = omega * step * fraction;
            Complex::new(libm::cos(angle), -libm::sin(angle))
        };
        let z = turned(1.0);
        Some(match self {
            Self::Gauss(_) => return None,
            Self::Polynomials { characteristic, .. } => {
                let MatrixFactors { mass, stiffness, damping } = characteristic.factors_of_matrices(step, z);
                let load: Vec<_> =
                    characteristic.forcing(step, omega).into_iter().map(|load| -load).collect();
                let answer = only(0, load.len());
                SchemeFactors { mass, stiffness, damping, load, answer }
            }
            Self::GaussLobatto { rule, transfers } => of_knots(rule, transfers, step, omega),
            Self::Collocation { inverse, nodes, transfers } => {
                let delta = symbol::difference(inverse, z) / Complex::new(step, 0.0);
                let damping = transfers.iter().map(|transfer| match transfer.exponent() {
                    Some(order) => {
                        symbol::runge_kutta(inverse, order, z) / Complex::new(libm::pow(step, order), 0.0)
                    }
                    None => symbol::function_of(&delta, |s| transfer.value(s)),
                });
                SchemeFactors {
                    mass: &delta * &delta,
                    stiffness: DMatrix::identity(nodes.len(), nodes.len()),
                    damping: damping.collect(),
                    load: nodes.iter().map(|node| turned(1.0 - node)).collect(),
                    answer: only(nodes.len() - 1, nodes.len()),
                }
            }
            Self::Euler { explicit, order, transfers } => {
                let one = |entry: Complex<f64>| DMatrix::from_element(1, 1, entry);
                let squared = Complex::new(step * step, 0.0);
                let (elastic, resisting) = match explicit {
                    true => (z * squared, squared),
                    false => (squared / z, squared / z),
                };
                let damped = transfers.iter().map(|transfer| {
                    let value = match transfer.exponent() {
                        Some(beta) => symbol::multistep((*order).into(), beta, z) / libm::pow(step, beta),
                        None => transfer.symbol((*order).into(), step, z),
                    };
                    one(resisting * value)
                });
                SchemeFactors {
                    mass: one(z.inv() - 2.0 + z),
                    stiffness: one(elastic),
                    damping: damped.collect(),
                    load: vec![elastic],
                    answer: only(0, 1),
                }
            }
        })
    }
}

/// The coefficients of a response that is one of the unknown vectors.
pub(super) fn only(index: usize, count: usize) -> Vec<Complex<f64>> {
    (0..count).map(|place| Complex::new(f64::from(u8::from(place == index)), 0.0)).collect()
}

/// Harmonic motions of Gauss's method whose constraints hold at Lobatto's knots.
///
/// With ζ = e^{iωh}, B = A + 1bᵀ/(ζ − 1), B̃ = Ã + 1bᵀ/(ζ − 1), B̂ = Â + 1b̃ᵀ/(ζ − 1) and the curvature
/// K_c = Σ λ_k ∂²c_k of the constraints, which act at the knots, the velocities V at the nodes satisfy, on
/// the kernel of C,
///
/// ```text
/// M V + h²B² (K − K_c + Σ ρ_m K_m(B⁻¹/h)) V + h² B̂B̃ K_c V = h B e^{iωhc} ,     H_h(ω) = h bᵀV/(ζ − 1) .
/// ```
///
/// The last matrix of the damping is K_c, the part K_c of K included in K.
fn of_knots(
    rule: &GaussLobatto<f64>,
    transfers: &[TransferFunction],
    step: f64,
    omega: f64,
) -> SchemeFactors {
    let (s, h) = (rule.stages(), Complex::new(step, 0.0));
    let turned = |fraction: f64| {
        let angle = omega * step * fraction;
        Complex::new(libm::cos(angle), libm::sin(angle))
    };
    let earlier = (turned(1.0) - 1.0).inv();
    let with_earlier = |now: f64, weight: f64| now + weight * earlier;
    let nodes = DMatrix::from_fn(s, s, |i, j| h * with_earlier(rule.matrix(i, j), rule.weight(j)));
    let to_knots = DMatrix::from_fn(s + 1, s, |j, k| h * with_earlier(rule.at_knot(j, k), rule.weight(k)));
    let of_knots =
        DMatrix::from_fn(s, s + 1, |i, j| h * with_earlier(rule.conjugate(i, j), rule.knot_weight(j)));
    let squared = &nodes * &nodes;
    let force = |transfer: &TransferFunction| {
        symbol::function_of(&nodes, |interval| interval * interval * transfer.value(interval.inv()))
    };
    let mut damping: Vec<_> = transfers.iter().map(force).collect();
    damping.push(of_knots * to_knots - &squared);
    let load = (0..s).map(|i| (0..s).map(|j| nodes[(i, j)] * turned(rule.node(j))).sum());
    SchemeFactors {
        mass: DMatrix::identity(s, s),
        stiffness: squared,
        damping,
        load: load.collect(),
        answer: (0..s).map(|i| h * rule.weight(i) * earlier).collect(),
    }
}

/// Harmonic motions of Gauss's method with s stages.
///
/// Its step of x' = λx multiplies by R(λh) = N(λh)/N(−λh). The motions that turn by θ = ωh in a step are
/// those of R(iy) = e^{iθ}, which has s real roots y_r, one of them near θ. So the response of a linear
/// system is one of the continuous system at the frequencies y_r/h,
///
/// ```text
/// H_h(ω) = Σ_r w_r H(y_r/h) ,     w_r = e^{iθ} Σ_i ℓ_i e^{−iθ(1 − c_i)} / Σ_i ℓ_i m_i ,
/// ℓᵀ = bᵀ(I − iy_r A)⁻¹ ,   m = (I − iy_r A)⁻¹ 1 ,
/// ```
///
/// since the equations at the nodes are functions of one matrix Δ, of which ℓ and m are the left and right
/// eigenvectors.
pub(super) struct GaussModes {
    rule: GaussLobatto<f64>,
    /// N, the coefficient of x^j at j.
    numerator: Vec<f64>,
}

impl GaussModes {
    fn new(stages: usize) -> Result<Self, String> {
        let rule = GaussLobatto::new(stages).map_err(|error| error.to_string())?;
        let mut numerator = vec![1.0];
        for j in 0..stages {
            let [s, j] = [stages as f64, j as f64];
            let last = numerator[numerator.len() - 1];
            numerator.push(last * (s - j) / ((2.0 * s - j) * (j + 1.0)));
        }
        Ok(Self { rule, numerator })
    }

    /// The frequencies y_r/h and the weights w_r; `None` if a root is not found.
    pub(super) fn at(&self, step: f64, omega: f64) -> Option<Vec<(f64, Complex<f64>)>> {
        let angle = omega * step;
        self.roots(angle)?.into_iter().map(|y| Some((y / step, self.weight(angle, y)?))).collect()
    }

    /// The real roots of Im(e^{−iθ/2} N(iy)).
    fn roots(&self, angle: f64) -> Option<Vec<f64>> {
        let (sine, cosine) = (libm::sin(0.5 * angle), libm::cos(0.5 * angle));
        let of_power = |(j, n): (usize, &f64)| match j % 4 {
            0 => -sine * n,
            1 => cosine * n,
            2 => sine * n,
            _ => -cosine * n,
        };
        let polynomial: Vec<f64> = self.numerator.iter().enumerate().map(of_power).collect();
        let (&leading, lower) = polynomial.split_last()?;
        let count = lower.len();
        let companion = DMatrix::from_fn(count, count, |row, column| match column + 1 == count {
            true => -lower[row] / leading,
            false => f64::from(u8::from(row == column + 1)),
        });
        let near = dense::eigenvalues(companion)?;
        let refined = near.into_iter().map(|near| {
            let mut y = near.re;
            for _ in 0..8 {
                let value = polynomial.iter().rev().fold(0.0, |sum, c| sum * y + c);
                let powers = polynomial.iter().enumerate().skip(1).rev();
                let slope = powers.fold(0.0, |sum, (j, c)| sum * y + j as f64 * c);
                let change = value / slope;
                if !change.is_finite() {
                    return None;
                }
                y -= change;
            }
            Some(y)
        });
        refined.collect()
    }

    fn weight(&self, angle: f64, y: f64) -> Option<Complex<f64>> {
        let stages = self.rule.stages();
        let turned = |angle: f64| Complex::new(libm::cos(angle), libm::sin(angle));
        let entry =
            |i: usize, j: usize| Complex::new(f64::from(u8::from(i == j)), -y * self.rule.matrix(i, j));
        let matrix: Vec<_> =
            (0..stages).flat_map(|i| (0..stages).map(move |j| (i, j))).map(|(i, j)| entry(i, j)).collect();
        let transposed: Vec<_> =
            (0..stages).flat_map(|i| (0..stages).map(move |j| (j, i))).map(|(i, j)| entry(i, j)).collect();
        let mut left: Vec<_> = (0..stages).map(|i| Complex::new(self.rule.weight(i), 0.0)).collect();
        let mut right = vec![Complex::new(1.0, 0.0); stages];
        dense::solve_complex(&mut transposed.clone(), &mut left)?;
        dense::solve_complex(&mut matrix.clone(), &mut right)?;
        let force = |i: usize| turned(-angle * (1.0 - self.rule.node(i)));
        let forced: Complex<f64> = left.iter().enumerate().map(|(i, l)| l * force(i)).sum();
        let whole: Complex<f64> = left.iter().zip(&right).map(|(l, m)| l * m).sum();
        Some(turned(angle) * forced / whole)
    }
}
