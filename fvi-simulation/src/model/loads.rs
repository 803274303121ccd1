//! Compiled loads of a scenario: Σ_l f_l a_l(t).

use crate::model::tape::CompiledForce;
use fvi_scenario::language::expression::{Elementary, Expression, Moment};
use fvi_scenario::scenario::{Amplitude, Load, Record};

/// Patterns and amplitudes of loads.
#[derive(Clone, Debug)]
pub struct Loads<T> {
    /// (coordinate, number) of each pattern: first of those with expressions, then of those with records.
    patterns: Vec<Vec<(usize, T)>>,
    expressions: CompiledForce<T>,
    records: Vec<Record>,
    amplitudes: Vec<T>,
    registers: Vec<T>,
}

impl<T: Elementary> Loads<T> {
    /// Compiles the loads.
    pub fn new(loads: &[Load]) -> Self {
        let (mut patterns, mut expressions, mut records) = (Vec::new(), Vec::<Expression>::new(), Vec::new());
        let pattern = |load: &Load| -> Vec<(usize, T)> {
            let entries = load.pattern.entries.iter();
            entries.map(|&(coordinate, number)| (coordinate as usize, T::of(number))).collect()
        };
        for load in loads {
            if let Amplitude::Expression(amplitude) = &load.amplitude {
                patterns.push(pattern(load));
                expressions.push(amplitude.clone());
            }
        }
        for load in loads {
            if let Amplitude::Record(record) = &load.amplitude {
                patterns.push(pattern(load));
                records.push(record.clone());
            }
        }
        let amplitudes = vec![T::zero(); expressions.len()];
        let expressions = CompiledForce::compile(&expressions);
        Self { patterns, expressions, records, amplitudes, registers: Vec::new() }
    }

    /// True if there are no loads.
    pub fn is_empty(&self) -> bool {
        self.patterns.is_empty()
    }

    /// Adds `factor` times the force at this moment.
    pub fn add(&mut self, moment: Moment<T>, factor: T, force: &mut [T]) {
        if self.patterns.is_empty() {
            return;
        }
        if !self.amplitudes.is_empty() {
            self.expressions.value(moment, &[], &mut self.registers, &mut self.amplitudes);
        }
        let recorded = self.records.iter().map(|record| T::of(record.at(moment.in_double())));
        for (pattern, amplitude) in self.patterns.iter().zip(self.amplitudes.iter().copied().chain(recorded))
        {
            let amplitude = amplitude * factor;
            for &(coordinate, number) in pattern {
                force[coordinate] += number * amplitude;
            }
        }
    }
}
