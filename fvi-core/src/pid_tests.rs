//! The controller against a law that keeps all samples and is evaluated anew at every tick.

use std::vec;
use std::vec::Vec;

use crate::direct::FixedDirect;
use crate::memory::Memory;
use crate::memoryless::Memoryless;
use crate::noise::noise;
use crate::pid::{Actuator, FractionalPid, PidError, PidInputs, RingPi, RingPid};
use crate::pid_law::{AntiWindup, Bumpless, DerivativeFilter, DerivativeOf, PidGains, PidLaw, PidSettings};
use crate::saving::{StateReader, StateWriter, Stateful};
use crate::weights::{BdfOrder, ConvolutionWeights};

const ORDER: BdfOrder = BdfOrder::GRUNWALD_LETNIKOV;

/// Coefficients of (1 − z)^power, by a recursion.
fn binomials(power: f64, count: usize) -> Vec<f64> {
    let next = |last: &mut f64, n: usize| {
        *last *= if n == 0 { 1.0 } else { 1.0 - (power + 1.0) / n as f64 };
        Some(*last)
    };
    (0..count).scan(1.0, next).collect()
}

/// The law in double precision, from all samples at every tick; equations with limits are solved by
/// bisection.
struct Reference {
    settings: PidSettings<f64>,
    step: f64,
    /// Samples of the integral, and the sum of all transfers.
    samples: Vec<f64>,
    offset: f64,
    /// Samples of the derivative and of the fractional filter, and the output of the filter of order 1.
    signals: Vec<f64>,
    behind: Vec<f64>,
    filtered: f64,
    last_integral: f64,
    output: f64,
    has_ticked: bool,
    manual: Option<f64>,
    transfer: bool,
    gains: PidGains<f64>,
}

impl Reference {
    fn new(settings: PidSettings<f64>) -> Self {
        Self {
            settings,
            step: settings.sample.unwrap(),
            samples: Vec::new(),
            offset: 0.0,
            signals: Vec::new(),
            behind: Vec::new(),
            filtered: 0.0,
            last_integral: 0.0,
            output: 0.0,
            has_ticked: false,
            manual: None,
            transfer: false,
            gains: settings.gains,
        }
    }

    /// s^power of a sequence at its last sample, and the derivative by that sample.
    fn operator(&self, power: f64, samples: &[f64]) -> (f64, f64) {
        let scale = self.step.powf(-power);
        let weights = binomials(power, samples.len());
        let sum: f64 = weights.iter().zip(samples.iter().rev()).map(|(w, x)| w * x).sum();
        (scale * sum, scale)
    }

    /// The x with x + time s^power x = signal, after the previous ones.
    fn relax(&self, power: f64, time: f64, signal: f64) -> f64 {
        let mut all = self.behind.clone();
        all.push(0.0);
        let (past, leading) = self.operator(power, &all);
        (signal - time * past) / (1.0 + time * leading)
    }

    /// The derivative, filtered, or the lag of the series form.
    fn derived(&mut self, inputs: &PidInputs<f64>) -> f64 {
        let settings = self.settings;
        let (r, y) = (inputs.setpoint, inputs.measured);
        let [_, c] = settings.setpoint_weights;
        match settings.gains {
            PidGains::Series { derivative_time, filter_ratio, .. } => {
                let order = settings.derivative_order;
                let behind = self.relax(order, derivative_time / filter_ratio, r - y);
                self.behind.push(behind);
                behind
            }
            PidGains::Parallel { .. } => {
                let (signal, order) = match settings.derivative_of {
                    DerivativeOf::MeasuredRate => (-inputs.rate, settings.derivative_order - 1.0),
                    _ => (c * r - y, settings.derivative_order),
                };
                self.signals.push(signal);
                let first = if settings.derivative_of == DerivativeOf::ValuesFromRest {
                    self.signals[0]
                } else {
                    0.0
                };
                let acted_on: Vec<f64> = self.signals.iter().map(|x| x - first).collect();
                let (value, _) = self.operator(order, &acted_on);
                match settings.derivative_filter {
                    DerivativeFilter::None => value,
                    DerivativeFilter::FirstOrder { time } => {
                        self.filtered = (time / self.step * self.filtered + value) / (1.0 + time / self.step);
                        self.filtered
                    }
                    DerivativeFilter::Fractional { time, order } => {
                        let behind = self.relax(order, time, value);
                        self.behind.push(behind);
                        behind
                    }
                }
            }
        }
    }

    /// The derivative, or the lag of the series form, had the gains of the last tick been kept.
    fn derived_before(&mut self, error: f64, derived: f64) -> f64 {
        let PidGains::Series { derivative_time, filter_ratio, .. } = self.gains else { return derived };
        let last = self.behind.pop();
        let kept = self.relax(self.settings.derivative_order, derivative_time / filter_ratio, error);
        self.behind.extend(last);
        kept
    }

