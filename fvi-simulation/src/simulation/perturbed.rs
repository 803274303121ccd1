//! A second run of an equation whose start and right sides are a little beside the first's, on the same
//! steps: how much perturbations grow.

use super::choice::SolverChoice;
use super::{GridState, Precision, Simulation};
use fvi_core::max_or_nan;
use fvi_fft::memory::Tables;
use fvi_scenario::scenario::{Adaptive, Scenario};

/// Range of the relative size of the perturbation, which is the tolerance within it: above rounding, and so
/// small that growths of 10⁶ are seen.
const SIZES: [f64; 2] = [1e-10, 1e-6];

/// Relative difference of the two runs from which on it says no more about small ones.
const LARGE: f64 = 0.1;

/// Pairs of steps that are followed; beyond, the growth is one at least.
const FOLLOWED: usize = 5000;

/// Growth of perturbations that is told.
const STRONG: f64 = 100.0;

/// The second run.
pub(super) struct Perturbed {
    simulation: Option<Simulation>,
    state: GridState,
    size: f64,
    pairs: usize,
    growth: f64,
}

impl Perturbed {
    /// For an equation whose right sides are expressions, in double precision; `None` for others, and where
    /// there is no run from the other start.
    pub(super) fn of(
        scenario: &Scenario,
        precision: Precision,
        tables: &Tables,
        start: &GridState,
    ) -> Option<Self> {
        let rule = scenario.time.adaptive()?;
        let is_followed = precision == Precision::F64 && scenario.system.own_terms.is_none();
        let unknowns = scenario.system.unknowns.filter(|_| is_followed)?;
        let size = rule.tolerance.clamp(SIZES[0], SIZES[1]);
        // Different parts, so that they are no direction of the system by themselves.
        let part = |index: usize| 1.0 - 0.1 * (index % 7) as f64;
        let mut beside = scenario.clone();
        for (index, x) in beside.initial.position.iter_mut().take(unknowns).enumerate() {
            *x += size * x.abs().max(rule.scale) * part(index);
        }
        // Constants may solve the equation whatever grows in it, as those of Caputo's derivatives alone: the
        // right sides are other ones, too, by what moves an unknown as far in the whole time.
        if let Some(equation) = &scenario.equation {
            let pushes = equation.terms.iter().enumerate().map(|(index, terms)| {
                size * rule.scale * part(index) * terms[0].coefficient * libm::pow(rule.end, -terms[0].order)
            });
            equation.push(&mut beside.system, &pushes.collect::<Vec<_>>());
        }
        let simulation = Simulation::sharing(&beside, precision, SolverChoice::default(), tables).ok()?;
        Some(Self { simulation: Some(simulation), state: start.clone(), size, pairs: 0, growth: 0.0 })
    }

    /// Follows a pair of steps, by its halves of a length, to a state of the first run; `largest` are its
    /// values so far.
    pub(super) fn follow(
        &mut self,
        [length, between, end]: [f64; 3],
        (input, rule): (&[f64], &Adaptive),
        (position, largest): (&[f64], &[f64]),
        unknowns: usize,
    ) {
        let Some(simulation) = &mut self.simulation else { return };
        let made = simulation
            .step_over(length, between, input)
            .and_then(|_| simulation.step_over(length, end, input));
        self.pairs += 1;
        if made.is_err() || self.pairs == FOLLOWED {
            self.simulation = None;
            return;
        }
        simulation.read_without_energy(&mut self.state);
        let pairs = self.state.position.iter().zip(position).zip(largest).take(unknowns);
        let apart = pairs
            .map(|((beside, x), largest)| (beside - x).abs() / largest.max(rule.scale))
            .fold(0.0, max_or_nan);
        if apart.is_finite() {
            self.growth = self.growth.max(apart / self.size);
        }
        if apart.is_nan() || apart > LARGE {
            self.simulation = None;
        }
    }

    /// The second run's jumps and kinks are on the sides of the first.
    pub(super) fn switches(&mut self) -> Option<&mut dyn crate::model::Switched> {
        self.simulation.as_mut().map(Simulation::switches)
    }

    /// A warning where perturbations have grown strongly.
    pub(super) fn note(&self, tolerance: f64) -> Option<String> {
        let Self { growth, size, .. } = self;
        let least = if growth * size > LARGE { "at least " } else { "" };
        (*growth > STRONG).then(|| {
            format!(
                "time.tolerance: a perturbation of start and right side has grown {least}{growth:.0e} times, relative to the largest values; errors \
                 of steps grow alike, and may have become {:.0e} where {tolerance:e} was asked for",
                growth * tolerance
            )
        })
    }
}
