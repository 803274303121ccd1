//! Detection of energy that grows without work done on the system.

use crate::column::{highest, lowest};
use crate::model::tape::CompiledForce;
use crate::model::{Loads, Mechanism, RoughForces, without_dampers};
use crate::simulation::stability;
use crate::simulation::step_batch::StepBatch;
use crate::simulation::{GridState, Precision};
use fvi_core::{Instant, Lagrangian, NodalRule};
use fvi_fft::dense;
use fvi_fft::transfer::TransferFunction;
use fvi_scenario::language::expression::Moment;
use fvi_scenario::scenario::{Derivative, OnEnergyGrowth, Scenario, SharedTerms, SymmetricMatrix};
use nalgebra::Complex;
use serde::{Deserialize, Serialize};

/// Largest relative loss of energy of a motion without damping, on steps known in advance and, in units of
/// their tolerance, on adaptive ones.
const LOST: f64 = 0.1;
const LOST_IN_TOLERANCES: f64 = 1e4;

/// The same for the energy of a mechanism together with what its dampers have taken up, which a step of Gauss
/// weights keeps up to its error; in either direction.
const CHANGED: f64 = 0.02;

/// Largest rise of the energy, as a multiple of the initial energy and the work.
const FACTOR: f64 = 1000.0;

/// Energy of a mechanism at rest that is taken for rounding, as of a start moved onto its constraints.
const ROUNDING: f64 = 1e-40;

/// ρ x, K(s) and j of the force ρ x L⁻¹[K(s)/s^{1+j}](t).
type Push = (Vec<f64>, TransferFunction, f64);

/// Compares the energy of a run with the initial energy and the work of forces since.
///
/// The check of the step before the run is that of the motion linearised at the start. If the potential is
/// not quadratic, a step can be too long elsewhere, and the energy then grows without work. Damping only
/// takes energy, so
///
/// ```text
/// E_k − E₀ ≤ W_k ,    W_k = Σ h |F·v| + Σ h |u·v| + work of the memory's initial forces
/// ```
///
/// up to the error of the scheme. The guard trips if E_k − E₀ exceeds a thousand times T₀ + max(|U₀|, U₀ −
/// min U) + W_k, with the kinetic energy T and the potential U: a rise that cannot be due to a constant in U,
/// a fall into a well or resonance. Forces are evaluated at the nodes of the scheme, with corrections where
/// they are rough between nodes, and the displacement is the larger of Δq and h v at both ends of the step.
/// For a force F(t, q, v) this is F(t, q, 0) only; the remainder R = F(t, q, v) − F(t, q, 0) counts with its
/// power R·v if that is positive: drag does not count at all, a driving force with its work.
/// Velocity-dependent forces in code count as a whole. The memory of a Riemann–Liouville derivative exerts up
/// to |ρ q₀| t^{−β}, that of Caputo's for β > 1 up to |ρ v₀| t^{1−β}; for β = 0 it is a spring with the
/// energy ½ q₀ᵀρ q₀.
///
/// With a mass matrix from a file each velocity would require the solution of equations. The diagonal matrix
/// L of the sums of |m_ij| over rows is used instead: M ≤ L, so that ½ pᵀL⁻¹p is a lower bound of T. The
/// energy is computed only if that bound alone exceeds the limit.
///
/// The mass at the start is not that of a mechanism elsewhere: T is E + L(q, 0) there, and speeds are
/// 2T/Σ|p|. The step of a mechanism is not checked before the run, but what its memories have taken up, A_k,
/// is known, and constraints do no work: it warns when E_k + A_k − E₀ has left [−W_k, W_k] by a part of the
/// energy that there was.
pub struct EnergyGuard {
    reaction: OnEnergyGrowth,
    start: f64,
    inverse_mass: SymmetricMatrix,
    /// True if the inverse is that of the larger, diagonal mass instead of the system's.
    is_lumped: bool,
    /// The mechanism, whose energy at rest is the potential.
    potential: Option<Box<Mechanism<f64>>>,
    /// Forces that the initial state exerts through the memory.
    pushes: Vec<Push>,
    first_energy: f64,
    first_potential: f64,
    lowest_potential: f64,
    /// Kinetic energy at the start, and the energy in damping terms of order 0, which are springs; of a
    /// mechanism with what rounding makes of its potential there.
    stored: f64,
    rounding: f64,
    /// True if forces or the initial state can do work; if not, positions and velocities are not stored.
    is_driven: bool,
    work: f64,
    /// What forces that depend on velocities have taken from the energy, by an upper bound.
    dragged: f64,
    time: f64,
    position: Vec<f64>,
    velocity: Vec<f64>,
    /// The velocity at the end of the step.
    new_velocity: Vec<f64>,
    force: Option<Forces>,
    /// Rough forces, and a buffer for their moments in a step.
    rough: Option<(RoughForces, Vec<f64>)>,
    /// Forces in code, and a buffer for the largest of a step.
    own: Option<(SharedTerms, Vec<f64>)>,
    /// Fractions of a step at which the scheme evaluates forces; of a mechanism, start, middle and end.
    nodes: Vec<f64>,
    warning: Option<String>,
    /// Fraction of the energy that may be lost if nothing dissipates any; `None` if something may.
    may_lose: Option<f64>,
    /// Warning that more was lost.
    lost: Option<String>,
    /// What memories have taken up until the last state, where it counts.
    absorbed: f64,
    /// Twice the kinetic energies of a batch, then its potential energies.
    heights: Vec<f64>,
    /// Buffer for a state of a batch.
    state: GridState,
}

