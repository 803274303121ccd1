"""fvi.petsc under mpiexec: `petsc_cases.py` contains the code of the ranks."""

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import xml.etree.ElementTree
from pathlib import Path

import numpy as np
import pytest

CASES = Path(__file__).with_name("petsc_cases.py")
TOLERANCE = 1e-10
SECONDS = float(os.environ.get("FVI_PETSC_SECONDS", "150"))
"""No case takes as long unless its ranks wait for each other in vain."""

under_mpi = pytest.mark.skipif(
    importlib.util.find_spec("petsc4py") is None or shutil.which("mpiexec") is None, reason="needs petsc4py and mpiexec"
)


def ranks(count, case, *words):
    """Runs a case on a number of ranks; returns the exit code and the output."""
    given = {
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        # Ranks share processors here with each other and with other processes.
        "OMPI_MCA_mpi_yield_when_idle": "1",
        "OMP_NUM_THREADS": "1",
    }
    command = ["mpiexec", "-n", str(count), sys.executable, "-m", "mpi4py", CASES, case, *map(str, words)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ | given, start_new_session=True
    )
    try:
        said, _ = process.communicate(timeout=SECONDS)
    except subprocess.TimeoutExpired:
        # mpiexec ends its ranks.
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=30)
        pytest.fail(f"{case} on {count} ranks hangs: {said}")
    return process.returncode, said


def succeed(count, case, *words):
    code, said = ranks(count, case, *words)
    assert code == 0, said
    return said


def differences(found, expected):
    """Largest differences, relative to the largest numbers."""
    return {name: np.abs(found[name] - expected[name]).max() / np.abs(expected[name]).max() for name in ("t", "q", "p", "energy")}


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    return tmp_path_factory.mktemp("petsc")


@pytest.fixture(scope="module")
def expected(directory):
    succeed(1, "reference", directory)
    return {name: np.load(directory / f"{name}.npz") for name in ("small", "large")}


def test_without_petsc4py_the_import_says_what_to_install():
    blocked = [("mpi4py", "petsc4py")] + ([("petsc4py",)] if importlib.util.find_spec("mpi4py") else [])
    for missing in blocked:
        code = f"import sys; sys.modules.update(dict.fromkeys({missing!r})); import fvi.petsc"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert done.returncode != 0 and f"fvi.petsc needs the package {missing[0]}" in done.stderr, done.stderr
        assert "apt-get install python3-petsc4py python3-mpi4py" in done.stderr


@under_mpi
@pytest.mark.parametrize("count", [1, 2, 3])
def test_ranks_together_make_the_motion_of_one_machine(count, directory, expected):
    succeed(count, "compare", directory)
    for name, same in (("small", "small"), ("system", "small"), ("large", "large")):
        found = np.load(directory / f"{name}-{count}.npz")
        errors = differences(found, expected[same])
        assert errors.pop("t") == 0.0
        assert max(errors.values()) <= 10.0 * TOLERANCE, (name, errors)
    summary = json.loads(str(found["summary"]))
    assert summary["ranks"] == count and summary["coordinates"] > 10_000
    assert summary["seconds"]["memory"] < 0.3 * summary["seconds"]["all"]


@under_mpi
def test_a_killed_rank_ends_the_job_and_other_numbers_of_ranks_go_on(tmp_path, expected):
    code, said = ranks(2, "run", tmp_path, 60, 1, 25, signal.SIGKILL.value)
    assert code != 0 and "signal 9" in said, said
    place = tmp_path / "out" / "checkpoint"
    manifest = json.loads((place / "manifest.json").read_text())
    assert manifest["step"] == 21
    # A bit of the newest generation is flipped on the disk; the generation before is used, and the run is stopped by a signal.
    path = place / manifest["files"][1][0]
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    said = succeed(3, "run", tmp_path, 60, 0, 20, signal.SIGTERM.value)
    assert "damaged" in said and path.name in said
    interrupted = np.load(tmp_path / "interrupted.npz")
    summary = json.loads(str(interrupted["summary"]))
    assert (summary["resumed_at"], summary["steps"], summary["ranks"]) == (14, 34, 3)
    assert interrupted["t"].tolist() == [0.0, 10.0, 20.0, 30.0]
    succeed(1, "run", tmp_path, 60)
    finished = np.load(tmp_path / "finished.npz")
    assert json.loads(str(finished["summary"]))["resumed_at"] == 34
    errors = differences(finished, expected["small"])
    assert max(errors.values()) <= 10.0 * TOLERANCE, errors
    import fvi

    read = fvi.load(tmp_path / "out")
    assert read.success and np.array_equal(read.q, finished["q"]) and np.array_equal(read.p, finished["p"])
    with np.load(tmp_path / "out" / "trajectory.npz") as written:
        assert all(np.array_equal(written[name], finished[name]) for name in ("t", "q", "p", "energy"))
    assert_snapshots(tmp_path / "out", finished, {0: 2, 20: 3, 40: 1, 60: 1})


