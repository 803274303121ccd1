//! Results of races, as they are stored and written.

use serde::{Deserialize, Serialize};

use crate::machine::Machine;
use crate::precision::Precision;
use crate::strategy::Task;

/// Everything that a lab has measured so far: the content of the file from which `--resume` continues.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Text of the file of strategies, with hashes of the weights of its kernels and of its programs, and the
    /// names of the strategies.
    pub plan: String,
    /// Where it was measured.
    pub machine: Machine,
    /// The races, in the order of the plan.
    pub races: Vec<RaceRecord>,
}

/// All strategies on one kernel at one length, number of channels, precision and tolerance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RaceRecord {
    /// Name of the kernel.
    pub kernel: String,
    /// Number of steps.
    pub length: usize,
    /// Number of channels.
    pub channels: usize,
    /// Type of the samples.
    pub precision: Precision,
    /// Tolerated error, relative to Σ|w||x|.
    pub tolerance: f64,
    /// Rounds that were made, each with every strategy made anew.
    pub rounds: usize,
    /// How many of them each process has made that ran or resumed the race: a median lies between those of
    /// all.
    pub parts: Vec<usize>,
    /// How long they have taken together.
    pub seconds: f64,
    /// Measurements.
    pub rows: Vec<Row>,
    /// The strategies that were not measured.
    pub absent: Vec<Absence>,
}

/// One strategy in one race.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the strategy.
    pub strategy: String,
    /// Largest |r_k − sum| / Σ|w||x| over the signals, in units of u of the precision.
    pub error_u: f64,
    /// True if `error_u` is within the tolerance, or rounding.
    pub within: bool,
    /// True if the method has an error bound, so that it should be within the tolerance.
    pub promised: bool,
    /// True if the strategy sums weights of its own, with which it is then compared.
    pub own_weights: bool,
    /// The terms that the run which is timed ends with, and how far from them a repetition may be.
    pub last: Vec<(f64, f64)>,
    /// Mean time of a step in each round, on Linux without what the thread waited for a processor.
    pub rounds_ns: Vec<f64>,
    /// Median of them.
    pub mean_ns: f64,
    /// 95 % confidence interval of `mean_ns`, with the medians of all processes; of fewer than six rounds, the
    /// range.
    pub between_ns: (f64, f64),
    /// Time to construct the strategy in each round.
    pub setups_ns: Vec<f64>,
    /// Median of them.
    pub setup_ns: f64,
    /// Time of a run with its construction, setup + length · mean: median over the rounds.
    pub total_ns: f64,
    /// 95 % confidence interval of `total_ns`, as of `mean_ns`.
    pub total_between_ns: (f64, f64),
    /// True if there are six rounds at least and half of either interval is at most 5 % of its median.
    pub stands: bool,
    /// Median of the times of single steps, the smallest of all rounds.
    pub p50_ns: f64,
    /// 99.9 % quantile of them, the smallest of all rounds.
    pub p999_ns: f64,
    /// Largest of them, the smallest of all rounds.
    pub worst_ns: f64,
    /// Bytes of state, tables and buffers after a run; of a program what its processes have in memory, where
    /// the system tells.
    pub bytes: Option<usize>,
    /// Floating-point operations of a step on average, where they are counted.
    pub flops: Option<f64>,
    /// Error of the weights themselves: |Σ w_n x_{N−n} − K(d/dt) t²| / Σ|w||x| on x = t² at the end of the
    /// run, where K(d/dt) t² is known. No engine that sums them comes closer to the operator.
    #[serde(default)]
    pub quadrature: Option<f64>,
}

/// A strategy that was not measured.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Absence {
    /// Name of the strategy.
    pub strategy: String,
    /// Kind of the reason.
    pub kind: Kind,
    /// Why.
    pub reason: String,
}

/// Kinds of reasons for absence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The strategy does not apply to this task.
    SitsOut,
    /// It failed: it cannot be constructed, refuses samples, panics, hangs, dies, gives numbers that are not
    /// finite, or others while it is timed.
    Failed,
}

impl RaceRecord {
    /// True if this is the race with these parameters.
    fn is_of(
        &self,
        kernel: &str,
        length: usize,
        channels: usize,
        precision: Precision,
        tolerance: f64,
    ) -> bool {
        self.kernel == kernel
            && (self.length, self.channels, self.precision) == (length, channels, precision)
            && self.tolerance == tolerance
    }

    /// True if this is the race for `task`.
    pub(crate) fn is_for(&self, task: &Task) -> bool {
        let Task { length, channels, precision, tolerance, .. } = *task;
        self.is_of(&task.kernel.name, length, channels, precision, tolerance)
    }

    /// True if the races differ in their tolerance at most.
    pub(crate) fn is_of_group(&self, other: &Self) -> bool {
        self.is_of(&other.kernel, other.length, other.channels, other.precision, self.tolerance)
    }

    /// Short description of the race.
    pub(crate) fn words(&self) -> String {
        format!(
            "{}, {}, {}, {}, tolerance {:e}",
            self.kernel,
            counted(self.length, "step"),
            counted(self.channels, "channel"),
            self.precision.name(),
            self.tolerance
        )
    }
}

/// A number of things in words.
pub(crate) fn counted(count: usize, one: &str) -> String {
    format!("{count} {one}{}", if count == 1 { "" } else { "s" })
}
