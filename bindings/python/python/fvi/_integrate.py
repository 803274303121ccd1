"""Systems given by arrays, expressions and functions."""

from __future__ import annotations

import inspect
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from fvi import _arrays, _fvi
from fvi._errors import InputError
from fvi._result import Result
from fvi._run import Progress, compute, compute_cases
from fvi._scenario import SEVERAL, SHORT_NAMES, Files, Ready, by_path, chooses, source, symmetric
from fvi._system import System
from fvi._terms import (
    Damping,
    Element,
    Event,
    Force,
    Function,
    Functions,
    Load,
    Potential,
    damping_of,
    elements_of,
    events_of,
    loads_of,
    on_its_pattern,
    terms_of,
    with_loads,
)
from fvi._types import OutputKeys, Precision, Real, ScenarioKeys, Whole


def integrate(
    system: System | None = None,
    *,
    mass: Any = None,
    position: ArrayLike | None = None,
    step: Real | None = None,
    steps: Whole | None = None,
    end: Real | None = None,
    momentum: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    start: Real | None = None,
    past: Any = None,
    continue_from: Result | None = None,
    stiffness: Any = None,
    gyroscopic: Any = None,
    potential: str | Potential | None = None,
    force: str | Sequence[str] | Function | Force | None = None,
    damping: Damping | Mapping[str, Any] | Iterable[Damping | Mapping[str, Any]] = (),
    loads: Load | Iterable[Load] = (),
    elements: Element | Iterable[Element] = (),
    events: Event | Mapping[str, Any] | Iterable[Event | Mapping[str, Any]] = (),
    parameters: Mapping[str, Real] | None = None,
    precision: Precision = "f64",
    check: bool = True,
    progress: Progress | None = None,
    keep_memory: bool | None = None,
    overrides: Mapping[str, Any] | None = None,
    kinetic: str | None = None,
    constraints: Sequence[str] = (),
    project: bool | None = None,
    **keys: Unpack[OutputKeys],
) -> Result:
    """Integrates M q̈ + G q̇ + K q + ∇U(q) + Σ ∇U_e(q) = F(t, q) + Σ f a(t) − Σ ρ D^β q.

    Parameters
    ----------
    system : System, optional
        The system, in place of the arguments that describe it.
    mass : array_like or sparse matrix
        M: the diagonal, or a symmetric positive definite matrix. It determines the number of coordinates N. Zeros in the
        diagonal, or rows of zeros in a matrix, are coordinates without mass, on which stiffness or damping must act. Their
        momentum is 0. Where only stiffness acts on them, an initial position of 0 is replaced by the one at which their forces
        balance.
    position : array_like
        q(t₀), N numbers, or one for all coordinates. With samples as `past` it may be left out.
    step, steps, end : number
        Step size h, and either the number of steps or the last time; with a `grid`, the arguments that it needs.
    momentum, velocity : array_like, optional
        p(t₀) = M v(t₀) or v(t₀); default: at rest.
    start : float, optional
        t₀ ≥ 0, the time at which the motion begins; default: 0.
    past : (float, callable) or (array_like, array_like), optional
        The motion before t₀, which the memories contain: either the time at which the past begins and q(t) as a function, or
        times t₀ − m h, …, t₀ − h, optionally t₀, and the positions at them. Before its first time the system is at rest at its
        first position, without a past at q(t₀); for Riemann–Liouville damping it is at zero.
    continue_from : Result, optional
        A result of this function from which to continue, with its memory. Allowed beside it are only `steps` (number of further
        steps) or a later `end`, `every`, `times`, `coordinates`, `check`, `progress` and `keep_memory`. The first row is the last
        one of that result.
    stiffness : array_like or sparse matrix, optional
        K, symmetric: adds ½ qᵀKq to the potential.
    gyroscopic : array_like or sparse matrix, optional
        G, skew-symmetric: forces −G q̇, which do no work. The matrix of a step is then a full one.
    potential : str or Potential, optional
        U(q): an expression in q0, q1, … and the parameters, or functions.
    force : str, list of str, callable or Force, optional
        F(t, q, v): an expression for each coordinate in t, q0, …, v0, … and the parameters, or a function of (t, q, v), (t, q) or
        t. With a function of t alone large systems stay sparse.
    damping : Damping or list of Damping, optional
        The damping terms; dictionaries with the same keys serve as well.
    loads : Load or list of Load, optional
        Forces that depend on time only, f a(t).
    elements : Element or list of Element, optional
        Potentials U_e of a few coordinates each.
    events : Event or list of Event, optional
        Events to be detected; `Result.events` lists those that occurred. Dictionaries with the same keys serve as well.
    parameters : mapping of str to float, optional
        Named constants of the expressions.
    kinetic : str, optional
        In place of `mass`: T(q, v) of the Lagrangian T − U, an expression of degree 2 in v0, v1, …, for as many coordinates as
        `position` has.
    constraints : list of str, optional
        Expressions in q0, q1, …, each 0 along the motion; `Result.multipliers` has their λ.
    project : bool, optional
        Whether position and velocity are moved onto the constraints first.
    precision, check, progress, overrides
        As in `run`.
    keep_memory : bool, optional
        Whether a later run can continue from the result. Default: if the memory takes at most as many bytes as the rows, or 16
        million.
    **keys
        How to integrate, by the names in a scenario: scheme="low-order" (kappa=0.5), "galerkin" (degree, quadrature, points),
        "collocation", "energy", "explicit-euler" or "implicit-euler", or scheme="auto" with a `tolerance` of positions and momenta,
        relative to their size, which chooses scheme, grid and step (then `step` is the time between rows, and may be left out; the
        choice is in `Result.summary["choice"]`); convolution="bdf" (order from 1 to 6), "radau-iia" or
        "lobatto-iiic" (stages), "gauss" or "trapezoidal", likewise symbol="trapezoidal"; at; starting; engine, tolerance, horizon, capacity, overflow, states, threads;
        every, times, coordinates; allow_unstable; energy_guard; title;
        sensitivities, paths such as "system.damping[0].order" of the numbers with respect to which the motion is differentiated
        (`Result.dq` and `Result.dp`); memory_energy=True for `Result.memory_stored` and `Result.memory_dissipated`; and for steps
        of different lengths grid="graded" (with end, steps, exponent), grid="geometric" (end, first, ratio, longest),
        grid="adaptive" (end, tolerance; optional: first, shortest, longest, scale) or grid=array of times, together with
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
        An exception raised by a function ends the run and is passed to the caller with its traceback; its attribute `result`
        contains what was computed until then.

    Notes
    -----
    Sparse matrices of more than 32 rows stay sparse, and so do arrays of more than 128 rows: schemes of degree 1, and of
    degree 2 on two Gauss points (`scheme="galerkin", degree=2, order=3` or `4`), then solve with a sparse factor.
    `coordinates` selects the coordinates of a large system that the result contains, `every` and `times` the rows.

    Functions are called with new arrays, several times a step, from the calling thread; with expressions only, the interpreter
    lock is released. A function may return anything that `numpy.asarray` converts to numbers.

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

    Adaptive steps, until the pendulum is upright:

    >>> r = fvi.integrate(mass=[1.0], potential="-9.81*cos(q0)", position=[-3.0], grid="adaptive", end=10.0, tolerance=1e-8,
    ...                   scheme="collocation", events=fvi.Event("q0", "rising", action="stop"))
    >>> len(r.events), bool(abs(r.q[-1, 0]) < 1e-12)
    (1, True)
    """
    if continue_from is not None:
        others = dict(
            mass=mass, position=position, step=step, momentum=momentum, velocity=velocity, start=start, past=past,
            stiffness=stiffness, gyroscopic=gyroscopic, potential=potential, force=force, damping=damping, loads=loads,
            elements=elements, events=events, parameters=parameters, overrides=overrides, kinetic=kinetic,
            constraints=tuple(constraints), project=project, system=system,
        )
        others = {name: value for name, value in others.items() if not (value is None or value == ())}
        if precision != "f64":
            others["precision"] = precision
        return _continued(continue_from, steps, end, {**others, **keys}, check, progress, keep_memory)
    return _integrated(
        described_by(system, dict(
        mass=mass,
        position=position,
        step=step,
        steps=steps,
        end=end,
        momentum=momentum,
        velocity=velocity,
        start=start,
        past=past,
        stiffness=stiffness,
        gyroscopic=gyroscopic,
        potential=potential,
        force=force,
        damping=damping,
        loads=loads,
        elements=elements,
        events=events,
        parameters=parameters,
        overrides=overrides,
        keys=keys,
        kinetic=kinetic,
        constraints=constraints,
        project=project,
        )),
        precision=precision,
        check=check,
        progress=progress,
        keep_memory=keep_memory,
    )


