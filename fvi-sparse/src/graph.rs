//! Weighted graphs for dissection, and coarser graphs that approximate them.

/// An undirected graph without loops. The weight of a vertex is a number of unknowns, that of an edge a
/// number of places.
pub(crate) struct Graph {
    starts: Vec<usize>,
    neighbours: Vec<u32>,
    edges: Vec<u32>,
    weights: Vec<u32>,
}

/// Marker for no vertex.
pub(crate) const NONE: u32 = u32::MAX;

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

    /// The subgraph of these vertices. `local` has the length of this graph, and is [`NONE`] everywhere
    /// before and after.
    pub(crate) fn part(&self, vertices: &[u32], local: &mut [u32]) -> Self {
        let most = vertices.iter().map(|&vertex| self.neighbours(vertex).len()).sum();
        let mut part = Self::with_room(vertices.len(), most);
        for (index, &vertex) in vertices.iter().enumerate() {
            local[vertex as usize] = index as u32;
        }
        for &vertex in vertices {
            for (other, edge) in self.edges(vertex) {
                let other = local[other as usize];
                if other != NONE {
                    part.neighbours.push(other);
                    part.edges.push(edge);
                }
            }
            part.close(self.weights[vertex as usize]);
        }
        vertices.iter().for_each(|&vertex| local[vertex as usize] = NONE);
        part
    }

    fn with_room(vertices: usize, edges: usize) -> Self {
        let mut starts = Vec::with_capacity(vertices + 1);
        starts.push(0);
        let weights = Vec::with_capacity(vertices);
        Self { starts, neighbours: Vec::with_capacity(edges), edges: Vec::with_capacity(edges), weights }
    }

    /// Completes a vertex, whose neighbours are those added last.
    fn close(&mut self, weight: u32) {
        self.starts.push(self.neighbours.len());
        self.weights.push(weight);
    }

    /// A graph of about half the size, and for each vertex the vertex of it that it is merged into: pairs of
    /// neighbours along heavy edges are merged. Other seeds give other pairs.
    pub(crate) fn coarser(&self, seed: u32) -> (Self, Vec<u32>) {
        let size = self.size();
        let total: u64 = self.weights.iter().map(|&weight| u64::from(weight)).sum();
        let heaviest = (total / 16).max(2);
        let mut coarse = vec![NONE; size];
        let mut pairs: Vec<(u32, u32)> = Vec::with_capacity(size / 2);
        let weight = |vertex: u32| u64::from(self.weights[vertex as usize]);
        for vertex in scattered(size, seed) {
            if coarse[vertex as usize] != NONE {
                continue;
            }
            let most = heaviest.saturating_sub(weight(vertex));
            let mut partner = (vertex, 0, u64::MAX);
            for (other, edge) in self.edges(vertex) {
                let better = edge > partner.1 || (edge == partner.1 && weight(other) < partner.2);
                if better && coarse[other as usize] == NONE && weight(other) <= most {
                    partner = (other, edge, weight(other));
                }
            }
            let partner = partner.0;
            (coarse[vertex as usize], coarse[partner as usize]) = (pairs.len() as u32, pairs.len() as u32);
            pairs.push((vertex, partner));
        }
        let mut place = vec![NONE; pairs.len()];
        let mut graph = Self::with_room(pairs.len(), self.neighbours.len());
        for (own, &(one, other)) in pairs.iter().enumerate() {
            let start = graph.neighbours.len();
            let both = if one == other { &[one][..] } else { &[one, other][..] };
            for (neighbour, edge) in both.iter().flat_map(|&vertex| self.edges(vertex)) {
                let neighbour = coarse[neighbour as usize];
                if neighbour == own as u32 {
                    continue;
                }
                let known = place[neighbour as usize] as usize;
                if known >= start && graph.neighbours.get(known) == Some(&neighbour) {
                    graph.edges[known] += edge;
                } else {
                    place[neighbour as usize] = graph.neighbours.len() as u32;
                    graph.neighbours.push(neighbour);
                    graph.edges.push(edge);
                }
            }
            graph.close(both.iter().map(|&vertex| self.weights[vertex as usize]).sum());
        }
        (graph, coarse)
    }
}

/// The numbers below `size` in a pseudorandom order that depends on the seed only.
fn scattered(size: usize, seed: u32) -> impl Iterator<Item = u32> {
    let size = size.max(1) as u64;
    // Steps coprime to the size visit every number once.
    let mut step = (size as f64 * (0.618_033_988_75 + 0.07 * f64::from(seed))) as u64 % size;
    while common_factor(step, size) != 1 {
        step += 1;
    }
    let mut number = 0;
    (0..size).map(move |_| {
        number = (number + step) % size;
        number as u32
    })
}

fn common_factor(mut one: u64, mut other: u64) -> u64 {
    while other != 0 {
        (one, other) = (other, one % other);
    }
    one
}
