//! Which strategy wins where: fronts, fits and sentences.

use fvi_fft::sums::max_or_nan;

use crate::precision::Precision;
use crate::race::{STANDS, allowed};
use crate::record::{RaceRecord, Record, Row, counted};

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

/// A point of error and time: strategy, range of the time, error relative to Σ|w||x|.
struct Timed<'a> {
    strategy: &'a str,
    range_ns: (f64, f64),
    error: f64,
}

/// Times of a row that are not told from its own: the confidence interval of its mean, but not less than what
/// a median is measured to.
fn range_ns(row: &Row) -> (f64, f64) {
    widened(row.mean_ns, row.between_ns)
}

/// The same for the total time of a run.
fn total_range_ns(row: &Row) -> (f64, f64) {
    widened(row.total_ns, row.total_between_ns)
}

fn widened(median: f64, (low, high): (f64, f64)) -> (f64, f64) {
    (low.min((1.0 - STANDS) * median), high.max((1.0 + STANDS) * median))
}

/// The strategies on the Pareto front of error and total time of a run of some races, which differ in their tolerance
/// only, and those that the spread of the times does not tell from it: no other strategy with as small an
/// error is faster beyond the ranges of both.
pub(crate) fn front_and_ties<'a>(races: &[&'a RaceRecord]) -> (Vec<&'a str>, Vec<&'a str>) {
    let rows = || races.iter().flat_map(|race| race.rows.iter().map(move |row| (race, row)));
    let error = |race: &RaceRecord, row: &Row| row.error_u * race.precision.unit();
    let points: Vec<(f64, f64)> = rows().map(|(race, row)| (row.total_ns, error(race, row))).collect();
    let timed: Vec<Timed<'_>> = rows()
        .map(|(race, row)| Timed {
            strategy: &row.strategy,
            range_ns: total_range_ns(row),
            error: error(race, row),
        })
        .collect();
    let distinct = |indices: &mut dyn Iterator<Item = usize>| {
        let mut names: Vec<&str> = Vec::new();
        indices.for_each(|index| {
            if !names.contains(&timed[index].strategy) {
                names.push(timed[index].strategy);
            }
        });
        names
    };
    let on_it = distinct(&mut front(&points).into_iter());
    let is_beaten = |one: &Timed<'_>| {
        timed.iter().any(|other| other.error <= one.error && other.range_ns.1 < one.range_ns.0)
    };
    let unbeaten = distinct(&mut (0..timed.len()).filter(|&index| !is_beaten(&timed[index])));
    let ties = unbeaten.into_iter().filter(|name| !on_it.contains(name)).collect();
    (on_it, ties)
}

/// Races on one kernel with one length, number of channels and precision, over all tolerances.
pub(crate) fn groups(record: &Record) -> Vec<Vec<&RaceRecord>> {
    let mut groups: Vec<Vec<&RaceRecord>> = Vec::new();
    for race in &record.races {
        match groups.iter_mut().find(|group| group[0].is_of_group(race)) {
            Some(group) => group.push(race),
            None => groups.push(vec![race]),
        }
    }
    groups
}

/// How far several runs of the same races agree about who wins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Agreement {
    /// Races with the same fastest strategy in all runs.
    pub same_winner: usize,
    /// Races whose fastest strategies differ, where each is the fastest or a tie with it in every run.
    pub tied_winners: usize,
    /// All other races.
    pub other_winners: usize,
    /// Pareto fronts of error and total time with the same strategies in all runs.
    pub same_front: usize,
    /// Fronts that differ, where each strategy is on the front or a tie with it in every run.
    pub tied_fronts: usize,
    /// All other fronts.
    pub other_fronts: usize,
}

impl Agreement {
    /// The agreement of runs, on the races that all of them have.
    pub fn of(runs: &[Record]) -> Self {
        let mut agreement = Self::default();
        let Some((first, others)) = runs.split_first() else { return agreement };
        for race in &first.races {
            let is_same = |other: &&RaceRecord| other.is_of_group(race) && other.tolerance == race.tolerance;
            let found: Option<Vec<&RaceRecord>> =
                others.iter().map(|run| run.races.iter().find(is_same)).collect();
            let Some(found) = found else { continue };
            let winners: Vec<_> = std::iter::once(race)
                .chain(found)
                .map(|race| {
                    fastest(race).map_or((Vec::new(), Vec::new()), |(best, ties)| {
                        (vec![&*best.strategy], ties.iter().map(|row| &*row.strategy).collect())
                    })
                })
                .collect();
            *match agree(&winners) {
                Some(true) => &mut agreement.same_winner,
                Some(false) => &mut agreement.tied_winners,
                None => &mut agreement.other_winners,
            } += 1;
        }
        for group in groups(first) {
            let of = |run| groups(run).into_iter().find(|other| other[0].is_of_group(group[0]));
            let Some(found) = others.iter().map(of).collect::<Option<Vec<_>>>() else { continue };
            let fronts: Vec<_> =
                std::iter::once(&group).chain(&found).map(|races| front_and_ties(races)).collect();
            *match agree(&fronts) {
                Some(true) => &mut agreement.same_front,
                Some(false) => &mut agreement.tied_fronts,
                None => &mut agreement.other_fronts,
            } += 1;
        }
        agreement
    }
}

