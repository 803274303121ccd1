"""Numbers of a scenario from data."""

from __future__ import annotations

import copy
import csv
import html
import io
import json
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Unpack

import numpy as np

from fvi import _arrays, _fvi
from fvi._datasets import _module, appearance_of, attributes, dataset
from fvi._errors import InputError
from fvi._result import Picture, labelled, new_axes
from fvi._run import Progress, check_progress
from fvi._scenario import Scenario, by_path, put, source
from fvi._system import scenario_of, source_of
from fvi._types import FloatArray, ScenarioKeys, Whole


@dataclass(frozen=True)
class Estimate:
    """An estimated parameter.

    Attributes
    ----------
    start, estimate : float
        Start value of the search, and the value with the smallest sum of squares.
    standard_error : float or None
        None where the data do not determine it, and at a bound.
    interval : (float, float) or None
        The 95 % interval; None in the same cases.
    at_bound : {"lower", "upper"} or None
        The bound at which the estimate lies.
    derivative : {"exact", "differences"}
        Whether exact derivatives of the discrete motion or differences, of runs or of closed forms of any table, were used.
    profile_interval : (float or None, float or None) or None
        The 95 % interval of the profile likelihood, where requested; None for an end that was not reached.
    profile : ndarray, shape (L, 2), or None
        Values of the parameter, and for each the smallest χ² over the other parameters.
    """

    start: float
    estimate: float
    standard_error: float | None
    interval: tuple[float, float] | None
    at_bound: str | None
    derivative: str
    profile_interval: tuple[float | None, float | None] | None = None
    profile: FloatArray | None = field(default=None, compare=False)


@dataclass(frozen=True)
class FitTable:
    """A table of data with the predictions of the fitted model.

    Attributes
    ----------
    over : {"t", "omega"}
        Independent variable of the rows.
    places : ndarray, shape (K,)
        Times, or angular frequencies.
    data, model, deviation : dict of ndarray
        Data, predictions and standard deviations, by the names of the columns.
    temperature, log10_shift : float or None
        Its temperature, and log₁₀ of the factor a by which that shifts it, where tables are shifted: the master curve is over
        a ω, or t/a.
    """

    over: str
    places: FloatArray
    data: dict[str, FloatArray]
    model: dict[str, FloatArray]
    deviation: dict[str, FloatArray]
    temperature: float | None = None
    log10_shift: float | None = None
    _units: dict[str, str] = field(default_factory=dict, repr=False, compare=False)

    def to_pandas(self) -> Any:
        """The rows as a pandas DataFrame over `places`, with columns such as ``q0``, ``q0_model`` and ``q0_deviation``."""
        pandas = _module("pandas", "to_pandas()")
        columns = {
            f"{name}{behind}": values[name]
            for name in self.data
            for behind, values in (("", self.data), ("_model", self.model), ("_deviation", self.deviation))
        }
        return pandas.DataFrame(columns, index=pandas.Index(self.places, name=self.over))

    def to_xarray(self) -> Any:
        """The same as an xarray Dataset, with names, and units where the scenario names them."""
        frame: dict[str, tuple[Any, Any]] = {}
        described = {}
        for name, data in self.data.items():
            of = attributes(name.rstrip("0123456789"), self._units)
            for behind, values in (("", data), ("_model", self.model[name]), ("_deviation", self.deviation[name])):
                frame[f"{name}{behind}"] = (self.over, values)
                described[f"{name}{behind}"] = {**of, "long_name": f"{of['long_name']} {name}{behind.replace('_', ', ')}"}
        made = dataset(frame, {self.over: (self.over, self.places)}, self._units)
        for name, entries in described.items():
            made[name].attrs.update(entries)
        return made


