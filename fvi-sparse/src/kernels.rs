//! The inner loops: products of dense blocks.
//!
//! Each number is formed by the same operations in the same order whatever the width of the machine's vectors.

/// C ← C − A Bᵀ, column by column: C with `rows` rows of which neighbouring columns are `c_step` apart, one for each of
/// the first `columns` rows of B; A and B with `depth` columns, `step` apart.
#[inline(always)]
pub(crate) fn subtract_product(
    c: &mut [f64],
    c_step: usize,
    (rows, columns, depth): (usize, usize, usize),
    (a, b): (&[f64], &[f64]),
    step: usize,
) {
    let mut column = 0;
    while column + 4 <= columns {
        strip::<4>(&mut c[column * c_step..], c_step, (rows, depth), (a, &b[column..]), step);
        column += 4;
    }
    while column < columns {
        strip::<1>(&mut c[column * c_step..], c_step, (rows, depth), (a, &b[column..]), step);
        column += 1;
    }
}

/// The same for W columns.
#[inline(always)]
fn strip<const W: usize>(
    c: &mut [f64],
    c_step: usize,
    (rows, depth): (usize, usize),
    (a, b): (&[f64], &[f64]),
    step: usize,
) {
    let mut row = 0;
    while row + 8 <= rows {
        tile::<8, W>(&mut c[row..], c_step, depth, (&a[row..], b), step);
        row += 8;
    }
    while row < rows {
        tile::<1, W>(&mut c[row..], c_step, depth, (&a[row..], b), step);
        row += 1;
    }
}

/// The same for H rows and W columns.
#[inline(always)]
fn tile<const H: usize, const W: usize>(
    c: &mut [f64],
    c_step: usize,
    depth: usize,
    (a, b): (&[f64], &[f64]),
    step: usize,
) {
    let mut sums = [[0.0; H]; W];
    for (a, b) in a.chunks(step.max(1)).zip(b.chunks(step.max(1))).take(depth) {
        let (Some(a), Some(b)) = (a.first_chunk::<H>(), b.first_chunk::<W>()) else { return };
        for (sums, &b) in sums.iter_mut().zip(b) {
            for (sum, &a) in sums.iter_mut().zip(a) {
                *sum += a * b;
            }
        }
    }
    for (column, sums) in sums.iter().enumerate() {
        if let Some(c) = c.get_mut(column * c_step..).and_then(|c| c.first_chunk_mut::<H>()) {
            for (c, &sum) in c.iter_mut().zip(sums) {
                *c -= sum;
            }
        }
    }
}

/// y ← y − Σ x_j l_j for four columns.
#[inline(always)]
pub(crate) fn subtract_columns(y: &mut [f64], l: [&[f64]; 4], x: [f64; 4]) {
    for ((((y, &a), &b), &c), &d) in y.iter_mut().zip(l[0]).zip(l[1]).zip(l[2]).zip(l[3]) {
        *y -= (a * x[0] + b * x[1]) + (c * x[2] + d * x[3]);
    }
}

/// The products lᵀy of four columns with a vector, in eight partial sums each.
#[inline(always)]
pub(crate) fn products(l: [&[f64]; 4], y: &[f64]) -> [f64; 4] {
    let mut sums = [[0.0; 8]; 4];
    let (whole, rest) = y.as_chunks::<8>();
    let [a, b, c, d] = l.map(|column| column.as_chunks::<8>().0);
    for ((((y, a), b), c), d) in whole.iter().zip(a).zip(b).zip(c).zip(d) {
        for lane in 0..8 {
            sums[0][lane] += a[lane] * y[lane];
            sums[1][lane] += b[lane] * y[lane];
            sums[2][lane] += c[lane] * y[lane];
            sums[3][lane] += d[lane] * y[lane];
        }
    }
    let mut totals = sums.map(|[a, b, c, d, e, f, g, h]| ((a + b) + (c + d)) + ((e + f) + (g + h)));
    for (total, column) in totals.iter_mut().zip(l) {
        *total += column.iter().zip(y).skip(y.len() - rest.len()).map(|(&l, &y)| l * y).sum::<f64>();
    }
    totals
}
