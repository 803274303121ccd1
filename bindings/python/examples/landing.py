"""A probe lands on a viscoelastic leg: events as functions of Python's tell when it touches, and end the run when it bounces.

    python landing.py
"""

import numpy as np

import fvi

MASS, GRAVITY, LEG = 100.0, 1.6, 1.0


def squeezed(q):
    return max(LEG - q[0], 0.0)


def main() -> None:
    leg = fvi.Potential(
        lambda q: MASS * GRAVITY * q[0] + 2000.0 * squeezed(q) ** 2,
        lambda q: [MASS * GRAVITY - 4000.0 * squeezed(q)],
        lambda q: [[4000.0 * (q[0] < LEG)]],
    )
    touches = fvi.Event(lambda t, q: q[0] - LEG, "falling")
    bounces = fvi.Event(lambda t, q: q[0] - LEG, "rising", "stop")
    r = fvi.integrate(mass=[MASS], potential=leg, position=[5.0], velocity=[-1.0], step=1e-3, end=20.0, events=[touches, bounces])
    fall = (-1.0 + np.sqrt(1.0 + 2.0 * GRAVITY * 4.0)) / GRAVITY
    contact = r.events[1]["time"] - r.events[0]["time"]
    print(f"it touches at t = {r.events[0]['time']:.6f} (falling takes {fall:.6f}), and leaves {contact:.3f} s later: {r.message}")
    assert abs(r.events[0]["time"] - fall) < 1e-6 and r.t[-1] == r.events[1]["time"]


main()
