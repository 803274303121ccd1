//! Response of a damped structure to a harmonic force: frequency response and poles of a linearised scenario.

mod discrete;
mod mechanism;
mod modes;
mod poles;

use super::stability::characteristic::log_determinant;
use super::stability::{self, LinearDamping, LinearSystem};
use crate::model::{Matrix, Model, matrix};
use discrete::{GaussModes, SchemeFactors, StepEquations, only};
use fvi_core::{Instant, Mechanics, max_or_nan};
use fvi_fft::dense::solve_complex;
use fvi_fft::transfer::TransferFunction;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Feature, Scenario, Scheme};
use fvi_sparse::{ComplexSolver, Pattern};
#[doc(hidden)]
pub use modes::MOST_MODES;
pub use modes::SystemMode;
use nalgebra::{Complex, DMatrix};
pub use poles::SystemPole;
use std::sync::Arc;

/// Largest number of coordinates for which equations are solved in full matrices.
const DENSE: usize = 64;

/// Largest number of unknowns of a step for which they are, with schemes of several nodes.
const DENSE_UNKNOWNS: usize = 600;

/// M q̈ + K q + Σ_m ρ_m K_m(D) q = f, linearised at a point of a scenario: K = ∂²U/∂q² − ∂F/∂q there, at t =
/// 0, including the springs of kernels.
///
/// For a Lagrangian with M = L_vv, dampers along elongations with Gᵀ ρ_m G, and constraints with K + Σ λ_k
/// ∂²c_k on the kernel of C = ∂c/∂q, at an equilibrium with the multipliers λ.
pub struct Linearised {
    /// Number of unknowns: of coordinates, or of directions that constraints leave.
    size: usize,
    /// Those directions, column by column, and L_vv, of a system with constraints.
    free: Option<[DMatrix<f64>; 2]>,
    /// Σ λ_k ∂²c_k on them, where it is not zero.
    bent: Option<DMatrix<f64>>,
    transfers: Vec<TransferFunction>,
    equations: Equations,
    scheme: Result<StepEquations, String>,
    step: f64,
    /// True if K changes with time.
    changes: bool,
    /// True if the forces have no derivative at the point.
    kink: bool,
}

/// Distance at which forces are compared with their derivatives, as a part of the largest coordinate (or 1).
const APART: f64 = 1e-6;

/// True if forces, given with their derivatives by `linearised_at`, have none at a position q: at q ± δ their
/// difference is not δ (K₊ + K₋), or K₊ and K₋ differ, by 10⁻³, in a way that falls with δ like δ. Of smooth
/// forces it falls like δ² at least.
fn has_kink(position: &[f64], mut linearised_at: impl FnMut(&[f64]) -> (Vec<f64>, Entries)) -> bool {
    let largest = position.iter().map(|number| number.abs()).fold(1.0, max_or_nan);
    // By each coordinate: how far the forces are from their derivatives, and how far without a meaning.
    let mut off = |apart: f64| -> Vec<[f64; 2]> {
        // Coordinates move by different amounts: forces of differences of coordinates change, too.
        let moved: Vec<f64> =
            (0..position.len()).map(|i| apart * largest * (0.6 + 0.4 * (i as f64).cos())).collect();
        let mut side = |sign: f64| {
            let at: Vec<f64> = position.iter().zip(&moved).map(|(q, moved)| q + sign * moved).collect();
            let (force, stiffness) = linearised_at(&at);
            // Forces are sums of terms of the size K q, which may cancel.
            let [mut product, mut terms] = [(); 2].map(|()| vec![0.0; force.len()]);
            for &(row, column, entry) in &stiffness {
                product[row] += entry * moved[column];
                terms[row] += entry.abs() * largest;
            }
            (force, product, terms)
        };
        let ((above, rise, terms), (below, fall, _)) = (side(1.0), side(-1.0));
        let of_coordinate = |i: usize| {
            let (change, expected) = (above[i] - below[i], rise[i] + fall[i]);
            let scale = change.abs() + rise[i].abs() + fall[i].abs();
            let rounding = 1e-12 * (above[i].abs() + below[i].abs()) + 1e-15 * terms[i];
            [(change - expected).abs().max((rise[i] - fall[i]).abs()), 1e-3 * scale + rounding]
        };
        (0..position.len()).map(of_coordinate).collect()
    };
    let falls = |(far, near): (&[f64; 2], &[f64; 2])| near[0] <= near[1] || near[0] < far[0] / 20.0;
    let (far, near) = (off(APART), off(APART / 8.0));
    far.iter().zip(&near).any(|(far, near)| far[0] > far[1] && !falls((far, near)))
}

