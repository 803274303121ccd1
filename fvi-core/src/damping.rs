//! Fractional damping: coefficients, order, and the memory that it needs.

use core::fmt;

use nalgebra::{SMatrix, SVector};

use crate::error::ParameterError;
use crate::memory::{Memory, MemoryError};
use crate::real::Real;
use crate::system::{Coefficients, MatrixError};

/// On what the fractional derivative acts.
///
/// The two types agree where the terms left out vanish (\[JO\] eq. 4). With q₀ ≠ 0 and 0 < β < 1 the Riemann–Liouville
/// type has the force ρ q₀ t^{−β}/Γ(1−β), singular at t = 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Derivative {
    /// On q itself.
    RiemannLiouville,
    /// On q − q₀ for 0 < β ≤ 1, on q − q₀ − v₀ t for 1 < β < 2, with v₀ = M⁻¹ p₀; on q itself for β = 0.
    Caputo,
}

/// The damping forces of one step as they depend on what is being solved for.
///
/// ```text
/// Σ_m ρ_m (D^{β_m} q)_i = known_i + Σ_j leading_ij e_j ,      e_j = q_j − q_k ,   i, j = 1…R
/// ```
///
/// The R nodes of the sample to come are measured from the position q_k at the beginning of the step. The force on the
/// system is minus this.
#[derive(Clone, Copy, Debug)]
pub struct AffineForce<T, const N: usize, const R: usize> {
    /// Σ_m ρ_m times entry (i, j) of the leading weight of term m.
    pub leading: [[SMatrix<T, N, N>; R]; R],
    /// The part that no unknown enters.
    pub known: [SVector<T, N>; R],
}

impl<T: Real, const N: usize, const R: usize> AffineForce<T, N, R> {
    /// No force.
    pub fn zero() -> Self {
        Self { leading: [[SMatrix::zeros(); R]; R], known: [SVector::zeros(); R] }
    }

    /// The force at node i when the nodes lie at q_k + `increments`.
    #[inline]
    pub fn at(&self, node: usize, increments: &[SVector<T, N>; R]) -> SVector<T, N> {
        let known = self.known.get(node).copied().unwrap_or_else(SVector::zeros);
        let row = self.leading.get(node).map_or(&[][..], |row| &row[..]);
        row.iter().zip(increments).fold(known, |sum, (weight, increment)| sum + weight * increment)
    }
}

/// Damping with memory: anything between no damping and many terms.
///
/// `R` is the number of nodes of a sample: 1 where the memory holds main nodes q_k, r where it holds the r stage
/// values of a Runge–Kutta convolution quadrature. `()` is no damping, [`DampingTerm`] one term, and tuples, arrays and
/// mutable slices of dampings act together.
pub trait Damping<T: Real, const N: usize, const R: usize> {
    /// Checks that the memories fit N coordinates and R nodes.
    ///
    /// # Errors
    /// [`MemoryShape`] if one does not.
    fn check_shape(&self) -> Result<(), MemoryShape>;

    /// Forgets everything and notes how the motion starts.
    fn begin(&mut self, position: &SVector<T, N>, velocity: &SVector<T, N>);

    /// Adds to `force` what the damping exerts at nodes at the given times; `from` is the position q_k.
    ///
    /// # Errors
    /// [`MemoryError::Full`] if the sample to come could not be stored.
    fn add_force(
        &mut self,
        from: &SVector<T, N>,
        times: &[T; R],
        force: &mut AffineForce<T, N, R>,
    ) -> Result<(), MemoryError>;

    /// Stores the positions of the nodes.
    ///
    /// # Errors
    /// [`MemoryError::Full`]; not after a successful [`add_force`](Damping::add_force).
    fn push(&mut self, positions: &[SVector<T, N>; R], times: &[T; R]) -> Result<(), MemoryError>;
}

/// A memory has another number of channels or stages than the system and the scheme need.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryShape {
    /// Channels needed, N·R.
    pub channels_needed: usize,
    /// Channels of the memory.
    pub channels: usize,
    /// Stages needed, R.
    pub stages_needed: usize,
    /// Stages of the memory's kernel.
    pub stages: usize,
}

