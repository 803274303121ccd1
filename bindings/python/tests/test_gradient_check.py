"""Gradients that do not belong to their potential are noticed at the start of a run."""

import numpy as np
import pytest

import fvi

COMMON = dict(step=0.05, steps=4)


@pytest.mark.parametrize("position", [[0.7, -0.4], [0.0, 0.0]])
def test_a_wrong_gradient_is_refused_with_the_entry_and_both_numbers(position):
    def value(q):
        return 2.0 * q[0] ** 2 + np.cosh(q[1])

    def gradient(q):
        return np.array([4.0 * q[0], np.cosh(q[1])])

    with pytest.raises(fvi.InputError, match=r"entry 1 is .* differences of potential.value give") as refused:
        fvi.integrate(mass=[1.0, 1.0], position=position, potential=fvi.Potential(value, gradient), **COMMON)
    assert refused.value.key == "potential.gradient"

    def right(q):
        return np.array([4.0 * q[0], np.sinh(q[1])])

    fvi.integrate(mass=[1.0, 1.0], position=position, potential=fvi.Potential(value, right), **COMMON)


@pytest.mark.parametrize("factor", [-1.0, 2.0, 1.01])
def test_at_rest_a_point_nearby_tells(factor):
    wrong = fvi.Potential(lambda q: 0.5 * q @ q, lambda q: factor * q)
    with pytest.raises(fvi.InputError, match="entry 0"):
        fvi.integrate(mass=[1.0], position=[0.0], potential=wrong, force=lambda t: [1.0], **COMMON)


@pytest.mark.parametrize(
    "value, gradient, start",
    [
        # Kinks, jumps, single precision, large constants and edges of the domain say nothing wrong.
        (lambda q: abs(q[0]), lambda q: np.sign(q), 0.0),
        (lambda q: float(np.float32(0.5) * np.float32(q[0]) ** 2), lambda q: q, 1.0),
        (lambda q: 1e12 + 0.5 * q[0] ** 2, lambda q: q, 1.0),
        (lambda q: max(q[0], 0.0) ** 2, lambda q: [2.0 * max(q[0], 0.0)], 1e-7),
        (lambda q: -np.sqrt(np.float64(1.0) - q[0]), lambda q: 0.5 / np.sqrt(1.0 - q), 0.99999),
        (lambda q: float(q[0] > 1.0), lambda q: 0.0 * q, 1.0),
        (lambda q: q[0] ** 1.5 if q[0] >= 0 else _raised(), lambda q: 1.5 * np.sqrt(q), 0.0),
    ],
)
def test_right_gradients_are_accepted(value, gradient, start):
    fvi.integrate(mass=[1.0], position=[start], potential=fvi.Potential(value, gradient), step=1e-4, steps=1)


def _raised():
    raise ValueError("outside of the domain")
