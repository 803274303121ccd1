#!/usr/bin/env python3
"""What a large structure costs: the cantilever of make.py, run for some steps, with and without memory, by schemes of order 3 and 4, and under
eight load cases.

    measure.py FVI DIRECTORY [CELLS] [STEPS]

FVI is the program, DIRECTORY has the matrices of `make.py cantilever DIRECTORY CELLS` or gets them; 144 cells along the length, which are 97 200
coordinates, and 100 steps by default. Prints a table for book/src/use/large.md: seconds on the clock and on the processors for each step, without
those before the first one, what 10 000 steps take at that, and the most memory in use. Schemes of order 3 and 4 make steps that are stable, a
thousandth as long, which cost as much as others. Last a run that is interrupted half-way goes on, and
must leave the bytes of one that was not.
"""

import json
import resource
import subprocess
import sys
from pathlib import Path

SCENARIO = """
[system]
mass = "cantilever-M.npz"
stiffness = "cantilever-K.npz"
[[system.damping]]
order = {order}
coefficient = "cantilever-K.npz"
scale = 0.02
{loads}
{scheme}
[time]
step = {step}
steps = {steps}
[history]
threads = {threads}
[output]
every = {steps}
coordinates = [0]
"""

GAUSS = """
[scheme]
kind = "galerkin"
degree = 2
[convolution]
order = {order}
"""

LOAD = """
[[{table}.load]]
pattern = "cantilever-load.npy"
amplitude = "sin({frequency}*t)"
"""


def run(program, directory, name, steps, order=0.6, cases=0, threads=2, formula=None):
    """Processor and wall seconds for each step, and MB, of a run; its shorter twin takes off what comes before the first step.

    With order one the kernel ends after two steps: classical damping by the same solver. With a formula of order 3 or 4 the scheme has two Gauss
    points.
    """
    scheme, step = ("", 4.0) if formula is None else (GAUSS.format(order=formula), 0.004)
    if cases:
        loads = "".join(
            f'\n[[case]]\nname = "load-{case}"' + LOAD.format(table="case", frequency=0.01 * (case + 1))
            for case in range(cases)
        )
    else:
        loads = LOAD.format(table="system", frequency=0.01)
    used = []
    for count in (steps // 4, steps):
        text = SCENARIO.format(order=order, loads=loads, scheme=scheme, step=step, steps=count, threads=threads)
        (directory / "measure.toml").write_text(text)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        output = directory / "out" / name
        command = ["/usr/bin/env", program, "run", "measure.toml", "--out", str(output), "--quiet", "--checkpoint-every", "never"]
        subprocess.run(command, cwd=directory, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        summary = json.loads((output / "summary.json").read_text())
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        used.append((spent, summary["seconds"], after.ru_maxrss / 1024, summary))
    (spent, seconds, _, _), (more, later, peak, summary) = used
    made = steps - steps // 4
    return (more - spent) / made, (later - seconds) / made, peak, summary


def goes_on(program, directory, steps):
    """Whether a run that stops half-way and goes on leaves the same files."""
    files = ("trajectory.csv", "snapshots.npz", "map.svg")
    load = LOAD.format(table="system", frequency=0.01)
    text = SCENARIO.format(order=0.6, loads=load, scheme="", step=4.0, steps=steps, threads=2)
    text += f"snapshots = {max(1, steps // 4)}\n"
    (directory / "measure.toml").write_text(text)

    def made(name, *more):
        command = [program, "run", "measure.toml", "--out", str(directory / "out" / name), "--quiet", *more]
        subprocess.run(command, cwd=directory, check=True)
        return [(directory / "out" / name / file).read_bytes() for file in files]

    whole = made("whole")
    made("halves", "--steps", str(steps // 2))
    return made("halves", "--steps", str(steps), "--resume") == whole


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    program, directory = str(Path(sys.argv[1]).resolve()), Path(sys.argv[2]).resolve()
    cells = int(sys.argv[3]) if len(sys.argv) > 3 else 144
    steps = int(sys.argv[4]) if len(sys.argv) > 4 else 100
    if not (directory / "cantilever-K.npz").exists():
        make = Path(__file__).with_name("make.py")
        subprocess.run([sys.executable, make, "cantilever", directory, str(cells)], check=True)
    print("| run | s a step | processor s a step | min for 10 000 steps | MB |")
    print("|---|---|---|---|---|")
    found, factors = {}, {}
    for name, keys in (
        ("classical damping, order 1", {"order": 1.0}),
        ("fractional, order 0.6", {}),
        ("the same, one thread", {"threads": 1}),
        ("two Gauss points, BDF 3", {"formula": 3}),
        ("two Gauss points, BDF 4", {"formula": 4}),
        ("eight load cases", {"cases": 8}),
    ):
        directory_name = name.replace(" ", "-").replace(",", "")
        cost, seconds, peak, summary = run(program, directory, directory_name, steps, **keys)
        found[name] = cost, seconds
        factors[name] = summary["solver"]["factor_bytes"]
        print(f"| {name} | {seconds:.4f} | {cost:.4f} | {seconds * 1e4 / 60:.1f} | {peak:.0f} |", flush=True)
    factors = ", ".join(f"{name} {bytes / 2**20:.0f} MB" for name, bytes in factors.items())
    print(f"\nfactors: {factors}")
    one, classical = found["fractional, order 0.6"], found["classical damping, order 1"]
    print(f"memory: {one[0] / classical[0]:.2f} times the processor time of classical damping, {one[1] / classical[1]:.2f} times that on the clock")
    cases = found["eight load cases"]
    print(f"eight load cases: {cases[0] / one[0]:.2f} times one, {cases[1] / one[1]:.2f} times on the clock")
    same = goes_on(program, directory, min(steps, 20))
    print(f"a run that stops half-way and goes on leaves {'the same' if same else 'OTHER'} bytes")
    sys.exit(0 if same else 1)


if __name__ == "__main__":
    main()
