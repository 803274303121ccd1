//! The memory for steps of any length: generalised convolution quadrature by exponentials in continuous time.

use crate::error::ParameterError;
use crate::linear::all_finite;
use crate::memory::{Memory, MemoryError, check_channels};
use crate::real::Real;
use crate::resolvent::{LANES, Lanes, Resolvent, ResolventValues};
use crate::runge_kutta::RungeKutta;
use crate::saving::{Shape, StateError, StateReader, StateWriter, Stateful, fingerprint, header_bytes};
use crate::space::{part, part_from, parts_mut};

/// A state too short for its table and channels takes no sample. [`VariableStepMemory::new`] refuses it.
const TOO_SHORT: MemoryError = MemoryError::Full { capacity: 0 };

/// Kind of the saved state.
const TAG: [u8; 4] = *b"rate";

/// Relative amount by which a step may be shorter than the table's shortest, or end after its horizon:
/// rounding of grids.
const SLACK: f64 = 1e-6;

/// The power s^{−μ}, 0 < μ < 1, as a sum of relaxations that does not depend on the step size.
///
/// ```text
/// s^{−μ} = (sin πμ / π) ∫₀^∞ λ^{−μ} (s + λ)^{−1} dλ  ≈  Σ_j c_j (s + λ_j)^{−1} ,      μ = ⌈β⌉ − β
/// ```
///
/// It serves D^β on every grid with steps of at least `shortest` and an end of at most `horizon`, both in
/// units of time. For integer β there are no rates. This is plain data, so that it can lie in flash; `C` is
/// any container of numbers. Source: \[LFS16\].
///
/// A table without `leading` is that of any kernel K(s) = s^d Σ_j c_j (s + λ_j)^{−1}, d = ⌈`exponent`⌉, such
/// as a Prony series, whose leading weight follows from the relaxations too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateTable<C> {
    /// β, the order of the derivative: above −1 and below 2; integrals have negative orders. Without
    /// `leading` only ⌈β⌉ matters.
    pub exponent: f64,
    /// (A^{−β})_{ab}, R×R numbers row by row, for the matrix A of the method; or empty, for a kernel that is
    /// the sum of its relaxations.
    pub leading: C,
    /// λ_j ≥ 0, padded with zeros to a multiple of four.
    pub rates: C,
    /// c_j, one for each λ_j; zero for the padding.
    pub coefficients: C,
    /// The shortest step, in units of time.
    pub shortest: f64,
    /// The longest time from the start, in units of time.
    pub horizon: f64,
}

impl<C> RateTable<C> {
    /// The same table, borrowed.
    pub fn borrow<T>(&self) -> RateTable<&[T]>
    where
        C: AsRef<[T]>,
    {
        RateTable {
            exponent: self.exponent,
            leading: self.leading.as_ref(),
            rates: self.rates.as_ref(),
            coefficients: self.coefficients.as_ref(),
            shortest: self.shortest,
            horizon: self.horizon,
        }
    }
}

impl<T> RateTable<&[T]> {
    /// Length of the state of [`VariableStepMemory`] for N coordinates and R stages: (2R + 1) J for the step
    /// at hand and R² for its leading weight, which all coordinates share, and 2J + 2 for each coordinate.
    pub const fn state_len(&self, coordinates: usize, stages: usize) -> usize {
        let shared = stages.saturating_mul(2).saturating_add(1).saturating_mul(self.rates.len());
        let each = self.rates.len().saturating_mul(2).saturating_add(2);
        shared.saturating_add(stages.saturating_mul(stages)).saturating_add(each.saturating_mul(coordinates))
    }
}

impl<T: Real> RateTable<&[T]> {
    /// Checks the table for a method of `stages` stages.
    ///
    /// # Errors
    /// If its shape does not fit the stages, or its numbers are not finite or out of range.
    pub fn check(&self, stages: usize) -> Result<(), ParameterError> {
        let count = |parameter, value: usize, accepted, allowed| {
            ParameterError::check(accepted, parameter, value as f64, allowed)
        };
        let planes = stages * stages;
        ParameterError::check(
            self.exponent > -1.0 && self.exponent < 2.0,
            "exponent",
            self.exponent,
            "greater than -1 and less than 2",
        )?;
        let leading = self.leading.len();
        count("leading numbers", leading, leading == planes || leading == 0, "the stages squared, or none")?;
        let rates = self.rates.len();
        count("rates", rates, rates.is_multiple_of(LANES), "a multiple of four")?;
        let coefficients = self.coefficients.len();
        count("coefficients", coefficients, coefficients == rates, "as many as rates")?;
        for (parameter, numbers) in
            [("leading number", self.leading), ("rate", self.rates), ("coefficient", self.coefficients)]
        {
            if let Some(number) = numbers.iter().copied().find(|number| !number.is_finite()) {
                return Err(ParameterError { parameter, value: number.to_f64(), allowed: "finite" });
            }
        }
        if let Some(rate) = self.rates.iter().copied().find(|&rate| rate < T::zero()) {
            return Err(ParameterError { parameter: "rate", value: rate.to_f64(), allowed: "at least 0" });
        }
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let (shortest, horizon) = (self.shortest, self.horizon);
        ParameterError::check(positive(shortest), "shortest step", shortest, "positive and finite")?;
        ParameterError::check(positive(horizon), "horizon", horizon, "positive and finite")
    }
}

