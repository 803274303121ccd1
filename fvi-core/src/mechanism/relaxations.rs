//! Memory along elongations: relaxations that a Gauss method integrates with the motion.

use crate::error::ParameterError;
use crate::linear::{all_finite, at, factor, substitute};
use crate::mechanism::gauss_lobatto::{GaussLobatto, MOST_STAGES};
use crate::mechanism::lagrangian::Dampers;
use crate::memory::MemoryError;
use crate::real::Real;
use crate::saving::{Shape, StateError, StateReader, StateWriter, Stateful, fingerprint, header_bytes};
use crate::space::{part, part_from, part_mut, parts_mut};

/// Kind of the saved state.
const TAG: [u8; 4] = *b"relx";

/// Relative amount by which a step may be shorter than the shortest, or end after the horizon: rounding.
const SLACK: f64 = 1e-6;

/// A kernel K as a sum of relaxations in continuous time, K(s) = s^d Σ_j c_j/(s + λ_j) with d = 1 or 2.
///
/// It serves steps of at least `shortest` up to the time `horizon`, both in units of time. A spring is a rate
/// 0, a dashpot a rate far above that of the shortest step. `C` is any container of numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelaxationTable<C> {
    /// True if d = 2: kernels that grow faster than s.
    pub is_inertial: bool,
    /// λ_j ≥ 0.
    pub rates: C,
    /// c_j.
    pub coefficients: C,
    /// The shortest step.
    pub shortest: f64,
    /// The longest time from the start.
    pub horizon: f64,
}

/// Rate times shortest step above which a relaxation is a dashpot.
const DASHPOT: f64 = 1e9;

/// λh from which a relaxation is too fast for a step: what a Gauss method does to slower ones is part of its
/// error of order 2s.
const FAST: f64 = 0.3;

/// Numbers per rate and step length, besides two for each stage: 1 − R(−x), e^{−x}, R(−x) − e^{−x}.
const DECAYS: usize = 3;

/// Dampers of one kernel along neighbouring elongations: f = ρ (Z ∗ W) with Z(s) = K(s)/s and a matrix ρ.
///
/// ```text
/// y_j ← R(−hλ_j) y_j + h bᵀ(I + hλ_jA)⁻¹ W ,      f = Σ_j c_j Y_j  (d = 1) ,  Σ_j c_j (W − λ_j Y_j)  (d = 2)
/// ```
///
/// with the stages Y_j of y_j' = W − λ_j y_j, integrated by the Gauss method (A, b) of the step. If all c_j
/// are positive, the work h Σ b_i W_iᵀ f_i of a step is at least the rise of the stored energy
/// Σ_j ½ c_j y_jᵀ ρ y_j (d = 1; Σ_j ½ c_j λ_j y_jᵀ ρ y_j for d = 2), whatever the step and the motion, since
/// the method is algebraically stable. With d = 2 the samples are W − W₀, as Caputo's derivative has it.
///
/// `B` is a buffer of [`numbers`](Relaxing::numbers) numbers. Sources: \[LFS16\] for the relaxations,
/// \[BurrageButcher79\] for the stability.
#[derive(Clone, Debug)]
pub struct Relaxing<T, C, B> {
    rule: GaussLobatto<T>,
    table: RelaxationTable<C>,
    /// Number of elongations.
    count: usize,
    /// ρ, row by row.
    coefficient: C,
    numbers: B,
    /// Length of the steps that the operators are for; zero at first.
    length: f64,
    elapsed: f64,
}

/// The arrays in the buffer.
struct Parts<'a, T> {
    /// For each rate the outputs of s stages, the inputs of s stages, and the decays.
    operators: &'a mut [T],
    /// Σ_j of the part of f that W has in its own step, s×s.
    leading: &'a mut [T],
    /// For each rate e^{−λt} and Π R(−hλ) − e^{−λt}.
    remainders: &'a mut [T],
    /// W₀ of each elongation.
    start: &'a mut [T],
    /// For each elongation and rate y and its rounding error.
    sums: &'a mut [T],
}

