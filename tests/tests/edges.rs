//! Laws at the edges of their parameters.

mod creep;
mod poles;
mod tolerance;
