//! A chart: series over two axes, drawn as SVG.

use super::axis::{Axis, LARGEST_PLACE, Ticks};
use super::colour_map::ColourMap;
use fvi_scenario::scenario::Paper;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Size of a picture for a screen, in pixels.
const SIZE: (i32, i32) = (900, 560);
/// Left edge of titles and legend, in pixels.
const LEFT: i32 = 24;
/// Height of the letters at axes and in the legend, in pixels.
const LETTERS: i32 = 14;
/// Subdivision of a pixel: the library's integer coordinates count these finer units.
const FINE: i32 = 4;

const FONT: &str = "Helvetica, Arial, DejaVu Sans, sans-serif";
const INK: RGBColor = RGBColor(40, 40, 40);
const FAINT: RGBColor = RGBColor(90, 90, 90);

/// Colours that can be distinguished with colour-vision deficiency (after Okabe and Ito).
const COLOURS: [RGBColor; 10] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(120, 94, 64),
    RGBColor(150, 150, 0),
    RGBColor(0, 0, 0),
    RGBColor(120, 60, 190),
];

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A line.
    Line,
    /// A dashed line.
    Dashed,
    /// Markers.
    Points,
    /// A line with markers at its points.
    LineWithPoints,
    /// A thin dashed black line over the other series: the exact or reference curve.
    Reference,
    /// Black rings over the other series: known points of the exact solution.
    ReferencePoints,
    /// A dotted grey line with its label at its end, such as a slope to compare with; not in the legend.
    Guide,
}

/// The shape of a series' points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Marker {
    /// A disc.
    #[default]
    Disc,
    /// A square.
    Square,
    /// A triangle, point up.
    Triangle,
    /// A square on its corner.
    Diamond,
}

/// Radius of a disc; the other markers are about as large.
const MARKER_RADIUS: i32 = 3 * FINE;

impl Marker {
    /// Corners around the middle; none for the disc.
    fn corners(self) -> Option<&'static [(i32, i32)]> {
        const SQUARE: [(i32, i32); 4] = [(-12, -12), (12, -12), (12, 12), (-12, 12)];
        const TRIANGLE: [(i32, i32); 3] = [(0, -17), (15, 11), (-15, 11)];
        const DIAMOND: [(i32, i32); 4] = [(0, -18), (16, 0), (0, 18), (-16, 0)];
        match self {
            Self::Disc => None,
            Self::Square => Some(&SQUARE),
            Self::Triangle => Some(&TRIANGLE),
            Self::Diamond => Some(&DIAMOND),
        }
    }
}

/// A named curve or set of points.
#[derive(Clone, Debug)]
pub struct Series {
    label: String,
    style: Style,
    marker: Marker,
    points: Vec<(f64, f64)>,
    /// Half the length of the bar through each point; empty without bars.
    bars: Vec<f64>,
    colour: Option<usize>,
}

impl Series {
    /// A series; points that cannot be drawn (not finite, or ≤ 0 on a logarithmic axis) are left out and
    /// interrupt its line.
    pub fn new(label: impl Into<String>, style: Style, points: Vec<(f64, f64)>) -> Self {
        Self { label: label.into(), style, marker: Marker::default(), points, bars: Vec::new(), colour: None }
    }

    /// The series with another shape of its points.
    pub fn with_marker(mut self, marker: Marker) -> Self {
        self.marker = marker;
        self
    }

    /// The series with a bar through each point, from y − half to y + half: what is known about its error.
    pub fn with_bars(mut self, halves: Vec<f64>) -> Self {
        self.bars = halves;
        self
    }

    /// The series in the `index`-th colour, which by default is that of the `index`-th series.
    pub fn with_colour_of(mut self, index: usize) -> Self {
        self.colour = Some(index);
        self
    }

    /// A guide y = c·x^slope through `through`, from `from` to `to` in x, for logarithmic axes.
    pub fn slope(label: impl Into<String>, slope: f64, through: (f64, f64), from: f64, to: f64) -> Self {
        let at = |x: f64| (x, through.1 * (x / through.0).powf(slope));
        Self::new(label, Style::Guide, vec![at(from), at(to)])
    }
}

