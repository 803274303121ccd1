//! The kernel of a convolution quadrature: what a memory and its damping term must agree on.

use crate::direct::{FixedDirect, Overflow};
use crate::error::{ParameterError, check_step_size};
use crate::exponential_sum::{ExponentialSum, ExponentialTable};
use crate::linear::factor;
use crate::memory::{ActsOn, Memory};
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
/// # use fvi_core::{BdfOrder, Kernel, Memory, monic_increment_table};
/// static WEIGHTS: [f64; 64] = monic_increment_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
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
    /// Scalar weights of another rule or another symbol, identified by the first two.
    Weights {
        /// w₀ and w₁, on values.
        first: [f64; 2],
    },
    /// Matrix weights of another rule or another symbol, identified by det W₀.
    MatrixWeights {
        /// Number of stages R.
        stages: usize,
        /// det W₀.
        determinant: f64,
    },
    /// Weights that are not checked and for which the caller is responsible: measured ones, or of another
    /// rule.
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
    /// Another function, of which only the growth is known here.
    Other {
        /// μ with K(s) ~ s^μ for large s.
        growth: f64,
    },
}

impl Symbol {
    /// μ with K(s) ~ s^μ for large s: the order of a fractional derivative.
    #[inline(always)]
    pub fn growth(self) -> f64 {
        match self {
            Self::Power { exponent } => exponent,
            Self::Other { growth } => growth,
        }
    }
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

    /// s^β by weights for which the caller is responsible; neither they nor the step size are checked.
    ///
    /// # Errors
    /// If β is outside (−1, 2).
    #[inline(always)]
    pub fn given(exponent: f64) -> Result<Self, ParameterError> {
        check_exponent(exponent)?;
        Ok(Self { rule: Rule::Given, symbol: Symbol::Power { exponent }, step_size: None })
    }

    /// Another symbol that grows as s^`growth` for large s, with weights that are not checked, as those of
    /// [`given`](Kernel::given) for s^β: for example a table of relaxations on steps of any length. A growth
    /// of 0 does not make it the identity: Caputo's form subtracts the first value.
    ///
    /// # Errors
    /// If the growth is outside (−1, 2).
    pub fn given_growth(growth: f64) -> Result<Self, ParameterError> {
        Self::other(growth, Rule::Given, None)
    }

    /// Another symbol that grows as s^`growth` for large s, by scalar weights whose first two on values are
    /// `first`: a memory with others is refused.
    ///
    /// # Errors
    /// If the growth is outside (−1, 2), or h is not positive and finite, or a weight not finite.
    pub fn weights(growth: f64, first: [f64; 2], step_size: f64) -> Result<Self, ParameterError> {
        check_step_size(step_size)?;
        for weight in first {
            ParameterError::check(weight.is_finite(), "weight", weight, "finite")?;
        }
        Self::other(growth, Rule::Weights { first }, Some(step_size))
    }

    /// Another symbol that grows as s^`growth` for large s, by R×R matrix weights, det W₀ = `determinant`: a
    /// memory with another determinant is refused.
    ///
    /// # Errors
    /// If the growth is outside (−1, 2), or h is not positive and finite, or the determinant not finite.
    pub fn matrix_weights(
        growth: f64,
        stages: usize,
        determinant: f64,
        step_size: f64,
    ) -> Result<Self, ParameterError> {
        check_step_size(step_size)?;
        ParameterError::check(determinant.is_finite(), "determinant of W₀", determinant, "finite")?;
        Self::other(growth, Rule::MatrixWeights { stages, determinant }, Some(step_size))
    }

    fn other(growth: f64, rule: Rule, step_size: Option<f64>) -> Result<Self, ParameterError> {
        check_exponent(growth)?;
        Ok(Self { rule, symbol: Symbol::Other { growth }, step_size })
    }

    /// The rule.
    pub fn rule(&self) -> Rule {
        self.rule
    }

    /// The symbol.
    pub fn symbol(&self) -> Symbol {
        self.symbol
    }

    /// h; `None` where the weights are given, or for steps of any length.
    #[inline(always)]
    pub fn step_size(&self) -> Option<f64> {
        self.step_size
    }

