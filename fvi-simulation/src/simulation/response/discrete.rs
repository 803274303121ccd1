//! The equations of a step for harmonic motions, for every scheme on equal steps.

use crate::simulation::stability::characteristic::{Characteristic, MatrixFactors};
use crate::simulation::stability::{DampingForm, discretisation, stages_of_family, symbol};
use fvi_core::BdfOrder;
use fvi_fft::dense;
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::transfer::TransferFunction;
use fvi_scenario::scenario::{Scenario, Scheme};
use nalgebra::{Complex, DMatrix};

/// The coefficients of M, K and the ρ_m in the equations of a harmonic motion, those of the force, and the
/// index of the unknown vector that is the response.
pub(super) struct SchemeFactors {
    pub(super) mass: DMatrix<Complex<f64>>,
    pub(super) stiffness: DMatrix<Complex<f64>>,
    pub(super) damping: Vec<DMatrix<Complex<f64>>>,
    pub(super) load: Vec<Complex<f64>>,
    pub(super) answer: usize,
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
}

impl StepEquations {
    /// The equations for a scenario.
    ///
    /// # Errors
    /// A message, for different steps.
    pub(super) fn of(scenario: &Scenario, transfers: &[TransferFunction]) -> Result<Self, String> {
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
            Self::Euler { .. } => 1,
        }
    }

    /// The coefficients at a frequency and step.
    pub(super) fn factors(&self, step: f64, omega: f64) -> SchemeFactors {
        let turned = |fraction: f64| {
            let angle = omega * step * fraction;
            Complex::new(libm::cos(angle), -libm::sin(angle))
        };
        let z = turned(1.0);
        match self {
            Self::Polynomials { characteristic, .. } => {
                let MatrixFactors { mass, stiffness, damping } = characteristic.factors_of_matrices(step, z);
                let load = characteristic.forcing(step, omega).into_iter().map(|load| -load).collect();
                SchemeFactors { mass, stiffness, damping, load, answer: 0 }
            }
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
                    answer: nodes.len() - 1,
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
                    answer: 0,
                }
            }
        }
    }
}
