//! Families of convolution quadrature.

use super::staged_method::StagedMethod;
use crate::transfer::multistep_rule::MultistepRule;
use fvi_core::{BdfOrder, ParameterError};
use serde::Serialize;
use serde::ser::SerializeMap as _;

/// The method on which a convolution quadrature is based.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConvolutionFamily {
    /// Backward differentiation formulas.
    Bdf {
        /// Order p, 1 to 6.
        order: usize,
    },
    /// The trapezoidal rule, of order 2.
    Trapezoidal,
    /// Radau IIA methods.
    RadauIia {
        /// Number of stages, 1 to 3.
        stages: usize,
    },
    /// Lobatto IIIC methods.
    LobattoIiic {
        /// Number of stages, 2 to 4.
        stages: usize,
    },
    /// The Gauss method of a [mechanism](fvi_core::MechanismIntegrator), whose dampers integrate the kernel's
    /// relaxations with it.
    Gauss {
        /// Number of stages, 1 to 6.
        stages: usize,
    },
}

impl Serialize for ConvolutionFamily {
    /// The keys of `[convolution]`.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        match self {
            Self::Bdf { order } => {
                map.serialize_entry("family", "bdf")?;
                map.serialize_entry("order", order)?;
            }
            Self::Trapezoidal => map.serialize_entry("symbol", "trapezoidal")?,
            Self::RadauIia { stages } => {
                map.serialize_entry("family", "radau-iia")?;
                map.serialize_entry("stages", stages)?;
            }
            Self::LobattoIiic { stages } => {
                map.serialize_entry("family", "lobatto-iiic")?;
                map.serialize_entry("stages", stages)?;
            }
            Self::Gauss { .. } => map.serialize_entry("family", "gauss")?,
        }
        map.end()
    }
}

impl ConvolutionFamily {
    /// The underlying multistep rule; `None` for Runge–Kutta families.
    ///
    /// # Errors
    /// If its order is outside 1 to 6.
    pub fn multistep(&self) -> Result<Option<MultistepRule>, ParameterError> {
        Ok(match self {
            Self::Bdf { order } => Some(BdfOrder::new(*order)?.into()),
            Self::Trapezoidal => Some(MultistepRule::Trapezoidal),
            Self::RadauIia { .. } | Self::LobattoIiic { .. } | Self::Gauss { .. } => None,
        })
    }

    /// The underlying stiffly accurate Runge–Kutta method; `None` for multistep rules and for Gauss's.
    pub fn staged(&self) -> Option<StagedMethod> {
        match *self {
            Self::RadauIia { stages } => Some(StagedMethod::RadauIia(stages)),
            Self::LobattoIiic { stages } => Some(StagedMethod::LobattoIiic(stages)),
            Self::Bdf { .. } | Self::Trapezoidal | Self::Gauss { .. } => None,
        }
    }

    /// True if it is a Runge–Kutta family, with stages.
    pub fn is_staged(&self) -> bool {
        !matches!(self, Self::Bdf { .. } | Self::Trapezoidal)
    }

    /// Order of the quadrature on smooth signals.
    pub fn order(&self) -> usize {
        match (*self, self.staged()) {
            (_, Some(method)) => method.order(),
            (Self::Bdf { order }, _) => order,
            (Self::Gauss { stages }, _) => 2 * stages,
            _ => 2,
        }
    }
}
