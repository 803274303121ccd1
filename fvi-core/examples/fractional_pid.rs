//! A fractional PI^λD^μ controller at a kilohertz: limits, windup, and a change by hand.
//!
//! The plant is a motor with a load, T ÿ + ẏ = u, whose drive gives at most 2.

use fvi_core::{
    AntiWindup, BdfOrder, DerivativeFilter, PidGains, PidLaw, PidSettings, RingPid, monic_bdf_table_f32,
};

const SAMPLE: f64 = 1e-3;
const LAMBDA: f64 = 0.9;
const MU: f64 = 0.8;
const HISTORY: usize = 1024;

// Tables in flash, for every sample time: I^λ and D^μ.
static INTEGRAL: [f32; HISTORY] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, -LAMBDA);
static DERIVATIVE: [f32; HISTORY] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, MU);

/// What a program would keep for an axis.
struct Axis {
    pid: RingPid<'static, f32, HISTORY>,
    position: f32,
    speed: f32,
}

impl Axis {
    fn new() -> Result<Self, fvi_core::ParameterError> {
        let gains = PidGains::Parallel { proportional: 8.0, integral: 4.0, derivative: 2.0 };
        let law = PidLaw::new(PidSettings {
            integral_order: LAMBDA,
            derivative_order: MU,
            derivative_filter: DerivativeFilter::FirstOrder { time: 0.01 },
            limits: [-2.0, 2.0],
            anti_windup: AntiWindup::BackCalculation { time: 0.2 },
            ..PidSettings::new(gains, SAMPLE)
        })?;
        let integral = law.integral_kernel()?.short_memory(&INTEGRAL)?;
        let derivative = law.derivative_kernel()?.short_memory(&DERIVATIVE)?;
        Ok(Self { pid: RingPid::new(law, integral, derivative)?, position: 0.0, speed: 0.0 })
    }

    fn tick(&mut self, setpoint: f32) -> Result<f32, fvi_core::PidError> {
        let output = self.pid.tick(setpoint, self.position)?;
        let (step, lag) = (SAMPLE as f32, 0.1);
        self.speed += step / lag * (output - self.speed);
        self.position += step * self.speed;
        Ok(output)
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut axis = Axis::new()?;
    println!("   ms  output  position");
    for tick in 0..6000 {
        match tick {
            // Standing still, by hand, and back without a bump.
            3000 => axis.pid.manual(0.0)?,
            4000 => axis.pid.automatic(),
            _ => {}
        }
        let output = axis.tick(if tick < 4000 { 3.0 } else { 1.0 })?;
        if tick % 400 == 399 {
            println!("{:5}  {output:6.3}  {:.4}", tick + 1, axis.position);
        }
    }
    Ok(())
}
