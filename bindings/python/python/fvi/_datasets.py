"""Names and units of what results hold, for tables of pandas and datasets of xarray."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def _module(name: str, what: str) -> Any:
    """Imports a library that only this call needs."""
    import importlib

    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and error.name.split(".")[0] == name.split(".")[0]:
            raise ModuleNotFoundError(f"{what} needs the package {name.split('.')[0]}", name=error.name) from None
        raise


KNOWN = {
    "t": ("time", "time"),
    "q": ("position", "position"),
    "x": ("unknown", "position"),
    "p": ("momentum", "momentum"),
    "energy": ("energy", "energy"),
    "dq": ("derivative of the position", ""),
    "dp": ("derivative of the momentum", ""),
    "coordinate": ("number of the coordinate", ""),
    "label": ("name of the coordinate", ""),
    "u": ("output of the controller", ""),
    "setpoint": ("setpoint of the controller", ""),
    "measure": ("measured value of the controller", ""),
    "lambda": ("multiplier of the constraint", ""),
    "memory_stored": ("energy stored in the memories", "energy"),
    "memory_dissipated": ("energy dissipated by the memories", "energy"),
    "omega": ("angular frequency", ""),
    "omega_between": ("angular frequency", ""),
    "response": ("receptance", ""),
    "between": ("receptance", ""),
    "discrete": ("receptance of the discrete scheme", ""),
    "pole": ("pole s", ""),
    "mode": ("damped motion s", ""),
    "shape": ("shape of the damped motion", ""),
    "moduli": ("K(iω) of the kernel", ""),
    "plant": ("frequency response of the plant", ""),
    "loop": ("frequency response of the loop", ""),
    "sampled_loop": ("frequency response of the sampled loop", ""),
    "step": ("measured value after a step of the setpoint", ""),
    "control": ("output after a step of the setpoint", ""),
    "load": ("measured value after a step of the load", ""),
}
"""For each name what it is, and the unit of a scenario that it has."""


def attributes(name: str, units: Mapping[str, str]) -> dict[str, str]:
    """`long_name` of a variable, and its `units` where the scenario names them."""
    described, of = KNOWN.get(name, (name.replace("_", " "), ""))
    unit = units.get(of, "")
    if name.startswith("omega") and units.get("time"):
        unit = f"rad/{units['time']}"
    elif name in ("pole", "mode") and units.get("time"):
        unit = f"1/{units['time']}"
    return {"long_name": described, **({"units": unit} if unit else {})}


def members_of(name: str) -> str:
    """The dimension of the members of a column that has several."""
    return "constraint" if name == "lambda" else "controller"


def dataset(
    variables: Mapping[str, tuple[Any, Any]],
    coordinates: Mapping[str, tuple[Any, Any]],
    units: Mapping[str, str],
    more: Mapping[str, Any] | None = None,
) -> Any:
    """A Dataset of variables and coordinates, each with its dimensions, names and units; `more` are its attributes."""

    def described(entries: Mapping[str, tuple[Any, Any]]) -> dict[str, Any]:
        return {name: (along, values, attributes(name, units)) for name, (along, values) in entries.items()}

    xarray = _module("xarray", "to_xarray()")
    return xarray.Dataset(described(variables), coords=described(coordinates), attrs=dict(more or {}))


def appearance_of(source: Any) -> tuple[list[str], dict[str, str]]:
    """The labels and units of a scenario, from the source for the compiled part."""
    if isinstance(source, Path):
        keys: Any = tomllib.loads(source.read_text(encoding="utf-8"))
    else:
        keys = source[2]
    output = keys.get("output", {})
    return list(output.get("labels", ())), dict(output.get("units", {}))
