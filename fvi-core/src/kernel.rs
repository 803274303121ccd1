//! The kernel of a convolution quadrature: what a memory and its damping term must agree on.

use crate::direct::{FixedDirect, Overflow};
use crate::error::{ParameterError, check_step_size};
use crate::linear::factor;
use crate::memory::Memory;
use crate::real::Real;
use crate::runge_kutta::RungeKutta;
use crate::tiled::Tiled;
use crate::weights::{BdfOrder, ConvolutionWeights, leading_bdf_weight};

/// Kernel of a convolution quadrature: a rule, a symbol and a step size.
///
/// ```text
/// Σ_n W_n zⁿ = K(δ(z)/h) ,      K(s) = s^β ,      δ = γ_p (backward differentiation) or Δ (Runge–Kutta)
/// ```
///
/// A kernel makes memories, and every [`DampingTerm`](crate::DampingTerm) takes the kernel of its memory: the
/// term refuses a memory with another leading weight, and the integrator a kernel with another step. So
/// order, step and weights cannot disagree. Source: \[Lubich86\]; \[HJO\] eq. 18–22; \[LO93\].
///
/// ```
/// # use fvi_core::{BdfOrder, Kernel, Memory, monic_bdf_table};
/// static WEIGHTS: [f64; 64] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
/// let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 0.01)?;
/// let memory = kernel.full_memory::<f64, 1, 64>(&WEIGHTS)?;
/// assert_eq!(memory.leading(), [10.0]); // (1/h)^β
/// // A table of another order is noticed.
/// let other = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.6, 0.01)?;
/// assert!(other.full_memory::<f64, 1, 64>(&WEIGHTS).is_err());
/// # Ok::<(), fvi_core::ParameterError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[must_use]
pub struct Kernel {
    rule: Rule,
    symbol: Symbol,
    step_size: Option<f64>,
}

/// How derivatives are discretised.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Rule {
    /// Backward differentiation: plain weights.
    Bdf(BdfOrder),
    /// A Runge–Kutta method: matrix weights.
    RungeKutta {
        /// Number of stages R.
        stages: usize,
        /// det A of its matrix.
        determinant: f64,
    },
    /// Weights that the caller vouches for: measured ones, or of another rule.
    Given,
}

/// The function K(s) that is discretised.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Symbol {
    /// s^β, the fractional derivative of order β.
    Power {
        /// β.
        exponent: f64,
    },
}

impl Kernel {
    /// s^β by a backward differentiation formula.
    ///
    /// # Errors
    /// If β is outside (−1, 2), or h is not positive and finite or so small that weights overflow.
    pub fn bdf(order: BdfOrder, exponent: f64, step_size: f64) -> Result<Self, ParameterError> {
        leading_bdf_weight(order, exponent, step_size)?;
        Ok(Self { rule: Rule::Bdf(order), symbol: Symbol::Power { exponent }, step_size: Some(step_size) })
    }

    /// s^β by a Runge–Kutta method.
    ///
    /// # Errors
    /// If β is outside (−1, 2), or h is not positive and finite.
    pub fn runge_kutta<const R: usize>(
        method: &RungeKutta<R>,
        exponent: f64,
        step_size: f64,
    ) -> Result<Self, ParameterError> {
        check_exponent(exponent)?;
        check_step_size(step_size)?;
        let determinant = determinant(*method.matrix());
        let rule = Rule::RungeKutta { stages: R, determinant };
        Ok(Self { rule, symbol: Symbol::Power { exponent }, step_size: Some(step_size) })
    }

    /// s^β by a Runge–Kutta method on steps of any length, for a
    /// [`VariableStepMemory`](crate::VariableStepMemory) of this exponent.
    ///
    /// # Errors
    /// If β is outside (−1, 2).
    pub fn any_step<const R: usize>(method: &RungeKutta<R>, exponent: f64) -> Result<Self, ParameterError> {
        check_exponent(exponent)?;
        let rule = Rule::RungeKutta { stages: R, determinant: determinant(*method.matrix()) };
        Ok(Self { rule, symbol: Symbol::Power { exponent }, step_size: None })
    }

