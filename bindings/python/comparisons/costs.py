"""Overheads of the package: ratios within one process, delays and bytes, each compared with its limit.

    python costs.py [--out DIR]
"""

import argparse
import multiprocessing
import os
import platform
import signal
import threading
import time
from pathlib import Path

import numpy as np
from scipy.signal import fftconvolve

import fvi

PENDULUM = {
    "system": {"mass": [1.0], "potential": "-9.81*cos(q0)", "damping": [{"order": 0.5, "coefficient": [0.1]}]},
    "initial": {"position": [2.0], "momentum": [0.0]},
    "time": {"step": 0.01, "steps": 10**6},
}
# Two processes share nothing that could block them, but the machine may have other load.
FORK = multiprocessing.get_context("fork")


def seconds(call):
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def ratios(call, other, times=15):
    """Ratios of the times of two calls that alternate, so that both run under the same load of the machine."""
    pairs = [(seconds(call), seconds(other)) for _ in range(times)]
    return [pair[0] / pair[1] for pair in pairs]


def derivatives():
    rng = np.random.default_rng(1)
    x = rng.standard_normal(10**6)
    for order in (0.5, -0.5, 1.5):
        w = fvi.weights(exponent=order, step=1.0, count=x.size)
        yield (
            f"derivative of order {order}, 10⁶ samples, by SciPy's fftconvolve",
            ratios(lambda: fvi.derivative(x, order, 1.0, start="riemann-liouville"), lambda: fftconvolve(x, w)[: x.size]),
            3.0,
        )
    table = np.asfortranarray(rng.standard_normal((100, 10**4)))
    yield (
        "derivative along the first axis of 10⁴ × 100 samples, by that along the last",
        ratios(lambda: fvi.derivative(table.T, 0.5, 1.0, axis=0), lambda: fvi.derivative(np.ascontiguousarray(table), 0.5, 1.0)),
        None,
    )


def errors():
    """Largest error of a derivative in units of u Σ|w||x|, and that of the transform."""
    rng = np.random.default_rng(2)
    x, order = rng.standard_normal(10**6) * np.exp(-np.arange(10**6) / 5e4), 0.5
    w = fvi.weights(exponent=order, step=1.0, count=x.size)
    ours, transformed = fvi.derivative(x, order, 1.0, start="riemann-liouville"), fftconvolve(x, w)[: x.size]
    worst = np.zeros(2)
    for k in rng.integers(0, x.size, 200):
        products = w[: k + 1].astype(np.longdouble) * x[k::-1]
        unit = np.finfo(float).eps / 2 * np.abs(products).sum()
        exact = products.sum()
        worst = np.maximum(worst, [abs(ours[k] - exact) / unit, abs(transformed[k] - exact) / unit])
    yield "error of that derivative, in u Σ|w||x|; decaying samples", [float(worst[0])], 8.0
    yield "error of the transform, likewise", [float(worst[1])], None


def functions():
    stiffness = np.array([[3.0, -1.0], [-1.0, 2.0]])
    sign = np.array([[1.0, -1.0], [-1.0, 1.0]])

    def value(q):
        return 0.5 * q @ stiffness @ q + 0.25 * (q[0] - q[1]) ** 4

    def gradient(q):
        cube = (q[0] - q[1]) ** 3
        return stiffness @ q + np.array([cube, -cube])

    def hessian(q):
        return stiffness + 3 * (q[0] - q[1]) ** 2 * sign

    common = dict(mass=[1.0, 2.0], position=[1.0, -0.5], step=0.01, steps=10_000, damping=fvi.Damping(0.5, 0.1))
    calls = []

    def recorded(function):
        def called(q):
            calls.append((function, q.copy()))
            return function(q)

        return called

    fvi.integrate(potential=fvi.Potential(*map(recorded, (value, gradient, hessian))), **common)

    def by_themselves():
        for function, q in calls:
            function(q)

    yield (
        f"a potential in Python, {len(calls) / 10_000:.1f} calls a step, by the same calls alone",
        ratios(lambda: fvi.integrate(potential=fvi.Potential(value, gradient, hessian), **common), by_themselves),
        1.5,
    )


def threads():
    def run():
        fvi.run(PENDULUM, every=10_000)

    def two(kind):
        both = [kind(target=run) for _ in range(2)]
        for each in both:
            each.start()
        for each in both:
            each.join()

    yield "two runs in two threads, by one run", ratios(lambda: two(threading.Thread), run), 1.1
    yield "two runs in two threads, by two processes", ratios(lambda: two(threading.Thread), lambda: two(FORK.Process)), None


def interrupts():
    """Seconds between Ctrl-C and the exception, in a run of 10⁹ steps."""

    def run(sender):
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            fvi.run(PENDULUM, steps=10**9, every=10**9, progress=lambda done, all: sender.send(done))
        except KeyboardInterrupt:
            sender.send(time.monotonic())

    delays = []
    for _ in range(5):
        receiver, sender = FORK.Pipe(duplex=False)
        process = FORK.Process(target=run, args=(sender,))
        process.start()
        while receiver.recv() < 1000:
            pass
        begin = time.monotonic()
        os.kill(process.pid, signal.SIGINT)
        process.join()
        while receiver.poll():
            end = receiver.recv()
        delays.append(end - begin)
    yield "seconds from Ctrl-C to KeyboardInterrupt in a run of 10⁹ steps", delays, 0.1


def memory():
    """Megabytes by which the process grows over 10⁴ calls of everything, after as many to warm up."""

    def resident():
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20

    x = np.linspace(0.0, 1.0, 1000)
    short = {**PENDULUM, "time": {"step": 0.01, "steps": 50}}
    potential = fvi.Potential(lambda q: 0.5 * q @ q, lambda q: q)

    def calls():
        for _ in range(2_000):
            fvi.run(short)
            fvi.integrate(mass=[1.0], potential=potential, position=[1.0], step=0.1, steps=5)
            fvi.derivative(x, 0.5, 1e-3)
            fvi.weights(exponent=0.5, step=0.1, count=100)
            fvi.Memory(exponent=0.5, step=0.1, length=100).push(1.0)

    calls()
    before = resident()
    calls()
    yield "megabytes by which the process grows over 10⁴ calls", [resident() - before], 1.0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="where costs.csv goes")
    arguments = parser.parse_args()
    lines = ["what,smallest,median,largest,allowed"]
    for study in (derivatives, errors, functions, threads, interrupts, memory):
        for what, numbers, allowed in study():
            smallest, median, largest = (f"{number:.3g}" for number in np.quantile(numbers, [0.0, 0.5, 1.0]))
            limit = "" if allowed is None else f"{allowed:g}"
            print(f"| {what} | {smallest} | {median} | {largest} | {limit} |", flush=True)
            lines.append(f'"{what}",{smallest},{median},{largest},{limit}')
    print(f"\n{os.cpu_count()} processors, {platform.machine()}, load {os.getloadavg()[0]:.1f}")
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        (arguments.out / "costs.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
