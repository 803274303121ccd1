"""Golden trajectories of the Galerkin schemes, damped at the main nodes (BDF) or at the stages (Runge–Kutta quadrature).

Independent of the library and plain: 60-digit arithmetic (mpmath), polynomials in the monomial basis, the discrete action from its
definition, its derivatives by central differences, every history by the double sum over all earlier samples, each step by
Newton's method with a difference Jacobian.

    python3 dense_galerkin.py            writes trajectory_<name>.csv beside itself (needs mpmath)

Columns: t, q0…, p0…, 25 digits. Problems: see PROBLEMS; the tests repeat their definitions.
"""

import os
from mpmath import mp, mpf, matrix, cos, sin, lu_solve, inverse, legendre, findroot, sqrt, pi
from dense_rk_weights import tableaux, near_weights
from dense_bdf import bdf_weights

mp.dps = 60


def gauss(n):
    near = [cos(pi * (k + mpf(3) / 4) / (n + mpf(1) / 2)) for k in range(n)]
    width = mpf("0.02")
    roots = sorted(findroot(lambda x: legendre(n, x), (x - width, x + width), solver="anderson") for x in near)
    nodes = [(1 + x) / 2 for x in roots]
    return nodes, moments(nodes)


def lobatto(n):
    inner = {2: [], 3: [mpf(0)], 4: [-1 / sqrt(mpf(5)), 1 / sqrt(mpf(5))],
             5: [-sqrt(mpf(3) / 7), mpf(0), sqrt(mpf(3) / 7)],
             6: [s * sqrt(mpf(1) / 3 + t * 2 * sqrt(mpf(7)) / 21) for s, t in [(-1, 1), (-1, -1), (1, -1), (1, 1)]],
             7: [-sqrt((15 + 2 * sqrt(mpf(15))) / 33), -sqrt((15 - 2 * sqrt(mpf(15))) / 33), mpf(0),
                 sqrt((15 - 2 * sqrt(mpf(15))) / 33), sqrt((15 + 2 * sqrt(mpf(15))) / 33)]}[n]
    nodes = [(1 + x) / 2 for x in [mpf(-1)] + inner + [mpf(1)]]
    return nodes, moments(nodes)


def moments(nodes):
    """Weights that integrate 1, τ, τ², … exactly on [0, 1]."""
    n = len(nodes)
    system = matrix(n, n)
    for k in range(n):
        for i in range(n):
            system[k, i] = nodes[i] ** k
    w = lu_solve(system, matrix([mpf(1) / (k + 1) for k in range(n)]))
    return [w[i] for i in range(n)]


