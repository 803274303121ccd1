"""Velocities and accelerations of chosen coordinates where the mass couples them with others: M⁻¹p of NumPy."""

import pickle

import numpy as np
import pytest
import scipy.sparse as sp

import fvi

RNG = np.random.default_rng(5)


def rod(n, **more):
    """A rod of linear elements, whose consistent mass couples neighbours."""
    mass = sp.diags([1.0, 4.0, 1.0], [-1, 0, 1], shape=(n, n)).tocsr() / 6
    stiffness = sp.diags([-1.0, 2.1, -1.0], [-1, 0, 1], shape=(n, n)).tocsr()
    return dict(mass=mass, stiffness=stiffness, damping=fvi.Damping(0.5, 0.01 * stiffness), position=RNG.random(n),
                velocity=RNG.random(n), step=0.01, steps=30, **more)  # fmt: skip


@pytest.mark.parametrize("more", [{}, {"every": 7}, {"times": [0.013, 0.2]}, {"precision": "f32"}, {"scheme": "galerkin", "degree": 2, "order": 3}])
@pytest.mark.parametrize("n", [3, 40, 150])
@pytest.mark.parametrize("dense", [False, True])
def test_they_are_those_of_all_momenta(n, dense, more):
    given = rod(n, **more)
    full = given["mass"].toarray()
    if dense:
        given = {**given, "mass": full, "stiffness": given["stiffness"].toarray()}
    velocities = np.linalg.solve(full, fvi.integrate(**given, coordinates=range(n)).p.T).T
    some = fvi.integrate(**given, coordinates=[2, 0])
    assert some.v.shape == some.q.shape
    assert np.abs(some.v - velocities[:, [2, 0]]).max() < 1e-14 * np.abs(velocities).max()


def test_runs_that_go_on_and_those_of_models_and_load_cases_have_them():
    given = rod(5)
    model, whole = fvi.Model(**given, coordinates=[3, 1]), fvi.integrate(**given)
    first = fvi.integrate(**{**given, "steps": 12})
    on = fvi.integrate(continue_from=first, steps=18, coordinates=[3, 1])
    assert np.allclose(on.v, whole.v[12:, [3, 1]], rtol=0.0, atol=1e-14)
    assert np.allclose(fvi.integrate(continue_from=on, steps=1).v[0], whole.v[-1, [3, 1]], rtol=0.0, atol=1e-14)
    starts = np.stack([given["position"], 2.0 * given["position"]])
    runs = model.batch({"position": starts})
    for run, start in zip(runs, starts):
        assert np.array_equal(run.v, model.integrate(position=start).v)
    assert np.array_equal(model.run({"position": starts[1]}).v, runs[1].v)
    load = fvi.Load({"coordinate": 4}, "sin(t)")
    cases = fvi.integrate_cases({"none": (), "end": load}, **given, coordinates=[3, 1])
    assert np.allclose(cases["end"].v, fvi.integrate(**given, loads=load).v[:, [3, 1]], rtol=0.0, atol=1e-14)


def test_kinetic_energies_in_words_and_coordinates_without_mass():
    given = dict(kinetic="0.5*(v0^2*(1 + 0.1*q1^2) + v1^2 + v0*v1)", potential="q0^2 + q1^2 + q0*q1", position=[0.3, 0.4],
                 velocity=[1.0, 0.2], step=0.01, steps=20)  # fmt: skip
    assert np.array_equal(fvi.integrate(**given, coordinates=[1]).v[:, 0], fvi.integrate(**given).v[:, 1])
    given = dict(mass=[[2.0, 0.0, 0.3], [0.0, 0.0, 0.0], [0.3, 0.0, 1.0]], stiffness=np.diag([8.0, 5.0, 1.0]), position=[1.0, 1.0, 0.0],
                 damping=fvi.Damping(1.0, [0.0, 2.5, 0.0]), step=0.01, steps=5)  # fmt: skip
    some, whole = fvi.integrate(**given, coordinates=[1, 2]).v, fvi.integrate(**given).v
    assert np.isnan(some[:, 0]).all() and np.allclose(some[:, 1], whole[:, 2], rtol=0.0, atol=1e-14)


def test_they_are_saved_and_pickled(tmp_path):
    some = fvi.integrate(**rod(4), coordinates=[1])
    some.save(tmp_path / "run.npz")
    again = fvi.load(tmp_path / "run.npz")
    assert np.array_equal(again.v, some.v) and again.columns == {}
    assert np.array_equal(pickle.loads(pickle.dumps(some)).v, some.v)


def test_the_order_of_the_coordinates_in_a_file_is_kept(tmp_path):
    given = dict(mass=[[2.0, 0.5], [0.5, 1.0]], stiffness=[[3.0, 0.0], [0.0, 2.0]])
    scenario = {"system": given, "initial": {"position": [1.0, 0.0]}, "time": {"step": 0.1, "steps": 9}}
    plain = fvi.run(scenario)
    fvi.run(scenario, out=tmp_path / "all", coordinates=[1, 0])
    assert np.allclose(fvi.load(tmp_path / "all").v, plain.v[:, ::-1], rtol=0.0, atol=1e-14)
    fvi.run(scenario, out=tmp_path / "one", coordinates=[1])
    with pytest.raises(fvi.InputError, match="couples"):
        fvi.load(tmp_path / "one").v


def test_accelerations_are_slopes_of_velocities():
    given = dict(mass=[[2.0, 0.5], [0.5, 1.0]], stiffness=[[3.0, 1.0], [1.0, 2.0]], position=[1.0, 0.0], scheme="galerkin", degree=3, end=2.0)
    errors = []
    for step in (0.04, 0.02, 0.01):
        r = fvi.integrate(**given, step=step, coordinates=[1])
        whole = fvi.integrate(**given, step=step)
        exact = -np.linalg.solve(given["mass"], np.array(given["stiffness"]) @ whole.q.T).T
        assert np.allclose(r.a, whole.a[:, [1]], rtol=0.0, atol=1e-11)
        errors.append(np.abs(whole.a - exact).max())
    assert errors[-1] < 1e-7 and np.log2(errors[0] / errors[1]) > 3.7 and np.log2(errors[1] / errors[2]) > 3.7
    uneven = fvi.integrate(**given, step=0.01, times=np.linspace(0.0, 1.4, 60) ** 2)
    assert np.abs(uneven.a + np.linalg.solve(given["mass"], np.array(given["stiffness"]) @ uneven.q.T).T).max() < 1e-4
    assert fvi.integrate(**given, step=0.1, times=[0.0, 1.0]).a.shape == (2, 2)
    with pytest.raises(fvi.InputError, match="two rows"):
        fvi.integrate(**given, step=0.1, times=[1.0]).a
