//! Energy stored in the memories of materials, and energy dissipated by them.

use fvi_core::{Real, StateError, StateReader, StateWriter};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::quadrature::multistep_weights::multistep_weights;
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::transfer::multistep_rule::MultistepRule;
use fvi_scenario::language::{InputError, Problem};
use fvi_scenario::scenario::{Derivative, Scenario, SymmetricMatrix, TimeGrid};
use nalgebra::Complex;
use std::f64::consts::PI;

/// Energy stored in the memories of a run with the midpoint rule, and dissipated by them, with an exact
/// balance in every step.
///
/// A kernel with K(s)/s = ∫ dμ(r)/(s + r), μ ≥ 0, corresponds to Maxwell elements in parallel: springs of
/// moduli g in series with dashpots, of rates r. Discretised with the samples X_k = (q_k + q_{k+1})/2, the
/// force F of each follows from the increments Δ_k = q_{k+1} − q_k by a state v; with ε = h r
///
/// ```text
/// BDF 1        (1 + ε) v_k = Δ_k + v_{k−1}                    F_k = (g/2)(v_k + v_{k−1})
/// trapezoidal  (2 + ε) (v_k + v_{k−1}) = Δ_k + 4 v_{k−1}      F_k = g (v_k + v_{k−1})
/// BDF 2        (6 + 4ε) v_k = Δ_k + 8 v_{k−1} − 2 v_{k−2}      F_k = g (3 v_k + 2 v_{k−1} − v_{k−2})
/// ```
///
/// The work of a step is Δ_kᵀρF_k = S_{k+1} − S_k + D_k with (squares are those of ρ, b = (√3 − 1)/2, a = 1 +
/// b)
///
/// ```text
/// BDF 1        S_{k+1} = (g/2)(1 + ε/2) v_k²                   D_k = (g ε/4)(v_k + v_{k−1})²
/// trapezoidal  S_{k+1} = 2g v_k²                               D_k = g ε (v_k + v_{k−1})²
/// BDF 2        S_{k+1} = 2g (3v_k − v_{k−1})²                  D_k = 4gε (a y_k − b y_{k−1})² ,  y_k = v_k +
/// v_{k−1} .
///                        + 4gε [(v_k − b v_{k−1})² + b² v_k²]
/// ```
///
/// Derived in `book/src/theory/kernels.md`. A jump from 0 to q₀, in Riemann and Liouville's form, begins with
/// v_{−1} = 2q₀/(2 + ε), q₀/2, or v_{−1} = −v_{−2} = q₀/(8 + 2ε).
pub(crate) struct MemoryEnergy {
    terms: Vec<Term>,
    dissipated: f64,
    /// Rounding error of the dissipated energy.
    rest: f64,
    increments: Vec<f64>,
}

struct Term {
    rho: SymmetricMatrix,
    rule: Rule,
    elements: Vec<Element>,
    /// v_{k−1} and v_{k−2} of each element.
    states: Vec<[Vec<f64>; 2]>,
}

/// The rules with an exact balance.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Rule {
    One,
    Two,
    Trapezoidal,
}

/// A Maxwell element: modulus, and h times its rate.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Element {
    modulus: f64,
    rate: f64,
}

/// h r that represents a dashpot.
const DASHPOT: f64 = 1e18;

/// Bounds of h r beyond which elements are merged to one, independently of the length of the run. The
/// relative error is the square of the first times the number of steps, and of the inverse of the second.
const STANDING: f64 = 1e-16;
const IMMEDIATE: f64 = 1e8;

/// Ratio to a sum below which its terms are neglected.
const NEGLIGIBLE: f64 = 1e-18;

/// Number of the run's weights with which the elements are compared, and the largest difference.
const COMPARED: usize = 64;
const AGREEMENT: f64 = 1e-12;

