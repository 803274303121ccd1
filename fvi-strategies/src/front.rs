//! Which strategy wins where: fronts, fits and sentences.

use crate::precision::Precision;
use crate::record::{RaceRecord, Record, Row};

/// Pareto front: indices of the points to which no other point is better in both coordinates, sorted by the
/// first coordinate.
pub(crate) fn front(points: &[(f64, f64)]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| {
        let (a, b) = (points[a], points[b]);
        a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    let mut lowest = f64::INFINITY;
    order.retain(|&index| {
        let better = points[index].1 < lowest;
        lowest = lowest.min(points[index].1);
        better
    });
    order
}

/// The rows that may win: those with an error within the tolerance.
pub(crate) fn eligible(race: &RaceRecord) -> Vec<&Row> {
    race.rows.iter().filter(|row| row.within).collect()
}

/// The fastest row of a race, and the rows whose confidence intervals overlap its own.
pub(crate) fn fastest(race: &RaceRecord) -> Option<(&Row, Vec<&Row>)> {
    let rows = eligible(race);
    let best = rows.iter().copied().min_by(|a, b| a.mean_ns.total_cmp(&b.mean_ns))?;
    let tie = |row: &&Row| row.strategy != best.strategy && row.between_ns.0 <= best.between_ns.1;
    Some((best, rows.into_iter().filter(tie).collect()))
}

/// The row with the smallest value of `of`.
pub(crate) fn least(race: &RaceRecord, of: impl Fn(&Row) -> f64) -> Option<&Row> {
    eligible(race).into_iter().min_by(|a, b| of(a).total_cmp(&of(b)))
}

/// Key common to races that differ in length only: kernel, channels, precision and tolerance.
pub(crate) type Family<'a> = (&'a str, usize, Precision, f64);

pub(crate) fn family(race: &RaceRecord) -> Family<'_> {
    (&race.kernel, race.channels, race.precision, race.tolerance)
}

/// Races of one kernel, number of channels, precision and tolerance, by length.
pub(crate) fn families(record: &Record) -> Vec<Vec<&RaceRecord>> {
    let mut families: Vec<Vec<&RaceRecord>> = Vec::new();
    for race in &record.races {
        match families.iter_mut().find(|races| family(races[0]) == family(race)) {
            Some(races) => races.push(race),
            None => families.push(vec![race]),
        }
    }
    families.iter_mut().for_each(|races| races.sort_by_key(|race| race.length));
    families
}

/// Sentences that state, for each range of lengths, the fastest strategy within the tolerance.
pub(crate) fn winners(record: &Record) -> Vec<String> {
    families(record).iter().map(|races| sentence(races)).collect()
}

fn sentence(races: &[&RaceRecord]) -> String {
    let (kernel, channels, precision, tolerance) = family(races[0]);
    let mut parts: Vec<(String, usize, usize)> = Vec::new();
    for race in races {
        let name = match fastest(race) {
            None => "nobody keeps it".to_owned(),
            Some((best, ties)) if ties.is_empty() => best.strategy.clone(),
            Some((best, ties)) => {
                let others: Vec<_> = ties.iter().map(|row| row.strategy.as_str()).collect();
                format!("{} (a tie with {})", best.strategy, others.join(", "))
            }
        };
        match parts.last_mut() {
            Some((last, _, to)) if *last == name => *to = race.length,
            _ => parts.push((name, race.length, race.length)),
        }
    }
    let parts: Vec<String> = parts
        .into_iter()
        .map(|(name, from, to)| {
            if from == to {
                format!("{name} at {from} steps")
            } else {
                format!("{name} from {from} to {to} steps")
            }
        })
        .collect();
    let channels = if channels == 1 { "1 channel".to_owned() } else { format!("{channels} channels") };
    format!(
        "{kernel}, {channels}, {}, error up to {tolerance:e}: fastest is {}",
        precision.name(),
        parts.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_front_has_the_points_that_nobody_beats() {
        let points = [(1.0, 5.0), (2.0, 6.0), (3.0, 2.0), (3.0, 1.0), (0.5, 9.0), (4.0, 1.0)];
        assert_eq!(front(&points), [4, 0, 3]);
        assert!(front(&[]).is_empty());
    }
}
