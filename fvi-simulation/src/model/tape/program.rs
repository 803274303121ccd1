//! A graph as a program: straight-line code in which equal operations are consecutive.
//!
//! The values that the outputs need are ordered, each after its operands and close to its use, and divided
//! into windows. Within a window, independent operations are sorted by kind, so that the interpreter
//! dispatches once for a whole run of equal operations. The values of a window are stored in registers that
//! every window reuses, few enough to stay in the fastest cache; only values needed by later windows are
//! copied to registers of their own.

mod assembly;
mod lanes;

pub(in crate::model) use lanes::{LANES, LaneRegisters};

use super::graph::{Graph, Value};
use super::operation::{Operation, scale};
use core::ops::Range;
use fvi_scenario::language::expression::{Elementary, Function, Moment};

/// Operations in a window: their values take 8 KB in double precision.
const WINDOW: usize = 1024;

/// Length of a run from which its preparation is worth while, and number of operations with a common constant
/// that form a run.
const SHORT: usize = 4;

/// Largest number of registers of a program that is interpreted operation by operation.
const SMALL: usize = 64;

/// Length of its register file: an index of eight bits needs no bounds check.
const ALL_OF_A_BYTE: usize = 256;

/// Numbers of a row processed at a time. Numbers beyond the end of a run are computed too, and overwritten.
const STRIDE: usize = 8;

/// A program with inputs t and q and two lists of outputs.
#[derive(Clone, Debug)]
pub(super) struct Program<T> {
    constants: Vec<T>,
    plan: Plan,
}

/// The operations of a program, independent of the scalar type.
///
/// The registers hold, in this order, the constants, t, the sided t, q, values needed across windows, and the
/// values of the current window.
#[derive(Clone, Debug, Default)]
struct Plan {
    /// Number of constants.
    constants: usize,
    coordinates: usize,
    registers: usize,
    windows: Vec<Window>,
    runs: Vec<Run>,
    /// The operations of all runs one by one, if the runs are too short for their preparation and the
    /// registers are few; empty otherwise.
    singles: Vec<Single>,
    /// The registers read by the runs, operation by operation.
    operands: Vec<u32>,
    /// (from, to) of the values needed by later windows.
    exports: Vec<(u32, u32)>,
    /// (register, place in the output) of the outputs that are added.
    sums: Vec<(u32, u32)>,
    /// The same for the outputs that are set.
    entries: Vec<(u32, u32)>,
}

/// Equal operations whose results are in neighbouring registers.
#[derive(Clone, Debug)]
struct Run {
    work: Work,
    target: usize,
    count: usize,
    operands: usize,
    /// The run as an operation on rows, if possible.
    row: Option<Row>,
}

/// Equal operations on numbers in neighbouring registers, as vectors.
#[derive(Clone, Copy, Debug)]
struct Row {
    kind: RowKind,
    count: u32,
    target: u32,
    /// First register of the left operands, and of the right ones; operations on one operand use the left.
    left: u32,
    right: u32,
}

/// Operation of a row. `By` and `Of` variants have one number as the operand on one side, the right one for
/// `By` and the left one for `Of`.
#[derive(Clone, Copy, Debug)]
enum RowKind {
    Negate,
    Add,
    AddBy,
    AddOf,
    Subtract,
    SubtractBy,
    SubtractOf,
    Multiply,
    MultiplyBy,
    MultiplyOf,
    Scale,
    ScaleBy,
    ScaleOf,
}

/// Registers of the operands of a run on one side of its operations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Places {
    /// Neighbouring registers from this one on.
    Row(u32),
    /// The same register for all.
    One(u32),
}

impl Places {
    fn of(mut registers: impl Iterator<Item = u32> + Clone) -> Option<Self> {
        let first = registers.clone().next()?;
        if registers.clone().zip(first..).all(|(register, next)| register == next) {
            Some(Self::Row(first))
        } else if registers.all(|register| register == first) {
            Some(Self::One(first))
        } else {
            None
        }
    }
}

impl Row {
    /// The run as a row, if its operands are arranged suitably.
    fn of(run: &Run, operands: &[u32]) -> Option<Self> {
        use RowKind as R;
        let Work::One(operation) = run.work else { return None };
        let [rows, by, of] = match operation {
            Operation::Negate => [R::Negate; 3],
            Operation::Add => [R::Add, R::AddBy, R::AddOf],
            Operation::Subtract => [R::Subtract, R::SubtractBy, R::SubtractOf],
            Operation::Multiply => [R::Multiply, R::MultiplyBy, R::MultiplyOf],
            Operation::Scale => [R::Scale, R::ScaleBy, R::ScaleOf],
            _ => return None,
        };
        let arity = operation.arity();
        let read = operands[run.operands..][..arity * run.count].iter().copied();
        let left = Places::of(read.clone().step_by(arity))?;
        let right = Places::of(read.skip(arity - 1).step_by(arity))?;
        let (kind, left, right) = match (left, right) {
            (Places::Row(left), Places::Row(right)) => (rows, left, right),
            (Places::Row(left), Places::One(right)) => (by, left, right),
            (Places::One(left), Places::Row(right)) => (of, left, right),
            (Places::One(_), Places::One(_)) => return None,
        };
        let narrow = |number: usize| u32::try_from(number).ok();
        Some(Self { kind, count: narrow(run.count)?, target: narrow(run.target)?, left, right })
    }

