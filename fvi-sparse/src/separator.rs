//! Small sets of vertices whose removal leaves two parts of similar size.

use crate::graph::Graph;
use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

/// Effort spent on finding a small separator.
pub(crate) struct Effort {
    /// Parts up to this many vertices are not divided.
    pub(crate) leaf: usize,
    /// Number of divisions computed on coarser graphs, of which the best is kept.
    trials: u32,
    /// Size up to which a graph is divided by growing parts from several vertices.
    coarsest: usize,
    /// Number of vertices from which parts are grown.
    seeds: usize,
    /// Number of rounds in which each vertex of a separator may move.
    rounds: usize,
    /// Number of moves without improvement after which a round ends: the first number, or this fraction of
    /// the moves considered at the beginning of the round, two for each vertex of the separator. A separator
    /// that moves as a whole grows temporarily.
    patience: (usize, f64),
    /// A cross-section is improved only if its score before is worse than the best division by at most this
    /// fraction.
    nearly: f64,
}

impl Effort {
    /// For structures whose elimination takes no longer than that.
    pub(crate) const QUICK: Self =
        Self { leaf: 300, trials: 1, coarsest: 60, seeds: 4, rounds: 4, patience: (15, 0.25), nearly: 0.25 };
    /// Separators that are a few per cent smaller, in five times the time.
    pub(crate) const THOROUGH: Self =
        Self { leaf: 64, trials: 2, coarsest: 96, seeds: 8, rounds: 6, patience: (40, 1.0), nearly: 1.0 };
}

/// Largest fraction of the whole for a part.
const LARGEST: f64 = 0.6;

/// Location of a vertex: part 0, part 1, or the separator between them.
pub(crate) type Side = u8;

/// The side of vertices of the separator.
pub(crate) const BETWEEN: Side = 2;

/// The side of each vertex; no edge leads from one part into the other.
///
/// The graph is coarsened repeatedly, the coarsest one divided, and the separator improved by moving its
/// vertices while it is transferred back. Source: \[HendricksonRothberg98\] §§ 2, 3. Cross-sections of
/// slender structures, for which that method gives oblique separators, are tried too.
pub(crate) fn separate(graph: &Graph, effort: &Effort) -> Vec<Side> {
    let divisions = (0..effort.trials).map(|trial| multilevel(graph, effort, trial));
    let Some((mut best, mut sides)) = divisions.min_by_key(|(score, _)| *score) else { return Vec::new() };
    for mut section in cross_sections(graph) {
        // A cross-section that is poor before improvement will not become the best.
        let (too_large, weight, _) = score(weights(graph, &section));
        if !too_large && weight as f64 <= (1.0 + effort.nearly) * best.1 as f64 {
            let score = improve(graph, &mut section, effort);
            if score < best {
                (best, sides) = (score, section);
            }
        }
    }
    sides
}

/// One division, which depends on the pairs that are merged in coarser graphs.
fn multilevel(graph: &Graph, effort: &Effort, trial: u32) -> (Score, Vec<Side>) {
    let mut coarser = Vec::new();
    loop {
        let last = coarser.last().map_or(graph, |(graph, _)| graph);
        if last.size() <= effort.coarsest {
            break;
        }
        let (next, of) = last.coarser(trial);
        if next.size() * 20 > last.size() * 19 {
            break;
        }
        coarser.push((next, of));
    }
    let (mut score, mut sides) = grown(coarser.last().map_or(graph, |(graph, _)| graph), effort);
    while let Some((_, of)) = coarser.pop() {
        sides = of.iter().map(|&vertex| sides[vertex as usize]).collect();
        score = improve(coarser.last().map_or(graph, |(graph, _)| graph), &mut sides, effort);
    }
    (score, sides)
}

/// Divisions of a connected graph by all vertices at one distance from one of its ends: from a vertex there,
/// and from all vertices at the other end that are farthest from it. Source: \[GeorgeLiu78\].
fn cross_sections(graph: &Graph) -> Vec<Vec<Side>> {
    let mut ends = Vec::new();
    let mut start = vec![0];
    for _ in 0..2 {
        let Some(distances) = distances(graph, &start) else { return Vec::new() };
        let most = distances.iter().copied().max().unwrap_or(0);
        let farthest = (0..graph.size() as u32).filter(|&vertex| distances[vertex as usize] == most);
        start = if ends.is_empty() { farthest.take(1).collect() } else { farthest.collect() };
        ends.push(start.clone());
    }
    ends.iter().filter_map(|end| Some(cross_section(graph, &distances(graph, end)?))).collect()
}

