//! Division of a response into a near part and stages of blocks, by a model of the cost.

use fvi_core::ParameterError;

use crate::engines::scalar::Scalar;
use crate::engines::stream::responses::Responses;

/// What is known about a stream before it begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stream {
    /// Samples by which outputs come later than by the definition: y(k) is the value for k − latency. With a
    /// latency of the length of a block nothing needs to be summed directly.
    pub latency: usize,
    /// Samples of a call, if all have as many, and begin at a multiple. Other calls remain possible, but may
    /// cost more.
    pub block: Option<usize>,
    /// Samples of the longest response that will be exchanged for the present ones, if it is longer.
    pub longest: usize,
}

/// Largest latency, in samples.
const LARGEST_LATENCY: usize = 1 << 24;

/// The near part and the stages of a convolver.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Partition {
    /// Samples of a block of the near part and of the finest stage.
    pub(crate) first: usize,
    /// True if the finest stage does the whole work of a block at once when it has come.
    pub(crate) at_once: bool,
    /// The stages, finest first; there may be none.
    pub(crate) stages: Vec<StagePlan>,
    /// Lags covered: the longest response with the latency before it.
    pub(crate) lags: usize,
    pub(crate) latency: usize,
    pub(crate) grain: Grain,
}

/// Size of the tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Grain {
    /// Largest leaf of the transforms.
    pub(crate) leaf: usize,
    /// Butterflies in a piece of a pass.
    pub(crate) piece: usize,
    /// Packets of a spectrum per task of products.
    pub(crate) tile: usize,
}

/// For calls of a few samples: a task costs about as much as a sample.
const FINE: Grain = Grain { leaf: 32, piece: 16, tile: 2 };
/// Otherwise.
const COARSE: Grain = Grain { leaf: 256, piece: 64, tile: 8 };
/// Samples of a call from which tasks are coarse.
const COARSE_FROM: usize = 16;

/// A stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct StagePlan {
    /// Samples of a block, B.
    pub(crate) block: usize,
    /// Shortest block distance that it serves: 0 at once, 2 if the work is spread.
    pub(crate) nearest: usize,
    /// Largest block distance.
    pub(crate) reach: usize,
    /// Block size of the next stage in blocks, or `None` at the top.
    pub(crate) ratio: Option<usize>,
}

impl StagePlan {
    /// The input blocks from which this stage contributes to output block m, those at distance `nearest` and
    /// more: all that no coarser stage serves.
    pub(crate) fn inputs(&self, output: u64, nearest: usize) -> core::ops::Range<u64> {
        let of_stage = match self.ratio {
            Some(ratio) => (output / ratio as u64).saturating_sub(1) * ratio as u64,
            None => 0,
        };
        let first = of_stage.max(output.saturating_sub(self.reach as u64));
        first..(output + 1).saturating_sub(nearest as u64).max(first)
    }

    /// Largest number of input blocks of an output.
    pub(crate) fn most_inputs(&self) -> usize {
        (self.reach + 1).saturating_sub(self.nearest)
    }
}

/// Block sizes with which the finest stage may begin.
const FIRST: core::ops::RangeInclusive<u32> = 4..=12;
/// Ratios of the blocks of neighbouring stages.
const RATIOS: [usize; 3] = [2, 4, 8];

/// Nanoseconds on a processor of 2023 with vectors of 512 bits, for double precision; what counts is their
/// ratio. `cargo bench -p fvi-benches --bench convolver` shows how near the choice is to the best.
struct Cost {
    /// Of a lag of the near part, per sample.
    tap: f64,
    /// Of a block pair, per sample.
    product: f64,
    /// Of a transform, per sample.
    transform: f64,
    /// The same, for each doubling of the block.
    doubling: f64,
}

const COST: Cost = Cost { tap: 0.06, product: 0.2, transform: 1.5, doubling: 0.35 };

/// How many inputs, outputs, and pairs with a response.
struct Count {
    inputs: f64,
    outputs: f64,
    paths: f64,
}

/// Cost of the stages from one on, and the ratios of those above it.
#[derive(Clone)]
struct Best {
    cost: f64,
    ratios: Vec<usize>,
}

