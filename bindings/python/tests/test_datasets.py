"""Tables of pandas and datasets of xarray: dimensions, names, units."""

import numpy as np
import pytest

import fvi

pytest.importorskip("pandas")
xarray = pytest.importorskip("xarray")

UNITS = {"time": "s", "position": "mm", "momentum": "N s", "energy": "mJ"}
LOOKS = dict(labels=["base", "tip"], units=UNITS)
PLANE = dict(mass=[[2.0, 0.3], [0.3, 1.0]], stiffness=[[3.0, 0.4], [0.4, 2.0]], damping=fvi.Damping(0.5, [0.2, 0.1]), position=[1.0, -0.5],
             step=0.05, steps=40)  # fmt: skip


def described(data):
    """Names and units of all variables and coordinates."""
    assert all(data[name].attrs["long_name"] for name in data.variables)
    return {name: data[name].attrs.get("units") for name in data.variables}


def test_results_have_labels_and_units_of_their_scenario(tmp_path):
    r = fvi.integrate(**PLANE, **LOOKS, memory_energy=True, sensitivities=["system.mass[0][0]"])
    data = r.to_xarray()
    assert described(data) == {
        "t": "s", "q": "mm", "p": "N s", "energy": "mJ", "memory_stored": "mJ", "memory_dissipated": "mJ", "dq": None, "dp": None,
        "coordinate": None, "label": None,
    }  # fmt: skip
    assert list(data["label"].values) == r.labels == LOOKS["labels"] and r.units == UNITS
    assert data["dq"].dims == ("t", "parameter", "coordinate") and np.array_equal(data["dq"], r.dq)
    r.save(tmp_path / "run.npz")
    fvi.run({"system": {"mass": [1.0]}, "initial": {"position": [1.0]}, "time": {"step": 0.1, "steps": 3}}, out=tmp_path / "run",
            units={"time": "s"}, labels=["tip"])  # fmt: skip
    assert described(fvi.load(tmp_path / "run.npz").to_xarray()) == described(data)
    read = fvi.load(tmp_path / "run")
    assert read.labels == ["tip"] and read.to_xarray()["t"].attrs == {"long_name": "time", "units": "s"}
    plain = fvi.integrate(**PLANE, coordinates=[1])
    assert plain.labels == ["q1"] and plain.units == {} and set(described(plain.to_xarray()).values()) == {None}


def test_runs_of_a_batch_have_those_of_their_model():
    runs = fvi.Model(**PLANE, **LOOKS).batch({"q0": [0.5, 1.0]})
    data = runs.to_xarray()
    assert data["q"].dims == ("run", "t", "coordinate") and list(data["label"].values) == ["base", "tip"]
    units = described(data)
    assert (units["t"], units["q"], units["p"], units["energy"], units["status"]) == ("s", "mm", "N s", "mJ", None)
    assert runs[1].labels == ["base", "tip"] and runs[1].to_xarray()["q"].attrs["units"] == "mm"


def test_pictures_have_them_unless_others_are_given():
    pytest.importorskip("matplotlib").use("Agg")
    r = fvi.integrate(**PLANE, **LOOKS)
    above, below = r.plot()
    assert above.get_ylabel() == "position (mm)" and below.get_ylabel() == "energy (mJ)" and below.get_xlabel() == "time t (s)"
    assert [line.get_label() for line in above.lines] == ["base", "tip"]
    above, below = r.plot(unit="", time_unit="ms", coordinates=[1])
    assert above.get_ylabel() == "position" and below.get_xlabel() == "time t (ms)" and above.lines[0].get_label() == "tip"
    above, _ = fvi.Model(**PLANE, **LOOKS).batch({"q0": [0.5, 1.0]}).plot(coordinate=1)
    assert above.get_ylabel() == "tip (mm)"


def test_constraints_and_controllers_have_dimensions_of_their_own():
    time, start = {"step": 0.05, "steps": 20}, {"position": [1.0, 0.5, 0.5]}
    held = {"system": {"mass": [1.0, 1.0, 1.0], "constraints": ["q1 - q2", "q0 + q1 - 1.5"]}, "initial": start, "time": time}
    pid = {"kp": 1.0, "sample": 0.05, "measures": "q0", "setpoint": "0", "drives": [1.0, 0.0, 0.0]}
    driven = {"system": {"mass": [1.0, 1.0, 1.0]}, "controller": [pid, {**pid, "measures": "q1"}], "initial": start, "time": time}
    of_constraints, of_controllers = (fvi.run(scenario).to_xarray() for scenario in (held, driven))
    assert of_constraints["lambda"].dims == ("t", "constraint") and of_controllers["u"].dims == ("t", "controller")
    assert of_controllers["u"].attrs["long_name"] == "output of the controller"
    described(of_constraints), described(of_controllers)


