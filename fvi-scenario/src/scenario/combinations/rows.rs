//! What does not go together.

use super::Feature::*;
use super::{Feature, Row};

const fn row(refused: Feature, beside: Feature, why: &'static str, instead: &'static str) -> Row {
    Row { refused, beside, why, instead }
}

const OF_MECHANICS: &str = "a scenario with `[system]`: coordinates without mass, each with its damper";
const ANY_WEIGHTS: &str = "\"direct\", \"block-fft\" or \"real-time\"";
const LINEAR: &str = "cases of a linear structure, one factor for all: springs in `stiffness`, forces in `[[system.load]]` and `[[case.load]]`";
const SMOOTH: &str = "expressions without jumps and kinks in the position";
const SLOPED: &str =
    "forces whose slopes in position and velocity are continuous: v0*abs(v0) has them, abs(v0) has not";
const EXACT: &str = "expressions, or functions with exact Hessian and Jacobian matrices";
const WITH_MASS: &str = "a scenario without it where a coordinate has no mass";
const MAXWELL: &str = "kernels that are Maxwell elements side by side";
const CHOSEN: &str = "the scheme and the steps that `fvi run` has chosen: `scenario` in its `summary.json`";
const ONE_MOTION: &str = "scenarios without cases; `fvi run` and `fvi.run_cases` take those with them";

