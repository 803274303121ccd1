//! The memory of steps of any length: against Runge–Kutta convolution quadrature on equal steps, and by the
//! laws that its operators obey on any grid.

use fvi_core::{
    Memory, MemoryError, Real, RungeKutta, StateReader, StateWriter, Stateful, VariableStepMemory, min_or_nan,
};
use fvi_fft::Aligned;
use fvi_fft::exponentials::rate_table::{rate_table, rate_table_of};
use fvi_fft::quadrature::runge_kutta_weights::RungeKuttaWeights;
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::{Scalar, VectorVariableSteps};

const TOLERANCE: f64 = 1e-12;

type AnyMemory<T, const R: usize> = VariableStepMemory<T, R, Aligned<T>, Aligned<T>>;

fn memory<T: Real, const R: usize>(
    method: &RungeKutta<R>,
    exponent: f64,
    steps: &[f64],
    tolerance: f64,
) -> AnyMemory<T, R> {
    let shortest = steps.iter().copied().fold(f64::INFINITY, min_or_nan);
    let table = rate_table::<T, R>(method, exponent, shortest, steps.iter().sum(), tolerance).unwrap();
    let state = Aligned::zeros(table.borrow::<T>().state_len(1, R));
    VariableStepMemory::new(method, table, 1, state).unwrap()
}

/// D^β X at every stage of every step.
fn operator<const R: usize>(
    method: &RungeKutta<R>,
    exponent: f64,
    steps: &[f64],
    samples: &[[f64; R]],
) -> Vec<[f64; R]> {
    operator_in::<f64, R>(memory(method, exponent, steps, TOLERANCE), steps, samples)
}

/// The same in the precision of a memory.
fn operator_in<T: Real, const R: usize>(
    mut memory: impl Memory<T>,
    steps: &[f64],
    samples: &[[f64; R]],
) -> Vec<[f64; R]> {
    let step = |(&length, sample): (&f64, &[f64; R])| {
        memory.begin_step(T::of(length)).unwrap();
        let (mut term, sample) = ([T::zero(); R], sample.map(T::of));
        memory.next_term(&mut term).unwrap();
        for (value, row) in term.iter_mut().zip(memory.leading().chunks(R)) {
            *value += row.iter().zip(&sample).fold(T::zero(), |sum, (&w, &x)| sum + w * x);
        }
        memory.push(&sample).unwrap();
        term.map(T::to_f64)
    };
    steps.iter().zip(samples).map(step).collect()
}

/// Steps whose lengths jump by factors up to 10³, and back.
fn random_steps(count: usize, seed: u64) -> Vec<f64> {
    let mut numbers = noise(seed);
    (0..count).map(|_| 10_f64.powf(3.0 * (numbers() - 1.0))).collect()
}

/// Numbers in [0, 1).
pub(crate) fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64
    }
}

fn random_samples<const R: usize>(count: usize, seed: u64) -> Vec<[f64; R]> {
    let mut numbers = noise(seed);
    (0..count).map(|_| std::array::from_fn(|_| 2.0 * numbers() - 1.0)).collect()
}

fn largest<const R: usize>(values: &[[f64; R]]) -> f64 {
    values.as_flattened().iter().map(|value| value.abs()).fold(0.0, max_or_nan)
}

fn assert_equal_steps<const R: usize>(method: &RungeKutta<R>) {
    let (count, step) = (60, 0.01);
    let steps = vec![step; count];
    let samples = random_samples::<R>(count, 7);
    for exponent in [-0.5, 0.3, 0.5, 0.9, 1.0, 1.3, 1.9, 0.0] {
        let weights = RungeKuttaWeights::new(method, exponent, step, count).unwrap().planes();
        let found = operator(method, exponent, &steps, &samples);
        let scale = largest(&found);
        for (k, found) in found.iter().enumerate() {
            for (a, &found) in found.iter().enumerate() {
                let mut expected = 0.0;
                for n in 0..=k {
                    for b in 0..R {
                        expected += weights[(a * R + b) * count + n] * samples[k - n][b];
                    }
                }
                let error = (found - expected).abs() / scale;
                assert!(error < 4.0 * TOLERANCE, "{R} stages, β = {exponent}, step {k}: {error:e}");
            }
        }
    }
}

