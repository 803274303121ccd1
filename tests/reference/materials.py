"""materials.csv: position and momentum of motions that memories of materials damp, to 20 digits.

    zener      q″ + ½ q + 3/2 K(D) q = 0          K = s^0.6/(1 + s^0.6)                      Caputo, q₀ = 1
    tempered   q″ + q + 4/5 K(D) q = 0            K = (s + ½)^0.6 − (½)^0.6                   Caputo, q₀ = 1
    polymer    q″ + 3/25 q + K(D) q = 0           K = Σ g τ s/(1 + τ s)                       v₀ = 1
    body       2 q″ + 3 q + K(D) q = 0            K = s Ĝ, G linear between rows              Caputo, q₀ = 1
    basset     q″ + 3 D^(3/2) q + q′ = 1          from rest

By Talbot's inversion with two numbers of points. The kernel of the floating body has delays e^(−ks), by whose powers the solution is expanded,
so that each term is a rational function; that of the settling sphere has a velocity in closed form, with erfc. mpmath 1.3.
"""
import mpmath as mp

mp.mp.dps = 60
TIMES = [1, 2, 4, 8]
ORDER = mp.mpf(0.6)
STRENGTHS = [mp.mpf(g) for g in (0.22, 0.25, 0.21, 0.13, 0.07)]
RELAXATION_TIMES = [mp.mpf(t) for t in (1e-3, 1e-2, 0.1, 1.0, 10.0)]
ROWS = [mp.mpf(g) for g in (1.0, 0.25, -0.1, 0.03, 0.0)]


def invert(image, t):
    """The inverse transform at t, by two degrees that must agree."""
    one, other = (mp.invertlaplace(image, t, method="talbot", degree=degree) for degree in (60, 74))
    assert abs(one - other) < mp.mpf(10) ** -22, (t, one - other)
    return one


def released(mass, stiffness, kernel, start=(1, 0)):
    """q̂ and q̇̂ of M q″ + k q + K(D)(q − q₀) = 0."""
    q0, v0 = start
    position = lambda s: q0 / s + (mass * v0 - stiffness * q0 / s) / (mass * s * s + stiffness + kernel(s))
    return position, lambda s: s * position(s) - q0


def by_transform(images, mass):
    return lambda t: (invert(images[0], t), mass * invert(images[1], t))


def body(t):
    """1/P = Σ_k c_k(s) e^(−ks), P = 2s² + 3 + K, K = G₀ + Σ_i m_i (e^(−is) − e^(−(i+1)s))/s."""
    slopes = [b - a for a, b in zip(ROWS, ROWS[1:])]
    delayed = [slopes[0]] + [b - a for a, b in zip(slopes, slopes[1:])] + [-slopes[-1]]

    def coefficients(s):
        symbol = [2 * s * s + 3 + ROWS[0] + delayed[0] / s] + [m / s for m in delayed[1:]]
        series = [1 / symbol[0]]
        for k in range(1, t + 1):
            past = mp.fsum(symbol[i] * series[k - i] for i in range(1, min(k, len(symbol) - 1) + 1))
            series.append(-past / symbol[0])
        return series

    def total(factor):
        terms = [invert(lambda s, k=k: factor(s) * coefficients(s)[k], mp.mpf(t - k)) for k in range(t)]
        return mp.fsum(terms)

    return 1 - 3 * total(lambda s: 1 / s), -2 * 3 * total(lambda s: mp.mpf(1))


def basset(t):
    alpha, beta = (3 - mp.sqrt(5)) / 2, (3 + mp.sqrt(5)) / 2
    part = lambda x: (1 - mp.exp(x * x * t) * mp.erfc(x * mp.sqrt(t))) / x
    velocity = (part(alpha) - part(beta)) / (beta - alpha)
    image = lambda s: 1 / (s * (s * s + 3 * s ** mp.mpf(1.5) + s))
    assert abs(velocity - invert(lambda s: s * image(s), t)) < mp.mpf(10) ** -21
    return invert(image, t), velocity


zener = lambda s: mp.mpf(1.5) * s**ORDER / (1 + s**ORDER)
tempered = lambda s: mp.mpf(0.8) * ((s + mp.mpf(0.5)) ** ORDER - mp.mpf(0.5) ** ORDER)
polymer = lambda s: mp.fsum(g * tau * s / (1 + tau * s) for g, tau in zip(STRENGTHS, RELAXATION_TIMES))
MOTIONS = {
    "zener": by_transform(released(1, mp.mpf(0.5), zener), 1),
    "tempered": by_transform(released(1, 1, tempered), 1),
    "polymer": by_transform(released(1, mp.mpf(0.12), polymer, (0, 1)), 1),
    "body": body,
    "basset": basset,
}

print("motion,t,q,p")
for name, motion in MOTIONS.items():
    for t in TIMES:
        print(f"{name},{t}," + ",".join(mp.nstr(number, 20) for number in motion(t)))
