//! Fast-Fourier-transform memories for fractional variational integrators.
#![forbid(unsafe_code)]
