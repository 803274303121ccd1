//! The inner loops: products of dense blocks.
//!
//! Each number is computed by the same operations in the same order whatever the width of the machine's
//! vectors.

use pulp::Simd;

/// Rows and columns of a product that are computed together: as many sums as fit into the registers.
const TILE: (usize, usize) = (8, 4);

/// Number of rows of A that stay in the cache for all rows of B.
const ROWS: usize = 64;

/// Buffers for products of blocks, with the numbers in the order in which they are used.
#[derive(Default)]
pub(crate) struct Products {
    a: Vec<[f64; TILE.0]>,
    b: Vec<[f64; TILE.1]>,
    /// True if every second column of A and B has a negative sign in the product.
    signed: bool,
}

impl Products {
    /// Products A Bᵀ, or A Σ Bᵀ with the signs 1, −1, 1, …
    pub(crate) fn signed(signed: bool) -> Self {
        Self { signed, ..Self::default() }
    }

    /// C ← C − A Bᵀ. C has `rows` rows and columns at distance `c_step`, one for each of the first `columns`
    /// rows of B; A and B have `depth` columns, at distance `step`.
    #[inline(always)]
    pub(crate) fn subtract(
        &mut self,
        c: &mut [f64],
        c_step: usize,
        (rows, columns, depth): (usize, usize, usize),
        (a, b): (&[f64], &[f64]),
        step: usize,
    ) {
        if rows == 0 || columns == 0 || depth == 0 {
            return;
        }
        pack(&mut self.b, b, (columns, depth), step);
        if self.signed {
            for pair in self.b.chunks_exact_mut(2) {
                pair[1].iter_mut().for_each(|number| *number = -*number);
            }
        }
        for first in (0..rows).step_by(ROWS) {
            let count = (rows - first).min(ROWS);
            pack(&mut self.a, &a[first..], (count, depth), step);
            for (b, column) in self.b.chunks_exact(depth).zip((0..columns).step_by(TILE.1)) {
                for (a, row) in self.a.chunks_exact(depth).zip((0..count).step_by(TILE.0)) {
                    let sums = tile(a, b);
                    let height = (count - row).min(TILE.0);
                    for (sums, column) in sums.iter().zip(column..columns) {
                        let c = &mut c[column * c_step + first + row..][..height];
                        c.iter_mut().zip(sums).for_each(|(c, &sum)| *c -= sum);
                    }
                }
            }
        }
    }
}

/// Writes strips of W rows one after another, each column by column; missing rows are zero.
#[inline(always)]
fn pack<const W: usize>(
    packed: &mut Vec<[f64; W]>,
    from: &[f64],
    (rows, depth): (usize, usize),
    step: usize,
) {
    packed.clear();
    packed.resize(rows.div_ceil(W) * depth, [0.0; W]);
    for (index, column) in from.chunks(step.max(1)).take(depth).enumerate() {
        let (whole, rest) = column[..rows].as_chunks::<W>();
        let mut places = packed.iter_mut().skip(index).step_by(depth);
        places.by_ref().zip(whole).for_each(|(place, numbers)| *place = *numbers);
        if let Some(place) = places.next() {
            place[..rest.len()].copy_from_slice(rest);
        }
    }
}

/// The product of two strips.
#[inline(always)]
fn tile(a: &[[f64; TILE.0]], b: &[[f64; TILE.1]]) -> [[f64; TILE.0]; TILE.1] {
    let mut sums = [[0.0; TILE.0]; TILE.1];
    for (a, b) in a.iter().zip(b) {
        for (sums, &b) in sums.iter_mut().zip(b) {
            for (sum, &a) in sums.iter_mut().zip(a) {
                *sum += a * b;
            }
        }
    }
    sums
}

/// Vector number `part` of the vectors that make up W numbers.
#[inline(always)]
fn vector<S: Simd, const W: usize>(unit: S, numbers: &[f64; W], part: usize) -> S::f64s {
    S::as_simd_f64s(numbers).0.get(part).copied().unwrap_or(unit.splat_f64s(0.0))
}

/// Checks that right-hand sides side by side fill whole vectors on every machine.
const fn one_or_vectors(width: usize) {
    assert!(width == 1 || width.is_multiple_of(8));
}

/// Numbers per cache line.
const LINE: usize = 8;