class Arguments(ScenarioKeys, total=False):
    """The arguments of `integrate` that describe a run, without the `system` as a whole."""

    mass: Any
    stiffness: Any
    gyroscopic: Any
    potential: str | Potential | None
    force: str | Sequence[str] | Function | Force | None
    damping: Damping | Mapping[str, Any] | Iterable[Damping | Mapping[str, Any]]
    loads: Load | Iterable[Load]
    elements: Element | Iterable[Element]
    events: Event | Mapping[str, Any] | Iterable[Event | Mapping[str, Any]]
    overrides: Mapping[str, Any] | None
    kinetic: str | None
    constraints: Sequence[str]


class ModelArguments(Arguments, total=False):
    """The same with those that say how a call goes."""

    precision: Precision
    check: bool
    progress: Progress | None
    keep_memory: bool | None


class Changes(ModelArguments, total=False):
    """All arguments of `integrate` but the `system`."""

    continue_from: Result | None


def described_by(system: System | None, arguments: dict[str, Any]) -> dict[str, Any]:
    """Arguments of `integrate` with those of a system."""
    if system is None:
        return arguments
    if not isinstance(system, System):
        raise InputError(f"system = {system!r}: a fvi.System is needed; matrices are given by their names", "system", repr(system))
    return system.merged(arguments)


