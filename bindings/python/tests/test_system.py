"""One system for all calls that take one."""

import pickle

import numpy as np
import pytest
import scipy.sparse as sp

import fvi


def chain(n):
    return sp.diags([-1.0, 2.1, -1.0], [-1, 0, 1], shape=(n, n)).tocsr()


def same(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("t", "q", "p", "energy"))


@pytest.mark.parametrize("n", [2, 40, 200])
def test_a_system_has_the_bits_of_its_arguments(n):
    given = dict(mass=np.ones(n), stiffness=chain(n), damping=[fvi.Damping(0.5, 0.1 * chain(n)), fvi.Damping(0.3, np.ones(n))],
                 loads=fvi.Load({"coordinate": 1}, "a*sin(t)"), elements=fvi.Element("0.1*x0^4", [[0]]), parameters={"a": 2.0})
    more = dict(position=0.1, step=0.05, steps=5)
    system = pickle.loads(pickle.dumps(fvi.System(**given)))
    assert system.coordinates == n and f"{n} coordinates" in repr(system)
    alone = fvi.integrate(**given, **more)
    for result in (fvi.integrate(system, **more), fvi.Model(system, **more).integrate(), fvi.run(system, **more)):
        assert same(result, alone)


def test_response_fit_and_converge_take_it():
    n = 100
    system = fvi.System(mass=np.ones(n), stiffness=chain(n), damping=fvi.Damping(0.5, 0.1 * chain(n)))
    omega = np.array([0.5, 1.0, 1.7])
    found = fvi.response(system, omega, output=3)
    s = 1j * omega
    for h, at in zip(found.response, s):
        matrix = (at**2 * np.eye(n) + chain(n).toarray() * (1 + 0.1 * at**0.5)).astype(complex)
        assert abs(h - np.linalg.solve(matrix, np.eye(n)[0])[3]) < 1e-12
    with pytest.raises(fvi.InputError, match="omega"):
        fvi.response(system)

    one = fvi.System(mass=[1.0], stiffness=[4.0], damping=fvi.Damping(0.5, [0.1]))
    more = dict(position=1.0, step=0.05, steps=100)
    r = fvi.integrate(one, **more)
    fitted = fvi.fit(one, {"system.damping[0].order": 0.7}, {"t": r.t, "q0": r.q[:, 0]}, **more)
    assert abs(fitted.estimates["system.damping[0].order"] - 0.5) < 1e-8
    assert np.abs(fvi.run(fitted.scenario).q - r.q).max() < 1e-8
    free = fvi.System(mass=[1.0], stiffness=[4.0])
    table = fvi.converge(free, (4, 6), position=1.0, end=2.0, step=0.1, overrides={"reference": {"position": ["cos(2*t)"]}})
    assert abs(table["position_order"][-1] - 2.0) < 0.1


def test_it_stands_in_dictionaries():
    n = 40
    system = fvi.System(mass=np.ones(n), stiffness=chain(n), damping=fvi.Damping(0.5, 0.1 * chain(n)),
                        loads=[fvi.Load({"coordinate": 2}, "sin(t)"), fvi.Load(np.ones(n), ([0.0, 1.0], [0.0, 2.0]))])  # fmt: skip
    scenario = {"system": system, "initial": {"position": 0.1}, "time": {"step": 0.05, "steps": 5}}
    alone = fvi.integrate(system, position=0.1, step=0.05, steps=5)
    assert same(fvi.run(scenario), alone) and same(fvi.run(scenario, steps=5), alone)
    table = fvi.sweep({"scenario": scenario, "axes": {"time.step": [0.05, 0.01]}, "keep": {"quantities": ["last"]}})
    assert table["q2"][0] == alone.q[-1, 2]
    with pytest.raises(fvi.InputError, match="needs initial values and steps"):
        fvi.sweep({"scenario": system, "axes": {"time.step": [0.05, 0.01]}})
    # With loads, which a response does not ask for.
    assert np.array_equal(fvi.response(system, [1.0], output=3).response, fvi.response(scenario, [1.0], output=3).response)


