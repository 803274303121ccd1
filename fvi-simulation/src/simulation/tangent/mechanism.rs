//! Derivatives of the discrete motion of a mechanism with respect to parameters of its scenario.

use super::mechanism_explicit::Explicit;
use super::mechanism_step::{
    Given, Knot, Node, Saddle, Step, add, add_transposed, add_vector, at, second, second_at, stays_on,
};
use super::{Differentiated, SINGULAR};
use crate::model::{Mechanism, coefficient_of, damped_coordinates};
use crate::simulation::mechanism::{
    Element, Integrator, Row, damper, dampers, integrator, start_slope_derivative,
};
use fvi_core::{
    Dampers, GaussLobatto, Instant, Lagrangian, StateError, StateReader, StateWriter, Stateful, max_or_nan,
};
use fvi_fft::dense::Factored;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Parameter, Quantity, ReportedMomentum, Scenario};
use nalgebra::DMatrix;

/// ∂q_k/∂θ and ∂p_k/∂θ of the discrete motion of a mechanism.
///
/// The equations of a step (`fvi-core/src/mechanism/step.rs`), differentiated, are linear in the derivatives
/// of their unknowns and have the matrix of Newton's method; with δ for ∂/∂θ and ∂_θ for the part at fixed
/// motion
///
/// ```text
/// δQ_i = δq + h Σ_j a_ij δV_j ,   δW_i = G_i δV_i + V_iᵀ∂²g δQ_i + ∂_θG_i V_i ,   δf = Z(∂_h) δW + ∂_θZ(∂_h) W
/// δY_i = ∂_q(L_q + F) δQ_i + ∂_v(L_q + F) δV_i + ∂_θ(L_q + F) − G_iᵀ δf_i − (f_i·∂²g) δQ_i − ∂_θG_iᵀ f_i
/// δI_j = (Λ_j·∂²c) δQ̃_j + C_jᵀ δΛ_j + ∂_θC_jᵀ Λ_j
/// 0 = L_vq δQ_i + L_vv δV_i + ∂_θL_v − δp − h Σ_j a_ij δY_j + h Σ_{j<s} â_ij δI_j
/// 0 = C_j δQ̃_j + ∂_θc(Q̃_j) ,   j = 1 … s
/// ```
///
/// Z acts on δW with a memory of its own, which begins with δW₀, and ∂_θZ on W. So the derivatives are those
/// of the computed numbers, up to rounding, not of the exact motion.
pub(super) struct OfMechanism {
    scenario: Scenario,
    /// The motion again, with what its steps were solved by.
    integrator: Integrator<f64>,
    system: Mechanism<f64>,
    /// W₀, and Z ∗ W for the forces of a step.
    first_rates: Vec<f64>,
    memory: Row<f64>,
    parameters: Vec<OfParameter>,
}

/// The derivatives by one parameter.
struct OfParameter {
    explicit: Explicit,
    position: Vec<f64>,
    momentum: Vec<f64>,
    /// δW₀, and that of the slope of W there.
    start: Vec<f64>,
    slope: Vec<f64>,
    /// The derivative of the momentum that is shown.
    shown: Vec<f64>,
    /// Z ∗ δW.
    memory: Row<f64>,
    /// ∂_θZ ∗ W of dampers, each with the index of its first elongation.
    changes: Vec<(usize, Element<f64>)>,
}

const OFF_CONSTRAINTS: &str = "with another value the motion would begin off the constraints: \
    `initial.project = true` moves it onto them";

const STIFFENED: &str =
    "a step was solved by stiffened corrections, whose matrix is not that of the derivatives";

/// Corrections of Newton's method beyond which steps are solved otherwise.
const MOST_CORRECTIONS: u32 = 40;

