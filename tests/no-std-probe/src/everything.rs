//! Every engine, scheme and check.

mod engines;
mod schemes;

use engines::Unknown;
use fvi_core::{BdfOrder, ConvolutionWeights};

/// Samples that the rings hold.
const HISTORY: usize = 64;

/// Numbers of a table: whole planes for any number of stages.
const TABLE: usize = 144;

/// Runs everything on numbers that the compiler does not know.
#[unsafe(no_mangle)]
pub extern "C" fn probe(numbers: &[f64; 8], order: usize, stages: usize, channels: usize) -> f64 {
    let [mass, rho, beta, h, kappa, ..] = *numbers;
    let all = || -> Option<f64> {
        let bdf_order = BdfOrder::new(order).ok()?;
        let mut table = [0.0; TABLE];
        let mut single = [0f32; TABLE];
        ConvolutionWeights::bdf(bdf_order, beta, h).ok()?.fill(&mut table);
        ConvolutionWeights::bdf(bdf_order, beta, h).ok()?.fill(&mut single);
        let (samples, single_samples) = ([mass, rho, beta, h], [mass as f32; 4]);
        let double = Unknown { table: &table, samples: &samples, scale: kappa, stages, channels };
        let float =
            Unknown { table: &single, samples: &single_samples, scale: kappa as f32, stages, channels };
        Some(
            engines::weights(bdf_order, beta, h)?
                + engines::rules(stages)?
                + engines::engines(&double)?
                + f64::from(engines::engines(&float)?)
                + schemes::of_one_node(&table, numbers)?
                + f64::from(schemes::of_one_node(&single, numbers)?)
                + schemes::of_higher_degree(&table, numbers)?
                + schemes::stability(numbers, bdf_order)?,
        )
    };
    all().unwrap_or(-1.0)
}
