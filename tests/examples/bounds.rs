//! Prints the bounds of the engines as rows of a table.

use fvi_fft::memory::Engine;
use fvi_tests::conformance::Bound;

fn main() {
    let engines = [
        ("direct", Engine::Direct),
        ("block-fft", Engine::BlockFft),
        ("real-time", Engine::RealTime),
        ("exponential-sum", Engine::ExponentialSum),
        ("exponential-sum-core", Engine::ExponentialSumCore),
    ];
    let bounds = engines.map(|(name, engine)| (name, Bound::of(engine)));
    for (name, Bound { steady, changing }) in bounds.into_iter().chain([("tiled", Bound::TILED)]) {
        println!("| `{name}` | {steady} | {changing} |");
    }
}
