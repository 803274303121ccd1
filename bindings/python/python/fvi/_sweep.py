"""Sweeps: one scenario with many values of some of its keys."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

from fvi import _arrays, _fvi
from fvi._errors import InputError, suggesting
from fvi._result import Table
from fvi._run import Progress, check_progress
from fvi._scenario import Scenario, source
from fvi._system import System, scenario_of
from fvi._terms import out_of
from fvi._types import Precision, Whole


@suggesting
def sweep(
    sweep: Scenario,
    *,
    client: Any = None,
    out: str | os.PathLike[str] | None = None,
    jobs: Whole | None = None,
    shard: str | None = None,
    gather: bool = False,
    precision: Precision = "f64",
    progress: Progress | None = None,
) -> Any:
    """Makes the runs of a sweep, as the program `fvi sweep` does: on the cores of this machine, or on a Dask cluster.

    Parameters
    ----------
    sweep : path or dict
        A sweep file (TOML), or a dictionary with the same keys: `scenario`, a path or a dictionary as in `run`, whose `system` may
        be a `System`; `axes`, values of
        the scenario's keys by their paths, as lists, arrays, or ranges such as ``{"from": 0.1, "to": 1.9, "count": 37}``;
        `sampling`; `keep`. A dictionary may contain functions, as in `run`, if the runs are made in this process and `out` is not
        used; only one thread at a time then executes Python code.
    client : dask.distributed.Client, optional
        The cluster that makes the runs; every worker needs the same version of the package fvi, but no access to files. Workers
        may leave and join at any time, and the connection to the scheduler may be lost for a while; this costs time but no
        results.
    out : path, optional
        A directory for the files of `fvi sweep`, apart from its pictures: ``results.csv``, ``results.npz`` and the records of the
        runs done. The same call, or `fvi sweep`, continues after an interruption. Without `out` nothing is kept on the disk.
    jobs : int, optional
        Threads on this machine; default: one for each core.
    shard : str, optional
        "I/COUNT": the part of the runs that this process makes; requires `out`.
    gather : bool
        Whether to join the shards in `out` to the table, and make no runs.
    precision : {"f64", "f32"}
        Precision of the computation.
    progress : callable, optional
        Called about ten times a second with the number of runs done and their total number. An exception that it raises stops the
        sweep and is passed to the caller.

    Returns
    -------
    pandas.DataFrame, or Table where pandas is not installed
        A row for each run in the order of the axes, the last of which varies fastest: run, the values of the axes, status
        ("completed", "failed" or "refused"), steps, the quantities of `keep`, message.

    Raises
    ------
    InputError
        If the sweep or its scenario cannot be used. A failing run is not an error but a row.
    KeyboardInterrupt
        On Ctrl-C; the rows so far are in its attribute `result`.

    Examples
    --------
    >>> import fvi
    >>> oscillator = {
    ...     "system": {
    ...         "mass": [1.0],
    ...         "potential": "0.5*q0^2",
    ...         "damping": [{"order": 0.5, "coefficient": [0.1]}],
    ...     },
    ...     "initial": {"position": [1.0], "momentum": [0.0]},
    ...     "time": {"step": 0.05, "steps": 200},
    ... }
    >>> table = fvi.sweep({
    ...     "scenario": oscillator,
    ...     "axes": {"system.damping[0].order": {"from": 0.2, "to": 1.8, "count": 5}, "initial.position[0]": [1.0, 2.0]},
    ...     "keep": {"quantities": ["energy"]},
    ... })
    >>> len(table["energy_left"])
    10
    >>> bool((table["energy_left"] < 1).all())
    True
    """
    plan = _plan(sweep, precision, local=client is None and out is None and shard is None and not gather)
    progress = check_progress(progress)
    if jobs is not None:
        jobs = _arrays.whole("jobs", jobs, 1)
    if shard is not None and not isinstance(shard, str):
        raise InputError(f'shard = {shard!r}: not allowed; allowed: "I/COUNT"', "shard", repr(shard))
    for name, given, reason in (
        ("shard", shard is not None, "the shards of a sweep meet in a directory"),
        ("gather", gather, "the shards of a sweep meet in a directory"),
        ("keep.trajectories", plan.keeps_trajectories, "the trajectories are written into a directory"),
    ):
        if given and out is None:
            raise InputError(f"{name}: only together with out: {reason}", name)
    for name, given, other in (
        ("jobs", jobs is not None and client is not None, "client, whose workers have threads of their own"),
        ("client", gather and client is not None, "gather, which makes no runs"),
        ("jobs", gather and jobs is not None, "gather, which makes no runs"),
        ("shard", gather and shard is not None, "gather, which takes all shards"),
    ):
        if given:
            raise InputError(f"{name}: cannot stand beside {other}", name)
    with ExitStack() as ending:
        directory = out if out is not None else ending.enter_context(tempfile.TemporaryDirectory(prefix="fvi-sweep-"))
        try:
            if gather:
                plan.gather(directory)
            elif client is not None:
                from fvi._cluster import make_on

                make_on(client, plan, directory, shard, precision, progress)
            else:
                _, raised = plan.make(directory, jobs, shard, progress)
                if raised is not None:
                    raise raised
        except InputError:
            raise
        except BaseException as error:
            # An exception that stops a sweep carries the rows so far.
            try:
                setattr(error, "result", _table(plan.rows(directory, shard, False)))
            except Exception:
                pass
            raise
        return _table(plan.rows(directory, shard, gather))


def _plan(given: Scenario, precision: str, local: bool) -> _fvi.Sweep:
    """The sweep, read and checked; only a `local` one may contain functions."""
    if not isinstance(given, Mapping):
        try:
            return _fvi.Sweep(Path(cast(str, given)), None, precision)
        except TypeError:
            kind = type(given).__name__
            message = f"sweep: a path or a dictionary is needed, not a value of type {kind}"
            raise InputError(message, "sweep", repr(given)) from None
    scenario, _ = scenario_of(given.get("scenario"), {})
    if isinstance(given.get("scenario"), System):
        message = 'scenario: a system needs initial values and steps: {"system": system, "initial": {...}, "time": {...}}'
        raise InputError(message, "scenario", repr(given["scenario"]))
    if not isinstance(scenario, Mapping):
        return _fvi.Sweep(source(given, {}, "sweep"), None, precision)
    keys = source({**given, "scenario": "a dictionary"}, {}, "sweep")
    scenario, functions, files = out_of(scenario)
    if any(functions.events):
        raise InputError("scenario.event: an expression is needed in a sweep", "scenario.event")
    if functions and not local:
        message = (
            "scenario: with functions in it the runs are made on the threads of this process, and nothing is kept that could not tell "
            "which functions they were: without client, out, shard and gather"
        )
        raise InputError(message, "scenario")
    where = source(scenario, {})
    where[3].update(files)
    return _fvi.Sweep(keys, where, precision, functions.terms)


def _table(columns: dict[str, Any]) -> Any:
    table = Table.of_columns(columns)
    try:
        return table.to_pandas()
    except ModuleNotFoundError:
        return table
