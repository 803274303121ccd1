//! Resolvents of a Runge–Kutta method, for the memories for steps of any length.

use crate::real::Real;
use crate::runge_kutta::RungeKutta;

/// Number of rates processed at a time.
pub(crate) const LANES: usize = 4;

/// One number for each of these rates.
pub(crate) type Lanes<T> = [T; LANES];

/// (I + xA)⁻¹ 1 and e_Rᵀ (I + xA)⁻¹ of a stiffly accurate method, as rational functions of x.
///
/// With p(x) = det(I + xA) = Σ_k p_k x^k the adjugate is Σ_k B_k x^k, by Faddeev and LeVerrier: B₀ = I, p_k =
/// tr(A B_{k−1})/k, B_k = p_k I − A B_{k−1}.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resolvent<T, const R: usize> {
    columns: [[T; R]; R],
    rows: [[T; R]; R],
    determinant: [T; R],
    /// b
    weights: [T; R],
}

/// (I + xA)⁻¹ 1, e_Rᵀ (I + xA)⁻¹ and 1 − R(−x) for each x of a block, R the stability function.
pub(crate) struct ResolventValues<T, const R: usize> {
    pub(crate) column: [Lanes<T>; R],
    pub(crate) row: [Lanes<T>; R],
    pub(crate) decrement: Lanes<T>,
}

/// A number in two parts: for five stages and more the recursion cancels half of the digits of one.
#[derive(Clone, Copy, Default)]
struct Twofold {
    whole: f64,
    rest: f64,
}

impl Twofold {
    fn of(number: f64) -> Self {
        Self { whole: number, rest: 0.0 }
    }

    /// One part only for fewer than five stages, where nothing cancels.
    fn kept<const R: usize>(self) -> Self {
        if R < 5 { Self::of(self.whole) } else { self }
    }

    /// whole + rest, where the rest is small.
    fn joined(whole: f64, rest: f64) -> Self {
        let sum = whole + rest;
        Self { whole: sum, rest: rest - (sum - whole) }
    }

    fn plus(self, other: Self) -> Self {
        let sum = self.whole + other.whole;
        let part = sum - self.whole;
        let lost = (self.whole - (sum - part)) + (other.whole - part);
        Self::joined(sum, lost + (self.rest + other.rest))
    }

    fn times(self, factor: f64) -> Self {
        let product = self.whole * factor;
        Self::joined(product, libm::fma(self.whole, factor, -product) + self.rest * factor)
    }

    fn over(self, divisor: f64) -> Self {
        let quotient = self.whole / divisor;
        Self::joined(quotient, (libm::fma(-quotient, divisor, self.whole) + self.rest) / divisor)
    }
}

fn sum<const R: usize>(numbers: impl Iterator<Item = Twofold>) -> Twofold {
    numbers.fold(Twofold::default(), |sum, number| sum.plus(number).kept::<R>())
}

fn add_to_diagonal<const R: usize>(matrix: &mut [[Twofold; R]; R], number: Twofold) {
    for (index, row) in matrix.iter_mut().enumerate() {
        let diagonal = row.iter_mut().skip(index).take(1);
        diagonal.for_each(|entry| *entry = entry.plus(number).kept::<R>());
    }
}

impl<T: Real, const R: usize> Resolvent<T, R> {
    /// The resolvent of a method.
    pub fn new(method: &RungeKutta<R>) -> Self {
        let matrix = method.matrix();
        let (mut adjugate, mut columns) = ([[Twofold::default(); R]; R], [[T::zero(); R]; R]);
        add_to_diagonal(&mut adjugate, Twofold::of(1.0));
        let mut rows = [[T::zero(); R]; R];
        let mut determinant = [T::zero(); R];
        let places = columns.iter_mut().zip(&mut rows).zip(&mut determinant);
        for (k, ((column, row), coefficient)) in places.enumerate() {
            for (place, numbers) in column.iter_mut().zip(&adjugate) {
                *place = T::of(sum::<R>(numbers.iter().copied()).whole);
            }
            for (place, number) in row.iter_mut().zip(adjugate.last().unwrap_or(&[Twofold::default(); R])) {
                *place = T::of(number.whole);
            }
            let product = matrix.map(|row| {
                let mut sums = [Twofold::default(); R];
                for (&factor, numbers) in row.iter().zip(&adjugate) {
                    let parts = numbers.iter().map(|number| number.times(factor).kept::<R>());
                    sums.iter_mut().zip(parts).for_each(|(sum, part)| *sum = sum.plus(part).kept::<R>());
                }
                sums
            });
            let diagonal = product.iter().enumerate().filter_map(|(i, row)| row.get(i).copied());
            let p = sum::<R>(diagonal).over((k + 1) as f64).kept::<R>();
            *coefficient = T::of(p.whole);
            adjugate = product.map(|row| row.map(|number| number.times(-1.0)));
            add_to_diagonal(&mut adjugate, p);
        }
        let weights = method.quadrature().weights().map(T::of);
        Self { columns, rows, determinant, weights }
    }

