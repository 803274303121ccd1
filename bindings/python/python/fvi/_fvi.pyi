"""The compiled part of the package. Its callers have checked the arguments."""

from typing import Any, Self, final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import disjoint_base

_Array = NDArray[np.float64]
_Real = float | np.floating[Any] | np.integer[Any]
_Whole = int | np.integer[Any]

__all__ = [
    "Batch",
    "DATA_KEYS",
    "Convolver",
    "FractionalPid",
    "KEYS",
    "Ledger",
    "Loads",
    "Memory",
    "Operator",
    "Prepared",
    "Record",
    "Recording",
    "RunSnapshot",
    "Sweep",
    "__version__",
    "compare_engines",
    "converge",
    "derivative",
    "exponentials",
    "extremal",
    "fit",
    "kernel_facts",
    "past_nodes",
    "record",
    "response",
    "run",
    "run_in",
    "tune",
    "vector_units",
    "velocities",
    "weights",
]

__version__: str

KEYS: list[tuple[str, list[str]]]
"""Tables of a scenario that control the integration, with their keys."""

DATA_KEYS: list[str]
"""Keys of a table of data of a fit."""

@final
class Prepared:
    def __new__(cls) -> Self: ...

@final
class Record:
    def json(self) -> str: ...

_Arrays = tuple[_Array, _Array, _Array, _Array, dict[str, _Array], _Array, _Array]

@final
class Batch:
    def __new__(
        cls, source: Any, paths: list[str], precision: str, prepared: Prepared, terms: Any, events: Any
    ) -> Self: ...
    def described(self, numbers: list[float], with_mass: bool) -> str: ...
    def run_one(self, numbers: list[float]) -> tuple[_Arrays, str, Record, BaseException | None]: ...
    def run(self, numbers: _Array, jobs: int | None, progress: Any) -> tuple[dict[str, Any], BaseException | None]: ...

@final
class Recording:
    @property
    def nbytes(self) -> int: ...
    def gradient(self, position: _Array, momentum: _Array) -> list[_Array]: ...

def exponentials(
    order: int,
    exponent: float | None,
    kernel: dict[str, Any] | None,
    step: float,
    increments: bool,
    horizon: int | None,
    band: list[float] | None,
    tolerance: float,
) -> list[_Array]: ...
def record(
    source: Any, prepared: Prepared, most_bytes: int | None = None, terms: Any = None
) -> tuple[_Arrays, str, Record, BaseException | None, Recording]: ...
@final
class RunSnapshot:
    @property
    def steps(self) -> int: ...
    @property
    def nbytes(self) -> int: ...

def past_nodes(source: Any) -> list[float]: ...
def run(
    source: Any,
    *,
    engine: str | None = None,
    precision: str = "f64",
    progress: Any = None,
    terms: Any = None,
    cases: bool = False,
    prepared: Prepared | None = None,
    spent: float = 0.0,
    events: Any = ...,
    resume: RunSnapshot | None = None,
    keep: bool | None = None,
) -> tuple[
    list[tuple[str, _Arrays, str, Record]], BaseException | None, RunSnapshot | None
]: ...
def run_in(
    source: Any,
    directory: Any,
    *,
    engine: str | None = None,
    precision: str = "f64",
    progress: Any = None,
    checkpoint_every: str | None = None,
    resume: bool = False,
    accept_other_machine: bool = False,
) -> tuple[str, BaseException | None]: ...
def response(
    source: Any,
    *,
    omega: list[float] | None = None,
    from_omega: float | None = None,
    to_omega: float | None = None,
    points: int | None = None,
    input: int = 0,
    output: int = 0,
    position: list[float] | None = None,
    near: list[float] | None = None,
    modes: int | None = None,
    discrete: bool = True,
) -> dict[str, Any]: ...
def fit(
    plan: Any, scenario: Any, progress: Any = None
) -> tuple[list[str], int, list[str], str, list[tuple[_Array, str, list[tuple[_Array, _Array, _Array]]]]]: ...
def tune(
    source: Any,
    plant: Any = None,
) -> tuple[str, str, tuple[list[list[float]], list[list[float]]]]: ...
def derivative(
    samples: _Array,
    exponent: float | None,
    kernel: dict[str, Any] | None,
    step: float,
    order: int,
    starting: list[float],
    engine: str | None,
) -> _Array: ...
def kernel_facts(kernel: dict[str, Any]) -> tuple[float, float, str | None]: ...
def velocities(source: Any, positions: _Array, momenta: _Array) -> _Array: ...
def weights(
    family: str,
    order: int,
    stages: int | None,
    exponent: float | None,
    kernel: dict[str, Any] | None,
    step: float,
    count: int,
) -> _Array: ...
def extremal(source: Any) -> tuple[_Array, _Array, _Array, dict[str, Any]]: ...
def converge(
    source: Any, first: int, last: int, intervals: int, from_time: float, engine: str | None, progress: Any
) -> tuple[list[dict[str, Any]], str | None]: ...
def compare_engines(
    lengths: list[int], orders: list[int], exponents: list[float], repetitions: int | None
) -> list[dict[str, Any]]: ...

