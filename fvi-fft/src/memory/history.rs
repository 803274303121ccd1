//! A choice of engine with its settings.

use serde::Serialize;
use std::num::NonZero;
use std::sync::OnceLock;

/// A memory engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Engine {
    /// The plain sum over a ring of samples.
    Direct,
    /// Block transforms, amortised.
    BlockFft,
    /// Block transforms, with the cost spread evenly over the steps.
    RealTime,
    /// A short head and decaying exponentials, in chunks and vector code.
    ExponentialSum,
    /// The same with fvi-core's memory, a sample at a time, with the bits of firmware.
    ExponentialSumCore,
    /// Exponentials in continuous time, for Runge–Kutta quadrature on steps of any length.
    AnyStep,
}

impl Engine {
    /// The engines with their names in files and in the program's options.
    pub const NAMES: [(&'static str, Self); 6] = [
        ("direct", Self::Direct),
        ("block-fft", Self::BlockFft),
        ("real-time", Self::RealTime),
        ("exponential-sum", Self::ExponentialSum),
        ("exponential-sum-core", Self::ExponentialSumCore),
        ("any-step", Self::AnyStep),
    ];

    /// The name in files and in the program's options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Direct => "direct",
            Self::BlockFft => "block-fft",
            Self::RealTime => "real-time",
            Self::ExponentialSum => "exponential-sum",
            Self::ExponentialSumCore => "exponential-sum-core",
            Self::AnyStep => "any-step",
        }
    }
}

/// Policy of the direct engine for samples beyond its capacity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Overflow {
    /// Stops the run.
    #[default]
    Stop,
    /// Forgets the oldest sample.
    Forget,
}

impl Overflow {
    /// Skipped in serialisation by default: the key belongs to the direct engine, and would select that.
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Largest default number of threads of a run.
const THREADS: usize = 8;

/// Precision of the state of an exponential sum.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum States {
    /// The precision of the run.
    F64,
    /// Single precision.
    F32,
}

/// The memory engine and its settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct History {
    /// The engine; absent: the fastest that is exact to rounding.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub engine: Option<Engine>,
    /// Relative error of each weight of the exponential sum; absent: rounding.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// Largest lag of the table of exponentials; absent: that of the run. Tables for firmware have a larger
    /// one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub horizon: Option<usize>,
    /// Capacity of the direct engine in samples; absent: unlimited.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub capacity: Option<usize>,
    /// Policy for samples beyond the capacity.
    #[serde(skip_serializing_if = "Overflow::is_default")]
    pub overflow: Overflow,
    /// Precision of the state of an exponential sum; absent: that of the run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub states: Option<States>,
    /// Threads for the work of a large system: memories of many channels, products and solutions; absent: as
    /// many as the machine has, up to eight. The number does not change the bits of the result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threads: Option<usize>,
    /// Number of samples for which engine and table are chosen, if a run is continued beyond its original
    /// end; absent: that of the run.
    #[serde(skip)]
    pub planned: Option<usize>,
    /// Relative error that the table of rates for steps of any length should have: an error ε of s^β shifts a
    /// motion that oscillates undamped by ε/β of its phase, which grows with the time. At least 10⁻¹⁴;
    /// absent: 10⁻¹³.
    #[serde(skip)]
    pub rates: Option<f64>,
}

impl History {
    /// Replaces the engine of the file, and drops settings that belong to that engine only.
    pub fn choose(&mut self, engine: Engine) {
        if self.engine != Some(engine) {
            *self =
                Self { engine: Some(engine), threads: self.threads, rates: self.rates, ..Self::default() };
        }
    }

    /// Threads that share the work of a large system.
    pub fn threads(&self) -> usize {
        // Requested once: the answer requires reading several files of the operating system, and every run of
        // a sweep needs it.
        static THERE: OnceLock<usize> = OnceLock::new();
        let there = || std::thread::available_parallelism().map_or(1, NonZero::get).min(THREADS);
        self.threads.unwrap_or_else(|| *THERE.get_or_init(there))
    }
}
