//! The features of a scenario, and the uses that one can be put to.

use super::super::own_terms::SharedTerms;
use super::super::scheme::{DampedAt, Quadrature, Scheme};
use super::super::time::ReportedMomentum;
use super::super::warnings::bends;
use super::super::{Action, Damping, Derivative, GridRule, Scenario};
use fvi_fft::memory::Engine;
use fvi_fft::quadrature::ConvolutionFamily;

/// Keys that choose multistep weights, and what chooses a Runge–Kutta method or Gauss's, without a family.
const MULTISTEP: [&str; 5] =
    ["convolution.symbol", "convolution.order", "convolution.at", "convolution", "scheme.kind"];
const STAGED: [&str; 6] = [
    "convolution.stages",
    "convolution",
    "system.constraints",
    "system.kinetic",
    "scheme.kind",
    "system.damping",
];
const MECHANISM: [&str; 2] = ["system.constraints", "system.damping"];

/// Keys by which steps are chosen on the way without a grid.
const TOLERANCE: [&str; 2] = ["time.tolerance", "time.end"];

/// Name, key and predicate of a feature.
type Definition = (&'static str, &'static str, fn(&Scenario) -> Option<usize>);

/// Defines [`Feature`]: a name, the key, and a predicate that returns the index of what it found. In names
/// and keys `{i}` stands for that index. After `or` come the keys that bring it where its own is not written.
macro_rules! features {
    ($($feature:ident: $name:literal, $key:literal $(or $others:expr)?, $find:expr;)*) => {
        /// A feature of a scenario, or a use that a scenario can be put to.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Feature {
            $(
                #[doc = concat!($name, ".")]
                $feature,
            )*
        }

        impl Feature {
            /// All of them.
            pub const ALL: &'static [Self] = &[$(Self::$feature),*];

            /// Name, key and predicate of each.
            const DEFINITIONS: &'static [Definition] = &[$(($name, $key, $find)),*];

            /// Keys that bring it without its own.
            fn other_keys(self) -> &'static [&'static str] {
                match self {
                    $($(Self::$feature => &$others,)?)*
                    _ => &[],
                }
            }
        }
    };
}

