//! The controller of firmware: exponential sums in single precision against double precision and sums over
//! all samples, over long times, and ticks that come early or late.

use fvi_core::{
    AntiWindup, BdfOrder, ConvolutionWeights, DerivativeFilter, ExponentialPid, ExponentialSum,
    FractionalPid, PidGains, PidInputs, PidLaw, PidSettings, Real, RungeKutta, VariableStepMemory,
};
use fvi_fft::Aligned;
use fvi_fft::exponentials::exponential_table::ExponentialKernel;
use fvi_fft::exponentials::rate_table::rate_table;

const SAMPLE: f64 = 1e-3;

/// K_p, K_i, K_d as numbers that single precision holds.
const GAINS: [f64; 3] = [2.0, 1.5, 0.125];

fn settings<T: Real>(lambda: f64, mu: f64, sample: Option<f64>) -> PidSettings<T> {
    let [proportional, integral, derivative] = GAINS.map(T::of);
    PidSettings {
        integral_order: lambda,
        derivative_order: mu,
        sample,
        limits: [T::of(-4.0), T::of(4.0)],
        anti_windup: AntiWindup::BackCalculation { time: 0.25 },
        derivative_filter: DerivativeFilter::FirstOrder { time: 0.0078125 },
        ..PidSettings::new(PidGains::Parallel { proportional, integral, derivative }, SAMPLE)
    }
}

type Sum<T> = ExponentialSum<T, Aligned<T>, Vec<T>>;

/// A table of a kernel of backward differences, on increments where there is one.
fn sum<T: Real>(law: &PidLaw<T>, exponent: f64, horizon: usize, tolerance: f64) -> Sum<T> {
    let order = BdfOrder::GRUNWALD_LETNIKOV;
    let made = if exponent > 0.0 { ExponentialKernel::bdf_on_increments } else { ExponentialKernel::bdf };
    let table = made(order, exponent, 1.0, horizon, tolerance).unwrap().table::<T>();
    let state = vec![T::of(0.0); table.borrow().state_len(1)];
    let of_integral = law.integral_kernel().unwrap();
    let kernel = match of_integral.symbol().growth() == exponent {
        true => of_integral,
        false => law.derivative_kernel().unwrap(),
    };
    kernel.exponential_sum(table, 1, state).unwrap()
}

fn on_sums<T: Real>(
    lambda: f64,
    mu: f64,
    horizon: usize,
    tolerance: f64,
) -> FractionalPid<T, Sum<T>, Sum<T>> {
    let law = PidLaw::new(settings::<T>(lambda, mu, Some(SAMPLE))).unwrap();
    let (integral, derivative) =
        (sum(&law, lambda.floor() - lambda, horizon, tolerance), sum(&law, mu, horizon, tolerance));
    FractionalPid::new(law, integral, derivative).unwrap()
}

#[test]
fn single_precision_on_exponential_sums_follows_the_law_over_ten_million_ticks() {
    const TICKS: usize = 10_000_000;
    for (lambda, mu) in [(0.875, 0.5), (1.25, 0.75)] {
        let mut single = on_sums::<f32>(lambda, mu, TICKS + 1, 1e-7);
        let mut double = on_sums::<f64>(lambda, mu, TICKS + 1, 1e-13);
        // Signals that both precisions hold: setpoints that change every second and decade, a measured value
        // that approaches them; never long at the limits.
        let (mut r, mut y) = (0.0f32, 0.0f32);
        let mut worst = [0.0f64; 2];
        let mut limited = 0u32;
        for tick in 0..TICKS {
            if tick % 1000 == 0 {
                let turn = (tick / 1000) % 16;
                r = if turn < 8 { 0.5 * turn as f32 } else { -0.25 * (turn as f32 - 8.0) };
            }
            y += (r - y) * 0.015625;
            let found = f64::from(single.tick(r, y).unwrap());
            let expected = double.tick(r.into(), y.into()).unwrap();
            limited += u32::from(expected.abs() == 4.0);
            let late = usize::from(tick > TICKS / 2);
            worst[late] = worst[late].max((found - expected).abs());
        }
        let [early, late] = worst;
        println!(
            "λ = {lambda}, μ = {mu}: {early:.1e} in the first half, {late:.1e} in the second; limited {limited}"
        );
        assert!(limited > 1000 && (limited as usize) < TICKS / 2, "{limited}");
        // Of outputs up to 4: no drift.
        assert!(early < 2e-6 && late < 2e-6, "λ = {lambda}: {early:e} {late:e}");
    }
}

