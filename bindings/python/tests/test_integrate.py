"""Systems from arrays, expressions and functions."""

import traceback

import numpy as np
import pytest

import fvi

COMMON = dict(
    mass=[1.0, 2.0],
    position=[1.0, -0.5],
    step=0.02,
    steps=300,
    damping=[fvi.Damping(order=0.5, coefficient=[0.1, 0.3])],
)
STIFFNESS = np.array([[3.0, -1.0], [-1.0, 2.0]])


def u(q):
    return 0.5 * q @ STIFFNESS @ q + 0.25 * (q[0] - q[1]) ** 4


def du(q):
    cube = (q[0] - q[1]) ** 3
    return STIFFNESS @ q + np.array([cube, -cube])


def ddu(q):
    square = 3 * (q[0] - q[1]) ** 2
    return STIFFNESS + square * np.array([[1.0, -1.0], [-1.0, 1.0]])


SCHEMES = [
    dict(scheme="low-order", kappa=0.5, order=2, at="nodes"),
    dict(scheme="low-order", kappa=0.0, at="main-nodes"),
    dict(scheme="galerkin", degree=3, points=3, order=3, at="nodes"),
    dict(scheme="galerkin", degree=2, convolution="radau-iia", stages=2),
    dict(scheme="galerkin", degree=3, convolution="lobatto-iiic", stages=4),
    dict(scheme="implicit-euler"),
]


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda keys: "-".join(map(str, keys.values())))
def test_functions_move_as_expressions_do(scheme):
    words = fvi.integrate(
        potential="0.25*(q0 - q1)^4", stiffness=STIFFNESS, force=["sin(3*t)", "-0.2*q1*t"], **COMMON, **scheme
    )
    force = fvi.Force(lambda t, q: [np.sin(3 * t), -0.2 * q[1] * t], lambda t, q: [[0, 0], [0, -0.2 * t]])
    functions = fvi.integrate(potential=fvi.Potential(u, du, ddu), force=force, **COMMON, **scheme)
    by_differences = fvi.integrate(potential=fvi.Potential(u, du), force=force.value, **COMMON, **scheme)
    for other in (functions, by_differences):
        assert np.abs(other.q - words.q).max() < 1e-11
        assert np.abs(other.p - words.p).max() < 1e-11
        assert np.abs(other.energy - words.energy).max() < 1e-11


def test_stiffness_and_expressions_and_functions_add():
    all_words = fvi.integrate(potential="q0^2 + 0.5*q1^2 + 0.1*q0^4", **COMMON)
    mixed = fvi.integrate(potential="0.1*q0^4", stiffness=[2.0, 1.0], **COMMON)
    assert np.abs(mixed.q - all_words.q).max() < 1e-12


def test_sparse_matrices_are_matrices():
    sparse = pytest.importorskip("scipy.sparse")
    stiffness = sparse.diags([[-1.0] * 9, [2.0] * 10, [-1.0] * 9], [-1, 0, 1])
    mass = sparse.identity(10, format="csr")
    common = dict(position=np.linspace(0, 1, 10), step=0.05, steps=100)
    one = fvi.integrate(
        mass=mass, stiffness=stiffness, damping=fvi.Damping(0.4, 0.1 * stiffness.tocsr()), **common
    )
    dense = stiffness.toarray()
    other = fvi.integrate(mass=np.eye(10), stiffness=dense, damping=fvi.Damping(0.4, 0.1 * dense), **common)
    assert np.allclose(one.q, other.q, rtol=0, atol=1e-12)
    with pytest.raises(fvi.InputError, match="mass has") as caught:
        fvi.integrate(mass=mass, stiffness=sparse.identity(3), **common)
    assert caught.value.key == "stiffness"


def chain(size, sparse):
    """A chain of masses between two walls, and the frequencies of its modes."""
    stiffness = 2.0 * sparse.identity(size, format="csr") - sparse.eye_array(size, k=1) - sparse.eye_array(size, k=-1)
    modes = np.arange(1, size + 1)
    return sparse.csr_array(stiffness), 2.0 * np.sin(np.pi * modes / (2 * (size + 1)))


