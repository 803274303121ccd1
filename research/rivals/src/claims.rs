//! Statements of the sources about their strategies, compared with values computed here.

use std::f64::consts::PI;

use fvi_core::{BdfOrder, ConvolutionWeights, Memory, ParameterError, min_or_nan};
use fvi_fft::baseline::{MemoryTerm, Signal, memory_term};
use fvi_fft::exponentials::rational_power::RationalPower;
use fvi_fft::sums::max_or_nan;
use nalgebra::Complex;

use crate::dyadic_exponentials::{Term, power_rules};
use crate::l1::l1_weights;
use crate::oustaloup::recursion;
use crate::{
    ObliviousQuadrature, PlainSum, RelaxedProduct, TextbookHls, jiang, kernel_compression,
    non_uniform_partition, uniform_partition,
};

/// A quantitative statement of a source for a kernel, with the value that this implementation of the strategy
/// gives.
#[derive(Clone, Debug)]
pub struct Claim {
    /// Name of the strategy in `fvi strategies`.
    pub strategy: &'static str,
    /// Key in `REFERENCES.md`, with the place in the source.
    pub source: &'static str,
    /// The statement as text.
    pub statement: &'static str,
    /// Kernel and parameters.
    pub setting: &'static str,
    /// The stated value.
    pub stated: f64,
    /// The value computed here.
    pub found: f64,
    /// Relation of the two values if the statement holds.
    pub relation: Relation,
    /// True if `found` is a rounding error of transforms, which depends on the vector units of the machine.
    pub is_rounding: bool,
}

/// Relation of the computed to the stated value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Relation {
    /// The stated value is an upper bound.
    AtMost,
    /// Both agree within this difference.
    Within(f64),
}

impl Claim {
    /// True if the statement holds for the computed value.
    pub fn holds(&self) -> bool {
        match self.relation {
            Relation::AtMost => self.found <= self.stated,
            Relation::Within(distance) => (self.found - self.stated).abs() <= distance,
        }
    }

    /// A row of a Markdown table: strategy, source, statement, setting, stated value, computed value.
    pub fn row(&self) -> String {
        let relation = match self.relation {
            Relation::AtMost => "≤ ",
            Relation::Within(_) => "",
        };
        format!(
            "| `{}` | {} | {} | {} | {relation}{} | {} |",
            self.strategy,
            self.source,
            self.statement,
            self.setting,
            shown(self.stated),
            shown(self.found)
        )
    }
}

/// A number with three significant digits.
fn shown(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        size if !(1e-2..1e4).contains(&size) => format!("{value:.2e}"),
        size if size >= 100.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        size if size >= 1.0 => format!("{value:.2}"),
        size if size >= 0.1 => format!("{value:.3}"),
        _ => format!("{value:.4}"),
    }
}

const UNIT: f64 = f64::EPSILON / 2.0;

/// All claims, in the order of the strategies.
///
/// # Errors
/// [`ParameterError`] of a strategy that cannot be constructed; this does not occur.
pub fn claims() -> Result<Vec<Claim>, ParameterError> {
    let mut claims = exact_sums()?;
    claims.extend(short_memory_principle()?);
    claims.extend(filters());
    claims.extend(l1_formula()?);
    claims.extend(sums_of_exponentials()?);
    claims.extend(oblivious_quadrature()?);
    Ok(claims)
}

/// Memory terms of a run with one channel.
fn terms(memory: &mut dyn Memory<f64>, samples: &[f64]) -> Vec<f64> {
    let mut term = [f64::NAN];
    let mut step = |sample: &f64| {
        // NaN in place of a refused term makes every claim fail.
        let served = memory.next_term(&mut term).and_then(|()| memory.push(&[*sample]));
        if served.is_ok() { term[0] } else { f64::NAN }
    };
    samples.iter().map(&mut step).collect()
}

fn weights_of_root(count: usize) -> Result<Vec<f64>, ParameterError> {
    Ok(ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 1.0)?.take(count).collect())
}

