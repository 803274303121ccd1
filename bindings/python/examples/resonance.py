"""A sweep with functions in it: the largest amplitude of a driven hardening spring over the order of its damper.

    python resonance.py
"""

from typing import Any

import numpy as np

import fvi


def main() -> None:
    scenario: dict[str, Any] = {
        "system": {
            "mass": [1.0],
            "potential": fvi.Potential(lambda q: 0.5 * q @ q + 0.1 * np.sum(q**4), lambda q: q + 0.4 * q**3),
            "force": lambda t: [0.3 * np.cos(1.2 * t)],
            "damping": [fvi.Damping(order=0.5, coefficient=[0.2])],
        },
        "initial": {"position": [0.0]},
        "time": {"step": 0.05, "end": 60.0},
    }
    orders = [0.4, 0.8, 1.2]
    table = fvi.sweep({"scenario": scenario, "axes": {"system.damping[0].order": orders}, "keep": {"quantities": ["largest"]}})
    for order, largest in zip(orders, table["largest_q0"]):
        alone = {**scenario, "system": {**scenario["system"], "damping": [fvi.Damping(order=order, coefficient=[0.2])]}}
        print(f"β = {order}: {largest:.4f}")
        assert np.abs(fvi.run(alone).q).max() == largest


main()
