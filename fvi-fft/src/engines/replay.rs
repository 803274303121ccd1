//! The saved state of the transform engines: their samples, which are pushed again one after another.
//!
//! The rest of an engine's state follows from the samples, bit by bit, and is several times as large.

use fvi_core::{Memory, Shape, StateError, StateReader, StateWriter, fingerprint, header_bytes};

use crate::engines::scalar::Scalar;

/// The header contains the engine's tag: no engine restores the state of another, as their bits differ.
pub(crate) fn state_bytes<T: Scalar>(memory: &impl Memory<T>) -> usize {
    header_bytes(4) + memory.len() * memory.channels() * T::BYTES
}

/// Writes the samples of a memory, all channels of one sample after another.
pub(crate) fn save<T: Scalar>(
    memory: &impl Memory<T>,
    tag: [u8; 4],
    signal: &[Vec<T>],
    to: &mut StateWriter<'_>,
) -> Result<(), StateError> {
    to.header::<T, 3>(tag, &shape(memory))?;
    to.count(memory.len() as u64)?;
    match signal {
        // One channel is stored contiguously.
        [row] => to.numbers(row.iter().take(memory.len())),
        rows => (0..memory.len()).try_for_each(|k| to.numbers(rows.iter().filter_map(|row| row.get(k)))),
    }
}

/// Reads past a saved state and checks it.
pub(crate) fn check<T: Scalar>(
    memory: &impl Memory<T>,
    tag: [u8; 4],
    capacity: usize,
    from: &mut StateReader<'_>,
) -> Result<(), StateError> {
    let count = begin(memory, tag, capacity, from)?;
    from.skip::<T>(count.saturating_mul(memory.channels()))
}

/// Clears the memory and pushes the samples of a saved state.
pub(crate) fn restore<T: Scalar>(
    memory: &mut impl Memory<T>,
    tag: [u8; 4],
    capacity: usize,
    from: &mut StateReader<'_>,
) -> Result<(), StateError> {
    check(memory, tag, capacity, &mut from.clone())?;
    let count = begin(memory, tag, capacity, from)?;
    memory.clear();
    let mut sample = vec![T::zero(); memory.channels()];
    for _ in 0..count {
        from.numbers(&mut sample)?;
        let limit = capacity as u64;
        let too_large = StateError::TooLarge { what: "samples", limit, found: count as u64 };
        memory.push(&sample).map_err(|_| too_large)?;
    }
    Ok(())
}

/// Reads the header and the number of samples.
fn begin<T: Scalar>(
    memory: &impl Memory<T>,
    tag: [u8; 4],
    capacity: usize,
    from: &mut StateReader<'_>,
) -> Result<usize, StateError> {
    from.header::<T, 3>(tag, &shape(memory))?;
    from.count_up_to("samples", capacity)
}

fn shape<T: Scalar>(memory: &impl Memory<T>) -> Shape<3> {
    [
        ("channels", memory.channels() as u64),
        ("stages", memory.stages() as u64),
        ("fingerprint of the kernel", fingerprint(memory.leading())),
    ]
}
