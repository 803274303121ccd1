"""Fractional differential equations by `solve_fde`: known solutions, functions as expressions, events, and what is refused."""

import math

import numpy as np
import pytest

import fvi


def relaxation(t):
    """E_½(−√t), the solution of D^½ x = −x from 1."""
    return math.exp(t) * math.erfc(math.sqrt(t))


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("right", [["-x0"], "-x0", lambda t, x: -x, lambda t, x: [-float(x[0])]])
def test_the_error_follows_the_tolerance(right, rtol):
    times = [0.0, 1e-4, 0.1, 1.0, 5.0]
    r = fvi.solve_fde(right, 0.5, (0, 5), [1.0], rtol=rtol, t_eval=times)
    assert r.success and r.status == 0 and r.x.shape == (5, 1)
    np.testing.assert_array_equal(r.t, times)
    assert np.max(np.abs(r.x[:, 0] - [relaxation(t) for t in times])) < 10 * rtol


def test_functions_give_what_expressions_give():
    # x0 = 1 + t, x1 = t^1.5: orders of their own, and arguments of the functions.
    half = math.gamma(2.5) / math.gamma(2.0)

    def right(t, x, k):
        return [k * (t**1.5 - x[1]) + t**0.5 / math.gamma(1.5), half * (x[0] - 1.0)]

    def slopes(t, x, k):
        return [[0.0, -k], [half, 0.0]]

    texts = ["k*(t^1.5 - x1) + t^0.5/gamma(1.5)", "h*(x0 - 1)"]
    by_text = fvi.solve_fde(texts, [0.5, 0.5], 3.0, [1.0, 0.0], 1e-9, parameters={"k": 2.0, "h": half})
    for jac in (None, slopes):
        by_function = fvi.solve_fde(right, [0.5, 0.5], 3.0, [1.0, 0.0], 1e-9, args=(2.0,), jac=jac)
        assert abs(by_function.x[-1] - by_text.x[-1]).max() < 1e-8
    assert abs(by_text.x[:, 0] - 1 - by_text.t).max() < 1e-8


def test_orders_above_one_and_terms():
    # x'' + D^1.5 x + x = 1 + t has the solution 1 + t.
    for right in (["1 + t"], lambda t, x: 1 + t):
        for terms in ([(2, 1), (1.5, 1), (0, 1)], [[{"order": 2, "coefficient": 1}, (1.5, 1), (0, 1)]]):
            r = fvi.solve_fde(right, None, 10, [1.0, 1.0], 1e-9, terms=terms)
            assert r.x.shape[1] == 1 and abs(r.x[:, 0] - 1 - r.t).max() < 1e-8
    r = fvi.solve_fde(lambda t, x: -x, 2, (0, 3), [[1.0, 0.0]], 1e-9)
    assert abs(r.x[:, 0] - np.cos(r.t)).max() < 1e-8
    assert r.summary["equation" if "equation" in r.summary else "scenario"]["equation"]["order"] == [2.0]


def test_large_right_sides_begin_with_short_steps():
    size = 1e6
    r = fvi.solve_fde(lambda t, x: size - x, 0.5, 5.0, [0.0], 1e-8, t_eval=[1e-6, 1.0, 5.0])
    assert r.success
    assert max(abs(r.x[:, 0] - [size * (1 - relaxation(t)) for t in r.t])) < 1e-7 * size


def test_another_start_moves_the_time():
    late = fvi.solve_fde(lambda t, x: t - 3.0 - x, 0.7, (3.0, 5.0), [0.5], 1e-9, t_eval=[3.0, 4.0, 5.0])
    early = fvi.solve_fde(["t - x0"], 0.7, (0.0, 2.0), [0.5], 1e-9, t_eval=[0.0, 1.0, 2.0])
    np.testing.assert_array_equal(late.t, [3.0, 4.0, 5.0])
    assert abs(late.x - early.x).max() < 1e-9
    with pytest.raises(fvi.InputError) as error:
        fvi.solve_fde(["t - x0"], 0.7, (3.0, 5.0), [0.5])
    assert error.value.key == "span[0]"


