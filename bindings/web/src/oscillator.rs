//! A fractionally damped oscillator, alone and under a fractional PID controller.

use fvi_core::nalgebra::SVector;
use fvi_core::{
    BdfOrder, Coefficients, ConvolutionWeights, DampingError, DampingTerm, Derivative, FixedDirect,
    FractionalPid, Galerkin, Instant, Integrator, IntegratorError, Kernel, Mass, MatrixError, NodeGalerkin,
    ParameterError, PidError, PidGains, PidLaw, PidSettings, Quadratic, StepError, System, TimeForce,
};

/// Samples that a memory holds: those at the beginning and at the ends of 2048 steps.
pub(crate) const SAMPLES: usize = 2049;

/// Position, momentum, and external force over the following step.
pub(crate) type Row = [f64; 3];

/// Input of a computation; all fields are numbers, which JavaScript writes one after another.
///
/// ```text
/// plant        m q̈ + ρ D^β q + k q = F + u
/// controller   u = K_p (r − q) + K_i I^λ (r − q) − K_d D^μ q
/// ```
#[derive(Clone, Copy)]
#[repr(C)]
pub(crate) struct Settings {
    /// m
    pub(crate) mass: f64,
    /// k
    pub(crate) stiffness: f64,
    /// ρ
    pub(crate) damping: f64,
    /// β, the order of the damping, 0 ≤ β < 2.
    pub(crate) damping_order: f64,
    /// Order of the backward differentiation formula for the weights of D^β, 1…6.
    pub(crate) bdf_order: f64,
    /// h, which is also the sampling time of the controller.
    pub(crate) step_size: f64,
    /// Number of steps, at most [`SAMPLES`] − 1.
    pub(crate) steps: f64,
    /// q(0). D^β is the Caputo derivative.
    pub(crate) position: f64,
    /// q̇(0)
    pub(crate) velocity: f64,
    /// F, from t = 0 on; ignored with a controller.
    pub(crate) force: f64,
    /// K_p
    pub(crate) proportional: f64,
    /// K_i
    pub(crate) integral: f64,
    /// K_d
    pub(crate) derivative: f64,
    /// λ
    pub(crate) integral_order: f64,
    /// μ
    pub(crate) derivative_order: f64,
    /// r, from t = 0 on.
    pub(crate) setpoint: f64,
}

impl Settings {
    pub(crate) const ZERO: Self = Self {
        mass: 0.0,
        stiffness: 0.0,
        damping: 0.0,
        damping_order: 0.0,
        bdf_order: 0.0,
        step_size: 0.0,
        steps: 0.0,
        position: 0.0,
        velocity: 0.0,
        force: 0.0,
        proportional: 0.0,
        integral: 0.0,
        derivative: 0.0,
        integral_order: 0.0,
        derivative_order: 0.0,
        setpoint: 0.0,
    };

    fn steps(&self) -> Result<usize, Refusal> {
        let steps = self.steps as usize;
        if steps as f64 == self.steps && (1..SAMPLES).contains(&steps) {
            Ok(steps)
        } else {
            Err(Refusal {
                what: "number of steps",
                value: self.steps,
                allowed: "a whole number from 1 to 2048",
            })
        }
    }

    fn check_damping_order(&self) -> Result<(), Refusal> {
        let order = self.damping_order;
        if (0.0..2.0).contains(&order) {
            Ok(())
        } else {
            Err(Refusal { what: "damping order β", value: order, allowed: "at least 0 and less than 2" })
        }
    }

    fn bdf_order(&self) -> Result<BdfOrder, Refusal> {
        let what = "order of the backward differentiation formula";
        let order = self.bdf_order as usize;
        if order as f64 != self.bdf_order {
            return Err(Refusal { what, value: self.bdf_order, allowed: "one of 1, 2, 3, 4, 5, 6" });
        }
        Ok(BdfOrder::new(order)?)
    }

    /// The law of the controller.
    fn law(&self) -> Result<PidLaw<f64>, ParameterError> {
        let gains = PidGains::Parallel {
            proportional: self.proportional,
            integral: self.integral,
            derivative: self.derivative,
        };
        PidLaw::new(PidSettings {
            integral_order: self.integral_order,
            derivative_order: self.derivative_order,
            ..PidSettings::new(gains, self.step_size)
        })
    }
}

/// The weights of D^β, of the integral and of the derivative.
pub(crate) struct Tables {
    damping: [f64; SAMPLES],
    integral: [f64; SAMPLES],
    derivative: [f64; SAMPLES],
}

impl Tables {
    pub(crate) const EMPTY: Self =
        Self { damping: [0.0; SAMPLES], integral: [0.0; SAMPLES], derivative: [0.0; SAMPLES] };
}

/// Why something was not computed.
pub(crate) struct Refusal {
    /// Name of the setting, or the event.
    pub(crate) what: &'static str,
    /// Its value; NaN if there is none.
    pub(crate) value: f64,
    /// The values that are allowed, or empty.
    pub(crate) allowed: &'static str,
}

impl Refusal {
    fn without_value(what: &'static str) -> Self {
        Self { what, value: f64::NAN, allowed: "" }
    }
}

impl From<ParameterError> for Refusal {
    fn from(error: ParameterError) -> Self {
        Self { what: error.parameter, value: error.value, allowed: error.allowed }
    }
}

impl From<MatrixError> for Refusal {
    fn from(_: MatrixError) -> Self {
        Self { what: "mass or stiffness", value: f64::NAN, allowed: "finite, the mass positive" }
    }
}

impl From<DampingError> for Refusal {
    fn from(error: DampingError) -> Self {
        match error {
            DampingError::Order(error) | DampingError::Kernel(error) => error.into(),
            _ => Self { what: "damping coefficient", value: f64::NAN, allowed: "finite and not negative" },
        }
    }
}

