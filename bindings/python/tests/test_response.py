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


def test_modes_near_frequencies_have_shapes_that_solve_their_equation():
    sparse, size = pytest.importorskip("scipy.sparse"), 200
    stiffness = sparse.diags_array([np.full(size - 1, -1.0), np.full(size, 2.0), np.full(size - 1, -1.0)], offsets=[-1, 0, 1])
    system = fvi.System(
        mass=np.ones(size), stiffness=stiffness, damping=[fvi.Damping(0.5, 0.05 * stiffness), fvi.Damping(1.0, np.eye(size)[0] * 0.3)]
    )
    found = fvi.response(system, [0.5], near=[0.5, 1.0], modes=3, discrete=False)
    assert found.discrete is None and not any("discrete" in reason for reason in found.left_out)
    assert [mode.near for mode in found.modes] == [0.5] * 3 + [1.0] * 3
    for mode in found.modes:
        s, x = mode.s, mode.shape
        left = s**2 * x + (1 + 0.05 * s**0.5) * (stiffness @ x)
        left[0] += 0.3 * s * x[0]
        assert np.abs(left).max() < 1e-12 and np.abs(x).max() == pytest.approx(1)
        assert mode.frequency == abs(s) and 0 < mode.damping < 1 and mode.residual < 1e-12 and mode.of_tables is None
    distances = [abs(mode.s - 0.5j) for mode in found.modes[:3]]
    assert distances == sorted(distances)
    with pytest.raises(fvi.InputError, match="near"):
        fvi.response(system, [0.5], near=-1.0)
    with pytest.raises(fvi.InputError, match="modes"):
        fvi.response(system, [0.5], near=1.0, modes=0)
