//! A fractional PID controller in whole numbers: its constants as Rust and C, and what rounding does to it.

use crate::exponentials::controller_source::{ControllerTables, camel_case};
use crate::exponentials::exponential_table::ExponentialKernel;
use fvi_core::{
    AntiWindup, DerivativeFilter, DerivativeOf, FixedGain, FixedLaw, FixedOperator, FixedTerm, FixedWindup,
    ParameterError, PidGains, PidLaw,
};
use std::fmt::Write as _;

/// Decays below which an exponential is a sum that stays, 2⁻⁵⁰, and from which one fits.
const STANDING: f64 = 8.9e-16;
const SLOWEST: f64 = 4.7e-10;

/// Factor from a sum that stays to units of the output, so that it saturates far beyond all outputs.
const OF_STANDING: f64 = 1.0 / 4096.0;

/// The constants of a [`FixedPid`](fvi_core::FixedPid).
#[derive(Clone, Debug)]
pub struct FixedController {
    integral: Operator,
    derivative: Operator,
    /// The law without its operators.
    law: FixedLaw<'static>,
    units: FixedUnits,
    rounding: f64,
}

/// What a count is worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixedUnits {
    /// Of setpoint and measured value.
    pub input: f64,
    /// Of the output.
    pub output: f64,
}

/// An operator; empty where its gain is zero.
#[derive(Clone, Debug, Default)]
struct Operator {
    head: Vec<FixedGain>,
    terms: Vec<FixedTerm>,
}

const NONE: FixedOperator<'static> = FixedOperator { head: &[], terms: &[] };

fn refused(parameter: &'static str, value: f64, allowed: &'static str) -> ParameterError {
    ParameterError { parameter, value, allowed }
}

fn gain(parameter: &'static str, value: f64) -> Result<FixedGain, ParameterError> {
    let allowed = "a number whose factor between counts fits: other units of the counts";
    FixedGain::nearest(value).ok_or_else(|| refused(parameter, value, allowed))
}

impl Operator {
    /// K times the operator of a table; `factor` is that of its samples to units of the output.
    fn new(parameter: &'static str, table: &ExponentialKernel, factor: f64) -> Result<Self, ParameterError> {
        let length = table.head().len() as f64;
        let weights = table.head().iter().map(|weight| gain(parameter, weight * factor));
        let terms = table.exponentials().iter().map(|e| {
            let output = e.coefficient * libm::exp(-e.rate * length) * factor;
            Self::term(parameter, -libm::expm1(-e.rate), output)
        });
        Ok(Self { head: weights.collect::<Result<_, _>>()?, terms: terms.collect::<Result<_, _>>()? })
    }

    /// I¹: the sum of all samples.
    fn sum(parameter: &'static str, factor: f64) -> Result<Self, ParameterError> {
        let weight = gain(parameter, factor)?;
        Ok(Self { head: vec![weight; 2], terms: vec![Self::term(parameter, 0.0, factor)?] })
    }

    fn term(parameter: &'static str, decay: f64, output: f64) -> Result<FixedTerm, ParameterError> {
        let (decay, lift) = if decay < STANDING {
            (0.0, libm::ceil(libm::log2((output / OF_STANDING).abs())).clamp(0.0, 31.0))
        } else if decay >= SLOWEST {
            (decay, (31.0 - libm::ceil(-libm::log2(decay))).clamp(0.0, 31.0))
        } else {
            let allowed = "at least 2^-31 in whole numbers: a band that begins at a higher frequency";
            return Err(refused("decay of an exponential", decay, allowed));
        };
        let output = gain(parameter, output * libm::exp2(-lift))?;
        Ok(FixedTerm { decay: gain(parameter, decay)?, output, lift: lift as i32 })
    }

    /// The weight of the sample of a tick.
    fn leading(&self) -> f64 {
        self.head.first().copied().unwrap_or(FixedGain::ZERO).value()
    }

    /// Σ |W_n − W_{n−1}| of the weights W on increments, at most: what the operator makes of samples whose
    /// increments it takes and that are off by 1 at most. For orders up to 1 it is twice the leading weight.
    fn variation(&self) -> f64 {
        let head: Vec<f64> = self.head.iter().map(|weight| weight.value()).collect();
        let [Some(first), Some(last)] = [head.first(), head.last()] else { return 0.0 };
        // Of an exponential that begins at the lag behind the head.
        let starts = |term: &FixedTerm| term.output.value() * libm::exp2(f64::from(term.lift));
        let next: f64 = self.terms.iter().map(starts).sum();
        let sizes: f64 = self.terms.iter().map(|term| starts(term).abs()).sum();
        let between: f64 = head.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum();
        first.abs() + between + (next - last).abs() + sizes
    }

