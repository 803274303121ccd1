//! The schemes that exhibits beyond the papers compare.

use super::problems::{GALERKIN, MIDPOINT};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_host::results::picture::{Marker, Series, Style};
use fvi_scenario::scenario::{Convolution, DampedAt, Quadrature, ReportedMomentum, Scenario, Scheme};

/// How a method is drawn: a colour for the kind, a marker for the order or the number of stages.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Look {
    pub(super) colour: usize,
    pub(super) marker: Marker,
}

impl Look {
    /// A curve through the points.
    pub(super) fn curve(&self, label: &str, points: Vec<(f64, f64)>) -> Series {
        self.series(label, Style::LineWithPoints, points)
    }

    fn series(&self, label: &str, style: Style, points: Vec<(f64, f64)>) -> Series {
        Series::new(label, style, points).with_colour_of(self.colour).with_marker(self.marker)
    }
}

/// A scheme with its convolution quadrature, and how it is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Method {
    pub(super) label: &'static str,
    scheme: Scheme,
    family: ConvolutionFamily,
    at: DampedAt,
    look: Look,
}

/// Polynomials of a degree with the nodes of the Runge–Kutta method.
const fn at_stages(degree: usize) -> Scheme {
    Scheme::Galerkin { degree, quadrature: None }
}

const fn bdf(label: &'static str, scheme: Scheme, order: usize, (colour, marker): (usize, Marker)) -> Method {
    Method {
        label,
        scheme,
        family: ConvolutionFamily::Bdf { order },
        at: DampedAt::MainNodes,
        look: Look { colour, marker },
    }
}

/// Gauss's quadrature with as many points as the degree, damped at them.
const fn gauss(
    label: &'static str,
    degree: usize,
    order: usize,
    (colour, marker): (usize, Marker),
) -> Method {
    let quadrature = Some(Quadrature::Gauss(degree));
    let (scheme, family) = (Scheme::Galerkin { degree, quadrature }, ConvolutionFamily::Bdf { order });
    Method { label, scheme, family, at: DampedAt::Nodes, look: Look { colour, marker } }
}

const fn radau(label: &'static str, stages: usize, marker: Marker) -> Method {
    Method {
        label,
        scheme: at_stages(stages),
        family: ConvolutionFamily::RadauIia { stages },
        at: DampedAt::Nodes,
        look: Look { colour: 1, marker },
    }
}

const fn lobatto(label: &'static str, stages: usize, marker: Marker) -> Method {
    let family = ConvolutionFamily::LobattoIiic { stages };
    let look = Look { colour: 3, marker };
    Method { label, scheme: at_stages(stages - 1), family, at: DampedAt::Nodes, look }
}

/// Runge–Kutta convolution quadrature, with the polynomials that do not limit its order.
pub(super) const RUNGE_KUTTA: [Method; 6] = [
    radau("Radau IIA 1", 1, Marker::Disc),
    radau("Radau IIA 2", 2, Marker::Square),
    radau("Radau IIA 3", 3, Marker::Triangle),
    lobatto("Lobatto IIIC 2", 2, Marker::Square),
    lobatto("Lobatto IIIC 3", 3, Marker::Triangle),
    lobatto("Lobatto IIIC 4", 4, Marker::Diamond),
];

/// The papers' schemes and their baselines.
pub(super) const MAIN_NODES: [Method; 7] = [
    bdf("explicit Euler", Scheme::ExplicitEuler, 1, (6, Marker::Disc)),
    bdf("implicit Euler", Scheme::ImplicitEuler, 1, (6, Marker::Square)),
    bdf("midpoint, BDF 1", MIDPOINT, 1, (0, Marker::Disc)),
    bdf("midpoint, BDF 2", MIDPOINT, 2, (0, Marker::Square)),
    bdf("midpoint, BDF 3", MIDPOINT, 3, (0, Marker::Triangle)),
    bdf("Galerkin 2, BDF 2", GALERKIN, 2, (2, Marker::Square)),
    bdf("Galerkin 2, BDF 3", GALERKIN, 3, (2, Marker::Triangle)),
];

/// The backward differentiation formulas at the quadrature nodes, each with as many nodes as it needs.
pub(super) const NODES: [Method; 5] = [
    gauss("Gauss 1, BDF 2, nodes", 1, 2, (7, Marker::Disc)),
    gauss("Gauss 2, BDF 3, nodes", 2, 3, (5, Marker::Square)),
    gauss("Gauss 2, BDF 4, nodes", 2, 4, (5, Marker::Triangle)),
    gauss("Gauss 3, BDF 5, nodes", 3, 5, (4, Marker::Square)),
    gauss("Gauss 3, BDF 6, nodes", 3, 6, (4, Marker::Triangle)),
];

impl Method {
    /// True if the damping acts at the stages of a Runge–Kutta method.
    pub(super) fn is_at_stages(&self) -> bool {
        !matches!(self.family, ConvolutionFamily::Bdf { .. })
    }

    /// A scenario with this method in place of its own, and the momentum after the kick where there is one.
    pub(super) fn on(&self, mut scenario: Scenario) -> Scenario {
        scenario.scheme = self.scheme;
        scenario.convolution = Convolution { family: self.family, at: self.at, starting: Vec::new() };
        scenario.output.momentum = ReportedMomentum::OneSided;
        scenario
    }

    /// How it is drawn.
    pub(super) fn look(&self) -> Look {
        self.look
    }

    /// The method's curve through the points.
    pub(super) fn curve(&self, points: Vec<(f64, f64)>) -> Series {
        self.look.curve(self.label, points)
    }

    /// The points with the method's marker.
    pub(super) fn markers(&self, points: Vec<(f64, f64)>) -> Series {
        self.look.series(self.label, Style::Points, points)
    }
}
