//! A thousand million samples of a stream through a response of one second, in single and in double
//! precision, against the plain sum at random places:
//!
//! ```text
//! cargo run --release -p fvi-fft --example endless_stream -- 1e9
//! ```
//!
//! The argument is the number of samples.

use std::error::Error;

use fvi_fft::sums::max_or_nan;
use fvi_fft::{Convolver, Engines, Responses, Stream};

const RESPONSE: usize = 48_000;
const BLOCK: usize = 1024;
/// One block in so many is compared, at one place.
const COMPARED: u64 = 97;

/// The k-th of a sequence of numbers in (−1, 1) without pattern, so that any part of the stream is known.
fn noise(k: u64) -> f64 {
    let mut bits = k.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((bits ^ (bits >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

fn run<T: Engines>(name: &str, samples: u64) -> Result<(), Box<dyn Error>> {
    let decay = |n: usize| (-6.0 * n as f64 / RESPONSE as f64).exp();
    let response: Vec<T> = (0..RESPONSE).map(|n| T::of(decay(n) * noise(!(n as u64)))).collect();
    let size: f64 = response.iter().map(|w| w.to_f64().abs()).sum();
    let stream = Stream { block: Some(BLOCK), ..Stream::default() };
    let mut convolver = Convolver::new(&Responses::one(&response)?, &stream)?;
    let (mut input, mut output) = (vec![T::zero(); BLOCK], vec![T::zero(); BLOCK]);
    let (mut largest, mut places) = (0.0, 0u64);
    for block in 0..samples / BLOCK as u64 {
        let first = block * BLOCK as u64;
        for (k, x) in (first..).zip(&mut input) {
            *x = T::of(noise(k));
        }
        convolver.process_one(&input, &mut output)?;
        // The bits of a number without pattern say where.
        if block % COMPARED == 0 {
            let place = (noise(!first).to_bits() >> 20) % BLOCK as u64;
            let lags = response.iter().zip((0..=first + place).rev());
            let sum: f64 = lags.map(|(w, j)| w.to_f64() * T::of(noise(j)).to_f64()).sum();
            largest = max_or_nan(largest, (output[place as usize].to_f64() - sum).abs());
            places += 1;
        }
    }
    let units = largest / (size * T::EPSILON.to_f64() / 2.0);
    println!(
        "{name}: {} samples, {places} places, within {units:.2} units of rounding of Σ|w| max|x|",
        convolver.taken()
    );
    if units.is_nan() || units >= 8.0 || convolver.overruns() > 0 {
        return Err(format!("{units} units of rounding, {} blocks late", convolver.overruns()).into());
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let samples: f64 = std::env::args().nth(1).map_or(Ok(1e6), |argument| argument.parse())?;
    run::<f32>("f32", samples as u64)?;
    run::<f64>("f64", samples as u64)
}