    fn fixed(&self) -> FixedOperator<'_> {
        FixedOperator { head: &self.head, terms: &self.terms }
    }

    /// Bound on what rounding does to the operator, in units of 2⁻¹⁶ counts of the output, for samples that
    /// are exact.
    fn rounding(&self) -> f64 {
        let weights = self.head.iter().filter(|weight| weight.shift > 0 && weight.mantissa != 0).count();
        let terms = self.terms.iter().map(|term| {
            let kept = match term.decay.value() {
                0.0 => 0.0,
                decay => term.decay.rounding() / decay * term.output.value().abs(),
            };
            kept + term.output.rounding()
        });
        0.5 * weights as f64 + terms.sum::<f64>()
    }
}

/// Whole counts within limits; infinite ones are those of 32 bits.
fn limits([lower, upper]: [f64; 2], unit: f64) -> Result<[i64; 2], ParameterError> {
    let count = |limit: f64, inwards: fn(f64) -> f64| {
        let counts = limit / unit;
        let nearest = counts.round();
        let whole = if (counts - nearest).abs() < 1e-6 { nearest } else { inwards(counts) };
        let fits = whole.abs() <= f64::from(i32::MAX);
        let allowed = "at most 2^31 - 1 counts: a larger unit of the output, or none";
        if fits { Ok(whole as i64) } else { Err(refused("limits", limit, allowed)) }
    };
    let lowest = if lower.is_finite() { count(lower, f64::ceil)? } else { i64::from(i32::MIN) };
    let highest = if upper.is_finite() { count(upper, f64::floor)? } else { i64::from(i32::MAX) };
    if lowest > highest {
        return Err(refused("limits", lower, "at least a count apart: a smaller unit of the output"));
    }
    Ok([lowest << FixedLaw::OUTPUT_DIGITS, highest << FixedLaw::OUTPUT_DIGITS])
}

