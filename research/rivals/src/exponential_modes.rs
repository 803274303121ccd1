//! The history of a continuous kernel as a sum of decaying modes, driven by a signal between its samples.

use fvi_core::{Memory, MemoryError, ParameterError, Stateful};

use crate::frame::{Frame, framed};
use crate::operations::Operations;
use crate::product::sum;

/// r_k = g x_{k−1} + Σ_i V_i with V_i ← ρ_i V_i + a_i x_k + b_i x_{k−1} after each sample: O(modes) a step.
#[derive(Clone, Debug)]
pub struct ExponentialModes {
    frame: Frame,
    local: f64,
    decays: Vec<f64>,
    newest: Vec<f64>,
    before: Vec<f64>,
    /// V_i, the modes of the first channel, then those of the next, and so on.
    states: Vec<f64>,
    last: Vec<f64>,
    operations: Operations,
}

/// Coefficients of one mode, named as in the formula.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mode {
    /// ρ
    pub(crate) decay: f64,
    /// a
    pub(crate) newest: f64,
    /// b
    pub(crate) before: f64,
}

/// Leading weight, g and the modes of a memory.
#[derive(Clone, Debug)]
pub(crate) struct Modes {
    pub(crate) leading: f64,
    pub(crate) local: f64,
    pub(crate) modes: Vec<Mode>,
}

impl Modes {
    /// The weight w_n, n ≥ 1, that the recursions effectively use.
    pub(crate) fn weight(&self, n: usize) -> f64 {
        let history: f64 = self
            .modes
            .iter()
            .map(|mode| {
                let older = if n >= 2 { libm::pow(mode.decay, (n - 2) as f64) } else { 0.0 };
                mode.newest * libm::pow(mode.decay, (n - 1) as f64) + mode.before * older
            })
            .sum();
        if n == 1 { self.local + history } else { history }
    }
}

impl ExponentialModes {
    pub(crate) fn new(modes: &Modes, channels: usize, capacity: usize) -> Result<Self, ParameterError> {
        let of = |coefficient: fn(&Mode) -> f64| modes.modes.iter().map(coefficient).collect::<Vec<_>>();
        Ok(Self {
            frame: Frame::new(channels, capacity, modes.leading)?,
            local: modes.local,
            decays: of(|mode| mode.decay),
            newest: of(|mode| mode.newest),
            before: of(|mode| mode.before),
            states: vec![0.0; modes.modes.len() * channels],
            last: vec![0.0; channels],
            operations: Operations::default(),
        })
    }

    /// The counter of its operations.
    pub fn operations(&self) -> Operations {
        self.operations.clone()
    }

    /// Number of modes.
    pub fn modes(&self) -> usize {
        self.decays.len()
    }
}

impl Memory<f64> for ExponentialModes {
    framed!();

    #[inline(always)]
    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        self.frame.check(term)?;
        let modes = self.decays.len().max(1);
        for ((number, states), last) in term.iter_mut().zip(self.states.chunks_exact(modes)).zip(&self.last) {
            *number = self.local * last + sum(states);
        }
        self.operations.add((modes + 2) * self.frame.channels);
        Ok(())
    }

    #[inline(always)]
    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        self.frame.check(sample)?;
        let modes = self.decays.len().max(1);
        let rows = self.states.chunks_exact_mut(modes).zip(&mut self.last);
        for ((states, last), &number) in rows.zip(sample) {
            let coefficients = self.decays.iter().zip(&self.newest).zip(&self.before);
            for (state, ((decay, newest), before)) in states.iter_mut().zip(coefficients) {
                *state = decay * *state + (newest * number + before * *last);
            }
            *last = number;
        }
        self.frame.len += 1;
        self.operations.add(5 * modes * self.frame.channels);
        Ok(())
    }

    fn clear(&mut self) {
        self.frame.len = 0;
        self.states.fill(0.0);
        self.last.fill(0.0);
        self.operations.clear();
    }

    fn bytes(&self) -> usize {
        let numbers = 3 * self.decays.capacity() + self.states.capacity() + self.last.capacity();
        size_of::<Self>() + numbers * size_of::<f64>()
    }
}

impl Stateful for ExponentialModes {}
