//! Exact moments of forces that are rough in time.

use super::moment::moment;
use crate::language::expression::{Expression, Moment};
use crate::model::tape::{CompiledForce, RoughArguments};
use fvi_core::{Instant, NodalRule, Real};

/// Moments of the part of a force that depends on time alone, where the nodes of a quadrature are not enough.
///
/// A scheme takes ∫₀¹ ℓ_ν(τ) F(t_k + τh) dτ as Σ_i b_i ℓ_ν(c_i) F(t_k + c_i h). A jump or kink inside the
/// step spoils that, and so does a root in the step or near it: √t costs every scheme all orders beyond 3/2.
/// There the integrals are taken piece by piece between the rough points: with the double-exponential rule
/// \[TakahasiMori74\] where a root is close, with Gauss's and Kronrod's nodes elsewhere. A force without such
/// points, and every step far from them, costs nothing.
#[derive(Clone, Debug)]
pub struct ForceMoments {
    force: CompiledForce<f64>,
    rough: RoughArguments,
    coordinates: usize,
    lengths: StepLengths,
    /// The step size that the reaches are for.
    step_size: f64,
    /// For each argument, up to how many steps from its zero the nodes are not enough; without end where it
    /// costs less to look at each step.
    reaches: Vec<f64>,
    registers: Vec<f64>,
    values: Vec<f64>,
    load: Vec<f64>,
    breaks: Vec<f64>,
    /// Σ of the pieces, (S + 1)·N numbers.
    total: Vec<f64>,
}

/// What is known of the steps to come. It decides on the cost of their moments, and a run that goes on from a
/// checkpoint has them as one that was not interrupted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepLengths {
    /// All of one length.
    Equal,
    /// Of any.
    Any,
}

/// Breaks so close to each other, in parts of a step, are one.
const APART: f64 = 4.0 * f64::EPSILON;

/// Parts of a step in which the sign of an argument is looked at.
const LOOKS: usize = 8;

/// Step of the double-exponential rule, and how far it goes: to 10⁻³⁷ of the piece from its ends.
const SPACING: f64 = 1.0 / 8.0;
const EXTENT: i32 = 32;

/// Halvings of a piece whose two rules do not agree.
const MOST_HALVINGS: u32 = 12;

