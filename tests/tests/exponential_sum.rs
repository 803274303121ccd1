//! The exponential-sum memory: every weight, and every term, against independent values.

use fvi_core::{BdfOrder, ConvolutionWeights, ExponentialSum, ExponentialTable, Memory, MemoryError};
use fvi_fft::exponentials::exponential_table::{
    ENDLESS, ENDLESS_REACH, ExponentialKernel, ExponentialKernelError, SMALLEST_TOLERANCE,
};
use fvi_fft::sums::max_or_nan;
use fvi_fft::{ChunkedExponentialSum, Engines, Vectorised};
use fvi_tests::reference;

/// Exponents of the quadrature: everywhere in (−1, 2), and near whole numbers.
const EXPONENTS: [f64; 7] = [-0.999, -0.5, -1e-3, 0.3, 1.001, 1.5, 1.99];

fn kernel(order: usize, exponent: f64, horizon: usize, tolerance: f64) -> ExponentialKernel {
    ExponentialKernel::bdf(BdfOrder::new(order).unwrap(), exponent, 1.0, horizon, tolerance).unwrap()
}

/// A memory that goes from sample to sample, and one that goes by chunks.
fn memories<T: Engines>(kernel: &ExponentialKernel) -> [(&'static str, Box<dyn Memory<T>>); 2] {
    let table = kernel.table::<T>();
    let state = vec![T::of(f64::NAN); table.borrow().state_len(1)];
    let chunked = ChunkedExponentialSum::<T, 1>::new(&kernel.table().borrow(), 1).unwrap();
    [
        ("by samples", Box::new(ExponentialSum::new(table, T::of(1.0), 1, state).unwrap())),
        ("in chunks", Box::new(chunked)),
    ]
}

/// Weights as a memory itself computes them: the answers to a unit pulse n steps ago.
fn pulse_answers(memory: &mut dyn Memory<f64>, lags: &[usize]) -> Vec<f64> {
    let mut term = [0.0];
    let mut answers = Vec::new();
    for step in 0..=*lags.last().unwrap() {
        memory.next_term(&mut term).unwrap();
        if lags.contains(&step) {
            answers.push(term[0]);
        }
        memory.push(&[if step == 0 { 1.0 } else { 0.0 }]).unwrap();
    }
    answers
}

#[test]
fn first_order_weights_hold_three_ulps_of_ten_up_to_a_hundred_million() {
    // Closed form w_n = Γ(n − β) / (Γ(−β) n!) at 40 digits; `reference/long_weights.py`.
    let rows = reference::read("long_weights.csv");
    let mut checked = 0;
    for group in rows.chunk_by(|a, b| a["exponent"] == b["exponent"]) {
        let kernel = kernel(1, group[0]["exponent"], 100_000_000, SMALLEST_TOLERANCE);
        for row in group {
            let (n, expected) = (row["n"] as usize, row["weight"]);
            let error = (kernel.weight(n) / expected - 1.0).abs();
            assert!(error <= 3e-15, "exponent {}, n = {n}: relative error {error:e}", row["exponent"]);
            checked += 1;
        }
    }
    assert!(checked >= 100, "only {checked} reference values were read");
}

#[test]
fn weights_of_every_order_hold_the_requested_tolerance() {
    let rows = reference::read("cq_weights.csv");
    for tolerance in [1e-6, 1e-10, 1e-13, SMALLEST_TOLERANCE] {
        for group in rows.chunk_by(|a, b| a["order"] == b["order"] && a["beta"] == b["beta"]) {
            let kernel = kernel(group[0]["order"] as usize, group[0]["beta"], 1_000_000, tolerance);
            for row in group.iter().filter(|row| row["weight"] != 0.0) {
                let (n, expected) = (row["n"] as usize, row["weight"]);
                let error = (kernel.weight(n) / expected - 1.0).abs();
                assert!(
                    error <= tolerance,
                    "order {}, exponent {}, n = {n}: relative error {error:e} with tolerance {tolerance:e}",
                    row["order"],
                    row["beta"]
                );
            }
        }
    }
}

type Make = fn(BdfOrder, f64, f64, usize, f64) -> Result<ExponentialKernel, ExponentialKernelError>;

#[test]
fn exponents_next_to_whole_numbers_have_tables() {
    for order in 1..=6 {
        for exponent in [1e-15, 1.0 - 1e-15, 1.0 + 1e-15, 2.0 - 1e-15, 2.0f64.next_down()] {
            let order = BdfOrder::new(order).unwrap();
            let exact = ConvolutionWeights::bdf(order, exponent, 1.0).unwrap();
            let sums = exact.clone().on_increments();
            // There are none of sums that hardly decay.
            let on_increments =
                (exponent > 0.1).then_some((ExponentialKernel::bdf_on_increments as Make, sums));
            let on_values = (ExponentialKernel::bdf as Make, exact);
            for (make, exact) in [on_values].into_iter().chain(on_increments) {
                let kernel = make(order, exponent, 1.0, 1_000_000, SMALLEST_TOLERANCE);
                let kernel = kernel.unwrap_or_else(|error| panic!("{order:?}, {exponent:e}: {error}"));
                for (n, exact) in exact.take(1000).enumerate() {
                    let error = (kernel.weight(n) - exact).abs();
                    // Later weights are next to nothing, and so are their errors.
                    let allowed = 2.0 * SMALLEST_TOLERANCE * exact.abs().max(1e-9);
                    assert!(error <= allowed, "{order:?}, {exponent:e}, n = {n}: {error:e} of {exact:e}");
                }
            }
        }
    }
}

#[test]
fn every_weight_is_within_the_smallest_tolerance_for_every_order_and_exponent() {
    // Lag by lag, where the search for a table looks at few of them.
    const LAGS: usize = 1000;
    for order in 1..=6 {
        for exponent in EXPONENTS {
            let weights = ConvolutionWeights::bdf(BdfOrder::new(order).unwrap(), exponent, 1.0).unwrap();
            let exact: Vec<f64> = weights.take(LAGS + 1).collect();
            let tolerance = SMALLEST_TOLERANCE;
            for horizon in [33, 1_000_000] {
                let kernel = kernel(order, exponent, horizon, tolerance);
                let errors = exact.iter().enumerate().take(horizon + 1).map(|(n, exact)| {
                    let error = (kernel.weight(n) - exact).abs();
                    if error == 0.0 { 0.0 } else { error / exact.abs() }
                });
                let error = errors.fold(0.0, max_or_nan);
                assert!(
                    error <= tolerance,
                    "order {order}, exponent {exponent}, horizon {horizon}: {error:e}"
                );
            }
        }
    }
}

#[test]
fn kernels_that_share_their_rates_hold_the_tolerance_with_a_few_more() {
    const LAGS: usize = 1500;
    let groups: [&[f64]; 6] =
        [&[0.3, 0.6], &[0.11, 1.9], &[0.999, 1.001], &[0.2, 0.5, 0.8, 1.4], &[-0.9, -0.1, 0.05], &[0.5, 0.5]];
    for order in [1, 2, 6] {
        for exponents in groups {
            for tolerance in [1e-6, SMALLEST_TOLERANCE] {
                let formula = BdfOrder::new(order).unwrap();
                let on_increments = exponents[0] > 0.0;
                let make = |exponents: &[f64]| {
                    ExponentialKernel::sharing_rates(
                        formula,
                        exponents,
                        on_increments,
                        1.0,
                        1 << 20,
                        tolerance,
                    )
                    .unwrap()
                };
                let shared = make(exponents);
                let rates = |kernel: &ExponentialKernel| -> Vec<f64> {
                    kernel.exponentials().iter().map(|exponential| exponential.rate).collect()
                };
                let mut most = 0;
                for (kernel, &exponent) in shared.iter().zip(exponents) {
                    assert_eq!(rates(kernel), rates(&shared[0]));
                    assert_eq!(kernel.head().len(), shared[0].head().len());
                    most = most.max(make(&[exponent])[0].exponentials().len());
                    let weights = ConvolutionWeights::bdf(formula, exponent, 1.0).unwrap();
                    let weights = if on_increments { weights.on_increments() } else { weights };
                    let exact: Vec<f64> = weights.take(LAGS + 1).collect();
                    let tail = exact[kernel.head().len()].abs() * kernel.head().len() as f64;
                    for (n, exact_weight) in exact.iter().enumerate() {
                        let error = (kernel.weight(n) - exact_weight).abs();
                        let held = error <= tolerance * exact_weight.abs()
                            || error / exact_weight.abs() * tail <= 1e-9 * tolerance * exact[0];
                        assert!(held, "{order}, {exponents:?}, {tolerance:e}, {exponent}: {error:e} at {n}");
                    }
                }
                let count = shared[0].exponentials().len();
                assert!(count <= most + 16, "{order}, {exponents:?}, {tolerance:e}: {count}, {most} alone");
            }
        }
    }
    let whole =
        ExponentialKernel::sharing_rates(BdfOrder::new(2).unwrap(), &[0.5, 1.0], true, 1.0, 1000, 1e-6);
    assert!(matches!(whole, Err(ExponentialKernelError::Parameter(error)) if error.value == 1.0));
}

#[test]
fn the_recursion_keeps_the_accuracy_of_the_weights() {
    let lags: Vec<usize> = [1, 2, 8, 9, 10, 100, 1000, 9999, 100_000, 299_999].into();
    for (order, exponent) in [(1, 0.3), (1, 0.5), (1, 1.9), (1, -0.5), (3, 0.5), (6, 1.5), (2, 1.0)] {
        let kernel = kernel(order, exponent, 1_000_000, SMALLEST_TOLERANCE);
        let exact: Vec<f64> = ConvolutionWeights::bdf(BdfOrder::new(order).unwrap(), exponent, 1.0)
            .unwrap()
            .take(300_000)
            .collect();
        for (name, mut memory) in memories(&kernel) {
            for (&n, found) in lags.iter().zip(pulse_answers(&mut *memory, &lags)) {
                let error = (found - exact[n]).abs();
                assert!(
                    error <= 4e-15 * exact[n].abs(),
                    "{name}, order {order}, exponent {exponent}, n = {n}: {found:e} instead of {:e}",
                    exact[n]
                );
            }
        }
    }
}

#[test]
fn dispatch_to_wider_vectors_and_more_channels_keep_every_bit() {
    let kernel = kernel(2, 0.5, 10_000, 1e-13);
    let table = kernel.table::<f64>();
    let state = |channels| vec![0.0; table.borrow().state_len(channels)];
    let mut plain = ExponentialSum::new(table.clone(), 0.7, 1, state(1)).unwrap();
    let mut wide = Vectorised::new(ExponentialSum::new(table.clone(), 0.7, 3, state(3)).unwrap());
    let (mut one, mut three) = ([0.0], [0.0; 3]);
    for k in 0..3000 {
        let x = (k as f64 * 0.37).sin();
        plain.next_term(&mut one).unwrap();
        wide.next_term(&mut three).unwrap();
        assert_eq!((one[0], one[0]), (three[0], three[2]), "step {k}");
        plain.push(&[x]).unwrap();
        wide.push(&[x, -1.0, x]).unwrap();
    }
}

#[test]
fn matrix_kernels_agree_with_the_sum_of_their_definition() {
    // Two stages, five exponentials in two blocks (one decays with changing sign), head of three.
    let (stages, head, horizon) = (2, 3, 500);
    let factors = [0.999, 0.9, 0.5, -0.8, 0.2];
    let output = [[1.0, 0.5], [0.3, -1.0], [0.7, 0.2], [-0.4, 0.9], [2.0, 1.0]];
    let input = [[0.2, 1.0], [1.0, 0.1], [-0.6, 0.8], [0.5, 0.5], [0.3, -0.7]];
    let weight = |n: usize, a: usize, b: usize| match n {
        0..3 => (n * 4 + a * 2 + b) as f64 - 5.0,
        _ => (0..5).map(|j| f64::powi(factors[j], (n - head) as i32) * output[j][a] * input[j][b]).sum(),
    };
    let mut planes = Vec::new();
    for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        planes.extend((0..head).map(|n| weight(n, a, b)));
    }
    let mut exponentials = Vec::new();
    for block in [0..4, 4..5] {
        let column = |value: &dyn Fn(usize) -> f64| {
            let mut column = [0.0; 4];
            block.clone().enumerate().for_each(|(lane, j)| column[lane] = value(j));
            column
        };
        exponentials.extend(column(&|j| 1.0 - factors[j]));
        (0..2).for_each(|a| exponentials.extend(column(&|j| output[j][a])));
        (0..2).for_each(|b| exponentials.extend(column(&|j| input[j][b])));
    }
    let table = ExponentialTable {
        stages,
        head: planes,
        exponentials,
        slow_blocks: 1,
        far_blocks: 0,
        horizon,
        step_size: 1.0,
    };
    let mut chunked = ChunkedExponentialSum::<f64, 2>::new(&table.borrow(), 4).unwrap();
    let state = vec![f64::NAN; table.borrow().state_len(4)];
    let mut memory = ExponentialSum::new(table, 2.0, 4, state).unwrap();
    assert_eq!(
        (memory.leading(), chunked.leading()),
        ([-10.0, -8.0, -6.0, -4.0].as_slice(), [-5.0, -4.0, -3.0, -2.0].as_slice())
    );
    let sample = |k: usize, channel: usize| ((k * 4 + channel) as f64 * 0.61).cos();
    let (mut term, mut chunked_term) = ([0.0; 4], [0.0; 4]);
    for k in 0..60 {
        memory.next_term(&mut term).unwrap();
        chunked.next_term(&mut chunked_term).unwrap();
        for (channel, (found, chunked)) in term.iter().zip(chunked_term).enumerate() {
            let (coordinate, a) = (channel / 2, channel % 2);
            let expected: f64 = (1..=k)
                .flat_map(|n| (0..2).map(move |b| (n, b)))
                .map(|(n, b)| 2.0 * weight(n, a, b) * sample(k - n, 2 * coordinate + b))
                .sum();
            for found in [*found, 2.0 * chunked] {
                let error = (found - expected).abs();
                assert!(error <= 1e-12, "step {k}, channel {channel}: {found} and {expected}");
            }
        }
        let sample: [f64; 4] = std::array::from_fn(|channel| sample(k, channel));
        memory.push(&sample).unwrap();
        chunked.push(&sample).unwrap();
    }
}

