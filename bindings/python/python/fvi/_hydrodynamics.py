"""Hydrodynamics of floating bodies from the files of boundary-element codes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np

from fvi._datasets import _module
from fvi._errors import InputError, suggesting
from fvi._kernel import Kernel
from fvi._types import FloatArray, RadiationKeys


@dataclass(frozen=True, eq=False)
class Hydrodynamics:
    """Added mass and radiation damping over frequency, in SI units.

    Attributes
    ----------
    omega : array
        n angular frequencies in rad/s, ascending.
    added_mass, damping : array
        A and B, shape (n, N, N): the force on the first index by a motion of the second.
    infinite : array or None
        A(∞), shape (N, N), if the file has it.
    dofs : list of str
        The names of the N degrees of freedom.
    left_out : int
        Number of frequencies that were left out, since a number of their matrices is not finite.
    """

    omega: FloatArray
    added_mass: FloatArray
    damping: FloatArray
    infinite: FloatArray | None
    dofs: list[str]
    left_out: int = 0

    def kernel(self, dofs: Sequence[str | int] | None = None, **keys: Unpack[RadiationKeys]) -> Kernel:
        """The kernel of these degrees of freedom, all unless given.

        Parameters
        ----------
        dofs : sequence of str or int, optional
            Names, or numbers from 0.
        **keys
            As for `Kernel.radiation`; `infinite` is that of the file, if it has one.

        Returns
        -------
        Kernel
        """
        chosen = list(range(len(self.dofs))) if dofs is None else [self._number(dof) for dof in dofs]
        if not chosen or len(set(chosen)) < len(chosen):
            raise InputError(f"dofs = {dofs!r}: one at least is needed, and none twice", "dofs", repr(dofs))
        rows = np.ix_(range(len(self.omega)), chosen, chosen)
        if self.infinite is not None:
            keys.setdefault("infinite", self.infinite[np.ix_(chosen, chosen)])
        return Kernel.radiation(self.omega, self.added_mass[rows], self.damping[rows], **keys)

    def _number(self, dof: str | int) -> int:
        if isinstance(dof, str) and dof in self.dofs:
            return self.dofs.index(dof)
        if isinstance(dof, int | np.integer) and not isinstance(dof, bool) and 0 <= dof < len(self.dofs):
            return int(dof)
        raise InputError(f"dofs: {dof!r} is none of {self.dofs}, nor one of their numbers from 0", "dofs", repr(dof))

    def __repr__(self) -> str:
        return f"Hydrodynamics({len(self.omega)} frequencies, {len(self.dofs)} degrees of freedom)"


@suggesting
def read_capytaine(source: str | os.PathLike[str] | Any) -> Hydrodynamics:
    """A and B of a NetCDF file of Capytaine, or of its xarray Dataset.

    The variables `added_mass` and `radiation_damping` are read, over the dimensions `influenced_dof`, `radiating_dof` and that of
    `omega`; other dimensions must have one entry. The row of ω = ∞ is A(∞).

    Parameters
    ----------
    source : path or xarray.Dataset
        Paths need the package ``xarray`` with one that reads NetCDF, such as ``h5netcdf``.

    Returns
    -------
    Hydrodynamics

    Raises
    ------
    InputError
        If the file is not readable as NetCDF, or its content is of another kind; the error names the variable.
    """
    if isinstance(source, str | os.PathLike):
        name = os.fspath(source)
        xarray = _module("xarray", "read_capytaine()")
        try:
            with xarray.open_dataset(name) as opened:
                return _of_dataset(opened.load(), name)
        except FileNotFoundError:
            raise
        except (ValueError, OSError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"source: {name} is not read as NetCDF: {error}", "source", name) from error
    return _of_dataset(source, "source")


def _of_dataset(source: Any, name: str) -> Hydrodynamics:
    def variable(key: str) -> Any:
        if key not in source:
            known = ", ".join(sorted(map(str, source.variables)))
            raise InputError(f"{name}: there is no `{key}`; allowed: a dataset of Capytaine; this one has {known}", "source", key)
        return source[key]

    frequencies = variable("omega")
    unit = str(frequencies.attrs.get("units", "rad/s"))
    if unit not in ("rad/s", "rad s-1", "1/s", "s-1"):
        raise InputError(f"{name}: `omega` is in {unit}; allowed: rad/s", "source", unit)
    if frequencies.ndim != 1:
        reason = f"{name}: `omega` has the dimensions {list(frequencies.dims)}; allowed: one, over several frequencies"
        raise InputError(reason, "source", "omega")
    wanted = (frequencies.dims[0], "influenced_dof", "radiating_dof")

    def read(key: str) -> FloatArray:
        found = variable(key)
        missing = [dimension for dimension in wanted if dimension not in found.dims]
        if missing:
            raise InputError(f"{name}: `{key}` has no dimension {missing}, but {list(found.dims)}", "source", str(missing))
        others = [dimension for dimension in found.dims if dimension not in wanted]
        for dimension in others:
            if found.sizes[dimension] != 1:
                reason = f"{name}: `{key}` has {found.sizes[dimension]} entries along `{dimension}`; allowed: one, choose it by `isel`"
                raise InputError(reason, "source", str(dimension))
        if found.dtype.kind not in "fiu":
            raise InputError(f"{name}: `{key}` has values of type {found.dtype}; allowed: real numbers", "source", str(found.dtype))
        return np.asarray(found.squeeze(others).transpose(*wanted), dtype=float)

    def names(key: str) -> list[str]:
        return [dof.decode() if isinstance(dof, bytes) else str(dof) for dof in np.asarray(variable(key)).tolist()]

    added, damping = read("added_mass"), read("radiation_damping")
    dofs, radiating = names("influenced_dof"), names("radiating_dof")
    if sorted(dofs) != sorted(radiating) or len(set(dofs)) < len(dofs):
        reason = f"{name}: `radiating_dof` has {radiating}; allowed: each of `influenced_dof` once, {dofs}"
        raise InputError(reason, "source", repr(radiating))
    order = [radiating.index(dof) for dof in dofs]
    omega = np.asarray(frequencies, dtype=float)
    return _sorted(name, omega, added[:, :, order], damping[:, :, order], None, dofs)


@suggesting
def read_bemio(path: str | os.PathLike[str], bodies: Sequence[int] | None = None) -> Hydrodynamics:
    """A and B of an HDF5 file that BEMIO, of WEC-Sim, has written, whose A is divided by ρ and whose B is divided by ρω.

    Parameters
    ----------
    path : path
        Needs the package ``h5py``.
    bodies : sequence of int, optional
        Numbers of the bodies, from 1; default: all. The degrees of freedom are ``"body1 surge"`` … ``"body1 yaw"``, and so on.

    Returns
    -------
    Hydrodynamics

    Raises
    ------
    InputError
        If the file is not HDF5, or its content is of another kind: scaled already, or with further modes of bodies.
    """
    h5py, name = _module("h5py", "read_bemio()"), os.fspath(path)
    try:
        file = h5py.File(name, "r")
    except FileNotFoundError:
        raise
    except OSError as error:
        raise InputError(f"path: {name} is not read as HDF5: {error}", "path", name) from error
    with file:

        def read(key: str) -> FloatArray:
            if not isinstance(file.get(key), h5py.Dataset):
                raise InputError(f"path: {name} has no `{key}`; allowed: a file of BEMIO", "path", key)
            if file[key].dtype.kind not in "fiu":
                raise InputError(f"path: {name}: `{key}` has values of type {file[key].dtype}, not numbers", "path", key)
            return np.asarray(file[key], dtype=float)

        if "simulation_parameters/scaled" in file and (read("simulation_parameters/scaled") != 0).any():
            reason = f"path: {name}: `simulation_parameters/scaled` is not 0; allowed: A divided by ρ and B by ρω, as BEMIO writes it"
            raise InputError(reason, "path", "simulation_parameters/scaled")
        omega, density = read("simulation_parameters/w").ravel(), read("simulation_parameters/rho").ravel()
        if density.shape != (1,) or not (np.isfinite(density).all() and density[0] > 0):
            reason = f"path: {name}: `simulation_parameters/rho` = {density.tolist()}; allowed: one positive number"
            raise InputError(reason, "path", str(density))
        rho, count = float(density[0]), 0
        while f"body{count + 1}" in file:
            count += 1
        chosen = list(range(1, count + 1)) if bodies is None else list(bodies)
        if not chosen or len(set(chosen)) < len(chosen) or any(body not in range(1, count + 1) for body in chosen):
            raise InputError(f"bodies = {bodies!r}; allowed: numbers from 1 to {count}, each once", "bodies", repr(bodies))
        columns = [6 * (body - 1) + dof for body in chosen for dof in range(6)]

        def matrices(key: str, dimensions: int) -> FloatArray:
            parts = []
            for body in chosen:
                place = f"body{body}/hydro_coeffs/{key}"
                part, shape = read(place), (6, 6 * count, len(omega))[:dimensions]
                if part.shape != shape:
                    reason = f"path: {name}: `{place}` has the shape {part.shape}; allowed: {shape}, six for each body, and `w`"
                    raise InputError(reason, "path", place)
                parts.append(part[:, columns])
            return np.concatenate(parts)

        with np.errstate(invalid="ignore", over="ignore"):
            added = rho * matrices("added_mass/all", 3).transpose(2, 0, 1)
            damping = rho * omega[:, None, None] * matrices("radiation_damping/all", 3).transpose(2, 0, 1)
        has_infinite = all(f"body{body}/hydro_coeffs/added_mass/inf_freq" in file for body in chosen)
        infinite = rho * matrices("added_mass/inf_freq", 2) if has_infinite else None
        if infinite is not None and not np.isfinite(infinite).all():
            infinite = None
    names = ("surge", "sway", "heave", "roll", "pitch", "yaw")
    dofs = [f"body{body} {dof}" for body in chosen for dof in names]
    return _sorted(name, omega, added, damping, infinite, dofs)


def _sorted(
    name: str, omega: FloatArray, added: FloatArray, damping: FloatArray, infinite: FloatArray | None, dofs: list[str]
) -> Hydrodynamics:
    """Rows with ascending ω; that of ω = ∞ is A(∞), and those that are not finite are left out."""
    if np.isnan(omega).any() or (omega < 0).any():
        wrong = omega[np.isnan(omega) | (omega < 0)][0]
        raise InputError(f"{name}: a frequency is {wrong}; allowed: numbers from 0, in rad/s", "omega", str(wrong))
    at_infinity = np.isposinf(omega)
    if at_infinity.any() and np.isfinite(added[at_infinity][0]).all():
        infinite = added[at_infinity][0]
    kept = ~at_infinity & np.isfinite(added).all(axis=(1, 2)) & np.isfinite(damping).all(axis=(1, 2))
    if not kept.any():
        raise InputError(f"{name}: no frequency has finite numbers only", "omega", repr(omega.tolist()[:5]))
    order = np.flatnonzero(kept)[np.argsort(omega[kept], kind="stable")]
    left_out = int((~kept & ~at_infinity).sum())
    return Hydrodynamics(omega[order], added[order], damping[order], infinite, dofs, left_out)