@dataclass(frozen=True, repr=False)
class Fit:
    """Estimates with their errors, and the scenario with the estimates.

    Attributes
    ----------
    parameters : dict of Estimate
        By their paths.
    correlation : ndarray, shape (P, P)
        Correlations of the estimates, in the order of `parameters`; NaN where one has no standard error.
    chi2 : float
        Σ ((model − datum)/deviation)², with deviations of 1 where none are known.
    degrees_of_freedom : int
        Number of data minus number of parameters that are determined.
    reduced_chi2 : float or None
        χ² over the degrees of freedom.
    aic, bic : float
        Criteria of Akaike and of Schwarz, with the whole likelihood of normal deviations.
    converged : bool
        Whether the search ended at a minimum.
    undetermined, notes : tuple of str
        Sentences about what the data do not determine, and further remarks.
    name : str or None
        The model, where several were compared.
    models : dict
        The records of all models, where several were compared, by their names.
    scenario : dict
        The scenario with the estimates as values, for `fvi.run`.
    scenarios : tuple of dict
        The scenario for each table of data, with the values of that table.
    tables : tuple of FitTable
        The data, and the predictions of the model.
    record : dict
        Everything else, as `fvi fit` writes it to ``fit.json``.
    """

    parameters: dict[str, Estimate]
    correlation: FloatArray
    chi2: float
    degrees_of_freedom: int
    reduced_chi2: float | None
    aic: float
    bic: float
    converged: bool
    undetermined: tuple[str, ...]
    notes: tuple[str, ...]
    name: str | None
    models: dict[str, dict[str, Any]]
    scenario: dict[str, Any]
    scenarios: tuple[dict[str, Any], ...]
    tables: tuple[FitTable, ...]
    record: dict[str, Any]
    _report: str = ""

    @property
    def estimates(self) -> dict[str, float]:
        """The estimates by their paths."""
        return {path: found.estimate for path, found in self.parameters.items()}

    @property
    def comparison(self) -> dict[str, dict[str, float]]:
        """The models that were compared: `parameters`, `chi2`, `aic`, `aic_difference` from the smallest, Akaike's weight
        `aic_weight`, e^(−difference/2) over the sum of all, and `bic`. A DataFrame by ``pandas.DataFrame(fit.comparison).T``."""
        aic = {name: _number(model["aic"]) for name, model in self.models.items()}
        smallest = min(aic.values(), default=0.0)
        above = {name: 0.0 if own == smallest else own - smallest for name, own in aic.items()}
        total = sum(np.exp(-0.5 * own) for own in above.values())
        return {
            name: {
                "parameters": len(model["parameters"]),
                "chi2": model["chi2"],
                "aic": aic[name],
                "aic_difference": above[name],
                "aic_weight": float(np.exp(-0.5 * above[name]) / total),
                "bic": _number(model["bic"]),
            }
            for name, model in self.models.items()
        }

    @property
    def standard_errors(self) -> dict[str, float | None]:
        """Their standard errors."""
        return {path: found.standard_error for path, found in self.parameters.items()}

    @property
    def intervals(self) -> dict[str, tuple[float, float] | None]:
        """Their 95 % intervals."""
        return {path: found.interval for path, found in self.parameters.items()}

    def __repr__(self) -> str:
        return self._report.rstrip()

    def _repr_html_(self) -> str:
        """The estimates as a table, for notebooks."""

        def cell(number: float | None) -> str:
            return "–" if number is None else f"{number:.6g}"

        rows = []
        for path, found in self.parameters.items():
            interval = "not determined" if found.interval is None else " to ".join(map(cell, found.interval))
            if found.at_bound is not None:
                interval = f"at its {found.at_bound} bound"
            cells = [html.escape(path), cell(found.estimate), cell(found.standard_error), interval]
            rows.append("<tr>" + "".join(f"<td>{entry}</td>" for entry in cells) + "</tr>")
        head = "".join(f"<th>{name}</th>" for name in ("parameter", "estimate", "standard error", "95 % interval"))
        said = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in (*self.undetermined, *self.notes))
        model = "" if self.name is None else f"{html.escape(self.name)}: "
        end = f"<p>{model}χ² = {self.chi2:.6g}, AIC = {self.aic:.6g}, BIC = {self.bic:.6g}</p>"
        return f"<table><tr>{head}</tr>{''.join(rows)}</table>{end}<ul>{said}</ul>"

    def to_pandas(self) -> Any:
        """The estimates as a pandas DataFrame, a row for each parameter by its path."""
        pandas = _module("pandas", "to_pandas()")
        return pandas.DataFrame(self._estimates(), index=pandas.Index(list(self.parameters), name="parameter"))

    def to_xarray(self) -> Any:
        """The estimates, with their correlations, as an xarray Dataset with dimensions ``parameter`` and ``other``; χ² and the criteria
        are attributes. `tables` have a Dataset each."""
        variables: dict[str, tuple[Any, Any]] = {name: ("parameter", column) for name, column in self._estimates().items()}
        variables["correlation"] = (("parameter", "other"), self.correlation)
        paths = list(self.parameters)
        numbers = {"chi2": self.chi2, "aic": self.aic, "bic": self.bic, "degrees_of_freedom": self.degrees_of_freedom}
        return dataset(variables, {"parameter": ("parameter", paths), "other": ("other", paths)}, {}, numbers)

    def _estimates(self) -> dict[str, Any]:
        found = list(self.parameters.values())

        def column(numbers: list[float | None]) -> FloatArray:
            return np.array([np.nan if number is None else number for number in numbers], dtype=np.float64)

        return {
            "start": column([one.start for one in found]),
            "estimate": column([one.estimate for one in found]),
            "standard_error": column([one.standard_error for one in found]),
            "lower": column([None if one.interval is None else one.interval[0] for one in found]),
            "upper": column([None if one.interval is None else one.interval[1] for one in found]),
            "at_bound": np.array([one.at_bound or "" for one in found]),
        }

    def plot(self, axes: Any = None, *, units: Mapping[str, str] | None = None) -> Picture:
        """Draws data and model, and below them the residuals over their deviations, a column for each table of data.

        Parameters
        ----------
        axes : sequence of matplotlib axes, optional
            Axes to draw in, those of the data first; default: a new figure.
        units : mapping of str to str, optional
            Units for the labels, by the names of the columns: "t", "omega", "q0", …

        Returns
        -------
        sequence of matplotlib axes
            Those of the data first, with their `figure`, and its `savefig`.
        """
        units, count = {} if units is None else units, len(self.tables)
        axes = new_axes(axes, 2, count, (max(6.0, 4.5 * count), 5.5), sharex="col")
        for column, table in enumerate(self.tables):
            above, below = axes[column], axes[count + column]
            for index, name in enumerate(table.data):
                colour, shown = f"C{index}", labelled(name, units.get(name, ""))
                above.plot(table.places, table.data[name], ".", color=colour, label=f"{shown}, data")
                above.plot(table.places, table.model[name], "-", color=colour, label=f"{shown}, model")
                left = (table.data[name] - table.model[name]) / table.deviation[name]
                below.plot(table.places, left, ".", color=colour)
            if table.over == "omega":
                above.set_xscale("log")
                if all((values > 0).all() for values in (*table.data.values(), *table.model.values())):
                    above.set_yscale("log")
            above.legend()
            below.axhline(0, color="0.5", linewidth=0.8)
            below.set_xlabel(labelled("ω" if table.over == "omega" else "t", units.get(table.over, "")))
        axes[count].set_ylabel("(datum − model)/deviation")
        return Picture(axes)


    def plot_models(self, axes: Any = None) -> Picture:
        """Draws AIC minus the smallest over the number of parameters of the models that were compared.

        Parameters
        ----------
        axes : matplotlib axes, optional
            Default: a new figure.

        Raises
        ------
        InputError
            If there is one model only.
        """
        if not self.models:
            raise InputError("models: there is one model only", "models")
        axes = new_axes(axes, 1, 1, (6.0, 4.0))
        for name, row in self.comparison.items():
            axes[0].plot(row["parameters"], row["aic_difference"], "o", label=name)
        axes[0].set_xlabel("free parameters")
        axes[0].set_ylabel("AIC − smallest AIC")
        axes[0].legend()
        return Picture(axes)

    def plot_master_curve(self, axes: Any = None, *, units: Mapping[str, str] | None = None) -> Picture:
        """Draws data of all temperatures and the model over the reduced frequency a ω, or the reduced time t/a.

        Parameters
        ----------
        axes : matplotlib axes, optional
            Default: a new figure.
        units : mapping of str to str, optional
            Units for the labels, by the names of the columns.

        Raises
        ------
        InputError
            If the tables are not shifted, or some are over time and others over frequencies.
        """
        units = {} if units is None else units
        if len({table.over for table in self.tables}) != 1 or any(table.log10_shift is None for table in self.tables):
            raise InputError("shift: tables over one variable with a shift are needed for a master curve", "shift")
        axes, over_time = new_axes(axes, 1, 1, (6.0, 4.5)), self.tables[0].over == "t"
        for index, table in enumerate(self.tables):
            factor = 10.0 ** (table.log10_shift or 0.0)
            places = table.places / factor if over_time else table.places * factor
            for name, values in table.data.items():
                label = f"{labelled(name, units.get(name, ''))} at {table.temperature:g}"
                axes[0].plot(places, values, ".", color=f"C{index}", label=label)
                axes[0].plot(places, table.model[name], "-", color=f"C{index}")
        axes[0].set_xscale("log")
        if all((values > 0).all() for table in self.tables for values in (*table.data.values(), *table.model.values())):
            axes[0].set_yscale("log")
        axes[0].set_xlabel(labelled("t/a" if over_time else "a ω", units.get(self.tables[0].over, "")))
        axes[0].legend()
        return Picture(axes)