/// The memory of D^β on steps of any length, for a stiffly accurate Runge–Kutta method of R stages.
///
/// With the stage values X_k of step k, of length h_k, for one coordinate, their last x_k, x_{−1} = 0 and
/// μ = ⌈β⌉ − β
///
/// ```text
/// (∂X)_k    = A⁻¹ (X_k − 1 x_{k−1}) / h_k ,      Y = ∂^{⌈β⌉} X
/// (D^β X)_k = (h_k A)^μ Y_k + Σ_j c_j (I + h_k λ_j A)⁻¹ 1 z_j
/// z_j      ← e_Rᵀ (I + h_k λ_j A)⁻¹ (1 z_j + h_k A Y_k)
/// ```
///
/// with the rates of a [`RateTable`]. In the step at hand it is exact; on equal steps it is Runge–Kutta
/// convolution quadrature; on every grid the operators compose, D^a D^b = D^{a+b}. All z_j decay whatever the
/// sequence of steps, since the methods are A-stable.
///
/// The leading weight (A⁻¹/h_k)^β follows [`begin_step`](Memory::begin_step), which must come before every
/// [`next_term`](Memory::next_term). A step as long as the one before costs (2R + 1) J multiply–adds for each
/// coordinate; one of another length forms the (I + h λ_j A)⁻¹ anew, once for all coordinates. The state is
/// the caller's: [`RateTable::state_len`] numbers. The z_j are sums compensated for rounding, so that the
/// rounding errors of many steps do not accumulate, not even in single precision.
///
/// Source: \[LFS13\], \[LFS16\].
#[derive(Clone, Debug)]
pub struct VariableStepMemory<T, const R: usize, C, B> {
    table: RateTable<C>,
    resolvent: Resolvent<T, R>,
    /// c
    nodes: [T; R],
    /// A and A⁻¹, row by row.
    matrix: [[T; R]; R],
    inverse: [[T; R]; R],
    derivatives: Derivatives,
    coordinates: usize,
    state: B,
    /// Length of the step to come; zero before it is known.
    length: T,
    /// Time of the samples so far, as a compensated sum: in single precision the rounding errors of many
    /// steps would exceed the tolerance of the horizon.
    elapsed: [T; 2],
    len: usize,
}

/// ⌈β⌉, the number of derivatives taken before the fractional integral.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Derivatives {
    None,
    One,
    Two,
}

