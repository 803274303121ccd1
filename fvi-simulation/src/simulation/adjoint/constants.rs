//! Constants of expressions backwards.

use crate::model::moment;
use crate::model::tape::CompiledSlopes;
use fvi_core::Instant;
use fvi_scenario::language::InputError;
use fvi_scenario::scenario::{Named, Parameter, Quantity, Scenario};

/// Σ_i Ḡ_i ∂G_i/∂θ for all constants θ of expressions at once, G = ∇U − F.
pub(super) struct Constants {
    /// Their indices among the parameters, and their values.
    parameters: Vec<usize>,
    values: Vec<f64>,
    potential: Option<CompiledSlopes<f64>>,
    force: Option<CompiledSlopes<f64>>,
    /// True if the force depends on the velocity.
    moves: bool,
    elements: Vec<OfElements>,
    loads: Vec<OfLoad>,
    registers: Vec<f64>,
    point: Vec<f64>,
    sums: Vec<f64>,
}

struct OfElements {
    potential: CompiledSlopes<f64>,
    /// The coordinates of each element.
    places: Vec<Vec<usize>>,
}

struct OfLoad {
    amplitude: CompiledSlopes<f64>,
    pattern: Vec<(u32, f64)>,
}

impl Constants {
    /// Those among the parameters; `None` if there are none.
    ///
    /// # Errors
    /// If an expression cannot be read again.
    pub(super) fn new(scenario: &Scenario, parameters: &[Parameter]) -> Result<Option<Self>, InputError> {
        let prefix = "system.parameters.";
        let named = parameters.iter().enumerate().filter_map(|(index, parameter)| match &parameter.what {
            Quantity::Named(named) => Some((index, parameter.path.strip_prefix(prefix)?, &**named)),
            _ => None,
        });
        let named: Vec<(usize, &str, &Named)> = named.collect();
        let Some((.., first)) = named.first() else { return Ok(None) };
        let names: Vec<&str> = named.iter().map(|&(_, name, _)| name).collect();
        let together = first.together(scenario, &names)?;
        let (size, count, system) = (scenario.coordinates(), names.len(), &scenario.system);
        let moves = system.force_in_words_depends_on_velocity();
        let variables = if moves { 2 * size } else { size };
        let elements = together.elements.iter().map(|(group, potential)| {
            let places = system.elements[*group].coordinates.clone();
            let width = places.first().map_or(0, Vec::len);
            OfElements { potential: CompiledSlopes::of_potential(potential, [width, count]), places }
        });
        let loads = together.loads.iter().map(|(load, amplitude)| {
            let pattern = system.loads[*load].pattern.entries.to_vec();
            let amplitude = CompiledSlopes::of_force(std::slice::from_ref(amplitude), [0, count]);
            OfLoad { amplitude, pattern }
        });
        Ok(Some(Self {
            parameters: named.iter().map(|&(index, ..)| index).collect(),
            values: named.iter().map(|(.., named)| named.value).collect(),
            potential: together.potential.as_ref().map(|u| CompiledSlopes::of_potential(u, [size, count])),
            force: together.force.as_ref().map(|force| CompiledSlopes::of_force(force, [variables, count])),
            moves,
            elements: elements.collect(),
            loads: loads.collect(),
            registers: Vec::new(),
            point: Vec::new(),
            sums: vec![0.0; count],
        }))
    }

    /// Adds what one point of a step contributes, where the cotangents of the forces are `by`.
    pub(super) fn visit(
        &mut self,
        instant: Instant<f64>,
        (position, velocity): (&[f64], &[f64]),
        by: &[f64],
    ) {
        let Self { values, potential, force, moves, elements, loads, registers, point, sums, .. } = self;
        let at = moment(instant);
        if let Some(potential) = potential {
            point.clear();
            point.extend(position.iter().chain(&*values).chain(by));
            potential.add(at, point, registers, sums);
        }
        for OfElements { potential, places } in elements {
            for place in places {
                point.clear();
                point.extend(place.iter().map(|&coordinate| position[coordinate]));
                point.extend(&*values);
                point.extend(place.iter().map(|&coordinate| by[coordinate]));
                potential.add(at, point, registers, sums);
            }
        }
        if let Some(force) = force {
            let velocity = if *moves { velocity } else { &[] };
            point.clear();
            point.extend(position.iter().chain(velocity).chain(&*values).chain(by));
            force.add(at, point, registers, sums);
        }
        for OfLoad { amplitude, pattern } in loads {
            let weight: f64 =
                pattern.iter().map(|&(coordinate, entry)| entry * by[coordinate as usize]).sum();
            point.clear();
            point.extend(values.iter().copied().chain([weight]));
            amplitude.add(at, point, registers, sums);
        }
    }

    /// Adds the sums to the derivatives by all parameters.
    pub(super) fn finish(&self, gradient: &mut [f64]) {
        self.parameters.iter().zip(&self.sums).for_each(|(&parameter, sum)| gradient[parameter] += sum);
    }
}