features! {
    Equation: "an equation", "[equation]", |s| on(s.equation.is_some());
    Potential: "a potential", "system.potential", |s| on(s.system.potential.is_some());
    Force: "a force in words", "system.force", |s| on(s.system.force.is_some());
    ForceOfVelocity: "a force of the velocity", "system.force", |s| on(s.system.has_forces_of_velocity());
    Elements: "elements", "[[system.element]]", |s| on(!s.system.elements.is_empty());
    KinkedPotential: "jumps or kinks in the position", "system.potential",
        |s| on(s.system.potential.iter().any(|potential| potential.root().has_kinks()));
    KinkedElement: "jumps or kinks in the position", "system.element[{i}].potential",
        |s| s.system.elements.iter().position(|element| element.potential.root().has_kinks());
    KinkedForce: "jumps or kinks in the position", "system.force[{i}]",
        |s| s.system.force.iter().flatten().position(|force| force.root().has_kinks());
    BentForce: "a force with a kink", "system.force[{i}]",
        |s| s.system.force.iter().flatten().position(|force| bends(force.root()));
    KinkedMechanism: "jumps or kinks in the position", "system",
        |s| {
            let mut all = s.system.kinetic.iter().chain(&s.system.constraints).chain(s.system.elongations());
            on(all.any(|expression| expression.root().has_kinks()))
        };
    OwnTerms: "a potential or force in code that depends on the position", "system",
        |s| on(s.system.own_terms.as_ref().is_some_and(SharedTerms::depend_on_position));
    ApproximateDerivatives: "a potential or force in code without exact derivatives", "system",
        |s| on(s.system.own_terms.as_ref().is_some_and(SharedTerms::have_approximate_derivatives));
    Gyroscopic: "gyroscopic forces", "system.gyroscopic", |s| on(s.system.gyroscopic.is_some());
    Massless: "coordinate {i} (from 0), which has no mass", "system.mass",
        // What a kinetic energy in words leaves without mass a constraint may move.
        |s| s.system.massless().first().copied().filter(|_| s.system.kinetic.is_none());
    GivenWeights: "a kernel by its weights", "system.damping[{i}].kernel.weights",
        |s| s.system.damping.iter().position(|term| term.transfer.table().is_some());
    OtherKernel: "a kernel that singularities on the negative real axis are not seen to make up",
        "system.damping[{i}].kernel", |s| s.system.damping.iter().position(|term| !term.transfer.is_relaxation());
    MomentumOffset: "a momentum from which an offset is taken off", "output.momentum", momentum_offset;
    UnknownOffset: "Riemann–Liouville damping from q₀ ≠ 0 by a kernel that singularities on the negative real axis are not seen to make up",
        "system.damping[{i}].kernel", |s| jump(s, |term| !term.transfer.is_relaxation());
    TrapezoidalJump: "Riemann–Liouville damping from q₀ ≠ 0 by the trapezoidal rule, and a kernel that grows",
        "system.damping[{i}].derivative", |s| match s.convolution.family {
            ConvolutionFamily::Trapezoidal => jump(s, |term| term.transfer.growth() > 0.0),
            _ => None,
        };
    Mechanism: "a Lagrangian, constraints or elongations", "system.kinetic" or MECHANISM, |s| on(s.system.is_mechanism());
    Constraints: "constraints", "system.constraints", |s| on(!s.system.constraints.is_empty());
    NotGauss: "a family other than Gauss's", "convolution.family" or MULTISTEP,
        |s| on(!matches!(s.convolution.family, ConvolutionFamily::Gauss { .. }));
    Gauss: "Gauss weights", "convolution.family" or STAGED,
        |s| on(matches!(s.convolution.family, ConvolutionFamily::Gauss { .. }));
    NotGalerkin: "a scheme other than Galerkin's", "scheme.kind",
        |s| on(!matches!(s.scheme, Scheme::Galerkin { .. } | Scheme::Energy));
    Energy: "the energy scheme", "scheme.kind", |s| on(s.scheme == Scheme::Energy);
    Projected: "a start that is moved onto constraints", "initial.project", |s| on(s.initial.project);
    Unconstrained: "a system without constraints", "system", |s| on(s.system.constraints.is_empty());
    RiemannLiouville: "damping of Riemann and Liouville's form, or of order 0",
        "system.damping[{i}].derivative" or ["system.damping[{i}].order", "system.damping[{i}]"],
        |s| s.system.damping.iter().position(|term| term.derivative == Derivative::RiemannLiouville);
    Past: "a past", "initial.past", |s| on(s.initial.past.is_some());
    LaterStart: "a later start", "time.start", |s| on(s.time.start != 0.0);
    Automatic: "a scheme that a tolerance chooses", "scheme.kind", |s| on(s.automatic.is_some());
    Euler: "Euler's methods", "scheme.kind",
        |s| on(matches!(s.scheme, Scheme::ExplicitEuler | Scheme::ImplicitEuler));
    OneNode: "a scheme without stages", "scheme.kind",
        |s| on(!matches!(s.scheme, Scheme::Galerkin { .. } | Scheme::Collocation | Scheme::Energy));
    Collocation: "collocation", "scheme.kind", |s| on(s.scheme == Scheme::Collocation);
    OwnQuadrature: "a quadrature of the action", "scheme.points" or ["scheme.quadrature"], |s| on(s.scheme.quadrature().is_some());
    NoVelocities: "a node at the beginning of a step, or more nodes than the degree", "scheme", |s| on(!has_velocities(s));
    NotForMassless: "a scheme that does not determine coordinates without mass", "scheme",
        |s| on(!determines_massless(s));
    NoBalance: "a scheme without an exact balance of energies", "scheme" or ["convolution", "time.tolerance"], |s| on(!has_balance(s));
    NotRadau: "a family other than Radau IIA", "convolution.family" or MULTISTEP,
        |s| on(!matches!(s.convolution.family, ConvolutionFamily::RadauIia { .. }));
    Multistep: "a multistep rule", "convolution.family" or MULTISTEP, |s| on(!s.convolution.family.is_staged());
    Staged: "a Runge–Kutta family", "convolution.family" or STAGED, |s| on(s.convolution.family.is_staged());
    ManyStages: "more than three stages", "convolution.stages",
        |s| on(matches!(s.convolution.family, ConvolutionFamily::RadauIia { stages } if stages > 3));
    Trapezoidal: "the trapezoidal rule", "convolution.symbol",
        |s| on(s.convolution.family == ConvolutionFamily::Trapezoidal);
    NotBdf: "a quadrature other than BDF", "convolution.family" or STAGED,
        |s| on(!matches!(s.convolution.family, ConvolutionFamily::Bdf { .. }));
    AtNodes: "damping at the nodes", "convolution.at", |s| on(s.convolution.at == DampedAt::Nodes);
    AtMainNodes: "damping at the main nodes", "convolution.at",
        |s| on(s.convolution.at == DampedAt::MainNodes);
    Starting: "starting weights", "convolution.starting", |s| on(!s.convolution.starting.is_empty());
    SafeStarting: "starting weights that must not grow", "convolution.starting",
        |s| on(!s.convolution.starting.is_empty() && !s.time.allow_unstable);
    Steps: "steps that differ", "time.grid" or TOLERANCE, |s| on(s.time.grid.is_some());
    UnrefinableSteps: "a grid without a finer one of the same shape", "time.grid", unrefinable;
    Adaptive: "steps chosen on the way", "time.grid" or TOLERANCE, |s| on(s.time.adaptive().is_some());
    AnyStep: "the engine for steps of any length", "history.engine",
        |s| on(s.history.engine == Some(Engine::AnyStep));
    EqualSteps: "an engine for equal steps", "history.engine",
        |s| on(s.history.engine.is_some_and(|engine| engine != Engine::AnyStep));
    ExponentialSums: "an engine of exponentials for equal steps", "history.engine",
        |s| on(matches!(s.history.engine, Some(Engine::ExponentialSum | Engine::ExponentialSumCore)));
    Tolerance: "a tolerance of the exponentials", "history.tolerance", |s| on(s.history.tolerance.is_some());
    MeanMomentum: "the mean of the momenta", "output.momentum",
        |s| on(s.output.momentum == ReportedMomentum::Mean);
    GuardedEnergy: "a guard of energies", "time.energy_guard", |s| on(s.time.energy_guard.is_some());
    Times: "rows between grid points", "output.times", |s| on(!s.output.times.is_empty());
    MemoryEnergy: "energies of memories", "output.memory_energy", |s| on(s.output.memory_energy);
    Input: "samples as a force", "[input]", |s| on(s.input.is_some());
    SampleInside: "a sample of a force inside a step", "[input]", |s| Some(sample_inside(s)?.0);
    Reference: "a reference", "[reference]", |s| on(s.reference.is_some());
    Cases: "load cases", "[[case]]", |s| on(!s.cases.is_empty());
    Events: "events", "[[event]]", |s| on(!s.events.is_empty());
    StopEvent: "an event that ends the run", "event[{i}].action",
        |s| s.events.iter().position(|event| event.action == Action::Stop);
    MomentumEvent: "an event of the momentum", "event[{i}].when",
        |s| s.events.iter().position(|event| event.when.root().has_variable_from(s.coordinates()));
    NoMomentumInside: "a momentum that jumps from step to step", "scheme",
        |s| on(!s.scheme_descriptor().has_momentum_inside);
    Controllers: "a controller", "[controller]", |s| on(!s.controllers.is_empty());
    DelayInside: "a delay that ends inside a step", "controller[{i}].delay",
        |s| s.controllers.iter().position(|controller| controller.delay_in_steps(s.time.step).1 != 0.0);
    ForcesFromGridPoints: "forces that act from a grid point on", "scheme", |s| on(!s.acts_inside_steps());
    Sensitivity: "sensitivities", "[sensitivity]", |s| on(s.sensitivity.is_some());
    SinglePrecision: "single precision", "", |_| None;
    Npz: "the output format npz", "", |_| None;
    OneMotion: "a run of one motion", "", |_| None;
    Motion: "a motion", "", |_| None;
    AnotherEnd: "another end (`--until`, `--steps`)", "", |_| None;
    Sweep: "a sweep", "", |_| None;
    Converge: "`fvi converge`", "", |_| None;
    Fit: "a fit", "", |_| None;
    Response: "a frequency response", "", |_| None;
    Gradient: "a gradient", "", |_| None;
}

