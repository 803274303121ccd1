//! A damping term backwards.

use super::Step;
use crate::model::{Matrix, matrix};
use crate::simulation::tangent::{Change, derivative_memory, slope_weights};
use crate::simulation::{memory_request, refused_memory};
use fvi_core::{ActsOn, Derivative, Memory, MemoryError, Subtraction};
use fvi_fft::memory::{EngineError, HostMemory, MemoryRequest, Tables};
use fvi_fft::quadrature::correlation::Correlation;
use fvi_fft::transfer::derivative::TransferDerivative;
use fvi_scenario::language::InputError;
use fvi_scenario::scenario::{self, Parameter, Quantity, Scenario};

/// A damping term ρ D X backwards. With the weights W_l and the samples s_m of the motion
///
/// ```text
/// (D X)_m = Σ_l W_l s_{m−l}      gives      Z_m = Σ_l W_lᵀ D̄_{m+l} ,      s̄_m = ρᵀ Z_m
/// ```
///
/// from the cotangents D̄ of the forces ρ D X, so the same weights act on the sequence in reverse order, by
/// the same engine. Starting weights, which belong to single samples, are sums of their own.
pub(super) struct Term {
    pub(super) rho: Matrix<f64>,
    pub(super) acts_on: ActsOn,
    kind: Subtraction,
    memory: HostMemory<f64>,
    /// W₀, R×R numbers row by row.
    weights: Vec<f64>,
    starting: Option<Starting>,
    /// ∂ρ for the parameters in it.
    changes: Vec<(usize, Change)>,
    /// Parameters of the kernel, each with the derivatives of its weights, plane by plane.
    kernels: Vec<(usize, Vec<f64>)>,
    /// ρᵀD̄_m and s_m of every sample, if there are such parameters: coordinate by coordinate, the nodes of
    /// each one after another, each backwards.
    weighted: Vec<Vec<f64>>,
    samples: Vec<Vec<f64>>,
    /// Z of the current sample: R n numbers, node after node.
    pub(super) convolved: Vec<f64>,
    channels: Vec<f64>,
}

/// Starting weights.
struct Starting {
    /// For each of the first samples j its weights w_{m,j} in the derivatives at the samples m ≥ j.
    columns: Vec<Vec<f64>>,
    /// Σ_m w_{m,j} D̄_m.
    sums: Vec<Vec<f64>>,
}

/// Where the motion of the memories begins, with its velocity, and when.
pub(super) struct Origin<'a> {
    pub(super) position: &'a [f64],
    pub(super) velocity: &'a [f64],
    pub(super) time: f64,
}

impl Term {
    pub(super) fn new(
        scenario: &Scenario,
        (index, nodes): (usize, usize),
        parameters: &[Parameter],
        tables: &Tables,
    ) -> Result<Self, InputError> {
        let refused = |error| refused_memory(scenario, index, error);
        let term = &scenario.system.damping[index];
        let size = scenario.coordinates();
        let request = |coordinates| memory_request(scenario, (coordinates, nodes), term);
        let kernel = request(size).kernel().map_err(|error| refused(error.into()))?;
        let derivative = match term.derivative {
            scenario::Derivative::Caputo => Derivative::Caputo,
            scenario::Derivative::RiemannLiouville => Derivative::RiemannLiouville,
        };
        let step = scenario.time.step;
        let memory = reversed(&request(size), step, tables).map_err(refused)?;
        let stages = memory.stages();
        let leading = memory.leading().to_vec();
        let weight = |i: usize, j: usize| match stages == nodes {
            true => leading[i * stages + j],
            false if i == j => leading[0],
            false => 0.0,
        };
        // Those of the memory are transposed.
        let weights = (0..nodes).flat_map(|i| (0..nodes).map(move |j| (j, i))).map(|(i, j)| weight(i, j));
        let weights = weights.collect();
        let starting = match scenario.convolution.starting.len() {
            0 => None,
            count => {
                Some(Starting::new(&request(1), (count + 2, nodes * size), step, tables).map_err(refused)?)
            }
        };
        let mut changes = Vec::new();
        let mut kernels = Vec::new();
        for (parameter, Parameter { what, .. }) in parameters.iter().enumerate() {
            match what {
                Quantity::Coefficient(own, change) if *own == index => {
                    changes.push((parameter, change.clone()));
                }
                _ => {}
            }
            if let Some(by) = what.kernel(index) {
                kernels.push((parameter, slopes(scenario, &request(1), by).map_err(refused)?));
            }
        }
        let kept = if kernels.is_empty() { 0 } else { size * nodes };
        Ok(Self {
            rho: matrix(&term.coefficient),
            acts_on: request(size).acts_on(),
            kind: Subtraction::of(derivative, kernel.symbol()),
            memory,
            weights,
            starting,
            changes,
            kernels,
            weighted: vec![Vec::new(); kept],
            samples: vec![Vec::new(); kept],
            convolved: vec![0.0; nodes * size],
            channels: vec![0.0; nodes * size],
        })
    }

