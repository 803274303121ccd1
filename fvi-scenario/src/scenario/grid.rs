//! `time.grid`: grids with different steps.

use super::adaptive::{Adaptive, Start};
use crate::language::document::{Document, Table, Value};
use crate::language::error::InputError;
use crate::language::number_table::NumberTable;
use std::sync::Arc;

/// Largest number of grid points of a grid with different steps, all of which are stored.
const MOST_POINTS: usize = 10_000_000;

/// A grid point nearer to a required time than this fraction of its step is moved there.
const NEAR: f64 = 0.1;

/// Rule for the times of a grid.
#[derive(Clone, Debug, PartialEq)]
pub enum GridRule {
    /// t_k = end (k/steps)^exponent: short steps where a motion begins like a power of t.
    Graded {
        /// The last time.
        end: f64,
        /// Number of steps, before required times are inserted.
        steps: usize,
        /// The exponent, at least 1.
        exponent: f64,
    },
    /// Steps that grow by a constant factor: the same number of them in every decade.
    Geometric {
        /// The last time.
        end: f64,
        /// The first step.
        first: f64,
        /// The factor, greater than 1.
        ratio: f64,
        /// The longest step; absent: unlimited.
        longest: Option<f64>,
    },
    /// Given times.
    Points {
        /// The file that contains them, if any.
        file: Option<String>,
    },
    /// Times chosen during the run to keep errors near a tolerance.
    Adaptive(Adaptive),
}

/// The times of a grid with different steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    rule: GridRule,
    must_hit: Vec<f64>,
    times: Arc<[f64]>,
}

impl Grid {
    /// Reads a grid with different steps from `[time]`; without the name of one it is adaptive. `start`
    /// describes the beginning of the momentum.
    pub(super) fn read(table: &Table<'_>, start: Start, document: &Document) -> Result<Self, InputError> {
        let keys = ["grid", "start", "must_hit", "allow_unstable", "energy_guard"];
        let allow = |own: &[&str]| table.allow(&[&keys, own].concat());
        let kind = table.optional("grid");
        let name = kind.map_or(Ok("adaptive"), |kind| kind.text())?;
        let (rule, times) = match name {
            "graded" => {
                allow(&["end", "steps", "exponent"])?;
                let end = table.required("end")?.positive()?;
                let steps = table.required("steps")?.whole(1..=MOST_POINTS)?;
                let value = table.required("exponent")?;
                let exponent = value.number()?;
                if !(1.0..=100.0).contains(&exponent) {
                    return Err(value.out_of_range(
                        "an exponent of at least 1 (and at most 100): steps grow from t = 0 on",
                    ));
                }
                let times = graded(end, steps, exponent);
                check_ascending(
                    &times,
                    &value,
                    "an exponent, or fewer steps, with which the first steps are positive numbers",
                )?;
                (GridRule::Graded { end, steps, exponent }, times)
            }
            "geometric" => {
                allow(&["end", "first", "ratio", "longest"])?;
                let end_value = table.required("end")?;
                let end = end_value.positive()?;
                let first_value = table.required("first")?;
                let first = first_value.positive()?;
                let ratio_value = table.required("ratio")?;
                let ratio = ratio_value.number()?;
                if !(ratio > 1.0 && ratio <= 1e3) {
                    return Err(ratio_value.out_of_range(
                        "a ratio greater than 1 (and at most 1000); equal steps are `grid = \"uniform\"`",
                    ));
                }
                let longest = match table.optional("longest") {
                    Some(value) => {
                        let longest = value.positive()?;
                        if longest < first {
                            return Err(value.out_of_range(format!("at least the first step, {first}")));
                        }
                        Some(longest)
                    }
                    None => None,
                };
                if first > end {
                    return Err(first_value.out_of_range(format!("a first step up to the end, {end}")));
                }
                let must_hit =
                    table.optional("must_hit").map_or(Ok(Vec::new()), |value| read_must_hit(&value, end))?;
                let times = geometric(end, first, ratio, longest, &must_hit).ok_or_else(|| {
                    end_value.out_of_range(format!("an end that {MOST_POINTS} steps reach"))
                })?;
                check_ascending(&times, &first_value, "a first step that shows beside the end")?;
                (GridRule::Geometric { end, first, ratio, longest }, times)
            }
            "adaptive" => {
                allow(&["end", "tolerance", "first", "shortest", "longest", "scale"])?;
                let adaptive = Adaptive::read(table, start)?;
                let mut must_hit = Vec::new();
                if let Some(value) = table.optional("must_hit") {
                    must_hit = read_must_hit(&value, adaptive.end)?;
                    if let Some((one, other)) = adaptive.too_near(&must_hit) {
                        return Err(value.out_of_range(format!(
                            "times apart from each other and from the ends by two of the shortest steps, {}, at least; {one} and \
                             {other} are not",
                            adaptive.shortest
                        )));
                    }
                }
                let mut times = [&[0.0], must_hit.as_slice(), &[adaptive.end]].concat();
                times.dedup();
                let rule = GridRule::Adaptive(adaptive);
                return Ok(Self { rule, must_hit, times: times.into() });
            }
            _ => {
                allow(&["points", "end"])?;
                let value = table.required("points")?;
                let (file, times) = read_points(&value, document)?;
                if let Some(end) = table.optional("end")
                    && times.last().copied() != Some(end.number()?)
                {
                    let last = times.last().copied().unwrap_or_default();
                    return Err(end.out_of_range(format!(
                        "the last of `time.points`, {last}, or nothing: the points say it"
                    )));
                }
                (GridRule::Points { file }, times)
            }
        };
        let mut grid = Self { rule, must_hit: Vec::new(), times: times.into() };
        if let Some(value) = table.optional("must_hit") {
            grid.must_hit = read_must_hit(&value, grid.end())?;
            grid.put_in();
        }
        Ok(grid)
    }

