"""What `test_petsc.py` runs on several ranks: mpiexec -n RANKS python -m mpi4py petsc_cases.py CASE …"""

import json
import os
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "examples/scenarios" / "finite-elements"))

from distributed import Beam  # noqa: E402
from petsc4py import PETSc  # noqa: E402

import fvi  # noqa: E402
import fvi.petsc  # noqa: E402

WORLD = PETSc.COMM_WORLD
RANK, RANKS = WORLD.getRank(), WORLD.getSize()
TOLERANCE = 1e-10
DAMPERS = 5
ZENER = fvi.Kernel.symbol("0.4 + (3*s)^0.6/(1 + (3*s)^0.6)")
"""With a spring in it."""


def dampers(beam):
    """Dampers between neighbouring cross-sections: a column each, on other ranks than its rows."""
    matrix = PETSc.Mat().createAIJ(((beam.local, beam.size), (None, DAMPERS)), nnz=(2, 2), comm=beam.stiffness.getComm())
    first, end = matrix.getOwnershipRange()
    for column in range(DAMPERS):
        for row, entry in ((beam.plane * 3 * column + 1, 1.0), (beam.plane * (3 * column + 1) + 1, -1.0)):
            if first <= row < end:
                matrix.setValue(row, column, entry)
    matrix.assemble()
    return matrix


