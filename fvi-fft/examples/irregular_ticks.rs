//! A fractional PID controller whose ticks come early or late: a task that is preempted, samples over a bus.
//!
//! The memories are for steps of any length from 1 ms on. Their tables reach to 10¹² s, 30 000 years, which
//! costs a few dozen rates more than a minute does. On a microcontroller they are constants of `fvi rates
//! --stages 1 --exponent … --shortest 0.001 --horizon 1e12 --tolerance 1e-7 --format rust --precision f32`.

use fvi_core::{
    AntiWindup, FractionalPid, PidGains, PidInputs, PidLaw, PidSettings, RungeKutta, VariableStepMemory,
};
use fvi_fft::Aligned;
use fvi_fft::exponentials::rate_table::rate_table;

type Rates = VariableStepMemory<f32, 1, Aligned<f32>, Vec<f32>>;

const LAMBDA: f64 = 0.8;
const MU: f64 = 0.6;

fn memory(exponent: f64) -> Result<Rates, Box<dyn std::error::Error>> {
    let method = RungeKutta::<1>::radau_iia()?;
    let table = rate_table::<f32, 1>(&method, exponent, 1e-3, 1e12, 1e-7)?;
    let state = vec![0.0; table.borrow::<f32>().state_len(1, 1)];
    Ok(Rates::new(&method, table, 1, state)?)
}

/// Setpoint 1 from t = 0.5 on, a plant T ẏ + y = u that is turned exactly; y at the end of every second.
fn run(intervals: impl Fn(usize) -> f32) -> Result<Vec<f32>, Box<dyn std::error::Error>> {
    let gains = PidGains::Parallel { proportional: 3.0, integral: 4.0, derivative: 0.2 };
    let law = PidLaw::new(PidSettings {
        integral_order: LAMBDA,
        derivative_order: MU,
        limits: [-2.0, 2.0],
        anti_windup: AntiWindup::BackCalculation { time: 0.2 },
        // Of each tick's own.
        sample: None,
        ..PidSettings::new(gains, 1.0)
    })?;
    let mut pid = FractionalPid::<f32, _, _>::new(law, memory(-LAMBDA)?, memory(MU)?)?;
    let (mut time, mut y, mut seconds) = (0.0f32, 0.0f32, Vec::new());
    for tick in 0.. {
        let interval = intervals(tick);
        time += interval;
        if time > (seconds.len() + 1) as f32 {
            seconds.push(y);
        }
        if seconds.len() == 4 {
            break;
        }
        let setpoint = if time < 0.5 { 0.0 } else { 1.0 };
        let output = pid.tick_after(interval, &PidInputs::new(setpoint, y))?;
        y += (1.0 - (-interval / 0.4).exp()) * (output - y);
    }
    Ok(seconds)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let even = run(|_| 0.005)?;
    // Between 2 and 8 ms, in an order without a pattern.
    let uneven = run(|tick| 0.002 + 0.006 * ((tick * 7919 % 101) as f32 / 100.0))?;
    println!("y after 1, 2, 3, 4 s, ticks every 5 ms: {even:.3?}");
    println!("between 2 and 8 ms after one another:   {uneven:.3?}");
    for (a, b) in even.iter().zip(&uneven) {
        assert!((a - b).abs() < 0.01, "{a} and {b}");
    }
    Ok(())
}