/// State of a guard.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gathered {
    lowest_potential: f64,
    work: f64,
    #[serde(default)]
    dragged: f64,
    warning: Option<String>,
    lost: Option<String>,
}

impl EnergyGuard {
    /// A guard for a run of the scenario from this state.
    pub fn new(scenario: &Scenario, precision: Precision, start: &GridState) -> Self {
        // Linear systems are covered by the check of the step; equations have no energy.
        if !scenario.cases.is_empty() || scenario.equation.is_some() {
            return Self::blind();
        }
        let mut potential = resting(scenario);
        // Zero for coordinates without mass.
        let inverse = |mass: f64| if mass == 0.0 { 0.0 } else { mass.recip() };
        let inverse_mass = match &scenario.system.mass {
            _ if potential.is_some() => SymmetricMatrix::Diagonal(vec![0.0; scenario.coordinates()]),
            SymmetricMatrix::Diagonal(masses) => {
                SymmetricMatrix::Diagonal(masses.iter().map(|&mass| inverse(mass)).collect())
            }
            SymmetricMatrix::Dense(mass) => {
                let mut regular = mass.clone();
                // Momenta of coordinates without mass are zero.
                scenario.system.massless().into_iter().for_each(|row| regular[(row, row)] = 1.0);
                // The integrator has factored it: an energy that is no number would show the opposite.
                let unknown = || nalgebra::DMatrix::from_element(mass.nrows(), mass.nrows(), f64::NAN);
                SymmetricMatrix::Dense(dense::inverse(regular).unwrap_or_else(unknown))
            }
            // Linear motions that are stable at every step.
            SymmetricMatrix::Sparse(_) if stability::is_unconditional(scenario) => return Self::blind(),
            SymmetricMatrix::Sparse(mass) => SymmetricMatrix::Diagonal(
                mass.pattern
                    .rows()
                    .map(|slots| inverse(mass.values[slots].iter().map(|entry| entry.abs()).sum()))
                    .collect(),
            ),
        };
        let is_lumped = potential.is_none() && matches!(scenario.system.mass, SymmetricMatrix::Sparse(_));
        let velocity = inverse_mass.times(&start.momentum);
        let kinetic = match &mut potential {
            Some(potential) => start.energy - height(potential, &start.position),
            None => 0.5 * dot(&start.momentum, &velocity),
        };
        let rounding = match &mut potential {
            Some(mechanism) => precision.epsilon() * force_times_place(mechanism, start) + ROUNDING,
            None => 0.0,
        };
        let (pushes, springs) = match potential {
            Some(_) => (Vec::new(), 0.0),
            None => exerted_by_start(scenario, start, &velocity),
        };
        let force = Forces::of(scenario);
        let own = scenario.system.own_terms.clone().map(|terms| (terms, vec![0.0; scenario.coordinates()]));
        let is_driven = force.is_some()
            || own.is_some()
            || scenario.input.is_some()
            || !scenario.controllers.is_empty()
            || !pushes.is_empty();
        let first_potential = start.energy - kinetic;
        // A past stored in memories and kernels that drive may add energy that is not accounted for here.
        let adds = scenario.initial.past.is_some()
            || scenario.system.damping.iter().any(|term| term.active().is_some());
        let reaction = match scenario.time.energy_guard {
            None if adds => OnEnergyGrowth::Ignore,
            _ => scenario.time.on_energy_growth(),
        };
        Self {
            reaction,
            start: start.time,
            inverse_mass,
            is_lumped,
            pushes,
            first_energy: start.energy,
            first_potential,
            lowest_potential: first_potential,
            stored: kinetic + springs + rounding,
            rounding,
            is_driven,
            work: 0.0,
            dragged: 0.0,
            time: start.time,
            position: start.position.clone(),
            new_velocity: velocity.clone(),
            velocity,
            force,
            rough: RoughForces::of(scenario).map(|rough| (rough, vec![0.0; 2 * scenario.coordinates()])),
            own,
            nodes: match potential {
                Some(_) => vec![0.0, 0.5, 1.0],
                None => stability::force_nodes(scenario),
            },
            may_lose: may_lose(scenario, potential.is_some()).filter(|_| !is_driven || potential.is_some()),
            potential,
            lost: None,
            absorbed: 0.0,
            warning: None,
            heights: Vec::new(),
            state: start.clone(),
        }
    }

