//! Pictures as SVG, within a page and as files: points over logarithmic axes.

use fvi_core::min_or_nan;
use std::fmt::Write;

/// A point with the strategy that it belongs to.
pub(crate) struct Point {
    pub(crate) series: usize,
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// Tooltip of the point.
    pub(crate) words: String,
}

/// Points, with lines through some of them.
pub(crate) struct Picture<'a> {
    pub(crate) x: &'a str,
    pub(crate) y: &'a str,
    pub(crate) names: &'a [String],
    pub(crate) points: Vec<Point>,
    /// Lines, by the indices of their points, and whether they have the colour of their series.
    pub(crate) lines: Vec<(Vec<usize>, bool)>,
}

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 420.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 190.0;
const TOP: f64 = 34.0;
const BOTTOM: f64 = 52.0;
const COLOURS: [&str; 10] = [
    "#1b6ca8", "#c8553d", "#2a9134", "#7b4b94", "#d08c00", "#00888a", "#b0306a", "#5f6b00", "#444444",
    "#8c564b",
];
/// Shapes of marks, as paths around the origin.
const MARKS: [&str; 5] = [
    "M-4,0a4,4 0 1,0 8,0a4,4 0 1,0 -8,0z",
    "M-4,-4h8v8h-8z",
    "M0,-5l5,9h-10z",
    "M0,-5.5l5,5.5l-5,5.5l-5,-5.5z",
    "M0,5l5,-9h-10z",
];

/// The shape of a series: neighbours differ in it and in their colour, and so do those that share a colour.
fn mark(series: usize) -> &'static str {
    MARKS[(series + series / COLOURS.len()) % MARKS.len()]
}

/// Style of the pictures, in a page and in a file.
pub(crate) const STYLE: &str = "svg text{font:12px system-ui,sans-serif}.h{font-weight:600}\
.m{text-anchor:middle}.e{text-anchor:end}.g{stroke:#e4e4e4;fill:none}";

/// A text with the special characters of HTML escaped.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Where zeros are drawn on a logarithmic axis: at a tenth of the smallest number above.
fn place_of_zero(numbers: impl Iterator<Item = f64>) -> f64 {
    let smallest = numbers.filter(|&number| number > 0.0).fold(f64::INFINITY, min_or_nan);
    if smallest.is_finite() { 0.1 * smallest } else { 1.0 }
}

/// Ends of a logarithmic axis, with a margin beside the points; `least` is where zeros are drawn.
fn ends(numbers: impl Iterator<Item = f64>, least: f64) -> (f64, f64) {
    let (low, high) = numbers
        .map(|number| number.max(least).log10())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), number| (low.min(number), high.max(number)));
    if low > high {
        return (0.0, 1.0);
    }
    let room = (0.06 * (high - low)).max(0.15);
    (low - room, high + room)
}

impl Picture<'_> {
    /// All below the title.
    pub(crate) fn body(&self) -> String {
        let (xs, ys) = (self.points.iter().map(|point| point.x), self.points.iter().map(|point| point.y));
        let (least_x, least_y) = (place_of_zero(xs.clone()), place_of_zero(ys.clone()));
        let ((x0, x1), (y0, y1)) = (ends(xs, least_x), ends(ys, least_y));
        let across = |x: f64| LEFT + (x - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT);
        let up = |y: f64| HEIGHT - BOTTOM - (y - y0) / (y1 - y0) * (HEIGHT - TOP - BOTTOM);
        let place = |point: &Point| (across(point.x.max(least_x).log10()), up(point.y.max(least_y).log10()));
        let mut svg = String::new();
        for (ticks, vertical) in [(ticks(x0, x1), true), (ticks(y0, y1), false)] {
            for (tick, label) in ticks {
                if vertical {
                    let x = across(tick);
                    let _ = writeln!(
                        svg,
                        "<path class=\"g\" d=\"M{x:.1},{TOP}V{:.1}\"/><text x=\"{x:.1}\" y=\"{:.1}\" class=\"m\">{label}</text>",
                        HEIGHT - BOTTOM,
                        HEIGHT - BOTTOM + 16.0
                    );
                } else {
                    let y = up(tick);
                    let _ = writeln!(
                        svg,
                        "<path class=\"g\" d=\"M{LEFT},{y:.1}H{:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\" class=\"e\">{label}</text>",
                        WIDTH - RIGHT,
                        LEFT - 6.0,
                        y + 4.0
                    );
                }
            }
        }
        let (middle, height) = (0.5 * (LEFT + WIDTH - RIGHT), 0.5 * (TOP + HEIGHT - BOTTOM));
        let _ = writeln!(
            svg,
            "<text x=\"{middle}\" y=\"{:.1}\" class=\"m\">{}</text><text transform=\"translate(16,{height}) rotate(-90)\" class=\"m\">{}</text>",
            HEIGHT - 12.0,
            escaped(self.x),
            escaped(self.y)
        );
        for (line, coloured) in &self.lines {
            let colour = match (coloured, line.first()) {
                (true, Some(&first)) => COLOURS[self.points[first].series % COLOURS.len()],
                _ => "#999",
            };
            let places: Vec<String> = line
                .iter()
                .map(|&index| place(&self.points[index]))
                .map(|(x, y)| format!("{x:.1},{y:.1}"))
                .collect();
            let _ = writeln!(
                svg,
                "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>",
                places.join(" ")
            );
        }
        for point in &self.points {
            let (x, y) = place(point);
            let _ = writeln!(
                svg,
                "<path transform=\"translate({x:.1},{y:.1})\" d=\"{}\" fill=\"{}\"><title>{}</title></path>",
                mark(point.series),
                COLOURS[point.series % COLOURS.len()],
                escaped(&point.words)
            );
        }
        let shown = self.names.iter().enumerate();
        let shown = shown.filter(|(index, _)| self.points.iter().any(|point| point.series == *index));
        for (row, (series, name)) in shown.enumerate() {
            let y = TOP + 10.0 + 18.0 * row as f64;
            let _ = writeln!(
                svg,
                "<path transform=\"translate({:.1},{y:.1})\" d=\"{}\" fill=\"{}\"/><text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                WIDTH - RIGHT + 16.0,
                mark(series),
                COLOURS[series % COLOURS.len()],
                WIDTH - RIGHT + 28.0,
                y + 4.0,
                escaped(name)
            );
        }
        svg
    }
}

