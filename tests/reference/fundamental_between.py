"""fundamental_between.csv: G, G′, G″ and S = ∫G with L{G} = 1/P, P = m s² + ρ s^β + c, for damping orders between the simple ones.

Two ways that must agree to 22 digits: the double series of 1/P in powers of s^(β−2) and s^(−2), term by term, and Talbot's inversion.
The damping order is the binary double nearest to the decimal one printed. mpmath 1.3.
"""
import mpmath as mp

mp.mp.dps = 50
MASS, COEFFICIENT, STIFFNESS = 1, mp.mpf(0.5), 1
ORDERS = [0.3, 0.7, 0.9]
TIMES = [1, 1.5, 2, 3, 4, 6, 8]


def series(beta, t, shift):
    """Inverse transform of s^shift / P."""
    total = mp.mpf(0)
    for j in range(90):
        for k in range(60):
            power = 2 + 2 * k + j * (2 - beta) - shift
            term = mp.binomial(j + k, j) * (-COEFFICIENT / MASS) ** j * (-mp.mpf(STIFFNESS) / MASS) ** k
            total += term / MASS * t ** (power - 1) * mp.rgamma(power)
    return total


def talbot(beta, t, shift):
    symbol = lambda s: s**shift / (MASS * s * s + COEFFICIENT * s**beta + STIFFNESS)
    # s²/P − 1/m: without the delta that s²/P holds.
    impulse = lambda s: symbol(s) - (mp.mpf(1) / MASS if shift == 2 else 0)
    return mp.invertlaplace(impulse, t, method="talbot", degree=60)


print("alpha,beta,m,rho,c,t,G,dG,ddG,S")
for order in ORDERS:
    beta = mp.mpf(order)
    for t in TIMES:
        values = []
        for shift in [0, 1, 2, -1]:
            value = series(beta, mp.mpf(t), shift)
            assert abs(value - talbot(beta, mp.mpf(t), shift)) < mp.mpf(10) ** -22, (order, t, shift)
            values.append(mp.nstr(value, 22))
        print(f"{order / 2!r},{order!r},{MASS},{mp.nstr(COEFFICIENT)},{STIFFNESS},{t}," + ",".join(values))
