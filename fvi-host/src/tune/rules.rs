//! Named rules.

use super::law::Law;
use super::plant::Plant;
use super::problem::{Purpose, Rule, Structure, Terms};
use fvi_core::PidGains;
use std::f64::consts::PI;

/// Coefficients a, b, c of a x^b + c.
type Curve = [f64; 3];

/// Constants of \[PV11\] for K_p of L/(L + T), T_i/T and T_d/T^μ of L/T.
struct Constants {
    proportional: Curve,
    integral_time: Curve,
    derivative_time: Curve,
    /// μ for L/(L + T) below 0.1, up to 0.4, and above.
    orders: [f64; 3],
}

/// For the purpose and Ms = 1.4 or 2.0: \[PV11\], tables of fractional controllers.
fn constants(purpose: Purpose, ms: f64) -> Constants {
    match (purpose, ms < 1.7) {
        (Purpose::Load, true) => Constants {
            proportional: [0.2776, -1.095, -0.1426],
            integral_time: [0.6241, 0.5573, 0.0442],
            derivative_time: [0.4793, 0.7469, -0.02393],
            orders: [1.0, 1.1, 1.2],
        },
        (Purpose::Load, false) => Constants {
            proportional: [0.1804, -1.449, 0.2319],
            integral_time: [0.6426, 0.8069, 0.05627],
            derivative_time: [0.5970, 0.5568, -0.09536],
            orders: [1.0, 1.1, 1.2],
        },
        (Purpose::Setpoint, true) => Constants {
            proportional: [0.6503, -0.9166, -0.6741],
            integral_time: [0.04701, -0.2611, 0.9276],
            derivative_time: [0.3563, 1.2, 0.000_310_8],
            orders: [1.1, 1.2, 1.2],
        },
        (Purpose::Setpoint, false) => Constants {
            proportional: [0.9294, -0.9330, -0.9205],
            integral_time: [-0.001_427, -1.003, 1.031],
            derivative_time: [0.4203, 1.229, 0.018_22],
            orders: [1.0, 1.1, 1.2],
        },
    }
}

/// The law according to a rule, for a plant and its ultimate gain and frequency.
///
/// # Errors
/// A sentence, where the plant is not of the form that the rule requires.
pub(super) fn by_rule(
    plant: &Plant,
    structure: &Structure,
    (name, ms, purpose, closed_loop_time): (Rule, Option<f64>, Option<Purpose>, Option<f64>),
    ultimate: Option<(f64, f64)>,
) -> Result<Law, String> {
    let parallel = |[proportional, integral, derivative]: [f64; 3]| Law {
        gains: PidGains::Parallel { proportional, integral, derivative },
        lambda: 1.0,
        mu: 1.0,
        filter: structure.filter,
        setpoint_weights: structure.setpoint_weights,
    };
    let no_plant = || "the rule is for another plant".to_owned();
    match name {
        Rule::PadulaVisioli => {
            let plant = plant.first_order().ok_or_else(no_plant)?;
            let (Some(purpose), Some(ms)) = (purpose, ms) else { return Err(no_plant()) };
            let (share, ratio) =
                (plant.dead_time / (plant.dead_time + plant.time), plant.dead_time / plant.time);
            let constants = constants(purpose, ms);
            let curve = |[a, b, c]: Curve, x: f64| a * libm::pow(x, b) + c;
            let [short, middle, long] = constants.orders;
            let mu = if share < 0.1 {
                short
            } else if share < 0.4 {
                middle
            } else {
                long
            };
            let integral_time = plant.time * curve(constants.integral_time, ratio);
            Ok(Law {
                gains: PidGains::Series {
                    proportional: curve(constants.proportional, share) / plant.gain,
                    integral_rate: integral_time.recip(),
                    derivative_time: libm::pow(plant.time, mu) * curve(constants.derivative_time, ratio),
                    // With N = 10 T^{µ−1}, as an implementation has it, the loop would depend on the unit of
                    // time: T is the unit.
                    filter_ratio: 10.0,
                },
                mu,
                ..parallel([0.0; 3])
            })
        }
        Rule::ZieglerNichols => {
            let (gain, omega) = ultimate
                .ok_or_else(|| "the plant has no ultimate gain: its phase does not reach −180°".to_owned())?;
            let period = 2.0 * PI / omega;
            Ok(match structure.terms {
                Terms::Pid => {
                    let proportional = 0.6 * gain;
                    parallel([proportional, proportional / (0.5 * period), proportional * 0.125 * period])
                }
                _ => {
                    let proportional = 0.45 * gain;
                    parallel([proportional, proportional * 1.2 / period, 0.0])
                }
            })
        }
        Rule::Simc => {
            let (gain, [first, second]) = match plant.first_order() {
                Some(plant) => (plant.gain, [plant.time, 0.0]),
                None => plant.two_time_constants().ok_or_else(no_plant)?,
            };
            let dead_time = plant.dead_time();
            let slower = closed_loop_time.unwrap_or(dead_time) + dead_time;
            let (proportional, integral_time) = (first / (gain * slower), first.min(4.0 * slower));
            // K (1 + 1/(T₁ s)) (1 + T₂ s) = K (1 + T₂/T₁) + K/(T₁ s) + K T₂ s
            Ok(parallel([
                proportional * (1.0 + second / integral_time),
                proportional / integral_time,
                proportional * second,
            ]))
        }
        Rule::Lambda => {
            let plant = plant.first_order().ok_or_else(no_plant)?;
            let time = closed_loop_time.ok_or_else(no_plant)?;
            let proportional = plant.time / (plant.gain * (time + plant.dead_time));
            Ok(parallel([proportional, proportional / plant.time, 0.0]))
        }
    }
}