impl Count {
    /// Cost of a sample in a stage with a number of block pairs.
    fn stage(&self, block: usize, pairs: f64) -> f64 {
        let transform = COST.transform + COST.doubling * f64::from(block.trailing_zeros());
        (self.inputs + self.outputs) * transform + self.paths * pairs * COST.product
    }

    /// The best ratios for stages from blocks of 2^e samples on, for each e, for the given number of lags.
    fn best(&self, lags: usize) -> Vec<Best> {
        let top = lags.next_power_of_two().trailing_zeros().max(*FIRST.end());
        let mut best: Vec<Option<Best>> = vec![None; top as usize + 1];
        for e in (*FIRST.start()..=top).rev() {
            let block = 1usize << e;
            let reach = reach(block, lags);
            if reach < 2 {
                best[e as usize] = Some(Best { cost: 0.0, ratios: Vec::new() });
                continue;
            }
            let mut chosen = Best { cost: self.stage(block, (reach - 1) as f64), ratios: Vec::new() };
            for ratio in RATIOS {
                let above = best.get((e + ratio.trailing_zeros()) as usize).cloned().flatten();
                let Some(above) = above.filter(|_| self::reach(block * ratio, lags) >= 2) else { continue };
                let cost = self.stage(block, 1.5 * (ratio - 1) as f64) + above.cost;
                if cost < chosen.cost {
                    let ratios = [&[ratio], &*above.ratios].concat();
                    chosen = Best { cost, ratios };
                }
            }
            best[e as usize] = Some(chosen);
        }
        let none = Best { cost: 0.0, ratios: Vec::new() };
        best.into_iter().map(|best| best.unwrap_or(none.clone())).collect()
    }
}

/// Largest distance at which two blocks have a pair of samples with one of the lags.
fn reach(block: usize, lags: usize) -> usize {
    (lags - 1).div_ceil(block)
}

impl Partition {
    /// The cheapest partition for the responses and the stream.
    pub(crate) fn new<T: Scalar>(responses: &Responses<T>, stream: &Stream) -> Result<Self, ParameterError> {
        let &Stream { latency, block, longest } = stream;
        let refused = |parameter, value: usize, allowed| {
            Err(ParameterError { parameter, value: value as f64, allowed })
        };
        if latency > LARGEST_LATENCY {
            return refused("latency", latency, "at most 16777216 samples");
        }
        if block == Some(0) {
            return refused("block", 0, "at least 1");
        }
        if longest > 1 << 28 {
            return refused("longest", longest, "at most 268435456 samples");
        }
        let lags = responses.longest().max(longest) + latency;
        let count = Count {
            inputs: responses.inputs() as f64,
            outputs: responses.outputs() as f64,
            paths: responses.paths().len() as f64,
        };
        let best = count.best(lags);
        let mut chosen: Option<(f64, Self)> = None;
        let grain = if block.is_some_and(|block| block >= COARSE_FROM) { COARSE } else { FINE };
        for e in FIRST {
            let first = 1usize << e;
            for at_once in [false, true] {
                if at_once && !block.is_some_and(|block| block.is_multiple_of(first)) {
                    continue;
                }
                let (cost, ratios) = count.beginning(first, at_once, lags, latency, &best);
                if chosen.as_ref().is_none_or(|(least, _)| cost < *least) {
                    let stages = stages(first, at_once, &ratios, lags);
                    chosen = Some((cost, Self { first, at_once, stages, lags, latency, grain }));
                }
            }
        }
        match chosen {
            Some((_, partition)) => Ok(partition),
            None => refused("latency", latency, "a number of samples"),
        }
    }

    /// Samples of history that the stages and the near part read.
    pub(crate) fn history(&self) -> usize {
        self.stages.last().map_or(2 * self.first, |top| (top.reach + 2) * top.block)
    }

    /// Samples of a block of the coarsest stage.
    pub(crate) fn top(&self) -> usize {
        self.stages.last().map_or(self.first, |top| top.block)
    }
}

