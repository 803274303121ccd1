//! The sampled plant over a grid of frequencies, computed once for all laws that a search tries.

use super::law::Law;
use super::margins::{Loop, Margins, margins};
use super::plant::Plant;
use super::sampled::{band, difference, held_plant, sampled_loop};
use fvi_simulation::simulation::closed_loop::{Contour, growing_motions_open};
use nalgebra::Complex;
use std::f64::consts::PI;

/// Logarithm of the ratio of neighbouring frequencies, near the frequencies that matter and far below them.
const SPACING: f64 = 0.03;
const SPACING_BELOW: f64 = 0.15;

/// Distance in ln ω below which the wider spacing begins.
const NEAR: f64 = 9.0;

/// Largest change of phase and of ln |G| between neighbours.
const TURN: f64 = 0.2;
const STRETCH: f64 = 0.35;

/// Largest number of bisections of an interval in which the plant changes quickly.
const HALVINGS: u32 = 28;

/// Number of points that a dead time may need; above the frequency up to which they suffice bounds are
/// required for any phase of L.
const MOST_FOR_DEAD_TIME: f64 = 1000.0;

/// Number of pieces of the arc around s = 0.
const ARC: usize = 12;

/// True if |L| at a low frequency, compared with a higher one, seems to grow without bound as ω → 0.
pub(super) fn is_rising(low: f64, high: f64) -> bool {
    low > 1.02 * high
}

/// The sampled plant at one frequency.
#[derive(Clone, Copy, Debug)]
pub(super) struct SampledPoint {
    /// ω.
    pub omega: f64,
    /// (1 − e^{−iωh})/h, in which the sampled law is a function.
    pub difference: Complex<f64>,
    /// G(e^{iωh}).
    pub plant: Complex<f64>,
    /// True if the dead time turns the phase between neighbours too often.
    pub any_phase: bool,
    /// The same two beside the axis, where the plant has no poles.
    beside: [Complex<f64>; 2],
}

/// A sampled plant over its grid.
pub(super) struct SampledPlant<'a> {
    pub plant: &'a Plant,
    pub sample: f64,
    /// Ascending frequencies up to π/h.
    pub points: Vec<SampledPoint>,
    /// Difference and plant on the arc from the positive axis to the first frequency.
    arc: Vec<[Complex<f64>; 2]>,
    /// Growing motions of the plant itself.
    own: usize,
    shift: f64,
}

impl<'a> SampledPlant<'a> {
    /// The grid about a frequency, with further frequencies in it.
    ///
    /// # Errors
    /// A sentence, where the plant has no value or its growing motions cannot be counted.
    pub(super) fn new(plant: &'a Plant, sample: f64, about: f64, further: &[f64]) -> Result<Self, String> {
        let least = about.min(plant.scale());
        let (lowest, highest) = (1e-7 * least, band(sample));
        let shift = 1e-8 * least;
        let contour = Contour {
            lowest,
            highest: 1e4 * about.max(plant.scale()),
            crossing: lowest,
            dead_time: 0.0,
            shift,
        };
        let own = growing_motions_open(&contour, &|s| plant.at(s))
            .map_err(|reason| format!("of the plant alone, {reason}"))?;
        let mut grid = Self { plant, sample, points: Vec::new(), arc: Vec::new(), own, shift };
        for index in 0..=ARC {
            let angle = 0.5 * PI * index as f64 / ARC as f64;
            let s = Complex::new(libm::cos(angle), libm::sin(angle)) * lowest + shift;
            let place = held_plant(plant, s, sample).map(|value| [difference(s, sample), value]);
            grid.arc.push(place.ok_or_else(|| format!("the plant has no value at s = {s:e}"))?);
        }
        let turning = MOST_FOR_DEAD_TIME * TURN / plant.dead_time();
        let mut omega = lowest;
        let mut frequencies: Vec<f64> = further.iter().copied().filter(|omega| *omega < highest).collect();
        while omega < highest {
            frequencies.push(omega);
            let mut ratio = if omega < least * libm::exp(-NEAR) { SPACING_BELOW } else { SPACING };
            if omega < turning {
                ratio = ratio.min(TURN / (plant.dead_time() * omega));
            }
            omega *= libm::exp(ratio);
        }
        frequencies.push(highest);
        frequencies.sort_by(f64::total_cmp);
        frequencies.dedup();
        let mut last: Option<SampledPoint> = None;
        for omega in frequencies {
            // On a pole of the plant there is no value, but beside it.
            let next = grid.point(omega, omega > turning);
            let next = next.or_else(|| grid.point(omega * (1.0 - 1e-9), omega > turning));
            let next = next.ok_or_else(|| format!("the loop gain is not a number at ω = {omega:e}"))?;
            if let Some(last) = last {
                grid.refine(last, next, HALVINGS);
            } else {
                grid.points.push(next);
            }
            last = Some(next);
        }
        if grid.points.len() < 2 {
            return Err(format!("the plant has no values between ω = {lowest:e} and {highest:e}"));
        }
        Ok(grid)
    }

