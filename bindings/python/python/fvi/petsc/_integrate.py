"""A run: arguments, steps, rows, checkpoints."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from petsc4py import PETSc

from fvi import _arrays, _fvi
from fvi._errors import InputError, StepError
from fvi._integrate import MOST_COLUMNS
from fvi._types import Precision
from fvi._terms import Damping, Load
from fvi._result import Result
from fvi._run import Progress
from fvi._system import System
from fvi.petsc import _arguments as given_as
from fvi.petsc._arguments import Layout
from fvi.petsc._checkpoint import Checkpoints, Pace, differences
from fvi.petsc._damping import Damping as RankDamping
from fvi.petsc._damping import Kernels
from fvi.petsc._loads import Loads
from fvi.petsc._output import Directory, Output, Rows, Snapshots, write_json
from fvi.petsc._signals import Signals
from fvi.petsc._step import Stepper
from fvi.petsc._system import arguments_of
from fvi.petsc._together import Together, text_of

LEAST_REACH = 1 << 20
"""Samples that every table of exponentials reaches over."""


def integrate(
    mass: Any,
    stiffness: Any = None,
    *,
    position: Any,
    step: float,
    steps: int | None = None,
    end: float | None = None,
    momentum: Any = None,
    velocity: Any = None,
    damping: Damping | Mapping[str, Any] | Iterable[Damping | Mapping[str, Any]] = (),
    loads: Load | Mapping[str, Any] | Iterable[Load | Mapping[str, Any]] = (),
    parameters: Mapping[str, float] | None = None,
    order: int = 2,
    tolerance: float | None = None,
    states: Precision | None = None,
    horizon: int | None = None,
    threads: int = 1,
    solver_tolerance: float = 1e-10,
    ksp: Any = None,
    near_null_space: Any = None,
    every: int = 1,
    coordinates: Iterable[int] | None = None,
    energy: bool = True,
    output: Output | str | os.PathLike[str] | None = None,
    checkpoint_every: int | str | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Integrates M q̈ + K q = Σ f a(t) − Σ ρ D^β q, distributed by PETSc; collective.

    The scheme is that of `fvi.integrate` for large systems: the midpoint rule, damped at its node with a backward differentiation
    formula, of order 2 and stable for every step.

    Parameters
    ----------
    mass : PETSc.Mat, PETSc.Vec or System
        M: a symmetric positive definite matrix, or the diagonal of one. It determines the rows of each rank; all other arguments
        must be distributed in the same way. Or a `fvi.System`, equal on all ranks of the world, in place of `mass`, `stiffness`,
        `damping`, `loads` and `parameters`: each rank takes its rows of it. Vectors may then be arrays of N numbers, too.
    stiffness : PETSc.Mat
        K, symmetric. A near null space attached to it (rigid-body modes) is passed to the preconditioner.
    position : PETSc.Vec or float
        q(0), or one number for all coordinates.
    step, steps, end : number
        Step size h > 0, and either the number of steps or the last time.
    momentum, velocity : PETSc.Vec or float, optional
        p(0) = M v(0) or v(0); default: at rest.
    damping : Damping or list of Damping, optional
        ρ in `coefficient` as a PETSc.Mat, a PETSc.Vec (the diagonal) or a number; or dampers: B in `attached` as a PETSc.Mat with
        a column for each, and `strength` as a sequence for all dampers or a PETSc.Vec distributed as the columns.
    loads : Load or list of Load, optional
        Forces f a(t): the pattern is a PETSc.Vec or ``{"coordinate": 17, "value": 1.0}``; the amplitude is as in `fvi.Load` and
        the same on all ranks.
    parameters : mapping of str to float, optional
        Named constants of the amplitudes.
    order : {1, 2}
        Order of the backward differentiation formula.
    tolerance, states, horizon, threads
        Settings of the memory: relative error of its weights (default: rounding), "f32" to store its state in single precision,
        largest number of steps to which the run may later be extended, threads of each rank.
    solver_tolerance : float
        The residual r of the equations A e = b of each step has ‖r‖₂ ≤ solver_tolerance·‖b‖₂, or the level of rounding where that
        is larger. It is computed from the forces themselves after the solver has ended, and reduced by further solutions if
        necessary.
    ksp : PETSc.KSP, optional
        A solver in place of conjugate gradients with PETSc's algebraic multigrid (GAMG). The latter takes options with the prefix
        ``fvi_``, such as ``-fvi_ksp_type preonly -fvi_pc_type cholesky``; the solver of the mass, for velocities and energies, with
        ``fvi_mass_``.
    near_null_space : PETSc.NullSpace, optional
        Near null space of the step's matrix, in place of that of `stiffness`.
    every : int
        Number of steps between two rows; the last step always has a row.
    coordinates : iterable of int, optional
        Coordinates contained in the rows, counted over all ranks; default: all if there are at most 64, else none.
    energy : bool
        Whether rows contain the energy, which requires a solution with M for each row; NaN otherwise.
    output : Output or path, optional
        The output directory, and which files are written.
    checkpoint_every : int or str, optional
        How often a checkpoint is written to `output`: a number of steps, a duration such as "10min", or "never". Default: every
        minute, less often where writing takes more than a hundredth of the time.
    resume : bool
        Whether to continue from the checkpoint in `output`, if there is one, on the same or another number of ranks; `steps` or
        `end` may be greater than they were.
    progress : callable, optional
        Called on rank 0, about ten times a second, with the number of steps made and the total number of steps.

    Returns
    -------
    Result
        The same on all ranks.

    Raises
    ------
    InputError
        If an argument cannot be used: is not assembled, is distributed differently from the mass, differs between ranks, …
    StepError
        If the solver diverges or the motion is not finite; what was computed is in its `result`.
    KeyboardInterrupt
        After SIGINT, SIGTERM or SIGUSR1 on any rank: a checkpoint is written to `output` first, what was computed is in its `result`.

    Notes
    -----
    Every exception is raised on all ranks. If a rank is killed MPI ends the job; checkpoints are kept.
    """
    given: dict[str, Any] = dict(
        mass=mass,
        stiffness=stiffness,
        position=position,
        step=step,
        steps=steps,
        end=end,
        momentum=momentum,
        velocity=velocity,
        damping=damping,
        loads=loads,
        parameters=parameters,
        order=order,
        tolerance=tolerance,
        states=states,
        horizon=horizon,
        threads=threads,
        solver_tolerance=solver_tolerance,
        ksp=ksp,
        near_null_space=near_null_space,
        every=every,
        coordinates=coordinates,
        energy=energy,
        output=output,
        checkpoint_every=checkpoint_every,
        resume=resume,
        progress=progress,
    )
    if isinstance(mass, System):
        given = arguments_of(mass, {name: value for name, value in given.items() if name != "mass"})
    candidates = [(name, given[name]) for name in ("mass", "stiffness", "position", "momentum", "velocity")]
    # A rank without any PETSc object has no communicator for a common error, and raises at once.
    together = Together(given_as.communicator(candidates).Dup())
    run = _Run(together, **given)
    try:
        result = run.make()
    finally:
        run.close()
    # Not freed after an exception: the call is collective, and some ranks may not reach it.
    together.comm.Free()
    return result


