"""Runs of scenarios: bit-identity with the program, refused input, interruptions and callbacks."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import fvi

ROOT = Path(__file__).resolve().parents[3]
# All but one scenario, which takes minutes without optimisation.
SCENARIOS = sorted(set((ROOT / "examples/scenarios").glob("*.toml")) - {ROOT / "examples/scenarios/pendulum-ten-million.toml"})
PROGRAM = os.environ.get("FVI_PROGRAM")

PENDULUM = {
    "system": {
        "mass": [0.25],
        "potential": "m*g*l*(1 - cos(q0))",
        "parameters": {"m": 1.0, "g": 9.81, "l": 0.5},
        "damping": [{"order": 0.6, "coefficient": [0.12]}],
    },
    "initial": {"position": [2.0], "velocity": [0.0]},
    "convolution": {"order": 2},
    "time": {"step": 0.005, "steps": 400},
}


def bits(array):
    return np.ascontiguousarray(array).view(np.uint64)


@pytest.mark.skipif(PROGRAM is None, reason="FVI_PROGRAM does not name the program")
@pytest.mark.parametrize("precision", ["f64", "f32"])
@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda path: path.stem)
def test_the_numbers_are_those_of_the_program(scenario, precision, tmp_path):
    arguments = [PROGRAM, "run", scenario, "--out", tmp_path, "--precision", precision, "--quiet"]
    if subprocess.run(arguments, capture_output=True).returncode != 0:
        pytest.skip("the program does not run this scenario in this precision")
    rows = np.loadtxt(tmp_path / "trajectory.csv", delimiter=",", skiprows=1)
    with pytest.warns() if "warnings" in json.loads((tmp_path / "summary.json").read_text()) else open(os.devnull):
        result = fvi.run(scenario, precision=precision)
    record = json.loads((tmp_path / "summary.json").read_text())
    columns = dict(result.columns)
    loops = [columns.pop(name) for name in ("u", "setpoint", "measure") if name in columns]
    # Of several controllers the file has the three columns of each together.
    loops = [np.stack(loops, axis=-1).reshape(len(result.t), -1)] if loops else []
    mine = np.column_stack([result.t, result.q, result.p, result.energy, *loops, *columns.values()])
    assert np.array_equal(bits(mine), bits(rows))
    read = fvi.load(tmp_path)
    # Python has another meaning for the name of the column.
    columns = ["multipliers" if name == "lambda" else name for name in result.columns]
    for name in ("t", "q", "p", "energy", "dq", "dp", *columns):
        assert np.array_equal(bits(getattr(read, name)), bits(getattr(result, name))), name
    assert read.message == result.message
    for key in ("steps", "last", "largest", "engine", "scenario", "newton_iterations"):
        assert result.summary[key] == record[key], key


def test_a_dictionary_is_a_scenario_and_changes_are_changes():
    result = fvi.run(PENDULUM)
    assert result.success and result.status == 0
    assert result.t.shape == result.energy.shape == (401,)
    assert result.q.shape == result.p.shape == (401, 1)
    # The same through arrays, another engine, and by path.
    with_arrays = json.loads(json.dumps(PENDULUM)) | {"initial": {"position": np.array([2.0]), "velocity": np.zeros(1)}}
    assert np.array_equal(fvi.run(with_arrays).q, result.q)
    direct = fvi.run(PENDULUM, engine="block-fft")
    assert direct.summary["engine"] == ["block-fft"]
    assert np.allclose(direct.q, result.q, atol=1e-11)
    other = fvi.run(PENDULUM, overrides={"system.damping[0].order": 1.2}, every=100, steps=250)
    assert other.summary["scenario"]["system"]["damping"][0]["order"] == 1.2
    assert np.array_equal(other.t, 0.005 * np.array([0, 100, 200, 250]))
    assert fvi.run(PENDULUM, end=1.0).summary["steps"] == 200
    assert fvi.run(PENDULUM, momentum=[0.5]).p[0, 0] == 0.5


def test_a_file_with_changes_finds_the_files_it_names():
    changed = fvi.run(ROOT / "examples/scenarios/pendulum.toml", step=0.01)
    assert changed.summary["steps"] == 2000
    assert changed.title == "Pendulum on a viscoelastic hinge"


@pytest.mark.parametrize(
    ("keys", "key"),
    [
        ({"step": -1.0}, "time.step"),
        ({"step": float("nan")}, "time.step"),
        ({"engine": "fastest"}, "engine"),
        ({"order": 7}, "convolution.order"),
        ({"position": [1.0, 2.0]}, "initial.position"),
        ({"position": np.array([1.0 + 1j])}, "initial.position"),
        ({"stepp": 0.1}, "stepp"),
        ({"overrides": {"system.damping[3].order": 0.5}}, "system.damping[3].order"),
        ({"overrides": {"system.damping[0].ordr": 0.5}}, "system.damping[0].ordr"),
        ({"overrides": {"time.step": object()}}, "time.step"),
        ({"precision": "f16"}, "precision"),
    ],
)
def test_what_cannot_be_used_is_named(keys, key):
    with pytest.raises(fvi.InputError) as caught:
        fvi.run(PENDULUM, **keys)
    assert caught.value.key == key, caught.value
    assert key in str(caught.value)


def test_a_mistake_in_a_file_is_told_with_its_place(tmp_path):
    file = tmp_path / "wrong.toml"
    file.write_text((ROOT / "examples/scenarios/pendulum.toml").read_text().replace("order = 0.6", "order = 2.6"))
    with pytest.raises(fvi.InputError, match=r"wrong\.toml:11:9: system\.damping\[0\]\.order = 2\.6: .*0 ≤ β < 2"):
        fvi.run(file)
    with pytest.raises(fvi.InputError, match="cannot be read"):
        fvi.run(tmp_path / "absent.toml")
    with pytest.raises(fvi.InputError, match="a path or a dictionary"):
        fvi.run(7)


GROWING = {
    "system": {"mass": [1.0], "potential": "-q0^4"},
    "initial": {"position": [1.0], "momentum": [0.0]},
    "time": {"step": 0.01, "steps": 1000},
}


def test_a_step_that_fails_keeps_what_was_computed():
    with pytest.raises(fvi.StepError) as caught:
        fvi.run(GROWING)
    result = caught.value.result
    assert not result.success and result.status == -1 and result.message in str(caught.value)
    assert 10 < len(result.t) < 1000 and np.isfinite(result.q).all()
    unchecked = fvi.run(GROWING, check=False)
    assert np.array_equal(unchecked.q, result.q) and unchecked.message == result.message


def test_warnings_of_a_scenario_are_warnings():
    singular = PENDULUM | {"system": PENDULUM["system"] | {"damping": [
        {"order": 0.6, "coefficient": [0.12], "derivative": "riemann-liouville"}]}}
    with pytest.warns(UserWarning, match="Riemann–Liouville"):
        fvi.run(singular, at="main-nodes")


def test_progress_is_told_and_may_stop_the_run():
    heard = []
    fvi.run(PENDULUM, progress=lambda done, all: heard.append((done, all)))
    assert heard[-1] == (400, 400)

    def enough(done, all):
        raise LookupError("enough")

    with pytest.raises(LookupError, match="enough") as caught:
        fvi.run(PENDULUM, progress=enough, steps=10**7, every=10**5)
    assert caught.value.result.status == 1
    with pytest.raises(fvi.InputError, match="progress"):
        fvi.run(PENDULUM, progress=3)


def test_rows_that_do_not_fit_are_refused():
    undamped = PENDULUM | {"system": PENDULUM["system"] | {"damping": []}}
    with pytest.raises(MemoryError, match="every"):
        fvi.run(undamped, steps=10**11)


def test_an_interrupt_ends_a_long_run_at_once():
    # 10⁹ steps; a second thread interrupts after the run has begun.
    script = f"""
        import _thread, signal, threading, time, fvi
        # The tests may have been started with interrupts ignored, which processes inherit.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        began = threading.Event()
        def interrupt():
            began.wait()
            global at
            at = time.monotonic()
            _thread.interrupt_main()
        threading.Thread(target=interrupt, daemon=True).start()
        try:
            fvi.run({PENDULUM!r}, steps=10**9, every=10**6, engine="exponential-sum", tolerance=1e-10,
                    progress=lambda done, all: began.set())
        except KeyboardInterrupt as error:
            print(time.monotonic() - at, error.result.status)
    """
    run = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, timeout=300)
    seconds, status = run.stdout.split()
    assert status == "1", run.stderr
    assert float(seconds) < 1.0  # 0.02 s on an idle machine


def test_the_interpreter_is_free_during_a_run():
    # A counting thread makes progress while another one computes.
    counted = 0
    done = threading.Event()

    def count():
        nonlocal counted
        while not done.is_set():
            counted += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    fvi.run(PENDULUM, steps=200_000, every=1000, engine="exponential-sum")
    done.set()
    thread.join()
    assert counted > 20


def test_threads_do_not_mix_their_runs():
    expected = {order: fvi.run(PENDULUM, overrides={"system.damping[0].order": order}).q for order in (0.3, 0.9, 1.5)}
    found = {}

    def one(order):
        found[order] = fvi.run(PENDULUM, overrides={"system.damping[0].order": order}).q

    threads = [threading.Thread(target=one, args=(order,)) for order in expected]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(expected[order], found[order]) for order in expected)


def test_arrays_belong_to_python():
    result = fvi.run(PENDULUM)
    for array in (result.t, result.q, result.p, result.energy):
        assert array.dtype == np.float64 and array.flags.c_contiguous and array.flags.writeable
        # No copy was made: the memory is Rust's, held by a base object.
        assert array.base is not None
    q = result.q
    del result
    assert q[0, 0] == 2.0


def test_memory_does_not_grow():
    resource = pytest.importorskip("resource")
    short = json.loads(json.dumps(PENDULUM))
    short["time"]["steps"] = 100

    def calls(count):
        for _ in range(count):
            fvi.run(short)
            with pytest.raises(fvi.InputError):
                fvi.run(short, step=-1.0)
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    calls(500)
    before = calls(200)
    assert calls(1500) - before < 2000  # kilobytes


def test_a_panic_is_an_exception():
    panic = getattr(fvi._fvi, "_panic", None)
    if panic is None:
        pytest.skip("a release has no panic to ask for")
    with pytest.raises(RuntimeError, match="a mistake in fvi, please report it: asked for"):
        panic()


def test_results_become_tables_and_pictures():
    result = fvi.run(PENDULUM)
    pandas = pytest.importorskip("pandas")
    frame = result.to_pandas()
    assert list(frame.columns) == ["q0", "p0", "energy"] and frame.index.name == "t"
    assert isinstance(frame, pandas.DataFrame) and frame["q0"].to_numpy()[-1] == result.q[-1, 0]


def test_xarray_and_matplotlib():
    result = fvi.run(PENDULUM)
    pytest.importorskip("xarray")
    data = result.to_xarray()
    assert data["q"].dims == ("t", "coordinate") and data.attrs["steps"] == 400
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    above, below = result.plot()
    assert above.get_ylabel() == "position" and below.get_xlabel() == "time t"
    assert np.array_equal(above.lines[0].get_ydata(), result.q[:, 0])


LOOP = {
    "measures": "q0",
    "setpoint": "1",
    "drives": [1.0],
    "kp": 2.0,
    "ki": 1.0,
    "lambda": 0.9,
    "sample": 0.02,
    "delay": 0.03,
}


def loop_of(*controllers):
    return {
        "system": {"mass": [1.0], "potential": "0.5*q0^2"},
        "time": {"step": 0.02, "steps": 100},
        "controller": list(controllers),
    }


def test_a_controller_by_itself_is_that_of_the_loop():
    keys = {"kp": 2.0, "ki": 1.0, "kd": 0.3, "mu": 0.5, "limits": [-1.5, 1.5], "rate_limit": 60.0}
    windup = {"kind": "back-calculation", "time": 0.1}
    one = fvi.run(loop_of({**LOOP, **keys, "anti_windup": windup, "derivative_filter": 0.05}))
    pid = fvi.FractionalPid(sample=0.02, lam=0.9, anti_windup=windup, derivative_filter=0.05, length=101, **keys)
    assert [pid.tick(1.0, y) for y in one.q[:, 0]] == list(one.u)
    assert (abs(one.u) == 1.5).any()
    state, expected = pid.save(), pid.output
    with pytest.raises(fvi.InputError, match="measured value is not a finite number"):
        pid.tick(1.0, float("nan"))
    assert pid.save() == state and pid.output == expected
    pid.manual(0.25)
    assert pid.is_manual and pid.tick(1.0, 0.0) == 0.25
    pid.automatic()
    assert pid.tick(0.9, 0.1) == pytest.approx(0.25, abs=1e-12)
    pid.set_gains(1.0, 0.5, 0.0)
    assert pid.tick(0.9, 0.1) - 0.25 < 0.1
    pid.restore(state)
    assert pid.output == expected
    pid.reset()
    assert pid.output == 0.0 and pid.integral == 0.0
    to_r, to_y = pid.response(3.0)
    assert to_y - to_r == pytest.approx(0.0, abs=10.0) and to_r.real > 1.0
    with pytest.raises(fvi.InputError, match="lam = "):
        fvi.FractionalPid(sample=0.02, lam=2.0)
    with pytest.raises(fvi.InputError, match="limits"):
        fvi.FractionalPid(sample=0.02, kp=1.0, limits=[1.0, -1.0])
    with pytest.raises(fvi.InputError, match="speed"):
        fvi.FractionalPid(sample=0.02, speed=1.0)


def test_a_controller_starts_from_rest_and_gains_are_factors_of_the_operators():
    rest = {"sample": 0.01, "kp": 2.0, "ki": 1.0, "kd": 1.0, "mu": 0.9}
    assert fvi.FractionalPid(**rest).tick(20.0, 20.0) == 0.0
    kick = fvi.FractionalPid(**rest, derivative="riemann-liouville").tick(20.0, 20.0)
    assert kick == pytest.approx(-20.0 * 0.01**-0.9)
    # In the series form 1/T_i and T_d, as in Rust and C.
    series = {"sample": 0.01, "form": "series", "lam": 0.8, "mu": 0.7}
    made = fvi.FractionalPid(**series, kp=2.0, integral_time=4.0, derivative_time=0.5)
    given = fvi.FractionalPid(**series, kp=1.0, integral_time=1.0, derivative_time=0.1)
    given.set_gains(2.0, 0.25, 0.5)
    assert given.response(3.0) == made.response(3.0)
    without = fvi.FractionalPid(**series, kp=2.0, derivative_time=0.5)
    given.set_gains(2.0, 0.0, 0.5)
    assert given.response(3.0) == without.response(3.0)


def test_controllers_have_columns(tmp_path):
    plain = fvi.run(loop_of())
    assert plain.u is None and plain.setpoint is None and plain.measure is None
    one = fvi.run(loop_of(LOOP))
    assert one.u.shape == one.setpoint.shape == one.measure.shape == (101,)
    assert (one.setpoint == 1.0).all() and (one.measure == one.q[:, 0]).all()
    assert one.u[0] == pytest.approx(2.0 + 0.02**0.9, rel=1e-14)
    in_files = fvi.run(loop_of(LOOP), out=tmp_path / "out")
    assert (in_files.u == one.u).all() and (in_files.measure == one.measure).all()
    one.save(tmp_path / "r.npz")
    assert (fvi.load(tmp_path / "r.npz").u == one.u).all()
    two = fvi.run(loop_of(LOOP, {**LOOP, "kp": 0.0, "ki": 0.0, "kd": 0.1}))
    assert two.u.shape == two.measure.shape == (101, 2)
    assert (two.measure[:, 0] == two.measure[:, 1]).all() and not (two.u[:, 0] == two.u[:, 1]).all()
    with pytest.raises(fvi.InputError, match=r"controller\[0\].sample"):
        fvi.run(loop_of({**LOOP, "sample": 0.03}))
