//! The memory for steps of any length in vector code.

use fvi_core::{
    ActsOn, Memory, MemoryError, ParameterError, RateTable, Resolvent, RungeKutta, Shape, StateError,
    StateReader, StateWriter, Stateful, check_channels, fingerprint, header_bytes,
};
use pulp::{Arch, Simd, WithSimd};

use crate::engines::row::{CHUNK, Row};
use crate::engines::scalar::Scalar;

/// The memory of D^β on steps of any length, as [`VariableStepMemory`](fvi_core::VariableStepMemory), in
/// vector code:
///
/// ```text
/// (D^β X)_k = (A⁻¹/h_k)^β (X_k − …) + Σ_j c_j (I + h_k λ_j A)⁻¹ 1 z_j
/// z_j      ← z_j − (1 − R(−h_k λ_j)) z_j + e_Rᵀ (I + h_k λ_j A)⁻¹ h_k A Y_k
/// ```
///
/// Terms agree with the core's to rounding; not to the last bit, because sixteen rates are processed side by
/// side and a multiply–add is rounded once on machines where that is one instruction. Bits depend on neither
/// the width
/// of vectors nor the number of channels.
///
/// For steps of constant length the sums are read once per step: while a sample is added to them, the term of
/// the next is computed. The (I + hλ_jA)⁻¹ are cached for the last few lengths, so that steps that are halved
/// and doubled cost as much as equal ones. For a new length they are rational functions with one division;
/// the decrements of the sums are computed from positive terms only.
///
/// Source: \[LFS13\], \[LFS16\].
#[derive(Clone, Debug)]
pub struct VectorVariableSteps<T: Scalar, const R: usize> {
    acts_on: ActsOn,
    shortest: f64,
    horizon: f64,
    /// −β
    scaling: T,
    derivatives: usize,
    /// Hash that distinguishes tables.
    fingerprint: u64,
    /// (A^{−β}), row by row; `None` if the leading weight follows from the relaxations.
    leading: Option<[[T; R]; R]>,
    matrix: [[T; R]; R],
    inverse: [[T; R]; R],
    nodes: [T; R],
    resolvent: Resolvent<T, R>,
    relaxations: Vec<Relaxations<T>>,
    /// Cached operators by length, those of the current step first.
    steps: Vec<Step<T, R>>,
    /// z_j, sixteen at a time, coordinate after coordinate.
    sums: Vec<Sum<T>>,
    /// x_{k−1} and, for two derivatives, the last stage of (∂X)_{k−1}, of every coordinate. The first stays
    /// zero where samples are rises.
    last: Vec<[T; 2]>,
    /// The term of the next step for every coordinate, valid if that step is as long as the previous one.
    terms: Vec<[T; R]>,
    terms_are_known: bool,
    /// True if the current step is as long as the previous one.
    steady: bool,
    /// Time of the samples so far, and its rounding error.
    elapsed: [T; 2],
    len: usize,
    unit: Arch,
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"vrat";

/// Lengths of steps that are cached: for a pair of half steps and the whole step, before and after a change
/// of length.
const KEPT: usize = 4;

/// Relative amount by which a step may be shorter than the table's shortest, or end after its horizon:
/// rounding of grids.
const SLACK: f64 = 1e-6;

/// Sixteen rates.
#[derive(Clone, Copy, Debug)]
struct Relaxations<T> {
    /// λ
    rates: Row<T>,
    /// 1/λ
    times: Row<T>,
    /// c
    coefficients: Row<T>,
}

/// Values of the relaxations for steps of one length.
#[derive(Clone, Debug)]
struct Step<T, const R: usize> {
    length: T,
    /// (A⁻¹/h)^β
    leading: [[T; R]; R],
    blocks: Vec<Operators<T, R>>,
}

/// Values for sixteen relaxations.
#[derive(Clone, Copy, Debug)]
struct Operators<T, const R: usize> {
    /// c (I + hλA)⁻¹ 1, stage by stage.
    outputs: [Row<T>; R],
    /// e_Rᵀ (I + hλA)⁻¹
    inputs: [Row<T>; R],
    /// 1 − R(−hλ)
    decrement: Row<T>,
}

/// Sixteen z_j, and their rounding errors.
#[derive(Clone, Copy, Debug)]
struct Sum<T> {
    whole: Row<T>,
    rest: Row<T>,
}

/// Sums over rates for each stage, in as many vectors as a row has; unused ones stay zero.
type Totals<T, V, const R: usize> = [[<T as crate::engines::lanes::Lanes>::Reals<V>; CHUNK]; R];

impl<T: Scalar> Relaxations<T> {
    fn new(rates: &[T], coefficients: &[T]) -> Self {
        let row = |numbers: &[T]| {
            let mut row = Row::zeros();
            row.0.iter_mut().zip(numbers).for_each(|(place, &number)| *place = number);
            row
        };
        let (rates, mut times) = (row(rates), Row::zeros());
        for (time, &rate) in times.0.iter_mut().zip(&rates.0) {
            // For a rate of 0 a number so large that its minimum with 1 is 1 in every step.
            *time = match rate > T::SMALLEST_NORMAL {
                true => T::one() / rate,
                false => T::max_value().unwrap_or(T::one()),
            };
        }
        Self { rates, times, coefficients: row(coefficients) }
    }
}

impl<T: Scalar, const R: usize> Operators<T, R> {
    fn zeros() -> Self {
        Self { outputs: [Row::zeros(); R], inputs: [Row::zeros(); R], decrement: Row::zeros() }
    }