#[test]
fn equal_steps_are_runge_kutta_convolution_quadrature() {
    assert_equal_steps(&RungeKutta::<1>::radau_iia().unwrap());
    assert_equal_steps(&RungeKutta::<2>::radau_iia().unwrap());
    assert_equal_steps(&RungeKutta::<3>::radau_iia().unwrap());
    assert_equal_steps(&RungeKutta::<2>::lobatto_iiic().unwrap());
    assert_equal_steps(&RungeKutta::<3>::lobatto_iiic().unwrap());
    assert_equal_steps(&RungeKutta::<4>::lobatto_iiic().unwrap());
}

fn assert_composition<const R: usize>(method: &RungeKutta<R>) {
    let steps = random_steps(80, 3);
    let samples = random_samples::<R>(80, 4);
    for (first, second) in [(0.5, 0.5), (0.3, 0.4), (0.7, 1.0), (0.6, 0.9), (-0.4, 0.4), (-0.5, 1.2)] {
        let once = operator(method, second, &steps, &samples);
        let composed = operator(method, first, &steps, &once);
        let together = operator(method, first + second, &steps, &samples);
        // The shortest steps make the largest values, and rounding and tolerance are relative to them.
        let scale = largest(&once) * 1e3_f64.powf(first.max(0.0)) + largest(&together);
        for (a, b) in composed.as_flattened().iter().zip(together.as_flattened()) {
            let error = (a - b).abs() / scale;
            assert!(error < 10.0 * TOLERANCE, "{R} stages, {first} + {second}: {error:e}");
        }
    }
}

#[test]
fn operators_compose_on_any_grid() {
    assert_composition(&RungeKutta::<1>::radau_iia().unwrap());
    assert_composition(&RungeKutta::<3>::radau_iia().unwrap());
    assert_composition(&RungeKutta::<3>::lobatto_iiic().unwrap());
}

/// The same operator by the plain trapezoidal rule in ln λ, three times as fine and far beyond both ends,
/// with resolvents by elimination: nothing in common with the table and the rational functions of the memory.
fn dense<const R: usize>(
    method: &RungeKutta<R>,
    exponent: f64,
    steps: &[f64],
    samples: &[[f64; R]],
) -> Vec<[f64; R]> {
    const SPACING: f64 = 0.1;
    let matrix = nalgebra::SMatrix::<f64, R, R>::from_fn(|i, j| method.matrix()[i][j]);
    let inverse = matrix.try_inverse().unwrap();
    let mu = exponent.ceil() - exponent;
    let leading = *RungeKuttaWeights::new(method, -mu, 1.0, 1).unwrap().leading();
    let ones = nalgebra::SVector::<f64, R>::repeat(1.0);
    // Y_k
    let mut derivatives: Vec<nalgebra::SVector<f64, R>> =
        samples.iter().map(|sample| (*sample).into()).collect();
    for _ in 0..exponent.ceil() as usize {
        let mut before = 0.0;
        for (&length, derivative) in steps.iter().zip(&mut derivatives) {
            let last = derivative[R - 1];
            *derivative = inverse * (*derivative - ones * before) / length;
            before = last;
        }
    }
    let shortest = steps.iter().copied().fold(f64::INFINITY, min_or_nan);
    let (low, high) = (-(40.0 / (1.0 - mu)) - steps.iter().sum::<f64>().ln(), 40.0 - shortest.ln());
    let jump = (std::f64::consts::PI * mu).sin() / std::f64::consts::PI;
    let mut values: Vec<nalgebra::SVector<f64, R>> = steps
        .iter()
        .zip(&derivatives)
        .map(|(&length, derivative)| leading * derivative * length.powf(mu))
        .collect();
    for node in 0..((high - low) / SPACING) as usize {
        let y = low + SPACING * node as f64;
        let (rate, coefficient) = (y.exp(), jump * SPACING * ((1.0 - mu) * y).exp());
        let mut z = 0.0;
        for ((&length, derivative), value) in steps.iter().zip(&derivatives).zip(&mut values) {
            let resolvent = (nalgebra::SMatrix::identity() + matrix * (length * rate)).try_inverse().unwrap();
            *value += resolvent * ones * (coefficient * z);
            z = (resolvent * (ones * z + matrix * derivative * length))[R - 1];
        }
    }
    values.iter().map(|value| (*value).into()).collect()
}

