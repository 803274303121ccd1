"""Solutions of the linear equations of this folder, to 17 digits: `python references.py` with mpmath writes the tables again.

Each solution is known by its Laplace transform, which is inverted on Talbot's contour in 60 digits, with two numbers of points
that have to agree.
"""

from pathlib import Path

import mpmath as mp

mp.mp.dps = 60
DEGREES = (90, 120)


def number(text):
    return mp.mpf(text)


def inverse(transform, t):
    first, second = (mp.invertlaplace(transform, t, method="talbot", degree=degree) for degree in DEGREES)
    assert abs(first - second) < mp.mpf("1e-18"), (t, first - second)
    return second


def relaxation(s):
    return [s ** number("-0.4") / (s ** number("0.6") + 10)]


def oscillation(s):
    return [1 / s / (s ** number("1.8") + 1)]


def order_3_7(s):
    return [(s ** number("2.7") + 1 / (s * s + 1)) / (s ** number("3.7") + 1)]


def furnace(s):
    return [1 / s / (number("0.8") * s ** number("2.2") + number("0.5") * s ** number("0.9") + 1)]


def six_terms(s):
    left = s**3 + s ** number("2.5") / 16 + number("0.8") * s * s + number("1.5") * s + mp.sqrt(s) / 25 + number("1.2")
    return [number(172) / 125 * s / (s * s + number("0.64")) / left]


def negative_term(s):
    return [1 / s / (s ** number("0.9") - s ** number("0.4") / 2 + 2)]


def stiff(s):
    slow, fast = (1 / mp.sqrt(s) / (mp.sqrt(s) + rate) for rate in (1, 199))
    return [(slow + fast) / 2, (slow - fast) / 2]


TABLES = {
    "relaxation": (relaxation, ["1e-6", "1e-4", "0.01", "0.1", "1", "2", "5"]),
    "oscillation": (oscillation, ["0.1", "1", "2", "5", "10", "15", "20"]),
    "order-3.7": (order_3_7, ["0.1", "1", "2", "4", "6", "8"]),
    "furnace": (furnace, ["0.1", "1", "2", "5", "10", "15", "20"]),
    "six-terms": (six_terms, ["0.1", "1", "2", "5", "10", "20", "30"]),
    "negative-term": (negative_term, ["0.01", "0.1", "1", "2", "5", "10"]),
    "stiff": (stiff, ["1e-6", "1e-4", "0.01", "0.1", "1", "5", "10"]),
}

for name, (transform, times) in TABLES.items():
    size = len(transform(number(2)))
    lines = [",".join(["t", *(f"x{index}" for index in range(size))])]
    for time in times:
        values = [inverse(lambda s: transform(s)[index], number(time)) for index in range(size)]
        lines.append(",".join([time, *(mp.nstr(value, 17) for value in values)]))
    Path(__file__).with_name(f"{name}-reference.csv").write_text("\n".join(lines) + "\n")
