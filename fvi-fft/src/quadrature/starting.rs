//! Starting weights: fractional derivatives that are exact on chosen powers of time.

use crate::dense::Factored;
use crate::quadrature::kernel_defects::KernelDefects;
use crate::quadrature::starting_defects::PowerDefects;
use crate::sums::max_or_nan;
use crate::transfer::TransferFunction;
use fvi_core::{
    ActsOn, BdfOrder, Memory, MemoryError, ParameterError, Real, Shape, StateError, StateReader, StateWriter,
    Stateful, check_channels, fingerprint, header_bytes,
};
use nalgebra::DMatrix;

/// Condition number of the starting system above which its weights have lost half of their digits.
pub const TRUSTED_CONDITION: f64 = 1e8;

/// A memory with starting weights: exact on the powers t^ν, ν from a list.
///
/// ```text
/// (D̃^β x)_k = Σ_{n=0}^{k} w_n x_{k−n} + h^{−β} Σ_j ϖ_{k,j} x_j ,
/// Σ_j ϖ_{k,j} j^ν = Γ(ν+1)/Γ(ν+1−β) k^{ν−β} − Σ_{n=0}^{k} ŵ_n (k−n)^ν       for every ν of the list
/// ```
///
/// with as many samples x_j as exponents: from j = 0 if ν = 0 is one of them, otherwise from j = 1 (with a
/// column of zeros for x₀). The sum of the corrections is Σ_ν a_ν (D^β t^ν − its quadrature), where Σ_ν a_ν
/// t^ν interpolates the first samples: once these are known no weights are needed any more. The defect of the
/// quadrature for a power is computed in advance, to full accuracy at every step, where a sum of k^ν would
/// leave its rounding error.
///
/// The quadrature's error on t^ν grows like t^{ν−β−p}, with the order p: exponents above β + p add a force
/// that grows without bound, and are useful only if the solution is known to be that power.
///
/// While there are fewer samples than exponents, quadrature is exact for the smallest exponents, as many as
/// there are samples, the sample to come included: the corrections of a step never need a later sample, and
/// the scheme stays explicit in the memory. The correction of x_k itself is part of
/// [`leading`](Memory::leading), which changes over the first steps for this memory.
///
/// The corrections are as accurate as the first samples. If the error of the scheme's first step is a fixed
/// fraction of x₁, as under a force that starts like √t, that fraction of the quadrature's error remains at
/// every step size.
///
/// Source: \[HJO\] eq. 26–27; \[Lubich86\] eq. 4.1 ff.; \[DFFW06\] for the condition.
#[derive(Clone, Debug)]
pub struct StartingCorrection<T, M> {
    memory: M,
    /// Defects of its kernel on t^ν.
    defects: Defects,
    /// ν, ascending.
    exponents: Vec<f64>,
    /// The systems of the starting weights for the smallest exponents: for one, two, … all of them.
    systems: Vec<Factored>,
    /// That of the a_ν for all of them; `None` without exponents.
    interpolation: Option<Factored>,
    /// The first values, one row of channels for each.
    first: Vec<Vec<f64>>,
    /// x_{k−1} of each channel, the sum of increments, until the first values are complete.
    last: Vec<f64>,
    /// a_ν for each channel, once the first samples are known.
    coefficients: Option<DMatrix<f64>>,
    leading: [T; 1],
}

/// Defects of powers of time.
#[derive(Clone, Debug)]
enum Defects {
    /// Defects of s^β with step size 1, and the factor h^{−β}.
    Power { defects: PowerDefects, scale: f64 },
    /// Defects of another kernel.
    Kernel(Box<KernelDefects>),
}

impl Defects {
    fn bytes(&self) -> usize {
        match self {
            Self::Power { defects, .. } => defects.bytes(),
            Self::Kernel(defects) => defects.bytes(),
        }
    }
}

impl<T: Real, M: Memory<T>> StartingCorrection<T, M> {
    /// Wraps `memory`, an empty memory for D^`exponent` by the backward differentiation formula of order
    /// `order` with the given step size.
    ///
    /// # Errors
    /// If the memory has more than one stage, the exponent is outside (−1, 2), or the starting exponents are
    /// not distinct, finite and at least zero.
    pub fn new(
        memory: M,
        order: BdfOrder,
        exponent: f64,
        step_size: f64,
        exponents: &[f64],
    ) -> Result<Self, ParameterError> {
        let scale = libm::pow(step_size, -exponent);
        let defects = |sorted: &[f64]| {
            Ok(Defects::Power { defects: PowerDefects::new(order, exponent, sorted)?, scale })
        };
        Self::with(memory, exponents, defects)
    }

