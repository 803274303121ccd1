"""A mechanical system, made once for all calls that take one."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from fvi import _arrays
from fvi._errors import InputError, suggesting
from fvi._scenario import Described, ready, source
from fvi._terms import (
    Damping,
    Element,
    Force,
    Function,
    Load,
    Potential,
    damping_of,
    elements_of,
    loads_of,
    out_of,
    terms_of,
)


class System(Described):
    """M q̈ + G q̇ + K q + ∇U(q) + Σ ∇U_e(q) = F(t, q) + Σ f a(t) − Σ ρ D^β q, without initial values and steps.

    Made once and accepted by `integrate`, `Model` and `fvi.petsc.integrate`, and in place of a scenario by `run`, `response`, `fit`
    and `converge`; what else they need are keywords: `position`, `step`, `end`, `scheme`, … It may also stand in a dictionary, as
    its `system`, with `initial`, `time`, … beside it, as in the `scenario` of `sweep`, or as the `scenario` of a plant in `tune`.

    Parameters
    ----------
    mass, stiffness, gyroscopic, potential, force, damping, loads, elements, parameters, kinetic, constraints
        As in `integrate`.

    Notes
    -----
    Matrices are checked and copied here. A system is not changed afterwards, and is pickled if its functions are.

    Examples
    --------
    >>> import numpy as np, fvi
    >>> oscillator = fvi.System(mass=[1.0], stiffness=[4.0], damping=fvi.Damping(0.5, [0.1]))
    >>> r = fvi.integrate(oscillator, position=[1.0], step=0.05, end=10.0)
    >>> H = fvi.response(oscillator, [1.0, 2.0]).response
    >>> bool(abs(H[0] - 1 / (4 - 1 + 0.1 * 1j**0.5)) < 1e-14)
    True
    >>> found = fvi.fit(oscillator, {"system.damping[0].order": 0.7}, {"t": r.t, "q0": r.q[:, 0]}, position=[1.0], step=0.05, end=10.0)
    >>> bool(abs(found.estimates["system.damping[0].order"] - 0.5) < 1e-8)
    True
    """

    __slots__ = ("_arguments", "_size")

    @suggesting
    def __init__(
        self,
        *,
        mass: Any = None,
        stiffness: Any = None,
        gyroscopic: Any = None,
        potential: str | Potential | None = None,
        force: str | Sequence[str] | Function | Force | None = None,
        damping: Damping | Mapping[str, Any] | Iterable[Damping | Mapping[str, Any]] = (),
        loads: Load | Iterable[Load] = (),
        elements: Element | Iterable[Element] = (),
        parameters: Mapping[str, float] | None = None,
        kinetic: str | None = None,
        constraints: Sequence[str] = (),
    ) -> None:
        if (mass is None) == (kinetic is None):
            message = "mass: needed, unless there is `kinetic`" if mass is None else "kinetic: cannot stand beside mass: give one of them"
            raise InputError(message, "mass" if mass is None else "kinetic")
        given: dict[str, Any] = {}
        self._size: int | None = None
        if mass is not None:
            given["mass"] = ready("mass", mass, None)
            self._size = None if np.ndim(mass) == 0 and not hasattr(mass, "shape") else int(given["mass"].shape[0])
            if self._size is None:
                given["mass"] = float(given["mass"][0])
        for name, matrix in (("stiffness", stiffness), ("gyroscopic", gyroscopic)):
            if matrix is not None:
                given[name] = ready(name, matrix, self._size) if name == "stiffness" else _arrays.matrix(name, matrix, self._size)
        terms_of(potential, force)
        terms = [
            term if not isinstance(term, Damping) or not _is_large(term.coefficient) else _with_ready(index, term, self._size)
            for index, term in enumerate(_arrays.several("damping", damping, (Damping, Mapping), "a fvi.Damping"))
        ]
        given.update(
            potential=potential, force=force, damping=tuple(terms), kinetic=kinetic, constraints=tuple(constraints),
            loads=tuple(_arrays.several("loads", loads, (Load, Mapping), "a fvi.Load")),
            elements=tuple(_arrays.several("elements", elements, (Element, Mapping), "a fvi.Element")),
            parameters=None if parameters is None else dict(parameters),
        )
        self._arguments = {
            name: _arrays.copied(value) for name, value in given.items() if value is not None and not _is_empty(value)
        }
        if self._size is not None:
            # What is wrong is told here and not by the first call.
            damping_of(terms, self._size)
            loads_of(self._arguments.get("loads", ()), "loads", "system.load", self._size, {}, [])
        elements_of(self._arguments.get("elements", ()), "elements")

    @property
    def coordinates(self) -> int | None:
        """N; None where a single number for the mass stands for any number of coordinates."""
        return self._size

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments of `integrate` that it stands for."""
        return dict(self._arguments)

    def merged(self, others: Mapping[str, Any]) -> dict[str, Any]:
        """These arguments and others, which are refused where both have one."""
        for name, value in others.items():
            if name in self._arguments and not (value is None or _is_empty(value)):
                raise InputError(f"{name}: the system has one already; make another fvi.System", name)
        return {**others, **self._arguments}

    def scenario(self, size: int | None = None) -> dict[str, Any]:
        """The dictionary of a scenario without initial values and time, for `size` coordinates if the system leaves them open."""
        count = self._size if self._size is not None else 1 if size is None else size
        keys = {name: value for name, value in self._arguments.items() if name not in ("damping", "loads", "elements", "constraints")}
        if isinstance(keys.get("mass"), float):
            keys["mass"] = np.full(count, keys["mass"])
        if isinstance(keys.get("potential"), str):
            keys["potential"] = f"({keys['potential']})"
        if "constraints" in self._arguments:
            keys["constraints"] = list(self._arguments["constraints"])
        if terms := self._arguments.get("damping"):
            keys["damping"] = damping_of(terms, count)
        if loads := self._arguments.get("loads"):
            keys["load"] = list(loads)
        if elements := self._arguments.get("elements"):
            keys["element"] = elements_of(elements, "elements")
        scenario: dict[str, Any] = {"system": keys}
        if count > MOST_COLUMNS:
            scenario["output"] = {"coordinates": range(count)}
        return scenario

    def __repr__(self) -> str:
        size = "any number of" if self._size is None else str(self._size)
        return f"System({size} coordinates; {', '.join(self._arguments)})"

    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:
        return id(self)

    def __getstate__(self) -> dict[str, Any]:
        return {"arguments": self._arguments, "size": self._size}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._arguments, self._size = state["arguments"], state["size"]


