//! Statistics of the costs of several runs.

/// Mean and worst case of several runs.
#[derive(Clone, Copy, Default)]
pub struct Spread {
    total: u64,
    runs: u32,
    worst: u32,
}

impl Spread {
    /// Adds a run.
    pub fn add(&mut self, cost: u32) {
        self.total += u64::from(cost);
        self.runs += 1;
        self.worst = self.worst.max(cost);
    }

    /// Mean.
    pub fn mean(&self) -> f32 {
        self.total as f32 / self.runs.max(1) as f32
    }

    /// Worst case.
    pub fn worst(&self) -> u32 {
        self.worst
    }
}