def test_large_sparse_systems_stay_sparse_and_move_as_their_modes():
    sparse = pytest.importorskip("scipy.sparse")
    size, mode = 400, 7
    stiffness, frequencies = chain(size, sparse)
    shape = np.sin(np.pi * mode * np.arange(1, size + 1) / (size + 1))
    common = dict(step=0.05, steps=200)
    large = fvi.integrate(
        mass=sparse.identity(size),
        stiffness=stiffness,
        damping=fvi.Damping(0.6, 0.02 * stiffness),
        position=shape,
        coordinates=[0, 250],
        every=10,
        **common,
    )
    assert large.summary["solver"]["kind"] == "sparse"
    assert large.q.shape == large.p.shape == (21, 2) and large.coordinates == [0, 250]
    assert list(large.to_pandas()) == ["q0", "q250", "p0", "p250", "energy"]
    k = frequencies[mode - 1] ** 2
    one = fvi.integrate(mass=[1.0], stiffness=[k], damping=fvi.Damping(0.6, [0.02 * k]), position=[1.0], every=10, **common)
    assert np.abs(large.q - one.q * shape[[0, 250]]).max() < 1e-10
    # Arrays with as many rows are treated in the same way, and by default all coordinates are in the result.
    dense = fvi.integrate(
        mass=np.eye(size), stiffness=stiffness.toarray(), damping=fvi.Damping(0.6, 0.02 * stiffness), position=shape, **common
    )
    assert dense.summary["solver"]["kind"] == "sparse" and dense.q.shape == (201, size)
    assert np.abs(dense.q[::10, [0, 250]] - large.q).max() < 1e-12


def test_dampers_loads_and_elements_act_where_they_are():
    sparse = pytest.importorskip("scipy.sparse")
    for size in (6, 150):
        stiffness, _ = chain(size, sparse)
        damper = sparse.csr_array(([1.0, -1.0], ([0, 1], [0, 0])), shape=(size, 1))
        times = np.linspace(0.0, 10.0, 101)
        common = dict(mass=np.ones(size), position=np.zeros(size), step=0.1, steps=50, coordinates=[0, 1])
        short = fvi.integrate(
            stiffness=stiffness,
            damping=fvi.Damping(0.5, attached=damper, strength=[3.0]),
            loads=[fvi.Load({"coordinate": 0}, "sin(t)"), fvi.Load(np.eye(size)[1], (times, 0.2 * times))],
            elements=fvi.Element("0.1*(x1 - x0)^4", [[0, 1]]),
            **common,
        )
        rho = np.zeros((size, size))
        rho[:2, :2] = [[3.0, -3.0], [-3.0, 3.0]]
        long = fvi.integrate(
            stiffness=stiffness,
            potential="0.1*(q1 - q0)^4",
            damping=fvi.Damping(0.5, rho),
            force=["sin(t)", "0.2*t"] + ["0"] * (size - 2),
            **common,
        )
        assert np.abs(short.q).max() > 0.1 and np.abs(short.q - long.q).max() < 1e-9


def test_grids_and_times_are_arguments():
    common = dict(mass=[1.0], stiffness=[1.0], position=[1.0], damping=fvi.Damping(0.5, [0.3]), scheme="collocation",
                  convolution="radau-iia", stages=3)  # fmt: skip
    graded = fvi.integrate(grid="graded", end=5.0, steps=60, exponent=2.0, **common)
    assert np.allclose(graded.t, 5.0 * (np.arange(61) / 60) ** 2)
    points = fvi.integrate(grid=graded.t, **common)
    assert np.abs(points.q - graded.q).max() < 1e-12
    geometric = fvi.integrate(grid="geometric", end=5.0, first=1e-3, ratio=1.2, longest=0.2, must_hit=[2.5], **common)
    assert 2.5 in geometric.t and np.allclose(geometric.q[-1], graded.q[-1], atol=1e-7)
    times = [0.3, 1.234, 5.0]
    chosen = fvi.integrate(grid="graded", end=5.0, steps=60, exponent=2.0, times=times, **common)
    assert chosen.t.tolist() == times and chosen.q.shape == (3, 1) and np.allclose(chosen.q[-1], graded.q[-1])
    with pytest.raises(fvi.InputError) as caught:
        fvi.integrate(grid=[0.0, 2.0, 1.0], **common)
    assert caught.value.key.startswith("grid")


