//! The equations of one step: their matrix, and Newton's method converged to rounding.

use crate::linear::{Singular, fold, keep_factors, solve, substitute, substitute_kept, subtract_and_fold};
use crate::real::Real;
use crate::scheme::StepError;
use crate::space::Block;

/// Largest number of corrections. A well-posed step needs three to five.
const MAX_ITERATIONS: u32 = 50;

/// Largest relative size of a correction from which the convergence rate is estimated.
const NEAR: f64 = 1.0 / 64.0;

/// How many corrections in a row that do not shrink are no rounding yet.
const STALLS: u32 = 6;

/// Largest ratio of successive corrections at which expensive factors are reused.
const SHRINKING: f64 = 0.125;

/// The matrix of a step's linear equations: S×S blocks of N×N numbers, put together term by term.
///
/// fvi-core has a dense implementation in place; a host adds others, sparse ones included.
pub trait Equations<T: Real, B: Block<T>> {
    /// Factors that solve the equations of every step while the matrix stays the same.
    type Factor;

    /// Sets all entries to zero.
    fn clear(&mut self);

    /// Adds factor · `block` to the block in the given row and column.
    fn add(&mut self, row: usize, column: usize, factor: T, block: &B);

    /// Replaces `vector` by the solution. The matrix may be overwritten.
    ///
    /// # Errors
    /// [`Singular`].
    fn solve(&mut self, vector: &mut [T]) -> Result<(), Singular>;

    /// True if [`solve`](Equations::solve) has left factors for [`solve_again`](Equations::solve_again).
    #[inline(always)]
    fn has_factors(&self) -> bool {
        false
    }

    /// True if factorisation is so much more expensive than a solution that the factors of the first
    /// correction are reused as long as corrections shrink fast enough.
    #[inline(always)]
    fn spares_factors(&self) -> bool {
        false
    }

    /// Replaces `vector` by the solution with the matrix that was solved last, if its factors were kept.
    #[inline(always)]
    fn solve_again(&mut self, _vector: &mut [T]) {}

    /// Prepares solutions with this matrix. `inertia` is (factor, M): the diagonal blocks contain factor · M
    /// of the mass M. The matrix may be overwritten.
    ///
    /// # Errors
    /// [`Singular`].
    fn keep(&mut self, kept: &mut Self::Factor, inertia: (T, &B)) -> Result<(), Singular>;

    /// Replaces `vector` by the solution, with what [`keep`](Equations::keep) prepared.
    fn solve_kept(&mut self, kept: &Self::Factor, vector: &mut [T]);

    /// True if one correction by [`solve_kept`](Equations::solve_kept) suffices: the prepared solution is
    /// exact for a matrix that differs from this one only by a symmetric change of the mass of rounding size.
    #[inline(always)]
    fn is_solved_at_once(&self, _kept: &Self::Factor) -> bool {
        false
    }

    /// True if the residual left by [`solve_kept`](Equations::solve_kept), with these increments on this
    /// position, needs another correction. Negligible parts of it may be set to zero.
    ///
    /// Rounding errors in factors are the same at every step. Where they are not symmetric, energy grows or
    /// decays, so the default is true.
    #[inline(always)]
    fn is_unsettled(
        &self,
        _kept: &Self::Factor,
        _increments: &[T],
        _position: &[T],
        _residual: &mut [T],
    ) -> bool {
        true
    }
}

/// Dense [`Equations`] for N coordinates and S nodes, in place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StepMatrix<T, const N: usize, const S: usize> {
    entries: Square<T, N, S>,
    pivots: [[usize; N]; S],
}

/// (S N)×(S N) numbers, row by row.
type Square<T, const N: usize, const S: usize> = [[[[T; N]; S]; N]; S];

/// The factors of the matrix of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factors<T, const N: usize, const S: usize> {
    /// Column by column.
    entries: Square<T, N, S>,
    /// In 16 bits: a microcontroller stores them.
    pivots: [[u16; N]; S],
}

impl<T: Real, const N: usize, const S: usize> Factors<T, N, S> {
    /// No factors yet.
    #[inline(always)]
    pub fn zero() -> Self {
        Self { entries: [[[[T::zero(); N]; S]; N]; S], pivots: [[0; N]; S] }
    }
}

impl<T: Real, const N: usize, const S: usize> StepMatrix<T, N, S> {
    /// The zero matrix.
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        Self { entries: [[[[T::zero(); N]; S]; N]; S], pivots: [[0; N]; S] }
    }

    #[inline(always)]
    fn entries(&mut self) -> &mut [T] {
        self.entries.as_flattened_mut().as_flattened_mut().as_flattened_mut()
    }
}

impl<T: Real, const N: usize, const S: usize, B: Block<T>> Equations<T, B> for StepMatrix<T, N, S> {
    type Factor = Factors<T, N, S>;

    #[inline(always)]
    fn clear(&mut self) {
        self.entries().fill(T::zero());
    }

    #[inline(always)]
    fn add(&mut self, row: usize, column: usize, factor: T, block: &B) {
        block.add_to(factor, self.entries(), N * S, row * N, column * N);
    }

    #[inline(always)]
    fn solve(&mut self, vector: &mut [T]) -> Result<(), Singular> {
        let entries = self.entries.as_flattened_mut().as_flattened_mut().as_flattened_mut();
        solve(entries, self.pivots.as_flattened_mut(), vector)
    }

