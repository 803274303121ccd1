//! The program `fvi`.
fn main() {}
