//! Laws at the edges of their parameters.

mod tolerance;