    #[inline(always)]
    fn has_factors(&self) -> bool {
        true
    }

    #[inline(always)]
    fn solve_again(&mut self, vector: &mut [T]) {
        let factors = self.entries.as_flattened().as_flattened().as_flattened();
        substitute(factors, self.pivots.as_flattened(), vector);
    }

    #[inline(always)]
    fn keep(&mut self, kept: &mut Factors<T, N, S>, _: (T, &B)) -> Result<(), Singular> {
        let entries = self.entries.as_flattened_mut().as_flattened_mut().as_flattened_mut();
        let factors = kept.entries.as_flattened_mut().as_flattened_mut().as_flattened_mut();
        let pivots = self.pivots.as_flattened_mut();
        keep_factors(entries, pivots, factors)?;
        for (kept, &pivot) in kept.pivots.as_flattened_mut().iter_mut().zip(&*pivots) {
            *kept = u16::try_from(pivot).map_err(|_| Singular)?;
        }
        Ok(())
    }

    #[inline(always)]
    fn solve_kept(&mut self, kept: &Factors<T, N, S>, vector: &mut [T]) {
        let factors = kept.entries.as_flattened().as_flattened().as_flattened();
        substitute_kept(factors, kept.pivots.as_flattened(), vector);
    }
}

/// Largest absolute value; not a number if one is not finite.
#[inline(always)]
pub(crate) fn size<T: Real>(numbers: &[T]) -> T {
    fold(numbers, T::zero(), max_or_nan)
}

/// The larger of a size and the size of a number; not a number if that is not finite.
#[expect(clippy::eq_op, reason = "x − x tells a finite number from others")]
#[inline(always)]
fn max_or_nan<T: Real>(largest: T, number: T) -> T {
    let size = number.abs();
    // x − x is not a number if x is not finite, nor is a sum with it.
    (if size > largest { size } else { largest }) + (number - number)
}

/// Result of Newton's method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Converged<T> {
    /// Corrections made.
    pub(crate) iterations: u32,
    /// Estimate of the residual at the end without rounding; `None` without one.
    pub(crate) residual: Option<T>,
    /// True if only stiffened equations led there ([`Stiffening`]), which may leave a residual: velocities
    /// are then known to rounding only, which decides forces with slopes that are nearly infinite. What these
    /// are is what the equations need.
    pub(crate) leaves_residual: bool,
}

/// Newton's method apart from its equations: which corrections reuse the factors of the previous one, and
/// when the iteration ends.
///
/// Corrections are Newton's; after each small one follows one with the same factors, which needs a
/// residual only: two such corrections together converge to third order (\[Kelley95\] §5.4.3). The iteration
/// ends when a correction is no larger than the rounding of numbers of size `offset` + |x| (the unknowns x
/// are increments on something of size `offset`), or when the next one would be: corrections shrink by a
/// factor that falls from each to the next, and at most doubles where the factors are those of the one
/// before. It also ends, once corrections are below the square root of that rounding, when they stop
/// shrinking because rounding in the residual makes them: if one with reused factors was much smaller than
/// the one before it. If none was, the factors may be wrong, or Newton's corrections may go round in a cycle,
/// as they do for forces that change much within a step's small increments. So further corrections have
/// factors of their own, and half of one that does not shrink is taken back; if that happens more than
/// [`STALLS`] times below that square root, rounding it is. Near the smallest normal number rounding no
/// longer shrinks with the numbers, so neither does the bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Corrections<T> {
    offset: T,
    count: u32,
    previous: Option<T>,
    again: bool,
    sparing: bool,
    /// True if a correction with the factors of the one before it was much smaller, so that the slope hardly
    /// changes.
    proven: bool,
    /// True if reused factors were no good, so that each correction has its own.
    fresh: bool,
    /// How often a correction with its own factors was no smaller than the one before it.
    stalls: u32,
}

/// What follows a correction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Verdict<T> {
    /// The iteration has ended.
    Converged(Converged<T>),
    /// A further correction.
    Continue,
    /// A further correction after half of this one has been taken back.
    Halve,
}

impl<T: Real> Corrections<T> {
    /// No correction made yet.
    #[inline(always)]
    pub(crate) fn new(offset: T) -> Self {
        Self {
            offset,
            count: 0,
            previous: None,
            again: false,
            sparing: false,
            proven: false,
            fresh: false,
            stalls: 0,
        }
    }

    /// The same, where each factor is reused as long as corrections with it shrink by [`SHRINKING`].
    #[inline(always)]
    fn sparing(self, sparing: bool) -> Self {
        Self { sparing, ..self }
    }

    /// True if the next correction reuses the factors of the last one.
    #[inline(always)]
    pub(crate) fn takes_factors_again(&self) -> bool {
        self.again
    }

