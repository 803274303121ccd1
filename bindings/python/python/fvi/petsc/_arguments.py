"""Requirements on the PETSc objects and on their distribution.

Checks that a rank makes by itself create no PETSc objects: these are numbered, and ranks that created different numbers of them
could no longer exchange messages.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from petsc4py import PETSc

from fvi import _arrays, _fvi
from fvi._errors import InputError
from fvi._terms import Damping
from fvi._kernel import Kernel
from fvi._keyed import keys_of
from fvi._types import FloatArray
from fvi.petsc._together import Together, text_of

SYMMETRY = 1e-10
"""How far a matrix may be from symmetric, of its Frobenius norm."""


KEYS = ("order", "kernel", "allow_active", "coefficient", "derivative", "attached", "strength")
"""What a damping term may say here."""


@dataclass
class Term:
    """A damping term as given, checked."""

    place: str
    key_of_kernel: str
    """order or kernel."""
    kernel: dict[str, Any]
    growth: float
    """μ, where K(s) is like s^μ for large s."""
    spring: float
    """K(0)."""
    derivative: str
    coefficient: Any
    attached: Any
    strength: Any
    text: str
    """What all ranks have to say alike."""


def communicator(candidates: list[tuple[str, Any]]) -> Any:
    """The largest communicator of the arguments, on which the ranks agree on all other arguments."""
    largest = None
    for name, given in candidates:
        if isinstance(given, (PETSc.Mat, PETSc.Vec)) and given.handle:
            comm = given.getComm().tompi4py()
            if largest is None or comm.Get_size() > largest.Get_size():
                largest = comm
    if largest is None:
        name, given = candidates[0]
        raise InputError(f"{name} = {given!r}: a PETSc.Mat that is assembled, or a PETSc.Vec, is needed", name, repr(given))
    return largest


class Layout:
    """The distribution of the rows over the ranks, given by the mass; all other arguments must have the same."""

    def __init__(self, together: Together, name: str, given: Any) -> None:
        self.together = together
        self.first, self.end = self._rows(name, given)
        self.size: int = given.getSize()[0] if isinstance(given, PETSc.Mat) else given.getSize()
        if self.size == 0:
            raise InputError(f"{name}: has no rows", name, "0")

    @property
    def count(self) -> int:
        return self.end - self.first

    def _rows(self, name: str, given: Any) -> tuple[int, int]:
        if not isinstance(given, (PETSc.Mat, PETSc.Vec)):
            raise InputError(f"{name} = {given!r}: a PETSc.Mat or PETSc.Vec is needed", name, repr(given))
        kind = type(given).__name__
        if not given.handle:
            raise InputError(f"{name}: a {kind} that has not been created", name, kind)
        size = given.getComm().getSize()
        if size != self.together.size:
            message = f"{name}: lives on {size} rank(s), other arguments on {self.together.size}; one communicator is needed"
            raise InputError(message, name, str(size))
        if isinstance(given, PETSc.Mat) and not given.assembled:
            raise InputError(f"{name}: a matrix that is not assembled: call assemble() on all ranks", name, "not assembled")
        try:
            first, end = given.getOwnershipRange()
        except PETSc.Error as error:
            raise InputError(f"{name}: a {kind} that is not set up: {error}", name, kind) from None
        return int(first), int(end)

    def check(self, name: str, given: Any) -> Any:
        """Checks that an argument is distributed like the mass."""
        first, end = self._rows(name, given)
        size = given.getSize()[0] if isinstance(given, PETSc.Mat) else given.getSize()
        if size != self.size:
            message = f"{name}: {size} rows, but the system has {self.size} coordinates (as many as mass has)"
            raise InputError(message, name, str(size))
        if (first, end) != (self.first, self.end):
            message = (
                f"{name}: rank {self.together.rank} has the rows {first} to {end - 1}, but those of mass from {self.first} to "
                f"{self.end - 1}; all are to be distributed alike"
            )
            raise InputError(message, name, f"{first}:{end}")
        return given

    def norm(self, numbers: FloatArray) -> float:
        """Euclidean norm of the numbers of all ranks; collective."""
        with np.errstate(over="ignore"):
            square = float(np.square(numbers).sum())
        return float(np.sqrt(self.together.sum(square)))

    def matrix(self, name: str, given: Any) -> Any:
        """A square matrix."""
        if not isinstance(given, PETSc.Mat):
            raise InputError(f"{name} = {given!r}: a PETSc.Mat is needed", name, repr(given))
        self.check(name, given)
        rows, columns = given.getSize()
        if rows != columns:
            raise InputError(f"{name}: {rows} rows and {columns} columns; a square matrix is needed", name, f"{rows}x{columns}")
        if tuple(given.getOwnershipRangeColumn()) != (self.first, self.end):
            raise InputError(f"{name}: columns are distributed otherwise than rows", name, str(given.getOwnershipRangeColumn()))
        return given

    def numbers(self, name: str, given: Any) -> FloatArray:
        """This rank's numbers of a vector, or of a constant."""
        if isinstance(given, PETSc.Vec):
            return np.array(local_numbers(name, self.check(name, given), self.first))
        if np.ndim(given) == 0 and not isinstance(given, PETSc.Object):
            return np.full(self.count, _arrays.real(name, given))
        raise InputError(f"{name}: a PETSc.Vec distributed as mass is needed, or a number for all coordinates", name, repr(given))