    /// The same for any kernel whose singularities lie on the negative real axis.
    ///
    /// # Errors
    /// As [`new`](Self::new); and if the kernel is another one, or given by weights.
    pub fn of_transfer(
        memory: M,
        order: BdfOrder,
        transfer: &TransferFunction,
        step_size: f64,
        exponents: &[f64],
    ) -> Result<Self, ParameterError> {
        if let Some(exponent) = transfer.exponent() {
            return Self::new(memory, order, exponent, step_size, exponents);
        }
        Self::with(memory, exponents, |sorted| {
            Ok(Defects::Kernel(Box::new(KernelDefects::new(transfer, order, step_size, sorted)?)))
        })
    }

    fn with(
        memory: M,
        exponents: &[f64],
        defects: impl FnOnce(&[f64]) -> Result<Defects, ParameterError>,
    ) -> Result<Self, ParameterError> {
        let refuse = |parameter, value, allowed| Err(ParameterError { parameter, value, allowed });
        if memory.stages() != 1 {
            return refuse("stages", memory.stages() as f64, "1 for starting weights");
        }
        let mut sorted = exponents.to_vec();
        sorted.sort_by(f64::total_cmp);
        for (index, &value) in sorted.iter().enumerate() {
            if !(value >= 0.0 && value.is_finite()) || (index > 0 && sorted[index - 1] == value) {
                return refuse("starting exponent", value, "distinct, finite and at least zero");
            }
        }
        let (mut systems, mut interpolation) = (Vec::new(), None);
        for (index, &value) in sorted.iter().enumerate() {
            let matrix = starting_matrix(&sorted[..=index], first_index(&sorted));
            let transposed = Factored::new(matrix.transpose());
            let (Some(system), Some(transposed)) = (Factored::new(matrix), transposed) else {
                let allowed =
                    "so far from the others that the system of the starting weights is not singular";
                return refuse("starting exponent", value, allowed);
            };
            systems.push(system);
            interpolation = Some(transposed);
        }
        let mut this = Self {
            leading: [T::zero()],
            memory,
            defects: defects(&sorted)?,
            systems,
            interpolation,
            exponents: sorted,
            first: Vec::new(),
            last: Vec::new(),
            coefficients: None,
        };
        this.clear();
        Ok(this)
    }

    /// Header of the saved state: the values that must match when it is restored.
    fn shape(&self) -> Shape<2> {
        let exponents = fingerprint(&self.exponents);
        [("channels", self.memory.channels() as u64), ("fingerprint of the starting exponents", exponents)]
    }

    /// D^β t^ν minus its quadrature at step k ≥ 1, for every ν: the quantities to be corrected.
    fn defects(&self) -> Vec<f64> {
        let k = self.memory.len();
        match &self.defects {
            Defects::Power { defects, scale } => defects.at(k).map(|defect| scale * defect).collect(),
            Defects::Kernel(defects) => defects.at(k),
        }
    }

    /// The weights h^{−β} ϖ_{k,j} of the first `count` samples from the defects of the `count` smallest
    /// exponents.
    fn starting_weights(&self, defects: &[f64], count: usize) -> DMatrix<f64> {
        let mut weights = DMatrix::from_column_slice(count, 1, &defects[..count]);
        self.systems[count - 1].solve(&mut weights);
        weights
    }

    /// Computes the a_ν once all samples that they need are known.
    fn interpolate(&mut self) {
        let wanted = self.exponents.len();
        if let Some(system) = self.interpolation.as_ref().filter(|_| self.first.len() == wanted) {
            let channels = self.memory.channels();
            let mut numbers = DMatrix::from_fn(wanted, channels, |j, channel| self.first[j][channel]);
            system.solve(&mut numbers);
            self.coefficients = Some(numbers);
        }
    }