/// A picture in a page that has the [`STYLE`].
pub(crate) fn in_page(title: &str, body: &str) -> String {
    framed("", title, "", body)
}

/// A picture as the content of a file, whose title tells what it shows without a page.
pub(crate) fn as_file(title: &str, body: &str) -> String {
    let paper = "<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>";
    let before = format!("<style>{STYLE}</style>{paper}");
    framed(" xmlns=\"http://www.w3.org/2000/svg\"", title, &before, body)
}

fn framed(language: &str, title: &str, before: &str, body: &str) -> String {
    let title = escaped(title);
    format!(
        "<svg{language} viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{title}\">{before}<text x=\"{LEFT}\" y=\"20\" class=\"h\">{title}</text>\n{body}</svg>\n"
    )
}

/// Logarithms of the ticks between two of them, with labels: powers of ten, thinned out if there are many,
/// and multiples of them where there are fewer than three.
fn ticks(low: f64, high: f64) -> Vec<(f64, String)> {
    let (first, last) = (low.ceil() as i32, high.floor() as i32);
    let step = ((last - first) / 8 + 1).max(1);
    let powers = (first..=last).filter(|power| power.rem_euclid(step) == 0);
    let powers: Vec<(f64, String)> =
        powers.map(|power| (f64::from(power), format!("10{}", superscript(power)))).collect();
    if powers.len() >= 3 {
        return powers;
    }
    let factors: &[u32] = if high - low > 0.7 { &[1, 2, 5] } else { &[1, 2, 3, 4, 5, 6, 8] };
    let all = (first - 1..=last).flat_map(|power| {
        factors.iter().map(move |&factor| {
            let place = f64::from(power) + f64::from(factor).log10();
            let label = match (factor, power) {
                (1, _) => format!("10{}", superscript(power)),
                (_, 0..=4) => format!("{}", factor * 10u32.pow(power.unsigned_abs())),
                _ => format!("{factor}·10{}", superscript(power)),
            };
            (place, label)
        })
    });
    all.filter(|&(place, _)| (low..=high).contains(&place)).collect()
}

fn superscript(power: i32) -> String {
    power
        .to_string()
        .chars()
        .map(|digit| match digit {
            '-' => '⁻',
            '1' => '¹',
            '2' => '²',
            '3' => '³',
            other => other.to_digit(10).and_then(|digit| char::from_u32(0x2070 + digit)).unwrap_or(other),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_has_its_points_lines_and_names_and_no_markup_from_outside() {
        let names = ["a<b".to_owned(), "unused".to_owned()];
        let point = |x, y| Point { series: 0, x, y, words: "\"here\"".to_owned() };
        let picture = Picture {
            x: "x",
            y: "y",
            names: &names,
            points: vec![point(1.0, 1e-12), point(100.0, 0.0)],
            lines: vec![(vec![0, 1], true)],
        };
        let body = picture.body();
        let svg = in_page("one & two", &body);
        assert!(svg.contains("one &amp; two") && svg.contains("a&lt;b") && svg.contains("&quot;here&quot;"));
        assert!(!svg.contains("unused") && !svg.contains("NaN") && svg.matches("<polyline").count() == 1);
        let file = as_file("three", &body);
        assert!(!svg.contains("<style>") && file.contains("<style>") && file.contains(">three</text>"));
        assert_eq!(superscript(-12), "⁻¹²");
        assert!((0..40).all(|series| mark(series) != mark(series + 1) && mark(series) != mark(series + 10)));
        let labels = |low, high| ticks(low, high).into_iter().map(|(_, label)| label).collect::<Vec<_>>();
        assert_eq!(labels(-0.2, 3.4), ["10⁰", "10¹", "10²", "10³"]);
        assert_eq!(labels(2.2, 3.4), ["200", "500", "10³", "2000"]);
        assert_eq!(labels(-4.4, -3.6), ["5·10⁻⁵", "10⁻⁴", "2·10⁻⁴"]);
    }

    #[test]
    fn a_zero_is_drawn_below_all_other_points() {
        let names = ["a".to_owned()];
        let point = |x, y| Point { series: 0, x, y, words: String::new() };
        let points = vec![point(1.0, 10.0), point(2.0, 0.0), point(3.0, 30.0)];
        let body = Picture { x: "x", y: "y", names: &names, points, lines: Vec::new() }.body();
        assert!(body.contains(">10¹</text>") && !body.contains("10⁻"), "{body}");
    }
}