/// A matrix by row, column and number.
type Entries = Vec<(usize, usize, f64)>;

/// Solver of A x = b for A = a M + k K + Σ r_m ρ_m.
enum Equations {
    Dense { mass: DMatrix<f64>, stiffness: DMatrix<f64>, damping: Vec<DMatrix<f64>> },
    Sparse { pattern: Arc<Pattern>, solver: ComplexSolver, slots: Vec<Vec<(usize, f64)>> },
}

/// A scenario at a point.
struct AtPoint {
    free: Option<[DMatrix<f64>; 2]>,
    bent: Option<DMatrix<f64>>,
    equations: Equations,
    changes: bool,
    kink: bool,
}

impl AtPoint {
    /// M, K and ρ_m of a system of straight coordinates.
    fn of_coordinates(scenario: &Scenario, position: &[f64]) -> Result<Self, InputError> {
        let mut alone = scenario.clone();
        alone.cases.clear();
        let mut model = Model::<f64>::new(&alone).map_err(|error| super::bad_mass(scenario, &error))?;
        let size = scenario.coordinates();
        let mut linearised_at = |time: f64, position: &[f64]| {
            let mut stiffness = model.stiffness();
            let mut restoring = vec![0.0; size];
            model.linearise(
                Instant::in_step(time, 0.5, 0.0),
                &position.to_vec(),
                &mut restoring,
                &mut stiffness,
            );
            (restoring, stiffness)
        };
        let (_, stiffness) = linearised_at(0.0, position);
        let entries = stiffness.entries();
        if entries.iter().any(|(.., entry)| !entry.is_finite()) {
            return Err(not_finite(scenario, position));
        }
        let changes = later(scenario).any(|time| linearised_at(time, position).1.entries() != entries);
        let kink = has_kink(position, |position| {
            let (restoring, stiffness) = linearised_at(0.0, position);
            (restoring, stiffness.entries())
        });
        let mass = matrix::<f64>(&scenario.system.mass);
        let terms = &scenario.system.damping;
        let damping: Vec<_> = terms.iter().map(|term| matrix::<f64>(&term.coefficient)).collect();
        let full = size <= DENSE || (size <= DENSE_UNKNOWNS && !scenario.system.has_sparse_matrices());
        let equations = if full {
            let whole = |matrix: &Matrix<f64>| {
                let mut full = DMatrix::zeros(size, size);
                matrix.entries().into_iter().for_each(|(row, column, entry)| full[(row, column)] += entry);
                full
            };
            Equations::Dense {
                mass: whole(&mass),
                stiffness: whole(&stiffness),
                damping: damping.iter().map(whole).collect(),
            }
        } else {
            sparse(size, [&mass, &stiffness].into_iter().chain(&damping))
        };
        Ok(Self { free: None, bent: None, equations, changes, kink })
    }
}

/// Times of the run at which its stiffness is compared with that of its start.
fn later(scenario: &Scenario) -> impl Iterator<Item = f64> + use<> {
    let time = &scenario.time;
    let end = if time.adaptive().is_some() { 1.0 } else { time.time(time.steps) };
    [0.37, 0.71, 1.0].into_iter().map(move |part| part * end)
}

fn not_finite(scenario: &Scenario, position: &[f64]) -> InputError {
    let problem = Problem::NotFinite { what: "the stiffness", place: format!("q = {position:?}") };
    scenario.error_at("system", problem)
}

