//! Traces of a run that stay small however long it is.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// A curve over time, kept as the extremes of a bounded number of intervals: nothing that sticks out is lost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Envelope {
    buckets: Vec<Bucket>,
    /// Samples a bucket holds.
    width: usize,
    /// Samples in the newest bucket.
    filled: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Bucket {
    first: (f64, f64),
    lowest: (f64, f64),
    highest: (f64, f64),
    last: (f64, f64),
}

impl Bucket {
    fn of(point: (f64, f64)) -> Self {
        Self { first: point, lowest: point, highest: point, last: point }
    }

    fn take(&mut self, point: (f64, f64)) {
        if point.1 < self.lowest.1 {
            self.lowest = point;
        }
        if point.1 > self.highest.1 {
            self.highest = point;
        }
        self.last = point;
    }

    fn joined(self, later: Self) -> Self {
        let lowest = if later.lowest.1 < self.lowest.1 { later.lowest } else { self.lowest };
        let highest = if later.highest.1 > self.highest.1 { later.highest } else { self.highest };
        Self { first: self.first, lowest, highest, last: later.last }
    }
}

impl Envelope {
    const MOST_BUCKETS: usize = 2048;

    /// An empty trace.
    pub fn new() -> Self {
        Self { buckets: Vec::new(), width: 1, filled: 0 }
    }

    /// Whether a trace that was read could have been gathered.
    pub(crate) fn is_sound(&self) -> bool {
        self.buckets.len() <= Self::MOST_BUCKETS && (1..=self.width).contains(&self.filled.max(1))
    }

    /// Takes the next point; times ascend.
    #[inline]
    pub fn push(&mut self, time: f64, value: f64) {
        match self.buckets.last_mut() {
            Some(bucket) if self.filled < self.width => {
                bucket.take((time, value));
                self.filled += 1;
            }
            _ => self.open((time, value)),
        }
    }

    /// Begins a bucket.
    #[cold]
    fn open(&mut self, point: (f64, f64)) {
        if self.buckets.len() == Self::MOST_BUCKETS {
            self.halve();
        }
        self.buckets.push(Bucket::of(point));
        self.filled = 1;
    }

    /// Joins neighbouring buckets; their number is even.
    fn halve(&mut self) {
        self.buckets =
            self.buckets.chunks(2).filter_map(|pair| pair.iter().copied().reduce(Bucket::joined)).collect();
        self.width *= 2;
    }

    /// The curve to draw, at most four points for each interval.
    pub fn points(&self) -> Vec<(f64, f64)> {
        let mut points = Vec::with_capacity(4 * self.buckets.len());
        for bucket in &self.buckets {
            let mut inner = [bucket.lowest, bucket.highest];
            inner.sort_by(|a, b| a.0.total_cmp(&b.0));
            points.extend([bucket.first, inner[0], inner[1], bucket.last]);
        }
        points.dedup();
        points
    }
}

impl Default for Envelope {
    fn default() -> Self {
        Self::new()
    }
}

/// A path in the plane, kept as points a small share of its extent apart; of a path that is too long even so,
/// the beginning and the end.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PathTrace {
    beginning: Vec<(f64, f64)>,
    end: VecDeque<(f64, f64)>,
    /// Smallest distance of neighbouring points, as a share of the extent.
    spacing: f64,
    last: Option<(f64, f64)>,
    extent: Option<[(f64, f64); 2]>,
    interrupted: bool,
}

impl PathTrace {
    /// Most points of the beginning, and of the end.
    const MOST_POINTS: usize = 8192;
    /// Finer than anyone can see in a picture.
    const FINEST_SPACING: f64 = 1.0 / 512.0;

    /// An empty path.
    pub fn new() -> Self {
        Self::default()
    }

    /// Whether a path that was read could have been gathered.
    pub(crate) fn is_sound(&self) -> bool {
        self.beginning.len() <= Self::MOST_POINTS && self.end.len() <= Self::MOST_POINTS
    }

    /// Takes the next point of the path.
    #[inline]
    pub fn push(&mut self, x: f64, y: f64) {
        let inside = |[low, high]: [(f64, f64); 2]| low.0 <= x && x <= high.0 && low.1 <= y && y <= high.1;
        if !self.extent.is_some_and(inside) {
            if !x.is_finite() || !y.is_finite() {
                return;
            }
            self.widen((x, y));
        }
        self.last = Some((x, y));
        let newest = self.end.back().or(self.beginning.last());
        if !newest.is_some_and(|&kept| self.are_close(kept, (x, y))) {
            self.keep((x, y));
        }
    }

