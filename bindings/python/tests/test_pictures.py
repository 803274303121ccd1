"""Pictures and tables for notebooks of results and studies."""

import numpy as np
import pytest

import fvi

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")

OSCILLATOR = {
    "system": {"mass": [1.0], "potential": "2*q0^2", "damping": [{"order": 0.5, "coefficient": [0.1]}]},
    "initial": {"position": [1.0]},
    "time": {"step": 0.1, "steps": 100},
}


def test_a_result_draws_the_chosen_coordinates_with_labels_and_units():
    r = fvi.integrate(mass=np.ones(3), stiffness=np.ones(3), position=[1.0, 2.0, 3.0], step=0.1, steps=5, coordinates=[0, 2])
    above, below = r.plot(coordinates=[2], labels=["tip"], unit="m", time_unit="s", energy_unit="J")
    assert np.array_equal(above.lines[0].get_ydata(), r.q[:, 1])
    assert above.get_ylabel() == "position (m)" and below.get_xlabel() == "time t (s)" and below.get_ylabel() == "energy (J)"
    assert [text.get_text() for text in above.get_legend().get_texts()] == ["tip"]
    for wrong in (dict(coordinates=[1]), dict(labels=["a"]), dict(axes=[above])):
        with pytest.raises(fvi.InputError):
            r.plot(**wrong)


def test_a_response_is_drawn_as_bode_and_nyquist():
    found = fvi.response(OSCILLATOR, np.geomspace(0.1, 10.0, 50))
    above, below = found.plot(frequency_unit="Hz", unit="m/N")
    assert np.allclose(above.lines[0].get_ydata(), np.abs(found.response))
    assert np.allclose(above.lines[0].get_xdata(), found.omega / (2 * np.pi)) and below.get_xlabel() == "frequency (Hz)"
    (plane,) = found.plot("nyquist")
    assert np.allclose(plane.lines[0].get_xdata(), found.response.real)
    with pytest.raises(fvi.InputError, match="nyquist"):
        found.plot("smith")
    assert "damping ratio" in found._repr_html_()


def test_kernels_draw_their_curves():
    kernel = fvi.Kernel.maxwell(order=0.6, time=2.0)
    curves = kernel.curves([0.1, 1.0, 10.0])
    s = 1j * np.array([0.1, 1.0, 10.0])
    assert np.allclose(curves.moduli, (2 * s) ** 0.6 / (1 + (2 * s) ** 0.6))
    moduli, loss, course = kernel.plot(unit="Pa", time_unit="s")
    assert moduli.get_ylabel() == "modulus (Pa)" and len(course.lines) == 2 and course.get_xlabel() == "t (s)"
    assert "maxwell" in kernel._repr_html_()
    with pytest.raises(fvi.InputError, match="not known"):
        fvi.Kernel.weights([1.0, 2.0]).curves()


def test_studies_draw_themselves():
    table = fvi.converge({**OSCILLATOR, "time": {"step": 0.1, "end": 2.0}, "system": {"mass": [1.0], "potential": "2*q0^2"},
                          "reference": {"position": ["cos(2*t)"]}}, (4, 6))
    (place,) = table.plot_errors()
    assert len(place.lines) == 3 and "position, order 2.0" in place.get_legend().get_texts()[0].get_text()
    assert "position_error" in table._repr_html_() and len(table.plot("step", "steps", logarithmic=True)[0].lines) == 1
    for wrong in (lambda: table.plot("h"), lambda: table.plot_errors(["place"])):
        with pytest.raises(fvi.InputError):
            wrong()
    measured = fvi.run(OSCILLATOR)
    fitted = fvi.fit(OSCILLATOR, {"system.damping[0].order": 0.6}, {"t": measured.t, "q0": measured.q[:, 0]})
    assert fitted.plot(units={"t": "s"})[1].get_xlabel() == "t (s)"
    tuned = fvi.tune({"plant": {"transfer": "1.0263/(s*(0.71*s + 1))"}, "controller": {"structure": "pd", "sample": 1e-8},
                      "specification": {"crossover": 2.51, "phase_margin": 83.9, "flat_phase": True}})
    assert len(tuned.plot(unit="rad", time_unit="s")) == 4 and "phase_margin" in tuned._repr_html_()
