"""Results of many runs of one model."""

from __future__ import annotations

import html
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fvi import _arrays
from fvi._datasets import dataset, members_of
from fvi._errors import InputError
from fvi._result import Picture, Result, ending, html_table, labelled, new_axes
from fvi._types import FloatArray


@dataclass(frozen=True, repr=False, eq=False)
class Runs:
    """The runs of `Model.batch`: arrays whose first axis is that of the R runs.

    A run that ends early, by an event or a step that fails, has NaN behind its last row; `rows` counts its rows. ``runs[i]`` is
    the `Result` of one run.

    Attributes
    ----------
    t : ndarray, shape (K,) or (R, K)
        Times of the rows: common to all runs where every run has the first of the same times; otherwise a row for each run.
    q, p : ndarray, shape (R, K, N)
        Positions and momenta, of the chosen `coordinates` if any were chosen.
    energy : ndarray, shape (R, K)
        ½ pᵀM⁻¹p + U(q).
    rows, steps : ndarray of int, shape (R,)
        Numbers of rows and of steps of each run.
    status : ndarray of int, shape (R,)
        0: all steps were made, or an event has ended the run; −1: a step failed; −2: the numbers were refused; 1: stopped.
    errors : dict of int to Exception
        By the index of the run, why it was refused or failed.
    events : list of list of dict
        The events of each run, as `Result.events`.
    columns : dict of ndarray, shape (R, K), or (R, K, C) of C controllers or constraints
        Further columns, as `Result.columns`.
    parameters : dict of ndarray
        The numbers of the runs by the names that were given.
    """

    t: FloatArray
    q: FloatArray
    p: FloatArray
    energy: FloatArray
    rows: NDArray[np.int64]
    steps: NDArray[np.int64]
    status: NDArray[np.int64]
    errors: dict[int, Exception]
    events: list[list[dict[str, Any]]]
    columns: dict[str, FloatArray]
    parameters: dict[str, FloatArray]
    _ends: dict[int, dict[str, Any]] = field(default_factory=dict)
    _derivatives: FloatArray | None = None
    _velocities: FloatArray | None = None
    _coordinates: tuple[int, ...] = ()
    _mass: Any = None
    _appearance: tuple[list[str], dict[str, str]] = field(default_factory=lambda: ([], {}))
    """Labels and units of the model."""
    _described: dict[int, dict[str, Any]] = field(default_factory=dict)
    """The title of each run, and what velocities and accelerations follow from."""

    @property
    def success(self) -> NDArray[np.bool_]:
        """Whether each run has status 0."""
        return np.asarray(self.status == 0)

    @property
    def dq(self) -> FloatArray:
        """∂q/∂θ, shape (R, K, P, N): derivatives of the positions with respect to the P `sensitivities`."""
        return self._derived()[..., 0, :]

    @property
    def dp(self) -> FloatArray:
        """∂p/∂θ, shape (R, K, P, N): the same of the momenta."""
        return self._derived()[..., 1, :]

    def _derived(self) -> FloatArray:
        runs, rows, coordinates = self.q.shape
        if self._derivatives is None or self._derivatives.size == 0:
            return np.zeros((runs, rows, 0, 2, coordinates))
        return self._derivatives.reshape(runs, rows, -1, 2, coordinates)

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Result]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> Result:
        if not hasattr(index, "__index__"):
            raise TypeError(f"runs[{index!r}]: the number of a run is needed; several are `[runs[k] for k in …]`")
        place = range(len(self))[index]
        if self.status[place] == -2:
            raise self.errors[place]
        rows = int(self.rows[place])
        known = {"status": "completed", **self._ends.get(place, {}), "steps": int(self.steps[place])}
        status, message = ending(known)
        described = self._described.get(place, {})
        scenario = {
            "system": {},
            **described,
            "initial": {"position": self.q[place, :1].ravel().tolist(), "momentum": self.p[place, :1].ravel().tolist()},
            "output": {**described.get("output", {}), "coordinates": list(self._coordinates)},
        }
        labels, units = self._appearance
        record = {**known, "events": self.events[place], "labels": labels, "units": units, "scenario": scenario}
        return Result(
            np.array(self.t[:rows] if self.t.ndim == 1 else self.t[place, :rows]),
            np.array(self.q[place, :rows]),
            np.array(self.p[place, :rows]),
            np.array(self.energy[place, :rows]),
            status == 0,
            status,
            message,
            json.dumps(record),
            _mass=self._mass,
            columns={name: np.array(column[place, :rows]) for name, column in self.columns.items()},
            _derivatives=None if self._derivatives is None else np.array(self._derivatives[place, :rows]),
            _velocities=None if self._velocities is None else np.array(self._velocities[place, :rows]),
        )

    def __repr__(self) -> str:
        runs, rows, coordinates = self.q.shape
        counts = {"refused": -2, "failed": -1, "stopped": 1}
        others = [f"{count} {name}" for name, status in counts.items() if (count := int((self.status == status).sum()))]
        of = f"{runs} runs of {rows} rows and {coordinates} coordinate{'s' if coordinates != 1 else ''}"
        return f"Runs({', '.join([of, *others])})"

    def _repr_html_(self) -> str:
        """Numbers and ends of the first and the last runs, for notebooks."""
        shown = [*range(min(5, len(self))), *range(max(5, len(self) - 5), len(self))]
        rows = []
        for place in shown:
            numbers = [f"{column[place]:.6g}" if column.ndim == 1 else str(column[place]) for column in self.parameters.values()]
            rows.append([str(place), *numbers, str(self.rows[place]), str(self.status[place])])
        return f"<p>{html.escape(repr(self))}</p>{html_table(('run', *self.parameters, 'rows', 'status'), rows)}"

    def plot(self, coordinate: int | None = None, axes: Any = None) -> Picture:
        """Draws a coordinate and the energy of all runs over time.

        Parameters
        ----------
        coordinate : int, optional
            The coordinate, as the system numbers it; default: the first one that the runs contain.
        axes : sequence of two matplotlib axes, optional
            Axes to draw in; default: a new figure.

        Returns
        -------
        sequence of two matplotlib axes
            With their `figure`, and its `savefig`.
        """
        self._check_made("plot")
        chosen = self._coordinates[0] if coordinate is None else _arrays.whole("coordinate", coordinate)
        if chosen not in self._coordinates:
            allowed = f"a coordinate of the runs: {', '.join(map(str, self._coordinates))}"
            raise InputError(f"coordinate = {chosen}: not allowed; allowed: {allowed}", "coordinate", str(chosen))
        above, below = axes = new_axes(axes, 2, 1, (6.4, 4.8), sharex=True)
        times = np.broadcast_to(self.t, self.energy.shape).T
        above.plot(times, self.q[:, :, self._coordinates.index(chosen)].T, linewidth=0.7)
        labels, units = self._appearance
        place = self._coordinates.index(chosen)
        above.set_ylabel(labelled(labels[place] if labels else f"position q{chosen}", units.get("position", "")))
        below.plot(times, self.energy.T, linewidth=0.7)
        below.set_ylabel(labelled("energy", units.get("energy", "")))
        below.set_xlabel(labelled("time t", units.get("time", "")))
        return Picture(axes)

    def _check_made(self, asked: str) -> None:
        """Refuses runs of which none has rows."""
        if self.q.shape[1] == 0:
            raise InputError(f"{asked}: none of the runs was made; their `errors` say why", asked, "0")

    def to_xarray(self) -> Any:
        """The runs as an xarray Dataset with dimensions ``run``, ``row`` or ``t``, and ``coordinate``, with names, and units where the
        model names them. A parameter with the name of a variable, as p, is p_given."""
        self._check_made("to_xarray")
        along = "t" if self.t.ndim == 1 else "row"
        labels, units = self._appearance
        names = labels or [f"q{coordinate}" for coordinate in self._coordinates]
        rows = {"t": (("t",) if along == "t" else ("run", "row"), self.t)}
        # A parameter may have the name of what the runs have anyway.
        taken = {"q", "p", "energy", "status", "t", "coordinate", "label", *self.columns}
        numbers = {name: column for name, column in self.parameters.items() if column.ndim == 1}
        given = {f"{name}_given" if name in taken else name: ("run", column) for name, column in numbers.items()}
        columns = {name: (("run", along, members_of(name))[: column.ndim], column) for name, column in self.columns.items()}
        variables = {
            "q": (("run", along, "coordinate"), self.q),
            "p": (("run", along, "coordinate"), self.p),
            "energy": (("run", along), self.energy),
            "status": ("run", self.status),
            **columns,
        }
        places = {"coordinate": ("coordinate", list(self._coordinates)), "label": ("coordinate", names)}
        return dataset(variables, {**places, **rows, **given}, units)


def runs_of(
    table: Mapping[str, Any],
    given: dict[str, FloatArray],
    coordinates: tuple[int, ...],
    mass: Any,
    appearance: tuple[list[str], dict[str, str]],
) -> Runs:
    """The runs of what the compiled part has returned."""
    count = len(table["rows"])
    status = np.zeros(count, dtype=np.int64)
    errors: dict[int, Exception] = {}
    ends: dict[int, dict[str, Any]] = {}
    for place, end in enumerate(table["ends"]):
        if end is None:
            continue
        if isinstance(end, Exception):
            status[place], errors[place] = -2, end
            continue
        ends[place] = end
        status[place] = {"event": 0, "stopped": 1, "failed": -1}[end["status"]]
    happened = [table["events"].get(place, []) for place in range(count)]
    return Runs(
        table["t"], table["q"], table["p"], table["energy"], table["rows"], table["steps"], status, errors, happened, table["columns"],
        given, ends, table["derivatives"], table["v"], coordinates, mass, appearance,
    )