/// Number of edges between each vertex and the nearest of the given ones; `None` if one is not connected to
/// them.
fn distances(graph: &Graph, from: &[u32]) -> Option<Vec<u32>> {
    let mut distances = vec![u32::MAX; graph.size()];
    from.iter().for_each(|&vertex| distances[vertex as usize] = 0);
    let (mut queue, mut next) = (from.to_vec(), 0);
    while let Some(&vertex) = queue.get(next) {
        next += 1;
        for &other in graph.neighbours(vertex) {
            if distances[other as usize] == u32::MAX {
                distances[other as usize] = distances[vertex as usize] + 1;
                queue.push(other);
            }
        }
    }
    (next == graph.size()).then_some(distances)
}

/// The best division into the vertices nearer than, at and farther than one distance.
fn cross_section(graph: &Graph, distances: &[u32]) -> Vec<Side> {
    let mut weights = vec![0; distances.iter().map(|&distance| distance as usize + 1).max().unwrap_or(0)];
    for (&distance, &weight) in distances.iter().zip(graph.weights()) {
        weights[distance as usize] += u64::from(weight);
    }
    let total = weights.iter().sum::<u64>();
    let mut nearer = 0;
    let scores = weights.iter().enumerate().map(|(distance, &weight)| {
        let score = score([nearer, total - nearer - weight, weight]);
        nearer += weight;
        (score, distance)
    });
    let cut = scores.min().map_or(0, |(_, distance)| distance);
    let side = |&distance: &u32| match (distance as usize).cmp(&cut) {
        Ordering::Less => 0,
        Ordering::Equal => BETWEEN,
        Ordering::Greater => 1,
    };
    distances.iter().map(side).collect()
}

/// The best of several divisions, each grown from one vertex until it has half of the whole.
fn grown(graph: &Graph, effort: &Effort) -> (Score, Vec<Side>) {
    let size = graph.size();
    let mut best: Option<(Score, Vec<Side>)> = None;
    for seed in (0..size).step_by(size.div_ceil(effort.seeds).max(1)) {
        let mut sides = vec![1; size];
        let total: u64 = graph.weights().iter().map(|&weight| u64::from(weight)).sum();
        let (mut queue, mut next, mut weight) = (vec![seed as u32], 0, 0);
        let mut seen = vec![false; size];
        seen[seed] = true;
        while 2 * weight < total {
            // The next component of a graph that is not connected.
            if next == queue.len() {
                let Some(other) = seen.iter().position(|&seen| !seen) else { break };
                seen[other] = true;
                queue.push(other as u32);
            }
            let vertex = queue[next];
            next += 1;
            sides[vertex as usize] = 0;
            weight += u64::from(graph.weights()[vertex as usize]);
            for &other in graph.neighbours(vertex) {
                if !std::mem::replace(&mut seen[other as usize], true) {
                    queue.push(other);
                }
            }
        }
        for vertex in 0..size as u32 {
            let touches = |side| graph.neighbours(vertex).iter().any(|&other| sides[other as usize] == side);
            if sides[vertex as usize] == 1 && touches(0) {
                sides[vertex as usize] = BETWEEN;
            }
        }
        let score = improve(graph, &mut sides, effort);
        if best.as_ref().is_none_or(|(least, _)| score < *least) {
            best = Some((score, sides));
        }
    }
    best.unwrap_or(((true, 0, 0), Vec::new()))
}

/// Smaller is better: whether a part is too large, the weight of the separator times the sum of half the
/// whole and the larger part, the weight of the larger part.
type Score = (bool, u64, u64);

/// Score of a division into parts and a separator of these weights.
fn score(weights: [u64; 3]) -> Score {
    let [one, other, between] = weights;
    let (larger, total) = (one.max(other), one + other + between);
    (larger > largest(total), between * (total / 2 + larger), larger)
}

/// The weights of the parts and of the separator.
fn weights(graph: &Graph, sides: &[Side]) -> [u64; 3] {
    let mut weights = [0; 3];
    for (&side, &weight) in sides.iter().zip(graph.weights()) {
        weights[side as usize] += u64::from(weight);
    }
    weights
}

