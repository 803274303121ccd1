"""Runs of scenarios."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn, Unpack, cast

import numpy as np

from fvi import _fvi
from fvi._types import FloatArray, Precision, ScenarioKeys
from fvi._errors import InputError, StepError
from fvi._result import Arrays, Continuation, Result, ending, of_arrays
from fvi._scenario import Files, Scenario, by_path, source
from fvi._system import scenario_of
from fvi._terms import Functions, out_of

Progress = Callable[[int, int | None], object]
"""A function of the number of steps made and of all steps; `None` where steps are chosen on the way."""


def run(
    scenario: Scenario,
    *,
    precision: Precision = "f64",
    check: bool = True,
    progress: Progress | None = None,
    overrides: Mapping[str, Any] | None = None,
    out: str | os.PathLike[str] | None = None,
    checkpoint_every: int | str | None = None,
    resume: bool = False,
    accept_other_machine: bool = False,
    **keys: Unpack[ScenarioKeys],
) -> Result:
    """Runs a scenario, as the program `fvi run` does, and returns the trajectory.

    Parameters
    ----------
    scenario : path, dict or System
        A scenario file (TOML), a `System`, or a dictionary with the same keys; lists may be NumPy arrays, and the objects that `integrate`
        takes are allowed as well: a `Potential`, functions as force and amplitudes, `Damping`, `Load`, `Element`, `Event`.
    precision : {"f64", "f32"}
        Precision of the computation. The arrays are in double precision in either case.
    check : bool
        Whether a step that fails raises `StepError`. If not, `success`, `status` and `message` of the result record it.
    progress : callable, optional
        Called about ten times a second with the number of steps made and the total number of steps; a tqdm bar is accepted, too.
        An exception that it raises stops the run and is passed to the caller.
    overrides : mapping, optional
        Values in place of the scenario's, by paths such as ``"system.damping[0].order"``.
    out : path, optional
        A directory for the files of `fvi run`, the trajectory as NumPy arrays, with checkpoints: a long run that was killed or
        interrupted can be resumed.
    checkpoint_every : int or str, optional
        How often a checkpoint is written: a number of steps, a duration such as "30s", or "never". Default: every minute.
    resume : bool
        Whether to continue from the checkpoint in `out`, if there is one. The result is that of an uninterrupted run; with
        another `end` or number of `steps` the run is extended.
    accept_other_machine : bool
        Whether to continue from a checkpoint of another machine or version, although the last bits may differ.
    **keys
        Values in place of the scenario's for keys that are identified by a short name: step, steps, end, engine, kappa, degree,
        order (of the backward differentiation formula), stages, at, starting, position, momentum, velocity, parameters, every,
        sensitivities (paths of numbers with respect to which the motion is differentiated, `Result.dq` and `Result.dp`), … `None`
        leaves the scenario as it is. `tolerance` is that of the engine, or together with grid="adaptive" that of the steps. With
        another `engine` the scenario's settings of its engine are ignored.

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
    The arrays are bit-identical to ``trajectory.csv``. The interpreter lock is released during the run, so that threads run in
    parallel.

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
    scenario, given_keys = scenario_of(scenario, keys)
    changes = by_path(overrides, given_keys, run)
    engine = changes.pop("history.engine", None) if not _history_settings(changes) else None
    functions = Functions()
    files: Files = {}
    if isinstance(scenario, Mapping):
        scenario, functions, files = out_of(scenario)
    given = source(scenario, changes)
    if files:
        given[3].update(files)
    if out is not None and functions:
        raise InputError("out: a scenario with functions leaves no files: nothing could tell that they are the same", "out", os.fspath(out))
    if out is None:
        if resume or accept_other_machine or checkpoint_every is not None:
            name = "resume" if resume else "accept_other_machine" if accept_other_machine else "checkpoint_every"
            raise InputError(f"{name}: only together with out, the directory of the run", name)
        return compute(given, engine=engine, precision=precision, check=check, progress=progress, functions=functions)
    progress = check_progress(progress)
    record, raised = _fvi.run_in(
        given,
        out,
        engine=engine,
        precision=precision,
        progress=progress,
        checkpoint_every=None if checkpoint_every is None else str(checkpoint_every),
        resume=resume,
        accept_other_machine=accept_other_machine,
    )
    with np.load(Path(out) / "trajectory.npz") as file:
        arrays = of_arrays(file)
    return finish(result_of(arrays, record, record), raised, check)