    /// True if the numbers of the samples are needed.
    pub(super) fn needs_samples(&self) -> bool {
        !self.changes.is_empty() || !self.kernels.is_empty()
    }

    /// True if the weight of the sample to come is the same for all samples.
    pub(super) fn is_uniform(&self) -> bool {
        self.starting.is_none()
    }

    /// W_ij, the weight of the unknown of node j in the derivative at node i, for sample m.
    pub(super) fn leading(&self, m: usize) -> Vec<f64> {
        let mut weights = self.weights.clone();
        let correction = self.starting.as_ref().and_then(|starting| starting.columns.get(m));
        if let Some(&correction) = correction.and_then(|column| column.get(m)) {
            let nodes = weights.len().isqrt();
            (0..nodes).for_each(|i| weights[i * nodes + i] += correction);
        }
        weights
    }

    /// Determines the part of Z_m that is known before D̄_m.
    pub(super) fn recall(&mut self, m: usize, length: f64) -> Result<(), MemoryError> {
        self.memory.begin_step(length)?;
        self.memory.next_term(&mut self.channels)?;
        let nodes = self.weights.len().isqrt();
        let n = self.channels.len() / nodes;
        for (coordinate, stages) in self.channels.chunks(nodes).enumerate() {
            stages.iter().enumerate().for_each(|(i, &number)| self.convolved[i * n + coordinate] = number);
        }
        if let Some(sums) = self.starting.as_ref().and_then(|starting| starting.sums.get(m)) {
            self.convolved.iter_mut().zip(sums).for_each(|(z, sum)| *z += sum);
        }
        Ok(())
    }

    /// Completes Z_m by D̄_m, and stores that.
    pub(super) fn push(&mut self, m: usize, cotangent: &[f64]) -> Result<(), MemoryError> {
        let leading = self.leading(m);
        let nodes = leading.len().isqrt();
        let n = self.channels.len() / nodes;
        for (index, &weight) in leading.iter().enumerate() {
            let (i, j) = (index / nodes, index % nodes);
            super::add(&mut self.convolved[j * n..][..n], weight, &cotangent[i * n..][..n]);
        }
        for (coordinate, stages) in self.channels.chunks_mut(nodes).enumerate() {
            stages.iter_mut().enumerate().for_each(|(i, place)| *place = cotangent[i * n + coordinate]);
        }
        if let Some(Starting { columns, sums }) = &mut self.starting {
            for (column, sum) in columns.iter().zip(sums).take(m) {
                if let Some(&weight) = column.get(m) {
                    super::add(sum, weight, cotangent);
                }
            }
        }
        self.memory.push(&self.channels)
    }

