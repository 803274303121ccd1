//! Forces, loads and samples that are rough in time, whose moments are computed exactly.

use super::force_moments::{ForceMoments, StepLengths};
use super::scenario_loads::{loads, takes_moments};
use super::signal_moments::SignalMoments;
use super::unbounded_forces::UnboundedForces;
use fvi_core::{NodalRule, Real};
use fvi_scenario::scenario::{Amplitude, Load, Record, SampledInput, Scenario};
use std::ops::Range;
use std::slice::from_ref;

/// The forces of a scenario that have jumps, kinks or roots, are narrow or unbounded, or are given by
/// samples.
#[derive(Clone, Debug)]
pub(crate) struct RoughForces {
    coordinates: usize,
    /// Number of motions integrated together, one for each load case.
    motions: usize,
    force: Option<ForceMoments>,
    /// Unbounded part of the force, which the scheme does not evaluate.
    unbounded: Option<ForceMoments>,
    /// Amplitudes that are expressions.
    expressions: Vec<(ForceMoments, RoughLoad)>,
    records: Vec<(SignalMoments<Record>, RoughLoad)>,
    input: Option<SignalMoments<SampledInput>>,
    /// Input that controllers change inside the next step.
    live: Option<SignalMoments<SampledInput>>,
}

/// A load and the motions that it acts on.
#[derive(Clone, Debug)]
struct RoughLoad {
    load: Load,
    motions: Range<usize>,
}

impl RoughForces {
    /// The rough forces of a scenario whose scheme computes the work of forces by a quadrature or at nodes
    /// inside the step; `None` if all forces are smooth.
    pub(crate) fn of(scenario: &Scenario) -> Option<Self> {
        let is_forced = scenario.system.force.is_some() || loads(scenario).next().is_some();
        let is_pushed = scenario.input.is_some() || !scenario.controllers.is_empty();
        if !(is_forced || is_pushed) || !takes_moments(scenario) {
            return None;
        }
        let whole = UnboundedForces::of(scenario);
        let rest = whole.as_ref().map_or(scenario, |whole| &whole.rest);
        let system = &rest.system;
        let (mut expressions, mut records) = (Vec::new(), Vec::new());
        let time = &scenario.time;
        let lengths = if time.grid.is_some() { StepLengths::Any } else { StepLengths::Equal };
        let run = (time.end(), time.adaptive().is_none().then(|| time.longest_step()));
        for (load, motions) in loads(rest) {
            let rough = RoughLoad { load: load.clone(), motions };
            match &load.amplitude {
                Amplitude::Expression(amplitude) => {
                    let moments = ForceMoments::new(from_ref(amplitude), lengths, run);
                    expressions.extend(moments.map(|moments| (moments, rough)));
                }
                Amplitude::Record(record) => {
                    records.push((SignalMoments::new(record.clone()), rough));
                }
            }
        }
        let (mut unbounded, coordinates) = (None, system.coordinates());
        if let Some(whole) = &whole {
            let moments = |components: &[_], singularities: &[_]| {
                ForceMoments::whole(components, lengths, time.end(), Some(singularities.to_vec()))
            };
            unbounded = whole.force.as_ref().map(|(components, times)| moments(components, times));
            for (load, motions, times) in &whole.loads {
                if let Amplitude::Expression(amplitude) = &load.amplitude {
                    let rough = RoughLoad { load: load.clone(), motions: motions.clone() };
                    expressions.push((moments(from_ref(amplitude), times), rough));
                }
            }
        }
        let force = ForceMoments::new(system.force.as_deref().unwrap_or_default(), lengths, run);
        let input = scenario.input.clone().filter(|_| scenario.scheme_descriptor().takes_inputs_inside);
        let input = input.map(SignalMoments::new);
        let step = scenario.time.step;
        let inside = scenario.controllers.iter().any(|controller| controller.delay_in_steps(step).1 != 0.0);
        let nothing = || SampledInput::of(vec![0.0], vec![vec![0.0; coordinates]]);
        let live = inside.then(|| SignalMoments::new(nothing()));
        let is_rough = force.is_some()
            || live.is_some()
            || unbounded.is_some()
            || input.is_some()
            || !(expressions.is_empty() && records.is_empty());
        let motions = scenario.copies();
        is_rough.then_some(Self { coordinates, motions, force, unbounded, expressions, records, input, live })
    }

    /// Input that controllers change inside the next step.
    pub(crate) fn live(&mut self) -> Option<&mut SampledInput> {
        self.live.as_mut().map(SignalMoments::signal_mut)
    }

    /// Time from which rough points may have been overlooked.
    pub(crate) fn unresolved_since(&self) -> Option<f64> {
        let forces = self.force.iter().chain(&self.unbounded);
        forces
            .chain(self.expressions.iter().map(|(amplitude, _)| amplitude))
            .find_map(ForceMoments::unresolved_since)
    }

    /// Writes the exact moments minus those of the nodes, ν = 0…S, N numbers each and for each motion, and
    /// returns whether there is a correction.
    pub(crate) fn moment_correction<T: Real>(
        &mut self,
        rule: &NodalRule<'_, T>,
        moment_correction: &mut [T],
    ) -> bool {
        let everywhere = [
            self.force.as_mut().and_then(|force| force.moment_correction(rule)),
            self.unbounded.as_mut().and_then(|force| force.moment_correction(rule)),
            self.input.as_mut().and_then(|input| input.moment_correction(rule)),
            self.live.as_mut().and_then(|input| input.moment_correction(rule)),
        ];
        let mut found = false;
        for moments in everywhere.into_iter().flatten() {
            clear(moment_correction, &mut found);
            moment_correction.iter_mut().zip(moments).for_each(|(place, &number)| *place += T::of(number));
        }
        let expressions =
            self.expressions.iter_mut().map(|(amplitude, load)| (amplitude.moment_correction(rule), &*load));
        let records = self.records.iter_mut().map(|(record, load)| (record.moment_correction(rule), &*load));
        for (moments, RoughLoad { load, motions }) in expressions.chain(records) {
            let Some(moments) = moments else { continue };
            clear(moment_correction, &mut found);
            for (moment_correction, moment) in
                moment_correction.chunks_exact_mut(self.coordinates * self.motions).zip(moments)
            {
                for motion in
                    moment_correction.chunks_exact_mut(self.coordinates).take(motions.end).skip(motions.start)
                {
                    for &(coordinate, number) in load.pattern.entries.iter() {
                        motion[coordinate as usize] += T::of(number * moment);
                    }
                }
            }
        }
        found
    }
}

/// Sets the sum to zero before its first term.
fn clear<T: Real>(moment_correction: &mut [T], found: &mut bool) {
    if !std::mem::replace(found, true) {
        moment_correction.fill(T::zero());
    }
}
