"""Fits."""

import json
import math
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import fvi

OSCILLATOR = {
    "system": {
        "mass": [1.0],
        "potential": "0.5*k*q0^2",
        "parameters": {"k": 4.0},
        "damping": [{"order": 0.6, "coefficient": [0.3]}],
    },
    "initial": {"position": [1.0]},
    "time": {"step": 0.02, "steps": 200},
}
ORDER, COEFFICIENT, STIFFNESS = "system.damping[0].order", "system.damping[0].coefficient[0]", "system.parameters.k"
FREE = {ORDER: {"start": 0.8, "bounds": (0.1, 1.0)}, COEFFICIENT: {"start": 0.2, "scale": "log"}, STIFFNESS: 3.5}
TRUTH = {ORDER: 0.6, COEFFICIENT: 0.3, STIFFNESS: 4.0}


def record():
    run = fvi.run(OSCILLATOR)
    return {"t": run.t[::4], "q0": run.q[::4, 0]}


def near(found, tolerance=1e-8):
    return all(abs(found.estimates[path] - truth) < tolerance for path, truth in TRUTH.items())


def test_a_truth_is_found_and_its_scenario_runs():
    found = fvi.fit(OSCILLATOR, FREE, record())
    assert near(found) and found.converged and not found.undetermined
    assert all(estimate.derivative == "exact" for estimate in found.parameters.values())
    assert np.abs(fvi.run(found.scenario).q - fvi.run(OSCILLATOR).q).max() < 1e-10
    assert found.correlation.shape == (3, 3) and np.allclose(np.diag(found.correlation), 1)
    assert "standard error" in repr(found) and "<table>" in found._repr_html_()
    assert list(found.intervals) == list(FREE) and set(found.standard_errors) == set(FREE)


def test_noise_gives_errors_and_profiles():
    data = record()
    data["q0"] = data["q0"] + 0.01 * np.random.default_rng(5).standard_normal(len(data["t"]))
    found = fvi.fit(OSCILLATOR, FREE, {**data, "deviation": 0.01}, profile=[STIFFNESS])
    for path, truth in TRUTH.items():
        low, high = found.intervals[path]
        assert low < found.estimates[path] < high and abs(found.estimates[path] - truth) < 5 * (high - low)
    low, high = found.parameters[STIFFNESS].profile_interval
    assert low < found.estimates[STIFFNESS] < high and found.parameters[STIFFNESS].profile.shape[1] == 2
    assert found.parameters[ORDER].profile is None
    arrays = fvi.fit(OSCILLATOR, FREE, {**data, "deviation": np.full(len(data["t"]), 0.01)})
    columns = fvi.fit(OSCILLATOR, FREE, {**data, "deviation": {"q0": np.full(len(data["t"]), 0.01)}})
    assert arrays.chi2 == columns.chi2 == found.chi2
    left = (found.tables[0].data["q0"] - found.tables[0].model["q0"]) / found.tables[0].deviation["q0"]
    assert (left**2).sum() == pytest.approx(found.chi2)


def test_tables_with_their_own_starts_and_frequencies():
    other = fvi.run(OSCILLATOR, position=[-0.5])
    omega = np.geomspace(0.1, 10, 30)
    receptance = 1 / (4 - omega**2 + 0.3 * (1j * omega) ** 0.6)
    data = [
        {**record(), "deviation": 0.01},
        {"t": other.t, "q0": other.q[:, 0], "deviation": 0.01, "set": {"initial.position[0]": -0.5}},
        {"omega": omega, "value": receptance, "relative_deviation": 0.01},
    ]
    found = fvi.fit(OSCILLATOR, FREE, data)
    assert near(found)
    assert found.scenarios[1]["initial"]["position"] == [-0.5] and found.scenario["initial"]["position"] == [1.0]
    assert [table.over for table in found.tables] == ["t", "t", "omega"]


def test_frames_and_missing_numbers():
    pandas = pytest.importorskip("pandas")
    data = record()
    frame = pandas.DataFrame({"Position [m]": data["q0"], "Time": data["t"], "Remark": "fine"})
    frame.loc[[4, 9], "Position [m]"] = np.nan
    columns = {"t": "Time", "q0": "Position [m]"}
    mixed = {"frame": frame.sample(frac=1, random_state=1), "columns": columns}
    found = fvi.fit(OSCILLATOR, FREE, mixed)
    assert near(found) and found.record["tables"][0]["left_out"] == 2
    assert any("2 of 51 rows are left out" in note for note in found.notes)
    assert (np.diff(found.tables[0].places) > 0).all()
    indexed = pandas.DataFrame({"q0": data["q0"]}, index=pandas.Index(data["t"], name="t"))
    assert near(fvi.fit(OSCILLATOR, FREE, indexed)) and near(fvi.fit(OSCILLATOR, FREE, [indexed, mixed]))
    with pytest.raises(fvi.InputError, match="there is no column 'Zeit'; there are 'Position"):
        fvi.fit(OSCILLATOR, FREE, {"frame": frame, "columns": {"t": "Zeit", "q0": "Position [m]"}})


def test_a_parameter_that_touches_nothing_stops():
    system = {**OSCILLATOR["system"], "parameters": {"k": 4.0, "unused": 1.0}}
    with pytest.raises(fvi.InputError, match="no datum changes with system.parameters.unused"):
        fvi.fit({**OSCILLATOR, "system": system}, [STIFFNESS, "system.parameters.unused"], record())


