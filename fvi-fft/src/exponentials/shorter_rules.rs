//! Sums of exponentials with fewer terms: Gauss rules in place of the slowest and of the fastest ones.
//!
//! How far each group can be compressed is found by comparing sums at lags, and what one head has shown is
//! where the search for the next one begins.

use crate::exponentials::decays::{Lags, SumsAtLags, sum_of_exponentials};
use crate::exponentials::jacobi_matrix::{JacobiMatrix, LONGEST_RULE};
use crate::quadrature::exponential::Exponential;
use std::cell::RefCell;
use std::ops::Range;

/// Exponentials, slowest first.
pub(super) type Nodes = Vec<Exponential>;

/// Upper ends of the group of slow nodes for which Gauss rules are tried, as rate · horizon: up to there
/// e^{−sn} is nearly a polynomial in s.
const SLOW_REACHES: [f64; 5] = [2.0, 4.0, 8.0, 16.0, 32.0];

/// Lower ends of the group of fast nodes, as rate · head.
const FAST_REACHES: [f64; 6] = [16.0, 13.0, 10.0, 8.0, 6.0, 4.0];

/// Rounding of sums of squares, relative to the whole.
const OF_SQUARES: f64 = 8.0 * f64::EPSILON;

/// Where the searches of one head have ended, and those of the next one begin.
#[derive(Debug, Default)]
pub(super) struct Shortening {
    slow: Reaches,
    fast: Reaches,
}

/// The search for one of the two groups.
#[derive(Debug, Default)]
struct Reaches {
    /// Size of the rule that was found for each reach; 0 where none was sought.
    sizes: [usize; FAST_REACHES.len()],
    /// The reach that saved most nodes.
    best: Option<usize>,
}

/// What a rule has to agree with.
struct Target<'a> {
    lags: &'a Lags,
    /// The largest difference at each lag, relative to the whole sum there.
    bounds: &'a [f64],
    /// The whole sums at each lag, one for each kernel.
    whole: &'a [Vec<f64>],
}

/// A part of the nodes of several kernels with common rates, and its sums at all lags.
struct Group<'a> {
    nodes: Vec<&'a [Exponential]>,
    sums: Vec<Vec<f64>>,
    /// The sums without the rounding of squares, at the lags where they were needed.
    exact: RefCell<Vec<Option<Vec<f64>>>>,
}

impl<'a> Group<'a> {
    fn new(rules: &'a [Nodes], range: Range<usize>, sums: Vec<Vec<f64>>) -> Self {
        let exact = RefCell::new(vec![None; sums.first().map_or(0, Vec::len)]);
        let nodes = rules.iter().map(|nodes| nodes.get(range.clone()).unwrap_or(&[])).collect();
        Self { nodes, sums, exact }
    }

    /// The sum of a kernel at the lag n, which is at this place.
    fn exact(&self, index: usize, place: usize, n: u64) -> f64 {
        let sums = || self.nodes.iter().map(|nodes| sum_of_exponentials(nodes, n)).collect();
        self.exact.borrow_mut()[place].get_or_insert_with(sums)[index]
    }
}