def assert_snapshots(out, finished, ranks_of):
    """Files of all steps and ranks, whose parts make up the rows; and an index whose references exist."""
    for step, count in ranks_of.items():
        parts = [np.load(path) for path in sorted(out.glob(f"snapshots/{step:012d}.rank-*-of-*.npz"))]
        assert len(parts) == count and [float(part["t"]) for part in parts] == [step] * count
        assert parts[0]["first"] == 0 and all(b["first"] == a["first"] + len(a["q"]) for a, b in zip(parts, parts[1:]))
        whole = np.concatenate([part["q"] for part in parts])
        assert np.array_equal(whole[::7], finished["q"][step // 10])
    h5py = pytest.importorskip("h5py")
    steps = xml.etree.ElementTree.parse(out / "snapshots.xdmf").getroot().find("Domain/Grid").findall("Grid")
    assert [float(grid.find("Time").get("Value")) for grid in steps] == list(ranks_of)
    for grid, count in zip(steps, ranks_of.values()):
        pieces = grid.findall("Grid")
        assert len(pieces) == count
        cells = 0
        for piece in grid.findall("Grid"):
            points, corners = (piece.find(f"{name}/DataItem").text.partition(":") for name in ("Geometry", "Topology"))
            with h5py.File(out / points[0]) as file:
                a, b, d, e = (file[points[2]][:][file[corners[2]][:, corner]] for corner in (0, 1, 3, 4))
                # Round the lower face, then upwards.
                assert (np.einsum("ij,ij->i", np.cross(b - a, d - a), e - a) > 0.0).all()
        for item in grid.iter("DataItem"):
            name, _, path = item.text.partition(":")
            with h5py.File(out / name) as file:
                assert file[path].shape == tuple(map(int, item.get("Dimensions").split()))
                cells += len(file[path]) if path == "/cells" else 0
        assert cells == 20 * 3 * 3


@under_mpi
def test_a_job_killed_as_a_whole_is_carried_further_to_the_bits_of_one_that_was_not(tmp_path, directory, expected):
    code, _ = ranks(2, "run", tmp_path, 40, -1, 25, signal.SIGKILL.value)
    assert code != 0
    succeed(2, "run", tmp_path, 60)
    found = np.load(tmp_path / "finished.npz")
    assert json.loads(str(found["summary"]))["resumed_at"] == 21
    errors = differences(found, expected["small"])
    assert max(errors.values()) <= 10.0 * TOLERANCE, errors
    # On the same number of ranks the memory is bit-identical, and the solver's sums have the same order.
    undisturbed = np.load(directory / "small-2.npz")
    assert max(differences(found, undisturbed).values()) < 1e-3 * TOLERANCE


@under_mpi
def test_whatever_cannot_be_used_is_one_error_on_all_ranks(tmp_path):
    succeed(2, "refusals", tmp_path)
    first, second = json.loads((tmp_path / "said.json").read_text())
    for name, said in first.items():
        assert said is not None, f"{name} was taken"
        kind, key, message = said
        assert second[name] == said, name
        wanted = name if name.startswith("loads'") else name.split()[0]
        if wanted.endswith("Error"):
            assert kind == wanted or (kind == "NotADirectoryError" and wanted == "OSError"), (name, said)
        else:
            assert kind == "InputError" and key == wanted, (name, said)
            assert message.removeprefix("rank 0: ").removeprefix("rank 1: ").startswith(wanted), (name, said)
    assert "DIVERGED_MAX_IT" in first["StepError solver"][2]
    assert "rank 1: position[" in first["position nan"][2]
    assert "other arguments on 2" in first["position alone"][2]
    assert "not assembled" in first["stiffness open"][2]
    assert "all are to be distributed alike" in first["stiffness shifted"][2]
    assert "3 on rank 0, 4 on rank 1" in first["steps differ"][2]
    assert "none on the diagonal" in first["damping[0].coefficient hollow"][2]
    assert "not symmetric" in first["stiffness crooked"][2]


@under_mpi
def test_what_ranks_send_in_a_step_does_not_depend_on_the_number_of_steps(tmp_path):
    succeed(2, "traffic", tmp_path)
    for counts in json.loads((tmp_path / "traffic.json").read_text()):
        short, middle, long = (np.array(counts[steps]) for steps in ("10", "30", "110"))
        assert np.array_equal((middle - short) / 20, (long - middle) / 80), counts
        assert (middle > short).all()


@under_mpi
def test_ranks_without_rows_snapshots_of_petsc_and_other_solvers(tmp_path):
    succeed(3, "numbers_of_ranks", tmp_path)
    import fvi

    common = dict(mass=[1.0], stiffness=[4.0], position=[1.0], step=0.01, end=1.0, damping=fvi.Damping(0.5, [0.1]), at="nodes")
    found, one = np.load(tmp_path / "oscillator.npz"), fvi.integrate(order=2, **common)
    assert np.abs(found["q"] - one.q).max() < 10.0 * TOLERANCE and np.isnan(found["energy"]).all()
    rough, one = np.load(tmp_path / "rough.npz"), fvi.integrate(order=1, momentum=[0.5], **common)
    errors = [np.abs(rough[name] - getattr(one, name)).max() for name in ("q", "p")]
    # The error is that of single precision, and not larger.
    assert 1e-12 < max(errors) < 1e-5, errors
    names = sorted(path.name for path in (tmp_path / "binary" / "snapshots").iterdir())
    assert names == [f"{step:012d}.petsc" for step in (0, 25, 50, 75, 100)]
    # PETSc's format: a vector is its class, its length and its numbers, most significant bytes first.
    content = (tmp_path / "binary" / "snapshots" / names[-1]).read_bytes()
    assert np.frombuffer(content, ">i4", 2).tolist() == [1211214, 2]
    assert np.array_equal(np.frombuffer(content, ">f8", 2, 8), found["q"][-1])
