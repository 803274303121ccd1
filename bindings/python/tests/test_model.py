"""Systems that are integrated several times, and large ones with functions of time."""

import pickle
import time
import warnings

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as sla

import fvi


MODEL_OF_TWO = dict(
    mass=[1.0, 2.0], potential="0.5*k*q0^2 + 0.5*(q1 - q0)^2", parameters={"k": 1.0}, damping=fvi.Damping(0.5, [0.1, 0.2]),
    position=[1.0, 0.0], step=0.05, steps=40,
)


def membrane(k):
    """Stiffness of k×k points, each held by its four neighbours."""
    line, one = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(k, k)), sp.eye(k)
    return (sp.kron(line, one) + sp.kron(one, line) + 0.1 * sp.eye(k * k)).tocsr()


def arguments(k, **more):
    n, stiffness = k * k, membrane(k)
    return dict(mass=sp.eye(n, format="csr") + 0.01 * stiffness, stiffness=stiffness, position=np.zeros(n),
                damping=fvi.Damping(0.5, 0.02 * stiffness), loads=fvi.Load({"coordinate": 7}, "sin(3*t)"),
                step=0.01, steps=3, coordinates=[0, 7], **more)


def same(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("t", "q", "p", "energy"))


@pytest.mark.parametrize("k", [4, 15])
def test_a_model_has_the_bits_of_integrate(k):
    given = arguments(k)
    model = fvi.Model(**given)
    assert same(model.integrate(), fvi.integrate(**given))
    load = fvi.Load(np.linspace(0.0, 1.0, k * k), ([0.0, 1.0], [1.0, 2.0]))
    for changes in (
        dict(loads=[load]),
        dict(damping=fvi.Damping(0.5, 0.04 * given["stiffness"])),
        dict(damping=[fvi.Damping(0.3, 0.02 * given["stiffness"]), fvi.Damping(0.7, np.ones(k * k))]),
        dict(position=np.full(k * k, 0.1), velocity=np.ones(k * k)),
        dict(stiffness=2.0 * given["stiffness"]),
        dict(elements=fvi.Element("0.25*(x1 - x0)^4", [[0, 1], [3, 7]]), position=np.full(k * k, 0.2)),
        dict(steps=None, end=0.05),
        {},
    ):
        assert same(model.integrate(**changes), fvi.integrate(**{**given, **changes})), changes


@pytest.mark.parametrize("order", [3, 4])
@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_two_gauss_points_have_sparse_factors(order, precision):
    given = arguments(15, scheme="galerkin", degree=2, order=order, precision=precision)
    model = fvi.Model(**given)
    sparse = model.integrate()
    assert sparse.summary["solver"]["kind"] == "sparse"
    assert same(sparse, fvi.integrate(**given)) and same(sparse, model.integrate())
    with pytest.warns(UserWarning, match="full matrices"):
        dense = fvi.integrate(**given, force=lambda t, q: 0.0 * q)
    assert dense.summary["solver"]["kind"] == "dense"
    assert 0.0 < np.abs(dense.q).max() and np.abs(sparse.q - dense.q).max() < (1e-12 if precision == "f64" else 1e-6)


def test_a_model_keeps_the_arrays_it_was_given_and_refuses_what_integrate_does():
    stiffness = membrane(15)
    model = fvi.Model(**{**arguments(15), "stiffness": stiffness})
    before = model.integrate()
    stiffness.data[:] = 7.0
    assert same(model.integrate(), before)
    with pytest.raises(fvi.InputError, match="semidefinite") as refused:
        model.integrate(damping=fvi.Damping(0.5, -0.02 * membrane(15)))
    assert refused.value.key == "damping[0].coefficient"
    with pytest.raises(fvi.InputError, match="shape"):
        model.integrate(stiffness=membrane(14))
    with pytest.raises(fvi.InputError, match="position"):
        fvi.Model(mass=[1.0], step=0.1, steps=1).integrate()
    with pytest.raises(fvi.InputError, match="did you mean stiffness"):
        fvi.Model(mass=[1.0], stifness=[4.0])
    velocity = fvi.Model(mass=[1.0], position=[0.0], momentum=[1.0], step=0.1, steps=1).integrate(velocity=[2.0])
    assert velocity.p[0, 0] == 2.0


def test_preparation_is_part_of_the_call_and_not_of_the_steps():
    begin = time.perf_counter()
    summary = fvi.integrate(**arguments(60)).summary
    assert summary["preparation_seconds"] > 0.0
    assert summary["preparation_seconds"] + summary["seconds"] <= time.perf_counter() - begin