impl MemoryEnergy {
    /// At t = 0 of a scenario; `None` if it does not request these energies.
    ///
    /// # Errors
    /// If there is no exact balance: for kernels that do not correspond to Maxwell elements, which their
    /// numbers decide. Schemes and steps without one are rows of the table of combinations.
    pub(crate) fn new(scenario: &Scenario) -> Result<Option<Self>, InputError> {
        if !scenario.output.memory_energy {
            return Ok(None);
        }
        let refused = |with: &str, allowed: &str| {
            let (with, allowed) = (with.to_owned(), allowed.to_owned());
            Err(scenario.error_at("output.memory_energy", Problem::Incompatible { with, allowed }))
        };
        let Ok(Some(multistep)) = scenario.convolution.family.multistep() else {
            return refused("a Runge–Kutta family", "multistep rules");
        };
        // Those that the table of combinations leaves.
        let rule = match scenario.convolution.family {
            ConvolutionFamily::Trapezoidal => Rule::Trapezoidal,
            ConvolutionFamily::Bdf { order: 1 } => Rule::One,
            _ => Rule::Two,
        };
        let mut terms = Vec::new();
        for (index, term) in scenario.system.damping.iter().enumerate() {
            let elements = elements(&term.transfer, scenario.time.step).map_err(|reason| {
                let with = format!("`system.damping[{index}]`, {reason}");
                let allowed = "kernels that are Maxwell elements side by side".to_owned();
                scenario.error_at("output.memory_energy", Problem::Incompatible { with, allowed })
            })?;
            let agreement = agreement(&term.transfer, &elements, (rule, multistep), &scenario.time);
            agreement.map_err(|reason| {
                let with = format!("`system.damping[{index}]`, {reason}");
                let allowed =
                    format!("kernels whose weights their Maxwell elements make up to {AGREEMENT:e}");
                scenario.error_at("output.memory_energy", Problem::Incompatible { with, allowed })
            })?;
            let jumps = term.coefficient.times(&scenario.initial.position).iter().any(|&force| force != 0.0)
                && term.derivative == Derivative::RiemannLiouville;
            if jumps && rule == Rule::Trapezoidal && term.transfer.growth() > 0.0 {
                return refused(
                    &format!(
                        "the jump of `system.damping[{index}]` to the initial position by the trapezoidal rule"
                    ),
                    "backward differentiation, or Caputo's form: the jump of a kernel without a glass modulus puts an energy \
                     without bound into that rule",
                );
            }
            let jump = match term.derivative {
                Derivative::Caputo => vec![0.0; scenario.coordinates()],
                Derivative::RiemannLiouville => scenario.initial.position.clone(),
            };
            let rho = term.coefficient.clone();
            let states = elements.iter().map(|element| element.after_a_jump(rule, &jump)).collect();
            terms.push(Term { rho, rule, elements, states });
        }
        Ok(Some(Self { terms, dissipated: 0.0, rest: 0.0, increments: Vec::new() }))
    }

    /// Adds the step from one position to the next.
    pub(crate) fn advance(&mut self, from: &[f64], to: &[f64]) {
        self.increments.clear();
        self.increments.extend(to.iter().zip(from).map(|(to, from)| to - from));
        for term in &mut self.terms {
            for (element, state) in term.elements.iter().zip(&mut term.states) {
                let lost = element.advance(term.rule, &self.increments, state, &term.rho) - self.rest;
                let sum = self.dissipated + lost;
                self.rest = (sum - self.dissipated) - lost;
                self.dissipated = sum;
            }
        }
    }

    /// Writes the stored energy, and the dissipated energy.
    pub(crate) fn write(&self, columns: &mut [f64]) {
        let of = |term: &Term| -> f64 {
            let pairs = term.elements.iter().zip(&term.states);
            pairs.map(|(element, state)| element.stored(term.rule, state, &term.rho)).sum()
        };
        let numbers = [self.terms.iter().map(of).sum(), self.dissipated];
        columns.iter_mut().zip(numbers).for_each(|(place, number)| *place = number);
    }

    fn numbers(&self) -> impl Iterator<Item = &f64> {
        let states = self.terms.iter().flat_map(|term| &term.states).flatten().flatten();
        [&self.dissipated, &self.rest].into_iter().chain(states)
    }

    /// Appends its state.
    pub(crate) fn save(&self, bytes: &mut Vec<u8>) -> Result<(), StateError> {
        let numbers: Vec<f64> = self.numbers().copied().collect();
        let begin = bytes.len();
        bytes.resize(begin + numbers.len() * f64::BYTES, 0);
        StateWriter::new(&mut bytes[begin..]).numbers(&numbers)
    }

