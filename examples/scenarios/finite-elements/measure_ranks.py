#!/usr/bin/env python3
"""What a step of the beam of distributed.py costs on ranks: seconds, flops, messages and bytes, counted by PETSc's log.

    measure_ranks.py [CELLS ACROSS STEPS]      starts mpiexec with one rank and with two, CELLS cells along the length for each
    mpiexec -n 2 python measure_ranks.py ranks CELLS ACROSS STEPS [PETSc's options]

Prints one table for both, and what it says for a thousand ranks.
"""

import json
import os
import subprocess
import sys
import time

SIZE = ["103", "17", "10"]
"""About 10⁵ coordinates a rank."""

LATENCY, BANDWIDTH = 2e-6, 1e9
"""Seconds that a message takes on its way, and bytes a second for each rank: a modest network."""


def on_ranks(cells, across, steps):
    from distributed import Beam
    from petsc4py import PETSc

    import fvi
    import fvi.petsc

    world = PETSc.COMM_WORLD.tompi4py()
    PETSc.Log.begin()
    beam = Beam(PETSc.COMM_WORLD, cells * world.size, across)
    events = {name: PETSc.Log.Event(name) for name in ("fvi step", "fvi memory", "KSPSolve", "PCApply", "MatMult")}
    names = ("time", "flops", "numMessages", "messageLength", "numReductions")
    begin = time.process_time()
    result = fvi.petsc.integrate(
        beam.mass,
        beam.stiffness,
        position=0.0,
        step=1.0,
        steps=steps,
        damping=fvi.Damping(0.6, 0.02 * beam.stiffness),
        loads=fvi.Load(beam.load(1e-6), "1"),
        every=steps,
        energy=False,
    )
    found = {event: [events[event].getPerfInfo()[name] / steps for name in names] for event in events}
    found["processor"] = [time.process_time() - begin]
    everyone = world.gather((found, beam.stiffness.getInfo()["nz_used"]))
    if world.rank == 0:
        summary = {name: result.summary[name] for name in ("coordinates", "solver", "memory", "seconds")}
        print(json.dumps({"ranks": world.size, "steps": steps, **summary, "events": [each for each, _ in everyone]}))


def table(runs):
    print(
        "| ranks | coordinates | iterations | processor s a rank and step | s a step | of it memory | Mflop a rank | messages in and out | "
        "kB in and out | sums over ranks |\n|---|---|---|---|---|---|---|---|---|---|"
    )
    processor = []
    for run in runs:
        steps = run["steps"]
        flops, messages, volume, reductions = (max(of_ranks) for of_ranks in zip(*(each["fvi step"][1:] for each in run["events"])))
        processor.append(max(each["processor"][0] for each in run["events"]) / steps)
        seconds, memory = run["seconds"]["all"] / steps, run["seconds"]["memory"] / steps
        print(
            f"| {run['ranks']} | {run['coordinates']} | {run['solver']['iterations'] / steps:.1f} | {processor[-1]:.2f} | {seconds:.2f} | "
            f"{memory / seconds:.2%} | {flops / 1e6:.0f} | {messages:.0f} | {volume / 1e3:.0f} | {reductions:.0f} |"
        )
    # The last is that of two ranks, each with one neighbour; a rank inside has two. A sum goes down a tree of ranks and up again.
    for ranks, sides in ((2, 1), (1000, 2)):
        waiting = sides * (messages * LATENCY + volume / BANDWIDTH) + reductions * 2 * LATENCY * (ranks - 1).bit_length()
        share = waiting / (processor[0] + waiting)
        print(f"{ranks} ranks: {1e3 * waiting:.1f} ms a step for messages and sums, {share:.1%} of the step")


def main():
    if sys.argv[1:2] == ["ranks"]:
        on_ranks(*(int(word) for word in sys.argv[2:5]))
        return
    given = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "OMP_NUM_THREADS": "1"}
    runs = []
    for ranks in (1, 2):
        command = ["mpiexec", "-n", str(ranks), sys.executable, "-m", "mpi4py", __file__, "ranks", *(sys.argv[1:4] or SIZE)]
        done = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ | given)
        runs.append(json.loads(done.stdout.splitlines()[-1]))
        print(json.dumps(runs[-1]), file=sys.stderr)
    table(runs)


if __name__ == "__main__":
    main()