    /// B_k 1 for k = 0…R−1: (I + xA)⁻¹ 1 = Σ_k B_k 1 x^k / p(x).
    pub fn columns(&self) -> &[[T; R]; R] {
        &self.columns
    }

    /// e_Rᵀ B_k for k = 0…R−1.
    pub fn rows(&self) -> &[[T; R]; R] {
        &self.rows
    }

    /// p_1 … p_R; p_0 is 1.
    pub fn determinant(&self) -> &[T; R] {
        &self.determinant
    }

    /// d_1 … d_R with 1 − R(−x) = Σ_k d_k x^k / p(x), R the stability function. For Radau IIA and Lobatto
    /// IIIC none is negative: nothing cancels.
    pub fn decrement(&self) -> [T; R] {
        let mut decrement = self.determinant;
        // R(−x) is the last of (I + xA)⁻¹ 1.
        for (difference, column) in decrement.iter_mut().zip(self.columns.iter().skip(1)) {
            *difference -= column.last().copied().unwrap_or(T::zero());
        }
        decrement
    }

    /// Leading weight of the relaxations c_j/(s + λ_j) after d = `derivatives` derivatives, for a step of
    /// length h: Σ_j c_j (I + hλ_jA)⁻¹ (hA)^{1−d}, for the `matrix` A and its inverse.
    ///
    /// With σ_k = Σ_j c_j x_j^k/p(x_j), x_j = hλ_j, the sum is Σ_k σ_k B_k, a polynomial in A.
    #[cold]
    pub fn leading(
        &self,
        [matrix, inverse]: [&[[T; R]; R]; 2],
        derivatives: usize,
        length: T,
        relaxations: impl Iterator<Item = (T, T)>,
    ) -> [[T; R]; R] {
        let (zero, one) = (T::zero(), T::one());
        let mut sums = [zero; R];
        for (rate, c) in relaxations {
            let x = length * rate;
            let (high, low) = if x <= one { (x, one) } else { (one, one / x) };
            let (mut power, mut determinant) = (one, one);
            for &p in &self.determinant {
                power *= high;
                determinant = determinant * low + p * power;
            }
            // high^k low^{R−k}; one of high and low is 1.
            let mut part = c * low / determinant;
            if x <= one {
                for sum in &mut sums {
                    *sum += part;
                    part *= high;
                }
            } else {
                for sum in sums.iter_mut().rev() {
                    *sum += part;
                    part *= low;
                }
            }
        }
        // B_k = Σ_m p_{k−m} (−A)^m, so the coefficient of (−A)^m is σ_m + Σ_{k>m} p_{k−m} σ_k.
        let mut polynomial = [[zero; R]; R];
        for m in (0..R).rev() {
            let higher = sums.iter().skip(m + 1).zip(&self.determinant);
            let coefficient = higher.fold(zero, |sum, (&sigma, &p)| sum + p * sigma);
            let coefficient = coefficient + sums.get(m).copied().unwrap_or(zero);
            polynomial = product(matrix, &polynomial).map(|row| row.map(|number| -number));
            for (index, row) in polynomial.iter_mut().enumerate() {
                row.iter_mut().skip(index).take(1).for_each(|diagonal| *diagonal += coefficient);
            }
        }
        match derivatives {
            0 => product(matrix, &polynomial).map(|row| row.map(|number| number * length)),
            1 => polynomial,
            _ => product(inverse, &polynomial).map(|row| row.map(|number| number / length)),
        }
    }

