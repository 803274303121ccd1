//! The matrix-free solver's memory grows like the grid.

use fvi_host::lab::two_point::{Closures, ExtremalProblem, Grid, Method, Sigma};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Bytes allocated in all, freed ones counted again with each allocation: an upper bound of the peak.
fn allocated(steps: usize) -> usize {
    let quadratic = Closures::new(
        1,
        |_t, x: &[f64], v: &[f64]| 0.5 * (v[0] * v[0] + x[0] * x[0]),
        |_t, x: &[f64], v: &[f64], out: &mut [f64]| out.copy_from_slice(&[x[0], v[0]]),
        |_t, _x: &[f64], _v: &[f64], out: &mut [f64]| out.copy_from_slice(&[1.0, 0.0, 0.0, 1.0]),
    );
    let grid = Grid::new(0.0, 1.0, steps).unwrap();
    let region = Region::new(ALLOCATOR);
    let problem = ExtremalProblem::new(&quadratic, grid, Sigma::Minus, 0.7, &[0.5], &[1.0]).unwrap();
    let extremal = problem.with_method(Method::Krylov).solve().unwrap();
    assert!(extremal.krylov_iterations > 5);
    region.change().bytes_allocated
}

#[test]
fn sixteen_times_the_grid_allocates_about_sixteen_times_as_much() {
    let (small, large) = (allocated(4096), allocated(65_536));
    let ratio = large as f64 / small as f64;
    assert!((12.0..20.0).contains(&ratio), "{small} and {large} bytes");
    // All vectors of all iterations together; one dense matrix would take 34 GB.
    assert!(large < 65_536 * 8 * 1000, "{large} bytes");
}
