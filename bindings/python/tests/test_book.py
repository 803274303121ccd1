"""The Python of the README and of the book, as a reader has it: run from top to bottom, and seen by mypy."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
FRAGMENT = re.compile(r"^```python(?: \S+)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# One rank of PETSc, which .ci/petsc has, and a strategy that speaks to the program through pipes, which .ci/strategies has.
ELSEWHERE = {"book/src/use/cluster.md", "book/src/engines/strategies.md"}


def pages_with_python():
    for page in [ROOT / "README.md", ROOT / "bindings/python/README.md", *sorted((ROOT / "book/src").rglob("*.md"))]:
        name = page.relative_to(ROOT).as_posix()
        if name not in ELSEWHERE and FRAGMENT.search(page.read_text(encoding="utf-8")):
            yield name


PAGES = list(pages_with_python())


def program(page):
    """The fragments of a page one after another, each at the lines where the page has it."""
    text = (ROOT / page).read_text(encoding="utf-8")
    program = ""
    for fragment in FRAGMENT.finditer(text):
        begins = text.count("\n", 0, fragment.start(1))
        program += "\n" * (begins - program.count("\n")) + fragment[1]
    return program


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A folder with the examples, where pages may write."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_pages_with_python_are_found():
    assert {"README.md", "book/src/use/python.md", "book/src/use/equations.md", "book/src/start/python.md"} <= set(PAGES)
    assert all((ROOT / page).exists() for page in ELSEWHERE)


@pytest.mark.parametrize("page", PAGES)
def test_the_fragments_of_a_page_run_one_after_another(page, checkout):
    (checkout / "page.py").write_text(program(page), encoding="utf-8")
    ran = subprocess.run(
        [sys.executable, "page.py"], capture_output=True, text=True, env={**os.environ, "MPLBACKEND": "agg"}, timeout=600
    )
    assert ran.returncode == 0, ran.stderr


def test_mypy_has_nothing_against_them(checkout):
    names = []
    for page in PAGES:
        names.append(page.replace("/", "_").removesuffix(".md").lower() + ".py")
        (checkout / names[-1]).write_text(program(page), encoding="utf-8")
    # Each is a program of its own, since pages use the same names for other things.
    checks = [subprocess.run([sys.executable, "-m", "mypy", "--ignore-missing-imports", name], capture_output=True, text=True) for name in names]
    assert all(check.returncode == 0 for check in checks), "".join(check.stdout for check in checks)
