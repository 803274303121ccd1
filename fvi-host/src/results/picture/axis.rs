//! Axes: range, ticks and their labels.

use core::ops::Range;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

/// Scale of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Linear.
    Linear,
    /// Logarithmic; values ≤ 0 are left out.
    Logarithmic,
}

/// Largest and smallest magnitude on a linear axis: larger numbers are left out, smaller ones are drawn at
/// zero.
pub(super) const LARGEST_PLACE: f64 = 1e290;
const SMALLEST_PLACE: f64 = 1e-280;

/// An axis with its label, unit included.
#[derive(Clone, Debug)]
pub struct Axis {
    label: String,
    scale: Scale,
    range: Option<(f64, f64)>,
}

impl Axis {
    /// A linear axis that fits the data.
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Linear, range: None }
    }

    /// A logarithmic axis that fits the data.
    pub fn logarithmic(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Logarithmic, range: None }
    }

    /// The axis with the name of its unit behind its label, if it has one.
    pub fn in_units(mut self, unit: &str) -> Self {
        if !unit.is_empty() {
            self.label = format!("{} ({unit})", self.label);
        }
        self
    }

    /// The axis with a range of its own; on a logarithmic axis both ends are > 0.
    pub fn with_range(mut self, from: f64, to: f64) -> Self {
        self.range = Some((from, to));
        self
    }

    /// True if a number is too large for the axis.
    pub(super) fn overflows(&self, value: f64) -> bool {
        value.is_finite() && self.scale == Scale::Linear && self.place(value).is_none()
    }

    pub(super) fn label(&self) -> &str {
        &self.label
    }

    /// The position of a value along the axis: the value itself, or its decimal logarithm; `None` if it
    /// cannot be drawn.
    ///
    /// On a linear axis the smallest numbers lie at zero and the largest are left out, so that widths and
    /// ticks neither overflow nor lose digits.
    pub(super) fn place(&self, value: f64) -> Option<f64> {
        match self.scale {
            _ if !value.is_finite() => None,
            Scale::Linear if value.abs() > LARGEST_PLACE => None,
            Scale::Linear => Some(if value.abs() < SMALLEST_PLACE { 0.0 } else { value }),
            Scale::Logarithmic => (value > 0.0).then(|| value.log10()),
        }
    }

    /// The ticks of an axis that ends with its data; about `count` of them.
    pub(super) fn ticks_over(&self, places: impl Iterator<Item = f64>, count: usize) -> Ticks {
        let ends = |range: Option<(f64, f64)>, place: f64| match range {
            Some((low, high)) => Some((low.min(place), high.max(place))),
            None => Some((place, place)),
        };
        let own = self.range.and_then(|(from, to)| Some((self.place(from)?, self.place(to)?)));
        match own.or_else(|| places.fold(None, ends)) {
            Some((low, high)) if low < high => match self.scale {
                Scale::Linear => Ticks::linear(low, high, count, true),
                Scale::Logarithmic => Ticks::logarithmic(low, high, count, true),
            },
            other => self.ticks(other.into_iter().flat_map(|(low, high)| [low, high]), count),
        }
    }

    /// The ticks for data at the given places; about `count` of them.
    pub(super) fn ticks(&self, places: impl Iterator<Item = f64>, count: usize) -> Ticks {
        let data = places.fold(None, |range: Option<(f64, f64)>, place| match range {
            Some((low, high)) => Some((low.min(place), high.max(place))),
            None => Some((place, place)),
        });
        let given = self.range.and_then(|(from, to)| Some((self.place(from)?, self.place(to)?)));
        let (low, high) = given.or(data).unwrap_or((0.0, 1.0));
        match self.scale {
            Scale::Linear => Ticks::linear(low, high, count, given.is_some()),
            Scale::Logarithmic => Ticks::logarithmic(low, high, count, given.is_some()),
        }
    }
}

/// A range with labelled ticks and unlabelled ones between them, as a coordinate of the plotting library.
#[derive(Clone, Debug)]
pub(super) struct Ticks {
    low: f64,
    high: f64,
    bold: Vec<(f64, String)>,
    light: Vec<f64>,
}