    fn point(&self, omega: f64, any_phase: bool) -> Option<SampledPoint> {
        let (on, beside) = (Complex::new(0.0, omega), Complex::new(self.shift, omega));
        let held = |s| held_plant(self.plant, s, self.sample).filter(|value| value.norm().is_finite());
        Some(SampledPoint {
            omega,
            difference: difference(on, self.sample),
            plant: held(on)?,
            any_phase,
            beside: [difference(beside, self.sample), held(beside)?],
        })
    }

    /// Adds points between two points, and the second one.
    fn refine(&mut self, left: SampledPoint, right: SampledPoint, halvings: u32) {
        let ratio = right.beside[1] / left.beside[1];
        let turned = libm::atan2(ratio.im, ratio.re).abs();
        let changes = turned > TURN || libm::log(ratio.norm()).abs() > STRETCH;
        if changes && halvings > 0 && !right.any_phase {
            let omega = libm::sqrt(left.omega * right.omega);
            if let Some(middle) =
                self.point(omega, false).filter(|_| left.omega < omega && omega < right.omega)
            {
                self.refine(left, middle, halvings - 1);
                return self.refine(middle, right, halvings - 1);
            }
        }
        self.points.push(right);
    }

    /// G at a frequency.
    pub(super) fn held(&self, omega: f64) -> Option<Complex<f64>> {
        held_plant(self.plant, Complex::new(0.0, omega), self.sample)
    }

    /// L of the sampled loop at a frequency.
    pub(super) fn open(&self, law: &Law, omega: f64) -> Option<Complex<f64>> {
        sampled_loop(self.plant, law, self.sample, Complex::new(0.0, omega))
    }

    /// L of the sampled loop at the points.
    pub(super) fn loop_points(&self, law: &Law) -> Vec<(f64, Complex<f64>)> {
        let at = |point: &SampledPoint| (point.omega, point.plant * law.response(point.difference).measured);
        self.points.iter().map(at).collect()
    }

    /// Margins of the sampled loop, to the accuracy of the grid.
    pub(super) fn margins(&self, law: &Law) -> Margins {
        let open: &Loop<'_> = &|omega| self.open(law, omega);
        margins(&self.loop_points(law), open)
    }

    /// True if no motion of the sampled loop grows, as far as the grid tells: the turns of 1 + L along the
    /// unit circle make up for the growing motions of the plant, and |L|, where it grows without bound as
    /// ω → 0, is above 1 at the first point.
    pub(super) fn is_stable(&self, law: &Law) -> bool {
        const FURTHER: usize = 10;
        let size = |index: usize| {
            let [difference, plant] = self.points[index.min(self.points.len() - 1)].beside;
            (plant * law.response(difference).measured).norm()
        };
        if size(0) < 1.0 && is_rising(size(0), size(FURTHER)) {
            return false;
        }
        let beside = self.points.iter().map(|point| point.beside);
        let mut last: Option<Complex<f64>> = None;
        let mut turned = 0.0;
        for [difference, plant] in self.arc.iter().copied().chain(beside) {
            let value = plant * law.response(difference).measured + 1.0;
            if let Some(last) = last {
                let ratio = value / last;
                let turn = libm::atan2(ratio.im, ratio.re);
                if turn.is_nan() || turn.abs() > 2.5 {
                    return false;
                }
                turned += turn;
            }
            last = Some(value);
        }
        (self.own as f64 - turned / PI).abs() < 0.1
    }
}