def simulate(problem):
    h, steps, n, degree = problem["h"], problem["steps"], problem["n"], problem["degree"]
    mass, potential, force = problem["mass"], problem["potential"], problem["force"]
    family, count = problem["rule"]
    stages_damped = family in ("radau", "lobatto-iiic")
    if stages_damped:
        rows, c = next(t for f, r, t in tableaux() if f == ("lobatto-iiic" == family) and r == count)
        a_rk, b_rk = matrix(rows), matrix(rows[-1])
        b = list(rows[-1])
    else:
        c, b = gauss(count) if family == "gauss" else lobatto(count)
    d, _ = lobatto(degree + 1)
    vandermonde = matrix(degree + 1, degree + 1)
    for i in range(degree + 1):
        for k in range(degree + 1):
            vandermonde[i, k] = d[i] ** k
    basis = inverse(vandermonde)  # column ν: monomial coefficients of ℓ_ν
    value = [[sum(basis[k, v] * x**k for k in range(degree + 1)) for v in range(degree + 1)] for x in c]
    slope = [[sum(k * basis[k, v] * x ** (k - 1) for k in range(1, degree + 1)) for v in range(degree + 1)] for x in c]

    q, p = [matrix(problem["q0"])], [matrix(problem["p0"])]
    v0 = lu_solve(mass, p[0])
    terms = []
    for rho, beta, caputo in problem["damping"]:
        if stages_damped:
            mp.dps = 90
            w = [m / h**beta for m in near_weights(a_rk, b_rk, beta, steps, points=2 * steps)]
            mp.dps = 60
        else:
            w = bdf_weights(problem["order"], beta, h, steps + 1)
        terms.append((matrix(rho), beta, caputo, w))

    def acted_on(x, t, beta, caputo):
        if caputo and beta > 0:
            x = x - q[0]
            if beta > 1:
                x = x - v0 * t
        return x

    def combination(nodes, factors):
        total = matrix(n, 1)
        for x, f in zip(nodes, factors):
            total += x * f
        return total

    def action(nodes):
        total = mpf(0)
        for i in range(len(c)):
            v = combination(nodes, slope[i]) / h
            total += h * b[i] * ((v.T * mass * v)[0] / 2 - potential(combination(nodes, value[i])))
        return total

    def gradient(nodes, index):
        eps = mpf(10) ** -15
        out = matrix(n, 1)
        for i in range(n):
            total = mpf(0)
            # Sixth-order difference.
            for shift, factor in [(1, mpf(45)), (2, mpf(-9)), (3, mpf(1))]:
                for sign in (1, -1):
                    moved = [x.copy() for x in nodes]
                    moved[index][i] += sign * shift * eps
                    total += sign * factor * action(moved)
            out[i] = total / (60 * eps)
        return out

    history = []  # stage values of earlier steps

    for k in range(steps):
        # What the earlier steps contribute to the damping at stage i.
        past = None
        if stages_damped:
            past = []
            for i in range(len(c)):
                total = matrix(n, 1)
                for rho, beta, caputo, w in terms:
                    for m in range(1, k + 1):
                        for j in range(len(c)):
                            t = (k - m + c[j]) * h
                            total += rho * acted_on(history[k - m][j], t, beta, caputo) * w[m][i, j]
                past.append(total)

        def work(nodes):
            """Virtual work of the force (and of the stage damping) on every node."""
            x = [combination(nodes, value[i]) for i in range(len(c))]
            out = [matrix(n, 1) for _ in range(degree + 1)]
            for i in range(len(c)):
                f = matrix(force((k + c[i]) * h, x[i]))
                if stages_damped:
                    f = f - past[i]
                    for rho, beta, caputo, w in terms:
                        for j in range(len(c)):
                            f = f - rho * acted_on(x[j], (k + c[j]) * h, beta, caputo) * w[0][i, j]
                for v in range(degree + 1):
                    out[v] += f * (h * b[i] * value[i][v])
            return out

        def nodes_of(unknowns):
            return [q[k]] + [matrix([unknowns[v * n + i] for i in range(n)]) for v in range(degree)]

        def residual(unknowns):
            nodes = nodes_of(unknowns)
            f = work(nodes)
            out = []
            for v in range(degree):
                r = gradient(nodes, v) + f[v]
                if v == 0:
                    r = r + p[k]
                out += [r[i] for i in range(n)]
            return matrix(out)

        velocity = lu_solve(mass, p[k])
        unknowns = matrix([q[k][i] + h * d[v + 1] * velocity[i] for v in range(degree) for i in range(n)])
        size = degree * n
        jacobian = matrix(size, size)
        eps = mpf(10) ** -12
        for j in range(size):
            up, down = unknowns.copy(), unknowns.copy()
            up[j] += eps
            down[j] -= eps
            column = (residual(up) - residual(down)) / (2 * eps)
            for i in range(size):
                jacobian[i, j] = column[i]
        for _ in range(80):
            change = lu_solve(jacobian, residual(unknowns))
            unknowns = unknowns - change
            if max(abs(x) for x in change) < mpf(10) ** -32:
                break
        else:
            raise RuntimeError("no convergence")
        nodes = nodes_of(unknowns)
        momentum = gradient(nodes, degree) + work(nodes)[degree]
        q.append(nodes[-1])
        if stages_damped:
            history.append([combination(nodes, value[i]) for i in range(len(c))])
        else:
            for rho, beta, caputo, w in terms:
                for m in range(k + 2):
                    momentum -= h * rho * acted_on(q[k + 1 - m], (k + 1 - m) * h, beta, caputo) * w[m]
        p.append(momentum)
    return q, p