#[test]
fn random_steps_agree_with_a_dense_quadrature() {
    let method = RungeKutta::<3>::radau_iia().unwrap();
    for (seed, exponent) in [(11, 0.5), (12, 0.3), (13, 1.5), (14, 0.7)] {
        let steps = random_steps(150, seed);
        let samples = random_samples::<3>(150, seed);
        let found = operator(&method, exponent, &steps, &samples);
        let expected = dense(&method, exponent, &steps, &samples);
        let scale = largest(&expected);
        for (k, (found, expected)) in found.iter().zip(&expected).enumerate() {
            for (found, expected) in found.iter().zip(expected) {
                let error = (found - expected).abs() / scale;
                assert!(error < TOLERANCE, "β = {exponent}, step {k}: {error:e}");
            }
        }
    }
}

/// I^μ w backwards in time, by the method that is adjoint to `method` and the plain trapezoidal rule in ln λ:
/// A⁺ = B⁻¹AᵀB, B = diag(b).
fn advanced_integral<const R: usize>(
    method: &RungeKutta<R>,
    mu: f64,
    steps: &[f64],
    samples: &[[f64; R]],
) -> Vec<[f64; R]> {
    const SPACING: f64 = 0.1;
    type Vector<const R: usize> = nalgebra::SVector<f64, R>;
    let b = method.quadrature().weights();
    let adjoint = nalgebra::SMatrix::<f64, R, R>::from_fn(|i, j| b[j] * method.matrix()[j][i] / b[i]);
    let shortest = steps.iter().copied().fold(f64::INFINITY, min_or_nan);
    let (low, high) = (-(40.0 / (1.0 - mu)) - steps.iter().sum::<f64>().ln(), 40.0 / mu - shortest.ln());
    let jump = (std::f64::consts::PI * mu).sin() / std::f64::consts::PI;
    let mut values = vec![Vector::<R>::zeros(); steps.len()];
    for node in 0..((high - low) / SPACING) as usize {
        let y = low + SPACING * node as f64;
        let (rate, coefficient) = (y.exp(), jump * SPACING * ((1.0 - mu) * y).exp());
        let mut z = 0.0;
        for ((&length, sample), value) in steps.iter().zip(samples).zip(&mut values).rev() {
            let resolvent =
                (nalgebra::SMatrix::identity() + adjoint * (length * rate)).try_inverse().unwrap();
            let sample = Vector::<R>::from(*sample);
            let stages = resolvent * (Vector::<R>::repeat(z) + adjoint * sample * length);
            *value += stages * coefficient;
            z += length * Vector::<R>::from(*b).dot(&(sample - stages * rate));
        }
    }
    values.iter().map(|value| (*value).into()).collect()
}

/// Σ_k h_k Σ_i b_i x_{k,i} y_{k,i}, with the sum of the absolute values.
fn inner<const R: usize>(
    method: &RungeKutta<R>,
    steps: &[f64],
    x: &[[f64; R]],
    y: &[[f64; R]],
) -> (f64, f64) {
    let mut sums = (0.0, 0.0);
    for ((&length, x), y) in steps.iter().zip(x).zip(y) {
        for ((&b, &x), &y) in method.quadrature().weights().iter().zip(x).zip(y) {
            sums.0 += length * b * x * y;
            sums.1 += (length * b * x * y).abs();
        }
    }
    sums
}

fn assert_laws_of_the_inner_product<const R: usize>(method: &RungeKutta<R>) {
    for (seed, mu) in [(51, 0.2), (52, 0.5), (53, 0.7)] {
        let steps = random_steps(60, seed);
        let (x, y) = (random_samples::<R>(60, seed), random_samples::<R>(60, seed + 10));
        let retarded = operator(method, -mu, &steps, &x);
        let advanced = advanced_integral(method, mu, &steps, &y);
        let (one, size) = inner(method, &steps, &retarded, &y);
        let (other, _) = inner(method, &steps, &x, &advanced);
        assert!((one - other).abs() < 1e-10 * size, "{R} stages, μ = {mu}: {one} {other}");
        // What damping of order 1 − μ takes from a velocity, up to any step.
        for last in 1..=60 {
            let (work, size) = inner(method, &steps[..last], &x[..last], &retarded[..last]);
            assert!(work > -1e-12 * size, "{R} stages, μ = {mu}, {last} steps: {work}");
        }
    }
}

#[test]
fn the_advanced_operator_is_the_adjoint_and_damping_takes_energy_on_any_grid() {
    assert_laws_of_the_inner_product(&RungeKutta::<1>::radau_iia().unwrap());
    assert_laws_of_the_inner_product(&RungeKutta::<2>::radau_iia().unwrap());
    assert_laws_of_the_inner_product(&RungeKutta::<3>::radau_iia().unwrap());
    assert_laws_of_the_inner_product(&RungeKutta::<3>::lobatto_iiic().unwrap());
}

