//! The progress bar of commands with countable work.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// A progress bar that appears on a terminal once the work has taken about a second.
pub(super) struct Progress {
    /// Number of pieces of work; `None`: unknown.
    all: Option<usize>,
    /// Number of pieces of work between two readings of the clock.
    stride: usize,
    unit: &'static str,
    start: Instant,
    wanted: bool,
    bar: Option<ProgressBar>,
}

/// Largest number of readings of the clock, each of which costs as much as a short step.
const MOST_UPDATES: usize = 4096;

impl Progress {
    /// For `all` pieces of work, called `unit` in the plural; nothing is shown if `quiet` or not on a
    /// terminal.
    pub(super) fn new(all: usize, unit: &'static str, quiet: bool) -> Self {
        Self::of(Some(all), unit, quiet)
    }

    /// A progress bar for an unknown number of pieces of work.
    pub(super) fn of_unknown(unit: &'static str, quiet: bool) -> Self {
        Self::of(None, unit, quiet)
    }

    fn of(all: Option<usize>, unit: &'static str, quiet: bool) -> Self {
        let wanted = !quiet && std::io::stderr().is_terminal();
        let stride = all.map_or(1, |all| all.div_ceil(MOST_UPDATES).max(1));
        Self { all, stride, unit, start: Instant::now(), wanted, bar: None }
    }

    /// Shows that `done` pieces are done.
    pub(super) fn update(&mut self, done: usize) {
        if !self.wanted || !done.is_multiple_of(self.stride) {
            return;
        }
        if self.bar.is_none() && self.start.elapsed() > Duration::from_secs(1) {
            self.bar = Some(self.styled_bar());
        }
        if let Some(bar) = &self.bar {
            bar.set_position(done as u64);
        }
    }

    /// Shows that `done` pieces are done where, as far as is known now, there are `all`.
    #[cfg(feature = "research")]
    pub(super) fn update_of(&mut self, done: usize, all: usize) {
        self.all = Some(all);
        if let Some(bar) = &self.bar {
            bar.set_length(all as u64);
        }
        self.update(done);
    }

    fn styled_bar(&self) -> ProgressBar {
        let all = self.all.map(|all| all as u64);
        let bar = ProgressBar::with_draw_target(all, ProgressDrawTarget::stderr());
        let unit = self.unit;
        let template = match all {
            Some(_) => {
                format!("{{bar:40}} {{human_pos}}/{{human_len}} {unit}, {{elapsed}} gone, {{eta}} to go")
            }
            None => format!("{{human_pos}} {unit}, {{elapsed}} gone"),
        };
        match ProgressStyle::with_template(&template) {
            Ok(style) => bar.with_style(style),
            Err(_) => bar,
        }
    }

    /// Removes the bar.
    pub(super) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