    /// Evaluates a correction from the size of its residual, its own size, and that of the unknowns after it.
    /// `keeps_factors`: another correction could reuse its factors.
    ///
    /// # Errors
    /// [`StepError::NotFinite`] or [`StepError::NotConverged`].
    #[inline(always)]
    pub(crate) fn judge(
        &mut self,
        residual: T,
        (change, extent): (T, T),
        keeps_factors: bool,
    ) -> Result<Verdict<T>, StepError> {
        if !change.is_finite() {
            return Err(StepError::NotFinite);
        }
        self.count += 1;
        let (previous, again) = (self.previous, self.again);
        let scale = self.offset + extent + T::SMALLEST_NORMAL / T::EPSILON;
        // Far from the solution corrections shrink by chance.
        let near = T::of(NEAR) * scale;
        let ratio = previous.map(|previous| change / previous.min(near));
        // Upper bound of the ratio of the next correction to this one.
        let shrinkage = ratio.map(|ratio| if again { ratio + ratio } else { ratio });
        let resolved = change <= T::of(2.0) * T::EPSILON * scale;
        let settled = shrinkage.is_some_and(|factor| factor * change <= T::of(0.125) * T::EPSILON * scale);
        let is_small = change <= T::EPSILON.sqrt() * scale;
        let stalled = is_small && previous.is_some_and(|previous| change >= previous);
        let is_rounding = stalled && (self.proven || self.stalls == STALLS);
        self.proven |= again && previous.is_some_and(|previous| change <= T::of(SHRINKING) * previous);
        if resolved || settled || is_rounding {
            // The residual after a Newton correction is quadratic in it, as this residual was in the previous
            // one; after a correction with reused factors it is smaller by the shrinkage.
            let left = shrinkage.map(|factor| if again { factor } else { factor * factor });
            return Ok(Verdict::Converged(Converged {
                iterations: self.count,
                residual: left.map(|left| residual * left),
                leaves_residual: false,
            }));
        }
        if self.count == MAX_ITERATIONS {
            let residual = residual.to_f64();
            return Err(StepError::NotConverged { iterations: MAX_ITERATIONS, residual });
        }
        self.previous = Some(change);
        let shrinks = |by: f64| previous.is_none_or(|previous| change < T::of(by) * previous);
        if self.fresh && !shrinks(1.0) {
            self.stalls += u32::from(is_small);
            return Ok(Verdict::Halve);
        }
        self.fresh |= stalled || again && !shrinks(0.5);
        self.again = keeps_factors
            && !self.fresh
            && match self.sparing {
                true => previous.is_none_or(|previous| change <= T::of(SHRINKING) * previous),
                false => !again && change <= near,
            };
        Ok(Verdict::Continue)
    }
}

/// How the derivatives of forces with respect to velocities enter the matrix of a stiffened correction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stiffened<T> {
    /// λ, by which they are multiplied.
    pub(crate) factor: T,
    /// How far from the velocities they are taken, in units of the unknowns: no further than rounding.
    pub(crate) aside: T,
}

impl<T: Real> Stiffened<T> {
    /// Moves velocities aside, each by something else, so that no difference of two of them stays zero.
    pub(crate) fn move_aside(velocity: &mut [T], by: T) {
        let mut share = T::of(0.5);
        for velocity in velocity {
            *velocity += share * by;
            share += T::of(0.618_033_988_749_895);
            share = if share > T::of(1.5) { share - T::one() } else { share };
        }
    }
}

/// How a second attempt solves equations whose forces resist velocities with slopes that fall as these grow,
/// as c sign(v)|v|^γ with γ < 1 does, where Newton's corrections go round in a cycle across v = 0.
///
/// The slope ∂F/∂v is multiplied by λ ≥ 1. With λ = 1/γ it is the secant c|v|^γ/|v|, with which every
/// correction lowers the convex potential of the step ∫ r·dx whatever the start, since the secant's parabola
/// lies above |v|^{1+γ} everywhere (majorisation, as in iteratively reweighted least squares). λ doubles
/// whenever the residual does not fall, and otherwise falls slowly towards 1, Newton's method. The first
/// correction has λ = 0: its size is that of the motion without resistance, beside which slopes are taken no
/// nearer to v = 0 than rounding, so that they are finite and hide no mass. The iteration ends when a
/// correction is no larger than that, and the residual is rounding or no longer falls. If only the latter,
/// the velocity is 0 as far as numbers tell it, and the force whatever the equations need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stiffening<T> {
    pub(crate) slopes: Stiffened<T>,
    before: T,
    /// The largest residual, against which rounding is judged.
    largest: T,
    /// The smallest residual that halved the one before it, and the corrections since.
    best: T,
    since: u32,
    widened: u32,
    pub(crate) count: u32,
}

/// How far aside slopes are taken, in units of rounding, and how often sixteen times as far.
pub(crate) const ASIDE: f64 = 256.0;
const MOST_WIDENED: u32 = 3;

/// Largest λ, for powers down to γ = 1/64.
const STIFFEST: f64 = 64.0;

/// After how many corrections a residual that has not halved is one of rounding.
const NO_LONGER_FALLS: u32 = 300;

/// How many corrections then bring velocities to rest, and after how many of them one is Newton's.
const SHRINKS: u32 = 8 * TURN;
const TURN: u32 = 60;

impl<T: Real> Stiffening<T> {
    /// No correction made yet.
    #[inline(always)]
    pub(crate) fn new() -> Self {
        let slopes = Stiffened { factor: T::zero(), aside: T::SMALLEST_NORMAL.sqrt() };
        let none = T::zero();
        Self { slopes, before: none, largest: none, best: none, since: 0, widened: 0, count: 0 }
    }

