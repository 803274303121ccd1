//! Sources of controllers compile, and make the controllers that their settings say.

use fvi_core::{
    ActsOn, DerivativeFilter, DerivativeOf, FractionalPid, Memory as _, PidGains, PidLaw, PidSettings,
    SealedTable, StateReader, StateWriter, Stateful as _,
};
use fvi_fft::exponentials::controller_source::controller_source;

/// A fractional filter of the derivative, a law of everything that is not plain.
#[expect(unreachable_pub, reason = "the source is for a module of any visibility")]
mod full {
    include!("controllers/full.rs");
}

/// An integral alone, in double precision.
#[expect(unreachable_pub, reason = "the source is for a module of any visibility")]
mod plain {
    include!("controllers/plain.rs");
}

fn full_settings() -> PidSettings<f32> {
    let gains = PidGains::Parallel { proportional: 2.0, integral: 1.5, derivative: 0.25 };
    PidSettings {
        integral_order: 1.25,
        derivative_order: 0.75,
        setpoint_weights: [0.5, 0.25],
        derivative_of: DerivativeOf::ValuesFromRest,
        derivative_filter: DerivativeFilter::Fractional { time: 0.0625, order: 0.875 },
        rate_limit: 64.0,
        ..PidSettings::new(gains, 0.01)
    }
}

fn plain_settings() -> PidSettings<f64> {
    let gains =
        PidGains::Series { proportional: 0.3, integral_rate: 2.0, derivative_time: 0.0, filter_ratio: 10.0 };
    PidSettings { integral_order: 0.5, ..PidSettings::new(gains, 0.01) }
}

#[test]
fn the_source_is_what_is_compiled_here() {
    let full = controller_source("full", &full_settings(), 1000, 1e-3).unwrap();
    let plain = controller_source("plain", &plain_settings(), 1000, 1e-6).unwrap();
    if let Some(directory) = std::env::var_os("FVI_WRITE_CONTROLLERS") {
        let directory = std::path::PathBuf::from(directory);
        std::fs::write(directory.join("full.rs"), &full).unwrap();
        std::fs::write(directory.join("plain.rs"), &plain).unwrap();
    }
    assert_eq!(full, include_str!("controllers/full.rs"));
    assert_eq!(plain, include_str!("controllers/plain.rs"));
}

#[test]
fn it_makes_the_controller_of_its_settings() {
    assert_eq!(*full::full_law().unwrap().settings(), full_settings());
    assert_eq!(*plain::plain_law().unwrap().settings(), plain_settings());
    // One law, owned and shared.
    let law = full::full_law().unwrap();
    let mut own: full::FullPid = full::new_full().unwrap();
    let mut shared: full::FullPid<&PidLaw<f32>> = full::full_with(&law).unwrap();
    let mut plain: plain::PlainPid<plain::PlainLaw> = plain::plain_with(plain::PlainLaw).unwrap();
    let mut own_plain: plain::PlainPid = plain::new_plain().unwrap();
    let mut sum = 0.0;
    for tick in 0..900 {
        let measured = (tick % 7) as f32 * 0.125;
        assert_eq!(own.tick(1.0, measured).unwrap(), shared.tick(1.0, measured).unwrap());
        sum = plain.tick(1.0, 0.0).unwrap();
        assert_eq!(own_plain.tick(1.0, 0.0).unwrap(), sum);
    }
    // 0.3 (1 + 2 t^½/Γ(3/2)) at t = 9
    let exact = 0.3 * (1.0 + 2.0 * 3.0 / 0.886_226_925_452_758);
    assert!((sum - exact).abs() < 1e-3 * exact, "{sum} and not {exact}");
    // A law of other orders is not one of these tables.
    let other = PidSettings { integral_order: 1.5, ..full_settings() };
    assert!(full::full_with(PidLaw::new(other).unwrap()).is_err());
}

/// A small generator: numbers between −1 and 1.
fn noise(state: &mut u32) -> f32 {
    *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    (*state >> 8) as f32 / 8_388_608.0 - 1.0
}

