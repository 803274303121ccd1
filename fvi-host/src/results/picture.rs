//! Pictures: charts as SVG, and traces that keep long runs drawable.

mod axis;
mod chart;
mod trace;

pub use axis::{Axis, Scale};
pub use chart::{Chart, Marker, PictureError, Series, Style};
pub use trace::{Envelope, PathTrace};
