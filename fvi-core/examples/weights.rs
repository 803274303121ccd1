//! Weights of convolution quadrature, and the order they show: D^{1/2} t² = Γ(3)/Γ(5/2) t^{3/2} at t = 1.

use fvi_core::{BdfOrder, ConvolutionWeights};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let exact = 2.0 / libm::tgamma(2.5);
    for order in 1..=3 {
        print!("BDF {order}:");
        let mut before = f64::NAN;
        for steps in [16, 32, 64, 128] {
            let h = 1.0 / f64::from(steps);
            let weights = ConvolutionWeights::bdf(BdfOrder::new(order)?, 0.5, h)?;
            let sample = |n: i32| (f64::from(steps - n) * h).powi(2);
            let sum: f64 = weights.zip(0..=steps).map(|(w, n)| w * sample(n)).sum();
            let error = (sum - exact).abs();
            print!("  {error:.2e}");
            if before.is_finite() {
                print!(" (order {:.2})", (before / error).log2());
            }
            before = error;
        }
        println!();
    }
    Ok(())
}