    /// Its state.
    pub(crate) fn gathered(&self) -> Gathered {
        let &Self { lowest_potential, work, dragged, .. } = self;
        let (warning, lost) = (self.warning.clone(), self.lost.clone());
        Gathered { lowest_potential, work, dragged, warning, lost }
    }

    /// Continues from a later state with the state of another guard of the same run.
    pub(crate) fn resume(&mut self, gathered: Gathered, state: &GridState) {
        let Gathered { lowest_potential, work, dragged, warning, lost } = gathered;
        (self.lowest_potential, self.work, self.dragged) = (lowest_potential, work, dragged);
        (self.warning, self.lost) = (warning, lost);
        if self.position.is_empty() {
            // The guard is disabled.
            return;
        }
        self.time = state.time;
        self.position.copy_from_slice(&state.position);
        self.inverse_mass.write_times(&state.momentum, &mut self.velocity);
    }

    /// A guard that never trips.
    fn blind() -> Self {
        Self {
            reaction: OnEnergyGrowth::Ignore,
            start: 0.0,
            inverse_mass: SymmetricMatrix::Diagonal(Vec::new()),
            is_lumped: false,
            potential: None,
            pushes: Vec::new(),
            first_energy: 0.0,
            first_potential: 0.0,
            lowest_potential: 0.0,
            stored: 0.0,
            rounding: 0.0,
            is_driven: false,
            work: 0.0,
            dragged: 0.0,
            time: 0.0,
            position: Vec::new(),
            velocity: Vec::new(),
            new_velocity: Vec::new(),
            force: None,
            rough: None,
            own: None,
            nodes: Vec::new(),
            may_lose: None,
            lost: None,
            absorbed: 0.0,
            warning: None,
            heights: Vec::new(),
            state: GridState::default(),
        }
    }

    /// What the memories of a mechanism have taken up until the state that is examined next.
    pub(crate) fn absorb(&mut self, absorbed: f64) {
        self.absorbed = absorbed;
    }