    /// Sets the leading weight for the sample to come, and adds the corrections to its memory term.
    fn correct(&mut self, term: &mut [T]) {
        let k = self.memory.len();
        self.leading = [self.memory.leading().first().copied().unwrap_or(T::zero())];
        if k == 0 || self.exponents.is_empty() {
            return;
        }
        let defects = self.defects();
        if let Some(coefficients) = &self.coefficients {
            for (term, column) in term.iter_mut().zip(coefficients.column_iter()) {
                let sum: f64 = column.iter().zip(&defects).map(|(a, defect)| a * defect).sum();
                *term += T::of(sum);
            }
            return;
        }
        // The sample to come is one of the first samples.
        let weights = self.starting_weights(&defects, self.first.len() + 1);
        for (weight, sample) in weights.iter().zip(&self.first) {
            for (term, x) in term.iter_mut().zip(sample) {
                *term += T::of(weight * x);
            }
        }
        if let Some(&weight) = weights.iter().next_back() {
            self.leading[0] += T::of(weight);
            // x_k is the sum of this and the sample to come.
            for (term, x) in term.iter_mut().zip(&self.last) {
                *term += T::of(weight * x);
            }
        }
    }
}

impl<T: Real, M: Memory<T>> Memory<T> for StartingCorrection<T, M> {
    fn channels(&self) -> usize {
        self.memory.channels()
    }

    fn acts_on(&self) -> ActsOn {
        self.memory.acts_on()
    }

    fn leading(&self) -> &[T] {
        &self.leading
    }

    fn leading_is_constant(&self) -> bool {
        self.coefficients.is_some() || self.exponents.is_empty()
    }

    fn len(&self) -> usize {
        self.memory.len()
    }

    fn begin_step(&mut self, length: T) -> Result<(), MemoryError> {
        self.memory.begin_step(length)
    }

    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        self.memory.next_term(term)?;
        self.correct(term);
        Ok(())
    }

    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        check_channels(self.memory.channels(), sample.len())?;
        let k = self.memory.len();
        self.memory.push(sample)?;
        let wanted = self.exponents.len();
        if self.first.len() < wanted {
            let before = std::mem::replace(&mut self.last, vec![0.0; sample.len()]);
            let value = sample.iter().zip(before).map(|(x, before)| x.to_f64() + before).collect();
            if self.memory.acts_on() != ActsOn::Values {
                self.last.clone_from(&value);
            }
            if k >= first_index(&self.exponents) {
                self.first.push(value);
                self.interpolate();
            }
        }
        Ok(())
    }

    fn clear(&mut self) {
        self.memory.clear();
        self.first.clear();
        self.last = vec![0.0; self.memory.channels()];
        self.coefficients = None;
        self.leading = [self.memory.leading().first().copied().unwrap_or(T::zero())];
    }

    fn bytes(&self) -> usize {
        let numbers = self.first.iter().map(Vec::len).sum::<usize>() + 2 * self.exponents.len();
        self.memory.bytes() + self.defects.bytes() + size_of::<Self>() + numbers * size_of::<f64>()
    }

    fn overruns(&self) -> Option<usize> {
        self.memory.overruns()
    }
}

impl<T: Real, M: Memory<T>> Stateful for StartingCorrection<T, M> {
    fn state_bytes(&self) -> usize {
        let first = self.first.iter().chain([&self.last]).map(Vec::len).sum::<usize>();
        header_bytes(3) + T::BYTES + first * f64::BYTES + self.memory.state_bytes()
    }

    fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        to.header::<T, 2>(TAG, &self.shape())?;
        to.numbers(&self.leading)?;
        to.count(self.first.len() as u64)?;
        self.first.iter().chain([&self.last]).try_for_each(|sample| to.numbers(sample))?;
        self.memory.save(to)
    }

    fn check_state(&self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.header::<T, 2>(TAG, &self.shape())?;
        from.skip::<T>(1)?;
        let first = from.count_up_to("first samples", self.exponents.len())?;
        from.skip::<f64>((first + 1).saturating_mul(self.memory.channels()))?;
        self.memory.check_state(from)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.check_state(&mut from.clone())?;
        from.header::<T, 2>(TAG, &self.shape())?;
        from.numbers(&mut self.leading)?;
        let first = from.count_up_to("first samples", self.exponents.len())?;
        self.first = vec![vec![0.0; self.memory.channels()]; first];
        self.first.iter_mut().chain([&mut self.last]).try_for_each(|sample| from.numbers(sample))?;
        self.coefficients = None;
        self.interpolate();
        self.memory.restore(from)
    }
}

/// Kind of the saved state.
const TAG: [u8; 4] = *b"strt";

/// x^ν with 0⁰ = 1.
fn power(x: f64, nu: f64) -> f64 {
    if nu == 0.0 { 1.0 } else { libm::pow(x, nu) }
}

/// Smallest index j of the samples x_j that the corrections for these exponents use.
fn first_index(exponents: &[f64]) -> usize {
    usize::from(!exponents.contains(&0.0))
}

