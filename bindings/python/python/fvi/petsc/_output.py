"""The files of a run: rows, snapshots, and files for ParaView."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike
from petsc4py import PETSc

from fvi import _arrays
from fvi._errors import InputError
from fvi._types import FloatArray
from fvi.petsc._arguments import Layout

CELLS = {"segment": 2, "triangle": 3, "quadrilateral": 4, "tetrahedron": 4, "wedge": 6, "hexahedron": 8}
"""Kinds of cells, with their corners in the order of XDMF and VTK."""

FORMATS = ("npz", "petsc")


@dataclass(frozen=True, eq=False)
class Mesh:
    """The part of a mesh on a rank; with it snapshots are also written for ParaView.

    Parameters
    ----------
    points : array_like, shape (P, 3)
        The points of this rank's cells.
    cells : array_like of int, shape (C, corners)
        For each cell the points at its corners, counted from 0 on this rank, in VTK order.
    kind : {"segment", "triangle", "quadrilateral", "tetrahedron", "wedge", "hexahedron"}
        Type of the cells.
    rows : array_like of int, shape (P, 3)
        For each point the coordinates (rows of the matrices, counted over all ranks) that are its displacement; −1 where it is
        fixed. They may belong to other ranks.
    """

    points: ArrayLike
    cells: ArrayLike
    kind: str
    rows: ArrayLike


@dataclass(frozen=True, eq=False)
class Output:
    """The output directory of a run, and the files written.

    Parameters
    ----------
    directory : path
        A directory that all ranks can access: ``trajectory.npz``, ``summary.json``, ``checkpoint/`` and ``snapshots/``.
    snapshots : int, optional
        Number of steps between two snapshots of the whole state, the first at the start; default: none.
    format : {"npz", "petsc"}
        A NumPy file for each rank with the arrays t, first (its first row), q and p; or one PETSc binary file for all ranks
        with the vectors q and p.
    mesh : Mesh, optional
        Writes ``snapshots.xdmf`` and HDF5 files beside the snapshots. Needs h5py.
    """

    directory: str | os.PathLike[str]
    snapshots: int | None = None
    format: str = "npz"
    mesh: Mesh | None = None


def new_file(path: Path) -> BinaryIO:
    """A new file in place of whatever file or link has the name, for writing."""
    path.unlink(missing_ok=True)
    return open(path, "xb")


def whole_file(path: Path, write: Callable[[Any], object]) -> int:
    """Writes a file atomically: under a temporary name, flushed to the disk, then renamed. Returns its size."""
    beside = path.with_name(path.name + ".part")
    with new_file(beside) as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())
        size = file.seek(0, os.SEEK_END)
    os.replace(beside, path)
    return size


def flush_directory(path: Path) -> None:
    """Flushes the renames in a directory to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


class Directory:
    """The directory of a run, locked by rank 0 against other runs while its process lives."""

    def __init__(self, path: str | os.PathLike[str], rank: int) -> None:
        self.path = Path(path)
        if rank > 0:
            return
        self.path.mkdir(parents=True, exist_ok=True)
        lock = self.path / ".lock"
        if lock.is_symlink():
            lock.unlink()
        self.lock = open(lock, "ab")
        try:
            fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self.lock.close()
            raise InputError(f"output: another run is writing to {self.path}", "output", str(self.path)) from None

    def close(self) -> None:
        if hasattr(self, "lock"):
            self.lock.close()


class Rows:
    """Time, chosen positions and momenta, and energy of the rows so far; on rank 0, in memory and in a file that grows."""

    def __init__(self, chosen: Any, layout: Layout, directory: Directory | None) -> None:
        self.chosen, self.layout = chosen, layout
        here = (chosen >= layout.first) & (chosen < layout.end)
        self.places, self.local = np.flatnonzero(here), chosen[here] - layout.first
        self.width = 2 * len(chosen) + 2
        self.rows: list[FloatArray] = []
        self.path = None if directory is None else directory.path / "checkpoint" / "rows.f64"
        self.file: Any = None

    def begin(self, count: int) -> None:
        """Keeps the first rows of a resumed run, none of a new one. On rank 0 only."""
        if self.path is None:
            return
        if count == 0 or self.path.is_symlink():
            self.path.unlink(missing_ok=True)
        self.file = open(self.path, "r+b" if self.path.exists() else "x+b")
        content = self.file.read(8 * self.width * count)
        if len(content) < 8 * self.width * count:
            raise InputError(f"output: {self.path} holds fewer rows than the checkpoint counts", "output", str(self.path))
        self.rows = list(np.frombuffer(content, dtype="<f8").reshape(count, self.width).copy())
        self.file.truncate(8 * self.width * count)
        self.file.seek(0, os.SEEK_END)

    def add(self, time: float, position: Any, momentum: Any, energy: float) -> BaseException | None:
        """Appends a row; collective. Returns an error of this rank, if any."""
        together, count = self.layout.together, len(self.chosen)
        row = np.zeros(self.width)
        for begin, vector in ((1, position), (1 + count, momentum)):
            row[begin + self.places] = vector.getArray(readonly=True)[self.local]
        if together.size > 1:
            gathered = np.empty_like(row)
            together.comm.Reduce(row, gathered)
            row = gathered
        if together.rank > 0:
            return None
        row[0], row[-1] = time, energy
        self.rows.append(row)
        if self.file is None:
            return None
        try:
            self.file.write(row.astype("<f8").tobytes())
        except OSError as error:
            return error
        return None

    def flush(self) -> None:
        if self.file is not None:
            self.file.flush()
            os.fsync(self.file.fileno())

    def table(self) -> FloatArray:
        return np.array(self.rows).reshape(len(self.rows), self.width)

    def finish(self, table: FloatArray) -> None:
        """Writes ``trajectory.npz`` from the growing file of rows. On rank 0 only."""
        if self.path is None:
            return
        count = len(self.chosen)
        arrays: dict[str, Any] = {"t": table[:, 0], "q": table[:, 1 : 1 + count], "p": table[:, 1 + count : -1], "energy": table[:, -1]}
        whole_file(self.path.parent.with_name("trajectory.npz"), lambda file: np.savez(file, **arrays))

    def close(self) -> None:
        if self.file is not None:
            self.file.close()


