/// Integral, s^-0.8: 5 weights, then 34 exponentials; tolerance 1e-7.
///
/// A memory on it ends after 100000000 samples: it refuses further ones, or forgets.
///
/// `fvi_core::Kernel::exponential_sum` takes it, with `AXIS_INTEGRAL.state_len(channels)` numbers of state.
pub const AXIS_INTEGRAL: fvi_core::ExponentialTable<&[f32]> = fvi_core::ExponentialTable {
    stages: 1,
    head: &[
        1e0, 8e-1, 7.2e-1, 6.72e-1,
        6.384e-1,
    ],
    exponentials: &[
        3.11991e-10, 5.982325e-9, 1.6882215e-8, 3.3049854e-8,
        1.7872425e-2, 6.1155763e-3, 4.029075e-3, 3.6988854e-3,
        6.09368e-8, 1.1206948e-7, 2.0610423e-7, 3.7904118e-7,
        4.110807e-3, 4.6427036e-3, 5.244336e-3, 5.9239306e-3,
        6.9708517e-7, 1.2819916e-6, 2.3576767e-6, 4.3359373e-6,
        6.6915858e-3, 7.5587058e-3, 8.538165e-3, 9.644492e-3,
        7.974088e-6, 1.4664852e-5, 2.6969437e-5, 4.959771e-5,
        1.089406e-2, 1.2305301e-2, 1.38988895e-2, 1.5697882e-2,
        9.1210146e-5, 1.6772952e-4, 3.0842386e-4, 5.67068e-4,
        1.7727705e-2, 2.0015802e-2, 2.259052e-2, 2.5478384e-2,
        1.042385e-3, 1.9153495e-3, 3.5168205e-3, 6.4486694e-3,
        2.869804e-2, 3.224735e-2, 3.6076926e-2, 4.0037915e-2,
        1.1795765e-2, 2.1480696e-2, 3.88052e-2, 6.911527e-2,
        4.378545e-2, 4.6621457e-2, 4.731053e-2, 4.409453e-2,
        1.2014089e-1, 2.0071468e-1, 3.159233e-1, 4.5926362e-1,
        3.5514686e-2, 2.2545515e-2, 1.0009164e-2, 2.7580524e-3,
        6.1033255e-1, 7.5949574e-1, 0e0, 0e0,
        4.4607118e-4, 3.908273e-5, 0e0, 0e0,
    ],
    slow_blocks: 7,
    far_blocks: 0,
    horizon: 100000000,
    step_size: 1.0,
};

/// [`AXIS_INTEGRAL`] as a type, with its scale.
#[derive(Clone, Copy, Debug)]
pub struct AxisIntegral;

impl fvi_core::GeneratedKernel<f32> for AxisIntegral {
    const TABLE: fvi_core::SealedTable<f32> = match fvi_core::SealedTable::<f32>::new(
        AXIS_INTEGRAL,
        6.9314484e-3,
        fvi_core::ActsOn::Values,
        0x228bbd80,
    ) {
        Some(table) => table,
        None => panic!("a constant has been edited: generate the controller again"),
    };
}

/// Derivative, s^0.6: 5 weights, then 39 exponentials; tolerance 1e-7.
///
/// A memory on it ends after 100000000 samples: it refuses further ones, or forgets.
///
/// `fvi_core::Kernel::exponential_sum` takes it, with `AXIS_DERIVATIVE.state_len(channels)` numbers of state.
pub const AXIS_DERIVATIVE: fvi_core::ExponentialTable<&[f32]> = fvi_core::ExponentialTable {
    stages: 1,
    head: &[
        1e0, 4e-1, 2.8e-1, 2.24e-1,
        1.904e-1,
    ],
    exponentials: &[
        7.728584e-10, 5.7378804e-9, 1.4307081e-8, 2.624566e-8,
        3.6404426e-6, 4.1942662e-6, 4.1611243e-6, 4.74441e-6,
        4.5219707e-8, 7.761617e-8, 1.3321579e-7, 2.2864366e-7,
        6.4121514e-6, 8.862953e-6, 1.2255745e-5, 1.694734e-5,
        3.9243034e-7, 6.735439e-7, 1.1560303e-6, 1.98414e-6,
        2.3434906e-5, 3.2405937e-5, 4.481108e-5, 6.196484e-5,
        3.4054553e-6, 5.8449073e-6, 1.0031809e-5, 1.7217879e-5,
        8.568479e-5, 1.18483935e-4, 1.6383649e-4, 2.2654475e-4,
        2.955138e-5, 5.071916e-5, 8.7048196e-5, 1.4939504e-4,
        3.1324488e-4, 4.331027e-4, 5.987676e-4, 8.276713e-4,
        2.5638533e-4, 4.3996377e-4, 7.548898e-4, 1.2949477e-3,
        1.1437765e-3, 1.5798822e-3, 2.1805482e-3, 3.0055162e-3,
        2.2205117e-3, 3.8051018e-3, 6.513098e-3, 1.1126781e-2,
        4.1329972e-3, 5.6609022e-3, 7.7011352e-3, 1.0355895e-2,
        1.8946333e-2, 3.208293e-2, 5.3828143e-2, 8.89573e-2,
        1.3654086e-2, 1.7413938e-2, 2.1011177e-2, 2.3153929e-2,
        1.4353448e-1, 2.2338563e-1, 3.3051652e-1, 4.586806e-1,
        2.2101091e-2, 1.6988264e-2, 9.640904e-3, 3.725308e-3,
        5.926308e-1, 7.1746224e-1, 8.3795416e-1, 0e0,
        9.3872566e-4, 1.5946955e-4, 1.3280932e-5, 0e0,
    ],
    slow_blocks: 8,
    far_blocks: 0,
    horizon: 100000000,
    step_size: 1.0,
};

