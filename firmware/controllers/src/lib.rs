//! Controllers whose costs are measured: a PID controller and a fractional one, both with a filter of the
//! derivative, limits of output and rate, and back-calculation, for any number of ticks of a millisecond.
#![no_std]

/// Orders 1.
pub mod integer {
    include!(concat!(env!("OUT_DIR"), "/integer.rs"));
}

/// λ = 0.9, μ = 0.8; tables within 1 % from 0.005 to 500 Hz.
pub mod band {
    include!(concat!(env!("OUT_DIR"), "/band.rs"));
}

/// The same in whole numbers, of 10⁻⁴ for inputs and 10⁻³ for the output.
pub mod whole {
    include!(concat!(env!("OUT_DIR"), "/whole.rs"));
}

/// λ = 0.9, μ = 0.8; tables for every lag, within 10⁻⁷.
pub mod fractional {
    include!(concat!(env!("OUT_DIR"), "/fractional.rs"));
}