def test_relaxation_and_creep():
    solid = {
        "system": {
            "mass": [1.0],
            "stiffness": [[1.0]],
            "damping": [{"coefficient": [1.0], "kernel": {"form": "prony", "strengths": [1.0], "times": [1.0]}}],
        },
        "time": {"step": 0.1, "steps": 10},
    }
    free = {path: {"scale": "log"} for path in ("system.stiffness[0][0]", "system.damping[0].coefficient[0]", "system.damping[0].kernel.times[0]")}
    t = np.geomspace(0.01, 10, 40)
    relaxation = {"t": t, "relaxation": 2 + 5 * np.exp(-t / 0.3), "relative_deviation": 0.01}
    creep = {"t": t, "creep": (1 - 5 / 7 * np.exp(-t * 2 / (0.3 * 7))) / 2, "relative_deviation": 0.01}
    for data in (relaxation, creep, [relaxation, creep]):
        found = fvi.fit(solid, free, data)
        assert np.allclose(list(found.estimates.values()), [2, 5, 0.3], rtol=1e-8)


def test_frequencies_in_hertz():
    f = np.geomspace(0.02, 2, 30)
    omega = 2 * np.pi * f
    receptance = 1 / (4 - omega**2 + 0.3 * (1j * omega) ** 0.6)
    assert near(fvi.fit(OSCILLATOR, FREE, {"f": f[::-1], "value": receptance[::-1]}))
    given = {"omega": f, "value": receptance, "units": {"omega": "Hz"}}
    assert near(fvi.fit(OSCILLATOR, FREE, given))


def test_models_are_compared():
    data = {**record(), "deviation": 0.001}
    models = {"dashpot": {"set": {ORDER: 1.0}}, "spring-pot": {"free": {ORDER: {"bounds": (0.05, 1)}}}}
    found = fvi.fit(OSCILLATOR, [COEFFICIENT, STIFFNESS], data, models=models, overrides={STIFFNESS: 3.9})
    assert found.name == "spring-pot" and set(found.models) == set(models)
    assert found.models["dashpot"]["aic"] > found.aic
    assert near(found)


def test_what_is_not_determined_has_no_interval():
    found = fvi.fit(OSCILLATOR, {**FREE, "system.mass[0]": 1.1}, record())
    assert found.intervals["system.mass[0]"] is None and found.standard_errors[STIFFNESS] is None
    assert "system.mass[0]" in found.undetermined[0]
    assert math.isnan(found.correlation[1, 1])


def test_large_arrays_come_back_with_the_estimates():
    size = 140
    chain = {
        "system": {
            "mass": np.ones(size),
            "stiffness": np.diag(np.full(size, 2.0)) - np.eye(size, k=1) - np.eye(size, k=-1),
            "damping": [{"order": 0.5, "coefficient": np.ones(size), "scale": 0.1}],
        },
        "initial": {"position": np.linspace(0, 1, size)},
        "time": {"step": 0.05, "steps": 40},
        "output": {"coordinates": [0, 1]},
    }
    run = fvi.run(chain)
    found = fvi.fit(chain, {"system.damping[0].scale": 0.15}, {"t": run.t, "q0": run.q[:, 0]})
    assert found.estimates["system.damping[0].scale"] == pytest.approx(0.1, abs=1e-8)
    again = fvi.run(found.scenario)
    assert np.abs(again.q - run.q).max() < 1e-8


def test_mistakes_are_refused():
    data = record()
    for free, table, keys, words in [
        (FREE, {"q0": data["q0"]}, {}, "one of t, omega and f"),
        (FREE, {**data, "q0": data["q0"][1:]}, {}, "the shape of t"),
        (FREE, {**data, "x": data["q0"]}, {}, "unknown column `x`"),
        (FREE, {**data, "deviation": -1.0}, {}, "a number > 0"),
        ({**FREE, "system.parameters.x": 1.0}, data, {}, "there is no number"),
        ("system.parameters.k", data, {}, "a dictionary or a list of paths"),
        (FREE, data, {"starts": 4}, "every free number has `bounds`"),
        (FREE, {**data, "t": data["t"] + 1}, {}, "after the motion ends"),
        (FREE, data, {"deviations": "guessed"}, "known"),
    ]:
        with pytest.raises(fvi.InputError, match=words):
            fvi.fit(OSCILLATOR, free, table, **keys)
    with pytest.raises(fvi.InputError, match="no such key"):
        fvi.fit(OSCILLATOR, FREE, data, unknown_key=1)


def test_exceptions_of_progress_stop_a_fit():
    class Enough(Exception):
        pass

    def progress(done, all):
        raise Enough

    long = {**OSCILLATOR, "time": {"step": 0.0002, "steps": 200000}}
    with pytest.raises(Enough):
        fvi.fit(long, FREE, {"t": [1.0, 2.0, 40.0], "q0": [0.1, 0.2, 0.3]}, progress=progress)


def test_pictures_are_drawn():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    picture = fvi.fit(OSCILLATOR, FREE, record()).plot()
    assert len(picture) == 2


@pytest.mark.skipif("FVI_PROGRAM" not in os.environ, reason="the program fvi is not there")
def test_the_program_finds_the_same(tmp_path: Path):
    fits = Path(__file__).resolve().parents[3] / "examples/fits"
    command = [os.environ["FVI_PROGRAM"], "fit", str(fits / "decay.toml"), "--out", str(tmp_path), "--quiet"]
    subprocess.run(command, check=True)
    known = json.loads((tmp_path / "fit.json").read_text())
    free = {ORDER: {"bounds": [0.05, 1.0]}, COEFFICIENT: {"scale": "log"}, STIFFNESS: None}
    found = fvi.fit(fits / "oscillator.toml", free, {"file": fits / "decay.csv", "deviation": 0.01})
    assert found.record["parameters"] == known["parameters"]
    assert fvi.run(found.scenario).success
