//! A stream must not allocate: in a process of its own, whose allocator counts.

use std::alloc::System;

use fvi_fft::{Convolver, Responses, Stream};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// The allocator counts for all threads, so there is one, without the harness of tests and its own.
fn main() {
    let response = |rate: f32| -> Vec<f32> { (0..9000).map(|n| (-rate * n as f32).exp()).collect() };
    for block in [None, Some(64), Some(256)] {
        let stream = Stream { block, ..Stream::default() };
        let mut convolver = Convolver::new(&Responses::shared(&response(1e-3), 2).unwrap(), &stream).unwrap();
        let prepare = |rate| {
            let responses = Responses::shared(&response(rate), 2).unwrap();
            Some(convolver.preparer().prepare(&responses).unwrap())
        };
        let mut ready = [prepare(2e-3), prepare(3e-3)];
        let mut back = [const { None }; 2];
        let (input, mut output) = ([[0.25; 256]; 2], [[0.0; 256]; 2]);
        let region = Region::new(ALLOCATOR);
        for call in 0..400 {
            if call == 100 {
                convolver.exchange(ready[0].take().unwrap(), 1000).unwrap();
            } else if call == 200 {
                let exchanged = convolver.exchange_evenly(ready[1].take().unwrap(), 1000).unwrap();
                back[0] = exchanged.retired;
            }
            // Whole blocks, and calls across their ends.
            for part in if call < 300 { [0..256, 0..0, 0..0] } else { [0..1, 1..100, 100..256] } {
                let input: [&[f32]; 2] = core::array::from_fn(|channel| &input[channel][part.clone()]);
                let [first, second] = &mut output;
                convolver.process(&input, &mut [&mut first[part.clone()], &mut second[part]]).unwrap();
            }
        }
        back[1] = convolver.take_retired();
        let change = region.change();
        assert_eq!((change.allocations, change.deallocations, change.reallocations), (0, 0, 0), "{stream:?}");
        assert!(back.iter().all(Option::is_some));
    }
    println!("a stream and its exchanges neither allocate nor free: ok");
}
