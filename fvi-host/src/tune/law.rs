//! A controller in continuous time, and the same sampled.

use fvi_core::{DerivativeFilter, ParameterError, PidGains, PidLaw, PidSettings};
use nalgebra::Complex;

/// C(s): gains, orders, filter and setpoint weights of a law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// Gains, and with them the form.
    pub gains: PidGains<f64>,
    /// λ.
    pub lambda: f64,
    /// μ.
    pub mu: f64,
    /// Derivative filter of the parallel form.
    pub filter: DerivativeFilter,
    /// b and c of the parallel form.
    pub setpoint_weights: [f64; 2],
}

/// Value of a law at one s: u = C_r r − C_y y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LawResponse {
    /// C_r.
    pub setpoint: Complex<f64>,
    /// C_y.
    pub measured: Complex<f64>,
    /// Product of the denominators of C, which has no zeros to the right of the imaginary axis.
    pub denominator: Complex<f64>,
}

/// s^e, the principal branch.
pub(super) fn power(s: Complex<f64>, exponent: f64) -> Complex<f64> {
    if exponent == 0.0 {
        return Complex::new(1.0, 0.0);
    }
    let (size, angle) = (libm::pow(s.norm(), exponent), exponent * libm::atan2(s.im, s.re));
    Complex::new(size * libm::cos(angle), size * libm::sin(angle))
}

/// The filter's polynomial 1 + T s^ν, and s times its derivative.
pub(super) fn filter(filter: DerivativeFilter, s: Complex<f64>) -> [Complex<f64>; 2] {
    let (time, order) = match filter {
        DerivativeFilter::None => (0.0, 1.0),
        DerivativeFilter::FirstOrder { time } => (time, 1.0),
        DerivativeFilter::Fractional { time, order } => (time, order),
    };
    let term = power(s, order) * time;
    [term + 1.0, term * order]
}

impl Law {
    /// Value of the law at s.
    pub fn response(&self, s: Complex<f64>) -> LawResponse {
        let one = Complex::new(1.0, 0.0);
        match self.gains {
            PidGains::Parallel { proportional, integral, derivative } => {
                let below = power(s, self.lambda);
                let [through, _] = filter(self.filter, s);
                let integrated = if integral == 0.0 { Complex::ZERO } else { below.inv() * integral };
                let derived =
                    if derivative == 0.0 { Complex::ZERO } else { power(s, self.mu) * derivative / through };
                let [b, c] = self.setpoint_weights;
                LawResponse {
                    setpoint: integrated + derived * c + proportional * b,
                    measured: integrated + derived + proportional,
                    denominator: if integral == 0.0 { one } else { below }
                        * if derivative == 0.0 { one } else { through },
                }
            }
            PidGains::Series { proportional, integral_rate, derivative_time, filter_ratio } => {
                let below = power(s, self.lambda);
                let derived = power(s, self.mu) * derivative_time;
                let through = derived / filter_ratio + 1.0;
                let whole = (one + below.inv() * integral_rate) * (derived + 1.0) / through * proportional;
                LawResponse { setpoint: whole, measured: whole, denominator: below * through }
            }
        }
    }

    /// The discrete law with sampling time `sample`.
    ///
    /// # Errors
    /// [`ParameterError`].
    pub fn sampled(&self, sample: f64) -> Result<PidLaw<f64>, ParameterError> {
        PidLaw::new(PidSettings {
            integral_order: self.lambda,
            derivative_order: self.mu,
            derivative_filter: self.filter,
            setpoint_weights: self.setpoint_weights,
            ..PidSettings::new(self.gains, sample)
        })
    }

    /// K_p, K_i and K_d; of the series form K_p, K_p/T_i and K_p T_d.
    pub fn three(&self) -> [f64; 3] {
        match self.gains {
            PidGains::Parallel { proportional, integral, derivative } => [proportional, integral, derivative],
            PidGains::Series { proportional, integral_rate, derivative_time, .. } => {
                [proportional, proportional * integral_rate, proportional * derivative_time]
            }
        }
    }
}
