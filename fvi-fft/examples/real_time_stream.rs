//! A response of ten seconds on a stream against the clock: blocks of 64 samples at 48 kHz, each of which
//! must be done before the next one comes. Other responses are prepared on a second thread and exchanged.
//!
//! ```text
//! cargo run --release -p fvi-fft --example real_time_stream -- 5
//! ```
//!
//! The argument is the time to run in seconds.

use std::error::Error;
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::{Duration, Instant};

use fvi_fft::{Convolver, Responses, Stream};

const RATE: f64 = 48_000.0;
const BLOCK: usize = 64;
/// Samples over which the responses are faded.
const FADE: usize = 4800;

/// Ten seconds of noise that decays, different for each seed.
fn room(seed: u32) -> Vec<f32> {
    let mut state = seed;
    let mut noise = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state as f32 / u32::MAX as f32 - 0.5
    };
    (0..480_000).map(|n| noise() * (-7.0 * n as f32 / 480_000.0).exp()).collect()
}

fn main() -> Result<(), Box<dyn Error>> {
    let seconds: f64 = std::env::args().nth(1).map_or(Ok(1.0), |argument| argument.parse())?;
    let stream = Stream { block: Some(BLOCK), ..Stream::default() };
    let mut convolver = Convolver::new(&Responses::one(&room(1))?, &stream)?;

    // The stream does not wait: what is not ready comes at a later block. Old responses are freed over there.
    let preparer = convolver.preparer();
    let (to_stream, ready) = sync_channel(1);
    let (to_preparer, retired) = sync_channel(2);
    let other = thread::spawn(move || {
        for seed in 2.. {
            let Ok(responses) = Responses::one(&room(seed)) else { break };
            let Ok(prepared) = preparer.prepare(&responses) else { break };
            if to_stream.send(prepared).is_err() {
                break;
            }
            while let Ok(old) = retired.try_recv() {
                drop(old);
            }
        }
    });

    let blocks = (seconds * RATE / BLOCK as f64) as usize;
    let mut times = Vec::with_capacity(blocks);
    let (mut output, mut exchanges) = ([0.0; BLOCK], 0);
    let begin = Instant::now();
    for block in 0..blocks {
        let due = Duration::from_secs_f64(block as f64 * BLOCK as f64 / RATE);
        thread::sleep(due.saturating_sub(begin.elapsed()));
        let input: [f32; BLOCK] = core::array::from_fn(|k| (0.02 * (block * BLOCK + k) as f32).sin());
        let before = Instant::now();
        if convolver.exchange_left() == 0
            && let Ok(responses) = ready.try_recv()
        {
            // Nothing is under way, and the shapes are those of the preparer.
            if let Ok(exchanged) = convolver.exchange_evenly(responses, FADE) {
                exchanges += 1;
                if let Some(old) = exchanged.retired {
                    to_preparer.try_send(old).ok();
                }
            }
        }
        convolver.process_one(&input, &mut output)?;
        times.push(before.elapsed());
    }
    drop(ready);
    other.join().map_err(|_| "the other thread has failed")?;

    let period = Duration::from_secs_f64(BLOCK as f64 / RATE);
    let late = times.iter().filter(|&&time| time > period).count();
    let mean = times.iter().sum::<Duration>() / u32::try_from(times.len().max(1))?;
    times.sort();
    println!("{blocks} blocks of {period:?}, {exchanges} exchanges");
    println!("mean {mean:?}, longest {:?}, {late} later than the next block", times.last());
    Ok(())
}