def along(beam, function):
    """A vector whose numbers depend on the place along the beam."""
    vector = beam.vector()
    first, end = vector.getOwnershipRange()
    vector.setArray(function((np.arange(first, end) // beam.plane + 1) * beam.plane / beam.size))
    return vector


def everything(beam, convert=lambda given: given):
    """Arguments with every kind of term; `convert` turns PETSc objects into arguments for one machine."""
    K = beam.stiffness
    times = np.array([0.0, 17.3, 40.2, 90.0]), np.array([0.0, 1.0, -1.0, 0.5])
    diagonal = along(beam, lambda x: 1e-4 * (x > 0.5))
    return dict(
        mass=convert(beam.mass),
        stiffness=convert(K),
        position=convert(along(beam, lambda x: 1e-2 * x**2)),
        velocity=convert(along(beam, lambda x: 1e-3 * x)),
        step=1.0,
        damping=[
            fvi.Damping(0.6, convert(0.02 * K)),
            fvi.Damping(1.4, convert(0.5 * K)),
            fvi.Damping(0.7, convert(0.002 * K), "riemann-liouville"),
            fvi.Damping(1.0, convert(diagonal)),
            fvi.Damping(0.05, convert(diagonal)),
            fvi.Damping(0.35, attached=convert(dampers(beam)), strength=np.linspace(1e-3, 2e-3, DAMPERS)),
            fvi.Damping(1.2, attached=convert(dampers(beam)), strength=np.linspace(1e-3, 2e-3, DAMPERS)),
            fvi.Damping(kernel=fvi.Kernel.prony([1.0, 0.5], [3.0, 30.0]), coefficient=convert(0.05 * K)),
            fvi.Damping(kernel=ZENER, coefficient=convert(0.03 * K)),
            fvi.Damping(kernel=ZENER, attached=convert(dampers(beam)), strength=np.full(DAMPERS, 1e-3), derivative="riemann-liouville"),
        ],
        loads=[
            fvi.Load(convert(beam.load(1e-5)), "a*step(20.3 - t)"),
            fvi.Load({"coordinate": beam.tip, "value": 1e-6}, times),
            fvi.Load({"coordinate": 5}, "1e-6*sin(0.5*t)"),
        ],
        parameters={"a": 0.7},
        coordinates=list(range(0, beam.size, 7)),
        every=10,
    )


def integrate(**arguments):
    return fvi.petsc.integrate(arguments.pop("mass"), arguments.pop("stiffness"), solver_tolerance=TOLERANCE, **arguments)


def on_one_machine(given):
    import scipy.sparse

    if isinstance(given, PETSc.Vec):
        return given.getArray().copy()
    starts, columns, values = given.getValuesCSR()
    matrix = scipy.sparse.csr_matrix((values, columns, starts), shape=given.getSize())
    # Assembly adds in different orders above and below the diagonal.
    return (matrix + matrix.T) / 2 if matrix.shape[0] == matrix.shape[1] else matrix


def tall(beam, convert=lambda given: given):
    """Some 10⁴ coordinates and damping in proportion to the stiffness."""
    return dict(
        mass=convert(beam.mass),
        stiffness=convert(beam.stiffness),
        position=0.0,
        step=1.0,
        steps=6,
        damping=fvi.Damping(0.6, convert(0.02 * beam.stiffness)),
        loads=fvi.Load(convert(beam.load(1e-6)), "1"),
        coordinates=list(range(0, beam.size, 97)),
        every=3,
    )


def save(path, result):
    if RANK == 0:
        np.savez(path, t=result.t, q=result.q, p=result.p, energy=result.energy, summary=json.dumps(result.summary))


def reference(directory):
    """Both problems on one machine."""
    if RANK == 0:
        small, large = Beam(PETSc.COMM_SELF, 20, 3), Beam(PETSc.COMM_SELF, 42, 8)
        save(f"{directory}/small.npz", fvi.integrate(steps=60, **everything(small, on_one_machine)))
        save(f"{directory}/large.npz", fvi.integrate(**tall(large, on_one_machine)))


def compare(directory):
    save(f"{directory}/small-{RANKS}.npz", integrate(steps=60, **everything(Beam(WORLD, 20, 3))))
    save(f"{directory}/large-{RANKS}.npz", integrate(**tall(Beam(WORLD, 42, 8))))
    # The small one again, as a system that every rank has as a whole.
    given = everything(Beam(PETSc.COMM_SELF, 20, 3), on_one_machine)
    system = fvi.System(**{name: given.pop(name) for name in ("mass", "stiffness", "damping", "loads", "parameters")})
    save(f"{directory}/system-{RANKS}.npz", fvi.petsc.integrate(system, steps=60, solver_tolerance=TOLERANCE, **given))
    for unlike, words in (
        (fvi.System(mass=np.ones(6), stiffness=np.full(6, 1.0 + RANK)), "stiffness: " if RANKS > 1 else ""),
        (fvi.System(mass=np.ones(6), potential="q0^4"), "potential: on ranks a system is linear"),
        (fvi.System(mass=np.ones(6)), "stiffness: missing"),
        (fvi.System(mass=1.0, stiffness=None), "mass: a number for each"),
    ):
        if words:
            try:
                fvi.petsc.integrate(unlike, position=0.0, step=0.1, steps=1)
            except fvi.InputError as error:
                assert words in str(error), error
            else:
                raise AssertionError(words)


def run(directory, steps, *how):
    """Runs the small problem with output files until it ends or is stopped; `how` gives the rank (−1: all), the signal, and the
    step after which it is sent."""
    beam = Beam(WORLD, 20, 3)
    arguments = everything(beam)
    if how:
        rank, step, number = (int(word) for word in how)
        push = fvi.Memory.push
        pushes = 0

        def push_or_die(memory, sample):
            nonlocal pushes
            pushes += 1
            if pushes == step * len(arguments["damping"]) and rank in (RANK, -1):
                os.kill(os.getpid(), number)
            push(memory, sample)

        fvi.Memory.push = push_or_die
    mesh = fvi.petsc.Mesh(beam.points, beam.cells, "hexahedron", beam.rows)
    output = fvi.petsc.Output(f"{directory}/out", snapshots=20, mesh=mesh)
    try:
        result = integrate(steps=int(steps), output=output, checkpoint_every=7, resume=True, **arguments)
    except KeyboardInterrupt as interrupt:
        save(f"{directory}/interrupted.npz", interrupt.result)
        return
    save(f"{directory}/finished.npz", result)


def numbers_of_ranks(directory):
    """A system with fewer rows than ranks: PETSc's binary snapshots, rows without energy, another solver, f32 states, no steps."""
    mass, stiffness = PETSc.Vec().createMPI(2, comm=WORLD), PETSc.Mat().createAIJ((2, 2), nnz=1, comm=WORLD)
    mass.set(1.0)
    first, end = stiffness.getOwnershipRange()
    for row in range(first, end):
        stiffness.setValue(row, row, 4.0)
    stiffness.assemble()
    output = fvi.petsc.Output(f"{directory}/binary", snapshots=25, format="petsc")
    result = fvi.petsc.integrate(
        mass, stiffness, position=1.0, step=0.01, end=1.0, damping=fvi.Damping(0.5, 0.1), energy=False, output=output
    )
    save(f"{directory}/oscillator.npz", result)
    solver = PETSc.KSP().create(WORLD)
    solver.setType("cg")
    solver.getPC().setType("jacobi")
    solver.setTolerances(rtol=1e-6)
    arguments = dict(position=1.0, momentum=0.5, step=0.01, damping=fvi.Damping(0.5, 0.1), order=1)
    rough = fvi.petsc.integrate(mass, stiffness, steps=100, ksp=solver, tolerance=1e-6, states="f32", **arguments)
    assert solver.getTolerances()[0] == 1e-6 and rough.summary["solver"]["preconditioner"] == "jacobi"
    save(f"{directory}/rough.npz", rough)
    still = fvi.petsc.integrate(mass, stiffness, steps=0, **arguments)
    assert still.t.tolist() == [0.0] and still.q.tolist() == [[1.0, 1.0]] and still.p.tolist() == [[0.5, 0.5]]


def refusals(directory):
    """Invalid arguments: the error on every rank for each of them."""
    beam = Beam(WORLD, 4, 2)
    good = dict(mass=beam.mass, stiffness=beam.stiffness, position=0.0, step=0.1, steps=3)
    other = Beam(WORLD, 5, 2)
    open_matrix = PETSc.Mat().createAIJ(((beam.local, beam.size),) * 2, nnz=1, comm=WORLD)
    uneven = 3 if RANK == 0 else (beam.size - 3 if RANK == RANKS - 1 else 0)
    shifted = PETSc.Vec().createMPI((uneven, beam.size), comm=WORLD)
    shifted_matrix = PETSc.Mat().createAIJ(((uneven, beam.size),) * 2, nnz=1, comm=WORLD)
    shifted_matrix.assemble()
    alone = PETSc.Vec().createSeq(beam.size, comm=PETSc.COMM_SELF)
    spoilt = beam.vector()
    if RANK == RANKS - 1:
        spoilt.getArray()[-1] = np.nan
    crooked = beam.stiffness.copy()
    if RANK == 0:
        crooked.setValue(0, 1, 7.0)
    crooked.assemble()
    wide = PETSc.Mat().createAIJ(((beam.local, beam.size), (None, 3)), nnz=1, comm=WORLD)
    wide.assemble()
    hollow = PETSc.Mat().createAIJ(((beam.local, beam.size),) * 2, nnz=1, comm=WORLD)
    if RANK == 0:
        hollow.setValue(0, 1, -1e-3)
        hollow.setValue(1, 0, -1e-3)
    hollow.assemble()
    shell = PETSc.Mat().createPython(((beam.local, beam.size),) * 2, object(), comm=WORLD)
    shell.setUp()
    damping = fvi.Damping(0.5, beam.stiffness)
    Output = fvi.petsc.Output
    cases = {
        "mass": dict(mass=None),
        "mass nothing": dict(mass=None, stiffness=None),
        "mass negative": dict(mass=-1.0 * beam.mass),
        "mass empty": dict(mass=PETSc.Vec()),
        "mass zero": dict(mass=beam.vector()),
        "stiffness open": dict(stiffness=open_matrix),
        "stiffness other": dict(stiffness=other.stiffness),
        "stiffness shifted": dict(stiffness=shifted_matrix),
        "stiffness crooked": dict(stiffness=crooked),
        "stiffness vector": dict(stiffness=beam.vector()),
        "stiffness wide": dict(stiffness=wide),
        "position shifted": dict(position=shifted),
        "position alone": dict(position=alone),
        "position nan": dict(position=spoilt),
        "position list": dict(position=[0.0] * beam.size),
        "position differs": dict(position=0.1 * RANK),
        "velocity": dict(momentum=0.0, velocity=0.0),
        "step differs": dict(step=0.1 + RANK),
        "step negative": dict(step=-1.0),
        "steps differ": dict(steps=3 + RANK),
        "steps none": dict(steps=None),
        "steps word": dict(steps=3 if RANK == 0 else "three"),
        "end": dict(steps=None, end=0.55),
        "order": dict(order=3),
        "damping differs": dict(damping=[damping] * (1 + RANK)),
        "damping number": dict(damping=fvi.Damping(0.5, 0.1 + RANK)),
        "damping strength": dict(damping=fvi.Damping(0.5, attached=wide, strength=[1.0 + RANK, 1.0, 1.0])),
        "damping[0].coefficient hollow": dict(damping=fvi.Damping(0.5, hollow)),
        "damping[0].coefficient shell": dict(damping=fvi.Damping(0.5, shell)),
        "damping[0].order": dict(damping=fvi.Damping(2.5, beam.stiffness)),
        "damping[0].order missing": dict(damping={"coefficient": beam.stiffness}),
        "damping[0].order both": dict(damping=fvi.Damping(0.5, beam.stiffness, kernel=ZENER)),
        "damping[0].kernel": dict(damping=fvi.Damping(kernel=fvi.Kernel.symbol("s - s^0.5"), coefficient=beam.stiffness)),
        "damping[0].kernel.rate": dict(damping={"kernel": {"form": "tempered", "order": 0.5, "rate": -1}, "coefficient": 1.0}),
        "damping[0].kernel without exponentials": dict(
            damping=fvi.Damping(kernel=fvi.Kernel.symbol("s/sqrt(s^2 + s + 1)"), coefficient=beam.stiffness), horizon=10**4
        ),
        "damping[0].kind": dict(damping={"order": 0.5, "coefficient": beam.stiffness, "kind": 1}),
        "damping[0].coefficient": dict(damping=fvi.Damping(0.5, -1.0 * beam.stiffness)),
        "damping[0].coefficient number": dict(damping=fvi.Damping(0.5, -1.0)),
        "damping[0].coefficient other": dict(damping=fvi.Damping(0.5, other.stiffness)),
        "damping[0].coefficient open": dict(damping=fvi.Damping(0.5, open_matrix)),
        "damping[0].strength": dict(damping=fvi.Damping(0.5, attached=wide, strength=[1.0, -1.0, 1.0])),
        "damping[0].strength short": dict(damping=fvi.Damping(0.5, attached=wide, strength=[1.0])),
        "loads[0].pattern": dict(loads=fvi.Load(alone, "t")),
        "loads[0].pattern.coordinate": dict(loads=fvi.Load({"coordinate": beam.size}, "t")),
        "loads[0].amplitude": dict(loads=fvi.Load({"coordinate": 0}, "t + x")),
        "loads[0].amplitude[0][1]": dict(loads=fvi.Load({"coordinate": 0}, ([0.0, 0.0], [1.0, 1.0]))),
        "loads' patterns": dict(loads=fvi.Load({"coordinate": RANK}, "t")),
        "loads differ": dict(loads=fvi.Load({"coordinate": 0}, f"{1 + RANK}*t")),
        "tolerance": dict(damping=damping, tolerance=1.0),
        "states": dict(damping=damping, states="f32"),
        "solver_tolerance": dict(solver_tolerance=1.0),
        "ksp": dict(ksp="cg"),
        "near_null_space": dict(near_null_space=1),
        "coordinates": dict(coordinates=[0, beam.size]),
        "coordinates twice": dict(coordinates=[0, 0]),
        "resume": dict(resume=True),
        "checkpoint_every": dict(checkpoint_every="soon", output=f"{directory}/refused"),
        "output": dict(output=3),
        "output.format": dict(output=Output(f"{directory}/refused", 1, "vtk")),
        "output.mesh": dict(output=Output(f"{directory}/refused", mesh=fvi.petsc.Mesh([], [], "wedge", []))),
        "output.mesh.kind": dict(output=Output(f"{directory}/refused", 1, mesh=fvi.petsc.Mesh([], [], "ball", []))),
        "output.mesh.rows": dict(
            output=Output(f"{directory}/refused", 1, mesh=fvi.petsc.Mesh([[0, 0, 0]], [], "wedge", [[0, 0, beam.size]]))
        ),
        "StepError solver": dict(position=1.0, options={"fvi_ksp_max_it": 1, "fvi_pc_type": "none"}),
        "StepError residual": dict(position=1.0, options={"fvi_ksp_rtol": 0.5}),
        "stiffness pushes": dict(stiffness=-1e3 * beam.stiffness, position=1.0, step=10.0),
        "StepError amplitude": dict(loads=fvi.Load({"coordinate": 0}, "1/(t - 0.25) + 0*log(0.25 - t)")),
        "StepError overflow": dict(loads=fvi.Load({"coordinate": 0, "value": 1e300}, "1e300*t")),
        "ksp options": dict(options={"fvi_pc_type": "no-such"}),
        "ZeroDivisionError": dict(progress=(lambda made, all: 1 // 0) if RANK == 0 else None),
        "OSError": dict(output="/dev/null/no"),
        "MemoryError": dict(damping=damping, spoil=True),
    }
    begun = dict(output=f"{directory}/begun", position=0.1, steps=4, damping=damping)
    fvi.petsc.integrate(beam.mass, beam.stiffness, step=0.1, checkpoint_every=2, **begun)
    cases |= {
        "output other step": begun | dict(resume=True, step=0.2),
        "output other damping": begun | dict(resume=True, damping=fvi.Damping(0.5, 2.0 * beam.stiffness)),
        "steps fewer": begun | dict(resume=True, steps=3),
        "steps too many": begun | dict(resume=True, steps=10**9),
        "output locked": dict(output=f"{directory}/held"),
    }
    if RANK == 0:
        held = fvi.petsc._output.Directory(f"{directory}/held", 0)
    said = {}
    for name, change in cases.items():
        options = PETSc.Options()
        given = dict(change)
        for option, value in (chosen := given.pop("options", {})).items():
            options[option] = value
        push = fvi.Memory.push
        if given.pop("spoil", False) and RANK == RANKS - 1:

            def full(memory, sample):
                raise MemoryError("no room for the sample")

            fvi.Memory.push = full
        try:
            arguments = good | given
            fvi.petsc.integrate(arguments.pop("mass"), arguments.pop("stiffness"), **arguments)
            said[name] = None
        except Exception as error:
            said[name] = [type(error).__name__, getattr(error, "key", ""), str(error)]
        fvi.Memory.push = push
        for option in chosen:
            options.delValue(option)
    # Its context would be destroyed after the interpreter.
    shell.destroy()
    everyone = WORLD.tompi4py().gather(said)
    if RANK == 0:
        held.close()
        Path(directory, "said.json").write_text(json.dumps(everyone))


def traffic(directory):
    """Messages, bytes and reductions of all steps, for runs of several lengths whose solver makes the same iterations."""
    options = PETSc.Options()
    for option, value in {"ksp_max_it": 5, "ksp_norm_type": "none", "ksp_convergence_test": "skip"}.items():
        options[f"fvi_{option}"] = value
    PETSc.Log.begin()
    beam = Beam(WORLD, 20, 3)
    event = PETSc.Log.Event("fvi step")
    found, before = {}, np.zeros(3)
    for steps in (10, 30, 110):
        arguments = everything(beam) | dict(every=10**6, energy=False, coordinates=[])
        integrate_without_residual(steps=steps, **arguments)
        info = event.getPerfInfo()
        counts = np.array([info[name] for name in ("numMessages", "messageLength", "numReductions")])
        found[steps] = (counts - before).tolist()
        before = counts
    everyone = WORLD.tompi4py().gather(found)
    if RANK == 0:
        Path(directory, "traffic.json").write_text(json.dumps(everyone))


def integrate_without_residual(**arguments):
    """For a fixed number of iterations: the residual is not checked."""
    from fvi.petsc import _step

    most, _step.MOST_CORRECTIONS = _step.MOST_CORRECTIONS, 0
    balance = _step.Stepper._balance
    _step.Stepper._balance = lambda stepper, impulses: 0.0 * balance(stepper, impulses)
    try:
        return fvi.petsc.integrate(arguments.pop("mass"), arguments.pop("stiffness"), **arguments)
    finally:
        _step.Stepper._balance, _step.MOST_CORRECTIONS = balance, most


if __name__ == "__main__":
    case, *words = sys.argv[1:]
    {function.__name__: function for function in (reference, compare, run, numbers_of_ranks, refusals, traffic)}[case](*words)