impl Ticks {
    fn linear(low: f64, high: f64, count: usize, fixed: bool) -> Self {
        // Equal values get a range of their own magnitude.
        let (low, high) = if high - low > 1e-12 * low.abs().max(high.abs()) {
            (low, high)
        } else {
            let half = if low == 0.0 { 1.0 } else { 0.1 * low.abs() };
            (low - half, high + half)
        };
        let step = round_step((high - low) / count as f64);
        let margin = if fixed { 0.0 } else { 0.03 * (high - low) };
        // An end of the range close to a tick is moved to it.
        let snap = |edge: f64, moved: f64| {
            let tick = (edge / step).round() * step;
            if (tick - edge).abs() < 1e-6 * step { tick } else { moved }
        };
        let (low, high) = (snap(low, low - margin), snap(high, high + margin));
        let indices = (low / step - 1e-9).ceil() as i64..=(high / step + 1e-9).floor() as i64;
        let bold = indices.map(|index| (index as f64 * step, linear_label(index, step))).collect();
        Self { low, high, bold, light: Vec::new() }
    }

    fn logarithmic(low: f64, high: f64, count: usize, fixed: bool) -> Self {
        let margin = if fixed { 0.0 } else { (0.03 * (high - low)).max(0.05) };
        let (low, high) = (low - margin, high + margin);
        let decades = (low - 1e-9).ceil() as i64..=(high + 1e-9).floor() as i64;
        let number = decades.clone().count();
        let stride = number.div_ceil(count.max(1)).max(1) as i64;
        let mut bold: Vec<(f64, String)> = Vec::new();
        let mut light = Vec::new();
        // On a short logarithmic range, intermediate digits are labelled too.
        let labelled = |digit: i32| number <= 2 && (digit == 2 || digit == 5 || high - low < 0.8);
        for decade in (low.floor() as i64)..=(high.ceil() as i64) {
            if decades.contains(&decade) {
                if decade % stride == 0 {
                    let label = match decade {
                        -3..0 if number <= 2 => {
                            format!("{:.*}", decade.unsigned_abs() as usize, 10.0_f64.powi(decade as i32))
                        }
                        _ => power_of_ten(decade),
                    };
                    bold.push((decade as f64, label));
                } else {
                    light.push(decade as f64);
                }
            }
            for digit in 2..=9 {
                let place = decade as f64 + f64::from(digit).log10();
                if place < low || place > high {
                    continue;
                }
                if labelled(digit) {
                    let label = match decade {
                        -3..0 => format!("{:.*}", decade.unsigned_abs() as usize, 10.0_f64.powf(place)),
                        0..=3 => format!("{:.0}", 10.0_f64.powf(place)),
                        _ => format!("{digit}·{}", power_of_ten(decade)),
                    };
                    bold.push((place, label));
                } else if stride == 1 {
                    light.push(place);
                }
            }
        }
        Self { low, high, bold, light }
    }

    /// The widest label, in characters.
    pub(super) fn label_width(&self) -> usize {
        self.bold.iter().map(|(_, label)| label.chars().count()).max().unwrap_or(0)
    }

    /// Places with labels.
    pub(super) fn labels(&self) -> &[(f64, String)] {
        &self.bold
    }

    pub(super) fn ends(&self) -> (f64, f64) {
        (self.low, self.high)
    }
}

