//! Convolvers of either precision behind the pointers of the caller.

use core::mem::MaybeUninit;

use fvi_core::{StateReader, StateWriter, Stateful};
use fvi_fft::{Convolver, Engines, PreparedResponses, Preparer, Responses, Stream};

use crate::pointer::{check, reference, slice, slice_mut};
use crate::status::{FviStreamStatus, of_block, of_exchange, of_parameter, status};
use crate::stream::{FviConvolverFacts, FviStream};

/// An array of the caller, read where an input is needed.
#[derive(Clone, Copy)]
struct Source<T> {
    samples: *const T,
    count: usize,
}

/// An array of the caller, written where an output is ready.
#[derive(Clone, Copy)]
struct Sink<T> {
    samples: *mut T,
    count: usize,
}

// Slices are made for each access, so that none of an input exists beside one of an output, which may be the
// same array.
impl<T> AsRef<[T]> for Source<T> {
    fn as_ref(&self) -> &[T] {
        if self.count == 0 {
            return &[];
        }
        // SAFETY: `process` has checked the pointer; `count` samples lie there as promised.
        unsafe { core::slice::from_raw_parts(self.samples, self.count) }
    }
}

impl<T> AsMut<[T]> for Sink<T> {
    fn as_mut(&mut self) -> &mut [T] {
        if self.count == 0 {
            return &mut [];
        }
        // SAFETY: `process` has checked the pointer; `count` samples lie there as promised.
        unsafe { core::slice::from_raw_parts_mut(self.samples, self.count) }
    }
}

/// A convolver with room for the pointers of a call.
pub(crate) struct Machine<T: Engines> {
    convolver: Convolver<T>,
    sources: Vec<Source<T>>,
    sinks: Vec<Sink<T>>,
}

/// A place for prepared responses, which an exchange takes out of it.
pub(crate) struct Prepared<T: Engines>(Option<PreparedResponses<T>>);

/// A response of the caller.
pub(crate) trait Response<T> {
    /// Its samples.
    fn parts(&self) -> (*const T, usize);
}

/// The object behind a pointer to change it.
///
/// # Safety
/// If the pointer is not NULL and aligned, it must point to an initialised `O` that nobody else uses during
/// `'a`.
unsafe fn object<'a, O>(pointer: *mut O) -> Result<&'a mut O, FviStreamStatus> {
    check(pointer)?;
    // SAFETY: not NULL, aligned; the rest is the caller's promise.
    Ok(unsafe { &mut *pointer })
}

/// Hands an object over to the caller.
///
/// # Safety
/// If the pointer is not NULL and aligned, it must be writable.
unsafe fn hand_over<O>(
    place: *mut *mut O,
    make: impl FnOnce() -> Result<O, FviStreamStatus>,
) -> FviStreamStatus {
    status((|| {
        check(place)?;
        let made = Box::new(make()?);
        // SAFETY: not NULL and aligned; writable as promised.
        unsafe { place.write(Box::into_raw(made)) };
        Ok(())
    })())
}

/// Frees what [`hand_over`] has handed over; NULL is ignored.
///
/// # Safety
/// The pointer must be NULL or come from [`hand_over`], and not be used afterwards.
pub(crate) unsafe fn free<O>(object: *mut O) {
    if !object.is_null() {
        // SAFETY: promised by the caller.
        drop(unsafe { Box::from_raw(object) });
    }
}

/// The responses of `inputs` rows with one for each of `outputs`.
///
/// # Safety
/// As [`crate::fvi_convolver_new_f32`].
unsafe fn responses<T: Engines, R: Response<T>>(
    given: *const R,
    inputs: usize,
    outputs: usize,
) -> Result<Responses<T>, FviStreamStatus> {
    let count = inputs.checked_mul(outputs).ok_or(FviStreamStatus::OutOfRange)?;
    if count == 0 {
        return Err(FviStreamStatus::NoResponse);
    }
    // SAFETY: promised by the caller.
    let given = unsafe { slice(given, count) }?;
    let taps = |response: &R| {
        let (samples, count) = response.parts();
        // SAFETY: promised by the caller.
        unsafe { slice(samples, count) }
    };
    let rows: Vec<&[T]> = given.iter().map(taps).collect::<Result<_, _>>()?;
    if rows.iter().all(|row| row.is_empty()) {
        return Err(FviStreamStatus::NoResponse);
    }
    // One array for every channel is transformed and stored once.
    let on_diagonal = |place: usize| place % outputs == place / outputs;
    let same = |row: &[T]| core::ptr::eq(row, rows[0]);
    let shared = inputs == outputs
        && rows
            .iter()
            .enumerate()
            .all(|(place, row)| if on_diagonal(place) { same(row) } else { row.is_empty() });
    let made = if shared { Responses::shared(rows[0], inputs) } else { Responses::matrix(outputs, &rows) };
    made.map_err(of_parameter)
}

