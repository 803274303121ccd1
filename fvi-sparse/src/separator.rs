//! Small sets of vertices whose removal leaves two parts of like size.

use crate::graph::Graph;
use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

/// A graph up to this size is divided by growing parts from several vertices.
const COARSEST: usize = 96;

/// Divisions of which the best is kept.
const TRIALS: u32 = 2;

/// Vertices that parts are grown from.
const SEEDS: usize = 8;

/// A part may have so much of the whole.
const LARGEST: f64 = 0.6;

/// Times that all vertices of a separator may move.
const ROUNDS: usize = 6;

/// Moves that do not pay before a round ends, beyond two for each vertex of the separator: one that is moved
/// as a whole gets larger on the way.
const PATIENCE: usize = 40;

/// Where a vertex is: in part 0 or 1, or between them.
pub(crate) type Side = u8;

/// The side of what separates.
pub(crate) const BETWEEN: Side = 2;

/// The side of each vertex; no edge leads from one part into the other.
///
/// The graph is made coarser and coarser, the smallest one divided, and the separator improved by moving its
/// vertices while it is carried back. Source: \[HendricksonRothberg98\] §§ 2, 3. Cross-sections of slender
/// structures, which that leaves oblique, are tried too.
pub(crate) fn separate(graph: &Graph) -> Vec<Side> {
    let found = (0..TRIALS).map(|trial| multilevel(graph, trial)).chain(cross_sections(graph));
    let best = found.min_by_key(|(score, _)| *score);
    best.map_or_else(Vec::new, |(_, sides)| sides)
}

/// One division, which depends on the pairs that coarser graphs are made of.
fn multilevel(graph: &Graph, trial: u32) -> (Score, Vec<Side>) {
    let mut coarser = Vec::new();
    loop {
        let last = coarser.last().map_or(graph, |(graph, _)| graph);
        if last.size() <= COARSEST {
            break;
        }
        let (next, of) = last.coarser(trial);
        if next.size() * 20 > last.size() * 19 {
            break;
        }
        coarser.push((next, of));
    }
    let (mut score, mut sides) = grown(coarser.last().map_or(graph, |(graph, _)| graph));
    while let Some((_, of)) = coarser.pop() {
        sides = of.iter().map(|&vertex| sides[vertex as usize]).collect();
        score = improve(coarser.last().map_or(graph, |(graph, _)| graph), &mut sides);
    }
    (score, sides)
}

/// Divisions by all vertices at one distance from an end of a connected graph: from a vertex there, and from
/// all that are farthest from it, at the other end. Source: \[GeorgeLiu78\].
fn cross_sections(graph: &Graph) -> Vec<(Score, Vec<Side>)> {
    let mut ends = Vec::new();
    let mut start = vec![0];
    for _ in 0..2 {
        let Some(distances) = distances(graph, &start) else { return Vec::new() };
        let most = distances.iter().copied().max().unwrap_or(0);
        let farthest = (0..graph.size() as u32).filter(|&vertex| distances[vertex as usize] == most);
        start = if ends.is_empty() { farthest.take(1).collect() } else { farthest.collect() };
        ends.push(start.clone());
    }
    let divided = ends.iter().filter_map(|end| {
        let mut sides = cross_section(graph, &distances(graph, end)?);
        Some((improve(graph, &mut sides), sides))
    });
    divided.collect()
}

/// Number of edges between each vertex and the nearest one of some; `None` if one is not connected with them.
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

/// The best division by the vertices at one distance.
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
fn grown(graph: &Graph) -> (Score, Vec<Side>) {
    let size = graph.size();
    let mut best: Option<(Score, Vec<Side>)> = None;
    for seed in (0..size).step_by(size.div_ceil(SEEDS).max(1)) {
        let mut sides = vec![1; size];
        let total: u64 = graph.weights().iter().map(|&weight| u64::from(weight)).sum();
        let (mut queue, mut next, mut weight) = (vec![seed as u32], 0, 0);
        let mut seen = vec![false; size];
        seen[seed] = true;
        while 2 * weight < total {
            // The next of a part that is not connected.
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
        let score = improve(graph, &mut sides);
        if best.as_ref().is_none_or(|(least, _)| score < *least) {
            best = Some((score, sides));
        }
    }
    best.unwrap_or(((true, 0, 0), Vec::new()))
}

/// Less is better: whether a part is too large, the weight of the separator times half the whole and the
/// larger part, that of the larger part.
type Score = (bool, u64, u64);

/// How good a division into parts and a separator of these weights is.
fn score(weights: [u64; 3]) -> Score {
    let [one, other, between] = weights;
    let (larger, total) = (one.max(other), one + other + between);
    (larger > largest(total), between * (total / 2 + larger), larger)
}

/// What a part of a graph of this weight may weigh.
fn largest(total: u64) -> u64 {
    (LARGEST * total as f64) as u64
}

/// Moves vertices of the separator into the parts, their neighbours on the other side taking their places,
/// while it gets lighter; also through some divisions that are worse. Returns how good it is.
fn improve(graph: &Graph, sides: &mut [Side]) -> Score {
    let mut search = Search::new(graph, sides);
    let mut score = search.score();
    for _ in 0..ROUNDS {
        let better = search.round();
        if better >= score {
            break;
        }
        score = better;
    }
    score
}

/// A division under way.
struct Search<'a> {
    graph: &'a Graph,
    sides: &'a mut [Side],
    /// Weight of the neighbours of each vertex in the two parts.
    near: Vec<[u64; 2]>,
    /// Weights of the parts and of the separator.
    weights: [u64; 3],
    largest: u64,
    /// Moves by what they take off the separator.
    moves: BinaryHeap<(i64, Reverse<u32>, Side)>,
    moved: Vec<bool>,
    /// Vertices that have changed sides, with the sides they were on.
    changes: Vec<(u32, Side)>,
}