    #[inline(always)]
    fn evaluate<T: Elementary>(&self, registers: &mut [T]) {
        match self.kind {
            RowKind::Negate => self.rows(registers, |x, _| -x),
            RowKind::Add => self.rows(registers, |x, y| x + y),
            RowKind::AddBy => self.by(registers, |x, y| x + y),
            RowKind::AddOf => self.of_one(registers, |x, y| x + y),
            RowKind::Subtract => self.rows(registers, |x, y| x - y),
            RowKind::SubtractBy => self.by(registers, |x, y| x - y),
            RowKind::SubtractOf => self.of_one(registers, |x, y| x - y),
            RowKind::Multiply => self.rows(registers, |x, y| x * y),
            RowKind::MultiplyBy => self.by(registers, |x, y| x * y),
            RowKind::MultiplyOf => self.of_one(registers, |x, y| x * y),
            RowKind::Scale => self.rows(registers, scale),
            RowKind::ScaleBy => self.by(registers, scale),
            RowKind::ScaleOf => self.of_one(registers, scale),
        }
    }

    #[inline(always)]
    fn rows<T: Copy>(&self, registers: &mut [T], of: impl Fn(T, T) -> T) {
        self.put(registers, |registers, start| {
            let x = at(registers, self.left, start)?;
            let y = at(registers, self.right, start)?;
            Some(core::array::from_fn(|index| of(x[index], y[index])))
        });
    }

    #[inline(always)]
    fn by<T: Copy>(&self, registers: &mut [T], of: impl Fn(T, T) -> T) {
        let Some(&y) = registers.get(self.right as usize) else { return };
        self.put(registers, |registers, start| Some(at(registers, self.left, start)?.map(|x| of(x, y))));
    }

    #[inline(always)]
    fn of_one<T: Copy>(&self, registers: &mut [T], of: impl Fn(T, T) -> T) {
        let Some(&x) = registers.get(self.left as usize) else { return };
        self.put(registers, |registers, start| Some(at(registers, self.right, start)?.map(|y| of(x, y))));
    }

    /// Writes the values of the row, several at a time; `values` computes those from an index on.
    #[inline(always)]
    fn put<T: Copy>(&self, registers: &mut [T], values: impl Fn(&[T], u32) -> Option<[T; STRIDE]>) {
        let mut start = 0;
        while start < self.count {
            // Separate checks: combined ones would pass the values through the stack.
            let Some(values) = values(registers, start) else { return };
            let target = self.target as usize + start as usize;
            let Some(places) = registers.get_mut(target..target + STRIDE) else { return };
            let Some(places) = places.first_chunk_mut() else { return };
            *places = values;
            start += STRIDE as u32;
        }
    }
}

/// Numbers from a register on.
#[inline(always)]
fn at<T: Copy>(registers: &[T], first: u32, start: u32) -> Option<[T; STRIDE]> {
    let place = first as usize + start as usize;
    registers.get(place..place + STRIDE)?.first_chunk().copied()
}

/// One operation of a run.
#[derive(Clone, Copy, Debug)]
struct Single {
    kind: Kind,
    target: u8,
    /// The registers of its operands; repetitions beyond the arity.
    x: u8,
    y: u8,
    z: u8,
    /// Operation of [`Kind::Other`].
    other: Operation,
}

/// Kind of an operation, for dispatch; the most frequent operations have separate kinds.
#[derive(Clone, Copy, Debug)]
enum Kind {
    Negate,
    Add,
    Subtract,
    Multiply,
    Scale,
    Sine,
    SineAndCosine,
    /// The product of a sine and the number at y.
    SineBy,
    /// The product of another function and the number at y.
    OtherBy,
    /// The products of a sine and the number at y, and of the cosine and the number at z.
    SineAndCosineBy,
    Other,
}