impl fmt::Display for MemoryShape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "a memory has {} channels and {} stages where {} and {} are needed",
            self.channels, self.stages, self.channels_needed, self.stages_needed
        )
    }
}

impl core::error::Error for MemoryShape {}

/// Why a damping term cannot be made.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum DampingError {
    /// The damping order is outside [0, 2).
    Order(ParameterError),
    /// The coefficients are not finite, not symmetric or not positive semidefinite.
    Coefficients(MatrixError),
}

impl fmt::Display for DampingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Order(error) => error.fmt(f),
            Self::Coefficients(error) => write!(f, "damping coefficient: {error}"),
        }
    }
}

impl core::error::Error for DampingError {}

/// One damping term ρ D₋^β q with its memory.
///
/// ρ is symmetric positive semidefinite; β = 2α is the damping order, 0 ≤ β < 2 (α is the order in the Lagrangian). The
/// kernel of the memory must be that of D^β for the step size of the integration. Source: \[JO\] eq. 1, 34a; \[HJO\] eq. 34a, 35.
#[derive(Clone, Copy, Debug)]
pub struct DampingTerm<T, const N: usize, M> {
    coefficients: Coefficients<T, N>,
    start: Subtraction,
    initial_position: SVector<T, N>,
    initial_velocity: SVector<T, N>,
    memory: M,
}

/// Part of the motion on which a term does not act.
#[derive(Clone, Copy, Debug)]
enum Subtraction {
    Nothing,
    Position,
    PositionAndVelocity,
}

impl<T: Real, const N: usize, M> DampingTerm<T, N, M> {
    /// The term ρ D^β q on an engine whose kernel is that of D^β.
    ///
    /// # Errors
    /// If β is outside [0, 2) or ρ is not finite, symmetric and positive semidefinite.
    pub fn new(
        coefficients: Coefficients<T, N>,
        damping_order: T,
        derivative: Derivative,
        memory: M,
    ) -> Result<Self, DampingError> {
        ParameterError::check(
            damping_order >= T::zero() && damping_order < T::of(2.0),
            "damping order",
            damping_order.to_f64(),
            "at least 0 and less than 2",
        )
        .map_err(DampingError::Order)?;
        coefficients.check_positive_semidefinite().map_err(DampingError::Coefficients)?;
        let start = match derivative {
            Derivative::RiemannLiouville => Subtraction::Nothing,
            Derivative::Caputo if damping_order == T::zero() => Subtraction::Nothing,
            Derivative::Caputo if damping_order <= T::one() => Subtraction::Position,
            Derivative::Caputo => Subtraction::PositionAndVelocity,
        };
        let zero = SVector::zeros();
        Ok(Self { coefficients, start, initial_position: zero, initial_velocity: zero, memory })
    }

    /// The memory.
    pub fn memory(&self) -> &M {
        &self.memory
    }

    /// What the operator acts on when the position is `position` at `time`.
    #[inline]
    fn acted_on(&self, position: &SVector<T, N>, time: T) -> SVector<T, N> {
        match self.start {
            Subtraction::Nothing => *position,
            Subtraction::Position => position - self.initial_position,
            Subtraction::PositionAndVelocity => {
                position - self.initial_position - self.initial_velocity * time
            }
        }
    }
}

impl<T: Real, const N: usize, const R: usize, M: Memory<T>> Damping<T, N, R> for DampingTerm<T, N, M> {
    fn check_shape(&self) -> Result<(), MemoryShape> {
        let (channels, stages) = (self.memory.channels(), self.memory.stages());
        if channels == N * R && stages == R {
            Ok(())
        } else {
            Err(MemoryShape { channels_needed: N * R, channels, stages_needed: R, stages })
        }
    }

    fn begin(&mut self, position: &SVector<T, N>, velocity: &SVector<T, N>) {
        self.memory.clear();
        self.initial_position = *position;
        self.initial_velocity = *velocity;
    }