impl Linearised {
    /// The scenario linearised at a position.
    ///
    /// # Errors
    /// If the mass is not usable, the stiffness there is not finite, or a mechanism has no equilibrium there.
    pub fn new(scenario: &Scenario, position: &[f64]) -> Result<Self, InputError> {
        scenario.check_use(Feature::Response)?;
        let transfers: Vec<_> = scenario.system.damping.iter().map(|term| term.transfer.clone()).collect();
        let AtPoint { free, bent, equations, changes, kink } = match scenario.system.is_mechanism() {
            true => mechanism::at_point(scenario, position)?,
            false => AtPoint::of_coordinates(scenario, position)?,
        };
        let size = free.as_ref().map_or(scenario.coordinates(), |[directions, _]| directions.ncols());
        let scheme = StepEquations::of(scenario, &transfers, bent.is_some()).and_then(|scheme| {
            let massless = scenario.system.massless();
            if let (Some(row), true) = (massless.first(), scenario.scheme != Scheme::Collocation) {
                return Err(format!(
                    "coordinate {row} has no mass, and its positions at grid points do not follow from the polynomials of the scheme"
                ));
            }
            let unknowns = scheme.nodes() * size;
            if scheme.nodes() > 1 && (unknowns > DENSE_UNKNOWNS || matches!(equations, Equations::Sparse { .. })) {
                return Err(format!(
                    "the equations of a step have {unknowns} unknowns; with more than one node they are solved for up to \
                     {DENSE_UNKNOWNS} in full matrices"
                ));
            }
            Ok(scheme)
        });
        Ok(Self { size, free, bent, transfers, equations, scheme, step: scenario.time.step, changes, kink })
    }

    /// True if ∂²U/∂q² − ∂F/∂q changes with time; the response is then that of t = 0.
    pub fn changes_with_time(&self) -> bool {
        self.changes
    }

    /// True if the forces have no derivative at the position, as ∂|q|/∂q at q = 0 has none; the response is
    /// then that of the stiffness on one side of it, or of none.
    pub fn is_at_a_kink(&self) -> bool {
        self.kink
    }

    /// H(ω) = (−ω²M + K + Σ_m ρ_m K_m(iω))⁻¹, the column of one input: displacements under a force e^{iωt} on
    /// the coordinate `input`. For kernels given by weights K_m is known up to ω = π/h.
    ///
    /// # Errors
    /// A message, if the equations have no accurate solution: at a resonance without damping.
    pub fn response(&self, omega: f64, input: usize) -> Result<Vec<Complex<f64>>, String> {
        self.response_unless(omega, input, &mut || false)
    }

    /// The same. `stopped` is asked now and then during the elimination of sparse equations; if it says so,
    /// the equations are left unsolved, with an error.
    ///
    /// # Errors
    /// As [`response`](Self::response).
    #[doc(hidden)]
    pub fn response_unless(
        &self,
        omega: f64,
        input: usize,
        stopped: &mut dyn FnMut() -> bool,
    ) -> Result<Vec<Complex<f64>>, String> {
        if let Some(highest) = self.highest().filter(|highest| omega > highest * (1.0 + 1e-12)) {
            return Err(format!(
                "no response at ω = {omega}: a kernel is given by weights, which tell it up to π/h = {highest}"
            ));
        }
        self.at(omega, input, stopped).ok_or_else(|| unsolved(omega))
    }

    /// (−ω²M + K + Σ_m ρ_m K_m(iω))⁻¹, a column of it.
    fn at(&self, omega: f64, input: usize, stopped: &mut dyn FnMut() -> bool) -> Option<Vec<Complex<f64>>> {
        let s = Complex::new(0.0, omega);
        let one = |entry: Complex<f64>| DMatrix::from_element(1, 1, entry);
        let factors = SchemeFactors {
            mass: one(s * s),
            stiffness: one(Complex::new(1.0, 0.0)),
            damping: self.transfers.iter().map(|transfer| one(transfer.value(s))).collect(),
            load: vec![Complex::new(1.0, 0.0)],
            answer: only(0, 1),
        };
        self.solve(&factors, input, stopped)
    }

