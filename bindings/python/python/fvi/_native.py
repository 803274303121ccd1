"""Functions of C: pointers of ctypes and what Numba has compiled."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fvi._errors import InputError
from fvi._types import FloatArray

POINTER = ctypes.POINTER(ctypes.c_double)

SIGNATURES = {
    "potential.value": ("double U(const double *q)", [(1, True)]),
    "potential.gradient": ("void gradient(const double *q, double *out)", [(2, False)]),
    "potential.hessian": ("void hessian(const double *q, double *out)", [(2, False)]),
    "force": (
        "void F(double t, const double *q, double *out) or void F(double t, const double *q, const double *v, double *out)",
        [(2, False), (3, False)],
    ),
}
"""For each function how it is declared, and for each form the number of its pointers and whether it returns a number."""


_FUNCTION: Any = ctypes.CFUNCTYPE(None).__mro__[1]
"""The class of all function pointers of ctypes."""


class Native:
    """A C function that is called without the interpreter, and from Python as the function that it stands for."""

    def __init__(self, function: Any, owner: Any, of_time: bool, moves: bool, square: bool) -> None:
        self.function, self.owner = function, owner
        self.of_time, self.moves, self.square = of_time, moves, square
        self.fvi_address = ctypes.cast(function, ctypes.c_void_p).value

    def __call__(self, *arguments: ArrayLike) -> Any:
        times = arguments[: int(self.of_time)]
        arrays = [np.ascontiguousarray(array, dtype=np.float64) for array in arguments[len(times) :]]
        pointers: list[Any] = [array.ctypes.data_as(POINTER) for array in arrays]
        if self.function.restype is not None:
            return self.function(*pointers)
        size = len(arrays[0])
        out: FloatArray = np.zeros((size, size) if self.square else size)
        self.function(*times, *pointers, out.ctypes.data_as(POINTER))
        return out


def native(name: str, kind: str, function: Any) -> Any:
    """The function as one of C, if it is such; any other object as it is.

    `kind` is one of `SIGNATURES`; derivatives of a force are declared as the force is.
    """
    # What Numba compiles has its ctypes function as an attribute.
    given = function.ctypes if hasattr(function, "address") and hasattr(function, "ctypes") else function
    if not isinstance(given, _FUNCTION):
        return function
    key = kind if kind in SIGNATURES else "force"
    declared, forms = SIGNATURES[key]
    if given.argtypes is None:
        message = f"{name}: the function of C has no `argtypes`; allowed: {declared}"
        raise InputError(message, name, repr(function))
    times = given.argtypes[:1] if key == "force" else ()
    pointers = given.argtypes[len(times) :]
    fits = all(one is ctypes.c_double for one in times) and all(map(_points_to_numbers, pointers))
    returns = {None: False, ctypes.c_double: True}.get(given.restype)
    if not fits or (len(pointers), returns) not in forms:
        message = f"{name}: the function of C takes or returns something else; allowed: {declared}"
        raise InputError(message, name, repr(function))
    square = kind not in ("potential.value", "potential.gradient", "force")
    return Native(given, function, key == "force", len(pointers) == 3, square)


def _points_to_numbers(declared: Any) -> bool:
    """Whether a type of ctypes, or one of NumPy's `ndpointer`, is a pointer to double-precision numbers."""
    of_array = getattr(declared, "_dtype_", None)
    return declared in (ctypes.c_void_p, POINTER) or (of_array is not None and of_array == np.float64)