/// The memory that runs take, from the table of the core's.
fn in_vectors<T: Scalar, const R: usize>(
    method: &RungeKutta<R>,
    exponent: f64,
    steps: &[f64],
    tolerance: f64,
    coordinates: usize,
) -> VectorVariableSteps<T, R> {
    let table = memory::<T, R>(method, exponent, steps, tolerance).table().clone();
    VectorVariableSteps::new(method, &table.borrow(), coordinates).unwrap()
}

/// Random lengths, each followed by what a pair of halves, a length that is kept and one that comes back do.
fn returning_steps(count: usize, seed: u64) -> Vec<f64> {
    let lengths = random_steps(count / 10, seed).into_iter();
    lengths.flat_map(|h| [h, h, h, 0.5 * h, 0.5 * h, h, 0.7 * h, 0.5 * h, 0.5 * h, h]).collect()
}

fn assert_vectors_agree<const R: usize>(method: &RungeKutta<R>) {
    let (steps, samples) = (returning_steps(300, 31), random_samples::<R>(300, 32));
    // What single precision holds exactly.
    let single = |x: f64| f64::from(x as f32);
    let (steps, samples) = (
        steps.into_iter().map(single).collect::<Vec<_>>(),
        samples.into_iter().map(|sample| sample.map(single)).collect::<Vec<_>>(),
    );
    for exponent in [-0.5, 0.3, 1.0, 1.5, 1.9] {
        let plain = operator(method, exponent, &steps, &samples);
        let error = |found: Vec<[f64; R]>| {
            let pairs = found.as_flattened().iter().zip(plain.as_flattened());
            pairs.fold(0.0_f64, |largest, (a, b)| max_or_nan(largest, (a - b).abs())) / largest(&plain)
        };
        let double = error(operator_in(
            in_vectors::<f64, R>(method, exponent, &steps, TOLERANCE, 1),
            &steps,
            &samples,
        ));
        assert!(double < 1e-14, "{R} stages, β = {exponent}: {double:e}");
        let rough =
            error(operator_in(in_vectors::<f32, R>(method, exponent, &steps, 1e-8, 1), &steps, &samples));
        assert!(rough < 4e-6, "{R} stages, β = {exponent}, in single precision: {rough:e}");
    }
}

#[test]
fn vectors_of_rates_agree_with_the_core() {
    assert_vectors_agree(&RungeKutta::<1>::radau_iia().unwrap());
    assert_vectors_agree(&RungeKutta::<2>::radau_iia().unwrap());
    assert_vectors_agree(&RungeKutta::<3>::radau_iia().unwrap());
    assert_vectors_agree(&RungeKutta::<4>::lobatto_iiic().unwrap());
}

/// Whatever is prepared or kept: lengths tried in between, terms asked for twice or not at all, a state that
/// is saved and taken by another memory, other coordinates.
#[test]
fn what_vectors_of_rates_prepare_changes_no_bit() {
    let method = RungeKutta::<3>::radau_iia().unwrap();
    let (steps, samples) = (returning_steps(200, 33), random_samples::<3>(200, 34));
    for exponent in [-0.5, 0.5, 1.5] {
        let make = |coordinates| in_vectors::<f64, 3>(&method, exponent, &steps, TOLERANCE, coordinates);
        let (mut plain, mut other, mut many) = (make(1), make(1), make(3));
        for (k, (&length, sample)) in steps.iter().zip(&samples).enumerate() {
            let (mut term, mut again, mut of_many) = ([0.0; 3], [0.0; 3], [0.0; 9]);
            plain.begin_step(length).unwrap();
            plain.next_term(&mut term).unwrap();
            plain.push(sample).unwrap();
            // Not beyond the horizon.
            if k % 3 == 0 && other.begin_step(3.0 * length).is_ok() {
                other.next_term(&mut again).unwrap();
            }
            assert!(other.begin_step(-1.0).is_err() && other.begin_step(f64::NAN).is_err());
            other.begin_step(length).unwrap();
            if k % 2 == 0 {
                other.next_term(&mut again).unwrap();
                other.next_term(&mut again).unwrap();
                assert_eq!(term.map(f64::to_bits), again.map(f64::to_bits), "β = {exponent}, step {k}");
            }
            other.push(sample).unwrap();
            if k % 7 == 0 {
                let mut bytes = vec![0; other.state_bytes()];
                other.save(&mut StateWriter::new(&mut bytes)).unwrap();
                other = make(1);
                assert!(other.restore(&mut StateReader::new(&bytes[1..])).is_err());
                other.restore(&mut StateReader::new(&bytes)).unwrap();
                assert_eq!(other.next_term(&mut again), Err(MemoryError::StepLength));
            }
            many.begin_step(length).unwrap();
            many.next_term(&mut of_many).unwrap();
            many.push([sample.map(|x| -x), *sample, [0.0; 3]].as_flattened()).unwrap();
            let expected = [term.map(|x| -x), term, [0.0; 3]];
            let bits = |numbers: &[f64]| numbers.iter().map(|x| (x + 0.0).to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(expected.as_flattened()), bits(&of_many));
        }
        assert_eq!(plain.len(), 200);
        plain.clear();
        assert_eq!(plain.push(&[0.0; 3]), Err(MemoryError::StepLength));
    }
}

