"""Derivatives of motions with respect to numbers of their scenarios."""

import numpy as np
import pytest

import fvi

PATHS = ["system.damping[0].order", "system.parameters.k", "initial.position[1]"]


def motion(order=0.5, k=1.0, q1=0.2, **keys):
    return fvi.integrate(
        mass=[1.0, 2.0],
        potential="k*q0^2 + (q1 - q0)^4",
        parameters={"k": k},
        damping=fvi.Damping(order=order, coefficient=[0.3, 0.1]),
        position=[1.0, q1],
        step=0.1,
        steps=50,
        **keys,
    )


def test_derivatives_are_differences(tmp_path):
    found = motion(sensitivities=PATHS)
    assert found.dq.shape == found.dp.shape == (51, 3, 2)
    h = 1e-5
    for index, (name, value) in enumerate([("order", 0.5), ("k", 1.0), ("q1", 0.2)]):
        ahead, behind = (motion(**{name: value + change}) for change in (h, -h))
        for derived, column in ((found.dq, "q"), (found.dp, "p")):
            difference = (getattr(ahead, column) - getattr(behind, column)) / (2 * h)
            assert np.abs(derived[:, index] - difference).max() < 1e-7 * max(1, np.abs(difference).max())
    found.save(tmp_path / "r.npz")
    assert (fvi.load(tmp_path / "r.npz").dq == found.dq).all()


def test_derivatives_with_gyroscopic_forces_a_past_a_late_start_and_a_symbol():
    def turning(turn=0.8, rate=2.0, **keys):
        # The past is the line through two positions, at the times 0.95 and 1, the start.
        return fvi.integrate(
            mass=[1.0, 2.0],
            stiffness=[3.0, 1.0],
            gyroscopic=[[0.0, turn], [-turn, 0.0]],
            parameters={"a": rate},
            damping=fvi.Damping(kernel=fvi.Kernel.symbol("s^0.6/(1 + a*s^0.6)"), coefficient=[0.3, 0.1]),
            position=[1.0, 0.2],
            past=([0.95, 1.0], [[0.7, 0.1], [1.0, 0.2]]),
            start=1.0,
            step=0.05,
            steps=60,
            **keys,
        )

    found = turning(sensitivities=["system.gyroscopic[0][1]", "system.parameters.a"])
    h = 1e-5
    for index, (name, value) in enumerate([("turn", 0.8), ("rate", 2.0)]):
        ahead, behind = (turning(**{name: value + change}) for change in (h, -h))
        difference = (ahead.q - behind.q) / (2 * h)
        assert np.abs(difference).max() > 1e-5
        assert np.abs(found.dq[:, index] - difference).max() < 1e-7 * max(1, np.abs(difference).max())


def test_without_them_there_are_none_and_mistakes_are_refused():
    plain = motion()
    assert plain.dq.shape == (51, 0, 2)
    for paths, words in [(["system.damping[1].order"], "below 1"), ([], "one path")]:
        with pytest.raises(fvi.InputError, match=words):
            motion(sensitivities=paths)
    with pytest.raises(fvi.InputError, match="single precision"):
        motion(sensitivities=PATHS, precision="f32")
    with pytest.raises(fvi.InputError, match="exact Hessian and Jacobian"):
        fvi.integrate(
            mass=[1.0], force=lambda t, q: -q, position=[1.0], step=0.1, steps=5, sensitivities=["initial.position[0]"]
        )
