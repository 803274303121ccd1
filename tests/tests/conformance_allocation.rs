//! The real-time memory allocates in its constructor and never again.

use std::alloc::System;

use fvi_core::Memory;
use fvi_fft::{Pacing, RealTime};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

#[test]
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
