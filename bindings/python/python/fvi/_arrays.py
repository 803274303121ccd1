"""Conversion and checks of array arguments."""

from __future__ import annotations

import io
from collections.abc import Iterable
from copy import copy
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from fvi._errors import InputError
from fvi._types import FloatArray


LARGEST = 2**63 - 1
"""The largest whole number that goes over to the compiled half."""


def unchecked(name: str, given: Any) -> FloatArray:
    """An argument converted to an array in double precision, whose numbers need not be finite."""
    refuse_masked(name, given)
    array = np.asarray(given)
    if array.dtype.kind not in "fiub":
        described = "objects" if array.dtype.kind == "O" else f"values of type {array.dtype}"
        raise InputError(f"{name}: an array of {described}; real numbers are needed", name, str(array.dtype))
    return np.ascontiguousarray(array, dtype=np.float64).reshape(array.shape)


def numbers(name: str, given: Any, *, missing: bool = False) -> FloatArray:
    """An argument converted to an array of finite numbers in double precision; with `missing`, NaN is one of them."""
    array = unchecked(name, given)
    wrong = np.isinf(array) if missing else ~np.isfinite(array)
    if wrong.any():
        place = tuple(int(index) for index in np.argwhere(wrong)[0])
        value = str(array[place])
        subject = f"{name}[{', '.join(map(str, place))}]" if place else name
        raise InputError(f"{subject} = {value}: not allowed; allowed: a finite number", name, value)
    return array


def refuse_masked(name: str, given: Any) -> None:
    """Raises InputError for a masked array with masked entries."""
    if isinstance(given, np.ma.MaskedArray) and np.ma.is_masked(given):
        raise InputError(f"{name}: a masked array, in which numbers are missing; all are needed", name, "masked")


def returned(name: str, given: Any) -> FloatArray:
    """The value returned by a user's function, as an array in double precision, which may contain NaN; arrays of other libraries
    are converted."""
    refuse_masked(name, given)
    try:
        array = np.asarray(given.toarray() if is_sparse(given) else given)
    except ValueError as error:
        raise InputError(f"{name} has returned no array: {error}", name, repr(given)[:60]) from error
    if array.dtype.kind == "O":
        # NumPy takes None for NaN.
        strange = [entry for entry in array.flat if isinstance(entry, (str, bytes)) or not hasattr(entry, "__float__")]
        if strange:
            raise InputError(f"{name} has returned {repr(given)[:60]}; real numbers are needed", name, repr(strange[0])[:60])
    if array.dtype.kind not in "fiubO":
        raise InputError(f"{name} has returned values of type {array.dtype}; real numbers are needed", name, str(array.dtype))
    return np.asarray(array, dtype=np.float64)


def copied(given: Any) -> Any:
    """The same with arrays and sparse matrices of its own, inside of lists, dictionaries and the package's objects too."""
    if isinstance(given, np.ndarray) or is_sparse(given):
        return given.copy()
    if isinstance(given, (list, tuple)) and type(given) in (list, tuple):
        return type(given)(copied(part) for part in given)
    if type(given) is dict:
        return {name: copied(part) for name, part in given.items()}
    if is_dataclass(given) and not isinstance(given, type):
        own = copy(given)
        for field in fields(given):
            object.__setattr__(own, field.name, copied(getattr(given, field.name)))
        return own
    return given


def several(name: str, given: Any, kinds: type | tuple[type, ...], wanted: str) -> Iterable[Any]:
    """An argument that is one object of the given types or several of them, as a list."""
    if isinstance(given, kinds):
        return [given]
    if isinstance(given, (str, bytes)) or not isinstance(given, Iterable):
        raise InputError(f"{name} = {given!r}: {wanted} is needed, or a list of them", name, repr(given))
    return given


def vector(name: str, given: Any, size: int) -> FloatArray:
    """One number for each coordinate; a single number stands for all of them."""
    array = numbers(name, given)
    if array.ndim == 0:
        array = np.full(size, float(array))
    if array.shape != (size,):
        raise InputError(
            f"{name}: shape {array.shape} instead of ({size},), one number for each coordinate", name, str(array.shape)
        )
    return array