def test_single_numbers_float32_and_strided_arrays_are_converted():
    exact = fvi.integrate(mass=[1.0, 2.0], position=[0.5, 0.25], stiffness=STIFFNESS, step=0.1, steps=20)
    single = fvi.integrate(
        mass=np.float32([1.0, 2.0]),
        position=np.array([0.5, 9.0, 0.25, 9.0], dtype=np.float32)[::2],
        stiffness=np.asfortranarray(STIFFNESS),
        step=0.1,
        steps=np.int64(20),
    )
    assert np.array_equal(exact.q, single.q)
    assert fvi.integrate(mass=2.0, position=[1.0, 2.0], stiffness=1.0, step=0.1, steps=3).q.shape == (4, 2)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (dict(mass=[1.0, np.nan]), "mass"),
        (dict(mass=[1.0, -2.0]), "mass"),
        (dict(mass=[[1.0, 0.5], [0.4, 2.0]]), "mass"),
        (dict(mass=np.ones((2, 3))), "mass"),
        (dict(mass=np.array([1, None])), "mass"),
        (dict(position=[1.0]), "position"),
        (dict(position=[1.0, np.inf]), "position"),
        (dict(position=["a", "b"]), "position"),
        (dict(momentum=[[1.0, 2.0]]), "momentum"),
        (dict(momentum=[1.0, 2.0], velocity=[1.0, 2.0]), "velocity"),
        (dict(stiffness=np.ones((3, 3))), "stiffness"),
        (dict(stiffness=[[1.0, 2.0], [0.0, 1.0]]), "stiffness"),
        (dict(damping=[fvi.Damping(2.5, [1.0, 1.0])]), "damping[0].order"),
        (dict(damping=[fvi.Damping(0.5, [1.0])]), "damping[0].coefficient"),
        (dict(damping=[fvi.Damping(0.5, [1.0, 1.0], "weyl")]), "damping[0].derivative"),
        (dict(damping=[{"order": 0.5}]), "damping[0]"),
        (dict(damping=[3]), "damping[0]"),
        (dict(damping=[fvi.Damping(0.5, attached=[[1.0], [0.0], [0.0]], strength=[1.0])]), "damping[0].attached"),
        (dict(loads=fvi.Load([1.0], "t")), "loads[0].pattern"),
        (dict(loads=fvi.Load([1.0, 0.0], ([0.0, 1.0], [2.0]))), "loads[0].amplitude"),
        (dict(loads=fvi.Load([1.0, 0.0], ([0.0, 0.0], [2.0, 1.0]))), "loads[0].amplitude[0][1]"),
        (dict(loads=[3]), "loads[0]"),
        (dict(elements=fvi.Element("x1^2", [[0, 5]])), "elements[0].coordinates[0][1]"),
        (dict(elements=fvi.Element("x1^2", [[0.5, 1]])), "elements[0].coordinates[0][0]"),
        (dict(step=None), "step"),
        (dict(times=[0.5, 0.1]), "times"),
        (dict(coordinates=[0, 2]), "coordinates[1]"),
        (dict(potential="q0^2 + q7"), "potential"),
        (dict(potential=u), "potential"),
        (dict(potential=fvi.Potential(u, "du")), "potential.gradient"),
        (dict(potential=fvi.Potential(u, lambda q: [1.0])), "potential.gradient"),
        (dict(potential=fvi.Potential(lambda q: np.nan, du)), "potential"),
        (dict(potential=fvi.Potential(u, lambda q: None)), "potential.gradient"),
        (dict(potential=fvi.Potential(lambda q: None, du)), "potential.value"),
        (dict(force=lambda t: None), "force"),
        (dict(force=lambda t: [1.0, "fast"]), "force"),
        (dict(force=lambda t: [[1.0], [2.0, 3.0]]), "force"),
        (dict(force=lambda t: [1.0, 2.0, 3.0]), "force"),
        (dict(force=[1.0, 2.0]), "force[0]"),
        (dict(force=["t"]), "force"),
        (dict(step=0.0), "step"),
        (dict(step="fast"), "step"),
        (dict(steps=1.5), "steps"),
        (dict(steps=None), "steps"),
        (dict(scheme="rk4"), "scheme"),
        (dict(convolution="radau-iia", stages=9, scheme="galerkin", degree=2), "stages"),
        (dict(engine="none"), "engine"),
        (dict(kapa=0.5), "kapa"),
    ],
)
def test_what_cannot_be_used_is_named(change, key):
    with pytest.raises(fvi.InputError) as caught:
        fvi.integrate(**(COMMON | change))
    assert caught.value.key == key, caught.value


