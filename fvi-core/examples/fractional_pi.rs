//! A fractional PI^λ controller on a stream of measurements, u = K_P e + K_I D^{−λ} e with λ = 0.8, at a
//! kilohertz.
//!
//! The plant is a first-order lag, T ẏ = u − y.

use fvi_core::{BdfOrder, FixedDirect, FractionalOperator, Kernel, Start, monic_bdf_table_f32};

const SAMPLE_TIME: f32 = 1e-3;
const LAMBDA: f64 = 0.8;
const HISTORY: usize = 2048;
static WEIGHTS: [f32; HISTORY] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, -LAMBDA);

/// u = K_P e + K_I D^{−λ} e
struct Controller {
    proportional: f32,
    integral: f32,
    operator: FractionalOperator<f32, FixedDirect<'static, f32, 1, HISTORY>>,
}

impl Controller {
    fn answer(&mut self, error: f32) -> Result<f32, fvi_core::OperatorError> {
        Ok(self.proportional * error + self.integral * self.operator.push(error)?)
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, -LAMBDA, SAMPLE_TIME.into())?;
    let operator = FractionalOperator::new(kernel.full_memory(&WEIGHTS)?, Start::RiemannLiouville)?;
    let mut controller = Controller { proportional: 2.0, integral: 12.0, operator };
    let (setpoint, lag) = (1.0, 0.3);
    let mut output = 0.0;
    println!("   ms  output");
    for sample in 0..1500 {
        let control = controller.answer(setpoint - output)?;
        output += SAMPLE_TIME / lag * (control - output);
        if sample % 150 == 149 {
            println!("{:5}  {output:.4}", sample + 1);
        }
    }
    Ok(())
}
