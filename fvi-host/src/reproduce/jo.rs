//! \[JO\]: figures 4 to 7, the ones with numbers.

mod lagrange_dalembert;
mod oscillator;
mod plate;

use super::{Exhibit, Findings, Origin, ReproduceError};
use std::sync::atomic::AtomicBool;

const fn exhibit(
    name: &'static str,
    number: &'static str,
    title: &'static str,
    compute: fn(&AtomicBool) -> Result<Findings, ReproduceError>,
) -> Exhibit {
    Exhibit { name, origin: Origin::Printed { paper: "JO", number }, title, compute }
}

pub(super) const EXHIBITS: [Exhibit; 4] = [
    exhibit("jo-fig-4", "Fig. 4", "the oscillator for several α", oscillator::figure_4),
    exhibit(
        "jo-fig-5",
        "Fig. 5",
        "positions and momenta of the linearly damped oscillator",
        oscillator::figure_5,
    ),
    exhibit("jo-fig-6", "Fig. 6", "energy of the linearly damped oscillator", oscillator::figure_6),
    exhibit(
        "jo-fig-7",
        "Fig. 7",
        "the plate under a pulse against Podlubny's matrix method",
        plate::figure_7,
    ),
];