/// # Safety
/// As [`crate::fvi_convolver_new_f32`].
pub(crate) unsafe fn new<T: Engines, R: Response<T>>(
    given: *const R,
    (inputs, outputs): (usize, usize),
    stream: *const FviStream,
    place: *mut *mut Machine<T>,
) -> FviStreamStatus {
    let make = || {
        // SAFETY: promised by the caller.
        let &FviStream { latency, block, longest } = unsafe { reference(stream) }?;
        // SAFETY: promised by the caller.
        let responses = unsafe { responses(given, inputs, outputs) }?;
        let stream = Stream { latency, block: (block > 0).then_some(block), longest };
        let convolver = Convolver::new(&responses, &stream).map_err(of_parameter)?;
        let sources = vec![Source { samples: core::ptr::null(), count: 0 }; inputs];
        let sinks = vec![Sink { samples: core::ptr::null_mut(), count: 0 }; outputs];
        Ok(Machine { convolver, sources, sinks })
    };
    // SAFETY: promised by the caller.
    unsafe { hand_over(place, make) }
}

/// # Safety
/// As [`crate::fvi_convolver_process_f32`].
pub(crate) unsafe fn process<T: Engines>(
    machine: *mut Machine<T>,
    inputs: *const *const T,
    outputs: *const *mut T,
    samples: usize,
) -> FviStreamStatus {
    status((|| {
        // SAFETY: promised by the caller.
        let Machine { convolver, sources, sinks } = unsafe { object(machine) }?;
        // SAFETY: promised by the caller.
        let (inputs, outputs) = unsafe { (slice(inputs, sources.len())?, slice(outputs, sinks.len())?) };
        for (source, &input) in sources.iter_mut().zip(inputs) {
            // SAFETY: promised by the caller; what is checked here is made a slice where it is read.
            let count = unsafe { slice(input, samples) }?.len();
            *source = Source { samples: input, count };
        }
        for (sink, &output) in sinks.iter_mut().zip(outputs) {
            // SAFETY: promised by the caller; what is checked here is made a slice where it is written.
            let count = unsafe { slice(output.cast_const().cast::<MaybeUninit<T>>(), samples) }?.len();
            *sink = Sink { samples: output, count };
        }
        convolver.process(sources, sinks).map_err(of_block)
    })())
}

/// # Safety
/// As [`crate::fvi_convolver_facts_f32`].
pub(crate) unsafe fn facts<T: Engines>(
    machine: *const Machine<T>,
    facts: *mut FviConvolverFacts,
) -> FviStreamStatus {
    status((|| {
        // SAFETY: promised by the caller.
        let Machine { convolver, sources, sinks } = unsafe { reference(machine) }?;
        check(facts)?;
        let found = FviConvolverFacts {
            inputs: sources.len(),
            outputs: sinks.len(),
            latency: convolver.latency(),
            longest: convolver.longest(),
            bytes: convolver.bytes(),
            taken: convolver.taken(),
            exchange_left: convolver.exchange_left(),
            overruns: convolver.overruns(),
        };
        // SAFETY: not NULL and aligned; writable as promised.
        unsafe { facts.write(found) };
        Ok(())
    })())
}

/// # Safety
/// As [`crate::fvi_preparer_new_f32`].
pub(crate) unsafe fn preparer<T: Engines>(
    machine: *const Machine<T>,
    place: *mut *mut Preparer<T>,
) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    let make = || Ok(unsafe { reference(machine) }?.convolver.preparer());
    // SAFETY: promised by the caller.
    unsafe { hand_over(place, make) }
}

