//! The control loop of the image `control_loop`, reset three times during the run: each time it saves its
//! state to RAM that a reset leaves unchanged, resets the processor, and continues from the saved state.
#![no_std]
#![no_main]

use core::fmt::Write;
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use cortex_m::peripheral::SCB;
use cortex_m_rt::entry;
use fvi_core::{StateReader, StateWriter};
use images::{Refused, main};
use scenarios::control_loop::{ControlLoop, TICKS};

/// Ticks between two resets.
const LIFE: u32 = 270_001;

/// Largest number of words of a state.
const ROOM: usize = 1024;

/// Value of the first word while a state is stored.
const MARK: u32 = 0x6676_6921;

/// RAM that the start-up code does not initialise: mark, number of bytes, checksum, and the state.
#[unsafe(link_section = ".uninit.kept")]
static KEPT: [AtomicU32; 3 + ROOM] = [const { AtomicU32::new(0) }; 3 + ROOM];

/// FNV-1a checksum, which detects bits that have changed during a power failure.
fn checksum(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0x811c_9dc5, |hash, &byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}

/// The state stored before the reset, if there is one.
fn recall(bytes: &mut [u8; 4 * ROOM]) -> Option<&[u8]> {
    let [mark, length, sum, state @ ..] = &KEPT;
    if mark.swap(0, Relaxed) != MARK {
        return None;
    }
    for (place, word) in bytes.chunks_exact_mut(4).zip(state) {
        place.copy_from_slice(&word.load(Relaxed).to_le_bytes());
    }
    let bytes = bytes.get(..length.load(Relaxed) as usize)?;
    (checksum(bytes) == sum.load(Relaxed)).then_some(bytes)
}

/// Stores a state for the time after the next reset.
fn keep(bytes: &[u8]) {
    let [mark, length, sum, state @ ..] = &KEPT;
    for (word, part) in state.iter().zip(bytes.chunks(4)) {
        let mut four = [0; 4];
        four.iter_mut().zip(part).for_each(|(place, &byte)| *place = byte);
        word.store(u32::from_le_bytes(four), Relaxed);
    }
    length.store(bytes.len() as u32, Relaxed);
    sum.store(checksum(bytes), Relaxed);
    mark.store(MARK, Relaxed);
}

#[entry]
fn start() -> ! {
    main(|out| {
        let mut bytes = [0; 4 * ROOM];
        let begun = match recall(&mut bytes) {
            Some(state) => ControlLoop::restored(&mut StateReader::new(state)),
            None => ControlLoop::new(),
        };
        let mut control_loop = begun.map_err(|refusal| Refused::because(out, refusal))?;
        writeln!(out, "# from tick {}", control_loop.ticks()).map_err(|_| Refused)?;
        while control_loop.ticks() < TICKS {
            control_loop.tick().map_err(|refusal| Refused::because(out, refusal))?;
            if control_loop.ticks().is_multiple_of(LIFE) {
                let mut to = StateWriter::new(&mut bytes);
                control_loop.save(&mut to).map_err(|refusal| Refused::because(out, refusal))?;
                let written = to.written();
                keep(bytes.get(..written).ok_or(Refused)?);
                SCB::sys_reset();
            }
        }
        writeln!(out, "hash {:08x}", control_loop.hash()).map_err(|_| Refused)
    })
}
