//! Traces of a run of bounded size, whatever its length: a few kilobytes each, since they are part of
//! checkpoints.

use super::levels::{Level, Levels, has_level, moved};
use fvi_simulation::column::{extremes, first_place, is_finite};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// A curve over time, stored as the extremes in a bounded number of intervals, so that no peak is lost.
///
/// There are at least as many intervals as a picture has columns once the curve is longer than that; values
/// are stored to a hundredth of a pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Envelope {
    levels: Levels,
    intervals: Vec<Interval>,
    /// Number of samples in an interval.
    width: usize,
    /// The unfinished interval, and its number of samples.
    open: Option<Open>,
    filled: usize,
}

/// Unfinished interval, with exact extremes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Open {
    first: (f64, f64),
    lowest: (f64, f64),
    highest: (f64, f64),
    last: (f64, f64),
}

impl Open {
    fn of(point: (f64, f64)) -> Self {
        Self { first: point, lowest: point, highest: point, last: point }
    }

    #[inline]
    fn take(&mut self, point: (f64, f64)) {
        if point.1 < self.lowest.1 {
            self.lowest = point;
        }
        if point.1 > self.highest.1 {
            self.highest = point;
        }
        self.last = point;
    }

    /// Adds points, at least one.
    fn take_all(&mut self, times: &[f64], values: &[f64]) {
        let (low, high) = extremes(values);
        let first = |wanted: f64| {
            let index = first_place(values, wanted)?;
            times.get(index).copied().zip(values.get(index).copied())
        };
        if low < self.lowest.1 {
            self.lowest = first(low).unwrap_or(self.lowest);
        }
        if high > self.highest.1 {
            self.highest = first(high).unwrap_or(self.highest);
        }
        if let (Some(&time), Some(&value)) = (times.last(), values.last()) {
            self.last = (time, value);
        }
    }

    /// The extremes in the order of their times.
    fn extremes(&self) -> [(f64, f64); 2] {
        let (lowest, highest) = (self.lowest, self.highest);
        if highest.0 < lowest.0 { [highest, lowest] } else { [lowest, highest] }
    }
}

/// Finished interval: time of its first sample, and its extremes in order of time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "[u8; 8]", into = "[u8; 8]")]
struct Interval {
    begin: Moment,
    extremes: [Level; 2],
}

impl Interval {
    fn joined(self, later: Self) -> Self {
        let [a, b] = self.extremes;
        let [c, d] = later.extremes;
        let all = [a, b, c, d];
        let (lowest, highest) = (a.min(b).min(c).min(d), a.max(b).max(c).max(d));
        let place = |level| all.iter().position(|&other| other == level);
        let extremes = if place(highest) < place(lowest) { [highest, lowest] } else { [lowest, highest] };
        Self { begin: self.begin, extremes }
    }
}

impl From<Interval> for [u8; 8] {
    fn from(Interval { begin: Moment(begin), extremes: [earlier, later] }: Interval) -> Self {
        let [a, b, c, d] = begin.to_le_bytes();
        let ([e, f], [g, h]) = (earlier.to_le_bytes(), later.to_le_bytes());
        [a, b, c, d, e, f, g, h]
    }
}

impl From<[u8; 8]> for Interval {
    fn from([a, b, c, d, e, f, g, h]: [u8; 8]) -> Self {
        let extremes = [[e, f], [g, h]].map(Level::from_le_bytes);
        Self { begin: Moment(u32::from_le_bytes([a, b, c, d])), extremes }
    }
}

/// A time rounded to a relative accuracy of 10⁻⁶, enough on linear and logarithmic axes: the upper 32 bits of
/// its `f64`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Moment(u32);

impl Moment {
    fn of(time: f64) -> Self {
        let nearest = time.to_bits().saturating_add(1 << 31).min(f64::MAX.to_bits());
        Self((nearest >> 32) as u32)
    }

    fn time(self) -> f64 {
        f64::from_bits(u64::from(self.0) << 32)
    }
}

impl Envelope {
    /// Twice the number of pixel columns of a picture, so that after joining in pairs there is one interval
    /// for each column.
    const MOST_INTERVALS: usize = 1536;