    /// Judges a correction from its residual, its size, the rounding of the unknowns, and their size after
    /// it: true if it was the last one. Chooses λ for the next one.
    ///
    /// # Errors
    /// [`StepError::NotConverged`] after too many corrections.
    #[inline(always)]
    pub(crate) fn judge(
        &mut self,
        residual: T,
        change: T,
        (rounding, extent): (T, T),
    ) -> Result<bool, StepError> {
        let Stiffened { factor, aside } = &mut self.slopes;
        if self.count == 0 {
            *factor = T::of(2.0);
            *aside = (*aside).max(T::of(ASIDE) * T::EPSILON * extent);
            (self.before, self.best) = (residual, residual);
        } else {
            let grows = residual >= T::of(0.999) * self.before;
            let by = if grows { T::of(2.0) } else { T::of(0.95) };
            *factor = (*factor * by).max(T::one()).min(T::of(STIFFEST));
            if self.since > NO_LONGER_FALLS {
                // What is held goes round v = 0 in a cycle, which stiff corrections shrink; a correction of
                // Newton's now and then brings all else to its place.
                let turn = (self.since - NO_LONGER_FALLS).is_multiple_of(TURN);
                *factor = if turn { T::one() } else { T::of(STIFFEST) };
            }
        }
        let resolved = (*aside + *aside).max(T::of(ASIDE) * rounding);
        self.count += 1;
        (self.before, self.largest) = (residual, self.largest.max(residual));
        (self.best, self.since) =
            if residual < T::of(0.5) * self.best { (residual, 0) } else { (self.best, self.since + 1) };
        let is_balanced = residual <= T::of(16.0) * T::EPSILON * self.largest;
        let rests = self.since > NO_LONGER_FALLS;
        if (is_balanced || rests) && change <= resolved {
            return Ok(true);
        }
        if self.since > NO_LONGER_FALLS + SHRINKS && !self.widen() {
            return Err(StepError::NotConverged { iterations: self.count, residual: residual.to_f64() });
        }
        Ok(false)
    }

    /// Takes slopes farther aside; false if they are too far already.
    #[inline(always)]
    pub(crate) fn widen(&mut self) -> bool {
        (self.since, self.widened) = (0, self.widened + 1);
        self.slopes.aside *= T::of(16.0);
        self.widened <= MOST_WIDENED && self.count > 0
    }
}

/// A slope is steep where h |∂F/∂v| is this many times the mass.
const STEEP: f64 = 1e4;

/// True if a slope ∂F/∂v is so steep beside the mass, for a step of this length, that a correction of
/// rounding size may change a force as a whole, as that of c sign(v)|v|^γ on the way out of v = 0.
#[inline(always)]
pub(crate) fn is_steep<T: Real>(length: T, [slopes, mass]: [&[T]; 2]) -> bool {
    let size = |numbers: &[T]| numbers.iter().fold(T::zero(), |most, x| max_or_nan(most, x.abs()));
    length * size(slopes) > T::of(STEEP) * size(mass)
}

/// True if a force with such a slope is not in balance although corrections are small. At a solution the
/// residual is far below |∂F/∂v| |v|, with the slope at this velocity.
///
/// Residual and velocities are stage by stage, the slopes row by row of each stage.
#[inline(always)]
pub(crate) fn is_unbalanced<T: Real>(
    coordinates: usize,
    residual: &[T],
    length: T,
    [slopes, mass]: [&[T]; 2],
    velocities: &[T],
) -> bool {
    let n = coordinates.max(1);
    let heaviest = mass.iter().fold(T::zero(), |most, m| max_or_nan(most, m.abs()));
    (0..n).any(|row| {
        let (mut steepest, mut told) = (T::zero(), T::zero());
        for (slopes, velocity) in slopes.chunks_exact(n.saturating_mul(n)).zip(velocities.chunks_exact(n)) {
            let mut sum = T::zero();
            for (&slope, &v) in slopes.iter().skip(row * n).zip(velocity) {
                steepest = max_or_nan(steepest, slope.abs());
                sum += (slope * v).abs();
            }
            told = max_or_nan(told, sum);
        }
        let off = residual.iter().skip(row).step_by(n).fold(T::zero(), |most, r| max_or_nan(most, r.abs()));
        length * steepest > T::of(STEEP) * heaviest && off > T::of(3.0) * length * told
    })
}

/// The matrix of a correction, and how slopes enter it if it is stiffened.
pub(crate) type Linearised<'a, E, T> = (&'a mut E, Option<Stiffened<T>>);

