//! A library of others in the race: the convolution of audio effects, `fft-convolver`, a partition in blocks of
//! two sizes, fed sample by sample.

use fft_convolver::TwoStageFFTConvolver;
use fvi_strategies::fvi_core::{Memory, MemoryError, Stateful, check_channels};

/// r_{k+1} = Σ_{n≥0} w_{n+1} x_{k−n} is what the convolver with the kernel w_1, w_2, … returns for the sample x_k.
pub struct TwoStage {
    convolver: TwoStageFFTConvolver<f64>,
    leading: [f64; 1],
    term: [f64; 1],
    len: usize,
    capacity: usize,
}

/// Size of the small blocks: of 4, 8, … 128 the fastest for 16 384 samples one by one.
const HEAD: usize = 16;

impl TwoStage {
    /// A convolver for weights w_0, w_1, …, at least one.
    pub fn new(weights: &[f64]) -> Result<Self, fft_convolver::FFTConvolverError> {
        let mut convolver = TwoStageFFTConvolver::default();
        convolver.init_default(HEAD, &weights[1..])?;
        Ok(Self { convolver, leading: [weights[0]], term: [0.0], len: 0, capacity: weights.len() })
    }
}

impl Memory<f64> for TwoStage {
    fn channels(&self) -> usize {
        1
    }

    fn leading(&self) -> &[f64] {
        &self.leading
    }

    fn len(&self) -> usize {
        self.len
    }

    #[inline(always)]
    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        check_channels(1, term.len())?;
        term.copy_from_slice(&self.term);
        Ok(())
    }

    #[inline(always)]
    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        check_channels(1, sample.len())?;
        let full = MemoryError::Full { capacity: self.capacity };
        if self.len == self.capacity {
            return Err(full);
        }
        self.convolver.process(sample, &mut self.term).map_err(|_| full)?;
        self.len += 1;
        Ok(())
    }

    fn clear(&mut self) {
        self.convolver.reset();
        (self.term, self.len) = ([0.0], 0);
    }

    /// It does not tell its size: this counts the spectra of weights and samples.
    fn bytes(&self) -> usize {
        2 * 16 * self.capacity + size_of::<Self>()
    }
}

impl Stateful for TwoStage {}
