"""Checkpoints: a file of each rank, and a manifest that lists them."""

from __future__ import annotations

import json
import re
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fvi import _arrays
from fvi._errors import InputError
from fvi.petsc._arguments import Layout
from fvi.petsc._damping import fresh
from fvi.petsc._output import Directory, flush_directory, whole_file, write_json
from fvi.petsc._step import Stepper

VERSION = 1
NORMS = 1e-9
"""Relative difference of norms that rounding in sums over other ranks may make."""


class Checkpoints:
    """The last two generations of the state of a run.

    Every rank writes a file of its own rows; when all of them are on the disk, rank 0 writes the manifest that names them. Until
    then the previous manifest and its files are kept.
    """

    def __init__(self, directory: Directory, layout: Layout) -> None:
        self.place, self.layout = directory.path / "checkpoint", layout
        self.manifest, self.previous = self.place / "manifest.json", self.place / "manifest.previous.json"

    def forget(self) -> None:
        """Removes the checkpoints of an earlier run. On rank 0 only."""
        self.place.mkdir(parents=True, exist_ok=True)
        for path in (self.manifest, self.previous, *self.place.glob("step-*")):
            path.unlink(missing_ok=True)

    def write(self, step: int, stepper: Stepper, facts: Mapping[str, Any]) -> None:
        """Writes a generation; collective. An error on one rank is raised on all."""
        together = self.layout.together
        name, size, error = f"step-{step:012d}.rank-{together.rank:05d}-of-{together.size:05d}.npz", 0, None
        try:
            arrays: dict[str, Any] = {
                "step": np.int64(step),
                "position": stepper.position.getArray(readonly=True),
                "momentum": stepper.momentum.getArray(readonly=True),
            }
            for index, term in enumerate(stepper.damping):
                arrays |= {f"damping{index}.{key}": value for key, value in term.state().items()}
            size = whole_file(self.place / name, lambda file: np.savez(file, **arrays))
        except Exception as raised:
            error = raised
        together.agree(error)
        spans = [_span(term.channels.index) for term in stepper.damping]
        files = together.comm.gather([name, size, self.layout.first, self.layout.end, spans])
        error = None
        if together.rank == 0:
            try:
                self._conclude({"version": VERSION, "step": step, **facts, "files": files})
            except Exception as raised:
                error = raised
        together.agree(error)

    def _conclude(self, manifest: dict[str, Any]) -> None:
        flush_directory(self.place)
        if self.manifest.exists():
            self.manifest.replace(self.previous)
        write_json(self.manifest, manifest)
        flush_directory(self.place)
        kept = {file[0] for file in manifest["files"]}
        if self.previous.exists():
            kept |= {file[0] for file in json.loads(self.previous.read_text())["files"]}
        for path in self.place.glob("step-*"):
            if path.name not in kept:
                path.unlink()

    def newest(self) -> dict[str, Any] | None:
        """The manifest of the newest complete and undamaged generation; `None` if there is none. Collective."""
        damages: list[str] = []
        for path in (self.manifest, self.previous):
            manifest = self._whole(path, damages)
            if manifest is not None:
                if damages and self.layout.together.rank == 0:
                    warnings.warn(f"a checkpoint is damaged, the one before is taken: {damages[0]}", stacklevel=2)
                return manifest
        if damages:
            message = f"output: all checkpoints in {self.place} are damaged: {'; '.join(damages)}"
            raise InputError(message, "output", str(self.place))
        return None

    def _whole(self, path: Path, damages: list[str]) -> dict[str, Any] | None:
        """The manifest, if all its files are undamaged; otherwise `None`, with the reason added to `damages`. The ranks share the
        reading."""
        together = self.layout.together
        manifest: dict[str, Any] | None = None
        damage = None
        if together.rank == 0 and path.exists():
            try:
                manifest = json.loads(path.read_text())
                if manifest is None or manifest["version"] != VERSION:
                    raise ValueError(f"not of version {VERSION}")
                _ = [manifest["files"], manifest["step"], manifest["rows"]]
            except (OSError, ValueError, KeyError, TypeError) as error:
                manifest, damage = None, f"{path.name}: {error!r}"
        manifest = together.comm.bcast(manifest)
        if manifest is not None:
            try:
                for name, size, *_ in manifest["files"][together.rank :: together.size]:
                    _look_through(self.place / name, size)
            except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
                damage = f"{path.name}: {error}"
        found = [damage for damage in together.comm.allgather(damage) if damage is not None]
        damages.extend(found)
        return None if found else manifest

    def read(self, manifest: Mapping[str, Any], stepper: Stepper) -> None:
        """Restores the rows of this rank from the files of all ranks that had some of them."""
        first, end = self.layout.first, self.layout.end
        vectors = {"position": stepper.position, "momentum": stepper.momentum}
        fresh(stepper.damping)
        for name, _, its_first, its_end, spans in manifest["files"]:
            begin, stop = max(first, its_first), min(end, its_end)
            shared = [index for index, term in enumerate(stepper.damping) if _meet(spans[index], term.channels.index)]
            if begin >= stop and not shared:
                continue
            with np.load(self.place / name, allow_pickle=False) as saved:
                if begin < stop:
                    for key, vector in vectors.items():
                        vector.getArray()[begin - first : stop - first] = saved[key][begin - its_first : stop - its_first]
                for index in shared:
                    prefix = f"damping{index}."
                    state = {key.removeprefix(prefix): saved[key] for key in saved.files if key.startswith(prefix)}
                    stepper.damping[index].restore(state)