impl<T: Real, C: AsRef<[T]>, B: AsRef<[T]> + AsMut<[T]>> Relaxing<T, C, B> {
    /// Numbers of the buffer for `rates` rates, a method of s stages and `count` elongations.
    pub const fn numbers(rates: usize, stages: usize, count: usize) -> usize {
        rates * (2 * stages + DECAYS + 2) + stages * stages + count * (1 + 2 * rates)
    }

    /// Dampers at rest.
    ///
    /// # Errors
    /// If a number is not finite or out of range, or a length does not fit.
    pub fn new(
        rule: &GaussLobatto<T>,
        table: RelaxationTable<C>,
        coefficient: C,
        count: usize,
        numbers: B,
    ) -> Result<Self, ParameterError> {
        let check = ParameterError::check;
        let (rates, coefficients) = (table.rates.as_ref(), table.coefficients.as_ref());
        let fits = rates.len() == coefficients.len();
        check(fits, "coefficients", coefficients.len() as f64, "as many as rates")?;
        let is_rate = rates.iter().all(|&rate| rate >= T::zero() && rate.is_finite());
        check(is_rate, "rates", f64::NAN, "finite and at least 0")?;
        check(all_finite(coefficients), "coefficients", f64::NAN, "finite")?;
        let entries = coefficient.as_ref();
        let is_square = entries.len() == count * count && all_finite(entries);
        check(is_square, "damping coefficients", entries.len() as f64, "one for each pair, finite")?;
        let long = Self::numbers(rates.len(), rule.stages(), count);
        let found = numbers.as_ref().len();
        check(found == long, "numbers of the buffer", found as f64, "those of `numbers`")?;
        let positive = |number: f64| number > 0.0 && number.is_finite();
        check(positive(table.shortest), "shortest step", table.shortest, "positive and finite")?;
        check(positive(table.horizon), "horizon", table.horizon, "positive and finite")?;
        let rule = *rule;
        let mut made = Self { rule, table, count, coefficient, numbers, length: 0.0, elapsed: 0.0 };
        made.begin(&[]);
        Ok(made)
    }

    /// Number of elongations.
    pub fn elongations(&self) -> usize {
        self.count
    }

    /// Number of rates.
    fn rates(&self) -> usize {
        self.table.rates.as_ref().len()
    }

    /// Numbers of a rate's operators.
    fn stride(&self) -> usize {
        2 * self.rule.stages() + DECAYS
    }

