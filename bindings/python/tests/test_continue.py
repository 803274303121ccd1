"""Runs that continue from results, and motions that begin with a past or at another time."""

import copy
import pickle

import numpy as np
import pytest
import scipy.sparse as sp

import fvi

STIFFNESS = np.array([[3.0, -1.0], [-1.0, 2.0]])
SYSTEM = dict(mass=[1.0, 2.0], stiffness=STIFFNESS, position=[1.0, -0.5], velocity=[0.3, 0.2], step=0.05,
              damping=[fvi.Damping(0.5, [0.4, 0.3]), fvi.Damping(1.4, [0.1, 0.0])])  # fmt: skip
SCHEMES = [
    dict(),
    dict(order=1, at="main-nodes", kappa=0.5),
    dict(scheme="galerkin", degree=2, order=2),
    dict(scheme="galerkin", degree=2, convolution="radau-iia", stages=2),
    dict(scheme="collocation", convolution="radau-iia", stages=3),
    dict(scheme="implicit-euler"),
    dict(convolution="trapezoidal"),
]
ENGINES = ["direct", "block-fft", "real-time", "exponential-sum", "exponential-sum-core"]


def name_of(keys):
    return "-".join(map(str, keys.values())) or "default"


def rows(result):
    return [result.t, result.q, result.p, result.energy]


def assert_goes_on(parts, whole):
    """Asserts that results, each continuing from the one before, together have the rows of a single run."""
    joined = [np.concatenate([column[index > 0 :] for index, column in enumerate(columns)]) for columns in zip(*map(rows, parts))]
    for mine, one in zip(joined, rows(whole)):
        assert np.array_equal(mine, one)


@pytest.mark.parametrize("scheme", SCHEMES, ids=name_of)
def test_results_go_on_to_the_bits_of_one_run(scheme):
    # Without `engine` the shorter run uses another engine than the longer one: equal to rounding.
    short, long = (fvi.integrate(**SYSTEM, **scheme, steps=steps) for steps in (100, 300))
    assert np.abs(fvi.integrate(continue_from=short, steps=200).q - long.q[100:]).max() < 1e-12
    scheme = {**scheme, "engine": "block-fft"}
    whole = fvi.integrate(**SYSTEM, **scheme, steps=300)
    first = fvi.integrate(**SYSTEM, **scheme, steps=100)
    second = fvi.integrate(continue_from=first, steps=50)
    third = fvi.integrate(continue_from=second, end=15.0)
    if scheme.get("convolution") is None:
        assert_goes_on([first, second, third], whole)
    else:
        # Weights without a recursion are computed for a given number of samples.
        assert np.abs(np.concatenate([second.q[1:], third.q[1:]]) - whole.q[101:]).max() < 1e-13
    assert third.success and third.summary["steps"] == 300
    # Starting from the state alone gives a different motion.
    from_state = fvi.integrate(**{**SYSTEM, "position": first.q[-1], "velocity": first.v[-1]}, **scheme, steps=50)
    assert np.abs(from_state.q - second.q).max() > 1e-4
    # It is possible to continue from the first one again.
    assert np.array_equal(fvi.integrate(continue_from=first, steps=50).q, second.q)


@pytest.mark.parametrize("engine", ENGINES)
def test_every_engine_goes_on_to_the_bits_of_one_run_with_its_tables(engine):
    # Tables of exponentials, and the schedule of work spread over the steps, depend on the number of samples.
    keys = dict(engine=engine, **(dict(horizon=4096) if engine.startswith("exp") else {}))
    whole = fvi.integrate(**SYSTEM, **keys, steps=700)
    first = fvi.integrate(**SYSTEM, **keys, steps=300)
    second = fvi.integrate(continue_from=first, steps=400)
    if engine == "real-time":
        assert np.abs(second.q - whole.q[300:]).max() < 1e-13
    else:
        assert_goes_on([first, second], whole)


def test_runs_with_functions_go_on():
    cube = fvi.Potential(lambda q: 0.25 * np.sum(q**4), lambda q: q**3)
    keys = dict(SYSTEM, potential=cube, force=lambda t, q: [np.sin(3 * t), -0.1 * q[0]], loads=fvi.Load([1.0, 0.0], lambda t: t))
    first = fvi.integrate(**keys, steps=60)
    assert_goes_on([first, fvi.integrate(continue_from=first, steps=40)], fvi.integrate(**keys, steps=100))