/// Largest weight of a part of a graph of this weight.
fn largest(total: u64) -> u64 {
    (LARGEST * total as f64) as u64
}

/// Moves vertices of the separator into the parts and their neighbours on the other side into the separator,
/// while it gets lighter, passing through some worse divisions. Returns the score.
fn improve(graph: &Graph, sides: &mut [Side], effort: &Effort) -> Score {
    let mut search = Search::new(graph, sides);
    let mut score = search.score();
    for _ in 0..effort.rounds {
        let better = search.round(effort);
        if better >= score {
            break;
        }
        score = better;
    }
    score
}

/// State of the search for a better division.
struct Search<'a> {
    graph: &'a Graph,
    sides: &'a mut [Side],
    /// Vertices of the separator, and some former ones.
    between: Vec<u32>,
    /// Weight of the neighbours of each vertex of the separator in the two parts.
    near: Vec<[u64; 2]>,
    /// Weights of the parts and of the separator.
    weights: [u64; 3],
    largest: u64,
    /// Moves of a vertex to a side, ordered by the decrease of the separator.
    moves: BinaryHeap<(i64, Reverse<u32>, Side)>,
    /// Round in which each vertex moved last.
    moved: Vec<u32>,
    round: u32,
    /// Vertices that have changed sides, with their former sides.
    changes: Vec<(u32, Side)>,
}

impl<'a> Search<'a> {
    fn new(graph: &'a Graph, sides: &'a mut [Side]) -> Self {
        let (mut between, mut weights) = (Vec::new(), [0; 3]);
        for (vertex, (&side, &weight)) in sides.iter().zip(graph.weights()).enumerate() {
            weights[side as usize] += u64::from(weight);
            if side == BETWEEN {
                between.push(vertex as u32);
            }
        }
        let largest = largest(weights.iter().sum());
        let (near, moved) = (vec![[0; 2]; graph.size()], vec![0; graph.size()]);
        let (moves, changes) = (BinaryHeap::new(), Vec::new());
        let mut search =
            Self { graph, sides, between, near, weights, largest, moves, moved, round: 0, changes };
        (0..search.between.len()).for_each(|index| search.look_around(search.between[index]));
        search
    }

    fn score(&self) -> Score {
        score(self.weights)
    }

    /// Decrease of the separator when a vertex of it moves to a side.
    fn gain(&self, vertex: u32, side: Side) -> i64 {
        i64::from(self.graph.weights()[vertex as usize])
            - self.near[vertex as usize][1 - side as usize] as i64
    }

    /// Computes the weight of the neighbours of a vertex of the separator on each side.
    fn look_around(&mut self, vertex: u32) {
        let mut near = [0; 3];
        for &other in self.graph.neighbours(vertex) {
            near[self.sides[other as usize] as usize] += u64::from(self.graph.weights()[other as usize]);
        }
        self.near[vertex as usize] = [near[0], near[1]];
    }

    fn may_move(&self, vertex: u32) -> bool {
        self.sides[vertex as usize] == BETWEEN && self.moved[vertex as usize] != self.round
    }

    /// Adds the moves of a vertex of the separator to the queue.
    fn consider(&mut self, vertex: u32) {
        if self.may_move(vertex) {
            for side in [0, 1] {
                self.moves.push((self.gain(vertex, side), Reverse(vertex), side));
            }
        }
    }

    /// Moves a vertex to a side. Moves whose gain increases are queued anew; the others are re-evaluated when
    /// they are taken from the queue.
    fn put(&mut self, vertex: u32, side: Side) {
        let graph = self.graph;
        let before = std::mem::replace(&mut self.sides[vertex as usize], side);
        let weight = u64::from(graph.weights()[vertex as usize]);
        self.weights[before as usize] -= weight;
        self.weights[side as usize] += weight;
        for &other in graph.neighbours(vertex) {
            if self.sides[other as usize] != BETWEEN {
                continue;
            }
            let near = &mut self.near[other as usize];
            if let Some(near) = near.get_mut(side as usize) {
                *near += weight;
            }
            if let Some(near) = near.get_mut(before as usize) {
                *near -= weight;
                if self.moved[other as usize] != self.round {
                    let onward = 1 - before;
                    self.moves.push((self.gain(other, onward), Reverse(other), onward));
                }
            }
        }
        if side == BETWEEN {
            self.look_around(vertex);
            self.between.push(vertex);
        }
    }

