"""Functions in all places where they are allowed: Hessians with patterns, events, dictionaries of scenarios, sweeps."""

import warnings

import numpy as np
import pytest
import scipy.sparse as sp

import fvi

N = 150


def chain_energy(q):
    return np.sum(1.0 - np.cos(np.diff(q))) + 0.05 * np.sum(q**4)


def chain_gradient(q):
    pull = np.sin(np.diff(q))
    gradient = 0.2 * q**3
    gradient[1:] += pull
    gradient[:-1] -= pull
    return gradient


def chain_hessian(q):
    stiff = np.cos(np.diff(q))
    diagonal = 0.6 * q**2
    diagonal[1:] += stiff
    diagonal[:-1] += stiff
    return sp.diags([-stiff, diagonal, -stiff], [-1, 0, 1]).tocsr()


CHAIN = dict(mass=np.ones(N), position=np.sin(np.arange(N) / 9.0), step=0.05, steps=40,
             damping=fvi.Damping(0.5, 0.1 * sp.identity(N, format="csr")))  # fmt: skip
PATTERN = sp.diags([np.ones(N - 1), np.ones(N), np.ones(N - 1)], [-1, 0, 1])


def test_a_potential_whose_pattern_is_known_stays_sparse():
    given = dict(CHAIN, damping=())
    dense = fvi.integrate(**given, potential=fvi.Potential(chain_energy, chain_gradient, lambda q: chain_hessian(q).toarray()))
    assert dense.summary["solver"]["kind"] == "dense"
    calls = []

    def counted(q):
        calls.append(q)
        return chain_gradient(q)

    for potential in (
        fvi.Potential(chain_energy, chain_gradient, chain_hessian),
        fvi.Potential(chain_energy, chain_gradient, lambda q: chain_hessian(q).tocoo(), pattern=sp.triu(PATTERN)),
        fvi.Potential(chain_energy, chain_gradient, lambda q: chain_hessian(q).toarray(), pattern=PATTERN.toarray() != 0),
        fvi.Potential(chain_energy, counted, pattern=PATTERN),
    ):
        sparse = fvi.integrate(**given, potential=potential)
        assert sparse.summary["solver"]["kind"] == "sparse"
        assert np.abs(sparse.q - dense.q).max() < 1e-12 and np.abs(sparse.energy - dense.energy).max() < 1e-11
    # A chain has three groups of columns: four calls in place of 151 for each Hessian.
    assert len(calls) < 40 * 4 * 12
    # Beside other matrices, and with loads that are functions of time.
    damped = fvi.integrate(**CHAIN, potential=fvi.Potential(chain_energy, chain_gradient, chain_hessian),
                           force=lambda t: np.full(N, np.sin(t)))  # fmt: skip
    assert damped.summary["solver"]["kind"] == "sparse"
    elements = [fvi.Element("1 - cos(x1 - x0)", [[k, k + 1] for k in range(N - 1)]), fvi.Element("0.05*x0^4", [[k] for k in range(N)])]
    words = fvi.integrate(**CHAIN, elements=elements, loads=fvi.Load(np.ones(N), "sin(t)"))
    assert np.abs(damped.q - words.q).max() < 1e-11


