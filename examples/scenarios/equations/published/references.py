"""Solutions of the published test problems of this folder that have no short formula: `python references.py` with mpmath
writes the tables again, to 17 digits.

Linear problems are inverted from their Laplace transforms on Talbot's contour in 60 digits, with two numbers of points that
have to agree, or are sums of Mittag-Leffler functions of order ½, E_½(z) = exp(z²) erfc(−z), over the eigenvalues of a matrix.
"""

from pathlib import Path

import mpmath as mp

mp.mp.dps = 60
DEGREES = (300, 360)


def number(text):
    return mp.mpf(text)


def inverse(transform, t):
    first, second = (mp.invertlaplace(transform, t, method="talbot", degree=degree) for degree in DEGREES)
    assert abs(first - second) < mp.mpf("1e-18"), (t, first - second)
    return second


def relaxation(order, rate):
    """D^α x = −λ x from 1."""
    return lambda t: [inverse(lambda s: s ** (order - 1) / (s**order + rate), t)]


def oscillator(t):
    """x'' − x' + 1.2 D^0.75 x + 4 x = 0 from x = x' = −½."""

    def transform(s):
        left = s * s - s + number("1.2") * s ** number("0.75") + 4
        return (-(s + 1) / 2 + number("0.5") - number("0.6") * s ** number("-0.25")) / left

    return [inverse(transform, t)]


def five_unknowns(t):
    """Σ_j c_j E_½(λ_j √t) v_j with the eigenvectors v_j of the matrix and Σ c_j v_j = x(0)."""
    rows = [[41, 41, -38, 40, -2], [-79, 81, 2, 0, -2], [20, -60, 20, -20, -8], [-22, 58, -24, 20, -4], [1, 1, -2, -4, -2]]
    values, vectors = mp.eig(mp.matrix(rows) / 8)
    shares = mp.lu_solve(vectors, mp.matrix([1, 2, 3, 4, 5]))
    grown = []
    for value, share in zip(values, shares):
        z = value * mp.sqrt(t)
        grown.append(share * mp.exp(z * z) * mp.erfc(-z))
    return [mp.re(entry) for entry in vectors * mp.matrix(grown)]


TABLES = {
    "fractionaldiffeq-linear": (relaxation(number("0.8"), 10), ["1e-6", "1e-4", "0.01", "0.1", "1", "2", "5"]),
    "fractionaldiffeq-oscillator": (oscillator, ["0.01", "0.1", "1", "5", "10", "20", "35", "50"]),
    "fhbvm-oscillating": (five_unknowns, ["1e-4", "0.01", "0.1", "0.5", "1", "2"]),
    "long-relaxation": (relaxation(number("0.6"), 1), ["1e-3", "1", "10", "100", "1000", "1e4", "1e6"]),
    "long-order-0.3": (relaxation(number("0.3"), 1), ["1e-3", "1", "10", "100", "1000", "1e4"]),
}

for name, (solution, times) in TABLES.items():
    rows = [[time, *(mp.nstr(value, 17) for value in solution(number(time)))] for time in times]
    header = ",".join(["t", *(f"x{index}" for index in range(len(rows[0]) - 1))])
    lines = [header, *(",".join(row) for row in rows)]
    Path(__file__).with_name(f"{name}-reference.csv").write_text("\n".join(lines) + "\n")
