//! Sums of products, with as many accumulators as vectors have room for.

/// Σ a_i b_i over the shorter of both.
#[inline(always)]
pub(crate) fn product(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 16;
    let mut sums = [0.0; LANES];
    let (blocks, others) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f64 = blocks.remainder().iter().zip(others.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in blocks.zip(others) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    rest + sum_of(&mut sums)
}

/// Σ a_i
#[inline(always)]
pub(crate) fn sum(numbers: &[f64]) -> f64 {
    const LANES: usize = 16;
    let mut sums = [0.0; LANES];
    let blocks = numbers.chunks_exact(LANES);
    let rest: f64 = blocks.remainder().iter().sum();
    for block in blocks {
        for lane in 0..LANES {
            sums[lane] += block[lane];
        }
    }
    rest + sum_of(&mut sums)
}

#[inline(always)]
fn sum_of(sums: &mut [f64; 16]) -> f64 {
    for half in [8, 4, 2, 1] {
        for lane in 0..half {
            sums[lane] += sums[lane + half];
        }
    }
    sums[0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_have_every_term_once() {
        for length in [0, 1, 15, 16, 17, 40] {
            let a: Vec<f64> = (0..length).map(f64::from).collect();
            let b: Vec<f64> = (0..length).map(|i| f64::from(i + 1)).collect();
            let expected: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
            assert_eq!((product(&a, &b), sum(&a)), (expected, a.iter().sum()), "{length}");
        }
    }
}
