//! Stability of a step: the number of growing motions of a linearised scheme.

pub(super) mod characteristic;
#[cfg(test)]
mod growth_tests;
mod large;
mod of_scenario;
mod parts;
mod polynomials;
pub(super) mod symbol;
pub(super) mod winding;

use characteristic::Characteristic;
use fvi_core::ParameterError;
use fvi_fft::dense;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::transfer::multistep_rule::MultistepRule;
use nalgebra::{Cholesky, DMatrix};
pub(crate) use of_scenario::{
    check_large_step, check_step, discretisation, force_nodes, is_unconditional, stages_of_family,
    takes_gyroscopic,
};
pub(crate) use parts::{LARGEST_PART, Part};
use parts::{all_parts, parts};
use winding::{Count, Fineness};

/// Nodes at which the fractional force acts, and its convolution quadrature.
#[derive(Clone, Debug, PartialEq)]
pub enum DampingForm {
    /// Explicitly at the main nodes q_k.
    MainNodes {
        /// The rule of the convolution quadrature.
        rule: MultistepRule,
    },
    /// Implicitly at the quadrature nodes, with a separate sequence of values for each.
    Nodes {
        /// The rule of the convolution quadrature.
        rule: MultistepRule,
    },
    /// Implicitly at the stages of a stiffly accurate Runge–Kutta method, whose nodes and weights are those
    /// of the quadrature.
    Stages {
        /// A of the method.
        matrix: DMatrix<f64>,
    },
}

/// The properties of a scheme that determine its stability.
#[derive(Clone, Debug, PartialEq)]
pub struct Discretisation {
    /// Degree S of the polynomials; 1 with one node at 1 − κ is the low-order scheme.
    pub degree: usize,
    /// Quadrature nodes c_i on [0, 1].
    pub nodes: Vec<f64>,
    /// Quadrature weights b_i.
    pub weights: Vec<f64>,
    /// Nodes at which the fractional force acts.
    pub form: DampingForm,
}

/// A damping term ρ K(D) q.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearDamping {
    /// ρ, symmetric and positive semidefinite.
    pub coefficients: DMatrix<f64>,
    /// K(s), passive.
    pub transfer: TransferFunction,
}

/// M q̈ + C q̇ + K q + Σ_m ρ_m K_m(D) q = 0, in coordinates where M is the identity, with zeros instead of
/// some of its ones if there are coordinates without mass.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearSystem {
    /// M, if it is not the identity.
    mass: Option<DMatrix<f64>>,
    stiffness: DMatrix<f64>,
    /// C = −∂F/∂v.
    resistance: Option<DMatrix<f64>>,
    damping: Vec<LinearDamping>,
}

impl LinearSystem {
    /// The system of a mass matrix M, a stiffness K = ∂²U/∂q² − ∂F/∂q, symmetric or not, and damping terms.
    ///
    /// # Errors
    /// If M is not positive definite but for rows and columns of zeros, or so small that K or ρ divided by it
    /// is not finite; or if neither stiffness alone nor damping holds a coordinate without mass.
    pub fn new(
        mass: &DMatrix<f64>,
        stiffness: &DMatrix<f64>,
        damping: Vec<LinearDamping>,
    ) -> Result<Self, ParameterError> {
        Self::resisted(mass, (stiffness, None), damping)
    }

