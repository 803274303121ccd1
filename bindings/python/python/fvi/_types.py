"""Types that several modules use: arrays, names, and the keywords that stand for keys of a scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
Whole = int | np.integer[Any]
Real = float | np.floating[Any] | np.integer[Any]



class HasArray(Protocol):
    """What NumPy makes an array of."""

    def __array__(self) -> NDArray[Any]: ...


Row = Sequence[Real] | HasArray
"""Numbers in a row. `ArrayLike` would admit a text."""
Numbers = Real | Row | Sequence[Sequence[Real]]
"""A number or an array of numbers."""

Precision = Literal["f64", "f32"]
Engine = Literal["direct", "block-fft", "real-time", "exponential-sum", "exponential-sum-core", "any-step"]
Derivative = Literal["caputo", "riemann-liouville"]
Direction = Literal["both", "rising", "falling"]
Action = Literal["record", "stop"]


class _Keys(TypedDict, total=False):
    title: str | None
    scheme: Literal["low-order", "galerkin", "collocation", "energy", "explicit-euler", "implicit-euler", "auto"] | None
    kappa: Real | None
    degree: Whole | None
    quadrature: Literal["gauss", "lobatto"] | None
    convolution: Literal["bdf", "radau-iia", "lobatto-iiic", "gauss", "trapezoidal"] | None
    symbol: Literal["trapezoidal"] | None
    order: Whole | None
    stages: Whole | None
    at: Literal["nodes", "main-nodes"] | None
    starting: Numbers | None
    engine: Engine | None
    tolerance: Real | None
    horizon: Whole | None
    capacity: Whole | None
    overflow: Literal["stop", "forget"] | None
    states: Precision | None
    threads: Whole | None
    every: Whole | None
    coordinates: Row | slice | None
    snapshots: Any
    times: Numbers | None
    memory_energy: bool | None
    labels: Sequence[str] | None
    units: Mapping[str, str] | None
    picture: Mapping[str, Real] | None
    grid: Literal["uniform", "graded", "geometric", "adaptive"] | Row | None
    must_hit: Numbers | None
    allow_unstable: bool | None
    energy_guard: Literal["stop", "warn", "ignore"] | None
    exponent: Real | None
    first: Real | None
    ratio: Real | None
    longest: Real | None
    shortest: Real | None
    scale: Real | None
    sensitivities: Sequence[str] | None


class OutputKeys(_Keys, total=False):
    """How to integrate, and what to keep, by the names of the keys in a scenario; `None` leaves a default."""

    points: Whole | None


class _StartKeys(TypedDict, total=False):
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


class ScenarioKeys(OutputKeys, _StartKeys, total=False):
    """The same, with the keys that are arguments of `integrate`."""


class ResponseKeys(_Keys, _StartKeys, total=False):
    """The same without `points`, which `response` has as an argument of its own."""


class ControllerKeys(TypedDict, total=False):
    """Keys of a controller beside its gains and orders."""

    form: Literal["parallel", "series"]
    integral_time: Real
    derivative_time: Real
    filter_ratio: Real
    setpoint_weights: Row
    derivative: Derivative
    derivative_filter: Real | Mapping[str, Real]
    limits: Row
    rate_limit: Real
    anti_windup: Mapping[str, Any]


class RadiationKeys(TypedDict, total=False):
    """Arguments of `Kernel.radiation` beside its table."""

    infinite: ArrayLike | None
    coordinates: Sequence[int] | None
    added_to_mass: bool
    memory: Real | None
    begin: Real | None
    end: Real | None
    activity: Real | None
    asymmetry: Real | None
    inconsistency: Real | None
