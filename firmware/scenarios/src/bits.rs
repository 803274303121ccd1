//! Numbers as their bit patterns, for exact comparison.

use core::fmt;

use fvi_core::Real;

/// A scalar with access to its bits.
pub trait Bits: Real {
    /// Name of the scalar.
    const NAME: &'static str;

    /// The bits, most significant first.
    fn hexadecimal(self) -> Hexadecimal;
}

/// Bits of a number; displayed as hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hexadecimal {
    bits: u64,
    digits: usize,
}

impl fmt::Display for Hexadecimal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:0digits$x}", self.bits, digits = self.digits)
    }
}

impl Bits for f32 {
    const NAME: &'static str = "f32";

    fn hexadecimal(self) -> Hexadecimal {
        Hexadecimal { bits: u64::from(self.to_bits()), digits: 8 }
    }
}

impl Bits for f64 {
    const NAME: &'static str = "f64";

    fn hexadecimal(self) -> Hexadecimal {
        Hexadecimal { bits: self.to_bits(), digits: 16 }
    }
}
