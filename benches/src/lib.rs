//! What the benchmarks in `benches/` share.
#![forbid(unsafe_code)]

use fvi_core::{
    BdfOrder, Coefficients, Damping, DampingTerm, Derivative, Fixed, FixedDirect, Galerkin, Integrator,
    Kernel, Mass, NoForce, Potential, System, leading_bdf_weight, monic_bdf_table,
};
use nalgebra::{SMatrix, SVector};

/// A slow oscillation with noise, the same in every run.
pub fn noise(count: usize) -> Vec<f64> {
    fvi_fft::baseline::Signal::Stationary.samples(1, count)
}

/// Samples that the memory of [`short_memory_damping`] keeps.
pub const HISTORY: usize = 256;

const STEP_SIZE: f64 = 0.01;

static WEIGHTS: [f64; HISTORY + 1] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);

/// Damping of order ½ on the latest 256 samples.
pub type ShortMemoryDamping<const N: usize> =
    DampingTerm<f64, Fixed<N>, FixedDirect<'static, f64, N, HISTORY>>;

/// A [`ShortMemoryDamping`] without samples.
pub fn short_memory_damping<const N: usize>() -> ShortMemoryDamping<N> {
    let scale = leading_bdf_weight(BdfOrder::GRUNWALD_LETNIKOV, 0.5, STEP_SIZE).expect("in range");
    let memory = FixedDirect::<f64, N, HISTORY>::short_memory(&WEIGHTS, scale).expect("good weights");
    let rho = Coefficients::Diagonal(SVector::repeat(1e-3));
    DampingTerm::new(Kernel::given(0.5).expect("an order in range"), rho, Derivative::Caputo, memory)
        .expect("good damping")
}

/// Pendulums, each tied to its neighbours by a spring.
pub struct PendulumChain;

impl<const N: usize> Potential<f64, N> for PendulumChain {
    fn value(&self, q: &SVector<f64, N>) -> f64 {
        let hanging: f64 = q.iter().map(|q| -q.cos()).sum();
        hanging + q.as_slice().windows(2).map(|pair| 0.5 * (pair[1] - pair[0]).powi(2)).sum::<f64>()
    }

    fn gradient(&self, q: &SVector<f64, N>) -> SVector<f64, N> {
        let mut gradient = q.map(f64::sin);
        for i in 1..N {
            let pull = q[i] - q[i - 1];
            gradient[i] += pull;
            gradient[i - 1] -= pull;
        }
        gradient
    }

    fn hessian(&self, q: &SVector<f64, N>) -> SMatrix<f64, N, N> {
        let mut hessian = SMatrix::from_diagonal(&q.map(f64::cos));
        for i in 1..N {
            hessian[(i, i)] += 1.0;
            hessian[(i - 1, i - 1)] += 1.0;
            hessian[(i, i - 1)] -= 1.0;
            hessian[(i - 1, i)] -= 1.0;
        }
        hessian
    }
}

/// The integrator of [`pendulum_chain`].
pub type ChainIntegrator<D, const N: usize> =
    Integrator<f64, Fixed<N>, System<f64, N, PendulumChain, NoForce>, Galerkin<f64, 1, 1>, D>;

/// A chain of pendulums, each let go one radian from where it hangs; low order with κ = ½.
pub fn pendulum_chain<D: Damping<f64, Fixed<N>>, const N: usize>(damping: D) -> ChainIntegrator<D, N> {
    let system = System {
        mass: Mass::diagonal([1.0; N]).expect("positive"),
        potential: PendulumChain,
        force: NoForce,
    };
    let scheme = Galerkin::low_order(0.5).expect("in range");
    Integrator::builder(system, scheme, STEP_SIZE)
        .damping(damping)
        .position(SVector::repeat(1.0))
        .momentum(SVector::zeros())
        .build()
        .expect("good problem")
}
