//! Pictures: charts as SVG, and traces that bound the amount of data of long runs.

mod axis;
mod chart;
mod colour_map;
mod map;

pub use crate::results::trace::{Envelope, PathTrace};
pub use axis::{Axis, Scale, power};
pub use chart::{Chart, Marker, PictureError, Series, Style};
pub use colour_map::ColourMap;
pub use map::Map;