MOST_COLUMNS = 64
"""Coordinates up to which a scenario writes all of them without being asked."""

VECTORS = ("position", "momentum", "velocity")


def scenario_of(given: Any, keys: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
    """A scenario and the keywords of a call; for a system, or a dictionary whose `system` is one, the scenario with it, and vectors
    at the start with a number for each coordinate."""
    inside = isinstance(given, Mapping) and isinstance(given.get("system"), System)
    system = given["system"] if inside else given
    if not isinstance(system, System):
        return given, dict(keys)
    initial = given.get("initial") if inside else None
    starts = [start for start in (keys, initial) if isinstance(start, Mapping)]
    size = system.coordinates
    if size is None:
        numbers = (start[name] for start in starts for name in VECTORS if start.get(name) is not None)
        size = next((int(np.size(vector)) for vector in numbers), 1)
    changed = _spread(keys, size)
    scenario = system.scenario(size)
    if inside:
        output = given.get("output", {})
        if isinstance(output, Mapping) and (output := {**scenario.get("output", {}), **output}):
            scenario["output"] = output
        scenario = {**scenario, **{name: value for name, value in given.items() if name not in ("system", "output")}}
        if isinstance(initial, Mapping):
            scenario["initial"] = _spread(initial, size)
    return scenario, changed


def source_of(given: Any, changes: Mapping[str, Any]) -> tuple[Any, Any]:
    """A scenario without functions that may have objects of the package in it: as it is after the changes of a call, apart from
    these, and its source for the compiled part."""
    if not isinstance(given, Mapping):
        return given, source(given, changes)
    scenario, functions, files = out_of(given)
    if functions:
        key = "event" if any(functions.events) else "system"
        raise InputError(f"{key}: functions of Python are taken by integrate, run, Model and sweep; here expressions are needed", key)
    found = source(scenario, changes)
    found[3].update(files)
    if "load" in (system := given.get("system") or {}):
        # Whose records are files otherwise.
        scenario["system"] = {**scenario["system"], "load": system["load"]}
    return scenario, found


def _spread(start: Mapping[str, Any], size: int) -> dict[str, Any]:
    """The same with a number for each coordinate in the vectors at the start."""
    files = (str, os.PathLike, type(None))
    return {
        name: _arrays.vector(name, value, size) if name in VECTORS and not isinstance(value, files) else value
        for name, value in start.items()
    }


def _is_empty(given: Any) -> bool:
    return isinstance(given, (tuple, list)) and not given


def _is_large(given: Any) -> bool:
    return _arrays.is_sparse(given) or getattr(given, "ndim", 0) == 2


def _with_ready(index: int, term: Damping, size: int | None) -> Damping:
    from dataclasses import replace

    return replace(term, coefficient=ready(f"damping[{index}].coefficient", term.coefficient, size))