    /// The same rule with another number of steps, if it depends on one.
    pub(super) fn in_steps(&self, steps: usize) -> Option<Self> {
        let GridRule::Graded { end, exponent, .. } = self.rule else { return None };
        let rule = GridRule::Graded { end, steps: steps.max(1), exponent };
        let times = graded(end, steps.max(1), exponent).into();
        let mut grid = Self { rule, must_hit: self.must_hit.clone(), times };
        grid.put_in();
        Some(grid)
    }

    /// Rule for the times.
    pub fn rule(&self) -> &GridRule {
        &self.rule
    }

    /// Times that are required to be grid points.
    pub fn must_hit(&self) -> &[f64] {
        &self.must_hit
    }

    /// Settings for steps chosen during the run, if they are.
    pub fn adaptive(&self) -> Option<&Adaptive> {
        match &self.rule {
            GridRule::Adaptive(adaptive) => Some(adaptive),
            GridRule::Graded { .. } | GridRule::Geometric { .. } | GridRule::Points { .. } => None,
        }
    }

    /// t_0 = 0 … t_steps; for steps chosen during the run the times known in advance.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// The last time.
    pub fn end(&self) -> f64 {
        self.times.last().copied().unwrap_or_default()
    }

    /// The lengths of the steps.
    pub fn lengths(&self) -> impl Iterator<Item = f64> {
        self.times.windows(2).map(|pair| pair[1] - pair[0])
    }

    /// Description for headings.
    pub fn describe(&self) -> String {
        let steps = self.times.len() - 1;
        match &self.rule {
            GridRule::Graded { exponent, .. } => format!("{steps} graded steps, exponent {exponent}"),
            GridRule::Geometric { first, ratio, .. } => {
                format!("{steps} steps from {first:e}, ratio {ratio}")
            }
            GridRule::Points { .. } => format!("{steps} given steps"),
            GridRule::Adaptive(adaptive) => format!("steps to a tolerance of {:e}", adaptive.tolerance),
        }
    }

    /// Makes every required time a grid point: the nearest grid point is moved if it is near enough, except
    /// for given points.
    fn put_in(&mut self) {
        let mut times = self.times.to_vec();
        for &time in &self.must_hit {
            let after = times.partition_point(|&other| other < time);
            if times.get(after) == Some(&time) {
                continue;
            }
            let (before, next) = (times[after - 1], times[after]);
            let step = next - before;
            let moves = !matches!(self.rule, GridRule::Points { .. });
            if moves && next - time < NEAR * step && after + 1 < times.len() {
                times[after] = time;
            } else if moves && time - before < NEAR * step && after > 1 {
                times[after - 1] = time;
            } else {
                times.insert(after, time);
            }
        }
        self.times = times.into();
    }
}

fn graded(end: f64, steps: usize, exponent: f64) -> Vec<f64> {
    let time = |k: usize| if k == steps { end } else { end * libm::pow(k as f64 / steps as f64, exponent) };
    (0..=steps).map(time).collect()
}

/// Steps that grow by the ratio up to the longest, from one required time to the next; `None` if they are too
/// many.
///
/// The steps to each of these times, and to the end, are as many as the rule needs, and then all shortened by
/// the same factor, except for the very first step.
fn geometric(end: f64, first: f64, ratio: f64, longest: Option<f64>, must_hit: &[f64]) -> Option<Vec<f64>> {
    let longest = longest.unwrap_or(f64::INFINITY);
    let (mut times, mut step) = (vec![0.0], first);
    let targets = must_hit.iter().copied().filter(|&time| time < end).chain([end]);
    for target in targets {
        let from = times.last().copied().unwrap_or_default();
        let (mut steps, mut sum) = (Vec::new(), 0.0);
        // A target missed by rounding only counts as reached.
        while sum < (target - from) * (1.0 - 1e-9) {
            if times.len() + steps.len() > MOST_POINTS {
                return None;
            }
            steps.push(step);
            sum += step;
            step = (step * ratio).min(longest);
        }
        let kept = if times.len() == 1 && steps.len() > 1 { first } else { 0.0 };
        let factor = (target - from - kept) / (sum - kept);
        let mut time = from;
        for (index, step) in steps.iter().enumerate() {
            time = match index {
                _ if index + 1 == steps.len() => target,
                0 if kept > 0.0 => time + step,
                _ => time + step * factor,
            };
            times.push(time);
        }
    }
    Some(times)
}

