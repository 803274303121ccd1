"""A viscoelastic bar of 2000 finite elements, pushed at its end by a pulse that is a function of Python's: it stays sparse.

    python bar.py
"""

import numpy as np
import scipy.sparse as sp

import fvi

ELEMENTS, LENGTH, SPEED = 2000, 1.0, 1.0


def main() -> None:
    h = LENGTH / ELEMENTS
    ones = np.ones(ELEMENTS)
    stiffness = SPEED**2 / h * sp.spdiags([-ones, np.append(2 * ones[1:], 1.0), -ones], [-1, 0, 1], ELEMENTS, ELEMENTS, format="csr")
    mass = h / 6 * sp.spdiags([ones, np.append(4 * ones[1:], 2.0), ones], [-1, 0, 1], ELEMENTS, ELEMENTS, format="csr")
    pulse = lambda t: np.sin(np.pi * t / 0.2) ** 2 if t < 0.2 else 0.0
    bar = fvi.Model(mass=mass, stiffness=stiffness, position=np.zeros(ELEMENTS), step=2e-3, end=2.2, coordinates=[ELEMENTS // 2, ELEMENTS - 1],
                    loads=fvi.Load({"coordinate": ELEMENTS - 1}, pulse))  # fmt: skip
    elastic = bar.integrate()
    assert elastic.summary["solver"]["kind"] == "sparse"
    at = lambda r, t: float(np.interp(t, r.t, r.q[:, 0]))
    # The pulse runs to the fixed end and back; its middle passes the middle of the bar at t = 0.6, with the displacement of a wave.
    height = 0.1 / SPEED
    print(f"elastic: the middle is pushed by {at(elastic, 0.75):.4f}, a wave of a rod by {height:.4f}")
    assert abs(at(elastic, 0.75) - height) < 2e-3
    for rho in (1e-3, 1e-2):
        r = bar.integrate(damping=fvi.Damping(order=0.5, coefficient=rho * stiffness))
        lost = 1.0 - r.energy[-1] / r.energy[len(r.t) // 8]
        print(f"ρ = {rho:5g} K: {100 * lost:.0f} % of the energy are lost on the way")
        assert 0.0 < lost < 1.0


main()