def local_numbers(name: str, vector: Any, first: int) -> FloatArray:
    """The numbers of a vector on this rank, all of them finite."""
    numbers: FloatArray = vector.getArray(readonly=True)
    if not np.isfinite(numbers).all():
        index = int(np.argmin(np.isfinite(numbers)))
        value = str(numbers[index])
        message = f"{name}[{first + index}] = {value}: not allowed; allowed: a finite number"
        raise InputError(message, name, value)
    return numbers


def damping_terms(given: Any, layout: Layout) -> list[Term]:
    """The damping terms, after the checks that a rank can make by itself."""
    return [
        _damping_term(f"damping[{index}]", term, layout)
        for index, term in enumerate(_arrays.several("damping", given, (Damping, Mapping), "a fvi.Damping"))
    ]


def _damping_term(place: str, term: Any, layout: Layout) -> Term:
    if isinstance(term, Damping):
        term = {field.name: getattr(term, field.name) for field in fields(term)}
    if not isinstance(term, Mapping):
        raise InputError(f"{place} = {term!r}: a fvi.Damping is needed", place, repr(term))
    entries = {key: value for key, value in term.items() if value is not None}
    for key in entries:
        if key not in KEYS:
            raise InputError(f"{place}.{key}: no such key on ranks; allowed: {', '.join(KEYS)}", f"{place}.{key}", key)
    key_of_kernel, kernel = _kernel_of(place, entries)
    try:
        growth, spring, active = _fvi.kernel_facts(kernel)
    except InputError as error:
        key = f"{place}.{error.key}"
        raise InputError(f"{place}.{error}", key, error.value) from None
    if active is not None and not entries.get("allow_active", False):
        message = f"{place}.kernel: a passive kernel is needed: this one can drive the motion at {active}; allow_active=True admits it"
        raise InputError(message, f"{place}.kernel", repr(kernel))
    derivative = entries.get("derivative", "caputo")
    if derivative not in ("caputo", "riemann-liouville"):
        message = f'{place}.derivative = {derivative!r}: not allowed; allowed: "caputo", "riemann-liouville"'
        raise InputError(message, f"{place}.derivative", repr(derivative))
    if ("coefficient" in entries) == ("attached" in entries):
        raise InputError(f"{place}: needs either coefficient, or attached and strength", place)
    if ("strength" in entries) != ("attached" in entries):
        raise InputError(f"{place}.strength: goes together with attached", f"{place}.strength")
    coefficient = entries.get("coefficient")
    if coefficient is not None:
        name = f"{place}.coefficient"
        if isinstance(coefficient, PETSc.Mat):
            layout.matrix(name, coefficient)
        elif isinstance(coefficient, PETSc.Vec):
            layout.check(name, coefficient)
        elif np.ndim(coefficient) != 0:
            message = f"{name}: a PETSc.Mat, a PETSc.Vec (the diagonal) or a number is needed"
            raise InputError(message, name, repr(type(coefficient)))
        else:
            coefficient = _arrays.real(name, coefficient)
    strength = entries.get("strength")
    if "attached" in entries:
        attached = entries["attached"]
        if not isinstance(attached, PETSc.Mat):
            raise InputError(f"{place}.attached: a PETSc.Mat is needed", f"{place}.attached", repr(attached))
        layout.check(f"{place}.attached", attached)
        strength = _strength(f"{place}.strength", strength, attached)
    said = [text_of(entries.get(key)) for key in ("coefficient", "attached", "strength")]
    text = f"{kernel} {derivative} {' '.join(said)}"
    attached = entries.get("attached")
    return Term(place, key_of_kernel, kernel, growth, spring, derivative, coefficient, attached, strength, text)