impl<T, const R: usize, C, B> VariableStepMemory<T, R, C, B>
where
    T: Real,
    C: AsRef<[T]>,
    B: AsRef<[T]> + AsMut<[T]>,
{
    /// A memory on `coordinates` coordinates without samples.
    ///
    /// # Errors
    /// If the table is not one for R stages, its numbers are not finite or out of range, there are no
    /// coordinates, or the state has another length than [`RateTable::state_len`].
    pub fn new(
        method: &RungeKutta<R>,
        table: RateTable<C>,
        coordinates: usize,
        state: B,
    ) -> Result<Self, ParameterError> {
        let view = table.borrow();
        view.check(R)?;
        ParameterError::check(coordinates > 0, "coordinates", coordinates as f64, "at least 1")?;
        let length = state.as_ref().len();
        ParameterError::check(
            length == view.state_len(coordinates, R),
            "state length",
            length as f64,
            "the table's state_len",
        )?;
        let derivatives = match table.exponent {
            exponent if exponent <= 0.0 => Derivatives::None,
            exponent if exponent <= 1.0 => Derivatives::One,
            _ => Derivatives::Two,
        };
        let inverse = method.inverse()?.map(|row| row.map(T::of));
        let matrix = method.matrix().map(|row| row.map(T::of));
        let resolvent = Resolvent::new(method);
        let nodes = method.quadrature().nodes().map(T::of);
        let (length, elapsed, len) = (T::zero(), [T::zero(); 2], 0);
        let mut memory = Self {
            table,
            resolvent,
            nodes,
            matrix,
            inverse,
            derivatives,
            coordinates,
            state,
            length,
            elapsed,
            len,
        };
        memory.clear();
        Ok(memory)
    }

    /// The table.
    pub fn table(&self) -> &RateTable<C> {
        &self.table
    }

    /// Time of the samples so far.
    pub fn elapsed(&self) -> T {
        self.elapsed[0]
    }

    /// The time after a step of the given length, in two parts.
    fn elapsed_after(&self, length: T) -> [T; 2] {
        let [before, lost] = self.elapsed;
        let whole = length + lost;
        let after = before + whole;
        [after, whole - (after - before)]
    }

    fn parts(&mut self) -> Option<Parts<'_, T>> {
        let table = self.table.borrow();
        let rates = table.rates.len();
        let (operators, rest) = self.state.as_mut().split_at_mut_checked((2 * R + 1) * rates)?;
        let (leading, coordinates) = rest.split_at_mut_checked(R * R)?;
        Some(Parts { operators: operators.as_chunks_mut().0, leading, coordinates })
    }

    /// Computes the leading weight of a step from the relaxations.
    #[cold]
    #[inline(never)]
    fn write_leading(&mut self, length: T) -> Result<(), MemoryError> {
        let table = self.table.borrow();
        let derivatives = match self.derivatives {
            Derivatives::None => 0,
            Derivatives::One => 1,
            Derivatives::Two => 2,
        };
        let relaxations = table.rates.iter().copied().zip(table.coefficients.iter().copied());
        let matrices = [&self.matrix, &self.inverse];
        let formed = self.resolvent.leading(matrices, derivatives, length, relaxations);
        if !all_finite(formed.as_flattened()) {
            return Err(MemoryError::StepLength);
        }
        if let Some(parts) = self.parts() {
            parts.leading.iter_mut().zip(formed.as_flattened()).for_each(|(place, &number)| *place = number);
        }
        Ok(())
    }

    /// Length of the state of a coordinate.
    fn stride(&self) -> usize {
        2 * self.table.rates.as_ref().len() + 2
    }

    /// Index of the state of the first coordinate.
    fn first_coordinate(&self) -> usize {
        (2 * R + 1) * self.table.rates.as_ref().len() + R * R
    }

    /// Header of the saved state: the values that must match when it is restored.
    fn shape(&self) -> Shape<3> {
        let table = self.table.borrow();
        let numbers = table.leading.iter().chain(table.rates).chain(table.coefficients);
        [
            ("coordinates", self.coordinates as u64),
            ("stages", R as u64),
            ("fingerprint of the rates", fingerprint(numbers)),
        ]
    }

    fn read(&self, from: &mut StateReader<'_>) -> Result<(usize, [T; 2]), StateError> {
        from.header::<T, 3>(TAG, &self.shape())?;
        let len = from.count_up_to("samples", usize::MAX)?;
        Ok((len, [from.number()?, from.number()?]))
    }

    fn step_length(&self) -> Result<T, MemoryError> {
        if self.length > T::zero() { Ok(self.length) } else { Err(MemoryError::StepLength) }
    }
}

/// The parts of the state.
struct Parts<'a, T> {
    /// For each block of rates c_j ((I + hλ_jA)⁻¹1)_a for every stage a, then (e_Rᵀ(I + hλ_jA)⁻¹)_a, then 1 −
    /// R(−hλ_j).
    operators: &'a mut [Lanes<T>],
    /// (A⁻¹/h)^β
    leading: &'a mut [T],
    /// For each coordinate the blocks of z_j and of their rounding errors, x_{k−1} and, for two derivatives,
    /// the last stage of (∂X)_{k−1}.
    coordinates: &'a mut [T],
}

/// Blocks of z_j, each with its rounding errors.
type Sums<T> = [[Lanes<T>; 2]];

/// The numbers of one coordinate: the blocks of z_j, and (x, v).
#[inline(always)]
fn coordinate<T>(numbers: &mut [T]) -> Option<(&mut Sums<T>, &mut [T; 2])> {
    let (sums, last) = numbers.split_last_chunk_mut::<2>()?;
    Some((sums.as_chunks_mut().0.as_chunks_mut().0, last))
}