impl Shortening {
    /// The positive nodes of kernels with common rates, slowest first, with the slowest and the fastest
    /// replaced; at lags from `head` to `horizon` their sums differ by less than `tolerance` relative to the
    /// whole. All rates are at least `slowest`.
    pub(super) fn of(
        &mut self,
        rules: &[Nodes],
        [head, horizon]: [u64; 2],
        slowest: f64,
        tolerance: f64,
    ) -> Vec<Nodes> {
        let Some(nodes) = rules.first() else { return Vec::new() };
        let allowed = largest_change(tolerance);
        let lags = Lags::new(head, horizon);
        // Rates are rounded to double precision too.
        let bound = |&n: &u64| allowed + f64::EPSILON * slowest * n as f64;
        let bounds: Vec<f64> = lags.all().iter().map(bound).collect();
        let up_to = |rate: f64| nodes.partition_point(|node| node.rate - slowest <= rate);
        let ends = SLOW_REACHES.map(|reach| up_to(reach / horizon as f64));
        let begins = FAST_REACHES.map(|reach| up_to(reach / head as f64));
        let mut slow_sums =
            sums_after(rules, 0..nodes.len(), &lags, ends.iter().copied().chain([nodes.len()]));
        let whole = slow_sums.pop().unwrap_or_default();
        let counts = begins.iter().map(|begin| nodes.len() - begin);
        let fast_sums = sums_after(rules, (0..nodes.len()).rev(), &lags, counts);
        let target = Target { lags: &lags, bounds: &bounds, whole: &whole };
        let (slow_count, slow_rules) = self.slow.most_saved(ends.len(), |reach, size| {
            let group = Group::new(rules, 0..ends[reach], slow_sums[reach].clone());
            target.shortest_rules(&group, slow_gauss_rules(&group.nodes, slowest), size)
        });
        let (fast_count, mut fast_rules) = self.fast.most_saved(begins.len(), |reach, size| {
            let group = Group::new(rules, begins[reach]..nodes.len(), fast_sums[reach].clone());
            target.shortest_rules(&group, fast_gauss_rules(&group.nodes, head), size)
        });
        let mut end = nodes.len() - fast_count;
        if end < slow_count {
            // For a short horizon the two groups overlap: the fast one takes what the slow one leaves.
            end = slow_count;
            let rest = (slow_count..nodes.len()).rev();
            let sums = sums_after(rules, rest, &lags, [nodes.len() - slow_count].into_iter());
            let group = Group::new(rules, slow_count..nodes.len(), sums.concat());
            fast_rules = target.shortest_rules(&group, fast_gauss_rules(&group.nodes, head), 1).1;
        }
        let parts = slow_rules.iter().zip(rules).zip(&fast_rules);
        parts.map(|((slow, rule), fast)| [slow, &rule[slow_count..end], fast].concat()).collect()
    }
}

/// The largest change of a sum by one of the two groups, relative to itself.
pub(super) fn largest_change(tolerance: f64) -> f64 {
    (0.25 * tolerance).max(4.0 * f64::EPSILON)
}

/// The sums of so many nodes, in the given order, for each of the ascending `counts`.
fn sums_after(
    rules: &[Nodes],
    mut order: impl Iterator<Item = usize>,
    lags: &Lags,
    counts: impl Iterator<Item = usize>,
) -> Vec<Vec<Vec<f64>>> {
    let mut sums = SumsAtLags::new(lags, rules.len());
    let mut before = 0;
    let after = |count: usize| {
        for place in order.by_ref().take(count - before) {
            sums.add(rules[0][place].rate, rules.iter().map(|rule| rule[place].coefficient));
        }
        before = count;
        sums.totals()
    };
    counts.map(after).collect()
}

impl Reaches {
    /// Of the rules by reach the one that saves most nodes, with the number of nodes that it replaces;
    /// `shorter` finds one, from the size where its search begins. All reaches are tried the first time, then
    /// those next to the last choice.
    fn most_saved(
        &mut self,
        count: usize,
        mut shorter: impl FnMut(usize, usize) -> (usize, Vec<Nodes>),
    ) -> (usize, Vec<Nodes>) {
        let mut found: [Option<(usize, Vec<Nodes>)>; FAST_REACHES.len()] = Default::default();
        let mut tried = match self.best {
            None => 0..count,
            Some(best) => best..best + 1,
        };
        loop {
            for reach in tried {
                // A larger group is not replaced by fewer nodes.
                let known = self.sizes[..=reach].iter().rev().find(|&&size| size > 0);
                let (count, rules) = shorter(reach, known.map_or(1, |&size| size));
                let size = rules.first().map_or(0, Vec::len);
                if size < count {
                    self.sizes[reach] = size;
                }
                found[reach] = Some((count, rules));
            }
            let saved = |reach: &usize| {
                found[*reach].as_ref().map(|(count, rules)| count - rules.first().map_or(0, Vec::len))
            };
            let Some(best) = (0..count).max_by_key(saved) else { return Default::default() };
            let beside =
                (best.saturating_sub(1)..(best + 2).min(count)).find(|&reach| found[reach].is_none());
            match beside {
                Some(reach) => tried = reach..reach + 1,
                None => {
                    self.best = Some(best);
                    return found[best].take().unwrap_or_default();
                }
            }
        }
    }
}