impl FixedController {
    /// The constants of a law on tables for a band ([`ControllerTables::over_band`]).
    ///
    /// # Errors
    /// [`ParameterError`] for what whole numbers do not have: the series form, λ > 1, the derivative of a
    /// measured rate, a fractional filter, exponentials slower than 2⁻³¹ a tick; and for numbers that do not
    /// fit.
    pub fn new(
        law: &PidLaw<f64>,
        tables: &ControllerTables,
        units: FixedUnits,
    ) -> Result<Self, ParameterError> {
        let settings = law.settings();
        for (name, unit) in [("unit of the inputs", units.input), ("unit of the output", units.output)] {
            if !(unit > 0.0 && unit.is_finite()) {
                return Err(refused(name, unit, "positive and finite"));
            }
        }
        let PidGains::Parallel { proportional, integral, derivative } = settings.gains else {
            return Err(refused("form", f64::NAN, "parallel in whole numbers"));
        };
        let (lambda, mu) = (settings.integral_order, settings.derivative_order);
        if lambda > 1.0 {
            return Err(refused("integral order", lambda, "at most 1 in whole numbers"));
        }
        if settings.derivative_of == DerivativeOf::MeasuredRate {
            return Err(refused("derivative", f64::NAN, "of the values in whole numbers"));
        }
        if let DerivativeFilter::Fractional { order, .. } = settings.derivative_filter {
            return Err(refused("order of the derivative's filter", order, "1 in whole numbers"));
        }
        let step = law.constants().step;
        let counts = units.input / units.output * libm::exp2(f64::from(FixedLaw::OUTPUT_DIGITS));
        let samples = counts * libm::exp2(-f64::from(FixedLaw::SAMPLE_DIGITS));
        let of_integral = integral * libm::pow(step, lambda) * samples;
        let integral_operator = match integral {
            0.0 => Operator::default(),
            _ if lambda == 1.0 => Operator::sum("integral gain", of_integral)?,
            _ => Operator::new("integral gain", &tables.integral, of_integral)?,
        };
        let of_derivative = derivative * libm::pow(step, -mu) * samples;
        let derivative_operator = match derivative {
            0.0 => Operator::default(),
            _ => Operator::new("derivative gain", &tables.derivative, of_derivative)?,
        };
        let [b, c] = settings.setpoint_weights;
        if c.abs() > 3.0 {
            return Err(refused("setpoint weight", c, "at most 3 for the derivative, in whole numbers"));
        }
        let leading = integral_operator.leading();
        let anti_windup = match settings.anti_windup {
            _ if leading == 0.0 => FixedWindup::None,
            AntiWindup::None => FixedWindup::None,
            AntiWindup::Conditional => FixedWindup::Conditional(gain("integral gain", leading.recip())?),
            AntiWindup::BackCalculation { time } => {
                // w/τ^λ is the ratio of the two.
                let ratio = libm::pow(step / time, lambda);
                let factor = ratio / (1.0 + ratio) / leading;
                FixedWindup::BackCalculation(gain("tracking time", factor)?)
            }
        };
        let stride = match settings.rate_limit * step / units.output
            * libm::exp2(f64::from(FixedLaw::OUTPUT_DIGITS))
        {
            stride if stride >= libm::exp2(62.0) => i64::MAX,
            stride if stride >= 1.0 => stride as i64,
            _ => {
                let allowed = "at least 2^-16 counts a tick: a smaller unit of the output";
                return Err(refused("rate limit", settings.rate_limit, allowed));
            }
        };
        let law = FixedLaw {
            setpoint: gain("proportional gain", proportional * b * counts)?,
            measured: gain("proportional gain", proportional * counts)?,
            integral: NONE,
            derivative: NONE,
            derivative_weight: gain("setpoint weight", c * libm::exp2(f64::from(FixedLaw::SAMPLE_DIGITS)))?,
            from_rest: settings.derivative_of == DerivativeOf::ValuesFromRest,
            filter_share: gain("time of the derivative's filter", law.constants().filter_share)?,
            limits: limits(settings.limits, units.output)?,
            stride,
            anti_windup,
        };
        let mut made =
            Self { integral: integral_operator, derivative: derivative_operator, law, units, rounding: 0.0 };
        made.rounding = made.bound();
        Ok(made)
    }

    /// Bound on what rounding does to an output that has reached no limit, in its counts.
    fn bound(&self) -> f64 {
        let word = |gain: FixedGain| if gain.mantissa == 0 || gain.shift <= 0 { 0.0 } else { 0.5 };
        let proportional = word(self.law.setpoint) + word(self.law.measured);
        // Of samples of which each is off by half a unit.
        let weight = self.law.derivative_weight.value();
        let of_weight = if weight.fract() == 0.0 { 0.0 } else { 0.5 };
        let share = self.law.filter_share;
        // The filter has 15 digits more, and is rounded to those of the output.
        let filter = if self.derivative.head.is_empty() {
            0.0
        } else {
            0.5 + share.rounding() / share.value() * libm::exp2(-15.0)
        };
        let derivative = self.derivative.rounding() + self.derivative.variation() * of_weight + filter;
        let units = proportional + self.integral.rounding() + derivative;
        0.5 + units * libm::exp2(-f64::from(FixedLaw::OUTPUT_DIGITS))
    }

    /// Bound on the difference between an output and that of exact arithmetic with the same constants, in
    /// counts of the output, half a count of which is the rounding of the output itself. It holds for any
    /// inputs within ±(2²³ − 1) counts as long as no limit is reached and no sum saturates.
    pub fn rounding(&self) -> f64 {
        self.rounding
    }

