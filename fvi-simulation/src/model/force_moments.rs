//! Exact moments of forces that are rough in time.

use super::moment::moment;
use crate::model::tape::{CompiledForce, RoughArguments, Singularity, TimeTerms};
use fvi_core::{Instant, NodalRule, Real, max_or_nan};
use fvi_scenario::language::expression::{Expression, Moment};

/// Moments of the part of a force that depends on time alone, for steps where a quadrature is not accurate
/// enough.
///
/// A scheme approximates ∫₀¹ ℓ_ν(τ) F(t_k + τh) dτ by Σ_i b_i ℓ_ν(c_i) F(t_k + c_i h). That is inaccurate
/// with a jump or kink inside the step, and with a root in the step or near it: √t reduces the order of every
/// scheme to 3/2. There the integrals are computed piecewise between the rough points: by the
/// double-exponential rule \[TakahasiMori74\] if a root is close, by Gauss–Kronrod quadrature otherwise. The
/// same is done if a term of the force is narrower than the step. Forces without such points, and all steps
/// far from them, have no additional cost.
///
/// Collocation takes forces at its nodes only. The moment correction for it consists of forces at the nodes
/// that have the moments of the force with as many polynomials as there are nodes, and is used across rough
/// points and narrow terms only.
#[derive(Clone, Debug)]
pub struct ForceMoments {
    force: CompiledForce<f64>,
    rough: RoughArguments,
    /// Terms that may be narrower than a step; `None` if all steps are known to be short enough.
    terms: Option<TimeTerms>,
    /// Times at which the force is unbounded: then the scheme does not evaluate it, and the moment correction
    /// is the whole of its moments.
    unbounded: Option<Vec<Singularity>>,
    coordinates: usize,
    lengths: StepLengths,
    end: f64,
    /// The step size for which the reaches were computed.
    step_size: f64,
    /// For each argument the distance from its zero, in steps, up to which the nodes are not accurate enough;
    /// infinite if it is cheaper to check each step.
    reaches: Vec<f64>,
    registers: Vec<f64>,
    values: Vec<f64>,
    load: Vec<f64>,
    breaks: Vec<f64>,
    /// Σ of the pieces, (S + 1)·N numbers.
    total: Vec<f64>,
    /// Dyadic parts of the run that contain the step, and whether they are smooth.
    cells: Vec<(f64, f64, bool)>,
    /// Time from which rough points may have been overlooked.
    unresolved_since: Option<f64>,
}

/// Lengths of the steps to come. They determine how moments are computed, such that a run continued from a
/// checkpoint has the same moments as an uninterrupted one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepLengths {
    /// All of one length.
    Equal,
    /// Of different lengths.
    Any,
}

/// Distance, in fractions of a step, below which two breaks are one.
const APART: f64 = 4.0 * f64::EPSILON;

/// Largest number of pieces of a step with a narrow term, and of their halvings.
const MOST_PIECES: usize = 4096;
const MOST_HALVINGS_OF_NARROW: u32 = 44;

/// Distance, in fractions of a step, from another break below which a zero of an argument is not a separate
/// one.
const NEAR: f64 = 1e-9;

/// Number of parts of a run that are examined to find out whether all its steps are smooth.
const CELLS: usize = 64;

/// Weight functions against which a piece of a step is integrated.
#[derive(Clone, Debug)]
pub(super) enum TestFunction {
    /// The polynomials ℓ_0 … ℓ_S on 0 and these points.
    Shapes(Vec<f64>),
    /// The Lagrange polynomials of these nodes divided by the weights there: the integrals are forces at the
    /// nodes.
    AtNodes(Vec<f64>, Vec<f64>),
}

/// Spacing of the double-exponential rule, and its extent: its points come as near as 10⁻³⁷ of the piece to
/// the ends.
const SPACING: f64 = 1.0 / 8.0;
const EXTENT: i32 = 32;

/// Largest number of halvings of a piece while its two rules disagree.
const MOST_HALVINGS: u32 = 12;

/// Size of a correction, relative to the force, below which it is rounding.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// The nodes in (0, 1] of Kronrod's rule with 15 nodes, from the outermost one, their weights, and the
/// weights of Gauss's rule with seven of them.
const KRONROD: [(f64, f64, f64); 8] = [
    (0.991_455_371_120_812_6, 0.022_935_322_010_529_224, 0.0),
    (0.949_107_912_342_758_5, 0.063_092_092_629_978_55, 0.129_484_966_168_869_7),
    (0.864_864_423_359_769_1, 0.104_790_010_322_250_19, 0.0),
    (0.741_531_185_599_394_4, 0.140_653_259_715_525_92, 0.279_705_391_489_276_64),
    (0.586_087_235_467_691_1, 0.169_004_726_639_267_9, 0.0),
    (0.405_845_151_377_397_2, 0.190_350_578_064_785_4, 0.381_830_050_505_118_9),
    (0.207_784_955_007_898_47, 0.204_432_940_075_298_9, 0.0),
    (0.0, 0.209_482_141_084_727_83, 0.417_959_183_673_469_4),
];

