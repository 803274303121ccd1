"""Scenarios as dictionaries, and changes to them by the short names of their keys."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from fvi import _arrays, _fvi
from fvi._errors import InputError

class Described:
    """A system that stands for a scenario without initial values and time: `fvi.System`."""

    __slots__ = ()


Scenario = str | os.PathLike[str] | Mapping[str, Any] | Described
"""A scenario file, a dictionary with the same keys, or a system."""

SHORT_NAMES = {
    "title": "title",
    "scheme": "scheme.kind",
    "convolution": "convolution.family",
    "parameters": "system.parameters",
    "sensitivities": "sensitivity.parameters",
    # A key that several tables have is that of the first.
    **{key: f"{table}.{key}" for table, keys in reversed(_fvi.KEYS) for key in keys if key not in ("kind", "family")},
    "tolerance": "history.tolerance",
}
"""Names of arguments, with the keys of a scenario that they stand for."""

RIVALS = {
    "time.steps": "end",
    "time.end": "steps",
    "initial.momentum": "velocity",
    "initial.velocity": "momentum",
}
"""Keys that say the same in another way: the one given takes the place of the other."""


INSTEAD = {
    "t_span": "`start` and `end`",
    "t_eval": "`times`, the times of the rows",
    "dense_output": "nothing: a result is a function of time, `r(t)`",
    "method": "`scheme` and `convolution`",
    "rtol": '`tolerance`, with grid="adaptive"',
    "atol": '`tolerance` and `scale`, with grid="adaptive"',
    "max_step": '`longest`, with grid="adaptive"',
    "first_step": '`first`, with grid="adaptive"',
    "min_step": '`shortest`, with grid="adaptive"',
    "y0": "`position` and `momentum` or `velocity`",
    "x0": "`position` and `momentum` or `velocity`",
    "q0": "`position`",
    "p0": "`momentum`",
    "v0": "`velocity`",
    "dt": "`step`",
    "h": "`step`",
    "args": "`parameters`, named constants of the expressions",
    "jac": "`fvi.Force(value, jacobian)` or `fvi.Potential(value, gradient, hessian)`",
}
"""Names that other packages have for what arguments here say."""

WHOLE = re.compile(
    r"scheme\.(degree|points)|convolution\.(order|stages)|time\.steps|history\.capacity|output\.(every|coordinates\[\d+\])"
)
EXPRESSIONS = re.compile(
    r"system\.(potential|force\[\d+\]|load\[\d+\]\.amplitude|element\[\d+\]\.potential)"
    r"|case\[\d+\]\.load\[\d+\]\.amplitude|event\[\d+\]\.when"
)
"""Keys that take whole numbers, and those that take expressions, in which ``**`` is a power as in Python."""


class Ready:
    """A checked large matrix, as the content of a file."""

    def __init__(self, shape: tuple[int, ...], suffix: str, content: bytes) -> None:
        self.shape = shape
        self.ndim = len(shape)
        self.suffix = suffix
        self.content = content


Files = dict[str, bytes]
"""Contents of files by the names that a scenario has for them."""

MANY = 128
"""Rows from which on matrices and vectors go over as the content of a file: the program keeps such matrices sparse."""

SEVERAL = 32
"""Rows from which on sparse matrices do."""

MATRICES = re.compile(r"system\.(mass|stiffness|gyroscopic|damping\[\d+\]\.(coefficient|attached))")
VECTORS = re.compile(r"(system|case\[\d+\])\.load\[\d+\]\.pattern|initial\.(position|momentum|velocity)")
"""Keys that may name a file."""


def plain(value: Any, path: str, files: Files) -> Any:
    """A value with arrays, NumPy scalars and paths converted to types that a file can contain; entries that are None are left
    out.

    Large matrices and vectors are replaced by names of files, whose contents are added to `files`.
    """
    if isinstance(value, Mapping):
        entries = {str(key): entry for key, entry in value.items() if entry is not None}
        return {key: plain(entry, f"{path}.{key}" if path else key, files) for key, entry in entries.items()}
    if isinstance(value, int) and not -_arrays.LARGEST <= value <= _arrays.LARGEST:
        raise InputError(f"{path} = {value}: not allowed; allowed: whole numbers below 2⁶³", path, str(value))
    if isinstance(value, Ready):
        return _attach(files, path + value.suffix, value.content)
    if isinstance(value, str) and path == "system.force":
        value = [value]
    if isinstance(value, str) and EXPRESSIONS.fullmatch(path):
        return value.replace("**", "^")
    if isinstance(value, (float, np.floating)) and float(value).is_integer() and WHOLE.fullmatch(path):
        return int(value)
    if isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (np.bool_, np.integer, np.floating)):
        return value.item()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if _arrays.is_sparse(value):
        if value.shape[0] > SEVERAL and MATRICES.fullmatch(path):
            return _attach(files, f"{path}.npz", _arrays.npz(path, value))
        value = value.toarray()
    if isinstance(value, np.ndarray):
        kind = value.dtype.kind
        if kind not in "fiubUO":
            raise InputError(f"{path}: an array of {value.dtype}", path, str(value.dtype))
        if value.ndim > 0 and len(value) > MANY and (MATRICES if value.ndim == 2 else VECTORS).fullmatch(path):
            return _attach(files, f"{path}.npy", _arrays.npy(path, value))
        if value.ndim == 1 and path == "system.mass" and len(value) > MANY:
            return _attach(files, f"{path}.npz", _arrays.diagonal_npz(path, value))
        of_whole = WHOLE.fullmatch(f"{path}[0]") is not None
        value = value.tolist()
        if kind in "fib" and not of_whole:
            return value
    if isinstance(value, range):
        return list(value)
    if isinstance(value, (list, tuple)):
        return [plain(entry, f"{path}[{index}]", files) for index, entry in enumerate(value)]
    kind = type(value).__name__
    raise InputError(f"{path} = {value!r}: a scenario cannot hold a value of type {kind}", path, repr(value))


def _attach(files: Files, name: str, content: bytes) -> str:
    files[name] = content
    return name


def symmetric(name: str, given: Any) -> Any:
    """The symmetric part of a matrix that is symmetric to rounding; for a diagonal matrix its diagonal."""
    if isinstance(given, Ready):
        return given
    if _arrays.is_sparse(given):
        entries = given.tocoo()
        for triangle, absent, other in (("upper", entries.row > entries.col, "triu"), ("lower", entries.row < entries.col, "tril")):
            there = entries.row < entries.col if triangle == "upper" else entries.row > entries.col
            if not absent.any() and bool((entries.data[there] != 0.0).any()):
                shift = 1 if triangle == "upper" else -1
                message = (
                    f"{name}: not symmetric: the {triangle} triangle only? Both are needed: "
                    f"{name} + scipy.sparse.{other}({name}, {shift}).T"
                )
                raise InputError(message, name, f"{triangle} triangle")
        if bool((entries.row == entries.col).all()) and name == "mass":
            return _arrays.numbers(name, given.diagonal())
        if given.shape[0] > SEVERAL:
            # The reader of files does the same as the code below.
            return given
        given = _arrays.numbers(name, given.toarray())
    if given.ndim == 1:
        return given
    with np.errstate(over="ignore"):
        off = np.abs(given - given.T)
    row, column = (int(index) for index in np.unravel_index(np.argmax(off), off.shape))
    if off[row, column] > 64 * np.finfo(float).eps * np.abs(given).max():
        message = (
            f"{name}: not symmetric: entry ({row}, {column}) is {given[row, column]}, "
            f"entry ({column}, {row}) is {given[column, row]}"
        )
        raise InputError(message, name, f"entry ({row}, {column})")
    if off[row, column] != 0.0:
        given = 0.5 * given + 0.5 * given.T
    return _by_its_entries(name, given)


FEW = 0.125
"""The part of N² entries up to which an array of more than `SEVERAL` rows goes over by its entries that are not zero."""


def _by_its_entries(name: str, given: Any) -> Any:
    """A full matrix; if it is large and has few nonzero entries, as the content of a file, so that the step is solved with a
    sparse factor."""
    size = given.shape[0]
    if not SEVERAL < size <= MANY or np.count_nonzero(given) > FEW * size * size:
        return given
    return Ready(given.shape, ".npz", _arrays.entries_npz(name, given))


def ready(name: str, given: Any, size: int | None) -> Any:
    """A matrix in the form passed to the compiled part; a large one as the content of a file, for any number of runs."""
    matrix = symmetric(name, _arrays.matrix(name, given, size))
    if isinstance(matrix, Ready):
        return matrix
    if _arrays.is_sparse(matrix):
        if matrix.shape[0] > SEVERAL:
            return Ready(matrix.shape, ".npz", _arrays.npz(name, matrix))
    elif getattr(matrix, "ndim", 0) == 2 and matrix.shape[0] > MANY:
        return Ready(matrix.shape, ".npy", _arrays.npy(name, matrix))
    elif name == "mass" and matrix.shape[0] > MANY:
        return Ready(matrix.shape, ".npz", _arrays.diagonal_npz(name, matrix))
    return matrix


def places_of(path: str) -> list[str | int]:
    """The keys and indices of a path such as ``system.damping[0].order``."""
    steps: list[str | int] = []
    for part in path.split("."):
        match = re.fullmatch(r"([^\[\]]+)((?:\[\d+\])*)", part)
        if not match:
            raise InputError(f"{path}: not the path of a key, such as system.damping[0].order", path)
        steps.append(match[1])
        steps.extend(int(index) for index in re.findall(r"\d+", match[2]))
    return steps


def put(scenario: dict[str, Any], path: str, value: Any) -> None:
    """Sets the value at a path such as ``system.damping[0].order``."""
    steps = places_of(path)
    place: Any = scenario
    for step, following in zip(steps, steps[1:]):
        if isinstance(step, str) and isinstance(place, dict) and isinstance(following, str):
            place = place.setdefault(step, {})
            continue
        try:
            place = place[step]
        except (KeyError, IndexError, TypeError):
            raise InputError(f"{path}: the scenario has no such place", path) from None
    try:
        if isinstance(steps[-1], str):
            if not isinstance(place, dict):
                raise TypeError
            place.pop(RIVALS.get(path, ""), None)
        place[steps[-1]] = value
    except (IndexError, TypeError):
        raise InputError(f"{path}: the scenario has no such place", path) from None


def source(scenario: Scenario, changes: Mapping[str, Any], name: str = "scenario") -> Any:
    """The source for the compiled part: a path, or name, directory, keys and contents of files."""
    changes = {path: value for path, value in changes.items() if value is not None}
    files: Files = {}
    if isinstance(scenario, Mapping):
        keys, directory = plain(scenario, "", files), Path()
    else:
        try:
            path = Path(cast(str, scenario))
        except TypeError:
            kind = type(scenario).__name__
            message = f"scenario: a path or a dictionary is needed, not a value of type {kind}"
            raise InputError(message, "scenario", repr(scenario)) from None
        if not changes:
            return path
        try:
            keys = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            # The compiled reader reports errors with their places in the file.
            return path
        name, directory = str(path), path.parent
    for path_of_key, value in changes.items():
        put(keys, path_of_key, plain(value, path_of_key, files))
    return name, directory, keys, files


def is_adaptive(grid: Any) -> bool:
    """Whether steps are adaptive, so that `tolerance` is that of the steps and not of an engine."""
    return isinstance(grid, str) and grid == "adaptive"


def chooses(scheme: Any) -> bool:
    """Whether `tolerance` is that of the motion, for which scheme and steps are chosen."""
    return isinstance(scheme, str) and scheme == "auto"


def key_of(name: str, short: Mapping[str, Any]) -> str:
    """The key that a short name stands for beside the others."""
    if name == "tolerance" and chooses(short.get("scheme")):
        return "scheme.tolerance"
    if name == "tolerance" and is_adaptive(short.get("grid")):
        return "time.tolerance"
    return SHORT_NAMES[name]


def by_path(
    overrides: Mapping[str, Any] | None, short: Mapping[str, Any], others: Sequence[str] | Callable[..., Any] = ()
) -> dict[str, Any]:
    """Changes given by short names or paths, as a dictionary by paths. `others` are further arguments of the call, which a
    misspelt name may have meant, or the function that was called."""
    changes = {}
    for name, value in short.items():
        if name not in SHORT_NAMES:
            if name in INSTEAD:
                raise InputError(f"{name}: no such argument here; use {INSTEAD[name]}", name, repr(value))
            import difflib
            import inspect

            further = inspect.signature(others).parameters if callable(others) else others
            near = difflib.get_close_matches(name, [*SHORT_NAMES, *further], 1)
            advice = f"did you mean {near[0]}? " if near else ""
            message = f"{name}: no such key; {advice}Names here: {', '.join(SHORT_NAMES)}; others go into overrides by path"
            raise InputError(message, name, repr(value))
        if name == "grid" and value is not None and not isinstance(value, str):
            # The points themselves.
            changes["time.points"], value = value, "points"
        if name == "convolution" and isinstance(value, str) and value == "trapezoidal":
            # The name used by `weights` and `Memory`.
            changes["convolution.symbol"] = value
            continue
        changes[key_of(name, short)] = value
    changes.update(overrides or {})
    return changes
