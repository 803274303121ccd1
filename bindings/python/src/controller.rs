//! A fractional PID controller as an object.

use crate::errors::{Failure, Outcome, guarded};
use fvi_core::{Actuator, PidError, PidGains, PidInputs, StateReader, StateWriter, Stateful};
use fvi_scenario::language::InputError;
use fvi_scenario::scenario::Scenario;
use fvi_simulation::simulation::control::{SumPid, pid};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A controller in double precision.
#[pyclass(frozen, subclass, module = "fvi._fvi", name = "FractionalPid")]
pub(crate) struct FractionalPid {
    pid: Mutex<SumPid<f64>>,
}

fn locked(mutex: &Mutex<SumPid<f64>>) -> MutexGuard<'_, SumPid<f64>> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Converts the path of a controller's key in an error to the name of the argument.
fn about(error: &InputError) -> Failure {
    let key = error.key().trim_start_matches("controller.").to_owned();
    let key = if key == "lambda" { "lam".to_owned() } else { key };
    let value = error.value().to_owned();
    let mut message = format!("{key} = {value}: {}", error.problem());
    if let Some(allowed) = error.problem().allowed() {
        message += &format!("; {allowed}");
    }
    Failure::Input { key, value, message }
}

fn refused(error: PidError) -> Failure {
    Failure::Input { key: "tick".to_owned(), value: String::new(), message: error.to_string() }
}

#[pymethods]
impl FractionalPid {
    /// A controller from a scenario in JSON with one controller; `length` is the largest number of samples.
    #[new]
    fn new(document: &str, length: usize) -> PyResult<Self> {
        guarded(|| {
            let value: serde_json::Value =
                serde_json::from_str(document).map_err(|error| Failure::Failed(error.to_string()))?;
            let scenario = Scenario::from_value(&value).map_err(|error| about(&error))?;
            let made = scenario.controllers.first().map(|controller| pid::<f64>(&scenario, controller));
            let none = || Failure::Failed("no controller".to_owned());
            let made = made.ok_or_else(none)?.map_err(|unusable| Failure::Input {
                key: "length".to_owned(),
                value: length.to_string(),
                message: unusable.error(&scenario, 0).problem().to_string(),
            })?;
            Ok(Self { pid: Mutex::new(made) })
        })
    }

    #[pyo3(signature = (setpoint, measured, feed_forward, applied, limited))]
    fn tick(
        &self,
        setpoint: f64,
        measured: f64,
        feed_forward: f64,
        applied: Option<f64>,
        limited: bool,
    ) -> PyResult<f64> {
        let actuator = match (applied, limited) {
            (_, true) => Actuator::Limited,
            (Some(applied), false) => Actuator::Applied(applied),
            (None, false) => Actuator::Followed,
        };
        let inputs = PidInputs { feed_forward, actuator, ..PidInputs::new(setpoint, measured) };
        guarded(|| locked(&self.pid).tick_with(&inputs).map_err(refused))
    }

    fn manual(&self, output: f64) -> PyResult<()> {
        guarded(|| locked(&self.pid).manual(output).map_err(refused))
    }

    fn automatic(&self) {
        locked(&self.pid).automatic();
    }

    fn set_gains(&self, kp: f64, ki: f64, kd: f64) -> PyResult<()> {
        guarded(|| {
            let mut pid = locked(&self.pid);
            let gains = match pid.law().settings().gains {
                PidGains::Parallel { .. } => {
                    PidGains::Parallel { proportional: kp, integral: ki, derivative: kd }
                }
                PidGains::Series { filter_ratio, .. } => PidGains::Series {
                    proportional: kp,
                    integral_rate: ki,
                    derivative_time: kd,
                    filter_ratio,
                },
            };
            pid.set_gains(gains).map_err(|error| Failure::Input {
                key: error.parameter.to_owned(),
                value: error.value.to_string(),
                message: error.to_string(),
            })
        })
    }

    fn reset(&self) {
        locked(&self.pid).reset();
    }

    #[getter]
    fn output(&self) -> f64 {
        locked(&self.pid).output()
    }

    #[getter]
    fn integral(&self) -> f64 {
        locked(&self.pid).integral()
    }

    #[getter]
    fn is_manual(&self) -> bool {
        locked(&self.pid).is_manual()
    }

    /// (Re, Im) of C_r and of C_y; `None` outside 0 < ω ≤ π/h.
    fn response(&self, omega: f64) -> Option<[f64; 4]> {
        let response = locked(&self.pid).law().response(omega)?;
        let (of_r, of_y) = (response.setpoint, response.measured);
        Some([of_r.re, of_r.im, of_y.re, of_y.im])
    }

    fn save<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let state = guarded(|| -> Outcome<Vec<u8>> {
            let pid = locked(&self.pid);
            let mut room = vec![0; pid.state_bytes()];
            let mut writer = StateWriter::new(&mut room);
            pid.save(&mut writer).map_err(|error| Failure::Failed(error.to_string()))?;
            Ok(room)
        })?;
        Ok(PyBytes::new(py, &state))
    }

    fn restore(&self, state: &[u8]) -> PyResult<()> {
        guarded(|| {
            let mut reader = StateReader::new(state);
            locked(&self.pid).restore(&mut reader).map_err(|error| Failure::Input {
                key: "state".to_owned(),
                value: String::new(),
                message: format!("state: {error}"),
            })
        })
    }
}