    /// Computes the operators for a length and its reciprocal.
    ///
    /// Polynomials are evaluated as homogeneous forms of (x, 1), x = hλ, up to x = 1, and of (1, 1/x) beyond,
    /// so that nothing overflows.
    #[inline(always)]
    fn set<V: Simd>(
        &mut self,
        unit: V,
        resolvent: &Resolvent<T, R>,
        decrement: [T; R],
        relaxations: &Relaxations<T>,
        [length, reciprocal]: [T; 2],
    ) {
        let (length, reciprocal) = (T::in_lanes(unit, length), T::in_lanes(unit, reciprocal));
        let one = T::in_lanes(unit, T::one());
        let rates = relaxations.rates.parts::<V>().iter().zip(relaxations.times.parts::<V>());
        for (part, ((&rate, &time), &c)) in rates.zip(relaxations.coefficients.parts::<V>()).enumerate() {
            let high = T::smaller(unit, one, T::times(unit, length, rate));
            let low = T::smaller(unit, one, T::times(unit, reciprocal, time));
            // high^k low^{R−1−k}
            let mut powers = [one; R];
            for k in 1..R {
                for (i, power) in powers.iter_mut().enumerate() {
                    *power = T::times(unit, if i >= k { high } else { low }, *power);
                }
            }
            let above = form(unit, &powers, |k| resolvent.determinant()[k]);
            let determinant = T::plus_product(unit, high, above, T::times(unit, low, powers[0]));
            let inverse = T::quotient(unit, one, determinant);
            let lost = form(unit, &powers, |k| decrement[k]);
            self.decrement.parts_mut::<V>()[part] = T::times(unit, T::times(unit, high, inverse), lost);
            let factor = T::times(unit, low, inverse);
            let scaled = T::times(unit, c, factor);
            for a in 0..R {
                let output = form(unit, &powers, |k| resolvent.columns()[k][a]);
                let input = form(unit, &powers, |k| resolvent.rows()[k][a]);
                self.outputs[a].parts_mut::<V>()[part] = T::times(unit, scaled, output);
                self.inputs[a].parts_mut::<V>()[part] = T::times(unit, factor, input);
            }
        }
    }

    /// Lets the sums decay, and adds h A Y.
    #[inline(always)]
    fn absorb<V: Simd>(&self, unit: V, sum: &mut Sum<T>, sample: &[T::Reals<V>; R]) {
        let sums = sum.whole.parts_mut::<V>().iter_mut().zip(sum.rest.parts_mut::<V>());
        for (part, ((whole, rest), &decrement)) in sums.zip(self.decrement.parts::<V>()).enumerate() {
            let before = *whole;
            let mut change = *rest;
            for (inputs, &number) in self.inputs.iter().zip(sample) {
                change = T::plus_product(unit, inputs.parts::<V>()[part], number, change);
            }
            change = T::minus_product(unit, decrement, before, change);
            *whole = T::plus(unit, before, change);
            *rest = T::minus(unit, change, T::minus(unit, *whole, before));
        }
    }