    /// In powers of x up to 1 and of 1/x beyond, so that nothing overflows. All x of the block take the same
    /// operations, which the compiler vectorises.
    #[inline(always)]
    pub(crate) fn at(&self, x: Lanes<T>) -> ResolventValues<T, R> {
        let (zero, one) = (T::zero(), T::one());
        // Polynomials are evaluated as homogeneous forms of two variables.
        let high = x.map(|x| if x <= one { x } else { one });
        let low = x.map(|x| if x <= one { one } else { one / x });
        let mut column = [[zero; LANES]; R];
        let mut row = [[zero; LANES]; R];
        let mut power = [one; LANES];
        let mut determinant = [one; LANES];
        // From the highest power of `low` downwards: sums ← sums · low + coefficient · high^k.
        let add = |sum: &mut Lanes<T>, coefficient: T, power: &Lanes<T>| {
            for ((sum, &low), &power) in sum.iter_mut().zip(&low).zip(power) {
                *sum = *sum * low + coefficient * power;
            }
        };
        let coefficients = self.columns.iter().zip(&self.rows).zip(&self.determinant);
        for ((columns, rows), &p) in coefficients {
            column.iter_mut().zip(columns).for_each(|(place, &number)| add(place, number, &power));
            row.iter_mut().zip(rows).for_each(|(place, &number)| add(place, number, &power));
            power.iter_mut().zip(&high).for_each(|(power, &high)| *power *= high);
            add(&mut determinant, p, &power);
        }
        let mut factor = low;
        factor.iter_mut().zip(&determinant).for_each(|(factor, &determinant)| *factor /= determinant);
        for numbers in column.iter_mut().chain(&mut row) {
            numbers.iter_mut().zip(&factor).for_each(|(number, &factor)| *number *= factor);
        }
        // 1 − R(−x) = x bᵀ (I + xA)⁻¹ 1 for small x, and the last component of 1 − (I + xA)⁻¹ 1 otherwise.
        let mut decrement = [zero; LANES];
        for (numbers, &b) in column.iter().zip(&self.weights) {
            decrement.iter_mut().zip(numbers).for_each(|(sum, &number)| *sum += b * number);
        }
        let last = column.last().copied().unwrap_or([zero; LANES]);
        for ((decrement, &x), &last) in decrement.iter_mut().zip(&x).zip(&last) {
            *decrement = if x <= one { x * *decrement } else { one - last };
        }
        ResolventValues { column, row, decrement }
    }
}