/// Reason why there are no derivatives by a parameter.
enum Refusal {
    Input(InputError),
    Start(&'static str),
}

impl From<InputError> for Refusal {
    fn from(error: InputError) -> Self {
        Self::Input(error)
    }
}

/// ∂_θZ ∗ W of the dampers that a parameter is in.
fn changes(
    scenario: &Scenario,
    rule: &GaussLobatto<f64>,
    what: &Quantity,
) -> Result<Vec<(usize, Element<f64>)>, InputError> {
    let (mut first, mut changes) = (0, Vec::new());
    for (index, term) in scenario.system.damping.iter().enumerate() {
        let rho = coefficient_of::<f64>(scenario, term);
        let count = rho.len().isqrt();
        if let Quantity::Coefficient(own, entries) = what
            && *own == index
        {
            let places =
                if term.along.is_some() { (0..count).collect() } else { damped_coordinates(scenario, term) };
            let place = |row: usize| places.iter().position(|&place| place == row);
            let mut change = vec![0.0; count * count];
            for &(row, column, entry) in entries {
                if let (Some(row), Some(column)) = (place(row), place(column)) {
                    change[row * count + column] += entry;
                }
            }
            changes.push((first, damper(scenario, rule, index, (None, change))?));
        }
        if let Some(by) = what.kernel(index) {
            changes.push((first, damper(scenario, rule, index, (Some(by), rho))?));
        }
        first += count;
    }
    Ok(changes)
}

impl OfMechanism {
    pub(super) fn new(scenario: &Scenario, parameters: &[Parameter]) -> Result<Self, InputError> {
        let integrator = integrator::<f64>(scenario)?;
        let system = integrator.system().clone().in_units_of_scenario();
        let mut made = Self {
            memory: dampers(scenario, integrator.rule())?,
            first_rates: Vec::new(),
            integrator,
            system,
            parameters: Vec::new(),
            scenario: scenario.clone(),
        };
        let mut start = vec![0.0; made.shape()[2]];
        made.start_rates(&mut start);
        made.memory.begin(&start);
        made.first_rates.clone_from(&start);
        for (index, Parameter { what, path }) in parameters.iter().enumerate() {
            let parameter = made.parameter((what, path), &start).map_err(|error| match error {
                Refusal::Input(error) => error,
                Refusal::Start(reason) => {
                    let path = format!("sensitivity.parameters[{index}]");
                    scenario.error_at(&path, Problem::Unusable { reason: reason.to_owned() })
                }
            })?;
            made.parameters.push(parameter);
        }
        made.show();
        Ok(made)
    }

    /// N, M, E.
    fn shape(&self) -> [usize; 3] {
        [self.system.coordinates(), self.system.constraints(), self.system.elongations()]
    }

    /// W₀.
    fn start_rates(&mut self, rates: &mut [f64]) {
        let mut elongating = vec![0.0; rates.len() * self.integrator.position().len()];
        self.system.elongate(self.integrator.position(), &mut elongating);
        add(1.0, &elongating, self.integrator.velocity(), rates);
    }

    fn parameter(&mut self, (what, path): (&Quantity, &str), start: &[f64]) -> Result<OfParameter, Refusal> {
        let mut explicit = Explicit::new(&self.scenario, what);
        let [position, velocity] = self.begin(what, &mut explicit)?;
        let [n, _, e] = self.shape();
        let node = second(&mut self.system, self.integrator.position(), self.integrator.velocity());
        let mut momentum = vec![0.0; n];
        add(1.0, &node.coupling, &position, &mut momentum);
        add(1.0, &node.mass, &velocity, &mut momentum);
        explicit.add_momentum(1.0, &node.position, &node.velocity, &mut momentum);
        let (mut elongating, mut turning) = (vec![0.0; e * n], vec![0.0; e * n]);
        self.system.elongate(&node.position, &mut elongating);
        let idle = &mut vec![0.0; n * n];
        self.system.turn(&node.position, &node.velocity, &vec![0.0; e], &mut turning, idle);
        let mut rates = vec![0.0; e];
        add(1.0, &elongating, &velocity, &mut rates);
        add(1.0, &turning, &position, &mut rates);
        elongating.fill(0.0);
        explicit.elongate(&node.position, &mut elongating);
        add(1.0, &elongating, &node.velocity, &mut rates);
        let mut memory = dampers(&self.scenario, self.integrator.rule())?;
        memory.begin(&rates);
        let mut changes = changes(&self.scenario, self.integrator.rule(), what)?;
        for (first, change) in &mut changes {
            change.begin(&start[*first..]);
        }
        let shown = momentum.clone();
        let slope = match self.shows_own_momentum() {
            true => vec![0.0; e],
            false => start_slope_derivative(&self.scenario, path)?,
        };
        Ok(OfParameter { explicit, position, momentum, start: rates, slope, shown, memory, changes })
    }