def _kernel_of(place: str, entries: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """The key that gives the kernel, and the kernel K(s) with the keys of a scenario."""
    if ("order" in entries) == ("kernel" in entries):
        message = f"{place}.order: missing" if "order" not in entries else f"{place}.order cannot stand beside kernel"
        raise InputError(message, f"{place}.order")
    if "kernel" in entries:
        return "kernel", keys_of(f"{place}.kernel", entries["kernel"])
    order = _arrays.real(f"{place}.order", entries["order"])
    if not 0.0 <= order < 2.0:
        raise InputError(f"{place}.order = {order}: not allowed; allowed: 0 ≤ order < 2", f"{place}.order", str(order))
    return "order", Kernel.power(order).keys


def _strength(name: str, given: Any, attached: Any) -> FloatArray:
    """The strengths of the dampers whose columns this rank has."""
    first, end = attached.getOwnershipRangeColumn()
    count = attached.getSize()[1]
    if isinstance(given, PETSc.Vec):
        if given.getSize() != count or tuple(given.getOwnershipRange()) != (first, end):
            message = f"{name}: a vector distributed as the columns of attached is needed"
            raise InputError(message, name, str(given.getOwnershipRange()))
        numbers = np.array(local_numbers(name, given, first))
    else:
        numbers = _arrays.numbers(name, given)
        if numbers.ndim == 0:
            numbers = np.full(count, float(numbers))
        if numbers.shape != (count,):
            raise InputError(f"{name}: shape {numbers.shape} instead of ({count},), one number for each damper", name, str(numbers.shape))
        numbers = numbers[first:end]
    if (numbers < 0.0).any():
        index = int(np.argmax(numbers < 0.0))
        value = str(numbers[index])
        raise InputError(f"{name}[{first + index}] = {value}: not allowed; allowed: a number ≥ 0", name, value)
    return numbers


def coordinates(name: str, given: Any, layout: Layout) -> Any:
    """Numbers of coordinates, counted from 0 over all ranks."""
    chosen = np.asarray(list(given))
    if chosen.size == 0:
        return np.empty(0, dtype=np.int64)
    if chosen.ndim != 1 or chosen.dtype.kind not in "iu":
        raise InputError(f"{name}: whole numbers are needed", name, repr(given))
    outside = (chosen < 0) | (chosen >= layout.size)
    if outside.any():
        value = int(chosen[np.argmax(outside)])
        message = f"{name} = {value}: not allowed; allowed: from 0 to {layout.size - 1}"
        raise InputError(message, name, str(value))
    if len(np.unique(chosen)) < len(chosen):
        raise InputError(f"{name}: each coordinate can be chosen once", name, repr(chosen.tolist()))
    return chosen.astype(np.int64)


def check_symmetric(name: str, matrix: Any, probes: tuple[Any, Any], definite: str) -> float:
    """Refuses a matrix that is not finite, not symmetric, or negative along a probe vector; collective. Returns its Frobenius
    norm.

    xᵀA y = yᵀA x for two vectors of random signs: the difference of the two numbers is of the size of A − Aᵀ.
    """
    try:
        norm = float(matrix.norm(PETSc.NormType.FROBENIUS))
    except PETSc.Error:
        kind = str(matrix.getType())
        raise InputError(f'{name}: a matrix of the type "{kind}"; one with entries, such as "aij", is needed', name, kind) from None
    if not np.isfinite(norm):
        raise InputError(f"{name}: has entries that are not finite, or too large", name, str(norm))
    x, y = probes
    product = x.duplicate()
    matrix.mult(y, product)
    one = product.dot(x)
    matrix.mult(x, product)
    other, along = product.dot(y), product.dot(x)
    product.destroy()
    if abs(one - other) > SYMMETRY * norm:
        message = f"{name}: not symmetric: xᵀAy = {one}, yᵀAx = {other} for two vectors of signs"
        raise InputError(message, name, "not symmetric")
    if definite and along < -SYMMETRY * norm or (definite == "positive definite" and along <= 0.0):
        raise InputError(f"{name}: not {definite}: xᵀAx = {along} for a vector of signs", name, str(along))
    if definite == "positive definite":
        diagonal = matrix.getDiagonal()
        row, smallest = diagonal.min()
        diagonal.destroy()
        if not smallest > 0.0:
            raise InputError(f"{name}: not {definite}: entry ({row}, {row}) is {smallest}", name, str(smallest))
    return norm