/// 500 steps whose lengths differ by factors up to 10³, or RANDOM_STEPS: `.ci/variable-steps` makes 10⁵ of
/// them.
#[test]
fn random_steps_agree_with_a_dense_quadrature_in_both_precisions() {
    let wanted = std::env::var("RANDOM_STEPS").map(|count| count.parse().expect("RANDOM_STEPS is a number"));
    let count = wanted.unwrap_or(500);
    let method = RungeKutta::<3>::radau_iia().unwrap();
    for (seed, exponent) in [(41, 0.3), (42, 0.5), (43, 0.9), (44, 1.5), (45, -0.5)] {
        // What single precision holds exactly.
        let single = |x: f64| f64::from(x as f32);
        let steps: Vec<f64> = random_steps(count, seed).into_iter().map(single).collect();
        let samples: Vec<[f64; 3]> =
            random_samples::<3>(count, seed).into_iter().map(|sample| sample.map(single)).collect();
        let exact = dense(&method, exponent, &steps, &samples);
        let largest_error = |found: &[[f64; 3]]| {
            let pairs = found.as_flattened().iter().zip(exact.as_flattened());
            pairs.fold(0.0_f64, |largest, (a, b)| max_or_nan(largest, (a - b).abs())) / largest(&exact)
        };
        let plain = largest_error(&operator(&method, exponent, &steps, &samples));
        let double = in_vectors::<f64, 3>(&method, exponent, &steps, TOLERANCE, 1);
        let double = largest_error(&operator_in(double, &steps, &samples)).max(plain);
        let plain = memory::<f32, 3>(&method, exponent, &steps, 1e-8);
        let plain = largest_error(&operator_in(plain, &steps, &samples));
        let rough = in_vectors::<f32, 3>(&method, exponent, &steps, 1e-8, 1);
        let rough = largest_error(&operator_in(rough, &steps, &samples)).max(plain);
        println!("β = {exponent}: error {double:.1e}, in single precision {rough:.1e}, of the largest value");
        assert!(double < TOLERANCE, "β = {exponent}: {double:e}");
        assert!(rough < 1e-5, "β = {exponent}: {rough:e}");
    }
}

