//! From a scenario's numbers to the core's types.

use super::assembly::{assemble, check_stage_step, check_step};
use super::{Precision, Stepper};
use crate::expression::Elementary;
use crate::scenario::{ConvolutionFamily, InputError, Problem, Quadrature, Scenario, Scheme};
use fvi_core::{ExplicitEuler, Galerkin, ImplicitEuler, ParameterError, RungeKutta, StageGalerkin};
use fvi_fft::Scalar;

type Made = Result<Box<dyn Stepper>, InputError>;

/// Calls `$function` with the number of coordinates as its type parameter.
macro_rules! by_coordinates {
    ($scenario:expr, $function:ident, $($scalar:ty)?) => {
        match $scenario.coordinates() {
            1 => $function::<$($scalar,)? 1>($scenario),
            2 => $function::<$($scalar,)? 2>($scenario),
            3 => $function::<$($scalar,)? 3>($scenario),
            4 => $function::<$($scalar,)? 4>($scenario),
            5 => $function::<$($scalar,)? 5>($scenario),
            6 => $function::<$($scalar,)? 6>($scenario),
            7 => $function::<$($scalar,)? 7>($scenario),
            _ => $function::<$($scalar,)? 8>($scenario),
        }
    };
}

/// The integrator of a scenario.
///
/// Galerkin schemes come in double precision only: there is one for each degree and number of coordinates, and their orders are beyond what single precision resolves.
pub(super) fn stepper(scenario: &Scenario, precision: Precision) -> Made {
    match (scenario.scheme, precision) {
        (Scheme::Galerkin { .. }, Precision::F64) => by_coordinates!(scenario, galerkin,),
        (Scheme::Galerkin { .. }, Precision::F32) => Err(scenario.error_at(
            "scheme.kind",
            Problem::Incompatible {
                with: "`--precision f32`".to_owned(),
                allowed: "\"low-order\", \"explicit-euler\", \"implicit-euler\"".to_owned(),
            },
        )),
        (_, Precision::F64) => by_coordinates!(scenario, one_node, f64),
        (_, Precision::F32) => by_coordinates!(scenario, one_node, f32),
    }
}

/// The schemes with one node.
fn one_node<T: Elementary + Scalar, const N: usize>(scenario: &Scenario) -> Made {
    match scenario.scheme {
        Scheme::ExplicitEuler => assemble::<T, N, 1, _>(scenario, ExplicitEuler),
        Scheme::ImplicitEuler => assemble::<T, N, 1, _>(scenario, ImplicitEuler),
        Scheme::LowOrder { kappa } => {
            let refused = |_| {
                scenario.error_at("scheme.kappa", Problem::OutOfRange { allowed: "0 ≤ κ ≤ 1".to_owned() })
            };
            let checked = Galerkin::low_order(kappa).map_err(refused)?;
            check_step::<N, 1, 1>(scenario, &checked)?;
            assemble::<T, N, 1, _>(scenario, Galerkin::low_order(T::of(kappa)).map_err(refused)?)
        }
        Scheme::Galerkin { .. } => Err(wrong_shape(scenario)),
    }
}

/// Calls `$function` with degree and number of points as its type parameters, for the pairs listed.
macro_rules! by_shape {
    ($scenario:expr, $degree:expr, $points:expr, $function:ident, $($s:literal: $($q:literal)*;)*) => {
        match ($degree, $points) {
            $($(($s, $q) => $function::<N, $s, $q>($scenario),)*)*
            _ => Err(wrong_shape($scenario)),
        }
    };
}

/// The Galerkin schemes: damped at the main nodes, or at the stages of a Runge–Kutta method.
fn galerkin<const N: usize>(scenario: &Scenario) -> Made {
    let Scheme::Galerkin { degree, .. } = scenario.scheme else { return Err(wrong_shape(scenario)) };
    match scenario.convolution.family {
        ConvolutionFamily::Bdf { .. } => {
            let refused = |_| wrong_shape(scenario);
            let rule = scenario.scheme.quadrature().and_then(rule).transpose().map_err(refused)?;
            let rule = rule.ok_or_else(|| wrong_shape(scenario))?;
            match degree {
                1 => main_nodes::<N, 1>(scenario, &rule),
                2 => main_nodes::<N, 2>(scenario, &rule),
                3 => main_nodes::<N, 3>(scenario, &rule),
                4 => main_nodes::<N, 4>(scenario, &rule),
                5 => main_nodes::<N, 5>(scenario, &rule),
                6 => main_nodes::<N, 6>(scenario, &rule),
                _ => Err(wrong_shape(scenario)),
            }
        }
        ConvolutionFamily::RadauIia { stages } | ConvolutionFamily::LobattoIiic { stages } => {
            by_shape!(scenario, degree, stages, at_stages, 1: 1 2 3 4; 2: 2 3 4; 3: 3 4; 4: 4;)
        }
    }
}

/// Most quadrature points of a scenario. Rules are padded to it, so that there is one integrator for each degree.
const POINTS: usize = 7;

/// The quadrature of a scenario; `None` for a number of points that no rule has.
fn rule(quadrature: Quadrature) -> Option<Result<fvi_core::Quadrature<POINTS>, ParameterError>> {
    macro_rules! padded {
        ($rule:ident, $points:expr, $($q:literal)*) => {
            match $points {
                $($q => Some(fvi_core::Quadrature::<$q>::$rule().and_then(|rule| rule.padded())),)*
                _ => None,
            }
        };
    }
    match quadrature {
        Quadrature::Gauss(points) => padded!(gauss, points, 1 2 3 4 5 6),
        Quadrature::Lobatto(points) => padded!(lobatto, points, 2 3 4 5 6 7),
    }
}

fn main_nodes<const N: usize, const S: usize>(
    scenario: &Scenario,
    rule: &fvi_core::Quadrature<POINTS>,
) -> Made {
    let scheme = Galerkin::<f64, S, POINTS>::new(rule).map_err(|_| wrong_shape(scenario))?;
    check_step::<N, S, POINTS>(scenario, &scheme)?;
    assemble::<f64, N, 1, _>(scenario, scheme)
}

fn at_stages<const N: usize, const S: usize, const R: usize>(scenario: &Scenario) -> Made {
    let method = match scenario.convolution.family {
        ConvolutionFamily::LobattoIiic { .. } => RungeKutta::<R>::lobatto_iiic(),
        _ => RungeKutta::<R>::radau_iia(),
    };
    let refused = |_| wrong_shape(scenario);
    let method = method.map_err(refused)?;
    let scheme = StageGalerkin::<f64, S, R>::new(&method).map_err(refused)?;
    check_stage_step::<N, R>(scenario, &method, S)?;
    assemble::<f64, N, R, _>(scenario, scheme)
}

/// A degree with fewer nodes than it needs.
fn wrong_shape(scenario: &Scenario) -> InputError {
    let allowed = "at most as many as there are quadrature points or stages".to_owned();
    scenario.error_at("scheme.degree", Problem::OutOfRange { allowed })
}
