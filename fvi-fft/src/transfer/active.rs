//! Regions in which a kernel is not passive.

use nalgebra::Complex;
use std::fmt;

/// Region in which a transfer function is not passive: Im K(iω)/ω < 0 in a band of angular frequencies, or,
/// if there is none, Re K(s)/s < 0 on a part of a ray into the right half-plane. If there are several, the
/// lowest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Active {
    /// s where K is least passive.
    pub place: Complex<f64>,
    /// Re (K(s)/s) |s|/|K(s)| there, in [−1, 0).
    pub resistance: f64,
    /// Lower bound of |s|; `None` if the region extends to the smallest |s| examined, 10⁻³⁰.
    pub from: Option<f64>,
    /// Upper bound of |s|; `None` if the region extends to the largest |s| examined, 10³⁰.
    pub to: Option<f64>,
}

impl fmt::Display for Active {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let on_axis = self.place.re == 0.0;
        let name = if on_axis { "ω" } else { "|s|" };
        match (self.from, self.to) {
            (Some(from), Some(to)) => write!(f, "{name} from {from:.4e} to {to:.4e}")?,
            (Some(from), None) => write!(f, "{name} above {from:.4e}")?,
            (None, Some(to)) => write!(f, "{name} below {to:.4e}")?,
            (None, None) => write!(f, "every {name}")?,
        }
        if on_axis {
            f.write_str(", where Im K(iω)/ω < 0")
        } else {
            write!(f, " with arg s = {:.0}°, where Re K(s)/s < 0", self.place.arg().to_degrees())
        }
    }
}
