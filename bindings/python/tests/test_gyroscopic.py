"""Gyroscopic forces: conserved quantities, the order of schemes, and where they are refused."""

import numpy as np
import pytest
import scipy.sparse as sp

import fvi

# A charge in a magnetic field and a trap: q̈ + Ω J q̇ + k q = 0, z = x + i y, z̈ = −iΩ ż·s − k z.
OMEGA, K = 1.7, 0.8
SKEW = OMEGA * np.array([[0.0, -1.0], [1.0, 0.0]])
TRAP = dict(mass=[1.0, 1.0], stiffness=[K, K], gyroscopic=SKEW, position=[1.0, 0.0], velocity=[0.0, 0.5])


def exact(t):
    """z̈ + iΩ ż + k z = 0."""
    rates = -0.5j * OMEGA + np.array([1.0, -1.0]) * 1j * np.sqrt(K + OMEGA**2 / 4)
    a, b = np.linalg.solve(np.array([[1.0, 1.0], rates]), np.array([1.0, 0.5j]))
    z = a * np.exp(rates[0] * t) + b * np.exp(rates[1] * t)
    return np.column_stack([z.real, z.imag])


@pytest.mark.parametrize(("scheme", "order"), [(dict(), 2), (dict(scheme="galerkin", degree=2), 4), (dict(scheme="galerkin", degree=3), 6)])
def test_schemes_keep_their_order_and_the_energy(scheme, order):
    errors = []
    for steps in (20, 40):
        r = fvi.integrate(**TRAP, **scheme, step=8.0 / steps, steps=steps)
        errors.append(np.abs(r.q - exact(r.t)).max())
        assert np.ptp(r.energy) < 1e-13
    assert order - 0.2 < np.log2(errors[0] / errors[1]) < order + 0.4


def test_large_steps_do_not_grow():
    r = fvi.integrate(**TRAP, step=50.0, steps=2000)
    assert np.ptp(r.energy) < 1e-9


def test_damping_takes_energy_and_the_same_forces_in_code_move_alike():
    damped = dict(TRAP, damping=fvi.Damping(0.5, [0.2, 0.2]), step=0.01, steps=800)
    r = fvi.integrate(**damped)
    assert r.energy[-1] < 0.7 * r.energy[0]
    # Order 1 of the damper: G in the place of ρ is the same force by a difference quotient of order 2.
    one = fvi.integrate(**{**damped, "damping": fvi.Damping(1.0, [0.3, 0.3])})
    z = -0.5 * (0.3 + 1j * OMEGA) + np.array([1, -1]) * np.sqrt((0.3 + 1j * OMEGA) ** 2 / 4 - K + 0j)
    a, b = np.linalg.solve(np.array([[1.0, 1.0], z]), np.array([1.0, 0.5j]))
    motion = a * np.exp(z[0] * one.t) + b * np.exp(z[1] * one.t)
    assert np.abs(one.q[:, 0] + 1j * one.q[:, 1] - motion).max() < 1e-3


def test_nonlinear_potentials_sparse_matrices_and_models_take_them():
    cube = dict(TRAP, potential="0.25*(q0^2 + q1^2)^2", step=0.05, steps=200)
    words = fvi.integrate(**cube)
    assert np.ptp(words.energy) < 1e-3
    code = fvi.integrate(**{**cube, "potential": fvi.Potential(lambda q: 0.25 * (q @ q) ** 2, lambda q: (q @ q) * q)})
    sparse = fvi.integrate(**{**cube, "gyroscopic": sp.csr_matrix(SKEW)})
    for other in (code, sparse):
        assert np.abs(other.q - words.q).max() < 1e-11
    n = 40
    skew = sp.kron(sp.identity(n), SKEW).tocsr()
    many = fvi.integrate(mass=np.ones(2 * n), stiffness=K * np.ones(2 * n), gyroscopic=skew, position=np.tile([1.0, 0.0], n),
                         velocity=np.tile([0.0, 0.5], n), step=0.05, steps=100)  # fmt: skip
    assert many.summary["solver"]["kind"] == "dense" and np.abs(many.q[:, 4:6] - exact(many.t)).max() < 2e-3
    again = fvi.Model(**TRAP).integrate(step=0.05, steps=10)
    assert np.array_equal(again.q, fvi.integrate(**TRAP, step=0.05, steps=10).q)
    first = fvi.integrate(**TRAP, step=0.05, steps=10)
    assert np.array_equal(fvi.integrate(continue_from=first, steps=10).q[1:], fvi.integrate(**TRAP, step=0.05, steps=20).q[11:])


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (dict(gyroscopic=[[0.0, 1.0], [1.0, 0.0]]), "gyroscopic"),
        (dict(gyroscopic=[[0.5, 1.0], [-1.0, 0.0]]), "gyroscopic"),
        (dict(gyroscopic=[1.0, 1.0]), "gyroscopic"),
        (dict(gyroscopic=np.zeros((3, 3))), "gyroscopic"),
        (dict(at="main-nodes"), "at"),
        (dict(scheme="collocation"), "scheme"),
        (dict(scheme="explicit-euler"), "scheme"),
        (dict(scheme="galerkin", degree=2, quadrature="lobatto"), "scheme"),
        (dict(scheme="galerkin", degree=2, damping=fvi.Damping(0.5, [1.0, 1.0])), "scheme"),
        (dict(sensitivities=["system.gyroscopic[0][0]"]), "sensitivities[0]"),
    ],
)
def test_what_cannot_be_used_is_named(change, key):
    with pytest.raises(fvi.InputError) as caught:
        fvi.integrate(**TRAP | dict(step=0.1, steps=10) | change)
    assert caught.value.key == key, caught.value


def test_scenarios_have_them_and_responses_refuse_them():
    scenario = {
        "system": {"mass": [1.0, 1.0], "stiffness": [K, K], "gyroscopic": SKEW},
        "initial": {"position": [1.0, 0.0], "velocity": [0.0, 0.5]},
        "time": {"step": 0.1, "steps": 30},
    }
    told = fvi.run(scenario)
    assert np.array_equal(told.q, fvi.integrate(**TRAP, step=0.1, steps=30).q)
    assert told.summary["scenario"]["system"]["gyroscopic"] == SKEW.tolist()
    with pytest.raises(fvi.InputError, match="gyroscopic"):
        fvi.response(scenario, [1.0])
