//! Prints what memories and steppers cost, in instructions.
#![no_std]
#![no_main]

use core::fmt::Write;
use core::hint::black_box;

use cortex_m_rt::entry;
use fvi_core::{BdfOrder, FixedDirect, Memory, Overflow, Tiled, monic_bdf_table_f32};
use images::instructions::{Counter, Spread};
use images::{Refused, main};

static WEIGHTS: [f32; 1025] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, 0.5);

/// Cost of a term over `H` samples that lie in two slices.
fn direct<const H: usize>(out: &mut impl Write, counter: &mut Counter) -> Result<(), Refused> {
    let mut memory =
        FixedDirect::<f32, 1, H>::short_memory(&WEIGHTS[..=H], 1.0).map_err(|_| Refused)?;
    for k in 0..H + H / 2 {
        let _ = memory.push(&[k as f32]);
    }
    let mut term = Spread::default();
    let mut step = Spread::default();
    for k in 0..16 {
        let mut sum = [0.0];
        term.add(counter.count(|| {
            let _ = black_box(&mut memory).next_term(&mut sum);
            black_box(&sum);
        }));
        step.add(term.worst() + counter.count(|| {
            let _ = black_box(&mut memory).push(&black_box([k as f32]));
        }));
    }
    let _ = writeln!(out, "direct {H}: term {} worst {} per product {} step {}", term.mean(), term.worst(), term.mean() / H as f32, step.mean());
    Ok(())
}

/// Cost of a step with a tiled memory full of `B` blocks.
fn tiled<const B: usize>(out: &mut impl Write, counter: &mut Counter) -> Result<(), Refused> {
    let mut memory = Tiled::<f32, 1, B>::new(&WEIGHTS, 1.0, Overflow::Forget).map_err(|_| Refused)?;
    for k in 0..12 * B {
        let _ = memory.push(&[k as f32]);
    }
    let (mut terms, mut pushes, mut steps) = (Spread::default(), Spread::default(), Spread::default());
    for k in 0..16 {
        let mut sum = [0.0];
        let term = counter.count(|| {
            let _ = black_box(&mut memory).next_term(&mut sum);
            black_box(&sum);
        });
        let push = counter.count(|| {
            let _ = black_box(&mut memory).push(&black_box([k as f32]));
        });
        terms.add(term);
        pushes.add(push);
        steps.add(term + push);
    }
    let _ = writeln!(out, "tiled {}: term {} worst {} push {} worst {} step {} worst {}, per product {}", 8 * (B - 1), terms.mean(), terms.worst(), pushes.mean(), pushes.worst(), steps.mean(), steps.worst(), steps.mean() / (8 * (B - 1)) as f32);
    Ok(())
}

#[entry]
fn start() -> ! {
    main(|out| {
        let peripherals = cortex_m::Peripherals::take().ok_or(Refused)?;
        let mut counter = Counter::new(peripherals.SYST);
        direct::<32>(out, &mut counter)?;
        direct::<64>(out, &mut counter)?;
        direct::<128>(out, &mut counter)?;
        direct::<256>(out, &mut counter)?;
        direct::<512>(out, &mut counter)?;
        direct::<1024>(out, &mut counter)?;
        tiled::<17>(out, &mut counter)?;
        tiled::<33>(out, &mut counter)?;
        tiled::<129>(out, &mut counter)?;
        Ok(())
    })
}
