//! Traces of a run that stay small however long it is.

/// A curve over time, kept as the extremes of a bounded number of intervals: nothing that sticks out is lost.
#[derive(Clone, Debug)]
pub struct Envelope {
    buckets: Vec<Bucket>,
    /// Samples a bucket holds.
    width: usize,
    /// Samples in the newest bucket.
    filled: usize,
}

#[derive(Clone, Copy, Debug)]
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

    /// Takes the next point; times ascend.
    pub fn push(&mut self, time: f64, value: f64) {
        let point = Bucket::of((time, value));
        match self.buckets.last_mut() {
            Some(bucket) if self.filled < self.width => {
                *bucket = bucket.joined(point);
                self.filled += 1;
            }
            _ => {
                if self.buckets.len() == Self::MOST_BUCKETS {
                    self.halve();
                }
                self.buckets.push(point);
                self.filled = 1;
            }
        }
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

/// A path in the plane, kept as points no closer than a small share of its extent.
#[derive(Clone, Debug, Default)]
pub struct PathTrace {
    points: Vec<(f64, f64)>,
    /// Smallest distance of neighbouring points, as a share of the extent.
    spacing: f64,
    last: Option<(f64, f64)>,
    extent: Option<[(f64, f64); 2]>,
}

impl PathTrace {
    const MOST_POINTS: usize = 16_384;

    /// An empty path.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes the next point of the path.
    pub fn push(&mut self, x: f64, y: f64) {
        let point = (x, y);
        if !x.is_finite() || !y.is_finite() {
            return;
        }
        let [low, high] = self.extent.unwrap_or([point, point]);
        self.extent = Some([(low.0.min(x), low.1.min(y)), (high.0.max(x), high.1.max(y))]);
        self.last = Some(point);
        if self.points.last().is_some_and(|&kept| self.distance(kept, point) < self.spacing) {
            return;
        }
        self.points.push(point);
        while self.points.len() > Self::MOST_POINTS {
            self.spacing = (2.0 * self.spacing).max(1.0 / 4096.0);
            self.thin();
            // A path that fills the plane is dropped to its newest part at last.
            if self.spacing > 0.02 && self.points.len() > Self::MOST_POINTS {
                self.points.drain(..Self::MOST_POINTS / 2);
            }
        }
    }

    fn thin(&mut self) {
        let mut kept: Vec<(f64, f64)> = Vec::with_capacity(self.points.len());
        for &point in &self.points {
            if kept.last().is_none_or(|&last| self.distance(last, point) >= self.spacing) {
                kept.push(point);
            }
        }
        self.points = kept;
    }

    /// Distance as a share of the extent.
    fn distance(&self, a: (f64, f64), b: (f64, f64)) -> f64 {
        let Some([low, high]) = self.extent else { return 0.0 };
        let share = |difference: f64, size: f64| if size > 0.0 { (difference / size).abs() } else { 0.0 };
        share(a.0 - b.0, high.0 - low.0).max(share(a.1 - b.1, high.1 - low.1))
    }

    /// The path to draw.
    pub fn points(&self) -> Vec<(f64, f64)> {
        let mut points = self.points.clone();
        points.extend(self.last);
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

    #[test]
    fn a_long_path_keeps_its_shape_in_bounded_memory() {
        let mut path = PathTrace::new();
        for k in 0..1_000_000 {
            let angle = 1e-3 * f64::from(k);
            let radius = (-3e-6 * f64::from(k)).exp();
            path.push(radius * angle.cos(), radius * angle.sin());
        }
        let points = path.points();
        assert!(points.len() <= PathTrace::MOST_POINTS + 1);
        // The first turn is still a circle, no chord longer than a twenty-fifth of it.
        let turn: Vec<_> = points.iter().take_while(|point| point.0.hypot(point.1) > 0.985).collect();
        assert!(turn.windows(2).all(|pair| (pair[0].0 - pair[1].0).hypot(pair[0].1 - pair[1].1) < 0.08));
        assert!(turn.len() > 100);
    }
}