/// The table. Where several rows apply, the first is told.
pub const ROWS: &[Row] = &[
    // Fractional differential equations.
    row(Equation, Sweep, "", OF_MECHANICS),
    row(Equation, Fit, "", OF_MECHANICS),
    row(Equation, Converge, "", "`fvi run`, whose steps follow `time.tolerance`"),
    row(Equation, Response, "", OF_MECHANICS),
    row(GuardedEnergy, Equation, "it has no energy", "`[time]` without this key"),
    // Schemes and quadratures.
    row(
        NotGalerkin,
        Gauss,
        "",
        "\"galerkin\" with a `degree`, as many Gauss points; degree 1 is the midpoint rule",
    ),
    row(NotRadau, Collocation, "", "\"radau-iia\", whose nodes the scheme collocates at"),
    row(
        Staged,
        OneNode,
        "",
        "\"bdf\" here, or `scheme.kind = \"galerkin\"` or, with Radau IIA, \"collocation\"",
    ),
    row(
        OwnQuadrature,
        Staged,
        "",
        "leave out `scheme.quadrature` and `scheme.points`: the nodes are those of the Runge–Kutta method",
    ),
    row(AtNodes, Euler, "", "\"main-nodes\" here, or `scheme.kind` = \"low-order\" or \"galerkin\""),
    row(
        Trapezoidal,
        AtMainNodes,
        "the force of a step is explicit there, and the part of the weights that alternates in sign grows",
        "`convolution.at` = \"nodes\" with `scheme.kind` = \"low-order\" or \"galerkin\"",
    ),
    row(Starting, AtNodes, "", "starting weights with \"main-nodes\", whose samples lie on the grid"),
    row(
        SafeStarting,
        OtherKernel,
        "",
        "starting weights beside kernels whose singularities lie on the negative real axis",
    ),
    row(MeanMomentum, Euler, "", "\"one-sided\" with Euler's methods"),
    row(
        MomentumOffset,
        UnknownOffset,
        "what is taken off follows from a sum of decaying exponentials",
        "\"one-sided\", the momentum of the discrete Lagrangian, of order 2 there; or `convolution.order` up to 2",
    ),
    row(
        TrapezoidalJump,
        MeanMomentum,
        "the rule does not forget the jump to the initial position: momenta alternate about the right ones, and approach them with an \
         order below 2",
        "\"caputo\" here, or backward differentiation (`convolution.family` = \"bdf\"); or `output.momentum` = \"one-sided\" for momenta \
         that alternate",
    ),
    // Mechanisms.
    row(
        NotGauss,
        Mechanism,
        "only the weights of the method that moves the mechanism keep its order and take no energy from nowhere",
        "`convolution.family` = \"gauss\", which is what is taken without `[convolution]`",
    ),
    row(
        NotGauss,
        Energy,
        "the energy stored in the dampers is known for the weights of the midpoint rule",
        "`convolution.family` = \"gauss\", which is what is taken without `[convolution]`",
    ),
    row(
        Energy,
        OwnTerms,
        "its gradients take the potential at both ends of a step, which code does not tell apart from its forces",
        "an expression as `system.potential`; or `scheme.kind` = \"galerkin\"",
    ),
    row(Projected, Unconstrained, "", "`initial.project` beside `system.constraints`"),
    row(
        RiemannLiouville,
        Gauss,
        "the force K(D) q of the initial position begins at once",
        "\"caputo\" as `derivative`; in place of a damping of order 0 a spring: `system.stiffness`, `system.potential`, or along an \
         elongation `[[system.element]]` with `along`",
    ),
    row(GivenWeights, Gauss, "weights do not tell the kernel K(s), whose relaxations dampers take", MAXWELL),
    row(
        OtherKernel,
        Gauss,
        "dampers are sums of relaxations",
        "kernels of relaxations, or a `[convolution]` of multistep weights for a system without constraints, elongations and \
         `system.kinetic`",
    ),
    row(
        Massless,
        Gauss,
        "",
        "a mass for it, or, where constraints determine how it moves, `system.kinetic` without its velocity",
    ),
    row(
        Gyroscopic,
        Gauss,
        "",
        "terms of `system.kinetic` that are linear in the velocities, such as \"0.5*(q0*v1 - q1*v0)\"",
    ),
    row(
        EqualSteps,
        Gauss,
        "each of its dampers is a sum of relaxations that takes steps of any length",
        "\"any-step\", which is what is taken without this key",
    ),
    row(
        Adaptive,
        Gauss,
        "",
        "steps that are known beforehand: `time.step`, or `time.grid` = \"uniform\", \"graded\", \"geometric\" or \"points\"",
    ),
    row(Past, Gauss, "", "a motion that begins at the start, with its memories at rest"),
    row(Cases, Gauss, "", ONE_MOTION),
    row(
        SampleInside,
        Gauss,
        "a step has one force with them, and the sample would act from the next grid point on",
        "samples at grid points: a `time.step` that divides `input.period`, or steps that meet `input.times` (`time.grid` with \
         `time.must_hit`)",
    ),
    // Steps and engines.
    row(
        Steps,
        Multistep,
        "its weights are for equal steps",
        "equal steps (`time.step`); or `scheme.kind` = \"collocation\", or \"galerkin\" with `convolution.family` = \"radau-iia\" or \
         \"lobatto-iiic\", which take steps of any length",
    ),
    row(AnyStep, Multistep, "", "another engine here, or a Runge–Kutta family"),
    row(
        EqualSteps,
        ManyStages,
        "dampers are sums of relaxations with them, which take steps of any length",
        "\"any-step\", which is what is taken without this key",
    ),
    row(
        ManyStages,
        OtherKernel,
        "dampers are sums of relaxations with them",
        "1 to 3 stages beside kernels whose singularities do not lie on the negative real axis",
    ),
    row(
        EqualSteps,
        Steps,
        "its weights are for equal steps",
        "\"any-step\", which is what is taken without this key",
    ),
    row(
        Tolerance,
        NotBdf,
        "",
        "only with \"bdf\"; the exponentials of Runge–Kutta quadrature are exact to rounding",
    ),
    row(GivenWeights, Steps, "", "equal steps, those of the file"),
    row(GivenWeights, Staged, "", "the family \"bdf\", whose weights are numbers"),
    row(ExponentialSums, Trapezoidal, "its weights alternate in sign and do not fall off", ANY_WEIGHTS),
    row(
        ExponentialSums,
        GivenWeights,
        "weights do not tell the kernel K(s), whose exponentials it takes",
        ANY_WEIGHTS,
    ),
    // A tolerance in place of a scheme.
    row(GivenWeights, Automatic, "they are for steps of one length", "a kernel by its formula"),
    row(Past, Automatic, "its rows are for steps of one length", "a scheme and a step of your own"),
    // A past, and a start other than t = 0.
    row(Past, Steps, "", "equal steps, whose memories have a sample for each step of the past"),
    row(LaterStart, Steps, "", "equal steps; the other grids begin at t = 0"),
    row(Input, Past, "", "`[[system.load]]` with a record in place of samples"),
    row(Input, LaterStart, "", "`[[system.load]]` with a record in place of samples"),
    row(Controllers, Past, "", "a scenario that begins at t = 0, where controllers take their first sample"),
    row(
        Controllers,
        LaterStart,
        "",
        "a scenario that begins at t = 0, where controllers take their first sample",
    ),
    row(Starting, Past, "", "no starting weights: they are for motions that begin at the start"),
    // Load cases: several motions of a linear system at once.
    row(
        Cases,
        Controllers,
        "load cases are motions of a linear system that nothing measures",
        "one motion beside [controller]",
    ),
    row(Potential, Cases, "", LINEAR),
    row(Force, Cases, "", LINEAR),
    row(Elements, Cases, "", LINEAR),
    row(Cases, OwnTerms, "", LINEAR),
    row(Input, Cases, "", "records in `[[case.load]]` in place of samples"),
    row(Reference, Cases, "", "a reference for one motion at a time, without cases"),
    row(Times, Cases, "", "`output.every`"),
    row(Events, Cases, "", "a scenario of one motion: each case would have its own events and end"),
    row(Steps, Cases, "", "equal steps, for which one factor serves"),
    row(Cases, Past, "", "a scenario of one motion: the past would be that of all cases"),
    // Gyroscopic forces, whose velocity is that of the polynomial at the nodes.
    row(
        NoVelocities,
        Gyroscopic,
        "",
        "\"low-order\" with `kappa` < 1, or \"galerkin\" with as many Gauss points as its degree",
    ),
    row(AtMainNodes, Gyroscopic, "", "\"nodes\", where the scheme has a velocity"),
    row(Steps, Gyroscopic, "", "\"uniform\""),
    row(Cases, Gyroscopic, "", "one motion: load cases need a symmetric matrix of the step"),
    // Coordinates without mass.
    row(Cases, Massless, "", WITH_MASS),
    row(Past, Massless, "", WITH_MASS),
    row(Sensitivity, Massless, "", WITH_MASS),
    row(MemoryEnergy, Massless, "", WITH_MASS),
    row(
        NotForMassless,
        Massless,
        "",
        "\"low-order\" with `kappa` = 0.5, \"galerkin\" with as many Gauss points as its `degree` and a multistep `[convolution]`, or \
         \"collocation\"",
    ),
    // Energies of memories.
    row(
        MemoryEnergy,
        NoBalance,
        "",
        "the midpoint rule (\"low-order\", `kappa` = 0.5) with `convolution.at` = \"nodes\", order 1 or 2 or the trapezoidal rule, which have \
         an exact balance",
    ),
    row(MemoryEnergy, Times, "", "rows at grid points"),
    row(MemoryEnergy, Events, "", "rows at grid points"),
    row(MemoryEnergy, Cases, "", "one motion"),
    row(MemoryEnergy, GivenWeights, "they have no states", MAXWELL),
    row(MemoryEnergy, OtherKernel, "", MAXWELL),
    // Controllers and events.
    row(
        Steps,
        Controllers,
        "its samples are points of a grid of equal steps",
        "\"uniform\" beside [controller]",
    ),
    row(
        DelayInside,
        ForcesFromGridPoints,
        "",
        "a multiple of `time.step` here; any length with the low-order (kappa > 0) and Galerkin schemes, without Gauss weights, and \
         `system.force_quadrature` = \"moments\"",
    ),
    row(
        MomentumEvent,
        NoMomentumInside,
        "inside steps variational schemes have that of a polynomial of q",
        "a function of t and positions here, or `scheme.kind` = \"collocation\"",
    ),
    // Sensitivities.
    row(Steps, Sensitivity, "", "equal steps: derivatives are those of one grid"),
    row(Cases, Sensitivity, "", "one motion"),
    row(Events, Sensitivity, "", "runs that nothing looks into on the way"),
    row(Controllers, Sensitivity, "", "loops that are open: what a controller does is not differentiated"),
    row(Times, Sensitivity, "", "rows at grid points: `output.every`"),
    row(KinkedPotential, Sensitivity, "", SMOOTH),
    row(KinkedElement, Sensitivity, "", SMOOTH),
    row(BentForce, Sensitivity, "", SLOPED),
    row(KinkedMechanism, Sensitivity, "", SMOOTH),
    row(
        Energy,
        Sensitivity,
        "its gradients are made of differences of the potential",
        "`scheme.kind` = \"galerkin\" with `degree` = 1, of the same order",
    ),
    row(
        MomentumOffset,
        Sensitivity,
        "",
        "\"one-sided\" for Riemann–Liouville damping from q₀ ≠ 0 at several nodes with `convolution.order` ≥ 3: what is taken off the \
         momentum there is not differentiated",
    ),
    row(ApproximateDerivatives, Sensitivity, "", EXACT),
    // What a scenario is used for.
    row(Steps, Gradient, "", "equal steps: derivatives are those of one grid"),
    row(Cases, Gradient, "", ONE_MOTION),
    row(Events, Gradient, "", "runs that nothing looks into on the way"),
    row(Controllers, Gradient, "", "loops that are open: what a controller does is not differentiated"),
    row(Times, Gradient, "", "rows at grid points: `output.every`"),
    row(KinkedPotential, Gradient, "", SMOOTH),
    row(KinkedElement, Gradient, "", SMOOTH),
    row(BentForce, Gradient, "", SLOPED),
    row(
        MomentumOffset,
        Gradient,
        "",
        "\"one-sided\" for Riemann–Liouville damping from q₀ ≠ 0 at several nodes with `convolution.order` ≥ 3: what is taken off the \
         momentum there is not differentiated",
    ),
    row(Massless, Gradient, "", WITH_MASS),
    row(
        Past,
        Gradient,
        "",
        "a motion that begins at the start; `[sensitivity]` has the derivatives by a past",
    ),
    row(Gauss, Gradient, "", "`[sensitivity]`, which differentiates mechanisms and Gauss weights forwards"),
    row(Automatic, Gradient, "its steps are chosen by the motion", "a scheme and a step of your own"),
    row(ApproximateDerivatives, Gradient, "", EXACT),
    row(Sensitivity, SinglePrecision, "", "double precision: `--precision f64`"),
    row(Sensitivity, Npz, "", "derivatives are columns of `trajectory.csv`"),
    row(Cases, OneMotion, "", ONE_MOTION),
    row(
        Automatic,
        Motion,
        "it has no scheme before one is chosen",
        "`fvi run`, `fvi.run` and `fvi.integrate`, which choose it",
    ),
    row(Automatic, AnotherEnd, "what is chosen depends on the end", "another `time.end` in the file"),
    row(Automatic, Sweep, "every point would choose another one", CHOSEN),
    row(Automatic, Converge, "it chooses the steps", CHOSEN),
    row(Automatic, Fit, "every point would choose another one", CHOSEN),
    row(Automatic, Response, "a response is that of one scheme", CHOSEN),
    row(
        Steps,
        AnotherEnd,
        "",
        "another `time.end` in the file: grids of steps that differ end where it says",
    ),
    row(Cases, Sweep, "", ONE_MOTION),
    row(Cases, Converge, "", ONE_MOTION),
    row(
        UnrefinableSteps,
        Converge,
        "",
        "\"uniform\", or \"graded\" without `time.must_hit`, which have a finer grid of the same shape",
    ),
    row(Past, Converge, "", "a motion that begins at the start: rows of a past are for one length of steps"),
    row(StopEvent, Converge, "", "\"record\": errors are compared up to the same end"),
    row(Cases, Fit, "", ONE_MOTION),
    row(
        Adaptive,
        Fit,
        "",
        "grids whose steps do not depend on what is sought: the numbers of a run whose steps are chosen on the way jump with it",
    ),
    row(Events, Fit, "", "motions that nothing ends or switches"),
    row(Gyroscopic, Response, "", "a system without it, whose equations are symmetric"),
    row(
        ForceOfVelocity,
        Response,
        "",
        "a system without forces of the velocity; linear damping is `[[system.damping]]` with `order` = 1",
    ),
];