def test_events_are_those_of_solve_ivp():
    def half(t, x, k):
        return x[0] - 0.5

    half.terminal, half.direction = True, -1
    r = fvi.solve_fde(lambda t, x, k: -k * x, 0.5, (0, 5), [1.0], 1e-9, args=(1.0,), events=[half, fvi.Event("x0 - 0.8")])
    assert r.success and r.status == 1 and "event 0" in r.message
    (at,), (value,) = r.t_events[0], r.x_events[0]
    assert abs(relaxation(at) - 0.5) < 1e-8 and abs(value[0] - 0.5) < 1e-12 and r.t[-1] == at
    assert len(r.t_events[1]) == 1
    half.terminal = 3
    with pytest.raises(fvi.InputError, match="not counted") as error:
        fvi.solve_fde(lambda t, x, k: -k * x, 0.5, (0, 5), [1.0], 1e-9, args=(1.0,), events=half)
    assert error.value.key == "events[0].terminal"


def test_a_blow_up_is_a_message_with_its_time():
    r = fvi.solve_fde(["x0^2"], 1.0, (0, 5), [1.0], 1e-8)
    assert not r.success and r.status == -1 and "grows without bound" in r.message and "0.99999" in r.message
    assert r.x[-1, 0] > 1e6


def test_exceptions_pass_with_what_was_computed():
    class Stop(Exception):
        pass

    def right(t, x):
        if t > 0.5:
            raise Stop("enough")
        return -x

    with pytest.raises(Stop) as error:
        fvi.solve_fde(right, 0.5, 1.0, [1.0])
    assert error.value.result.t[-1] <= 0.5


@pytest.mark.parametrize(
    ("arguments", "key"),
    [
        ({"order": 0.0}, "order"),
        ({"order": [0.5, -1.0]}, "order"),
        ({"order": 1.5}, "initial"),
        ({"rtol": 1e-15}, "rtol"),
        ({"span": (1.0, 0.5)}, "span"),
        ({"span": -1.0}, "span"),
        ({"right": ["-x1"]}, "right[0]"),
        ({"right": [lambda t, x: x]}, "right[0]"),
        ({"right": lambda t, x: [1.0, 2.0]}, "right"),
        ({"right": lambda t, x: math.nan}, "right"),
        ({"initial": [math.nan]}, "initial[0]"),
        ({"t_eval": [0.0, 2.0]}, "t_eval"),
        ({"order": None}, "order"),
        ({"events": "x0"}, "events[0]"),
        ({"derivative": "riemann-liouville"}, "initial"),
        ({"jac": lambda t, x: 1.0}, "jac"),
    ],
)
def test_what_cannot_be_used_is_refused_by_its_name(arguments, key):
    with pytest.raises(fvi.InputError) as error:
        fvi.solve_fde(**{"right": ["-x0"], "order": 0.5, "span": 1.0, "initial": [1.0], **arguments})
    assert error.value.key.startswith(key), (error.value.key, str(error.value))
    assert "equation." not in str(error.value) and "mass" not in str(error.value)


def test_scenarios_with_an_equation_run_too(tmp_path):
    scenario = {"equation": {"order": 1.5, "right": ["-x0"], "initial": [[1.0, 0.0]]}, "time": {"end": 2.0}}
    r = fvi.run(scenario)
    kept = fvi.run(scenario, out=tmp_path / "out")
    assert r.q.shape[1] == 1
    np.testing.assert_array_equal(r.q, kept.q)
    np.testing.assert_array_equal(r.q, fvi.load(tmp_path / "out").q)


def test_right_sides_take_derivatives_of_lower_orders():
    # x = 1 + t^1.5: D^0.5 x = Γ(2.5) t, x' = 1.5 √t, D^1.2 x = Γ(2.5)/Γ(1.3) t^0.3.
    g, k = math.gamma(2.5), math.gamma(2.5) / math.gamma(1.3)

    def right(t, x, d, g):
        half, slope = d
        return k * t**0.3 + x * (half - g * t) - (slope**2 - 2.25 * t)

    def slopes(t, x, d, g):
        return [[d[0] - g * t, x[0], -2 * d[1]]]

    text = "k*t^0.3 + x0*(half - g*t) - (slope^2 - 2.25*t)"
    names = {"half": (0, 0.5), "slope": {"of": "x0", "order": 1}}
    known = {"parameters": {"g": g, "k": k}}
    runs = [fvi.solve_fde(text, 1.2, 2.0, [1.0, 0.0], 1e-9, derivatives=names, **known)]
    for jac in (None, slopes):
        for derivatives in (names, [(0, 0.5), ("x0", 1.0)]):
            runs.append(fvi.solve_fde(right, 1.2, 2.0, [1.0, 0.0], 1e-9, args=(g,), jac=jac, derivatives=derivatives))
    for r in runs:
        assert r.success and r.x.shape[1] == 1 and abs(r.x[:, 0] - 1 - r.t**1.5).max() < 1e-8