/// Largest error of a term divided by `scale`, which is given the exact term and ‖w‖₂‖x‖₂ up to its step.
fn rounding(
    memory: &mut dyn Memory<f64>,
    weights: &[f64],
    steps: usize,
    scale: impl Fn(&MemoryTerm, f64) -> f64,
) -> f64 {
    let samples = Signal::Stationary.samples::<f64>(1, steps);
    let found = terms(memory, &samples);
    let norm = |numbers: &[f64]| numbers.iter().map(|number| number * number).sum::<f64>().sqrt();
    let error = |k: usize| {
        let exact = memory_term(weights, 1, &samples, 1, k)[0];
        let norms = norm(&weights[1..=k]) * norm(&samples[..k]);
        (found[k] - exact.sum).abs() / scale(&exact, norms)
    };
    (1..steps).filter(|k| k % 37 == 5 || k + 1 == steps).map(error).fold(0.0, max_or_nan)
}

fn exact_sums() -> Result<Vec<Claim>, ParameterError> {
    const SETTING: &str = "s^½, BDF of order 1, 4096 steps, noise on a wave";
    const STEPS: usize = 4096;
    let weights = weights_of_root(STEPS)?;
    // Transforms of length n ≤ 2N have an error of log₂ n · (1 + 4√2) u relative to the norm; three of them
    // and a product follow one another. Lags that share a transform are in at most two pieces, hence the
    // factor 2.
    let of_a_transform = (2.0 * STEPS as f64).log2() * (1.0 + 4.0 * 2.0f64.sqrt());
    let bound = 2.0 * (3.0 * of_a_transform + 4.0);
    let mut naive = PlainSum::new(&weights, 1, STEPS)?;
    let mut claims = vec![Claim {
        strategy: "naive",
        source: "[Higham02] §3.1",
        statement: "theorem: a sum of N products is right to N u Σ\\|w\\|\\|x\\|; error in u of it",
        setting: SETTING,
        stated: STEPS as f64,
        found: rounding(&mut naive, &weights, STEPS, |term, _| UNIT * term.absolute),
        relation: Relation::AtMost,
        is_rounding: true,
    }];
    let rivals: [(&'static str, &'static str, Box<dyn Memory<f64>>); 4] = [
        ("hls", "[HLS], [Higham02] §24.1", Box::new(TextbookHls::new(&weights, 1, STEPS)?)),
        ("uniform", "[Wefers15], [Higham02] §24.1", Box::new(uniform_partition(&weights, 1, STEPS)?)),
        ("gardner", "[Gardner95], [Higham02] §24.1", Box::new(non_uniform_partition(&weights, 1, STEPS)?)),
        ("relaxed", "[vdHoeven03], [Higham02] §24.1", Box::new(RelaxedProduct::new(&weights, 1, STEPS)?)),
    ];
    for (strategy, source, mut memory) in rivals {
        claims.push(Claim {
            strategy,
            source,
            statement: "theorem: the sum itself, with the rounding of transforms; error in u‖w‖₂‖x‖₂",
            setting: SETTING,
            stated: bound,
            found: rounding(&mut *memory, &weights, STEPS, |_, norms| UNIT * norms),
            relation: Relation::AtMost,
            is_rounding: true,
        });
    }
    Ok(claims)
}

/// |D^β f − D^β of the window| ≤ M L^{−β}/|Γ(1−β)| for |f| ≤ M, on f = 1.
fn short_memory_principle() -> Result<Vec<Claim>, ParameterError> {
    let claim = |order: f64, setting| -> Result<Claim, ParameterError> {
        let (step, steps, window) = (0.01, 10_000, 100);
        // Of order 2, so that the quadrature error is negligible compared with the bound, which is nearly
        // attained.
        let weights: Vec<f64> =
            ConvolutionWeights::bdf(BdfOrder::new(2)?, order, step)?.take(steps).collect();
        let ones = vec![1.0; steps];
        let all = terms(&mut PlainSum::new(&weights, 1, steps)?, &ones);
        let short = terms(&mut PlainSum::new(&weights[..=window], 1, steps)?, &ones);
        let error = all.iter().zip(&short).map(|(all, short)| (all - short).abs()).fold(0.0, max_or_nan);
        Ok(Claim {
            strategy: "short-memory",
            source: "[Podlubny] §7.3",
            statement: "theorem: a window L leaves out at most M L^−β/\\|Γ(1−β)\\| of D^β f, \\|f\\| ≤ M",
            setting,
            stated: 1.0 / libm::tgamma(1.0 - order).abs(),
            found: error,
            relation: Relation::AtMost,
            is_rounding: false,
        })
    };
    Ok(vec![
        claim(0.3, "s^0.3, f = 1, L = 1, t ≤ 100, BDF of order 2, h = 0.01")?,
        claim(0.5, "s^½, f = 1, L = 1, t ≤ 100, BDF of order 2, h = 0.01")?,
        claim(1.5, "s^1.5, f = 1, L = 1, t ≤ 100, BDF of order 2, h = 0.01")?,
    ])
}