/// A chart with a title, two axes and any number of series.
#[derive(Clone, Debug)]
pub struct Chart {
    title: String,
    subtitle: String,
    x: Axis,
    y: Axis,
    series: Vec<Series>,
    map: Option<ColourMap>,
    paper: Option<Paper>,
}

/// Error message of the plotting library.
#[derive(Debug, thiserror::Error)]
#[error("the picture cannot be drawn: {0}")]
pub struct PictureError(String);

/// Points that a line joins.
type Piece = Vec<(f64, f64)>;

/// True if a character may stand in a document of XML 1.0, escaped or not.
fn belongs_in_xml(letter: char) -> bool {
    matches!(letter, '\t' | '\n' | '\r' | ' '..='\u{fffd}' | '\u{10000}'..)
}

type DrawingResult<E> = Result<(), DrawingAreaErrorKind<E>>;

impl Chart {
    /// An empty chart.
    pub fn new(title: impl Into<String>, x: Axis, y: Axis) -> Self {
        Self {
            title: title.into(),
            subtitle: String::new(),
            x,
            y,
            series: Vec::new(),
            map: None,
            paper: None,
        }
    }

    /// A smaller line under the title.
    pub fn with_subtitle(mut self, subtitle: impl Into<String>) -> Self {
        self.subtitle = subtitle.into();
        self
    }