@pytest.mark.parametrize(
    "derivatives, key",
    [
        ({"w": (0, 1.5)}, "derivatives.w.order"),
        ({"w": (1, 0.5)}, "derivatives.w.of"),
        ({"w": (-1, 0.5)}, "derivatives['w']"),
        ({"x0": (0, 0.5)}, "derivatives.x0"),
        ({"w": 0.5}, "derivatives['w']"),
        ([(0, 0.5)], "derivatives"),
    ],
)
def test_derivatives_that_cannot_be_are_refused(derivatives, key):
    with pytest.raises(fvi.InputError) as caught:
        fvi.solve_fde("-x0", 1.5, 1.0, [1.0, 0.0], derivatives=derivatives)
    assert caught.value.key == key


def test_functions_of_derivatives_return_a_number_for_each_unknown():
    with pytest.raises(fvi.InputError, match="2 numbers instead of 1"):
        fvi.solve_fde(lambda t, x, d: [1.0, 2.0], 1.5, 1.0, [1.0, 0.0], derivatives=[(0, 0.5)])


@pytest.mark.parametrize(
    "key, arguments",
    [
        ("order", {"order": [[0.5]]}),
        ("initial[0]", {"order": 1.5, "initial": [[[1.0, 2.0]]]}),
        ("right", {"right": None}),
        ("right", {"right": 5}),
        ("args", {"right": lambda t, x: -x, "args": 1.0}),
        ("args", {"args": (1.0,)}),
        ("t_eval", {"t_eval": [[0.5]]}),
        ("t_eval", {"t_eval": 0.5}),
        ("jac", {"right": lambda t, x: -x, "jac": "x"}),
        ("events", {"events": 5}),
        ("events", {"events": lambda t, x: math.nan}),
        ("terms", {"order": None, "terms": 5}),
        ("terms", {"order": None, "terms": [5]}),
        ("terms[0][0]", {"right": lambda t, x: [1e9], "order": None, "terms": [{"coefficient": 1}]}),
        ("parameters", {"parameters": [1]}),
        ("parameters.k", {"parameters": {"k": "a"}}),
        ("max_step", {"max_step": math.nan}),
        ("derivative", {"derivative": None}),
        ("derivatives[0].order", {"right": lambda t, x, d: -x, "derivatives": [(0, 0.6)]}),
        ("derivatives[0]['order']", {"right": lambda t, x, d: -x, "derivatives": [{"of": "x0", "order": "a"}]}),
    ],
)
def test_what_no_argument_can_be_is_refused_by_its_name(key, arguments):
    with pytest.raises(fvi.InputError) as caught:
        fvi.solve_fde(**{"right": "-x0", "order": 0.5, "span": 1.0, "initial": [1.0], **arguments})
    assert caught.value.key == key


def test_roots_of_sizes_and_growing_perturbations_as_in_scenarios():
    # x = t^1.6 − 1 passes 0 at t = 1, where the slope of the right side is infinite.
    root = "gamma(2.6)/gamma(2)*t - sign(x0)*abs(x0)^0.5 + sign(t^1.6 - 1)*abs(t^1.6 - 1)^0.5"
    for rtol in (1e-3, 1e-6, 1e-9):
        r = fvi.solve_fde(root, 0.6, 2.0, [-1.0], rtol)
        assert r.success and abs(r.x[:, 0] - (r.t**1.6 - 1)).max() < 20 * rtol
    with pytest.warns(match="grown"):
        r = fvi.solve_fde("gamma(2.5)*t + 5*(x0 - 1 - t^1.5)", 0.5, 0.6, [1.0], 1e-9)
    assert len(r.warnings) == 1


