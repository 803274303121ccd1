"""Types that several modules use: arrays, names, and the keywords that stand for keys of a scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
Whole = int | np.integer[Any]
Real = float | np.floating[Any] | np.integer[Any]

Precision = Literal["f64", "f32"]
Engine = Literal["direct", "block-fft", "real-time", "exponential-sum", "exponential-sum-core", "any-step"]
Derivative = Literal["caputo", "riemann-liouville"]
Direction = Literal["both", "rising", "falling"]
Action = Literal["record", "stop"]


class OutputKeys(TypedDict, total=False):
    """How to integrate, and what to keep, by the names of the keys in a scenario; `None` leaves a default."""

    title: str | None
    scheme: Literal["low-order", "galerkin", "collocation", "energy", "explicit-euler", "implicit-euler", "auto"] | None
    kappa: Real | None
    degree: Whole | None
    quadrature: Literal["gauss", "lobatto"] | None
    points: Whole | None
    convolution: Literal["bdf", "radau-iia", "lobatto-iiic", "gauss", "trapezoidal"] | None
    symbol: Literal["trapezoidal"] | None
    order: Whole | None
    stages: Whole | None
    at: Literal["nodes", "main-nodes"] | None
    starting: ArrayLike | None
    engine: Engine | None
    tolerance: Real | None
    horizon: Whole | None
    capacity: Whole | None
    overflow: Literal["stop", "forget"] | None
    states: Precision | None
    threads: Whole | None
    every: Whole | None
    coordinates: ArrayLike | range | slice | None
    snapshots: Any
    times: ArrayLike | None
    memory_energy: bool | None
    labels: Sequence[str] | None
    units: Mapping[str, str] | None
    picture: Mapping[str, Real] | None
    grid: Literal["uniform", "graded", "geometric", "adaptive"] | ArrayLike | None
    must_hit: ArrayLike | None
    allow_unstable: bool | None
    energy_guard: Literal["stop", "warn", "ignore"] | None
    exponent: Real | None
    first: Real | None
    ratio: Real | None
    longest: Real | None
    shortest: Real | None
    scale: Real | None
    sensitivities: Sequence[str] | None


class ScenarioKeys(OutputKeys, total=False):
    """The same, with the keys that are arguments of `integrate`."""

    position: ArrayLike | None
    momentum: ArrayLike | None
    velocity: ArrayLike | None
    past: Any
    project: bool | None
    start: Real | None
    step: Real | None
    steps: Whole | None
    end: Real | None
    parameters: Mapping[str, Real] | None
