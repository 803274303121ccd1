//! When the next checkpoint is due.

use std::str::FromStr;
use std::time::{Duration, Instant};

/// How often a run writes checkpoints. One is written when it is stopped, unless there are none at all, and
/// when it has come to its end, unless it did so within the first minute and nobody asked for any.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CheckpointEvery {
    /// Every minute; less often where writing one takes more than a hundredth of the time between two.
    #[default]
    Minute,
    /// After so many steps.
    Steps(usize),
    /// After so much time.
    Time(Duration),
    /// Never, and none at the end.
    Never,
}

/// A text that says no interval.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{text}` is neither a number of steps (1000000), nor a duration (500ms, 30s, 10min, 2h), nor `never`"
)]
pub struct IntervalError {
    text: String,
}

impl CheckpointEvery {
    /// After how many steps more one is due, where steps are counted, from a number of steps on.
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

/// Tells when a checkpoint is due, and looks at the clock seldom: a look costs as much as a short step.
pub(crate) struct Timer {
    every: CheckpointEvery,
    last: Instant,
    /// When the clock was looked at.
    looked: Instant,
    /// Times that it is asked until the next look, and between the last two.
    left: usize,
    stride: usize,
    /// How long writing the last checkpoint took.
    cost: Duration,
    /// Whether one was written.
    written: bool,
}

/// The clock is looked at about this often.
const LOOK: Duration = Duration::from_millis(10);

/// The default interval.
const MINUTE: Duration = Duration::from_secs(60);

/// The default interval is at least so many times what writing takes.
const LEAST_SHARE: u32 = 100;

impl Timer {
    pub(crate) fn new(every: CheckpointEvery) -> Self {
        let now = Instant::now();
        Self { every, last: now, looked: now, left: 1, stride: 1, cost: Duration::ZERO, written: false }
    }

    /// Whether any was written.
    pub(crate) fn has_written(&self) -> bool {
        self.written
    }

    /// Whether a checkpoint is due after step `steps`; to be asked wherever one may be written.
    pub(crate) fn is_due(&mut self, steps: usize) -> bool {
        match self.every {
            CheckpointEvery::Never => false,
            CheckpointEvery::Steps(every) => steps.is_multiple_of(every),
            CheckpointEvery::Time(time) => self.has_passed(|_| time),
            CheckpointEvery::Minute => self.has_passed(|timer| MINUTE.max(LEAST_SHARE * timer.cost)),
        }
    }

    /// Whether so much time has passed since the last checkpoint, as far as looks at the clock tell.
    #[inline]
    fn has_passed(&mut self, interval: impl Fn(&Self) -> Duration) -> bool {
        self.left -= 1;
        self.left == 0 && self.look(interval(self))
    }

    /// Looks at the clock, and decides when to look again.
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

    /// One has been written, begun at `begin`.
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