def test_large_systems_models_and_single_precision_go_on():
    n = 200
    stiffness = sp.diags([-1.0, 2.1, -1.0], [-1, 0, 1], shape=(n, n)).tocsr()
    keys = dict(mass=np.ones(n), stiffness=stiffness, damping=fvi.Damping(0.6, 0.1 * stiffness), step=0.1,
                position=np.linspace(0.0, 1.0, n), coordinates=[3, 150])  # fmt: skip
    for keys, run in ((keys, fvi.integrate), (keys, fvi.Model(**keys).integrate), (SYSTEM | {"precision": "f32"}, fvi.integrate)):
        first = run(**keys if run is fvi.integrate else {}, steps=20)
        whole = run(**keys if run is fvi.integrate else {}, steps=50)
        assert_goes_on([first, fvi.integrate(continue_from=first, steps=30)], whole)


def test_rows_events_and_interrupted_runs_go_on():
    zeros = fvi.Event("q0")
    first = fvi.integrate(**SYSTEM, steps=100, every=7, events=zeros)
    second = fvi.integrate(continue_from=first, steps=100, every=10, coordinates=[1])
    whole = fvi.integrate(**SYSTEM, steps=200, every=10, events=zeros)
    assert np.array_equal(second.t[1:], whole.t[whole.t > 5.0]) and np.array_equal(second.q[1:, 0], whole.q[whole.t > 5.0, 1])
    assert second.t[0] == 5.0 and second.q[0, 0] == first.q[-1, 1] and [event["time"] for event in second.events] == [event["time"] for event in whole.events]
    between = fvi.integrate(continue_from=first, steps=100, times=[5.03, 7.2])
    assert np.array_equal(between.q, fvi.integrate(**SYSTEM, steps=200, times=[5.03, 7.2]).q)

    def stop(made, of):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as stopped:
        fvi.integrate(**SYSTEM, steps=2_000_000, every=1000, progress=stop)
    begun = stopped.value.result
    made = begun.summary["steps"]
    after = fvi.integrate(continue_from=begun, end=0.05 * (made + 10), every=1)
    assert after.summary["steps"] == made + 10 and after.success


def test_what_cannot_be_gone_on_with_says_why(tmp_path):
    first = fvi.integrate(**SYSTEM, steps=10)
    for change, key in [
        (dict(mass=[1.0, 2.0]), "mass"),
        (dict(step=0.1), "step"),
        (dict(force=lambda t: [0.0, 0.0]), "force"),
        (dict(order=1), "order"),
        (dict(precision="f32"), "precision"),
        (dict(end=0.1), "end"),
        (dict(steps=None), "steps"),
        (dict(end=1.0, steps=3), "steps"),
    ]:
        with pytest.raises(fvi.InputError) as caught:
            fvi.integrate(continue_from=first, **({"steps": 5} if not {"end", "steps"} & change.keys() else {}) | change)
        assert caught.value.key == key, caught.value
    first.save(tmp_path / "first.npz")
    collocated = dict(mass=[1.0], stiffness=[1.0], position=[1.0], scheme="collocation", end=10.0)
    for result, words in [
        (fvi.load(tmp_path / "first.npz"), "read from a file"),
        (pickle.loads(pickle.dumps(first)), "no memory"),
        (fvi.integrate(**SYSTEM, steps=10, keep_memory=False), "keep_memory"),
        (fvi.integrate(**collocated, grid="adaptive", tolerance=1e-4), "steps of the result differ"),
        (fvi.integrate(**collocated, step=0.1, events=fvi.Event("q0", action="stop")), "event"),
        (fvi.integrate(**SYSTEM, force=lambda t: [np.nan if t > 0.2 else 0.0, 0.0], steps=10, check=False), "failed"),
        (3, "a result"),
    ]:
        with pytest.raises(fvi.InputError, match=words) as caught:
            fvi.integrate(continue_from=result, steps=5)
        assert caught.value.key == "continue_from"
    assert copy.copy(first).summary == first.summary


def nodes_of(scheme):
    """Where the schemes below have their nodes, beside the ends of steps."""
    if scheme.get("convolution") == "radau-iia":
        return {2: [1 / 3, 1.0], 3: [(4 - 6**0.5) / 10, (4 + 6**0.5) / 10, 1.0]}[scheme["stages"]]
    return [0.5 - 3**-0.5 / 2, 0.5 + 3**-0.5 / 2] if scheme.get("degree") == 2 else []