    /// The direct memory for C coordinates that keeps up to H samples and refuses more, with its weights in
    /// flash: those on increments ([`monic_increment_table`](crate::monic_increment_table)), which lose less
    /// to rounding, or those on values ([`monic_bdf_table`](crate::monic_bdf_table)). Which of the two
    /// follows from the table.
    ///
    /// # Errors
    /// If the weights are not those of this kernel.
    pub fn full_memory<'w, T: Real, const C: usize, const H: usize>(
        &self,
        weights: &'w [T],
    ) -> Result<FixedDirect<'w, T, C, H>, ParameterError> {
        let (scale, acts_on) = self.table(weights)?;
        Ok(FixedDirect::full_memory(weights, scale)?.acting_on(acts_on))
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
        let (scale, acts_on) = self.table(weights)?;
        Ok(FixedDirect::short_memory(weights, scale)?.acting_on(acts_on))
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
        let (scale, acts_on) = self.table(weights)?;
        Ok(Tiled::new(weights, scale, overflow)?.acting_on(acts_on))
    }

    /// The exponential-sum memory for a table of this kernel and the given number of channels, on values or
    /// on increments: which of the two follows from the table.
    ///
    /// A table made for a step size of 1 serves every other one, and gets its scale here; one whose weights
    /// hold their step size ([`ExponentialTable::step_size`]) must hold that of the kernel.
    ///
    /// # Errors
    /// If the first weights of the table are not those of this kernel, or [`ExponentialSum::new`] refuses
    /// channels or state.
    pub fn exponential_sum<T, C, B>(
        &self,
        table: ExponentialTable<C>,
        channels: usize,
        state: B,
    ) -> Result<ExponentialSum<T, C, B>, ParameterError>
    where
        T: Real,
        C: AsRef<[T]>,
        B: AsRef<[T]> + AsMut<[T]>,
    {
        let view = table.borrow();
        view.check()?;
        let held = view.step_size != 1.0;
        if held && let Some(step_size) = self.step_size {
            ParameterError::check(
                close(view.step_size, step_size, 4.0 * T::EPSILON.to_f64()),
                "step size of the table",
                view.step_size,
                "that of the kernel, or 1 for a table that every step size may scale",
            )?;
        }
        let (scale, acts_on) = self.scale_of(view.head, view.exponentials.is_empty())?;
        let exact = held || self.step_size == Some(1.0);
        let unit = close(scale.to_f64(), 1.0, 64.0 * T::EPSILON.to_f64());
        ParameterError::check(
            unit || !exact,
            "leading weight of the table",
            view.head.first().map_or(f64::NAN, |weight| weight.to_f64()),
            "that of the kernel at the step size that the table says it holds",
        )?;
        let scale = if unit { T::one() } else { scale };
        Ok(ExponentialSum::new(table, scale, channels, state)?.acting_on(acts_on))
    }

    /// Factor from a table's weights to those of this kernel, and the kind of samples they act on. `ends`
    /// states that all weights after `weights` are zero.
    ///
    /// # Errors
    /// If the first of the weights are not, up to a factor, those of this kernel, or the kernel is not one of
    /// backward differentiation with a step size.
    pub fn scale_of<T: Real>(&self, weights: &[T], ends: bool) -> Result<(T, ActsOn), ParameterError> {
        let mut monic = [T::zero(); COMPARED];
        let first = weights.first().copied().unwrap_or_default();
        ParameterError::check(
            first != T::zero() && first.is_finite(),
            "leading weight of the table",
            first.to_f64(),
            "finite and not 0",
        )?;
        for (place, &weight) in monic.iter_mut().zip(weights) {
            *place = weight / first;
        }
        let count = if ends { COMPARED } else { weights.len() };
        let (leading, acts_on) = self.table(monic.get(..count).unwrap_or(&monic))?;
        Ok((leading / first, acts_on))
    }

    /// w₀ and the kind of samples a table acts on, from its first weights: they must be w_n/w₀ of this
    /// kernel, or the partial sums of these.
    fn table<T: Real>(&self, weights: &[T]) -> Result<(T, ActsOn), ParameterError> {
        if let Rule::Weights { first } = self.rule {
            return Self::table_of(first, weights);
        }
        let (Rule::Bdf(order), Symbol::Power { exponent }, Some(step_size)) =
            (self.rule, self.symbol, self.step_size)
        else {
            return Err(ParameterError {
                parameter: "kernel",
                value: f64::NAN,
                allowed: "one of backward differentiation, whose weights are plain numbers",
            });
        };
        let leading = leading_bdf_weight(order, exponent, step_size)?;
        let on_values = ConvolutionWeights::bdf(order, exponent, order.generating_function(0.0))?;
        let on_increments = on_values.clone().on_increments();
        let wrong = |right: ConvolutionWeights| {
            let unequal = |pair: &(T, f64)| !close(pair.0.to_f64(), pair.1, 64.0 * T::EPSILON.to_f64());
            weights.iter().copied().zip(right.take(COMPARED)).find(unequal)
        };
        let Some((weight, _)) = wrong(on_values) else { return Ok((T::of(leading), ActsOn::Values)) };
        if wrong(on_increments).is_none() {
            return Ok((T::of(leading), ActsOn::Increments));
        }
        Err(ParameterError {
            parameter: "weight of the table",
            value: weight.to_f64(),
            allowed: "the kernel's: a table of the same order and exponent",
        })
    }

    /// As `table`, for a kernel of which the first two weights are known. The second weight on increments is
    /// their sum.
    fn table_of<T: Real>(first: [f64; 2], weights: &[T]) -> Result<(T, ActsOn), ParameterError> {
        let [leading, second] = first;
        let found = weights.get(1).map_or(f64::NAN, |weight| weight.to_f64());
        let is = |right: f64| (found - right / leading).abs() <= 64.0 * T::EPSILON.to_f64();
        if is(second) {
            return Ok((T::of(leading), ActsOn::Values));
        }
        ParameterError::check(
            is(leading + second),
            "weight of the table",
            found,
            "the kernel's: a table of the same kernel and step",
        )?;
        Ok((T::of(leading), ActsOn::Increments))
    }

    /// Checks that the first weights of kernel `index` of a memory are those of this kernel, and clears the
    /// memory.
    ///
    /// # Errors
    /// If they are not.
    #[inline(always)]
    pub(crate) fn check<T: Real>(
        &self,
        memory: &mut impl Memory<T>,
        index: usize,
    ) -> Result<(), ParameterError> {
        // Inlined, so that a program with given weights links nothing of what follows.
        if matches!(self.rule, Rule::Given) { Ok(()) } else { self.check_rule(memory, index) }
    }

    fn check_rule<T: Real>(&self, memory: &mut impl Memory<T>, index: usize) -> Result<(), ParameterError> {
        let Some(step_size) = self.step_size else { return Ok(()) };
        let planes = memory.stages() * memory.stages();
        let found = memory.leading().get(index * planes..).unwrap_or(&[]);
        let first = || found.first().map_or(f64::NAN, |weight| weight.to_f64());
        let growth = self.symbol.growth();
        let (found, right) = match self.rule {
            Rule::Given => return Ok(()),
            Rule::Bdf(order) => (first(), leading_bdf_weight(order, growth, step_size)?),
            Rule::Weights { first: [right, _] } => (first(), right),
            // W₀ = (A⁻¹/h)^β
            Rule::RungeKutta { stages, determinant } => (
                determinant_of(found, stages),
                libm::pow(determinant, -growth) * libm::pow(step_size, -growth * stages as f64),
            ),
            Rule::MatrixWeights { stages, determinant } => (determinant_of(found, stages), determinant),
        };
        // Determinants lose some digits more.
        let plain = matches!(self.rule, Rule::Bdf(_) | Rule::Weights { .. });
        let tolerance = if plain { 64.0 } else { 4096.0 };
        ParameterError::check(
            close(found, right, tolerance * T::EPSILON.to_f64()),
            "leading weight of the memory",
            found,
            "that of the damping term's kernel: same rule, same order β, same step",
        )?;
        // Weights on values and on increments have the same first one.
        let [on_values, on_increments] = match self.rule {
            Rule::Bdf(order) => {
                let weights = ConvolutionWeights::bdf(order, growth, step_size)?;
                let second = |mut weights: ConvolutionWeights| weights.nth(1).unwrap_or(f64::NAN);
                [second(weights.clone()), second(weights.on_increments())]
            }
            Rule::Weights { first: [leading, second] } => [second, leading + second],
            _ => return Ok(()),
        };
        let Some(found) = second_weight(memory) else { return Ok(()) };
        let right = match memory.acts_on() {
            ActsOn::Values => on_values,
            ActsOn::Increments | ActsOn::Rises => on_increments,
        };
        let found = found.to_f64();
        // Relative to the leading weight: the weight may be a difference of numbers of that size.
        let leading = memory.leading().first().map_or(1.0, |weight| weight.to_f64());
        let error = (found - right).abs() / leading.abs();
        // Weights before the delay of a kernel are nothing beside the others.
        let is_nothing = leading.abs() < NOTHING && found.abs() < NOTHING && right.abs() < NOTHING;
        ParameterError::check(
            error <= tolerance * T::EPSILON.to_f64() || is_nothing || found == right,
            "second weight of the memory",
            found,
            "that of the damping term's kernel on the samples that the memory says it takes",
        )
    }
}