#[test]
fn after_a_hundred_seconds_at_the_limit_the_output_leaves_it_with_the_law() {
    const SATURATED: usize = 100_000;
    for lambda in [0.5, 0.875, 1.25] {
        let mut single = on_sums::<f32>(lambda, 0.5, 1 << 20, 1e-7);
        // The law with all samples of its integral, in double precision; without derivative there are none
        // of others.
        let settings = PidSettings {
            gains: PidGains::Parallel { proportional: GAINS[0], integral: GAINS[1], derivative: 0.0 },
            ..settings::<f64>(lambda, 0.5, Some(SAMPLE))
        };
        let gains =
            PidGains::Parallel { proportional: GAINS[0] as f32, integral: GAINS[1] as f32, derivative: 0.0 };
        single.set_gains(gains).unwrap();
        let weights: Vec<f64> = integral_weights(lambda, SATURATED + 4000);
        let AntiWindup::BackCalculation { time } = settings.anti_windup else { panic!() };
        let (scale, tracking) = (SAMPLE.powf(lambda), time.powf(-lambda));
        let mut samples: Vec<f64> = Vec::new();
        let mut past = 0.0;
        let (mut left, mut expected_left) = (None, None);
        for tick in 0..SATURATED + 3000 {
            let error = if tick < SATURATED { 8.0 } else { 8.0 - (tick - SATURATED) as f64 / 256.0 };
            // While the error stands the samples are those of a smooth function: the sum over all of them is
            // recomputed at every sixteenth tick of the first hundred seconds, and at every one at their end.
            let dense = tick + 1 >= SATURATED || tick % 16 == 0 || tick < 4096;
            if dense {
                past = weights[1..].iter().zip(samples.iter().rev()).map(|(w, x)| w * x).sum();
            }
            let full = GAINS[0] * error + scale * (past + GAINS[1] * error);
            let beyond = (full - full.clamp(-4.0, 4.0)) / (1.0 + scale * tracking);
            samples.push(GAINS[1] * error - tracking * beyond);
            let expected = full.clamp(-4.0, 4.0);
            let found = f64::from(single.tick(error as f32, 0.0).unwrap());
            if tick >= SATURATED {
                expected_left = expected_left.or((expected < 4.0).then_some(tick));
                left = left.or((found < 4.0).then_some(tick));
            }
        }
        let (left, expected) = (left.unwrap(), expected_left.unwrap());
        println!("λ = {lambda}: left at {left}, the law at {expected}");
        assert!(left.abs_diff(expected) <= 1, "λ = {lambda}: {left} and not {expected}");
    }
}

/// Weights of (1 − z)^{−λ}.
fn integral_weights(lambda: f64, count: usize) -> Vec<f64> {
    let of =
        |order: f64| ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, -order, 1.0).unwrap().take(count);
    if lambda < 1.0 {
        return of(lambda).collect();
    }
    let summed = |sum: &mut f64, weight: f64| {
        *sum += weight;
        Some(*sum)
    };
    of(lambda - 1.0).scan(0.0, summed).collect()
}

#[test]
fn a_controller_in_a_struct_has_a_name() {
    /// What a user writes.
    struct Axis<'w> {
        pid: ExponentialPid<'w, f32, 512, 512>,
    }
    // That its size is known is the point.
    assert!(size_of::<Axis<'_>>() > 4096);
    let _ = |axis: &mut Axis<'_>| axis.pid.tick(1.0, 0.0);
}

#[test]
fn ticks_that_come_early_or_late_take_the_time_that_has_passed() {
    // Equal ticks on a memory for steps of any length are those of the memory for equal steps.
    let (lambda, mu) = (0.75, 0.5);
    let method = RungeKutta::<1>::radau_iia().unwrap();
    let rates = |exponent: f64| {
        let table = rate_table::<f64, 1>(&method, exponent, 2e-4, 20.0, 1e-12).unwrap();
        let state = vec![0.0; table.borrow::<f64>().state_len(1, 1)];
        VariableStepMemory::<f64, 1, _, _>::new(&method, table, 1, state).unwrap()
    };
    let law = PidLaw::new(settings::<f64>(lambda, mu, None)).unwrap();
    let late = || FractionalPid::<f64, _, _>::new(law, rates(-lambda), rates(mu)).unwrap();
    let mut equal = on_sums::<f64>(lambda, mu, 100_000, 1e-13);
    let mut any = late();
    let mut y = 0.0;
    for tick in 0..2000 {
        let r = if tick % 700 < 350 { 1.0 } else { -0.5 };
        let (expected, found) =
            (equal.tick(r, y).unwrap(), any.tick_after(SAMPLE, &PidInputs::new(r, y)).unwrap());
        assert!((found - expected).abs() < 1e-8, "{tick}: {found} {expected}");
        y += 0.01 * (expected - y);
    }
    // Ticks of many lengths approach the same continuous law: the integral of order λ of 1 by itself.
    let integral_of = |intervals: &dyn Fn(usize) -> f64| {
        let gains = PidGains::Parallel { proportional: 0.0, integral: 1.0, derivative: 0.0 };
        let plain = PidSettings { sample: None, integral_order: lambda, ..PidSettings::new(gains, SAMPLE) };
        let law = PidLaw::new(plain).unwrap();
        let mut pid = FractionalPid::<f64, _, _>::new(law, rates(-lambda), rates(1.0)).unwrap();
        let (mut time, mut output) = (0.0, 0.0);
        for tick in 0..4000 {
            let interval = intervals(tick);
            time += interval;
            output = pid.tick_after(interval, &PidInputs::new(1.0, 0.0)).unwrap();
        }
        // t^λ/Γ(1 + λ), Γ(7/4) = 0.919 062 526 8
        output * 0.919_062_526_848_883_2 / time.powf(lambda) - 1.0
    };
    for intervals in
        [&(|_| SAMPLE) as &dyn Fn(usize) -> f64, &|tick| SAMPLE * (0.5 + (tick * 7 % 11) as f64 / 10.0)]
    {
        let error = integral_of(intervals);
        assert!(error.abs() < 1e-3, "{error:e}");
    }
}