ARGUMENTS = tuple(inspect.signature(integrate).parameters)[:-1]
"""The arguments of `integrate` apart from keys of a scenario."""

MORE = ("every", "times", "coordinates")
"""Keys that may stand beside `continue_from`."""


def _continued(
    before: Result,
    steps: Any,
    end: Any,
    others: Mapping[str, Any],
    check: bool,
    progress: Progress | None,
    keep_memory: bool | None,
) -> Result:
    """`integrate`, continuing from a result."""
    if not isinstance(before, Result):
        raise InputError(f"continue_from = {before!r}: a result of fvi.integrate is needed", "continue_from", repr(before))
    for name, value in others.items():
        if name not in MORE and value is not None:
            message = (
                f"{name}: cannot stand beside continue_from, which goes on with the same system and scheme; allowed beside it: steps, "
                f"end, {', '.join(MORE)}, check, progress, keep_memory"
            )
            raise InputError(message, name, repr(value))
    known = before._continuation
    if known is None:
        message = f"continue_from: {before._why_not}"
        raise InputError(message, "continue_from", repr(before))
    if (steps is None) == (end is None):
        raise InputError("steps: give either steps or end", "steps")
    changes = by_path(None, {name: value for name, value in others.items() if value is not None})
    name, directory, keys, files = known.given
    time = {key: value for key, value in keys["time"].items() if key not in ("steps", "end")}
    if steps is not None:
        if isinstance(steps, (float, np.floating)) and float(steps).is_integer():
            steps = int(steps)
        time["steps"] = known.snapshot.steps + _arrays.whole("steps", steps)
    else:
        time["end"], reached = _arrays.real("end", end), float(before.summary["last"]["time"])
        if time["end"] < reached:
            allowed = f"a time from {reached} on, where the result ends"
            raise InputError(f"end = {time['end']}: not allowed; allowed: {allowed}", "end", str(time["end"]))
    keys = {**keys, "time": time}
    if "output.times" in changes and "output" in keys:
        keys["output"] = {key: value for key, value in keys["output"].items() if key != "every"}
    if isinstance(chosen := changes.get("output.coordinates"), slice):
        changes["output.coordinates"] = list(range(len(before.summary["last"]["position"])))[chosen]
    with _arguments():
        _, _, keys, more = source(keys, changes)
        result = compute(
            (name, directory, keys, {**files, **more}), engine=known.engine, precision=known.precision, check=check,
            progress=progress, functions=known.functions, prepared=known.prepared, mass=before._mass, keep_memory=keep_memory,
            snapshot=known.snapshot, junction=before,
        )
    return result


