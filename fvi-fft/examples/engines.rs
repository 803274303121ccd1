//! The same sum by three engines: the plain one, block transforms, and transforms that are never late.

use fvi_core::{BdfOrder, ConvolutionWeights, Memory, MemoryError};
use fvi_fft::sums::max_or_nan;
use fvi_fft::{BlockFft, Pacing, RealTime};

const STEPS: usize = 4096;

/// The terms Σ_{n≥1} w_n x_{k−n} of a sine.
fn terms(memory: &mut dyn Memory<f64>) -> Result<Vec<f64>, MemoryError> {
    (0..STEPS)
        .map(|k| {
            let mut term = [0.0];
            memory.next_term(&mut term)?;
            memory.push(&[(0.01 * k as f64).sin()])?;
            Ok(term[0])
        })
        .collect()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let weights = || ConvolutionWeights::bdf(BdfOrder::new(2)?, 0.5, 0.01);
    let numbers: Vec<f64> = weights()?.take(STEPS).collect();
    let x = |k: usize| (0.01 * k as f64).sin();
    let plain: Vec<f64> = (0..STEPS).map(|k| (1..=k).rev().map(|n| numbers[n] * x(k - n)).sum()).collect();
    let size: f64 = numbers.iter().map(|w| w.abs()).sum();
    let mut block = BlockFft::<f64>::planned(weights()?, 1, STEPS)?;
    let mut bounded = RealTime::<f64>::planned(weights()?, 1, STEPS, Pacing::Paced)?;
    let memories: [(&str, &mut dyn Memory<f64>); 2] =
        [("block-fft", &mut block), ("real-time", &mut bounded)];
    for (name, memory) in memories {
        let found = terms(memory)?;
        let error = found.iter().zip(&plain).map(|(a, b)| (a - b).abs()).fold(0.0, max_or_nan);
        println!(
            "{name}: within {:.1} units of rounding of the plain sum",
            error / (size * f64::EPSILON / 2.0)
        );
    }
    Ok(())
}