class Snapshots:
    """Snapshots of the whole state."""

    def __init__(self, output: Output, directory: Directory, layout: Layout, like: Any) -> None:
        self.every = _arrays.whole("output.snapshots", output.snapshots, 1)
        if output.format not in FORMATS:
            names = ", ".join(f'"{name}"' for name in FORMATS)
            message = f"output.format = {output.format!r}: not allowed; allowed: {names}"
            raise InputError(message, "output.format", repr(output.format))
        self.binary = output.format == "petsc"
        self.layout, self.place = layout, directory.path / "snapshots"
        together = layout.together
        self.name = f"rank-{together.rank:05d}-of-{together.size:05d}"
        self.mesh = None if output.mesh is None else _Shown(output.mesh, layout)
        self.like = like

    def begin(self, step: int | None) -> None:
        """Removes snapshots of steps that are still to be made; for a new run all of them. On rank 0 only."""
        self.place.mkdir(exist_ok=True)
        for path in self.place.iterdir():
            number = path.name.partition(".")[0]
            if step is None or number.isdigit() and int(number) > step or path.name.endswith(".part"):
                path.unlink()

    def prepare(self) -> None:
        """Finds the ranks and rows of the displacements of the mesh, and writes the mesh; collective."""
        error = None
        if self.mesh is not None:
            self.mesh.connect(self.like)
            try:
                self.mesh.write(self.place / f"mesh.{self.name}.h5")
            except Exception as raised:
                error = raised
        self.layout.together.agree(error)

    def add(self, step: int, time: float, position: Any, momentum: Any) -> BaseException | None:
        """Writes a snapshot; collective. Returns an error of this rank, if any."""
        stem, error = f"{step:012d}", None
        if self.binary:
            viewer = PETSc.Viewer().createBinary(str(self.place / f"{stem}.part"), "w", comm=position.getComm())
            position.view(viewer)
            momentum.view(viewer)
            viewer.destroy()
            if self.layout.together.rank == 0:
                # The file that PETSc writes beside it contains options for its own reader only.
                (self.place / f"{stem}.part.info").unlink(missing_ok=True)
                os.replace(self.place / f"{stem}.part", self.place / f"{stem}.petsc")
        shown = None if self.mesh is None else self.mesh.gather(position)
        try:
            if not self.binary:
                arrays = {
                    "t": np.float64(time),
                    "first": np.int64(self.layout.first),
                    "q": position.getArray(readonly=True),
                    "p": momentum.getArray(readonly=True),
                }
                whole_file(self.place / f"{stem}.{self.name}.npz", lambda file: np.savez(file, **arrays))
            if self.mesh is not None and shown is not None:
                self.mesh.write_displacement(self.place / f"{stem}.{self.name}.h5", shown, time)
        except Exception as raised:
            error = raised
        return error

    def finish(self) -> None:
        """Writes the file that ParaView opens. On rank 0 only."""
        if self.mesh is not None:
            whole_file(self.place.with_name("snapshots.xdmf"), lambda file: file.write(_xdmf(self.place).encode()))