#[test]
fn a_full_memory_refuses_and_a_cleared_one_starts_again() {
    for (_, mut memory) in memories::<f64>(&kernel(1, 0.5, 300, 1e-10)) {
        let (mut first, mut again) = ([0.0], [0.0]);
        for _ in 0..299 {
            memory.push(&[1.0]).unwrap();
        }
        memory.next_term(&mut first).unwrap();
        memory.next_term(&mut again).unwrap();
        assert_eq!(first, again);
        memory.push(&[1.0]).unwrap();
        assert_eq!(memory.push(&[1.0]), Err(MemoryError::Full { capacity: 300 }));
        assert_eq!(memory.next_term(&mut again), Err(MemoryError::Full { capacity: 300 }));
        assert_eq!(memory.len(), 300);
        memory.clear();
        memory.next_term(&mut again).unwrap();
        assert_eq!((again, memory.len()), ([0.0], 0));
        (0..299).for_each(|_| memory.push(&[1.0]).unwrap());
        memory.next_term(&mut again).unwrap();
        assert_eq!(first, again);
        let mismatch = Err(MemoryError::ChannelMismatch { expected: 1, found: 2 });
        assert_eq!(memory.push(&[1.0, 2.0]), mismatch);
        assert_eq!(memory.next_term(&mut [0.0; 2]), mismatch);
    }
}