    /// s_m, node after node: in the step at the nodes X_i, or where the nodes are ends of steps at its end.
    ///
    /// `rises` are the differences of the nodes from q_k, and `behind` those of q_k from the nodes of the
    /// sample before; `None` for the first sample, or with ends of steps.
    pub(super) fn sample(
        &self,
        step: &Step<'_>,
        (rises, behind): (&[f64], Option<&[f64]>),
        (is_first, origin): (bool, &Origin<'_>),
    ) -> Vec<f64> {
        let n = step.start.len();
        let mut sample = rises.to_vec();
        for (i, node) in sample.chunks_mut(n).enumerate() {
            let into = step.fractions[i] * step.length;
            let lapse = match self.acts_on {
                ActsOn::Values => {
                    super::add(node, 1.0, step.start);
                    if self.kind != Subtraction::Nothing {
                        super::add(node, -1.0, origin.position);
                    }
                    step.time + into - origin.time
                }
                ActsOn::Increments | ActsOn::Rises if is_first => {
                    if self.kind == Subtraction::Nothing {
                        super::add(node, 1.0, step.start);
                    }
                    into
                }
                ActsOn::Rises => into,
                ActsOn::Increments => {
                    if let Some(behind) = behind {
                        super::add(node, 1.0, &behind[i * n..][..n]);
                    }
                    step.length
                }
            };
            if self.kind == Subtraction::PositionAndVelocity {
                super::add(node, -lapse, origin.velocity);
            }
        }
        sample
    }

    /// Hands the cotangent s̄ of one node of a sample to what the sample was made of besides the rise: q_k,
    /// and position and velocity of the origin.
    pub(super) fn pull(
        &self,
        step: &Step<'_>,
        (i, is_first, begin): (usize, bool, f64),
        cotangent: &[f64],
        [position, base, velocity]: [&mut [f64]; 3],
    ) {
        let into = step.fractions[i] * step.length;
        let lapse = match self.acts_on {
            ActsOn::Values => {
                super::add(position, 1.0, cotangent);
                if self.kind != Subtraction::Nothing {
                    super::add(base, -1.0, cotangent);
                }
                step.time + into - begin
            }
            ActsOn::Increments | ActsOn::Rises if is_first => {
                if self.kind == Subtraction::Nothing {
                    super::add(position, 1.0, cotangent);
                }
                into
            }
            ActsOn::Rises => into,
            ActsOn::Increments => step.length,
        };
        if self.kind == Subtraction::PositionAndVelocity {
            super::add(velocity, -lapse, cotangent);
        }
    }

    /// Adds the derivatives by the parameters in ρ that sample s_m contributes, and keeps what those of the
    /// kernel need: D̄_m and s_m.
    pub(super) fn gather(&mut self, (cotangent, sample): (&[f64], &[f64]), gradient: &mut [f64]) {
        let n = self.rho.size();
        for (parameter, change) in &self.changes {
            for (z, s) in self.convolved.chunks(n).zip(sample.chunks(n)) {
                let sum: f64 = change.iter().map(|&(row, column, entry)| z[row] * entry * s[column]).sum();
                gradient[*parameter] += sum;
            }
        }
        if self.kernels.is_empty() {
            return;
        }
        let nodes = self.weights.len().isqrt();
        let mut weighted = vec![0.0; n];
        for (i, (cotangent, sample)) in cotangent.chunks(n).zip(sample.chunks(n)).enumerate() {
            weighted.fill(0.0);
            self.rho.transposed_multiply_add(1.0, cotangent, &mut weighted);
            for coordinate in 0..n {
                self.weighted[coordinate * nodes + i].push(weighted[coordinate]);
                self.samples[coordinate * nodes + i].push(sample[coordinate]);
            }
        }
    }

    /// Adds the derivatives by the parameters of the kernel, when all samples have been gathered.
    pub(super) fn correlate(&mut self, gradient: &mut [f64]) {
        if self.kernels.is_empty() {
            return;
        }
        let nodes = self.weights.len().isqrt();
        let length = self.samples.first().map_or(0, Vec::len);
        let mut correlation = Correlation::new(length, nodes);
        let pairs = self.weighted.chunks_mut(nodes).zip(self.samples.chunks_mut(nodes));
        for (weighted, samples) in pairs {
            weighted.iter_mut().chain(&mut *samples).for_each(|sequence| sequence.reverse());
            correlation.add(weighted, samples);
        }
        let planes = correlation.planes();
        let stages = self.memory.stages();
        for (parameter, slopes) in &self.kernels {
            let count = slopes.len() / (stages * stages);
            for i in 0..nodes {
                for j in 0..nodes {
                    let plane = match stages == nodes {
                        true => i * stages + j,
                        false if i == j => 0,
                        false => continue,
                    };
                    let correlations = &planes[(i * nodes + j) * length..][..length];
                    let pairs = slopes[plane * count..][..count].iter().zip(correlations);
                    gradient[*parameter] += pairs.map(|(slope, number)| slope * number).sum::<f64>();
                }
            }
        }
    }
}

impl Starting {
    fn new(
        request: &MemoryRequest<'_>,
        (count, numbers): (usize, usize),
        length: f64,
        tables: &Tables,
    ) -> Result<Self, EngineError> {
        let request = MemoryRequest { coordinates: 1, ..request.clone() };
        let plain = responses(&MemoryRequest { starting: &[], ..request.clone() }, 0, length, tables)?;
        let column = |j: usize| -> Result<Vec<f64>, EngineError> {
            let mut column = responses(&request, j, length, tables)?;
            column.iter_mut().zip(&plain).for_each(|(weight, plain)| *weight -= plain);
            // Place m belongs to sample m.
            Ok(std::iter::repeat_n(0.0, j).chain(column).collect())
        };
        let columns = (0..count.min(request.samples)).map(column).collect::<Result<Vec<_>, _>>()?;
        Ok(Self { sums: vec![vec![0.0; numbers]; columns.len()], columns })
    }
}

/// The weights that sample j has in the derivatives at samples j, j + 1, …, of a memory of one coordinate, as
/// its engine has them: plane by plane, in places (r·S + s)·count + l for the derivative at stage r.
fn responses(
    request: &MemoryRequest<'_>,
    j: usize,
    length: f64,
    tables: &Tables,
) -> Result<Vec<f64>, EngineError> {
    let mut memory: HostMemory<f64> = request.build_with(tables)?;
    let (stages, channels) = (memory.stages(), memory.channels());
    let count = request.samples - j;
    let mut planes = vec![0.0; stages * stages * count];
    let engine = memory.engine();
    let unserved = |_| EngineError::Unsuited { engine, reason: UNSERVED };
    let (mut sample, mut term) = (vec![0.0; channels], vec![0.0; channels]);
    for s in 0..stages {
        memory.clear();
        for m in 0..j + count {
            memory.begin_step(length).map_err(unserved)?;
            memory.next_term(&mut term).map_err(unserved)?;
            sample.fill(0.0);
            if m == j {
                sample[s] = 1.0;
            }
            for r in 0..stages {
                match m.cmp(&j) {
                    std::cmp::Ordering::Less => {}
                    std::cmp::Ordering::Equal => {
                        planes[(r * stages + s) * count] = memory.leading()[r * stages + s];
                    }
                    std::cmp::Ordering::Greater => planes[(r * stages + s) * count + m - j] = term[r],
                }
            }
            memory.push(&sample).map_err(unserved)?;
        }
    }
    Ok(planes)
}

const UNSERVED: &str = "gradients need its weights for all steps of the run";

/// The memory of the transposed weights, without starting weights.
fn reversed(
    request: &MemoryRequest<'_>,
    length: f64,
    tables: &Tables,
) -> Result<HostMemory<f64>, EngineError> {
    let request = MemoryRequest { starting: &[], ..request.clone() };
    if !request.family.is_staged() {
        return request.build_with(tables);
    }
    let stages = request.family.staged().map_or(1, fvi_fft::quadrature::StagedMethod::stages);
    let planes = responses(&MemoryRequest { coordinates: 1, ..request.clone() }, 0, length, tables)?;
    let given = planes.len() / (stages * stages);
    let transposed = |_: bool, count: usize| {
        let places = (0..stages).flat_map(|i| (0..stages).map(move |j| j * stages + i));
        let plane = |plane: usize| {
            let weights = planes[plane * given..][..given.min(count)].iter().copied();
            weights.chain(std::iter::repeat_n(0.0, count.saturating_sub(given)))
        };
        Ok(places.flat_map(plane).collect())
    };
    request.build_of_weights(stages, &transposed)
}

/// The derivatives of the weights by a parameter of the kernel, plane by plane, as far as a memory applies
/// them.
fn slopes(
    scenario: &Scenario,
    request: &MemoryRequest<'_>,
    by: &TransferDerivative,
) -> Result<Vec<f64>, EngineError> {
    let count = request.samples.saturating_add(1);
    if scenario.history.capacity.is_none() {
        return Ok(slope_weights(scenario, by, request.acts_on() != ActsOn::Values, count)?);
    }
    // A short memory drops the oldest samples: what it applies is seen from its answers.
    let (_, mut memory) = derivative_memory(scenario, request, by)?;
    let engine = memory.engine();
    let unserved = |_| EngineError::Unsuited { engine, reason: UNSERVED };
    let (stages, channels) = (memory.stages(), memory.channels());
    let mut planes = vec![0.0; stages * stages * request.samples];
    let (mut sample, mut term) = (vec![0.0; channels], vec![0.0; channels]);
    for s in 0..stages {
        memory.clear();
        for m in 0..request.samples {
            memory.next_term(&mut term).map_err(unserved)?;
            sample.fill(0.0);
            sample[s] = if m == 0 { 1.0 } else { 0.0 };
            for r in 0..stages {
                let weight = if m == 0 { memory.leading()[r * stages + s] } else { term[r] };
                planes[(r * stages + s) * request.samples + m] = weight;
            }
            memory.push(&sample).map_err(unserved)?;
        }
    }
    Ok(planes)
}
