//! The memory engines on the host, and the one place where one is chosen.

use crate::runge_kutta_weights::RungeKuttaWeights;
use crate::scenario::{Convolution, ConvolutionFamily, Engine, History, Overflow};
use fvi_core::{
    BdfOrder, ConvolutionWeights, Direct, Memory, MemoryError, ParameterError, Real, Ring, RungeKutta,
};
use std::collections::VecDeque;

/// A memory engine chosen at run time.
pub struct HostMemory<T>(Box<dyn Memory<T> + Send>);

/// What a memory is wanted for.
#[derive(Clone, Debug)]
pub struct MemoryRequest<'a> {
    /// How the fractional derivative is discretised.
    pub convolution: &'a Convolution,
    /// Exponent of the convolution quadrature: the damping order β.
    pub exponent: f64,
    /// h.
    pub step_size: f64,
    /// Number of coordinates N.
    pub coordinates: usize,
    /// Number of samples that will come: one for each step, and one before the first.
    pub samples: usize,
    /// The engine asked for, and its settings.
    pub history: &'a History,
}

/// Why an engine cannot serve a request.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    /// The engine does not serve this kind of kernel.
    #[error("the engine \"{}\" does not serve {kernel} kernels", .engine.name())]
    Kernel {
        /// The engine.
        engine: Engine,
        /// The kind of kernel.
        kernel: String,
    },
    /// The run is too long for the engine's tables and samples to fit into memory.
    #[error("the engine \"{}\" finds no room for {samples} samples", .engine.name())]
    NoRoom {
        /// The engine.
        engine: Engine,
        /// Number of samples.
        samples: usize,
    },
    /// A parameter of the kernel is outside its range.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
}

impl MemoryRequest<'_> {
    /// The engine that serves the request: the one asked for, or the fastest that is exact to rounding.
    pub fn engine(&self) -> Engine {
        self.history.engine.unwrap_or(Engine::Direct)
    }

    /// The memory, empty.
    ///
    /// # Errors
    /// [`EngineError`] if the engine asked for cannot serve the kernel.
    pub fn build<T: Real>(&self) -> Result<HostMemory<T>, EngineError> {
        let engine = self.engine();
        let unserved = || EngineError::Kernel { engine, kernel: self.convolution.describe() };
        match (engine, self.convolution.family) {
            (Engine::Direct, ConvolutionFamily::Bdf { order }) => self.direct(BdfOrder::new(order)?),
            (Engine::Direct, ConvolutionFamily::RadauIia { stages }) => match stages {
                1 => self.direct_stages(&RungeKutta::<1>::radau_iia()?),
                2 => self.direct_stages(&RungeKutta::<2>::radau_iia()?),
                _ => self.direct_stages(&RungeKutta::<3>::radau_iia()?),
            },
            (Engine::Direct, ConvolutionFamily::LobattoIiic { stages }) => match stages {
                2 => self.direct_stages(&RungeKutta::<2>::lobatto_iiic()?),
                3 => self.direct_stages(&RungeKutta::<3>::lobatto_iiic()?),
                _ => self.direct_stages(&RungeKutta::<4>::lobatto_iiic()?),
            },
            _ => Err(unserved()),
        }
    }

    fn direct<T: Real>(&self, order: BdfOrder) -> Result<HostMemory<T>, EngineError> {
        let kept = self.kept();
        // With the step size γ_p(0) the leading weight is 1: the same monic table and scale as in flash.
        let mut monic = ConvolutionWeights::bdf(order, self.exponent, order.generating_function(0.0))?;
        let mut weights = self.room(kept.saturating_add(1))?;
        weights.resize(kept + 1, T::zero());
        monic.fill(&mut weights);
        let scale = T::of(fvi_core::leading_bdf_weight(order, self.exponent, self.step_size)?);
        self.direct_of(weights, 1, scale)
    }

    fn direct_stages<T: Real, const R: usize>(
        &self,
        method: &RungeKutta<R>,
    ) -> Result<HostMemory<T>, EngineError> {
        let count = self.kept().saturating_add(1);
        self.room::<f64>(count.saturating_mul(R * R))?;
        let weights = RungeKuttaWeights::new(method, self.exponent, self.step_size, count)?.planes();
        self.direct_of(weights.into_iter().map(T::of).collect(), R, T::one())
    }

    fn direct_of<T: Real>(
        &self,
        weights: Vec<T>,
        stages: usize,
        scale: T,
    ) -> Result<HostMemory<T>, EngineError> {
        let channels = self.coordinates * stages;
        let rings: Vec<GrowingRing<T>> = (0..channels).map(|_| GrowingRing::new(self.kept())).collect();
        let overflow = match self.history.overflow {
            Overflow::Stop => fvi_core::Overflow::Refuse,
            Overflow::Forget => fvi_core::Overflow::Forget,
        };
        Ok(HostMemory(Box::new(Direct::new(weights, stages, scale, rings, overflow)?)))
    }

    /// Number of samples that the direct engine keeps.
    fn kept(&self) -> usize {
        let samples = self.samples.max(1);
        self.history.capacity.map_or(samples, |capacity| capacity.min(samples))
    }

    /// Room for `count` numbers.
    fn room<T>(&self, count: usize) -> Result<Vec<T>, EngineError> {
        let mut room = Vec::new();
        match room.try_reserve_exact(count) {
            Ok(()) => Ok(room),
            Err(_) => Err(EngineError::NoRoom { engine: self.engine(), samples: self.samples }),
        }
    }
}