    /// s^β by weights that the caller vouches for; neither they nor the step are checked.
    ///
    /// # Errors
    /// If β is outside (−1, 2).
    #[inline(always)]
    pub fn given(exponent: f64) -> Result<Self, ParameterError> {
        check_exponent(exponent)?;
        Ok(Self { rule: Rule::Given, symbol: Symbol::Power { exponent }, step_size: None })
    }

    /// The rule.
    pub fn rule(&self) -> Rule {
        self.rule
    }

    /// The symbol.
    pub fn symbol(&self) -> Symbol {
        self.symbol
    }

    /// β of the symbol s^β.
    #[inline(always)]
    pub fn exponent(&self) -> f64 {
        let Symbol::Power { exponent } = self.symbol;
        exponent
    }

    /// h; `None` where the weights are given, or for steps of any length.
    #[inline(always)]
    pub fn step_size(&self) -> Option<f64> {
        self.step_size
    }

    /// The direct memory for C coordinates that keeps up to H samples and refuses more, with the weights
    /// w_n/w₀ in flash ([`monic_bdf_table`](crate::monic_bdf_table)).
    ///
    /// # Errors
    /// If the weights are not those of this kernel.
    pub fn full_memory<'w, T: Real, const C: usize, const H: usize>(
        &self,
        weights: &'w [T],
    ) -> Result<FixedDirect<'w, T, C, H>, ParameterError> {
        FixedDirect::full_memory(weights, self.scale(weights)?)
    }

    /// The direct memory for C coordinates that keeps the latest H samples and forgets the others; see
    /// [`full_memory`](Kernel::full_memory).
    ///
    /// # Errors
    /// If the weights are not those of this kernel.
    pub fn short_memory<'w, T: Real, const C: usize, const H: usize>(
        &self,
        weights: &'w [T],
    ) -> Result<FixedDirect<'w, T, C, H>, ParameterError> {
        FixedDirect::short_memory(weights, self.scale(weights)?)
    }

    /// The tiled memory for C coordinates in B blocks; see [`full_memory`](Kernel::full_memory).
    ///
    /// # Errors
    /// If the weights are not those of this kernel.
    pub fn tiled_memory<'w, T: Real, const C: usize, const B: usize>(
        &self,
        weights: &'w [T],
        overflow: Overflow,
    ) -> Result<Tiled<'w, T, C, B>, ParameterError> {
        Tiled::new(weights, self.scale(weights)?, overflow)
    }

    /// w₀, after a look at the first weights and the last: they must be w_n/w₀ of this kernel.
    fn scale<T: Real>(&self, weights: &[T]) -> Result<T, ParameterError> {
        let (Rule::Bdf(order), Some(step_size)) = (self.rule, self.step_size) else {
            return Err(ParameterError {
                parameter: "kernel",
                value: f64::NAN,
                allowed: "one of backward differentiation, whose weights are plain numbers",
            });
        };
        let leading = leading_bdf_weight(order, self.exponent(), step_size)?;
        let right = ConvolutionWeights::bdf(order, self.exponent(), order.generating_function(0.0))?;
        for (&weight, right) in weights.iter().zip(right.take(8)) {
            ParameterError::check(
                close(weight.to_f64(), right, 64.0 * T::EPSILON.to_f64()),
                "weight of the table",
                weight.to_f64(),
                "the kernel's: a table of the same order and exponent",
            )?;
        }
        Ok(T::of(leading))
    }

    /// Checks that the leading weight of a memory is that of this kernel.
    ///
    /// # Errors
    /// If it is not.
    #[inline(always)]
    pub(crate) fn check<T: Real>(&self, memory: &impl Memory<T>) -> Result<(), ParameterError> {
        // Inlined, so that a program with given weights links nothing of what follows.
        if matches!(self.rule, Rule::Given) { Ok(()) } else { self.check_rule(memory) }
    }

    fn check_rule<T: Real>(&self, memory: &impl Memory<T>) -> Result<(), ParameterError> {
        let Some(step_size) = self.step_size else { return Ok(()) };
        let found = memory.leading();
        let (found, right) = match self.rule {
            Rule::Given => return Ok(()),
            Rule::Bdf(order) => (
                found.first().map_or(f64::NAN, |weight| weight.to_f64()),
                leading_bdf_weight(order, self.exponent(), step_size)?,
            ),
            // W₀ = (A⁻¹/h)^β
            Rule::RungeKutta { stages, determinant } => (
                determinant_of(found, stages),
                libm::pow(determinant, -self.exponent())
                    * libm::pow(step_size, -self.exponent() * stages as f64),
            ),
        };
        // Determinants lose some digits more.
        let tolerance = if matches!(self.rule, Rule::Bdf(_)) { 64.0 } else { 4096.0 };
        ParameterError::check(
            close(found, right, tolerance * T::EPSILON.to_f64()),
            "leading weight of the memory",
            found,
            "that of the damping term's kernel: same rule, same order β, same step",
        )
    }
}