    fn parts_mut(&mut self) -> Parts<'_, T> {
        let (rates, stages, count, stride) = (self.rates(), self.rule.stages(), self.count, self.stride());
        let (operators, rest) = parts_mut(self.numbers.as_mut(), rates * stride);
        let (leading, rest) = parts_mut(rest, stages * stages);
        let (remainders, rest) = parts_mut(rest, 2 * rates);
        let (start, sums) = parts_mut(rest, count);
        Parts { operators, leading, remainders, start, sums }
    }

    /// The same arrays, to read: operators, leading, remainders, start, sums.
    fn parts(&self) -> [&[T]; 5] {
        let (rates, stages) = (self.rates(), self.rule.stages());
        let mut rest = self.numbers.as_ref();
        [rates * self.stride(), stages * stages, 2 * rates, self.count, 2 * rates * self.count].map(|count| {
            let taken = part(rest, count);
            rest = part_from(rest, count);
            taken
        })
    }

    /// Begins at rest with the velocities W₀; missing ones are zero.
    pub fn begin(&mut self, velocities: &[T]) {
        let parts = self.parts_mut();
        parts.sums.fill(T::zero());
        for pair in parts.remainders.as_chunks_mut::<2>().0 {
            *pair = [T::one(), T::zero()];
        }
        parts.start.fill(T::zero());
        parts.start.iter_mut().zip(velocities).for_each(|(place, &velocity)| *place = velocity);
        self.elapsed = 0.0;
    }

    /// Computes the operators for a length.
    #[cold]
    fn settle(&mut self, length: f64) {
        let (rule, stages, is_inertial) = (self.rule, self.rule.stages(), self.table.is_inertial);
        let mut leading = [0.0; MOST_STAGES * MOST_STAGES];
        let stride = self.stride();
        let resolvents = Resolvents::new(&rule);
        for index in 0..self.rates() {
            let rate = at(self.table.rates.as_ref(), index).to_f64();
            let c = at(self.table.coefficients.as_ref(), index).to_f64();
            let x = length * rate;
            let found = resolvents.at(x);
            for (place, (&whole, &moved)) in leading.iter_mut().zip(found.inverse.iter().zip(&found.moved)) {
                *place += c * if is_inertial { whole } else { length * moved };
            }
            let worth = if is_inertial { -c * rate } else { c };
            let start = index * stride;
            let operators = self.parts_mut().operators;
            let (_, places) = parts_mut(operators, start);
            let outputs = found.column.iter().take(stages).map(|output| worth * output);
            let inputs = found.row.iter().take(stages).map(|input| length * input);
            let kept = libm::exp(-x);
            let decays = [found.decrement, kept, -libm::expm1(-x) - found.decrement];
            let numbers = outputs.chain(inputs).chain(decays);
            places.iter_mut().zip(numbers).for_each(|(place, number)| *place = T::of(number));
        }
        let parts = self.parts_mut();
        for (index, place) in parts.leading.iter_mut().enumerate() {
            let (row, column) = (index / stages.max(1), index % stages.max(1));
            *place = T::of(at(&leading, row * MOST_STAGES + column));
        }
        self.length = length;
    }

    /// Sets the length of the step to come.
    ///
    /// # Errors
    /// If it is shorter than the table's shortest or ends after its horizon.
    pub fn begin_step(&mut self, length: T) -> Result<(), MemoryError> {
        let length = length.to_f64();
        let (shortest, horizon) = (self.table.shortest * (1.0 - SLACK), self.table.horizon * (1.0 + SLACK));
        if !(length >= shortest && self.elapsed + length <= horizon) {
            return Err(MemoryError::StepLength);
        }
        if length != self.length {
            self.settle(length);
        }
        Ok(())
    }

    /// Σ_b ρ_ab x_b for elongation a.
    fn coupled(&self, a: usize, x: impl Fn(usize) -> T) -> T {
        let row = part_from(self.coefficient.as_ref(), a * self.count);
        row.iter().take(self.count).enumerate().fold(T::zero(), |sum, (b, &rho)| sum + rho * x(b))
    }

    /// Writes the part of the forces that earlier steps leave, elongation by elongation.
    pub fn known(&self, forces: &mut [T]) {
        let stages = self.rule.stages();
        let [operators, leading, _, start, sums] = self.parts();
        forces.fill(T::zero());
        let width = (2 * self.rates()).max(1);
        for (b, sums) in sums.chunks_exact(width).enumerate() {
            let mut left = [T::zero(); MOST_STAGES];
            for (block, pair) in operators.chunks_exact(self.stride()).zip(sums.as_chunks::<2>().0) {
                let [y, _] = *pair;
                left.iter_mut().zip(part(block, stages)).for_each(|(sum, &output)| *sum += output * y);
            }
            if self.table.is_inertial {
                let rows = leading.chunks_exact(stages.max(1));
                for (left, row) in left.iter_mut().zip(rows) {
                    *left -= row.iter().fold(T::zero(), |sum, &w| sum + w) * at(start, b);
                }
            }
            for (a, forces) in forces.chunks_exact_mut(stages.max(1)).enumerate() {
                let rho = at(self.coefficient.as_ref(), a * self.count + b);
                forces.iter_mut().zip(&left).for_each(|(force, &left)| *force += rho * left);
            }
        }
    }

    /// ∂f of elongation `row` at node i with respect to W of elongation `column` at node j.
    pub fn leading(&self, [row, column]: [usize; 2], [i, j]: [usize; 2]) -> T {
        let [_, leading, ..] = self.parts();
        at(self.coefficient.as_ref(), row * self.count + column) * at(leading, i * self.rule.stages() + j)
    }

    /// Stores the velocities of a step, those of an elongation at all nodes side by side.
    pub fn push(&mut self, velocities: &[T]) {
        let (stages, stride, is_inertial) = (self.rule.stages(), self.stride(), self.table.is_inertial);
        let (width, length) = ((2 * self.rates()).max(1), self.length);
        let parts = self.parts_mut();
        let elongations = parts.sums.chunks_exact_mut(width).zip(velocities.chunks_exact(stages.max(1)));
        for ((sums, velocities), &start) in elongations.zip(&*parts.start) {
            let off = if is_inertial { start } else { T::zero() };
            for (block, pair) in parts.operators.chunks_exact(stride).zip(sums.as_chunks_mut::<2>().0) {
                let [y, rest] = *pair;
                let (inputs, decays) = parts_from_split(part_from(block, stages), stages);
                let mut change = rest - at(decays, 0) * y;
                for (&input, &velocity) in inputs.iter().zip(velocities) {
                    change += input * (velocity - off);
                }
                let sum = y + change;
                *pair = [sum, change - (sum - y)];
            }
        }
        let negligible = T::SMALLEST_NORMAL / T::EPSILON;
        for (block, pair) in parts.operators.chunks_exact(stride).zip(parts.remainders.as_chunks_mut::<2>().0)
        {
            let decays = part_from(block, 2 * stages);
            let [exact, gap] = *pair;
            // R Π R − e^{−x} e^{−λt}, with the difference of the two factors known to its own digits. Numbers
            // that processors are slow with are as good as none.
            let next = [exact * at(decays, 1), gap * (T::one() - at(decays, 0)) + exact * at(decays, 2)];
            *pair = next.map(|number| if number.abs() < negligible { T::zero() } else { number });
        }
        self.elapsed += length;
    }

    /// Writes δ_a = Σ_b ρ_ab Σ_j c_j (W_b/λ_j² − Ẇ_b/λ_j³) (Π R(−hλ_j) − e^{−λ_jt}) for velocities W + Ẇt at
    /// the start: by so much the impulse of the discrete memory exceeds that of the kernel. For d = 2, whose
    /// samples are W(t) − W, it is Σ_j c_j Ẇ_b/λ_j² (Π R(−hλ_j) − e^{−λ_jt}).
    pub fn excess(&self, [start, slope]: [&[T]; 2], excess: &mut [T]) {
        let ([_, _, remainders, ..], least) = (self.parts(), FAST / self.length);
        let [mut second, mut third] = [0.0; 2];
        let tables = self.table.rates.as_ref().iter().zip(self.table.coefficients.as_ref());
        for ((&rate, &c), pair) in tables.zip(remainders.as_chunks::<2>().0) {
            let (rate, [_, gap]) = (rate.to_f64(), *pair);
            if rate > least {
                let part = c.to_f64() / rate * (gap.to_f64() / rate);
                second += part;
                third += part / rate;
            }
        }
        let [of_start, of_slope] = if self.table.is_inertial { [0.0, second] } else { [second, -third] };
        for (a, place) in excess.iter_mut().enumerate().take(self.count) {
            *place = T::of(of_start) * self.coupled(a, |b| at(start, b))
                + T::of(of_slope) * self.coupled(a, |b| at(slope, b));
        }
    }

    /// The energy stored in the relaxations.
    pub fn stored(&self) -> T {
        let [.., sums] = self.parts();
        let width = (2 * self.rates()).max(1);
        let y = |elongation: usize, j: usize| at(sums, elongation * width + 2 * j);
        let mut energy = T::zero();
        let tables = self.table.rates.as_ref().iter().zip(self.table.coefficients.as_ref());
        for (j, (&rate, &c)) in tables.enumerate() {
            let worth = if self.table.is_inertial { c * rate } else { c };
            for a in 0..self.count {
                energy += worth * y(a, j) * self.coupled(a, |b| y(b, j));
            }
        }
        energy * T::of(0.5)
    }

    fn shape(&self) -> Shape<3> {
        let numbers = self.table.rates.as_ref().iter().chain(self.table.coefficients.as_ref());
        let all = numbers.chain(self.coefficient.as_ref());
        [
            ("elongations", self.count as u64),
            ("stages", self.rule.stages() as u64),
            ("fingerprint of the rates", fingerprint(all)),
        ]
    }

    /// Numbers of the buffer that are state.
    fn carried(&self) -> usize {
        2 * self.rates() + self.count * (1 + 2 * self.rates())
    }
}