impl Ranged for Ticks {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (value - self.low) / (self.high - self.low);
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        let bold = self.bold.iter().map(|&(place, _)| place);
        if hint.weight().allow_light_points() {
            bold.chain(self.light.iter().copied()).collect()
        } else {
            bold.collect()
        }
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for Ticks {
    fn format_ext(&self, value: &f64) -> String {
        self.bold.iter().find(|(place, _)| place == value).map(|(_, label)| label.clone()).unwrap_or_default()
    }
}

/// 1, 2 or 5 times a power of ten, not below `step`.
fn round_step(step: f64) -> f64 {
    let magnitude = 10.0_f64.powf(step.log10().floor());
    [1.0, 2.0, 5.0]
        .map(|digit| digit * magnitude)
        .into_iter()
        .find(|&round| round >= step)
        .unwrap_or(10.0 * magnitude)
}

fn linear_label(index: i64, step: f64) -> String {
    let value = index as f64 * step;
    let exponent = step.log10().floor() as i64;
    if index == 0 && exponent < -4 {
        return "0".to_owned();
    }
    // Beyond these magnitudes labels use a power of ten instead of many zeros.
    if exponent < -4 || value.abs() >= 1e6 {
        let leading = value.abs().log10().floor() as i64;
        let digits = usize::try_from(leading - exponent).unwrap_or(0);
        let mantissa = format!("{:.digits$}", value / 10.0_f64.powi(leading as i32));
        return format!("{}·{}", mantissa.replace('-', "−"), power_of_ten(leading));
    }
    let decimals = usize::try_from(-exponent).unwrap_or(0);
    let label = format!("{value:.decimals$}").replace('-', "−");
    let whole = label.chars().take_while(|&letter| letter != '.').count();
    if value.abs() < 1e4 {
        return label;
    }
    // Digits in groups of three, separated by a thin space.
    let grouped = |(place, letter): (usize, char)| {
        let space =
            (1 + usize::from(value < 0.0)..whole).contains(&place) && (whole - place).is_multiple_of(3);
        space.then_some('\u{2009}').into_iter().chain([letter])
    };
    label.chars().enumerate().flat_map(grouped).collect()
}

/// A power as text with a superscript exponent: h², 10⁻³.
pub fn power(base: &str, exponent: i64) -> String {
    const RAISED: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let raise = |letter: char| letter.to_digit(10).map_or('⁻', |digit| RAISED[digit as usize]);
    base.chars().chain(exponent.to_string().chars().map(raise)).collect()
}

fn power_of_ten(exponent: i64) -> String {
    match exponent {
        0 => "1".to_owned(),
        1 => "10".to_owned(),
        _ => power("10", exponent),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(axis: &Axis, low: f64, high: f64) -> Vec<String> {
        let places = [low, high].into_iter().filter_map(|value| axis.place(value));
        axis.ticks(places, 6).bold.into_iter().map(|(_, label)| label).collect()
    }

    #[test]
    fn linear_ticks_are_round_numbers() {
        let axis = Axis::linear("t");
        assert_eq!(labels(&axis, 0.0, 30.0), ["0", "5", "10", "15", "20", "25", "30"]);
        assert_eq!(labels(&axis, -0.9, 1.1), ["−0.5", "0.0", "0.5", "1.0"]);
        assert_eq!(labels(&axis, 0.0, 1e5)[1..3], ["20\u{2009}000", "40\u{2009}000"]);
        assert_eq!(labels(&axis, -1e5, 0.0)[0], "−100\u{2009}000");
        assert_eq!(labels(&axis, 0.0, 3e-7).last().map(String::as_str), Some("3.0·10⁻⁷"));
        assert_eq!(labels(&axis, -1e-15, 1e-15)[2..4], ["0", "5·10⁻¹⁶"]);
        assert!(labels(&axis, 5.0, 5.0).contains(&"5.0".to_owned()));
    }

    #[test]
    fn a_range_at_the_ends_of_the_numbers_has_few_ticks() {
        let axis = Axis::linear("E");
        for (low, high) in
            [(0.0, 4.5e-324), (-3e-280, 3e-280), (1e-280, 1.1e-280), (-1e290, 1e290), (-1e308, f64::MAX)]
        {
            let labels = labels(&axis, low, high);
            assert!((2..12).contains(&labels.len()), "{low:e}, {high:e}: {labels:?}");
            assert!(
                labels.iter().all(|label| !label.contains("inf") && !label.contains("NaN")),
                "{labels:?}"
            );
        }
        assert!(axis.overflows(1e291) && !axis.overflows(f64::INFINITY) && !axis.overflows(1.0));
    }

    #[test]
    fn logarithmic_ticks_are_powers_of_ten() {
        let axis = Axis::logarithmic("error");
        assert_eq!(labels(&axis, 1e-3, 1e2), ["10⁻³", "10⁻²", "10⁻¹", "1", "10", "10²"]);
        assert_eq!(labels(&axis, 1e-12, 1.0), ["10⁻¹²", "10⁻⁹", "10⁻⁶", "10⁻³", "1"]);
        assert_eq!(labels(&axis, 0.012, 0.04), ["0.02", "0.03", "0.04"]);
        assert_eq!(labels(&axis, 0.03, 0.5), ["0.05", "0.1", "0.2", "0.5"]);
        assert!(labels(&axis, 1e-6, 1e-5).contains(&"2·10⁻⁶".to_owned()));
        assert_eq!(axis.place(0.0), None);
        assert_eq!(axis.place(f64::NAN), None);
    }
}