@pytest.mark.filterwarnings("ignore:system.damping")
@pytest.mark.parametrize("derivative", ["caputo", "riemann-liouville"])
@pytest.mark.parametrize("scheme", SCHEMES, ids=name_of)
def test_a_past_is_what_a_longer_run_remembers(scheme, derivative):
    """The second half of a run equals a run that has the first half as its past."""
    keys = dict(SYSTEM, **scheme, damping=[fvi.Damping(0.5, [0.4, 0.3], derivative), fvi.Damping(1.4, [0.1, 0.0], derivative)])
    del keys["velocity"]
    steps, h = 80, 0.05
    momentum = {"overrides": {"output.momentum": "one-sided"}} if scheme.get("scheme") != "implicit-euler" else {}
    whole = fvi.integrate(**keys, steps=2 * steps, force=["sin(t)", "0.3*t"], **momentum)
    begin, end = steps * h, slice(steps, None)
    more = dict(keys, position=whole.q[steps], momentum=whole.p[steps], steps=steps, start=begin, force=["sin(t)", "0.3*t"])
    inside = nodes_of(scheme)
    if not inside:
        half = fvi.integrate(**more, past=(whole.t[:steps], whole.q[:steps]), **momentum)
        # With the position at the start among the samples.
        del more["position"]
        same = fvi.integrate(**more, past=(whole.t[: steps + 1], whole.q[: steps + 1]), **momentum)
        assert np.array_equal(same.q, half.q)
    else:
        times = np.unique(np.round((whole.t[:steps, None] + h * np.array([0.0, *inside])).ravel(), 12))
        fine = fvi.integrate(**keys, steps=2 * steps, force=["sin(t)", "0.3*t"], times=times, **momentum)
        half = fvi.integrate(**more, past=(0.0, lambda t: fine.q[np.abs(times - t).argmin()]), **momentum)
        with pytest.raises(fvi.InputError, match="function of t"):
            fvi.integrate(**more, past=(whole.t[:steps], whole.q[:steps]), **momentum)
    assert np.allclose(half.t, whole.t[end], rtol=0.0, atol=1e-13)
    # Within a step the stages of collocation differ slightly from the polynomial that `times` evaluates.
    bound = 1e-8 if scheme.get("scheme") == "collocation" else 1e-11
    assert np.abs(half.q - whole.q[end]).max() < bound and np.abs(half.p - whole.p[end]).max() < bound
    without = fvi.integrate(**more | {"position": whole.q[steps]}, **momentum)
    assert np.abs(without.q - whole.q[end]).max() > 1e-4


@pytest.mark.parametrize("engine", ENGINES)
def test_every_engine_takes_a_past(engine):
    keys = dict(mass=[1.0], stiffness=[1.0], damping=fvi.Damping(0.5, [0.5]), step=0.1, steps=100, momentum=[0.0])
    past = (-20.0, lambda t: np.cos(t))
    exact = fvi.integrate(**keys, position=[1.0], past=past, engine="direct")
    assert np.abs(fvi.integrate(**keys, position=[1.0], past=past, engine=engine).q - exact.q).max() < 1e-12


def test_the_force_of_a_past_is_the_derivative_of_its_function():
    # Held at rest after a ramp: the damper's force is D^β of the ramp, known in closed form.
    beta, h = 0.5, 1e-3
    r = fvi.integrate(mass=[1e9], damping=fvi.Damping(beta, [1e6]), position=[1.0], past=(-1.0, lambda t: 1.0 + t), step=h, steps=50)
    force = -np.diff(r.p[:, 0]) / h / 1e6
    t = r.t[1:] - 0.5 * h
    from math import gamma

    exact = ((t + 1.0) ** (1 - beta) - t ** (1 - beta)) / gamma(2 - beta)
    assert np.abs(force[5:] / exact[5:] - 1.0).max() < 1e-3


