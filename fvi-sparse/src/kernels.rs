//! The inner loops: products of dense blocks.
//!
//! Each number is formed by the same operations in the same order whatever the width of the machine's
//! vectors.

use pulp::Simd;

/// C ← C − A Bᵀ, column by column: C with `rows` rows of which neighbouring columns are `c_step` apart, one
/// for each of the first `columns` rows of B; A and B with `depth` columns, `step` apart.
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

/// Whether W numbers fill vectors of the machine: they are then computed with side by side.
#[inline(always)]
const fn fills_vectors<S: Simd, const W: usize>() -> bool {
    W > 1 && W.is_multiple_of(S::F64_LANES)
}

/// Number `part` of the vectors that W numbers are.
#[inline(always)]
fn vector<S: Simd, const W: usize>(unit: S, numbers: &[f64; W], part: usize) -> S::f64s {
    S::as_simd_f64s(numbers).0.get(part).copied().unwrap_or(unit.splat_f64s(0.0))
}

/// y ← y − Σ x_j l_j for four columns, and for W right-hand sides that lie side by side.
#[inline(always)]
pub(crate) fn subtract_columns<S: Simd, const W: usize>(
    unit: S,
    y: &mut [[f64; W]],
    l: [&[f64]; 4],
    x: [[f64; W]; 4],
) {
    let rows = l[0].iter().zip(l[1]).zip(l[2]).zip(l[3]);
    if !fills_vectors::<S, W>() {
        let [p, q, r, s] = x;
        for (y, (((&a, &b), &c), &d)) in y.iter_mut().zip(rows) {
            for lane in 0..W {
                y[lane] -= (a * p[lane] + b * q[lane]) + (c * r[lane] + d * s[lane]);
            }
        }
        return;
    }
    for part in 0..W / S::F64_LANES {
        let [p, q, r, s] = [0, 1, 2, 3].map(|column: usize| vector(unit, &x[column], part));
        let times = |number: &f64, x| unit.mul_f64s(unit.splat_f64s(*number), x);
        for (y, (((a, b), c), d)) in y.iter_mut().zip(rows.clone()) {
            if let Some(y) = S::as_mut_simd_f64s(y).0.get_mut(part) {
                let (ab, cd) =
                    (unit.add_f64s(times(a, p), times(b, q)), unit.add_f64s(times(c, r), times(d, s)));
                *y = unit.sub_f64s(*y, unit.add_f64s(ab, cd));
            }
        }
    }
}

/// The products lᵀy of four columns with W vectors, in eight partial sums each.
#[inline(always)]
pub(crate) fn products<S: Simd, const W: usize>(unit: S, l: [&[f64]; 4], y: &[[f64; W]]) -> [[f64; W]; 4] {
    let [a, b, c, d] = l;
    if W == 1 {
        return some_products(unit, [a, b, c, d], y);
    }
    // As many sums as there are registers.
    let ([a, b], [c, d]) = (some_products(unit, [a, b], y), some_products(unit, [c, d], y));
    [a, b, c, d]
}

/// The same for C columns.
#[inline(always)]
fn some_products<S: Simd, const C: usize, const W: usize>(
    unit: S,
    l: [&[f64]; C],
    y: &[[f64; W]],
) -> [[f64; W]; C] {
    let (whole, rest) = y.as_chunks::<8>();
    let columns = l.map(|column| column.as_chunks::<8>().0);
    let mut totals = [[0.0; W]; C];
    if fills_vectors::<S, W>() {
        for part in 0..W / S::F64_LANES {
            let mut sums = [[unit.splat_f64s(0.0); 8]; C];
            for (chunk, y) in whole.iter().enumerate() {
                for (sums, column) in sums.iter_mut().zip(columns) {
                    let Some(l) = column.get(chunk) else { break };
                    for ((sum, &l), y) in sums.iter_mut().zip(l).zip(y) {
                        let product = unit.mul_f64s(unit.splat_f64s(l), vector(unit, y, part));
                        *sum = unit.add_f64s(*sum, product);
                    }
                }
            }
            for (total, sums) in totals.iter_mut().zip(sums) {
                if let Some(total) = S::as_mut_simd_f64s(total).0.get_mut(part) {
                    *total = in_pairs(sums, |a, b| unit.add_f64s(a, b));
                }
            }
        }
    } else {
        let mut sums = [[[0.0; W]; 8]; C];
        for (chunk, y) in whole.iter().enumerate() {
            for (sums, column) in sums.iter_mut().zip(columns) {
                let Some(l) = column.get(chunk) else { break };
                for ((sum, &l), y) in sums.iter_mut().zip(l).zip(y) {
                    for lane in 0..W {
                        sum[lane] += l * y[lane];
                    }
                }
            }
        }
        let plus = |a: [f64; W], b: [f64; W]| core::array::from_fn(|lane| a[lane] + b[lane]);
        totals = sums.map(|sums| in_pairs(sums, plus));
    }
    let first = y.len() - rest.len();
    for (total, column) in totals.iter_mut().zip(l) {
        let mut sum = [0.0; W];
        for (&l, y) in column.iter().skip(first).zip(rest) {
            for lane in 0..W {
                sum[lane] += l * y[lane];
            }
        }
        for lane in 0..W {
            total[lane] += sum[lane];
        }
    }
    totals
}

/// The sum of eight parts.
#[inline(always)]
fn in_pairs<T>([a, b, c, d, e, f, g, h]: [T; 8], plus: impl Fn(T, T) -> T) -> T {
    plus(plus(plus(a, b), plus(c, d)), plus(plus(e, f), plus(g, h)))
}