    /// The same for the discrete scheme at its step h, for 0 < ω ≤ π/h: q_k = H_h(ω) e^{iωt_k} under the
    /// force e^{iωt}, which the scheme evaluates at its nodes.
    ///
    /// # Errors
    /// A message, if the equations have no accurate solution, or the scheme has no such response, as on
    /// different steps.
    pub fn discrete_response(&self, omega: f64, input: usize) -> Result<Vec<Complex<f64>>, String> {
        self.discrete_response_unless(omega, input, &mut || false)
    }

    /// The same, as [`response_unless`](Self::response_unless).
    ///
    /// # Errors
    /// As [`discrete_response`](Self::discrete_response).
    #[doc(hidden)]
    pub fn discrete_response_unless(
        &self,
        omega: f64,
        input: usize,
        stopped: &mut dyn FnMut() -> bool,
    ) -> Result<Vec<Complex<f64>>, String> {
        let scheme = self.scheme.as_ref().map_err(Clone::clone)?;
        let found = match scheme {
            StepEquations::Gauss(modes) => self.of_modes(modes, omega, input, stopped),
            _ => scheme.factors(self.step, omega).and_then(|factors| self.solve(&factors, input, stopped)),
        };
        found.ok_or_else(|| unsolved(omega))
    }

    fn of_modes(
        &self,
        modes: &GaussModes,
        omega: f64,
        input: usize,
        stopped: &mut dyn FnMut() -> bool,
    ) -> Option<Vec<Complex<f64>>> {
        let mut sum = Vec::new();
        for (frequency, weight) in modes.at(self.step, omega)? {
            let column = self.at(frequency, input, stopped)?;
            sum.resize(column.len(), Complex::ZERO);
            sum.iter_mut().zip(column).for_each(|(place, number)| *place += weight * number);
        }
        Some(sum)
    }

    /// A(s)⁻¹ f for A(s) = s²M + K + Σ_m ρ_m K_m(s), Re s ≥ 0, and ln det A(s) on any branch: A is analytic
    /// in the right half-plane, and the zeros of its determinant there are growing motions.
    ///
    /// # Errors
    /// A message, if the equations have no solution, or the system is solved by sparse factors.
    pub fn transfer(
        &self,
        s: Complex<f64>,
        load: &[f64],
    ) -> Result<(Vec<Complex<f64>>, Complex<f64>), String> {
        let Equations::Dense { mass, stiffness, damping } = &self.equations else {
            return Err(format!("its determinant is taken of systems of up to {DENSE} coordinates"));
        };
        let size = self.size;
        let values: Vec<_> = self.transfers.iter().map(|transfer| transfer.value(s)).collect();
        let mut matrix = vec![Complex::ZERO; size * size];
        for row in 0..size {
            for column in 0..size {
                let place = (row, column);
                let entry = s * s * mass[place] + stiffness[place];
                let damped = values.iter().zip(damping);
                matrix[row * size + column] =
                    damped.fold(entry, |sum, (value, rho)| sum + value * rho[place]);
            }
        }
        let unsolved = || format!("no solution at s = {s}: a motion that nothing damps");
        let on_free = |[directions, _]: &[DMatrix<f64>; 2]| {
            let columns = directions.column_iter();
            columns.map(|column| column.iter().zip(load).map(|(n, force)| n * force).sum()).collect()
        };
        let load: Vec<f64> = self.free.as_ref().map_or_else(|| load.to_vec(), on_free);
        let mut solution: Vec<_> = load.into_iter().map(|force| Complex::new(force, 0.0)).collect();
        let logarithm = log_determinant(&mut matrix.clone(), size).ok_or_else(unsolved)?;
        solve_complex(&mut matrix, &mut solution).ok_or_else(unsolved)?;
        Ok((self.coordinates(&solution), logarithm))
    }

    /// M v.
    pub fn momentum(&self, velocity: &[Complex<f64>]) -> Option<Vec<Complex<f64>>> {
        let Equations::Dense { mass, .. } = &self.equations else { return None };
        let mass = self.free.as_ref().map_or(mass, |[_, whole]| whole);
        let row = |row: usize| velocity.iter().enumerate().map(|(column, v)| v * mass[(row, column)]).sum();
        Some((0..mass.nrows()).map(row).collect())
    }