    /// Examines the states of a batch, whose first step began at the time `begin`; `input` returns the input
    /// held over the step that began at a given time. Returns the state at which the run must stop, if it
    /// must, and the reason.
    pub(crate) fn take_along<'a>(
        &mut self,
        batch: &StepBatch,
        begin: f64,
        input: impl Fn(usize, f64) -> &'a [f64],
    ) -> Option<(usize, String)> {
        if self.is_done() || self.take_without_rise(batch) {
            return None;
        }
        let mut state = std::mem::take(&mut self.state);
        let mut from = begin;
        let found = (0..batch.len()).find_map(|index| {
            batch.read(index, &mut state);
            let reason = self.take(input(index, from), &state);
            from = state.time;
            reason.map(|reason| (index, reason))
        });
        self.state = state;
        found
    }

    /// Examines a batch as a whole if nothing drives the motion and no energy exceeds the bound; returns
    /// whether it did.
    ///
    /// The bound only grows, with the fall of the potential: an energy below the bound before the batch is
    /// below it after every step.
    fn take_without_rise(&mut self, batch: &StepBatch) -> bool {
        let SymmetricMatrix::Diagonal(inverse) = &self.inverse_mass else { return false };
        if self.potential.is_some() {
            return false;
        }
        // Beyond the bound, or not a number.
        let within = highest(batch.energies()) - self.first_energy <= FACTOR * self.explained();
        if self.is_driven || !within {
            return false;
        }
        self.heights.clear();
        self.heights.resize(batch.len(), 0.0);
        for (momentum, inverse) in batch.momenta().zip(inverse) {
            self.heights.iter_mut().zip(momentum).for_each(|(sum, p)| *sum += p * (inverse * p));
        }
        self.heights.iter_mut().zip(batch.energies()).for_each(|(height, energy)| {
            *height = energy - 0.5 * *height;
        });
        self.lowest_potential = self.lowest_potential.min(lowest(&self.heights));
        if let (Some(&energy), Some(&time)) = (batch.energies().last(), batch.times().last()) {
            self.judge_loss(energy, time);
        }
        true
    }

    /// True if no further check is needed.
    fn is_done(&self) -> bool {
        self.reaction == OnEnergyGrowth::Ignore || self.warning.is_some()
    }

    /// Upper bound of the energy explained by the initial state and the work.
    fn explained(&self) -> f64 {
        let fall = self.first_potential - self.lowest_potential;
        self.stored + self.first_potential.abs().max(fall) + self.work
    }

    /// True if the energies of states are unknown and are requested only if needed.
    pub(crate) fn asks_for_energies(&self) -> bool {
        self.is_lumped
    }

    /// As [`take`](Self::take), for a state whose energy is computed only if it is needed.
    pub(crate) fn take_asking(
        &mut self,
        input: &[f64],
        state: &GridState,
        energy: impl FnOnce() -> f64,
    ) -> Option<String> {
        if self.is_done() {
            return None;
        }
        let kinetic = self.follow(input, state);
        if kinetic <= FACTOR * self.explained() || kinetic.is_nan() {
            return None;
        }
        self.judge(kinetic, energy(), state.time)
    }

    /// Examines the state after a step with this input; returns the reason to stop the run, if it must stop.
    pub fn take(&mut self, input: &[f64], state: &GridState) -> Option<String> {
        if self.is_done() {
            return None;
        }
        let kinetic = self.follow(input, state);
        self.judge(kinetic, state.energy, state.time)
    }

    /// Adds the work of a step to a state; returns the kinetic energy.
    fn follow(&mut self, input: &[f64], state: &GridState) -> f64 {
        let kinetic = match (&mut self.potential, &self.inverse_mass) {
            (Some(potential), _) => {
                let kinetic = state.energy - height(potential, &state.position);
                // p·v = 2T, as if all coordinates had one speed.
                let size: f64 = state.momentum.iter().map(|p| p.abs()).sum();
                let speed = if size > 0.0 { 2.0 * kinetic.abs() / size } else { 0.0 };
                self.new_velocity.fill(speed);
                kinetic
            }
            // Velocities are not needed themselves.
            (None, SymmetricMatrix::Diagonal(inverse)) if !self.is_driven => {
                0.5 * state.momentum.iter().zip(inverse).map(|(p, inverse)| p * (inverse * p)).sum::<f64>()
            }
            (None, inverse) => {
                inverse.write_times(&state.momentum, &mut self.new_velocity);
                0.5 * dot(&state.momentum, &self.new_velocity)
            }
        };
        if self.is_driven {
            self.work += self.work_of_step(input, state);
            self.time = state.time;
            self.position.copy_from_slice(&state.position);
            std::mem::swap(&mut self.velocity, &mut self.new_velocity);
        }
        kinetic
    }

    /// Compares the energy with its explained bound.
    fn judge(&mut self, kinetic: f64, energy: f64, time: f64) -> Option<String> {
        self.lowest_potential = self.lowest_potential.min(energy - kinetic);
        self.judge_loss(energy, time);
        let explained = self.explained();
        if energy - self.first_energy <= FACTOR * explained || energy.is_nan() {
            return None;
        }
        self.react(energy, time, explained)
    }

    /// Records a change of energy that dissipation and forces do not explain.
    fn judge_loss(&mut self, energy: f64, time: f64) {
        let Some(share) = self.may_lose.filter(|_| self.lost.is_none()) else { return };
        let there_was = self.stored + self.first_potential - self.lowest_potential + self.work;
        let all = energy + self.absorbed;
        let change = all - self.first_energy;
        let explained = if change < 0.0 { self.work + self.dragged } else { self.work };
        let counts = match self.potential {
            Some(_) => change.abs() - explained,
            None => -change,
        };
        let least = (f64::EPSILON.sqrt() * self.first_energy.abs()).max(FACTOR * self.rounding);
        if counts > share * there_was && counts > least {
            let how = if change < 0.0 { "fallen" } else { "risen" };
            let (with, reason) = match (self.is_driven, self.absorbed == 0.0) {
                (false, true) => ("", "though nothing damps or drives".to_owned()),
                (false, false) => {
                    (", with what the dampers have taken up,", "though nothing drives".to_owned())
                }
                (true, _) => (
                    ", with what dampers have taken up,",
                    format!("and forces explain no more than {explained:.3e}"),
                ),
            };
            self.lost = Some(format!(
                "the energy{with} has {how} by {:.2e} from {:.3e} at t = {time}, {reason}: the steps seem too long there",
                change.abs(),
                self.first_energy
            ));
        }
    }

    /// Reaction to an energy above the explained bound.
    #[cold]
    fn react(&mut self, energy: f64, time: f64, explained: f64) -> Option<String> {
        let reason = format!(
            "the energy has risen from {:.3e} to {energy:.3e} at t = {time}; start and forces explain no more than {explained:.3e}: \
             the step seems too long there (`time.energy_guard`)",
            self.first_energy
        );
        match self.reaction {
            OnEnergyGrowth::Stop => Some(reason),
            OnEnergyGrowth::Warn | OnEnergyGrowth::Ignore => {
                self.warning = Some(reason);
                None
            }
        }
    }

    /// The warning, if there is one.
    pub fn warning(&self) -> Option<&str> {
        self.warning.as_deref().or(self.lost.as_deref())
    }

    /// An upper bound of the work over the step to `state`.
    fn work_of_step(&mut self, input: &[f64], state: &GridState) -> f64 {
        let (from, to, step) = (&self.position, &state.position, state.time - self.time);
        let way = |index: usize| {
            let fastest = self.velocity[index].abs().max(self.new_velocity[index].abs());
            (to[index] - from[index]).abs().max(step * fastest)
        };
        let mut work: f64 = input.iter().enumerate().map(|(index, push)| push.abs() * way(index)).sum();
        for (push, transfer, integrals) in &self.pushes {
            // An approximation of L⁻¹[K(s)/s^{1+j}](t).
            let since = state.time - self.start;
            let rate = Complex::new(1.0 / since, 0.0);
            let fading = match transfer.table() {
                Some(table) => table.after_a_jump(since),
                None => transfer.value(rate).norm() * libm::pow(since, *integrals),
            };
            work +=
                fading * push.iter().enumerate().map(|(index, push)| push.abs() * way(index)).sum::<f64>();
        }
        if let (Some((rough, moment_correction)), Some(&node)) = (&mut self.rough, self.nodes.first()) {
            // With any nodes: ∫F is F at this node plus the sum of the two moment corrections.
            let (shapes, tests) = ([node], [1.0 - node]);
            let rule = NodalRule {
                start: self.time,
                length: step,
                weights: &[1.0],
                nodes: &[node],
                points: &[1.0],
                shapes: &shapes,
                tests: &tests,
            };
            if rough.moment_correction(&rule, moment_correction) {
                let moments = moment_correction.iter().enumerate();
                work += moments.map(|(index, moment)| moment.abs() * way(index % from.len())).sum::<f64>();
            }
        }
        if let Some((terms, largest)) = &mut self.own {
            // The largest values during the evaluations of the step itself, so that no further ones are
            // needed.
            terms.with(|terms| terms.take_largest_force(largest));
            work += largest.iter().enumerate().map(|(index, force)| force * way(index)).sum::<f64>();
        }
        let Some(Forces { force, moves, loads, registers, place, value, largest }) = &mut self.force else {
            return work;
        };
        let (mut gained, mut taken): (f64, f64) = (0.0, 0.0);
        largest.fill(0.0);
        for &node in &self.nodes {
            let moment = match node {
                0.0 => Moment::from_right(self.time),
                1.0 => Moment::from_left(state.time),
                _ => Moment::inside(self.time + node * step),
            };
            for ((place, from), to) in place.iter_mut().zip(from).zip(to) {
                *place = from + node * (to - from);
            }
            value.fill(0.0);
            if let Some(Moves { velocity, moved }) = moves {
                let ends = self.velocity.iter().zip(&self.new_velocity).zip(from.iter().zip(to));
                for (v, ((first, last), (from, to))) in velocity.iter_mut().zip(ends) {
                    *v = if self.is_lumped || self.potential.is_some() {
                        (to - from) / step
                    } else {
                        first + node * (last - first)
                    };
                }
                let count = velocity.len();
                place[count..].copy_from_slice(velocity);
                force.value(moment, place, registers, moved);
                place[count..].fill(0.0);
                force.value(moment, place, registers, value);
                if value.iter().all(|force| force.is_finite()) {
                    let added = moved.iter().zip(&*value).map(|(moved, still)| moved - still);
                    let power: f64 = added.zip(&*velocity).map(|(force, v)| force * v).sum();
                    gained = gained.max(step * power);
                    taken = taken.max(-step * power);
                } else {
                    // The force is not defined at rest.
                    value.copy_from_slice(moved);
                }
            } else if !force.is_zero() {
                force.value(moment, place, registers, value);
            }
            loads.add(moment, 1.0, value);
            for (largest, value) in largest.iter_mut().zip(&*value) {
                *largest = largest.max(value.abs());
            }
        }
        self.dragged += taken;
        work + gained + largest.iter().enumerate().map(|(index, force)| force * way(index)).sum::<f64>()
    }
}

