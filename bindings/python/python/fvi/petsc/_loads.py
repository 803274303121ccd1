"""Loads: their impulses on the momenta at both ends of each step."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from petsc4py import PETSc

from fvi import _arrays, _fvi
from fvi._errors import InputError, StepError
from fvi._integrate import _arguments
from fvi._scenario import source
from fvi._terms import Load, loads_of
from fvi._types import FloatArray
from fvi.petsc._arguments import Layout, coordinates, local_numbers

BLOCK = 64
"""Steps whose amplitudes are computed together."""


@dataclass
class Pattern:
    """The part of a load's pattern on this rank: local rows and their numbers."""

    rows: Any
    numbers: FloatArray
    text: str
    """What all ranks have to say alike."""


class Loads:
    """Forces Σ f a(t). Amplitudes are read and integrated as on one machine; each rank has its rows of the patterns."""

    def __init__(self, given: Any, layout: Layout, step: float, parameters: Mapping[str, float] | None) -> None:
        self.step = step
        self.patterns: list[Pattern] = []
        amplitudes: list[Any] = []
        for index, load in enumerate(_arrays.several("loads", given, (Load, Mapping), "a fvi.Load")):
            place = f"loads[{index}]"
            if isinstance(load, Load):
                load = {"pattern": load.pattern, "amplitude": load.amplitude}
            if not isinstance(load, Mapping) or set(load) != {"pattern", "amplitude"}:
                raise InputError(f"{place} = {load!r}: a fvi.Load with pattern and amplitude is needed", place, repr(load))
            self.patterns.append(_pattern(f"{place}.pattern", load["pattern"], layout))
            amplitudes.append(load["amplitude"])
        self.compiled = _compiled(amplitudes, step, parameters) if amplitudes else None
        self.texts = [_text(amplitude) for amplitude in amplitudes]
        self.places = [pattern.text for pattern in self.patterns]
        self.first = 0
        self.block: FloatArray = np.empty((0, 2, 0))
        self.impulses: FloatArray = np.empty((2, 0))

    def take(self, step: int) -> BaseException | None:
        """Selects the impulses of a step, which are computed for a block of steps. Returns an error, if any."""
        if self.compiled is None:
            return None
        if not self.first <= step < self.first + len(self.block):
            self.first, self.block = step, self.compiled.impulses(step, BLOCK)
        self.impulses = self.block[step - self.first]
        finite = np.isfinite(self.impulses).all(axis=0)
        if not finite.all():
            index = int(np.argmin(finite))
            return StepError(f"step {step} (t = {step * self.step:g}) failed: the amplitude of loads[{index}] is not finite")
        return None

    def add(self, end: int, vector: Any) -> None:
        """Adds the impulse at the beginning (0) or at the end (1) of the step to a vector."""
        if self.compiled is None:
            return
        numbers = vector.getArray()
        with np.errstate(over="ignore"):
            for pattern, impulse in zip(self.patterns, self.impulses[end]):
                if impulse != 0.0:
                    numbers[pattern.rows] += impulse * pattern.numbers

    def norms(self, layout: Layout) -> list[float]:
        """Euclidean norms of the patterns; collective."""
        return [layout.norm(pattern.numbers) for pattern in self.patterns]


def _compiled(amplitudes: list[Any], step: float, parameters: Mapping[str, float] | None) -> _fvi.Loads:
    """The amplitudes, each as the force on one coordinate of a scenario."""
    count = len(amplitudes)
    files: dict[str, bytes] = {}
    loads = [
        Load({"coordinate": index}, tuple(amplitude) if isinstance(amplitude, list) else amplitude)
        for index, amplitude in enumerate(amplitudes)
    ]
    system: dict[str, Any] = {"mass": np.ones(count), "load": loads_of(loads, "loads", "system.load", count, files)}
    if parameters is not None:
        system["parameters"] = dict(parameters)
    scenario = {
        "system": system,
        "initial": {"position": np.zeros(count), "momentum": np.zeros(count)},
        "scheme": {"kind": "low-order"},
        "time": {"step": step, "steps": 1},
        "output": {"coordinates": [0]},
    }
    with _arguments():
        given = source(scenario, {})
        given[3].update(files)
        return _fvi.Loads(given)


def _text(amplitude: Any) -> str:
    """A text that identifies an amplitude."""
    if isinstance(amplitude, str):
        return amplitude
    content = b"".join(np.ascontiguousarray(column, dtype=np.float64).tobytes() for column in amplitude)
    return f"record {hashlib.sha256(content).hexdigest()[:16]}"


def _pattern(name: str, given: Any, layout: Layout) -> Pattern:
    if isinstance(given, Mapping):
        if not {"coordinate"} <= set(given) <= {"coordinate", "value"}:
            raise InputError(f"{name} = {given!r}: allowed: coordinate, and value if it is not 1", name, repr(given))
        coordinate = coordinates(f"{name}.coordinate", [given["coordinate"]], layout)
        value = _arrays.real(f"{name}.value", given.get("value", 1.0))
        local = coordinate[(coordinate >= layout.first) & (coordinate < layout.end)] - layout.first
        return Pattern(local, np.full(len(local), value), f"{value} at {coordinate.tolist()}")
    if not isinstance(given, PETSc.Vec):
        message = f'{name}: a PETSc.Vec distributed as mass is needed, or {{"coordinate": …, "value": …}}'
        raise InputError(message, name, repr(given))
    numbers = local_numbers(name, layout.check(name, given), layout.first)
    rows = np.flatnonzero(numbers)
    return Pattern(rows, numbers[rows].copy(), "Vec")


