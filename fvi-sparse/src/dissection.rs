//! An order of elimination by nested dissection. For meshes in three dimensions, and long and slender ones,
//! it has less fill-in than minimum degree.

use crate::Pattern;
use crate::graph::{Graph, NONE};
use crate::separator::{BETWEEN, Effort, separate};
use std::collections::HashMap;

/// The rows, each separator after the parts that it separates; parts that are not divided any further are
/// ordered by minimum degree.
///
/// Rows with the same places, or nearly, are a group and stay together, as the unknowns of one node of a mesh
/// are. Source: \[GeorgeLiu78\].
pub(crate) fn nested_dissection(pattern: &Pattern, effort: &Effort) -> Vec<u32> {
    let (graph, members) = groups(pattern);
    let mut local = vec![NONE; graph.size()];
    let mut order = Vec::with_capacity(graph.size());
    // Built backwards: a separator comes before the parts on its sides.
    let mut open = vec![(0..graph.size() as u32).collect::<Vec<_>>()];
    while let Some(vertices) = open.pop() {
        let part = graph.part(&vertices, &mut local);
        let sides = if part.size() > effort.leaf { separate(&part, effort) } else { Vec::new() };
        let on = |side| {
            let both = vertices.iter().zip(&sides).filter(move |&(_, &other)| other == side);
            both.map(|(&vertex, _)| vertex).collect::<Vec<_>>()
        };
        let (one, other, between) = (on(0), on(1), on(BETWEEN));
        if one.is_empty() || other.is_empty() {
            let least = minimum_degree(&part);
            order.extend(least.iter().rev().map(|&index| vertices[index as usize]));
        } else {
            order.extend(between.iter().rev());
            open.extend([one, other]);
        }
    }
    order.iter().rev().flat_map(|&group| members[group as usize].iter().copied()).collect()
}

/// The vertices in an order that keeps the factor sparse.
fn minimum_degree(graph: &Graph) -> Vec<u32> {
    let (mut starts, mut places) = (vec![0], Vec::new());
    for vertex in 0..graph.size() as u32 {
        places.extend(graph.neighbours(vertex).iter().map(|&other| other as i32));
        starts.push(places.len() as i32);
    }
    match amd::order(graph.size() as i32, &starts, &places, &amd::Control::default()) {
        Ok((order, ..)) => order.into_iter().map(|vertex| vertex as u32).collect(),
        // amd does not fail for a graph; any order is correct.
        Err(_) => (0..graph.size() as u32).collect(),
    }
}

/// Fraction of common places from which rows are grouped: some couplings of the unknowns of two nodes may be
/// zero.
const ALIKE: f64 = 0.8;

/// Number of preceding rows among its places with which a row is compared.
const COMPARED: usize = 3;

/// The graph of groups of rows with the same places, or nearly, and the rows of each.
fn groups(pattern: &Pattern) -> (Graph, Vec<Vec<u32>>) {
    let places = |row: usize| &pattern.columns()[pattern.row(row)];
    let mut known: HashMap<&[u32], u32> = HashMap::new();
    let mut members: Vec<Vec<u32>> = Vec::new();
    let mut group_of: Vec<u32> = Vec::with_capacity(pattern.size());
    for row in 0..pattern.size() {
        let own = places(row);
        let alike = |&group: &u32| {
            let first = members[group as usize].first().map_or(&[][..], |&first| places(first as usize));
            common(own, first) as f64 >= ALIKE * own.len().max(first.len()) as f64
        };
        let before = &own[..own.partition_point(|&column| (column as usize) < row)];
        let near = before.iter().rev().take(COMPARED).map(|&column| group_of[column as usize]);
        let group = known.get(own).copied().or_else(|| near.clone().find(alike));
        let group = group.unwrap_or(members.len() as u32);
        if group as usize == members.len() {
            members.push(Vec::new());
            known.insert(own, group);
        }
        members[group as usize].push(row as u32);
        group_of.push(group);
    }
    let graph = Graph::of(members.iter().enumerate().map(|(own, rows)| {
        let others =
            rows.iter().flat_map(|&row| places(row as usize)).map(|&column| group_of[column as usize]);
        let mut others: Vec<u32> = others.filter(|&other| other as usize != own).collect();
        others.sort_unstable();
        others.dedup();
        (rows.len() as u32, others.into_iter().map(|other| (other, 1)).collect::<Vec<_>>())
    }));
    (graph, members)
}

/// Number of common entries of two ascending lists.
fn common(one: &[u32], other: &[u32]) -> usize {
    let mut rest = other.iter().peekable();
    one.iter()
        .filter(|&&number| {
            while rest.next_if(|&&other| other < number).is_some() {}
            rest.next_if_eq(&&number).is_some()
        })
        .count()
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
        let order = nested_dissection(&pattern, &Effort::THOROUGH);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted.iter().enumerate().all(|(index, &row)| row as usize == index));
        // The last separator is a cross-section near the middle.
        let strip = order.iter().rev().map(|&row| row as usize).filter(|&row| row < 2 * long * wide);
        let last: Vec<usize> = strip.take(6).map(|row| row / 2 / wide).collect();
        assert!(last.iter().all(|&x| x == last[0] && (20..40).contains(&x)), "{last:?}");
    }
}
