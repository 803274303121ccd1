//! When the next checkpoint is due.

use std::str::FromStr;
use std::time::{Duration, Instant};

/// How often a run writes checkpoints. Except with [`Never`](Self::Never), one is also written when the run
/// is stopped, and when its last step is made; with [`Minute`](Self::Minute), the default, the latter only if
/// the run was resumed or has already written one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CheckpointEvery {
    /// Every minute, or less often, so that writing takes at most a hundredth of the time.
    #[default]
    Minute,
    /// Whenever the number of steps made is a multiple of this.
    Steps(usize),
    /// Whenever this time has passed since the last checkpoint.
    Time(Duration),
    /// Never, not even at the end.
    Never,
}

/// A text that cannot be read as an interval.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{text}` is neither a number of steps (1000000), nor a duration (500ms, 30s, 10min, 2h), nor `never`"
)]
pub struct IntervalError {
    text: String,
}

impl CheckpointEvery {
    /// Number of steps from step `steps` to the next checkpoint, for an interval counted in steps.
    pub(crate) fn steps_to_next(self, steps: usize) -> usize {
        match self {
            Self::Steps(every) => every - steps % every,
            Self::Minute | Self::Time(_) | Self::Never => usize::MAX,
        }
    }
}

impl FromStr for CheckpointEvery {
    type Err = IntervalError;

    fn from_str(text: &str) -> Result<Self, IntervalError> {
        let error = || IntervalError { text: text.to_owned() };
        if text == "never" {
            return Ok(Self::Never);
        }
        let digits =
            text.find(|letter: char| letter != '_' && !letter.is_ascii_digit()).unwrap_or(text.len());
        let (number, unit) = text.split_at(digits);
        let number: u64 = number.replace('_', "").parse().map_err(|_| error())?;
        let milliseconds = match unit {
            "" => {
                let steps = usize::try_from(number).ok().filter(|&steps| steps > 0);
                return steps.map(Self::Steps).ok_or_else(error);
            }
            "ms" => 1,
            "s" => 1000,
            "min" => 60_000,
            "h" => 3_600_000,
            _ => return Err(error()),
        };
        let time = number.checked_mul(milliseconds).filter(|&time| time > 0).ok_or_else(error)?;
        Ok(Self::Time(Duration::from_millis(time)))
    }
}

/// Decides when a checkpoint is due. It reads the clock rarely, since that costs as much as a short step.
pub(crate) struct Timer {
    every: CheckpointEvery,
    last: Instant,
    /// When the clock was last read.
    looked: Instant,
    /// Number of queries until the clock is read again (`left`), and between two readings (`stride`).
    left: usize,
    stride: usize,
    /// How long writing the last checkpoint took.
    cost: Duration,
    /// True if a checkpoint was written.
    written: bool,
}

/// Approximate time between two readings of the clock.
const LOOK: Duration = Duration::from_millis(10);

/// The default interval.
const MINUTE: Duration = Duration::from_secs(60);

/// The default interval is at least this many times as long as writing a checkpoint takes.
const LEAST_SHARE: u32 = 100;

impl Timer {
    pub(crate) fn new(every: CheckpointEvery) -> Self {
        let now = Instant::now();
        Self { every, last: now, looked: now, left: 1, stride: 1, cost: Duration::ZERO, written: false }
    }

    /// True if a checkpoint was written.
    pub(crate) fn has_written(&self) -> bool {
        self.written
    }

    /// True if a checkpoint is due after `steps` steps; to be called at every step after which one may be
    /// written.
    pub(crate) fn is_due(&mut self, steps: usize) -> bool {
        match self.every {
            CheckpointEvery::Never => false,
            CheckpointEvery::Steps(every) => steps.is_multiple_of(every),
            CheckpointEvery::Time(time) => self.has_passed(|_| time),
            CheckpointEvery::Minute => self.has_passed(|timer| MINUTE.max(LEAST_SHARE * timer.cost)),
        }
    }

    /// True if `interval` has passed since the last checkpoint, as of the last reading of the clock.
    #[inline]
    fn has_passed(&mut self, interval: impl Fn(&Self) -> Duration) -> bool {
        self.left -= 1;
        self.left == 0 && self.look(interval(self))
    }

    /// Reads the clock, and adjusts the number of queries until the next reading.
    #[cold]
    fn look(&mut self, interval: Duration) -> bool {
        let now = Instant::now();
        let elapsed = now - self.looked;
        let look = LOOK.min(interval);
        if elapsed < look / 2 {
            self.stride = self.stride.saturating_mul(2);
        } else if elapsed > 2 * look {
            self.stride = (self.stride / 2).max(1);
        }
        (self.looked, self.left) = (now, self.stride);
        now - self.last >= interval
    }

    /// Records that a checkpoint has been written, begun at `begin`.
    pub(crate) fn written(&mut self, begin: Instant) {
        self.last = Instant::now();
        self.looked = self.last;
        (self.cost, self.written) = (self.last - begin, true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_steps_or_durations() {
        let parse = |text: &str| text.parse::<CheckpointEvery>().ok();
        assert_eq!(parse("1_000_000"), Some(CheckpointEvery::Steps(1_000_000)));
        assert_eq!(parse("30s"), Some(CheckpointEvery::Time(Duration::from_secs(30))));
        assert_eq!(parse("10min"), Some(CheckpointEvery::Time(Duration::from_secs(600))));
        assert_eq!(parse("250ms"), Some(CheckpointEvery::Time(Duration::from_millis(250))));
        assert_eq!(parse("never"), Some(CheckpointEvery::Never));
        for wrong in
            ["", "0", "0s", "-1", "1.5s", "s", "10m", "99999999999999999999", "18446744073709551615h"]
        {
            assert_eq!(parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn steps_are_counted_from_the_start_of_the_run() {
        let mut timer = Timer::new(CheckpointEvery::Steps(10));
        let due: Vec<usize> = (15..35).filter(|&steps| timer.is_due(steps)).collect();
        assert_eq!(due, [20, 30]);
        assert_eq!([15, 20].map(|steps| CheckpointEvery::Steps(10).steps_to_next(steps)), [5, 10]);
        assert!(!Timer::new(CheckpointEvery::Never).is_due(10));
    }
}
