"""Many runs of one model: the bits of single runs, ragged ends, errors by their index."""

import pickle
import subprocess
import sys

import numpy as np
import pytest

import fvi


def oscillator(**more):
    given = dict(mass=[1.0], potential="0.5*k*q0^2 + c*q0^4", parameters={"k": 1.0, "c": 0.1}, position=[1.0], step=0.05, steps=80,
                 damping=fvi.Damping(0.5, [0.1]))
    return {**given, **more}


def same(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("t", "q", "p", "energy"))


RNG = np.random.default_rng(3)


@pytest.mark.parametrize(
    "more, numbers, changes",
    [
        ({}, {"k": 3, "q0": 1}, lambda k, q: dict(parameters={"k": k, "c": 0.1}, position=[q])),
        ({}, {"parameters.c": 3, "position[0]": 1}, lambda c, q: dict(parameters={"k": 1.0, "c": c}, position=[q])),
        ({}, {"damping[0].order": 1, "damping[0].coefficient": 2}, lambda b, r: dict(damping=fvi.Damping(b, [r]))),
        ({}, {"v0": 1, "system.mass[0]": 2}, lambda v, m: dict(velocity=[v], mass=[m])),
        ({"steps": None, "end": 3.0, "order": 2}, {"p0": 1, "step": 0.0}, lambda p, h: dict(momentum=[p], step=0.05)),
        ({"steps": 600}, {"k": 3}, lambda k: dict(parameters={"k": k, "c": 0.1})),
        ({"every": 7, "precision": "f32"}, {"k": 3}, lambda k: dict(parameters={"k": k, "c": 0.1})),
    ],
)
def test_runs_have_the_bits_of_integrate(more, numbers, changes):
    given = oscillator(**more)
    model = fvi.Model(**given)
    arrays = {name: 0.2 + size * RNG.random(40) if size else np.full(40, 0.05) for name, size in numbers.items()}
    runs = model.batch(arrays)
    assert runs.q.shape == (40, len(runs.t), 1) and runs.success.all() and runs.errors == {}
    for index in (0, 17, 39):
        one = {name: array[index] for name, array in arrays.items()}
        alone = fvi.integrate(**{**given, **changes(*one.values()), **({"momentum": None} if "v0" in one else {})})
        assert same(runs[index], alone), one
        assert same(model.run(one), alone), one
    assert np.array_equal(runs.q[17], runs[17].q)


def test_a_run_has_the_record_of_a_run():
    model = fvi.Model(**oscillator())
    one = model.run({"k": 2.0, "position": [0.5]})
    other = model.integrate(parameters={"k": 2.0, "c": 0.1}, position=[0.5])
    left, right = ({key: value for key, value in r.summary.items() if "seconds" not in key} for r in (one, other))
    assert left == right
    assert same(model.run(), model.integrate())
    assert same(pickle.loads(pickle.dumps(one)), one) and pickle.loads(pickle.dumps(one)).summary == one.summary


def test_vectors_and_single_numbers_stand_for_all_runs():
    model = fvi.Model(mass=np.ones(3), stiffness=np.diag([1.0, 2.0, 3.0]), position=np.zeros(3), step=0.1, steps=5)
    starts = RNG.random((4, 3))
    runs = model.batch({"position": starts, "velocity": np.ones(3), "stiffness[0][0]": 2.0})
    assert np.array_equal(runs.q[:, 0], starts) and (runs.p[:, 0] == 1.0).all()
    assert runs.parameters["velocity"].shape == (4, 3) and len(list(runs)) == 4
    assert same(runs[2], model.integrate(position=starts[2], velocity=np.ones(3), stiffness=np.diag([2.0, 2.0, 3.0])))
    assert model.batch({"position": np.ones(3)}).q.shape == (1, 6, 3)


def test_events_end_runs_and_are_told():
    given = oscillator(events=[fvi.Event("q0", action="stop"), fvi.Event("p0 + 0.3", "falling")], scheme="collocation")
    runs = fvi.Model(**given).batch({"k": [0.0, 1.0, 4.0], "c": 0.0})
    assert runs.t.shape == (3, runs.rows.max()) and runs.rows[2] < runs.rows[1]
    assert np.isnan(runs.q[2, runs.rows[2] :]).all() and not np.isnan(runs.q[2, : runs.rows[2]]).any()
    alone = fvi.integrate(**{**given, "parameters": {"k": 4.0, "c": 0.0}})
    assert same(runs[2], alone) and runs[2].message == alone.message
    assert runs.events[2] == alone.events and runs[2].events == alone.events


