//! Nonlinear least squares within bounds: the method of Levenberg and Marquardt on the parameters that are
//! not fixed at a bound, with the damping parameter updated as in \[Nielsen99\].

use fvi_core::max_or_nan;
use fvi_fft::dense::{SingularValues, triangle};
use nalgebra::{DMatrix, DVector};

/// Residuals at a point, and their derivatives where requested.
#[derive(Clone, Debug)]
pub(super) struct Evaluation {
    pub(super) residuals: DVector<f64>,
    pub(super) jacobian: Option<DMatrix<f64>>,
}

impl Evaluation {
    /// Half the sum of squares.
    pub(super) fn cost(&self) -> f64 {
        0.5 * self.residuals.norm_squared()
    }
}

/// Why there are no residuals.
#[derive(Debug)]
pub(super) enum Refusal<E> {
    /// The residuals are undefined at this point; the search tries another one.
    Point(String),
    /// The search must end.
    End(E),
}

/// Residuals as a function of the parameters.
pub(super) trait Residuals {
    type End;

    /// The residuals at a point, with their derivatives if `derivatives` is set.
    fn evaluate(&mut self, point: &[f64], derivatives: bool) -> Result<Evaluation, Refusal<Self::End>>;
}

/// Bounds and scales of a search.
#[derive(Clone, Debug)]
pub(super) struct Region {
    pub(super) lower: Vec<f64>,
    pub(super) upper: Vec<f64>,
    /// Typical size of each parameter, to which its changes are relative.
    pub(super) typical: Vec<f64>,
    /// Longest change of each parameter in one step. Where residuals saturate, as behind exponentials, a step
    /// that the linear model makes ends where nothing changes any more.
    pub(super) longest: Vec<f64>,
    /// Cost (half the sum of squares) below which residuals consist of rounding errors.
    pub(super) rounding: f64,
}

/// How a search ended.
#[derive(Clone, Debug)]
pub(super) struct Minimum {
    pub(super) point: Vec<f64>,
    /// Residuals and derivatives at `point`.
    pub(super) evaluation: Evaluation,
    pub(super) iterations: usize,
    pub(super) end: End,
}

/// Why a search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    /// The point is a minimum within rounding.
    Converged,
    /// As many steps as allowed were made.
    Iterations,
    /// No step along the gradient reduces the cost, although the gradient is not zero.
    Stuck,
}

/// A step shorter than this, relative to the parameters, ends the search.
const SHORTEST: f64 = 1e-12;

/// The search ends where the predicted decrease of the sum of squares, relative to it, is less than this:
/// with m data a distance of 10⁻¹⁰ √m standard deviations, however ill-conditioned the problem is.
const LEAST_GAIN: f64 = 1e-20;

/// A predicted decrease below this fraction of the sum of squares is not seen in it: steps are then judged
/// by the gradient.
const UNSEEN: f64 = 1e-12;

/// Directions with singular values smaller than this, relative to the largest, do not count in the predicted
/// decrease.
const FLAT: f64 = 1e-9;

/// A predicted decrease below this fraction of the sum of squares may be hidden by rounding.
const NO_GAIN: f64 = 1e-9;

/// The search ends where the cosine of the angle between the residuals and each column of their derivatives
/// is below this.
const ORTHOGONAL: f64 = 1e-14;

/// Damping parameter at which the search gives up.
const HEAVIEST: f64 = 1e14;

/// Which parameters are fixed at a bound: those at a bound beyond which the sum of squares would decrease.
pub(super) fn held(point: &[f64], region: &Region, gradient: &[f64]) -> Vec<bool> {
    let bounds = region.lower.iter().zip(&region.upper);
    let with_slope = point.iter().zip(gradient).zip(bounds);
    with_slope
        .map(|((&x, &slope), (&low, &high))| {
            low == high || (x <= low && slope > 0.0) || (x >= high && slope < 0.0)
        })
        .collect()
}