impl ForceMoments {
    /// Moments of a force with one expression for each coordinate in a run to `end`, whose steps are no
    /// longer than `longest` if that is known; `None` if no step needs them.
    pub fn new(
        components: &[Expression],
        lengths: StepLengths,
        (end, longest): (f64, Option<f64>),
    ) -> Option<Self> {
        if components.is_empty() {
            return None;
        }
        // Steps that are chosen on the way follow the terms anyway.
        let terms = longest.and_then(|_| TimeTerms::of(components, end));
        let step_size = longest.unwrap_or(f64::NAN);
        let mut moments = Self { terms, step_size, ..Self::whole(components, lengths, end, None) };
        if moments.terms.is_some() && longest.is_some_and(|step| moments.is_smooth_everywhere(step)) {
            moments.terms = None;
        }
        moments.step_size = f64::NAN;
        (!moments.reaches.is_empty() || moments.terms.is_some()).then_some(moments)
    }

    /// For all of a force: `unbounded` says where it has no bound, so that the scheme does not look at it.
    pub fn whole(
        components: &[Expression],
        lengths: StepLengths,
        end: f64,
        unbounded: Option<Vec<Singularity>>,
    ) -> Self {
        let rough = RoughArguments::of(components);
        let count = rough.arguments().len();
        Self {
            force: CompiledForce::compile(components),
            coordinates: components.len(),
            lengths,
            end,
            step_size: f64::NAN,
            reaches: vec![f64::INFINITY; count],
            registers: Vec::new(),
            values: vec![0.0; count],
            load: vec![0.0; components.len()],
            breaks: Vec::new(),
            total: Vec::new(),
            cells: Vec::new(),
            unresolved_since: None,
            rough,
            terms: None,
            unbounded,
        }
    }

    /// Time from which rough points may have been overlooked.
    pub fn unresolved_since(&self) -> Option<f64> {
        self.unresolved_since
    }

    /// Exact moments minus those of the nodes, ν = 0…S, N numbers each; `None` if the nodes are accurate
    /// enough. For a rule without shapes, that of collocation: corrections of the forces at the nodes.
    pub fn moment_correction<T: Real>(&mut self, rule: &NodalRule<'_, T>) -> Option<&[f64]> {
        let (start, length) = (rule.start.to_f64(), rule.length.to_f64());
        let against = TestFunction::of(rule);
        if let Some(singularities) = self.unbounded.take() {
            self.find_breaks((start, length), sides_of_step(rule));
            let finite = self.integrate_whole(&against, &singularities, start, length);
            self.unbounded = Some(singularities);
            if !finite {
                self.unresolved_since.get_or_insert(start);
                return None;
            }
            return Some(self.total.as_slice());
        }
        let collocation = matches!(against, TestFunction::AtNodes(..));
        if self.step_size != length {
            self.step_size = length;
            if self.lengths == StepLengths::Equal && !collocation {
                self.find_reaches(rule);
            }
        }
        let (near_root, narrow) = self.find_breaks((start, length), sides_of_step(rule))?;
        if collocation && self.breaks.is_empty() && !narrow {
            return None;
        }
        let rough =
            self.integrate(rule, &against, start, length, near_root) && self.total.iter().any(|&e| e != 0.0);
        rough.then_some(self.total.as_slice())
    }

    /// True if the whole run is smooth for steps of this length, as far as a limited number of checks shows.
    fn is_smooth_everywhere(&mut self, step: f64) -> bool {
        let mut cells = vec![(0.0, self.end)];
        for _ in 0..CELLS {
            let Some((from, to)) = cells.pop() else { return true };
            if self.terms.as_mut().is_none_or(|terms| terms.is_described((from, to), step)) {
                continue;
            }
            if to - from <= 2.0 * step {
                return false;
            }
            let middle = 0.5 * (from + to);
            cells.extend([(middle, to), (from, middle)]);
        }
        cells.is_empty()
    }