def test_what_fails_or_is_refused_is_told_by_its_index():
    # Repelled from the top the motion leaves the domain of the potential.
    model = fvi.Model(**oscillator(potential="-k*q0 + 0*sqrt(3 - q0)", parameters={"k": 1.0}))
    numbers = {"k": [-1.0, 1.0, 1.0, -1.0], "damping[0].order": [0.5, 0.5, 2.5, 0.7]}
    runs = model.batch(numbers, check=False)
    assert runs.status.tolist() == [0, -1, -2, 0] and sorted(runs.errors) == [1, 2]
    assert runs.rows[1] == runs.steps[1] + 1 and runs.t.shape == (81,) and runs.rows[2] == 0
    assert "run 1: step" in str(runs.errors[1]) and runs[1].status == -1
    assert runs.errors[2].key == "damping[0].order" and "run 2: damping[0].order = 2.5" in str(runs.errors[2])
    with pytest.raises(fvi.StepError, match="run 1: step") as failed:
        model.batch(numbers)
    assert failed.value.result.status.tolist() == runs.status.tolist()
    with pytest.raises(fvi.InputError, match="run 0: damping"):
        model.batch({"damping[0].order": [2.5, 0.5]})
    with_gaps = model.batch({"k": [-1.0, np.nan, -2.0], "q0": [1.0, 1.0, np.inf]}, check=False)
    assert with_gaps.status.tolist() == [0, -2, -2] and with_gaps.rows.tolist() == [81, 0, 0]
    assert {place: error.key for place, error in with_gaps.errors.items()} == {1: "k", 2: "q0"}
    assert same(with_gaps[0], model.run({"k": -1.0, "q0": 1.0}))
    for place in (1, 2):
        with pytest.raises(fvi.InputError, match=f"run {place}: "):
            with_gaps[place]
    # A number that all runs have refuses all.
    assert sorted(model.batch({"k": [-1.0, -2.0], "q0": np.nan}, check=False).errors) == [0, 1]
    with pytest.raises(fvi.InputError, match="2.5") as refused:
        model.run({"damping[0].order": 2.5})
    assert refused.value.key == "damping[0].order"
    with pytest.raises(fvi.StepError):
        model.run({"k": 1.0})
    assert model.run({"k": 1.0}, check=False).status == -1


@pytest.mark.parametrize(
    "numbers, said",
    [
        ({"kk": [1.0]}, "did you mean k"),
        ({"k": [[1.0]]}, "one number for each run"),
        ({"k": [1.0, 2.0], "q0": [1.0, 2.0, 3.0]}, "q0 has 3"),
        ({"k": [1.0, np.nan]}, "run 1: k = nan: not allowed; allowed: a finite number"),
        ({"position": [[1.0], [2.0], [np.inf]]}, r"run 2: position\[0\] = inf"),
        ({"k": []}, "no runs"),
        ({"position": [[1.0, 2.0]]}, "a row of 1"),
        ({"q1": [1.0]}, "1 entries"),
        ({"parameters.z": [1.0]}, "no parameter"),
        ({"system.damping[3].order": [1.0]}, "has 1 entries"),
        ({}, "arrays by the names"),
    ],
)
def test_numbers_that_the_model_does_not_have(numbers, said):
    with pytest.raises(fvi.InputError, match=said):
        fvi.Model(**oscillator()).batch(numbers)


def test_functions_run_one_after_another_and_raise():
    def spring(k):
        return fvi.Potential(lambda q: 0.5 * k * q @ q, lambda q: k * q, lambda q: [[k]])

    given = dict(mass=[1.0], position=[1.0], step=0.05, steps=20, potential=spring(2.0))
    runs = fvi.Model(**given).batch({"q0": np.linspace(0.5, 1.0, 20)})
    assert same(runs[3], fvi.integrate(**{**given, "position": [np.linspace(0.5, 1.0, 20)[3]]}))

    def force(t):
        if t > 0.5:
            raise ZeroDivisionError("asked for")
        return [0.0]

    with pytest.raises(ZeroDivisionError) as raised:
        fvi.Model(**given, force=force).batch({"q0": [1.0, 2.0]})
    assert len(raised.value.result) == 2


def test_progress_interrupts_and_pickles():
    model, seen = fvi.Model(**oscillator()), []
    runs = model.batch({"k": np.linspace(0.5, 1.0, 200)}, jobs=2, progress=lambda done, of: seen.append((done, of)))
    assert seen[-1] == (200, 200)
    again = pickle.loads(pickle.dumps(runs))
    assert np.array_equal(again.q, runs.q) and repr(again) == repr(runs)

    def enough(done, of):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as stopped:
        model.batch({"k": np.linspace(0.5, 1.0, 20000)}, progress=enough)
    assert len(stopped.value.result) == 20000 and (stopped.value.result.status == 1).any()


