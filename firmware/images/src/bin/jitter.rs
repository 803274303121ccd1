//! The control loop with ticks up to a fifth of the interval early or late.
#![no_std]
#![no_main]

use core::fmt::Write;

use images::{Counter, Refused, image};
use scenarios::jitter::{Jitter, PRINTED, TICKS};

image!(|out| {
    let mut counter = Counter::new().ok_or(Refused)?;
    let mut jitter = Jitter::new().map_err(|refusal| Refused::because(out, refusal))?;
    let (mut total, mut worst) = (0_u64, 0);
    while jitter.ticks() < TICKS {
        let mut tick = None;
        let taken = counter.count(|| tick = Some(jitter.tick()));
        total += u64::from(taken);
        worst = worst.max(taken);
        let Some(tick) = tick else { return Err(Refused) };
        let tick = tick.map_err(|refusal| Refused::because(out, refusal))?;
        if jitter.ticks().is_multiple_of(PRINTED) {
            writeln!(out, "{} {tick}", jitter.ticks()).map_err(|_| Refused)?;
        }
    }
    writeln!(out, "hash {:08x}", jitter.hash()).map_err(|_| Refused)?;
    let mean = total / u64::from(TICKS);
    writeln!(out, "# instructions per tick, each of a new length: mean {mean}, worst {worst}")
        .map_err(|_| Refused)
});
