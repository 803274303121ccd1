//! Memories of the library for whoever asks in Python.

use crate::errors::{Failure, Outcome};
use fvi_core::{ActsOn, Memory, MemoryError, StateError, StateReader, StateWriter};
use fvi_host::memory::{EngineError, HostMemory, MemoryRequest};
use fvi_host::results::room::require;
use fvi_host::scenario::{Convolution, Engine, History};

/// A memory that takes and serves the values of sequences, whatever differences its engine acts on.
///
/// An engine may be fed with Y_k = X_k − l_k, where l is the sample before, or for stages its last stage; its term t_k then gives
///
/// ```text
/// (W ∗ X)_k = W₀ (X_k − l_k) + t_k ,    so that    r_k = t_k − W₀ l_k .
/// ```
pub(crate) struct ValueMemory {
    memory: HostMemory<f64>,
    /// l_k, one number for each channel of the memory; zeros where the engine acts on values.
    last: Vec<f64>,
}

impl ValueMemory {
    fn new(memory: HostMemory<f64>) -> Self {
        let last = vec![0.0; memory.channels()];
        Self { memory, last }
    }

    /// What the engine is told of a sample.
    fn difference(&self, sample: &[f64]) -> Vec<f64> {
        sample.iter().zip(&self.last).map(|(value, last)| value - last).collect()
    }

    /// Adds sign · W₀ y.
    fn add_leading(&self, sign: f64, y: &[f64], sum: &mut [f64]) {
        let (stages, leading) = (self.memory.stages(), self.memory.leading());
        for (sum, y) in sum.chunks_exact_mut(stages).zip(y.chunks_exact(stages)) {
            for (sum, row) in sum.iter_mut().zip(leading.chunks_exact(stages)) {
                *sum += sign * row.iter().zip(y).map(|(weight, y)| weight * y).sum::<f64>();
            }
        }
    }

    /// r_k.
    pub(crate) fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        self.memory.next_term(term)?;
        self.add_leading(-1.0, &self.last, term);
        Ok(())
    }

    /// Takes X_k.
    pub(crate) fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        self.memory.push(&self.difference(sample))?;
        self.remember(sample);
        Ok(())
    }

    /// Takes X_k and writes (W ∗ X)_k.
    pub(crate) fn operate(&mut self, sample: &[f64], result: &mut [f64]) -> Result<(), MemoryError> {
        self.memory.next_term(result)?;
        let difference = self.difference(sample);
        self.add_leading(1.0, &difference, result);
        self.memory.push(&difference)?;
        self.remember(sample);
        Ok(())
    }

    fn remember(&mut self, sample: &[f64]) {
        let stages = self.memory.stages();
        match self.memory.acts_on() {
            ActsOn::Values => {}
            ActsOn::Increments => self.last.copy_from_slice(sample),
            ActsOn::Rises => {
                for (last, sample) in self.last.chunks_exact_mut(stages).zip(sample.chunks_exact(stages)) {
                    last.fill(sample[stages - 1]);
                }
            }
        }
    }

    pub(crate) fn clear(&mut self) {
        self.memory.clear();
        self.last.fill(0.0);
    }

    pub(crate) fn engine(&self) -> Engine {
        self.memory.engine()
    }

    pub(crate) fn stages(&self) -> usize {
        self.memory.stages()
    }

    pub(crate) fn leading(&self) -> &[f64] {
        self.memory.leading()
    }

    pub(crate) fn len(&self) -> usize {
        self.memory.len()
    }

    pub(crate) fn bytes(&self) -> usize {
        self.memory.bytes() + size_of_val(&self.last[..])
    }

    pub(crate) fn state_bytes(&self) -> usize {
        self.memory.state_bytes() + size_of_val(&self.last[..])
    }

    pub(crate) fn save(&self, to: &mut StateWriter<'_>) -> Result<(), StateError> {
        self.memory.save(to)?;
        to.numbers(&self.last)
    }

    /// Takes over a whole state; on an error it is as before.
    pub(crate) fn restore(&mut self, state: &[u8]) -> Result<(), StateError> {
        let mut check = StateReader::new(state);
        self.memory.check_state(&mut check)?;
        let mut last = self.last.clone();
        check.numbers(&mut last)?;
        check.finish()?;
        self.memory.restore(&mut StateReader::new(state))?;
        self.last = last;
        Ok(())
    }
}

/// The memory of a kernel for `channels` sequences of `samples` values.
pub(crate) fn value_memory(
    convolution: &Convolution,
    exponent: f64,
    step: f64,
    channels: usize,
    samples: usize,
    engine: Option<Engine>,
) -> Outcome<ValueMemory> {
    memory(convolution, exponent, step, channels, samples, engine).map(ValueMemory::new)
}

/// The memory of a kernel for `channels` sequences of `samples` numbers, which act on what it says.
pub(crate) fn memory(
    convolution: &Convolution,
    exponent: f64,
    step: f64,
    channels: usize,
    samples: usize,
    engine: Option<Engine>,
) -> Outcome<HostMemory<f64>> {
    if channels == 0 {
        return Err(Failure::argument("channels", channels, "one at least"));
    }
    let history = History { engine, ..History::default() };
    let build = |channels: usize| -> Outcome<HostMemory<f64>> {
        let request = MemoryRequest {
            convolution,
            exponent,
            step_size: step,
            end: None,
            coordinates: channels,
            motions: 1,
            samples,
            history: &history,
        };
        // Exponent and step are looked at before the engine is.
        let _ = request.kernel()?;
        request.build().map_err(|error| match error {
            EngineError::Parameter(error) => error.into(),
            EngineError::NoRoom { .. } => Failure::NoRoom(error.to_string()),
            other => Failure::argument("engine", engine.map_or("None", Engine::name), &other.to_string()),
        })
    };
    if channels > MANY {
        let (one, two) = (build(1)?, build(2)?);
        // Nobody stops a program whose memory has run out.
        let each = two.bytes().saturating_sub(one.bytes()).max(size_of::<f64>());
        require(each.saturating_mul(channels))
            .map_err(|error| Failure::NoRoom(format!("channels = {channels}: {error}")))?;
    }
    build(channels)
}

/// Channels from which on the room for them is looked at beforehand.
const MANY: usize = 1 << 16;

/// A refusal of a memory that is full, or of a sample of another shape.
pub(crate) fn refused(error: MemoryError) -> Failure {
    match error {
        MemoryError::Full { capacity } => Failure::Failed(format!(
            "the memory is full: it takes {capacity} samples; make it with a greater `length`"
        )),
        other => Failure::Failed(other.to_string()),
    }
}