class _Run:
    """The arguments, checked on all ranks, and the objects built from them."""

    def __init__(self, together: Together, **given: Any) -> None:
        self.together = together
        self.directory: Directory | None = None
        self.rows: Rows | None = None
        with self._agreeing():
            self._check(**given)
        together.same(self.scalars)
        try:
            with self._agreeing():
                if self.output is not None:
                    self.directory = Directory(self.output.directory, together.rank)
            self._prepare(given)
        except BaseException:
            self.close()
            raise

    @contextmanager
    def _agreeing(self) -> Iterator[None]:
        """Context in which an error of one rank is raised on all."""
        error = None
        try:
            yield
        except Exception as raised:
            error = raised
        self.together.agree(error)

    def _check(self, **given: Any) -> None:
        """Makes all checks that a rank can make by itself."""
        if not np.issubdtype(PETSc.ScalarType, np.floating) or np.dtype(PETSc.ScalarType) != np.float64:
            message = f"PETSc was built for {np.dtype(PETSc.ScalarType)}; fvi.petsc needs its real numbers in double precision"
            raise InputError(message, "mass", str(np.dtype(PETSc.ScalarType)))
        self.layout = layout = Layout(self.together, "mass", given["mass"])
        if isinstance(given["mass"], PETSc.Vec):
            self.mass = given["mass"]
            numbers = given_as.local_numbers("mass", self.mass, layout.first)
            if not (numbers > 0.0).all():
                index = int(np.argmin(numbers > 0.0))
                value = str(numbers[index])
                message = f"mass[{layout.first + index}] = {value}: not allowed; allowed: a number > 0"
                raise InputError(message, "mass", value)
        else:
            self.mass = layout.matrix("mass", given["mass"])
        self.stiffness = layout.matrix("stiffness", given["stiffness"])
        self.position = layout.numbers("position", given["position"])
        if given["momentum"] is not None and given["velocity"] is not None:
            raise InputError("velocity: cannot stand beside momentum: give one of them", "velocity")
        self.starts_with_velocity = given["velocity"] is not None
        name = "velocity" if self.starts_with_velocity else "momentum"
        self.start = layout.numbers(name, 0.0 if given[name] is None else given[name])
        self.terms = given_as.damping_terms(given["damping"], layout)
        self.step = _arrays.positive("step", given["step"])
        self.steps = _steps(self.step, given["steps"], given["end"])
        self.order = _arrays.whole("order", given["order"], 1)
        if self.order > 2:
            raise InputError(f"order = {self.order}: not allowed; allowed: 1, 2", "order", str(self.order))
        self.horizon = 0 if given["horizon"] is None else _arrays.whole("horizon", given["horizon"], 1)
        self.solver_tolerance = _arrays.positive("solver_tolerance", given["solver_tolerance"])
        if not 1e-15 <= self.solver_tolerance <= 1e-3:
            message = f"solver_tolerance = {self.solver_tolerance}: not allowed; allowed: 1e-15 to 1e-3"
            raise InputError(message, "solver_tolerance", str(self.solver_tolerance))
        if given["ksp"] is not None and not isinstance(given["ksp"], PETSc.KSP):
            raise InputError(f"ksp = {given['ksp']!r}: a PETSc.KSP is needed", "ksp", repr(given["ksp"]))
        near = given["near_null_space"]
        if near is not None and not isinstance(near, PETSc.NullSpace):
            raise InputError(f"near_null_space = {near!r}: a PETSc.NullSpace is needed", "near_null_space", repr(near))
        self.every = _arrays.whole("every", given["every"], 1)
        chosen = given["coordinates"]
        if chosen is None:
            chosen = range(layout.size if layout.size <= MOST_COLUMNS else 0)
        self.chosen = given_as.coordinates("coordinates", chosen, layout)
        self.wants_energy = bool(given["energy"])
        output = given["output"]
        self.output = output if isinstance(output, Output) or output is None else Output(output)
        if self.output is not None and not isinstance(self.output.directory, (str, os.PathLike)):
            raise InputError(f"output = {output!r}: a directory or a fvi.petsc.Output is needed", "output", repr(output))
        self.pace = Pace(given["checkpoint_every"])
        self.resume, self.progress = bool(given["resume"]), given["progress"]
        self.pace.wants_end |= self.resume
        if self.output is None:
            for name in ("checkpoint_every", "resume"):
                if given[name]:
                    raise InputError(f"{name}: needs output, a directory", name, repr(given[name]))
        self.settings = {name: given[name] for name in ("tolerance", "states", "threads")}
        self.loads = Loads(given["loads"], layout, self.step, given["parameters"])
        outputs = None if self.output is None else (os.fspath(self.output.directory), self.output.snapshots, self.output.format)
        self.scalars = {
            "mass": type(self.mass).__name__,
            "step": self.step,
            "steps": self.steps,
            **{name: text_of(given[name]) for name in ("position", "momentum", "velocity")},
            "damping": [term.text for term in self.terms],
            "loads": self.loads.texts,
            "loads' patterns": self.loads.places,
            "parameters": None if given["parameters"] is None else sorted(dict(given["parameters"]).items()),
            "order": self.order,
            "horizon": self.horizon,
            "solver_tolerance": self.solver_tolerance,
            "ksp": given["ksp"] is not None,
            "near_null_space": near is not None,
            "every": self.every,
            "coordinates": self.chosen.tolist(),
            "energy": self.wants_energy,
            "output": outputs,
            "output.mesh": self.output is not None and self.output.mesh is not None,
            "checkpoint_every": given["checkpoint_every"],
            "resume": self.resume,
            **self.settings,
        }

    def _prepare(self, given: Mapping[str, Any]) -> None:
        """Creates memories, the matrix of the step and its solver; collective from here on."""
        layout, together = self.layout, self.together
        self.checkpoints = None if self.directory is None else Checkpoints(self.directory, layout)
        manifest = None
        if self.checkpoints is not None and self.resume:
            manifest = self.checkpoints.newest()
        like = self.stiffness.createVecLeft()
        probes = _probes(like, layout)
        norms = {} if isinstance(self.mass, PETSc.Mat) else {"mass": float(self.mass.norm())}
        if isinstance(self.mass, PETSc.Mat):
            norms["mass"] = given_as.check_symmetric("mass", self.mass, probes, "positive definite")
        norms["stiffness"] = given_as.check_symmetric("stiffness", self.stiffness, probes, "")
        length = self._length(manifest)
        kernels = Kernels(self.step, self.order, length, *(self.settings[name] for name in ("tolerance", "states", "threads")))
        damping = [RankDamping(term, kernels, layout, like, probes) for term in self.terms]
        norms |= {f"damping[{index}]": term.channels.norm for index, term in enumerate(damping)}
        for probe in probes:
            probe.destroy()
        norms |= {"position": layout.norm(self.position), "momentum": layout.norm(self.start)}
        norms |= {f"loads[{index}].pattern": norm for index, norm in enumerate(self.loads.norms(layout))}
        try:
            self.stepper = Stepper(
                together,
                layout,
                self.mass,
                self.stiffness,
                damping,
                self.step,
                self.solver_tolerance,
                given["ksp"],
                given["near_null_space"],
            )
        except PETSc.Error as error:
            raise StepError(f"the matrix of the step, or its solver, cannot be set up: {error}") from None
        self.facts: dict[str, Any] = {
            **{f"{name} (norm)": norm for name, norm in norms.items()},
            "coordinates of the system": layout.size,
            **{name: self.scalars[name] for name in ("step", "order", "every", "coordinates", "energy", "tolerance", "states")},
            "damping": [[term.kernel, term.derivative, term.attached is not None] for term in self.terms],
            "loads": self.scalars["loads"],
            "parameters": self.scalars["parameters"],
            "samples": [term.memory.samples for term in damping],
        }
        self.length = length
        if manifest is not None and (unlike := differences(manifest["run"], self.facts)):
            message = f"output: the checkpoint is that of another run; what differs: {', '.join(unlike)}"
            raise InputError(message, "output", unlike[0])
        self._begin(manifest)

    def _length(self, manifest: Mapping[str, Any] | None) -> int:
        """Number of samples for which memories are made; an extended run keeps the tables that it began with."""
        wanted = max(self.steps + 1, self.horizon)
        if manifest is None:
            return wanted
        begun = int(manifest["length"])
        if self.steps < manifest["step"]:
            message = f"steps = {self.steps}: not allowed; allowed: {manifest['step']} at least, those of the checkpoint"
            raise InputError(message, "steps", str(self.steps))
        if self.steps + 1 > max(2 * begun, LEAST_REACH):
            message = (
                f"steps = {self.steps}: the run began with memories for {max(2 * begun, LEAST_REACH)} samples: begin anew, or with a "
                "longer horizon the next time"
            )
            raise InputError(message, "steps", str(self.steps))
        return begun

    def _begin(self, manifest: Mapping[str, Any] | None) -> None:
        """Sets the initial state, or that of the checkpoint."""
        stepper = self.stepper
        stepper.position.setArray(self.position)
        if self.starts_with_velocity:
            stepper.scratch.setArray(self.start)
            stepper.multiply_mass(stepper.scratch, stepper.momentum)
        else:
            stepper.momentum.setArray(self.start)
        self.rows = Rows(self.chosen, self.layout, self.directory)
        self.snapshots: Snapshots | None = None
        with self._agreeing():
            if self.output is not None and self.directory is not None and self.output.snapshots is not None:
                self.snapshots = Snapshots(self.output, self.directory, self.layout, stepper.position)
            elif self.output is not None and self.output.mesh is not None:
                raise InputError("output.mesh: needs output.snapshots", "output.mesh")
        with self._agreeing():
            if self.together.rank == 0:
                if self.checkpoints is not None and manifest is None:
                    self.checkpoints.forget()
                self.rows.begin(0 if manifest is None else int(manifest["rows"]))
                if self.snapshots is not None:
                    self.snapshots.begin(None if manifest is None else int(manifest["step"]))
        if self.snapshots is not None:
            self.snapshots.prepare()
        self.made = 0
        if manifest is None:
            stepper.begin()
        else:
            assert self.checkpoints is not None
            with self._agreeing():
                self.checkpoints.read(manifest, stepper)
            self.made = int(manifest["step"])
        self.begun_at = self.made

    def make(self) -> Result:
        """Makes the steps."""
        self.begun, self.reported = time.perf_counter(), float("-inf")
        self.pace.begin(self.begun)
        failed: BaseException | None = None
        message = "all steps were made"
        with Signals() as signals:
            try:
                if self.made == 0:
                    self._keep_row()
                self._steps(signals)
            except (StepError, KeyboardInterrupt) as error:
                failed, message = error, str(error)
            except PETSc.Error as error:
                message = f"step {self.made} (t = {self.made * self.step:g}) failed: {error}"
                failed = StepError(message)
        result = self._result(failed, message)
        if failed is not None:
            failed.result = result  # type: ignore[attr-defined]
            raise failed
        return result

    def _steps(self, signals: Signals) -> None:
        stepper, error = self.stepper, None
        try:
            while self.made < self.steps:
                error = self.loads.take(self.made) or error
                with stepper.whole_step:
                    error = stepper.prepare(self.loads.add) or error
                error = self._report() or error
                due = self.pace.is_due(self.made - self.begun_at, time.perf_counter()) if self.together.rank == 0 else False
                stop, write = self.together.agree(error, signals.came, due)
                if stop:
                    raise KeyboardInterrupt(f"stopped at step {self.made}{' by ' + signals.name if signals.came else ''}")
                if write and self.checkpoints is not None and self.made > self.begun_at:
                    self._write_checkpoint()
                with stepper.whole_step:
                    stepper.solve(self.loads.add, self.made)
                self.made += 1
                try:
                    stepper.push()
                except Exception as raised:
                    error = raised
                if self.made % self.every == 0 or self.made == self.steps:
                    error = self._keep_row() or error
                if self.snapshots is not None and self.made % self.snapshots.every == 0:
                    error = self._keep_snapshot() or error
            self.together.agree(error or self._report())
        except KeyboardInterrupt:
            if self.checkpoints is not None and self.made > self.begun_at:
                self._write_checkpoint()
            raise
        if self.checkpoints is not None and self.made > self.begun_at and self.pace.wants_end:
            self._write_checkpoint()

    def _report(self) -> BaseException | None:
        if self.progress is None or self.together.rank > 0:
            return None
        now = time.perf_counter()
        if now - self.reported < 0.1 and self.made < self.steps:
            return None
        self.reported = now
        try:
            self.progress(self.made, self.steps)
        except BaseException as error:
            return error
        return None

    def _keep_row(self) -> BaseException | None:
        assert self.rows is not None
        stepper = self.stepper
        energy = stepper.energy() if self.wants_energy else float("nan")
        error = self.rows.add(self.made * self.step, stepper.position, stepper.momentum, energy)
        if self.made == 0 and self.snapshots is not None:
            error = self._keep_snapshot() or error
        return error

    def _keep_snapshot(self) -> BaseException | None:
        assert self.snapshots is not None
        return self.snapshots.add(self.made, self.made * self.step, self.stepper.position, self.stepper.momentum)

    def _write_checkpoint(self) -> None:
        assert self.checkpoints is not None and self.rows is not None
        begin = time.perf_counter()
        with self._agreeing():
            self.rows.flush()
        facts = {"run": self.facts, "length": self.length, "rows": len(self.rows.rows)}
        self.checkpoints.write(self.made, self.stepper, facts)
        self.pace.written(self.made - self.begun_at, begin, time.perf_counter())

    def _result(self, failed: BaseException | None, message: str) -> Result:
        """Returns the result, the same on all ranks, and writes the final files."""
        assert self.rows is not None
        together, stepper = self.together, self.stepper
        seconds = {name: together.largest(value) for name, value in stepper.seconds.items()}
        memory = together.sum(float(sum(term.memory.nbytes for term in stepper.damping)))
        channels = together.sum(float(sum(len(term.channels.index) for term in stepper.damping)))
        table = together.comm.bcast(self.rows.table() if together.rank == 0 else None)
        summary = {
            "status": "completed" if failed is None else "stopped" if isinstance(failed, KeyboardInterrupt) else "failed",
            "version": _fvi.__version__,
            "files": [] if failed is not None or self.directory is None else ["trajectory.npz"],
            "scenario": {"output": {"coordinates": self.chosen.tolist()}},
            "ranks": together.size,
            "coordinates": self.layout.size,
            "step": self.step,
            "steps": self.made,
            "resumed_at": self.begun_at or None,
            "solver": {
                "kind": stepper.solver.getType(),
                "preconditioner": stepper.solver.getPC().getType(),
                "tolerance": self.solver_tolerance,
                "iterations": stepper.iterations,
                "most_iterations": stepper.most_iterations,
                "corrections": stepper.corrections,
                "setup_seconds": stepper.setup_seconds,
            },
            "memory": {"channels": int(channels), "bytes": int(memory)},
            "seconds": {"all": together.largest(time.perf_counter() - self.begun), **seconds},
        }
        if failed is None:
            with self._agreeing():
                if together.rank == 0 and self.directory is not None:
                    self.rows.finish(table)
                    if self.snapshots is not None:
                        self.snapshots.finish()
                    write_json(self.directory.path / "summary.json", summary)
        count = len(self.chosen)
        t, q, p, energy = table[:, 0], table[:, 1 : 1 + count], table[:, 1 + count : -1], table[:, -1]
        status = 0 if failed is None else 1 if isinstance(failed, KeyboardInterrupt) else -1
        return Result(t, q, p, energy, failed is None, status, message, json.dumps(summary))

    def close(self) -> None:
        if self.rows is not None:
            self.rows.close()
        if self.directory is not None:
            self.directory.close()


def _steps(step: float, steps: Any, end: Any) -> int:
    if (steps is None) == (end is None):
        raise InputError("steps: give either steps or end", "steps")
    if steps is not None:
        return _arrays.whole("steps", steps)
    end = _arrays.real("end", end)
    count = int(round(end / step))
    if end < 0.0 or abs(count * step - end) > 1e-9 * max(end, step):
        raise InputError(f"end = {end}: not allowed; allowed: a multiple of step = {step}", "end", str(end))
    return count


def _probes(like: Any, layout: Layout) -> tuple[Any, Any]:
    """Two vectors of random signs that do not depend on the distribution of rows."""
    rows = np.arange(layout.first, layout.end, dtype=np.uint64)
    made = []
    for salt in (0x9E3779B97F4A7C15, 0xD1B54A32D192ED03):
        mixed = (rows + np.uint64(1)) * np.uint64(salt)
        mixed ^= mixed >> np.uint64(29)
        mixed *= np.uint64(0xBF58476D1CE4E5B9)
        vector = like.duplicate()
        vector.setArray(1.0 - 2.0 * (mixed >> np.uint64(63)).astype(np.float64))
        made.append(vector)
    return made[0], made[1]
