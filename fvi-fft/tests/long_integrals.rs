//! Fractional operators of single precision over very many samples, against double precision.

use fvi_core::{BdfOrder, ExponentialSum, FractionalIntegral, FractionalOperator, Kernel, Real, Start};
use fvi_fft::Aligned;
use fvi_fft::exponentials::exponential_table::ExponentialKernel;
use fvi_fft::sums::max_or_nan;

const ORDER: BdfOrder = BdfOrder::GRUNWALD_LETNIKOV;
const STEP: f64 = 1e-3;
const SAMPLES: usize = 2_000_000;

type Sum<T> = ExponentialSum<T, Aligned<T>, Vec<T>>;

fn kernel(exponent: f64) -> Kernel {
    Kernel::bdf(ORDER, exponent, STEP).unwrap()
}

/// The memory of D^exponent, on increments where there is such a table.
fn memory<T: Real>(exponent: f64, tolerance: f64) -> Sum<T> {
    let made = if exponent > 0.0 { ExponentialKernel::bdf_on_increments } else { ExponentialKernel::bdf };
    let table = made(ORDER, exponent, 1.0, SAMPLES + 1, tolerance).unwrap().table::<T>();
    let state = vec![T::of(0.0); table.borrow().state_len(1)];
    kernel(exponent).exponential_sum(table, 1, state).unwrap()
}

fn integral<T: Real>(order: f64, tolerance: f64) -> FractionalIntegral<T, Sum<T>> {
    FractionalIntegral::new(&kernel(1.0 - order), memory(1.0 - order, tolerance)).unwrap()
}

fn operator<T: Real>(order: f64, tolerance: f64) -> FractionalOperator<T, Sum<T>> {
    FractionalOperator::new(memory(-order, tolerance), Start::RiemannLiouville).unwrap()
}

/// Largest differences of single precision, relative to the largest value so far, in ten parts of the run.
fn errors(mut single: impl FnMut(f32) -> f32, mut double: impl FnMut(f64) -> f64) -> [f64; 10] {
    let (mut worst, mut size) = ([0.0f64; 10], 0.0f64);
    for sample in 0..SAMPLES {
        let x = 0.1 + (sample % 7) as f32 * 0.013 + if sample % 4096 < 2048 { 0.3 } else { -0.35 };
        let (found, expected) = (f64::from(single(x)), double(x.into()));
        size = max_or_nan(size, expected.abs());
        let part = &mut worst[sample / (SAMPLES / 10)];
        *part = max_or_nan(*part, (found - expected).abs() / size);
    }
    worst
}

#[test]
fn integrals_of_single_precision_do_not_drift() {
    for order in [0.5, 0.9, 1.5] {
        // Below 1 on the memory of the integral itself; above, the sum of one.
        let found = if order < 1.0 {
            let memory = memory::<f32>(-order, 1e-7);
            let mut single = FractionalIntegral::of_integral(&kernel(-order), memory).unwrap();
            let mut double = operator::<f64>(order, 1e-11);
            errors(|x| single.push(x).unwrap(), |x| double.push(x).unwrap())
        } else {
            let (mut single, mut double) = (integral::<f32>(order, 1e-7), integral::<f64>(order, 1e-11));
            errors(|x| single.push(x).unwrap(), |x| double.push(x).unwrap())
        };
        println!("order {order}: {found:?}");
        // In the last part of the run as in the first; ten million samples have the same errors.
        assert!(found.iter().all(|&error| error < 6e-7), "order {order}: {found:?}");
    }
}

#[test]
fn derivatives_of_signals_that_jump_do_not_drift() {
    const SAMPLES: usize = 500_000;
    // The slower the kernel falls, the more there is to gather: with sums that lose a digit of each jump the
    // errors are 10⁻³ by the end for D^0.1, and 10⁻⁴ for D^0.3. Of increments each rounded by itself two
    // thirds of that remain.
    for exponent in [0.1, 0.3, 0.75] {
        let mut single = FractionalOperator::new(memory::<f32>(exponent, 1e-7), Start::Caputo).unwrap();
        let mut double = FractionalOperator::new(memory::<f64>(exponent, 1e-11), Start::Caputo).unwrap();
        let (mut worst, mut size) = ([0.0f64; 2], 0.0f64);
        for sample in 0..SAMPLES {
            let x = [0.7f32, -0.3, 0.1][sample % 3] + if sample % 4096 < 2048 { 0.0 } else { 2.0 };
            let (found, expected) = (f64::from(single.push(x).unwrap()), double.push(x.into()).unwrap());
            size = max_or_nan(size, expected.abs());
            let late = usize::from(sample > SAMPLES / 2);
            worst[late] = worst[late].max((found - expected).abs());
        }
        let worst = worst.map(|error| error / size);
        println!("D^{exponent}: {worst:?} of {size}");
        assert!(worst.iter().all(|&error| error < 1e-6), "D^{exponent}: {worst:?}");
    }
}
