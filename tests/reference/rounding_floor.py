"""The same scheme with 70 digits: what rounding does to it in double precision.

    q'' + rho D^beta q + q = 0,  q(0) = 1, q'(0) = 0 (Caputo),  beta = 1.9, rho = 1/2, BDF 2, midpoint rule, [0, 4] in 8192 steps

with the fractional force at the main nodes and at the midpoints. Numbers are integers in units of 2^-256; the quadrature acts on
values, whose digits it cancels here to no harm. Writes rounding_floor.csv: every 256th step.
"""

from operator import mul

from mpmath import mp, mpf

mp.prec = 320
BITS = 256
ONE = 1 << BITS
STEPS, EVERY = 8192, 256
H_BITS = 11  # h = 4/8192 = 2^-11


def weights(count):
    """(gamma_2(z)/h)^beta by the recursion for a power of a polynomial, beta being the double nearest 1.9."""
    beta = mpf(1.9)
    a = [mpf(3) / 2, mpf(-2), mpf(1) / 2]
    w = [(a[0] * 2**H_BITS) ** beta]
    for n in range(1, count):
        total = sum((beta * j - n + j) * a[j] * w[n - j] for j in (1, 2) if j <= n)
        w.append(total / (n * a[0]))
    return [int(mp.nint(x * ONE)) for x in w]


def run(at_nodes):
    w = weights(STEPS + 2)
    backwards = w[::-1]
    rho = ONE // 2
    times = lambda x, y: (x * y) >> BITS
    over_h = lambda x: x << H_BITS
    of_h = lambda x: x >> H_BITS
    q, p, rows = ONE, 0, []
    samples = [] if at_nodes else [0]
    for k in range(STEPS + 1):
        if k % EVERY == 0:
            rows.append((k, q, p))
        n = len(samples)
        # sum over lags 1..n of w_lag x_{n - lag}
        known = sum(map(mul, backwards[-n - 1 : -1], samples)) >> BITS if n else 0
        if at_nodes:
            # p = e/h + (h/2)(q + e/2 + rho (w0 (q + e/2 - 1) + known))
            w0 = w[0]
            right = p - (of_h(q + times(rho, times(w0, q - ONE) + known)) >> 1)
            left = over_h(ONE) + (of_h(ONE + times(rho, w0)) >> 2)
            e = (right << BITS) // left
            x = q + (e >> 1) - ONE
            samples.append(x)
            p -= of_h(q + (e >> 1) + times(rho, times(w0, x) + known))
            q += e
        else:
            right = p - (of_h(q) >> 1)
            left = over_h(ONE) + (of_h(ONE) >> 2)
            e = (right << BITS) // left
            x = q + e - ONE
            samples.append(x)
            p -= of_h(q + (e >> 1) + times(rho, times(w[0], x) + known))
            q += e
    return rows


def decimal(number):
    return mp.nstr(mpf(number) / ONE, 25)


if __name__ == "__main__":
    forms = [run(False), run(True)]
    with open("rounding_floor.csv", "w") as out:
        print("step,main_q,main_p,node_q,node_p", file=out)
        for (k, mq, mp_), (_, nq, np_) in zip(*forms):
            print(k, *map(decimal, (mq, mp_, nq, np_)), sep=",", file=out)
