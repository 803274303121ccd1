"""Gradients of functions of a trajectory."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fvi import _arrays, _fvi
from fvi._errors import InputError
from fvi._result import Result
from fvi._types import FloatArray

Cotangent = ArrayLike | tuple[ArrayLike, ArrayLike]
"""∂J/∂q, like `Result.q`; or ∂J/∂q and ∂J/∂p."""


@dataclass(frozen=True, eq=False)
class Gradient:
    """The derivatives of a function J of a trajectory, see `Model.gradient`.

    Attributes
    ----------
    parameters : dict of str to float or array
        ∂J/∂θ by the names of the parameters, with the shapes of their values. An entry off the diagonal of a matrix is changed
        together with its mirror image; where both are named each has half of that.
    position, momentum : array
        ∂J/∂q₀ and ∂J/∂p₀, N numbers each, at the given parameters.
    force : array
        ∂J/∂F, shape (steps, N): by a force on each coordinate that is constant over a step, added to those of the system.
    result : Result
        The trajectory.
    """

    parameters: dict[str, Any]
    position: FloatArray
    momentum: FloatArray
    force: FloatArray
    result: Result

    def __getitem__(self, name: str) -> Any:
        return self.parameters[name]


class Recording:
    """A run whose steps are kept, for gradients of any functions of its trajectory; made by `Model.record`.

    Attributes
    ----------
    result : Result
        The trajectory.
    nbytes : int
        Bytes of the steps.
    shapes : dict of str to tuple of int
        The shapes of the parameters by their names.
    """

    def __init__(self, result: Result, steps: _fvi.Recording, shapes: dict[str, tuple[int, ...]]) -> None:
        self.result = result
        self._steps = steps
        self._shapes = shapes

    @property
    def nbytes(self) -> int:
        return self._steps.nbytes

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shapes of the parameters by their names."""
        return dict(self._shapes)

    def gradient(self, q: ArrayLike | None = None, p: ArrayLike | None = None) -> Gradient:
        """The derivatives of the function whose derivatives by the rows of the result are `q` and `p`.

        Parameters
        ----------
        q, p : array_like, optional
            ∂J/∂q and ∂J/∂p, of the shape of `result.q`; default: zeros.

        Returns
        -------
        Gradient

        Raises
        ------
        InputError
            If a shape differs, or gradients of the system are not supported.
        """
        by_position, by_momentum = self._flat("q", q), self._flat("p", p)
        numbers, position, momentum, force = self._steps.gradient(by_position, by_momentum)
        parameters: dict[str, Any] = {}
        used = 0
        for name, shape in self._shapes.items():
            count = int(np.prod(shape, dtype=int))
            own = numbers[used : used + count]
            parameters[name] = own.reshape(shape) if shape else float(own[0])
            used += count
        for name in parameters:
            if (mirror := mirrored(name)) is not None and mirror[0] in parameters:
                parameters[name] *= 0.5
        return Gradient(parameters, position, momentum, force.reshape(-1, len(position)), self.result)

    def _flat(self, name: str, given: ArrayLike | None) -> FloatArray:
        if given is None:
            return np.zeros(0)
        array = _arrays.numbers(name, given)
        if array.shape != self.result.q.shape:
            raise InputError(f"{name}: shape {array.shape}, where that of the result, {self.result.q.shape}, is needed", name)
        return np.ascontiguousarray(array).ravel()

    def __repr__(self) -> str:
        return f"Recording({self.result!r}, {self.nbytes} bytes)"


def gradient_of(recording: Recording, cotangent: Cotangent | Callable[[Result], Any]) -> Gradient:
    """The gradient for cotangents or a function of the result that returns them."""
    by: Any = cotangent(recording.result) if callable(cotangent) else cotangent
    parts = by if isinstance(by, tuple) else (by,)
    if len(parts) > 2:
        raise InputError(f"cotangent: {len(parts)} arrays in place of ∂J/∂q, or of that and ∂J/∂p", "cotangent", str(len(parts)))
    if all(part is None for part in parts):
        raise InputError("cotangent: returned None, where ∂J/∂q is needed, of the shape of `q`", "cotangent", "None")
    return recording.gradient(*by) if isinstance(by, tuple) else recording.gradient(by)


MATRICES = re.compile(r"(.*\b(?:mass|stiffness|gyroscopic|coefficient))\[(\d+)\]\[(\d+)\]")


def mirrored(name: str) -> tuple[str, float] | None:
    """The name of the mirror image of an entry off the diagonal of a matrix, and its sign there; `None` for other numbers."""
    if "][" not in name or (found := MATRICES.fullmatch(name)) is None or found[2] == found[3]:
        return None
    return f"{found[1]}[{found[3]}][{found[2]}]", -1.0 if found[1].endswith("gyroscopic") else 1.0


def numbers_of(
    parameters: Mapping[str, Any] | Sequence[str], size: Callable[[str], int | None]
) -> tuple[dict[str, FloatArray | None], dict[str, tuple[int, ...]]]:
    """The values and the shapes of named parameters; no values where names alone are given. `size` is the length of a vector
    with this name, `None` for a number."""
    if isinstance(parameters, str):
        parameters = [parameters]
    values: dict[str, FloatArray | None] = {}
    shapes: dict[str, tuple[int, ...]] = {}
    for name in parameters:
        count = size(name)
        if not isinstance(parameters, Mapping):
            values[name], shapes[name] = None, () if count is None else (count,)
            continue
        array = _arrays.numbers(name, parameters[name])
        if array.ndim > 1:
            raise InputError(f"{name}: shape {array.shape}, where a number or a vector is needed", name, str(array.shape))
        if count is not None and array.shape not in ((), (count,)):
            raise InputError(f"{name}: {len(array)} numbers, where {count} are needed", name, str(array.shape))
        values[name] = np.full(count, array) if count is not None and array.ndim == 0 else array
        shapes[name] = () if count is None and array.ndim == 0 else (len(array) if count is None else count,)
    return values, shapes