/// Fraction of its energy that a motion of the scenario may lose if nothing dissipates any. Variational
/// schemes on steps known in advance lose none, their energy only oscillates; that of a mechanism is compared
/// all the same, since its step is never checked before the run, and what it dissipates is known.
fn may_lose(scenario: &Scenario, is_mechanism: bool) -> Option<f64> {
    if is_mechanism {
        // With as many constraints as coordinates nothing moves.
        return (scenario.system.constraints.len() < scenario.coordinates()).then_some(CHANGED);
    }
    if !scenario.system.damping.is_empty() {
        return None;
    }
    match scenario.time.adaptive() {
        Some(rule) => Some((LOST_IN_TOLERANCES * rule.tolerance).min(LOST)),
        None => scenario.scheme_descriptor().is_dissipative.then_some(LOST),
    }
}

/// What the initial state exerts through the memories: forces ρ x, K(s) and j, and the energy of springs.
fn exerted_by_start(scenario: &Scenario, start: &GridState, velocity: &[f64]) -> (Vec<Push>, f64) {
    let (mut pushes, mut springs) = (Vec::new(), 0.0);
    for term in &scenario.system.damping {
        let pulled = term.coefficient.times(&start.position);
        match term.derivative {
            Derivative::Caputo if term.transfer.exponent() == Some(0.0) => {
                springs += 0.5 * dot(&pulled, &start.position);
            }
            Derivative::Caputo if term.transfer.growth() > 1.0 => {
                pushes.push((term.coefficient.times(velocity), term.transfer.clone(), 1.0));
            }
            // Coordinates without mass may have jumped from where memories are at rest.
            Derivative::Caputo => {
                let jump: Vec<f64> =
                    start.position.iter().zip(scenario.initial.base()).map(|(to, from)| to - from).collect();
                if let (true, Some(modulus)) = (jump.iter().any(|&x| x != 0.0), term.transfer.unrelaxed()) {
                    springs += 0.5 * modulus.abs() * dot(&term.coefficient.times(&jump), &jump);
                }
            }
            Derivative::RiemannLiouville => pushes.push((pulled, term.transfer.clone(), 0.0)),
        }
    }
    // Terms without a force are dropped.
    pushes.retain(|(push, ..)| push.iter().any(|&push| push != 0.0));
    (pushes, springs)
}

