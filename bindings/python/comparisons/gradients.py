"""What a gradient by 100 parameters costs, and what sensitivities by them would: both by a run without either.

    python gradients.py [--times N]
"""

import argparse
import statistics
import time

import numpy as np

import fvi


def entries(count=50):
    """100 entries of mass and damping of a chain."""
    stiffness = 2 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)
    system = dict(
        mass=np.ones(count), stiffness=100 * stiffness, damping=fvi.Damping(0.5, np.full(count, 0.1)), position=np.linspace(1, 0, count),
        step=0.01, steps=2000,
    )
    return system, [f"mass[{i}]" for i in range(count)] + [f"damping[0].coefficient[{i}]" for i in range(count)]


def strengths(count=100):
    """100 strengths of a Prony series of one mass."""
    kernel = fvi.Kernel.prony([1.0] * count, np.logspace(-2, 2, count))
    system = dict(mass=[1.0], stiffness=[4.0], damping=fvi.Damping(kernel=kernel, coefficient=[0.01]), position=[1.0], step=0.01, steps=10_000)
    return system, [f"damping[0].kernel.strengths[{i}]" for i in range(count)]


def constants(count=100):
    """100 constants in the potential of one mass."""
    terms = " + ".join(f"a{i}*cos({i + 1}*q0)" for i in range(count))
    system = dict(
        mass=[1.0], potential=f"2*q0^2 + {terms}", parameters={f"a{i}": 1e-3 / (i + 1) for i in range(count)},
        damping=fvi.Damping(0.5, 0.1), position=[1.0], step=0.01, steps=10_000,
    )
    return system, [f"a{i}" for i in range(count)]


def seconds(call, times):
    def once():
        begin = time.perf_counter()
        call()
        return time.perf_counter() - begin

    return statistics.median(once() for _ in range(times))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=5)
    times = parser.parse_args().times
    for case in (entries, strengths, constants):
        system, names = case()
        model = fvi.Model(**system)
        plain = seconds(model.run, times)
        gradient = seconds(lambda: model.gradient(names, lambda result: result.q), times)
        prefix = "system.parameters." if "parameters" in system else "system."
        paths = [prefix + name for name in names]
        whole = seconds(lambda: fvi.integrate(**system, sensitivities=paths), 1)
        print(f"{case.__doc__} A run: {1e3 * plain:.1f} ms; gradient {gradient / plain:.1f} runs, sensitivities {whole / plain:.0f}")


if __name__ == "__main__":
    main()
