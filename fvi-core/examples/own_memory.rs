//! Your own memory: whatever implements [`Memory`] works with every scheme.
//!
//! Here the kernel is that of the ordinary derivative, w = (1, −1)/h: the damping ρ q̇ of an oscillator, and
//! one sample to remember.

use fvi_core::{
    Coefficients, DampingTerm, Derivative, Galerkin, Integrator, Kernel, Mass, Memory, MemoryError, NoForce,
    Quadratic, Stateful, System, check_channels,
};

/// Backward differences (x_k − x_{k−1})/h, x_{−1} = 0, for steps of any length.
struct Difference {
    leading: [f64; 1],
    last: f64,
    count: usize,
}

impl Memory<f64> for Difference {
    fn channels(&self) -> usize {
        1
    }

    fn leading(&self) -> &[f64] {
        &self.leading
    }

    fn leading_is_constant(&self) -> bool {
        false
    }

    fn len(&self) -> usize {
        self.count
    }

    fn begin_step(&mut self, length: f64) -> Result<(), MemoryError> {
        self.leading = [1.0 / length];
        Ok(())
    }

    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        check_channels(1, term.len())?;
        term[0] = -self.leading[0] * self.last;
        Ok(())
    }

    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        check_channels(1, sample.len())?;
        self.last = sample[0];
        self.count += 1;
        Ok(())
    }

    fn clear(&mut self) {
        (self.last, self.count) = (0.0, 0);
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
    }
}

impl Stateful for Difference {}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let memory = Difference { leading: [0.0], last: 0.0, count: 0 };
    // The author of the memory is responsible for its weights.
    let kernel = Kernel::given(1.0)?;
    let rho = Coefficients::Diagonal([0.2].into());
    let damping = DampingTerm::new(kernel, rho, Derivative::Caputo, memory)?;
    let system =
        System { mass: Mass::diagonal([1.0])?, potential: Quadratic::diagonal([1.0])?, force: NoForce };
    let mut integrator = Integrator::builder(system, Galerkin::low_order(0.5)?, 0.01)
        .damping(damping)
        .position([1.0])
        .build()?;
    println!("    t  position  exact");
    for step in 1..=1000 {
        integrator.step(&[0.0].into())?;
        if step % 100 == 0 {
            let (t, omega) = (integrator.time(), 0.99f64.sqrt());
            let exact = (-0.1 * t).exp() * ((omega * t).cos() + 0.1 / omega * (omega * t).sin());
            println!("{t:5.1}  {:+.5}  {exact:+.5}", integrator.state().position[0]);
        }
    }
    Ok(())
}