    /// Restores a saved state.
    pub(crate) fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let mut head = [0.0; 2];
        let mut numbers = vec![0.0; self.numbers().count() - head.len()];
        let mut reader = StateReader::new(bytes);
        reader.numbers(&mut head)?;
        reader.numbers(&mut numbers)?;
        reader.finish()?;
        [self.dissipated, self.rest] = head;
        let states = self.terms.iter_mut().flat_map(|term| &mut term.states).flatten().flatten();
        states.zip(numbers).for_each(|(place, number)| *place = number);
        Ok(())
    }
}

/// xᵀρx for x = Σ c_i x_i.
fn square<const M: usize>(rho: &SymmetricMatrix, parts: [(f64, &[f64]); M]) -> f64 {
    let size = parts.first().map_or(0, |(_, vector)| vector.len());
    let sum = |index: usize| parts.iter().map(|(factor, vector)| factor * vector[index]).sum::<f64>();
    let vector: Vec<f64> = (0..size).map(sum).collect();
    rho.times(&vector).iter().zip(&vector).map(|(force, x)| force * x).sum()
}

/// b = (√3 − 1)/2
const B: f64 = 0.366_025_403_784_438_65;

impl Element {
    /// The state at t = 0 after a jump to q₀.
    fn after_a_jump(&self, rule: Rule, jump: &[f64]) -> [Vec<f64>; 2] {
        let (before, earlier) = match rule {
            Rule::One => (2.0 / (2.0 + self.rate), 0.0),
            Rule::Trapezoidal => (0.5, 0.0),
            Rule::Two => ((8.0 + 2.0 * self.rate).recip(), -(8.0 + 2.0 * self.rate).recip()),
        };
        [before, earlier].map(|factor| jump.iter().map(|q| factor * q).collect())
    }

    /// Adds an increment; returns the dissipated energy.
    fn advance(
        &self,
        rule: Rule,
        increments: &[f64],
        [before, earlier]: &mut [Vec<f64>; 2],
        rho: &SymmetricMatrix,
    ) -> f64 {
        let Self { modulus: g, rate } = *self;
        let states = before.iter().zip(earlier.iter()).zip(increments);
        let next: Vec<f64> = match rule {
            Rule::One => states.map(|((v1, _), d)| (d + v1) / (1.0 + rate)).collect(),
            // v_k + v_{k−1}, which is small for fast elements, whose v alternates in sign.
            Rule::Trapezoidal => states.map(|((v1, _), d)| (d + 4.0 * v1) / (2.0 + rate)).collect(),
            Rule::Two => states.map(|((v1, v2), d)| (d + 8.0 * v1 - 2.0 * v2) / (6.0 + 4.0 * rate)).collect(),
        };
        let lost = match rule {
            Rule::One => 0.25 * g * rate * square(rho, [(1.0, &next), (1.0, before)]),
            Rule::Trapezoidal => {
                let lost = g * rate * square(rho, [(1.0, &next)]);
                before.iter_mut().zip(&next).for_each(|(v, sum)| *v = sum - *v);
                return lost;
            }
            // a y_k − b y_{k−1}, a − b = 1
            Rule::Two => 4.0 * g * rate * square(rho, [(1.0 + B, &next), (1.0, before), (-B, earlier)]),
        };
        *earlier = std::mem::replace(before, next);
        lost
    }

    /// Adds the weights of g s/(s + r) with h s = γ(z), a ratio of polynomials in z.
    fn add_weights(&self, rule: Rule, weights: &mut [f64]) {
        let Self { modulus, rate } = *self;
        let ([n0, n1, n2], [d0, d1, d2]) = match rule {
            Rule::One => ([1.0, -1.0, 0.0], [1.0 + rate, -1.0, 0.0]),
            Rule::Two => ([3.0, -4.0, 1.0], [3.0 + 2.0 * rate, -4.0, 1.0]),
            Rule::Trapezoidal => ([2.0, -2.0, 0.0], [2.0 + rate, rate - 2.0, 0.0]),
        };
        let (mut before, mut earlier) = (0.0, 0.0);
        for (weight, n) in weights.iter_mut().zip([n0, n1, n2].into_iter().chain(std::iter::repeat(0.0))) {
            let next = (n * modulus - d1 * before - d2 * earlier) / d0;
            *weight += next;
            (before, earlier) = (next, before);
        }
    }