def _span(index: Any) -> list[int]:
    """First and end index, counted over all ranks, of the channels of a state."""
    return [int(index[0]), int(index[-1]) + 1] if len(index) > 0 else [0, 0]


def _meet(span: list[int], index: Any) -> bool:
    first, end = _span(index)
    return max(first, span[0]) < min(end, span[1])


def _look_through(path: Path, size: int) -> None:
    """Raises if a file is damaged: another size, or a wrong checksum."""
    if path.stat().st_size != size:
        raise ValueError(f"{path.name} has {path.stat().st_size} bytes instead of {size}")
    with zipfile.ZipFile(path) as archive:
        if (name := archive.testzip()) is not None:
            raise ValueError(f"{path.name}: the checksum of {name} is wrong")


def differences(saved: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """The names of the values in which a run and its checkpoint differ; norms of matrices may differ by rounding."""
    found = []
    for key in sorted(set(saved) | set(now)):
        one, other = saved.get(key), now.get(key)
        if key.endswith(" (norm)") and isinstance(one, float) and isinstance(other, float):
            same = one == other or abs(one - other) <= NORMS * max(abs(one), abs(other))
        else:
            same = json.loads(json.dumps(other)) == one
        if not same:
            found.append(f"{re.sub(' .norm.$', '', key)} ({one} there, {other} here)")
    return found


class Pace:
    """Decides when a checkpoint is due: after a number of steps, or a time."""

    def __init__(self, given: int | str | None) -> None:
        self.steps: int | None = None
        self.seconds: float | None = 60.0
        self.asked = given is not None
        self.wants_end = given is not None and given != "never"
        if given is None:
            return
        if isinstance(given, str):
            match = re.fullmatch(r"(\d+(?:\.\d+)?)(ms|s|min|h)", given)
            if given == "never":
                self.seconds = None
            elif match:
                self.seconds = float(match[1]) * {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}[match[2]]
            else:
                allowed = 'a number of steps, a duration as "500ms", "30s", "10min", "2h", or "never"'
                message = f"checkpoint_every = {given!r}: not allowed; allowed: {allowed}"
                raise InputError(message, "checkpoint_every", repr(given))
        else:
            self.steps, self.seconds = _arrays.whole("checkpoint_every", given, 1), None

    def begin(self, now: float) -> None:
        self.last_step, self.last, self.cost = 0, now, 0.0

    def is_due(self, made: int, now: float) -> bool:
        if self.steps is not None:
            return made - self.last_step >= self.steps
        if self.seconds is None:
            return False
        return now - self.last >= (self.seconds if self.asked else max(self.seconds, 100.0 * self.cost))

    def written(self, made: int, begin: float, now: float) -> None:
        self.last_step, self.last, self.cost = made, now, now - begin
        self.wants_end = True
