"""Argument forms common in other libraries: accepted where the meaning is clear, otherwise refused with the right name."""

import numpy as np
import pytest
import scipy.sparse as sp

import fvi

COMMON = dict(mass=[1.0, 1.0], position=[0.1, 0.2], step=0.1, steps=4)


def chain(n):
    return sp.diags([-1.0, 2.1, -1.0], [-1, 0, 1], shape=(n, n)).tocsr()


@pytest.mark.parametrize("n", [5, 200])
@pytest.mark.parametrize("triangle", [sp.triu, sp.tril])
def test_one_triangle_is_refused_with_what_to_write(n, triangle):
    half = triangle(chain(n)).tocsr()
    given = dict(mass=np.ones(n), position=0.0, step=0.1, steps=1)
    for key, arguments in (
        ("stiffness", dict(stiffness=half)),
        ("damping[0].coefficient", dict(damping=fvi.Damping(0.5, half))),
    ):
        with pytest.raises(fvi.InputError, match=f"triangle only.*{triangle.__name__}") as refused:
            fvi.integrate(**given, **arguments)
        assert refused.value.key == key
    fvi.integrate(**given, stiffness=half + (half - sp.diags(half.diagonal())).T)


def test_what_is_not_symmetric_is_named_by_its_argument():
    bent = chain(200).tolil()
    bent[3, 4] = 5.0
    with pytest.raises(fvi.InputError, match="not symmetric") as refused:
        fvi.integrate(mass=np.ones(200), stiffness=bent.tocsr(), position=0.0, step=0.1, steps=1)
    assert refused.value.key == "stiffness" and ".npz" not in str(refused.value)


@pytest.mark.parametrize("name, instead", [("t_span", "end"), ("t_eval", "times"), ("dense_output", "r(t)"), ("rtol", "tolerance"),
                                           ("method", "scheme"), ("y0", "position"), ("dt", "step")])
def test_names_of_other_packages_are_refused_with_the_one_to_use(name, instead):
    with pytest.raises(fvi.InputError) as refused:
        fvi.integrate(**COMMON, **{name: [0.0, 1.0]})
    assert refused.value.key == name and f"`{instead}`" in str(refused.value)
    with pytest.raises(fvi.InputError, match="no such argument"):
        fvi.run({"system": {"mass": [1.0]}}, **{name: [0.0, 1.0]})


def test_keys_of_the_program_are_arguments():
    with pytest.raises(fvi.InputError) as refused:
        fvi.integrate(**COMMON, threads=0)
    assert refused.value.key == "threads"
    with pytest.raises(fvi.InputError, match="no such key; did you mean threads?") as refused:
        fvi.integrate(**COMMON, thread=1)
    for name in ("scheme", "degree", "convolution", "stages", "engine", "horizon", "states", "grid", "must_hit", "memory_energy"):
        assert f" {name}," in str(refused.value), name


def test_coordinates_may_be_a_range_a_slice_or_a_tuple():
    n = 200
    given = dict(mass=np.ones(n), stiffness=chain(n), position=np.linspace(0.0, 1.0, n), step=0.1, steps=2)
    chosen = fvi.integrate(**given, coordinates=[10, 12, 14]).q
    for coordinates in (range(10, 16, 2), slice(10, 16, 2), (10, 12, 14), np.array([10, 12, 14]), [10.0, 12, 14]):
        assert np.array_equal(fvi.integrate(**given, coordinates=coordinates).q, chosen), coordinates
    assert fvi.integrate(**given, coordinates=slice(-3, None)).coordinates == [197, 198, 199]


def test_whole_numbers_may_be_floats():
    result = fvi.integrate(**{**COMMON, "steps": 4.0}, every=2.0, order=2.0)
    assert np.allclose(result.t, [0.0, 0.2, 0.4])
    with pytest.raises(fvi.InputError, match="whole number"):
        fvi.integrate(**{**COMMON, "steps": 4.5})