    fn tick(&mut self, inputs: &PidInputs<f64>) -> f64 {
        let settings = self.settings;
        let (r, y) = (inputs.setpoint, inputs.measured);
        let [b, _] = settings.setpoint_weights;
        let derived = self.derived(inputs);
        let kept = self.derived_before(r - y, derived);
        self.has_ticked = true;
        // The output without the integral, and the sample of the integral.
        let terms = |gains: PidGains<f64>, derived: f64| match gains {
            PidGains::Parallel { proportional, integral, derivative } => {
                (proportional * (b * r - y), derivative * derived, integral, integral * (r - y))
            }
            PidGains::Series { proportional, integral_rate, filter_ratio, .. } => {
                let lead = filter_ratio * (r - y) + (1.0 - filter_ratio) * derived;
                let gain = proportional * integral_rate;
                (proportional * lead, 0.0, gain, gain * lead)
            }
        };
        let now = terms(settings.gains, derived);
        let range = settings.rate_limit * self.step;
        let clamp = |u: f64| u.max(settings.limits[0]).min(settings.limits[1]);
        let (least, most) = (clamp(self.output - range), clamp(self.output + range));
        if let Some(manual) = self.manual {
            self.output = manual.max(least).min(most);
            self.gains = settings.gains;
            return self.output;
        }
        let integral = |sample: f64| {
            let mut all = self.samples.clone();
            all.push(sample);
            self.operator(-settings.integral_order, &all).0 + self.offset
        };
        let beside = now.0 + now.1 + inputs.feed_forward;
        let (mut shift, old) = (0.0, terms(self.gains, kept));
        if self.transfer && now.2 != 0.0 {
            shift = self.output - beside - integral(now.3);
        } else if self.gains != settings.gains
            && (now.2 != 0.0 || old.2 != 0.0)
            && settings.bumpless != Bumpless::Nothing
        {
            shift = old.1 - now.1 + integral(old.3) - integral(now.3);
            if settings.bumpless == Bumpless::Whole || matches!(settings.gains, PidGains::Series { .. }) {
                shift += old.0 - now.0;
            }
        }
        let whole = |sample: f64| beside + integral(sample) + shift;
        let mut sample = now.3;
        let start = self.last_integral + shift;
        if now.2 != 0.0 {
            // The sample between two for which `f` rises through zero.
            let bisect = |f: &dyn Fn(f64) -> f64| {
                let (mut low, mut high) = (-1e9, 1e9);
                for _ in 0..200 {
                    let middle = 0.5 * (low + high);
                    if f(middle) < 0.0 { low = middle } else { high = middle }
                }
                0.5 * (low + high)
            };
            match (settings.anti_windup, inputs.actuator) {
                (_, Actuator::Limited) => {
                    let target = (integral(sample) + shift).max(start.min(0.0)).min(start.max(0.0));
                    sample = bisect(&|v| integral(v) + shift - target);
                }
                (AntiWindup::BackCalculation { time }, actuator) => {
                    let tracking = time.powf(-settings.integral_order);
                    if let Actuator::Applied(applied) = actuator {
                        // f = (u_applied − u − w f)/τ^λ: what is fed back changes the gap.
                        let (_, leading) = self.operator(-settings.integral_order, &[]);
                        sample += tracking * (applied - self.output) / (1.0 + leading * tracking);
                    }
                    sample = bisect(&|v| {
                        let raw = whole(v);
                        v - sample - tracking * (raw.max(least).min(most) - raw)
                    });
                }
                (AntiWindup::Conditional, actuator) => {
                    let (mut low, mut high) = (least, most);
                    if let Actuator::Applied(applied) = actuator {
                        if applied > self.output {
                            low = applied
                        }
                        if applied < self.output {
                            high = applied
                        }
                    }
                    let alone = integral(0.0) + shift;
                    let full = integral(sample) + shift;
                    if whole(sample) > high {
                        let target = full.min((high - beside).max(start.min(alone)));
                        sample = bisect(&|v| integral(v) + shift - target);
                    } else if whole(sample) < low {
                        let target = full.max((low - beside).min(start.max(alone)));
                        sample = bisect(&|v| integral(v) + shift - target);
                    }
                }
                (AntiWindup::None, _) => {}
            }
        }
        let (output, value) = (whole(sample).max(least).min(most), integral(sample) + shift);
        (self.output, self.last_integral) = (output, value);
        self.samples.push(sample);
        self.offset += shift;
        (self.transfer, self.gains) = (false, settings.gains);
        self.output
    }

    fn manual(&mut self, output: f64) {
        if !self.has_ticked {
            let [lowest, highest] = self.settings.limits;
            self.output = output.max(lowest).min(highest);
        }
        if self.manual.is_none() {
            self.samples.clear();
            (self.offset, self.last_integral) = (0.0, 0.0);
        }
        (self.manual, self.transfer) = (Some(output), false);
    }

    fn automatic(&mut self) {
        self.transfer |= self.manual.take().is_some();
    }
}

const HISTORY: usize = 1024;

type Full<'w> = FixedDirect<'w, f64, 1, HISTORY>;

/// Weights on increments of derivatives, on values of integrals.
fn table(exponent: f64) -> Vec<f64> {
    let weights = ConvolutionWeights::bdf(ORDER, exponent, 1.0).unwrap();
    if exponent > 0.0 {
        weights.on_increments().take(HISTORY).collect()
    } else {
        weights.take(HISTORY).collect()
    }
}

/// Laws of every form, filter, limit and order.
fn laws() -> Vec<PidSettings<f64>> {
    let parallel = |p, i, d| PidGains::Parallel { proportional: p, integral: i, derivative: d };
    let of = |gains, lambda, mu| PidSettings {
        integral_order: lambda,
        derivative_order: mu,
        derivative_of: DerivativeOf::Values,
        ..PidSettings::new(gains, 0.01)
    };
    let back = AntiWindup::BackCalculation { time: 0.2 };
    let series =
        PidGains::Series { proportional: 1.5, integral_rate: 2.0, derivative_time: 0.05, filter_ratio: 8.0 };
    vec![
        of(parallel(2.0, 3.0, 0.2), 0.7, 0.6),
        PidSettings { limits: [-2.0, 1.5], anti_windup: back, ..of(parallel(2.0, 3.0, 0.2), 0.9, 0.5) },
        PidSettings {
            limits: [-2.0, 1.5],
            rate_limit: 20.0,
            anti_windup: back,
            setpoint_weights: [0.5, 0.25],
            derivative_filter: DerivativeFilter::FirstOrder { time: 0.03 },
            bumpless: Bumpless::ExceptProportional,
            ..of(parallel(2.0, 3.0, 0.2), 1.0, 1.0)
        },
        PidSettings {
            limits: [-1.0, 4.0],
            anti_windup: AntiWindup::Conditional,
            derivative_of: DerivativeOf::ValuesFromRest,
            derivative_filter: DerivativeFilter::Fractional { time: 0.1, order: 0.8 },
            ..of(parallel(-2.0, -3.0, -0.05), 0.4, 1.3)
        },
        PidSettings {
            limits: [-2.0, 2.0],
            rate_limit: 50.0,
            anti_windup: AntiWindup::Conditional,
            derivative_of: DerivativeOf::MeasuredRate,
            bumpless: Bumpless::Nothing,
            ..of(parallel(1.0, 4.0, 0.3), 1.4, 0.7)
        },
        PidSettings { limits: [-2.0, 2.0], anti_windup: back, ..of(parallel(1.0, 4.0, 0.0), 1.6, 0.5) },
        PidSettings { limits: [-2.0, 2.0], ..of(parallel(1.0, 0.0, 0.3), 0.5, 0.5) },
        PidSettings { limits: [-2.0, 2.0], anti_windup: back, ..of(series, 0.8, 0.9) },
        PidSettings { anti_windup: AntiWindup::Conditional, limits: [-3.0, 3.0], ..of(series, 1.2, 1.2) },
    ]
}