    /// Adds the contribution of the sums.
    #[inline(always)]
    fn emit<V: Simd>(&self, unit: V, sum: &Sum<T>, totals: &mut Totals<T, V, R>) {
        for (totals, outputs) in totals.iter_mut().zip(&self.outputs) {
            let parts = outputs.parts::<V>().iter().zip(sum.whole.parts::<V>());
            for (total, (&output, &whole)) in totals.iter_mut().zip(parts) {
                *total = T::plus_product(unit, output, whole, *total);
            }
        }
    }
}

impl<T: Scalar, const R: usize> Step<T, R> {
    /// The memory term: the contribution of the sums minus that of a sample that continues the motion
    /// unchanged, W₀ (1 x + h c v).
    #[inline(always)]
    fn term<V: Simd>(&self, unit: V, totals: &Totals<T, V, R>, stay: [T; R]) -> [T; R] {
        let mut term = [T::zero(); R];
        for (term, (totals, row)) in term.iter_mut().zip(totals.iter().zip(&self.leading)) {
            *term = sum_of_lanes::<T, V>(unit, *totals) - dot(row, &stay);
        }
        term
    }
}

/// Σ_k coefficient_k powers_k
#[inline(always)]
fn form<T: Scalar, V: Simd, const R: usize>(
    unit: V,
    powers: &[T::Reals<V>; R],
    coefficient: impl Fn(usize) -> T,
) -> T::Reals<V> {
    let mut sum = T::in_lanes(unit, T::zero());
    for (k, &power) in powers.iter().enumerate() {
        sum = T::plus_product(unit, T::in_lanes(unit, coefficient(k)), power, sum);
    }
    sum
}

/// Adds halves to each other until one number is left: the same order of additions for vectors of any width.
#[inline(always)]
fn sum_of_lanes<T: Scalar, V: Simd>(unit: V, mut totals: [T::Reals<V>; CHUNK]) -> T {
    let mut row = Row::zeros();
    let mut parts = row.parts::<V>().len();
    let mut lanes = CHUNK / parts;
    while parts > 1 {
        parts /= 2;
        for part in 0..parts {
            totals[part] = T::plus(unit, totals[part], totals[part + parts]);
        }
    }
    row.parts_mut::<V>()[0] = totals[0];
    while lanes > 1 {
        lanes /= 2;
        for lane in 0..lanes {
            row.0[lane] += row.0[lane + lanes];
        }
    }
    row.0[0]
}

#[inline(always)]
fn dot<T: Scalar, const R: usize>(row: &[T; R], vector: &[T; R]) -> T {
    row.iter().zip(vector).fold(T::zero(), |sum, (&a, &x)| sum + a * x)
}

/// The matrix of these entries.
fn matrix_of<T: Scalar, const R: usize>(entry: impl Fn(usize, usize) -> T) -> [[T; R]; R] {
    let mut matrix = [[T::zero(); R]; R];
    for (a, row) in matrix.iter_mut().enumerate() {
        row.iter_mut().enumerate().for_each(|(b, number)| *number = entry(a, b));
    }
    matrix
}

impl<T: Scalar, const R: usize> VectorVariableSteps<T, R> {
    /// A memory on `coordinates` coordinates without samples.
    ///
    /// # Errors
    /// If the table is not one for R stages, its numbers are not finite or out of range, or there are no
    /// coordinates.
    pub fn new(
        method: &RungeKutta<R>,
        table: &RateTable<&[T]>,
        coordinates: usize,
    ) -> Result<Self, ParameterError> {
        table.check(R)?;
        if coordinates == 0 {
            return Err(ParameterError { parameter: "coordinates", value: 0.0, allowed: "at least 1" });
        }
        let inverse = method.inverse()?;
        let mut nodes = [T::zero(); R];
        nodes.iter_mut().zip(method.quadrature().nodes()).for_each(|(node, &c)| *node = T::of(c));
        let numbers = table.leading.iter().chain(table.rates).chain(table.coefficients);
        let chunks = table.rates.chunks(CHUNK).zip(table.coefficients.chunks(CHUNK));
        let relaxations: Vec<_> = chunks.map(|(rates, c)| Relaxations::new(rates, c)).collect();
        let blocks = relaxations.len();
        let step = Step {
            length: T::zero(),
            leading: [[T::zero(); R]; R],
            blocks: vec![Operators::zeros(); blocks],
        };
        Ok(Self {
            acts_on: ActsOn::Values,
            shortest: table.shortest,
            horizon: table.horizon,
            scaling: T::of(-table.exponent),
            derivatives: table.exponent.ceil().max(0.0) as usize,
            fingerprint: fingerprint(numbers),
            leading: (!table.leading.is_empty()).then(|| matrix_of(|a, b| table.leading[a * R + b])),
            matrix: matrix_of(|a, b| T::of(method.matrix()[a][b])),
            inverse: matrix_of(|a, b| T::of(inverse[a][b])),
            nodes,
            resolvent: Resolvent::new(method),
            relaxations,
            steps: vec![step; KEPT],
            sums: vec![Sum { whole: Row::zeros(), rest: Row::zeros() }; blocks * coordinates],
            last: vec![[T::zero(); 2]; coordinates],
            terms: vec![[T::zero(); R]; coordinates],
            terms_are_known: false,
            steady: false,
            elapsed: [T::zero(); 2],
            len: 0,
            unit: Arch::new(),
        })
    }

    /// The same memory for rises X_k − 1 x_{k−1} in place of values, if it is one of a derivative: it forms
    /// the rises of values itself, with a rounding error of u|x|. It does not accept increments, nor rises
    /// for an integral, and is unchanged then.
    pub fn acting_on(self, acts_on: ActsOn) -> Self {
        match acts_on {
            ActsOn::Rises if self.derivatives > 0 => Self { acts_on, ..self },
            _ => self,
        }
    }

    /// Header of the saved state: the values that must match when it is restored.
    fn shape(&self) -> Shape<3> {
        [
            ("coordinates", self.last.len() as u64),
            ("stages", R as u64),
            ("fingerprint of the rates", self.fingerprint),
        ]
    }