def test_a_fit_takes_the_loads_of_a_system():
    given = dict(mass=[1.0], stiffness=[4.0], loads=fvi.Load([1.0], ([0.0, 1.0, 2.0], [0.0, 1.0, 0.0])))
    more = dict(position=0.0, step=0.05, steps=100)
    measured = fvi.integrate(fvi.System(**given, damping=fvi.Damping(0.5, [0.1])), **more)
    found = fvi.fit(fvi.System(**given, damping=fvi.Damping(0.7, [0.1])), ["system.damping[0].order"],
                    {"t": measured.t, "q0": measured.q[:, 0]}, **more)  # fmt: skip
    assert abs(found.estimates["system.damping[0].order"] - 0.5) < 1e-8
    assert np.abs(fvi.run(found.scenario).q - measured.q).max() < 1e-8


def test_a_controller_is_tuned_for_a_system():
    system = fvi.System(mass=[1.0], stiffness=[1.0], damping=fvi.Damping(0.5, [0.3]))
    loop = {"controller": {"structure": "pid", "sample": 0.01}, "specification": {"crossover": 2.0, "phase_margin": 60.0}}
    of_formula = fvi.tune({"plant": {"transfer": "1/(s^2 + 0.3*s^0.5 + 1)"}, **loop})
    for scenario in (system, {"system": system, "time": {"step": 0.01, "steps": 1}}):
        found = fvi.tune({"plant": {"scenario": scenario, "measures": "q0", "drives": [1.0]}, **loop})
        assert found.kp == pytest.approx(of_formula.kp, rel=1e-9) and found.mu == pytest.approx(of_formula.mu, rel=1e-9)
    with pytest.raises(fvi.InputError, match="measures"):
        fvi.tune({"plant": {"scenario": system, "drives": [1.0]}, **loop})


def test_functions_are_part_of_it():
    system = fvi.System(mass=1.0, potential=fvi.Potential(lambda q: q @ q, lambda q: 2.0 * q), force=lambda t: [np.sin(t)])
    more = dict(position=[0.3], step=0.1, steps=5)
    assert same(fvi.integrate(system, **more), fvi.run(system, **more))
    assert system.coordinates is None
    with pytest.raises(fvi.InputError, match="functions of Python are taken by integrate"):
        fvi.response(system, [1.0])


@pytest.mark.parametrize(
    "given, said",
    [
        (dict(), "mass: needed"),
        (dict(mass=[1.0], kinetic="v0^2"), "beside mass"),
        (dict(mass=[1.0], stiffness=[1.0, 2.0]), "shape"),
        (dict(mass=[1.0], damping=fvi.Damping(0.5, [1.0, 2.0])), "shape"),
        (dict(mass=[1.0], damping=3.0), "fvi.Damping"),
        (dict(mass=[1.0], potential=3.0), "expression"),
    ],
)
def test_what_is_wrong_is_told_when_it_is_made(given, said):
    with pytest.raises(fvi.InputError, match=said):
        fvi.System(**given)


def test_what_the_system_has_is_not_given_again():
    system = fvi.System(mass=[1.0], stiffness=[4.0])
    with pytest.raises(fvi.InputError, match="has one already") as refused:
        fvi.integrate(system, stiffness=[5.0], position=[1.0], step=0.1, steps=1)
    assert refused.value.key == "stiffness"
    with pytest.raises(fvi.InputError, match="fvi.System is needed"):
        fvi.integrate([1.0], position=[1.0], step=0.1, steps=1)


def test_a_system_and_a_model_keep_their_numbers() -> None:
    stiffness, rho, start = np.array([[3.0, -1.0], [-1.0, 2.0]]), np.array([0.1, 0.1]), np.array([1.0, 0.5])
    system = fvi.System(mass=[1.0, 2.0], stiffness=stiffness, damping=fvi.Damping(0.5, rho))
    model = fvi.Model(system, position=start, step=0.1, steps=20)
    before = model.integrate().q
    stiffness *= 2.0
    rho[:] = 7.0
    start[:] = 0.2
    np.testing.assert_array_equal(fvi.integrate(system, position=[1.0, 0.5], step=0.1, steps=20).q, before)
    for after in (model.integrate().q, model.run().q, model.gradient(["position"], lambda r: r.q).result.q):
        np.testing.assert_array_equal(after, before)