Data = Mapping[str, Any] | Any
"""A table of data: a dictionary, or a DataFrame of pandas."""

Free = Mapping[str, Any] | Sequence[Any]
"""Paths of the numbers that are sought, with what is known of each."""


def fit(
    scenario: Scenario,
    free: Free,
    data: Data | Sequence[Data],
    *,
    models: Mapping[str, Mapping[str, Any]] | None = None,
    shift: Mapping[str, Any] | None = None,
    starts: Whole = 1,
    seed: Whole = 1,
    deviations: Literal["known", "relative"] | None = None,
    profile: bool | Sequence[str] = False,
    most_iterations: Whole | None = None,
    progress: Progress | None = None,
    overrides: Mapping[str, Any] | None = None,
    **keys: Unpack[ScenarioKeys],
) -> Fit:
    """Estimates numbers of a scenario from measured data, as the program `fvi fit` does.

    Weighted least squares within bounds, by the method of Levenberg and Marquardt, with exact derivatives of the discrete motion
    where they are available.

    Parameters
    ----------
    scenario : path, dict or System
        As in `run`.
    free : dict or list
        Paths of the free parameters, such as ``"system.damping[0].order"``; as a dictionary with a value for each: None, a start
        value, or a dictionary of `start` (default: the scenario's value), `bounds`, `scale` ("linear" or "log") and `data`, the
        index of the only table that the parameter applies to. The path of a kernel of the form "prony" with ``{"terms": 8}``
        seeks strengths ≥ 0 of 8 terms, whose times are spread over those of the data, or `between` two; ``{"terms": (1, 8)}``
        compares all these numbers of terms as `models`.
    data : dict or DataFrame, or list of them
        Tables of data: `t` and any of `q0`, `p0`, `v0`, `a0`, …, `energy`; or `omega` with `re` and `im`, a complex
        `value`: a receptance (`input`, `output`), or with `quantity` a "mobility" or "accelerance"; or `omega` with `magnitude`, of
        the `quantity` "receptance", "mobility", "accelerance", "modulus" or "kernel"; or `omega`
        with `storage`, `loss`, `magnitude`, `tan_delta`, or `t` with `relaxation` or `creep`: those of the modulus
        K + Σ ρ K(s), or of K(s) of the damping `term`. `deviation`, a number, an array or a dictionary by columns;
        `relative_deviation`, a fraction of each datum, a number or a dictionary by columns, for `re` and `im` of their
        magnitude unless `relative_to` is "datum" or "magnitude"; or `weight`, an array. `set`: values of the scenario for this table, by their paths.
        `f`, in Hz, may stand in place of `omega`. `frame`, a DataFrame, whose index counts as a column if it has a name, or
        `file`, a table with commas, semicolons, tabs or spaces in UTF-8, UTF-16 or Latin-1, stand in place of the columns, or a
        DataFrame in place of the dictionary. `columns`: names of the columns there by those above, such as
        ``{"omega": "Angular Frequency"}``, or of a file their numbers from 1 on; `units`: what columns are multiplied by, "Hz" or "rad/s" for frequencies; `decimal`: "," where it stands before the decimals of
        the file. Rows are brought into order; those with a NaN are left out, as one of the `notes` tells.
    models : dict, optional
        Models to compare by their names: dictionaries of `set`, values by their paths, `scenario`, a path, and `free`, further
        free parameters, as above. The one with the smallest AIC is returned; `Fit.comparison` is the table of all.
    shift : dict, optional
        Makes one master curve of tables at several temperatures, each with a key `temperature`: `law` "wlf" with `c1` and `c2`,
        "arrhenius" with `energy` in J/mol, or "free", and `reference`, the temperature without shift; `unit` "celsius" or
        "kelvin". Its numbers may be free: "shift.c1", "shift.c2", "shift.energy", "shift.log10".
    starts, seed : int
        Number of searches, from points between the bounds, and the seed for choosing them.
    deviations : {"known", "relative"}, optional
        Whether the given deviations are the standard deviations of the data, or known only up to a common factor, which is then
        estimated from the residuals. Default: "known" if deviations are given.
    profile : bool or list of str
        Whether, or for which paths, intervals by the profile likelihood are computed, too.
    most_iterations : int, optional
        Largest number of steps of a search.
    progress : callable, optional
        Called about ten times a second with the number of runs made, and None.
    overrides, **keys
        As in `run`.

    Returns
    -------
    Fit
        Parameters that the data do not determine have no interval; `undetermined` lists them.

    Raises
    ------
    InputError
        If the scenario or the data cannot be used.

    Warns
    -----
    UserWarning
        If a search has not converged.

    Examples
    --------
    >>> import fvi, numpy as np
    >>> oscillator = {"system": {"mass": [1.0], "potential": "2*q0^2", "damping": [{"order": 0.5, "coefficient": [0.1]}]},
    ...               "initial": {"position": [1.0]}, "time": {"step": 0.05, "steps": 200}}
    >>> measured = fvi.run(oscillator)
    >>> found = fvi.fit(oscillator, {"system.damping[0].order": 0.8, "system.damping[0].coefficient[0]": 0.2},
    ...                 {"t": measured.t, "q0": measured.q[:, 0]})
    >>> bool(abs(found.estimates["system.damping[0].order"] - 0.5) < 1e-8)
    True
    >>> fvi.run(found.scenario).success
    True
    """
    scenario, changed = scenario_of(scenario, keys)
    scenario, given = source_of(scenario, by_path(overrides, changed, fit))
    files: dict[str, bytes] = {}
    if isinstance(data, Mapping) or _is_frame(data):
        data = [data]
    plan: dict[str, Any] = {
        "scenario": "the one at hand",
        "free": _free("free", free),
        "data": [_table(index, table, files) for index, table in enumerate(data)],
        "starts": _arrays.whole("starts", starts, 1),
        "seed": _arrays.whole("seed", seed),
        "profile": profile if isinstance(profile, bool) else [str(path) for path in profile],
    }
    if most_iterations is not None:
        plan["most_iterations"] = _arrays.whole("most_iterations", most_iterations, 1)
    if deviations is not None:
        plan["deviations"] = deviations
    if shift is not None:
        plan["shift"] = dict(shift)
    if models is not None:
        plan["model"] = [_model(name, model) for name, model in models.items()]
    name, directory, written, more = source(plan, {}, "fit")
    progress = check_progress(progress)
    try:
        records, best, scenarios, report, tables = _fvi.fit((name, directory, written, {**more, **files}), given, progress)
    except InputError as error:
        message = of_arrays(str(error), files)
        place = re.match(r"data\[[0-9]+\]", message) if message != str(error) else None
        raise InputError(message, place[0] if place else error.key, error.value) from error.__cause__
    found = [json.loads(record) for record in records]
    record = found[best]
    for model in found:
        if not model["converged"]:
            of = f" of model {model['name']}" if "name" in model else ""
            warnings.warn(f"the search{of} has not converged: {model['end']}", stacklevel=2)
    fitted = [json.loads(entry) for entry in scenarios]
    if isinstance(scenario, Mapping) and isinstance(given, tuple) and given[3]:
        # There arrays are replaced by names of files: the original dictionary receives the estimates.
        changes = by_path(overrides, changed)
        fitted = [_with_estimates(scenario, changes, plan, record, index, told) for index, told in enumerate(fitted)]
    return Fit(
        parameters={path: _estimate(entry) for path, entry in record["parameters"].items()},
        correlation=np.array(record["correlation"], dtype=np.float64),
        chi2=record["chi2"],
        degrees_of_freedom=record["degrees_of_freedom"],
        reduced_chi2=record["reduced_chi2"],
        aic=_number(record["aic"]),
        bic=_number(record["bic"]),
        converged=record["converged"],
        undetermined=tuple(record["undetermined"]),
        notes=tuple(of_arrays(note, files) for note in record["notes"]),
        name=record.get("name"),
        models={model["name"]: model for model in found if "name" in model},
        scenario=fitted[0],
        scenarios=tuple(fitted[1:]),
        tables=tuple(_told(table, entry, appearance_of(given)[1]) for table, entry in zip(tables, record["tables"])),
        record=record,
        _report=report,
    )


