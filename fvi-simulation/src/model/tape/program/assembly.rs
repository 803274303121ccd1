//! Compilation of a graph to the plan of a program.

use super::{Kind, Plan, Row, Run, SHORT, SMALL, STRIDE, Single, WINDOW, Window, Work};
use crate::model::tape::graph::{Graph, Origin, Value};
use crate::model::tape::operation::Operation;
use fvi_scenario::language::expression::Function;
use std::collections::HashMap;

impl Plan {
    /// The plan of the program that computes `sums` and `entries` for q of length `coordinates`, and the
    /// constants for the first registers.
    pub(super) fn new(
        graph: &Graph,
        coordinates: usize,
        sums: &[(u32, Value)],
        entries: &[(u32, Value)],
    ) -> (Self, Vec<f64>) {
        let schedule = Schedule::new(graph, sums.iter().chain(entries).map(|&(_, value)| value));
        Assembly::new(graph, coordinates, &schedule).assemble(sums, entries)
    }
}

/// The operations to be computed, in windows, each in an order with long runs.
struct Schedule {
    windows: Vec<Vec<Value>>,
    /// Window of each computed value of the graph.
    window_of: Vec<Option<u32>>,
    /// Constant of each value whose operation forms a run with others of the same constant.
    constant_of: Vec<Option<Value>>,
}

impl Schedule {
    fn new(graph: &Graph, outputs: impl Iterator<Item = Value>) -> Self {
        let order = needed(graph, outputs);
        let mut window_of = vec![None; graph.len()];
        let mut level_of = vec![0_u32; graph.len()];
        let mut constant_of = vec![None; graph.len()];
        let mut windows = Vec::new();
        for (index, window) in order.chunks(WINDOW).enumerate() {
            let index = Some(u32::try_from(index).expect("fewer windows than values"));
            for &value in window {
                // Depth of a value within its window.
                let level = operands(graph, value)
                    .filter(|operand| window_of[operand.0 as usize] == index)
                    .map(|operand| level_of[operand.0 as usize] + 1)
                    .max();
                level_of[value.0 as usize] = level.unwrap_or(0);
                window_of[value.0 as usize] = index;
            }
            let kind = |value: Value| (level_of[value.0 as usize], operation(graph, value));
            let mut alike = HashMap::new();
            let candidates = if window.len() < SHORT { &[] } else { window };
            for &value in candidates {
                if let Some((constant, _)) = constant_and_other(graph, value) {
                    alike.entry((kind(value), constant)).or_insert_with(Vec::new).push(value);
                }
            }
            for ((_, constant), values) in alike {
                let many = values.len() >= SHORT;
                values.iter().for_each(|value| constant_of[value.0 as usize] = many.then_some(constant));
            }
            let mut window = window.to_vec();
            // Equal operations sorted by their operands: sines and cosines of the same numbers then match.
            window.sort_by_key(|&value| {
                let constant = constant_of[value.0 as usize];
                let first = match (constant, constant_and_other(graph, value)) {
                    (Some(_), Some((_, other))) => Some(other),
                    _ => operands(graph, value).next(),
                };
                (kind(value), constant, first)
            });
            windows.push(window);
        }
        if windows.is_empty() {
            windows.push(Vec::new());
        }
        Self { windows, window_of, constant_of }
    }
}

/// The constant and the other operand of a product or a sum with a constant.
fn constant_and_other(graph: &Graph, value: Value) -> Option<(Value, Value)> {
    let Origin::Computed(Operation::Multiply | Operation::Add, [left, right, _]) = graph.origin(value) else {
        return None;
    };
    match (graph.number(left), graph.number(right)) {
        (Some(_), None) => Some((left, right)),
        (None, Some(_)) => Some((right, left)),
        _ => None,
    }
}

/// The operations that the outputs need, each after its operands and as late as its first use allows.
fn needed(graph: &Graph, outputs: impl Iterator<Item = Value>) -> Vec<Value> {
    let mut order = Vec::new();
    let mut visited = vec![false; graph.len()];
    let mut pending: Vec<(Value, bool)> = Vec::new();
    for output in outputs {
        pending.push((output, false));
        while let Some((value, complete)) = pending.pop() {
            if complete {
                order.push(value);
            } else if !visited[value.0 as usize] && operation(graph, value).is_some() {
                visited[value.0 as usize] = true;
                pending.push((value, true));
                let first = pending.len();
                pending.extend(operands(graph, value).map(|operand| (operand, false)));
                pending[first..].reverse();
            }
        }
    }
    order
}

fn operation(graph: &Graph, value: Value) -> Option<Operation> {
    match graph.origin(value) {
        Origin::Computed(operation, _) => Some(operation),
        _ => None,
    }
}

fn operands(graph: &Graph, value: Value) -> impl Iterator<Item = Value> {
    let (operands, arity) = match graph.origin(value) {
        Origin::Computed(operation, operands) => (operands, operation.arity()),
        _ => ([Value(0); 3], 0),
    };
    operands.into_iter().take(arity)
}

