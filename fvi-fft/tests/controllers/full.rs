/// Integral, s^-1.25 but for a sum: 5 weights, then 9 exponentials; tolerance 1e-3.
///
/// A memory on it ends after 1000 samples: it refuses further ones, or forgets.
///
/// `fvi_core::Kernel::exponential_sum` takes it, with `FULL_INTEGRAL.state_len(channels)` numbers of state.
pub const FULL_INTEGRAL: fvi_core::ExponentialTable<&[f32]> = fvi_core::ExponentialTable {
    stages: 1,
    head: &[
        1e0, 2.5e-1, 1.5625e-1, 1.171875e-1,
        9.5214844e-2,
    ],
    exponentials: &[
        1.9584842e-4, 1.2008279e-3, 3.570495e-3, 1.0075238e-2,
        1.1213715e-3, 1.7552489e-3, 3.3755244e-3, 7.082148e-3,
        2.808348e-2, 7.5814106e-2, 1.8890063e-1, 3.980229e-1,
        1.3873978e-2, 2.2431573e-2, 2.2419432e-2, 8.194768e-3,
        6.560219e-1, 0e0, 0e0, 0e0,
        6.768127e-4, 0e0, 0e0, 0e0,
    ],
    slow_blocks: 2,
    far_blocks: 0,
    horizon: 1000,
    step_size: 1.0,
};

/// Derivative, s^0.75: 5 weights, then 9 exponentials; tolerance 1e-3.
///
/// A memory on it ends after 1000 samples: it refuses further ones, or forgets.
///
/// `fvi_core::Kernel::exponential_sum` takes it, with `FULL_DERIVATIVE.state_len(channels)` numbers of state.
pub const FULL_DERIVATIVE: fvi_core::ExponentialTable<&[f32]> = fvi_core::ExponentialTable {
    stages: 1,
    head: &[
        1e0, 2.5e-1, 1.5625e-1, 1.171875e-1,
        9.5214844e-2,
    ],
    exponentials: &[
        1.9584842e-4, 1.2008279e-3, 3.570495e-3, 1.0075238e-2,
        1.1213715e-3, 1.7552489e-3, 3.3755244e-3, 7.082148e-3,
        2.808348e-2, 7.5814106e-2, 1.8890063e-1, 3.980229e-1,
        1.3873978e-2, 2.2431573e-2, 2.2419432e-2, 8.194768e-3,
        6.560219e-1, 0e0, 0e0, 0e0,
        6.768127e-4, 0e0, 0e0, 0e0,
    ],
    slow_blocks: 2,
    far_blocks: 0,
    horizon: 1000,
    step_size: 1.0,
};

/// Filter of the derivative: 5 weights, then 10 exponentials; tolerance 1e-3.
///
/// A memory on it ends after 1000 samples: it refuses further ones, or forgets.
///
/// `fvi_core::Kernel::exponential_sum` takes it, with `FULL_FILTER.state_len(channels)` numbers of state.
pub const FULL_FILTER: fvi_core::ExponentialTable<&[f32]> = fvi_core::ExponentialTable {
    stages: 1,
    head: &[
        1e0, 1.25e-1, 7.03125e-2, 4.9804688e-2,
        3.8909912e-2,
    ],
    exponentials: &[
        1.1453428e-4, 6.239625e-4, 1.7824044e-3, 4.859688e-3,
        1.1807378e-4, 2.2204219e-4, 4.785572e-4, 1.1299899e-3,
        1.3173772e-2, 3.5208546e-2, 9.071134e-2, 2.1427658e-1,
        2.59038e-3, 5.4534595e-3, 9.213701e-3, 9.246847e-3,
        4.2709967e-1, 6.7490214e-1, 0e0, 0e0,
        3.3496688e-3, 2.9736743e-4, 0e0, 0e0,
    ],
    slow_blocks: 2,
    far_blocks: 0,
    horizon: 1000,
    step_size: 1.0,
};

/// The law of the controller, sample 0.01.
///
/// # Errors
/// None: it has been checked.
pub fn full_law() -> Result<fvi_core::PidLaw<f32>, fvi_core::ParameterError> {
    fvi_core::PidLaw::new(fvi_core::PidSettings {
        gains: fvi_core::PidGains::Parallel { proportional: 2.0, integral: 1.5, derivative: 0.25 },
        integral_order: 1.25,
        derivative_order: 0.75,
        sample: Some(0.01),
        setpoint_weights: [0.5, 0.25],
        derivative_of: fvi_core::DerivativeOf::ValuesFromRest,
        derivative_filter: fvi_core::DerivativeFilter::Fractional { time: 0.0625, order: 0.875 },
        limits: [f32::NEG_INFINITY, f32::INFINITY],
        rate_limit: 64.0,
        anti_windup: fvi_core::AntiWindup::None,
        bumpless: fvi_core::Bumpless::Whole,
    })
}

/// The controller, with a law of its own or one that it borrows. It
/// ends after 1000 samples, 10 units of time: further ticks are refused.
pub type FullPid<L = fvi_core::PidLaw<f32>> = fvi_core::FractionalPid<f32, fvi_core::ExponentialSum<f32, &'static [f32], [f32; FULL_INTEGRAL.state_len(1)]>, fvi_core::ExponentialSum<f32, &'static [f32], [f32; FULL_DERIVATIVE.state_len(1)]>, L, fvi_core::ExponentialSum<f32, &'static [f32], [f32; FULL_FILTER.state_len(1)]>>;

/// The controller with a law of its own, before its first tick.
///
/// # Errors
/// None: it has been checked.
pub fn new_full() -> Result<FullPid, fvi_core::ParameterError> {
    full_with(full_law()?)
}

/// The same with this law, by value or by reference: one with other gains, or one that loops share.
///
/// # Errors
/// If its orders or its sample time are others than those of the tables.
pub fn full_with<L: core::borrow::Borrow<fvi_core::PidLaw<f32>>>(
    law: L,
) -> Result<FullPid<L>, fvi_core::ParameterError> {
    let shared: &fvi_core::PidLaw<f32> = law.borrow();
    let integral = shared.integral_kernel()?.exponential_sum(FULL_INTEGRAL, 1, [0.0; FULL_INTEGRAL.state_len(1)])?;
    let derivative = shared.derivative_kernel()?.exponential_sum(FULL_DERIVATIVE, 1, [0.0; FULL_DERIVATIVE.state_len(1)])?;
    let filter = match shared.filter_kernel()? {
        Some(kernel) => Some(kernel.exponential_sum(FULL_FILTER, 1, [0.0; FULL_FILTER.state_len(1)])?),
        None => None,
    };
    fvi_core::FractionalPid::with_parts(law, integral, Some(derivative), filter)
}