COUPLED = dict(
    n=2,
    mass=matrix([["2", "0.5"], ["0.5", "1"]]),
    q0=["0.5", "-0.25"],
    p0=["0.125", "1"],
    potential=lambda q: 3 * q[0] ** 2 / 2 + q[0] ** 4 / 4 + q[1] ** 2 - cos(q[0] - q[1]),
    force=lambda t, q: [cos(2 * t) - q[1] / 4, t * q[0] / 8],
    damping=[
        ([["0.5", "0.25"], ["0.25", "0.5"]], mpf("0.75"), False),
        ([["0.25", "0"], ["0", "0.125"]], mpf("1.5"), True),
    ],
)
PENDULUM = dict(
    n=1,
    mass=matrix([["1.5"]]),
    q0=["2"],
    p0=["0.3"],
    potential=lambda q: -mpf("9.75") * cos(q[0]),
    force=lambda t, q: [mpf(0)],
    damping=[([["0.375"]], mpf("0.5"), True)],
)
HARDENING = dict(
    n=1,
    mass=matrix([["1"]]),
    q0=["1"],
    p0=["-0.5"],
    potential=lambda q: q[0] ** 2 / 2 + q[0] ** 4 / 4,
    force=lambda t, q: [sin(3 * t) - q[0] ** 2 / 8],
)
PROBLEMS = {
    # BDF at the main nodes.
    "galerkin_pendulum": dict(PENDULUM, rule=("gauss", 2), degree=2, order=2, h=mpf("0.0625"), steps=120),
    "galerkin_coupled": dict(COUPLED, rule=("lobatto", 4), degree=3, order=3, h=mpf("0.0625"), steps=60),
    "galerkin_high": dict(
        PENDULUM, rule=("gauss", 6), degree=6, order=6, h=mpf("0.125"), steps=40,
        damping=[([["0.0078125"]], mpf("1.25"), False)],
    ),
    # Runge–Kutta quadrature at the stages.
    "radau_pendulum": dict(PENDULUM, rule=("radau", 3), degree=3, h=mpf("0.125"), steps=60),
    "radau_coupled": dict(COUPLED, rule=("radau", 2), degree=2, h=mpf("0.125"), steps=40),
    "lobatto_coupled": dict(COUPLED, rule=("lobatto-iiic", 3), degree=2, h=mpf("0.125"), steps=40),
    "lobatto_steep": dict(
        HARDENING, rule=("lobatto-iiic", 4), degree=3, h=mpf("0.125"), steps=40,
        damping=[([["0.5"]], mpf("1.875"), True), ([["0.25"]], mpf(1), True), ([["0.5"]], mpf(0), True)],
    ),
}

if __name__ == "__main__":
    import sys

    folder = os.path.dirname(os.path.abspath(__file__))
    for name in sys.argv[1:] or PROBLEMS:
        problem = PROBLEMS[name]
        q, p = simulate(problem)
        n = problem["n"]
        header = ["t"] + [f"q{i}" for i in range(n)] + [f"p{i}" for i in range(n)]
        with open(os.path.join(folder, f"trajectory_{name}.csv"), "w") as file:
            file.write(",".join(header) + "\n")
            for k in range(len(q)):
                row = [k * problem["h"]] + [q[k][i] for i in range(n)] + [p[k][i] for i in range(n)]
                file.write(",".join(mp.nstr(x, 25) for x in row) + "\n")
        print(name, mp.nstr(q[-1].T, 17), mp.nstr(p[-1].T, 17), flush=True)
