//! The progress bar of commands that count what they do.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// A progress bar that appears on a terminal once the work has taken about a second.
pub(super) struct Progress {
    all: usize,
    unit: &'static str,
    start: Instant,
    wanted: bool,
    bar: Option<ProgressBar>,
}

/// Most looks at the clock: one costs as much as a short step.
const MOST_UPDATES: usize = 4096;

impl Progress {
    /// For `all` pieces of work, called `unit` in the plural; nothing is shown if `quiet` or not on a terminal.
    pub(super) fn new(all: usize, unit: &'static str, quiet: bool) -> Self {
        let wanted = !quiet && std::io::stderr().is_terminal();
        Self { all, unit, start: Instant::now(), wanted, bar: None }
    }

    /// Shows that `done` pieces are done.
    pub(super) fn update(&mut self, done: usize) {
        if !self.wanted || !done.is_multiple_of(self.all.div_ceil(MOST_UPDATES).max(1)) {
            return;
        }
        if self.bar.is_none() && self.start.elapsed() > Duration::from_secs(1) {
            self.bar = Some(self.styled_bar());
        }
        if let Some(bar) = &self.bar {
            bar.set_position(done as u64);
        }
    }

    fn styled_bar(&self) -> ProgressBar {
        let bar = ProgressBar::with_draw_target(Some(self.all as u64), ProgressDrawTarget::stderr());
        let unit = self.unit;
        let template =
            format!("{{bar:40}} {{human_pos}}/{{human_len}} {unit}, {{elapsed}} gone, {{eta}} to go");
        match ProgressStyle::with_template(&template) {
            Ok(style) => bar.with_style(style),
            Err(_) => bar,
        }
    }

    /// Takes the bar away.
    pub(super) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