impl Kind {
    fn of(work: Work) -> Self {
        match work {
            Work::One(Operation::Negate) => Self::Negate,
            Work::One(Operation::Add) | Work::RunningSum => Self::Add,
            Work::One(Operation::Subtract) => Self::Subtract,
            Work::One(Operation::Multiply) => Self::Multiply,
            Work::One(Operation::Scale) => Self::Scale,
            Work::One(Operation::Call(Function::Sin)) => Self::Sine,
            Work::One(_) => Self::Other,
            Work::SineAndCosine => Self::SineAndCosine,
        }
    }
}

/// Computation of a run for each of its operands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Work {
    One(Operation),
    /// Sines, followed by the cosines of the same numbers: argument reduction is half the work.
    SineAndCosine,
    /// Partial sums, each of which adds a number to the previous one: the terms of a long sum.
    RunningSum,
}

#[derive(Clone, Debug)]
struct Window {
    runs: Range<usize>,
    exports: Range<usize>,
    sums: Range<usize>,
    entries: Range<usize>,
}

impl<T: Elementary> Program<T> {
    /// The program that computes `sums` and `entries` (see [`evaluate`](Self::evaluate)) for q of length
    /// `coordinates`.
    pub(super) fn new(
        graph: &Graph,
        coordinates: usize,
        sums: &[(u32, Value)],
        entries: &[(u32, Value)],
    ) -> Self {
        let (plan, constants) = Plan::new(graph, coordinates, sums, entries);
        let constants: Vec<T> = constants.into_iter().map(T::of).collect();
        Self { constants, plan }
    }

    /// Number of operations of an evaluation, sums included.
    #[cfg(test)]
    pub(super) fn operations(&self) -> usize {
        self.plan.runs.iter().map(|run| run.count).sum::<usize>() + self.plan.sums.len()
    }

    /// True if outputs for the same place of `sums` are added in the given order.
    pub(super) fn keeps_the_order_of_sums(&self) -> bool {
        self.plan.windows.len() == 1
    }

    /// Adds the first outputs to `sums` and writes the others to `entries`.
    ///
    /// `registers` is scratch: its contents are arbitrary, and it grows if it is too small.
    pub(super) fn evaluate(
        &self,
        moment: Moment<T>,
        position: &[T],
        registers: &mut Vec<T>,
        sums: &mut [T],
        entries: &mut [T],
    ) {
        let room = self.plan.room();
        if registers.len() < room {
            registers.resize(room, T::zero());
        }
        let (constants, others) = registers.split_at_mut(self.constants.len());
        copy(constants, &self.constants);
        if let [time, sided, ..] = others {
            (*time, *sided) = (moment.time, moment.sided);
        }
        self.plan.execute(registers, position, sums, |place, value| entries[place] = value);
    }

    /// As [`evaluate`](Self::evaluate) at t = 0, except that each entry is added to the values of a matrix at
    /// its slot, and at that of its mirror image if it has another. The registers must be new or have been
    /// used for this program only: they contain its constants.
    pub(super) fn evaluate_again(
        &self,
        registers: &mut OwnRegisters<T>,
        position: &[T],
        sums: &mut [T],
        (slots, values): (&[(u32, u32)], &mut [T]),
    ) {
        let registers = &mut registers.0;
        if registers.is_empty() {
            self.prepare(registers);
        }
        self.plan.execute(registers, position, sums, |place, value| {
            let (slot, mirrored) = slots[place];
            values[slot as usize] += value;
            if slot != mirrored {
                values[mirrored as usize] += value;
            }
        });
    }

    #[cold]
    fn prepare(&self, registers: &mut Vec<T>) {
        registers.resize(self.plan.room(), T::zero());
        registers[..self.constants.len()].copy_from_slice(&self.constants);
    }
}

impl Plan {
    /// The register after the constants and the two times.
    fn first_variable(&self) -> usize {
        self.constants + 2
    }

    /// Number of registers for an evaluation.
    fn room(&self) -> usize {
        if self.singles.is_empty() { self.registers } else { ALL_OF_A_BYTE }
    }

    /// Evaluates at a position, with constants and time already in their registers.
    #[inline(always)]
    fn execute<T: Elementary>(
        &self,
        registers: &mut [T],
        position: &[T],
        sums: &mut [T],
        mut set: impl FnMut(usize, T),
    ) {
        let variables = self.first_variable();
        copy(&mut registers[variables..variables + self.coordinates], position);
        if !self.singles.is_empty() {
            let Some(registers) = registers.first_chunk_mut::<ALL_OF_A_BYTE>() else { return };
            self.singles.iter().for_each(|single| single.evaluate(registers));
            return hand_out(registers, (&self.sums, sums), (&self.entries, &mut set));
        }
        self.execute_windows(registers, sums, set);
    }