    /// Adds a series; later ones are drawn over earlier ones.
    pub fn with(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Draws a colour map below the series.
    pub fn with_map(mut self, map: ColourMap) -> Self {
        self.map = Some(map);
        self
    }

    /// The chart in a size on paper; `None`: for a screen.
    pub fn on_paper(mut self, paper: Option<Paper>) -> Self {
        self.paper = paper;
        self
    }

    /// Width and height of the drawing, in pixels.
    fn size(&self) -> (i32, i32) {
        self.paper.map_or(SIZE, |paper| paper.pixels(f64::from(LETTERS)))
    }

    /// The picture as SVG text.
    ///
    /// # Errors
    /// [`PictureError`].
    pub fn to_svg(&self) -> Result<String, PictureError> {
        let (width, height) = self.size();
        let fine = ((width * FINE) as u32, (height * FINE) as u32);
        let mut svg = String::new();
        {
            let area = SVGBackend::with_string(&mut svg, fine).into_drawing_area();
            self.draw(&area).map_err(|error| PictureError(error.to_string()))?;
            area.present().map_err(|error| PictureError(error.to_string()))?;
        }
        let of_drawing = format!("width=\"{}\" height=\"{}\"", fine.0, fine.1);
        let shown = match self.paper {
            Some(Paper { width, height, .. }) => format!("width=\"{width}mm\" height=\"{height}mm\""),
            None => format!("width=\"{width}\" height=\"{height}\""),
        };
        let svg = svg.replacen(&of_drawing, &shown, 1);
        // Titles and labels may hold any character; XML may not.
        Ok(svg.replace(|letter| !belongs_in_xml(letter), "\u{fffd}"))
    }

    fn draw<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, plotters::coord::Shift>,
    ) -> DrawingResult<B::ErrorType> {
        area.fill(&WHITE)?;
        let pieces: Vec<Vec<Piece>> = self.series.iter().map(|series| self.pieces(series)).collect();
        let rectangles = self.map.as_ref().map_or_else(Vec::new, |map| map.rectangles(&self.x, &self.y));
        let counts = self.tick_counts();
        let (x, y) = self.ticks(&pieces, &rectangles, counts);
        let scale = self.map.as_ref().map(|map| {
            map.quantity
                .ticks_over(map.values.iter().filter_map(|(_, value)| map.quantity.place(*value)), counts.1)
        });
        let bar = scale.as_ref().map_or(0, |scale| 66 + 8 * scale.label_width() as i32);
        let top = self.draw_head(area)?;
        let mut chart = ChartBuilder::on(area)
            .margin_top(top)
            .margin_right((24 + bar) * FINE)
            .margin_bottom(10 * FINE)
            .margin_left(10 * FINE)
            .x_label_area_size(50 * FINE)
            .y_label_area_size((38 + 8 * y.label_width() as i32) * FINE)
            .build_cartesian_2d(x.clone(), y.clone())?;
        chart
            .configure_mesh()
            .bold_line_style(RGBColor(208, 208, 208).stroke_width(FINE as u32))
            .light_line_style(RGBColor(236, 236, 236).stroke_width(FINE as u32))
            .axis_style(INK.stroke_width(FINE as u32))
            .label_style((FONT, LETTERS * FINE).into_font().color(&INK))
            .axis_desc_style((FONT, 16 * FINE).into_font().color(&INK))
            .set_all_tick_mark_size(5 * FINE)
            .x_desc(self.x.label())
            .y_desc(self.y.label())
            .draw()?;
        if let (Some(map), Some(scale)) = (&self.map, &scale) {
            draw_map(&mut chart, map, scale, &rectangles)?;
            draw_bar(area, chart.plotting_area().get_pixel_range(), map, scale)?;
        }
        for (index, pieces) in pieces.iter().enumerate() {
            let series = &self.series[index];
            let stroke = self.stroke(index);
            let dash = |length: i32, gap: i32| (length * FINE, gap * FINE);
            let dashed = match series.style {
                // As many lines as there are colours are whole, the next ones dashed.
                Style::Line | Style::LineWithPoints => match self.rank(index) / COLOURS.len() {
                    0 => None,
                    1 => Some(dash(9, 5)),
                    _ => Some(dash(3, 3)),
                },
                Style::Dashed => Some(dash(9, 5)),
                Style::Reference => Some(dash(5, 5)),
                Style::Guide => Some(dash(2, 4)),
                Style::Points => {
                    for bar in self.bars(series) {
                        chart.draw_series(LineSeries::new(
                            bar,
                            self.colour(index).stroke_width(FINE as u32),
                        ))?;
                    }
                    self.draw_markers(&mut chart, index, pieces)?;
                    continue;
                }
                Style::ReferencePoints => {
                    let ring = |&point| Circle::new(point, 4 * FINE, stroke);
                    chart.draw_series(pieces.iter().flatten().map(ring))?;
                    continue;
                }
            };
            for piece in pieces {
                let line = piece.iter().copied();
                match dashed {
                    Some((length, gap)) => {
                        chart.draw_series(DashedLineSeries::new(line, length, gap, stroke))?;
                    }
                    None => {
                        chart.draw_series(LineSeries::new(line, stroke))?;
                    }
                }
            }
            if series.style == Style::LineWithPoints {
                self.draw_markers(&mut chart, index, pieces)?;
            }
            if let (Style::Guide, Some(&end)) = (series.style, pieces.iter().flatten().last()) {
                // The label stays inside the frame: left of an end point at the right edge, right of any
                // other.
                let (low, high) = x.ends();
                let side = if (high - end.0) < 0.12 * (high - low) { HPos::Right } else { HPos::Left };
                let style = (FONT, 13 * FINE).into_font().color(&FAINT).pos(Pos::new(side, VPos::Bottom));
                let label = Text::new(series.label.clone(), (0, -5 * FINE), style);
                chart.draw_series([EmptyElement::at(end) + label])?;
            }
        }
        Ok(())
    }

    /// About how many ticks the two axes have: on a screen 10 across and 8 up.
    fn tick_counts(&self) -> (usize, usize) {
        let (width, height) = self.size();
        ((width / 90).max(3) as usize, (height / 70).max(3) as usize)
    }

    /// The ticks of both axes over what is drawn: lines, points, and the rectangles of a map.
    fn ticks(
        &self,
        pieces: &[Vec<Piece>],
        rectangles: &[[(f64, f64); 2]],
        (across, up): (usize, usize),
    ) -> (Ticks, Ticks) {
        let all = || pieces.iter().flatten().flatten();
        let corners = || rectangles.iter().flatten().filter(|corner| corner.0.is_finite());
        match &self.map {
            // The axes of a map end with its data.
            Some(map) if map.cells => (
                self.x.ticks_over(corners().map(|at| at.0), across),
                self.y.ticks_over(corners().map(|at| at.1), up),
            ),
            _ => (
                self.x.ticks(all().chain(corners()).map(|point| point.0), across),
                self.y.ticks(all().chain(corners()).map(|point| point.1), up),
            ),
        }
    }