/// Jᵀr.
pub(super) fn gradient(evaluation: &Evaluation) -> Vec<f64> {
    let Some(jacobian) = &evaluation.jacobian else { return Vec::new() };
    jacobian.column_iter().map(|column| column.dot(&evaluation.residuals)).collect()
}

/// The largest cosine of the angle between the residuals and a column of their derivatives.
fn slope_along(evaluation: &Evaluation, free: &[usize]) -> f64 {
    let Some(jacobian) = &evaluation.jacobian else { return f64::INFINITY };
    let size = evaluation.residuals.norm();
    let cosine = |&index: &usize| {
        let column = jacobian.column(index);
        column.dot(&evaluation.residuals).abs() / (column.norm() * size).max(f64::MIN_POSITIVE)
    };
    free.iter().map(cosine).fold(0.0, max_or_nan)
}

/// The residuals at a point, with derivatives if requested; `None` where either is undefined.
fn at<R: Residuals>(
    residuals: &mut R,
    point: &[f64],
    derivatives: bool,
) -> Result<Option<Evaluation>, Refusal<R::End>> {
    match residuals.evaluate(point, derivatives) {
        Ok(evaluation) => Ok(Some(evaluation)),
        Err(Refusal::Point(_)) => Ok(None),
        Err(end) => Err(end),
    }
}

/// An evaluation with its derivatives; `None` where they are undefined.
fn with_derivatives<R: Residuals>(
    residuals: &mut R,
    evaluation: Evaluation,
    point: &[f64],
) -> Result<Option<Evaluation>, Refusal<R::End>> {
    match evaluation.jacobian {
        Some(_) => Ok(Some(evaluation)),
        None => at(residuals, point, true),
    }
}

/// The residuals as a linear function of the scaled free parameters about a point.
struct LinearModel {
    free: Vec<usize>,
    /// The sizes of the derivatives by the free parameters.
    scales: Vec<f64>,
    /// R of the QR factorisation of the scaled derivatives.
    triangle: DMatrix<f64>,
    /// Qᵀr.
    right: DVector<f64>,
    parts: SingularValues,
    /// Uᵀ Qᵀr.
    projected: DVector<f64>,
}

impl LinearModel {
    /// `None` if the derivatives have no singular values.
    fn new(now: &Evaluation, jacobian: &DMatrix<f64>, free: Vec<usize>, scales: Vec<f64>) -> Option<Self> {
        let columns = DMatrix::from_fn(jacobian.nrows(), free.len(), |row, column| {
            jacobian[(row, free[column])] / scales[column]
        });
        let (triangle, right) = triangle(columns, &now.residuals);
        let parts = SingularValues::of(triangle.clone())?;
        let projected = parts.u.tr_mul(&right);
        Some(Self { free, scales, triangle, right, parts, projected })
    }

    /// Decrease of the cost that an undamped step would bring.
    fn potential(&self) -> f64 {
        let values = &self.parts.values;
        let steep = |k: &usize| values[*k] > FLAT * values.max();
        let shares = (0..values.len()).filter(steep).map(|k| self.projected[k] * self.projected[k]);
        0.5 * shares.sum::<f64>()
    }

    /// The point after a step damped by a weight, within the region.
    fn trial(&self, point: &[f64], region: &Region, weight: f64) -> Vec<f64> {
        let shares = DVector::from_fn(self.parts.values.len(), |k, _| {
            let sigma = self.parts.values[k];
            -sigma / (sigma * sigma + weight) * self.projected[k]
        });
        let step = self.parts.v_t.tr_mul(&shares);
        let mut trial = point.to_vec();
        for (column, &index) in self.free.iter().enumerate() {
            let longest = region.longest[index];
            let change = (step[column] / self.scales[column]).max(-longest).min(longest);
            trial[index] = region.clamped(index, point[index] + change);
        }
        trial
    }

    /// Decrease of the cost that the model predicts for a trial point.
    fn decrease(&self, point: &[f64], trial: &[f64]) -> f64 {
        let made = DVector::from_fn(self.free.len(), |column, _| {
            let index = self.free[column];
            (trial[index] - point[index]) * self.scales[column]
        });
        0.5 * (self.right.norm_squared() - (&self.right + &self.triangle * &made).norm_squared())
    }
}

