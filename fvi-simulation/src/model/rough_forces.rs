//! What acts on a system and is rough in time: forces, loads and samples whose moments are taken exactly.

use super::force_moments::{ForceMoments, StepLengths};
use super::signal_moments::SignalMoments;
use crate::scenario::{Amplitude, ForceQuadrature, Load, Record, SampledInput, Scenario, Scheme};
use fvi_core::{NodalRule, Real};
use std::ops::Range;
use std::slice::from_ref;

/// The forces of a scenario that jump, have kinks or roots, or come as samples.
#[derive(Clone, Debug)]
pub(crate) struct RoughForces {
    coordinates: usize,
    /// Motions integrated together, one for each load case.
    motions: usize,
    force: Option<ForceMoments>,
    /// Amplitudes that are expressions.
    expressions: Vec<(ForceMoments, RoughLoad)>,
    records: Vec<(SignalMoments<Record>, RoughLoad)>,
    input: Option<SignalMoments<SampledInput>>,
}

/// A load, and the motions that it acts on.
#[derive(Clone, Debug)]
struct RoughLoad {
    load: Load,
    motions: Range<usize>,
}

impl RoughForces {
    /// For the schemes that take the work of forces by a quadrature; `None` if all is smooth.
    pub(crate) fn of(scenario: &Scenario) -> Option<Self> {
        let system = &scenario.system;
        let by_moments = system.force_quadrature == ForceQuadrature::Moments
            && matches!(scenario.scheme, Scheme::LowOrder { .. } | Scheme::Galerkin { .. });
        if !by_moments {
            return None;
        }
        let (mut expressions, mut records) = (Vec::new(), Vec::new());
        let lengths = if scenario.time.grid.is_some() { StepLengths::Any } else { StepLengths::Equal };
        let motions = scenario.copies();
        let shared = system.loads.iter().map(|load| (load, 0..motions));
        let of_cases = scenario.cases.iter().enumerate();
        let of_cases =
            of_cases.flat_map(|(index, case)| case.loads.iter().map(move |load| (load, index..index + 1)));
        for (load, motions) in shared.chain(of_cases) {
            let rough = RoughLoad { load: load.clone(), motions };
            match &load.amplitude {
                Amplitude::Expression(amplitude) => {
                    expressions.extend(ForceMoments::new(from_ref(amplitude), lengths).map(|m| (m, rough)));
                }
                Amplitude::Record(record) => {
                    records.push((SignalMoments::new(record.clone()), rough));
                }
            }
        }
        let force = ForceMoments::new(system.force.as_deref().unwrap_or_default(), lengths);
        let input = scenario.input.clone().map(SignalMoments::new);
        let is_rough = force.is_some() || input.is_some() || !(expressions.is_empty() && records.is_empty());
        let coordinates = system.coordinates();
        is_rough.then_some(Self { coordinates, motions, force, expressions, records, input })
    }

    /// Writes by how much the moments exceed what the nodes give, ν = 0…S, N numbers each and for each
    /// motion, and returns whether they do.
    pub(crate) fn excess<T: Real>(&mut self, rule: &NodalRule<'_, T>, excess: &mut [T]) -> bool {
        let everywhere = [
            self.force.as_mut().and_then(|force| force.excess(rule)),
            self.input.as_mut().and_then(|input| input.excess(rule)),
        ];
        let mut found = false;
        for moments in everywhere.into_iter().flatten() {
            clear(excess, &mut found);
            excess.iter_mut().zip(moments).for_each(|(place, &number)| *place += T::of(number));
        }
        let expressions =
            self.expressions.iter_mut().map(|(amplitude, load)| (amplitude.excess(rule), &*load));
        let records = self.records.iter_mut().map(|(record, load)| (record.excess(rule), &*load));
        for (moments, RoughLoad { load, motions }) in expressions.chain(records) {
            let Some(moments) = moments else { continue };
            clear(excess, &mut found);
            for (excess, moment) in excess.chunks_exact_mut(self.coordinates * self.motions).zip(moments) {
                for motion in excess.chunks_exact_mut(self.coordinates).take(motions.end).skip(motions.start)
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

/// Sets what is to be summed to zero, once.
fn clear<T: Real>(excess: &mut [T], found: &mut bool) {
    if !std::mem::replace(found, true) {
        excess.fill(T::zero());
    }
}