    /// Draws the points of a series.
    fn draw_markers<B: DrawingBackend, C: CoordTranslate<From = (f64, f64)>>(
        &self,
        chart: &mut ChartContext<'_, B, C>,
        index: usize,
        pieces: &[Piece],
    ) -> DrawingResult<B::ErrorType> {
        let fill = self.colour(index).filled();
        let points = pieces.iter().flatten().copied();
        match self.series[index].marker.corners() {
            None => chart.draw_series(points.map(|point| Circle::new(point, MARKER_RADIUS, fill)))?,
            Some(corners) => chart.draw_series(
                points.map(|point| EmptyElement::at(point) + Polygon::new(corners.to_vec(), fill)),
            )?,
        };
        Ok(())
    }

    /// The lines of a text whose letters are about `letter` pixels wide; a screen has room for one.
    fn lines(&self, text: &str, letter: i32) -> Vec<String> {
        let room = if self.paper.is_some() { (self.size().0 - 2 * LEFT) / letter } else { i32::MAX } as usize;
        let mut lines: Vec<String> = Vec::new();
        for word in text.split(' ') {
            match lines.last_mut() {
                Some(line) if line.chars().count() + 1 + word.chars().count() <= room => {
                    line.push(' ');
                    line.push_str(word);
                }
                _ => lines.push(word.to_owned()),
            }
        }
        lines
    }

