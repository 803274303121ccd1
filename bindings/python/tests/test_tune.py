"""Tunings of controllers."""

import numpy as np
import pytest

import fvi

PROBLEM = {
    "plant": {"gain": 3.13, "time_constant": 433.33, "dead_time": 50.0},
    "controller": {"lambda": 0.8968, "mu": 0.4773, "sample": 1.0},
    "specification": {"crossover": 0.008, "phase_margin": 60, "flat_phase": True},
}


def test_a_loop_has_the_margins_that_were_asked_for():
    found = fvi.tune(PROBLEM)
    s = 1j * found.omega
    plant = 3.13 * np.exp(-50 * s) / (433.33 * s + 1)
    law = found.kp + found.ki * s**-found.lam + found.kd * s**found.mu
    assert np.abs(found.plant / plant - 1).max() < 1e-12
    assert np.abs(found.loop / (plant * law) - 1).max() < 1e-11
    for ours, printed in [(found.kp, 0.6152), (found.ki, 0.0100), (found.kd, 4.3867)]:
        # The printed ones are those in continuous time; these are for samples of 1 s.
        assert ours == pytest.approx(printed, rel=0.03)
    assert found.sampled_margins["phase_margin"] == pytest.approx(60)
    assert found.margins["phase_margin"] == pytest.approx(60.17, abs=0.1)
    assert found.margins["ms"] >= (1 / np.abs(1 + found.loop)).max() - 1e-9
    below = found.omega < np.pi
    assert np.isfinite(found.sampled_loop[below]).all() and np.isnan(found.sampled_loop[~below]).all()
    assert abs(found.step[-1] - 1) < 0.05 and abs(found.load[-1]) < 0.5
    assert "[controller]" in found.controller


def test_mistakes_and_what_cannot_be_met():
    with pytest.raises(fvi.InputError, match="phase_margin"):
        fvi.tune(PROBLEM, overrides={"specification.phase_margin": 200})
    with pytest.raises(RuntimeError, match="turn it by"):
        fvi.tune(PROBLEM, overrides={"controller": {"structure": "pi", "sample": 1.0}, "specification.crossover": 0.05})