fn filters() -> Vec<Claim> {
    // Oustaloup: α is the ratio pole/zero of a section, αη the ratio of successive zeros; far from the ends
    // of the band the logarithm of the filter over s^β is periodic in log ω.
    let (order, low, high, count) = (0.4, 1e-8, 1e8, 20);
    let sections: Vec<_> = recursion(order, low, high, count).collect();
    let spacing = libm::log(sections[1].zero / sections[0].zero);
    let of_a_pair = sections[0].pole.map_or(f64::NAN, |pole| libm::log(pole / sections[0].zero));
    let level = |x: f64| {
        let place = Complex::new(0.0, libm::exp(x));
        let factor =
            |section: &crate::Section| (place + section.zero) / (place + section.pole.unwrap_or(f64::NAN));
        libm::log(sections.iter().map(factor).product::<Complex<f64>>().norm()) - order * x
    };
    let levels: Vec<f64> = (0..400).map(|index| level(spacing * f64::from(index) / 400.0)).collect();
    let highest = levels.iter().copied().fold(f64::NEG_INFINITY, max_or_nan);
    let lowest = levels.iter().copied().fold(f64::INFINITY, min_or_nan);
    let ripple = libm::sin(PI * order) * libm::exp(PI * PI / spacing) / libm::sinh(2.0 * PI * PI / spacing);

    let (points, from, to) = (9, 1e-3, 1e2);
    let fraction = RationalPower::through_gains(0.5, from, to, (points - 1) / 2);
    let error = |k: usize| {
        let s = from * libm::pow(to / from, k as f64 / (points - 1) as f64);
        fraction.as_ref().map_or(f64::NAN, |fraction| (fraction.value(s) / libm::sqrt(s) - 1.0).abs())
    };
    // The printed fractions are those of s^−½; the same with numerator and denominator exchanged is that of
    // s^½, of the recursion as of the interpolation.
    let printed = recursion(0.5, 1e-2, 1e2, 5).collect::<Vec<_>>();
    let zeros: Vec<f64> = printed.iter().map(|section| section.zero).collect();
    let poles: Vec<f64> = printed.iter().filter_map(|section| section.pole).collect();
    let recursive = max_or_nan(
        printed_difference(&zeros, 10.0, &[10.0, 298.5, 1218.0, 768.5, 74.97, 1.0]),
        printed_difference(&poles, 1.0, &[1.0, 74.97, 768.5, 1218.0, 298.5, 10.0]),
    );
    let through_nine = RationalPower::through_gains(0.5, 0.1, 10.0, 4).map_or(f64::NAN, |fraction| {
        max_or_nan(
            printed_difference(&fraction.zeros, 1.0, &[1.0, 13.0, 20.84, 4.876, 0.08551]),
            printed_difference(&fraction.poles, 1.0 / fraction.gain, &[0.08549, 4.877, 20.84, 12.995, 1.0]),
        )
    });
    vec![
        Claim {
            strategy: "oustaloup",
            source: "[VinagrePHF00]",
            statement: "printed to four digits: the coefficients; largest relative difference",
            setting: "s^½, 5 pairs on 10⁻² ≤ ω ≤ 10²",
            stated: 5e-4,
            found: recursive,
            relation: Relation::AtMost,
            is_rounding: false,
        },
        Claim {
            strategy: "oustaloup",
            source: "[Oustaloup00]",
            statement: "synthesis: log α/log αη of the recursion of zeros and poles is the order",
            setting: "s^0.4, 20 pairs on 10⁻⁸ ≤ ω ≤ 10⁸",
            stated: order,
            found: of_a_pair / spacing,
            relation: Relation::Within(1e-12),
            is_rounding: false,
        },
        Claim {
            strategy: "oustaloup",
            source: "[Oustaloup00], by Poisson's sum",
            statement: "theorem: inside the band the gain ripples by sin πβ e^{π²/ln αη}/sinh(2π²/ln αη)",
            setting: "s^0.4, 20 pairs on 10⁻⁸ ≤ ω ≤ 10⁸",
            stated: ripple,
            found: 0.5 * (highest - lowest),
            relation: Relation::Within(1e-4 * ripple),
            is_rounding: false,
        },
        Claim {
            strategy: "matsuda",
            source: "[MatsudaFujii93]",
            statement: "synthesis: the fraction has the gain of s^β at its points; largest relative error there",
            setting: "s^½, 9 points on 10⁻³ ≤ s ≤ 10²",
            stated: 0.0,
            found: (0..points).map(error).fold(0.0, max_or_nan),
            relation: Relation::Within(1e-10),
            is_rounding: false,
        },
        Claim {
            strategy: "matsuda",
            source: "[VinagrePHF00]",
            statement: "printed to four digits: the coefficients; largest relative difference",
            setting: "s^½, 9 points on 10⁻¹ ≤ s ≤ 10",
            stated: 5e-4,
            found: through_nine,
            relation: Relation::AtMost,
            is_rounding: false,
        },
    ]
}

