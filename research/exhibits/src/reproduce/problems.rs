//! The papers' problems, from the scenario files of the repository, and how exhibits vary them.

use fvi_fft::memory::Engine;
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_scenario::language::{Document, InputError};
use fvi_scenario::scenario::{Convolution, DampedAt, Quadrature, ReportedMomentum, Scenario, Scheme};
use std::path::Path;

/// The text of a file of the repository's `scenarios`. The package contains its own copy, since a package
/// cannot use files outside of its folder; a test checks that copies and originals are equal.
macro_rules! carried {
    ($name:literal) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/", $name))
    };
}

/// The document of a scenario of the repository.
macro_rules! repository {
    ($name:literal) => {
        Document::new(concat!("examples/scenarios/", $name), Path::new(""), carried!($name))
    };
}

/// A problem with its history in plain sums, which are bit-identical on every machine, so that the numbers on
/// the pages are reproducible.
fn on_plain_sums(document: Document) -> Result<Scenario, InputError> {
    let mut scenario = Scenario::from_document(document)?;
    scenario.history.choose(Engine::Direct);
    Ok(scenario)
}

/// The same problem with the memory engine that `fvi run` takes by default.
pub(super) fn on_default_engine(mut scenario: Scenario) -> Scenario {
    scenario.history.engine = None;
    scenario
}

/// q̈ + 0.2 q̇ + q = 0, q(0) = 1, q̇(0) = ½ as a fractional oscillator with α = ½, midpoint rule: \[JO\] eq.
/// 67.
pub(super) fn jo_oscillator() -> Result<Scenario, InputError> {
    on_plain_sums(repository!("damped-oscillator-jo.toml"))
}

/// q̈ + 0.2 q̇ + q = 0, q(0) = 0, q̇(0) = 1.2 on [0, 16] as a fractional oscillator with α = ½: \[HJO\] eq.
/// 39.
pub(super) fn hjo_oscillator() -> Result<Scenario, InputError> {
    on_plain_sums(repository!("damped-oscillator-hjo.toml"))
}

/// The plate under a pulse on [0, 30], midpoint rule: \[JO\] eq. 68.
pub(super) fn pulse_plate() -> Result<Scenario, InputError> {
    on_plain_sums(with_pulse_reference(repository!("bagley-torvik-pulse.toml")))
}

/// The same with Radau IIA quadrature, far more accurate than anything it is compared with.
pub(super) fn accurate_pulse_plate() -> Result<Scenario, InputError> {
    on_plain_sums(with_pulse_reference(repository!("bagley-torvik-pulse-radau.toml")))
}

fn with_pulse_reference(document: Document) -> Document {
    document.with_attached("bagley-torvik-pulse-reference.csv", carried!("bagley-torvik-pulse-reference.csv"))
}

/// A pendulum on a viscoelastic hinge, released from 2 rad, on [0, 20].
pub(super) fn pendulum() -> Result<Scenario, InputError> {
    on_plain_sums(repository!("pendulum.toml"))
}

/// q̈ + D^{1/2} q + q = f with the solution t³ on [0, 1]: \[HJO\] eq. 41a.
pub(super) fn cube_plate() -> Result<Scenario, InputError> {
    on_plain_sums(repository!("bagley-torvik-cubic.toml"))
}

/// q̈ + D^{3/2} q + q = f with the solution t^{5/2} on [0, 1]: \[HJO\] eq. 41b.
pub(super) fn root_plate() -> Result<Scenario, InputError> {
    on_plain_sums(repository!("bagley-torvik-root.toml"))
}

/// q̈ + ρ D^{3/2} q + q = f with the solution t^ν on [0, 1]; ρ = 0 switches the memory off.
pub(super) fn power_plate(power: f64, coefficient: f64) -> Result<Scenario, InputError> {
    let text = format!(
        r#"
        [system]
        mass = [1.0]
        potential = "0.5*q0^2"
        force = ["nu*(nu - 1)*t^(nu - 2) + rho*gamma(nu + 1)/gamma(nu - 1/2)*t^(nu - 3/2) + t^nu"]
        parameters = {{ nu = {power:?}, rho = {coefficient:?} }}
        force_quadrature = "nodes"
        [[system.damping]]
        order = 1.5
        coefficient = [{coefficient:?}]
        derivative = "riemann-liouville"
        [initial]
        position = [0.0]
        momentum = [0.0]
        [time]
        step = 0.00390625
        end = 1.0
        [reference]
        position = ["t^nu"]
        momentum = ["nu*t^(nu - 1)"]
        "#
    );
    on_plain_sums(Document::new("plate with the solution t^nu", Path::new(""), &text))
}

/// The midpoint rule: the low-order scheme with κ = ½.
pub(super) const MIDPOINT: Scheme = Scheme::LowOrder { kappa: 0.5 };

/// The Galerkin scheme of \[HJO\] §5.1: degree 2, two Gauss points.
pub(super) const GALERKIN: Scheme = Scheme::Galerkin { degree: 2, quadrature: Some(Quadrature::Gauss(2)) };

/// The same problem with another scheme.
pub(super) fn with_scheme(mut scenario: Scenario, scheme: Scheme) -> Scenario {
    scenario.scheme = scheme;
    scenario
}

/// The same problem with convolution quadrature by the backward differentiation formula of an order at the
/// main nodes, and the momentum after the kick: the papers' form.
pub(super) fn with_bdf(mut scenario: Scenario, order: usize) -> Scenario {
    scenario.convolution = Convolution {
        family: ConvolutionFamily::Bdf { order },
        at: DampedAt::MainNodes,
        starting: Vec::new(),
    };
    scenario.output.momentum = ReportedMomentum::OneSided;
    scenario
}

/// The same problem with starting weights that make the powers t^ν exact.
pub(super) fn with_starting_weights(mut scenario: Scenario, exponents: &[f64]) -> Scenario {
    scenario.convolution.starting = exponents.to_vec();
    scenario
}

/// The same problem on `steps` steps of the given size.
pub(super) fn on_grid(mut scenario: Scenario, step: f64, steps: usize) -> Scenario {
    scenario.time.step = step;
    scenario.time.steps = steps;
    scenario
}

/// The same problem on steps too long for the explicit fractional force as well: the papers' coarsest grids
/// have too few steps for the instability to grow.
pub(super) fn on_any_step(mut scenario: Scenario) -> Scenario {
    scenario.time.allow_unstable = true;
    scenario
}