/// Excess that is rounding, relative to the force.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// Kronrod's nodes in (0, 1] of 15, from the outermost in, their weights, and those of Gauss's seven among
/// them.
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
    /// For a force with one expression for each coordinate; `None` if it is smooth in time.
    pub fn new(components: &[Expression], lengths: StepLengths) -> Option<Self> {
        let rough = RoughArguments::of(components)?;
        let count = rough.arguments().len();
        Some(Self {
            force: CompiledForce::compile(components),
            coordinates: components.len(),
            lengths,
            step_size: f64::NAN,
            reaches: vec![f64::INFINITY; count],
            registers: Vec::new(),
            values: vec![0.0; count],
            load: vec![0.0; components.len()],
            breaks: Vec::new(),
            total: Vec::new(),
            rough,
        })
    }

    /// By how much the moments exceed what the nodes give, ν = 0…S, N numbers each; `None` where they do not.
    pub fn excess<T: Real>(&mut self, rule: &NodalRule<'_, T>) -> Option<&[f64]> {
        let (start, length) = (rule.start.to_f64(), rule.length.to_f64());
        if self.step_size != length {
            self.step_size = length;
            if self.lengths == StepLengths::Equal {
                self.find_reaches(rule);
            }
        }
        let near_root = self.find_breaks((start, length), sides_of_step(rule))?;
        let rough = self.integrate(rule, start, length, near_root) && self.total.iter().any(|&e| e != 0.0);
        rough.then_some(self.total.as_slice())
    }

    /// Finds the rough points inside a step. `None` if the step is smooth; otherwise whether a root is close.
    fn find_breaks(&mut self, (start, length): (f64, f64), (first, last): (f64, f64)) -> Option<bool> {
        self.breaks.clear();
        let (mut rough, mut near_root) = (false, false);
        let mut curved = false;
        for (argument, &reach) in self.rough.arguments().iter().zip(&self.reaches) {
            let Some(zero) = argument.zero else {
                curved = true;
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
        if curved {
            let count = self.rough.arguments().len();
            let mut before = vec![0.0; count];
            for look in 0..=LOOKS {
                let place = look as f64 / LOOKS as f64;
                self.rough.values(start + place * length, &mut self.registers, &mut self.values);
                for (index, &before) in before.iter().enumerate() {
                    let argument = self.rough.arguments()[index];
                    if argument.zero.is_some() {
                        continue;
                    }
                    let value = self.values[index];
                    if argument.root {
                        (rough, near_root) = (true, true);
                    }
                    if look > 0 && (value < 0.0) != (before < 0.0) {
                        let found = self.bisect(index, before < 0.0, (start, length), (look - 1, look));
                        self.rough.values(start + place * length, &mut self.registers, &mut self.values);
                        if found > first && found < 1.0 - last {
                            self.breaks.push(found);
                            rough = true;
                        }
                    }
                }
                before.copy_from_slice(&self.values);
            }
        }
        self.breaks.sort_by(f64::total_cmp);
        self.breaks.dedup_by(|a, b| *a - *b < APART);
        rough.then_some(near_root)
    }

    /// The place between two looks where an argument changes its sign.
    fn bisect(
        &mut self,
        index: usize,
        negative: bool,
        (start, length): (f64, f64),
        looks: (usize, usize),
    ) -> f64 {
        let (mut low, mut high) = (looks.0 as f64 / LOOKS as f64, looks.1 as f64 / LOOKS as f64);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            self.rough.values(start + middle * length, &mut self.registers, &mut self.values);
            if (self.values[index] < 0.0) == negative { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// Finds how far from the zeros of linear arguments under roots the nodes are not enough: the excess
    /// falls like a power of the distance.
    fn find_reaches<T: Real>(&mut self, rule: &NodalRule<'_, T>) {
        for index in 0..self.rough.arguments().len() {
            let argument = self.rough.arguments()[index];
            let (Some(zero), true) = (argument.zero, argument.root) else { continue };
            let length = self.step_size;
            let mut reach = 1.0;
            while reach < 1e12 {
                let sides = [zero + reach * length, zero - (reach + 1.0) * length];
                let rough = sides.iter().any(|&start| {
                    self.breaks.clear();
                    self.integrate(rule, start, length, false) && self.total.iter().any(|&e| e != 0.0)
                });
                if !rough {
                    break;
                }
                reach *= 2.0;
            }
            self.reaches[index] = reach;
        }
    }

    /// Leaves in `total` what the integrals over the pieces exceed the nodes by, zero where that is rounding.
    /// `false` if the force is not finite.
    fn integrate<T: Real>(
        &mut self,
        rule: &NodalRule<'_, T>,
        start: f64,
        length: f64,
        near_root: bool,
    ) -> bool {
        let points: Vec<f64> = rule.points.iter().map(|point| point.to_f64()).collect();
        self.total.clear();
        self.total.resize((points.len() + 1) * self.coordinates, 0.0);
        let mut edges = std::mem::take(&mut self.breaks);
        edges.insert(0, 0.0);
        edges.push(1.0);
        let mut finite = true;
        for piece in edges.windows(2) {
            let piece = (piece[0], piece[1]);
            finite &= if near_root {
                self.double_exponential(&points, (start, length), piece)
            } else {
                self.kronrod(&points, (start, length), piece, 0)
            };
        }
        edges.pop();
        edges.remove(0);
        self.breaks = edges;
        if !finite {
            return false;
        }
        let mut largest = 0.0_f64;
        for i in 0..rule.nodes.len() {
            self.force.load(node_moment(rule, i), &mut self.registers, &mut self.load);
            largest = self.load.iter().fold(largest, |largest, number| largest.max(number.abs()));
            subtract_node(rule, i, &self.load, &mut self.total);
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

    /// Adds weight · ℓ_ν(place) F(place) to the moments; `false` if F is not finite there.
    fn add(&mut self, points: &[f64], (start, length): (f64, f64), place: f64, weight: f64) -> bool {
        self.force.load(Moment::inside(start + place * length), &mut self.registers, &mut self.load);
        if self.load.iter().any(|number| !number.is_finite()) {
            return false;
        }
        add_shapes(points, place, weight, &self.load, &mut self.total);
        true
    }

    /// The double-exponential rule: τ = q/(1 + q) of the piece from its ends, q = e^{−π sinh s}.
    fn double_exponential(&mut self, points: &[f64], step: (f64, f64), (from, to): (f64, f64)) -> bool {
        let width = to - from;
        let mut finite = true;
        for index in -EXTENT..=EXTENT {
            let s = SPACING * f64::from(index);
            let q = libm::exp(-std::f64::consts::PI * libm::sinh(s.abs()));
            let distance = width * q / (1.0 + q);
            let place = if index < 0 { from + distance } else { to - distance };
            let weight = width * SPACING * std::f64::consts::PI * libm::cosh(s) * q / ((1.0 + q) * (1.0 + q));
            // So close to an end rounding may take a point beyond it.
            finite &= self.add(points, step, place, weight) || weight < 1e-12 * width;
        }
        finite
    }

    /// Kronrod's rule with 15 nodes, halving the piece while Gauss's seven of them disagree.
    fn kronrod(&mut self, points: &[f64], step: (f64, f64), (from, to): (f64, f64), halvings: u32) -> bool {
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        let places = KRONROD.iter().flat_map(|&(node, weight, gauss)| {
            let sides = if node == 0.0 { vec![0.0] } else { vec![-node, node] };
            sides.into_iter().map(move |node| (middle + half * node, half * weight, half * gauss))
        });
        let places: Vec<_> = places.collect();
        // The force alone, without shapes, tells whether the nodes are dense enough.
        let mut difference = vec![0.0_f64; self.coordinates];
        let mut size = 0.0_f64;
        for &(place, weight, gauss) in &places {
            self.force.load(Moment::inside(step.0 + place * step.1), &mut self.registers, &mut self.load);
            for (difference, &force) in difference.iter_mut().zip(&self.load) {
                *difference += (weight - gauss) * force;
                size = size.max(force.abs());
            }
        }
        let error = difference.iter().fold(0.0_f64, |largest, number| largest.max(number.abs()));
        // Kronrod's error is about the square of Gauss's.
        if error > 1e-9 * size * half && halvings < MOST_HALVINGS {
            return self.kronrod(points, step, (from, middle), halvings + 1)
                & self.kronrod(points, step, (middle, to), halvings + 1);
        }
        places.iter().fold(true, |finite, &(place, weight, _)| self.add(points, step, place, weight) & finite)
    }
}

/// How close to the beginning and to the end of a step, in parts of it, a break is one that the nodes there
/// see from inside the step: see [`Moment`].
pub(super) fn sides_of_step<T: Real>(rule: &NodalRule<'_, T>) -> (f64, f64) {
    let length = rule.length.to_f64();
    let side = |moment: Moment<T>| {
        let moment = moment.in_double();
        (moment.sided - moment.time).abs() / length
    };
    (side(Moment::from_right(rule.start)), side(Moment::from_left(rule.start + rule.length)))
}

/// The moment at which a scheme looks at the force in its i-th node.
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
pub(super) fn add_shapes(points: &[f64], place: f64, weight: f64, force: &[f64], total: &mut [f64]) {
    for (nu, sums) in total.chunks_exact_mut(force.len()).enumerate() {
        let factor = weight * shape(points, nu, place);
        sums.iter_mut().zip(force).for_each(|(sum, force)| *sum += factor * force);
    }
}

/// Takes b_i ℓ_ν(c_i) F from the moments ν = 0…S.
pub(super) fn subtract_node<T: Real>(rule: &NodalRule<'_, T>, i: usize, force: &[f64], total: &mut [f64]) {
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
    use crate::language::expression::Symbols;
    use fvi_core::{DiscreteLagrangian, Galerkin, Quadrature, RungeKutta};

    fn rule<'a>(lagrangian: &DiscreteLagrangian<'a, f64>, start: f64, length: f64) -> NodalRule<'a, f64> {
        let DiscreteLagrangian { weights, nodes, control_points: points, shapes, tests, .. } = *lagrangian;
        NodalRule { start, length, weights, nodes, points, shapes, tests }
    }

    fn force(text: &str) -> Option<ForceMoments> {
        let expression = Expression::parse(text, &Symbols::new().with_time()).unwrap();
        ForceMoments::new(&[expression], StepLengths::Equal)
    }

    /// ∫₀¹ F dτ and ∫₀¹ τ F dτ over a step, from excess and nodes on straight lines.
    fn moments(text: &str, start: f64, length: f64, value: impl Fn(f64) -> f64) -> Option<[f64; 2]> {
        let midpoint = Galerkin::<f64, 1, 1>::low_order(0.5).unwrap();
        let mut force = force(text)?;
        let excess = force.excess(&rule(&midpoint.view(), start, length))?;
        let node = 0.5 * value(start + 0.5 * length);
        Some([excess[0] + excess[1] + 2.0 * node, excess[1] + node])
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
        assert!(root.excess(&rule(&radau.view(), 0.0, 0.01)).is_some());
        assert!(root.excess(&rule(&radau.view(), 0.1, 0.01)).is_some());
        // With cubic polynomials the nodes are exact for linear forces: the excess falls like the distance to
        // the power −2.
        assert!(root.excess(&rule(&radau.view(), 1e5, 0.01)).is_none());
        // The same without reaches, which are not looked for where each step has another length.
        let mut graded = ForceMoments { lengths: StepLengths::Any, ..force("sqrt(t)").unwrap() };
        for (start, length) in [(0.0, 0.01), (0.1, 0.02), (1e5, 0.01)] {
            let found = graded.excess(&rule(&radau.view(), start, length)).map(<[f64]>::to_vec);
            assert_eq!(found.as_deref(), root.excess(&rule(&radau.view(), start, length)));
        }
        assert_eq!(graded.reaches, [f64::INFINITY]);
        // A jump at a grid point is seen from both sides by the nodes.
        let mut pulse = force("8*step(1 - t)").unwrap();
        assert!(pulse.excess(&rule(&radau.view(), 0.9, 0.1)).is_none());
        assert!(pulse.excess(&rule(&radau.view(), 1.0, 0.1)).is_none());
        assert!(pulse.excess(&rule(&radau.view(), 0.95, 0.1)).is_some());
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
