"""Sweeps on the cores of one machine."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import fvi

PROGRAM = os.environ.get("FVI_PROGRAM")

OSCILLATOR = {
    "system": {
        "mass": [1.0],
        "potential": "0.5*k*q0^2",
        "parameters": {"k": 1.0},
        "damping": [{"order": 0.5, "coefficient": [0.1]}],
    },
    "initial": {"position": [1.0], "momentum": [0.0]},
    "scheme": {"kind": "low-order", "kappa": 0.0},
    "time": {"step": 0.05, "steps": 60},
}
AXES = {
    "system.damping[0].order": {"from": 0.1, "to": 1.9, "count": 7},
    # With the last of them the step is too long, and the runs are refused.
    "system.parameters.k": np.array([1.0, 4.0, 1e5]),
}
SWEEP = {"scenario": OSCILLATOR, "axes": AXES, "keep": {"quantities": ["last", "energy"]}}

SCENARIO_FILE = """
[system]
mass = [1.0]
potential = "0.5*k*q0^2"
parameters = { k = 1.0 }
damping = [{ order = 0.5, coefficient = [0.1] }]
[initial]
position = [1.0]
momentum = [0.0]
[scheme]
kind = "low-order"
kappa = 0.0
[time]
step = 0.05
steps = 60
"""
SWEEP_FILE = """
scenario = "scenario.toml"
[axes]
"system.damping[0].order" = { from = 0.1, to = 1.9, count = 7 }
"system.parameters.k" = [1.0, 4.0, 1e5]
[keep]
quantities = ["last", "energy"]
"""


@pytest.fixture
def files(tmp_path):
    (tmp_path / "scenario.toml").write_text(SCENARIO_FILE)
    (tmp_path / "sweep.toml").write_text(SWEEP_FILE)
    return tmp_path


def table_bytes(directory):
    return [(Path(directory) / name).read_bytes() for name in ("results.csv", "results.npz")]


def test_a_row_for_each_run_is_what_run_says():
    table = fvi.sweep(SWEEP)
    assert list(table) == [
        "run", "system.damping[0].order", "system.parameters.k", "status", "steps", "t", "q0", "p0",
        "energy_start", "energy", "energy_left", "largest_energy", "message",
    ]  # fmt: skip
    assert len(table["run"]) == 21
    stiff = table["system.parameters.k"] == 1e5
    assert (table["status"][stiff] == "refused").all() and (table["status"][~stiff] == "completed").all()
    assert table["q0"][stiff].isna().all() and "largest stable step" in table["message"][2]
    single = fvi.run(OSCILLATOR, overrides={"system.damping[0].order": 1.3, "system.parameters.k": 4.0})
    assert table["q0"][13] == single.q[-1, 0] and table["energy"][13] == single.energy[-1]


@pytest.mark.skipif(PROGRAM is None, reason="FVI_PROGRAM does not name the program")
def test_the_table_has_the_bytes_of_the_program(files):
    subprocess.run([PROGRAM, "sweep", "sweep.toml", "--quiet", "--out", "program"], cwd=files, check=True)
    table = fvi.sweep(files / "sweep.toml", out=files / "here", jobs=2)
    assert table_bytes(files / "here") == table_bytes(files / "program")
    with np.load(files / "program/results.npz") as arrays:
        for name in arrays:
            column = table[name].to_numpy()
            numbers = arrays[name].dtype.kind in "fi"
            assert np.array_equal(column, arrays[name], equal_nan=numbers and column.dtype.kind == "f"), name


def test_an_interrupted_sweep_goes_on(files):
    class Enough(Exception):
        pass

    def stop(done, all):
        if done >= 5:
            raise Enough

    whole = fvi.sweep(files / "sweep.toml", out=files / "whole")
    with pytest.raises(Enough) as caught:
        fvi.sweep(SWEEP | {"scenario": OSCILLATOR | {"time": {"step": 0.05, "steps": 1_000_000}}}, jobs=1, progress=stop)
    part = caught.value.result
    assert 1 <= len(part) < 21 and list(part) == list(whole)
    heard = []
    for attempt in range(2):
        fvi.sweep(files / "sweep.toml", out=files / "part", shard=f"{attempt}/2", progress=lambda *now: heard.append(now))
    assert heard[-1] == (10, 10) and (11, 11) in heard
    joined = fvi.sweep(files / "sweep.toml", out=files / "part", gather=True)
    assert joined.equals(whole) and table_bytes(files / "part") == table_bytes(files / "whole")


def test_trajectories_are_kept_and_samples_are_drawn(tmp_path):
    axes = {"system.damping[0].order": {"from": 0.1, "to": 1.9}}
    sampled = {"scenario": OSCILLATOR, "axes": axes, "sampling": {"kind": "sobol", "count": 4, "seed": 3}}
    table = fvi.sweep(sampled | {"keep": {"trajectories": True}}, out=tmp_path)
    for run in range(4):
        with np.load(tmp_path / f"runs/{run:06}.npz") as arrays:
            assert arrays["q"][-1, 0] == table["q0"][run]


def test_a_table_needs_no_pandas(monkeypatch):
    monkeypatch.setattr(fvi.Table, "to_pandas", lambda table: (_ for _ in ()).throw(ModuleNotFoundError("pandas")))
    table = fvi.sweep(SWEEP)
    assert isinstance(table, fvi.Table) and table["q0"].shape == (21,) and set(table["status"]) == {"completed", "refused"}


@pytest.mark.parametrize(
    ("change", "keys", "key"),
    [
        ({"axes": {"system.damping[0].ordr": [0.5]}}, {}, "axes.system.damping[0].ordr"),
        ({"axes": {"system.damping[0].order": [0.5, 2.5]}}, {}, "axes.system.damping[0].order[1]"),
        ({"axes": {"system.damping[0].order": [0.5, np.nan]}}, {}, "axes.system.damping[0].order[1]"),
        ({"axes": {}}, {}, "axes"),
        ({"scenario": OSCILLATOR | {"time": {"step": -1.0, "steps": 3}}}, {}, "time.step"),
        ({"scenario": "absent.toml"}, {}, ""),
        ({"scenario": None}, {}, ""),
        ({"keep": {"quantities": ["everything"]}}, {}, "keep.quantities[0]"),
        ({"keep": {"trajectories": True}}, {}, "keep.trajectories"),
        ({}, {"shard": "1/2"}, "shard"),
        ({}, {"shard": "5/2", "out": "o"}, "shard"),
        ({}, {"shard": 2, "out": "o"}, "shard"),
        ({}, {"gather": True}, "gather"),
        ({}, {"gather": True, "out": "o"}, "out"),
        ({}, {"jobs": 0}, "jobs"),
        ({}, {"jobs": 2, "client": object()}, "jobs"),
        ({}, {"precision": "f16"}, "precision"),
        ({}, {"progress": 3}, "progress"),
    ],
)
def test_what_cannot_be_used_is_named(change, keys, key, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "o").mkdir()
    with pytest.raises(fvi.InputError) as caught:
        fvi.sweep(SWEEP | change, **keys)
    assert caught.value.key == key, (caught.value.key, str(caught.value))


def test_another_sweep_in_a_directory_is_refused(tmp_path):
    fvi.sweep(SWEEP, out=tmp_path)
    with pytest.raises(fvi.InputError, match="another sweep"):
        fvi.sweep(SWEEP | {"axes": {"initial.position[0]": [1.0, 2.0]}}, out=tmp_path)
    with pytest.raises(fvi.InputError, match="a path or a dictionary"):
        fvi.sweep(7)
