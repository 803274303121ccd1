"""fvi and pycaputo on the Bagley–Torvik equation: error, seconds and megabytes, as a table and a picture.

    x'' + D^1.5 x + x = f(t) ,  x(0) = x'(0) = 0 ,  0 ≤ t ≤ 1 ,  with the solution x = t³ .

    python bagley_torvik.py [--steps 1000 10000] [--out DIR]

pycaputo solves systems of order one half: for its trapezoidal rule the four successive derivatives of order ½ are the unknowns,
and their linear equations are solved by a matrix product, as its documentation recommends where a better solver than the general
one is known. Each run has its own process, so that memory can be attributed to it. Seconds are those of the steps; memory is the
peak of the process minus its memory before the steps.
"""

import argparse
import json
import math
import resource
import subprocess
import sys
import time
from pathlib import Path

CASES = {
    "pycaputo, trapezoidal rule": ("pycaputo", {}),
    "fvi, midpoint, BDF 2 at the nodes": ("fvi", dict(order=2, at="nodes")),
    "fvi, degree 2, BDF 4 at the nodes": ("fvi", dict(scheme="galerkin", degree=2, points=2, order=4, at="nodes")),
}


def with_pycaputo(steps, keys):
    import numpy as np
    from pycaputo.controller import make_fixed_controller
    from pycaputo.derivatives import CaputoDerivative
    from pycaputo.events import StepCompleted
    from pycaputo.fode.caputo import Trapezoidal
    from pycaputo.stepping import evolve

    matrix = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, -1]])

    def pulled(t):
        return t**3 + 6 * t + 6 / math.gamma(2.5) * t**1.5

    def source(t, y):
        rates = matrix @ y
        rates[3] += pulled(t)
        return rates

    class Linear(Trapezoidal):
        def solve(self, t, y0, c, r):
            # y = c (A y + f) + r
            right = r.copy()
            right[3] += np.broadcast_to(c, 4)[3] * pulled(t)
            return np.linalg.solve(np.eye(4) - np.diag(np.broadcast_to(c, 4)) @ matrix, right)

    method = Linear(
        ds=tuple(CaputoDerivative(0.5) for _ in range(4)),
        control=make_fixed_controller(1.0 / steps, tstart=0.0, tfinal=1.0, nsteps=steps),
        source=source,
        y0=(np.zeros(4),),
        source_jac=None,
    )
    begin = time.perf_counter()
    error = 0.0
    for event in evolve(method):
        if isinstance(event, StepCompleted):
            error = max(error, float(abs(event.y[0] - event.t**3)))
    return error, time.perf_counter() - begin


def with_fvi(steps, keys):
    import numpy as np

    import fvi

    begin = time.perf_counter()
    r = fvi.integrate(
        mass=[1.0],
        stiffness=[1.0],
        force=["t^3 + 6*t + 6/gamma(2.5)*t^1.5"],
        damping=fvi.Damping(order=1.5, coefficient=[1.0]),
        position=[0.0],
        step=1.0 / steps,
        steps=steps,
        **keys,
    )
    seconds = time.perf_counter() - begin
    return float(np.abs(r.q[:, 0] - r.t**3).max()), seconds


def measured(name, steps):
    """One run, in this process."""
    import numpy  # noqa: F401  (not to be counted)

    library, keys = CASES[name]
    run = {"fvi": with_fvi, "pycaputo": with_pycaputo}[library]
    run(16, keys)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    error, seconds = run(steps, keys)
    megabytes = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    return {"method": name, "steps": steps, "error": error, "seconds": seconds, "megabytes": megabytes}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, nargs="+", default=[100, 1000, 10000])
    parser.add_argument("--out", type=Path, default=Path("out/pycaputo"))
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measured(arguments.one[0], int(arguments.one[1]))))
        return
    rows = []
    for name in CASES:
        for steps in arguments.steps:
            command = [sys.executable, __file__, "--one", name, str(steps)]
            rows.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1]))
            print("{method}, {steps} steps: error {error:.1e}, {seconds:.3g} s, {megabytes:.1f} MB".format(**rows[-1]))
    arguments.out.mkdir(parents=True, exist_ok=True)
    with open(arguments.out / "pycaputo.csv", "w", encoding="utf-8") as file:
        print("method,steps,error,seconds,megabytes", file=file)
        for row in rows:
            print('"{method}",{steps},{error:.3e},{seconds:.4g},{megabytes:.1f}'.format(**row), file=file)
    picture(rows, arguments.out / "pycaputo.svg")


def picture(rows, path):
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "fvi"
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(9, 4), layout="constrained")
    for name, marker in zip(CASES, "osD"):
        mine = [row for row in rows if row["method"] == name]
        axes[0].loglog([row["steps"] for row in mine], [row["error"] for row in mine], marker=marker, label=name)
        axes[1].loglog([row["steps"] for row in mine], [row["seconds"] for row in mine], marker=marker, label=name)
    axes[0].set(xlabel="steps", ylabel="largest error of x")
    axes[1].set(xlabel="steps", ylabel="seconds")
    axes[0].legend(fontsize="small")
    for axis in axes:
        axis.grid(alpha=0.3)
    figure.suptitle("Bagley–Torvik equation, solution t³")
    figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    main()