/// Assigns registers to values and writes the plan.
struct Assembly<'a> {
    graph: &'a Graph,
    schedule: &'a Schedule,
    plan: Plan,
    constants: Vec<f64>,
    /// Register of each value of the graph for the whole program, if it has one.
    lasting: Vec<Option<u32>>,
    /// Register of each computed value during its window.
    passing: Vec<u32>,
}

impl<'a> Assembly<'a> {
    fn new(graph: &'a Graph, coordinates: usize, schedule: &'a Schedule) -> Self {
        Self {
            graph,
            schedule,
            plan: Plan { coordinates, ..Plan::default() },
            constants: Vec::new(),
            lasting: vec![None; graph.len()],
            passing: vec![0; graph.len()],
        }
    }

    fn assemble(mut self, sums: &[(u32, Value)], entries: &[(u32, Value)]) -> (Plan, Vec<f64>) {
        let schedule = self.schedule;
        self.place_constants(sums, entries);
        let first_lasting = self.inputs_end();
        let mut lasting = first_lasting;
        for value in schedule.windows.iter().flatten() {
            for operand in operands(self.graph, *value) {
                let home = schedule.window_of[operand.0 as usize];
                let place = &mut self.lasting[operand.0 as usize];
                if home.is_some() && home != schedule.window_of[value.0 as usize] && place.is_none() {
                    *place = Some(lasting);
                    lasting += 1;
                }
            }
        }
        let sums = self.by_window(sums);
        let entries = self.by_window(entries);
        for (index, window) in schedule.windows.iter().enumerate() {
            let runs = self.plan.runs.len();
            let exports = self.plan.exports.len();
            self.write_runs(window, lasting);
            for value in window {
                if let Some(to) = self.lasting[value.0 as usize] {
                    self.plan.exports.push((self.passing[value.0 as usize], to));
                }
            }
            let first = (self.plan.sums.len(), self.plan.entries.len());
            for &(place, value) in &sums[index] {
                let register = self.output(value);
                self.plan.sums.push((register, place));
            }
            for &(place, value) in &entries[index] {
                let register = self.output(value);
                self.plan.entries.push((register, place));
            }
            self.plan.windows.push(Window {
                runs: runs..self.plan.runs.len(),
                exports: exports..self.plan.exports.len(),
                sums: first.0..self.plan.sums.len(),
                entries: first.1..self.plan.entries.len(),
            });
        }
        for run in &mut self.plan.runs {
            run.row = Row::of(run, &self.plan.operands);
        }
        let longest = schedule.windows.iter().map(Vec::len).max().unwrap_or(0);
        self.plan.registers = lasting as usize + longest + (STRIDE - 1);
        self.plan.singles = self.singles().unwrap_or_default();
        (self.plan, self.constants)
    }

    /// The operations one by one, if runs have fewer than [`SHORT`] of them on average.
    fn singles(&self) -> Option<Vec<Single>> {
        let runs = &self.plan.runs;
        let operations: usize = runs.iter().map(|run| run.count).sum();
        let few = self.plan.windows.len() == 1 && self.plan.registers <= SMALL + (STRIDE - 1);
        if !few || operations >= SHORT * runs.len() {
            return None;
        }
        let singles: Option<Vec<_>> = runs.iter().map(|run| run.singles(&self.plan.operands)).collect();
        singles.map(|singles| self.join_products(singles.concat()))
    }

    /// Merges an operation of a function, or of a sine with its cosine, with the products by constants that
    /// are its only uses.
    fn join_products(&self, mut singles: Vec<Single>) -> Vec<Single> {
        let Plan { constants, sums, entries, .. } = &self.plan;
        let is_output =
            |register: u8| sums.iter().chain(entries).any(|&(output, _)| output == u32::from(register));
        // The only operation that reads a register, if it is a product with a constant, as its target and the
        // register of the constant.
        let product = |singles: &[Single], register: u8| {
            let mut readers = singles.iter().filter(|single| single.reads(register));
            let (reader, none) = (readers.next()?, readers.next());
            let constant = if reader.x == register { reader.y } else { reader.x };
            let is_product = matches!(reader.kind, Kind::Multiply) && usize::from(constant) < *constants;
            (is_product && none.is_none() && !is_output(register)).then_some((reader.target, constant))
        };
        let mut index = 0;
        while let Some(&Single { kind, target, other, .. }) = singles.get(index) {
            let joined = match (kind, product(&singles, target), product(&singles, target.wrapping_add(1))) {
                (Kind::Sine, Some((target, y)), _) => Some((Kind::SineBy, target, 1, y, y)),
                (Kind::Other, Some((target, y)), _) if matches!(other, Operation::Call(_)) => {
                    Some((Kind::OtherBy, target, 1, y, y))
                }
                (Kind::SineAndCosine, Some((target, y)), Some((next, z)))
                    if next == target.wrapping_add(1) =>
                {
                    Some((Kind::SineAndCosineBy, target, 2, y, z))
                }
                _ => None,
            };
            if let Some((kind, target, count, y, z)) = joined {
                let products = target..=target.wrapping_add(count - 1);
                singles[index] = Single { kind, target, y, z, ..singles[index] };
                let mut place = 0;
                singles.retain(|single| {
                    place += 1;
                    place <= index + 1 || !products.contains(&single.target)
                });
            }
            index += 1;
        }
        singles
    }