impl<T, const R: usize, C, B> Memory<T> for VariableStepMemory<T, R, C, B>
where
    T: Real,
    C: AsRef<[T]>,
    B: AsRef<[T]> + AsMut<[T]>,
{
    fn channels(&self) -> usize {
        self.coordinates * R
    }

    fn stages(&self) -> usize {
        R
    }

    fn leading(&self) -> &[T] {
        let end = self.first_coordinate();
        part_from(part(self.state.as_ref(), end), end - R * R)
    }

    fn len(&self) -> usize {
        self.len
    }

    /// Accepts steps of at least the table's shortest that end by its horizon.
    #[inline(always)]
    fn begin_step(&mut self, length: T) -> Result<(), MemoryError> {
        let (shortest, horizon) = (self.table.shortest * (1.0 - SLACK), self.table.horizon * (1.0 + SLACK));
        let in_range = length.to_f64() >= shortest && self.elapsed_after(length)[0].to_f64() <= horizon;
        if in_range && length == self.length {
            return Ok(());
        }
        let scale = length.power(T::of(-self.table.exponent));
        // A value that is not a number is not in range.
        if !in_range || !scale.is_finite() {
            return Err(MemoryError::StepLength);
        }
        if self.table.borrow().leading.is_empty() {
            self.write_leading(length)?;
        }
        let resolvent = self.resolvent;
        let table = self.table.borrow();
        let rates = table.rates.len();
        let (operators, rest) = parts_mut(self.state.as_mut(), (2 * R + 1) * rates);
        let blocks = operators.as_chunks_mut::<LANES>().0.chunks_exact_mut(2 * R + 1);
        let rates = table.rates.as_chunks::<LANES>().0;
        let coefficients = table.coefficients.as_chunks::<LANES>().0;
        for ((block, rates), coefficients) in blocks.zip(rates).zip(coefficients) {
            let ResolventValues { mut column, row, decrement } =
                resolvent.at(rates.map(|rate| length * rate));
            for numbers in &mut column {
                numbers.iter_mut().zip(coefficients).for_each(|(number, &c)| *number *= c);
            }
            let numbers = column.into_iter().chain(row).chain([decrement]);
            block.iter_mut().zip(numbers).for_each(|(place, numbers)| *place = numbers);
        }
        for (place, &number) in rest.iter_mut().zip(table.leading) {
            *place = number * scale;
        }
        self.length = length;
        Ok(())
    }

    #[inline(always)]
    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        check_channels(self.channels(), term.len())?;
        let length = self.step_length()?;
        let (derivatives, nodes, stride) = (self.derivatives, self.nodes, self.stride());
        let Some(parts) = self.parts() else { return Err(TOO_SHORT) };
        let coordinates = parts.coordinates.chunks_exact_mut(stride);
        for (term, numbers) in term.chunks_exact_mut(R.max(1)).zip(coordinates) {
            let Some((sums, &mut [x, v])) = coordinate(numbers) else { return Err(TOO_SHORT) };
            // Contribution of a sample that continues the motion unchanged: W₀ (1 x + h c v).
            let stay = nodes.map(|node| match derivatives {
                Derivatives::None => T::zero(),
                Derivatives::One => x,
                Derivatives::Two => x + length * node * v,
            });
            let mut totals = [[T::zero(); LANES]; R];
            for (block, [z, _]) in parts.operators.chunks_exact(2 * R + 1).zip(sums) {
                for (total, output) in totals.iter_mut().zip(block) {
                    for ((total, &output), &z) in total.iter_mut().zip(output).zip(&*z) {
                        *total += output * z;
                    }
                }
            }
            let rows = parts.leading.chunks_exact(R.max(1));
            for ((place, [a, b, c, d]), row) in term.iter_mut().zip(totals).zip(rows) {
                let stay = row.iter().zip(&stay).fold(T::zero(), |sum, (&w, &x)| sum + w * x);
                *place = ((a + c) + (b + d)) - stay;
            }
        }
        Ok(())
    }

    #[inline(always)]
    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        check_channels(self.channels(), sample.len())?;
        let length = self.step_length()?;
        let (derivatives, stride) = (self.derivatives, self.stride());
        let (inverse, matrix) = (self.inverse, self.matrix);
        let Some(parts) = self.parts() else { return Err(TOO_SHORT) };
        let coordinates = parts.coordinates.chunks_exact_mut(stride);
        for (sample, numbers) in sample.chunks_exact(R.max(1)).zip(coordinates) {
            let Some((sums, [x, v])) = coordinate(numbers) else { return Err(TOO_SHORT) };
            let mut values = [T::zero(); R];
            for (value, &number) in values.iter_mut().zip(sample) {
                *value = number;
            }
            let rise = values.map(|value| value - *x);
            *x = values.last().copied().unwrap_or(T::zero());
            // h A Y
            let integrated = match derivatives {
                Derivatives::None => multiply(&matrix, &values).map(|number| number * length),
                Derivatives::One => rise,
                Derivatives::Two => {
                    let slopes = multiply(&inverse, &rise).map(|number| number / length);
                    let before = core::mem::replace(v, slopes.last().copied().unwrap_or(T::zero()));
                    slopes.map(|slope| slope - before)
                }
            };
            for (block, sums) in parts.operators.chunks_exact(2 * R + 1).zip(sums) {
                let Some((decrement, operators)) = block.split_last() else { return Err(TOO_SHORT) };
                let mut change = [T::zero(); LANES];
                for (row, &number) in operators.iter().skip(R).zip(&integrated) {
                    for (change, &factor) in change.iter_mut().zip(row) {
                        *change += factor * number;
                    }
                }
                relax(sums, decrement, &change);
            }
        }
        self.elapsed = self.elapsed_after(length);
        self.len += 1;
        Ok(())
    }

    fn clear(&mut self) {
        self.state.as_mut().fill(T::zero());
        (self.length, self.elapsed, self.len) = (T::zero(), [T::zero(); 2], 0);
    }

    fn bytes(&self) -> usize {
        let table = self.table.borrow();
        let numbers = table.leading.len() + table.rates.len() + table.coefficients.len();
        size_of::<Self>() - size_of::<B>() + (numbers + self.state.as_ref().len()) * size_of::<T>()
    }
}