/// The first `count` numbers, and the others.
fn parts_from_split<T>(numbers: &[T], count: usize) -> (&[T], &[T]) {
    (part(numbers, count), part_from(numbers, count))
}

impl<T: Real, C: AsRef<[T]>, B: AsRef<[T]> + AsMut<[T]>> Stateful for Relaxing<T, C, B> {
    fn state_bytes(&self) -> usize {
        header_bytes(3) + 16 + self.carried() * T::BYTES
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 3>(TAG, &self.shape())?;
        to.count(self.elapsed.to_bits())?;
        to.count(self.length.to_bits())?;
        let [operators, leading, ..] = self.parts();
        to.numbers(part_from(self.numbers.as_ref(), operators.len() + leading.len()))
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.header::<T, 3>(TAG, &self.shape())?;
        from.count()?;
        from.count()?;
        from.skip::<T>(self.carried())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        from.header::<T, 3>(TAG, &self.shape())?;
        self.elapsed = f64::from_bits(from.count()?);
        // The length of the last step, which the excess depends on.
        let length = f64::from_bits(from.count()?);
        if length != self.length && length > 0.0 && length.is_finite() {
            self.settle(length);
        }
        let [operators, leading, ..] = self.parts();
        let kept = operators.len() + leading.len();
        let (_, state) = parts_mut(self.numbers.as_mut(), kept);
        from.numbers(state)
    }
}