impl Feature {
    fn definition(self) -> &'static Definition {
        &Self::DEFINITIONS[self as usize]
    }

    /// Its name.
    pub fn name(self) -> String {
        self.definition().0.replace("{i}", "i")
    }

    /// The keys that bring it, the one that turns it on first; an empty one for uses.
    pub fn keys(self) -> impl Iterator<Item = String> {
        self.all_keys().map(|key| key.replace("{i}", "i"))
    }

    fn all_keys(self) -> impl Iterator<Item = &'static str> {
        [self.definition().1].into_iter().chain(self.other_keys().iter().copied())
    }

    /// True if it is a use of a scenario and not a part of it.
    pub fn is_use(self) -> bool {
        self.definition().1.is_empty()
    }

    /// True if a scenario has it.
    pub fn is_in(self, scenario: &Scenario) -> bool {
        self.find(scenario).is_some()
    }

    /// The index of the part of the scenario that has it, 0 where there is one part only.
    pub(super) fn find(self, scenario: &Scenario) -> Option<usize> {
        (self.definition().2)(scenario)
    }

    /// The name with this index.
    pub(super) fn name_of(self, index: usize) -> String {
        self.definition().0.replace("{i}", &index.to_string())
    }

    /// The name with the key that a message shows, tables as their headers; of a default, whose key is not in
    /// the file, that it is one.
    pub(super) fn shown(self, scenario: &Scenario, index: usize) -> String {
        let (key, name) = (self.definition().1, self.name_of(index));
        match (self.written(scenario, index), key.starts_with('[')) {
            (Some(_), true) => format!("{name} (`{key}`)"),
            (Some(path), _) => format!("{name} (`{path}`)"),
            (None, _) => format!("{name}, the default of `{}`", self.path(scenario, index)),
        }
    }

    /// Numbers of what was found, where the place does not tell them.
    pub(super) fn numbers(self, scenario: &Scenario) -> Option<String> {
        let (index, [from, to]) = (self == Self::SampleInside).then(|| sample_inside(scenario))??;
        let time = scenario.input.as_ref()?.times[index];
        Some(format!("sample {index} (from 0) begins at t = {time}, inside the step from {from} to {to}"))
    }

    /// The path of what was found in the document of the scenario.
    pub(super) fn path(self, scenario: &Scenario, index: usize) -> String {
        self.written(scenario, index).unwrap_or_else(|| path_of(self.definition().1, index))
    }

    /// The same, if the document has it: of the keys that bring it the first that is written.
    pub(super) fn written(self, scenario: &Scenario, index: usize) -> Option<String> {
        let mut paths = self.all_keys().flat_map(|key| {
            // One controller may stand without brackets.
            let alone = (index == 0).then(|| path_of(&key.replace("[{i}]", ""), index));
            [path_of(key, index)].into_iter().chain(alone)
        });
        paths.find(|path| scenario.has_key(path))
    }
}

