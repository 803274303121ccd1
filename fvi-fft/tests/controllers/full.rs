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

/// [`FULL_INTEGRAL`] as a type, with its scale.
#[derive(Clone, Copy, Debug)]
pub struct FullIntegral;

impl fvi_core::GeneratedKernel<f32> for FullIntegral {
    const TABLE: fvi_core::SealedTable<f32> = match fvi_core::SealedTable::<f32>::new(
        FULL_INTEGRAL,
        3.1622776e-1,
        fvi_core::ActsOn::Values,
        0xba67e8de,
    ) {
        Some(table) => table,
        None => panic!("a constant has been edited: generate the controller again"),
    };
}

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

/// [`FULL_DERIVATIVE`] as a type, with its scale.
#[derive(Clone, Copy, Debug)]
pub struct FullDerivative;

impl fvi_core::GeneratedKernel<f32> for FullDerivative {
    const TABLE: fvi_core::SealedTable<f32> = match fvi_core::SealedTable::<f32>::new(
        FULL_DERIVATIVE,
        3.1622776e1,
        fvi_core::ActsOn::Increments,
        0xd5db6ad5,
    ) {
        Some(table) => table,
        None => panic!("a constant has been edited: generate the controller again"),
    };
}

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

/// [`FULL_FILTER`] as a type, with its scale.
#[derive(Clone, Copy, Debug)]
pub struct FullFilter;

impl fvi_core::GeneratedKernel<f32> for FullFilter {
    const TABLE: fvi_core::SealedTable<f32> = match fvi_core::SealedTable::<f32>::new(
        FULL_FILTER,
        5.623413e1,
        fvi_core::ActsOn::Increments,
        0x37c0abc5,
    ) {
        Some(table) => table,
        None => panic!("a constant has been edited: generate the controller again"),
    };
}

/// The law of the controller, sample 0.01.
pub const FULL_LAW: fvi_core::PidLaw<f32> = match fvi_core::PidLaw::<f32>::sealed(
    fvi_core::PidSettings {
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
    },
    fvi_core::PidConstants {
        tracking: 0.0,
        filter_time: 0.0625,
        filter_share: 0.13793103,
        step: 0.01,
        stride: 0.64,
    },
    [0xba67e8de, 0xd5db6ad5, 0x37c0abc5],
    0x08f702ce,
) {
    Some(law) => law,
    None => panic!("a constant has been edited: generate the controller again"),
};

/// [`FULL_LAW`].
///
/// # Errors
/// None: it has been checked.
pub const fn full_law() -> Result<fvi_core::PidLaw<f32>, fvi_core::ParameterError> {
    Ok(FULL_LAW)
}

/// [`FULL_LAW`] as a type: a controller with it needs no storage for it, and only the code for
/// what it uses.
#[derive(Clone, Copy, Debug)]
#[allow(dead_code)]
pub struct FullLaw;

impl core::borrow::Borrow<fvi_core::PidLaw<f32>> for FullLaw {
    #[inline(always)]
    fn borrow(&self) -> &fvi_core::PidLaw<f32> {
        const LAW: &fvi_core::PidLaw<f32> = &FULL_LAW;
        LAW
    }
}

/// The controller, with a law of its own, which can be changed, one that it borrows, or
/// [`FullLaw`], which is compiled in. It
/// ends after 1000 samples, 10 units of time: further ticks are refused.
pub type FullPid<L = fvi_core::PidLaw<f32>> = fvi_core::FractionalPid<
    f32,
    fvi_core::GeneratedSum<f32, FullIntegral, [f32; FULL_INTEGRAL.state_len(1)]>,
    fvi_core::GeneratedSum<f32, FullDerivative, [f32; FULL_DERIVATIVE.state_len(1)]>,
    L,
    fvi_core::GeneratedSum<f32, FullFilter, [f32; FULL_FILTER.state_len(1)]>,
>;

/// The controller with a law of its own, before its first tick.
///
/// # Errors
/// None: it has been checked.
#[inline]
pub fn new_full() -> Result<FullPid, fvi_core::ParameterError> {
    full_with(FULL_LAW)
}

/// The same with this law, by value or by reference: one with other gains, one that loops
/// share, or [`FullLaw`].
///
/// # Errors
/// If its orders or its sample time are others than those of the tables.
#[inline]
pub fn full_with<L: core::borrow::Borrow<fvi_core::PidLaw<f32>>>(
    law: L,
) -> Result<FullPid<L>, fvi_core::ParameterError> {
    let integral = fvi_core::GeneratedSum::generated([0.0; FULL_INTEGRAL.state_len(1)])?;
    let derivative = Some(fvi_core::GeneratedSum::generated([0.0; FULL_DERIVATIVE.state_len(1)])?);
    let filter = Some(fvi_core::GeneratedSum::generated([0.0; FULL_FILTER.state_len(1)])?);
    fvi_core::FractionalPid::generated(&FULL_LAW, law, integral, derivative, filter)
}