#[test]
fn whole_exponents_are_finite_kernels() {
    for (order, exponent, length) in [(1, 0.0, 1), (1, 1.0, 2), (6, 1.0, 7)] {
        let kernel = kernel(order, exponent, 10, SMALLEST_TOLERANCE);
        assert_eq!((kernel.head().len(), kernel.exponentials().len()), (length, 0));
        assert_eq!(kernel.horizon(), usize::MAX);
        assert_eq!(kernel.weight(1000), 0.0);
    }
}

#[test]
fn tables_that_do_not_fit_together_are_refused() {
    let good = ExponentialTable {
        stages: 1,
        head: vec![1.0, 2.0],
        exponentials: vec![0.5, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        slow_blocks: 1,
        far_blocks: 0,
        horizon: 100,
        step_size: 1.0,
    };
    let refusal = |table: ExponentialTable<Vec<f64>>, scale: f64, channels: usize, missing: usize| {
        let state = vec![0.0; table.borrow().state_len(channels).saturating_sub(missing)];
        ExponentialSum::new(table, scale, channels, state).err().map(|error| error.parameter)
    };
    assert_eq!(refusal(good.clone(), 1.0, 1, 0), None);
    assert_eq!(refusal(good.clone(), 1.0, 1, 1), Some("state length"));
    assert_eq!(refusal(good.clone(), f64::NAN, 1, 0), Some("scale"));
    assert_eq!(refusal(good.clone(), 1.0, 0, 0), Some("channels"));
    assert_eq!(refusal(ExponentialTable { stages: 5, ..good.clone() }, 1.0, 5, 0), Some("stages"));
    assert_eq!(refusal(ExponentialTable { stages: 0, ..good.clone() }, 1.0, 1, 0), Some("stages"));
    assert_eq!(
        refusal(ExponentialTable { head: vec![1.0], ..good.clone() }, 1.0, 1, 0),
        Some("head weights")
    );
    assert_eq!(refusal(ExponentialTable { slow_blocks: 2, ..good.clone() }, 1.0, 1, 0), Some("slow blocks"));
    let infinite = ExponentialTable { head: vec![1.0, f64::INFINITY], ..good.clone() };
    assert_eq!(refusal(infinite, 1.0, 1, 0), Some("head weight"));
    let numbers = |change: &dyn Fn(&mut Vec<f64>)| {
        let mut table = good.clone();
        change(&mut table.exponentials);
        refusal(table, 1.0, 1, 0)
    };
    assert_eq!(numbers(&|numbers| numbers.truncate(7)), Some("numbers of exponentials"));
    assert_eq!(numbers(&|numbers| numbers[0] = 2.5), Some("decay"));
    assert_eq!(numbers(&|numbers| numbers[3] = -0.1), Some("decay"));
    assert_eq!(numbers(&|numbers| numbers[4] = f64::NAN), Some("exponential"));
}

#[test]
fn parameters_outside_their_range_are_refused() {
    let refusal = |exponent, step, horizon, tolerance| {
        let order = BdfOrder::new(1).unwrap();
        ExponentialKernel::bdf(order, exponent, step, horizon, tolerance).err().map(|error| error.to_string())
    };
    assert_eq!(refusal(0.5, 1.0, 100, 1e-12), None);
    for (exponent, step, horizon, tolerance, named) in [
        (2.0, 1.0, 100, 1e-12, "exponent"),
        (f64::NAN, 1.0, 100, 1e-12, "exponent"),
        (0.5, 0.0, 100, 1e-12, "step size"),
        (0.5, 1.0, 0, 1e-12, "horizon"),
        (0.5, 1.0, 100, 1e-16, "tolerance"),
        (0.5, 1.0, 100, 0.5, "tolerance"),
    ] {
        let error = refusal(exponent, step, horizon, tolerance).expect(named);
        assert!(error.starts_with(named), "{error}");
    }
}

/// ln Γ(n + a) − ln Γ(n), for n so large that the rest of Stirling's series is rounding.
fn log_ratio_of_gammas(n: f64, a: f64) -> f64 {
    let series = |x: f64| 1.0 / (12.0 * x) - 1.0 / (360.0 * x.powi(3)) + 1.0 / (1260.0 * x.powi(5));
    (n - 0.5) * (a / n).ln_1p() + a * ((n + a).ln() - 1.0) + series(n + a) - series(n)
}

#[test]
fn endless_tables_hold_the_weights_for_thousands_of_years() {
    for exponent in [-0.8, -0.2, 0.3, 0.5, 0.9, 1.4] {
        let kernel = kernel(1, exponent, ENDLESS, 1e-7);
        assert_eq!(kernel.horizon(), ENDLESS);
        assert!(kernel.exponentials().iter().all(|e| e.rate > 0.0), "{exponent}");
        // w_n = Γ(n − β) / (Γ(−β) Γ(n + 1))
        let factor = 1.0 / libm::tgamma(-exponent);
        for power in (6..=50).step_by(2) {
            let n = 1usize << power;
            let exact = factor * libm::exp(log_ratio_of_gammas(n as f64 + 1.0, -exponent - 1.0));
            let error = (kernel.weight(n) / exact - 1.0).abs();
            assert!(error < 1.5e-7, "exponent {exponent}, lag 2^{power}: {error:e}");
        }
        // Beyond they fade.
        let [reach, later] = [ENDLESS_REACH, ENDLESS_REACH << 12].map(|n| kernel.weight(n as usize).abs());
        assert!(later < 1e-3 * reach, "{exponent}: {later:e} of {reach:e}");
        let (single, double) = (kernel.table::<f32>(), kernel.table::<f64>());
        assert_eq!((single.horizon, double.horizon), (u64::MAX, u64::MAX));
        assert!(single.far_blocks > 5 && double.far_blocks == 0, "{}", single.far_blocks);
        println!(
            "{exponent}: {} exponentials, {} far blocks of {}",
            kernel.exponentials().len(),
            single.far_blocks,
            single.slow_blocks
        );
    }
    let table = kernel(1, 0.5, 100_000_000, 1e-7).table::<f32>();
    assert_eq!((table.far_blocks, table.horizon), (0, 100_000_000));
}
