"""Results of runs and studies."""

from __future__ import annotations

import html
import io
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal
from zipfile import BadZipFile

import numpy as np

from fvi import _fvi
from fvi._datasets import _module, dataset, members_of
from fvi._errors import InputError, suggesting
from fvi._types import FloatArray


def _text(record: str | _fvi.Record) -> str:
    """The record of a run as JSON."""
    return record if isinstance(record, str) else record.json()


class Picture(tuple[Any, ...]):
    """The axes of a picture, from top to bottom, with their figure as an attribute."""

    __slots__ = ()

    @property
    def figure(self) -> Any:
        """The matplotlib figure."""
        return self[0].figure

    def savefig(self, *arguments: Any, **keys: Any) -> None:
        """Writes the figure, as `matplotlib.figure.Figure.savefig` does."""
        self.figure.savefig(*arguments, **keys)


def new_axes(axes: Any, rows: int, columns: int, size: tuple[float, float], **keys: Any) -> tuple[Any, ...]:
    """The axes given, or those of a new figure, from top to bottom and left to right."""
    if axes is None:
        pyplot = _module("matplotlib.pyplot", "plot()")
        _, axes = pyplot.subplots(rows, columns, squeeze=False, figsize=size, layout="constrained", **keys)
    found = tuple(np.ravel(axes))
    if len(found) != rows * columns:
        message = f"axes: {len(found)} of them, where {rows * columns} are needed"
        raise InputError(message, "axes", str(len(found)))
    return found


def labelled(name: str, unit: str) -> str:
    """The label of an axis."""
    return f"{name} ({unit})" if unit else name