def _integrated(
    arguments: dict[str, Any],
    *,
    precision: str,
    check: bool,
    progress: Progress | None,
    keep_memory: bool | None = None,
    prepared: _fvi.Prepared | None = None,
) -> Result:
    """`integrate`, with what a model has prepared."""
    begin = time.perf_counter()
    given, functions = _scenario(**arguments)
    with _arguments():
        spent = time.perf_counter() - begin
        return compute(
            given, precision=precision, check=check, progress=progress, functions=functions, prepared=prepared, spent=spent,
            mass=as_it_is(arguments["mass"]), keep_memory=keep_memory,
        )


def as_it_is(mass: Any) -> Any:
    """The mass for computing velocities, unless the summary of the run contains it."""
    if _arrays.is_sparse(mass):
        return mass.copy()
    if isinstance(mass, Ready):
        return mass
    return np.array(mass, dtype=np.float64) if np.ndim(mass) > 0 and len(mass) > SEVERAL else None


def integrate_cases(
    cases: Mapping[str, Load | Iterable[Load]],
    system: System | None = None,
    *,
    precision: Precision = "f64",
    check: bool = True,
    progress: Progress | None = None,
    **arguments: Unpack[Arguments],
) -> dict[str, Result]:
    """Integrates a linear system under several load cases together: with one factorisation of its matrices and one pass over the
    factor for all of them.

    Parameters
    ----------
    cases : mapping of str to Load or list of Load
        The loads of each case, by its name; those in `loads` act in every case.
    system : System, optional
        The system, in place of the arguments that describe it.
    precision, check, progress
        As in `run`.
    **arguments
        Those of `integrate`; springs must be in `stiffness`; no potential, and no force by functions.

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
    if "continue_from" in arguments:
        raise InputError("continue_from: cannot stand beside cases, whose results have no memory", "continue_from")
    bound = inspect.signature(integrate).bind(system, **arguments)
    bound.apply_defaults()
    others = described_by(bound.arguments.pop("system"), {**bound.arguments})
    for name in ("precision", "check", "progress", "keep_memory", "continue_from"):
        del others[name]
    given, functions = _scenario(**others, cases=cases)
    if functions.terms is not None:
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
    start: Any,
    past: Any,
    stiffness: Any,
    gyroscopic: Any,
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
    kinetic: str | None = None,
    constraints: Sequence[str] = (),
    project: bool | None = None,
) -> tuple[Any, Functions]:
    """The scenario for the arguments of `integrate`, for the compiled part, and the functions among them."""
    # First, since an argument that is missing may be one that is misspelt.
    changes = by_path(overrides, keys, ARGUMENTS)
    if mass is None and kinetic is None:
        raise InputError("mass: needed, unless there is `kinetic` or a result to continue_from", "mass", "None")
    if mass is not None and kinetic is not None:
        raise InputError("kinetic: cannot stand beside mass: give one of them", "kinetic")
    time = _time(start, step, steps, end, keys.get("grid"), keys.get("scheme"))
    samples = None if past is None else _Past(past, time)
    if position is None and samples is not None and samples.end is not None:
        position = samples.end
    if position is None:
        raise InputError("position: needed", "position", "None")
    system: dict[str, Any]
    if mass is None:
        size, system = int(np.size(position)), {"kinetic": kinetic}
    else:
        matrix = symmetric("mass", _arrays.matrix("mass", mass))
        if matrix.shape == (1,) and np.ndim(mass) == 0:
            matrix = np.full(max(1, np.size(position)), matrix[0])
        size, system = matrix.shape[0], {"mass": matrix}
    initial: dict[str, Any] = {"position": _arrays.vector("position", position, size)}
    if constraints:
        system["constraints"] = list(constraints)
    if project is not None:
        initial["project"] = project
    if parameters is not None:
        system["parameters"] = dict(parameters)
    texts, terms, force_texts = terms_of(potential, force)
    terms = on_its_pattern(terms, potential, initial["position"])
    if stiffness is not None:
        system["stiffness"] = symmetric("stiffness", _arrays.matrix("stiffness", stiffness, size))
    if gyroscopic is not None:
        system["gyroscopic"] = _arrays.matrix("gyroscopic", gyroscopic, size)
        if system["gyroscopic"].ndim == 1:
            raise InputError("gyroscopic: a skew-symmetric matrix is needed", "gyroscopic", str(system["gyroscopic"].shape))
    if texts:
        system["potential"] = " + ".join(texts)
    if force_texts is not None:
        system["force"] = force_texts
    system["damping"] = damping_of(damping, size)
    scenario: dict[str, Any] = {"system": system}
    files: Files = {}
    driven: list[tuple[str, Any, Function]] = []
    if entries := loads_of(loads, "loads", "system.load", size, files, driven):
        system["load"] = entries
    if driven:
        terms = with_loads(terms, driven)
    if cases is not None:
        scenario["case"] = [
            {"name": str(name), "load": loads_of(given, f"cases[{name!r}]", f"case[{index}].load", size, files)}
            for index, (name, given) in enumerate(cases.items())
        ]
    if placed := elements_of(elements, "elements"):
        system["element"] = placed
    described, watched = events_of(events, "events", keys.get("scheme") == "collocation")
    if described:
        scenario["event"] = described
    if velocity is not None and momentum is None:
        initial["velocity"] = _arrays.vector("velocity", velocity, size)
    elif kinetic is None or momentum is not None:
        initial["momentum"] = _arrays.vector("momentum", 0.0 if momentum is None else momentum, size)
        if velocity is not None:
            raise InputError("velocity: cannot stand beside momentum: give one of them", "velocity")
    if isinstance(chosen := changes.get("output.coordinates"), slice):
        changes["output.coordinates"] = list(range(size))[chosen]
    scenario["initial"] = initial
    scenario["time"] = time
    # Only a file must select its columns; arrays contain all coordinates by default.
    if size > MOST_COLUMNS and changes.get("output.coordinates") is None:
        changes["output.coordinates"] = range(size)
    functions = Functions(terms if any((terms.gradient, terms.force)) else None, watched)
    with _arguments():
        given = source(scenario, changes)
        given[3].update(files)
        if samples is not None:
            rows = samples.rows(_fvi.past_nodes(given), initial["position"], size)
            given[2]["initial"]["past"] = "initial.past.npy"
            given[3]["initial.past.npy"] = _arrays.npy("past", rows)
    return given, functions


class _Past:
    """The motion before the start, in the form that the compiled part requires."""

    def __init__(self, given: Any, time: Mapping[str, Any]) -> None:
        message = "past: (where it begins, function of t) or (times, positions) is needed"
        if not isinstance(given, (tuple, list)) or len(given) != 2:
            raise InputError(message, "past", repr(given))
        if "step" not in time:
            raise InputError("past: equal steps are needed, `step`", "past")
        self.start, self.step = time.get("start", 0.0), float(time["step"])
        self.function = given[1] if callable(given[1]) else None
        self.end = None
        if self.function is not None:
            since = _arrays.real("past[0]", given[0])
            self.steps = self._count("past[0]", since)
            return
        times, positions = _arrays.numbers("past[0]", given[0]), _arrays.numbers("past[1]", given[1])
        if positions.ndim == 1:
            positions = positions[:, None]
        if times.ndim != 1 or times.size == 0 or positions.ndim != 2 or len(positions) != len(times):
            shapes = f"{times.shape} and {np.shape(given[1])}"
            raise InputError(f"past: shapes {shapes}; times and as many rows of positions are needed", "past", shapes)
        self.steps = self._count("past[0][0]", float(times[0]))
        grid = self.start - self.step * np.arange(self.steps, -1, -1)
        tolerance = 1e-9 * self.step + 4 * np.finfo(float).eps * self.start
        if len(times) not in (self.steps, self.steps + 1) or np.any(np.abs(times - grid[: len(times)]) > tolerance):
            message = (
                f"past[0]: the times of all {self.steps} steps before the start are needed, {grid[0]:g}, …, {grid[-2]:g}, and perhaps "
                f"{grid[-1]:g}"
            )
            raise InputError(message, "past[0]", f"{len(times)} times")
        self.positions = positions[: self.steps]
        if len(times) > self.steps:
            self.end = positions[-1]

    def _count(self, name: str, since: float) -> int:
        exact = float((self.start - since) / self.step)
        steps = int(round(exact))
        if steps < 1 or abs(exact - steps) > 1e-9 * steps + 4 * np.finfo(float).eps * self.start / self.step:
            allowed = f"a time a whole number of steps of {self.step:g} before the start, {self.start:g}"
            raise InputError(f"{name} = {since}: not allowed; allowed: {allowed}", name, str(since))
        return steps

    def rows(self, nodes: Sequence[float], position: Any, size: int) -> Any:
        """Positions at the beginning and at the given nodes of each step."""
        if self.end is not None and not np.array_equal(self.end, position):
            raise InputError("position: not the last one of past", "position", repr(position))
        if self.function is None:
            if nodes:
                message = f"past: with this scheme memories know {len(nodes)} positions inside each step; give a function of t"
                raise InputError(message, "past", "samples")
            if self.positions.shape[1] != size:
                shape = str(self.positions.shape)
                raise InputError(f"past[1]: shape {shape} instead of ({self.steps}, {size})", "past[1]", shape)
            return self.positions
        at = self.start - self.step * np.arange(self.steps, 0, -1)
        times = at[:, None] + self.step * np.array([0.0, *nodes])
        return np.stack([_arrays.vector("past[1]", self.function(float(t)), size) for t in times.ravel()])


MOST_COLUMNS = 64
"""Coordinates of a large system up to which a scenario writes all of them without being asked."""


def _time(start: Any, step: Any, steps: Any, end: Any, grid: Any, scheme: Any) -> dict[str, Any]:
    time: dict[str, Any] = {}
    if start is not None:
        time["start"] = _arrays.real("start", start)
    if step is not None:
        time["step"] = step if isinstance(step, int) else _arrays.real("step", step)
    if steps is not None:
        if isinstance(steps, (float, np.floating)) and float(steps).is_integer():
            steps = int(steps)
        time["steps"] = _arrays.whole("steps", steps)
    if end is not None:
        time["end"] = _arrays.real("end", end)
    if grid is None or (isinstance(grid, str) and grid == "uniform"):
        if step is None and not chooses(scheme):
            raise InputError("step: needed, unless there is a grid with other steps", "step", "None")
        if (steps is None) == (end is None):
            raise InputError("steps: give either steps or end", "steps")
    return time


@contextmanager
def _arguments() -> Iterator[None]:
    """Context in which errors about keys of the scenario become errors about the arguments."""
    try:
        yield
    except InputError as error:
        raise named_after_argument(error) from error.__cause__


def named_after_argument(error: InputError) -> InputError:
    """An error about a key of a scenario, as one about the argument that it came from."""
    arguments = {path: name for name, path in SHORT_NAMES.items()} | {
        f"system.{name}": name for name in ("mass", "stiffness", "gyroscopic", "potential", "force", "damping")
    }
    arguments |= {"system.load": "loads", "system.element": "elements", "case": "cases", "event": "events", "sensitivity": "sensitivities"}
    arguments |= {"time.points": "grid", "time.tolerance": "tolerance", "scheme.tolerance": "tolerance"}
    for path, name in arguments.items():
        if error.key == path or error.key.startswith((f"{path}.", f"{path}[")):
            key = name + error.key[len(path) :]
            text = str(error).replace(error.key, key, 1)
            for suffix in (".npz", ".npy"):
                # The user does not know the name of the file that stands for an array.
                file = error.key + suffix
                text = text.replace(f'{key} = "{file}": {file}: ', f"{key}: ", 1)
            renamed = InputError(text, key, error.value)
            return renamed.with_traceback(error.__traceback__)
    return error