/// Weights below it are not told from those of another kernel.
const NOTHING: f64 = 1e-77;

/// Weights of a table that are compared with those of a kernel.
const COMPARED: usize = 8;

/// Largest number of channels of a memory whose second weight is measured.
const TRIED: usize = 16;

/// The weight w₁ of a memory of plain numbers, measured as its response to a unit sample. `None` where it
/// cannot be measured: weights that vary, too many channels, several kernels, no room.
fn second_weight<T: Real>(memory: &mut impl Memory<T>) -> Option<T> {
    let channels = memory.channels();
    let plain = memory.stages() == 1 && memory.kernels() == 1;
    if !plain || channels > TRIED || !memory.leading_is_constant() {
        return None;
    }
    let mut numbers = [T::one(); TRIED];
    let numbers = numbers.get_mut(..channels)?;
    memory.clear();
    let answer = memory.push(numbers).and_then(|()| memory.next_term(numbers));
    memory.clear();
    answer.ok()?;
    numbers.first().copied()
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
    use crate::saving::Stateful;
    use crate::weights::{monic_bdf_table, monic_bdf_table_f32, monic_increment_table};

    static WEIGHTS: [f64; 16] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
    static SINGLE: [f32; 16] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, 0.5);

    #[test]
    fn a_kernel_knows_its_tables_and_its_memories() {
        let kernel = |p, exponent, h| Kernel::bdf(BdfOrder::new(p).unwrap(), exponent, h).unwrap();
        let right = kernel(1, 0.5, 0.01);
        assert!(right.full_memory::<f32, 1, 16>(&SINGLE).is_ok());
        let mut memory = right.full_memory::<f64, 1, 16>(&WEIGHTS).unwrap();
        assert_eq!(right.check(&mut memory, 0), Ok(()));
        for wrong in [kernel(2, 0.5, 0.01), kernel(1, 0.51, 0.01)] {
            assert!(wrong.full_memory::<f64, 1, 16>(&WEIGHTS).is_err(), "{wrong:?}");
            assert!(wrong.check(&mut memory, 0).is_err(), "{wrong:?}");
        }
        assert!(kernel(1, 0.5, 0.02).check(&mut memory, 0).is_err());
        assert_eq!(Kernel::given(1.5).unwrap().check(&mut memory, 0), Ok(()));
    }

    #[test]
    fn weights_on_values_and_on_increments_are_told_apart() {
        static SUMS: [f64; 16] = monic_increment_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
        let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 0.01).unwrap();
        let values = kernel.full_memory::<f64, 1, 16>(&WEIGHTS).unwrap();
        let increments = kernel.full_memory::<f64, 1, 16>(&SUMS).unwrap();
        assert_eq!((values.acts_on(), increments.acts_on()), (ActsOn::Values, ActsOn::Increments));
        for (memory, taken_for) in [(values, ActsOn::Increments), (increments, ActsOn::Values)] {
            assert_eq!(kernel.check(&mut memory.clone(), 0), Ok(()));
            let error = kernel.check(&mut memory.acting_on(taken_for), 0).unwrap_err();
            assert_eq!(error.parameter, "second weight of the memory");
        }
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
        assert_eq!(kernel.check(&mut memory(1.0), 0), Ok(()));
        assert!(kernel.check(&mut memory(2.0), 0).is_err());
    }

    type FixedRing = heapless::Deque<f64, 4>;
    type FixedStages<'w> = crate::direct::Direct<f64, &'w [f64], [FixedRing; 2], FixedRing>;

    #[test]
    fn determinants_count_the_rows_that_were_exchanged() {
        assert_eq!(determinant([[3.0]]), 3.0);
        assert_eq!(determinant([[0.0, 1.0], [1.0, 0.0]]), -1.0);
        assert_eq!(determinant([[0.0, 0.0, 2.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]]), 24.0);
        assert_eq!(determinant([[1.0, 2.0], [2.0, 4.0]]), 0.0);
        let mut diagonal = [0.0f32; 16];
        for (index, place) in diagonal.iter_mut().step_by(5).enumerate() {
            *place = 2.0 + index as f32;
        }
        assert_eq!(determinant_of(&diagonal, 4), 120.0);
        assert_eq!(determinant_of(&[2.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0, 4.0, 0.0f64], 3), -24.0);
        assert_eq!(determinant_of(&[0.5f64], 1), 0.5);
        assert_eq!(determinant_of(&[0.5f64; 25], 5), 0.0);
    }

    #[test]
    fn weights_of_another_symbol_are_told_by_the_first_two_of_them() {
        let kernel = |first| Kernel::weights(0.5, first, 0.01).unwrap();
        for weights in [&WEIGHTS, &monic_increment_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5)] {
            let power = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 0.01).unwrap();
            let mut memory = power.full_memory::<f64, 1, 16>(weights).unwrap();
            assert_eq!(kernel([10.0, -5.0]).check(&mut memory, 0), Ok(()));
            let parameter = |first| kernel(first).check(&mut memory.clone(), 0).unwrap_err().parameter;
            assert_eq!(parameter([10.1, -5.0]), "leading weight of the memory");
            assert_eq!(parameter([10.0, -5.1]), "second weight of the memory");
        }
        // Also for tables.
        let increments: [f64; 16] = monic_increment_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);
        let values = &WEIGHTS[..];
        let acts_on = |first, table: &[f64]| {
            let memory = kernel(first).full_memory::<f64, 1, 16>(table);
            memory.map(|memory| memory.acts_on()).map_err(|error| error.parameter)
        };
        assert_eq!(acts_on([10.0, -5.0], values), Ok(ActsOn::Values));
        assert_eq!(acts_on([10.0, -5.0], &increments), Ok(ActsOn::Increments));
        assert_eq!(acts_on([10.0, -5.1], values), Err("weight of the table"));
        let leading = [3.0, 1.0, -9.0, 5.0];
        let rings = [FixedRing::new(), FixedRing::new()];
        let mut memory = FixedStages::new(&leading, 2, 1.0, rings, Overflow::Refuse).unwrap();
        let matrices = |determinant| Kernel::matrix_weights(0.5, 2, determinant, 0.01).unwrap();
        assert_eq!(matrices(24.0).check(&mut memory, 0), Ok(()));
        assert!(matrices(24.1).check(&mut memory, 0).is_err());
        assert_eq!(Kernel::weights(0.5, [f64::NAN, 0.0], 0.1).unwrap_err().parameter, "weight");
        assert!(Kernel::weights(2.0, [1.0, 0.0], 0.1).is_err());
        assert!(Kernel::weights(0.5, [1.0, 0.0], 0.0).is_err());
        assert!(Kernel::matrix_weights(0.5, 2, f64::INFINITY, 0.1).is_err());
    }

    #[test]
    fn orders_outside_the_range_are_refused() {
        let method = RungeKutta::<2>::radau_iia().unwrap();
        for exponent in [-1.0, -1.5, 2.0, 2.5, f64::NAN] {
            assert_eq!(Kernel::given(exponent).unwrap_err().parameter, "exponent");
            assert!(Kernel::any_step(&method, exponent).is_err(), "{exponent}");
            assert!(Kernel::runge_kutta(&method, exponent, 0.1).is_err(), "{exponent}");
            assert!(Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, exponent, 0.1).is_err(), "{exponent}");
        }
        assert_eq!(Kernel::given(1.75).unwrap().symbol().growth(), 1.75);
        assert_eq!(Kernel::given_growth(0.0).unwrap().symbol(), Symbol::Other { growth: 0.0 });
        assert!(Kernel::given_growth(2.0).is_err());
        assert_eq!(Kernel::any_step(&method, -0.5).unwrap().step_size(), None);
        assert!(Kernel::runge_kutta(&method, 0.5, 0.0).is_err());
    }

    #[test]
    fn tables_may_be_rounded_but_not_wrong() {
        static SINGLE: [f32; 8] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, 0.3);
        static FIRST: [f64; 8] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, 1.0);
        for step_size in [1e-6, 0.01, 30.0] {
            let kernel = |exponent| Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, exponent, step_size).unwrap();
            let mut memory = kernel(0.3).full_memory::<f32, 1, 8>(&SINGLE).unwrap();
            assert_eq!(kernel(0.3).check(&mut memory, 0), Ok(()));
            // Weights that vanish are accepted as zeros.
            assert!(kernel(1.0).full_memory::<f64, 1, 8>(&FIRST).is_ok());
            let mut table: [f64; 8] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, 0.3);
            assert!(kernel(0.3).full_memory::<f64, 1, 8>(&table).is_ok());
            table[6] *= 1.0 + 1e-12;
            assert!(kernel(0.3).full_memory::<f64, 1, 8>(&table).is_err());
        }
    }

    /// The first weights of s^β at a step size, in single precision.
    fn exponentials(exponent: f64, step_size: f64, on_increments: bool) -> [f32; 6] {
        let weights = ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, exponent, step_size).unwrap();
        let mut head = [0.0; 6];
        if on_increments {
            weights.on_increments().fill(&mut head)
        } else {
            weights.clone().fill(&mut head)
        };
        head
    }

    #[test]
    fn a_kernel_finds_the_scale_of_its_tables_of_exponentials_and_refuses_others() {
        const TAIL: [f32; 8] = [0.5, 0.5, 0.5, 0.5, 0.1, 0.0, 0.0, 0.0];
        let kernel = |exponent, step| Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, exponent, step).unwrap();
        let made = |kernel: Kernel, head: &[f32], said: f64| {
            let table = ExponentialTable {
                stages: 1,
                head,
                exponentials: &TAIL[..],
                slow_blocks: 0,
                far_blocks: 0,
                horizon: 100,
                step_size: said,
            };
            let memory = kernel.exponential_sum(table, 1, std::vec![0.0; table.state_len(1)]);
            memory.map(|memory| (memory.leading()[0], memory.acts_on())).map_err(|error| error.parameter)
        };
        let leading = |step: f64, exponent: f64| libm::pow(step, -exponent) as f32;
        for (exponent, on_increments) in [(0.5, false), (-0.8, false), (0.6, true), (1.5, true)] {
            let acts_on = if on_increments { ActsOn::Increments } else { ActsOn::Values };
            let right = kernel(exponent, 1e-3);
            // Made for h = 1 and for h = 1 ms: the same memory, never scaled twice.
            for said in [1.0, 1e-3] {
                let head = exponentials(exponent, said, on_increments);
                let (found, samples) = made(right, &head, said).unwrap();
                assert!((found / leading(1e-3, exponent) - 1.0).abs() < 1e-5, "{exponent}, {said}: {found}");
                assert_eq!(samples, acts_on, "{exponent}");
            }
            // Another exponent, another step size, and a table whose stated step size is not that of its
            // weights.
            let other = exponentials(exponent + 0.1, 1e-3, on_increments);
            assert_eq!(made(right, &other, 1e-3), Err("weight of the table"), "{exponent}");
            let head = exponentials(exponent, 2e-3, on_increments);
            assert_eq!(made(right, &head, 2e-3), Err("step size of the table"), "{exponent}");
            assert_eq!(made(right, &head, 1e-3), Err("leading weight of the table"), "{exponent}");
            assert_eq!(made(kernel(exponent, 1.0), &head, 1.0), Err("leading weight of the table"));
        }
        // A table that ends after three weights is not that of a kernel with infinitely many.
        let scale = |weights: &[f32], ends| kernel(1.0, 0.5).scale_of(weights, ends).map_err(|_| ());
        assert_eq!(scale(&[1.0, -1.0], true), Ok((2.0, ActsOn::Values)));
        assert!(kernel(0.5, 1.0).scale_of(&[1.0f32, -0.5, -0.125], true).is_err());
        assert!(kernel(0.5, 1.0).scale_of(&[1.0f32, -0.5, -0.125], false).is_ok());
        assert!(scale(&[0.0, 0.0], true).is_err() && scale(&[], false).is_err());
        assert!(Kernel::given(0.5).unwrap().scale_of(&[1.0f32], false).is_err());
    }

    /// A memory whose stages and constancy of the leading weight can be set.
    struct Special {
        memory: FixedDirect<'static, f64, 2, 16>,
        stages: usize,
        varies: bool,
    }

    impl Memory<f64> for Special {
        fn channels(&self) -> usize {
            self.memory.channels()
        }

        fn stages(&self) -> usize {
            self.stages
        }

        fn acts_on(&self) -> ActsOn {
            self.memory.acts_on()
        }

        fn leading(&self) -> &[f64] {
            self.memory.leading()
        }

        fn leading_is_constant(&self) -> bool {
            !self.varies
        }

        fn len(&self) -> usize {
            self.memory.len()
        }

        fn next_term(&mut self, term: &mut [f64]) -> Result<(), crate::MemoryError> {
            self.memory.next_term(term)
        }

        fn push(&mut self, sample: &[f64]) -> Result<(), crate::MemoryError> {
            self.memory.push(sample)
        }

        fn clear(&mut self) {
            self.memory.clear();
        }

        fn bytes(&self) -> usize {
            self.memory.bytes()
        }
    }

    impl Stateful for Special {}

    #[test]
    fn memories_of_plain_weights_with_up_to_sixteen_channels_are_tried_out() {
        let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 0.01).unwrap();
        let wrong = ActsOn::Increments;
        let mut sixteen = kernel.full_memory::<f64, 16, 4>(&WEIGHTS).unwrap().acting_on(wrong);
        assert_eq!(kernel.check(&mut sixteen, 0).unwrap_err().parameter, "second weight of the memory");
        let mut seventeen = kernel.full_memory::<f64, 17, 4>(&WEIGHTS).unwrap().acting_on(wrong);
        assert_eq!(kernel.check(&mut seventeen, 0), Ok(()));
        // For weights that vary, or matrices, the second weight is not checked.
        for (stages, varies, accepted) in [(1, false, false), (1, true, true), (2, false, true)] {
            let memory = kernel.full_memory(&WEIGHTS).unwrap().acting_on(wrong);
            let mut special = Special { memory, stages, varies };
            assert_eq!(kernel.check(&mut special, 0).is_ok(), accepted, "{stages} stages, {varies}");
        }
    }

    /// A memory of several kernels of which only the leading weights are used.
    struct Leading<'a>(&'a [f64]);

    impl Memory<f64> for Leading<'_> {
        fn channels(&self) -> usize {
            2
        }

        fn stages(&self) -> usize {
            2
        }

        fn kernels(&self) -> usize {
            self.0.len() / 4
        }

        fn leading(&self) -> &[f64] {
            self.0
        }

        fn len(&self) -> usize {
            0
        }

        fn next_term(&mut self, _: &mut [f64]) -> Result<(), crate::MemoryError> {
            Ok(())
        }

        fn push(&mut self, _: &[f64]) -> Result<(), crate::MemoryError> {
            Ok(())
        }

        fn clear(&mut self) {}

        fn bytes(&self) -> usize {
            0
        }
    }

    impl Stateful for Leading<'_> {}

    #[test]
    fn each_of_several_kernels_is_compared_with_its_own_leading_weight() {
        let method = RungeKutta::<2>::radau_iia().unwrap();
        let first = Kernel::runge_kutta(&method, 1.0, 0.5).unwrap();
        let second = Kernel::runge_kutta(&method, 1.0, 0.25).unwrap();
        // A⁻¹/h
        let mut memory = Leading(&[3.0, 1.0, -9.0, 5.0, 6.0, 2.0, -18.0, 10.0]);
        assert_eq!((first.check(&mut memory, 0), second.check(&mut memory, 1)), (Ok(()), Ok(())));
        for (kernel, index) in [(first, 1), (second, 0), (first, 2)] {
            assert!(kernel.check(&mut memory, index).is_err(), "{index}");
        }
    }
}