/// The mechanism without its dampers; `None` for other systems.
fn resting(scenario: &Scenario) -> Option<Box<Mechanism<f64>>> {
    if !scenario.system.is_mechanism() {
        return None;
    }
    // The simulation has made the same model.
    Mechanism::new(&without_dampers(scenario)).ok().map(Box::new)
}

/// The energy at rest, −L(q, 0): U, less what L has beside it without a velocity, as in a rotating frame.
fn height(mechanism: &mut Mechanism<f64>, position: &[f64]) -> f64 {
    mechanism.energy(position, &vec![0.0; position.len()])
}

/// Σ |L_q| |q| at rest: what the potential is made of, however its terms cancel.
fn force_times_place(mechanism: &mut Mechanism<f64>, start: &GridState) -> f64 {
    let still = vec![0.0; start.position.len()];
    let (mut momentum, mut force) = (still.clone(), still.clone());
    let now = Instant::in_step(start.time, 0.0, 0.0);
    mechanism.first(now, &start.position, &still, &mut momentum, &mut force);
    force.iter().zip(&start.position).map(|(force, q)| (force * q).abs()).sum()
}

/// A velocity, and a velocity-dependent force there.
struct Moves {
    velocity: Vec<f64>,
    moved: Vec<f64>,
}

/// The external forces, with buffers for their evaluation.
struct Forces {
    force: CompiledForce<f64>,
    moves: Option<Moves>,
    loads: Loads<f64>,
    registers: Vec<f64>,
    place: Vec<f64>,
    value: Vec<f64>,
    largest: Vec<f64>,
}

