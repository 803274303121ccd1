//! Energy stored in the memories of materials, and energy dissipated by them.

use crate::language::{InputError, Problem};
use crate::numerics::transfer::TransferFunction;
use crate::scenario::{ConvolutionFamily, Derivative, Scenario, SymmetricMatrix};
use fvi_core::{Real, StateError, StateReader, StateWriter};
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
/// BDF 2        S_{k+1} = 2g (3v_k − v_{k−1})²                  D_k = 4gε (a y_k − b y_{k−1})² ,  y_k = v_k + v_{k−1} .
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
        let mut numbers = vec![0.0; self.numbers().count()];
        let mut reader = StateReader::new(bytes);
        reader.numbers(&mut numbers)?;
        reader.finish()?;
        let mut numbers = numbers.into_iter();
        (self.dissipated, self.rest) = (numbers.next().unwrap_or(0.0), numbers.next().unwrap_or(0.0));
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
    match transfer.exponent() {
        Some(0.0) => return Ok(vec![Element { modulus: 1.0, rate: 0.0 }]),
        Some(1.0) => return Ok(vec![Element { modulus: DASHPOT / step, rate: DASHPOT }]),
        _ => {}
    }
    if !transfer.is_relaxation() {
        return Err("whose kernel has singularities off the negative real axis");
    }
    if transfer.growth() > 1.0 {
        return Err("whose kernel grows faster than s: it holds inertia beside elements");
    }
    let poles = transfer.poles();
    let Some(cut) = transfer.cut() else {
        // −residue/λ = g
        let element = |pole: &crate::numerics::transfer::Pole| Element {
            modulus: -pole.residue / pole.rate,
            rate: pole.rate * step,
        };
        let elements: Vec<Element> = poles.iter().map(element).collect();
        return if elements.iter().all(|element| element.modulus > 0.0) { Ok(elements) } else { Err(ACTIVE) };
    };
    let spacing = 2.0 * PI * cut.strip / 40.0;
    let node = |k: i32| {
        let d = libm::exp(spacing * f64::from(k)) / step;
        let rate = cut.start + d;
        (spacing * d * transfer.jump(d) / rate, rate, d)
    };
    const MOST: i32 = 200_000;
    let mut elements = Vec::new();
    let (mut slow, mut slow_rates) = (0.0_f64, 0.0_f64);
    let (mut fast, mut fast_times) = (0.0_f64, 0.0_f64);
    let mut least = 0.0_f64;
    for k in (-MOST..0).rev() {
        let (modulus, rate, d) = node(k);
        least = least.min(modulus);
        if d * step > STANDING {
            elements.push(Element { modulus, rate: rate * step });
            continue;
        }
        (slow, slow_rates) = (slow + modulus, slow_rates + modulus * rate);
        if modulus <= NEGLIGIBLE * slow || d < 1e-290 {
            break;
        }
    }
    for k in 0..MOST {
        let (modulus, rate, d) = node(k);
        least = least.min(modulus);
        if d * step < IMMEDIATE {
            elements.push(Element { modulus, rate: rate * step });
            continue;
        }
        (fast, fast_times) = (fast + modulus / rate, fast_times + modulus / (rate * rate));
        if modulus / rate <= NEGLIGIBLE * fast || d > 1e290 {
            break;
        }
    }
    if slow > 0.0 {
        elements.push(Element { modulus: slow, rate: slow_rates / slow * step });
    }
    if fast > 0.0 {
        // Σ g/r and Σ g/r² are preserved.
        let rate = fast / fast_times;
        elements.push(Element { modulus: fast * rate, rate: rate * step });
    }
    let largest = elements.iter().fold(0.0_f64, |most, element| most.max(element.modulus));
    if least < -1e-12 * largest {
        return Err(ACTIVE);
    }
    elements.retain(|element| element.modulus > 0.0);
    Ok(elements)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::multistep_rule::MultistepRule;
    use crate::numerics::multistep_weights::multistep_weights;
    use crate::scenario::kernel_of_symbol;
    use fvi_core::BdfOrder;

    const STEP: f64 = 0.05;

    fn rules() -> [(Rule, MultistepRule); 3] {
        let of_order = |order| MultistepRule::Bdf(BdfOrder::new(order).unwrap());
        [(Rule::One, of_order(1)), (Rule::Two, of_order(2)), (Rule::Trapezoidal, MultistepRule::Trapezoidal)]
    }

    /// The force in a step with the increment d from the previous states to the state v.
    fn force(element: &Element, rule: Rule, [before, earlier]: &[Vec<f64>; 2], (d, v): (f64, f64)) -> f64 {
        let (v1, v2) = (before[0], earlier[0]);
        element.modulus
            * match rule {
                Rule::One => 0.5 * (v + v1),
                Rule::Trapezoidal => (d + 4.0 * v1) / (2.0 + element.rate),
                Rule::Two => 3.0 * v + 2.0 * v1 - v2,
            }
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
        let one = SymmetricMatrix::Diagonal(vec![1.0]);
        for transfer in &kernels {
            let elements = elements(transfer, STEP).unwrap();
            for (rule, multistep) in rules() {
                let weights = multistep_weights(transfer, multistep, STEP, false, STEPS).unwrap();
                for jumps in [false, true] {
                    if jumps && rule == Rule::Trapezoidal && transfer.growth() > 0.0 {
                        continue;
                    }
                    let path = |k: usize| 1.0 + 0.2 * (0.7 * k as f64).sin() + 0.001 * (k as f64).powf(1.5);
                    let start = if jumps { 0.0 } else { path(0) };
                    let samples: Vec<f64> =
                        (0..STEPS).map(|k| 0.5 * (path(k) + path(k + 1)) - start).collect();
                    let jump = [path(0) - start];
                    let mut states: Vec<_> =
                        elements.iter().map(|element| element.after_a_jump(rule, &jump)).collect();
                    let mut stored: f64 =
                        elements.iter().zip(&states).map(|(e, state)| e.stored(rule, state, &one)).sum();
                    for k in 0..STEPS {
                        let increment = path(k + 1) - path(k);
                        let (mut found, mut lost, mut after) = (0.0, 0.0, 0.0);
                        for (element, state) in elements.iter().zip(&mut states) {
                            let old = state.clone();
                            let dissipated = element.advance(rule, &[increment], state, &one);
                            assert!(dissipated >= 0.0);
                            lost += dissipated;
                            after += element.stored(rule, state, &one);
                            found += force(element, rule, &old, (increment, state[0][0]));
                        }
                        let known: f64 = (0..=k).map(|n| weights[n] * samples[k - n]).sum();
                        let size: f64 = (0..=k).map(|n| (weights[n] * samples[k - n]).abs()).sum();
                        let at = format!("{transfer}, {rule:?}, {jumps}, {k}");
                        assert!((found - known).abs() < 2e-13 * size, "{at}: {found} {known}");
                        let work = found * increment;
                        let error = (work - (after - stored) - lost).abs();
                        assert!(error < 1e-12 * (work.abs() + after + stored + lost), "{at}: {error:e}");
                        stored = after;
                    }
                }
            }
        }
    }

    #[test]
    fn kernels_that_are_no_maxwell_elements_are_told() {
        let reason = |transfer: &TransferFunction| elements(transfer, 0.1).unwrap_err();
        let resonator = kernel_of_symbol("0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)").unwrap();
        assert!(reason(&resonator).contains("off the negative real axis"));
        assert!(reason(&TransferFunction::power(1.5).unwrap()).contains("faster than s"));
        let negative = TransferFunction::prony(&[1.0, -0.1], &[1.0, 10.0]).unwrap();
        assert!(reason(&negative).contains("negative elements"));
        assert!(reason(&TransferFunction::havriliak_negami(0.9, 1.6, 1.0).unwrap()).contains("negative"));
    }
}