    /// An empty trace.
    pub fn new() -> Self {
        Self { levels: Levels::default(), intervals: Vec::new(), width: 1, open: None, filled: 0 }
    }

    /// True if a trace read from a file is valid.
    pub(crate) fn is_sound(&self) -> bool {
        self.levels.is_sound()
            && self.intervals.len() <= Self::MOST_INTERVALS
            && self.filled <= self.width
            && (self.filled == 0) == self.open.is_none()
            && (self.open.is_some() || (self.intervals.is_empty() && self.width == 1))
    }

    /// Adds the next point; times ascend.
    #[inline]
    pub fn push(&mut self, time: f64, value: f64) {
        match &mut self.open {
            Some(open) if self.filled < self.width => {
                open.take((time, value));
                self.filled += 1;
            }
            _ => self.open((time, value)),
        }
    }

    /// Adds the next points, with the same result as [`push`](Self::push) for each.
    pub fn push_all(&mut self, mut times: &[f64], mut values: &[f64]) {
        while let (Some(&time), Some(&value)) = (times.first(), values.first()) {
            let free = self.width - self.filled;
            let count = match &mut self.open {
                Some(open) if free > 0 => {
                    let count = free.min(values.len()).min(times.len());
                    open.take_all(&times[..count], &values[..count]);
                    self.filled += count;
                    count
                }
                _ => {
                    self.open((time, value));
                    1
                }
            };
            (times, values) = (&times[count..], &values[count..]);
        }
    }

    /// Begins an interval.
    #[cold]
    fn open(&mut self, point: (f64, f64)) {
        if let Some(open) = self.open.take() {
            self.close(open);
        }
        self.open = Some(Open::of(point));
        self.filled = 1;
    }

    fn close(&mut self, open: Open) {
        if self.intervals.len() == Self::MOST_INTERVALS {
            self.halve();
        }
        let extremes = open.extremes().map(|(_, value)| value);
        for value in extremes {
            if let Some(ratio) = self.levels.reach(value) {
                for interval in &mut self.intervals {
                    interval.extremes = interval.extremes.map(|level| moved(level, ratio));
                }
            }
        }
        let extremes = extremes.map(|value| self.levels.level(value));
        self.intervals.push(Interval { begin: Moment::of(open.first.0), extremes });
    }

    /// Joins neighbouring intervals; their number is even. The interval that is closed next remains half as
    /// long as the following ones.
    fn halve(&mut self) {
        let pairs = self.intervals.chunks(2);
        self.intervals = pairs.filter_map(|pair| pair.iter().copied().reduce(Interval::joined)).collect();
        self.width *= 2;
    }