def html_table(names: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table for notebooks."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


@dataclass(frozen=True)
class Continuation:
    """State that a run needs to continue from a result."""

    given: Any
    engine: str | None
    precision: str
    functions: Any
    prepared: Any
    snapshot: Any


#: Arrays that every file of rows contains.
_STATE = ("t", "q", "p", "energy")


@dataclass(frozen=True, repr=False, eq=False)
class Result:
    """A trajectory, and the record of the run that made it.

    Attributes
    ----------
    t : ndarray, shape (K,)
        Times: every `every`-th grid point, and the last; or those of `times`.
    q : ndarray, shape (K, N)
        Positions, of the chosen `coordinates` if any were chosen.
    p : ndarray, shape (K, N)
        Momenta p = M v, of the same coordinates.
    energy : ndarray, shape (K,)
        ½ pᵀM⁻¹p + U(q).
    success : bool
        Whether all steps were made.
    status : int
        0: all steps were made; −1: a step failed; 1: the run was stopped.
    message : str
        How it ended, in words.
    columns : dict of ndarray, shape (K,), or (K, C) of C controllers
        Further columns of a run, by their names in ``trajectory.csv``; they include the following ones.
    u, setpoint, measure : ndarray, or None without controllers
        Outputs, setpoints and measured values of the controllers at their last sample up to the time of the row.
    multipliers : ndarray, or None without constraints
        λ of the constraints, one column each: their force is −(∂c/∂q)ᵀ λ.
    memory_stored, memory_dissipated : ndarray, or None unless ``output.memory_energy`` is set
        Energy stored in the memories of damping, and dissipated by them since t = 0.
    """

    t: FloatArray
    q: FloatArray
    p: FloatArray
    energy: FloatArray
    success: bool
    status: int
    message: str
    _record: str | _fvi.Record = "{}"
    _warnings: tuple[str, ...] = field(default=(), compare=False)
    _mass: Any = field(default=None, compare=False)
    columns: dict[str, FloatArray] = field(default_factory=dict)
    _derivatives: FloatArray | None = field(default=None, compare=False)
    _continuation: Continuation | None = field(default=None, compare=False)
    _velocities: FloatArray | None = field(default=None, compare=False)
    """Where the momenta of the result do not tell them."""

    def __getstate__(self) -> dict[str, Any]:
        # Functions and memories are not pickled.
        return {**self.__dict__, "_continuation": None, "_record": _text(self._record)}

    @property
    def _why_not(self) -> str:
        """Why there is nothing to continue from."""
        if self.status == -1:
            return "the result ends with a step that failed"
        if "choice" in self.summary:
            return "its scheme and steps were chosen for its end; take a scheme and a step to continue"
        time = self.summary.get("scenario", {}).get("time", {})
        if time.get("grid", "uniform") != "uniform":
            return "the steps of the result differ; only runs with equal steps are continued"
        if self.summary.get("status") == "event":
            return "an event has ended the result inside of a step"
        if self.summary.get("scenario", {}).get("sensitivity"):
            return "the result has sensitivities, which are not continued"
        return (
            "the result has no memory: it was read from a file, made of a scenario's file, by `Model.run` or by `Model.batch`, or its memory "
            "is large and was not kept; "
            "`keep_memory=True` keeps it, and a run with `out` is gone on with by `resume=True`"
        )

    @property
    def u(self) -> FloatArray | None:
        """Outputs of the controllers, held at the time of the row."""
        return self.columns.get("u")

    @property
    def setpoint(self) -> FloatArray | None:
        """Setpoints of the controllers at their last sample."""
        return self.columns.get("setpoint")

    @property
    def measure(self) -> FloatArray | None:
        """Values measured by the controllers at their last sample."""
        return self.columns.get("measure")

    @property
    def multipliers(self) -> FloatArray | None:
        """λ of the constraints, one column each."""
        found = self.columns.get("lambda")
        return None if found is None else found.reshape(len(found), -1)

    @property
    def memory_stored(self) -> FloatArray | None:
        """Energy stored in the memories of damping."""
        return self.columns.get("memory_stored")

    @property
    def memory_dissipated(self) -> FloatArray | None:
        """Energy dissipated by the memories of damping since t = 0."""
        return self.columns.get("memory_dissipated")

    @property
    def dq(self) -> FloatArray:
        """∂q/∂θ, shape (K, P, N): the derivatives of the positions with respect to the P `sensitivities`, in their order."""
        return self._derived()[:, :, 0, :]

    @property
    def dp(self) -> FloatArray:
        """∂p/∂θ, shape (K, P, N): the same of the momenta."""
        return self._derived()[:, :, 1, :]

    def _derived(self) -> FloatArray:
        rows, columns = self.q.shape
        if self._derivatives is None or self._derivatives.size == 0:
            return np.zeros((rows, 0, 2, columns))
        return self._derivatives.reshape(rows, -1, 2, columns)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The record of the run, as `fvi run` writes it to ``summary.json``: inputs as used, version, engine, steps, largest
        values, errors against the reference, warnings."""
        return dict(json.loads(_text(self._record)))

    def _repr_html_(self) -> str:
        """The end of the run and its last rows, for notebooks."""
        shown = self.q.shape[1] if self.q.shape[1] <= 6 else 3
        energy = [] if self._is_equation else ["energy"]
        names = ["t", *(f"{self._letter}{coordinate}" for coordinate in self.coordinates[:shown]), *energy]
        rows = [*range(min(3, len(self.t))), *range(max(3, len(self.t) - 3), len(self.t))]
        cells = [[self.t[row], *self.q[row, :shown], *([self.energy[row]] if energy else [])] for row in rows]
        head = "".join(f"<th>{name}</th>" for name in names)
        body = "".join("<tr>" + "".join(f"<td>{number:.6g}</td>" for number in line) + "</tr>" for line in cells)
        return f"<p>{html.escape(repr(self))}</p><table><tr>{head}</tr>{body}</table>"

    @property
    def _is_equation(self) -> bool:
        """Whether it is of an equation D^α x = f, whose unknowns have neither momenta nor an energy."""
        return bool(self.summary.get("scenario", {}).get("equation"))

    @property
    def _letter(self) -> str:
        return "x" if self._is_equation else "q"

    @property
    def v(self) -> FloatArray:
        """Velocities M⁻¹p, shape (K, N); NaN at coordinates without mass, whose velocity does not follow from the momentum.

        With a `kinetic` energy in words they are those with ∂L/∂v(q, v) = p, on the constraints. At rows inside of steps, as with
        `times`, they have the order of the scheme's polynomial, 1 for the midpoint rule.

        Where the mass couples the `coordinates` of a result with others, the run has kept them.

        Raises
        ------
        InputError
            If they do not follow from the result: it is one of files without the mass, or without some coordinates that the mass
            couples with the others; or of an equation, whose unknowns have none.
        """
        if self._is_equation:
            raise InputError("v: the unknowns of an equation have no mass and no velocities; q holds them, p is 0", "v", "equation")
        if self._velocities is not None and self._velocities.shape == self.q.shape:
            return self._velocities
        mass = self._mass_matrix()
        if mass is not None and mass.ndim == 1:
            chosen = mass[self.coordinates] if len(mass) > 1 else np.full(len(self.coordinates), mass[0])
            return np.asarray(np.where(chosen > 0.0, self.p / np.where(chosen > 0.0, chosen, 1.0), np.nan))
        size = len(self.summary["scenario"]["initial"]["position"]) if mass is None else mass.shape[0]
        if self.p.shape[1] != size:
            message = "v: the mass couples coordinates, and some were left out of the result: choose all `coordinates`"
            raise InputError(message, "v", str(self.p.shape))
        order = np.argsort(self.coordinates)
        return self._velocities_of(self.q[:, order], self.p[:, order])[:, self.coordinates]

    @property
    def a(self) -> FloatArray:
        """Accelerations dv/dt, shape (K, N): the slopes of polynomials through the velocities of five neighbouring rows.

        In addition to the error of the run they have one of order (distance of rows)⁴ where the motion is smooth; it is larger next
        to t = 0 and to jumps of forces. NaN where `v` is. Inside of steps, as with `times`, velocities are of a lower order: that of
        a row at which an event has ended the run is none of the five.

        Raises
        ------
        InputError
            As for `v`; if there is one row only; and for `times` inside of steps of the midpoint rule, whose velocities say too little.
        """
        v, at = self.v, np.flatnonzero(self._with_velocities())
        if len(at) < 2:
            raise InputError("a: two rows are needed at least", "a", str(len(at)))
        width = min(5, len(at))
        first = np.clip(np.searchsorted(at, np.arange(len(self.t))) - width // 2, 0, len(at) - width)
        window = at[first[:, None] + np.arange(width)]
        nodes = self.t[window]
        # Slopes of Newton's form of the polynomial: of the products that follow each other, and their factors.
        value, slope = np.zeros_like(v), np.zeros_like(v)
        parts = v[window]
        for order in range(1, width):
            parts[:, order:] = (parts[:, order:] - parts[:, order - 1 : -1]) / (nodes[:, order:] - nodes[:, :-order])[..., None]
        for order in reversed(range(width)):
            apart = (self.t - nodes[:, order])[:, None]
            slope = slope * apart + value
            value = value * apart + parts[:, order]
        return np.asarray(slope)

    def _with_velocities(self) -> Any:
        """Which rows have velocities from which accelerations follow."""
        scenario = self.summary.get("scenario", {})
        time, chosen = scenario.get("time", {}), np.ones(len(self.t), dtype=bool)
        if time.get("grid") is not None or not isinstance(step := time.get("step"), (int, float)):
            return chosen
        steps = (self.t - time.get("start", 0.0)) / step
        inside = np.abs(steps - np.round(steps)) > 1e-9 * np.maximum(1.0, np.abs(steps))
        if scenario.get("output", {}).get("times"):
            scheme = scenario.get("scheme", {})
            if inside.any() and (scheme.get("kind") == "low-order" or scheme.get("degree") == 1):
                message = "a: between grid points the midpoint rule has velocities of order 1: choose rows at grid points, or another scheme"
                raise InputError(message, "a", "times")
            return chosen
        chosen[-1] = not inside[-1]
        return chosen

    def _mass_matrix(self) -> Any:
        """The mass: its diagonal, a full or a sparse matrix; None where there is a kinetic energy in words."""
        system = self.summary.get("scenario", {}).get("system", {})
        if system.get("kinetic") is not None:
            return None
        mass = system.get("mass") if self._mass is None else self._mass
        if mass is None or isinstance(mass, str):
            where = "in a file, or depends on the position and on parameters of the run"
            raise InputError(f"v: the result does not hold the mass, which is {where}: solve with it yourself", "v", repr(mass))
        if hasattr(mass, "content"):
            loaded = np.load(io.BytesIO(mass.content))
            if mass.ndim == 1:
                mass = loaded["data"]
            elif mass.suffix == ".npz":
                sparse = _module("scipy.sparse", "v")
                mass = sparse.csr_matrix((loaded["data"], loaded["indices"], loaded["indptr"]), shape=loaded["shape"])
            else:
                mass = loaded
        return mass if hasattr(mass, "tocsc") else np.atleast_1d(np.asarray(mass, dtype=np.float64))

    def _velocities_of(self, q: FloatArray, p: FloatArray) -> FloatArray:
        """The velocities of the system at positions and momenta of all coordinates, a row each."""
        mass = self._mass_matrix()
        if mass is None:
            scenario = self.summary["scenario"]
            system = {key: scenario["system"][key] for key in ("kinetic", "parameters", "constraints") if scenario["system"].get(key)}
            initial = {key: scenario["initial"][key] for key in ("position", "momentum")}
            keys = {"system": system, "initial": initial, "time": {"step": 1.0, "steps": 1}}
            return np.asarray(_fvi.velocities(("result", ".", keys, {}), np.ascontiguousarray(q), np.ascontiguousarray(p)))
        if mass.ndim == 1:
            return np.asarray(np.where(mass > 0.0, p / np.where(mass > 0.0, mass, 1.0), np.nan))
        massless = np.asarray(abs(mass).sum(axis=1)).ravel() == 0.0
        if hasattr(mass, "tocsc"):
            sparse = _module("scipy.sparse", "v")
            regular = mass + sparse.diags(massless.astype(np.float64)) if massless.any() else mass
            factor = _module("scipy.sparse.linalg", "v").splu(regular.tocsc())
            velocities = np.asarray(factor.solve(np.ascontiguousarray(p.T)).T)
        else:
            velocities = np.asarray(np.linalg.solve(mass + np.diag(massless.astype(np.float64)), p.T).T)
        velocities[:, massless] = np.nan
        return velocities

    def __call__(self, t: Any) -> FloatArray:
        """Positions between the rows, by cubic Hermite interpolation of positions and velocities.

        In addition to the error of the run they have an interpolation error of order (distance of rows)⁴, of order 3 at
        coordinates without mass and unknowns of equations, whose slopes are differences, and larger near t = 0 where the motion is not smooth. The argument
        `times` of a run evaluates the scheme's own polynomial instead.

        Parameters
        ----------
        t : float or array_like
            Times from the first row to the last.

        Returns
        -------
        ndarray, shape (N,) or (len(t), N)

        Raises
        ------
        InputError
            If a time is outside of the rows, or there are no velocities.
        """
        times = np.asarray(t, dtype=np.float64)
        outside = times[~((times >= self.t[0]) & (times <= self.t[-1]))]
        if outside.size > 0:
            value = str(outside.flat[0])
            raise InputError(f"t = {value}: not allowed; allowed: {self.t[0]:g} ≤ t ≤ {self.t[-1]:g}", "t", value)
        if len(self.t) == 1:
            return np.broadcast_to(self.q[0], (*times.shape, self.q.shape[1])).copy()
        v = np.full_like(self.q, np.nan) if self._is_equation else self.v
        if np.isnan(v).any():
            # Coordinates without mass, and unknowns of equations: slopes of the rows.
            order: Literal[1, 2] = 1 if len(self.t) == 2 else 2
            v = np.where(np.isnan(v), np.gradient(self.q, self.t, axis=0, edge_order=order), v)
        row = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self.t) - 2)
        length = (self.t[row + 1] - self.t[row])[..., None]
        s = (times - self.t[row])[..., None] / length
        start, end = self.q[row], self.q[row + 1]
        slopes = length * v[row], length * v[row + 1]
        rest = (1.0 - s) * slopes[0] - s * slopes[1] + (2.0 * s - 1.0) * (end - start)
        return np.asarray((1.0 - s) * start + s * end + s * (1.0 - s) * rest)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes rows and summary into a file of NumPy's (.npz), which `fvi.load` reads.

        Parameters
        ----------
        path : path
            The file, by its whole name.
        """
        with open(path, "wb") as file:
            derivatives = np.zeros((len(self.t), 0)) if self._derivatives is None else self._derivatives
            columns: dict[str, Any] = dict(self.columns)
            if self._velocities is not None:
                columns["v"] = self._velocities
            np.savez(file, t=self.t, q=self.q, p=self.p, energy=self.energy, **columns, derivatives=derivatives, end=np.array(
                json.dumps({"success": self.success, "status": self.status, "message": self.message, "summary": self.summary})
            ))

    def __repr__(self) -> str:
        rows, coordinates = self.q.shape
        named = "unknown" if self._is_equation else "coordinate"
        return (
            f"Result({self.message!r}, {rows} rows of {coordinates} {named}{'s' if coordinates != 1 else ''}, "
            f"t = {self.t[0]:g} … {self.t[-1]:g})"
        )

    @property
    def coordinates(self) -> list[int]:
        """Which coordinates the columns of `q` and `p` are, numbered from 0."""
        chosen = self.summary.get("scenario", {}).get("output", {}).get("coordinates")
        return list(range(self.q.shape[1])) if chosen is None else list(chosen)

    @property
    def events(self) -> list[dict[str, Any]]:
        """The events that occurred, in order of time: `event`, index of the event in the scenario, from 0; `rising`; `time`;
        `position`, `momentum` and `energy` there."""
        return list(self.summary.get("events", []))

    @property
    def labels(self) -> list[str]:
        """Names of the coordinates: those of the scenario, or q0, q1, …, of the unknowns of an equation x0, x1, …"""
        given = self.summary.get("labels", [])
        return list(given) if len(given) == self.q.shape[1] else [f"{self._letter}{coordinate}" for coordinate in self.coordinates]

    @property
    def units(self) -> dict[str, str]:
        """The units that the scenario names, of "time", "position", "momentum" and "energy"."""
        return dict(self.summary.get("units", {}))

    @property
    def title(self) -> str:
        """The title of the scenario; empty if it has none."""
        return str(self.summary.get("scenario", {}).get("title") or "")

    @suggesting
    def plot(
        self,
        axes: Any = None,
        *,
        coordinates: Sequence[int] | None = None,
        labels: Sequence[str] | None = None,
        unit: str | None = None,
        time_unit: str | None = None,
        energy_unit: str | None = None,
    ) -> Picture:
        """Draws coordinates and energy over time; of an equation, which has no energy, its unknowns.

        Parameters
        ----------
        axes : sequence of two matplotlib axes, optional
            Axes to draw in, one of an equation; default: a new figure.
        coordinates : sequence of int, optional
            The coordinates to draw, as the system numbers them; default: the first ten of the result.
        labels : sequence of str, optional
            Their names in the legend; default: `labels` of the result.
        unit, time_unit, energy_unit : str, optional
            Units for the labels; default: `units` of the result.

        Returns
        -------
        sequence of two matplotlib axes, or of one
            With their `figure`, and its `savefig`.
        """
        known = self.coordinates
        chosen = known[:10] if coordinates is None else [int(coordinate) for coordinate in np.ravel(coordinates)]
        for coordinate in chosen:
            if coordinate not in known:
                allowed = f"coordinates of the result: {', '.join(map(str, known[:64]))}"
                raise InputError(f"coordinates: {coordinate}: not allowed; allowed: {allowed}", "coordinates", str(coordinate))
        own, units = self.labels, self.units
        names = [own[known.index(coordinate)] for coordinate in chosen] if labels is None else list(labels)
        if len(names) != len(chosen):
            raise InputError(f"labels: {len(names)} names for {len(chosen)} coordinates", "labels", str(len(names)))
        axes = new_axes(axes, 1 if self._is_equation else 2, 1, (6.4, 4.8), sharex=True)
        above, below = axes[0], axes[-1]
        for coordinate, name in zip(chosen, names):
            above.plot(self.t, self.q[:, known.index(coordinate)], label=name, linewidth=1)
        drawn = "unknown" if self._is_equation else "position"
        above.set_ylabel(labelled(drawn, units.get("position", "") if unit is None else unit))
        first = coordinates is None and len(chosen) < len(known)
        above.set_title(f"{self.title} (first {len(chosen)} coordinates)" if first else self.title)
        if len(chosen) > 1 or labels is not None:
            above.legend(loc="upper right", fontsize="small")
        if not self._is_equation:
            below.plot(self.t, self.energy, color="black", linewidth=1)
            below.set_ylabel(labelled("energy", units.get("energy", "") if energy_unit is None else energy_unit))
        below.set_xlabel(labelled("time t", units.get("time", "") if time_unit is None else time_unit))
        return Picture(axes)

    def to_pandas(self) -> Any:
        """The rows as a pandas DataFrame with the columns of ``trajectory.csv``, over an index t."""
        pandas = _module("pandas", "to_pandas()")
        columns: dict[str, FloatArray] = {}
        for letter, values in ((self._letter, self.q), *(() if self._is_equation else (("p", self.p),))):
            columns.update({f"{letter}{coordinate}": values[:, column] for column, coordinate in enumerate(self.coordinates)})
        if not self._is_equation:
            columns["energy"] = self.energy
        # As in the file: controller by controller.
        several = max((column.shape[1] for column in self.columns.values() if column.ndim == 2), default=0)
        for member in range(several):
            columns.update({f"{name}{member}": column[:, member] for name, column in self.columns.items() if column.ndim == 2})
        columns.update({name: column for name, column in self.columns.items() if column.ndim == 1})
        for parameter in range(self.dq.shape[1]):
            for letter, values in (("dq", self.dq), ("dp", self.dp)):
                of = enumerate(self.coordinates)
                columns.update({f"{letter}{coordinate}_d{parameter}": values[:, parameter, column] for column, coordinate in of})
        return pandas.DataFrame(columns, index=pandas.Index(self.t, name="t"))

    def to_xarray(self) -> Any:
        """The rows as an xarray Dataset with dimensions ``t`` and ``coordinate``, with names, and units where the scenario names them;
        scalars of the summary are attributes."""
        known = {"title": self.title, **self.summary}
        dimensions = {name: ("t", members_of(name))[: column.ndim] for name, column in self.columns.items()}
        rows: dict[str, tuple[Any, Any]] = {name: (dimensions[name], column) for name, column in self.columns.items()}
        if not self._is_equation:
            rows = {"energy": ("t", self.energy), **rows}
        if self.dq.shape[1] > 0:
            rows.update((name, (("t", "parameter", "coordinate"), values)) for name, values in (("dq", self.dq), ("dp", self.dp)))
        state: dict[str, tuple[Any, Any]] = {self._letter: (("t", "coordinate"), self.q)}
        if not self._is_equation:
            state["p"] = (("t", "coordinate"), self.p)
        places = {"t": ("t", self.t), "coordinate": ("coordinate", self.coordinates), "label": ("coordinate", self.labels)}
        scalars = {key: value for key, value in known.items() if isinstance(value, (str, int, float))}
        return dataset({**state, **rows}, places, self.units, scalars)


Arrays = tuple[
    FloatArray, FloatArray, FloatArray, FloatArray, dict[str, FloatArray], FloatArray | None, FloatArray | None
]
"""t, q, p, energy, further columns, derivatives by parameters, and velocities where the momenta do not tell them."""


def of_arrays(arrays: Any) -> Arrays:
    """What is in a file of NumPy arrays."""
    if "x" in arrays:
        # The unknowns of an equation have neither momenta nor an energy.
        t, q = arrays["t"], arrays["x"]
        p, energy = np.zeros_like(q), np.zeros_like(t)
    else:
        t, q, p, energy = (arrays[name] for name in _STATE)
    others = (*_STATE, "x", "end", "derivatives", "v")
    columns = {name: arrays[name] for name in arrays if name not in others}
    return t, q, p, energy, columns, arrays.get("derivatives"), arrays.get("v")


def ending(known: Mapping[str, Any]) -> tuple[int, str]:
    """Status and message of a result, from the record of how its run ended."""
    if known["status"] == "completed":
        return 0, f"all {known['steps']} steps were made"
    if known["status"] == "event":
        return 0, f"event {known['event']} ended the run at t = {known['time']}"
    if known["status"] == "stopped":
        wanted = f" of {known['steps_wanted']}" if "steps_wanted" in known else ""
        return 1, f"stopped after {known['steps']}{wanted} steps"
    return -1, f"step {known['step']} (from t = {known['time']}) failed: {known['reason']}"


def _of_directory(path: str) -> Result:
    """The result in the directory of a run: ``summary.json`` and ``trajectory.csv`` or ``trajectory.npz``."""
    with open(os.path.join(path, "summary.json"), encoding="utf-8") as file:
        record = file.read()
    known = json.loads(record)
    status, message = ending(known)
    warned = tuple(known.get("warnings", ()))
    arrays = os.path.join(path, "trajectory.npz")
    if "trajectory.npz" in known["files"]:
        with np.load(arrays, allow_pickle=False) as kept:
            t, q, p, energy, columns, derivatives, _ = of_arrays(kept)
        return Result(
            t, q, p, energy, status == 0, status, message, record, warned, columns=columns, _derivatives=derivatives
        )
    with open(os.path.join(path, "trajectory.csv"), encoding="utf-8") as file:
        names = file.readline().rstrip("\n").split(",")
        rows = np.loadtxt(file, delimiter=",", ndmin=2)

    def taken(pattern: str) -> list[int]:
        return [index for index, name in enumerate(names) if re.fullmatch(pattern, name)]

    def part(pattern: str) -> FloatArray:
        return np.ascontiguousarray(rows[:, taken(pattern)])

    q, p = part(r"[qx]\d+"), part(r"p\d+")
    if not taken(r"p\d+"):
        p = np.zeros_like(q)
    columns = {}
    for heading in names:
        name = heading.rstrip("0123456789")
        if re.fullmatch(r"t|energy|[qpx]\d+|d[qp]\d+_d\d+", heading) or name in columns:
            continue
        columns[name] = part(re.escape(name))[:, 0] if name == heading else part(rf"{re.escape(name)}\d+")
    parameters = len(taken(r"dq\d+_d\d+")) // q.shape[1]
    by_parameter = [part(rf"d{letter}\d+_d{parameter}") for parameter in range(parameters) for letter in "qp"]
    derivatives = np.concatenate(by_parameter, axis=1) if by_parameter else None
    t = part("t")[:, 0]
    energy = part("energy")[:, 0] if "energy" in names else np.zeros_like(t)
    return Result(t, q, p, energy, status == 0, status, message, record, warned, columns=columns, _derivatives=derivatives)


@suggesting
def load(path: str | os.PathLike[str]) -> Result:
    """Reads a result that `Result.save` wrote, or the directory of a run of `fvi run` or with `out`; the numbers are restored bit
    by bit.

    Parameters
    ----------
    path : path
        The file, or the directory.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        If file or directory contains no result.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import fvi, os, tempfile
    >>> r = fvi.integrate(mass=[1.0], stiffness=[4.0], position=[1.0], step=0.01, steps=10)
    >>> with tempfile.TemporaryDirectory() as directory:
    ...     r.save(os.path.join(directory, "r.npz"))
    ...     same = fvi.load(os.path.join(directory, "r.npz"))
    >>> bool((same.q == r.q).all()), same.summary == r.summary
    (True, True)
    """
    try:
        if os.path.isdir(path):
            return _of_directory(os.fspath(path))
        with np.load(path, allow_pickle=False) as arrays:
            t, q, p, energy, columns, derivatives, velocities = of_arrays(arrays)
            end = json.loads(str(arrays["end"]))
        record = json.dumps(end["summary"])
        return Result(
            t, q, p, energy, end["success"], end["status"], end["message"], record, columns=columns, _derivatives=derivatives,
            _velocities=velocities,
        )
    except (KeyError, ValueError, TypeError, EOFError, BadZipFile) as error:
        raise InputError(f"path: {os.fspath(path)} holds no result of fvi: {error}", "path", os.fspath(path)) from None


@dataclass(frozen=True, repr=False, eq=False)
class Extremal:
    """The solution of a two-point problem on its grid.

    Attributes
    ----------
    t : ndarray, shape (K,)
        Grid times.
    x : ndarray, shape (K, d)
        Positions.
    v : ndarray, shape (K, d)
        Fractional velocities; NaN at the end where they are not defined.
    success : bool
        Whether the iteration converged; if not, x is its best iterate.
    message : str
        Description of how it ended.
    summary : dict
        Value of the functional, iterations, residuals.
    """

    t: FloatArray
    x: FloatArray
    v: FloatArray
    success: bool
    message: str
    summary: dict[str, Any]

    def __repr__(self) -> str:
        return f"Extremal({self.message!r}, {self.x.shape[0]} grid points, d = {self.x.shape[1]})"


class Table(Mapping[str, Any]):
    """Columns of equal length, by name.

    Examples
    --------
    >>> table = Table([{"level": 4, "error": 0.5}, {"level": 5, "error": 0.25}])
    >>> list(table)
    ['level', 'error']
    >>> float(table["error"][1])
    0.25
    """

    def __init__(self, rows: list[dict[str, Any]]) -> None:
        names = list(rows[0]) if rows else []
        self._columns = {name: np.array([row[name] for row in rows]) for name in names}

    @classmethod
    def of_columns(cls, columns: Mapping[str, Any]) -> Table:
        """A table from given columns."""
        table = cls([])
        table._columns = {name: np.asarray(column) for name, column in columns.items()}
        return table

    def __getitem__(self, name: str) -> Any:
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        texts = {
            name: [name, *(f"{value:.4g}" if isinstance(value, float) else str(value) for value in column.tolist())]
            for name, column in self._columns.items()
        }
        widths = {name: max(map(len, cells)) for name, cells in texts.items()}
        lines = zip(*([cell.rjust(widths[name]) for cell in cells] for name, cells in texts.items()))
        return "\n".join("  ".join(line) for line in lines)

    def _repr_html_(self) -> str:
        """The columns as a table, for notebooks."""
        texts = [[f"{value:.4g}" if isinstance(value, float) else str(value) for value in column.tolist()] for column in self._columns.values()]
        return html_table(self._columns, zip(*texts))

    def plot(self, x: str, *columns: str, axes: Any = None, logarithmic: bool = False) -> Picture:
        """Draws columns over another one.

        Parameters
        ----------
        x : str
            The column along the picture.
        *columns : str
            The columns drawn over it.
        axes : matplotlib axes, optional
            Axes to draw in; default: a new figure.
        logarithmic : bool
            Whether both scales are logarithmic.

        Returns
        -------
        sequence of one matplotlib axes
            With its `figure`, and its `savefig`.
        """
        for name in (x, *columns):
            if name not in self._columns:
                allowed = f"a column: {', '.join(self._columns)}"
                raise InputError(f"{name}: not allowed; allowed: {allowed}", name, name)
        (place,) = axes = new_axes(axes, 1, 1, (6.4, 4.0))
        for name in columns:
            place.plot(self._columns[x], self._columns[name], ".-", label=name, linewidth=1)
        if logarithmic:
            place.set_xscale("log")
            place.set_yscale("log")
        place.set_xlabel(x)
        if len(columns) == 1:
            place.set_ylabel(columns[0])
        elif columns:
            place.legend(fontsize="small")
        return Picture(axes)

    def to_pandas(self) -> Any:
        """The table as a pandas DataFrame."""
        return _module("pandas", "to_pandas()").DataFrame(self._columns)

    def to_xarray(self) -> Any:
        """The table as an xarray Dataset with the dimension ``row``."""
        return dataset({name: ("row", column) for name, column in self._columns.items()}, {}, {})


class Convergence(Table):
    """Errors and orders over step sizes, with their picture."""

    def plot_errors(
        self, quantities: Sequence[Literal["position", "momentum", "energy"]] = ("position", "momentum", "energy"), axes: Any = None
    ) -> Picture:
        """Draws errors over the step size, both logarithmic, with the last measured order in the legend.

        Parameters
        ----------
        quantities : sequence of {"position", "momentum", "energy"}
            The errors to draw; those without a reference are left out.
        axes : matplotlib axes, optional
            Axes to draw in; default: a new figure.

        Returns
        -------
        sequence of one matplotlib axes
            With its `figure`, and its `savefig`.
        """
        (place,) = axes = new_axes(axes, 1, 1, (5.6, 4.2))
        for quantity in quantities:
            if f"{quantity}_error" not in self:
                allowed = '"position", "momentum", "energy"'
                raise InputError(f"quantities: {quantity!r}: not allowed; allowed: {allowed}", "quantities", repr(quantity))
            errors, orders = self[f"{quantity}_error"], self[f"{quantity}_order"]
            if np.isfinite(errors).any():
                known = orders[np.isfinite(orders)]
                name = f"{quantity}, order {known[-1]:.2f}" if known.size else quantity
                place.loglog(self["step"], errors, ".-", label=name, linewidth=1)
        place.set_xlabel("step h")
        place.set_ylabel("largest error")
        if place.get_legend_handles_labels()[0]:
            place.legend(fontsize="small")
        return Picture(axes)