class _Shown:
    """A mesh, with the origin of the displacements of its points."""

    def __init__(self, mesh: Mesh, layout: Layout) -> None:
        try:
            import h5py
        except ModuleNotFoundError:
            message = "output.mesh needs the package h5py (Debian: python3-h5py)"
            raise ModuleNotFoundError(message, name="h5py") from None
        self.h5py = h5py
        if mesh.kind not in CELLS:
            names = ", ".join(f'"{kind}"' for kind in CELLS)
            message = f"output.mesh.kind = {mesh.kind!r}: not allowed; allowed: {names}"
            raise InputError(message, "output.mesh.kind", repr(mesh.kind))
        self.kind = mesh.kind
        self.points = _arrays.numbers("output.mesh.points", mesh.points)
        if self.points.size == 0:
            self.points = np.empty((0, 3))
        if self.points.ndim != 2 or self.points.shape[1] != 3:
            message = f"output.mesh.points: shape {self.points.shape} instead of three numbers for each point"
            raise InputError(message, "output.mesh.points", str(self.points.shape))
        count = len(self.points)
        self.cells = _indices("output.mesh.cells", mesh.cells, CELLS[mesh.kind], 0, count)
        self.rows = _indices("output.mesh.rows", mesh.rows, 3, -1, layout.size)
        if len(self.rows) != count:
            message = f"output.mesh.rows: {len(self.rows)} rows instead of {count}, one for each point"
            raise InputError(message, "output.mesh.rows", str(len(self.rows)))

    def connect(self, like: Any) -> None:
        self.moves = self.rows >= 0
        wanted = PETSc.IS().createGeneral(self.rows[self.moves].astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        self.found = PETSc.Vec().createSeq(int(self.moves.sum()), comm=PETSc.COMM_SELF)
        self.scatter = PETSc.Scatter().create(like, wanted, self.found, None)

    def gather(self, position: Any) -> FloatArray:
        self.scatter.scatter(position, self.found, addv=PETSc.InsertMode.INSERT_VALUES, mode=PETSc.ScatterMode.FORWARD)
        shown = np.zeros(self.rows.shape)
        shown[self.moves] = self.found.getArray(readonly=True)
        return shown

    def write(self, path: Path) -> None:
        self._write(path, {"points": self.points, "cells": self.cells}, kind=self.kind)

    def write_displacement(self, path: Path, shown: FloatArray, time: float) -> None:
        self._write(path, {"displacement": shown}, time=time)

    def _write(self, path: Path, arrays: dict[str, Any], **attributes: Any) -> None:
        def write(file: Any) -> None:
            with self.h5py.File(file, "w") as content:
                content.attrs.update(attributes)
                for name, array in arrays.items():
                    content[name] = array

        whole_file(path, write)


def _indices(name: str, given: Any, width: int, least: int, end: int) -> Any:
    array = np.asarray(given)
    if array.size == 0:
        return np.empty((0, width), dtype=np.int64)
    if array.dtype.kind not in "iu" or array.ndim != 2 or array.shape[1] != width:
        message = f"{name}: shape {array.shape} of {array.dtype}; whole numbers in {width} columns are needed"
        raise InputError(message, name, str(array.shape))
    if array.min() < least or array.max() >= end:
        value = str(array.min() if array.min() < least else array.max())
        raise InputError(f"{name} = {value}: not allowed; allowed: from {least} to {end - 1}", name, value)
    return array.astype(np.int64)


def _xdmf(place: Path) -> str:
    """The index of all displacements in a directory, with the mesh of the ranks that wrote them."""
    import h5py

    steps: dict[str, list[Path]] = {}
    for path in sorted(place.glob("[0-9]*.rank-*.h5")):
        steps.setdefault(path.name.partition(".")[0], []).append(path)
    lines = ['<?xml version="1.0"?>', '<Xdmf Version="3.0"><Domain><Grid Name="motion" GridType="Collection" CollectionType="Temporal">']
    for stem, paths in steps.items():
        lines.append(f'<Grid Name="{stem}" GridType="Collection" CollectionType="Spatial">')
        for index, path in enumerate(paths):
            mesh = "mesh" + path.name[len(stem) :]
            with h5py.File(place / mesh, "r") as content:
                kind = content.attrs["kind"]
                points, cells = content["points"].shape, content["cells"].shape
            if index == 0:
                with h5py.File(path, "r") as content:
                    lines.append(f'<Time Value="{float(content.attrs["time"])!r}"/>')
            if cells[0] == 0:
                continue

            def item(file: str, name: str, shape: tuple[int, ...], number: str) -> str:
                dimensions = " ".join(map(str, shape))
                return (
                    f'<DataItem Format="HDF" NumberType="{number}" Precision="8" Dimensions="{dimensions}">'
                    f"snapshots/{file}:/{name}</DataItem>"
                )

            lines += [
                f'<Grid Name={quoteattr(path.stem)} GridType="Uniform">',
                f'<Topology TopologyType="{_TOPOLOGY[kind]}" NumberOfElements="{cells[0]}">{item(mesh, "cells", cells, "Int")}</Topology>',
                f'<Geometry GeometryType="XYZ">{item(mesh, "points", points, "Float")}</Geometry>',
                f'<Attribute Name="displacement" AttributeType="Vector" Center="Node">'
                f"{item(path.name, 'displacement', points, 'Float')}</Attribute>",
                "</Grid>",
            ]
        lines.append("</Grid>")
    lines.append("</Grid></Domain></Xdmf>")
    return "\n".join(lines) + "\n"


# For each type of cell its name in XDMF, and further attributes of the topology element.
_TOPOLOGY = {
    "segment": 'Polyline" NodesPerElement="2',
    "triangle": "Triangle",
    "quadrilateral": "Quadrilateral",
    "tetrahedron": "Tetrahedron",
    "wedge": "Wedge",
    "hexahedron": "Hexahedron",
}


def write_json(path: Path, content: Any) -> None:
    whole_file(path, lambda file: file.write((json.dumps(content, indent=2) + "\n").encode()))