/// A controller with the memories of its law.
fn on<'w>(
    settings: PidSettings<f64>,
    [integral, derivative, filter]: &'w [Vec<f64>; 3],
) -> FractionalPid<f64, Full<'w>, Full<'w>, PidLaw<f64>, Full<'w>> {
    let law = PidLaw::new(settings).unwrap();
    let integral = law.integral_kernel().unwrap().full_memory(integral).unwrap();
    let derivative = law.derivative_kernel().unwrap().full_memory(derivative).unwrap();
    match law.filter_kernel().unwrap() {
        Some(kernel) => {
            FractionalPid::with_filter(law, integral, derivative, kernel.full_memory(filter).unwrap())
                .unwrap()
        }
        None => FractionalPid::with_parts(law, integral, Some(derivative), None).unwrap(),
    }
}

fn tables(settings: &PidSettings<f64>) -> [Vec<f64>; 3] {
    let law = PidLaw::new(*settings).unwrap();
    let of = |kernel: crate::kernel::Kernel| table(kernel.symbol().growth());
    let filter = law.filter_kernel().unwrap().map(of).unwrap_or_default();
    [of(law.integral_kernel().unwrap()), of(law.derivative_kernel().unwrap()), filter]
}

fn bytes_of<I, D, F>(pid: &FractionalPid<f64, I, D, PidLaw<f64>, F>) -> Vec<u8>
where
    I: Memory<f64>,
    D: Memory<f64>,
    F: Memory<f64>,
{
    let mut bytes = vec![0; pid.state_bytes()];
    let mut writer = StateWriter::new(&mut bytes);
    pid.save(&mut writer).unwrap();
    assert_eq!(writer.written(), bytes.len());
    bytes
}

#[test]
fn calls_of_every_kind_give_the_outputs_of_the_law() {
    for (index, settings) in laws().into_iter().enumerate() {
        let tables = tables(&settings);
        let mut pid = on(settings, &tables);
        let mut reference = Reference::new(settings);
        let mut numbers = noise(20 * HISTORY).into_iter().skip(1000 * index).cycle();
        let mut random = || 2.0 * numbers.next().unwrap();
        let (mut r, mut y) = (0.0, 0.3);
        let (mut limited, mut worst) = (0, 0.0f64);
        for tick in 0..HISTORY {
            match tick % 40 {
                0 => r = 4.0 * random(),
                7 if tick > 300 => {
                    let factor = 1.0 + 0.5 * random();
                    let gains = match pid.law().settings().gains {
                        PidGains::Parallel { proportional, integral, derivative } => PidGains::Parallel {
                            proportional: proportional / factor,
                            integral: integral * factor,
                            derivative: derivative / factor,
                        },
                        PidGains::Series { proportional, integral_rate, derivative_time, filter_ratio } => {
                            PidGains::Series {
                                proportional: proportional * factor,
                                integral_rate: integral_rate / factor,
                                derivative_time: derivative_time * factor,
                                filter_ratio: filter_ratio * factor,
                            }
                        }
                    };
                    pid.set_gains(gains).unwrap();
                    reference.settings.gains = gains;
                }
                17 if tick > 600 => {
                    let output = 3.0 * random();
                    pid.manual(output).unwrap();
                    reference.manual(output);
                }
                23 => {
                    pid.automatic();
                    reference.automatic();
                }
                _ => {}
            }
            y += 0.05 * (pid.output() + random() - y);
            let actuator = match tick % 11 {
                3 => Actuator::Applied(pid.output() + 0.2 * random()),
                5 if tick > 400 => Actuator::Limited,
                _ => Actuator::Followed,
            };
            let feed_forward = if tick % 50 > 25 { 0.3 } else { 0.0 };
            let inputs = PidInputs { setpoint: r, measured: y, rate: random(), feed_forward, actuator };
            if tick % 5 == 0 {
                // Refused calls, and a restored controller that continues.
                let before = bytes_of(&pid);
                for wrong in [
                    PidInputs { measured: f64::NAN, ..inputs },
                    PidInputs { setpoint: f64::INFINITY, ..inputs },
                    PidInputs { feed_forward: f64::NAN, ..inputs },
                    PidInputs { actuator: Actuator::Applied(f64::NAN), ..inputs },
                    PidInputs { measured: f64::MAX, setpoint: -f64::MAX, ..inputs },
                ] {
                    assert!(pid.tick_with(&wrong).is_err());
                }
                let by_rate = settings.derivative_of == DerivativeOf::MeasuredRate;
                assert!(!by_rate || pid.tick(r, y).is_err(), "a rate is missing");
                assert_eq!(pid.tick_after(0.01, &inputs), Err(PidError::Interval));
                assert!(pid.manual(f64::NAN).is_err());
                assert_eq!(bytes_of(&pid), before);
                let mut other = on(*pid.law().settings(), &tables);
                let mut reader = StateReader::new(&before);
                assert_eq!(other.check_state(&mut reader.clone()), Ok(()));
                assert_eq!((other.restore(&mut reader), reader.finish()), (Ok(()), Ok(())));
                pid = other;
            }
            let (output, expected) = (pid.tick_with(&inputs).unwrap(), reference.tick(&inputs));
            limited += usize::from(settings.limits.contains(&output));
            worst = worst.max((output - expected).abs());
            assert!((output - expected).abs() < 1e-8, "law {index}, tick {tick}: {output} {expected}");
            assert!((pid.integral() - reference.last_integral).abs() < 1e-7 || pid.is_manual());
        }
        assert!(limited > 40 || settings.limits[1].is_infinite(), "law {index} has not seen its limits");
        assert!(worst < 1e-8);
        // The memory is full: refused as a whole.
        let before = bytes_of(&pid);
        if pid.integral_memory().len() == HISTORY {
            assert!(pid.tick(1.0, 0.0).is_err());
            assert_eq!(bytes_of(&pid), before);
        }
    }
}

