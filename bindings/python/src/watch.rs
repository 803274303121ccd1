//! What happens while Rust computes: signals, and the caller's progress function.

use pyo3::prelude::*;
use std::time::{Duration, Instant};

/// Between two looks at signals.
const LOOK: Duration = Duration::from_millis(20);
/// Between two calls of the progress function.
const REPORT: Duration = Duration::from_millis(100);

/// Looks at signals every now and then, tells the caller how far the work is, and keeps the exception that
/// either raises.
pub(crate) struct Watch {
    progress: Option<Py<PyAny>>,
    raised: Option<PyErr>,
    looked: Instant,
    reported: Instant,
    /// Pieces of work until the next look at the clock, and how many there were between the last two.
    left: u32,
    stride: u32,
}

impl Watch {
    pub(crate) fn new(progress: Option<Py<PyAny>>) -> Self {
        let now = Instant::now();
        Self { progress, raised: None, looked: now, reported: now, left: 1, stride: 1 }
    }

    /// Hears that `done` of `all` pieces of work are done (`None`: nobody knows of how many); whether to go
    /// on.
    pub(crate) fn tick(&mut self, done: usize, all: impl Into<Option<usize>>) -> bool {
        let all = all.into();
        self.left = self.left.saturating_sub(1);
        let last = self.progress.is_some() && Some(done) == all;
        if self.left > 0 && !last {
            return true;
        }
        // So many pieces at a time that the clock is read about once in a few milliseconds, however long a
        // piece takes.
        let since = self.looked.elapsed();
        self.stride =
            if since < LOOK / 8 { (2 * self.stride).min(1 << 20) } else { (self.stride / 2).max(1) };
        self.left = self.stride;
        if since < LOOK && !last {
            return true;
        }
        self.look(done, all)
    }

    /// The same for work whose pieces may take long, and which calls again meanwhile: the clock is read at
    /// every call.
    pub(crate) fn hear(&mut self, done: usize, all: usize) -> bool {
        if self.looked.elapsed() < LOOK && done < all {
            self.raised.is_none()
        } else {
            self.look(done, Some(all))
        }
    }

    fn look(&mut self, done: usize, all: Option<usize>) -> bool {
        self.looked = Instant::now();
        let due = self.reported.elapsed() >= REPORT || Some(done) == all;
        let result = Python::attach(|py| {
            py.check_signals()?;
            if let (true, Some(progress)) = (due, &self.progress) {
                self.reported = Instant::now();
                progress.call1(py, (done, all))?;
            }
            Ok(())
        });
        if let Err(error) = result {
            self.raised = Some(error);
        }
        self.raised.is_none()
    }

    /// The exception that stopped the work.
    pub(crate) fn into_raised(self) -> Option<PyErr> {
        self.raised
    }
}