def test_times_are_those_of_the_caller() -> None:
    def right(t: float, x: np.ndarray) -> np.ndarray:
        return -x

    for event in (lambda t, x: t - 1.5, fvi.Event(lambda t, x: t - 1.5), fvi.Event("t - 1.5")):
        found = fvi.solve_fde(right, 0.6, (1.0, 3.0), [1.0], events=event).t_events
        assert found[0] == pytest.approx([1.5])
    ends = fvi.solve_fde(lambda t, x: x**2, 1.0, (10.0, 14.0), [1.0])
    assert not ends.success and "t = 11" in ends.message
    with pytest.raises(fvi.InputError, match=r"t_eval\[0\] = 0.5.*1 ≤ t ≤ 2"):
        fvi.solve_fde(right, 0.5, (1.0, 2.0), [1.0], t_eval=[0.5, 1.5])
    late = fvi.solve_fde(right, 0.3, (1.7, 4.7), [1.0], rtol=1e-10)
    assert late.t[0] == 1.7 and late.x[0, 0] == 1.0 and np.all(np.diff(late.t) > 0.0)


def test_a_jacobian_that_is_no_number_is_refused() -> None:
    with pytest.raises(fvi.InputError, match="jac"):
        fvi.solve_fde(lambda t, x: [-x[0] ** 3, x[0] - x[1]], 0.5, 1.0, [1.0, 2.0], jac=lambda t, x: np.full((2, 2), np.nan))


def test_functions_that_jump_keep_the_tolerance_wherever_they_jump():
    def exact(t, at):
        return np.exp(-t) + 3.0 * np.where(t > at, -np.expm1(at - t), 0.0)

    for at in np.random.default_rng(9).uniform(0.1, 1.9, 25):
        r = fvi.solve_fde(lambda t, x: -x + 3.0 * (t > at), 1.0, 2.0, [1.0], rtol=1e-8)
        assert r.success and np.abs(r.x[:, 0] - exact(r.t, at)).max() < 1e-7


def test_steps_end_where_a_function_is_said_to_bend():
    # D^½ x = (t − ½)₊ has x = (t − ½)^{3/2}/Γ(5/2) behind the kink.
    def bent(t, x):
        return [max(t - 0.5, 0.0)]

    r = fvi.solve_fde(bent, 0.5, (0.0, 2.0), [0.0], rtol=1e-9, must_hit=[0.5])
    assert 0.5 in r.t
    assert np.abs(r.x[:, 0] - np.maximum(r.t - 0.5, 0.0) ** 1.5 / math.gamma(2.5)).max() < 1e-8
    shifted = fvi.solve_fde(lambda t, x: bent(t - 1.0, x), 0.5, (1.0, 3.0), [0.0], rtol=1e-9, must_hit=[1.0, 1.5, 3.0])
    assert 1.5 in shifted.t
    with pytest.raises(fvi.InputError, match=r"must_hit\[1\] = 7"):
        fvi.solve_fde(bent, 0.5, 2.0, [0.0], must_hit=[0.5, 7.0])


def test_results_of_equations_speak_of_unknowns():
    r = fvi.run({"equation": {"order": 0.6, "right": ["-10*x0", "x0-x1"], "initial": [1.0, 0.0]}, "time": {"end": 5.0, "tolerance": 1e-8}})
    assert r.labels == ["x0", "x1"] and list(r.to_pandas().columns) == ["x0", "x1"]
    assert set(r.to_xarray().data_vars) == {"x"} and "unknowns" in repr(r)
    known = fvi.solve_fde(["-10*x0", "x0-x1"], 0.6, 5.0, [1.0, 0.0], rtol=1e-10, t_eval=[2.5]).x[0]
    assert np.abs(r(2.5) - known).max() < 1e-4
    with pytest.raises(fvi.InputError, match="unknowns of an equation"):
        r.v
    with pytest.raises(fvi.InputError, match="order"):
        fvi.solve_fde(lambda t, x: -x, 0.5 + 0j, 1.0, [1.0])