def test_an_exception_in_a_function_arrives_with_its_traceback_and_the_rows_so_far():
    def breaks(t):
        if t > 1.0:
            raise ZeroDivisionError("the drive has gone")
        return [0.0, 0.0]

    with pytest.raises(ZeroDivisionError, match="the drive has gone") as caught:
        fvi.integrate(stiffness=STIFFNESS, force=breaks, **COMMON)
    assert any(frame.name == "breaks" for frame in traceback.extract_tb(caught.value.__traceback__))
    result = caught.value.result
    assert result.status == -1 and result.t[-1] == pytest.approx(1.0)
    undisturbed = fvi.integrate(stiffness=STIFFNESS, force=lambda t: [0.0, 0.0], **COMMON)
    assert np.array_equal(result.q, undisturbed.q[: len(result.t)])


def test_an_exception_at_the_start_arrives_before_anything_is_computed():
    def breaks(q):
        raise LookupError("no table")

    with pytest.raises(LookupError, match="no table"):
        fvi.integrate(potential=fvi.Potential(u, breaks), **COMMON)


def test_numbers_that_are_none_fail_the_step():
    with pytest.raises(fvi.StepError) as caught:
        fvi.integrate(stiffness=STIFFNESS, force=lambda t: [np.nan if t > 2.0 else 0.0, 0.0], **COMMON)
    assert caught.value.result.t[-1] == pytest.approx(2.0)


@pytest.mark.parametrize(
    "answer",
    [[0.0j, 1.0 + 0.5j], np.array([0.0, 1.0j]), np.ma.masked_array([0.0, 1.0], [False, True])],
    ids=["list of complex numbers", "complex array", "masked array"],
)
def test_no_part_of_what_a_function_returns_is_dropped(answer):
    with pytest.raises(fvi.InputError, match=r"^force.*(complex128|masked)") as caught:
        fvi.integrate(stiffness=STIFFNESS, force=lambda t: answer, **COMMON)
    assert caught.value.key == "force"


def test_parameters_with_defaults_are_a_functions_own():
    plain = fvi.integrate(stiffness=STIFFNESS, force=["0.5*sin(t)", "2*q0"], **COMMON)
    # As functions in a loop are written; the default argument is not taken for the position.
    time_alone = fvi.integrate(stiffness=STIFFNESS, force=lambda t, a=0.5: [a * np.sin(t), 0.0], **COMMON)
    assert np.allclose(
        time_alone.q, fvi.integrate(stiffness=STIFFNESS, force=["0.5*sin(t)", "0"], **COMMON).q, rtol=0.0, atol=1e-12
    )
    for force in (
        lambda t, q, a=0.5: [a * np.sin(t), 2.0 * q[0]],
        lambda *arguments: [0.5 * np.sin(arguments[0]), 2.0 * arguments[1][0]],
    ):
        assert np.allclose(fvi.integrate(stiffness=STIFFNESS, force=force, **COMMON).q, plain.q, rtol=0.0, atol=1e-9)


def test_functions_may_return_numbers_of_other_kinds():
    from fractions import Fraction

    plain = fvi.integrate(stiffness=STIFFNESS, force=lambda t: [0.5, 2.0], **COMMON)
    for answer in ([Fraction(1, 2), Fraction(2)], np.array([0.5, 2.0], dtype=np.float32), (0.5, 2)):
        other = fvi.integrate(stiffness=STIFFNESS, force=lambda t, answer=answer: answer, **COMMON)
        assert np.array_equal(other.q, plain.q)


