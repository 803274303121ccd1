/// Integral, s^-0.5: 5 weights, then 15 exponentials; tolerance 1e-6.
///
/// A memory on it ends after 1000 samples: it refuses further ones, or forgets.
///
/// `fvi_core::Kernel::exponential_sum` takes it, with `PLAIN_INTEGRAL.state_len(channels)` numbers of state.
pub const PLAIN_INTEGRAL: fvi_core::ExponentialTable<&[f64]> = fvi_core::ExponentialTable {
    stages: 1,
    head: &[
        1e0, 5e-1, 3.75e-1, 3.125e-1,
        2.734375e-1,
    ],
    exponentials: &[
        7.255003566199437e-5, 6.181802034613403e-4, 1.5799395799006887e-3, 3.080257658430838e-3,
        1.0766259200780526e-2, 9.897071734487237e-3, 9.220151509672673e-3, 1.1097459301460319e-2,
        5.800640400402078e-3, 1.0887447074362077e-2, 2.0343706127208774e-2, 3.7700122976035026e-2,
        1.4904772516921103e-2, 1.985085607321327e-2, 2.5738624640020014e-2, 3.175729608870436e-2,
        6.882402900554309e-2, 1.2237515074275662e-1, 2.0827406588594344e-1, 3.316807621820875e-1,
        3.5810426811058726e-2, 3.447548630744244e-2, 2.55237308859934e-2, 1.2683429638492593e-2,
        4.8354954580106707e-1, 6.390843749692785e-1, 7.850018255656601e-1, 0e0,
        3.7097351786108544e-3, 6.055439011301226e-4, 5.29061189284453e-5, 0e0,
    ],
    slow_blocks: 2,
    far_blocks: 0,
    horizon: 1000,
    step_size: 1.0,
};

/// [`PLAIN_INTEGRAL`] as a type, with its scale.
#[derive(Clone, Copy, Debug)]
pub struct PlainIntegral;

impl fvi_core::GeneratedKernel<f64> for PlainIntegral {
    const TABLE: fvi_core::SealedTable<f64> = match fvi_core::SealedTable::<f64>::new(
        PLAIN_INTEGRAL,
        1e-1,
        fvi_core::ActsOn::Values,
        0xfa0d5249,
    ) {
        Some(table) => table,
        None => panic!("a constant has been edited: generate the controller again"),
    };
}

/// The law of the controller, sample 0.01.
pub const PLAIN_LAW: fvi_core::PidLaw<f64> = match fvi_core::PidLaw::<f64>::sealed(
    fvi_core::PidSettings {
        gains: fvi_core::PidGains::Series { proportional: 0.3, integral_rate: 2.0, derivative_time: 0.0, filter_ratio: 10.0 },
        integral_order: 0.5,
        derivative_order: 1.0,
        sample: Some(0.01),
        setpoint_weights: [1.0, 0.0],
        derivative_of: fvi_core::DerivativeOf::ValuesFromRest,
        derivative_filter: fvi_core::DerivativeFilter::None,
        limits: [f64::NEG_INFINITY, f64::INFINITY],
        rate_limit: f64::INFINITY,
        anti_windup: fvi_core::AntiWindup::None,
        bumpless: fvi_core::Bumpless::Whole,
    },
    fvi_core::PidConstants {
        tracking: 0.0,
        filter_time: 0.0,
        filter_share: 1.0,
        step: 0.01,
        stride: f64::INFINITY,
    },
    [0xfa0d5249, 0x0, 0x0],
    0x013af006,
) {
    Some(law) => law,
    None => panic!("a constant has been edited: generate the controller again"),
};

/// [`PLAIN_LAW`].
///
/// # Errors
/// None: it has been checked.
pub const fn plain_law() -> Result<fvi_core::PidLaw<f64>, fvi_core::ParameterError> {
    Ok(PLAIN_LAW)
}

/// [`PLAIN_LAW`] as a type: a controller with it needs no storage for it, and only the code for
/// what it uses.
#[derive(Clone, Copy, Debug)]
#[allow(dead_code)]
pub struct PlainLaw;

impl core::borrow::Borrow<fvi_core::PidLaw<f64>> for PlainLaw {
    #[inline(always)]
    fn borrow(&self) -> &fvi_core::PidLaw<f64> {
        const LAW: &fvi_core::PidLaw<f64> = &PLAIN_LAW;
        LAW
    }
}

/// The controller, with a law of its own, which can be changed, one that it borrows, or
/// [`PlainLaw`], which is compiled in. It
/// ends after 1000 samples, 10 units of time: further ticks are refused.
pub type PlainPid<L = fvi_core::PidLaw<f64>> = fvi_core::FractionalPid<
    f64,
    fvi_core::GeneratedSum<f64, PlainIntegral, [f64; PLAIN_INTEGRAL.state_len(1)]>,
    fvi_core::Memoryless<f64>,
    L,
    fvi_core::Memoryless<f64>,
>;

/// The controller with a law of its own, before its first tick.
///
/// # Errors
/// None: it has been checked.
#[inline]
pub fn new_plain() -> Result<PlainPid, fvi_core::ParameterError> {
    plain_with(PLAIN_LAW)
}

/// The same with this law, by value or by reference: one with other gains, one that loops
/// share, or [`PlainLaw`].
///
/// # Errors
/// If its orders or its sample time are others than those of the tables.
#[inline]
pub fn plain_with<L: core::borrow::Borrow<fvi_core::PidLaw<f64>>>(
    law: L,
) -> Result<PlainPid<L>, fvi_core::ParameterError> {
    let integral = fvi_core::GeneratedSum::generated([0.0; PLAIN_INTEGRAL.state_len(1)])?;
    let derivative = None;
    let filter = None;
    fvi_core::FractionalPid::generated(&PLAIN_LAW, law, integral, derivative, filter)
}