    /// δq and δv at the start, on the constraints.
    fn begin(&mut self, what: &Quantity, explicit: &mut Explicit) -> Result<[Vec<f64>; 2], Refusal> {
        let [n, m, _] = self.shape();
        let (scenario, system) = (&self.scenario, &mut self.system);
        let unit = |index: usize| {
            let mut unit = vec![0.0; n];
            unit[index] = 1.0;
            unit
        };
        let mut at = scenario.initial.position.clone();
        let velocity = scenario.initial_velocity().ok_or(Refusal::Start(SINGULAR))?;
        let mut position = if let Quantity::Position(index) = *what { unit(index) } else { vec![0.0; n] };
        let slope = if scenario.document().has("initial.velocity") {
            if let Quantity::Velocity(index) = *what { unit(index) } else { vec![0.0; n] }
        } else {
            let mut right = if let Quantity::Momentum(index) = *what { unit(index) } else { vec![0.0; n] };
            let node = second(system, &at, &velocity);
            add(-1.0, &node.coupling, &position, &mut right);
            explicit.add_momentum(-1.0, &at, &velocity, &mut right);
            let mut column = DMatrix::from_column_slice(n, 1, &right);
            let mass = DMatrix::from_row_slice(n, n, &node.mass);
            Factored::new(mass).ok_or(Refusal::Start(SINGULAR))?.solve(&mut column);
            column.as_slice().to_vec()
        };
        if m == 0 {
            return Ok([position, slope]);
        }
        let constrained = |system: &mut Mechanism<f64>, at: &[f64], right: [&[f64]; 2]| {
            Saddle::new(system, at, right).ok_or(Refusal::Start(SINGULAR))
        };
        if !scenario.initial.project {
            let stays = stays_on(system, explicit, (&at, &velocity), (&position, &slope));
            return if stays { Ok([position, slope]) } else { Err(Refusal::Start(OFF_CONSTRAINTS)) };
        }
        let mut last = f64::MAX;
        for _ in 0..50 {
            let (mut values, mut gradients) = (vec![0.0; m], vec![0.0; m * n]);
            system.constrain(&at, &mut values, &mut gradients);
            let size = values.iter().fold(0.0, |most, value| max_or_nan(most, value.abs()));
            let right: Vec<f64> = values.iter().map(|value| -value).collect();
            let saddle = constrained(system, &at, [&vec![0.0; n], &right])?;
            let mut rates = vec![0.0; m];
            let mut parts = vec![0.0; m * n];
            explicit.constrain(&at, &mut rates, &mut parts);
            add(1.0, &gradients, &position, &mut rates);
            rates.iter_mut().for_each(|rate| *rate = -*rate);
            let [change, _] = saddle.slope(explicit, &position, (vec![0.0; n], rates));
            add_vector(1.0, &change, &mut position);
            // The last correction leaves the position as it is, and gives its derivative.
            if size == 0.0 || (size < 1e-6 && size >= last) {
                break;
            }
            last = size;
            add_vector(1.0, saddle.value().0, &mut at);
        }
        let node = second(system, &at, &velocity);
        let still = second(system, &at, &vec![0.0; n]);
        let (mut right, mut top) = (vec![0.0; n], vec![0.0; n]);
        add(1.0, &node.mass, &velocity, &mut right);
        add(1.0, &node.mass, &slope, &mut top);
        add(1.0, &node.coupling, &position, &mut top);
        add(-1.0, &still.coupling, &position, &mut top);
        explicit.add_momentum(1.0, &at, &velocity, &mut top);
        explicit.add_momentum(-1.0, &at, &vec![0.0; n], &mut top);
        let saddle = constrained(system, &at, [&right, &vec![0.0; m]])?;
        let [slope, _] = saddle.slope(explicit, &position, (top, vec![0.0; m]));
        Ok([position, slope])
    }
}

impl OfMechanism {
    /// Linearises the step to come, whose beginning and unknowns are those of the integrator: before it.
    fn linearise(&mut self, start: &[f64], time: f64) -> Step {
        let ([n, m, e], rule, length) = (self.shape(), *self.integrator.rule(), self.scenario.time.step);
        let s = rule.stages();
        let (velocities, unit) = (self.integrator.solution(), self.integrator.system().unit());
        let multipliers: Vec<f64> =
            self.integrator.multipliers().iter().map(|number| unit * number).collect();
        let moved = |weight: &dyn Fn(usize) -> f64| {
            let mut position = start.to_vec();
            (0..s).for_each(|j| add_vector(length * weight(j), at(velocities, n, j), &mut position));
            position
        };
        let positions: Vec<_> = (0..s).map(|i| moved(&|j| rule.matrix(i, j))).collect();
        let knots = (0..if m == 0 { 0 } else { s + 1 }).map(|j| moved(&|k| rule.at_knot(j, k)));
        let knots: Vec<_> = knots.collect();
        let mut leading = vec![0.0; e * s * e * s];
        for (row, line) in leading.chunks_exact_mut((e * s).max(1)).enumerate() {
            for (column, place) in line.iter_mut().enumerate() {
                *place = self.memory.leading([row / s, column / s], [row % s, column % s]);
            }
        }
        let system = &mut self.system;
        let mut rates = vec![0.0; e * s];
        let mut elongating = vec![vec![0.0; e * n]; s];
        for (i, jacobian) in elongating.iter_mut().enumerate() {
            system.elongate(&positions[i], jacobian);
            let mut own = vec![0.0; e];
            add(1.0, jacobian, at(velocities, n, i), &mut own);
            own.iter().enumerate().for_each(|(index, &rate)| rates[index * s + i] = rate);
        }
        let mut pulls = vec![0.0; e * s];
        self.memory.known(&mut pulls);
        add(1.0, &leading, &rates, &mut pulls);
        let mut step =
            Step { rule, shape: [n, m, e], time, length, leading, nodes: Vec::new(), knots: Vec::new() };
        for (i, elongating) in elongating.into_iter().enumerate() {
            let mut node = second_at(system, step.instant(i), &positions[i], at(velocities, n, i));
            node.elongating = elongating;
            node.turning = vec![0.0; e * n];
            node.forces = (0..e).map(|index| pulls[index * s + i]).collect();
            let Node { position, velocity, forces, turning, stiffness, .. } = &mut node;
            system.turn(position, velocity, forces, turning, stiffness);
            step.nodes.push(node);
        }
        for (j, position) in knots.into_iter().enumerate() {
            let (mut values, mut gradients) = (vec![0.0; m], vec![0.0; m * n]);
            system.constrain(&position, &mut values, &mut gradients);
            let multipliers = if j < s { at(&multipliers, m, j).to_vec() } else { vec![0.0; m] };
            let mut curvature = vec![0.0; n * n];
            system.add_constraint_curvature(&position, &multipliers, 1.0, &mut curvature);
            step.knots.push(Knot { position, gradients, multipliers, curvature });
        }
        self.memory.push(&rates);
        self.parameters.iter_mut().flat_map(|parameter| &mut parameter.changes).for_each(
            |(first, change)| {
                let count = change.elongations() * s;
                change.push(&rates[*first * s..][..count]);
            },
        );
        step
    }

