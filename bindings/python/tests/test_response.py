"""Frequency responses."""

import numpy as np
import pytest

import fvi

OSCILLATOR = {
    "system": {
        "mass": [2.0],
        "potential": "1.5*q0^2",
        "damping": [{"kernel": {"form": "maxwell", "order": 0.6, "time": 2.0}, "coefficient": [0.8]}],
    },
    "time": {"step": 0.1, "steps": 200},
}


def test_the_response_is_the_closed_form():
    omega = np.geomspace(0.01, 20, 7)
    found = fvi.response(OSCILLATOR, omega)
    s = 2j * omega
    kernel = s**0.6 / (1 + s**0.6)
    known = 1 / (-2 * omega**2 + 3 + 0.8 * kernel)
    assert np.abs(found.response / known - 1).max() < 1e-12
    assert np.abs(found.kernels[0].moduli - kernel).max() < 1e-13
    assert found.discrete is not None and len(found.discrete) == 7
    s = found.poles[0]
    assert abs(2 * s**2 + 3 + 0.8 * (2 * s) ** 0.6 / (1 + (2 * s) ** 0.6)) < 1e-12
    assert found.frequency[0] == abs(s) and found.damping[0] == pytest.approx(-s.real / abs(s))


def test_keys_change_the_scenario_and_mistakes_are_refused():
    assert len(fvi.response(OSCILLATOR, points=10, step=0.2).omega) == 10
    for arguments, words in [
        ({"omega": [1.0, 0.5]}, "ascend"),
        ({"input": 1}, "input"),
        ({"about": [0.0, 1.0]}, "position"),
        ({"from_omega": -1.0}, "from"),
    ]:
        with pytest.raises(fvi.InputError, match=words):
            fvi.response(OSCILLATOR, **arguments)
