//! Assignment of pairs of samples to levels of blocks.

/// Block sizes B₀ < B₁ < … of the levels, each a multiple of the one before.
///
/// The pair (k, j) of an output and an earlier input belongs
/// - to the *near* part if the B₀-blocks of k and j are at distance ≤ 1,
/// - otherwise to the coarsest level ℓ at which their blocks m, m′ are at distance ≥ 2.
///
/// Distance ≥ 2 at one level implies it at all finer ones, so level ℓ serves exactly the block pairs (m, m′)
/// with
///
/// ```text
/// m − m′ ≥ 2   and   ⌊m/r⌋ − ⌊m′/r⌋ ≤ 1 ,      r = B_{ℓ+1}/B_ℓ ,
/// ```
///
/// the last condition dropped at the top. A block pair at distance d has the lags ((d−1)B, (d+1)B): large
/// weights of short lags never share a transform with small ones of long lags, which would leave the latter
/// with the rounding errors of the former.
///
/// Source: \[HLS\], \[Gardner95\], \[Garcia02\], arranged for accuracy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Cover {
    blocks: Vec<usize>,
    /// Ratio to the level above the last one; `None` if the last level is the top.
    beyond: Option<usize>,
}

impl Cover {
    /// Levels from block size `first` up by the given ratios; the last is the top and serves all its
    /// distances.
    pub(crate) fn bounded(first: usize, ratios: &[usize]) -> Self {
        let mut blocks = vec![first];
        for ratio in ratios {
            blocks.push(blocks[blocks.len() - 1] * ratio);
        }
        Self { blocks, beyond: None }
    }

    /// Levels for a run of at most `capacity` samples: blocks grow by `ratio` until at most `top_blocks` hold
    /// the run.
    pub(crate) fn for_run(first: usize, ratio: usize, top_blocks: usize, capacity: usize) -> Self {
        let mut ratios = Vec::new();
        let mut block = first;
        while capacity.div_ceil(block) > top_blocks {
            ratios.push(ratio);
            block *= ratio;
        }
        Self::bounded(first, &ratios)
    }

    /// The level `first` alone, with a ratio to a later one above: for runs of unknown length.
    pub(crate) fn growing(first: usize, ratio: usize) -> Self {
        Self { blocks: vec![first], beyond: Some(ratio) }
    }

    /// Block size of a level.
    pub(crate) fn block(&self, level: usize) -> usize {
        self.blocks[level]
    }

    /// Number of samples before k that are in the near part for the outputs of k's chunk.
    pub(crate) fn near(&self, k: usize) -> usize {
        let block = self.blocks[0];
        k - (k / block).saturating_sub(1) * block
    }

    /// Number of levels.
    pub(crate) fn levels(&self) -> usize {
        self.blocks.len()
    }

    /// B_{ℓ+1}/B_ℓ, or `None` at the top.
    pub(crate) fn ratio(&self, level: usize) -> Option<usize> {
        match self.blocks.get(level + 1) {
            Some(above) => Some(above / self.blocks[level]),
            None => self.beyond,
        }
    }

    /// The input blocks from which this level contributes to output block `m`.
    pub(crate) fn inputs(&self, level: usize, m: usize) -> core::ops::Range<usize> {
        let first = match self.ratio(level) {
            Some(ratio) => ((m / ratio).saturating_sub(1)) * ratio,
            None => 0,
        };
        first..(m.saturating_sub(1)).max(first)
    }

    /// Largest distance at which this level ever serves a block pair, for outputs below `length`.
    pub(crate) fn reach(&self, level: usize, length: usize) -> usize {
        let last = length.div_ceil(self.blocks[level]).saturating_sub(1);
        match self.ratio(level) {
            Some(ratio) => last.min(2 * ratio - 1),
            None => last,
        }
    }

    /// Number of lags covered by the blocks of a run. The last ones may lie beyond the run and meet no
    /// sample; they are kept so that the spectra are bit-identical for every length of run.
    pub(crate) fn lags(&self, length: usize) -> usize {
        let ends = (0..self.levels()).map(|level| (self.reach(level, length), self.block(level)));
        let ends = ends.take_while(|&(reach, _)| reach >= 2).map(|(reach, block)| (reach + 1) * block);
        ends.fold(length.max(2 * self.block(0)), usize::max)
    }

    /// Floating-point operations of a run of `steps` steps of one channel with a kernel of plain numbers.
    ///
    /// A multiply–add counts two, a complex one eight, a transform of a block of B samples 5 B log₂ B: each
    /// block is transformed once, and each output block once back.
    pub(crate) fn operations(&self, steps: usize) -> f64 {
        let near: usize = (0..steps).map(|k| 2 * self.near(k)).sum();
        let mut operations = near as f64;
        for level in 0..self.levels() {
            let block = self.block(level);
            let transforms = 2 * 5 * block * block.trailing_zeros() as usize;
            for m in 2..steps.div_ceil(block) {
                operations += (transforms + 8 * block * self.inputs(level, m).len()) as f64;
            }
        }
        operations
    }