/// A ring whose capacity is known at run time and whose storage grows as samples come; newest first.
#[derive(Clone, Debug)]
struct GrowingRing<T> {
    samples: VecDeque<T>,
    capacity: usize,
}

impl<T> GrowingRing<T> {
    fn new(capacity: usize) -> Self {
        Self { samples: VecDeque::new(), capacity }
    }
}

impl<T: Copy> Ring<T> for GrowingRing<T> {
    fn as_slices(&self) -> (&[T], &[T]) {
        self.samples.as_slices()
    }

    fn capacity(&self) -> usize {
        self.capacity
    }

    fn store(&mut self, sample: T) {
        if self.samples.len() == self.capacity {
            self.samples.pop_back();
        }
        self.samples.push_front(sample);
    }

    fn clear(&mut self) {
        self.samples.clear();
    }

    fn bytes(&self) -> usize {
        size_of::<Self>() + self.samples.capacity() * size_of::<T>()
    }
}

impl<T> Memory<T> for HostMemory<T> {
    fn channels(&self) -> usize {
        self.0.channels()
    }

    fn stages(&self) -> usize {
        self.0.stages()
    }

    fn leading(&self) -> &[T] {
        self.0.leading()
    }

    fn len(&self) -> usize {
        self.0.len()
    }

    fn next_term(&mut self, term: &mut [T]) -> Result<(), MemoryError> {
        self.0.next_term(term)
    }

    fn push(&mut self, sample: &[T]) -> Result<(), MemoryError> {
        self.0.push(sample)
    }

    fn clear(&mut self) {
        self.0.clear();
    }

    fn bytes(&self) -> usize {
        self.0.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request<'a>(convolution: &'a Convolution, history: &'a History) -> MemoryRequest<'a> {
        MemoryRequest { convolution, exponent: 0.5, step_size: 0.25, coordinates: 2, samples: 6, history }
    }

    #[test]
    fn the_direct_engine_sums_the_weights_of_the_step_size() {
        let (convolution, history) = (Convolution::default(), History::default());
        let mut memory = request(&convolution, &history).build::<f64>().unwrap();
        let weights: Vec<f64> =
            ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 0.25).unwrap().take(6).collect();
        assert_eq!(memory.leading(), [2.0]);
        memory.push(&[1.0, 0.0]).unwrap();
        for weight in &weights[1..] {
            let mut term = [f64::NAN; 2];
            memory.next_term(&mut term).unwrap();
            assert!((term[0] - weight).abs() < 1e-15 && term[1] == 0.0, "{term:?} {weight}");
            memory.push(&[0.0, 0.0]).unwrap();
        }
        assert_eq!(memory.next_term(&mut [0.0; 2]), Err(MemoryError::Full { capacity: 6 }));
    }

    #[test]
    fn a_run_too_long_for_the_memory_of_the_machine_is_refused() {
        let (convolution, history) = (Convolution::default(), History::default());
        let mut request = request(&convolution, &history);
        request.samples = usize::MAX;
        let refused = EngineError::NoRoom { engine: Engine::Direct, samples: usize::MAX };
        assert_eq!(request.build::<f64>().err(), Some(refused));
    }

    #[test]
    fn short_memory_forgets_only_when_it_is_told_to() {
        let convolution = Convolution::default();
        let history = History { capacity: Some(2), overflow: Overflow::Forget, ..History::default() };
        let mut memory = request(&convolution, &history).build::<f64>().unwrap();
        for sample in [[1.0, 1.0], [0.0, 0.0], [0.0, 0.0]] {
            memory.push(&sample).unwrap();
        }
        let mut term = [f64::NAN; 2];
        memory.next_term(&mut term).unwrap();
        assert_eq!(term, [0.0, 0.0]);
        let history = History { overflow: Overflow::Stop, ..history };
        let mut memory = request(&convolution, &history).build::<f64>().unwrap();
        memory.push(&[1.0, 1.0]).unwrap();
        memory.push(&[1.0, 1.0]).unwrap();
        assert_eq!(memory.push(&[1.0, 1.0]), Err(MemoryError::Full { capacity: 2 }));
    }
}
