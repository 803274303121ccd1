//! The registry of output columns: numbers of a run at each grid point in addition to t, q, p, energy and
//! derivatives.

use fvi_scenario::scenario::Scenario;
use std::ops::Range;

/// Source of the numbers of some columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The controllers, as of their last sample up to the time of the row.
    Controllers,
    /// The memories of damping.
    Memories,
    /// The constraints of a mechanism.
    Constraints,
}

/// Quantities of each member of a source.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Group {
    source: Source,
    quantities: &'static [&'static str],
    members: usize,
}

/// The columns of a run, in the order of their numbers in a state: source by source, member by member, with
/// the quantities of a member side by side.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Columns {
    groups: Vec<Group>,
}

/// One quantity for all members of its source: an array in `trajectory.npz` and in Python.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quantity {
    /// Its name.
    pub name: &'static str,
    /// Number of members.
    pub members: usize,
    first: usize,
    stride: usize,
}

impl Quantity {
    /// Its numbers, one for each member, among the numbers of all columns.
    pub fn of<'a>(&self, columns: &'a [f64]) -> impl Iterator<Item = f64> + use<'a> {
        columns.iter().skip(self.first).step_by(self.stride).take(self.members).copied()
    }
}

impl Columns {
    /// The columns of a scenario. **The registry**: a new column is a line here and a line in `motion.rs`
    /// that writes its numbers.
    pub fn of(scenario: &Scenario) -> Self {
        let group = |source, quantities, members| Group { source, quantities, members };
        let memories = usize::from(scenario.output.memory_energy);
        let constraints = scenario.system.constraints.len();
        let mut groups = vec![
            group(Source::Constraints, &["lambda"], constraints),
            group(Source::Controllers, &["u", "setpoint", "measure"], scenario.controllers.len()),
            group(Source::Memories, &["memory_stored", "memory_dissipated"], memories),
        ];
        groups.retain(|group| group.members > 0);
        Self { groups }
    }

    /// Number of columns.
    pub fn len(&self) -> usize {
        self.groups.iter().map(|group| group.quantities.len() * group.members).sum()
    }

    /// True if there are no columns.
    pub fn is_empty(&self) -> bool {
        self.groups.is_empty()
    }

    /// The quantities, in the order of the first appearance of their names.
    pub fn quantities(&self) -> impl Iterator<Item = Quantity> {
        let mut begin = 0;
        self.groups.iter().flat_map(move |group| {
            let (first, stride) = (begin, group.quantities.len());
            begin += stride * group.members;
            let quantity = move |(place, &name): (usize, &&'static str)| Quantity {
                name,
                members: group.members,
                first: first + place,
                stride,
            };
            group.quantities.iter().enumerate().map(quantity)
        })
    }

    /// The heading of each column in `trajectory.csv`: the name of its quantity, followed by the index of the
    /// member if there are several, and for multipliers always.
    pub fn headings(&self) -> Vec<String> {
        let of_group = |group: &Group| -> Vec<String> {
            let of_member = |member: usize| {
                let is_alone = group.members == 1 && group.source != Source::Constraints;
                group.quantities.iter().map(move |name| match is_alone {
                    true => (*name).to_owned(),
                    false => format!("{name}{member}"),
                })
            };
            (0..group.members).flat_map(of_member).collect()
        };
        self.groups.iter().flat_map(of_group).collect()
    }

    /// The range of a source's columns; empty if it has none.
    pub fn places(&self, source: Source) -> Range<usize> {
        let mut begin = 0;
        for group in &self.groups {
            let end = begin + group.quantities.len() * group.members;
            if group.source == source {
                return begin..end;
            }
            begin = end;
        }
        begin..begin
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headings_quantities_and_places_agree() {
        let group = |source, quantities, members| Group { source, quantities, members };
        let columns = Columns {
            groups: vec![
                group(Source::Controllers, &["u", "setpoint", "measure"], 2),
                group(Source::Memories, &["memory_stored", "memory_dissipated"], 1),
            ],
        };
        let headings = columns.headings();
        let expected = [
            "u0",
            "setpoint0",
            "measure0",
            "u1",
            "setpoint1",
            "measure1",
            "memory_stored",
            "memory_dissipated",
        ];
        assert_eq!(headings, expected);
        assert_eq!(
            (columns.len(), columns.places(Source::Controllers), columns.places(Source::Memories)),
            (8, 0..6, 6..8)
        );
        let row: Vec<f64> = (0..8).map(f64::from).collect();
        for quantity in columns.quantities() {
            let found: Vec<String> =
                quantity.of(&row).map(|place| headings[place as usize].clone()).collect();
            let expected: Vec<String> = match quantity.members {
                1 => vec![quantity.name.to_owned()],
                members => (0..members).map(|member| format!("{}{member}", quantity.name)).collect(),
            };
            assert_eq!(found, expected);
        }
        assert!(Columns::default().is_empty() && Columns::default().quantities().next().is_none());
    }
}