#[test]
fn constants_that_were_checked_before_give_the_bits_of_those_that_are_checked_now() {
    // The same tables, given at run time with a law that is checked at run time.
    let law = PidLaw::new(full_settings()).unwrap();
    let sum = |kernel: fvi_core::Kernel, table: fvi_core::ExponentialTable<&'static [f32]>| {
        kernel.exponential_sum(table, 1, vec![0.0; table.state_len(1)]).unwrap()
    };
    let integral = sum(law.integral_kernel().unwrap(), full::FULL_INTEGRAL);
    let derivative = sum(law.derivative_kernel().unwrap(), full::FULL_DERIVATIVE);
    let filter = sum(law.filter_kernel().unwrap().unwrap(), full::FULL_FILTER);
    let mut checked = FractionalPid::with_filter(law, integral, derivative, filter).unwrap();
    let mut own: full::FullPid = full::new_full().unwrap();
    let mut fixed: full::FullPid<full::FullLaw> = full::full_with(full::FullLaw).unwrap();
    let mut state = 1;
    for tick in 0..990 {
        let (setpoint, measured) = (noise(&mut state), noise(&mut state));
        let expected = checked.tick(setpoint, measured).unwrap().to_bits();
        assert_eq!(own.tick(setpoint, measured).unwrap().to_bits(), expected, "tick {tick}");
        assert_eq!(fixed.tick(setpoint, measured).unwrap().to_bits(), expected, "tick {tick}");
        if tick == 500 {
            // What is refused changes nothing, and a state goes from one to the other.
            assert!(fixed.tick(f32::NAN, 0.0).is_err());
            let mut bytes = vec![0; checked.state_bytes()];
            checked.save(&mut StateWriter::new(&mut bytes)).unwrap();
            fixed = full::full_with(full::FullLaw).unwrap();
            fixed.restore(&mut StateReader::new(&bytes)).unwrap();
        }
    }
    for _ in 990..1000 {
        assert!(fixed.tick(0.0, 0.0).is_ok());
    }
    assert!(fixed.tick(0.0, 0.0).is_err(), "the tables end");
    // No law in the object.
    assert!(size_of_val(&fixed) + size_of::<PidLaw<f32>>() <= size_of_val(&own));
}

#[test]
fn a_constant_that_was_edited_is_not_accepted() {
    let table = full::FULL_INTEGRAL;
    let kernel = PidLaw::new(full_settings()).unwrap().integral_kernel().unwrap();
    let memory = kernel.exponential_sum(table, 1, vec![0.0; table.state_len(1)]).unwrap();
    let (scale, acts_on) = (memory.scale(), memory.acts_on());
    let seal = SealedTable::<f32>::seal(&table, scale, acts_on);
    assert!(SealedTable::<f32>::new(table, scale, acts_on, seal).is_some());
    let longer = fvi_core::ExponentialTable { horizon: table.horizon + 1, ..table };
    assert!(SealedTable::<f32>::new(longer, scale, acts_on, seal).is_none());
    assert!(SealedTable::<f32>::new(table, scale * 2.0, acts_on, seal).is_none());
    assert!(SealedTable::<f32>::new(table, scale, ActsOn::Increments, seal).is_none());
    for place in 0..table.exponentials.len() {
        let mut numbers = table.exponentials.to_vec();
        numbers[place] += 0.125;
        let edited = fvi_core::ExponentialTable { exponentials: numbers.as_slice(), ..table };
        assert_ne!(SealedTable::<f32>::seal(&edited, scale, acts_on), seal, "number {place}");
    }
    let (law, memories) = (full::FULL_LAW, [1, 2, 3]);
    let (settings, constants) = (*law.settings(), *law.constants());
    let seal = PidLaw::<f32>::seal(&settings, &constants, memories);
    assert_eq!(PidLaw::<f32>::sealed(settings, constants, memories, seal).unwrap().settings(), &settings);
    let faster = PidSettings { sample: Some(0.02), ..settings };
    assert!(PidLaw::<f32>::sealed(faster, constants, memories, seal).is_none());
    let stronger = PidSettings { limits: [-1.0, 1.0], ..settings };
    assert!(PidLaw::<f32>::sealed(stronger, constants, memories, seal).is_none());
    let other = fvi_core::PidConstants { step: 0.02, ..constants };
    assert!(PidLaw::<f32>::sealed(settings, other, memories, seal).is_none());
    assert!(PidLaw::<f32>::sealed(settings, constants, [1, 2, 4], seal).is_none());
    // A law with the seals of other memories.
    let wrong = PidLaw::<f32>::sealed(settings, constants, memories, seal).unwrap();
    let memory = fvi_core::Memoryless::<f32>::new;
    let made = FractionalPid::generated(&wrong, wrong, memory(), Some(memory()), Some(memory()));
    assert_eq!(made.unwrap_err().parameter, "memory");
}
