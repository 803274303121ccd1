"""Sweeps on a Dask cluster: each task makes some runs and returns their records, which this process stores."""

from __future__ import annotations

import os
import tempfile
import threading
import time
import warnings
from collections import deque
from concurrent.futures import CancelledError
from typing import Any

from fvi import _fvi
from fvi._errors import InputError
from fvi._run import Progress

TASK_SECONDS = 1.0
"""How long a task should take: long beside what the scheduler does for it, and not much to lose."""

MOST_ATTEMPTS = 4
"""So many times runs may fail for a reason that lies in the cluster."""

LOOK = 0.5
"""Seconds between two questions how many workers there are."""


def make_on(
    client: Any,
    plan: _fvi.Sweep,
    directory: str | os.PathLike[str],
    shard: str | None,
    precision: str,
    progress: Progress | None,
) -> None:
    """Makes the missing runs of a sweep on a cluster, and writes the table."""
    try:
        import distributed
    except ModuleNotFoundError:
        raise ModuleNotFoundError("client needs the package distributed", name="distributed") from None
    if not isinstance(client, distributed.Client) or client.asynchronous:
        raise InputError(f"client = {client!r}: a dask.distributed.Client is needed, not an asynchronous one", "client", repr(client))
    ledger = plan.open(directory, shard)
    try:
        _Work(client, plan, ledger, precision, progress).make()
        ledger.finish()
    finally:
        ledger.close()


class _Work:
    """The runs submitted to the cluster, and their results.

    Lost runs are repeated: a run has the same record wherever and however often it is made. The scheduler replaces workers that
    die. A broken connection to the scheduler cancels all futures of the client, which then reconnects by itself; their runs are
    submitted again.
    """

    def __init__(
        self, client: Any, plan: _fvi.Sweep, ledger: _fvi.Ledger, precision: str, progress: Progress | None
    ) -> None:
        self.client = client
        self.plan = plan
        self.ledger = ledger
        self.precision = precision
        self.progress = progress
        missing = ledger.missing().tolist()
        self.waiting: deque[int] = deque(missing)
        self.again: list[tuple[list[int], int]] = []
        self.under_way: dict[Any, tuple[list[int], int]] = {}
        self.all = ledger.share
        self.done = self.all - len(missing)
        self.parts: Any = None
        self.threads = 1
        self.looked = float("-inf")
        self.seconds_of_a_run: float | None = None
        self.woken = threading.Event()
        self.warned = False

    def make(self) -> None:
        reported = float("-inf")
        try:
            while True:
                now = time.monotonic()
                if self.progress is not None and (now - reported > 0.1 or self.done == self.all):
                    reported = now
                    self.progress(self.done, self.all)
                if not (self.waiting or self.again or self.under_way):
                    return
                if self.client.status in ("closing", "closed"):
                    raise ConnectionError(
                        "the connection to the scheduler is lost for good; with out, the same call goes on where this one ended"
                    )
                if self.client.status == "running":
                    self._hand_out()
                self.woken.wait(0.1)
                self.woken.clear()
                for future in [future for future in self.under_way if future.status != "pending"]:
                    self._take_back(future)
        finally:
            if self.under_way and self.client.status == "running":
                self.client.cancel(list(self.under_way), force=True)

    def _hand_out(self) -> None:
        """Keeps every thread of the cluster busy, with one further task waiting for each."""
        if time.monotonic() - self.looked > LOOK:
            try:
                self.threads = max(1, sum(self.client.nthreads().values()))
            except (OSError, CancelledError):
                return
            self.looked = time.monotonic()
        while len(self.under_way) < 2 * self.threads and (self.again or self.waiting):
            if self.again:
                runs, attempt = self.again.pop()
            else:
                runs, attempt = [self.waiting.popleft() for _ in range(self._size_of_a_task())], 1
            if self.parts is None or self.parts.status in ("cancelled", "lost", "error"):
                # A separate task, so that the scheduler can repeat it when the worker with its result dies.
                self.parts = self.client.submit(_parts, self.plan.parts(), pure=False)
            future = self.client.submit(
                make_runs, self.parts, self.precision, self.plan.fingerprint, runs, pure=False
            )
            self.under_way[future] = (runs, attempt)
            future.add_done_callback(lambda _: self.woken.set())

    def _size_of_a_task(self) -> int:
        if self.seconds_of_a_run is None:
            return 1
        wanted = int(TASK_SECONDS / max(self.seconds_of_a_run, 1e-5))
        fair = -(-len(self.waiting) // (2 * self.threads))
        return max(1, min(wanted, fair))

    def _take_back(self, future: Any) -> None:
        runs, attempt = self.under_way.pop(future)
        try:
            made, vector_units, seconds = future.result(timeout=600)
        except CancelledError:
            # The connection was lost; the runs themselves have not failed.
            self.again.append((runs, attempt))
            return
        except Exception as error:
            self._failed(error, runs, attempt)
            return
        if vector_units != _fvi.vector_units() and not self.warned:
            self.warned = True
            warnings.warn(
                f"some workers compute with other vector units ({vector_units}) than this machine "
                f"({_fvi.vector_units()}): last bits of their runs may differ from those made here",
                stacklevel=5,
            )
        self.seconds_of_a_run = seconds / len(runs)
        entered = {run for run, record, trajectory in made if self.ledger.take(run, record, trajectory)}
        self.done += len(entered)
        missing = [run for run in runs if run not in entered]
        if missing:
            self._failed(RuntimeError(f"runs {missing} came back damaged"), missing, attempt)

    def _failed(self, error: Exception, runs: list[int], attempt: int) -> None:
        """Repeats failed runs if the cluster may be the cause, one run per task, so that a run that kills its worker does not
        affect others."""
        import distributed

        cluster = (distributed.KilledWorker, OSError, TimeoutError)
        if isinstance(error, cluster) and attempt < MOST_ATTEMPTS:
            self.again.extend(([run], attempt + 1) for run in runs)
            return
        if isinstance(error, ModuleNotFoundError):
            error.add_note("Every worker of the cluster needs the package fvi.")
        if isinstance(error, cluster):
            error.add_note(f"fvi: runs {runs} have failed on the cluster {attempt} times")
        raise error


def _parts(parts: Any) -> Any:
    """A task whose result is the data sent to the workers."""
    return parts


_plans: dict[tuple[int, str], _fvi.Sweep] = {}
_lock = threading.Lock()


def make_runs(
    parts: Any, precision: str, fingerprint: int, runs: list[int]
) -> tuple[list[tuple[int, bytes, bytes | None]], str, float]:
    """Makes runs on a worker; returns their records, the vector units, and the time taken in seconds."""
    with _lock:
        plan = _plans.get((fingerprint, precision))
    if plan is None:
        plan = _fvi.Sweep.of_parts(parts, precision)
        if plan.fingerprint != fingerprint:
            message = f"this worker has another version of fvi, {_fvi.__version__}, than the caller, or reads the sweep otherwise"
            raise RuntimeError(message)
        with _lock:
            _plans.clear()
            _plans[fingerprint, precision] = plan
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="fvi-sweep-") as scratch:
        made = plan.make_elsewhere(runs, scratch)
    return made, _fvi.vector_units(), time.perf_counter() - begin