/// True if the best of all runs are the same; `Some(false)` if they are so up to ties of each run.
fn agree(runs: &[(Vec<&str>, Vec<&str>)]) -> Option<bool> {
    let all = || runs.iter().flat_map(|(best, _)| best);
    if runs.iter().all(|(best, _)| all().all(|name| best.contains(name))) {
        return Some(true);
    }
    let up_to_ties =
        runs.iter().all(|(best, ties)| all().all(|name| best.contains(name) || ties.contains(name)));
    up_to_ties.then_some(false)
}

impl std::fmt::Display for Agreement {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { same_winner, tied_winners, other_winners, same_front, tied_fronts, other_fronts } = self;
        writeln!(
            f,
            "fastest as a whole: the same in {same_winner} of {} races, up to ties in {tied_winners}, another in {other_winners}",
            same_winner + tied_winners + other_winners
        )?;
        write!(
            f,
            "fronts of error and total time: the same in {same_front} of {}, up to ties in {tied_fronts}, another in {other_fronts}",
            same_front + tied_fronts + other_fronts
        )
    }
}

/// The rows that may win: those with an error within the tolerance.
pub(crate) fn eligible(race: &RaceRecord) -> Vec<&Row> {
    race.rows.iter().filter(|row| row.within).collect()
}

/// A row, and those that the spread of the times does not tell from it.
type WithTies<'a> = Option<(&'a Row, Vec<&'a Row>)>;

/// The fastest row of a race, construction and run together, and the rows whose ranges of times overlap its
/// own.
pub(crate) fn fastest(race: &RaceRecord) -> WithTies<'_> {
    first(race, |row| row.total_ns, total_range_ns)
}

/// The row with the shortest step on average, construction aside, in the same way.
pub(crate) fn quickest(race: &RaceRecord) -> WithTies<'_> {
    first(race, |row| row.mean_ns, range_ns)
}

fn first(race: &RaceRecord, of: fn(&Row) -> f64, range: fn(&Row) -> (f64, f64)) -> WithTies<'_> {
    let rows = eligible(race);
    let best = rows.iter().copied().min_by(|a, b| of(a).total_cmp(&of(b)))?;
    let tie = |row: &&Row| row.strategy != best.strategy && range(row).0 <= range(best).1;
    Some((best, rows.into_iter().filter(tie).collect()))
}