    fn read(&self, from: &mut StateReader<'_>) -> Result<(usize, [T; 2]), StateError> {
        from.header::<T, 3>(TAG, &self.shape())?;
        let len = from.count_up_to("samples", usize::MAX)?;
        Ok((len, [from.number()?, from.number()?]))
    }

    /// The time after a step of the given length, as a compensated sum.
    fn elapsed_after(&self, length: T) -> [T; 2] {
        let [before, lost] = self.elapsed;
        let whole = length + lost;
        let after = before + whole;
        [after, whole - (after - before)]
    }

    /// The operators of the current step, if its length is known.
    fn step(&self) -> Result<&Step<T, R>, MemoryError> {
        self.steps.first().filter(|step| step.length > T::zero()).ok_or(MemoryError::StepLength)
    }

    /// W₀ of a step.
    fn leading_of(&self, length: T) -> [[T; R]; R] {
        if let Some(leading) = &self.leading {
            let scale = length.power(self.scaling);
            return matrix_of(|a, b| leading[a][b] * scale);
        }
        let relaxations =
            self.relaxations.iter().flat_map(|block| block.rates.0.iter().zip(&block.coefficients.0));
        let relaxations = relaxations.map(|(&rate, &c)| (rate, c));
        self.resolvent.leading([&self.matrix, &self.inverse], self.derivatives, length, relaxations)
    }

    /// A sample that continues the motion unchanged.
    #[inline(always)]
    fn stay(derivatives: usize, length: T, nodes: &[T; R], [x, v]: [T; 2]) -> [T; R] {
        let mut stay = [T::zero(); R];
        for (stay, &node) in stay.iter_mut().zip(nodes) {
            *stay = match derivatives {
                0 => T::zero(),
                1 => x,
                _ => x + length * node * v,
            };
        }
        stay
    }

    /// Computes the terms of the current step.
    #[inline(always)]
    fn form_terms<V: Simd>(&mut self, unit: V) {
        let (step, blocks) = (&self.steps[0], self.relaxations.len());
        for (index, (term, &last)) in self.terms.iter_mut().zip(&self.last).enumerate() {
            let mut totals = [[T::in_lanes(unit, T::zero()); CHUNK]; R];
            for (block, sum) in step.blocks.iter().zip(&self.sums[index * blocks..]) {
                block.emit(unit, sum, &mut totals);
            }
            *term = step.term(unit, &totals, Self::stay(self.derivatives, step.length, &self.nodes, last));
        }
        self.terms_are_known = true;
    }

    /// Adds a sample, and computes the terms of the next one if the length of the steps is constant.
    #[inline(always)]
    fn take<V: Simd>(&mut self, unit: V, sample: &[T]) {
        let (step, blocks, steady) = (&self.steps[0], self.relaxations.len(), self.steady);
        let are_rises = self.acts_on == ActsOn::Rises;
        let coordinates = sample.as_chunks::<R>().0.iter().zip(&mut self.last).zip(&mut self.terms);
        for (index, ((values, [x, v]), term)) in coordinates.enumerate() {
            let mut rise = *values;
            if !are_rises {
                rise.iter_mut().for_each(|value| *value -= *x);
                *x = values[R - 1];
            }
            // h A Y
            let mut integrated = rise;
            match self.derivatives {
                0 => {
                    for (number, row) in integrated.iter_mut().zip(&self.matrix) {
                        *number = dot(row, values) * step.length;
                    }
                }
                1 => {}
                _ => {
                    for (slope, row) in integrated.iter_mut().zip(&self.inverse) {
                        *slope = dot(row, &rise) / step.length;
                    }
                    let before = core::mem::replace(v, integrated[R - 1]);
                    integrated.iter_mut().for_each(|slope| *slope -= before);
                }
            }
            let mut sample = [T::in_lanes(unit, T::zero()); R];
            for (number, &integrated) in sample.iter_mut().zip(&integrated) {
                *number = T::in_lanes(unit, integrated);
            }
            let sums = self.sums[index * blocks..].iter_mut();
            if !steady {
                for (block, sum) in step.blocks.iter().zip(sums) {
                    block.absorb(unit, sum, &sample);
                }
                continue;
            }
            let mut totals = [[T::in_lanes(unit, T::zero()); CHUNK]; R];
            for (block, sum) in step.blocks.iter().zip(sums) {
                block.absorb(unit, sum, &sample);
                block.emit(unit, sum, &mut totals);
            }
            *term =
                step.term(unit, &totals, Self::stay(self.derivatives, step.length, &self.nodes, [*x, *v]));
        }
        self.terms_are_known = steady;
    }
}

/// Computes the operators of the current step: a call that is compiled once for every vector unit.
struct SetOperators<'a, T: Scalar, const R: usize>(&'a mut VectorVariableSteps<T, R>);

