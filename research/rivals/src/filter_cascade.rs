//! Rational functions of s as first-order sections, one after the other.

use fvi_core::{BdfOrder, Memory, MemoryError, ParameterError, Stateful};

use crate::frame::{Frame, framed};
use crate::operations::Operations;

/// One section (s + zero)/(s + pole), or s + zero where there is no pole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Section {
    /// `zero` ≥ 0; the zero of the section is at s = −`zero`.
    pub zero: f64,
    /// `pole` ≥ 0; the pole of the section is at s = −`pole`. `None` for s + zero.
    pub pole: Option<f64>,
}

/// gain · Π sections with s = γ_p(z)/h, the backward differentiation formula of the convolution quadrature
/// that the cascade replaces: O(sections) a step.
///
/// A section has a direct gain from its newest input, so the leading weight is the product of these gains
/// times `gain`; the memory term is the output of the cascade for the past samples with a new sample of zero.
#[derive(Clone, Debug)]
pub struct FilterCascade {
    frame: Frame,
    /// γ_1/h … γ_p/h
    formula: Vec<f64>,
    /// For each section: factor of its newest input, factor of the past inputs and outputs, and 1 if it has a
    /// pole, else 0.
    direct: Vec<f64>,
    behind: Vec<f64>,
    recursive: Vec<f64>,
    /// Direct gain from the input of the cascade up to and including each section; the first entry is `gain`
    /// alone.
    gains: Vec<f64>,
    /// For each channel and each of the last p steps: the input and the outputs of all sections. The steps
    /// form a ring buffer.
    history: Vec<f64>,
    newest: usize,
    /// Input and outputs of all sections at the next step for a sample of zero, for each channel.
    prepared: Vec<f64>,
    is_prepared: bool,
    operations: Operations,
}

impl FilterCascade {
    /// The cascade at step h, for at most `capacity` samples.
    ///
    /// # Errors
    /// If the step is not positive and finite, or there is no section, channel or capacity.
    pub fn new(
        gain: f64,
        sections: &[Section],
        order: BdfOrder,
        step: f64,
        channels: usize,
        capacity: usize,
    ) -> Result<Self, ParameterError> {
        if !(step > 0.0 && step.is_finite()) {
            return Err(ParameterError { parameter: "step", value: step, allowed: "positive and finite" });
        }
        let gamma: Vec<f64> = formula(order).into_iter().map(|coefficient| coefficient / step).collect();
        let (mut direct, mut behind, mut recursive, mut gains) = (vec![], vec![], vec![], vec![gain]);
        let mut through = gain;
        for section in sections {
            let denominator = section.pole.map_or(1.0, |pole| gamma[0] + pole);
            direct.push((gamma[0] + section.zero) / denominator);
            behind.push(1.0 / denominator);
            recursive.push(if section.pole.is_some() { 1.0 } else { 0.0 });
            through *= (gamma[0] + section.zero) / denominator;
            gains.push(through);
        }
        let width = sections.len() + 1;
        let steps = gamma.len() - 1;
        Ok(Self {
            frame: Frame::new(channels, capacity, through)?,
            formula: gamma[1..].to_vec(),
            direct,
            behind,
            recursive,
            gains,
            history: vec![0.0; width * steps * channels],
            newest: 0,
            prepared: vec![0.0; width * channels],
            is_prepared: false,
            operations: Operations::default(),
        })
    }

    /// The counter of its operations.
    pub fn operations(&self) -> Operations {
        self.operations.clone()
    }

    /// Number of sections.
    pub fn sections(&self) -> usize {
        self.direct.len()
    }

    /// Computes the outputs of the sections for a next sample of zero.
    #[inline(always)]
    fn prepare(&mut self) {
        if self.is_prepared {
            return;
        }
        let (sections, steps) = (self.direct.len(), self.formula.len());
        let width = sections + 1;
        for channel in 0..self.frame.channels {
            let history = &self.history[channel * width * steps..][..width * steps];
            let prepared = &mut self.prepared[channel * width..][..width];
            // Σ_{j≥1} γ_j (u_{k−j} − y_{k−j}) for all sections first: these sums are independent of each
            // other.
            prepared.fill(0.0);
            for (j, gamma) in self.formula.iter().enumerate() {
                let row = &history[(self.newest + j) % steps * width..][..width];
                for i in 0..sections {
                    prepared[i + 1] += gamma * (row[i] - self.recursive[i] * row[i + 1]);
                }
            }
            let mut input = 0.0;
            for i in 0..sections {
                input = self.direct[i] * input + self.behind[i] * prepared[i + 1];
                prepared[i + 1] = input;
            }
        }
        self.operations.add((4 * steps + 3) * sections * self.frame.channels);
        self.is_prepared = true;
    }
}

