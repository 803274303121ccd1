//! Structures around fractional controllers: a cascade, feed-forward, scheduled gains, direct and reverse
//! action, and a start in a plant that runs.
//!
//! Every loop ticks every 10 ms and keeps all of its samples; a microcontroller would keep exponential sums,
//! whose tables `fvi controller` prints.

use fvi_core::{
    Actuator, AntiWindup, BdfOrder, Bumpless, ParameterError, PidError, PidGains, PidInputs, PidLaw,
    PidSettings, RingPid, monic_bdf_table_f32,
};

const SAMPLE: f64 = 0.01;
const LAMBDA: f64 = 0.8;
const MU: f64 = 0.6;
const HISTORY: usize = 4096;

static INTEGRAL: [f32; HISTORY] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, -LAMBDA);
static DERIVATIVE: [f32; HISTORY] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, MU);

type Pid = RingPid<'static, f32, HISTORY>;

type Outcome = Result<(), Box<dyn std::error::Error>>;

/// K_p, K_i, K_d, within limits.
fn pid([proportional, integral, derivative]: [f32; 3], limits: [f32; 2]) -> Result<Pid, ParameterError> {
    let gains = PidGains::Parallel { proportional, integral, derivative };
    let law = PidLaw::new(PidSettings {
        integral_order: LAMBDA,
        derivative_order: MU,
        limits,
        anti_windup: AntiWindup::Conditional,
        ..PidSettings::new(gains, SAMPLE)
    })?;
    let integral = law.integral_kernel()?.full_memory(&INTEGRAL)?;
    let derivative = law.derivative_kernel()?.full_memory(&DERIVATIVE)?;
    Pid::new(law, integral, derivative)
}

/// T ẏ + y = K u, turned exactly over a sample.
struct Lag {
    gain: f32,
    time: f32,
    y: f32,
}

impl Lag {
    fn go(&mut self, u: f32) {
        self.y += (1.0 - (-SAMPLE as f32 / self.time).exp()) * (self.gain * u - self.y);
    }
}

/// A position loop whose output is the setpoint of a speed loop. Where the inner loop is at its limits the
/// outer one is told so, and its integral cannot wind up.
fn cascade() -> Outcome {
    let mut position = pid([4.0, 0.5, 0.0], [-2.0, 2.0])?;
    let mut speed = pid([1.5, 6.0, 0.0], [-1.0, 1.0])?;
    let mut motor = Lag { gain: 3.0, time: 0.2, y: 0.0 };
    let (mut angle, mut largest) = (0.0, 0.0f32);
    let mut actuator = Actuator::Followed;
    for _ in 0..1000 {
        let wanted = position.tick_with(&PidInputs { actuator, ..PidInputs::new(5.0, angle) })?;
        let voltage = speed.tick(wanted, motor.y)?;
        actuator = if voltage.abs() < 1.0 { Actuator::Followed } else { Actuator::Limited };
        motor.go(voltage);
        angle += SAMPLE as f32 * motor.y;
        largest = largest.max(angle);
    }
    println!("cascade: angle {angle:.3} of 5, at most {largest:.3}");
    assert!((angle - 5.0).abs() < 0.02 && largest < 5.3);
    Ok(())
}

/// The output that the plant needs at the setpoint is added inside the limits; the controller only corrects.
fn feed_forward() -> Outcome {
    let run = |share: f32| -> Result<f32, Box<dyn std::error::Error>> {
        let mut pid = pid([1.0, 1.0, 0.0], [-10.0, 10.0])?;
        let mut plant = Lag { gain: 2.0, time: 1.0, y: 0.0 };
        let mut sum = 0.0;
        for tick in 0..400 {
            // A ramp needs y/K and T ẏ/K.
            let (ramp, slope) = (0.5 * tick as f32 * SAMPLE as f32, 0.5);
            let feed_forward = share * (ramp + plant.time * slope) / plant.gain;
            let output = pid.tick_with(&PidInputs { feed_forward, ..PidInputs::new(ramp, plant.y) })?;
            plant.go(output);
            sum += (ramp - plant.y).abs() * SAMPLE as f32;
        }
        Ok(sum)
    };
    let (without, with) = (run(0.0)?, run(1.0)?);
    println!("feed-forward: the integral of |e| along a ramp is {with:.4} instead of {without:.4}");
    assert!(with < 0.1 * without);
    Ok(())
}