    /// True if no curved argument changes its sign, and no term is narrow, in the largest dyadic part of the
    /// run around this step for which that can be decided. The result does not depend on earlier calls.
    fn is_in_smooth_cell(&mut self, start: f64, length: f64) -> bool {
        if self.lengths != StepLengths::Equal {
            return false;
        }
        let end = start + length;
        while self.cells.last().is_some_and(|&(from, to, _)| start < from || to < end) {
            self.cells.pop();
        }
        if self.cells.is_empty() {
            let whole = (0.0, self.end + length);
            let smooth = self.is_smooth_cell(whole, length);
            self.cells.push((whole.0, whole.1, smooth));
        }
        while let Some(&(from, to, smooth)) = self.cells.last() {
            if smooth {
                return true;
            }
            let middle = 0.5 * (from + to);
            let cell = match () {
                () if to - from <= 2.0 * length => return false,
                () if end <= middle => (from, middle),
                () if start >= middle => (middle, to),
                () => return false,
            };
            let smooth = self.is_smooth_cell(cell, length);
            self.cells.push((cell.0, cell.1, smooth));
        }
        false
    }

    /// True if no curved argument changes its sign in a range of time and no term is narrow for steps of this
    /// length.
    pub(super) fn is_smooth_cell(&mut self, (from, to): (f64, f64), length: f64) -> bool {
        let rough = &self.rough;
        let mut curved = rough.arguments().iter().enumerate().filter(|(_, argument)| argument.zero.is_none());
        curved.all(|(index, _)| rough.keeps_sign(index, from, to))
            && self.terms.as_mut().is_none_or(|terms| terms.is_described((from, to), length))
    }

    /// Finds the rough points inside a step. `None` if the step is smooth; otherwise whether a root is close,
    /// and whether a term is narrow.
    fn find_breaks(
        &mut self,
        (start, length): (f64, f64),
        (first, last): (f64, f64),
    ) -> Option<(bool, bool)> {
        self.breaks.clear();
        let (mut rough, mut near_root) = (false, false);
        let (mut curved, mut curved_root) = (false, false);
        for (argument, &reach) in self.rough.arguments().iter().zip(&self.reaches) {
            let Some(zero) = argument.zero else {
                curved = true;
                curved_root |= argument.root;
                continue;
            };
            let place = (zero - start) / length;
            let inside = place > first && place < 1.0 - last;
            if inside {
                self.breaks.push(place);
            }
            let distance = (-place).max(place - 1.0).max(0.0);
            rough |= inside || (argument.root && distance <= reach);
            near_root |= argument.root && distance < 1.0;
        }
        let mut at_root = near_root;
        if curved_root {
            (rough, near_root) = (true, true);
        }
        let mut narrow = false;
        if (curved || self.terms.is_some()) && !self.is_in_smooth_cell(start, length) {
            if curved {
                let (found, touches) = self.find_curved((start, length), (first, last));
                rough |= found;
                at_root |= touches;
            }
            self.breaks.sort_by(f64::total_cmp);
            self.breaks.dedup_by(|a, b| *a - *b < APART);
            // A force is never smooth towards a root: the double-exponential rule is dense there.
            if !at_root {
                // Breaks at the ends count if they are inside, up to the rounding of numbers as large as
                // times may be.
                let scale = start.abs() + self.end.min(1e3 * length);
                let slack = first.max(last) * length + 64.0 * f64::EPSILON * scale;
                narrow = self.split_narrow(start, length, slack);
                rough |= narrow;
            }
        }
        self.breaks.sort_by(f64::total_cmp);
        self.breaks.dedup_by(|a, b| *a - *b < APART);
        rough.then_some((near_root, narrow))
    }

    /// Adds the zeros of curved arguments; returns whether there are any, and whether one under a root has or
    /// may have a zero.
    fn find_curved(&mut self, (start, length): (f64, f64), (first, last): (f64, f64)) -> (bool, bool) {
        let (mut found, mut touches) = (false, false);
        for index in 0..self.rough.arguments().len() {
            let argument = self.rough.arguments()[index];
            if argument.zero.is_some() || self.rough.keeps_sign(index, start, start + length) {
                continue;
            }
            touches |= argument.root;
            let breaks = &mut self.breaks;
            let changes = self.rough.changes(
                index,
                (start, length),
                (&mut self.registers, &mut self.values),
                |place, changes| {
                    // An argument that touches zero is often the absolute value of one that changes its sign
                    // there.
                    let is_new =
                        changes || breaks.iter().chain(&[0.0, 1.0]).all(|other| (other - place).abs() > NEAR);
                    if is_new && place > first && place < 1.0 - last {
                        breaks.push(place);
                        found = true;
                    }
                    true
                },
            );
            if let Err(time) = changes {
                self.unresolved_since.get_or_insert(time);
            }
        }
        (found, touches)
    }

