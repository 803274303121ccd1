//! Weights as a controller makes them, and an index that may be out of bounds: its panic must show.

use fvi_core::{BdfOrder, ConvolutionWeights};

#[unsafe(no_mangle)]
pub extern "C" fn seeded(order: usize, beta: f64, index: usize) -> f64 {
    let mut table = [0.0; 64];
    let weights = BdfOrder::new(order).and_then(|order| ConvolutionWeights::bdf(order, beta, 1.0));
    if let Ok(mut weights) = weights {
        weights.fill(&mut table);
    }
    table[index]
}
