"""A run that is looked at and gone on with: with its memory, and without, which is another motion.

    python going_on.py
"""

from typing import Any

import numpy as np

import fvi


def main() -> None:
    damper = fvi.Damping(order=0.4, coefficient=[1.5])
    system: dict[str, Any] = dict(
        mass=[1.0], stiffness=[1.0], damping=damper, force=lambda t: [np.sin(0.3 * t)], step=0.02, engine="block-fft"
    )
    first = fvi.integrate(**system, position=[1.0], steps=500)
    second = fvi.integrate(continue_from=first, steps=500)
    whole = fvi.integrate(**system, position=[1.0], steps=1000)
    assert np.array_equal(second.q, whole.q[500:])
    print("continue_from: the bits of one run of 1000 steps")
    # Position and momentum are not the whole state: the damper remembers.
    restarted = fvi.integrate(**system, position=first.q[-1], momentum=first.p[-1], start=first.t[-1], steps=500)
    difference = np.abs(restarted.q - whole.q[500:]).max()
    print(f"position and momentum alone: up to {difference:.3f} beside it")
    assert difference > 0.05
    # What it remembers may also be given: the motion so far.
    told = fvi.integrate(**system, past=(first.t, first.q), momentum=first.p[-1], start=first.t[-1], steps=500)
    difference = np.abs(told.q - whole.q[500:]).max()
    print(f"with the positions so far as the past: {difference:.0e} beside it")
    assert difference < 1e-12


main()
