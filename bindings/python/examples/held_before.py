"""A viscoelastic link is stretched, held for a while, and let go: how far it swings back depends on how long it was held.

    python held_before.py
"""

from typing import Any

import numpy as np

import fvi

STRETCH, RAMP = 1.0, 0.5


def stretched(hold: float):
    """A ramp to the stretch, which is then held until t = 0."""
    return -(hold + RAMP), lambda t: [STRETCH * min(1.0, (t + hold + RAMP) / RAMP)]


def main() -> None:
    link: dict[str, Any] = dict(mass=[1.0], stiffness=[1.0], damping=fvi.Damping(order=0.5, coefficient=[2.0]), step=0.01, end=30.0)
    swing = {}
    for hold in (1.0, 10.0, 100.0):
        r = fvi.integrate(**link, position=[STRETCH], past=stretched(hold))
        swing[hold] = r.q[:, 0].min()
        print(f"held for {hold:5g} s: the link swings back to {swing[hold]:.3f}, and is at {r.q[-1, 0]:.3f} after 30 s")
    always = fvi.integrate(**link, position=[STRETCH])
    print(f"at rest there for ever: to {always.q[:, 0].min():.3f}")
    # A short hold leaves the damper pulling back. It forgets slowly: what is left of it falls like the root of the hold.
    left = [always.q[:, 0].min() - swing[hold] for hold in (1.0, 10.0, 100.0)]
    assert left[0] > left[1] > left[2] > 0.0 and 1.5 < left[1] / left[2] < 3.2


main()
