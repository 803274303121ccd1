/// A controller in whole numbers, sample 0.002, delay 0.001: a count of setpoint and measured value is
/// 0.0001, of the output 0.001; inputs saturate at ±8388607 counts; the output is within 0.501 counts of
/// exact arithmetic as long as it has reached no limit.
///
/// Its integral: from 0.01 to 250 Hz within 9.5e-3 of the weights' symbol (8.2e-2 dB, 5.4e-1 degrees) and
/// within 3.1e0 dB, 7.2e1 degrees of the operator.
///
/// Its derivative: from 0.01 to 250 Hz within 9.6e-3 of the weights' symbol (7.6e-2 dB, 5.2e-1 degrees) and
/// within 2.4e0 dB, 5.4e1 degrees of the operator.
///
/// [`new_whole_axis`] makes a controller of it.
pub const WHOLE_AXIS_LAW: fvi_core::FixedLaw<'static> = fvi_core::FixedLaw {
    setpoint: fvi_core::FixedGain { mantissa: 1610612736, shift: 12 },
    measured: fvi_core::FixedGain { mantissa: 1610612736, shift: 12 },
    integral: fvi_core::FixedOperator {
        head: &[
            fvi_core::FixedGain { mantissa: 1905302037, shift: 26 },
            fvi_core::FixedGain { mantissa: 1524241630, shift: 26 },
        ],
        terms: &[
            fvi_core::FixedTerm {
                decay: fvi_core::FixedGain { mantissa: 0, shift: 0 },
                output: fvi_core::FixedGain { mantissa: 1751995954, shift: 43 },
                lift: 14,
            },
            fvi_core::FixedTerm {
                decay: fvi_core::FixedGain { mantissa: 1795274259, shift: 44 },
                output: fvi_core::FixedGain { mantissa: 1976198982, shift: 47 },
                lift: 17,
            },
            fvi_core::FixedTerm {
                decay: fvi_core::FixedGain { mantissa: 1414608759, shift: 41 },
                output: fvi_core::FixedGain { mantissa: 1195724706, shift: 49 },
                lift: 20,
            },
            fvi_core::FixedTerm {
                decay: fvi_core::FixedGain { mantissa: 1205508700, shift: 38 },
                output: fvi_core::FixedGain { mantissa: 1863160203, shift: 52 },
                lift: 23,
            },
            fvi_core::FixedTerm {
                decay: fvi_core::FixedGain { mantissa: 2114023959, shift: 36 },
                output: fvi_core::FixedGain { mantissa: 1312849413, shift: 53 },
                lift: 25,
            },
            fvi_core::FixedTerm {
                decay: fvi_core::FixedGain { mantissa: 1807099304, shift: 33 },
                output: fvi_core::FixedGain { mantissa: 1243634028, shift: 56 },
                lift: 28,
            },
        ],
    },
    derivative: fvi_core::FixedOperator {
        head: &[
            fvi_core::FixedGain { mantissa: 1676150999, shift: 14 },
            fvi_core::FixedGain { mantissa: 1340920799, shift: 15 },
        ],
        terms: &[
            fvi_core::FixedTerm {
                decay: fvi_core::FixedGain { mantissa: 1571628007, shift: 45 },
                output: fvi_core::FixedGain { mantissa: 1081125051, shift: 38 },
                lift: 16,
            },
            fvi_core::FixedTerm {
                decay: fvi_core::FixedGain { mantissa: 1778177161, shift: 42 },
                output: fvi_core::FixedGain { mantissa: 1086542921, shift: 40 },
                lift: 19,
            },
            fvi_core::FixedTerm {
                decay: fvi_core::FixedGain { mantissa: 1318587836, shift: 39 },
                output: fvi_core::FixedGain { mantissa: 1507749166, shift: 42 },
                lift: 22,
            },
            fvi_core::FixedTerm {
                decay: fvi_core::FixedGain { mantissa: 1822727803, shift: 37 },
                output: fvi_core::FixedGain { mantissa: 2028650933, shift: 43 },
                lift: 24,
            },
            fvi_core::FixedTerm {
                decay: fvi_core::FixedGain { mantissa: 1214461119, shift: 34 },
                output: fvi_core::FixedGain { mantissa: 1203819354, shift: 44 },
                lift: 27,
            },
            fvi_core::FixedTerm {
                decay: fvi_core::FixedGain { mantissa: 1409516521, shift: 32 },
                output: fvi_core::FixedGain { mantissa: 1699710673, shift: 46 },
                lift: 29,
            },
        ],
    },
    derivative_weight: fvi_core::FixedGain { mantissa: 0, shift: 0 },
    from_rest: true,
    filter_share: fvi_core::FixedGain { mantissa: 1431655765, shift: 32 },
    limits: [-2621440000, 2621440000],
    stride: 2621440000,
    anti_windup: fvi_core::FixedWindup::BackCalculation(fvi_core::FixedGain { mantissa: 1370132664, shift: 39 }),
};

/// A controller with [`WHOLE_AXIS_LAW`]. It has no end.
pub type WholeAxisPid =
    fvi_core::FixedPid<&'static fvi_core::FixedLaw<'static>, [i64; WHOLE_AXIS_LAW.state_len()]>;

/// The controller before its first tick.
///
/// # Errors
/// None: the length is right.
#[inline]
pub fn new_whole_axis() -> Result<WholeAxisPid, fvi_core::ParameterError> {
    fvi_core::FixedPid::new(&WHOLE_AXIS_LAW, [0; WHOLE_AXIS_LAW.state_len()])
}