    /// The momentum at the end of a step without the last multipliers.
    fn unconstrained(&mut self, step: &Step, momentum: &[f64], input: &[f64]) -> Vec<f64> {
        let [n, ..] = step.shape;
        let (h, mut sum) = (step.length, momentum.to_vec());
        for (i, node) in step.nodes.iter().enumerate() {
            let (mut own, mut force) = (vec![0.0; n], vec![0.0; n]);
            self.system.first(step.instant(i), &node.position, &node.velocity, &mut own, &mut force);
            add_vector(1.0, input, &mut force);
            add_transposed(-1.0, &node.elongating, &node.forces, &mut force);
            add_vector(h * step.rule.weight(i), &force, &mut sum);
        }
        for (j, knot) in step.knots.iter().enumerate().take(step.rule.stages()) {
            let factor = -h * step.rule.knot_weight(j);
            add_transposed(factor, &knot.gradients, &knot.multipliers, &mut sum);
        }
        sum
    }

    fn make(&mut self, step: usize) -> Result<(), String> {
        let input = self.scenario.input_over(step).to_vec();
        let (position, momentum) = (self.integrator.position().to_vec(), self.integrator.momentum().to_vec());
        let time = self.integrator.time();
        let length = self.scenario.time.step;
        let begun =
            |memory: &mut dyn Dampers<f64>| memory.begin_step(length).map_err(|error| error.to_string());
        begun(&mut self.memory)?;
        let mut known = Vec::new();
        for parameter in &mut self.parameters {
            begun(&mut parameter.memory)?;
            for (_, change) in &mut parameter.changes {
                begun(change)?;
            }
        }
        let corrections = self.integrator.step(&input).map_err(|error| error.to_string())?;
        if corrections > MOST_CORRECTIONS {
            return Err(STIFFENED.to_owned());
        }
        let (s, [n, m, e]) = (self.integrator.rule().stages(), self.shape());
        // What ∂_θZ leaves, before its memories take the step.
        for parameter in &self.parameters {
            let mut forces = vec![0.0; e * s];
            parameter.memory.known(&mut forces);
            for (first, change) in &parameter.changes {
                let mut own = vec![0.0; change.elongations() * s];
                Dampers::known(change, &mut own);
                add_vector(1.0, &own, &mut forces[first * s..]);
            }
            known.push(forces);
        }
        let step = self.linearise(&position, time);
        let before = self.unconstrained(&step, &momentum, &input);
        let factored = step.factor().ok_or(SINGULAR)?;
        let end = self.integrator.position().to_vec();
        let mut right = before;
        let (mut still, mut idle) = (vec![0.0; n], vec![0.0; n]);
        let instant = Instant::in_step(time, 0.5, length);
        self.system.first(instant, &end, &vec![0.0; n], &mut still, &mut idle);
        add_vector(-1.0, &still, &mut right);
        let saddle = match m {
            0 => None,
            _ => Some(Saddle::new(&mut self.system, &end, [&right, &vec![0.0; m]]).ok_or(SINGULAR)?),
        };
        let coupling = second(&mut self.system, &end, &vec![0.0; n]).coupling;
        for (parameter, known) in self.parameters.iter_mut().zip(known) {
            let given = parameter.given(&step, known);
            let still = vec![0.0; s * (n + m)];
            let right: Vec<f64> = step.respond(&given, &still).residual.iter().map(|r| -r).collect();
            let mut column = DMatrix::from_column_slice(right.len(), 1, &right);
            factored.solve(&mut column);
            let found = step.respond(&given, column.as_slice());
            parameter.memory.push(&found.rates);
            (parameter.position, parameter.momentum) = (found.position, found.momentum);
            let OfParameter { explicit, position, momentum, .. } = parameter;
            if let Some(saddle) = &saddle {
                let mut top = momentum.clone();
                add(-1.0, &coupling, position, &mut top);
                explicit.add_momentum(-1.0, &end, &vec![0.0; n], &mut top);
                let [_, pulled] = saddle.slope(explicit, position, (top, vec![0.0; m]));
                add_vector(-1.0, &pulled, momentum);
            }
            if !momentum.iter().chain(&*position).all(|number| number.is_finite()) {
                return Err(SINGULAR.to_owned());
            }
        }
        self.show();
        Ok(())
    }

