//! Laws at the edges of their parameters.

mod creep;
mod kernel_forms;
mod laws;
mod poles;
mod tolerance;