def test_responses():
    scenario = {"system": {"mass": [1.0], "potential": "2*q0^2", "damping": [{"order": 0.5, "coefficient": [0.1]}]},
                "initial": {"position": [0.0]}, "time": {"step": 0.5, "steps": 100}, "output": {"units": UNITS}}  # fmt: skip
    omega = np.geomspace(0.1, 20.0, 30)
    r = fvi.response(scenario, omega, near=2.0, modes=1)
    data, frame = r.to_xarray(), r.to_pandas()
    units = described(data)
    assert (units["omega"], units["t"], units["pole"]) == ("rad/s", "s", "1/s") and np.array_equal(data["response"], r.response)
    assert np.array_equal(frame["response"], r.response) and np.array_equal(frame.index, omega) and frame.index.name == "omega"
    # The scheme has frequencies up to π/h.
    known = len(r.discrete)
    assert known < 30 and np.array_equal(frame["discrete"][:known], r.discrete) and frame["discrete"][known:].isna().all()
    assert data["moduli"].dims == ("kernel", "omega") and np.array_equal(data["creep"][0], r.kernels[0].creep)
    assert np.array_equal(data["mode"], [r.modes[0].s]) and np.array_equal(data["shape"][0], r.modes[0].shape)
    assert np.isnan(fvi.response(scenario, omega, discrete=False).to_xarray()["discrete"]).all()


def test_fits_and_their_tables():
    truth = {"system": {"mass": [1.0], "potential": "2*q0^2", "damping": [{"order": 0.5, "coefficient": [0.1]}]},
             "initial": {"position": [1.0]}, "time": {"step": 0.05, "steps": 100}, "output": {"units": UNITS}}  # fmt: skip
    measured = fvi.run(truth)
    data = {"t": measured.t, "q0": measured.q[:, 0] + 1e-3 * np.sin(50.0 * measured.t), "deviation": 1e-3}
    fit = fvi.fit(truth, ["system.damping[0].order", "system.damping[0].coefficient[0]"], data)
    frame, found = fit.to_pandas(), fit.to_xarray()
    assert list(frame.index) == list(fit.parameters) and frame["estimate"].to_dict() == fit.estimates
    assert frame["standard_error"].to_dict() == fit.standard_errors
    low, high = fit.intervals["system.damping[0].order"]
    assert tuple(frame.loc["system.damping[0].order", ["lower", "upper"]]) == (low, high)
    assert np.array_equal(found["correlation"], fit.correlation) and found.attrs["chi2"] == fit.chi2
    described(found)
    table = fit.tables[0]
    rows = table.to_xarray()
    assert described(rows) == {"t": "s", "q0": "mm", "q0_model": "mm", "q0_deviation": "mm"}
    assert rows["q0_model"].attrs["long_name"] == "position q0, model" and np.array_equal(rows["q0_model"], table.model["q0"])
    assert list(table.to_pandas()) == ["q0", "q0_model", "q0_deviation"] and table.to_pandas().index.name == "t"


def test_tunings_and_tables():
    tuning = fvi.tune({"plant": {"transfer": "1.0263/(s*(0.71*s + 1))"}, "controller": {"structure": "pd", "sample": 1e-8},
                       "specification": {"crossover": 2.51, "phase_margin": 83.9, "flat_phase": True}})  # fmt: skip
    data = tuning.to_xarray()
    described(data)
    assert np.array_equal(data["loop"], tuning.loop) and np.array_equal(data["step"], tuning.step) and data.attrs["kp"] == tuning.kp
    assert tuning.to_pandas().loc["phase_margin", "continuous"] == tuning.margins["phase_margin"]
    oscillator = {"system": {"mass": [1.0], "potential": "0.5*q0^2"}, "initial": {"position": [1.0], "momentum": [0.0]},
                  "time": {"step": 0.1, "end": 2.0}, "reference": {"position": ["cos(t)"]}}  # fmt: skip
    table = fvi.converge(oscillator, (3, 5))
    assert np.array_equal(table.to_xarray()["position_error"], table["position_error"])