def _number(value: float | None) -> float:
    # JSON has no infinite numbers; only a perfect fit has an infinite AIC.
    return -np.inf if value is None else value


def _free(place: str, given: Free) -> list[dict[str, Any]]:
    if isinstance(given, (str, bytes)) or not isinstance(given, (Mapping, Sequence)):
        raise InputError(f"{place}: a dictionary or a list of paths is needed", place, repr(given))
    entries = given.items() if isinstance(given, Mapping) else [(entry, None) for entry in given]
    tables = []
    for path, known in entries:
        if isinstance(path, Mapping):
            tables.append(dict(path))
        elif known is None:
            tables.append({"path": path})
        elif isinstance(known, Mapping):
            tables.append({"path": path, **known})
        else:
            tables.append({"path": path, "start": _arrays.real(f"{place}[{path!r}]", known)})
    return tables


def _model(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    place = f"models[{name!r}]"
    if not isinstance(given, Mapping):
        raise InputError(f"{place}: a dictionary is needed", place, repr(given))
    model = {"name": name, **given}
    if isinstance(model.get("scenario"), Mapping):
        raise InputError(f"{place}.scenario: a path is needed; `set` changes a dictionary", f"{place}.scenario", "a dictionary")
    if "free" in model:
        model["free"] = _free(f"{place}.free", model["free"])
    return model


def _table(index: int, given: Mapping[str, Any], files: dict[str, bytes]) -> dict[str, Any]:
    place = f"data[{index}]"
    if _is_frame(given):
        given = {"frame": given}
    if not isinstance(given, Mapping):
        raise InputError(f"{place}: a dictionary or a table of pandas is needed", place, repr(given))
    keys = {key: given[key] for key in _fvi.DATA_KEYS if given.get(key) is not None}
    columns: dict[str, Any] = {key: value for key, value in given.items() if key not in _fvi.DATA_KEYS}
    if "file" in keys:
        if columns:
            message = f"{place}.file: cannot stand beside columns; here there are {', '.join(columns)}"
            raise InputError(message, f"{place}.file", str(keys["file"]))
        return {**keys, "file": str(Path(keys["file"]).absolute())}
    headers: dict[str, str] = {}
    if "frame" in columns:
        columns = {**_frame(place, columns.pop("frame"), keys.get("columns"), headers), **columns}
    elif isinstance(keys.get("columns"), Mapping):
        columns = _named(place, columns, keys["columns"])
    keys.pop("columns", None)
    if "value" in columns:
        value = np.asarray(columns.pop("value"))
        columns.update(re=value.real, im=value.imag)
    deviation = keys.get("deviation")
    if isinstance(deviation, Mapping):
        if any(np.ndim(entry) for entry in deviation.values()):
            del keys["deviation"]
            sizes = {name: np.size(columns[name]) for name in deviation if name in columns}
            for name, entry in deviation.items():
                columns[f"{name}_deviation"] = entry if np.ndim(entry) else np.full(sizes.get(name, 1), entry)
    elif deviation is not None and np.ndim(deviation) > 0:
        columns["deviation"] = keys.pop("deviation")
    order: list[str] = [name for name in ("t", "omega", "f") if name in columns]
    if len(order) != 1:
        message = f"{place}: one of t, omega and f is needed; here there are {', '.join(map(str, columns)) or 'no columns'}"
        raise InputError(message, place)
    order += [name for name in columns if name not in order]
    arrays = [np.atleast_1d(_arrays.numbers(f"{place}.{name}", columns[name], missing=True)) for name in order]
    for name, array in zip(order, arrays):
        if array.shape != arrays[0].shape or array.ndim != 1:
            message = f"{place}.{name}: {array.shape} instead of {arrays[0].shape}, the shape of {order[0]}"
            raise InputError(message, f"{place}.{name}", str(array.shape))
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow([headers.get(name, name) for name in order])
    table.writerows(map(repr, row) for row in zip(*(array.tolist() for array in arrays)))
    keys["file"] = f"{place}.csv"
    files[keys["file"]] = text.getvalue().encode()
    return keys


def of_arrays(text: str, files: Mapping[str, bytes]) -> str:
    """A message about a file that arrays have become: by the place of the arrays and their rows, from 0."""

    def rows(lines: re.Match[str]) -> str:
        return f"row{lines[1]} " + re.sub("[0-9]+", lambda line: str(int(line[0]) - 2), lines[2])

    for file in files:
        place = re.escape(file.removesuffix(".csv"))
        changed = re.sub(rf'({place})\.file = "{place}\.csv": (?:\./)?{place}\.csv', r"\1", text)
        changed = re.sub(rf"(?:\./)?({place})\.csv", r"\1", changed)
        if changed != text:
            text = re.sub(r"\bline(s?) ([0-9]+(?:, [0-9]+)*)", rows, changed.replace(", line 1:", ":"))
    return text


def _is_frame(given: Any) -> bool:
    """Whether an object is a table of pandas or of a library like it."""
    return all(hasattr(given, name) for name in ("columns", "to_numpy", "__getitem__")) and not isinstance(given, Mapping)


_UNIT = re.compile(r"\s*[\[(][^\[\]()]*[\])]$|\s*/\s*[^/]+$|\s+in\s+\S+$")
"""A unit behind the name of a column: in brackets, behind a stroke or "in"."""


def _frame(place: str, frame: Any, named: Any, headers: dict[str, str]) -> dict[str, Any]:
    """The columns of a table of pandas; its index is one of them where it has a name. Names with the units behind them are added to
    `headers`: they are read as those of a file are."""
    if not _is_frame(frame):
        raise InputError(f"{place}.frame: a table of pandas is needed", f"{place}.frame", repr(frame)[:60])
    if any(name is not None for name in getattr(getattr(frame, "index", None), "names", ())):
        frame = frame.reset_index()
    columns = {name: frame[name] for name in frame.columns}
    if len(columns) != len(frame.columns):
        raise InputError(f"{place}.frame: two columns have one name", f"{place}.frame", str(list(frame.columns))[:60])
    # By the names without units, unless two columns would have one.
    parts = {name: _UNIT.search(name) for name in columns if isinstance(name, str)}
    short = {name: name[: unit.start()] if unit else name for name, unit in parts.items()}
    if len(set(short.values())) < len(short):
        short = {name: name for name in short}
    full = {own: name for name, own in short.items()}
    if isinstance(named, Mapping):
        named = {own: name if name in columns else full.get(name, name) for own, name in named.items()}
        columns = _named(place, columns, named)
    else:
        named = {short.get(name, name): name for name in columns}
        columns = {own: columns[name] for own, name in named.items()}
    headers.update((own, own + unit[0]) for own, name in named.items() if (unit := parts.get(name)))
    return {name: np.asarray(column) for name, column in columns.items()}


def _named(place: str, columns: Mapping[Any, Any], named: Mapping[str, Any]) -> dict[str, Any]:
    """The columns under the names by which a fit knows them."""
    for name in named.values():
        if name not in columns:
            message = f"{place}.columns: there is no column {name!r}; there are {', '.join(map(repr, columns))}"
            raise InputError(message, f"{place}.columns", repr(name))
    return {own: columns[name] for own, name in named.items()}


def _estimate(entry: dict[str, Any]) -> Estimate:
    profile = entry.get("profile")
    interval = entry["interval"]
    return Estimate(
        start=entry["start"],
        estimate=entry["estimate"],
        standard_error=entry["standard_error"],
        interval=None if interval is None else (interval[0], interval[1]),
        at_bound=entry.get("at_bound"),
        derivative=entry["derivative"],
        profile_interval=None if profile is None else (profile["interval"][0], profile["interval"][1]),
        profile=None if profile is None else np.array(profile["points"], dtype=np.float64).reshape(-1, 2),
    )


def _told(
    table: tuple[FloatArray, str, list[tuple[FloatArray, FloatArray, FloatArray]]], entry: dict[str, Any], units: dict[str, str]
) -> FitTable:
    places, over, columns = table
    names = entry["columns"]
    data, model, deviation = ({name: column[which] for name, column in zip(names, columns)} for which in range(3))
    return FitTable(over, places, data, model, deviation, entry.get("temperature"), entry.get("log10_shift"), units)


def _with_estimates(
    scenario: Mapping[str, Any],
    changes: Mapping[str, Any],
    plan: dict[str, Any],
    record: dict[str, Any],
    index: int,
    fitted: dict[str, Any],
) -> dict[str, Any]:
    """The given dictionary with the estimates as values; for an index from 1 on, that for a table of data."""
    values = copy.deepcopy(dict(scenario))
    for path, value in changes.items():
        if value is not None:
            put(values, path, value)
    for model in plan.get("model", []):
        if model["name"] == record.get("name"):
            for path, value in model.get("set", {}).items():
                put(values, path, value)
    if index > 0:
        for path, value in plan["data"][index - 1].get("set", {}).items():
            put(values, path, value)
    free = [*plan["free"], *(entry for model in plan.get("model", []) for entry in model.get("free", []))]
    for entry in free:
        if "terms" in entry and (found := re.fullmatch(r"system\.damping\[(\d+)\]\.kernel", entry["path"])):
            put(values, entry["path"], fitted["system"]["damping"][int(found[1])]["kernel"])
    for key, entry in record["parameters"].items():
        own, _, path = key.rpartition("]: ")
        if path.startswith("shift."):
            continue
        if not own or own == f"data[{index - 1}":
            put(values, path, entry["estimate"])
    return values
