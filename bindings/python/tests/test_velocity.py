"""Forces that depend on the velocity, as functions and as expressions."""

import numpy as np
import pytest

import fvi

PLANE = dict(mass=[[2.0, 0.3], [0.3, 1.0]], stiffness=[[3.0, 0.4], [0.4, 2.0]], damping=fvi.Damping(0.5, [0.2, 0.1]),
             position=[1.0, -0.5], velocity=[0.3, 0.8], step=0.05, steps=100)  # fmt: skip
WORDS = ["(1 - q0^2)*v0 - 0.2*v1*abs(v1)", "-0.3*v1^3 + q0*v0"]


def force(t, q, v):
    return [(1.0 - q[0] ** 2) * v[0] - 0.2 * v[1] * abs(v[1]), -0.3 * v[1] ** 3 + q[0] * v[0]]


def by_position(t, q, v):
    return [[-2.0 * q[0] * v[0], 0.0], [v[0], 0.0]]


def by_velocity(t, q, v):
    return [[1.0 - q[0] ** 2, -0.4 * abs(v[1])], [q[0], -0.9 * v[1] ** 2]]


@pytest.mark.parametrize(
    "scheme",
    [dict(order=2), dict(scheme="galerkin", degree=2, quadrature="gauss", points=2, order=3), dict(scheme="implicit-euler"),
     dict(scheme="explicit-euler"), dict(scheme="collocation", convolution="radau-iia", stages=2)],
)  # fmt: skip
def test_functions_move_as_expressions_do(scheme):
    words = fvi.integrate(**PLANE, **scheme, force=WORDS)
    for given in (force, fvi.Force(force), fvi.Force(force, by_position, by_velocity), fvi.Force(force, None, by_velocity)):
        code = fvi.integrate(**PLANE, **scheme, force=given)
        assert np.abs(code.q - words.q).max() < 1e-12 and np.abs(code.p - words.p).max() < 1e-12
        # Newton's method sees the derivatives: without those with respect to the velocity it would need many more iterations.
        assert code.summary["newton_iterations"] <= 1.3 * words.summary["newton_iterations"]


def test_wrong_derivatives_cost_iterations():
    wrong = fvi.Force(force, by_position, lambda t, q, v: np.zeros((2, 2)))
    right, slow = (fvi.integrate(**PLANE, order=2, force=given) for given in (fvi.Force(force, by_position, by_velocity), wrong))
    assert np.abs(right.q - slow.q).max() < 1e-9
    assert slow.summary["newton_iterations"] > 1.5 * right.summary["newton_iterations"]


def test_what_does_not_go_together_is_refused():
    with pytest.raises(fvi.InputError, match="t, q, v") as caught:
        fvi.integrate(**PLANE, force=lambda t, q, v, a: q)
    assert caught.value.key == "force"
    with pytest.raises(fvi.InputError, match="takes no velocity") as caught:
        fvi.integrate(**PLANE, force=fvi.Force(lambda t, q: q, None, by_velocity))
    assert caught.value.key == "force.velocity_jacobian"
    with pytest.raises(fvi.InputError, match="1 numbers.*2 are needed"):
        fvi.integrate(**PLANE, force=lambda t, q, v: [v[0]])
    with pytest.raises(fvi.InputError, match="not finite"):
        fvi.integrate(**PLANE, force=lambda t, q, v: [np.nan * v[0], 0.0])
    with pytest.raises(fvi.InputError, match="order"):
        fvi.response({"system": {"mass": [1.0], "force": ["-v0"]}, "initial": {"position": [0.0]},
                      "time": {"step": 0.1, "steps": 1}})  # fmt: skip


def test_a_step_too_long_for_a_drag_in_code_is_refused():
    given = dict(mass=[1.0], stiffness=[1.0], position=[1.0], kappa=0.0, step=0.1, steps=10)
    with pytest.raises(fvi.InputError, match="unstable.*9.50e-2") as caught:
        fvi.integrate(**given, force=lambda t, q, v: -21.0 * v)
    assert caught.value.key == "step"
    fvi.integrate(**given, force=lambda t, q, v: -18.0 * v)


def test_a_motion_with_a_drag_in_code_goes_on():
    whole = fvi.integrate(**PLANE, order=2, force=force)
    half = fvi.integrate(**dict(PLANE, steps=50), order=2, force=force)
    assert np.array_equal(fvi.integrate(continue_from=half, steps=50).q, whole.q[50:])
