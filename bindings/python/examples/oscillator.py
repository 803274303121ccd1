"""A mass on a spring with dampers between a spring (β = 0) and a dashpot (β = 1): the order decides how it comes to rest.

    python oscillator.py [PICTURE.png]
"""

import sys

import numpy as np

import fvi

FREQUENCY = 2.0


def main() -> None:
    before = 1.0
    for beta in (0.25, 0.5, 0.75, 1.0):
        r = fvi.integrate(mass=[1.0], stiffness=[FREQUENCY**2], damping=fvi.Damping(order=beta, coefficient=[0.4]),
                          position=[1.0], step=0.01, end=40.0, order=2)  # fmt: skip
        late = np.abs(r.q[-400:, 0]).max()
        print(f"β = {beta:4}: after 40 s the amplitude is {late:.1e}, the energy {r.energy[-1] / r.energy[0]:.1e} of that at the start")
        # Dissipation grows with the order: the damper's part in phase with the velocity is ρ ω^β sin(βπ/2).
        assert late < before
        before = late
    if len(sys.argv) > 1:
        r.plot().savefig(sys.argv[1])


main()
