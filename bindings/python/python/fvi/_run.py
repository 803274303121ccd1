"""Runs of scenarios."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping
from typing import Any

from fvi import _fvi
from fvi._errors import InputError, StepError
from fvi._result import Result
from fvi._scenario import Scenario, by_path, source

Progress = Callable[[int, int], object]
"""A function of the number of steps made and of all steps."""


def run(
    scenario: Scenario,
    *,
    precision: str = "f64",
    check: bool = True,
    progress: Progress | None = None,
    overrides: Mapping[str, Any] | None = None,
    **keys: Any,
) -> Result:
    """Runs a scenario, as the program `fvi run` does, and keeps the trajectory in memory.

    Parameters
    ----------
    scenario : path or dict
        A scenario file (TOML), or a dictionary with the same keys; NumPy arrays may stand for lists.
    precision : {"f64", "f32"}
        What to compute in. The arrays are in double precision either way.
    check : bool
        Whether a step that fails raises `StepError`. If not, the result says so in `success`, `status` and `message`.
    progress : callable, optional
        Called about ten times a second with the number of steps made and of all steps. An exception that it raises stops
        the run and reaches the caller.
    overrides : mapping, optional
        Values in place of the scenario's, by paths such as ``"system.damping[0].order"``.
    **keys
        The same for the keys that one name tells: step, steps, end, engine, kappa, degree, order (of the backward
        differentiation formula), stages, at, starting, position, momentum, velocity, parameters, every, … `None` leaves the
        scenario as it is. Another `engine` comes with its own settings, those of the scenario's no longer count.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        If the scenario cannot be used; nothing has been computed then.
    StepError
        If a step failed; what was computed is in its `result`.
    KeyboardInterrupt
        On Ctrl-C, within a fraction of a second; what was computed is in its attribute `result`.

    Notes
    -----
    The arrays hold the numbers of ``trajectory.csv``, bit by bit. The interpreter is released during the run: threads run
    side by side.

    Examples
    --------
    >>> import fvi
    >>> pendulum = {
    ...     "system": {
    ...         "mass": [0.25],
    ...         "potential": "4.905*(1 - cos(q0))",
    ...         "damping": [{"order": 0.6, "coefficient": [0.12]}],
    ...     },
    ...     "initial": {"position": [2.0], "velocity": [0.0]},
    ...     "time": {"step": 0.01, "end": 5.0},
    ... }
    >>> r = fvi.run(pendulum, order=2)
    >>> r
    Result('all 500 steps were made', 501 rows of 1 coordinate, t = 0 … 5)
    >>> bool(r.energy[-1] < r.energy[0])
    True
    >>> fvi.run(pendulum, step=-1)
    Traceback (most recent call last):
    ...
    fvi._errors.InputError: time.step = -1: not allowed; allowed: a number > 0
    """
    changes = by_path(overrides, keys)
    engine = changes.pop("history.engine", None) if not _history_settings(changes) else None
    return compute(source(scenario, changes), engine=engine, precision=precision, check=check, progress=progress)


def _history_settings(changes: Mapping[str, Any]) -> bool:
    """Whether the engine comes together with settings of its own."""
    return any(path.startswith("history.") and path != "history.engine" and value is not None for path, value in changes.items())


def compute(
    scenario: Any,
    *,
    engine: str | None = None,
    precision: str = "f64",
    check: bool = True,
    progress: Progress | None = None,
    terms: Any = None,
) -> Result:
    """Runs what `fvi._scenario.source` has made."""
    if progress is not None and not callable(progress):
        raise InputError(f"progress = {progress!r}: a function is needed", "progress", repr(progress))
    t, q, p, energy, record, raised = _fvi.run(
        scenario, engine=engine, precision=precision, progress=progress, terms=terms
    )
    summary = json.loads(record)
    end = summary["status"]
    if end == "completed":
        status, message = 0, f"all {summary['steps']} steps were made"
    elif end == "stopped":
        status, message = 1, f"stopped after {summary['steps']} of {summary['steps_wanted']} steps"
    else:
        status = -1
        message = f"step {summary['step']} (from t = {summary['time']}) failed: {summary['reason']}"
    result = Result(t, q, p, energy, status == 0, status, message, summary)
    if raised is not None:
        try:
            setattr(raised, "result", result)
        except AttributeError:
            raised.add_note(f"fvi: {message}")
        raise raised
    for warning in summary.get("warnings", []):
        warnings.warn(warning, stacklevel=3)
    if check and status != 0:
        raise StepError(message, result)
    return result