/// [`AXIS_DERIVATIVE`] as a type, with its scale.
#[derive(Clone, Copy, Debug)]
pub struct AxisDerivative;

impl fvi_core::GeneratedKernel<f32> for AxisDerivative {
    const TABLE: fvi_core::SealedTable<f32> = match fvi_core::SealedTable::<f32>::new(
        AXIS_DERIVATIVE,
        4.162766e1,
        fvi_core::ActsOn::Increments,
        0x2c18f952,
    ) {
        Some(table) => table,
        None => panic!("a constant has been edited: generate the controller again"),
    };
}

/// The law of the controller, sample 0.002, delay 0.001.
pub const AXIS_LAW: fvi_core::PidLaw<f32> = match fvi_core::PidLaw::<f32>::sealed(
    fvi_core::PidSettings {
        gains: fvi_core::PidGains::Parallel { proportional: 60.0, integral: 20.0, derivative: 12.0 },
        integral_order: 0.8,
        derivative_order: 0.6,
        sample: Some(0.002),
        setpoint_weights: [1.0, 0.0],
        derivative_of: fvi_core::DerivativeOf::ValuesFromRest,
        derivative_filter: fvi_core::DerivativeFilter::FirstOrder { time: 0.004 },
        limits: [-40.0, 40.0],
        rate_limit: 20000.0,
        anti_windup: fvi_core::AntiWindup::BackCalculation { time: 0.05 },
        bumpless: fvi_core::Bumpless::Whole,
    },
    fvi_core::PidConstants {
        tracking: 10.985605,
        filter_time: 0.004,
        filter_share: 0.33333334,
        step: 0.002,
        stride: 40.0,
    },
    [0x228bbd80, 0x2c18f952, 0x0],
    0x44b823ba,
) {
    Some(law) => law,
    None => panic!("a constant has been edited: generate the controller again"),
};

/// [`AXIS_LAW`].
///
/// # Errors
/// None: it has been checked.
pub const fn axis_law() -> Result<fvi_core::PidLaw<f32>, fvi_core::ParameterError> {
    Ok(AXIS_LAW)
}

/// [`AXIS_LAW`] as a type: a controller with it needs no storage for it, and only the code for
/// what it uses.
#[derive(Clone, Copy, Debug)]
#[allow(dead_code)]
pub struct AxisLaw;

impl core::borrow::Borrow<fvi_core::PidLaw<f32>> for AxisLaw {
    #[inline(always)]
    fn borrow(&self) -> &fvi_core::PidLaw<f32> {
        const LAW: &fvi_core::PidLaw<f32> = &AXIS_LAW;
        LAW
    }
}

/// The controller, with a law of its own, which can be changed, one that it borrows, or
/// [`AxisLaw`], which is compiled in. It
/// ends after 100000000 samples, 200000 units of time: further ticks are refused.
pub type AxisPid<L = fvi_core::PidLaw<f32>> = fvi_core::FractionalPid<
    f32,
    fvi_core::GeneratedSum<f32, AxisIntegral, [f32; AXIS_INTEGRAL.state_len(1)]>,
    fvi_core::GeneratedSum<f32, AxisDerivative, [f32; AXIS_DERIVATIVE.state_len(1)]>,
    L,
    fvi_core::Memoryless<f32>,
>;

/// The controller with a law of its own, before its first tick.
///
/// # Errors
/// None: it has been checked.
#[inline]
pub fn new_axis() -> Result<AxisPid, fvi_core::ParameterError> {
    axis_with(AXIS_LAW)
}

/// The same with this law, by value or by reference: one with other gains, one that loops
/// share, or [`AxisLaw`].
///
/// # Errors
/// If its orders or its sample time are others than those of the tables.
#[inline]
pub fn axis_with<L: core::borrow::Borrow<fvi_core::PidLaw<f32>>>(
    law: L,
) -> Result<AxisPid<L>, fvi_core::ParameterError> {
    let integral = fvi_core::GeneratedSum::generated([0.0; AXIS_INTEGRAL.state_len(1)])?;
    let derivative = Some(fvi_core::GeneratedSum::generated([0.0; AXIS_DERIVATIVE.state_len(1)])?);
    let filter = None;
    fvi_core::FractionalPid::generated(&AXIS_LAW, law, integral, derivative, filter)
}
