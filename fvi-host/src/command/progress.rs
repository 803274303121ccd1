//! Progress of commands on a terminal.

use super::terminal::mention;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// A line on a terminal that is written over and over, and appears once the work has taken about a second.
pub(super) struct ProgressLine {
    start: Instant,
    /// When it is written next; `None`: never.
    next: Option<Duration>,
    shown: bool,
}

impl ProgressLine {
    /// Nothing is shown if `quiet` or not on a terminal.
    pub(super) fn new(quiet: bool) -> Self {
        let wanted = !quiet && std::io::stderr().is_terminal();
        Self { start: Instant::now(), next: wanted.then_some(Duration::from_secs(1)), shown: false }
    }

    /// Writes what is said after the time gone, ten times a second at most.
    pub(super) fn update(&mut self, say: impl FnOnce(Duration) -> String) {
        let Some(next) = self.next else { return };
        let gone = self.start.elapsed();
        if gone < next {
            return;
        }
        // What does not fit into the terminal's width is cut, not wrapped.
        mention(&format!("\r\x1b[?7l{}\x1b[K\x1b[?7h", say(gone)));
        self.next = Some(gone + Duration::from_millis(100));
        self.shown = true;
    }

    /// Takes the line away.
    pub(super) fn finish(&mut self) {
        if std::mem::take(&mut self.shown) {
            mention("\r\x1b[K");
        }
    }
}

/// Errors begin on a line of their own.
impl Drop for ProgressLine {
    fn drop(&mut self) {
        self.finish();
    }
}

/// The progress of what is counted.
pub(super) struct Progress {
    /// `None`: unknown.
    all: Option<usize>,
    unit: &'static str,
    line: ProgressLine,
}

/// Most looks at the clock: one costs as much as a short step.
const MOST_UPDATES: usize = 4096;

/// Characters of a full bar.
const WIDTH: usize = 40;

impl Progress {
    /// For `all` pieces of work, called `unit` in the plural; nothing is shown if `quiet` or not on a
    /// terminal.
    pub(super) fn new(all: usize, unit: &'static str, quiet: bool) -> Self {
        Self { all: Some(all), unit, line: ProgressLine::new(quiet) }
    }

    /// For pieces of work of which nobody knows how many there will be.
    pub(super) fn of_unknown(unit: &'static str, quiet: bool) -> Self {
        Self { all: None, unit, line: ProgressLine::new(quiet) }
    }

    /// Shows that `done` pieces are done.
    pub(super) fn update(&mut self, done: usize) {
        let stride = self.all.map_or(1, |all| all.div_ceil(MOST_UPDATES).max(1));
        if done.is_multiple_of(stride) {
            let (all, unit) = (self.all, self.unit);
            self.line.update(|gone| said(done, all, unit, gone));
        }
    }

    /// Takes the bar away.
    pub(super) fn finish(&mut self) {
        self.line.finish();
    }
}

/// The line for `done` of `all` pieces.
fn said(done: usize, all: Option<usize>, unit: &str, gone: Duration) -> String {
    let time = rounded(gone);
    let Some(all) = all else { return format!("{} {unit}, {time} gone", grouped(done)) };
    let share = if all == 0 { 1.0 } else { (done as f64 / all as f64).min(1.0) };
    let full = (share * WIDTH as f64) as usize;
    let bar = "█".repeat(full) + &"░".repeat(WIDTH - full);
    let left = if share > 0.0 {
        format!(", {} to go", rounded(gone.mul_f64(((1.0 - share) / share).min(1e9))))
    } else {
        String::new()
    };
    format!("{bar} {}/{} {unit}, {time} gone{left}", grouped(done), grouped(all))
}

/// A time in the unit that suits it.
fn rounded(time: Duration) -> String {
    match time.as_secs() {
        seconds @ ..120 => format!("{seconds} s"),
        seconds @ ..7200 => format!("{} min", seconds / 60),
        seconds => format!("{} h", seconds / 3600),
    }
}

/// A number with a comma behind the thousands, the millions and so on.
fn grouped(number: usize) -> String {
    let digits = number.to_string();
    let first = digits.len() % 3;
    let (head, tail) = digits.split_at(first);
    let tail = tail.as_bytes().chunks(3).map(|group| String::from_utf8_lossy(group).into_owned());
    let head = (!head.is_empty()).then(|| head.to_owned());
    head.into_iter().chain(tail).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_tells_what_is_done_and_what_is_left() {
        let said = |done, all, seconds| said(done, all, "steps", Duration::from_secs(seconds));
        let half = "█".repeat(20) + &"░".repeat(20);
        assert_eq!(
            said(500_000, Some(1_000_000), 60),
            half + " 500,000/1,000,000 steps, 60 s gone, 60 s to go"
        );
        assert_eq!(said(0, Some(10), 1), "░".repeat(40) + " 0/10 steps, 1 s gone");
        assert_eq!(said(10, Some(10), 300), "█".repeat(40) + " 10/10 steps, 5 min gone, 0 s to go");
        assert_eq!(said(12_345, None, 7300), "12,345 steps, 2 h gone");
        assert!(said(1, Some(usize::MAX), u64::from(u32::MAX)).ends_with(" h to go"));
    }

    #[test]
    fn quiet_commands_show_nothing() {
        let mut line = ProgressLine::new(true);
        line.update(|_| panic!("nobody asked"));
        line.finish();
    }
}
