//! The papers' problems, from the scenario files of the repository, and how exhibits vary them.

use crate::scenario::{Convolution, ConvolutionFamily, Document, InputError, Quadrature, Scenario, Scheme};
use std::path::Path;

macro_rules! scenario {
    ($name:literal) => {
        read(
            concat!("scenarios/", $name, ".toml"),
            include_str!(concat!("../../../scenarios/", $name, ".toml")),
        )
    };
}

fn read(name: &str, text: &str) -> Result<Scenario, InputError> {
    Scenario::from_document(Document::new(name, Path::new(""), text))
}

/// q̈ + 0.2 q̇ + q = 0, q(0) = 0, q̇(0) = 1.2 on [0, 16] as a fractional oscillator with α = ½: \[HJO\] eq. 39.
pub(super) fn oscillator_from_rest_point() -> Result<Scenario, InputError> {
    scenario!("damped-oscillator-hjo")
}

/// q̈ + D^{1/2} q + q = f with the solution t³ on [0, 1]: \[HJO\] eq. 41a.
pub(super) fn plate_with_cube() -> Result<Scenario, InputError> {
    scenario!("bagley-torvik-cubic")
}

/// q̈ + D^{3/2} q + q = f with the solution t^{5/2} on [0, 1]: \[HJO\] eq. 41b.
pub(super) fn plate_with_root() -> Result<Scenario, InputError> {
    scenario!("bagley-torvik-root")
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

/// The same problem with convolution quadrature by the backward differentiation formula of an order.
pub(super) fn with_bdf(mut scenario: Scenario, order: usize) -> Scenario {
    scenario.convolution = Convolution { family: ConvolutionFamily::Bdf { order }, starting: Vec::new() };
    scenario
}