def run_cases(
    scenario: Scenario,
    *,
    precision: Precision = "f64",
    check: bool = True,
    progress: Progress | None = None,
    overrides: Mapping[str, Any] | None = None,
    **keys: Unpack[ScenarioKeys],
) -> dict[str, Result]:
    """Runs the load cases of a scenario together, with one factorisation of the matrices, and returns their trajectories.

    Parameters
    ----------
    scenario : path or dict
        A scenario with ``[[case]]``, each with a name and loads of its own.
    precision, check, progress, overrides, **keys
        As in `run`.

    Returns
    -------
    dict of Result
        By the names of the cases, in their order.

    Raises
    ------
    InputError, StepError, KeyboardInterrupt
        As in `run`; the `result` of an exception is a dictionary, too.

    Examples
    --------
    >>> import fvi
    >>> frame = {
    ...     "system": {"mass": [2.0, 1.0], "stiffness": [[300.0, -100.0], [-100.0, 100.0]]},
    ...     "case": [
    ...         {"name": "top", "load": [{"pattern": [0.0, 1.0], "amplitude": "sin(5*t)"}]},
    ...         {"name": "both", "load": [{"pattern": [1.0, 1.0], "amplitude": "sin(5*t)"}]},
    ...     ],
    ...     "initial": {"position": [0.0, 0.0], "momentum": [0.0, 0.0]},
    ...     "time": {"step": 0.001, "end": 1.0},
    ... }
    >>> {name: r.q.shape for name, r in fvi.run_cases(frame).items()}
    {'top': (1001, 2), 'both': (1001, 2)}
    """
    changes = by_path(overrides, keys, run_cases)
    engine = changes.pop("history.engine", None) if not _history_settings(changes) else None
    return compute_cases(
        source(scenario, changes), engine=engine, precision=precision, check=check, progress=progress
    )


def _history_settings(changes: Mapping[str, Any]) -> bool:
    """Whether settings of the engine are given together with it."""
    return any(path.startswith("history.") and path != "history.engine" and value is not None for path, value in changes.items())


def compute(
    scenario: Any,
    *,
    engine: str | None = None,
    precision: str = "f64",
    check: bool = True,
    progress: Progress | None = None,
    functions: Functions = Functions(),
    prepared: _fvi.Prepared | None = None,
    spent: float = 0.0,
    mass: Any = None,
    keep_memory: bool | None = None,
    snapshot: _fvi.RunSnapshot | None = None,
    junction: Result | None = None,
) -> Result:
    """Runs the output of `fvi._scenario.source`; with a `snapshot` it continues from there, where the result `junction` ends."""
    progress = check_progress(progress)
    motions, raised, reached = _fvi.run(
        scenario, engine=engine, precision=precision, progress=progress, terms=functions.terms, prepared=prepared, spent=spent,
        events=functions.events, resume=snapshot, keep=keep_memory,
    )
    ((_, arrays, end, record),) = motions
    result = result_of(arrays, end, record, mass)
    if junction is not None:
        result = _behind(junction, result)
    if reached is not None and isinstance(scenario, tuple):
        known = Continuation(scenario, engine, precision, functions, prepared, reached)
        object.__setattr__(result, "_continuation", known)
    return finish(result, raised, check)


