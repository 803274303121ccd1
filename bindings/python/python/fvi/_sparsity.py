"""Hessians on a sparsity pattern: given as sparse matrices, or by differences of the gradient."""

from __future__ import annotations

from typing import Any

import numpy as np

from fvi import _arrays
from fvi._errors import InputError
from fvi._types import FloatArray


class Pattern:
    """Sparsity pattern of a symmetric matrix of N rows: structural nonzeros in row order, with both triangles."""

    def __init__(self, size: int, rows: Any, columns: Any) -> None:
        both = np.concatenate([rows, columns]).astype(np.int64), np.concatenate([columns, rows]).astype(np.int64)
        keys = np.unique(both[0] * size + both[1])
        self.size, self.keys = size, keys
        self.rows, self.columns = keys // size, keys % size
        self.mirrored = np.searchsorted(keys, self.columns * size + self.rows)

    def numbers(self, name: str, matrix: Any) -> FloatArray:
        """The values at the structural nonzeros, of a matrix without other nonzeros."""
        shape = (self.size, self.size)
        if np.shape(matrix) != shape:
            message = f"{name} has returned numbers in shape {np.shape(matrix)}; {shape} is needed"
            raise InputError(message, name, str(np.shape(matrix)))
        if not _arrays.is_sparse(matrix):
            full = _arrays.returned(name, matrix)
            if np.isnan(full).any():
                return np.full(len(self.keys), np.nan)
            rows, columns = np.nonzero(full)
            self._place(name, rows, columns, full[rows, columns])
            return np.asarray(full[self.rows, self.columns])
        entries = matrix.tocoo()
        numbers = np.zeros(len(self.keys))
        places = self._place(name, entries.row, entries.col, entries.data)
        there = places >= 0
        np.add.at(numbers, places[there], _arrays.returned(name, entries.data)[there])
        return numbers

    def _place(self, name: str, rows: Any, columns: Any, data: Any) -> Any:
        """Indices of entries in the pattern; −1 for zero entries outside of it."""
        keys = np.asarray(rows, dtype=np.int64) * self.size + columns
        places = np.minimum(np.searchsorted(self.keys, keys), max(len(self.keys) - 1, 0))
        known = self.keys[places] == keys if len(self.keys) else np.zeros(len(keys), dtype=bool)
        outside = np.flatnonzero(~known & (np.asarray(data) != 0))
        if outside.size > 0:
            row, column = int(rows[outside[0]]), int(columns[outside[0]])
            message = (
                f"{name} has an entry ({row}, {column}) where its pattern has none; `pattern` says where there may be entries, "
                "without it the Hessian where the run begins"
            )
            raise InputError(message, name, f"entry ({row}, {column})")
        return np.where(known, places, -1)

    def groups(self) -> list[Any]:
        """Groups of columns without common rows. Source: Curtis, Powell, Reid (1974)."""
        ends = np.searchsorted(self.rows, np.arange(self.size + 1))
        neighbours = [self.columns[ends[row] : ends[row + 1]].tolist() for row in range(self.size)]
        group = [-1] * self.size
        for column in range(self.size):
            taken = {group[other] for row in neighbours[column] for other in neighbours[row]}
            own = 0
            while own in taken:
                own += 1
            group[column] = own
        numbers = np.array(group)
        return [np.flatnonzero(numbers == own) for own in range(int(numbers.max(initial=-1)) + 1)]


class SparseHessian:
    """∂²U/∂q² by its values on a pattern."""

    def __init__(self, pattern: Pattern, potential: Any, name: str) -> None:
        self.pattern, self.potential, self.name = pattern, potential, name
        self.places: list[int] = np.column_stack([pattern.rows, pattern.columns]).ravel().tolist()
        self.groups = None if potential.hessian is not None else pattern.groups()

    def __call__(self, position: FloatArray) -> FloatArray:
        pattern, potential = self.pattern, self.potential
        if self.groups is None:
            return pattern.numbers(f"{self.name}.hessian", potential.hessian(position))
        lengths = np.sqrt(np.finfo(float).eps) * np.maximum(np.abs(position), 1.0)
        # The changes after rounding.
        lengths = (position + lengths) - position
        name = f"{self.name}.gradient"
        base = _arrays.returned(name, potential.gradient(position.copy()))
        change = np.zeros_like(position)
        of_column = np.zeros((len(self.groups), pattern.size))
        own = np.zeros(pattern.size, dtype=np.int64)
        for index, group in enumerate(self.groups):
            change[group] = lengths[group]
            of_column[index] = _arrays.returned(name, potential.gradient(position + change)) - base
            change[group] = 0.0
            own[group] = index
        numbers = of_column[own[pattern.columns], pattern.rows] / lengths[pattern.columns]
        return np.asarray(0.5 * (numbers + numbers[pattern.mirrored]))


def sparse_hessian(potential: Any, position: FloatArray, name: str) -> SparseHessian | None:
    """The Hessian of a potential on its pattern; `None` where it is not known to be sparse."""
    size = len(position)
    if potential.pattern is not None:
        given = potential.pattern
        if np.shape(given) != (size, size):
            shape = np.shape(given)
            message = f"{name}.pattern: shape {shape} instead of {(size, size)}"
            raise InputError(message, f"{name}.pattern", str(shape))
        if _arrays.is_sparse(given):
            entries = given.tocoo()
            rows, columns = entries.row, entries.col
        else:
            rows, columns = np.nonzero(np.asarray(given))
    else:
        if potential.hessian is None:
            return None
        first = potential.hessian(np.array(position, dtype=np.float64))
        if not _arrays.is_sparse(first):
            return None
        if first.shape != (size, size):
            message = f"{name}.hessian has returned numbers in shape {first.shape}; {(size, size)} is needed"
            raise InputError(message, f"{name}.hessian", str(first.shape))
        entries = first.tocoo()
        rows, columns = entries.row, entries.col
    return SparseHessian(Pattern(size, rows, columns), potential, name)
