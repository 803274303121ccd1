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