    fn keep(&mut self, point: (f64, f64)) {
        if self.beginning.len() == Self::MOST_POINTS && self.spacing == 0.0 {
            self.thin();
        }
        if self.beginning.len() < Self::MOST_POINTS {
            self.beginning.push(point);
            return;
        }
        if self.end.len() == Self::MOST_POINTS {
            self.end.pop_front();
            self.interrupted = true;
        }
        self.end.push_back(point);
    }

    /// Takes a point into the extent.
    #[cold]
    fn widen(&mut self, (x, y): (f64, f64)) {
        let [low, high] = self.extent.unwrap_or([(x, y); 2]);
        self.extent = Some([(low.0.min(x), low.1.min(y)), (high.0.max(x), high.1.max(y))]);
    }

    fn thin(&mut self) {
        self.spacing = Self::FINEST_SPACING;
        let mut kept: Vec<(f64, f64)> = Vec::with_capacity(Self::MOST_POINTS);
        for &point in &self.beginning {
            if kept.last().is_none_or(|&last| !self.are_close(last, point)) {
                kept.push(point);
            }
        }
        self.beginning = kept;
    }

    /// Whether two points are less than the spacing apart; where the path has no extent, all are.
    fn are_close(&self, a: (f64, f64), b: (f64, f64)) -> bool {
        let Some([low, high]) = self.extent else { return false };
        let close = |difference: f64, size: f64| {
            difference.abs() < self.spacing * size || (size == 0.0 && self.spacing > 0.0)
        };
        close(a.0 - b.0, high.0 - low.0) && close(a.1 - b.1, high.1 - low.1)
    }

    /// Whether the middle of the path is missing.
    pub fn interrupted(&self) -> bool {
        self.interrupted
    }

    /// The path to draw; a point that is not a number where it is interrupted.
    pub fn points(&self) -> Vec<(f64, f64)> {
        let gap = self.interrupted.then_some((f64::NAN, f64::NAN));
        let mut points = self.beginning.clone();
        points.extend(gap.into_iter().chain(self.end.iter().copied()).chain(self.last));
        points.dedup();
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_run_is_kept_whole() {
        let mut envelope = Envelope::new();
        let mut path = PathTrace::new();
        let points: Vec<(f64, f64)> = (0..100).map(|k| (f64::from(k), f64::from(k * k))).collect();
        for &(time, value) in &points {
            envelope.push(time, value);
            path.push(time, value);
        }
        assert_eq!(envelope.points(), points);
        assert_eq!(path.points(), points);
    }

    #[test]
    fn a_long_run_keeps_its_extremes_in_bounded_memory() {
        let mut envelope = Envelope::new();
        for k in 0..1_000_000 {
            let spike = if k == 123_457 { 100.0 } else { 0.0 };
            envelope.push(f64::from(k), (0.1 * f64::from(k)).sin() + spike);
        }
        let points = envelope.points();
        assert!(points.len() <= 4 * Envelope::MOST_BUCKETS && points.len() > Envelope::MOST_BUCKETS);
        assert!(points.iter().any(|&(time, value)| time == 123_457.0 && value > 99.0));
        assert!(points.windows(2).all(|pair| pair[0].0 <= pair[1].0));
        assert_eq!((points[0].0, points[points.len() - 1].0), (0.0, 999_999.0));
    }

    /// A spiral of many turns; returns the chords of its drawing.
    fn spiral(turns: f64, decay: f64) -> (PathTrace, Vec<f64>) {
        let mut path = PathTrace::new();
        let count = 1_000_000;
        for k in 0..count {
            let turned = turns * f64::from(k) / f64::from(count);
            let (radius, angle) = ((-decay * turned).exp(), core::f64::consts::TAU * turned);
            path.push(radius * angle.cos(), radius * angle.sin());
        }
        let chord = |pair: &[(f64, f64)]| (pair[0].0 - pair[1].0).hypot(pair[0].1 - pair[1].1);
        let chords = path.points().windows(2).map(chord).filter(|chord| chord.is_finite()).collect();
        (path, chords)
    }

    #[test]
    fn a_path_that_comes_to_rest_is_kept_whole_in_bounded_memory() {
        let (path, chords) = spiral(100.0, 0.3);
        assert!(path.points().len() < PathTrace::MOST_POINTS && !path.interrupted());
        assert!(chords.len() > 1000 && chords.iter().all(|&chord| chord < 0.01));
    }

    #[test]
    fn of_a_path_without_end_the_beginning_and_the_end_are_kept() {
        let (path, chords) = spiral(1000.0, 1e-4);
        let points = path.points();
        assert!(path.interrupted() && points.len() <= 2 * PathTrace::MOST_POINTS + 2);
        assert!(chords.iter().all(|&chord| chord < 0.02));
        let last = points[points.len() - 1];
        assert!((last.0.hypot(last.1) - (-0.1_f64).exp()).abs() < 1e-6);
        assert_eq!(points[0], (1.0, 0.0));
    }
}