/// Largest relative difference between the coefficients of `leading` · Π (s + root), from the highest power,
/// and those printed.
fn printed_difference(roots: &[f64], leading: f64, printed: &[f64]) -> f64 {
    let mut coefficients = vec![leading];
    for root in roots {
        coefficients.push(0.0);
        for k in (1..coefficients.len()).rev() {
            coefficients[k] += root * coefficients[k - 1];
        }
    }
    assert_eq!(coefficients.len(), printed.len());
    coefficients
        .iter()
        .zip(printed)
        .map(|(found, printed)| (found / printed - 1.0).abs())
        .fold(0.0, max_or_nan)
}

/// Factor of h^{2−β} max|f″| in the bound of the L1 formula.
fn l1_bound(order: f64) -> f64 {
    let power = libm::pow(2.0, 2.0 - order);
    ((1.0 - order) / 12.0 + power / (2.0 - order) - (1.0 + libm::pow(2.0, -order)))
        / libm::tgamma(2.0 - order)
}

/// Largest error of D^β f on (0, 1] with `steps` steps, for f zero at the start.
fn derivative_error(
    memory: &mut dyn Memory<f64>,
    steps: usize,
    f: impl Fn(f64) -> f64,
    exact: impl Fn(f64) -> f64,
) -> f64 {
    let times: Vec<f64> = (1..=steps).map(|k| k as f64 / steps as f64).collect();
    let samples: Vec<f64> = times.iter().map(|&t| f(t)).collect();
    let leading = memory.leading()[0];
    let terms = terms(memory, &samples);
    let errors = times.iter().zip(&samples).zip(&terms);
    errors.map(|((&t, x), term)| (leading * x + term - exact(t)).abs()).fold(0.0, max_or_nan)
}

fn square_error(memory: &mut dyn Memory<f64>, order: f64, steps: usize) -> f64 {
    let scale = 2.0 / libm::tgamma(3.0 - order);
    derivative_error(memory, steps, |t| t * t, |t| scale * libm::pow(t, 2.0 - order))
}

