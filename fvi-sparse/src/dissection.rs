//! An order of elimination by nested dissection: long and slender meshes, and those in three dimensions, fill less with it than by minimum
//! degree.

use crate::Pattern;
use std::collections::HashMap;

/// Parts up to this many groups are not divided further.
const LEAF: usize = 8;

/// The larger part of a division has at most this share of the whole.
const LOPSIDED: f64 = 0.65;

/// Steps towards the far end of a part, from where its levels are counted.
const STEPS: usize = 6;

/// The rows, separators behind what they separate.
///
/// Rows with the same places are a group and stay together, as the unknowns of one node of a mesh are. A part of the graph of groups is
/// divided by one of the levels of a breadth-first search from a far end of it: the smallest that leaves both sides of like size. Source:
/// \[GeorgeLiu78\].
pub(crate) fn nested_dissection(pattern: &Pattern) -> Vec<u32> {
    let graph = Groups::of(pattern);
    let count = graph.starts.len() - 1;
    let mut search =
        Search { graph: &graph, part: vec![0; count], level: vec![0; count], queue: Vec::new(), parts: 0 };
    let mut order = Vec::with_capacity(count);
    // Backwards: a separator comes before the parts on its sides.
    let mut open = vec![(0..count as u32).collect::<Vec<_>>()];
    while let Some(vertices) = open.pop() {
        let [one, other, separator] = search.divide(vertices);
        order.extend(separator.into_iter().rev());
        open.extend([one, other].into_iter().filter(|part| !part.is_empty()));
    }
    order.iter().rev().flat_map(|&group| graph.members[group as usize].iter().copied()).collect()
}

/// Rows with the same places, and which groups have places in common.
struct Groups {
    members: Vec<Vec<u32>>,
    starts: Vec<usize>,
    neighbours: Vec<u32>,
}

impl Groups {
    fn of(pattern: &Pattern) -> Self {
        let mut known: HashMap<&[usize], u32> = HashMap::new();
        let mut members: Vec<Vec<u32>> = Vec::new();
        let mut group_of = Vec::with_capacity(pattern.size());
        for (row, slots) in pattern.rows().enumerate() {
            let group = *known.entry(&pattern.columns()[slots]).or_insert(members.len() as u32);
            if group as usize == members.len() {
                members.push(Vec::new());
            }
            members[group as usize].push(row as u32);
            group_of.push(group);
        }
        let (mut starts, mut neighbours) = (vec![0], Vec::new());
        for (own, rows) in members.iter().enumerate() {
            let row = rows.first().map_or(0..0, |&row| pattern.row(row as usize));
            let first = neighbours.len();
            let others = pattern.columns()[row].iter().map(|&column| group_of[column]);
            neighbours.extend(others.filter(|&other| other as usize != own));
            neighbours[first..].sort_unstable();
            let mut kept = first;
            for index in first..neighbours.len() {
                if kept == first || neighbours[kept - 1] != neighbours[index] {
                    neighbours[kept] = neighbours[index];
                    kept += 1;
                }
            }
            neighbours.truncate(kept);
            starts.push(neighbours.len());
        }
        Self { members, starts, neighbours }
    }

    fn neighbours(&self, group: u32) -> &[u32] {
        &self.neighbours[self.starts[group as usize]..self.starts[group as usize + 1]]
    }
}

/// A graph on its way to be divided.
struct Search<'a> {
    graph: &'a Groups,
    /// The number of the part that each group is in.
    part: Vec<u32>,
    level: Vec<u32>,
    queue: Vec<u32>,
    /// Numbers given so far.
    parts: u32,
}