@disjoint_base
class Memory:
    def __new__(
        cls,
        *,
        exponent: float | None,
        kernel: dict[str, Any] | None,
        step: float,
        family: str,
        order: int,
        stages: int | None,
        channels: int,
        length: int,
        engine: str | None,
        samples: str,
        tolerance: float | None,
        states: str | None,
        threads: int | None,
    ) -> Self: ...
    @property
    def engine(self) -> str: ...
    @property
    def samples(self) -> str: ...
    @property
    def channels(self) -> int: ...
    @property
    def stages(self) -> int: ...
    @property
    def nbytes(self) -> int: ...
    @property
    def leading(self) -> _Array: ...
    def __len__(self) -> int: ...
    def next_term(self) -> _Array: ...
    def push(self, sample: _Array) -> None: ...
    def clear(self) -> None: ...
    def save(self) -> bytes: ...
    def restore(self, state: bytes) -> None: ...
    def restore_channels(self, state: bytes, of: int, first: int, count: int, to: int) -> None: ...

@disjoint_base
class Convolver:
    def __new__(
        cls,
        *,
        rows: Any,
        single: bool,
        arrangement: str,
        outputs: int,
        latency: int,
        block: int | None,
        longest: int,
    ) -> Self: ...
    @property
    def inputs(self) -> int: ...
    @property
    def outputs(self) -> int: ...
    @property
    def latency(self) -> int: ...
    @property
    def longest(self) -> int: ...
    @property
    def taken(self) -> int: ...
    @property
    def exchange_left(self) -> int: ...
    @property
    def nbytes(self) -> int: ...
    @property
    def stages(self) -> list[tuple[int, int]]: ...
    def process(self, block: Any) -> Any: ...
    def exchange(self, rows: Any, arrangement: str, outputs: int, fade: int) -> None: ...
    def clear(self) -> None: ...
    def save(self) -> bytes: ...
    def restore(self, state: bytes) -> None: ...

@disjoint_base
class FractionalPid:
    def __new__(cls, document: str, length: _Whole) -> Self: ...
    def tick(
        self, setpoint: _Real, measured: _Real, feed_forward: _Real, applied: _Real | None, limited: bool
    ) -> float: ...
    def manual(self, output: float) -> None: ...
    def automatic(self) -> None: ...
    def set_gains(self, kp: _Real, ki: _Real, kd: _Real) -> None: ...
    def reset(self) -> None: ...
    @property
    def output(self) -> float: ...
    @property
    def integral(self) -> float: ...
    @property
    def is_manual(self) -> bool: ...
    def response(self, omega: float) -> tuple[float, float, float, float] | None: ...
    def save(self) -> bytes: ...
    def restore(self, state: bytes) -> None: ...

@disjoint_base
class Operator:
    def __new__(
        cls,
        *,
        exponent: float,
        step: float,
        order: int,
        start: str,
        rise: float | None,
        length: _Whole,
        engine: str | None,
    ) -> Self: ...
    def push(self, sample: float) -> float: ...
    def push_many(self, samples: _Array) -> _Array: ...
    def save(self) -> bytes: ...
    def restore(self, state: bytes) -> None: ...

@final
class Loads:
    def __new__(cls, source: Any) -> Self: ...
    def impulses(self, first: int, count: int) -> _Array: ...

_Parts = tuple[tuple[str, str], tuple[str, str], str, list[tuple[str, bytes]]]

def vector_units() -> str: ...

@final
class Sweep:
    def __new__(cls, source: Any, scenario: Any, precision: str, terms: Any = None) -> Self: ...
    @staticmethod
    def of_parts(parts: _Parts, precision: str) -> Sweep: ...
    def parts(self) -> _Parts: ...
    @property
    def fingerprint(self) -> int: ...
    @property
    def keeps_trajectories(self) -> bool: ...
    def __len__(self) -> int: ...
    def make_elsewhere(self, runs: list[int], scratch: Any) -> list[tuple[int, bytes, bytes | None]]: ...
    def make(
        self, directory: Any, jobs: int | None, shard: str | None, progress: Any
    ) -> tuple[dict[str, Any], BaseException | None]: ...
    def gather(self, directory: Any) -> dict[str, Any]: ...
    def rows(self, directory: Any, shard: str | None, gathered: bool) -> dict[str, Any]: ...
    def open(self, directory: Any, shard: str | None) -> Ledger: ...

@final
class Ledger:
    @property
    def share(self) -> int: ...
    def missing(self) -> NDArray[np.uint64]: ...
    def take(self, run: int, record: bytes, trajectory: bytes | None) -> bool: ...
    def finish(self) -> dict[str, Any]: ...
    def close(self) -> None: ...