def test_a_start_shifts_the_time():
    words = dict(force=["sin(3*t)", "0"], loads=fvi.Load([0.0, 1.0], ([0.0, 2.0, 9.0], [0.0, 1.0, 0.0])))
    late = dict(force=["sin(3*(t + 2.5))", "0"], loads=fvi.Load([0.0, 1.0], ([-2.5, -0.5, 6.5], [0.0, 1.0, 0.0])))
    code = dict(force=lambda t: [np.sin(3 * t), np.interp(t, [0.0, 2.0, 9.0], [0.0, 1.0, 0.0])])
    begun = fvi.integrate(**SYSTEM, **late, steps=100)
    for forces in (words, code):
        moved = fvi.integrate(**SYSTEM, **forces, start=2.5, end=7.5)
        assert np.allclose(moved.t, begun.t + 2.5, rtol=0.0, atol=1e-14) and moved.summary["steps"] == 100
        assert np.abs(moved.q - begun.q).max() < 1e-12 and moved.summary["scenario"]["time"]["start"] == 2.5
    first = fvi.integrate(**SYSTEM, **words, start=2.5, steps=40, events=fvi.Event("t - 3.01"))
    assert abs(first.events[0]["time"] - 3.01) < 1e-14
    assert_goes_on([first, fvi.integrate(continue_from=first, end=7.5)], fvi.integrate(**SYSTEM, **words, start=2.5, steps=100))
    inside = fvi.integrate(**SYSTEM, **words, start=2.5, steps=100, times=[2.5, 3.333, 7.5])
    assert np.allclose(inside.q[1], first(3.333), atol=1e-3)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (dict(start=-1.0), "start"),
        (dict(start=np.nan), "start"),
        (dict(start=1.0, end=0.5, steps=None), "end"),
        (dict(start=1.0, times=[0.5]), "times"),
        (dict(start=1.0, scheme="collocation", grid="graded", exponent=2.0, step=None, end=2.0), "start"),
        (dict(past=3.0), "past"),
        (dict(past=(-1.02, lambda t: [0.0, 0.0])), "past[0]"),
        (dict(past=(0.0, lambda t: [0.0, 0.0])), "past[0]"),
        (dict(past=(-0.1, lambda t: [0.0])), "past[1]"),
        (dict(past=([-0.1, 0.0], np.zeros((2, 2)))), "past[0]"),
        (dict(past=([-0.1, -0.05, 0.0], np.zeros((3, 2)))), "position"),
        (dict(past=([-0.05], np.zeros((1, 3)))), "past[1]"),
        (dict(past=([-0.05], [[np.inf, 0.0]])), "past[1]"),
        (dict(past=([-0.05], np.zeros((1, 2))), starting=[0.5]), "starting"),
    ],
)
def test_starts_and_pasts_that_cannot_be_used_are_named(change, key):
    with pytest.raises(fvi.InputError) as caught:
        fvi.integrate(**SYSTEM | dict(steps=10) | change)
    assert caught.value.key == key, caught.value


def test_scenarios_have_starts_and_pasts():
    scenario = {
        "system": {"mass": [1.0], "stiffness": [1.0], "damping": [{"order": 0.5, "coefficient": [0.5]}]},
        "initial": {"position": [0.4], "past": [[0.1], [0.2], [0.3]]},
        "time": {"start": 1.0, "step": 0.1, "end": 3.0},
    }
    told = fvi.run(scenario)
    asked = fvi.integrate(mass=[1.0], stiffness=[1.0], damping=fvi.Damping(0.5, [0.5]), start=1.0, step=0.1, end=3.0,
                          past=(1.0 + 0.1 * np.arange(-3, 1), [0.1, 0.2, 0.3, 0.4]))  # fmt: skip
    assert np.array_equal(told.q, asked.q) and told.summary["scenario"]["initial"]["past"] == [[0.1], [0.2], [0.3]]
    assert np.array_equal(fvi.run(told.summary["scenario"]).q, told.q)
    with pytest.raises(fvi.InputError, match="past"):
        fvi.converge(scenario, (4, 6))


@pytest.mark.parametrize("keys", [dict(scheme="energy"), dict(scheme="galerkin", degree=2, convolution="gauss")])
def test_relaxations_of_gauss_weights_reach_beyond_the_first_run(keys):
    pendulum = dict(mass=[1.0], potential="-9.81*cos(q0)", damping=fvi.Damping(0.5, 0.3), position=[2.0], step=0.001, **keys)
    first = fvi.integrate(**pendulum, end=1.0)
    second = fvi.integrate(continue_from=first, end=3.0)
    assert (second.q == fvi.integrate(**pendulum, end=3.0).q[1000:]).all()