#[test]
fn many_random_steps_stay_bounded_and_single_precision_keeps_its_digits() {
    let method = RungeKutta::<3>::radau_iia().unwrap();
    let steps = random_steps(20_000, 5);
    let horizon: f64 = steps.iter().sum();
    let double = rate_table::<f64, 3>(&method, 0.5, 1e-3, horizon, TOLERANCE).unwrap();
    let single = rate_table::<f32, 3>(&method, 0.5, 1e-3, horizon, 1e-8).unwrap();
    // A rate has two numbers in the state.
    assert!(single.rates.as_ref().len() < double.rates.as_ref().len());
    let state = Aligned::zeros(double.borrow::<f64>().state_len(1, 3));
    let mut double = VariableStepMemory::new(&method, double, 1, state).unwrap();
    let state = Aligned::zeros(single.borrow::<f32>().state_len(1, 3));
    let mut single = VariableStepMemory::new(&method, single, 1, state).unwrap();
    let mut time = 0.0;
    let (mut largest_term, mut largest_error) = (0.0_f64, 0.0_f64);
    for &length in &steps {
        // What a step of this length sees of a slow motion.
        let sample = method.quadrature().nodes().map(|c| (0.01 * (time + c * length)).sin());
        let (mut term, mut rough) = ([0.0; 3], [0.0_f32; 3]);
        double.begin_step(length).unwrap();
        single.begin_step(length as f32).unwrap();
        double.next_term(&mut term).unwrap();
        single.next_term(&mut rough).unwrap();
        // The derivative itself, in the precision of each.
        for a in 0..3 {
            let of = |weights: &[f64], term: f64| {
                term + (0..3).map(|b| weights[3 * a + b] * sample[b]).sum::<f64>()
            };
            let exact = of(double.leading(), term[a]);
            let weights: Vec<f64> = single.leading().iter().map(|&w| f64::from(w)).collect();
            let found = of(&weights, f64::from(rough[a]));
            largest_term = max_or_nan(largest_term, exact.abs());
            // Rounding of values of size one, which short steps divide by h^β.
            largest_error = max_or_nan(largest_error, (found - exact).abs() * length.sqrt());
        }
        double.push(&sample).unwrap();
        single.push(&sample.map(|number| number as f32)).unwrap();
        time += length;
    }
    assert!(largest_term < 1.0, "{largest_term}");
    assert!(largest_error < 1e-5, "{largest_error:e}");
}

#[test]
fn the_state_of_seventeen_decades_fits_into_three_kilobytes() {
    let method = RungeKutta::<3>::radau_iia().unwrap();
    for exponent in [0.1, 0.5, 0.9, 1.1, 1.5, 1.9] {
        let table = rate_table::<f64, 3>(&method, exponent, 1e-9, 1e8, TOLERANCE).unwrap();
        let numbers = 2 * table.rates.as_ref().len() + 2;
        assert!(numbers * 8 <= 3000, "β = {exponent}: {} bytes", numbers * 8);
    }
}

/// Intervals about 0.01 that come up to a fifth early or late.
fn jittery(count: usize) -> Vec<f64> {
    let mut numbers = noise(21);
    (0..count).map(|_| 0.01 * (0.8 + 0.4 * numbers())).collect()
}

#[test]
fn an_operator_on_a_stream_takes_samples_that_come_early_or_late() {
    use fvi_core::{FractionalOperator, Start};
    let method = RungeKutta::<1>::radau_iia().unwrap();
    let intervals = jittery(1000);
    let memory = || memory::<f64, 1>(&method, 0.5, &intervals, TOLERANCE);
    let mut integral = FractionalOperator::new(memory(), Start::RiemannLiouville).unwrap();
    let mut ramp = FractionalOperator::new(memory(), Start::Caputo).unwrap();
    let mut levelled = FractionalOperator::new(memory(), Start::CaputoWithSlope { slope: 2.0 }).unwrap();
    let mut time = 0.0;
    for (k, &interval) in intervals.iter().enumerate() {
        if k > 0 {
            time += interval;
        }
        let of_one = integral.push_after(interval, 1.0).unwrap();
        let of_line = ramp.push_after(interval, 3.0 + time).unwrap();
        assert!(levelled.push_after(interval, 1.0 + 2.0 * time).unwrap().abs() < 1e-11);
        if k > 100 {
            // D^½ 1 = 1/√(πt), D^½ t = 2 √(t/π); of first order, the first interval counts for the former.
            let exact = 1.0 / (std::f64::consts::PI * time).sqrt();
            assert!((of_one / exact - 1.0).abs() < 0.01 / time, "{of_one} {exact}");
            let exact = 2.0 * (time / std::f64::consts::PI).sqrt();
            assert!((of_line / exact - 1.0).abs() < 0.01 / time, "{of_line} {exact}");
        }
    }
    assert!(integral.push_after(1e-9, 1.0).is_err());
    assert!(levelled.push(1.0).is_err());
}

