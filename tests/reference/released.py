"""released.csv: q and q′ of q″ + ρ D^β q + k q = 0 in Caputo's sense, let go from q = 1 at rest.

L{q} = (s + ρ s^(β−1))/P, L{q′} = −k/P, P = s² + ρ s^β + k. Two ways that agree to 20 decimals: the residues at the two poles with the integral along the cut,
and with Talbot's inversion of what the poles leave. The orders are the doubles nearest to the decimals printed. mpmath 1.3.
"""
import mpmath as mp

mp.mp.dps = 40
ROUND = [0.001, 0.01, 0.1] + [0.5 * k for k in range(1, 41)]
MOTIONS = [
    (1, 0.3, 1, ROUND),
    (1, 0.5, 1, ROUND),
    (1, 0.7, 1, ROUND),
    (1, 1.5, 1, ROUND + [20.0 + k for k in range(1, 11)]),
    (20, 0.5, 1, [10.0**k for k in range(-6, 9)]),
    (10000, 0.5, 1000000, [1e-5, 1e-4] + ROUND),
]


def cut(symbol, t):
    """The integral along both sides of the negative real axis; s = −x below it, x = e^y."""
    def integrand(y):
        x = mp.exp(y)
        below = lambda exponent: x**exponent * mp.expjpi(-exponent)
        return x * mp.exp(-x * t) * mp.im(symbol(below))

    last = mp.log(100 / t)
    return mp.quad(integrand, mp.linspace(last - 220, last, 45)) / mp.pi


print("rho,beta,k,t,q,p")
for rho, order, k, times in MOTIONS:
    beta = mp.mpf(order)
    # Functions of the powers of s.
    characteristic = lambda power: power(2) + rho * power(beta) + k
    numerators = [lambda power: power(1) + rho * power(beta - 1), lambda power: mp.mpf(-k)]
    powers = lambda s: lambda exponent: s**exponent
    slope = lambda s: 2 * s + rho * beta * s ** (beta - 1)
    pole = max(mp.sqrt(k), rho ** (1 / (2 - beta))) * mp.expjpi(0.6)
    for _ in range(60):
        pole -= characteristic(powers(pole)) / slope(pole)
    assert mp.im(pole) > 0 and abs(characteristic(powers(pole))) < mp.mpf(10) ** -30 * abs(pole) ** 2
    for t in times:
        time, found = mp.mpf(t), []
        for numerator in numerators:
            symbol = lambda power: numerator(power) / characteristic(power)
            residue = numerator(powers(pole)) / slope(pole)
            mode = 2 * mp.re(residue * mp.exp(pole * time))
            value = mode + cut(symbol, time)
            poles = lambda s: residue / (s - pole) + mp.conj(residue) / (s - mp.conj(pole))
            with mp.workdps(70):
                other = mode + mp.invertlaplace(lambda s: symbol(powers(s)) - poles(s), time, method="talbot", degree=70)
            assert abs(value - other) < mp.mpf(10) ** -20, (rho, order, t, value, other)
            found.append(mp.nstr(value, 20))
        print(f"{rho},{order!r},{k},{t!r}," + ",".join(found))