    /// Adds the level above the last one of a growing cover.
    pub(crate) fn grow(&mut self) {
        if let Some(ratio) = self.beyond {
            self.blocks.push(self.blocks[self.blocks.len() - 1] * ratio);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operations_are_those_of_the_near_part_and_of_every_block() {
        let cover = Cover::bounded(64, &[8]);
        let near: usize = (0..128).map(|k| 2 * k).sum();
        assert_eq!(cover.operations(128), near as f64);
        // One output block of 64, with one block two before it.
        let near = near + (128..192).map(|k| 2 * (k - 64)).sum::<usize>();
        assert_eq!(cover.operations(192), (near + 2 * 5 * 64 * 6 + 8 * 64) as f64);
        // Of the blocks of 512 the third is the first with a block two before it.
        let without = Cover::bounded(64, &[]).operations(1024);
        assert_eq!(cover.operations(1024), without);
        assert!(
            cover.operations(1025)
                < Cover::bounded(64, &[]).operations(1025) + 2.0 * 5.0 * 512.0 * 9.0 + 8.0 * 512.0
        );
    }

    /// The part that serves the pair (k, j): the near part, or a level.
    #[derive(Clone, Copy, Debug, PartialEq)]
    enum Server {
        Near,
        Level(usize),
    }

    /// By the definition: the coarsest level at which the blocks of k and j are two or more apart.
    fn server(cover: &Cover, k: usize, j: usize) -> Server {
        let apart = |&level: &usize| k / cover.block(level) - j / cover.block(level) >= 2;
        (0..cover.levels()).rev().find(apart).map_or(Server::Near, Server::Level)
    }

    /// All parts that serve each earlier sample j of the output k.
    fn servers(cover: &Cover, k: usize) -> Vec<Vec<Server>> {
        let mut servers = vec![Vec::new(); k];
        for servers in &mut servers[k - cover.near(k)..] {
            servers.push(Server::Near);
        }
        for level in 0..cover.levels() {
            let block = cover.block(level);
            for input in cover.inputs(level, k / block) {
                for servers in &mut servers[input * block..(input + 1) * block] {
                    servers.push(Server::Level(level));
                }
            }
        }
        servers
    }

    fn covers() -> [Cover; 6] {
        let mut growing = Cover::growing(4, 3);
        growing.grow();
        growing.grow();
        growing.grow();
        [
            Cover::bounded(4, &[]),
            Cover::bounded(4, &[2, 2, 2, 2]),
            Cover::bounded(2, &[4, 4, 4]),
            Cover::bounded(8, &[4, 2]),
            Cover::bounded(3, &[8, 16]),
            growing,
        ]
    }

    #[test]
    fn every_pair_of_samples_is_served_once_by_the_coarsest_level_that_keeps_its_blocks_apart() {
        for cover in covers() {
            for k in 0..300 {
                for (j, servers) in servers(&cover, k).iter().enumerate() {
                    assert_eq!(servers[..], [server(&cover, k, j)], "{cover:?}, k = {k}, j = {j}");
                }
            }
        }
    }

    #[test]
    fn lags_that_share_a_block_pair_differ_by_less_than_a_factor_of_three() {
        for cover in covers() {
            for level in 0..cover.levels() {
                let block = cover.block(level);
                for m in 0..100 {
                    for input in cover.inputs(level, m) {
                        let shortest = m * block - ((input + 1) * block - 1);
                        let longest = (m + 1) * block - 1 - input * block;
                        assert!(longest < 3 * shortest, "{cover:?}, level {level}: {shortest} to {longest}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_cover_for_a_run_has_as_few_levels_as_hold_it_in_so_many_blocks() {
        for (capacity, blocks) in
            [(1, vec![64]), (2048, vec![64]), (2049, vec![64, 512]), (16_385, vec![64, 512, 4096])]
        {
            assert_eq!(Cover::for_run(64, 8, 32, capacity).blocks, blocks, "{capacity} samples");
        }
    }

    #[test]
    fn the_reach_bounds_every_distance_used() {
        let cover = Cover::bounded(4, &[4, 2, 8]);
        for level in 0..cover.levels() {
            let mut largest = 0;
            for k in 0..2000 {
                let m = k / cover.block(level);
                largest = cover.inputs(level, m).map(|input| m - input).fold(largest, usize::max);
            }
            assert_eq!(largest, cover.reach(level, 2000));
        }
    }

    #[test]
    fn a_run_has_the_lags_of_its_blocks() {
        for cover in covers() {
            for length in [1, 9, 100, 333, 1000] {
                let mut lags = length.max(2 * cover.block(0));
                for k in 0..length {
                    for level in 0..cover.levels() {
                        let m = k / cover.block(level);
                        if let Some(first) = cover.inputs(level, m).next() {
                            lags = lags.max((m - first + 1) * cover.block(level));
                        }
                    }
                }
                assert_eq!(cover.lags(length), lags, "{cover:?}, {length}");
            }
        }
    }
}
