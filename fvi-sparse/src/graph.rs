//! Graphs with weights, as dissection divides them: smaller and smaller ones that stand for the first.

/// An undirected graph without loops. Vertices stand for so many unknowns, edges for so many places.
pub(crate) struct Graph {
    starts: Vec<usize>,
    neighbours: Vec<u32>,
    edges: Vec<u32>,
    weights: Vec<u32>,
}

/// No vertex.
const NONE: u32 = u32::MAX;

impl Graph {
    /// The graph of vertices given one after another, each by its weight, and its neighbours with the weights
    /// of the edges.
    pub(crate) fn of<N: IntoIterator<Item = (u32, u32)>>(vertices: impl Iterator<Item = (u32, N)>) -> Self {
        let mut graph =
            Self { starts: vec![0], neighbours: Vec::new(), edges: Vec::new(), weights: Vec::new() };
        for (weight, neighbours) in vertices {
            for (neighbour, edge) in neighbours {
                graph.neighbours.push(neighbour);
                graph.edges.push(edge);
            }
            graph.starts.push(graph.neighbours.len());
            graph.weights.push(weight);
        }
        graph
    }

    /// Number of vertices.
    pub(crate) fn size(&self) -> usize {
        self.weights.len()
    }

    pub(crate) fn weights(&self) -> &[u32] {
        &self.weights
    }

    pub(crate) fn neighbours(&self, vertex: u32) -> &[u32] {
        &self.neighbours[self.starts[vertex as usize]..self.starts[vertex as usize + 1]]
    }

    /// The neighbours, each with the weight of the edge.
    pub(crate) fn edges(&self, vertex: u32) -> impl Iterator<Item = (u32, u32)> {
        let range = self.starts[vertex as usize]..self.starts[vertex as usize + 1];
        self.neighbours[range.clone()].iter().copied().zip(self.edges[range].iter().copied())
    }

    /// The part with these vertices. `local` is of the size of this graph, and may hold anything.
    pub(crate) fn part(&self, vertices: &[u32], local: &mut [u32]) -> Self {
        for &vertex in vertices {
            self.neighbours(vertex).iter().for_each(|&other| local[other as usize] = NONE);
        }
        for (index, &vertex) in vertices.iter().enumerate() {
            local[vertex as usize] = index as u32;
        }
        Self::of(vertices.iter().map(|&vertex| {
            let local = &*local;
            let others = self.edges(vertex).map(|(other, edge)| (local[other as usize], edge));
            (self.weights[vertex as usize], others.filter(|&(other, _)| other != NONE).collect::<Vec<_>>())
        }))
    }

    /// A graph of about half the size, and the vertex of it that each vertex is part of: neighbours along
    /// heavy edges are one. Seeds give other pairs.
    pub(crate) fn coarser(&self, seed: u32) -> (Self, Vec<u32>) {
        let size = self.size();
        let total: u64 = self.weights.iter().map(|&weight| u64::from(weight)).sum();
        let heaviest = (total / 16).max(2);
        let mut coarse = vec![NONE; size];
        let mut pairs: Vec<(u32, u32)> = Vec::with_capacity(size / 2);
        for vertex in scattered(size, seed) {
            if coarse[vertex as usize] != NONE {
                continue;
            }
            let weight = |vertex: u32| u64::from(self.weights[vertex as usize]);
            let free = self.edges(vertex).filter(|&(other, _)| {
                coarse[other as usize] == NONE && weight(vertex) + weight(other) <= heaviest
            });
            let partner = free.max_by_key(|&(other, edge)| (edge, std::cmp::Reverse((weight(other), other))));
            let partner = partner.map_or(vertex, |(other, _)| other);
            (coarse[vertex as usize], coarse[partner as usize]) = (pairs.len() as u32, pairs.len() as u32);
            pairs.push((vertex, partner));
        }
        let mut place = vec![NONE; pairs.len()];
        let coarse_of = &coarse;
        let graph = Self::of(pairs.iter().enumerate().map(|(own, &(one, other))| {
            let both = if one == other { &[one][..] } else { &[one, other][..] };
            let mut merged: Vec<(u32, u32)> = Vec::new();
            for (neighbour, edge) in both.iter().flat_map(|&vertex| self.edges(vertex)) {
                let neighbour = coarse_of[neighbour as usize];
                if neighbour == own as u32 {
                    continue;
                }
                match merged.get_mut(place[neighbour as usize] as usize) {
                    Some((known, sum)) if *known == neighbour => *sum += edge,
                    _ => {
                        place[neighbour as usize] = merged.len() as u32;
                        merged.push((neighbour, edge));
                    }
                }
            }
            (both.iter().map(|&vertex| self.weights[vertex as usize]).sum(), merged)
        }));
        (graph, coarse)
    }
}

/// The numbers below `size` in an order that looks random and is always the same for a seed.
fn scattered(size: usize, seed: u32) -> Vec<u32> {
    let mut numbers: Vec<u32> = (0..size as u32).collect();
    numbers.sort_by_key(|&number| {
        ((number ^ seed).wrapping_mul(0x9E37_79B1).rotate_left(16).wrapping_mul(0x85EB_CA6B), number)
    });
    numbers
}
