//! Values over two axes as colours, with a colour bar.

use super::axis::Axis;

/// Values at points of a chart.
#[derive(Clone, Debug)]
pub struct ColourMap {
    /// Label of the colour scale.
    pub(super) quantity: Axis,
    /// ((x, y), value).
    pub(super) values: Vec<((f64, f64), f64)>,
    /// True if each value fills the cell around it; discs otherwise.
    pub(super) cells: bool,
}

impl ColourMap {
    /// Values on a grid, each of which fills the cell around its place. Values outside of the colour scale
    /// are grey.
    pub fn cells(quantity: Axis, values: impl IntoIterator<Item = ((f64, f64), f64)>) -> Self {
        Self { quantity, values: values.into_iter().collect(), cells: true }
    }

    /// Values at scattered places, as discs.
    pub fn points(quantity: Axis, values: impl IntoIterator<Item = ((f64, f64), f64)>) -> Self {
        Self { cells: false, ..Self::cells(quantity, values) }
    }

    /// Rectangles on the axes: (left, low), (right, high), value.
    pub(super) fn rectangles(&self, x: &Axis, y: &Axis) -> Vec<[(f64, f64); 2]> {
        let along = |axis: &Axis, pick: fn(&(f64, f64)) -> f64| {
            Edges::new(self.values.iter().filter_map(|(place, _)| axis.place(pick(place))))
        };
        let (columns, rows) = (along(x, |place| place.0), along(y, |place| place.1));
        let rectangle = |((at_x, at_y), _): &((f64, f64), f64)| {
            let (left, right) = columns.around(x.place(*at_x)?)?;
            let (low, high) = rows.around(y.place(*at_y)?)?;
            Some([(left, low), (right, high)])
        };
        self.values.iter().map(|value| rectangle(value).unwrap_or([(f64::NAN, f64::NAN); 2])).collect()
    }
}

/// Boundaries of the cells along one axis: midpoints between neighbouring places.
struct Edges {
    places: Vec<f64>,
}

impl Edges {
    fn new(places: impl Iterator<Item = f64>) -> Self {
        let mut places: Vec<f64> = places.collect();
        places.sort_by(f64::total_cmp);
        places.dedup();
        Self { places }
    }

    fn around(&self, place: f64) -> Option<(f64, f64)> {
        let index = self.places.iter().position(|&known| known == place)?;
        let before = index.checked_sub(1).and_then(|index| self.places.get(index));
        let after = self.places.get(index + 1);
        let half = |other: Option<&f64>| other.map(|&other| 0.5 * (other - place).abs());
        let (below, above) = match (half(before), half(after)) {
            (Some(below), Some(above)) => (below, above),
            (Some(only), None) | (None, Some(only)) => (only, only),
            (None, None) => (0.5, 0.5),
        };
        Some((place - below, place + above))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_meet_halfway_between_their_places() {
        let values = [((1.0, 1.0), 0.0), ((2.0, 1.0), 0.0), ((4.0, 1.0), 0.0)];
        let map = ColourMap::cells(Axis::linear("v"), values);
        let rectangles = map.rectangles(&Axis::linear("x"), &Axis::logarithmic("y"));
        let sides: Vec<(f64, f64)> = rectangles.iter().map(|[low, high]| (low.0, high.0)).collect();
        assert_eq!(sides, [(0.5, 1.5), (1.5, 3.0), (3.0, 5.0)]);
        assert_eq!((rectangles[0][0].1, rectangles[0][1].1), (-0.5, 0.5));
    }
}