#[test]
fn a_loop_at_rest_starts_without_a_kick_unless_asked_to() {
    for mu in [0.4, 1.0, 1.5] {
        let gains = PidGains::Parallel { proportional: 2.0, integral: 1.0, derivative: 0.5 };
        let rest = PidSettings {
            integral_order: 0.8,
            derivative_order: mu,
            setpoint_weights: [1.0, 0.5],
            ..PidSettings::new(gains, 0.01)
        };
        let tables = tables(&rest);
        let mut pid = on(rest, &tables);
        for _ in 0..50 {
            assert_eq!(pid.tick(20.0, 20.0), Ok(0.0), "order {mu}");
        }
        // What comes later is seen as it is: a step of y.
        let seen = pid.tick(20.0, 21.0).unwrap();
        let expected = -2.0 - 0.01f64.powf(0.8) - 0.5 * 0.01f64.powf(-mu);
        assert!((seen - expected).abs() < 1e-12 * expected.abs(), "order {mu}: {seen} {expected}");
        // After `reset` it starts at rest again, and so it does where the first output is set by hand.
        pid.reset();
        assert_eq!(pid.tick(-3.0, -3.0), Ok(0.0));
        // c r − y from 0 to −10: a kick of −10 K_d h^{−μ}.
        let mut kicks = on(PidSettings { derivative_of: DerivativeOf::Values, ..rest }, &tables);
        let kick = -5.0 * 0.01f64.powf(-mu);
        assert!((kicks.tick(20.0, 20.0).unwrap() - kick).abs() < 1e-12 * kick.abs(), "order {mu}");
    }
    // The series form acts on r − y: there is nothing to start from.
    let gains =
        PidGains::Series { proportional: 1.5, integral_rate: 2.0, derivative_time: 0.05, filter_ratio: 8.0 };
    let settings = PidSettings::new(gains, 0.01);
    let tables = tables(&settings);
    assert_eq!(on(settings, &tables).tick(20.0, 20.0), Ok(0.0));
}

#[test]
fn an_actuator_that_cannot_follow_winds_the_integral_back_for_every_tracking_time() {
    // An actuator that stops at L, unknown to the law, with any tracking time down to 10⁻⁴ of a sample.
    // The feedback solved with its own effect is stable for 0 < λ < 2: (1 − z)^λ = −s z with 0 < s < 1 has no
    // solution in |z| ≤ 1.
    let mut numbers = noise(40_000).into_iter().map(|number| number + 0.5);
    let mut random = |low: f64, high: f64| low + (high - low) * numbers.next().unwrap();
    for case in 0..300 {
        let lambda = random(0.05, 1.95);
        let sample = 10f64.powf(random(-4.0, 0.5));
        let time = sample * 10f64.powf(random(-4.0, 3.0));
        let gain = 10f64.powf(random(-1.0, 1.0));
        let gains = PidGains::Parallel { proportional: gain, integral: gain, derivative: 0.0 };
        let limit = random(0.1, 2.0);
        let own = if case % 3 == 0 { 2.0 * limit } else { f64::INFINITY };
        let settings = PidSettings {
            integral_order: lambda,
            anti_windup: AntiWindup::BackCalculation { time },
            limits: [-own, own],
            ..PidSettings::new(gains, sample)
        };
        let tables = tables(&settings);
        let mut pid = on(settings, &tables);
        // Without the error: whatever the integral holds comes to the limit. 1 is far beyond for a while.
        let mut largest = 0.0f64;
        for tick in 0..HISTORY - 1 {
            let error = if tick < 100 { random(0.0, 2.0) } else { 0.0 };
            let output = pid.tick_applied(error, 0.0, pid.output().clamp(-limit, limit)).unwrap();
            assert_eq!(output, pid.output());
            largest = largest.max(output.abs());
        }
        // K_i h^λ e and K_p e of one tick, beyond what the actuator takes.
        let bound = 4.0 * (limit + 2.0 * gain * (1.0 + sample.powf(lambda)) + 2.0 * gain * time.powf(lambda));
        assert!(
            largest < bound,
            "case {case}: λ = {lambda}, h = {sample}, τ = {time}: {largest} and {bound}"
        );
    }
}

