//! Exact moments of signals that are given piece by piece: samples that are held, and records with straight
//! lines between rows.

use super::force_moments::{add_shapes, edge_of_step, gauss_places, subtract_node};
use crate::scenario::{Record, SampledInput};
use fvi_core::{NodalRule, Real};

/// A function of time that is a polynomial between its breaks.
pub(super) trait Signal {
    /// Numbers that it has at each time.
    fn width(&self) -> usize;

    /// Calls `found` with each break between two times, in ascending order.
    fn breaks(&self, from: f64, to: f64, found: impl FnMut(f64));

    /// Writes the values at a time in the piece that begins at or before it.
    fn value(&self, time: f64, values: &mut [f64]);

    /// Writes what a scheme takes at a node of the step that begins at `start`.
    fn at_node(&self, start: f64, time: f64, values: &mut [f64]);
}

impl Signal for SampledInput {
    fn width(&self) -> usize {
        self.samples.first().map_or(0, Vec::len)
    }

    fn breaks(&self, from: f64, to: f64, found: impl FnMut(f64)) {
        let first = self.times.partition_point(|&time| time <= from);
        self.times[first..].iter().copied().take_while(|&time| time < to).for_each(found);
    }

    fn value(&self, time: f64, values: &mut [f64]) {
        match self.times.partition_point(|&other| other <= time).checked_sub(1) {
            Some(index) => values.copy_from_slice(&self.samples[index]),
            None => values.fill(0.0),
        }
    }

    /// The sample at the beginning of the step, held over all of it.
    fn at_node(&self, start: f64, _: f64, values: &mut [f64]) {
        self.value(start, values);
    }
}

impl Signal for Record {
    fn width(&self) -> usize {
        1
    }

    fn breaks(&self, from: f64, to: f64, found: impl FnMut(f64)) {
        let rows = self.rows();
        let first = rows.partition_point(|&(time, _)| time <= from);
        rows[first..].iter().map(|&(time, _)| time).take_while(|&time| time < to).for_each(found);
    }

    fn value(&self, time: f64, values: &mut [f64]) {
        values.fill(self.at(time));
    }

    fn at_node(&self, _: f64, time: f64, values: &mut [f64]) {
        self.value(time, values);
    }
}

/// ∫₀¹ ℓ_ν(τ) F(t_k + τh) dτ − Σ_i b_i ℓ_ν(c_i) F(t_k + c_i h) of a signal.
#[derive(Clone, Debug)]
pub(super) struct SignalMoments<S> {
    signal: S,
    breaks: Vec<f64>,
    values: Vec<f64>,
    /// (S + 1) × width numbers.
    total: Vec<f64>,
}

impl<S: Signal> SignalMoments<S> {
    /// Of this signal.
    pub(super) fn new(signal: S) -> Self {
        let values = vec![0.0; signal.width()];
        Self { signal, breaks: Vec::new(), values, total: Vec::new() }
    }

    /// The excess ν = 0…S, `width` numbers each; `None` in a step without a break inside, which is left to
    /// the nodes.
    pub(super) fn excess<T: Real>(&mut self, rule: &NodalRule<'_, T>) -> Option<&[f64]> {
        let (start, length) = (rule.start.to_f64(), rule.length.to_f64());
        let edge = edge_of_step(rule);
        self.breaks.clear();
        self.breaks.push(0.0);
        let breaks = &mut self.breaks;
        self.signal.breaks(start + edge * length, start + (1.0 - edge) * length, |time| {
            breaks.push((time - start) / length);
        });
        if self.breaks.len() == 1 {
            return None;
        }
        self.breaks.push(1.0);
        let points: Vec<f64> = rule.points.iter().map(|point| point.to_f64()).collect();
        let width = self.values.len();
        self.total.clear();
        self.total.resize((points.len() + 1) * width, 0.0);
        for piece in self.breaks.windows(2) {
            for (place, weight) in gauss_places(piece[0], piece[1]) {
                self.signal.value(start + place * length, &mut self.values);
                add_shapes(&points, place, weight, &self.values, &mut self.total);
            }
        }
        // A sample within the rounding of the first grid point counts there.
        let begin = start + edge * length;
        for (i, &node) in rule.nodes.iter().enumerate() {
            self.signal.at_node(begin, start + node.to_f64() * length, &mut self.values);
            subtract_node(rule, i, &self.values, &mut self.total);
        }
        Some(&self.total)
    }
}
