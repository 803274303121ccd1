//! Your own memory engine joins the comparison by implementing one trait.
//!
//! This one keeps every sample for a while and then only the mean of ever longer stretches, a popular
//! approximation: the table shows how fast it is and what it costs in accuracy.

// fvi-host hands fvi-core on: your crate depends on fvi-host alone.
use fvi_host::fvi_core::{BdfOrder, Memory, MemoryError, check_channels};
use fvi_host::lab::compare_engines::{Comparison, Contender, text_table};

/// Samples that are kept one by one.
const RECENT: usize = 256;

/// Recent samples one by one, older ones as sums over stretches of 16.
struct Coarsened {
    weights: Vec<f64>,
    recent: Vec<f64>,
    stretches: Vec<f64>,
}

impl Memory<f64> for Coarsened {
    fn channels(&self) -> usize {
        1
    }

    fn leading(&self) -> &[f64] {
        &self.weights[..1]
    }

    fn len(&self) -> usize {
        16 * self.stretches.len() + self.recent.len()
    }

    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        check_channels(1, term.len())?;
        let k = self.len();
        if k >= self.weights.len() {
            return Err(MemoryError::Full { capacity: self.weights.len() });
        }
        let recent = self.recent.iter().rev().zip(&self.weights[1..]).map(|(x, w)| x * w);
        // The weight in the middle of a stretch stands for all of it.
        let old = self.stretches.iter().enumerate().map(|(m, sum)| sum * self.weights[k - 16 * m - 8]);
        term[0] = recent.sum::<f64>() + old.sum::<f64>();
        Ok(())
    }

    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        check_channels(1, sample.len())?;
        if self.len() >= self.weights.len() {
            return Err(MemoryError::Full { capacity: self.weights.len() });
        }
        self.recent.push(sample[0]);
        if self.recent.len() >= RECENT + 16 {
            self.stretches.push(self.recent.drain(..16).sum());
        }
        Ok(())
    }

    fn clear(&mut self) {
        self.recent.clear();
        self.stretches.clear();
    }

    fn bytes(&self) -> usize {
        8 * (self.weights.len() + self.recent.capacity() + self.stretches.capacity())
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let own = Contender::new("coarsened", |task| {
        let weights = task.weights.to_vec();
        Ok(Some(Box::new(Coarsened { weights, recent: Vec::new(), stretches: Vec::new() })))
    });
    let contenders: Vec<Contender> = Contender::all().into_iter().chain([own]).collect();
    let comparison = Comparison {
        lengths: vec![1 << 10, 1 << 13],
        kernels: vec![(BdfOrder::GRUNWALD_LETNIKOV, 0.5)],
        repetitions: Some(5),
    };
    print!("{}", text_table(&comparison.run(&contenders, &mut |_| {})?));
    Ok(())
}
