"""Systems that are integrated several times."""

from __future__ import annotations

import inspect
import json
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike

from fvi import _arrays, _fvi
from fvi._datasets import appearance_of
from fvi._errors import InputError, StepError, suggesting
from fvi._gradient import Cotangent, Gradient, Recording, gradient_of, mirrored, numbers_of
from fvi._integrate import (
    Changes,
    ModelArguments,
    _arguments,
    _integrated,
    _scenario,
    as_it_is,
    described_by,
    integrate,
    named_after_argument,
)
from fvi._result import Result, ending
from fvi._run import Progress, _outside, check_progress, finish, raise_with, result_of
from fvi._runs import Runs, runs_of
from fvi._scenario import SHORT_NAMES, Ready, by_path, key_of, places_of, put, ready
from fvi._system import System
from fvi._terms import Damping
from fvi._types import FloatArray, Whole

DEFAULTS: dict[str, Any] = {
    name: parameter.default
    for name, parameter in inspect.signature(integrate).parameters.items()
    if parameter.kind is inspect.Parameter.KEYWORD_ONLY
}
"""The arguments of `integrate` without its keys, with their defaults."""

MOST_COMPILED = 16
"""Sets of names for which a model stays compiled."""

VECTORS = ("initial.position", "initial.momentum", "initial.velocity")

RIVALS = {"velocity": "momentum", "momentum": "velocity", "steps": "end", "end": "steps"}
"""Arguments that say the same in another way: the one given takes the place of the other."""

TABLES = ("system", "initial", "scheme", "convolution", "time", "history", "output", "event", "input", "controller")
"""Keys that paths of a scenario begin with."""

OPTIONS = ("precision", "check", "progress", "keep_memory")


class _Known(NamedTuple):
    """A compiled model whose numbers of some names differ from run to run."""

    batch: _fvi.Batch
    counts: list[int | None]
    names: dict[str, str]
    coordinates: tuple[int, ...]
    mass: Any
    """The mass, where it is a file."""
    moves: bool
    """Whether velocities and accelerations of each run follow in another way."""
    appearance: tuple[list[str], dict[str, str]]
    """Labels and units."""