fn product<T: Real, const R: usize>(a: &[[T; R]; R], b: &[[T; R]; R]) -> [[T; R]; R] {
    a.map(|row| {
        let mut sum = [T::zero(); R];
        for (&factor, numbers) in row.iter().zip(b) {
            sum.iter_mut().zip(numbers).for_each(|(sum, &number)| *sum += factor * number);
        }
        sum
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linear::all_finite;
    use crate::real::max_or_nan;

    fn assert_resolvent<const R: usize>(method: &RungeKutta<R>) {
        let resolvent = Resolvent::<f64, R>::new(method);
        for x in [0.0, 1e-9, 0.3, 1.0, 1.1, 40.0, 1e12] {
            let ResolventValues { column, row, decrement } = resolvent.at([x; LANES]);
            let (column, row, decrement) = (column.map(|x| x[0]), row.map(|x| x[3]), decrement[1]);
            // (I + xA) g = 1 and (I + xA)ᵀ u = e_R.
            let most = column.iter().chain(&row).fold(0.0, |most, number| max_or_nan(most, number.abs()));
            let allowed = 1e-14 * (1.0 + x * most);
            for i in 0..R {
                let mut of_column = column[i] - 1.0;
                let mut of_row = row[i] - f64::from(u8::from(i == R - 1));
                for j in 0..R {
                    of_column += x * method.matrix()[i][j] * column[j];
                    of_row += x * method.matrix()[j][i] * row[j];
                }
                assert!(of_column.abs() < allowed && of_row.abs() < allowed, "{R} stages, x = {x}");
            }
            assert!((decrement - (1.0 - column[R - 1])).abs() < 1e-15);
            let p = |numbers: &[f64; R]| numbers.iter().rev().fold(0.0, |sum, number| (sum + number) * x);
            let by_polynomials = p(&resolvent.decrement()) / (1.0 + p(resolvent.determinant()));
            assert!((by_polynomials - decrement).abs() <= 1e-15 * decrement, "{by_polynomials} {decrement}");
            assert!(resolvent.decrement().iter().all(|&number| number >= 0.0));
            if x == 1e-9 {
                assert!((decrement / x - 1.0).abs() < 2.0 * x, "{decrement:e}");
            }
        }
        // Each x of a block is evaluated in its own range.
        let at = resolvent.at([f64::INFINITY, 1e-9, 0.3, 40.0]);
        assert!(at.column.iter().all(|numbers| all_finite(numbers)) && at.decrement[0] == 1.0);
        assert_eq!(at.decrement[1..], [1e-9, 0.3, 40.0].map(|x| resolvent.at([x; LANES]).decrement[2]));
    }

    /// Σ_j c_j (I + hλ_jA)⁻¹ (hA)^{1−d}, solved column by column, from resolvents of one rate.
    fn assert_leading<const R: usize>(method: &RungeKutta<R>) {
        let resolvent = Resolvent::<f64, R>::new(method);
        let (matrix, inverse) = (*method.matrix(), method.inverse().unwrap());
        let relaxations = [(0.0, 0.5), (1e-9, 2.0), (0.7, 1.5), (3.0, 1.0), (40.0, 7.0), (1e12, 1e13)];
        for length in [1e-3, 1.0, 25.0] {
            let worth = |derivatives| {
                resolvent.leading([&matrix, &inverse], derivatives, length, relaxations.into_iter())
            };
            // Each relaxation by itself: (I + xA) L = c I.
            for (rate, c) in relaxations {
                let one = resolvent.leading([&matrix, &inverse], 1, length, [(rate, c)].into_iter());
                let scaled = product(&matrix, &one);
                for i in 0..R {
                    for j in 0..R {
                        let left = one[i][j] + length * rate * scaled[i][j];
                        let right = if i == j { c } else { 0.0 };
                        assert!((left - right).abs() < 1e-12 * c, "{R} stages, x = {}", length * rate);
                    }
                }
            }
            let size = |numbers: &[[f64; R]; R]| {
                numbers.as_flattened().iter().map(|b| b.abs()).fold(0.0, max_or_nan)
            };
            let mut sum = [[0.0; R]; R];
            for relaxation in relaxations {
                let one = resolvent.leading([&matrix, &inverse], 1, length, [relaxation].into_iter());
                sum.as_flattened_mut().iter_mut().zip(one.as_flattened()).for_each(|(sum, one)| *sum += one);
            }
            let zeroth = product(&matrix, &sum).map(|row| row.map(|number| number * length));
            let second = product(&inverse, &sum).map(|row| row.map(|number| number / length));
            for (found, expected) in [(worth(1), sum), (worth(0), zeroth), (worth(2), second)] {
                for (found, known) in found.as_flattened().iter().zip(expected.as_flattened()) {
                    assert!((found - known).abs() < 1e-13 * size(&expected), "{R} stages, h = {length}");
                }
            }
        }
    }

    #[test]
    fn what_relaxations_are_worth_within_a_step_solves_its_equations() {
        assert_leading(&RungeKutta::<1>::radau_iia().unwrap());
        assert_leading(&RungeKutta::<3>::radau_iia().unwrap());
        assert_leading(&RungeKutta::<4>::lobatto_iiic().unwrap());
    }

    #[test]
    fn resolvents_solve_their_equations() {
        assert_resolvent(&RungeKutta::<1>::radau_iia().unwrap());
        assert_resolvent(&RungeKutta::<2>::radau_iia().unwrap());
        assert_resolvent(&RungeKutta::<3>::radau_iia().unwrap());
        assert_resolvent(&RungeKutta::<5>::radau_iia().unwrap());
        assert_resolvent(&RungeKutta::<7>::radau_iia().unwrap());
        assert_resolvent(&RungeKutta::<2>::lobatto_iiic().unwrap());
        assert_resolvent(&RungeKutta::<3>::lobatto_iiic().unwrap());
        assert_resolvent(&RungeKutta::<4>::lobatto_iiic().unwrap());
    }
}