    /// The curve to draw, at most two points for each interval.
    pub fn points(&self) -> Vec<(f64, f64)> {
        let mut points = Vec::with_capacity(2 * self.intervals.len() + 5);
        let begins = self.intervals.iter().map(|interval| interval.begin.time());
        // The first value is known exactly: it is the origin of the levels.
        points.extend(begins.clone().next().zip(self.levels.origin()));
        let ends = begins.skip(1).chain(self.open.map(|open| open.first.0));
        // With equal steps this is the distance of the last sample from the first, relative to the interval.
        let share = (self.width - 1) as f64 / self.width as f64;
        for (interval, end) in self.intervals.iter().zip(ends) {
            let begin = interval.begin.time();
            let [earlier, later] = interval.extremes.map(|level| self.levels.number(level));
            points.push((begin, earlier));
            if self.width > 1 {
                points.push((begin + share * (end - begin).max(0.0), later));
            }
        }
        if let Some(open) = self.open {
            let [earlier, later] = open.extremes();
            points.extend([open.first, earlier, later, open.last]);
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

/// A path in the plane, stored as points at distances of a small fraction of its extent; of a path too long
/// for that, only beginning and end.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PathTrace {
    levels: [Levels; 2],
    beginning: Vec<LevelPoint>,
    end: VecDeque<LevelPoint>,
    /// Smallest distance of neighbouring points, as a fraction of the extent.
    spacing: f64,
    /// The newest stored point (`kept`), and the newest of all (`last`).
    kept: Option<(f64, f64)>,
    last: Option<(f64, f64)>,
    extent: Option<[(f64, f64); 2]>,
    interrupted: bool,
}

/// A point by its levels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "[u8; 4]", into = "[u8; 4]")]
struct LevelPoint([Level; 2]);

impl From<LevelPoint> for [u8; 4] {
    fn from(LevelPoint([x, y]): LevelPoint) -> Self {
        let ([a, b], [c, d]) = (x.to_le_bytes(), y.to_le_bytes());
        [a, b, c, d]
    }
}

impl From<[u8; 4]> for LevelPoint {
    fn from([a, b, c, d]: [u8; 4]) -> Self {
        Self([[a, b], [c, d]].map(Level::from_le_bytes))
    }
}

impl PathTrace {
    /// Largest number of points of the beginning, and of the end.
    const MOST_POINTS: usize = 2560;
    /// A circle drawn with chords of this length deviates by less than a hundredth of the line width.
    const FINEST_SPACING: f64 = 1.0 / 256.0;

    /// An empty path.
    pub fn new() -> Self {
        Self::default()
    }

    /// True if a path read from a file is valid.
    pub(crate) fn is_sound(&self) -> bool {
        self.levels.iter().all(Levels::is_sound)
            && self.beginning.len() <= Self::MOST_POINTS
            && self.end.len() <= Self::MOST_POINTS
    }

    /// Adds the next point of the path.
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
        let reach = self.reach();
        if !self.kept.is_some_and(|kept| are_within(reach, kept, (x, y))) {
            self.keep((x, y));
        }
    }

    /// Adds the next points of the path, with the same result as [`push`](Self::push) for each.
    pub fn push_all(&mut self, xs: &[f64], ys: &[f64]) {
        let Some([low, high]) = self.extent else { return self.push_each(xs, ys) };
        let within = |numbers: &[f64], low: f64, high: f64| {
            let (lowest, highest) = extremes(numbers);
            is_finite(numbers) && lowest >= low && highest <= high
        };
        if !within(xs, low.0, high.0) || !within(ys, low.1, high.1) {
            return self.push_each(xs, ys);
        }
        let mut reach = self.reach();
        for (&x, &y) in xs.iter().zip(ys) {
            if !self.kept.is_some_and(|kept| are_within(reach, kept, (x, y))) {
                self.keep((x, y));
                reach = self.reach();
            }
        }
        self.last = xs.last().copied().zip(ys.last().copied()).or(self.last);
    }

    fn push_each(&mut self, xs: &[f64], ys: &[f64]) {
        xs.iter().zip(ys).for_each(|(&x, &y)| self.push(x, y));
    }

    fn keep(&mut self, point: (f64, f64)) {
        self.kept = Some(point);
        if self.beginning.len() == Self::MOST_POINTS && self.spacing == 0.0 {
            self.thin();
        }
        let [x, y] = &self.levels;
        let place = LevelPoint([x.level(point.0), y.level(point.1)]);
        if self.beginning.len() < Self::MOST_POINTS {
            self.beginning.push(place);
            return;
        }
        if self.end.len() == Self::MOST_POINTS {
            self.end.pop_front();
            self.interrupted = true;
        }
        self.end.push_back(place);
    }

    /// Extends the extent by a point.
    #[cold]
    fn widen(&mut self, (x, y): (f64, f64)) {
        if !has_level(x) || !has_level(y) {
            // The picture leaves it out, with a note.
            return;
        }
        let [low, high] = self.extent.unwrap_or([(x, y); 2]);
        self.extent = Some([(low.0.min(x), low.1.min(y)), (high.0.max(x), high.1.max(y))]);
        let ratios = [self.levels[0].reach(x), self.levels[1].reach(y)];
        if ratios != [None; 2] {
            for LevelPoint([x, y]) in self.beginning.iter_mut().chain(&mut self.end) {
                *x = moved(*x, ratios[0].unwrap_or(1.0));
                *y = moved(*y, ratios[1].unwrap_or(1.0));
            }
        }
    }

    fn thin(&mut self) {
        self.spacing = Self::FINEST_SPACING;
        let mut kept: Vec<LevelPoint> = Vec::with_capacity(Self::MOST_POINTS);
        let reach = self.reach();
        for &place in &self.beginning {
            if kept.last().is_none_or(|&last| !are_within(reach, self.point(last), self.point(place))) {
                kept.push(place);
            }
        }
        self.beginning = kept;
    }

    fn point(&self, LevelPoint([x, y]): LevelPoint) -> (f64, f64) {
        (self.levels[0].number(x), self.levels[1].number(y))
    }

    /// Distances in x and y within which a point is not stored beside the previous one.
    fn reach(&self) -> (f64, f64) {
        let Some([low, high]) = self.extent else { return (0.0, 0.0) };
        let reach = |size: f64| match size {
            0.0 if self.spacing > 0.0 => f64::INFINITY,
            size => self.spacing * size,
        };
        (reach(high.0 - low.0), reach(high.1 - low.1))
    }

    /// True if the middle of the path is missing.
    pub fn interrupted(&self) -> bool {
        self.interrupted
    }

    /// The path to draw; a NaN point marks the interruption.
    pub fn points(&self) -> Vec<(f64, f64)> {
        let gap = self.interrupted.then_some((f64::NAN, f64::NAN));
        let mut points: Vec<_> = self.beginning.iter().map(|&place| self.point(place)).collect();
        let end = self.end.iter().map(|&place| self.point(place));
        // The newest point is known exactly; it may be the same as the last stored one.
        let last = self.last.filter(|_| self.last != self.kept);
        points.extend(gap.into_iter().chain(end).chain(last));
        points.dedup();
        points
    }
}

/// True if two points are less than `reach` apart in both directions.
#[inline(always)]
fn are_within(reach: (f64, f64), a: (f64, f64), b: (f64, f64)) -> bool {
    (a.0 - b.0).abs() < reach.0 && (a.1 - b.1).abs() < reach.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_core::min_or_nan;
    use fvi_fft::sums::max_or_nan;

    /// True if curves are visually indistinguishable, in a square with sides of this length.
    fn look_alike(found: &[(f64, f64)], expected: &[(f64, f64)], side: f64) -> bool {
        let close = |a: f64, b: f64| (a - b).abs() <= side / 16_000.0;
        found.len() == expected.len()
            && found.iter().zip(expected).all(|(a, b)| close(a.0, b.0) && close(a.1, b.1))
    }

    #[test]
    fn a_short_run_is_kept_whole() {
        let mut envelope = Envelope::new();
        let mut path = PathTrace::new();
        let points: Vec<(f64, f64)> = (0..100).map(|k| (f64::from(k), f64::from(k * k))).collect();
        for &(time, value) in &points {
            envelope.push(time, value);
            path.push(time, value);
        }
        assert!(look_alike(&envelope.points(), &points, 9801.0));
        assert!(look_alike(&path.points(), &points, 9801.0));
    }

    #[test]
    fn a_long_run_keeps_its_extremes_in_bounded_memory() {
        let mut envelope = Envelope::new();
        for k in 0..1_000_000 {
            let spike = if k == 123_457 { 100.0 } else { 0.0 };
            envelope.push(f64::from(k), (0.1 * f64::from(k)).sin() + spike);
        }
        let points = envelope.points();
        let columns = Envelope::MOST_INTERVALS / 2;
        assert!((2 * columns..=4 * columns + 5).contains(&points.len()));
        let spikes: Vec<_> = points.iter().filter(|point| point.1 > 2.0).collect();
        assert!(spikes.iter().all(|spike| (spike.0 - 123_457.0).abs() < 1e6 / columns as f64));
        assert!(spikes.iter().any(|spike| (spike.1 - 100.0 - 12_345.7_f64.sin()).abs() < 0.01));
        assert!(points.windows(2).all(|pair| pair[0].0 <= pair[1].0));
        assert_eq!((points[0], points[points.len() - 1].0), ((0.0, 0.0), 999_999.0));
    }

    #[test]
    fn a_smooth_curve_that_is_longer_than_a_picture_is_wide_keeps_its_shape() {
        for count in [1537, 3001, 5000] {
            let value = |time: f64| (0.003 * time).sin();
            let mut envelope = Envelope::new();
            (0..count).for_each(|k| envelope.push(f64::from(k), value(f64::from(k))));
            // Where an interval is shorter than the others its end is drawn half a sample too late, a quarter
            // of a pixel.
            let off = envelope.points().into_iter().map(|(time, found)| (found - value(time)).abs());
            assert!(off.fold(0.0, max_or_nan) < 0.5 * 0.003 + 2e-4, "{count} samples");
        }
    }

    #[test]
    fn traces_take_forty_five_kilobytes_of_a_checkpoint() {
        let mut traces = (Envelope::new(), Envelope::new(), PathTrace::new());
        for k in 0..200_000 {
            let (q, p) = (0.37 * f64::from(k)).sin_cos();
            let energy = 1.0 + 1e-9 * q;
            traces.0.push(f64::from(k), q);
            traces.1.push(f64::from(k), energy);
            traces.2.push(q, p * energy);
        }
        let bytes = postcard::to_allocvec(&traces).unwrap();
        assert!(bytes.len() <= 46_000, "{} bytes", bytes.len());
        let read: (Envelope, Envelope, PathTrace) = postcard::from_bytes(&bytes).unwrap();
        assert_eq!(read, traces);
        assert!(read.0.is_sound() && read.1.is_sound() && read.2.is_sound());
        // A small oscillation about a large value is resolved.
        let energies = traces.1.points().into_iter().map(|(_, energy)| energy);
        assert!(
            energies.clone().fold(1.0, max_or_nan) - 1.0 > 0.999e-9 && energies.fold(1.0, min_or_nan) < 1.0
        );
    }

    #[test]
    fn values_that_no_axis_reaches_hide_none_of_the_others() {
        let mut envelope = Envelope::new();
        let mut path = PathTrace::new();
        for (k, value) in [1.0, 2.0, 1.5e308, 3.0, 4.0].into_iter().enumerate() {
            envelope.push(k as f64, value);
            path.push(value, -value);
        }
        let expected = [1.0, 2.0, f64::MAX, 3.0, 4.0];
        assert_eq!(envelope.points().iter().map(|point| point.1).collect::<Vec<_>>(), expected);
        assert_eq!(path.points().iter().map(|point| point.0).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn many_points_at_once_leave_what_one_by_one_leaves() {
        let mut chance = fastrand::Rng::with_seed(3);
        let (mut one, mut all) = ((Envelope::new(), PathTrace::new()), (Envelope::new(), PathTrace::new()));
        let mut time = 0.0_f64;
        for _ in 0..1500 {
            let count = chance.usize(1..65);
            // Spikes, equal values, a growing extent, and occasionally NaN.
            let mut value = || match chance.usize(0..2000) {
                0 => f64::NAN,
                1..5 => 50.0 * chance.f64(),
                kind => (kind % 7) as f64 * (0.3 * time).cos(),
            };
            let (xs, ys): (Vec<f64>, Vec<f64>) = (0..count).map(|_| (value(), value())).unzip();
            let times: Vec<f64> = (0..count).map(|k| time + 0.01 * k as f64).collect();
            time += 0.01 * count as f64;
            for ((&time, &x), &y) in times.iter().zip(&xs).zip(&ys) {
                one.0.push(time, x);
                one.1.push(x, y);
            }
            all.0.push_all(&times, &xs);
            all.1.push_all(&xs, &ys);
        }
        // Compared as text, since NaN differs from itself.
        assert_eq!(format!("{one:?}"), format!("{all:?}"));
        assert!(one.1.interrupted() && one.0.width > 16);
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
        assert!(path.points().len() < 2 * PathTrace::MOST_POINTS && !path.interrupted());
        assert!(chords.len() > 1000 && chords.iter().all(|&chord| chord < 0.02));
    }

    #[test]
    fn of_a_path_without_end_the_beginning_and_the_end_are_kept() {
        let (path, chords) = spiral(1000.0, 1e-4);
        let points = path.points();
        assert!(path.interrupted() && points.len() <= 2 * PathTrace::MOST_POINTS + 2);
        assert!(chords.iter().all(|&chord| chord < 0.04));
        let last = points[points.len() - 1];
        assert!((last.0.hypot(last.1) - (-0.1_f64).exp()).abs() < 1e-4);
        assert_eq!(points[0], (1.0, 0.0));
    }
}
