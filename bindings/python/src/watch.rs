//! Signals and the caller's progress function during a computation in Rust.

use pyo3::prelude::*;
use std::time::{Duration, Instant};

/// Time between two checks for signals.
const LOOK: Duration = Duration::from_millis(20);
/// Time between two calls of the progress function.
const REPORT: Duration = Duration::from_millis(100);

/// Checks for signals at intervals, calls the progress function, and keeps the exception that either raises.
pub(crate) struct Watch {
    progress: Option<Py<PyAny>>,
    raised: Option<PyErr>,
    looked: Instant,
    reported: Instant,
    /// Pieces of work until the next reading of the clock (`left`), and between two readings.
    left: u32,
    stride: u32,
}

impl Watch {
    pub(crate) fn new(progress: Option<Py<PyAny>>) -> Self {
        let now = Instant::now();
        Self { progress, raised: None, looked: now, reported: now, left: 1, stride: 1 }
    }

    /// Reports that `done` of `all` pieces of work are done (`None`: unknown number); returns whether to
    /// continue.
    pub(crate) fn tick(&mut self, done: usize, all: impl Into<Option<usize>>) -> bool {
        let all = all.into();
        self.left = self.left.saturating_sub(1);
        let last = self.progress.is_some() && Some(done) == all;
        if self.left > 0 && !last {
            return true;
        }
        // The number of pieces between two readings adapts so that the clock is read every few milliseconds.
        let since = self.looked.elapsed();
        self.stride =
            if since < LOOK / 8 { (2 * self.stride).min(1 << 20) } else { (self.stride / 2).max(1) };
        self.left = self.stride;
        if since < LOOK && !last {
            return true;
        }
        self.look(done, all)
    }

    /// Like [`tick`](Self::tick), for work with long pieces that calls repeatedly during a piece: the clock
    /// is read at every call.
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