/// The path that a key with this index is at.
fn path_of(key: &str, index: usize) -> String {
    let key = if key.starts_with('[') { key.trim_matches(['[', ']']) } else { key };
    key.replace("{i}", &index.to_string())
}

/// The first sample of a force inside a step that is known beforehand, with that step.
fn sample_inside(s: &Scenario) -> Option<(usize, [f64; 2])> {
    s.input.as_ref().filter(|_| s.time.adaptive().is_none())?.first_inside(&s.time)
}

fn on(is: bool) -> Option<usize> {
    is.then_some(0)
}

/// The first damping term of Riemann and Liouville's form that suits and acts on the initial position.
fn jump(s: &Scenario, suits: impl Fn(&Damping) -> bool) -> Option<usize> {
    let acts = |term: &Damping| term.coefficient.times(&s.initial.position).iter().any(|&force| force != 0.0);
    let is_jump =
        |term: &Damping| term.derivative == Derivative::RiemannLiouville && suits(term) && acts(term);
    s.system.damping.iter().position(is_jump)
}

/// True if the reported momentum differs from that of the scheme, with damping at several nodes.
fn momentum_offset(s: &Scenario) -> Option<usize> {
    on(matches!(s.convolution.family, ConvolutionFamily::Bdf { order: 3.. })
        && s.convolution.at == DampedAt::Nodes
        && s.scheme_descriptor().nodes > 1
        && s.output.momentum == ReportedMomentum::Mean
        && s.system.damping.iter().any(|term| term.derivative == Derivative::RiemannLiouville))
}

fn unrefinable(s: &Scenario) -> Option<usize> {
    let grid = s.time.grid.as_ref()?;
    on(!(matches!(grid.rule(), GridRule::Graded { .. }) && grid.must_hit().is_empty()))
}

/// True if the velocities at the nodes follow from the unknowns of a step: nodes as many as the degree, none
/// at the beginning of the step.
fn has_velocities(s: &Scenario) -> bool {
    match (s.scheme, s.convolution.family) {
        (Scheme::LowOrder { kappa }, _) => kappa < 1.0,
        (Scheme::Galerkin { degree, quadrature: Some(rule) }, _) => rule == Quadrature::Gauss(degree),
        (Scheme::Galerkin { degree, .. }, ConvolutionFamily::RadauIia { stages }) => stages == degree,
        (Scheme::Galerkin { .. } | Scheme::Energy, ConvolutionFamily::Gauss { .. }) => true,
        _ => false,
    }
}

/// True if the equations of a step determine coordinates without mass: the forces balance at Gauss points.
fn determines_massless(s: &Scenario) -> bool {
    match s.scheme {
        Scheme::Collocation => true,
        Scheme::LowOrder { kappa } => kappa == 0.5,
        Scheme::Galerkin { degree, quadrature } => quadrature == Some(Quadrature::Gauss(degree)),
        _ => false,
    }
}

/// True if it is the midpoint rule damped at its node by a rule of order 1 or 2, or has Gauss weights.
fn has_balance(s: &Scenario) -> bool {
    if s.is_mechanism() {
        return true;
    }
    let midpoint = match s.scheme {
        Scheme::LowOrder { kappa } => kappa == 0.5,
        Scheme::Galerkin { degree, quadrature } => degree == 1 && quadrature == Some(Quadrature::Gauss(1)),
        _ => false,
    };
    let rule = matches!(
        s.convolution.family,
        ConvolutionFamily::Bdf { order: 1 | 2 } | ConvolutionFamily::Trapezoidal
    );
    midpoint && rule && s.convolution.at == DampedAt::Nodes
}