/// Solves residual(x) = 0 from the guess `unknowns`, and leaves the last correction in `correction`, by the
/// iteration of [`Corrections`]; where that does not converge and forces depend on the velocity (`moves`), by
/// that of [`Stiffening`].
///
/// `balance` writes the residual at x, and its Jacobian if it gets a matrix, stiffened if it is told so.
///
/// # Errors
/// [`StepError::NotFinite`], [`StepError::SingularJacobian`] or [`StepError::NotConverged`].
#[inline(always)]
pub(crate) fn newton<T: Real, B: Block<T>, E: Equations<T, B>>(
    unknowns: &mut [T],
    correction: &mut [T],
    (offset, moves): (T, bool),
    matrix: &mut E,
    mut balance: impl FnMut(&[T], &mut [T], Option<Linearised<'_, E, T>>),
) -> Result<Converged<T>, StepError> {
    let mut corrections = Corrections::new(offset).sparing(matrix.spares_factors());
    let failure = loop {
        let again = corrections.takes_factors_again();
        balance(unknowns, correction, if again { None } else { Some((&mut *matrix, None)) });
        let residual = size(correction);
        if !residual.is_finite() {
            return Err(StepError::NotFinite);
        }
        if again {
            matrix.solve_again(correction);
        } else {
            matrix.solve(correction).map_err(|_| StepError::SingularJacobian)?;
        }
        let sizes = subtract_and_fold(unknowns, correction, max_or_nan);
        match corrections.judge(residual, sizes, matrix.has_factors()) {
            Ok(Verdict::Converged(converged)) => return Ok(converged),
            Ok(Verdict::Continue) => {}
            Ok(Verdict::Halve) => {
                let half = T::of(0.5);
                unknowns.iter_mut().zip(&*correction).for_each(|(x, &change)| *x += half * change);
            }
            Err(failure) => break failure,
        }
    };
    if !moves || failure == StepError::NotFinite {
        return Err(failure);
    }
    unknowns.fill(T::zero());
    let mut stiffening = Stiffening::new();
    loop {
        balance(unknowns, correction, Some((&mut *matrix, Some(stiffening.slopes))));
        let residual = size(correction);
        if !residual.is_finite() {
            return Err(StepError::NotFinite);
        }
        if matrix.solve(correction).is_err() {
            if stiffening.widen() {
                continue;
            }
            return Err(StepError::SingularJacobian);
        }
        let (change, extent) = subtract_and_fold(unknowns, correction, max_or_nan);
        if !change.is_finite() {
            return Err(StepError::NotFinite);
        }
        let rounding = T::EPSILON * (offset + extent) + T::SMALLEST_NORMAL;
        if stiffening.judge(residual, change, (rounding, extent))? {
            let iterations = MAX_ITERATIONS + stiffening.count;
            return Ok(Converged { iterations, residual: None, leaves_residual: true });
        }
    }
}

/// Largest number of residuals in [`damped_newton`].
const MOST_RESIDUALS: u32 = 400;

/// Solves residual(x) = 0 from x = 0 where [`newton`] failed: Newton's corrections, of which a quarter, a
/// sixteenth … is taken until the residual is a number and smaller than before.
///
/// So it follows √x = r down from a guess that is far too large, where a whole correction leads to x < 0.
/// `correction` is left as by `newton`; `kept` has room for a correction, and without it `failure` is all.
/// Source: \[Kelley95\] §8.1.
///
/// # Errors
/// `failure`, that of `newton`.
#[cold]
pub(crate) fn damped_newton<T: Real, B: Block<T>, E: Equations<T, B>>(
    unknowns: &mut [T],
    [correction, kept]: [&mut [T]; 2],
    (offset, failure): (T, StepError),
    matrix: &mut E,
    mut balance: impl FnMut(&[T], &mut [T], Option<Linearised<'_, E, T>>),
) -> Result<Converged<T>, StepError> {
    let mut corrections = Corrections::new(offset);
    let mut count = 0;
    unknowns.fill(T::zero());
    while kept.len() == unknowns.len() {
        balance(unknowns, correction, Some((&mut *matrix, None)));
        let residual = size(correction);
        if !residual.is_finite() || matrix.solve(correction).is_err() {
            break;
        }
        kept.iter_mut().zip(&*correction).for_each(|(kept, &change)| *kept = change);
        let (change, extent) = subtract_and_fold(unknowns, kept, max_or_nan);
        if !change.is_finite() {
            break;
        }
        if let Ok(Verdict::Converged(converged)) = corrections.judge(residual, (change, extent), false) {
            return Ok(Converged { iterations: MAX_ITERATIONS + converged.iterations, ..converged });
        }
        // Among rounding errors residuals no longer fall.
        let is_small = change <= T::EPSILON.sqrt() * (offset + extent);
        loop {
            count += 1;
            balance(unknowns, correction, None);
            let next = size(correction);
            if next < residual || is_small && next.is_finite() {
                break;
            }
            if count > MOST_RESIDUALS {
                return Err(failure);
            }
            for (x, kept) in unknowns.iter_mut().zip(&mut *kept) {
                // From 0 without rounding, however small the part is.
                *x += *kept;
                *kept *= T::of(0.25);
                *x -= *kept;
            }
        }
        if count > MOST_RESIDUALS {
            break;
        }
    }
    Err(failure)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coefficients::Coefficients;
    use core::cell::Cell;

    fn scalar(guess: f64, f: impl Fn(f64) -> (f64, f64)) -> Result<(f64, u32), StepError> {
        let mut unknown = [guess];
        let mut matrix = StepMatrix::<f64, 1, 1>::zero();
        let balance =
            |x: &[f64], residual: &mut [f64], matrix: Option<Linearised<'_, StepMatrix<f64, 1, 1>, f64>>| {
                let (value, slope) = f(x[0]);
                residual[0] = value;
                if let Some((matrix, _)) = matrix {
                    Equations::<f64, Coefficients<f64, 1>>::clear(matrix);
                    matrix.add(0, 0, slope, &Coefficients::Diagonal([1.0].into()));
                }
            };
        let converged = newton::<_, Coefficients<f64, 1>, _>(
            &mut unknown,
            &mut [0.0],
            (0.0, false),
            &mut matrix,
            balance,
        )?;
        Ok((unknown[0], converged.iterations))
    }

    #[test]
    fn a_root_is_found_to_the_last_digit() {
        let (root, iterations) = scalar(1.0, |x| (x * x - 2.0, 2.0 * x)).unwrap();
        assert!((root - 2f64.sqrt()).abs() <= f64::EPSILON);
        assert!(iterations <= 6, "{iterations}");
    }

    #[test]
    fn a_force_with_an_infinite_slope_at_rest_is_balanced_as_far_as_rounding_allows() {
        // x + c sign(x)|x|^γ = r from afar, for roots down to 1e-100, where Newton's method goes round.
        for power in [0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9] {
            for root in [-3.0, 1.0, 1e-3, -1e-9, 1e-40, 1e-100] {
                for c in [1e-3, 1.0, 1e3] {
                    let force = |x: f64| x + c * x.signum() * x.abs().powf(power);
                    let right = force(root);
                    let mut unknown = [7.0];
                    let mut matrix = StepMatrix::<f64, 1, 1>::zero();
                    let balance =
                        |x: &[f64],
                         residual: &mut [f64],
                         matrix: Option<Linearised<'_, StepMatrix<f64, 1, 1>, f64>>| {
                            residual[0] = if x[0] == 0.0 { -right } else { force(x[0]) - right };
                            if let Some((matrix, stiffened)) = matrix {
                                let (factor, aside) = stiffened
                                    .map_or((1.0, 0.0), |slopes| (slopes.factor, 0.5 * slopes.aside));
                                let place = x[0] + aside;
                                let slope = if place == 0.0 {
                                    0.0
                                } else {
                                    power * c * place.abs().powf(power - 1.0)
                                };
                                Equations::<f64, Coefficients<f64, 1>>::clear(matrix);
                                matrix.add(0, 0, 1.0 + factor * slope, &Coefficients::Diagonal([1.0].into()));
                            }
                        };
                    let converged = newton::<_, Coefficients<f64, 1>, _>(
                        &mut unknown,
                        &mut [0.0],
                        (1.0, true),
                        &mut matrix,
                        balance,
                    );
                    let error = (force(unknown[0]) - right).abs();
                    // Newton's method ends where x is known beside the offset 1.
                    let bound = 2.0 * c * 1e-12_f64.powf(power);
                    let ended = converged.is_ok() && error <= bound;
                    assert!(ended, "{c} |x|^{power}, root {root:e}: {converged:?}, {error:e}");
                }
            }
        }
    }

    #[test]
    fn a_root_where_the_slope_at_the_start_is_infinite_is_found_from_far_above() {
        // x/h + √x = r with r² far below h r, where √x is not defined below 0, or continued by 0.
        for (h, r) in [(1e-3, 1e-6), (1e-12, 1e-18), (1e-12, 1e-40), (1e-6, 1e-150)] {
            for below in [f64::NAN, 0.0] {
                let root = |x: f64| if x < 0.0 { below } else { libm::sqrt(x) };
                let mut matrix = StepMatrix::<f64, 1, 1>::zero();
                let mut balance =
                    |x: &[f64],
                     residual: &mut [f64],
                     matrix: Option<Linearised<'_, StepMatrix<f64, 1, 1>, f64>>| {
                        residual[0] = x[0] / h + root(x[0]) - r;
                        if let Some((matrix, _)) = matrix {
                            let slope = if x[0] > 0.0 { 0.5 / libm::sqrt(x[0]) } else { 0.0 };
                            Equations::<f64, Coefficients<f64, 1>>::clear(matrix);
                            matrix.add(0, 0, 1.0 / h + slope, &Coefficients::Diagonal([1.0].into()));
                        }
                    };
                let (mut unknown, mut correction) = ([0.0], [0.0]);
                let whole = newton::<_, Coefficients<f64, 1>, _>(
                    &mut unknown,
                    &mut correction,
                    (0.0, false),
                    &mut matrix,
                    &mut balance,
                );
                let failure = whole.expect_err("whole corrections lead below 0");
                damped_newton::<_, Coefficients<f64, 1>, _>(
                    &mut unknown,
                    [&mut correction, &mut [0.0]],
                    (0.0, failure),
                    &mut matrix,
                    balance,
                )
                .unwrap();
                let error = (unknown[0] / h + libm::sqrt(unknown[0]) - r).abs();
                assert!(error <= 4.0 * f64::EPSILON * r, "{h:e}, {r:e}: {unknown:?}, {error:e}");
            }
        }
    }

    #[test]
    fn factors_of_a_small_correction_serve_the_next_one() {
        let slopes = Cell::new(0);
        let mut matrix = StepMatrix::<f64, 1, 1>::zero();
        let balance =
            |x: &[f64], residual: &mut [f64], matrix: Option<Linearised<'_, StepMatrix<f64, 1, 1>, f64>>| {
                residual[0] = x[0] * x[0] - 2.0;
                if let Some((matrix, _)) = matrix {
                    slopes.set(slopes.get() + 1);
                    Equations::<f64, Coefficients<f64, 1>>::clear(matrix);
                    matrix.add(0, 0, 2.0 * x[0], &Coefficients::Diagonal([1.0].into()));
                }
            };
        let (mut unknown, mut correction) = ([2f64.sqrt() + 1e-6], [0.0]);
        let converged = newton::<_, Coefficients<f64, 1>, _>(
            &mut unknown,
            &mut correction,
            (0.0, false),
            &mut matrix,
            balance,
        );
        assert_eq!(converged.map(|converged| converged.iterations), Ok(2));
        assert!((unknown[0] - 2f64.sqrt()).abs() <= f64::EPSILON && slopes.get() == 1, "{unknown:?}");
    }

    /// [`StepMatrix`] with factors that are to be reused.
    struct Dear(StepMatrix<f64, 1, 1>, bool);

    impl Equations<f64, Coefficients<f64, 1>> for Dear {
        type Factor = Factors<f64, 1, 1>;
        fn clear(&mut self) {
            Equations::<f64, Coefficients<f64, 1>>::clear(&mut self.0);
        }
        fn add(&mut self, row: usize, column: usize, factor: f64, block: &Coefficients<f64, 1>) {
            self.0.add(row, column, factor, block);
        }
        fn solve(&mut self, vector: &mut [f64]) -> Result<(), Singular> {
            Equations::<f64, Coefficients<f64, 1>>::solve(&mut self.0, vector)
        }
        fn has_factors(&self) -> bool {
            Equations::<f64, Coefficients<f64, 1>>::has_factors(&self.0)
        }
        fn spares_factors(&self) -> bool {
            self.1
        }
        fn solve_again(&mut self, vector: &mut [f64]) {
            Equations::<f64, Coefficients<f64, 1>>::solve_again(&mut self.0, vector);
        }
        fn keep(
            &mut self,
            kept: &mut Self::Factor,
            inertia: (f64, &Coefficients<f64, 1>),
        ) -> Result<(), Singular> {
            self.0.keep(kept, inertia)
        }
        fn solve_kept(&mut self, kept: &Self::Factor, vector: &mut [f64]) {
            Equations::<f64, Coefficients<f64, 1>>::solve_kept(&mut self.0, kept, vector);
        }
    }

    #[test]
    fn dear_factors_serve_while_corrections_shrink() {
        // x + c x³ = 1 from 0.9: one factor where the slope hardly changes, another one where it does.
        let solve = |c: f64, sparing: bool| {
            let slopes = Cell::new(0);
            let balance = |x: &[f64], residual: &mut [f64], matrix: Option<Linearised<'_, Dear, f64>>| {
                residual[0] = x[0] + c * x[0] * x[0] * x[0] - 1.0;
                if let Some((matrix, _)) = matrix {
                    slopes.set(slopes.get() + 1);
                    matrix.clear();
                    matrix.add(0, 0, 1.0 + 3.0 * c * x[0] * x[0], &Coefficients::Diagonal([1.0].into()));
                }
            };
            let (mut unknown, mut matrix) = ([0.9], Dear(StepMatrix::zero(), sparing));
            newton::<_, Coefficients<f64, 1>, _>(
                &mut unknown,
                &mut [0.0],
                (0.0, false),
                &mut matrix,
                balance,
            )
            .unwrap();
            let [x] = unknown;
            assert!((x + c * x * x * x - 1.0).abs() <= 2.0 * f64::EPSILON, "{c} {x}");
            slopes.get()
        };
        assert_eq!((solve(0.01, true), solve(0.01, false)), (1, 3));
        let far = solve(50.0, true);
        assert!((2..6).contains(&far), "{far}");
    }

    #[test]
    fn rounding_has_a_floor_among_the_smallest_numbers() {
        // The residual is ±3 of the smallest positive number on either side of the root: corrections cannot
        // shrink further.
        let rough = |x: f64| (if x > 1e-317 { 1.5e-323 } else { -1.5e-323 }, 1.0);
        let (root, iterations) = scalar(1.0001e-317, rough).unwrap();
        assert!((root - 1e-317).abs() < 1e-320 && iterations < 3, "{root:e} after {iterations}");
        // A correction far below the smallest normal number is rounding of a number of that size.
        assert_eq!(scalar(1e-310, |x| (x, 1.0)), Ok((0.0, 1)));
    }

    #[test]
    fn rounding_is_measured_by_the_size_of_the_unknowns() {
        // The next number above 10⁸.
        assert_eq!(scalar(1e8 + 1.5e-8, |x| (x - 1e8, 1.0)), Ok((1e8, 1)));
        // Corrections that do not shrink are rounding if they are small relative to the unknown, and a
        // failure otherwise.
        let noisy = |root: f64| move |x: f64| (if x > root { 0.5 } else { -0.5 }, 1.0);
        let (root, iterations) = scalar(1e8 + 0.25, noisy(1e8)).unwrap();
        assert!((root - 1e8).abs() <= 0.5 && iterations <= 10, "{root} after {iterations}");
        assert!(matches!(scalar(10.25, noisy(10.0)), Err(StepError::NotConverged { .. })));
    }

    #[test]
    fn failures_are_told_apart() {
        assert_eq!(scalar(1.0, |_| (1.0, 0.0)), Err(StepError::SingularJacobian));
        assert_eq!(scalar(1.0, |_| (f64::NAN, 1.0)), Err(StepError::NotFinite));
        // No real root, and from this guess Newton's method never converges.
        let never = scalar(0.3, |x| (x * x + 1.0, 2.0 * x));
        assert!(matches!(never, Err(StepError::NotConverged { iterations: 50, .. })), "{never:?}");
    }

    #[test]
    fn kept_factors_solve_what_elimination_solves() {
        let block = Coefficients::Dense(nalgebra::matrix![0.0, 2.0; 2.0, 1.0]);
        let other = Coefficients::Diagonal([3.0, -1.0].into());
        let mut matrix = StepMatrix::<f64, 2, 2>::zero();
        for (row, column, factor, block) in
            [(0, 0, 1.0, &block), (0, 1, 2.0, &other), (1, 0, -1.0, &other), (1, 1, 0.5, &block)]
        {
            matrix.add(row, column, factor, block);
        }
        let (mut eliminated, mut kept) = ([1.0, -2.0, 0.5, 4.0], [1.0, -2.0, 0.5, 4.0]);
        let mut factors = Factors::zero();
        let mut copy = matrix;
        copy.keep(&mut factors, (1.0, &block)).unwrap();
        Equations::<f64, Coefficients<f64, 2>>::solve_kept(&mut copy, &factors, &mut kept);
        Equations::<f64, Coefficients<f64, 2>>::solve(&mut matrix, &mut eliminated).unwrap();
        for (a, b) in eliminated.into_iter().zip(kept) {
            assert!((a - b).abs() < 1e-14, "{eliminated:?} {kept:?}");
        }
        let mut again = [1.0, -2.0, 0.5, 4.0];
        Equations::<f64, Coefficients<f64, 2>>::solve_again(&mut matrix, &mut again);
        assert_eq!(again, eliminated);
    }

    #[test]
    fn corrections_end_where_the_next_one_would_be_rounding() {
        let near = |found: Verdict<f64>, iterations: u32, left: f64| {
            let Verdict::Converged(found) = found else { panic!("{found:?}") };
            let residual = found.residual.unwrap();
            assert!((residual / left - 1.0).abs() < 1e-12 && found.iterations == iterations, "{found:?}");
        };
        // On a position of size 64 a correction is small up to 1. After a larger one the matrix is factored
        // anew, and the residual left shrinks with the square of 10⁻⁸.
        let mut corrections = Corrections::new(64.0);
        assert_eq!(corrections.judge(1.0, (2.0, 0.0), true), Ok(Verdict::Continue));
        assert!(!corrections.takes_factors_again());
        near(corrections.judge(1e-3, (1e-8, 0.0), true).unwrap(), 2, 1e-3 * 1e-16);
        // After a small one the factors are reused, and corrections shrink by no more than twice the ratio.
        let mut corrections = Corrections::new(64.0);
        assert_eq!(corrections.judge(1.0, (0.5, 0.0), true), Ok(Verdict::Continue));
        assert!(corrections.takes_factors_again());
        near(corrections.judge(1e-3, (1e-8, 0.0), true).unwrap(), 2, 1e-3 * 4e-8);
        // A first correction of rounding size gives no estimate of the residual.
        let first = Corrections::new(64.0).judge(1e-3, (1e-14, 0.0), true);
        assert_eq!(
            first,
            Ok(Verdict::Converged(Converged { iterations: 1, residual: None, leaves_residual: false }))
        );
    }

    #[test]
    fn a_small_unknown_on_a_large_offset_is_found() {
        // Increments x = h v of a velocity with v + 50 v³ = c, where a step h changes positions by less than
        // the square root of their rounding: corrections of that size are no rounding here.
        let mut matrix = StepMatrix::<f64, 1, 1>::zero();
        for h in [1.0, 1e-3, 1e-5, 1e-7, 1e-8, 1e-9] {
            for (guess, c) in [(1.0, 0.5), (0.3, 0.4), (0.01, -0.2), (-0.7, 3.0), (0.0, 10.0)] {
                let mut unknown = [guess * h];
                let balance =
                    |x: &[f64],
                     residual: &mut [f64],
                     matrix: Option<Linearised<'_, StepMatrix<f64, 1, 1>, f64>>| {
                        let v = x[0] / h;
                        residual[0] = v + 50.0 * v * v * v - c;
                        if let Some((matrix, _)) = matrix {
                            Equations::<f64, Coefficients<f64, 1>>::clear(matrix);
                            let slope = (1.0 + 150.0 * v * v) / h;
                            matrix.add(0, 0, slope, &Coefficients::Diagonal([1.0].into()));
                        }
                    };
                newton::<_, Coefficients<f64, 1>, _>(
                    &mut unknown,
                    &mut [0.0],
                    (1.0, false),
                    &mut matrix,
                    balance,
                )
                .unwrap();
                let v = unknown[0] / h;
                let error = (v + 50.0 * v * v * v - c).abs() / (1.0 + 150.0 * v * v);
                assert!(error <= 1e-15 / h, "h = {h:e}, from {guess} for {c}: {v}, {error:e}");
            }
        }
    }

    #[test]
    fn corrections_that_go_round_are_no_rounding() {
        // Newton's method on x/√(1 + x²) goes from x to −x³: from 1 round and round, from there on away.
        for guess in [0.9, 1.0, 1.1] {
            let (h, offset) = (1e-9, 1.0);
            let mut matrix = StepMatrix::<f64, 1, 1>::zero();
            let mut unknown = [guess * h];
            let balance =
                |x: &[f64],
                 residual: &mut [f64],
                 matrix: Option<Linearised<'_, StepMatrix<f64, 1, 1>, f64>>| {
                    let v = x[0] / h;
                    let root = libm::sqrt(1.0 + v * v);
                    residual[0] = v / root;
                    if let Some((matrix, _)) = matrix {
                        Equations::<f64, Coefficients<f64, 1>>::clear(matrix);
                        let slope = 1.0 / (root * root * root * h);
                        matrix.add(0, 0, slope, &Coefficients::Diagonal([1.0].into()));
                    }
                };
            newton::<_, Coefficients<f64, 1>, _>(
                &mut unknown,
                &mut [0.0],
                (offset, false),
                &mut matrix,
                balance,
            )
            .unwrap();
            assert!((unknown[0] / h).abs() < 1e-6, "from {guess}: {}", unknown[0] / h);
        }
    }
}