impl Target<'_> {
    /// Number of nodes of a group and the shortest Gauss rules that agree with them, or the nodes themselves;
    /// the search begins at rules of `size` nodes.
    fn shortest_rules(
        &self,
        group: &Group<'_>,
        mut gauss_rules: impl FnMut(usize) -> Vec<Nodes>,
        size: usize,
    ) -> (usize, Vec<Nodes>) {
        let count = group.nodes.first().map_or(0, |nodes| nodes.len());
        let longest = LONGEST_RULE.min(count.saturating_sub(1));
        // A rule most likely fails at the lag where the one before it failed.
        let mut suspect = self.lags.all().len() - 1;
        let mut found = None;
        let mut size = size.min(longest);
        while (1..=longest).contains(&size) {
            let rules = gauss_rules(size);
            match self.first_miss(&rules, group, suspect) {
                None => (found, size) = (Some(rules), size - 1),
                Some(_) if found.is_some() => break,
                Some(place) => (suspect, size) = (place, size + 1),
            }
        }
        (count, found.unwrap_or_else(|| group.nodes.iter().map(|nodes| nodes.to_vec()).collect()))
    }

    /// The place of a lag where rules differ from a group by more than is allowed.
    fn first_miss(&self, rules: &[Nodes], group: &Group<'_>, suspect: usize) -> Option<usize> {
        // Where the rounding of squares could make the difference it is not part of the sums.
        let agrees = |index: usize, place: usize, sum: f64| {
            let (whole, bound) = (self.whole[index][place], self.bounds[place] * self.whole[index][place]);
            let miss = (group.sums[index][place] - sum).abs();
            let n = self.lags.all()[place];
            miss <= bound
                || miss <= bound + OF_SQUARES * whole
                    && (group.exact(index, place, n) - sum_of_exponentials(&rules[index], n)).abs() <= bound
        };
        let n = self.lags.all()[suspect];
        let mut each = rules.iter().enumerate();
        if !each.all(|(index, rule)| agrees(index, suspect, sum_of_exponentials(rule, n))) {
            return Some(suspect);
        }
        let mut sums = SumsAtLags::new(self.lags, rules.len());
        for place in 0..rules.first().map_or(0, Vec::len) {
            sums.add(rules[0][place].rate, rules.iter().map(|rule| rule[place].coefficient));
        }
        let totals = sums.totals();
        let misses =
            |place: &usize| !(0..rules.len()).all(|index| agrees(index, *place, totals[index][*place]));
        (0..self.lags.all().len()).find(misses)
    }
}

/// Gauss rules, by size, of the measures in the rate minus the slowest one: e^{−sn} is nearly a polynomial in
/// s where s n is moderate.
fn slow_gauss_rules(groups: &[&[Exponential]], slowest: f64) -> impl FnMut(usize) -> Vec<Nodes> {
    let beyond = move |node: &Exponential| node.rate - slowest;
    let unit = groups.first().and_then(|group| group.last()).map_or(1.0, beyond);
    let measure =
        |group: &&[Exponential]| group.iter().map(|node| (beyond(node) / unit, node.coefficient)).collect();
    let mut measures = Measures::of(groups.iter().map(measure).collect());
    move |size| {
        let node = |&(x, c): &(f64, f64)| Exponential { rate: slowest + x.max(0.0) * unit, coefficient: c };
        measures.gauss_rules(size).iter().map(|rule| rule.iter().map(node).collect()).collect()
    }
}