/// j^ν: row ν, column j from `first` on, as many as exponents.
fn starting_matrix(exponents: &[f64], first: usize) -> DMatrix<f64> {
    DMatrix::from_fn(exponents.len(), exponents.len(), |row, column| {
        power((first + column) as f64, exponents[row])
    })
}

/// Condition number of the system of the starting weights, its rows scaled to largest entry 1: the largest
/// amplification of rounding errors in the weights. Infinite if the system is singular.
pub fn starting_condition(exponents: &[f64]) -> f64 {
    if exponents.is_empty() {
        return 1.0;
    }
    let mut matrix = starting_matrix(exponents, first_index(exponents));
    for mut row in matrix.row_iter_mut() {
        let largest = row.amax();
        row /= largest;
    }
    let norm = |matrix: &DMatrix<f64>| matrix.row_iter().map(|row| row.abs().sum()).fold(0.0, max_or_nan);
    matrix.clone().lu().try_inverse().map_or(f64::INFINITY, |inverse| norm(&matrix) * norm(&inverse))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quadrature::starting_defects::reciprocal_gamma;
    use fvi_core::{ConvolutionWeights, FixedDirect, StateError};
    use nalgebra::DVector;

    /// Γ(ν+1)/Γ(ν+1−β), zero where the derivative of t^ν vanishes.
    fn derivative_factor(nu: f64, beta: f64) -> f64 {
        libm::tgamma(nu + 1.0) * reciprocal_gamma(nu + 1.0 - beta)
    }

    const STEPS: usize = 60;
    const STEP_SIZE: f64 = 0.125;

    fn weights(order: usize, beta: f64) -> Vec<f64> {
        let order = BdfOrder::new(order).unwrap();
        ConvolutionWeights::bdf(order, beta, STEP_SIZE).unwrap().take(STEPS).collect()
    }

    fn corrected<'w, const M: usize>(
        weights: &'w [f64],
        order: usize,
        beta: f64,
        exponents: [f64; M],
    ) -> StartingCorrection<f64, FixedDirect<'w, f64, 1, STEPS>> {
        StartingCorrection::new(
            FixedDirect::full_memory(weights, 1.0).unwrap(),
            BdfOrder::new(order).unwrap(),
            beta,
            STEP_SIZE,
            &exponents,
        )
        .unwrap()
    }

    /// D̃^β of a signal at every step from the first on.
    fn stream<M: Memory<f64>>(memory: &mut M, signal: impl Fn(usize) -> f64) -> Vec<f64> {
        (0..STEPS)
            .map(|k| {
                let mut term = [0.0];
                memory.next_term(&mut term).unwrap();
                let value = memory.leading()[0] * signal(k) + term[0];
                memory.push(&[signal(k)]).unwrap();
                value
            })
            .collect()
    }

    #[test]
    fn chosen_powers_have_their_exact_derivative() {
        let exponents = [2.5, 1.0, 3.0];
        for (order, beta) in [(1, 0.5), (3, 1.5), (2, 1.0)] {
            let table = weights(order, beta);
            let mut memory = corrected(&table, order, beta, exponents);
            for nu in exponents {
                memory.clear();
                let values = stream(&mut memory, |k| power(k as f64 * STEP_SIZE, nu));
                // From the step at which there are as many samples as exponents; for the smallest exponent at
                // once.
                let from = if nu == 1.0 { 1 } else { 3 };
                for (k, value) in values.iter().enumerate().skip(from) {
                    let t = k as f64 * STEP_SIZE;
                    let exact = derivative_factor(nu, beta) * power(t, nu - beta);
                    let size = table[0] * power(t, nu);
                    assert!((value - exact).abs() <= 1e-13 * size, "BDF {order}, {nu}, step {k}");
                }
            }
        }
    }

    #[test]
    fn the_corrections_are_those_of_the_starting_weights() {
        // [HJO] eq. 26 with the weights ϖ computed at every step.
        let (beta, exponents) = (0.6, [0.0, 0.6, 1.2]);
        let table = weights(2, beta);
        let signal = |k: usize| (0.3 * k as f64).cos() + 0.1 * k as f64;
        let found = stream(&mut corrected(&table, 2, beta, exponents), signal);
        for (k, found) in found.iter().enumerate().skip(3) {
            let quadrature = |f: &dyn Fn(usize) -> f64| (0..=k).map(|n| table[n] * f(k - n)).sum::<f64>();
            let defects = exponents.map(|nu| {
                let exact = derivative_factor(nu, beta) * power(k as f64, nu - beta) * STEP_SIZE.powf(-beta);
                exact - quadrature(&|j| power(j as f64, nu))
            });
            let system = DMatrix::from_fn(3, 3, |row, j| power(j as f64, exponents[row]));
            let omega = system.lu().solve(&DVector::from_column_slice(&defects)).unwrap();
            let expected = quadrature(&signal) + (0..3).map(|j| omega[j] * signal(j)).sum::<f64>();
            assert!((found - expected).abs() < 1e-12, "step {k}: {found} and {expected}");
        }
    }

    /// Pushes the samples from step `from` on; returns the leading weights and terms of all steps as bits.
    fn resume<M: Memory<f64>>(memory: &mut M, from: usize) -> Vec<[u64; 2]> {
        let step = |k: usize| {
            let mut term = [0.0];
            memory.next_term(&mut term).unwrap();
            let leading = memory.leading()[0];
            memory.push(&[(0.3 * k as f64).cos() + 0.1 * k as f64]).unwrap();
            [leading, term[0]].map(f64::to_bits)
        };
        (from..STEPS).map(step).collect()
    }

    #[test]
    fn a_restored_memory_has_the_bits_of_the_saved_one_at_every_step_of_the_start() {
        let exponents = [0.0, 0.6, 1.2];
        let plain = weights(2, 0.6);
        let table = FixedDirect::full_memory(&plain, 1.0).unwrap();
        let new = |acts_on, exponents: &[f64]| {
            let order = BdfOrder::new(2).unwrap();
            StartingCorrection::new(table.clone().acting_on(acts_on), order, 0.6, STEP_SIZE, exponents)
                .unwrap()
        };
        for (acts_on, saved_after) in [ActsOn::Values, ActsOn::Increments]
            .into_iter()
            .flat_map(|acts_on| [0, 1, 2, 3, 4, 40].map(|k| (acts_on, k)))
        {
            let mut memory: StartingCorrection<f64, FixedDirect<'_, f64, 1, STEPS>> =
                new(acts_on, &exponents);
            let whole = resume(&mut memory, 0);
            memory.clear();
            for k in 0..saved_after {
                memory.next_term(&mut [0.0]).unwrap();
                memory.push(&[(0.3 * k as f64).cos() + 0.1 * k as f64]).unwrap();
            }
            let mut bytes = vec![0; memory.state_bytes()];
            let mut writer = StateWriter::new(&mut bytes);
            memory.save(&mut writer).unwrap();
            assert_eq!(writer.written(), bytes.len());

            let mut restored = new(acts_on, &exponents);
            resume(&mut restored, 0);
            for length in 0..bytes.len() {
                assert!(restored.restore(&mut StateReader::new(&bytes[..length])).is_err());
                assert_eq!((restored.len(), restored.first.len()), (STEPS, 3));
            }
            let mut reader = StateReader::new(&bytes);
            restored.restore(&mut reader).unwrap();
            assert_eq!(reader.finish(), Ok(()));
            assert_eq!(restored.len(), saved_after);
            assert_eq!(resume(&mut restored, saved_after), whole[saved_after..], "saved after {saved_after}");

            let mut other = new(acts_on, &[0.0, 0.6, 1.3]);
            let refusal = other.restore(&mut StateReader::new(&bytes));
            assert!(matches!(refusal, Err(StateError::Mismatch { .. })), "{refusal:?}");
        }
    }

    #[test]
    fn bad_exponents_are_refused_and_close_ones_ill_conditioned() {
        let table = weights(1, 0.5);
        let single = || FixedDirect::<f64, 1, STEPS>::full_memory(&table, 1.0).unwrap();
        // 2^ν is the same number for the last two.
        let next = 0.5_f64.next_up();
        for exponents in [[0.5, 0.5], [-0.5, 1.0], [f64::NAN, 1.0], [0.5, next]] {
            assert!(
                StartingCorrection::new(single(), BdfOrder::GRUNWALD_LETNIKOV, 0.5, 0.1, &exponents).is_err()
            );
        }
        assert_eq!(starting_condition(&[2.5]), 1.0);
        assert!(starting_condition(&[0.0, 0.5, 1.0]) < 100.0);
        let many: Vec<f64> = (0..12).map(|i| 0.1 * f64::from(i)).collect();
        assert!(starting_condition(&many) > TRUSTED_CONDITION);
    }
}