    /// The register after the constants, the times and the coordinates.
    fn inputs_end(&self) -> u32 {
        let count = self.plan.first_variable() + self.plan.coordinates;
        u32::try_from(count).expect("fewer registers than 2³²")
    }

    /// Assigns registers to the constants that occur, to the times and to the variables.
    fn place_constants(&mut self, sums: &[(u32, Value)], entries: &[(u32, Value)]) {
        let graph = self.graph;
        let computed = self.schedule.windows.iter().flatten().flat_map(|&value| operands(graph, value));
        let outputs = sums.iter().chain(entries).map(|&(_, value)| value);
        let used: Vec<Value> = computed.chain(outputs).collect();
        for &value in &used {
            if let Some(number) = graph.number(value)
                && self.lasting[value.0 as usize].is_none()
            {
                let place = u32::try_from(self.constants.len()).expect("fewer constants than values");
                self.lasting[value.0 as usize] = Some(place);
                self.constants.push(number);
            }
        }
        self.plan.constants = self.constants.len();
        let time = u32::try_from(self.plan.constants).expect("fewer constants than values");
        for &value in &used {
            let place = match graph.origin(value) {
                Origin::Time => time,
                Origin::SidedTime => time + 1,
                Origin::Variable(index) => time + 2 + index,
                Origin::Constant(_) | Origin::Computed(..) => continue,
            };
            self.lasting[value.0 as usize] = Some(place);
        }
    }

    /// The outputs by the window in which they are computed; outputs that are inputs are in the first.
    fn by_window(&self, outputs: &[(u32, Value)]) -> Vec<Vec<(u32, Value)>> {
        let mut sorted = vec![Vec::new(); self.schedule.windows.len()];
        for &(place, value) in outputs {
            sorted[self.schedule.window_of[value.0 as usize].unwrap_or(0) as usize].push((place, value));
        }
        sorted
    }

    /// Register of an output at the end of its window.
    fn output(&self, value: Value) -> u32 {
        match self.schedule.window_of[value.0 as usize] {
            Some(_) => self.passing[value.0 as usize],
            None => self.lasting[value.0 as usize].unwrap_or(0),
        }
    }

    fn write_runs(&mut self, window: &[Value], first: u32) {
        let home = window.first().and_then(|value| self.schedule.window_of[value.0 as usize]);
        let first_run = self.plan.runs.len();
        let mut target = first;
        let mut constant_of_run = None;
        for &value in window {
            let Origin::Computed(operation, mut all) = self.graph.origin(value) else { continue };
            let constant = self.schedule.constant_of[value.0 as usize];
            if let (Some(_), Some((constant, other))) = (constant, constant_and_other(self.graph, value)) {
                (all[0], all[1]) = (other, constant);
            }
            let goes_on = std::mem::replace(&mut constant_of_run, constant) == constant;
            let start = self.plan.operands.len();
            let mut latest = 0;
            for operand in &all[..operation.arity()] {
                let index = operand.0 as usize;
                let register = if home.is_some() && self.schedule.window_of[index] == home {
                    self.passing[index]
                } else {
                    self.lasting[index].unwrap_or(0)
                };
                latest = latest.max(register);
                self.plan.operands.push(register);
            }
            // The run is extended, unless the operation reads a result of the run.
            match self.plan.runs[first_run..].last_mut() {
                Some(run)
                    if run.work == Work::One(operation) && goes_on && (latest as usize) < run.target =>
                {
                    run.count += 1
                }
                // The next term of a sum: it is added to the last result.
                Some(run)
                    if operation == Operation::Add
                        && self.plan.operands[start] + 1 == target
                        && (run.work == Work::RunningSum
                            || run.work == Work::One(Operation::Add) && run.count == 1) =>
                {
                    run.work = Work::RunningSum;
                    run.count += 1;
                }
                _ => self.plan.runs.push(Run {
                    work: Work::One(operation),
                    target: target as usize,
                    count: 1,
                    operands: start,
                    row: None,
                }),
            }
            self.passing[value.0 as usize] = target;
            target += 1;
        }
        self.join_sines_and_cosines(first_run);
    }

    /// Merges two runs in which cosines follow sines of the same numbers.
    fn join_sines_and_cosines(&mut self, first_run: usize) {
        let operands = &self.plan.operands;
        let read = |run: &Run| &operands[run.operands..run.operands + run.count];
        let runs = self.plan.runs.split_off(first_run);
        for run in runs {
            match self.plan.runs[first_run..].last_mut() {
                Some(last)
                    if last.work == Work::One(Operation::Call(Function::Sin))
                        && run.work == Work::One(Operation::Call(Function::Cos))
                        && read(last) == read(&run) =>
                {
                    last.work = Work::SineAndCosine;
                }
                _ => self.plan.runs.push(run),
            }
        }
    }
}