def test_a_force_in_code_that_drives_is_no_growth_from_nothing():
    r = fvi.integrate(mass=[1.0], position=[0.0], stiffness=[1.0], force=lambda t: [50.0 * np.sin(t)], step=0.02, end=40.0)
    assert r.success and r.energy[-1] > 1e4


def test_jumps_at_grid_points_are_seen_from_inside_the_step():
    common = dict(mass=[1.0], position=[0.0], stiffness=[1.0], step=0.1, steps=20, scheme="low-order", kappa=0.0)
    words = fvi.integrate(force=["8*step(1 - t)"], **common)
    code = fvi.integrate(force=lambda t: [8.0 * (1 - t >= 0)], **common)
    assert np.abs(words.q - code.q).max() < 1e-13


def test_single_precision_takes_functions():
    double = fvi.integrate(potential=fvi.Potential(u, du, ddu), **COMMON)
    single = fvi.integrate(potential=fvi.Potential(u, du, ddu), precision="f32", **COMMON)
    assert 0 < np.abs(double.q - single.q).max() < 1e-3


def test_steps_follow_a_tolerance():
    common = dict(mass=[1.0], stiffness=[1.0], position=[1.0], scheme="collocation", grid="adaptive", end=10.0)
    errors, steps = [], []
    for tolerance in (1e-4, 1e-6, 1e-8):
        r = fvi.integrate(tolerance=tolerance, **common)
        assert r.success and r.t[-1] == 10.0
        assert r.summary["scenario"]["time"]["tolerance"] == tolerance
        errors.append(np.abs(r.q[:, 0] - np.cos(r.t)).max() / tolerance)
        steps.append(r.summary["steps"])
    assert max(errors) < 10.0 and steps[0] < steps[1] < steps[2] < 400
    # With damping that starts singularly the first step is short, and no step longer than asked for.
    damped = fvi.integrate(damping=fvi.Damping(0.5, [1.0]), tolerance=1e-8, longest=0.1, **common)
    lengths = np.diff(damped.t)
    assert lengths[0] < 1e-3 and lengths.max() <= 0.1 * (1 + 1e-12)
    same = fvi.run(damped.summary["scenario"])
    assert np.array_equal(same.q, damped.q)
    # Of an engine, without such a grid.
    assert fvi.integrate(mass=[1.0], position=[1.0], step=0.1, steps=10, tolerance=None).success
    with pytest.raises(fvi.InputError) as caught:
        fvi.integrate(tolerance=1e-15, **common)
    assert caught.value.key == "tolerance"


def test_events_are_found_and_end_runs():
    common = dict(mass=[1.0], stiffness=[1.0], position=[1.0], scheme="collocation", convolution="radau-iia", stages=3)
    zeros = fvi.Event("q0")
    r = fvi.integrate(step=0.1, end=10.0, events=[zeros, {"when": "p0", "direction": "falling"}], **common)
    times = [event["time"] for event in r.events if event["event"] == 0]
    assert np.allclose(times, np.pi * (np.arange(3) + 0.5), atol=1e-6)
    assert [event["rising"] for event in r.events if event["event"] == 0] == [False, True, False]
    crests = [event["time"] for event in r.events if event["event"] == 1]
    assert np.allclose(crests, 2.0 * np.pi * np.arange(1, len(crests) + 1), atol=1e-6)
    assert all(abs(event["position"][0]) < 1e-12 for event in r.events if event["event"] == 0)
    stopped = fvi.integrate(step=0.1, end=10.0, events=fvi.Event("q0", "rising", "stop"), **common)
    assert stopped.success and stopped.status == 0 and "event 0" in stopped.message
    assert stopped.t[-1] == stopped.events[0]["time"] and abs(stopped.t[-1] - 1.5 * np.pi) < 1e-6
    assert fvi.integrate(step=0.1, end=1.0, **common).events == []
    for events, key in [
        (fvi.Event("q1"), "events[0].when"),
        (fvi.Event("q0", "up"), "events[0].direction"),
        ([zeros, "q0"], "events[1]"),
    ]:
        with pytest.raises(fvi.InputError) as caught:
            fvi.integrate(step=0.1, end=1.0, events=events, **common)
        assert caught.value.key == key, caught.value