    /// The law.
    pub fn law(&self) -> FixedLaw<'_> {
        FixedLaw { integral: self.integral.fixed(), derivative: self.derivative.fixed(), ..self.law }
    }

    /// What the constants are for, in a line.
    pub fn worth(&self) -> String {
        format!(
            "a count of setpoint and measured value is {}, of the output {}; inputs saturate at ±{} counts; the \
             output is within {:.3} counts of exact arithmetic as long as it has reached no limit",
            self.units.input,
            self.units.output,
            FixedLaw::LARGEST_INPUT,
            // Rounded up.
            (1e3 * self.rounding).ceil() * 1e-3
        )
    }

    /// The sentences before the constants.
    fn about(&self, sample: f64, tables: &ControllerTables, note: &str) -> Vec<String> {
        let mut lines =
            vec![format!("A controller in whole numbers, sample {sample}{note}: {}.", self.worth())];
        let used = |part: &str| match part {
            "integral" => !self.integral.head.is_empty(),
            _ => !self.derivative.head.is_empty(),
        };
        let errors = tables.errors.iter().filter(|(part, _)| used(part));
        lines.extend(errors.map(|(part, errors)| format!("Its {part}: {errors}.")));
        lines
    }

    /// The controller as Rust source.
    pub fn rust(&self, name: &str, sample: f64, tables: &ControllerTables, note: &str) -> String {
        let (small, large) = (name.to_ascii_lowercase(), name.to_ascii_uppercase());
        let camel = camel_case(&small);
        let gain = |gain: FixedGain| {
            format!("fvi_core::FixedGain {{ mantissa: {}, shift: {} }}", gain.mantissa, gain.shift)
        };
        let operator = |operator: &Operator| {
            let mut text = "fvi_core::FixedOperator {\n        head: &[\n".to_owned();
            for &weight in &operator.head {
                let _ = writeln!(text, "            {},", gain(weight));
            }
            text += "        ],\n        terms: &[\n";
            for FixedTerm { decay, output, lift } in &operator.terms {
                let _ = writeln!(
                    text,
                    "            fvi_core::FixedTerm {{\n                decay: {},\n                output: {},\n                \
                     lift: {lift},\n            }},",
                    gain(*decay),
                    gain(*output)
                );
            }
            text + "        ],\n    }"
        };
        let windup = match self.law.anti_windup {
            FixedWindup::None => "None".to_owned(),
            FixedWindup::BackCalculation(factor) => format!("BackCalculation({})", gain(factor)),
            FixedWindup::Conditional(factor) => format!("Conditional({})", gain(factor)),
        };
        let mut text = String::new();
        for line in self.about(sample, tables, note) {
            let _ = writeln!(text, "{}///", commented(&line));
        }
        let [lower, upper] = self.law.limits;
        let _ = write!(
            text,
            "/// [`new_{small}`] makes a controller of it.\n\
             pub const {large}_LAW: fvi_core::FixedLaw<'static> = fvi_core::FixedLaw {{\n    \
             setpoint: {},\n    measured: {},\n    integral: {},\n    derivative: {},\n    derivative_weight: {},\n    \
             from_rest: {},\n    filter_share: {},\n    limits: [{lower}, {upper}],\n    stride: {},\n    \
             anti_windup: fvi_core::FixedWindup::{windup},\n}};\n\n\
             /// A controller with [`{large}_LAW`]. It has no end.\n\
             pub type {camel}Pid =\n    fvi_core::FixedPid<&'static fvi_core::FixedLaw<'static>, [i64; {large}_LAW.state_len()]>;\n\n/// \
             The controller before its first tick.\n///\n/// # Errors\n/// None: the length is right.\n#[inline]\n\
             pub fn new_{small}() -> Result<{camel}Pid, fvi_core::ParameterError> {{\n    \
             fvi_core::FixedPid::new(&{large}_LAW, [0; {large}_LAW.state_len()])\n}}\n",
            gain(self.law.setpoint),
            gain(self.law.measured),
            operator(&self.integral),
            operator(&self.derivative),
            gain(self.law.derivative_weight),
            self.law.from_rest,
            gain(self.law.filter_share),
            self.law.stride,
        );
        text
    }

    /// The controller as constants of C for fvi.h.
    pub fn c(&self, name: &str, sample: f64, tables: &ControllerTables, note: &str) -> String {
        let large = name.to_ascii_uppercase();
        let gain = |gain: FixedGain| format!("{{{}, {}}}", gain.mantissa, gain.shift);
        let mut text = "#include <stdint.h>\n\n".to_owned();
        for line in self.about(sample, tables, note) {
            let _ = writeln!(text, "/* {line} */");
        }
        let mut members = Vec::new();
        for (part, operator) in [("integral", &self.integral), ("derivative", &self.derivative)] {
            let mut list = |what: &str, kind: &str, rows: Vec<String>| {
                if rows.is_empty() {
                    return;
                }
                let _ = write!(text, "static const {kind} {name}_{part}_{what}[] = {{\n    ");
                let _ = writeln!(text, "{},\n}};", rows.join(",\n    "));
                members.push(format!(".{part}_{what} = {name}_{part}_{what}"));
                members.push(format!(".{part}_{what}_count = {}", rows.len()));
            };
            list("head", "FviFixedGain", operator.head.iter().map(|&weight| gain(weight)).collect());
            let term =
                |term: &FixedTerm| format!("{{{}, {}, {}}}", gain(term.decay), gain(term.output), term.lift);
            list("terms", "FviFixedTerm", operator.terms.iter().map(term).collect());
        }
        let number = |number: i64| match number {
            i64::MIN => "INT64_MIN".to_owned(),
            _ => format!("INT64_C({number})"),
        };
        let [lower, upper] = self.law.limits.map(number);
        let (windup, factor) = match self.law.anti_windup {
            FixedWindup::None => ("FVI_PID_NO_ANTI_WINDUP", FixedGain::ZERO),
            FixedWindup::BackCalculation(factor) => ("FVI_PID_BACK_CALCULATION", factor),
            FixedWindup::Conditional(factor) => ("FVI_PID_CONDITIONAL", factor),
        };
        members.extend([
            format!(".setpoint = {}", gain(self.law.setpoint)),
            format!(".measured = {}", gain(self.law.measured)),
            format!(".derivative_weight = {}", gain(self.law.derivative_weight)),
            format!(".filter_share = {}", gain(self.law.filter_share)),
            format!(".limits = {{{lower}, {upper}}}"),
            format!(".stride = {}", number(self.law.stride)),
            format!(
                ".derivative_of = {}",
                if self.law.from_rest { "FVI_PID_FROM_REST" } else { "FVI_PID_OF_VALUES" }
            ),
            format!(".anti_windup = {windup}"),
            format!(".windup = {}", gain(factor)),
        ]);
        let _ = write!(
            text,
            "/* fvi_fixed_pid_init takes the law and {large}_NUMBERS numbers of state. The controller has no end. */\n\
             #define {large}_NUMBERS {}\nstatic const FviFixedLaw {name}_law = {{\n    {},\n}};\n",
            self.law().state_len(),
            members.join(",\n    ")
        );
        text
    }
}

