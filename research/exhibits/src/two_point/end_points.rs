//! Where the motion of a two-point problem begins and ends.

/// The fixed positions Q₀ and Q_N.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct EndPoints {
    pub(super) start: Vec<f64>,
    pub(super) end: Vec<f64>,
}

impl EndPoints {
    /// `None` unless each has `expected` finite numbers.
    pub(super) fn new(start: &[f64], end: &[f64], expected: usize) -> Option<Self> {
        let good = |position: &[f64]| position.len() == expected && position.iter().all(|x| x.is_finite());
        (good(start) && good(end)).then(|| Self { start: start.to_vec(), end: end.to_vec() })
    }

    /// The guess with these ends, or the straight line between them.
    pub(super) fn join(&self, guess: Option<&[f64]>, steps: usize) -> Vec<f64> {
        let d = self.start.len();
        let mut positions = match guess {
            Some(guess) => guess.to_vec(),
            None => (0..=steps)
                .flat_map(|k| {
                    let part = k as f64 / steps as f64;
                    self.start.iter().zip(&self.end).map(move |(a, b)| a * (1.0 - part) + b * part)
                })
                .collect(),
        };
        positions[..d].copy_from_slice(&self.start);
        positions[steps * d..].copy_from_slice(&self.end);
        positions
    }
}
