"""Many short runs: a loop in C of the same scheme, `Model.batch`, `Model.run`, `sweep` and `integrate`, after their agreement.

    python batches.py [--runs 10000] [--out DIR]

The C loop is compiled by `cc -O2` and runs on one thread. Memory: the growth of the process over a batch.
"""

import argparse
import ctypes
import os
import platform
import resource
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

import fvi

STEPS, STEP, ORDER, RHO = 100, 0.05, 0.5, 0.1

LOOP = """
#include <math.h>
/* Midpoint rule with Grunwald-Letnikov weights at the midpoints, Caputo's derivative: m = 1, U = k q^2/2. */
void runs(long count, long steps, double h, double beta, double rho, const double *k, const double *q0, double *q)
{
    double w[4096], x[4096];
    w[0] = 1.0;
    for (long j = 1; j <= steps; j++) w[j] = w[j - 1] * (j - 1 - beta) / j;
    double scale = rho * pow(h, -beta);
    for (long run = 0; run < count; run++) {
        double at = q0[run], p = 0.0, *row = q + run * (steps + 1);
        row[0] = at;
        for (long n = 0; n < steps; n++) {
            double sum = 0.0;
            for (long j = n; j >= 1; j--) sum += w[j] * x[n - j];
            double a = k[run] + scale, b = k[run] * at + scale * ((at - q0[run]) + sum);
            double e = h * (2.0 * p - h * b) / 4.0 / (1.0 + 0.25 * h * h * a);
            x[n] = at + e - q0[run];
            p -= h * (a * e + b);
            at += 2.0 * e;
            row[n + 1] = at;
        }
    }
}
"""


def seconds(call, times=3):
    """The shortest time of a few calls."""
    found = []
    for _ in range(times):
        begin = time.perf_counter()
        call()
        found.append(time.perf_counter() - begin)
    return min(found)


def c_loop(directory):
    source, library = Path(directory, "runs.c"), Path(directory, "runs.so")
    source.write_text(LOOP, encoding="utf-8")
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    function = ctypes.CDLL(str(library)).runs
    array = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")
    function.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_double, ctypes.c_double, ctypes.c_double, array, array, array]
    function.restype = None
    return function


def peak():
    """Megabytes that the process has needed at the most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--out", type=Path, help="where batches.csv goes")
    arguments = parser.parse_args()
    count = arguments.runs
    k, q0 = np.linspace(0.5, 4.0, count), np.linspace(0.5, 1.5, count)
    given = dict(mass=[1.0], potential="0.5*k*q0^2", parameters={"k": 1.0}, position=[1.0], step=STEP, steps=STEPS,
                 damping=fvi.Damping(ORDER, [RHO]), order=1)
    model = fvi.Model(**given)
    few = min(count, 500)
    lines = ["what,seconds_per_run,by_the_loop"]

    def told(what, time_of_all, runs):
        lines.append(f'"{what}",{time_of_all / runs:.3g},{time_of_all / runs / loop * count:.3g}')
        print(f"| {what} | {time_of_all / runs * 1e6:.1f} µs | {time_of_all / runs / loop * count:.1f} |", flush=True)

    with tempfile.TemporaryDirectory() as directory:
        function, rows = c_loop(directory), np.empty((count, STEPS + 1))
        loop = seconds(lambda: function(count, STEPS, STEP, ORDER, RHO, k, q0, rows))
        before = peak()
        runs = model.batch({"k": k, "q0": q0})
        grown, bytes_of_all = peak() - before, sum(part.nbytes for part in (runs.q, runs.p, runs.energy)) / 2**20
        print(f"largest difference from the loop: {np.abs(runs.q[:, :, 0] - rows).max():.1e}\n")
        print("| runs of 100 steps | each | by the loop |\n|---|---|---|")
        told("loop in C", loop, count)
        told("Model.batch", seconds(lambda: model.batch({"k": k, "q0": q0})), count)
        told("Model.batch, one thread", seconds(lambda: model.batch({"k": k, "q0": q0}, jobs=1)), count)
        told("Model.batch, initial values", seconds(lambda: model.batch({"p0": k, "q0": q0})), count)
        scenario = {
            "system": {"mass": [1.0], "potential": "0.5*k*q0^2", "parameters": {"k": 1.0},
                       "damping": [{"order": ORDER, "coefficient": [RHO]}]},
            "initial": {"position": [1.0], "momentum": [0.0]}, "time": {"step": STEP, "steps": STEPS}, "convolution": {"order": 1},
        }
        axes = {"system.parameters.k": k.tolist()}
        told("sweep", seconds(lambda: fvi.sweep({"scenario": scenario, "axes": axes}), 1), count)
        told("Model.run", seconds(lambda: [model.run({"k": a, "q0": b}) for a, b in zip(k[:few], q0)]), few)
        short = fvi.Model(**{**given, "steps": 1})
        told("Model.run, 1 step", seconds(lambda: [short.run({"k": a, "q0": b}) for a, b in zip(k[:few], q0)]), few)
        told("Model.integrate", seconds(lambda: [model.integrate(position=[b]) for b in q0[:few]]), few)
        told("integrate", seconds(lambda: [fvi.integrate(**{**given, "position": [b]}) for b in q0[:few]]), few)
    print(f"\nmegabytes: {grown:.0f} more for a batch whose arrays are {bytes_of_all:.0f}")
    print(f"{os.cpu_count()} processors, {platform.machine()}, load {os.getloadavg()[0]:.1f}")
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        (arguments.out / "batches.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