#[test]
fn an_integrator_takes_ticks_that_come_early_or_late() {
    use fvi_core::{
        Coefficients, Collocation, DampingTerm, Derivative, Integrator, Kernel, Mass, NoForce, Quadratic,
        System,
    };
    let method = RungeKutta::<3>::radau_iia().unwrap();
    let run = |steps: &[f64]| {
        let memory = memory::<f64, 3>(&method, 0.5, steps, TOLERANCE);
        let kernel = Kernel::any_step(&method, 0.5).unwrap();
        let rho = Coefficients::Diagonal([0.5].into());
        let damping = DampingTerm::new(kernel, rho, Derivative::Caputo, memory).unwrap();
        let system = System {
            mass: Mass::diagonal([1.0]).unwrap(),
            potential: Quadratic::diagonal([1.0]).unwrap(),
            force: NoForce,
        };
        let mut plant = Integrator::builder(system, Collocation::new(&method), 0.01)
            .damping(damping)
            .position([1.0])
            .build()
            .unwrap();
        for &length in steps {
            plant.step_by(length, &[0.0].into()).unwrap();
        }
        (plant.time(), plant.state().position[0], plant)
    };
    let ticks = jittery(500);
    let (time, position, mut plant) = run(&ticks);
    assert!((time - ticks.iter().sum::<f64>()).abs() < 1e-12);
    let (_, regular, _) = run(&vec![time / 500.0; 500]);
    assert!((position - regular).abs() < 1e-5, "{position} {regular}");
    // A step that no memory takes changes nothing.
    let before = *plant.state();
    assert!(plant.step_by(-0.01, &[0.0].into()).is_err() && plant.step_by(1e9, &[0.0].into()).is_err());
    assert_eq!(*plant.state(), before);
    assert_eq!(plant.time(), time);
}

/// The memory of any kernel, of the core's and in vectors.
fn memories_of<const R: usize>(
    method: &RungeKutta<R>,
    transfer: &TransferFunction,
    steps: &[f64],
) -> (AnyMemory<f64, R>, VectorVariableSteps<f64, R>) {
    let shortest = steps.iter().copied().fold(f64::INFINITY, min_or_nan);
    let table = rate_table_of::<f64, R>(method, transfer, shortest, steps.iter().sum(), TOLERANCE).unwrap();
    let in_vectors = VectorVariableSteps::new(method, &table.borrow(), 1).unwrap();
    let state = Aligned::zeros(table.borrow::<f64>().state_len(1, R));
    (VariableStepMemory::new(method, table, 1, state).unwrap(), in_vectors)
}

/// Passive kernels of every form with random parameters.
pub(crate) fn random_kernel(numbers: &mut impl FnMut() -> f64) -> TransferFunction {
    let form = (6.0 * numbers()) as usize;
    let mut time = || 10f64.powf(4.0 * numbers() - 2.0);
    let (one, other) = (time(), time());
    let mut between = |low: f64, high: f64| low + (high - low) * numbers();
    match form {
        0 => TransferFunction::tempered(between(0.05, 1.95), one),
        1 => TransferFunction::maxwell(between(0.05, 0.99), 0.0, one),
        2 => TransferFunction::maxwell(between(0.4, 1.0), between(0.0, 0.35), one),
        3 => TransferFunction::prony(&[between(0.1, 5.0), between(0.1, 5.0)], &[one, other]),
        4 => TransferFunction::havriliak_negami(between(0.1, 0.97), between(0.1, 1.0), one),
        _ => TransferFunction::havriliak_negami(1.0, between(0.1, 0.9), one),
    }
    .unwrap()
}

fn assert_equal_steps_of_kernels<const R: usize>(method: &RungeKutta<R>, seed: u64) {
    let count = 60;
    let mut numbers = noise(seed);
    for _ in 0..30 {
        let (transfer, step) = (random_kernel(&mut numbers), 10f64.powf(-3.0 * numbers()));
        let (steps, samples) = (vec![step; count], random_samples::<R>(count, 7));
        let weights = RungeKuttaWeights::of_transfer(method, &transfer, false, step, count).unwrap().planes();
        let (plain, in_vectors) = memories_of(method, &transfer, &steps);
        let found = operator_in::<f64, R>(plain, &steps, &samples);
        let other = operator_in::<f64, R>(in_vectors, &steps, &samples);
        let scale = largest(&found);
        for (k, (found, other)) in found.iter().zip(&other).enumerate() {
            for (a, (&found, &other)) in found.iter().zip(other).enumerate() {
                let mut expected = 0.0;
                for n in 0..=k {
                    for b in 0..R {
                        expected += weights[(a * R + b) * count + n] * samples[k - n][b];
                    }
                }
                let error = max_or_nan((found - expected).abs(), (other - expected).abs()) / scale;
                assert!(error < 10.0 * TOLERANCE, "{R} stages, {transfer}, h = {step}, step {k}: {error:e}");
            }
        }
    }
}