impl From<IntegratorError> for Refusal {
    fn from(error: IntegratorError) -> Self {
        match error {
            IntegratorError::StepSize(error) => error.into(),
            IntegratorError::InitialState => Self::without_value("the initial position or velocity"),
            _ => Self::without_value("the damping does not go with the step"),
        }
    }
}

impl From<StepError> for Refusal {
    fn from(_: StepError) -> Self {
        Self::without_value("a step led to numbers that are not finite")
    }
}

impl From<PidError> for Refusal {
    fn from(_: PidError) -> Self {
        Self::without_value("the controller met numbers that are not finite")
    }
}

/// A memory of all samples.
type Ring<'w> = FixedDirect<'w, f64, 1, SAMPLES>;

/// w_n/w₀ of D^`exponent` for the length of the table, or their partial sums, computed as in `fvi run`.
fn tabulate(
    table: &mut [f64; SAMPLES],
    order: BdfOrder,
    exponent: f64,
    increments: bool,
    steps: usize,
) -> Result<&[f64], ParameterError> {
    // With this step size the leading weight is 1.
    let weights = ConvolutionWeights::bdf(order, exponent, order.generating_function(0.0))?;
    let mut weights = if increments { weights.on_increments() } else { weights };
    let table = table.get_mut(..=steps).unwrap_or(&mut []);
    weights.fill(table);
    Ok(table)
}

/// Creates the plant: an oscillator integrated by the midpoint rule, damped at its node.
macro_rules! plant {
    ($settings:expr, $table:expr, $steps:expr, $force:expr) => {{
        let (settings, force): (&Settings, f64) = ($settings, $force);
        let order = settings.bdf_order()?;
        settings.check_damping_order()?;
        let kernel = Kernel::bdf(order, settings.damping_order, settings.step_size)?;
        let table = tabulate($table, order, settings.damping_order, true, $steps)?;
        let memory: Ring<'_> = kernel.full_memory(table)?;
        let rho = Coefficients::Diagonal(SVector::from([settings.damping]));
        let damping = DampingTerm::new(kernel, rho, Derivative::Caputo, memory)?;
        let system = System {
            mass: Mass::diagonal([settings.mass])?,
            potential: Quadratic::diagonal([settings.stiffness])?,
            force: TimeForce(move |_: Instant<f64>| SVector::from([force])),
        };
        Integrator::builder(system, NodeGalerkin::new(Galerkin::low_order(0.5)?), settings.step_size)
            .damping(damping)
            .position([settings.position])
            .velocity([settings.velocity])
            .build()?
    }};
}

/// Computes the oscillator under the force F, a row for every point of the grid.
pub(crate) fn motion(
    settings: &Settings,
    tables: &mut Tables,
    rows: &mut [Row; SAMPLES],
    written: &mut usize,
) -> Result<(), Refusal> {
    let steps = settings.steps()?;
    let mut plant = plant!(settings, &mut tables.damping, steps, settings.force);
    for (k, row) in rows.iter_mut().take(steps + 1).enumerate() {
        let state = plant.state();
        *row = [state.position[0], state.momentum[0], settings.force];
        *written += 1;
        if k < steps {
            plant.step(&SVector::from([0.0]))?;
        }
    }
    Ok(())
}

/// Computes the oscillator under the controller, which ticks at every point of the grid; its output is held
/// until the next.
pub(crate) fn controlled(
    settings: &Settings,
    tables: &mut Tables,
    rows: &mut [Row; SAMPLES],
    written: &mut usize,
) -> Result<(), Refusal> {
    let steps = settings.steps()?;
    let Tables { damping, integral, derivative } = tables;
    let mut plant = plant!(settings, damping, steps, 0.0);
    let law = settings.law()?;
    let one = BdfOrder::GRUNWALD_LETNIKOV;
    let kernel = law.integral_kernel()?;
    let integral: Ring<'_> =
        kernel.full_memory(tabulate(integral, one, kernel.symbol().growth(), false, steps)?)?;
    let kernel = law.derivative_kernel()?;
    let derivative: Ring<'_> =
        kernel.full_memory(tabulate(derivative, one, kernel.symbol().growth(), true, steps)?)?;
    let mut controller = FractionalPid::new(law, integral, derivative)?;
    for (k, row) in rows.iter_mut().take(steps + 1).enumerate() {
        let state = plant.state();
        let (position, momentum) = (state.position[0], state.momentum[0]);
        let output = controller.tick(settings.setpoint, position)?;
        *row = [position, momentum, output];
        *written += 1;
        if k < steps {
            plant.step(&SVector::from([output]))?;
        }
    }
    Ok(())
}

/// The plant P(iω) = 1/(m (iω)² + ρ (iω)^β + k) and the loop C P, with C of the sampled controller: their
/// real and imaginary parts.
pub(crate) fn response(settings: &Settings, omega: f64) -> Result<[f64; 4], Refusal> {
    settings.check_damping_order()?;
    let law = settings.law()?;
    let outside = Refusal { what: "frequency", value: omega, allowed: "greater than 0 and at most π/h" };
    let controller = law.response(omega).ok_or(outside)?.measured;
    let angle = 0.5 * core::f64::consts::PI * settings.damping_order;
    let size = settings.damping * libm::pow(omega, settings.damping_order);
    let real = settings.stiffness - settings.mass * omega * omega + size * libm::cos(angle);
    let imaginary = size * libm::sin(angle);
    let square = real * real + imaginary * imaginary;
    let (real, imaginary) = (real / square, -imaginary / square);
    Ok([
        real,
        imaginary,
        controller.re * real - controller.im * imaginary,
        controller.re * imaginary + controller.im * real,
    ])
}