    /// If the step's nodes do not resolve every term, adds breaks between which a quadrature resolves each.
    fn split_narrow(&mut self, start: f64, length: f64, slack: f64) -> bool {
        let Some(terms) = &mut self.terms else { return false };
        if self.breaks.is_empty() && terms.is_described_in_step(start, length, slack) {
            return false;
        }
        let was_smooth = self.breaks.is_empty();
        let mut edges = vec![1.0];
        edges.extend(self.breaks.iter().rev());
        edges.push(0.0);
        let mut pieces: Vec<_> = edges.windows(2).map(|edges| (edges[1], edges[0], 0)).collect();
        let before = self.breaks.len();
        // The first piece is at the end of the list.
        while let Some((from, to, halvings)) = pieces.pop() {
            let at = |place: f64| start + place * length;
            if halvings >= MOST_HALVINGS_OF_NARROW || terms.is_described_in_piece(at(from), at(to), slack) {
                continue;
            }
            if self.breaks.len() >= before + MOST_PIECES {
                self.unresolved_since.get_or_insert(at(from));
                break;
            }
            let middle = 0.5 * (from + to);
            self.breaks.push(middle);
            pieces.push((middle, to, halvings + 1));
            pieces.push((from, middle, halvings + 1));
        }
        was_smooth || self.breaks.len() > before
    }

    /// Finds the distance from the zeros of linear arguments under roots up to which the nodes are not
    /// accurate enough: the moment correction decreases like a power of the distance.
    fn find_reaches<T: Real>(&mut self, rule: &NodalRule<'_, T>) {
        let against = TestFunction::of(rule);
        for index in 0..self.rough.arguments().len() {
            let argument = self.rough.arguments()[index];
            let (Some(zero), true) = (argument.zero, argument.root) else { continue };
            let length = self.step_size;
            let mut reach = 1.0;
            while reach < 1e12 {
                let sides = [zero + reach * length, zero - (reach + 1.0) * length];
                let rough = sides.iter().any(|&start| {
                    self.breaks.clear();
                    self.integrate(rule, &against, start, length, false)
                        && self.total.iter().any(|&e| e != 0.0)
                });
                if !rough {
                    break;
                }
                reach *= 2.0;
            }
            self.reaches[index] = reach;
        }
    }

    /// Leaves in `total` the integrals over the pieces minus those of the nodes, zero if that is rounding.
    /// Returns `false` if the force is not finite.
    fn integrate<T: Real>(
        &mut self,
        rule: &NodalRule<'_, T>,
        against: &TestFunction,
        start: f64,
        length: f64,
        near_root: bool,
    ) -> bool {
        self.total.clear();
        self.total.resize(against.rows() * self.coordinates, 0.0);
        let mut edges = std::mem::take(&mut self.breaks);
        edges.insert(0, 0.0);
        edges.push(1.0);
        let mut finite = true;
        for piece in edges.windows(2) {
            let piece = (piece[0], piece[1]);
            finite &= if near_root {
                self.double_exponential(against, (start, length), piece)
            } else {
                self.kronrod(against, (start, length), piece, 0)
            };
        }
        if !finite {
            return false;
        }
        let mut largest = 0.0_f64;
        for i in 0..rule.nodes.len() {
            self.force.load(node_moment(rule, i), &mut self.registers, &mut self.load);
            largest = self.load.iter().map(|number| number.abs()).fold(largest, max_or_nan);
            against.subtract_node(rule, i, &self.load, &mut self.total);
        }
        if self.total.iter().any(|number| !number.is_finite()) {
            return false;
        }
        for number in &mut self.total {
            if number.abs() <= ROUNDING * largest {
                *number = 0.0;
            }
        }
        true
    }

    /// Leaves in `total` the integrals over the pieces, for a force that is unbounded at some times; returns
    /// `false` if it is not finite elsewhere.
    fn integrate_whole(
        &mut self,
        against: &TestFunction,
        singularities: &[Singularity],
        start: f64,
        length: f64,
    ) -> bool {
        self.total.clear();
        self.total.resize(against.rows() * self.coordinates, 0.0);
        // A grid point equals the time of the singularity up to rounding.
        let same = |place: f64, other: f64| {
            (place - other).abs() <= 16.0 * f64::EPSILON * (1.0 + start.abs() / length)
        };
        let place_of = |singularity: &Singularity| {
            let place = (singularity.time - start) / length;
            [0.0, 1.0].into_iter().find(|&end| same(place, end)).unwrap_or(place)
        };
        let mut edges = vec![0.0, 1.0];
        let inside = || singularities.iter().map(place_of).filter(|place| (0.0..=1.0).contains(place));
        edges.extend(inside());
        let apart = |place: &f64| inside().all(|other| (other - place).abs() > NEAR);
        edges.extend(self.breaks.iter().copied().filter(apart));
        edges.sort_by(f64::total_cmp);
        edges.dedup_by(|a, b| same(*a, *b));
        let at = |place: f64| singularities.iter().find(|singularity| same(place_of(singularity), place));
        let mut finite = true;
        for piece in edges.windows(2) {
            let (from, to) = (piece[0], piece[1]);
            let (left, right) = (at(from), at(to));
            let middle = if left.is_some() && right.is_some() { 0.5 * (from + to) } else { to };
            finite &= match left {
                Some(singularity) => self.beside(against, length, (from, middle), singularity, 1.0),
                None if right.is_none() => self.kronrod(against, (start, length), (from, to), 0),
                None => true,
            };
            if let Some(singularity) = right {
                let from = if left.is_some() { middle } else { from };
                finite &= self.beside(against, length, (to, from), singularity, -1.0);
            }
        }
        finite && self.total.iter().all(|number| number.is_finite())
    }