impl<T: Scalar, const R: usize> WithSimd for SetOperators<'_, T, R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, unit: V) {
        let Self(memory) = self;
        let step = &mut memory.steps[0];
        let lengths = [step.length, T::one() / step.length];
        let decrement = memory.resolvent.decrement();
        for (block, relaxations) in step.blocks.iter_mut().zip(&memory.relaxations) {
            block.set(unit, &memory.resolvent, decrement, relaxations, lengths);
        }
    }
}

/// Computes the terms, likewise.
struct FormTerms<'a, T: Scalar, const R: usize>(&'a mut VectorVariableSteps<T, R>);

impl<T: Scalar, const R: usize> WithSimd for FormTerms<'_, T, R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, unit: V) {
        self.0.form_terms(unit);
    }
}

/// Adds a sample, likewise.
struct Take<'a, T: Scalar, const R: usize>(&'a mut VectorVariableSteps<T, R>, &'a [T]);

impl<T: Scalar, const R: usize> WithSimd for Take<'_, T, R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, unit: V) {
        self.0.take(unit, self.1);
    }
}

impl<T: Scalar, const R: usize> Memory<T> for VectorVariableSteps<T, R> {
    fn channels(&self) -> usize {
        self.last.len() * R
    }

    fn stages(&self) -> usize {
        R
    }

    fn acts_on(&self) -> ActsOn {
        self.acts_on
    }

    fn leading(&self) -> &[T] {
        self.steps[0].leading.as_flattened()
    }

    fn len(&self) -> usize {
        self.len
    }

    /// Accepts steps of at least the table's shortest that end by its horizon.
    fn begin_step(&mut self, length: T) -> Result<(), MemoryError> {
        let (shortest, horizon) = (self.shortest * (1.0 - SLACK), self.horizon * (1.0 + SLACK));
        let in_range = length.to_f64() >= shortest && self.elapsed_after(length)[0].to_f64() <= horizon;
        if in_range && length == self.steps[0].length {
            self.steady = true;
            return Ok(());
        }
        // A value that is not a number is not in range.
        if !in_range {
            return Err(MemoryError::StepLength);
        }
        let kept = self.steps.iter().position(|step| step.length == length);
        if kept.is_none() {
            let leading = self.leading_of(length);
            if !leading.as_flattened().iter().all(|number| number.is_finite()) {
                return Err(MemoryError::StepLength);
            }
            // Replaces the operators that have not been used for longest.
            if let Some(step) = self.steps.last_mut() {
                (step.length, step.leading) = (length, leading);
            }
        }
        self.steps[..=kept.unwrap_or(KEPT - 1)].rotate_right(1);
        (self.steady, self.terms_are_known) = (false, false);
        if kept.is_none() {
            self.unit.dispatch(SetOperators(self));
        }
        Ok(())
    }

    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        check_channels(self.channels(), term.len())?;
        self.step()?;
        if !self.terms_are_known {
            self.unit.dispatch(FormTerms(self));
        }
        term.copy_from_slice(self.terms.as_flattened());
        Ok(())
    }

    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        check_channels(self.channels(), sample.len())?;
        let length = self.step()?.length;
        self.unit.dispatch(Take(self, sample));
        // Unless another length is announced the next step has this one.
        self.steady = true;
        self.elapsed = self.elapsed_after(length);
        self.len += 1;
        Ok(())
    }

    fn clear(&mut self) {
        self.sums.fill(Sum { whole: Row::zeros(), rest: Row::zeros() });
        self.last.fill([T::zero(); 2]);
        // There is no current step until one is announced.
        self.steps.iter_mut().for_each(|step| step.length = T::zero());
        (self.steady, self.terms_are_known) = (false, false);
        (self.elapsed, self.len) = ([T::zero(); 2], 0);
    }

    fn bytes(&self) -> usize {
        let blocks = |step: &Step<T, R>| size_of_val(step) + size_of_val(step.blocks.as_slice());
        size_of::<Self>()
            + size_of_val(self.relaxations.as_slice())
            + self.steps.iter().map(blocks).sum::<usize>()
            + size_of_val(self.sums.as_slice())
            + size_of_val(self.last.as_slice())
            + size_of_val(self.terms.as_slice())
    }
}

