"""A `fvi.System` in PETSc's objects: each rank has the whole system and keeps its own rows of it."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from petsc4py import PETSc

from fvi import _arrays
from fvi._errors import InputError
from fvi._scenario import Ready
from fvi._system import System
from fvi._terms import Damping, Load
from fvi._types import FloatArray
from fvi.petsc._together import Together, text_of

TAKEN = ("mass", "stiffness", "damping", "loads", "parameters")
"""What a system on ranks may have: it is linear."""


class _Entries(NamedTuple):
    """A matrix by the entries of its rows, one after another."""

    shape: tuple[int, int]
    starts: Any
    columns: Any
    numbers: FloatArray


def arguments_of(system: System, given: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `integrate` with those of a system; collective. Vectors among them may be arrays of N numbers."""
    for name, value in system.arguments.items():
        if name not in TAKEN:
            message = f"{name}: on ranks a system is linear; it may have {', '.join(TAKEN)}"
            raise InputError(message, name, repr(value))
    arguments = system.merged(given)
    if (size := system.coordinates) is None:
        raise InputError("mass: a number for each coordinate is needed on ranks", "mass", repr(arguments["mass"]))
    if arguments["stiffness"] is None:
        raise InputError("stiffness: missing in the system; needed on ranks", "stiffness", "None")
    comm = PETSc.COMM_WORLD
    together = Together(comm.tompi4py())
    found: dict[str, Any] = {}
    texts: dict[str, str] = {}

    def taken(name: str, value: Any, rows_alone: bool = False) -> Any:
        """The entries or numbers of an argument, and what all ranks have to say alike."""
        if value is None or isinstance(value, PETSc.Object):
            return value
        read: Any
        if isinstance(value, Ready) or _arrays.is_sparse(value) or np.ndim(value) == 2:
            read = _entries(value)
            texts[name] = f"{read.shape} {text_of(read.columns)} {text_of(read.numbers)}"
            return read
        if np.ndim(value) == 0:
            read = _arrays.real(name, value)
        else:
            read = _arrays.vector(name, value, size)
            read = _diagonal(read) if rows_alone else read
        texts[name] = text_of(read.numbers if isinstance(read, _Entries) else read)
        return read

    found["mass"], found["stiffness"] = taken("mass", arguments["mass"]), taken("stiffness", arguments["stiffness"], True)
    for name in ("position", "momentum", "velocity"):
        found[name] = taken(name, arguments[name])
    damping = [_changed(term, f"damping[{index}]", taken) for index, term in enumerate(arguments["damping"])]
    loads = [
        load if isinstance(pattern := _part(load, "pattern"), Mapping) else _with(load, pattern=taken(f"loads[{index}].pattern", pattern))
        for index, load in enumerate(arguments["loads"])
    ]
    together.same(texts)
    distributed = {name: _distributed(value, comm, size) for name, value in found.items()}
    distributed["damping"] = [
        _with(term, **{key: _distributed(_part(term, key), comm, size) for key in ("coefficient", "attached")}) for term in damping
    ]
    distributed["loads"] = [_with(load, pattern=_distributed(_part(load, "pattern"), comm, size)) for load in loads]
    return {**arguments, **distributed}


def _part(term: Any, key: str) -> Any:
    return term.get(key) if isinstance(term, Mapping) else getattr(term, key)


def _with(term: Any, **changes: Any) -> Any:
    if isinstance(term, (Damping, Load)):
        return replace(term, **changes)
    return {**term, **{key: value for key, value in changes.items() if value is not None}}


def _changed(term: Any, place: str, taken: Callable[[str, Any], Any]) -> Any:
    """A damping term with its matrices by their entries."""
    return _with(term, **{key: taken(f"{place}.{key}", _part(term, key)) for key in ("coefficient", "attached")})


def _entries(given: Any) -> _Entries:
    if isinstance(given, Ready):
        content = np.load(io.BytesIO(given.content))
        if given.suffix == ".npz":
            rows, columns = (int(count) for count in content["shape"])
            return _Entries((rows, columns), content["indptr"], content["indices"], content["data"])
        given = content
    if _arrays.is_sparse(given):
        by_rows = given.tocsr()
        return _Entries(by_rows.shape, by_rows.indptr, by_rows.indices, np.asarray(by_rows.data, dtype=np.float64))
    full = np.asarray(given, dtype=np.float64)
    places, others = np.nonzero(full)
    return _Entries((full.shape[0], full.shape[1]), np.searchsorted(places, np.arange(len(full) + 1)), others, full[places, others])


def _diagonal(numbers: FloatArray) -> _Entries:
    places = np.arange(len(numbers) + 1)
    return _Entries((len(numbers), len(numbers)), places, places[:-1], numbers)


def _distributed(given: Any, comm: Any, size: int) -> Any:
    """The rows of this rank; collective."""
    if isinstance(given, _Entries):
        rows = PETSc.Vec().createMPI(given.shape[0], comm=comm)
        first, end = rows.getOwnershipRange()
        rows.destroy()
        begin, behind = given.starts[first], given.starts[end]
        starts = (given.starts[first : end + 1] - begin).astype(PETSc.IntType)
        columns, numbers = given.columns[begin:behind].astype(PETSc.IntType), given.numbers[begin:behind]
        square = given.shape[0] == given.shape[1]
        width = (end - first if square else None, given.shape[1])
        matrix = PETSc.Mat().createAIJ(((end - first, given.shape[0]), width), csr=(starts, columns, numbers), comm=comm)
        matrix.assemble()
        return matrix
    if isinstance(given, np.ndarray) and given.ndim == 1:
        vector = PETSc.Vec().createMPI(size, comm=comm)
        first, end = vector.getOwnershipRange()
        vector.setArray(given[first:end])
        return vector
    return given