    /// True if the momenta that are shown are those of the scheme.
    fn shows_own_momentum(&self) -> bool {
        self.scenario.output.momentum != ReportedMomentum::Mean || self.shape()[2] == 0
    }

    /// The derivatives of the momenta with the excess of the dampers' impulse, where these are shown.
    fn show(&mut self) {
        let [n, m, e] = self.shape();
        for parameter in &mut self.parameters {
            parameter.shown.clone_from(&parameter.momentum);
        }
        if self.shows_own_momentum() {
            return;
        }
        let position = self.integrator.position().to_vec();
        let mut excess = vec![0.0; e];
        let first_slopes = self.integrator.slope().to_vec();
        self.memory.excess([&self.first_rates, &first_slopes], &mut excess);
        let (mut elongating, mut bent, mut idle) = (vec![0.0; e * n], vec![0.0; n * n], vec![0.0; e * n]);
        self.system.elongate(&position, &mut elongating);
        // −Σ δ ∂²g.
        self.system.turn(&position, &vec![0.0; n], &excess, &mut idle, &mut bent);
        let mut kick = vec![0.0; n];
        add_transposed(1.0, &elongating, &excess, &mut kick);
        let Some(saddle) = Saddle::new(&mut self.system, &position, [&kick, &vec![0.0; m]]) else { return };
        for parameter in &mut self.parameters {
            let OfParameter { explicit, position: change, start, slope, shown, memory, changes, .. } =
                parameter;
            let mut pushed = vec![0.0; e];
            memory.excess([start, slope], &mut pushed);
            for (first, of_change) in changes {
                let mut own = vec![0.0; of_change.elongations()];
                let begun = [&self.first_rates[*first..], &first_slopes[*first..]];
                Dampers::excess(of_change, begun, &mut own);
                add_vector(1.0, &own, &mut pushed[*first..]);
            }
            let (mut parts, mut top) = (vec![0.0; e * n], vec![0.0; n]);
            explicit.elongate(&position, &mut parts);
            add_transposed(1.0, &elongating, &pushed, &mut top);
            add_transposed(1.0, &parts, &excess, &mut top);
            add(-1.0, &bent, change, &mut top);
            let [_, pulled] = saddle.slope(explicit, change, (top.clone(), vec![0.0; m]));
            add_vector(1.0, &top, shown);
            add_vector(-1.0, &pulled, shown);
        }
    }
}

impl OfParameter {
    /// What the derivatives of a step follow from.
    fn given(&mut self, step: &Step, mut known: Vec<f64>) -> Given {
        let ([n, m, e], s) = (step.shape, step.rule.stages());
        // ∂_θZ₀ W is known.
        for (first, change) in &self.changes {
            let count = change.elongations();
            for (row, i) in (0..count).flat_map(|row| (0..s).map(move |i| (row, i))) {
                for (column, j) in (0..count).flat_map(|column| (0..s).map(move |j| (column, j))) {
                    let node = &step.nodes[j];
                    let jacobian = at(&node.elongating, n, first + column);
                    let rate: f64 = jacobian.iter().zip(&node.velocity).map(|(g, v)| g * v).sum();
                    known[(first + row) * s + i] += change.leading([row, column], [i, j]) * rate;
                }
            }
        }
        let (mut momenta, mut forces) = (vec![0.0; s * n], vec![0.0; s * n]);
        let mut elongating = vec![0.0; s * e * n];
        for (i, node) in step.nodes.iter().enumerate() {
            let (position, velocity) = (&node.position, &node.velocity);
            self.explicit.add_momentum(1.0, position, velocity, &mut momenta[i * n..][..n]);
            self.explicit.add_force(step.instant(i), position, velocity, &mut forces[i * n..][..n]);
            self.explicit.elongate(position, &mut elongating[i * e * n..][..e * n]);
        }
        let (mut values, mut gradients) = (vec![0.0; (s + 1) * m], vec![0.0; (s + 1) * m * n]);
        for (j, knot) in step.knots.iter().enumerate() {
            let (own, rows) = (&mut values[j * m..][..m], &mut gradients[j * m * n..][..m * n]);
            self.explicit.constrain(&knot.position, own, rows);
        }
        let (position, momentum) = (self.position.clone(), self.momentum.clone());
        Given { position, momentum, known, momenta, forces, elongating, values, gradients }
    }
}

impl Differentiated for OfMechanism {
    fn advance(&mut self, step: usize, _: (&[f64], &[f64]), _: &[f64]) -> Result<(), String> {
        self.make(step)
    }

    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), StateError> {
        let begin = bytes.len();
        let memories = self.memories();
        let numbers = 2 * self.parameters.len() * self.scenario.coordinates();
        let length: usize = memories.iter().map(|memory| memory.state_bytes()).sum();
        bytes.resize(begin + self.integrator.state_bytes() + length + numbers * 8, 0);
        let mut writer = StateWriter::new(&mut bytes[begin..]);
        self.integrator.save(&mut writer)?;
        memories.iter().try_for_each(|memory| memory.save(&mut writer))?;
        for parameter in &self.parameters {
            writer.numbers(&parameter.position)?;
            writer.numbers(&parameter.momentum)?;
        }
        let length = begin + writer.written();
        bytes.truncate(length);
        Ok(())
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let mut reader = StateReader::new(bytes);
        self.integrator.restore(&mut reader)?;
        self.memory.restore(&mut reader)?;
        for parameter in &mut self.parameters {
            parameter.memory.restore(&mut reader)?;
            parameter.changes.iter_mut().try_for_each(|(_, change)| change.restore(&mut reader))?;
        }
        for parameter in &mut self.parameters {
            reader.numbers(&mut parameter.position)?;
            reader.numbers(&mut parameter.momentum)?;
        }
        self.show();
        reader.finish()
    }

    fn write(&self, values: &mut Vec<f64>) {
        values.clear();
        for parameter in &self.parameters {
            values.extend(parameter.position.iter().chain(&parameter.shown));
        }
    }
}

impl OfMechanism {
    /// All memories, in the order of a saved state.
    fn memories(&self) -> Vec<&dyn Stateful> {
        let mut memories: Vec<&dyn Stateful> = vec![&self.memory];
        for OfParameter { memory, changes, .. } in &self.parameters {
            memories.push(memory);
            memories.extend(changes.iter().map(|(_, change)| change as &dyn Stateful));
        }
        memories
    }
}