/// γ_0 … γ_p of γ_p(z) = Σ_{j=1}^p (1 − z)^j/j.
fn formula(order: BdfOrder) -> Vec<f64> {
    let mut gamma = vec![0.0; order.get() + 1];
    let mut power = vec![1.0];
    for j in 1..=order.get() {
        let mut next = vec![0.0; j + 1];
        for (i, coefficient) in power.iter().enumerate() {
            next[i] += coefficient;
            next[i + 1] -= coefficient;
        }
        power = next;
        for (sum, coefficient) in gamma.iter_mut().zip(&power) {
            *sum += coefficient / j as f64;
        }
    }
    gamma
}

impl Memory<f64> for FilterCascade {
    framed!();

    #[inline(always)]
    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        self.frame.check(term)?;
        self.prepare();
        let width = self.direct.len() + 1;
        for (number, prepared) in term.iter_mut().zip(self.prepared.chunks_exact(width)) {
            *number = prepared[width - 1];
        }
        Ok(())
    }

    #[inline(always)]
    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        self.frame.check(sample)?;
        self.prepare();
        let (width, steps) = (self.direct.len() + 1, self.formula.len());
        self.newest = (self.newest + steps - 1) % steps;
        for (channel, &number) in sample.iter().enumerate() {
            let row = &mut self.history[(channel * steps + self.newest) * width..][..width];
            let prepared = &self.prepared[channel * width..][..width];
            for ((place, gain), prepared) in row.iter_mut().zip(&self.gains).zip(prepared) {
                *place = gain * number + prepared;
            }
        }
        self.operations.add(2 * width * self.frame.channels);
        self.frame.len += 1;
        self.is_prepared = false;
        Ok(())
    }

    fn clear(&mut self) {
        self.frame.len = 0;
        self.history.fill(0.0);
        self.is_prepared = false;
        self.operations.clear();
    }

    fn bytes(&self) -> usize {
        let numbers = [
            &self.formula,
            &self.direct,
            &self.behind,
            &self.recursive,
            &self.gains,
            &self.history,
            &self.prepared,
        ];
        size_of::<Self>() + numbers.map(Vec::capacity).iter().sum::<usize>() * size_of::<f64>()
    }
}

impl Stateful for FilterCascade {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formulas_are_those_of_backward_differentiation() {
        let of = |order| formula(BdfOrder::new(order).unwrap());
        assert_eq!(of(1), [1.0, -1.0]);
        assert_eq!(of(2), [1.5, -2.0, 0.5]);
        assert!(of(6).iter().sum::<f64>().abs() < 1e-14);
    }

    #[test]
    fn one_section_has_the_weights_of_its_power_series() {
        // (δ + z)/(δ + p) = 1 + (z − p)/(δ + p) with δ = (1 − q)/h.
        let (zero, pole, step) = (0.3, 2.0, 0.1);
        let sections = [Section { zero, pole: Some(pole) }];
        let mut memory =
            FilterCascade::new(3.0, &sections, BdfOrder::GRUNWALD_LETNIKOV, step, 1, 20).unwrap();
        let (mut term, decay) = ([0.0], 1.0 / (1.0 + step * pole));
        assert!((memory.leading()[0] - 3.0 * (1.0 + step * zero) * decay).abs() < 1e-15);
        memory.push(&[1.0]).unwrap();
        for n in 1..20 {
            memory.next_term(&mut term).unwrap();
            let expected = 3.0 * (zero - pole) * step * decay.powi(n + 1);
            assert!((term[0] - expected).abs() < 1e-14, "{n}: {} {expected}", term[0]);
            memory.push(&[0.0]).unwrap();
        }
    }
}