    fn stored(&self, rule: Rule, [before, earlier]: &[Vec<f64>; 2], rho: &SymmetricMatrix) -> f64 {
        let Self { modulus: g, rate } = *self;
        match rule {
            Rule::One => 0.5 * g * (1.0 + 0.5 * rate) * square(rho, [(1.0, before)]),
            Rule::Trapezoidal => 2.0 * g * square(rho, [(1.0, before)]),
            Rule::Two => {
                let moved =
                    square(rho, [(1.0, before), (-B, earlier)]) + B * B * square(rho, [(1.0, before)]);
                2.0 * g * square(rho, [(3.0, before), (-1.0, earlier)]) + 4.0 * g * rate * moved
            }
        }
    }
}

/// The Maxwell elements of a kernel, for steps of h: those of a Prony series, or the trapezoidal rule in ln d
/// for R(s) = K(s)/s = ∫ Im K(−x + i0)/(π x) dx/(s + x), x = start of the cut + d.
///
/// # Errors
/// The reason why the kernel has none.
fn elements(transfer: &TransferFunction, step: f64) -> Result<Vec<Element>, &'static str> {
    const ACTIVE: &str = "a kernel with negative elements";
    if transfer.table().is_some() {
        return Err("which is weights and has no states");
    }
    if transfer.exponent() == Some(1.0) {
        return Ok(vec![Element { modulus: DASHPOT / step, rate: DASHPOT }]);
    }
    if transfer.growth() > 1.0 {
        return Err("whose kernel grows faster than s: it holds inertia beside elements");
    }
    if !transfer.is_relaxation() {
        let is_viscous = transfer.growth() == 1.0 && transfer.fractions().is_none();
        return Err(if is_viscous {
            "whose symbol grows like s: its dashpot is a term of its own, with order 1"
        } else {
            "whose kernel has singularities off the negative real axis"
        });
    }
    let poles = transfer.poles();
    if transfer.narrow().is_some() {
        return Err("whose cut is too narrow: its elements are too many");
    }
    let Some(cut) = transfer.cut() else {
        // −residue/λ = g
        let element = |pole: &fvi_fft::transfer::Pole| Element {
            modulus: -pole.residue / pole.rate,
            rate: pole.rate * step,
        };
        let mut elements: Vec<Element> = poles.iter().map(element).collect();
        // c₁ s of a rational function is a dashpot.
        let viscous = transfer.fractions().map_or(0.0, |fractions| fractions.direct[1]);
        if viscous != 0.0 {
            elements.push(Element { modulus: viscous * DASHPOT / step, rate: DASHPOT });
        }
        return if elements.iter().all(|element| element.modulus > 0.0) { Ok(elements) } else { Err(ACTIVE) };
    };
    // Distances in units of the fastest rate that the steps see.
    let unit = cut.start + step.recip();
    let spacing = 2.0 * PI * cut.strip / 40.0;
    let node = |k: i32| {
        let d = libm::exp(spacing * f64::from(k)) * unit;
        let rate = cut.start + d;
        // d/r first: d^{1+β} may exceed all numbers.
        (spacing * (d / rate) * transfer.jump(d), rate, d)
    };
    let mut elements = Vec::new();
    let (mut slow_distances, mut fast_times) = (0.0_f64, 0.0_f64);
    for k in (i32::MIN..0).rev() {
        let (modulus, rate, d) = node(k);
        if d > STANDING * unit {
            elements.push(Element { modulus, rate: rate * step });
            continue;
        }
        slow_distances += modulus * d;
        if (modulus * d).abs() <= NEGLIGIBLE * slow_distances.abs() || d < 1e-290 {
            break;
        }
    }
    for k in 0..i32::MAX {
        let (modulus, rate, d) = node(k);
        if d < IMMEDIATE * unit {
            elements.push(Element { modulus, rate: rate * step });
            continue;
        }
        let times = modulus / rate / rate;
        fast_times += times;
        if times.abs() <= NEGLIGIBLE * fast_times.abs() || d > 1e290 {
            break;
        }
    }
    let [slow, fast] = rests(transfer, &elements, step, cut.start, [slow_distances, fast_times]);
    elements.extend([slow, fast].into_iter().flatten());
    let largest = elements.iter().map(|element| element.modulus).fold(0.0, max_or_nan);
    if elements.iter().any(|element| element.modulus < -1e-12 * largest) {
        return Err(ACTIVE);
    }
    // What is left of a NaN is found by the comparison with the weights.
    elements.retain(|element| element.modulus.is_nan() || element.modulus > 0.0);
    Ok(elements)
}

