//! The memory of steps of any length: against Runge–Kutta convolution quadrature on equal steps, and by the laws that
//! its operators obey on any grid.

use fvi_core::{Memory, RungeKutta, VariableStepMemory};
use fvi_host::numerics::aligned::Aligned;
use fvi_host::numerics::rate_table::rate_table;
use fvi_host::numerics::runge_kutta_weights::RungeKuttaWeights;

const TOLERANCE: f64 = 1e-12;

type AnyMemory<const R: usize> = VariableStepMemory<f64, R, Aligned<f64>, Aligned<f64>>;

fn memory<const R: usize>(method: &RungeKutta<R>, exponent: f64, steps: &[f64]) -> AnyMemory<R> {
    let shortest = steps.iter().copied().fold(f64::INFINITY, f64::min);
    let table = rate_table(method, exponent, shortest, steps.iter().sum(), TOLERANCE).unwrap();
    let state = Aligned::zeros(table.borrow::<f64>().state_len(1, R));
    VariableStepMemory::new(method, table, 1, state).unwrap()
}

/// D^β X at every stage of every step.
fn operator<const R: usize>(
    method: &RungeKutta<R>,
    exponent: f64,
    steps: &[f64],
    samples: &[[f64; R]],
) -> Vec<[f64; R]> {
    let mut memory = memory(method, exponent, steps);
    let step = |(&length, sample): (&f64, &[f64; R])| {
        memory.begin_step(length).unwrap();
        let mut value = [0.0; R];
        memory.next_term(&mut value).unwrap();
        for (value, row) in value.iter_mut().zip(memory.leading().chunks(R)) {
            *value += row.iter().zip(sample).map(|(w, x)| w * x).sum::<f64>();
        }
        memory.push(sample).unwrap();
        value
    };
    steps.iter().zip(samples).map(step).collect()
}

/// Steps whose lengths jump by factors up to 10³, and back.
fn random_steps(count: usize, seed: u64) -> Vec<f64> {
    let mut numbers = noise(seed);
    (0..count).map(|_| 10_f64.powf(3.0 * (numbers() - 1.0))).collect()
}

/// Numbers in [0, 1).
fn noise(seed: u64) -> impl FnMut() -> f64 {
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
    values.as_flattened().iter().fold(0.0, |largest, value| value.abs().max(largest))
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