#[test]
fn the_output_leaves_its_limit_when_the_law_with_its_whole_memory_does() {
    // 100 s at the limit, in single precision with a ring of all of them.
    const TICKS: usize = 10_240;
    for (kind, lambda) in [
        (AntiWindup::BackCalculation { time: 0.5 }, 0.8),
        (AntiWindup::BackCalculation { time: 0.5 }, 1.3),
        (AntiWindup::Conditional, 0.8),
        (AntiWindup::Conditional, 1.3),
    ] {
        let gains = PidGains::Parallel { proportional: 1.0, integral: 2.0, derivative: 0.0 };
        let settings = PidSettings {
            integral_order: lambda,
            limits: [-1.0, 1.0],
            anti_windup: kind,
            ..PidSettings::new(gains, 0.01)
        };
        let gains = PidGains::Parallel { proportional: 1.0f32, integral: 2.0, derivative: 0.0 };
        let law = PidLaw::new(PidSettings {
            integral_order: lambda,
            limits: [-1.0, 1.0],
            anti_windup: kind,
            ..PidSettings::new(gains, 0.01)
        })
        .unwrap();
        let weights: Vec<f32> = {
            let weights = ConvolutionWeights::bdf(ORDER, f64::floor(lambda) - lambda, 1.0).unwrap();
            weights.take(TICKS).map(|weight| weight as f32).collect()
        };
        let memory = law.integral_kernel().unwrap().full_memory(&weights).unwrap();
        let mut pid = RingPi::<f32, TICKS>::without_derivative(law, memory).unwrap();
        // The law evaluated with all of its samples.
        let weights = binomials(-lambda, TICKS + 1);
        let scale = settings.sample.unwrap().powf(lambda);
        let (mut samples, mut left, mut expected_left) = (Vec::<f64>::new(), None, None);
        let mut last = 0.0;
        for tick in 0..TICKS {
            // The error shrinks after 100 s until the output must leave.
            let error = if tick < 10_000 { 3.0 } else { 3.0 - 0.05 * (tick - 10_000) as f64 };
            let past: f64 = weights[1..].iter().zip(samples.iter().rev()).map(|(w, x)| w * x).sum();
            let alone = scale * past;
            let full = error + alone + scale * 2.0 * error;
            let sample = match kind {
                AntiWindup::BackCalculation { time } if full > 1.0 => {
                    let tracking = time.powf(-lambda);
                    2.0 * error - tracking * (full - 1.0) / (1.0 + scale * tracking)
                }
                AntiWindup::Conditional if full > 1.0 => {
                    let target = (1.0 - error).max(alone.min(last)).min(alone + scale * 2.0 * error);
                    (target - alone) / scale
                }
                _ => 2.0 * error,
            };
            samples.push(sample);
            last = alone + scale * sample;
            let expected = error + last;
            let output = pid.tick(error as f32, 0.0).unwrap();
            if tick > 10_000 {
                expected_left = expected_left.or((expected < 1.0 - 1e-6).then_some(tick));
                left = left.or((output < 1.0 - 1e-6).then_some(tick));
            }
        }
        let (left, expected) = (left.unwrap(), expected_left.unwrap());
        assert!(left.abs_diff(expected) <= 1, "{kind:?}, {lambda}: {left} and not {expected}");
        assert!(expected < 10_070, "{kind:?}, {lambda}: wound up until {expected}");
    }
}

#[test]
fn transfers_have_no_bump() {
    let [settings, ..] = laws()[..] else { panic!() };
    let tables = self::tables(&settings);
    let mut pid = on(settings, &tables);
    for _ in 0..100 {
        pid.tick(1.0, 0.2).unwrap();
    }
    pid.manual(0.75).unwrap();
    for _ in 0..50 {
        assert_eq!(pid.tick(1.0, 0.4), Ok(0.75));
    }
    pid.automatic();
    assert!((pid.tick(1.0, 0.4).unwrap() - 0.75).abs() < 1e-14);
    // The integral goes on: up, since the error is positive.
    assert!(pid.tick(1.0, 0.4).unwrap() > 0.75);
    // The first output with new gains is that of the old ones; or differs by the proportional term.
    for (bumpless, gap) in [(Bumpless::Whole, 0.0), (Bumpless::ExceptProportional, 3.0 * 0.6)] {
        let mut old = pid.clone();
        old.set_law(PidLaw::new(PidSettings { bumpless, ..settings }).unwrap()).unwrap();
        let mut new = old.clone();
        new.set_gains(PidGains::Parallel { proportional: 5.0, integral: 1.0, derivative: 0.9 }).unwrap();
        let (before, after) = (old.tick(1.0, 0.4).unwrap(), new.tick(1.0, 0.4).unwrap());
        assert!((after - before - gap).abs() < 1e-13, "{bumpless:?}: {before} {after}");
    }
    // The series form has its filter within its proportional part: no gain of it changes the output.
    let series = |time, ratio| PidGains::Series {
        proportional: 2.0,
        integral_rate: 0.5,
        derivative_time: time,
        filter_ratio: ratio,
    };
    let settings = PidSettings { derivative_order: 0.6, ..PidSettings::new(series(1.0, 10.0), 0.1) };
    let tables = self::tables(&settings);
    for (time, ratio) in [(4.0, 10.0), (0.2, 10.0), (1.0, 3.0), (0.0, 3.0)] {
        let mut old = on(settings, &tables);
        for setpoint in [1.0, 2.0, 3.0] {
            old.tick(setpoint, 0.0).unwrap();
        }
        let mut new = old.clone();
        new.set_gains(series(time, ratio)).unwrap();
        let (before, after) = (old.tick(4.0, 0.0).unwrap(), new.tick(4.0, 0.0).unwrap());
        assert!((after - before).abs() < 1e-12, "T_d {time}, N {ratio}: {before} {after}");
    }
    // Without an integral the output follows from the law.
    let gains = PidGains::Parallel { proportional: 2.0, integral: 0.0, derivative: 0.0 };
    let law = PidLaw::new(PidSettings::new(gains, 0.01)).unwrap();
    let mut proportional =
        FractionalPid::<f64, _, Memoryless<f64>>::without_derivative(law, Memoryless::new()).unwrap();
    proportional.manual(0.5).unwrap();
    assert_eq!(proportional.tick(1.0, 0.0), Ok(0.5));
    proportional.automatic();
    assert_eq!(proportional.tick(1.0, 0.0), Ok(2.0));
}

/// The actuator stands at 0.7, far from where the rate would lead from 0 in a tick.
#[test]
fn a_start_from_where_the_actuator_stands_has_no_bump() {
    for settings in laws().into_iter().filter(|law| law.derivative_of != DerivativeOf::MeasuredRate) {
        let settings = PidSettings { rate_limit: 0.1, limits: [-1.0, 1.0], ..settings };
        let tables = tables(&settings);
        for ticks in [0, 1, 3] {
            let mut pid = on(settings, &tables);
            // Another value first: before a tick nothing has moved.
            pid.manual(-0.6).unwrap();
            pid.manual(0.7).unwrap();
            for _ in 0..ticks {
                assert_eq!(pid.tick(0.0, 0.0), Ok(0.7));
            }
            pid.automatic();
            let first = pid.tick(0.0, 0.0).unwrap();
            // Without an integral the rate leads to what the law says.
            let leads = matches!(settings.gains, PidGains::Parallel { integral: 0.0, .. });
            let within = if leads { settings.rate_limit * settings.sample.unwrap() } else { 0.0 };
            assert!((first - 0.7).abs() < within + 1e-14, "{settings:?}, {ticks} ticks: {first}");
        }
        // Not behind a tick: from there the rate leads on, in any mode.
        let mut pid = on(settings, &tables);
        let before = pid.tick(0.0, 0.0).unwrap();
        pid.manual(0.7).unwrap();
        let step = settings.rate_limit * settings.sample.unwrap();
        assert!((pid.tick(0.0, 0.0).unwrap() - before - step).abs() < 1e-14);
        pid.automatic();
        pid.manual(0.7).unwrap();
        assert!((pid.tick(0.0, 0.0).unwrap() - before - 2.0 * step).abs() < 1e-14);
        // Beyond a limit it stands at the limit.
        let mut pid = on(settings, &tables);
        pid.manual(5.0).unwrap();
        assert_eq!(pid.tick(0.0, 0.0), Ok(1.0));
    }
}

