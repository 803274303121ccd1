"""Golden trajectories of the fractional variational integrators, by a dense implementation independent of the library.

Everything is written out plainly, in 40-digit arithmetic (mpmath): the weights by expanding the power series of the
generating function with its logarithmic derivative, the history by the double sum over all earlier positions, each step by
Newton's method with numerical derivatives of the residual built from the discrete Lagrangian.

    python3 dense_bdf.py            writes trajectory_<name>.csv beside itself (needs mpmath)

Columns: t, q0…, p0…, 25 digits. Problems: see PROBLEMS; the tests repeat their definitions.
"""

import os
from mpmath import mp, mpf, matrix, cos, sin, lu_solve, binomial, mpmathify

mp.dps = 40


def bdf_weights(order, beta, h, count):
    a = [mpf(0)] * (order + 1)
    for i in range(1, order + 1):
        for j in range(i + 1):
            a[j] += binomial(i, j) * (-1) ** j / mpf(i)
    # f = a(z)^beta:  f' a = beta a' f, coefficient by coefficient.
    f = [a[0] ** beta]
    for n in range(1, count):
        right = sum(beta * (j) * a[j] * f[n - j] for j in range(1, min(order, n) + 1))
        left = sum((n - j) * f[n - j] * a[j] for j in range(1, min(order, n) + 1))
        f.append((right - left) / (n * a[0]))
    return [w / h ** beta for w in f]


def simulate(problem):
    h, kappa, steps, n = problem["h"], problem["kappa"], problem["steps"], problem["n"]
    mass, gradient, force = problem["mass"], problem["gradient"], problem["force"]
    q = [matrix(problem["q0"])]
    p = [matrix(problem["p0"])]
    v0 = lu_solve(mass, p[0])
    terms = [
        (matrix(rho), beta, caputo, bdf_weights(problem["order"], beta, h, steps + 1))
        for rho, beta, caputo in problem["damping"]
    ]

    def damping_force(k):
        total = matrix(n, 1)
        for rho, beta, caputo, w in terms:
            derivative = matrix(n, 1)
            for m in range(k + 1):
                x = q[k - m]
                if caputo and beta > 0:
                    x = x - q[0]
                    if beta > 1:
                        x = x - v0 * ((k - m) * h)
                derivative += w[m] * x
            total += rho * derivative
        return total

    for k in range(steps):
        t = k * h + (1 - kappa) * h

        def pull(new):
            s = kappa * q[k] + (1 - kappa) * new
            return matrix(gradient(s)) - matrix(force(t, s))

        # p_k = −D₁L_d − f₀
        def residual(new):
            return mass * (new - q[k]) / h + h * kappa * pull(new) - p[k]

        new = q[k] + h * lu_solve(mass, p[k])
        for _ in range(60):
            r = residual(new)
            jacobian = matrix(n, n)
            eps = mpf(10) ** -18
            for j in range(n):
                moved, back = new.copy(), new.copy()
                moved[j] += eps
                back[j] -= eps
                column = (residual(moved) - residual(back)) / (2 * eps)
                for i in range(n):
                    jacobian[i, j] = column[i]
            change = lu_solve(jacobian, r)
            new = new - change
            if max(abs(c) for c in change) < mpf(10) ** -32:
                break
        else:
            raise RuntimeError("no convergence")
        q.append(new)
        # p_{k+1} = D₂L_d + f₁ − h Σ ρ D^β q
        p.append(mass * (new - q[k]) / h - h * (1 - kappa) * pull(new) - h * damping_force(k + 1))
    return q, p


def number(text):
    return mpmathify(text)


PROBLEMS = {
    # Pendulum, q0 != 0, Caputo, between 0 and 1.
    "pendulum": dict(
        n=1, h=number("0.05"), steps=200, kappa=number("0.5"), order=2,
        mass=matrix([["1.5"]]), q0=["2"], p0=["0.3"],
        gradient=lambda q: [number("9.81") * sin(q[0])],
        force=lambda t, q: [mpf(0)],
        damping=[([["0.4"]], number("0.5"), True)],
    ),
    # Two coupled coordinates, dense mass and damping, two terms, both types, a force in t and q.
    "coupled": dict(
        n=2, h=number("0.03125"), steps=160, kappa=number("0.3125"), order=3,
        mass=matrix([["2", "0.5"], ["0.5", "1"]]), q0=["0.5", "-0.25"], p0=["0.125", "1"],
        gradient=lambda q: [
            3 * q[0] + q[0] ** 3 + sin(q[0] - q[1]),
            2 * q[1] - sin(q[0] - q[1]),
        ],
        force=lambda t, q: [cos(2 * t) - q[1] / 4, t * q[0] / 8],
        damping=[
            ([["0.5", "0.25"], ["0.25", "0.5"]], number("0.75"), False),
            ([["0.25", "0"], ["0", "0.125"]], number("1.5"), True),
        ],
    ),
    # High order of quadrature near the end of its range, both ends of kappa.
    "steep_first": dict(
        n=1, h=number("0.015625"), steps=128, kappa=mpf(1), order=6,
        mass=matrix([["1"]]), q0=["1"], p0=["-0.5"],
        gradient=lambda q: [q[0] + q[0] ** 3],
        force=lambda t, q: [sin(3 * t) - q[0] ** 2 / 8],
        damping=[([["0.0078125"]], number("1.875"), True)],
    ),
    "steep_last": dict(
        n=1, h=number("0.015625"), steps=128, kappa=mpf(0), order=5,
        mass=matrix([["1"]]), q0=["1"], p0=["-0.5"],
        gradient=lambda q: [q[0] + q[0] ** 3],
        force=lambda t, q: [sin(3 * t) - q[0] ** 2 / 8],
        damping=[([["0.0625"]], number("1.25"), False), ([["0.5"]], mpf(0), True), ([["0.25"]], mpf(1), True)],
    ),
}

if __name__ == "__main__":
    folder = os.path.dirname(os.path.abspath(__file__))
    for name, problem in PROBLEMS.items():
        q, p = simulate(problem)
        n = problem["n"]
        header = ["t"] + [f"q{i}" for i in range(n)] + [f"p{i}" for i in range(n)]
        with open(os.path.join(folder, f"trajectory_{name}.csv"), "w") as file:
            file.write(",".join(header) + "\n")
            for k in range(len(q)):
                row = [k * problem["h"]] + [q[k][i] for i in range(n)] + [p[k][i] for i in range(n)]
                file.write(",".join(mp.nstr(x, 25) for x in row) + "\n")
        print(name, mp.nstr(q[-1].T, 17), mp.nstr(p[-1].T, 17))
