"""Kernels as decaying exponentials and as systems of first order."""

import numpy as np
import pytest
import scipy.signal

import fvi


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    "of", [{"exponent": 0.5}, {"exponent": -0.4}, {"kernel": fvi.Kernel.maxwell(0.6, 0.3)}, {"kernel": fvi.Kernel.tempered(1.3, 0.5)}]
)
def test_exponentials_are_the_weights(of, order):
    table = fvi.exponentials(**of, step=0.02, order=order)
    exact = fvi.weights(**of, step=0.02, order=order, count=2000)
    assert len(table.rates) < 200
    assert np.abs(table.weights(2000) - exact).max() < 1e-11 * np.abs(exact).max()
    assert np.allclose(table.weights(3), exact[:3], rtol=1e-12)


def test_a_state_space_answers_like_the_kernel():
    kernel, x = fvi.Kernel.maxwell(0.6, 0.3), np.random.default_rng(1).normal(size=400)
    for order in (1, 2, 3):
        A, B, C, D = system = kernel.state_space(step=0.02, order=order)
        assert A.shape == (len(A), len(A)) and B.shape == (len(A), 1) and C.shape == (1, len(A)) and D.shape == (1, 1)
        _, y, _ = scipy.signal.dlsim((*system, 0.02), x)
        expected = np.convolve(fvi.weights(kernel=kernel, step=0.02, order=order, count=400), x)[:400]
        assert np.abs(y[:, 0] - expected).max() < 1e-10 * np.abs(expected).max()


def test_a_band_needs_fewer_states():
    kernel = fvi.Kernel.maxwell(0.6, 0.3)
    few, many = kernel.state_space(0.01, band=(0.1, 10.0), tolerance=1e-3), kernel.state_space(0.01)
    assert len(few.A) < len(many.A) / 2
    for frequency in (0.1, 1.0, 10.0):
        z = np.exp(2j * np.pi * frequency * 0.01)
        found, exact = ((C @ np.linalg.solve(z * np.eye(len(A)) - A, B) + D)[0, 0] for A, B, C, D in (few, many))
        assert abs(found / exact - 1) < 2e-3


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        ({"step": -1.0}, "step"),
        ({"order": 7}, "order"),
        ({"tolerance": 1e-20}, "tolerance"),
        ({"band": (0.1, 10.0), "horizon": 5}, "horizon"),
        ({"band": (0.1,)}, "band"),
    ],
)
def test_what_makes_no_table_is_refused(arguments, part):
    with pytest.raises(fvi.InputError, match=part):
        fvi.exponentials(**{"exponent": 0.5, "step": 0.01, **arguments})