@pytest.mark.parametrize("step", [0.1, 0.125, 0.01])
def test_an_event_at_a_grid_point_adds_no_second_row(step: float) -> None:
    r = fvi.integrate(
        mass=[1.0], stiffness=[1.0], position=[0.0], velocity=[1.0], step=step, end=2.0, events=fvi.Event("t - 1", action="stop")
    )
    assert r.t[-1] == 1.0 and np.all(np.diff(r.t) > 0.0)
    assert abs(r(1.0)[0] - np.sin(1.0)) < step**2 and np.all(np.abs(r.a + r.q) < 0.1 * step)


def test_accelerations_beside_an_event_inside_of_a_step() -> None:
    keys = dict(mass=[1.0], stiffness=[1.0], position=[0.0], velocity=[1.0], step=0.01, steps=200)
    r = fvi.integrate(**keys, events=fvi.Event("q0 - 0.2", action="stop"))
    assert np.abs(r.a + r.q).max() < 1e-5
    # Velocities inside of steps are of a lower order.
    times = np.arange(0.0, 1.0, 0.013)
    with pytest.raises(fvi.InputError, match="grid points"):
        fvi.integrate(**keys, times=times).a
    between = fvi.integrate(**keys, times=times, scheme="galerkin", degree=3)
    assert np.abs(between.a + between.q).max() < 1e-5


def test_what_a_function_raises_is_the_message() -> None:
    def gradient(q: np.ndarray) -> np.ndarray:
        if q[0] < 0.9:
            raise ArithmeticError("mine")
        return q

    with pytest.raises(ArithmeticError, match="mine") as caught:
        fvi.integrate(mass=[1.0], position=[1.0], step=0.05, steps=40, potential=fvi.Potential(lambda q: 0.5 * q[0] ** 2, gradient))
    assert "ArithmeticError in a function" in caught.value.result.message


def test_derivatives_that_are_no_numbers_are_named() -> None:
    keys = dict(mass=[1.0], position=[1.0], step=0.05, steps=4)
    with pytest.raises(fvi.InputError, match="hessian") as caught:
        fvi.integrate(**keys, potential=fvi.Potential(lambda q: q[0] ** 2, lambda q: 2.0 * q, lambda q: [[np.nan]]))
    assert caught.value.key == "potential.hessian"
    with pytest.raises(fvi.InputError, match="force.jacobian"):
        fvi.integrate(**keys, force=fvi.Force(lambda t, q: -q, lambda t, q: [[np.nan]]))


def test_events_that_return_truth_values_are_refused() -> None:
    with pytest.raises(fvi.InputError, match="truth value"):
        fvi.integrate(mass=[1.0], stiffness=[1.0], position=[1.0], step=0.1, steps=20, events=fvi.Event(lambda t, q: q[0] > 0.5))


def test_misspelt_arguments_are_told_by_what_was_meant() -> None:
    for call, meant in [
        (lambda: fvi.solve_fde(["-x0"], 0.5, 1.0, [1.0], rtoll=1e-6), "rtol"),
        (lambda: fvi.System(mass=[1.0], stifness=[1.0]), "stiffness"),
        (lambda: fvi.Damping(ordr=0.5, coefficient=[1.0]), "order"),
        (lambda: fvi.Event("q0", directions="rising"), "direction"),
        (lambda: fvi.Memory(exponent=0.5, step=0.1, channel=2), "channels"),
        (lambda: fvi.Operator(exponnt=0.5, step=0.1), "exponent"),
        (lambda: fvi.Convolver([1.0], latncy=0), "latency"),
        (lambda: fvi.weights(exponent=0.5, step=0.1, cont=3), "count"),
        (lambda: fvi.exponentials(exponent=0.5, stepp=0.1), "step"),
        (lambda: fvi.sweep({}, job=2), "jobs"),
        (lambda: fvi.tune({}, override={}), "overrides"),
        (lambda: fvi.extremal({}, override={}), "overrides"),
    ]:
        with pytest.raises(TypeError, match=f"did you mean {meant}"):
            call()  # type: ignore[no-untyped-call]