    // Out of line, so that its registers do not burden programs with few operations.
    #[inline(never)]
    fn execute_windows<T: Elementary>(
        &self,
        registers: &mut [T],
        sums: &mut [T],
        mut set: impl FnMut(usize, T),
    ) {
        for window in &self.windows {
            for run in &self.runs[window.runs.clone()] {
                match &run.row {
                    Some(row) => row.evaluate(registers),
                    None => run.evaluate(registers, &self.operands[run.operands..]),
                }
            }
            for &(from, to) in &self.exports[window.exports.clone()] {
                registers[to as usize] = registers[from as usize];
            }
            let (added, written) = (&self.sums[window.sums.clone()], &self.entries[window.entries.clone()]);
            hand_out(registers, (added, sums), (written, &mut set));
        }
    }
}

/// Registers used for one program only.
#[derive(Clone, Debug)]
pub(in crate::model) struct OwnRegisters<T>(Vec<T>);

impl<T> Default for OwnRegisters<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

/// Adds registers to sums, and calls `set` with others.
#[inline(always)]
fn hand_out<T: Elementary>(
    registers: &[T],
    (added, sums): (&[(u32, u32)], &mut [T]),
    (written, set): (&[(u32, u32)], &mut impl FnMut(usize, T)),
) {
    for &(from, to) in added {
        sums[to as usize] += registers[from as usize];
    }
    for &(from, to) in written {
        set(to as usize, registers[from as usize]);
    }
}

/// Copies numbers to a place of the same length.
#[inline(always)]
fn copy<T: Copy>(place: &mut [T], numbers: &[T]) {
    if numbers.len() > 8 {
        return place.copy_from_slice(numbers);
    }
    // A call of the platform's copy takes longer than copying a few numbers.
    let ((fours, place), (of_fours, numbers)) = (place.as_chunks_mut::<4>(), numbers.as_chunks::<4>());
    for (four, &numbers) in fours.iter_mut().zip(of_fours) {
        *four = numbers;
        core::hint::black_box(());
    }
    for (place, &number) in place.iter_mut().zip(numbers) {
        *place = number;
        core::hint::black_box(());
    }
}

impl Single {
    fn new(work: Work, target: u32, read: &[u32]) -> Option<Self> {
        let narrow = |register: u32| u8::try_from(register).ok();
        let operand = |index: usize| narrow(read[index.min(read.len() - 1)]);
        let other = match work {
            Work::One(operation) => operation,
            Work::SineAndCosine | Work::RunningSum => Operation::Add,
        };
        let [x, y, z] = [operand(0)?, operand(1)?, operand(2)?];
        Some(Self { kind: Kind::of(work), target: narrow(target)?, x, y, z, other })
    }

    fn reads(&self, register: u8) -> bool {
        [self.x, self.y, self.z].contains(&register)
    }

    #[inline(always)]
    fn evaluate<T: Elementary>(&self, registers: &mut [T; ALL_OF_A_BYTE]) {
        let (x, y) = (registers[usize::from(self.x)], registers[usize::from(self.y)]);
        registers[usize::from(self.target)] = match self.kind {
            Kind::Negate => -x,
            Kind::Add => x + y,
            Kind::Subtract => x - y,
            Kind::Multiply => x * y,
            Kind::Scale => scale(x, y),
            Kind::Sine => x.sine(),
            Kind::Other => self.other.of([x, y, registers[usize::from(self.z)]]),
            Kind::SineAndCosine => {
                let (sine, cosine) = x.sine_cosine();
                registers[usize::from(self.target.wrapping_add(1))] = cosine;
                sine
            }
            Kind::SineBy => x.sine() * y,
            Kind::OtherBy => self.other.of([x, x, x]) * y,
            Kind::SineAndCosineBy => {
                let (sine, cosine) = x.sine_cosine();
                let other = cosine * registers[usize::from(self.z)];
                registers[usize::from(self.target.wrapping_add(1))] = other;
                sine * y
            }
        };
    }
}

impl Run {
    /// Its operations one by one, if it has at most one pair of a sine and a cosine.
    fn singles(&self, operands: &[u32]) -> Option<Vec<Single>> {
        let arity = match self.work {
            Work::One(operation) => operation.arity(),
            Work::RunningSum => 2,
            Work::SineAndCosine if self.count == 1 => 1,
            // All sines come before the first cosine.
            Work::SineAndCosine => return None,
        };
        let operands = operands[self.operands..].chunks_exact(arity).take(self.count);
        let targets = u32::try_from(self.target).ok()?..;
        operands.zip(targets).map(|(read, target)| Single::new(self.work, target, read)).collect()
    }

    // Out of line, so that it does not occupy the registers of the rows.
    #[inline(never)]
    fn evaluate<T: Elementary>(&self, registers: &mut [T], operands: &[u32]) {
        self.evaluate_along(registers.as_chunks_mut::<1>().0, operands);
    }
}
