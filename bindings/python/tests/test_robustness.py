"""Misuse and unusual conditions."""

import copy
import multiprocessing
import pickle
import threading

import numpy as np
import pytest

import fvi
from test_integrate import COMMON, STIFFNESS, ddu, du, u
from test_run import GROWING, PENDULUM


def test_results_and_errors_survive_pickling():
    result = fvi.run(PENDULUM)
    again = pickle.loads(pickle.dumps(result))
    assert np.array_equal(again.q, result.q) and again.summary == result.summary and again.message == result.message
    with pytest.raises(fvi.StepError) as caught:
        fvi.run(GROWING)
    error = pickle.loads(pickle.dumps(caught.value))
    assert str(error) == str(caught.value) and np.array_equal(error.result.t, caught.value.result.t)
    with pytest.raises(fvi.InputError) as caught:
        fvi.run(PENDULUM, step=-1)
    error = pickle.loads(pickle.dumps(caught.value))
    assert (str(error), error.key, error.value) == (str(caught.value), "time.step", "-1")
    table = pickle.loads(pickle.dumps(fvi.Table([{"a": 1.0}, {"a": 2.0}])))
    assert table["a"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("engine", ["direct", "block-fft", "real-time", "exponential-sum"])
def test_memories_and_operators_are_copied_with_their_state(engine):
    m = fvi.Memory(exponent=0.5, step=0.1, channels=2, length=50, engine=engine)
    operator = fvi.Operator(exponent=1.5, step=0.1, start="caputo", slope=0.25, length=50, engine=engine)
    for k in range(20):
        m.push([k, -1.0])
        operator.push(float(k * k))
    for other, second in ((copy.deepcopy(m), copy.deepcopy(operator)), pickle.loads(pickle.dumps((m, operator)))):
        assert np.array_equal(other.next_term(), m.next_term()) and len(other) == 20
        assert second.push(400.0) == copy.copy(operator).push(400.0)


@pytest.mark.parametrize("broken", ["value", "gradient", "hessian", "force", "jacobian"])
@pytest.mark.parametrize("at", [1, 2, 3, 7, 100])
def test_an_exception_in_any_call_reaches_the_caller(broken, at):
    class Broken(Exception):
        pass

    calls = 0

    def breaking(function):
        def called(*arguments):
            nonlocal calls
            calls += 1
            if calls == at:
                raise Broken
            return function(*arguments)

        return called

    functions = dict(value=u, gradient=du, hessian=ddu)
    forces = dict(value=lambda t, q: -0.1 * q, jacobian=lambda t, q: [[-0.1, 0.0], [0.0, -0.1]])
    if broken in functions:
        functions[broken] = breaking(functions[broken])
    else:
        forces["value" if broken == "force" else "jacobian"] = breaking(forces["value" if broken == "force" else "jacobian"])
    with pytest.raises(Broken) as caught:
        fvi.integrate(potential=fvi.Potential(**functions), force=fvi.Force(**forces), **COMMON)
    result = getattr(caught.value, "result", None)
    assert calls == at and (result is None or np.isfinite(result.q).all())


@pytest.mark.parametrize(
    "answer",
    [None, "text", [1.0], [1.0, 2.0, 3.0], [[1.0], 2.0], 1.0, [1.0, "b"], [1j, 0], np.ones((2, 2)), object(), {}, b"ab"],
    ids=repr,
)
def test_answers_that_are_none_are_refused_whatever_they_are(answer):
    late = iter(range(10**9))
    with pytest.raises((fvi.InputError, TypeError, ValueError)):
        # Right at first, so that the run has begun.
        fvi.integrate(potential=fvi.Potential(u, lambda q: du(q) if next(late) < 50 else answer), **COMMON)
    with pytest.raises((fvi.InputError, TypeError, ValueError)):
        fvi.integrate(potential=fvi.Potential(u, lambda q: answer), **COMMON)


def test_answers_may_be_anything_that_numpy_makes_numbers_of():
    expected = fvi.integrate(potential=fvi.Potential(u, du, ddu), **COMMON)
    for kind in (list, tuple, lambda a: a[::-1][::-1], np.float32, np.asfortranarray, lambda a: np.repeat(a, 2, axis=-1)[..., ::2]):
        got = fvi.integrate(potential=fvi.Potential(u, lambda q: kind(du(q)), lambda q: kind(ddu(q))), **COMMON)
        assert np.abs(got.q - expected.q).max() < (1e-4 if kind is np.float32 else 1e-12)


def test_functions_that_keep_or_change_what_they_are_given_harm_nobody():
    expected = fvi.integrate(potential=fvi.Potential(u, du, ddu), **COMMON)
    kept = []

    def gradient(q):
        answer = du(q)
        kept.append((q, q.copy()))
        return answer

    def hessian(q):
        answer = ddu(q)
        q[:] = np.nan
        return answer

    got = fvi.integrate(potential=fvi.Potential(u, gradient, hessian), **COMMON)
    assert np.array_equal(got.q, expected.q)
    assert all(np.array_equal(q, copied) for q, copied in kept)


def test_functions_may_call_the_package():
    inner = []

    def force(t):
        inner.append(fvi.run(PENDULUM, steps=3).q[-1, 0])
        return [0.0, 0.0]

    r = fvi.integrate(stiffness=STIFFNESS, force=force, **(COMMON | {"steps": 5}))
    assert r.success and len(set(inner)) == 1


def test_one_object_in_many_threads():
    m = fvi.Memory(exponent=0.5, step=0.1, length=8001)
    failures = []

    def push():
        try:
            for _ in range(1000):
                m.push(1.0)
                m.next_term()
        except Exception as error:
            failures.append(error)

    threads = [threading.Thread(target=push) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures and len(m) == 8000


def _square(order):
    return fvi.run(PENDULUM, overrides={"system.damping[0].order": order}).q[-1, 0]


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_processes_of_multiprocessing_get_the_same_bits(method):
    orders = [0.3, 0.9, 1.4]
    with multiprocessing.get_context(method).Pool(2) as pool:
        assert pool.map(_square, orders) == [_square(order) for order in orders]


def _many_channels(_):
    memory = fvi.Memory(exponent=0.5, step=0.1, channels=20_000, length=100, engine="exponential-sum")
    for k in range(70):
        memory.push(np.sin(0.1 * k + np.arange(20_000)))
    return memory.next_term()[::999].tolist()


def test_a_forked_process_has_threads_of_its_own():
    # The parent has threads that share the work; after the fork only their names exist.
    expected = _many_channels(None)
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map_async(_many_channels, range(2)).get(timeout=120) == [expected, expected]


@pytest.mark.parametrize(
    "call",
    [
        lambda: fvi.run(PENDULUM, steps=10**15),
        lambda: fvi.weights(exponent=0.5, step=0.1, count=10**15),
        lambda: fvi.weights(exponent=0.5, step=0.1, count=10**12, family="radau-iia", stages=3),
        lambda: fvi.Memory(exponent=0.5, step=0.1, length=10**14, engine="block-fft"),
        lambda: fvi.Memory(exponent=0.5, step=0.1, channels=10**9, length=10**6, engine="direct"),
        lambda: fvi.Memory(exponent=0.5, step=0.1, channels=10**12, length=10),
        lambda: fvi.Memory(exponent=0.5, step=0.1, channels=10**9, family="radau-iia", stages=2),
        lambda: fvi.compare_engines([10**13]),
        lambda: fvi.converge(PENDULUM, (4, 40)),
    ],
)
def test_huge_requests_are_refused_at_once(call):
    with pytest.raises((MemoryError, fvi.InputError)):
        call()


def test_huge_numbers_are_no_way_in():
    for steps in (2**63, 2**64, -1, 10**30):
        with pytest.raises(fvi.InputError):
            fvi.integrate(mass=[1.0], position=[1.0], step=0.1, steps=steps)
    for count in (2**63, 2**70, -5):
        with pytest.raises(fvi.InputError):
            fvi.weights(exponent=0.5, step=0.1, count=count)
    with pytest.raises(fvi.InputError) as caught:
        fvi.run(PENDULUM, overrides={"history.horizon": 10**30})
    assert caught.value.key == "history.horizon"


def test_texts_and_the_order_of_keys_arrive_as_they_are():
    title = 'quotes " and \\ backslashes, \t \x7f \x00 controls, ünï∂e 🎲 = [x] # no comment'
    assert fvi.run(PENDULUM, title=title).title == title
    parameters = {"zeta": 1.0, "alpha": 2.0, "m": 3, "k": 1e-300, "big": 1e300, "x1": -0.0}
    common = dict(mass=[1.0], position=[1.0], step=0.1, steps=3)
    words = fvi.integrate(potential="0.5*(alpha + m)*q0^2 + k*big*zeta*q0^4", parameters=parameters, **common)
    numbers = fvi.integrate(potential="2.5*q0^2 + 1e-300*1e300*q0^4", **common)
    assert np.abs(words.q - numbers.q).max() < 1e-14
    axes = {"initial.position[0]": [1.0, 2.0], "time.step": {"from": 0.1, "to": 0.2, "count": 2}, "title": ["a", "b"]}
    table = fvi.sweep({"axes": axes, "scenario": PENDULUM | {"time": {"step": 0.1, "steps": 3}}})
    assert list(table)[1:4] == list(axes)
    assert table["title"].tolist() == ["a", "b"] * 4 and table["initial.position[0]"].tolist() == [1.0] * 4 + [2.0] * 4


def test_jacobians_are_read_row_by_row_however_they_lie_in_memory():
    rate = np.array([[0.0, -0.4], [0.3, 0.0]])
    words = fvi.integrate(stiffness=STIFFNESS, force=["-0.4*q1", "0.3*q0"], **COMMON)
    kinds = (np.ascontiguousarray, np.asfortranarray, np.ndarray.tolist, lambda a: np.repeat(a, 2, axis=0)[::2])
    iterations = set()
    for kind in kinds:
        force = fvi.Force(lambda t, q: rate @ q, lambda t, q: kind(rate))
        r = fvi.integrate(stiffness=STIFFNESS, force=force, **COMMON)
        assert np.abs(r.q - words.q).max() < 1e-12
        iterations.add(r.summary["newton_iterations"])
    # A wrong Jacobian would need more iterations.
    assert len(iterations) == 1


@pytest.mark.parametrize(
    "call, key",
    [
        (lambda missing: fvi.derivative(missing, order=0.5, step=0.1), "x"),
        (lambda missing: fvi.integrate(mass=[1.0, 1.0], position=missing, step=0.1, steps=3), "position"),
        (lambda missing: fvi.integrate(mass=missing, position=0.0, step=0.1, steps=3), "mass"),
        (lambda missing: fvi.Memory(exponent=0.5, step=0.1, channels=2).push(missing), "sample"),
    ],
)
def test_a_number_that_is_masked_is_none(call, key):
    with pytest.raises(fvi.InputError) as caught:
        call(np.ma.array([1.0, 2.0], mask=[False, True]))
    assert caught.value.key == key
    call(np.ma.array([1.0, 2.0]))


@pytest.mark.parametrize("key", ["damping", "loads", "elements", "events"])
@pytest.mark.parametrize("given", [0.5, "text"])
def test_what_is_no_list_is_named(key, given):
    with pytest.raises(fvi.InputError) as caught:
        fvi.integrate(mass=[1.0], position=[1.0], step=0.1, steps=3, **{key: given})
    assert caught.value.key == key


def test_axes_and_levels_are_whole_numbers():
    samples = np.ones((3, 4))
    for axis in (1.0, (0, 1), None):
        with pytest.raises(fvi.InputError) as caught:
            fvi.derivative(samples, order=0.5, step=0.1, axis=axis)
        assert caught.value.key == "axis"
    for levels in (3, (3,), (3, 4, 5), (3.0, 4.0)):
        with pytest.raises(fvi.InputError) as caught:
            fvi.converge(PENDULUM, levels)
        assert caught.value.key == "levels"