#[test]
fn a_manual_tick_whose_derivative_overflows_is_refused() {
    let gains = PidGains::Parallel { proportional: 1.0, integral: 1.0, derivative: 1.0 };
    let derivative_filter = DerivativeFilter::FirstOrder { time: 0.01 };
    let settings = PidSettings { derivative_filter, ..PidSettings::new(gains, 0.01) };
    let tables = tables(&settings);
    let mut pid = on(settings, &tables);
    pid.manual(0.5).unwrap();
    for measured in [0.0, 1e306] {
        assert_eq!(pid.tick(0.0, measured), Ok(0.5));
    }
    // Derivatives of −10³⁰⁸ and then 1.7·10³⁰⁸ are finite, their difference in the filter is not.
    let before = bytes_of(&pid);
    assert_eq!(pid.tick(0.0, -0.7e306), Err(PidError::NotFinite { what: "the derivative" }));
    assert_eq!(bytes_of(&pid), before);
}

#[test]
fn a_million_calls_in_any_order_leave_a_sound_controller() {
    const H: usize = 32;
    let (integral, derivative): (Vec<f32>, Vec<f32>) = {
        let of = |exponent| ConvolutionWeights::bdf(ORDER, exponent, 1.0).unwrap();
        let narrow = |weights: Vec<f64>| weights.into_iter().map(|weight| weight as f32).collect();
        (narrow(of(-0.8).take(H).collect()), narrow(of(0.6).take(H).collect()))
    };
    let gains = PidGains::Parallel { proportional: 1.0, integral: 2.0, derivative: 0.1 };
    let settings = PidSettings {
        integral_order: 0.8,
        derivative_order: 0.6,
        limits: [-2.0, 3.0],
        rate_limit: 500.0,
        derivative_filter: DerivativeFilter::FirstOrder { time: 0.01 },
        ..PidSettings::new(gains, 1e-3)
    };
    let kinds = [AntiWindup::None, AntiWindup::Conditional, AntiWindup::BackCalculation { time: 0.05 }];
    let laws = kinds.map(|anti_windup| PidLaw::new(PidSettings { anti_windup, ..settings }).unwrap());
    let made = |law: PidLaw<f32>| {
        let integral = law.integral_kernel().unwrap().short_memory(&integral).unwrap();
        let derivative = law.derivative_kernel().unwrap().short_memory(&derivative).unwrap();
        RingPid::<f32, H>::new(law, integral, derivative).unwrap()
    };
    let state = |pid: &RingPid<'_, f32, H>| {
        let mut bytes = vec![0; pid.state_bytes()];
        pid.save(&mut StateWriter::new(&mut bytes)).unwrap();
        bytes
    };
    let mut pid = made(laws[1]);
    let mut random = noise(2_000_000).into_iter().map(|number| 2.0 * number);
    let mut refusals = 0;
    for call in 0..1_000_000u32 {
        let a = random.next().unwrap();
        let b = random.next().unwrap();
        let number = match call % 97 {
            13 => f32::NAN,
            14 => f32::INFINITY,
            15 => f32::MAX,
            16 => -f32::MAX,
            17 => f32::MIN_POSITIVE,
            _ => (10.0 * a) as f32,
        };
        // A refused call must leave this state.
        let before = if (13..18).contains(&(call % 97)) { state(&pid) } else { Vec::new() };
        let refused = match ((b + 1.0) * 16.0) as u32 {
            0 => pid.manual(number).is_err(),
            1 => {
                pid.automatic();
                false
            }
            2 => {
                let gains =
                    PidGains::Parallel { proportional: number, integral: 2.0 * number, derivative: 0.1 };
                pid.set_gains(gains).is_err()
            }
            3 => pid.set_law(laws[(call % 3) as usize]).is_err(),
            4 => pid.tick_applied(1.0, 0.5, number).is_err(),
            5 => {
                let actuator = Actuator::Limited;
                pid.tick_with(&PidInputs { actuator, ..PidInputs::new(number, 0.0) }).is_err()
            }
            6 => pid.tick_with(&PidInputs { feed_forward: number, ..PidInputs::new(1.0, 0.0) }).is_err(),
            7 => pid.tick_after(number, &PidInputs::new(1.0, 0.0)).is_err(),
            8 if call % 1000 == 0 => {
                pid.reset();
                false
            }
            9 => {
                let bytes = state(&pid);
                let mut other = made(*pid.law());
                other.restore(&mut StateReader::new(&bytes)).unwrap();
                let short = StateReader::new(&bytes[..bytes.len() - 1]);
                assert!(pid.check_state(&mut short.clone()).is_err());
                assert!(pid.restore(&mut short.clone()).is_err());
                assert_eq!(state(&pid), bytes);
                pid = other;
                false
            }
            _ => pid.tick(1.0, number).is_err(),
        };
        refusals += u32::from(refused);
        assert!(!refused || before.is_empty() || state(&pid) == before, "call {call}");
        let output = pid.output();
        assert!((-2.0..=3.0).contains(&output), "call {call}: {output}");
    }
    assert!(refusals > 1000, "{refusals}");
}