impl<T, const R: usize, C, B> Stateful for VariableStepMemory<T, R, C, B>
where
    T: Real,
    C: AsRef<[T]>,
    B: AsRef<[T]> + AsMut<[T]>,
{
    fn state_bytes(&self) -> usize {
        header_bytes(4) + T::BYTES * (2 + self.stride() * self.coordinates)
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 3>(TAG, &self.shape())?;
        to.count(self.len as u64)?;
        to.numbers(&self.elapsed)?;
        to.numbers(self.state.as_ref().iter().skip(self.first_coordinate()))
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.read(from)?;
        from.skip::<T>(self.stride() * self.coordinates)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        (self.len, self.elapsed) = self.read(from)?;
        let first = self.first_coordinate();
        from.numbers(self.state.as_mut().iter_mut().skip(first))
    }
}

/// z ← R(−hλ) z + change for a block of rates, as a compensated sum.
#[inline(always)]
fn relax<T: Real>([z, lost]: &mut [Lanes<T>; 2], decrement: &Lanes<T>, change: &Lanes<T>) {
    let before = *z;
    for ((lost, (z, &change)), (&before, &decrement)) in
        lost.iter_mut().zip(z.iter_mut().zip(change)).zip(before.iter().zip(decrement))
    {
        let whole = (change - decrement * before) + *lost;
        *z = before + whole;
        *lost = whole - (*z - before);
    }
}