/// Gauss rules, by size, of the measures in t = e^{−s}, weighted with their values after the head:
/// e^{−s(n−n₀)} is a power of t.
fn fast_gauss_rules(groups: &[&[Exponential]], head: u64) -> impl FnMut(usize) -> Vec<Nodes> {
    let behind = head as f64;
    let first = groups.first().and_then(|group| group.first());
    let unit = first.map_or(1.0, |node| libm::exp(-node.rate));
    let place = |node: &Exponential| {
        (libm::exp(-node.rate) / unit, node.coefficient * libm::exp(-node.rate * behind))
    };
    let mut measures = Measures::of(groups.iter().map(|group| group.iter().map(place).collect()).collect());
    move |size| {
        let node = |&(t, c): &(f64, f64)| {
            let rate = -libm::log(t.max(f64::EPSILON) * unit);
            Exponential { rate, coefficient: c * libm::exp(rate * behind) }
        };
        let sorted = |rule: &Vec<(f64, f64)>| {
            let mut rule: Nodes = rule.iter().map(node).collect();
            rule.sort_by(|a, b| a.rate.total_cmp(&b.rate));
            rule
        };
        measures.gauss_rules(size).iter().map(sorted).collect()
    }
}

/// Discrete positive measures on the same places, with the quantities for Gauss rules on common nodes.
struct Measures {
    jacobi: JacobiMatrix,
    /// For each of several measures, the integrals of the orthonormal polynomials of their mean.
    integrals: Vec<Vec<f64>>,
}

impl Measures {
    /// From lists of (place, mass).
    fn of(measures: Vec<Vec<(f64, f64)>>) -> Self {
        let (first, count) = match &measures[..] {
            [] => return Self { jacobi: JacobiMatrix::of(&[]), integrals: Vec::new() },
            [one] => return Self { jacobi: JacobiMatrix::of(one), integrals: Vec::new() },
            [first, ..] => (first, measures.len() as f64),
        };
        let mass = |measure: &[(f64, f64)]| measure.iter().map(|(_, mass)| *mass).sum::<f64>();
        let masses: Vec<f64> = measures.iter().map(|measure| mass(measure)).collect();
        // The geometric mean of the normalised masses: for powers of the rate it has the mean exponent.
        let mean = |(index, &(place, _)): (usize, &(f64, f64))| {
            let shares = measures.iter().zip(&masses).map(|(measure, mass)| (measure[index].1 / mass).ln());
            (place, (shares.sum::<f64>() / count).exp())
        };
        let mean: Vec<(f64, f64)> = first.iter().enumerate().map(mean).collect();
        let mut jacobi = JacobiMatrix::of(&mean);
        let basis = jacobi.basis();
        // The basis consists of p_j √m with the masses m of the mean.
        let integral = |measure: &[(f64, f64)], row: &[f64]| -> f64 {
            let parts = measure.iter().zip(&mean).zip(row);
            parts.map(|(((_, mass), (_, mean)), basis)| basis * (mass / mean.sqrt())).sum()
        };
        let integrals =
            measures.iter().map(|measure| basis.iter().map(|row| integral(measure, row)).collect());
        let integrals = integrals.collect();
        Self { jacobi, integrals }
    }

    /// For each measure the rule on the nodes of the Gauss rule of `size` nodes that integrates polynomials
    /// below the degree `size` exactly: for a single one the Gauss rule itself.
    fn gauss_rules(&mut self, size: usize) -> Vec<Vec<(f64, f64)>> {
        if self.integrals.is_empty() {
            return vec![self.jacobi.gauss_rule(size)];
        }
        let nodes = self.jacobi.nodes(size);
        let mass = self.jacobi.mass();
        let of_measure = |integrals: &Vec<f64>| -> Vec<(f64, f64)> {
            let coefficient = |vector: &[f64]| -> f64 {
                let sum = vector.iter().zip(integrals).map(|(entry, integral)| entry * integral);
                vector.first().map_or(0.0, |first| first * mass.sqrt()) * sum.sum::<f64>()
            };
            nodes.iter().map(|(place, vector)| (*place, coefficient(vector))).collect()
        };
        self.integrals.iter().map(of_measure).collect()
    }
}