def test_functions_of_time_leave_large_systems_sparse():
    given = arguments(15)
    pattern = np.linspace(0.0, 1.0, 225)
    given["loads"] = [fvi.Load(pattern, "sin(3*t)"), fvi.Load({"coordinate": 3, "value": 2.0}, "t^2")]
    words = fvi.integrate(**given)
    given["loads"] = [fvi.Load(pattern, "sin(3*t)"), fvi.Load({"coordinate": 3, "value": 2.0}, lambda t: t**2)]
    amplitude = fvi.integrate(**given)
    del given["loads"]

    def push(t):
        force = pattern * np.sin(3 * t)
        force[3] += 2.0 * t**2
        return force

    function = fvi.integrate(force=push, **given)
    with_element = dict(elements=fvi.Element("0.25*(x1 - x0)^4", [[0, 1]]))
    nonlinear = fvi.integrate(force=push, **given, **with_element)
    for result in (amplitude, function, nonlinear):
        assert result.summary["solver"]["kind"] == "sparse"
    for result in (amplitude, function):
        assert np.abs(result.q - words.q).max() < 1e-15 and np.abs(result.energy - words.energy).max() < 1e-15
    assert 0.0 < np.abs(nonlinear.q - words.q).max() < 1e-6


def test_amplitudes_that_cannot_be_used_are_named():
    given = arguments(4)
    for amplitude, words in ((lambda t: [1.0, 2.0], "2 numbers"), (lambda t: "a", "real numbers")):
        given["loads"] = fvi.Load(np.ones(16), amplitude)
        with pytest.raises(fvi.InputError, match=words) as refused:
            fvi.integrate(**given)
        assert refused.value.key == "loads[0].amplitude"
    given["loads"] = fvi.Load(np.ones(16), lambda t: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        fvi.integrate(**given)


def test_full_matrices_of_many_coordinates_are_warned_of():
    n = 320
    common = dict(mass=np.ones(n), stiffness=sp.eye(n, format="csr"), position=np.zeros(n), step=0.01, steps=1, coordinates=[0])
    with pytest.warns(UserWarning, match="320 coordinates are solved with full matrices.*take the position"):
        fvi.integrate(force=lambda t, q: -0.1 * q, **common)
    with pytest.warns(UserWarning, match="full matrices.*two Gauss points.*`degree` = 2"):
        fvi.integrate(scheme="galerkin", degree=3, **common)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fvi.integrate(force=lambda t: np.ones(n), **common)


def test_a_factor_is_about_as_large_as_that_of_superlu():
    """Whose symmetric factor would have 8 bytes for each number beside the indices."""
    for k in (141, 316):
        stiffness = membrane(k)
        n, columns = k * k, stiffness.tocsc()
        factor = sla.splu(columns, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=dict(SymmetricMode=True))
        own = fvi.integrate(mass=np.ones(n), stiffness=stiffness, position=np.zeros(n), step=0.01, steps=1, coordinates=[0])
        assert own.summary["solver"]["factor_bytes"] <= 2.2 * 8 * factor.L.nnz, k


def test_a_hundred_sparse_coordinates_are_solved_as_such():
    n = 120
    chain = sp.diags([-1.0, 2.1, -1.0], [-1, 0, 1], shape=(n, n)).tocsr()
    given = dict(mass=np.ones(n), position=np.linspace(0.0, 1.0, n), step=0.01, steps=10, coordinates=range(n))
    sparse = fvi.integrate(**given, stiffness=chain, damping=fvi.Damping(0.5, 0.02 * chain))
    assert sparse.summary["solver"]["kind"] == "sparse"
    # In a scenario's dictionary an array is an array.
    rows = chain.toarray()
    dense = fvi.run({
        "system": {"mass": np.ones(n), "stiffness": rows, "damping": [{"order": 0.5, "coefficient": 0.02 * rows}]},
        "initial": {"position": given["position"]}, "time": {"step": 0.01, "steps": 10}, "output": {"coordinates": range(n)},
    })  # fmt: skip
    assert dense.summary["solver"]["kind"] == "dense"
    assert np.abs(dense.q - sparse.q).max() < 1e-13
    full = sp.csr_matrix(np.eye(n) + 0.001)
    assert fvi.integrate(**given, stiffness=full).summary["solver"]["kind"] == "dense"


def test_velocities_of_runs_are_those_of_their_own_mass():
    """Where the mass is among the numbers, where its kinetic energy has a parameter, and with the mass of the fluid about a body."""
    common = dict(potential="q0^2 + q1^2", position=[1.0, 0.5], step=0.1, steps=5)
    fluid = fvi.Kernel.states([[0.0, 1.0], [-1.44, -0.7]], [[0.0, 0.0], [1.0, 0.5]], [[0.0, 1.0], [0.0, 0.5]], infinite=[[0.3, 0.1], [0.1, 0.2]])
    curved = dict(kinetic="0.5*(1 + a*q0^2)*v0^2 + 0.5*v1^2", **common)
    many = dict(stiffness=np.ones(300), position=np.ones(300), step=0.1, steps=5)
    cases = [
        (dict(mass=[1.0, 2.0], **common), {"mass": [4.0, 8.0]}, dict(mass=[4.0, 8.0], **common)),
        (dict(mass=[1.0, 2.0], **common), {"mass[0]": 4.0}, dict(mass=[4.0, 2.0], **common)),
        (dict(mass=[[1.0, 0.2], [0.2, 2.0]], **common), {"mass[0][0]": 3.0}, dict(mass=[[3.0, 0.2], [0.2, 2.0]], **common)),
        (dict(parameters={"a": 1.0}, **curved), {"a": 2.0}, dict(parameters={"a": 2.0}, **curved)),
        (
            dict(mass=[1.0, 2.0], damping=fvi.Damping(kernel=fluid), **common),
            {"q0": 0.7},
            dict(mass=[1.0, 2.0], damping=fvi.Damping(kernel=fluid), **{**common, "position": [0.7, 0.5]}),
        ),
        (dict(mass=np.ones(300), **many), {"q3": 2.0}, dict(mass=np.ones(300), **{**many, "position": [1.0] * 3 + [2.0] + [1.0] * 296})),
    ]
    for given, numbers, same in cases:
        model, expected = fvi.Model(**given), fvi.integrate(**same)
        of_batch = model.batch({name: [value, value] for name, value in numbers.items()})[1]
        for found in (model.run(numbers), of_batch):
            assert (found.q == expected.q).all()
            assert np.abs(found.v - expected.v).max() < 1e-15, numbers
            assert np.abs(found(0.25) - expected(0.25)).max() < 1e-15


def test_names_of_a_model_are_those_of_its_arguments():
    prony = fvi.Damping(kernel=fvi.Kernel.prony([1.0, 2.0, 0.5], [1.0, 0.1, 3.0]), coefficient=[0.3, 0.1])
    model = fvi.Model(mass=[1.0, 2.0], potential="q0^2 + q1^2", damping=prony, position=[1.0, 0.5], step=0.1, steps=20)
    by_name = model.gradient(["damping[0].kernel.strengths", "mass"], lambda result: result.q)
    by_value = model.gradient({"damping[0].kernel.strengths": [1.0, 2.0, 0.5], "mass": [1.0, 2.0]}, lambda result: result.q)
    for name in by_value.parameters:
        assert (by_name[name] == by_value[name]).all() and len(by_name[name]) == {"mass": 2}.get(name, 3)
    with pytest.raises(fvi.InputError, match=r"strengths: shape \(2,\) instead of \(3,\), the number of those of the model"):
        model.run({"damping[0].kernel.strengths": [1.1, 2.2]})
    with pytest.raises(fvi.InputError, match=r"`\[i\]` behind it: there are several"):
        model.integrate(sensitivities=["system.damping[0].kernel.strengths"])
    adaptive = dict(mass=[1.0], potential="q0^2", position=[1.0], scheme="collocation", grid="adaptive", end=2.0)
    found = fvi.Model(tolerance=1e-4, **adaptive).run({"tolerance": 1e-8})
    assert (found.q == fvi.integrate(tolerance=1e-8, **adaptive).q).all()
    chain = fvi.Model(mass=np.ones(200), stiffness=np.diag(np.full(200, 2.0)), position=np.ones(200), step=0.1, steps=2)
    with pytest.raises(fvi.InputError, match="a matrix of so many coordinates has no numbers here"):
        chain.run({"stiffness[3][3]": 2.5})


def test_a_misspelt_argument_is_told_before_a_missing_one():
    with pytest.raises(fvi.InputError, match="positon: no such key; did you mean position"):
        fvi.integrate(mass=[1.0], positon=[1.0], step=0.1, steps=2)
    with pytest.raises(fvi.InputError, match="outputs: no such key; did you mean output"):
        fvi.response(fvi.System(mass=[1.0], stiffness=[[1.0]]), [1.0], outputs=0)


def test_models_are_pickled_as_they_were_given():
    model = fvi.Model(**MODEL_OF_TWO)
    again = pickle.loads(pickle.dumps(model))
    assert (again.run({"k": 2.0}).q == model.run({"k": 2.0}).q).all()
    assert (again.integrate().q == model.integrate().q).all()


def test_numbers_of_a_controller_are_numbers_of_a_model():
    controller = {"measures": "q0", "drives": [1.0], "kp": 2.0, "setpoint": "1", "sample": 0.05}
    overrides = {"controller": [controller]}
    model = fvi.Model(mass=[1.0], stiffness=[[1.0]], position=[0.0], step=0.05, steps=60, overrides=overrides)
    runs = model.batch({"controller[0].kp": [2.0, 3.0]})
    overrides = {"controller": [{**controller, "kp": 3.0}]}
    expected = fvi.integrate(mass=[1.0], stiffness=[[1.0]], position=[0.0], step=0.05, steps=60, overrides=overrides)
    assert (runs[1].q == expected.q).all() and np.abs(runs[0].q - runs[1].q).max() > 0.1