    #[inline]
    fn add_force(
        &mut self,
        from: &SVector<T, N>,
        times: &[T; R],
        force: &mut AffineForce<T, N, R>,
    ) -> Result<(), MemoryError> {
        let mut term = [[T::zero(); R]; N];
        self.memory.next_term(term.as_flattened_mut())?;
        let rho = self.coefficients.to_matrix();
        let weights = self.memory.leading().chunks(R.max(1));
        for (i, ((known, blocks), weights)) in
            force.known.iter_mut().zip(&mut force.leading).zip(weights).enumerate()
        {
            // Stage i of every coordinate.
            let mut sum = SVector::<T, N>::from_fn(|coordinate, _| {
                term.get(coordinate).and_then(|stages| stages.get(i)).copied().unwrap_or(T::zero())
            });
            for ((block, &weight), &time) in blocks.iter_mut().zip(weights).zip(times) {
                *block += rho * weight;
                sum += self.acted_on(from, time) * weight;
            }
            *known += self.coefficients.multiply(&sum);
        }
        Ok(())
    }

    #[inline]
    fn push(&mut self, positions: &[SVector<T, N>; R], times: &[T; R]) -> Result<(), MemoryError> {
        let mut sample = [[T::zero(); R]; N];
        for (stage, (position, &time)) in positions.iter().zip(times).enumerate() {
            let acted_on = self.acted_on(position, time);
            for (stages, &number) in sample.iter_mut().zip(acted_on.iter()) {
                if let Some(place) = stages.get_mut(stage) {
                    *place = number;
                }
            }
        }
        self.memory.push(sample.as_flattened())
    }
}

impl<T: Real, const N: usize, const R: usize> Damping<T, N, R> for () {
    fn check_shape(&self) -> Result<(), MemoryShape> {
        Ok(())
    }

    fn begin(&mut self, _: &SVector<T, N>, _: &SVector<T, N>) {}

    fn add_force(
        &mut self,
        _: &SVector<T, N>,
        _: &[T; R],
        _: &mut AffineForce<T, N, R>,
    ) -> Result<(), MemoryError> {
        Ok(())
    }

    fn push(&mut self, _: &[SVector<T, N>; R], _: &[T; R]) -> Result<(), MemoryError> {
        Ok(())
    }
}

impl<T: Real, const N: usize, const R: usize, A: Damping<T, N, R>, B: Damping<T, N, R>> Damping<T, N, R>
    for (A, B)
{
    fn check_shape(&self) -> Result<(), MemoryShape> {
        self.0.check_shape()?;
        self.1.check_shape()
    }

    fn begin(&mut self, position: &SVector<T, N>, velocity: &SVector<T, N>) {
        self.0.begin(position, velocity);
        self.1.begin(position, velocity);
    }

    #[inline]
    fn add_force(
        &mut self,
        from: &SVector<T, N>,
        times: &[T; R],
        force: &mut AffineForce<T, N, R>,
    ) -> Result<(), MemoryError> {
        self.0.add_force(from, times, force)?;
        self.1.add_force(from, times, force)
    }

    #[inline]
    fn push(&mut self, positions: &[SVector<T, N>; R], times: &[T; R]) -> Result<(), MemoryError> {
        self.0.push(positions, times)?;
        self.1.push(positions, times)
    }
}

/// Several dampings of one type, one after another.
macro_rules! damping_sequence {
    ($({$($generics:tt)*})? $sequence:ty) => {
        impl<T: Real, const N: usize, const R: usize, D: Damping<T, N, R> $(, $($generics)*)?> Damping<T, N, R>
            for $sequence
        {
            fn check_shape(&self) -> Result<(), MemoryShape> {
                self.iter().try_for_each(D::check_shape)
            }

            fn begin(&mut self, position: &SVector<T, N>, velocity: &SVector<T, N>) {
                self.iter_mut().for_each(|damping| damping.begin(position, velocity));
            }

            #[inline]
            fn add_force(
                &mut self,
                from: &SVector<T, N>,
                times: &[T; R],
                force: &mut AffineForce<T, N, R>,
            ) -> Result<(), MemoryError> {
                self.iter_mut().try_for_each(|damping| damping.add_force(from, times, force))
            }

            #[inline]
            fn push(&mut self, positions: &[SVector<T, N>; R], times: &[T; R]) -> Result<(), MemoryError> {
                self.iter_mut().try_for_each(|damping| damping.push(positions, times))
            }
        }
    };
}

damping_sequence!({const K: usize} [D; K]);
damping_sequence!(&mut [D]);