    /// Moves each vertex at most once, and ends with the best division on the way.
    fn round(&mut self, effort: &Effort) -> Score {
        let graph = self.graph;
        self.round += 1;
        self.moves.clear();
        self.changes.clear();
        self.between.sort_unstable();
        self.between.dedup();
        let sides = &*self.sides;
        self.between.retain(|&vertex| sides[vertex as usize] == BETWEEN);
        (0..self.between.len()).for_each(|index| self.consider(self.between[index]));
        let (least, part) = effort.patience;
        let patience = least + (part * self.moves.len() as f64) as usize;
        let (mut best, mut kept, mut made) = (self.score(), 0, 0);
        while let Some((gain, Reverse(vertex), side)) = self.moves.pop() {
            if !self.may_move(vertex) {
                continue;
            }
            let now = self.gain(vertex, side);
            if now < gain {
                self.moves.push((now, Reverse(vertex), side));
            }
            let weight = u64::from(graph.weights()[vertex as usize]);
            if now != gain || self.weights[side as usize] + weight > self.largest {
                continue;
            }
            self.moved[vertex as usize] = self.round;
            self.changes.push((vertex, BETWEEN));
            self.put(vertex, side);
            for &other in graph.neighbours(vertex) {
                if self.sides[other as usize] == 1 - side {
                    self.changes.push((other, 1 - side));
                    self.put(other, BETWEEN);
                    self.consider(other);
                }
            }
            made += 1;
            let score = self.score();
            if score < best {
                (best, kept, made) = (score, self.changes.len(), 0);
            } else if made > patience {
                break;
            }
        }
        while self.changes.len() > kept {
            if let Some((vertex, side)) = self.changes.pop() {
                self.put(vertex, side);
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a box, connected if no coordinate differs by more than one.
    fn lattice([a, b, c]: [usize; 3]) -> Graph {
        let place = move |index: usize| [index % a, index / a % b, index / a / b];
        let size = a * b * c;
        Graph::of((0..size).map(|own| {
            let near = (0..size).filter(|&other| {
                other != own && place(own).iter().zip(place(other)).all(|(x, y)| x.abs_diff(y) <= 1)
            });
            (3, near.map(|other| (other as u32, 1)).collect::<Vec<_>>())
        }))
    }

    #[test]
    fn distances_are_numbers_of_edges_from_the_nearest_vertex() {
        let graph = lattice([7, 3, 1]);
        let from_an_end = distances(&graph, &[0, 7, 14]).unwrap();
        assert!((0..21).all(|vertex| from_an_end[vertex] == vertex as u32 % 7), "{from_an_end:?}");
        let cut = cross_section(&graph, &from_an_end);
        assert!((0..21).all(|vertex| cut[vertex] == [0, 0, 0, BETWEEN, 1, 1, 1][vertex % 7]), "{cut:?}");
        let apart = Graph::of([vec![(1, 1)], vec![(0, 1)], vec![]].into_iter().map(|others| (1, others)));
        assert_eq!(distances(&apart, &[0]), None);
        assert!(cross_sections(&apart).is_empty());
    }

    #[test]
    fn boxes_are_divided_by_cross_sections() {
        for (sides, least) in [([20, 4, 4], 16), ([40, 7, 7], 49), ([9, 9, 9], 81), ([40, 30, 1], 30)] {
            let graph = lattice(sides);
            for (name, effort) in [("quick", Effort::QUICK), ("thorough", Effort::THOROUGH)] {
                let found = separate(&graph, &effort);
                let count = |side| found.iter().filter(|&&other| other == side).count();
                for vertex in 0..graph.size() as u32 {
                    let side = found[vertex as usize];
                    let apart = |other: &u32| found[*other as usize] == 1 - side;
                    assert!(side == BETWEEN || !graph.neighbours(vertex).iter().any(apart));
                }
                let (one, other, between) = (count(0), count(1), count(BETWEEN));
                assert!(10 * one.max(other) <= 6 * graph.size(), "{name} {sides:?}: {one} {other} {between}");
                // None smaller where the box is long.
                let slender = sides[0] > 4 * sides[1];
                let part = if name == "quick" { 0.4 } else { 0.25 };
                let most = if slender { least } else { least + (part * least as f64) as usize };
                assert!(between <= most, "{name} {sides:?}: {between}");
            }
        }
    }
}
