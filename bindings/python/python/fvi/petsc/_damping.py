"""Damping terms: the memory of a rank's own rows or dampers, and the forces from its derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from petsc4py import PETSc

from fvi._errors import InputError
from fvi._kernel import Kernel
from fvi._memory import Memory
from fvi._types import FloatArray, Precision
from fvi.petsc._arguments import Layout, Term, check_symmetric

SIDE_BY_SIDE = 96
"""Channels from which on a memory keeps them side by side, so that they can be divided among ranks anew; ranks with fewer have
channels that stay zero."""


class Kernels(NamedTuple):
    """Settings common to all memories of a run."""

    step: float
    order: int
    length: int
    tolerance: float | None
    states: Precision | None
    threads: int


def memory_of(term: Term, kernels: Kernels, channels: int) -> Memory:
    """The memory of a term on this rank; the only place that chooses its kernel."""
    try:
        return Memory(
            kernel=term.kernel,
            step=kernels.step,
            order=kernels.order,
            channels=max(channels, SIDE_BY_SIDE),
            length=kernels.length,
            engine="exponential-sum",
            samples="differences",
            tolerance=kernels.tolerance,
            states=kernels.states,
            threads=kernels.threads,
        )
    except InputError as error:
        if error.key == "engine":
            key = f"{term.place}.{term.key_of_kernel}"
            message = f"{key}: ranks need a memory of exponentials, which this kernel does not have: {error}"
            raise InputError(message, key, repr(term.kernel)) from None
        raise


class Rows:
    """Channels that are rows: the force ρ D, one channel for each row of ρ on this rank that is not empty."""

    def __init__(self, term: Term, layout: Layout, vector: Any, probes: tuple[Any, Any]) -> None:
        name, self.matrix = f"{term.place}.coefficient", None
        given = term.coefficient
        if isinstance(given, PETSc.Mat):
            self.matrix, self.scratch = given, vector.duplicate()
            self.norm = check_symmetric(name, given, probes, "positive semidefinite")
            numbers = vector.duplicate()
            given.getDiagonal(numbers)
            diagonal: FloatArray = numbers.getArray()
            self.diagonal: FloatArray = np.empty(0)
            self.rows = _rows_that_are_not_empty(given)
            alone = np.arange(0) if self.rows is None else self.rows[diagonal[self.rows] == 0.0]
            self.rows = np.arange(layout.count) if self.rows is None else self.rows
        else:
            diagonal = np.full(layout.count, given) if not isinstance(given, PETSc.Vec) else given.getArray().copy()
            self.rows, alone = np.flatnonzero(diagonal), np.arange(0)
            self.diagonal = diagonal[self.rows]
            self.norm = layout.norm(diagonal)
        error = None
        if not (diagonal >= 0.0).all():
            index = int(np.argmin(diagonal >= 0.0))
            value = str(diagonal[index])
            place = layout.first + index
            message = f"{name}: entry ({place}, {place}) = {value}: not allowed; allowed: a finite number ≥ 0"
            error = InputError(message, name, value)
        elif len(alone) > 0:
            place = layout.first + int(alone[0])
            message = f"{name}: not positive semidefinite: row {place} has entries, but none on the diagonal"
            error = InputError(message, name, f"row {place}")
        layout.together.agree(error)
        if not np.isfinite(self.norm):
            raise InputError(f"{name}: has entries that are not finite", name, str(self.norm))
        self.index = self.rows + layout.first

    def gather(self, vector: Any) -> FloatArray:
        """The values of a vector in the channels."""
        numbers: FloatArray = vector.getArray(readonly=True)[self.rows]
        return numbers

    def add_force(self, channels: FloatArray, force: Any) -> None:
        """Adds ρ D to a vector."""
        if self.matrix is None:
            force.getArray()[self.rows] += self.diagonal * channels
            return
        self.scratch.getArray()[self.rows] = channels
        self.matrix.multAdd(self.scratch, force, force)

    def product(self, channels: FloatArray) -> float:
        """This rank's contribution to xᵀρx; collective."""
        if self.matrix is None:
            return float(self.diagonal @ np.square(channels))
        force = self.scratch.duplicate()
        self.add_force(channels, force)
        share = float(channels @ force.getArray()[self.rows])
        force.destroy()
        return share

    def add_to(self, matrix: Any, weight: float) -> None:
        """Adds weight·ρ to a matrix."""
        if self.matrix is not None:
            matrix.axpy(weight, self.matrix, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            return
        diagonal = matrix.createVecLeft()
        diagonal.getArray()[self.rows] = weight * self.diagonal
        matrix.setDiagonal(diagonal, PETSc.InsertMode.ADD_VALUES)
        diagonal.destroy()


def _rows_that_are_not_empty(matrix: Any) -> Any:
    """The local rows with entries; `None` for a matrix type whose rows cannot be inspected."""
    if matrix.getType() not in ("seqaij", "mpiaij", "seqbaij", "mpibaij"):
        return None
    starts, _, values = matrix.getValuesCSR()
    before = np.concatenate([[0], np.cumsum(values != 0.0)])
    return np.flatnonzero(before[starts[1:]] > before[starts[:-1]])


class Dampers:
    """Channels that are dampers: the force B diag(c) D, one channel for each column of B that this rank has."""

    def __init__(self, term: Term, layout: Layout) -> None:
        self.matrix, self.strength = term.attached, term.strength
        self.norm = float(self.matrix.norm(PETSc.NormType.FROBENIUS)) * layout.norm(self.strength)
        name = f"{term.place}.attached"
        if not np.isfinite(self.norm):
            raise InputError(f"{name}: has entries that are not finite, or too large", name, str(self.norm))
        self.scratch = self.matrix.createVecRight()
        first, end = self.matrix.getOwnershipRangeColumn()
        self.index = np.arange(first, end)

    def gather(self, vector: Any) -> FloatArray:
        """Bᵀ times a vector."""
        self.matrix.multTranspose(vector, self.scratch)
        return np.array(self.scratch.getArray(readonly=True))

    def add_force(self, channels: FloatArray, force: Any) -> None:
        """Adds B diag(c) D to a vector."""
        self.scratch.setArray(self.strength * channels)
        self.matrix.multAdd(self.scratch, force, force)

    def product(self, channels: FloatArray) -> float:
        """This rank's contribution to xᵀB diag(c) Bᵀx; the argument is Bᵀx."""
        return float(self.strength @ np.square(channels))

    def add_to(self, matrix: Any, weight: float) -> None:
        """Adds weight·B diag(c) Bᵀ to a matrix."""
        self.scratch.setArray(weight * self.strength)
        scaled = self.matrix.copy()
        scaled.diagonalScale(R=self.scratch)
        mirrored = self.matrix.transpose(PETSc.Mat())
        product = scaled.matMult(mirrored)
        matrix.axpy(1.0, product, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        for made in (product, mirrored, scaled):
            made.destroy()


class Damping:
    """One damping term on this rank.

    At the midpoint X_k = q_k + e_k/2 of a step the derivative is D X_k = w₀ (s_k + e_k/2) + r_k, where r_k is the memory's term and
    the sample s_k + e_k/2 is either the increment X_k − X_{k−1}, with s_k = e_{k−1}/2 known without a subtraction, or the value
    X_k; in both cases minus the terms that Caputo's derivative subtracts. All of these are in the channels of this rank.
    """

    def __init__(self, term: Term, kernels: Kernels, layout: Layout, vector: Any, probes: tuple[Any, Any]) -> None:
        self.term = term
        # The channels' own checks come first, on all ranks.
        self.channels: Rows | Dampers = Dampers(term, layout) if term.attached is not None else Rows(term, layout, vector, probes)
        error = None
        try:
            self.memory = memory_of(term, kernels, len(self.channels.index))
        except BaseException as raised:
            error = raised
        layout.together.agree(error)
        self.leading = float(self.memory.leading)
        self.step = kernels.step
        self.on_values = self.memory.samples == "values"
        self.padding = self.memory.channels - len(self.channels.index)
        self.subtracts_velocity = term.derivative == "caputo" and term.growth > 1.0
        self.subtracts_position = term.derivative == "caputo" and term.kernel != Kernel.power(0.0).keys

    def begin(self, position: Any, velocity: Any) -> None:
        """Sets the initial position and, needed if `subtracts_velocity`, the initial velocity."""
        count = len(self.channels.index)
        start = np.zeros(count) if self.subtracts_position else self.channels.gather(position)
        self.rest = self.channels.gather(position) - start
        self.rise = self.step * self.channels.gather(velocity) if self.subtracts_velocity else np.zeros(count)
        # s_0: for Caputo's form h v₀/2 is subtracted up to the first midpoint, and h v₀ between successive midpoints.
        self.known = start - 0.5 * self.rise

    def ask(self) -> BaseException | None:
        """Computes the known part of D X_k: w₀ s_k + r_k. Returns an error of this rank, if any."""
        try:
            self.term_of_step = self.memory.next_term()[: len(self.known)] + self.leading * self.known
        except Exception as raised:
            self.term_of_step = np.zeros(len(self.known))
            return raised
        return None

    def add_known(self, force: Any) -> None:
        """Adds the force of the known part."""
        self.channels.add_force(self.term_of_step, force)

    def add_force(self, increment: Any, force: Any) -> None:
        """Adds the force ρ D X_k of the step with the increment e_k."""
        self.half = 0.5 * self.channels.gather(increment)
        self.channels.add_force(self.term_of_step + self.leading * self.half, force)

    def energy(self, position: Any) -> float:
        """½ K(0) (q − q*)ᵀρ (q − q*), the contribution of this rank, with q* = 0 or, in Caputo's form, q₀; collective."""
        if self.term.spring == 0.0:
            return 0.0
        return 0.5 * self.term.spring * self.channels.product(self.channels.gather(position) - self.rest)

    def push(self) -> None:
        """Pushes the sample of the step whose force was computed last."""
        sample = self.known + self.half
        self.memory.push(np.concatenate([sample, np.zeros(self.padding)]))
        if self.on_values:
            self.known = self.known + 2.0 * self.half - self.rise
        else:
            self.known = self.half - self.rise

    def state(self) -> dict[str, Any]:
        """The state of this rank for a checkpoint."""
        return {
            "index": self.channels.index,
            "known": self.known,
            "rise": self.rise,
            "rest": self.rest,
            "memory": np.frombuffer(self.memory.save(), dtype=np.uint8),
            "channels": np.int64(self.memory.channels),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restores those of this rank's channels that a saved state of any rank contains."""
        mine, saved = self.channels.index, state["index"]
        taken, to, first = np.intersect1d(mine, saved, assume_unique=True, return_indices=True)
        count = len(taken)
        if count == 0:
            return
        # Both are sorted, and the common channels of two ranks are contiguous in both.
        at, into = int(first[0]), int(to[0])
        if int(first[-1]) - at + 1 != count or int(to[-1]) - into + 1 != count:
            raise InputError(f"{self.term.place}: has other channels than in the checkpoint", self.term.place)
        for name in ("known", "rise", "rest"):
            getattr(self, name)[to] = state[name][first]
        self.memory.restore_channels(state["memory"].tobytes(), int(state["channels"]), at, count, into)


def fresh(damping: list[Damping]) -> None:
    """Empty arrays for the states of a checkpoint."""
    for term in damping:
        count = len(term.channels.index)
        term.known, term.rise, term.rest = np.zeros(count), np.zeros(count), np.zeros(count)
        term.memory.clear()
