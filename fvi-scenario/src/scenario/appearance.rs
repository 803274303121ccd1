//! How pictures look: names and units of what they show, their size.

use super::keys;
use crate::language::InputError;
use crate::language::document::{Table, Value};
use serde::Serialize;

/// The look of the pictures of a scenario; it changes no number of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Appearance {
    /// One name for each coordinate that is drawn; empty: q0, q1, … (x0, x1, … of an equation).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub labels: Vec<String>,
    /// The units that axes name; an empty text: none.
    #[serde(skip_serializing_if = "Units::are_unknown")]
    pub units: Units,
    /// The size on paper; absent: 900 by 560 pixels for a screen.
    #[serde(skip)]
    pub paper: Option<Paper>,
}

/// Names of units, as they are written on axes.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Units {
    /// Of the time.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub time: String,
    /// Of the position.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub position: String,
    /// Of the momentum.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub momentum: String,
    /// Of the energy.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub energy: String,
}

impl Units {
    fn are_unknown(&self) -> bool {
        *self == Self::default()
    }
}

/// The size of a picture on paper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paper {
    /// Width, in millimetres: 30 … 1000.
    pub width: f64,
    /// Height, in millimetres: 30 … 1000.
    pub height: f64,
    /// Height of the letters at axes and in the legend, in points of 1/72 inch: 4 … 40.
    pub font: f64,
}

/// Height over width, if only the width is given.
const HEIGHT: f64 = 0.62;
/// Height of the letters, in points, if only the width is given.
const FONT: f64 = 8.0;
/// Widths of a picture in heights of its letters that leave room for axes, from the narrowest on.
const NARROWEST: f64 = 18.0;

impl Appearance {
    /// Reads `labels`, `units` and `picture` of `[output]`; `drawn` coordinates are drawn.
    pub(super) fn read(table: &Table<'_>, drawn: usize) -> Result<Self, InputError> {
        let mut appearance = Self::default();
        if let Some(value) = table.optional("labels") {
            let labels = value.list("a list of names")?.into_iter().map(|entry| name(&entry));
            appearance.labels = labels.collect::<Result<_, _>>()?;
            if appearance.labels.len() != drawn {
                let given = appearance.labels.len();
                return Err(value.out_of_range(format!(
                    "{drawn} names, one for each coordinate that is drawn, not {given}"
                )));
            }
        }
        if let Some(value) = table.optional("units") {
            let units = value.table()?;
            units.allow(&keys::UNITS)?;
            let of = |key| units.optional(key).map_or(Ok(String::new()), |value| name(&value));
            appearance.units = Units {
                time: of("time")?,
                position: of("position")?,
                momentum: of("momentum")?,
                energy: of("energy")?,
            };
        }
        appearance.paper = table.optional("picture").map(|value| Paper::read(&value)).transpose()?;
        Ok(appearance)
    }
}

/// A name that a picture can show.
fn name(value: &Value<'_>) -> Result<String, InputError> {
    let text = value.text()?;
    let fits = !text.trim().is_empty() && text.chars().count() <= 80 && !text.chars().any(char::is_control);
    if fits {
        Ok(text.to_owned())
    } else {
        Err(value.out_of_range("a name of 1 … 80 characters in one line"))
    }
}

impl Paper {
    fn read(value: &Value<'_>) -> Result<Self, InputError> {
        let table = value.table()?;
        table.allow(&keys::PICTURE)?;
        let within = |value: Value<'_>, low: f64, high: f64, unit: &str| {
            let number = value.number()?;
            let fits = (low..=high).contains(&number);
            if fits { Ok(number) } else { Err(value.out_of_range(format!("{low} … {high} {unit}"))) }
        };
        let width = within(table.required("width")?, 30.0, 1000.0, "millimetres")?;
        let height = table
            .optional("height")
            .map_or(Ok(HEIGHT * width), |value| within(value, 30.0, 1000.0, "millimetres"))?;
        let font = table.optional("font").map_or(Ok(FONT), |value| within(value, 4.0, 40.0, "points"))?;
        let paper = Self { width, height, font };
        let least = NARROWEST * font * MILLIMETRES_PER_POINT;
        if width < least || height < 0.62 * least {
            return Err(value.out_of_range(format!(
                "for letters of {font} points, a width of {least:.0} and a height of {:.0} millimetres at least",
                0.62 * least
            )));
        }
        Ok(paper)
    }
}

/// One point, 1/72 inch, in millimetres.
const MILLIMETRES_PER_POINT: f64 = 25.4 / 72.0;

impl Paper {
    /// Width and height in pixels for a drawing whose letters at axes are `letters` pixels high.
    pub fn pixels(&self, letters: f64) -> (i32, i32) {
        let scale = letters / (self.font * MILLIMETRES_PER_POINT);
        // At most some 10⁴, by the ranges of the three numbers.
        ((self.width * scale) as i32, (self.height * scale) as i32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_have_their_size_on_paper() {
        let paper = Paper { width: 84.0, height: 52.0, font: 8.0 };
        let (width, _) = paper.pixels(14.0);
        // 14 pixels of the drawing on 84 mm, in points.
        let points = 14.0 * (84.0 / f64::from(width)) / MILLIMETRES_PER_POINT;
        assert!((points - 8.0).abs() < 0.05, "{points}");
    }
}