    /// Draws title, subtitle and legend; returns the height they take.
    fn draw_head<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, plotters::coord::Shift>,
    ) -> Result<i32, DrawingAreaErrorKind<B::ErrorType>> {
        const ROW: i32 = 22;
        let mut top = 12;
        if !self.title.is_empty() {
            let style = (FONT, 19 * FINE).into_font().color(&INK);
            for line in self.lines(&self.title, 10) {
                area.draw(&Text::new(line, (LEFT * FINE, top * FINE), style.clone()))?;
                top += 26;
            }
        }
        let subtitle = self.subtitle_with_omissions();
        if !subtitle.is_empty() {
            let style = (FONT, LETTERS * FINE).into_font().color(&FAINT);
            for line in self.lines(&subtitle, 7) {
                area.draw(&Text::new(line, (LEFT * FINE, top * FINE), style.clone()))?;
                top += ROW;
            }
        }
        let shown: Vec<usize> = (0..self.series.len())
            .filter(|&index| self.series[index].style != Style::Guide && !self.series[index].label.is_empty())
            .collect();
        // A single curve that the vertical axis already names needs no legend.
        if shown.len() < 2 {
            return Ok((top + 6) * FINE);
        }
        let mut left = LEFT;
        for index in shown {
            let label = &self.series[index].label;
            // Letters are about half as wide as they are high; the estimate is on the wide side.
            let width = 34 + 7 * label.chars().count() as i32 + 18;
            if left + width > self.size().0 && left > LEFT {
                left = LEFT;
                top += ROW;
            }
            self.draw_key(area, index, left, top + ROW / 2)?;
            let style = (FONT, 14 * FINE).into_font().color(&INK).pos(Pos::new(HPos::Left, VPos::Center));
            area.draw(&Text::new(label.clone(), ((left + 34) * FINE, (top + ROW / 2) * FINE), style))?;
            left += width;
        }
        Ok((top + ROW + 6) * FINE)
    }

    /// The subtitle, and whether points are left out because they are too large to draw.
    fn subtitle_with_omissions(&self) -> String {
        let mut points = self.series.iter().flat_map(|series| &series.points);
        let omitted = points.any(|&(x, y)| self.x.overflows(x) || self.y.overflows(y));
        match (omitted, self.subtitle.as_str()) {
            (false, subtitle) => subtitle.to_owned(),
            (true, "") => format!("values beyond {LARGEST_PLACE:e} are left out"),
            (true, subtitle) => format!("{subtitle}; values beyond {LARGEST_PLACE:e} are left out"),
        }
    }

    /// Draws the sample of a series in the legend.
    fn draw_key<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, plotters::coord::Shift>,
        index: usize,
        left: i32,
        middle: i32,
    ) -> DrawingResult<B::ErrorType> {
        let stroke = self.stroke(index);
        let height = middle * FINE;
        let dash = |from: i32, to: i32| {
            PathElement::new(vec![((left + from) * FINE, height), ((left + to) * FINE, height)], stroke)
        };
        let centre = ((left + 13) * FINE, height);
        let fill = self.colour(index).filled();
        let marker = match self.series[index].marker.corners() {
            None => Circle::new(centre, MARKER_RADIUS, fill).into_dyn(),
            Some(corners) => {
                let place = |corner: &(i32, i32)| (centre.0 + corner.0, centre.1 + corner.1);
                Polygon::new(corners.iter().map(place).collect::<Vec<_>>(), fill).into_dyn()
            }
        };
        match self.series[index].style {
            Style::Line if self.rank(index) < COLOURS.len() => area.draw(&dash(0, 26)),
            Style::LineWithPoints => {
                area.draw(&dash(0, 26))?;
                area.draw(&marker)
            }
            Style::Line | Style::Dashed | Style::Reference | Style::Guide => {
                area.draw(&dash(0, 6))?;
                area.draw(&dash(10, 16))?;
                area.draw(&dash(20, 26))
            }
            Style::Points => area.draw(&marker),
            Style::ReferencePoints => area.draw(&Circle::new(centre, 4 * FINE, stroke)),
        }
    }

    fn colour(&self, index: usize) -> RGBColor {
        match self.series[index].style {
            Style::Reference | Style::ReferencePoints => BLACK,
            Style::Guide => RGBColor(120, 120, 120),
            _ => COLOURS[self.rank(index) % COLOURS.len()],
        }
    }

    /// The place of a series among those with colours of their own.
    fn rank(&self, index: usize) -> usize {
        let own = |style| !matches!(style, Style::Reference | Style::ReferencePoints | Style::Guide);
        let before = || self.series[..index].iter().filter(|series| own(series.style)).count();
        self.series[index].colour.unwrap_or_else(before)
    }

    /// The bars of a series in axis coordinates; one that reaches beyond a logarithmic axis begins at its
    /// point.
    fn bars(&self, series: &Series) -> Vec<Piece> {
        let bar = |(&(x, y), &half): (&(f64, f64), &f64)| {
            let (x, middle) = (self.x.place(x)?, self.y.place(y)?);
            let end = |y: f64| (x, self.y.place(y).unwrap_or(middle));
            Some(vec![end(y - half), end(y + half)])
        };
        series.points.iter().zip(&series.bars).filter_map(bar).collect()
    }

    fn stroke(&self, index: usize) -> ShapeStyle {
        let width = match self.series[index].style {
            Style::Line | Style::LineWithPoints | Style::Dashed => 2 * FINE,
            Style::Reference | Style::ReferencePoints | Style::Guide => FINE + FINE / 4,
            Style::Points => FINE,
        };
        self.colour(index).stroke_width(width as u32)
    }

    /// The series in axis coordinates, interrupted at points that cannot be drawn.
    fn pieces(&self, series: &Series) -> Vec<Piece> {
        let place = |&(x, y): &(f64, f64)| Some((self.x.place(x)?, self.y.place(y)?));
        let places: Vec<Option<(f64, f64)>> = series.points.iter().map(place).collect();
        let pieces = places.split(Option::is_none).map(|piece| piece.iter().flatten().copied().collect());
        pieces.filter(|piece: &Piece| !piece.is_empty()).collect()
    }
}

/// Colour of a value that the scale does not contain.
const UNKNOWN: RGBColor = RGBColor(214, 214, 214);

/// Perceptually uniform colours from low to high (Matplotlib's viridis, in the public domain).
const VIRIDIS: [(u8, u8, u8); 9] = [
    (68, 1, 84),
    (71, 44, 122),
    (59, 81, 139),
    (44, 113, 142),
    (33, 144, 141),
    (39, 173, 129),
    (92, 200, 99),
    (170, 220, 50),
    (253, 231, 37),
];

