"""A kink in a chain of 1000 pendulums: a potential in Python whose sparse Hessian keeps the system sparse.

    python lattice.py
"""

from typing import Any

import numpy as np
import scipy.sparse as sp

import fvi

N, COUPLING = 1000, 25.0


def energy(q):
    return np.sum(1.0 - np.cos(q)) + 0.5 * COUPLING * np.sum(np.diff(q) ** 2)


def gradient(q):
    pull = np.sin(q)
    stretch = COUPLING * np.diff(q)
    pull[:-1] -= stretch
    pull[1:] += stretch
    return pull


ENDS = np.full(N, 2 * COUPLING)
ENDS[[0, -1]] = COUPLING
BESIDE = np.full(N, -COUPLING)
BONDS = sp.spdiags([BESIDE, ENDS, BESIDE], [-1, 0, 1], N, N, format="csr")


def hessian(q):
    return BONDS + sp.diags(np.cos(q))


def main() -> None:
    # A kink of the continuum limit, at the speed v in units of the speed of sound.
    x, v = (np.arange(N) - 300) / np.sqrt(COUPLING), 0.5
    sharp = x / np.sqrt(1 - v**2)
    kink = 4 * np.arctan(np.exp(sharp))
    speed = -2 * v / np.sqrt(1 - v**2) / np.cosh(sharp)
    chain = fvi.System(mass=np.ones(N), potential=fvi.Potential(energy, gradient, hessian))
    motion: dict[str, Any] = dict(position=kink, velocity=speed, step=0.1, steps=800, every=100)
    free = fvi.integrate(chain, **motion)
    assert free.summary["solver"]["kind"] == "sparse"
    middle = lambda r: np.array([np.interp(np.pi, q, np.arange(N)) for q in r.q])
    way = (middle(free)[-1] - middle(free)[0]) / np.sqrt(COUPLING)
    print(f"free: the kink has gone {way:.2f} in 80 units of time, {v * 80:.2f} at its speed")
    assert abs(way - v * 80) < 1.0
    damped = fvi.integrate(chain, **motion, damping=fvi.Damping(order=0.5, coefficient=np.full(N, 0.05)))
    way = (middle(damped)[-1] - middle(damped)[0]) / np.sqrt(COUPLING)
    print(f"with a half-order damper at every pendulum: {way:.2f}")
    assert 0.0 < way < 0.9 * v * 80


main()
