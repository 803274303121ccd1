//! Your own strategy in a race with those of the field:
//!
//!     cargo run --release -- race.toml out

mod two_stage;

use fvi_strategies::fvi_core::{Memory, MemoryError, Stateful, check_channels};
use fvi_strategies::{BuiltStrategy, Lab, LabError, Strategy};

/// The last 256 samples one by one, and those before as means of sixteen: O(N/16) a step, right for signals
/// that change slowly.
struct Coarse {
    weights: Vec<f64>,
    /// w_0 + … + w_{n−1}
    sums: Vec<f64>,
    samples: Vec<f64>,
    means: Vec<f64>,
}

const NEAR: usize = 256;
const GROUP: usize = 16;

impl Coarse {
    fn new(weights: &[f64]) -> Self {
        let mut sums = vec![0.0];
        sums.extend(weights.iter().scan(0.0, |sum, weight| {
            *sum += weight;
            Some(*sum)
        }));
        Self { weights: weights.to_vec(), sums, samples: Vec::new(), means: Vec::new() }
    }
}

impl Memory<f64> for Coarse {
    fn channels(&self) -> usize {
        1
    }

    fn leading(&self) -> &[f64] {
        &self.weights[..1]
    }

    fn len(&self) -> usize {
        self.samples.len()
    }

    #[inline(always)]
    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        check_channels(1, term.len())?;
        let k = self.samples.len();
        // Whole groups that lie NEAR or more behind; from the end of the last of them on, one by one.
        let groups = k.saturating_sub(NEAR) / GROUP;
        let near = k - groups * GROUP;
        let recent: f64 =
            self.samples[k - near..].iter().rev().zip(&self.weights[1..]).map(|(x, w)| x * w).sum();
        // The newest of these groups has the lags near + 1 … near + 16, the one before it the sixteen that
        // follow.
        let weight = |group: usize| {
            let first = near + 1 + group * GROUP;
            self.sums[first + GROUP] - self.sums[first]
        };
        let far: f64 =
            self.means[..groups].iter().rev().enumerate().map(|(group, x)| x * weight(group)).sum();
        term[0] = recent + far;
        Ok(())
    }

    #[inline(always)]
    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        check_channels(1, sample.len())?;
        if self.samples.len() == self.weights.len() {
            return Err(MemoryError::Full { capacity: self.weights.len() });
        }
        self.samples.push(sample[0]);
        if self.samples.len().is_multiple_of(GROUP) {
            let group = &self.samples[self.samples.len() - GROUP..];
            self.means.push(group.iter().sum::<f64>() / GROUP as f64);
        }
        Ok(())
    }

    fn clear(&mut self) {
        self.samples.clear();
        self.means.clear();
    }

    fn bytes(&self) -> usize {
        8 * [&self.weights, &self.sums, &self.samples, &self.means].map(Vec::capacity).iter().sum::<usize>()
    }
}

impl Stateful for Coarse {}

fn main() -> Result<(), LabError> {
    let mut arguments = std::env::args().skip(1);
    let file = arguments.next().unwrap_or_else(|| "race.toml".to_owned());
    let out = arguments.next().unwrap_or_else(|| "out".to_owned());
    let coarse = Strategy::new("coarse", "means of sixteen beyond 256 lags", |task| match task.channels {
        1 => Ok(BuiltStrategy::memory(Coarse::new(&task.weights))),
        _ => Err(fvi_strategies::Declined::SitsOut("it is for one channel".to_owned())),
    });
    let two_stage = Strategy::new("fft-convolver", "a partition in blocks of two sizes, of audio", |task| {
        match task.channels {
            1 => Ok(BuiltStrategy::memory(two_stage::TwoStage::new(&task.weights)?)),
            _ => Err(fvi_strategies::Declined::SitsOut("it is for one channel".to_owned())),
        }
    });
    let summary = Lab::new().with(coarse.without_bound()).with(two_stage).run(file.as_ref(), out.as_ref())?;
    println!("{summary}");
    Ok(())
}
