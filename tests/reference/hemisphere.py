"""Decay test of a floating hemisphere: its hydrodynamics by Hulme's multipoles, its motion in the frequency domain.

Writes examples/scenarios/hemisphere-radiation.csv, the added mass and the radiation damping of a hemisphere of radius a in
deep water that heaves, and hemisphere-decay-reference.csv, its motion after a release without Cummins' equation:

    q^ = q0 [(m + A(inf)) s + K^] / [(m + A(inf)) s^2 + s K^ + c],   K^(i w) = B(w) + i w (A(w) - A(inf)),
    q(t) = (2/pi) int Re q^(i w) cos(w t) dw .

The potential is c_0 (a wave source at the origin) + sum c_n (P_2n/r^(2n+1) + K/(2n) P_(2n-1)/r^(2n)), K = w^2/g, matched to the
velocity cos(theta) on r = a by least squares [Hul82]. numpy, scipy.
"""

from pathlib import Path

import numpy as np
from scipy.special import eval_legendre, exp1, j0, j1

A, RHO, G = 5.0, 1000.0, 9.81
VOLUME = 2 / 3 * np.pi * A**3
HERE = Path(__file__).resolve().parents[2] / "examples" / "scenarios"


def source(K, R, z, points=200):
    """The wave source 1/r + K PV int exp(-kz) J0(kR)/(k - K) dk + i pi K exp(-Kz) J0(KR), and its derivatives; z downwards."""
    x, w = np.polynomial.legendre.leggauss(points)
    tau, w = 0.25 * np.pi * (x + 1), 0.5 * w
    path = z[:, None] - 1j * R[:, None] * np.cos(tau)
    principal = np.exp(-K * path) * (exp1(-K * path) + 1j * np.pi)
    slope = -1 / path - K * principal
    mean = (w * principal.real).sum(1)
    in_z = (w * slope.real).sum(1)
    in_R = (w * (-1j * np.cos(tau) * slope).real).sum(1)
    r, e = np.hypot(R, z), np.exp(-K * z)
    value = 1 / r + K * mean + 1j * np.pi * K * e * j0(K * R)
    in_z = -z / r**3 + K * in_z - 1j * np.pi * K**2 * e * j0(K * R)
    in_R = -R / r**3 + K * in_R - 1j * np.pi * K**2 * e * j1(K * R)
    return value, in_R, in_z


def hemisphere(Ka, terms=16, points=160):
    """A/(rho V) and B/(rho V w)."""
    x, w = np.polynomial.legendre.leggauss(points)
    mu, w = 0.5 * (x + 1), 0.5 * w
    z, R = mu, np.sqrt(1 - mu * mu)
    value, in_R, in_z = source(Ka, R, z)
    values, slopes = [value], [in_R * R + in_z * z]
    for n in range(1, terms):
        even, odd = eval_legendre(2 * n, mu), eval_legendre(2 * n - 1, mu)
        values.append(even + Ka / (2 * n) * odd + 0j)
        slopes.append(-(2 * n + 1) * even - Ka * odd + 0j)
    root = np.sqrt(w)
    c, *_ = np.linalg.lstsq(np.array(slopes).T * root[:, None], mu * root + 0j, rcond=None)
    force = -2 * np.pi * (w * (np.array(values).T @ c) * mu).sum() / (2 * np.pi / 3)
    return force.real, force.imag


def table(omega):
    found = np.array([hemisphere(w * w * A / G) for w in omega])
    return RHO * VOLUME * found[:, 0], RHO * VOLUME * found[:, 1] * omega


def main():
    omega = np.round(np.arange(0.05, 6.5001, 0.05), 2)
    added, damping = table(omega)
    lines = ["omega [rad/s],A [kg],B [N s/m]"] + [f"{w:g},{a:.8g},{b:.8g}" for w, a, b in zip(omega, added, damping)]
    (HERE / "hemisphere-radiation.csv").write_text("\n".join(lines) + "\n")
    # Twenty times as close, and further up; above it B = 0.
    fine = np.arange(0.0025, 8.0, 0.0025)
    added, damping = table(fine)
    mass, stiffness, infinite = RHO * VOLUME, RHO * G * np.pi * A**2, 0.5 * RHO * VOLUME
    s = 1j * fine
    K = damping + s * (added - infinite)
    whole = mass + infinite
    q = (whole * s + K) / (whole * s * s + s * K + stiffness)
    times = np.arange(0.0, 30.01, 1.0)
    # Above the last frequency as (A(inf) has been reached) of a body without waves.
    step = fine[1] - fine[0]
    motion = [2 / np.pi * step * np.sum(q.real * np.cos(fine * t)) + step / np.pi * q.real[0] for t in times]
    lines = ["t,q0"] + [f"{t:g},{x:.6f}" for t, x in zip(times, motion)]
    (HERE / "hemisphere-decay-reference.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