/// The gain of the plant grows with y, those of the controller fall with it at every tick. The integral is in
/// units of the output, so that a change of its gain is none of the output; `Bumpless::Whole`, for gains that
/// jump now and then, would let it absorb the proportional term too, tick by tick, and the loop overshoot.
fn scheduled_gains() -> Outcome {
    let gains_at = |y: f32| {
        let factor = 1.0 / (1.0 + y.max(0.0));
        PidGains::Parallel { proportional: 1.5 * factor, integral: 2.0 * factor, derivative: 0.1 * factor }
    };
    let mut pid = pid([1.5, 2.0, 0.1], [-20.0, 20.0])?;
    pid.set_law(PidLaw::new(PidSettings { bumpless: Bumpless::Nothing, ..*pid.law().settings() })?)?;
    let mut plant = Lag { gain: 1.0, time: 0.5, y: 0.0 };
    for setpoint in [1.0, 4.0, 8.0] {
        let mut largest = 0.0f32;
        for _ in 0..500 {
            pid.set_gains(gains_at(plant.y))?;
            let output = pid.tick(setpoint, plant.y)?;
            plant.gain = 1.0 + plant.y.max(0.0);
            plant.go(output);
            largest = largest.max(plant.y);
        }
        println!("scheduled gains: {:.3} of {setpoint}, at most {largest:.3}", plant.y);
        assert!((plant.y - setpoint).abs() < 0.05 * setpoint && largest < 1.1 * setpoint);
    }
    Ok(())
}

/// More heat makes it warmer, more coolant colder: positive gains act in the reverse direction of the
/// measured value (the output falls as it rises), negative ones in the same direction.
fn direction() -> Outcome {
    for (name, sign, gain) in [("reverse: a heater", 1.0, 5.0), ("direct: a cooler", -1.0, -5.0)] {
        let mut pid = pid([0.8 * sign, 1.5 * sign, 0.0], [0.0, 1.0])?;
        let mut room = Lag { gain, time: 1.0, y: 0.0 };
        let setpoint = 2.0 * sign;
        for _ in 0..1500 {
            let output = pid.tick(setpoint, room.y)?;
            room.go(output);
        }
        println!("{name} holds {:.3} of {setpoint} with {:.3}", room.y, pid.output());
        assert!((room.y - setpoint).abs() < 0.02);
    }
    Ok(())
}

/// The plant runs by hand; the controller takes over at its output, and goes on from there.
fn bumpless_start() -> Outcome {
    let mut pid = pid([2.0, 3.0, 0.2], [-5.0, 5.0])?;
    let mut plant = Lag { gain: 2.0, time: 0.5, y: 3.0 };
    // The valve stands at 1.5, as somebody has set it.
    pid.manual(1.5)?;
    let go = |pid: &mut Pid, plant: &mut Lag, setpoint: f32| -> Result<f32, PidError> {
        let output = pid.tick(setpoint, plant.y)?;
        plant.go(output);
        Ok(output)
    };
    for _ in 0..50 {
        go(&mut pid, &mut plant, 3.0)?;
    }
    pid.automatic();
    let first = go(&mut pid, &mut plant, 3.0)?;
    for _ in 0..800 {
        go(&mut pid, &mut plant, 4.0)?;
    }
    println!("bumpless start: the first output is {first:.3}, then y goes to {:.3} of 4", plant.y);
    assert!((first - 1.5).abs() < 1e-6 && (plant.y - 4.0).abs() < 0.05);
    Ok(())
}

fn main() -> Outcome {
    cascade()?;
    feed_forward()?;
    scheduled_gains()?;
    direction()?;
    bumpless_start()
}
