"""Weights of backward differentiation formulas for kernels other than s^β, 24 digits, for kernel_weights.csv.

w_n are the Taylor coefficients of K(γ_p(z)/h). Up to n = 512 Cauchy's integral on a circle in 100 digits; beyond, the
integral over the cut of K, or the part of its pole, with 40 or 100; at n = 512 both must agree to 28 digits. Parameters are
binary doubles. mpmath 1.3.
"""
import mpmath as mp

mp.mp.dps = 100
LAGS = [0, 1, 2, 3, 5, 8, 16, 33, 64, 100, 256, 511, 512, 513, 1000, 12345, 10**5, 10**6]
LAST = 512
POINTS = 2048
RADIUS = mp.mpf("0.9")


def tempered(order, rate):
    order, rate = mp.mpf(order), mp.mpf(rate)
    return lambda s: (s + rate) ** order - rate**order, rate


def maxwell(order, inner, time):
    order, inner, time = mp.mpf(order), mp.mpf(inner), mp.mpf(time)
    return lambda s: (time * s) ** order / (1 + (time * s) ** (order - inner)), 0


def havriliak(order, power, time):
    order, power, time = mp.mpf(order), mp.mpf(power), mp.mpf(time)
    return lambda s: 1 - (1 + (time * s) ** order) ** (-power), 1 / time if order == 1 else 0


def prony(strength, time):
    strength, time = mp.mpf(strength), mp.mpf(time)
    return lambda s: strength * time * s / (1 + time * s), 1 / time


KERNELS = [
    ("tempered", (0.5, 0.3), tempered),
    ("tempered", (1.5, 0.002), tempered),
    ("maxwell", (0.6, 0.0, 1.5), maxwell),
    ("maxwell", (0.9, 0.4, 0.5), maxwell),
    ("maxwell", (0.95, 0.0, 20.0), maxwell),
    ("havriliak-negami", (0.7, 0.5, 1.0), havriliak),
    ("havriliak-negami", (1.0, 0.4, 70.0), havriliak),
    ("prony", (1.3, 70.0), prony),
]


def formula(p, z):
    return sum((1 - z) ** j / j for j in range(1, p + 1))


def on_circle(kernel, p, h):
    mp.mp.dps = 100
    half = POINTS // 2
    turns = [mp.expjpi(mp.mpf(2 * k) / POINTS) for k in range(POINTS)]
    values = [kernel(formula(p, RADIUS * turns[k]) / h) for k in range(half + 1)]

    def weight(n):
        total = values[0] + values[half] * (-1) ** n
        total += 2 * mp.fsum((values[k] * turns[-n * k % POINTS]).real for k in range(1, half))
        return (total / POINTS / RADIUS**n).real

    return weight


def over_the_cut(kernel, start, p, h):
    # Next to a branch point behind 0 distances from it cancel.
    digits = mp.mp.dps = 100 if start else 40

    def g(m):
        return -formula(p, 1 + m)

    place = mp.findroot(lambda m: g(m) - start * h, start * h) if start else mp.mpf(0)

    def weight(n):
        mp.mp.dps = digits

        def of(y):
            d = mp.exp(y) / n
            m = place + d
            jump = kernel(mp.mpc(-g(m) / h, 0))
            # Relative to the decay of the branch point: the quadrature ends where errors are small by themselves.
            return -jump.imag / mp.pi * d * mp.exp(-(n + 1) * mp.log1p(d / (1 + place)))

        # Where g turns there are other parts of the cut, that have died out.
        last = mp.log(min(mp.mpf(130), mp.mpf(n) / 4))
        places = mp.linspace(-200, last, 120)
        return mp.quad(of, places, maxdegree=7) * (1 + place) ** (-n - 1)

    return weight


def of_the_pole(kernel, start, p, h):
    """K = K(∞) + residue/(s + start): residue·h/(g′(m) (1 + m)) (1 + m)^(−n) of the zero m of g − start h next to 0."""
    mp.mp.dps = 100
    g = lambda m: -formula(p, 1 + m)
    place = mp.findroot(lambda m: g(m) - start * h, start * h)
    slope = sum((-place) ** (i - 1) for i in range(1, p + 1))
    residue = -kernel(mp.mpf(1)) * (1 + start)
    residue = residue * start
    return lambda n: residue * h / (slope * (1 + place)) * (1 + place) ** (-n)


print("form,parameters,order,step,n,weight")
for name, parameters, make in KERNELS:
    for p in (1, 2, 4):
        h = mp.mpf(0.05)
        kernel, start = make(*parameters)
        near, far = on_circle(kernel, p, h), None
        rows = {}
        for n in LAGS:
            if n <= LAST:
                mp.mp.dps = 100
                rows[n] = near(n)
            else:
                far = far or (of_the_pole if name == "prony" else over_the_cut)(kernel, start, p, h)
                rows[n] = far(n)
        both = far(LAST)
        assert abs(both / rows[LAST] - 1) < mp.mpf(10) ** -28, (name, parameters, p, both, rows[LAST])
        text = " ".join(repr(number) for number in parameters)
        for n in LAGS:
            print(f"{name},{text},{p},0.05,{n},{mp.nstr(rows[n], 24)}", flush=True)