def test_what_leaves_the_pattern_is_refused_and_what_is_full_is_warned_of():
    def grows(q):
        hessian = chain_hessian(q).tolil()
        if abs(q[0]) > 1e-3:
            hessian[0, 40] = hessian[40, 0] = 1.0
        return hessian.tocsr()

    given = dict(CHAIN, damping=())
    with pytest.raises(fvi.InputError, match=r"entry \(0, 40\) where its pattern has none") as caught:
        fvi.integrate(**given, potential=fvi.Potential(chain_energy, chain_gradient, grows))
    assert caught.value.key == "potential.hessian"
    for potential, key in [
        (fvi.Potential(chain_energy, chain_gradient, pattern=np.ones((3, 3))), "potential.pattern"),
        (fvi.Potential(chain_energy, chain_gradient, lambda q: sp.identity(3)), "potential.hessian"),
    ]:
        with pytest.raises(fvi.InputError) as caught:
            fvi.integrate(**given, potential=potential)
        assert caught.value.key == key
    n = 320
    common = dict(mass=np.ones(n), position=np.zeros(n), step=0.01, steps=1)
    square = lambda hessian: fvi.Potential(lambda q: 0.5 * q @ q, lambda q: q, hessian)
    with pytest.warns(UserWarning, match="full matrices.*pattern or sparse Hessian"):
        fvi.integrate(**common, potential=square(lambda q: np.eye(n)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fvi.integrate(**common, potential=square(lambda q: sp.identity(n)))


def test_arrays_with_few_entries_are_solved_as_sparse_ones():
    n = 100
    stiffness = np.diag(np.full(n, 2.1)) - np.eye(n, k=1) - np.eye(n, k=-1)
    given = dict(mass=np.full(n, 1.5), position=np.linspace(0.0, 1.0, n), step=0.05, steps=50)
    arrays = fvi.integrate(**given, stiffness=stiffness, damping=fvi.Damping(0.5, 0.1 * stiffness))
    matrices = fvi.integrate(**given, stiffness=sp.csr_matrix(stiffness), damping=fvi.Damping(0.5, sp.csr_matrix(0.1 * stiffness)))
    assert arrays.summary["solver"]["kind"] == "sparse" and np.array_equal(arrays.q, matrices.q)
    coupled = fvi.integrate(**{**given, "mass": np.diag(given["mass"]) + 1e-12 * stiffness}, stiffness=stiffness)
    assert np.allclose(coupled.v, coupled.p / 1.5, atol=1e-9)
    full = stiffness + 0.001
    assert fvi.integrate(**given, stiffness=full).summary["solver"]["kind"] == "dense"


def test_events_may_be_functions():
    common = dict(mass=[1.0, 1.0], stiffness=[1.0, 4.0], position=[1.0, 0.0], velocity=[0.0, 1.0], step=0.1, end=10.0)
    words = fvi.integrate(**common, events=[fvi.Event("q0 - 0.3*q1"), fvi.Event("q0", "rising"), fvi.Event("t - 3.21")])
    code = fvi.integrate(**common, events=[fvi.Event(lambda t, q: q[0] - 0.3 * q[1]), fvi.Event("q0", "rising"), fvi.Event(lambda t: t - 3.21)])
    times = [[(event["event"], event["rising"], event["time"]) for event in run.events] for run in (words, code)]
    assert len(times[0]) > 4 and [one[:2] for one in times[0]] == [other[:2] for other in times[1]]
    assert np.allclose([one[2] for one in times[0]], [other[2] for other in times[1]], rtol=0.0, atol=1e-13)
    with_momenta = dict(common, scheme="collocation", convolution="radau-iia", stages=3)
    stopped = fvi.integrate(**with_momenta, events=fvi.Event(lambda t, q, p: p[0], "rising", "stop"))
    assert abs(stopped.t[-1] - np.pi) < 1e-4 and "event 0" in stopped.message
    with pytest.raises(fvi.InputError, match="collocation") as caught:
        fvi.integrate(**common, events=fvi.Event(lambda t, q, p: p[0]))
    assert caught.value.key == "events[0].when"

    def breaks(t, q):
        if t > 2.0:
            raise LookupError("no more")
        return q[0]

    with pytest.raises(LookupError, match="no more") as raised:
        fvi.integrate(**common, events=fvi.Event(breaks))
    assert 2.0 <= raised.value.result.t[-1] <= 2.2
    with pytest.raises(fvi.InputError, match="2 numbers"):
        fvi.integrate(**common, events=fvi.Event(lambda t, q: q))


OSCILLATOR = {
    "system": {
        "mass": 2.0,
        "potential": fvi.Potential(lambda q: np.sum(q**2 + 0.25 * q**4), lambda q: 2.0 * q + q**3),
        "force": lambda t: [np.sin(t), 0.0],
        "damping": [fvi.Damping(order=0.5, coefficient=[0.2, 0.1])],
        "load": [fvi.Load([0.0, 1.0], lambda t: t), {"pattern": [1.0, 0.0], "amplitude": "t^2"}],
    },
    "initial": {"position": [1.0, 0.5]},
    "time": {"step": 0.05, "steps": 100},
}


def test_dictionaries_take_what_integrate_takes():
    asked = fvi.integrate(
        mass=2.0, potential=OSCILLATOR["system"]["potential"], force=lambda t: [np.sin(t), 0.0],
        damping=OSCILLATOR["system"]["damping"], loads=OSCILLATOR["system"]["load"], position=[1.0, 0.5], step=0.05, steps=100,
    )  # fmt: skip
    told = fvi.run(OSCILLATOR)
    assert np.array_equal(told.q, asked.q) and np.array_equal(fvi.integrate(continue_from=told, steps=10).q[0], told.q[-1])
    watched = {**OSCILLATOR, "event": fvi.Event(lambda t, q: q[0] - 0.9)}
    assert len(fvi.run(watched).events) > 0
    rest = {"system": {"mass": [1.0, 1.0], "element": fvi.Element("x0^2 - x0", [[1]])}, "initial": {"position": 0.0}, "time": OSCILLATOR["time"]}
    assert np.abs(fvi.run(rest).q[:, 1]).max() > 0.5
    with pytest.raises(fvi.InputError, match="leaves no files"):
        fvi.run(OSCILLATOR, out="somewhere")
    with pytest.raises(fvi.InputError) as caught:
        fvi.run({**OSCILLATOR, "system": {**OSCILLATOR["system"], "potential": fvi.Potential(3, 4)}})
    assert caught.value.key == "system.potential.value"


def test_sweeps_on_threads_take_functions():
    sweep = {"scenario": OSCILLATOR, "axes": {"initial.position[0]": [0.5, 1.0, 1.5]}, "keep": {"quantities": ["last"]}}
    table = fvi.sweep(sweep, jobs=2)
    for start, last in zip([0.5, 1.0, 1.5], table["q0"]):
        alone = fvi.run({**OSCILLATOR, "initial": {"position": [start, 0.5]}})
        assert alone.q[-1, 0] == last
    for more in (dict(out="somewhere"), dict(shard="1/2", out="somewhere")):
        with pytest.raises(fvi.InputError, match="threads of this process") as caught:
            fvi.sweep(sweep, **more)
        assert caught.value.key == "scenario"

    def breaks(t):
        raise LookupError("no table")

    with pytest.raises(LookupError, match="no table"):
        fvi.sweep({**sweep, "scenario": {**OSCILLATOR, "system": {**OSCILLATOR["system"], "force": breaks}}}, jobs=2)


def test_the_trapezoidal_rule_is_a_keyword():
    common = dict(mass=[1.0], stiffness=[1.0], position=[1.0], damping=fvi.Damping(0.5, [0.5]), step=0.1, steps=50)
    family = fvi.integrate(**common, convolution="trapezoidal")
    symbol = fvi.integrate(**common, symbol="trapezoidal")
    dictionary = fvi.integrate(**common, overrides={"convolution.symbol": "trapezoidal"})
    assert np.array_equal(family.q, symbol.q) and np.array_equal(family.q, dictionary.q)
    assert np.abs(family.q - fvi.integrate(**common, order=2).q).max() > 1e-6
    assert '"trapezoidal"' in fvi.integrate.__doc__
