//! Weights of convolution quadrature.

use crate::errors::{Failure, Outcome, guarded};
use crate::memory::{keys, transfer};
use fvi_core::{ParameterError, RungeKutta};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::quadrature::multistep_weights::multistep_weights;
use fvi_fft::quadrature::runge_kutta_weights::RungeKuttaWeights;
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::multistep_rule::MultistepRule;
use fvi_scenario::language::memory_limit::check_capacity;
use fvi_scenario::scenario::{Convolution, DampedAt};
use numpy::{IntoPyArray, PyArrayDyn, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The weights w₀, …, w_{count−1}: numbers for BDF, matrices for Runge–Kutta methods.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the arguments of the function in Python")]
pub(crate) fn weights<'py>(
    py: Python<'py>,
    family: &str,
    order: usize,
    stages: Option<usize>,
    exponent: Option<f64>,
    kernel: Option<&Bound<'py, PyDict>>,
    step: f64,
    count: usize,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let kernel = keys(kernel)?;
    let (numbers, stages) = py.detach(|| {
        guarded(|| {
            let convolution = convolution(family, order, stages)?;
            let transfer = transfer(exponent, kernel)?;
            let power = || {
                let allowed = "an exponent with this family; kernels have weights of \"bdf\"";
                transfer.exponent().ok_or_else(|| Failure::argument("kernel", &transfer, allowed))
            };
            let (numbers, stages) = match convolution.family {
                ConvolutionFamily::Bdf { .. } | ConvolutionFamily::Trapezoidal => {
                    room(count)?;
                    let rule = convolution.family.multistep()?.unwrap_or(MultistepRule::Trapezoidal);
                    (multistep_weights(&transfer, rule, step, false, count)?, None)
                }
                ConvolutionFamily::RadauIia { stages } => match stages {
                    1 => (matrices(RungeKutta::<1>::radau_iia(), power()?, step, count)?, Some(1)),
                    2 => (matrices(RungeKutta::<2>::radau_iia(), power()?, step, count)?, Some(2)),
                    _ => (matrices(RungeKutta::<3>::radau_iia(), power()?, step, count)?, Some(3)),
                },
                ConvolutionFamily::LobattoIiic { stages } => match stages {
                    2 => (matrices(RungeKutta::<2>::lobatto_iiic(), power()?, step, count)?, Some(2)),
                    3 => (matrices(RungeKutta::<3>::lobatto_iiic(), power()?, step, count)?, Some(3)),
                    _ => (matrices(RungeKutta::<4>::lobatto_iiic(), power()?, step, count)?, Some(4)),
                },
                // No family of this function; mechanisms have it.
                ConvolutionFamily::Gauss { .. } => {
                    return Err(Failure::argument(
                        "family",
                        family,
                        "\"bdf\", \"trapezoidal\", \"radau-iia\" or \"lobatto-iiic\"",
                    ));
                }
            };
            // Late ones may underflow, as those of exp(−s).
            let largest = numbers.iter().fold(0.0, |most, weight| max_or_nan(most, weight.abs()));
            if largest == 0.0 || largest.is_normal() {
                Ok((numbers, stages))
            } else {
                let allowed = "a step whose weights, h^(-exponent) in size, double precision holds";
                Err(Failure::argument("step", step, allowed))
            }
        })
    })?;
    let shape = match stages {
        None => vec![count],
        Some(stages) => vec![count, stages, stages],
    };
    numbers.into_pyarray(py).reshape(shape)
}

fn room(count: usize) -> Outcome<()> {
    check_capacity(count.saturating_mul(size_of::<f64>()))
        .map_err(|error| Failure::NoRoom(format!("count = {count}: {error}")))
}

/// Matrices one after the other, row by row.
fn matrices<const R: usize>(
    method: Result<RungeKutta<R>, ParameterError>,
    exponent: f64,
    step: f64,
    count: usize,
) -> Outcome<Vec<f64>> {
    room(count.saturating_mul(2 * R * R))?;
    let planes = RungeKuttaWeights::new(&method?, exponent, step, count)?.planes();
    let mut numbers = Vec::with_capacity(planes.len());
    for n in 0..count {
        numbers.extend(planes.iter().skip(n).step_by(count.max(1)));
    }
    Ok(numbers)
}

/// A quadrature from its names, as in `[convolution]`.
pub(crate) fn convolution(family: &str, order: usize, stages: Option<usize>) -> Outcome<Convolution> {
    let staged = |of_family: &[usize], allowed: &str| match stages {
        Some(stages) if of_family.contains(&stages) => Ok(stages),
        Some(stages) => Err(Failure::argument("stages", stages, allowed)),
        None => Err(Failure::argument("stages", "None", allowed)),
    };
    let family = match family {
        "bdf" => {
            if let Some(stages) = stages {
                return Err(Failure::argument("stages", stages, "none with the family \"bdf\""));
            }
            if !(1..=6).contains(&order) {
                return Err(Failure::argument("order", order, "a whole number from 1 to 6"));
            }
            ConvolutionFamily::Bdf { order }
        }
        "trapezoidal" => match stages {
            Some(stages) => {
                return Err(Failure::argument("stages", stages, "none with the family \"trapezoidal\""));
            }
            None => ConvolutionFamily::Trapezoidal,
        },
        "radau-iia" => ConvolutionFamily::RadauIia {
            stages: staged(&[1, 2, 3, 5, 7], "1, 2, 3, 5 or 7 with \"radau-iia\"")?,
        },
        "lobatto-iiic" => {
            ConvolutionFamily::LobattoIiic { stages: staged(&[2, 3, 4], "2, 3 or 4 with \"lobatto-iiic\"")? }
        }
        other => {
            let allowed = "\"bdf\", \"trapezoidal\", \"radau-iia\", \"lobatto-iiic\"";
            return Err(Failure::argument("family", format!("{other:?}"), allowed));
        }
    };
    Ok(Convolution { family, at: DampedAt::Nodes, starting: Vec::new() })
}
