//! Runs of the integrator on test problems, with everything kept.

use fvi_core::{
    BdfOrder, Coefficients, ConvolutionWeights, Damping, DampingTerm, Derivative, Fixed, FixedDirect, Force,
    Integrator, Kernel, Potential, Scheme, StepError, System,
};
use nalgebra::{SMatrix, SVector};

/// Samples that the memories of the tests hold.
pub const CAPACITY: usize = 8200;

/// A damping term on a full direct memory.
pub type Term<'w, const N: usize> = DampingTerm<f64, Fixed<N>, FixedDirect<'w, f64, N, CAPACITY>>;

/// Weights of D^`exponent` for the first `count` lags.
pub fn weights(order: usize, exponent: f64, step_size: f64, count: usize) -> Vec<f64> {
    let order = BdfOrder::new(order).expect("an order from 1 to 6");
    ConvolutionWeights::bdf(order, exponent, step_size).expect("an exponent in range").take(count).collect()
}

/// A damping term with the given weights of D^`damping_order`.
pub fn term<'w, const N: usize>(
    coefficients: Coefficients<f64, N>,
    damping_order: f64,
    derivative: Derivative,
    weights: &'w [f64],
) -> Term<'w, N> {
    let memory = FixedDirect::full_memory(weights, 1.0).expect("good weights");
    DampingTerm::new(
        Kernel::given(damping_order).expect("an order in range"),
        coefficients,
        derivative,
        memory,
    )
    .expect("good damping")
}

/// Equal diagonal coefficients.
pub fn diagonal<const N: usize>(entry: f64) -> Coefficients<f64, N> {
    Coefficients::Diagonal(SVector::repeat(entry))
}

/// A trajectory with its energy, from t = 0.
pub struct Motion<const N: usize> {
    /// t_k.
    pub times: Vec<f64>,
    /// q_k.
    pub positions: Vec<SVector<f64, N>>,
    /// p_k.
    pub momenta: Vec<SVector<f64, N>>,
    /// E_k.
    pub energies: Vec<f64>,
}

impl<const N: usize> Motion<N> {
    /// First coordinate of every position.
    pub fn first_positions(&self) -> Vec<f64> {
        self.positions.iter().map(|q| q[0]).collect()
    }

    /// First component of every momentum.
    pub fn first_momenta(&self) -> Vec<f64> {
        self.momenta.iter().map(|p| p[0]).collect()
    }
}

/// Integrates `steps` steps without input.
///
/// # Errors
/// The error of the first step that fails.
pub fn integrate<const N: usize, P, F, S, D>(
    system: System<f64, N, P, F>,
    scheme: S,
    damping: D,
    step_size: f64,
    start: (SVector<f64, N>, SVector<f64, N>),
    steps: usize,
) -> Result<Motion<N>, StepError>
where
    P: Potential<f64, N>,
    F: Force<f64, N>,
    S: Scheme<f64, Fixed<N>>,
    D: Damping<f64, Fixed<N>>,
{
    let mut integrator = Integrator::builder(system, scheme, step_size)
        .damping(damping)
        .position(start.0)
        .momentum(start.1)
        .build()
        .expect("a good problem");
    let mut motion = Motion { times: vec![], positions: vec![], momenta: vec![], energies: vec![] };
    for k in 0..=steps {
        if k > 0 {
            integrator.step(&SVector::zeros())?;
        }
        motion.times.push(integrator.time());
        motion.positions.push(integrator.state().position);
        motion.momenta.push(integrator.state().momentum);
        motion.energies.push(integrator.energy());
    }
    Ok(motion)
}

/// Pendulum in one coordinate: U = −g cos q.
#[derive(Clone, Copy, Debug)]
pub struct Pendulum {
    /// Weight times length, g.
    pub gravity: f64,
}

impl Potential<f64, 1> for Pendulum {
    fn value(&self, position: &SVector<f64, 1>) -> f64 {
        -self.gravity * position[0].cos()
    }

    fn gradient(&self, position: &SVector<f64, 1>) -> SVector<f64, 1> {
        SVector::from([self.gravity * position[0].sin()])
    }

    fn hessian(&self, position: &SVector<f64, 1>) -> SMatrix<f64, 1, 1> {
        SMatrix::from([[self.gravity * position[0].cos()]])
    }
}