fn check_ascending(times: &[f64], value: &Value<'_>, allowed: &str) -> Result<(), InputError> {
    // Shorter steps have powers that underflow.
    let ascending = times.windows(2).all(|pair| pair[1] - pair[0] >= 1e-150 && pair[1] > pair[0]);
    if ascending { Ok(()) } else { Err(value.out_of_range(allowed)) }
}

fn read_points(value: &Value<'_>, document: &Document) -> Result<(Option<String>, Vec<f64>), InputError> {
    let (file, times) = if value.is_list() {
        (None, value.numbers()?)
    } else {
        let table = NumberTable::read(value, document, &[])?;
        (Some(value.text()?.to_owned()), table.rows.iter().map(|row| row[0]).collect())
    };
    if times.first() != Some(&0.0) {
        return Err(value.out_of_range("times that begin with 0, where the motion starts"));
    }
    if times.len() < 2 {
        return Err(value.out_of_range("two times at least"));
    }
    if times.len() > MOST_POINTS {
        return Err(value.out_of_range(format!("at most {MOST_POINTS} times")));
    }
    if let Some(pair) = times.windows(2).find(|pair| pair[0] >= pair[1]) {
        return Err(
            value.out_of_range(format!("times that increase; {} is followed by {}", pair[0], pair[1]))
        );
    }
    check_ascending(&times, value, "times further apart")?;
    Ok((file, times))
}

pub(super) fn read_must_hit(value: &Value<'_>, end: f64) -> Result<Vec<f64>, InputError> {
    let times = value.numbers()?;
    if !times.is_sorted_by(|earlier, later| earlier < later) {
        return Err(value.out_of_range("increasing times"));
    }
    if let Some(time) = times.iter().find(|&&time| !(time > 0.0 && time <= end)) {
        return Err(value.out_of_range(format!("times after 0 and up to the end, {end}; {time} is not")));
    }
    Ok(times)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn graded_times_are_powers() {
        let times = graded(8.0, 4, 3.0);
        assert_eq!(times, [0.0, 0.125, 1.0, 3.375, 8.0]);
    }

    #[test]
    fn geometric_steps_grow_to_the_longest_and_reach_the_end() {
        let near = |found: &[f64], expected: &[f64]| {
            assert_eq!(found.len(), expected.len(), "{found:?}");
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
        };
        // 0.5 + 1 + 2 + 2 + 2 is too short, a sixth step too much: all but the first are shortened by about
        // 8.5/9.
        let times = geometric(9.0, 0.5, 2.0, Some(2.0), &[]).unwrap();
        let factor = 8.5 / 9.0;
        let expected: Vec<f64> = [0.0, 1.0, 3.0, 5.0, 7.0, 9.0].map(|t: f64| 0.5 + t * factor).into();
        near(&times, &[&[0.0], expected.as_slice()].concat());
        near(&geometric(7.5, 0.5, 2.0, None, &[]).unwrap(), &[0.0, 0.5, 1.5, 3.5, 7.5]);
        near(&geometric(0.5, 0.5, 2.0, None, &[]).unwrap(), &[0.0, 0.5]);
        near(&geometric(7.4, 0.5, 2.0, None, &[1.4]).unwrap(), &[0.0, 0.5, 1.4, 3.4, 7.4]);
        assert_eq!(geometric(1e9, 1e-9, 1.0 + 1e-12, None, &[]), None);
    }

    #[test]
    fn times_that_must_be_hit_move_near_points_and_come_between_others() {
        let rule = GridRule::Graded { end: 4.0, steps: 4, exponent: 1.0 };
        let grid = |must_hit: &[f64]| {
            let times = graded(4.0, 4, 1.0).into();
            let mut grid = Grid { rule: rule.clone(), must_hit: must_hit.to_vec(), times };
            grid.put_in();
            grid.times.to_vec()
        };
        assert_eq!(grid(&[2.0]), [0.0, 1.0, 2.0, 3.0, 4.0]);
        assert_eq!(grid(&[1.95, 2.5]), [0.0, 1.0, 1.95, 2.5, 3.0, 4.0]);
        // The ends are not moved.
        assert_eq!(grid(&[0.01, 3.99]), [0.0, 0.01, 1.0, 2.0, 3.0, 3.99, 4.0]);
        let given =
            Grid { rule: GridRule::Points { file: None }, must_hit: vec![1.95], times: [0.0, 2.0].into() };
        let mut given = given;
        given.put_in();
        assert_eq!(given.times(), [0.0, 1.95, 2.0]);
    }
}
