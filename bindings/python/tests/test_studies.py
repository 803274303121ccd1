"""Studies and the package as a whole."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fvi

ROOT = Path(__file__).resolve().parents[3]


def test_orders_are_measured():
    table = fvi.converge(ROOT / "examples/scenarios/damped-oscillator-jo.toml", (4, 6))
    assert list(table["level"]) == [4, 5, 6]
    assert list(table)[:5] == ["level", "steps", "step", "position_error", "position_order"]
    assert np.isnan(table["position_order"][0]) and np.isfinite(table["position_order"][1:]).all()
    with pytest.raises(fvi.InputError, match="levels"):
        fvi.converge(ROOT / "examples/scenarios/pendulum.toml", (6, 4))


def test_engines_are_compared():
    table = fvi.compare_engines([100], exponent=[0.5, -0.5], repetitions=1)
    rows = {name: error for name, error in zip(table["engine"], table["error_u"])}
    assert {"direct", "block-fft", "real-time", "exponential-sum"} <= set(rows)
    assert max(rows[name] for name in ("direct", "block-fft", "real-time", "exponential-sum")) < 30
    with pytest.raises(fvi.InputError):
        fvi.compare_engines([100], exponent=2.5)


def test_extremals_are_found():
    problem = ROOT / "examples/problems/classical-oscillator.toml"
    solution = fvi.extremal(problem, overrides={"interval.steps": 256})
    assert solution.success and solution.x.shape == (257, 1)
    assert np.abs(solution.x[:, 0] - np.sin(solution.t) / np.sin(2.0)).max() < 1e-2
    assert np.isnan(solution.v).sum() == 1
    with pytest.raises(fvi.InputError, match="problem.alpha"):
        fvi.extremal(problem, overrides={"problem.alpha": 1.5})


def test_the_package_imports_with_numpy_alone():
    # A new interpreter without other libraries.
    script = (
        "import sys; import fvi; fvi.derivative([1.0, 2.0], 0.5, 0.1); "
        "print(sorted({'scipy', 'pandas', 'xarray', 'matplotlib', 'dask'} & set(sys.modules)))"
    )
    output = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert output.strip() == "[]"


def test_public_names_have_docstrings():
    for name in fvi.__all__:
        if not name.startswith("__"):
            assert getattr(fvi, name).__doc__, name