#[test]
fn equal_steps_are_runge_kutta_quadrature_of_any_kernel() {
    assert_equal_steps_of_kernels(&RungeKutta::<1>::radau_iia().unwrap(), 61);
    assert_equal_steps_of_kernels(&RungeKutta::<2>::radau_iia().unwrap(), 62);
    assert_equal_steps_of_kernels(&RungeKutta::<3>::radau_iia().unwrap(), 63);
    assert_equal_steps_of_kernels(&RungeKutta::<4>::lobatto_iiic().unwrap(), 64);
}

/// K(D) X on any grid by Cauchy's integral about the negative real axis, K(D) X = Σ_q K(s_q) y_q with
/// y the solutions of ẏ = s_q y + X by the method: nothing in common with rates.
fn on_a_contour<const R: usize>(
    method: &RungeKutta<R>,
    transfer: &TransferFunction,
    steps: &[f64],
    samples: &[[f64; R]],
) -> Vec<[f64; R]> {
    use nalgebra::Complex;
    type Matrix<const R: usize> = nalgebra::SMatrix<Complex<f64>, R, R>;
    let complex = |number: f64| Complex::new(number, 0.0);
    let matrix = Matrix::<R>::from_fn(|i, j| complex(method.matrix()[i][j]));
    let inverse = matrix.try_inverse().unwrap();
    let ones = nalgebra::SVector::<Complex<f64>, R>::repeat(complex(1.0));
    let shortest = steps.iter().copied().fold(f64::INFINITY, min_or_nan);
    // Two derivatives are taken of the samples, so that K/s² ends on both branches.
    let mut derivatives: Vec<nalgebra::SVector<Complex<f64>, R>> =
        samples.iter().map(|sample| nalgebra::SVector::from(sample.map(complex))).collect();
    for _ in 0..2 {
        let mut before = complex(0.0);
        for (&length, derivative) in steps.iter().zip(&mut derivatives) {
            let last = derivative[R - 1];
            *derivative = inverse * (*derivative - ones * before) / complex(length);
            before = last;
        }
    }
    let mut values = vec![nalgebra::SVector::<Complex<f64>, R>::zeros(); steps.len()];
    // s = s₀ + e^{y ± iφ}: two rays to the left from a place on the positive axis.
    const SPACING: f64 = 0.08;
    let total: f64 = steps.iter().sum();
    let (low, high) = (-40.0 - total.ln(), 40.0 - shortest.ln());
    let (place, angle) = (0.5 / total, 0.75 * std::f64::consts::PI);
    for node in 0..((high - low) / SPACING) as usize {
        let ray = Complex::from_polar((low + SPACING * node as f64).exp(), angle);
        let s = ray + place;
        // Both rays add up to twice the real part of the upper one: (1/2πi) ∫ F(s) y ds, ds = ray dy.
        let weight = transfer.value(s) / (s * s) * ray * SPACING / Complex::new(0.0, std::f64::consts::PI);
        let mut z = complex(0.0);
        for ((&length, derivative), value) in steps.iter().zip(&derivatives).zip(&mut values) {
            let resolvent = (Matrix::<R>::identity() - matrix * (s * length)).try_inverse().unwrap();
            let stages = resolvent * (ones * z + matrix * derivative * complex(length));
            *value += stages * weight;
            z = stages[R - 1];
        }
    }
    values.iter().map(|value| std::array::from_fn(|stage| value[stage].re)).collect()
}

#[test]
fn random_steps_of_any_kernel_agree_with_a_contour_integral() {
    let method = RungeKutta::<3>::radau_iia().unwrap();
    let mut numbers = noise(71);
    for seed in 0..20 {
        let transfer = random_kernel(&mut numbers);
        let (steps, samples) = (random_steps(60, 80 + seed), random_samples::<3>(60, 90 + seed));
        let expected = on_a_contour(&method, &transfer, &steps, &samples);
        let (plain, in_vectors) = memories_of(&method, &transfer, &steps);
        for found in [
            operator_in::<f64, 3>(plain, &steps, &samples),
            operator_in::<f64, 3>(in_vectors, &steps, &samples),
        ] {
            let scale = largest(&expected);
            for (k, (found, expected)) in found.iter().zip(&expected).enumerate() {
                for (found, expected) in found.iter().zip(expected) {
                    let error = (found - expected).abs() / scale;
                    assert!(error < 1e-10, "{transfer}, step {k}: {error:e}");
                }
            }
        }
    }
}
