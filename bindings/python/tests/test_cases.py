"""Load cases integrated together: each equals its run alone, and is bit-identical to the files of the program."""

import os
import subprocess

import numpy as np
import pytest

import fvi

PROGRAM = os.environ.get("FVI_PROGRAM")
STIFFNESS = np.array([[300.0, -100.0], [-100.0, 100.0]])
COMMON = dict(
    mass=[2.0, 1.0], stiffness=STIFFNESS, damping=fvi.Damping(0.5, 0.02 * STIFFNESS), position=[0.0, 0.01], step=0.01, steps=200
)
TIMES = np.linspace(0.0, 2.0, 41)
CASES = {
    "top": fvi.Load([0.0, 1.0], "sin(5*t)"),
    "record": [fvi.Load({"coordinate": 0}, (TIMES, np.cos(TIMES))), fvi.Load([1.0, 1.0], "exp(-t)")],
    "free": [],
}
SCENARIO = """
[system]
mass = [2.0, 1.0]
stiffness = [[300.0, -100.0], [-100.0, 100.0]]
damping = [{ order = 0.5, coefficient = [[6.0, -2.0], [-2.0, 2.0]] }]
[[case]]
name = "top"
load = [{ pattern = [0.0, 1.0], amplitude = "sin(5*t)" }]
[[case]]
name = "both"
load = [{ pattern = [1.0, 1.0], amplitude = "sin(5*t)" }]
[initial]
position = [0.0, 0.01]
momentum = [0.0, 0.0]
[time]
step = 0.01
steps = 205
[output]
every = 10
"""


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_each_case_moves_as_it_does_alone(precision):
    together = fvi.integrate_cases(CASES, **COMMON, loads=fvi.Load([0.0, 0.1], "1"), precision=precision)
    assert list(together) == list(CASES)
    limit = 1e-12 if precision == "f64" else 1e-4
    for name, loads in CASES.items():
        loads = [loads] if isinstance(loads, fvi.Load) else loads
        alone = fvi.integrate(**COMMON, loads=[fvi.Load([0.0, 0.1], "1"), *loads], precision=precision)
        for mine, other in ((together[name].q, alone.q), (together[name].p, alone.p), (together[name].energy, alone.energy)):
            assert np.abs(mine - other).max() <= limit * np.abs(other).max(), name
        assert together[name].success and together[name].summary["steps"] == 200
    assert np.abs(together["top"].q - together["free"].q).max() > 1e-3


def test_a_sparse_structure_has_cases_too():
    sparse = pytest.importorskip("scipy.sparse")
    n = 150
    stiffness = sparse.diags_array([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1]).tocsr()
    pattern = np.sin(np.arange(n))
    common = dict(mass=np.ones(n), stiffness=stiffness, damping=fvi.Damping(0.5, 0.1 * stiffness), position=0.0, step=0.1, steps=50)
    cases = {"one": fvi.Load(pattern, "1"), "two": fvi.Load(2 * pattern, "1")}
    results = fvi.integrate_cases(cases, **common, coordinates=[3, 149])
    assert results["one"].summary["solver"]["kind"] == "sparse" and results["one"].q.shape == (51, 2)
    # A linear structure under twice the load.
    assert np.allclose(2 * results["one"].q, results["two"].q, rtol=1e-12)


@pytest.mark.skipif(PROGRAM is None, reason="FVI_PROGRAM does not name the program")
def test_the_numbers_are_those_of_the_program(tmp_path):
    file = tmp_path / "frame.toml"
    file.write_text(SCENARIO)
    subprocess.run([PROGRAM, "run", file, "--out", tmp_path / "out", "--quiet"], check=True)
    for name, result in fvi.run_cases(file).items():
        rows = np.loadtxt(tmp_path / "out" / name / "trajectory.csv", delimiter=",", skiprows=1)
        assert np.array_equal(np.column_stack([result.t, result.q, result.p, result.energy]), rows)
        assert result.t[-1] == pytest.approx(2.05) and len(result.t) == 22


@pytest.mark.parametrize(
    "cases, change, key",
    [
        ({}, {}, "cases"),
        ([fvi.Load([0.0, 1.0], "t")], {}, "cases"),
        ({"a b": []}, {}, "cases[0].name"),
        ({"a": [], "A": []}, {}, "cases[1].name"),
        ({"a": [3]}, {}, "cases['a'][0]"),
        ({"a": None}, {}, "cases['a']"),
        ({"a": fvi.Load([0.0, 1.0], ([0.0, 2.0, 1.0], [0.0, 1.0, 1.0]))}, {}, "cases['a'][0].amplitude[0][2]"),
        ({"a": fvi.Load([1.0], "t")}, {}, "cases['a'][0].pattern"),
        ({"a": fvi.Load([1.0, 1.0], "t + ")}, {}, "cases[0].load[0].amplitude"),
        ({"a": []}, {"potential": "q0^4"}, "potential"),
        ({"a": []}, {"potential": fvi.Potential(lambda q: q @ q, lambda q: 2 * q)}, "cases"),
        ({"a": []}, {"times": [0.5]}, "times"),
    ],
)
def test_what_cannot_be_used_is_named(cases, change, key):
    with pytest.raises(fvi.InputError) as caught:
        fvi.integrate_cases(cases, **(COMMON | change))
    assert caught.value.key == key, caught.value


def test_functions_of_one_motion_name_the_one_that_takes_cases(tmp_path):
    file = tmp_path / "frame.toml"
    file.write_text(SCENARIO)
    with pytest.raises(fvi.InputError, match="run_cases"):
        fvi.run(file)
    with pytest.raises(fvi.InputError, match="the key `case` is missing"):
        fvi.run_cases({"system": {"mass": [1.0]}, "initial": {"position": [0.0], "velocity": [1.0]}, "time": {"step": 0.1, "end": 1.0}})
    assert list(fvi.run_cases(file, precision="f32", every=50)) == ["top", "both"]


def test_what_ends_the_run_has_the_rows_of_all_cases():
    def stop(done, all):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough") as caught:
        fvi.integrate_cases(CASES, **(COMMON | {"steps": 10**9}), every=10**6, progress=stop)
    assert set(caught.value.result) == set(CASES)
    assert not caught.value.result["top"].success
