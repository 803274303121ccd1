//! Damping at the stages of a Runge–Kutta convolution quadrature, on direct memories.

use fvi_core::{Coefficients, DampingTerm, Derivative, Direct, Fixed, Kernel, Overflow, RungeKutta};
use fvi_fft::quadrature::runge_kutta_weights::RungeKuttaWeights;
use heapless::Deque;

type StageRing = Deque<f64, 4100>;

/// A direct memory with any number of channels and stages.
pub type StageMemory = Direct<f64, Vec<f64>, Vec<StageRing>, StageRing>;

/// A direct memory for D^`exponent` at the stages of N coordinates, with room for `count` steps.
pub fn stage_memory<const N: usize, const R: usize>(
    method: &RungeKutta<R>,
    exponent: f64,
    step_size: f64,
    count: usize,
) -> StageMemory {
    let weights = RungeKuttaWeights::new(method, exponent, step_size, count).expect("good weights");
    let rings = vec![StageRing::new(); N * R];
    Direct::new(weights.planes(), R, 1.0, rings, Overflow::Refuse).expect("a good memory")
}

/// A damping term at the stages.
pub fn stage_term<const N: usize, const R: usize>(
    method: &RungeKutta<R>,
    coefficients: Coefficients<f64, N>,
    damping_order: f64,
    derivative: Derivative,
    step_size: f64,
    count: usize,
) -> DampingTerm<f64, Fixed<N>, StageMemory> {
    let memory = stage_memory::<N, R>(method, damping_order, step_size, count);
    DampingTerm::new(
        Kernel::given(damping_order).expect("an order in range"),
        coefficients,
        derivative,
        memory,
    )
    .expect("good damping")
}