/// The colour at a place of a scale.
fn colour_at(place: Option<f64>, scale: &Ticks) -> RGBColor {
    let (low, high) = scale.ends();
    let Some(place) = place else { return UNKNOWN };
    let along = ((place - low) / (high - low)).clamp(0.0, 1.0) * (VIRIDIS.len() - 1) as f64;
    let index = (along as usize).min(VIRIDIS.len() - 2);
    let (from, to, share) = (VIRIDIS[index], VIRIDIS[index + 1], along - index as f64);
    let mixed =
        |from: u8, to: u8| (f64::from(from) + share * (f64::from(to) - f64::from(from))).round() as u8;
    RGBColor(mixed(from.0, to.0), mixed(from.1, to.1), mixed(from.2, to.2))
}

fn draw_map<B: DrawingBackend, C: CoordTranslate<From = (f64, f64)>>(
    chart: &mut ChartContext<'_, B, C>,
    map: &ColourMap,
    scale: &Ticks,
    rectangles: &[[(f64, f64); 2]],
) -> DrawingResult<B::ErrorType> {
    let cells = map.values.iter().zip(rectangles).filter(|(_, [corner, _])| corner.0.is_finite());
    for (&(_, value), &[low, high]) in cells {
        let fill = colour_at(map.quantity.place(value), scale).filled();
        if map.cells {
            chart.draw_series([Rectangle::new([low, high], fill)])?;
        } else {
            let middle = (0.5 * (low.0 + high.0), 0.5 * (low.1 + high.1));
            chart.draw_series([Circle::new(middle, MARKER_RADIUS, fill)])?;
        }
    }
    Ok(())
}