impl Forces {
    /// The forces of a scenario, if there are any.
    fn of(scenario: &Scenario) -> Option<Self> {
        let components = scenario.system.force.as_deref().unwrap_or_default();
        let loads = Loads::new(&scenario.system.loads);
        if components.is_empty() && loads.is_empty() {
            return None;
        }
        let (count, zeros) = (scenario.coordinates(), || vec![0.0; scenario.coordinates()]);
        let force = CompiledForce::compile(components);
        let moves = scenario.system.force_in_words_depends_on_velocity();
        let place = vec![0.0; if moves { 2 * count } else { count }];
        let moves = moves.then(|| Moves { velocity: zeros(), moved: zeros() });
        Some(Self { force, moves, loads, registers: Vec::new(), place, value: zeros(), largest: zeros() })
    }
}

fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(left, right)| left * right).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::motion::Motion;
    use crate::simulation::{Precision, Simulation};
    use fvi_scenario::language::Document;
    use std::path::Path;

    /// Runs a scenario of one coordinate; returns the step at which the guard trips.
    fn trips(system: &str, start: [f64; 2], scheme: &str, time: &str) -> Option<usize> {
        let [q, p] = start;
        let text = format!(
            "[system]\nmass = [1.0]\n{system}\n[initial]\nposition = [{q:?}]\nmomentum = [{p:?}]\n\
             [scheme]\nkind = \"low-order\"\n{scheme}\n[time]\n{time}\n"
        );
        let scenario = Scenario::from_document(Document::new("test.toml", Path::new(""), &text)).unwrap();
        let mut simulation = Simulation::new(&scenario, Precision::F64).unwrap();
        let mut state = GridState { position: vec![0.0], momentum: vec![0.0], ..GridState::default() };
        simulation.read(&mut state);
        let mut guard = EnergyGuard::new(&scenario, Precision::F64, &state);
        (0..scenario.time.steps).find(|_| {
            simulation.step(&[]).unwrap();
            simulation.read(&mut state);
            guard.take(&[], &state).is_some()
        })
    }

    #[test]
    fn a_step_that_is_too_long_away_from_the_start_is_caught() {
        // At q = 3 the potential is repulsive, at the bottom h ω = 3.2.
        let pendulum = "potential = \"1000*(1-cos(q0))\"";
        assert!(trips(pendulum, [3.0, 0.0], "kappa = 0.0", "step = 0.1\nsteps = 3000").is_some());
        assert_eq!(trips(pendulum, [3.0, 0.0], "kappa = 0.0", "step = 0.01\nsteps = 3000"), None);
    }

    /// A delayed spring, K(s) = e^(−s): the motion grows with the root of s² + 4 + 0.1 e^(−s) = 0 at
    /// 0.0224 ± 1.98 i, as a user has admitted; who asks for the guard has it.
    #[test]
    fn motions_that_an_active_kernel_drives_may_grow() {
        let steps = |guard: &str| {
            let text = format!(
                "[system]\nmass = [1.0]\nstiffness = [4.0]\n[[system.damping]]\nkernel = {{ symbol = \"exp(-s)\" }}\n\
                 coefficient = [0.1]\nallow_active = true\n[initial]\nposition = [1.0]\n[time]\nstep = 0.02\nend = 200.0\n{guard}"
            );
            let scenario = Scenario::from_document(Document::new("test.toml", Path::new(""), &text)).unwrap();
            let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
            while !motion.is_done() && motion.advance().is_ok() {}
            motion.steps()
        };
        assert_eq!(steps(""), 10_000);
        assert!(steps("energy_guard = \"stop\"\n") < 10_000);
    }

    #[test]
    fn masses_from_files_are_watched_like_rows() {
        let place = tempfile::tempdir().unwrap();
        let entries = "1 1 1.0\n2 1 0.2\n2 2 1.0\n";
        let file = format!("%%MatrixMarket matrix coordinate real symmetric\n2 2 3\n{entries}");
        std::fs::write(place.path().join("mass.mtx"), file).unwrap();
        let steps = |mass: &str, system: &str, start: &str, step: f64, every: usize| {
            let text = format!(
                "[system]\nmass = {mass}\n{system}\n[initial]\nposition = {start}\nmomentum = [0.0, 0.0]\n[scheme]\nkind = \"low-order\"\n\
                 kappa = 0.0\n[time]\nstep = {step}\nsteps = 3000\n[output]\nevery = {every}\n"
            );
            let document = Document::new("test.toml", place.path(), &text);
            let scenario = Scenario::from_document(document).unwrap();
            let mut motion = Motion::start(&scenario, Precision::F64).unwrap();
            while !motion.is_done() {
                if let Err(failure) = motion.advance() {
                    assert!(failure.reason.contains("energy has risen"), "{}", failure.reason);
                    break;
                }
            }
            motion.steps()
        };
        let (rows, file) = ("[[1.0, 0.2], [0.2, 1.0]]", "\"mass.mtx\"");
        let pendulums = "potential = \"1000*(2 - cos(q0) - cos(q1))\"";
        // The energy may rise somewhat more before the lower bound of its kinetic part exceeds the limit.
        let (dense, sparse) =
            (steps(rows, pendulums, "[3.0, 3.0]", 0.1, 1), steps(file, pendulums, "[3.0, 3.0]", 0.1, 700));
        assert!(dense < 3000 && (dense..dense + 200).contains(&sparse), "{dense} {sparse}");
        assert_eq!(steps(file, pendulums, "[3.0, 3.0]", 0.01, 700), 3000);
        // A fall from U = 0, and a resonance.
        let well = "potential = \"q0^4 + q1^4 - 50*(q0^2 + q1^2)\"";
        assert_eq!(steps(file, well, "[1e-9, 1e-9]", 0.01, 700), 3000);
        let driven = "stiffness = \"mass.mtx\"\nforce = [\"sin(t)\", \"sin(t)\"]";
        assert_eq!(steps(file, driven, "[0.0, 0.0]", 0.05, 700), 3000);
    }

    #[test]
    fn energy_that_is_explained_is_let_pass() {
        // Resonance, a fall from an unstable equilibrium with U = 0, a constant in U, an impact on a system
        // at rest.
        let half = "kappa = 0.5";
        let time = "step = 0.05\nsteps = 4000";
        let driven = "potential = \"0.5*q0^2\"\nforce = [\"sin(t)\"]";
        assert_eq!(trips(driven, [0.0, 0.0], half, time), None);
        assert_eq!(trips("potential = \"-0.5*q0^2\"", [1e-6, 0.0], half, "step = 0.05\nsteps = 600"), None);
        assert_eq!(
            trips("potential = \"q0^4 - 50*q0^2\"", [1e-9, 0.0], half, "step = 0.01\nsteps = 3000"),
            None
        );
        assert_eq!(trips("potential = \"10 - 10*cos(q0) + 1e6\"", [1.0, 0.0], half, time), None);
        let kicked = "potential = \"0.5*q0^2\"\nforce = [\"1e6*exp(-(100*(t-1.025))^2)\"]";
        assert_eq!(trips(kicked, [0.0, 0.0], half, time), None);
        // A stiff spring, with a turn by nearly π in every step.
        assert_eq!(trips("potential = \"1e10*q0^2\"", [1.0, 0.0], half, time), None);
        // A force that begins between the nodes of a step, and one that ends before the next node.
        for force in ["step(t - 0.17)", "max(t - 0.17, 0)", "step(t - 0.17)*step(0.19 - t)"] {
            let late = format!("potential = \"0.5*q0^2\"\nforce = [\"{force}\"]");
            for kappa in ["kappa = 0.5", "kappa = 1.0", "kappa = 0.0"] {
                assert_eq!(
                    trips(&late, [0.0, 0.0], kappa, "step = 0.1\nsteps = 100"),
                    None,
                    "{force}, {kappa}"
                );
            }
        }
        // The memory of a Riemann–Liouville derivative exerts a force on a system without a spring.
        let pushed =
            "[[system.damping]]\norder = 1.5\ncoefficient = [0.5]\nderivative = \"riemann-liouville\"";
        assert_eq!(trips(pushed, [1.0, 0.0], half, "step = 0.01\nsteps = 2000"), None);
    }
}