#[test]
fn ticks_at_any_times_are_those_of_equal_steps_where_they_are_equal() {
    // λ = μ = 1, of which a memory for steps of any length needs no table: a plain PID.
    let gains = PidGains::Parallel { proportional: 1.5, integral: 2.0, derivative: 0.2 };
    let equal = PidSettings {
        limits: [-1.0, 1.0],
        rate_limit: 30.0,
        anti_windup: AntiWindup::BackCalculation { time: 0.3 },
        derivative_filter: DerivativeFilter::FirstOrder { time: 0.05 },
        ..PidSettings::new(gains, 0.02)
    };
    let law = PidLaw::new(PidSettings { sample: None, ..equal }).unwrap();
    let derivative = || {
        let method = crate::RungeKutta::<1>::radau_iia().unwrap();
        let none = Vec::new;
        let table = crate::RateTable {
            exponent: 1.0,
            leading: vec![1.0],
            rates: none(),
            coefficients: none(),
            shortest: 1e-3,
            horizon: 1e3,
        };
        let state = vec![0.0; table.borrow::<f64>().state_len(1, 1)];
        crate::VariableStepMemory::<f64, 1, Vec<f64>, Vec<f64>>::new(&method, table, 1, state).unwrap()
    };
    let mut late = FractionalPid::<f64, _, _>::new(law, Memoryless::new(), derivative()).unwrap();
    assert_eq!(late.tick(1.0, 0.0), Err(PidError::Interval));
    for interval in [0.0, -1.0, f64::NAN, 1e-9] {
        assert!(late.tick_after(interval, &PidInputs::new(1.0, 0.0)).is_err(), "{interval}");
    }
    let mut reference = Reference::new(equal);
    let mut y = 0.0;
    for tick in 0..200 {
        let inputs = PidInputs::new(if tick % 60 < 30 { 1.0 } else { -0.5 }, y);
        let expected = reference.tick(&inputs);
        let output = late.tick_after(0.02, &inputs).unwrap();
        assert!((output - expected).abs() < 1e-9, "{tick}: {output} {expected}");
        y += 0.1 * (output - y);
    }
    // An integrator on its own: intervals as they come.
    let gains = PidGains::Parallel { proportional: 0.0, integral: 2.0, derivative: 0.0 };
    let law = PidLaw::new(PidSettings { sample: None, ..PidSettings::new(gains, 1.0) }).unwrap();
    let mut integral =
        FractionalPid::<f64, _, Memoryless<f64>>::without_derivative(law, Memoryless::new()).unwrap();
    let mut time = 0.0;
    for interval in [0.5, 0.25, 1.0, 0.125] {
        time += interval;
        assert_eq!(integral.tick_after(interval, &PidInputs::new(1.0, 0.0)), Ok(2.0 * time));
    }
}

#[test]
fn the_response_is_that_of_the_weights() {
    for (index, settings) in laws().into_iter().enumerate() {
        let settings =
            PidSettings { limits: [f64::NEG_INFINITY, f64::INFINITY], rate_limit: f64::INFINITY, ..settings };
        if settings.derivative_of == DerivativeOf::MeasuredRate {
            continue;
        }
        let law = PidLaw::new(settings).unwrap();
        // The frequency response as the Fourier sum of the responses to impulses in r and in y.
        let tables = tables(&settings);
        let (mut of_r, mut of_y) = (on(settings, &tables), on(settings, &tables));
        let omega = 40.0;
        let response = law.response(omega).unwrap();
        let (mut sums, mut radius) = ([[0.0; 2]; 2], 1.0);
        for k in 0..HISTORY {
            let (r, y) = if k == 0 { (1.0, 1.0) } else { (0.0, 0.0) };
            let outputs = [of_r.tick(r, 0.0).unwrap(), -of_y.tick(0.0, y).unwrap()];
            // Smooth cut-off: a constant tail of the response counts as its mean.
            let angle = omega * 0.01 * k as f64;
            radius = if k > HISTORY / 2 {
                0.5 * (1.0 + (core::f64::consts::PI * (2.0 * k as f64 / HISTORY as f64 - 1.0)).cos())
            } else {
                radius
            };
            for (sum, output) in sums.iter_mut().zip(outputs) {
                sum[0] += radius * output * angle.cos();
                sum[1] -= radius * output * angle.sin();
            }
        }
        for (found, expected) in sums.iter().zip([response.setpoint, response.measured]) {
            let gap = (found[0] - expected.re).hypot(found[1] - expected.im) / expected.re.hypot(expected.im);
            // Caputo's type subtracts the first sample, here the impulse: its response is not compared.
            let rest = settings.derivative_of == DerivativeOf::ValuesFromRest;
            assert!(gap < 2e-3 || rest, "law {index}: {found:?} and not {expected:?}");
        }
        assert!(law.response(0.0).is_none() && law.response(315.0).is_none());
    }
}