    /// As [`new`](Self::new), with C = −∂F/∂v of velocity-dependent forces, if there are any: an arbitrary
    /// matrix.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn resisted(
        mass: &DMatrix<f64>,
        (stiffness, resistance): (&DMatrix<f64>, Option<&DMatrix<f64>>),
        mut damping: Vec<LinearDamping>,
    ) -> Result<Self, ParameterError> {
        let refused = ParameterError {
            parameter: "smallest diagonal entry of the mass matrix",
            value: mass.diagonal().min(),
            allowed: "that of a positive definite matrix by which stiffness and damping can be divided",
        };
        let massless: Vec<usize> =
            (0..mass.nrows()).filter(|&row| mass.row(row).iter().all(|&entry| entry == 0.0)).collect();
        if !massless.is_empty() {
            let all = Self {
                mass: Some(mass.clone()),
                stiffness: stiffness.clone(),
                resistance: resistance.cloned(),
                damping,
            };
            return all.scaled(&massless).ok_or(refused);
        }
        let factor = Cholesky::new(mass.clone()).ok_or(refused)?.l();
        let inverse = dense::inverse(factor).ok_or(refused)?;
        let in_new_coordinates = |matrix: &DMatrix<f64>| &inverse * matrix * inverse.transpose();
        for term in &mut damping {
            term.coefficients = in_new_coordinates(&term.coefficients);
        }
        let stiffness = in_new_coordinates(stiffness);
        let resistance = resistance.map(in_new_coordinates);
        let finite = |matrix: &DMatrix<f64>| matrix.iter().all(|entry| entry.is_finite());
        if !finite(&stiffness)
            || !resistance.iter().all(finite)
            || !damping.iter().all(|term| finite(&term.coefficients))
        {
            return Err(refused);
        }
        Ok(Self { mass: None, stiffness, resistance, damping })
    }

    /// The system whose mass has these rows of zeros, in coordinates where all other entries of M are those
    /// of the identity. Coordinates held by stiffness alone are where K q = 0, at every node of a scheme too,
    /// and are eliminated; those that are damped have the identity for the sum of what damps them.
    fn scaled(self, massless: &[usize]) -> Option<Self> {
        let mass = self.mass?;
        let size = mass.nrows();
        let acts = |matrix: &DMatrix<f64>, row: usize| matrix.row(row).amax() > 0.0;
        let damped = |row: usize| {
            self.resistance.iter().any(|resistance| acts(resistance, row))
                || self.damping.iter().any(|term| acts(&term.coefficients, row))
        };
        let held: Vec<usize> = massless.iter().copied().filter(|&row| !damped(row)).collect();
        let heavy = (0..size).filter(|row| !massless.contains(row));
        let kept: Vec<usize> =
            heavy.chain(massless.iter().copied().filter(|row| !held.contains(row))).collect();
        let block = |matrix: &DMatrix<f64>, rows: &[usize], columns: &[usize]| {
            DMatrix::from_fn(rows.len(), columns.len(), |i, j| matrix[(rows[i], columns[j])])
        };
        let mut stiffness = block(&self.stiffness, &kept, &kept);
        if !held.is_empty() {
            let inverse = dense::inverse(block(&self.stiffness, &held, &held))?;
            let [to, from] =
                [(&kept, &held), (&held, &kept)].map(|(rows, columns)| block(&self.stiffness, rows, columns));
            stiffness -= to * inverse * from;
        }
        let of_kept = |matrix: &DMatrix<f64>| block(matrix, &kept, &kept);
        let (mass, resistance) = (of_kept(&mass), self.resistance.as_ref().map(of_kept));
        let mut damping = self.damping;
        damping.iter_mut().for_each(|term| term.coefficients = of_kept(&term.coefficients));
        let count = size - massless.len();
        let mut metric = mass.clone();
        for matrix in damping.iter().map(|term| &term.coefficients).chain(&resistance) {
            let mut own = metric.view_range_mut(count.., count..);
            own +=
                0.5 * (matrix.view_range(count.., count..) + matrix.view_range(count.., count..).transpose());
        }
        // Dampers may resist some motions only; then stiffness holds the others.
        let regular = Cholesky::new(metric.clone()).or_else(|| {
            let mut own = metric.view_range_mut(count.., count..);
            let held = stiffness.view_range(count.., count..);
            own += 0.5 * (held + held.transpose());
            Cholesky::new(metric)
        });
        let inverse = dense::inverse(regular?.l())?;
        let in_new_coordinates = |matrix: &DMatrix<f64>| &inverse * matrix * inverse.transpose();
        damping.iter_mut().for_each(|term| term.coefficients = in_new_coordinates(&term.coefficients));
        let (stiffness, resistance) =
            (in_new_coordinates(&stiffness), resistance.as_ref().map(in_new_coordinates));
        let finite = |matrix: &DMatrix<f64>| matrix.iter().all(|entry| entry.is_finite());
        let terms = damping.iter().map(|term| &term.coefficients);
        if !terms.chain([&stiffness]).chain(&resistance).all(finite) {
            return None;
        }
        let one = |i, j| f64::from(u8::from(i == j && i < count));
        let mass = (count < kept.len()).then(|| DMatrix::from_fn(kept.len(), kept.len(), one));
        Some(Self { mass, stiffness, resistance, damping })
    }

    /// Its uncoupled parts; `None` if one has more than [`LARGEST_PART`] coordinates.
    pub(crate) fn parts(&self) -> Option<Vec<Part>> {
        all_parts(self).ok()
    }
}

/// Result of the check.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// No motion grows.
    Stable,
    /// A motion grows, or rounding makes it impossible to decide.
    Unstable {
        /// The largest shorter step without growing motions, to four digits; `None` if there is none above
        /// 10⁻¹² of the step.
        largest_stable_step: Option<f64>,
    },
}

/// Growth of a motion over the whole run that is accepted.
const GROWTH: f64 = 2.0;

/// Bounds of the accepted growth per step: the lower one allows for rounding, the upper one limits it in
/// short runs.
const MARGINS: (f64, f64) = (1e-7, 1e-3);

