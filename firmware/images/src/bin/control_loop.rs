//! The control loop, driven by the SysTick interrupt at 1 kHz for a thousand seconds of its clock.
#![no_std]
#![no_main]

use core::cell::RefCell;
use core::fmt::Write;

use cortex_m::interrupt::{Mutex, free};
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use cortex_m_rt::{entry, exception};
use images::{Refused, main};
use scenarios::control_loop::{ControlLoop, PRINTED, TICKS, Tick};
use scenarios::refusal::Refusal;

/// 25 MHz divided by the rate of the loop.
const CLOCKS_PER_TICK: u32 = 25_000;

static LOOP: Mutex<RefCell<Option<Running>>> = Mutex::new(RefCell::new(None));

/// The loop and its statistics.
struct Running {
    control_loop: ControlLoop,
    printed: [Option<Tick>; (TICKS / PRINTED) as usize],
    worst_clocks: u32,
    total_clocks: u64,
    /// Number of ticks that had not ended when the next one was due.
    overruns: u32,
    refusal: Option<Refusal>,
}

impl Running {
    fn tick(&mut self) {
        if self.control_loop.ticks() == TICKS || self.refusal.is_some() {
            return;
        }
        match self.control_loop.tick() {
            Ok(tick) => {
                let ticks = self.control_loop.ticks();
                if ticks.is_multiple_of(PRINTED)
                    && let Some(place) = self.printed.get_mut((ticks / PRINTED - 1) as usize)
                {
                    *place = Some(tick);
                }
            }
            Err(refusal) => self.refusal = Some(refusal),
        }
        // The timer counts down from the beginning of the tick.
        let clocks = CLOCKS_PER_TICK - 1 - SYST::get_current();
        self.worst_clocks = self.worst_clocks.max(clocks);
        self.total_clocks += u64::from(clocks);
        self.overruns += u32::from(SCB::is_pendst_pending());
    }

    fn done(&self) -> bool {
        self.control_loop.ticks() == TICKS || self.refusal.is_some()
    }
}

#[exception]
fn SysTick() {
    free(|token| {
        if let Some(running) = LOOP.borrow(token).borrow_mut().as_mut() {
            running.tick();
        }
    });
}

#[entry]
fn start() -> ! {
    main(|out| {
        let mut timer = cortex_m::Peripherals::take().ok_or(Refused)?.SYST;
        let control_loop = ControlLoop::new().map_err(|refusal| Refused::because(out, refusal))?;
        free(|token| {
            LOOP.borrow(token).replace(Some(Running {
                control_loop,
                printed: [None; (TICKS / PRINTED) as usize],
                worst_clocks: 0,
                total_clocks: 0,
                overruns: 0,
                refusal: None,
            }))
        });
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(CLOCKS_PER_TICK - 1);
        timer.clear_current();
        timer.enable_interrupt();
        timer.enable_counter();
        while !free(|token| LOOP.borrow(token).borrow().as_ref().is_some_and(Running::done)) {
            cortex_m::asm::wfi();
        }
        timer.disable_counter();
        let Some(running) = free(|token| LOOP.borrow(token).take()) else { return Err(Refused) };
        if let Some(refusal) = running.refusal {
            return Err(Refused::because(out, refusal));
        }
        let mut report = || -> core::fmt::Result {
            for (index, tick) in running.printed.iter().flatten().enumerate() {
                writeln!(out, "{} {tick}", (index as u32 + 1) * PRINTED)?;
            }
            writeln!(out, "hash {:08x}", running.control_loop.hash())?;
            writeln!(
                out,
                "# instructions per tick: mean {}, worst {}, available {}; overruns {}",
                running.total_clocks * 5 / 8 / u64::from(TICKS),
                running.worst_clocks * 5 / 8,
                CLOCKS_PER_TICK * 5 / 8,
                running.overruns
            )
        };
        report().map_err(|_| Refused)?;
        if running.overruns == 0 { Ok(()) } else { Err(Refused) }
    })
}