def test_threads_and_order_do_not_change_the_bits():
    model = fvi.Model(**oscillator())
    numbers = {"k": RNG.random(50), "damping[0].order": 0.1 + RNG.random(50)}
    one, other = (model.batch(numbers, jobs=jobs) for jobs in (1, 3))
    assert np.array_equal(one.q, other.q) and np.array_equal(one.energy, other.energy)


def test_runs_are_drawn_and_convert():
    pytest.importorskip("matplotlib").use("Agg")
    runs = fvi.Model(**oscillator()).batch({"k": [1.0, 2.0]})
    assert len(runs.plot()[0].lines) == 2 and "2 runs" in runs._repr_html_()
    with pytest.raises(fvi.InputError, match="coordinate"):
        runs.plot(coordinate=1)
    xarray = pytest.importorskip("xarray")
    assert isinstance(runs.to_xarray(), xarray.Dataset) and runs.to_xarray()["q"].dims == ("run", "t", "coordinate")


def test_sensitivities_have_the_axis_of_runs():
    given = oscillator(sensitivities=["system.parameters.k", "initial.position[0]"])
    runs = fvi.Model(**given).batch({"k": [1.0, 2.0]})
    assert runs.dq.shape == (2, 81, 2, 1)
    assert np.array_equal(runs.dq[1], fvi.integrate(**{**given, "parameters": {"k": 2.0, "c": 0.1}}).dq)
    assert np.array_equal(runs[1].dp, runs.dp[1])


def test_a_model_asks_for_no_signature():
    program = """
import inspect, fvi
model = fvi.Model(mass=[1.0], position=[1.0], step=0.1, steps=2)
def refused(*_, **__): raise AssertionError
inspect.signature = refused
model.integrate(), model.run(), model.batch({"q0": [1.0, 2.0]})
"""
    subprocess.run([sys.executable, "-c", program], check=True)


def test_vectors_at_paths_are_taken_as_a_whole():
    kernel = fvi.Kernel.prony([1.0, 0.5], [1.0, 0.1])
    given = dict(mass=[1.0], stiffness=[4.0], position=[1.0], step=0.05, steps=40)
    model = fvi.Model(**given, damping=fvi.Damping(kernel=kernel, coefficient=[0.3]))
    name = "damping[0].kernel.strengths"
    strengths = np.array([[0.8, 0.7], [1.0, 0.5], [0.2, 2.0]])
    runs = model.batch({name: strengths})
    for run, of_run in zip(runs, strengths):
        alone = fvi.integrate(**given, damping=fvi.Damping(kernel=fvi.Kernel.prony(of_run, [1.0, 0.1]), coefficient=[0.3]))
        assert (run.q == alone.q).all() and (model.run({name: of_run}).q == alone.q).all()
    with pytest.raises(fvi.InputError, match="shape"):
        model.run({name: [1.0, 2.0, 3.0]})


def test_accelerations_and_titles_of_batches_are_those_of_single_runs():
    arguments = dict(mass=[1.0], potential="0.5*k*q0^2", parameters={"k": 1.0}, position=[1.0], step=0.1, steps=100, title="tip")
    for more in ({"events": fvi.Event("q0-0.3", "falling", "stop")}, {"start": 0.05}):
        model = fvi.Model(**arguments, **more)
        one, several = model.integrate(), model.batch({"k": [1.0]})[0]
        assert several.title == one.title == "tip"
        assert (several.a == one.a).all() and np.abs(one.a + one.q).max() < 2e-2
    inside = fvi.Model(**arguments, times=[0.0, 0.17, 0.23])
    with pytest.raises(fvi.InputError, match="midpoint rule"):
        inside.batch({"k": [1.0]})[0].a
    steps = fvi.Model(**arguments).batch({"time.step": [0.1, 0.05]})
    assert [run.summary["scenario"]["time"]["step"] for run in steps] == [0.1, 0.05]


def test_parameters_may_have_the_names_of_variables():
    pytest.importorskip("xarray")
    for name in ("p", "q", "energy", "status"):
        model = fvi.Model(mass=[1.0], potential=f"0.5*{name}*q0^2", parameters={name: 1.0}, position=[1.0], step=0.1, steps=10)
        data = model.batch({name: [1.0, 2.0]}).to_xarray()
        assert list(data[f"{name}_given"].values) == [1.0, 2.0] and data["q"].ndim == 3
