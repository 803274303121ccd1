//! Values and slopes between the times of a grid.

use fvi_scenario::scenario::TimeGrid;

/// Number of grid points of the polynomial that interpolates a motion.
const POINTS: usize = 6;

/// Number of grid points of the polynomial of lower degree for the error estimate.
const FEWER: usize = 4;

/// A time within this fraction of a step from a grid time counts as that grid time.
const SAME: f64 = 1e-9;

/// A value or slope at a time as a weighted sum over consecutive grid points.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stencil {
    /// The first grid point.
    pub(super) first: usize,
    /// Weights of this grid point and the following ones.
    pub(super) shares: Vec<f64>,
    /// Weights of the polynomial of lower degree; the difference of the two sums estimates the interpolation
    /// error. Empty at a grid time itself.
    pub(super) lower: Vec<f64>,
}

/// What a stencil gives: the value or the derivative with respect to time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sought {
    Value,
    Slope,
}

impl Stencil {
    /// The polynomial through the nearest grid points, at a time from 0 to the last one.
    pub(super) fn new(grid: &TimeGrid, time: f64, of: Sought) -> Self {
        let count = grid.steps + 1;
        let after = partition(count, |index| grid.time(index) < time);
        let near = [after.saturating_sub(1), after.min(grid.steps)];
        let distance = |index: usize| (grid.time(index) - time).abs();
        let nearest = if distance(near[0]) <= distance(near[1]) { near[0] } else { near[1] };
        let step = (grid.time(near[1]) - grid.time(near[0])).abs();
        let is_there = distance(nearest) <= SAME * step || distance(nearest) == 0.0;
        if of == Sought::Value && (is_there || count == 1) {
            return Self { first: nearest, shares: vec![1.0], lower: Vec::new() };
        }
        let points = POINTS.min(count);
        let first = nearest_points(after, points, count);
        let shares = polynomial(grid, first, points, time, of);
        let fewer = FEWER.min(points);
        let inner = nearest_points(after, fewer, count);
        let mut lower = vec![0.0; points];
        for (share, place) in polynomial(grid, inner, fewer, time, of).into_iter().zip(inner - first..) {
            lower[place] = share;
        }
        Self { first, shares, lower }
    }

    /// The last grid point.
    pub(super) fn last(&self) -> usize {
        self.first + self.shares.len() - 1
    }
}

/// Number of indices in 0..`count` for which `is_before` holds; it holds for the first ones and fails for the
/// rest.
fn partition(count: usize, is_before: impl Fn(usize) -> bool) -> usize {
    let (mut low, mut high) = (0, count);
    while low < high {
        let middle = low + (high - low) / 2;
        if is_before(middle) { low = middle + 1 } else { high = middle }
    }
    low
}

/// The first of `points` consecutive grid points centred about the interval that ends at grid point `after`,
/// of `count` grid points in all.
fn nearest_points(after: usize, points: usize, count: usize) -> usize {
    after.saturating_sub(points / 2).min(count - points)
}

/// Weights of grid points in the value or slope of the polynomial through them (Lagrange).
fn polynomial(grid: &TimeGrid, first: usize, points: usize, time: f64, of: Sought) -> Vec<f64> {
    let times: Vec<f64> = (first..first + points).map(|index| grid.time(index)).collect();
    let share = |i: usize| {
        let others = || (0..points).filter(move |&j| j != i);
        let factor = |j: usize| (time - times[j]) / (times[i] - times[j]);
        match of {
            Sought::Value => others().map(factor).product::<f64>(),
            Sought::Slope => others()
                .map(|k| {
                    let rest: f64 = others().filter(|&j| j != k).map(factor).product();
                    rest / (times[i] - times[k])
                })
                .sum(),
        }
    };
    (0..points).map(share).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_scenario::scenario::Scenario;

    fn grid(time: serde_json::Value) -> TimeGrid {
        let scenario = serde_json::json!({
            "system": { "mass": [1.0], "potential": "0.5*q0^2" },
            "initial": { "position": [1.0], "momentum": [0.0] },
            "convolution": { "family": "radau-iia", "stages": 2 },
            "scheme": { "kind": "galerkin", "degree": 1 },
            "time": time,
        });
        Scenario::from_value(&scenario).unwrap().time
    }

    fn told(stencil: &Stencil, shares: &[f64], grid: &TimeGrid, f: impl Fn(f64) -> f64) -> f64 {
        shares.iter().zip(stencil.first..).map(|(share, index)| share * f(grid.time(index))).sum()
    }

    #[test]
    fn polynomials_of_degree_five_are_met() {
        let grids = [
            grid(serde_json::json!({ "step": 0.1, "steps": 20 })),
            grid(serde_json::json!({ "grid": "graded", "end": 2.0, "steps": 20, "exponent": 2.0 })),
        ];
        let f = |t: f64| t.powi(5) - 2.0 * t.powi(3) + 0.5;
        let slope = |t: f64| 5.0 * t.powi(4) - 6.0 * t.powi(2);
        for grid in &grids {
            for time in [0.0, 0.013, 0.1, 0.55, 1.23456, 1.999, grid.end()] {
                let value = Stencil::new(grid, time, Sought::Value);
                assert!((told(&value, &value.shares, grid, f) - f(time)).abs() < 1e-11, "{time}");
                let change = Stencil::new(grid, time, Sought::Slope);
                let found = told(&change, &change.shares, grid, f);
                assert!((found - slope(time)).abs() < 1e-9, "{time}: {found}");
                assert!(change.last() <= grid.steps && value.last() <= grid.steps);
            }
        }
    }

    #[test]
    fn a_grid_time_stands_for_itself() {
        let grid = grid(serde_json::json!({ "step": 0.1, "steps": 20 }));
        let found = Stencil::new(&grid, 0.3, Sought::Value);
        assert_eq!(found, Stencil { first: 3, shares: vec![1.0], lower: Vec::new() });
    }

    #[test]
    fn short_runs_take_what_points_they_have() {
        let grid = grid(serde_json::json!({ "step": 0.1, "steps": 2 }));
        let found = Stencil::new(&grid, 0.15, Sought::Value);
        let value = told(&found, &found.shares, &grid, |t| t * t);
        assert!((value - 0.0225).abs() < 1e-15, "{value}");
    }
}
