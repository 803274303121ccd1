//! What allocates, how much, and what must not: in a process of their own, whose allocator counts.

use std::alloc::System;

use fvi_core::Memory;
use fvi_exhibits::two_point::{Closures, ExtremalProblem, Grid, Method, Sigma};
use fvi_fft::{Pacing, RealTime};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// The allocator counts for all threads, so there is one, without the harness of tests and its own.
fn main() {
    a_real_time_run_neither_allocates_nor_frees();
    sixteen_times_the_grid_allocates_about_sixteen_times_as_much();
    println!("allocations are what is promised: ok");
}

fn a_real_time_run_neither_allocates_nor_frees() {
    let kernel = |first: usize, weights: &mut [f64]| {
        for (n, weight) in (first..).zip(weights) {
            *weight = 1.0 / (1.0 + n as f64);
        }
    };
    let mut memory = RealTime::planned(kernel, 2, 40_000, Pacing::Paced).unwrap();
    let mut term = [0.0; 2];
    let region = Region::new(ALLOCATOR);
    for run in 0..2 {
        for k in 0..40_000 {
            memory.next_term(&mut term).unwrap();
            memory.push(&[k as f64, term[0]]).unwrap();
        }
        assert!(memory.next_term(&mut term).is_err(), "run {run} is full");
        memory.clear();
    }
    let change = region.change();
    assert_eq!((change.allocations, change.deallocations, change.reallocations), (0, 0, 0));
}

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

fn sixteen_times_the_grid_allocates_about_sixteen_times_as_much() {
    let (small, large) = (allocated(4096), allocated(65_536));
    let ratio = large as f64 / small as f64;
    assert!((12.0..20.0).contains(&ratio), "{small} and {large} bytes");
    // All vectors of all iterations together; one dense matrix would take 34 GB.
    assert!(large < 65_536 * 8 * 1000, "{large} bytes");
}