/// (I + xA)⁻¹ of a method at any x ≥ 0, in double precision.
struct Resolvents<'a, T> {
    rule: &'a GaussLobatto<T>,
}

/// Values at one x.
struct RelaxationValues {
    /// (I + xA)⁻¹ and (I + xA)⁻¹ A, rows of [`MOST_STAGES`].
    inverse: [f64; MOST_STAGES * MOST_STAGES],
    moved: [f64; MOST_STAGES * MOST_STAGES],
    /// (I + xA)⁻¹ 1 and bᵀ (I + xA)⁻¹.
    column: [f64; MOST_STAGES],
    row: [f64; MOST_STAGES],
    /// 1 − R(−x) = x bᵀ (I + xA)⁻¹ 1.
    decrement: f64,
}

impl<'a, T: Real> Resolvents<'a, T> {
    fn new(rule: &'a GaussLobatto<T>) -> Self {
        Self { rule }
    }

    /// Solved for (I low + A high), whose entries are of order 1 at every x, and scaled by `low`.
    fn at(&self, x: f64) -> RelaxationValues {
        let s = self.rule.stages();
        let (low, high) = if x <= 1.0 { (1.0, x) } else { (1.0 / x, 1.0) };
        let mut matrix = [0.0; MOST_STAGES * MOST_STAGES];
        let used = part_mut(&mut matrix, s * s);
        for (index, place) in used.iter_mut().enumerate() {
            let (i, j) = (index / s.max(1), index % s.max(1));
            *place = high * self.rule.matrix(i, j).to_f64() + if i == j { low } else { 0.0 };
        }
        let mut pivots = [0; MOST_STAGES];
        let pivots = part_mut(&mut pivots, s);
        // The matrix of a Gauss method has no eigenvalue on the negative axis.
        let _ = factor(used, pivots);
        let mut found = RelaxationValues {
            inverse: [0.0; MOST_STAGES * MOST_STAGES],
            moved: [0.0; MOST_STAGES * MOST_STAGES],
            column: [0.0; MOST_STAGES],
            row: [0.0; MOST_STAGES],
            decrement: 0.0,
        };
        // What of (I + xA)⁻¹ is left beside the factor 1/x beyond x = 1.
        let scale = if x <= 1.0 { 1.0 } else { low };
        for j in 0..s {
            let mut unit = [0.0; MOST_STAGES];
            unit.iter_mut().skip(j).take(1).for_each(|one| *one = 1.0);
            let mut moved = [0.0; MOST_STAGES];
            moved.iter_mut().enumerate().for_each(|(i, place)| *place = self.rule.matrix(i, j).to_f64());
            substitute(used, pivots, part_mut(&mut unit, s));
            substitute(used, pivots, part_mut(&mut moved, s));
            for i in 0..s {
                let (unscaled, place) = (at(&unit, i), i * MOST_STAGES + j);
                let entry = unscaled * scale;
                found.inverse.iter_mut().skip(place).take(1).for_each(|place| *place = entry);
                let entry = at(&moved, i) * scale;
                found.moved.iter_mut().skip(place).take(1).for_each(|place| *place = entry);
                found.column.iter_mut().skip(i).take(1).for_each(|sum| *sum += unscaled * scale);
                let weight = self.rule.weight(i).to_f64();
                found.row.iter_mut().skip(j).take(1).for_each(|sum| *sum += weight * unscaled * scale);
                found.decrement += weight * unscaled * high;
            }
        }
        found
    }
}