    /// The integral from a singularity to another place, on the side given by the sign. With δ = u^m, m =
    /// 1/(1 + e), the integrand is a smooth function of u.
    fn beside(
        &mut self,
        against: &TestFunction,
        length: f64,
        (from, to): (f64, f64),
        singularity: &Singularity,
        sign: f64,
    ) -> bool {
        let exponent = singularity.exponents[usize::from(sign > 0.0)];
        let power = (1.0 / (1.0 + exponent)).max(if exponent > -0.2 { 4.0 } else { 2.0 });
        let width = (to - from).abs();
        // Where the rounding of the time would matter, the force is replaced by its power law; a logarithm is
        // not affected.
        let time = singularity.time;
        let close = match () {
            () if time == 0.0 => 1e-290,
            // Late in time, where the rest of the run is hardly longer than that, with fewer digits.
            () if exponent < -0.2 => {
                let rest = if self.end > time { 1e-3 * (self.end - time) } else { f64::INFINITY };
                (1e-8 * time.abs()).min(rest.max(64.0 * f64::EPSILON * time.abs()))
            }
            () => 1e-14 * time.abs(),
        };
        let pieces = 16;
        let mut finite = true;
        for piece in 0..pieces {
            let (low, high) =
                (f64::from(piece) / f64::from(pieces), f64::from(piece + 1) / f64::from(pieces));
            let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
            for &(node, weight, _) in &KRONROD {
                let sides: &[f64] = if node == 0.0 { &[0.0] } else { &[-1.0, 1.0] };
                for side in sides {
                    let u = middle + half * node * side;
                    let share = libm::pow(u, power);
                    let distance = width * share;
                    let slope = half * weight * width * power * share / u;
                    let (near, factor) = match distance * length {
                        away if away < close => {
                            (close, libm::exp(exponent * (libm::log(away) - libm::log(close))))
                        }
                        away => (away, 1.0),
                    };
                    self.force.load(Moment::inside(time + sign * near), &mut self.registers, &mut self.load);
                    if self.load.iter().any(|number| !number.is_finite()) {
                        finite = false;
                        continue;
                    }
                    against.add(from + sign * distance, slope * factor, &self.load, &mut self.total);
                }
            }
        }
        finite
    }

    /// Adds weight · ℓ_ν(place) F(place) to the moments; `false` if F is not finite there.
    fn add(&mut self, against: &TestFunction, (start, length): (f64, f64), place: f64, weight: f64) -> bool {
        self.force.load(Moment::inside(start + place * length), &mut self.registers, &mut self.load);
        if self.load.iter().any(|number| !number.is_finite()) {
            return false;
        }
        against.add(place, weight, &self.load, &mut self.total);
        true
    }

    /// The double-exponential rule: τ = q/(1 + q) of the piece from its ends, q = e^{−π sinh s}.
    fn double_exponential(
        &mut self,
        against: &TestFunction,
        step: (f64, f64),
        (from, to): (f64, f64),
    ) -> bool {
        let width = to - from;
        let mut finite = true;
        for index in -EXTENT..=EXTENT {
            let s = SPACING * f64::from(index);
            let q = libm::exp(-std::f64::consts::PI * libm::sinh(s.abs()));
            let distance = width * q / (1.0 + q);
            let place = if index < 0 { from + distance } else { to - distance };
            let weight = width * SPACING * std::f64::consts::PI * libm::cosh(s) * q / ((1.0 + q) * (1.0 + q));
            // Very close to an end rounding may move a point beyond it.
            finite &= self.add(against, step, place, weight) || weight < 1e-12 * width;
        }
        finite
    }