/// Prefetches C cache lines: the lines from C · `run` on. With eight right-hand sides the arithmetic for a
/// line takes so long that the memory would be idle meanwhile; with one right-hand side, memory is the limit
/// anyway.
#[inline(always)]
fn fetch_ahead<const C: usize>(numbers: &[f64], run: usize) {
    #[cfg(target_arch = "x86_64")]
    if let (Some(unit), Some(lines)) =
        (pulp::core_arch::x86::Sse::try_new(), numbers.get(C * LINE * run..C * LINE * (run + 1)))
    {
        for line in lines.chunks_exact(LINE) {
            unit._mm_prefetch::<{ core::arch::x86_64::_MM_HINT_T0 }>(line.as_ptr().cast());
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (numbers, run);
}

/// y ← y − Σ x_j l_j for four columns, and for W right-hand sides side by side. With several right-hand sides
/// the same amount of the numbers `next` is prefetched meanwhile.
#[inline(always)]
pub(crate) fn subtract_columns<S: Simd, const W: usize>(
    unit: S,
    y: &mut [[f64; W]],
    l: [&[f64]; 4],
    x: [[f64; W]; 4],
    next: &[f64],
) {
    const { one_or_vectors(W) };
    if W == 1 {
        return subtract_rows(unit, y, l, x);
    }
    let (whole, rest) = y.as_chunks_mut::<LINE>();
    let columns = l.map(|column| column.as_chunks::<LINE>());
    let [a, b, c, d] = columns.map(|(whole, _)| whole);
    let rows = a.iter().zip(b).zip(c).zip(d);
    for (run, (y, (((a, b), c), d))) in whole.iter_mut().zip(rows).enumerate() {
        fetch_ahead::<4>(next, run);
        subtract_rows(unit, y, [a, b, c, d], x);
    }
    subtract_rows(unit, rest, columns.map(|(_, rest)| rest), x);
}

/// The same for some rows.
#[inline(always)]
fn subtract_rows<S: Simd, const W: usize>(unit: S, y: &mut [[f64; W]], l: [&[f64]; 4], x: [[f64; W]; 4]) {
    let rows = l[0].iter().zip(l[1]).zip(l[2]).zip(l[3]);
    if W == 1 {
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

/// The products lᵀy of C columns, a multiple of two, with W vectors, in eight partial sums each; `next` is
/// prefetched as in [`subtract_columns`].
#[inline(always)]
pub(crate) fn products<S: Simd, const C: usize, const W: usize>(
    unit: S,
    l: [&[f64]; C],
    y: &[[f64; W]],
    next: &[f64],
) -> [[f64; W]; C] {
    const { one_or_vectors(W) };
    if W == 1 {
        return products_with_one(unit, l, y.as_flattened()).map(|product| [product; W]);
    }
    // Pairs of columns, as many sums as there are registers.
    let mut products = [[0.0; W]; C];
    let pairs = products.as_chunks_mut::<2>().0.iter_mut().zip(l.as_chunks::<2>().0);
    for (pair, (products, l)) in pairs.enumerate() {
        *products = products_with_some(unit, *l, y, next.get(pair * 2 * y.len()..).unwrap_or_default());
    }
    products
}

/// The same with one vector.
#[inline(always)]
fn products_with_one<S: Simd, const C: usize>(unit: S, l: [&[f64]; C], y: &[f64]) -> [f64; C] {
    let (whole, rest) = y.as_chunks::<8>();
    let columns = l.map(|column| column.as_chunks::<8>().0);
    // Sums for all lanes of the vectors that make up eight numbers.
    let mut sums = [[unit.splat_f64s(0.0); 8]; C];
    for (chunk, y) in whole.iter().enumerate() {
        for (sums, column) in sums.iter_mut().zip(columns) {
            let Some(l) = column.get(chunk) else { break };
            let vectors = S::as_simd_f64s(l).0.iter().zip(S::as_simd_f64s(y).0);
            for (sum, (&l, &y)) in sums.iter_mut().zip(vectors) {
                *sum = unit.add_f64s(*sum, unit.mul_f64s(l, y));
            }
        }
    }
    let mut totals = [0.0; C];
    for ((total, sums), column) in totals.iter_mut().zip(sums).zip(l) {
        let mut lanes = [0.0; 8];
        S::as_mut_simd_f64s(&mut lanes).0.iter_mut().zip(sums).for_each(|(lanes, sum)| *lanes = sum);
        let last = column.iter().skip(y.len() - rest.len()).zip(rest);
        *total = in_pairs(lanes, |a, b| a + b) + last.fold(0.0, |sum, (&l, &y)| sum + l * y);
    }
    totals
}

/// The same with W vectors.
#[inline(always)]
fn products_with_some<S: Simd, const C: usize, const W: usize>(
    unit: S,
    l: [&[f64]; C],
    y: &[[f64; W]],
    next: &[f64],
) -> [[f64; W]; C] {
    let (whole, rest) = y.as_chunks::<8>();
    let columns = l.map(|column| column.as_chunks::<8>().0);
    let mut totals = [[0.0; W]; C];
    for part in 0..W / S::F64_LANES {
        let mut sums = [[unit.splat_f64s(0.0); 8]; C];
        for (chunk, y) in whole.iter().enumerate() {
            if part == 0 {
                fetch_ahead::<C>(next, chunk);
            }
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

/// The sum of eight parts, by pairs.
#[inline(always)]
fn in_pairs<T>([a, b, c, d, e, f, g, h]: [T; 8], plus: impl Fn(T, T) -> T) -> T {
    plus(plus(plus(a, b), plus(c, d)), plus(plus(e, f), plus(g, h)))
}
