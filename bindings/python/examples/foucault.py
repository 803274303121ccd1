"""Foucault's pendulum: a gyroscopic force turns its plane; a damper of half order lets it come to rest without changing the rate.

    python foucault.py
"""

import numpy as np

import fvi

OMEGA, TURN = 2.0, 0.05


def main() -> None:
    # In the frame of the ground, M q̈ + 2 TURN J q̇ + ω² q = 0 for turns that are slow beside ω.
    turning = 2 * TURN * np.array([[0.0, -1.0], [1.0, 0.0]])
    pendulum = fvi.System(mass=[1.0, 1.0], stiffness=[OMEGA**2, OMEGA**2], gyroscopic=turning)
    for name, damping in (("free", []), ("damped", [fvi.Damping(order=0.5, coefficient=[0.02, 0.02])])):
        r = fvi.integrate(pendulum, damping=damping, position=[1.0, 0.0], step=0.005, end=40.0)
        # The plane of the last swing.
        last = r.q[-int(2 * np.pi / OMEGA / 0.005) :]
        farthest = last[np.argmax(np.sum(last**2, axis=1))]
        angle = np.arctan2(farthest[1], farthest[0]) % np.pi
        when = r.t[-len(last) + int(np.argmax(np.sum(last**2, axis=1)))]
        expected = (-TURN * when) % np.pi
        print(f"{name}: the plane has turned to {np.degrees(angle):.1f}° at t = {when:.1f}, {np.degrees(expected):.1f}° by its rate; "
              f"energy {r.energy[-1] / r.energy[0]:.4f} of that at the start")  # fmt: skip
        assert min(abs(angle - expected), np.pi - abs(angle - expected)) < 0.03
        # A gyroscopic force does no work.
        assert (abs(r.energy[-1] - r.energy[0]) < 1e-12) == (name == "free")


main()