    /// Kronrod's rule with 15 nodes; the piece is halved while Gauss's rule with seven of them disagrees.
    fn kronrod(
        &mut self,
        against: &TestFunction,
        step: (f64, f64),
        (from, to): (f64, f64),
        halvings: u32,
    ) -> bool {
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        let places = KRONROD.iter().flat_map(|&(node, weight, gauss)| {
            let sides = if node == 0.0 { vec![0.0] } else { vec![-node, node] };
            sides.into_iter().map(move |node| (middle + half * node, half * weight, half * gauss))
        });
        let places: Vec<_> = places.collect();
        // The force alone, without shapes, determines whether the nodes are dense enough.
        let mut difference = vec![0.0_f64; self.coordinates];
        let mut size = 0.0_f64;
        for &(place, weight, gauss) in &places {
            self.force.load(Moment::inside(step.0 + place * step.1), &mut self.registers, &mut self.load);
            for (difference, &force) in difference.iter_mut().zip(&self.load) {
                *difference += (weight - gauss) * force;
                size = size.max(force.abs());
            }
        }
        let error = difference.iter().map(|number| number.abs()).fold(0.0, max_or_nan);
        // Kronrod's error is about the square of Gauss's.
        if error > 1e-9 * size * half && halvings < MOST_HALVINGS {
            return self.kronrod(against, step, (from, middle), halvings + 1)
                & self.kronrod(against, step, (middle, to), halvings + 1);
        }
        places
            .iter()
            .fold(true, |finite, &(place, weight, _)| self.add(against, step, place, weight) & finite)
    }
}

impl TestFunction {
    pub(super) fn of<T: Real>(rule: &NodalRule<'_, T>) -> Self {
        let numbers = |numbers: &[T]| numbers.iter().map(|number| number.to_f64()).collect();
        if rule.shapes.is_empty() {
            Self::AtNodes(numbers(rule.nodes), numbers(rule.weights))
        } else {
            Self::Shapes(numbers(rule.points))
        }
    }

    /// Number of integrals for each coordinate.
    pub(super) fn rows(&self) -> usize {
        match self {
            Self::Shapes(points) => points.len() + 1,
            Self::AtNodes(nodes, _) => nodes.len(),
        }
    }

    /// Adds the contribution of a place inside a piece.
    pub(super) fn add(&self, place: f64, weight: f64, force: &[f64], total: &mut [f64]) {
        match self {
            Self::Shapes(points) => add_shapes(points, place, weight, force, total),
            Self::AtNodes(nodes, weights) => {
                for (j, sums) in total.chunks_exact_mut(force.len()).enumerate() {
                    let others = nodes.iter().enumerate().filter(|&(index, _)| index != j);
                    let shape: f64 = others.map(|(_, other)| (place - other) / (nodes[j] - other)).product();
                    let factor = weight * shape / weights[j];
                    sums.iter_mut().zip(force).for_each(|(sum, force)| *sum += factor * force);
                }
            }
        }
    }

    /// Subtracts the contribution of the i-th node of a rule, with F there.
    pub(super) fn subtract_node<T: Real>(
        &self,
        rule: &NodalRule<'_, T>,
        i: usize,
        force: &[f64],
        total: &mut [f64],
    ) {
        match self {
            Self::Shapes(_) => subtract_node(rule, i, force, total),
            Self::AtNodes(..) => {
                let sums = total.chunks_exact_mut(force.len()).nth(i).unwrap_or(&mut []);
                sums.iter_mut().zip(force).for_each(|(sum, force)| *sum -= force);
            }
        }
    }
}

/// Distance from the beginning and from the end of a step, as fractions of it, within which a break is seen
/// by the nodes there from inside the step: see [`Moment`].
pub(super) fn sides_of_step<T: Real>(rule: &NodalRule<'_, T>) -> (f64, f64) {
    let length = rule.length.to_f64();
    let side = |moment: Moment<T>| {
        let moment = moment.in_double();
        (moment.sided - moment.time).abs() / length
    };
    (side(Moment::from_right(rule.start)), side(Moment::from_left(rule.start + rule.length)))
}

/// The moment at which a scheme evaluates the force in its i-th node.
pub(super) fn node_moment<T: Real>(rule: &NodalRule<'_, T>, i: usize) -> Moment<f64> {
    moment(Instant::in_step(rule.start, rule.nodes[i], rule.length)).in_double()
}

/// Gauss's seven places in a piece of a step, with their weights.
pub(super) fn gauss_places(from: f64, to: f64) -> impl Iterator<Item = (f64, f64)> {
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    KRONROD.iter().filter(|&&(_, _, gauss)| gauss != 0.0).flat_map(move |&(node, _, gauss)| {
        let other = (node != 0.0).then_some((middle - half * node, half * gauss));
        [Some((middle + half * node, half * gauss)), other].into_iter().flatten()
    })
}

