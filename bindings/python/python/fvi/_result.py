"""What runs and studies hand back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fvi._types import FloatArray


def _module(name: str, what: str) -> Any:
    """A library that only this call needs."""
    import importlib

    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and error.name.split(".")[0] == name.split(".")[0]:
            raise ModuleNotFoundError(f"{what} needs the package {name.split('.')[0]}", name=error.name) from None
        raise


@dataclass(frozen=True, repr=False)
class Result:
    """A trajectory, and the record of the run that made it.

    Attributes
    ----------
    t : ndarray, shape (K,)
        Times: every `every`-th grid point, and the last; or those of `times`.
    q : ndarray, shape (K, N)
        Positions; of the coordinates that were chosen, if some were.
    p : ndarray, shape (K, N)
        Momenta p = M v, likewise.
    energy : ndarray, shape (K,)
        ½ pᵀM⁻¹p + U(q).
    success : bool
        Whether all steps were made.
    status : int
        0: all steps were made; −1: a step failed; 1: the run was stopped.
    message : str
        How it ended, in words.
    summary : dict
        The record, as `fvi run` writes it to ``summary.json``: inputs as used, version, engine, steps, largest values,
        errors against the reference, warnings.
    """

    t: FloatArray
    q: FloatArray
    p: FloatArray
    energy: FloatArray
    success: bool
    status: int
    message: str
    summary: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        rows, coordinates = self.q.shape
        return (
            f"Result({self.message!r}, {rows} rows of {coordinates} coordinate{'s' if coordinates != 1 else ''}, "
            f"t = {self.t[0]:g} … {self.t[-1]:g})"
        )

    @property
    def coordinates(self) -> list[int]:
        """Which coordinates the columns of `q` and `p` are, numbered from 0."""
        chosen = self.summary.get("scenario", {}).get("output", {}).get("coordinates")
        return list(range(self.q.shape[1])) if chosen is None else list(chosen)

    @property
    def events(self) -> list[dict[str, Any]]:
        """What happened, in the order of time: `event`, which of the scenario's events from 0; `rising`; `time`; `position`, `momentum`
        and `energy` there."""
        return list(self.summary.get("events", []))

    @property
    def title(self) -> str:
        """The title of the scenario; empty if it has none."""
        return str(self.summary.get("scenario", {}).get("title") or "")

    def plot(self, axes: Any = None) -> Any:
        """Draws coordinates and energy over time.

        Parameters
        ----------
        axes : sequence of two matplotlib axes, optional
            Where to draw; without it a new figure is made.

        Returns
        -------
        sequence of two matplotlib axes
        """
        if axes is None:
            pyplot = _module("matplotlib.pyplot", "plot()")
            _, axes = pyplot.subplots(2, 1, sharex=True, layout="constrained")
        above, below = axes
        shown = min(self.q.shape[1], 10)
        for column, coordinate in enumerate(self.coordinates[:shown]):
            above.plot(self.t, self.q[:, column], label=f"q{coordinate}", linewidth=1)
        above.set_ylabel("position")
        above.set_title(self.title if shown == self.q.shape[1] else f"{self.title} (first {shown} coordinates)")
        if shown > 1:
            above.legend(loc="upper right", fontsize="small")
        below.plot(self.t, self.energy, color="black", linewidth=1)
        below.set_ylabel("energy")
        below.set_xlabel("time t")
        return axes

    def to_pandas(self) -> Any:
        """The rows as a pandas DataFrame with the columns of ``trajectory.csv``, over an index t."""
        pandas = _module("pandas", "to_pandas()")
        columns: dict[str, FloatArray] = {}
        for letter, values in (("q", self.q), ("p", self.p)):
            columns.update({f"{letter}{coordinate}": values[:, column] for column, coordinate in enumerate(self.coordinates)})
        columns["energy"] = self.energy
        return pandas.DataFrame(columns, index=pandas.Index(self.t, name="t"))

    def to_xarray(self) -> Any:
        """The rows as an xarray Dataset with dimensions ``t`` and ``coordinate``; scalars of the summary are attributes."""
        xarray = _module("xarray", "to_xarray()")
        scalars = {key: value for key, value in self.summary.items() if isinstance(value, (str, int, float))}
        return xarray.Dataset(
            {"q": (("t", "coordinate"), self.q), "p": (("t", "coordinate"), self.p), "energy": ("t", self.energy)},
            coords={"t": self.t, "coordinate": self.coordinates},
            attrs={"title": self.title, **scalars},
        )


@dataclass(frozen=True, repr=False)
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
        The same in words.
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
        """The table of columns that are at hand."""
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

    def to_pandas(self) -> Any:
        """The table as a pandas DataFrame."""
        return _module("pandas", "to_pandas()").DataFrame(self._columns)
