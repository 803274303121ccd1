"""fvi and SciPy's Radau on a double pendulum with two fractional joints: error, seconds, and their ratio.

    M(q) v' = … − ρ₁ D^½ q₀ … ,  ρ₂ D^0.7 (q₁ − q₀) ,  0 ≤ t ≤ 10     (examples/scenarios/double-pendulum.toml)

    FVI=target/release/fvi python double_pendulum.py [--repeats 7]

Radau takes the equivalent Prony system: s^β/s = Σ c/(s + λ) + c₀/s + c∞, from the trapezoidal rule in ln λ for
sin(πβ)/π ∫ λ^(β−1)/(s + λ) dλ, each relaxation a state, with its Jacobian matrix given. fvi runs as a program, its start,
the reading of the scenario and the writing of its files included. Errors are the largest at any of 100 times, in angles,
against fvi with degree 4 and a step of 0.0025. Both are to have an error of 1e-8.
"""

import argparse
import csv
import os
import re
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

ROOT = Path(__file__).resolve().parents[3]
END, ROWS = 10.0, 100
M1, M2, L1, L2, G = 1.0, 0.8, 1.0, 0.7, 9.81
START = np.array([1.0, 1.6, 0.5, -1.0])
JOINTS = [(0.5, 1.2, np.array([1.0, 0.0])), (0.7, 0.5, np.array([-1.0, 1.0]))]


def relaxations(beta, spacing=0.45, lowest=1e-7, highest=1e9):
    """λ, c, and the spring and the dashpot of what lies beyond both ends."""
    places = np.arange(np.log(lowest), np.log(highest), spacing)
    scale, rates = spacing * np.sin(np.pi * beta) / np.pi, np.exp(places)

    def beyond(power):
        """Σ e^(−power·spacing·k), k = 1, 2, …: the rule goes on to infinity at both ends."""
        return 1 / np.expm1(power * spacing)

    spring = scale * rates[0] ** beta * beyond(beta)
    dashpot = scale * rates[-1] ** (beta - 1) * beyond(1 - beta)
    return rates, scale * rates**beta, spring, dashpot


def prony_system():
    tables = [relaxations(beta) for beta, _, _ in JOINTS]
    counts = [len(rates) for rates, *_ in tables]
    places = [slice(4, 4 + counts[0]), slice(4 + counts[0], 4 + sum(counts))]

    def mechanics(q, v, states):
        cosine, sine = np.cos(q[0] - q[1]), np.sin(q[0] - q[1])
        coupled = M2 * L1 * L2
        mass = np.array([[(M1 + M2) * L1**2, coupled * cosine], [coupled * cosine, M2 * L2**2]])
        force = np.array(
            [
                -coupled * sine * v[1] ** 2 - (M1 + M2) * G * L1 * np.sin(q[0]),
                coupled * sine * v[0] ** 2 - M2 * G * L2 * np.sin(q[1]),
            ]
        )
        for (_, rho, along), (_, c, spring, dashpot), y in zip(JOINTS, tables, states, strict=True):
            force -= rho * along * (c @ y + spring * (along @ (q - START[:2])) + dashpot * (along @ v))
        return mass, force

    def right(_, x):
        q, v, states = x[:2], x[2:4], [x[place] for place in places]
        mass, force = mechanics(q, v, states)
        rates = [along @ v - table[0] * y for (_, _, along), table, y in zip(JOINTS, tables, states, strict=True)]
        return np.concatenate([v, np.linalg.solve(mass, force), *rates])

    def jacobian(_, x):
        q, v, states = x[:2], x[2:4], [x[place] for place in places]
        matrix = np.zeros((len(x), len(x)))
        matrix[0, 2] = matrix[1, 3] = 1.0
        mass, _ = mechanics(q, v, states)
        for j in range(4):
            # Central differences of the smooth 4 × 4 part, to 1e-10.
            more, less = x[:4].copy(), x[:4].copy()
            more[j] += 1e-6
            less[j] -= 1e-6
            ends = [np.linalg.solve(*mechanics(at[:2], at[2:], states)) for at in (more, less)]
            matrix[2:4, j] = (ends[0] - ends[1]) / 2e-6
        for (_, rho, along), (rates, c, _, _), place in zip(JOINTS, tables, places, strict=True):
            matrix[2:4, place] = -np.outer(np.linalg.solve(mass, rho * along), c)
            matrix[place, 2:4] = along
            matrix[range(place.start, place.stop), range(place.start, place.stop)] = -rates
        return matrix

    return right, jacobian, np.concatenate([START, np.zeros(sum(counts))])


def with_radau(tolerance):
    right, jacobian, start = prony_system()
    times = np.linspace(0.0, END, ROWS + 1)
    begin = time.perf_counter()
    found = solve_ivp(right, (0.0, END), start, "Radau", times, rtol=tolerance, atol=tolerance, jac=jacobian)
    seconds = time.perf_counter() - begin
    return seconds, found.y[:2].T, f"{len(start)} states, {found.nfev} evaluations"


def with_fvi(degree, step):
    text = (ROOT / "examples" / "scenarios" / "double-pendulum.toml").read_text()
    text = re.sub(r"degree = .*", f"degree = {degree}", re.sub(r"step = .*", f"step = {step}", text))
    text = text.replace("memory_energy = true", f"every = {round(END / step / ROWS)}")
    program = os.environ.get("FVI", ROOT / "target" / "release" / "fvi")
    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / "pendulum.toml"
        scenario.write_text(text)
        begin = time.perf_counter()
        subprocess.run([program, "run", scenario, "--out", Path(folder) / "out"], check=True, capture_output=True)
        seconds = time.perf_counter() - begin
        with (Path(folder) / "out" / "trajectory.csv").open() as file:
            rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return seconds, np.array([[float(row["q0"]), float(row["q1"])] for row in rows]), f"{round(END / step)} steps"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    _, exact, _ = with_fvi(4, 0.0025)
    cases = {f"Radau, tolerance {tolerance:g}": (with_radau, (tolerance,)) for tolerance in (1e-8, 1e-10)}
    cases |= {f"fvi, degree {d}, h = {h:g}": (with_fvi, (d, h)) for d, h in ((3, 0.02), (3, 0.01), (4, 0.02))}
    print("| | error | seconds: median (least … largest) | |\n|---|---|---|---|")
    for name, (run, arguments) in cases.items():
        runs = [run(*arguments) for _ in range(repeats)]
        seconds = [run[0] for run in runs]
        error = np.abs(runs[0][1] - exact).max()
        spread = f"{statistics.median(seconds):.3g} ({min(seconds):.3g} … {max(seconds):.3g})"
        print(f"| {name} | {error:.1e} | {spread} | {runs[0][2]} |", flush=True)


if __name__ == "__main__":
    main()