#[test]
fn settings_that_contradict_themselves_are_refused() {
    let [fine, ..] = laws()[..] else { panic!() };
    let refused = |settings: PidSettings<f64>| PidLaw::new(settings).map(|_| ()).unwrap_err().parameter;
    let gains = |p, i, d| PidGains::Parallel { proportional: p, integral: i, derivative: d };
    let series = |p, i, t, n| PidGains::Series {
        proportional: p,
        integral_rate: i,
        derivative_time: t,
        filter_ratio: n,
    };
    let cases = [
        (PidSettings { gains: gains(f64::NAN, 1.0, 0.0), ..fine }, "proportional gain"),
        (PidSettings { gains: gains(1.0, f64::INFINITY, 0.0), ..fine }, "integral gain"),
        (PidSettings { gains: gains(1.0, 1.0, f64::NAN), ..fine }, "derivative gain"),
        (PidSettings { gains: series(1.0, 1.0, -1.0, 10.0), ..fine }, "derivative time"),
        (PidSettings { gains: series(1.0, 1.0, 1.0, 0.0), ..fine }, "filter ratio"),
        (PidSettings { gains: series(1.0, f64::NAN, 1.0, 1.0), ..fine }, "integral rate"),
        (PidSettings { integral_order: 0.0, ..fine }, "integral order"),
        (PidSettings { integral_order: 2.0, ..fine }, "integral order"),
        (PidSettings { derivative_order: f64::NAN, ..fine }, "derivative order"),
        (PidSettings { sample: Some(0.0), ..fine }, "step size"),
        (PidSettings { setpoint_weights: [f64::NAN, 0.0], ..fine }, "setpoint weight"),
        (PidSettings { limits: [1.0, -1.0], ..fine }, "lower limit"),
        (PidSettings { limits: [f64::INFINITY; 2], ..fine }, "limits"),
        (PidSettings { limits: [f64::NAN, 1.0], ..fine }, "lower limit"),
        (PidSettings { rate_limit: 0.0, ..fine }, "rate limit"),
        (PidSettings { rate_limit: f64::NAN, ..fine }, "rate limit"),
        (PidSettings { anti_windup: AntiWindup::BackCalculation { time: 0.0 }, ..fine }, "tracking time"),
        (
            PidSettings { derivative_filter: DerivativeFilter::FirstOrder { time: -1.0 }, ..fine },
            "time of the derivative's filter",
        ),
        (
            PidSettings { derivative_filter: DerivativeFilter::Fractional { time: 1.0, order: 2.0 }, ..fine },
            "order of the derivative's filter",
        ),
        (
            PidSettings { derivative_of: DerivativeOf::MeasuredRate, setpoint_weights: [1.0, 0.5], ..fine },
            "setpoint weight of the derivative",
        ),
        (
            PidSettings {
                gains: series(1.0, 1.0, 1.0, 10.0),
                derivative_filter: DerivativeFilter::FirstOrder { time: 1.0 },
                ..fine
            },
            "time of the derivative's filter",
        ),
        (
            PidSettings {
                gains: series(1.0, 1.0, 1.0, 10.0),
                derivative_of: DerivativeOf::MeasuredRate,
                ..fine
            },
            "derivative",
        ),
    ];
    for (settings, parameter) in cases {
        assert_eq!(refused(settings), parameter);
    }
    // Memories of other kernels, and laws that a loop cannot take over.
    let law = PidLaw::new(fine).unwrap();
    let tables = tables(&fine);
    let memory = |exponent: f64| {
        crate::kernel::Kernel::bdf(ORDER, exponent, 0.01)
            .unwrap()
            .full_memory::<f64, 1, HISTORY>(if exponent == 0.6 { &tables[1] } else { &tables[0] })
    };
    let (right, other) = (memory(-0.7).unwrap(), memory(0.6).unwrap());
    assert!(FractionalPid::<f64, _, _>::new(law, other.clone(), other.clone()).is_err());
    assert!(FractionalPid::<f64, _, _>::new(law, right.clone(), right.clone()).is_err());
    assert!(FractionalPid::<f64, _, Memoryless<f64>>::without_derivative(law, right.clone()).is_err());
    let mut pid = FractionalPid::<f64, _, _>::new(law, right, other).unwrap();
    for wrong in [
        PidSettings { integral_order: 0.8, ..fine },
        PidSettings { sample: Some(0.02), ..fine },
        PidSettings { gains: series(1.0, 1.0, 1.0, 10.0), ..fine },
    ] {
        assert_eq!(pid.set_law(PidLaw::new(wrong).unwrap()).unwrap_err().parameter, "law");
    }
    assert!(pid.set_gains(series(1.0, 1.0, 1.0, 10.0)).is_err());
    // One law for many loops.
    let shared = PidLaw::new(PidSettings::new(gains(1.0, 1.0, 0.0), 0.01)).unwrap();
    let looped = || {
        FractionalPid::<f64, _, Memoryless<f64>, &PidLaw<f64>>::without_derivative(&shared, Memoryless::new())
    };
    let mut loops = [looped().unwrap(), looped().unwrap()];
    assert_eq!((loops[0].tick(1.0, 0.0), loops[1].tick(2.0, 0.0)), (Ok(1.01), Ok(2.02)));
}

#[test]
fn a_slow_filter_comes_to_its_value_in_single_precision() {
    // T = 10⁵ h: without what rounding took, the filter stands still 3·10⁻³ before the value, where its
    // change is less than half a unit in the last place.
    let settings = PidSettings {
        derivative_of: DerivativeOf::MeasuredRate,
        derivative_filter: DerivativeFilter::FirstOrder { time: 1.0 },
        ..PidSettings::new(PidGains::Parallel { proportional: 0.0f32, integral: 0.0, derivative: 1.0 }, 1e-5)
    };
    let law = PidLaw::new(settings).unwrap();
    let mut pid = FractionalPid::<f32, _, _>::new(law, Memoryless::new(), Memoryless::new()).unwrap();
    let inputs = PidInputs { rate: 1.0, ..PidInputs::new(0.0, 0.0) };
    for _ in 0..2_000_000 {
        pid.tick_with(&inputs).unwrap();
    }
    // 1 − e^{−20}
    assert!((pid.output() + 1.0).abs() < 2e-7, "{}", pid.output());
}

#[test]
fn settings_that_leave_single_precision_are_refused_by_their_name() {
    let plain =
        PidSettings::new(PidGains::Parallel { proportional: 1.0f32, integral: 0.0, derivative: 0.0 }, 1e-3);
    let series = |derivative_time, filter_ratio| PidGains::Series {
        proportional: 1.0f32,
        integral_rate: 0.0,
        derivative_time,
        filter_ratio,
    };
    let refused = |settings| PidLaw::<f32>::new(settings).unwrap_err().parameter;
    assert_eq!(refused(PidSettings { sample: Some(1e-40), ..plain }), "step size");
    assert_eq!(refused(PidSettings { sample: Some(1e39), ..plain }), "step size");
    assert_eq!(refused(PidSettings { rate_limit: 1e-44, ..plain }), "rate limit");
    assert_eq!(refused(PidSettings { gains: series(1e30, 1e-30), ..plain }), "derivative time");
    assert!(PidLaw::new(PidSettings { gains: series(1e30, 1e-3), ..plain }).is_ok());
    assert!(PidLaw::new(PidSettings { rate_limit: 1e-30, ..plain }).is_ok());
}
