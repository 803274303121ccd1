//! Benchmarks of fvi; see the files in `benches/`.
