"""Positions of the continuous extremals of two-point problems, to 25 digits.

least_fractional_speed: min 1/2 int_0^1 (D^alpha x)^2 dt, x(0) = 0, x(1) = 1, 1/2 < alpha < 1, has the extremal
    x(t) = (2 alpha - 1) int_0^t dtau / [(1 - tau)(t - tau)]^(1 - alpha).
The integral is computed by quadrature after the substitution tau = t - s^(1/alpha), which removes the singularity at
tau = t, and checked against (2 alpha - 1)/alpha t^alpha 2F1(1, 1 - alpha; 1 + alpha; t).

Run: python3 extremal_closed_forms.py  (mpmath 1.3); writes extremal_least_fractional_speed.csv beside itself with
columns alpha, t, x for t = k/64, and the same for one alpha as a reference table in ../../examples/problems.
"""
from pathlib import Path

from mpmath import hyp2f1, mp, mpf, nstr, quad

mp.dps = 40
HERE = Path(__file__).parent


def position(alpha, t):
    if t == 0 or t == 1:
        return t
    # d tau = -(1/alpha) s^(1/alpha - 1) ds and (t - tau)^(alpha - 1) = s^(1 - 1/alpha)
    integrand = lambda s: (1 - t + s ** (1 / alpha)) ** (alpha - 1) / alpha
    upper = t**alpha
    points = [0, upper / 4096, upper / 256, upper / 16, upper]
    value = (2 * alpha - 1) * quad(integrand, points)
    series = (2 * alpha - 1) / alpha * t**alpha * hyp2f1(1, 1 - alpha, 1 + alpha, t)
    assert abs(value - series) < mpf(10) ** -25, (alpha, t, value - series)
    return value


rows = [(a, mpf(k) / 64, position(mpf(a), mpf(k) / 64)) for a in ("0.55", "0.75", "0.9") for k in range(65)]
with open(HERE / "extremal_least_fractional_speed.csv", "w") as table:
    table.write("alpha,t,x\n")
    table.writelines(f"{a},{nstr(t, 17)},{nstr(x, 25)}\n" for a, t, x in rows)
with open(HERE / "../../examples/problems/least-fractional-speed-reference.csv", "w") as table:
    table.write("# x(t) = (2a-1) int_0^t dtau / [(1-tau)(t-tau)]^(1-a) for a = 0.75; tests/reference/extremal_closed_forms.py\n")
    table.write("t,x0\n")
    table.writelines(f"{nstr(t, 17)},{nstr(x, 25)}\n" for a, t, x in rows if a == "0.75")