/// # Safety
/// As [`crate::fvi_preparer_prepare_f32`].
pub(crate) unsafe fn prepare<T: Engines, R: Response<T>>(
    preparer: *const Preparer<T>,
    given: *const R,
    (inputs, outputs): (usize, usize),
    place: *mut *mut Prepared<T>,
) -> FviStreamStatus {
    let make = || {
        // SAFETY: promised by the caller.
        let preparer = unsafe { reference(preparer) }?;
        // SAFETY: promised by the caller.
        let responses = unsafe { responses(given, inputs, outputs) }?;
        Ok(Prepared(Some(preparer.prepare(&responses).map_err(of_parameter)?)))
    };
    // SAFETY: promised by the caller.
    unsafe { hand_over(place, make) }
}

/// When a fade begins.
#[derive(Clone, Copy)]
pub(crate) enum Begins {
    Now,
    Evenly,
}

/// # Safety
/// As [`crate::fvi_convolver_exchange_f32`].
pub(crate) unsafe fn exchange<T: Engines>(
    machine: *mut Machine<T>,
    prepared: *mut Prepared<T>,
    fade: usize,
    begins: Begins,
    begins_in: *mut u64,
) -> FviStreamStatus {
    status((|| {
        // SAFETY: promised by the caller.
        let (machine, place) = unsafe { (object(machine)?, object(prepared)?) };
        if !begins_in.is_null() {
            check(begins_in)?;
        }
        let responses = place.0.take().ok_or(FviStreamStatus::Empty)?;
        let exchanged = match begins {
            Begins::Now => machine.convolver.exchange(responses, fade),
            Begins::Evenly => machine.convolver.exchange_evenly(responses, fade),
        };
        match exchanged {
            Ok(exchanged) => {
                place.0 = exchanged.retired;
                if !begins_in.is_null() {
                    // SAFETY: not NULL and aligned; writable as promised.
                    unsafe { begins_in.write(exchanged.begins_in) };
                }
                Ok(())
            }
            Err(error) => {
                let status = of_exchange(&error);
                place.0 = Some(error.into_responses());
                Err(status)
            }
        }
    })())
}

/// # Safety
/// As [`crate::fvi_convolver_take_retired_f32`].
pub(crate) unsafe fn take_retired<T: Engines>(
    machine: *mut Machine<T>,
    prepared: *mut Prepared<T>,
) -> FviStreamStatus {
    status((|| {
        // SAFETY: promised by the caller.
        let (machine, place) = unsafe { (object(machine)?, object(prepared)?) };
        if place.0.is_some() {
            return Err(FviStreamStatus::Occupied);
        }
        place.0 = Some(machine.convolver.take_retired().ok_or(FviStreamStatus::Empty)?);
        Ok(())
    })())
}

/// # Safety
/// As [`crate::fvi_convolver_clear_f32`].
pub(crate) unsafe fn clear<T: Engines>(machine: *mut Machine<T>) -> FviStreamStatus {
    // SAFETY: promised by the caller.
    status(unsafe { object(machine) }.map(|machine| machine.convolver.clear()))
}

/// # Safety
/// As [`crate::fvi_convolver_save_f32`].
pub(crate) unsafe fn save<T: Engines>(
    machine: *const Machine<T>,
    bytes: *mut u8,
    capacity: usize,
    written: *mut usize,
) -> FviStreamStatus {
    status((|| {
        // SAFETY: promised by the caller.
        let convolver = &unsafe { reference(machine) }?.convolver;
        check(written)?;
        let size = convolver.state_bytes();
        if capacity != 0 {
            // SAFETY: promised by the caller.
            let bytes = unsafe { slice_mut(bytes, capacity) }?;
            let bytes = bytes.get_mut(..size).ok_or(FviStreamStatus::WrongSize)?;
            convolver.save(&mut StateWriter::new(bytes))?;
        }
        // SAFETY: not NULL and aligned; writable as promised.
        unsafe { written.write(size) };
        Ok(())
    })())
}

/// # Safety
/// As [`crate::fvi_convolver_restore_f32`].
pub(crate) unsafe fn restore<T: Engines>(
    machine: *mut Machine<T>,
    bytes: *const u8,
    count: usize,
) -> FviStreamStatus {
    status((|| {
        // SAFETY: promised by the caller.
        let (machine, bytes) = unsafe { (object(machine)?, slice(bytes, count)?) };
        Ok(machine.convolver.restore(&mut StateReader::new(bytes))?)
    })())
}