impl Count {
    /// Cost of a sample, and ratios of the stages, if the finest begins with blocks of `first`.
    fn beginning(
        &self,
        first: usize,
        at_once: bool,
        lags: usize,
        latency: usize,
        best: &[Best],
    ) -> (f64, Vec<usize>) {
        let above = &best[first.trailing_zeros() as usize];
        if !at_once {
            // Between one and two blocks, as far as there are weights.
            let taps = |lag: f64| (lag.min(lags as f64) - latency as f64).max(0.0);
            let (least, most) = (taps(first as f64), taps(2.0 * first as f64));
            return (self.paths * COST.tap * 0.5 * (least + most) + above.cost, above.ratios.clone());
        }
        let reach = reach(first, lags);
        let mut chosen = (self.stage(first, (reach + 1) as f64), Vec::new());
        for ratio in RATIOS {
            let exponent = (first * ratio).trailing_zeros() as usize;
            let Some(above) = best.get(exponent).filter(|_| self::reach(first * ratio, lags) >= 2) else {
                continue;
            };
            let cost = self.stage(first, 1.5 * (ratio - 1) as f64 + 2.0) + above.cost;
            if cost < chosen.0 {
                chosen = (cost, [&[ratio], &*above.ratios].concat());
            }
        }
        chosen
    }
}

/// The stages with the given ratios.
fn stages(first: usize, at_once: bool, ratios: &[usize], lags: usize) -> Vec<StagePlan> {
    let mut block = first;
    let mut stages = Vec::new();
    for place in 0..=ratios.len() {
        let ratio = ratios.get(place).copied();
        let nearest = if at_once && place == 0 { 0 } else { 2 };
        let reach = reach(block, lags).min(ratio.map_or(usize::MAX, |ratio| 2 * ratio - 1));
        if reach < nearest {
            break;
        }
        stages.push(StagePlan { block, nearest, reach, ratio });
        block *= ratio.unwrap_or(1);
    }
    stages
}

#[cfg(test)]
mod tests {
    use super::*;

    fn partitions() -> Vec<Partition> {
        let mut found = Vec::new();
        for lags in [1, 2, 17, 33, 100, 480, 4800, 20_000] {
            let responses = Responses::one(&vec![1.0; lags]).unwrap();
            for block in [None, Some(1), Some(48), Some(64), Some(1024)] {
                for latency in [0, 1, 40, 64, 1024] {
                    let stream = Stream { latency, block, longest: 0 };
                    found.push(Partition::new(&responses, &stream).unwrap());
                }
            }
        }
        found
    }

    /// How often a pair of an output k and an input k − lag is served.
    fn services(partition: &Partition, k: u64, lag: u64) -> usize {
        let (first, j) = (partition.first as u64, k - lag);
        let near = match partition.at_once {
            true => false,
            false => k / first - j / first < 2,
        };
        let stages = partition.stages.iter().filter(|stage| {
            let block = stage.block as u64;
            stage.inputs(k / block, stage.nearest).contains(&(j / block))
        });
        usize::from(near) + stages.count()
    }

    #[test]
    fn every_lag_of_a_response_is_served_once_and_no_sample_is_served_twice() {
        for partition in partitions() {
            for k in [0, 1, 63, 64, 1000, 30_011, 40_960, 65_535] {
                for lag in (0..=k.min(3 * partition.lags as u64)).step_by(7) {
                    let served = services(&partition, k, lag);
                    let expected = usize::from(lag < partition.lags as u64);
                    // Blocks that reach beyond the last lag meet weights of zero there.
                    let beyond = lag >= partition.lags as u64 && served <= 1;
                    assert!(served == expected || beyond, "{partition:?}, {k}, {lag}: {served}");
                }
            }
        }
    }

    #[test]
    fn a_latency_of_two_blocks_leaves_nothing_to_sum_directly() {
        let responses = Responses::one(&vec![1.0; 48_000]).unwrap();
        let stream = Stream { latency: 1024, ..Stream::default() };
        let partition = Partition::new(&responses, &stream).unwrap();
        assert_eq!((partition.at_once, partition.lags), (false, 49_024));
        assert!((256..=512).contains(&partition.first), "{}", partition.first);
    }

    #[test]
    fn what_is_known_of_a_stream_is_checked() {
        let responses = Responses::one(&[1.0]).unwrap();
        let refused = |stream| Partition::new(&responses, &stream).unwrap_err().parameter;
        assert_eq!(refused(Stream { latency: usize::MAX, ..Stream::default() }), "latency");
        assert_eq!(refused(Stream { block: Some(0), ..Stream::default() }), "block");
        assert_eq!(refused(Stream { longest: usize::MAX, ..Stream::default() }), "longest");
    }
}