impl<T: Real, C: AsRef<[T]>, B: AsRef<[T]> + AsMut<[T]>> Relaxing<T, C, B> {
    /// Σ c/λ of the relaxations that are done within the shortest step: the dashpots of the kernel.
    fn dashpot(&self) -> f64 {
        let tables = self.table.rates.as_ref().iter().zip(self.table.coefficients.as_ref());
        let pairs = tables.map(|(&rate, &c)| (rate.to_f64(), c.to_f64()));
        let fast = pairs.filter(|(rate, _)| rate * self.table.shortest > DASHPOT);
        fast.map(|(rate, c)| c / rate).sum()
    }
}

impl<T: Real, C: AsRef<[T]>, B: AsRef<[T]> + AsMut<[T]>> Dampers<T> for Relaxing<T, C, B> {
    fn elongations(&self) -> usize {
        self.count
    }

    fn begin(&mut self, velocities: &[T]) {
        Self::begin(self, velocities);
    }

    fn begin_step(&mut self, length: T) -> Result<(), MemoryError> {
        Self::begin_step(self, length)
    }

    fn known(&self, forces: &mut [T]) {
        Self::known(self, forces);
    }

    fn leading(&self, places: [usize; 2], nodes: [usize; 2]) -> T {
        Self::leading(self, places, nodes)
    }

    fn push(&mut self, velocities: &[T]) {
        Self::push(self, velocities);
    }

    fn excess(&self, start: [&[T]; 2], excess: &mut [T]) {
        Self::excess(self, start, excess);
    }

    fn sudden(&self, velocities: &[T], forces: &mut [T]) {
        let modulus = if self.table.is_inertial { 0.0 } else { self.dashpot() };
        for (a, place) in forces.iter_mut().enumerate().take(self.count) {
            *place = T::of(modulus) * self.coupled(a, |b| at(velocities, b));
        }
    }

    fn stored(&self) -> T {
        Self::stored(self)
    }
}
