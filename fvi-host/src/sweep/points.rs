//! Which values the runs of a sweep have.

use super::axis::Axis;

/// How the runs are spread over the axes.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Sampling {
    /// Every combination; the last axis varies fastest.
    Grid,
    /// One run in each of `count` equal parts of every axis, paired at random.
    LatinHypercube { seed: u64, orders: Vec<Vec<u32>> },
    /// Sobol's points with Owen's scrambling.
    Sobol { seed: u64, count: usize },
}

/// Largest numbers of points of Sobol's sequence, and of axes, that the library supports.
pub(super) const MOST_SOBOL: usize = 1 << 16;
pub(super) const MOST_SOBOL_AXES: usize = sobol_burley::NUM_DIMENSIONS as usize;

impl Sampling {
    pub(super) fn latin_hypercube(axes: usize, count: usize, seed: u64) -> Self {
        let order = |axis: usize| {
            let mut order: Vec<u32> = (0..count as u32).collect();
            fastrand::Rng::with_seed(mixed(seed, axis as u64)).shuffle(&mut order);
            order
        };
        Self::LatinHypercube { seed, orders: (0..axes).map(order).collect() }
    }

    /// Number of runs; `None` if it overflows.
    pub(super) fn runs(&self, axes: &[Axis]) -> Option<usize> {
        match self {
            Self::Grid => axes.iter().try_fold(1_usize, |runs, axis| runs.checked_mul(axis.count())),
            Self::LatinHypercube { orders, .. } => Some(orders.first().map_or(0, Vec::len)),
            Self::Sobol { count, .. } => Some(*count),
        }
    }

    /// The values of a run, in the order of the axes.
    pub(super) fn values(&self, axes: &[Axis], run: usize) -> Vec<toml::Value> {
        match self {
            Self::Grid => {
                let mut rest = run;
                let mut values: Vec<toml::Value> = axes
                    .iter()
                    .rev()
                    .map(|axis| {
                        let index = rest % axis.count();
                        rest /= axis.count();
                        axis.value(index)
                    })
                    .collect();
                values.reverse();
                values
            }
            Self::LatinHypercube { seed, orders } => axes
                .iter()
                .zip(orders)
                .enumerate()
                .map(|(index, (axis, order))| {
                    let within =
                        fastrand::Rng::with_seed(mixed(mixed(!seed, index as u64), run as u64)).f64();
                    let part = order.get(run).copied().unwrap_or(0);
                    axis.at((f64::from(part) + within) / order.len() as f64)
                })
                .collect(),
            Self::Sobol { seed, .. } => {
                let seed = mixed(*seed, 0) as u32;
                let place = |dimension: usize| sobol_burley::sample(run as u32, dimension as u32, seed);
                axes.iter().enumerate().map(|(index, axis)| axis.at(f64::from(place(index)))).collect()
            }
        }
    }
}

/// Hash of two numbers.
fn mixed(a: u64, b: u64) -> u64 {
    fastrand::Rng::with_seed(a ^ b.wrapping_mul(0x9e37_79b9_7f4a_7c15)).u64(..)
}

#[cfg(test)]
mod tests {
    use super::super::axis::{Spacing, Values, number};
    use super::*;

    fn unit(path: &str, count: usize) -> Axis {
        let values = Values::Range { from: 0.0, to: 1.0, count, spacing: Spacing::Linear };
        Axis { path: path.to_owned(), values }
    }

    fn numbers(sampling: &Sampling, axes: &[Axis]) -> Vec<Vec<f64>> {
        let runs = sampling.runs(axes).unwrap();
        let row = |run| sampling.values(axes, run).iter().map(|value| number(value).unwrap()).collect();
        (0..runs).map(row).collect()
    }

    #[test]
    fn a_grid_is_every_combination_in_order() {
        let axes = [unit("a", 2), unit("b", 3)];
        let expected = [[0.0, 0.0], [0.0, 0.5], [0.0, 1.0], [1.0, 0.0], [1.0, 0.5], [1.0, 1.0]];
        assert_eq!(numbers(&Sampling::Grid, &axes), expected);
    }

    #[test]
    fn a_latin_hypercube_has_one_point_in_each_part_of_every_axis() {
        let axes = [unit("a", 2), unit("b", 2), unit("c", 2)];
        let rows = numbers(&Sampling::latin_hypercube(3, 40, 1), &axes);
        for axis in 0..3 {
            let mut parts: Vec<usize> = rows.iter().map(|row| (row[axis] * 40.0) as usize).collect();
            parts.sort_unstable();
            assert_eq!(parts, (0..40).collect::<Vec<_>>());
        }
        assert!(rows == numbers(&Sampling::latin_hypercube(3, 40, 1), &axes));
        assert!(rows != numbers(&Sampling::latin_hypercube(3, 40, 2), &axes));
    }

    #[test]
    fn sobol_points_fill_every_elementary_box_once() {
        let axes = [unit("a", 2), unit("b", 2)];
        let rows = numbers(&Sampling::Sobol { seed: 1, count: 64 }, &axes);
        for (columns, lines) in [(64, 1), (32, 2), (8, 8), (2, 32), (1, 64)] {
            let mut boxes: Vec<(usize, usize)> = rows
                .iter()
                .map(|row| ((row[0] * columns as f64) as usize, (row[1] * lines as f64) as usize))
                .collect();
            boxes.sort_unstable();
            boxes.dedup();
            assert_eq!(boxes.len(), 64, "{columns} × {lines}");
        }
    }
}
