"""What the types tell before a program runs."""

from pathlib import Path

from mypy import api

EXAMPLES = Path(__file__).parents[1] / "examples"
ORDINARY = ["--config-file=", "--ignore-missing-imports", "--check-untyped-defs"]

CALLS = """\
import numpy as np
import fvi
fvi.integrate(mass=[1.0], position=[1.0], step=0.1, steps=3, scheme_="galerkin")  # wrong
fvi.integrate(mass=[1.0], position=[1.0], step=0.1, steps=3, scheme="galerkn")  # wrong
fvi.integrate(mass=[1.0], position=[1.0], step=0.1, steps=3, engine="block-ft")  # wrong
fvi.run({}, ever=3)  # wrong
fvi.Damping(0.5, 1.0, derivative="caputoo")  # wrong
fvi.fit({}, {}, {}, startz=3)  # wrong
fvi.converge({}, (1, 2), enginee="direct")  # wrong
fvi.integrate(mass=[1.0], position=[1.0], steps=3, end=1.0, grid="gradd")  # wrong
fvi.integrate(mass=[1.0], position=[1.0], step=0.1, steps=3, times="0.1")  # wrong
fvi.integrate(mass=[1.0], position=[1.0], step=0.1, steps=3, precision="f16")  # wrong
fvi.run({}, quadrature="gauss2")  # wrong
fvi.Model(mass=[1.0], positon=[1.0])  # wrong
fvi.Model(mass=[1.0], position=[1.0], grid="gradd")  # wrong
model = fvi.Model(mass=[1.0], position=[1.0], step=np.float32(0.1), steps=np.int64(3), scheme="galerkin", degree=np.int32(2))
model.integrate(stepz=3)  # wrong
model.integrate(overflow="forgett")  # wrong
model.integrate(steps=np.int64(3), loads=fvi.Load([1.0], "sin(t)"), precision="f32", progress=None)
model.run({"k": 1.0}, checks=False)  # wrong
model.batch({"k": [1.0]}, job=2)  # wrong
model.gradient(["k"], lambda r: r.q, most=3)  # wrong
fvi.integrate_cases({}, mass=[1.0], postion=[1.0])  # wrong
fvi.integrate_cases({}, fvi.System(mass=[1.0]), position=[1.0], step=0.1, steps=np.int32(3), scheme="low-order")
fvi.response({}, [1.0], nera=2.0)  # wrong
fvi.response({}, [1.0], scheme="galerkn")  # wrong
fvi.response({}, np.ones(3), near=2.0, points=np.int64(40), step=np.float64(0.1), order=2)
fvi.tune({}, override={})  # wrong
fvi.solve_fde(["x0"], 0.5, 1.0, [1.0], rtoll=1e-6)  # wrong
fvi.sweep({}, job=2)  # wrong
fvi.System(mass=[1.0], stifness=[1.0])  # wrong
fvi.Event("q0", "risingg")  # wrong
fvi.FractionalPid(sample=0.1, kpp=2.0)  # wrong
fvi.FractionalPid(sample=0.1, kp=2.0, form="serial")  # wrong
fvi.FractionalPid(sample=0.1, kp=np.float64(2.0), limits=[-1.0, 1.0], anti_windup={"kind": "conditional"})
fvi.Memory(exponent=0.5, step=0.1, engin="direct")  # wrong
fvi.Memory(exponent=0.5, step=0.1, engine="direkt")  # wrong
fvi.derivative([1.0, 2.0], 0.5, 0.1, starts="caputo")  # wrong
fvi.weights(exponent=0.5, step=0.1, cont=3)  # wrong
fvi.integrate(mass=[1.0], position=[1.0], steps=4, end=1.0, grid="graded", exponent=np.float64(2.0))
fvi.integrate(mass=[1.0], position=(1, 2), grid=np.linspace(0.0, 1.0, 9), coordinates=range(2), times=[0.5])
fvi.converge({}, (1, 2), engine="direct")
fvi.integrate(mass=[1.0], position=[1.0], step=np.float32(0.1), steps=np.int64(3), order=np.int32(2))
fvi.integrate(fvi.System(mass=1.0, parameters={"k": 1.0}), position=np.ones(3), step=1, end=2)
"""


def test_misspelt_names_are_found_and_numpys_scalars_are_taken(tmp_path):
    script = tmp_path / "calls.py"
    script.write_text(CALLS, encoding="utf-8")
    said, failed, _ = api.run([*ORDINARY, str(script)])
    found = {int(line.split(":")[-3]) for line in said.splitlines() if ": error:" in line}
    wrong = {number for number, line in enumerate(CALLS.splitlines(), 1) if line.endswith("# wrong")}
    assert found == wrong and failed == "", said + failed


def test_the_examples_have_no_errors():
    said, failed, code = api.run([*ORDINARY, *map(str, sorted(EXAMPLES.glob("*.py")))])
    assert code == 0, said + failed