def _behind(before: Result, result: Result) -> Result:
    """A result that continues another one, with the last row of that as its first; not with `times`."""
    scenario = result.summary["scenario"]
    last = before.summary["last"]
    if scenario["output"].get("times"):
        return result
    chosen = scenario["output"].get("coordinates")
    state = [np.array(last[name])[None] for name in ("position", "momentum")]
    q, p = state if chosen is None else (numbers[:, chosen] for numbers in state)
    columns = {
        name: np.concatenate([before.columns[name][-1:], column]) for name, column in result.columns.items() if name in before.columns
    }
    velocities = result._velocities
    if velocities is not None and velocities.size > 0:
        velocities = np.concatenate([before._velocities_of(*state)[:, chosen], velocities])
    return replace(
        result,
        _velocities=velocities,
        t=np.concatenate([[last["time"]], result.t]),
        q=np.concatenate([q, result.q]),
        p=np.concatenate([p, result.p]),
        energy=np.concatenate([[last["energy"]], result.energy]),
        columns=columns,
    )


def compute_cases(
    scenario: Any, *, engine: str | None = None, precision: str, check: bool, progress: Progress | None
) -> dict[str, Result]:
    """As `compute`, for each load case by its name."""
    progress = check_progress(progress)
    motions, raised, _ = _fvi.run(scenario, engine=engine, precision=precision, progress=progress, cases=True)
    results = {name: result_of(arrays, end, record) for name, arrays, end, record in motions}
    if raised is not None:
        raise_with(raised, results)
    # The steps are common to all cases, and so are the warnings about them.
    _judge(next(iter(results.values())), check, results)
    return results


def check_progress(progress: Any) -> Progress | None:
    """The progress function; a tqdm bar is converted to one, anything else is refused."""
    if progress is None or callable(progress):
        return cast(Progress | None, progress)
    if not (callable(getattr(progress, "update", None)) and hasattr(progress, "n")):
        raise InputError(f"progress = {progress!r}: a function or a bar of tqdm's is needed", "progress", repr(progress))

    def advance(made: int, of: int | None) -> None:
        if of is not None:
            progress.total = of
        progress.update(made - progress.n)

    return advance


def finish(result: Result, raised: BaseException | None, check: bool) -> Result:
    """Returns the result, or raises the error with which the run ended."""
    if raised is not None:
        raise_with(raised, replace(result, message=raised_in(raised, result.t)))
    _judge(result, check, result)
    return result


def raised_in(raised: BaseException, t: FloatArray) -> str:
    """The message of a result that an exception, in a function or from the keyboard, has ended."""
    name = type(raised).__name__ if isinstance(raised, KeyboardInterrupt) else f"{type(raised).__name__} in a function"
    return f"{name} ended the run after t = {t[-1]:g}" if len(t) else name


def result_of(arrays: Arrays, end: str, record: str | _fvi.Record, mass: Any = None) -> Result:
    """The result with status and message from the record; the whole record is parsed on demand."""
    t, q, p, energy, columns, derivatives, velocities = arrays
    known = json.loads(end)
    status, message = ending(known)
    warned = tuple(known.get("warnings", ()))
    return Result(
        t, q, p, energy, status == 0, status, message, record, warned, mass, columns=columns, _derivatives=derivatives,
        _velocities=velocities,
    )


def raise_with(raised: BaseException, computed: object) -> NoReturn:
    """Raises the exception that stopped a run, with what was computed until then."""
    try:
        setattr(raised, "result", computed)
    except AttributeError:
        raised.add_note("fvi: what was computed is lost")
    raise raised


def _outside() -> int:
    """Number of stack frames up to the caller of the package."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] == "fvi":
        frame, level = frame.f_back, level + 1
    return level


def _judge(result: Result, check: bool, computed: Result | dict[str, Result]) -> None:
    """Issues the warnings of the record; raises if a step failed."""
    for warning in result._warnings:
        warnings.warn(warning, stacklevel=_outside())
    if check and result.status != 0:
        raise StepError(result.message, computed)