/// Adds weight · ℓ_ν(place) F to the moments ν = 0…S.
fn add_shapes(points: &[f64], place: f64, weight: f64, force: &[f64], total: &mut [f64]) {
    for (nu, sums) in total.chunks_exact_mut(force.len()).enumerate() {
        let factor = weight * shape(points, nu, place);
        sums.iter_mut().zip(force).for_each(|(sum, force)| *sum += factor * force);
    }
}

/// Subtracts b_i ℓ_ν(c_i) F from the moments ν = 0…S.
fn subtract_node<T: Real>(rule: &NodalRule<'_, T>, i: usize, force: &[f64], total: &mut [f64]) {
    let degree = rule.points.len();
    for (nu, sums) in total.chunks_exact_mut(force.len()).enumerate() {
        let shape = match nu {
            nu if nu == degree => rule.shapes[i * degree + degree - 1],
            nu => rule.tests[i * degree + nu],
        };
        let factor = rule.weights[i].to_f64() * shape.to_f64();
        sums.iter_mut().zip(force).for_each(|(sum, force)| *sum -= factor * force);
    }
}

/// ℓ_ν(τ) on the points 0, d_1, …, d_S.
fn shape(points: &[f64], nu: usize, tau: f64) -> f64 {
    let point = |index: usize| if index == 0 { 0.0 } else { points[index - 1] };
    let own = point(nu);
    (0..=points.len())
        .filter(|&index| index != nu)
        .map(|index| (tau - point(index)) / (own - point(index)))
        .product()
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_core::{DiscreteLagrangian, Galerkin, Quadrature, RungeKutta};
    use fvi_scenario::language::expression::Symbols;

    fn rule<'a>(lagrangian: &DiscreteLagrangian<'a, f64>, start: f64, length: f64) -> NodalRule<'a, f64> {
        let DiscreteLagrangian { weights, nodes, control_points: points, shapes, tests, .. } = *lagrangian;
        NodalRule { start, length, weights, nodes, points, shapes, tests }
    }

    fn force(text: &str) -> Option<ForceMoments> {
        let expression = Expression::parse(text, &Symbols::new().with_time()).unwrap();
        ForceMoments::new(&[expression], StepLengths::Equal, (1e6, None))
    }

    /// ∫₀¹ F dτ and ∫₀¹ τ F dτ over a step, from the moment correction and the nodes, on straight lines.
    fn moments(text: &str, start: f64, length: f64, value: impl Fn(f64) -> f64) -> Option<[f64; 2]> {
        let midpoint = Galerkin::<f64, 1, 1>::low_order(0.5).unwrap();
        let mut force = force(text)?;
        let moment_correction = force.moment_correction(&rule(&midpoint.view(), start, length))?;
        let node = 0.5 * value(start + 0.5 * length);
        Some([moment_correction[0] + moment_correction[1] + 2.0 * node, moment_correction[1] + node])
    }

    fn assert_close(found: Option<[f64; 2]>, expected: [f64; 2]) {
        let found = found.expect("a rough step");
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() <= 4e-15 * expected.abs().max(1e-3), "{found} and {expected}");
        }
    }

    #[test]
    fn moments_of_roots_jumps_and_kinks_are_exact() {
        let (h, nu) = (0.25_f64, 0.3_f64);
        let root = |t: f64| t.powf(nu);
        assert_close(moments("t^0.3", 0.0, h, root), [h.powf(nu) / (nu + 1.0), h.powf(nu) / (nu + 2.0)]);
        let inverse = |t: f64| t.powf(-0.5);
        assert_close(moments("1/sqrt(t)", 0.0, h, inverse), [2.0 / h.sqrt(), 2.0 / 3.0 / h.sqrt()]);
        // A jump at a third of the step, and the same by a curved argument.
        let jump = |t: f64| if t < 1.1 { 2.0 } else { 0.0 };
        let third = 0.1 / 0.3;
        assert_close(moments("2*step(1.1 - t)", 1.0, 0.3, jump), [2.0 * third, third * third]);
        assert_close(moments("2*step(1.21 - t*t)", 1.0, 0.3, jump), [2.0 * third, third * third]);
        let kink = |t: f64| (t - 1.1).abs();
        let first = (0.1_f64 * 0.1 + 0.2 * 0.2) / 0.6;
        let second = (0.1_f64.powi(3) / 6.0 + 0.2_f64.powi(3) / 3.0 + 0.1 * 0.2 * 0.2 / 2.0) / 0.09;
        assert_close(moments("abs(t - 1.1)", 1.0, 0.3, kink), [first, second]);
        assert_close(moments("max(t - 1.1, 1.1 - t)", 1.0, 0.3, kink), [first, second]);
    }

    #[test]
    fn smooth_forces_and_steps_far_from_roots_are_left_to_the_nodes() {
        for text in ["sin(3*t)", "exp(-t^2)", "t^3 + 2", "step(1)*t", "1/(t + 2)^2"] {
            assert!(force(text).is_none(), "{text}");
        }
        let method = RungeKutta::<3>::radau_iia().unwrap();
        let radau = Galerkin::<f64, 3, 3>::new(method.quadrature()).unwrap();
        let mut root = force("sqrt(t)").unwrap();
        assert!(root.moment_correction(&rule(&radau.view(), 0.0, 0.01)).is_some());
        assert!(root.moment_correction(&rule(&radau.view(), 0.1, 0.01)).is_some());
        // With cubic polynomials the nodes are exact for linear forces: the moment correction falls like the
        // distance to the power −2.
        assert!(root.moment_correction(&rule(&radau.view(), 1e5, 0.01)).is_none());
        // The same without reaches, which are not computed for steps of different lengths.
        let mut graded = ForceMoments { lengths: StepLengths::Any, ..force("sqrt(t)").unwrap() };
        for (start, length) in [(0.0, 0.01), (0.1, 0.02), (1e5, 0.01)] {
            let found = graded.moment_correction(&rule(&radau.view(), start, length)).map(<[f64]>::to_vec);
            assert_eq!(found.as_deref(), root.moment_correction(&rule(&radau.view(), start, length)));
        }
        assert_eq!(graded.reaches, [f64::INFINITY]);
        // At a jump at a grid point the nodes on both sides see the limits from their steps.
        let mut pulse = force("8*step(1 - t)").unwrap();
        assert!(pulse.moment_correction(&rule(&radau.view(), 0.9, 0.1)).is_none());
        assert!(pulse.moment_correction(&rule(&radau.view(), 1.0, 0.1)).is_none());
        assert!(pulse.moment_correction(&rule(&radau.view(), 0.95, 0.1)).is_some());
    }

    #[test]
    fn narrow_terms_have_their_moments_and_kinks_at_grid_points_are_no_such() {
        let midpoint = Galerkin::<f64, 1, 1>::low_order(0.5).unwrap();
        let view = midpoint.view();
        let of_run = |text: &str, end: f64, step: f64| {
            let expression = Expression::parse(text, &Symbols::new().with_time()).unwrap();
            ForceMoments::new(&[expression], StepLengths::Equal, (end, Some(step)))
        };
        let mut pulse = of_run("1 + exp(-((t - 3.3)/1e-5)^2)/1e-5", 8.0, 0.1).unwrap();
        assert!(pulse.moment_correction(&rule(&view, 3.0, 0.1)).is_none());
        let moment_correction = pulse.moment_correction(&rule(&view, 3.25, 0.1)).unwrap();
        let impulse = 0.1 * (moment_correction[0] + moment_correction[1]);
        // The node is in the middle of the pulse: its contribution is subtracted.
        let expected = std::f64::consts::PI.sqrt() - 0.1 / 1e-5;
        assert!((impulse - expected).abs() < 1e-9 * expected.abs(), "{impulse}");
        for (text, end, step) in [
            ("max(1 - abs(t - 0.1)/0.1, 0)", 2.0, 0.002),
            ("sin(3*t)*step(t - 0.7)", 10.0, 0.1),
            ("t^2*step(1 - t)", 10.0, 0.1),
            ("abs(sin(t))", 100.0, 0.01),
            ("exp(-((t - 5)/0.5)^2)", 10.0, 0.05),
        ] {
            let mut kinked = of_run(text, end, step).unwrap();
            let steps = (end / step).round() as usize;
            let whole = (0..steps)
                .filter(|&k| kinked.moment_correction(&rule(&view, k as f64 * step, step)).is_some());
            // Steps that contain a zero of the sine.
            assert_eq!(whole.count(), if text.contains("abs(sin") { 31 } else { 0 }, "{text}");
        }
        for smooth in ["sin(3*t)*exp(-t)", "t^2 + 5", "1/(1 + t^2)"] {
            assert!(of_run(smooth, 10.0, 0.05).is_none(), "{smooth}");
        }
    }

    #[test]
    fn shapes_are_those_of_the_scheme() {
        let gauss = Galerkin::<f64, 2, 2>::new(&Quadrature::gauss().unwrap()).unwrap();
        let view = gauss.view();
        for (i, &node) in view.nodes.iter().enumerate() {
            for nu in 0..2 {
                assert!((shape(view.control_points, nu, node) - view.tests[2 * i + nu]).abs() < 1e-15);
                assert!((shape(view.control_points, nu + 1, node) - view.shapes[2 * i + nu]).abs() < 1e-15);
            }
        }
    }
}