impl<T: Scalar, const R: usize> Stateful for VectorVariableSteps<T, R> {
    fn state_bytes(&self) -> usize {
        let numbers = 2 + 2 * CHUNK * self.sums.len() + 2 * self.last.len();
        header_bytes(4) + T::BYTES * numbers
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 3>(TAG, &self.shape())?;
        to.count(self.len as u64)?;
        to.numbers(&self.elapsed)?;
        for sum in &self.sums {
            to.numbers(sum.whole.0.iter().chain(&sum.rest.0))?;
        }
        to.numbers(self.last.as_flattened())
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.read(from)?;
        from.skip::<T>(2 * CHUNK * self.sums.len() + 2 * self.last.len())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        (self.len, self.elapsed) = self.read(from)?;
        for sum in &mut self.sums {
            from.numbers(sum.whole.0.iter_mut().chain(&mut sum.rest.0))?;
        }
        from.numbers(self.last.as_flattened_mut())?;
        self.terms_are_known = false;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_core::max_or_nan;

    fn memory<T: Scalar, const R: usize>(method: &RungeKutta<R>) -> VectorVariableSteps<T, R> {
        let rates: Vec<T> = (0..20).map(|j| T::of(if j == 0 { 0.0 } else { 10f64.powi(j - 12) })).collect();
        let coefficients: Vec<T> = (0..20).map(|j| T::of(1.0 + f64::from(j))).collect();
        let leading: Vec<T> = (0..R * R).map(|i| T::of(i as f64)).collect();
        let table = RateTable {
            exponent: 1.5,
            leading: leading.as_slice(),
            rates: &rates,
            coefficients: &coefficients,
            shortest: 1e-9,
            horizon: 1e9,
        };
        VectorVariableSteps::new(method, &table, 1).unwrap()
    }

    /// The operators against (I + xA) g = 1 and (I + xA)ᵀ u = e_R, for x from 10⁻¹⁶ to 10¹⁵.
    fn assert_operators<T: Scalar, const R: usize>(method: &RungeKutta<R>) {
        let mut memory = memory::<T, R>(method);
        for length in [1e-4, 0.3, 1e8] {
            memory.begin_step(T::of(length)).unwrap();
            let (tolerance, length) = (16.0 * T::EPSILON.to_f64(), T::of(length).to_f64());
            for (block, relaxations) in memory.steps[0].blocks.iter().zip(&memory.relaxations) {
                for lane in 0..CHUNK {
                    let c = relaxations.coefficients.0[lane].to_f64();
                    if c == 0.0 {
                        assert!(block.outputs.iter().all(|row| row.0[lane].to_f64() == 0.0));
                        continue;
                    }
                    let x = length * relaxations.rates.0[lane].to_f64();
                    let g = block.outputs.map(|row| row.0[lane].to_f64() / c);
                    let u = block.inputs.map(|row| row.0[lane].to_f64());
                    for i in 0..R {
                        let (mut left, mut size) = (g[i] - 1.0, 1.0);
                        let (mut right, mut right_size) = (u[i] - f64::from(u8::from(i == R - 1)), 1.0);
                        for j in 0..R {
                            let (forth, back) =
                                (x * method.matrix()[i][j] * g[j], x * method.matrix()[j][i] * u[j]);
                            (left, right) = (left + forth, right + back);
                            (size, right_size) = (size + forth.abs(), right_size + back.abs());
                        }
                        assert!(left.abs() < tolerance * size, "{R} stages, x = {x:e}: {left:e}");
                        assert!(right.abs() < tolerance * right_size, "{R} stages, x = {x:e}: {right:e}");
                    }
                    let decrement = block.decrement.0[lane].to_f64();
                    assert!((decrement - (1.0 - g[R - 1])).abs() < tolerance);
                    if x < 1e-9 {
                        assert!((decrement - x).abs() <= (tolerance + x) * x, "{decrement:e} for x = {x:e}");
                    }
                }
            }
        }
    }

    #[test]
    fn operators_solve_their_equations_at_any_rate() {
        assert_operators::<f64, 1>(&RungeKutta::radau_iia().unwrap());
        assert_operators::<f64, 2>(&RungeKutta::radau_iia().unwrap());
        assert_operators::<f64, 3>(&RungeKutta::radau_iia().unwrap());
        assert_operators::<f64, 2>(&RungeKutta::lobatto_iiic().unwrap());
        assert_operators::<f64, 3>(&RungeKutta::lobatto_iiic().unwrap());
        assert_operators::<f64, 4>(&RungeKutta::lobatto_iiic().unwrap());
        assert_operators::<f32, 3>(&RungeKutta::radau_iia().unwrap());
        assert_operators::<f32, 4>(&RungeKutta::lobatto_iiic().unwrap());
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn the_width_of_vectors_changes_no_bit() {
        use pulp::x86::{V3, V4};
        let units = [V3::try_new().map(Arch::V3), V4::try_new().map(Arch::V4)];
        let terms = units.into_iter().flatten().map(|unit| {
            let mut memory =
                VectorVariableSteps { unit, ..memory::<f64, 3>(&RungeKutta::radau_iia().unwrap()) };
            let mut terms = Vec::new();
            for k in 0..40 {
                memory.begin_step([0.3, 0.3, 1e-3, 7.0][k / 5 % 4]).unwrap();
                let mut term = [0.0; 3];
                memory.next_term(&mut term).unwrap();
                memory.push(&[k as f64, 1.0 / (1.0 + k as f64), (k as f64).sin()]).unwrap();
                terms.extend(term.map(f64::to_bits));
            }
            terms
        });
        let terms: Vec<_> = terms.collect();
        assert!(terms.windows(2).all(|pair| pair[0] == pair[1]));
    }

    fn rate_table<T: Scalar>(exponent: f64, stages: usize) -> RateTable<Vec<T>> {
        let of = |numbers: Vec<f64>| numbers.into_iter().map(T::of).collect::<Vec<T>>();
        RateTable {
            exponent,
            leading: of((0..stages * stages).map(|i| 2.0 + (i as f64).cos()).collect()),
            rates: of((0..20)
                .map(|j| if j == 0 { 0.0 } else { 10f64.powf(0.5 * f64::from(j) - 4.0) })
                .collect()),
            coefficients: of((0..20).map(|j| 1.0 + f64::from(j)).collect()),
            shortest: 1e-6,
            horizon: 1e6,
        }
    }

    const LENGTHS: [f64; 14] = [0.3, 0.3, 0.3, 0.01, 0.02, 0.01, 2.0, 2.0, 0.3, 5.0, 1e-3, 7.0, 0.3, 0.3];

    fn sample<const R: usize>(k: usize, coordinates: usize) -> Vec<f64> {
        (0..coordinates * R).map(|channel| (3.0 * k as f64 + channel as f64).sin()).collect()
    }

    fn assert_core<const R: usize>(method: &RungeKutta<R>) {
        for exponent in [-0.5, 0.0, 0.5, 1.0, 1.5] {
            let table = rate_table::<f64>(exponent, R);
            let view = table.borrow();
            let mut memory = VectorVariableSteps::new(method, &view, 2).unwrap();
            let state = vec![0.0; view.state_len(2, R)];
            let mut core = fvi_core::VariableStepMemory::new(method, view, 2, state).unwrap();
            assert_eq!((memory.channels(), memory.stages(), memory.is_empty()), (2 * R, R, true));
            for round in 0..2 {
                for (k, length) in LENGTHS.into_iter().enumerate() {
                    core.begin_step(length).unwrap();
                    // A step as long as the one before needs no announcement.
                    if round == 0 || k == 0 || length != LENGTHS[k - 1] {
                        memory.begin_step(length).unwrap();
                    }
                    assert_eq!(memory.leading(), core.leading());
                    let (mut found, mut expected) = (vec![f64::NAN; 2 * R], vec![f64::NAN; 2 * R]);
                    memory.next_term(&mut found).unwrap();
                    core.next_term(&mut expected).unwrap();
                    let size = expected.iter().map(|number| number.abs()).fold(1.0, max_or_nan);
                    for (found, expected) in found.iter().zip(&expected) {
                        let error = (found - expected).abs();
                        assert!(error <= 1e-10 * size, "β = {exponent}, {R} stages, step {k}: {error:e}");
                    }
                    memory.push(&sample::<R>(k, 2)).unwrap();
                    core.push(&sample::<R>(k, 2)).unwrap();
                    assert_eq!(memory.len(), k + 1);
                }
                memory.clear();
                core.clear();
                assert!(memory.is_empty());
                assert_eq!(memory.next_term(&mut vec![0.0; 2 * R]), Err(MemoryError::StepLength));
                assert_eq!(memory.push(&vec![0.0; 2 * R]), Err(MemoryError::StepLength));
            }
            let wrong = Err(MemoryError::ChannelMismatch { expected: 2 * R, found: 1 });
            assert_eq!((memory.next_term(&mut [0.0]), memory.push(&[0.0])), (wrong, wrong));
        }
    }

    #[test]
    fn terms_are_those_of_the_core_on_any_grid() {
        assert_core::<1>(&RungeKutta::radau_iia().unwrap());
        assert_core::<3>(&RungeKutta::radau_iia().unwrap());
        assert_core::<2>(&RungeKutta::lobatto_iiic().unwrap());
    }

    #[test]
    fn a_saved_state_goes_on_with_the_same_bits_and_others_are_refused() {
        let method = RungeKutta::<2>::radau_iia().unwrap();
        let table = rate_table::<f64>(1.5, 2);
        let build = |coordinates| VectorVariableSteps::new(&method, &table.borrow(), coordinates).unwrap();
        let mut memory = build(3);
        // Two numbers for the time; two parts of 20 rates, padded to 32, and two numbers for each coordinate.
        assert_eq!(memory.state_bytes(), header_bytes(4) + 8 * (2 + 3 * (2 * 32 + 2)));
        for (k, length) in LENGTHS.into_iter().enumerate() {
            let mut bytes = vec![0; memory.state_bytes()];
            let mut writer = StateWriter::new(&mut bytes);
            memory.save(&mut writer).unwrap();
            assert_eq!(writer.written(), memory.state_bytes());
            let mut restored = build(3);
            for cut in [0, 4, 36, 44, 60, bytes.len() - 1] {
                assert!(restored.check_state(&mut StateReader::new(&bytes[..cut])).is_err(), "{cut}");
                assert!(restored.restore(&mut StateReader::new(&bytes[..cut])).is_err(), "{cut}");
            }
            let (mut checked, mut reader) = (StateReader::new(&bytes), StateReader::new(&bytes));
            assert_eq!((restored.check_state(&mut checked), checked.finish()), (Ok(()), Ok(())));
            assert_eq!((restored.restore(&mut reader), reader.finish()), (Ok(()), Ok(())));
            assert_eq!((restored.len(), restored.elapsed), (k, memory.elapsed));
            let refused = build(2).restore(&mut StateReader::new(&bytes));
            let mismatch = StateError::Mismatch { what: "coordinates", expected: 2, found: 3 };
            assert_eq!(refused, Err(mismatch));
            let other = rate_table::<f64>(1.5, 2);
            let other = RateTable { coefficients: other.rates.clone(), ..other };
            let mut other = VectorVariableSteps::new(&method, &other.borrow(), 3).unwrap();
            assert!(matches!(other.restore(&mut StateReader::new(&bytes)), Err(StateError::Mismatch { .. })));
            let mut terms = [[f64::NAN; 6]; 2];
            for (memory, term) in [&mut memory, &mut restored].into_iter().zip(&mut terms) {
                memory.begin_step(length).unwrap();
                memory.next_term(term).unwrap();
            }
            assert_eq!(terms[0].map(f64::to_bits), terms[1].map(f64::to_bits), "{k}");
            memory.push(&sample::<2>(k, 3)).unwrap();
        }
    }

    #[test]
    fn lengths_may_miss_the_table_by_the_rounding_of_a_grid() {
        let method = RungeKutta::<1>::radau_iia().unwrap();
        let table = RateTable { shortest: 0.25, horizon: 10.0, ..rate_table::<f64>(0.5, 1) };
        let mut memory = VectorVariableSteps::new(&method, &table.borrow(), 1).unwrap();
        for (length, accepted) in [
            (0.25 * (1.0 - 5e-7), true),
            (0.25 * (1.0 - 2e-6), false),
            (10.0 * (1.0 + 5e-7), true),
            (10.0 * (1.0 + 2e-6), false),
            (f64::NAN, false),
        ] {
            assert_eq!(memory.begin_step(length).is_ok(), accepted, "{length}");
        }
        memory.begin_step(6.0).unwrap();
        memory.push(&[1.0]).unwrap();
        assert_eq!(memory.begin_step(4.0 + 1e-4), Err(MemoryError::StepLength));
        assert_eq!(memory.begin_step(4.0), Ok(()));
        assert_eq!(
            VectorVariableSteps::new(&method, &table.borrow(), 0).unwrap_err().parameter,
            "coordinates"
        );
    }

    #[test]
    fn a_hundred_thousand_roundings_do_not_gather_in_single_precision() {
        // A relaxation that does not decay, under the half integral: z_k = Σ h x.
        let method = RungeKutta::<1>::radau_iia().unwrap();
        let table = RateTable {
            exponent: -0.5,
            leading: &[0.0f32][..],
            rates: &[0.0; 4],
            coefficients: &[1.0, 0.0, 0.0, 0.0],
            shortest: 1e-3,
            horizon: 1e5,
        };
        let mut memory = VectorVariableSteps::new(&method, &table, 1).unwrap();
        let (length, x) = (0.1f32, 0.3f32);
        memory.begin_step(length).unwrap();
        for _ in 0..100_000 {
            memory.push(&[x]).unwrap();
        }
        let time = 1e5 * f64::from(length);
        assert!((f64::from(memory.elapsed[0]) / time - 1.0).abs() < 1e-7, "{:?}", memory.elapsed);
        let mut term = [f32::NAN];
        memory.next_term(&mut term).unwrap();
        let expected = time * f64::from(x);
        assert!((f64::from(term[0]) / expected - 1.0).abs() < 2e-7, "{term:?} {expected}");
    }

    #[test]
    fn bytes_are_those_of_rates_operators_and_sums() {
        let method = RungeKutta::<2>::radau_iia().unwrap();
        let memory = VectorVariableSteps::new(&method, &rate_table::<f64>(0.5, 2).borrow(), 3).unwrap();
        // Rows of 16 numbers in 2 blocks: rates, operators of four lengths, sums; then numbers per
        // coordinate.
        let rows = 2 * (3 + 4 * 5 + 2 * 3);
        let steps = 4 * size_of::<Step<f64, 2>>();
        let numbers = 16 * rows + 2 * 3 + 2 * 3;
        assert_eq!(memory.bytes(), size_of::<VectorVariableSteps<f64, 2>>() + steps + 8 * numbers);
    }
}