def test_powers_may_be_written_as_in_python():
    one = fvi.integrate(potential="q0**2 + q1**4", force=["t**2", "0"], **COMMON)
    other = fvi.integrate(potential="q0^2 + q1^4", force=["t^2", "0"], **COMMON)
    assert np.array_equal(one.q, other.q)
    loads = [fvi.Load([1.0, 0.0], amplitude) for amplitude in ("t**2", "t^2")]
    assert np.array_equal(*(fvi.integrate(loads=load, **COMMON).q for load in loads))


def test_dictionaries_take_a_single_force_and_rest():
    scenario = {"system": {"mass": [1.0], "force": "sin(t)"}, "initial": {"position": [0.0]}, "time": {"step": 0.1, "steps": 4}}
    direct = fvi.integrate(mass=[1.0], force="sin(t)", position=[0.0], step=0.1, steps=4)
    assert np.array_equal(fvi.run(scenario).q, direct.q)


def test_a_sparse_hessian_is_taken():
    stiffness = np.array([[2.0, -1.0], [-1.0, 2.0]])
    potential = lambda hessian: fvi.Potential(lambda q: 0.5 * q @ stiffness @ q, lambda q: stiffness @ q, hessian)
    dense = fvi.integrate(potential=potential(lambda q: stiffness), **COMMON)
    sparse = fvi.integrate(potential=potential(lambda q: sp.csr_matrix(stiffness)), **COMMON)
    assert np.array_equal(dense.q, sparse.q)


@pytest.mark.parametrize("mass", [np.array([1.0, 2.0, 4.0]), np.diag([1.0, 2.0, 3.0]) + 0.1,
                                  sp.csr_matrix(np.diag([1.0, 2.0, 3.0]) + 0.1)], ids=["diagonal", "dense", "sparse"])
def test_velocities_and_positions_between_rows(mass):
    given = dict(mass=mass, stiffness=[4.0, 5.0, 6.0], position=[1.0, 0.5, 0.2], velocity=[0.0, 1.0, -1.0], end=1.0)
    result = fvi.integrate(step=0.01, every=5, **given)
    assert np.allclose(result.v[0], [0.0, 1.0, -1.0], atol=1e-14)
    full = mass.toarray() if sp.issparse(mass) else np.diag(mass) if mass.ndim == 1 else mass
    assert np.allclose(result.v @ full, result.p, atol=1e-13)
    fine = fvi.integrate(step=0.01, **given)
    # Cubic polynomials: (0.05)⁴/384 times the fourth derivative, 36 at most.
    assert np.abs(result(fine.t) - fine.q).max() < 1e-5
    assert np.array_equal(result(result.t), result.q) and result(0.31).shape == (3,)
    for outside in (-0.1, 1.1, float("nan")):
        with pytest.raises(fvi.InputError, match="allowed: 0 ≤ t ≤ 1"):
            result(outside)
    for chosen in ([1], [2, 0], [2, 0, 1]):
        some = fvi.integrate(step=0.01, coordinates=chosen, **given)
        assert np.allclose(some.v, fine.v[:, chosen], rtol=0.0, atol=1e-14)
        assert np.array_equal(some(fine.t[::7]), fine.q[::7, chosen])