/// Break-even length: steps from which on a run with this strategy, its construction included, is faster than
/// with any other that keeps the tolerance and whose step takes longer beyond the spread of the times. All
/// times are those of this race. `None` for one that does not keep the tolerance.
pub(crate) fn break_even(race: &RaceRecord, row: &Row) -> Option<f64> {
    if !row.within {
        return None;
    }
    let slower = eligible(race).into_iter().filter(|other| range_ns(other).0 > range_ns(row).1);
    let even = slower.map(|other| (row.setup_ns - other.setup_ns) / (other.mean_ns - row.mean_ns));
    Some(even.fold(0.0, max_or_nan).ceil())
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

/// Sentences that state, for each range of lengths, the strategy within the tolerance with which a run is
/// over first, construction included, and that with the shortest step.
pub(crate) fn winners(record: &Record) -> Vec<String> {
    families(record).iter().map(|races| sentence(races)).collect()
}

fn sentence(races: &[&RaceRecord]) -> String {
    let (kernel, channels, precision, tolerance) = family(races[0]);
    let (whole, step) = (by_length(races, fastest), by_length(races, quickest));
    let channels = counted(channels, "channel");
    let allowed = allowed(tolerance, precision);
    let allowed =
        if allowed == tolerance { format!("{tolerance:e}") } else { format!("{allowed:.1e}, rounding") };
    let step = if step == whole { "the same".to_owned() } else { step };
    format!(
        "{kernel}, {channels}, {}, error up to {allowed}: fastest is {whole}, construction included; shortest step: {step}",
        precision.name(),
    )
}

/// Who is first at which lengths.
fn by_length(races: &[&RaceRecord], of: fn(&RaceRecord) -> WithTies<'_>) -> String {
    let mut parts: Vec<(String, usize, usize)> = Vec::new();
    for race in races {
        let name = match of(race) {
            None => "none (no strategy keeps it)".to_owned(),
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
                format!("{name} at {}", counted(from, "step"))
            } else {
                format!("{name} from {from} to {to} steps")
            }
        })
        .collect();
    parts.join(", ")
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

    /// A race on one kernel with rows of name, error in u, and confidence interval around the mean.
    fn race(length: usize, rows: &[(&str, f64, f64, f64)]) -> RaceRecord {
        let row = |&(strategy, error_u, low, high): &(&str, f64, f64, f64)| Row {
            strategy: strategy.to_owned(),
            error_u,
            within: true,
            promised: true,
            own_weights: false,
            last: Vec::new(),
            rounds_ns: vec![low, high],
            mean_ns: 0.5 * (low + high),
            between_ns: (low, high),
            stands: true,
            p50_ns: low,
            p999_ns: high,
            worst_ns: high,
            setups_ns: vec![1.0, 1.0],
            setup_ns: 1.0,
            total_ns: 1.0 + length as f64 * 0.5 * (low + high),
            total_between_ns: (1.0 + length as f64 * low, 1.0 + length as f64 * high),
            bytes: Some(1),
            flops: None,
            quadrature: None,
        };
        RaceRecord {
            kernel: "s^½".to_owned(),
            length,
            channels: 1,
            precision: Precision::F64,
            tolerance: 1e-3,
            rounds: 6,
            parts: vec![6],
            seconds: 1.0,
            rows: rows.iter().map(row).collect(),
            absent: Vec::new(),
        }
    }

    #[test]
    fn a_strategy_within_the_spread_of_the_front_is_a_tie_of_it() {
        let rows = [
            ("exact", 1.0, 50.0, 54.0),
            ("coarse", 1e6, 10.0, 12.0),
            ("nearly", 2e6, 11.0, 13.0),
            ("slow", 1e6, 13.0, 14.0),
        ];
        let race = race(256, &rows);
        assert_eq!(front_and_ties(&[&race]), (vec!["coarse", "exact"], vec!["nearly"]));
    }

    #[test]
    fn a_long_construction_is_worth_it_from_its_break_even_length_on() {
        let mut race = race(
            1000,
            &[("table", 1.0, 9.9, 10.1), ("transform", 1.0, 29.9, 30.1), ("like", 1.0, 10.0, 10.2)],
        );
        let at = |race: &mut RaceRecord, length: usize| {
            race.length = length;
            for (row, setup) in race.rows.iter_mut().zip([40_000.0, 1000.0, 50_000.0]) {
                row.setup_ns = setup;
                row.total_ns = setup + length as f64 * row.mean_ns;
                row.total_between_ns = (row.total_ns, row.total_ns);
            }
        };
        at(&mut race, 1000);
        // 39 000 ns more of construction, 20 ns less of a step; a tie of the step has no break-even with it.
        assert_eq!(break_even(&race, &race.rows[0]), Some(1950.0));
        assert_eq!(break_even(&race, &race.rows[1]), Some(0.0));
        assert_eq!(break_even(&race, &race.rows[2]), Some((49_000.0_f64 / 19.9).ceil()));
        assert_eq!(fastest(&race).unwrap().0.strategy, "transform");
        assert_eq!(quickest(&race).unwrap().0.strategy, "table");
        let said = sentence(&[&race]);
        assert!(
            said.contains("fastest is transform at 1000 steps, construction included; shortest step: table"),
            "{said}"
        );
        at(&mut race, 10_000);
        assert_eq!(fastest(&race).unwrap().0.strategy, "table");
        race.rows[0].within = false;
        assert_eq!(break_even(&race, &race.rows[0]), None);
    }

    #[test]
    fn runs_agree_where_the_winner_is_the_same_or_a_tie_in_each() {
        let run = |races: Vec<RaceRecord>| Record {
            plan: String::new(),
            machine: crate::machine::Machine::here(),
            races,
        };
        let (a, b) = (("a", 1.0, 10.0, 12.0), ("b", 1.0, 20.0, 22.0));
        let clear = || race(256, &[a, b]);
        let close = |a_ns: f64| race(512, &[("a", 1.0, a_ns, a_ns + 4.0), ("b", 1.0, 11.0, 15.0)]);
        let turned = race(1024, &[("a", 1.0, 30.0, 31.0), b]);
        let runs = [
            run(vec![clear(), close(10.0), race(1024, &[a, b])]),
            run(vec![clear(), close(12.0), turned, race(2048, &[a, b])]),
        ];
        let agreement = Agreement::of(&runs);
        let expected = Agreement {
            same_winner: 1,
            tied_winners: 1,
            other_winners: 1,
            same_front: 1,
            tied_fronts: 1,
            other_fronts: 1,
        };
        assert_eq!(agreement, expected);
        assert!(agreement.to_string().contains("the same in 1 of 3 races"), "{agreement}");
    }
}