def is_sparse(given: Any) -> bool:
    """Whether it is a sparse SciPy matrix."""
    return hasattr(given, "tocsr") and hasattr(given, "toarray")


def npz(name: str, given: Any) -> bytes:
    """A sparse matrix as the file that `scipy.sparse.save_npz` writes."""
    rows = given.tocsr()
    content = io.BytesIO()
    np.savez(
        content,
        format=np.array(b"csr"),
        shape=np.array(rows.shape, dtype=np.int64),
        data=numbers(f"{name}.data", rows.data),
        indices=rows.indices,
        indptr=rows.indptr,
    )
    return content.getvalue()


def diagonal_npz(name: str, given: Any) -> bytes:
    """A diagonal matrix by its entries, as the file that `scipy.sparse.save_npz` writes."""
    entries = numbers(name, given)
    content, size = io.BytesIO(), len(entries)
    shape, places = np.array([size, size], dtype=np.int64), np.arange(size + 1, dtype=np.int32)
    np.savez(content, format=np.array(b"csr"), shape=shape, data=entries, indices=places[:-1], indptr=places)
    return content.getvalue()


def entries_npz(name: str, given: Any) -> bytes:
    """A full matrix by its nonzero entries, as the file that `scipy.sparse.save_npz` writes."""
    rows, columns = np.nonzero(given)
    content, size = io.BytesIO(), given.shape[0]
    starts = np.searchsorted(rows, np.arange(size + 1)).astype(np.int32)
    shape, indices = np.array(given.shape, dtype=np.int64), columns.astype(np.int32)
    data = numbers(name, given[rows, columns])
    np.savez(content, format=np.array(b"csr"), shape=shape, data=data, indices=indices, indptr=starts)
    return content.getvalue()


def npy(name: str, given: Any) -> bytes:
    """An array as the file that `numpy.save` writes."""
    content = io.BytesIO()
    np.save(content, numbers(name, given), allow_pickle=False)
    return content.getvalue()


def matrix(name: str, given: Any, size: int | None = None) -> Any:
    """A diagonal (one dimension) or a square matrix (two), as an array, or as a sparse SciPy matrix if it was one.

    Without `size` this argument determines the number of coordinates.
    """
    if hasattr(given, "suffix") and hasattr(given, "content"):
        array = given
    else:
        array = given if is_sparse(given) else numbers(name, given)
    if array.ndim == 0:
        array = np.full(size or 1, float(array))
    square = array.ndim == 1 or (array.ndim == 2 and array.shape[0] == array.shape[1])
    if not square or array.shape[0] == 0:
        raise InputError(
            f"{name}: shape {array.shape}; a vector (the diagonal) or a square matrix is needed", name, str(array.shape)
        )
    if size is not None and array.shape[0] != size:
        raise InputError(
            f"{name}: shape {array.shape}, but the system has {size} coordinates (as many as mass has)",
            name,
            str(array.shape),
        )
    return array


def whole(name: str, given: Any, least: int = 0) -> int:
    """A whole number."""
    if isinstance(given, (bool, np.bool_)) or not isinstance(given, (int, np.integer)):
        raise InputError(f"{name} = {given!r}: not allowed; allowed: a whole number", name, repr(given))
    if given < least:
        raise InputError(f"{name} = {given!r}: not allowed; allowed: a whole number ≥ {least}", name, repr(given))
    if given > LARGEST:
        raise InputError(f"{name} = {given!r}: not allowed; allowed: a whole number below 2⁶³", name, repr(given))
    return int(given)


def real(name: str, given: Any) -> float:
    """A finite number."""
    array = numbers(name, given)
    if array.ndim != 0:
        raise InputError(f"{name}: shape {array.shape} instead of a single number", name, str(array.shape))
    return float(array)


def positive(name: str, given: Any) -> float:
    """A finite number > 0."""
    number = real(name, given)
    if number <= 0.0:
        raise InputError(f"{name} = {number}: not allowed; allowed: a number > 0", name, str(number))
    return number
