"""Systems given by arrays, expressions and functions."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fvi import _arrays, _fvi
from fvi._errors import InputError
from fvi._kernel import keys_of
from fvi._result import Result
from fvi._run import Progress, compute, compute_cases
from fvi._scenario import MANY, SEVERAL, SHORT_NAMES, Files, Ready, by_path, source

Function = Callable[..., Any]


@dataclass(frozen=True)
class Potential:
    """A potential U(q) given by functions of an array of N positions.

    Parameters
    ----------
    value : callable
        U(q), a number.
    gradient : callable
        ∇U(q), N numbers.
    hessian : callable, optional
        ∂²U/∂q², N×N numbers. Without it differences of the gradient serve, one call more for each coordinate; the result is
        the same to rounding, since Newton's method corrects for them.
    """

    value: Function
    gradient: Function
    hessian: Function | None = None


@dataclass(frozen=True)
class Force:
    """A force F(t, q) given by functions of the time and an array of N positions.

    Parameters
    ----------
    value : callable
        F(t, q), N numbers; or F(t), if the time is all that it needs: parameters with defaults are its own.
    jacobian : callable, optional
        ∂F/∂q, N×N numbers, as a function of t and q. Without it differences of the force serve, where it takes a position.

    Notes
    -----
    At a grid point a force is asked for within rounding of the time, on the side of the step that asks: a force that jumps at
    a grid point, such as ``8.0*(t <= 1.0)``, jumps between two steps.
    """

    value: Function
    jacobian: Function | None = None


@dataclass(frozen=True)
class Damping:
    """A damping term ρ D^β q, or ρ K(D) q.

    Parameters
    ----------
    order : float, optional
        β, 0 ≤ β < 2.
    coefficient : array_like or sparse matrix, optional
        ρ: a diagonal or a symmetric positive semidefinite matrix.
    derivative : {"caputo", "riemann-liouville"}
        What the derivative acts on.
    attached, strength : array_like or sparse matrix, optional
        In place of `coefficient`: B, N rows and one column for each damper, and their strengths c ≥ 0; ρ = B diag(c) Bᵀ.
    kernel : Kernel, optional
        K in place of `order`.
    allow_active : bool
        Whether a kernel that is not passive is taken.
    """

    order: float | None = None
    coefficient: Any = None
    derivative: str = "caputo"
    attached: Any = None
    strength: ArrayLike | None = None
    kernel: Any = None
    allow_active: bool | None = None


@dataclass(frozen=True)
class Load:
    """A force f a(t): a pattern over the coordinates times an amplitude over time.

    Parameters
    ----------
    pattern : array_like or dict
        f, N numbers; or ``{"coordinate": 17, "value": 1.0}``.
    amplitude : str, callable or (array_like, array_like)
        a: an expression in t and the parameters; a function of t; or times and values, linear in between and zero outside.
    """

    pattern: Any
    amplitude: Any


@dataclass(frozen=True)
class Element:
    """A potential of a few coordinates that acts in many places.

    Parameters
    ----------
    potential : str
        An expression in x0, x1, … and the parameters.
    coordinates : array_like of int, shape (E, n)
        For each place the coordinates that x0, x1, … stand for.
    """

    potential: str
    coordinates: ArrayLike


@dataclass(frozen=True)
class Event:
    """Where a function of the motion passes zero.

    Parameters
    ----------
    when : str
        An expression in t, q0, q1, … and the parameters; with scheme="collocation" in p0, p1, … too.
    direction : {"both", "rising", "falling"}
        Which passages count.
    action : {"record", "stop"}
        Whether the run goes on.
    """

    when: str
    direction: str = "both"
    action: str = "record"


class _Terms(NamedTuple):
    """What the compiled half calls."""

    value: Function | None
    gradient: Function | None
    hessian: Function | None
    force: Function | None
    jacobian: Function | None
    takes_position: bool


def integrate(
    *,
    mass: Any,
    position: ArrayLike,
    step: float | None = None,
    steps: int | None = None,
    end: float | None = None,
    momentum: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    stiffness: Any = None,
    potential: str | Potential | None = None,
    force: str | Sequence[str] | Function | Force | None = None,
    damping: Damping | Mapping[str, Any] | Iterable[Damping | Mapping[str, Any]] = (),
    loads: Load | Iterable[Load] = (),
    elements: Element | Iterable[Element] = (),
    events: Event | Mapping[str, Any] | Iterable[Event | Mapping[str, Any]] = (),
    parameters: Mapping[str, float] | None = None,
    precision: str = "f64",
    check: bool = True,
    progress: Progress | None = None,
    overrides: Mapping[str, Any] | None = None,
    **keys: Any,
) -> Result:
    """Integrates M q̈ + K q + ∇U(q) + Σ ∇U_e(q) = F(t, q) + Σ f a(t) − Σ ρ D^β q.

    Parameters
    ----------
    mass : array_like or sparse matrix
        M: the diagonal, or a symmetric positive definite matrix. It says how many coordinates N there are.
    position : array_like
        q(0), N numbers, or one for all coordinates.
    step, steps, end : number
        Step size h, and either the number of steps or the end of the time; with a `grid`, what that needs.
    momentum, velocity : array_like, optional
        p(0) = M v(0) or v(0); at rest without them.
    stiffness : array_like or sparse matrix, optional
        K, symmetric: adds ½ qᵀKq to the potential.
    potential : str or Potential, optional
        U(q): an expression in q0, q1, … and the parameters, or functions.
    force : str, list of str, callable or Force, optional
        F(t, q): an expression for each coordinate in t, q0, … and the parameters, or a function of (t, q), or of t alone, which
        leaves large systems sparse.
    damping : Damping or list of Damping, optional
        The damping terms; dictionaries with the same keys serve as well.
    loads : Load or list of Load, optional
        Forces of time alone, f a(t).
    elements : Element or list of Element, optional
        Potentials U_e of a few coordinates each.
    events : Event or list of Event, optional
        What to watch for; `Result.events` has what happened. Dictionaries with the same keys serve as well.
    parameters : mapping of str to float, optional
        Named constants of the expressions.
    precision, check, progress, overrides
        As in `run`.
    **keys
        How to integrate, by the names in a scenario: scheme="low-order" (kappa=0.5), "galerkin" (degree, quadrature, points),
        "collocation", "explicit-euler" or "implicit-euler"; convolution="bdf" (order from 1 to 6), "radau-iia" or "lobatto-iiic" (stages);
        at; starting; engine, tolerance, capacity, overflow; every, times, coordinates; allow_unstable; energy_guard; title;
        sensitivities, paths such as "system.damping[0].order" by which the motion is differentiated, `Result.dq` and `Result.dp`; and
        for steps that differ grid="graded" (with end, steps, exponent), grid="geometric" (end, first, ratio, longest),
        grid="adaptive" (end, tolerance, and first, shortest, longest, scale if wanted) or grid=array of times, together with
        must_hit.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        If an argument cannot be used; its `key` names it.
    StepError
        If a step failed; what was computed is in its `result`.
    Exception
        What a function raises ends the step and reaches the caller with its traceback; what was computed until then is in
        the attribute `result` of the exception.

    Notes
    -----
    Sparse matrices of more than 32 rows stay sparse, and so do arrays of more than 128 rows: schemes of degree 1 then solve with a
    sparse Cholesky factor. `coordinates` chooses what the result holds of a large system, `every` and `times` when.

    Functions are called with new arrays, several times a step, from the thread that calls this; with expressions the
    interpreter is released. A function's value may be anything that `numpy.asarray` makes numbers of.

    Examples
    --------
    A mass on a spring with a fractional damper, and the same with functions:

    >>> import numpy as np, fvi
    >>> common = dict(mass=[1.0], position=[1.0], step=0.01, steps=1000,
    ...               damping=fvi.Damping(order=0.5, coefficient=[0.2]), order=2)
    >>> r = fvi.integrate(stiffness=[4.0], **common)
    >>> spring = fvi.Potential(lambda q: 2.0 * q @ q, lambda q: 4.0 * q, lambda q: [[4.0]])
    >>> s = fvi.integrate(potential=spring, **common)
    >>> bool(np.abs(r.q - s.q).max() < 1e-12)
    True

    A pendulum driven by a force that depends on the time only:

    >>> r = fvi.integrate(mass=[1.0], potential="-9.81*cos(q0)", force=lambda t: [np.sin(3.0 * t)],
    ...                   position=[0.1], step=0.01, end=2.0)
    >>> r.q.shape
    (201, 1)

    Steps chosen on the way, until the pendulum is upright:

    >>> r = fvi.integrate(mass=[1.0], potential="-9.81*cos(q0)", position=[-3.0], grid="adaptive", end=10.0, tolerance=1e-8,
    ...                   scheme="collocation", events=fvi.Event("q0", "rising", action="stop"))
    >>> len(r.events), bool(abs(r.q[-1, 0]) < 1e-12)
    (1, True)
    """
    return _integrated(
        dict(
        mass=mass,
        position=position,
        step=step,
        steps=steps,
        end=end,
        momentum=momentum,
        velocity=velocity,
        stiffness=stiffness,
        potential=potential,
        force=force,
        damping=damping,
        loads=loads,
        elements=elements,
        events=events,
        parameters=parameters,
        overrides=overrides,
        keys=keys,
        ),
        precision=precision,
        check=check,
        progress=progress,
    )


def _integrated(
    arguments: dict[str, Any],
    *,
    precision: str,
    check: bool,
    progress: Progress | None,
    prepared: _fvi.Prepared | None = None,
) -> Result:
    """`integrate`, with what a model has prepared."""
    begin = time.perf_counter()
    given, terms = _scenario(**arguments)
    with _arguments():
        spent = time.perf_counter() - begin
        return compute(
            given, precision=precision, check=check, progress=progress, terms=terms, prepared=prepared, spent=spent,
            mass=_as_it_is(arguments["mass"]),
        )


def _as_it_is(mass: Any) -> Any:
    """The mass for velocities, unless its numbers are in the record of the run."""
    if _arrays.is_sparse(mass):
        return mass.copy()
    if isinstance(mass, Ready):
        return mass
    return np.array(mass, dtype=np.float64) if np.ndim(mass) > 0 and len(mass) > MANY else None


def integrate_cases(
    cases: Mapping[str, Load | Iterable[Load]],
    *,
    precision: str = "f64",
    check: bool = True,
    progress: Progress | None = None,
    **arguments: Any,
) -> dict[str, Result]:
    """Integrates a linear system under several load cases together: one factor of its matrices, one pass over it for all.

    Parameters
    ----------
    cases : mapping of str to Load or list of Load
        The loads of each case, by its name; those in `loads` act in every case.
    precision, check, progress
        As in `run`.
    **arguments
        Those of `integrate`; springs in `stiffness`, no potential and no force of functions.

    Returns
    -------
    dict of Result
        By the names of the cases, in their order.

    Raises
    ------
    InputError, StepError, KeyboardInterrupt
        As in `integrate`; the `result` of an exception is a dictionary, too.

    Examples
    --------
    >>> import numpy as np, fvi
    >>> K = np.array([[300.0, -100.0], [-100.0, 100.0]])
    >>> results = fvi.integrate_cases(
    ...     {"top": fvi.Load([0.0, 1.0], "sin(5*t)"), "both": fvi.Load([1.0, 1.0], "sin(5*t)")},
    ...     mass=[2.0, 1.0], stiffness=K, damping=fvi.Damping(0.5, 0.02 * K), position=0.0, step=0.001, steps=1000,
    ... )
    >>> bool(np.ptp(results["top"].q[:, 1]) < np.ptp(results["both"].q[:, 1]))
    True
    """
    if not isinstance(cases, Mapping):
        raise InputError("cases: a mapping of names to loads is needed", "cases", repr(cases))
    if not cases:
        raise InputError("cases: none are given", "cases", repr(cases))
    bound = inspect.signature(integrate).bind(**arguments)
    bound.apply_defaults()
    others = {name: value for name, value in bound.arguments.items() if name not in ("precision", "check", "progress")}
    given, terms = _scenario(**others, cases=cases)
    if terms is not None:
        raise InputError("cases: need a linear system, without functions for potential and force", "cases")
    with _arguments():
        return compute_cases(given, precision=precision, check=check, progress=progress)


def _scenario(
    *,
    mass: Any,
    position: Any,
    step: Any,
    steps: Any,
    end: Any,
    momentum: Any,
    velocity: Any,
    stiffness: Any,
    potential: Any,
    force: Any,
    damping: Any,
    loads: Any,
    elements: Any,
    events: Any,
    parameters: Any,
    overrides: Any,
    keys: dict[str, Any],
    cases: Mapping[str, Any] | None = None,
) -> tuple[Any, _Terms | None]:
    """The scenario of the arguments of `integrate`, for the compiled half, and the functions beside it."""
    matrix = _symmetric("mass", _arrays.matrix("mass", mass))
    if matrix.shape == (1,) and np.ndim(mass) == 0:
        matrix = np.full(max(1, np.size(position)), matrix[0])
    size = matrix.shape[0]
    system: dict[str, Any] = {"mass": matrix}
    if parameters is not None:
        system["parameters"] = dict(parameters)
    texts, functions, force_texts = _terms(potential, force)
    if stiffness is not None:
        system["stiffness"] = _symmetric("stiffness", _arrays.matrix("stiffness", stiffness, size))
    if texts:
        system["potential"] = " + ".join(texts)
    if force_texts is not None:
        system["force"] = force_texts
    system["damping"] = _damping(damping, size)
    scenario: dict[str, Any] = {"system": system}
    files: Files = {}
    driven: list[tuple[Any, Function]] = []
    if entries := _loads(loads, "loads", "system.load", size, files, driven):
        system["load"] = entries
    if driven:
        functions = _with_loads(functions, driven)
    if cases is not None:
        scenario["case"] = [
            {"name": str(name), "load": _loads(given, f"cases[{name!r}]", f"case[{index}].load", size, files)}
            for index, (name, given) in enumerate(cases.items())
        ]
    _elements(system, elements)
    watched = _events(events)
    if watched:
        scenario["event"] = watched
    initial: dict[str, Any] = {"position": _arrays.vector("position", position, size)}
    if velocity is not None and momentum is None:
        initial["velocity"] = _arrays.vector("velocity", velocity, size)
    else:
        initial["momentum"] = _arrays.vector("momentum", 0.0 if momentum is None else momentum, size)
        if velocity is not None:
            raise InputError("velocity: cannot stand beside momentum: give one of them", "velocity")
    changes = by_path(overrides, keys)
    if isinstance(chosen := changes.get("output.coordinates"), slice):
        changes["output.coordinates"] = list(range(size))[chosen]
    scenario["initial"] = initial
    scenario["time"] = _time(step, steps, end, changes.get("time.grid"))
    # A file has to choose its columns; whoever asks for arrays gets them all.
    if size > MOST_COLUMNS and changes.get("output.coordinates") is None:
        changes["output.coordinates"] = range(size)
    terms = functions if any((functions.gradient, functions.force)) else None
    with _arguments():
        given = source(scenario, changes)
    given[3].update(files)
    return given, terms


MOST_COLUMNS = 64
"""Coordinates of a large system up to which a scenario writes all of them without being asked."""


def _time(step: Any, steps: Any, end: Any, grid: Any) -> dict[str, Any]:
    time: dict[str, Any] = {}
    if step is not None:
        time["step"] = step if isinstance(step, int) else _arrays.real("step", step)
    if steps is not None:
        if isinstance(steps, (float, np.floating)) and float(steps).is_integer():
            steps = int(steps)
        time["steps"] = _arrays.whole("steps", steps)
    if end is not None:
        time["end"] = _arrays.real("end", end)
    if grid is None or grid == "uniform":
        if step is None:
            raise InputError("step: needed, unless there is a grid with other steps", "step", "None")
        if (steps is None) == (end is None):
            raise InputError("steps: give either steps or end", "steps")
    return time


def _with_loads(functions: _Terms, driven: list[tuple[Any, Function]]) -> _Terms:
    """The functions, with loads whose amplitudes are functions of time added to the force."""
    push, takes_position = functions.force, functions.takes_position

    def loads(t: float) -> Any:
        total = 0.0
        for index, (pattern, amplitude) in enumerate(driven):
            value = _arrays.returned(f"loads[{index}].amplitude", amplitude(t))
            if value.size != 1:
                name = f"loads[{index}].amplitude"
                raise InputError(f"{name} has returned {value.size} numbers; one is needed", name, str(value.shape))
            total = total + pattern * float(value.reshape(()))
        return total

    def pushed(*arguments: Any) -> Any:
        own = 0.0 if push is None else _arrays.returned("force", push(*arguments))
        return own + loads(arguments[0])

    return functions._replace(force=pushed, takes_position=push is not None and takes_position)


def _loads(
    given: Any, argument: str, key: str, size: int, files: Files, driven: list[tuple[Any, Function]] | None = None
) -> list[dict[str, Any]]:
    """The entries of loads under a key of the scenario; the records of their amplitudes go to `files`, patterns with amplitudes
    that are functions to `driven`."""
    loads = []
    for index, load in enumerate(_arrays.several(argument, given, (Load, Mapping), "a fvi.Load")):
        place = f"{argument}[{index}]"
        if isinstance(load, Load):
            load = {"pattern": load.pattern, "amplitude": load.amplitude}
        if not isinstance(load, Mapping):
            raise InputError(f"{place} = {load!r}: a fvi.Load is needed", place, repr(load))
        entries = dict(load)
        pattern, amplitude = entries.get("pattern"), entries.get("amplitude")
        if pattern is not None and not isinstance(pattern, (Mapping, str)):
            if _arrays.is_sparse(pattern):
                pattern = pattern.toarray().ravel()
            entries["pattern"] = _arrays.vector(f"{place}.pattern", pattern, size)
        if callable(amplitude):
            if driven is None:
                name = f"{place}.amplitude"
                raise InputError(f"{name}: an expression or a record is needed in a load case", name, repr(amplitude))
            if isinstance(pattern, Mapping):
                coordinate = _arrays.whole(f"{place}.pattern.coordinate", pattern.get("coordinate"))
                if coordinate >= size:
                    name, value = f"{place}.pattern.coordinate", str(coordinate)
                    raise InputError(f"{name} = {value}: not allowed; allowed: a coordinate below {size}", name, value)
                entries["pattern"] = np.zeros(size)
                entries["pattern"][coordinate] = _arrays.real(f"{place}.pattern.value", pattern.get("value", 1.0))
            elif pattern is None or isinstance(pattern, str):
                name = f"{place}.pattern"
                raise InputError(f"{name} = {pattern!r}: numbers are needed with a function of time", name, repr(pattern))
            driven.append((entries["pattern"], amplitude))
            continue
        if isinstance(amplitude, (tuple, list)):
            name = f"{key}[{index}].csv"
            files[name] = _record(f"{place}.amplitude", amplitude)
            entries["amplitude"] = {"file": name}
        loads.append(entries)
    return loads


def _record(name: str, given: Sequence[Any]) -> bytes:
    """Times and values as the file of a record."""
    if len(given) != 2:
        raise InputError(f"{name}: {len(given)} entries instead of times and values", name, str(len(given)))
    times, values = (_arrays.numbers(f"{name}[{index}]", column) for index, column in enumerate(given))
    if times.ndim != 1 or times.shape != values.shape:
        shapes = f"{times.shape} and {values.shape}"
        raise InputError(f"{name}: shapes {shapes} instead of two of the same length", name, shapes)
    early = np.flatnonzero(np.diff(times) <= 0.0)
    if early.size > 0:
        index = int(early[0]) + 1
        value = str(times[index])
        raise InputError(f"{name}[0][{index}] = {value}: not allowed; allowed: times that increase", f"{name}[0][{index}]", value)
    rows = (f"{time!r},{value!r}\n" for time, value in zip(times.tolist(), values.tolist()))
    return ("t,a\n" + "".join(rows)).encode()


def _elements(system: dict[str, Any], given: Any) -> None:
    """Puts elements into a system."""
    for index, element in enumerate(_arrays.several("elements", given, (Element, Mapping), "a fvi.Element")):
        place = f"elements[{index}]"
        if isinstance(element, Element):
            element = {"potential": element.potential, "coordinates": element.coordinates}
        if not isinstance(element, Mapping):
            raise InputError(f"{place} = {element!r}: a fvi.Element is needed", place, repr(element))
        system.setdefault("element", []).append(dict(element))


def _events(given: Any) -> list[dict[str, Any]]:
    """Events as a scenario has them."""
    entries = []
    for index, event in enumerate(_arrays.several("events", given, (Event, Mapping), "a fvi.Event")):
        place = f"events[{index}]"
        if isinstance(event, Event):
            event = {"when": event.when, "direction": event.direction, "action": event.action}
        if not isinstance(event, Mapping):
            raise InputError(f"{place} = {event!r}: a fvi.Event is needed", place, repr(event))
        entries.append(dict(event))
    return entries


def _terms(
    potential: str | Potential | None, force: str | Sequence[str] | Function | Force | None
) -> tuple[list[str], _Terms, list[str] | None]:
    """Expressions of the potential, functions, expressions of the force."""
    texts: list[str] = []
    value = gradient = hessian = push = jacobian = None
    takes_position = False
    force_texts = None
    if isinstance(potential, str):
        texts.append(f"({potential})")
    elif isinstance(potential, Potential):
        value, gradient, hessian = potential.value, potential.gradient, potential.hessian
        for name, function in (("value", value), ("gradient", gradient), ("hessian", hessian)):
            if not callable(function) and not (name == "hessian" and function is None):
                raise InputError(f"potential.{name} = {function!r}: a function is needed", f"potential.{name}", repr(function))
    elif potential is not None:
        message = "potential: an expression in quotes or a fvi.Potential with value, gradient and hessian is needed"
        raise InputError(message, "potential", repr(potential))
    if isinstance(force, str):
        force_texts = [force]
    elif isinstance(force, Force) or callable(force):
        push, jacobian = (force.value, force.jacobian) if isinstance(force, Force) else (force, None)
        if not callable(push):
            raise InputError(f"force.value = {push!r}: a function is needed", "force.value", repr(push))
        takes_position = _takes_position(push)
    elif force is not None:
        force_texts = list(force)
        for index, text in enumerate(force_texts):
            if not isinstance(text, str):
                message = f"force[{index}] = {text!r}: an expression in quotes is needed; or give a function of (t, q)"
                raise InputError(message, f"force[{index}]", repr(text))
    return texts, _Terms(value, gradient, hessian, push, jacobian, takes_position), force_texts


def _takes_position(function: Function) -> bool:
    """Whether a force is a function of time and position, or of time alone."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return True
    try:
        signature.bind(0.0)
    except TypeError:
        return True
    # A second parameter that has a default, as in ``lambda t, a=a: …``, is the function's own.
    return any(parameter.kind is inspect.Parameter.VAR_POSITIONAL for parameter in signature.parameters.values())