    /// The reason why the scheme has no discrete response; `None` if it has.
    pub fn without_discrete_response(&self) -> Option<&str> {
        self.scheme.as_ref().err().map(String::as_str)
    }

    /// A kernel that may have poles of its own which are not known, as a formula that is neither rational nor
    /// made up by its cut: beside them [`poles`](Self::poles) may miss zeros.
    pub fn kernel_of_unknown_poles(&self) -> Option<&TransferFunction> {
        self.transfers.iter().find(|transfer| !poles::is_known(transfer))
    }

    /// The zeros s of det(s²M + K + Σ_m ρ_m K_m(s)) on the principal sheet with Im s ≥ 0, ordered by their
    /// frequencies; for Im s > 0 the conjugate is a zero too. Zeros at s = 0, of unconstrained motions, are
    /// left out.
    ///
    /// # Errors
    /// A message, if there are too many coupled coordinates, or zeros are too close to be separated.
    pub fn poles(&self) -> Result<Vec<SystemPole>, String> {
        if self.transfers.iter().any(|transfer| transfer.table().is_some()) {
            return Err(OF_WEIGHTS.to_owned());
        }
        if self.has_tables_over_time() {
            return Err("a kernel is a table over time, which tells K(s) to the left of the imaginary axis near given frequencies \
                        only, as `--near` (in Python `near`) seeks modes"
                .to_owned());
        }
        let Equations::Dense { mass, stiffness, damping } = &self.equations else {
            return Err(format!(
                "poles are sought in systems of up to {DENSE} coordinates, or given by full matrices"
            ));
        };
        if let Some(row) = (0..self.size).find(|&row| mass.row(row).amax() == 0.0) {
            return Err(format!(
                "coordinate {row} has no mass; poles are sought where every coordinate has one"
            ));
        }
        let damping = damping
            .iter()
            .zip(&self.transfers)
            .map(|(rho, transfer)| LinearDamping { coefficients: rho.clone(), transfer: transfer.clone() });
        let system =
            LinearSystem::new(mass, stiffness, damping.collect()).map_err(|error| error.to_string())?;
        let parts = system.parts().ok_or_else(|| {
            let most = stability::LARGEST_PART;
            format!("poles are sought where up to {most} coordinates are coupled")
        })?;
        let mut found = Vec::new();
        for part in &parts {
            found.extend(poles::poles_of(part, &self.transfers)?);
        }
        found.sort_by(|a, b| a.frequency().total_cmp(&b.frequency()).then(a.place.im.total_cmp(&b.place.im)));
        Ok(found)
    }

    /// The `count` modes nearest to iω, |s − iω| < 0.999 ω, by their distance, and those that are as near as
    /// the last of them; fewer if there are no more. They are the zeros of the same determinant, of systems
    /// of any size, and their number is that of the argument principle. `stopped` is asked now and then; if
    /// it says so, there is an error.
    ///
    /// Kernels that are tables over time up to T are taken as zero, or as their decay, after T; zeros that
    /// tables up to T/2 would change by more than 10⁻³ of |s| are none, and the disc ends before them.
    ///
    /// # Errors
    /// A message, if the kernels do not tell the modes, or they cannot be separated.
    pub fn modes(
        &self,
        omega: f64,
        count: usize,
        stopped: &mut dyn FnMut() -> bool,
    ) -> Result<Vec<SystemMode>, String> {
        if self.transfers.iter().any(|transfer| transfer.table().is_some()) {
            return Err(OF_WEIGHTS.to_owned());
        }
        if !(omega > 0.0 && omega.is_finite()) || count == 0 || count > MOST_MODES {
            return Err(format!(
                "modes are sought near a positive frequency, 1 to {MOST_MODES} of them; not {count} near ω = {omega}"
            ));
        }
        modes::near(self, omega, count, stopped)
    }