#[inline(always)]
fn multiply<T: Real, const R: usize>(matrix: &[[T; R]; R], vector: &[T; R]) -> [T; R] {
    matrix.map(|row| row.iter().zip(vector).fold(T::zero(), |sum, (&a, &x)| sum + a * x))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::max_or_nan;
    use std::vec;
    use std::vec::Vec;

    fn table(
        exponent: f64,
        leading: Vec<f64>,
        rates: Vec<f64>,
        coefficients: Vec<f64>,
    ) -> RateTable<Vec<f64>> {
        RateTable { exponent, leading, rates, coefficients, shortest: 1e-9, horizon: 1e9 }
    }

    fn memory<const R: usize>(
        method: &RungeKutta<R>,
        table: RateTable<Vec<f64>>,
        coordinates: usize,
    ) -> VariableStepMemory<f64, R, Vec<f64>, Vec<f64>> {
        let state = vec![0.0; table.borrow::<f64>().state_len(coordinates, R)];
        VariableStepMemory::new(method, table, coordinates, state).unwrap()
    }

    /// W₀ X + term.
    fn derivative<const R: usize>(
        memory: &mut VariableStepMemory<f64, R, Vec<f64>, Vec<f64>>,
        length: f64,
        sample: [f64; R],
    ) -> [f64; R] {
        memory.begin_step(length).unwrap();
        let mut value = [0.0; R];
        memory.next_term(&mut value).unwrap();
        for (value, row) in value.iter_mut().zip(memory.leading().chunks(R)) {
            *value += row.iter().zip(&sample).map(|(w, x)| w * x).sum::<f64>();
        }
        memory.push(&sample).unwrap();
        value
    }

    #[test]
    fn the_first_derivative_of_a_line_is_its_slope_on_any_grid() {
        let method = RungeKutta::<2>::radau_iia().unwrap();
        // A⁻¹
        let mut memory = memory(&method, table(1.0, vec![1.5, 0.5, -4.5, 2.5], vec![], vec![]), 1);
        let mut time = 0.0;
        for length in [1.0, 0.01, 30.0, 1e-6] {
            let at = |node: f64| 3.0 * (time + node * length);
            let found = derivative(&mut memory, length, [at(1.0 / 3.0), at(1.0)]);
            for slope in found {
                assert!((slope - 3.0).abs() < 1e-15 * 3.0 * (1.0 + time) / length + 1e-14, "{slope}");
            }
            time += length;
        }
        assert_eq!(memory.elapsed(), time);
    }

    #[test]
    fn a_relaxation_decays_by_the_stability_function_of_every_step() {
        // One rate λ = 2, no leading weight, β = ½: z₀ = h u·X, then z falls by 1/(1 + hλ).
        let method = RungeKutta::<1>::radau_iia().unwrap();
        let rates = vec![2.0, 0.0, 0.0, 0.0];
        let mut memory = memory(&method, table(0.5, vec![0.0], rates, vec![5.0, 0.0, 0.0, 0.0]), 1);
        assert_eq!(derivative(&mut memory, 0.5, [4.0]), [0.0]);
        // z = 4/(1 + 1) = 2; at the next step c z/(1 + hλ).
        assert!((derivative(&mut memory, 1.5, [4.0])[0] - 5.0 * 2.0 / 4.0).abs() < 1e-15);
        // Nothing moved: z = 2/4.
        assert!((derivative(&mut memory, 0.5, [4.0])[0] - 5.0 * 0.5 / 2.0).abs() < 1e-15);
    }

    #[test]
    fn lengths_outside_the_table_are_refused_and_change_nothing() {
        let method = RungeKutta::<1>::radau_iia().unwrap();
        let mut memory = memory(&method, table(1.0, vec![1.0], vec![], vec![]), 1);
        assert_eq!(memory.next_term(&mut [0.0]), Err(MemoryError::StepLength));
        assert_eq!(memory.push(&[0.0]), Err(MemoryError::StepLength));
        memory.begin_step(0.25).unwrap();
        for length in [0.0, -1.0, 1e-10, 2e9, f64::NAN, f64::INFINITY] {
            assert_eq!(memory.begin_step(length), Err(MemoryError::StepLength), "{length}");
        }
        assert_eq!(memory.leading(), [4.0]);
    }

    #[test]
    fn tables_that_cannot_be_read_are_refused() {
        let method = RungeKutta::<1>::radau_iia().unwrap();
        let good = || table(0.5, vec![1.0], vec![1.0; 4], vec![1.0; 4]);
        let refused = |table: RateTable<Vec<f64>>| {
            let state = vec![0.0; table.borrow::<f64>().state_len(1, 1)];
            VariableStepMemory::new(&method, table, 1, state).is_err()
        };
        assert!(!refused(good()));
        assert!(refused(RateTable { exponent: 2.0, ..good() }));
        assert!(refused(RateTable { leading: vec![1.0; 4], ..good() }));
        assert!(refused(RateTable { rates: vec![1.0; 8], ..good() }));
        assert!(refused(RateTable { rates: vec![1.0, 2.0, -3.0, 4.0], ..good() }));
        assert!(refused(RateTable { coefficients: vec![1.0, f64::NAN, 0.0, 0.0], ..good() }));
        assert!(refused(RateTable { shortest: 0.0, ..good() }));
        assert!(refused(RateTable { horizon: f64::INFINITY, ..good() }));
        assert!(VariableStepMemory::new(&method, good(), 1, vec![0.0; 3]).is_err());
        assert!(VariableStepMemory::new(&method, good(), 0, vec![0.0; 13]).is_err());
    }

    #[test]
    fn a_saved_state_goes_on_with_the_same_bits() {
        let method = RungeKutta::<2>::radau_iia().unwrap();
        let make = || {
            let rates = vec![0.1, 1.0, 10.0, 100.0];
            memory(&method, table(1.5, vec![1.0, 0.2, -3.0, 2.0], rates, vec![1.0; 4]), 2)
        };
        let mut first = make();
        for k in 1..20 {
            first.begin_step(0.01 * f64::from(k)).unwrap();
            first.push(&[0.1, f64::from(k), -1.0, 0.5]).unwrap();
        }
        let mut bytes = vec![0; first.state_bytes()];
        first.save(&mut StateWriter::new(&mut bytes)).unwrap();
        let mut second = make();
        second.restore(&mut StateReader::new(&bytes)).unwrap();
        assert_eq!(second.len(), 19);
        for length in [0.3, 0.3, 0.001] {
            let mut terms = [[0.0; 4]; 2];
            for (memory, term) in [&mut first, &mut second].into_iter().zip(&mut terms) {
                memory.begin_step(length).unwrap();
                memory.next_term(term).unwrap();
                memory.push(&[length, 0.0, 1.0, -length]).unwrap();
            }
            assert_eq!(terms[0].map(f64::to_bits), terms[1].map(f64::to_bits));
        }
        assert!(make().restore(&mut StateReader::new(&bytes[1..])).is_err());
    }

    /// The definition, with an inverse for each rate: the expected result of `derivative`.
    struct Definition<const R: usize> {
        table: RateTable<Vec<f64>>,
        method: RungeKutta<R>,
        sums: Vec<f64>,
        last: f64,
        speed: f64,
    }

    impl<const R: usize> Definition<R> {
        fn derivative(&mut self, length: f64, sample: [f64; R]) -> [f64; R] {
            use nalgebra::{SMatrix, SVector};
            let matrix = SMatrix::<f64, R, R>::from_fn(|a, b| self.method.matrix()[a][b]);
            let x = SVector::<f64, R>::from(sample);
            let ones = SVector::<f64, R>::repeat(1.0);
            let nodes = SVector::<f64, R>::from(*self.method.quadrature().nodes());
            let slopes = matrix.try_inverse().unwrap() * (x - ones * self.last) / length;
            let (stay, integrated) = match self.table.exponent {
                exponent if exponent <= 0.0 => (ones * 0.0, matrix * x * length),
                exponent if exponent <= 1.0 => (ones * self.last, x - ones * self.last),
                _ => (ones * self.last + nodes * (length * self.speed), slopes - ones * self.speed),
            };
            let leading = SMatrix::<f64, R, R>::from_row_slice(&self.table.leading);
            let mut value = leading * (x - stay) * length.powf(-self.table.exponent);
            let rates = self.table.rates.iter().zip(&self.table.coefficients);
            for ((&rate, &c), sum) in rates.zip(&mut self.sums) {
                let resolvent = (SMatrix::identity() + matrix * (length * rate)).try_inverse().unwrap();
                value += resolvent * ones * (c * *sum);
                *sum = (resolvent * (ones * *sum + integrated))[R - 1];
            }
            (self.last, self.speed) = (sample[R - 1], slopes[R - 1]);
            value.into()
        }
    }

    fn eight_rates(exponent: f64, stages: usize) -> RateTable<Vec<f64>> {
        let leading = (0..stages * stages).map(|i| libm::cos(i as f64) + 2.0).collect();
        let rates = vec![0.0, 0.03, 0.5, 2.0, 3.0, 40.0, 500.0, 2e4];
        table(exponent, leading, rates, vec![0.7, 1.0, -0.4, 3.0, 0.5, 2.0, -8.0, 90.0])
    }

    fn assert_definition<const R: usize>(method: &RungeKutta<R>) {
        for exponent in [-0.5, 0.0, 0.5, 1.0, 1.5] {
            let mut memory = memory(method, eight_rates(exponent, R), 2);
            assert_eq!((memory.channels(), memory.stages(), memory.len()), (2 * R, R, 0));
            let mut definitions = [0, 1].map(|_| Definition {
                table: eight_rates(exponent, R),
                method: *method,
                sums: vec![0.0; 8],
                last: 0.0,
                speed: 0.0,
            });
            for (k, length) in [0.3, 0.3, 0.01, 2.0, 2.0, 0.3, 1e-3].into_iter().enumerate() {
                let sample: [[f64; R]; 2] = core::array::from_fn(|coordinate| {
                    core::array::from_fn(|a| libm::sin((3 * k + a + 5 * coordinate) as f64))
                });
                memory.begin_step(length).unwrap();
                let mut found = vec![f64::NAN; 2 * R];
                memory.next_term(&mut found).unwrap();
                for ((found, sample), definition) in found.chunks_mut(R).zip(&sample).zip(&mut definitions) {
                    let expected = definition.derivative(length, *sample);
                    let size = expected.iter().map(|number| number.abs()).fold(1.0, max_or_nan);
                    for ((found, row), expected) in
                        found.iter_mut().zip(memory.leading().chunks(R)).zip(expected)
                    {
                        *found += row.iter().zip(sample).map(|(w, x)| w * x).sum::<f64>();
                        let error = (*found - expected).abs();
                        assert!(error <= 1e-12 * size, "β = {exponent}, {R} stages, step {k}: {error:e}");
                    }
                }
                memory.push(sample.as_flattened()).unwrap();
            }
            let wrong = Err(MemoryError::ChannelMismatch { expected: 2 * R, found: 1 });
            assert_eq!((memory.next_term(&mut [0.0]), memory.push(&[0.0])), (wrong, wrong));
        }
    }

    #[test]
    fn any_grid_has_the_derivative_that_the_definition_says() {
        assert_definition(&RungeKutta::<2>::radau_iia().unwrap());
        assert_definition(&RungeKutta::<3>::radau_iia().unwrap());
        assert_definition(&RungeKutta::<7>::radau_iia().unwrap());
        assert_definition(&RungeKutta::<4>::lobatto_iiic().unwrap());
    }

    #[test]
    fn a_hundred_thousand_roundings_do_not_gather_in_single_precision() {
        // The half integral of a constant, with a single relaxation that hardly decays: z_k = Σ h x.
        let method = RungeKutta::<1>::radau_iia().unwrap();
        let (leading, coefficients) = ([0.0f32], [1.0f32, 0.0, 0.0, 0.0]);
        let table = RateTable {
            exponent: -0.5,
            leading: &leading[..],
            rates: &[0.0f32; 4][..],
            coefficients: &coefficients[..],
            shortest: 1e-3,
            horizon: 1e5,
        };
        let mut memory =
            VariableStepMemory::new(&method, table, 1, vec![0.0; table.state_len(1, 1)]).unwrap();
        let (length, x) = (0.1f32, 0.3f32);
        for _ in 0..100_000 {
            memory.begin_step(length).unwrap();
            memory.push(&[x]).unwrap();
        }
        let time = 1e5 * f64::from(length);
        assert!((f64::from(memory.elapsed()) / time - 1.0).abs() < 1e-7, "{}", memory.elapsed());
        let mut term = [f32::NAN];
        memory.next_term(&mut term).unwrap();
        let expected = time * f64::from(x);
        assert!((f64::from(term[0]) / expected - 1.0).abs() < 2e-7, "{term:?} {expected}");
    }

    #[test]
    fn lengths_may_miss_the_table_by_the_rounding_of_a_grid() {
        let method = RungeKutta::<1>::radau_iia().unwrap();
        let table = || RateTable { shortest: 0.25, horizon: 10.0, ..eight_rates(0.5, 1) };
        let mut memory = memory(&method, table(), 1);
        for (length, accepted) in [
            (0.25 * (1.0 - 5e-7), true),
            (0.25 * (1.0 - 2e-6), false),
            (10.0 * (1.0 + 5e-7), true),
            (10.0 * (1.0 + 2e-6), false),
        ] {
            assert_eq!(memory.begin_step(length).is_ok(), accepted, "{length}");
        }
        memory.begin_step(6.0).unwrap();
        memory.push(&[1.0]).unwrap();
        assert_eq!(memory.begin_step(4.0 + 1e-4), Err(MemoryError::StepLength));
        assert_eq!(memory.begin_step(4.0), Ok(()));
        assert!(RateTable { exponent: -1.0, ..table() }.borrow::<f64>().check(1).is_err());
    }

    #[test]
    fn a_cleared_memory_begins_again_with_a_step() {
        let method = RungeKutta::<2>::radau_iia().unwrap();
        let run = |memory: &mut VariableStepMemory<f64, 2, Vec<f64>, Vec<f64>>| {
            [0.5, 0.5, 0.125].map(|length| derivative(memory, length, [length, 1.0]).map(f64::to_bits))
        };
        let mut memory = memory(&method, eight_rates(1.5, 2), 1);
        let first = run(&mut memory);
        memory.clear();
        assert_eq!((memory.len(), memory.elapsed()), (0, 0.0));
        assert_eq!(memory.next_term(&mut [0.0; 2]), Err(MemoryError::StepLength));
        assert_eq!(run(&mut memory), first);
    }

    #[test]
    fn states_of_other_rates_coordinates_and_lengths_are_refused() {
        let method = RungeKutta::<2>::radau_iia().unwrap();
        let mut own = memory(&method, eight_rates(0.5, 2), 3);
        derive_all(&mut own);
        let mut bytes = vec![0; own.state_bytes()];
        let mut writer = StateWriter::new(&mut bytes);
        own.save(&mut writer).unwrap();
        assert_eq!(writer.written(), own.state_bytes());
        let mut reader = StateReader::new(&bytes);
        assert_eq!((own.check_state(&mut reader), reader.finish()), (Ok(()), Ok(())));
        for cut in [0, 30, 40, 50, bytes.len() - 1] {
            let truncated = own.check_state(&mut StateReader::new(&bytes[..cut]));
            assert!(matches!(truncated, Err(StateError::Truncated { .. })), "{cut}");
            assert!(own.restore(&mut StateReader::new(&bytes[..cut])).is_err(), "{cut}");
        }
        let mut rates = eight_rates(0.5, 2);
        rates.rates[3] *= 1.5;
        for (mut other, what) in [
            (memory(&method, eight_rates(0.5, 2), 2), "coordinates"),
            (memory(&method, rates, 3), "fingerprint of the rates"),
        ] {
            let refused = other.restore(&mut StateReader::new(&bytes)).unwrap_err();
            assert!(
                matches!(refused, StateError::Mismatch { what: found, .. } if found == what),
                "{refused}"
            );
        }
    }

    fn derive_all(memory: &mut VariableStepMemory<f64, 2, Vec<f64>, Vec<f64>>) {
        memory.begin_step(0.5).unwrap();
        memory.push(&vec![1.0; memory.channels()]).unwrap();
    }

    #[test]
    fn bytes_are_those_of_the_object_the_table_and_the_state() {
        let method = RungeKutta::<2>::radau_iia().unwrap();
        let memory = memory(&method, eight_rates(0.5, 2), 3);
        // 8 rates and coefficients, 4 leading numbers; 5 numbers a rate, 4, and 2 · 8 + 2 a coordinate.
        let numbers = 20 + 5 * 8 + 4 + 3 * 18;
        assert_eq!(memory.bytes(), size_of_val(&memory) - size_of::<Vec<f64>>() + 8 * numbers);
        assert_eq!(memory.state_bytes(), header_bytes(4) + 8 * (2 + 3 * 18));
    }
}