impl<'a> Search<'a> {
    fn new(graph: &'a Graph, sides: &'a mut [Side]) -> Self {
        let (mut near, mut weights) = (vec![[0; 2]; graph.size()], [0; 3]);
        for (vertex, (&side, &weight)) in sides.iter().zip(graph.weights()).enumerate() {
            weights[side as usize] += u64::from(weight);
            if side != BETWEEN {
                for &other in graph.neighbours(vertex as u32) {
                    near[other as usize][side as usize] += u64::from(weight);
                }
            }
        }
        let largest = largest(weights.iter().sum());
        let (moves, moved) = (BinaryHeap::new(), vec![false; graph.size()]);
        Self { graph, sides, near, weights, largest, moves, moved, changes: Vec::new() }
    }

    fn score(&self) -> Score {
        score(self.weights)
    }

    /// What the separator loses when a vertex of it moves to a side.
    fn gain(&self, vertex: u32, side: Side) -> i64 {
        i64::from(self.graph.weights()[vertex as usize])
            - self.near[vertex as usize][1 - side as usize] as i64
    }

    /// Has the moves of a vertex of the separator looked at.
    fn consider(&mut self, vertex: u32) {
        if self.sides[vertex as usize] == BETWEEN && !self.moved[vertex as usize] {
            for side in [0, 1] {
                self.moves.push((self.gain(vertex, side), Reverse(vertex), side));
            }
        }
    }

    /// Puts a vertex on another side. Moves that gain by it are looked at again; the others when their turn
    /// comes.
    fn put(&mut self, vertex: u32, side: Side) {
        let graph = self.graph;
        let before = std::mem::replace(&mut self.sides[vertex as usize], side);
        let weight = u64::from(graph.weights()[vertex as usize]);
        self.weights[before as usize] -= weight;
        self.weights[side as usize] += weight;
        for &other in graph.neighbours(vertex) {
            let near = &mut self.near[other as usize];
            if let Some(near) = near.get_mut(side as usize) {
                *near += weight;
            }
            if let Some(near) = near.get_mut(before as usize) {
                *near -= weight;
                if self.sides[other as usize] == BETWEEN && !self.moved[other as usize] {
                    let onward = 1 - before;
                    self.moves.push((self.gain(other, onward), Reverse(other), onward));
                }
            }
        }
    }

    /// Moves each vertex once at most, and ends with the best division on the way.
    fn round(&mut self) -> Score {
        let graph = self.graph;
        self.moves.clear();
        self.moved.fill(false);
        self.changes.clear();
        (0..graph.size() as u32).for_each(|vertex| self.consider(vertex));
        let patience = PATIENCE + self.moves.len();
        let (mut best, mut kept, mut made) = (self.score(), 0, 0);
        while let Some((gain, Reverse(vertex), side)) = self.moves.pop() {
            if self.sides[vertex as usize] != BETWEEN || self.moved[vertex as usize] {
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
            self.moved[vertex as usize] = true;
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

    /// Points of a box, neighbours where no coordinate differs by more than one.
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
            let found = separate(&graph);
            let count = |side| found.iter().filter(|&&other| other == side).count();
            for vertex in 0..graph.size() as u32 {
                let side = found[vertex as usize];
                let apart = |other: &u32| found[*other as usize] == 1 - side;
                assert!(side == BETWEEN || !graph.neighbours(vertex).iter().any(apart));
            }
            let (one, other, between) = (count(0), count(1), count(BETWEEN));
            assert!(10 * one.max(other) <= 6 * graph.size(), "{sides:?}: {one} {other} {between}");
            // None smaller where the box is long.
            let slender = sides[0] > 4 * sides[1];
            let most = if slender { least } else { least + least / 8 };
            assert!(between <= most, "{sides:?}: {between}");
        }
    }
}