    /// True if a kernel is a table over time, which tells K(s) to the left of the imaginary axis as far as
    /// its end tells nothing.
    #[doc(hidden)]
    pub fn has_tables_over_time(&self) -> bool {
        self.transfers.iter().any(|transfer| transfer.halved().is_some())
    }

    /// The displacements of the coordinates for those of the unknowns.
    fn coordinates(&self, unknowns: &[Complex<f64>]) -> Vec<Complex<f64>> {
        let Some([directions, _]) = &self.free else { return unknowns.to_vec() };
        let along = |row: usize| unknowns.iter().zip(directions.row(row).iter()).map(|(x, n)| x * *n).sum();
        (0..directions.nrows()).map(along).collect()
    }

    /// The response of all coordinates to a force on one of them.
    fn solve(
        &self,
        factors: &SchemeFactors,
        input: usize,
        stopped: &mut dyn FnMut() -> bool,
    ) -> Option<Vec<Complex<f64>>> {
        let nodes = factors.load.len();
        let mut vector = vec![Complex::ZERO; nodes * self.size];
        for (node, load) in vector.chunks_exact_mut(self.size).zip(&factors.load) {
            match &self.free {
                None => node[input] = *load,
                Some([directions, _]) => {
                    let entries = directions.row(input);
                    node.iter_mut().zip(entries.iter()).for_each(|(place, &entry)| *place = load * entry);
                }
            }
        }
        match &self.equations {
            Equations::Dense { mass, stiffness, damping } => {
                let mut matrix = vec![Complex::ZERO; vector.len() * vector.len()];
                match (&self.bent, factors.damping.len() > damping.len()) {
                    (Some(bent), true) => {
                        let damping: Vec<_> = damping.iter().chain([bent]).cloned().collect();
                        factors.add_to(&mut matrix, mass, stiffness, &damping);
                    }
                    _ => factors.add_to(&mut matrix, mass, stiffness, damping),
                }
                solve_complex(&mut matrix, &mut vector)?;
            }
            Equations::Sparse { pattern, solver, .. } => {
                let of_matrices = [factors.mass[(0, 0)], factors.stiffness[(0, 0)]].into_iter();
                let of_matrices: Vec<_> =
                    of_matrices.chain(factors.damping.iter().map(|factor| factor[(0, 0)])).collect();
                solver.factored(pattern, self.entries(&of_matrices), stopped)?.solve(&mut vector).ok()?;
            }
        }
        let mut answer = vec![Complex::ZERO; self.size];
        for (node, share) in vector.chunks_exact(self.size).zip(&factors.answer) {
            answer.iter_mut().zip(node).for_each(|(sum, number)| *sum += share * number);
        }
        Some(self.coordinates(&answer))
    }

    /// The highest frequency for which kernels given by weights are known; `None` without such kernels.
    pub fn highest(&self) -> Option<f64> {
        let is_given = self.transfers.iter().any(|transfer| transfer.table().is_some());
        is_given.then_some(std::f64::consts::PI / self.step)
    }

    /// The damping terms' transfer functions.
    pub fn kernels(&self) -> &[TransferFunction] {
        &self.transfers
    }
}

/// Why kernels given by weights have no poles.
const OF_WEIGHTS: &str = "weights of a file do not tell K(s) to the left of the imaginary axis";

fn unsolved(omega: f64) -> String {
    format!("no solution at ω = {omega}: the system is at a resonance without damping, or too close to one")
}

fn sparse<'a>(size: usize, matrices: impl Iterator<Item = &'a Matrix<f64>>) -> Equations {
    let entries: Vec<Vec<(usize, usize, f64)>> = matrices.map(Matrix::entries).collect();
    let places = entries.iter().flatten().flat_map(|&(row, column, _)| [(row, column), (column, row)]);
    let pattern = Arc::new(Pattern::new(size, places.chain((0..size).map(|row| (row, row))).collect()));
    let slots = entries.iter().map(|entries| {
        entries.iter().map(|&(row, column, entry)| (pattern.slot(row, column), entry)).collect()
    });
    Equations::Sparse { solver: ComplexSolver::new(&pattern), slots: slots.collect(), pattern }
}
