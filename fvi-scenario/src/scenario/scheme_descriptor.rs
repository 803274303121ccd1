//! Descriptor of a scheme, by which the rest of the program depends on its properties and not on its name.

use super::scheme::Scheme;
use fvi_fft::quadrature::ConvolutionFamily;

/// Properties of a scheme with its convolution quadrature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SchemeDescriptor {
    /// Number of unknown vectors of N coordinates per step.
    pub unknowns: usize,
    /// Number of nodes per step.
    pub nodes: usize,
    /// Order in h of positions at grid points, for smooth motions and an accurate quadrature of forces.
    pub order: usize,
    /// Order in h of velocities inside a step.
    pub order_inside: usize,
    /// True if the momentum inside a step has that order too.
    pub has_momentum_inside: bool,
    /// True if the scheme is variational: a step makes a discrete action stationary.
    pub is_variational: bool,
    /// True if an undamped motion loses energy by the scheme.
    pub is_dissipative: bool,
    /// True if it takes the impulse of a time-dependent force by exact moments instead of values at grid
    /// points.
    pub takes_moments: bool,
    /// True if an input that changes inside a step acts from that time on instead of from the next grid
    /// point.
    pub takes_inputs_inside: bool,
    /// True if the momentum reported by default is the computed one instead of the mean of the momenta before
    /// and after the kick of the damping.
    pub reports_own_momentum: bool,
}

impl Scheme {
    /// The descriptor of the scheme with a convolution quadrature.
    pub fn descriptor(&self, family: ConvolutionFamily) -> SchemeDescriptor {
        let stages = match family {
            ConvolutionFamily::Gauss { stages } => Some(stages),
            _ => family.staged().map(|method| method.stages()),
        };
        let variational = SchemeDescriptor {
            unknowns: 1,
            nodes: 1,
            order: family.order(),
            order_inside: 2,
            has_momentum_inside: false,
            is_variational: true,
            is_dissipative: false,
            takes_moments: true,
            takes_inputs_inside: true,
            reports_own_momentum: false,
        };
        let baseline = SchemeDescriptor {
            order: 1,
            is_variational: false,
            takes_moments: false,
            takes_inputs_inside: false,
            reports_own_momentum: true,
            ..variational
        };
        match *self {
            Self::LowOrder { kappa } => SchemeDescriptor {
                order: family.order().min(if kappa == 0.5 { 2 } else { 1 }),
                // With κ = 0 the position of a step does not depend on forces.
                takes_moments: kappa != 0.0,
                takes_inputs_inside: kappa != 0.0,
                ..variational
            },
            // Gauss collocation: forces are evaluated at the nodes, inputs held over steps.
            Self::Galerkin { degree, .. } if matches!(family, ConvolutionFamily::Gauss { .. }) => {
                SchemeDescriptor {
                    unknowns: degree,
                    nodes: degree,
                    order: 2 * degree,
                    order_inside: degree + 1,
                    takes_moments: false,
                    takes_inputs_inside: false,
                    ..variational
                }
            }
            Self::Galerkin { degree, quadrature } => SchemeDescriptor {
                unknowns: degree,
                nodes: stages.or(quadrature.map(|rule| rule.points())).unwrap_or(degree),
                order: family.order().min(2 * degree),
                order_inside: degree + 1,
                ..variational
            },
            Self::Collocation => {
                let stages = stages.unwrap_or(1);
                SchemeDescriptor {
                    unknowns: stages,
                    nodes: stages,
                    order_inside: stages + 1,
                    has_momentum_inside: true,
                    is_variational: false,
                    is_dissipative: true,
                    takes_inputs_inside: false,
                    ..variational
                }
            }
            Self::Energy => SchemeDescriptor {
                order: 2,
                is_variational: false,
                takes_moments: false,
                takes_inputs_inside: false,
                ..variational
            },
            Self::ExplicitEuler | Self::ImplicitEuler => baseline,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Quadrature;

    #[test]
    fn a_description_counts_unknowns_nodes_and_orders() {
        let counts = |scheme: Scheme, family| {
            let SchemeDescriptor { unknowns, nodes, order, .. } = scheme.descriptor(family);
            (unknowns, nodes, order)
        };
        let galerkin = |degree, points| Scheme::Galerkin { degree, quadrature: points };
        let bdf = |order| ConvolutionFamily::Bdf { order };
        assert_eq!(counts(Scheme::LowOrder { kappa: 0.5 }, bdf(2)), (1, 1, 2));
        assert_eq!(counts(Scheme::LowOrder { kappa: 0.3 }, bdf(2)), (1, 1, 1));
        assert_eq!(counts(galerkin(3, Some(Quadrature::Lobatto(4))), bdf(5)), (3, 4, 5));
        assert_eq!(counts(galerkin(2, None), ConvolutionFamily::LobattoIiic { stages: 3 }), (2, 3, 4));
        assert_eq!(counts(Scheme::Collocation, ConvolutionFamily::RadauIia { stages: 3 }), (3, 3, 5));
        assert_eq!(counts(Scheme::ImplicitEuler, bdf(1)), (1, 1, 1));
        assert_eq!(counts(galerkin(3, None), ConvolutionFamily::Gauss { stages: 3 }), (3, 3, 6));
        assert_eq!(counts(Scheme::Energy, ConvolutionFamily::Gauss { stages: 1 }), (1, 1, 2));
    }
}
