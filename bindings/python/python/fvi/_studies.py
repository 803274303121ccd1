"""Studies: orders of convergence, comparison of engines, two-point problems."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Unpack, cast

import numpy as np

from fvi import _arrays, _fvi
from fvi._errors import InputError, suggesting
from fvi._result import Convergence, Extremal, Table
from fvi._run import Progress
from fvi._scenario import Scenario, by_path, source
from fvi._system import scenario_of, source_of
from fvi._types import Real, ScenarioKeys, Whole


def converge(
    scenario: Scenario,
    levels: tuple[int, int] = (4, 11),
    *,
    intervals: Whole = 1,
    from_time: Real = 0.0,
    progress: Progress | None = None,
    overrides: Mapping[str, Any] | None = None,
    **keys: Unpack[ScenarioKeys],
) -> Convergence:
    """Errors and orders of a scenario over step sizes, as the program `fvi converge` measures them.

    Parameters
    ----------
    scenario : path, dict or System
        As in `run`.
    levels : (int, int)
        First and last level i: the time of the scenario is cut into `intervals`·2^i steps.
    intervals : int
        Number of intervals of the coarsest grid (level 0); their ends, such as the times of jumps, are points of every grid.
    from_time : float
        Errors count from this time on: next to a singular start they are larger than the order promises.
    progress, overrides, **keys
        As in `run`.

    Returns
    -------
    Convergence
        A `Table`, with `plot_errors()`: columns level, steps, step, then error and order of position, momentum and energy (NaN where there is no reference),
        seconds, failure.

    Examples
    --------
    >>> import fvi
    >>> oscillator = {
    ...     "system": {"mass": [1.0], "potential": "0.5*q0^2"},
    ...     "initial": {"position": [1.0], "momentum": [0.0]},
    ...     "time": {"step": 0.1, "end": 2.0},
    ...     "reference": {"position": ["cos(t)"]},
    ... }
    >>> table = fvi.converge(oscillator, (4, 6))
    >>> bool(abs(table["position_order"][-1] - 2) < 0.1)
    True
    """
    ends = tuple(levels) if isinstance(levels, Iterable) else ()
    if len(ends) != 2:
        raise InputError(f"levels = {levels!r}: not allowed; allowed: the first and the last level", "levels", repr(levels))
    first, last = (_arrays.whole("levels", level) for level in ends)
    if first > last or last > 40:
        raise InputError(f"levels = {levels}: not allowed; allowed: 0 ≤ first ≤ last ≤ 40", "levels", str(levels))
    scenario, changed = scenario_of(scenario, keys)
    changes = by_path(overrides, changed, converge)
    engine = changes.pop("history.engine", None)
    _, given = source_of(scenario, changes)
    rows, warning = _fvi.converge(given, first, last, _arrays.whole("intervals", intervals, 1), _arrays.real("from_time", from_time), engine, progress)
    if warning:
        warnings.warn(warning, stacklevel=2)
    return Convergence(rows)


@suggesting
def compare_engines(
    lengths: Sequence[int] = (1024, 16384),
    *,
    order: int | Sequence[int] = 1,
    exponent: float | Sequence[float] = 0.5,
    repetitions: Whole | None = None,
) -> Table:
    """Compares the memory engines: agreement with the plain sum, time per step, bytes.

    Parameters
    ----------
    lengths : sequence of int
        Numbers of steps.
    order, exponent : number or sequence of numbers
        Orders of the backward differentiation formula, and exponents; every combination is measured.
    repetitions : int, optional
        Number of timed runs of each engine.

    Returns
    -------
    Table
        Columns engine, length, order, exponent; error_u, the largest error in units of u Σ |w||x|; mean, median, 99.9 %
        quantile and largest time of a step in nanoseconds; bytes.

    Examples
    --------
    >>> import fvi
    >>> table = fvi.compare_engines([64], repetitions=1)
    >>> "exponential-sum" in table["engine"]
    True
    """
    orders = [order] if np.ndim(order) == 0 else list(cast(Sequence[int], order))
    exponents = [exponent] if np.ndim(exponent) == 0 else list(cast(Sequence[float], exponent))
    return Table(
        _fvi.compare_engines(
            [_arrays.whole("lengths", length, 1) for length in lengths],
            [_arrays.whole("order", entry, 1) for entry in orders],
            [_arrays.real("exponent", entry) for entry in exponents],
            None if repetitions is None else _arrays.whole("repetitions", repetitions, 1),
        )
    )


@suggesting
def extremal(problem: Scenario, *, overrides: Mapping[str, Any] | None = None) -> Extremal:
    """Solves a two-point fractional Euler–Lagrange problem, as the program `fvi extremal` does.

    Parameters
    ----------
    problem : path or dict
        A problem file (TOML), or a dictionary with the same keys.
    overrides : mapping, optional
        Values in place of the problem's, by paths such as ``"problem.alpha"``.

    Returns
    -------
    Extremal
        Its `success` says whether the iteration converged.

    Examples
    --------
    The straight line between two points:

    >>> import fvi
    >>> line = fvi.extremal({
    ...     "problem": {"lagrangian": "0.5*v0^2", "alpha": 1.0, "sigma": "+"},
    ...     "interval": {"end": 1.0, "steps": 8},
    ...     "boundary": {"start": [0.0], "end": [1.0]},
    ... })
    >>> line.success, bool(abs(line.x[4, 0] - 0.5) < 1e-12)
    (True, True)
    """
    t, x, v, record = _fvi.extremal(source(problem, dict(overrides or {})))
    success = bool(record["converged"])
    message = (
        f"converged after {record['newton_iterations']} Newton steps"
        if success
        else f"no convergence: after {record['newton_iterations']} Newton steps the relative residual is "
        f"{record['relative_residual']:.1e}"
    )
    return Extremal(t, x, v, success, message, record)
