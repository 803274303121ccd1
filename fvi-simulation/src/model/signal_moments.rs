//! Exact moments of piecewise signals: samples that are held, and records that are linear between rows.

use super::force_moments::{TestFunction, gauss_places, node_moment, sides_of_step};
use fvi_core::{NodalRule, Real};
use fvi_scenario::language::expression::Moment;
use fvi_scenario::scenario::{Record, SampledInput};

/// A function of time that is a polynomial between its breaks.
pub(super) trait Signal {
    /// Number of its components.
    fn width(&self) -> usize;

    /// Calls `found` with each break between two times, in ascending order.
    fn breaks(&self, from: f64, to: f64, found: impl FnMut(f64));

    /// Writes the values at a time, by the piece that begins at or before it.
    fn value(&self, time: f64, values: &mut [f64]);

    /// Writes the values that a scheme uses at a node of the step that begins at `start`.
    fn at_node(&self, start: f64, node: Moment<f64>, values: &mut [f64]);

    /// Distance from the ends of the step, as fractions of it, within which a break counts as at the end.
    fn edges<T: Real>(rule: &NodalRule<'_, T>) -> (f64, f64);
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

    /// The sample at the beginning of the step, held over the whole step.
    fn at_node(&self, start: f64, _: Moment<f64>, values: &mut [f64]) {
        self.value(start, values);
    }

    /// The same tolerance as in [`Scenario::input_over`](fvi_scenario::scenario::Scenario::input_over).
    fn edges<T: Real>(rule: &NodalRule<'_, T>) -> (f64, f64) {
        let rounding = 4.0 * T::EPSILON.to_f64() * rule.start.abs().max(rule.length).to_f64();
        let edge = f64::max(1e-9, rounding / rule.length.to_f64());
        (edge, edge)
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
        values.fill(self.at(Moment::inside(time)));
    }

    fn at_node(&self, _: f64, node: Moment<f64>, values: &mut [f64]) {
        values.fill(self.at(node));
    }

    fn edges<T: Real>(rule: &NodalRule<'_, T>) -> (f64, f64) {
        sides_of_step(rule)
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
    /// Moments of this signal.
    pub(super) fn new(signal: S) -> Self {
        let values = vec![0.0; signal.width()];
        Self { signal, breaks: Vec::new(), values, total: Vec::new() }
    }

    /// The signal, mutable between steps.
    pub(super) fn signal_mut(&mut self) -> &mut S {
        &mut self.signal
    }

    /// The moment correction, as of [`ForceMoments`](super::force_moments::ForceMoments); `None` for a step
    /// without a break inside, for which the nodes are accurate enough.
    pub(super) fn moment_correction<T: Real>(&mut self, rule: &NodalRule<'_, T>) -> Option<&[f64]> {
        let (start, length) = (rule.start.to_f64(), rule.length.to_f64());
        let (first, last) = S::edges(rule);
        self.breaks.clear();
        self.breaks.push(0.0);
        let breaks = &mut self.breaks;
        self.signal.breaks(start + first * length, start + (1.0 - last) * length, |time| {
            breaks.push((time - start) / length);
        });
        if self.breaks.len() == 1 {
            return None;
        }
        self.breaks.push(1.0);
        let against = TestFunction::of(rule);
        let width = self.values.len();
        self.total.clear();
        self.total.resize(against.rows() * width, 0.0);
        for piece in self.breaks.windows(2) {
            for (place, weight) in gauss_places(piece[0], piece[1]) {
                self.signal.value(start + place * length, &mut self.values);
                against.add(place, weight, &self.values, &mut self.total);
            }
        }
        // A sample within rounding of the first grid point counts as at that point.
        let begin = start + first * length;
        for i in 0..rule.nodes.len() {
            self.signal.at_node(begin, node_moment(rule, i), &mut self.values);
            against.subtract_node(rule, i, &self.values, &mut self.total);
        }
        Some(&self.total)
    }
}
