//! Evaluation of a program at several points at once.
//!
//! The interpreter dispatches an operation once for all points.

use super::{Plan, Program, Run, Work};
use crate::model::tape::operation::{Operation, scale};
use fvi_scenario::language::expression::{Elementary, Function};

/// Number of points evaluated together.
pub(in crate::model) const LANES: usize = 16;

/// A number for each of these points.
pub(in crate::model) type Lanes<T> = [T; LANES];

/// Registers of one program at several points.
#[derive(Clone, Debug)]
pub(in crate::model) struct LaneRegisters<T>(Vec<Lanes<T>>);

impl<T> Default for LaneRegisters<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T: Elementary> Program<T> {
    /// The first of the `sums` of [`evaluate`](Self::evaluate) at t = 0, at several points, with the same
    /// bits as one by one.
    ///
    /// `place` writes the variables. `registers` must be new or have been used for this program only.
    pub(in crate::model::tape) fn first_sum_along(
        &self,
        registers: &mut LaneRegisters<T>,
        place: impl FnOnce(&mut [Lanes<T>]),
    ) -> Lanes<T> {
        let registers = &mut registers.0;
        if registers.is_empty() {
            registers.resize(self.plan.registers, [T::zero(); LANES]);
            for (register, &constant) in registers.iter_mut().zip(&self.constants) {
                *register = [constant; LANES];
            }
        }
        let variables = self.plan.first_variable();
        place(&mut registers[variables..variables + self.plan.coordinates]);
        #[cfg(target_arch = "x86_64")]
        if let Some(wide) = pulp::x86::V3::try_new() {
            return wide.vectorize(Execute { plan: &self.plan, registers });
        }
        self.plan.execute_along(registers)
    }
}

impl Plan {
    #[inline(always)]
    fn execute_along<T: Elementary>(&self, registers: &mut [Lanes<T>]) -> Lanes<T> {
        let mut sum = [T::zero(); LANES];
        for window in &self.windows {
            for run in &self.runs[window.runs.clone()] {
                run.evaluate_along(registers, &self.operands[run.operands..]);
            }
            for &(from, to) in &self.exports[window.exports.clone()] {
                registers[to as usize] = registers[from as usize];
            }
            for &(from, _) in &self.sums[window.sums.clone()] {
                add(&mut sum, &registers[from as usize]);
            }
        }
        sum
    }
}

/// Executes a plan on prepared registers, compiled for the vector unit of the caller.
#[cfg(target_arch = "x86_64")]
struct Execute<'a, T> {
    plan: &'a Plan,
    registers: &'a mut [Lanes<T>],
}

#[cfg(target_arch = "x86_64")]
impl<T: Elementary> pulp::NullaryFnOnce for Execute<'_, T> {
    type Output = Lanes<T>;

    #[inline(always)]
    fn call(self) -> Lanes<T> {
        self.plan.execute_along(self.registers)
    }
}

#[inline(always)]
fn add<T: Elementary, const L: usize>(sum: &mut [T; L], terms: &[T; L]) {
    sum.iter_mut().zip(terms).for_each(|(sum, &term)| *sum += term);
}

impl Run {
    /// Evaluates the run at L points.
    #[inline(always)]
    pub(super) fn evaluate_along<T: Elementary, const L: usize>(
        &self,
        registers: &mut [[T; L]],
        operands: &[u32],
    ) {
        if self.work == Work::RunningSum {
            let pairs = &operands.as_chunks::<2>().0[..self.count];
            let Some(&[first, _]) = pairs.first() else { return };
            let mut sum = registers[first as usize];
            for (place, &[_, term]) in (self.target..).zip(pairs) {
                add(&mut sum, &registers[term as usize]);
                registers[place] = sum;
            }
            return;
        }
        // Operands of a run were computed before: their registers precede those of the results.
        let (known, new) = registers.split_at_mut(self.target);
        let operation = match self.work {
            Work::One(operation) => operation,
            Work::SineAndCosine => {
                let (sines, cosines) = new.split_at_mut(self.count);
                for ((sines, cosines), &x) in sines.iter_mut().zip(cosines).zip(operands) {
                    let places = sines.iter_mut().zip(cosines);
                    for ((sine, cosine), x) in places.zip(known[x as usize]) {
                        (*sine, *cosine) = x.sine_cosine();
                    }
                }
                return;
            }
            Work::RunningSum => return,
        };
        let new = &mut new[..self.count];
        match operation {
            Operation::Negate => unary(known, new, operands, |x| -x),
            Operation::Add => binary(known, new, operands, |x, y| x + y),
            Operation::Subtract => binary(known, new, operands, |x, y| x - y),
            Operation::Multiply => binary(known, new, operands, |x, y| x * y),
            Operation::Divide => binary(known, new, operands, |x, y| x / y),
            Operation::Scale => binary(known, new, operands, scale),
            Operation::Call(Function::Sin) => unary(known, new, operands, T::sine),
            Operation::Call(Function::Cos) => unary(known, new, operands, T::cosine),
            Operation::Call(Function::Exp) => unary(known, new, operands, T::exponential),
            other => match other.arity() {
                1 => unary(known, new, operands, |x| other.of([x, x, x])),
                2 => binary(known, new, operands, |x, y| other.of([x, y, y])),
                _ => {
                    for (new, &[x, y, z]) in new.iter_mut().zip(operands.as_chunks().0) {
                        let read = known[x as usize].iter().zip(&known[y as usize]).zip(&known[z as usize]);
                        for (new, ((&x, &y), &z)) in new.iter_mut().zip(read) {
                            *new = other.of([x, y, z]);
                        }
                    }
                }
            },
        }
    }
}

#[inline(always)]
fn unary<T: Copy, const L: usize>(
    known: &[[T; L]],
    new: &mut [[T; L]],
    operands: &[u32],
    of: impl Fn(T) -> T,
) {
    for (new, &x) in new.iter_mut().zip(operands) {
        for (new, &x) in new.iter_mut().zip(&known[x as usize]) {
            *new = of(x);
        }
    }
}

#[inline(always)]
fn binary<T: Copy, const L: usize>(
    known: &[[T; L]],
    new: &mut [[T; L]],
    operands: &[u32],
    of: impl Fn(T, T) -> T,
) {
    for (new, &[x, y]) in new.iter_mut().zip(operands.as_chunks().0) {
        let read = known[x as usize].iter().zip(&known[y as usize]);
        for (new, (&x, &y)) in new.iter_mut().zip(read) {
            *new = of(x, y);
        }
    }
}
