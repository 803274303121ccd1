"""Learns a potential from a measured motion: the coefficients of a polynomial, by the gradient of the misfit.

The motion is that of a pendulum with a damper of order 1/2, so that the coefficients approach those of 1 − cos q as far as
it swings.
"""

from typing import Any

import numpy as np
from scipy.optimize import minimize

import fvi

motion: dict[str, Any] = dict(mass=[1.0], damping=fvi.Damping(0.5, 0.15), position=[1.2], step=0.05, steps=300)
data = fvi.integrate(**motion, potential="1 - cos(q0)").q
names = ["a", "b", "c"]
model = fvi.Model(**motion, potential="a*q0^2 + b*q0^4 + c*q0^6", parameters={"a": 0.4, "b": 0.0, "c": 0.0})


def misfit(values):
    g = model.gradient(dict(zip(names, values)), lambda r: r.q - data)
    return 0.5 * ((g.result.q - data) ** 2).sum(), [g[name] for name in names]


# Within the bounds the potential holds the motion.
found = minimize(misfit, [0.4, 0.0, 0.0], jac=True, method="L-BFGS-B", bounds=[(0.2, 1.0), (-0.05, 0.05), (-0.002, 0.01)], tol=1e-14)
for name, value, series in zip(names, found.x, (1 / 2, -1 / 24, 1 / 720)):
    print(f"{name} = {value:.6f}, that of the series {series:.6f}")
assert np.allclose(found.x, (1 / 2, -1 / 24, 1 / 720), atol=1e-3)