impl Region {
    /// A parameter within its bounds.
    fn clamped(&self, index: usize, x: f64) -> f64 {
        x.max(self.lower[index]).min(self.upper[index])
    }

    /// True if a step of the free parameters is too short to change anything.
    fn is_short(&self, free: &[usize], point: &[f64], trial: &[f64]) -> bool {
        free.iter().all(|&index| {
            let size = point[index].abs().max(1e-3 * self.typical[index]);
            (trial[index] - point[index]).abs() <= SHORTEST * size
        })
    }
}

/// Minimises the sum of squares from a start.
///
/// # Errors
/// [`Refusal::End`] as returned by `residuals`; [`Refusal::Point`] if they are undefined at the start.
pub(super) fn minimise<R: Residuals>(
    residuals: &mut R,
    start: &[f64],
    region: &Region,
    most: usize,
) -> Result<Minimum, Refusal<R::End>> {
    let size = start.len();
    let mut point: Vec<f64> = (0..size).map(|index| region.clamped(index, start[index])).collect();
    let mut now = residuals.evaluate(&point, true)?;
    if !now.cost().is_finite() {
        return Err(Refusal::Point("the sum of squares there is not a finite number".to_owned()));
    }
    let mut scales = vec![0.0f64; size];
    let (mut weight, mut growth) = (1e-3, 2.0);
    let mut iterations = 0;
    let end = loop {
        let Some(jacobian) = &now.jacobian else { break End::Stuck };
        let slopes = gradient(&now);
        let held = held(&point, region, &slopes);
        let free: Vec<usize> = (0..size).filter(|&index| !held[index]).collect();
        let norms: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
        let size_of_residuals = now.residuals.norm();
        let is_orthogonal =
            |&index: &usize| slopes[index].abs() <= ORTHOGONAL * norms[index] * size_of_residuals;
        if free.iter().all(is_orthogonal) {
            break End::Converged;
        }
        if iterations == most {
            break End::Iterations;
        }
        iterations += 1;
        scales.iter_mut().zip(&norms).for_each(|(scale, norm)| *scale = scale.max(*norm));
        let scales_of_free = free.iter().map(|&index| if scales[index] > 0.0 { scales[index] } else { 1.0 });
        let Some(model) = LinearModel::new(&now, jacobian, free.clone(), scales_of_free.collect()) else {
            break End::Stuck;
        };
        let cost = now.cost();
        let potential = model.potential();
        if potential <= LEAST_GAIN * cost {
            break End::Converged;
        }
        // Where the residuals jump, steps become short although the cost could still decrease. `noise` bounds
        // the cost of residuals that consist of rounding errors, and the change of the cost by rounding of
        // larger ones.
        let noise = region.rounding.max(4.0 * (cost * region.rounding).sqrt());
        let is_done = potential <= NO_GAIN * cost || potential <= noise;
        let end_of_short = if is_done { End::Converged } else { End::Stuck };
        let (next, step_end) = loop {
            let trial = model.trial(&point, region, weight);
            let predicted = model.decrease(&point, &trial);
            let is_short = region.is_short(&free, &point, &trial);
            if predicted > 0.0
                && let Some(tried) = at(residuals, &trial, growth == 2.0)?
            {
                let gained = cost - tried.cost();
                let is_finite = tried.residuals.iter().all(|residual| residual.is_finite());
                if is_finite && gained > 1e-4 * predicted {
                    // A point without derivatives, where the next step could not begin, is avoided like one
                    // without residuals.
                    let whole = with_derivatives(residuals, tried, &trial)?;
                    if let Some(whole) = whole {
                        let ratio = 2.0 * gained / predicted - 1.0;
                        weight = (weight * (1.0 - ratio * ratio * ratio).clamp(0.1, 1.0)).max(1e-16);
                        growth = 2.0;
                        break (Some((trial, whole)), is_short.then_some(end_of_short));
                    }
                } else if is_finite && potential <= UNSEEN * cost && gained.abs() <= UNSEEN * cost {
                    let whole = with_derivatives(residuals, tried, &trial)?;
                    match whole.filter(|whole| 2.0 * slope_along(whole, &free) < slope_along(&now, &free)) {
                        Some(whole) => {
                            weight = (0.1 * weight).max(1e-16);
                            break (Some((trial, whole)), None);
                        }
                        None => break (None, Some(End::Converged)),
                    }
                }
            }
            if is_short {
                break (None, Some(end_of_short));
            }
            weight *= growth;
            growth *= 2.0;
            if weight > HEAVIEST {
                break (None, Some(end_of_short));
            }
        };
        if let Some((trial, tried)) = next {
            point = trial;
            now = tried;
        }
        if let Some(end) = step_end {
            break end;
        }
    };
    Ok(Minimum { point, evaluation: now, iterations, end })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// r(x) as a function with its derivatives.
    struct Function<F>(F, usize);

    impl<F: Fn(&[f64]) -> Option<(Vec<f64>, Vec<Vec<f64>>)>> Residuals for Function<F> {
        type End = ();

        fn evaluate(&mut self, point: &[f64], derivatives: bool) -> Result<Evaluation, Refusal<()>> {
            self.1 += 1;
            let (residuals, rows) = (self.0)(point).ok_or(Refusal::Point(String::new()))?;
            let matrix = DMatrix::from_fn(residuals.len(), point.len(), |i, j| rows[i][j]);
            Ok(Evaluation {
                residuals: DVector::from_vec(residuals),
                jacobian: derivatives.then_some(matrix),
            })
        }
    }

    fn region(bounds: &[(f64, f64)]) -> Region {
        Region {
            lower: bounds.iter().map(|bounds| bounds.0).collect(),
            upper: bounds.iter().map(|bounds| bounds.1).collect(),
            typical: vec![1.0; bounds.len()],
            longest: vec![f64::INFINITY; bounds.len()],
            rounding: 0.0,
        }
    }

    const OPEN: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);

    /// Rosenbrock's valley.
    #[expect(clippy::unnecessary_wraps, reason = "functions may refuse")]
    fn valley(x: &[f64]) -> Option<(Vec<f64>, Vec<Vec<f64>>)> {
        Some((vec![10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]], vec![vec![-20.0 * x[0], 10.0], vec![-1.0, 0.0]]))
    }

    #[test]
    fn the_end_of_a_curved_valley_is_found() {
        let mut function = Function(valley, 0);
        let found = minimise(&mut function, &[-1.2, 1.0], &region(&[OPEN, OPEN]), 200).unwrap();
        assert_eq!(found.end, End::Converged);
        assert!(found.point.iter().all(|x| (x - 1.0).abs() < 1e-10), "{:?}", found.point);
        assert!(function.1 < 60, "{} evaluations", function.1);
    }

    /// 1/(1 + e^{−x}) = 0.8
    #[test]
    fn no_step_is_longer_than_the_longest() {
        let saturates = |x: &[f64]| {
            let fallen = (-x[0]).exp();
            Some((vec![1.0 / (1.0 + fallen) - 0.8], vec![vec![fallen / ((1.0 + fallen) * (1.0 + fallen))]]))
        };
        let within = Region { longest: vec![1.0], ..region(&[OPEN]) };
        // From −8 on the linear model leads to x = 2376.
        let found = minimise(&mut Function(saturates, 0), &[-8.0], &within, 200).unwrap();
        assert_eq!(found.end, End::Converged);
        assert!((found.point[0] - 4.0_f64.ln()).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn a_bound_holds_what_would_leave_it() {
        // With x0 ≤ 0.5 the smallest sum of squares is at x = (0.5, 0.25).
        let mut function = Function(valley, 0);
        let within = region(&[(-2.0, 0.5), OPEN]);
        let found = minimise(&mut function, &[-1.2, 1.0], &within, 200).unwrap();
        assert_eq!(found.end, End::Converged);
        assert_eq!(found.point[0], 0.5);
        assert!((found.point[1] - 0.25).abs() < 1e-8, "{:?}", found.point);
        let held = held(&found.point, &within, &gradient(&found.evaluation));
        assert_eq!(held, [true, false]);
    }

    #[test]
    fn a_bound_that_is_met_on_the_way_is_left_again() {
        let mut function = Function(valley, 0);
        let within = region(&[(-2.0, 2.0), (0.9, 5.0)]);
        let found = minimise(&mut function, &[1.5, 0.9], &within, 500).unwrap();
        assert!(found.point.iter().all(|x| (x - 1.0).abs() < 1e-8), "{found:?}");
    }

    #[test]
    fn points_that_are_refused_are_gone_around() {
        // √x exists for x ≥ 0 only, and the first step would lead below.
        let root = |x: &[f64]| (x[0] > 0.0).then(|| (vec![x[0].sqrt() - 0.1], vec![vec![0.5 / x[0].sqrt()]]));
        let found = minimise(&mut Function(root, 0), &[4.0], &region(&[OPEN]), 200).unwrap();
        assert!((found.point[0] - 0.01).abs() < 1e-12, "{found:?}");
    }

    /// (x + 1)², which is flat at its end, with derivatives for x > 0 only.
    struct WithoutDerivatives;

    impl Residuals for WithoutDerivatives {
        type End = ();

        fn evaluate(&mut self, point: &[f64], derivatives: bool) -> Result<Evaluation, Refusal<()>> {
            let x = point[0];
            if derivatives && x <= 0.0 {
                return Err(Refusal::Point("no derivatives".to_owned()));
            }
            // Far away the model promises too much, so that a shorter step is tried, without derivatives.
            let residuals =
                DVector::from_vec(vec![(x + 1.0) * (x + 1.0) + if x < -0.5 { 100.0 } else { 0.0 }]);
            Ok(Evaluation {
                residuals,
                jacobian: derivatives.then(|| DMatrix::from_element(1, 1, 2.0 * (x + 1.0))),
            })
        }
    }

    #[test]
    fn points_without_derivatives_are_gone_around_too() {
        let found = minimise(&mut WithoutDerivatives, &[3.0], &region(&[OPEN]), 200).unwrap();
        assert!((0.0..1e-3).contains(&found.point[0]), "{found:?}");
        assert!(found.evaluation.jacobian.is_some());
    }

    #[test]
    fn a_start_without_a_finite_sum_of_squares_is_refused() {
        let huge = |x: &[f64]| Some((vec![1e200 * x[0]], vec![vec![1e200]]));
        let refused = minimise(&mut Function(huge, 0), &[1.0], &region(&[OPEN]), 200);
        assert!(matches!(refused, Err(Refusal::Point(reason)) if reason.contains("not a finite number")));
    }

    #[test]
    fn a_jump_is_no_minimum() {
        // From x > 1 the slope leads to 0, but the residual jumps up at 1.
        let jump = |x: &[f64]| Some((vec![if x[0] > 1.0 { x[0] } else { x[0] + 5.0 }], vec![vec![1.0]]));
        let found = minimise(&mut Function(jump, 0), &[3.0], &region(&[(0.0, 9.0)]), 200).unwrap();
        assert_eq!(found.end, End::Stuck, "{found:?}");
    }

    #[test]
    fn what_two_parameters_say_together_leaves_their_difference_where_it_was() {
        let sum = |x: &[f64]| {
            Some((vec![x[0] + x[1] - 3.0, 2.0 * (x[0] + x[1]) - 6.0], vec![vec![1.0; 2], vec![2.0; 2]]))
        };
        let found = minimise(&mut Function(sum, 0), &[1.0, 0.0], &region(&[OPEN, OPEN]), 200).unwrap();
        assert!((found.point[0] - 2.0).abs() < 1e-6 && (found.point[1] - 1.0).abs() < 1e-6, "{found:?}");
    }
}
