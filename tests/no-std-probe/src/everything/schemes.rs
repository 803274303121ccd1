//! Schemes, dampings and the integrator.

use fvi_core::{
    BdfOrder, Coefficients, Collocation, Damping, DampingTerm, Derivative, Direct, ExplicitDamping,
    ExplicitEuler, Fixed, Force, Galerkin, ImplicitEuler, Instant, Integrator, Kernel, Mass, NoForce,
    NodeGalerkin, Outcome, Overflow, Potential, Quadratic, Quadrature, Real, RungeKutta, Scheme, Stability,
    StateReader, StateWriter, Stateful, System, TimeForce, check_stability,
};
use heapless::Deque;
use nalgebra::{SMatrix, SVector};

use super::HISTORY;

/// Quartic springs in every coordinate, without calls to the platform.
struct Springs;

impl<T: Real, const N: usize> Potential<T, N> for Springs {
    fn value(&self, position: &SVector<T, N>) -> T {
        position.iter().fold(T::zero(), |sum, &q| sum + q * q)
    }

    fn gradient(&self, position: &SVector<T, N>) -> SVector<T, N> {
        position.map(|q| q + q * q * q)
    }

    fn hessian(&self, position: &SVector<T, N>) -> SMatrix<T, N, N> {
        let diagonal = position.map(|q| T::one() + T::of(3.0) * q * q);
        Coefficients::Diagonal(diagonal).to_matrix()
    }
}

/// A force −c v³.
struct Drag<T>(T);

impl<T: Real, const N: usize> Force<T, N> for Drag<T> {
    fn value(&self, _: Instant<T>, position: &SVector<T, N>) -> SVector<T, N> {
        position * T::zero()
    }

    fn depends_on_velocity(&self) -> bool {
        true
    }

    fn value_in_motion(&self, _: Instant<T>, _: &SVector<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        velocity.map(|v| -self.0 * v * v * v)
    }

    fn velocity_jacobian(
        &self,
        _: Instant<T>,
        _: &SVector<T, N>,
        velocity: &SVector<T, N>,
    ) -> SMatrix<T, N, N> {
        Coefficients::Diagonal(velocity.map(|v| -self.0 * T::of(3.0) * v * v)).to_matrix()
    }
}

/// A step under a force of the velocity.
fn dragged<T: Real>(scheme: impl Scheme<T, Fixed<2>>, numbers: &[f64; 8]) -> Option<T> {
    let [mass, rho, _, h, q, p, u, _] = numbers.map(T::of);
    let mass = Mass::dense(SMatrix::from([[mass, u], [u, mass]])).ok()?;
    let system = System { mass, potential: Springs, force: Drag(rho) };
    let mut integrator =
        Integrator::builder(system, scheme, h).position([q, p]).momentum([p, q]).build().ok()?;
    let iterations = integrator.step(&SVector::from([u, u])).ok()?;
    Some(integrator.state().momentum.sum() + T::from_count(iterations.into()))
}

/// A step, and what an integrator tells.
fn step<T: Real>(
    scheme: impl Scheme<T, Fixed<2>>,
    damping: impl Damping<T, Fixed<2>>,
    numbers: &[f64; 8],
) -> Option<T> {
    let [mass, _, _, h, q, p, u, _] = numbers.map(T::of);
    let system = System {
        mass: Mass::dense(SMatrix::from([[mass, u], [u, mass]])).ok()?,
        potential: Springs,
        force: TimeForce(|instant: fvi_core::Instant<T>| SVector::from([instant.time, u])),
    };
    let start = (SVector::from([q, p]), SVector::from([p, q]));
    let mut integrator = Integrator::builder(system, scheme, h)
        .damping(damping)
        .start(u)
        .position(start.0)
        .momentum(start.1)
        .build()
        .ok()?;
    let (nodes, rise) = ([q; 16], [u; 2]);
    let found = Outcome { increments: &nodes, rise: &rise, kick: &rise };
    integrator.follow(h, &found, &mut [u; 16], &mut [u; 18]).ok()?;
    let iterations = integrator.step(&SVector::from([u, u])).ok()?;
    let mut velocity = SVector::from([T::zero(); 2]);
    integrator.velocity(&mut velocity);
    let told = integrator.time() + integrator.step_size() + velocity.sum();
    let mut bytes = [0; 8192];
    let mut writer = StateWriter::new(bytes.get_mut(..integrator.state_bytes())?);
    integrator.save(&mut writer).ok()?;
    let (written, skipped) = (writer.written(), numbers.len() + iterations as usize);
    let mut reader = StateReader::new(bytes.get(skipped..written)?);
    let restored = T::from_count(integrator.restore(&mut reader).is_ok().into());
    let masses = integrator.system().mass.matrix().to_matrix().sum();
    let shaped = T::from_count(integrator.damping_mut().check(2, 1, h).is_ok().into());
    Some(
        shaped
            + restored
            + integrator.energy()
            + integrator.state().momentum.sum()
            + told
            + masses
            + T::from_count(iterations.into()),
    )
}

