"""Types that several modules use: arrays, names, and the keywords that stand for keys of a scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

Precision = Literal["f64", "f32"]
Engine = Literal["direct", "block-fft", "real-time", "exponential-sum", "exponential-sum-core", "any-step"]
Derivative = Literal["caputo", "riemann-liouville"]
Direction = Literal["both", "rising", "falling"]
Action = Literal["record", "stop"]


class OutputKeys(TypedDict, total=False):
    """How to integrate, and what to keep, by the names of the keys in a scenario; `None` leaves a default."""

    title: str | None
    scheme: Literal["low-order", "galerkin", "collocation", "energy", "explicit-euler", "implicit-euler", "auto"] | None
    kappa: float | None
    degree: int | None
    quadrature: Literal["gauss", "lobatto"] | None
    points: int | None
    convolution: Literal["bdf", "radau-iia", "lobatto-iiic", "gauss", "trapezoidal"] | None
    symbol: Literal["trapezoidal"] | None
    order: int | None
    stages: int | None
    at: Literal["nodes", "main-nodes"] | None
    starting: ArrayLike | None
    engine: Engine | None
    tolerance: float | None
    horizon: int | None
    capacity: int | None
    overflow: Literal["stop", "forget"] | None
    states: Precision | None
    threads: int | None
    every: int | None
    coordinates: ArrayLike | range | slice | None
    snapshots: Any
    times: ArrayLike | None
    memory_energy: bool | None
    labels: Sequence[str] | None
    units: Mapping[str, str] | None
    picture: Mapping[str, float] | None
    grid: Literal["uniform", "graded", "geometric", "adaptive"] | ArrayLike | None
    must_hit: ArrayLike | None
    allow_unstable: bool | None
    energy_guard: Literal["stop", "warn", "ignore"] | None
    exponent: float | None
    first: float | None
    ratio: float | None
    longest: float | None
    shortest: float | None
    scale: float | None
    sensitivities: Sequence[str] | None


class ScenarioKeys(OutputKeys, total=False):
    """The same, with the keys that are arguments of `integrate`."""

    position: ArrayLike | None
    momentum: ArrayLike | None
    velocity: ArrayLike | None
    past: Any
    project: bool | None
    start: float | None
    step: float | None
    steps: int | None
    end: float | None
    parameters: Mapping[str, float] | None