def test_results_are_saved_and_read_again(tmp_path):
    result = fvi.integrate(**COMMON, stiffness=[1.0, 2.0])
    result.save(tmp_path / "run.npz")
    again = fvi.load(tmp_path / "run.npz")
    assert repr(again) == repr(result) and again.summary == result.summary
    assert all(np.array_equal(getattr(again, name), getattr(result, name)) for name in ("t", "q", "p", "energy", "v"))
    np.savez(tmp_path / "other.npz", t=[1.0])
    (tmp_path / "text.npz").write_text("no archive")
    for name in ("other.npz", "text.npz"):
        with pytest.raises(fvi.InputError, match=name):
            fvi.load(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        fvi.load(tmp_path / "absent.npz")
    scenario = {"system": {"mass": [1.0], "stiffness": [1.0]}, "initial": {"position": [1.0]}, "time": {"step": 0.1, "steps": 9}}
    run = fvi.run(scenario, out=tmp_path / "run")
    again = fvi.load(tmp_path / "run")
    assert repr(again) == repr(run) and all(np.array_equal(getattr(again, name), getattr(run, name)) for name in ("t", "q", "p", "energy", "v"))
    with pytest.raises(fvi.InputError, match="no result"):
        (tmp_path / "run" / "summary.json").write_text("{}")
        fvi.load(tmp_path / "run")


def test_pictures_and_notebooks(tmp_path):
    pytest.importorskip("matplotlib").use("Agg")
    result = fvi.integrate(**COMMON, stiffness=[1.0, 2.0])
    picture = result.plot()
    above, below = picture
    picture.savefig(tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 1000 and above.figure is picture.figure is below.figure
    assert "<table>" in result._repr_html_() and "&" not in result._repr_html_().replace("&#x27;", "")


def test_the_help_names_every_scheme():
    for scheme in ("low-order", "galerkin", "collocation", "explicit-euler", "implicit-euler"):
        assert f'"{scheme}"' in fvi.integrate.__doc__
        more = {"collocation": dict(convolution="radau-iia", stages=2), "galerkin": dict(degree=2)}.get(scheme, {})
        fvi.integrate(**COMMON, scheme=scheme, **more)


def test_a_tolerance_chooses_the_scheme():
    system = dict(mass=[1.0], stiffness=[4.0], position=[1.0])
    r = fvi.integrate(**system, scheme="auto", tolerance=1e-8, end=10.0)
    assert np.abs(r.q[:, 0] - np.cos(2.0 * r.t)).max() < 1e-8
    assert r.summary["choice"]["tolerance"] == 1e-8 and r.summary["scenario"]["scheme"]["kind"] == "galerkin"
    spaced = fvi.integrate(**system, scheme="auto", tolerance=1e-8, end=10.0, step=0.5)
    assert np.array_equal(spaced.t, 0.5 * np.arange(21))
    with pytest.raises(fvi.InputError, match="chosen for its end"):
        fvi.integrate(continue_from=spaced, end=20.0)
    with pytest.raises(fvi.InputError, match="tolerance") as error:
        fvi.integrate(**system, scheme="auto", end=10.0, step=0.5, tolerance=2.0)
    assert error.value.key == "tolerance"


def test_the_error_near_the_start_is_the_one_that_is_told():
    t = np.arange(200) * 1e-3
    ratio = fvi.derivative(t, 0.5, 1e-3)[1:] / (2 * np.sqrt(t[1:] / np.pi))
    assert abs(ratio[0] - 0.886) < 1e-3 and abs(ratio[9] - 1.0) < 0.014


def test_progress_may_be_a_bar():
    class Bar:
        n, total = 0, None

        def update(self, steps):
            self.n += steps

    bar = Bar()
    fvi.integrate(**{**COMMON, "steps": 200_000}, stiffness=[1.0, 1.0], every=1000, progress=bar)
    assert bar.total == 200_000 and 0 <= bar.n <= 200_000
    with pytest.raises(fvi.InputError, match="tqdm"):
        fvi.integrate(**COMMON, progress=3)


def test_every_key_that_is_an_argument_has_a_type():
    from fvi._scenario import SHORT_NAMES
    from fvi._types import ScenarioKeys

    assert set(ScenarioKeys.__annotations__) == set(SHORT_NAMES)


def test_misspelt_arguments_are_told_the_right_one():
    for wrong, right in (("dampings", "damping"), ("stifness", "stiffness"), ("toleranc", "tolerance")):
        with pytest.raises(fvi.InputError, match=f"did you mean {right}"):
            fvi.integrate(**COMMON, **{wrong: [1.0, 1.0]})
