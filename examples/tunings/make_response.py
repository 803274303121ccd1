"""Makes `oven-response.csv`: P(i omega) of an oven, with noise of a seed. Needs nothing but Python.

    python3 examples/tunings/make_response.py
"""

import cmath
import math
import random
from pathlib import Path


def oven(s):
    """1.8 exp(-6 s)/((90 s + 1)(12 s + 1)), in kelvin for each watt."""
    return 1.8 * cmath.exp(-6 * s) / ((90 * s + 1) * (12 * s + 1))


random.seed(1)
lines = ["# sweep of an oven, 1 % noise; made by make_response.py", "Frequency (Hz),Magnitude (dB),Phase (deg)"]
phase = 0.0
for k in range(61):
    frequency = 10 ** (-4 + 0.05 * k)
    value = oven(2j * math.pi * frequency) * (1 + 0.01 * complex(random.gauss(0, 1), random.gauss(0, 1)) / math.sqrt(2))
    # Without jumps by 360 degrees.
    phase += math.remainder(cmath.phase(value) - phase, math.tau)
    lines.append(f"{frequency:.6g},{20 * math.log10(abs(value)):.3f},{math.degrees(phase):.2f}")
(Path(__file__).resolve().parent / "oven-response.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