fn l1_formula() -> Result<Vec<Claim>, ParameterError> {
    let of = |order: f64, steps: usize| -> Result<PlainSum, ParameterError> {
        PlainSum::new(&l1_weights(order, 1.0 / steps as f64, steps)?, 1, steps)
    };
    let bounded = |order: f64, setting| -> Result<Claim, ParameterError> {
        Ok(Claim {
            strategy: "l1",
            source: "[SunWu06] Lemma 2.1",
            statement: "theorem: bound of the error, of order 2 − β, by max\\|f″\\|",
            setting,
            stated: 2.0 * l1_bound(order) * libm::pow(0.01, 2.0 - order),
            found: square_error(&mut of(order, 100)?, order, 100),
            relation: Relation::AtMost,
            is_rounding: false,
        })
    };
    let order = 0.5;
    let error = |steps: usize| -> Result<f64, ParameterError> {
        Ok(derivative_error(
            &mut of(order, steps)?,
            steps,
            |t| libm::pow(t, 3.0 + order),
            |t| libm::tgamma(4.0 + order) / 6.0 * t * t * t,
        ))
    };
    Ok(vec![
        bounded(0.3, "s^0.3, f = t², 100 steps to t = 1")?,
        bounded(0.5, "s^½, f = t², 100 steps to t = 1")?,
        bounded(0.8, "s^0.8, f = t², 100 steps to t = 1")?,
        Claim {
            strategy: "l1",
            source: "[SunWu06] Lemma 2.1",
            statement: "theorem: the order 2 − β",
            setting: "s^½, f = t^3.5, 800 and 1600 steps to t = 1",
            stated: 2.0 - order,
            found: libm::log2(error(800)? / error(1600)?),
            relation: Relation::Within(0.02),
            is_rounding: false,
        },
    ])
}

/// Largest |Σ a e^{−λt} − Γ(p+1) t^{−p−1}|, divided by `scale` of the exact value, for 1 ≤ t ≤ N.
fn kernel_error(terms: &[Term], p: f64, steps: usize, scale: impl Fn(f64) -> f64) -> f64 {
    let gamma = libm::tgamma(p + 1.0);
    let error = |index: u32| {
        let t = libm::pow(steps as f64, f64::from(index) / 600.0);
        let sum: f64 = terms.iter().map(|term| term.amplitude * libm::exp(-term.rate * t)).sum();
        let exact = gamma * libm::pow(t, -p - 1.0);
        (sum - exact).abs() / scale(exact)
    };
    (0..=600).map(error).fold(0.0, max_or_nan)
}

fn sums_of_exponentials() -> Result<Vec<Claim>, ParameterError> {
    let (order, steps): (f64, usize) = (0.5, 100);
    let step = 1.0 / steps as f64;
    let gamma = libm::tgamma(1.0 + order);
    // Absolute error of t^{−1−β} itself, t in seconds.
    let absolute = |tolerance: f64| -> Result<(f64, usize), ParameterError> {
        let (points, _) = crate::jiang::fewest_points(order, step, steps, tolerance, |points| {
            let terms = crate::jiang::kernel_terms(order, steps, tolerance, points);
            crate::jiang::modes_of(order, step, &terms)
        })?;
        let terms = crate::jiang::kernel_terms(order, steps, tolerance, points);
        let error = kernel_error(&terms, order, steps, |_| gamma) * libm::pow(step, -1.0 - order);
        Ok((error, terms.len()))
    };
    let epsilon = 1e-9;
    let (kernel, _) = absolute(epsilon * libm::pow(step, 1.0 + order))?;
    let coarse = 1e-2;
    let (epsilon_of_coarse, _) = absolute(coarse)?;
    let mut fast = jiang(order, step, 1, steps, coarse)?;
    let modes = |steps: usize| -> Result<f64, ParameterError> {
        Ok(jiang(order, 1.0, 1, steps, 1e-9)?.modes() as f64)
    };
    let compressed = |steps: usize| -> Result<f64, ParameterError> {
        Ok(kernel_compression(order, 1.0, 1, steps, 1e-8)?.modes() as f64)
    };
    let ratio = crate::kernel_compression::RATIO;
    // Gauss rules converge like ρ^{−2n}, where ρ belongs to the Bernstein ellipse through the singularity of
    // λ^{β−1} at zero.
    let place = (ratio + 1.0) / (ratio - 1.0);
    let ellipse = place + libm::sqrt(place * place - 1.0);
    let relative = |points: usize| {
        let terms = power_rules(order - 1.0, 1e6, ratio, 64.0, points);
        kernel_error(&terms, order - 1.0, 1_000_000, |exact| exact)
    };
    Ok(vec![
        Claim {
            strategy: "jiang",
            source: "[JiangZhangZhangZhang17] §2",
            statement: "theorem: absolute error ε of t^−1−β on [h, T]",
            setting: "β = ½, h = 0.01, T = 1, ε = 10⁻⁹",
            stated: epsilon,
            found: kernel,
            relation: Relation::AtMost,
            is_rounding: false,
        },
        Claim {
            strategy: "jiang",
            source: "[JiangZhangZhangZhang17] §2",
            statement: "theorem: the error is that of L1 and β ε T/Γ(1−β) max\\|f\\| at most",
            setting: "s^½, f = t², 100 steps to t = 1, weights right to 10⁻²",
            stated: 2.0 * l1_bound(order) * libm::pow(step, 2.0 - order)
                + order * epsilon_of_coarse / libm::tgamma(1.0 - order),
            found: square_error(&mut fast, order, steps),
            relation: Relation::AtMost,
            is_rounding: false,
        },
        Claim {
            strategy: "jiang",
            source: "[JiangZhangZhangZhang17], abstract",
            statement: "theorem: O(log N) exponentials; those for 2²⁰ steps over those for 2¹⁰",
            setting: "β = ½, T = N, 10⁻⁹",
            stated: 2.0,
            found: modes(1 << 20)? / modes(1 << 10)?,
            relation: Relation::AtMost,
            is_rounding: false,
        },
        Claim {
            strategy: "baffet-hesthaven",
            source: "[Baffet19]",
            statement: "theorem: geometric convergence, the error of a rule divided by (2 + √3)² a point",
            setting: "t^−½ on 1 ≤ t ≤ 10⁶, intervals that grow threefold, 2 to 8 points",
            stated: ellipse * ellipse,
            found: libm::pow(relative(2) / relative(8), 1.0 / 6.0),
            relation: Relation::Within(1.0),
            is_rounding: false,
        },
        Claim {
            strategy: "baffet-hesthaven",
            source: "[BaffetHesthaven17]",
            statement: "theorem: O(log N) auxiliary variables; those for 2²⁰ steps over those for 2¹⁰",
            setting: "β = ½, 10⁻⁸",
            stated: 2.0,
            found: compressed(1 << 20)? / compressed(1 << 10)?,
            relation: Relation::AtMost,
            is_rounding: false,
        },
    ])
}