impl Search<'_> {
    /// Two parts without a place in common, and what separates them; small parts are all separator.
    fn divide(&mut self, vertices: Vec<u32>) -> [Vec<u32>; 3] {
        let whole = |separator| [Vec::new(), Vec::new(), separator];
        let Some(&start) = vertices.first() else { return whole(vertices) };
        if vertices.len() <= LEAF {
            return whole(vertices);
        }
        let number = self.number(&vertices);
        let (mut far, mut levels) = self.levels_from(start, &vertices, number);
        if self.queue.len() < vertices.len() {
            let reached = self.queue.clone();
            self.number(&reached);
            let others = vertices.into_iter().filter(|&group| self.part[group as usize] == number).collect();
            return [reached, others, Vec::new()];
        }
        for _ in 0..STEPS {
            let (next, longer) = self.levels_from(far, &vertices, number);
            let ends = longer <= levels;
            (far, levels) = (next, longer);
            if ends {
                break;
            }
        }
        if levels < 3 {
            return whole(vertices);
        }
        let chosen = self.best_level(&vertices, levels);
        let (mut one, mut other, mut separator) = (Vec::new(), Vec::new(), Vec::new());
        for group in vertices {
            let level = self.level[group as usize];
            let is_beyond = |other: &u32| {
                self.part[*other as usize] == number && self.level[*other as usize] == chosen + 1
            };
            match level.cmp(&chosen) {
                std::cmp::Ordering::Less => one.push(group),
                std::cmp::Ordering::Greater => other.push(group),
                // What has no neighbour beyond need not separate.
                std::cmp::Ordering::Equal if self.graph.neighbours(group).iter().any(is_beyond) => {
                    separator.push(group);
                }
                std::cmp::Ordering::Equal => one.push(group),
            }
        }
        // What is in no part any more.
        self.number(&separator);
        [one, other, separator]
    }

    /// Makes a part of these groups; returns its number.
    fn number(&mut self, vertices: &[u32]) -> u32 {
        self.parts += 1;
        vertices.iter().for_each(|&group| self.part[group as usize] = self.parts);
        self.parts
    }

    /// Counts levels within a part from one of its groups; returns one at the far end with few neighbours, and how many levels there are.
    /// The queue holds what was reached.
    fn levels_from(&mut self, start: u32, vertices: &[u32], number: u32) -> (u32, u32) {
        const UNSEEN: u32 = u32::MAX;
        vertices.iter().for_each(|&group| self.level[group as usize] = UNSEEN);
        self.queue.clear();
        self.queue.push(start);
        self.level[start as usize] = 0;
        let mut next = 0;
        while let Some(&group) = self.queue.get(next) {
            next += 1;
            let level = self.level[group as usize] + 1;
            for &other in self.graph.neighbours(group) {
                if self.part[other as usize] == number && self.level[other as usize] == UNSEEN {
                    self.level[other as usize] = level;
                    self.queue.push(other);
                }
            }
        }
        let last = self.queue.last().map_or(0, |&group| self.level[group as usize]);
        let at_the_end = self.queue.iter().rev().take_while(|&&group| self.level[group as usize] == last);
        let far = at_the_end.min_by_key(|&&group| self.graph.neighbours(group).len());
        (far.copied().unwrap_or(start), last + 1)
    }

    /// The level that divides a part best: small, with sides of like size.
    fn best_level(&self, vertices: &[u32], levels: u32) -> u32 {
        let mut sizes = vec![0_usize; levels as usize];
        vertices.iter().for_each(|&group| sizes[self.level[group as usize] as usize] += 1);
        let (mut before, mut best) = (0, (f64::INFINITY, levels / 2));
        for (level, &size) in sizes.iter().enumerate() {
            let larger = before.max(vertices.len() - before - size) as f64 / vertices.len() as f64;
            before += size;
            let inner = level > 0 && level + 1 < sizes.len();
            let badness = size as f64 * (1.0 + 2.0 * (larger - 0.5).max(0.0));
            if inner && (larger <= LOPSIDED || levels <= 4) && badness < best.0 {
                best = (badness, level as u32);
            }
        }
        best.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_is_eliminated_once_and_separators_come_last() {
        // A strip of 60×3 nodes of two unknowns each, and an island.
        let (long, wide) = (60_usize, 3_usize);
        let rows = (0..2 * long * wide + 1).map(|row| {
            if row == 2 * long * wide {
                return vec![row];
            }
            let (x, y) = (row / 2 / wide, row / 2 % wide);
            let near = (0..2 * long * wide).filter(|other| {
                let (x2, y2) = (other / 2 / wide, other / 2 % wide);
                x.abs_diff(x2) <= 1 && y.abs_diff(y2) <= 1
            });
            near.collect()
        });
        let pattern = Pattern::from_rows(rows);
        let order = nested_dissection(&pattern);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted.iter().enumerate().all(|(index, &row)| row as usize == index));
        // The last separator is a cross-section near the middle.
        let strip = order.iter().rev().map(|&row| row as usize).filter(|&row| row < 2 * long * wide);
        let last: Vec<usize> = strip.take(6).map(|row| row / 2 / wide).collect();
        assert!(last.iter().all(|&x| x == last[0] && (20..40).contains(&x)), "{last:?}");
    }
}
