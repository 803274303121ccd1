//! Everything a controller calls, compiled without `std`. The panic handler calls a function that does not exist: if
//! the optimiser cannot prove it unreachable, its name stays among the undefined symbols of the library.
#![no_std]

use core::panic::PanicInfo;

use fvi_core::{
    BdfOrder, Coefficients, ConvolutionWeights, DampingTerm, Derivative, ExplicitDamping, ExponentialSum,
    ExponentialTable, Fixed, FixedDirect, FractionalOperator, Galerkin, ImplicitEuler, Integrator, Kernel,
    Mass, Memory, NoForce, Overflow, Potential, Quadratic, Real, Scheme, Stability, Start, System, Tiled,
    check_stability, leading_bdf_weight, monic_bdf_table,
};
use nalgebra::{SMatrix, SVector};

unsafe extern "C" {
    fn fvi_reachable_panic() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    unsafe { fvi_reachable_panic() }
}

const HISTORY: usize = 64;
static WEIGHTS: [f64; HISTORY] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);

/// A pendulum in every coordinate, without calls to the platform.
struct Pendulums;

impl<T: Real, const N: usize> Potential<T, N> for Pendulums {
    fn value(&self, position: &SVector<T, N>) -> T {
        position.iter().fold(T::zero(), |sum, &q| sum + q * q)
    }

    fn gradient(&self, position: &SVector<T, N>) -> SVector<T, N> {
        position.map(|q| q + q * q * q)
    }

    fn hessian(&self, position: &SVector<T, N>) -> SMatrix<T, N, N> {
        SMatrix::from_diagonal(&position.map(|q| T::one() + T::of(3.0) * q * q))
    }
}

fn run<T: Real, S: Scheme<T, Fixed<2>>>(scheme: S, table: &[T], numbers: &[f64; 8]) -> Option<T> {
    let [mass, rho, beta, h, q, p, u, scale] = numbers.map(T::of);
    let system = System {
        mass: Mass::dense(SMatrix::from([[mass, u], [u, mass]])).ok()?,
        potential: Pendulums,
        force: NoForce,
    };
    let memory = FixedDirect::<T, 2, HISTORY>::full_memory(table, scale).ok()?;
    let short = FixedDirect::<T, 2, HISTORY>::short_memory(table, scale).ok()?;
    let coefficients = Coefficients::Dense(SMatrix::from([[rho, u], [u, rho]]));
    let damping = (
        DampingTerm::new(Kernel::given(beta.to_f64()).ok()?, coefficients, Derivative::Caputo, memory)
            .ok()?,
        DampingTerm::new(
            Kernel::given(beta.to_f64()).ok()?,
            coefficients,
            Derivative::RiemannLiouville,
            short,
        )
        .ok()?,
    );
    let start = (SVector::from([q, p]), SVector::from([p, q]));
    let mut integrator = Integrator::builder(system, scheme, h)
        .damping(damping)
        .position(start.0)
        .momentum(start.1)
        .build()
        .ok()?;
    integrator.step(&SVector::from([u, u])).ok()?;
    Some(integrator.energy())
}

/// A memory of exponentials for tables, channels and numbers that the compiler does not know.
fn exponentials<T: Real>(table: &[T], stages: usize, channels: usize, samples: &[T; 4]) -> Option<T> {
    let exponentials = table.get(8..24)?;
    let table =
        ExponentialTable { stages, head: table.get(..8)?, exponentials, slow_blocks: 1, horizon: HISTORY };
    let mut state = [T::zero(); 128];
    let state = state.get_mut(..table.state_len(channels))?;
    let mut memory = ExponentialSum::new(table, T::one(), channels, state).ok()?;
    let mut term = [T::zero(); 4];
    for _ in 0..2 {
        memory.next_term(term.get_mut(..channels)?).ok()?;
        memory.push(samples.get(..channels)?).ok()?;
    }
    let leading = memory.leading().first().copied()?;
    memory.clear();
    Some(term.iter().fold(leading, |sum, &term| sum + term))
}

/// Runs everything on numbers that the compiler does not know.
#[unsafe(no_mangle)]
pub extern "C" fn probe(numbers: &[f64; 8], order: usize) -> f64 {
    let [mass, rho, beta, h, kappa, ..] = *numbers;
    let all = || -> Option<f64> {
        let bdf_order = BdfOrder::new(order).ok()?;
        let mut table = [0.0; HISTORY];
        let mut single = [0f32; HISTORY];
        ConvolutionWeights::bdf(bdf_order, beta, h).ok()?.fill(&mut table);
        ConvolutionWeights::bdf(bdf_order, beta, h).ok()?.fill(&mut single);
        let energy = run(Galerkin::low_order(kappa).ok()?, &table, numbers)?
            + run(ImplicitEuler, &WEIGHTS, numbers)?
            + f64::from(run(Galerkin::low_order(kappa as f32).ok()?, &single, numbers)?);
        let scale = leading_bdf_weight(bdf_order, beta, h).ok()?;
        let memory = FixedDirect::<f64, 1, HISTORY>::short_memory(&WEIGHTS, scale).ok()?;
        let mut operator = FractionalOperator::new(memory, Start::Caputo).ok()?;
        let tiled = Tiled::<f64, 1, 4>::new(&WEIGHTS, scale, Overflow::Forget).ok()?;
        let mut tiled = FractionalOperator::new(tiled, Start::Caputo).ok()?;
        let derivative = operator.push(mass).ok()? + operator.push(rho).ok()? + tiled.push(mass).ok()?;
        let derivative = derivative
            + exponentials(&table, order, order, &[mass, rho, beta, h])?
            + f64::from(exponentials(&single, order, 2 * order, &[mass as f32; 4])?);
        let terms = [ExplicitDamping {
            coefficients: Coefficients::Diagonal([rho].into()),
            damping_order: beta,
            bdf_order,
        }];
        let spring = Quadratic::diagonal([mass]).ok()?;
        let stiffness = spring.hessian(&[kappa].into());
        let mass = Mass::diagonal([mass]).ok()?;
        match check_stability(&Galerkin::low_order(kappa).ok()?, &mass, &stiffness, &terms, h).ok()? {
            Stability::Stable => Some(energy + derivative),
            Stability::Unstable { largest_stable_step } => Some(largest_stable_step),
        }
    };
    all().unwrap_or(-1.0)
}

/// An index that may be out of bounds: its panic must show.
#[cfg(feature = "seeded-panic")]
#[unsafe(no_mangle)]
pub extern "C" fn seeded(index: usize) -> f64 {
    WEIGHTS[index]
}