/// Draws the bar of colours beside the frame.
fn draw_bar<B: DrawingBackend>(
    area: &DrawingArea<B, plotters::coord::Shift>,
    (columns, rows): (std::ops::Range<i32>, std::ops::Range<i32>),
    map: &ColourMap,
    scale: &Ticks,
) -> DrawingResult<B::ErrorType> {
    const PARTS: i32 = 128;
    let (left, right) = (columns.end + 18 * FINE, columns.end + 36 * FINE);
    let (low, high) = scale.ends();
    let height = rows.end - rows.start;
    for part in 0..PARTS {
        let edge = |part: i32| rows.end - height * part / PARTS;
        let place = low + (high - low) * (f64::from(part) + 0.5) / f64::from(PARTS);
        let fill = colour_at(Some(place), scale).filled();
        area.draw(&Rectangle::new([(left, edge(part + 1)), (right, edge(part))], fill))?;
    }
    area.draw(&Rectangle::new([(left, rows.start), (right, rows.end)], INK.stroke_width(FINE as u32)))?;
    for (place, label) in scale.labels().iter().filter(|(place, _)| (low..=high).contains(place)) {
        let at = rows.end - ((place - low) / (high - low) * f64::from(height)).round() as i32;
        area.draw(&PathElement::new(
            vec![(right, at), (right + 4 * FINE, at)],
            INK.stroke_width(FINE as u32),
        ))?;
        let style = (FONT, 14 * FINE).into_font().color(&INK).pos(Pos::new(HPos::Left, VPos::Center));
        area.draw(&Text::new(label.clone(), (right + 8 * FINE, at), style))?;
    }
    let style = (FONT, 15 * FINE).into_font().color(&INK).pos(Pos::new(HPos::Right, VPos::Bottom));
    area.draw(&Text::new(
        map.quantity.label().to_owned(),
        (area.dim_in_pixel().0 as i32 - 12 * FINE, rows.start - 6 * FINE),
        style,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn titles_and_labels_are_in_the_picture_and_cannot_break_it() {
        let chart = Chart::new("a < b & c", Axis::linear("time t / s"), Axis::linear("position q / m"))
            .with(Series::new("q0", Style::Line, vec![(0.0, 1.0), (1.0, 2.0)]))
            .with(Series::new("exact", Style::Reference, vec![(0.0, 1.0), (1.0, 2.0)]));
        let svg = chart.to_svg().unwrap();
        assert!(svg.starts_with("<svg width=\"900\" height=\"560\" viewBox=\"0 0 3600 2240\""));
        for text in ["a &lt; b &amp; c", "time t / s", "position q / m", "q0", "exact"] {
            assert!(svg.contains(text), "{text}");
        }
    }

    #[test]
    fn the_eleventh_line_is_dashed_in_the_first_colour() {
        let mut chart = Chart::new("", Axis::linear("x"), Axis::linear("y"));
        let lines = |chart: &Chart| chart.to_svg().unwrap().matches("stroke=\"#0072B2\"").count();
        for index in 0..10 {
            chart = chart.with(Series::new(format!("{index}"), Style::Line, vec![(0.0, 0.0), (1.0, 1.0)]));
        }
        // The line and its sample in the legend.
        assert_eq!(lines(&chart), 2);
        let chart = chart.with(Series::new("10", Style::Line, vec![(0.0, 1.0), (1.0, 0.0)]));
        assert!(lines(&chart) > 20);
    }

    #[test]
    fn points_have_their_bars() {
        let points = Series::new("", Style::Points, vec![(1.0, 2.0), (2.0, 3.0), (f64::NAN, 1.0)]);
        let chart = |points: Series| {
            let chart = Chart::new("", Axis::linear("x"), Axis::logarithmic("y"));
            chart.with(points).to_svg().unwrap().matches("stroke=\"#0072B2\"").count()
        };
        assert_eq!(chart(points.clone()), 0);
        // The second one reaches beyond the logarithmic axis.
        assert_eq!(chart(points.with_bars(vec![0.5, 4.0, 0.5])), 2);
    }

    #[test]
    fn what_xml_forbids_is_not_in_the_picture() {
        let svg = Chart::new("bell \u{7}, escape \u{1b}[2J", Axis::linear("x\0"), Axis::linear("y\u{ffff}"))
            .with_subtitle("tab\tand α")
            .to_svg()
            .unwrap();
        assert!(svg.contains("bell \u{fffd}, escape \u{fffd}[2J") && svg.contains("tab\tand α"), "{svg}");
        assert!(svg.chars().all(belongs_in_xml));
    }

    #[test]
    fn the_largest_numbers_are_left_out_with_a_word() {
        let chart = |y: f64| {
            Chart::new("", Axis::linear("x"), Axis::linear("y"))
                .with(Series::new("", Style::Line, vec![(0.0, -y), (1.0, y)]))
                .to_svg()
                .unwrap()
        };
        assert!(chart(f64::MAX).contains("left out"));
        for drawn in [1e290, 1.0, 3e-162, f64::MIN_POSITIVE, 4.5e-324] {
            assert!(!chart(drawn).contains("left out"), "{drawn:e}");
        }
    }

    #[test]
    fn points_without_a_place_are_left_out() {
        let points = vec![(0.0, 1.0), (1.0, f64::NAN), (10.0, 0.0), (100.0, 1e-3), (1000.0, f64::INFINITY)];
        let discs = |x: Axis, y: Axis| {
            let svg =
                Chart::new("", x, y).with(Series::new("", Style::Points, points.clone())).to_svg().unwrap();
            svg.matches("<circle").count()
        };
        assert_eq!(discs(Axis::linear("x"), Axis::linear("y")), 3);
        assert_eq!(discs(Axis::logarithmic("x"), Axis::logarithmic("y")), 1);
    }

    #[test]
    fn a_line_is_interrupted_where_a_point_has_no_place() {
        let points = vec![(0.0, 1.0), (1.0, 2.0), (f64::NAN, f64::NAN), (2.0, 1.0), (3.0, 2.0)];
        let chart = Chart::new("", Axis::linear("x"), Axis::linear("y"));
        let lines = |points: Vec<(f64, f64)>| {
            let svg = chart.clone().with(Series::new("", Style::Line, points)).to_svg().unwrap();
            svg.matches("stroke=\"#0072B2\"").count()
        };
        assert_eq!(lines(points[..2].to_vec()), 1);
        assert_eq!(lines(points), 2);
    }

    #[test]
    fn an_empty_chart_is_drawn() {
        assert!(Chart::new("nothing", Axis::logarithmic("x"), Axis::linear("y")).to_svg().is_ok());
    }
}