class Model:
    """A system that is integrated several times: with other loads, initial states or damping coefficients by `integrate`, with
    other numbers, once by `run` or many times by `batch`.

    Work common to the runs is done once: reading and checking matrices, symbolic factorisation, and the numerical factorisation
    where the matrix of the step is the same, as for other loads and initial states. A damping coefficient that is a multiple of
    an earlier one needs no check either. Results are bit-identical to those of `integrate`. Models are pickled if their functions
    are.

    Parameters
    ----------
    system : System, optional
        The system, in place of the arguments that describe it.
    mass : array_like or sparse matrix
        As in `integrate`; without it there is `kinetic`.
    **arguments
        Other arguments of `integrate`, as defaults for its calls.

    Notes
    -----
    Arrays are copied: later changes of them have no effect. A model keeps its last matrices and factors, two for
    each sparsity pattern, until it is deleted.

    Examples
    --------
    Which damping has the tip of a chain at rest soonest?

    >>> import numpy as np, fvi
    >>> chain = fvi.Model(mass=np.ones(3), stiffness=[[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]],
    ...                   position=[0.1, 0.2, 0.3], step=0.05, end=20.0)
    >>> left = [chain.integrate(damping=fvi.Damping(0.5, rho * np.ones(3))).energy[-1] for rho in (0.1, 0.4)]
    >>> bool(left[1] < left[0])
    True
    """

    def __init__(self, system: System | None = None, **arguments: Unpack[ModelArguments]) -> None:
        self._arguments: dict[str, Any] = {}
        self._prepared = _fvi.Prepared()
        self._compiled: dict[tuple[str, ...], _Known] = {}
        given = described_by(system, {**arguments})
        # Misspelt names are told here and not by the first call.
        by_path(None, {name: value for name, value in given.items() if name not in DEFAULTS}, tuple(DEFAULTS))
        self._size: int | None = None
        if given.get("mass") is not None:
            mass = given["mass"] = ready("mass", given["mass"], None)
            self._size = None if mass.shape == (1,) else mass.shape[0]
        elif given.get("kinetic") is None:
            raise InputError("mass: needed by a model, unless there is `kinetic`", "mass", "None")
        self._arguments = _arrays.copied(self._taken(given))

    def __getstate__(self) -> dict[str, Any]:
        # What has been prepared and compiled is made anew.
        return {"_arguments": self._arguments, "_size": self._size}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _prepared=_fvi.Prepared(), _compiled={})

    def integrate(self, **changes: Unpack[Changes]) -> Result:
        """Integrates it.

        Parameters
        ----------
        **changes
            Arguments of `integrate`, in addition to the model's own or in place of them.

        Returns
        -------
        Result

        Raises
        ------
        InputError, StepError, Exception
            As `integrate`.
        """
        if changes.get("continue_from") is not None:
            # The result itself refers to its system and to the data prepared for it.
            return integrate(**changes)
        arguments = self._merged(self._taken(changes))
        arguments.pop("continue_from")
        options = {name: arguments.pop(name) for name in OPTIONS}
        return _integrated(arguments, prepared=self._prepared, **options)

    def run(self, parameters: Mapping[str, Any] | None = None, *, check: bool = True) -> Result:
        """Integrates it with other numbers, without reading and compiling it again.

        Parameters
        ----------
        parameters : mapping, optional
            Numbers by their names or paths, as in `batch`, one each; for a vector such as ``"position"`` all of its numbers.
        check : bool
            Whether a step that fails raises `StepError`.

        Returns
        -------
        Result
            With the bits of `integrate` for the same numbers.

        Raises
        ------
        InputError, StepError, Exception
            As `integrate`.

        Examples
        --------
        >>> import fvi
        >>> model = fvi.Model(mass=[1.0], potential="0.5*k*q0^2", parameters={"k": 1.0}, position=[1.0], step=0.01, steps=100)
        >>> [model.run({"k": k, "q0": 0.5}).q.shape for k in (1.0, 2.0)]
        [(101, 1), (101, 1)]
        """
        given = _with_mirrors({} if parameters is None else parameters)
        known = self._known(given)
        numbers: list[float] = []
        for name, count in zip(given, known.counts):
            value = given[name]
            if count is None:
                numbers.append(value if isinstance(value, float) else _arrays.real(name, value))
            else:
                array = _arrays.numbers(name, value)
                if array.shape not in ((), (count,)):
                    message = f"{name}: shape {array.shape} instead of ({count},), the number of those of the model"
                    raise InputError(message, name, str(array.shape))
                numbers.extend(np.broadcast_to(array, count).tolist())
        with _renamed(known.names):
            arrays, end, record, raised = known.batch.run_one(numbers)
        return finish(result_of(arrays, end, record, known.mass), raised, check)

    @suggesting
    def batch(
        self,
        parameters: Mapping[str, ArrayLike],
        *,
        jobs: Whole | None = None,
        check: bool = True,
        progress: Progress | None = None,
    ) -> Runs:
        """Integrates it many times, with other numbers in each run, on all cores.

        Each run has the bits of `integrate` for its numbers. What is common is done once: reading and compiling, and the tables of
        memories with equal kernels, steps and lengths.

        Parameters
        ----------
        parameters : mapping of str to array_like
            The numbers that differ, R for R runs, or one for all: by the name of a parameter of the expressions, as ``"k"``; by
            that of a coordinate, momentum or velocity at the start, ``"q0"``, ``"p0"``, ``"v0"``; or by a path,
            ``"damping[0].order"``, ``"damping[0].coefficient[0]"``, ``"parameters.k"``, ``"position[0]"``, ``"mass[0]"``,
            ``"time.step"``, or any other number of the scenario. For vectors, ``"position"``, ``"momentum"``, ``"velocity"`` or a
            path such as ``"damping[0].kernel.strengths"``, R rows of their numbers.
        jobs : int, optional
            Threads; default: one for each core. Functions of Python run on one.
        check : bool
            Whether a run that is refused or fails raises an error, which names its index and has the runs in its `result`. If
            not, `status` and `errors` of the runs tell.
        progress : callable, optional
            Called about ten times a second with the number of runs made and the number of all.

        Returns
        -------
        Runs
            Arrays of shape (R, rows, N), with NaN behind the end of runs that end early.

        Raises
        ------
        InputError
            If there is no such number, or a run is refused: the message begins with its index.
        StepError
            If a step of a run failed, likewise.

        Notes
        -----
        Initial values, parameters of expressions, orders of damping and entries of its diagonal are put into the compiled model;
        for other numbers each run reads the scenario again. While it runs, the process grows by about
        three times the bytes of the result.

        Examples
        --------
        >>> import numpy as np, fvi
        >>> model = fvi.Model(mass=[1.0], potential="0.5*k*q0^2", parameters={"k": 1.0}, position=[1.0], step=0.01, steps=100,
        ...                   damping=fvi.Damping(0.5, 0.1))
        >>> runs = model.batch({"k": np.linspace(1.0, 4.0, 50), "q0": 0.5})
        >>> runs.q.shape
        (50, 101, 1)
        >>> bool((runs[7].q == model.integrate(parameters={"k": np.linspace(1.0, 4.0, 50)[7]}, position=[0.5]).q).all())
        True
        """
        if not isinstance(parameters, Mapping) or not parameters:
            raise InputError("parameters: arrays by the names of the numbers are needed", "parameters", repr(parameters))
        if jobs is not None:
            jobs = _arrays.whole("jobs", jobs, 1)
        progress = check_progress(progress)
        whole = _with_mirrors(parameters)
        known = self._known(whole)
        # What is not finite is refused with its run.
        arrays = {name: _arrays.unchecked(name, values) for name, values in whole.items()}
        columns, given = _columns(arrays, known.counts)
        given = {name: given[name] for name in parameters}
        with _renamed(known.names):
            table, raised = known.batch.run(columns, jobs, progress)
        for index, end in enumerate(table["ends"]):
            if isinstance(end, InputError):
                error = _after_argument(end, known.names)
                table["ends"][index] = InputError(f"run {index}: {error}", error.key, error.value)
        runs = runs_of(table, given, known.coordinates, known.mass, known.appearance)
        runs._described.update(_described(known, columns, runs.status))
        for place, end in runs._ends.items():
            if end["status"] == "failed":
                runs.errors[place] = StepError(f"run {place}: {ending({**end, 'steps': 0})[1]}", runs)
        warned = {text: place for place, texts in reversed(table["warnings"].items()) for text in texts}
        for text, place in warned.items():
            warnings.warn(f"run {place}: {text}", stacklevel=_outside())
        if raised is not None:
            raise_with(raised, runs)
        if check and runs.errors:
            first = runs.errors[min(runs.errors)]
            setattr(first, "result", runs)
            raise first
        return runs

    def gradient(
        self,
        parameters: Mapping[str, ArrayLike] | Sequence[str],
        cotangent: Cotangent | Callable[[Result], Cotangent],
    ) -> Gradient:
        """The derivatives of one function J of the trajectory by any number of parameters, at the price of a few runs.

        The trajectory is integrated once, and its steps are then gone back with their transposed equations: the exact derivative
        of the computed numbers, equal to that of `sensitivities` up to rounding.

        Parameters
        ----------
        parameters : mapping of str to array_like, or sequence of str
            Numbers by their names or paths, as in `run`, and vectors such as ``"position"`` or ``"damping[0].kernel.strengths"``;
            or names alone, for the model's own numbers.
        cotangent : array_like, pair of array_like, or callable
            ∂J/∂q, of the shape of `Result.q`, or ∂J/∂q and ∂J/∂p; or a function of the `Result` that returns them.

        Returns
        -------
        Gradient
            ∂J/∂θ by names, and the derivatives by the initial state and by a force on each coordinate in each step.

        Raises
        ------
        InputError
            If there is no such number, or no gradient of this system.
        StepError, Exception
            As `integrate`.

        Notes
        -----
        The steps take 8 N (2 + s) bytes each, s the unknowns of a coordinate in a step; beyond 512 MB states are saved in place of
        stretches, which are made again.

        Examples
        --------
        How does the distance from data, J = ½ Σ (q − d)², depend on the stiffness, the order, and the load?

        >>> import numpy as np, fvi
        >>> model = fvi.Model(mass=[1.0], potential="0.5*k*q0^2", parameters={"k": 2.0}, damping=fvi.Damping(0.5, 0.1),
        ...                   position=[1.0], step=0.05, steps=200)
        >>> data = model.integrate(parameters={"k": 2.2}).q
        >>> g = model.gradient({"k": 2.0, "damping[0].order": 0.5}, lambda r: r.q - data)
        >>> g["k"] < 0, g.force.shape
        (True, (200, 1))
        """
        return gradient_of(self.record(parameters), cotangent)

    def record(
        self, parameters: Mapping[str, ArrayLike] | Sequence[str] = (), *, most_bytes: int | None = None
    ) -> Recording:
        """Integrates it and keeps the steps, for gradients of several functions.

        Parameters
        ----------
        parameters : mapping of str to array_like, or sequence of str
            As in `gradient`.
        most_bytes : int, optional
            Bytes that a stretch of steps takes at most; default: 512 MB. The states at the ends of earlier stretches are saved in
            place of these.

        Returns
        -------
        Recording

        Raises
        ------
        InputError, StepError, Exception
            As `gradient`.
        """
        arguments = self._merged({})
        if arguments.pop("continue_from") is not None:
            raise InputError("continue_from: belongs to `integrate`, not to a model", "continue_from")
        if arguments["precision"] != "f64":
            raise InputError("precision: gradients are those of double precision", "precision", repr(arguments["precision"]))
        for name in OPTIONS:
            arguments.pop(name)
        if isinstance(parameters, str):
            parameters = [parameters]
        paths = {name: _path(name, arguments) for name in parameters}
        if any(path.startswith("initial.velocity") for path in paths.values()) and arguments["velocity"] is None:
            if arguments["momentum"] is not None:
                raise InputError("velocity: cannot stand beside momentum: give one of them", "velocity")
            arguments["velocity"] = 0.0
        (title, directory, keys, files), functions = _scenario(**arguments)
        size = len(np.atleast_1d(_vector_of((title, directory, keys, files), "position")))
        values, shapes = numbers_of(parameters, lambda name: size if paths[name] in VECTORS else _several_at(keys, paths[name]))
        names = {path: name for name, path in paths.items()}
        asked: list[str] = []
        for name, value in values.items():
            path, shape = paths[name], shapes[name]
            own = [f"{path}[{index}]" for index in range(shape[0])] if shape else [path]
            names.update((f"sensitivity.parameters[{len(asked) + index}]", name) for index in range(len(own)))
            asked += own
            if value is not None:
                put(keys, path, value.tolist())
                if not shape and (mirror := mirrored(path)) is not None and mirror[0] not in names:
                    put(keys, mirror[0], float(mirror[1] * value))
        if asked:
            keys["sensitivity"] = {"parameters": asked}
        with _arguments(), _renamed(names):
            made, end, record, raised, steps = _fvi.record(
                (title, directory, keys, files), self._prepared, most_bytes, functions.terms
            )
        result = finish(result_of(made, end, record, as_it_is(arguments["mass"])), raised, True)
        return Recording(result, steps, shapes)

    def _known(self, given: Mapping[str, Any]) -> _Known:
        """The compiled model whose numbers of these names differ."""
        # Vectors of different lengths are different paths, which `_compiled` checks.
        names = tuple(given)
        known = self._compiled.get(names)
        if known is None:
            if len(self._compiled) >= MOST_COMPILED:
                self._compiled.pop(next(iter(self._compiled)))
            known = self._compiled[names] = self._compile(names)
        return known

    def _compile(self, names: tuple[str, ...]) -> _Known:
        arguments = self._merged({})
        if arguments.pop("continue_from") is not None:
            raise InputError("continue_from: belongs to `integrate`, not to a model", "continue_from")
        precision = arguments["precision"]
        for name in OPTIONS:
            arguments.pop(name)
        moving = [_path(name, arguments) for name in names]
        if any(path.startswith("initial.velocity") for path in moving) and arguments["velocity"] is None:
            if arguments["momentum"] is not None:
                raise InputError("velocity: cannot stand beside momentum: give one of them", "velocity")
            arguments["velocity"] = 0.0
        source, functions = _scenario(**arguments)
        size = len(np.atleast_1d(_vector_of(source, "position")))
        for name, path in zip(names, moving):
            # What is a file for many coordinates has no entries.
            table, _, key = whole = re.split(r"\[\d+\](?!\.)", path, maxsplit=1)[0].partition(".")
            value = _at(source[2], "".join(whole))
            if table == "initial" and isinstance(value, str):
                source[2][table][key] = _vector_of(source, key).tolist()
            elif isinstance(value, str) and value in source[3]:
                message = f"{name}: a matrix of so many coordinates has no numbers here; make a model with another one"
                raise InputError(message, name, path)
        paths: list[str] = []
        counts: list[int | None] = []
        for path in moving:
            count = size if path in VECTORS else _several_at(source[2], path)
            if count is not None:
                counts.append(count)
                paths += [f"{path}[{index}]" for index in range(count)]
            else:
                counts.append(None)
                paths.append(path)
        by_path = {path: name for name, path in zip(names, moving)}
        with _arguments(), _renamed(by_path):
            batch = _fvi.Batch(source, paths, precision, self._prepared, functions.terms, functions.events)
        chosen = source[2].get("output", {}).get("coordinates")
        # The mass of a run that is no file is in its record, with that of the fluid about bodies.
        kept = arguments["mass"]
        mass = kept if isinstance(kept, Ready) or _arrays.is_sparse(kept) else None
        in_words = arguments["kinetic"] is not None
        moves = any(path.startswith(("system.mass", "time.")) or path.endswith(".infinite") or in_words for path in paths)
        written = tuple(range(size) if chosen is None else chosen)
        return _Known(batch, counts, by_path, written, mass, moves, appearance_of(source))

    def _taken(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Arguments with large matrices converted once."""
        taken = dict(given)
        if taken.get("stiffness") is not None:
            taken["stiffness"] = ready("stiffness", taken["stiffness"], self._size)
        if isinstance(terms := taken.get("damping"), (Damping, Mapping)):
            taken["damping"] = terms = [terms]
        if isinstance(terms, (list, tuple)):
            taken["damping"] = [self._damping(f"damping[{index}]", term) for index, term in enumerate(terms)]
        return taken

    def _damping(self, place: str, term: Any) -> Any:
        if isinstance(term, Damping) and _is_large(term.coefficient):
            coefficient = ready(f"{place}.coefficient", term.coefficient, self._size)
            return replace(term, coefficient=coefficient)
        return term

    def _merged(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """The arguments of a call, merged with those of the model."""
        own = {name: value for name, value in self._arguments.items() if RIVALS.get(name) not in changes}
        merged, keys = dict(DEFAULTS), {}
        for name, value in {**own, **changes}.items():
            if name in merged:
                merged[name] = value
            else:
                keys[name] = value
        merged["keys"] = keys
        return merged

    def __repr__(self) -> str:
        size = "any number of" if self._size is None else str(self._size)
        return f"Model({size} coordinates; {', '.join(self._arguments)})"


def _is_large(given: Any) -> bool:
    return _arrays.is_sparse(given) or getattr(given, "ndim", 0) == 2


def _path(name: str, arguments: Mapping[str, Any]) -> str:
    """The path in a scenario of a number that a call names."""
    if not isinstance(name, str):
        raise InputError(f"parameters: {name!r}, where the name of a number is needed", "parameters", repr(name))
    if name in (arguments["parameters"] or {}):
        return f"system.parameters.{name}"
    if match := re.fullmatch(r"([qpv])(\d+)", name):
        letters = {"q": "position", "p": "momentum", "v": "velocity"}
        return f"initial.{letters[match[1]]}[{match[2]}]"
    head = re.split(r"[.\[]", name, maxsplit=1)[0]
    rest = name[len(head) :]
    if head in ("position", "momentum", "velocity", "past"):
        return f"initial.{name}"
    if head in ("parameters", "damping", "mass", "stiffness", "gyroscopic", "load", "element"):
        return f"system.{name}"
    if head in ("loads", "elements"):
        return f"system.{head[:-1]}{rest}"
    if not rest and head in SHORT_NAMES:
        return key_of(head, arguments["keys"])
    if not rest or head not in TABLES:
        import difflib

        known = [*(arguments["parameters"] or {}), "position", "momentum", "velocity", "parameters", "damping", *SHORT_NAMES]
        near = difflib.get_close_matches(head, known, 1)
        advice = f"; did you mean {near[0]}?" if near else ""
        message = f"{name}: no number of the model has this name or path{advice}"
        raise InputError(message, name, name)
    return name


def _vector_of(source: Any, key: str) -> Any:
    """A vector at the start as the scenario has it: numbers, or a file of them."""
    import io

    value = source[2]["initial"][key]
    return np.load(io.BytesIO(source[3][value])) if isinstance(value, str) else value


def _at(keys: Mapping[str, Any], path: str) -> Any:
    """What the scenario has at a path; None where there is nothing."""
    place: Any = keys
    for step in places_of(path):
        try:
            place = place[step]
        except (KeyError, IndexError, TypeError):
            return None
    return place


def _several_at(keys: Mapping[str, Any], path: str) -> int | None:
    """How many numbers the scenario has at a path; None for one, and where there is none."""
    place = _at(keys, path)
    several = isinstance(place, list) and len(place) > 1 and all(isinstance(entry, (int, float)) for entry in place)
    return len(place) if several else None


def _with_mirrors(given: Mapping[str, Any]) -> Mapping[str, Any]:
    """The numbers with those of mirror images: an entry off the diagonal of a matrix is changed together with its own."""
    images = {name: image for name in given if (image := mirrored(name)) is not None and image[0] not in given}
    if not images:
        return given
    added = {image: given[name] if sign > 0.0 else -np.asarray(given[name]) for name, (image, sign) in images.items()}
    return {**given, **added}


def _columns(arrays: Mapping[str, FloatArray], counts: list[int | None]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """The numbers of the runs, a row for each, and by the given names."""
    lengths: dict[str, int] = {}
    for (name, array), count in zip(arrays.items(), counts):
        inner = 0 if count is None else 1
        if array.ndim not in (inner, inner + 1) or (count is not None and array.shape[-1] != count):
            wanted = "one number for each run" if count is None else f"a row of {count} numbers for each run"
            raise InputError(f"{name}: shape {array.shape}, where {wanted} is needed, or one for all", name, str(array.shape))
        if array.ndim > inner:
            lengths[name] = len(array)
    runs = max(lengths.values(), default=1)
    for name, length in lengths.items():
        if length != runs:
            longest = max(lengths, key=lambda other: lengths[other])
            raise InputError(f"{name}: {length} numbers, but {longest} has {runs}", name, str(length))
    if runs == 0:
        raise InputError("parameters: no runs: an array is empty", "parameters", "0")
    given: dict[str, FloatArray] = {}
    parts = []
    for (name, array), count in zip(arrays.items(), counts):
        shape = (runs,) if count is None else (runs, count)
        given[name] = np.broadcast_to(array, shape).copy()
        parts.append(given[name].reshape(runs, -1))
    return np.ascontiguousarray(np.concatenate(parts, axis=1)), given


def _described(known: _Known, columns: FloatArray, status: Any) -> dict[int, dict[str, Any]]:
    """The title of each run that was made, and what velocities and accelerations follow from."""
    there = np.flatnonzero(status != -2).tolist()
    if not there:
        return {}

    def of(place: int) -> dict[str, Any]:
        described: dict[str, Any] = json.loads(known.batch.described(columns[place].tolist(), known.mass is None))
        return described

    return {place: of(place) for place in there} if known.moves else dict.fromkeys(there, of(there[0]))


@contextmanager
def _renamed(names: Mapping[str, str]) -> Iterator[None]:
    """Context in which errors about paths become errors about the names that were given for them."""
    try:
        yield
    except InputError as error:
        raise _after_argument(error, names) from error.__cause__


def _after_argument(error: InputError, names: Mapping[str, str]) -> InputError:
    for path, name in names.items():
        if error.key == path or error.key.startswith((f"{path}[", f"{path}.")):
            key = name + error.key[len(path) :]
            return InputError(str(error).replace(error.key, key, 1), key, error.value)
    return named_after_argument(error)


def checked(model: Any, parameters: Any) -> None:
    """Raises InputError unless these may be a model and its numbers."""
    if not isinstance(model, Model):
        raise InputError(f"model = {model!r}: a fvi.Model is needed", "model", repr(model))
    if not isinstance(parameters, Mapping):
        raise InputError("parameters: numbers by their names are needed", "parameters", repr(parameters))
