"""oscillator.csv: solutions of q″ + ½ D^β q + q = 0 for damping orders from 0.1 to 1.9, by what they are made of:
G, G′, G″, S = ∫G and J = ∫S with L{G} = 1/P, P = s² + ½ s^β + 1.

Riemann–Liouville:  q = q₀ G′ + v₀ G
Caputo, β ≤ 1:      q = q₀ (1 − S) + v₀ G
Caputo, β > 1:      q = q₀ (1 − S) + v₀ (t − J)

Two ways that must agree to 21 decimals: Talbot's inversion, and the double series of 1/P in powers of s^(β−2) and s^(−2), term by term
(above β = 1.5, where the series hardly converges, the inversion with another number of points).
The damping order is the binary double nearest to the decimal one printed. mpmath 1.3.
"""
import functools

import mpmath as mp

mp.mp.dps = 60
COEFFICIENT = mp.mpf(0.5)
ORDERS = [0.1, 0.3, 0.5, 0.7, 0.9, 1.0, 1.1, 1.3, 1.5, 1.7, 1.9]
TIMES = [1, 2, 3, 4, 6, 8]
SHIFTS = [0, 1, 2, -1, -2]


@functools.cache
def coefficients(beta, shift):
    """Powers of t and their coefficients in the inverse transform of s^shift / P, without the delta that s²/P holds."""
    terms = []
    for j in range(100):
        for k in range(45):
            power = 2 + 2 * k + j * (2 - beta) - shift
            factor = mp.binomial(j + k, j) * (-COEFFICIENT) ** j * mp.mpf(-1) ** k
            terms.append((power - 1, factor * mp.rgamma(power)))
    return terms


def series(beta, t, shift):
    """Inverse transform of s^shift / P."""
    return mp.fsum(factor * t**power for power, factor in coefficients(beta, shift))


def talbot(beta, t, shift, degree=70):
    symbol = lambda s: s**shift / (s * s + COEFFICIENT * s**beta + 1) - (1 if shift == 2 else 0)
    return mp.invertlaplace(symbol, t, method="talbot", degree=degree)


print("beta,t,G,dG,ddG,S,J")
for order in ORDERS:
    for t in TIMES:
        values = []
        for shift in SHIFTS:
            beta, time = mp.mpf(order), mp.mpf(t)
            value = talbot(beta, time, shift)
            # Near β = 2 the series hardly converges: two degrees of the inversion then.
            other = series(beta, time, shift) if order <= 1.5 else talbot(beta, time, shift, degree=54)
            assert abs(value - other) < mp.mpf(10) ** -21, (order, t, shift, value - other)
            values.append(mp.nstr(value, 21))
        print(f"{order!r},{t}," + ",".join(values))
