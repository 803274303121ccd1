"""Makes the data of the fits in this folder: exact solutions, and noise of a seed. Needs nothing but Python.

    python3 examples/fits/make_data.py
"""

import cmath
import math
import random
from pathlib import Path

HERE = Path(__file__).resolve().parent


def inverse_laplace(transform, time, nodes=56):
    """f(t) of its Laplace transform, along Talbot's contour, to 6 digits.

    All singularities must lie to the left of the contour: frequencies up to nodes/(2t).
    """
    scale = 2 * nodes / (5 * time)
    total = 0.5 * math.exp(scale * time) * transform(complex(scale)).real
    for k in range(1, nodes):
        angle = k * math.pi / nodes
        cotangent = 1 / math.tan(angle)
        place = scale * angle * (cotangent + 1j)
        slope = 1 + 1j * (angle * (1 + cotangent**2) - cotangent)
        total += (cmath.exp(time * place) * transform(place) * slope).real
    return total * scale / nodes


def write(name, header, comment, rows):
    lines = [f"# {comment}; made by make_data.py", header, *(",".join(f"{number:.6g}" for number in row) for row in rows)]
    (HERE / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


# A fractionally damped oscillator, q̈ + 0.3 D^0.6 q + 4 q = 0, released from q = 1 at rest.
random.seed(1)
decay = lambda s: (s + 0.3 * s ** (0.6 - 1)) / (s**2 + 0.3 * s**0.6 + 4)
times = [0.05 * k for k in range(1, 241)]
rows = [(t, inverse_laplace(decay, t) + random.gauss(0, 0.01)) for t in times]
write("decay.csv", "t,q0", "positions with a standard deviation of 0.01", rows)

# A mass of 0.5 on a fractional Zener spring, 40 + 60 K(s), K(s) = (0.02 s)^0.45/(1 + (0.02 s)^0.45): the moduli of the
# spring over four decades, with deviations of 1 % of their magnitude, and the decay of the mass, released from q = 0.01,
# where it had rested.
random.seed(3)
kernel = lambda s: (0.02 * s) ** 0.45 / (1 + (0.02 * s) ** 0.45)
rows = []
for k in range(41):
    omega = 0.1 * 10 ** (k / 10)
    modulus = 40 + 60 * kernel(1j * omega)
    size = 0.01 * abs(modulus)
    rows.append((omega, modulus.real + random.gauss(0, size), modulus.imag + random.gauss(0, size)))
write("spring-moduli.csv", "omega,storage,loss", "storage and loss with a standard deviation of 1 % of the modulus", rows)
motion = lambda s: 0.01 * (0.5 * s + 60 * kernel(s) / s) / (0.5 * s**2 + 40 + 60 * kernel(s))
rows = [(t, inverse_laplace(motion, t) + random.gauss(0, 5e-5)) for t in [0.01 * k for k in range(1, 151)]]
write("spring-decay.csv", "t,q0", "positions with a standard deviation of 5e-5", rows)
