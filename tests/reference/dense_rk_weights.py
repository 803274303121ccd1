"""Matrix weights of Runge–Kutta convolution quadrature, to 25 digits, by means independent of the library.

(Δ(z))^β with Δ(z) = A⁻¹ − z A⁻¹ 1 bᵀ A⁻¹, h = 1. For n ≤ 64 its coefficients by Cauchy's formula on a circle of radius
10^(−30/256) with 256 points and 90 digits, the power from the eigenvalues; for larger n from the integral over the
cut by adaptive tanh–sinh quadrature with 40 digits. At n = 64 the two agree to 25 digits (asserted).

    python3 dense_rk_weights.py     writes runge_kutta_weights.csv beside itself (needs mpmath)

Columns: family (0 Radau IIA, 1 Lobatto IIIC), stages, beta, n, row, column, weight.
"""

import os
from mpmath import mp, mpf, mpc, matrix, sqrt, sin, pi, inf, quad, eye, ones, inverse, eig, diag, exp, linspace

mp.dps = 90


def tableaux():
    s6, s5 = sqrt(6), sqrt(5)
    one, h = mpf(1), mpf(1) / 2
    radau = {
        1: ([[one]], [one]),
        2: ([[one * 5 / 12, -one / 12], [one * 3 / 4, one / 4]], [one / 3, one]),
        3: (
            [
                [(88 - 7 * s6) / 360, (296 - 169 * s6) / 1800, (-2 + 3 * s6) / 225],
                [(296 + 169 * s6) / 1800, (88 + 7 * s6) / 360, (-2 - 3 * s6) / 225],
                [(16 - s6) / 36, (16 + s6) / 36, one / 9],
            ],
            [(4 - s6) / 10, (4 + s6) / 10, one],
        ),
    }
    lobatto = {
        2: ([[h, -h], [h, h]], [mpf(0), one]),
        3: (
            [
                [one / 6, -one / 3, one / 6],
                [one / 6, one * 5 / 12, -one / 12],
                [one / 6, one * 2 / 3, one / 6],
            ],
            [mpf(0), h, one],
        ),
        4: (
            [
                [one / 12, -s5 / 12, s5 / 12, -one / 12],
                [one / 12, one / 4, (10 - 7 * s5) / 60, s5 / 60],
                [one / 12, (10 + 7 * s5) / 60, one / 4, -s5 / 60],
                [one / 12, one * 5 / 12, one * 5 / 12, one / 12],
            ],
            [mpf(0), (5 - s5) / 10, (5 + s5) / 10, one],
        ),
    }
    return [(0, r, t) for r, t in radau.items()] + [(1, r, t) for r, t in lobatto.items()]


def power(m, beta):
    values, vectors = eig(m)
    return vectors * diag([v**beta for v in values]) * inverse(vectors)


def near_weights(a, b, beta, count, points=256):
    r = len(b)
    inv = inverse(a)
    rank_one = inv * ones(r, 1) * (b.T * inv)
    radius = mpf(10) ** (-mpf(30) / points)
    zs = [radius * exp(2j * pi * k / points) for k in range(points)]
    values = [power(inv - z * rank_one, beta) for z in zs]
    weights = []
    for n in range(count):
        total = matrix(r, r)
        for z, v in zip(zs, values):
            total += v * z ** (-n)
        weights.append((total / points).apply(lambda x: x.real))
    return weights


def far_weight(a, b, beta, n):
    r = len(b)
    e = ones(r, 1)
    cache = {}

    def parts(y):
        if y not in cache:
            x = exp(y)
            m = inverse(eye(r) + x * a)
            u, v = m * e, b.T * m
            stability = 1 - x * (b.T * u)[0]
            cache[y] = (x ** (beta + 1) * stability ** (n - 1), u, v)
        return cache[y]

    result = matrix(r, r)
    from mpmath import log
    low, high = -mpf(60) / (1 + beta) * 1 - log(n), log(mpf(60) / n) + 4
    pieces = linspace(low, high, 9)
    for i in range(r):
        for j in range(r):
            integral = quad(lambda y: parts(y)[0] * parts(y)[1][i] * parts(y)[2][j], pieces)
            result[i, j] = -sin(pi * beta) / pi * integral
    return result


if __name__ == "__main__":
    folder = os.path.dirname(os.path.abspath(__file__))
    with open(os.path.join(folder, "runge_kutta_weights.csv"), "w") as file:
        file.write("family,stages,beta,n,row,column,weight\n")
        for family, r, (rows, nodes) in tableaux():
            for beta in [mpf("-0.5"), mpf("0.25"), mpf("0.5"), mpf("0.9375"), mpf("1.0625"), mpf("1.5"), mpf("1.875")]:
                mp.dps = 90
                a, b = matrix(rows), matrix(rows[-1])
                # 256 points alias n + 256 onto n with 10^-30.
                near = near_weights(a, b, beta, 65)
                mp.dps = 40
                chosen = {n: near[n] for n in [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 15, 16, 17, 31, 64]}
                check = far_weight(a, b, beta, 64)
                for i in range(r):
                    for j in range(r):
                        assert abs(check[i, j] / near[64][i, j] - 1) < mpf(10) ** -25, (family, r, beta, i, j)
                for n in [1000, 20000]:
                    chosen[n] = far_weight(a, b, beta, n)
                for n, w in chosen.items():
                    for i in range(r):
                        for j in range(r):
                            file.write(f"{family},{r},{mp.nstr(beta, 8)},{n},{i},{j},{mp.nstr(w[i, j], 25)}\n")
                file.flush()
                print(family, r, beta)