fn oblivious_quadrature() -> Result<Vec<Claim>, ParameterError> {
    let symbol = |s: Complex<f64>| s.sqrt();
    let of = |steps: usize, tolerance: f64| -> Result<(Vec<f64>, ObliviousQuadrature), ParameterError> {
        let weights = weights_of_root(steps)?;
        let memory = ObliviousQuadrature::new(&symbol, &weights, 1.0, 1, steps, tolerance)?;
        Ok((weights, memory))
    };
    let nodes = |steps: usize, tolerance: f64| -> Result<f64, ParameterError> {
        Ok(of(steps, tolerance)?.1.nodes() as f64)
    };
    let (steps, tolerance) = (4096, 1e-6);
    let (weights, mut memory) = of(steps, tolerance)?;
    // Levels of base 8 over 2^10 and 2^16 steps: 3 and 5.
    Ok(vec![
        Claim {
            strategy: "oblivious",
            source: "[SchädleLFLubich06]",
            statement: "theorem: contours of enough points keep any tolerance; error over Σ\\|w\\|\\|x\\|",
            setting: "s^½, implicit Euler, 4096 steps, 10⁻⁶",
            stated: tolerance,
            found: rounding(&mut memory, &weights, steps, |term, _| term.absolute),
            relation: Relation::AtMost,
            is_rounding: false,
        },
        Claim {
            strategy: "oblivious",
            source: "[SchädleLFLubich06], abstract",
            statement: "theorem: O(log N) evaluations of K(s); those for 2¹⁶ steps over those for 2¹⁰",
            setting: "s^½, implicit Euler, 10⁻⁵, five levels over three",
            stated: 5.0 / 3.0,
            found: nodes(1 << 16, 1e-5)? / nodes(1 << 10, 1e-5)?,
            relation: Relation::Within(0.15),
            is_rounding: false,
        },
        Claim {
            strategy: "oblivious",
            source: "[SchädleLFLubich06]",
            statement: "theorem: O(log 1/ε) points a contour; those for 10⁻⁸ over those for 10⁻⁴",
            setting: "s^½, implicit Euler, 1024 steps",
            stated: 2.0,
            found: nodes(1 << 10, 1e-8)? / nodes(1 << 10, 1e-4)?,
            relation: Relation::AtMost,
            is_rounding: false,
        },
    ])
}