def _symmetric(name: str, given: Any) -> Any:
    """A matrix that is symmetric to rounding, as its symmetric part; the diagonal, where that is all there is."""
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
            # The reader of files does as is done below.
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
    return given if off[row, column] == 0.0 else 0.5 * given + 0.5 * given.T


def ready(name: str, given: Any, size: int | None) -> Any:
    """A matrix as it goes over; a large one as the content of a file, for any number of runs."""
    matrix = _symmetric(name, _arrays.matrix(name, given, size))
    if _arrays.is_sparse(matrix):
        if matrix.shape[0] > SEVERAL:
            return Ready(matrix.shape, ".npz", _arrays.npz(name, matrix))
    elif getattr(matrix, "ndim", 0) == 2 and matrix.shape[0] > MANY:
        return Ready(matrix.shape, ".npy", _arrays.npy(name, matrix))
    elif name == "mass" and matrix.shape[0] > MANY:
        return Ready(matrix.shape, ".npz", _arrays.diagonal_npz(name, matrix))
    return matrix


def _damping(given: Any, size: int) -> list[dict[str, Any]]:
    terms = []
    for index, term in enumerate(_arrays.several("damping", given, (Damping, Mapping), "a fvi.Damping")):
        place = f"damping[{index}]"
        if isinstance(term, Damping):
            term = {field.name: getattr(term, field.name) for field in fields(term)}
        if not isinstance(term, Mapping):
            raise InputError(f"{place} = {term!r}: a fvi.Damping is needed", place, repr(term))
        entries = {key: value for key, value in dict(term).items() if value is not None}
        if "order" in entries:
            entries["order"] = _arrays.real(f"{place}.order", entries["order"])
        if "kernel" in entries:
            entries["kernel"] = keys_of(f"{place}.kernel", entries["kernel"])
        if "coefficient" in entries:
            name = f"{place}.coefficient"
            coefficient = _arrays.matrix(name, entries["coefficient"], size)
            entries["coefficient"] = _symmetric(name, coefficient)
        if "attached" in entries and not _arrays.is_sparse(entries["attached"]):
            entries["attached"] = _arrays.numbers(f"{place}.attached", entries["attached"])
        terms.append(entries)
    return terms


@contextmanager
def _arguments() -> Iterator[None]:
    """Errors about keys of the scenario become those about the arguments."""
    try:
        yield
    except InputError as error:
        raise _named_after_argument(error) from error.__cause__


def _named_after_argument(error: InputError) -> InputError:
    """An error about a key of a scenario, as one about the argument that it came from."""
    arguments = {path: name for name, path in SHORT_NAMES.items()} | {
        f"system.{name}": name for name in ("mass", "stiffness", "potential", "force", "damping")
    }
    arguments |= {"system.load": "loads", "system.element": "elements", "case": "cases", "event": "events"}
    arguments |= {"time.points": "grid", "time.tolerance": "tolerance"}
    for path, name in arguments.items():
        if error.key == path or error.key.startswith((f"{path}.", f"{path}[")):
            key = name + error.key[len(path) :]
            text = str(error).replace(error.key, key, 1)
            for suffix in (".npz", ".npy"):
                # The file that an array went over as is nobody's.
                file = error.key + suffix
                text = text.replace(f'{key} = "{file}": {file}: ', f"{key}: ", 1)
            renamed = InputError(text, key, error.value)
            return renamed.with_traceback(error.__traceback__)
    return error