/// Width of comments.
const WIDTH: usize = 108;

/// A sentence as lines of a comment of Rust.
fn commented(sentence: &str) -> String {
    let (mut text, mut line) = (String::new(), "///".to_owned());
    for word in sentence.split(' ') {
        if line.chars().count() + 1 + word.chars().count() > WIDTH {
            let _ = writeln!(text, "{line}");
            line = "///".to_owned();
        }
        let _ = write!(line, " {word}");
    }
    text + &line + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use fvi_core::{FixedPid, FractionalPid, PidSettings, max_or_nan};

    const SAMPLE: f64 = 1e-3;
    const BAND: [f64; 2] = [0.005, 200.0];

    fn made(
        settings: PidSettings<f64>,
        units: FixedUnits,
    ) -> (PidLaw<f64>, ControllerTables, FixedController) {
        let law = PidLaw::new(settings).unwrap();
        let tables = ControllerTables::over_band(&law, BAND, 1e-2).unwrap();
        let fixed = FixedController::new(&law, &tables, units).unwrap();
        (law, tables, fixed)
    }

    fn settings(lambda: f64, mu: f64) -> PidSettings<f64> {
        let gains = PidGains::Parallel { proportional: 3.0, integral: 8.0, derivative: 0.05 };
        PidSettings {
            integral_order: lambda,
            derivative_order: mu,
            derivative_filter: DerivativeFilter::FirstOrder { time: 0.004 },
            ..PidSettings::new(gains, SAMPLE)
        }
    }

    /// Setpoints and measured values: of full size and random, and in turn at rest, slow, small and constant,
    /// and at every tick another.
    fn inputs() -> impl Iterator<Item = [i32; 2]> {
        let mut seed = 1u64;
        let mut random = move |size: f64| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0) * size
        };
        (0u64..).map(move |k| {
            let slow = libm::sin(1e-4 * k as f64);
            match (k / 5000) % 6 {
                0 => [random(9e6) as i32, random(9e6) as i32],
                1 => [0, 0],
                2 => [(8e5 * slow) as i32, random(3.0) as i32],
                3 => [700, 699],
                4 => [if k % 2 == 0 { 1 } else { 4 }, 0],
                _ => [if k % 997 < 500 { i32::MAX } else { i32::MIN }, (3000.0 * slow) as i32],
            }
        })
    }

    /// The same law in double precision, without limits.
    struct Exact<'a> {
        law: FixedLaw<'a>,
        states: [Vec<f64>; 2],
        acted: Option<f64>,
        filtered: f64,
    }

    impl Exact<'_> {
        fn operator(of: FixedOperator<'_>, state: &mut [f64], sample: f64) -> f64 {
            let (delayed, sums) = state.split_at_mut(of.head.len().saturating_sub(1));
            let mut value = of.head.first().map_or(0.0, |weight| weight.value() * sample);
            value += of.head.iter().skip(1).zip(&*delayed).map(|(w, x)| w.value() * x).sum::<f64>();
            for (term, z) in of.terms.iter().zip(sums) {
                value += term.output.value() * *z;
                let oldest = delayed[delayed.len() - 1] * libm::exp2(f64::from(term.lift));
                *z += oldest - term.decay.value() * *z;
            }
            if !delayed.is_empty() {
                delayed.rotate_right(1);
                delayed[0] = sample;
            }
            value
        }

        /// The output in counts.
        fn tick(&mut self, inputs: [i32; 2]) -> f64 {
            let largest = f64::from(FixedLaw::LARGEST_INPUT);
            let [r, y] = inputs.map(|input| f64::from(input).clamp(-largest, largest));
            let acted = self.law.derivative_weight.value() * r - 32.0 * y;
            let rise = acted - self.acted.unwrap_or(acted);
            self.acted = Some(acted);
            let [of_integral, of_derivative] = &mut self.states;
            let derived = Self::operator(self.law.derivative, of_derivative, rise);
            self.filtered += self.law.filter_share.value() * (derived - self.filtered);
            let integral = Self::operator(self.law.integral, of_integral, 32.0 * (r - y));
            let proportional = self.law.setpoint.value() * r - self.law.measured.value() * y;
            (proportional + self.filtered + integral) * libm::exp2(-16.0)
        }
    }

    /// `FVI_TICKS` sets the number of ticks of each law, 10⁷ for instance.
    #[test]
    fn an_output_is_within_its_bound_of_double_precision() {
        let ticks = std::env::var("FVI_TICKS").map_or(100_000, |ticks| ticks.parse().unwrap());
        let coarse = FixedUnits { input: 1e-3, output: 0.5 };
        let fine = FixedUnits { input: 1e-6, output: 1e-4 };
        let weighted =
            |c: f64, lambda: f64| PidSettings { setpoint_weights: [0.7, c], ..settings(lambda, 0.6) };
        let above_one = PidSettings { derivative_order: 1.9, ..weighted(0.3, 0.8) };
        let from_zero = PidSettings { derivative_of: DerivativeOf::Values, ..settings(0.3, 1.0) };
        for (settings, units) in [
            (settings(0.8, 0.6), coarse),
            (settings(1.0, 0.6), fine),
            (weighted(0.3, 0.8), fine),
            (weighted(-1.0, 0.5), coarse),
            (from_zero, fine),
            (PidSettings { derivative_filter: DerivativeFilter::None, ..above_one }, fine),
        ] {
            let (_, _, fixed) = made(settings, units);
            let law = fixed.law();
            let mut pid = FixedPid::new(&law, vec![0; law.state_len()]).unwrap();
            let states = [law.integral, law.derivative]
                .map(|of| vec![0.0; of.terms.len() + of.head.len().saturating_sub(1)]);
            let acted = if law.from_rest { None } else { Some(0.0) };
            let mut exact = Exact { law, states, acted, filtered: 0.0 };
            let (mut largest, mut compared) = (0.0, 0u64);
            for input in inputs().take(ticks) {
                let (output, known) = (pid.tick(input[0], input[1]), exact.tick(input));
                // Outputs of 32 bits.
                if known.abs() < 2e9 {
                    largest = max_or_nan(largest, (f64::from(output) - known).abs());
                    compared += 1;
                }
            }
            println!(
                "{ticks} ticks, {compared} compared: {largest:.4} counts, bound {:.4}",
                fixed.rounding()
            );
            assert!(compared > ticks as u64 / 3);
            assert!(largest <= fixed.rounding(), "{settings:?}: {largest} beyond {}", fixed.rounding());
            assert!(largest > 0.45, "{largest}");
        }
    }

    /// With limits, a rate and anti-windup the law is that of a controller in double precision on the same
    /// tables.
    #[test]
    fn the_law_is_that_of_a_controller_in_floating_point() {
        let units = FixedUnits { input: 1e-4, output: 1e-3 };
        for (lambda, anti_windup) in [
            (0.8, AntiWindup::None),
            (0.8, AntiWindup::BackCalculation { time: 0.05 }),
            (0.8, AntiWindup::Conditional),
            (1.0, AntiWindup::BackCalculation { time: 0.05 }),
            (1.0, AntiWindup::Conditional),
        ] {
            let limited = PidSettings {
                limits: [-4.0, 5.0],
                rate_limit: 300.0,
                anti_windup,
                setpoint_weights: [0.8, 1.0],
                ..settings(lambda, 0.6)
            };
            let (law, tables, fixed) = made(limited, units);
            let memory = |kernel: fvi_core::Kernel, table: &ExponentialKernel| {
                let numbers = table.table::<f64>();
                let state = vec![0.0; numbers.borrow::<f64>().state_len(1)];
                kernel.exponential_sum(numbers, 1, state).unwrap()
            };
            let integral = memory(law.integral_kernel().unwrap(), &tables.integral);
            let derivative = memory(law.derivative_kernel().unwrap(), &tables.derivative);
            let mut double = FractionalPid::new(law, integral, derivative).unwrap();
            let of_counts = fixed.law();
            let mut pid = FixedPid::new(&of_counts, vec![0; of_counts.state_len()]).unwrap();
            let (mut largest, mut at_limits) = (0.0, 0);
            for k in 0..40_000 {
                let slow = libm::sin(3e-3 * f64::from(k));
                let setpoint = if k % 4000 < 2000 { 9000 } else { -3000 };
                let measured = (7000.0 * slow) as i32;
                let output = pid.tick(setpoint, measured);
                let [r, y] = [setpoint, measured].map(|count| f64::from(count) * units.input);
                let known = double.tick(r, y).unwrap() / units.output;
                at_limits += usize::from(known == -4000.0 || known == 5000.0);
                largest = max_or_nan(largest, (f64::from(output) - known).abs());
            }
            println!("{lambda}, {anti_windup:?}: {largest:.4} counts, {at_limits} at a limit");
            // Samples that wind back are rounded.
            assert!(at_limits > 1000 && largest < fixed.rounding() + 0.1, "{anti_windup:?}: {largest}");
        }
    }

    #[test]
    fn what_whole_numbers_do_not_have_is_refused() {
        let units = FixedUnits { input: 1e-3, output: 1e-3 };
        let refusal = |settings: PidSettings<f64>, units: FixedUnits| {
            let law = PidLaw::new(settings).unwrap();
            let tables = ControllerTables::over_band(&law, BAND, 1e-2).unwrap();
            FixedController::new(&law, &tables, units).unwrap_err().to_string()
        };
        let plain = settings(0.8, 0.6);
        let series = PidGains::Series {
            proportional: 1.0,
            integral_rate: 1.0,
            derivative_time: 0.0,
            filter_ratio: 10.0,
        };
        let series = PidSettings { gains: series, derivative_filter: DerivativeFilter::None, ..plain };
        let filter = DerivativeFilter::Fractional { time: 0.1, order: 0.7 };
        for (message, said) in [
            (refusal(series, units), "form"),
            (refusal(PidSettings { integral_order: 1.2, ..plain }, units), "integral order = 1.2"),
            (refusal(PidSettings { derivative_filter: filter, ..plain }, units), "filter = 0.7"),
            (refusal(PidSettings { limits: [-1e7, 1e7], ..plain }, units), "limits = -10000000"),
            (refusal(PidSettings { rate_limit: 1e-9, ..plain }, units), "rate limit"),
            (refusal(plain, FixedUnits { input: 0.0, ..units }), "unit of the inputs = 0"),
            (refusal(plain, FixedUnits { output: f64::NAN, ..units }), "unit of the output"),
            (refusal(plain, FixedUnits { input: 1e30, output: 1e-30 }), "other units"),
        ] {
            assert!(message.contains(said), "no {said} in {message}");
        }
    }
}