/// The elements slower and faster than those between, each part merged to one: S/(s + a + δ) and G/(s + r).
///
/// Their sums need not converge within the numbers there are (for β near 0 and 1 they go like d^{±0.001}),
/// but R(s) is known: with those between taken off, R(s) = S/(s + a + δ) + F − T s at two places s gives
/// S = Σ g and F = Σ g/r, where the sums S δ = Σ g d and T = Σ g/r² do converge. `None` for a part within the
/// rounding of R.
fn rests(
    transfer: &TransferFunction,
    between: &[Element],
    step: f64,
    start: f64,
    [slow_distances, fast_times]: [f64; 2],
) -> [Option<Element>; 2] {
    const ROUNDING: f64 = 3e-14;
    let unit = start + step.recip();
    let at = |s: f64| {
        let whole = transfer.value(Complex::new(s, 0.0)).re / s;
        let taken = between.iter().map(|element| element.modulus / (s + element.rate / step)).sum::<f64>();
        let near = s + start;
        (whole, whole - taken + slow_distances / (near * near) + fast_times * s, near.recip())
    };
    let ((_, low, low_factor), (whole, high, high_factor)) = (at(1e-4 * unit), at(unit));
    let slow = (low - high) / (low_factor - high_factor);
    let fast = high - slow * high_factor;
    let counts = |part: f64| part.is_nan() || part.abs() > ROUNDING * whole;
    let slow = counts(slow * high_factor)
        .then(|| Element { modulus: slow, rate: (start + slow_distances / slow) * step });
    let fast = counts(fast).then(|| {
        let rate = (fast / fast_times).clamp(IMMEDIATE * unit, DASHPOT * unit);
        Element { modulus: fast * rate, rate: rate * step }
    });
    [slow, fast]
}

/// Compares elements with the weights of a run, and with K(s) for what happens later than those.
///
/// # Errors
/// If they differ, with the difference.
fn agreement(
    transfer: &TransferFunction,
    elements: &[Element],
    (rule, multistep): (Rule, MultistepRule),
    time: &TimeGrid,
) -> Result<(), String> {
    let weights = multistep_weights(transfer, multistep, time.step, false, time.steps.clamp(1, COMPARED))
        .map_err(|error| error.to_string())?;
    let found =
        max_or_nan(difference(elements, rule, &weights), later(transfer, elements, time.step, time.steps));
    if found <= AGREEMENT {
        Ok(())
    } else {
        Err(format!("whose elements are off its weights by {found:.1e}"))
    }
}

/// Largest difference of the elements' weights from those of the rule, and of their sums, in units of the sum
/// of the sizes of the latter so far.
fn difference(elements: &[Element], rule: Rule, weights: &[f64]) -> f64 {
    let mut made = vec![0.0; weights.len()];
    for element in elements {
        element.add_weights(rule, &mut made);
    }
    let (mut sum, mut size, mut worst) = (0.0_f64, 0.0, 0.0);
    for (made, weight) in made.iter().zip(weights) {
        let off = made - weight;
        sum += off;
        size += weight.abs();
        worst = max_or_nan(worst, max_or_nan(off.abs(), sum.abs()) / size);
    }
    worst
}