type Ring<T> = Deque<T, HISTORY>;
type Term<'t, T, const C: usize> = DampingTerm<T, Fixed<2>, Direct<T, &'t [T], [Ring<T>; C], Ring<T>>>;

/// A term on C channels, one for each coordinate and stage.
fn term<'t, T: Real, const C: usize>(
    table: &'t [T],
    derivative: Derivative,
    numbers: &[f64; 8],
) -> Option<Term<'t, T, C>> {
    let [_, rho, beta, _, _, _, u, scale] = numbers.map(T::of);
    let rings: [Ring<T>; C] = [const { Deque::new() }; C];
    let memory = Direct::new(table, C / 2, scale, rings, Overflow::Forget).ok()?;
    let coefficients = Coefficients::Dense(SMatrix::from([[rho, u], [u, rho]]));
    let term = DampingTerm::new(Kernel::given(beta.to_f64()).ok()?, coefficients, derivative, memory).ok()?;
    let _ = term.memory().capacity();
    Some(term)
}

/// A scheme on C channels, one for each coordinate and stage: without damping, with a pair, an array and a
/// slice of terms.
fn run<T: Real, const C: usize>(
    scheme: impl Scheme<T, Fixed<2>> + Copy,
    table: &[T],
    numbers: &[f64; 8],
) -> Option<T> {
    let caputo = || term::<T, C>(table, Derivative::Caputo, numbers);
    let riemann_liouville = || term::<T, C>(table, Derivative::RiemannLiouville, numbers);
    let mut several = [caputo()?, riemann_liouville()?];
    Some(
        step(scheme, (), numbers)?
            + step(scheme, (caputo()?, riemann_liouville()?), numbers)?
            + step(scheme, [caputo()?, riemann_liouville()?], numbers)?
            + step(scheme, several.as_mut_slice(), numbers)?,
    )
}

/// Schemes of one node, in any precision.
pub fn of_one_node<T: Real>(table: &[T], numbers: &[f64; 8]) -> Option<T> {
    let kappa = T::of(numbers[4]);
    Some(
        run::<T, 2>(Galerkin::low_order(kappa).ok()?, table, numbers)?
            + run::<T, 2>(ImplicitEuler, table, numbers)?
            + run::<T, 2>(ExplicitEuler, table, numbers)?
            + dragged(Galerkin::low_order(kappa).ok()?, numbers)?
            + dragged(ExplicitEuler, numbers)?,
    )
}

/// Polynomials of degree 2 and 3, damped at the ends of the steps and at the stages.
pub fn of_higher_degree(table: &[f64], numbers: &[f64; 8]) -> Option<f64> {
    let gauss = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().ok()?).ok()?;
    let lobatto = Galerkin::<f64, 3, 4>::new(&Quadrature::lobatto().ok()?).ok()?;
    let nodes = gauss.nodes().iter().sum::<f64>() + lobatto.nodes().iter().sum::<f64>();
    let radau = NodeGalerkin::<f64, 2, 2>::with_stages(&RungeKutta::radau_iia().ok()?).ok()?;
    let lobatto_iiic = NodeGalerkin::<f64, 2, 3>::with_stages(&RungeKutta::lobatto_iiic().ok()?).ok()?;
    Some(
        nodes
            + step(gauss, term::<f64, 2>(table, Derivative::Caputo, numbers)?, numbers)?
            + step(lobatto, term::<f64, 2>(table, Derivative::Caputo, numbers)?, numbers)?
            + run::<f64, 4>(radau, table, numbers)?
            + run::<f64, 6>(lobatto_iiic, table, numbers)?
            + dragged(gauss, numbers)?
            + dragged(radau, numbers)?
            + dragged(Collocation::<f64, 2>::new(&RungeKutta::radau_iia().ok()?), numbers)?,
    )
}

/// The stability check of degree 1 and 2.
pub fn stability(numbers: &[f64; 8], bdf_order: BdfOrder) -> Option<f64> {
    let [mass, rho, damping_order, h, kappa, ..] = *numbers;
    let coefficients = Coefficients::Diagonal([rho].into());
    let terms = [ExplicitDamping { coefficients, damping_order, bdf_order }];
    let spring = Quadratic::diagonal([mass]).ok()?;
    let stiffness = spring.hessian(&[kappa].into());
    let mass = Mass::diagonal([mass]).ok()?;
    let energy = System { mass, potential: spring, force: NoForce }.energy(&[kappa].into(), &[rho].into());
    let second = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().ok()?).ok()?;
    let verdicts = [
        check_stability(&Galerkin::low_order(kappa).ok()?, &mass, &stiffness, &terms, h).ok()?,
        check_stability(&second, &mass, &stiffness, &terms, h).ok()?,
    ];
    let limit = |verdict: &Stability| match *verdict {
        Stability::Stable => energy,
        Stability::Unstable { largest_stable_step } => largest_stable_step,
    };
    Some(verdicts.iter().map(limit).sum())
}
