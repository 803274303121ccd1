//! A map: values over coordinate and time, as colours.

use core::fmt::Write;
use fvi_core::max_or_nan;

/// Numbers over coordinate (upwards) and time (to the right).
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    title: String,
    /// First and last time.
    times: (f64, f64),
    /// Number of times.
    count: usize,
    coordinates: usize,
    /// Cells, one column after another, each from the first coordinate on.
    cells: Vec<f64>,
    /// Number of cells in a column.
    height: usize,
}

/// Largest number of cells along either axis.
const MOST: usize = 160;

/// Number of colours on either side of zero.
const SHADES: i32 = 12;

impl Map {
    /// A map of zeros for `coordinates` coordinates at these times.
    pub fn new(title: &str, times: &[f64], coordinates: usize) -> Self {
        let (count, height) = (times.len(), coordinates.clamp(1, MOST));
        let cells = vec![0.0_f64; count.clamp(1, MOST) * height];
        let ends = (times.first().copied().unwrap_or(0.0), times.last().copied().unwrap_or(0.0));
        Self { title: title.to_owned(), times: ends, count, coordinates, cells, height }
    }

    /// Adds the row at time `index`; each cell keeps the value of largest magnitude.
    pub fn take(&mut self, index: usize, row: &[f64]) {
        let width = self.cells.len() / self.height;
        let column = index * width / self.count.max(1);
        let Some(cells) = self.cells.chunks_exact_mut(self.height).nth(column) else { return };
        for (coordinate, &number) in row.iter().enumerate().take(self.coordinates) {
            let cell = &mut cells[coordinate * self.height / self.coordinates];
            if number.abs() > cell.abs() {
                *cell = number;
            }
        }
    }

    /// The picture.
    pub fn to_svg(&self) -> String {
        let (left, top, width, height) = (70.0, 50.0, 640.0, 380.0);
        let largest =
            self.cells.iter().filter(|cell| cell.is_finite()).map(|cell| cell.abs()).fold(0.0, max_or_nan);
        let shade = |number: f64| {
            if largest > 0.0 { (number / largest * f64::from(SHADES)).round() as i32 } else { 0 }
        };
        let columns = self.cells.len() / self.height;
        let (dx, dy) = (width / columns as f64, height / self.height as f64);
        let mut svg = String::from(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"840\" height=\"500\" viewBox=\"0 0 840 500\" \
             font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"840\" height=\"500\" fill=\"white\"/>\n",
        );
        let mut text = |x: f64, y: f64, anchor: &str, words: &str| {
            let words = words.replace('&', "&amp;").replace('<', "&lt;");
            let _ = writeln!(svg, "<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\">{words}</text>");
        };
        text(left, 28.0, "start", &format!("{}: position over coordinate and time", self.title));
        text(left + 0.5 * width, top + height + 38.0, "middle", "time t");
        text(left, top + height + 18.0, "start", &format!("{}", self.times.0));
        text(left + width, top + height + 18.0, "end", &format!("{}", self.times.1));
        text(left - 8.0, top + height, "end", "0");
        text(left - 8.0, top + 10.0, "end", &format!("{}", self.coordinates.saturating_sub(1)));
        for (word, part) in [(largest, 0.0), (0.0, 0.5), (-largest, 1.0)] {
            text(left + width + 46.0, top + 5.0 + part * height, "start", &format!("{word:.2e}"));
        }
        let middle = top + 0.5 * height;
        let _ = writeln!(
            svg,
            "<text transform=\"translate(28,{middle}) rotate(-90)\" text-anchor=\"middle\">coordinate</text>"
        );
        let mut cell = |x: f64, y: f64, width: f64, height: f64, shade: i32| {
            let _ = writeln!(
                svg,
                "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"{}\"/>",
                colour(shade)
            );
        };
        cell(left, top, width, height, 0);
        for (column, cells) in self.cells.chunks_exact(self.height).enumerate() {
            let mut first = 0;
            while first < cells.len() {
                let own = shade(cells[first]);
                let count = cells[first..].iter().take_while(|&&other| shade(other) == own).count();
                if own != 0 {
                    let y = top + height - (first + count) as f64 * dy;
                    // A little wider, so that no gap shows between neighbours.
                    cell(left + column as f64 * dx, y, dx + 0.3, count as f64 * dy, own);
                }
                first += count;
            }
        }
        for step in -SHADES..=SHADES {
            let part = height / f64::from(2 * SHADES + 1);
            cell(left + width + 20.0, top + f64::from(SHADES - step) * part, 18.0, part + 0.3, step);
        }
        let _ = writeln!(
            svg,
            "<rect x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\" fill=\"none\" stroke=\"black\"/>\n</svg>"
        );
        svg
    }
}

/// Colour of a shade: from blue through white to red.
fn colour(shade: i32) -> String {
    let part = f64::from(shade.abs()) / f64::from(SHADES);
    let mix = |end: f64| (255.0 + (end - 255.0) * part).round() as u8;
    let (red, green, blue) =
        if shade < 0 { (mix(33.0), mix(102.0), mix(172.0)) } else { (mix(178.0), mix(24.0), mix(43.0)) };
    format!("#{red:02x}{green:02x}{blue:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_cell_shows_what_is_farthest_from_zero() {
        let times: Vec<f64> = (0..3).map(f64::from).collect();
        let mut map = Map::new("chain", &times, 2);
        for (index, row) in [[0.0, 1.0], [0.0, -4.0], [0.0, 2.0]].iter().enumerate() {
            map.take(index, row);
        }
        assert_eq!((map.height, map.cells.as_slice()), (2, [0.0, 1.0, 0.0, -4.0, 0.0, 2.0].as_slice()));
        let svg = map.to_svg();
        assert!(svg.contains(&colour(-SHADES)) && svg.contains("chain: position"), "{svg}");
        let many: Vec<f64> = (0..1000).map(f64::from).collect();
        let mut fine = Map::new("chain", &many, 500);
        (0..1000).for_each(|index| fine.take(index, &[1.0; 500]));
        assert_eq!((fine.cells.len(), fine.height), (MOST * MOST, MOST));
        assert!(fine.cells.iter().all(|&cell| cell == 1.0));
    }
}