/// Largest difference of Σ g s/(s + r) from K(s) at real s from 1/(the run's length) to 1/h, in units of
/// K(1/h).
fn later(transfer: &TransferFunction, elements: &[Element], step: f64, steps: usize) -> f64 {
    const PLACES: i32 = 10;
    let kernel = |s: f64| transfer.value(Complex::new(s, 0.0)).re;
    let ratio = (steps.max(1) as f64).powf(-f64::from(PLACES).recip());
    let size = kernel(step.recip()).abs();
    (0..=PLACES).fold(0.0, |worst, place| {
        let x = ratio.powi(place);
        let made = elements.iter().map(|element| element.modulus * (x / (x + element.rate))).sum::<f64>();
        max_or_nan(worst, (made - kernel(x / step)).abs() / size)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_core::BdfOrder;
    use fvi_scenario::scenario::kernel_of_symbol;

    const STEP: f64 = 0.05;

    fn rules() -> [(Rule, MultistepRule); 3] {
        let of_order = |order| MultistepRule::Bdf(BdfOrder::new(order).unwrap());
        [(Rule::One, of_order(1)), (Rule::Two, of_order(2)), (Rule::Trapezoidal, MultistepRule::Trapezoidal)]
    }

    /// The force in a step with the increment d from the previous states to the state v.
    fn force(element: &Element, rule: Rule, [v1, v2]: [f64; 2], d: f64, v: f64) -> f64 {
        element.modulus
            * match rule {
                Rule::One => 0.5 * (v + v1),
                Rule::Trapezoidal => (d + 4.0 * v1) / (2.0 + element.rate),
                Rule::Two => 3.0 * v + 2.0 * v1 - v2,
            }
    }

    /// Largest error of the force by the double sum, and of the balance, over some steps.
    fn errors(elements: &[Element], rule: Rule, weights: &[f64], jumps: bool) -> [f64; 2] {
        let one = SymmetricMatrix::Diagonal(vec![1.0]);
        let path = |k: usize| 1.0 + 0.2 * (0.7 * k as f64).sin() + 0.001 * (k as f64).powf(1.5);
        let start = if jumps { 0.0 } else { path(0) };
        let sample = |k: usize| 0.5 * (path(k) + path(k + 1)) - start;
        let jump = [path(0) - start];
        let mut states: Vec<_> = elements.iter().map(|element| element.after_a_jump(rule, &jump)).collect();
        let mut stored: f64 =
            elements.iter().zip(&states).map(|(e, state)| e.stored(rule, state, &one)).sum();
        let [mut of_force, mut of_balance] = [0.0; 2];
        for k in 0..weights.len() {
            let increment = path(k + 1) - path(k);
            let (mut found, mut lost, mut after) = (0.0, 0.0, 0.0);
            for (element, state) in elements.iter().zip(&mut states) {
                let old = [state[0][0], state[1][0]];
                let dissipated = element.advance(rule, &[increment], state, &one);
                assert!(dissipated >= 0.0);
                lost += dissipated;
                after += element.stored(rule, state, &one);
                found += force(element, rule, old, increment, state[0][0]);
            }
            let known: f64 = (0..=k).map(|n| weights[n] * sample(k - n)).sum();
            let size: f64 = (0..=k).map(|n| (weights[n] * sample(k - n)).abs()).sum();
            of_force = max_or_nan(of_force, (found - known).abs() / size);
            let work = known * increment;
            let scale = size * increment.abs() + after + stored + lost;
            of_balance = max_or_nan(of_balance, (work - (after - stored) - lost).abs() / scale);
            stored = after;
        }
        [of_force, of_balance]
    }

    #[test]
    fn elements_make_up_the_weights_and_balance_the_work_of_every_step() {
        let kernels = [
            TransferFunction::prony(&[2.0, 0.5, 30.0], &[1.0, 0.003, 40.0]).unwrap(),
            TransferFunction::power(0.37).unwrap(),
            TransferFunction::power(1.0).unwrap(),
            TransferFunction::tempered(0.8, 3.0).unwrap(),
            TransferFunction::maxwell(0.85, 0.2, 0.6).unwrap(),
            TransferFunction::havriliak_negami(0.6, 0.7, 0.2).unwrap(),
            TransferFunction::havriliak_negami(1.0, 0.4, 2.0).unwrap(),
            kernel_of_symbol("s^0.5/(1 + s^0.5) + 0.3*s^0.8").unwrap(),
        ];
        const STEPS: usize = 400;
        for transfer in &kernels {
            let elements = elements(transfer, STEP).unwrap();
            for (rule, multistep) in rules() {
                let weights = multistep_weights(transfer, multistep, STEP, false, STEPS).unwrap();
                for jumps in [false, true] {
                    if jumps && rule == Rule::Trapezoidal && transfer.growth() > 0.0 {
                        continue;
                    }
                    let [force, balance] = errors(&elements, rule, &weights, jumps);
                    assert!(force < 2e-13, "{transfer}, {rule:?}, {jumps}: {force:e}");
                    assert!(balance < 1e-12, "{transfer}, {rule:?}, {jumps}: {balance:e}");
                }
            }
        }
    }

    #[test]
    fn elements_at_the_edges_of_parameters_make_up_the_weights_or_are_refused() {
        let ends = [0.001, 0.01, 0.025, 0.3, 0.9, 0.95, 0.99, 0.999];
        let (power, tempered) = (TransferFunction::power, TransferFunction::tempered);
        let (maxwell, havriliak) = (TransferFunction::maxwell, TransferFunction::havriliak_negami);
        let symbol = |text: String| kernel_of_symbol(&text).unwrap();
        let mut kernels = vec![symbol("s^0.97 + 0.2*s^0.99".to_owned())];
        for order in ends {
            kernels.push(power(order).unwrap());
            kernels.extend([1e-6, 0.3, 1e4, 1e12].map(|rate| tempered(order, rate).unwrap()));
            kernels.extend([1e-4, 0.5, 1e5].map(|time| maxwell(order, 0.0, time).unwrap()));
            kernels.push(maxwell(order, 0.5 * order, 0.3).unwrap());
            kernels.extend([0.001, 0.3, 0.999].map(|power| havriliak(order, power, 0.4).unwrap()));
            kernels.extend([1e-4, 0.4, 1e4].map(|time| havriliak(1.0, order, time).unwrap()));
            kernels.push(symbol(format!("0.2*s^{order:?} + s^0.5/(1 + s^0.5)")));
        }
        kernels.push(TransferFunction::prony(&[1e-9, 3.0, 1e6], &[1e9, 0.05, 1e-9]).unwrap());
        let (mut wrong, mut refused) = (Vec::new(), Vec::new());
        for transfer in &kernels {
            let elements = match elements(transfer, STEP) {
                Ok(elements) => elements,
                Err(reason) => {
                    refused.push(format!("{transfer}: {reason}"));
                    continue;
                }
            };
            for (rule, multistep) in rules() {
                let weights = multistep_weights(transfer, multistep, STEP, false, COMPARED).unwrap();
                let [off, late] =
                    [difference(&elements, rule, &weights), later(transfer, &elements, STEP, 100_000)];
                let [force, balance] = errors(&elements, rule, &weights[..16], false);
                if max_or_nan(off, late) > 5e-13
                    || max_or_nan(force, balance) > AGREEMENT
                    || (off + late + force + balance).is_nan()
                {
                    wrong.push(format!(
                        "{transfer}, {rule:?}, {}: {off:.1e} {late:.1e} {force:.1e} {balance:.1e}",
                        elements.len()
                    ));
                }
            }
        }
        assert!(
            wrong.is_empty(),
            "{} of {}:\n{}\n{}",
            wrong.len(),
            3 * kernels.len(),
            wrong.join("\n"),
            refused.join("\n")
        );
        let known = |reason: &String| reason.contains("too narrow");
        assert!(refused.iter().all(known), "{refused:#?}");
    }

    #[test]
    fn kernels_that_are_no_maxwell_elements_are_told() {
        let reason = |transfer: &TransferFunction| elements(transfer, 0.1).unwrap_err();
        let resonator = kernel_of_symbol("0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)").unwrap();
        assert!(reason(&resonator).contains("off the negative real axis"));
        assert!(reason(&kernel_of_symbol("s^0.5 + 0.3*s").unwrap()).contains("grows like s"));
        assert!(reason(&TransferFunction::power(1.5).unwrap()).contains("faster than s"));
        let negative = TransferFunction::prony(&[1.0, -0.1], &[1.0, 10.0]).unwrap();
        assert!(reason(&negative).contains("negative elements"));
        assert!(reason(&TransferFunction::havriliak_negami(0.9, 1.6, 1.0).unwrap()).contains("negative"));
    }
}
