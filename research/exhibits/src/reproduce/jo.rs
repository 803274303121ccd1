//! \[JO\]: figures 4 to 7, the ones with numbers.

mod lagrange_dalembert;
mod oscillator;
mod plate;

use super::Exhibit;

pub(super) const EXHIBITS: [Exhibit; 4] = [
    Exhibit::printed("JO", "jo-fig-4", "Fig. 4", "the oscillator for several α", oscillator::figure_4),
    Exhibit::printed(
        "JO",
        "jo-fig-5",
        "Fig. 5",
        "positions and momenta of the linearly damped oscillator",
        oscillator::figure_5,
    ),
    Exhibit::printed(
        "JO",
        "jo-fig-6",
        "Fig. 6",
        "energy of the linearly damped oscillator",
        oscillator::figure_6,
    ),
    Exhibit::printed(
        "JO",
        "jo-fig-7",
        "Fig. 7",
        "the plate under a pulse against Podlubny's matrix method",
        plate::figure_7,
    ),
];