fn check_exponent(exponent: f64) -> Result<(), ParameterError> {
    ParameterError::check(exponent > -1.0 && exponent < 2.0, "exponent", exponent, "between -1 and 2")
}

/// Equal but for rounding.
fn close(found: f64, right: f64, tolerance: f64) -> bool {
    (found - right).abs() <= tolerance * right.abs() + f64::MIN_POSITIVE
}

fn determinant<const R: usize>(mut matrix: [[f64; R]; R]) -> f64 {
    let mut pivots = [0; R];
    let numbers = matrix.as_flattened_mut();
    if factor(numbers, &mut pivots).is_err() {
        return 0.0;
    }
    let product = numbers.iter().step_by(R + 1).product::<f64>();
    let swaps = pivots.iter().enumerate().filter(|&(row, &pivot)| row != pivot).count();
    if swaps % 2 == 0 { product } else { -product }
}

/// Determinant of R×R numbers in any precision; 0 for other shapes than a kernel has.
fn determinant_of<T: Real>(numbers: &[T], stages: usize) -> f64 {
    fn of<T: Real, const R: usize>(numbers: &[T]) -> f64 {
        let mut matrix = [[0.0; R]; R];
        for (place, number) in matrix.as_flattened_mut().iter_mut().zip(numbers) {
            *place = number.to_f64();
        }
        determinant(matrix)
    }
    match stages {
        1 => of::<T, 1>(numbers),
        2 => of::<T, 2>(numbers),
        3 => of::<T, 3>(numbers),
        4 => of::<T, 4>(numbers),
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::weights::{monic_bdf_table, monic_bdf_table_f32};

    static WEIGHTS: [f64; 16] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
    static SINGLE: [f32; 16] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, 0.5);

    #[test]
    fn a_kernel_knows_its_tables_and_its_memories() {
        let kernel = |p, exponent, h| Kernel::bdf(BdfOrder::new(p).unwrap(), exponent, h).unwrap();
        let right = kernel(1, 0.5, 0.01);
        assert!(right.full_memory::<f32, 1, 16>(&SINGLE).is_ok());
        let memory = right.full_memory::<f64, 1, 16>(&WEIGHTS).unwrap();
        assert_eq!(right.check(&memory), Ok(()));
        for wrong in [kernel(2, 0.5, 0.01), kernel(1, 0.51, 0.01)] {
            assert!(wrong.full_memory::<f64, 1, 16>(&WEIGHTS).is_err(), "{wrong:?}");
            assert!(wrong.check(&memory).is_err(), "{wrong:?}");
        }
        assert!(kernel(1, 0.5, 0.02).check(&memory).is_err());
        assert_eq!(Kernel::given(1.5).unwrap().check(&memory), Ok(()));
    }

    #[test]
    fn matrix_kernels_are_told_by_the_determinant_of_their_leading_weight() {
        let method = RungeKutta::<2>::radau_iia().unwrap();
        let kernel = Kernel::runge_kutta(&method, 1.0, 0.5).unwrap();
        // W₀ = A⁻¹/h for β = 1: A⁻¹ of Radau IIA with two stages is (3/2, 1/2; −9/2, 5/2).
        let leading = [3.0, 1.0, -9.0, 5.0];
        let memory = |scale| {
            FixedStages::new(&leading, 2, scale, [FixedRing::new(), FixedRing::new()], Overflow::Refuse)
                .unwrap()
        };
        assert_eq!(kernel.check(&memory(1.0)), Ok(()));
        assert!(kernel.check(&memory(2.0)).is_err());
    }

    type FixedRing = heapless::Deque<f64, 4>;
    type FixedStages<'w> = crate::direct::Direct<f64, &'w [f64], [FixedRing; 2], FixedRing>;
}
