"""What the package costs, as ratios within one process: derivatives against a transform, functions against themselves, threads.

    python costs.py
"""

import multiprocessing
import threading
import time

import numpy as np
from scipy.signal import fftconvolve

import fvi


def shortest(call, times=5):
    seconds = []
    for _ in range(times):
        begin = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def derivative():
    x = np.random.default_rng(1).standard_normal(10**6)
    for order in (0.5, -0.5, 1.5):
        w = fvi.weights(exponent=order, step=1.0, count=x.size)
        transform = shortest(lambda: fftconvolve(x, w)[: x.size])
        ours = shortest(lambda: fvi.derivative(x, order, 1.0, start="riemann-liouville"))
        print(f"derivative of order {order} of 10⁶ samples: {ours / transform:.2f} of the time of fftconvolve ({ours:.3f} s)")


def function():
    calls = seconds = 0

    def timed(call):
        def wrapped(q):
            nonlocal calls, seconds
            begin = time.perf_counter()
            answer = call(q)
            seconds += time.perf_counter() - begin
            calls += 1
            return answer

        return wrapped

    stiffness = np.array([[3.0, -1.0], [-1.0, 2.0]])

    def value(q):
        return 0.5 * q @ stiffness @ q + 0.25 * (q[0] - q[1]) ** 4

    def gradient(q):
        cube = (q[0] - q[1]) ** 3
        return stiffness @ q + np.array([cube, -cube])

    def hessian(q):
        return stiffness + 3 * (q[0] - q[1]) ** 2 * np.array([[1.0, -1.0], [-1.0, 1.0]])

    common = dict(mass=[1.0, 2.0], position=[1.0, -0.5], step=0.01, steps=10_000, damping=fvi.Damping(0.5, 0.1), order=2,
                  engine="exponential-sum")
    fvi.integrate(potential=fvi.Potential(timed(value), timed(gradient), timed(hessian)), **common)
    own = seconds - calls * shortest(lambda: [time.perf_counter() for _ in range(10**5)]) / 10**5
    whole = shortest(lambda: fvi.integrate(potential=fvi.Potential(value, gradient, hessian), **common), 3)
    print(f"a potential in Python, {calls} calls: {whole / own:.2f} of the functions' own time ({whole:.3f} s)")


def threads():
    pendulum = {
        "system": {"mass": [1.0], "potential": "-9.81*cos(q0)", "damping": [{"order": 0.5, "coefficient": [0.1]}]},
        "initial": {"position": [2.0], "momentum": [0.0]},
        "time": {"step": 0.01, "steps": 10**6},
    }

    def run():
        fvi.run(pendulum, every=10_000)

    def two(kind):
        both = [kind(target=run) for _ in range(2)]
        for each in both:
            each.start()
        for each in both:
            each.join()

    # Two processes have nothing in common that could hold them up, and the machine may be busy with other things.
    process = multiprocessing.get_context("fork").Process
    one, in_threads, in_processes = shortest(run), shortest(lambda: two(threading.Thread)), shortest(lambda: two(process))
    print(
        f"two runs in two threads: {in_threads / one:.2f} of the time of one; {in_threads / in_processes:.2f} of that in two processes"
    )


if __name__ == "__main__":
    derivative()
    function()
    threads()
