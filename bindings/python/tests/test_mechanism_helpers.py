"""`fvi.mechanism`: what it writes moves as mechanics says."""

import numpy as np
import pytest

import fvi
from fvi import mechanism

SCHEME = {"scheme": "galerkin", "degree": 3}


def test_a_chain_moves_as_its_masses_on_rods_do() -> None:
    lengths, masses, angles = [1.0, 0.7, 0.4], [1.0, 0.8, 0.5], np.array([1.0, 1.6, 0.3])
    chain = mechanism.pendulum_chain(lengths, masses)
    first = fvi.integrate(**chain, position=angles, step=0.01, end=1.0, **SCHEME)
    bars = [(node, node + 1, length) for node, length in enumerate(lengths)]
    places = mechanism.truss([None, *masses], bars, fixed={0: (0.0, 0.0)})
    points = mechanism.pendulum_points(lengths)
    start = points(angles)[1:].ravel()
    second = fvi.integrate(**places, position=start, step=0.01, end=1.0, **SCHEME)
    assert np.abs(points(first.q[-1])[1:].ravel() - second.q[-1]).max() < 1e-8
    assert np.abs(first.energy - second.energy).max() < 1e-6
    assert mechanism.joints(3) == ["q0", "q1 - q0", "q2 - q1"]


def test_a_free_body_keeps_its_angular_momentum() -> None:
    inertia = np.array([[0.4, 0.05, 0.0], [0.05, 0.3, 0.02], [0.0, 0.02, 0.2]])
    body = mechanism.rigid_body(inertia, mass=2.0)
    q, rates = np.array([0.5, 0.5, -0.5, 0.5]), np.array([1.0, 5.0, -2.0])
    assert np.allclose(mechanism.body_rates(q, mechanism.quaternion_rates(q, rates)), rates)
    r = fvi.integrate(
        **body, position=[*q, 0.0, 0.0, 1.0], velocity=[*mechanism.quaternion_rates(q, rates), 1.0, 0.0, 2.0],
        step=0.01, end=2.0, **SCHEME,
    )
    # p = 4 Lᵀ J L q̇: the body rates are those of J⁻¹ times a quarter of L p.
    spins = []
    for position, momentum in zip(r.q[:, :4], r.p[:, :4], strict=True):
        own = np.array([mechanism.body_rates(position, row) for row in np.eye(4)]).T / 4
        spins.append(mechanism.rotation(position) @ (own @ momentum))
    before = mechanism.rotation(q) @ inertia @ rates
    assert np.abs(np.array(spins) - before).max() < 1e-7
    assert np.abs(r.q[-1, 4:] - [2.0, 0.0, 1.0 + 2.0 * 2.0 - 0.5 * 9.81 * 4.0]).max() < 1e-9


def test_the_axis_of_a_top_turns_at_the_rate_of_the_textbook() -> None:
    spin, lean, j, jz, arm = 200.0, 0.3, 0.02, 0.01, 0.1
    # Steady precession: J sin cos Ω² − Jz s Ω sin + m g l sin = 0 with the spin s about the axis.
    roots = np.roots([(j) * np.cos(lean), -jz * spin, 9.81 * arm])
    slow = float(np.abs(roots).min())
    q = [np.cos(lean / 2), np.sin(lean / 2), 0.0, 0.0]
    rates = np.array([0.0, slow * np.sin(lean), spin])
    top = mechanism.rigid_body([j, j, jz], mass=1.0, arm=[0.0, 0.0, arm])
    r = fvi.integrate(
        **top, position=q, velocity=mechanism.quaternion_rates(q, rates), step=0.0005, end=0.5, **SCHEME,
    )
    axis = np.array([mechanism.rotation(position)[:, 2] for position in r.q])
    assert np.abs(axis[:, 2] - np.cos(lean)).max() < 1e-6
    turned = np.unwrap(np.arctan2(axis[:, 1], axis[:, 0]))
    assert abs((turned[-1] - turned[0]) / 0.5 - slow) < 1e-4 * slow


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: mechanism.pendulum_chain([1.0, -1.0], [1.0, 1.0]), "lengths"),
        (lambda: mechanism.pendulum_chain([1.0], [1.0, 1.0]), "masses"),
        (lambda: mechanism.truss([1.0, 1.0], [(0, 2, 1.0)]), r"bars\[0\]"),
        (lambda: mechanism.truss([None, 1.0], [(0, 1, 1.0)]), "masses"),
        (lambda: mechanism.rigid_body([1.0, 1.0]), "inertia"),
        (lambda: mechanism.rigid_body([1.0, 1.0, 1.0], arm=[0.0, 1.0]), "arm"),
        (lambda: mechanism.distance(["q0"], [1.0, 2.0]), "points"),
    ],
)
def test_what_makes_no_mechanism_is_refused(make, said: str) -> None:
    with pytest.raises(fvi.InputError, match=said):
        make()


def test_a_motion_is_drawn() -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    r = fvi.integrate(**mechanism.pendulum_chain([1.0, 0.5], [1.0, 1.0]), position=[1.0, 2.0], step=0.02, end=1.0)
    picture = mechanism.stroboscope(r, mechanism.pendulum_points([1.0, 0.5]), frames=10)
    assert len(picture[0].lines) == 11
    last = picture[0].lines[9].get_xydata()
    assert np.allclose(last, mechanism.pendulum_points([1.0, 0.5])(r.q[-1]))
    with pytest.raises(fvi.InputError, match="frames"):
        mechanism.stroboscope(r, mechanism.pendulum_points([1.0, 0.5]), frames=0)
    pyplot.close(picture.figure)