/// Checks whether a step is short enough for runs of this length.
///
/// With motions q_k = z^{−k} v the equations of a step are A(z) v = 0 (`characteristic.rs`). Every zero of
/// det A in |z| < 1 is a motion that grows, and a motion that grows is such a zero. They are counted by the
/// argument principle, on a circle a little inside |z| = 1: a motion may grow by the factor 2 over the run.
/// So what neither grows nor decays is accepted, as are undamped systems. Where the system itself makes
/// motions grow (K not positive semidefinite, forces that do not come from a potential, forces of the
/// velocity that drive) none may grow more
/// than twice as fast as the system's fastest can; where coordinates have no mass nothing bounds that, and
/// such parts are not looked at.
///
/// Matrices that commute are split into their modes. Parts of more than 40 coupled coordinates are split into
/// the modes of K, and into those of ρ, neglecting the coupling: the check is then only heuristic.
///
/// K is that of the initial point, so for nonlinear problems the check is local.
pub fn check_stability(
    discretisation: &Discretisation,
    system: &LinearSystem,
    step: f64,
    steps: usize,
) -> Verdict {
    let transfers = system.damping.iter().map(|term| term.transfer.clone()).collect();
    let check = Check {
        characteristic: Characteristic::new(discretisation, transfers),
        parts: parts(system)
            .into_iter()
            .filter(|part| !is_always_stable(discretisation, part) && !may_grow_at_any_rate(part))
            .collect(),
        end: step * steps.max(1) as f64,
    };
    if check.is_stable(step) {
        return Verdict::Stable;
    }
    // Given weights are for a single step size.
    let others = !system.damping.iter().any(|term| term.transfer.table().is_some());
    Verdict::Unstable { largest_stable_step: if others { check.largest_stable_step(step) } else { None } }
}

/// True if a part is stable at every step.
///
/// A free motion is. So is the midpoint rule, undamped or with BDF 1 or 2 at its node: with w = (2/h)(1 −
/// z)/(1 + z) the equation divided by w, multiplied by v*, is
///
/// ```text
/// w + k/w + Σ ρ (γ_p(z)/h)^β / w = 0 ,
/// ```
///
/// and in |z| < 1 the first term has a positive real part, the others a nonnegative one: on the upper half of
/// |z| = 1, arg 1/w = π/2 and −π/2 ≤ arg γ_p ≤ 0, so arg γ_p^β/w stays within ±π/2 for 0 ≤ β ≤ 2; it is
/// harmonic, so this holds inside too. Every other passive kernel is a positive combination of resonators,
/// for which the same holds (book/src/theory/kernels.md). A velocity-dependent force adds v*C v, whose real
/// part is nonnegative if C adds no energy.
fn is_always_stable(discretisation: &Discretisation, part: &Part) -> bool {
    if !part.is_damped() && !part.is_resisted() && part.stiffness.amax() == 0.0 {
        return true;
    }
    let mut nodes =
        discretisation.nodes.iter().zip(&discretisation.weights).filter(|(_, weight)| **weight != 0.0);
    let midpoint = discretisation.degree == 1 && nodes.all(|(&node, _)| node == 0.5);
    let passive = match discretisation.form {
        DampingForm::Nodes { rule } => rule.is_passive(),
        DampingForm::MainNodes { .. } | DampingForm::Stages { .. } => false,
    };
    midpoint && (passive || !part.is_damped()) && part.growth_rate() == 0.0
}

/// True if the motions of a part with coordinates without mass may grow at any rate, as with repulsive
/// forces.
fn may_grow_at_any_rate(part: &Part) -> bool {
    part.mass.is_some() && part.growth_rate() > 0.0
}

struct Check {
    characteristic: Characteristic,
    parts: Vec<Part>,
    end: f64,
}

impl Check {
    fn is_stable(&self, step: f64) -> bool {
        self.finds_none(step) == Some(true)
    }

    /// True if no motion grows; `None` if that would take too much work.
    fn finds_none(&self, step: f64) -> Option<bool> {
        let margin = (libm::log(GROWTH) * step / self.end).clamp(MARGINS.0, MARGINS.1);
        for part in &self.parts {
            let radius = libm::exp(-margin.max(2.0 * part.growth_rate() * step));
            let count = |fineness: &Fineness| {
                winding::zeros_inside(radius, fineness, |z| self.characteristic.logarithm(part, step, z))
            };
            match count(&winding::FINENESS) {
                Count::Zeros(0) => {}
                // Nothing is refused for zeros that a finer count does not find.
                Count::Zeros(_) | Count::Unknown if count(&winding::FINER) == Count::Zeros(0) => {}
                Count::Zeros(_) | Count::Unknown => return Some(false),
                Count::Endless => return None,
            }
        }
        Some(true)
    }

    /// The first smaller stable step, by reductions of a tenth and later by halves; then the limit above it
    /// to four digits.
    fn largest_stable_step(&self, step: f64) -> Option<f64> {
        let (mut low, mut high) = (step, step);
        while !self.finds_none(low)? {
            high = low;
            low *= if low > 0.1 * step { 0.9 } else { 0.5 };
            if low < 1e-12 * step {
                return None;
            }
        }
        while high - low > 1e-4 * low {
            let middle = 0.5 * (low + high);
            if self.is_stable(middle) { low = middle } else { high = middle }
        }
        Some(low)
    }
}
