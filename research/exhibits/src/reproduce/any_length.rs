//! Steps of any length: singular starts, decades of time, steps chosen by a tolerance.

mod decades;
mod problems;
mod released;
mod singular;
mod tolerances;
mod work;

use super::Exhibit;

pub(super) const EXHIBITS: [Exhibit; 6] = [
    Exhibit::beyond(
        "any-length-singular",
        "the solution t^(5/2) on graded steps, on equal ones, and with starting weights",
        singular::exhibit,
    ),
    Exhibit::beyond("any-length-released", "motions let go from rest, in Caputo's sense", released::exhibit),
    Exhibit::beyond("any-length-decades", "relaxation over seventeen decades of time", decades::exhibit),
    Exhibit::beyond(
        "any-length-tolerances",
        "errors of steps that are chosen on the way, and their work beside the best grids",
        tolerances::exhibit,
    ),
    Exhibit::beyond(
        "work-precision-root",
        "error against work, the solution t^(5/2): steps of any length against equal ones",
        work::root,
    ),
    Exhibit::beyond(
        "work-precision-released",
        "error against work, an oscillator let go: steps of any length against equal ones",
        work::released,
    ),
];
